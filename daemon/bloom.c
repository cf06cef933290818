// SPDX-License-Identifier: Apache-2.0
// bloom.c - the engine's life, and a frame's: plan, record, run, account. record_frame() reads like METHODS.
#include "bloom.h"

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "bloom_internal.h"
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
    const bool composite = !strncmp(name, "composite", 9), bright = !strncmp(name, "bright", 6);
    const unsigned attachments = bright ? (strstr(name, "_c3") ? 6 : 2) : LEVEL_PHASES;
    if (vk_pipeline_create(&b->vk, &p->pipeline, s->words, s->bytes,
                           composite ? VK_FORMAT_R32G32B32A32_UINT : VK_FORMAT_R32G32B32A32_SFLOAT,
                           attachments, &spec, bright ? 1 : 0, f) < 0)
        return NULL;
    snprintf(p->name, sizeof(p->name), "%s", name);
    p->spec = spec;
    b->pipelines++;
    return &p->pipeline;
}

/* ---- recording ----------------------------------------------------------------------------------- */

/* One frame being recorded. */
struct frame {
    struct bloom *b;
    struct slot_target *target;
    const struct bloom_request *request;
    double threshold, knee; /* in use: exposure applied */
    struct fault *f;
};

static struct pass_uniforms *begin_pass(struct frame *fr, struct vk_draw *d)
{
    struct bloom *b = fr->b;
    assert(b->passes < PASSES_MAX);
    b->pass_name[b->passes] = ((const struct named_pipeline *)(const void *)
                                   ((const char *)d->pipeline - offsetof(struct named_pipeline, pipeline)))->name;
    const VkDeviceSize offset = (VkDeviceSize)b->passes++ * UNIFORM_STRIDE;
    d->uniforms = b->uniforms.buffer;
    d->uniforms_offset = offset;
    d->uniforms_bytes = sizeof(struct pass_uniforms);
    struct pass_uniforms *u = (struct pass_uniforms *)(void *)(b->uniforms.memory.map + offset);
    memset(u, 0, sizeof(*u));
    return u;
}

static VkRect2D area_of(uint32_t width, uint32_t height) { return (VkRect2D){ { 0, 0 }, { width, height } }; }

static void level_area(struct frame *fr, const struct level *v, struct vk_draw *d, struct pass_uniforms *u)
{
    u->frame[2] = (int32_t)v->groups;
    d->area = area_of(v->texels, v->groups * fr->target->geometry.channels);
}

static void source(struct pass_uniforms *u, const struct level *v)
{
    u->src[0] = (int32_t)v->texels;
    u->src[1] = (int32_t)v->groups;
}

static void added(struct pass_uniforms *u, const struct level *v)
{
    u->add[0] = (int32_t)v->texels;
    u->add[1] = (int32_t)v->groups;
}

static void input_planes(struct frame *fr, struct vk_draw *d)
{
    for (unsigned c = 0; c < VK_PLANES; c++)
        d->in[c] = &fr->target->in[c < fr->target->geometry.channels ? c : 0];
}

// Step 4, and with an order the first halving across.
static int record_bright(struct frame *fr, unsigned order)
{
    struct targets *t = &fr->b->targets;
    const struct bloom_geometry *g = &fr->target->geometry;
    const struct params *p = fr->request->params;
    struct vk_draw d = { .dst = &t->layered };
    d.pipeline = pipeline_get(fr->b, fr->f, p->bright, "bright_o%u_c%u%s", order, g->channels,
                              g->type == PIXEL_TYPE_HALF ? "_half" : "");
    if (!d.pipeline)
        return -1;
    struct pass_uniforms *u = begin_pass(fr, &d);
    u->frame[0] = (int32_t)g->width;
    u->frame[1] = (int32_t)g->height;
    // Differences are taken in double here: T - K must be 0 when K = T, not a rest of rounding.
    const double edge = fr->threshold, k = p->bright == BRIGHT_SMOOTHSTEP ? edge * fr->knee : fr->knee;
    u->bright[0] = (float)edge;
    u->bright[1] = (float)(2 * k);
    u->bright[2] = k > 0 ? (float)(1 / ((p->bright == BRIGHT_SMOOTHSTEP ? 2 : 4) * k)) : 0;
    u->bright[3] = (float)(edge - k);
    for (unsigned c = 0; c < 3; c++)
        u->luma[c] = fr->request->luma[c];
    input_planes(fr, &d);
    d.area = area_of(t->layered.width, t->layered.height);
    vk_draw(&fr->b->commands, &d);
    return 0;
}

