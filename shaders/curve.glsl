// SPDX-License-Identifier: Apache-2.0
// curve.glsl - the bright-pass curves (METHODS section 1, step 4) of one pixel; CURVE is the includer's constant. Twin of
// gain_at() in daemon/bloom_request.c.

vec3 excess(vec3 c)
{
    if (CURVE == 0)
        return c;
    if (CURVE == 1)
        return max(c - pass.bright.x, 0.0);
    float l = dot(c, pass.luma.rgb);
    float gain;
    if (CURVE == 4) {
        // A knee of no width is a step; 1/(2TK) is 0 then.
        float t = pass.bright.z == 0.0 ? float(l > pass.bright.x) : clamp((l - pass.bright.w) * pass.bright.z, 0.0, 1.0);
        gain = t * t * (3.0 - 2.0 * t);
    } else {
        float s = clamp(l - pass.bright.w, 0.0, pass.bright.y);
        gain = max(s * (s * pass.bright.z), max(l - pass.bright.x, 0.0)) / max(l, 1.1754944e-38);
    }
    return c * gain;
}
