// SPDX-License-Identifier: Apache-2.0
//
// libairy.c - the connection: what comes from the daemon, the pump that reads while it writes, and the waits.
//
// Everything that comes from the daemon is checked as if it were hostile; a message that may not come
// loses the connection, with words.
#include "lib_internal.h"

#include <errno.h>
#include <inttypes.h>
#include <poll.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { READ_BYTES = 4 * 1024 * 1024 };

// ---- errors and time ---------------------------------------------------------------------------

int lib_fail(struct airy_error *e, int err, const char *field, const char *format, ...)
{
    if (!e)
        return -1;
    *e = (struct airy_error){ .code = -err, .symbol = "LOCAL" };
    snprintf(e->field, sizeof(e->field), "%s", field);
    va_list args;
    va_start(args, format);
    vsnprintf(e->text, sizeof(e->text), format, args);
    va_end(args);
    return -1;
}

int lib_copy_error(struct airy_error *out, const struct airy_error *e)
{
    if (out)
        *out = *e;
    return -1;
}

int64_t lib_now_ms(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000 + t.tv_nsec / 1000000;
}

int64_t lib_deadline_ms(int timeout_ms) { return timeout_ms < 0 ? -1 : lib_now_ms() + timeout_ms; }

// ---- requests on their lists ---------------------------------------------------------------------

void lib_request_free(struct request *r)
{
    if (!r)
        return;
    while (r->n_fds)
        close(r->fds[--r->n_fds]);
    free(r->body);
    airy_result_free(r->result);
    free(r->got);
    free(r);
}

const struct airy_error lib_cancelled = { .code = -ECANCELED, .symbol = "CANCELLED", .text = "the request was cancelled" };

static struct request *find(struct request *list, uint64_t id)
{
    while (list && list->id != id)
        list = list->next;
    return list;
}

static void unlink_request(struct request **list, struct request *r)
{
    while (*list != r)
        list = &(*list)->next;
    *list = r->next;
    r->next = NULL;
}

// An ended request stays open until its data is out of our hands.
static void settle(struct request *r)
{
    if (!r->ended || r->sending)
        return;
    struct airy *a = r->airy;
    unlink_request(&a->open, r);
    a->open_count--;
    struct request **tail = &a->done;
    while (*tail)
        tail = &(*tail)->next;
    *tail = r;
}

void lib_request_sent(void *request)
{
    struct request *r = request;
    r->sending = false;
    settle(r);
}

void lib_request_end(struct request *r, const struct airy_error *e)
{
    if (e)
        r->error = *e;
    r->ended = true;
    settle(r);
}

// By the daemon's word.
static void end_request(struct request *r, const struct airy_error *e)
{
    lib_useful(r->airy);
    lib_request_end(r, e);
}

// ---- messages from the daemon ------------------------------------------------------------------

void *lib_place_data(void *ctx, uint64_t id, uint32_t bytes)
{
    struct airy *a = ctx;
    struct request *r = find(a->open, id);
    if (!r || !r->sent || r->ended || r->output_kind != AIRY__OUTPUT__KIND__INLINE)
        return NULL;
    uint64_t max = a->limits.max_frame_bytes < SIZE_MAX ? a->limits.max_frame_bytes : SIZE_MAX;
    if (bytes > max || r->got_bytes > max - bytes)
        return NULL;
    uint64_t need = r->got_bytes + bytes;
    if (need > r->got_cap) {
        uint64_t cap = r->got_cap ? r->got_cap : r->input_bytes;
        cap = cap < max / 2 ? cap * 2 : max;
        if (cap < need)
            cap = need;
        uint8_t *bigger = realloc(r->got, (size_t)cap);
        if (!bigger)
            return NULL;
        r->got = bigger;
        r->got_cap = cap;
    }
    return r->got + r->got_bytes;
}

static void *unpack(struct airy *a, const ProtobufCMessageDescriptor *d, const struct conn_message *m,
                    struct airy_error *e)
{
    struct fault f;
    void *body = body_unpack(d, m->body, m->header.body_bytes, &a->arena, &f);
    if (!body)
        lib_fail(e, EPROTO, "", "from the daemon: %s", f.text);
    return body;
}

