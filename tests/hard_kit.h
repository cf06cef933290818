/* SPDX-License-Identifier: Apache-2.0 */
/*
 * hard_kit.h - what the hard cases (METHODS section 4) share: the devices, the rules, and figures, which are printed, kept
 * for the report, and held to their limit.
 */
#ifndef AIRY_HARD_KIT_H
#define AIRY_HARD_KIT_H

#include "scene_kit.h"

extern struct bloom *hard_engine; /* of the device that is being tried */

enum { RULES = 4 };
struct hard_rule {
    const char *name; /* the rule that METHODS names for the tolerance */
    double tolerance;
};
extern const struct hard_rule hard_rules[RULES];

/* One line "case N: ...", and one of the CSV at $AIRY_HARD_CSV; the test fails when value is above limit (INFINITY: it
 * is only reported). */
void figure(unsigned number, const char *what, const char *rule, double value, double limit, const char *unit);

/* Runs the scene on hard_engine, slot 0; the ratio of error to stated bound, by the reference. */
double hard_ratio(struct scene *s, const struct params *p);
void hard_run(struct scene *s, const struct params *p);
/* Sample of the glow in output 0: (out - in) / intensity. No grow. */
double hard_glow(const struct scene *s, const struct params *p, unsigned c, size_t i);

size_t hard_count(const struct scene *s); /* pixels of a plane */
void hard_fill(struct scene *s, double v);
void hard_border(struct scene *s); /* lights all along the border of plane 0 */
double *hard_copy(const double *v, size_t n); /* the caller's */
double *hard_output(struct scene *s, const struct params *p); /* runs; the output's first plane, the caller's */
double hard_relative(const double *a, const double *b, size_t n); /* |a - b| / |b|, the worst */

struct hard_case {
    bool has; /* the engine has what the case tries */
    const char *name;
    void (*run)(void);
};
/* Every case on every device; what main returns. */
int hard_main(const char *group, const struct hard_case *cases, unsigned count);

#endif
