// SPDX-License-Identifier: Apache-2.0
// run_engine.c - the engine in this process: J5 on float and half planes at four tolerances, the scan
// that comes before it, and the floors, in turns.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"

static const float LUMA[3] = { .2126f, .7152f, .0722f };
static const double TOLERANCES[] = { 1e-3, 1e-2, 1e-4, 1e-5 };
enum { N_TOLERANCES = sizeof TOLERANCES / sizeof TOLERANCES[0] };

struct engine_job {
    struct bloom *engine;
    struct bloom_slot *slot;
    struct params params;
    const struct frame_scan *scan;
    struct bloom_reply reply;
};

static void engine_run(void *ctx, struct sample *s)
{
    struct engine_job *j = ctx;
    struct bloom_request r = { .params = &j->params, .scan = j->scan, .pixel_aspect = 1 };
    struct fault f;
    memcpy(r.luma, LUMA, sizeof r.luma);
    double t0 = now_ms();
    if (bloom_run(j->engine, j->slot, 0, &r, &j->reply, &f) < 0)
        die("%s: %s", f.field, f.text);
    s->ms = now_ms() - t0;
    s->part[0] = j->reply.device_ms;
    if (j->reply.untouched)
        die("the engine says that nothing glows");
}

struct scan_job {
    struct team *team;
    const struct planes *in;
    struct frame_scan scan;
};

static void scan_half(void *ctx, unsigned member)
{
    struct scan_job *j = ctx;
    uint32_t h = j->in->height;
    for (uint32_t y = member * h / TEAM; y < (member + 1) * h / TEAM; y++)
        frame_scan_row(&j->scan, j->in, y, LUMA);
}

static void scan_run(void *ctx, struct sample *s)
{
    struct scan_job *j = ctx;
    frame_scan_finish(&j->scan);
    if (frame_scan_init(&j->scan, j->in->width, j->in->height))
        die("no memory for a scan");
    double t0 = now_ms();
    team_run(j->team, scan_half, j);
    s->ms = now_ms() - t0;
}

// One pixel type: its slot, its scan and its four jobs.
struct side {
    enum pixel_type type;
    struct planes in, out;
    struct scan_job scan;
    struct engine_job job[N_TOLERANCES];
};

static void side_init(struct side *s, struct bench *b, const struct bench_frame *f, unsigned slot,
                      enum pixel_type type)
{
    const struct planes *from = type == PIXEL_TYPE_HALF ? &f->in_half : &f->in_float;
    const struct bloom_geometry g = { f->width, f->height, 3, type, 0, 1 };
    struct fault fault;
    *s = (struct side){ .type = type };
    if (bloom_slot_prepare(b->engine, bloom_slot(b->engine, slot), 1, &g, &s->in, &s->out, &fault) < 0)
        die("%s", fault.text);
    planes_fill(&s->in, from);
    s->scan.team = b->team;
    s->scan.in = &s->in;
    scan_run(&s->scan, &(struct sample){ 0 });
    for (unsigned t = 0; t < N_TOLERANCES; t++)
        s->job[t] = (struct engine_job){ b->engine,
                                         bloom_slot(b->engine, slot),
                                         job_params(f->width, TOLERANCES[t]),
                                         &s->scan.scan,
                                         { 0 } };
}

static unsigned side_cases(struct side *s, struct bench_case *cases, unsigned n)
{
    const char *type = s->type == PIXEL_TYPE_HALF ? "half" : "float";
    for (unsigned t = 0; t < N_TOLERANCES; t++, n++) {
        cases[n] = (struct bench_case){ .run = engine_run, .ctx = &s->job[t] };
        snprintf(cases[n].name, sizeof cases[n].name, "engine J5 %s, tolerance %g", type, TOLERANCES[t]);
    }
    cases[n] = (struct bench_case){ .run = scan_run, .ctx = &s->scan };
    snprintf(cases[n].name, sizeof cases[n].name, "scan %s, 2 threads", type);
    return n + 1;
}

static void side_notes(const struct side *s, const struct bench_frame *f, struct bench_case *cases,
                       unsigned rounds)
{
    for (unsigned t = 0; t < N_TOLERANCES; t++) {
        const struct bloom_reply *r = &s->job[t].reply;
        snprintf(cases[t].note, sizeof cases[t].note, "%s, bound %.1e, device %.1f", r->rule,
                 r->error_bound, bench_part(&cases[t], 0, rounds));
        csv_line("engine", f->size, cases[t].name, "device", bench_part(&cases[t], 0, rounds), "ms");
        csv_line("engine", f->size, cases[t].name, "error_bound", r->error_bound, "relative");
    }
}

void measure_engine(struct bench *b, struct bench_frame *f)
{
    static struct bench_case cases[CASES_MAX];
    struct side side[2];
    struct copy *copy = copy_create(f, b->team);
    struct chain_job *chain = chain_job_create(f, b->team);
    unsigned n = 0;
    cases[n++] =
        (struct bench_case){ .name = "memcpy float RGBA, 2 threads", .run = copy_run, .ctx = copy };
    cases[n++] =
        (struct bench_case){ .name = "C chain J5 float, 2 threads", .run = chain_job_run, .ctx = chain };
    for (unsigned i = 0; i < 2; i++) {
        side_init(&side[i], b, f, i, i ? PIXEL_TYPE_HALF : PIXEL_TYPE_FLOAT);
        n = side_cases(&side[i], cases, n);
    }
    bench_rounds(cases, n, b->rounds);
    for (unsigned i = 0; i < 2; i++) {
        side_notes(&side[i], f, &cases[2 + i * (N_TOLERANCES + 1)], b->rounds);
        // What the daemon's answers are compared with.
        engine_run(&side[i].job[0], &(struct sample){ 0 });
        planes_fill(i ? &f->out_half : &f->out_float, &side[i].out);
        frame_scan_finish(&side[i].scan.scan);
    }
    printf("Engine in this process, %s (%.0f %% of the pixels above 1)\n", f->size,
           100 * f->bright_share);
    bench_table("engine", f->size, cases, n, b->rounds,
                (const struct bench_base[]){ { "memcpy", 0 }, { "chain", 1 }, { NULL, 0 } });
    copy_destroy(copy);
    chain_job_destroy(chain);
}