// What a level-0 read of the layered image must know: its groups are of 2 rows.
static void layered_source(const struct targets *t, struct pass_uniforms *u)
{
    u->src[0] = (int32_t)t->layered.width;
    u->src[1] = (int32_t)t->layered_groups;
}

static int record_down(struct frame *fr, unsigned octave, unsigned order)
{
    struct targets *t = &fr->b->targets;
    const char *kind = octave > 0 ? "" : t->shape.full_size ? "layered_" : "vertical_";
    struct vk_draw d = { .src = octave ? &t->e[octave] : &t->layered, .dst = &t->e[octave + 1] };
    d.pipeline = pipeline_get(fr->b, fr->f, 0, "down_%so%u", kind, order);
    if (!d.pipeline)
        return -1;
    struct pass_uniforms *u = begin_pass(fr, &d);
    if (octave)
        source(u, &t->level[octave]);
    else
        layered_source(t, u);
    level_area(fr, &t->level[octave + 1], &d, u);
    vk_draw(&fr->b->commands, &d);
    return 0;
}

static unsigned reach_of(const struct psf_taps *taps)
{
    static const unsigned reaches[] = { 1, 2, 3, 4, 6, 10 };
    unsigned i = 0;
    while (4 * reaches[i] < taps->half)
        i++;
    return reaches[i];
}

static void set_taps(struct pass_uniforms *u, const struct psf_taps *taps)
{
    for (unsigned k = 0; k <= taps->half; k++)
        u->tap[k] = (float)taps->tap[k];
}

/* Three images go round: one holds the sum so far, the others the next rows and the next sum. */
struct round {
    struct vk_image *sum, *rows, *next;
    bool any; /* sum holds something */
};

static int record_gaussian(struct frame *fr, const struct plan_gaussian *k, struct round *r)
{
    struct targets *t = &fr->b->targets;
    const struct level *v = &t->level[k->level];
    struct vk_draw h = { .src = k->level ? &t->e[k->level] : &t->layered, .dst = r->rows };
    h.pipeline = pipeline_get(fr->b, fr->f, 0, "blur_h_%sr%u", k->level ? "" : "layered_", reach_of(&k->x));
    struct vk_draw w = { .src = r->rows, .add = r->any ? r->sum : NULL, .dst = r->next };
    w.pipeline = h.pipeline ? pipeline_get(fr->b, fr->f, 0, "blur_v_%sr%u", r->any ? "add_" : "", reach_of(&k->y))
                            : NULL;
    if (!w.pipeline)
        return -1;
    struct pass_uniforms *u = begin_pass(fr, &h);
    if (k->level)
        source(u, v);
    else
        layered_source(t, u);
    level_area(fr, v, &h, u);
    set_taps(u, &k->x);
    vk_draw(&fr->b->commands, &h);

    u = begin_pass(fr, &w);
    source(u, v);
    added(u, v);
    level_area(fr, v, &w, u);
    set_taps(u, &k->y);
    for (unsigned c = 0; c < 3; c++)
        u->weight[c] = (float)k->weight;
    vk_draw(&fr->b->commands, &w);
    struct vk_image *free_now = r->sum;
    r->sum = r->next;
    r->next = free_now;
    r->any = true;
    return 0;
}

static int record_up(struct frame *fr, unsigned octave, struct round *r)
{
    struct targets *t = &fr->b->targets;
    struct vk_draw d = { .add = r->sum, .dst = r->next };
    d.pipeline = pipeline_get(fr->b, fr->f, 0, "up_o%u", fr->b->plan->order[octave]);
    if (!d.pipeline)
        return -1;
    struct pass_uniforms *u = begin_pass(fr, &d);
    added(u, &t->level[octave + 1]);
    level_area(fr, &t->level[octave], &d, u);
    vk_draw(&fr->b->commands, &d);
    struct vk_image *free_now = r->sum;
    r->sum = r->next;
    r->next = free_now;
    return 0;
}

// Steps 5 and 6: the Gaussians of each level, coarsest first, each sum doubled into the next finer level.
static int record_spread(struct frame *fr, struct round *r)
{
    const struct plan *p = fr->b->plan;
    const unsigned finest = fr->b->targets.shape.finest;
    unsigned g = p->count;
    for (unsigned level = p->levels;; level--) {
        while (g > 0 && p->gaussian[g - 1].level == level)
            if (record_gaussian(fr, &p->gaussian[--g], r) < 0)
                return -1;
        if (level == finest)
            return 0;
        if (record_up(fr, level - 1, r) < 0)
            return -1;
    }
}

