/* SPDX-License-Identifier: Apache-2.0 */
/*
 * fault.h - what went wrong with a request, in the words that go on the wire.
 *
 * A function that can be at odds with what came from outside takes a struct fault *
 * and returns 0 or -1 (with the fault filled, outputs untouched). The codes are
 * stable: PROTOCOL.md lists them, clients switch on them, numbers are never reused.
 */
#ifndef AIRY_FAULT_H
#define AIRY_FAULT_H

#include <stdbool.h>
#include <stdint.h>

/* X(code, SYMBOL, retryable, closes the connection, meaning) */
#define AIRY_FAULTS(X)                                                                            \
    X(100, BAD_MAGIC, 0, 1, "the stream is not this protocol")                                    \
    X(101, BAD_VERSION, 0, 1, "no common protocol version")                                       \
    X(102, UNEXPECTED, 0, 1, "this message may not come now")                                     \
    X(103, TOO_LONG, 0, 1, "a message body is longer than the limit")                             \
    X(104, BAD_BODY, 0, 1, "a message body cannot be decoded")                                    \
    X(105, BAD_FDS, 0, 1, "descriptors do not match the header's count")                          \
    X(106, DUPLICATE_ID, 0, 0, "the request id is in use on this connection")                     \
    X(200, PARAM_UNKNOWN, 0, 0, "no parameter of this name")                                      \
    X(201, PARAM_RANGE, 0, 0, "a parameter is outside its range")                                 \
    X(202, PARAM_SYNTAX, 0, 0, "a parameter cannot be read")                                      \
    X(203, PARAM_CONFLICT, 0, 0, "parameters contradict each other")                              \
    X(210, PAYLOAD, 0, 0, "the payload is not what the request says")                             \
    X(211, PAYLOAD_SEALS, 0, 0, "the memfd is not sealed against shrinking")                      \
    X(212, LAYOUT, 0, 0, "the raw layout is not possible")                                        \
    X(220, NO_PART, 0, 0, "the file has no such part")                                            \
    X(221, NO_LAYER, 0, 0, "the file has no such layer")                                          \
    X(222, NO_VIEW, 0, 0, "the file has no such view")                                            \
    X(223, NO_ASSET, 0, 0, "no image of this digest: send it first")                              \
    X(224, NO_WALL, 0, 0, "no wall of this name: open it first")                                  \
    X(300, NOT_EXR, 0, 0, "the payload is not an OpenEXR file")                                   \
    X(301, EXR_DAMAGED, 0, 0, "the OpenEXR file is damaged or truncated")                         \
    X(302, EXR_TOO_LARGE, 0, 0, "the OpenEXR file is larger than the limits")                     \
    X(303, EXR_UNSUPPORTED, 0, 0, "the OpenEXR file uses what cannot be bloomed")                 \
    X(304, NONFINITE, 0, 0, "the frame has NaN or Inf and nonfinite=reject")                      \
    X(305, WALL, 0, 0, "the wall definition has mistakes")                                        \
    X(400, BUSY, 1, 0, "too much in flight; try again")                                           \
    X(401, LIMIT, 0, 0, "the request is larger than the limits")                                  \
    X(402, NO_MEMORY, 1, 0, "out of memory")                                                      \
    X(403, WALL_BUSY, 1, 0, "another client's frames are on this wall")                           \
    X(404, DEADLINE, 1, 0, "the request waited longer than its deadline")                         \
    X(500, INTERNAL, 0, 0, "a fault in the daemon")                                               \
    X(501, DEVICE_LOST, 1, 0, "the Vulkan device was lost")                                       \
    X(502, SHUTTING_DOWN, 1, 0, "the daemon is stopping")

enum fault_code {
    FAULT_NONE = 0,
#define X(code, symbol, retryable, closes, text) FAULT_##symbol = code,
    AIRY_FAULTS(X)
#undef X
};

struct fault {
    enum fault_code code;
    char field[64];  /* "params.sigma", "input.size"; empty when there is none */
    char text[320];  /* one sentence: what was found, what was expected */
    uint32_t retry_after_ms;
    uint32_t queue_position;
};

/* Fills *f and returns -1, so that a caller can write `return fault_set(...)`. f may be NULL. */
int fault_set(struct fault *f, enum fault_code code, const char *field, const char *format, ...)
    __attribute__((format(printf, 4, 5)));

const char *fault_symbol(enum fault_code code);  /* "PARAM_RANGE"; "UNKNOWN" for no code of ours */
bool fault_retryable(enum fault_code code);
bool fault_closes(enum fault_code code); /* the daemon closes after sending it */

#endif
