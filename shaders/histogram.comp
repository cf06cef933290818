#version 460
// SPDX-License-Identifier: Apache-2.0
#extension GL_GOOGLE_include_directive : require
// exposure=auto: how many pixels have a log2 luminance in each of 256 bins over -16 .. 16 (METHODS section 1, auto exposure). The bins are
// exact: 1/8 stop wide, their edges 2^(k/8) compared as mantissas, so no logarithm is taken and every device counts alike.
// -D CHANNELS, HALF as in bright.frag.
#define READS_IN
#include "common.glsl"
#ifdef HALF
const bool IS_HALF = true;
const int WIDE = 8;
#else
const bool IS_HALF = false;
const int WIDE = 4;
#endif

layout(local_size_x = 8, local_size_y = 8) in;
layout(std430, set = 0, binding = 6) buffer Counts { uint count[256]; } counts;
shared uint bins[256];

// Mantissas of 2^(k/8), k = 1 .. 7.
const uint EDGE[7] = uint[](0x0b95c2u, 0x1837f1u, 0x25fed7u, 0x3504f4u, 0x45672bu, 0x5744fdu, 0x6ac0c7u);

void main()
{
    uint local = gl_LocalInvocationIndex;
    [[unroll]] for (int i = 0; i < 4; i++)
        bins[local + 64u * uint(i)] = 0u;
    barrier();
    ivec2 at = ivec2(gl_GlobalInvocationID.xy);
    if (at.x * WIDE < pass.frame.x && at.y < pass.frame.y) {
        uvec4 r = imageLoad(planes[0], at), g = r, b = r;
#if CHANNELS == 3
        g = imageLoad(planes[1], at);
        b = imageLoad(planes[2], at);
#endif
        for (int i = 0; i < WIDE; i++) {
            vec3 c = vec3(finite_part(sample_bits(r, i, IS_HALF)), finite_part(sample_bits(g, i, IS_HALF)),
                          finite_part(sample_bits(b, i, IS_HALF)));
            float l = CHANNELS == 3 ? dot(c, pass.luma.rgb) : c.r;
            uint bits = floatBitsToUint(l);
            if (at.x * WIDE + i < pass.frame.x && l > 0.0 && !nonfinite(bits)) {
                int bin = (int(bits >> 23) - 127 + 16) * 8;
                uint mantissa = bits & 0x7fffffu;
                for (int k = 0; k < 7; k++)
                    bin += mantissa >= EDGE[k] ? 1 : 0;
                atomicAdd(bins[clamp(bin, 0, 255)], 1u);
            }
        }
    }
    barrier();
    [[unroll]] for (int i = 0; i < 4; i++) {
        uint n = bins[local + 64u * uint(i)];
        if (n > 0u)
            atomicAdd(counts.count[local + 64u * uint(i)], n);
    }
}
