// SPDX-License-Identifier: Apache-2.0
//
// libresult.c - RESULT as a struct airy_result. Descriptors are mapped only when they are sealed
// against shrinking and as large as they are said to be: nothing the daemon does later can then take
// the pages away.
#include "lib_internal.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

void lib_times(struct airy_times *out, const Airy__StageTimes *t)
{
    *out = (struct airy_times){ 0 };
    if (t)
        *out = (struct airy_times){ t->queue, t->load, t->decode, t->bloom, t->encode, t->total };
}

void airy_result_free(struct airy_result *r)
{
    if (!r)
        return;
    if (r->priv->map)
        munmap(r->priv->map, r->priv->map_bytes);
    free(r->priv->received);
    body_arena_finish(&r->priv->arena);
    if (r->fd >= 0)
        close(r->fd);
    free(r->priv);
    free(r);
}

static int map_output(struct airy_result *r, const Airy__Payload *p, struct airy_error *e)
{
    struct stat st;
    int seals = fcntl(r->fd, F_GET_SEALS);
    if (seals < 0 || !(seals & F_SEAL_SHRINK))
        return lib_fail(e, EPROTO, "output",
                        "the result's descriptor is not a memfd sealed with F_SEAL_SHRINK");
    if (fstat(r->fd, &st) < 0)
        return lib_fail(e, errno, "output", "the result's descriptor: %s", strerror(errno));
    uint64_t has = (uint64_t)st.st_size;
    if (p->offset > has || p->size > has - p->offset)
        return lib_fail(e, EPROTO, "output.size",
                        "the result is said to be bytes %" PRIu64 " to %" PRIu64 "+%" PRIu64
                        " of a memfd of %" PRIu64 " bytes",
                        p->offset, p->offset, p->size, has);
    r->size = p->size;
    if (!p->size)
        return 0;
    uint64_t skip = p->offset % (uint64_t)sysconf(_SC_PAGESIZE);
    if (p->size > SIZE_MAX - skip)
        return lib_fail(e, EOVERFLOW, "output.size", "%" PRIu64 " bytes cannot be mapped", p->size);
    // Private: kernels before 6.7 refuse shared maps of a memfd that is sealed against writing.
    size_t bytes = (size_t)(p->size + skip);
    void *map = mmap(NULL, bytes, PROT_READ, MAP_PRIVATE, r->fd, (off_t)(p->offset - skip));
    if (map == MAP_FAILED)
        return lib_fail(e, errno, "output", "mapping %zu bytes: %s", bytes, strerror(errno));
    r->priv->map = map;
    r->priv->map_bytes = bytes;
    r->data = (const uint8_t *)map + skip;
    return 0;
}

static int take_inline(struct airy_result *r, struct request *request, const Airy__Payload *p,
                       struct airy_error *e)
{
    if (p->size != request->got_bytes)
        return lib_fail(e, EPROTO, "output.size",
                        "the result is said to be %" PRIu64 " bytes, %" PRIu64 " came", p->size,
                        request->got_bytes);
    r->priv->received = request->got;
    r->data = request->got;
    r->size = request->got_bytes;
    request->got = NULL;
    request->got_bytes = request->got_cap = 0;
    return 0;
}

// The kind of output must be the one that was asked for.
static int take_output(struct airy_result *r, struct request *request, const Airy__Payload *p,
                       struct airy_error *e)
{
    static const Airy__Payload__Kind expected[] = {
        [AIRY__OUTPUT__KIND__INLINE] = AIRY__PAYLOAD__KIND__INLINE,
        [AIRY__OUTPUT__KIND__MEMFD] = AIRY__PAYLOAD__KIND__MEMFD,
        [AIRY__OUTPUT__KIND__BUFFER] = AIRY__PAYLOAD__KIND__NONE,
        [AIRY__OUTPUT__KIND__WALL] = AIRY__PAYLOAD__KIND__NONE,
    };
    static const Airy__Payload nothing = AIRY__PAYLOAD__INIT;
    if (!p)
        p = &nothing;
    Airy__Payload__Kind want =
        request->kind == REQUEST_PLAN ? AIRY__PAYLOAD__KIND__NONE : expected[request->output_kind];
    bool want_fd = want == AIRY__PAYLOAD__KIND__MEMFD;
    if (p->kind != want || p->fd != 0 || (r->fd >= 0) != want_fd)
        return lib_fail(e, EPROTO, "output.kind",
                        "the result came as kind %d with%s descriptor, expected kind %d with%s",
                        (int)p->kind, r->fd >= 0 ? "" : "out", (int)want, want_fd ? "" : "out");
    if (want == AIRY__PAYLOAD__KIND__MEMFD)
        return map_output(r, p, e);
    if (want == AIRY__PAYLOAD__KIND__INLINE)
        return take_inline(r, request, p, e);
    r->size = p->size;
    return 0;
}

