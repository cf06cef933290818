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
    ivec4 frame;    // width, height of the data window; z: groups of a block of the target
    ivec4 mode;     // x: curve, y: nonfinite policy
    vec4 bright;    // T, 2K, 1/(4K) (smoothstep: 1/(2TK)) or 0 where K is 0, the curve's foot T - K (T - TK)
    vec4 luma;
    vec4 weight;    // of this pass's result; in .w the gain of a composite
    vec4 tap[11];   // half kernel: tap[k / 4][k % 4]
} pass;

float tap(int k) { return pass.tap[k >> 2][k & 3]; }

#ifdef READS_SRC
layout(rgba32f, set = 0, binding = 0) uniform readonly image2DArray src;

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
layout(rgba32f, set = 0, binding = 1) uniform readonly image2DArray add;

vec4 add_at(int column, int block, int row)
{
    int g = block * pass.add.y + clamp(row >> 2, 0, pass.add.y - 1);
    return imageLoad(add, ivec3(clamp(column, 0, pass.add.x - 1), g, row & 3));
}
#endif

#ifdef READS_IN
layout(rgba32ui, set = 0, binding = 2) uniform readonly uimage2D planes[3];
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
