// SPDX-License-Identifier: Apache-2.0
// fft.c - see fft.h. Stockham's self-sorting form, decimation in frequency: at each stage the inner loop
// runs over s * LANES consecutive numbers with one twiddle, so it vectorises without shuffles and needs
// no bit reversal. The stage's length is n = radix * m; element q + s * (p + m * r) goes to q + s *
// (radix * p + r), times w^(p r).
#include "fft.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>

#define INLINE static inline __attribute__((always_inline))

struct stage {
    const double *xr, *xi; /* read */
    double *yr, *yi;       /* written */
    const double *twiddle;
    size_t m, s; /* s: numbers of one run, lanes included */
};

INLINE void radix2(struct stage g)
{
    for (size_t p = 0; p < g.m; p++) {
        const double wr = g.twiddle[2 * p], wi = g.twiddle[2 * p + 1];
        const double *restrict ar = g.xr + g.s * p, *restrict ai = g.xi + g.s * p;
        const double *restrict br = ar + g.s * g.m, *restrict bi = ai + g.s * g.m;
        double *restrict yr = g.yr + g.s * 2 * p, *restrict yi = g.yi + g.s * 2 * p;
        for (size_t q = 0; q < g.s; q++) {
            const double dr = ar[q] - br[q], di = ai[q] - bi[q];
            yr[q] = ar[q] + br[q];
            yi[q] = ai[q] + bi[q];
            yr[q + g.s] = dr * wr - di * wi;
            yi[q + g.s] = dr * wi + di * wr;
        }
    }
}

INLINE void radix3(struct stage g)
{
    const double half_root = 0.86602540378443864676;
    for (size_t p = 0; p < g.m; p++) {
        const double *w = g.twiddle + 4 * p;
        const double w1r = w[0], w1i = w[1], w2r = w[2], w2i = w[3];
        const double *restrict xr = g.xr + g.s * p, *restrict xi = g.xi + g.s * p;
        double *restrict yr = g.yr + g.s * 3 * p, *restrict yi = g.yi + g.s * 3 * p;
        const size_t b = g.s * g.m, c = 2 * b;
        for (size_t q = 0; q < g.s; q++) {
            const double sr = xr[q + b] + xr[q + c], si = xi[q + b] + xi[q + c];
            const double tr = xr[q] - 0.5 * sr, ti = xi[q] - 0.5 * si;
            const double dr = half_root * (xr[q + b] - xr[q + c]),
                         di = half_root * (xi[q + b] - xi[q + c]);
            const double ur = tr + di, ui = ti - dr, vr = tr - di, vi = ti + dr;
            yr[q] = xr[q] + sr;
            yi[q] = xi[q] + si;
            yr[q + g.s] = ur * w1r - ui * w1i;
            yi[q + g.s] = ur * w1i + ui * w1r;
            yr[q + 2 * g.s] = vr * w2r - vi * w2i;
            yi[q + 2 * g.s] = vr * w2i + vi * w2r;
        }
    }
}

INLINE void radix4(struct stage g)
{
    for (size_t p = 0; p < g.m; p++) {
        const double *w = g.twiddle + 6 * p;
        const double w1r = w[0], w1i = w[1], w2r = w[2], w2i = w[3], w3r = w[4], w3i = w[5];
        const double *restrict xr = g.xr + g.s * p, *restrict xi = g.xi + g.s * p;
        double *restrict yr = g.yr + g.s * 4 * p, *restrict yi = g.yi + g.s * 4 * p;
        const size_t b = g.s * g.m, c = 2 * b, d = 3 * b;
        for (size_t q = 0; q < g.s; q++) {
            const double pr = xr[q] + xr[q + c], pi = xi[q] + xi[q + c];
            const double mr = xr[q] - xr[q + c], mi = xi[q] - xi[q + c];
            const double sr = xr[q + b] + xr[q + d], si = xi[q + b] + xi[q + d];
            const double dr = xr[q + b] - xr[q + d], di = xi[q + b] - xi[q + d];
            const double ur = mr + di, ui = mi - dr, vr = pr - sr, vi = pi - si, tr = mr - di,
                         ti = mi + dr;
            yr[q] = pr + sr;
            yi[q] = pi + si;
            yr[q + g.s] = ur * w1r - ui * w1i;
            yi[q + g.s] = ur * w1i + ui * w1r;
            yr[q + 2 * g.s] = vr * w2r - vi * w2i;
            yi[q + 2 * g.s] = vr * w2i + vi * w2r;
            yr[q + 3 * g.s] = tr * w3r - ti * w3i;
            yi[q + 3 * g.s] = tr * w3i + ti * w3r;
        }
    }
}

