// SPDX-License-Identifier: Apache-2.0
// params_psf.c - the point spread function's text: which kinds there are, the keys of each, and what they make.
//
// Invariant: psf_spec holds what the canonical text says, whichever kind it was said in: octaves and halation are
// sums of Gaussians when they are read, and stay the words that were asked when they are printed.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "params_internal.h"

#define WEIGHT(max, value, alike) { "weight", SHAPE_NUMBER, max, { "a weight", 0, 1e6 }, value, false, alike }
#define TINT { "tint", SHAPE_TINT, PARAMS_GAUSSIANS_MAX, { "a tint", 0, 1000 }, "", false, true }

enum { G_SIGMA, G_WEIGHT, G_TINT };
static const struct key_rule gaussians_rules[] = {
    { "sigma", SHAPE_SIZE, PARAMS_GAUSSIANS_MAX, { .what = "a size" }, NULL, false, false },
    WEIGHT(PARAMS_GAUSSIANS_MAX, NULL, true),
    TINT,
};

enum { O_SIGMA, O_COUNT, O_RATIO, O_WEIGHT, O_SLOPE, O_BEND, O_WEIGHTS, O_TINT };
static const struct key_rule octaves_rules[] = {
    { "sigma", SHAPE_SIZE, 1, { .what = "a size" }, NULL, false, false },
    { "count", SHAPE_WHOLE, 1, { "a count", 1, PARAMS_GAUSSIANS_MAX }, NULL, false, false },
    { "ratio", SHAPE_NUMBER, 1, { "a ratio", 1.01, 16 }, "2", false, false },
    WEIGHT(1, "", false),
    { "slope", SHAPE_NUMBER, 1, { "a slope", -16, 16 }, "", false, false },
    { "bend", SHAPE_NUMBER, 1, { "a bend", -4, 4 }, "", false, false },
    { "weights", SHAPE_NUMBER, PARAMS_GAUSSIANS_MAX, { "a weight", 0, 1e6 }, "", false, true },
    TINT,
};

enum { H_SIGMA, H_GAIN };
static const struct key_rule halation_rules[] = {
    { "sigma", SHAPE_SIZE, 3, { .what = "a size" }, NULL, true, true },
    { "gain", SHAPE_NUMBER, 3, { "a gain", 0, 1e6 }, NULL, true, true },
};

enum { E_DEGREES, E_WEIGHT };
static const struct key_rule eye_rules[] = {
    { "degrees", SHAPE_NUMBER, 1, { "an angle", 1, 170 }, "40", false, false },
    WEIGHT(1, "0.1", false),
};

#define OPTICS                                                                                          \
    { "f", SHAPE_NUMBER, 1, { "an f-number", 0.5, 1000 }, "8", false, false },                          \
    { "pitch", SHAPE_NUMBER, 1, { "a pixel pitch in um", 0.1, 1000 }, "5", false, false },              \
    { "wavelength", SHAPE_NUMBER, 3, { "a wavelength in nm", 100, 20000 }, "610/550/465", true, true }, \
    WEIGHT(1, "0.1", false)
enum { A_F, A_PITCH, A_WAVELENGTH, A_WEIGHT, A_BLADES, A_ROTATION };
static const struct key_rule aperture_rules[] = {
    OPTICS,
    { "blades", SHAPE_WHOLE, 1, { "a number of blades", 3, 32 }, "6", false, false },
    { "rotation", SHAPE_NUMBER, 1, { "an angle in degrees", -360, 360 }, "0", false, false },
};

static const struct key_rule image_rules[] = { WEIGHT(1, "0.1", false) };

/* ---- from keys to a spec ----------------------------------------------------------------------------- */

/* As many elements as there are Gaussians, or one for all. */
static int spread(struct key_value *v, unsigned count, const char *what, const struct piece *all,
                  struct fault *f)
{
    if (v->count != count && v->count != 1)
        return piece_fault(f, FAULT_PARAM_SYNTAX, all, "%u Gaussians and %u %s: as many, or one, expected", count,
                           v->count, what);
    for (; v->count < count; v->count++)
        memcpy(v->v[v->count], v->v[0], sizeof(v->v[0]));
    return 0;
}

static int tint_all(struct psf_spec *spec, struct key_value *tint, const struct piece *all, struct fault *f)
{
    if (!tint->count) {
        tint->count = 1;
        tint->v[0][0] = tint->v[0][1] = tint->v[0][2] = 1;
    }
    if (spread(tint, spec->count, "tints", all, f) < 0)
        return -1;
    for (unsigned i = 0; i < spec->count; i++)
        memcpy(spec->gaussian[i].tint, tint->v[i], sizeof(spec->gaussian[i].tint));
    return 0;
}

