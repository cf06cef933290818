// SPDX-License-Identifier: Apache-2.0
// scheduler_threads.c - the device thread and the pool; see scheduler.h.
#include "scheduler_private.h"

#include <stdio.h>
#include <string.h>

#include "prompt.h"

static void say(struct sched *s, const char *line)
{
    if (s->log)
        s->log(line);
}

// ---- pool ------------------------------------------------------------------------------------------

static void pool_run(struct sched *s, bool walls_only)
{
    struct exr_worker *worker = NULL;
    int error = exr_worker_create(&worker);
    pthread_mutex_lock(&s->lock);
    while (!s->stopping) {
        unsigned task = 0;
        struct job *j = sched_claim(s, walls_only, &task);
        if (!j) {
            pthread_cond_wait(walls_only ? &s->wall_wake : &s->pool_wake, &s->lock);
            continue;
        }
        pthread_mutex_unlock(&s->lock);
        struct fault f = { .code = FAULT_NONE };
        int rc = 0;
        if (error && j->stage != JOB_FINISH) // freeing needs no codec
            rc = fault_set(&f, FAULT_NO_MEMORY, "", "no memory for a codec thread");
        else
            rc = job_task(j, task, worker, &f);
        pthread_mutex_lock(&s->lock);
        sched_complete(s, j, task, rc, &f);
    }
    pthread_mutex_unlock(&s->lock);
    exr_worker_destroy(worker);
}

static void *pool_main(void *arg)
{
    pool_run(arg, false);
    return NULL;
}

static void *wall_pool_main(void *arg)
{
    prompt_me(0); // and the driver's threads, which it starts
    pool_run(arg, true);
    return NULL;
}

// ---- device ----------------------------------------------------------------------------------------

static int open_device(struct sched_lane *l, struct fault *f)
{
    struct bloom_options o = l->sched->device;
    o.slots = l->slots;
    // A wall asks for few pipelines, and for those at once.
    if (l->name == LANE_WALLS)
        o.warm_all = false;
    if (bloom_create(&l->bloom, &o, f) < 0) {
        l->bloom = NULL;
        l->warming = false;
        return -1;
    }
    l->warming = l->name == LANE_FRAMES && l->sched->warm_idle;
    for (unsigned i = 0; i < l->slots; i++)
        l->slot[i].engine = bloom_slot(l->bloom, i);
    return 0;
}

static int device_task(struct sched_lane *l, struct job *j, struct fault *f)
{
    struct sched_slot *slot = j->slot;
    if (!l->bloom)
        return fault_set(f, FAULT_DEVICE_LOST, "", "the Vulkan device was lost and could not be opened again");
    if (j->stage == JOB_PLAN)
        return job_plan(j, l->bloom, f);
    if (j->stage == JOB_BLOOM)
        return job_bloom(j, l->bloom, slot->engine, f);
    return bloom_slot_prepare(l->bloom, slot->engine, slot->count, slot->geometry, slot->in, slot->out, f);
}

// Under the lock. A new device, once; each job that was in the pipeline starts again on it, once.
static void device_replace(struct sched_lane *l, const struct fault *f)
{
    struct sched *s = l->sched;
    char line[400];
    snprintf(line, sizeof line, "the device is lost (%s); opening it again", f->text);
    say(s, line);
    l->hold = true;
    while (l->claimed)
        pthread_cond_wait(&l->quiet, &s->lock);
    pthread_mutex_unlock(&s->lock);
    pulse_begin(&l->pulse);
    unsigned messages = bloom_validation_messages(l->bloom);
    bloom_destroy(l->bloom);
    l->bloom = NULL;
    struct fault again = { .code = FAULT_NONE };
    int rc = open_device(l, &again);
    pulse_end();
    if (rc < 0) {
        snprintf(line, sizeof line, "the device cannot be opened again: %s", again.text);
        say(s, line);
    }
    pthread_mutex_lock(&s->lock);
    l->validation_messages += messages;
    l->dead = l->lost = rc < 0;
    sched_rewind_all(l, f);
    l->hold = false;
    pthread_cond_broadcast(&s->pool_wake);
    pthread_cond_broadcast(&s->wall_wake);
}

// Under the lock; nobody waits for the device. A step is short, so that who comes meanwhile hardly waits.
static void warm_step(struct sched_lane *l)
{
    struct sched *s = l->sched;
    struct fault f;
    pthread_mutex_unlock(&s->lock);
    pulse_begin(&l->pulse);
    bool more = bloom_warm_next(l->bloom, &f);
    pulse_end();
    pthread_mutex_lock(&s->lock);
    l->warming = more;
    if (f.code == FAULT_DEVICE_LOST) {
        device_replace(l, &f);
    } else if (f.code != FAULT_NONE) {
        char line[400];
        snprintf(line, sizeof line, "drawing with all pipelines: %s; those left draw when they are asked for", f.text);
        say(s, line);
    } else if (!more) {
        say(s, "all pipelines have drawn");
    }
}

