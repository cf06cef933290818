// SPDX-License-Identifier: Apache-2.0
/*
 * client_ask.c - BLOOM and ASSET: what is refused at the door, in which order, and how a request becomes a job. Nothing is
 * allocated for its pixels before every limit has been asked, and whatever is refused says what was found and what is allowed.
 */
#include "client_private.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <sys/stat.h>

#include "request.h"

enum { RETRY_MIN_MS = 20, RETRY_MAX_MS = 60000 };

int client_busy(const struct client_host *h, struct fault *f, const char *what, uint64_t found, uint64_t limit)
{
    fault_set(f, FAULT_BUSY, "", "%s: %" PRIu64 " of %" PRIu64 "; try again", what, found, limit);
    struct sched_counts counts = sched_counts(h->sched);
    double each = metrics_mean(&h->metrics).total, wait = each * (counts.waiting + 1) / 2;
    f->retry_after_ms = wait > RETRY_MAX_MS ? RETRY_MAX_MS : wait < RETRY_MIN_MS ? RETRY_MIN_MS : (uint32_t)wait;
    f->queue_position = counts.waiting + 1;
    return -1;
}

// What is judged before the request itself: the connection's and the daemon's room.
static int admit(struct client *c, uint64_t id, uint64_t bytes, bool is_inline, struct fault *f)
{
    const struct client_host *h = c->host;
    if (h->draining)
        return fault_set(f, FAULT_SHUTTING_DOWN, "", "the daemon is stopping");
    if (client_job_find(c, id))
        return fault_set(f, FAULT_DUPLICATE_ID, "id", "request %" PRIu64 " is still in flight", id);
    if (bytes > h->facts.job.max_frame_bytes)
        return fault_set(f, FAULT_LIMIT, "input.size", "%" PRIu64 " bytes; at most %" PRIu64 " are taken", bytes,
                         h->facts.job.max_frame_bytes);
    if (bytes > c->credit_left)
        return client_busy(h, f, "credit exceeded, payload bytes in flight on this connection",
                    h->facts.credit_bytes - c->credit_left + bytes, h->facts.credit_bytes);
    if (c->n_requests >= h->facts.max_requests)
        return client_busy(h, f, "requests in flight on this connection", c->n_requests, h->facts.max_requests);
    if (h->jobs >= h->jobs_max)
        return client_busy(h, f, "requests in the daemon", h->jobs, h->jobs_max);
    if (is_inline && h->held_bytes + bytes > h->held_bytes_max) // both far below 2^63
        return client_busy(h, f, "payload bytes in the daemon", h->held_bytes + bytes, h->held_bytes_max);
    return 0;
}

// Whose request it is, and whether that user may have one more.
static int hold(struct client *c, struct job *j, uint64_t inline_bytes, unsigned fds, struct fault *f)
{
    struct sched_refusal r;
    if (sched_hold(c->host->sched, &c->flow, j, inline_bytes, fds, &r))
        return 0;
    if (r.verdict == SCHED_BUSY)
        return client_busy(c->host, f, r.what, r.found, r.allowed);
    return fault_set(f, FAULT_LIMIT, "input.size", "%s: %" PRIu64 "; at most %" PRIu64 " are taken", r.what, r.found,
                     r.allowed);
}

// A file of unstated size is as large as it is now: memory is reckoned with it before it is read. Asked of what the kernel knows: never
// blocks. What is no plain file is refused where it is read.
static void measure(struct payload *p)
{
    struct statx st;
    if (p->kind != PAYLOAD_FILE || p->size || statx(p->fd, "", AT_EMPTY_PATH | AT_STATX_DONT_SYNC, STATX_SIZE | STATX_TYPE, &st) < 0)
        return;
    if (S_ISREG(st.stx_mode) && st.stx_size > p->offset)
        p->size = st.stx_size - p->offset;
}

// What is known of its size before it is opened can be too much for good.
static int fits(struct client *c, struct job *j, struct fault *f)
{
    uint64_t bytes;
    measure(&j->input);
    if (j->kind != JOB_BLOOMS || !j->raw || j->wall || !j->layout.targets)
        return 0;
    j->n_targets = j->layout.targets;
    bool can = sched_fits(c->host->sched, j, &bytes);
    j->n_targets = 0;
    return can ? 0
               : fault_set(f, FAULT_LIMIT, "raw", "%" PRIu64 " bytes of memory for this frame; at most %" PRIu64 " are taken",
                           bytes, c->host->facts.memory.work_max);
}

