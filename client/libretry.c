// SPDX-License-Identifier: Apache-2.0
//
// libretry.c - a lost connection: made anew, or not, and what becomes of the requests that were open.
//
// The invariant: an open request is never in two daemons' hands, ends exactly once, and is sent at most TRIES_MAX times to
// daemons that went away with it; and the time without a daemon, between two ends of requests, is bounded by limit_ms. So
// everything ends, whatever the daemons do. Why the pauses grow: a daemon that comes up slowly is not helped by being asked.
#include "lib_internal.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/timerfd.h>
#include <unistd.h>

enum { TRIES_MAX = 3, LIMIT_MS = 30000, PAUSE_FIRST_MS = 20, PAUSE_MAX_MS = 1000 };

bool lib_up(const struct airy *a) { return a->conn && a->welcome; }

static bool comes_back(const struct airy *a) { return a->again.path[0] && a->again.limit_ms; }

// ---- airy_fd ---------------------------------------------------------------------------------------
//
// One descriptor for the connection's whole life: that of a conn may get the number of the one before it, and then an event loop that
// uses epoll could not tell that it has to be added again.

int lib_again_init(struct airy *a, const char *path, struct airy_error *e)
{
    struct again *g = &a->again;
    struct epoll_event timer = { .events = EPOLLIN };
    snprintf(g->path, sizeof(g->path), "%s", path); // a path that was connected to has room
    g->limit_ms = LIMIT_MS;
    g->left_ms = LIMIT_MS;
    g->watch_fd = epoll_create1(EPOLL_CLOEXEC);
    if (g->watch_fd >= 0)
        g->timer_fd = timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK);
    if (g->watch_fd < 0 || g->timer_fd < 0 || epoll_ctl(g->watch_fd, EPOLL_CTL_ADD, g->timer_fd, &timer) < 0)
        return lib_fail(e, errno, "", "a descriptor for an event loop: %s", strerror(errno));
    lib_watch(a);
    return 0;
}

void lib_again_finish(struct airy *a)
{
    if (a->again.timer_fd >= 0)
        close(a->again.timer_fd);
    if (a->again.watch_fd >= 0)
        close(a->again.watch_fd);
}

int64_t lib_due_ms(const struct airy *a)
{
    const struct again *g = &a->again;
    if (!g->away) // asleep, and something needs it: now
        return !a->final && !a->conn && (a->open || g->wanted) ? 0 : -1;
    return a->conn || g->next_ms > g->end_ms ? g->end_ms : g->next_ms;
}

void lib_watch(struct airy *a)
{
    struct again *g = &a->again;
    if (g->watch_fd < 0)
        return;
    uint32_t want = !a->conn ? 0 : conn_wants_write(a->conn) ? EPOLLIN | EPOLLOUT : EPOLLIN;
    struct epoll_event event = { .events = want };
    if (want != g->watched && epoll_ctl(g->watch_fd, g->watched ? EPOLL_CTL_MOD : EPOLL_CTL_ADD, conn_fd(a->conn), &event) == 0)
        g->watched = want;
    int64_t due_ms = lib_due_ms(a);
    if (due_ms == g->timer_ms)
        return;
    // A time of 0 would stop the timer; setting it takes back that it has run out.
    struct itimerspec at = { .it_value = { due_ms < 0 ? 0 : due_ms / 1000, due_ms < 0 ? 0 : due_ms % 1000 * 1000000 + 1 } };
    if (timerfd_settime(g->timer_fd, TFD_TIMER_ABSTIME, &at, NULL) == 0)
        g->timer_ms = due_ms;
}

// ---- losing ------------------------------------------------------------------------------------------

static void drop(struct airy *a)
{
    struct again *g = &a->again;
    // Before it is closed: a copy of it in a child would keep it in the set.
    if (a->conn && g->watched)
        epoll_ctl(g->watch_fd, EPOLL_CTL_DEL, conn_fd(a->conn), NULL);
    g->watched = 0;
    g->draining = false;
    struct conn *conn = a->conn;
    a->conn = NULL;
    conn_destroy(conn);
    a->welcome = false;
    a->n_given_up = 0; // those answers can come no more
}

static void schedule(struct again *g)
{
    g->next_ms = lib_now_ms() + g->pause_ms;
    g->pause_ms = g->pause_ms ? 2 * g->pause_ms : PAUSE_FIRST_MS;
    if (g->pause_ms > PAUSE_MAX_MS)
        g->pause_ms = PAUSE_MAX_MS;
}

static void go_away(struct again *g)
{
    if (!g->away)
        g->end_ms = lib_now_ms() + g->left_ms;
    g->away = true;
    schedule(g);
}

// Is this loss one that another daemon, or the same one started again, makes good?
static bool passes(const struct airy *a, const struct airy_error *why)
{
    return why->code == -EPIPE || why->code == -ECONNRESET || why->code == FAULT_SHUTTING_DOWN || (!a->welcome && why->retryable);
}

