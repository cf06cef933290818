// SPDX-License-Identifier: Apache-2.0
/*
 * scheduler_fair.c - whose turn it is: deficit round-robin between users, then between a user's connections, in its limit of an
 * infinitely small quantum: whoever has been served least is next, and who was away is owed nothing for that time.
 *
 * What a turn costs is reckoned when it is given, from what the request declares (samples of a raw picture; of an EXR file, whose pixels
 * nobody knows before it is opened, its bytes at two a sample) times what such a sample took that connection's last frames: its plan's
 * price on this device. When the job ends, what it really took takes the estimate's place. So a user's share does not depend on how good the
 * estimate is, only how evenly it is dealt out over some frames.
 *
 * Invariant: served_ms of user and flow is the sum of charged_ms of their jobs, pending_ms of those at work. All under the lock.
 */
#include "scheduler_private.h"

#include <math.h>

enum { EXR_BYTES_PER_SAMPLE = 2, PASS_FACTOR = 8 };
static const double FIRST_MS_PER_UNIT = 1e-5, LEARNT_SHARE = 0.3;

void fair_init(struct sched *s)
{
    TAILQ_INIT(&s->users);
    s->ms_per_unit = FIRST_MS_PER_UNIT;
}

static double units_of(const struct job *j)
{
    double units = 0;
    for (unsigned i = 0; j->raw && i < j->layout.targets; i++)
        units += (double)j->layout.width * j->layout.height * j->layout.target[i].planes;
    return units > 0 ? units : fmax(1, (double)j->input.size / EXR_BYTES_PER_SAMPLE);
}

static double price(const struct sched *s, const struct sched_flow *flow)
{
    return flow->ms_per_unit > 0 ? flow->ms_per_unit : s->ms_per_unit;
}

// A flow is on its user's list as long as one of its jobs waits. Of one priority first in, first out; `first`: before the others of it.
static void line_up(struct sched_flow *flow, struct job *j, bool first)
{
    struct job *before = TAILQ_LAST(&flow->waiting, job_queue);
    if (!before)
        TAILQ_INSERT_TAIL(&flow->user->flows, flow, of_user);
    while (before && (before->priority < j->priority || (first && before->priority == j->priority)))
        before = TAILQ_PREV(before, job_queue, link);
    if (before)
        TAILQ_INSERT_AFTER(&flow->waiting, before, j, link);
    else
        TAILQ_INSERT_HEAD(&flow->waiting, j, link);
    j->linked = true;
    flow->user->queued++;
}

void fair_push(struct sched *s, struct sched_flow *flow, struct job *j)
{
    struct sched_user *u = flow->user;
    if (!u->queued && !u->running)
        u->served_ms = fmax(u->served_ms, s->virtual_ms);
    if (TAILQ_EMPTY(&flow->waiting) && !flow->running)
        flow->served_ms = fmax(flow->served_ms, u->virtual_ms);
    j->units = units_of(j);
    line_up(flow, j, false);
}

void fair_remove(struct job *j)
{
    struct sched_flow *flow = j->flow;
    TAILQ_REMOVE(&flow->waiting, j, link);
    if (TAILQ_EMPTY(&flow->waiting))
        TAILQ_REMOVE(&j->user->flows, flow, of_user);
    j->linked = false;
    j->user->queued--;
}

static struct sched_flow *flow_first(struct sched_user *u)
{
    struct sched_flow *flow, *best = NULL;
    int priority = 0;
    TAILQ_FOREACH(flow, &u->flows, of_user)
    {
        const struct job *j = TAILQ_FIRST(&flow->waiting);
        if (best && (j->priority < priority || (j->priority == priority && flow->served_ms >= best->served_ms)))
            continue;
        best = flow;
        priority = j->priority;
    }
    return best;
}

