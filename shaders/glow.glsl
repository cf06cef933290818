// SPDX-License-Identifier: Apache-2.0
// glow.glsl - B, without intensity, of the 4 rows of WIDE pixels that a fragment of the composite makes. ORDER 4, 6, 8:
// from the level-1 sum, doubled here; ORDER 0: from the full-size sum.

#if ORDER
#include "up.glsl"
#endif

void glow(int column, int block, int group, out float b[4][WIDE])
{
#if ORDER == 0
    [[unroll]] for (int p = 0; p < 4; p++) {
        [[unroll]] for (int t = 0; t < WIDE / 4; t++) {
            vec4 v = add_at(column * (WIDE / 4) + 2 + t + (pass.mode.x >> 2), block, 4 * group + 8 + p + pass.mode.x);
            [[unroll]] for (int i = 0; i < 4; i++)
                b[p][4 * t + i] = v[i];
        }
    }
#else
    // Pixel WIDE*c is fine cell 2m: coarse column m + 8.
    const int FAR = WIDE / 2 - 1 - LOW, NEED = FAR - LOW + 1, ROWS = 2 - 2 * LOW;
    int first = column * (WIDE / 2) + 8 + LOW + (pass.mode.x >> 1), row0 = 2 * group + 8 + LOW + (pass.mode.x >> 1);
    int texel = first >> 2;
    const int EVEN_AT = LOW & 3, ODD_AT = (2 + LOW) & 3, TEXELS = WIDE == 8 ? 3 : 2;
    bool odd = WIDE == 4 && (column & 1) != 0;
    [[unroll]] for (int p = 0; p < 4; p++)
        [[unroll]] for (int i = 0; i < WIDE; i++)
            b[p][i] = 0.0;
    [[unroll]] for (int r = 0; r < ROWS; r++) {
        float v[12];
        [[unroll]] for (int t = 0; t < TEXELS; t++) {
            vec4 a = add_at(texel + t, block, row0 + r);
            v[4 * t] = a.x;
            v[4 * t + 1] = a.y;
            v[4 * t + 2] = a.z;
            v[4 * t + 3] = a.w;
        }
        float c[NEED];
        [[unroll]] for (int i = 0; i < NEED; i++)
            c[i] = odd ? v[ODD_AT + i] : v[EVEN_AT + i];
        [[unroll]] for (int i = 0; i < WIDE; i++) {
            float line = 0.0;
            [[unroll]] for (int d = 0; d < NEED; d++)
                line += up_weight(i & 1, d + LOW - (i >> 1)) * c[d];
            [[unroll]] for (int p = 0; p < 4; p++)
                b[p][i] += up_weight(p & 1, r + LOW - (p >> 1)) * line;
        }
    }
#endif
}
