#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// One halving by b_ORDER. Both ways from a level (or, -D LAYERED, from E at full size); -D VERTICAL: rows
// only, from what the bright pass has halved across already.
#define READS_SRC
#define WRITES_LEVEL
#include "common.glsl"
#include "binomial.glsl"

// Output cell j takes input cells 2j - ORDER/2 + 1 ...; with both origins at 8 that is column 8g - 11 at the
// earliest for the 4 cells of texel g: texels 2g-3 .. 2g.
const int BASE = -8 - (ORDER / 2 - 1);

vec4 across(int column, int block, int group, int phase)
{
#ifdef VERTICAL
    return src_at(column, block, group, phase);
#else
    float v[16];
    [[unroll]] for (int t = 0; t < 4; t++) {
        vec4 c = src_at(2 * column - 3 + t, block, group, phase);
        v[4 * t] = c.x;
        v[4 * t + 1] = c.y;
        v[4 * t + 2] = c.z;
        v[4 * t + 3] = c.w;
    }
    vec4 sum = vec4(0.0);
    [[unroll]] for (int i = 0; i < 4; i++)
        [[unroll]] for (int k = 0; k < ORDER; k++)
            sum[i] += B[k] * v[12 + BASE + 2 * i + k];
    return sum;
#endif
}

void main()
{
    int column, block, group;
    where(column, block, group);
    vec4 sum[4];
    [[unroll]] for (int p = 0; p < 4; p++)
        sum[p] = vec4(0.0);
    [[unroll]] for (int r = 0; r < ORDER + 6; r++) {
        const int row = BASE + r; // from 8 * group
        vec4 line = across(column, block, 2 * group + (row >> 2), row & 3);
        [[unroll]] for (int p = 0; p < 4; p++) {
            const int k = r - 2 * p;
            if (k >= 0 && k < ORDER)
                sum[p] += B[k] * line;
        }
    }
    out0 = stored(sum[0]);
    out1 = stored(sum[1]);
    out2 = stored(sum[2]);
    out3 = stored(sum[3]);
}
