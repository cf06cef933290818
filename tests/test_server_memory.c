// SPDX-License-Identifier: Apache-2.0
/*
 * test_server_memory.c - memory that is refused: the n-th allocation of the daemon's own code, for every n that a request comes to, and
 * every kind of request. The daemon is the real one, its threads in this process; malloc, calloc, realloc and mmap of its code are wrapped by the
 * linker, and fail on other threads than the test's. It must not crash, must answer NO_MEMORY (or, where not even an answer can be
 * made, close), and must do the next request well.
 */
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "daemon_fixture.h"

#include "listener.h"
#include "server.h"

static pthread_t test_thread;
static _Atomic long allocations, fail_at; // fail_at 0: none
static _Atomic long failed;

static bool refuse(void)
{
    if (!fail_at || pthread_equal(pthread_self(), test_thread))
        return false;
    if (++allocations != fail_at)
        return false;
    failed++;
    errno = ENOMEM;
    return true;
}

void *__real_malloc(size_t n);
void *__wrap_malloc(size_t n);
void *__wrap_malloc(size_t n) { return refuse() ? NULL : __real_malloc(n); }
void *__real_calloc(size_t n, size_t size);
void *__wrap_calloc(size_t n, size_t size);
void *__wrap_calloc(size_t n, size_t size) { return refuse() ? NULL : __real_calloc(n, size); }
void *__real_realloc(void *p, size_t n);
void *__wrap_realloc(void *p, size_t n);
void *__wrap_realloc(void *p, size_t n) { return refuse() ? NULL : __real_realloc(p, n); }
void *__real_mmap(void *at, size_t n, int prot, int flags, int fd, off_t offset);
void *__wrap_mmap(void *at, size_t n, int prot, int flags, int fd, off_t offset);
void *__wrap_mmap(void *at, size_t n, int prot, int flags, int fd, off_t offset)
{
    return refuse() ? MAP_FAILED : __real_mmap(at, n, prot, flags, fd, offset);
}

// ---- the daemon, in threads ----------------------------------------------------------------------------

static struct server *server;
static struct listener listener = { .lock_fd = -1 };
static struct daemon here; // its path only
static pthread_t server_thread;
static int lifetime;

static void say(const char *line) { (void)line; }

static void *serve(void *arg)
{
    (void)arg;
    return (void *)(intptr_t)server_run(server);
}

static int start(void **state)
{
    (void)state;
    struct fault f = { .code = FAULT_NONE };
    const uint64_t mib = 1 << 20;
    int ends[2];
    test_thread = pthread_self();
    strcpy(here.dir, "/tmp/airyd-test-XXXXXX");
    assert_non_null(mkdtemp(here.dir));
    snprintf(here.path, sizeof here.path, "%s/s", here.dir);
    assert_int_equal(pipe(ends), 0);
    lifetime = ends[1];
    struct server_config c = {
        .sched = { .threads = 2, .slots = 2, .log = say, .device = { .log = say },
                   .limits = { 512 * mib, 64 * mib, 512 * mib, 64 * mib, 1000, 1000, 1000 } },
        .limits = { .max_frame_bytes = 16 * mib,
                    .exr = { .max_width = 4096, .max_height = 4096, .max_pixels = 1 << 24, .max_decoded_bytes = 256 * mib } },
        .memory_bytes = 1024 * mib, .held_bytes_max = 64 * mib, .credit_bytes = 32 * mib, .idle_bytes_max = 0, .asset_bytes_max = mib,
        .max_requests = 64, .max_clients = 100, .max_jobs = 100, .user_connections = 100,
        .timeouts = { 60000, 60000, 60000, 1000 }, .lifetime_fd = ends[0], .log = say,
    };
    if (listener_bind(&listener, here.path, &f) < 0 || server_create(&server, &c, &listener, &f) < 0)
        fail_msg("%s", f.text);
    assert_int_equal(pthread_create(&server_thread, NULL, serve, NULL), 0);
    return 0;
}

static int stop(void **state)
{
    (void)state;
    void *status;
    close(lifetime);
    pthread_join(server_thread, &status);
    assert_null(status);
    server_destroy(server);
    rmdir(here.dir);
    return 0;
}

