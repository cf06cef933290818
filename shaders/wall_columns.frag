#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// A wall's picture, second half: along wall_rows.frag's rows to the wall's pixels, all channels of one and all sources a fragment
// (each pass more that reads and writes a wall of 512 x 256 costs 2 ms on two cores), and from there to the LEDs' linear drive
// (daemon/bloom.h): 2^exposure, tone map, saturation, matrix, gain. Sums as in wall_rows.frag. -D CHANNELS 3 or 1.
#include "common.glsl"
#include "display.glsl"

layout(rgba32f, set = 0, binding = 0) uniform readonly image2D rows; // sources beside, channels below each other
layout(rgba32f, set = 0, binding = 1) uniform readonly image2D gain; // of the whole wall
// x the wall column; y, of each source: first texel, last one there is, how many; then 4 weights each.
layout(rgba32f, set = 0, binding = 5) uniform readonly image2D weights;
// Bits 0-1 tone map, 2 saturation, 3 gain; 4-7, 8-11, 12-15 the chunks of up to 3 sources, 0 there: in loops, as the weights say.
layout(constant_id = 0) const int FEATURES = 0;
layout(location = 0) out vec4 result;

const float FLOAT_MAX = 3.4028235e38;
// Light that is this bright is held at full drive later anyway; sums of it stay finite.
const float MOST = 1e30;

float light[CHANNELS], sum[CHANNELS];

void add_chunk(ivec2 at, ivec3 head, int line, int k)
{
    vec4 w = imageLoad(weights, ivec2(at.x, line + 1 + k));
    int texel = min(head.x + k, head.y);
    [[unroll]] for (int c = 0; c < CHANNELS; c++) {
        vec4 v = imageLoad(rows, ivec2(texel, at.y + c * pass.mode.w));
        [[unroll]] for (int i = 0; i < 4; i++)
            sum[c] += w[i] * v[i];
    }
}

ivec3 begin_source(ivec2 at, int line)
{
    [[unroll]] for (int c = 0; c < CHANNELS; c++)
        sum[c] = 0.0;
    return ivec3(imageLoad(weights, ivec2(at.x, line)).xyz);
}

void end_source()
{
    [[unroll]] for (int c = 0; c < CHANNELS; c++)
        light[c] += clamp(sum[c], -FLOAT_MAX, FLOAT_MAX);
}

vec3 light_at(ivec2 at)
{
    [[unroll]] for (int c = 0; c < CHANNELS; c++)
        light[c] = 0.0;
    int line = 0;
    if (FEATURES >> 4 != 0) {
        [[unroll]] for (int s = 0; s < 3; s++) {
            const int chunks = FEATURES >> (4 + 4 * s) & 15;
            if (chunks == 0)
                continue;
            ivec3 head = begin_source(at, line);
            [[unroll]] for (int k = 0; k < 8; k++)
                if (k < chunks)
                    add_chunk(at, head, line, k);
            end_source();
            line += 1 + chunks;
        }
    } else {
        for (int s = 0; s < pass.mode.z; s++) {
            ivec3 head = begin_source(at, line);
            for (int k = 0; k < head.z; k++)
                add_chunk(at, head, line, k);
            end_source();
            line += 1 + head.z;
        }
    }
    return CHANNELS == 3 ? vec3(light[0], light[CHANNELS / 2], light[CHANNELS - 1]) : vec3(light[0]);
}

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 v = clamp(light_at(at) * pass.luma.w, 0.0, MOST);
    [[unroll]] for (int c = 0; c < 3; c++)
        v[c] = tone_map(v[c], FEATURES & 3);
    if ((FEATURES & 4) != 0)
        v = saturated(v, pass.luma.rgb, pass.limit.w);
    vec3 led = vec3(dot(pass.tap[0].rgb, v), dot(pass.tap[1].rgb, v), dot(pass.tap[2].rgb, v));
    if ((FEATURES & 8) != 0)
        led *= imageLoad(gain, at + pass.window.xy).rgb;
    result = vec4(led, 0.0);
}
