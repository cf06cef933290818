// SPDX-License-Identifier: Apache-2.0
// reference.c - reference.h's text as code, in its order. Loops run so that each output is a sum over
// inputs in rising order, and inputs of exactly 0 are passed over: that is all the speed there is.
#include "reference.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static double sanitised(double v) { return isfinite(v) && v > 0 ? v : 0; }

static double clamped(double v, double low, double high) { return v < low ? low : v > high ? high : v; }

static double luminance(const double v[3], unsigned channels, const double luma[3])
{
    return channels == 1 ? v[0] : luma[0] * v[0] + luma[1] * v[1] + luma[2] * v[2];
}

static size_t pixels(const struct reference_frame *f) { return (size_t)f->width * f->height; }

/* ---- 2. exposure --------------------------------------------------------------------------------- */

enum { BINS = 256 };
static const double bins_low = -16, bins_per_stop = 8;

/* Takes `take` pixels away, from bin `from` on in steps of `step`. */
static void take_away(double bins[BINS], double take, int from, int step)
{
    for (int i = from; i >= 0 && i < BINS && take > 0; i += step) {
        double t = fmin(take, bins[i]);
        bins[i] -= t;
        take -= t;
    }
}

double reference_exposure(const struct reference_frame *f, const struct params *p, size_t *near_edges)
{
    double bins[BINS] = { 0 }, counted = 0, left = 0, sum = 0;
    if (near_edges)
        *near_edges = 0;
    if (!p->exposure_auto)
        return p->exposure;
    for (size_t i = 0; i < pixels(f); i++) {
        double v[3] = { 0 };
        for (unsigned c = 0; c < f->channels; c++)
            v[c] = sanitised(f->plane[c][i]);
        double L = luminance(v, f->channels, f->luma), at = (log2(L) - bins_low) * bins_per_stop;
        if (!(L > 0 && isfinite(L)))
            continue;
        bins[(int)clamped(floor(at), 0, BINS - 1)]++;
        counted++;
        if (near_edges && at > .5 && at < BINS - .5 && fabs(at - rint(at)) < 1e-6 * bins_per_stop)
            ++*near_edges;
    }
    if (p->meter_dark + p->meter_bright >= 100)
        return 0;
    take_away(bins, counted * p->meter_dark / 100, 0, 1);
    take_away(bins, counted * p->meter_bright / 100, BINS - 1, -1);
    for (int i = 0; i < BINS; i++) {
        left += bins[i];
        sum += bins[i] * exp2(bins_low + (i + .5) / bins_per_stop);
    }
    return left > 0 ? clamped(log2(p->key / (sum / left)), -32, 32) : 0;
}

static double threshold_in_use(const struct params *p)
{
    double t = p->threshold_unit == UNIT_STOPS ? exp2(p->threshold) : p->threshold;
    return t / exp2(p->exposure);
}

static double knee_in_use(const struct params *p)
{
    if (p->bright == BRIGHT_SMOOTHSTEP)
        return p->knee;
    return fmin(p->knee / exp2(p->exposure), threshold_in_use(p));
}

/* ---- 3. source ----------------------------------------------------------------------------------- */

static double scene_gain(const struct reference_frame *f, const struct params *p, size_t i)
{
    return f->matte ? 1 + sanitised(f->matte[i]) * (p->emission - 1) : 1;
}

static void source_pixel(double s[3], const struct reference_frame *f, const struct params *p, size_t i)
{
    for (unsigned c = 0; c < f->channels; c++) {
        double v = f->source[0] ? f->source[c][i] : f->plane[c][i];
        s[c] = sanitised(f->matte ? v * sanitised(f->matte[i]) * p->emission : v);
    }
}

/* The mean of l over those of (x, y)'s 8 neighbours that are there; -1 when none is. */
static double around(const double *l, const struct reference_frame *f, size_t x, size_t y)
{
    double sum = 0;
    unsigned n = 0;
    for (size_t v = y ? y - 1 : 0; v <= y + 1 && v < f->height; v++)
        for (size_t u = x ? x - 1 : 0; u <= x + 1 && u < f->width; u++)
            if (u != x || v != y) {
                sum += l[v * f->width + u];
                n++;
            }
    return n ? sum / n : -1;
}

