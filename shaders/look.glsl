// SPDX-License-Identifier: Apache-2.0
// look.glsl - what the stages of a named look share (METHODS section 2). Twin of struct stage_uniforms in daemon/look_internal.h.
// Images are rgba32f, a pixel a texel; or rows: 4 pixels of a channel in a texel, the channels in 3 layers, several images (sections)
// of the frame's width and of their own heights below each other. Planes are the slot's, 8 halfs or 4 floats in a texel.
#extension GL_EXT_control_flow_attributes : enable

layout(std140, set = 0, binding = 3) uniform Stage {
    ivec4 src;    // width, height of src; sum: z texels a column
    ivec4 add;    // of add
    ivec4 dst;    // of the result, in pixels; rows: z first row of the section; store: z groups of 4 rows of a channel's block
    ivec4 mode;   // x nonfinite policy, z enum display, w enum encoding
    vec4 bright;  // T, 2K, 1/(4K) (smoothstep: 1/(2TK)) or 0 where K is 0, the curve's foot T - K (T - TK)
    vec4 luma;    // w: saturation
    vec4 weight;  // load: x scale, w emission; sample: rgb of the sum; mix: gain * tint of the sun; sum: x scale; store: x k, w emission
    vec4 numbers; // store: x 2^EV, y 1: the glow comes after the tone map; mix: the sun's pixel and rest
    vec4 more;    // mix: x 1/(2 r^2), y pixel aspect of the sun
    vec4 tap[20]; // sample: offset in texels of src, weight; mix, store: a section's first row, height and weight
} stage;

const float FLOAT_MAX = 3.4028235e38;

bool nonfinite(uint bits) { return (bits & 0x7f800000u) == 0x7f800000u; }
float finite_part(float v) { return nonfinite(floatBitsToUint(v)) ? 0.0 : max(v, 0.0); }

// Pixel x of `to` lies between cells low and high of `from`, clamped to the edge, with shares near and far: exact in integers, for
// a float's position would be off by 1e-5 at x = 300. Sizes to 16384. Each share is rounded once, so that it is right to its own
// last bit: 1 - far would not be.
void along(int x, int from, int to, int offset, out int low, out int high, out float near, out float far)
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
    low = clamp(q - 1 + offset, 0, from - 1);
    high = clamp(q + offset, 0, from - 1);
    near = float(d - rest) / float(d);
    far = float(rest) / float(d);
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
