// SPDX-License-Identifier: Apache-2.0
// daemon_fixture.c - see daemon_fixture.h. Every wait is bounded; a failed one fails the test.
#include "daemon_fixture.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { START_MS = 300000, STOP_MS = 300000, REPLY_MS = 300000, ARGS_MAX = 24 };

int64_t daemon_now_ms(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000 + t.tv_nsec / 1000000;
}

void daemon_nap(void) { nanosleep(&(struct timespec){ .tv_nsec = 5000000 }, NULL); }

static const char *airyd(void)
{
    const char *path = getenv("AIRYD");
    return path ? path : "build/airyd";
}

#if defined(__has_feature)
#define SANITIZED (__has_feature(address_sanitizer) || __has_feature(thread_sanitizer))
#elif defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SANITIZED 1
#else
#define SANITIZED 0
#endif

bool daemon_sanitized(void) { return SANITIZED; }

// The Vulkan loader unloads the driver at the end. What the driver keeps for its life (112 bytes) then looks
// lost to LeakSanitizer, and ThreadSanitizer objects to suppressions of a library that went away.
static void keep_driver(void)
{
    char options[512];
    const char *given = getenv("ASAN_OPTIONS");
    snprintf(options, sizeof options, "%s%sverify_asan_link_order=0", given ? given : "", given ? ":" : "");
    setenv("ASAN_OPTIONS", options, 1);
    setenv("LD_PRELOAD", "libvulkan_lvp.so", 0);
}

void daemon_exec(const char *const *first, const char *const *more)
{
    const char *args[ARGS_MAX] = { airyd() };
    unsigned n = 1;
    if (SANITIZED)
        keep_driver();
    for (; first && *first && n < ARGS_MAX - 1; first++)
        args[n++] = *first;
    for (; more && *more && n < ARGS_MAX - 1; more++)
        args[n++] = *more;
    execv(args[0], (char *const *)args);
    perror(args[0]);
    _exit(127);
}

// An emulated machine may be named slower: AIRY_TEST_START_S.
static int64_t start_ms(void)
{
    const char *given = getenv("AIRY_TEST_START_S");
    return given ? strtoll(given, NULL, 10) * 1000 : START_MS;
}

void daemon_start(struct daemon *d, const char *const *options)
{
    *d = (struct daemon){ .lifetime_fd = -1 };
    strcpy(d->dir, "/tmp/airyd-test-XXXXXX");
    assert_non_null(mkdtemp(d->dir));
    snprintf(d->path, sizeof d->path, "%s/s", d->dir);
    int ends[2];
    assert_int_equal(pipe(ends), 0);
    fcntl(ends[1], F_SETFD, FD_CLOEXEC);
    d->lifetime_fd = ends[1];
    char fd_text[16];
    snprintf(fd_text, sizeof fd_text, "%d", ends[0]);
    d->pid = fork();
    assert_true(d->pid >= 0);
    if (d->pid == 0)
        daemon_exec((const char *const[]){ "--socket", d->path, "--lifetime-fd", fd_text, NULL }, options);
    close(ends[0]);
    for (int64_t limit_ms = start_ms(), end = daemon_now_ms() + limit_ms;;) {
        int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
        struct sockaddr_un a = { .sun_family = AF_UNIX };
        strcpy(a.sun_path, d->path);
        int rc = connect(fd, (struct sockaddr *)&a, sizeof a);
        close(fd);
        if (rc == 0)
            return;
        int status;
        if (waitpid(d->pid, &status, WNOHANG) == d->pid)
            fail_msg("airyd ended at its start, status 0x%x", (unsigned)status);
        if (daemon_now_ms() > end) {
            kill(d->pid, SIGKILL);
            fail_msg("airyd did not start in %lld ms", (long long)limit_ms);
        }
        daemon_nap();
    }
}

int daemon_wait(struct daemon *d)
{
    int status = 0;
    for (int64_t end = daemon_now_ms() + STOP_MS; waitpid(d->pid, &status, WNOHANG) != d->pid; daemon_nap())
        if (daemon_now_ms() > end) {
            kill(d->pid, SIGKILL);
            waitpid(d->pid, &status, 0);
            fail_msg("airyd did not end in %d ms", STOP_MS);
        }
    d->pid = 0;
    return WIFEXITED(status) ? WEXITSTATUS(status) : 1000 + WTERMSIG(status);
}

