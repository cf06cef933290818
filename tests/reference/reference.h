/* SPDX-License-Identifier: Apache-2.0 */
/*
 * reference.h - what a bloom is, in scalar float64: the truth that the engine's tests compare with. This
 * header is its manual. Dense and slow on purpose: no pyramid, no fitted taps, and no code shared with
 * the daemon but struct params and its enums, so that one mistake cannot be on both sides.
 *
 * Input: 1 or 3 planes of width x height doubles, row after row, no padding: the layer I of METHODS.
 *
 * 1. SANITISE. For the glow a NaN, an Inf or a negative sample counts as 0: it alone, not its pixel. The
 *    output sample of a nonfinite input sample is that sample, unchanged (keep), or 0 + glow (zero), or
 *    the frame is refused (reject: reference_bloom returns -1). Finite negatives stay in the output,
 *    with glow added. The other channels of a pixel with a nonfinite sample get their glow as any other.
 *
 * 2. EXPOSURE. T = threshold / 2^exposure. The knee is in the same unit, K = knee / 2^exposure; but for
 *    smoothstep, where it is a share of T, and stays.
 *
 * 3. BRIGHT PASS on the sanitised samples I; L = sum of luma[c] * I_c (of one plane: I itself).
 *      none        E = I
 *      channel     E_c = max(0, I_c - T)
 *      luminance   E = I * max(0, L - T) / L
 *      knee        K' = min(K, T); s = clamp(L - (T - K'), 0, 2K'); E = I * max(s^2 / 4K', L - T, 0) / L
 *                  (s^2 / 4K' is 0 when K' = 0); so T = 0 is E = I, black stays black,
 *                  and K' = T keeps its digits: T - K' is 0 then, not a rest of rounding
 *      smoothstep  E = I * t^2 (3 - 2t), t = clamp((L - (T - TK)) / 2TK, 0, 1);
 *                  when TK = 0: t = 1 where L > T, else 0
 *    With L <= 0, which only odd luma weights make of a lit pixel, E = 0 (luminance, knee, smoothstep).
 *    The guard max(L, epsilon) of METHODS is there for that: an engine may use any epsilon with which E
 *    is right to its rounding for every normal float.
 *
 * 4. SPREAD. B = sum of weight_i * (G_i convolved with E). G_i is separable; along each axis
 *      g[n] = exp(-n^2 / 2 sigma^2) / (the sum of that over all integers n),
 *    sampled at pixel distances, so that its sum is 1. Outside the frame E = 0, and light that leaves
 *    the frame is lost. Taps below 1e-17 of g[0] are cut. sigma counts pixels of the vertical axis:
 *    sigma_y = sigma, sigma_x = sigma / pixel_aspect (a pixel of aspect 2 is twice as wide as high, so
 *    the same glow has half as many pixels in x). In per cent, sigma = percent / 100 * diagonal, and
 *    diagonal = sqrt((width * pixel_aspect)^2 + height^2), in pixel heights.
 *
 * 5. COMPOSITE. out = I + intensity * B. Nothing clamps. (What a HALF output does above 65504 is the
 *    encoder's business. Where B = 0 all over, out == I; the daemon hands on the very bits, as of -0.0.)
 *
 * Energies are sums over all samples of all planes: input (finite samples as they are, negatives too),
 * bright (E), bloomed (intensity * B inside the frame), lost (intensity * B outside, worked out from the
 * taps that leave, not as a difference). bloomed + lost = intensity * sum of weights * bright.
 */
#ifndef AIRY_REFERENCE_H
#define AIRY_REFERENCE_H

#include <stdbool.h>
#include <stddef.h>

#include "params.h"

struct reference_frame {
    unsigned width, height;
    unsigned channels;      /* 1 or 3 */
    const double *plane[3]; /* the caller's */
    double luma[3];         /* of one plane: not looked at */
    double pixel_aspect;    /* > 0 */
};

struct reference_result {
    double *bright[3], *glow[3], *out[3]; /* E, B (without intensity), out; owned, width * height each */
    double max_bright;                    /* largest E */
    double energy_input, energy_bright, energy_bloomed, energy_lost;
    double threshold, knee; /* T and K' (smoothstep: K) in use */
};

/* 0, or -1: no memory, or nonfinite=reject and the frame has NaN or Inf. *r is reference_free's then,
 * too. */
int reference_bloom(struct reference_result *r, const struct reference_frame *f, const struct params *p);
void reference_free(struct reference_result *r);

/* Steps on their own, for tests of one pass. */
void reference_bright(double e[3], const double pixel[3], unsigned channels, const double luma[3],
                      const struct params *p);
/* sigma of Gaussian i along x and y, in pixels. */
void reference_sigma(double *x, double *y, const struct psf_gaussian *g,
                     const struct reference_frame *f);
/* Adds weight * (G * in) to out. Both width * height; out is not in. 0 or -1 (no memory). */
int reference_spread(double *out, const double *in, unsigned width, unsigned height, double sigma_x,
                     double sigma_y, double weight);

/* The worst difference of two planes, for messages. at: y * width + x of it. */
double reference_worst(const double *a, const double *b, size_t n, size_t *at);

#endif