// ---- every kind of request -----------------------------------------------------------------------------

enum way { WAY_RAW_INLINE, WAY_RAW_MEMFD, WAY_EXR_INLINE, WAY_EXR_MEMFD, WAY_PLAN, WAY_ASSET, WAY_STATUS, WAY_WALL, WAYS };
static const char *const way_name[WAYS] = { "raw inline", "raw memfd", "exr inline", "exr memfd", "plan", "asset", "status", "wall" };

static struct picture picture;
static uint8_t *file;
static size_t file_bytes;

static int bloom(struct airy *a, enum way way, struct airy_error *e)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    struct airy_result *result = NULL;
    uint64_t id;
    const bool raw = way == WAY_RAW_INLINE || way == WAY_RAW_MEMFD, by_memfd = way == WAY_RAW_MEMFD || way == WAY_EXR_MEMFD;
    const void *data = raw ? (const void *)picture.pixels : file;
    const size_t bytes = raw ? picture_bytes(&picture) : file_bytes;
    if (raw)
        picture_request(&picture, &r);
    r.plan_only = way == WAY_PLAN;
    r.inline_output = !by_memfd;
    if (by_memfd)
        r.input_fd = make_memfd(data, bytes, F_SEAL_SHRINK);
    else {
        r.data = data;
        r.size = bytes;
    }
    int rc = airy_submit(a, &r, &id, e);
    if (by_memfd)
        close(r.input_fd);
    if (rc == 0)
        rc = airy_wait(a, id, 60000, &result, e) == 1 ? 0 : -1;
    airy_result_free(result);
    return rc;
}

static int wall(struct airy *a, struct airy_error *e)
{
    const struct airy_wall_request q = { .action = AIRY_WALL_LIST };
    struct airy_wall_reply *r = NULL;
    int rc = airy_wall(a, &q, 60000, &r, e);
    airy_wall_reply_free(r);
    return rc;
}

static int ask(enum way way, struct airy_error *e)
{
    static struct airy_status s;
    struct airy *a;
    struct airy_asset kept;
    if (airy_connect(&a, here.path, e) < 0)
        return -1;
    airy_set_reconnect(a, 0); // each failure is to be seen
    int rc = way == WAY_STATUS ? airy_status(a, &s, 60000, e)
             : way == WAY_WALL ? wall(a, e)
             : way == WAY_ASSET ? airy_asset(a, -1, file, file_bytes, &kept, e)
                                : bloom(a, way, e);
    airy_close(a);
    return rc;
}

static void drive(enum way way)
{
    struct airy_error e;
    unsigned no_memory = 0, closed = 0, well = 0; // well: it could do without
    long n = 1;
    if (ask(way, &e) < 0)
        fail_msg("%s, with all the memory: %s %s", way_name[way], e.symbol, e.text);
    for (unsigned passes = 0; passes < 3 && n < 400; n++) {
        allocations = failed = 0;
        fail_at = n;
        int rc = ask(way, &e);
        usleep(2000); // what is left to be freed may allocate, too
        fail_at = 0;
        passes = failed ? 0 : passes + 1; // beyond its last allocation
        if (rc == 0)
            well += failed > 0;
        else if (!strcmp(e.symbol, "NO_MEMORY"))
            no_memory++;
        else if (e.code < 0) // the connection: not even a reply could be made
            closed++;
        else
            fail_msg("%s, allocation %ld refused: %s %s", way_name[way], n, e.symbol, e.text);
        if (ask(way, &e) < 0)
            fail_msg("%s, after allocation %ld was refused: %s %s", way_name[way], n, e.symbol, e.text);
    }
    print_message("%s: %ld allocations; %u NO_MEMORY, %u closed, %u done all the same\n", way_name[way], n - 4, no_memory, closed, well);
    assert_true(n < 400 && n > 4);
    assert_true(no_memory + closed > 0);
}

static void test_every_request(void **state)
{
    (void)state;
    picture = picture_make(48, 40, 300, 5);
    file = picture_exr(&picture, &file_bytes);
    for (unsigned way = 0; way < WAYS; way++)
        drive((enum way)way);
    free(file);
    picture_free(&picture);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_every_request) };
    return cmocka_run_group_tests(tests, start, stop);
}
