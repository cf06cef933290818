// SPDX-License-Identifier: Apache-2.0
// method_box.c - mip maps: 2 x 2 means down, bilinear up an octave at a time, each sigma a mix of the two levels next to it.
#include "pyramid.h"

static void down(struct stencil *s) { stencil_sample(s, .5, .5, 1); }

static void up(struct stencil *s, double x, double y, double offset)
{
    (void)offset;
    stencil_sample(s, x, y, 1);
}

static const struct pyramid_filters filters = { FIT_MIX, down, up, NULL };
static void *create(const struct blur_job *j) { return pyramid_create(j, &filters); }

const struct method method_box = { "box pyramid", "2 x 2 means down, bilinear up, two levels mixed", create, pyramid_run,
                                   pyramid_destroy };
