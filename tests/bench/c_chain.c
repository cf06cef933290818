// SPDX-License-Identifier: Apache-2.0
// c_chain.c - see c_chain.h. A level has its cells 0..n-1, one apron cell on each side (light that the
// filters carry out, and back in on the way up), and zeros beyond for the kernels to read.
#include "c_chain.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { LEVELS_MAX = 8, HALF = 6, PAD = 8, PAD_X = 32 };

struct grid {
    long width, height; /* cells inside */
    size_t stride;
    float *memory;
};

struct level {
    struct grid down, across, glow; /* each with 3 planes */
    bool blurred;
    float tap[HALF + 1], weight;
};

struct c_chain {
    long width, height;
    unsigned levels;
    struct level level[LEVELS_MAX]; /* [0]: half size */
    float *line[TEAM], *none;       /* a row and its pads; a row of zeros */
    struct team *team;
    const struct planes *in, *out;
    float threshold, intensity;
};

static float *row(const struct grid *g, unsigned c, long y)
{
    return g->memory + ((size_t)c * (size_t)(g->height + 2 * PAD) + (size_t)(y + PAD)) * g->stride +
           PAD_X;
}

static bool grid_init(struct grid *g, long width, long height)
{
    *g = (struct grid){ width, height, ((size_t)width + 2 * PAD_X + 15) / 16 * 16, NULL };
    size_t bytes = g->stride * (size_t)(height + 2 * PAD) * 3 * sizeof(float);
    if (posix_memalign((void **)&g->memory, 64, bytes))
        return false;
    memset(g->memory, 0, bytes);
    return true;
}

// A pair of octaves' filters adds 1.5 * 4^i: what is left of the variance is the kernel's.
static bool level_set(struct level *l, unsigned level, double sigma, double weight)
{
    double m2 = ldexp(1, 2 * (int)level), variance = (sigma * sigma - .5 * (m2 - 1)) / m2, sum = 0;
    if (variance <= 0 || HALF < 3 * sqrt(variance))
        return false;
    double tap[HALF + 1];
    for (int i = 0; i <= HALF; i++) {
        tap[i] = exp(-i * i / (2 * variance));
        sum += i ? 2 * tap[i] : tap[i];
    }
    for (int i = 0; i <= HALF; i++)
        l->tap[i] = (float)(tap[i] / sum);
    l->blurred = true;
    l->weight = (float)weight;
    return true;
}

struct c_chain *c_chain_create(unsigned width, unsigned height, const double *sigma,
                               const double *weight, unsigned n, struct team *team)
{
    struct c_chain *c = calloc(1, sizeof(*c));
    if (!c)
        return NULL;
    *c = (struct c_chain){ .width = (long)width, .height = (long)height, .team = team };
    for (unsigned i = 0; i < n; i++) {
        unsigned level = (unsigned)lrint(log2(sigma[i])) - 1;
        if (!(sigma[i] >= 4) || level > LEVELS_MAX || ldexp(2, (int)level) != sigma[i] ||
            c->level[level - 1].blurred || !level_set(&c->level[level - 1], level, sigma[i], weight[i]))
            goto fail;
        c->levels = level > c->levels ? level : c->levels;
    }
    long w = c->width, h = c->height;
    for (unsigned i = 0; i < c->levels; i++) {
        w = (w + 1) / 2;
        h = (h + 1) / 2;
        if (!grid_init(&c->level[i].down, w, h) || !grid_init(&c->level[i].across, w, h) ||
            !grid_init(&c->level[i].glow, w, h))
            goto fail;
    }
    for (unsigned t = 0; t < TEAM; t++)
        if (!(c->line[t] = calloc((size_t)width + 2 * PAD_X, sizeof(float))))
            goto fail;
    if ((c->none = calloc((size_t)width, sizeof(float))))
        return c;
fail:
    c_chain_destroy(c);
    return NULL;
}

