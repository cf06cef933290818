// SPDX-License-Identifier: Apache-2.0
/*
 * exr_chunk.c - where every chunk of every part is, and that the file agrees.
 *
 * Invariant: after exr_read_tables, each chunk's bytes lie inside the file, behind the offset tables, and
 * no two chunks share a byte; its leader says the coordinates that its place in the table demands. So
 * a small file cannot name one chunk many times, and copying chunks copies no byte twice.
 */
#include <stdlib.h>
#include <string.h>

#include "exr_internal.h"

unsigned exr_lines_per_chunk(int compression)
{
    switch (compression) {
    case EXR_ZIP:
    case EXR_PXR24:
        return 16;
    case EXR_PIZ:
    case EXR_B44:
    case EXR_B44A:
    case EXR_DWAA:
        return 32;
    case EXR_DWAB:
        return 256;
    default:
        return 1;
    }
}

uint32_t exr_level_size(uint32_t size, unsigned level, bool round_up)
{
    uint64_t s = size;
    if (round_up)
        s += (UINT64_C(1) << level) - 1;
    s >>= level;
    return s ? (uint32_t)s : 1;
}

static unsigned level_count(uint32_t size, bool round_up)
{
    unsigned n = 1;
    for (uint64_t s = size; s > 1; s = round_up ? (s + 1) / 2 : s / 2)
        n++;
    return n;
}

uint64_t exr_rows_bytes(const struct exr_part *p, uint32_t width, uint32_t y, uint32_t rows, bool out)
{
    const struct exr_channel *list = out ? p->out_channel : p->channel;
    const unsigned n = out ? p->out_channels : p->channels;
    uint64_t bytes = 0;
    for (unsigned i = 0; i < n; i++) {
        const struct exr_channel *c = &list[i];
        bytes += (uint64_t)(width / (uint32_t)c->x_sampling) *
                 exr_sampled(y, rows, (uint32_t)c->y_sampling) *
                 pixel_bytes(out ? c->out_type : c->type);
    }
    return bytes;
}

// ---- planning ---------------------------------------------------------------------------------------

static bool is_tiled(const struct exr_part *p)
{
    return p->storage == EXR_TILED || p->storage == EXR_DEEP_TILED;
}

static bool is_deep(const struct exr_part *p)
{
    return p->storage == EXR_DEEP_SCANLINE || p->storage == EXR_DEEP_TILED;
}

static uint64_t ceil_div(uint64_t a, uint64_t b)
{
    return (a + b - 1) / b;
}

static uint64_t tiles_of_level(const struct exr_part *p, unsigned lx, unsigned ly)
{
    return ceil_div(exr_level_size(p->width, lx, p->round_up), p->tile_width) *
           ceil_div(exr_level_size(p->height, ly, p->round_up), p->tile_height);
}

static bool level_exists(const struct exr_part *p, unsigned lx, unsigned ly)
{
    return p->level_mode == 2 || lx == ly;
}

static uint64_t count_chunks(struct exr_part *p)
{
    if (!is_tiled(p))
        return ceil_div(p->height, exr_lines_per_chunk(p->compression));
    const uint32_t larger = p->width > p->height ? p->width : p->height;
    p->levels_x = p->levels_y = 1;
    if (p->level_mode == 1)
        p->levels_x = p->levels_y = level_count(larger, p->round_up);
    if (p->level_mode == 2) {
        p->levels_x = level_count(p->width, p->round_up);
        p->levels_y = level_count(p->height, p->round_up);
    }
    uint64_t n = 0; // at most 32 * 32 levels of 2^62 / 1: each is bounded by the part's area
    for (unsigned ly = 0; ly < p->levels_y; ly++)
        for (unsigned lx = 0; lx < p->levels_x; lx++)
            if (level_exists(p, lx, ly))
                n += tiles_of_level(p, lx, ly);
    return n;
}

static int check_limits(const struct exr *x, const struct exr_part *p, struct fault *f)
{
    const struct exr_limits *l = &x->limits;
    char title[96];
    if (p->width > l->max_width || p->height > l->max_height)
        return fault_set(f, FAULT_EXR_TOO_LARGE, "input", "%s is %u x %u pixels; at most %u x %u are taken",
                         exr_part_title(p, title), p->width, p->height, l->max_width, l->max_height);
    const uint64_t area = (uint64_t)p->width * p->height;
    if (area > l->max_pixels)
        return fault_set(f, FAULT_EXR_TOO_LARGE, "input", "%s has %llu pixels; at most %llu are taken",
                         exr_part_title(p, title), (unsigned long long)area,
                         (unsigned long long)l->max_pixels);
    return 0;
}

