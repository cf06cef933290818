// SPDX-License-Identifier: Apache-2.0
// bloom.c - the engine's life, and a frame's: what glows, plan, record, run, account.
#include "bloom.h"

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "bloom_internal.h"
#include "look.h"
#include "spirv.h"

enum { LEDGER_CELLS = 256 }; // the coarsest level is at most this wide and high, for its sum is read back

/* ---- pipelines ----------------------------------------------------------------------------------- */

static const struct spirv_entry *spirv_find(const char *name)
{
    for (unsigned i = 0; i < sizeof(spirv_table) / sizeof(spirv_table[0]); i++)
        if (!strcmp(spirv_table[i].name, name))
            return &spirv_table[i];
    return NULL;
}

static bool starts(const char *name, const char *with) { return !strncmp(name, with, strlen(with)); }

const struct vk_pipeline *pipeline_get(struct bloom *b, struct fault *f, int32_t spec, const char *format, ...)
{
    char name[40];
    va_list args;
    va_start(args, format);
    vsnprintf(name, sizeof(name), format, args);
    va_end(args);
    for (unsigned i = 0; i < b->pipelines; i++)
        if (b->pipeline[i].spec == spec && !strcmp(b->pipeline[i].name, name))
            return &b->pipeline[i].pipeline;
    const struct spirv_entry *s = spirv_find(name);
    assert(s && b->pipelines < PIPELINES_MAX);
    struct named_pipeline *p = &b->pipeline[b->pipelines];
    const bool picture = starts(name, "composite") || starts(name, "develop");
    const bool layered = starts(name, "bright") || starts(name, "extract");
    const unsigned attachments = layered ? (strstr(name, "_c3") ? 6 : 2) : LEVEL_PHASES;
    const int r = starts(name, "histogram")
                      ? vk_compute_create(&b->vk, &p->pipeline, s->words, s->bytes, f)
                      : vk_pipeline_create(&b->vk, &p->pipeline, s->words, s->bytes,
                                           picture ? VK_FORMAT_R32G32B32A32_UINT : VK_FORMAT_R32G32B32A32_SFLOAT,
                                           attachments, &spec, layered || starts(name, "develop") ? 1 : 0, f);
    if (r < 0)
        return NULL;
    snprintf(p->name, sizeof(p->name), "%s", name);
    p->spec = spec;
    b->pipelines++;
    return &p->pipeline;
}

/* ---- plans --------------------------------------------------------------------------------------- */

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

