// SPDX-License-Identifier: Apache-2.0
// listener.c - see listener.h.
#include "listener.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <systemd/sd-daemon.h>
#include <unistd.h>

enum { BACKLOG = 128 };

int listener_from_systemd(struct listener *l, struct fault *f)
{
    *l = (struct listener){ .lock_fd = -1 };
    int n = sd_listen_fds(1);
    if (n < 0)
        return fault_set(f, FAULT_INTERNAL, "LISTEN_FDS", "%s", strerror(-n));
    if (n > LISTENER_FDS_MAX)
        return fault_set(f, FAULT_INTERNAL, "LISTEN_FDS", "%d sockets; at most %d are taken", n,
                         LISTENER_FDS_MAX);
    for (int i = 0; i < n; i++) {
        int fd = SD_LISTEN_FDS_START + i;
        if (sd_is_socket(fd, AF_UNIX, SOCK_STREAM, 1) <= 0)
            return fault_set(f, FAULT_INTERNAL, "LISTEN_FDS",
                             "descriptor %d is no listening Unix stream socket (ListenStream= with a path)", fd);
        int flags = fcntl(fd, F_GETFL);
        if (flags < 0 || fcntl(fd, F_SETFL, flags | O_NONBLOCK) < 0)
            return fault_set(f, FAULT_INTERNAL, "LISTEN_FDS", "descriptor %d: %s", fd, strerror(errno));
        l->fd[l->count++] = fd;
    }
    return 0;
}

int listener_default_path(char *out, size_t size, struct fault *f)
{
    const char *dir = getenv("XDG_RUNTIME_DIR");
    int n;
    if (geteuid() == 0 && (!dir || !*dir)) {
        if (mkdir("/run/airyd", 0755) < 0 && errno != EEXIST)
            return fault_set(f, FAULT_INTERNAL, "--socket", "/run/airyd: %s", strerror(errno));
        n = snprintf(out, size, "/run/airyd/airyd.sock");
    } else if (dir && *dir) {
        n = snprintf(out, size, "%s/airyd.sock", dir);
    } else {
        return fault_set(f, FAULT_INTERNAL, "--socket", "XDG_RUNTIME_DIR is not set; expected --socket PATH");
    }
    if (n < 0 || (size_t)n >= size)
        return fault_set(f, FAULT_INTERNAL, "--socket", "the default path is longer than %zu bytes", size - 1);
    return 0;
}

static bool same_file(int fd, const char *path)
{
    struct stat a, b;
    return fstat(fd, &a) == 0 && lstat(path, &b) == 0 && a.st_dev == b.st_dev && a.st_ino == b.st_ino;
}

static int take_lock(struct listener *l, struct fault *f)
{
    char path[sizeof l->path + 8];
    snprintf(path, sizeof path, "%s.lock", l->path);
    // Who held it may have removed it between our open and our flock: then it locks nothing.
    for (int tries = 0; tries < 8; tries++) {
        int fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
        if (fd < 0)
            return fault_set(f, FAULT_INTERNAL, "--socket", "%.200s: %s", path, strerror(errno));
        int rc = flock(fd, LOCK_EX | LOCK_NB), error = errno;
        if (rc == 0 && same_file(fd, path)) {
            l->lock_fd = fd;
            return 0;
        }
        close(fd);
        if (rc < 0)
            return fault_set(f, FAULT_INTERNAL, "--socket", "%.200s: %s", l->path,
                             error == EWOULDBLOCK ? "another airyd serves it" : strerror(error));
    }
    return fault_set(f, FAULT_INTERNAL, "--socket", "%.200s: the lock file is replaced again and again", path);
}

// With the lock held: nobody else makes or removes the file meanwhile, if all are airyds.
static int clear_stale(const struct listener *l, const struct sockaddr_un *address, struct fault *f)
{
    struct stat st;
    if (lstat(l->path, &st) < 0)
        return errno == ENOENT ? 0 : fault_set(f, FAULT_INTERNAL, "--socket", "%.200s: %s", l->path, strerror(errno));
    if (!S_ISSOCK(st.st_mode))
        return fault_set(f, FAULT_INTERNAL, "--socket", "%.200s exists and is no socket", l->path);
    int probe = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (probe < 0)
        return fault_set(f, FAULT_INTERNAL, "--socket", "socket: %s", strerror(errno));
    int rc = connect(probe, (const struct sockaddr *)address, sizeof *address), error = errno;
    close(probe);
    if (rc == 0 || error != ECONNREFUSED)
        return fault_set(f, FAULT_INTERNAL, "--socket", "%.200s: somebody serves it already%s%s", l->path,
                         rc ? ": " : "", rc ? strerror(error) : "");
    if (unlink(l->path) < 0)
        return fault_set(f, FAULT_INTERNAL, "--socket", "removing the stale %.200s: %s", l->path, strerror(errno));
    return 0;
}

int listener_bind(struct listener *l, const char *path, struct fault *f)
{
    struct sockaddr_un address = { .sun_family = AF_UNIX };
    *l = (struct listener){ .lock_fd = -1 };
    size_t n = strlen(path);
    if (!n || n >= sizeof address.sun_path)
        return fault_set(f, FAULT_INTERNAL, "--socket", "a path of %zu bytes; expected 1 to %zu", n,
                         sizeof address.sun_path - 1);
    memcpy(address.sun_path, path, n + 1);
    memcpy(l->path, path, n + 1);
    if (take_lock(l, f) < 0 || clear_stale(l, &address, f) < 0)
        goto fail;
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (fd < 0) {
        fault_set(f, FAULT_INTERNAL, "--socket", "socket: %s", strerror(errno));
        goto fail;
    }
    l->fd[l->count++] = fd;
    mode_t mask = umask(0);
    umask(mask | 0117);
    int rc = bind(fd, (struct sockaddr *)&address, sizeof address), error = errno;
    umask(mask);
    struct stat st;
    if (rc < 0 || lstat(path, &st) < 0) {
        fault_set(f, FAULT_INTERNAL, "--socket", "%.200s: %s", path, strerror(rc < 0 ? error : errno));
        goto fail;
    }
    l->dev = st.st_dev;
    l->ino = st.st_ino;
    return 0;
fail:
    listener_finish(l);
    return -1;
}

int listener_listen(struct listener *l, struct fault *f)
{
    if (l->path[0] && listen(l->fd[0], BACKLOG) < 0)
        return fault_set(f, FAULT_INTERNAL, "--socket", "listening on %.200s: %s", l->path, strerror(errno));
    return 0;
}

void listener_finish(struct listener *l)
{
    struct stat st;
    if (l->path[0] && l->ino && lstat(l->path, &st) == 0 && st.st_dev == l->dev && st.st_ino == l->ino)
        unlink(l->path);
    for (unsigned i = 0; i < l->count; i++)
        close(l->fd[i]);
    l->count = 0;
    if (l->lock_fd >= 0) {
        char path[sizeof l->path + 8];
        snprintf(path, sizeof path, "%s.lock", l->path);
        unlink(path);
        close(l->lock_fd);
    }
    l->lock_fd = -1;
    l->path[0] = 0;
}
