// SPDX-License-Identifier: Apache-2.0
//
// test_conn.c - the stream over a real socketpair: every way of cutting it, descriptors, sinks, hostile
// peers. The other end is a bare socket here, or a second conn.
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "conn.h"

enum { BUDGET = 1 << 22 };

struct pair {
    struct conn *daemon; // under test
    int peer;            // the client's bare socket
    unsigned fds_before;
};

static unsigned count_fds(void)
{
    unsigned n = 0;
    for (int fd = 0; fd < 256; fd++)
        n += fcntl(fd, F_GETFD) >= 0;
    return n;
}

static struct pair pair_open(void)
{
    struct pair p = { .fds_before = count_fds() };
    int fds[2];
    assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, fds), 0);
    assert_int_equal(conn_create(&p.daemon, fds[0], WIRE_DAEMON), 0);
    assert_true(fcntl(fds[0], F_GETFL) & O_NONBLOCK);
    p.peer = fds[1];
    return p;
}

// No descriptor may be left over, whatever happened.
static void pair_close(struct pair *p)
{
    conn_destroy(p->daemon);
    if (p->peer >= 0)
        close(p->peer);
    assert_int_equal(count_fds(), p->fds_before);
}

static size_t message(uint8_t *out, enum wire_type type, unsigned n_fds, uint64_t id, const void *body,
                      size_t n)
{
    wire_encode(out, &(struct wire_header){
                         .type = type, .n_fds = (uint8_t)n_fds, .body_bytes = (uint32_t)n, .id = id });
    if (n)
        memcpy(out + WIRE_HEADER_BYTES, body, n);
    return WIRE_HEADER_BYTES + n;
}

static void send_with_fds(int fd, const void *bytes, size_t n, unsigned n_fds, const int *fds)
{
    union {
        struct cmsghdr align;
        uint8_t bytes[CMSG_SPACE(300 * sizeof(int))];
    } control = { .bytes = { 0 } };
    struct iovec iov = { (void *)bytes, n };
    struct msghdr h = { .msg_iov = &iov, .msg_iovlen = 1 };
    if (n_fds) {
        h.msg_control = &control;
        h.msg_controllen = CMSG_SPACE(n_fds * sizeof(int));
        struct cmsghdr *m = CMSG_FIRSTHDR(&h);
        m->cmsg_level = SOL_SOCKET;
        m->cmsg_type = SCM_RIGHTS;
        m->cmsg_len = CMSG_LEN(n_fds * sizeof(int));
        memcpy(CMSG_DATA(m), fds, n_fds * sizeof(int));
    }
    assert_int_equal(sendmsg(fd, &h, MSG_NOSIGNAL), (ssize_t)n);
}

static int a_file(const char *text)
{
    int fd = memfd_create("t", MFD_CLOEXEC);
    assert_true(fd >= 0);
    assert_int_equal(write(fd, text, strlen(text)), (ssize_t)strlen(text));
    return fd;
}

static void expect_file(int fd, const char *text)
{
    char got[64] = "";
    assert_true(pread(fd, got, sizeof(got) - 1, 0) >= 0);
    assert_string_equal(got, text);
    assert_true(fcntl(fd, F_GETFD) & FD_CLOEXEC);
    close(fd);
}

static void read_all(struct conn *c)
{
    int n;
    while ((n = conn_read(c, BUDGET)) == 1)
        ;
    assert_int_equal(n, 0);
}

static void expect_message(struct conn *c, enum wire_type type, uint64_t id, const void *body, size_t n)
{
    struct conn_message m;
    struct fault f = { .text = "" };
    int got = conn_next(c, &m, &f);
    if (got != 1)
        fail_msg("conn_next: %d %s", got, f.text);
    assert_int_equal(m.header.type, type);
    assert_true(m.header.id == id);
    assert_int_equal(m.header.body_bytes, n);
    assert_int_equal(m.header.n_fds, 0);
    if (n)
        assert_memory_equal(m.body, body, n);
}

