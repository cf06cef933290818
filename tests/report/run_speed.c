// SPDX-License-Identifier: Apache-2.0
// run_speed.c - (time, error) of each method at each size, on the same frame in turns; and the shimmer of a source that
// slides. A method that needs long has fewer turns: no more than its budget, at least one.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "report.h"

enum { TURNS_MAX = 16 };

struct entry {
    struct subject subject;
    bool open;
    unsigned turns;
    double spent_ms, ms[TURNS_MAX], ratio[TURNS_MAX];
};

static int by_value(const void *a, const void *b)
{
    return *(const double *)a < *(const double *)b ? -1 : *(const double *)a > *(const double *)b;
}

static double middle(const double *v, unsigned n)
{
    double sorted[TURNS_MAX];
    memcpy(sorted, v, n * sizeof(*v));
    qsort(sorted, n, sizeof(*sorted), by_value);
    return n % 2 ? sorted[n / 2] : (sorted[n / 2 - 1] + sorted[n / 2]) / 2;
}

// Turn 0 warms up, and counts only where the budget has no second turn.
static void turn(struct entry *e, unsigned turn, double budget_ms, double copy_ms)
{
    if (!e->open || (turn && e->spent_ms > budget_ms))
        return;
    double ms = subject_run(&e->subject);
    e->spent_ms += ms;
    if (turn == 0 && e->spent_ms <= budget_ms)
        return;
    e->ms[e->turns] = ms;
    e->ratio[e->turns++] = ms / copy_ms;
}

static void measure_turns(struct report *r, const struct bench_frame *f, struct entry *e, unsigned n)
{
    static const unsigned turns[] = { 1, 3, 5 };
    static const double budget_ms[] = { 1e3, 500, 1500 };
    struct copy *copy = copy_create(f, r->team);
    struct sample s;
    copy_run(copy, &s);
    // The driver compiles at the first draw, once in its life: nobody's turn.
    for (unsigned i = 0; i < n; i++)
        if (e[i].open && !e[i].subject.method)
            subject_run(&e[i].subject);
    for (unsigned k = 0; k <= turns[r->extent]; k++) {
        copy_run(copy, &s);
        for (unsigned i = 0; i < n; i++)
            turn(&e[i], k, budget_ms[r->extent], s.ms);
    }
    copy_destroy(copy);
}

static void write_entry(struct report *r, const struct bench_frame *f, const struct psf_job *p, const struct entry *e,
                        double error)
{
    const struct subject *s = &e->subject;
    double low = e->ms[0], high = e->ms[0];
    for (unsigned i = 1; i < e->turns; i++) {
        low = fmin(low, e->ms[i]);
        high = fmax(high, e->ms[i]);
    }
    sheet_row(r->speed, "ssssssddddduss", s->method ? "CPU, 2 threads" : r->device, f->size, p->name, s->name, s->setting,
              s->type == PIXEL_TYPE_HALF ? "half" : "float", error, middle(e->ms, e->turns), low, high,
              middle(e->ratio, e->turns), e->turns, s->method ? "" : s->reply.rule, s->method ? "" : s->reply.plan);
}

static void measure_psf(struct report *r, const struct bench_frame *f, const struct psf_job *p, const double *error)
{
    static struct entry e[SUBJECTS_MAX];
    static struct subject s[SUBJECTS_MAX];
    unsigned n = subjects_all(s);
    const struct blur_job job = psf_blur(p, f->width, f->height, 3, 1, 1, r->team);
    for (unsigned i = 0; i < n; i++) {
        e[i] = (struct entry){ .subject = s[i] };
        if ((r->engine_only && s[i].method) || !(error[i] >= 0) ||
            !(e[i].open = subject_open(&e[i].subject, r, &job)))
            continue;
        subject_load(&e[i].subject, &f->in_float);
    }
    measure_turns(r, f, e, n);
    for (unsigned i = 0; i < n; i++) {
        if (!e[i].open)
            continue;
        write_entry(r, f, p, &e[i], error[i]);
        subject_close(&e[i].subject);
    }
    fflush(r->speed);
}

