// SPDX-License-Identifier: Apache-2.0
// job.c - see job.h.
#include "job.h"

#include <assert.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "airy.h"

static const float alone[3] = { 1, 0, 0 };

struct job *job_create(const struct job_env *env)
{
    struct job *j = calloc(1, sizeof *j);
    if (!j)
        return NULL;
    j->env = env;
    j->input = j->output = (struct payload)PAYLOAD_INIT;
    j->progress_sent = -1;
    params_init(&j->params);
    return j;
}

static void scan_clear(struct frame_scan *s)
{
    if (s->tile_luma)
        frame_scan_finish(s);
    s->tile_luma = NULL;
}

// All but what the reply needs.
static void release_work(struct job *j)
{
    exr_close(j->exr);
    j->exr = NULL;
    for (unsigned i = 0; i < RAW_ROLES; i++)
        scan_clear(&j->raw_scan[i]);
    asset_release(j->env->assets, j->dirt);
    asset_release(j->env->assets, j->kernel);
    j->dirt = j->kernel = NULL;
    job_wall_release(j);
    payload_finish(&j->input, j->env->blocks);
}

void job_destroy(struct job *j)
{
    if (!j)
        return;
    release_work(j);
    payload_finish(&j->output, j->env->blocks);
    free(j);
}

bool job_stage_on_device(enum job_stage s) { return s == JOB_PLAN || s == JOB_PREPARE || s == JOB_BLOOM; }

unsigned job_tasks(const struct job *j)
{
    switch ((enum job_stage)j->stage) {
    case JOB_DECODE: return j->raw ? raw_tasks(&j->layout) : exr_decode_tasks(j->exr);
    case JOB_ENCODE: return j->raw ? raw_tasks(&j->layout) : exr_encode_tasks(j->exr);
    default: return 1;
    }
}

// ---- OPEN ----------------------------------------------------------------------------------------

// EXR bytes are parsed more than once, so they are copied to where nobody can change them.
static int load(struct job *j, struct fault *f)
{
    struct payload *p = &j->input;
    if (p->data)
        return 0;
    if (p->kind == PAYLOAD_INLINE) {
        p->data = p->block->data;
        return 0;
    }
    uint64_t from = clock_ns();
    int rc = j->raw && p->kind == PAYLOAD_MEMFD
                 ? payload_map(p, false, "input", f)
                 : payload_load(p, j->env->blocks, j->env->limits.max_frame_bytes, f);
    j->ms.load = (double)(clock_ns() - from) / 1e6;
    return rc;
}

// What chooses the pixels and how they are stored, beside the parameters: a run on another layer is another request.
static void choice_digest(const struct job *j, char hex[ASSET_DIGEST_MAX])
{
    char text[sizeof j->part + sizeof j->layer + sizeof j->view + 64] = { 0 };
    size_t n = 0;
    n += strlen(strcpy(text + n, j->part)) + 1; // the zeros keep the names apart
    n += strlen(strcpy(text + n, j->layer)) + 1;
    n += strlen(strcpy(text + n, j->view)) + 1;
    n += (size_t)snprintf(text + n, sizeof text - n, "%d %d", (int)j->exr_options.pixels, j->exr_options.compression);
    asset_digest(hex, text, n);
}

// The same request on the same bytes has the same stamp: no times, no names of hosts or users.
static void stamp(struct job *j)
{
    char hex[ASSET_DIGEST_MAX], choice[ASSET_DIGEST_MAX], params[PARAMS_LINE_MAX];
    asset_digest(hex, j->input.data, j->input.size);
    choice_digest(j, choice);
    int n = params_print(&j->params, params, sizeof params);
    assert(n >= 0 && (size_t)n < sizeof params);
    (void)n;
    snprintf(j->stamp, sizeof j->stamp, "airyd %s; params: %s; choice xxh3:%s; input xxh3:%s", AIRY_VERSION, params,
             choice, hex);
    j->exr_options.stamp = j->stamp;
}

