/* SPDX-License-Identifier: Apache-2.0 */
/*
 * pyramid.h - one mechanism for the pyramids of the field: a method is a filter down, a filter up and, perhaps,
 * passes at a level. All are given as bilinear samples, the way a GPU takes them, and turned into taps on whole
 * pixels once.
 */
#ifndef AIRY_REPORT_PYRAMID_H
#define AIRY_REPORT_PYRAMID_H

#include "method.h"

enum { STENCIL_MAX = 64, PYRAMID_LEVELS_MAX = 10, PYRAMID_PASSES = 3 };

struct stencil {
    unsigned n;
    struct {
        int dx, dy;
        float w;
    } tap[STENCIL_MAX];
};
/* A bilinear sample at (x, y) from a pixel's centre, in pixels of what is read. */
void stencil_sample(struct stencil *s, double x, double y, double weight);

enum pyramid_fit {
    FIT_OFFSET, /* the widest Gaussian sets `offset` of the filter up; the others take levels an octave apart */
    FIT_MIX,    /* each Gaussian is a mix of two levels next to each other */
    FIT_PASSES, /* each Gaussian has passes at its level, whose `offset` is set */
};

struct pyramid_filters {
    enum pyramid_fit fit;
    void (*down)(struct stencil *s);                           /* read at the middle of 2 x 2 fine pixels */
    void (*up)(struct stencil *s, double x, double y, double offset); /* read at (x, y) in the coarse level */
    void (*pass)(struct stencil *s, unsigned i, double offset);       /* FIT_PASSES */
};

void *pyramid_create(const struct blur_job *j, const struct pyramid_filters *f);
void pyramid_run(void *self, const struct planes *in, const struct planes *out);
void pyramid_destroy(void *self);

#endif
