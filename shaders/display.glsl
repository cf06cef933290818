// SPDX-License-Identifier: Apache-2.0
// display.glsl - tone maps, saturation and transfer curves of METHODS section 1, step 8, for v >= 0. The device's own pow and
// exp2 may be off by some 1e-5; the ones here keep about 3e-7, so that a picture holds its bound on every device.
// Kinds are enum display and enum encoding of daemon/params.h.

// 2^r for r within -126 .. 127; below it 0.
float exact_exp2(float r)
{
    if (r < -125.0)
        return 0.0;
    float k = floor(r + 0.5), x = (r - k) * 0.69314718;
    // exp(x) to x^7 / 7!, |x| <= .3466: the rest is 5e-9.
    float e = 1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x * (1.0 / 120.0 + x * (1.0 / 720.0 + x / 5040.0))))));
    return e * uintBitsToFloat(uint(int(k) + 127) << 23);
}

// v^(high + low) for 0 < high < 1 whose last bits are 0, so that its product with v's exponent is exact. Below the normal
// floats 0.
float exact_pow(float v, float high, float low)
{
    uint bits = floatBitsToUint(v);
    if (bits < 0x00800000u)
        return 0.0;
    // v = m * 2^e with m in .7071 .. 1.4142.
    int e = int((bits + 0x004afb0du) >> 23) - 127;
    float m = uintBitsToFloat(bits - (uint(e) << 23));
    // log2 m by the series of artanh, |s| <= .1716: the rest is 4e-10.
    float s = (m - 1.0) / (m + 1.0), q = s * s;
    float log2_m = 2.8853900 * s * (1.0 + q * (1.0 / 3.0 + q * (0.2 + q * (1.0 / 7.0 + q / 9.0))));
    float whole = float(e) * high, k = floor(whole + 0.5);
    float r = (whole - k) + (float(e) * low + (high + low) * log2_m);
    return exact_exp2(r) * uintBitsToFloat(uint(int(k) + 127) << 23);
}

float tone_map(float v, int kind)
{
    if (kind == 1)
        return v / (v + 1.0);
    if (kind == 2) {
        // Narkowicz 2015; from 1 on over v^2, so that no square overflows.
        if (v < 1.0)
            return v * (2.51 * v + 0.03) / (v * (2.43 * v + 0.59) + 0.14);
        float i = 1.0 / v;
        return (2.51 + 0.03 * i) / (2.43 + i * (0.59 + 0.14 * i));
    }
    return v;
}

vec3 saturated(vec3 v, vec3 luma, float saturation)
{
    float l = dot(v, luma);
    return max(vec3(0.0), l + saturation * (v - l));
}

float encoded(float v, int kind)
{
    if (kind == 1)
        return exact_pow(v, 0.45452880859375, 1.6645952e-05); // 1 / 2.2
    if (kind == 2)
        return v <= 0.0031308 ? 12.92 * v : 1.055 * exact_pow(v, 0.416656494140625, 1.0172526e-05) - 0.055; // 1 / 2.4
    return v;
}
