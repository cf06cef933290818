// SPDX-License-Identifier: Apache-2.0
// method_recursive.c - Young and van Vliet, Signal Processing 44 (1995): a third-order recursion forth and back along each
// axis, float32. Light that the filter carries beyond the far end is kept in cells there, so that coming back it is right.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "method.h"

enum { LANES = 16 };

struct recursive {
    struct blur_job job;
    float b[METHOD_GAUSSIANS_MAX][4]; /* gain and three feedbacks */
    long tail;                        /* cells beyond the end */
    struct grid bright, across;       /* across: with `tail` rows below, of which columns are made */
    float *line[TEAM];                /* a block of rows, turned; or a block of columns */
    const struct planes *in, *out;
};

static void destroy(void *self)
{
    struct recursive *r = self;
    for (unsigned t = 0; t < TEAM; t++)
        free(r->line[t]);
    grid_finish(&r->bright);
    grid_finish(&r->across);
    free(r);
}

static void coefficients(float b[4], double sigma)
{
    double q = sigma >= 2.5 ? .98711 * sigma - .96330 : 3.97156 - 4.14554 * sqrt(1 - .26891 * sigma);
    double b0 = 1.57825 + 2.44413 * q + 1.4281 * q * q + .422205 * q * q * q;
    double b1 = (2.44413 * q + 2.85619 * q * q + 1.26661 * q * q * q) / b0;
    double b2 = -(1.4281 * q * q + 1.26661 * q * q * q) / b0, b3 = .422205 * q * q * q / b0;
    b[0] = (float)(1 - (b1 + b2 + b3));
    b[1] = (float)b1;
    b[2] = (float)b2;
    b[3] = (float)b3;
}

static void *create(const struct blur_job *j)
{
    struct recursive *r = take(1, sizeof(*r));
    long longest = j->width > j->height ? j->width : j->height;
    r->job = *j;
    r->tail = (long)ceil(5 * j->sigma[j->n - 1]);
    for (unsigned i = 0; i < j->n; i++)
        coefficients(r->b[i], j->sigma[i]);
    for (unsigned t = 0; t < TEAM; t++)
        if (posix_memalign((void **)&r->line[t], 64, (size_t)(longest + r->tail + 6) * LANES * sizeof(float)))
            r->line[t] = NULL;
    if (r->line[0] && r->line[1] && grid_init(&r->bright, j->width, j->height, j->channels, LANES) &&
        grid_init(&r->across, j->width, j->height, j->channels, LANES))
        return r;
    destroy(r);
    return NULL;
}

// Both ways over n cells of LANES signals; three cells on each side belong to the caller.
static void recurse(float *v, long n, const float b[4])
{
    memset(v - 3 * LANES, 0, 3 * LANES * sizeof(float));
    for (long x = 0; x < n; x++) {
        float *at = v + x * LANES;
        for (int k = 0; k < LANES; k++)
            at[k] = b[0] * at[k] + b[1] * at[k - LANES] + b[2] * at[k - 2 * LANES] + b[3] * at[k - 3 * LANES];
    }
    memset(v + n * LANES, 0, 3 * LANES * sizeof(float));
    for (long x = n - 1; x >= 0; x--) {
        float *at = v + x * LANES;
        for (int k = 0; k < LANES; k++)
            at[k] = b[0] * at[k] + b[1] * at[k + LANES] + b[2] * at[k + 2 * LANES] + b[3] * at[k + 3 * LANES];
    }
}

static void rows(struct recursive *r, unsigned i, unsigned c, long y, long n, float *v)
{
    long w = r->bright.width;
    for (long k = 0; k < LANES; k++)
        for (long x = 0; x < w; x++)
            v[x * LANES + k] = k < n ? grid_row(&r->bright, c, y + k)[x] : 0;
    memset(v + w * LANES, 0, (size_t)r->tail * LANES * sizeof(float));
    recurse(v, w + r->tail, r->b[i]);
    for (long k = 0; k < n; k++)
        for (long x = 0; x < w; x++)
            grid_row(&r->across, c, y + k)[x] = v[x * LANES + k];
}

static void columns(struct recursive *r, unsigned i, unsigned c, long x, long n, float *v)
{
    long h = r->across.height;
    float weight = (float)r->job.weight[i];
    for (long y = 0; y < h; y++)
        memcpy(v + y * LANES, grid_row(&r->across, c, y) + x, LANES * sizeof(float));
    memset(v + h * LANES, 0, (size_t)r->tail * LANES * sizeof(float));
    recurse(v, h + r->tail, r->b[i]);
    for (long y = 0; y < h; y++) {
        float *out = (float *)planes_row(r->out, c, (uint32_t)y) + x;
        const float *in = i ? out : (const float *)planes_row(r->in, c, (uint32_t)y) + x;
        for (long k = 0; k < n; k++)
            out[k] = in[k] + weight * v[y * LANES + k];
    }
}

static long least(long a, long b) { return a < b ? a : b; }

static void member_run(void *ctx, unsigned member)
{
    struct recursive *r = ctx;
    float *v = r->line[member] + 3 * LANES;
    long first = part_first(r->bright.height, member), last = part_first(r->bright.height, member + 1);
    long blocks = (r->bright.width + LANES - 1) / LANES;
    grid_bright(&r->bright, r->in, r->job.threshold, member);
    for (unsigned i = 0; i < r->job.n; i++) {
        for (unsigned c = 0; c < r->job.channels; c++)
            for (long y = first; y < last; y += LANES)
                rows(r, i, c, y, least(last - y, LANES), v);
        team_meet(r->job.team);
        for (unsigned c = 0; c < r->job.channels; c++)
            for (long k = part_first(blocks, member); k < part_first(blocks, member + 1); k++)
                columns(r, i, c, k * LANES, least(r->bright.width - k * LANES, LANES), v);
        team_meet(r->job.team);
    }
}

static void run(void *self, const struct planes *in, const struct planes *out)
{
    struct recursive *r = self;
    r->in = in;
    r->out = out;
    team_run(r->job.team, member_run, r);
}

const struct method method_recursive = { "recursive (Young-van Vliet)", "third-order recursion forth and back, float32",
                                         create, run, destroy };
