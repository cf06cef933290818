/* SPDX-License-Identifier: Apache-2.0 */
/*
 * psf.h - Gaussians on a pyramid of binomial filters, in one dimension: compensated taps, and the error
 * that they leave, computed (METHODS section 3.1). Pure arithmetic in double.
 *
 * Octave i leads from level i to level i+1. Its filter "b_n" has n = order[i] taps C(n-1,k)/2^(n-1),
 * n = 4, 6 or 8, down and (transposed, times 2) up; level i+1's cell j sits between cells 2j and 2j+1 of
 * level i. "Exact" is the Gaussian sampled at whole pixels, exp(-x^2/2 sigma^2), normalised to sum 1.
 */
#ifndef AIRYD_PSF_H
#define AIRYD_PSF_H

enum { PSF_LEVELS_MAX = 12, PSF_TAPS_MAX = 40 };

struct psf_taps {
    unsigned half;               /* taps at -half..half */
    double tap[PSF_TAPS_MAX + 1]; /* tap[0] the middle; >= 0; sum over both sides 1 */
};

/*
 * Errors of one axis, worst over the source's phase: l1 = sum |response - exact|, peak = max
 * |response - exact| / exact's peak. For a separable kernel with axes x and y the two-dimensional L1 error is
 * <= l1_x + l1_y (both responses sum to 1), and the peak error is <= peak_x + peak_y + peak_x * peak_y.
 */
struct psf_error {
    double l1, peak;
};

/* The level's kernel for `sigma` level-0 pixels at level `level` with these octaves below it, closed form:
 * k[n] = 1/pi int_0^pi exp(-sigma^2 (W/M)^2 / 2) / (D(W/M) U(W/M)) cos(nW) dW, truncated, clamped to >= 0,
 * normalised. level 0: the sampled Gaussian. half <= PSF_TAPS_MAX. */
void psf_gaussian_taps(struct psf_taps *out, double sigma, unsigned level,
                       const unsigned char *order, unsigned half);

/* Runs unit sources of all phases (at most 64, evenly spread, with a margin for those between) through
 * down, taps and up, and compares. 0, or -ENOMEM. */
int psf_gaussian_error(struct psf_error *out, double sigma, unsigned level,
                       const unsigned char *order, const struct psf_taps *taps);

/* Taps of b_n: n/2 of them, from the outermost in (the filter is symmetric). */
const double *psf_binomial(unsigned order);

#endif