// Step 7.
static int record_composite(struct frame *fr, struct round *r, unsigned order)
{
    struct slot_target *t = fr->target;
    struct targets *pyramid = &fr->b->targets;
    struct vk_draw d = { .add = r->sum };
    d.pipeline = pipeline_get(fr->b, fr->f, 0, "composite_o%u%s", order,
                              t->geometry.type == PIXEL_TYPE_HALF ? "_half" : "");
    if (!d.pipeline)
        return -1;
    struct pass_uniforms *u = begin_pass(fr, &d);
    u->frame[0] = (int32_t)t->geometry.width;
    u->frame[1] = (int32_t)t->geometry.height;
    u->frame[2] = (int32_t)t->groups;
    u->mode[1] = fr->request->params->nonfinite;
    u->weight[3] = (float)fr->request->params->intensity;
    added(u, &pyramid->level[pyramid->shape.finest]);
    input_planes(fr, &d);
    for (unsigned i = 0; i < LEVEL_PHASES; i++)
        d.dst_each[i] = &t->out[i];
    d.area = area_of(t->texels, t->groups * t->geometry.channels);
    d.bands = t->geometry.channels;
    vk_draw(&fr->b->commands, &d);
    return 0;
}

static void record_staging(struct frame *fr, struct bloom_slot *s, bool up)
{
    struct vk_commands *c = &fr->b->commands;
    struct slot_target *t = fr->target;
    const VkDeviceSize row = (VkDeviceSize)t->texels * 16;
    const unsigned n = up ? t->geometry.channels : LEVEL_PHASES;
    for (unsigned i = 0; i < n; i++) {
        struct vk_image *m = up ? &t->in[i] : &t->out[i];
        vk_use(c, m, VK_PIPELINE_STAGE_2_COPY_BIT, up ? VK_ACCESS_2_TRANSFER_WRITE_BIT : VK_ACCESS_2_TRANSFER_READ_BIT,
               up);
        vk_flush_barriers(c);
        const VkBufferImageCopy copy = {
            .bufferOffset = (up ? t->staging_in : t->staging_out) + i * row * m->height,
            .imageSubresource = { VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1 },
            .imageExtent = { m->width, m->height, 1 },
        };
        if (up)
            vkCmdCopyBufferToImage(c->buffer, s->staging.buffer, m->image, VK_IMAGE_LAYOUT_GENERAL, 1, &copy);
        else
            vkCmdCopyImageToBuffer(c->buffer, m->image, VK_IMAGE_LAYOUT_GENERAL, s->staging.buffer, 1, &copy);
    }
}

static int record_frame(struct frame *fr, struct bloom_slot *s)
{
    struct bloom *b = fr->b;
    const struct plan *p = b->plan;
    if (vk_begin(&b->commands, fr->f) < 0)
        return -1;
    b->passes = 0;
    if (b->staged)
        record_staging(fr, s, true);
    const bool fused = !b->targets.shape.full_size;
    if (record_bright(fr, fused ? b->plan->order[0] : 0) < 0)
        return -1;
    for (unsigned i = 0; i < b->octaves; i++)
        if (record_down(fr, i, i < p->levels ? p->order[i] : 4) < 0)
            return -1;
    struct round r = { .sum = &b->targets.pool[0], .rows = &b->targets.pool[1], .next = &b->targets.pool[2] };
    if (record_spread(fr, &r) < 0 || record_composite(fr, &r, b->targets.shape.finest ? p->order[0] : 0) < 0 ||
        ledger_record(&b->commands, &b->ledger, &b->targets, fr->f) < 0)
        return -1;
    if (b->staged)
        record_staging(fr, s, false);
    vk_to_host(&b->commands);
    return 0;
}

/* ---- a frame --------------------------------------------------------------------------------------- */

// Member by member: a struct's padding is nobody's.
static bool same_spec(const struct psf_spec *a, const struct psf_spec *b)
{
    bool same = a->count == b->count;
    for (unsigned i = 0; same && i < a->count; i++)
        same = a->gaussian[i].sigma.value == b->gaussian[i].sigma.value && a->gaussian[i].sigma.unit == b->gaussian[i].sigma.unit &&
               a->gaussian[i].weight == b->gaussian[i].weight;
    return same;
}

static bool answers(const struct planned *e, const struct params *p, const struct bloom_geometry *g, double aspect)
{
    return e->asked && e->width == g->width && e->height == g->height && e->tolerance == p->tolerance &&
           e->aspect == aspect && same_spec(&e->spec, &p->psf_spec);
}

