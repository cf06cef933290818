// SPDX-License-Identifier: Apache-2.0
// method_direct.c - what "a Gaussian blur" is in most programs: separable at full size, cut at 4 sigma, sum 1.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "method.h"

enum { BLOCK = 512 };

struct direct {
    struct blur_job job;
    long radius[METHOD_GAUSSIANS_MAX];
    float *tap[METHOD_GAUSSIANS_MAX];
    struct grid bright, across;
    const struct planes *in, *out;
};

static void destroy(void *self)
{
    struct direct *d = self;
    for (unsigned i = 0; i < METHOD_GAUSSIANS_MAX; i++)
        free(d->tap[i]);
    grid_finish(&d->bright);
    grid_finish(&d->across);
    free(d);
}

static void make_taps(struct direct *d, unsigned i)
{
    double sigma = d->job.sigma[i], sum = 0;
    long r = d->radius[i] = (long)ceil(4 * sigma);
    d->tap[i] = take((size_t)r + 1, sizeof(float));
    for (long k = -r; k <= r; k++)
        sum += exp(-(double)(k * k) / (2 * sigma * sigma));
    for (long k = 0; k <= r; k++)
        d->tap[i][k] = (float)(exp(-(double)(k * k) / (2 * sigma * sigma)) / sum);
}

static void *create(const struct blur_job *j)
{
    struct direct *d = take(1, sizeof(*d));
    long pad = 0;
    d->job = *j;
    for (unsigned i = 0; i < j->n; i++) {
        make_taps(d, i);
        pad = d->radius[i] > pad ? d->radius[i] : pad;
    }
    if (grid_init(&d->bright, j->width, j->height, j->channels, pad) &&
        grid_init(&d->across, j->width, j->height, j->channels, pad))
        return d;
    destroy(d);
    return NULL;
}

// out = gain * the taps over rows (or columns) `step` floats apart.
static void taps(float *restrict out, const float *in, size_t step, const float *tap, long radius, long n)
{
    for (long x = 0; x < n; x++)
        out[x] = tap[0] * in[x];
    for (long k = 1; k <= radius; k++) {
        const float *a = in - k * (long)step, *b = in + k * (long)step;
        for (long x = 0; x < n; x++)
            out[x] += tap[k] * (a[x] + b[x]);
    }
}

static void gaussian_across(struct direct *d, unsigned i, unsigned c, long y)
{
    for (long x = 0; x < d->bright.width; x += BLOCK) {
        long n = d->bright.width - x < BLOCK ? d->bright.width - x : BLOCK;
        taps(grid_row(&d->across, c, y) + x, grid_row(&d->bright, c, y) + x, 1, d->tap[i], d->radius[i], n);
    }
}

static void gaussian_down(struct direct *d, unsigned i, unsigned c, long y)
{
    float sum[BLOCK], weight = (float)d->job.weight[i];
    float *out = (float *)planes_row(d->out, c, (uint32_t)y);
    const float *in = (const float *)planes_row(d->in, c, (uint32_t)y);
    for (long x = 0; x < d->bright.width; x += BLOCK) {
        long n = d->bright.width - x < BLOCK ? d->bright.width - x : BLOCK;
        taps(sum, grid_row(&d->across, c, y) + x, d->across.stride, d->tap[i], d->radius[i], n);
        for (long k = 0; k < n; k++)
            out[x + k] = (i ? out[x + k] : in[x + k]) + weight * sum[k];
    }
}

static void member_run(void *ctx, unsigned member)
{
    struct direct *d = ctx;
    long first = part_first(d->bright.height, member), last = part_first(d->bright.height, member + 1);
    grid_bright(&d->bright, d->in, d->job.threshold, member);
    for (unsigned i = 0; i < d->job.n; i++) {
        for (unsigned c = 0; c < d->job.channels; c++)
            for (long y = first; y < last; y++)
                gaussian_across(d, i, c, y);
        team_meet(d->job.team);
        for (unsigned c = 0; c < d->job.channels; c++)
            for (long y = first; y < last; y++)
                gaussian_down(d, i, c, y);
        team_meet(d->job.team);
    }
}

static void run(void *self, const struct planes *in, const struct planes *out)
{
    struct direct *d = self;
    d->in = in;
    d->out = out;
    team_run(d->job.team, member_run, d);
}

const struct method method_direct = { "direct Gaussian", "separable, full size, cut at 4 sigma", create, run, destroy };
