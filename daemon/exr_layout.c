// SPDX-License-Identifier: Apache-2.0
/*
 * exr_layout.c - what the output has otherwise than the input: types of channels, extra layers, a grown data
 * window, and the chunks that follow from them.
 *
 * Invariant: what the options ask for is refused here before anything is made of it; after that the encoder's
 * sizes all come from these lists. A part that grows or gets layers has no chunk of the input in it, so its
 * size is held to the limit of decoded bytes: a small file cannot ask for a large one.
 */
#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "exr_internal.h"

enum { NAME_BYTES = 256 }; // of a channel, with its NUL

static const char *added_field(const struct exr_part *p)
{
    return p->grow ? "params.grow" : p->extended ? "params.layers" : "compression";
}

// The pixels of all parts that are made anew.
static int check_bytes(const struct exr *x, const char *field, struct fault *f)
{
    uint64_t bytes = 0;
    for (unsigned i = 0; i < x->targets; i++) {
        const struct exr_target *t = &x->target[i].pub;
        const struct exr_part *p = &x->part[t->part];
        bool first = t->role == EXR_SCENE && (p->extended || t->grow);
        for (unsigned k = 0; k < i && first; k++)
            first = x->target[k].pub.part != t->part;
        if (first) // the window is within the limits already: no overflow
            bytes += exr_rows_bytes(p, 1, 0, 1, true) * ((uint64_t)p->width + 2 * (uint64_t)t->grow) *
                     ((uint64_t)p->height + 2 * (uint64_t)t->grow);
    }
    if (bytes > x->limits.max_decoded_bytes)
        return fault_set(f, FAULT_EXR_TOO_LARGE, field,
                         "the bloomed parts would hold %llu bytes of pixels; at most %llu are made",
                         (unsigned long long)bytes, (unsigned long long)x->limits.max_decoded_bytes);
    return 0;
}

// ---- extra layers -----------------------------------------------------------------------------------------------

static int name_order(const void *a, const void *b)
{
    return strcmp(((const struct exr_channel *)a)->name, ((const struct exr_channel *)b)->name);
}

static int add_layer(const struct exr *x, struct exr_part *p, int target, unsigned extra, char **name,
                     struct fault *f)
{
    static const char *const words[] = { "R", "G", "B" };
    const struct exr_state *t = &x->target[target];
    for (unsigned c = 0; c < t->pub.channels; c++, *name += NAME_BYTES) {
        const int n = snprintf(*name, NAME_BYTES, "%sairy.%s.%s", t->prefix, x->options.extra_name[extra],
                               t->pub.channels == 1 ? "Y" : words[c]);
        if (n >= NAME_BYTES)
            return fault_set(f, FAULT_EXR_UNSUPPORTED, "params.layers",
                             "channel '%.64s...' would have a name of %d bytes; at most %d are possible", *name, n,
                             NAME_BYTES - 1);
        // Beside luminance and chroma the layer is plain colour, in the type of luminance.
        const unsigned like = exr_channel_of(x, t, t->luma_chroma ? 0 : c);
        const uint8_t type = p->channel[like].out_type;
        p->out_channel[p->out_channels++] = (struct exr_channel){
            .name = *name, .type = type, .out_type = type, .x_sampling = 1, .y_sampling = 1, .from = -1,
            .target = target, .plane = c, .output = 1 + extra };
    }
    return 0;
}

static int add_layers(const struct exr *x, struct exr_part *p, struct fault *f)
{
    char title[96];
    uint64_t added = 0;
    exr_part_title(p, title);
    if (p->chunks > p->level0)
        return fault_set(f, FAULT_EXR_UNSUPPORTED, "params.layers",
                         "%s has %u levels of resolution; layers are added to parts of one level", title,
                         p->level_mode == 2 ? p->levels_x * p->levels_y : p->levels_x);
    for (unsigned i = 0; i < x->targets; i++)
        if (x->target[i].pub.part == p->index && x->target[i].pub.role == EXR_SCENE)
            added += (uint64_t)x->options.extras * x->target[i].pub.channels;
    if (p->channels + added > EXR_CHANNELS_MAX)
        return fault_set(f, FAULT_EXR_TOO_LARGE, "params.layers",
                         "%s would have %llu channels; at most %d are possible", title,
                         (unsigned long long)(p->channels + added), EXR_CHANNELS_MAX);
    struct exr_channel *list = malloc((p->channels + added) * sizeof(*list));
    char *name = p->extra_names = malloc(added * NAME_BYTES);
    if (!list || !name) {
        free(list);
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the added channels");
    }
    memcpy(list, p->channel, p->channels * sizeof(*list));
    p->out_channel = list;
    p->extended = true;
    for (unsigned i = 0; i < x->targets; i++)
        for (unsigned e = 0; e < x->options.extras; e++)
            if (x->target[i].pub.part == p->index && x->target[i].pub.role == EXR_SCENE &&
                add_layer(x, p, (int)i, e, &name, f))
                return -1;
    qsort(list, p->out_channels, sizeof(*list), name_order);
    for (unsigned i = 1; i < p->out_channels; i++)
        if (!strcmp(list[i - 1].name, list[i].name))
            return fault_set(f, FAULT_EXR_UNSUPPORTED, "params.layers",
                             "%s has a channel '%.64s' already: a layer of another name, or a file without it, was "
                             "expected", title, list[i].name);
    return 0;
}

