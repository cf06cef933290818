// SPDX-License-Identifier: Apache-2.0
// client.c - see client.h.
#include "client_private.h"

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
#include "wall_message.h"

enum { READ_ONCE_BYTES = 1024 * 1024, REFUSED_MAX = 16 };

void client_say(const struct client *c, const char *format, ...)
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

void client_job_drop(struct client_host *host, struct job *j)
{
    host->held_bytes -= j->input_held;
    host->jobs--;
    sched_drop(host->sched, j);
    job_destroy(j);
}

struct job *client_job_find(struct client *c, uint64_t id)
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
        client_job_drop(c->host, j);
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
        client_say(c, "no reply could be made: %s", strerror(-rc));
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
static void settle(struct client *c, uint64_t credit_bytes, unsigned fds)
{
    unsigned max = c->host->facts.max_requests;
    assert(c->settled_count < max);
    c->settled[(c->settled_first + c->settled_count++) % max] =
        (struct settled){ c->written + conn_unsent_bytes(c->conn), credit_bytes, fds };
}

static void settle_written(struct client *c)
{
    uint64_t credit = 0;
    unsigned fds = 0;
    while (c->settled_count && c->settled[c->settled_first].at <= c->written) {
        fds += c->settled[c->settled_first].fds;
        credit += c->settled[c->settled_first].credit_bytes;
        c->settled_first = (c->settled_first + 1) % c->host->facts.max_requests;
        c->settled_count--;
        c->n_requests--;
    }
    if (fds)
        sched_fds_sent(c->host->sched, &c->flow, fds);
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
            client_say(c, "gone while being written to: %s", strerror(-rc));
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
    client_say(c, "%s: %s", fault_symbol(f->code), f->text);
    jobs_abandon(c);
    enter(c, CLIENT_CLOSING);
    queued(c, reply_fault(c->conn, id, f));
}

// An error that ends one request which has not become (or is no longer) a job.
void client_refuse(struct client *c, uint64_t id, uint64_t credit_bytes, const struct fault *f)
{
    c->host->metrics.failed++;
    c->host->metrics.refused_busy += f->code == FAULT_BUSY;
    client_say(c, "request %" PRIu64 ": %s: %s: %s", id, fault_symbol(f->code), f->field, f->text);
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
        settle(c, credit, 0);
}

static void data_written(void *ctx)
{
    struct job *j = ctx;
    client_job_drop(j->host, j);
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
        client_job_drop(host, j);
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
        client_say(c, "request %" PRIu64 ": %s: %s: %s", id, fault_symbol(j->fault.code), j->fault.field,
            j->fault.text);
        rc = reply_fault(c->conn, id, &j->fault);
    } else {
        rc = conn_send(c->conn, WIRE_CANCELLED, id, NULL, 0, NULL, 0);
    }
    const bool sends_fd = rc == 0 && j->finished && !j->overrun && j->output_kind == JOB_OUTPUT_MEMFD;
    if (sends_fd)
        sched_fd_keep(host->sched, &c->flow, j);
    if (queued(c, rc) == 0)
        settle(c, credit, sends_fd);
    if (!kept)
        client_job_drop(host, j);
    flush(c);
}

// ---- DATA, CANCEL (BLOOM, ASSET: client_ask.c) ------------------------------------------------------------------------

static void *place_data(void *ctx, uint64_t id, uint32_t bytes)
{
    struct client *c = ctx;
    struct job *j = client_job_find(c, id);
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
        client_job_drop(c->host, j);
        return;
    }
    j->received += bytes;
    j->upload_ns = clock_ns();
    if (j->received == j->input.size)
        sched_submit(c->host->sched, &c->flow, j);
}

// Bytes of a request that ended (refused, cancelled) are still on their way here: they mean nothing.
static void on_data(struct client *c, const struct conn_message *m)
{
    struct fault f;
    if (!m->body && m->header.body_bytes) {
        data_taken(c, m->header.body_bytes);
        return;
    }
    struct job *j = client_job_find(c, m->header.id);
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
    struct job *j = client_job_find(c, m->header.id);
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
        settle(c, credit, 0);
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
    client_say(c, "hello from \"%.80s\"", h->client);
    enter(c, CLIENT_READY);
    queued(c, reply_welcome(c->conn, &c->host->facts));
}

static void on_status(struct client *c, const struct conn_message *m)
{
    struct reply_status s = {
        .clients = c->host->clients,
        .sched = sched_counts(c->host->sched),
        .metrics = &c->host->metrics,
        .inline_bytes = c->host->held_bytes,
        .draining = c->host->draining,
    };
    s.n_users = sched_users(c->host->sched, s.user);
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
    if (w && (!id || client_job_find(c, id))) {
        fault_set(&f, id ? FAULT_DUPLICATE_ID : FAULT_UNEXPECTED, "id", "WALL with %s; expected an id of its own",
                  id ? "the id of a request in flight" : "request id 0");
        w = NULL;
    }
    if (w && h->draining) {
        fault_set(&f, FAULT_SHUTTING_DOWN, "", "the daemon is stopping");
        w = NULL;
    }
    if (!w || wall_message(&desk, w, c, &c->arena, &r, &preview, &bytes, &f) < 0) {
        client_refuse(c, id, 0, &f);
        return;
    }
    if (preview && queued(c, send_preview(c, id, preview, bytes)) < 0)
        return;
    queued(c, body_send(c->conn, WIRE_WALL_REPLY, id, &r->base, NULL, 0));
}

void client_close_fds(const struct conn_message *m)
{
    for (unsigned i = 0; i < m->header.n_fds; i++)
        close(m->fds[i]);
}

static void dispatch(struct client *c, const struct conn_message *m)
{
    if (c->state == CLIENT_READY) {
        switch (m->header.type) {
        case WIRE_BLOOM:
        case WIRE_ASSET: client_ask(c, m); return;
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
    client_close_fds(m);
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
        client_say(c, "gone (%s)%s", strerror(-rc), TAILQ_EMPTY(&c->jobs) ? "" : " with requests in flight");
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
        client_say(c, "does not read its replies: closed");
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

// It is told, and then let go; of many that come at once only some are waited for until they have read it.
static void turn_away(struct client *c, const char *what, unsigned found, unsigned allowed)
{
    struct fault f;
    client_busy(c->host, &f, what, found, allowed);
    sched_flow_close(c->host->sched, &c->flow);
    c->refused = true;
    c->host->metrics.refused_busy++;
    fail(c, 0, &f);
    flush(c);
    if (++c->host->refused > REFUSED_MAX)
        enter(c, CLIENT_DEAD);
}

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
    unsigned connections;
    if (sched_flow_open(host->sched, &c->flow, c->peer.uid, &connections) < 0)
        goto fail;
    conn_set_sink(c->conn, place_data, c);
    host->clients++;
    const unsigned fds = sched_user_fds(host->sched, &c->flow);
    if (connections > host->user_connections_max)
        turn_away(c, "connections of this user", connections, host->user_connections_max);
    else if (fds > host->user_fds_max)
        turn_away(c, "descriptors of this user", fds, host->user_fds_max);
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
        client_job_drop(c->host, c->sink);
    sched_flow_close(c->host->sched, &c->flow);
    body_arena_finish(&c->arena);
    c->host->clients--;
    c->host->refused -= c->refused;
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