static void expect_nothing(struct conn *c)
{
    struct conn_message m;
    struct fault f = { .text = "" };
    int got = conn_next(c, &m, &f);
    if (got)
        fail_msg("conn_next: %d %s", got, f.text);
}

static void expect_broken(struct conn *c, enum fault_code code)
{
    struct conn_message m;
    struct fault f = { .code = FAULT_NONE };
    assert_int_equal(conn_next(c, &m, &f), -1);
    if (f.code != code)
        fail_msg("%s (%s), expected %s", fault_symbol(f.code), f.text, fault_symbol(code));
    assert_true(f.text[0]);
    // It stays broken, and says the same.
    struct fault again;
    assert_int_equal(conn_next(c, &m, &again), -1);
    assert_int_equal(again.code, code);
    assert_string_equal(again.text, f.text);
    assert_int_equal(conn_read(c, BUDGET), -EPROTO);
}

// ---- cutting ---------------------------------------------------------------------------------------

static void one_byte_at_a_time(void **state)
{
    (void)state;
    struct pair p = pair_open();
    uint8_t bytes[256];
    int file = a_file("one");
    size_t first = message(bytes, WIRE_BLOOM, 1, 7, "hello", 5);
    size_t n = first + message(bytes + first, WIRE_CANCEL, 0, 8, NULL, 0);
    for (size_t i = 0; i < n; i++) {
        send_with_fds(p.peer, bytes + i, 1, i == 0, &file);
        assert_int_equal(conn_read(p.daemon, BUDGET), 1);
        if (i + 1 == first) {
            struct conn_message m;
            struct fault f;
            assert_int_equal(conn_next(p.daemon, &m, &f), 1);
            assert_int_equal(m.header.n_fds, 1);
            assert_memory_equal(m.body, "hello", 5);
            expect_file(m.fds[0], "one");
        } else if (i + 1 == n) {
            expect_message(p.daemon, WIRE_CANCEL, 8, NULL, 0);
        } else {
            expect_nothing(p.daemon);
        }
    }
    expect_nothing(p.daemon);
    assert_int_equal(conn_read(p.daemon, BUDGET), 0);
    close(file);
    pair_close(&p);
}

// The peer goes away after each possible number of bytes: no message, no leak, a clear end.
static void truncated_at_each_byte(void **state)
{
    (void)state;
    uint8_t bytes[256];
    int file = a_file("cut");
    size_t whole = message(bytes, WIRE_BLOOM, 1, 7, "0123456789", 10);
    for (size_t n = 0; n < whole; n++) {
        struct pair p = pair_open();
        if (n)
            send_with_fds(p.peer, bytes, n, 1, &file);
        close(p.peer);
        p.peer = -1;
        if (n)
            assert_int_equal(conn_read(p.daemon, BUDGET), 1);
        expect_nothing(p.daemon);
        assert_int_equal(conn_read(p.daemon, BUDGET), -EPIPE);
        expect_nothing(p.daemon);
        pair_close(&p);
    }
    close(file);
}

static void several_messages_in_one_read(void **state)
{
    (void)state;
    struct pair p = pair_open();
    uint8_t bytes[256];
    size_t n = message(bytes, WIRE_STATUS, 0, 1, NULL, 0);
    n += message(bytes + n, WIRE_DATA, 0, 2, "abc", 3);
    n += message(bytes + n, WIRE_CANCEL, 0, 3, NULL, 0);
    send_with_fds(p.peer, bytes, n, 0, NULL);
    read_all(p.daemon);
    expect_message(p.daemon, WIRE_STATUS, 1, NULL, 0);
    expect_message(p.daemon, WIRE_DATA, 2, "abc", 3);
    expect_message(p.daemon, WIRE_CANCEL, 3, NULL, 0);
    expect_nothing(p.daemon);
    // What was complete when the peer went can still be had.
    send_with_fds(p.peer, bytes, n, 0, NULL);
    close(p.peer);
    p.peer = -1;
    assert_int_equal(conn_read(p.daemon, BUDGET), 1);
    assert_int_equal(conn_read(p.daemon, BUDGET), -EPIPE);
    expect_message(p.daemon, WIRE_STATUS, 1, NULL, 0);
    expect_message(p.daemon, WIRE_DATA, 2, "abc", 3);
    expect_message(p.daemon, WIRE_CANCEL, 3, NULL, 0);
    expect_nothing(p.daemon);
    pair_close(&p);
}

