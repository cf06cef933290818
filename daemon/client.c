// SPDX-License-Identifier: Apache-2.0
// client.c - see client.h.
#include "client.h"

#include <assert.h>
#include <errno.h>
#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "body.h"
#include "request.h"
#include "wall_message.h"

enum { READ_ONCE_BYTES = 1024 * 1024, UNSENT_REPLIES_MAX = 256, RETRY_MIN_MS = 20, RETRY_MAX_MS = 60000 };

enum client_state { CLIENT_HELLO, CLIENT_READY, CLIENT_CLOSING, CLIENT_LINGER, CLIENT_DEAD };

struct settled { // comes back to the client when the stream has been written up to here
    uint64_t at, credit_bytes;
};

struct client {
    struct client_host *host;
    struct conn *conn;
    struct ucred peer;
    enum client_state state;
    struct body_arena arena;
    struct sched_flow flow;

    struct job_queue jobs; // in upload, or sched's
    unsigned n_requests;   // jobs, and replies not yet written
    struct job *sink;      // a DATA message is being read into its block
    bool sink_dead;        // ... and it has ended: destroyed after that message
    uint64_t credit_left;

    uint64_t written; // of the stream to the client, since the start
    uint64_t reply_end[UNSENT_REPLIES_MAX];
    unsigned replies;
    struct settled *settled; // ring of max_requests
    unsigned settled_first, settled_count;

    uint64_t since_ns; // state entered; CLOSING and LINGER: deadline counts from here
    uint64_t write_ns; // last time that something was written, or there was nothing to write
};

static void say(const struct client *c, const char *format, ...) __attribute__((format(printf, 2, 3)));
static void say(const struct client *c, const char *format, ...)
{
    if (!c->host->log)
        return;
    char text[420], line[512];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    snprintf(line, sizeof line, "client pid %d uid %u: %s", (int)c->peer.pid, (unsigned)c->peer.uid, text);
    c->host->log(line);
}

static bool talking(const struct client *c) { return c->state == CLIENT_HELLO || c->state == CLIENT_READY; }

static void enter(struct client *c, enum client_state state)
{
    c->state = state;
    c->since_ns = clock_ns();
}

// ---- jobs ------------------------------------------------------------------------------------------

static void job_drop(struct client_host *host, struct job *j)
{
    host->held_bytes -= j->input_held + j->output_held;
    host->jobs--;
    job_destroy(j);
}

static struct job *job_find(struct client *c, uint64_t id)
{
    struct job *j;
    TAILQ_FOREACH(j, &c->jobs, of_client)
    if (j->id == id)
        return j;
    return NULL;
}

// The client's part of an upload ends; its block may still be the target of a message that is coming in.
static void upload_end(struct client *c, struct job *j)
{
    TAILQ_REMOVE(&c->jobs, j, of_client);
    if (c->sink == j)
        c->sink_dead = true;
    else
        job_drop(c->host, j);
}

static void jobs_abandon(struct client *c)
{
    struct job *j;
    while ((j = TAILQ_FIRST(&c->jobs))) {
        if (j->stage == JOB_UPLOAD) {
            upload_end(c, j);
            continue;
        }
        TAILQ_REMOVE(&c->jobs, j, of_client);
        j->client = NULL;
        sched_cancel(c->host->sched, j);
    }
}

// ---- replies ---------------------------------------------------------------------------------------

// Counts a message that was queued; without memory for it the client cannot be told anything.
static int queued(struct client *c, int rc)
{
    if (rc < 0) {
        say(c, "no reply could be made: %s", strerror(-rc));
        enter(c, CLIENT_DEAD);
        return -1;
    }
    c->reply_end[c->replies++ % UNSENT_REPLIES_MAX] = c->written + conn_unsent_bytes(c->conn);
    return 0;
}

static bool overfull(const struct client *c)
{
    return c->replies >= UNSENT_REPLIES_MAX && c->reply_end[c->replies % UNSENT_REPLIES_MAX] > c->written;
}

// The request's terminal reply has been queued.
static void settle(struct client *c, uint64_t credit_bytes)
{
    unsigned max = c->host->facts.max_requests;
    assert(c->settled_count < max);
    c->settled[(c->settled_first + c->settled_count++) % max] =
        (struct settled){ c->written + conn_unsent_bytes(c->conn), credit_bytes };
}