static int gaussians_make(struct psf_spec *spec, struct key_value *v, const struct piece *all, struct fault *f)
{
    spec->count = v[G_SIGMA].count;
    if (spread(&v[G_WEIGHT], spec->count, "weights", all, f) < 0)
        return -1;
    for (unsigned i = 0; i < spec->count; i++) {
        spec->gaussian[i].sigma = (struct size){ v[G_SIGMA].v[i][0], v[G_SIGMA].unit[i] };
        spec->gaussian[i].weight = v[G_WEIGHT].v[i][0];
    }
    return tint_all(spec, &v[G_TINT], all, f);
}

/* The two-parameter curve weight * w_i / sum w, w_i = 2^(-slope i - bend i^2); the largest w is taken as 1, so that
 * none overflows. */
static void curve_weights(struct psf_spec *spec, double weight, double slope, double bend)
{
    double largest = -INFINITY, sum = 0;
    for (unsigned i = 0; i < spec->count; i++) {
        spec->gaussian[i].weight = -slope * i - bend * i * i;
        largest = fmax(largest, spec->gaussian[i].weight);
    }
    for (unsigned i = 0; i < spec->count; i++)
        sum += spec->gaussian[i].weight = exp2(spec->gaussian[i].weight - largest);
    for (unsigned i = 0; i < spec->count; i++)
        spec->gaussian[i].weight *= weight / sum;
}

static void default_number(struct key_value *v, double value)
{
    if (!v->count)
        v->v[v->count++][0] = value;
}

static int octaves_weights(struct psf_spec *spec, struct key_value *v, const struct piece *all, struct fault *f)
{
    if (v[O_WEIGHTS].count) {
        if (v[O_WEIGHT].count || v[O_SLOPE].count || v[O_BEND].count)
            return piece_fault(f, FAULT_PARAM_SYNTAX, all, "weights=... without weight, slope and bend expected");
        if (spread(&v[O_WEIGHTS], spec->count, "weights", all, f) < 0)
            return -1;
        for (unsigned i = 0; i < spec->count; i++)
            spec->gaussian[i].weight = v[O_WEIGHTS].v[i][0];
        return 0;
    }
    default_number(&v[O_WEIGHT], 1);
    default_number(&v[O_SLOPE], 1);
    default_number(&v[O_BEND], 0);
    curve_weights(spec, v[O_WEIGHT].v[0][0], v[O_SLOPE].v[0][0], v[O_BEND].v[0][0]);
    return 0;
}

static int octaves_make(struct psf_spec *spec, struct key_value *v, const struct piece *all, struct fault *f)
{
    const enum size_unit unit = v[O_SIGMA].unit[0];
    spec->count = (unsigned)v[O_COUNT].v[0][0];
    for (unsigned i = 0; i < spec->count; i++) {
        double sigma = v[O_SIGMA].v[0][0] * pow(v[O_RATIO].v[0][0], i);
        if (sigma > sigma_range.max[unit])
            return piece_fault(f, FAULT_PARAM_RANGE, all, "octave %u has sigma %s: at most %s expected", i,
                               number_print(sigma).s, number_print(sigma_range.max[unit]).s);
        spec->gaussian[i].sigma = (struct size){ sigma, unit };
    }
    if (octaves_weights(spec, v, all, f) < 0)
        return -1;
    return tint_all(spec, &v[O_TINT], all, f);
}

static int halation_make(struct psf_spec *spec, struct key_value *v, const struct piece *all, struct fault *f)
{
    (void)all, (void)f;
    spec->count = 3;
    for (unsigned i = 0; i < 3; i++) {
        spec->gaussian[i].sigma = (struct size){ v[H_SIGMA].v[i][0], v[H_SIGMA].unit[i] };
        spec->gaussian[i].weight = v[H_GAIN].v[i][0];
        spec->gaussian[i].tint[i] = 1;
    }
    return 0;
}

static int eye_make(struct psf_spec *spec, struct key_value *v, const struct piece *all, struct fault *f)
{
    (void)all, (void)f;
    spec->degrees = v[E_DEGREES].v[0][0];
    spec->weight = v[E_WEIGHT].v[0][0];
    return 0;
}

static int airy_make(struct psf_spec *spec, struct key_value *v, const struct piece *all, struct fault *f)
{
    (void)all, (void)f;
    spec->f_number = v[A_F].v[0][0];
    spec->pitch_um = v[A_PITCH].v[0][0];
    for (unsigned c = 0; c < 3; c++)
        spec->wavelength_nm[c] = v[A_WAVELENGTH].v[c][0];
    spec->weight = v[A_WEIGHT].v[0][0];
    return 0;
}