static int place_chunk(const struct exr_part *p, struct exr_chunk *k, uint32_t level_w, uint32_t level_h,
                       uint32_t step_w, uint32_t step_h, struct fault *f)
{
    char title[96];
    k->x = k->tile_x * step_w;
    k->width = level_w - k->x < step_w ? level_w - k->x : step_w;
    k->height = level_h - k->y < step_h ? level_h - k->y : step_h;
    if (is_deep(p))
        return 0;
    k->unpacked_bytes = exr_rows_bytes(p, k->width, k->y, k->height, false);
    if (k->unpacked_bytes > INT32_MAX)
        return fault_set(f, FAULT_EXR_TOO_LARGE, "input",
                         "a chunk of %s holds %llu bytes; at most %d are possible",
                         exr_part_title(p, title), (unsigned long long)k->unpacked_bytes, INT32_MAX);
    return 0;
}

static int fill_tiles(struct exr_part *p, unsigned lx, unsigned ly, struct exr_chunk **at, struct fault *f)
{
    const uint32_t w = exr_level_size(p->width, lx, p->round_up);
    const uint32_t h = exr_level_size(p->height, ly, p->round_up);
    const uint32_t nx = (uint32_t)ceil_div(w, p->tile_width);
    const uint32_t ny = (uint32_t)ceil_div(h, p->tile_height);
    for (uint32_t ty = 0; ty < ny; ty++)
        for (uint32_t tx = 0; tx < nx; tx++) {
            struct exr_chunk *k = (*at)++;
            *k = (struct exr_chunk){ .tile_x = tx, .tile_y = ty, .level_x = (uint8_t)lx,
                                     .level_y = (uint8_t)ly, .y = ty * p->tile_height };
            if (place_chunk(p, k, w, h, p->tile_width, p->tile_height, f))
                return -1;
        }
    return 0;
}

static int fill_scanlines(struct exr_part *p, struct fault *f)
{
    const uint32_t lines = exr_lines_per_chunk(p->compression);
    for (uint32_t i = 0; i < p->chunks; i++) {
        p->chunk[i] = (struct exr_chunk){ .y = i * lines };
        if (place_chunk(p, &p->chunk[i], p->width, p->height, p->width, lines, f))
            return -1;
    }
    p->level0 = p->chunks;
    return 0;
}

int exr_plan_chunks(struct exr *x, struct exr_part *p, struct fault *f)
{
    char title[96];
    if (check_limits(x, p, f))
        return -1;
    const uint64_t n = count_chunks(p);
    if (p->chunk_count_attr >= 0 && (x->multipart || is_deep(p)) && (uint64_t)p->chunk_count_attr != n)
        return fault_set(f, FAULT_EXR_DAMAGED, "input",
                         "chunkCount of %s is %lld; its window and compression make %llu",
                         exr_part_title(p, title), (long long)p->chunk_count_attr, (unsigned long long)n);
    // Each chunk takes 8 bytes of table and a leader: so the list is never much larger than the file.
    if (n > x->size / (8 + exr_leader_bytes(x, p)))
        return fault_set(f, FAULT_EXR_DAMAGED, "input",
                         "%s has %llu chunks, more than the file's %llu bytes can hold: truncated or "
                         "damaged", exr_part_title(p, title), (unsigned long long)n,
                         (unsigned long long)x->size);
    p->chunk = calloc(n, sizeof(*p->chunk));
    if (!p->chunk)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for %llu chunks", (unsigned long long)n);
    p->chunks = (uint32_t)n;
    if (!is_tiled(p))
        return fill_scanlines(p, f);
    struct exr_chunk *at = p->chunk;
    for (unsigned ly = 0; ly < p->levels_y; ly++)
        for (unsigned lx = 0; lx < p->levels_x; lx++) {
            if (level_exists(p, lx, ly) && fill_tiles(p, lx, ly, &at, f))
                return -1;
            if (!lx && !ly)
                p->level0 = (uint32_t)(at - p->chunk);
        }
    return 0;
}

struct exr_chunk *exr_scanline_chunk(struct exr_part *p, uint32_t y)
{
    return &p->chunk[y / exr_lines_per_chunk(p->compression)];
}

// ---- the tables and leaders of the file ---------------------------------------------------------------

unsigned exr_leader_bytes(const struct exr *x, const struct exr_part *p)
{
    return (x->multipart ? 4 : 0) + (is_tiled(p) ? 16 : 4) + (is_deep(p) ? 24 : 4);
}

static int bad_chunk(const struct exr_part *p, uint32_t i, struct fault *f, const char *what,
                     uint64_t found)
{
    char title[96];
    return fault_set(f, FAULT_EXR_DAMAGED, "input", "chunk %u of %s %s (%llu)", i,
                     exr_part_title(p, title), what, (unsigned long long)found);
}

