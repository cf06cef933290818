/* SPDX-License-Identifier: Apache-2.0 */
/* make_vectors.h - what the files of make_vectors share: an example message. */
#ifndef MAKE_VECTORS_H
#define MAKE_VECTORS_H

#include "airy.pb-c.h"
#include "wire.h"

struct vector {
    const char *name, *what;
    enum wire_type type;
    uint64_t id;
    uint8_t n_fds;
    const ProtobufCMessage *body;
    const char *data; // instead of body: raw bytes
    size_t data_bytes;
    const char *error; // symbol; the message is bad
    int patch_at;      // bad: this byte of the message ...
    uint8_t patch;     // ... becomes this
    const char *from;  // NULL: by type
};

typedef void (*each_vector)(const struct vector *v, void *ctx); // the one callback of this program

/* make_vectors_turns.c: turns, users, memory. */
void turn_vectors(each_vector each, void *ctx);
/* make_vectors_stamp.c: what is done already. */
void stamp_vectors(each_vector each, void *ctx);
/* make_vectors_wall.c: WALL, its answers, and frames for walls. */
void wall_vectors(each_vector each, void *ctx);

#endif
