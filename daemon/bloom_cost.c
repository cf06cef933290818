// SPDX-License-Identifier: Apache-2.0
// bloom_cost.c - what a frame costs on this device, from three small frames at its start: a tiny one tells the fixed part,
// two plans of known arithmetic on a larger one tell the slope. Good to some 30 %: enough to choose a plan for a time.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "bloom_internal.h"

enum { SIDE = 384, TURNS = 3 };

// The least of a few turns: what disturbs only ever adds.
static int time_one(struct bloom *b, uint32_t side, const char *psf, double tolerance, double *ms, double *cost, struct fault *f)
{
    struct params p;
    struct planes in, out[BLOOM_OUTPUTS_MAX];
    struct frame_scan scan;
    struct bloom_reply reply;
    const struct bloom_geometry g = { side, side, 3, PIXEL_TYPE_HALF, 0, 1 };
    params_init(&p);
    p.tolerance = tolerance;
    if (params_set_text(&p, "psf", psf, f) < 0 || bloom_slot_prepare(b, &b->slot[0], 1, &g, &in, out, f) < 0)
        return -1;
    if (frame_scan_init(&scan, side, side) < 0)
        return fault_set(f, FAULT_NO_MEMORY, "", "out of memory for the first frames");
    const uint16_t four = 0x4400;
    struct bloom_request request = { .params = &p, .scan = &scan, .source = -1, .matte = -1, .depth = -1,
                                     .luma = { 0.25f, 0.5f, 0.25f }, .pixel_aspect = 1 };
    for (uint32_t y = 0; y < side; y++) {
        for (unsigned c = 0; c < 3; c++)
            for (uint32_t x = 0; x < side; x++)
                memcpy(planes_row(&in, c, y) + 2 * x, &four, 2);
        frame_scan_row(&scan, &in, y, request.luma);
    }
    int r = 0;
    *ms = INFINITY;
    for (unsigned i = 0; r == 0 && i <= TURNS; i++) {
        r = bloom_run(b, &b->slot[0], 0, &request, &reply, f);
        if (r == 0 && i > 0) // the first turn makes pipelines and pages
            *ms = fmin(*ms, reply.device_ms);
    }
    *cost = b->plan ? b->plan->cost : 0;
    frame_scan_finish(&scan);
    return r;
}

int cost_measure(struct bloom *b, struct fault *f)
{
    // The same passes but for the Gaussians: at the coarse level almost free, at full size 2 x 25 taps.
    static const char cheap[] = "gaussians:sigma=4/7/12/24,weight=.2", dear[] = "gaussians:sigma=1.8/4,weight=.2";
    double fixed, base, more, cost0, cost1, ignored;
    if (time_one(b, 16, cheap, 1e-3, &fixed, &ignored, f) < 0 || time_one(b, SIDE, cheap, 1e-3, &base, &cost0, f) < 0 ||
        time_one(b, SIDE, dear, 1e-3, &more, &cost1, f) < 0)
        return -1;
    const double samples = 3.0 * SIDE * SIDE;
    struct cost_model *m = &b->cost;
    m->fixed_ms = fixed;
    m->mac_ns = fmax(0, more - base) * 1e6 / samples / fmax(cost1 - cost0, 1);
    m->base_ns = fmax(0, base - fixed) * 1e6 / samples - m->mac_ns * cost0;
    if (m->base_ns < 0) { // noise: all of it on the arithmetic
        m->base_ns = 0;
        m->mac_ns = fmax(0, base - fixed) * 1e6 / samples / fmax(cost0, 1);
    }
    return 0;
}

double cost_predict(const struct bloom *b, const struct plan *p, const struct bloom_geometry *g)
{
    const double samples = ((double)g->width + 2.0 * g->grow) * ((double)g->height + 2.0 * g->grow) * g->channels;
    return b->cost.fixed_ms + samples * (b->cost.base_ns + b->cost.mac_ns * p->cost) * 1e-6;
}
