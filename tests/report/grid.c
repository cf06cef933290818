// SPDX-License-Identifier: Apache-2.0
// grid.c - what the compared methods share: padded planes and the bright pass.
#include <stdlib.h>
#include <string.h>

#include "method.h"

const struct method *const methods[METHODS] = { &method_kawase,    &method_dual, &method_tent,   &method_box,
                                                &method_recursive, &method_fft,  &method_direct, &method_c_chain };

bool grid_init(struct grid *g, long width, long height, unsigned planes, long pad)
{
    long pad_x = (pad + 15) / 16 * 16;
    *g = (struct grid){ width, height, pad, pad_x, ((size_t)(width + 2 * pad_x) + 15) / 16 * 16, NULL };
    // A row more: a filter may look beyond the last row's right pad.
    size_t bytes = g->stride * ((size_t)(height + 2 * pad) * planes + 1) * sizeof(float);
    if (posix_memalign((void **)&g->memory, 64, bytes)) {
        g->memory = NULL;
        return false;
    }
    memset(g->memory, 0, bytes);
    return true;
}

void grid_finish(struct grid *g)
{
    free(g->memory);
    g->memory = NULL;
}

void grid_bright(const struct grid *g, const struct planes *in, float threshold, unsigned member)
{
    for (unsigned c = 0; c < in->count; c++)
        for (long y = part_first(g->height, member); y < part_first(g->height, member + 1); y++) {
            const float *restrict from = (const float *)planes_row(in, c, (uint32_t)y);
            float *restrict to = grid_row(g, c, y);
            for (long x = 0; x < g->width; x++)
                to[x] = from[x] > threshold ? from[x] - threshold : 0;
        }
}
