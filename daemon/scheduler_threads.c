// SPDX-License-Identifier: Apache-2.0
// scheduler_threads.c - the device thread and the pool; see scheduler.h.
#include "scheduler_private.h"

#include <stdio.h>
#include <string.h>

static void say(struct sched *s, const char *line)
{
    if (s->log)
        s->log(line);
}

// ---- pool ------------------------------------------------------------------------------------------

static void *pool_main(void *arg)
{
    struct sched *s = arg;
    struct exr_worker *worker = NULL;
    int error = exr_worker_create(&worker);
    pthread_mutex_lock(&s->lock);
    while (!s->stopping) {
        unsigned task = 0;
        struct job *j = sched_claim(s, &task);
        if (!j) {
            pthread_cond_wait(&s->pool_wake, &s->lock);
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
    return NULL;
}

// ---- device ----------------------------------------------------------------------------------------

static int open_device(struct sched *s, struct fault *f)
{
    if (bloom_create(&s->bloom, &s->device, f) < 0) {
        s->bloom = NULL;
        s->warming = false;
        return -1;
    }
    s->warming = s->warm_idle;
    for (unsigned i = 0; i < s->slots; i++)
        s->slot[i].engine = bloom_slot(s->bloom, i);
    return 0;
}

static int device_task(struct sched *s, struct job *j, struct fault *f)
{
    struct sched_slot *slot = j->slot;
    if (!s->bloom)
        return fault_set(f, FAULT_DEVICE_LOST, "", "the Vulkan device was lost and could not be opened again");
    if (j->stage == JOB_PLAN)
        return job_plan(j, s->bloom, f);
    if (j->stage == JOB_BLOOM)
        return job_bloom(j, s->bloom, slot->engine, f);
    return bloom_slot_prepare(s->bloom, slot->engine, slot->count, slot->geometry, slot->in, slot->out, f);
}

// Under the lock. A new device, once; each job that was in the pipeline starts again on it, once.
static void device_replace(struct sched *s, const struct fault *f)
{
    char line[400];
    snprintf(line, sizeof line, "the device is lost (%s); opening it again", f->text);
    say(s, line);
    s->hold = true;
    while (s->claimed)
        pthread_cond_wait(&s->quiet, &s->lock);
    pthread_mutex_unlock(&s->lock);
    unsigned messages = bloom_validation_messages(s->bloom);
    bloom_destroy(s->bloom);
    s->bloom = NULL;
    struct fault again = { .code = FAULT_NONE };
    int rc = open_device(s, &again);
    if (rc < 0) {
        snprintf(line, sizeof line, "the device cannot be opened again: %s", again.text);
        say(s, line);
    }
    pthread_mutex_lock(&s->lock);
    s->validation_messages += messages;
    s->device_dead = rc < 0;
    sched_rewind_all(s, f);
    s->hold = false;
    pthread_cond_broadcast(&s->pool_wake);
}

// Under the lock; nobody waits for the device. A step is short, so that who comes meanwhile hardly waits.
static void warm_step(struct sched *s)
{
    struct fault f;
    pthread_mutex_unlock(&s->lock);
    bool more = bloom_warm_next(s->bloom, &f);
    pthread_mutex_lock(&s->lock);
    s->warming = more;
    if (f.code == FAULT_DEVICE_LOST) {
        device_replace(s, &f);
    } else if (f.code != FAULT_NONE) {
        char line[400];
        snprintf(line, sizeof line, "drawing with all pipelines: %s; those left draw when they are asked for", f.text);
        say(s, line);
    } else if (!more) {
        say(s, "all pipelines have drawn");
    }
}

static void *device_main(void *arg)
{
    struct sched *s = arg;
    pthread_mutex_lock(&s->lock);
    while (!s->stopping) {
        struct job *j = sched_device_next(s);
        if (!j && s->warming) {
            warm_step(s);
            continue;
        }
        if (!j) {
            pthread_cond_wait(&s->device_wake, &s->lock);
            continue;
        }
        pthread_mutex_unlock(&s->lock);
        struct fault f = { .code = FAULT_NONE };
        int rc = device_task(s, j, &f);
        pthread_mutex_lock(&s->lock);
        // A plan touches no device; one that says so all the same has no slot to start again from.
        if (rc < 0 && f.code == FAULT_DEVICE_LOST && s->bloom && j->slot) {
            j->running--;
            device_replace(s, &f);
            continue;
        }
        if (j->stage == JOB_PREPARE)
            j->slot->prepared = rc == 0;
        sched_complete(s, j, 0, rc, &f);
    }
    pthread_mutex_unlock(&s->lock);
    return NULL;
}

// ---- life ------------------------------------------------------------------------------------------

int sched_threads_start(struct sched *s, unsigned threads, struct fault *f)
{
    if (open_device(s, f) < 0)
        return -1;
    s->device_info = *bloom_device(s->bloom);
    s->validation_messages = 0;
    int error = pthread_create(&s->device_thread, NULL, device_main, s);
    s->device_started = !error;
    for (unsigned i = 0; i < threads && !error; i++) {
        error = pthread_create(&s->pool_thread[i], NULL, pool_main, s);
        s->threads_started += !error;
    }
    if (error)
        return fault_set(f, FAULT_INTERNAL, "", "starting thread %u of %u: %s", s->threads_started + 2,
                         threads + 1, strerror(error));
    return 0;
}

void sched_threads_stop(struct sched *s)
{
    pthread_mutex_lock(&s->lock);
    s->stopping = true;
    pthread_cond_broadcast(&s->pool_wake);
    pthread_cond_broadcast(&s->device_wake);
    pthread_mutex_unlock(&s->lock);
    if (s->device_started)
        pthread_join(s->device_thread, NULL);
    for (unsigned i = 0; i < s->threads_started; i++)
        pthread_join(s->pool_thread[i], NULL);
    s->device_started = false;
    s->threads_started = 0;
}
