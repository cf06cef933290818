#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// A wall's picture, last: from light to the LEDs' linear drive (daemon/bloom.h): 2^exposure, tone map, saturation, matrix, gain.
#include "common.glsl"
#include "display.glsl"

layout(rgba32f, set = 0, binding = 0) uniform readonly image2D light;
layout(rgba32f, set = 0, binding = 5) uniform readonly image2D gain; // of the whole wall
layout(constant_id = 0) const int FEATURES = 0; // bits 0-1 tone map, 2 saturation, 3 gain
layout(location = 0) out vec4 result;

// What is this bright is held at full drive later anyway; sums of it stay finite.
const float MOST = 1e30;

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 v = clamp(imageLoad(light, at).rgb * pass.luma.w, 0.0, MOST);
    [[unroll]] for (int c = 0; c < 3; c++)
        v[c] = tone_map(v[c], FEATURES & 3);
    if ((FEATURES & 4) != 0)
        v = saturated(v, pass.luma.rgb, pass.limit.w);
    vec3 led = vec3(dot(pass.tap[0].rgb, v), dot(pass.tap[1].rgb, v), dot(pass.tap[2].rgb, v));
    if ((FEATURES & 8) != 0)
        led *= imageLoad(gain, at + pass.window.xy).rgb;
    result = vec4(led, 0.0);
}
