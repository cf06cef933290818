// SPDX-License-Identifier: Apache-2.0
// bloom_selftest.c - at start: a small frame through the real passes, compared with numbers worked out on the CPU.
// It catches drivers that take everything and do nothing (a JIT without executable memory, say), and its draws
// make the driver compile the passes that common requests use before the first client waits for them.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "bloom_internal.h"

enum { SIZE = 48 };

/* Lone points of light, so that the right answer is a sum of a few Gaussians in closed form. */
static const struct { int x, y; float value; } points[] = { { 7, 11, 9.0f }, { 30, 40, 3.0f }, { 47, 0, 17.0f } };
enum { POINTS = sizeof(points) / sizeof(points[0]) };

static double normal(double sigma)
{
    double n = 1;
    for (int x = 1; x < 10 * sigma + 1; x++)
        n += 2 * exp(-(double)x * x / (2 * sigma * sigma));
    return n;
}

/* What each point's light becomes at a pixel. */
static void spread_at(const struct params *p, const double *norm, int x, int y, double spread[POINTS])
{
    for (unsigned i = 0; i < POINTS; i++) {
        const double dx = x - points[i].x, dy = y - points[i].y;
        spread[i] = 0;
        for (unsigned g = 0; g < p->psf_spec.count; g++) {
            const double s = p->psf_spec.gaussian[g].sigma.value;
            spread[i] += p->psf_spec.gaussian[g].weight * exp(-(dx * dx + dy * dy) / (2 * s * s)) / (norm[g] * norm[g]);
        }
    }
}

static void put(const struct planes *in, unsigned c, int x, int y, float v)
{
    uint8_t *row = planes_row(in, c, (uint32_t)y);
    if (in->type == PIXEL_TYPE_FLOAT) {
        memcpy(row + 4 * x, &v, 4);
        return;
    }
    uint16_t h;
    float_to_half(&h, &v, 1);
    memcpy(row + 2 * x, &h, 2);
}

static float get(const struct planes *out, unsigned c, int x, int y)
{
    const uint8_t *row = planes_row(out, c, (uint32_t)y);
    float v;
    if (out->type == PIXEL_TYPE_FLOAT) {
        memcpy(&v, row + 4 * x, 4);
        return v;
    }
    uint16_t h;
    memcpy(&h, row + 2 * x, 2);
    half_to_float(&v, &h, 1);
    return v;
}

static int compare(const struct planes *out, const struct params *p, const struct bloom_reply *reply,
                   struct fault *f)
{
    double brightest = 0;
    for (unsigned i = 0; i < POINTS; i++)
        brightest = fmax(brightest, points[i].value * out->count);
    const double half = out->type == PIXEL_TYPE_HALF ? 0x1p-11 : 0x1p-23;
    double norm[PARAMS_GAUSSIANS_MAX], spread[POINTS];
    for (unsigned g = 0; g < p->psf_spec.count; g++)
        norm[g] = normal(p->psf_spec.gaussian[g].sigma.value);
    for (int y = 0; y < SIZE; y++)
        for (int x = 0; x < SIZE; x++) {
            spread_at(p, norm, x, y, spread);
            for (unsigned c = 0; c < out->count; c++) {
                double want = 0;
                for (unsigned i = 0; i < POINTS; i++) {
                    const double light = points[i].value * (c + 1);
                    want += (light - p->threshold) * spread[i] + (points[i].x == x && points[i].y == y ? light : 0);
                }
                const double got = get(out, c, x, y);
                if (!(fabs(got - want) <= reply->error_bound * brightest + want * half + 0x1p-24))
                    return fault_set(f, FAULT_INTERNAL, "device",
                                     "self-test: pixel %d,%d channel %u is %.9g, %.9g expected (bound %.3g): "
                                     "this device does not compute what it is told",
                                     x, y, c, got, want, reply->error_bound * brightest);
            }
        }
    return 0;
}

/* What a small frame of the start is to show. */
struct trial {
    struct bloom_geometry geometry;
    enum bright_curve curve;
    const char *psf;
    double tolerance;
    bool points; /* lone points whose glow is compared; else a column of lamps, for the sake of the draws: drivers compile
                    a pipeline when it first draws */
};

static void paint(const struct trial *t, const struct planes *in)
{
    for (unsigned c = 0; c < in->count; c++) {
        for (uint32_t y = 0; y < in->height; y++) {
            memset(planes_row(in, c, y), 0, (size_t)in->width * pixel_bytes(in->type));
            if (!t->points)
                put(in, c, 1, (int)y, 9);
        }
        for (unsigned i = 0; t->points && i < POINTS; i++)
            put(in, c, points[i].x, points[i].y, points[i].value * (float)(c + 1));
    }
}

