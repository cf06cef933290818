// SPDX-License-Identifier: Apache-2.0
// glow.glsl - B, without intensity, of the 4 rows of WIDE pixels that a fragment of a picture makes. ORDER 4, 6, 8: from the
// level-1 sum, doubled here; ORDER 0: from the full-size sum. All that a fragment needs is read first and then each row made by
// itself, down before across: so a row's numbers stay in registers.
#if ORDER
#include "up.glsl"
// Pixel WIDE*c is fine cell 2m: coarse column m + 8.
const int GLOW_FAR = WIDE / 2 - 1 - LOW, GLOW_CELLS = GLOW_FAR - LOW + 1, GLOW_ROWS = 2 - 2 * LOW;
#else
const int GLOW_CELLS = WIDE, GLOW_ROWS = 4;
#endif

void glow_read(int column, int block, int group, out float v[GLOW_ROWS][GLOW_CELLS])
{
#if ORDER == 0
    [[unroll]] for (int p = 0; p < 4; p++) {
        [[unroll]] for (int t = 0; t < WIDE / 4; t++) {
            vec4 a = add_at(column * (WIDE / 4) + 2 + t + (pass.mode.x >> 2), block, 4 * group + 8 + p + pass.mode.x);
            [[unroll]] for (int i = 0; i < 4; i++)
                v[p][4 * t + i] = a[i];
        }
    }
#else
    int first = column * (WIDE / 2) + 8 + LOW + (pass.mode.x >> 1), row0 = 2 * group + 8 + LOW + (pass.mode.x >> 1);
    int texel = first >> 2;
    const int EVEN_AT = LOW & 3, ODD_AT = (2 + LOW) & 3, TEXELS = WIDE == 8 ? 3 : 2;
    bool odd = WIDE == 4 && (column & 1) != 0;
    [[unroll]] for (int r = 0; r < GLOW_ROWS; r++) {
        float c[12];
        [[unroll]] for (int t = 0; t < TEXELS; t++) {
            vec4 a = add_at(texel + t, block, row0 + r);
            c[4 * t] = a.x;
            c[4 * t + 1] = a.y;
            c[4 * t + 2] = a.z;
            c[4 * t + 3] = a.w;
        }
        [[unroll]] for (int i = 0; i < GLOW_CELLS; i++)
            v[r][i] = odd ? c[ODD_AT + i] : c[EVEN_AT + i];
    }
#endif
}

void glow_row(float v[GLOW_ROWS][GLOW_CELLS], int p, out float b[WIDE])
{
#if ORDER == 0
    [[unroll]] for (int i = 0; i < WIDE; i++)
        b[i] = v[p][i];
#else
    float c[GLOW_CELLS];
    [[unroll]] for (int i = 0; i < GLOW_CELLS; i++) {
        c[i] = 0.0;
        [[unroll]] for (int r = 0; r < GLOW_ROWS; r++)
            c[i] += up_weight(p & 1, r + LOW - (p >> 1)) * v[r][i];
    }
    [[unroll]] for (int i = 0; i < WIDE; i++) {
        b[i] = 0.0;
        [[unroll]] for (int d = 0; d < GLOW_CELLS; d++)
            b[i] += up_weight(i & 1, d + LOW - (i >> 1)) * c[d];
    }
#endif
}
