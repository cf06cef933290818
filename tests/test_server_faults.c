// SPDX-License-Identifier: Apache-2.0
// test_server_faults.c - what a real airyd does when something runs out or breaks under it: descriptors, files that shrink while they are
// read, descriptors that are no memory, refused memory for results, thousands of connects. One daemon for all: whatever was done to it, the next
// frame is the one that it made first.
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include "daemon_fixture.h"

enum { SIDE = 96, FILE_SIDE = 1024, USER_FDS = 400, CONNECTS = 10000 };

static struct daemon the_daemon;
static unsigned fds_at_start;
static struct picture picture;
static uint8_t *first; // what it made of the picture
static struct rlimit fds_allowed;

// The picture's bloom, by memfd or inline. 0, or -1 and *e.
static int bloom(struct airy *a, bool by_memfd, struct airy_error *e)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    struct airy_result *result = NULL;
    uint64_t id;
    picture_request(&picture, &r);
    r.inline_output = !by_memfd;
    if (by_memfd)
        r.input_fd = make_memfd(picture.pixels, picture_bytes(&picture), F_SEAL_SHRINK);
    else {
        r.data = picture.pixels;
        r.size = picture_bytes(&picture);
    }
    int rc = airy_submit(a, &r, &id, e);
    if (by_memfd)
        close(r.input_fd);
    if (rc < 0 || airy_wait(a, id, 60000, &result, e) != 1)
        return -1;
    assert_int_equal(result->size, picture_bytes(&picture));
    if (!first) {
        first = malloc(result->size);
        memcpy(first, result->data, result->size);
    }
    assert_memory_equal(result->data, first, result->size);
    airy_result_free(result);
    return 0;
}

static void frame_is_right(struct airy *a, bool by_memfd)
{
    struct airy_error e;
    if (bloom(a, by_memfd, &e) < 0)
        fail_msg("the next frame, %s: %s %s", by_memfd ? "by memfd" : "inline", e.symbol, e.text);
}

static void frames_are_right(void)
{
    struct airy *a = daemon_join(&the_daemon);
    frame_is_right(a, false);
    frame_is_right(a, true);
    airy_close(a);
}

static int start(void **state)
{
    (void)state;
    char fds[16];
    snprintf(fds, sizeof fds, "%d", USER_FDS);
    picture = picture_make(SIDE, SIDE, 300, 8);
    daemon_start(&the_daemon, (const char *const[]){ "--user-fds", fds, NULL });
    frames_are_right();
    usleep(300000); // until it has seen that all of these are gone
    fds_at_start = daemon_fds(&the_daemon);
    assert_int_equal(prlimit(the_daemon.pid, RLIMIT_NOFILE, NULL, &fds_allowed), 0);
    return 0;
}

static int stop(void **state)
{
    (void)state;
    for (int i = 0; i < 1000 && daemon_fds(&the_daemon) > fds_at_start; i++)
        usleep(10000);
    assert_true(daemon_fds(&the_daemon) <= fds_at_start);
    assert_int_equal(daemon_stop(&the_daemon, SIGTERM), 0);
    picture_free(&picture);
    free(first);
    return 0;
}

struct ask {
    Airy__Bloom bloom;
    Airy__Payload input;
    Airy__Output output;
    Airy__RawLayout raw;
    Airy__RawChannel channel, *channels[1];
};

// One channel of floats.
static void ask_raw(struct ask *a, Airy__Payload__Kind kind, Airy__Output__Kind output, uint32_t side)
{
    memset(a, 0, sizeof *a);
    airy__bloom__init(&a->bloom);
    airy__payload__init(&a->input);
    airy__output__init(&a->output);
    airy__raw_layout__init(&a->raw);
    airy__raw_channel__init(&a->channel);
    a->input.kind = kind;
    a->input.size = (uint64_t)side * side * 4;
    a->output.kind = output;
    a->output.size = a->input.size;
    a->raw.width = a->raw.height = side;
    a->raw.type = AIRY__PIXEL_TYPE__PIXEL_FLOAT;
    a->channel.name = "Y";
    a->channel.row_stride = side * 4;
    a->channel.pixel_stride = 4;
    a->channels[0] = &a->channel;
    a->raw.channels = a->channels;
    a->raw.n_channels = 1;
    a->bloom.input = &a->input;
    a->bloom.output = &a->output;
    a->bloom.format_case = AIRY__BLOOM__FORMAT_RAW;
    a->bloom.raw = &a->raw;
}