static int check_coordinates(const struct exr_part *p, uint32_t i, const uint8_t *at, struct fault *f)
{
    const struct exr_chunk *k = &p->chunk[i];
    if (!is_tiled(p)) {
        int32_t y = (int32_t)exr_u32(at);
        if ((int64_t)y != (int64_t)p->min_y + k->y)
            return bad_chunk(p, i, f, "says another scanline than its place in the table", (uint32_t)y);
        return 0;
    }
    if (exr_u32(at) != k->tile_x || exr_u32(at + 4) != k->tile_y || exr_u32(at + 8) != k->level_x ||
        exr_u32(at + 12) != k->level_y)
        return bad_chunk(p, i, f, "says another tile than its place in the table", exr_u32(at));
    return 0;
}

static int read_leader(const struct exr *x, const struct exr_part *p, uint32_t i, uint64_t first,
                       struct fault *f)
{
    struct exr_chunk *k = &p->chunk[i];
    const unsigned leader = exr_leader_bytes(x, p);
    if (!k->at)
        return bad_chunk(p, i, f, "has no offset: the file was not written to its end", 0);
    if (k->at < first || k->at > x->size || x->size - k->at < leader)
        return bad_chunk(p, i, f, "has an offset outside the file's chunks", k->at);
    const uint8_t *at = x->bytes + k->at;
    const uint64_t room = x->size - k->at - leader;
    if (x->multipart) {
        if (exr_u32(at) != p->index)
            return bad_chunk(p, i, f, "says that it is of another part", exr_u32(at));
        at += 4;
    }
    if (check_coordinates(p, i, at, f))
        return -1;
    at += is_tiled(p) ? 16 : 4;
    if (is_deep(p)) {
        uint64_t counts = exr_u64(at), data = exr_u64(at + 8);
        if (counts > room || data > room - counts)
            return bad_chunk(p, i, f, "is longer than the file", data);
        k->packed_bytes = counts + data;
    } else {
        k->packed_bytes = exr_u32(at);
        if (k->packed_bytes > room)
            return bad_chunk(p, i, f, "is longer than the file", k->packed_bytes);
        if (k->packed_bytes > k->unpacked_bytes)
            return bad_chunk(p, i, f, "is larger than its pixels", k->packed_bytes);
        if (!k->packed_bytes && k->unpacked_bytes)
            return bad_chunk(p, i, f, "is empty", 0);
    }
    k->packed_at = k->at + leader;
    k->bytes = leader + k->packed_bytes;
    return 0;
}

struct span {
    uint64_t at, bytes;
};

static int span_order(const void *a, const void *b)
{
    const struct span *l = a, *r = b;
    return l->at < r->at ? -1 : l->at > r->at;
}

static int check_overlap(const struct exr *x, uint64_t chunks, struct fault *f)
{
    struct span *s = malloc(chunks * sizeof(*s));
    if (!s)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for %llu chunks", (unsigned long long)chunks);
    uint64_t n = 0;
    bool sorted = true;
    for (unsigned i = 0; i < x->parts; i++)
        for (uint32_t k = 0; k < x->part[i].chunks; k++) {
            s[n] = (struct span){ x->part[i].chunk[k].at, x->part[i].chunk[k].bytes };
            sorted &= !n || s[n - 1].at < s[n].at;
            n++;
        }
    if (!sorted)
        qsort(s, n, sizeof(*s), span_order);
    int result = 0;
    for (uint64_t i = 1; i < n && !result; i++)
        if (s[i].at - s[i - 1].at < s[i - 1].bytes)
            result = fault_set(f, FAULT_EXR_DAMAGED, "input",
                               "two chunks overlap at byte %llu of the file", (unsigned long long)s[i].at);
    free(s);
    return result;
}

int exr_read_tables(struct exr *x, uint64_t tables, struct fault *f)
{
    uint64_t chunks = 0;
    for (unsigned i = 0; i < x->parts; i++)
        chunks += x->part[i].chunks;
    if (chunks > (x->size - tables) / 8)
        return fault_set(f, FAULT_EXR_DAMAGED, "input",
                         "the file ends inside its offset tables (%llu chunks): truncated",
                         (unsigned long long)chunks);
    const uint8_t *at = x->bytes + tables;
    const uint64_t first = tables + 8 * chunks;
    for (unsigned i = 0; i < x->parts; i++)
        for (uint32_t k = 0; k < x->part[i].chunks; k++, at += 8)
            x->part[i].chunk[k].at = exr_u64(at);
    for (unsigned i = 0; i < x->parts; i++)
        for (uint32_t k = 0; k < x->part[i].chunks; k++)
            if (read_leader(x, &x->part[i], k, first, f))
                return -1;
    return check_overlap(x, chunks, f);
}