/* What each pixel of the source is multiplied by; the caller's to free. NULL: no memory. */
static double *firefly_factors(const struct reference_frame *f, const struct params *p)
{
    double *l = malloc(pixels(f) * sizeof(double)), *factor = malloc(pixels(f) * sizeof(double));
    for (size_t i = 0; l && factor && i < pixels(f); i++) {
        double s[3] = { 0 };
        source_pixel(s, f, p, i);
        l[i] = luminance(s, f->channels, f->luma);
    }
    for (size_t i = 0; l && factor && i < pixels(f); i++) {
        double n = p->firefly > 0 ? around(l, f, i % f->width, i / f->width) : -1;
        factor[i] = n >= 0 && l[i] > 0 ? fmin(1, p->firefly * n / l[i]) : 1;
    }
    if (!l) {
        free(factor);
        factor = NULL;
    }
    free(l);
    return factor;
}

/* ---- 4. bright pass ------------------------------------------------------------------------------ */

/* The share of a pixel of luminance L that glows; L > 0. */
static double share(double L, const struct params *p)
{
    double T = threshold_in_use(p), K = knee_in_use(p), soft = 0, t;
    switch ((enum bright_curve)p->bright) {
    case BRIGHT_LUMINANCE:
        return fmax(0, L - T) / L;
    case BRIGHT_KNEE:
        if (K > 0) {
            double s = clamped(L - (T - K), 0, 2 * K);
            soft = s / (4 * K) * s;
        }
        return fmax(soft, fmax(0, L - T)) / L;
    case BRIGHT_SMOOTHSTEP:
        if (T * K == 0)
            return L > T;
        t = clamped((L - (T - T * K)) / (2 * T * K), 0, 1);
        return t * t * (3 - 2 * t);
    default:
        return 1;
    }
}

static void bright_unclamped(double e[3], const double pixel[3], unsigned channels, const double luma[3],
                             const struct params *p)
{
    for (unsigned c = 0; c < channels; c++)
        e[c] = sanitised(pixel[c]);
    double L = luminance(e, channels, luma);
    for (unsigned c = 0; c < channels; c++) {
        if (p->bright == BRIGHT_CHANNEL)
            e[c] = fmax(0, e[c] - threshold_in_use(p));
        else if (p->bright != BRIGHT_NONE)
            e[c] = L > 0 ? e[c] * share(L, p) : 0;
    }
}

static void clamp_pixel(double e[3], unsigned channels, const double luma[3], const struct params *p)
{
    double l = luminance(e, channels, luma);
    for (unsigned c = 0; p->clamp > 0 && l > p->clamp && c < channels; c++)
        e[c] *= p->clamp / l;
}

void reference_bright(double e[3], const double pixel[3], unsigned channels, const double luma[3],
                      const struct params *p)
{
    bright_unclamped(e, pixel, channels, luma, p);
    clamp_pixel(e, channels, luma, p);
}

static double sum_of(const double v[3], unsigned channels)
{
    double sum = 0;
    for (unsigned c = 0; c < channels; c++)
        sum += v[c];
    return sum;
}

/* Where pixel i of the frame is in the result's planes. */
static size_t grown(const struct reference_frame *f, const struct reference_result *r, size_t i)
{
    return (i / f->width + f->grow) * r->width + f->grow + i % f->width;
}

static int bright_pass(struct reference_result *r, const struct reference_frame *f, const struct params *p)
{
    long double bright = 0, taken_clamp = 0, taken_firefly = 0;
    double *factor = firefly_factors(f, p);
    if (!factor)
        return -1;
    for (size_t i = 0; i < pixels(f); i++) {
        double s[3], plain[3], e[3];
        source_pixel(s, f, p, i);
        bright_unclamped(plain, s, f->channels, f->luma, p);
        for (unsigned c = 0; c < f->channels; c++)
            s[c] *= factor[i];
        bright_unclamped(e, s, f->channels, f->luma, p);
        double unclamped = sum_of(e, f->channels);
        clamp_pixel(e, f->channels, f->luma, p);
        taken_firefly += sum_of(plain, f->channels) - unclamped;
        taken_clamp += unclamped - sum_of(e, f->channels);
        bright += sum_of(e, f->channels);
        for (unsigned c = 0; c < f->channels; c++) {
            r->bright[c][grown(f, r, i)] = e[c];
            r->max_bright = fmax(r->max_bright, e[c]);
        }
    }
    r->energy_bright = (double)bright;
    r->energy_clamped = (double)taken_clamp;
    r->energy_suppressed = (double)taken_firefly;
    free(factor);
    return 0;
}

/* ---- 5. spread ----------------------------------------------------------------------------------- */