static void a_small_budget_loses_nothing(void **state)
{
    (void)state;
    for (size_t budget = 1; budget < 70; budget++) {
        struct pair p = pair_open();
        uint8_t bytes[256];
        int files[2] = { a_file("a"), a_file("b") };
        for (unsigned i = 0; i < 2; i++) {
            size_t n = message(bytes, WIRE_BLOOM, 1, i, "0123456789", 10);
            send_with_fds(p.peer, bytes, n, 1, &files[i]);
            n = message(bytes, WIRE_CANCEL, 0, i, NULL, 0);
            send_with_fds(p.peer, bytes, n, 0, NULL);
        }
        unsigned messages = 0;
        while (conn_read(p.daemon, budget) == 1) {
            struct conn_message m;
            struct fault f = { .text = "" };
            int got;
            while ((got = conn_next(p.daemon, &m, &f)) == 1) {
                assert_int_equal(m.header.n_fds, messages % 2 == 0);
                if (m.header.n_fds)
                    expect_file(m.fds[0], messages ? "b" : "a");
                messages++;
            }
            if (got < 0)
                fail_msg("budget %zu: %s", budget, f.text);
        }
        assert_int_equal(messages, 4);
        close(files[0]);
        close(files[1]);
        pair_close(&p);
    }
}

static void thousands_of_small_messages(void **state)
{
    (void)state;
    struct pair p = pair_open();
    struct conn *client;
    assert_int_equal(conn_create(&client, p.peer, WIRE_CLIENT), 0);
    p.peer = -1;
    enum { COUNT = 20000 };
    uint64_t sent = 0, got = 0, unsent = 0;
    while (got < COUNT) {
        for (unsigned i = 0; i < 100 && sent < COUNT; i++, sent++) {
            uint8_t body[256];
            memset(body, (int)(sent % 251), sizeof(body));
            assert_int_equal(conn_send(client, WIRE_DATA, sent, body, sent % 257, NULL, 0), 0);
            unsent += WIRE_HEADER_BYTES + sent % 257;
        }
        assert_true(conn_unsent_bytes(client) <= unsent);
        assert_true(conn_flush(client) >= 0);
        conn_read(p.daemon, 5000);
        struct conn_message m;
        struct fault f = { .text = "" };
        int n;
        while ((n = conn_next(p.daemon, &m, &f)) == 1) {
            assert_true(m.header.id == got);
            assert_int_equal(m.header.body_bytes, got % 257);
            for (unsigned i = 0; i < m.header.body_bytes; i++)
                assert_int_equal(m.body[i], got % 251);
            got++;
        }
        if (n < 0)
            fail_msg("%s", f.text);
    }
    assert_int_equal(conn_flush(client), 1);
    assert_false(conn_wants_write(client));
    assert_int_equal(conn_unsent_bytes(client), 0);
    expect_nothing(p.daemon);
    conn_destroy(client);
    pair_close(&p);
}

// ---- descriptors -----------------------------------------------------------------------------------

