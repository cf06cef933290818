// SPDX-License-Identifier: Apache-2.0
/*
 * scheduler_room.c - memory of what is at work, under a ceiling, by declared size: taken here before it is allocated there.
 *
 * Two kinds. `load`: payloads that are read from descriptors, taken when a job gets its turn. `work`: planes, what the codec unpacks
 * and packs, the result, and what the engine keeps beside planes, taken when the job is opened and its sizes are known; without room it is parked, and
 * while one is parked nobody else gets a turn. A load is never held by what waits for another load, nor work by what waits for work, so whoever
 * has work ends and gives it back: nothing waits for ever. What could not fit into an empty daemon is LIMIT.
 *
 * What of work is a user's is held to the user's share in the same place. Who comes to that limit does not park, for others would wait behind
 * it, perhaps for results that its client does not read: it goes back into its line with nothing held, and is opened again when there is room.
 *
 * Planes and what the engine keeps stay with their slot and lane after the job, for the next frame of that size; without room for another size the
 * device thread frees those of idle slots first.
 *
 * Jobs of walls are counted and never wait: they must not stand behind a farm's frames. All under the lock.
 */
#include "scheduler_private.h"

#include <assert.h>
#include <stddef.h>
#include <string.h>

static uint64_t texels16(uint64_t samples, enum pixel_type type) { return (samples * pixel_bytes(type) + 15) / 16 * 16; }

// As bloom_targets.c makes them: rows of whole 16-byte texels; outputs in four phases of rows.
uint64_t room_planes_bytes(unsigned count, const struct bloom_geometry *g)
{
    uint64_t bytes = 0;
    for (unsigned i = 0; i < count; i++) {
        const uint64_t width = g[i].width + 2ull * g[i].grow, height = g[i].height + 2ull * g[i].grow;
        const uint64_t row = texels16(width, g[i].type) * g[i].channels;
        bytes += row * height + row * ((height + 3) / 4 * 4) * g[i].outputs;
    }
    return bytes;
}

static uint64_t sum_of(const uint64_t keep[BLOOM_KEEPS])
{
    uint64_t sum = 0;
    for (unsigned i = 0; i < BLOOM_KEEPS; i++)
        sum += keep[i];
    return sum;
}

static void most_of(uint64_t keep[BLOOM_KEEPS], const uint64_t other[BLOOM_KEEPS])
{
    for (unsigned i = 0; i < BLOOM_KEEPS; i++)
        keep[i] = other[i] > keep[i] ? other[i] : keep[i];
}

static void work_add(struct sched *s, uint64_t bytes)
{
    s->room.work += bytes;
    if (s->room.work > s->room.work_peak)
        s->room.work_peak = s->room.work;
}

static void job_add(struct sched *s, struct job *j, uint64_t bytes)
{
    work_add(s, bytes);
    j->work_held += bytes;
    if (j->user)
        j->user->work += bytes;
}

static void job_sub(struct sched *s, struct job *j, uint64_t bytes)
{
    assert(bytes <= j->work_held && bytes <= s->room.work);
    s->room.work -= bytes;
    j->work_held -= bytes;
    if (j->user)
        j->user->work -= bytes;
}

void room_give(struct sched *s, struct job *j, uint64_t keep)
{
    const bool more = j->keeping || j->load_held || j->work_held > keep;
    if (j->keeping)
        s->room.keeping = j->keeping = false;
    s->room.load -= j->load_held;
    j->load_held = 0;
    if (j->work_held > keep)
        job_sub(s, j, j->work_held - keep);
    else // an output that is larger than was thought: it is there
        job_add(s, j, keep - j->work_held);
    if (!more)
        return;
    sched_room_freed(s);
    pthread_cond_broadcast(&s->pool_wake); // a user's turn may have waited for this
}

// ---- a turn: the payload -----------------------------------------------------------------------------

static uint64_t load_of(const struct job *j)
{
    bool copied = j->input.kind == PAYLOAD_FILE || (j->input.kind == PAYLOAD_MEMFD && !j->raw);
    return copied ? j->input.size : 0;
}

bool room_may_turn(struct sched *s, const struct job *j)
{
    const struct sched_user *u = j->user;
    if (j->kind == JOB_KEEPS && s->room.keeping)
        return false;
    // One at a time goes beyond what a user may have: a frame that fits the daemon is done.
    if (u->work && (u->work >= s->limits.user_work_bytes || u->work + j->work_known > s->limits.user_work_bytes))
        return false;
    return !s->room.load || s->room.load + load_of(j) <= s->limits.load_bytes;
}

void room_turn(struct sched *s, struct job *j)
{
    j->load_held = load_of(j);
    s->room.load += j->load_held;
    if (j->kind == JOB_KEEPS)
        s->room.keeping = j->keeping = true;
}

// ---- opened: all else ----------------------------------------------------------------------------------

struct want {
    unsigned count;
    struct bloom_geometry g[BLOOM_TARGETS_MAX];
    uint64_t planes, keep[BLOOM_KEEPS], work, all;
};

static void want_of(const struct sched *s, const struct job *j, struct want *w)
{
    w->count = job_geometry(j, w->g);
    w->planes = room_planes_bytes(w->count, w->g);
    job_keep_bytes(j, s->device.threads, w->keep);
    w->work = job_work_bytes(j);
    w->all = w->planes + sum_of(w->keep) + w->work;
}

bool sched_fits(const struct sched *s, const struct job *j, uint64_t *bytes)
{
    struct want w;
    want_of(s, j, &w);
    *bytes = w.all;
    return *bytes <= s->limits.work_bytes;
}