// The width by which the target's window grows: capped by what any frame may have. 0, or -1 and *f.
static int grow_read(const struct job *j, struct exr_target *t, struct fault *f)
{
    const struct exr_limits *l = &j->env->limits.exr;
    double pixels = ceil(params_pixels(&j->params, &j->params.grow_size, t->width, t->height,
                                       t->display_width ? t->display_width : t->width, t->pixel_aspect));
    if (!(pixels > 0))
        return 0;
    uint64_t n = pixels < 1e9 ? (uint64_t)pixels : UINT64_C(1000000000);
    uint64_t width = t->width + 2 * n, height = t->height + 2 * n;
    if (width > l->max_width || height > l->max_height || width * height > l->max_pixels)
        return fault_set(f, FAULT_PARAM_RANGE, "params.grow",
                         "%.0f pixels on each side make %.80s %llu x %llu; at most %u x %u and %llu pixels are taken",
                         pixels, t->name, (unsigned long long)width, (unsigned long long)height, l->max_width,
                         l->max_height, (unsigned long long)l->max_pixels);
    int64_t right = (int64_t)t->min_x + t->width - 1, bottom = (int64_t)t->min_y + t->height - 1;
    if (t->min_x - (int64_t)n < INT32_MIN || t->min_y - (int64_t)n < INT32_MIN || right + (int64_t)n > INT32_MAX ||
        bottom + (int64_t)n > INT32_MAX)
        return fault_set(f, FAULT_PARAM_RANGE, "params.grow",
                         "%llu pixels on each side take the data window of %.80s beyond what a file can say",
                         (unsigned long long)n, t->name);
    t->grow = (uint32_t)n;
    return 0;
}

// Extra layers and grown windows multiply what one small file asks for: held to what decoded files are.
static int output_check(const struct job *j, struct fault *f)
{
    uint64_t bytes = 0, max = j->env->limits.exr.max_decoded_bytes;
    for (unsigned i = 0; i < j->n_targets; i++) {
        const struct exr_target *t = exr_target(j->exr, i);
        if (t->role == EXR_SCENE) // each factor is within the reader's limits: below 2^60 a target
            bytes += ((uint64_t)t->width + 2 * t->grow) * ((uint64_t)t->height + 2 * t->grow) * t->channels *
                     pixel_bytes(t->type) * (1 + j->params.layer_count);
    }
    bool asked = j->params.layer_count || j->params.grow_size.value > 0;
    if (!asked || bytes <= max)
        return 0;
    return fault_set(f, FAULT_LIMIT, j->params.layer_count ? "params.layers" : "params.grow",
                     "the pixels of the result are %llu bytes; at most %llu are made", (unsigned long long)bytes,
                     (unsigned long long)max);
}

static int open_targets(struct job *j, struct fault *f)
{
    unsigned n = exr_target_count(j->exr);
    if (n > BLOOM_TARGETS_MAX)
        return fault_set(f, FAULT_LIMIT, "exr.part",
                         "%u layers would be bloomed or read for it; at most %d at once: select some", n,
                         BLOOM_TARGETS_MAX);
    j->n_targets = n;
    if (j->wall)
        return 0;
    for (unsigned i = 0; i < n; i++)
        if (grow_read(j, exr_target(j->exr, i), f) < 0)
            return -1;
    return exr_grow_check(j->exr, f) < 0 ? -1 : output_check(j, f);
}

static int open_exr(struct job *j, struct fault *f)
{
    if (!j->wall)
        stamp(j);
    struct exr_select select = { .part = j->part,
                                 .layer = j->layer,
                                 .view = j->view,
                                 .source = j->params.source,
                                 .matte = j->params.matte,
                                 .depth = j->params.sun_spec.given };
    j->exr_options.extras = j->params.layer_count;
    for (unsigned i = 0; i < j->params.layer_count; i++) {
        params_view_name(&j->params.layer[i], j->extra_name[i]);
        j->exr_options.extra_name[i] = j->extra_name[i];
    }
    if (exr_open(&j->exr, j->input.data, j->input.size, &j->env->limits.exr, &select, &j->exr_options, f) < 0)
        return -1;
    return open_targets(j, f);
}

