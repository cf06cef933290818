// SPDX-License-Identifier: Apache-2.0
/*
 * exr_dwa.cc - DWAA and DWAB chunks through the OpenEXR C++ library: Debian's OpenEXRCore 3.1 lacks them,
 * and the library's compressor classes are private.
 *
 * A DWA chunk depends on no other and not on its place, so each is handled as a one-chunk file in memory
 * whose header is written here from checked values: the library never parses a header from outside.
 * No exception leaves this file.
 */
#include "exr_codec.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <ImfTiledInputFile.h>
#include <ImfTiledOutputFile.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

struct MemoryOut : Imf::OStream {
    std::vector<char> bytes;
    size_t at = 0;
    MemoryOut() : OStream("chunk") {}
    void write(const char c[], int n) override
    {
        if (at + size_t(n) > bytes.size())
            bytes.resize(at + size_t(n));
        memcpy(bytes.data() + at, c, size_t(n));
        at += size_t(n);
    }
    uint64_t tellp() override { return at; }
    void seekp(uint64_t p) override { at = p; }
};

struct MemoryIn : Imf::IStream {
    const std::vector<char> &bytes;
    size_t at = 0;
    explicit MemoryIn(const std::vector<char> &b) : IStream("chunk"), bytes(b) {}
    bool read(char c[], int n) override
    {
        if (n < 0 || size_t(n) > bytes.size() - at)
            throw std::runtime_error("ends early");
        memcpy(c, bytes.data() + at, size_t(n));
        at += size_t(n);
        return at < bytes.size();
    }
    uint64_t tellg() override { return at; }
    void seekg(uint64_t p) override
    {
        if (p > bytes.size())
            throw std::runtime_error("seeks past its end");
        at = p;
    }
};

int floor_mod(int a, int b) { return (a % b + b) % b; }

unsigned sample_bytes(uint8_t type) { return type == Imf::HALF ? 2 : 4; }

Imf::Header make_header(const exr_codec_chunk *c)
{
    const int y = c->tiled ? 0 : c->y;
    Imath::Box2i window(Imath::V2i(0, y), Imath::V2i(int(c->width) - 1, y + int(c->height) - 1));
    Imf::Header h(window, window);
    h.compression() = Imf::Compression(c->compression);
    h.dwaCompressionLevel() = c->dwa_level;
    for (unsigned i = 0; i < c->channels; i++) {
        const exr_codec_channel &k = c->channel[i];
        h.channels().insert(k.name, Imf::Channel(Imf::PixelType(k.type), k.x_sampling, k.y_sampling,
                                                 k.linear != 0));
    }
    if (c->tiled)
        h.setTileDescription(Imf::TileDescription(c->width, c->height));
    return h;
}

// The chunk's samples, channel by channel, as the library wants them: it has no per-row layout for
// subsampled channels.
struct Planar {
    std::vector<char> bytes;
    std::vector<size_t> start;
    Imf::FrameBuffer frame;

    explicit Planar(const exr_codec_chunk *c)
    {
        size_t total = 0;
        for (unsigned i = 0; i < c->channels; i++) {
            const exr_codec_channel &k = c->channel[i];
            start.push_back(total);
            total += size_t(k.width) * k.height * sample_bytes(k.type);
        }
        bytes.resize(total + 8);
        for (unsigned i = 0; i < c->channels; i++) {
            const exr_codec_channel &k = c->channel[i];
            const size_t x = sample_bytes(k.type), line = x * k.width;
            // The library counts lines from 0, not from the chunk's first.
            const ptrdiff_t first = c->tiled ? 0 : (c->y - floor_mod(c->y, k.y_sampling)) / k.y_sampling;
            char *base = bytes.data() + start[i] - first * ptrdiff_t(line);
            frame.insert(k.name, Imf::Slice(Imf::PixelType(k.type), base, x, line, k.x_sampling,
                                            k.y_sampling));
        }
    }

    // Between planes and rows; visit(plane bytes, row bytes, n).
    template <class Visit> void rows(const exr_codec_chunk *c, uint64_t room, Visit visit)
    {
        std::vector<size_t> at(start);
        uint64_t row = 0;
        for (uint32_t y = 0; y < c->height; y++)
            for (unsigned i = 0; i < c->channels; i++) {
                const exr_codec_channel &k = c->channel[i];
                if (!c->tiled && (c->y + int64_t(y)) % k.y_sampling)
                    continue;
                const size_t n = size_t(k.width) * sample_bytes(k.type);
                if (n > room - row)
                    throw std::runtime_error("has another size than its pixels");
                visit(bytes.data() + at[i], row, n);
                at[i] += n;
                row += n;
            }
    }
};

