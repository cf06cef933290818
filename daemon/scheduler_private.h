/* SPDX-License-Identifier: Apache-2.0 */
/*
 * scheduler_private.h - what scheduler.c (queues: pure bookkeeping under the lock) and scheduler_threads.c (the
 * threads) share.
 */
#ifndef AIRYD_SCHEDULER_PRIVATE_H
#define AIRYD_SCHEDULER_PRIVATE_H

#include <pthread.h>

#include "scheduler.h"

struct sched_user {
    uid_t uid;
    unsigned flows_open;
    TAILQ_ENTRY(sched_user) link;
    TAILQ_HEAD(, sched_flow) flows; /* whose turn it is first */
};

struct sched_slot {
    struct bloom_slot *engine;
    struct job *job; /* NULL: free */
    /* What it is (prepared) or is to be prepared for: a job of the same geometry takes planes that are there.
     * Not prepared: the planes are from before, whoever asked for the geometry may have been cancelled. */
    bool prepared;
    unsigned count;
    struct bloom_geometry geometry[BLOOM_TARGETS_MAX];
    struct planes in[BLOOM_TARGETS_MAX], out[BLOOM_TARGETS_MAX * BLOOM_OUTPUTS_MAX];
};

struct sched {
    pthread_mutex_t lock;
    pthread_cond_t pool_wake, device_wake, quiet;
    TAILQ_HEAD(, sched_user) users; /* whose turn it is first */
    struct job_queue stage[JOB_STAGES]; /* jobs with tasks to claim, or for the device */
    struct job_queue done;
    unsigned waiting, running; /* running: admitted and not yet done */
    unsigned admitted;         /* between OPEN and the end of ENCODE: at most `slots` */
    unsigned claimed;          /* tasks that threads of the pool are at, of admitted jobs */
    bool stopping, hold;       /* hold: nothing but FINISH is claimed */
    bool device_dead;

    unsigned slots;
    struct sched_slot slot[SCHED_SLOTS_MAX];

    struct bloom *bloom; /* the device thread's, once it runs */
    struct bloom_options device;
    bool warm_idle, warming; /* warming: pipelines are left that have not drawn */
    struct bloom_device_info device_info;
    unsigned validation_messages;
    void (*log)(const char *line);

    int event_fd;
    unsigned threads_started;
    bool device_started;
    pthread_t device_thread, pool_thread[SCHED_THREADS_MAX];
};

/* All under the lock. */
struct job *sched_claim(struct sched *s, unsigned *task); /* NULL: nothing to do now */
void sched_complete(struct sched *s, struct job *j, unsigned task, int rc, const struct fault *f);
struct job *sched_device_next(struct sched *s); /* in PLAN, PREPARE or BLOOM; off its queue, running */
void sched_rewind_all(struct sched *s, const struct fault *f);

/* scheduler_threads.c */
int sched_threads_start(struct sched *s, unsigned threads, struct fault *f);
void sched_threads_stop(struct sched *s); /* may come twice */

#endif