static void settle_written(struct client *c)
{
    uint64_t credit = 0;
    while (c->settled_count && c->settled[c->settled_first].at <= c->written) {
        credit += c->settled[c->settled_first].credit_bytes;
        c->settled_first = (c->settled_first + 1) % c->host->facts.max_requests;
        c->settled_count--;
        c->n_requests--;
    }
    if (!credit || !talking(c))
        return;
    c->credit_left += credit;
    queued(c, reply_credit(c->conn, credit));
}

static void flush(struct client *c)
{
    while (c->state != CLIENT_DEAD) {
        uint64_t before = conn_unsent_bytes(c->conn);
        int rc = conn_flush(c->conn);
        uint64_t after = conn_unsent_bytes(c->conn);
        c->written += before - after;
        if (before != after || !after)
            c->write_ns = clock_ns();
        if (rc < 0) {
            say(c, "gone while being written to: %s", strerror(-rc));
            enter(c, CLIENT_DEAD);
            return;
        }
        settle_written(c);
        if (rc == 0 || conn_unsent_bytes(c->conn) == 0)
            break;
    }
    if (c->state == CLIENT_CLOSING && !conn_wants_write(c->conn)) {
        shutdown(conn_fd(c->conn), SHUT_WR);
        enter(c, CLIENT_LINGER);
    }
}

// An error that ends the connection, once it is written.
static void fail(struct client *c, uint64_t id, const struct fault *f)
{
    say(c, "%s: %s", fault_symbol(f->code), f->text);
    jobs_abandon(c);
    enter(c, CLIENT_CLOSING);
    queued(c, reply_fault(c->conn, id, f));
}

// An error that ends one request which has not become (or is no longer) a job.
static void refuse(struct client *c, uint64_t id, uint64_t credit_bytes, const struct fault *f)
{
    c->host->metrics.failed++;
    say(c, "request %" PRIu64 ": %s: %s: %s", id, fault_symbol(f->code), f->field, f->text);
    if (fault_closes(f->code)) {
        fail(c, id, f);
        return;
    }
    if (queued(c, reply_fault(c->conn, id, f)) == 0 && credit_bytes)
        queued(c, reply_credit(c->conn, credit_bytes));
}

static void upload_fail(struct client *c, struct job *j, const struct fault *f)
{
    uint64_t id = j->id, credit = j->credit_bytes;
    upload_end(c, j);
    c->host->metrics.failed++;
    if (queued(c, reply_fault(c->conn, id, f)) == 0)
        settle(c, credit);
}

static void data_written(void *ctx)
{
    struct job *j = ctx;
    job_drop(j->host, j);
}

static int send_result(struct client *c, struct job *j, bool *kept)
{
    uint64_t bytes = j->output.size;
    *kept = false;
    if (j->output_kind == JOB_OUTPUT_INLINE) {
        int rc = conn_send_data(c->conn, j->id, j->output.block->data, bytes, data_written, j);
        if (rc < 0)
            return rc;
        *kept = true;
        j->output_held = bytes;
        c->host->held_bytes += bytes;
    }
    return j->kind == JOB_KEEPS ? reply_kept(c->conn, j) : reply_result(c->conn, j, &c->host->facts);
}

static void note_end(struct client_host *host, struct job *j)
{
    struct metrics *m = &host->metrics;
    m->bytes_in += j->input_bytes;
    if (j->finished && !j->overrun) {
        m->done++;
        m->bytes_out += j->output_kind == JOB_OUTPUT_BUFFER ? j->input_bytes : j->output.size;
        if (j->kind != JOB_BLOOMS) // their times would say nothing of a frame's
            return;
        for (unsigned i = 0; i < j->n_scenes; i++)
            m->pixels += (uint64_t)j->scene[i].width * j->scene[i].height;
        metrics_note(m, &j->ms);
    } else if (j->fault.code != FAULT_NONE || j->overrun) {
        m->failed++;
    } else {
        m->cancelled++;
    }
}

static void overrun_fault(const struct job *j, struct fault *f)
{
    fault_set(f, FAULT_PAYLOAD, "input.size", "more DATA came than the %" PRIu64 " bytes that were announced",
              j->credit_bytes);
}

