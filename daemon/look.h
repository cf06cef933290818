/* SPDX-License-Identifier: Apache-2.0 */
/*
 * look.h - the five named looks (METHODS section 2) as data: a list of stages and numbers, which one mechanism runs.
 *
 * A stage makes one image from one or two others: a weighted sum of bilinear samples (exact in float32, clamped to the edge), of
 * the bright curve of each where the look says so, plus an image. The first stage loads the slot's planes, sanitised; the last
 * one composites, displays and stores. What METHODS leaves open is decided here; T is threshold / 2^EV, k is intensity, half
 * means max(1, floor(n / 2)), (n) that n times over. params_look_defaults() puts each look's own numbers in.
 *
 *   half-gaussian  E = max(I - T, 0) of I at half size; 9 + 9 taps of sigma 1.8; out = I + k B.
 *   mip-chain      mip m is mip m-1 at half size, m = 1 .. 5; B = sum of w_m * knee(mip m, at full size), w = .20 .40 .24 .11 .05
 *                  .02; plus the sun: gain * tint * a * exp(-r^2 / (2 radius^2)), r in pixel heights from (x %, y %) of the data
 *                  window, and a the unoccluded share of the 64 points i at distance radius * sqrt((i + .5) / 64), angle
 *                  i * (pi * (3 - sqrt 5)) around it, each the pixel it falls in (points outside the frame are not counted; all
 *                  outside, or no depth: a = 1). A point is unoccluded when its Z is +Inf, or finite and at least the frame's largest.
 *                  The sun is part of B: k counts. Sun shafts need the scene's fog and shadow maps, which no frame carries.
 *   three-scale    E = I * max(0, L - T) / L at full size, halved 3 (stages=6: 6) times; at each size 9 + 9 taps .227027 .194595
 *                  .121622 .054054 .016216 across, then down, or kawase = N passes i = 0 .. N-1 of the mean of 4 samples at
 *                  (+-(i + .5), +-(i + .5)) texels; times that scale's tint; B is their sum at full size.
 *   jimenez        E = smoothstep bright pass of I at half size (mip 0); mips 1 .. 5 by the 13 taps at 0, +-1 and +-2 texels of the
 *                  larger one (half and one of the smaller); each blurred by 9 + 9 taps of sigma 1.8, `radius` texels apart; from
 *                  mip 5 on the sum is drawn up by the 3 x 3 tent (a texel apart) and the blurred mip added; mip 0 gets the sum
 *                  without E. legacy_gain=on: the 4 edges 1/8 and the 4 corners 1/16, sum 1.375.
 *   airy-eight     E = max(I - T, 0) at full size; 8 halvings, each times .8; 11 + 11 taps of sigma 2 at each size; B is their sum
 *                  at full size over the sum of .8^1 .. .8^8, so that a flat E comes back as E. Composite screen-add.
 *
 * An EXR in is a linear EXR out for every look: tone map, saturation and encoding only where display, saturation or encoding
 * ask for them (airy-eight adds after the tone map then, else just adds).
 * With a matte m the source of the glow is S * m * emission, the scene I * (1 + m * (emission - 1)).
 * Views: final, source, bright (E; mip-chain's is the knee of mip 0), bloom (k B).
 */
#ifndef AIRYD_LOOK_H
#define AIRYD_LOOK_H

#include "bloom.h"

/* Blooms one target of the slot by params->look. exposure: stops in use (metered already). Fills the reply but for tiles, max_bright
 * and exposure.
 *
 * energy_bright: sum of E at full size (view bright). energy_bloomed: sum of k B, what is added to the scene in linear light, before a
 * display and before the output's type holds it. Both to 1e-4 for light above 1e-30. energy_lost stays 0: light that clamped edges
 * and unnormalised weights make or lose is part of a look's definition.
 *
 * error_bound is a share of the largest value there is (scene, what glows, k B or result; not, as elsewhere, of intensity * max E),
 * in linear light: a display's curves come after it. It counts the roundings of the definition's float32 evaluation (look_bound.c): at
 * most 1e-5 for METHODS' numbers, but for jimenez where sizes are odd all the way down (1.1e-5; what is measured is 1e-7), since its
 * 14 resamplings round three times an axis there, and where smoothstep's slope asks for more: a small knee makes a share of L into
 * a large one of E, whatever evaluates it. At knee=0 the definition jumps, and the bound says so: it is the look's gain. Values below
 * the normal floats may count as 0 (each sum may lose some 1e-37).
 * Called by bloom_run on the device thread. 0, or -1 and *f. */
int look_run(struct bloom *b, struct bloom_slot *s, unsigned target, const struct bloom_request *request,
             double exposure, struct bloom_reply *reply, struct fault *f);
/* Frees what look_run keeps between frames. NULL is fine. */
struct look_targets;
void look_destroy(struct bloom *b, struct look_targets *t);
/* Only its images, and what it reads them back by. NULL is fine. */
void look_release(struct bloom *b, struct look_targets *t);
/* "half-gaussian: half size, 9 + 9 taps; ...": what would run, for people. */
int look_print(const struct params *p, uint32_t width, uint32_t height, char *out, size_t size);

#endif
