/* SPDX-License-Identifier: Apache-2.0 */
/*
 * client.h - one peer: its state, its messages, its requests and its quota. Socket thread only.
 *
 *     HELLO -> READY -> CLOSING (an error is being written) -> LINGER (written; the peer may still
 *     read it) -> dead
 *
 * Invariants: every BLOOM and ASSET that is taken gets exactly one terminal reply, or the connection ends. Credit
 * and the place in max_requests come back only when the reply's last byte has been written, so what a
 * client who does not read can pile up here is bounded by its credit. What it sends is not read while 256
 * replies wait for it.
 */
#ifndef AIRYD_CLIENT_H
#define AIRYD_CLIENT_H

#include "reply.h"
#include "scheduler.h"

struct client;

struct client_timeouts { /* ms; the tests shorten them */
    uint32_t hello, write, upload, linger;
};

struct client_host { /* what the clients of one server share; the server's */
    struct sched *sched;
    struct reply_facts facts;
    struct job_env job;
    struct block_pool blocks;
    struct asset_cache assets;
    struct walls *walls;
    struct metrics metrics;
    struct client_timeouts timeout;
    unsigned clients, refused;           /* refused: being told that they are too many of their user */
    unsigned user_connections_max, user_fds_max;
    unsigned jobs, jobs_max;             /* not yet destroyed */
    uint64_t held_bytes, held_bytes_max; /* inline payloads in memory */
    bool draining;
    void (*log)(const char *line); /* NULL: not verbose */
};

/* Takes a connected socket. NULL and the socket closed: no memory. */
struct client *client_create(struct client_host *host, int fd);
/* Cancels what it had; its jobs end by themselves. NULL is fine. */
void client_destroy(struct client *c);
bool client_dead(const struct client *c); /* to be destroyed, when nobody looks at it any more */

uint32_t client_events(const struct client *c); /* EPOLLIN, EPOLLOUT */
void client_event(struct client *c, uint32_t events);
void client_tick(struct client *c, uint64_t now_ns); /* time-outs */
void client_progress(struct client *c);              /* sends PROGRESS for stages that changed */

/* A job that sched handed back: replies (or not, when its client is gone) and destroys it. */
void client_job_done(struct client_host *host, struct job *j);

/* The daemon stops: unfinished uploads end with SHUTTING_DOWN. */
void client_drain(struct client *c);
bool client_idle(const struct client *c); /* no request, nothing to write */
void client_hangup(struct client *c);     /* an idle one: no more replies, the peer may read the last */

#endif