void reference_sigma(double *x, double *y, const struct psf_gaussian *g, const struct reference_frame *f,
                     const struct params *p)
{
    double width = f->display_width ? f->display_width : f->width;
    *y = g->sigma.value;
    if (g->sigma.unit == SIZE_PERCENT)
        *y *= hypot(f->width * f->pixel_aspect, f->height) / 100;
    else if (g->sigma.unit == SIZE_MM)
        *y *= width * f->pixel_aspect / p->sensor_mm;
    *x = *y / f->pixel_aspect;
}

double reference_weight(const struct reference_frame *f, const struct params *p, unsigned gaussian, unsigned c)
{
    const struct psf_gaussian *g = &p->psf_spec.gaussian[gaussian];
    double x, sigma, smallest = INFINITY, largest = 0;
    for (unsigned i = 0; i < p->psf_spec.count; i++) {
        reference_sigma(&x, &sigma, &p->psf_spec.gaussian[i], f, p);
        smallest = fmin(smallest, sigma);
        largest = fmax(largest, sigma);
    }
    reference_sigma(&x, &sigma, g, f, p);
    double u = largest > smallest ? log(sigma / smallest) / log(largest / smallest) : 0;
    double tint = f->channels == 1 ? (g->tint[0] + g->tint[1] + g->tint[2]) / 3 : g->tint[c];
    return g->weight * tint * (p->near_gain + (p->far_gain - p->near_gain) * u);
}

/* One axis of n inputs and n + 2 grow outputs. */
struct axis {
    double *g;            /* taps at distance -(n+grow-1) .. n+grow-1; 0 where cut */
    double *first, *last; /* edge=fill: what input 0 and input n-1 do to the outputs, with all beyond them */
    double *lost;         /* [n]: what a source at i puts outside 0..n-1 */
    unsigned n, grow;
    bool fill;
};

static void axis_finish(struct axis *a)
{
    free(a->g);
    free(a->first);
    free(a->last);
    free(a->lost);
}

/* tail[d]: the sum of all taps from distance d on, d of any sign. */
static double taps_from(const double *tail, long d) { return d > 0 ? tail[d] : 1 - tail[1 - d]; }

static void axis_fill(struct axis *a, const double *half, const double *tail)
{
    long n = a->n, grow = a->grow;
    for (long d = 0; d < n + grow; d++)
        a->g[n + grow - 1 + d] = a->g[n + grow - 1 - d] = half[d];
    for (long i = 0; i < n; i++)
        a->lost[i] = tail[i + 1] + tail[n - i];
    for (long o = 0; o < n + 2 * grow; o++) {
        a->first[o] = n == 1 ? 1 : taps_from(tail, o - grow);
        a->last[o] = n == 1 ? 1 : taps_from(tail, n - 1 - (o - grow));
    }
}

static int axis_init(struct axis *a, unsigned n, unsigned grow, enum edge edge, double sigma)
{
    long radius = (long)ceil(sigma * sqrt(2 * log(1e17)));
    long last = radius > (long)n + grow ? radius : (long)n + grow;
    double *half = calloc((size_t)last + 1, sizeof(double)), *tail = calloc((size_t)last + 3, sizeof(double));
    *a = (struct axis){ .n = n, .grow = grow, .fill = edge == EDGE_FILL };
    a->g = calloc(2 * ((size_t)n + grow), sizeof(double));
    a->first = calloc(n + 2 * (size_t)grow, sizeof(double));
    a->last = calloc(n + 2 * (size_t)grow, sizeof(double));
    a->lost = calloc(n, sizeof(double));
    int r = half && tail && a->g && a->first && a->last && a->lost ? 0 : -1;
    long double sum = 0;
    for (long i = radius; r == 0 && i >= 0; i--) {
        half[i] = exp(-.5 * ((double)i / sigma) * ((double)i / sigma));
        half[i] = half[i] < 1e-17 ? 0 : half[i];
        sum += (i ? 2 : 1) * (long double)half[i];
    }
    for (long i = last; r == 0 && i >= 0; i--) {
        half[i] = (double)(half[i] / sum);
        tail[i] = tail[i + 1] + half[i];
    }
    if (r == 0)
        axis_fill(a, half, tail);
    else
        axis_finish(a);
    free(half);
    free(tail);
    return r;
}