static void refused(struct peer *p, uint64_t id, unsigned code, const char *says)
{
    const Airy__Error *e = peer_expect_error(p, id, code, NULL);
    if (!strstr(e->text, says))
        fail_msg("\"%s\" does not say \"%s\"", e->text, says);
    assert_int_equal(e->retryable, fault_retryable((enum fault_code)code));
}

static const Airy__UserState *me(const Airy__StatusReply *s)
{
    for (size_t i = 0; i < s->n_users; i++)
        if (s->users[i]->uid == getuid())
            return s->users[i];
    fail_msg("STATUS does not know user %u", (unsigned)getuid());
    return NULL;
}

static void wait_for_fds(struct peer *p, unsigned fds)
{
    for (int i = 0; i < 3000 && me(peer_status(p))->fds != fds; i++)
        usleep(10000);
    assert_int_equal(me(peer_status(p))->fds, fds);
}

// ---- descriptors of a user ------------------------------------------------------------------------------

// Half-open requests each speak for their result's descriptor; at the cap one more is BUSY, and so is one more connection, while what takes
// none goes on, and other users do.
static void test_user_cap(void **state)
{
    (void)state;
    enum { PEERS = 7, EACH = 60 };
    struct peer p[PEERS], late;
    struct ask q;
    struct conn_message m;
    uint8_t *bytes = calloc(1, SIDE * SIDE * 4);
    for (int i = 0; i < PEERS; i++)
        peer_hello(&p[i], &the_daemon);
    wait_for_fds(&p[0], PEERS);
    ask_raw(&q, AIRY__PAYLOAD__KIND__INLINE, AIRY__OUTPUT__KIND__MEMFD, SIDE);
    unsigned held = PEERS;
    for (int i = 0; i < PEERS; i++)
        for (uint64_t id = 1; id <= EACH && held < USER_FDS; id++, held++)
            peer_bloom(&p[i], id, &q.bloom, NULL, 0);
    for (int i = 0; i < PEERS; i++)
        peer_status(&p[i]); // taken, all of them
    assert_int_equal(me(peer_status(&p[0]))->fds, USER_FDS);
    peer_bloom(&p[0], 100, &q.bloom, NULL, 0);
    refused(&p[0], 100, FAULT_BUSY, "descriptors of this user: 401 of 400");
    peer_open(&late, &the_daemon);
    refused(&late, 0, FAULT_BUSY, "descriptors of this user: 401 of 400");
    peer_expect_closed(&late);
    peer_close(&late);
    struct ask plain;
    ask_raw(&plain, AIRY__PAYLOAD__KIND__INLINE, AIRY__OUTPUT__KIND__INLINE, SIDE);
    peer_bloom(&p[1], 101, &plain.bloom, NULL, 0);
    peer_data(&p[1], 101, bytes, plain.input.size);
    peer_expect(&p[1], &m, WIRE_DATA, 101);
    peer_expect(&p[1], &m, WIRE_RESULT, 101);
    if (geteuid() == 0) {
        chmod(the_daemon.dir, 0755);
        chmod(the_daemon.path, 0666);
        assert_int_equal(seteuid(65534), 0);
        struct airy *other = daemon_join(&the_daemon);
        assert_int_equal(seteuid(0), 0);
        frame_is_right(other, true);
        airy_close(other);
    }
    peer_cancel(&p[0], 1); // its place is the next one's
    peer_expect(&p[0], &m, WIRE_CANCELLED, 1);
    peer_bloom(&p[0], 100, &q.bloom, NULL, 0);
    peer_data(&p[0], 100, bytes, q.input.size);
    peer_expect(&p[0], &m, WIRE_RESULT, 100);
    assert_int_equal(m.header.n_fds, 1);
    close(m.fds[0]);
    for (int i = 1; i < PEERS; i++)
        peer_close(&p[i]);
    peer_hello(&late, &the_daemon);
    wait_for_fds(&late, 2 + EACH - 1);
    peer_close(&p[0]);
    wait_for_fds(&late, 1);
    peer_close(&late);
    free(bytes);
    frames_are_right();
}

