// SPDX-License-Identifier: Apache-2.0
// cmd_output.c - cmd_output.h's promise, step by step. The temporary file is in the target's folder,
// since only there is rename atomic; a symbolic link is followed first, so that it still is one
// afterwards.
#include "cmd_output.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
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

static int temp_open(const struct place *p, char *name, size_t size)
{
    for (unsigned attempt = 0; attempt < 100; attempt++) {
        uint64_t random;
        if (getrandom(&random, sizeof(random), 0) != sizeof(random))
            return -EIO;
        snprintf(name, size, ".%.200s.airy-%016llx", p->base, (unsigned long long)random);
        int fd = openat(p->folder_fd, name, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0666);
        if (fd >= 0 || errno != EEXIST)
            return fd >= 0 ? fd : -errno;
    }
    return -EEXIST;
}

int output_write(const char *path, const struct airy_result *r, bool overwrite, char *why)
{
    struct place p;
    sigset_t saved;
    static char temp[NAME_MAX + 1]; /* the signal handler looks at it */
    if (place_init(&p, path, overwrite, why) < 0)
        return -1;
    cleanup_hold(&saved);
    int fd = temp_open(&p, temp, sizeof(temp));
    if (fd >= 0)
        cleanup_set_file(p.folder_fd, temp);
    cleanup_release(&saved);
    int e = fd < 0 ? fd : fill(fd, r, &p);
    if (fd >= 0 && close(fd) < 0 && e == 0)
        e = -errno;
    cleanup_hold(&saved);
    if (e == 0 &&
        renameat2(p.folder_fd, temp, p.folder_fd, p.base, overwrite ? 0 : RENAME_NOREPLACE) < 0)
        e = -errno;
    if (fd >= 0 && e < 0)
        unlinkat(p.folder_fd, temp, 0);
    cleanup_set_file(-1, NULL);
    cleanup_release(&saved);
    if (e == 0)
        fsync(p.folder_fd); /* of the name; the data is safe, and some file systems refuse this */
    place_finish(&p);
    return e < 0 ? fail_with(why, path, "cannot be written", -e) : 0;
}
