// SPDX-License-Identifier: Apache-2.0
// wall_def_colour.c - the colour part of a wall definition, above all the matrix from linear Rec.709 to the LEDs' own drive.
//
// From chromaticities (x, y) of the LEDs and of their white, all three full on: P has a column (x/y, 1, (1-x-y)/y) a primary, W is
// the same of the white, S = P^-1 W, and N = P diag(S) takes drive to XYZ (SMPTE RP 177, section 3.3; Lindbloom, "RGB/XYZ
// Matrices"). The wall's matrix is
//     M = E * k * N_led^-1 * A * N_709,
// with A the Bradford adaptation of D65 to the target white (identity unless one is asked for; Lindbloom, "Chromatic
// Adaptation"), k so that the strongest channel of white (1, 1, 1) is 1, and E the definition's explicit matrix.
// Invariant: without E no channel of white exceeds 1, and none is below 0: a white that the LEDs cannot show is a mistake.
#include <math.h>
#include <string.h>

#include "wall_def_internal.h"

struct matrix {
    double m[3][3];
};

static const double d65[2] = { 0.3127, 0.3290 };
static const double rec709[3][2] = { { 0.640, 0.330 }, { 0.300, 0.600 }, { 0.150, 0.060 } }; /* ITU-R BT.709 */

static struct matrix multiply(const struct matrix *a, const struct matrix *b)
{
    struct matrix c;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            c.m[i][k] = a->m[i][0] * b->m[0][k] + a->m[i][1] * b->m[1][k] + a->m[i][2] * b->m[2][k];
    return c;
}

static void apply(const struct matrix *a, const double v[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = a->m[i][0] * v[0] + a->m[i][1] * v[1] + a->m[i][2] * v[2];
}

/* By cofactors; false: (nearly) no inverse. */
static bool invert(const struct matrix *a, struct matrix *out)
{
    const double (*m)[3] = a->m;
    struct matrix c;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            const int r0 = (k + 1) % 3, r1 = (k + 2) % 3, c0 = (i + 1) % 3, c1 = (i + 2) % 3;
            c.m[i][k] = m[r0][c0] * m[r1][c1] - m[r0][c1] * m[r1][c0];
        }
    const double determinant = m[0][0] * c.m[0][0] + m[0][1] * c.m[1][0] + m[0][2] * c.m[2][0];
    if (!(fabs(determinant) > 1e-6))
        return false;
    for (int i = 0; i < 9; i++)
        c.m[i / 3][i % 3] /= determinant;
    *out = c;
    return true;
}

static void to_xyz(const double xy[2], double out[3])
{
    out[0] = xy[0] / xy[1];
    out[1] = 1;
    out[2] = (1 - xy[0] - xy[1]) / xy[1];
}

/* Drive -> XYZ. False: the primaries lie on a line, or the white is not inside their triangle. */
static bool rgb_to_xyz(const double primary[3][2], const double white[2], struct matrix *out)
{
    struct matrix p, inverse;
    double w[3], s[3];
    for (int c = 0; c < 3; c++) {
        double xyz[3];
        to_xyz(primary[c], xyz);
        for (int i = 0; i < 3; i++)
            p.m[i][c] = xyz[i];
    }
    to_xyz(white, w);
    if (!invert(&p, &inverse))
        return false;
    apply(&inverse, w, s);
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < 3; i++)
            out->m[i][c] = p.m[i][c] * s[c];
    return s[0] > 0 && s[1] > 0 && s[2] > 0;
}

static bool bradford(const double from[2], const double to[2], struct matrix *out)
{
    static const struct matrix cone = { { { 0.8951, 0.2664, -0.1614 }, { -0.7502, 1.7135, 0.0367 }, { 0.0389, -0.0685, 1.0296 } } };
    struct matrix back, scale = { { { 0 } } };
    double xyz[3], a[3], b[3];
    to_xyz(from, xyz);
    apply(&cone, xyz, a);
    to_xyz(to, xyz);
    apply(&cone, xyz, b);
    if (!invert(&cone, &back))
        return false;
    for (int i = 0; i < 3; i++)
        scale.m[i][i] = b[i] / a[i];
    const struct matrix half = multiply(&scale, &cone);
    *out = multiply(&back, &half);
    return true;
}

/* ---- reading -------------------------------------------------------------------------------------------------- */

struct measured { /* chromaticities */
    double primary[3][2], white[2], target[2];
    bool any, adapt;
};

static bool read_xy(struct wall_reader *r, const struct wall_node *n, double out[2])
{
    double v[2];
    if (!wall_numbers(r, n, 2, 0, 1, "chromaticity x, y", v))
        return false;
    if (v[1] < 0.01 || v[0] + v[1] > 1) {
        wall_mistake(r, n, "x %.6g, y %.6g; expected a chromaticity: y at least 0.01, x + y at most 1", v[0], v[1]);
        return false;
    }
    memcpy(out, v, sizeof(v));
    return true;
}

static bool read_white(struct wall_reader *r, const struct wall_node *n, double out[2])
{
    /* CIE 15: daylight and equal energy, 2 degree observer. */
    static const struct { const char *name; double xy[2]; } whites[] = {
        { "D50", { 0.3457, 0.3585 } }, { "D55", { 0.3324, 0.3474 } }, { "D65", { 0.3127, 0.3290 } },
        { "D75", { 0.2990, 0.3149 } }, { "D93", { 0.2831, 0.2970 } }, { "E", { 1.0 / 3, 1.0 / 3 } } };
    if (n->kind == NODE_LIST)
        return read_xy(r, n, out);
    for (unsigned i = 0; i < sizeof(whites) / sizeof(whites[0]); i++)
        if (n->kind == NODE_TEXT && strcmp(n->text, whites[i].name) == 0) {
            memcpy(out, whites[i].xy, sizeof(whites[i].xy));
            return true;
        }
    wall_mistake(r, n, "%s; expected a white: [x, y], D50, D55, D65, D75, D93 or E", wall_found(n).s);
    return false;
}

