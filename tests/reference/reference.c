// SPDX-License-Identifier: Apache-2.0
// reference.c - reference.h's text as code, in its order. Loops run so that each output is a sum over
// inputs in rising order, and inputs of exactly 0 are passed over: that is all the speed there is.
#include "reference.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static double sanitised(double v) { return isfinite(v) && v > 0 ? v : 0; }

static double clamped(double v, double low, double high) { return v < low ? low : v > high ? high : v; }

/* ---- bright pass ------------------------------------------------------------------------------- */

static double threshold_in_use(const struct params *p) { return p->threshold / exp2(p->exposure); }

static double knee_in_use(const struct params *p)
{
    if (p->bright == BRIGHT_SMOOTHSTEP)
        return p->knee;
    return fmin(p->knee / exp2(p->exposure), threshold_in_use(p));
}

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

void reference_bright(double e[3], const double pixel[3], unsigned channels, const double luma[3],
                      const struct params *p)
{
    double L = 0;
    for (unsigned c = 0; c < channels; c++) {
        e[c] = sanitised(pixel[c]);
        L += (channels == 1 ? 1 : luma[c]) * e[c];
    }
    for (unsigned c = 0; c < channels; c++) {
        if (p->bright == BRIGHT_CHANNEL)
            e[c] = fmax(0, e[c] - threshold_in_use(p));
        else if (p->bright != BRIGHT_NONE)
            e[c] = L > 0 ? e[c] * share(L, p) : 0;
    }
}

/* ---- spread ----------------------------------------------------------------------------------------
 */

void reference_sigma(double *x, double *y, const struct psf_gaussian *g, const struct reference_frame *f)
{
    double diagonal = hypot(f->width * f->pixel_aspect, f->height);
    *y = g->sigma.unit == SIZE_PERCENT ? g->sigma.value / 100 * diagonal : g->sigma.value;
    *x = *y / f->pixel_aspect;
}

struct axis {
    double *g;    /* taps -(n-1) .. n-1 at g[0 .. 2n-2]; 0 where cut */
    double *lost; /* [n]: what a source at i puts outside 0..n-1 */
    unsigned n;
};

static void axis_finish(struct axis *a)
{
    free(a->g);
    free(a->lost);
}

static int axis_init(struct axis *a, unsigned n, double sigma)
{
    long radius = (long)ceil(sigma * sqrt(2 * log(1e17)));
    double *half = calloc((size_t)(radius > (long)n ? radius : (long)n) + 1, sizeof(double));
    double *tail = calloc((size_t)(radius > (long)n ? radius : (long)n) + 2, sizeof(double));
    *a = (struct axis){ calloc(2 * (size_t)n, sizeof(double)), calloc(n, sizeof(double)), n };
    int r = half && tail && a->g && a->lost ? 0 : -1;
    long last = radius > (long)n ? radius : (long)n;
    long double sum = 0;
    for (long i = radius; r == 0 && i >= 0; i--) {
        half[i] = exp(-.5 * ((double)i / sigma) * ((double)i / sigma));
        half[i] = half[i] < 1e-17 ? 0 : half[i];
        sum += (i ? 2 : 1) * (long double)half[i];
    }
    for (long i = last; r == 0 && i >= 0; i--) {
        half[i] = (double)(half[i] / sum);
        tail[i] = tail[i + 1] + half[i]; /* of i and all beyond it, on one side */
    }
    for (long i = 0; r == 0 && i < (long)n; i++) {
        a->g[(long)n - 1 + i] = a->g[(long)n - 1 - i] = half[i];
        a->lost[i] = tail[i + 1] + tail[(long)n - i];
    }
    free(half);
    free(tail);
    if (r < 0)
        axis_finish(a);
    return r;
}

/* out[0..n) += v * g(distance from i). */
static void splat(double *restrict out, const double *restrict g, double v, size_t n)
{
    for (size_t k = 0; k < n; k++)
        out[k] += v * g[k];
}

static void add_scaled(double *restrict out, const double *restrict in, double v, size_t n)
{
    for (size_t k = 0; k < n; k++)
        out[k] += v * in[k];
}

static int spread(double *out, const double *in, const struct axis *ax, const struct axis *ay,
                  double weight)
{
    size_t w = ax->n, h = ay->n;
    double *across = calloc(w * h, sizeof(double));
    bool *lit = calloc(h, sizeof(bool));
    int r = across && lit ? 0 : -1;
    for (size_t y = 0; r == 0 && y < h; y++)
        for (size_t x = 0; x < w; x++)
            if (in[y * w + x] != 0) {
                splat(across + y * w, ax->g + (w - 1 - x), in[y * w + x], w);
                lit[y] = true;
            }
    for (size_t y = 0; r == 0 && y < h; y++)
        for (size_t k = 0; k < h; k++) {
            double g = ay->g[h - 1 + y - k];
            if (lit[k] && g != 0)
                add_scaled(out + y * w, across + k * w, weight * g, w);
        }
    free(lit);
    free(across);
    return r;
}

