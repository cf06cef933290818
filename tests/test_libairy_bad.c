// SPDX-License-Identifier: Apache-2.0
// test_libairy_bad.c - libairy with peers that refuse, die, or break the protocol; and finding the
// socket.
#include "airy_peer.h"

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

// ---- bad peers -------------------------------------------------------------------------------------

// Ends the request at once, then reads late: the caller's data must stay in use until it is read.
static void script_early_error(struct peer *p)
{
    peer_welcome(p);
    uint64_t id = peer_bloom(p);
    peer_fault(p, id, FAULT_PARAM_RANGE, "params.knee", "no");
    usleep(100000);
    uint8_t *expected = malloc(BIG_BYTES);
    must(expected);
    fill(expected, BIG_BYTES, 9);
    for (size_t got = 0; got < BIG_BYTES;) {
        struct conn_message m = peer_next(p, WIRE_DATA);
        must(!memcmp(m.body, expected + got, m.header.body_bytes));
        got += m.header.body_bytes;
    }
    free(expected);
    peer_until_closed(p);
}

static void an_early_error_waits_for_the_upload(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_early_error);
    uint8_t *data = malloc(BIG_BYTES);
    fill(data, BIG_BYTES, 9);
    struct airy_request r = inline_request(data, BIG_BYTES);
    uint64_t id = submit(a, &r);
    expect_failure(a, id, "PARAM_RANGE");
    memset(data, 0, BIG_BYTES); // the caller's again
    free(data);
    close_peer(&p, a);
}

static void script_dies_in_data(struct peer *p)
{
    peer_welcome(p);
    uint64_t a = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    uint64_t b = peer_bloom(p);
    peer_result_text(p, a, "first");
    uint8_t bytes[WIRE_HEADER_BYTES + 10] = { 0 };
    wire_encode(bytes, &(struct wire_header){ .type = WIRE_DATA, .body_bytes = 1000, .id = b });
    must(send(conn_fd(p->conn), bytes, sizeof(bytes), MSG_NOSIGNAL) == sizeof(bytes));
}

static void a_peer_that_dies_in_the_middle(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_dies_in_data);
    uint8_t *data = calloc(1, BIG_BYTES);
    uint64_t first = submit_text(a, "1"), id;
    struct airy_request r = inline_request(data, BIG_BYTES);
    uint64_t second = submit(a, &r);
    struct airy_error e = expect_failure(a, second, "LOCAL"); // while much of its upload is unsent
    assert_true(e.code == -EPIPE || e.code == -ECONNRESET);
    free(data);
    expect_text(a, first, "first"); // what came before is not lost
    assert_int_equal(airy_wait_any(a, -1, &id, NULL, &e), -1);
    assert_int_equal(id, 0);
    assert_int_equal(airy_submit(a, &r, &id, &e), -1);
    assert_int_equal(airy_cancel(a, 1, &e), -1);
    struct airy_status s;
    assert_int_equal(airy_status(a, &s, 1000, &e), -1);
    assert_true(e.text[0]);
    close_peer(&p, a);
}

static void script_dies_before_credit(struct peer *p)
{
    peer_welcome(p);
    peer_bloom(p);
    peer_next(p, WIRE_DATA);
    usleep(50000);
}

static void a_peer_that_dies_while_submit_waits(void **state)
{
    (void)state;
    struct peer p = { .credit_bytes = 10 };
    struct airy *a = open_peer(&p, script_dies_before_credit);
    struct airy_request r = inline_request("0123456789", 10);
    submit(a, &r);
    struct airy_error e = { .text = "" };
    uint64_t id;
    assert_int_equal(airy_submit(a, &r, &id, &e), -1);
    assert_true(e.code == -EPIPE || e.code == -ECONNRESET);
    close_peer(&p, a);
}

// What a peer sends that it may not, after one BLOOM with inline output and one without.
static unsigned breach;
enum { BREACHES = 11 };

