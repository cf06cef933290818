// SPDX-License-Identifier: Apache-2.0
// common.glsl - the layout that every pass shares. Twin of daemon/bloom_internal.h.
//
// A pyramid level is an rgba32f 2D array. One texel holds 4 cells side by side of one channel; layer p of the
// 4 holds the rows y with (y + 8) % 4 == p, so that a fragment, which writes one texel to each of 4
// attachments, makes a block of 4 x 4 cells and shares its reads among them. The channels stand
// below each other, each a block of `groups` rows of texels. Cell (0,0) of a level is at column 8, row 8
// of its block: two texels (two groups) on each side are the apron, where light that left the frame is kept
// for the way back, and outside it a ring that is always 0. Reads are clamped to the ring: outside the
// data window there is no light (METHODS section 3.1, borders).
//
// "Layered" images have the same cells, but rows in two phases, and channel and phase in the layer:
// layer = channel * 2 + row % 2. Only the bright pass, which makes all channels at once, writes them.
#extension GL_EXT_control_flow_attributes : enable

layout(std140, set = 0, binding = 3) uniform Pass {
    ivec4 src;      // x: texels of a row, y: groups of a block
    ivec4 add;      // the same of the image that is added
    ivec4 frame;    // width, height of the planes; z: groups of a block of the target
    ivec4 mode;     // x: pixels between the canvas' corner and the planes', a multiple of 16; y: nonfinite policy;
                    // z, w: size of the dirt image
    vec4 bright;    // T, 2K, 1/(4K) (smoothstep: 1/(2TK)) or 0 where K is 0, the curve's foot T - K (T - TK)
    vec4 luma;      // w: 2^exposure, for the display
    vec4 weight;    // of this pass's result, for R, G, B; in .w the gain of a composite
    vec4 limit;     // clamp, firefly, emission, saturation
    vec4 dirt;      // gain, the image's size over the picture's in x and y
    ivec4 window;   // the data window within the planes: first x, y, and those past the last
    vec4 tap[11];   // half kernel: tap[k / 4][k % 4]
} pass;

float tap(int k) { return pass.tap[k >> 2][k & 3]; }

// How levels are stored: float32, or -D STORE_HALF as half, all numbers scaled by a power of 2 so that none is beyond it. The
// attachment only cuts digits off, so rounding to nearest even is done before: Veltkamp's splitting at 11 bits.
#ifdef STORE_HALF
#define STORED rgba16f
vec4 stored(vec4 v)
{
    precise vec4 t = v * 8193.0;
    precise vec4 low = t - v;
    precise vec4 high = t - low;
    return high;
}
#else
#define STORED rgba32f
vec4 stored(vec4 v) { return v; }
#endif

#ifdef READS_SRC
layout(STORED, set = 0, binding = 0) uniform readonly image2DArray src;

#ifdef LAYERED
// group and phase count 4-row groups; here a group has two.
vec4 src_at(int column, int block, int group, int phase)
{
    int g = clamp(group * 2 + (phase >> 1), 0, pass.src.y - 1);
    return imageLoad(src, ivec3(clamp(column, 0, pass.src.x - 1), g, block * 2 + (phase & 1)));
}
#else
vec4 src_at(int column, int block, int group, int phase)
{
    int g = block * pass.src.y + clamp(group, 0, pass.src.y - 1);
    return imageLoad(src, ivec3(clamp(column, 0, pass.src.x - 1), g, phase));
}
#endif
#endif

#ifdef READS_ADD
layout(STORED, set = 0, binding = 1) uniform readonly image2DArray add;

vec4 add_at(int column, int block, int row)
{
    int g = block * pass.add.y + clamp(row >> 2, 0, pass.add.y - 1);
    return imageLoad(add, ivec3(clamp(column, 0, pass.add.x - 1), g, row & 3));
}
#endif

#ifdef READS_IN
layout(rgba32ui, set = 0, binding = 2) uniform readonly uimage2D planes[3];
layout(rgba32ui, set = 0, binding = 4) uniform readonly uimage2D matte_plane;

// Sample x of row y of an image of 8 halfs or 4 floats a texel.
float sample_bits(uvec4 u, int x, bool of_half)
{
    int k = of_half ? (x & 7) >> 1 : x & 3;
    uint word = k < 2 ? (k == 0 ? u.x : u.y) : (k == 2 ? u.z : u.w);
    if (!of_half)
        return uintBitsToFloat(word);
    vec2 two = unpackHalf2x16(word);
    return (x & 1) == 0 ? two.x : two.y;
}
float matte_at(ivec2 at, bool of_half) { return sample_bits(imageLoad(matte_plane, ivec2(of_half ? at.x >> 3 : at.x >> 2, at.y)), at.x, of_half); }
#endif

#ifdef WRITES_LEVEL
layout(location = 0) out vec4 out0;
layout(location = 1) out vec4 out1;
layout(location = 2) out vec4 out2;
layout(location = 3) out vec4 out3;

// Which 4 x 4 block of cells this fragment is.
void where(out int column, out int block, out int group)
{
    ivec2 at = ivec2(gl_FragCoord.xy);
    column = at.x;
    block = at.y / pass.frame.z;
    group = at.y - block * pass.frame.z;
}
#endif

bool nonfinite(uint bits) { return (bits & 0x7f800000u) == 0x7f800000u; }

float finite_part(float v)
{
    return nonfinite(floatBitsToUint(v)) ? 0.0 : max(v, 0.0);
}
