// SPDX-License-Identifier: Apache-2.0
// cmd_wall_clock.c - see cmd_wall_clock.h.
#include "cmd_wall_clock.h"

#include <math.h>

uint64_t play_ahead_ns(double fps)
{
    double ns = PLAY_IN_FLIGHT * 1e9 / fps;
    return (uint64_t)(ns < 5e8 ? ns : 5e8);
}

uint64_t play_due_ns(const struct play_clock *c, uint64_t k)
{
    return c->start_ns + (uint64_t)llrint((double)k * (1e9 / c->fps));
}

void play_start(struct play_clock *c, uint64_t now_ns)
{
    c->start_ns = 0;
    c->start_ns = now_ns + c->ahead_ns - play_due_ns(c, c->next);
}

/* The first frame that is due at or after now. */
static uint64_t first_due(const struct play_clock *c, uint64_t now_ns)
{
    uint64_t k = c->next;
    if (play_due_ns(c, k) >= now_ns)
        return k;
    double at = (double)(now_ns - c->start_ns) * (c->fps / 1e9);
    k = at > (double)k + 1 ? (uint64_t)at - 1 : k;
    k = k > c->next ? k : c->next;
    while (play_due_ns(c, k) < now_ns)
        k++;
    return k;
}

enum play_step play_next(struct play_clock *c, uint64_t now_ns, unsigned in_flight, uint64_t *k, uint64_t *until_ns)
{
    *until_ns = UINT64_MAX;
    if (!c->loop && c->next >= c->count)
        return PLAY_OVER;
    if (in_flight >= PLAY_IN_FLIGHT)
        return PLAY_WAIT;
    uint64_t first = first_due(c, now_ns);
    if (!c->loop && first > c->count)
        first = c->count;
    c->skipped += first - c->next;
    c->next = first;
    if (!c->loop && first == c->count)
        return PLAY_OVER;
    uint64_t due_ns = play_due_ns(c, first);
    if (due_ns > now_ns + c->ahead_ns) {
        *until_ns = due_ns - c->ahead_ns;
        return PLAY_WAIT;
    }
    *k = first;
    c->next++;
    return PLAY_SEND;
}
