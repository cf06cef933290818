#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// Bright pass with everything that is rarely asked for: matte and emission, firefly, clamp, edge=fill (METHODS
// section 1, steps 1 to 4). Pixel by pixel, E stored at full size; bright.frag is the fast one. FEATURES, bits: 0-2 curve, 3 firefly, 4 clamp,
// 5 matte, 6 the matte is half, 7 fill. -D HALF, CHANNELS as in bright.frag.
#define READS_IN
#include "common.glsl"

layout(constant_id = 0) const int FEATURES = 3;
const int CURVE = FEATURES & 7;
const bool FIREFLY = (FEATURES & 8) != 0, CLAMP = (FEATURES & 16) != 0, MATTE = (FEATURES & 32) != 0;
const bool MATTE_HALF = (FEATURES & 64) != 0, FILL = (FEATURES & 128) != 0;

#include "curve.glsl"

#ifdef HALF
const bool IS_HALF = true;
#else
const bool IS_HALF = false;
#endif

layout(location = 0) out vec4 out_r0;
layout(location = 1) out vec4 out_r1;
#if CHANNELS == 3
layout(location = 2) out vec4 out_g0;
layout(location = 3) out vec4 out_g1;
layout(location = 4) out vec4 out_b0;
layout(location = 5) out vec4 out_b1;
#endif

// The source at a pixel, sanitised; the border's beyond it.
vec3 source_at(ivec2 at)
{
    at = clamp(at, pass.window.xy, pass.window.zw - 1);
    ivec2 texel = ivec2(IS_HALF ? at.x >> 3 : at.x >> 2, at.y);
    vec3 s = vec3(0.0);
    s.r = finite_part(sample_bits(imageLoad(planes[0], texel), at.x, IS_HALF));
#if CHANNELS == 3
    s.g = finite_part(sample_bits(imageLoad(planes[1], texel), at.x, IS_HALF));
    s.b = finite_part(sample_bits(imageLoad(planes[2], texel), at.x, IS_HALF));
#endif
    if (MATTE) {
        float gain = finite_part(matte_at(at, MATTE_HALF)) * pass.limit.z;
        s *= gain;
        s = vec3(finite_part(s.r), finite_part(s.g), finite_part(s.b));
    }
    return s;
}

float luminance(vec3 s) { return CHANNELS == 3 ? dot(s, pass.luma.rgb) : s.r; }
// Beyond the canvas there is nothing, with edge=fill too: the ring around a level must be 0.
bool on_canvas(ivec2 at)
{
    return all(greaterThanEqual(at, ivec2(-pass.mode.x))) && all(lessThan(at, pass.frame.xy + pass.mode.x));
}
bool inside(ivec2 at) { return all(greaterThanEqual(at, pass.window.xy)) && all(lessThan(at, pass.window.zw)); }

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    ivec2 first = ivec2((at.x - 2) * 4, at.y * 2 - 8) - pass.mode.x;
    vec3 s[4][6];
    [[unroll]] for (int y = 0; y < 4; y++)
        [[unroll]] for (int x = 0; x < 6; x++)
            s[y][x] = FIREFLY || (y > 0 && y < 3 && x > 0 && x < 5) ? source_at(first + ivec2(x - 1, y - 1)) : vec3(0.0);
    vec3 e[2][4];
    [[unroll]] for (int y = 0; y < 2; y++) {
        [[unroll]] for (int x = 0; x < 4; x++) {
            ivec2 pixel = first + ivec2(x, y);
            vec3 c = s[y + 1][x + 1];
            if (FIREFLY) {
                // With edge=fill a pixel outside is the border's, and so is what its neighbours make of it.
                ivec2 near = clamp(pixel, pass.window.xy, pass.window.zw - 1);
                float sum = 0.0, count = 0.0;
                [[unroll]] for (int j = -1; j <= 1; j++)
                    [[unroll]] for (int i = -1; i <= 1; i++) {
                        bool counts = (i != 0 || j != 0) && inside(near + ivec2(i, j));
                        float l = FILL ? luminance(source_at(near + ivec2(i, j))) : luminance(s[y + 1 + j][x + 1 + i]);
                        sum += counts ? l : 0.0;
                        count += counts ? 1.0 : 0.0;
                    }
                float l = luminance(c), most = pass.limit.y * (sum / max(count, 1.0));
                if (count > 0.0 && l > most)
                    c *= most / l;
            }
            vec3 v = excess(c);
            if (CLAMP) {
                float l = luminance(v);
                if (l > pass.limit.x)
                    v *= pass.limit.x / l;
            }
            e[y][x] = (FILL ? on_canvas(pixel) : inside(pixel)) ? v : vec3(0.0);
        }
    }
    out_r0 = vec4(e[0][0].r, e[0][1].r, e[0][2].r, e[0][3].r);
    out_r1 = vec4(e[1][0].r, e[1][1].r, e[1][2].r, e[1][3].r);
#if CHANNELS == 3
    out_g0 = vec4(e[0][0].g, e[0][1].g, e[0][2].g, e[0][3].g);
    out_g1 = vec4(e[1][0].g, e[1][1].g, e[1][2].g, e[1][3].g);
    out_b0 = vec4(e[0][0].b, e[0][1].b, e[0][2].b, e[0][3].b);
    out_b1 = vec4(e[1][0].b, e[1][1].b, e[1][2].b, e[1][3].b);
#endif
}
