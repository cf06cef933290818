#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// A wall's picture, first half of a resampling: down the columns to the wall's rows, times a gain. A fragment makes 4 cells side by side
// of one wall row of one channel; the channels stand below each other, the sources beside each other. What is read, one of:
// -D INPUT a target's planes, drawn in one band a channel, so that planes[0] is this channel's (three planes at once, and
// taps in fours, took 16 ms where this takes 9 to 11: which of the two it was has not been measured apart); -D OUTPUT its first output (rows in 4 images by y % 4: 0 to 2 in planes, 3
// in matte_plane); else a level, -D LAYERED E at full size. -D HALF as in bright.frag.
//
// Sums go up the rows one by one from 0: weights of 0 at either end change no bit, so that how a table is cut and where the target lies
// in its frame do not show.
#if defined(INPUT) || defined(OUTPUT)
#define READS_IN
#else
#define READS_SRC
#endif
#include "common.glsl"

layout(rgba32f, set = 0, binding = 5) uniform readonly image2D weights; // x the wall row, y: 0 its first row, then 4 weights each
layout(constant_id = 0) const int TAPS = 0; // rows; 0: pass.mode.z chunks of 4, in a loop
layout(location = 0) out vec4 result;

const float FLOAT_MAX = 3.4028235e38;

#ifdef READS_IN
#ifdef HALF
int texel_of(int column) { return column >> 1; }
#else
int texel_of(int column) { return column; }
#endif

// Not finite: no light (and no NaN out of 0 * Inf either).
vec4 decoded(uvec4 u, int column)
{
#ifdef HALF
    uvec2 two = (column & 1) == 0 ? u.xy : u.zw;
    vec4 v = vec4(unpackHalf2x16(two.x), unpackHalf2x16(two.y));
#else
    vec4 v = uintBitsToFloat(u);
#endif
    [[unroll]] for (int i = 0; i < 4; i++)
        v[i] = nonfinite(floatBitsToUint(v[i])) ? 0.0 : v[i];
    return v;
}
#endif

// k: which row of its chunk, so that an image is chosen by a constant; row0 is a multiple of 4 then.
vec4 cells(int column, int c, int row0, const int k)
{
#ifdef INPUT
    return decoded(imageLoad(planes[0], ivec2(texel_of(column), min(row0 + k, pass.frame.y - 1))), column);
#elif defined(OUTPUT)
    ivec2 at = ivec2(texel_of(column), c * pass.frame.z + min(row0 >> 2, pass.frame.z - 1));
    if (k == 3)
        return decoded(imageLoad(matte_plane, at), column);
    return decoded(imageLoad(planes[k], at), column);
#else
    int row = row0 + k;
    return min(src_at(column, c, row >> 2, row & 3), FLOAT_MAX);
#endif
}

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    int channel = at.y / pass.mode.w, row = at.y - channel * pass.mode.w, column = at.x - pass.frame.w;
    int row0 = int(imageLoad(weights, ivec2(row, 0)).x);
    vec4 sum = vec4(0.0);
    if (TAPS > 0) {
        [[unroll]] for (int i = 0; i < TAPS; i += 4) {
            vec4 w = imageLoad(weights, ivec2(row, 1 + (i >> 2)));
            [[unroll]] for (int k = 0; k < 4; k++)
                if (i + k < TAPS)
                    sum += w[k] * cells(column, channel, row0 + i, k);
        }
    } else {
        for (int i = 0; i < pass.mode.z; i++) {
            vec4 w = imageLoad(weights, ivec2(row, 1 + i));
            [[unroll]] for (int k = 0; k < 4; k++)
                sum += w[k] * cells(column, channel, row0 + 4 * i, k);
        }
    }
    // Inf times 0 would be NaN.
    result = clamp(clamp(sum, -FLOAT_MAX, FLOAT_MAX) * pass.weight[channel], -FLOAT_MAX, FLOAT_MAX);
}