int exr_plan_channels(struct exr *x, struct fault *f)
{
    for (unsigned i = 0; i < x->parts; i++) {
        struct exr_part *p = &x->part[i];
        if (!p->scenes)
            continue;
        for (unsigned c = 0; c < p->channels; c++) {
            struct exr_channel *k = &p->channel[c];
            if (k->target >= 0 && x->options.pixels != EXR_PIXELS_KEEP)
                k->out_type = x->options.pixels == EXR_PIXELS_HALF ? PIXEL_TYPE_HALF : PIXEL_TYPE_FLOAT;
            p->retyped |= k->out_type != k->type;
        }
        p->out_channel = p->channel;
        p->out_channels = p->channels;
        if (x->options.extras && add_layers(x, p, f))
            return -1;
    }
    return x->options.extras ? check_bytes(x, "params.layers", f) : 0;
}

// ---- growing ----------------------------------------------------------------------------------------------------

static int check_window(const struct exr *x, const struct exr_part *p, uint32_t grow, struct fault *f)
{
    const int64_t g = grow, far = INT32_MAX / 2, w = (int64_t)p->width + 2 * g, h = (int64_t)p->height + 2 * g;
    const struct exr_limits *l = &x->limits;
    char title[96];
    exr_part_title(p, title);
    if (p->min_x - g <= -far || p->min_y - g <= -far || p->min_x - g + w > far || p->min_y - g + h > far)
        return fault_set(f, FAULT_EXR_TOO_LARGE, "params.grow",
                         "%s at (%d, %d) would leave the coordinates that a file can have (%lld) with %u more pixels "
                         "on each side", title, p->min_x, p->min_y, (long long)far, grow);
    if (w > l->max_width || h > l->max_height || (uint64_t)w * (uint64_t)h > l->max_pixels)
        return fault_set(f, FAULT_EXR_TOO_LARGE, "params.grow",
                         "%s would grow to %lld x %lld pixels; at most %u x %u, and %llu in all, are made", title,
                         (long long)w, (long long)h, l->max_width, l->max_height,
                         (unsigned long long)l->max_pixels);
    return 0;
}

static int check_grow(const struct exr *x, const struct exr_state *t, struct fault *f)
{
    const struct exr_part *p = &x->part[t->pub.part];
    char title[96];
    exr_part_title(p, title);
    if (p->storage == EXR_TILED && p->level_mode)
        return fault_set(f, FAULT_EXR_UNSUPPORTED, "params.grow",
                         "%s has %s levels; only parts of one level can grow", title,
                         p->level_mode == 1 ? "mip" : "rip");
    if (t->luma_chroma)
        return fault_set(f, FAULT_EXR_UNSUPPORTED, "params.grow",
                         "%s holds luminance and chroma; only R, G, B or Y can grow", title);
    for (unsigned i = 0; i < p->channels; i++)
        if (p->channel[i].x_sampling != 1 || p->channel[i].y_sampling != 1)
            return fault_set(f, FAULT_EXR_UNSUPPORTED, "params.grow",
                             "channel '%.64s' of %s is subsampled %d x %d; only parts without such channels can grow",
                             p->channel[i].name, title, p->channel[i].x_sampling, p->channel[i].y_sampling);
    return check_window(x, p, t->pub.grow, f);
}

