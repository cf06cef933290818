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

layout(location = 0) out uvec4 out0;
layout(location = 1) out uvec4 out1;
layout(location = 2) out uvec4 out2;
layout(location = 3) out uvec4 out3;

#ifdef HALF
const int WIDE = 8;
#else
const int WIDE = 4;
#endif

#include "glow.glsl"

// What the scan of the frame has shown: bit 0, no NaN and no Inf; bit 1, no sum reaches the type's largest value.
layout(constant_id = 0) const int KNOWN = 0;
const bool CLEAN = (KNOWN & 1) != 0, IN_RANGE = (KNOWN & 2) != 0;

const float FLOAT_MAX = 3.4028235e38;

uint add_float(uint bits, float b)
{
    bool bad = !CLEAN && nonfinite(bits);
    float base = bad ? 0.0 : uintBitsToFloat(bits), sum = base + b;
    uint made = floatBitsToUint(IN_RANGE ? sum : clamp(sum, -FLOAT_MAX, FLOAT_MAX));
    if (bad)
        return pass.mode.y == 1 ? made : bits;
    return b == 0.0 ? bits : made;
}

// Round to nearest even of a finite |v| <= 65504. (The device's own packHalf2x16 takes more than twice the time on a CPU.)
uint half_of(float v)
{
    uint u = floatBitsToUint(v), a = u & 0x7fffffffu;
    uint normal = (a + 0xc8000fffu + ((a >> 13) & 1u)) >> 13; // exponent less 112, half an ulp and the tie's bit more
    uint small = floatBitsToUint(uintBitsToFloat(a) + 0.5) - 0x3f000000u; // the adder rounds at 2^-24
    return (a < 0x38800000u ? small : normal) | ((u >> 16) & 0x8000u);
}

uint add_half(uint bits, float i, float b)
{
    bool bad = !CLEAN && (bits & 0x7c00u) == 0x7c00u;
    float sum = (bad ? 0.0 : i) + b;
    uint made = half_of(IN_RANGE ? sum : clamp(sum, -65504.0, 65504.0));
    if (bad)
        return pass.mode.y == 1 ? made : bits;
    return b == 0.0 ? bits : made;
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
    float coarse[GLOW_ROWS][GLOW_CELLS];
    glow_read(at.x, block, group, coarse);
    uvec4 result[4];
    [[unroll]] for (int p = 0; p < 4; p++) {
        float b[WIDE];
        glow_row(coarse, p, b);
        ivec2 q = ivec2(at.x, min(4 * group + p, pass.frame.y - 1));
        result[p] = line(imageLoad(planes[0], q), b);
    }
    out0 = result[0];
    out1 = result[1];
    out2 = result[2];
    out3 = result[3];
}
