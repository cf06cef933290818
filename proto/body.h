/* SPDX-License-Identifier: Apache-2.0 */
/*
 * body.h - message bodies: protobuf in memory that is bounded and reused.
 *
 * A body of 64 KiB can describe megabytes of structures (a two-byte empty sub-message costs a
 * pointer and a struct), so unpacking takes its memory from an arena with a fixed ceiling. The arena
 * keeps its blocks, so that steady state allocates nothing.
 */
#ifndef AIRY_BODY_H
#define AIRY_BODY_H

#include <protobuf-c/protobuf-c.h>
#include <stddef.h>
#include <stdint.h>

#include "airy.pb-c.h"
#include "conn.h"

enum {
    BODY_ARENA_BLOCKS = 8,
    BODY_ARENA_FIRST_BYTES = 4096, /* block i has BODY_ARENA_FIRST_BYTES << i: 1 020 KiB in all */
};

/* Zero-initialised is an empty arena. Owned by one thread at a time. */
struct body_arena {
    uint8_t *block[BODY_ARENA_BLOCKS];
    unsigned current;  /* block being filled */
    size_t used_bytes; /* of the current block */
};

void body_arena_finish(struct body_arena *a); /* frees the blocks; the arena is empty again */
/* All that was taken from the arena is given up; its memory is kept. */
void body_arena_reset(struct body_arena *a);
/* Zeroed memory, valid until the arena is reset or finished; NULL above the ceiling. */
void *body_arena_alloc(struct body_arena *a, size_t bytes);

/*
 * Unpacks a body. Resets the arena first: what an earlier call returned is gone. The message lives in the
 * arena (never protobuf_c_message_free_unpacked it). It does not point into `bytes`. NULL and *f
 * (FAULT_BAD_BODY, or FAULT_NO_MEMORY when malloc failed) when it cannot be decoded.
 *
 *     Airy__Bloom *b = body_unpack(&airy__bloom__descriptor, m.body, m.header.body_bytes, &arena, &f);
 *
 * Strings may hold any bytes but NUL (a NUL ends them); enums may hold any number; sub-messages
 * that did not come are NULL.
 */
void *body_unpack(const ProtobufCMessageDescriptor *d, const uint8_t *bytes, size_t n,
                  struct body_arena *arena, struct fault *f);

/* Packs and queues a message (conn_send). m NULL: an empty body. 0, -EMSGSIZE when it is longer
 * than WIRE_CONTROL_BYTES_MAX, -ENOMEM. fds become the conn's on success only. */
int body_send(struct conn *c, enum wire_type type, uint64_t id, const ProtobufCMessage *m,
              const int *fds, unsigned n_fds);

/* ERROR for f, in the words of fault.h's table. 0 or -ENOMEM. */
int body_send_fault(struct conn *c, uint64_t id, const struct fault *f);

#endif
