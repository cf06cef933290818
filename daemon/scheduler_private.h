/* SPDX-License-Identifier: Apache-2.0 */
/*
 * scheduler_private.h - what scheduler.c (queues: pure bookkeeping under the lock) and scheduler_threads.c (the
 * threads) share.
 */
#ifndef AIRYD_SCHEDULER_PRIVATE_H
#define AIRYD_SCHEDULER_PRIVATE_H

#include <pthread.h>

#include "pulse.h"
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

/*
 * A lane: a device of its own and the jobs for it. Frames go in the first. A wall's go in the second: that they never wait for a
 * farm's frame on the device, it has its own; that they never wait for one's codec, it has a thread of its own too, and
 * every thread of the pool takes its tasks first. Its device is opened when the first wall is. In it jobs are bloomed
 * strictly in the order in which they came, for exposure follows one frame after the other.
 */
enum sched_lane_name { LANE_FRAMES, LANE_WALLS, LANES };

struct sched_lane {
    struct sched *sched;
    enum sched_lane_name name;
    bool open;                          /* its device thread runs */
    struct job_queue stage[JOB_STAGES]; /* jobs with tasks to claim, or for the device */
    struct job_queue waiting;           /* of walls: first in, first out */
    TAILQ_HEAD(, job) order;            /* of walls: admitted, and not yet past BLOOM */
    unsigned n_waiting, running;        /* running: admitted and not yet done */
    unsigned admitted;                  /* between OPEN and the end of ENCODE: at most `slots` */
    unsigned claimed;                   /* tasks that threads of the pool are at, of admitted jobs */
    bool hold;                          /* nothing but FINISH is claimed */
    bool dead;                          /* its device is lost, and could not be had again */
    unsigned slots;
    struct sched_slot slot[SCHED_SLOTS_MAX];
    struct bloom *bloom;                /* the device thread's, once it runs */
    struct pulse pulse;                 /* the device thread's */
    bool warming;                       /* pipelines are left that have not drawn */
    unsigned validation_messages;
    pthread_cond_t device_wake, quiet;
    pthread_t device_thread, pool_thread; /* pool_thread: of walls */
    bool pool_started;
};

struct sched {
    pthread_mutex_t lock;
    pthread_cond_t pool_wake, wall_wake; /* wall_wake: the walls' own thread */
    TAILQ_HEAD(, sched_user) users; /* whose turn it is first */
    struct job_queue done;
    bool stopping;
    struct sched_lane lane[LANES];
    struct bloom_options device;
    bool warm_idle;
    struct bloom_device_info device_info;
    void (*log)(const char *line);

    int event_fd;
    unsigned threads_started;
    pthread_t pool_thread[SCHED_THREADS_MAX];
};

/* All under the lock. */
/* NULL: nothing to do now. walls_only: as the walls' own thread. */
struct job *sched_claim(struct sched *s, bool walls_only, unsigned *task);
void sched_complete(struct sched *s, struct job *j, unsigned task, int rc, const struct fault *f);
struct job *sched_device_next(struct sched_lane *l); /* in PLAN, PREPARE or BLOOM; off its queue, running */
void sched_rewind_all(struct sched_lane *l, const struct fault *f);

/* scheduler_threads.c */
int sched_threads_start(struct sched *s, unsigned threads, struct fault *f);
int sched_walls_start(struct sched *s, struct fault *f);
void sched_threads_stop(struct sched *s); /* may come twice */

#endif
