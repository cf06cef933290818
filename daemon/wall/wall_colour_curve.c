// SPDX-License-Identifier: Apache-2.0
// wall_colour_curve.c - the transfer curve in double, the controller's LUT, and the curve as a table. Invariant: the table is made
// from the two functions here and nothing else, so that bytes, LUT and power estimate speak of one curve.
#include <math.h>
#include <stdlib.h>

#include "wall_colour_internal.h"

static double held(double v) { return v > 0 ? v < 1 ? v : 1 : 0; }

double wall_transfer_light(const struct wall_def *d, double code)
{
    const double v = held(code);
    if (d->transfer == WALL_TRANSFER_GAMMA)
        return pow(v, d->gamma);
    return v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4);
}

double wall_transfer_code(const struct wall_def *d, double light)
{
    const double v = held(light);
    if (d->transfer == WALL_TRANSFER_GAMMA)
        return pow(v, 1 / d->gamma);
    if (v == 1)
        return 1; // 1.055 - 0.055 is not
    return v <= 0.04045 / 12.92 ? v * 12.92 : 1.055 * pow(v, 1 / 2.4) - 0.055;
}

void wall_colour_lut(const struct wall_def *d, uint16_t lut[3 * 257])
{
    for (unsigned e = 0; e < 257; e++) {
        const uint16_t v = (uint16_t)lrint(65535 * wall_transfer_light(d, (e < 255 ? e : 255) / 255.0));
        for (unsigned ch = 0; ch < 3; ch++)
            lut[ch * 257 + e] = v;
    }
}

static double code_of(const struct wall_def *d, double light)
{
    const double pure = 255 * wall_transfer_code(d, light);
    if (d->dither == WALL_DITHER_OFF || light >= 1)
        return pure;
    int n = (int)pure;
    // The inverse may round across a byte's own light.
    while (n > 0 && wall_transfer_light(d, n / 255.0) > light)
        n--;
    while (n < 254 && wall_transfer_light(d, (n + 1) / 255.0) <= light)
        n++;
    const double low = wall_transfer_light(d, n / 255.0), high = wall_transfer_light(d, (n + 1) / 255.0);
    return n + (light - low) / (high - low);
}

static double piece_start(uint32_t i)
{
    const uint32_t bits = i << CURVE_SHIFT;
    float v;
    memcpy(&v, &bits, sizeof(v));
    return (double)v;
}

/* The line through the code at two lights. */
static struct curve_piece piece_between(const struct wall_def *d, double low, double high)
{
    const double a = CODE_ONE * code_of(d, low), b = CODE_ONE * code_of(d, high);
    const double slope = (b - a) / (high - low);
    return (struct curve_piece){ .base = (float)(a - slope * low), .slope = (float)slope };
}

int curve_make(struct curve *v, const struct wall_def *d, struct fault *f)
{
    // From the light of 1/256 code down to 0 one line will do; a normal float it must be.
    const double least = fmax(wall_transfer_light(d, 1 / 256.0 / 255), 0x1p-120);
    const float edge = (float)exp2(floor(log2(least))), one = 1;
    uint32_t low, high;
    memcpy(&low, &edge, sizeof(low));
    memcpy(&high, &one, sizeof(high));
    low >>= CURVE_SHIFT;
    high >>= CURVE_SHIFT;
    // Piece 0 ends where piece 1 starts, at the least light; the last is that of light 1 alone.
    *v = (struct curve){ .first = low - 1, .pieces = high - low + 2 };
    v->piece = malloc(v->pieces * sizeof(*v->piece));
    if (!v->piece)
        return fault_set(f, FAULT_NO_MEMORY, "wall", "no memory for a transfer curve of %u pieces", v->pieces);
    v->piece[0] = piece_between(d, 0, piece_start(low));
    for (uint32_t i = low; i < high; i++)
        v->piece[i - v->first] = piece_between(d, piece_start(i), piece_start(i + 1));
    v->piece[high - v->first] = (struct curve_piece){ .base = CODE_MOST };
    for (unsigned n = 0; n < 256; n++)
        v->light[n] = (uint32_t)ceil(0x1p31 * wall_transfer_light(d, n / 255.0));
    return 0;
}

void curve_free(struct curve *v)
{
    free(v->piece);
    v->piece = NULL;
}
