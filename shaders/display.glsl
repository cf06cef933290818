// SPDX-License-Identifier: Apache-2.0
// display.glsl - tone maps and transfer curves (METHODS section 1, step 8; tests/reference/reference.h section 7).
// v is >= 0.

const int TONE_NONE = 0, TONE_REINHARD = 1, TONE_ACES = 2;
const int ENCODE_LINEAR = 0, ENCODE_GAMMA22 = 1, ENCODE_SRGB = 2;

float tone_map(int tone, float v)
{
    if (tone == TONE_REINHARD)
        return v < 1e18 ? v / (v + 1.0) : 1.0;
    if (tone == TONE_ACES) // beyond 1e8 its limit, to a float's last digit; v * v would overflow
        return v < 1e8 ? (v * (2.51 * v + 0.03)) / (v * (2.43 * v + 0.59) + 0.14) : 2.51 / 2.43;
    return v;
}

float encode(int curve, float v)
{
    if (curve == ENCODE_GAMMA22)
        return pow(v, 1.0 / 2.2);
    if (curve == ENCODE_SRGB)
        return v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1.0 / 2.4) - 0.055;
    return v;
}
