// SPDX-License-Identifier: Apache-2.0
// method_kawase.c - Kawase 2003: three passes of four corner samples at growing offsets, at the size where sigma is
// 1.7 to 3.4 cells; 2 x 2 means down, bilinear up. The offsets are scaled to the sigma.
#include "pyramid.h"

static void down(struct stencil *s) { stencil_sample(s, .5, .5, 1); }

static void up(struct stencil *s, double x, double y, double offset)
{
    (void)offset;
    stencil_sample(s, x, y, 1);
}

static void pass(struct stencil *s, unsigned i, double offset)
{
    for (int k = 0; k < 4; k++)
        stencil_sample(s, (k & 1 ? 1 : -1) * (i + .5) * offset, (k & 2 ? 1 : -1) * (i + .5) * offset, .25);
}

static const struct pyramid_filters filters = { FIT_PASSES, down, up, pass };
static void *create(const struct blur_job *j) { return pyramid_create(j, &filters); }

const struct method method_kawase = { "Kawase", "3 passes of 4 corner samples at a reduced size", create, pyramid_run,
                                      pyramid_destroy };
