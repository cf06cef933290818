// SPDX-License-Identifier: Apache-2.0
// test_server_life.c - cancelling, vanishing, stalling and stopping, against real daemons. What one client
// does must cost no other anything.
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "daemon_fixture.h"

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + (double)t.tv_nsec / 1e9;
}

static void nap(int ms) { nanosleep(&(struct timespec){ .tv_nsec = ms * 1000000L }, NULL); }

// A raw request by memfd: `heavy` ones keep the daemon busy for a good while.
static uint64_t submit_raw(struct airy *a, const struct picture *p, bool heavy)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    struct airy_error e;
    uint64_t id;
    r.input_fd = make_memfd(p->pixels, picture_bytes(p), F_SEAL_SHRINK);
    picture_request(p, &r);
    if (heavy)
        assert_int_equal(airy_request_param(&r, "psf",
                                            "gaussians:sigma=1.5/3/6/12/24/48/96,weight=.1/.1/.1/.1/.1/.1/.1", &e),
                         0);
    if (airy_submit(a, &r, &id, &e) < 0)
        fail_msg("submit: %s %s", e.symbol, e.text);
    close(r.input_fd);
    return id;
}

static void expect_done(struct airy *a, uint64_t id)
{
    struct airy_result *r;
    struct airy_error e;
    int rc = airy_wait(a, id, 60000, &r, &e);
    if (rc != 1)
        fail_msg("request %llu: %d %s %s", (unsigned long long)id, rc, e.symbol, e.text);
    airy_result_free(r);
}

static struct airy_status status_of(struct airy *a)
{
    struct airy_status s;
    struct airy_error e;
    if (airy_status(a, &s, 20000, &e) < 0)
        fail_msg("status: %s", e.text);
    return s;
}

// ---- cancel ----------------------------------------------------------------------------------------