static int on_welcome(struct airy *a, const struct conn_message *m, struct airy_error *e)
{
    const Airy__Welcome *w = unpack(a, &airy__welcome__descriptor, m, e);
    if (!w)
        return -1;
    if (w->version != WIRE_VERSION)
        return lib_fail(e, EPROTO, "version",
                        "the daemon chose protocol version %" PRIu32 ", asked was %d", w->version,
                        WIRE_VERSION);
    if (!w->limits)
        return lib_fail(e, EPROTO, "limits", "the daemon's WELCOME states no limits");
    snprintf(a->server, sizeof(a->server), "%s", w->server);
    snprintf(a->device, sizeof(a->device), "%s", w->device ? w->device->name : "");
    a->limits = (struct airy_limits){
        .max_frame_bytes = w->limits->max_frame_bytes,
        .max_pixels = w->limits->max_pixels,
        .credit_bytes = w->limits->credit_bytes,
        .max_width = w->limits->max_width,
        .max_height = w->limits->max_height,
        .max_requests = w->limits->max_requests,
    };
    a->credit_bytes = a->limits.credit_bytes;
    a->has_walls = false;
    for (size_t i = 0; i < w->n_features; i++)
        a->has_walls = a->has_walls || strcmp(w->features[i], "wall") == 0;
    a->welcome = true;
    lib_came_up(a);
    return 0;
}

// 0: the request ended, -1: the connection did, for the same reason.
static int on_error(struct airy *a, const struct conn_message *m, struct airy_error *e)
{
    const Airy__Error *b = unpack(a, &airy__error__descriptor, m, e);
    if (!b)
        return -1;
    // Anything else could pass for success, or for a failure of this side.
    if (b->code < 100 || b->code > 599)
        return lib_fail(e, EPROTO, "", "the daemon sent an ERROR of code %u; 100 to 599 expected", b->code);
    struct airy_error error = { .code = (int)b->code,
                                .retryable = b->retryable,
                                .retry_after_ms = b->retry_after_ms };
    snprintf(error.symbol, sizeof(error.symbol), "%s", b->symbol);
    snprintf(error.field, sizeof(error.field), "%s", b->field);
    snprintf(error.text, sizeof(error.text), "%s", *b->text ? b->text : "the daemon gives no reason");
    if (m->header.id && !lib_wall_error(a, m->header.id, &error)) {
        struct request *r = find(a->open, m->header.id);
        if (!r || !r->sent || r->ended)
            return lib_fail(e, EPROTO, "",
                            "the daemon sent ERROR %s for request %" PRIu64 ", which is not open",
                            error.symbol, m->header.id);
        if (!lib_hold(r, &error))
            end_request(r, &error);
    }
    return m->header.id && !fault_closes((enum fault_code)error.code) ? 0 : lib_copy_error(e, &error);
}

static void status_users(struct airy_status *s, const Airy__StatusReply *b)
{
    for (size_t i = 0; i < b->n_users && s->n_users < AIRY_STATUS_USERS_MAX; i++) {
        const Airy__UserState *u = b->users[i];
        s->user[s->n_users++] = (struct airy_status_user){ .uid = u->uid,
                                                           .connections = u->connections,
                                                           .requests = u->requests,
                                                           .queued = u->queued,
                                                           .running = u->running,
                                                           .fds = u->fds,
                                                           .bytes = u->bytes,
                                                           .device_ms = u->device_ms };
    }
}

// A histogram whose buckets are not those that were told, or more than there is room for, is left out.
static void status_stages(struct airy_status *s, const Airy__StatusReply *b)
{
    if (b->n_bucket_ms > AIRY_STATUS_BUCKETS_MAX)
        return;
    s->n_buckets = (uint32_t)b->n_bucket_ms;
    for (size_t i = 0; i < b->n_bucket_ms; i++)
        s->bucket_ms[i] = b->bucket_ms[i];
    for (size_t i = 0; i < b->n_stages && s->n_stages < AIRY_STATUS_STAGES_MAX; i++) {
        const Airy__StageHistogram *h = b->stages[i];
        struct airy_status_stage *o = &s->stage[s->n_stages];
        if (h->n_counts != b->n_bucket_ms + 1)
            continue;
        snprintf(o->name, sizeof(o->name), "%s", h->stage);
        for (size_t k = 0; k < h->n_counts; k++)
            o->counts[k] = h->counts[k];
        o->sum_ms = h->sum_ms;
        s->n_stages++;
    }
}