// A second message's descriptors come while the first is incomplete, or in the same read as its end.
static void descriptors_find_their_message(void **state)
{
    (void)state;
    for (size_t cut = 1; cut < WIRE_HEADER_BYTES + 10; cut++) {
        struct pair p = pair_open();
        uint8_t bytes[256];
        int files[3] = { a_file("first"), a_file("second"), a_file("third") };
        size_t n = message(bytes, WIRE_BLOOM, 1, 1, "0123456789", 10);
        send_with_fds(p.peer, bytes, cut, 1, &files[0]);
        if (cut % 2)
            read_all(p.daemon), expect_nothing(p.daemon);
        send_with_fds(p.peer, bytes + cut, n - cut, 0, NULL);
        n = message(bytes, WIRE_CANCEL, 0, 2, NULL, 0);
        send_with_fds(p.peer, bytes, n, 0, NULL);
        n = message(bytes, WIRE_BLOOM, 2, 3, "x", 1);
        send_with_fds(p.peer, bytes, n, 2, &files[1]);
        read_all(p.daemon);
        struct conn_message m;
        struct fault f;
        assert_int_equal(conn_next(p.daemon, &m, &f), 1);
        assert_int_equal(m.header.n_fds, 1);
        expect_file(m.fds[0], "first");
        expect_message(p.daemon, WIRE_CANCEL, 2, NULL, 0);
        assert_int_equal(conn_next(p.daemon, &m, &f), 1);
        assert_int_equal(m.header.n_fds, 2);
        expect_file(m.fds[0], "second");
        expect_file(m.fds[1], "third");
        expect_nothing(p.daemon);
        for (unsigned i = 0; i < 3; i++)
            close(files[i]);
        pair_close(&p);
    }
}

static void wrong_counts_break_the_stream(void **state)
{
    (void)state;
    static const struct {
        unsigned stated, sent;
    } cases[] = { { 0, 1 }, { 0, 2 }, { 1, 0 },   { 1, 2 },  { 2, 0 },
                  { 2, 1 }, { 2, 3 }, { 1, 100 }, { 2, 253 } };
    for (unsigned i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        struct pair p = pair_open();
        uint8_t bytes[256];
        int fds[253];
        for (unsigned k = 0; k < 253; k++)
            fds[k] = STDERR_FILENO;
        size_t n = message(bytes, WIRE_BLOOM, cases[i].stated, 1, "body", 4);
        send_with_fds(p.peer, bytes, n, cases[i].sent, fds);
        assert_int_equal(conn_read(p.daemon, BUDGET), 1);
        expect_broken(p.daemon, FAULT_BAD_FDS);
        pair_close(&p);
    }
}

static void descriptors_that_no_header_states_are_refused(void **state)
{
    (void)state;
    uint8_t bytes[256];
    int file = a_file("x");
    size_t n = message(bytes, WIRE_BLOOM, 1, 1, "0123456789", 10);
    // With a later byte than the header's first; twice; in the body of a message that states none.
    for (unsigned how = 0; how < 4; how++) {
        struct pair p = pair_open();
        if (how == 0) {
            send_with_fds(p.peer, bytes, 1, 0, NULL);
            read_all(p.daemon);
            send_with_fds(p.peer, bytes + 1, n - 1, 1, &file);
        } else if (how == 1) {
            send_with_fds(p.peer, bytes, 5, 1, &file);
            send_with_fds(p.peer, bytes + 5, n - 5, 1, &file);
        } else if (how == 2) {
            bytes[6] = 0;
            send_with_fds(p.peer, bytes, n - 3, 0, NULL);
            read_all(p.daemon);
            expect_nothing(p.daemon);
            send_with_fds(p.peer, bytes + n - 3, 3, 1, &file);
        } else { // descriptors, and then a message that does not claim them, and the next neither
            message(bytes, WIRE_STATUS, 0, 1, NULL, 0);
            send_with_fds(p.peer, bytes, WIRE_HEADER_BYTES, 1, &file);
        }
        read_all(p.daemon);
        expect_broken(p.daemon, FAULT_BAD_FDS);
        pair_close(&p);
    }
    close(file);
}