// A file that ends where its only chunk begins; the last 8 bytes are the offset table.
void begin_file(const exr_codec_chunk *c, const Imf::Header &h, MemoryOut &out)
{
    size_t begin;
    if (c->tiled) {
        Imf::TiledOutputFile file(out, h, 0);
        begin = out.bytes.size();
    } else {
        Imf::OutputFile file(out, h, 0);
        begin = out.bytes.size();
    }
    out.bytes.resize(begin);
    uint64_t offset = begin;
    for (int i = 0; i < 8; i++)
        out.bytes[begin - 8 + size_t(i)] = char(offset >> 8 * i);
    out.at = begin;
}

void put_u32(MemoryOut &out, uint32_t v)
{
    char b[4] = { char(v), char(v >> 8), char(v >> 16), char(v >> 24) };
    out.write(b, 4);
}

void unpack(const exr_codec_chunk *c, const uint8_t *packed, uint64_t packed_bytes, uint8_t *unpacked,
            uint64_t unpacked_bytes)
{
    MemoryOut file;
    begin_file(c, make_header(c), file);
    if (c->tiled)
        for (int i = 0; i < 4; i++)
            put_u32(file, 0);
    else
        put_u32(file, uint32_t(c->y));
    put_u32(file, uint32_t(packed_bytes));
    file.write(reinterpret_cast<const char *>(packed), int(packed_bytes));
    MemoryIn in(file.bytes);
    Planar planar(c);
    if (c->tiled) {
        Imf::TiledInputFile reader(in, 0);
        reader.setFrameBuffer(planar.frame);
        reader.readTile(0, 0);
    } else {
        Imf::InputFile reader(in, 0);
        reader.setFrameBuffer(planar.frame);
        reader.readPixels(c->y, c->y + int(c->height) - 1);
    }
    planar.rows(c, unpacked_bytes, [&](const char *plane, uint64_t row, size_t n) {
        memcpy(unpacked + row, plane, n);
    });
}

std::vector<char> pack(const exr_codec_chunk *c, const uint8_t *unpacked, uint64_t unpacked_bytes)
{
    MemoryOut out;
    Planar planar(c);
    planar.rows(c, unpacked_bytes, [&](char *plane, uint64_t row, size_t n) {
        memcpy(plane, unpacked + row, n);
    });
    const Imf::Header h = make_header(c);
    if (c->tiled) {
        size_t begin;
        {
            Imf::TiledOutputFile file(out, h, 0);
            begin = out.bytes.size();
            file.setFrameBuffer(planar.frame);
            file.writeTile(0, 0);
        }
        return std::vector<char>(out.bytes.begin() + ptrdiff_t(begin) + 20, out.bytes.end());
    }
    size_t begin;
    {
        Imf::OutputFile file(out, h, 0);
        begin = out.bytes.size();
        file.setFrameBuffer(planar.frame);
        file.writePixels(int(c->height));
    }
    return std::vector<char>(out.bytes.begin() + ptrdiff_t(begin) + 8, out.bytes.end());
}

template <class Body> int guarded(char why[96], Body body)
{
    try {
        body();
        return 0;
    } catch (const std::exception &e) {
        snprintf(why, 96, "%s", e.what());
    } catch (...) {
        snprintf(why, 96, "cannot be coded as DWA");
    }
    return -1;
}

} // namespace

int exr_dwa_unpack(const struct exr_codec_chunk *c, const uint8_t *packed, uint64_t packed_bytes,
                   uint8_t *unpacked, uint64_t unpacked_bytes, char why[96])
{
    return guarded(why, [&] { unpack(c, packed, packed_bytes, unpacked, unpacked_bytes); });
}

int exr_dwa_pack(const struct exr_codec_chunk *c, const uint8_t *unpacked, uint64_t unpacked_bytes,
                 uint8_t **packed, uint64_t *packed_bytes, char why[96])
{
    return guarded(why, [&] {
        const std::vector<char> bytes = pack(c, unpacked, unpacked_bytes);
        *packed = static_cast<uint8_t *>(malloc(bytes.size() + 1));
        if (!*packed)
            throw std::bad_alloc();
        memcpy(*packed, bytes.data(), bytes.size());
        *packed_bytes = bytes.size();
    });
}