static int run_trial(struct bloom *b, struct bloom_slot *s, const struct trial *t, struct fault *f)
{
    struct params p;
    struct planes in, out[BLOOM_OUTPUTS_MAX];
    struct frame_scan scan;
    struct bloom_reply reply;
    params_init(&p);
    p.bright = (int)t->curve;
    p.threshold = 1;
    p.tolerance = t->tolerance;
    if (params_set_text(&p, "psf", t->psf, f) < 0 ||
        bloom_slot_prepare(b, s, 1, &t->geometry, &in, out, f) < 0)
        return -1;
    if (frame_scan_init(&scan, in.width, in.height) < 0)
        return fault_set(f, FAULT_NO_MEMORY, "", "out of memory for the self-test");
    struct bloom_request request = { .params = &p, .scan = &scan, .source = -1, .matte = -1, .depth = -1,
                                     .luma = { 0.25f, 0.5f, 0.25f }, .pixel_aspect = 1 };
    paint(t, &in);
    for (uint32_t y = 0; y < in.height; y++)
        frame_scan_row(&scan, &in, y, request.luma);
    int r = bloom_run(b, s, 0, &request, &reply, f);
    if (r == 0 && t->points)
        r = compare(&out[0], &p, &reply, f);
    frame_scan_finish(&scan);
    return r;
}

static int one(struct bloom *b, unsigned channels, enum pixel_type type, const char *psf, double tolerance, struct fault *f)
{
    const struct trial t = { { SIZE, SIZE, channels, type, 0, 1 }, BRIGHT_CHANNEL, psf, tolerance, true };
    return run_trial(b, &b->slot[0], &t, f);
}

static int warm(struct bloom *b, struct bloom_slot *s, const struct bloom_geometry *g, enum bright_curve curve,
                const char *psf, double tolerance, struct fault *f)
{
    const struct trial t = { *g, curve, psf, tolerance, false };
    return run_trial(b, s, &t, f);
}

// The first octave's order, and none, decides the bright pass and the composite.
static const struct warm_plan { const char *psf; double tolerance; } plans[] = {
    { "gaussians:sigma=30,weight=1", 1e-2 },         // b4 first
    { "gaussians:sigma=4/8/20,weight=.3", 1e-3 },    // b6 first
    { "gaussians:sigma=8/16/17,weight=.3", 1e-4 },   // b8 first
    { "gaussians:sigma=1/1.8/3/6,weight=.2", 1e-5 }, // full size
};
// These ask for the reaches and octaves that are left; tests/test_engine.c counts that none is.
static const struct warm_plan rest[] = {
    { "gaussians:sigma=1/30,weight=.5", 1e-2 },
    { "gaussians:sigma=1/1.2/2.7/2.75,weight=.2", 1e-2 },
    { "gaussians:sigma=2.5/2.6,weight=.5", 1e-3 },
    { "gaussians:sigma=4/7/32/33/60/61,weight=.1", 1e-5 },
    { "gaussians:sigma=4/59,weight=1", 1e-5 },
};
enum { PLANS = sizeof(plans) / sizeof(plans[0]), REST = sizeof(rest) / sizeof(rest[0]), CURVES = BRIGHT_SMOOTHSTEP + 1 };

bool bloom_warm_next(struct bloom *b, struct fault *f)
{
    const unsigned step = b->warmed++;
    struct bloom_geometry g = { 4, 4, 3, PIXEL_TYPE_HALF, 0, 1 };
    const struct warm_plan *p = rest;
    enum bright_curve curve = BRIGHT_KNEE;
    *f = (struct fault){ .code = FAULT_NONE };
    if (step >= REST + PLANS * 4 * CURVES)
        return false;
    if (step < REST) {
        p = &rest[step];
    } else {
        const unsigned n = step - REST;
        curve = (enum bright_curve)(n % CURVES);
        g.type = n / CURVES % 2 ? PIXEL_TYPE_FLOAT : PIXEL_TYPE_HALF;
        g.channels = n / CURVES / 2 % 2 ? 3 : 1;
        p = &plans[n / CURVES / 4];
    }
    return warm(b, &b->warm_slot, &g, curve, p->psf, p->tolerance, f) == 0;
}

static int warm_all(struct bloom *b, struct fault *f)
{
    while (bloom_warm_next(b, f))
        ;
    return f->code == FAULT_NONE ? 0 : -1;
}

int bloom_self_test(struct bloom *b, bool all, struct fault *f)
{
    // Levels 1 to 3 at the rules of 1e-2 and 1e-3, and a small sigma at full size.
    static const char wide[] = "gaussians:sigma=4/7/12/24,weight=.2/.2/.2/.2";
    static const char fine[] = "gaussians:sigma=1.8/5,weight=.5/.2";
    if (one(b, 3, PIXEL_TYPE_HALF, wide, 1e-3, f) < 0 || one(b, 3, PIXEL_TYPE_FLOAT, wide, 1e-3, f) < 0 ||
        one(b, 1, PIXEL_TYPE_FLOAT, wide, 1e-2, f) < 0 || one(b, 3, PIXEL_TYPE_HALF, fine, 1e-3, f) < 0)
        return -1;
    // The default curve at the default look's first octave.
    for (int type = PIXEL_TYPE_HALF; type <= PIXEL_TYPE_FLOAT; type++) {
        const struct bloom_geometry g = { 4, 4, 3, (enum pixel_type)type, 0, 1 };
        if (warm(b, &b->slot[0], &g, BRIGHT_KNEE, wide, 1e-3, f) < 0)
            return -1;
    }
    return all ? warm_all(b, f) : 0;
}
