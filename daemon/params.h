/* SPDX-License-Identifier: Apache-2.0 */
/*
 * params.h - what was asked, validated. The table is proto/params.def; nothing else knows a range
 * or a default. Pure.
 */
#ifndef AIRYD_PARAMS_H
#define AIRYD_PARAMS_H

#include <stdbool.h>
#include <stddef.h>

#include "fault.h"

enum bright_curve { BRIGHT_NONE, BRIGHT_CHANNEL, BRIGHT_LUMINANCE, BRIGHT_KNEE, BRIGHT_SMOOTHSTEP };
enum nonfinite_policy { NONFINITE_KEEP, NONFINITE_ZERO, NONFINITE_REJECT };

enum { PARAMS_GAUSSIANS_MAX = 32, PARAMS_TEXT_MAX = 512 };

struct psf_gaussian {
    double sigma;      /* > 0; pixels, or per cent of the diagonal */
    bool percent;
    double weight;     /* >= 0 */
};

struct psf_spec {
    unsigned count;
    struct psf_gaussian gaussian[PARAMS_GAUSSIANS_MAX];
};

struct params {
#define NUMBER(name, field, def, min, max, unit, help) double field;
#define CHOICE(name, field, def, words, help) int field;
#define TEXT(name, field, def, help) char field[PARAMS_TEXT_MAX];
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
    struct psf_spec psf_spec; /* psf, read */
};

/* The defaults. */
void params_init(struct params *p);
/* Sets one parameter from text ("0.5", "knee", ...) or from a number. 0, or -1 and *f with
 * field "params.<name>", the value and the range. *p is untouched on failure. */
int params_set_text(struct params *p, const char *name, const char *text, struct fault *f);
int params_set_number(struct params *p, const char *name, double value, struct fault *f);
/* Contradictions between parameters. */
int params_check(const struct params *p, struct fault *f);
/* One line that says every parameter that has a meaning, "name=value" in the table's order, numbers with
 * %.17g trimmed to the shortest that reads back: equal lines mean equal requests. Returns its length as
 * snprintf does. */
int params_print(const struct params *p, char *out, size_t size);

#endif
