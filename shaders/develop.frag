#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// The composite with everything that is rarely asked for: emission, dirt, mix, screen-add, display, views (METHODS section 1,
// steps 6 to 9). composite.frag is the fast one; the geometry is the same, but all planes are bound in each band. FEATURES,
// bits: 0-2 view, 3-4 composite, 5-6 tone map, 7-8 encoding, 9 saturation, 10 matte, 11 the matte is half, 12 dirt, 13 there is a
// glow (add), 14 there is E (src, at full size), 15 the display is on. -D CHANNELS, HALF, ORDER as in bright.frag and composite.frag.
#define READS_IN
#define READS_ADD
#define READS_SRC
#include "common.glsl"
#include "display.glsl"

layout(constant_id = 0) const int FEATURES = 0;
const int VIEW = FEATURES & 7, MODE = (FEATURES >> 3) & 3, TONE = (FEATURES >> 5) & 3, ENCODING = (FEATURES >> 7) & 3;
const bool SATURATE = (FEATURES & 512) != 0 && CHANNELS == 3, MATTE = (FEATURES & 1024) != 0, MATTE_HALF = (FEATURES & 2048) != 0;
const bool DIRT = (FEATURES & 4096) != 0, GLOW = (FEATURES & 8192) != 0, HAS_E = (FEATURES & 16384) != 0;
const bool DISPLAY = (FEATURES & 32768) != 0;
const int VIEW_FINAL = 0, VIEW_SOURCE = 1, VIEW_BRIGHT = 2, VIEW_BLOOM = 3, VIEW_LEVEL = 4, VIEW_RESIDUAL = 5;
const int MODE_ADD = 0, MODE_MIX = 1, MODE_SCREEN = 2;

layout(rgba32f, set = 0, binding = 5) uniform readonly image2D dirt;

layout(location = 0) out uvec4 out0;
layout(location = 1) out uvec4 out1;
layout(location = 2) out uvec4 out2;
layout(location = 3) out uvec4 out3;

#ifdef HALF
const int WIDE = 8;
const bool IS_HALF = true;
#else
const int WIDE = 4;
const bool IS_HALF = false;
#endif
#include "glow.glsl"

const float FLOAT_MAX = 3.4028235e38;

// The dirt at a picture's pixel, bilinear, clamped to the image's border.
float dirt_at(ivec2 pixel, int c)
{
    ivec2 last = ivec2(pass.mode.z, pass.mode.w) - 1;
    vec2 at = clamp((vec2(pixel) + 0.5) * pass.dirt.yz - 0.5, vec2(0.0), vec2(last));
    ivec2 i = ivec2(at);
    ivec2 j = min(i + 1, last);
    vec2 f = at - vec2(i);
    vec4 v = mix(mix(imageLoad(dirt, i), imageLoad(dirt, ivec2(j.x, i.y)), f.x),
                 mix(imageLoad(dirt, ivec2(i.x, j.y)), imageLoad(dirt, j), f.x), f.y);
    float d = CHANNELS == 1 ? (v.r + v.g + v.b) / 3.0 : v[c];
    return 1.0 - pass.dirt.x + pass.dirt.x * d;
}

float bright_at(ivec2 pixel, int c)
{
    if (any(lessThan(pixel, pass.window.xy)) || any(greaterThanEqual(pixel, pass.window.zw)))
        return 0.0;
    ivec2 at = pixel + pass.mode.x;
    vec4 v = imageLoad(src, ivec3((at.x >> 2) + 2, (at.y + 8) >> 1, c * 2 + (at.y & 1)));
    return (at.x & 2) == 0 ? ((at.x & 1) == 0 ? v.x : v.y) : ((at.x & 1) == 0 ? v.z : v.w);
}

