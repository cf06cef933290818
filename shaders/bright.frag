#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// Bright pass at full resolution (METHODS section 1, steps 1 and 4), all channels at once, 4 cells x 2 rows
// a fragment. With ORDER the first horizontal halving is taken along (the result has half the columns and
// all rows), so that E itself is never stored; ORDER 0 stores it.
// -D HALF: input planes hold 8 halfs in a texel, else 4 floats. -D CHANNELS 3 or 1.
#define READS_IN
#include "common.glsl"
#if ORDER
#include "binomial.glsl"
#endif

// Bits 0-2 the curve, 3: the scan has found no NaN and no Inf, 4: nor a negative sample.
layout(constant_id = 0) const int FEATURES = 3;
const int CURVE = FEATURES & 7;
const bool CLEAN = (FEATURES & 8) != 0, POSITIVE = (FEATURES & 16) != 0;

#if CHANNELS == 3
layout(location = 0) out vec4 out_r0;
layout(location = 1) out vec4 out_r1;
layout(location = 2) out vec4 out_g0;
layout(location = 3) out vec4 out_g1;
layout(location = 4) out vec4 out_b0;
layout(location = 5) out vec4 out_b1;
#else
layout(location = 0) out vec4 out_r0;
layout(location = 1) out vec4 out_r1;
#endif

#ifdef HALF
const int WIDE = 8;
#else
const int WIDE = 4;
#endif

// Input pixels that 4 output cells need: FIRST .. FIRST + SPAN - 1, from the block's own first pixel.
#if ORDER
const int FIRST = 1 - ORDER / 2, SPAN = 6 + ORDER, STEP = 8;
#else
const int FIRST = 0, SPAN = 4, STEP = 4;
#endif

#include "curve.glsl"

float sane(float v)
{
    return CLEAN ? (POSITIVE ? v : max(v, 0.0)) : finite_part(v);
}

void unpack_texel(uvec4 u, out float v[8])
{
#ifdef HALF
    vec2 a = unpackHalf2x16(u.x), b = unpackHalf2x16(u.y), c = unpackHalf2x16(u.z), d = unpackHalf2x16(u.w);
    v = float[](a.x, a.y, b.x, b.y, c.x, c.y, d.x, d.y);
#else
    vec4 f = uintBitsToFloat(u);
    v = float[](f.x, f.y, f.z, f.w, 0.0, 0.0, 0.0, 0.0);
#endif
}

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    // Column 8 of the target is cell 0; x0 is a multiple of WIDE, and the texel before covers FIRST.
    int x0 = (at.x - 2) * STEP, y0 = at.y * 2 - 8;
    const int LEAD = ORDER == 0 ? 0 : 1;
#if ORDER == 0 && defined(HALF)
    // A half texel holds two blocks of 4.
    int texel0 = x0 >> 3;
    bool second = (x0 & 4) != 0;
    const int TEXELS = 1;
#else
    int texel0 = x0 / WIDE - LEAD;
    if (x0 < 0)
        texel0 = -((-x0) / WIDE) - LEAD;
    const int TEXELS = ORDER == 0 ? 1 : WIDE == 8 ? 3 : 4;
#endif
    int texels = (pass.frame.x + WIDE - 1) / WIDE;
    vec4 result[2][3];
    [[unroll]] for (int row = 0; row < 2; row++) {
        int y = y0 + row;
        bool inside_y = y >= 0 && y < pass.frame.y;
        int yc = clamp(y, 0, pass.frame.y - 1);
        vec3 e[32];
        [[unroll]] for (int t = 0; t < TEXELS; t++) {
            int tc = clamp(texel0 + t, 0, texels - 1);
            // Outside the planes there is no light; past a row's last pixel its texel holds 0.
            bool inside = inside_y && tc == texel0 + t;
            float r[8], g[8], b[8];
            unpack_texel(inside ? imageLoad(planes[0], ivec2(tc, yc)) : uvec4(0u), r);
#if CHANNELS == 3
            unpack_texel(inside ? imageLoad(planes[1], ivec2(tc, yc)) : uvec4(0u), g);
            unpack_texel(inside ? imageLoad(planes[2], ivec2(tc, yc)) : uvec4(0u), b);
#else
            g = r;
            b = r;
#endif
            [[unroll]] for (int i = 0; i < WIDE; i++) {
                int k = t * WIDE + i - LEAD * WIDE; // from x0
                if (k < FIRST || k >= FIRST + SPAN) {
#if !(ORDER == 0 && defined(HALF))
                    continue;
#endif
                }
#if CHANNELS == 3
                e[t * WIDE + i] = excess(vec3(sane(r[i]), sane(g[i]), sane(b[i])));
#else
                e[t * WIDE + i] = excess(vec3(sane(r[i]), 0.0, 0.0));
#endif
            }
        }
        [[unroll]] for (int i = 0; i < 4; i++) {
            vec3 sum = vec3(0.0);
#if ORDER
            [[unroll]] for (int k = 0; k < ORDER; k++)
                sum += B[k] * e[2 * i + k + FIRST + LEAD * WIDE];
#elif defined(HALF)
            sum = second ? e[4 + i] : e[i];
#else
            sum = e[i];
#endif
#ifdef STORE_HALF
            sum *= pass.weight.w;
#endif
            result[row][0][i] = sum.r;
            result[row][1][i] = sum.g;
            result[row][2][i] = sum.b;
        }
    }
    out_r0 = stored(result[0][0]);
    out_r1 = stored(result[1][0]);
#if CHANNELS == 3
    out_g0 = stored(result[0][1]);
    out_g1 = stored(result[1][1]);
    out_b0 = stored(result[0][2]);
    out_b1 = stored(result[1][2]);
#endif
}
