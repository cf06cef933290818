/* SPDX-License-Identifier: Apache-2.0 */
/*
 * reference.h - what a bloom is, in scalar float64: the truth that the engine's tests compare with. This
 * header is its manual. Dense and slow on purpose: no pyramid, no fitted taps, and no code shared with
 * the daemon but struct params and its enums, so that one mistake cannot be on both sides.
 *
 * Input: 1 or 3 planes of width x height doubles, row after row, no padding: the layer I of METHODS. Beside it, when
 * given: a source S of the same shape, a matte M of one plane, a dirt image D. "sanitised" v is v when finite and > 0, else 0.
 *
 * Only psfs that are sums of Gaussians; of the others the caller makes B, and hands it to reference_take_glow.
 *
 * 1. SANITISE. For the glow a NaN, an Inf or a negative sample counts as 0: it alone, not its pixel. The
 *    output sample of a nonfinite input sample is that sample, unchanged (keep), or 0 + glow (zero), or
 *    the frame is refused (reject: reference_bloom returns -1). Finite negatives stay in the output,
 *    with glow added. The other channels of a pixel with a nonfinite sample get their glow as any other. (With a display
 *    transform a nonfinite sample is handed on, or is 0 + glow and transformed.)
 *
 * 2. EXPOSURE. EV = exposure, or, auto: of the pixels of I whose luminance L (sanitised samples) is a finite number > 0, a histogram of
 *    256 equal bins of log2 L over -16 .. 16 (beyond it: the end bins; a normal float's log2 taken in float32, so that a
 *    pixel within 1e-6 of a bin's edge may be counted on either side); with N counted, meter_dark % of N are taken away from the dark end
 *    and meter_bright % of N from the bright end (fractions of a bin allowed); of what is left the mean of 2^(bin's middle) is
 *    m; EV = log2(key / m) within -32 .. 32. Nothing left: EV = 0.
 *    T = t / 2^EV with t = threshold (linear) or 2^threshold (stops). The knee is in scene-linear too, K = knee / 2^EV; but for
 *    smoothstep, where it is a share of T, and stays.
 *
 * 3. SOURCE of the glow: S, or I. With a matte m = sanitised M: the source is S * m * emission, and the scene that is composited is
 *    I' = I * (1 + m * (emission - 1)); without, I' = I, and emission counts for nothing. Sanitised after that.
 *    FIREFLY F > 0: with l the source's luminance and n the mean of l over those of the 8 neighbours that lie in the frame, the pixel
 *    is multiplied by min(1, F * n / l) where l > 0. (No neighbour: nothing is done.)
 *
 * 4. BRIGHT PASS on that source s; L = sum of luma[c] * s_c (of one plane: s itself).
 *      none        E = s
 *      channel     E_c = max(0, s_c - T)
 *      luminance   E = s * max(0, L - T) / L
 *      knee        K' = min(K, T); q = clamp(L - (T - K'), 0, 2K'); E = s * max(q^2 / 4K', L - T, 0) / L
 *                  (q^2 / 4K' is 0 when K' = 0); so T = 0 is E = s, black stays black,
 *                  and K' = T keeps its digits: T - K' is 0 then, not a rest of rounding
 *      smoothstep  E = s * t^2 (3 - 2t), t = clamp((L - (T - TK)) / 2TK, 0, 1);
 *                  when TK = 0: t = 1 where L > T, else 0
 *    With L <= 0, which only odd luma weights make of a lit pixel, E = 0 (luminance, knee, smoothstep).
 *    The guard max(L, epsilon) of METHODS is there for that: an engine may use any epsilon with which E
 *    is right to its rounding for every normal float.
 *    CLAMP C > 0: with l the luminance of E, E is multiplied by C / l where l > C.
 *
 * 5. SPREAD. B_c = sum of weight_i * tint_i,c * gain_i * (G_i convolved with E_c); of one plane the tint is the mean of the three.
 *    gain_i = near + (far - near) * u, u = log(sigma_i / smallest) / log(largest / smallest) over the psf's sigmas in pixels (one
 *    sigma, or all alike: u = 0). G_i is separable; along each axis
 *      g[n] = exp(-n^2 / 2 sigma^2) / (the sum of that over all integers n),
 *    sampled at pixel distances, so that its sum is 1. Outside the frame E = 0 (edge=zero; light that leaves
 *    the frame is lost), or E of the nearest pixel of the frame (edge=fill). Taps below 1e-17 of g[0] are cut. sigma counts pixels of
 *    the vertical axis: sigma_y = sigma, sigma_x = sigma / pixel_aspect (a pixel of aspect 2 is twice as wide as high, so
 *    the same glow has half as many pixels in x). In per cent, sigma = percent / 100 * diagonal, and
 *    diagonal = sqrt((width * pixel_aspect)^2 + height^2), in pixel heights. In mm, sigma = mm / sensor * display_width *
 *    pixel_aspect. GROW n: B is also wanted n pixels beyond the frame on each side, where I is 0 (with edge=fill too).
 *    DIRT: B_c is multiplied by 1 - dirt_gain + dirt_gain * D_c, D taken bilinearly: output pixel (x, y) of the frame grown to W x H
 *    looks at ((x + .5) * dw / W - .5, (y + .5) * dh / H - .5) of the dw x dh image, clamped to its border; of one plane D is the mean.
 *
 * 6. COMPOSITE, k = intensity. add: out = I' + k B. mix: out = I' + k (B - E). screen-add: out = tone(I') + k B, then what follows the tone
 *    map. bloom=off: out = I'... with no matte, I; and B = E = 0.
 *    Beyond the frame (GROW) I' and E are 0: out = k B there. Of a nonfinite sample's I' the 0 of "zero" is taken, and that of "keep" is
 *    put back at the very end; so, with a display, it counts as 0 + glow in the saturation of its pixel's other channels.
 *    Nothing clamps. (What a HALF output does above 65504 is the
 *    encoder's business. Where B = 0 all over, out == I; the daemon hands on the very bits, as of -0.0.)
 *
 * 7. DISPLAY, when one of display, saturation, encoding is not at its default: v = max(0, out * 2^EV); tone: reinhard v / (v + 1), aces
 *    v (2.51 v + .03) / (v (2.43 v + .59) + .14); saturation, of three planes: l = sum luma[c] v_c, v = max(0, l + saturation (v - l));
 *    encoding: v^(1/2.2), or sRGB's (12.92 v to .0031308, else 1.055 v^(1/2.4) - .055). For screen-add tone(I') is v after the tone
 *    map, k B is added, and saturation and encoding follow.
 *
 * 8. VIEW. final: out. source: I'. bright: E. bloom: k B (dirt included). level:N: of k B only Gaussian N's part. residual: I' - E. Only
 *    final passes the display. Extra layers are views.
 *
 * Energies are sums over all samples of all planes: input (finite samples as they are, negatives too),
 * bright (E), bloomed (intensity * B inside the frame), lost (intensity * B outside, worked out from the
 * taps that leave, not as a difference). bloomed + lost = intensity * sum of weights * bright. Inside is the
 * frame as it came, whatever grow; B before the dirt. With edge=fill lost is 0 and bloomed what is inside.
 * suppressed: the E of the source without firefly less that with it, both without clamp; clamped: that less bright.
 * So bright + clamped + suppressed is the E of neither. All of them but input are 0 with bloom=off.
 */
