// SPDX-License-Identifier: Apache-2.0
// look.glsl - what the stages of a named look share (METHODS section 2). Twin of struct stage_uniforms in daemon/look_internal.h.
// Images are rgba32f, a pixel a texel; planes are the slot's, 8 halfs or 4 floats in a texel.
#extension GL_EXT_control_flow_attributes : enable

layout(std140, set = 0, binding = 3) uniform Stage {
    ivec4 src;    // width, height of src
    ivec4 add;    // of add
    ivec4 dst;    // of the result; store: z groups of 4 rows of a channel's block; w channels
    ivec4 mode;   // x nonfinite policy, y enum view, z enum display, w enum encoding
    vec4 bright;  // T, 2K, 1/(4K) (smoothstep: 1/(2TK)) or 0 where K is 0, the curve's foot T - K (T - TK)
    vec4 luma;    // w: saturation
    vec4 weight;  // load: x scale, w emission; sample: rgb of the sum; sun: gain * tint; store: x k, w emission
    vec4 numbers; // store: x 2^EV, y 1: the glow comes after the tone map, z 1: display; sun: pixel, rest and shape
    vec4 more;    // sun: x 1/(2 r^2), y pixel aspect
    vec4 tap[16]; // offset in texels of src, weight
} stage;

const float FLOAT_MAX = 3.4028235e38;

bool nonfinite(uint bits) { return (bits & 0x7f800000u) == 0x7f800000u; }
float finite_part(float v) { return nonfinite(floatBitsToUint(v)) ? 0.0 : max(v, 0.0); }

// Pixel x of `to` lies at cell + t texels of `from`: exact in integers, for a float's position would be off by 1e-5 at x = 300. Sizes to 16384.
void along(int x, int from, int to, out int cell, out float t)
{
    int d = 2 * to, n = (2 * x + 1) * from + to;
    // The quotient of floats is off by one at most; integer division is done a lane at a time on CPUs.
    int q = int(float(n) / float(d)), rest = n - q * d;
    if (rest < 0) {
        q--;
        rest += d;
    } else if (rest >= d) {
        q++;
        rest -= d;
    }
    cell = q - 1;
    t = float(rest) / float(d);
}

// The four texels around pixel `at` of an image of size `to` in one of size `from`, `offset` texels away, clamped to the edge.
void corners(ivec2 at, ivec2 from, ivec2 to, vec2 offset, out ivec2 low, out ivec2 high, out vec2 t)
{
    ivec2 cell;
    along(at.x, from.x, to.x, cell.x, t.x);
    along(at.y, from.y, to.y, cell.y, t.y);
    vec2 whole = floor(offset);
    t += offset - whole;
    cell += ivec2(whole);
    if (t.x >= 1.0) {
        t.x -= 1.0;
        cell.x++;
    }
    if (t.y >= 1.0) {
        t.y -= 1.0;
        cell.y++;
    }
    low = clamp(cell, ivec2(0), from - 1);
    high = clamp(cell + 1, ivec2(0), from - 1);
}

// A function for each image: an image cannot be handed to one with its format.
#define BILINEAR(NAME, IMAGE)                                                                                                  \
    vec4 NAME(ivec2 at, ivec2 from, ivec2 to, vec2 offset)                                                                     \
    {                                                                                                                          \
        ivec2 low, high;                                                                                                       \
        vec2 t;                                                                                                                \
        corners(at, from, to, offset, low, high, t);                                                                           \
        vec4 upper = imageLoad(IMAGE, low) * (1.0 - t.x) + imageLoad(IMAGE, ivec2(high.x, low.y)) * t.x;                       \
        vec4 lower = imageLoad(IMAGE, ivec2(low.x, high.y)) * (1.0 - t.x) + imageLoad(IMAGE, high) * t.x;                      \
        return upper * (1.0 - t.y) + lower * t.y;                                                                              \
    }

// METHODS section 1, step 4. Twin of excess() in bright.frag, which is specialised for its own pass.
vec3 glowing(vec3 c, int curve)
{
    if (curve == 0)
        return c;
    if (curve == 1)
        return max(c - stage.bright.x, 0.0);
    float l = min(dot(c, stage.luma.rgb), FLOAT_MAX), gain;
    if (curve == 4) {
        float t = stage.bright.z == 0.0 ? float(l > stage.bright.x) : clamp((l - stage.bright.w) * stage.bright.z, 0.0, 1.0);
        gain = t * t * (3.0 - 2.0 * t);
    } else {
        float q = clamp(l - stage.bright.w, 0.0, stage.bright.y);
        gain = max(q * (q * stage.bright.z), max(l - stage.bright.x, 0.0)) / max(l, 1.1754944e-38);
    }
    return c * gain;
}
