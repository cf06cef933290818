// SPDX-License-Identifier: Apache-2.0
// job.c - see job.h.
#include "job.h"

#include <assert.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define XXH_INLINE_ALL
#include <xxhash.h>

#include "airy.h"

// METHODS' .2126 .7152 .0722, unrounded: the same weights to the bit as a file without chromaticities gets,
// so that a picture blooms alike raw and as EXR.
static const float rec709[3] = { 0.212639019f, 0.715168655f, 0.0721923187f };
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

// All but what the reply needs.
static void release_work(struct job *j)
{
    exr_close(j->exr);
    j->exr = NULL;
    if (j->raw_scan.tile_luma)
        frame_scan_finish(&j->raw_scan);
    j->raw_scan.tile_luma = NULL;
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

bool job_stage_on_device(enum job_stage s) { return s == JOB_PREPARE || s == JOB_BLOOM; }

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

// The same request on the same bytes has the same stamp: no times, no names of hosts or users.
static void stamp(struct job *j)
{
    XXH128_canonical_t digest;
    XXH128_canonicalFromHash(&digest, XXH3_128bits(j->input.data, j->input.size));
    char hex[2 * sizeof digest.digest + 1];
    for (size_t i = 0; i < sizeof digest.digest; i++)
        snprintf(hex + 2 * i, 3, "%02x", digest.digest[i]);
    char params[JOB_STAMP_MAX - 128];
    int n = params_print(&j->params, params, sizeof params);
    assert(n >= 0 && (size_t)n < sizeof params);
    snprintf(j->stamp, sizeof j->stamp, "airyd %s; params: %s; input xxh3:%s", AIRY_VERSION, params, hex);
    j->exr_options.stamp = j->stamp;
}

static int open_exr(struct job *j, struct fault *f)
{
    stamp(j);
    struct exr_select select = { .part = j->part, .layer = j->layer, .view = j->view };
    if (exr_open(&j->exr, j->input.data, j->input.size, &j->env->limits.exr, &select, &j->exr_options, f) < 0)
        return -1;
    j->n_targets = exr_target_count(j->exr);
    if (j->n_targets > BLOOM_TARGETS_MAX) {
        unsigned n = j->n_targets;
        j->n_targets = 0;
        return fault_set(f, FAULT_LIMIT, "exr.part", "%u layers would be bloomed; at most %d at once: select some",
                         n, BLOOM_TARGETS_MAX);
    }
    return 0;
}

static int open_raw(struct job *j, struct fault *f)
{
    // A file of unstated size is measured only now.
    if (!j->layout.planes && raw_check(&j->layout, j->input.size, f) < 0)
        return -1;
    if (frame_scan_init(&j->raw_scan, j->layout.width, j->layout.height) < 0) {
        j->raw_scan.tile_luma = NULL;
        return fault_set(f, FAULT_NO_MEMORY, "raw", "no memory for the frame's tiles");
    }
    j->n_targets = 1;
    return 0;
}

static int job_open(struct job *j, struct fault *f)
{
    if (load(j, f) < 0)
        return -1;
    j->input_bytes = j->input.size;
    return j->raw ? open_raw(j, f) : open_exr(j, f);
}

unsigned job_geometry(const struct job *j, struct bloom_geometry g[BLOOM_TARGETS_MAX])
{
    if (j->raw) {
        g[0] = (struct bloom_geometry){ j->layout.width, j->layout.height, j->layout.planes, j->layout.type, 0, 1 };
        return 1;
    }
    for (unsigned i = 0; i < j->n_targets; i++) {
        const struct exr_target *t = exr_target(j->exr, i);
        g[i] = (struct bloom_geometry){ t->width, t->height, t->channels, t->type, t->grow,
                                         t->role == EXR_SCENE ? 1 + j->params.layer_count : 0 };
    }
    return j->n_targets;
}

void job_bind(struct job *j, const struct planes *in, const struct planes *out)
{
    if (j->raw) {
        j->raw_in = in[0];
        j->raw_out = out[0];
        return;
    }
    for (unsigned i = 0; i < j->n_targets; i++)
        exr_bind(j->exr, i, &in[i], &out[(size_t)i * BLOOM_OUTPUTS_MAX]);
}

// ---- BLOOM ---------------------------------------------------------------------------------------

static const float *luma_of(const struct job *j) { return j->layout.planes == 3 ? rec709 : alone; }

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
    out->channels = l->planes;
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

static int bloom_target(struct job *j, unsigned i, struct bloom *b, struct bloom_slot *s, struct fault *f)
{
    struct job_target *out = &j->target[i];
    struct exr_target *t = j->raw ? NULL : exr_target(j->exr, i);
    const struct frame_scan *scan = t ? &t->scan : &j->raw_scan;
    if (t)
        describe(out, t);
    else
        describe_raw(out, &j->layout);
    count_samples(out, scan);
    if (j->params.nonfinite == NONFINITE_REJECT && reject_nonfinite(out, f) < 0)
        return -1;
    struct bloom_request request = { .params = &j->params, .scan = scan, .pixel_aspect = 1, .source = -1, .matte = -1, .depth = -1 };
    memcpy(request.luma, t ? t->luma : luma_of(j), sizeof request.luma);
    if (t)
        request.pixel_aspect = t->pixel_aspect;
    if (bloom_run(b, s, i, &request, &out->bloom, f) < 0)
        return -1;
    j->untouched[i] = out->bloom.untouched;
    j->ms.bloom += out->bloom.device_ms;
    return 0;
}

int job_bloom(struct job *j, struct bloom *b, struct bloom_slot *s, struct fault *f)
{
    j->ms.bloom = 0;
    for (unsigned i = 0; i < j->n_targets && !j->cancel; i++)
        if (bloom_target(j, i, b, s, f) < 0)
            return -1;
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
    const struct planes *from = j->untouched[0] ? &j->raw_in : &j->raw_out;
    j->raw_saturated += raw_encode(&j->layout, j->input.data, from, j->output.data, task);
    return 0;
}

static int job_decode(struct job *j, unsigned task, struct exr_worker *w, struct fault *f)
{
    if (!j->raw)
        return exr_decode(j->exr, task, w, f);
    raw_decode(&j->layout, j->input.data, &j->raw_in, &j->raw_scan, luma_of(j), task);
    return 0;
}

// ---- FINISH ----------------------------------------------------------------------------------------

static int write_block(void *ctx, const void *data, size_t len)
{
    struct payload *p = ctx;
    if (len > p->block->bytes - p->size)
        return -ENOSPC;
    memcpy(p->block->data + p->size, data, len);
    p->size += len;
    return 0;
}

static int write_fd(void *ctx, const void *data, size_t len)
{
    struct payload *p = ctx;
    for (size_t done = 0; done < len;) {
        ssize_t n = write(p->fd, (const char *)data + done, len - done);
        if (n < 0 && errno == EINTR)
            continue;
        if (n <= 0)
            return n < 0 ? -errno : -EIO;
        done += (size_t)n;
        p->size += (uint64_t)n;
    }
    return 0;
}

static int finish_exr(struct job *j, struct fault *f)
{
    struct payload *p = &j->output;
    uint64_t size = exr_assembled_bytes(j->exr), limit = j->env->limits.max_frame_bytes;
    if (size > limit)
        return fault_set(f, FAULT_LIMIT, "output.size", "the result has %llu bytes; at most %llu are sent",
                         (unsigned long long)size, (unsigned long long)limit);
    if (j->output_kind == JOB_OUTPUT_MEMFD) {
        if (payload_new_memfd(p, f) < 0 || exr_assemble(j->exr, write_fd, p, f) < 0)
            return -1;
    } else if (take_block(j, size, f) < 0 || exr_assemble(j->exr, write_block, p, f) < 0) {
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
    case JOB_OPEN: return job_open(j, f);
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
    if (j->raw_scan.tile_luma)
        frame_scan_finish(&j->raw_scan);
    j->raw_scan.tile_luma = NULL;
    j->n_targets = 0;
}