static void script_breach(struct peer *p)
{
    peer_welcome(p);
    uint64_t a = peer_bloom(p), b;
    peer_next(p, WIRE_DATA);
    b = peer_bloom(p);
    uint8_t bytes[64] = { 0 };
    int fd;
    switch (breach) {
    case 0: // garbage
        memset(bytes, 0xa5, sizeof(bytes));
        must(send(conn_fd(p->conn), bytes, sizeof(bytes), MSG_NOSIGNAL) == sizeof(bytes));
        break;
    case 1: // a result that nobody asked for, with a descriptor
        fd = memfd_of("x", 1, F_SEAL_SHRINK);
        peer_result(p, b + 1, AIRY__PAYLOAD__KIND__MEMFD, 0, 1, fd);
        break;
    case 2: // DATA where a memfd was asked for
        must(conn_send(p->conn, WIRE_DATA, b, "x", 1, NULL, 0) == 0);
        peer_flush(p);
        break;
    case 3: // DATA for nobody
        must(conn_send(p->conn, WIRE_DATA, 999, "x", 1, NULL, 0) == 0);
        peer_flush(p);
        break;
    case 4: { // more DATA than the largest frame
        uint8_t *big = calloc(1, BIG_BYTES);
        must(big && conn_send_data(p->conn, a, big, BIG_BYTES, NULL, NULL) == 0);
        must(conn_send(p->conn, WIRE_DATA, a, "x", 1, NULL, 0) == 0);
        peer_flush(p);
        free(big);
        break;
    }
    case 5: { // a second WELCOME
        Airy__Welcome w = AIRY__WELCOME__INIT;
        peer_send(p, WIRE_WELCOME, 0, &w.base);
        break;
    }
    case 6: // a client's message
        must(conn_send(p->conn, WIRE_HELLO, 0, NULL, 0, NULL, 0) == 0);
        peer_flush(p);
        break;
    case 7: // a body that is none
        must(conn_send(p->conn, WIRE_CREDIT, 0, "\x08\xff", 2, NULL, 0) == 0);
        peer_flush(p);
        break;
    case 8: // two ends
        peer_send(p, WIRE_CANCELLED, b, NULL);
        peer_send(p, WIRE_CANCELLED, b, NULL);
        break;
    case 9: // an error for nobody
        peer_fault(p, 999, FAULT_INTERNAL, "", "what?");
        break;
    case 10: // a descriptor that its header does not state
        wire_encode(bytes, &(struct wire_header){ .type = WIRE_CREDIT });
        struct iovec iov = { bytes, WIRE_HEADER_BYTES };
        union {
            struct cmsghdr align;
            uint8_t bytes[CMSG_SPACE(sizeof(int))];
        } control = { .bytes = { 0 } };
        struct msghdr h = {
            .msg_iov = &iov, .msg_iovlen = 1, .msg_control = &control, .msg_controllen = sizeof(control)
        };
        *CMSG_FIRSTHDR(&h) = (struct cmsghdr){ .cmsg_level = SOL_SOCKET,
                                               .cmsg_type = SCM_RIGHTS,
                                               .cmsg_len = CMSG_LEN(sizeof(int)) };
        fd = conn_fd(p->conn);
        memcpy(CMSG_DATA(CMSG_FIRSTHDR(&h)), &fd, sizeof(fd));
        must(sendmsg(conn_fd(p->conn), &h, MSG_NOSIGNAL) == WIRE_HEADER_BYTES);
        break;
    }
    peer_until_closed(p);
}

static void breaches_lose_the_connection_with_words(void **state)
{
    (void)state;
    for (breach = 0; breach < BREACHES; breach++) {
        struct peer p = { 0 };
        struct airy *a = open_peer(&p, script_breach);
        int file = memfd_of("frame", 5, F_SEAL_SHRINK);
        struct airy_request r = AIRY_REQUEST_INIT;
        r.input_fd = file;
        uint64_t first = submit_text(a, "1"), second = submit(a, &r);
        close(file);
        struct airy_error e = expect_failure(a, first, "LOCAL");
        if (e.code != -EPROTO && !(breach == 4 && e.code == -ENOMEM))
            fail_msg("breach %u: %d %s", breach, e.code, e.text);
        expect_failure(a, second, breach == 8 ? "CANCELLED" : "LOCAL");
        assert_int_equal(airy_fd(a), -1);
        close_peer(&p, a);
    }
}

static void script_wrong_size(struct peer *p)
{
    peer_welcome(p);
    uint64_t id = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    must(conn_send(p->conn, WIRE_DATA, id, "abc", 3, NULL, 0) == 0);
    peer_result(p, id, AIRY__PAYLOAD__KIND__INLINE, 0, 4, -1);
    peer_result_text(p, peer_bloom(p), "");
    peer_until_closed(p);
}

static void an_inline_result_must_have_its_size(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_wrong_size);
    struct airy_error e = expect_failure(a, submit_text(a, "1"), "LOCAL");
    assert_string_equal(e.field, "output.size");
    expect_text(a, submit_text(a, "2"), "");
    close_peer(&p, a);
}

static unsigned refusal;
enum { REFUSALS = 5 };

static void script_refuse(struct peer *p)
{
    Airy__Limits limits = AIRY__LIMITS__INIT;
    Airy__Welcome w = AIRY__WELCOME__INIT;
    peer_next(p, WIRE_HELLO);
    switch (refusal) {
    case 0:
        peer_fault(p, 0, FAULT_BAD_VERSION, "version_min", "this daemon speaks 7");
        break;
    case 1:
        w.version = 2;
        w.limits = &limits;
        peer_send(p, WIRE_WELCOME, 0, &w.base);
        break;
    case 2:
        w.version = 1;
        peer_send(p, WIRE_WELCOME, 0, &w.base);
        break;
    case 3:
        peer_credit(p, 5);
        break;
    case 4:
        return; // goes away
    }
    peer_until_closed(p);
}

