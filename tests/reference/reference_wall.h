/* SPDX-License-Identifier: Apache-2.0 */
/*
 * reference_wall.h - a wall's picture in scalar float64: the truth for struct bloom_wall. The whole frame is composited by
 * reference.h at full size; then each wall pixel is the exact mean of it over its rectangle, by area, with nothing outside the
 * frame. No pyramid and no separable weights, and no code shared with the daemon.
 *
 * mean: of out (display off; a nonfinite sample is 0 + its glow). size: the mean of |I'| + k B, for what float32 rounds off. drive, of that: v =
 * max(0, mean * 2^EV); tone map as reference.h's section 7; l = .2126 R + .7152 G + .0722 B (a frame of one plane has R = G = B),
 * v = max(0, l + saturation (v - l)); matrix times v; times gain.
 */
#ifndef AIRY_REFERENCE_WALL_H
#define AIRY_REFERENCE_WALL_H

#include "reference.h"

struct reference_wall {
    unsigned width, height;
    double x, y, pitch_x, pitch_y; /* in frame pixels */
    double exposure, saturation, matrix[3][3];
    int tone_map;
    const float *gain;             /* [height][width][3] or NULL */
};

struct reference_light {
    double *mean, *size, *drive;   /* owned: [height][width][3] */
    double max_bright;
};

/* 0, or -1 as reference_bloom. *l is reference_light_free's. */
int reference_wall(struct reference_light *l, const struct reference_frame *f, const struct params *p, const struct reference_wall *w);
/* Only the last step, of one mean. */
void reference_drive(double drive[3], const double mean[3], const struct reference_wall *w, const float *gain);
void reference_light_free(struct reference_light *l);

#endif