// What channel c of a pixel becomes, before saturation and encoding. base: its scene value, 0 where that is not finite.
float developed(float base, float b, ivec2 pixel, int c)
{
    float k = pass.weight.w, scene = base;
    if (MATTE && VIEW != VIEW_BRIGHT && VIEW != VIEW_BLOOM && VIEW != VIEW_LEVEL)
        scene *= 1.0 + finite_part(matte_at(pixel, MATTE_HALF)) * (pass.limit.z - 1.0);
    float e = HAS_E ? bright_at(pixel, c) : 0.0;
    if (DIRT)
        b *= dirt_at(pixel, c);
    float v;
    switch (VIEW) {
    case VIEW_SOURCE: v = scene; break;
    case VIEW_BRIGHT: v = e; break;
    case VIEW_BLOOM:
    case VIEW_LEVEL: v = k * b; break;
    case VIEW_RESIDUAL: v = scene - e; break;
    default:
        if (MODE == MODE_SCREEN && DISPLAY)
            return tone_map(min(max(scene * pass.luma.w, 0.0), FLOAT_MAX), TONE) + k * b;
        v = MODE == MODE_MIX ? scene + k * (b - e) : scene + k * b;
        if (DISPLAY)
            v = tone_map(min(max(v * pass.luma.w, 0.0), FLOAT_MAX), TONE);
    }
    return clamp(v, -FLOAT_MAX, FLOAT_MAX);
}

uint half_bits(float v) { return packHalf2x16(vec2(clamp(v, -65504.0, 65504.0), 0.0)) & 0xffffu; }

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    int own = at.y / pass.frame.z, group = at.y - own * pass.frame.z;
    float v[CHANNELS][4][WIDE];
    uvec4 own_bits[4];
    [[unroll]] for (int c = 0; c < CHANNELS; c++) {
        // Only saturation looks at the other channels.
        int channel = SATURATE ? c : own;
        if (!SATURATE && c > 0)
            continue;
        float coarse[GLOW_ROWS][GLOW_CELLS];
        if (GLOW)
            glow_read(at.x, channel, group, coarse);
        [[unroll]] for (int p = 0; p < 4; p++) {
            ivec2 texel = ivec2(at.x, min(4 * group + p, pass.frame.y - 1));
            float b[WIDE];
            if (GLOW)
                glow_row(coarse, p, b);
            uvec4 bits;
            if (SATURATE)
                bits = imageLoad(planes[c], texel);
            else // drawn in one band a channel: the band's own plane is the first
                bits = imageLoad(planes[0], texel);
            if (!SATURATE || channel == own)
                own_bits[p] = bits;
            [[unroll]] for (int i = 0; i < WIDE; i++) {
                float base = sample_bits(bits, i, IS_HALF);
                if (nonfinite(floatBitsToUint(base)))
                    base = 0.0;
                v[c][p][i] = developed(base, GLOW ? b[i] : 0.0, ivec2(min(at.x * WIDE + i, pass.frame.x - 1), texel.y), channel);
            }
        }
    }
    uvec4 result[4];
    [[unroll]] for (int p = 0; p < 4; p++) {
        [[unroll]] for (int i = 0; i < WIDE; i++) {
            float value;
            if (SATURATE) {
                vec3 rgb = vec3(v[0][p][i], v[CHANNELS / 2][p][i], v[CHANNELS - 1][p][i]);
                rgb = saturated(rgb, pass.luma.rgb, pass.limit.w);
                value = own == 0 ? rgb.r : own == 1 ? rgb.g : rgb.b;
            } else {
                value = v[0][p][i];
            }
            if (DISPLAY)
                value = encoded(value, ENCODING);
            float base = sample_bits(own_bits[p], i, IS_HALF);
            bool bad = nonfinite(floatBitsToUint(base));
            // A view of the glow alone has nothing of the scene to keep.
            bool keeps = VIEW == VIEW_FINAL || VIEW == VIEW_SOURCE || VIEW == VIEW_RESIDUAL;
            // Displayed, a denormal below 0 is no 0 to be handed on.
            bool keep = keeps && (bad ? pass.mode.y != 1 : !DISPLAY && value == base);
#ifdef HALF
            uint shift = uint(i & 1) * 16u;
            uint bits = keep ? (own_bits[p][i >> 1] >> shift) & 0xffffu : half_bits(value);
            result[p][i >> 1] = shift == 0u ? bits : result[p][i >> 1] | bits << 16;
#else
            result[p][i] = keep ? own_bits[p][i] : floatBitsToUint(value);
#endif
        }
    }
    out0 = result[0];
    out1 = result[1];
    out2 = result[2];
    out3 = result[3];
}
