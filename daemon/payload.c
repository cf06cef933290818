// SPDX-License-Identifier: Apache-2.0
// payload.c - see payload.h.
#include "payload.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/magic.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/vfs.h>
#include <unistd.h>

static const char *field_of(char out[64], const char *payload, const char *part)
{
    snprintf(out, 64, "%s.%s", payload, part);
    return out;
}

// offset + size against what the descriptor has; a size of 0 becomes the rest.
static int range_check(struct payload *p, uint64_t there, const char *field, struct fault *f)
{
    char name[64];
    if (p->offset > there || (p->size == 0 && p->offset == there))
        return fault_set(f, FAULT_PAYLOAD, field_of(name, field, "offset"),
                         "offset %llu is not within the %llu bytes of the descriptor",
                         (unsigned long long)p->offset, (unsigned long long)there);
    if (p->size == 0)
        p->size = there - p->offset;
    if (p->size > there - p->offset)
        return fault_set(f, FAULT_PAYLOAD, field_of(name, field, "size"),
                         "%llu bytes from offset %llu on; the descriptor has %llu there",
                         (unsigned long long)p->size, (unsigned long long)p->offset,
                         (unsigned long long)(there - p->offset));
    return 0;
}

static int memfd_seals(const struct payload *p, const char *field, struct fault *f)
{
    char name[64];
    int seals = fcntl(p->fd, F_GET_SEALS);
    if (seals < 0)
        return fault_set(f, FAULT_PAYLOAD_SEALS, field_of(name, field, "fd"),
                         "the descriptor is no memfd; expected one that is sealed with F_SEAL_SHRINK");
    if (!(seals & F_SEAL_SHRINK))
        return fault_set(f, FAULT_PAYLOAD_SEALS, field_of(name, field, "fd"),
                         "the memfd has seals 0x%x, not F_SEAL_SHRINK (0x%x)", (unsigned)seals,
                         (unsigned)F_SEAL_SHRINK);
    // Huge pages come from a pool that can run dry under a mapping.
    struct statfs fs;
    if (fstatfs(p->fd, &fs) < 0 || fs.f_type != TMPFS_MAGIC)
        return fault_set(f, FAULT_PAYLOAD_SEALS, field_of(name, field, "fd"),
                         "the memfd is not made of ordinary pages (MFD_HUGETLB is not taken)");
    return seals;
}

int payload_check_memfd(struct payload *p, bool writable, const char *field, struct fault *f)
{
    char name[64];
    int seals = memfd_seals(p, field, f);
    if (seals < 0)
        return -1;
    int flags = fcntl(p->fd, F_GETFL);
    if (flags < 0 || (writable && (flags & O_ACCMODE) != O_RDWR) || (flags & O_ACCMODE) == O_WRONLY)
        return fault_set(f, FAULT_PAYLOAD, field_of(name, field, "fd"), "the memfd is not open for %s",
                         writable ? "reading and writing" : "reading");
    if (writable && (seals & (F_SEAL_WRITE | F_SEAL_FUTURE_WRITE)))
        return fault_set(f, FAULT_PAYLOAD_SEALS, field_of(name, field, "fd"),
                         "the memfd has seals 0x%x, which forbid writing", (unsigned)seals);
    struct stat st;
    if (fstat(p->fd, &st) < 0)
        return fault_set(f, FAULT_PAYLOAD, field_of(name, field, "fd"), "fstat: %s", strerror(errno));
    return range_check(p, (uint64_t)st.st_size, field, f);
}

int payload_map(struct payload *p, bool writable, const char *field, struct fault *f)
{
    char name[64];
    uint64_t page = (uint64_t)sysconf(_SC_PAGESIZE), skip = p->offset % page, bytes = p->size + skip;
    // Reading is private: kernels before 6.7 refuse shared maps of a memfd that is sealed against writing.
    void *map = mmap(NULL, bytes, writable ? PROT_READ | PROT_WRITE : PROT_READ,
                     writable ? MAP_SHARED : MAP_PRIVATE, p->fd, (off_t)(p->offset - skip));
    if (map == MAP_FAILED)
        return fault_set(f, errno == ENOMEM ? FAULT_NO_MEMORY : FAULT_PAYLOAD, field_of(name, field, "fd"),
                         "mapping %llu bytes: %s", (unsigned long long)bytes, strerror(errno));
    p->map = map;
    p->map_bytes = bytes;
    p->data = (uint8_t *)map + skip;
    return 0;
}

static int file_check(struct payload *p, struct stat *st, struct fault *f)
{
    if (fstat(p->fd, st) < 0)
        return fault_set(f, FAULT_PAYLOAD, "input.fd", "fstat: %s", strerror(errno));
    if (!S_ISREG(st->st_mode))
        return fault_set(f, FAULT_PAYLOAD, "input.fd", "the descriptor is no regular file (mode 0%o)",
                         (unsigned)st->st_mode);
    int flags = fcntl(p->fd, F_GETFL);
    if (flags < 0 || (flags & O_ACCMODE) == O_WRONLY || (flags & O_PATH))
        return fault_set(f, FAULT_PAYLOAD, "input.fd", "the file is not open for reading");
    return range_check(p, (uint64_t)st->st_size, "input", f);
}

