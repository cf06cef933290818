// SPDX-License-Identifier: Apache-2.0
/*
 * exr_mip.c - the lower levels of mipmapped and ripmapped parts after a bloom of level 0.
 *
 * level' = level + area average of (out - in): whatever filter made the file's levels stays, and where
 * nothing changed the bits stay. The average is exact for odd sizes too (an output pixel covers w / n
 * input pixels, the ones at its ends in part), so no glow is lost at borders.
 *
 * A pixel that was NaN or Inf and is finite now (nonfinite=zero) makes the delta NaN: such samples of a
 * level are no sums, they are averaged anew from the level above it.
 */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "exr_internal.h"

struct exr_delta {
    uint32_t width[EXR_LEVELS_MAX], height[EXR_LEVELS_MAX];
    unsigned planes;  // targets of the part * 3
    float **level;    // [levels_y][levels_x][planes]: difference; NULL at level 0 and where there is none
    float **fresh;    // likewise: the average of the output, made only where the difference has NaN
};

static bool is_finite(float v) { return v <= FLT_MAX && v >= -FLT_MAX; }

static size_t slot(const struct exr_part *p, const struct exr_delta *d, unsigned lx, unsigned ly,
                   unsigned plane)
{
    return ((size_t)ly * p->levels_x + lx) * d->planes + plane;
}

static size_t slots(const struct exr_part *p, const struct exr_delta *d)
{
    return (size_t)p->levels_x * p->levels_y * d->planes;
}

void exr_delta_free(struct exr_part *p)
{
    struct exr_delta *d = p->delta;
    if (!d)
        return;
    for (size_t i = 0; d->level && i < slots(p, d); i++)
        free(d->level[i]);
    for (size_t i = 0; d->fresh && i < slots(p, d); i++)
        free(d->fresh[i]);
    free(d->level);
    free(d->fresh);
    free(d);
    p->delta = NULL;
}

// n outputs of `step` floats each from w inputs, each the mean of w / n neighbours.
static void shrink(float *out, uint32_t n, size_t out_step, const float *in, uint32_t w, size_t in_step)
{
    const double span = (double)w / n;
    for (uint32_t i = 0; i < n; i++) {
        const double begin = i * span, end = i + 1 == n ? (double)w : (i + 1) * span;
        double sum = 0;
        for (uint32_t j = (uint32_t)begin; j < w && (double)j < end; j++) {
            const double from = begin > j ? begin : j, to = end < j + 1.0 ? end : j + 1.0;
            sum += (to - from) * (double)in[j * in_step];
        }
        out[i * out_step] = (float)(sum / span);
    }
}

// A new plane, nw x nh, from w x h; only one direction differs, or both. NULL: no memory.
static float *shrink_plane(const float *in, uint32_t w, uint32_t h, uint32_t nw, uint32_t nh)
{
    float *mid = malloc(((size_t)nw * h + 1) * sizeof(float));
    float *out = malloc(((size_t)nw * nh + 1) * sizeof(float));
    if (mid && out) {
        for (uint32_t y = 0; y < h; y++)
            shrink(mid + (size_t)y * nw, nw, 1, in + (size_t)y * w, w, 1);
        for (uint32_t x = 0; x < nw; x++)
            shrink(out + x, nh, nw, mid + x, h, nw);
    } else {
        free(out);
        out = NULL;
    }
    free(mid);
    return out;
}

static void out_row(const struct exr_state *t, const struct exr_channel *c, uint32_t y, float *row)
{
    const struct planes *from = t->luma_chroma ? &t->yc[c->plane] : &t->out[0];
    const uint8_t *at = planes_row(from, t->luma_chroma ? 0 : c->plane, y);
    if (from->type == PIXEL_TYPE_HALF)
        half_to_float(row, (const uint16_t *)(const void *)at, from->width);
    else
        memcpy(row, at, from->width * sizeof(float));
}

// out - in of level 0, in from the file's own samples.
static bool difference(const struct exr_state *t, const struct exr_part *p, unsigned channel, float *d,
                       float *row, uint16_t *half)
{
    bool any = false;
    for (uint32_t y = 0; y < p->height; y++) {
        float *to = d + (size_t)y * p->width;
        exr_fetch_row(p, channel, y, to, half);
        out_row(t, &p->channel[channel], y, row);
        for (uint32_t i = 0; i < p->width; i++) {
            if (!memcmp(&row[i], &to[i], 4) || (!is_finite(row[i]) && !is_finite(to[i])))
                to[i] = 0;
            else
                to[i] = is_finite(to[i]) && is_finite(row[i]) ? row[i] - to[i] : NAN;
            any |= to[i] != 0;
        }
    }
    return any;
}

