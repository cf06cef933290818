// SPDX-License-Identifier: Apache-2.0
// run_error.c - a lone point at 16 places of the pyramid's period through the engine, against the exact
// sampled Gaussian: the worst error of a pixel over the peak, and the L1 norm, beside the bounds that
// the plan and the reply state. A bound that does not hold ends the program.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"
#include "plan.h"

enum { PHASES = 16 };

struct point_job {
    struct bench *b;
    double sigma, tolerance, intensity, norm;
    struct params params;
    struct plan plan;
    long period, base; /* cells of the coarsest level; the first place of the point */
    uint32_t side;
    struct planes in, out;
    double *gauss; /* [side]: by distance */
    struct bloom_reply reply;
    double peak, l1; /* worst so far */
};

static void job_init(struct point_job *j, struct bench *b, double sigma, double tolerance)
{
    char psf[64];
    struct fault f;
    *j = (struct point_job){ .b = b, .sigma = sigma, .tolerance = tolerance, .norm = 1 };
    snprintf(psf, sizeof psf, "gaussians:sigma=%.17g,weight=1", sigma);
    params_init(&j->params);
    if (params_set_text(&j->params, "psf", psf, &f) < 0)
        die("%s: %s", f.field, f.text);
    for (long x = 1; x < 9 * sigma; x++)
        j->norm += 2 * exp(-(double)(x * x) / (2 * sigma * sigma));
    // The glow's peak is about 1, as the point: so that float32 holds both.
    j->intensity = j->norm * j->norm;
    j->params.bright = BRIGHT_NONE;
    j->params.tolerance = tolerance;
    j->params.intensity = j->intensity;
    const struct plan_facts facts = { 4096, 4096, 4096, 1, 1, -1 };
    if (plan_make(&j->plan, &j->params, tolerance, &facts, &f) < 0)
        die("%s: %s", f.field, f.text);
    long reach = (long)ceil(5.5 * sigma) + 8;
    j->period = 1L << j->plan.levels;
    j->base = (reach + j->period - 1) / j->period * j->period;
    j->side = (uint32_t)(j->base + j->period + reach);
    j->gauss = take(j->side, sizeof(double));
    for (uint32_t x = 0; x < j->side; x++)
        j->gauss[x] = exp(-(double)x * x / (2 * sigma * sigma)) / j->norm;
    const struct bloom_geometry g = { j->side, j->side, 1, PIXEL_TYPE_FLOAT, 0, 1 };
    if (bloom_slot_prepare(b->engine, bloom_slot(b->engine, 0), 1, &g, &j->in, &j->out, &f) < 0)
        die("%s", f.text);
    for (uint32_t y = 0; y < j->side; y++)
        memset(planes_row(&j->in, 0, y), 0, j->side * sizeof(float));
}

static void compare_row(struct point_job *j, uint32_t y, uint32_t px, uint32_t py, double *l1)
{
    const float *row = (const float *)planes_row(&j->out, 0, y);
    const double gy = j->intensity * j->gauss[labs((long)y - (long)py)];
    double sum = 0, worst = 0;
    for (uint32_t x = 0; x < j->side; x++) {
        double want = gy * j->gauss[labs((long)x - (long)px)] + (x == px && y == py);
        double e = fabs(row[x] - want);
        sum += e;
        worst = e > worst ? e : worst;
    }
    *l1 += sum;
    j->peak = fmax(j->peak, worst); // of the peak: that is intensity / norm^2 = 1
}

static void job_phase(struct point_job *j, long dx, long dy)
{
    const uint32_t px = (uint32_t)(j->base + dx), py = (uint32_t)(j->base + dy);
    const float luma[3] = { 1, 0, 0 };
    float *pixel = (float *)planes_row(&j->in, 0, py) + px;
    struct frame_scan scan = { 0 };
    struct fault f;
    double l1 = 0;
    *pixel = 1;
    if (frame_scan_init(&scan, j->side, j->side))
        die("no memory for a scan");
    for (uint32_t y = 0; y < j->side; y++)
        frame_scan_row(&scan, &j->in, y, luma);
    struct bloom_request r = {
        .params = &j->params, .scan = &scan, .luma = { 1, 0, 0 }, .pixel_aspect = 1
    };
    if (bloom_run(j->b->engine, bloom_slot(j->b->engine, 0), 0, &r, &j->reply, &f) < 0)
        die("%s: %s", f.field, f.text);
    if (j->reply.untouched || j->reply.levels != j->plan.levels)
        die("sigma %g: %u levels, %u expected", j->sigma, j->reply.levels, j->plan.levels);
    for (uint32_t y = 0; y < j->side; y++)
        compare_row(j, y, px, py, &l1);
    j->l1 = fmax(j->l1, l1 / j->intensity);
    *pixel = 0;
    frame_scan_finish(&scan);
}

// 16 places that differ in both axes' phases, spread over the period.
static void job_phases(struct point_job *j, long phases)
{
    const long m = j->period, step = m > PHASES ? m / PHASES : 1;
    for (long i = 0; i < PHASES; i += PHASES / phases)
        job_phase(j, i * step % m, (7 * i + 5 + i / m) * step % m);
}

static void job_report(struct point_job *j)
{
    char name[64];
    // Beside the plan's own: the sum with the scene, in float32.
    double bound = j->plan.gaussian[0].peak + j->plan.rounding_bound + 2 * 0x1p-24;
    double l1_bound = j->reply.error_bound;
    printf("  %-9g %5g  %-4s %6u  %9.2e %9.2e  %9.2e %9.2e\n", j->tolerance, j->sigma, j->reply.rule,
           j->reply.levels, j->peak, bound, j->l1, l1_bound);
    snprintf(name, sizeof name, "%s tolerance %g sigma %g", j->reply.rule, j->tolerance, j->sigma);
    csv_line("error", "", name, "peak_error", j->peak, "of the peak");
    csv_line("error", "", name, "peak_bound", bound, "of the peak");
    csv_line("error", "", name, "l1_error", j->l1, "of max E");
    csv_line("error", "", name, "l1_bound", l1_bound, "of max E");
    // Beyond 5.5 sigma, outside the square, a Gaussian has 1e-7 left.
    if (!(j->peak <= bound && j->l1 <= l1_bound + 1e-7))
        die("sigma %g at tolerance %g: the stated bound is broken", j->sigma, j->tolerance);
}

void measure_error(struct bench *b)
{
    static const double sigmas[] = { 1.8, 2.7, 4, 8, 16, 32, 64, 128, 256 };
    static const double tolerances[] = { 1e-2, 1e-3, 1e-4, 1e-5 };
    printf("Error of a lone point, worst of %d phases\n", b->quick ? 4 : PHASES);
    printf("  %-9s %5s  %-4s %6s  %9s %9s  %9s %9s\n", "tolerance", "sigma", "rule", "levels",
           "err/peak", "bound", "L1 error", "bound");
    for (unsigned t = 0; t < sizeof tolerances / sizeof tolerances[0]; t++)
        for (unsigned i = 0; i < sizeof sigmas / sizeof sigmas[0]; i++) {
            struct point_job j;
            if (b->quick && sigmas[i] > 64)
                continue;
            job_init(&j, b, sigmas[i], tolerances[t]);
            job_phases(&j, b->quick ? 4 : PHASES);
            job_report(&j);
            free(j.gauss);
        }
    printf("\n");
}