/*
 * A file that is cut while it is read may give zeros instead of an end: the kernel clears the rest of its last page under a read that has begun.
 * Its size says so afterwards. One that is written to shows it by its time, as finely as the file system keeps that.
 */
static int file_check_again(struct payload *p, const struct stat *before, struct fault *f)
{
    struct stat now;
    if (file_check(p, &now, f) < 0)
        return -1;
    if (now.st_size != before->st_size || now.st_mtim.tv_sec != before->st_mtim.tv_sec || now.st_mtim.tv_nsec != before->st_mtim.tv_nsec)
        return fault_set(f, FAULT_PAYLOAD, "input.fd", "the file was written to while it was read (%lld bytes, then %lld); expected a finished one",
                         (long long)before->st_size, (long long)now.st_size);
    return 0;
}

static int read_all(const struct payload *p, uint8_t *to, struct fault *f)
{
    for (uint64_t done = 0; done < p->size;) {
        uint64_t want = p->size - done;
        if (want > 1 << 30)
            want = 1 << 30;
        ssize_t n = pread(p->fd, to + done, want, (off_t)(p->offset + done));
        if (n < 0 && errno == EINTR)
            continue;
        if (n < 0)
            return fault_set(f, FAULT_PAYLOAD, "input.fd", "reading at offset %llu: %s",
                             (unsigned long long)(p->offset + done), strerror(errno));
        if (n == 0)
            return fault_set(f, FAULT_PAYLOAD, "input.size",
                             "the file ends after %llu of the %llu bytes from offset %llu on",
                             (unsigned long long)done, (unsigned long long)p->size,
                             (unsigned long long)p->offset);
        done += (uint64_t)n;
    }
    return 0;
}

int payload_load(struct payload *p, struct block_pool *blocks, uint64_t max_bytes, struct fault *f)
{
    struct stat st;
    if (p->kind == PAYLOAD_FILE && file_check(p, &st, f) < 0)
        return -1;
    if (p->size > max_bytes)
        return fault_set(f, FAULT_LIMIT, "input.size", "%llu bytes; at most %llu are taken",
                         (unsigned long long)p->size, (unsigned long long)max_bytes);
    p->block = block_take(blocks, p->size);
    if (!p->block)
        return fault_set(f, FAULT_NO_MEMORY, "input.size", "no memory for %llu bytes",
                         (unsigned long long)p->size);
    p->data = p->block->data;
    if (read_all(p, p->data, f) < 0)
        return -1;
    return p->kind == PAYLOAD_FILE ? file_check_again(p, &st, f) : 0;
}

void payload_finish(struct payload *p, struct block_pool *blocks)
{
    if (p->map)
        munmap(p->map, p->map_bytes);
    if (p->fd >= 0)
        close(p->fd);
    block_give(blocks, p->block);
    *p = (struct payload)PAYLOAD_INIT;
}

int payload_new_memfd(struct payload *p, struct fault *f)
{
    int fd = memfd_create("airyd-result", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    if (fd < 0)
        return fault_set(f, FAULT_NO_MEMORY, "output", "memfd_create: %s", strerror(errno));
    *p = (struct payload){ .kind = PAYLOAD_MEMFD, .fd = fd };
    return 0;
}

int payload_reserve(struct payload *p, uint64_t size, struct fault *f)
{
    // The pages are taken now: running out of them later would be a SIGBUS.
    int error = posix_fallocate(p->fd, 0, (off_t)size);
    if (error)
        return fault_set(f, FAULT_NO_MEMORY, "output", "no shared memory for %llu bytes: %s",
                         (unsigned long long)size, strerror(error));
    p->size = size;
    return payload_map(p, true, "output", f);
}

int payload_seal(struct payload *p, struct fault *f)
{
    // F_SEAL_WRITE is refused while a writable mapping exists.
    if (p->map)
        munmap(p->map, p->map_bytes);
    p->map = NULL;
    p->data = NULL;
    if (fcntl(p->fd, F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_WRITE | F_SEAL_SEAL) < 0)
        return fault_set(f, FAULT_INTERNAL, "output", "sealing the result: %s", strerror(errno));
    return 0;
}

int payload_write(struct payload *p, const void *data, size_t len)
{
    for (size_t done = 0; done < len;) {
        ssize_t n = write(p->fd, (const char *)data + done, len - done);
        if (n < 0 && errno == EINTR)
            continue;
        if (n <= 0)
            return n < 0 ? -errno : -EIO;
        done += (size_t)n;
        p->size += (uint64_t)n;
    }
    return 0;
}