// b->plan: from the cache, or made in the place of the one that nobody has asked for longest.
static int find_plan(struct frame *fr)
{
    struct bloom *b = fr->b;
    const struct params *p = fr->request->params;
    const struct bloom_geometry *g = &fr->target->geometry;
    struct planned *oldest = &b->planned[0];
    b->plans_asked++;
    b->plan = NULL;
    for (unsigned i = 0; i < PLANS_MAX; i++) {
        struct planned *e = &b->planned[i];
        if (answers(e, p, g, fr->request->pixel_aspect)) {
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
    if (plan_make(&oldest->plan, p, g->width, g->height, fr->request->pixel_aspect, fr->f) < 0)
        return -1;
    oldest->asked = b->plans_asked;
    oldest->spec = p->psf_spec;
    oldest->tolerance = p->tolerance;
    oldest->aspect = fr->request->pixel_aspect;
    oldest->width = g->width;
    oldest->height = g->height;
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

static int prepare_plan(struct frame *fr)
{
    struct bloom *b = fr->b;
    const struct bloom_geometry *g = &fr->target->geometry;
    if (find_plan(fr) < 0)
        return -1;
    // With nothing to spread there is nothing to prepare; the caller leaves the frame as it is.
    if (!b->plan->count)
        return 0;
    if (b->prepared == b->plan && b->targets.shape.channels == g->channels)
        return 0;
    b->prepared = NULL;
    b->octaves = octaves_for(b->plan, g->width, g->height);
    const struct targets_shape shape = {
        .width = g->width,
        .height = g->height,
        .channels = g->channels,
        .octaves = b->octaves,
        .full_size = b->plan->full_size,
        .finest = b->plan->full_size ? 0 : 1,
    };
    if (targets_prepare(&b->vk, &b->targets, &shape, fr->f) < 0 ||
        ledger_prepare(&b->ledger, b->plan, &b->targets, fr->f) < 0)
        return -1;
    b->prepared = b->plan;
    return 0;
}

/* The curve's gain at luminance l: monotone, so it bounds a frame, and a tile, from its largest l. */
static double gain_at(const struct frame *fr, double l)
{
    const double t = fr->threshold, k = fr->knee;
    switch (fr->request->params->bright) {
    case BRIGHT_NONE: return 1;
    case BRIGHT_CHANNEL: return l > t ? (l - t) / l : 0;
    case BRIGHT_LUMINANCE:
    case BRIGHT_KNEE: {
        const double s = fmin(fmax(l - t + k, 0), 2 * k);
        return l > 0 ? fmax(k > 0 ? s * s / (4 * k) : 0, fmax(l - t, 0)) / l : 0;
    }
    default: {
        const double lo = t - t * k, hi = t + t * k;
        if (hi <= lo)
            return l > t ? 1 : 0;
        const double x = fmin(fmax((l - lo) / (hi - lo), 0), 1);
        return x * x * (3 - 2 * x);
    }
    }
}

// An upper bound of E where luminance is at most l and every channel at most c. The device's float32 luminance
// may be a few ulp above the scan's: widen before asking.
static double bright_bound(const struct frame *fr, double l, double c)
{
    const double wide = 1 + 0x1p-20;
    const double value = fr->request->params->bright == BRIGHT_CHANNEL ? c : l;
    return c * gain_at(fr, value * wide) * wide;
}

static double bound_of_bits(const struct frame *fr, uint32_t luma, uint32_t channel)
{
    float l, c;
    memcpy(&l, &luma, 4);
    memcpy(&c, &channel, 4);
    return bright_bound(fr, l, c);
}

static void count_tiles(const struct frame *fr, struct bloom_reply *reply)
{
    const struct frame_scan *s = fr->request->scan;
    reply->tiles = s->tiles_x * s->tiles_y;
    reply->max_bright = 0;
    for (uint32_t i = 0; i < reply->tiles; i++) {
        const double e = bound_of_bits(fr, s->tile_luma[i], s->tile_channel[i]);
        reply->tiles_bright += e > 0;
        reply->max_bright = fmax(reply->max_bright, e);
    }
}

static void set_bright(struct frame *fr)
{
    const struct params *p = fr->request->params;
    const double scale = exp2(-p->exposure);
    fr->threshold = p->threshold * scale;
    // METHODS section 1, step 4: the knee shrinks as T nears 0. For smoothstep it is a share of T.
    fr->knee = p->bright == BRIGHT_SMOOTHSTEP  ? p->knee
               : p->bright == BRIGHT_LUMINANCE ? 0
                                               : fmin(p->knee * scale, fr->threshold);
}

// E is a difference: what the luminance, the threshold and their subtraction round off is a share of the
// largest sample, which may be much more than the largest E.
static double bright_rounding(const struct frame *fr, const struct bloom_reply *reply)
{
    if (fr->request->params->bright == BRIGHT_NONE || reply->max_bright == 0)
        return 0;
    return 8 * 0x1p-24 * frame_scan_max_channel(fr->request->scan) / reply->max_bright;
}

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

static bool zeroes_pixels(const struct bloom_request *r)
{
    const struct frame_scan *s = r->scan;
    return r->params->nonfinite == NONFINITE_ZERO && (s->nan || s->positive_inf || s->negative_inf);
}

int bloom_run(struct bloom *b, struct bloom_slot *s, unsigned target, const struct bloom_request *request,
              struct bloom_reply *reply, struct fault *f)
{
    struct frame fr = { .b = b, .target = &s->target[target], .request = request, .f = f };
    struct bloom_reply r = { 0 };
    set_bright(&fr);
    count_tiles(&fr, &r);
    if (prepare_plan(&fr) < 0)
        return -1;
    const bool dark = r.max_bright == 0 || !b->plan->count || request->params->intensity == 0;
    if (dark && !zeroes_pixels(request)) {
        r.untouched = true;
        snprintf(r.plan, sizeof(r.plan), "untouched: %s",
                 r.max_bright == 0 ? "no pixel is above the threshold" : "the glow has no weight");
        snprintf(r.rule, sizeof(r.rule), "-");
        *reply = r;
        return 0;
    }
    if (!b->plan->count)
        return fault_set(f, FAULT_PARAM_CONFLICT, "params.psf",
                         "nonfinite=zero with a psf of no weight: give it a weight above 0");
    const double start = now_ms();
    if (record_frame(&fr, s) < 0 || vk_submit_and_wait(&b->commands, f) < 0)
        return -1;
    r.device_ms = now_ms() - start;
    log_profile(b);
    plan_print(b->plan, r.plan, sizeof(r.plan));
    snprintf(r.rule, sizeof(r.rule), "%s", b->plan->rule);
    r.levels = b->plan->levels;
    r.error_bound = b->plan->filter_bound + b->plan->weight_sum * (b->plan->rounding_bound + bright_rounding(&fr, &r));
    double lost;
    ledger_sum(&b->ledger, b->plan, &b->targets, request->params->intensity, &r.energy_bright, &lost);
    r.energy_lost = lost;
    r.energy_bloomed = request->params->intensity * b->plan->weight_sum * r.energy_bright - lost;
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
    return vk_buffer_reserve(&b->vk, &b->uniforms, (VkDeviceSize)PASSES_MAX * UNIFORM_STRIDE,
                             VK_BUFFER_USAGE_UNIFORM_BUFFER_BIT, f);
}

int bloom_create(struct bloom **out, const struct bloom_options *options, struct fault *f)
{
    struct bloom *b = calloc(1, sizeof(*b));
    if (!b)
        return fault_set(f, FAULT_NO_MEMORY, "", "out of memory");
    b->slots = options->slots < 1 ? 1 : options->slots > 8 ? 8 : options->slots;
    if (open_device(b, options, f) < 0 || bloom_self_test(b, options->warm_all, f) < 0) {
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
    for (unsigned i = 0; i < sizeof(spirv_table) / sizeof(spirv_table[0]); i++)
        if (strcmp(spirv_table[i].name, "fullscreen") != 0)
            *possible += strncmp(spirv_table[i].name, "bright", 6) ? 1 : BRIGHT_SMOOTHSTEP + 1;
    return b->pipelines;
}

void bloom_list_devices(void (*print)(const char *line)) { vk_list(print); }
struct bloom_slot *bloom_slot(struct bloom *b, unsigned i) { return i < b->slots ? &b->slot[i] : NULL; }

/* TEMPORARY (room service, issue 3): the least that bloom_plan can be; the engine's own replaces it. */
int bloom_plan(struct bloom *b, const struct bloom_geometry *geometry, const struct bloom_request *request,
               struct bloom_reply *reply, struct fault *f)
{
    (void)b;
    struct plan p;
    struct bloom_reply r = { 0 };
    if (plan_make(&p, request->params, geometry->width, geometry->height, request->pixel_aspect, f) < 0)
        return -1;
    plan_print(&p, r.plan, sizeof(r.plan));
    snprintf(r.rule, sizeof(r.rule), "%s", p.rule);
    snprintf(r.storage, sizeof(r.storage), "float");
    r.levels = p.levels;
    r.error_bound = p.filter_bound + p.weight_sum * p.rounding_bound;
    r.exposure = request->params->exposure;
    *reply = r;
    return 0;
}