static void status_memory(struct airy_status_memory *o, const Airy__MemoryState *m)
{
    *o = (struct airy_status_memory){ m->ceiling, m->reserved,     m->payloads,  m->loads,   m->work,
                                      m->work_peak, m->payloads_max, m->loads_max, m->work_max };
}

static int on_status(struct airy *a, const struct conn_message *m, struct airy_error *e)
{
    const Airy__StatusReply *b = unpack(a, &airy__status_reply__descriptor, m, e);
    if (!b)
        return -1;
    if (!a->status || m->header.id != a->status_id)
        return 0; // one that was given up
    struct airy_status *s = a->status;
    *s = (struct airy_status){
        .uptime_s = b->uptime_s,
        .clients = b->clients,
        .queued = b->queued,
        .running = b->running,
        .done = b->done,
        .failed = b->failed,
        .cancelled = b->cancelled,
        .pixels = b->pixels,
        .bytes_in = b->bytes_in,
        .bytes_out = b->bytes_out,
        .rss_bytes = b->rss_bytes,
        .draining = b->draining,
        .loop_turns = b->loop_turns,
        .refused_busy = b->refused_busy,
        .loop_worst_ms = b->loop_worst_ms,
    };
    status_users(s, b);
    status_stages(s, b);
    if (b->memory)
        status_memory(&s->memory, b->memory);
    snprintf(s->server, sizeof(s->server), "%s", b->server);
    if (b->device) {
        snprintf(s->device, sizeof(s->device), "%s", b->device->name);
        snprintf(s->device_kind, sizeof(s->device_kind), "%s", b->device->kind);
        snprintf(s->driver, sizeof(s->driver), "%s", b->device->driver);
    }
    lib_times(&s->mean_ms, b->mean_ms);
    a->status = NULL;
    return 0;
}

static int on_data(struct request *r, const struct conn_message *m, struct airy_error *e)
{
    if (m->body && m->header.body_bytes)
        return lib_fail(
            e, r->output_kind == AIRY__OUTPUT__KIND__INLINE ? ENOMEM : EPROTO, "",
            "%" PRIu32 " bytes of DATA for request %" PRIu64
            " cannot be taken: no memory, more than the largest frame, or output that is not inline",
            m->header.body_bytes, r->id);
    r->got_bytes += m->header.body_bytes;
    return 0;
}

static int on_progress(struct airy *a, struct request *r, const struct conn_message *m,
                       struct airy_error *e)
{
    const Airy__Progress *b = unpack(a, &airy__progress__descriptor, m, e);
    if (!b)
        return -1;
    if (r && !r->ended && r->progress)
        r->progress(r->progress_ctx, r->id, b->stage, b->fraction);
    return 0;
}

static int on_credit(struct airy *a, const struct conn_message *m, struct airy_error *e)
{
    const Airy__Credit *b = unpack(a, &airy__credit__descriptor, m, e);
    if (!b)
        return -1;
    a->credit_bytes += b->bytes < UINT64_MAX - a->credit_bytes ? b->bytes : UINT64_MAX - a->credit_bytes;
    return 0;
}

static void on_result(struct request *r, const struct conn_message *m)
{
    struct airy_error e;
    end_request(r, lib_result_make(r, m, &e) < 0 ? &e : NULL);
}

static int on_kept(struct airy *a, struct request *r, const struct conn_message *m, struct airy_error *e)
{
    const Airy__AssetKept *b = unpack(a, &airy__asset_kept__descriptor, m, e);
    if (!b)
        return -1;
    if (strlen(b->digest) >= sizeof(r->kept->digest))
        return lib_fail(e, EPROTO, "digest", "the daemon's digest has %zu characters, 32 are expected",
                        strlen(b->digest));
    strcpy(r->kept->digest, b->digest);
    r->kept->width = b->width;
    r->kept->height = b->height;
    r->is_kept = true;
    end_request(r, NULL);
    return 0;
}

// Of a message for a request: is it open, and may it end, or go on, so?
static bool may_come(const struct request *r, enum wire_type type)
{
    bool is_asset = r && r->kind == REQUEST_ASSET;
    if (type == WIRE_RESULT || type == WIRE_DATA)
        return r && !r->ended && !is_asset;
    if (type == WIRE_ASSET_KEPT)
        return r && !r->ended && is_asset;
    return type != WIRE_WALL_REPLY && (type != WIRE_CANCELLED || (r && !r->ended));
}

