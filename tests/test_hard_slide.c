// SPDX-License-Identifier: Apache-2.0
// test_hard_slide.c - cases 4 and 16 of METHODS section 4: what shimmers when a small light moves. Frames here are one pixel
// high or wide: every filter is separable, so a line shows all that a square would.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hard_kit.h"

static const double sigmas[] = { 2.7, 8, 20, 64 };
enum { SIGMAS = sizeof(sigmas) / sizeof(sigmas[0]), EIGHTHS = 16 };

struct range {
    double low, high;
};

static void widen(struct range *r, double v)
{
    r->low = fmin(r->low, v);
    r->high = fmax(r->high, v);
}

/* What one light looks like: the engine's glow, and the true one's peak. */
struct looks {
    struct range peak, true_peak, energy, drift;
    double peak_error; /* |peak - true peak| / true peak, the worst */
};

#define EMPTY { INFINITY, -INFINITY }
static const struct looks nothing = { EMPTY, EMPTY, EMPTY, EMPTY, 0 };

/* A line of pixels along x or y. */
struct line {
    struct scene s;
    struct params p;
    unsigned n;
};

static void line_init(struct line *l, double sigma, double tolerance, bool down)
{
    char psf[64];
    snprintf(psf, sizeof(psf), "gaussians:sigma=%g,weight=1", sigma);
    l->p = scene_params(psf, BRIGHT_NONE, tolerance);
    l->p.intensity = 1e6; // so that the light itself does not round its glow off
    l->n = (unsigned)(20 * sigma) + 48; // the glow ends inside, so that its middle is its own
    scene_init(&l->s, down ? 1 : l->n, down ? l->n : 1, 1, PIXEL_TYPE_FLOAT);
}

/* A light of `size` pixels that begins at `from`: each pixel holds the share of it that is lit. */
static void light(struct line *l, double from, double size)
{
    for (unsigned i = 0; i < l->n; i++)
        l->s.plane[0][i] = fmax(0, fmin(i + 1, from + size) - fmax(i, from));
}

static void look(struct line *l, double middle, struct looks *r)
{
    double peak = 0, true_peak = 0, energy = 0, moment = 0;
    hard_run(&l->s, &l->p);
    const struct reference_frame f = scene_reference(&l->s, NULL);
    struct reference_result truth;
    assert_int_equal(reference_bloom(&truth, &f, &l->p), 0);
    for (unsigned i = 0; i < l->n; i++) {
        const double g = hard_glow(&l->s, &l->p, 0, i);
        peak = fmax(peak, g);
        true_peak = fmax(true_peak, truth.glow[0][i]);
        energy += g;
        moment += g * (i + .5);
    }
    widen(&r->peak, peak);
    widen(&r->true_peak, true_peak);
    widen(&r->energy, energy);
    widen(&r->drift, moment / energy - middle);
    r->peak_error = fmax(r->peak_error, fabs(peak / true_peak - 1));
    reference_free(&truth);
}

static double width_of(const struct range *r) { return (r->high - r->low) / ((r->high + r->low) / 2); }

static void report(unsigned number, const char *name, double sigma, const struct hard_rule *rule, const struct looks *l)
{
    char what[96];
    // Each peak is within the rule's error of the true one; float32 has its millionth.
    snprintf(what, sizeof(what), "%s: range of the peak (sigma %g)", name, sigma);
    figure(number, what, rule->name, width_of(&l->peak), width_of(&l->true_peak) + 2 * rule->tolerance + 1e-6, "relative");
    snprintf(what, sizeof(what), "%s: range of the true peak (sigma %g)", name, sigma);
    figure(number, what, rule->name, width_of(&l->true_peak), INFINITY, "relative");
    snprintf(what, sizeof(what), "%s: error of the peak (sigma %g)", name, sigma);
    figure(number, what, rule->name, l->peak_error, rule->tolerance + 1e-6, "relative");
    snprintf(what, sizeof(what), "%s: range of the energy (sigma %g)", name, sigma);
    figure(number, what, rule->name, width_of(&l->energy), 2 * rule->tolerance + 1e-6, "relative");
    snprintf(what, sizeof(what), "%s: drift of the centroid (sigma %g)", name, sigma);
    figure(number, what, rule->name, l->drift.high - l->drift.low, 1e-3, "px");
}

// Every phase of the coarsest level, once: 2^levels pixels.
static void phases(const char *name, double sigma, const struct hard_rule *rule, bool down)
{
    struct line l;
    struct looks r = nothing;
    line_init(&l, sigma, rule->tolerance, down);
    for (unsigned phase = 0; phase == 0 || phase < 1u << l.s.reply.levels; phase++) {
        const double from = floor(10 * sigma) + phase;
        light(&l, from, 1);
        look(&l, from + .5, &r);
    }
    report(4, name, sigma, rule, &r);
    scene_finish(&l.s);
}

static void case_4_phases(void)
{
    for (unsigned r = 0; r < RULES; r++) {
        for (unsigned i = 0; i < SIGMAS; i++)
            phases("one pixel at every phase", sigmas[i], &hard_rules[r], false);
        phases("the same downwards", 20, &hard_rules[r], true);
    }
}

static void case_16_slide(void)
{
    static const unsigned sizes[] = { 1, 2, 4 };
    for (unsigned r = 0; r < RULES; r++)
        for (unsigned i = 0; i < SIGMAS; i++)
            for (unsigned k = 0; k < 3; k++) {
                char name[32];
                struct line l;
                struct looks seen = nothing;
                line_init(&l, sigmas[i], hard_rules[r].tolerance, false);
                for (unsigned step = 0; step < EIGHTHS; step++) {
                    const double from = floor(10 * sigmas[i]) + step / 8.;
                    light(&l, from, sizes[k]);
                    look(&l, from + sizes[k] / 2., &seen);
                }
                snprintf(name, sizeof(name), "%u px by 1/8", sizes[k]);
                report(16, name, sigmas[i], &hard_rules[r], &seen);
                scene_finish(&l.s);
            }
}

int main(void)
{
    const struct hard_case cases[] = {
        { true, "case_4_phases", case_4_phases },
        { true, "case_16_slide", case_16_slide },
    };
    return hard_main("hard_slide", cases, sizeof(cases) / sizeof(cases[0]));
}