// A flood of descriptors, one set a byte, never holds more than the few that are being matched.
static void a_flood_of_descriptors_is_bounded(void **state)
{
    (void)state;
    uint8_t bytes[4096] = { 0 };
    size_t n = message(bytes, WIRE_BLOOM, 1, 1, bytes + 2048, 1000);
    int file = a_file("x");
    assert_true(n > 100);
    // Within a header; within a body of which the header is known.
    for (unsigned start = 0; start < 31; start += 30) {
        struct pair p = pair_open();
        unsigned before = count_fds();
        if (start)
            send_with_fds(p.peer, bytes, start, 1, &file);
        for (unsigned i = start; i < 100; i++)
            send_with_fds(p.peer, bytes + i, 1, 1, &file);
        for (unsigned i = 0; i < 10; i++) {
            conn_read(p.daemon, BUDGET);
            assert_true(count_fds() <= before + 32);
        }
        expect_broken(p.daemon, FAULT_BAD_FDS);
        assert_int_equal(count_fds(), before);
        pair_close(&p);
    }
    close(file);
}

static void descriptors_of_two_conns(void **state)
{
    (void)state;
    struct pair p = pair_open();
    struct conn *client;
    assert_int_equal(conn_create(&client, p.peer, WIRE_CLIENT), 0);
    p.peer = -1;
    enum { COUNT = 200 };
    for (unsigned i = 0; i < COUNT; i++) {
        char text[32];
        snprintf(text, sizeof(text), "file %u", i);
        int fds[2] = { a_file(text), i % 3 == 2 ? a_file("other") : -1 };
        unsigned n = i % 3;
        if (!n)
            close(fds[0]);
        assert_int_equal(conn_send(client, n ? WIRE_BLOOM : WIRE_DATA, i, text, strlen(text), fds, n),
                         0);
        if (i % 10 == 9)
            conn_flush(client);
        if (i % 7 == 0)
            conn_read(p.daemon, 100);
    }
    unsigned got = 0;
    while (got < COUNT) {
        struct conn_message m;
        struct fault f = { .text = "" };
        conn_flush(client);
        conn_read(p.daemon, 1000);
        int n;
        while ((n = conn_next(p.daemon, &m, &f)) == 1) {
            char text[32];
            snprintf(text, sizeof(text), "file %u", got);
            assert_memory_equal(m.body, text, strlen(text));
            assert_int_equal(m.header.n_fds, got % 3);
            if (m.header.n_fds)
                expect_file(m.fds[0], text);
            if (m.header.n_fds == 2)
                expect_file(m.fds[1], "other");
            got++;
        }
        if (n < 0)
            fail_msg("message %u: %s", got, f.text);
    }
    conn_destroy(client);
    pair_close(&p);
}

// Neither what is queued before it nor what is queued after it shares its sendmsg: the kernel ends a
// read where a set of descriptors ends.
static void a_message_with_descriptors_goes_alone(void **state)
{
    (void)state;
    struct pair p = pair_open();
    int file = a_file("alone");
    assert_int_equal(conn_send(p.daemon, WIRE_CREDIT, 1, NULL, 0, NULL, 0), 0);
    assert_int_equal(conn_send(p.daemon, WIRE_RESULT, 2, "body", 4, &file, 1), 0);
    assert_int_equal(conn_send(p.daemon, WIRE_CREDIT, 3, NULL, 0, NULL, 0), 0);
    assert_int_equal(conn_flush(p.daemon), 1);
    static const size_t expected[] = { WIRE_HEADER_BYTES, WIRE_HEADER_BYTES + 4, WIRE_HEADER_BYTES };
    uint8_t bytes[256];
    // The first is read for itself, so that the second read begins where the descriptors do.
    assert_int_equal(recv(p.peer, bytes, expected[0], 0), (ssize_t)expected[0]);
    union {
        struct cmsghdr align;
        uint8_t bytes[CMSG_SPACE(sizeof(int))];
    } control;
    struct iovec iov = { bytes, sizeof(bytes) };
    struct msghdr h = {
        .msg_iov = &iov, .msg_iovlen = 1, .msg_control = &control, .msg_controllen = sizeof(control)
    };
    assert_int_equal(recvmsg(p.peer, &h, MSG_CMSG_CLOEXEC), (ssize_t)expected[1]);
    assert_non_null(CMSG_FIRSTHDR(&h));
    assert_false(h.msg_flags & MSG_CTRUNC);
    int fd;
    memcpy(&fd, CMSG_DATA(CMSG_FIRSTHDR(&h)), sizeof(fd));
    expect_file(fd, "alone");
    assert_int_equal(recv(p.peer, bytes, sizeof(bytes), 0), (ssize_t)expected[2]);
    pair_close(&p);
}

