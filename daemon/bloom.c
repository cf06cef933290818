// SPDX-License-Identifier: Apache-2.0
// bloom.c - the engine's life, and a frame's: what glows, plan, record, run, account.
#include "bloom.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "bloom_host.h"
#include "look.h"

// Would auto take half where it may? Measured on lavapipe: half the memory and the same time, so float32, which is the more
// accurate, stays. A constant, so that a request gives the same bytes on every day.
enum { HALF_PAYS = 0 };
enum { LEDGER_CELLS = 256 }; // the coarsest level is at most this wide and high, for its sum is read back

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

// Levels as half: for plain pictures, where the bound allows it and no number is beyond float32's middle.
static int choose_storage(struct frame *fr, double max_bright)
{
    const struct params *p = fr->params;
    const struct plan *plan = fr->b->plan;
    fr->half = false;
    fr->scale = 1;
    if (p->storage == STORAGE_FLOAT || fr->fft || fr->wall)
        return 0;
    const bool plain = !fr->keeps_e && is_plain_picture(fr, &p->view_spec) && fr->target->geometry.outputs == 1;
    const bool sane = max_bright > 1e-25 && max_bright * fmax(1, plan->weight_sum) < 1e30;
    if (!plain || !sane || !plan_holds_half(plan, p->tolerance)) {
        if (p->storage == STORAGE_HALF && plain && sane)
            return fault_set(fr->f, FAULT_PARAM_CONFLICT, "params.storage",
                             "storage=half: levels of half would err by up to %.2g here, and tolerance is %g: float or auto expected",
                             plan->filter_bound + plan->half_bound, p->tolerance);
        return 0;
    }
    if (p->storage == STORAGE_AUTO && !HALF_PAYS)
        return 0;
    fr->half = true;
    // Weighted sums of numbers up to max E stay below half of 65504.
    int exponent;
    frexp(max_bright * fmax(1, plan->weight_sum), &exponent);
    fr->scale = ldexp(1, 15 - exponent);
    return 0;
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
        .octaves = fr->wall_direct ? b->plan->levels : octaves_for(b->plan, width, height),
        .full_size = full,
        .finest = fr->wall_direct ? fr->wall_level : b->plan->full_size || fr->fft ? 0 : 1,
        .half = fr->half,
    };
    if (fr->wall_direct) // no ledger
        return targets_prepare(&b->vk, &b->targets, &shape, fr->f);
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

double bloom_now_ms(void)
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

