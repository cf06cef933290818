#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// One axis of a level's Gaussian: up to 4*REACH taps to each side. -D VERTICAL: down the rows, times the
// Gaussian's weight, and -D ADD_SAME: plus what the level has so far.
#define READS_SRC
#define WRITES_LEVEL
#ifdef ADD_SAME
#define READS_ADD
#endif
#include "common.glsl"

const int SIDE = 4 * REACH;

void main()
{
    int column, block, group;
    where(column, block, group);
    vec4 sum[4];
    [[unroll]] for (int p = 0; p < 4; p++)
        sum[p] = vec4(0.0);
#ifdef VERTICAL
    [[unroll]] for (int r = -SIDE; r < SIDE + 4; r++) {
        vec4 line = src_at(column, block, group + (r >> 2), r & 3);
        [[unroll]] for (int p = 0; p < 4; p++) {
            const int k = abs(r - p);
            if (k <= SIDE)
                sum[p] += tap(k) * line;
        }
    }
    float w = pass.weight[block];
    [[unroll]] for (int p = 0; p < 4; p++) {
        sum[p] *= w;
#ifdef ADD_SAME
        sum[p] += add_at(column, block, 4 * group + p);
#endif
    }
#else
    [[unroll]] for (int p = 0; p < 4; p++) {
        [[unroll]] for (int t = -REACH; t <= REACH; t++) {
            vec4 c = src_at(column + t, block, group, p);
            [[unroll]] for (int i = 0; i < 4; i++) {
                [[unroll]] for (int j = 0; j < 4; j++) {
                    const int k = abs(4 * t + j - i);
                    if (k <= SIDE)
                        sum[p][i] += tap(k) * c[j];
                }
            }
        }
    }
#endif
    out0 = stored(sum[0]);
    out1 = stored(sum[1]);
    out2 = stored(sum[2]);
    out3 = stored(sum[3]);
}
