// SPDX-License-Identifier: Apache-2.0
// params_check.c - what goes together: which parameters a look or a psf understands, which depend on another, and
// what contradicts. METHODS section 2 says what each look is made of.
//
// Invariant: who sets a parameter that cannot act is told so, unless another switch merely turned it off (bright=none
// and its threshold). What params_print says is without contradiction again when it is read, because one
// question, foreign(), decides both.
#include <math.h>
#include <string.h>

#include "params_internal.h"

/* Threshold and knee after exposure stay far inside float32, in which the engine works. */
static const double exposed_max = 1e37;
static const double exposure_max = 32;

/* ---- the looks' numbers (METHODS section 2) ------------------------------------------------------------ */

struct look_numbers {
    enum bright_curve bright;
    double threshold, knee, intensity, emission;
    enum composite composite;
};
static const struct look_numbers look_numbers[] = {
    [LOOK_HALF_GAUSSIAN] = { BRIGHT_CHANNEL, .8, 0, 1.5, 2, COMPOSITE_ADD },
    [LOOK_MIP_CHAIN] = { BRIGHT_KNEE, 1, .5, 1, 1, COMPOSITE_ADD },
    [LOOK_THREE_SCALE] = { BRIGHT_LUMINANCE, 1, 0, 1, 1, COMPOSITE_ADD },
    [LOOK_JIMENEZ] = { BRIGHT_SMOOTHSTEP, .8, .5, 1, 1, COMPOSITE_ADD },
    [LOOK_AIRY_EIGHT] = { BRIGHT_CHANNEL, 1, 0, 1, 1, COMPOSITE_SCREEN_ADD },
};

void params_look_defaults(struct params *p)
{
    const struct look_numbers *n = &look_numbers[p->look];
    if (p->look == LOOK_NONE)
        return;
    p->bright = n->bright;
    p->composite = n->composite;
    if (!params_given(p, ROW_threshold))
        p->threshold = n->threshold;
    if (!params_given(p, ROW_knee))
        p->knee = n->knee;
    if (!params_given(p, ROW_intensity))
        p->intensity = n->intensity;
    if (!params_given(p, ROW_emission))
        p->emission = p->matte[0] ? n->emission : 1;
}

/* ---- who understands what ------------------------------------------------------------------------------ */

enum { STATED = 1u << LOOK_NONE, ALL = ~0u };

/* Bit L: look L has the parameter; STATED: the engine of stated psfs has. */
static unsigned looks_with(unsigned row)
{
    switch (row) {
    case ROW_bright:
    case ROW_clamp:
    case ROW_firefly:
    case ROW_psf:
    case ROW_near:
    case ROW_far:
    case ROW_dirt:
    case ROW_dirt_gain:
    case ROW_composite:
    case ROW_edge:
    case ROW_grow:
    case ROW_tolerance:
    case ROW_budget_ms:
    case ROW_storage:
        return STATED;
    case ROW_knee:
        return STATED | 1u << LOOK_MIP_CHAIN | 1u << LOOK_JIMENEZ;
    case ROW_radius:
    case ROW_legacy_gain:
        return 1u << LOOK_JIMENEZ;
    case ROW_kawase:
    case ROW_stages:
    case ROW_tint:
        return 1u << LOOK_THREE_SCALE;
    case ROW_sun:
        return 1u << LOOK_MIP_CHAIN;
    default:
        return ALL;
    }
}

static bool kernel_psf(const struct params *p) { return p->psf_spec.kind != PSF_GAUSSIANS; }

/* Why the parameter, being given, is a mistake; NULL: it is none. */
static const char *foreign(const struct params *p, unsigned row)
{
    switch (row) {
    case ROW_near:
    case ROW_far:
        return kernel_psf(p) ? "the psf is one kernel and has no Gaussians" : NULL;
    case ROW_dirt_gain:
        return p->dirt[0] ? NULL : "there is no dirt";
    case ROW_emission:
        return p->matte[0] ? NULL : "there is no matte";
    case ROW_key:
    case ROW_meter_dark:
    case ROW_meter_bright:
        return p->exposure_auto ? NULL : "exposure is not auto";
    default:
        return NULL;
    }
}

