// SPDX-License-Identifier: Apache-2.0
// crew.c - see crew.h. Invariant: fn, ctx and count change only while every helper waits for the next
// turn, under the lock; so helpers read them without it once they have seen the turn.
#include "crew.h"

#include "pulse.h"

#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>

struct helper {
    struct crew *crew;
    unsigned member;
    pthread_t thread;
};

struct crew {
    unsigned members, started;
    struct helper helper[CREW_MAX];
    pthread_mutex_t lock;
    pthread_cond_t begin, end;
    unsigned turn, busy;
    bool stop;
    unsigned count;
    atomic_uint next;
    void (*fn)(void *ctx, unsigned task, unsigned member);
    void *ctx;
};

static void work(struct crew *c, unsigned member)
{
    for (;;) {
        const unsigned task = atomic_fetch_add_explicit(&c->next, 1, memory_order_relaxed);
        if (task >= c->count)
            return;
        c->fn(c->ctx, task, member);
        pulse_beat();
    }
}

static void *helper_main(void *arg)
{
    struct helper *h = arg;
    struct crew *c = h->crew;
    unsigned seen = 0;
    pthread_mutex_lock(&c->lock);
    for (;;) {
        while (c->turn == seen && !c->stop)
            pthread_cond_wait(&c->begin, &c->lock);
        if (c->stop)
            break;
        seen = c->turn;
        pthread_mutex_unlock(&c->lock);
        work(c, h->member);
        pthread_mutex_lock(&c->lock);
        if (--c->busy == 0)
            pthread_cond_signal(&c->end);
    }
    pthread_mutex_unlock(&c->lock);
    return NULL;
}

int crew_create(struct crew **out, unsigned threads)
{
    struct crew *c = calloc(1, sizeof(*c));
    if (!c)
        return -ENOMEM;
    c->members = threads < 1 ? 1 : threads > CREW_MAX ? CREW_MAX : threads;
    pthread_mutex_init(&c->lock, NULL);
    pthread_cond_init(&c->begin, NULL);
    pthread_cond_init(&c->end, NULL);
    for (unsigned i = 1; i < c->members; i++) {
        struct helper *h = &c->helper[i];
        *h = (struct helper){ .crew = c, .member = i };
        const int err = pthread_create(&h->thread, NULL, helper_main, h);
        if (err) {
            crew_destroy(c);
            return -err;
        }
        c->started++;
    }
    *out = c;
    return 0;
}

void crew_destroy(struct crew *c)
{
    if (!c)
        return;
    pthread_mutex_lock(&c->lock);
    c->stop = true;
    pthread_cond_broadcast(&c->begin);
    pthread_mutex_unlock(&c->lock);
    for (unsigned i = 1; i <= c->started; i++)
        pthread_join(c->helper[i].thread, NULL);
    pthread_cond_destroy(&c->end);
    pthread_cond_destroy(&c->begin);
    pthread_mutex_destroy(&c->lock);
    free(c);
}

unsigned crew_members(const struct crew *c) { return c->members; }

void crew_run(struct crew *c, unsigned count, void (*fn)(void *ctx, unsigned task, unsigned member),
              void *ctx)
{
    pthread_mutex_lock(&c->lock);
    c->fn = fn;
    c->ctx = ctx;
    c->count = count;
    c->busy = c->started;
    atomic_store_explicit(&c->next, 0, memory_order_relaxed);
    c->turn++;
    pthread_cond_broadcast(&c->begin);
    pthread_mutex_unlock(&c->lock);
    work(c, 0);
    pthread_mutex_lock(&c->lock);
    while (c->busy)
        pthread_cond_wait(&c->end, &c->lock);
    pthread_mutex_unlock(&c->lock);
}
