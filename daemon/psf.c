// SPDX-License-Identifier: Apache-2.0
// psf.c - see psf.h. Errors are found by doing, not by formula: a unit source is sent through the very
// filters that the shaders apply, so whatever truncation or clamping did to the taps is in the result.
#include "psf.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { QUADRATURE = 2048, PHASES_MAX = 64 };

const double *psf_binomial(unsigned order)
{
    static const double b4[] = { 1 / 8.0, 3 / 8.0 };
    static const double b6[] = { 1 / 32.0, 5 / 32.0, 10 / 32.0 };
    static const double b8[] = { 1 / 128.0, 7 / 128.0, 21 / 128.0, 35 / 128.0 };
    return order == 4 ? b4 : order == 6 ? b6 : b8;
}

static double tap_of(unsigned order, unsigned k)
{
    return psf_binomial(order)[k < order / 2 ? k : order - 1 - k];
}

static void sampled_gaussian(struct psf_taps *out, double sigma)
{
    for (unsigned n = 0; n <= out->half; n++)
        out->tap[n] = exp(-(double)n * n / (2 * sigma * sigma));
}

// |H| of b_n at w is cos(w/2)^(n-1); level M's frequency W is W/M on the finest grid.
static void compensated(struct psf_taps *out, double sigma, unsigned level, const unsigned char *order)
{
    const double m = ldexp(1, (int)level);
    double *k = out->tap;
    memset(k, 0, (out->half + 1) * sizeof(*k));
    for (unsigned q = 0; q < QUADRATURE; q++) {
        const double big_w = (q + 0.5) * M_PI / QUADRATURE, w = big_w / m;
        double d = 1;
        for (unsigned i = 0; i < level; i++)
            d *= pow(cos(ldexp(w, (int)i) / 2), order[i] - 1);
        const double g = exp(-sigma * sigma * w * w / 2) / (d * d);
        // cos(n W) by recurrence would drift; n is small and this runs once per plan.
        for (unsigned n = 0; n <= out->half; n++)
            k[n] += g * cos(n * big_w);
    }
}

void psf_gaussian_taps(struct psf_taps *out, double sigma, unsigned level, const unsigned char *order,
                       unsigned half)
{
    out->half = half;
    if (level == 0)
        sampled_gaussian(out, sigma);
    else
        compensated(out, sigma, level, order);
    double sum = 0;
    for (unsigned n = 0; n <= half; n++) {
        out->tap[n] = fmax(out->tap[n], 0);
        sum += n ? 2 * out->tap[n] : out->tap[n];
    }
    for (unsigned n = 0; n <= half; n++)
        out->tap[n] /= sum;
}

/* A run of cells first .. first + count - 1; everything outside is 0. */
struct run {
    long first, count;
    double *v;
};

static double at(const struct run *r, long i)
{
    return i >= r->first && i < r->first + r->count ? r->v[i - r->first] : 0;
}

static long floor_half(long i) { return i >= 0 ? i / 2 : -((1 - i) / 2); }

static void run_down(struct run *out, const struct run *in, unsigned n)
{
    const long h = n / 2 - 1;
    out->first = floor_half(in->first + h - (long)n + 1);
    out->count = floor_half(in->first + in->count - 1 + h) - out->first + 1;
    for (long j = 0; j < out->count; j++) {
        double s = 0;
        for (unsigned k = 0; k < n; k++)
            s += tap_of(n, k) * at(in, 2 * (out->first + j) + (long)k - h);
        out->v[j] = s;
    }
}

static void run_up(struct run *out, const struct run *in, unsigned n)
{
    const long h = n / 2 - 1;
    out->first = 2 * in->first - h;
    out->count = 2 * in->count + 2 * h;
    memset(out->v, 0, (size_t)out->count * sizeof(double));
    for (long j = 0; j < in->count; j++)
        for (unsigned k = 0; k < n; k++)
            out->v[2 * j + (long)k] += 2 * tap_of(n, k) * in->v[j];
}

static void run_blur(struct run *out, const struct run *in, const struct psf_taps *t)
{
    const long h = t->half;
    out->first = in->first - h;
    out->count = in->count + 2 * h;
    memset(out->v, 0, (size_t)out->count * sizeof(double));
    for (long j = 0; j < in->count; j++)
        for (long k = -h; k <= h; k++)
            out->v[j + k + h] += t->tap[labs(k)] * in->v[j];
}

static void swap(struct run *a, struct run *b)
{
    struct run t = *a;
    *a = *b;
    *b = t;
}

static void compare(struct psf_error *worst, const struct run *r, long source, double sigma, double norm)
{
    // Past the response and past 9 sigma nothing is left to count.
    const long reach = (long)ceil(9 * sigma) + 1;
    long lo = r->first < source - reach ? r->first : source - reach;
    long hi = r->first + r->count - 1 > source + reach ? r->first + r->count - 1 : source + reach;
    double l1 = 0, peak = 0;
    for (long x = lo; x <= hi; x++) {
        const double d = (double)(x - source);
        const double e = fabs(at(r, x) - exp(-d * d / (2 * sigma * sigma)) / norm);
        l1 += e;
        peak = fmax(peak, e * norm);
    }
    worst->l1 = fmax(worst->l1, l1);
    worst->peak = fmax(worst->peak, peak);
}

int psf_gaussian_error(struct psf_error *out, double sigma, unsigned level, const unsigned char *order,
                       const struct psf_taps *taps)
{
    const long m = 1L << level;
    const size_t room = (size_t)((2 * taps->half + 32) * m + 64);
    double *memory = malloc(2 * room * sizeof(double));
    if (!memory)
        return -ENOMEM;
    double norm = 1;
    for (long x = 1; x < 9 * sigma + 1; x++)
        norm += 2 * exp(-(double)x * x / (2 * sigma * sigma));
    const long phases = m < PHASES_MAX ? m : PHASES_MAX;
    struct psf_error worst = { 0 };
    // Phases p and m-1-p mirror each other.
    for (long i = 0; i < (phases + 1) / 2; i++) {
        const long source = i * m / phases;
        struct run a = { source, 1, memory }, b = { .v = memory + room };
        a.v[0] = 1;
        for (unsigned o = 0; o < level; o++, swap(&a, &b))
            run_down(&b, &a, order[o]);
        run_blur(&b, &a, taps);
        swap(&a, &b);
        for (unsigned o = level; o-- > 0; swap(&a, &b))
            run_up(&b, &a, order[o]);
        compare(&worst, &a, source, sigma, norm);
    }
    free(memory);
    // The error over the phase is dominated by its first harmonic: between 64 samples of a period it
    // can rise by (pi/64)^2/2 = 0.12 %.
    const double margin = m > PHASES_MAX ? 1.01 : 1;
    *out = (struct psf_error){ worst.l1 * margin, worst.peak * margin };
    return 0;
}