static int axes_init(struct axis *x, struct axis *y, unsigned width, unsigned height,
                     const struct reference_kernel *k)
{
    if (axis_init(x, width, k->grow, k->edge, k->sigma_x) < 0)
        return -1;
    if (axis_init(y, height, k->grow, k->edge, k->sigma_y) == 0)
        return 0;
    axis_finish(x);
    return -1;
}

/* What input i does to outputs 0 .. n + 2 grow - 1. */
static const double *axis_column(const struct axis *a, size_t i)
{
    if (a->fill && i == 0)
        return a->first;
    if (a->fill && i == a->n - 1)
        return a->last;
    return a->g + (a->n - 1 - i);
}

static void add_scaled(double *restrict out, const double *restrict in, double v, size_t n)
{
    for (size_t k = 0; k < n; k++)
        out[k] += v * in[k];
}

static int spread(double *out, const double *in, size_t in_stride, const struct axis *ax, const struct axis *ay,
                  double weight)
{
    size_t w = ax->n, h = ay->n, wide = w + 2 * (size_t)ax->grow, high = h + 2 * (size_t)ay->grow;
    double *across = calloc(wide * h, sizeof(double));
    if (!across)
        return -1;
    for (size_t y = 0; y < h; y++) {
        bool lit = false;
        for (size_t x = 0; x < w; x++)
            if (in[y * in_stride + x] != 0) {
                add_scaled(across + y * wide, axis_column(ax, x), in[y * in_stride + x], wide);
                lit = true;
            }
        const double *column = axis_column(ay, y);
        for (size_t o = 0; lit && o < high; o++)
            if (column[o] != 0)
                add_scaled(out + o * wide, across + y * wide, weight * column[o], wide);
    }
    free(across);
    return 0;
}

int reference_spread(double *out, const double *in, size_t in_stride, unsigned width, unsigned height,
                     const struct reference_kernel *k)
{
    struct axis ax, ay;
    if (axes_init(&ax, &ay, width, height, k) < 0)
        return -1;
    int r = spread(out, in, in_stride, &ax, &ay, k->weight);
    axis_finish(&ax);
    axis_finish(&ay);
    return r;
}

/* What of weight * (G * in) falls outside the frame: 1 - a(x) b(y) = lost(x) + (1 - lost(x)) lost(y). */
static int spread_lost(long double *lost, const double *in, size_t in_stride, unsigned width, unsigned height,
                       const struct reference_kernel *k)
{
    struct axis ax, ay;
    if (axes_init(&ax, &ay, width, height, k) < 0)
        return -1;
    for (size_t y = 0; k->edge == EDGE_ZERO && y < height; y++)
        for (size_t x = 0; x < width; x++)
            *lost += (long double)k->weight * in[y * in_stride + x] *
                     (ax.lost[x] + (1 - (long double)ax.lost[x]) * ay.lost[y]);
    axis_finish(&ax);
    axis_finish(&ay);
    return 0;
}

/* Gaussian i of channel c: added to `out`, and its loss to *lost when that is asked for. */
static int spread_one(double *out, long double *lost, const struct reference_result *r, const struct reference_frame *f,
                      const struct params *p, unsigned i, unsigned c)
{
    struct reference_kernel k = { .weight = reference_weight(f, p, i, c), .edge = (enum edge)p->edge,
                                  .grow = f->grow };
    const double *e = r->bright[c] + (size_t)f->grow * r->width + f->grow;
    reference_sigma(&k.sigma_x, &k.sigma_y, &p->psf_spec.gaussian[i], f, p);
    if (reference_spread(out, e, r->width, f->width, f->height, &k) < 0)
        return -1;
    return lost ? spread_lost(lost, e, r->width, f->width, f->height, &k) : 0;
}

static double dirt_texel(const struct reference_frame *f, unsigned c, unsigned x, unsigned y)
{
    const double *t = f->dirt + 3 * ((size_t)y * f->dirt_width + x);
    return f->channels == 1 ? (t[0] + t[1] + t[2]) / 3 : t[c];
}

static double dirt_at(const struct reference_result *r, const struct reference_frame *f, unsigned c, size_t i)
{
    double u = ((double)(i % r->width) + .5) * f->dirt_width / r->width - .5;
    double v = ((double)(i / r->width) + .5) * f->dirt_height / r->height - .5;
    u = clamped(u, 0, f->dirt_width - 1);
    v = clamped(v, 0, f->dirt_height - 1);
    unsigned x0 = (unsigned)u, y0 = (unsigned)v;
    unsigned x1 = x0 + 1 < f->dirt_width ? x0 + 1 : x0, y1 = y0 + 1 < f->dirt_height ? y0 + 1 : y0;
    double top = dirt_texel(f, c, x0, y0) * (1 - (u - x0)) + dirt_texel(f, c, x1, y0) * (u - x0);
    double low = dirt_texel(f, c, x0, y1) * (1 - (u - x0)) + dirt_texel(f, c, x1, y1) * (u - x0);
    return top * (1 - (v - y0)) + low * (v - y0);
}