int exr_grow_check(const struct exr *x, struct fault *f)
{
    bool any = false;
    for (unsigned i = 0; i < x->targets; i++) {
        const struct exr_target *t = &x->target[i].pub;
        if (t->role != EXR_SCENE || !t->grow)
            continue;
        if (check_grow(x, &x->target[i], f))
            return -1;
        any = true;
    }
    return any ? check_bytes(x, "params.grow", f) : 0;
}

// ---- chunks -----------------------------------------------------------------------------------------------------

static int check_output(const struct exr_part *p, struct fault *f)
{
    const uint32_t lines = exr_lines_per_chunk(p->out_compression);
    const bool dwa = p->out_compression == EXR_DWAA || p->out_compression == EXR_DWAB;
    char title[96];
    for (unsigned i = 0; i < p->channels && dwa; i++)
        if (lines % (uint32_t)p->channel[i].y_sampling)
            return fault_set(f, FAULT_EXR_UNSUPPORTED, "compression",
                             "channel '%.64s' has a y sampling of %d, which DWA chunks cannot hold",
                             p->channel[i].name, p->channel[i].y_sampling);
    for (uint32_t i = 0; i < p->outs; i++) {
        const struct exr_out_chunk *o = &p->out[i];
        const uint64_t n = exr_rows_bytes(p, o->width, o->row, o->rows, true);
        if (n > INT32_MAX)
            return fault_set(f, FAULT_EXR_TOO_LARGE, added_field(p),
                             "a chunk of %s would hold %llu bytes; at most %d are possible",
                             exr_part_title(p, title), (unsigned long long)n, INT32_MAX);
    }
    return 0;
}

// Chunk i of a grid over the output's window.
static struct exr_out_chunk grid_chunk(const struct exr_part *p, uint32_t i, uint32_t step_x, uint32_t step_y)
{
    const uint32_t across = (p->out_width - 1) / step_x + 1;
    struct exr_out_chunk o = { .tile_x = i % across, .tile_y = i / across };
    o.column = o.tile_x * step_x;
    o.row = o.tile_y * step_y;
    o.width = p->out_width - o.column < step_x ? p->out_width - o.column : step_x;
    o.rows = p->out_height - o.row < step_y ? p->out_height - o.row : step_y;
    return o;
}

static struct exr_out_chunk same_chunk(const struct exr_chunk *k)
{
    return (struct exr_out_chunk){ .row = k->y, .rows = k->height, .column = k->x, .width = k->width,
                                   .tile_x = k->tile_x, .tile_y = k->tile_y, .level_x = k->level_x,
                                   .level_y = k->level_y };
}

uint32_t exr_part_grow(const struct exr *x, const struct exr_part *p)
{
    int64_t grow = -1;
    for (unsigned i = 0; i < x->targets; i++) {
        const struct exr_target *t = &x->target[i].pub;
        if (t->part != p->index || t->role != EXR_SCENE)
            continue;
        assert(grow < 0 || grow == t->grow);
        grow = t->grow;
    }
    return grow < 0 ? 0 : (uint32_t)grow;
}

int exr_plan_outs(struct exr_part *p, struct fault *f)
{
    const bool tiled = p->storage == EXR_TILED;
    const uint32_t lines = exr_lines_per_chunk(p->out_compression);
    p->out_width = p->width + 2 * p->grow;
    p->out_height = p->height + 2 * p->grow;
    p->relayout = p->grow || (!tiled && lines != exr_lines_per_chunk(p->compression));
    const uint32_t step_x = tiled ? p->tile_width : p->out_width, step_y = tiled ? p->tile_height : lines;
    uint64_t n = p->chunks;
    if (p->relayout)
        n = (uint64_t)((p->out_width - 1) / step_x + 1) * ((p->out_height - 1) / step_y + 1);
    if (p->grow && n > EXR_OUT_CHUNKS_MAX)
        return fault_set(f, FAULT_EXR_TOO_LARGE, "params.grow",
                         "part %u would have %llu chunks, of %u x %u pixels; at most %d are made", p->index,
                         (unsigned long long)n, step_x, step_y, EXR_OUT_CHUNKS_MAX);
    p->out = calloc(n, sizeof(*p->out));
    if (!p->out)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for %llu chunks", (unsigned long long)n);
    p->outs = (uint32_t)n;
    for (uint32_t i = 0; i < p->outs; i++)
        p->out[i] = p->relayout ? grid_chunk(p, i, step_x, step_y) : same_chunk(&p->chunk[i]);
    return check_output(p, f);
}
