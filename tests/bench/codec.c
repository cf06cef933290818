// SPDX-License-Identifier: Apache-2.0
// codec.c - the floor under every EXR frame: the daemon's own reader and writer with no bloom between
// them. Bytes are in memory on both sides, as in the daemon.
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"
#include "exr.h"

struct codec {
    struct team *team;
    struct exr_worker *worker[TEAM];
    struct exr *exr;
    unsigned tasks;
    bool encode;
    _Atomic unsigned next;
};

struct codec *codec_create(struct team *team)
{
    struct codec *c = take(1, sizeof(*c));
    c->team = team;
    for (unsigned i = 0; i < TEAM; i++)
        if (exr_worker_create(&c->worker[i]))
            die("no memory for a codec thread");
    return c;
}

void codec_destroy(struct codec *c)
{
    for (unsigned i = 0; i < TEAM; i++)
        exr_worker_destroy(c->worker[i]);
    free(c);
}

static void tasks_run(void *ctx, unsigned member)
{
    struct codec *c = ctx;
    struct fault f;
    for (unsigned i; (i = atomic_fetch_add(&c->next, 1)) < c->tasks;)
        if (c->encode ? exr_encode(c->exr, i, c->worker[member], &f)
                      : exr_decode(c->exr, i, c->worker[member], &f))
            die("EXR: %s", f.text);
}

static void all_tasks(struct codec *c, bool encode)
{
    c->encode = encode;
    c->tasks = encode ? exr_encode_tasks(c->exr) : exr_decode_tasks(c->exr);
    atomic_store(&c->next, 0);
    team_run(c->team, tasks_run, c);
}

static void read_all(struct codec *c, const uint8_t *exr, uint64_t bytes, int compression,
                     const struct planes *in, const struct planes *out)
{
    const struct exr_limits limits = { 65536, 65536, UINT64_C(1) << 32, UINT64_C(1) << 36 };
    const struct exr_select select = { 0 };
    const struct exr_options options = { .compression = compression };
    struct fault f;
    if (exr_open(&c->exr, exr, bytes, &limits, &select, &options, &f))
        die("EXR: %s", f.text);
    const struct exr_target *t = exr_target(c->exr, 0);
    if (exr_target_count(c->exr) != 1 || t->width != in->width || t->height != in->height ||
        t->channels != in->count || t->type != in->type)
        die("EXR: %u targets, the first %ux%u: not the frame", exr_target_count(c->exr), t->width,
            t->height);
    exr_bind(c->exr, 0, in, out);
    all_tasks(c, false);
}

void codec_read(struct codec *c, const uint8_t *exr, uint64_t bytes, const struct planes *in)
{
    read_all(c, exr, bytes, EXR_KEEP, in, in);
    exr_close(c->exr);
}

struct place {
    uint8_t *at, *end;
};

static int place_write(void *ctx, const void *data, size_t n)
{
    struct place *p = ctx;
    if (n > (size_t)(p->end - p->at))
        die("EXR: the result is longer than expected");
    memcpy(p->at, data, n); // as it would go into a memfd
    p->at += n;
    return 0;
}

struct codec_result codec_run(struct codec *c, const uint8_t *exr, uint64_t bytes, int compression,
                              const struct planes *in, const struct planes *out, uint8_t *file,
                              uint64_t room)
{
    const bool untouched = false;
    struct fault f;
    double t0 = now_ms();
    read_all(c, exr, bytes, compression, in, out);
    double t1 = now_ms();
    if (exr_encode_begin(c->exr, &untouched, &f))
        die("EXR: %s", f.text);
    all_tasks(c, true);
    struct place p = { file, file + room };
    if (exr_assemble(c->exr, place_write, &p, &f))
        die("EXR: %s", f.text);
    double t2 = now_ms();
    // Changing the compression makes every chunk anew; else a chunk of unchanged pixels would be copied.
    struct exr_counts n = exr_counts(c->exr);
    if (n.chunks_copied)
        die("EXR: %u of %u chunks were copied: no floor", n.chunks_copied, n.chunks);
    exr_close(c->exr);
    return (struct codec_result){ t1 - t0, t2 - t1, (uint64_t)(p.at - file) };
}