// Queued and never sent, received and never asked for: all closed by conn_destroy (pair_close looks).
static void destroy_closes_what_is_queued(void **state)
{
    (void)state;
    struct pair p = pair_open();
    int fds[2] = { a_file("a"), a_file("b") };
    assert_int_equal(conn_send(p.daemon, WIRE_RESULT, 1, NULL, 0, fds, 1), 0);
    uint8_t bytes[64];
    size_t n = message(bytes, WIRE_BLOOM, 1, 1, "x", 1);
    send_with_fds(p.peer, bytes, n, 1, &fds[1]);
    close(fds[1]);
    assert_int_equal(conn_read(p.daemon, BUDGET), 1);
    pair_close(&p);
}

// ---- hostile bytes ---------------------------------------------------------------------------------

static void bad_headers_break_the_stream(void **state)
{
    (void)state;
    static const struct {
        unsigned at, value;
        enum fault_code code;
    } cases[] = { { 0, 'G', FAULT_BAD_MAGIC }, { 4, 2, FAULT_BAD_VERSION },  { 5, 2, FAULT_UNEXPECTED },
                  { 5, 5, FAULT_UNEXPECTED },  { 5, 200, FAULT_UNEXPECTED }, { 6, 3, FAULT_BAD_FDS },
                  { 7, 4, FAULT_BAD_BODY },    { 11, 0xff, FAULT_TOO_LONG }, { 13, 1, FAULT_BAD_BODY } };
    for (unsigned i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        struct pair p = pair_open();
        uint8_t bytes[128];
        size_t n = message(bytes, WIRE_STATUS, 0, 1, NULL, 0);
        n += message(bytes + n, WIRE_BLOOM, 0, 2, "body", 4);
        bytes[WIRE_HEADER_BYTES + cases[i].at] = (uint8_t)cases[i].value;
        send_with_fds(p.peer, bytes, n, 0, NULL);
        read_all(p.daemon);
        expect_message(p.daemon, WIRE_STATUS, 1, NULL, 0); // what came before is good
        expect_broken(p.daemon, cases[i].code);
        pair_close(&p);
    }
}

static void garbage_breaks_the_stream(void **state)
{
    (void)state;
    srand(12345);
    for (unsigned i = 0; i < 200; i++) {
        struct pair p = pair_open();
        uint8_t bytes[3000];
        for (unsigned k = 0; k < sizeof(bytes); k++)
            bytes[k] = (uint8_t)(rand() >> 7);
        bytes[0] |= 0x80; // never the magic
        send_with_fds(p.peer, bytes, sizeof(bytes), 0, NULL);
        conn_read(p.daemon, BUDGET);
        expect_broken(p.daemon, FAULT_BAD_MAGIC);
        pair_close(&p);
    }
}

// ---- bulk ------------------------------------------------------------------------------------------

struct bulk {
    uint8_t *memory;
    uint64_t bytes, at;
    unsigned calls, done;
};

static void *bulk_place(void *ctx, uint64_t id, uint32_t bytes)
{
    struct bulk *b = ctx;
    if (id != 9 || bytes > b->bytes - b->at)
        return NULL;
    b->calls++;
    return b->memory + b->at;
}

static void bulk_done(void *ctx) { ((struct bulk *)ctx)->done++; }

static void fill(uint8_t *p, size_t n, unsigned seed)
{
    for (size_t i = 0; i < n; i++)
        p[i] = (uint8_t)(i * 2654435761u >> 13 ^ i ^ seed);
}

