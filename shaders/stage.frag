#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// One stage of a look:
//   -D LOAD [-D HALF] [-D MATTE]  the planes, sanitised, times the scale, and with a matte (in src) times it and emission
//   -D LOAD_HALF [-D HALF]        that at half size (of even sizes), the curve before or after
//   -D LOAD_ROWS [-D HALF]        that as rows
//   -D SAMPLE [-D ADD]            a weighted sum of samples of src, the bright curve of each, plus add
//   -D ROWS                       src drawn to the frame's width, as rows
//   -D MIX                        rows: add's curve, plus that of each section of src at the frame's height, plus the sun
//   -D SUM [-D PIXELS]            light of some texels of a row of add (PIXELS: of src)
#include "look.glsl"
#include "display.glsl"

layout(constant_id = 0) const int CURVE = 0;
layout(constant_id = 1) const int SRC_TEXELS = 0; // src has the result's size (ROWS: width) and all offsets are whole
layout(constant_id = 2) const int OPTION = 0;     // sample: add has the result's size; load: the curve comes after the mean; mix: sun
layout(constant_id = 3) const int COUNT = 1;      // taps; load: channels; mix: sections

#if defined(LOAD_ROWS) || defined(ROWS) || defined(MIX)
layout(location = 0) out vec4 red;
layout(location = 1) out vec4 green;
layout(location = 2) out vec4 blue;
#else
layout(location = 0) out vec4 result;
#endif

#if defined(SAMPLE) || defined(MATTE) || defined(ROWS) || defined(PIXELS)
layout(rgba32f, set = 0, binding = 0) uniform readonly image2D src;
#endif
#ifdef MIX
layout(rgba32f, set = 0, binding = 0) uniform readonly image2DArray src;
#endif
#ifdef ADD
layout(rgba32f, set = 0, binding = 1) uniform readonly image2D add;
#endif
#if defined(MIX) || defined(SUM) && !defined(PIXELS)
layout(rgba32f, set = 0, binding = 1) uniform readonly image2DArray add;
#endif

#if defined(LOAD) || defined(LOAD_HALF) || defined(LOAD_ROWS)
layout(rgba32ui, set = 0, binding = 2) uniform readonly uimage2D planes[3];
vec2 finite_pair(vec2 v) { return vec2(finite_part(v.x), finite_part(v.y)); }
#ifdef HALF
// Samples 2 x and 2 x + 1 of a row, and 4 x to 4 x + 3.
vec2 pair(uvec4 u, int x) { return finite_pair(unpackHalf2x16(u[x & 3])); }
vec4 four(uvec4 u, int x)
{
    uvec2 v = (x & 1) == 0 ? u.xy : u.zw;
    return vec4(finite_pair(unpackHalf2x16(v.x)), finite_pair(unpackHalf2x16(v.y)));
}
const int SHIFT = 3;
#else
vec2 pair(uvec4 u, int x) { return finite_pair(uintBitsToFloat((x & 1) == 0 ? u.xy : u.zw)); }
vec4 four(uvec4 u, int x) { return vec4(finite_pair(uintBitsToFloat(u.xy)), finite_pair(uintBitsToFloat(u.zw))); }
const int SHIFT = 2;
#endif
#endif

#ifdef LOAD
void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy), texel = ivec2(at.x >> SHIFT, at.y);
    vec3 c = vec3(pair(imageLoad(planes[0], texel), at.x >> 1)[at.x & 1], 0.0, 0.0);
    if (COUNT == 3)
        c.gb = vec2(pair(imageLoad(planes[1], texel), at.x >> 1)[at.x & 1],
                    pair(imageLoad(planes[2], texel), at.x >> 1)[at.x & 1]);
    c *= stage.weight.x;
#ifdef MATTE
    c *= imageLoad(src, at).x * stage.weight.w;
#endif
    result = vec4(glowing(min(c, FLOAT_MAX), CURVE), 0.0);
}
#endif

#ifdef LOAD_HALF
void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 low = vec3(0.0), high = vec3(0.0);
    [[unroll]] for (int y = 0; y < 2; y++) {
        ivec2 texel = ivec2(2 * at.x >> SHIFT, 2 * at.y + y);
        vec2 r = pair(imageLoad(planes[0], texel), at.x), g = vec2(0.0), b = vec2(0.0);
        if (COUNT == 3) {
            g = pair(imageLoad(planes[1], texel), at.x);
            b = pair(imageLoad(planes[2], texel), at.x);
        }
        vec3 left = vec3(r.x, g.x, b.x), right = vec3(r.y, g.y, b.y);
        if (OPTION == 0) {
            left = glowing(left, CURVE);
            right = glowing(right, CURVE);
        }
        vec3 both = left * 0.5 + right * 0.5;
        if (y == 0)
            low = both;
        else
            high = both;
    }
    vec3 mean = low * 0.5 + high * 0.5;
    if (OPTION == 1)
        mean = glowing(mean, CURVE);
    result = vec4(mean * stage.weight.x, 0.0);
}
#endif

#ifdef LOAD_ROWS
void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy), texel = ivec2(4 * at.x >> SHIFT, at.y);
    red = four(imageLoad(planes[0], texel), at.x) * stage.weight.x;
    green = blue = vec4(0.0);
    if (COUNT == 3) {
        green = four(imageLoad(planes[1], texel), at.x) * stage.weight.x;
        blue = four(imageLoad(planes[2], texel), at.x) * stage.weight.x;
    }
}
#endif

