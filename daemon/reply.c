// SPDX-License-Identifier: Apache-2.0
// reply.c - see reply.h.
#include "reply.h"

#include <string.h>

#include "airy.h"
#include "body.h"

#define SERVER_NAME "airyd/" AIRY_VERSION

// Length of the UTF-8 sequence at s, 0 when it is none (overlong forms and surrogates are none).
static size_t sequence(const unsigned char *s)
{
    if (s[0] < 0x80)
        return 1;
    size_t n = s[0] >= 0xf0 && s[0] <= 0xf4 ? 4 : s[0] >= 0xe0 ? 3 : s[0] >= 0xc2 ? 2 : 0;
    if (s[0] > 0xf4)
        return 0;
    for (size_t i = 1; i < n; i++)
        if ((s[i] & 0xc0) != 0x80)
            return 0;
    if ((s[0] == 0xe0 && s[1] < 0xa0) || (s[0] == 0xed && s[1] > 0x9f) || (s[0] == 0xf0 && s[1] < 0x90) ||
        (s[0] == 0xf4 && s[1] > 0x8f))
        return 0;
    return n;
}

void reply_clean(char *text)
{
    for (unsigned char *s = (unsigned char *)text; *s;) {
        size_t n = sequence(s);
        if (!n)
            *s = '?';
        s += n ? n : 1;
    }
}

static void times(Airy__StageTimes *out, const struct stage_times *t)
{
    airy__stage_times__init(out);
    out->queue = t->queue;
    out->load = t->load;
    out->decode = t->decode;
    out->bloom = t->bloom;
    out->encode = t->encode;
    out->total = t->total;
}

static void device(Airy__Device *out, const struct bloom_device_info *d)
{
    airy__device__init(out);
    out->name = (char *)d->name;
    out->kind = d->cpu ? "cpu" : "gpu";
    out->driver = (char *)d->driver;
}

int reply_welcome(struct conn *c, const struct reply_facts *facts)
{
    static char *features[] = { "exr", "raw", "inline", "memfd", "file", "buffer", "progress",
                                "asset", "plan", "wall", "priority", "deadline" };
    Airy__Welcome w = AIRY__WELCOME__INIT;
    Airy__Limits l = AIRY__LIMITS__INIT;
    Airy__Device d;
    device(&d, &facts->device);
    l.max_frame_bytes = facts->job.max_frame_bytes;
    l.max_width = facts->job.exr.max_width;
    l.max_height = facts->job.exr.max_height;
    l.max_pixels = facts->job.exr.max_pixels;
    l.credit_bytes = facts->credit_bytes;
    l.max_requests = facts->max_requests;
    l.max_body_bytes = WIRE_DATA_BYTES_MAX;
    w.version = WIRE_VERSION;
    w.server = SERVER_NAME;
    w.features = features;
    w.n_features = sizeof features / sizeof features[0];
    w.limits = &l;
    w.device = &d;
    return body_send(c, WIRE_WELCOME, 0, &w.base, NULL, 0);
}

static void memory(Airy__MemoryState *o, const struct reply_memory *m, const struct reply_status *s)
{
    airy__memory_state__init(o);
    o->ceiling = m->ceiling;
    o->reserved = m->reserved;
    o->payloads = s->inline_bytes;
    o->loads = s->sched.load_bytes;
    o->work = s->sched.work_bytes;
    o->work_peak = s->sched.work_peak_bytes;
    o->payloads_max = m->inline_max;
    o->loads_max = m->load_max;
    o->work_max = m->work_max;
}

static void user(Airy__UserState *o, const struct sched_user_facts *u)
{
    airy__user_state__init(o);
    o->uid = u->uid;
    o->connections = u->connections;
    o->requests = u->requests;
    o->queued = u->queued;
    o->running = u->running;
    o->fds = u->fds;
    o->bytes = u->bytes;
    o->device_ms = u->device_ms;
}

struct lists { // of a status; what the message points to
    Airy__UserState user[SCHED_USERS_SHOWN], *users[SCHED_USERS_SHOWN];
    Airy__StageHistogram stage[METRICS_STAGES], *stages[METRICS_STAGES];
};

