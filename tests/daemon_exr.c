// SPDX-License-Identifier: Apache-2.0
// daemon_exr.c - see daemon_exr.h.
#include "daemon_exr.h"

#include <stdlib.h>
#include <string.h>

#include "exr_tool.h"
#include "frame.h"

// Written twice: first to nowhere, for the size.
struct writer {
    uint8_t *base;
    size_t used;
};

static void put(struct writer *w, const void *data, size_t n)
{
    if (w->base)
        memcpy(w->base + w->used, data, n);
    w->used += n;
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

static void channels(struct writer *w, const struct exr_file *f)
{
    int32_t n = 1;
    for (unsigned i = 0; i < f->planes; i++)
        n += (int32_t)strlen(f->plane[i].name) + 1 + 16;
    put_text(w, "channels");
    put_text(w, "chlist");
    put_int(w, n);
    for (unsigned i = 0; i < f->planes; i++) {
        put_text(w, f->plane[i].name);
        put_int(w, f->half ? PIXEL_TYPE_HALF : PIXEL_TYPE_FLOAT);
        put_int(w, 0);
        put_int(w, 1);
        put_int(w, 1);
    }
    put(w, "", 1);
}

static void header(struct writer *w, const struct exr_file *f)
{
    const int32_t window[4] = { f->min_x, f->min_y, f->min_x + (int32_t)f->width - 1, f->min_y + (int32_t)f->height - 1 };
    const int32_t display[4] = { 0, 0, (int32_t)f->display_width - 1, (int32_t)f->display_height - 1 };
    put(w, "\x76\x2f\x31\x01\x02\0\0\0", 8);
    channels(w, f);
    attribute(w, "compression", "compression", "\0", 1);
    attribute(w, "dataWindow", "box2i", window, 16);
    attribute(w, "displayWindow", "box2i", display, 16);
    attribute(w, "lineOrder", "lineOrder", "\0", 1);
    attribute(w, "pixelAspectRatio", "float", &f->aspect, 4);
    attribute(w, "screenWindowCenter", "v2f", (float[]){ 0, 0 }, 8);
    attribute(w, "screenWindowWidth", "float", (float[]){ 1 }, 4);
    put(w, "", 1);
}

static void sample(struct writer *w, bool half, double value)
{
    const float v = (float)value;
    uint16_t h;
    if (!half) {
        put(w, &v, 4);
        return;
    }
    float_to_half(&h, &v, 1);
    put(w, &h, 2);
}

static void write_file(struct writer *w, const struct exr_file *f)
{
    const size_t row = (size_t)f->width * f->planes * (f->half ? 2 : 4);
    header(w, f);
    const uint64_t first = w->used + 8 * (uint64_t)f->height;
    for (uint32_t y = 0; y < f->height; y++)
        put(w, (uint64_t[]){ first + y * (8 + row) }, 8);
    for (uint32_t y = 0; y < f->height; y++) {
        put_int(w, f->min_y + (int32_t)y);
        put_int(w, (int32_t)row);
        for (unsigned i = 0; i < f->planes; i++)
            for (uint32_t x = 0; x < f->width; x++)
                sample(w, f->half, f->plane[i].value[(size_t)y * f->width + x]);
    }
}

uint8_t *exr_file_make(const struct exr_file *f, size_t *bytes)
{
    struct writer w = { NULL, 0 };
    write_file(&w, f);
    w = (struct writer){ malloc(w.used), 0 };
    if (!w.base)
        abort();
    write_file(&w, f);
    *bytes = w.used;
    return w.base;
}

static double value_of(uint32_t bits, bool half)
{
    const uint16_t h = (uint16_t)bits;
    float v;
    if (half)
        half_to_float(&v, &h, 1);
    else
        memcpy(&v, &bits, 4);
    return v;
}

double *exr_file_plane(const uint8_t *file, size_t bytes, const char *name, bool half, uint32_t *width, uint32_t *height)
{
    uint32_t *bits;
    if (exr_tool_channel(file, bytes, 0, name, 0, 0, &bits, width, height) < 0)
        return NULL;
    const size_t n = (size_t)*width * *height;
    double *out = malloc(n * sizeof *out);
    if (!out)
        abort();
    for (size_t i = 0; i < n; i++)
        out[i] = value_of(bits[i], half);
    free(bits);
    return out;
}