static void all_errors(struct report *r, const struct psf_job *p, double error[SUBJECTS_MAX])
{
    static const unsigned phases[] = { 1, 2, 8 };
    static struct subject s[SUBJECTS_MAX];
    unsigned n = subjects_all(s);
    for (unsigned i = 0; i < n; i++) {
        error[i] = -1;
        if (r->engine_only && s[i].method)
            continue;
        error[i] = point_error(&s[i], r, p, phases[r->extent]);
        if (error[i] < 0)
            report_note(r, "speed", "%s: cannot do %s", s[i].name, p->name);
    }
}

void report_speed(struct report *r)
{
    static const struct {
        uint32_t width, height;
        enum report_extent least, most;
    } sizes[] = { { 160, 90, EXTENT_TINY, EXTENT_TINY },
                  { 512, 288, EXTENT_QUICK, EXTENT_FULL },
                  { 1920, 1080, EXTENT_QUICK, EXTENT_FULL },
                  { 3840, 2160, EXTENT_FULL, EXTENT_FULL } };
    double error_20[SUBJECTS_MAX], error_j5[SUBJECTS_MAX];
    const struct psf_job sigma20 = psf_sigma20();
    uint32_t known = 0; /* width for which error_j5 is */
    all_errors(r, &sigma20, error_20);
    for (unsigned i = 0; i < sizeof sizes / sizeof sizes[0]; i++) {
        struct bench_frame f;
        if (r->extent < sizes[i].least || r->extent > sizes[i].most)
            continue;
        const struct psf_job j5 = psf_j5(sizes[i].width);
        if (!known || strcmp(j5.name, psf_j5(known).name))
            all_errors(r, &j5, error_j5);
        known = sizes[i].width;
        frame_make(&f, sizes[i].width, sizes[i].height, r->team);
        printf("speed: %s\n", f.size);
        measure_psf(r, &f, &sigma20, error_20);
        measure_psf(r, &f, &j5, error_j5);
        frame_finish(&f);
    }
}

/* ---- shimmer ---------------------------------------------------------------------------------------------------- */

// What the exact Gaussian shows of two neighbours with 1 - f and f: its peak over that of one point.
static double exact_peak(double sigma, double f)
{
    double g1 = exp(-1 / (2 * sigma * sigma));
    return fmax((1 - f) + f * g1, (1 - f) * g1 + f);
}

static void slide(struct report *r, struct subject *s, const struct psf_job *p, unsigned steps)
{
    long reach = (long)ceil(5.5 * p->sigma[0]) + 8;
    uint32_t side = 2 * (uint32_t)reach + 64;
    double norm = 1;
    for (long x = 1; x < 9 * p->sigma[0]; x++)
        norm += 2 * exp(-(double)(x * x) / (2 * p->sigma[0] * p->sigma[0]));
    const struct blur_job job = psf_blur(p, side, side, 1, 0, norm * norm, r->team);
    if (!subject_open(s, r, &job))
        return;
    for (unsigned i = 0; i < steps; i++) {
        uint32_t px = (uint32_t)reach + 16 + i / 8, py = (uint32_t)reach + 21;
        double f = i % 8 / 8., peak = 0, energy = -1;
        subject_point(s, px, py, (float)(1 - f), (float)f);
        subject_run(s);
        for (uint32_t y = 0; y < side; y++) {
            const float *row = subject_row(s, 0, y);
            for (uint32_t x = 0; x < side; x++) {
                double scene = y != py ? 0 : x == px ? 1 - f : x == px + 1 ? f : 0;
                peak = fmax(peak, row[x] - scene);
                energy += row[x];
            }
        }
        sheet_row(r->shimmer, "ssddd", s->name, s->method ? "" : s->setting, i / 8., peak / exact_peak(p->sigma[0], f),
                  energy / (norm * norm));
    }
    subject_close(s);
}

void report_shimmer(struct report *r)
{
    static const unsigned steps[] = { 9, 65, 129 };
    static struct subject s[SUBJECTS_MAX];
    const struct psf_job p = psf_sigma20();
    unsigned n = subjects_all(s);
    printf("shimmer\n");
    for (unsigned i = 0; i < n; i++)
        if (s[i].method || (s[i].type == PIXEL_TYPE_FLOAT && s[i].tolerance > 5e-5))
            slide(r, &s[i], &p, steps[r->extent]);
}