static void apply_dirt(double *plane, const struct reference_result *r, const struct reference_frame *f,
                       const struct params *p, unsigned c)
{
    for (size_t i = 0; f->dirt && i < (size_t)r->width * r->height; i++)
        plane[i] *= 1 - p->dirt_gain + p->dirt_gain * dirt_at(r, f, c, i);
}

static int spread_all(struct reference_result *r, const struct reference_frame *f, const struct params *p)
{
    long double bloomed = 0, lost = 0;
    for (unsigned c = 0; c < f->channels; c++) {
        for (unsigned i = 0; i < p->psf_spec.count; i++)
            if (spread_one(r->glow[c], &lost, r, f, p, i, c) < 0)
                return -1;
        for (size_t i = 0; i < pixels(f); i++)
            bloomed += r->glow[c][grown(f, r, i)];
        apply_dirt(r->glow[c], r, f, p, c);
    }
    r->energy_bloomed = (double)(bloomed * p->intensity);
    r->energy_lost = (double)(lost * p->intensity);
    return 0;
}

/* ---- 6. composite, 7. display -------------------------------------------------------------------- */

static bool displayed(const struct params *p)
{
    return p->display != DISPLAY_NONE || p->saturation != 1 || p->encoding != ENCODING_LINEAR;
}

static double toned(double v, const struct params *p)
{
    v = fmax(0, v * exp2(p->exposure));
    if (p->display == DISPLAY_REINHARD)
        return v / (v + 1);
    if (p->display == DISPLAY_ACES)
        return v * (2.51 * v + .03) / (v * (2.43 * v + .59) + .14);
    return v;
}

static double encoded(double v, const struct params *p)
{
    if (p->encoding == ENCODING_GAMMA22)
        return pow(v, 1 / 2.2);
    if (p->encoding == ENCODING_SRGB)
        return v <= .0031308 ? 12.92 * v : 1.055 * pow(v, 1 / 2.4) - .055;
    return v;
}

void reference_final(double out[3], const double scene[3], const double bright[3], const double glow[3],
                     unsigned channels, const double luma[3], const struct params *p)
{
    double k = p->intensity, v[3] = { 0 };
    for (unsigned c = 0; c < channels; c++) {
        if (p->composite == COMPOSITE_SCREEN_ADD && displayed(p))
            v[c] = toned(scene[c], p) + k * glow[c];
        else {
            v[c] = scene[c] + k * (p->composite == COMPOSITE_MIX ? glow[c] - bright[c] : glow[c]);
            v[c] = displayed(p) ? toned(v[c], p) : v[c];
        }
    }
    double l = luminance(v, channels, luma);
    for (unsigned c = 0; c < channels; c++) {
        if (displayed(p) && channels == 3)
            v[c] = fmax(0, l + p->saturation * (v[c] - l));
        out[c] = displayed(p) ? encoded(v[c], p) : v[c];
    }
}

/* ---- 8. views, and the whole --------------------------------------------------------------------- */

static void composite_all(struct reference_result *r, const struct reference_frame *f, const struct params *p)
{
    for (size_t i = 0; i < (size_t)r->width * r->height; i++) {
        double scene[3] = { 0 }, bright[3] = { 0 }, glow[3] = { 0 }, out[3];
        for (unsigned c = 0; c < f->channels; c++) {
            scene[c] = isfinite(r->scene[c][i]) ? r->scene[c][i] : 0;
            bright[c] = r->bright[c][i];
            glow[c] = r->glow[c][i];
        }
        reference_final(out, scene, bright, glow, f->channels, f->luma, p);
        for (unsigned c = 0; c < f->channels; c++)
            r->out[c][i] = isfinite(r->scene[c][i]) ? out[c] : r->scene[c][i];
    }
}

