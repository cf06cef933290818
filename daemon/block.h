/* SPDX-License-Identifier: Apache-2.0 */
/*
 * block.h - the big buffers of payloads, reused: a frame that comes in the size of an earlier one
 * allocates nothing and touches no fresh page.
 *
 * A block has one owner at a time; take and give may be called from any thread. What a block holds
 * when taken is left over from an earlier frame (perhaps of another user): whoever sends a block out
 * writes or clears every byte of it first.
 */
#ifndef AIRYD_BLOCK_H
#define AIRYD_BLOCK_H

#include <pthread.h>
#include <stdint.h>

struct block {
    uint8_t *data;
    uint64_t bytes; /* room, at least what was asked for */
    struct block *next;
};

enum { BLOCK_IDLE_MAX = 16 };

struct block_pool {
    pthread_mutex_t lock;
    struct block *idle; /* most recently given first */
    unsigned idle_count;
    uint64_t idle_bytes, idle_bytes_max;
};

void block_pool_init(struct block_pool *p, uint64_t idle_bytes_max);
void block_pool_finish(struct block_pool *p); /* all blocks must have been given back */
struct block *block_take(struct block_pool *p, uint64_t bytes); /* NULL: no memory */
void block_give(struct block_pool *p, struct block *b);         /* NULL is fine */

#endif
