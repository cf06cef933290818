// SPDX-License-Identifier: Apache-2.0
// cmd_output.c - cmd_output.h's promise, step by step. The temporary file is in the target's folder,
// since only there is rename atomic; a symbolic link is followed first, so that it still is one
// afterwards.
//
// Who writes a temporary file holds a lock (flock) on it until it has its last name: so a file that can be locked is of a
// run that has died, by kill -9 or a lost machine, and may go. Where locks do not reach other machines a
// living run's file may go, too: it then misses it at the rename, and writes it again.
#include "cmd_output.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/random.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <unistd.h>

#include "cmd_cleanup.h"

static int fail_with(char *why, const char *path, const char *what, int error)
{
    snprintf(why, OUTPUT_WHY_MAX, "%.300s: %s%s%s", path, what, *what ? ": " : "", strerror(error));
    return -1;
}

struct place {
    char *path;   /* real target; owned */
    char *folder; /* owned */
    const char *base;
    int folder_fd;
    bool exists;
    mode_t mode; /* of what exists */
};

static void place_finish(struct place *p)
{
    if (p->folder_fd >= 0)
        close(p->folder_fd);
    free(p->path);
    free(p->folder);
}

static int place_init(struct place *p, const char *path, bool overwrite, char *why)
{
    struct stat s;
    *p = (struct place){ .folder_fd = -1 };
    if (stat(path, &s) == 0) {
        p->exists = true;
        p->mode = s.st_mode & 07777;
        if (!S_ISREG(s.st_mode)) {
            snprintf(why, OUTPUT_WHY_MAX, "%.300s: is there and is not a regular file", path);
            goto fail;
        }
        if (!overwrite) {
            snprintf(why, OUTPUT_WHY_MAX, "%.300s: is there already (--no-overwrite)", path);
            goto fail;
        }
        p->path = realpath(path, NULL);
    } else {
        p->path = strdup(path);
    }
    if (!p->path) {
        fail_with(why, path, "", errno);
        goto fail;
    }
    char *slash = strrchr(p->path, '/');
    p->base = slash ? slash + 1 : p->path;
    p->folder = slash ? strndup(p->path, (size_t)(slash + 1 - p->path)) : strdup(".");
    if (!p->folder || !*p->base) {
        fail_with(why, path, "", p->folder ? EISDIR : ENOMEM);
        goto fail;
    }
    p->folder_fd = open(p->folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (p->folder_fd < 0 || faccessat(p->folder_fd, ".", W_OK | X_OK, AT_EACCESS) < 0) {
        char folder[300];
        snprintf(folder, sizeof(folder), "the output folder %.250s", p->folder);
        fail_with(why, path, folder, errno);
        goto fail;
    }
    return 0;
fail:
    place_finish(p);
    return -1;
}

int output_check(const char *path, bool overwrite, char *why)
{
    struct place p;
    if (place_init(&p, path, overwrite, why) < 0)
        return -1;
    place_finish(&p);
    return 0;
}

/* The daemon's memory goes to the file in the kernel where that works; else from the mapping. */
static int copy_to(int fd, const struct airy_result *r)
{
    uint64_t done = 0;
    while (r->fd >= 0 && done < r->size) {
        off_t from = (off_t)done;
        size_t want = r->size - done > (1u << 30) ? 1u << 30 : (size_t)(r->size - done);
        ssize_t n = sendfile(fd, r->fd, &from, want);
        if (n > 0)
            done += (uint64_t)n;
        else if (n == 0 || errno == EINVAL || errno == ENOSYS)
            break;
        else if (errno != EINTR)
            return -errno;
    }
    while (done < r->size) {
        if (!r->data)
            return -EIO;
        ssize_t n = write(fd, (const char *)r->data + done, r->size - done);
        if (n > 0)
            done += (uint64_t)n;
        else if (n < 0 && errno != EINTR)
            return -errno;
    }
    return 0;
}

static int fill(int fd, const struct airy_result *r, const struct place *p)
{
    /* Reserving first finds out about a full disk before the writing. */
    if (r->size && fallocate(fd, 0, 0, (off_t)r->size) < 0 && errno != EOPNOTSUPP && errno != EINTR)
        return -errno;
    int e = copy_to(fd, r);
    if (e == 0 && p->exists && fchmod(fd, p->mode) < 0)
        e = -errno;
    if (e == 0 && fsync(fd) < 0)
        e = -errno;
    return e;
}

#define TEMP_MARK ".airy-"
enum { TEMP_DIGITS = 16, TEMP_BASE_MAX = 200, ATTEMPTS_MAX = 100, WRITES_MAX = 5 };

/* Is the name still this file's? */
static bool is_there(int folder_fd, const char *name, int fd)
{
    struct stat named, held;
    return fstat(fd, &held) == 0 && fstatat(folder_fd, name, &named, AT_SYMLINK_NOFOLLOW) == 0 &&
           held.st_ino == named.st_ino && held.st_dev == named.st_dev;
}

/* Locked; where there are no locks, not. One that went between its making and its locking is made again. */
static int temp_open(const struct place *p, char *name, size_t size)
{
    for (unsigned attempt = 0; attempt < ATTEMPTS_MAX; attempt++) {
        uint64_t random;
        if (getrandom(&random, sizeof(random), 0) != sizeof(random))
            return -EIO;
        snprintf(name, size, ".%.*s" TEMP_MARK "%0*llx", TEMP_BASE_MAX, p->base, TEMP_DIGITS,
                 (unsigned long long)random);
        int fd = openat(p->folder_fd, name, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0666);
        if (fd < 0 && errno != EEXIST)
            return -errno;
        if (fd < 0)
            continue;
        bool taken = flock(fd, LOCK_EX | LOCK_NB) < 0 && errno == EWOULDBLOCK;
        if (!taken && is_there(p->folder_fd, name, fd))
            return fd;
        close(fd);
    }
    return -EEXIST;
}

/* Closes fd in such a way that its lock stays: *lock is closed by the caller. Network file systems say at the first close what
 * went wrong. */
static int close_locked(int fd, int *lock)
{
    *lock = dup(fd);
    int e = *lock < 0 ? -errno : 0;
    return close(fd) < 0 && e == 0 ? -errno : e;
}

/* The new name is on the disk, too. Some file systems have no fsync of folders. */
static int folder_sync(const struct place *p)
{
    return fsync(p->folder_fd) < 0 && errno != EINVAL && errno != ENOTSUP && errno != EBADF ? -errno : 0;
}

static int give_name(const struct place *p, const char *temp, bool overwrite)
{
    if (renameat2(p->folder_fd, temp, p->folder_fd, p->base, overwrite ? 0 : RENAME_NOREPLACE) == 0)
        return 0;
    if (overwrite || errno != EINVAL)
        return -errno;
    /* No such rename here; a link does not replace either. */
    if (linkat(p->folder_fd, temp, p->folder_fd, p->base, 0) < 0)
        return -errno;
    unlinkat(p->folder_fd, temp, 0);
    return 0;
}

/* 0, or -errno: nothing is left, and what was there is as it was. -ENOENT: the temporary file was taken away. */
static int write_once(const struct place *p, const struct airy_result *r, bool overwrite)
{
    sigset_t saved;
    static char temp[NAME_MAX + 1]; /* the signal handler looks at it */
    int lock = -1;
    cleanup_hold(&saved);
    int fd = temp_open(p, temp, sizeof(temp));
    if (fd >= 0)
        cleanup_set_file(p->folder_fd, temp);
    cleanup_release(&saved);
    if (fd < 0)
        return fd;
    int e = fill(fd, r, p), closed = close_locked(fd, &lock);
    e = e ? e : closed;
    cleanup_hold(&saved);
    if (e == 0)
        e = give_name(p, temp, overwrite);
    if (e < 0)
        unlinkat(p->folder_fd, temp, 0);
    cleanup_set_file(-1, NULL);
    cleanup_release(&saved);
    if (lock >= 0)
        close(lock);
    return e;
}

int output_write(const char *path, const struct airy_result *r, bool overwrite, char *why)
{
    struct place p;
    int e = -ENOENT;
    if (place_init(&p, path, overwrite, why) < 0)
        return -1;
    for (unsigned i = 0; e == -ENOENT && i < WRITES_MAX; i++)
        e = write_once(&p, r, overwrite);
    if (e == 0)
        e = folder_sync(&p);
    place_finish(&p);
    return e < 0 ? fail_with(why, path, "cannot be written", -e) : 0;
}

/* ---- what dead runs left ------------------------------------------------------------------------ */

/* Of ".BASE.airy-0123456789abcdef": BASE's length; 0: not such a name. */
static size_t temp_base(const char *name)
{
    size_t len = strlen(name), tail = sizeof(TEMP_MARK) - 1 + TEMP_DIGITS;
    if (name[0] != '.' || len < 2 + tail || strncmp(name + len - tail, TEMP_MARK, sizeof(TEMP_MARK) - 1) != 0 ||
        strspn(name + len - TEMP_DIGITS, "0123456789abcdef") != TEMP_DIGITS)
        return 0;
    return len - 1 - tail;
}

static bool remove_dead(int folder_fd, const char *name)
{
    struct stat s;
    bool removed = false;
    int fd = openat(folder_fd, name, O_RDWR | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
    if (fd < 0)
        return false;
    if (fstat(fd, &s) == 0 && S_ISREG(s.st_mode) && flock(fd, LOCK_EX | LOCK_NB) == 0 && is_there(folder_fd, name, fd))
        removed = unlinkat(folder_fd, name, 0) == 0;
    close(fd);
    return removed;
}

unsigned output_clean(const char *folder, bool (*is_ours)(void *ctx, const char *base, size_t len), void *ctx)
{
    unsigned removed = 0;
    struct dirent *entry;
    DIR *d = opendir(folder);
    if (!d)
        return 0;
    while ((entry = readdir(d))) {
        size_t len = temp_base(entry->d_name);
        if (len && is_ours(ctx, entry->d_name + 1, len))
            removed += remove_dead(dirfd(d), entry->d_name);
    }
    closedir(d);
    return removed;
}

bool output_is_base(const char *path, const char *base, size_t len)
{
    const char *slash = strrchr(path, '/'), *own = slash ? slash + 1 : path;
    size_t own_len = strnlen(own, TEMP_BASE_MAX);
    return own_len == len && memcmp(own, base, len) == 0;
}