INLINE void radix5(struct stage g)
{
    const double c1 = 0.30901699437494742410, s1 = 0.95105651629515357212;
    const double c2 = -0.80901699437494742410, s2 = 0.58778525229247312917;
    for (size_t p = 0; p < g.m; p++) {
        const double *w = g.twiddle + 8 * p;
        const double w1r = w[0], w1i = w[1], w2r = w[2], w2i = w[3];
        const double w3r = w[4], w3i = w[5], w4r = w[6], w4i = w[7];
        const double *restrict xr = g.xr + g.s * p, *restrict xi = g.xi + g.s * p;
        double *restrict yr = g.yr + g.s * 5 * p, *restrict yi = g.yi + g.s * 5 * p;
        const size_t b = g.s * g.m, c = 2 * b, d = 3 * b, e = 4 * b;
        for (size_t q = 0; q < g.s; q++) {
            const double ar = xr[q + b] + xr[q + e], ai = xi[q + b] + xi[q + e];
            const double br = xr[q + c] + xr[q + d], bi = xi[q + c] + xi[q + d];
            const double er = xr[q + b] - xr[q + e], ei = xi[q + b] - xi[q + e];
            const double fr = xr[q + c] - xr[q + d], fi = xi[q + c] - xi[q + d];
            const double t1r = xr[q] + c1 * ar + c2 * br, t1i = xi[q] + c1 * ai + c2 * bi;
            const double t2r = xr[q] + c2 * ar + c1 * br, t2i = xi[q] + c2 * ai + c1 * bi;
            const double u1r = s1 * er + s2 * fr, u1i = s1 * ei + s2 * fi;
            const double u2r = s2 * er - s1 * fr, u2i = s2 * ei - s1 * fi;
            const double k1r = t1r + u1i, k1i = t1i - u1r, k4r = t1r - u1i, k4i = t1i + u1r;
            const double k2r = t2r + u2i, k2i = t2i - u2r, k3r = t2r - u2i, k3i = t2i + u2r;
            yr[q] = xr[q] + ar + br;
            yi[q] = xi[q] + ai + bi;
            yr[q + g.s] = k1r * w1r - k1i * w1i;
            yi[q + g.s] = k1r * w1i + k1i * w1r;
            yr[q + 2 * g.s] = k2r * w2r - k2i * w2i;
            yi[q + 2 * g.s] = k2r * w2i + k2i * w2r;
            yr[q + 3 * g.s] = k3r * w3r - k3i * w3i;
            yi[q + 3 * g.s] = k3r * w3i + k3i * w3r;
            yr[q + 4 * g.s] = k4r * w4r - k4i * w4i;
            yi[q + 4 * g.s] = k4r * w4i + k4i * w4r;
        }
    }
}

INLINE void stages_run(const struct fft *f, struct fft_batch x, struct fft_batch y)
{
    const double *twiddle = f->twiddle;
    size_t n = f->n, s = FFT_LANES;
    for (unsigned i = 0; i < f->stages; i++) {
        const unsigned r = f->radix[i];
        const size_t m = n / r;
        const struct stage g = { x.re, x.im, y.re, y.im, twiddle, m, s };
        if (r == 4)
            radix4(g);
        else if (r == 2)
            radix2(g);
        else if (r == 3)
            radix3(g);
        else
            radix5(g);
        twiddle += 2 * m * (r - 1);
        n = m;
        s *= r;
        const struct fft_batch t = x;
        x = y;
        y = t;
    }
}

