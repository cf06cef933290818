// SPDX-License-Identifier: Apache-2.0
// wall_colour_dither.c - the thresholds of one tick (struct dither). Invariant: a function of the tick alone; the same tick gives
// the same thresholds.
#include "wall_colour_internal.h"

static unsigned reversed(unsigned v, unsigned bits)
{
    unsigned r = 0;
    for (unsigned i = 0; i < bits; i++)
        r |= (v >> i & 1) << (bits - 1 - i);
    return r;
}

/* Bayer's 2 x 2: neighbours as far apart as can be. */
static unsigned quad(unsigned x, unsigned y) { return (x ^ y) << 1 | y; }

void dither_make(struct dither *t, enum wall_dither kind, uint64_t tick)
{
    // Red, green, blue begin apart: the eye sees brightness flicker sooner than colour, and green is most of brightness.
    static const unsigned begin[3] = { 0, 2, 1 };
    const unsigned slow = reversed((unsigned)(tick >> 2 & 63), 6);
    for (unsigned place = 0; place < 16; place++) {
        const unsigned x = place & 3, y = place >> 2;
        const unsigned fine = quad(x & 1, y & 1), coarse = quad(x >> 1, y >> 1);
        const unsigned rank = fine << 2 | coarse;
        for (unsigned c = 0; c < 3; c++) {
            // Places of neighbouring rank, and neighbouring places, are at different quarters at any time.
            const unsigned quarter = reversed((unsigned)(tick + fine + coarse + begin[c]) & 3, 2);
            const unsigned dark = rank << 2 | 2, bright = (rank << 2) ^ slow;
            int32_t *at = t->at[place][c];
            at[0] = (int32_t)((quarter << 6 | dark) << 8);
            at[1] = (int32_t)((quarter << 6 | bright) << 8 | 128);
            if (kind == WALL_DITHER_OFF)
                at[0] = at[1] = CODE_ONE / 2;
        }
    }
}

void dither_none(struct dither *t) { *t = (struct dither){ 0 }; }