static int scan_make(struct frame_scan *s, const struct raw_layout *l, struct fault *f)
{
    if (frame_scan_init(s, l->width, l->height) == 0)
        return 0;
    s->tile_luma = NULL;
    return fault_set(f, FAULT_NO_MEMORY, "raw", "no memory for the frame's tiles");
}

static int open_raw(struct job *j, struct fault *f)
{
    struct raw_layout *l = &j->layout;
    // A file of unstated size is measured only now.
    if (!l->targets && raw_check(l, j->input.size, f) < 0)
        return -1;
    j->n_targets = l->targets;
    if (j->wall) // of the part that it needs
        return 0;
    for (unsigned i = 0; i < l->targets; i++)
        if (l->target[i].role != RAW_DEPTH && scan_make(&j->raw_scan[i], l, f) < 0)
            return -1;
    return 0;
}

static int keep(struct job *j, struct exr_worker *w, struct fault *f)
{
    struct asset *a = NULL;
    if (asset_keep(j->env->assets, j->input.data, j->input.size, &j->env->limits.exr, w, &j->cancel, &a, f) < 0)
        return -1;
    if (a) {
        j->kept = a->image;
        j->kept.rgb = NULL;
    }
    asset_release(j->env->assets, a);
    return 0;
}

static int job_open(struct job *j, struct exr_worker *w, struct fault *f)
{
    if (load(j, f) < 0)
        return -1;
    j->input_bytes = j->input.size;
    if (j->kind == JOB_KEEPS)
        return keep(j, w, f);
    if ((j->raw ? open_raw(j, f) : open_exr(j, f)) < 0)
        return -1;
    return j->wall ? job_wall_open(j, f) : 0;
}

unsigned job_geometry(const struct job *j, struct bloom_geometry g[BLOOM_TARGETS_MAX])
{
    const struct raw_layout *l = &j->layout;
    const unsigned pictures = j->wall && bloom_wall_is_direct(&j->params) ? 0 : 1;
    for (unsigned i = 0; i < j->n_targets; i++) {
        if (j->raw) {
            const struct raw_target *t = &l->target[i];
            g[i] = (struct bloom_geometry){ l->width, l->height, t->planes, t->type, 0, t->role == RAW_SCENE ? pictures : 0 };
            continue;
        }
        const struct exr_target *t = exr_target(j->exr, i);
        g[i] = (struct bloom_geometry){ t->width, t->height, t->channels, t->type, t->grow,
                                        t->role == EXR_SCENE ? pictures + j->params.layer_count : 0 };
    }
    return j->n_targets;
}

// Of a wall the drive; a raw result is as large as what came; of an EXR file what is unpacked, packed and put together.
uint64_t job_work_bytes(const struct job *j)
{
    if (j->wall)
        return (uint64_t)j->of_wall.geometry.width * j->of_wall.geometry.height * 12 + (j->raw ? 0 : exr_work_bytes(j->exr));
    if (!j->raw)
        return exr_work_bytes(j->exr);
    return j->output_kind == JOB_OUTPUT_BUFFER ? 0 : j->input.size;
}

static bool is_scene(const struct job *j, unsigned i)
{
    return j->raw ? j->layout.target[i].role == RAW_SCENE : exr_target(j->exr, i)->role == EXR_SCENE;
}

void job_keep_bytes(const struct job *j, unsigned threads, uint64_t bytes[BLOOM_KEEPS])
{
    struct bloom_geometry g[BLOOM_TARGETS_MAX];
    const unsigned n = job_geometry(j, g);
    memset(bytes, 0, BLOOM_KEEPS * sizeof *bytes);
    for (unsigned i = 0; i < n; i++) {
        if (!is_scene(j, i))
            continue;
        const struct exr_target *t = j->raw ? NULL : exr_target(j->exr, i);
        const struct bloom_keep_facts facts = { .params = &j->params,
                                                .pixel_aspect = t ? (double)t->pixel_aspect : 1,
                                                .display_width = t ? t->display_width : g[i].width,
                                                .matte = *j->params.matte,
                                                .dirt = j->dirt ? &j->dirt->image : NULL,
                                                .kernel = j->kernel ? &j->kernel->image : NULL,
                                                .threads = threads };
        uint64_t of[BLOOM_KEEPS];
        bloom_keep_bytes(&facts, 1, &g[i], of);
        for (unsigned k = 0; k < BLOOM_KEEPS; k++)
            bytes[k] = of[k] > bytes[k] ? of[k] : bytes[k];
    }
}

