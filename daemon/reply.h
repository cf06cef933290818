/* SPDX-License-Identifier: Apache-2.0 */
/*
 * reply.h - what the daemon says, as message bodies. Texts that came from files or clients are made
 * valid UTF-8 first: protobuf's readers in other languages refuse a message that has a bad string.
 *
 * All: 0 or -errno as body_send.
 */
#ifndef AIRYD_REPLY_H
#define AIRYD_REPLY_H

#include "conn.h"
#include "job.h"
#include "scheduler.h"

struct reply_memory { /* bytes; see --memory-bytes */
    uint64_t ceiling, reserved, inline_max, load_max, work_max;
};

struct reply_facts { /* about the daemon; constant */
    struct job_limits job;
    uint64_t credit_bytes;
    uint32_t max_requests;
    struct reply_memory memory;
    struct bloom_device_info device;
};

struct reply_status {
    unsigned clients;
    struct sched_counts sched;
    const struct metrics *metrics;
    uint64_t inline_bytes;
    unsigned n_users;
    struct sched_user_facts user[SCHED_USERS_SHOWN];
    bool draining;
};

int reply_welcome(struct conn *c, const struct reply_facts *facts);
int reply_status(struct conn *c, uint64_t id, const struct reply_facts *facts, const struct reply_status *s);
/* The terminal RESULT; a memfd output's descriptor becomes the conn's on success. */
int reply_result(struct conn *c, struct job *j, const struct reply_facts *facts);
/* The terminal ASSET_KEPT. */
int reply_kept(struct conn *c, const struct job *j);
int reply_fault(struct conn *c, uint64_t id, const struct fault *f);
int reply_progress(struct conn *c, uint64_t id, enum job_stage stage);
int reply_credit(struct conn *c, uint64_t bytes);
/* Replaces what is not UTF-8 by '?'. */
void reply_clean(char *text);

#endif