int daemon_stop(struct daemon *d, int signal)
{
    if (signal)
        kill(d->pid, signal);
    int status = daemon_wait(d);
    if (d->lifetime_fd >= 0)
        close(d->lifetime_fd);
    unlink(d->path);
    assert_int_equal(rmdir(d->dir), 0); // it left nothing behind
    return status;
}

unsigned daemon_fds(const struct daemon *d)
{
    char path[48];
    unsigned n = 0;
    snprintf(path, sizeof path, "/proc/%d/fd", (int)d->pid);
    DIR *dir = opendir(path);
    assert_non_null(dir);
    while (readdir(dir))
        n++;
    closedir(dir);
    return n;
}

int daemon_run(const char *const *options, char *text, size_t size)
{
    int ends[2], status;
    assert_int_equal(pipe(ends), 0);
    pid_t pid = fork();
    assert_true(pid >= 0);
    if (pid == 0) {
        dup2(ends[1], STDERR_FILENO);
        daemon_exec(options, NULL);
    }
    close(ends[1]);
    size_t n = 0;
    ssize_t got;
    while ((got = read(ends[0], text + n, size - 1 - n)) > 0)
        n += (size_t)got;
    text[n] = 0;
    close(ends[0]);
    assert_int_equal(waitpid(pid, &status, 0), pid);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 1000 + WTERMSIG(status);
}

struct airy *daemon_join(const struct daemon *d)
{
    struct airy *a;
    struct airy_error e;
    if (airy_connect(&a, d->path, &e) < 0)
        fail_msg("connect: %s", e.text);
    airy_set_reconnect(a, 0);
    return a;
}

// ---- peer ------------------------------------------------------------------------------------------

int peer_socket(const struct daemon *d)
{
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    struct sockaddr_un a = { .sun_family = AF_UNIX };
    strcpy(a.sun_path, d->path);
    assert_int_equal(connect(fd, (struct sockaddr *)&a, sizeof a), 0);
    return fd;
}

void peer_open(struct peer *p, const struct daemon *d)
{
    *p = (struct peer){ 0 };
    assert_int_equal(conn_create(&p->conn, peer_socket(d), WIRE_CLIENT), 0);
}

void peer_hello(struct peer *p, const struct daemon *d)
{
    Airy__Hello h = AIRY__HELLO__INIT;
    struct conn_message m;
    peer_open(p, d);
    h.version_min = h.version_max = 1;
    h.client = "test";
    assert_int_equal(body_send(p->conn, WIRE_HELLO, 0, &h.base, NULL, 0), 0);
    peer_flush(p);
    peer_expect(p, &m, WIRE_WELCOME, 0);
}

void peer_close(struct peer *p)
{
    conn_destroy(p->conn);
    body_arena_finish(&p->arena);
}

void peer_flush(struct peer *p)
{
    int rc;
    for (int64_t end = daemon_now_ms() + REPLY_MS; (rc = conn_flush(p->conn)) == 0;) {
        struct pollfd f = { .fd = conn_fd(p->conn), .events = POLLOUT };
        poll(&f, 1, 100);
        if (daemon_now_ms() > end)
            fail_msg("the daemon does not read");
    }
}

int peer_next(struct peer *p, struct conn_message *m, int timeout_ms)
{
    struct fault f;
    int64_t end = daemon_now_ms() + timeout_ms;
    for (;;) {
        int rc = conn_next(p->conn, m, &f);
        if (rc < 0)
            fail_msg("the daemon's stream: %s", f.text);
        if (rc > 0)
            return 1;
        rc = conn_read(p->conn, 1 << 20);
        if (rc < 0)
            return -1;
        if (rc > 0)
            continue;
        int64_t left = end - daemon_now_ms();
        if (left < 0)
            return 0;
        struct pollfd poll_fd = { .fd = conn_fd(p->conn), .events = POLLIN };
        poll(&poll_fd, 1, (int)left);
    }
}

