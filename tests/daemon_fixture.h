/* SPDX-License-Identifier: Apache-2.0 */
/*
 * daemon_fixture.h - a real airyd (AIRYD in the environment, else build/airyd) in a folder of its own, and
 * a bare peer that speaks the protocol message by message, right or wrong. For cmocka tests.
 */
#ifndef TEST_DAEMON_FIXTURE_H
#define TEST_DAEMON_FIXTURE_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include <cmocka.h>

#include "airy.h"
#include "body.h"

struct daemon {
    pid_t pid;
    char dir[64], path[96];
    int lifetime_fd; /* closing it ends the daemon */
};

/* Starts it with these options more (NULL-ended, may be NULL) and waits until it listens. */
void daemon_start(struct daemon *d, const char *const *options);
/* Sends the signal (0: none) and waits for the end. Returns the exit status, 1000 + signal when killed.
 * Removes the folder. */
int daemon_stop(struct daemon *d, int signal);
int daemon_wait(struct daemon *d); /* the end, without the folder's removal */
unsigned daemon_fds(const struct daemon *d); /* descriptors that it has open */
/* Runs airyd with options that make it end by itself; its stderr in text. Returns the exit status. */
int daemon_run(const char *const *options, char *text, size_t size);

/* In a child: becomes airyd with these options. */
void daemon_exec(const char *const *first, const char *const *more) __attribute__((noreturn));

/* True when the tests are built with a sanitizer: bounds on time and memory mean nothing then. */
bool daemon_sanitized(void);
/* CLOCK_MONOTONIC; and a moment between two looks at what is waited for. */
int64_t daemon_now_ms(void);
void daemon_nap(void);

/* A connection of libairy to it, which does not come back: so that a test sees what the daemon did. */
struct airy *daemon_join(const struct daemon *d);
/* A connected stream socket. */
int peer_socket(const struct daemon *d);

struct peer {
    struct conn *conn;
    struct body_arena arena;
};
void peer_open(struct peer *p, const struct daemon *d);  /* connected, nothing said */
void peer_hello(struct peer *p, const struct daemon *d); /* ... and WELCOME received */
void peer_close(struct peer *p);
/* Sends what is queued. */
void peer_flush(struct peer *p);
/* The next message in at most timeout_ms: 1; 0: none came; -1: the daemon has closed. */
int peer_next(struct peer *p, struct conn_message *m, int timeout_ms);
/* Skips CREDIT and PROGRESS; fails the test unless the next message is of this type and id. */
void peer_expect(struct peer *p, struct conn_message *m, enum wire_type type, uint64_t id);
/* ... an ERROR with this code, and (not NULL) this field. Returns the body. */
const Airy__Error *peer_expect_error(struct peer *p, uint64_t id, unsigned code, const char *field);
void peer_expect_closed(struct peer *p);
/* Queues messages. */
void peer_asset(struct peer *p, uint64_t id, const Airy__Payload *input, int fd); /* fd -1: none */
void peer_bloom(struct peer *p, uint64_t id, const Airy__Bloom *b, const int *fds, unsigned n_fds);
void peer_data(struct peer *p, uint64_t id, const void *data, size_t bytes);
void peer_cancel(struct peer *p, uint64_t id);
/* STATUS, and its reply. */
const Airy__StatusReply *peer_status(struct peer *p);

int make_memfd(const void *data, size_t bytes, int seals);

/* ---- pictures -------------------------------------------------------------------------------------- */

struct picture { /* R G B A, halves, interleaved */
    uint32_t width, height;
    uint16_t *pixels;
};
/* Dark ground and a few lamps up to `peak`; seeded. */
struct picture picture_make(uint32_t width, uint32_t height, float peak, uint32_t seed);
void picture_free(struct picture *p);
size_t picture_bytes(const struct picture *p);
/* An uncompressed scanline EXR file, written by hand from the format's description. malloc'ed. */
uint8_t *picture_exr(const struct picture *p, size_t *bytes);
/* Its pixels again (header of any size, no compression). Fails the test on anything unexpected. */
struct picture picture_from_exr(const uint8_t *file, size_t bytes);
/* The request's raw layout for it. */
void picture_request(const struct picture *p, struct airy_request *r);
uint16_t half_of(float f);
float float_of(uint16_t h);

#endif