// A result that its client does not read holds its descriptor in the daemon: it counts until it is written, and no longer.
static void test_unread_results(void **state)
{
    (void)state;
    enum { BIG = 700, RESULTS = 6 }; // few enough that the daemon still reads what comes
    struct peer p, watcher;
    struct ask big, small;
    struct conn_message m;
    uint8_t *bytes = calloc(1, (size_t)BIG * BIG * 4);
    peer_hello(&watcher, &the_daemon);
    peer_hello(&p, &the_daemon);
    wait_for_fds(&watcher, 2);
    ask_raw(&big, AIRY__PAYLOAD__KIND__INLINE, AIRY__OUTPUT__KIND__INLINE, BIG); // more than a socket takes
    ask_raw(&small, AIRY__PAYLOAD__KIND__INLINE, AIRY__OUTPUT__KIND__MEMFD, 16);
    const uint64_t done = peer_status(&watcher)->done;
    peer_bloom(&p, 1, &big.bloom, NULL, 0);
    peer_data(&p, 1, bytes, big.input.size);
    for (int i = 0; i < 6000 && peer_status(&watcher)->done == done; i++)
        usleep(10000); // its result goes first
    for (uint64_t id = 2; id < 2 + RESULTS; id++) {
        peer_bloom(&p, id, &small.bloom, NULL, 0);
        peer_data(&p, id, bytes, small.input.size);
    }
    for (int i = 0; i < 6000 && peer_status(&watcher)->done < done + 1 + RESULTS; i++)
        usleep(10000);
    assert_int_equal(me(peer_status(&watcher))->requests, 1); // of the others only the results are left
    wait_for_fds(&watcher, 2 + RESULTS);
    unsigned results = 0;
    while (results < 1 + RESULTS) {
        assert_int_equal(peer_next(&p, &m, 60000), 1);
        results += m.header.type == WIRE_RESULT;
        if (m.header.n_fds)
            close(m.fds[0]);
    }
    wait_for_fds(&watcher, 2);
    peer_close(&p);
    peer_close(&watcher);
    free(bytes);
}

// ---- no descriptor is left --------------------------------------------------------------------------------

static void allow_fds(rlim_t n)
{
    const struct rlimit limit = { n, fds_allowed.rlim_max };
    assert_int_equal(prlimit(the_daemon.pid, RLIMIT_NOFILE, &limit, NULL), 0);
}

// Not one more descriptor can be made in the daemon: who needs one is told or waits, nobody else notices, and the socket's thread rests.
static void test_table_full(void **state)
{
    (void)state;
    struct airy *a = daemon_join(&the_daemon);
    struct airy_error e;
    struct peer watcher, sender, late;
    struct ask q;
    struct conn_message m;
    peer_hello(&watcher, &the_daemon);
    peer_hello(&sender, &the_daemon);
    allow_fds(3);
    peer_open(&late, &the_daemon); // the kernel takes it for the daemon, which cannot
    Airy__Hello h = AIRY__HELLO__INIT;
    h.version_min = h.version_max = 1;
    assert_int_equal(body_send(late.conn, WIRE_HELLO, 0, &h.base, NULL, 0), 0);
    peer_flush(&late);
    const uint64_t turns = peer_status(&watcher)->loop_turns, from_ms = (uint64_t)daemon_now_ms();
    assert_int_equal(peer_next(&late, &m, 1000), 0);
    const uint64_t took_ms = (uint64_t)daemon_now_ms() - from_ms, more = peer_status(&watcher)->loop_turns - turns;
    print_message("%llu turns of the socket's thread in %llu ms without a descriptor\n", (unsigned long long)more, (unsigned long long)took_ms);
    assert_true(more <= 10 + took_ms / 50); // a loop that spins takes thousands
    frame_is_right(a, false);
    // A result's memfd cannot be made ...
    ask_raw(&q, AIRY__PAYLOAD__KIND__INLINE, AIRY__OUTPUT__KIND__MEMFD, 16);
    static const uint8_t bytes[16 * 16 * 4];
    peer_bloom(&watcher, 1, &q.bloom, NULL, 0);
    peer_data(&watcher, 1, bytes, sizeof bytes);
    refused(&watcher, 1, FAULT_NO_MEMORY, strerror(EMFILE));
    // ... and one that is sent cannot be taken: who sent it has lost it, and must connect again.
    int fd = make_memfd(bytes, sizeof bytes, F_SEAL_SHRINK);
    ask_raw(&q, AIRY__PAYLOAD__KIND__MEMFD, AIRY__OUTPUT__KIND__INLINE, 16);
    peer_bloom(&sender, 1, &q.bloom, &fd, 1);
    refused(&sender, 0, FAULT_NO_MEMORY, "BLOOM brings 1 descriptors, no more than 0 are free here");
    peer_expect_closed(&sender);
    peer_close(&sender);
    close(fd);
    frame_is_right(a, false);
    allow_fds(fds_allowed.rlim_max);
    peer_expect(&late, &m, WIRE_WELCOME, 0);
    peer_close(&late);
    peer_close(&watcher);
    if (bloom(a, true, &e) < 0)
        fail_msg("with descriptors again: %s %s", e.symbol, e.text);
    airy_close(a);
    frames_are_right();
}

