// SPDX-License-Identifier: Apache-2.0
// raw.c - see raw.h. Bands of about a quarter MiB: enough work for a task, small enough for the caches.
#include "raw.h"

#include <assert.h>
#include <stdio.h>
#include <string.h>

enum { RAW_BAND_BYTES = 256 * 1024, RAW_CHUNK_PIXELS = 1024 };

// Bytes from a row's first pixel to the end of its last.
static uint64_t row_span(const struct raw_layout *l, const struct raw_channel *c)
{
    return (l->width - 1) * c->pixel_stride + pixel_bytes(l->type);
}

static int channel_check(const struct raw_layout *l, const struct raw_channel *c, uint64_t payload_bytes,
                         struct fault *f)
{
    unsigned bytes = pixel_bytes(l->type);
    if (!c->name[0])
        return fault_set(f, FAULT_LAYOUT, "raw.channels.name", "a channel has no name");
    if (c->offset % bytes || c->row_stride % bytes || c->pixel_stride % bytes)
        return fault_set(f, FAULT_LAYOUT, "raw.channels",
                         "channel %.60s: offset %llu, row stride %llu, pixel stride %llu; expected multiples "
                         "of the pixel's %u bytes",
                         c->name, (unsigned long long)c->offset, (unsigned long long)c->row_stride,
                         (unsigned long long)c->pixel_stride, bytes);
    if (c->pixel_stride > UINT32_MAX || (c->pixel_stride < bytes && l->width > 1))
        return fault_set(f, FAULT_LAYOUT, "raw.channels.pixel_stride",
                         "channel %.60s: pixel stride %llu; expected %u to 2^32 - 1", c->name,
                         (unsigned long long)c->pixel_stride, bytes);
    uint64_t span = row_span(l, c); // < 2^32 * 2^32
    if (c->row_stride < span && l->height > 1)
        return fault_set(f, FAULT_LAYOUT, "raw.channels.row_stride",
                         "channel %.60s: row stride %llu; expected at least the row's %llu bytes", c->name,
                         (unsigned long long)c->row_stride, (unsigned long long)span);
    uint64_t end;
    if (__builtin_mul_overflow(c->row_stride, (uint64_t)(l->height - 1), &end) ||
        __builtin_add_overflow(end, span, &end) || __builtin_add_overflow(end, c->offset, &end) ||
        end > payload_bytes)
        return fault_set(f, FAULT_LAYOUT, "raw.channels.offset",
                         "channel %.60s: its last byte is outside the payload of %llu bytes (offset %llu, row "
                         "stride %llu, %u rows of %llu bytes)",
                         c->name, (unsigned long long)payload_bytes, (unsigned long long)c->offset,
                         (unsigned long long)c->row_stride, l->height, (unsigned long long)span);
    return 0;
}

static uint64_t channel_end(const struct raw_layout *l, const struct raw_channel *c)
{
    return c->offset + c->row_stride * (l->height - 1) + row_span(l, c);
}

// Proves that two channels share no byte, for the arrangements that exist: apart (planar), row beside
// row, pixel beside pixel. Two grids that are disjoint in some odder way are refused as well.
static bool channels_apart(const struct raw_layout *l, const struct raw_channel *a,
                           const struct raw_channel *b)
{
    if (a->offset > b->offset) {
        const struct raw_channel *swap = a;
        a = b;
        b = swap;
    }
    if (channel_end(l, a) <= b->offset)
        return true;
    unsigned bytes = pixel_bytes(l->type);
    bool one_row = l->height == 1, one_column = l->width == 1;
    if ((!one_row && a->row_stride != b->row_stride) || (!one_column && a->pixel_stride != b->pixel_stride))
        return false;
    // Distance within a row; with one row there is nothing to wrap into.
    uint64_t distance = b->offset - a->offset, span = row_span(l, a);
    uint64_t shift = one_row ? distance : distance % a->row_stride;
    bool wraps = !one_row && shift + span > a->row_stride;
    if (shift >= span && !wraps)
        return true;
    if (one_column)
        return false;
    uint64_t phase = shift % a->pixel_stride;
    return phase >= bytes && phase + bytes <= a->pixel_stride &&
           (!wraps || a->row_stride % a->pixel_stride == 0);
}

static int overlap_check(const struct raw_layout *l, struct fault *f)
{
    for (unsigned i = 0; i < l->count; i++)
        for (unsigned k = 0; k < i; k++) {
            const struct raw_channel *a = &l->channel[k], *b = &l->channel[i];
            if (!strcmp(a->name, b->name))
                return fault_set(f, FAULT_LAYOUT, "raw.channels.name", "two channels are named %.60s",
                                 a->name);
            if (!channels_apart(l, a, b))
                return fault_set(f, FAULT_LAYOUT, "raw.channels",
                                 "channels %.60s and %.60s overlap (offsets %llu and %llu); expected bytes of "
                                 "their own",
                                 a->name, b->name, (unsigned long long)a->offset,
                                 (unsigned long long)b->offset);
        }
    return 0;
}

