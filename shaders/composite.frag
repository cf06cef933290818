#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// out = I + intensity * B (METHODS section 1, step 7), 4 rows of a texel's pixels a fragment. Where B is 0,
// and where I is not finite (nonfinite=keep), the input's bits are handed on as they are.
// Drawn in one band a channel, so that planes[0] is this channel's (choosing one in the shader reads all three).
// ORDER 4, 6, 8: B is the level-1 sum, doubled here; ORDER 0: B is the full-size sum. -D HALF as in bright.frag.
#define READS_IN
#define READS_ADD
#include "common.glsl"
#if ORDER
#include "up.glsl"
#endif

layout(location = 0) out uvec4 out0;
layout(location = 1) out uvec4 out1;
layout(location = 2) out uvec4 out2;
layout(location = 3) out uvec4 out3;

#ifdef HALF
const int WIDE = 8;
#else
const int WIDE = 4;
#endif

void glow(int column, int block, int group, out float b[4][WIDE])
{
#if ORDER == 0
    [[unroll]] for (int p = 0; p < 4; p++) {
        [[unroll]] for (int t = 0; t < WIDE / 4; t++) {
            vec4 v = add_at(column * (WIDE / 4) + 2 + t, block, 4 * group + 8 + p);
            [[unroll]] for (int i = 0; i < 4; i++)
                b[p][4 * t + i] = v[i];
        }
    }
#else
    // Pixel WIDE*c is fine cell 2m: coarse column m + 8.
    const int FAR = WIDE / 2 - 1 - LOW, NEED = FAR - LOW + 1, ROWS = 2 - 2 * LOW;
    int first = column * (WIDE / 2) + 8 + LOW, row0 = 2 * group + 8 + LOW;
    int texel = first >> 2;
    const int EVEN_AT = LOW & 3, ODD_AT = (2 + LOW) & 3, TEXELS = WIDE == 8 ? 3 : 2;
    bool odd = WIDE == 4 && (column & 1) != 0;
    [[unroll]] for (int p = 0; p < 4; p++)
        [[unroll]] for (int i = 0; i < WIDE; i++)
            b[p][i] = 0.0;
    [[unroll]] for (int r = 0; r < ROWS; r++) {
        float v[12];
        [[unroll]] for (int t = 0; t < TEXELS; t++) {
            vec4 a = add_at(texel + t, block, row0 + r);
            v[4 * t] = a.x;
            v[4 * t + 1] = a.y;
            v[4 * t + 2] = a.z;
            v[4 * t + 3] = a.w;
        }
        float c[NEED];
        [[unroll]] for (int i = 0; i < NEED; i++)
            c[i] = odd ? v[ODD_AT + i] : v[EVEN_AT + i];
        [[unroll]] for (int i = 0; i < WIDE; i++) {
            float line = 0.0;
            [[unroll]] for (int d = 0; d < NEED; d++)
                line += up_weight(i & 1, d + LOW - (i >> 1)) * c[d];
            [[unroll]] for (int p = 0; p < 4; p++)
                b[p][i] += up_weight(p & 1, r + LOW - (p >> 1)) * line;
        }
    }
#endif
}

const float FLOAT_MAX = 3.4028235e38;

uint add_float(uint bits, float b)
{
    bool bad = nonfinite(bits);
    float base = bad ? 0.0 : uintBitsToFloat(bits);
    uint sum = floatBitsToUint(clamp(base + b, -FLOAT_MAX, FLOAT_MAX));
    if (bad)
        return pass.mode.y == 1 ? sum : bits;
    return b == 0.0 ? bits : sum;
}

uint add_half(uint bits, float i, float b)
{
    bool bad = (bits & 0x7c00u) == 0x7c00u;
    uint sum = packHalf2x16(vec2(clamp((bad ? 0.0 : i) + b, -65504.0, 65504.0), 0.0)) & 0xffffu;
    if (bad)
        return pass.mode.y == 1 ? sum : bits;
    return b == 0.0 ? bits : sum;
}

uvec4 line(uvec4 in_bits, float b[WIDE])
{
    uvec4 r;
    float gain = pass.weight.w;
    [[unroll]] for (int i = 0; i < 4; i++) {
#ifdef HALF
        vec2 v = unpackHalf2x16(in_bits[i]);
        r[i] = add_half(in_bits[i] & 0xffffu, v.x, gain * b[2 * i]) |
               add_half(in_bits[i] >> 16, v.y, gain * b[2 * i + 1]) << 16;
#else
        r[i] = add_float(in_bits[i], gain * b[i]);
#endif
    }
    return r;
}

void main()
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    int block = at.y / pass.frame.z, group = at.y - block * pass.frame.z;
    float b[4][WIDE];
    glow(at.x, block, group, b);
    uvec4 result[4];
    [[unroll]] for (int p = 0; p < 4; p++) {
        ivec2 q = ivec2(at.x, min(4 * group + p, pass.frame.y - 1));
        result[p] = line(imageLoad(planes[0], q), b[p]);
    }
    out0 = result[0];
    out1 = result[1];
    out2 = result[2];
    out3 = result[3];
}