void job_bind(struct job *j, const struct planes *in, const struct planes *out)
{
    if (j->raw) {
        memcpy(j->raw_in, in, j->n_targets * sizeof *in);
        j->raw_out = out[0];
        return;
    }
    for (unsigned i = 0; i < j->n_targets; i++)
        exr_bind(j->exr, i, &in[i], &out[(size_t)i * BLOOM_OUTPUTS_MAX]);
}

// ---- PLAN, BLOOM -----------------------------------------------------------------------------------

static const float *luma_of(const struct job *j) { return j->layout.target[0].planes == 3 ? frame_rec709 : alone; }

static const char *channel_name(const struct job_target *t, unsigned c)
{
    static const char *const names[] = { "R", "G", "B" };
    return t->channels == 1 ? "Y" : names[c < 3 ? c : 2];
}

static void describe(struct job_target *out, const struct exr_target *t)
{
    snprintf(out->name, sizeof out->name, "%s", t->name);
    out->min_x = t->min_x;
    out->min_y = t->min_y;
    out->width = t->width;
    out->height = t->height;
    out->channels = t->channels;
}

static void describe_raw(struct job_target *out, const struct raw_layout *l)
{
    snprintf(out->name, sizeof out->name, "beauty");
    out->width = l->width;
    out->height = l->height;
    out->channels = l->target[0].planes;
}

static void count_samples(struct job_target *out, const struct frame_scan *s)
{
    out->energy_input = frame_scan_sum(s);
    out->nan = s->nan;
    out->positive_inf = s->positive_inf;
    out->negative_inf = s->negative_inf;
    out->negative = s->negative;
    out->first_nonfinite = s->first_nonfinite;
}

static int reject_nonfinite(const struct job_target *t, struct fault *f)
{
    uint64_t bad = t->nan + t->positive_inf + t->negative_inf;
    if (!bad)
        return 0;
    uint64_t at = t->first_nonfinite;
    return fault_set(f, FAULT_NONFINITE, "params.nonfinite",
                     "%.80s: %llu NaN or Inf samples, the first at x %lld, y %lld in channel %s", t->name,
                     (unsigned long long)bad, (long long)t->min_x + (long long)(at >> 2 & UINT32_MAX),
                     (long long)t->min_y + (long long)(at >> 34), channel_name(t, (unsigned)(at & 3)));
}

static void request_raw(const struct job *j, struct bloom_request *r)
{
    const struct raw_layout *l = &j->layout;
    r->scan = &j->raw_scan[0];
    r->source = raw_find(l, RAW_SOURCE);
    r->source_scan = r->source >= 0 ? &j->raw_scan[r->source] : NULL;
    r->matte = raw_find(l, RAW_MATTE);
    r->matte_scan = r->matte >= 0 ? &j->raw_scan[r->matte] : NULL;
    r->depth = raw_find(l, RAW_DEPTH);
    memcpy(r->luma, luma_of(j), sizeof r->luma);
    r->pixel_aspect = 1;
    r->display_width = j->walled ? j->of_wall.frame_width : l->width;
}

// The index of what was asked for, when the reader has made it a target of that role; else -1.
static int other_target(const struct job *j, int index, enum exr_role role)
{
    if (index < 0 || (unsigned)index >= j->n_targets || exr_target(j->exr, (unsigned)index)->role != role)
        return -1;
    return index;
}