struct job *fair_first(struct sched *s, bool (*may)(struct sched *s, const struct job *j))
{
    struct sched_user *u;
    struct job *best = NULL;
    TAILQ_FOREACH(u, &s->users, link)
    {
        if (!u->queued || (best && u->served_ms >= best->user->served_ms))
            continue;
        struct sched_flow *flow = flow_first(u);
        if (flow && may(s, TAILQ_FIRST(&flow->waiting)))
            best = TAILQ_FIRST(&flow->waiting);
    }
    return best;
}

static bool passes_one(const struct job *j, double ms, const struct job *other)
{
    if (PASS_FACTOR * ms > other->charged_ms)
        return false;
    if (j->user != other->user)
        return j->user->served_ms <= other->user->served_ms;
    return !other->flow || (j->flow != other->flow && j->flow->served_ms <= other->flow->served_ms);
}

/*
 * All that is at work but what passes itself. That somebody has been served less bounds it: many small jobs one after the other pass a large
 * one until they have had as much.
 */
bool fair_passes(struct sched *s, const struct job *j)
{
    const struct sched_lane *l = &s->lane[LANE_FRAMES];
    const double ms = j->units * price(s, j->flow);
    bool any = false;
    for (unsigned i = 0; i < l->admitted; i++) {
        if (l->at_work[i]->passes)
            continue;
        if (!passes_one(j, ms, l->at_work[i]))
            return false;
        any = true;
    }
    return any;
}

static void charge(struct job *j, double ms)
{
    j->user->served_ms += ms - j->charged_ms;
    if (j->flow)
        j->flow->served_ms += ms - j->charged_ms;
    j->charged_ms = ms;
}

// Its estimate is among those of what is at work, or no more.
static void pend(struct job *j, int sign)
{
    j->user->pending_ms += sign * j->charged_ms;
    if (j->flow)
        j->flow->pending_ms += sign * j->charged_ms;
}

// Of those served alike the one who waits longest is next.
void fair_take(struct sched *s, struct job *j)
{
    struct sched_user *u = j->user;
    struct sched_flow *flow = j->flow;
    fair_remove(j);
    // Estimates of what is at work do not count here: one that is much too high, taken back later, would let newcomers begin far behind.
    s->virtual_ms = fmax(s->virtual_ms, u->served_ms - u->pending_ms);
    u->virtual_ms = fmax(u->virtual_ms, flow->served_ms - flow->pending_ms);
    u->running++;
    flow->running++;
    charge(j, j->units * price(s, flow));
    pend(j, 1);
    if (!TAILQ_EMPTY(&flow->waiting)) {
        TAILQ_REMOVE(&u->flows, flow, of_user);
        TAILQ_INSERT_TAIL(&u->flows, flow, of_user);
    }
    TAILQ_REMOVE(&s->users, u, link);
    TAILQ_INSERT_TAIL(&s->users, u, link);
}

void fair_return(struct job *j)
{
    pend(j, -1);
    charge(j, 0);
    j->user->running--;
    j->flow->running--;
    line_up(j->flow, j, true);
}

void fair_leave_flow(struct job *j)
{
    if (j->flow && !j->walled && j->stage > JOB_WAITING && j->stage < JOB_DONE)
        j->flow->running--;
    j->flow = NULL;
}

/*
 * A frame's stages overlap those of others, so what it takes from others is its longest: the device's, or, where the device has little to
 * do, the codec's.
 */
void fair_settle(struct sched *s, struct job *j)
{
    const double codec_ms = j->ms.decode + j->ms.encode, ms = fmax(j->ms.bloom, codec_ms);
    j->user->device_ms += j->ms.bloom;
    if (j->walled)
        return;
    j->user->running--;
    if (j->flow)
        j->flow->running--;
    pend(j, -1);
    charge(j, ms);
    if (j->kind != JOB_BLOOMS || !j->finished)
        return;
    const double measured = ms / j->units;
    s->ms_per_unit += LEARNT_SHARE * (measured - s->ms_per_unit);
    if (j->flow)
        j->flow->ms_per_unit = price(s, j->flow) + LEARNT_SHARE * (measured - price(s, j->flow));
}
