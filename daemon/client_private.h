/* SPDX-License-Identifier: Apache-2.0 */
/*
 * client_private.h - what client.c (the connection: states, replies, messages) and client_ask.c (BLOOM and ASSET: what is taken in, and what is
 * refused) share. Socket thread only; see client.h for the invariants.
 */
#ifndef AIRYD_CLIENT_PRIVATE_H
#define AIRYD_CLIENT_PRIVATE_H

#include <sys/socket.h>

#include "body.h"
#include "client.h"

enum { UNSENT_REPLIES_MAX = 256 };

enum client_state { CLIENT_HELLO, CLIENT_READY, CLIENT_CLOSING, CLIENT_LINGER, CLIENT_DEAD };

struct settled { /* comes back to the client when the stream has been written up to here */
    uint64_t at, credit_bytes;
    unsigned fds; /* went with it */
};

struct client {
    struct client_host *host;
    struct conn *conn;
    struct ucred peer;
    enum client_state state;
    bool refused; /* one too many of its user */
    struct body_arena arena;
    struct sched_flow flow;

    struct job_queue jobs; /* in upload, or sched's */
    unsigned n_requests;   /* jobs, and replies not yet written */
    struct job *sink;      /* a DATA message is being read into its block */
    bool sink_dead;        /* ... and it has ended: destroyed after that message */
    uint64_t credit_left;

    uint64_t written; /* of the stream to the client, since the start */
    uint64_t reply_end[UNSENT_REPLIES_MAX];
    unsigned replies;
    struct settled *settled; /* ring of max_requests */
    unsigned settled_first, settled_count;

    uint64_t since_ns; /* state entered; CLOSING and LINGER: deadline counts from here */
    uint64_t write_ns; /* last time that something was written, or there was nothing to write */
};

/* client.c */
void client_say(const struct client *c, const char *format, ...) __attribute__((format(printf, 2, 3)));
void client_job_drop(struct client_host *host, struct job *j); /* destroys it; what it held is free again */
struct job *client_job_find(struct client *c, uint64_t id);
/* An error that ends one request which has not become (or is no longer) a job. */
void client_refuse(struct client *c, uint64_t id, uint64_t credit_bytes, const struct fault *f);
void client_close_fds(const struct conn_message *m);

/* client_ask.c */
void client_ask(struct client *c, const struct conn_message *m); /* BLOOM, ASSET */
/* BUSY, with when to come again and behind how many. -1. */
int client_busy(const struct client_host *h, struct fault *f, const char *what, uint64_t found, uint64_t limit);

#endif
