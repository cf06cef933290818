/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wall_colour.h - from the linear drive of each wall pixel to the bytes of each board: brightness, current limit, fade,
 * transfer curve, dither, order of colours (LED, the chain from "brightness" on). Pure arithmetic; one thread at a time.
 *
 * Drive: linear light of the LED's own R, G, B as a share of its most, after matrix and calibration; what is outside
 * 0..1 is held there, NaN counts as 0. The controller linearises (Fadecandy: the LUT of wall_colour_lut; GUD: the display
 * does), so that byte n means the light transfer(n / 255).
 */
#ifndef AIRYD_WALL_COLOUR_H
#define AIRYD_WALL_COLOUR_H

#include "wall_layout.h"

struct wall_colour;

/* LEDs that no run names are not there: they draw nothing. A supply's amps are above its limit only when the idle current of its
 * LEDs alone is; then they are black. */
struct wall_power {
    double amps;       /* estimate from the bytes that are sent, after the limit; of a board or of a supply */
    double wanted;     /* before the limit, of the light before dither */
    double scale;      /* 0..1: the limit's factor in use (of a board: its supply's) */
};

/* def and layout must outlive it. */
int wall_colour_create(struct wall_colour **out, const struct wall_def *def, const struct wall_layout *layout,
                       struct fault *f);
void wall_colour_destroy(struct wall_colour *c);

/* One tick. drive: [height][width][3], NULL: black. fade: 0..1, linear, on top. tick: counts up by one, the dither's
 * phase. bytes[b]: 3 * leds bytes of board b, LED by LED, in the order of colours that goes on the wire; dark LEDs 0. */
void wall_colour_frame(struct wall_colour *c, const float *drive, double fade, uint64_t tick, uint8_t *const bytes[]);
/* Of the last frame. */
struct wall_power wall_colour_board(const struct wall_colour *c, unsigned board);
struct wall_power wall_colour_supply(const struct wall_colour *c, unsigned supply);

/* The transfer curve: light (0..1) of a code 0..1, and back, in double. */
double wall_transfer_light(const struct wall_def *d, double code);
double wall_transfer_code(const struct wall_def *d, double light);

/* LUT for a controller with 257 entries of 16 bits a channel (Fadecandy): entry e of channel ch at ch * 257 + e.
 * Entry e is the light of code e / 255; entry 256 is as 255. */
void wall_colour_lut(const struct wall_def *d, uint16_t lut[3 * 257]);

#endif