static int request_exr(const struct job *j, const struct exr_target *t, struct bloom_request *r, struct fault *f)
{
    r->scan = &t->scan;
    r->source = other_target(j, t->source, EXR_SOURCE);
    r->source_scan = r->source >= 0 ? &exr_target(j->exr, (unsigned)r->source)->scan : NULL;
    r->matte = other_target(j, t->matte, EXR_MATTE);
    r->matte_scan = r->matte >= 0 ? &exr_target(j->exr, (unsigned)r->matte)->scan : NULL;
    r->depth = other_target(j, t->depth, EXR_DEPTH);
    memcpy(r->luma, t->luma, sizeof r->luma);
    r->pixel_aspect = t->pixel_aspect;
    r->display_width = t->display_width;
    // A glow from elsewhere than was said would be worse than none.
    if ((*j->params.source && r->source < 0) || (*j->params.matte && r->matte < 0))
        return fault_set(f, FAULT_INTERNAL, *j->params.source && r->source < 0 ? "params.source" : "params.matte",
                         "%.80s: the reader gave nothing for it", t->name);
    return 0;
}

// Target i, which is a scene, as the next of the reply's.
static int scene_begin(struct job *j, unsigned i, struct bloom_request *r, struct job_target **out, struct fault *f)
{
    *r = (struct bloom_request){ .params = &j->params,
                                 .dirt = j->dirt ? &j->dirt->image : NULL,
                                 .kernel = j->kernel ? &j->kernel->image : NULL };
    *out = &j->scene[j->n_scenes++];
    memset(*out, 0, sizeof **out);
    if (j->raw) {
        request_raw(j, r);
        describe_raw(*out, &j->layout);
        return 0;
    }
    const struct exr_target *t = exr_target(j->exr, i);
    describe(*out, t);
    return request_exr(j, t, r, f);
}

static int bloom_scene(struct job *j, unsigned i, struct bloom *b, struct bloom_slot *s, struct fault *f)
{
    struct bloom_request request;
    struct bloom_wall wall;
    struct bloom_adapt adapt;
    struct job_target *out;
    if (scene_begin(j, i, &request, &out, f) < 0)
        return -1;
    count_samples(out, request.scan);
    if (j->params.nonfinite == NONFINITE_REJECT && reject_nonfinite(out, f) < 0)
        return -1;
    if (j->wall && job_wall_begin(j, &wall, &adapt, f) < 0)
        return -1;
    request.wall = j->wall ? &wall : NULL;
    if (bloom_run(b, s, i, &request, &out->bloom, f) < 0)
        return -1;
    if (j->wall)
        job_wall_end(j, &adapt, &out->bloom);
    j->untouched[i] = out->bloom.untouched;
    j->ms.bloom += out->bloom.device_ms;
    return 0;
}

int job_bloom(struct job *j, struct bloom *b, struct bloom_slot *s, struct fault *f)
{
    j->ms.bloom = 0;
    j->n_scenes = 0;
    for (unsigned i = 0; i < j->n_targets && !j->cancel; i++) {
        j->untouched[i] = true;
        // A wall shows one picture.
        if (is_scene(j, i) && !(j->wall && j->n_scenes) && bloom_scene(j, i, b, s, f) < 0)
            return -1;
    }
    return 0;
}

// Parameters that leave nothing to plan for.
static bool plan_is_nothing(const struct params *p, struct bloom_reply *r)
{
    if (p->bloom == SWITCH_ON && p->intensity > 0)
        return false;
    snprintf(r->plan, sizeof r->plan, "no glow: %s", p->bloom == SWITCH_OFF ? "bloom=off" : "intensity=0");
    snprintf(r->rule, sizeof r->rule, "-");
    r->exposure = p->exposure_auto ? 0 : p->exposure;
    return true;
}