// ---- files and memory of a client's -----------------------------------------------------------------------

// Cut short while it is read, or before, or after: a frame is done of all of it, or not at all.
static void test_file_shrinks(void **state)
{
    (void)state;
    char path[] = "/tmp/airyd-test-file-XXXXXX";
    size_t bytes;
    struct picture p = picture_make(FILE_SIDE, FILE_SIDE, 300, 4);
    uint8_t *content = picture_exr(&p, &bytes);
    int fd = mkstemp(path);
    struct airy *a = daemon_join(&the_daemon);
    unsigned done = 0, shorter = 0;
    uint32_t seed = 1;
    for (int i = 0; i < 300 || (i < 3000 && (!done || !shorter)); i++) {
        struct airy_request r = AIRY_REQUEST_INIT;
        struct airy_error e;
        struct airy_result *result = NULL;
        uint64_t id;
        r.input_fd = fd;
        r.size = bytes;
        assert_int_equal(airy_request_param(&r, "bloom", "off", &e), 0);
        assert_int_equal(pwrite(fd, content, bytes, 0), bytes);
        assert_int_equal(airy_submit(a, &r, &id, &e), 0);
        seed = seed * 1664525u + 1013904223u;
        if (seed >> 31)
            usleep((seed >> 8) % 2000);
        assert_int_equal(ftruncate(fd, (off_t)((seed >> 4) % bytes)), 0);
        if (airy_wait(a, id, 60000, &result, &e) == 1) {
            done++;
            assert_int_equal(result->size, bytes); // bloom=off: the very file
            assert_memory_equal(result->data, content, bytes);
        } else if (!strcmp(e.symbol, "PAYLOAD")) {
            shorter++;
        } else {
            fail_msg("a file that shrinks: %s %s", e.symbol, e.text);
        }
        airy_result_free(result);
    }
    print_message("a file that shrinks: %u times done, %u times too short\n", done, shorter);
    assert_true(done && shorter);
    frame_is_right(a, true);
    airy_close(a);
    close(fd);
    unlink(path);
    free(content);
    picture_free(&p);
}

static void __attribute__((noreturn)) make_holes(int fd, off_t bytes)
{
    for (off_t at = 0;; at = (at + 77 * 4096) % bytes)
        if (fallocate(fd, FALLOC_FL_PUNCH_HOLE | FALLOC_FL_KEEP_SIZE, at, 64 * 4096) < 0)
            _exit(1);
}

// Holes are made in a memfd that cannot shrink, while it is read and written to.
static void test_memfd_with_holes(void **state)
{
    (void)state;
    enum { BIG = 512, BYTES = BIG * BIG * 4 };
    struct peer p;
    struct ask q;
    struct conn_message m;
    uint8_t *bytes = calloc(1, BYTES);
    int fd = make_memfd(bytes, BYTES, F_SEAL_SHRINK);
    pid_t child = fork();
    assert_true(child >= 0);
    if (!child)
        make_holes(fd, BYTES);
    peer_hello(&p, &the_daemon);
    ask_raw(&q, AIRY__PAYLOAD__KIND__MEMFD, AIRY__OUTPUT__KIND__BUFFER, BIG);
    q.output.fd = 1;
    for (uint64_t id = 1; id <= 20; id++) {
        peer_bloom(&p, id, &q.bloom, (int[]){ fd, fd }, 2);
        peer_expect(&p, &m, WIRE_RESULT, id);
    }
    assert_int_equal(waitpid(child, NULL, WNOHANG), 0); // it made holes all the time
    kill(child, SIGKILL);
    assert_int_equal(waitpid(child, NULL, 0), child);
    close(fd);
    free(bytes);
    peer_close(&p);
    frames_are_right();
}