void peer_expect(struct peer *p, struct conn_message *m, enum wire_type type, uint64_t id)
{
    for (;;) {
        int rc = peer_next(p, m, REPLY_MS);
        if (rc <= 0)
            fail_msg("%s instead of %s", rc ? "the end" : "nothing", wire_type_name(type));
        if (m->header.type == type || (m->header.type != WIRE_CREDIT && m->header.type != WIRE_PROGRESS))
            break;
    }
    if (m->header.type == WIRE_ERROR && type != WIRE_ERROR) {
        struct fault f;
        Airy__Error *e = body_unpack(&airy__error__descriptor, m->body, m->header.body_bytes, &p->arena, &f);
        fail_msg("ERROR %u %s: %s (%s)", e->code, e->symbol, e->text, e->field);
    }
    if (m->header.type != type || m->header.id != id)
        fail_msg("%s id %llu instead of %s id %llu", wire_type_name(m->header.type),
                 (unsigned long long)m->header.id, wire_type_name(type), (unsigned long long)id);
}

const Airy__Error *peer_expect_error(struct peer *p, uint64_t id, unsigned code, const char *field)
{
    struct conn_message m;
    struct fault f;
    peer_expect(p, &m, WIRE_ERROR, id);
    Airy__Error *e = body_unpack(&airy__error__descriptor, m.body, m.header.body_bytes, &p->arena, &f);
    assert_non_null(e);
    if (e->code != code || (field && strcmp(e->field, field)))
        fail_msg("ERROR %u, field %s (%s); expected %u, field %s", e->code, e->field, e->text, code,
                 field ? field : "any");
    assert_string_equal(e->symbol, fault_symbol((enum fault_code)code));
    assert_true(e->text[0]);
    return e;
}

void peer_expect_closed(struct peer *p)
{
    struct conn_message m;
    int rc;
    while ((rc = peer_next(p, &m, REPLY_MS)) > 0)
        if (m.header.type != WIRE_CREDIT)
            fail_msg("%s instead of the end", wire_type_name(m.header.type));
    assert_int_equal(rc, -1);
}

void peer_bloom(struct peer *p, uint64_t id, const Airy__Bloom *b, const int *fds, unsigned n_fds)
{
    int own[WIRE_FDS_MAX];
    for (unsigned i = 0; i < n_fds; i++)
        own[i] = dup(fds[i]);
    assert_int_equal(body_send(p->conn, WIRE_BLOOM, id, &b->base, own, n_fds), 0);
    peer_flush(p);
}

void peer_asset(struct peer *p, uint64_t id, const Airy__Payload *input, int fd)
{
    Airy__Asset a = AIRY__ASSET__INIT;
    int own = fd < 0 ? -1 : dup(fd);
    a.input = (Airy__Payload *)input;
    assert_int_equal(body_send(p->conn, WIRE_ASSET, id, &a.base, &own, fd >= 0), 0);
    peer_flush(p);
}

void peer_data(struct peer *p, uint64_t id, const void *data, size_t bytes)
{
    const uint8_t *at = data;
    while (bytes) {
        size_t n = bytes < WIRE_DATA_BYTES_MAX ? bytes : WIRE_DATA_BYTES_MAX;
        assert_int_equal(conn_send(p->conn, WIRE_DATA, id, at, n, NULL, 0), 0);
        peer_flush(p);
        at += n;
        bytes -= n;
    }
}

void peer_cancel(struct peer *p, uint64_t id)
{
    assert_int_equal(conn_send(p->conn, WIRE_CANCEL, id, NULL, 0, NULL, 0), 0);
    peer_flush(p);
}

const Airy__StatusReply *peer_status(struct peer *p)
{
    struct conn_message m;
    struct fault f;
    assert_int_equal(conn_send(p->conn, WIRE_STATUS, 77, NULL, 0, NULL, 0), 0);
    peer_flush(p);
    peer_expect(p, &m, WIRE_STATUS_REPLY, 77);
    return body_unpack(&airy__status_reply__descriptor, m.body, m.header.body_bytes, &p->arena, &f);
}

int make_memfd(const void *data, size_t bytes, int seals)
{
    int fd = memfd_create("test", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    assert_true(fd >= 0);
    assert_int_equal(ftruncate(fd, (off_t)bytes), 0);
    if (data)
        assert_int_equal(pwrite(fd, data, bytes, 0), bytes);
    if (seals)
        assert_int_equal(fcntl(fd, F_ADD_SEALS, seals), 0);
    return fd;
}