// 0, or -1 and *e: the connection is to be lost. The message's descriptors are taken in every case.
static int on_message(struct airy *a, const struct conn_message *m, struct airy_error *e)
{
    uint64_t id = m->header.id;
    enum wire_type type = m->header.type;
    if (type == WIRE_ERROR)
        return on_error(a, m, e);
    if (!a->welcome && type == WIRE_WELCOME)
        return on_welcome(a, m, e);
    int wall = a->welcome ? lib_wall_message(a, m, e) : 0;
    if (wall)
        return wall < 0 ? -1 : 0;
    struct request *r = find(a->open, id);
    if (r && !r->sent)
        r = NULL; // not this daemon's
    if (!a->welcome || type == WIRE_WELCOME || !may_come(r, type)) {
        for (unsigned i = 0; i < m->header.n_fds; i++)
            close(m->fds[i]);
        return lib_fail(e, EPROTO, "", "the daemon sent %s for id %" PRIu64 ", which may not come %s",
                        wire_type_name(type), id, a->welcome ? "now" : "before WELCOME");
    }
    switch (type) {
    case WIRE_RESULT:
        on_result(r, m);
        return 0;
    case WIRE_CANCELLED:
        end_request(r, &lib_cancelled);
        return 0;
    case WIRE_ASSET_KEPT:
        return on_kept(a, r, m, e);
    case WIRE_DATA:
        return on_data(r, m, e);
    case WIRE_STATUS_REPLY:
        return on_status(a, m, e);
    case WIRE_CREDIT:
        return on_credit(a, m, e);
    case WIRE_PROGRESS:
        return on_progress(a, r, m, e);
    default: // wire_decode lets no client's message through
        return lib_fail(e, EPROTO, "", "the daemon sent %s", wire_type_name(type));
    }
}

// ---- the pump ------------------------------------------------------------------------------------

// 0: the connection may have been lost, and come back; -1: it is lost for good.
static int exchange(struct airy *a)
{
    struct airy_error e;
    struct fault f;
    struct conn_message m;
    // A peer that refuses our bytes may have sent the reason first: look before giving up.
    int written = conn_flush(a->conn);
    int got = conn_read(a->conn, READ_BYTES), next;
    while ((next = conn_next(a->conn, &m, &f)) == 1)
        if (on_message(a, &m, &e) < 0)
            return lib_lose(a, &e);
    if (next < 0) {
        lib_fail(&e, EPROTO, f.field, "from the daemon: %s", f.text);
        return lib_lose(a, &e);
    }
    int err = got < 0 ? got : got == 0 && written < 0 ? written : 0;
    if (!err)
        return 0;
    if (err == -EPIPE || err == -ECONNRESET) {
        lib_fail(&e, -err, "", "the daemon closed the connection%s",
                 a->open ? " while requests were open" : "");
        e.retryable = true;
    } else {
        lib_fail(&e, -err, "", "the connection failed: %s", strerror(-err));
    }
    return lib_lose(a, &e);
}

int lib_step(struct airy *a)
{
    if (!a->final)
        lib_away_step(a);
    if (a->conn)
        exchange(a);
    if (a->conn)
        lib_drained(a);
    if (lib_up(a)) {
        lib_send_waiting(a);
        if (a->conn)
            conn_flush(a->conn); // a failure is still there the next time, with its reason
    }
    lib_watch(a);
    return a->final ? -1 : 0;
}

int lib_step_until(struct airy *a, int64_t deadline_ms)
{
    if (a->final)
        return -1;
    int64_t due_ms = lib_due_ms(a), until_ms = deadline_ms;
    if (due_ms >= 0 && (until_ms < 0 || due_ms < until_ms))
        until_ms = due_ms;
    int64_t left_ms = until_ms < 0 ? -1 : until_ms - lib_now_ms();
    if (until_ms >= 0 && left_ms < 0)
        left_ms = 0;
    struct pollfd p = { .fd = a->conn ? conn_fd(a->conn) : -1,
                        .events = (short)(POLLIN | (a->conn && conn_wants_write(a->conn) ? POLLOUT : 0)) };
    poll(&p, 1, left_ms > INT32_MAX ? INT32_MAX : (int)left_ms);
    if (lib_step(a) < 0)
        return -1;
    // Also with more to read or write: a busy peer must not stretch the caller's time.
    return deadline_ms >= 0 && lib_now_ms() >= deadline_ms;
}

