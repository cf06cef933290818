// SPDX-License-Identifier: Apache-2.0
// pyramid.c - see pyramid.h. Level 0 is the frame; level l has cells of 2^l pixels.
#include "pyramid.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { PAD = 12 };

struct level {
    struct grid down, glow, spare; /* spare: for passes */
    float weight;                  /* of `down` in the glow */
    struct stencil pass[PYRAMID_PASSES];
    unsigned passes;
};

struct pyramid {
    struct team *team;
    unsigned channels, levels; /* the coarsest */
    float threshold;
    struct level level[PYRAMID_LEVELS_MAX + 1];
    struct stencil down, up[2][2]; /* up: by the parity of y and x */
    float *line[TEAM];             /* two rows */
    const struct planes *in, *out;
};

/* ---- stencils ------------------------------------------------------------------------------------------------ */

static void stencil_tap(struct stencil *s, int dx, int dy, double w)
{
    unsigned i = 0;
    while (i < s->n && (s->tap[i].dx != dx || s->tap[i].dy != dy))
        i++;
    if (w == 0)
        return;
    if (i == STENCIL_MAX)
        die("a stencil of more than %d taps", STENCIL_MAX);
    if (i == s->n) {
        s->n++;
        s->tap[i].dx = dx;
        s->tap[i].dy = dy;
        s->tap[i].w = 0;
    }
    s->tap[i].w += (float)w;
}

void stencil_sample(struct stencil *s, double x, double y, double weight)
{
    double fx = floor(x), fy = floor(y), a = x - fx, b = y - fy;
    int dx = (int)fx, dy = (int)fy;
    stencil_tap(s, dx, dy, weight * (1 - a) * (1 - b));
    stencil_tap(s, dx + 1, dy, weight * a * (1 - b));
    stencil_tap(s, dx, dy + 1, weight * (1 - a) * b);
    stencil_tap(s, dx + 1, dy + 1, weight * a * b);
}

// The second moment along x about `centre`, in pixels of what is read.
static double moment(const struct stencil *s, double centre)
{
    double sum = 0;
    for (unsigned i = 0; i < s->n; i++)
        sum += s->tap[i].w * (s->tap[i].dx - centre) * (s->tap[i].dx - centre);
    return sum;
}

static void up_stencils(const struct pyramid_filters *f, struct stencil up[2][2], double offset)
{
    for (int y = 0; y < 2; y++)
        for (int x = 0; x < 2; x++) {
            up[y][x].n = 0;
            f->up(&up[y][x], x ? .25 : -.25, y ? .25 : -.25, offset);
        }
}

// What one octave adds to the variance, in pixels of its finer side: about the pixel's centre the filter up reads
// at -+ 1/4 of a coarse cell.
static double octave(const struct pyramid_filters *f, const struct stencil *down, double offset)
{
    struct stencil up[2][2];
    up_stencils(f, up, offset);
    return moment(down, .5) + 2 * (moment(&up[0][0], -.25) + moment(&up[0][1], .25));
}

static double spread(unsigned level, double octave_variance)
{
    return (ldexp(1, 2 * (int)level) - 1) / 3 * octave_variance;
}

/* ---- fits ----------------------------------------------------------------------------------------------------- */

static unsigned nearest_level(double sigma, double octave_variance)
{
    unsigned best = 1;
    for (unsigned l = 1; l <= PYRAMID_LEVELS_MAX; l++)
        if (fabs(log(spread(l, octave_variance) / (sigma * sigma))) <
            fabs(log(spread(best, octave_variance) / (sigma * sigma))))
            best = l;
    return best;
}

static bool fit_offset(struct pyramid *p, const struct blur_job *j, const struct pyramid_filters *f, double *offset)
{
    double widest = j->sigma[j->n - 1], low = 0, high = 3;
    unsigned top = nearest_level(widest, octave(f, &p->down, 1));
    for (unsigned i = 0; i < 60; i++) {
        *offset = (low + high) / 2;
        *(spread(top, octave(f, &p->down, *offset)) < widest * widest ? &low : &high) = *offset;
    }
    for (unsigned i = 0; i < j->n; i++) {
        long level = (long)top - lround(log2(widest / j->sigma[i]));
        if (level < 1)
            return false;
        p->level[level].weight += (float)j->weight[i];
    }
    p->levels = top;
    return true;
}

static bool fit_mix(struct pyramid *p, const struct blur_job *j, double octave_variance)
{
    for (unsigned i = 0; i < j->n; i++) {
        double variance = j->sigma[i] * j->sigma[i];
        unsigned l = 1;
        while (l < PYRAMID_LEVELS_MAX && spread(l + 1, octave_variance) <= variance)
            l++;
        double low = spread(l, octave_variance), high = spread(l + 1, octave_variance);
        if (variance < low || variance >= high || l == PYRAMID_LEVELS_MAX)
            return false;
        double far = (variance - low) / (high - low);
        p->level[l].weight += (float)(j->weight[i] * (1 - far));
        p->level[l + 1].weight += (float)(j->weight[i] * far);
        p->levels = l + 1 > p->levels ? l + 1 : p->levels;
    }
    return true;
}

