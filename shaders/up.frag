#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// One doubling by b_ORDER of the coarser level's sum (`add`); this level's Gaussians are added to it after.
#define READS_ADD
#define WRITES_LEVEL
#include "common.glsl"
#include "up.glsl"

// Coarse cells m + LOW .. m + 1 - LOW serve the 4 fine cells 2m .. 2m+3.
const int FAR = 1 - LOW, NEED = FAR - LOW + 1;

void main()
{
    int column, block, group;
    where(column, block, group);
    // Fine column 4c is cell 4c - 8 = 2m: coarse column m + 8 = 2c + 4.
    int first = 2 * column + 4 + LOW, row0 = 2 * group + 4 + LOW;
    int texel = first >> 2;
    bool odd = (column & 1) != 0;
    const int EVEN_AT = (4 + LOW) & 3, ODD_AT = (6 + LOW) & 3;
    vec4 sum[4];
    [[unroll]] for (int p = 0; p < 4; p++)
        sum[p] = vec4(0.0);
    [[unroll]] for (int r = 0; r < NEED; r++) {
        vec4 a = add_at(texel, block, row0 + r), b = add_at(texel + 1, block, row0 + r);
        float v[8] = float[](a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w);
        float c[NEED];
        [[unroll]] for (int i = 0; i < NEED; i++)
            c[i] = odd ? v[ODD_AT + i] : v[EVEN_AT + i];
        vec4 line = vec4(0.0);
        [[unroll]] for (int i = 0; i < 4; i++)
            [[unroll]] for (int d = 0; d < NEED; d++)
                line[i] += up_weight(i & 1, d + LOW - (i >> 1)) * c[d];
        [[unroll]] for (int p = 0; p < 4; p++)
            sum[p] += up_weight(p & 1, r + LOW - (p >> 1)) * line;
    }
    out0 = stored(sum[0]);
    out1 = stored(sum[1]);
    out2 = stored(sum[2]);
    out3 = stored(sum[3]);
}
