// SPDX-License-Identifier: Apache-2.0
//
// fuzz_conn.c - wire.c and conn.c: any bytes, with descriptors anywhere, in any pieces, at either end of a socket.
//
// What is checked: a header that was decoded encodes to the same bytes; a message keeps to the limits, its body can be
// read, its descriptors are open; a broken stream stays broken; a message sent on by the other end arrives the same; no
// descriptor is left over. Input: one byte of ways, then steps of one byte, each with its bytes.
#include <errno.h>
#include <fcntl.h>
#include <sys/socket.h>

#include "conn.h"
#include "fuzz.h"

enum {
    WAY_DAEMON = 1, /* the end under test */
    WAY_SINK = 2,
    WAY_SMALL = 4,  /* reads of few bytes */
    STEP_SEND = 0,  /* u8 length */
    STEP_LONG = 1,  /* u16 length */
    STEP_FDS = 2,   /* u8 length, step >> 2 & 3 descriptors and one more */
    STEP_READ = 3,
};

struct rig {
    struct conn *conn;
    int peer;
    enum wire_end self;
    size_t budget;
    uint8_t *sink; /* of the DATA message that is coming */
    bool broken, ended;
};

static void check_header(const uint8_t *bytes)
{
    const enum wire_end ends[] = { WIRE_CLIENT, WIRE_DAEMON };
    for (unsigned i = 0; i < 2; i++) {
        struct wire_header h;
        struct fault f = { .code = FAULT_NONE };
        uint8_t again[WIRE_HEADER_BYTES];
        if (wire_decode(&h, bytes, ends[i], &f) < 0) {
            must(f.code != FAULT_NONE && *f.text);
            continue;
        }
        must(h.n_fds <= WIRE_FDS_MAX);
        must(h.body_bytes <= (h.type == WIRE_DATA ? (uint32_t)WIRE_DATA_BYTES_MAX : (uint32_t)WIRE_CONTROL_BYTES_MAX));
        wire_encode(again, &h);
        must(!memcmp(again, bytes, sizeof(again)));
    }
}

static void *place(void *ctx, uint64_t id, uint32_t bytes)
{
    struct rig *r = ctx;
    if (id & 1)
        return NULL;
    free(r->sink);
    r->sink = malloc(bytes);
    must(r->sink);
    return r->sink;
}

// ---- the same message, sent by the code under test -----------------------------------------------------

static void count(void *ctx) { ++*(unsigned *)ctx; }

static void send_on(const struct rig *r, const struct conn_message *m, const uint8_t *body)
{
    int fd[2];
    unsigned sent = 0;
    struct conn *from, *to;
    struct conn_message got;
    struct fault f;
    const struct wire_header *h = &m->header;
    must(!socketpair(AF_UNIX, SOCK_STREAM, 0, fd));
    must(!conn_create(&from, fd[0], r->self == WIRE_DAEMON ? WIRE_CLIENT : WIRE_DAEMON) && !conn_create(&to, fd[1], r->self));
    const bool pieces = h->type == WIRE_DATA && h->body_bytes && h->id & 2;
    if (pieces)
        must(!conn_send_data(from, h->id, body, h->body_bytes, count, &sent));
    else
        must(!conn_send(from, h->type, h->id, body, h->body_bytes, m->fds, h->n_fds));
    for (int n; (n = conn_next(to, &got, &f)) != 1;) {
        must(n == 0 && conn_flush(from) >= 0);
        must(conn_read(to, 1 << 20) == 1);
    }
    must(conn_flush(from) == 1 && !conn_unsent_bytes(from) && !conn_wants_write(from));
    must(sent == pieces);
    must(got.header.type == h->type && got.header.id == h->id && got.header.n_fds == h->n_fds);
    must(got.header.body_bytes == h->body_bytes && (!h->body_bytes || !memcmp(got.body, body, h->body_bytes)));
    for (unsigned i = 0; i < h->n_fds; i++)
        must(!close(got.fds[i]));
    if (pieces) // these were not sent
        must(!h->n_fds);
    conn_destroy(from);
    conn_destroy(to);
}

// ---- what comes ----------------------------------------------------------------------------------------

static void take_message(struct rig *r, const struct conn_message *m)
{
    const struct wire_header *h = &m->header;
    must(h->n_fds <= WIRE_FDS_MAX);
    for (unsigned i = 0; i < h->n_fds; i++)
        must(fcntl(m->fds[i], F_GETFD) == FD_CLOEXEC);
    must(m->body || r->sink);
    send_on(r, m, m->body ? m->body : r->sink);
}

static void take_all(struct rig *r)
{
    struct conn_message m;
    struct fault f = { .code = FAULT_NONE };
    for (;;) {
        const int came = conn_read(r->conn, r->budget);
        int n;
        while ((n = conn_next(r->conn, &m, &f)) == 1)
            take_message(r, &m);
        if (n < 0) {
            must(f.code != FAULT_NONE && fault_closes(f.code) && *f.text);
            must(conn_read(r->conn, r->budget) == -EPROTO && conn_next(r->conn, &m, &f) == -1);
            r->broken = true;
            return;
        }
        r->ended = came < 0;
        if (came <= 0)
            return;
    }
}

static void give(struct rig *r, const uint8_t *bytes, size_t n, unsigned n_fds)
{
    const int fds[4] = { STDERR_FILENO, STDERR_FILENO, STDERR_FILENO, STDERR_FILENO };
    while (n && !r->broken) {
        const ssize_t sent = fuzz_send(r->peer, bytes, n, fds, n_fds);
        if (sent < 0) {
            must(errno == EAGAIN);
            take_all(r);
            continue;
        }
        bytes += sent;
        n -= (size_t)sent;
        n_fds = 0;
    }
}

static void run(struct rig *r, struct fuzz_in *in)
{
    while (in->left && !r->broken) {
        const uint8_t step = fuzz_u8(in);
        const unsigned kind = step & 3;
        size_t n;
        if (kind == STEP_READ) {
            take_all(r);
            continue;
        }
        const uint8_t *bytes = fuzz_piece(in, kind == STEP_LONG ? fuzz_u16(in) : fuzz_u8(in), &n);
        give(r, bytes, n, kind == STEP_FDS ? 1 + (step >> 2 & 3) : 0);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct fuzz_in in = { data, size };
    const uint8_t way = fuzz_u8(&in);
    const int next = fuzz_next_fd();
    int fd[2];
    for (size_t i = 0; i + WIRE_HEADER_BYTES <= in.left && i < 4; i++)
        check_header(in.at + i);
    must(!socketpair(AF_UNIX, SOCK_STREAM, 0, fd));
    struct rig r = { .peer = fd[1], .self = way & WAY_DAEMON ? WIRE_DAEMON : WIRE_CLIENT, .budget = way & WAY_SMALL ? 1 + way / 8 : 1 << 16 };
    must(!conn_create(&r.conn, fd[0], r.self));
    if (way & WAY_SINK)
        conn_set_sink(r.conn, place, &r);
    run(&r, &in);
    must(!close(r.peer));
    if (!r.broken)
        take_all(&r);
    must(r.broken || r.ended);
    conn_destroy(r.conn);
    free(r.sink);
    must(fuzz_next_fd() == next);
    return 0;
}
