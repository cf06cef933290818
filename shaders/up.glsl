// SPDX-License-Identifier: Apache-2.0
// up.glsl - 2x up by b_ORDER (the transpose of down, times 2) of the image `add`, for blocks of cells.
// A fine cell 2m takes coarse m - ORDER/4 ..., a fine cell 2m+1 the mirror image; TAPS = ORDER/2 each.

const int TAPS = ORDER / 2;
#if ORDER == 4
const float U[2] = float[](0.25, 0.75);                           // cells m-1, m of fine 2m
const int LOW = -1;
#elif ORDER == 6
const float U[3] = float[](0.3125, 0.625, 0.0625);                // m-1, m, m+1
const int LOW = -1;
#elif ORDER == 8
const float U[4] = float[](0.015625, 0.328125, 0.546875, 0.109375); // m-2, m-1, m, m+1
const int LOW = -2;
#endif

// Weight of coarse cell m + d for the fine cell of this parity.
float up_weight(int parity, int d)
{
    const int k = (parity == 0 ? d : -d) - LOW;
    return k >= 0 && k < TAPS ? U[k] : 0.0;
}
