/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wire.h - the frame around every message: encode, decode, validate. Pure: no sockets, no allocation.
 *
 * 24 bytes, little-endian:
 *   0  u32 magic 0x59524941 ("AIRY")      8  u32 body length in bytes
 *   4  u8  protocol version (1)          12  u32 reserved, 0
 *   5  u8  type                          16  u64 request id, chosen by the client (0: none)
 *   6  u8  descriptors that come with the header's first byte, 0..WIRE_FDS_MAX
 *   7  u8  flags
 */
#ifndef AIRY_WIRE_H
#define AIRY_WIRE_H

#include <stddef.h>
#include <stdint.h>

#include "fault.h"

enum {
    WIRE_HEADER_BYTES = 24,
    WIRE_VERSION = 1,
    WIRE_FDS_MAX = 2,
    WIRE_CONTROL_BYTES_MAX = 64 * 1024,   /* body of any message but DATA */
    WIRE_DATA_BYTES_MAX = 1024 * 1024,    /* body of DATA */
};
#define WIRE_MAGIC UINT32_C(0x59524941)

/* X(number, NAME, who sends it: C client, D daemon, B both; fds allowed at most) */
#define WIRE_TYPES(X)                                                                             \
    X(1, HELLO, 'C', 0)                                                                           \
    X(2, WELCOME, 'D', 0)                                                                         \
    X(3, BLOOM, 'C', 2)                                                                           \
    X(4, DATA, 'B', 0)                                                                            \
    X(5, RESULT, 'D', 1)                                                                          \
    X(6, ERROR, 'D', 0)                                                                           \
    X(7, CANCEL, 'C', 0)                                                                          \
    X(8, CANCELLED, 'D', 0)                                                                       \
    X(9, STATUS, 'C', 0)                                                                          \
    X(10, STATUS_REPLY, 'D', 0)                                                                   \
    X(11, CREDIT, 'D', 0)                                                                         \
    X(12, PROGRESS, 'D', 0)                                                                       \
    X(13, ASSET, 'C', 1)                                                                          \
    X(14, ASSET_KEPT, 'D', 0)                                                                     \
    X(15, WALL, 'C', 0)                                                                           \
    X(16, WALL_REPLY, 'D', 0)

enum wire_type {
#define X(number, name, who, fds) WIRE_##name = number,
    WIRE_TYPES(X)
#undef X
};

struct wire_header {
    enum wire_type type;
    uint8_t n_fds;
    uint8_t flags;       /* none defined: 0 */
    uint32_t body_bytes;
    uint64_t id;
};

enum wire_end { WIRE_CLIENT = 'C', WIRE_DAEMON = 'D' };

void wire_encode(uint8_t out[WIRE_HEADER_BYTES], const struct wire_header *h);
/* Decodes and checks a header that `sender` sent. 0, or -1 and *f (FAULT_BAD_MAGIC, _BAD_VERSION,
 * _UNEXPECTED for a type that this end may not send, _TOO_LONG, _BAD_FDS, _BAD_BODY for flags or
 * reserved bits). */
int wire_decode(struct wire_header *h, const uint8_t in[WIRE_HEADER_BYTES], enum wire_end sender,
                struct fault *f);
const char *wire_type_name(enum wire_type t);

#endif
