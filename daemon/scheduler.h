/* SPDX-License-Identifier: Apache-2.0 */
/*
 * scheduler.h - who is next, and the threads that do the work: one device thread, a pool of codec threads.
 *
 * Users get equal shares of the device's time, and a user's connections equal shares of the user's (scheduler_fair.c); within a user jobs of
 * higher priority go first, else first in, first out in a connection. A job has its turn when its user does and there is room for it in
 * memory (scheduler_room.c). `slots` bounds how many jobs are between OPEN and the end of ENCODE; one more may be that is small beside those that
 * are, of somebody who has been served less, and it goes before them in every stage. The pool takes the latest stage first, so that
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

struct sched_limits { /* none is 0 */
    uint64_t work_bytes;        /* of planes, codec, results, the engine's levels */
    uint64_t load_bytes;        /* of payloads that are read from descriptors; one alone may be larger */
    uint64_t user_work_bytes;   /* a user that has so much of work_bytes gets no further turn */
    uint64_t user_inline_bytes; /* payloads that came inline, of a user */
    uint32_t user_requests;
    uint32_t fds, user_fds;     /* descriptors: connections, requests', results that are not yet sent */
};

struct sched_config {
    unsigned threads, slots;
    struct sched_limits limits;
    struct bloom_options device; /* `slots` of it is not looked at */
    bool warm_idle; /* pipelines that have not drawn at the start draw whenever the device has nothing to do */
    void (*log)(const char *line);
};

struct sched_user;

struct sched_flow { /* one connection's line; embedded in its owner */
    struct sched_user *user;
    TAILQ_ENTRY(sched_flow) of_user;
    struct job_queue waiting; /* highest priority first */
    unsigned running;
    unsigned fds; /* of results that are not yet sent */
    double served_ms, pending_ms, ms_per_unit;
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

/* 0 or -ENOMEM; *connections: of this user, this one included. A flow is closed when none of its jobs waits (sched_cancel each
 * before). */
int sched_flow_open(struct sched *s, struct sched_flow *flow, uid_t uid, unsigned *connections);
void sched_flow_close(struct sched *s, struct sched_flow *flow);
/* Descriptors of the flow's user, its connections included. */
unsigned sched_user_fds(struct sched *s, const struct sched_flow *flow);

enum sched_verdict { SCHED_TAKEN, SCHED_BUSY, SCHED_LIMIT };
struct sched_refusal {
    enum sched_verdict verdict;
    const char *what;
    uint64_t found, allowed;
};
/* A request counts for its user from here to sched_drop, with the bytes of its inline payload and its descriptors. False and *r: it
 * would be too much. A job that is to be submitted must be held. */
bool sched_hold(struct sched *s, struct sched_flow *flow, struct job *j, uint64_t inline_bytes, unsigned fds,
                struct sched_refusal *r);
/* Before the job is destroyed, when sched does not have it. Not held is fine. */
void sched_drop(struct sched *s, struct job *j);
/* One of the job's descriptors is the connection's from here on, until sched_fds_sent or the flow's end: a result that waits to be written. */
void sched_fd_keep(struct sched *s, struct sched_flow *flow, struct job *j);
void sched_fds_sent(struct sched *s, struct sched_flow *flow, unsigned n);
/* Could it ever be done, when its sizes are known now (a raw picture)? *bytes: what it takes. */
bool sched_fits(const struct sched *s, const struct job *j, uint64_t *bytes);

enum { SCHED_USERS_SHOWN = 256 };
struct sched_user_facts {
    uid_t uid;
    unsigned connections, requests, queued, running, fds;
    uint64_t bytes; /* inline payloads, and what its frames at work and its unread results take */
    double device_ms;
};
/* Those that are here first. Returns how many. */
unsigned sched_users(struct sched *s, struct sched_user_facts out[SCHED_USERS_SHOWN]);

/* The job is sched's until sched_done hands it back. */
void sched_submit(struct sched *s, struct sched_flow *flow, struct job *j);
/* The job (submitted, not yet handed back) ends soon: a waiting one at once, one in a stage at its next
 * task. It comes back by sched_done like every other. */
void sched_cancel(struct sched *s, struct job *j);
/* Jobs that wait beyond their deadline end with DEADLINE. Returns when the next one does (CLOCK_MONOTONIC), 0: none has one. */
uint64_t sched_expire(struct sched *s, uint64_t now_ns);
/* A job that ended, or NULL. The descriptor is readable when one may be there, or a stage changed. */
struct job *sched_done(struct sched *s);
int sched_event_fd(const struct sched *s);
void sched_event_clear(struct sched *s);

struct sched_counts {
    unsigned waiting, running;
    uint64_t load_bytes, work_bytes, work_peak_bytes;
    bool device_dead; /* that of frames, or of walls, was there, and could not be had again: those will not be bloomed any more */
};
struct sched_counts sched_counts(struct sched *s);
/* clock_ns() of the last progress (pulse.h) of the device thread that has gone longest without; 0 when none has anything to
 * do. Takes no lock: a device thread that hangs with it must not hang who asks. */
uint64_t sched_device_since_ns(struct sched *s);

#endif
