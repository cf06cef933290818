// SPDX-License-Identifier: Apache-2.0
// block.c - see block.h. Blocks are anonymous mappings, so that an announced payload costs memory only
// as its bytes arrive, and giving one back to the system is exact.
#include "block.h"

#include <stdlib.h>
#include <sys/mman.h>

enum { BLOCK_ROUND_BYTES = 256 * 1024 };

void block_pool_init(struct block_pool *p, uint64_t idle_bytes_max)
{
    *p = (struct block_pool){ .idle_bytes_max = idle_bytes_max };
    pthread_mutex_init(&p->lock, NULL);
}

static void block_free(struct block *b)
{
    munmap(b->data, b->bytes);
    free(b);
}

void block_pool_finish(struct block_pool *p)
{
    while (p->idle) {
        struct block *b = p->idle;
        p->idle = b->next;
        block_free(b);
    }
    pthread_mutex_destroy(&p->lock);
}

static struct block *block_new(uint64_t bytes)
{
    struct block *b = malloc(sizeof *b);
    if (!b)
        return NULL;
    void *data = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (data == MAP_FAILED) {
        free(b);
        return NULL;
    }
    *b = (struct block){ .data = data, .bytes = bytes };
    return b;
}

// The smallest idle block that is big enough, unless it is more than twice what is needed: a small
// request must not walk off with a large frame's pages.
static struct block *idle_take(struct block_pool *p, uint64_t bytes)
{
    struct block **best = NULL;
    for (struct block **b = &p->idle; *b; b = &(*b)->next)
        if ((*b)->bytes >= bytes && (*b)->bytes / 2 <= bytes && (!best || (*b)->bytes < (*best)->bytes))
            best = b;
    if (!best)
        return NULL;
    struct block *found = *best;
    *best = found->next;
    found->next = NULL;
    p->idle_count--;
    p->idle_bytes -= found->bytes;
    return found;
}

struct block *block_take(struct block_pool *p, uint64_t bytes)
{
    if (bytes > INT64_MAX / 2)
        return NULL;
    // An eighth of head-room, so that compressed frames of one shot, which differ in size, fit.
    uint64_t room = bytes + bytes / 8 + BLOCK_ROUND_BYTES;
    room -= room % BLOCK_ROUND_BYTES;
    pthread_mutex_lock(&p->lock);
    struct block *b = idle_take(p, bytes);
    pthread_mutex_unlock(&p->lock);
    return b ? b : block_new(room);
}

// The oldest idle blocks go first when there are too many.
static struct block *idle_trim(struct block_pool *p)
{
    struct block *out = NULL;
    while (p->idle && (p->idle_count > BLOCK_IDLE_MAX || p->idle_bytes > p->idle_bytes_max)) {
        struct block **last = &p->idle;
        while ((*last)->next)
            last = &(*last)->next;
        struct block *b = *last;
        *last = NULL;
        p->idle_count--;
        p->idle_bytes -= b->bytes;
        b->next = out;
        out = b;
    }
    return out;
}

void block_give(struct block_pool *p, struct block *b)
{
    if (!b)
        return;
    pthread_mutex_lock(&p->lock);
    b->next = p->idle;
    p->idle = b;
    p->idle_count++;
    p->idle_bytes += b->bytes;
    struct block *surplus = idle_trim(p);
    pthread_mutex_unlock(&p->lock);
    while (surplus) {
        struct block *next = surplus->next;
        block_free(surplus);
        surplus = next;
    }
}
