/* SPDX-License-Identifier: Apache-2.0 */
/*
 * scheduler.h - who is next, and the threads that do the work: one device thread, a pool of codec threads.
 *
 * Waiting jobs are first in, first out within a connection; connections of one user take turns, and users
 * take turns, so that one who sends much delays others by one frame at most per turn. `slots` bounds
 * how many jobs are between OPEN and the end of ENCODE. The pool takes the latest stage first, so that
 * the pipeline drains: frame n-1 is encoded, then n+1 decoded, while n is on the device.
 *
 * (Named so, not sched.h: with this folder on the include path it would hide the system's.)
 *
 * Jobs of walls do not take part in any of this: they have a lane of their own (scheduler_private.h).
 *
 * One mutex guards every queue and every job's place in them. Tasks are claimed under it: they last a
 * hundred microseconds and more, a claim far below one, and a job that moved on cannot be claimed.
 */
#ifndef AIRYD_SCHEDULER_H
#define AIRYD_SCHEDULER_H

#include <stdbool.h>
#include <sys/types.h>

#include "job.h"

struct sched;

enum { SCHED_THREADS_MAX = 256, SCHED_SLOTS_MAX = 8 };

struct sched_config {
    unsigned threads, slots;
    struct bloom_options device; /* `slots` of it is filled in here */
    bool warm_idle; /* pipelines that have not drawn at the start draw whenever the device has nothing to do */
    void (*log)(const char *line);
};

struct sched_user;

struct sched_flow { /* one connection's line; embedded in its owner */
    struct sched_user *user;
    TAILQ_ENTRY(sched_flow) of_user;
    struct job_queue waiting;
};

/* Jobs of walls (job->wall) need it, once, before the first: opens their own device in a thread of its own, so that nobody waits; jobs
 * wait for it. Again is no harm. 0, or -1 and *f. */
int sched_open_walls(struct sched *s, struct fault *f);
/* Opens the device (which tests itself) and starts the threads. 0, or -1 and *f. */
int sched_create(struct sched **out, const struct sched_config *config, struct fault *f);
/* Stops the threads after what they are at; unfinished jobs are destroyed. NULL is fine. */
void sched_destroy(struct sched *s);
const struct bloom_device_info *sched_device(struct sched *s);
/* Ends the threads: the last thing asked before sched_destroy. */
unsigned sched_validation_messages(struct sched *s);

/* 0 or -ENOMEM. A flow is closed when none of its jobs waits (sched_cancel each before). */
int sched_flow_open(struct sched *s, struct sched_flow *flow, uid_t uid);
void sched_flow_close(struct sched *s, struct sched_flow *flow);

/* The job is sched's until sched_done hands it back. */
void sched_submit(struct sched *s, struct sched_flow *flow, struct job *j);
/* The job (submitted, not yet handed back) ends soon: a waiting one at once, one in a stage at its next
 * task. It comes back by sched_done like every other. */
void sched_cancel(struct sched *s, struct job *j);
/* A job that ended, or NULL. The descriptor is readable when one may be there, or a stage changed. */
struct job *sched_done(struct sched *s);
int sched_event_fd(const struct sched *s);
void sched_event_clear(struct sched *s);

struct sched_counts {
    unsigned waiting, running;
    bool device_dead; /* that of frames, lost, and could not be had again: nothing more will be bloomed */
};
struct sched_counts sched_counts(struct sched *s);
/* clock_ns() of the last progress (pulse.h) of the device thread that has gone longest without; 0 when none has anything to
 * do. Takes no lock: a device thread that hangs with it must not hang who asks. */
uint64_t sched_device_since_ns(struct sched *s);

#endif