#if defined(__x86_64__)
__attribute__((target("avx2"))) static void run_avx2(const struct fft *f, struct fft_batch z,
                                                     struct fft_batch work)
{
    stages_run(f, z, work);
}
#endif

static void run_plain(const struct fft *f, struct fft_batch z, struct fft_batch work)
{
    stages_run(f, z, work);
}

struct fft_batch fft_run(const struct fft *f, struct fft_batch z, struct fft_batch work, bool inverse)
{
    // The inverse is the forward transform with real and imaginary parts exchanged on both sides.
    struct fft_batch a = inverse ? (struct fft_batch){ z.im, z.re } : z;
    struct fft_batch b = inverse ? (struct fft_batch){ work.im, work.re } : work;
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2"))
        run_avx2(f, a, b);
    else
#endif
        run_plain(f, a, b);
    return f->stages % 2 ? work : z;
}

uint32_t fft_length(uint32_t n)
{
    for (uint32_t length = n > 1 ? n : 1;; length++) {
        uint32_t rest = length;
        while (rest % 2 == 0)
            rest /= 2;
        while (rest % 3 == 0)
            rest /= 3;
        while (rest % 5 == 0)
            rest /= 5;
        if (rest == 1)
            return length;
    }
}

static void factors_find(struct fft *f)
{
    static const unsigned char order[] = { 5, 3, 4, 2 };
    uint32_t n = f->n;
    for (unsigned i = 0; i < sizeof(order); i++)
        for (; n % order[i] == 0; n /= order[i])
            f->radix[f->stages++] = order[i];
}

int fft_init(struct fft *f, uint32_t n)
{
    *f = (struct fft){ .n = n };
    factors_find(f);
    // Stage sizes n, n/r, ...: m (r - 1) pairs each telescope to n - 1 in all.
    f->twiddle = malloc((size_t)n * 2 * sizeof(*f->twiddle));
    if (!f->twiddle)
        return -ENOMEM;
    double *w = f->twiddle;
    for (unsigned i = 0, length = n; i < f->stages; length /= f->radix[i++])
        for (unsigned p = 0; p < length / f->radix[i]; p++)
            for (unsigned r = 1; r < f->radix[i]; r++) {
                // In long double, so that each factor is right to its last bit but a few.
                const long double turn = -2 * 3.14159265358979323846264338327950288L * p * r / length;
                *w++ = (double)cosl(turn);
                *w++ = (double)sinl(turn);
            }
    return 0;
}

void fft_finish(struct fft *f)
{
    free(f->twiddle);
    *f = (struct fft){ 0 };
}

struct fft_rounding fft_rounding(const struct fft *f)
{
    // d: roundings on the longest way through a butterfly, constants included. Its error per output is
    // <= d u sum |a|, by Cauchy-Schwarz <= d u sqrt(r) of the outputs' norm; the twiddle adds sqrt(2) *
    // (2 + 1/sqrt(2)) u < 4 u.
    static const double depth[6] = { [2] = 1, [3] = 4, [4] = 2, [5] = 6 };
    const double u = 0x1p-53;
    struct fft_rounding e = { 0, 0 };
    for (unsigned i = 0; i < f->stages; i++) {
        const unsigned r = f->radix[i];
        e.norm += u * (depth[r] * sqrt(r) + 4);
        // Real and imaginary part each: sqrt(2) of the modulus.
        e.each += u * (depth[r] * M_SQRT2 + 4);
    }
    return (struct fft_rounding){ e.norm * 1.01, e.each * 1.01 };
}
