// SPDX-License-Identifier: Apache-2.0
// method_dual.c - the dual filter (Bjorge, SIGGRAPH 2015): 5 samples down, 8 samples up; the offsets of the samples up
// are scaled to the sigma.
#include "pyramid.h"

static void down(struct stencil *s)
{
    stencil_sample(s, .5, .5, .5);
    for (int k = 0; k < 4; k++)
        stencil_sample(s, k & 1 ? 1.5 : -.5, k & 2 ? 1.5 : -.5, .125);
}

static void up(struct stencil *s, double x, double y, double offset)
{
    for (int k = 0; k < 4; k++) {
        int sign = k & 1 ? 1 : -1;
        stencil_sample(s, x + (k & 2 ? sign * offset : 0), y + (k & 2 ? 0 : sign * offset), 1. / 12);
        stencil_sample(s, x + (k & 1 ? .5 : -.5) * offset, y + (k & 2 ? .5 : -.5) * offset, 2. / 12);
    }
}

static const struct pyramid_filters filters = { FIT_OFFSET, down, up, NULL };
static void *create(const struct blur_job *j) { return pyramid_create(j, &filters); }

const struct method method_dual = { "dual filter", "5 samples down, 8 up, offset scaled", create, pyramid_run,
                                    pyramid_destroy };
