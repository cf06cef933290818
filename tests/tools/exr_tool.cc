// SPDX-License-Identifier: Apache-2.0
// exr_tool.cc - see exr_tool.h.
#include "exr_tool.h"

#include <ImfArray.h>
#include <ImfAttribute.h>
#include <ImfChannelList.h>
#include <ImfChromaticitiesAttribute.h>
#include <ImfDeepFrameBuffer.h>
#include <ImfDeepScanLineOutputPart.h>
#include <ImfFrameBuffer.h>
#include <ImfIO.h>
#include <ImfInputPart.h>
#include <ImfMultiPartInputFile.h>
#include <ImfMultiPartOutputFile.h>
#include <ImfOpaqueAttribute.h>
#include <ImfOutputFile.h>
#include <ImfOutputPart.h>
#include <ImfPartType.h>
#include <ImfPreviewImage.h>
#include <ImfRgbaFile.h>
#include <ImfStandardAttributes.h>
#include <ImfTiledInputPart.h>
#include <ImfTiledOutputFile.h>
#include <ImfTiledOutputPart.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

using namespace Imf;
using Imath::Box2i;
using Imath::V2i;

namespace {

struct Out : OStream {
    std::vector<char> bytes;
    size_t at = 0;
    Out() : OStream("memory") {}
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

struct In : IStream {
    const uint8_t *bytes;
    size_t size, at = 0;
    In(const uint8_t *b, size_t n) : IStream("memory"), bytes(b), size(n) {}
    bool read(char c[], int n) override
    {
        if (n < 0 || size_t(n) > size - at)
            throw std::runtime_error("the file ends early");
        memcpy(c, bytes + at, size_t(n));
        at += size_t(n);
        return at < size;
    }
    uint64_t tellg() override { return at; }
    void seekg(uint64_t p) override { at = p <= size ? p : size; }
};

uint32_t mix(uint32_t a)
{
    a ^= a >> 16;
    a *= 0x7feb352du;
    a ^= a >> 15;
    a *= 0x846ca68bu;
    return a ^ a >> 16;
}

// A dim gradient with grain and a few lamps; the same for the same place, channel and level.
float sample(int x, int y, unsigned channel, unsigned level, bool specials)
{
    const uint32_t r = mix(uint32_t(x) * 7919u + uint32_t(y) * 104729u + channel * 31u + level * 17u);
    float v = 0.1f + 0.0007f * float(x & 255) + 0.0005f * float(y & 255) + 0.01f * float(channel);
    v += 0.002f * float(r & 1023) / 1023.0f;
    if (r % 509 == 0)
        v = 3.0f + float(r >> 24);
    if (specials && r % 101 == 1) {
        static const float odd[] = { NAN, INFINITY, -INFINITY, -0.0f, -0.25f, 6e-8f, 65504.0f, 0.0f };
        v = odd[(r >> 8) & 7];
    }
    return v;
}

struct Image {
    std::map<std::string, std::vector<char>> data;
    FrameBuffer frame;
};

int modp(int a, int b) { return (a % b + b) % b; }
int divp(int a, int b) { return (a - modp(a, b)) / b; }

// A frame buffer of its own for window w of these channels.
void make_image(Image &im, const ChannelList &channels, const Box2i &w)
{
    for (auto i = channels.begin(); i != channels.end(); ++i) {
        const Channel &c = i.channel();
        const size_t bytes = c.type == HALF ? 2 : 4;
        const int cw = (w.max.x - w.min.x + 1) / c.xSampling, ch = (w.max.y - w.min.y + 1) / c.ySampling;
        std::vector<char> &d = im.data[i.name()];
        d.assign(size_t(cw) * size_t(ch) * bytes + 8, 0);
        const ptrdiff_t origin = ptrdiff_t(divp(w.min.y, c.ySampling)) * cw + divp(w.min.x, c.xSampling);
        im.frame.insert(i.name(), Slice(c.type, d.data() - origin * ptrdiff_t(bytes), bytes,
                                        bytes * size_t(cw), c.xSampling, c.ySampling));
    }
}

void fill_image(Image &im, const ChannelList &channels, const Box2i &w, unsigned level, bool specials)
{
    unsigned index = 0;
    for (auto i = channels.begin(); i != channels.end(); ++i, ++index) {
        const Channel &c = i.channel();
        const int cw = (w.max.x - w.min.x + 1) / c.xSampling, ch = (w.max.y - w.min.y + 1) / c.ySampling;
        const char *dot = strrchr(i.name(), '.'), *last = dot ? dot + 1 : i.name();
        const bool chroma = !strcmp(last, "RY") || !strcmp(last, "BY");
        for (int y = 0; y < ch; y++)
            for (int x = 0; x < cw; x++) {
                float v = sample(x, y, index, level, specials && !chroma);
                if (chroma)
                    v = 0.3f * float(sin(0.05 * x + 0.11 * y + index));
                char *to = im.data[i.name()].data() + (size_t(y) * size_t(cw) + size_t(x)) *
                                                          (c.type == HALF ? 2 : 4);
                if (c.type == HALF) {
                    const uint16_t h = Imath::half(v).bits();
                    memcpy(to, &h, 2);
                } else if (c.type == FLOAT) {
                    memcpy(to, &v, 4);
                } else {
                    const uint32_t u = mix(uint32_t(x * 3 + y));
                    memcpy(to, &u, 4);
                }
            }
    }
}

void add_channels(Header &h, const exr_tool_spec *s)
{
    ChannelList &c = h.channels();
    const PixelType t = s->type == 2 ? FLOAT : HALF, green = s->type == 1 ? HALF : FLOAT;
    auto rgb = [&](const std::string &p) {
        c.insert(p + "R", Channel(t));
        c.insert(p + "G", Channel(green));
        c.insert(p + "B", Channel(t));
    };
    switch (s->layout) {
    case EXR_TOOL_RGBA:
        rgb("");
        rgb("diffuse.");
        c.insert("A", Channel(HALF));
        c.insert("Z", Channel(FLOAT));
        c.insert("id", Channel(UINT));
        break;
    case EXR_TOOL_Y:
        c.insert("Y", Channel(t));
        c.insert("A", Channel(HALF));
        break;
    case EXR_TOOL_YC:
        c.insert("Y", Channel(t));
        c.insert("RY", Channel(t, 2, 2, true));
        c.insert("BY", Channel(t, 2, 2, true));
        break;
    case EXR_TOOL_STEREO:
        rgb("");
        rgb("right.");
        rgb("diffuse.right.");
        c.insert("A", Channel(HALF));
        c.insert("right.A", Channel(HALF));
        addMultiView(h, { "left", "right" });
        break;
    case EXR_TOOL_G:
        c.insert("G", Channel(t));
        break;
    case EXR_TOOL_EYES:
        for (const char *eye : { "", "right." }) {
            rgb(eye);
            rgb(std::string("glow.") + eye);
            c.insert(std::string(eye) + "Z", Channel(FLOAT));
            c.insert(std::string(eye) + "matte", Channel(HALF));
        }
        rgb("shared.");
        c.insert("hold.A", Channel(FLOAT));
        for (const char *name : { "id.m", "id.R", "id.G", "id.B" })
            c.insert(name, Channel(UINT));
        addMultiView(h, { "left", "right" });
        break;
    case EXR_TOOL_CROWD:
        for (const char *view : { "", "v1.", "v2.", "v3.", "v4.", "v5." }) {
            rgb(view);
            c.insert(std::string(view) + "Z", Channel(FLOAT));
        }
        addMultiView(h, { "v0", "v1", "v2", "v3", "v4", "v5" });
        break;
    case EXR_TOOL_SMALL:
        rgb("");
        c.insert("small", Channel(HALF, 2, 2));
        break;
    case EXR_TOOL_YCGLOW:
        for (const char *prefix : { "", "glow." }) {
            c.insert(std::string(prefix) + "Y", Channel(t));
            c.insert(std::string(prefix) + "RY", Channel(t, 2, 2, true));
            c.insert(std::string(prefix) + "BY", Channel(t, 2, 2, true));
        }
        break;
    case EXR_TOOL_UINT:
        c.insert("R", Channel(UINT));
        c.insert("G", Channel(UINT));
        c.insert("B", Channel(UINT));
        break;
    }
}

void add_attributes(Header &h)
{
    addOwner(h, "the tests");
    addComments(h, "a comment");
    addTimeCode(h, TimeCode(1, 2, 3, 4));
    addKeyCode(h, KeyCode(12, 34, 56, 7, 8));
    addChromaticities(h, Chromaticities());
    static const uint8_t blob[] = { 1, 0, 2, 0, 127, 255 };
    In from(blob, sizeof(blob));
    OpaqueAttribute odd("weirdType");
    odd.readValueFrom(from, sizeof(blob), 2);
    h.insert("oddity", odd);
    h.insert("oiio:SHA-1", StringAttribute("0123"));
    PreviewRgba pixels[6];
    h.setPreviewImage(PreviewImage(3, 2, pixels));
}

Header make_header(const exr_tool_spec *s)
{
    const Box2i w(V2i(s->min_x, s->min_y), V2i(s->min_x + s->width - 1, s->min_y + s->height - 1));
    Header h(Box2i(V2i(0, 0), V2i(99, 79)), w, 1.5f);
    h.compression() = Compression(s->compression);
    h.lineOrder() = LineOrder(s->line_order);
    if (s->dwa_level > 0)
        h.insert("dwaCompressionLevel", FloatAttribute(s->dwa_level));
    add_channels(h, s);
    add_attributes(h);
    if (s->tiled)
        h.setTileDescription(TileDescription(unsigned(s->tile_width), unsigned(s->tile_height),
                                             LevelMode(s->tiled - 1), LevelRoundingMode(s->round_up)));
    return h;
}

template <class File> void write_tiles(File &file, const Header &h, bool specials)
{
    const bool rip = h.tileDescription().mode == RIPMAP_LEVELS;
    for (int ly = 0; ly < file.numYLevels(); ly++)
        for (int lx = 0; lx < file.numXLevels(); lx++) {
            if (!rip && lx != ly)
                continue;
            const Box2i w = file.dataWindowForLevel(lx, ly);
            Image im;
            make_image(im, h.channels(), w);
            fill_image(im, h.channels(), w, unsigned(lx * 8 + ly), specials);
            file.setFrameBuffer(im.frame);
            file.writeTiles(0, file.numXTiles(lx) - 1, 0, file.numYTiles(ly) - 1, lx, ly);
        }
}

template <class File> void write_lines(File &file, const Header &h, bool specials)
{
    Image im;
    make_image(im, h.channels(), h.dataWindow());
    fill_image(im, h.channels(), h.dataWindow(), 0, specials);
    file.setFrameBuffer(im.frame);
    file.writePixels(h.dataWindow().max.y - h.dataWindow().min.y + 1);
}

void write_deep(MultiPartOutputFile &file, int part, const Header &h)
{
    DeepScanLineOutputPart out(file, part);
    const Box2i w = h.dataWindow();
    const int width = w.max.x - w.min.x + 1, height = w.max.y - w.min.y + 1;
    std::vector<unsigned> counts(size_t(width) * size_t(height), 1);
    std::vector<float> values(counts.size(), 0.5f);
    std::vector<float *> pointers;
    for (float &v : values)
        pointers.push_back(&v);
    const ptrdiff_t origin = ptrdiff_t(w.min.y) * width + w.min.x;
    DeepFrameBuffer frame;
    frame.insertSampleCountSlice(Slice(UINT, reinterpret_cast<char *>(counts.data() - origin),
                                       sizeof(unsigned), sizeof(unsigned) * size_t(width)));
    for (const char *name : { "R", "G", "B", "Z" })
        frame.insert(name, DeepSlice(FLOAT, reinterpret_cast<char *>(pointers.data() - origin),
                                     sizeof(float *), sizeof(float *) * size_t(width), sizeof(float)));
    out.setFrameBuffer(frame);
    out.writePixels(height);
}

void make_multipart(const exr_tool_spec *s, Out &out)
{
    std::vector<Header> h(2, make_header(s));
    h[0].setName("first.left");
    h[1].setName("second.right");
    h[0].setView("left");
    h[1].setView("right");
    for (Header &i : h)
        i.setType(s->tiled ? TILEDIMAGE : SCANLINEIMAGE);
    Header depth(Box2i(V2i(0, 0), V2i(99, 79)), Box2i(V2i(-3, 5), V2i(60, 40)));
    depth.channels().insert("Z", Channel(FLOAT));
    depth.compression() = ZIPS_COMPRESSION;
    depth.setName("depth");
    depth.setType(SCANLINEIMAGE);
    h.push_back(depth);
    if (s->parts > 2) {
        Header deep(depth);
        deep.channels() = ChannelList();
        for (const char *name : { "R", "G", "B", "Z" })
            deep.channels().insert(name, Channel(FLOAT));
        deep.setName("deep");
        deep.setType(DEEPSCANLINE);
        h.push_back(deep);
    }
    if (s->aov) {
        Header aov(Box2i(V2i(0, 0), V2i(99, 79)), h[0].dataWindow());
        for (const char *name : { "R", "G", "B", "mask.A" })
            aov.channels().insert(name, Channel(HALF));
        aov.compression() = ZIPS_COMPRESSION;
        aov.setName("emission");
        aov.setType(SCANLINEIMAGE);
        h.push_back(aov);
    }
    for (Header &i : h) // attributes that all parts share must agree
        i.pixelAspectRatio() = 1.5f;
    for (size_t i = 2; i < h.size(); i++) {
        addChromaticities(h[i], Chromaticities());
        addTimeCode(h[i], TimeCode(1, 2, 3, 4));
    }
    MultiPartOutputFile file(out, h.data(), int(h.size()), false, 0);
    for (int i = 0; i < 2; i++) {
        if (s->tiled) {
            TiledOutputPart part(file, i);
            write_tiles(part, part.header(), s->specials);
        } else {
            OutputPart part(file, i);
            write_lines(part, part.header(), s->specials);
        }
    }
    OutputPart part(file, 2);
    write_lines(part, part.header(), s->specials);
    if (s->parts > 2)
        write_deep(file, 3, file.header(3));
    if (s->aov) {
        OutputPart aov(file, int(h.size()) - 1);
        write_lines(aov, aov.header(), s->specials);
    }
}

void make_file(const exr_tool_spec *s, Out &out)
{
    if (s->parts > 1) {
        make_multipart(s, out);
        return;
    }
    const Header h = make_header(s);
    if (s->tiled) {
        TiledOutputFile file(out, h, 0);
        write_tiles(file, h, s->specials);
    } else {
        OutputFile file(out, h, 0);
        write_lines(file, h, s->specials);
    }
}

// ---- reading ----

bool is_deep(const Header &h) { return h.hasType() && isDeepData(h.type()); }

void read_level(MultiPartInputFile &file, int part, int lx, int ly, Image &im)
{
    const Header &h = file.header(part);
    if (h.hasTileDescription()) {
        TiledInputPart in(file, part);
        make_image(im, h.channels(), in.dataWindowForLevel(lx, ly));
        in.setFrameBuffer(im.frame);
        in.readTiles(0, in.numXTiles(lx) - 1, 0, in.numYTiles(ly) - 1, lx, ly);
    } else {
        InputPart in(file, part);
        make_image(im, h.channels(), h.dataWindow());
        in.setFrameBuffer(im.frame);
        in.readPixels(h.dataWindow().min.y, h.dataWindow().max.y);
    }
}

std::vector<V2i> levels_of(MultiPartInputFile &file, int part)
{
    std::vector<V2i> list;
    const Header &h = file.header(part);
    if (!h.hasTileDescription())
        return { V2i(0, 0) };
    TiledInputPart in(file, part);
    for (int ly = 0; ly < in.numYLevels(); ly++)
        for (int lx = 0; lx < in.numXLevels(); lx++)
            if (h.tileDescription().mode == RIPMAP_LEVELS || lx == ly)
                list.push_back(V2i(lx, ly));
    return list;
}

uint32_t bits_at(const std::vector<char> &d, size_t i, PixelType t, bool as_float)
{
    uint32_t u = 0;
    if (t != HALF) {
        memcpy(&u, d.data() + 4 * i, 4);
        return u;
    }
    uint16_t h;
    memcpy(&h, d.data() + 2 * i, 2);
    if (!as_float)
        return h;
    Imath::half v;
    v.setBits(h);
    const float f = v;
    memcpy(&u, &f, 4);
    return u;
}

struct Text {
    char *to;
    size_t size, used = 0;
    void add(const std::string &line)
    {
        if (used + line.size() + 2 > size)
            return;
        memcpy(to + used, line.data(), line.size());
        used += line.size();
        to[used++] = '\n';
        to[used] = 0;
    }
};

std::string value_of(const Attribute &a)
{
    Out o;
    a.writeValueTo(o, 2);
    return a.typeName() + std::string(":") + std::string(o.bytes.begin(), o.bytes.end());
}

void compare_headers(const Header &a, const Header &b, int part, Text &text)
{
    const std::string where = "part " + std::to_string(part) + " ";
    for (auto i = a.begin(); i != a.end(); ++i) {
        const Attribute *other = nullptr;
        for (auto j = b.begin(); j != b.end(); ++j)
            if (!strcmp(i.name(), j.name()))
                other = &j.attribute();
        if (!other)
            text.add(where + "lost " + i.name());
        else if (value_of(i.attribute()) != value_of(*other))
            text.add(where + "changed " + i.name());
    }
    for (auto j = b.begin(); j != b.end(); ++j)
        if (a.find(j.name()) == a.end())
            text.add(where + "added " + j.name());
}

void compare_level(MultiPartInputFile &a, MultiPartInputFile &b, int part, V2i l,
                   std::vector<exr_tool_diff> &list)
{
    Image ia, ib;
    read_level(a, part, l.x, l.y, ia);
    read_level(b, part, l.x, l.y, ib);
    const ChannelList &ca = a.header(part).channels(), &cb = b.header(part).channels();
    for (auto i = ca.begin(); i != ca.end(); ++i) {
        const Channel *other = cb.findChannel(i.name());
        if (!other)
            throw std::runtime_error(std::string("no channel ") + i.name());
        const PixelType ta = i.channel().type, tb = other->type;
        const std::vector<char> &da = ia.data[i.name()], &db = ib.data[i.name()];
        exr_tool_diff d = {};
        d.part = unsigned(part);
        d.level_x = unsigned(l.x);
        d.level_y = unsigned(l.y);
        snprintf(d.channel, sizeof(d.channel), "%.63s", i.name());
        d.type_a = ta;
        d.type_b = tb;
        d.samples = (da.size() - 8) / (ta == HALF ? 2 : 4);
        if (d.samples != (db.size() - 8) / (tb == HALF ? 2 : 4))
            throw std::runtime_error("another size");
        for (size_t k = 0; k < d.samples; k++)
            d.differing += bits_at(da, k, ta, ta != tb) != bits_at(db, k, tb, ta != tb);
        if (d.differing || ta != tb)
            list.push_back(d);
    }
}

template <class Body> int guarded(Body body)
{
    try {
        return body();
    } catch (const std::exception &e) {
        fprintf(stderr, "exr_tool: %s\n", e.what());
        return -1;
    }
}

} // namespace

int exr_tool_make(const struct exr_tool_spec *spec, uint8_t **bytes, size_t *size)
{
    return guarded([&] {
        Out out;
        make_file(spec, out);
        *size = out.bytes.size();
        *bytes = static_cast<uint8_t *>(malloc(*size));
        memcpy(*bytes, out.bytes.data(), *size);
        return 0;
    });
}

int exr_tool_compare(const uint8_t *a, size_t a_size, const uint8_t *b, size_t b_size,
                     struct exr_tool_diff *diff, int room, char *text, size_t text_size)
{
    return guarded([&] {
        In sa(a, a_size), sb(b, b_size);
        MultiPartInputFile fa(sa, 0, false), fb(sb, 0, false);
        Text t = { text, text_size };
        text[0] = 0;
        std::vector<exr_tool_diff> list;
        if (fa.parts() != fb.parts())
            throw std::runtime_error("another number of parts");
        for (int p = 0; p < fa.parts(); p++) {
            compare_headers(fa.header(p), fb.header(p), p, t);
            if (!fa.partComplete(p) || !fb.partComplete(p))
                throw std::runtime_error("a part is not complete");
            if (is_deep(fa.header(p)))
                continue;
            const std::vector<V2i> la = levels_of(fa, p);
            if (la != levels_of(fb, p))
                throw std::runtime_error("other levels");
            for (const V2i &l : la)
                compare_level(fa, fb, p, l, list);
        }
        for (size_t i = 0; i < list.size() && int(i) < room; i++)
            diff[i] = list[i];
        return int(list.size());
    });
}

int exr_tool_channel(const uint8_t *bytes, size_t size, unsigned part, const char *channel,
                     unsigned level_x, unsigned level_y, uint32_t **bits, unsigned *w, unsigned *h)
{
    return guarded([&] {
        In s(bytes, size);
        MultiPartInputFile f(s, 0, false);
        const Header &header = f.header(int(part));
        const Channel *c = header.channels().findChannel(channel);
        if (!c)
            throw std::runtime_error(std::string("no channel ") + channel);
        Box2i win = header.dataWindow();
        if (header.hasTileDescription())
            win = TiledInputPart(f, int(part)).dataWindowForLevel(int(level_x), int(level_y));
        Image im;
        read_level(f, int(part), int(level_x), int(level_y), im);
        *w = unsigned((win.max.x - win.min.x + 1) / c->xSampling);
        *h = unsigned((win.max.y - win.min.y + 1) / c->ySampling);
        *bits = static_cast<uint32_t *>(malloc(sizeof(uint32_t) * *w * *h + 4));
        for (size_t i = 0; i < size_t(*w) * *h; i++)
            (*bits)[i] = bits_at(im.data[channel], i, c->type, false);
        return 0;
    });
}

int exr_tool_headers(const uint8_t *a, size_t a_size, const uint8_t *b, size_t b_size, char *text,
                     size_t text_size)
{
    return guarded([&] {
        In sa(a, a_size), sb(b, b_size);
        MultiPartInputFile fa(sa, 0, false), fb(sb, 0, false);
        Text t = { text, text_size };
        text[0] = 0;
        if (fa.parts() != fb.parts())
            throw std::runtime_error("another number of parts");
        for (int p = 0; p < fa.parts(); p++) {
            compare_headers(fa.header(p), fb.header(p), p, t);
            if (!fb.partComplete(p))
                throw std::runtime_error("a part is not complete");
        }
        return 0;
    });
}

int exr_tool_window(const uint8_t *bytes, size_t size, unsigned part, int *min_x, int *min_y, int *w, int *h)
{
    return guarded([&] {
        In s(bytes, size);
        MultiPartInputFile f(s, 0, false);
        const Box2i win = f.header(int(part)).dataWindow();
        *min_x = win.min.x;
        *min_y = win.min.y;
        *w = win.max.x - win.min.x + 1;
        *h = win.max.y - win.min.y + 1;
        return 0;
    });
}

int exr_tool_rgb(const uint8_t *bytes, size_t size, const char *layer, float **rgb, unsigned *w, unsigned *h)
{
    return guarded([&] {
        In s(bytes, size);
        RgbaInputFile f(s, layer, 0);
        const Box2i win = f.dataWindow();
        *w = unsigned(win.max.x - win.min.x + 1);
        *h = unsigned(win.max.y - win.min.y + 1);
        std::vector<Rgba> pixels(size_t(*w) * *h);
        f.setFrameBuffer(pixels.data() - win.min.x - ptrdiff_t(win.min.y) * ptrdiff_t(*w), 1, *w);
        f.readPixels(win.min.y, win.max.y);
        *rgb = static_cast<float *>(malloc(sizeof(float) * 3 * pixels.size()));
        for (size_t i = 0; i < pixels.size(); i++) {
            (*rgb)[3 * i] = pixels[i].r;
            (*rgb)[3 * i + 1] = pixels[i].g;
            (*rgb)[3 * i + 2] = pixels[i].b;
        }
        return 0;
    });
}
