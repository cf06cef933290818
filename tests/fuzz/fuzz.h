/* SPDX-License-Identifier: Apache-2.0 */
/*
 * fuzz.h - what the fuzz targets share: their input taken apart, a check that stops the run, and a check that no
 * descriptor is left over.
 *
 * Invariant: what is taken from an input depends on its bytes alone, so that a kept input does the same in each run. An
 * input that has ended gives zeros. A failed check aborts: libFuzzer then keeps the input.
 */
#ifndef AIRY_FUZZ_H
#define AIRY_FUZZ_H

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

#define must(condition)                                                                          \
    do {                                                                                         \
        if (!(condition)) {                                                                      \
            fprintf(stderr, "%s:%d: expected %s\n", __FILE__, __LINE__, #condition);             \
            abort();                                                                             \
        }                                                                                        \
    } while (0)

struct fuzz_in {
    const uint8_t *at;
    size_t left;
};

/* At most n bytes; *got of them are there. */
static inline const uint8_t *fuzz_piece(struct fuzz_in *in, size_t n, size_t *got)
{
    const uint8_t *p = in->at;
    *got = n < in->left ? n : in->left;
    in->at += *got;
    in->left -= *got;
    return p;
}

/* Little-endian, of `bytes` bytes. */
static inline uint64_t fuzz_number(struct fuzz_in *in, unsigned bytes)
{
    size_t got;
    const uint8_t *p = fuzz_piece(in, bytes, &got);
    uint64_t v = 0;
    for (size_t i = 0; i < got; i++)
        v |= (uint64_t)p[i] << 8 * i;
    return v;
}
static inline uint8_t fuzz_u8(struct fuzz_in *in) { return (uint8_t)fuzz_number(in, 1); }
static inline uint16_t fuzz_u16(struct fuzz_in *in) { return (uint16_t)fuzz_number(in, 2); }
static inline uint32_t fuzz_u32(struct fuzz_in *in) { return (uint32_t)fuzz_number(in, 4); }
static inline double fuzz_double(struct fuzz_in *in)
{
    const uint64_t bits = fuzz_number(in, 8);
    double v;
    memcpy(&v, &bits, sizeof(v));
    return v;
}

/* The rest as a text of the caller's to free; it ends at a NUL, if there is one. */
static inline char *fuzz_text(const struct fuzz_in *in)
{
    char *text = malloc(in->left + 1);
    must(text);
    if (in->left)
        memcpy(text, in->at, in->left);
    text[in->left] = '\0';
    return text;
}

/* Bytes, with descriptors (at most 4) beside the first, without waiting: as sendmsg. */
static inline ssize_t fuzz_send(int to, const uint8_t *bytes, size_t n, const int *fds, unsigned n_fds)
{
    union {
        struct cmsghdr align;
        uint8_t bytes[CMSG_SPACE(4 * sizeof(int))];
    } control = { .bytes = { 0 } };
    struct iovec iov = { (void *)(uintptr_t)bytes, n };
    struct msghdr h = { .msg_iov = &iov, .msg_iovlen = 1 };
    if (n_fds) {
        h.msg_control = &control;
        h.msg_controllen = CMSG_SPACE(n_fds * sizeof(int));
        struct cmsghdr *c = CMSG_FIRSTHDR(&h);
        *c = (struct cmsghdr){ .cmsg_len = CMSG_LEN(n_fds * sizeof(int)), .cmsg_level = SOL_SOCKET, .cmsg_type = SCM_RIGHTS };
        memcpy(CMSG_DATA(c), fds, n_fds * sizeof(int));
    }
    return sendmsg(to, &h, MSG_DONTWAIT | MSG_NOSIGNAL);
}

/* The number that the next descriptor gets: equal before and after, none was left open. */
static inline int fuzz_next_fd(void)
{
    const int fd = dup(STDERR_FILENO);
    must(fd >= 0);
    close(fd);
    return fd;
}

#endif
