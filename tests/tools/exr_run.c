// SPDX-License-Identifier: Apache-2.0
// exr_run.c - see exr_run.h.
#include "exr_run.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { THREADS_MAX = 8 };

struct crew {
    struct exr *x;
    struct exr_worker *worker[THREADS_MAX];
    unsigned tasks;
    bool encode, backwards;
    _Atomic unsigned next;
    _Atomic int failed;
    struct fault fault[THREADS_MAX];
};

struct hand {
    struct crew *crew;
    unsigned index;
};

static void *hand_run(void *arg)
{
    const struct hand *h = arg;
    struct crew *c = h->crew;
    for (unsigned i; (i = atomic_fetch_add(&c->next, 1)) < c->tasks && !atomic_load(&c->failed);) {
        const unsigned task = c->backwards ? c->tasks - 1 - i : i;
        struct fault *f = &c->fault[h->index];
        if (c->encode ? exr_encode(c->x, task, c->worker[h->index], f)
                      : exr_decode(c->x, task, c->worker[h->index], f))
            atomic_store(&c->failed, (int)h->index + 1);
    }
    return NULL;
}

static int crew_run(struct crew *c, struct exr_run *r, bool encode)
{
    const unsigned threads = r->threads ? r->threads : 1;
    pthread_t thread[THREADS_MAX];
    struct hand hand[THREADS_MAX];
    c->encode = encode;
    c->backwards = !r->threads;
    c->tasks = encode ? exr_encode_tasks(c->x) : exr_decode_tasks(c->x);
    atomic_store(&c->next, 0);
    for (unsigned i = 0; i < threads; i++) {
        hand[i] = (struct hand){ c, i };
        if (i && pthread_create(&thread[i], NULL, hand_run, &hand[i]))
            abort();
    }
    hand_run(&hand[0]);
    for (unsigned i = 1; i < threads; i++)
        pthread_join(thread[i], NULL);
    int failed = atomic_load(&c->failed);
    if (failed)
        r->fault = c->fault[failed - 1];
    return failed ? -1 : 0;
}

float planes_get(const struct planes *p, unsigned c, uint32_t x, uint32_t y)
{
    const uint8_t *row = planes_row(p, c, y);
    float v;
    if (p->type == PIXEL_TYPE_HALF)
        half_to_float(&v, (const uint16_t *)(const void *)row + x, 1);
    else
        memcpy(&v, row + 4 * (size_t)x, 4);
    return v;
}

void planes_set(struct planes *p, unsigned c, uint32_t x, uint32_t y, float v)
{
    uint8_t *row = planes_row(p, c, y);
    if (p->type == PIXEL_TYPE_HALF)
        float_to_half((uint16_t *)(void *)row + x, &v, 1);
    else
        memcpy(row + 4 * (size_t)x, &v, 4);
}

static void planes_copy(struct planes *to, const struct planes *from, uint32_t grow)
{
    for (unsigned c = 0; c < from->count; c++)
        for (uint32_t y = 0; y < from->height; y++) {
            uint8_t *row = planes_row(to, c, y + grow) + (size_t)grow * pixel_bytes(to->type);
            const uint8_t *src = planes_row(from, c, y);
            if (to->type == from->type)
                memcpy(row, src, (size_t)from->width * pixel_bytes(from->type));
            else
                half_to_float((float *)(void *)row, (const uint16_t *)(const void *)src, from->width);
        }
}

static int take(void *ctx, const void *data, size_t n)
{
    struct exr_run *r = ctx;
    memcpy(r->bytes + r->size, data, n);
    r->size += n;
    return 0;
}

static int collect(struct exr_run *r, struct exr *x)
{
    const uint64_t expected = exr_assembled_bytes(x);
    r->bytes = malloc(expected);
    if (!r->bytes || exr_assemble(x, take, r, &r->fault))
        return -1;
    if (r->size != expected)
        return fault_set(&r->fault, FAULT_INTERNAL, "", "assembled %zu bytes, announced %llu", r->size,
                         (unsigned long long)expected);
    r->counts = exr_counts(x);
    for (unsigned i = 0; i < exr_note_count(x); i++) {
        const size_t used = strlen(r->notes);
        snprintf(r->notes + used, sizeof(r->notes) - used, "%s\n", exr_note(x, i));
    }
    return 0;
}

int exr_run(struct exr_run *r, const void *bytes, size_t size)
{
    static const struct exr_limits generous = { 16384, 16384, UINT64_C(1) << 28, UINT64_C(1) << 32 };
    struct crew crew = { 0 };
    struct planes in[16] = { { 0 } }, out[16][8] = { { { 0 } } };
    bool untouched[16];
    int result = exr_open(&crew.x, bytes, size, r->limits ? r->limits : &generous, &r->select, &r->options,
                          &r->fault);
    if (result)
        return -1;
    r->targets = exr_target_count(crew.x);
    for (unsigned i = 0; i < (r->threads ? r->threads : 1); i++)
        if (exr_worker_create(&crew.worker[i]))
            abort();
    for (unsigned i = 0; i < r->targets; i++) {
        struct exr_target *t = exr_target(crew.x, i);
        const bool scene = t->role == EXR_SCENE;
        t->grow = scene ? r->grow : 0;
        memcpy(r->names[i], t->name, sizeof(t->name));
        untouched[i] = r->untouched;
        if (planes_alloc(&in[i], t->width, t->height, t->channels, t->type))
            abort();
    }
    result = exr_grow_check(crew.x, &r->fault);
    for (unsigned i = 0; i < r->targets && !result; i++) {
        const struct exr_target *t = exr_target(crew.x, i);
        const bool scene = t->role == EXR_SCENE;
        for (unsigned k = 0; scene && k <= r->options.extras; k++)
            if (planes_alloc(&out[i][k], t->width + 2 * t->grow, t->height + 2 * t->grow, t->channels,
                             r->float_out ? PIXEL_TYPE_FLOAT : t->type))
                abort();
        exr_bind(crew.x, i, &in[i], scene ? out[i] : NULL);
    }
    if (!result)
        result = crew_run(&crew, r, false);
    for (unsigned i = 0; i < r->targets && !result; i++) {
        if (r->look)
            r->look(i, exr_target(crew.x, i), &in[i], r->ctx);
        if (exr_target(crew.x, i)->role != EXR_SCENE)
            continue;
        planes_copy(&out[i][0], &in[i], exr_target(crew.x, i)->grow);
        if (r->edit)
            r->edit(i, exr_target(crew.x, i), &out[i][0], r->ctx);
        for (unsigned k = 0; k < r->options.extras; k++)
            r->extra(i, k, &out[i][1 + k], r->ctx);
    }
    if (!result)
        result = exr_encode_begin(crew.x, untouched, &r->fault);
    if (!result)
        result = crew_run(&crew, r, true);
    if (!result)
        result = collect(r, crew.x);
    exr_close(crew.x);
    for (unsigned i = 0; i < 16; i++) {
        planes_free(&in[i]);
        for (unsigned k = 0; k < 8; k++)
            planes_free(&out[i][k]);
    }
    for (unsigned i = 0; i < THREADS_MAX; i++)
        exr_worker_destroy(crew.worker[i]);
    return result;
}

void exr_run_finish(struct exr_run *r)
{
    free(r->bytes);
    r->bytes = NULL;
    r->size = 0;
}
