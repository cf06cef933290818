// SPDX-License-Identifier: Apache-2.0
// airy_peer.c - the scripted peer of libairy's tests.
#include "airy_peer.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <poll.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

unsigned count_fds(void)
{
    unsigned n = 0;
    for (int fd = 0; fd < 256; fd++)
        n += fcntl(fd, F_GETFD) >= 0;
    return n;
}

int wait_readable(struct peer *p, int timeout_ms)
{
    struct pollfd w = { .fd = conn_fd(p->conn), .events = POLLIN };
    return poll(&w, 1, timeout_ms);
}

void peer_flush(struct peer *p)
{
    int n;
    while ((n = conn_flush(p->conn)) == 0) {
        struct pollfd w = { .fd = conn_fd(p->conn), .events = POLLOUT };
        must(poll(&w, 1, 10000) == 1);
    }
    must(n == 1);
}

struct conn_message peer_next(struct peer *p, enum wire_type expected)
{
    struct conn_message m;
    struct fault f = { .text = "" };
    int n;
    while ((n = conn_next(p->conn, &m, &f)) == 0) {
        must(wait_readable(p, 10000) == 1);
        must(conn_read(p->conn, 1 << 20) == 1);
    }
    if (n < 0)
        fprintf(stderr, "the client broke the stream: %s\n", f.text);
    must(n == 1);
    must(m.header.type == expected);
    return m;
}

void *peer_body(struct peer *p, const struct conn_message *m, const ProtobufCMessageDescriptor *d)
{
    void *body = body_unpack(d, m->body, m->header.body_bytes, &p->arena, NULL);
    must(body);
    return body;
}

void peer_send(struct peer *p, enum wire_type type, uint64_t id, const ProtobufCMessage *m)
{
    must(body_send(p->conn, type, id, m, NULL, 0) == 0);
    peer_flush(p);
}

void peer_welcome(struct peer *p)
{
    struct conn_message m = peer_next(p, WIRE_HELLO);
    must(m.header.id == 0);
    Airy__Hello *h = peer_body(p, &m, &airy__hello__descriptor);
    must(h->version_min == 1 && h->version_max == 1);
    must(!strcmp(h->client, "libairy/" AIRY_VERSION));
    Airy__Limits limits = AIRY__LIMITS__INIT;
    limits.max_frame_bytes = BIG_BYTES;
    limits.max_width = limits.max_height = 16384;
    limits.max_pixels = 1 << 27;
    limits.credit_bytes = p->credit_bytes;
    limits.max_requests = p->max_requests;
    limits.max_body_bytes = WIRE_DATA_BYTES_MAX;
    Airy__Device device = AIRY__DEVICE__INIT;
    device.name = (char *)"test device";
    Airy__Welcome w = AIRY__WELCOME__INIT;
    w.version = 1;
    w.server = (char *)"peer/1";
    w.limits = &limits;
    w.device = &device;
    char *features[] = { (char *)"exr", (char *)"wall" };
    w.features = features;
    w.n_features = p->no_walls ? 1 : 2;
    peer_send(p, WIRE_WELCOME, 0, &w.base);
}

void peer_credit(struct peer *p, uint64_t bytes)
{
    Airy__Credit c = AIRY__CREDIT__INIT;
    c.bytes = bytes;
    peer_send(p, WIRE_CREDIT, 0, &c.base);
}

uint64_t peer_bloom(struct peer *p)
{
    struct conn_message m = peer_next(p, WIRE_BLOOM);
    for (unsigned i = 0; i < m.header.n_fds; i++)
        close(m.fds[i]);
    return m.header.id;
}

void peer_result(struct peer *p, uint64_t id, Airy__Payload__Kind kind, uint64_t offset, uint64_t size,
                 int fd)
{
    Airy__Payload output = AIRY__PAYLOAD__INIT;
    Airy__Result r = AIRY__RESULT__INIT;
    output.kind = kind;
    output.offset = offset;
    output.size = size;
    r.output = &output;
    must(body_send(p->conn, WIRE_RESULT, id, &r.base, &fd, fd >= 0) == 0);
    peer_flush(p);
}

void peer_result_text(struct peer *p, uint64_t id, const char *text)
{
    must(conn_send(p->conn, WIRE_DATA, id, text, strlen(text), NULL, 0) == 0);
    peer_result(p, id, AIRY__PAYLOAD__KIND__INLINE, 0, strlen(text), -1);
}