static void lists(Airy__StatusReply *r, struct lists *l, const struct reply_status *s)
{
    const struct metrics *m = s->metrics;
    for (unsigned i = 0; i < s->n_users; i++) {
        user(&l->user[i], &s->user[i]);
        l->users[i] = &l->user[i];
    }
    for (unsigned i = 0; i < METRICS_STAGES; i++) {
        airy__stage_histogram__init(&l->stage[i]);
        l->stage[i].stage = (char *)metrics_stage_name[i];
        l->stage[i].counts = (uint64_t *)m->histogram[i].count;
        l->stage[i].n_counts = METRICS_BUCKETS + 1;
        l->stage[i].sum_ms = m->histogram[i].sum_ms;
        l->stages[i] = &l->stage[i];
    }
    r->users = l->users;
    r->n_users = s->n_users;
    r->stages = l->stages;
    r->n_stages = METRICS_STAGES;
    r->bucket_ms = (double *)metrics_bucket_ms;
    r->n_bucket_ms = METRICS_BUCKETS;
}

int reply_status(struct conn *c, uint64_t id, const struct reply_facts *facts, const struct reply_status *s)
{
    const struct metrics *m = s->metrics;
    Airy__StatusReply r = AIRY__STATUS_REPLY__INIT;
    Airy__MemoryState mem;
    Airy__StageTimes ms;
    Airy__Device d;
    struct lists l;
    struct stage_times mean = metrics_mean(m);
    device(&d, &facts->device);
    times(&ms, &mean);
    memory(&mem, &facts->memory, s);
    lists(&r, &l, s);
    r.server = SERVER_NAME;
    r.device = &d;
    r.uptime_s = (double)(clock_ns() - m->start_ns) / 1e9;
    r.clients = s->clients;
    r.queued = s->sched.waiting;
    r.running = s->sched.running;
    r.done = m->done;
    r.failed = m->failed;
    r.cancelled = m->cancelled;
    r.pixels = m->pixels;
    r.bytes_in = m->bytes_in;
    r.bytes_out = m->bytes_out;
    r.rss_bytes = metrics_rss_bytes();
    r.mean_ms = &ms;
    r.draining = s->draining;
    r.memory = &mem;
    r.loop_turns = m->loop_turns;
    r.loop_worst_ms = m->loop_worst_ms;
    r.refused_busy = m->refused_busy;
    return body_send(c, WIRE_STATUS_REPLY, id, &r.base, NULL, 0);
}

struct target_body {
    Airy__Target target;
    Airy__Energy energy;
    Airy__NonFinite nonfinite;
};

static void nonfinite(Airy__NonFinite *n, const struct job_target *t)
{
    static const char *const names[] = { "R", "G", "B" };
    airy__non_finite__init(n);
    n->nan = t->nan;
    n->positive_inf = t->positive_inf;
    n->negative_inf = t->negative_inf;
    n->negative = t->negative;
    n->any = t->first_nonfinite != UINT64_MAX;
    if (!n->any)
        return;
    unsigned channel = (unsigned)(t->first_nonfinite & 3);
    n->first_x = (int32_t)((int64_t)t->min_x + (int64_t)(t->first_nonfinite >> 2 & UINT32_MAX));
    n->first_y = (int32_t)((int64_t)t->min_y + (int64_t)(t->first_nonfinite >> 34));
    n->first_channel = (char *)(t->channels == 1 ? "Y" : names[channel < 3 ? channel : 2]);
}

static void target(struct target_body *b, struct job_target *t, bool planned)
{
    Airy__Target *o = &b->target;
    airy__target__init(o);
    airy__energy__init(&b->energy);
    reply_clean(t->name);
    o->name = t->name;
    o->min_x = t->min_x;
    o->min_y = t->min_y;
    o->width = t->width;
    o->height = t->height;
    o->untouched = t->bloom.untouched;
    o->plan = t->bloom.plan;
    o->rule = t->bloom.rule;
    o->levels = t->bloom.levels;
    o->error_bound = t->bloom.error_bound;
    o->max_bright = t->bloom.max_bright;
    o->saturated = t->bloom.saturated;
    o->tiles = t->bloom.tiles;
    o->tiles_bright = t->bloom.tiles_bright;
    b->energy.input = t->energy_input;
    b->energy.bright = t->bloom.energy_bright;
    b->energy.bloomed = t->bloom.energy_bloomed;
    b->energy.lost = t->bloom.energy_lost;
    b->energy.clamped = t->bloom.energy_clamped;
    b->energy.suppressed = t->bloom.energy_suppressed;
    o->skipped = t->bloom.skipped;
    o->storage = t->bloom.storage;
    o->exposure = t->bloom.exposure;
    o->predicted_ms = t->bloom.predicted_ms;
    if (planned) // nothing was looked at
        return;
    o->energy = &b->energy;
    nonfinite(&b->nonfinite, t);
    o->nonfinite = &b->nonfinite;
}

