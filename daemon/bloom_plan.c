// SPDX-License-Identifier: Apache-2.0
// bloom_plan.c - a request's plan: from the cache, within a tolerance or a time; and told without running.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "bloom_internal.h"
#include "look.h"

static bool same_facts(const struct plan_facts *a, const struct plan_facts *b)
{
    return a->width == b->width && a->height == b->height && a->display_width == b->display_width &&
           a->channels == b->channels && a->pixel_aspect == b->pixel_aspect && a->only == b->only;
}

// Member by member: a struct's padding is nobody's.
static bool same_spec(const struct psf_spec *a, const struct psf_spec *b)
{
    bool same = a->kind == b->kind && a->count == b->count;
    for (unsigned i = 0; same && i < a->count; i++) {
        const struct psf_gaussian *g = &a->gaussian[i], *h = &b->gaussian[i];
        same = g->sigma.value == h->sigma.value && g->sigma.unit == h->sigma.unit && g->weight == h->weight &&
               g->tint[0] == h->tint[0] && g->tint[1] == h->tint[1] && g->tint[2] == h->tint[2];
    }
    return same;
}

static bool answers(const struct planned *e, const struct params *p, const struct plan_facts *facts)
{
    return e->asked && same_spec(&e->spec, &p->psf_spec) && e->near_gain == p->near_gain && e->far_gain == p->far_gain &&
           e->sensor_mm == p->sensor_mm && e->tolerance == p->tolerance && e->budget_ms == p->budget_ms &&
           same_facts(&e->facts, facts);
}

// The best error whose predicted time is within the budget, and within the tolerance when that was asked for too.
static int plan_for_budget(struct bloom *b, struct plan *out, const struct params *p, const struct plan_facts *facts,
                           const struct bloom_geometry *g, struct fault *f)
{
    static const double tolerances[] = { 1e-5, 1e-4, 1e-3, 1e-2, 1e-1 };
    const double most = params_has(p, "tolerance") ? p->tolerance : 1e-1;
    double cheapest = INFINITY;
    for (unsigned i = 0; i < sizeof(tolerances) / sizeof(tolerances[0]); i++) {
        const double t = fmin(tolerances[i], most);
        if (plan_make(out, p, t, facts, f) < 0)
            return -1;
        const double ms = cost_predict(b, out, g);
        if (ms <= p->budget_ms)
            return 0;
        cheapest = fmin(cheapest, ms);
        if (t == most)
            break;
    }
    return fault_set(f, FAULT_PARAM_CONFLICT, "params.budget_ms",
                     "budget_ms = %g: the cheapest plan for %u x %u at tolerance %g takes about %.3g ms on this device",
                     p->budget_ms, g->width, g->height, most, cheapest);
}

int plan_find(struct bloom *b, const struct bloom_request *r, const struct bloom_geometry *g, struct fault *f)
{
    const struct params *p = r->params;
    // Of a part of a frame the frame is what counts.
    struct bloom_geometry of = *g;
    if (r->wall) {
        of.width = r->wall->frame_width;
        of.height = r->wall->frame_height;
        g = &of;
    }
    const struct plan_facts facts = {
        .width = g->width,
        .height = g->height,
        .display_width = r->display_width ? r->display_width : g->width,
        .channels = g->channels,
        .pixel_aspect = (double)r->pixel_aspect,
        .only = p->view_spec.view == VIEW_LEVEL && !p->layer_count ? (int)p->view_spec.level : -1,
    };
    struct planned *oldest = &b->planned[0];
    b->plans_asked++;
    b->plan = NULL;
    for (unsigned i = 0; i < PLANS_MAX; i++) {
        struct planned *e = &b->planned[i];
        if (answers(e, p, &facts)) {
            e->asked = b->plans_asked;
            b->plan = &e->plan;
            return 0;
        }
        if (e->asked < oldest->asked)
            oldest = e;
    }
    if (b->prepared == &oldest->plan)
        b->prepared = NULL;
    oldest->asked = 0;
    const int made = p->psf_spec.kind != PSF_GAUSSIANS ? (memset(&oldest->plan, 0, sizeof(oldest->plan)), 0)
                     : p->budget_ms > 0                ? plan_for_budget(b, &oldest->plan, p, &facts, g, f)
                                                       : plan_make(&oldest->plan, p, p->tolerance, &facts, f);
    if (made < 0)
        return -1;
    oldest->asked = b->plans_asked;
    oldest->spec = p->psf_spec;
    oldest->near_gain = p->near_gain;
    oldest->far_gain = p->far_gain;
    oldest->sensor_mm = p->sensor_mm;
    oldest->tolerance = p->tolerance;
    oldest->budget_ms = p->budget_ms;
    oldest->facts = facts;
    b->plan = &oldest->plan;
    return 0;
}

void plan_describe(struct bloom *b, const struct params *p, struct bloom_reply *r)
{
    if (p->psf_spec.kind != PSF_GAUSSIANS) {
        snprintf(r->plan, sizeof(r->plan), "by FFT in float64 on the host: %.400s", p->psf);
        snprintf(r->rule, sizeof(r->rule), "fft");
    } else {
        plan_print(b->plan, r->plan, sizeof(r->plan));
        snprintf(r->rule, sizeof(r->rule), "%s", b->plan->rule);
    }
    snprintf(r->storage, sizeof(r->storage), "float");
    r->levels = b->plan->levels;
}

int bloom_plan(struct bloom *b, const struct bloom_geometry *geometry, const struct bloom_request *request,
               struct bloom_reply *reply, struct fault *f)
{
    const struct params *p = request->params;
    // What exposure=auto meters is not known without pixels.
    struct bloom_reply r = { .exposure = p->exposure };
    if (p->look != LOOK_NONE) {
        look_print(p, geometry->width, geometry->height, r.plan, sizeof(r.plan));
        *reply = r;
        return 0;
    }
    if (plan_find(b, request, geometry, f) < 0)
        return -1;
    plan_describe(b, p, &r);
    if (p->psf_spec.kind != PSF_GAUSSIANS) {
        // float32's rounding of the result, which is nearly all of it; the transforms' own share needs the kernel.
        r.error_bound = p->psf_spec.weight * 0x1p-23;
    } else {
        r.error_bound = b->plan->filter_bound + b->plan->weight_sum * b->plan->rounding_bound;
        r.predicted_ms = cost_predict(b, b->plan, geometry);
    }
    *reply = r;
    return 0;
}