static int channel_find(const struct raw_layout *l, const char *name)
{
    for (unsigned i = 0; i < l->count; i++)
        if (!strcmp(l->channel[i].name, name))
            return (int)i;
    return -1;
}

static struct raw_target *target_add(struct raw_layout *l, enum raw_role role, unsigned planes)
{
    struct raw_target *t = &l->target[l->targets++];
    *t = (struct raw_target){ .role = role, .planes = planes, .type = l->type };
    return t;
}

static int scene_choose(struct raw_layout *l, struct fault *f)
{
    int r = channel_find(l, "R"), g = channel_find(l, "G"), b = channel_find(l, "B");
    int y = channel_find(l, "Y");
    if (r >= 0 && g >= 0 && b >= 0) {
        struct raw_target *t = target_add(l, RAW_SCENE, 3);
        t->plane[0] = (unsigned)r;
        t->plane[1] = (unsigned)g;
        t->plane[2] = (unsigned)b;
        return 0;
    }
    if (y < 0 || r >= 0 || g >= 0 || b >= 0)
        return fault_set(f, FAULT_LAYOUT, "raw.channels",
                         "%u channels, R %s, G %s, B %s, Y %s; expected R, G and B, or Y without them", l->count,
                         r < 0 ? "absent" : "there", g < 0 ? "absent" : "there", b < 0 ? "absent" : "there",
                         y < 0 ? "absent" : "there");
    target_add(l, RAW_SCENE, 1)->plane[0] = (unsigned)y;
    return 0;
}

static int source_choose(struct raw_layout *l, struct fault *f)
{
    unsigned planes = l->target[0].planes;
    const char *letters = planes == 3 ? "RGB" : "Y";
    if (!l->source || !*l->source)
        return 0;
    struct raw_target *t = target_add(l, RAW_SOURCE, planes);
    for (unsigned i = 0; i < planes; i++) {
        char name[RAW_NAME_MAX + 2];
        int n = snprintf(name, sizeof name, "%s.%c", l->source, letters[i]);
        int found = n < (int)sizeof name ? channel_find(l, name) : -1;
        if (found < 0)
            return fault_set(f, FAULT_LAYOUT, "params.source",
                             "no channel %.80s.%c in the picture; expected the source's channels %s beside the "
                             "picture's own",
                             l->source, letters[i], letters);
        t->plane[i] = (unsigned)found;
    }
    return 0;
}

static int targets_choose(struct raw_layout *l, struct fault *f)
{
    l->targets = 0;
    if (scene_choose(l, f) < 0 || source_choose(l, f) < 0)
        return -1;
    if (l->matte && *l->matte) {
        int found = channel_find(l, l->matte);
        if (found < 0)
            return fault_set(f, FAULT_LAYOUT, "params.matte", "no channel %.80s in the picture", l->matte);
        target_add(l, RAW_MATTE, 1)->plane[0] = (unsigned)found;
    }
    int z = l->depth ? channel_find(l, "Z") : -1;
    if (z >= 0) {
        struct raw_target *t = target_add(l, RAW_DEPTH, 1);
        t->plane[0] = (unsigned)z;
        t->type = PIXEL_TYPE_FLOAT;
    }
    return 0;
}

int raw_check(struct raw_layout *l, uint64_t payload_bytes, struct fault *f)
{
    if (!l->width || !l->height)
        return fault_set(f, FAULT_LAYOUT, l->width ? "raw.height" : "raw.width",
                         "%u x %u pixels; expected at least 1 x 1", l->width, l->height);
    if (l->type != PIXEL_TYPE_HALF && l->type != PIXEL_TYPE_FLOAT)
        return fault_set(f, FAULT_LAYOUT, "raw.type", "pixel type %d; expected 1 (half) or 2 (float)",
                         (int)l->type);
    for (unsigned i = 0; i < l->count; i++)
        if (channel_check(l, &l->channel[i], payload_bytes, f) < 0)
            return -1;
    if (overlap_check(l, f) < 0 || targets_choose(l, f) < 0)
        return -1;
    uint64_t row_bytes = (uint64_t)l->width * pixel_bytes(l->type) * l->count;
    l->dense = row_bytes * l->height == payload_bytes;
    uint64_t band = RAW_BAND_BYTES / row_bytes;
    l->band = band < 1 ? 1 : band > l->height ? l->height : (uint32_t)band;
    return 0;
}

unsigned raw_tasks(const struct raw_layout *l) { return (l->height - 1) / l->band + 1; }

