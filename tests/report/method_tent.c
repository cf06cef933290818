// SPDX-License-Identifier: Apache-2.0
// method_tent.c - Jimenez, SIGGRAPH 2014: 13 samples down, a 3 x 3 tent up, each level added to the one above. The tent's
// radius is scaled to the widest sigma; the others follow by octaves. Weights: METHODS section 2, look D.
#include "pyramid.h"

static void down(struct stencil *s)
{
    static const double outer[3] = { 1. / 8, 1. / 16, 1. / 32 };
    for (int y = -1; y <= 1; y++)
        for (int x = -1; x <= 1; x++)
            stencil_sample(s, .5 + 2 * x, .5 + 2 * y, outer[(x != 0) + (y != 0)]);
    for (int k = 0; k < 4; k++)
        stencil_sample(s, k & 1 ? 1.5 : -.5, k & 2 ? 1.5 : -.5, 1. / 8);
}

static void up(struct stencil *s, double x, double y, double offset)
{
    for (int j = -1; j <= 1; j++)
        for (int i = -1; i <= 1; i++)
            stencil_sample(s, x + i * offset, y + j * offset, (2 - (i != 0)) * (2 - (j != 0)) / 16.);
}

static const struct pyramid_filters filters = { FIT_OFFSET, down, up, NULL };
static void *create(const struct blur_job *j) { return pyramid_create(j, &filters); }

const struct method method_tent = { "13-tap + tent chain", "13 samples down, 3 x 3 tent up, radius scaled", create,
                                    pyramid_run, pyramid_destroy };
