// SPDX-License-Identifier: Apache-2.0
// binomial.glsl - b4, b6, b8 (METHODS section 3.1), down and up. Twin of psf_binomial() in daemon/psf.c.

#if ORDER == 4
const float B[4] = float[](0.125, 0.375, 0.375, 0.125);
#elif ORDER == 6
const float B[6] = float[](0.03125, 0.15625, 0.3125, 0.3125, 0.15625, 0.03125);
#elif ORDER == 8
const float B[8] = float[](0.0078125, 0.0546875, 0.1640625, 0.2734375, 0.2734375, 0.1640625, 0.0546875, 0.0078125);
#endif
