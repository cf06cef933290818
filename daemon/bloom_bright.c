// SPDX-License-Identifier: Apache-2.0
// bloom_bright.c - what glows in a frame, from its scan alone: an upper bound of E in every tile, so that dark frames and dark
// tiles are known before the device is asked. Twin of shaders/curve.glsl and extract.frag.
#include <math.h>
#include <string.h>

#include "bloom_internal.h"

/* The curve's gain at luminance l: monotone, so it bounds a frame, and a tile, from its largest l. */
static double gain_at(const struct frame *fr, double l)
{
    const double t = fr->threshold, k = fr->knee;
    switch (fr->params->bright) {
    case BRIGHT_NONE: return 1;
    case BRIGHT_CHANNEL: return l > t ? (l - t) / l : 0;
    case BRIGHT_LUMINANCE:
    case BRIGHT_KNEE: {
        const double s = fmin(fmax(l - t + k, 0), 2 * k);
        return l > 0 ? fmax(k > 0 ? s * s / (4 * k) : 0, fmax(l - t, 0)) / l : 0;
    }
    default: {
        const double lo = t - t * k, hi = t + t * k;
        if (hi <= lo)
            return l > t ? 1 : 0;
        const double x = fmin(fmax((l - lo) / (hi - lo), 0), 1);
        return x * x * (3 - 2 * x);
    }
    }
}

// An upper bound of E where luminance is at most l and every channel at most c. The device's float32 luminance
// may be a few ulp above the scan's: widen before asking.
static double bright_bound(const struct frame *fr, double l, double c)
{
    const double wide = 1 + 0x1p-20;
    const double value = fr->params->bright == BRIGHT_CHANNEL ? c : l;
    return c * gain_at(fr, value * wide) * wide;
}

static double of_bits(uint32_t bits)
{
    float v;
    memcpy(&v, &bits, 4);
    return (double)v;
}

// What the matte leaves of a tile's light, at most.
static double matte_gain(const struct frame *fr, uint32_t tile)
{
    const struct frame_scan *m = fr->request->matte_scan;
    return fr->matte ? of_bits(m->tile_channel[tile]) * fr->params->emission * (1 + 0x1p-20) : 1;
}

// clamp bounds the luminance, and so each channel by its weight.
static double clamp_bound(const struct frame *fr)
{
    double most = fr->params->clamp > 0 ? 0 : INFINITY;
    for (unsigned c = 0; c < fr->target->geometry.channels && most < INFINITY; c++) {
        const double weight = fr->target->geometry.channels == 1 ? 1 : (double)fr->request->luma[c];
        most = weight > 0 ? fmax(most, fr->params->clamp / weight * (1 + 0x1p-20)) : INFINITY;
    }
    return most;
}

static double tile_bound(const struct frame *fr, uint32_t tile)
{
    const double gain = matte_gain(fr, tile);
    return bright_bound(fr, of_bits(fr->scan->tile_luma[tile]) * gain, of_bits(fr->scan->tile_channel[tile]) * gain);
}

bool bright_tile(const struct frame *fr, uint32_t tile) { return tile_bound(fr, tile) > 0; }

void bright_count(const struct frame *fr, struct bloom_reply *reply)
{
    const struct frame_scan *s = fr->scan;
    reply->tiles = s->tiles_x * s->tiles_y;
    reply->max_bright = 0;
    const double most = clamp_bound(fr);
    for (uint32_t i = 0; i < reply->tiles && fr->params->bloom == SWITCH_ON; i++) {
        const double e = fmin(most, tile_bound(fr, i));
        reply->tiles_bright += e > 0;
        reply->max_bright = fmax(reply->max_bright, e);
    }
}

// One rectangle more, or the last one that spans the same columns and ends above it made longer.
static bool lit_add(struct lit *l, uint32_t x0, uint32_t y0, uint32_t x1, uint32_t y1)
{
    for (unsigned i = 0; i < l->count; i++)
        if (l->x0[i] == x0 && l->x1[i] == x1 && l->y1[i] == y0) {
            l->y1[i] = y1;
            return true;
        }
    if (l->count == LIT_MAX)
        return false;
    const unsigned i = l->count++;
    l->x0[i] = x0;
    l->y0[i] = y0;
    l->x1[i] = x1;
    l->y1[i] = y1;
    return true;
}

// Runs of bright tiles in each row of tiles; gaps of up to `gap` tiles are taken along, for a draw has its price too.
static bool lit_runs(const struct frame *fr, uint32_t gap, struct lit *l)
{
    const struct frame_scan *s = fr->scan;
    const uint32_t grow = fr->source->geometry.grow;
    uint32_t covered = 0;
    *l = (struct lit){ 0 };
    for (uint32_t y = 0; y < s->tiles_y; y++)
        for (uint32_t x = 0; x < s->tiles_x;) {
            if (!(tile_bound(fr, y * s->tiles_x + x) > 0)) {
                x++;
                continue;
            }
            uint32_t end = x + 1;
            for (uint32_t k = end; k < s->tiles_x && k <= end + gap; k++)
                if (tile_bound(fr, y * s->tiles_x + k) > 0)
                    end = k + 1;
            if (!lit_add(l, x * SCAN_TILE + grow, y * SCAN_TILE + grow, end * SCAN_TILE + grow, (y + 1) * SCAN_TILE + grow))
                return false;
            covered += end - x;
            x = end;
        }
    l->share = covered / ((double)s->tiles_x * s->tiles_y);
    return true;
}

