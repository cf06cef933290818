// SPDX-License-Identifier: Apache-2.0
/*
 * bench_wall.c - `make bench-wall`: a wall's picture of 1920x1080 float frames with J5's psf: ms of each pass (medians), of the
 * whole (and the processor time of all threads), and their ratio to copying the frame and to the C chain, by how much of
 * the frame is bright, as the scan has found it. No time is asserted.
 *
 * The turns of memcpy, C chain and engine alternate, as in airy_bench; a pass is known by its place in the recording.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "bench.h"

enum { WIDTH = 1920, HEIGHT = 1080, PASSES = 64, TURNS = 15 };

static char pass_name[PASSES][40];
static double pass_ms[PASSES][TURNS];
static unsigned passes, turn;

static void gather(const char *line)
{
    double ms;
    if (passes < PASSES && sscanf(line, "pass %39s %lf ms", pass_name[passes], &ms) == 2)
        pass_ms[passes++][turn] = ms;
}

static int by_value(const void *a, const void *b)
{
    return *(const double *)a < *(const double *)b ? -1 : *(const double *)a > *(const double *)b;
}

static double median(double *v)
{
    qsort(v, TURNS, sizeof(*v), by_value);
    return v[TURNS / 2];
}

// Dim noise, and bright tiles in clumps of 2 x 2 until so many of 16 are lit.
static void paint(const struct planes *in, unsigned lit_of_100)
{
    uint32_t seed = 1;
    for (uint32_t y = 0; y < HEIGHT; y++)
        for (uint32_t x = 0; x < WIDTH; x++) {
            const uint32_t clump = (x / 128 * 7 + y / 128 * 13) * 37 % 100;
            for (unsigned c = 0; c < 3; c++) {
                seed = seed * 1664525u + 1013904223u;
                const float dim = 0.9f * (float)(seed >> 8) * 0x1p-24f;
                ((float *)(void *)planes_row(in, c, y))[x] = clump < lit_of_100 ? 20 * dim : dim;
            }
        }
}

struct wall_job {
    struct bloom *engine;
    struct params params;
    struct frame_scan scan;
    struct bloom_wall wall;
    double total[TURNS], copy[TURNS], chain[TURNS], cpu[TURNS];
    struct bloom_reply reply; /* of the last turn */
};

// Of all threads: what a busy machine does not change much.
static double cpu_ms(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec * 1e3 + (double)t.tv_nsec * 1e-6;
}

static void run_once(struct wall_job *j, double *ms, double *cpu)
{
    struct fault f;
    struct bloom_request r = { .params = &j->params, .scan = &j->scan, .source = -1, .matte = -1, .depth = -1,
                               .pixel_aspect = 1, .wall = j->wall.drive ? &j->wall : NULL };
    memcpy(r.luma, frame_rec709, sizeof r.luma);
    passes = 0;
    const double t0 = now_ms(), cpu0 = cpu_ms();
    if (bloom_run(j->engine, bloom_slot(j->engine, 0), 0, &r, &j->reply, &f) < 0)
        die("%s: %s", f.field, f.text);
    *ms = now_ms() - t0;
    *cpu = cpu_ms() - cpu0;
}

static void report(struct wall_job *j, const char *what, double tolerance)
{
    double sum = 0, ratio_copy[TURNS], ratio_chain[TURNS];
    for (unsigned t = 0; t < TURNS; t++) {
        ratio_copy[t] = j->total[t] / j->copy[t];
        ratio_chain[t] = j->total[t] / j->chain[t];
    }
    printf("%s, tolerance %g, %.1f %% of tiles bright: %.2f ms, %.2f ms of all cores, %.2f x C chain, %.2f x memcpy\n", what, tolerance,
           100.0 * j->reply.tiles_bright / j->reply.tiles, median(j->total), median(j->cpu), median(ratio_chain), median(ratio_copy));
    for (unsigned i = 0; i < passes; i++) {
        const double ms = median(pass_ms[i]);
        sum += ms;
        printf("    %-28s %7.3f ms\n", pass_name[i], ms);
    }
    printf("    %-28s %7.3f ms\n", "all passes", sum);
}

static void measure(struct wall_job *j, const struct planes *in, struct bench_frame *frame, struct team *team, unsigned lit)
{
    static const struct { uint32_t width, height; } walls[] = { { 512, 256 }, { 64, 32 }, { 0, 0 } };
    static const double tolerances[] = { 1e-3, 1e-4 };
    struct copy *copy = copy_create(frame, team);
    struct chain_job *chain = chain_job_create(frame, team);
    if (frame_scan_init(&j->scan, WIDTH, HEIGHT))
        die("no memory for a scan");
    paint(in, lit);
    planes_fill(&frame->in_float, in);
    for (uint32_t y = 0; y < HEIGHT; y++)
        frame_scan_row(&j->scan, in, y, frame_rec709);
    for (unsigned k = 0; k < 3 * 2; k++) {
        const unsigned w = k / 2;
        char what[40] = "full picture";
        if (walls[w].width)
            snprintf(what, sizeof what, "wall %ux%u", walls[w].width, walls[w].height);
        j->params = job_params(WIDTH, tolerances[k % 2]);
        j->wall = (struct bloom_wall){ .width = walls[w].width, .height = walls[w].height, .end_x = walls[w].width,
                                       .end_y = walls[w].height, .frame_width = WIDTH, .frame_height = HEIGHT,
                                       .tone_map = DISPLAY_ACES, .saturation = 1.1,
                                       .matrix = { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } } };
        if (walls[w].width) {
            j->wall.pitch_x = (double)WIDTH / walls[w].width;
            j->wall.pitch_y = (double)HEIGHT / walls[w].height;
            j->wall.drive = take((size_t)walls[w].width * walls[w].height * 3, sizeof(float));
        }
        run_once(j, &j->total[0], &j->cpu[0]);
        for (turn = 0; turn < TURNS; turn++) {
            struct sample s = { 0 };
            copy_run(copy, &s);
            j->copy[turn] = s.ms;
            chain_job_run(chain, &s);
            j->chain[turn] = s.ms;
            run_once(j, &j->total[turn], &j->cpu[turn]);
        }
        report(j, what, tolerances[k % 2]);
        free(j->wall.drive);
    }
    frame_scan_finish(&j->scan);
    chain_job_destroy(chain);
    copy_destroy(copy);
}

int main(void)
{
    static const unsigned lit[] = { 5, 20, 100 };
    struct wall_job j = { 0 };
    struct planes in, out[BLOOM_OUTPUTS_MAX];
    struct bench_frame frame;
    struct fault f;
    setvbuf(stdout, NULL, _IOLBF, 0);
    bench_pin();
    struct team *team = team_create();
    const struct bloom_options options = { .slots = 1, .profile = true, .log = gather };
    const struct bloom_geometry g = { WIDTH, HEIGHT, 3, PIXEL_TYPE_FLOAT, 0, 1 };
    if (bloom_create(&j.engine, &options, &f) < 0 ||
        bloom_slot_prepare(j.engine, bloom_slot(j.engine, 0), 1, &g, &in, out, &f) < 0)
        die("%s", f.text);
    frame_make(&frame, WIDTH, HEIGHT, team);
    for (unsigned i = 0; i < sizeof lit / sizeof lit[0]; i++)
        measure(&j, &in, &frame, team, lit[i]);
    frame_finish(&frame);
    bloom_destroy(j.engine);
    team_destroy(team);
    return EXIT_SUCCESS;
}
