/* SPDX-License-Identifier: Apache-2.0 */
/*
 * conn.h - one end of the stream: a non-blocking socket, whole messages in and out, descriptors.
 * Shared by daemon and client. One thread at a time.
 *
 * Reading: conn_read takes what the socket has; conn_next hands out one message at a time, its body
 * valid until the next call; DATA bodies can be read straight to their place (conn_set_sink).
 * Writing: conn_send queues; conn_flush writes what the socket takes. A message with descriptors is the
 * only one in its sendmsg. Descriptors queued are owned by the conn until sent, then closed.
 */
#ifndef AIRY_CONN_H
#define AIRY_CONN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "wire.h"

struct conn;

struct conn_message {
    struct wire_header header;
    const uint8_t *body;      /* header.body_bytes; NULL when the sink took it */
    int fds[WIRE_FDS_MAX];    /* header.n_fds of them, now the caller's to close */
};

/* self: which end we are. The conn owns fd (and makes it non-blocking). 0 or -errno. */
int conn_create(struct conn **out, int fd, enum wire_end self);
void conn_destroy(struct conn *c); /* closes everything that it owns; NULL is fine */
int conn_fd(const struct conn *c);

/* Reads once until the socket is dry or `budget` bytes came in. 1: something came, 0: nothing (also when
 * complete messages fill the buffer: conn_next makes room), -EPIPE: the peer closed, -ECONNRESET...:
 * the peer is gone (messages already complete can still be had), -EPROTO: the stream is broken. */
int conn_read(struct conn *c, size_t budget);
/* 1: *m is a message; 0: none complete yet; -1: the stream is broken, *f says how. */
int conn_next(struct conn *c, struct conn_message *m, struct fault *f);

/* Where the body of DATA messages with this id goes: called when a DATA header is complete. Returns a
 * place for `bytes`, or NULL to have it delivered as body. The place must stay valid until the
 * message is delivered by conn_next or the conn is destroyed. */
void conn_set_sink(struct conn *c, void *(*place)(void *ctx, uint64_t id, uint32_t bytes), void *ctx);

/* Queues a copy of the body. 0 or -ENOMEM. fds (n_fds of them) become the conn's on success. */
int conn_send(struct conn *c, enum wire_type type, uint64_t id, const void *body, size_t bytes,
              const int *fds, unsigned n_fds);
/* Queues DATA messages over memory that stays as it is until `done` is called (with ctx; NULL is
 * fine) - after the last byte was written, from conn_flush, or when the conn is destroyed. `done` may
 * queue more, but must not destroy the conn. No bytes, no message: only `done`. */
int conn_send_data(struct conn *c, uint64_t id, const void *data, uint64_t bytes,
                   void (*done)(void *ctx), void *ctx);
/* 1: all is written, 0: the socket is full or had its share of this call (wait for POLLOUT,
 * level-triggered), -errno: the peer is gone (what it sent before can still be read). */
int conn_flush(struct conn *c);
uint64_t conn_unsent_bytes(const struct conn *c);
bool conn_wants_write(const struct conn *c);

#endif