// Under the lock. Planes that nobody uses make room for others.
static void drop_step(struct sched_lane *l)
{
    bool levels;
    const unsigned mask = room_drop_begin(l, &levels);
    pthread_mutex_unlock(&l->sched->lock);
    for (unsigned i = 0; i < l->slots && l->bloom; i++)
        if (mask >> i & 1)
            bloom_slot_release(l->bloom, l->slot[i].engine);
    if (levels && l->bloom)
        bloom_levels_release(l->bloom);
    pthread_mutex_lock(&l->sched->lock);
    room_drop_end(l, mask, levels);
}

// Under the lock.
static void device_run(struct sched_lane *l)
{
    struct sched *s = l->sched;
    while (!s->stopping) {
        if (room_drops(l)) {
            drop_step(l);
            continue;
        }
        struct job *j = sched_device_next(l);
        if (!j && l->warming) {
            warm_step(l);
            continue;
        }
        if (!j) {
            pthread_cond_wait(&l->device_wake, &s->lock);
            continue;
        }
        pthread_mutex_unlock(&s->lock);
        struct fault f = { .code = FAULT_NONE };
        pulse_begin(&l->pulse);
        int rc = device_task(l, j, &f);
        pulse_end();
        pthread_mutex_lock(&s->lock);
        // A plan touches no device; one that says so all the same has no slot to start again from.
        if (rc < 0 && f.code == FAULT_DEVICE_LOST && l->bloom && j->slot) {
            j->running--;
            device_replace(l, &f);
            continue;
        }
        if (j->stage == JOB_PREPARE)
            j->slot->prepared = rc == 0;
        sched_complete(s, j, 0, rc, &f);
    }
}

static void *device_main(void *arg)
{
    struct sched_lane *l = arg;
    pthread_mutex_lock(&l->sched->lock);
    device_run(l);
    pthread_mutex_unlock(&l->sched->lock);
    return NULL;
}

// Of walls: its device is opened here, and its jobs wait for that.
static void *wall_device_main(void *arg)
{
    struct sched_lane *l = arg;
    struct fault f = { .code = FAULT_NONE };
    prompt_me(0); // and the driver's threads, which it starts
    pulse_begin(&l->pulse);
    int rc = open_device(l, &f);
    pulse_end();
    pthread_mutex_lock(&l->sched->lock);
    if (rc < 0) {
        char line[400];
        snprintf(line, sizeof line, "no device for walls: %s", f.text);
        say(l->sched, line);
        l->dead = true;
    }
    device_run(l);
    pthread_mutex_unlock(&l->sched->lock);
    return NULL;
}

// ---- life ------------------------------------------------------------------------------------------

int sched_threads_start(struct sched *s, unsigned threads, struct fault *f)
{
    struct sched_lane *l = &s->lane[LANE_FRAMES];
    if (open_device(l, f) < 0)
        return -1;
    s->device_info = *bloom_device(l->bloom);
    int error = pthread_create(&l->device_thread, NULL, device_main, l);
    l->open = !error;
    for (unsigned i = 0; i < threads && !error; i++) {
        error = pthread_create(&s->pool_thread[i], NULL, pool_main, s);
        s->threads_started += !error;
    }
    if (error)
        return fault_set(f, FAULT_INTERNAL, "", "starting thread %u of %u: %s", s->threads_started + 2,
                         threads + 1, strerror(error));
    return 0;
}

int sched_walls_start(struct sched *s, struct fault *f)
{
    struct sched_lane *l = &s->lane[LANE_WALLS];
    int error = 0;
    if (!l->pool_started)
        error = pthread_create(&l->pool_thread, NULL, wall_pool_main, s);
    l->pool_started |= !error;
    if (!error)
        error = pthread_create(&l->device_thread, NULL, wall_device_main, l);
    l->open = !error;
    return error ? fault_set(f, FAULT_INTERNAL, "", "starting a thread for walls: %s", strerror(error)) : 0;
}

void sched_threads_stop(struct sched *s)
{
    pthread_mutex_lock(&s->lock);
    s->stopping = true;
    pthread_cond_broadcast(&s->pool_wake);
    pthread_cond_broadcast(&s->wall_wake);
    for (unsigned i = 0; i < LANES; i++)
        pthread_cond_broadcast(&s->lane[i].device_wake);
    pthread_mutex_unlock(&s->lock);
    for (unsigned i = 0; i < LANES; i++) {
        struct sched_lane *l = &s->lane[i];
        if (l->open)
            pthread_join(l->device_thread, NULL);
        if (l->pool_started)
            pthread_join(l->pool_thread, NULL);
        l->open = l->pool_started = false;
    }
    for (unsigned i = 0; i < s->threads_started; i++)
        pthread_join(s->pool_thread[i], NULL);
    s->threads_started = 0;
}
