/* SPDX-License-Identifier: Apache-2.0 */
/*
 * airy_peer.h - the other end for libairy's tests: it speaks the protocol over a real socketpair with
 * the real conn, from a thread of its own, as a script says. Its checks abort the whole test program
 * (cmocka's may only be used in the main thread).
 */
#ifndef AIRY_PEER_H
#define AIRY_PEER_H

#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "airy.h"
#include "body.h"

enum { BIG_BYTES = 20 * 1000 * 1000 };

#define must(condition)                                                                                 \
    do {                                                                                                \
        if (!(condition)) {                                                                             \
            fprintf(stderr, "%s:%d: the peer expected %s\n", __FILE__, __LINE__, #condition);           \
            abort();                                                                                    \
        }                                                                                               \
    } while (0)

/* Zero credit_bytes and max_requests are replaced by plenty. */
struct peer {
    struct conn *conn;
    struct body_arena arena;
    uint64_t credit_bytes;
    uint32_t max_requests;
    bool no_walls; /* WELCOME does not name the feature */
    pthread_t thread;
    void (*script)(struct peer *p);
    unsigned fds_before;
};

/* ---- in the main thread ---- */

unsigned count_fds(void);
/* Starts the peer; the client's end, the caller's. */
int peer_begin(struct peer *p, void (*script)(struct peer *p));
struct airy *open_peer(struct peer *p, void (*script)(struct peer *p));
/* Also checks that no descriptor is left over. */
void close_peer(struct peer *p, struct airy *a);
struct airy_request inline_request(const void *data, uint64_t size);
uint64_t submit(struct airy *a, const struct airy_request *r);
uint64_t submit_text(struct airy *a, const char *text);
void expect_text(struct airy *a, uint64_t id, const char *text);
struct airy_error expect_failure(struct airy *a, uint64_t id, const char *symbol);
void fill(uint8_t *p, size_t n, unsigned seed);

/* ---- in scripts ---- */

void script_handshake(struct peer *p); /* welcomes, and waits for the end */
int wait_readable(struct peer *p, int timeout_ms);
void peer_flush(struct peer *p);
/* The next message, which must be of this type; its body is valid until the next call. */
struct conn_message peer_next(struct peer *p, enum wire_type expected);
void *peer_body(struct peer *p, const struct conn_message *m, const ProtobufCMessageDescriptor *d);
void peer_send(struct peer *p, enum wire_type type, uint64_t id, const ProtobufCMessage *m);
void peer_welcome(struct peer *p);
void peer_credit(struct peer *p, uint64_t bytes);
/* Takes a BLOOM, closes its descriptors; the id. */
uint64_t peer_bloom(struct peer *p);
/* fd -1: none; it is the conn's then. */
void peer_result(struct peer *p, uint64_t id, Airy__Payload__Kind kind, uint64_t offset, uint64_t size,
                 int fd);
void peer_result_text(struct peer *p, uint64_t id, const char *text);
void peer_fault(struct peer *p, uint64_t id, enum fault_code code, const char *field, const char *text);
int memfd_of(const void *data, size_t bytes, int seals);
void peer_until_closed(struct peer *p);

#endif