static void gather(uint8_t *restrict out, const uint8_t *in, size_t stride, size_t n, unsigned bytes)
{
    if (stride == bytes) {
        memcpy(out, in, n * bytes);
    } else if (bytes == 2) {
        for (size_t i = 0; i < n; i++)
            memcpy(out + 2 * i, in + i * stride, 2);
    } else {
        for (size_t i = 0; i < n; i++)
            memcpy(out + 4 * i, in + i * stride, 4);
    }
}

static void scatter(uint8_t *out, const uint8_t *in, size_t stride, size_t n, unsigned bytes)
{
    if (stride == bytes) {
        memcpy(out, in, n * bytes);
    } else if (bytes == 2) {
        for (size_t i = 0; i < n; i++)
            memcpy(out + i * stride, in + 2 * i, 2);
    } else {
        for (size_t i = 0; i < n; i++)
            memcpy(out + i * stride, in + 4 * i, 4);
    }
}

static uint64_t row_offset(const struct raw_channel *c, uint32_t y) { return c->offset + c->row_stride * y; }

// Halves as the floats of a wider plane.
static void gather_wide(uint8_t *out, const uint8_t *in, size_t stride, size_t n)
{
    for (size_t i = 0; i < n; i += RAW_CHUNK_PIXELS) {
        size_t m = n - i < RAW_CHUNK_PIXELS ? n - i : RAW_CHUNK_PIXELS;
        uint16_t half[RAW_CHUNK_PIXELS];
        gather((uint8_t *)half, in + i * stride, stride, m, 2);
        half_to_float((float *)(void *)(out + 4 * i), half, m);
    }
}

void raw_decode(const struct raw_layout *l, const struct raw_target *t, const uint8_t *payload,
                const struct planes *in, struct frame_scan *scan, const float luma[3], unsigned task)
{
    assert(in->type == t->type && in->count == t->planes);
    uint32_t y0 = task * l->band, y1 = l->height - y0 < l->band ? l->height : y0 + l->band;
    for (uint32_t y = y0; y < y1; y++) {
        for (unsigned p = 0; p < t->planes; p++) {
            const struct raw_channel *c = &l->channel[t->plane[p]];
            const uint8_t *from = payload + row_offset(c, y);
            if (t->type == l->type)
                gather(planes_row(in, p, y), from, c->pixel_stride, l->width, pixel_bytes(l->type));
            else
                gather_wide(planes_row(in, p, y), from, c->pixel_stride, l->width);
        }
        if (scan)
            frame_scan_row(scan, in, y, luma);
    }
}

static uint64_t scatter_half(uint8_t *out, const uint8_t *in, size_t stride, size_t n)
{
    uint64_t held = 0;
    for (size_t i = 0; i < n; i += RAW_CHUNK_PIXELS) {
        size_t m = n - i < RAW_CHUNK_PIXELS ? n - i : RAW_CHUNK_PIXELS;
        uint16_t half[RAW_CHUNK_PIXELS];
        held += float_to_half(half, (const float *)(const void *)(in + 4 * i), m);
        scatter(out + i * stride, (const uint8_t *)half, stride, m, 2);
    }
    return held;
}

static bool is_plane(const struct raw_layout *l, unsigned channel)
{
    const struct raw_target *scene = &l->target[0];
    for (unsigned p = 0; p < scene->planes; p++)
        if (scene->plane[p] == channel)
            return true;
    return false;
}

static void copy_channel(const struct raw_layout *l, const struct raw_channel *c, const uint8_t *input,
                         uint8_t *output)
{
    unsigned bytes = pixel_bytes(l->type);
    if (c->pixel_stride == bytes) {
        memmove(output, input, (size_t)l->width * bytes);
        return;
    }
    for (uint32_t x = 0; x < l->width; x++)
        memmove(output + x * c->pixel_stride, input + x * c->pixel_stride, bytes);
}

uint64_t raw_encode(const struct raw_layout *l, const uint8_t *input, const struct planes *from,
                    uint8_t *output, unsigned task)
{
    const struct raw_target *scene = &l->target[0];
    unsigned bytes = pixel_bytes(l->type);
    uint64_t held = 0;
    uint32_t y0 = task * l->band, y1 = l->height - y0 < l->band ? l->height : y0 + l->band;
    for (uint32_t y = y0; y < y1; y++) {
        for (unsigned p = 0; p < scene->planes; p++) {
            const struct raw_channel *c = &l->channel[scene->plane[p]];
            uint8_t *out = output + row_offset(c, y);
            if (from->type == l->type) // else FLOAT, wider than a HALF layout
                scatter(out, planes_row(from, p, y), c->pixel_stride, l->width, bytes);
            else
                held += scatter_half(out, planes_row(from, p, y), c->pixel_stride, l->width);
        }
        for (unsigned i = 0; i < l->count; i++)
            if (!is_plane(l, i)) {
                uint64_t at = row_offset(&l->channel[i], y);
                copy_channel(l, &l->channel[i], input + at, output + at);
            }
    }
    return held;
}