static int aperture_make(struct psf_spec *spec, struct key_value *v, const struct piece *all, struct fault *f)
{
    spec->blades = (unsigned)v[A_BLADES].v[0][0];
    spec->rotation_deg = v[A_ROTATION].v[0][0];
    return airy_make(spec, v, all, f);
}

static int image_make(struct psf_spec *spec, struct key_value *v, const struct piece *all, struct fault *f)
{
    (void)all, (void)f;
    spec->weight = v[0].v[0][0];
    return 0;
}

/* ---- the kinds --------------------------------------------------------------------------------------- */

struct psf_row {
    const char *name;
    enum psf_kind kind;
    const struct key_rule *rule;
    unsigned rules;
    int (*make)(struct psf_spec *spec, struct key_value *v, const struct piece *all, struct fault *f);
    const char *usage;
};
#define RULES(r) r, sizeof(r) / sizeof((r)[0])
static const struct psf_row psf_rows[] = {
    { "gaussians", PSF_GAUSSIANS, RULES(gaussians_rules), gaussians_make,
      "gaussians:sigma=S/S/..,weight=W/W/..[,tint=R:G:B/..]" },
    { "octaves", PSF_GAUSSIANS, RULES(octaves_rules), octaves_make,
      "octaves:sigma=S,count=N[,ratio=][,weight=][,slope=][,bend=][,weights=W/W/..][,tint=R:G:B/..]" },
    { "halation", PSF_GAUSSIANS, RULES(halation_rules), halation_make, "halation:sigma=S/S/S,gain=G/G/G" },
    { "eye", PSF_EYE, RULES(eye_rules), eye_make, "eye:[degrees=][,weight=]" },
    { "airy", PSF_AIRY, aperture_rules, A_BLADES, airy_make,
      "airy:[f=][,pitch=][,wavelength=R/G/B][,weight=]" },
    { "aperture", PSF_APERTURE, RULES(aperture_rules), aperture_make,
      "aperture:[blades=][,rotation=][,f=][,pitch=][,wavelength=R/G/B][,weight=]" },
    { "image", PSF_IMAGE, RULES(image_rules), image_make, "image:DIGEST[,weight=]" },
};
enum { N_PSF_ROWS = sizeof(psf_rows) / sizeof(psf_rows[0]) };
_Static_assert(sizeof(octaves_rules) / sizeof(octaves_rules[0]) <= KEYS_MAX, "psf_set has room for them");

static const struct psf_row *psf_row(const struct piece *kind, struct fault *f)
{
    char known[128];
    struct printer to = { known, sizeof(known), 0 };
    for (unsigned i = 0; i < N_PSF_ROWS; i++) {
        if (piece_is(kind, psf_rows[i].name))
            return &psf_rows[i];
        print_text(&to, i ? " " : "");
        print_text(&to, psf_rows[i].name);
    }
    piece_fault(f, FAULT_PARAM_SYNTAX, kind, "no such point spread function; known: %s", known);
    return NULL;
}

int read_psf(struct params *p, const char *text, struct fault *f)
{
    struct piece items = piece_all("psf", text, NULL), kind, digest;
    struct key_value value[KEYS_MAX];
    struct psf_spec spec;
    char canonical[PARAMS_TEXT_MAX];
    struct printer to = { canonical, sizeof(canonical), 0 };
    memset(&spec, 0, sizeof(spec));
    piece_next(&items, ':', &kind);
    const struct psf_row *row = psf_row(&kind, f);
    if (!row)
        return -1;
    if (!items.s)
        items = (struct piece){ "psf", text, text + strlen(text), 0, NULL };
    items.usage = row->usage;
    spec.kind = row->kind;
    print_text(&to, row->name);
    print_text(&to, ":");
    if (row->kind == PSF_IMAGE) {
        piece_next(&items, ',', &digest);
        if (piece_digest(&digest, spec.digest, f) < 0)
            return -1;
        if (items.s && items.len == 0)
            return piece_fault(f, FAULT_PARAM_SYNTAX, &items, "weight=... after the comma expected");
        if (!items.s)
            items = (struct piece){ "psf", text, text + strlen(text), 0, row->usage };
        print_text(&to, spec.digest);
        print_text(&to, ",");
    }
    struct piece all = items;
    if (keys_read(value, row->rule, row->rules, items, f) < 0 || row->make(&spec, value, &all, f) < 0)
        return -1;
    keys_print(value, row->rule, row->rules, &to);
    if (text_keep(p->psf, "psf", &to, f) < 0)
        return -1;
    p->psf_spec = spec;
    return 0;
}