bool bright_lit(const struct frame *fr, struct lit *out)
{
    if (fr->rich || fr->source->geometry.width < 4 * SCAN_TILE)
        return false;
    for (uint32_t gap = 1; gap <= fr->scan->tiles_x; gap *= 2)
        if (lit_runs(fr, gap, out))
            return out->share < 0.75;
    return false;
}

/* ---- what cannot show ---------------------------------------------------------------------------------- */

// An upper bound of what Gaussian k adds anywhere: no more than its weight of the brightest E (its taps are >= 0 and sum to 1), and no
// more than all of E at the Gaussian's own peak. The sum of exp(-n^2 / 2 sigma^2) is at least 1 and at least sigma sqrt(2 pi).
static double most_of(const struct frame *fr, const struct plan_gaussian *k, double max_bright, double all_bright)
{
    const double norm = fmax(1, k->sigma_x * sqrt(2 * M_PI)) * fmax(1, k->sigma_y * sqrt(2 * M_PI));
    const double weight = fmax(k->weight[0], fmax(k->weight[1], k->weight[2]));
    const double peak = (1 + k->peak + 0x1p-10) / norm;
    return fr->params->intensity * weight * fmin(max_bright * (1 + 0x1p-10), all_bright * peak);
}

void bright_skip(struct frame *fr, const struct bloom_reply *reply)
{
    const struct plan *p = fr->b->plan;
    // Half the smallest step of a half: added to any half, it rounds away. (float32 has no step that small.)
    double left = 0x1p-25, all = 0;
    bool done[PARAMS_GAUSSIANS_MAX] = { false };
    fr->skip = 0;
    fr->skip_bound = 0;
    if (fr->fft || fr->pad || fr->b->whole || fr->target->geometry.type != PIXEL_TYPE_HALF)
        return;
    for (uint32_t i = 0; i < reply->tiles; i++)
        all += tile_bound(fr, i) * SCAN_TILE * SCAN_TILE;
    for (;;) {
        unsigned least = p->count;
        for (unsigned g = 0; g < p->count; g++)
            if (!done[g] && (least == p->count || most_of(fr, &p->gaussian[g], reply->max_bright, all) <
                                                      most_of(fr, &p->gaussian[least], reply->max_bright, all)))
                least = g;
        if (least == p->count || most_of(fr, &p->gaussian[least], reply->max_bright, all) > left)
            return;
        const double most = most_of(fr, &p->gaussian[least], reply->max_bright, all);
        done[least] = true;
        left -= most;
        fr->skip |= 1u << least;
        fr->skip_bound += most / (fr->params->intensity * reply->max_bright);
    }
}

void bright_set(struct frame *fr)
{
    const struct params *p = fr->params;
    const double scale = exp2(-fr->exposure);
    fr->threshold = (p->threshold_unit == UNIT_STOPS ? exp2(p->threshold) : p->threshold) * scale;
    // METHODS section 1, step 4: the knee shrinks as T nears 0. For smoothstep it is a share of T.
    fr->knee = p->bright == BRIGHT_SMOOTHSTEP  ? p->knee
               : p->bright == BRIGHT_LUMINANCE ? 0
                                               : fmin(p->knee * scale, fr->threshold);
}

// Differences are taken in double here: T - K must be 0 when K = T, not a rest of rounding.
void bright_curve(const struct frame *fr, float curve[4])
{
    const bool smooth = fr->params->bright == BRIGHT_SMOOTHSTEP;
    const double edge = fr->threshold, k = smooth ? edge * fr->knee : fr->knee;
    curve[0] = (float)edge;
    curve[1] = (float)(2 * k);
    curve[2] = k > 0 ? (float)(1 / ((smooth ? 2 : 4) * k)) : 0;
    curve[3] = (float)(edge - k);
}

// E is a difference: what the luminance, the threshold and their subtraction round off is a share of the
// largest sample, which may be much more than the largest E.
double bright_rounding(const struct frame *fr, const struct bloom_reply *reply)
{
    if (fr->params->bright == BRIGHT_NONE || reply->max_bright == 0)
        return 0;
    double gain = 1;
    for (uint32_t i = 0; fr->matte && i < reply->tiles; i++)
        gain = fmax(gain, matte_gain(fr, i));
    return (fr->rich ? 16 : 8) * 0x1p-24 * frame_scan_max_channel(fr->scan) * gain / reply->max_bright;
}
