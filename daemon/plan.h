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
    unsigned index;          /* in the psf */
    double sigma_x, sigma_y; /* pixels of the data window */
    double weight[3];        /* of each channel: weight, tint and band gain; of one plane the first */
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
    double weight_sum;                    /* of the channel that has most */
    double filter_bound;                  /* sum of weight * l1, of the channel where it is largest */
    double rounding_bound;                /* float32 arithmetic of these passes, of weight_sum * max E */
    double half_bound;                    /* what storing every level as half would add to filter_bound, and, of a lone
                                             point, to its peak's error relative to the weight */
    double half_peak;
    double cost;                          /* multiply-adds per pixel and channel */
};

struct plan_facts {
    uint32_t width, height;  /* of the data window */
    uint32_t display_width;  /* for sizes in mm */
    unsigned channels;       /* 1 or 3 */
    double pixel_aspect;     /* > 0 */
    int only;                /* the index of the one Gaussian that counts, -1: all */
};

/* For a psf of Gaussians. 0, or -1 and *f (PARAM_RANGE naming params.psf: a size
 * that is out of range once it is in pixels; NO_MEMORY). The bound is best effort beyond the tolerance that
 * R5 and refinement reach: read filter_bound. */
int plan_make(struct plan *p, const struct params *params, double tolerance, const struct plan_facts *facts,
              struct fault *f);
/* Does it hold the tolerance with its levels stored as half, too? */
bool plan_holds_half(const struct plan *p, double tolerance);
/* Pixels beyond which no Gaussian of the plan reaches. */
uint32_t plan_reach(const struct plan *p);
/* One line for people: "R3, 5 levels b6 b6 b6 b6 b6, sigma 4@1(15) 8@2(15) ..." */
int plan_print(const struct plan *p, char *out, size_t size);

#endif
