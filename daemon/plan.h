/* SPDX-License-Identifier: Apache-2.0 */
/*
 * plan.h - what was asked + the frame's geometry -> the passes that run, with the bound that they hold.
 * Pure arithmetic.
 *
 * The sum of Gaussians is put on one shared pyramid. Each Gaussian works at the coarsest level that its
 * rule allows; each octave uses the highest filter order that any Gaussian above it needs (sharing only ever
 * makes the others better). The cheapest rule whose computed error meets the tolerance is taken.
 */
#ifndef AIRYD_PLAN_H
#define AIRYD_PLAN_H

#include "params.h"
#include "psf.h"

struct plan_gaussian {
    double sigma_x, sigma_y; /* pixels of the data window */
    double weight;
    unsigned level;
    struct psf_taps x, y;
    double l1, peak;         /* two-dimensional error bounds, see psf.h */
};

struct plan {
    char rule[8];                         /* "R2" ... "R5"; "R5+" when levels had to be refined further */
    unsigned levels;                      /* octaves in use; 0: everything at full size */
    unsigned char order[PSF_LEVELS_MAX];  /* of octave i, both ways */
    unsigned count;
    struct plan_gaussian gaussian[PARAMS_GAUSSIANS_MAX]; /* by level, finest first */
    bool full_size;                       /* some Gaussian works at level 0 */
    double weight_sum;
    double filter_bound;                  /* sum of weight * l1 */
    double rounding_bound;                /* float32 arithmetic of these passes, of weight_sum * max E */
    double cost;                          /* multiply-adds per pixel and channel */
};

/* width x height: the data window; pixel_aspect > 0. 0, or -1 and *f (PARAM_RANGE naming params.psf: a size
 * that is out of range once it is in pixels; NO_MEMORY). The bound is best effort beyond the tolerance that
 * R5 and refinement reach: read filter_bound. */
int plan_make(struct plan *p, const struct params *params, uint32_t width, uint32_t height,
              double pixel_aspect, struct fault *f);
/* One line for people: "R3, 5 levels b6 b6 b6 b6 b6, sigma 4@1(15) 8@2(15) ..." */
int plan_print(const struct plan *p, char *out, size_t size);

#endif