static bool in_mm(const struct params *p)
{
    if (p->look != LOOK_NONE)
        return p->bloom == SWITCH_ON && p->look == LOOK_MIP_CHAIN && p->sun_spec.given && p->sun_spec.radius.unit == SIZE_MM;
    for (unsigned i = 0; i < p->psf_spec.count && p->bloom == SWITCH_ON; i++)
        if (p->psf_spec.gaussian[i].sigma.unit == SIZE_MM)
            return true;
    return p->grow_size.unit == SIZE_MM;
}

static bool displayed(const struct params *p)
{
    return p->display != DISPLAY_NONE || p->saturation != 1 || p->encoding != ENCODING_LINEAR;
}

static bool has_threshold(const struct params *p) { return p->look != LOOK_NONE || p->bright != BRIGHT_NONE; }

/* The curve in use, whether the look's defaults are in or not. */
static enum bright_curve curve(const struct params *p)
{
    return p->look == LOOK_NONE ? (enum bright_curve)p->bright : look_numbers[p->look].bright;
}

/* With bloom=off the scene is still sanitised, multiplied by its matte, displayed. */
static bool survives_off(unsigned row)
{
    switch (row) {
    case ROW_bloom:
    case ROW_matte:
    case ROW_emission:
    case ROW_grow:
    case ROW_sensor:
    case ROW_exposure:
    case ROW_key:
    case ROW_meter_dark:
    case ROW_meter_bright:
    case ROW_display:
    case ROW_saturation:
    case ROW_encoding:
    case ROW_view:
    case ROW_layers:
    case ROW_nonfinite:
        return true;
    default:
        return false;
    }
}

static bool exposure_counts(const struct params *p)
{
    return displayed(p) || (p->bloom == SWITCH_ON && has_threshold(p));
}

/* Turned off by another parameter, and no mistake. */
static bool silent(const struct params *p, unsigned row)
{
    if (p->bloom == SWITCH_OFF && !survives_off(row))
        return true;
    switch (row) {
    case ROW_grow: /* by nothing, like a look's window, which cannot grow */
        return p->bloom == SWITCH_OFF && p->grow_size.value == 0;
    case ROW_source:
        return !p->source[0];
    case ROW_matte:
        return !p->matte[0];
    case ROW_dirt:
        return !p->dirt[0];
    case ROW_layers:
        return !p->layers[0];
    case ROW_sun:
        return !p->sun_spec.given;
    case ROW_threshold:
    case ROW_threshold_unit:
        return !has_threshold(p);
    case ROW_knee:
        return curve(p) != BRIGHT_KNEE && curve(p) != BRIGHT_SMOOTHSTEP;
    case ROW_exposure:
    case ROW_key:
    case ROW_meter_dark:
    case ROW_meter_bright:
        return !exposure_counts(p);
    case ROW_sensor:
        return !in_mm(p);
    case ROW_tolerance: /* beside a budget it is a promise only when it was asked for */
        return p->budget_ms > 0 && !params_given(p, row);
    default:
        return false;
    }
}

bool params_has_meaning(const struct params *p, unsigned row)
{
    return looks_with(row) >> p->look & 1 && !foreign(p, row) && !silent(p, row);
}

/* ---- contradictions ------------------------------------------------------------------------------------ */

static int conflict(struct fault *f, unsigned row, const char *found, const char *expected)
{
    const char *name = params_row_name(row);
    return param_fault(f, FAULT_PARAM_CONFLICT, name, "%s = %s: %s", name, found, expected);
}

static int check_given(const struct params *p, struct fault *f)
{
    for (unsigned row = 0; row < N_ROWS; row++) {
        const char *name = params_row_name(row), *why = foreign(p, row);
        if (!params_given(p, row))
            continue;
        if (!(looks_with(row) >> p->look & 1))
            return param_fault(f, FAULT_PARAM_CONFLICT, name, "%s is given, and look = %s does not have it", name,
                               params_word(p, ROW_look).s);
        if (why)
            return param_fault(f, FAULT_PARAM_CONFLICT, name, "%s is given, and %s", name, why);
    }
    return 0;
}

