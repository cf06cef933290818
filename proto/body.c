// SPDX-License-Identifier: Apache-2.0
// body.c - bounded unpacking and packing of message bodies.
#include "body.h"

#include <errno.h>
#include <stdalign.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

static size_t block_bytes(unsigned i) { return (size_t)BODY_ARENA_FIRST_BYTES << i; }

void body_arena_finish(struct body_arena *a)
{
    for (unsigned i = 0; i < BODY_ARENA_BLOCKS; i++)
        free(a->block[i]);
    *a = (struct body_arena){ 0 };
}

void body_arena_reset(struct body_arena *a)
{
    a->current = 0;
    a->used_bytes = 0;
}

// Sets *no_memory when malloc, and not the ceiling, refused.
static void *arena_take(struct body_arena *a, size_t bytes, bool *no_memory)
{
    const size_t align = alignof(max_align_t);
    if (bytes > block_bytes(BODY_ARENA_BLOCKS - 1))
        return NULL;
    bytes = (bytes + align - 1) / align * align;
    unsigned i = a->current;
    size_t used = a->used_bytes;
    while (block_bytes(i) - used < bytes) {
        if (++i == BODY_ARENA_BLOCKS)
            return NULL;
        used = 0;
    }
    if (!a->block[i] && !(a->block[i] = malloc(block_bytes(i)))) {
        *no_memory = true;
        return NULL;
    }
    a->current = i;
    a->used_bytes = used + bytes;
    return a->block[i] + used;
}

void *body_arena_alloc(struct body_arena *a, size_t bytes)
{
    bool no_memory;
    void *p = arena_take(a, bytes, &no_memory);
    if (p)
        memset(p, 0, bytes);
    return p;
}

struct unpacking {
    struct body_arena *arena;
    bool full, no_memory;
};

static void *unpack_alloc(void *ctx, size_t bytes)
{
    struct unpacking *u = ctx;
    void *p = arena_take(u->arena, bytes, &u->no_memory);
    if (!p)
        u->full = true;
    return p;
}

static void unpack_free(void *ctx, void *p)
{
    (void)ctx;
    (void)p;
}

void *body_unpack(const ProtobufCMessageDescriptor *d, const uint8_t *bytes, size_t n,
                  struct body_arena *arena, struct fault *f)
{
    struct unpacking u = { .arena = arena };
    ProtobufCAllocator allocator = { unpack_alloc, unpack_free, &u };
    body_arena_reset(arena);
    void *m = protobuf_c_message_unpack(d, &allocator, n, bytes);
    if (m)
        return m;
    if (u.no_memory)
        fault_set(f, FAULT_NO_MEMORY, "", "no memory to decode a %s of %zu bytes", d->short_name, n);
    else if (u.full)
        fault_set(f, FAULT_BAD_BODY, "", "a %s of %zu bytes needs more than %d KiB when decoded",
                  d->short_name, n, (BODY_ARENA_FIRST_BYTES / 1024 << BODY_ARENA_BLOCKS) - 4);
    else
        fault_set(f, FAULT_BAD_BODY, "", "%zu bytes that are no protobuf message %s", n, d->name);
    return NULL;
}

int body_send(struct conn *c, enum wire_type type, uint64_t id, const ProtobufCMessage *m,
              const int *fds, unsigned n_fds)
{
    uint8_t buffer[WIRE_CONTROL_BYTES_MAX];
    size_t bytes = m ? protobuf_c_message_get_packed_size(m) : 0;
    if (bytes > sizeof(buffer))
        return -EMSGSIZE;
    if (bytes)
        protobuf_c_message_pack(m, buffer);
    return conn_send(c, type, id, buffer, bytes, fds, n_fds);
}

int body_send_fault(struct conn *c, uint64_t id, const struct fault *f)
{
    struct fault copy = *f;
    Airy__Error e = AIRY__ERROR__INIT;
    e.code = (uint32_t)copy.code;
    e.symbol = (char *)fault_symbol(copy.code);
    e.text = copy.text;
    e.field = copy.field;
    e.retryable = fault_retryable(copy.code);
    e.retry_after_ms = copy.retry_after_ms;
    e.queue_position = copy.queue_position;
    return body_send(c, WIRE_ERROR, id, &e.base, NULL, 0);
}