// b->plan: from the cache, or made in the place of the one that nobody has asked for longest.
static int find_plan(struct bloom *b, const struct bloom_request *r, const struct bloom_geometry *g, struct fault *f)
{
    const struct params *p = r->params;
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

// Level 1 is always there, so that the full-size image never has to be summed; more until the sum is small.
static unsigned octaves_for(const struct plan *p, uint32_t width, uint32_t height)
{
    unsigned n = p->levels ? p->levels : 1;
    while (n < PSF_LEVELS_MAX && ((width >> n) > LEDGER_CELLS || (height >> n) > LEDGER_CELLS))
        n++;
    return n;
}

static bool wants(const struct frame *fr, enum view view)
{
    bool any = fr->params->view_spec.view == view;
    for (unsigned i = 0; i + 1 < fr->target->geometry.outputs; i++)
        any |= fr->params->layer[i].view == view;
    return any;
}

// What the request means for the passes.
static void set_features(struct frame *fr)
{
    const struct params *p = fr->params;
    fr->fft = p->psf_spec.kind != PSF_GAUSSIANS;
    fr->pad = 0;
    if (p->edge == EDGE_FILL)
        fr->pad = (plan_reach(fr->b->plan) + 15) / 16 * 16;
    fr->rich = fr->matte || p->firefly > 0 || p->clamp > 0 || fr->pad;
    fr->keeps_e = fr->fft || fr->rich || wants(fr, VIEW_BRIGHT) || wants(fr, VIEW_RESIDUAL) ||
                  p->composite == COMPOSITE_MIX;
}

static int prepare_targets(struct frame *fr)
{
    struct bloom *b = fr->b;
    const struct slot_target *t = fr->target;
    const uint32_t width = t->width + 2 * fr->pad, height = t->height + 2 * fr->pad;
    const bool full = b->plan->full_size || fr->keeps_e;
    const struct targets_shape shape = {
        .width = width,
        .height = height,
        .channels = t->geometry.channels,
        .octaves = octaves_for(b->plan, width, height),
        .full_size = full,
        .finest = b->plan->full_size || fr->fft ? 0 : 1,
    };
    if (b->prepared == b->plan && b->prepared_pad == fr->pad + t->geometry.grow && targets_same(&b->targets, &shape))
        return 0;
    b->prepared = NULL;
    if (targets_prepare(&b->vk, &b->targets, &shape, fr->f) < 0 ||
        ledger_prepare(&b->ledger, b->plan, &b->targets, fr->pad + t->geometry.grow, fr->f) < 0)
        return -1;
    b->prepared = b->plan;
    b->prepared_pad = fr->pad + t->geometry.grow;
    return 0;
}

/* ---- a frame --------------------------------------------------------------------------------------- */

static double now_ms(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec * 1e3 + (double)t.tv_nsec * 1e-6;
}

static void log_profile(struct bloom *b)
{
    double ms[VK_STAMPS_MAX], before = 0;
    const unsigned n = vk_stamps_ms(&b->commands, ms, VK_STAMPS_MAX);
    for (unsigned i = 0; i < n && b->vk.log; i++) {
        char text[96];
        snprintf(text, sizeof(text), "pass %-24s %8.3f ms", b->pass_name[i], ms[i] - before);
        b->vk.log(text);
        before = ms[i];
    }
}

static bool displays(const struct params *p)
{
    return p->display != DISPLAY_NONE || p->encoding != ENCODING_LINEAR || p->saturation != 1;
}

// Whether the picture differs from the input though nothing glows.
static bool changes_anyway(const struct frame *fr)
{
    const struct frame_scan *s = fr->request->scan;
    const struct params *p = fr->params;
    const bool zeroes = p->nonfinite == NONFINITE_ZERO && (s->nan || s->positive_inf || s->negative_inf);
    const enum view view = p->view_spec.view;
    if (view == VIEW_BRIGHT || view == VIEW_BLOOM || view == VIEW_LEVEL || (view == VIEW_RESIDUAL && p->bloom == SWITCH_ON))
        return true;
    return zeroes || (fr->matte && p->emission != 1) || (view == VIEW_FINAL && displays(p));
}

/* The spread that the pool holds now, so that pictures of the same one share it. */
struct spread {
    bool done;
    int only;             /* a Gaussian's index, -1: all */
    struct vk_image *sum; /* NULL: no glow */
};

static bool shows_glow(enum view view) { return view == VIEW_FINAL || view == VIEW_BLOOM || view == VIEW_LEVEL; }

static int find_spread(struct frame *fr, const struct view_spec *view, struct spread *have)
{
    const int only = view->view == VIEW_LEVEL ? (int)view->level : -1;
    if (!shows_glow(view->view) || (have->done && (have->only == only || fr->fft)))
        return 0;
    *have = (struct spread){ .done = true, .only = only };
    if (fr->fft)
        return fft_spread(fr, &have->sum);
    struct round r;
    if (record_spread(fr, only, &r) < 0)
        return -1;
    have->sum = r.any ? r.sum : NULL;
    return 0;
}

static int record_pictures(struct frame *fr, bool dark)
{
    const struct params *p = fr->params;
    struct spread have = { 0 };
    // Whatever is shown, a kernel's ledger is counted while it is spread.
    if (fr->fft && !dark && find_spread(fr, &(struct view_spec){ VIEW_BLOOM, 0 }, &have) < 0)
        return -1;
    for (unsigned i = 0; i < fr->target->geometry.outputs; i++) {
        const struct view_spec *view = i ? &p->layer[i - 1] : &p->view_spec;
        if (i == 0 && dark && !changes_anyway(fr))
            continue;
        if ((!dark && find_spread(fr, view, &have) < 0) ||
            record_output(fr, i, view, shows_glow(view->view) ? have.sum : NULL) < 0)
            return -1;
    }
    return 0;
}

static int record_frame(struct frame *fr, bool dark)
{
    struct bloom *b = fr->b;
    if (record_begin(fr) < 0)
        return -1;
    if (fr->request->dirt && dirt_upload(fr, fr->request->dirt) < 0)
        return -1;
    // Even where no glow is added somebody may want to see E.
    const bool off = fr->params->bloom == SWITCH_OFF;
    if ((!dark || (fr->keeps_e && !off)) && (record_totals(fr) < 0 || record_bright(fr) < 0))
        return -1;
    if (!dark && ledger_record(&b->commands, &b->ledger, &b->targets, fr->f) < 0)
        return -1;
    return record_pictures(fr, dark) < 0 ? -1 : record_end(fr);
}

static void account(struct frame *fr, struct bloom_reply *r)
{
    struct bloom *b = fr->b;
    const struct params *p = fr->params;
    struct ledger_sums sums;
    ledger_sum(&b->ledger, b->plan, &b->targets, &sums);
    if (fr->fft)
        sums.bright = fr->sums.bright, sums.inside = fr->sums.inside, sums.outside = fr->sums.outside;
    r->energy_bright = fr->pad ? sums.total[TOTAL_BRIGHT] : sums.bright;
    r->energy_bloomed = p->intensity * sums.inside;
    // With edge=fill as much comes in as goes out: nothing is lost.
    r->energy_lost = fr->pad ? 0 : p->intensity * sums.outside;
    double after = r->energy_bright;
    if (p->clamp > 0) {
        r->energy_clamped = fmax(0, sums.total[TOTAL_UNCLAMPED] - after);
        after = sums.total[TOTAL_UNCLAMPED];
    }
    if (p->firefly > 0)
        r->energy_suppressed = fmax(0, sums.total[TOTAL_RAW] - after);
}

static void describe_plan(struct bloom *b, const struct params *p, struct bloom_reply *r)
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

// The spread's own error, of max E.
static double plan_bound(const struct frame *fr)
{
    const struct plan *p = fr->b->plan;
    return fr->fft ? fft_bound(fr) : p->filter_bound + p->weight_sum * p->rounding_bound;
}

static double plan_weight(const struct frame *fr)
{
    return fr->fft ? fr->params->psf_spec.weight : fr->b->plan->weight_sum;
}

static void untouched(struct bloom_reply *r)
{
    r->untouched = true;
    snprintf(r->plan, sizeof(r->plan), "untouched: %s",
             r->max_bright == 0 ? "no pixel is above the threshold" : "the glow has no weight");
    snprintf(r->rule, sizeof(r->rule), "-");
}

static int check_request(const struct frame *fr)
{
    const struct bloom_geometry *g = &fr->target->geometry;
    const struct slot_target *others[] = { fr->source, fr->matte };
    for (unsigned i = 0; i < 2; i++)
        if (others[i] && (others[i]->geometry.width != g->width || others[i]->geometry.height != g->height ||
                          others[i]->geometry.grow != g->grow))
            return fault_set(fr->f, FAULT_INTERNAL, i ? "params.matte" : "params.source",
                             "%u x %u pixels: the bloomed layer's %u x %u expected", others[i]->geometry.width,
                             others[i]->geometry.height, g->width, g->height);
    if (fr->params->edge == EDGE_FILL && fr->params->psf_spec.kind != PSF_GAUSSIANS)
        return fault_set(fr->f, FAULT_PARAM_CONFLICT, "params.edge", "edge=fill: a psf of Gaussians expected");
    return 0;
}

// A target is no companion of itself.
static int companion(int i, unsigned target) { return i < 0 || (unsigned)i == target ? -1 : i; }

int bloom_run(struct bloom *b, struct bloom_slot *s, unsigned target, const struct bloom_request *asked,
              struct bloom_reply *reply, struct fault *f)
{
    struct bloom_request request = *asked;
    request.source = companion(asked->source, target);
    request.matte = companion(asked->matte, target);
    request.depth = companion(asked->depth, target);
    struct frame fr = { .b = b, .slot = s, .target = &s->target[target], .request = &request, .params = request.params,
                        .f = f };
    fr.matte = request.matte >= 0 ? &s->target[request.matte] : NULL;
    fr.source = request.source >= 0 ? &s->target[request.source] : fr.target;
    fr.scan = request.source >= 0 ? request.source_scan : request.scan;
    struct bloom_reply r = { 0 };
    const double start = now_ms();
    if (check_request(&fr) < 0)
        return -1;
    fr.exposure = fr.params->exposure;
    const bool exposed = fr.params->bloom == SWITCH_ON || displays(fr.params);
    if (fr.params->exposure_auto && exposed && meter_exposure(&fr, &fr.exposure) < 0)
        return -1;
    r.exposure = fr.exposure;
    bright_set(&fr);
    bright_count(&fr, &r);
    if (fr.params->look != LOOK_NONE) {
        if (look_run(b, s, target, &request, fr.exposure, &r, f) < 0)
            return -1;
        *reply = r;
        return 0;
    }
    if (find_plan(b, &request, &fr.target->geometry, f) < 0)
        return -1;
    set_features(&fr);
    const bool no_plan = fr.fft ? fr.params->psf_spec.weight == 0 : !b->plan->count;
    const bool dark = r.max_bright == 0 || no_plan || fr.params->intensity == 0;
    if (dark)
        untouched(&r);
    if (dark && !changes_anyway(&fr) && fr.target->geometry.outputs == 1) {
        *reply = r;
        return 0;
    }
    r.untouched = dark && !changes_anyway(&fr);
    if (prepare_targets(&fr) < 0 || (fr.fft && !dark && fft_prepare(&fr) < 0) || record_frame(&fr, dark) < 0)
        return -1;
    r.device_ms = now_ms() - start;
    log_profile(b);
    if (!dark) {
        describe_plan(b, fr.params, &r);
        r.error_bound = plan_bound(&fr) + plan_weight(&fr) * bright_rounding(&fr, &r);
        r.predicted_ms = cost_predict(b, b->plan, &fr.target->geometry);
        account(&fr, &r);
    }
    *reply = r;
    return 0;
}

int bloom_plan(struct bloom *b, const struct bloom_geometry *geometry, const struct bloom_request *request,
               struct bloom_reply *reply, struct fault *f)
{
    const struct params *p = request->params;
    struct bloom_reply r = { 0 };
    if (p->look != LOOK_NONE) {
        look_print(p, geometry->width, geometry->height, r.plan, sizeof(r.plan));
        *reply = r;
        return 0;
    }
    if (find_plan(b, request, geometry, f) < 0)
        return -1;
    describe_plan(b, p, &r);
    r.error_bound = b->plan->filter_bound + b->plan->weight_sum * b->plan->rounding_bound;
    r.predicted_ms = cost_predict(b, b->plan, geometry);
    *reply = r;
    return 0;
}

/* ---- life ------------------------------------------------------------------------------------------ */

static int open_device(struct bloom *b, const struct bloom_options *o, struct fault *f)
{
    const struct spirv_entry *vertex = spirv_find("fullscreen");
    if (vk_open(&b->vk, o->device, o->validate, o->log, vertex->words, vertex->bytes, f) < 0)
        return -1;
    snprintf(b->info.name, sizeof(b->info.name), "%s", b->vk.properties.deviceName);
    snprintf(b->info.driver, sizeof(b->info.driver), "%s", b->vk.driver);
    b->info.cpu = b->vk.cpu;
    b->info.max_dimension = b->vk.properties.limits.maxImageDimension2D;
    b->staged = !b->vk.cpu || o->staged;
    if (vk_commands_create(&b->vk, &b->commands, o->profile, f) < 0)
        return -1;
    if (vk_image_create(&b->vk, &b->blank, VK_FORMAT_R32G32B32A32_SFLOAT, 1, 1, 1, false, f) < 0 ||
        vk_memory_reserve(&b->vk, &b->blank_memory, b->blank.needs.size, b->blank.needs.memoryTypeBits, VK_PLACE_DEVICE,
                          f) < 0 ||
        vk_image_bind(&b->vk, &b->blank, &b->blank_memory, 0, f) < 0)
        return -1;
    return vk_buffer_reserve(&b->vk, &b->uniforms, (VkDeviceSize)PASSES_MAX * UNIFORM_STRIDE,
                             VK_BUFFER_USAGE_UNIFORM_BUFFER_BIT, f);
}

int bloom_create(struct bloom **out, const struct bloom_options *options, struct fault *f)
{
    struct bloom *b = calloc(1, sizeof(*b));
    if (!b)
        return fault_set(f, FAULT_NO_MEMORY, "", "out of memory");
    b->slots = options->slots < 1 ? 1 : options->slots > 8 ? 8 : options->slots;
    b->threads = options->threads ? options->threads : 2;
    if (open_device(b, options, f) < 0 || bloom_self_test(b, options->warm_all, f) < 0 || cost_measure(b, f) < 0) {
        bloom_destroy(b);
        return -1;
    }
    *out = b;
    return 0;
}

void bloom_destroy(struct bloom *b)
{
    if (!b)
        return;
    if (b->vk.device) {
        vkDeviceWaitIdle(b->vk.device);
        ledger_clear(&b->ledger);
        look_destroy(b, b->look);
        fft_destroy(b);
        vk_buffer_free(&b->vk, &b->counts);
        vk_buffer_free(&b->vk, &b->exchange);
        vk_image_destroy(&b->vk, &b->blank);
        vk_image_destroy(&b->vk, &b->dirt);
        vk_memory_free(&b->vk, &b->blank_memory);
        vk_memory_free(&b->vk, &b->dirt_memory);
        vk_buffer_free(&b->vk, &b->ledger.buffer);
        targets_destroy(&b->vk, &b->targets);
        vk_arena_free(&b->vk, &b->targets.memory);
        for (unsigned i = 0; i < b->slots; i++)
            slot_destroy(&b->vk, &b->slot[i]);
        slot_destroy(&b->vk, &b->warm_slot);
        for (unsigned i = 0; i < b->pipelines; i++)
            vk_pipeline_destroy(&b->vk, &b->pipeline[i].pipeline);
        vk_buffer_free(&b->vk, &b->uniforms);
        vk_commands_destroy(&b->commands);
    }
    vk_close(&b->vk);
    free(b);
}

const struct bloom_device_info *bloom_device(const struct bloom *b) { return &b->info; }
unsigned bloom_validation_messages(const struct bloom *b) { return b->vk.messages; }
unsigned bloom_pipelines(const struct bloom *b, unsigned *possible)
{
    *possible = 0;
    static const char *const rare[] = { "fullscreen", "extract", "develop", "histogram", "look" };
    for (unsigned i = 0; i < sizeof(spirv_table) / sizeof(spirv_table[0]); i++) {
        bool common = true;
        for (unsigned k = 0; k < sizeof(rare) / sizeof(rare[0]); k++)
            common &= !starts(spirv_table[i].name, rare[k]);
        if (common)
            *possible += strncmp(spirv_table[i].name, "bright", 6) ? 1 : BRIGHT_SMOOTHSTEP + 1;
    }
    return b->pipelines;
}

void bloom_list_devices(void (*print)(const char *line)) { vk_list(print); }
struct bloom_slot *bloom_slot(struct bloom *b, unsigned i) { return i < b->slots ? &b->slot[i] : NULL; }
