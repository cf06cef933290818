// SPDX-License-Identifier: Apache-2.0
/*
 * exr_decode.c - decode tasks: chunks of the parts that have targets, unpacked, their colour rows put into
 * the input planes, and scanned while they are warm.
 *
 * A band is the rows that become complete together (one task's scanlines, or a row of tiles); the task that
 * brings its last chunk scans it. So any order and any threads do, and each row is scanned once.
 */
#include <stdlib.h>
#include <string.h>

#include "exr_internal.h"

enum { TASK_LINES = 16, TASK_TILE_PIXELS = 64 * 1024 };

void exr_row_to_float(float *out, const uint8_t *in, unsigned type, size_t n, uint16_t *scratch)
{
    if (type == PIXEL_TYPE_UINT) { // a number is that number, to the nearest float
        for (size_t i = 0; i < n; i++)
            out[i] = (float)exr_u32(in + 4 * i);
        return;
    }
    if (type == PIXEL_TYPE_FLOAT) {
        memcpy(out, in, 4 * n);
        return;
    }
    if ((uintptr_t)in & 1) { // a raw chunk lies anywhere in the file
        memcpy(scratch, in, 2 * n);
        in = (const uint8_t *)scratch;
    }
    half_to_float(out, (const uint16_t *)(const void *)in, n);
}

void exr_fetch_row(const struct exr_part *p, unsigned channel, uint32_t y, float *out,
                   uint16_t *scratch)
{
    const struct exr_channel *c = &p->channel[channel];
    const bool tiled = p->storage == EXR_TILED;
    const uint32_t across = tiled ? (p->width - 1) / p->tile_width + 1 : 1;
    const uint32_t lines = tiled ? p->tile_height : exr_lines_per_chunk(p->compression);
    for (uint32_t i = 0; i < across; i++) {
        const struct exr_chunk *k = &p->chunk[(uint64_t)(y / lines) * across + i];
        const uint8_t *at = k->pixels + exr_rows_bytes(p, k->width, k->y, y - k->y, false);
        for (unsigned j = 0; j < channel; j++)
            if (y % (uint32_t)p->channel[j].y_sampling == 0)
                at += (size_t)(k->width / (uint32_t)p->channel[j].x_sampling) *
                      pixel_bytes((enum pixel_type)p->channel[j].type);
        exr_row_to_float(out + k->x, at, c->type, k->width / (uint32_t)c->x_sampling, scratch);
    }
}

void exr_gather_row(const struct exr_part *p, int64_t x, int64_t y, uint32_t width, uint8_t *out)
{
    const bool tiled = p->storage == EXR_TILED;
    const uint32_t step = tiled ? p->tile_width : p->width;
    const uint32_t across = (p->width - 1) / step + 1;
    const uint32_t lines = tiled ? p->tile_height : exr_lines_per_chunk(p->compression);
    const int64_t first = x > 0 ? x : 0, end = x + width < p->width ? x + width : p->width;
    memset(out, 0, exr_rows_bytes(p, width, 0, 1, false));
    if (y < 0 || y >= p->height)
        return;
    for (int64_t at = first; at < end;) {
        const struct exr_chunk *k = &p->chunk[(uint64_t)(y / lines) * across + (uint64_t)at / step];
        const size_t n = (size_t)((end < k->x + (int64_t)k->width ? end : k->x + (int64_t)k->width) - at);
        const uint8_t *from = k->pixels + exr_rows_bytes(p, k->width, k->y, (uint32_t)y - k->y, false);
        uint8_t *to = out;
        for (unsigned i = 0; i < p->channels; i++) {
            const size_t bytes = pixel_bytes((enum pixel_type)p->channel[i].type);
            memcpy(to + (size_t)(at - x) * bytes, from + (size_t)(at - k->x) * bytes, n * bytes);
            from += k->width * bytes;
            to += width * bytes;
        }
        at += (int64_t)n;
    }
}

// ---- the plan -----------------------------------------------------------------------------------------------

static int add_task(struct exr *x, unsigned *room, struct exr_task t)
{
    if (x->decode_tasks == *room) {
        *room = *room ? *room * 2 : 256;
        struct exr_task *more = realloc(x->decode_task, *room * sizeof(*more));
        if (!more)
            return -1;
        x->decode_task = more;
    }
    x->decode_task[x->decode_tasks++] = t;
    return 0;
}

static int plan_scanlines(struct exr *x, struct exr_part *p, unsigned *room)
{
    const uint32_t lines = exr_lines_per_chunk(p->compression);
    const uint32_t group = lines < TASK_LINES ? TASK_LINES / lines : 1;
    p->bands = (p->chunks + group - 1) / group;
    p->band = calloc(p->bands, sizeof(*p->band));
    if (!p->band)
        return -1;
    for (uint32_t b = 0; b < p->bands; b++) {
        const uint32_t first = b * group;
        const uint32_t count = p->chunks - first < group ? p->chunks - first : group;
        const struct exr_chunk *last = &p->chunk[first + count - 1];
        p->band[b].row = p->chunk[first].y;
        p->band[b].rows = last->y + last->height - p->band[b].row;
        atomic_init(&p->band[b].left, count);
        if (add_task(x, room, (struct exr_task){ p->index, b, first, count }))
            return -1;
    }
    return 0;
}

