// SPDX-License-Identifier: Apache-2.0
/*
 * scheduler_users.c - what each user has in hand, by the socket's SO_PEERCRED: connections, requests, descriptors, bytes, time.
 *
 * A user's entry lives while it has a connection or a request; USERS_KEPT more are kept after that, for the time that they have used is
 * worth knowing. Under the lock, as everything of sched is; no call here is longer than the list of users.
 */
#include "scheduler_private.h"

#include <assert.h>
#include <errno.h>
#include <stdlib.h>

enum { USERS_KEPT = 64 };

static bool idle(const struct sched_user *u) { return !u->flows_open && !u->requests; }

// The one that has been idle longest goes.
static void trim(struct sched *s)
{
    struct sched_user *u, *oldest = NULL;
    unsigned n = 0;
    TAILQ_FOREACH(u, &s->users, link)
    {
        if (!idle(u))
            continue;
        n++;
        if (!oldest || u->idle_ns < oldest->idle_ns)
            oldest = u;
    }
    if (n <= USERS_KEPT)
        return;
    TAILQ_REMOVE(&s->users, oldest, link);
    free(oldest);
}

static void note_idle(struct sched *s, struct sched_user *u)
{
    if (!idle(u))
        return;
    u->idle_ns = clock_ns();
    trim(s);
}

static struct sched_user *user_of(struct sched *s, uid_t uid)
{
    struct sched_user *u;
    TAILQ_FOREACH(u, &s->users, link)
    if (u->uid == uid)
        return u;
    u = calloc(1, sizeof *u);
    if (!u)
        return NULL;
    u->uid = uid;
    TAILQ_INIT(&u->flows);
    TAILQ_INSERT_TAIL(&s->users, u, link);
    return u;
}

int sched_flow_open(struct sched *s, struct sched_flow *flow, uid_t uid, unsigned *connections)
{
    *flow = (struct sched_flow){ 0 };
    TAILQ_INIT(&flow->waiting);
    pthread_mutex_lock(&s->lock);
    struct sched_user *u = user_of(s, uid);
    if (u) {
        *connections = ++u->flows_open;
        s->fds++;
        flow->user = u;
    }
    pthread_mutex_unlock(&s->lock);
    return u ? 0 : -ENOMEM;
}

void sched_flow_close(struct sched *s, struct sched_flow *flow)
{
    struct sched_user *u = flow->user;
    if (!u)
        return;
    pthread_mutex_lock(&s->lock);
    assert(TAILQ_EMPTY(&flow->waiting));
    u->flows_open--;
    u->fds -= flow->fds;
    s->fds -= flow->fds + 1;
    flow->fds = 0;
    flow->user = NULL;
    note_idle(s, u);
    pthread_mutex_unlock(&s->lock);
}

unsigned sched_user_fds(struct sched *s, const struct sched_flow *flow)
{
    pthread_mutex_lock(&s->lock);
    unsigned fds = flow->user->flows_open + flow->user->fds;
    pthread_mutex_unlock(&s->lock);
    return fds;
}

static bool refuse(struct sched_refusal *r, enum sched_verdict verdict, const char *what, uint64_t found, uint64_t allowed)
{
    *r = (struct sched_refusal){ verdict, what, found, allowed };
    return false;
}

static bool may_have(const struct sched *s, const struct sched_user *u, uint64_t inline_bytes, unsigned fds, struct sched_refusal *r)
{
    const struct sched_limits *l = &s->limits;
    const unsigned of_user = u->flows_open + u->fds + fds;
    if (u->requests >= l->user_requests)
        return refuse(r, SCHED_BUSY, "requests in flight of this user", u->requests, l->user_requests);
    if (inline_bytes > l->user_inline_bytes)
        return refuse(r, SCHED_LIMIT, "payload bytes of a user", inline_bytes, l->user_inline_bytes);
    if (u->inline_bytes + inline_bytes > l->user_inline_bytes) // both far below 2^63
        return refuse(r, SCHED_BUSY, "payload bytes in flight of this user", u->inline_bytes + inline_bytes,
                      l->user_inline_bytes);
    if (fds && of_user > l->user_fds)
        return refuse(r, SCHED_BUSY, "descriptors of this user", of_user, l->user_fds);
    if (fds && s->fds + fds > l->fds)
        return refuse(r, SCHED_BUSY, "descriptors in the daemon", s->fds + fds, l->fds);
    return true;
}

bool sched_hold(struct sched *s, struct sched_flow *flow, struct job *j, uint64_t inline_bytes, unsigned fds,
                struct sched_refusal *r)
{
    struct sched_user *u = flow->user;
    pthread_mutex_lock(&s->lock);
    bool held = may_have(s, u, inline_bytes, fds, r);
    if (held) {
        u->requests++;
        u->inline_bytes += inline_bytes;
        u->fds += fds;
        s->fds += fds;
        j->user = u;
        j->input_held = inline_bytes;
        j->fds_held = fds;
    }
    pthread_mutex_unlock(&s->lock);
    return held;
}

void sched_drop(struct sched *s, struct job *j)
{
    struct sched_user *u = j->user;
    if (!u)
        return;
    pthread_mutex_lock(&s->lock);
    room_give(s, j, 0);
    u->requests--;
    u->inline_bytes -= j->input_held;
    u->fds -= j->fds_held;
    s->fds -= j->fds_held;
    j->user = NULL;
    note_idle(s, u);
    pthread_mutex_unlock(&s->lock);
}

void sched_fd_keep(struct sched *s, struct sched_flow *flow, struct job *j)
{
    assert(j->fds_held && j->user == flow->user);
    pthread_mutex_lock(&s->lock);
    j->fds_held--;
    flow->fds++;
    pthread_mutex_unlock(&s->lock);
}

void sched_fds_sent(struct sched *s, struct sched_flow *flow, unsigned n)
{
    pthread_mutex_lock(&s->lock);
    assert(n <= flow->fds);
    flow->fds -= n;
    flow->user->fds -= n;
    s->fds -= n;
    pthread_mutex_unlock(&s->lock);
}

unsigned sched_users(struct sched *s, struct sched_user_facts out[SCHED_USERS_SHOWN])
{
    struct sched_user *u;
    unsigned n = 0;
    pthread_mutex_lock(&s->lock);
    // Who is here first, then who was.
    for (int here = 1; here >= 0; here--)
        TAILQ_FOREACH(u, &s->users, link)
        if (idle(u) != here && n < SCHED_USERS_SHOWN)
            out[n++] = (struct sched_user_facts){ .uid = u->uid,
                                                  .connections = u->flows_open,
                                                  .requests = u->requests,
                                                  .queued = u->queued,
                                                  .running = u->running,
                                                  .fds = u->flows_open + u->fds,
                                                  .bytes = u->inline_bytes + u->work,
                                                  .device_ms = u->device_ms };
    pthread_mutex_unlock(&s->lock);
    return n;
}

void users_finish(struct sched *s)
{
    struct sched_user *u;
    while ((u = TAILQ_FIRST(&s->users))) {
        TAILQ_REMOVE(&s->users, u, link);
        free(u);
    }
}
