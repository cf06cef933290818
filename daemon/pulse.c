// SPDX-License-Identifier: Apache-2.0
// pulse.c - see pulse.h.
#include "pulse.h"

#include <stddef.h>
#include <time.h>

static _Thread_local struct pulse *mine;

// The same clock as metrics.h's clock_ns(), which the engine does not know.
static uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000 + (uint64_t)t.tv_nsec;
}

void pulse_begin(struct pulse *p)
{
    mine = p;
    pulse_beat();
}

void pulse_beat(void)
{
    if (mine)
        atomic_store_explicit(&mine->since_ns, now_ns(), memory_order_relaxed);
}

void pulse_end(void)
{
    if (mine)
        atomic_store_explicit(&mine->since_ns, 0, memory_order_relaxed);
    mine = NULL;
}

uint64_t pulse_since_ns(struct pulse *p) { return atomic_load_explicit(&p->since_ns, memory_order_relaxed); }