static void test_cancel(void **state)
{
    (void)state;
    enum { JOBS = 24 };
    struct daemon d;
    daemon_start(&d, (const char *const[]){ "--slots", "1", NULL });
    struct airy *a = daemon_join(&d);
    struct picture p = picture_make(1024, 1024, 500, 3);
    uint64_t id[JOBS];
    struct airy_error e;
    for (int i = 0; i < JOBS; i++)
        id[i] = submit_raw(a, &p, true);
    // The last ones wait; the first runs by now, or has run. Twice is once.
    for (int i = JOBS - 1; i >= 0; i--) {
        assert_int_equal(airy_cancel(a, id[i], &e), 0);
        assert_int_equal(airy_cancel(a, id[i], &e), 0);
    }
    int done = 0, cancelled = 0;
    for (int i = 0; i < JOBS; i++) {
        struct airy_result *r = NULL;
        int rc = airy_wait(a, id[i], 60000, &r, &e);
        assert_int_not_equal(rc, 0);
        if (rc > 0)
            done++;
        else
            assert_string_equal(e.symbol, "CANCELLED");
        cancelled += rc < 0;
        airy_result_free(r);
    }
    assert_true(cancelled >= JOBS / 2);
    // Exactly one reply each: what is counted is what was seen, and nothing is left.
    struct airy_status s = status_of(a);
    assert_int_equal(s.done, done);
    assert_int_equal(s.cancelled, cancelled);
    assert_int_equal(s.queued + s.running, 0);
    expect_done(a, submit_raw(a, &p, false));
    airy_close(a);
    picture_free(&p);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void bloom_inline(struct peer *p, uint64_t id, uint64_t bytes)
{
    Airy__Bloom b = AIRY__BLOOM__INIT;
    Airy__Payload in = AIRY__PAYLOAD__INIT;
    in.kind = AIRY__PAYLOAD__KIND__INLINE;
    in.size = bytes;
    b.input = &in;
    peer_bloom(p, id, &b, NULL, 0);
}

static void test_cancel_upload(void **state)
{
    (void)state;
    struct daemon d;
    struct peer p;
    struct conn_message m;
    static uint8_t bytes[100000];
    daemon_start(&d, NULL);
    peer_hello(&p, &d);
    bloom_inline(&p, 5, 300000);
    peer_data(&p, 5, bytes, sizeof bytes);
    peer_cancel(&p, 5);
    peer_cancel(&p, 5);
    peer_cancel(&p, 12345); // never was
    peer_data(&p, 5, bytes, sizeof bytes); // was on its way
    peer_expect(&p, &m, WIRE_CANCELLED, 5);
    const Airy__StatusReply *s = peer_status(&p); // and no second reply before this
    assert_int_equal(s->cancelled, 1);
    peer_close(&p);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

// ---- vanishing and stalling ------------------------------------------------------------------------

// A child that says hello, begins an upload of 64 MiB, tells us, and goes on until it is killed.
static pid_t uploader(const struct daemon *d, int *ready)
{
    int ends[2];
    assert_int_equal(pipe(ends), 0);
    pid_t pid = fork();
    assert_true(pid >= 0);
    if (pid == 0) {
        struct peer p;
        static uint8_t bytes[1 << 20];
        peer_hello(&p, d);
        bloom_inline(&p, 1, 64 << 20);
        peer_data(&p, 1, bytes, sizeof bytes);
        // Half a message, so that the daemon is in the middle of one.
        uint8_t h[WIRE_HEADER_BYTES];
        wire_encode(h, &(struct wire_header){ .type = WIRE_DATA, .body_bytes = 1 << 20, .id = 1 });
        (void)!send(conn_fd(p.conn), h, sizeof h, MSG_NOSIGNAL);
        (void)!send(conn_fd(p.conn), bytes, 100000, MSG_NOSIGNAL);
        (void)!write(ends[1], "x", 1);
        for (;;)
            pause();
    }
    close(ends[1]);
    *ready = ends[0];
    return pid;
}

static void test_kill_in_upload(void **state)
{
    (void)state;
    struct daemon d;
    daemon_start(&d, NULL);
    struct airy *a = daemon_join(&d);
    struct picture p = picture_make(256, 256, 500, 4);
    for (int i = 0; i < 8; i++) {
        int ready;
        char c;
        pid_t pid = uploader(&d, &ready);
        uint64_t id = submit_raw(a, &p, false);
        assert_int_equal(read(ready, &c, 1), 1);
        close(ready);
        kill(pid, SIGKILL);
        assert_int_equal(waitpid(pid, NULL, 0), pid);
        expect_done(a, id);
    }
    for (int i = 0; status_of(a).clients != 1; i++) {
        assert_true(i < 500);
        nap(10);
    }
    struct airy_status s = status_of(a);
    assert_int_equal(s.queued + s.running, 0);
    airy_close(a);
    picture_free(&p);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_gone_with_queue(void **state)
{
    (void)state;
    struct daemon d;
    daemon_start(&d, (const char *const[]){ "--slots", "1", NULL });
    struct picture p = picture_make(1024, 1024, 500, 5);
    struct airy *a = daemon_join(&d), *b = daemon_join(&d);
    for (int i = 0; i < 20; i++)
        submit_raw(a, &p, true);
    airy_close(a); // with all of them open
    expect_done(b, submit_raw(b, &p, false));
    struct airy_status s = status_of(b);
    assert_int_equal(s.queued + s.running, 0);
    assert_int_equal(s.done + s.cancelled, 21);
    assert_true(s.cancelled >= 10);
    airy_close(b);
    picture_free(&p);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_stalls(void **state)
{
    (void)state;
    struct daemon d;
    struct peer quiet, half, slow;
    static uint8_t bytes[1000];
    daemon_start(&d, (const char *const[]){ "--timeout-s", "1", NULL });
    peer_open(&quiet, &d); // says nothing
    peer_hello(&half, &d);
    bloom_inline(&half, 1, 5000); // stops in the middle
    peer_data(&half, 1, bytes, sizeof bytes);
    // Asks and asks and reads nothing: closed at last, after the socket's buffer is full.
    peer_hello(&slow, &d);
    uint8_t h[WIRE_HEADER_BYTES];
    wire_encode(h, &(struct wire_header){ .type = WIRE_STATUS, .id = 1 });
    ssize_t n;
    while ((n = send(conn_fd(slow.conn), h, sizeof h, MSG_NOSIGNAL | MSG_DONTWAIT)) > 0 ||
           (n < 0 && errno == EAGAIN)) {
        if (n < 0)
            nap(5);
    }
    assert_int_equal(errno, EPIPE);
    peer_expect_error(&quiet, 0, FAULT_UNEXPECTED, "type");
    peer_expect_closed(&quiet);
    peer_expect_error(&half, 1, FAULT_PAYLOAD, "input.size");
    assert_true(peer_status(&half)->clients >= 1); // that one may go on
    peer_close(&quiet);
    peer_close(&half);
    peer_close(&slow);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

static void test_too_many_clients(void **state)
{
    (void)state;
    struct daemon d;
    daemon_start(&d, (const char *const[]){ "--max-clients", "4", NULL });
    struct airy *a[4];
    for (int i = 0; i < 4; i++)
        a[i] = daemon_join(&d);
    struct peer late; // waits in the kernel's queue until one leaves
    peer_open(&late, &d);
    Airy__Hello h = AIRY__HELLO__INIT;
    struct conn_message m;
    h.version_min = h.version_max = 1;
    assert_int_equal(body_send(late.conn, WIRE_HELLO, 0, &h.base, NULL, 0), 0);
    peer_flush(&late);
    assert_int_equal(peer_next(&late, &m, 600), 0);
    assert_int_equal(status_of(a[0]).clients, 4);
    airy_close(a[3]);
    peer_expect(&late, &m, WIRE_WELCOME, 0);
    peer_close(&late);
    for (int i = 0; i < 3; i++)
        airy_close(a[i]);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

// STATUS, while the device and the pool have more than enough to do.
static void test_status_under_load(void **state)
{
    (void)state;
    struct daemon d;
    daemon_start(&d, NULL);
    struct airy *a = daemon_join(&d), *b = daemon_join(&d);
    struct picture p = picture_make(1920, 1080, 500, 6);
    uint64_t id[12];
    for (int i = 0; i < 12; i++)
        id[i] = submit_raw(a, &p, true);
    double worst = 0;
    unsigned most = 0;
    for (int i = 0; i < 40; i++) {
        double start = now_s();
        struct airy_status s = status_of(b);
        double took = now_s() - start;
        worst = took > worst ? took : worst;
        most = s.queued + s.running > most ? s.queued + s.running : most;
        nap(5);
    }
    print_message("worst STATUS %.1f ms, %u requests in the daemon\n", worst * 1e3, most);
    assert_true(most >= 8); // answered before what was asked for earlier; in how few turns: test_server_limits
    for (int i = 0; i < 12; i++)
        expect_done(a, id[i]);
    airy_close(a);
    airy_close(b);
    picture_free(&p);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
}

// ---- stopping ----------------------------------------------------------------------------------------

static void test_sigterm_drains(void **state)
{
    (void)state;
    struct daemon d;
    daemon_start(&d, NULL);
    struct airy *a = daemon_join(&d);
    struct peer half;
    struct picture p = picture_make(1024, 1024, 500, 7);
    uint64_t id[10];
    struct airy_error e;
    peer_hello(&half, &d);
    bloom_inline(&half, 1, 5000);
    for (int i = 0; i < 10; i++)
        id[i] = submit_raw(a, &p, true);
    while (status_of(a).queued + status_of(a).running + status_of(a).done < 10)
        nap(2);
    kill(d.pid, SIGTERM);
    peer_expect_error(&half, 1, FAULT_SHUTTING_DOWN, NULL); // unfinished: it cannot be finished
    struct sockaddr_un address = { .sun_family = AF_UNIX };
    strcpy(address.sun_path, d.path);
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_equal(connect(fd, (struct sockaddr *)&address, sizeof address), -1); // nobody new
    close(fd);
    uint64_t late = submit_raw(a, &p, false);
    struct airy_result *r = NULL;
    assert_int_equal(airy_wait(a, late, 60000, &r, &e), -1);
    assert_string_equal(e.symbol, "SHUTTING_DOWN");
    assert_true(e.retryable);
    for (int i = 0; i < 10; i++)
        expect_done(a, id[i]);
    airy_close(a);
    peer_close(&half);
    picture_free(&p);
    assert_int_equal(daemon_stop(&d, 0), 0);
}

static void test_second_signal(void **state)
{
    (void)state;
    struct daemon d;
    daemon_start(&d, NULL);
    struct airy *a = daemon_join(&d);
    struct picture p = picture_make(1920, 1080, 500, 8);
    for (int i = 0; i < 30; i++)
        submit_raw(a, &p, true);
    kill(d.pid, SIGTERM);
    nap(50);
    kill(d.pid, SIGTERM);
    assert_int_equal(daemon_stop(&d, 0), 1); // 0 when it ends them all
    airy_close(a);
    picture_free(&p);
}

static void test_lifetime(void **state)
{
    (void)state;
    struct daemon d;
    daemon_start(&d, NULL);
    struct airy *a = daemon_join(&d);
    struct picture p = picture_make(512, 512, 500, 9);
    uint64_t id = submit_raw(a, &p, true);
    status_of(a); // it is there
    close(d.lifetime_fd);
    d.lifetime_fd = -1;
    expect_done(a, id);
    airy_close(a);
    picture_free(&p);
    assert_int_equal(daemon_stop(&d, 0), 0);
}

// ---- starting ----------------------------------------------------------------------------------------

static void test_options(void **state)
{
    (void)state;
    char text[4096];
    const struct {
        const char *options[4], *says;
        int status;
    } cases[] = {
        { { "--threads", "0", NULL }, "--threads", 2 },
        { { "--threads", "many", NULL }, "--threads", 2 },
        { { "--slots", "9", NULL }, "--slots", 2 },
        { { "--max-frame-bytes", "99999999999G", NULL }, "--max-frame-bytes", 2 },
        { { "--max-clients", "-1", NULL }, "--max-clients", 2 },
        { { "--timeout-s", "", NULL }, "--timeout-s", 2 },
        { { "--lifetime-fd", "900", NULL }, "--lifetime-fd", 2 },
        { { "--warm", "tepid", NULL }, "--warm", 2 },
        { { "--memory-bytes", "64M", NULL }, "--memory-bytes: 67108864; expected at least", 2 },
        { { "--user-connections", "0", NULL }, "--user-connections", 2 },
        { { "--user-requests", "0", NULL }, "--user-requests", 2 },
        { { "--user-bytes", "some", NULL }, "--user-bytes", 2 },
        { { "--user-fds", "7", NULL }, "--user-fds: \"7\"; expected a whole number from 8", 2 },
        { { "--nonsense", NULL }, "--nonsense", 2 },
        { { "--socket", NULL }, "--socket", 2 },
        { { "stray", NULL }, "stray", 2 },
        { { "--socket", "/nonexistent/dir/s", NULL }, "/nonexistent/dir/s", 1 },
        { { "--socket", "", NULL }, "--socket", 1 },
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        int status = daemon_run(cases[i].options, text, sizeof text);
        if (status != cases[i].status || !strstr(text, cases[i].says))
            fail_msg("%s %s: status %d, %s", cases[i].options[0], cases[i].options[1], status, text);
    }
    // A device that is not there.
    char path[] = "/tmp/airyd-test-no-device-XXXXXX";
    assert_non_null(mkdtemp(path));
    char socket_path[64];
    snprintf(socket_path, sizeof socket_path, "%s/s", path);
    const char *options[] = { "--socket", socket_path, "--device", "nosuch", NULL };
    assert_int_equal(daemon_run(options, text, sizeof text), 1);
    assert_non_null(strstr(text, "nosuch"));
    assert_int_equal(rmdir(path), 0);
}

static void test_socket_path(void **state)
{
    (void)state;
    struct daemon d;
    char text[1024];
    daemon_start(&d, NULL);
    struct stat st;
    assert_int_equal(stat(d.path, &st), 0);
    mode_t mask = umask(0);
    umask(mask);
    assert_int_equal(st.st_mode & 0777, 0660 & ~mask);
    const char *options[] = { "--socket", d.path, NULL };
    assert_int_equal(daemon_run(options, text, sizeof text), 1); // live
    assert_non_null(strstr(text, d.path));
    struct airy *a = daemon_join(&d); // and unharmed
    airy_close(a);
    // Killed, it leaves its file; the next replaces it.
    kill(d.pid, SIGKILL);
    daemon_wait(&d);
    assert_int_equal(access(d.path, F_OK), 0);
    struct daemon next = d;
    next.pid = fork();
    if (next.pid == 0)
        daemon_exec((const char *const[]){ "--warm", "common", NULL }, options);
    a = NULL;
    for (int i = 0; !a && i < 6000; i++) {
        struct airy_error e;
        if (airy_connect(&a, d.path, &e) < 0)
            nap(10);
    }
    assert_non_null(a);
    airy_close(a);
    // Somebody else's file in its place is not removed at the end.
    assert_int_equal(unlink(d.path), 0);
    int fd = open(d.path, O_CREAT | O_WRONLY | O_CLOEXEC, 0600);
    close(fd);
    kill(next.pid, SIGTERM);
    assert_int_equal(daemon_wait(&next), 0);
    assert_int_equal(access(d.path, F_OK), 0);
    assert_int_equal(daemon_run(options, text, sizeof text), 1); // no socket: not touched
    assert_int_equal(access(d.path, F_OK), 0);
    unlink(d.path);
    close(d.lifetime_fd);
    assert_int_equal(rmdir(d.dir), 0);
}

// As systemd does it: the listening socket is descriptor 3, LISTEN_PID and LISTEN_FDS say so, and READY comes
// by NOTIFY_SOCKET.
static void test_systemd(void **state)
{
    (void)state;
    struct daemon d = { .lifetime_fd = -1 };
    strcpy(d.dir, "/tmp/airyd-test-XXXXXX");
    assert_non_null(mkdtemp(d.dir));
    snprintf(d.path, sizeof d.path, "%s/s", d.dir);
    char notify[80];
    snprintf(notify, sizeof notify, "%s/n", d.dir);
    struct sockaddr_un address = { .sun_family = AF_UNIX };
    strcpy(address.sun_path, notify);
    int notes = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    assert_int_equal(bind(notes, (struct sockaddr *)&address, sizeof address), 0);
    strcpy(address.sun_path, d.path);
    int listening = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_equal(bind(listening, (struct sockaddr *)&address, sizeof address), 0);
    assert_int_equal(listen(listening, 8), 0);
    d.pid = fork();
    if (d.pid == 0) {
        char pid[16];
        snprintf(pid, sizeof pid, "%d", (int)getpid());
        setenv("LISTEN_PID", pid, 1);
        setenv("LISTEN_FDS", "1", 1);
        setenv("NOTIFY_SOCKET", notify, 1);
        if (listening == 3)
            fcntl(3, F_SETFD, 0);
        else
            dup2(listening, 3);
        daemon_exec((const char *const[]){ "--warm", "common", NULL }, NULL);
    }
    struct airy *a = daemon_join(&d); // connects at once, is answered when it is ready
    char text[64] = "";
    assert_true(recv(notes, text, sizeof text - 1, 0) > 0);
    assert_non_null(strstr(text, "READY=1"));
    status_of(a);
    airy_close(a);
    kill(d.pid, SIGTERM);
    assert_int_equal(daemon_wait(&d), 0);
    memset(text, 0, sizeof text);
    assert_true(recv(notes, text, sizeof text - 1, 0) > 0);
    assert_non_null(strstr(text, "STOPPING=1"));
    assert_int_equal(access(d.path, F_OK), 0); // systemd's, not ours to remove
    close(listening);
    close(notes);
    unlink(d.path);
    unlink(notify);
    assert_int_equal(rmdir(d.dir), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_cancel),           cmocka_unit_test(test_cancel_upload),
        cmocka_unit_test(test_kill_in_upload),   cmocka_unit_test(test_gone_with_queue),
        cmocka_unit_test(test_stalls),           cmocka_unit_test(test_too_many_clients),
        cmocka_unit_test(test_status_under_load), cmocka_unit_test(test_sigterm_drains),
        cmocka_unit_test(test_second_signal),    cmocka_unit_test(test_lifetime),
        cmocka_unit_test(test_options),          cmocka_unit_test(test_socket_path),
        cmocka_unit_test(test_systemd),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
