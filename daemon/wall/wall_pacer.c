// SPDX-License-Identifier: Apache-2.0
// wall_pacer.c - see wall_pacer.h. Invariant: the queue is sorted, its pictures due at the last push are at most one.
#include <assert.h>
#include <math.h>
#include <string.h>

#include "wall_pacer.h"

static const uint64_t second_ns = 1000000000;

void pacer_init(struct pacer *p, uint64_t start_ns, double rate, double hold_s, double fade_s)
{
    const uint64_t live_ns = (uint64_t)(fmax(2 / rate, 0.1) * 1e9), hold_ns = (uint64_t)llrint(hold_s * 1e9);
    *p = (struct pacer){ .start_ns = start_ns, .rate = rate, .live_ns = live_ns,
                         .hold_ns = hold_ns > live_ns ? hold_ns : live_ns, .fade_ns = (uint64_t)llrint(fade_s * 1e9),
                         .free = (1u << PACER_SLOTS) - 1 };
}

uint64_t pacer_time_ns(const struct pacer *p, uint64_t tick)
{
    // In whole seconds and a rest, so that a rate like 60 is exact for years.
    const double seconds = floor((double)tick / p->rate);
    const double rest = (double)tick - seconds * p->rate;
    return p->start_ns + (uint64_t)seconds * second_ns + (uint64_t)llrint(rest / p->rate * 1e9);
}

/* ---- slots and queue ----------------------------------------------------------------------------------- */

int pacer_take(struct pacer *p)
{
    if (!p->free)
        return -1;
    const int slot = __builtin_ctz(p->free);
    p->free &= ~(1u << slot);
    return slot;
}

static void release(struct pacer *p, int slot)
{
    assert(slot >= 0 && slot < PACER_SLOTS && !(p->free >> slot & 1));
    p->free |= 1u << slot;
}

void pacer_give(struct pacer *p, int slot)
{
    release(p, slot);
    p->pictures++;
    p->dropped++;
}

static void drop(struct pacer *p, unsigned i)
{
    release(p, p->queue[i].slot);
    p->waiting--;
    memmove(&p->queue[i], &p->queue[i + 1], (p->waiting - i) * sizeof(p->queue[0]));
    p->dropped++;
}

static bool due(const struct pacer_picture *q, uint64_t now_ns) { return q->soon || q->time_ns <= now_ns; }

/* How many of the queue are due. One for the next tick counts even when its tick's time lies before it, and with it
 * what it is newer than. */
static unsigned due_count(const struct pacer *p, uint64_t now_ns)
{
    unsigned n = p->waiting;
    while (n > 0 && !due(&p->queue[n - 1], now_ns))
        n--;
    return n;
}

static void drop_older_due(struct pacer *p, uint64_t now_ns)
{
    for (unsigned n = due_count(p, now_ns); n > 1; n--)
        drop(p, 0);
}

static void insert(struct pacer *p, struct pacer_picture q)
{
    unsigned i = p->waiting;
    assert(p->waiting < PACER_QUEUE);
    for (; i > 0 && p->queue[i - 1].time_ns > q.time_ns; i--)
        p->queue[i] = p->queue[i - 1];
    p->queue[i] = q;
    p->waiting++;
}

void pacer_push(struct pacer *p, int slot, uint64_t now_ns, uint64_t present_ns, double exposure)
{
    const struct pacer_picture q = { .slot = slot, .soon = present_ns == 0, .time_ns = present_ns ? present_ns : now_ns,
                                     .number = p->pictures++, .exposure = exposure };
    drop_older_due(p, now_ns);
    const unsigned ready = due_count(p, now_ns);
    const unsigned later = p->waiting - ready;
    if (!due(&q, now_ns) && later == WALL_WAITING_MAX) {
        if (q.time_ns < p->queue[ready].time_ns) { // it is the oldest itself
            release(p, slot);
            p->dropped++;
            return;
        }
        drop(p, ready);
    } else if (due(&q, now_ns) && ready && p->queue[0].time_ns > q.time_ns) { // late, and what is due is newer
        release(p, slot);
        p->dropped++;
        return;
    } else if (due(&q, now_ns) && ready) {
        drop(p, 0);
    }
    insert(p, q);
}

/* ---- ticks ----------------------------------------------------------------------------------------------- */

static bool straggler(const struct pacer *p, const struct pacer_picture *q)
{
    return p->started && q->time_ns < p->current.time_ns && p->current.time_ns - q->time_ns <= second_ns;
}

static void take_newest(struct pacer *p, uint64_t time_ns)
{
    drop_older_due(p, time_ns);
    if (!due_count(p, time_ns))
        return;
    if (straggler(p, &p->queue[0])) {
        drop(p, 0);
        return;
    }
    if (p->started)
        release(p, p->current.slot);
    p->current = p->queue[0];
    p->current_ns = time_ns;
    p->started = true;
    p->waiting--;
    memmove(&p->queue[0], &p->queue[1], p->waiting * sizeof(p->queue[0]));
    if (p->pattern)
        p->dropped++;
    else
        p->shown++;
}

static void show_current(const struct pacer *p, uint64_t time_ns, struct pacer_tick *out)
{
    if (!p->started)
        return;
    const uint64_t age_ns = time_ns - p->current_ns;
    out->exposure = p->current.exposure;
    out->slot = p->current.slot;
    out->fade = 1;
    if (age_ns <= p->live_ns) {
        out->source = WALL_LIVE;
    } else if (age_ns <= p->hold_ns) {
        out->source = WALL_HELD;
    } else if (age_ns - p->hold_ns < p->fade_ns) {
        out->source = WALL_FADING;
        out->fade = 1 - (double)(age_ns - p->hold_ns) / (double)p->fade_ns;
    } else {
        out->source = WALL_BLACK;
        out->slot = -1;
        out->fade = 0;
    }
}

/* The last tick that is at most a period late; ticks before it are left out. */
static void skip_missed(struct pacer *p, uint64_t now_ns)
{
    const uint64_t late_ns = now_ns - pacer_time_ns(p, p->next);
    const double periods = (double)late_ns * 1e-9 * p->rate;
    uint64_t tick = p->next + (periods > 2 ? (uint64_t)periods - 2 : 0);
    while (now_ns > pacer_time_ns(p, tick + 1))
        tick++;
    p->ticks_missed += tick - p->next;
    p->next = tick;
}

bool pacer_run(struct pacer *p, uint64_t now_ns, struct pacer_tick *out)
{
    if (now_ns < pacer_time_ns(p, p->next))
        return false;
    skip_missed(p, now_ns);
    const uint64_t time_ns = pacer_time_ns(p, p->next);
    *out = (struct pacer_tick){ .tick = p->next, .time_ns = time_ns, .source = WALL_NONE, .slot = -1 };
    take_newest(p, time_ns);
    show_current(p, time_ns, out);
    if (p->pattern)
        *out = (struct pacer_tick){ .tick = p->next, .time_ns = time_ns, .source = WALL_PATTERN, .slot = -1, .fade = 1 };
    p->next++;
    p->ticks++;
    return true;
}

const char *wall_source_name(enum wall_source s)
{
    static const char *const name[] = { "none", "live", "held", "fading", "black", "pattern" };
    return name[s];
}