static void expect_refusal(struct peer *p, const struct ask *q, const int *fds, unsigned n, const char *name, unsigned code, const char *field)
{
    static uint64_t id;
    peer_bloom(p, ++id, &q->bloom, fds, n);
    const Airy__Error *e = peer_expect_error(p, id, code, NULL);
    if (strncmp(e->field, field, strlen(field)))
        fail_msg("%s: field %s (%s); expected %s", name, e->field, e->text, field);
}

// No plain file, or one that lies about its size or cannot be read; as input, and as the output that is written to.
static void test_strange_descriptors(void **state)
{
    (void)state;
    static const struct {
        const char *path;
        int flags;
    } strange[] = {
        { "/proc/self/mem", O_RDWR },   { "/proc/self/status", O_RDONLY }, { "/proc/kmsg", O_RDONLY | O_NONBLOCK },
        { "/dev/full", O_RDWR },        { "/dev/zero", O_RDWR },           { "/dev/null", O_RDWR },
        { "/tmp", O_RDONLY },           { "/tmp", O_PATH },                { "/sys/class/net/lo/speed", O_RDONLY },
        { "/sys/kernel/mm/transparent_hugepage/enabled", O_RDONLY },
    };
    struct peer p;
    struct ask q;
    int fd[16], ends[2];
    unsigned n = 0;
    char fifo[] = "/tmp/airyd-test-fifo-XXXXXX";
    const char *name[16];
    for (size_t i = 0; i < sizeof strange / sizeof strange[0]; i++)
        if ((fd[n] = open(strange[i].path, strange[i].flags | O_CLOEXEC)) >= 0)
            name[n++] = strange[i].path;
    assert_non_null(mkdtemp(fifo));
    rmdir(fifo);
    assert_int_equal(mkfifo(fifo, 0600), 0);
    fd[n] = open(fifo, O_RDWR | O_CLOEXEC); // whoever reads from it waits
    name[n++] = "a FIFO";
    unlink(fifo);
    assert_int_equal(socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends), 0);
    fd[n] = ends[0];
    name[n++] = "a socket";
    const int memfd = make_memfd(NULL, 16 * 16 * 4, F_SEAL_SHRINK);
    peer_hello(&p, &the_daemon);
    for (unsigned i = 0; i < n; i++) {
        ask_raw(&q, AIRY__PAYLOAD__KIND__FILE, AIRY__OUTPUT__KIND__INLINE, 16);
        expect_refusal(&p, &q, &fd[i], 1, name[i], FAULT_PAYLOAD, "input.");
        if (strncmp(name[i], "/sys/", 5)) { // of 4096 bytes, they say
            q.input.size = 0;
            expect_refusal(&p, &q, &fd[i], 1, name[i], FAULT_PAYLOAD, "input.");
        }
        ask_raw(&q, AIRY__PAYLOAD__KIND__MEMFD, AIRY__OUTPUT__KIND__INLINE, 16);
        expect_refusal(&p, &q, &fd[i], 1, name[i], FAULT_PAYLOAD_SEALS, "input.fd");
        ask_raw(&q, AIRY__PAYLOAD__KIND__MEMFD, AIRY__OUTPUT__KIND__BUFFER, 16);
        q.output.fd = 1;
        expect_refusal(&p, &q, (int[]){ memfd, fd[i] }, 2, name[i], FAULT_PAYLOAD_SEALS, "output.fd");
    }
    for (unsigned i = 0; i < n; i++)
        close(fd[i]);
    close(ends[1]);
    close(memfd);
    peer_close(&p);
    assert_true(n >= 8);
    frames_are_right();
}

// ---- no room for a result -----------------------------------------------------------------------------------

static void allow_file_bytes(rlim_t n)
{
    struct rlimit limit;
    assert_int_equal(prlimit(the_daemon.pid, RLIMIT_FSIZE, NULL, &limit), 0);
    limit.rlim_cur = n;
    assert_int_equal(prlimit(the_daemon.pid, RLIMIT_FSIZE, &limit, NULL), 0);
}

