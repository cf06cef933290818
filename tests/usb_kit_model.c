// SPDX-License-Identifier: Apache-2.0
//
// usb_kit_model.c - see usb_kit_model.h. Written from the byte tables alone, and strict: what a board would not
// understand counts as bad.
#include "usb_kit_model.h"

#include <errno.h>
#include <lz4.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

static uint32_t u32(const uint8_t *p) { return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24; }

static void put32(uint8_t *p, uint32_t v)
{
    for (unsigned i = 0; i < 4; i++)
        p[i] = (uint8_t)(v >> (8 * i));
}

static void put16(uint8_t *p, uint16_t v)
{
    p[0] = (uint8_t)v;
    p[1] = (uint8_t)(v >> 8);
}

static void frame_came(struct kit_board *b, const uint8_t *first)
{
    b->id[b->frames % KIT_LOG] = first[0] | (uint32_t)first[1] << 8 | (uint32_t)first[2] << 16;
    b->at_ns[b->frames % KIT_LOG] = now_ns();
    b->frames++;
}

// ---- Fadecandy ------------------------------------------------------------------------------------------------

static void fadecandy_packet(struct kit_board *b, const uint8_t *p)
{
    const unsigned type = p[0] & 0xC0, index = p[0] & 0x1F;
    const bool final = p[0] & 0x20;
    if (type == 0x80) {
        memcpy(b->config, p, 64);
        b->configs++;
        return;
    }
    if (type == 0xC0 || index > 24 || final != (index == 24)) {
        b->bad++;
        return;
    }
    memcpy((type ? b->lut : b->frame) + index * 64, p, 64);
    if (final && type)
        b->luts++;
    else if (final)
        frame_came(b, b->frame + 1);
}

static int fadecandy_control(struct kit_board *b, const uint8_t *s, uint8_t *out)
{
    if (s[0] != 0xC0 || s[1] != 1 || s[4] > 1)
        return -EPIPE;
    put32(out, (uint32_t)(s[4] ? b->frames : b->frames * 7));
    return 4;
}

// ---- GUD ------------------------------------------------------------------------------------------------------

void kit_gud_mode(uint8_t out[24], uint16_t width, uint16_t height)
{
    put32(out, 10000);
    const uint16_t t[8] = { width, (uint16_t)(width + 8), (uint16_t)(width + 16), (uint16_t)(width + 24),
                            height, (uint16_t)(height + 2), (uint16_t)(height + 4), (uint16_t)(height + 6) };
    for (unsigned i = 0; i < 8; i++)
        put16(out + 4 + 2 * i, t[i]);
    put32(out + 20, 1 << 10);
}

void kit_gud_defaults(struct kit_board *b)
{
    struct kit_reply *r = b->reply;
    uint8_t *d = r[0x01].data;
    memset(r, 0, KIT_REQUESTS * sizeof(*r));
    put32(d, 0x1d50614d);
    d[4] = 1;
    put32(d + 10, b->width * b->height * 3);
    put32(d + 14, b->width);
    put32(d + 18, b->width);
    put32(d + 22, b->height);
    put32(d + 26, b->height);
    r[0x01].length = 30;
    r[0x40].data[0] = 0x50;
    r[0x40].length = 1;
    r[0x50].length = 5;
    r[0x54].data[0] = 1;
    r[0x54].length = 1;
    kit_gud_mode(r[0x55].data, (uint16_t)b->width, (uint16_t)b->height);
    r[0x55].length = 24;
}

static void note_request(struct kit_board *b, uint8_t request) { b->request[b->requests++ % KIT_LOG] = request; }

static int gud_out(struct kit_board *b, uint8_t request, const uint8_t *data, size_t length)
{
    static const size_t size[] = { [0x60 - 0x60] = 25, [0x62 - 0x60] = 0, [0x63 - 0x60] = 1, [0x64 - 0x60] = 1 };
    if (b->set_stall == request)
        return -EPIPE;
    if (request < 0x60 || request > 0x64 || (request != 0x61 && length != size[request - 0x60]) ||
        (request == 0x61 && (length < 26 || length > sizeof(b->state) || (length - 26) % 10))) {
        b->bad++;
        return -EPIPE;
    }
    switch (request) {
    case 0x60:
        memcpy(b->buffer, data, 25);
        b->buffers++;
        b->named = true;
        break;
    case 0x61:
        memcpy(b->state, data, length);
        b->state_bytes = length;
        b->pixel_bytes = data[24] == 0x50 ? 3 : data[24] == 0x80 ? 4 : 2;
        break;
    case 0x62:
        b->committed = b->state_bytes > 0;
        break;
    case 0x64:
        b->lit = data[0];
        break;
    }
    return (int)length;
}

static int gud_control(struct kit_board *b, const uint8_t *s, const uint8_t *data, size_t length, uint8_t *out)
{
    const uint8_t request = s[1];
    if (s[0] == 0xC1 && request == 0) {
        b->statuses++;
        out[0] = b->set_status;
        return 1;
    }
    note_request(b, request);
    if (s[0] == 0x41)
        return gud_out(b, request, data, length);
    if (s[0] != 0xC1 || request >= KIT_REQUESTS || b->reply[request].stall)
        return -EPIPE;
    memcpy(out, b->reply[request].data, b->reply[request].length);
    return (int)b->reply[request].length;
}

