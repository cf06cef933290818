/* SPDX-License-Identifier: Apache-2.0 */
/*
 * payload.h - where the bytes of a request come from and go to: inline blocks, memfds, files.
 *
 * What a client's descriptor can do to us is decided here. A file is read, never mapped. A memfd is
 * mapped only when it cannot shrink (F_SEAL_SHRINK) and is made of ordinary pages: a page that is not
 * there would be a SIGBUS. Its owner can still write into it; so EXR bytes are always copied to a block
 * of ours, and raw pixels, from which nothing is concluded, are read once.
 *
 * A payload owns its descriptor, mapping and block from its init on; payload_finish gives up all of
 * them. One owner at a time.
 */
#ifndef AIRYD_PAYLOAD_H
#define AIRYD_PAYLOAD_H

#include <stdbool.h>

#include "block.h"
#include "fault.h"

enum payload_kind { PAYLOAD_NONE, PAYLOAD_INLINE, PAYLOAD_MEMFD, PAYLOAD_FILE };

struct payload {
    enum payload_kind kind;
    int fd;                /* MEMFD, FILE: ours; else -1 */
    uint64_t offset, size; /* within the descriptor; size 0 there: all from offset on */
    struct block *block;   /* the bytes, when they were copied or came inline */
    uint8_t *data;         /* the first byte, once loaded, mapped or inline; else NULL */
    void *map;
    uint64_t map_bytes;
};
#define PAYLOAD_INIT { .fd = -1 }

/* A memfd: seals, kind of pages, size (which replaces a size of 0). Never blocks. field: "input" or
 * "output", for the fault. 0, or -1 and *f. */
int payload_check_memfd(struct payload *p, bool writable, const char *field, struct fault *f);
/* Maps a checked memfd: data is valid until payload_finish. */
int payload_map(struct payload *p, bool writable, const char *field, struct fault *f);
/* Reads all of a memfd or a file into a block (may block on the file's disk). A size of 0 becomes
 * what the file has from offset on; larger than max_bytes is FAULT_LIMIT, a file that changes meanwhile FAULT_PAYLOAD. */
int payload_load(struct payload *p, struct block_pool *blocks, uint64_t max_bytes, struct fault *f);
void payload_finish(struct payload *p, struct block_pool *blocks);

/* A result that the client will own: a memfd of ours, empty, to be written by write(2) ... */
int payload_new_memfd(struct payload *p, struct fault *f);
/* (appends: p->size grows; 0 or -errno) */
int payload_write(struct payload *p, const void *data, size_t len);
/* ... or given `size` bytes (> 0), all zero, and mapped for writing. */
int payload_reserve(struct payload *p, uint64_t size, struct fault *f);
/* Unmaps it and seals it for good; p->fd is then ready to be sent. */
int payload_seal(struct payload *p, struct fault *f);

#endif