// Whatever a memfd may not grow to: half a file is no result.
static void test_no_room_for_result(void **state)
{
    (void)state;
    struct airy *a = daemon_join(&the_daemon);
    struct airy_error e;
    size_t bytes;
    uint8_t *file = picture_exr(&picture, &bytes);
    allow_file_bytes(20000);
    assert_int_equal(bloom(a, true, &e), -1);
    assert_string_equal(e.symbol, "NO_MEMORY");
    assert_true(e.retryable);
    struct airy_request r = AIRY_REQUEST_INIT;
    struct airy_result *result = NULL;
    uint64_t id;
    r.data = file;
    r.size = bytes;
    assert_int_equal(airy_submit(a, &r, &id, &e), 0);
    assert_int_equal(airy_wait(a, id, 60000, &result, &e), -1);
    assert_string_equal(e.symbol, "NO_MEMORY");
    assert_non_null(strstr(e.text, strerror(EFBIG)));
    frame_is_right(a, false);
    allow_file_bytes(RLIM_INFINITY);
    assert_int_equal(airy_submit(a, &r, &id, &e), 0);
    assert_int_equal(airy_wait(a, id, 60000, &result, &e), 1);
    airy_result_free(result);
    free(file);
    airy_close(a);
    frames_are_right();
}

// ---- connects -------------------------------------------------------------------------------------------------

static size_t put_header(uint8_t *to, enum wire_type type, unsigned n_fds, uint32_t body, uint64_t id)
{
    wire_encode(to, &(struct wire_header){ .type = type, .n_fds = (uint8_t)n_fds, .body_bytes = body, .id = id });
    return WIRE_HEADER_BYTES;
}

// What the i-th of them says before it goes or stays silent.
static void say_something(int fd, unsigned i)
{
    uint8_t text[256];
    size_t n = 0;
    switch (i % 8) {
    case 0: return;
    case 1: memcpy(text, "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n", n = 35); break;
    case 2: n = put_header(text, WIRE_HELLO, 0, 0, 0) / 2; break;                    // half a header
    case 3: n = put_header(text, WIRE_HELLO, 0, UINT32_MAX, 0); break;               // a body that is too long
    case 4: n = put_header(text, WIRE_HELLO, 0, 100, 0); memset(text + n, 0xff, 7); n += 7; break; // half a body
    case 5: n = put_header(text, WIRE_BLOOM, 2, 0, 1); break;                        // before HELLO, and no descriptors came
    case 6: memset(text, (int)i, n = sizeof text); break;
    default: n = put_header(text, WIRE_STATUS, 0, 0, i); break;
    }
    (void)!send(fd, text, n, MSG_NOSIGNAL | MSG_DONTWAIT); // it may have closed already
}

static void test_many_connects(void **state)
{
    (void)state;
    enum { OPEN = 200 };
    struct airy *a = daemon_join(&the_daemon);
    struct peer watcher;
    int open_fd[OPEN];
    for (unsigned i = 0; i < OPEN; i++)
        open_fd[i] = -1;
    peer_hello(&watcher, &the_daemon);
    for (unsigned i = 0; i < CONNECTS; i++) {
        int *fd = &open_fd[i % OPEN];
        if (*fd >= 0)
            close(*fd); // half-open until now
        *fd = peer_socket(&the_daemon);
        say_something(*fd, i);
        if (i % 3 == 0) {
            close(*fd);
            *fd = -1;
        }
        if (i % 500 == 0) {
            assert_true(peer_status(&watcher)->clients <= 1024);
            frame_is_right(a, i % 1000 == 0);
        }
    }
    for (unsigned i = 0; i < OPEN; i++)
        if (open_fd[i] >= 0)
            close(open_fd[i]);
    wait_for_fds(&watcher, 2);
    assert_int_equal(peer_status(&watcher)->clients, 2);
    peer_close(&watcher);
    airy_close(a);
    frames_are_right();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_user_cap),           cmocka_unit_test(test_unread_results),
        cmocka_unit_test(test_table_full),         cmocka_unit_test(test_file_shrinks),
        cmocka_unit_test(test_memfd_with_holes),   cmocka_unit_test(test_strange_descriptors),
        cmocka_unit_test(test_no_room_for_result), cmocka_unit_test(test_many_connects),
    };
    return cmocka_run_group_tests(tests, start, stop);
}