// Is it to be sent again? If not, *end says what it ends in.
static bool stays(struct airy *a, struct request *r, const struct airy_error *why, struct airy_error *end)
{
    if (!r->sent)
        return true;
    r->sent = false;
    r->got_bytes = 0;
    *end = *why;
    end->retryable = true;
    if (r->cancelled) {
        *end = lib_cancelled;
        return false;
    }
    if (!r->again || (r->wall && a->own_walls)) {
        snprintf(end->text, sizeof(end->text), "%.200s; this request is not sent again: %s", why->text,
                 r->wall ? "its wall may have gone with the connection" : "its output is where its input was");
        return false;
    }
    // A daemon that says that it stops, or that never let us in, did not die of it.
    if (why->code == FAULT_SHUTTING_DOWN)
        return true;
    a->again.left_ms = a->again.limit_ms;
    if (++r->losses < TRIES_MAX)
        return true;
    snprintf(end->text, sizeof(end->text), "%u daemons went away while they had this request, which is not sent again (the last: %.200s)",
             r->losses, why->text);
    return false;
}

int lib_lose(struct airy *a, const struct airy_error *why)
{
    const struct airy_error copy = *why; // it may be a->lost
    const bool again = comes_back(a) && passes(a, &copy);
    struct airy_error end;
    a->lost = copy;
    if (a->again.away)
        a->again.why = copy;
    drop(a);
    for (struct request *r = a->open, *next; r; r = next) {
        next = r->next;
        if (!again)
            lib_request_end(r, &copy);
        else if (!stays(a, r, &copy, &end))
            lib_request_end(r, &end);
    }
    a->own_walls = false;
    if (!again) {
        a->final = true;
        a->again.away = false;
        return -1;
    }
    if (a->open || a->again.wanted)
        go_away(&a->again);
    else
        a->again.away = false;
    return 0;
}

bool lib_hold(struct request *r, const struct airy_error *why)
{
    struct airy *a = r->airy;
    if (why->code != FAULT_SHUTTING_DOWN || !comes_back(a) || !r->again || r->cancelled)
        return false;
    r->sent = false;
    r->got_bytes = 0;
    if (!a->again.draining)
        a->lost = *why;
    a->again.draining = true;
    return true;
}

void lib_drained(struct airy *a)
{
    if (!a->again.draining)
        return;
    for (const struct request *r = a->open; r; r = r->next)
        if (r->sent)
            return;
    const struct airy_error why = a->lost;
    lib_lose(a, &why);
}

// ---- coming back -------------------------------------------------------------------------------------

void lib_came_up(struct airy *a)
{
    struct again *g = &a->again;
    g->serial++;
    if (g->away) {
        int64_t left_ms = g->end_ms - lib_now_ms();
        g->left_ms = left_ms > 0 ? left_ms : 0;
    }
    g->away = g->wanted = false;
}

void lib_useful(struct airy *a)
{
    a->again.left_ms = a->again.limit_ms;
    a->again.pause_ms = 0;
}

static void give_up(struct airy *a)
{
    struct again *g = &a->again;
    struct airy_error e = { .code = a->lost.code < 0 ? a->lost.code : -ECONNRESET, .symbol = "LOCAL", .retryable = true };
    snprintf(e.text, sizeof(e.text), "the daemon went away (%.120s), and none has answered for %u ms (the last try: %.160s)", a->lost.text,
             g->limit_ms, *g->why.text ? g->why.text : "no answer to HELLO");
    drop(a);
    a->lost = e;
    g->away = g->wanted = false;
    lib_useful(a);
    while (a->open)
        lib_request_end(a->open, &e);
}

void lib_away_step(struct airy *a)
{
    struct again *g = &a->again;
    if (!g->away && !a->conn && (a->open || g->wanted)) {
        g->why.text[0] = '\0';
        go_away(g);
    }
    if (!g->away)
        return;
    int64_t now_ms = lib_now_ms();
    if (now_ms >= g->end_ms)
        give_up(a);
    else if (!a->conn && now_ms >= g->next_ms && lib_connect_try(a, &g->why) < 0)
        schedule(g);
}

int lib_wait_up(struct airy *a, int64_t deadline_ms, struct airy_error *e)
{
    lib_step(a);
    a->again.wanted = !a->final && !lib_up(a);
    for (bool up = false; a->again.wanted && !a->final && !up;)
        up = lib_step_until(a, deadline_ms) > 0;
    const bool late = a->again.wanted && !a->final;
    a->again.wanted = false;
    if (lib_up(a))
        return 0;
    if (!late)
        return lib_copy_error(e, &a->lost);
    lib_fail(e, ETIMEDOUT, "", "there is no daemon yet (%.200s)", a->lost.text);
    if (e)
        e->retryable = true;
    return -1;
}

void airy_set_reconnect(struct airy *a, unsigned limit_ms)
{
    struct again *g = &a->again;
    if (!g->path[0] || a->final)
        return;
    if (limit_ms > INT32_MAX)
        limit_ms = INT32_MAX;
    g->limit_ms = limit_ms;
    g->left_ms = limit_ms;
    if (!limit_ms && !lib_up(a))
        lib_lose(a, &a->lost);
    lib_watch(a);
}

uint64_t airy_serial(const struct airy *a) { return a->again.serial; }