static bool has_nan(const float *v, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (v[i] != v[i])
            return true;
    return false;
}

// Every level from the one before it in x, or in y where x is 0; in both for mip levels.
static int make_levels(const struct exr_part *p, struct exr_delta *d, float **list, unsigned plane,
                       const float *base)
{
    for (unsigned ly = 0; ly < p->levels_y; ly++)
        for (unsigned lx = 0; lx < p->levels_x; lx++) {
            if ((!lx && !ly) || (p->level_mode == 1 && lx != ly))
                continue;
            const unsigned fx = lx ? lx - 1 : 0, fy = p->level_mode == 1 || !lx ? ly - 1 : ly;
            const float *from = fx || fy ? list[slot(p, d, fx, fy, plane)] : base;
            float *to = shrink_plane(from, d->width[fx], d->height[fy], d->width[lx], d->height[ly]);
            if (!to)
                return -1;
            list[slot(p, d, lx, ly, plane)] = to;
        }
    return 0;
}

static int make_channel(struct exr *x, struct exr_part *p, struct exr_delta *d, unsigned channel,
                        unsigned plane)
{
    const struct exr_state *t = &x->target[p->channel[channel].target];
    const size_t n = (size_t)p->width * p->height;
    float *base = malloc(n * sizeof(float)), *row = malloc(p->width * sizeof(float));
    uint16_t *half = malloc(p->width * sizeof(*half));
    int result = base && row && half ? 0 : -1;
    if (!result && difference(t, p, channel, base, row, half)) {
        result = make_levels(p, d, d->level, plane, base);
        if (!result && has_nan(base, n)) {
            for (uint32_t y = 0; y < p->height; y++)
                out_row(t, &p->channel[channel], y, base + (size_t)y * p->width);
            result = make_levels(p, d, d->fresh, plane, base);
        }
    }
    free(base);
    free(row);
    free(half);
    return result;
}

static unsigned plane_of(const struct exr *x, const struct exr_part *p, const struct exr_channel *c)
{
    unsigned before = 0;
    for (int i = 0; i < c->target; i++)
        before += x->target[i].pub.part == p->index;
    return 3 * before + c->plane;
}

int exr_delta_make(struct exr *x, struct exr_part *p, struct fault *f)
{
    struct exr_delta *d = p->delta = calloc(1, sizeof(*d));
    if (!d)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the levels");
    d->planes = 3 * p->targets;
    for (unsigned i = 0; i < p->levels_x; i++)
        d->width[i] = exr_level_size(p->width, i, p->round_up);
    for (unsigned i = 0; i < p->levels_y; i++)
        d->height[i] = exr_level_size(p->height, i, p->round_up);
    d->level = calloc(slots(p, d), sizeof(*d->level));
    d->fresh = calloc(slots(p, d), sizeof(*d->fresh));
    int result = d->level && d->fresh ? 0 : -1;
    for (unsigned i = 0; i < p->channels && !result; i++) {
        const struct exr_channel *c = &p->channel[i];
        if (c->target >= 0 && !x->target[c->target].untouched)
            result = make_channel(x, p, d, i, plane_of(x, p, c));
    }
    return result ? fault_set(f, FAULT_NO_MEMORY, "", "no memory for the levels") : 0;
}

bool exr_delta_row(const struct exr *x, const struct exr_part *p, const struct exr_channel *c,
                   const struct exr_chunk *k, uint32_t py, float *row)
{
    const struct exr_delta *d = p->delta;
    if (!d)
        return false;
    const size_t s = slot(p, d, k->level_x, k->level_y, plane_of(x, p, c));
    if (!d->level[s])
        return false;
    const size_t at = (size_t)py * d->width[k->level_x] + k->x;
    const float *delta = d->level[s] + at, *fresh = d->fresh[s] ? d->fresh[s] + at : NULL;
    bool any = false;
    for (uint32_t i = 0; i < k->width; i++) {
        if (delta[i] == 0)
            continue;
        any = true;
        if (delta[i] == delta[i])
            row[i] += delta[i];
        else if (fresh)
            row[i] = fresh[i];
    }
    return any;
}
