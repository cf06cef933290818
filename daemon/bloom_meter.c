// SPDX-License-Identifier: Apache-2.0
// bloom_meter.c - exposure=auto (METHODS section 1): a histogram on the device, read on the host, before the frame's own passes.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "bloom_internal.h"

enum { BINS = 256 };
static const double BIN_LOW = -16, BIN_STOPS = 0.125;

// Takes `share` of `total` away from one end.
static void cut(double *count, int from, int step, double amount)
{
    for (int i = from; i >= 0 && i < BINS && amount > 0; i += step) {
        const double taken = fmin(count[i], amount);
        count[i] -= taken;
        amount -= taken;
    }
}

static double stops_of(const uint32_t *bins, const struct params *p)
{
    double count[BINS], total = 0, left = 0, sum = 0;
    for (int i = 0; i < BINS; i++) {
        count[i] = bins[i];
        total += count[i];
    }
    cut(count, 0, 1, total * p->meter_dark / 100);
    cut(count, BINS - 1, -1, total * p->meter_bright / 100);
    for (int i = 0; i < BINS; i++) {
        left += count[i];
        sum += count[i] * exp2(BIN_LOW + (i + 0.5) * BIN_STOPS);
    }
    if (!(left > 0))
        return 0;
    return fmin(fmax(log2(p->key / (sum / left)), -32), 32);
}

int meter_exposure(struct frame *fr, double *stops)
{
    struct bloom *b = fr->b;
    struct slot_target *t = fr->target;
    struct vk_draw d = { 0 };
    d.pipeline = pipeline_get(b, fr->f, 0, "histogram_c%u%s", t->geometry.channels,
                              t->geometry.type == PIXEL_TYPE_HALF ? "_half" : "");
    if (!d.pipeline || vk_buffer_reserve(&b->vk, &b->counts, BINS * 4,
                                         VK_BUFFER_USAGE_STORAGE_BUFFER_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT, fr->f) < 0 ||
        record_begin(fr) < 0)
        return -1;
    pass_begin(fr, &d);
    for (unsigned c = 0; c < VK_PLANES; c++)
        d.in[c] = &t->in[c < t->geometry.channels ? c : 0];
    // What was grown around the window is 0, and 0 is not counted.
    vk_dispatch(&b->commands, &d, &b->counts, (t->texels + 7) / 8, (t->height + 7) / 8);
    if (vk_submit_and_wait(&b->commands, fr->f) < 0)
        return -1;
    *stops = stops_of((const uint32_t *)(const void *)b->counts.memory.map, fr->params);
    return 0;
}