static void output(Airy__Payload *p, const struct job *j)
{
    airy__payload__init(p);
    p->size = j->output.size;
    if (j->output_kind == JOB_OUTPUT_INLINE)
        p->kind = AIRY__PAYLOAD__KIND__INLINE;
    else if (j->output_kind == JOB_OUTPUT_MEMFD)
        p->kind = AIRY__PAYLOAD__KIND__MEMFD;
    else if (j->output_kind == JOB_OUTPUT_BUFFER) // written where it was wanted: as many bytes as came
        p->size = j->input_bytes;
}

int reply_result(struct conn *c, struct job *j, const struct reply_facts *facts)
{
    Airy__Result r = AIRY__RESULT__INIT;
    Airy__Payload out;
    Airy__StageTimes ms;
    struct target_body body[BLOOM_TARGETS_MAX];
    Airy__Target *targets[BLOOM_TARGETS_MAX];
    char *notes[JOB_NOTES_MAX];
    output(&out, j);
    times(&ms, &j->ms);
    // The encoder counts for the whole file; it is said with the file's first target.
    j->scene[0].bloom.saturated += j->counts.saturated;
    for (unsigned i = 0; i < j->n_scenes; i++) {
        target(&body[i], &j->scene[i], j->kind == JOB_PLANS);
        targets[i] = &body[i].target;
    }
    for (unsigned i = 0; i < j->n_notes; i++) {
        reply_clean(j->note[i]);
        notes[i] = j->note[i];
    }
    r.output = &out;
    r.targets = targets;
    r.n_targets = j->n_scenes;
    r.ms = &ms;
    r.device = (char *)facts->device.name;
    r.chunks = j->counts.chunks;
    r.chunks_copied = j->counts.chunks_copied;
    r.notes = notes;
    r.n_notes = j->n_notes;
    r.exposure = j->scene[0].bloom.exposure;
    reply_clean(j->stamp);
    r.stamp = (char *)job_stamp(j);
    Airy__Region need = AIRY__REGION__INIT;
    if (j->of_wall.has_need) {
        need.x = j->of_wall.need[0] + j->of_wall.corner[0];
        need.y = j->of_wall.need[1] + j->of_wall.corner[1];
        need.width = (uint32_t)(j->of_wall.need[2] - j->of_wall.need[0]);
        need.height = (uint32_t)(j->of_wall.need[3] - j->of_wall.need[1]);
        r.need = &need;
    }
    bool memfd = j->output_kind == JOB_OUTPUT_MEMFD;
    int rc = body_send(c, WIRE_RESULT, j->id, &r.base, memfd ? &j->output.fd : NULL, memfd);
    if (rc == 0 && memfd)
        j->output.fd = -1;
    return rc;
}

int reply_kept(struct conn *c, const struct job *j)
{
    Airy__AssetKept k = AIRY__ASSET_KEPT__INIT;
    k.digest = (char *)j->kept.digest;
    k.width = j->kept.width;
    k.height = j->kept.height;
    return body_send(c, WIRE_ASSET_KEPT, j->id, &k.base, NULL, 0);
}

int reply_fault(struct conn *c, uint64_t id, const struct fault *f)
{
    struct fault clean = *f;
    reply_clean(clean.field);
    reply_clean(clean.text);
    return body_send_fault(c, id, &clean);
}

int reply_progress(struct conn *c, uint64_t id, enum job_stage stage)
{
    Airy__Progress p = AIRY__PROGRESS__INIT;
    switch (stage) {
    case JOB_OPEN:
    case JOB_PLAN:
    case JOB_PREPARE:
    case JOB_DECODE:
        p.stage = "decode";
        p.fraction = 0.1;
        break;
    case JOB_BLOOM:
        p.stage = "bloom";
        p.fraction = 0.4;
        break;
    case JOB_BEGIN:
    case JOB_ENCODE:
    case JOB_FINISH:
        p.stage = "encode";
        p.fraction = 0.6;
        break;
    default: p.stage = "queued"; break;
    }
    return body_send(c, WIRE_PROGRESS, id, &p.base, NULL, 0);
}

int reply_credit(struct conn *c, uint64_t bytes)
{
    Airy__Credit r = AIRY__CREDIT__INIT;
    r.bytes = bytes;
    return body_send(c, WIRE_CREDIT, 0, &r.base, NULL, 0);
}