static void bulk_goes_to_its_sink(void **state)
{
    (void)state;
    static const uint64_t sizes[] = { 0,
                                      1,
                                      4095,
                                      WIRE_DATA_BYTES_MAX - 1,
                                      WIRE_DATA_BYTES_MAX,
                                      WIRE_DATA_BYTES_MAX + 1,
                                      5 * WIRE_DATA_BYTES_MAX + 12345 };
    for (unsigned i = 0; i < sizeof(sizes) / sizeof(sizes[0]); i++) {
        struct pair p = pair_open();
        struct conn *client;
        assert_int_equal(conn_create(&client, p.peer, WIRE_CLIENT), 0);
        p.peer = -1;
        uint8_t *data = malloc(sizes[i] + 1);
        struct bulk in = { .memory = malloc(sizes[i] + 1), .bytes = sizes[i] }, out = { .done = 0 };
        fill(data, sizes[i], i);
        conn_set_sink(p.daemon, bulk_place, &in);
        assert_int_equal(conn_send(client, WIRE_STATUS, 1, NULL, 0, NULL, 0), 0);
        assert_int_equal(conn_send_data(client, 9, data, sizes[i], bulk_done, &out), 0);
        assert_int_equal(conn_send(client, WIRE_CANCEL, 2, NULL, 0, NULL, 0), 0);
        assert_int_equal(out.done, 0);
        uint64_t messages = (sizes[i] + WIRE_DATA_BYTES_MAX - 1) / WIRE_DATA_BYTES_MAX;
        assert_int_equal(conn_unsent_bytes(client), sizes[i] + (messages + 2) * WIRE_HEADER_BYTES);
        unsigned status = 0, cancel = 0, data_messages = 0;
        while (!cancel) {
            conn_flush(client);
            conn_read(p.daemon, 100000 + 7777 * i);
            struct conn_message m;
            struct fault f = { .text = "" };
            int n;
            while ((n = conn_next(p.daemon, &m, &f)) == 1) {
                status += m.header.type == WIRE_STATUS;
                cancel += m.header.type == WIRE_CANCEL;
                if (m.header.type != WIRE_DATA)
                    continue;
                assert_null(m.body);
                in.at += m.header.body_bytes;
                data_messages++;
            }
            if (n < 0)
                fail_msg("size %" PRIu64 ": %s", sizes[i], f.text);
        }
        assert_int_equal(status, 1);
        assert_int_equal(out.done, 1);
        assert_int_equal(in.at, sizes[i]);
        assert_int_equal(data_messages, messages);
        assert_int_equal(in.calls, messages);
        assert_memory_equal(data, in.memory, sizes[i]);
        free(data);
        free(in.memory);
        conn_destroy(client);
        pair_close(&p);
    }
}

// No sink wants it: the largest body comes as a body.
static void the_largest_body_without_a_sink(void **state)
{
    (void)state;
    struct pair p = pair_open();
    struct conn *client;
    assert_int_equal(conn_create(&client, p.peer, WIRE_CLIENT), 0);
    p.peer = -1;
    struct bulk in = { .bytes = 0 };
    conn_set_sink(p.daemon, bulk_place, &in);
    uint8_t *data = malloc(WIRE_DATA_BYTES_MAX);
    fill(data, WIRE_DATA_BYTES_MAX, 3);
    for (unsigned i = 0; i < 3; i++) {
        assert_int_equal(conn_send_data(client, 9, data, WIRE_DATA_BYTES_MAX, NULL, NULL), 0);
        struct conn_message m;
        struct fault f;
        int n;
        do {
            conn_flush(client);
            conn_read(p.daemon, BUDGET);
        } while ((n = conn_next(p.daemon, &m, &f)) == 0);
        assert_int_equal(n, 1);
        assert_int_equal(m.header.body_bytes, WIRE_DATA_BYTES_MAX);
        assert_memory_equal(m.body, data, WIRE_DATA_BYTES_MAX);
    }
    assert_int_equal(in.calls, 0);
    free(data);
    conn_destroy(client);
    pair_close(&p);
}