static double pass_variance(const struct pyramid_filters *f, struct stencil s[PYRAMID_PASSES], double offset)
{
    double sum = 0;
    for (unsigned i = 0; i < PYRAMID_PASSES; i++) {
        s[i].n = 0;
        f->pass(&s[i], i, offset);
        sum += moment(&s[i], 0);
    }
    return sum;
}

static bool fit_passes(struct pyramid *p, const struct blur_job *j, const struct pyramid_filters *f,
                       double octave_variance)
{
    for (unsigned i = 0; i < j->n; i++) {
        unsigned l = 0;
        while (ldexp(j->sigma[i], -(int)l) > 3.4)
            l++;
        struct level *at = &p->level[l];
        double want = (j->sigma[i] * j->sigma[i] - spread(l, octave_variance)) * ldexp(1, -2 * (int)l);
        double low = 0, high = 3;
        for (unsigned k = 0; k < 60; k++) {
            double offset = (low + high) / 2;
            *(pass_variance(f, at->pass, offset) < want ? &low : &high) = offset;
        }
        if (l < 1 || l > PYRAMID_LEVELS_MAX || at->passes || fabs(pass_variance(f, at->pass, low) - want) > 1e-3 * want)
            return false;
        at->passes = PYRAMID_PASSES;
        at->weight = (float)j->weight[i];
        p->levels = l > p->levels ? l : p->levels;
    }
    return true;
}

static bool fit(struct pyramid *p, const struct blur_job *j, const struct pyramid_filters *f)
{
    double offset = 1;
    f->down(&p->down);
    double plain = f->fit == FIT_OFFSET ? 0 : octave(f, &p->down, offset);
    if (f->fit == FIT_OFFSET ? !fit_offset(p, j, f, &offset)
                             : f->fit == FIT_MIX ? !fit_mix(p, j, plain) : !fit_passes(p, j, f, plain))
        return false;
    up_stencils(f, p->up, offset);
    return true;
}

/* ---- life ------------------------------------------------------------------------------------------------------ */

void *pyramid_create(const struct blur_job *j, const struct pyramid_filters *f)
{
    struct pyramid *p = take(1, sizeof(*p));
    long w = j->width, h = j->height;
    *p = (struct pyramid){ .team = j->team, .channels = j->channels, .threshold = j->threshold };
    if (!fit(p, j, f))
        goto fail;
    for (unsigned l = 0; l <= p->levels; l++, w = (w + 1) / 2, h = (h + 1) / 2) {
        struct level *v = &p->level[l];
        if (!grid_init(&v->down, w, h, j->channels, PAD) || (l && !grid_init(&v->glow, w, h, j->channels, PAD)) ||
            (v->passes && !grid_init(&v->spare, w, h, j->channels, PAD)))
            goto fail;
    }
    for (unsigned t = 0; t < TEAM; t++)
        p->line[t] = take(2 * (j->width + 64), sizeof(float));
    return p;
fail:
    pyramid_destroy(p);
    return NULL;
}

void pyramid_destroy(void *self)
{
    struct pyramid *p = self;
    for (unsigned l = 0; l <= PYRAMID_LEVELS_MAX; l++) {
        grid_finish(&p->level[l].down);
        grid_finish(&p->level[l].glow);
        grid_finish(&p->level[l].spare);
    }
    for (unsigned t = 0; t < TEAM; t++)
        free(p->line[t]);
    free(p);
}

/* ---- run ------------------------------------------------------------------------------------------------------- */

enum { BLOCK = 256 }; /* of a row, in the first-level cache */

// Four taps at a time: fewer trips of the sum to memory. A stencil's rest is filled with taps of 0.
static void taps_1(float *restrict out, const float *const *in, const float *restrict w, unsigned n, long first, long last)
{
    for (unsigned i = 0; i < n; i += 4) {
        const float *a = in[i], *b = in[i + 1], *c = in[i + 2], *d = in[i + 3];
        for (long x = first; x < last; x++)
            out[x] += w[i] * a[x] + w[i + 1] * b[x] + w[i + 2] * c[x] + w[i + 3] * d[x];
    }
}

static void taps_2(float *restrict out, const float *const *in, const float *restrict w, unsigned n, long first, long last)
{
    for (unsigned i = 0; i < n; i += 4) {
        const float *a = in[i], *b = in[i + 1], *c = in[i + 2], *d = in[i + 3];
        for (long x = first; x < last; x++)
            out[x] += w[i] * a[2 * x] + w[i + 1] * b[2 * x] + w[i + 2] * c[2 * x] + w[i + 3] * d[2 * x];
    }
}