#ifdef SAMPLE
// An image cannot be handed to a function with its format.
#define BILINEAR(NAME, IMAGE)                                                                                                  \
    vec3 NAME(ivec2 at, ivec2 from, ivec2 to, ivec2 offset)                                                                    \
    {                                                                                                                          \
        ivec2 low, high;                                                                                                       \
        vec2 near, far;                                                                                                        \
        along(at.x, from.x, to.x, offset.x, low.x, high.x, near.x, far.x);                                                     \
        along(at.y, from.y, to.y, offset.y, low.y, high.y, near.y, far.y);                                                     \
        vec3 upper = imageLoad(IMAGE, low).rgb * near.x + imageLoad(IMAGE, ivec2(high.x, low.y)).rgb * far.x;                  \
        vec3 lower = imageLoad(IMAGE, ivec2(low.x, high.y)).rgb * near.x + imageLoad(IMAGE, high).rgb * far.x;                 \
        return upper * near.y + lower * far.y;                                                                                 \
    }
BILINEAR(src_bilinear, src)
#ifdef ADD
BILINEAR(add_bilinear, add)
#endif

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    // Four sums side by side: a chain of additions a quarter as long rounds less.
    vec3 sum[4] = vec3[](vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0));
    [[unroll]] for (int i = 0; i < COUNT; i++) {
        vec4 tap = stage.tap[i];
        vec3 v = SRC_TEXELS == 1 ? imageLoad(src, clamp(at + ivec2(tap.xy), ivec2(0), stage.src.xy - 1)).rgb
                                 : src_bilinear(at, stage.src.xy, stage.dst.xy, ivec2(tap.xy));
        sum[i & 3] += tap.z * glowing(v, CURVE);
    }
    vec3 all = ((sum[0] + sum[1]) + (sum[2] + sum[3])) * stage.weight.rgb;
#ifdef ADD
    all += OPTION == 1 ? imageLoad(add, at).rgb : add_bilinear(at, stage.add.xy, stage.dst.xy, ivec2(0));
#endif
    // Never Inf: Inf times a weight of 0 would be NaN.
    result = vec4(min(all, FLOAT_MAX), 0.0);
}
#endif

#ifdef ROWS
void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    int row = at.y - stage.dst.z;
    vec3 v[4];
    [[unroll]] for (int i = 0; i < 4; i++) {
        int x = min(4 * at.x + i, stage.dst.x - 1), low, high;
        float near, far;
        if (SRC_TEXELS == 1) {
            v[i] = imageLoad(src, ivec2(x, row)).rgb;
        } else {
            along(x, stage.src.x, stage.dst.x, 0, low, high, near, far);
            v[i] = imageLoad(src, ivec2(low, row)).rgb * near + imageLoad(src, ivec2(high, row)).rgb * far;
        }
    }
    red = vec4(v[0].r, v[1].r, v[2].r, v[3].r);
    green = vec4(v[0].g, v[1].g, v[2].g, v[3].g);
    blue = vec4(v[0].b, v[1].b, v[2].b, v[3].b);
}
#endif

#ifdef MIX
void add_glow(float weight, vec4 r, vec4 g, vec4 b)
{
    [[unroll]] for (int i = 0; i < 4; i++) {
        vec3 v = weight * glowing(vec3(r[i], g[i], b[i]), CURVE);
        red[i] += v.r;
        green[i] += v.g;
        blue[i] += v.b;
    }
}

vec4 drawn(int x, int low, int high, float near, float far, int layer)
{
    return imageLoad(src, ivec3(x, low, layer)) * near + imageLoad(src, ivec3(x, high, layer)) * far;
}

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    red = green = blue = vec4(0.0);
    add_glow(stage.tap[0].z, imageLoad(add, ivec3(at, 0)), imageLoad(add, ivec3(at, 1)), imageLoad(add, ivec3(at, 2)));
    [[unroll]] for (int i = 1; i < COUNT; i++) {
        vec4 section = stage.tap[i];
        int low, high, first = int(section.x);
        float near, far;
        along(at.y, int(section.y), stage.dst.y, 0, low, high, near, far);
        low += first;
        high += first;
        add_glow(section.z, drawn(at.x, low, high, near, far, 0), drawn(at.x, low, high, near, far, 1),
                 drawn(at.x, low, high, near, far, 2));
    }
    if (OPTION == 1) {
        [[unroll]] for (int i = 0; i < 4; i++) {
            vec2 d = (vec2(4 * at.x + i, at.y) - stage.numbers.xy) - stage.numbers.zw;
            d.x *= stage.more.y;
            float glow = exact_exp2(-1.4426950 * dot(d, d) * stage.more.x);
            red[i] += stage.weight.r * glow;
            green[i] += stage.weight.g * glow;
            blue[i] += stage.weight.b * glow;
        }
    }
    red = min(red, FLOAT_MAX);
    green = min(green, FLOAT_MAX);
    blue = min(blue, FLOAT_MAX);
}
#endif

#ifdef SUM
// The host adds the columns in double: here are some hundred additions in a row at most.
void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 sum[4] = vec3[](vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0));
    int first = at.x * stage.src.z;
#ifdef PIXELS
    int last = min(first + stage.src.z, stage.src.x);
    for (int x = first; x < last; x++)
        sum[0] += imageLoad(src, ivec2(x, at.y)).rgb * stage.weight.x;
#else
    int last = min(first + stage.src.z, (stage.dst.x + 3) / 4);
    for (int x = first; x < last; x++) {
        vec4 r = imageLoad(add, ivec3(x, at.y, 0)), g = imageLoad(add, ivec3(x, at.y, 1)), b = imageLoad(add, ivec3(x, at.y, 2));
        [[unroll]] for (int i = 0; i < 4; i++)
            sum[i] += 4 * x + i < stage.dst.x ? glowing(vec3(r[i], g[i], b[i]), CURVE) * stage.weight.x : vec3(0.0);
    }
#endif
    result = vec4((sum[0] + sum[1]) + (sum[2] + sum[3]), 0.0);
}
#endif