// Nothing is decoded: the request has no scans.
int job_plan(struct job *j, struct bloom *b, struct fault *f)
{
    struct bloom_geometry g[BLOOM_TARGETS_MAX];
    if (j->wall && job_wall_plan(j, b, f) < 0)
        return -1;
    if (j->kind != JOB_PLANS)
        return 0;
    job_geometry(j, g);
    j->n_scenes = 0;
    for (unsigned i = 0; i < j->n_targets && !j->cancel; i++) {
        struct bloom_request request;
        struct job_target *out;
        if (!is_scene(j, i))
            continue;
        if (scene_begin(j, i, &request, &out, f) < 0)
            return -1;
        if (plan_is_nothing(&j->params, &out->bloom))
            continue;
        request.scan = request.source_scan = request.matte_scan = NULL;
        if (bloom_plan(b, &g[i], &request, &out->bloom, f) < 0)
            return -1;
    }
    return 0;
}

// ---- BEGIN, ENCODE ---------------------------------------------------------------------------------

static int take_block(struct job *j, uint64_t size, struct fault *f)
{
    struct payload *p = &j->output;
    p->kind = PAYLOAD_INLINE;
    p->block = block_take(j->env->blocks, size);
    if (!p->block)
        return fault_set(f, FAULT_NO_MEMORY, "output", "no memory for %llu bytes", (unsigned long long)size);
    p->data = p->block->data;
    return 0;
}

static int place_raw(struct job *j, struct fault *f)
{
    struct payload *p = &j->output;
    uint64_t size = j->input.size;
    switch (j->output_kind) {
    case JOB_OUTPUT_BUFFER: return payload_map(p, true, "output", f);
    case JOB_OUTPUT_MEMFD: return payload_new_memfd(p, f) < 0 ? -1 : payload_reserve(p, size, f);
    default: p->size = size; return take_block(j, size, f);
    }
}

// May come twice, when the device was lost in between: what is there already is used again.
static int begin_raw(struct job *j, struct fault *f)
{
    j->raw_saturated = 0;
    if (j->output.data)
        return 0;
    if (place_raw(j, f) < 0)
        return -1;
    // The bytes between the channels come back as they came (and a used block holds what others sent).
    if (!j->layout.dense)
        memmove(j->output.data, j->input.data, j->input.size);
    return 0;
}

static int job_begin(struct job *j, struct fault *f)
{
    return j->raw ? begin_raw(j, f) : exr_encode_begin(j->exr, j->untouched, f);
}

static int job_encode(struct job *j, unsigned task, struct exr_worker *w, struct fault *f)
{
    if (!j->raw)
        return exr_encode(j->exr, task, w, f);
    const struct planes *from = j->untouched[0] ? &j->raw_in[0] : &j->raw_out;
    j->raw_saturated += raw_encode(&j->layout, j->input.data, from, j->output.data, task);
    return 0;
}

static int job_decode(struct job *j, unsigned task, struct exr_worker *w, struct fault *f)
{
    if (!j->raw)
        return exr_decode(j->exr, task, w, f);
    for (unsigned i = 0; i < j->n_targets; i++) {
        const struct raw_target *t = &j->layout.target[i];
        const float *luma = t->planes == 3 ? frame_rec709 : alone;
        struct frame_scan *scan = t->role == RAW_DEPTH ? NULL : &j->raw_scan[i];
        raw_decode(&j->layout, t, j->input.data, &j->raw_in[i], scan, luma, task);
    }
    return 0;
}

// ---- FINISH ----------------------------------------------------------------------------------------

static int write_block(void *ctx, const void *data, size_t len)
{
    struct payload *p = ctx;
    if (len > p->block->bytes - p->size)
        return -EOVERFLOW;
    memcpy(p->block->data + p->size, data, len);
    p->size += len;
    return 0;
}

static int write_fd(void *ctx, const void *data, size_t len) { return payload_write(ctx, data, len); }

// Nothing was asked for that changes a byte: the result is the file that came, without a stamp.
static bool hands_on(const struct job *j)
{
    const struct params *p = &j->params;
    return p->bloom == SWITCH_OFF && !*p->matte && p->display == DISPLAY_NONE && p->saturation == 1 &&
           p->encoding == ENCODING_LINEAR && p->view_spec.view == VIEW_FINAL && !p->layer_count &&
           p->nonfinite != NONFINITE_ZERO && !(p->grow_size.value > 0) && j->exr_options.compression == EXR_KEEP &&
           j->exr_options.pixels == EXR_PIXELS_KEEP;
}