static int start(struct client *c, struct job *j, uint64_t bytes, struct fault *f)
{
    if (j->input.kind == PAYLOAD_INLINE) {
        j->input.block = block_take(&c->host->blocks, j->input.size);
        if (!j->input.block)
            return fault_set(f, FAULT_NO_MEMORY, "input.size", "no memory for %" PRIu64 " bytes", j->input.size);
        c->host->held_bytes += j->input_held;
    }
    j->credit_bytes = bytes;
    c->credit_left -= bytes;
    j->upload_ns = clock_ns();
    TAILQ_INSERT_TAIL(&c->jobs, j, of_client);
    c->n_requests++;
    if (j->input.kind != PAYLOAD_INLINE)
        sched_submit(c->host->sched, &c->flow, j);
    return 0;
}

// The body of a BLOOM or an ASSET, unpacked.
struct ask {
    const Airy__Bloom *bloom; // one of the two
    const Airy__Asset *asset;
    const Airy__Payload *input; // may be NULL
};

static int ask_read(struct client *c, const struct conn_message *m, struct ask *a, struct fault *f)
{
    bool is_asset = m->header.type == WIRE_ASSET;
    void *body = body_unpack(is_asset ? &airy__asset__descriptor : &airy__bloom__descriptor, m->body,
                             m->header.body_bytes, &c->arena, f);
    if (!body)
        return -1;
    if (!m->header.id)
        return fault_set(f, FAULT_UNEXPECTED, "id", "%s with request id 0; expected any other",
                         wire_type_name(m->header.type));
    if (is_asset)
        a->asset = body;
    else
        a->bloom = body;
    a->input = is_asset ? a->asset->input : a->bloom->input;
    return 0;
}

// The result's descriptor is spoken for with those that came.
static unsigned gives_memfd(const struct ask *a)
{
    const Airy__Bloom *b = a->bloom;
    return b && !b->plan_only && b->output && b->output->kind == AIRY__OUTPUT__KIND__MEMFD;
}

// It never came to hold its payload's bytes.
static void job_forget(struct client_host *h, struct job *j)
{
    if (!j->input.block)
        h->held_bytes += j->input_held;
    client_job_drop(h, j);
}

// A fresh job from the message, or NULL and *f. Takes the descriptors.
static struct job *make_job(struct client *c, const struct conn_message *m, const struct ask *a, struct fault *f)
{
    struct job *j = job_create(&c->host->job);
    if (!j) {
        client_close_fds(m);
        fault_set(f, FAULT_NO_MEMORY, "", "no memory for a request");
        return NULL;
    }
    c->host->jobs++;
    j->host = c->host;
    j->client = c;
    j->id = m->header.id;
    const bool is_inline = a->input && a->input->kind == AIRY__PAYLOAD__KIND__INLINE;
    if (hold(c, j, is_inline ? a->input->size : 0, m->header.n_fds + gives_memfd(a), f) < 0) {
        client_close_fds(m);
        job_forget(c->host, j);
        return NULL;
    }
    int rc = a->asset ? request_read_asset(j, a->asset, m->fds, m->header.n_fds, f)
                      : request_read(j, a->bloom, m->fds, m->header.n_fds, f);
    if (rc == 0 && j->output_kind == JOB_OUTPUT_WALL)
        rc = walls_claim(j->wall, c, f);
    if (rc == 0)
        rc = fits(c, j, f);
    if (rc < 0 || start(c, j, a->input->size, f) < 0) {
        job_forget(c->host, j);
        return NULL;
    }
    return j;
}

void client_ask(struct client *c, const struct conn_message *m)
{
    struct fault f = { .code = FAULT_NONE };
    uint64_t id = m->header.id;
    struct ask a = { 0 };
    if (ask_read(c, m, &a, &f) < 0) {
        client_close_fds(m);
        client_refuse(c, id, 0, &f);
        return;
    }
    uint64_t bytes = a.input ? a.input->size : 0;
    bool is_inline = a.input && a.input->kind == AIRY__PAYLOAD__KIND__INLINE;
    struct job *j = NULL;
    if (admit(c, id, bytes, is_inline, &f) < 0)
        client_close_fds(m);
    else
        j = make_job(c, m, &a, &f);
    // The client has counted its bytes off in any case, and gets them back.
    if (!j)
        client_refuse(c, id, bytes, &f);
}
