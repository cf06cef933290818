#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// One stage of a look, one pixel a fragment:
//   -D LOAD [-D HALF] [-D MATTE]  the planes, sanitised, times the scale, and with a matte (in src) times it and emission
//   -D SAMPLE [-D ADD]            a weighted sum of samples of src, the bright curve of each, plus add
//   -D SUN                        add plus the sun's glow
#include "look.glsl"
#include "display.glsl"

layout(location = 0) out vec4 result;
layout(constant_id = 0) const int CURVE = 0;
layout(constant_id = 1) const int SRC_TEXELS = 0; // src has the result's size and all offsets are whole
layout(constant_id = 2) const int ADD_TEXELS = 0; // add has the result's size
layout(constant_id = 3) const int TAPS = 1;

#if defined(SAMPLE) || defined(MATTE)
layout(rgba32f, set = 0, binding = 0) uniform readonly image2D src;
#endif
#if defined(ADD) || defined(SUN)
layout(rgba32f, set = 0, binding = 1) uniform readonly image2D add;
#endif

#ifdef LOAD
layout(rgba32ui, set = 0, binding = 2) uniform readonly uimage2D planes[3];

#ifdef HALF
float sample_of(uvec4 u, int x) { return unpackHalf2x16(u[(x >> 1) & 3])[x & 1]; }
const int SHIFT = 3;
#else
float sample_of(uvec4 u, int x) { return uintBitsToFloat(u[x & 3]); }
const int SHIFT = 2;
#endif

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy), texel = ivec2(at.x >> SHIFT, at.y);
    vec3 c = vec3(finite_part(sample_of(imageLoad(planes[0], texel), at.x)), 0.0, 0.0);
    if (stage.dst.w == 3)
        c.gb = vec2(finite_part(sample_of(imageLoad(planes[1], texel), at.x)),
                    finite_part(sample_of(imageLoad(planes[2], texel), at.x)));
    c *= stage.weight.x;
#ifdef MATTE
    c *= imageLoad(src, at).x * stage.weight.w;
#endif
    result = vec4(glowing(min(c, FLOAT_MAX), CURVE), 0.0);
}
#endif

#ifdef SAMPLE
BILINEAR(src_bilinear, src)
#ifdef ADD
BILINEAR(add_bilinear, add)
#endif

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    // Four sums side by side: a chain of additions a quarter as long rounds less.
    vec3 sum[4] = vec3[](vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0));
    for (int i = 0; i < TAPS; i++) {
        vec4 tap = stage.tap[i];
        vec4 v = SRC_TEXELS == 1 ? imageLoad(src, clamp(at + ivec2(tap.xy), ivec2(0), stage.src.xy - 1))
                                 : src_bilinear(at, stage.src.xy, stage.dst.xy, tap.xy);
        sum[i & 3] += tap.z * glowing(v.rgb, CURVE);
    }
    vec3 all = ((sum[0] + sum[1]) + (sum[2] + sum[3])) * stage.weight.rgb;
#ifdef ADD
    all += ADD_TEXELS == 1 ? imageLoad(add, at).rgb : add_bilinear(at, stage.add.xy, stage.dst.xy, vec2(0.0)).rgb;
#endif
    // Never Inf: Inf times a weight of 0 would be NaN.
    result = vec4(min(all, FLOAT_MAX), 0.0);
}
#endif

#ifdef SUN
void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec2 d = (vec2(at) - stage.numbers.xy) - stage.numbers.zw;
    d.x *= stage.more.y;
    float glow = exact_exp2(-1.4426950 * dot(d, d) * stage.more.x);
    result = vec4(min(imageLoad(add, at).rgb + stage.weight.rgb * glow, FLOAT_MAX), 0.0);
}
#endif
