// SPDX-License-Identifier: Apache-2.0
/*
 * exr_arena.c - the memory of unpacked chunks, kept from frame to frame.
 *
 * Fresh pages cost a fifth of a ZIP frame's decoding. So a request takes one block for all its chunks and
 * gives it back to a small cache of the process: least recently used goes first, and at most
 * cache_bytes are kept. Any thread.
 */
#include <pthread.h>
#include <stdlib.h>

#include "exr_internal.h"

enum { CACHE_SLOTS = 16 };
static _Atomic uint64_t cache_bytes = UINT64_C(512) << 20;

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static struct exr_arena cache[CACHE_SLOTS]; // [0] is the least recently used; `used` of them
static unsigned used;
static uint64_t cached_bytes;

static struct exr_arena cache_remove(unsigned i)
{
    const struct exr_arena a = cache[i];
    for (used--; i < used; i++)
        cache[i] = cache[i + 1];
    cached_bytes -= a.bytes;
    return a;
}

// The smallest that is large enough, unless it is more than twice too large.
static struct exr_arena cache_take(uint64_t bytes)
{
    struct exr_arena a = { 0 };
    int best = -1;
    pthread_mutex_lock(&lock);
    for (unsigned i = 0; i < used; i++)
        if (cache[i].bytes >= bytes && cache[i].bytes / 2 <= bytes &&
            (best < 0 || cache[i].bytes < cache[best].bytes))
            best = (int)i;
    if (best >= 0)
        a = cache_remove((unsigned)best);
    pthread_mutex_unlock(&lock);
    return a;
}

void exr_cache_limit(uint64_t bytes) { cache_bytes = bytes; }

int exr_arena_init(struct exr_arena *a, uint64_t bytes)
{
    *a = (struct exr_arena){ 0 };
    if (!bytes)
        return 0;
    *a = cache_take(bytes);
    if (a->memory)
        return 0;
    a->memory = malloc(bytes);
    a->bytes = a->memory ? bytes : 0;
    return a->memory ? 0 : -1;
}

void exr_arena_finish(struct exr_arena *a)
{
    struct exr_arena drop[CACHE_SLOTS + 1];
    unsigned drops = 0;
    if (!a->memory)
        return;
    pthread_mutex_lock(&lock);
    if (a->bytes > cache_bytes) {
        drop[drops++] = *a;
    } else {
        while (used == CACHE_SLOTS || (used && cached_bytes + a->bytes > cache_bytes))
            drop[drops++] = cache_remove(0);
        cache[used++] = *a;
        cached_bytes += a->bytes;
    }
    pthread_mutex_unlock(&lock);
    for (unsigned i = 0; i < drops; i++)
        free(drop[i].memory);
    *a = (struct exr_arena){ 0 };
}
