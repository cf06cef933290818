#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// A wall's picture, second half of a resampling: along wall_rows.frag's rows to the wall's pixels, all channels of one a
// fragment, times a gain, -D ADD plus what there is so far. Sums as in wall_rows.frag. -D CHANNELS as there.
#include "common.glsl"

#if CHANNELS == 3
layout(rgba32f, set = 0, binding = 0) uniform readonly image2DArray rows;
#else
layout(rgba32f, set = 0, binding = 0) uniform readonly image2D rows;
#endif
#ifdef ADD
layout(rgba32f, set = 0, binding = 1) uniform readonly image2D light;
#endif
layout(rgba32f, set = 0, binding = 5) uniform readonly image2D weights; // x the wall column, y: 0 its first texel, then 4 weights each
layout(constant_id = 0) const int CHUNKS = 0;                           // texels; 0: pass.mode.z of them, in a loop
layout(location = 0) out vec4 result;

const float FLOAT_MAX = 3.4028235e38;

float sums[CHANNELS];

void add_chunk(ivec2 at, int texel0, int chunk)
{
    vec4 w = imageLoad(weights, ivec2(at.x, 1 + chunk));
    int texel = min(texel0 + chunk, pass.src.x - 1);
    [[unroll]] for (int c = 0; c < CHANNELS; c++) {
#if CHANNELS == 3
        vec4 v = imageLoad(rows, ivec3(texel, at.y, c));
#else
        vec4 v = imageLoad(rows, ivec2(texel, at.y));
#endif
        [[unroll]] for (int i = 0; i < 4; i++)
            sums[c] += w[i] * v[i];
    }
}

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    int texel0 = int(imageLoad(weights, ivec2(at.x, 0)).x);
    [[unroll]] for (int c = 0; c < CHANNELS; c++)
        sums[c] = 0.0;
    if (CHUNKS > 0) {
        [[unroll]] for (int i = 0; i < CHUNKS; i++)
            add_chunk(at, texel0, i);
    } else {
        for (int i = 0; i < pass.mode.z; i++)
            add_chunk(at, texel0, i);
    }
    vec3 sum = CHANNELS == 3 ? vec3(sums[0], sums[CHANNELS / 2], sums[CHANNELS - 1]) : vec3(sums[0]);
    // Inf times a gain of 0 would be NaN.
    sum = clamp(sum, -FLOAT_MAX, FLOAT_MAX) * pass.weight.rgb;
#ifdef ADD
    sum += imageLoad(light, at).rgb;
#endif
    result = vec4(clamp(sum, -FLOAT_MAX, FLOAT_MAX), 0.0);
}