static void stencil_row(float *out, const struct grid *g, unsigned c, long y, long step, const struct stencil *s, long n)
{
    const float *in[STENCIL_MAX + 3];
    float w[STENCIL_MAX + 3];
    for (unsigned i = 0; i < s->n + 3; i++) {
        const unsigned k = i < s->n ? i : 0;
        in[i] = grid_row(g, c, y + s->tap[k].dy) + s->tap[k].dx;
        w[i] = i < s->n ? s->tap[k].w : 0;
    }
    memset(out, 0, (size_t)n * sizeof(float));
    for (long x = 0; x < n; x += BLOCK)
        (step == 1 ? taps_1 : taps_2)(out, in, w, s->n, x, x + BLOCK < n ? x + BLOCK : n);
}

static void pass_down(struct pyramid *p, unsigned l, unsigned member)
{
    const struct grid *from = &p->level[l - 1].down, *g = &p->level[l].down;
    for (unsigned c = 0; c < p->channels; c++)
        for (long y = part_first(g->height, member); y < part_first(g->height, member + 1); y++)
            stencil_row(grid_row(g, c, y), from, c, 2 * y, 2, &p->down, g->width);
}

static void pass_at(struct pyramid *p, const struct grid *from, const struct grid *to, const struct stencil *s,
                    unsigned member)
{
    for (unsigned c = 0; c < p->channels; c++)
        for (long y = part_first(to->height, member); y < part_first(to->height, member + 1); y++)
            stencil_row(grid_row(to, c, y), from, c, y, 1, s, to->width);
}

// Three passes: down -> spare -> glow -> spare.
static void level_passes(struct pyramid *p, unsigned l, unsigned member)
{
    struct level *v = &p->level[l];
    const struct grid *from = &v->down;
    for (unsigned i = 0; i < v->passes; i++) {
        const struct grid *to = i % 2 ? &v->glow : &v->spare;
        pass_at(p, from, to, &v->pass[i], member);
        team_meet(p->team);
        from = to;
    }
}

static void up_row(struct pyramid *p, float *restrict out, const float *restrict base, float weight,
                   const struct grid *from, unsigned c, long y, long n, unsigned member)
{
    float *restrict even = p->line[member], *restrict odd = even + n / 2 + 32;
    stencil_row(even, from, c, y / 2, 1, &p->up[y % 2][0], (n + 1) / 2);
    stencil_row(odd, from, c, y / 2, 1, &p->up[y % 2][1], n / 2);
    for (long x = 0; x < n / 2; x++) {
        out[2 * x] = weight * base[2 * x] + even[x];
        out[2 * x + 1] = weight * base[2 * x + 1] + odd[x];
    }
    if (n % 2)
        out[n - 1] = weight * base[n - 1] + even[n / 2];
}

static void glow_only(struct pyramid *p, unsigned l, unsigned member)
{
    const struct level *v = &p->level[l];
    const struct grid *own = v->passes ? &v->spare : &v->down;
    for (unsigned c = 0; c < p->channels; c++)
        for (long y = part_first(own->height, member); y < part_first(own->height, member + 1); y++)
            for (long x = 0; x < own->width; x++)
                grid_row(&v->glow, c, y)[x] = v->weight * grid_row(own, c, y)[x];
}

static void pass_up(struct pyramid *p, unsigned l, unsigned member)
{
    const struct level *v = &p->level[l];
    const struct grid *own = v->passes ? &v->spare : &v->down, *from = &p->level[l + 1].glow;
    for (unsigned c = 0; c < p->channels; c++)
        for (long y = part_first(own->height, member); y < part_first(own->height, member + 1); y++)
            up_row(p, grid_row(&v->glow, c, y), grid_row(own, c, y), v->weight, from, c, y, own->width, member);
}

static void pass_add(struct pyramid *p, unsigned member)
{
    const struct grid *from = &p->level[1].glow;
    long w = p->level[0].down.width, h = p->level[0].down.height;
    for (unsigned c = 0; c < p->channels; c++)
        for (long y = part_first(h, member); y < part_first(h, member + 1); y++)
            up_row(p, (float *)planes_row(p->out, c, (uint32_t)y), (const float *)planes_row(p->in, c, (uint32_t)y), 1,
                   from, c, y, w, member);
}

static void member_run(void *ctx, unsigned member)
{
    struct pyramid *p = ctx;
    grid_bright(&p->level[0].down, p->in, p->threshold, member);
    for (unsigned l = 1; l <= p->levels; l++) {
        team_meet(p->team);
        pass_down(p, l, member);
    }
    team_meet(p->team);
    for (unsigned l = 1; l <= p->levels; l++)
        level_passes(p, l, member);
    glow_only(p, p->levels, member);
    for (unsigned l = p->levels - 1; l > 0; l--) {
        team_meet(p->team);
        pass_up(p, l, member);
    }
    team_meet(p->team);
    pass_add(p, member);
}

void pyramid_run(void *self, const struct planes *in, const struct planes *out)
{
    struct pyramid *p = self;
    p->in = in;
    p->out = out;
    team_run(p->team, member_run, p);
}
