// SPDX-License-Identifier: Apache-2.0
// daemon_picture.c - the pictures of daemon_fixture.h. The EXR files are made and read by hand, from the
// format's description, so that nothing here shares a mistake with the codec.
#include <stdlib.h>
#include <string.h>

#include "daemon_fixture.h"

uint16_t half_of(float f) // truncating: the pictures need no more
{
    uint32_t u;
    memcpy(&u, &f, 4);
    int e = (int)(u >> 23 & 255) - 127 + 15;
    if (e <= 0)
        return 0;
    return (uint16_t)((u >> 16 & 0x8000) | (uint32_t)e << 10 | (u >> 13 & 0x3ff));
}

float float_of(uint16_t h)
{
    uint32_t e = h >> 10 & 31, m = h & 0x3ff, u;
    float f;
    if (!e) {
        f = (float)m / 16777216.0f;
        return h & 0x8000 ? -f : f;
    }
    u = (uint32_t)(h & 0x8000) << 16 | (e + 112) << 23 | m << 13;
    memcpy(&f, &u, 4);
    return f;
}

static uint32_t next(uint32_t *s) { return *s = *s * 1664525u + 1013904223u; }

struct picture picture_make(uint32_t width, uint32_t height, float peak, uint32_t seed)
{
    struct picture p = { width, height, NULL };
    p.pixels = malloc(picture_bytes(&p));
    assert_non_null(p.pixels);
    size_t n = (size_t)width * height;
    for (size_t i = 0; i < n * 4; i++)
        p.pixels[i] = half_of((float)(next(&seed) >> 16) / 65536.0f * 0.25f + 0.001f);
    for (int lamp = 0; lamp < 5; lamp++) {
        size_t at = (size_t)(next(&seed) >> 8) % n * 4;
        for (int c = 0; c < 3; c++)
            p.pixels[at + (size_t)c] = half_of(peak / (float)(1 + c));
    }
    return p;
}

void picture_free(struct picture *p) { free(p->pixels); }

size_t picture_bytes(const struct picture *p) { return (size_t)p->width * p->height * 8; }

struct writer {
    uint8_t *at;
};

static void put(struct writer *w, const void *data, size_t n)
{
    memcpy(w->at, data, n);
    w->at += n;
}

static void put_int(struct writer *w, int32_t v) { put(w, &v, 4); }
static void put_text(struct writer *w, const char *s) { put(w, s, strlen(s) + 1); }

static void attribute(struct writer *w, const char *name, const char *type, const void *value, int32_t n)
{
    put_text(w, name);
    put_text(w, type);
    put_int(w, n);
    put(w, value, (size_t)n);
}

static void channels(struct writer *w)
{
    put_text(w, "channels");
    put_text(w, "chlist");
    put_int(w, 4 * 18 + 1);
    for (const char *name = "ABGR"; *name; name++) {
        put(w, (char[]){ *name, 0 }, 2);
        put_int(w, 1); // half
        put_int(w, 0);
        put_int(w, 1);
        put_int(w, 1);
    }
    put(w, "", 1);
}

uint8_t *picture_exr(const struct picture *p, size_t *bytes)
{
    size_t row = (size_t)p->width * 8;
    uint8_t *file = malloc(4096 + p->height * (8 + 8 + row));
    assert_non_null(file);
    struct writer w = { file };
    int32_t window[4] = { 0, 0, (int32_t)p->width - 1, (int32_t)p->height - 1 };
    put(&w, "\x76\x2f\x31\x01\x02\0\0\0", 8);
    channels(&w);
    attribute(&w, "compression", "compression", "\0", 1);
    attribute(&w, "dataWindow", "box2i", window, 16);
    attribute(&w, "displayWindow", "box2i", window, 16);
    attribute(&w, "lineOrder", "lineOrder", "\0", 1);
    attribute(&w, "oddOne", "oddType", "kept", 4);
    attribute(&w, "pixelAspectRatio", "float", (float[]){ 1 }, 4);
    attribute(&w, "screenWindowCenter", "v2f", (float[]){ 0, 0 }, 8);
    attribute(&w, "screenWindowWidth", "float", (float[]){ 1 }, 4);
    put(&w, "", 1);
    uint64_t first = (uint64_t)(w.at - file) + 8 * (uint64_t)p->height;
    for (uint32_t y = 0; y < p->height; y++)
        put(&w, (uint64_t[]){ first + y * (8 + row) }, 8);
    for (uint32_t y = 0; y < p->height; y++) {
        put_int(&w, (int32_t)y);
        put_int(&w, (int32_t)row);
        for (int c = 3; c >= 0; c--)
            for (uint32_t x = 0; x < p->width; x++)
                put(&w, &p->pixels[((size_t)y * p->width + x) * 4 + (size_t)c], 2);
    }
    *bytes = (size_t)(w.at - file);
    return file;
}

// Of the header's attributes only the data window is looked at.
static const uint8_t *skip_header(const uint8_t *at, const uint8_t *end, int32_t window[4])
{
    while (at < end && *at) {
        const char *name = (const char *)at;
        at += strlen(name) + 1;
        at += strlen((const char *)at) + 1;
        int32_t n;
        memcpy(&n, at, 4);
        at += 4;
        if (!strcmp(name, "dataWindow"))
            memcpy(window, at, 16);
        if (!strcmp(name, "compression"))
            assert_int_equal(*at, 0);
        at += n;
    }
    assert_true(at < end);
    return at + 1;
}

struct picture picture_from_exr(const uint8_t *file, size_t bytes)
{
    int32_t window[4] = { 0, 0, -1, -1 };
    assert_memory_equal(file, "\x76\x2f\x31\x01", 4);
    const uint8_t *table = skip_header(file + 8, file + bytes, window);
    struct picture p = { (uint32_t)(window[2] - window[0] + 1), (uint32_t)(window[3] - window[1] + 1), NULL };
    p.pixels = malloc(picture_bytes(&p));
    size_t row = (size_t)p.width * 8;
    for (uint32_t y = 0; y < p.height; y++) {
        uint64_t at;
        int32_t head[2];
        memcpy(&at, table + 8 * (size_t)y, 8);
        assert_true(at + 8 + row <= bytes);
        memcpy(head, file + at, 8);
        assert_int_equal(head[0], window[1] + (int32_t)y);
        assert_int_equal(head[1], row);
        for (int c = 3; c >= 0; c--)
            for (uint32_t x = 0; x < p.width; x++)
                memcpy(&p.pixels[((size_t)y * p.width + x) * 4 + (size_t)c],
                       file + at + 8 + ((size_t)(3 - c) * p.width + x) * 2, 2);
    }
    return p;
}

void picture_request(const struct picture *p, struct airy_request *r)
{
    static const char *const names[] = { "R", "G", "B", "A" };
    r->width = p->width;
    r->height = p->height;
    r->type = AIRY_HALF;
    r->n_channels = 4;
    for (unsigned c = 0; c < 4; c++)
        r->channels[c] = (struct airy_channel){ names[c], c * 2, (uint64_t)p->width * 8, 8 };
}
