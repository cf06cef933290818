/* SPDX-License-Identifier: Apache-2.0 */
/*
 * lib_internal.h - what libairy's files share. Not installed.
 *
 * A request is on exactly one list: `open` from submit until its terminal reply came AND its inline
 * data is written (only then may the caller's memory go), then `done` until it is waited for. An open one is
 * either in flight on this connection (`sent`) or waits to be sent. A lost connection destroys the conn at once, so that
 * nothing refers to the callers' memory any more, and moves to done what is not to be sent again (libretry.c).
 */
#ifndef AIRY_LIB_INTERNAL_H
#define AIRY_LIB_INTERNAL_H

#include <sys/socket.h>
#include <sys/un.h>

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
    uint8_t *body; /* the packed BLOOM or ASSET */
    size_t body_bytes;
    int fds[WIRE_FDS_MAX]; /* ours, until the end (`again`) or until it is sent */
    unsigned n_fds;
    const uint8_t *data; /* the caller's, inline; NULL: none */
    uint32_t deadline_ms;
    int64_t submitted_ms;
    bool again;     /* may be sent on another connection */
    bool wall;      /* names one */
    bool sent;      /* on this connection, and not refused because the daemon stops */
    bool cancelled; /* asked for by the caller */
    unsigned losses; /* connections that were lost while it was in flight: more than 0 is under suspicion */
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

/* How a connection comes back (libretry.c). It is up, or away (being made anew), or asleep (lost, and nothing needs it), or
 * lost for good. */
struct again {
    char path[sizeof(((struct sockaddr_un *)0)->sun_path)]; /* empty: it never does */
    unsigned limit_ms; /* longest time without a daemon; 0: it never does */
    bool away;
    bool wanted;   /* a call waits for it, besides the open requests */
    bool draining; /* the daemon stops: nothing is sent on this one any more */
    int64_t left_ms; /* of limit_ms; whole again when a request has ended */
    int64_t end_ms, next_ms, pause_ms; /* away: when it is given up, when the next try is, how long the pause after that is */
    struct airy_error why; /* of the last try's failure */
    uint64_t serial; /* of the connection, from 1 */
    int watch_fd, timer_fd; /* airy_fd's: an epoll set of the conn's and of a timer; -1: airy_fd is the conn's */
    uint32_t watched;       /* the events that the set has of the conn; 0: it is not in it */
    int64_t timer_ms;       /* what the timer is set to */
};

struct airy {
    struct conn *conn; /* NULL: there is none, `lost` says why */
    struct airy_error lost;
    bool final; /* lost for good */
    struct again again;
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
    bool own_walls;         /* opened on this connection, and gone with it */
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

/* Reads, writes, connects and sends what is possible without blocking. 0, or -1: the connection is lost for good. */
int lib_step(struct airy *a);
/* Waits for the socket, or for the next try, until `deadline_ms` (lib_now_ms; -1: for ever) and steps.
 * 1: time is up, 0: something may have happened, -1: the connection is lost for good. */
int lib_step_until(struct airy *a, int64_t deadline_ms);
int64_t lib_now_ms(void);
int64_t lib_deadline_ms(int timeout_ms); /* -1: for ever */
extern const struct airy_error lib_cancelled; /* a request's end */
int lib_copy_error(struct airy_error *out, const struct airy_error *e); /* -1; out may be NULL */

/* ---- libconnect.c ---- */
void *lib_place_data(void *ctx, uint64_t id, uint32_t bytes); /* a conn's sink; ctx: struct airy */
/* A conn to again.path with HELLO queued; never blocks. 0, or -1 and *e. */
int lib_connect_try(struct airy *a, struct airy_error *e);

/* ---- libretry.c ---- */
int lib_again_init(struct airy *a, const char *path, struct airy_error *e); /* from now on it comes back. 0, or -1 and *e */
void lib_again_finish(struct airy *a);
/* Destroys the conn; open requests end with *why, unless they are to be sent again. 0: it is to come back, -1: lost for good. */
int lib_lose(struct airy *a, const struct airy_error *why);
bool lib_up(const struct airy *a); /* WELCOME has come */
void lib_came_up(struct airy *a);
void lib_useful(struct airy *a); /* a request has ended: the daemon does its work */
/* Without a connection: what is due. With one: gives up when that takes too long. */
void lib_away_step(struct airy *a);
/* SHUTTING_DOWN for one request. Is it kept, for the next daemon? */
bool lib_hold(struct request *r, const struct airy_error *why);
void lib_drained(struct airy *a); /* closes a connection to a daemon that stops, once nothing is in flight there */
int64_t lib_due_ms(const struct airy *a); /* when lib_away_step has something to do; -1: never */
void lib_watch(struct airy *a); /* airy_fd's set is as the conn wants it */
/* Waits until it is up. 0, or -1 and *e. */
int lib_wait_up(struct airy *a, int64_t deadline_ms, struct airy_error *e);

/* ---- librequest.c ---- */
void lib_send_waiting(struct airy *a);
void lib_request_end(struct request *r, const struct airy_error *e); /* e NULL: well */
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