static int scene_all(struct reference_result *r, const struct reference_frame *f, const struct params *p)
{
    long double input = 0;
    for (size_t i = 0; i < pixels(f); i++)
        for (unsigned c = 0; c < f->channels; c++) {
            double v = f->plane[c][i], *to = &r->scene[c][grown(f, r, i)];
            if (isfinite(v)) {
                input += v;
                *to = v * scene_gain(f, p, i);
            } else {
                if (p->nonfinite == NONFINITE_REJECT)
                    return -1;
                *to = p->nonfinite == NONFINITE_KEEP ? v : 0;
            }
        }
    r->energy_input = (double)input;
    return 0;
}

int reference_bloom(struct reference_result *r, const struct reference_frame *f, const struct params *p)
{
    struct params used = *p;
    used.exposure = reference_exposure(f, p, NULL);
    *r = (struct reference_result){ .width = f->width + 2 * f->grow, .height = f->height + 2 * f->grow,
                                    .exposure = used.exposure, .threshold = threshold_in_use(&used),
                                    .knee = knee_in_use(&used) };
    for (unsigned c = 0; c < f->channels; c++) {
        size_t n = (size_t)r->width * r->height;
        r->scene[c] = calloc(n, sizeof(double));
        r->bright[c] = calloc(n, sizeof(double));
        r->glow[c] = calloc(n, sizeof(double));
        r->out[c] = calloc(n, sizeof(double));
        if (!r->scene[c] || !r->bright[c] || !r->glow[c] || !r->out[c])
            return -1;
    }
    if (scene_all(r, f, &used) < 0)
        return -1;
    if (p->bloom == SWITCH_ON && (p->psf_spec.kind != PSF_GAUSSIANS || bright_pass(r, f, &used) < 0 ||
                                  spread_all(r, f, &used) < 0))
        return -1;
    composite_all(r, f, &used);
    return 0;
}

void reference_take_glow(struct reference_result *r, const struct reference_frame *f, const struct params *p,
                         double weight)
{
    struct params used = *p;
    long double inside = 0, all = 0;
    used.exposure = r->exposure;
    for (unsigned c = 0; c < f->channels; c++) {
        for (size_t i = 0; i < pixels(f); i++) {
            inside += r->glow[c][grown(f, r, i)];
            all += (long double)weight * r->bright[c][grown(f, r, i)];
        }
        apply_dirt(r->glow[c], r, f, &used, c);
    }
    r->energy_bloomed = (double)(inside * p->intensity);
    r->energy_lost = (double)((all - inside) * p->intensity);
    composite_all(r, f, &used);
}

int reference_view(double *const out[3], const struct reference_result *r, const struct reference_frame *f,
                   const struct params *p, const struct view_spec *view)
{
    size_t n = (size_t)r->width * r->height;
    if (view->view == VIEW_LEVEL && view->level >= p->psf_spec.count)
        return -1;
    for (unsigned c = 0; c < f->channels; c++) {
        memset(out[c], 0, n * sizeof(double));
        if (view->view == VIEW_LEVEL) {
            if (p->bloom == SWITCH_ON && spread_one(out[c], NULL, r, f, p, view->level, c) < 0)
                return -1;
            apply_dirt(out[c], r, f, p, c);
        }
        for (size_t i = 0; i < n; i++)
            switch (view->view) {
            case VIEW_FINAL: out[c][i] = r->out[c][i]; break;
            case VIEW_SOURCE: out[c][i] = r->scene[c][i]; break;
            case VIEW_BRIGHT: out[c][i] = r->bright[c][i]; break;
            case VIEW_BLOOM: out[c][i] = p->intensity * r->glow[c][i]; break;
            case VIEW_LEVEL: out[c][i] *= p->intensity; break;
            case VIEW_RESIDUAL: out[c][i] = r->scene[c][i] - r->bright[c][i]; break;
            }
    }
    return 0;
}

void reference_free(struct reference_result *r)
{
    for (unsigned c = 0; c < 3; c++) {
        free(r->scene[c]);
        free(r->bright[c]);
        free(r->glow[c]);
        free(r->out[c]);
    }
    *r = (struct reference_result){ 0 };
}

double reference_worst(const double *a, const double *b, size_t n, size_t *at)
{
    double worst = 0;
    *at = 0;
    for (size_t i = 0; i < n; i++) {
        bool both = (isnan(a[i]) && isnan(b[i])) || a[i] == b[i];
        double d = both ? 0 : fabs(a[i] - b[i]);
        if (!(d <= worst)) { /* a lone NaN is the worst of all */
            worst = isnan(d) ? INFINITY : d;
            *at = i;
        }
    }
    return worst;
}