static void put_rows(struct kit_board *b, uint32_t x, uint32_t y, uint32_t w, uint32_t h, const uint8_t *data)
{
    const size_t pitch = (size_t)w * b->pixel_bytes;
    for (uint32_t row = 0; row < h; row++)
        memcpy(b->picture + ((size_t)(y + row) * b->width + x) * b->pixel_bytes, data + row * pitch, pitch);
    if (y + h == b->height)
        frame_came(b, b->picture);
}

// A compressed rectangle must come as it was announced, be shorter than plain, and unpack to exactly its pixels.
static bool unpack(struct kit_board *b, const uint8_t *data, size_t length, uint8_t *out, size_t plain)
{
    const uint8_t *const d = b->reply[0x01].data;
    if (b->buffer[20] != 1 || !(d[9] & 1) || (u32(d + 5) & 2) || u32(b->buffer + 21) != length || length >= plain ||
        LZ4_decompress_safe((const char *)data, (char *)out, (int)length, (int)plain) != (int)plain)
        return false;
    b->compressed++;
    return true;
}

// With FULL_UPDATE and no SET_BUFFER, what comes is the whole picture.
static void gud_bulk(struct kit_board *b, const uint8_t *data, size_t length)
{
    uint32_t x = 0, y = 0, w = b->width, h = b->height;
    note_request(b, 0xff);
    if (b->named) {
        x = u32(b->buffer);
        y = u32(b->buffer + 4);
        w = u32(b->buffer + 8);
        h = u32(b->buffer + 12);
    }
    const bool whole = u32(b->reply[0x01].data + 5) & 2, packed = b->named && b->buffer[20];
    const uint32_t most = u32(b->reply[0x01].data + 10);
    if ((!b->named && !whole) || !b->committed || (uint64_t)x + w > b->width || (uint64_t)y + h > b->height) {
        b->bad++;
        return;
    }
    const size_t plain = (size_t)w * h * b->pixel_bytes;
    uint8_t *const out = packed ? malloc(plain) : NULL;
    if ((most && plain > most) || (b->named && u32(b->buffer + 16) != plain) ||
        (packed ? !out || !unpack(b, data, length, out, plain) : length != plain || (b->named && u32(b->buffer + 21))))
        b->bad++;
    else {
        b->named = false;
        b->bulk_bytes += length;
        put_rows(b, x, y, w, h, packed ? out : data);
    }
    free(out);
}

// ---- both -----------------------------------------------------------------------------------------------------

static int string(const struct kit_board *b, unsigned index, uint8_t *out)
{
    static const uint8_t languages[4] = { 4, 3, 9, 4 };
    const char *const text = index == 1 ? "scanlime" : index == 2 ? "Fadecandy" : index == 3 ? b->serial : NULL;
    if (index == 0) {
        memcpy(out, languages, 4);
        return 4;
    }
    if (!text)
        return -EPIPE;
    const size_t n = strlen(text);
    out[0] = (uint8_t)(2 + 2 * n);
    out[1] = 3;
    for (size_t i = 0; i < n; i++)
        put16(out + 2 + 2 * i, (uint8_t)text[i]);
    return out[0];
}

int kit_control(struct kit_board *b, const uint8_t s[8], const uint8_t *data, size_t length, uint8_t *out, size_t max)
{
    uint8_t reply[KIT_REPLY_MAX];
    const size_t asked = s[6] | (size_t)s[7] << 8;
    int n;
    if (s[0] == 0x80 && s[1] == 6 && s[3] == 3)
        n = string(b, s[2], reply);
    else if (s[0] == 0x80 && s[1] == 8) // GET_CONFIGURATION
        n = (reply[0] = 1);
    else if (s[0] == 0x02 || s[0] == 0x00) // CLEAR_FEATURE and the like
        n = 0;
    else
        n = b->gud ? gud_control(b, s, data, length, reply) : fadecandy_control(b, s, reply);
    if (n < 0 || !(s[0] & 0x80))
        return n;
    const size_t most = asked < max ? asked : max;
    n = (size_t)n < most ? n : (int)most;
    memcpy(out, reply, (size_t)n);
    return n;
}

void kit_bulk(struct kit_board *b, const uint8_t *data, size_t length)
{
    if (b->gud) {
        gud_bulk(b, data, length);
        return;
    }
    b->bad += length % 64 != 0;
    for (size_t at = 0; at + 64 <= length; at += 64)
        fadecandy_packet(b, data + at);
}

void kit_descriptors(const struct kit_board *b, char *hex, size_t size)
{
    snprintf(hex, size, "1201000200000040%02x%02x%02x%02x080101020301%s", b->vendor & 255, b->vendor >> 8, b->product & 255,
             b->product >> 8,
             b->gud ? "0902190001010080320904000001ff00000007050102000200"
                    : "09022b0002010080320904000001ff0000000705010240000009040100" "00fe010104" "09210d1027000401" "01");
}