static bool read_primaries(struct wall_reader *r, const struct wall_node *n, struct measured *c)
{
    static const char *const keys[3] = { "red", "green", "blue" };
    const struct wall_node *v[3];
    bool good = true;
    if (!wall_keys(r, n, keys, 3, v))
        return false;
    for (unsigned i = 0; i < 3; i++) {
        if (!v[i])
            wall_mistake(r, n, "%s is not said; expected red, green and blue, each [x, y] as measured", keys[i]);
        good = v[i] && read_xy(r, v[i], c->primary[i]) && good;
    }
    return good;
}

static bool read_measured(struct wall_reader *r, const struct wall_node *primaries, const struct wall_node *white,
                          const struct wall_node *target, struct measured *c)
{
    memcpy(c->primary, rec709, sizeof(rec709));
    memcpy(c->white, d65, sizeof(d65));
    c->any = primaries || white || target;
    c->adapt = target != NULL;
    bool good = !primaries || read_primaries(r, primaries, c);
    good = (!white || read_white(r, white, c->white)) && good;
    if (target && target->kind == NODE_TEXT && strcmp(target->text, "native") == 0)
        memcpy(c->target, c->white, sizeof(c->target));
    else
        good = (!target || read_white(r, target, c->target)) && good;
    return good;
}

static void set_matrix(struct wall_reader *r, const struct wall_node *colour, const struct measured *c)
{
    struct matrix led, inverse, picture, adapted = { { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } } };
    double white[3];
    static const double one[3] = { 1, 1, 1 };
    if (!rgb_to_xyz(c->primary, c->white, &led) || !invert(&led, &inverse)) {
        wall_mistake(r, colour, "white %.4g, %.4g is not inside the triangle of the primaries; expected what a meter says of the LEDs: "
                     "each colour, and all three at once", c->white[0], c->white[1]);
        return;
    }
    rgb_to_xyz(rec709, d65, &picture);
    if (c->adapt)
        bradford(d65, c->target, &adapted);
    const struct matrix xyz = multiply(&adapted, &picture);
    struct matrix all = multiply(&inverse, &xyz);
    apply(&all, one, white);
    const double most = fmax(white[0], fmax(white[1], white[2]));
    if (!(fmin(white[0], fmin(white[1], white[2])) >= -1e-9) || !(most > 1e-6)) {
        wall_mistake(r, colour, "these LEDs cannot show the target white: it needs R %.3g, G %.3g, B %.3g; expected one inside the "
                     "triangle of the primaries", white[0], white[1], white[2]);
        return;
    }
    for (int i = 0; i < 9; i++)
        r->d->matrix[i / 3][i % 3] = all.m[i / 3][i % 3] / most;
}

static void read_matrix(struct wall_reader *r, const struct wall_node *n)
{
    struct matrix explicit, before;
    bool good = true;
    unsigned i = 0;
    if (!n)
        return;
    if (n->kind != NODE_LIST || n->count != 3) {
        wall_mistake(r, n, "%s; expected three rows of three numbers, the LEDs' R, G, B from the picture's", wall_found(n).s);
        return;
    }
    for (const struct wall_node *row = n->first; row; row = row->next)
        good = wall_numbers(r, row, 3, -8, 8, "a row of the matrix", explicit.m[i++]) && good;
    if (!good)
        return;
    memcpy(before.m, r->d->matrix, sizeof(before.m));
    const struct matrix both = multiply(&explicit, &before);
    memcpy(r->d->matrix, both.m, sizeof(both.m));
}

static void read_transfer(struct wall_reader *r, const struct wall_node *n)
{
    double gamma;
    if (!n)
        return;
    if (n->kind == NODE_TEXT && strcmp(n->text, "srgb") == 0) {
        r->d->transfer = WALL_TRANSFER_SRGB;
    } else if (n->kind == NODE_TEXT && wall_number_scan(n->text, strlen(n->text), &gamma) && gamma >= 1 && gamma <= 4) {
        r->d->transfer = WALL_TRANSFER_GAMMA;
        r->d->gamma = gamma;
    } else {
        wall_mistake(r, n, "%s; expected srgb, or a gamma of 1 to 4 (1: linear)", wall_found(n).s);
    }
}

void wall_read_colour(struct wall_reader *r, const struct wall_node *n)
{
    enum { TRANSFER, WHITE, TARGET, PRIMARIES, MATRIX, BRIGHTNESS, DITHER, CALIBRATION, KEYS };
    static const char *const keys[KEYS] = { "transfer", "white", "target white", "primaries", "matrix", "brightness", "dither",
                                            "calibration" };
    const struct wall_node *v[KEYS];
    struct measured c;
    unsigned word;
    if (!n || !wall_keys(r, n, keys, KEYS, v))
        return;
    read_transfer(r, v[TRANSFER]);
    if (read_measured(r, v[PRIMARIES], v[WHITE], v[TARGET], &c) && c.any)
        set_matrix(r, n, &c);
    read_matrix(r, v[MATRIX]);
    wall_share(r, v[BRIGHTNESS], &r->d->brightness);
    if (wall_word(r, v[DITHER], "temporal off", &word))
        r->d->dither = (enum wall_dither)word;
    wall_text(r, v[CALIBRATION], "the name of an EXR file", r->d->calibration, sizeof(r->d->calibration));
}
