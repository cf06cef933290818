// SPDX-License-Identifier: Apache-2.0
// subject.c - the engine and the methods behind one interface, and the lone point on which both are judged.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "report.h"

static const float LUMA[3] = { .2126f, .7152f, .0722f };
static const double TOLERANCES[] = { 1e-2, 1e-3, 1e-4, 1e-5 };

unsigned subjects_all(struct subject s[SUBJECTS_MAX])
{
    unsigned n = 0;
    for (unsigned type = 0; type < 2; type++)
        for (unsigned t = 0; t < 4; t++, n++) {
            s[n] = (struct subject){ .tolerance = TOLERANCES[t], .type = type ? PIXEL_TYPE_FLOAT : PIXEL_TYPE_HALF };
            snprintf(s[n].name, sizeof s[n].name, "airyd, %s", type ? "float" : "half");
            snprintf(s[n].setting, sizeof s[n].setting, "tolerance %g", TOLERANCES[t]);
        }
    for (unsigned i = 0; i < METHODS; i++, n++) {
        s[n] = (struct subject){ .method = methods[i], .type = PIXEL_TYPE_FLOAT };
        snprintf(s[n].name, sizeof s[n].name, "%s", methods[i]->name);
        snprintf(s[n].setting, sizeof s[n].setting, "%s", methods[i]->how);
    }
    return n;
}

/* ---- life ------------------------------------------------------------------------------------------------------ */

static void set(struct params *p, const char *name, const char *text)
{
    struct fault f;
    if (params_set_text(p, name, text, &f) < 0)
        die("%s: %s", f.field, f.text);
}

static void engine_params(struct subject *s)
{
    char psf[512], number[32];
    int n = snprintf(psf, sizeof psf, "gaussians:sigma=");
    for (unsigned i = 0; i < s->job.n; i++)
        n += snprintf(psf + n, sizeof psf - (size_t)n, "%s%.17g", i ? "/" : "", s->job.sigma[i]);
    // The weights' sum is the intensity, so that the psf's own is 1.
    double sum = 0;
    for (unsigned i = 0; i < s->job.n; i++)
        sum += s->job.weight[i];
    for (unsigned i = 0; i < s->job.n; i++)
        n += snprintf(psf + n, sizeof psf - (size_t)n, "%s%.17g", i ? "/" : ",weight=", s->job.weight[i] / sum);
    params_init(&s->params);
    set(&s->params, "psf", psf);
    snprintf(number, sizeof number, "%.17g", sum);
    set(&s->params, "intensity", number);
    snprintf(number, sizeof number, "%g", s->tolerance);
    set(&s->params, "tolerance", number);
    snprintf(number, sizeof number, "%.9g", (double)s->job.threshold);
    set(&s->params, "threshold", number);
    set(&s->params, "bright", "channel");
}

static void engine_open(struct subject *s, struct report *r)
{
    struct fault f;
    const struct bloom_geometry g = { s->job.width, s->job.height, s->job.channels, s->type, 0, 1 };
    s->engine = r->engine;
    s->slot = bloom_slot(r->engine, s->type == PIXEL_TYPE_HALF);
    engine_params(s);
    if (bloom_slot_prepare(r->engine, s->slot, 1, &g, &s->in, &s->out, &f) < 0)
        die("%s", f.text);
}

bool subject_open(struct subject *s, struct report *r, const struct blur_job *job)
{
    s->job = *job;
    if (s->method && !(s->self = s->method->create(job)))
        return false;
    s->row = take(job->width, sizeof(float));
    if (!s->method)
        engine_open(s, r);
    else if (planes_alloc(&s->in, job->width, job->height, job->channels, s->type) ||
             planes_alloc(&s->out, job->width, job->height, job->channels, s->type))
        die("no memory for %ux%u planes", job->width, job->height);
    return true;
}

void subject_close(struct subject *s)
{
    if (s->method) {
        s->method->destroy(s->self);
        planes_free(&s->in);
        planes_free(&s->out);
    }
    frame_scan_finish(&s->scan);
    free(s->row);
}

/* ---- pixels ---------------------------------------------------------------------------------------------------- */

static void scan(struct subject *s)
{
    const float one[3] = { 1, 0, 0 };
    if (s->method)
        return;
    frame_scan_finish(&s->scan);
    s->scan = (struct frame_scan){ 0 };
    if (frame_scan_init(&s->scan, s->in.width, s->in.height))
        die("no memory for a scan");
    for (uint32_t y = 0; y < s->in.height; y++)
        frame_scan_row(&s->scan, &s->in, y, s->in.count == 1 ? one : LUMA);
}

static void put_row(struct subject *s, unsigned c, uint32_t y, const float *row)
{
    if (s->type == PIXEL_TYPE_HALF)
        float_to_half((uint16_t *)planes_row(&s->in, c, y), row, s->in.width);
    else
        memcpy(planes_row(&s->in, c, y), row, s->in.width * sizeof(float));
}

void subject_load(struct subject *s, const struct planes *from)
{
    for (unsigned c = 0; c < from->count; c++)
        for (uint32_t y = 0; y < from->height; y++)
            put_row(s, c, y, (const float *)planes_row(from, c, y));
    scan(s);
}

