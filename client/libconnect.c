// SPDX-License-Identifier: Apache-2.0
//
// libconnect.c - from a path to a connection that has been welcomed: the first one, which blocks, and those that take its
// place, which do not. A descriptor that was handed to us is closed on every path.
#include "lib_internal.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

// Long, for a daemon may be started by this very connection (socket activation), and tests its device before it says a word.
enum { CONNECT_TIMEOUT_MS = 30000 };

// A conn over fd, which is taken in every case, with HELLO queued.
static int conn_make(struct airy *a, int fd, struct airy_error *e)
{
    struct conn *conn;
    int err = conn_create(&conn, fd, WIRE_CLIENT);
    if (err) {
        close(fd);
        return lib_fail(e, -err, "fd", "descriptor %d cannot be a connection: %s", fd, strerror(-err));
    }
    Airy__Hello h = AIRY__HELLO__INIT;
    h.version_min = h.version_max = WIRE_VERSION;
    h.client = (char *)"libairy/" AIRY_VERSION;
    err = body_send(conn, WIRE_HELLO, 0, &h.base, NULL, 0);
    if (err) {
        conn_destroy(conn);
        return lib_fail(e, -err, "", "HELLO: %s", strerror(-err));
    }
    conn_set_sink(conn, lib_place_data, a);
    a->conn = conn;
    a->welcome = false;
    return 0;
}

static int wait_for_welcome(struct airy *a, int64_t deadline_ms, struct airy_error *e)
{
    if (lib_step(a) < 0)
        return lib_copy_error(e, &a->lost);
    while (!a->welcome) {
        int up = lib_step_until(a, deadline_ms);
        if (up < 0)
            return lib_copy_error(e, &a->lost);
        if (up && !a->welcome)
            return lib_fail(e, ETIMEDOUT, "", "the daemon did not answer HELLO in %d ms",
                            CONNECT_TIMEOUT_MS);
    }
    return 0;
}

// path NULL: it never comes back.
static int connect_until(struct airy **out, int fd, const char *path, int64_t deadline_ms, struct airy_error *e)
{
    struct airy *a = calloc(1, sizeof(*a));
    if (!a) {
        close(fd);
        return lib_fail(e, ENOMEM, "", "no memory for a connection");
    }
    a->next_id = 1;
    a->again.watch_fd = a->again.timer_fd = -1;
    if (conn_make(a, fd, e) < 0 || wait_for_welcome(a, deadline_ms, e) < 0 || (path && lib_again_init(a, path, e) < 0)) {
        airy_close(a);
        return -1;
    }
    *out = a;
    return 0;
}

int airy_connect_fd(struct airy **out, int fd, struct airy_error *e)
{
    return connect_until(out, fd, NULL, lib_now_ms() + CONNECT_TIMEOUT_MS, e);
}

// A connected socket, or -errno. deadline_ms -1: it never waits.
static int open_socket(const char *path, int64_t deadline_ms)
{
    struct sockaddr_un address = { .sun_family = AF_UNIX };
    if (strlen(path) >= sizeof(address.sun_path))
        return -ENAMETOOLONG;
    strcpy(address.sun_path, path);
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | (deadline_ms < 0 ? SOCK_NONBLOCK : 0), 0);
    if (fd < 0)
        return -errno;
    // A full backlog makes connect wait; the send time-out bounds that.
    int64_t left_ms = deadline_ms - lib_now_ms();
    if (left_ms < 1)
        left_ms = 1;
    struct timeval left = { .tv_sec = left_ms / 1000, .tv_usec = left_ms % 1000 * 1000 };
    int err = 0;
    if (setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &left, sizeof(left)) < 0)
        err = -errno;
    while (!err && connect(fd, (struct sockaddr *)&address, sizeof(address)) < 0)
        if (errno != EINTR || (deadline_ms >= 0 && lib_now_ms() > deadline_ms))
            err = errno == EAGAIN && deadline_ms >= 0 ? -ETIMEDOUT : -errno;
    if (err) {
        close(fd);
        return err;
    }
    return fd;
}

// "PATH: reason; " of each that did not answer.
static void add_tried(char *tried, size_t size, const char *path, int err)
{
    size_t n = strlen(tried);
    snprintf(tried + n, size - n, "%s%s: %s", n ? "; " : "", path, strerror(-err));
}

int airy_connect(struct airy **out, const char *path, struct airy_error *e)
{
    int64_t deadline_ms = lib_now_ms() + CONNECT_TIMEOUT_MS;
    const char *own = getenv("AIRY_SOCKET"), *runtime = getenv("XDG_RUNTIME_DIR");
    char user[sizeof(((struct sockaddr_un *)0)->sun_path) + 1] = "", tried[320] = "";
    if (runtime && *runtime)
        snprintf(user, sizeof(user), "%s/airyd.sock", runtime);
    const char *paths[] = { own, user, "/run/airyd/airyd.sock" };
    unsigned count = sizeof(paths) / sizeof(paths[0]);
    if (path) {
        paths[0] = path;
        count = 1;
    }
    int err = -ENOENT;
    for (unsigned i = 0; i < count; i++) {
        if (!paths[i] || !*paths[i])
            continue;
        int fd = open_socket(paths[i], deadline_ms);
        if (fd >= 0)
            return connect_until(out, fd, paths[i], deadline_ms, e);
        err = fd;
        add_tried(tried, sizeof(tried), paths[i], fd);
    }
    return lib_fail(e, -err, "socket", "no daemon answers (%s)", *tried ? tried : "no path given");
}

int lib_connect_try(struct airy *a, struct airy_error *e)
{
    int fd = open_socket(a->again.path, -1);
    if (fd < 0)
        return lib_fail(e, -fd, "socket", "%s: %s", a->again.path, strerror(-fd));
    return conn_make(a, fd, e);
}