static void copy_target(struct airy_target *out, const Airy__Target *t)
{
    *out = (struct airy_target){
        .name = t->name,
        .plan = t->plan,
        .rule = t->rule,
        .min_x = t->min_x,
        .min_y = t->min_y,
        .width = t->width,
        .height = t->height,
        .levels = t->levels,
        .tiles = t->tiles,
        .tiles_bright = t->tiles_bright,
        .untouched = t->untouched,
        .error_bound = t->error_bound,
        .max_bright = t->max_bright,
        .saturated = t->saturated,
        .first_channel = "",
        .skipped = t->skipped,
        .storage = t->storage,
        .exposure = t->exposure,
        .predicted_ms = t->predicted_ms,
    };
    if (t->energy) {
        out->energy_input = t->energy->input;
        out->energy_bright = t->energy->bright;
        out->energy_bloomed = t->energy->bloomed;
        out->energy_lost = t->energy->lost;
        out->energy_clamped = t->energy->clamped;
        out->energy_suppressed = t->energy->suppressed;
    }
    if (t->nonfinite) {
        out->nan = t->nonfinite->nan;
        out->positive_inf = t->nonfinite->positive_inf;
        out->negative_inf = t->nonfinite->negative_inf;
        out->negative = t->nonfinite->negative;
        out->any_nonfinite = t->nonfinite->any;
        out->first_x = t->nonfinite->first_x;
        out->first_y = t->nonfinite->first_y;
        out->first_channel = t->nonfinite->first_channel;
    }
}

// The texts stay in the arena, where the body was unpacked.
static int copy_facts(struct airy_result *r, const Airy__Result *b, struct airy_error *e)
{
    struct airy_target *targets = body_arena_alloc(&r->priv->arena, b->n_targets * sizeof(*targets));
    if (!targets)
        return lib_fail(e, ENOMEM, "targets", "no room for %zu targets", b->n_targets);
    for (size_t i = 0; i < b->n_targets; i++)
        copy_target(&targets[i], b->targets[i]);
    r->targets = targets;
    r->n_targets = (unsigned)b->n_targets;
    lib_times(&r->ms, b->ms);
    r->device = b->device;
    r->chunks = b->chunks;
    r->chunks_copied = b->chunks_copied;
    r->notes = (const char *const *)b->notes;
    r->n_notes = (unsigned)b->n_notes;
    r->exposure = b->exposure;
    r->stamp = b->stamp;
    r->has_need = b->need != NULL;
    if (b->need)
        r->need = (struct airy_region){ b->need->x, b->need->y, b->need->width, b->need->height };
    return 0;
}

int lib_result_make(struct request *request, const struct conn_message *m, struct airy_error *e)
{
    int fd = m->header.n_fds ? m->fds[0] : -1;
    struct fault f;
    struct airy_result *r = calloc(1, sizeof(*r));
    if (r)
        r->priv = calloc(1, sizeof(*r->priv));
    if (!r || !r->priv) {
        free(r);
        if (fd >= 0)
            close(fd);
        return lib_fail(e, ENOMEM, "", "no memory for a result");
    }
    r->id = request->id;
    r->fd = fd;
    const Airy__Result *b =
        body_unpack(&airy__result__descriptor, m->body, m->header.body_bytes, &r->priv->arena, &f);
    if (!b) {
        lib_fail(e, EPROTO, "", "from the daemon: %s", f.text);
        goto fail;
    }
    if (copy_facts(r, b, e) < 0 || take_output(r, request, b->output, e) < 0)
        goto fail;
    request->result = r;
    return 0;
fail:
    airy_result_free(r);
    return -1;
}