/* T and K in use, for the darkest exposure that is possible. */
static int check_bright(const struct params *p, struct fault *f)
{
    const double exposure = p->exposure_auto ? -exposure_max : p->exposure;
    const bool stops = p->threshold_unit == UNIT_STOPS;
    const double threshold = stops ? exp2(p->threshold - exposure) : p->threshold * exp2(-exposure);
    const double knee = p->knee * exp2(-exposure);
    if (!stops && p->threshold < 0)
        return conflict(f, ROW_threshold, number_print(p->threshold).s,
                        "at least 0 expected; below it with threshold_unit = stops only");
    if (stops && has_threshold(p) && params_given(p, ROW_threshold_unit) && !params_given(p, ROW_threshold))
        return conflict(f, ROW_threshold_unit, "stops", "a threshold in stops is to be given, too");
    if (curve(p) == BRIGHT_SMOOTHSTEP && p->knee > 1)
        return conflict(f, ROW_knee, number_print(p->knee).s,
                        "with a smoothstep it is a share of the threshold, at most 1");
    if (has_threshold(p) && threshold > exposed_max)
        return param_fault(f, FAULT_PARAM_CONFLICT, p->exposure_auto || stops ? "threshold" : "exposure",
                           "threshold / 2^exposure = %s: at most 1e+37 expected%s", number_print(threshold).s,
                           p->exposure_auto ? " (exposure = auto may come to -32)" : "");
    if (curve(p) == BRIGHT_KNEE && knee > exposed_max)
        return param_fault(f, FAULT_PARAM_CONFLICT, p->exposure_auto ? "knee" : "exposure",
                           "knee / 2^exposure = %s: at most 1e+37 expected%s", number_print(knee).s,
                           p->exposure_auto ? " (exposure = auto may come to -32)" : "");
    return 0;
}

static int check_view(const struct params *p, const struct view_spec *v, unsigned row, struct fault *f)
{
    char name[32];
    params_view_name(v, name);
    if (p->look != LOOK_NONE && (v->view == VIEW_LEVEL || v->view == VIEW_RESIDUAL))
        return conflict(f, row, name, "a look has the views final, source, bright and bloom");
    if (v->view != VIEW_LEVEL || p->bloom == SWITCH_OFF)
        return 0;
    if (kernel_psf(p))
        return conflict(f, row, name, "the psf is one kernel and has no levels");
    if (v->level >= p->psf_spec.count)
        return param_fault(f, FAULT_PARAM_CONFLICT, params_row_name(row),
                           "%s = %s: the psf has %u Gaussians, level:0 to level:%u", params_row_name(row), name,
                           p->psf_spec.count, p->psf_spec.count - 1);
    return 0;
}

static int check_views(const struct params *p, struct fault *f)
{
    if (check_view(p, &p->view_spec, ROW_view, f) < 0)
        return -1;
    for (unsigned i = 0; i < p->layer_count; i++)
        if (check_view(p, &p->layer[i], ROW_layers, f) < 0)
            return -1;
    return 0;
}

static int check_three_scale(const struct params *p, struct fault *f)
{
    const unsigned scales = p->stages == STAGES_6 ? 6 : 3;
    if (p->kawase != floor(p->kawase))
        return param_fault(f, FAULT_PARAM_RANGE, "kawase", "kawase = %s: a whole number of passes expected",
                           number_print(p->kawase).s);
    if (p->tint_count > scales)
        return param_fault(f, FAULT_PARAM_CONFLICT, "tint", "tint: %u of them, and stages = %u: at most as many",
                           p->tint_count, scales);
    return 0;
}

int params_check(const struct params *p, struct fault *f)
{
    if (check_given(p, f) < 0 || check_bright(p, f) < 0 || check_views(p, f) < 0 || check_three_scale(p, f) < 0)
        return -1;
    if (p->exposure_auto && p->meter_dark + p->meter_bright >= 100)
        return conflict(f, ROW_meter_bright, number_print(p->meter_bright).s,
                        "with meter_dark less than 100 % of the pixels expected");
    if (p->look != LOOK_NONE)
        return 0;
    if (p->composite == COMPOSITE_MIX && p->intensity > 1)
        return conflict(f, ROW_intensity, number_print(p->intensity).s,
                        "with composite = mix it is a share, at most 1");
    if (p->edge == EDGE_FILL && kernel_psf(p))
        return conflict(f, ROW_edge, "fill", "outside the data window a kernel finds no light: zero expected");
    return 0;
}