void c_chain_destroy(struct c_chain *c)
{
    if (!c)
        return;
    for (unsigned i = 0; i < LEVELS_MAX; i++) {
        free(c->level[i].down.memory);
        free(c->level[i].across.memory);
        free(c->level[i].glow.memory);
    }
    for (unsigned t = 0; t < TEAM; t++)
        free(c->line[t]);
    free(c->none);
    free(c);
}

/* ---- rows ---------------------------------------------------------------------------------------- */

static float above(float v, float t) { return v > t ? v - t : 0; }

static void bright_rows(float *restrict out, const float *a, const float *b, const float *c,
                        const float *d, float t, long n)
{
    for (long x = 0; x < n; x++)
        out[x] = .125f * (above(a[x], t) + above(d[x], t)) + .375f * (above(b[x], t) + above(c[x], t));
}

static void four_rows(float *restrict out, const float *a, const float *b, const float *c,
                      const float *d, long n)
{
    for (long x = -PAD; x < n + PAD; x++)
        out[x] = .125f * (a[x] + d[x]) + .375f * (b[x] + c[x]);
}

static void half_row(float *restrict out, const float *restrict in, long n)
{
    for (long x = -1; x <= n; x++)
        out[x] = .125f * (in[2 * x - 1] + in[2 * x + 2]) + .375f * (in[2 * x] + in[2 * x + 1]);
}

static void blur_row(float *restrict out, const float *restrict in, const float *restrict tap, long n)
{
    for (long x = -1; x <= n; x++) {
        float s = tap[0] * in[x];
        for (int k = 1; k <= HALF; k++)
            s += tap[k] * (in[x - k] + in[x + k]);
        out[x] = s;
    }
}

static void blur_rows(float *restrict out, const float *restrict in, size_t stride,
                      const float *restrict tap, float weight, long n)
{
    for (long x = -1; x <= n; x++) {
        float s = tap[0] * in[x];
        for (int k = 1; k <= HALF; k++)
            s += tap[k] * (in[x - (long)stride * k] + in[x + (long)stride * k]);
        out[x] = weight * s;
    }
}

// Bilinear along y, at row y of the finer grid.
static void up_rows(float *restrict out, const struct grid *g, unsigned c, long y)
{
    long j = y >= 0 ? y / 2 : -((1 - y) / 2);
    const float *near = row(g, c, j), *far = row(g, c, y % 2 ? j + 1 : j - 1);
    for (long x = -1; x <= g->width; x++)
        out[x] = .75f * near[x] + .25f * far[x];
}

// ... and along x, added to a level's row that starts at its apron.
static void up_row(float *restrict out, const float *restrict t, long n, long coarse, bool add)
{
    if (!add)
        memset(out - 1, 0, (size_t)(n + 2) * sizeof(float));
    out[-1] += .75f * t[-1] + .25f * t[0];
    for (long j = 0; j < coarse; j++) {
        out[2 * j] += .75f * t[j] + .25f * t[j - 1];
        out[2 * j + 1] += .75f * t[j] + .25f * t[j + 1];
    }
    if (2 * coarse <= n)
        out[2 * coarse] += .75f * t[coarse] + .25f * t[coarse - 1];
}

static void add_row(float *restrict out, const float *restrict in, const float *restrict t, float gain,
                    long n)
{
    for (long j = 0; j < n / 2; j++) {
        out[2 * j] = in[2 * j] + gain * (.75f * t[j] + .25f * t[j - 1]);
        out[2 * j + 1] = in[2 * j + 1] + gain * (.75f * t[j] + .25f * t[j + 1]);
    }
    if (n % 2)
        out[n - 1] = in[n - 1] + gain * (.75f * t[n / 2] + .25f * t[n / 2 - 1]);
}

/* ---- passes: each member has its share of the rows
 * ----------------------------------------------------- */

static long share(long first, long last, unsigned member)
{
    return first + (last - first) * (long)member / TEAM;
}