const char *job_stamp(const struct job *j)
{
    return j->raw || j->walled || hands_on(j) ? "" : j->stamp;
}

static int assemble(struct job *j, int (*to)(void *ctx, const void *data, size_t len), struct fault *f)
{
    if (!hands_on(j))
        return exr_assemble(j->exr, to, &j->output, f);
    int rc = to(&j->output, j->input.data, j->input.size);
    return rc < 0 ? fault_set(f, FAULT_NO_MEMORY, "output", "the result cannot be written: %s", strerror(-rc)) : 0;
}

static int finish_exr(struct job *j, struct fault *f)
{
    struct payload *p = &j->output;
    uint64_t size = hands_on(j) ? j->input.size : exr_assembled_bytes(j->exr), limit = j->env->limits.max_frame_bytes;
    if (size > limit)
        return fault_set(f, FAULT_LIMIT, "output.size", "the result has %llu bytes; at most %llu are sent",
                         (unsigned long long)size, (unsigned long long)limit);
    if (j->output_kind == JOB_OUTPUT_MEMFD) {
        if (payload_new_memfd(p, f) < 0 || assemble(j, write_fd, f) < 0)
            return -1;
    } else if (take_block(j, size, f) < 0 || assemble(j, write_block, f) < 0) {
        return -1;
    }
    if (p->size != size)
        return fault_set(f, FAULT_INTERNAL, "output.size", "assembled %llu bytes; expected %llu",
                         (unsigned long long)p->size, (unsigned long long)size);
    j->counts = exr_counts(j->exr);
    for (unsigned i = 0; i < exr_note_count(j->exr) && i < JOB_NOTES_MAX; i++)
        snprintf(j->note[j->n_notes++], JOB_NOTE_MAX, "%s", exr_note(j->exr, i));
    return 0;
}

static int finish_output(struct job *j, struct fault *f)
{
    if (j->kind != JOB_BLOOMS)
        return 0;
    if (j->wall)
        return job_wall_finish(j, f);
    if (j->raw)
        j->counts.saturated = j->raw_saturated;
    else if (finish_exr(j, f) < 0)
        return -1;
    if (j->output_kind == JOB_OUTPUT_MEMFD)
        return payload_seal(&j->output, f);
    if (j->output_kind == JOB_OUTPUT_BUFFER)
        payload_finish(&j->output, j->env->blocks);
    return 0;
}

static int job_finish(struct job *j, struct fault *f)
{
    int rc = 0;
    bool ended = j->fault.code != FAULT_NONE || j->cancel;
    if (!ended)
        rc = finish_output(j, f);
    if (ended || rc < 0)
        payload_finish(&j->output, j->env->blocks);
    else
        j->finished = true;
    release_work(j);
    return rc;
}

int job_task(struct job *j, unsigned task, struct exr_worker *w, struct fault *f)
{
    switch ((enum job_stage)j->stage) {
    case JOB_OPEN: return job_open(j, w, f);
    case JOB_DECODE: return job_decode(j, task, w, f);
    case JOB_BEGIN: return job_begin(j, f);
    case JOB_ENCODE: return job_encode(j, task, w, f);
    case JOB_FINISH: return job_finish(j, f);
    default: assert(!"a stage of the pool"); return -1;
    }
}

void job_rewind(struct job *j)
{
    exr_close(j->exr);
    j->exr = NULL;
    for (unsigned i = 0; i < RAW_ROLES; i++)
        scan_clear(&j->raw_scan[i]);
    j->n_targets = j->n_scenes = 0;
    if (j->wall)
        job_wall_rewind(j);
}

void job_unload(struct job *j)
{
    struct payload *p = &j->input;
    job_rewind(j);
    j->ms.load = j->ms.decode = 0;
    if (p->kind == PAYLOAD_INLINE || !p->block)
        return;
    block_give(j->env->blocks, p->block);
    p->block = NULL;
    p->data = NULL;
}
