/* SPDX-License-Identifier: Apache-2.0 */
/*
 * params.h - what was asked, validated. The table is proto/params.def; nothing else knows a range
 * or a default. Pure.
 */
#ifndef AIRYD_PARAMS_H
#define AIRYD_PARAMS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "fault.h"

enum look { LOOK_NONE, LOOK_HALF_GAUSSIAN, LOOK_MIP_CHAIN, LOOK_THREE_SCALE, LOOK_JIMENEZ, LOOK_AIRY_EIGHT };
enum bright_curve { BRIGHT_NONE, BRIGHT_CHANNEL, BRIGHT_LUMINANCE, BRIGHT_KNEE, BRIGHT_SMOOTHSTEP };
enum nonfinite_policy { NONFINITE_KEEP, NONFINITE_ZERO, NONFINITE_REJECT };
enum { SWITCH_OFF, SWITCH_ON };
enum threshold_unit { UNIT_LINEAR, UNIT_STOPS };
enum composite { COMPOSITE_ADD, COMPOSITE_MIX, COMPOSITE_SCREEN_ADD };
enum edge { EDGE_ZERO, EDGE_FILL };
enum storage { STORAGE_AUTO, STORAGE_FLOAT, STORAGE_HALF };
enum display { DISPLAY_NONE, DISPLAY_REINHARD, DISPLAY_ACES };
enum encoding { ENCODING_LINEAR, ENCODING_GAMMA22, ENCODING_SRGB };
enum { STAGES_3, STAGES_6 };

enum { PARAMS_GAUSSIANS_MAX = 32, PARAMS_TEXT_MAX = 512, PARAMS_LAYERS_MAX = 7, PARAMS_TINTS_MAX = 6 };
enum { PARAMS_LINE_MAX = 5120 }; /* params_print is shorter, whatever was set */

/* A length: pixel heights, per cent of the data window's diagonal, or mm on the sensor. */
enum size_unit { SIZE_PIXELS, SIZE_PERCENT, SIZE_MM };
struct size {
    double value;
    enum size_unit unit;
};

struct psf_gaussian {
    struct size sigma; /* > 0 */
    double weight;     /* >= 0 */
    double tint[3];    /* >= 0, factors of the weight for R, G, B; one plane uses their mean */
};

/* A sum of Gaussians (octaves and halation are read into one), or a kernel that is drawn out and
 * convolved by FFT, with sum `weight` per channel. */
enum psf_kind { PSF_GAUSSIANS, PSF_EYE, PSF_AIRY, PSF_APERTURE, PSF_IMAGE };

struct psf_spec {
    enum psf_kind kind;
    unsigned count; /* PSF_GAUSSIANS */
    struct psf_gaussian gaussian[PARAMS_GAUSSIANS_MAX];
    double weight;             /* the others: total gain, default 0.1 */
    double f_number;           /* airy, aperture: 0.5 .. 1000, default 8 */
    double pitch_um;           /* airy, aperture: pixel pitch, 0.1 .. 1000, default 5 */
    double wavelength_nm[3];   /* airy, aperture: 100 .. 20000 for R, G, B, default 610 550 465 */
    unsigned blades;           /* aperture: 3 .. 32, default 6 */
    double rotation_deg;       /* aperture: -360 .. 360 */
    double degrees;            /* eye: angle that the picture's height spans, 1 .. 170, default 40 */
    char digest[33];           /* image: of the uploaded kernel; 32 hexadecimal digits, lower case */
}; /* what a kind does not have is 0 */

/* What a picture shows (METHODS section 1, step 9). */
enum view { VIEW_FINAL, VIEW_SOURCE, VIEW_BRIGHT, VIEW_BLOOM, VIEW_LEVEL, VIEW_RESIDUAL };
struct view_spec {
    enum view view;
    unsigned level; /* VIEW_LEVEL: index of a Gaussian in the psf, 0 .. count-1 */
};

struct sun_spec { /* look mip-chain */
    bool given;
    double x_percent, y_percent; /* of width and height from the data window's top left; -100 .. 200 */
    struct size radius;
    double gain, tint[3];
};

struct params {
#define NUMBER(name, field, def, min, max, unit, help) double field;
#define NUMBER_OR(name, field, flag, def, min, max, unit, word, help) double field; bool flag;
#define CHOICE(name, field, def, words, help) int field;
#define TEXT(name, field, def, help) char field[PARAMS_TEXT_MAX];
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
    uint64_t given;                /* bit i: row i of the table was set, not defaulted (by itself or by a look) */
    /* The texts, read. */
    struct psf_spec psf_spec;
    struct size grow_size;
    struct view_spec view_spec;
    unsigned layer_count;
    struct view_spec layer[PARAMS_LAYERS_MAX];
    unsigned tint_count;
    double tints[PARAMS_TINTS_MAX][3];
    struct sun_spec sun_spec;
};

/* The defaults. */
void params_init(struct params *p);
/* Sets one parameter from text ("0.5", "knee", ...) or from a number. 0, or -1 and *f with
 * field "params.<name>", the value and the range. *p is untouched on failure. */
int params_set_text(struct params *p, const char *name, const char *text, struct fault *f);
int params_set_number(struct params *p, const char *name, double value, struct fault *f);
/* Was it set, not defaulted? name is one of the table's. */
bool params_has(const struct params *p, const char *name);
/* Puts in the numbers of p->look (METHODS section 2) for threshold, knee, intensity and emission where they were not
 * given, and the look's own bright curve and composite. Call it when all is set, before params_check; again is
 * no harm. Without a look nothing is changed.
 *                  bright      threshold  knee  intensity  emission (with a matte)  composite
 *   half-gaussian  channel     0.8        -     1.5        2                        add
 *   mip-chain      knee        1          0.5   1          1                        add
 *   three-scale    luminance   1          -     1          1                        add
 *   jimenez        smoothstep  0.8        0.5   1          1                        add
 *   airy-eight     channel     1          -     1          1                        screen-add
 * Exposure and display stay as asked: an EXR comes out scene-linear by default, with a look too. */
void params_look_defaults(struct params *p);
/* Is anything of the display transform (METHODS section 1, step 8) asked for? */
static inline bool params_display(const struct params *p)
{
    return p->display != DISPLAY_NONE || p->encoding != ENCODING_LINEAR || p->saturation != 1;
}
/* Contradictions between parameters: what was given and cannot act with the look, the psf or the others; numbers that
 * exclude each other. 0, or -1 and *f (PARAM_CONFLICT naming one of them; PARAM_RANGE for kawase). */
int params_check(const struct params *p, struct fault *f);
/* One line that says every parameter that has a meaning, "name=value" in the table's order, numbers with
 * %.17g trimmed to the shortest that reads back, a text with a blank or a quote as "..." with \ before " and \:
 * equal lines mean equal requests, and the line, set again, makes the same. Returns its length as snprintf does. */
int params_print(const struct params *p, char *out, size_t size);
/* A size in pixel heights of a frame. display_width: pixels of the display window. */
double params_pixels(const struct params *p, const struct size *s, uint32_t width, uint32_t height,
                     uint32_t display_width, double pixel_aspect);
/* "bright", "level.0": a view as the last part of a layer's name. */
void params_view_name(const struct view_spec *v, char out[32]);

#endif
