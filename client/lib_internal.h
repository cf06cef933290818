/* SPDX-License-Identifier: Apache-2.0 */
/*
 * lib_internal.h - what libairy's files share. Not installed.
 *
 * A request is on exactly one list: `open` from submit until its terminal reply came AND its inline
 * data is written (only then may the caller's memory go), then `done` until it is waited for. A lost
 * connection moves all open ones to done and destroys the conn at once, so that nothing refers to the
 * callers' memory any more.
 */
#ifndef AIRY_LIB_INTERNAL_H
#define AIRY_LIB_INTERNAL_H

#include "airy.h"
#include "body.h"

/* What a request is to end in: RESULT with its output, RESULT without, ASSET_KEPT. */
enum request_kind { REQUEST_BLOOM, REQUEST_PLAN, REQUEST_ASSET };

struct request {
    struct request *next;
    struct airy *airy;
    enum request_kind kind;
    uint64_t id, input_bytes;
    Airy__Output__Kind output_kind;
    void (*progress)(void *ctx, uint64_t id, const char *stage, double fraction);
    void *progress_ctx;
    bool sending; /* the conn still refers to the caller's data */
    bool ended;   /* result or error is set */
    struct airy_result *result;
    struct airy_asset *kept; /* REQUEST_ASSET: the caller's, filled at the good end */
    bool is_kept;
    struct airy_error error;
    uint8_t *got; /* inline output so far */
    uint64_t got_bytes, got_cap;
};

enum { WALL_GIVEN_UP_MAX = 16 };

/* An airy_wall in progress, on its stack. */
struct wall_wait {
    uint64_t id;
    bool preview; /* was asked for */
    bool ended;   /* reply or error is set */
    struct airy_wall_reply *reply;
    struct airy_error error;
    uint8_t *got; /* of the preview */
    size_t got_bytes, got_room;
};

struct airy {
    struct conn *conn; /* NULL: the connection is lost, `lost` says how */
    struct airy_error lost;
    struct body_arena arena; /* for every body but RESULT's */
    bool welcome;
    char server[64], device[256];
    struct airy_limits limits;
    uint64_t next_id, credit_bytes;
    struct request *open, *done;
    unsigned open_count;
    uint64_t status_id; /* awaited; 0: none */
    struct airy_status *status;
    bool has_walls;         /* WELCOME names the feature */
    struct wall_wait *wall; /* NULL: none is asked for */
    uint64_t given_up[WALL_GIVEN_UP_MAX]; /* ids of what timed out; its answers are passed over */
    unsigned n_given_up;
};

struct airy_result_private {
    struct body_arena arena; /* texts, targets, notes */
    void *map;
    size_t map_bytes;
    void *received;
};

/* Fills *e with a failure of this side; -1. e may be NULL. */
int lib_fail(struct airy_error *e, int err, const char *field, const char *format, ...)
    __attribute__((format(printf, 4, 5)));

/* Reads and writes what is possible without blocking. 0, or -1: the connection is lost. */
int lib_step(struct airy *a);
/* lib_step, then waits for the socket until `deadline_ms` (lib_now_ms; -1: for ever) and steps again.
 * 1: time is up, 0: something may have happened, -1: the connection is lost. */
int lib_step_until(struct airy *a, int64_t deadline_ms);
int64_t lib_now_ms(void);
int64_t lib_deadline_ms(int timeout_ms); /* -1: for ever */
/* Destroys the conn and ends all open requests with *why. -1. */
int lib_lose(struct airy *a, const struct airy_error *why);

void lib_request_sent(void *request); /* conn_send_data's done */
void lib_request_free(struct request *r);

/* Makes r's result of a RESULT message, whose descriptors it takes. 0, or -1 and *e: the result is
 * not usable. */
int lib_result_make(struct request *r, const struct conn_message *m, struct airy_error *e);
/* A message that may be an airy_wall's. 1: it was, 0: it is another's, -1 and *e: the connection is to be lost. */
int lib_wall_message(struct airy *a, const struct conn_message *m, struct airy_error *e);
/* An ERROR for this id: was it an airy_wall's? */
bool lib_wall_error(struct airy *a, uint64_t id, const struct airy_error *error);

void lib_times(struct airy_times *out, const Airy__StageTimes *t);

#endif