// Whether the picture differs from the input though nothing glows.
static bool changes_anyway(const struct frame *fr)
{
    const struct frame_scan *s = fr->request->scan;
    const struct params *p = fr->params;
    const bool zeroes = p->nonfinite == NONFINITE_ZERO && (s->nan || s->positive_inf || s->negative_inf);
    const enum view view = p->view_spec.view;
    if (view == VIEW_BRIGHT || view == VIEW_BLOOM || view == VIEW_LEVEL || (view == VIEW_RESIDUAL && p->bloom == SWITCH_ON))
        return true;
    return zeroes || (fr->matte && p->emission != 1) || (view == VIEW_FINAL && params_display(p));
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
    ledger_sum(&b->ledger, b->plan, &b->targets, fr->scale, &sums);
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

// The spread's own error, of max E.
static double plan_bound(const struct frame *fr)
{
    const struct plan *p = fr->b->plan;
    return fr->fft ? fft_bound(fr) : p->filter_bound + p->weight_sum * p->rounding_bound + (fr->half ? p->half_bound : 0);
}

static double plan_weight(const struct frame *fr)
{
    return fr->fft ? fr->params->psf_spec.weight : fr->b->plan->weight_sum;
}

static bool all_skipped(const struct frame *fr)
{
    const unsigned n = fr->b->plan->count;
    return n && fr->skip == (n == 32 ? UINT32_MAX : (1u << n) - 1);
}

// Nothing is spread: why, in the reply.
static void dark_reply(const struct frame *fr, struct bloom_reply *r)
{
    const char *why = fr->params->bloom == SWITCH_OFF ? "bloom=off"
                      : r->max_bright == 0 ? "no pixel is above the threshold"
                      : all_skipped(fr) ? "the glow stays below half of the output's smallest step"
                                        : "the glow has no weight";
    r->untouched = !changes_anyway(fr);
    snprintf(r->skipped, sizeof(r->skipped), "the spread: %s", why);
    snprintf(r->plan, sizeof(r->plan), "%s: %s", r->untouched ? "untouched" : "no glow", why);
    snprintf(r->rule, sizeof(r->rule), "-");
    r->error_bound = fr->skip_bound;
}

static void describe_skips(const struct frame *fr, struct bloom_reply *r)
{
    int n = 0;
    if (fr->lit)
        n = snprintf(r->skipped, sizeof(r->skipped), "bright pass and first levels of %.0f %% of the tiles: no highlight there",
                     100 * (1 - fr->lit->share));
    const unsigned skipped = (unsigned)__builtin_popcount(fr->skip);
    if (skipped)
        snprintf(r->skipped + n, sizeof(r->skipped) - (size_t)n, "%s%u of %u Gaussians: together below half of the output's smallest step",
                 n ? "; " : "", skipped, fr->b->plan->count);
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

static int run_frame(struct frame *fr, bool dark, struct bloom_reply *r)
{
    struct bloom *b = fr->b;
    if (choose_storage(fr, r->max_bright) < 0 || (fr->wall_host ? host_prepare(fr, dark) : prepare_targets(fr)) < 0 || (fr->fft && !dark && fft_prepare(fr) < 0))
        return -1;
    struct lit lit;
    if (!dark) {
        fr->most_glow = fr->params->intensity * r->max_bright * (plan_weight(fr) * (1 + 0x1p-10) + plan_bound(fr));
        fr->lit = !b->whole && !fr->wall_host && bright_lit(fr, &lit) ? &lit : NULL;
    }
    if ((fr->wall_host ? wall_run_host(fr, dark) : fr->wall_direct ? wall_run(fr, dark) : record_frame(fr, dark)) < 0)
        return -1;
    if (!fr->wall_host)
        log_profile(b);
    if (dark)
        return 0;
    plan_describe(b, fr->params, r);
    describe_skips(fr, r);
    snprintf(r->storage, sizeof(r->storage), "%s", fr->half ? "half" : "float");
    r->error_bound = plan_bound(fr) + plan_weight(fr) * bright_rounding(fr, r) + fr->skip_bound;
    if (fr->wall_direct) {
        r->error_bound += plan_weight(fr) * wall_rounding(fr);
        return 0;
    }
    r->predicted_ms = fr->fft ? 0 : cost_predict(b, b->plan, &fr->target->geometry);
    account(fr, r);
    return 0;
}

// A target is no companion of itself.
static int companion(int i, unsigned target) { return i < 0 || (unsigned)i == target ? -1 : i; }

// A stated psf's frame, from plan to planes or drive.
static int run_stated(struct frame *fr, struct bloom_reply *r)
{
    if (plan_find(fr->b, fr->request, &fr->target->geometry, fr->f) < 0)
        return -1;
    set_features(fr);
    if (fr->wall_direct)
        fr->wall_level = wall_level(fr->b, fr->b->plan, fr->wall);
    fr->wall_host = fr->wall_direct && fr->b->vk.cpu && !fr->b->staged && !fr->rich;
    const bool no_plan = fr->fft ? fr->params->psf_spec.weight == 0 : !fr->b->plan->count;
    bool dark = r->max_bright == 0 || no_plan || fr->params->intensity == 0;
    // A wall's shares must agree on what is left out.
    if (!dark && !fr->wall && is_plain_picture(fr, &fr->params->view_spec) && fr->target->geometry.outputs == 1)
        bright_skip(fr, r);
    dark |= all_skipped(fr);
    if (dark)
        dark_reply(fr, r);
    const bool anyway = fr->target->geometry.outputs > 1 || fr->wall_direct;
    return !r->untouched || anyway ? run_frame(fr, dark, r) : 0;
}

static int run_any(struct frame *fr, unsigned target, struct bloom_reply *r)
{
    struct bloom *b = fr->b;
    const bool exposed = fr->params->bloom == SWITCH_ON || params_display(fr->params) || fr->wall;
    struct bloom_adapt *adapt = fr->wall && fr->params->exposure_auto ? fr->wall->adapt : NULL;
    fr->exposure = fr->params->exposure;
    if (fr->params->exposure_auto && exposed && meter_exposure(fr, &fr->exposure) < 0)
        return -1;
    if (adapt)
        fr->exposure = bloom_adapt_stops(adapt, fr->exposure);
    r->exposure = fr->exposure;
    bright_set(fr);
    bright_count(fr, r);
    if (fr->params->look == LOOK_NONE) {
        if (run_stated(fr, r) < 0)
            return -1;
    } else {
        if (look_run(b, fr->slot, target, fr->request, fr->exposure, r, fr->f) < 0)
            return -1;
        if (!r->untouched)
            log_profile(b);
    }
    if (fr->wall && !fr->wall_direct) {
        if (wall_run_output(fr, r->untouched) < 0)
            return -1;
        log_profile(b);
    }
    if (adapt) {
        adapt->stops = fr->exposure;
        adapt->started = true;
    }
    return 0;
}

int bloom_run(struct bloom *b, struct bloom_slot *s, unsigned target, const struct bloom_request *asked,
              struct bloom_reply *reply, struct fault *f)
{
    struct bloom_request request = *asked;
    struct params of_wall;
    request.source = companion(asked->source, target);
    request.matte = companion(asked->matte, target);
    request.depth = companion(asked->depth, target);
    if (asked->wall) { // a mean has no place to keep a NaN in
        of_wall = *asked->params;
        of_wall.nonfinite = NONFINITE_ZERO;
        request.params = &of_wall;
    }
    struct frame fr = { .b = b, .slot = s, .target = &s->target[target], .request = &request, .params = request.params,
                        .wall = request.wall, .f = f };
    fr.wall_direct = fr.wall && bloom_wall_is_direct(fr.params);
    fr.matte = request.matte >= 0 ? &s->target[request.matte] : NULL;
    fr.source = request.source >= 0 ? &s->target[request.source] : fr.target;
    fr.scan = request.source >= 0 ? request.source_scan : request.scan;
    struct bloom_reply r = { 0 };
    const double start = bloom_now_ms();
    if (check_request(&fr) < 0 || (fr.wall && wall_check(&fr) < 0) || run_any(&fr, target, &r) < 0)
        return -1;
    // A look keeps its own time.
    if ((!r.untouched && fr.params->look == LOOK_NONE) || fr.wall)
        r.device_ms = bloom_now_ms() - start;
    *reply = r;
    return 0;
}

/* ---- first frames of a wall ------------------------------------------------------------------------ */

static int warm_run(struct bloom *b, const struct bloom_request *r, struct frame_scan *scan, float luminance, struct fault *f)
{
    uint32_t bits;
    struct bloom_reply reply;
    memcpy(&bits, &luminance, sizeof(bits));
    for (uint32_t i = 0; i < scan->tiles_x * scan->tiles_y; i++) {
        atomic_store(&scan->tile_luma[i], bits);
        atomic_store(&scan->tile_channel[i], bits);
    }
    return bloom_run(b, &b->warm_slot, 0, r, &reply, f);
}

int bloom_wall_warm(struct bloom *b, const struct bloom_wall *w, const struct params *p, const struct bloom_geometry *geometry,
                    float pixel_aspect, uint32_t display_width, struct fault *f)
{
    struct planes in, out[BLOOM_OUTPUTS_MAX];
    struct frame_scan scan = { 0 };
    struct bloom_wall wall = *w;
    struct bloom_request r = { .params = p, .scan = &scan, .source = -1, .matte = -1, .depth = -1, .wall = &wall,
                               .pixel_aspect = pixel_aspect, .display_width = display_width };
    int rc = -1;
    memcpy(r.luma, frame_rec709, sizeof(r.luma));
    wall.adapt = NULL;
    wall.drive = calloc((size_t)w->width * w->height * 3, sizeof(float));
    const bool no_scan = frame_scan_init(&scan, geometry->width, geometry->height) != 0;
    if (!wall.drive || no_scan) {
        fault_set(f, FAULT_NO_MEMORY, "wall", "no memory for a first frame of %u x %u", geometry->width, geometry->height);
        goto fail;
    }
    // The planes are black; what the scan says of them decides which passes are drawn.
    if (bloom_slot_prepare(b, &b->warm_slot, 1, geometry, &in, out, f) == 0 && warm_run(b, &r, &scan, 1e30f, f) == 0)
        rc = warm_run(b, &r, &scan, 0, f);
fail:
    // As large as a frame, and not needed again.
    slot_destroy(&b->vk, &b->warm_slot);
    memset(&b->warm_slot, 0, sizeof(b->warm_slot));
    if (!no_scan)
        frame_scan_finish(&scan);
    free(wall.drive);
    return rc;
}

/* ---- life ------------------------------------------------------------------------------------------ */

static int open_device(struct bloom *b, const struct bloom_options *o, struct fault *f)
{
    size_t vertex_bytes;
    const uint32_t *vertex = pipeline_vertex(&vertex_bytes);
    if (vk_open(&b->vk, o->device, o->validate, o->log, vertex, vertex_bytes, f) < 0)
        return -1;
    snprintf(b->info.name, sizeof(b->info.name), "%s", b->vk.properties.deviceName);
    snprintf(b->info.driver, sizeof(b->info.driver), "%s", b->vk.driver);
    b->info.cpu = b->vk.cpu;
    b->info.max_dimension = b->vk.properties.limits.maxImageDimension2D;
    b->staged = !b->vk.cpu || o->staged;
    b->whole = o->whole;
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
    b->slots = options->slots < 1 ? 1 : options->slots > BLOOM_SLOTS_MAX ? BLOOM_SLOTS_MAX : options->slots;
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
        host_destroy(b->host);
        for (unsigned i = 0; i < WALL_KEPT; i++)
            wall_work_destroy(&b->vk, b->wall[i]);
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
void bloom_list_devices(void (*print)(const char *line)) { vk_list(print); }
struct bloom_slot *bloom_slot(struct bloom *b, unsigned i) { return i < b->slots ? &b->slot[i] : NULL; }