void peer_fault(struct peer *p, uint64_t id, enum fault_code code, const char *field, const char *text)
{
    struct fault f;
    fault_set(&f, code, field, "%s", text);
    f.retry_after_ms = code == FAULT_BUSY ? 250 : 0;
    must(body_send_fault(p->conn, id, &f) == 0);
    peer_flush(p);
}

int memfd_of(const void *data, size_t bytes, int seals)
{
    int fd = memfd_create("t", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    must(fd >= 0 && write(fd, data, bytes) == (ssize_t)bytes);
    must(fcntl(fd, F_ADD_SEALS, seals) == 0);
    return fd;
}

// Until the client closes.
void peer_until_closed(struct peer *p)
{
    struct conn_message m;
    for (;;) {
        must(wait_readable(p, 10000) == 1);
        if (conn_read(p->conn, 1 << 20) < 0)
            return;
        while (conn_next(p->conn, &m, NULL) == 1)
            for (unsigned i = 0; i < m.header.n_fds; i++)
                close(m.fds[i]);
    }
}

static void *peer_main(void *arg)
{
    struct peer *p = arg;
    p->script(p);
    conn_destroy(p->conn);
    body_arena_finish(&p->arena);
    return NULL;
}

int peer_begin(struct peer *p, void (*script)(struct peer *p))
{
    int fds[2];
    if (!p->credit_bytes)
        p->credit_bytes = 2 * BIG_BYTES;
    if (!p->max_requests)
        p->max_requests = 64;
    p->script = script;
    p->fds_before = count_fds();
    assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, fds), 0);
    assert_int_equal(conn_create(&p->conn, fds[1], WIRE_DAEMON), 0);
    assert_int_equal(pthread_create(&p->thread, NULL, peer_main, p), 0);
    return fds[0];
}

struct airy *open_peer(struct peer *p, void (*script)(struct peer *p))
{
    struct airy *a = NULL;
    struct airy_error e = { .text = "" };
    if (airy_connect_fd(&a, peer_begin(p, script), &e) < 0)
        fail_msg("connect: %s", e.text);
    return a;
}

void close_peer(struct peer *p, struct airy *a)
{
    airy_close(a);
    pthread_join(p->thread, NULL);
    assert_int_equal(count_fds(), p->fds_before);
}

void script_handshake(struct peer *p)
{
    peer_welcome(p);
    peer_until_closed(p);
}

// ---- requests ------------------------------------------------------------------------------------

struct airy_request inline_request(const void *data, uint64_t size)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    r.data = data;
    r.size = size;
    r.inline_output = true;
    return r;
}

uint64_t submit(struct airy *a, const struct airy_request *r)
{
    struct airy_error e = { .text = "" };
    uint64_t id = 0;
    if (airy_submit(a, r, &id, &e) < 0)
        fail_msg("submit: %s", e.text);
    assert_true(id);
    return id;
}

uint64_t submit_text(struct airy *a, const char *text)
{
    struct airy_request r = inline_request(text, strlen(text));
    return submit(a, &r);
}

void expect_text(struct airy *a, uint64_t id, const char *text)
{
    struct airy_result *res = NULL;
    struct airy_error e = { .text = "" };
    int n = airy_wait(a, id, 10000, &res, &e);
    if (n != 1)
        fail_msg("wait for %" PRIu64 ": %d %s", id, n, e.text);
    assert_true(res->id == id);
    assert_int_equal(res->size, strlen(text));
    assert_memory_equal(res->data, text, res->size);
    assert_int_equal(res->fd, -1);
    airy_result_free(res);
}

struct airy_error expect_failure(struct airy *a, uint64_t id, const char *symbol)
{
    struct airy_result *res = NULL;
    struct airy_error e = { .text = "" };
    assert_int_equal(airy_wait(a, id, 10000, &res, &e), -1);
    assert_null(res);
    assert_string_equal(e.symbol, symbol);
    assert_true(e.text[0]);
    return e;
}

void fill(uint8_t *p, size_t n, unsigned seed)
{
    for (size_t i = 0; i < n; i++)
        p[i] = (uint8_t)(i * 2654435761u >> 13 ^ i ^ seed);
}