static void pass_bright(struct c_chain *c, unsigned member)
{
    const struct grid *g = &c->level[0].down;
    float *line = c->line[member] + PAD_X;
    for (unsigned p = 0; p < 3; p++)
        for (long j = share(-1, g->height + 1, member); j < share(-1, g->height + 1, member + 1); j++) {
            const float *r[4];
            for (long k = 0; k < 4; k++) {
                long y = 2 * j - 1 + k;
                r[k] = y < 0 || y >= c->height ? c->none : (float *)planes_row(c->in, p, (uint32_t)y);
            }
            bright_rows(line, r[0], r[1], r[2], r[3], c->threshold, c->width);
            memset(line - 4, 0, 4 * sizeof(float));
            memset(line + c->width, 0, 4 * sizeof(float));
            half_row(row(g, p, j), line, g->width);
        }
}

static void pass_down(struct c_chain *c, unsigned level, unsigned member)
{
    const struct grid *from = &c->level[level - 1].down, *g = &c->level[level].down;
    float *line = c->line[member] + PAD_X;
    for (unsigned p = 0; p < 3; p++)
        for (long j = share(-1, g->height + 1, member); j < share(-1, g->height + 1, member + 1); j++) {
            four_rows(line, row(from, p, 2 * j - 1), row(from, p, 2 * j), row(from, p, 2 * j + 1),
                      row(from, p, 2 * j + 2), from->width);
            half_row(row(g, p, j), line, g->width);
        }
}

static void pass_blur(struct c_chain *c, bool down, unsigned member)
{
    for (unsigned i = 0; i < c->levels; i++) {
        const struct level *l = &c->level[i];
        long first = share(-1, l->down.height + 1, member),
             last = share(-1, l->down.height + 1, member + 1);
        for (unsigned p = 0; l->blurred && p < 3; p++)
            for (long y = first; y < last; y++)
                if (down)
                    blur_rows(row(&l->glow, p, y), row(&l->across, p, y), l->across.stride, l->tap,
                              l->weight, l->down.width);
                else
                    blur_row(row(&l->across, p, y), row(&l->down, p, y), l->tap, l->down.width);
    }
}

static void pass_up(struct c_chain *c, unsigned level, unsigned member)
{
    const struct grid *from = &c->level[level + 1].glow, *g = &c->level[level].glow;
    float *line = c->line[member] + PAD_X;
    for (unsigned p = 0; p < 3; p++)
        for (long y = share(-1, g->height + 1, member); y < share(-1, g->height + 1, member + 1); y++) {
            up_rows(line, from, p, y);
            up_row(row(g, p, y), line, g->width, from->width, c->level[level].blurred);
        }
}

static void pass_add(struct c_chain *c, unsigned member)
{
    float *line = c->line[member] + PAD_X;
    for (unsigned p = 0; p < 3; p++)
        for (long y = share(0, c->height, member); y < share(0, c->height, member + 1); y++) {
            up_rows(line, &c->level[0].glow, p, y);
            add_row((float *)planes_row(c->out, p, (uint32_t)y),
                    (const float *)planes_row(c->in, p, (uint32_t)y), line, c->intensity, c->width);
        }
}

static void member_run(void *ctx, unsigned member)
{
    struct c_chain *c = ctx;
    pass_bright(c, member);
    for (unsigned i = 1; i < c->levels; i++) {
        team_meet(c->team);
        pass_down(c, i, member);
    }
    team_meet(c->team);
    pass_blur(c, false, member);
    team_meet(c->team);
    pass_blur(c, true, member);
    for (unsigned i = c->levels - 1; i-- > 0;) {
        team_meet(c->team);
        pass_up(c, i, member);
    }
    team_meet(c->team);
    pass_add(c, member);
}

void c_chain_run(struct c_chain *c, const struct planes *in, const struct planes *out, float threshold,
                 float intensity)
{
    c->in = in;
    c->out = out;
    c->threshold = threshold;
    c->intensity = intensity;
    team_run(c->team, member_run, c);
}