void client_job_done(struct client_host *host, struct job *j)
{
    struct client *c = j->client;
    note_end(host, j);
    if (!c) {
        job_drop(host, j);
        return;
    }
    TAILQ_REMOVE(&c->jobs, j, of_client);
    uint64_t credit = j->credit_bytes, id = j->id;
    bool kept = false;
    int rc;
    if (j->overrun) {
        overrun_fault(j, &j->fault);
        rc = reply_fault(c->conn, id, &j->fault);
    } else if (j->finished) {
        rc = send_result(c, j, &kept);
    } else if (j->fault.code != FAULT_NONE) {
        say(c, "request %" PRIu64 ": %s: %s: %s", id, fault_symbol(j->fault.code), j->fault.field,
            j->fault.text);
        rc = reply_fault(c->conn, id, &j->fault);
    } else {
        rc = conn_send(c->conn, WIRE_CANCELLED, id, NULL, 0, NULL, 0);
    }
    if (queued(c, rc) == 0)
        settle(c, credit);
    if (!kept)
        job_drop(host, j);
    flush(c);
}

// ---- BLOOM, ASSET, DATA, CANCEL ------------------------------------------------------------------------

static int busy(const struct client *c, struct fault *f, const char *what, uint64_t found, uint64_t limit)
{
    fault_set(f, FAULT_BUSY, "", "%s: %" PRIu64 " of %" PRIu64 "; try again", what, found, limit);
    struct sched_counts counts = sched_counts(c->host->sched);
    double each = metrics_mean(&c->host->metrics).total, wait = each * (counts.waiting + 1) / 2;
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
    if (job_find(c, id))
        return fault_set(f, FAULT_DUPLICATE_ID, "id", "request %" PRIu64 " is still in flight", id);
    if (bytes > h->facts.job.max_frame_bytes)
        return fault_set(f, FAULT_LIMIT, "input.size", "%" PRIu64 " bytes; at most %" PRIu64 " are taken", bytes,
                         h->facts.job.max_frame_bytes);
    if (bytes > c->credit_left)
        return busy(c, f, "credit exceeded, payload bytes in flight on this connection",
                    h->facts.credit_bytes - c->credit_left + bytes, h->facts.credit_bytes);
    if (c->n_requests >= h->facts.max_requests)
        return busy(c, f, "requests in flight on this connection", c->n_requests, h->facts.max_requests);
    if (h->jobs >= h->jobs_max)
        return busy(c, f, "requests in the daemon", h->jobs, h->jobs_max);
    if (is_inline && h->held_bytes + bytes > h->held_bytes_max) // both far below 2^63
        return busy(c, f, "payload bytes in the daemon", h->held_bytes + bytes, h->held_bytes_max);
    return 0;
}

static void submit(struct client *c, struct job *j) { sched_submit(c->host->sched, &c->flow, j); }

static int start(struct client *c, struct job *j, uint64_t bytes, struct fault *f)
{
    if (j->input.kind == PAYLOAD_INLINE) {
        j->input.block = block_take(&c->host->blocks, j->input.size);
        if (!j->input.block)
            return fault_set(f, FAULT_NO_MEMORY, "input.size", "no memory for %" PRIu64 " bytes", j->input.size);
        j->input_held = j->input.size;
        c->host->held_bytes += j->input_held;
    }
    j->credit_bytes = bytes;
    c->credit_left -= bytes;
    j->upload_ns = clock_ns();
    TAILQ_INSERT_TAIL(&c->jobs, j, of_client);
    c->n_requests++;
    if (j->input.kind != PAYLOAD_INLINE)
        submit(c, j);
    return 0;
}

