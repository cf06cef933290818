#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// A wall's picture, first half of a resampling: down the columns to the wall's rows. A fragment makes 4 cells side by side of
// one wall row, every channel in an attachment of its own. What is read, one of: -D INPUT a target's planes; -D OUTPUT its first
// output (rows in 4 images by y % 4: 0 to 2 in planes, 3 in matte_plane); else a level, -D LAYERED E at full size.
// -D HALF, CHANNELS as in bright.frag.
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
layout(constant_id = 0) const int CHUNKS = 0; // of 4 rows; 0: pass.mode.z of them, in a loop
#if CHANNELS == 3
layout(location = 0) out vec4 out_r;
layout(location = 1) out vec4 out_g;
layout(location = 2) out vec4 out_b;
#else
layout(location = 0) out vec4 out_r;
#endif

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
    return decoded(imageLoad(planes[c], ivec2(texel_of(column), min(row0 + k, pass.frame.y - 1))), column);
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

vec4 sums[CHANNELS];

void add_chunk(ivec2 at, int row0, int chunk)
{
    vec4 w = imageLoad(weights, ivec2(at.y, 1 + chunk));
    [[unroll]] for (int k = 0; k < 4; k++)
        [[unroll]] for (int c = 0; c < CHANNELS; c++)
            sums[c] += w[k] * cells(at.x, c, row0 + 4 * chunk, k);
}

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    int row0 = int(imageLoad(weights, ivec2(at.y, 0)).x);
    [[unroll]] for (int c = 0; c < CHANNELS; c++)
        sums[c] = vec4(0.0);
    if (CHUNKS > 0) {
        [[unroll]] for (int i = 0; i < CHUNKS; i++)
            add_chunk(at, row0, i);
    } else {
        for (int i = 0; i < pass.mode.z; i++)
            add_chunk(at, row0, i);
    }
    [[unroll]] for (int c = 0; c < CHANNELS; c++)
        sums[c] = clamp(sums[c], -FLOAT_MAX, FLOAT_MAX);
    out_r = sums[0];
#if CHANNELS == 3
    out_g = sums[1];
    out_b = sums[2];
#endif
}