int airy_pump(struct airy *a, struct airy_error *e)
{
    return lib_step(a) < 0 ? lib_copy_error(e, &a->lost) : 0;
}

int airy_fd(const struct airy *a)
{
    if (a->final)
        return -1;
    return a->again.watch_fd >= 0 ? a->again.watch_fd : conn_fd(a->conn);
}

short airy_events(const struct airy *a)
{
    if (a->final)
        return 0;
    bool writes = a->again.watch_fd < 0 && conn_wants_write(a->conn);
    return (short)(POLLIN | (writes ? POLLOUT : 0));
}

// ---- the connection's facts and its end ------------------------------------------------------------

void airy_close(struct airy *a)
{
    if (!a)
        return;
    lib_lose(a, &(struct airy_error){ .code = -ECANCELED, .symbol = "LOCAL" });
    while (a->done) {
        struct request *r = a->done;
        a->done = r->next;
        lib_request_free(r);
    }
    body_arena_finish(&a->arena);
    lib_again_finish(a);
    free(a);
}

const char *airy_server(const struct airy *a) { return a->server; }
const char *airy_device(const struct airy *a) { return a->device; }
const struct airy_limits *airy_limits(const struct airy *a) { return &a->limits; }

// ---- waiting -------------------------------------------------------------------------------------

// 1 or -1 as airy_wait returns; frees r.
static int hand_out(struct airy *a, struct request *r, struct airy_result **out, struct airy_error *e)
{
    unlink_request(&a->done, r);
    int rc = r->result || r->is_kept ? 1 : lib_copy_error(e, &r->error);
    if (r->result && out) {
        *out = r->result;
        r->result = NULL;
    }
    lib_request_free(r);
    return rc;
}

static int wait_for(struct airy *a, uint64_t *id, int timeout_ms, struct airy_result **out,
                    struct airy_error *e)
{
    int64_t deadline_ms = lib_deadline_ms(timeout_ms);
    bool up = false;
    lib_step(a);
    for (;;) {
        struct request *r = *id ? find(a->done, *id) : a->done;
        if (r) {
            *id = r->id;
            return hand_out(a, r, out, e);
        }
        if (a->final)
            return lib_copy_error(e, &a->lost);
        if (*id ? !find(a->open, *id) : !a->open)
            return *id ? lib_fail(e, ENOENT, "id", "there is no request %" PRIu64 " to wait for", *id)
                       : lib_fail(e, ENOENT, "id", "there is no request to wait for");
        if (up)
            return 0;
        up = lib_step_until(a, deadline_ms) > 0;
    }
}

int airy_wait(struct airy *a, uint64_t id, int timeout_ms, struct airy_result **out,
              struct airy_error *e)
{
    return wait_for(a, &id, timeout_ms, out, e);
}

int airy_wait_any(struct airy *a, int timeout_ms, uint64_t *id, struct airy_result **out,
                  struct airy_error *e)
{
    uint64_t any = 0;
    int rc = wait_for(a, &any, timeout_ms, out, e);
    if (id)
        *id = any;
    return rc;
}

int airy_status(struct airy *a, struct airy_status *out, int timeout_ms, struct airy_error *e)
{
    int64_t deadline_ms = lib_deadline_ms(timeout_ms);
    struct airy_status status;
    if (lib_wait_up(a, deadline_ms, e) < 0)
        return -1;
    uint64_t id = a->next_id++, serial = a->again.serial;
    int err = body_send(a->conn, WIRE_STATUS, id, NULL, NULL, 0);
    if (err)
        return lib_fail(e, -err, "", "STATUS: %s", strerror(-err));
    a->status_id = id;
    a->status = &status;
    lib_step(a);
    for (bool up = false; a->status && lib_up(a) && a->again.serial == serial && !up;)
        up = lib_step_until(a, deadline_ms) > 0;
    bool answered = !a->status;
    a->status = NULL;
    if (answered) {
        *out = status;
        return 0;
    }
    if (!lib_up(a) || a->again.serial != serial)
        return lib_copy_error(e, &a->lost);
    return lib_fail(e, ETIMEDOUT, "", "the daemon did not answer STATUS in %d ms", timeout_ms);
}