static void close_fds(const struct conn_message *m)
{
    for (unsigned i = 0; i < m->header.n_fds; i++)
        close(m->fds[i]);
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

// A fresh job from the message, or NULL and *f. Takes the descriptors.
static struct job *make_job(struct client *c, const struct conn_message *m, const struct ask *a, struct fault *f)
{
    struct job *j = job_create(&c->host->job);
    if (!j) {
        close_fds(m);
        fault_set(f, FAULT_NO_MEMORY, "", "no memory for a request");
        return NULL;
    }
    c->host->jobs++;
    j->host = c->host;
    j->client = c;
    j->id = m->header.id;
    int rc = a->asset ? request_read_asset(j, a->asset, m->fds, m->header.n_fds, f)
                      : request_read(j, a->bloom, m->fds, m->header.n_fds, f);
    if (rc == 0 && j->output_kind == JOB_OUTPUT_WALL)
        rc = walls_claim(j->wall, c, f);
    if (rc < 0 || start(c, j, a->input->size, f) < 0) {
        job_drop(c->host, j);
        return NULL;
    }
    return j;
}

static void on_ask(struct client *c, const struct conn_message *m)
{
    struct fault f = { .code = FAULT_NONE };
    uint64_t id = m->header.id;
    struct ask a = { 0 };
    if (ask_read(c, m, &a, &f) < 0) {
        close_fds(m);
        refuse(c, id, 0, &f);
        return;
    }
    uint64_t bytes = a.input ? a.input->size : 0;
    bool is_inline = a.input && a.input->kind == AIRY__PAYLOAD__KIND__INLINE;
    struct job *j = NULL;
    if (admit(c, id, bytes, is_inline, &f) < 0)
        close_fds(m);
    else
        j = make_job(c, m, &a, &f);
    // The client has counted its bytes off in any case, and gets them back.
    if (!j)
        refuse(c, id, bytes, &f);
}

static void *place_data(void *ctx, uint64_t id, uint32_t bytes)
{
    struct client *c = ctx;
    struct job *j = job_find(c, id);
    if (c->state != CLIENT_READY || !j || j->stage != JOB_UPLOAD || bytes > j->input.size - j->received)
        return NULL;
    c->sink = j;
    c->sink_dead = false;
    j->upload_ns = clock_ns();
    return j->input.block->data + j->received;
}

static void data_taken(struct client *c, uint32_t bytes)
{
    struct job *j = c->sink;
    c->sink = NULL;
    if (c->sink_dead) {
        c->sink_dead = false;
        job_drop(c->host, j);
        return;
    }
    j->received += bytes;
    j->upload_ns = clock_ns();
    if (j->received == j->input.size)
        submit(c, j);
}

// Bytes of a request that ended (refused, cancelled) are still on their way here: they mean nothing.
static void on_data(struct client *c, const struct conn_message *m)
{
    struct fault f;
    if (!m->body && m->header.body_bytes) {
        data_taken(c, m->header.body_bytes);
        return;
    }
    struct job *j = job_find(c, m->header.id);
    if (!j || !m->header.body_bytes)
        return;
    if (j->stage == JOB_UPLOAD) {
        overrun_fault(j, &f);
        upload_fail(c, j, &f);
        return;
    }
    j->overrun = true;
    sched_cancel(c->host->sched, j);
}

static void on_cancel(struct client *c, const struct conn_message *m)
{
    struct job *j = job_find(c, m->header.id);
    if (!j)
        return; // ended already: its reply is on its way
    if (j->stage != JOB_UPLOAD) {
        sched_cancel(c->host->sched, j);
        return;
    }
    uint64_t credit = j->credit_bytes;
    upload_end(c, j);
    c->host->metrics.cancelled++;
    if (queued(c, conn_send(c->conn, WIRE_CANCELLED, m->header.id, NULL, 0, NULL, 0)) == 0)
        settle(c, credit);
}

// ---- HELLO, STATUS ---------------------------------------------------------------------------------

static void on_hello(struct client *c, const struct conn_message *m)
{
    struct fault f;
    const Airy__Hello *h =
        body_unpack(&airy__hello__descriptor, m->body, m->header.body_bytes, &c->arena, &f);
    if (!h) {
        fail(c, 0, &f);
        return;
    }
    if (h->version_min > WIRE_VERSION || h->version_max < WIRE_VERSION || h->version_min > h->version_max) {
        fault_set(&f, FAULT_BAD_VERSION, "version_max",
                  "the client speaks versions %u to %u; this daemon speaks %d", h->version_min, h->version_max,
                  WIRE_VERSION);
        fail(c, 0, &f);
        return;
    }
    say(c, "hello from \"%.80s\"", h->client);
    enter(c, CLIENT_READY);
    queued(c, reply_welcome(c->conn, &c->host->facts));
}

static void on_status(struct client *c, const struct conn_message *m)
{
    struct reply_status s = {
        .clients = c->host->clients,
        .sched = sched_counts(c->host->sched),
        .metrics = &c->host->metrics,
        .draining = c->host->draining,
    };
    queued(c, reply_status(c->conn, m->header.id, &c->host->facts, &s));
}

struct preview { // on its way to the client
    struct block_pool *blocks;
    struct block *block;
};

static void preview_written(void *ctx)
{
    struct preview *p = ctx;
    block_give(p->blocks, p->block);
    free(p);
}

static int send_preview(struct client *c, uint64_t id, struct block *block, uint64_t bytes)
{
    struct preview *p = malloc(sizeof *p);
    int rc = p ? 0 : -ENOMEM;
    if (p) {
        *p = (struct preview){ &c->host->blocks, block };
        rc = conn_send_data(c->conn, id, block->data, bytes, preview_written, p);
    }
    if (rc < 0) {
        free(p);
        block_give(&c->host->blocks, block);
    }
    return rc;
}

static void on_wall(struct client *c, const struct conn_message *m)
{
    struct fault f = { .code = FAULT_NONE };
    const struct client_host *h = c->host;
    const uint64_t id = m->header.id;
    const struct wall_desk desk = { h->walls, h->job.assets, h->sched, h->job.blocks };
    const Airy__Wall *w = body_unpack(&airy__wall__descriptor, m->body, m->header.body_bytes, &c->arena, &f);
    Airy__WallReply *r = NULL;
    struct block *preview = NULL;
    uint64_t bytes = 0;
    if (w && (!id || job_find(c, id))) {
        fault_set(&f, id ? FAULT_DUPLICATE_ID : FAULT_UNEXPECTED, "id", "WALL with %s; expected an id of its own",
                  id ? "the id of a request in flight" : "request id 0");
        w = NULL;
    }
    if (w && h->draining) {
        fault_set(&f, FAULT_SHUTTING_DOWN, "", "the daemon is stopping");
        w = NULL;
    }
    if (!w || wall_message(&desk, w, c, &c->arena, &r, &preview, &bytes, &f) < 0) {
        refuse(c, id, 0, &f);
        return;
    }
    if (preview && queued(c, send_preview(c, id, preview, bytes)) < 0)
        return;
    queued(c, body_send(c->conn, WIRE_WALL_REPLY, id, &r->base, NULL, 0));
}

static void dispatch(struct client *c, const struct conn_message *m)
{
    if (c->state == CLIENT_READY) {
        switch (m->header.type) {
        case WIRE_BLOOM:
        case WIRE_ASSET: on_ask(c, m); return;
        case WIRE_DATA: on_data(c, m); return;
        case WIRE_CANCEL: on_cancel(c, m); return;
        case WIRE_STATUS: on_status(c, m); return;
        case WIRE_WALL: on_wall(c, m); return;
        default: break;
        }
    } else if (m->header.type == WIRE_HELLO) {
        on_hello(c, m);
        return;
    }
    struct fault f;
    close_fds(m);
    fault_set(&f, FAULT_UNEXPECTED, "type", "%s %s", wire_type_name(m->header.type),
              c->state == CLIENT_READY ? "may not come again" : "came before HELLO");
    fail(c, 0, &f);
}

// ---- events ----------------------------------------------------------------------------------------

// While an error is on its way out, what comes in is taken off the socket and dropped: closing with
// bytes unread would reset the connection and lose the error.
static void discard(struct client *c)
{
    static uint8_t waste[64 * 1024]; // only this thread, only written
    for (int i = 0; i < 16; i++) {
        ssize_t n = recv(conn_fd(c->conn), waste, sizeof waste, MSG_DONTWAIT);
        if (n > 0)
            continue;
        if (n == 0 || (errno != EAGAIN && errno != EINTR))
            enter(c, CLIENT_DEAD);
        return;
    }
}

static void read_messages(struct client *c)
{
    int rc = conn_read(c->conn, READ_ONCE_BYTES);
    struct conn_message m;
    struct fault f;
    int got = 0;
    while (talking(c) && (got = conn_next(c->conn, &m, &f)) > 0)
        dispatch(c, &m);
    if (talking(c) && got < 0)
        fail(c, 0, &f);
    if (rc < 0 && c->state != CLIENT_DEAD) {
        flush(c); // who has only stopped writing can read its error
        say(c, "gone (%s)%s", strerror(-rc), TAILQ_EMPTY(&c->jobs) ? "" : " with requests in flight");
        enter(c, CLIENT_DEAD);
    }
}

void client_event(struct client *c, uint32_t events)
{
    if (c->state == CLIENT_DEAD)
        return;
    flush(c);
    if (events & (EPOLLIN | EPOLLHUP | EPOLLERR)) {
        if (talking(c))
            read_messages(c);
        else if (c->state != CLIENT_DEAD)
            discard(c);
    }
    flush(c);
}

uint32_t client_events(const struct client *c)
{
    uint32_t events = conn_wants_write(c->conn) ? EPOLLOUT : 0;
    return talking(c) && overfull(c) ? events : events | EPOLLIN;
}

static bool past(uint64_t now_ns, uint64_t from_ns, uint32_t ms)
{
    return now_ns > from_ns && now_ns - from_ns > (uint64_t)ms * 1000000;
}

static void uploads_tick(struct client *c, uint64_t now_ns)
{
    struct job *j, *next;
    for (j = TAILQ_FIRST(&c->jobs); j && c->state == CLIENT_READY; j = next) {
        next = TAILQ_NEXT(j, of_client);
        if (j->stage != JOB_UPLOAD || !past(now_ns, j->upload_ns, c->host->timeout.upload))
            continue;
        struct fault f;
        fault_set(&f, FAULT_PAYLOAD, "input.size",
                  "%" PRIu64 " of %" PRIu64 " bytes came, and none in the last %u ms", j->received,
                  j->input.size, c->host->timeout.upload);
        upload_fail(c, j, &f);
    }
}

void client_tick(struct client *c, uint64_t now_ns)
{
    const struct client_timeouts *t = &c->host->timeout;
    if (c->state == CLIENT_HELLO && past(now_ns, c->since_ns, t->hello)) {
        struct fault f;
        fault_set(&f, FAULT_UNEXPECTED, "type", "no HELLO in %u ms", t->hello);
        fail(c, 0, &f);
    }
    uploads_tick(c, now_ns);
    if (conn_unsent_bytes(c->conn) && past(now_ns, c->write_ns, t->write)) {
        say(c, "does not read its replies: closed");
        enter(c, CLIENT_DEAD);
    }
    if (c->state == CLIENT_LINGER && past(now_ns, c->since_ns, t->linger))
        enter(c, CLIENT_DEAD);
    flush(c);
}

void client_progress(struct client *c)
{
    struct job *j;
    TAILQ_FOREACH(j, &c->jobs, of_client)
    {
        int stage = j->stage;
        // Droppable: not to a client that lags behind with its replies.
        if (!j->wants_progress || stage <= j->progress_sent || stage == JOB_DONE || overfull(c))
            continue;
        j->progress_sent = stage;
        if (queued(c, reply_progress(c->conn, j->id, (enum job_stage)stage)) < 0)
            return;
    }
    flush(c);
}

// ---- life ------------------------------------------------------------------------------------------

struct client *client_create(struct client_host *host, int fd)
{
    struct client *c = calloc(1, sizeof *c);
    if (!c) {
        close(fd);
        return NULL;
    }
    c->host = host;
    TAILQ_INIT(&c->jobs);
    c->credit_left = host->facts.credit_bytes;
    c->since_ns = c->write_ns = clock_ns();
    c->settled = calloc(host->facts.max_requests, sizeof c->settled[0]);
    socklen_t n = sizeof c->peer;
    if (!c->settled || getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &c->peer, &n) < 0 ||
        conn_create(&c->conn, fd, WIRE_DAEMON) < 0)
        goto fail;
    if (sched_flow_open(host->sched, &c->flow, c->peer.uid) < 0)
        goto fail;
    conn_set_sink(c->conn, place_data, c);
    host->clients++;
    return c;
fail:
    if (c->conn)
        conn_destroy(c->conn);
    else
        close(fd);
    free(c->settled);
    free(c);
    return NULL;
}