static void refused_connections(void **state)
{
    (void)state;
    static const int codes[REFUSALS] = { FAULT_BAD_VERSION, -EPROTO, -EPROTO, -EPROTO, -EPIPE };
    for (refusal = 0; refusal < REFUSALS; refusal++) {
        struct peer p = { 0 };
        struct airy *a = NULL;
        struct airy_error e = { .text = "" };
        assert_int_equal(airy_connect_fd(&a, peer_begin(&p, script_refuse), &e), -1);
        assert_null(a);
        assert_int_equal(e.code, codes[refusal]);
        assert_true(e.text[0]);
        assert_string_equal(e.symbol, refusal ? "LOCAL" : "BAD_VERSION");
        close_peer(&p, NULL);
    }
    struct airy *a = NULL;
    assert_int_equal(airy_connect_fd(&a, -1, NULL), -1);
}

// ---- finding the socket ----------------------------------------------------------------------------

static int listen_at(const char *path)
{
    struct sockaddr_un address = { .sun_family = AF_UNIX };
    snprintf(address.sun_path, sizeof(address.sun_path), "%s", path);
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_true(fd >= 0);
    assert_int_equal(bind(fd, (struct sockaddr *)&address, sizeof(address)), 0);
    assert_int_equal(listen(fd, 4), 0);
    return fd;
}

static void *accept_main(void *arg)
{
    struct peer p = { .credit_bytes = 1000, .max_requests = 1 };
    int fd = accept(*(int *)arg, NULL, NULL);
    must(fd >= 0 && conn_create(&p.conn, fd, WIRE_DAEMON) == 0);
    script_handshake(&p);
    conn_destroy(p.conn);
    body_arena_finish(&p.arena);
    return NULL;
}

static void expect_connect(const char *path, int listener)
{
    pthread_t thread;
    struct airy *a = NULL;
    struct airy_error e = { .text = "" };
    assert_int_equal(pthread_create(&thread, NULL, accept_main, &listener), 0);
    if (airy_connect(&a, path, &e) < 0)
        fail_msg("%s", e.text);
    assert_string_equal(airy_server(a), "peer/1");
    airy_close(a);
    pthread_join(thread, NULL);
}

static void the_socket_is_found(void **state)
{
    (void)state;
    char folder[] = "/tmp/test_libairy_XXXXXX", own[64], user[64], none[64];
    assert_non_null(mkdtemp(folder));
    snprintf(own, sizeof(own), "%s/own.sock", folder);
    snprintf(user, sizeof(user), "%s/airyd.sock", folder);
    snprintf(none, sizeof(none), "%s/none.sock", folder);
    unsigned before = count_fds();
    int own_fd = listen_at(own), user_fd = listen_at(user);
    setenv("XDG_RUNTIME_DIR", folder, 1);
    setenv("AIRY_SOCKET", own, 1);
    expect_connect(own, own_fd);
    expect_connect(NULL, own_fd);
    setenv("AIRY_SOCKET", none, 1);
    expect_connect(NULL, user_fd); // the next in order
    unsetenv("AIRY_SOCKET");
    expect_connect(NULL, user_fd);

    struct airy *a = NULL;
    struct airy_error e = { .text = "" };
    assert_int_equal(airy_connect(&a, none, &e), -1);
    assert_int_equal(e.code, -ENOENT);
    assert_non_null(strstr(e.text, none));
    char longest[300];
    memset(longest, 'x', sizeof(longest) - 1);
    longest[sizeof(longest) - 1] = 0;
    assert_int_equal(airy_connect(&a, longest, &e), -1);
    assert_int_equal(e.code, -ENAMETOOLONG);
    // Listens, and never says a word.
    assert_int_equal(airy_connect(&a, own, &e), -1);
    assert_int_equal(e.code, -ETIMEDOUT);
    assert_null(a);
    close(own_fd);
    close(user_fd);
    assert_int_equal(airy_connect(&a, own, &e), -1);
    assert_int_equal(e.code, -ECONNREFUSED);
    unlink(own);
    unlink(user);
    rmdir(folder);
    assert_int_equal(count_fds(), before);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_early_error_waits_for_the_upload),
        cmocka_unit_test(a_peer_that_dies_in_the_middle),
        cmocka_unit_test(a_peer_that_dies_while_submit_waits),
        cmocka_unit_test(breaches_lose_the_connection_with_words),
        cmocka_unit_test(an_inline_result_must_have_its_size),
        cmocka_unit_test(refused_connections),
        cmocka_unit_test(the_socket_is_found),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