int reference_spread(double *out, const double *in, unsigned width, unsigned height, double sigma_x,
                     double sigma_y, double weight)
{
    struct axis ax, ay;
    if (axis_init(&ax, width, sigma_x) < 0)
        return -1;
    if (axis_init(&ay, height, sigma_y) < 0) {
        axis_finish(&ax);
        return -1;
    }
    int r = spread(out, in, &ax, &ay, weight);
    axis_finish(&ax);
    axis_finish(&ay);
    return r;
}

/* What of weight * (G * in) falls outside the frame: 1 - a(x) b(y) = lost(x) + (1 - lost(x)) lost(y). */
static int spread_lost(long double *lost, const double *in, unsigned width, unsigned height,
                       double sigma_x, double sigma_y, double weight)
{
    struct axis ax, ay;
    if (axis_init(&ax, width, sigma_x) < 0)
        return -1;
    if (axis_init(&ay, height, sigma_y) < 0) {
        axis_finish(&ax);
        return -1;
    }
    for (size_t y = 0; y < height; y++)
        for (size_t x = 0; x < width; x++)
            *lost += (long double)weight * in[y * width + x] *
                     (ax.lost[x] + (1 - (long double)ax.lost[x]) * ay.lost[y]);
    axis_finish(&ax);
    axis_finish(&ay);
    return 0;
}

/* ---- the whole ---------------------------------------------------------------------------------------
 */

static int bright_pass(struct reference_result *r, const struct reference_frame *f,
                       const struct params *p)
{
    size_t n = (size_t)f->width * f->height;
    long double input = 0, bright = 0;
    for (size_t i = 0; i < n; i++) {
        double pixel[3] = { 0 }, e[3];
        for (unsigned c = 0; c < f->channels; c++) {
            pixel[c] = f->plane[c][i];
            if (isfinite(pixel[c]))
                input += pixel[c];
            else if (p->nonfinite == NONFINITE_REJECT)
                return -1;
        }
        reference_bright(e, pixel, f->channels, f->luma, p);
        for (unsigned c = 0; c < f->channels; c++) {
            r->bright[c][i] = e[c];
            bright += e[c];
            r->max_bright = fmax(r->max_bright, e[c]);
        }
    }
    r->energy_input = (double)input;
    r->energy_bright = (double)bright;
    return 0;
}

static double composite(double in, double glow, const struct params *p)
{
    if (isfinite(in))
        return in + p->intensity * glow;
    return p->nonfinite == NONFINITE_KEEP ? in : p->intensity * glow;
}

int reference_bloom(struct reference_result *r, const struct reference_frame *f, const struct params *p)
{
    size_t n = (size_t)f->width * f->height;
    long double bloomed = 0, lost = 0;
    *r = (struct reference_result){ .threshold = threshold_in_use(p), .knee = knee_in_use(p) };
    for (unsigned c = 0; c < f->channels; c++) {
        r->bright[c] = calloc(n, sizeof(double));
        r->glow[c] = calloc(n, sizeof(double));
        r->out[c] = calloc(n, sizeof(double));
        if (!r->bright[c] || !r->glow[c] || !r->out[c])
            return -1;
    }
    if (bright_pass(r, f, p) < 0)
        return -1;
    for (unsigned c = 0; c < f->channels; c++) {
        for (unsigned i = 0; i < p->psf_spec.count; i++) {
            const struct psf_gaussian *g = &p->psf_spec.gaussian[i];
            double sx, sy;
            reference_sigma(&sx, &sy, g, f);
            if (reference_spread(r->glow[c], r->bright[c], f->width, f->height, sx, sy, g->weight) < 0 ||
                spread_lost(&lost, r->bright[c], f->width, f->height, sx, sy, g->weight) < 0)
                return -1;
        }
        for (size_t i = 0; i < n; i++) {
            r->out[c][i] = composite(f->plane[c][i], r->glow[c][i], p);
            bloomed += r->glow[c][i];
        }
    }
    r->energy_bloomed = (double)(bloomed * p->intensity);
    r->energy_lost = (double)(lost * p->intensity);
    return 0;
}

void reference_free(struct reference_result *r)
{
    for (unsigned c = 0; c < 3; c++) {
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
