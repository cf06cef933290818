/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wall_colour_internal.h - the two parts that wall_colour.c is made of: the curve from light to codes, as a table, and
 * the dither's thresholds. Codes are counted in 1/65536 here, so that code and threshold add up as integers.
 */
#ifndef AIRYD_WALL_COLOUR_INTERNAL_H
#define AIRYD_WALL_COLOUR_INTERNAL_H

#include <string.h>

#include "wall_colour.h"

enum {
    CODE_ONE = 1 << 16,
    CODE_MOST = 255 * CODE_ONE,
    CODE_DARK = 32 * CODE_ONE, /* below it one code is a step that the eye sees flicker */
    CURVE_SHIFT = 16           /* of a float's bits: 128 pieces an octave of light */
};

struct curve_piece { float base, slope; };

/*
 * Light 0..1 -> code, linear pieces over the light's own octaves: relative precision is what the dark needs, and the
 * piece's number is in the float's bits.
 *
 * With dither the code is n + (light - L(n)) / (L(n + 1) - L(n)), L(n) the light of byte n, n the last byte that is not
 * too bright: then the time's mean of the LIGHT is what was asked for. (The curve's own inverse, dithered, would make the dark too
 * bright: half way from 0 to 1 it is 0.22 of byte 1's light at gamma 2.2, and would be shown as 0.5.) At that gamma the two
 * are at most 0.005 code apart from byte 32 on. Without dither it is the curve's inverse, so that rounding finds the nearest code.
 *
 * Error: a piece meets the code at both its ends; between them it is off by at most 1/4 of the piece's width in codes times the
 * share by which the slope changes, below 0.003 code for gamma up to 5 (test_wall_colour checks every knot).
 */
struct curve {
    uint32_t first, pieces;  /* bits >> CURVE_SHIFT of the first piece's end; below it the line to 0 */
    struct curve_piece *piece; /* owned */
    uint32_t light[256];     /* of a byte, in 2^-31, rounded up: sums are never below what is drawn */
};

int curve_make(struct curve *v, const struct wall_def *d, struct fault *f);
void curve_free(struct curve *v);

/* light: 0..1, not NaN. In 1/65536 codes, 0..CODE_MOST; exactly 0 at 0 and CODE_MOST at 1. */
static inline int32_t curve_code(const struct curve *v, float light)
{
    uint32_t bits;
    memcpy(&bits, &light, sizeof(bits));
    const int32_t i = (int32_t)(bits >> CURVE_SHIFT) - (int32_t)v->first;
    const struct curve_piece p = v->piece[i < 0 ? 0 : i];
    const int32_t code = (int32_t)(p.base + light * p.slope);
    return code < CODE_MOST ? code : CODE_MOST;
}

/*
 * What is added to a code before its fraction is cut off, for each of the 4 x 4 places of a wall pixel (y & 3) * 4 + (x & 3),
 * in the dark [0] and from CODE_DARK on [1]. Below CODE_ONE always: 0 stays 0, and CODE_MOST stays 255.
 *
 * Four ticks are the four quarters of a code, in the order 0 2 1 3, begun elsewhere by each place and colour. What is left, less than
 * a quarter: in the dark it is decided by place alone (Bayer), so a still picture repeats every 4 ticks, nothing is slower than
 * rate / 4, and each 4 x 4 pixels together have the right mean. From CODE_DARK on it goes through all 64 steps in 256
 * ticks, bits reversed, so each LED by itself has the right mean.
 */
struct dither { int32_t at[16][3][2]; };

void dither_make(struct dither *t, enum wall_dither kind, uint64_t tick);
void dither_none(struct dither *t); /* all 0: codes are cut */

static inline uint8_t dither_byte(int32_t code, const int32_t threshold[2])
{
    return (uint8_t)((code + threshold[code >= CODE_DARK]) >> 16);
}

#endif