static bool same_geometry(const struct sched_slot *slot, const struct want *w)
{
    if (!slot->prepared || slot->count != w->count)
        return false;
    for (unsigned i = 0; i < w->count; i++)
        if (!bloom_geometry_same(&w->g[i], &slot->geometry[i]))
            return false;
    return true;
}

// A free slot, best one that fits as it is: then the device thread need not be asked.
static struct sched_slot *slot_choose(struct sched_lane *l, const struct want *w, bool *fits)
{
    struct sched_slot *found = NULL;
    *fits = false;
    for (unsigned i = 0; i < l->slots && !*fits; i++) {
        struct sched_slot *slot = &l->slot[i];
        if (slot->job || slot->drop)
            continue;
        *fits = same_geometry(slot, w);
        // An empty one before one that serves another size.
        if (*fits || !found || (found->prepared && !slot->prepared))
            found = slot;
    }
    return found;
}

// What the lane's engine must keep for the jobs that are in its slots.
static void keep_needed(const struct sched_lane *l, uint64_t keep[BLOOM_KEEPS])
{
    for (unsigned i = 0; i < BLOOM_KEEPS; i++)
        keep[i] = 0;
    for (unsigned i = 0; i < l->slots; i++)
        if (l->slot[i].job)
            most_of(keep, l->slot[i].keep);
}

// Asks the device thread to free what nobody uses, but no more than is needed.
static void reclaim(struct sched_lane *l, uint64_t missing, const uint64_t keep[BLOOM_KEEPS])
{
    uint64_t found = 0;
    for (unsigned i = 0; i < l->slots && found < missing; i++) {
        struct sched_slot *slot = &l->slot[i];
        if (slot->job || !slot->bytes)
            continue;
        slot->drop = true;
        slot->prepared = false;
        found += slot->bytes;
    }
    uint64_t needed[BLOOM_KEEPS];
    keep_needed(l, needed);
    most_of(needed, keep);
    if (found < missing && sum_of(l->keep) > sum_of(needed))
        l->drop_keep = true;
    if (room_drops(l))
        pthread_cond_signal(&l->device_wake);
}

bool room_drops(const struct sched_lane *l)
{
    bool any = l->drop_keep;
    for (unsigned i = 0; i < l->slots; i++)
        any |= l->slot[i].drop;
    return any;
}

unsigned room_drop_begin(const struct sched_lane *l, bool *keep)
{
    unsigned mask = 0;
    for (unsigned i = 0; i < l->slots; i++)
        mask |= (unsigned)l->slot[i].drop << i;
    *keep = l->drop_keep;
    return mask;
}

void room_drop_end(struct sched_lane *l, unsigned mask, bool keep)
{
    struct sched *s = l->sched;
    for (unsigned i = 0; i < l->slots; i++) {
        struct sched_slot *slot = &l->slot[i];
        if (!(mask >> i & 1))
            continue;
        slot->drop = false;
        s->room.work -= slot->bytes;
        slot->bytes = 0;
    }
    if (keep) {
        s->room.work -= sum_of(l->keep);
        keep_needed(l, l->keep);
        s->room.work += sum_of(l->keep);
        l->drop_keep = false;
    }
    sched_room_freed(s);
}

// The device and all that was in it are gone.
void room_lost(struct sched_lane *l)
{
    for (unsigned i = 0; i < l->slots; i++) {
        l->sched->room.work -= l->slot[i].bytes;
        l->slot[i].bytes = 0;
        l->slot[i].drop = false;
    }
    l->sched->room.work -= sum_of(l->keep);
    for (unsigned i = 0; i < BLOOM_KEEPS; i++)
        l->keep[i] = 0;
    l->drop_keep = false;
}

enum room_verdict room_take(struct sched_lane *l, struct job *j)
{
    struct sched *s = l->sched;
    struct want w;
    bool fits;
    want_of(s, j, &w);
    j->work_known = w.work;
    // Several may have had their turn before the first was opened and its size known.
    const uint64_t others = j->user ? j->user->work - j->work_held : 0;
    if (l->name == LANE_FRAMES && others && others + w.work > s->limits.user_work_bytes)
        return w.all > s->limits.work_bytes ? ROOM_NEVER : ROOM_USER;
    struct sched_slot *slot = slot_choose(l, &w, &fits);
    if (!slot)
        return ROOM_WAIT;
    const uint64_t grown = w.planes > slot->bytes ? w.planes - slot->bytes : 0;
    uint64_t keep[BLOOM_KEEPS];
    memcpy(keep, l->keep, sizeof keep);
    most_of(keep, w.keep);
    const uint64_t levels = sum_of(keep) - sum_of(l->keep);
    const uint64_t work = w.work > j->work_held ? w.work - j->work_held : 0;
    const uint64_t all = s->room.work + grown + levels + work, max = s->limits.work_bytes;
    if (l->name == LANE_FRAMES && all > max) {
        if (w.all > max)
            return ROOM_NEVER;
        reclaim(l, all - max, w.keep);
        return ROOM_WAIT;
    }
    slot->bytes += grown;
    memcpy(slot->keep, w.keep, sizeof slot->keep);
    memcpy(l->keep, keep, sizeof l->keep);
    work_add(s, grown + levels);
    job_add(s, j, work);
    slot->job = j;
    j->slot = slot;
    if (fits)
        return ROOM_READY;
    slot->prepared = false;
    slot->count = w.count;
    for (unsigned i = 0; i < w.count; i++)
        slot->geometry[i] = w.g[i];
    return ROOM_PREPARE;
}