#ifndef AIRY_REFERENCE_H
#define AIRY_REFERENCE_H

#include <stdbool.h>
#include <stddef.h>

#include "params.h"

struct reference_frame {
    unsigned width, height;
    unsigned channels;      /* 1 or 3 */
    const double *plane[3]; /* the caller's, as are all pointers here */
    double luma[3];         /* of one plane: not looked at */
    double pixel_aspect;    /* > 0 */
    /* What may stay 0. */
    const double *source[3]; /* width x height, as many as channels; [0] NULL: I */
    const double *matte;     /* width x height */
    const double *dirt;      /* interleaved R G B */
    unsigned dirt_width, dirt_height;
    unsigned grow;          /* pixels; what params->grow_size comes to */
    unsigned display_width; /* for sizes in mm; 0: width */
};

struct reference_result {
    unsigned width, height; /* the frame's + 2 grow; planes are owned, width * height, 0 beyond the frame */
    double *scene[3];       /* I', nonfinite samples by the policy */
    double *bright[3], *glow[3], *out[3]; /* E, B (dirt in it, without intensity), view final */
    double max_bright;                    /* largest E */
    double energy_input, energy_bright, energy_bloomed, energy_lost, energy_clamped, energy_suppressed;
    double exposure;        /* EV in use */
    double threshold, knee; /* T and K' (smoothstep: K) in use */
};

/* 0, or -1: no memory, a psf that is no sum of Gaussians, or nonfinite=reject and the frame has NaN or Inf. *r is
 * reference_free's then, too. */
int reference_bloom(struct reference_result *r, const struct reference_frame *f, const struct params *p);
void reference_free(struct reference_result *r);
/* For a psf that is no sum of Gaussians: *r is reference_bloom's of the same f and p, but with a psf of no Gaussians, and glow[c] has
 * got the spread E of r->bright, weight included. Makes sections 5's ledger and dirt, and 6 and 7 of it. weight: the psf's. */
void reference_take_glow(struct reference_result *r, const struct reference_frame *f, const struct params *p,
                         double weight);
/* A view of what reference_bloom made of the same f and p, into out[channels] of r's size. 0 or -1 (no memory, no such
 * Gaussian). */
int reference_view(double *const out[3], const struct reference_result *r, const struct reference_frame *f,
                   const struct params *p, const struct view_spec *view);

/* Steps on their own, for tests of one pass. In these exposure=auto counts as exposure. */
void reference_bright(double e[3], const double pixel[3], unsigned channels, const double luma[3],
                      const struct params *p);
/* EV. near_edges (may be NULL): pixels within 1e-6 of the edge of a bin, in log2 L. */
double reference_exposure(const struct reference_frame *f, const struct params *p, size_t *near_edges);
/* Sections 6 and 7 for one pixel of finite samples. Each result rises with its own glow and moves one way with another's, so a
 * box of glows has its extremes at corners (when no luma weight is above 1 or below 0). */
void reference_final(double out[3], const double scene[3], const double bright[3], const double glow[3],
                     unsigned channels, const double luma[3], const struct params *p);
/* sigma of Gaussian i along x and y, in pixels. */
void reference_sigma(double *x, double *y, const struct psf_gaussian *g, const struct reference_frame *f,
                     const struct params *p);
/* Its weight with tint and gain, for channel c. */
double reference_weight(const struct reference_frame *f, const struct params *p, unsigned gaussian, unsigned c);

struct reference_kernel {
    double sigma_x, sigma_y, weight;
    enum edge edge;
    unsigned grow;
};
/* Adds weight * (G * in) to out, of (width + 2 grow) x (height + 2 grow). in: width x height, rows in_stride apart; out is not in.
 * 0 or -1 (no memory). */
int reference_spread(double *out, const double *in, size_t in_stride, unsigned width, unsigned height,
                     const struct reference_kernel *k);

/* The worst difference of two planes, for messages. at: y * width + x of it. */
double reference_worst(const double *a, const double *b, size_t n, size_t *at);

#endif