static int plan_tiles(struct exr *x, struct exr_part *p, unsigned *room)
{
    const uint32_t across = (p->width - 1) / p->tile_width + 1;
    const uint64_t area = (uint64_t)p->chunk[0].width * p->chunk[0].height;
    const uint32_t group = area < TASK_TILE_PIXELS ? (uint32_t)(TASK_TILE_PIXELS / area) : 1;
    p->bands = p->level0 / across;
    p->band = calloc(p->bands, sizeof(*p->band));
    if (!p->band)
        return -1;
    for (uint32_t b = 0; b < p->bands; b++) {
        p->band[b].row = p->chunk[b * across].y;
        p->band[b].rows = p->chunk[b * across].height;
        atomic_init(&p->band[b].left, across);
        for (uint32_t i = 0; i < across; i += group) {
            const uint32_t count = across - i < group ? across - i : group;
            if (add_task(x, room, (struct exr_task){ p->index, b, b * across + i, count }))
                return -1;
        }
    }
    return 0;
}

int exr_plan_decode(struct exr *x, struct fault *f)
{
    unsigned room = 0;
    for (unsigned i = 0; i < x->parts; i++) {
        struct exr_part *p = &x->part[i];
        if (!p->targets)
            continue;
        atomic_init(&p->chunks_left, p->level0);
        if (p->storage == EXR_TILED ? plan_tiles(x, p, &room) : plan_scanlines(x, p, &room))
            return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the decode plan");
    }
    return 0;
}

// ---- one chunk ------------------------------------------------------------------------------------------------

// The part of row y that the target's planes have.
static void put_row(const struct exr_state *t, unsigned plane, const struct exr_channel *c,
                    const struct exr_chunk *k, uint32_t y, const uint8_t *in, uint16_t *scratch)
{
    const uint32_t first = k->x > t->crop_x ? k->x : t->crop_x;
    const uint32_t end = k->x + k->width < t->crop_x + t->pub.width ? k->x + k->width : t->crop_x + t->pub.width;
    if (y < t->crop_y || y - t->crop_y >= t->pub.height || first >= end)
        return;
    uint8_t *row = planes_row(&t->in, plane, y - t->crop_y) + (size_t)(first - t->crop_x) * pixel_bytes(t->in.type);
    in += (size_t)(first - k->x) * pixel_bytes((enum pixel_type)c->type);
    if (t->in.type == PIXEL_TYPE_HALF)
        memcpy(row, in, 2 * (size_t)(end - first));
    else
        exr_row_to_float((float *)(void *)row, in, c->type, end - first, scratch);
}

static void put_rows(struct exr *x, const struct exr_part *p, const struct exr_chunk *k, uint16_t *scratch)
{
    const uint8_t *at = k->pixels;
    for (uint32_t y = k->y; y < k->y + k->height; y++)
        for (unsigned i = 0; i < p->channels; i++) {
            const struct exr_channel *c = &p->channel[i];
            if (y % (uint32_t)c->y_sampling)
                continue;
            for (uint64_t taps = c->taps; taps; taps &= taps - 1) {
                const unsigned bit = (unsigned)__builtin_ctzll(taps);
                if (!x->target[bit / 4].luma_chroma)
                    put_row(&x->target[bit / 4], bit % 4, c, k, y, at, scratch);
            }
            at += (size_t)(k->width / (uint32_t)c->x_sampling) * pixel_bytes((enum pixel_type)c->type);
        }
}

static void scan_band(struct exr *x, const struct exr_part *p, const struct exr_band *b)
{
    for (unsigned i = 0; i < x->targets; i++) {
        struct exr_state *t = &x->target[i];
        if (t->pub.part != p->index || t->luma_chroma)
            continue;
        for (uint32_t y = b->row; y < b->row + b->rows; y++)
            if (y >= t->crop_y && y - t->crop_y < t->pub.height)
                frame_scan_row(&t->pub.scan, &t->in, y - t->crop_y, t->pub.luma);
    }
}

// Does any target show some of it? (A part with targets that are not cropped: always.)
static bool wanted(const struct exr *x, const struct exr_part *p, const struct exr_chunk *k)
{
    for (unsigned i = 0; i < x->targets; i++) {
        const struct exr_state *t = &x->target[i];
        if (t->pub.part == p->index && k->x < t->crop_x + t->pub.width && k->x + k->width > t->crop_x &&
            k->y < t->crop_y + t->pub.height && k->y + k->height > t->crop_y)
            return true;
    }
    return false;
}

static int finish_chroma(struct exr *x, const struct exr_part *p, struct fault *f)
{
    for (unsigned i = 0; i < x->targets; i++)
        if (x->target[i].pub.part == p->index && x->target[i].luma_chroma &&
            exr_yc_decode(x, &x->target[i], f))
            return -1;
    return 0;
}

unsigned exr_decode_tasks(const struct exr *x) { return x->decode_tasks; }

int exr_decode(struct exr *x, unsigned task, struct exr_worker *w, struct fault *f)
{
    const struct exr_task *t = &x->decode_task[task];
    struct exr_part *p = &x->part[t->part];
    uint16_t *scratch = exr_scratch(w, EXR_SCRATCH_ROW, 4 * (uint64_t)p->width);
    if (!scratch)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for a row");
    for (uint32_t i = t->first; i < t->first + t->count; i++) {
        if (!wanted(x, p, &p->chunk[i]))
            continue;
        if (exr_decode_chunk(x, p, &p->chunk[i], w, f))
            return -1;
        put_rows(x, p, &p->chunk[i], scratch);
    }
    struct exr_band *b = &p->band[t->band];
    if (atomic_fetch_sub_explicit(&b->left, t->count, memory_order_acq_rel) == t->count)
        scan_band(x, p, b);
    if (atomic_fetch_sub_explicit(&p->chunks_left, t->count, memory_order_acq_rel) == t->count)
        return finish_chroma(x, p, f);
    return 0;
}