static void a_gone_peer_is_an_error_and_no_signal(void **state)
{
    (void)state;
    struct pair p = pair_open();
    struct bulk out = { .done = 0 };
    static uint8_t data[100000];
    assert_int_equal(conn_send_data(p.daemon, 1, data, sizeof(data), bulk_done, &out), 0);
    int file = a_file("f");
    assert_int_equal(conn_send(p.daemon, WIRE_RESULT, 1, NULL, 0, &file, 1), 0);
    close(p.peer);
    p.peer = -1;
    assert_int_equal(conn_flush(p.daemon), -EPIPE);
    assert_int_equal(conn_flush(p.daemon), -EPIPE);
    assert_int_equal(conn_read(p.daemon, BUDGET), -EPIPE);
    assert_int_equal(out.done, 0);
    pair_close(&p);
    assert_int_equal(out.done, 1);
}

static void a_full_socket_says_so(void **state)
{
    (void)state;
    struct pair p = pair_open();
    enum { BYTES = 4 << 20 };
    uint8_t *data = malloc(BYTES), *got = malloc(BYTES);
    struct bulk out = { .done = 0 };
    fill(data, BYTES, 1);
    assert_int_equal(conn_send_data(p.daemon, 1, data, BYTES, bulk_done, &out), 0);
    assert_int_equal(conn_flush(p.daemon), 0);
    assert_true(conn_wants_write(p.daemon));
    assert_true(conn_unsent_bytes(p.daemon) > 0 && conn_unsent_bytes(p.daemon) < BYTES);
    size_t total = 0;
    for (unsigned message_at = 0; message_at < 4; message_at++) {
        uint8_t header[WIRE_HEADER_BYTES];
        for (size_t at = 0; at < WIRE_HEADER_BYTES;) {
            assert_true(conn_flush(p.daemon) >= 0);
            ssize_t n = recv(p.peer, header + at, WIRE_HEADER_BYTES - at, 0);
            assert_true(n > 0);
            at += (size_t)n;
        }
        struct wire_header h;
        assert_int_equal(wire_decode(&h, header, WIRE_DAEMON, NULL), 0);
        assert_int_equal(h.body_bytes, WIRE_DATA_BYTES_MAX);
        for (size_t end = total + h.body_bytes; total < end;) {
            assert_true(conn_flush(p.daemon) >= 0);
            ssize_t n = recv(p.peer, got + total, end - total, 0);
            assert_true(n > 0);
            total += (size_t)n;
        }
    }
    assert_int_equal(conn_flush(p.daemon), 1);
    assert_int_equal(out.done, 1);
    assert_memory_equal(data, got, BYTES);
    free(data);
    free(got);
    pair_close(&p);
}

static void not_a_descriptor(void **state)
{
    (void)state;
    struct conn *c = NULL;
    assert_int_equal(conn_create(&c, -1, WIRE_CLIENT), -EBADF);
    assert_null(c);
    conn_destroy(NULL);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(one_byte_at_a_time),
        cmocka_unit_test(truncated_at_each_byte),
        cmocka_unit_test(several_messages_in_one_read),
        cmocka_unit_test(a_small_budget_loses_nothing),
        cmocka_unit_test(thousands_of_small_messages),
        cmocka_unit_test(descriptors_find_their_message),
        cmocka_unit_test(wrong_counts_break_the_stream),
        cmocka_unit_test(descriptors_that_no_header_states_are_refused),
        cmocka_unit_test(a_flood_of_descriptors_is_bounded),
        cmocka_unit_test(descriptors_of_two_conns),
        cmocka_unit_test(a_message_with_descriptors_goes_alone),
        cmocka_unit_test(destroy_closes_what_is_queued),
        cmocka_unit_test(bad_headers_break_the_stream),
        cmocka_unit_test(garbage_breaks_the_stream),
        cmocka_unit_test(bulk_goes_to_its_sink),
        cmocka_unit_test(the_largest_body_without_a_sink),
        cmocka_unit_test(a_gone_peer_is_an_error_and_no_signal),
        cmocka_unit_test(a_full_socket_says_so),
        cmocka_unit_test(not_a_descriptor),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
