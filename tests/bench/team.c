// SPDX-License-Identifier: Apache-2.0
// team.c - two threads that start and end a piece of work together. The second sleeps in between, so
// that what is measured in other processes has both cores.
#include <pthread.h>
#include <stdlib.h>

#include "bench.h"

struct team {
    pthread_t other;
    pthread_barrier_t begin, end, middle;
    void (*fn)(void *ctx, unsigned member); /* NULL: to stop */
    void *ctx;
};

static void *other_run(void *arg)
{
    struct team *t = arg;
    for (;;) {
        pthread_barrier_wait(&t->begin);
        if (!t->fn)
            return NULL;
        t->fn(t->ctx, 1);
        pthread_barrier_wait(&t->end);
    }
}

struct team *team_create(void)
{
    struct team *t = take(1, sizeof(*t));
    if (pthread_barrier_init(&t->begin, NULL, TEAM) || pthread_barrier_init(&t->end, NULL, TEAM) ||
        pthread_barrier_init(&t->middle, NULL, TEAM) || pthread_create(&t->other, NULL, other_run, t))
        die("no second thread");
    return t;
}

void team_destroy(struct team *t)
{
    t->fn = NULL;
    pthread_barrier_wait(&t->begin);
    pthread_join(t->other, NULL);
    pthread_barrier_destroy(&t->begin);
    pthread_barrier_destroy(&t->end);
    pthread_barrier_destroy(&t->middle);
    free(t);
}

void team_run(struct team *t, void (*fn)(void *ctx, unsigned member), void *ctx)
{
    t->fn = fn;
    t->ctx = ctx;
    pthread_barrier_wait(&t->begin);
    fn(ctx, 0);
    pthread_barrier_wait(&t->end);
}

void team_meet(struct team *t) { pthread_barrier_wait(&t->middle); }
