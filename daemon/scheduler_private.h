/* SPDX-License-Identifier: Apache-2.0 */
/*
 * scheduler_private.h - what scheduler.c (queues: pure bookkeeping under the lock), scheduler_fair.c (turns), scheduler_room.c (memory),
 * scheduler_users.c (who has what) and scheduler_threads.c (the threads) share.
 */
#ifndef AIRYD_SCHEDULER_PRIVATE_H
#define AIRYD_SCHEDULER_PRIVATE_H

#include <pthread.h>

#include "pulse.h"
#include "scheduler.h"

struct sched_user {
    uid_t uid;
    unsigned flows_open, requests, fds; /* fds: of requests, and of results that are not yet sent */
    unsigned queued, running;           /* jobs of frames; running: had a turn, not yet done */
    uint64_t inline_bytes, work;
    double device_ms;                   /* used so far, walls' included */
    double served_ms, pending_ms, virtual_ms; /* virtual_ms: what the flow served last had then */
    uint64_t idle_ns;
    TAILQ_ENTRY(sched_user) link;
    TAILQ_HEAD(, sched_flow) flows; /* that have a job waiting; served longest ago first */
};

struct sched_slot {
    struct bloom_slot *engine;
    struct job *job; /* NULL: free */
    /* What it is (prepared) or is to be prepared for: a job of the same geometry takes planes that are there.
     * Not prepared: the planes are from before, whoever asked for the geometry may have been cancelled. */
    bool prepared;
    bool drop;               /* its planes are to be freed: nobody takes it */
    uint64_t bytes, keep[BLOOM_KEEPS]; /* of its planes; of what the engine keeps for its job */
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
    struct job *at_work[SCHED_SLOTS_MAX + 1]; /* those */
    unsigned claimed;                   /* tasks that threads of the pool are at, of admitted jobs */
    struct job_queue parked;            /* of frames: admitted and opened, without room */
    uint64_t keep[BLOOM_KEEPS];         /* bytes of what the engine keeps beside planes */
    bool drop_keep;
    bool hold;                          /* nothing but FINISH is claimed */
    bool dead;                          /* it has no device, and will not get one */
    bool lost;                          /* ... and had one before */
    unsigned slots, regular;            /* those above `regular` are for jobs that pass others */
    struct sched_slot slot[SCHED_SLOTS_MAX + 1];
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
    struct sched_limits limits;
    struct {
        uint64_t load, work, work_peak;
        bool keeping; /* an image that is to be kept is decoded: one at a time */
    } room;
    unsigned fds;                   /* of all users, connections included */
    TAILQ_HEAD(, sched_user) users; /* served longest ago first */
    double virtual_ms, ms_per_unit; /* virtual_ms: what the user served last had then */
    unsigned deadlines;             /* jobs that wait with one */
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

void sched_room_freed(struct sched *s); /* parked jobs go on */

/* scheduler_fair.c. Waiting jobs of frames; their user and flow are set. */
void fair_init(struct sched *s);
void fair_push(struct sched *s, struct sched_flow *flow, struct job *j);
void fair_remove(struct job *j); /* without a turn */
/* Whose turn it is, of the users whose first job `may`; NULL: nobody's. */
struct job *fair_first(struct sched *s, bool (*may)(struct sched *s, const struct job *j));
/* A small job of somebody who has been served less passes large ones that are at work: it need not wait for them to end. */
bool fair_passes(struct sched *s, const struct job *j);
void fair_take(struct sched *s, struct job *j);
void fair_return(struct job *j); /* taken, and back in its place as if it never were */
void fair_leave_flow(struct job *j); /* its connection is forgotten */
void fair_settle(struct sched *s, struct job *j); /* it is done */

/* scheduler_users.c */
void users_finish(struct sched *s);

/* scheduler_room.c */
/* USER: its user has too much at work already; it may come again with what it needs known (job.work_known). */
enum room_verdict { ROOM_READY, ROOM_PREPARE, ROOM_WAIT, ROOM_USER, ROOM_NEVER };
uint64_t room_planes_bytes(unsigned count, const struct bloom_geometry *g); /* of a slot */
bool room_may_turn(struct sched *s, const struct job *j);
void room_turn(struct sched *s, struct job *j);
/* A slot and all the memory for an opened job; nothing on WAIT, USER and NEVER. */
enum room_verdict room_take(struct sched_lane *l, struct job *j);
void room_give(struct sched *s, struct job *j, uint64_t keep); /* all but so much of its work */
/* What the device thread is to free: a bit a slot, and what it keeps beside planes. */
bool room_drops(const struct sched_lane *l);
unsigned room_drop_begin(const struct sched_lane *l, bool *keep);
void room_drop_end(struct sched_lane *l, unsigned mask, bool keep);
void room_lost(struct sched_lane *l); /* the device is gone */

/* scheduler_threads.c */
int sched_threads_start(struct sched *s, unsigned threads, struct fault *f);
int sched_walls_start(struct sched *s, struct fault *f);
void sched_threads_stop(struct sched *s); /* may come twice */

#endif