void client_destroy(struct client *c)
{
    if (!c)
        return;
    jobs_abandon(c);
    walls_client_gone(c->host->walls, c);
    conn_destroy(c->conn); // gives up the place of a message that is half read
    if (c->sink_dead)
        job_drop(c->host, c->sink);
    sched_flow_close(c->host->sched, &c->flow);
    body_arena_finish(&c->arena);
    c->host->clients--;
    free(c->settled);
    free(c);
}

bool client_dead(const struct client *c) { return c->state == CLIENT_DEAD; }

void client_drain(struct client *c)
{
    struct job *j, *next;
    for (j = TAILQ_FIRST(&c->jobs); j && talking(c); j = next) {
        next = TAILQ_NEXT(j, of_client);
        if (j->stage != JOB_UPLOAD)
            continue;
        struct fault f;
        fault_set(&f, FAULT_SHUTTING_DOWN, "", "the daemon is stopping; %" PRIu64 " of %" PRIu64 " bytes came",
                  j->received, j->input.size);
        upload_fail(c, j, &f);
    }
    flush(c);
}

bool client_idle(const struct client *c)
{
    return TAILQ_EMPTY(&c->jobs) && !c->settled_count && !conn_wants_write(c->conn);
}

void client_hangup(struct client *c)
{
    if (!talking(c))
        return;
    shutdown(conn_fd(c->conn), SHUT_WR);
    enter(c, CLIENT_LINGER);
}