void subject_point(struct subject *s, uint32_t x, uint32_t y, float at_x, float at_next)
{
    for (uint32_t row = 0; row < s->in.height; row++)
        memset(planes_row(&s->in, 0, row), 0, s->in.width * (size_t)pixel_bytes(s->type));
    memset(s->row, 0, s->in.width * sizeof(float));
    s->row[x] = at_x;
    s->row[x + 1] = at_next;
    put_row(s, 0, y, s->row);
    scan(s);
}

double subject_run(struct subject *s)
{
    struct bloom_request r = { .params = &s->params, .scan = &s->scan, .source = -1, .matte = -1, .depth = -1,
                               .luma = { 1, 0, 0 }, .pixel_aspect = 1 };
    struct fault f;
    if (s->in.count == 3)
        memcpy(r.luma, LUMA, sizeof r.luma);
    double t0 = now_ms();
    if (s->method)
        s->method->run(s->self, &s->in, &s->out);
    else if (bloom_run(s->engine, s->slot, 0, &r, &s->reply, &f) < 0)
        die("%s: %s", f.field, f.text);
    return now_ms() - t0;
}

const float *subject_row(struct subject *s, unsigned c, uint32_t y)
{
    const struct planes *from = !s->method && s->reply.untouched ? &s->in : &s->out;
    if (s->type == PIXEL_TYPE_HALF)
        half_to_float(s->row, (const uint16_t *)planes_row(from, c, y), from->width);
    else
        memcpy(s->row, planes_row(from, c, y), from->width * sizeof(float));
    return s->row;
}

/* ---- jobs -------------------------------------------------------------------------------------------------------- */

struct psf_job psf_sigma20(void) { return (struct psf_job){ .name = "sigma 20", .n = 1, .sigma = { 20 }, .weight = { 1 } }; }

struct psf_job psf_j5(uint32_t width)
{
    struct psf_job p = { .name = width > 1920 ? "J5, doubled" : "J5", .n = JOB_GAUSSIANS };
    job_sigmas(width, p.sigma);
    for (unsigned i = 0; i < p.n; i++)
        p.weight[i] = .2;
    return p;
}

struct blur_job psf_blur(const struct psf_job *p, uint32_t width, uint32_t height, unsigned channels, float threshold,
                         double gain, struct team *team)
{
    struct blur_job j = { .width = width, .height = height, .channels = channels, .n = p->n, .threshold = threshold,
                          .team = team };
    for (unsigned i = 0; i < p->n; i++) {
        j.sigma[i] = p->sigma[i];
        j.weight[i] = p->weight[i] * gain;
    }
    return j;
}

/* ---- a lone point ---------------------------------------------------------------------------------------------- */

enum { PERIOD = 128 }; /* a multiple of every pyramid's */

struct truth {
    double *g[METHOD_GAUSSIANS_MAX], gain; /* so that the peak is 1: float32 holds it beside the point */
    uint32_t side, base;
};

static void truth_init(struct truth *t, const struct psf_job *p)
{
    long reach = (long)ceil(5.5 * p->sigma[p->n - 1]) + 8;
    double peak = 0;
    t->base = (uint32_t)((reach + PERIOD - 1) / PERIOD * PERIOD);
    t->side = t->base + PERIOD + (uint32_t)reach;
    for (unsigned i = 0; i < p->n; i++) {
        double s2 = 2 * p->sigma[i] * p->sigma[i], norm = 1;
        t->g[i] = take(t->side, sizeof(double));
        for (long x = 1; x < 9 * p->sigma[i]; x++)
            norm += 2 * exp(-(double)(x * x) / s2);
        for (uint32_t x = 0; x < t->side; x++)
            t->g[i][x] = exp(-(double)x * x / s2) / norm;
        peak += p->weight[i] / (norm * norm);
    }
    t->gain = 1 / peak;
}

static double truth_worst(const struct truth *t, const struct psf_job *p, struct subject *s, uint32_t px, uint32_t py)
{
    double worst = 0;
    for (uint32_t y = 0; y < t->side; y++) {
        const float *row = subject_row(s, 0, y);
        for (uint32_t x = 0; x < t->side; x++) {
            double want = x == px && y == py;
            for (unsigned i = 0; i < p->n; i++)
                want += t->gain * p->weight[i] * t->g[i][labs((long)y - (long)py)] * t->g[i][labs((long)x - (long)px)];
            worst = fmax(worst, fabs(row[x] - want));
        }
    }
    return worst;
}

double point_error(struct subject *s, struct report *r, const struct psf_job *p, unsigned phases)
{
    struct truth t;
    double worst = -1;
    truth_init(&t, p);
    const struct blur_job job = psf_blur(p, t.side, t.side, 1, 0, t.gain, r->team);
    if (subject_open(s, r, &job)) {
        for (unsigned i = 0; i < phases; i++) {
            uint32_t step = PERIOD / phases, px = t.base + i * step % PERIOD,
                     py = t.base + ((7 * i + 5) * step + i) % PERIOD;
            subject_point(s, px, py, 1, 0);
            subject_run(s);
            worst = fmax(worst, truth_worst(&t, p, s, px, py));
        }
        subject_close(s);
    }
    for (unsigned i = 0; i < p->n; i++)
        free(t.g[i]);
    return worst;
}
