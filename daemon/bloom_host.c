// SPDX-License-Identifier: Apache-2.0
// bloom_host.c - a wall's glow on the host: bright pass, levels, Gaussians; METHODS' steps 4 to 6 as in bloom_record.c.
//
// Invariant: all of a plane is right after its step, 0 where no light can be; of E only what lies within HOST_APRON cells of the frame is
// ever written, and the rest stays 0 from its making.
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bloom_host.h"

// Rows of a level that are made at once: what they are made from stays in a core's cache.
enum { BAND = 16, SOURCES_MAX = 2 * BAND + 6 };
// Floats before and after what is read by place: the taps of a halving look that far past an apron.
enum { PAD = 16 };

void host_destroy(struct host *h)
{
    if (!h)
        return;
    for (unsigned i = 0; h->scratch && i < crew_members(h->crew); i++)
        free(h->scratch[i]);
    crew_destroy(h->crew);
    free(h->scratch);
    free(h->memory);
    free(h->lit);
    free(h);
}

/* ---- memory ------------------------------------------------------------------------------------------------ */

static uint64_t plane_floats(struct host_plane *p, const struct level *v)
{
    p->pitch = 4 * v->texels;
    p->rows = 4 * v->groups;
    return (uint64_t)p->pitch * p->rows + 2 * PAD;
}

static void plane_place(struct host_plane *p, unsigned channels, float **at)
{
    for (unsigned c = 0; c < channels; c++) {
        p->at[c] = *at + PAD;
        *at += (size_t)p->pitch * p->rows + 2 * PAD;
    }
}

// What one member needs at most: a band of the bright pass, or eight rows of a wall with those that they come from.
static uint64_t scratch_floats(const struct host *h)
{
    const uint64_t wide = 4 * (uint64_t)h->level[0].texels + 2 * PSF_TAPS_MAX + 2 * PAD;
    return wide * (3 + 2 + 2 * HOST_ROWS + 2 * HOST_ROWS + 1) + 3 * SOURCES_MAX * (wide / 2 + 4 * PAD);
}

static int memory_make(struct host *h, struct fault *f)
{
    uint64_t floats = 0;
    const unsigned from = h->full_size ? 0 : 1;
    for (unsigned l = from; l <= h->octaves; l++)
        floats += plane_floats(&h->e[l], &h->level[l]) * h->channels;
    struct host_plane *const more[] = { &h->sum[0], &h->sum[1], &h->rows };
    for (unsigned i = 0; i < 3; i++)
        floats += plane_floats(more[i], &h->level[h->finest]) * h->channels;
    free(h->memory);
    h->memory = floats > SIZE_MAX / sizeof(float) ? NULL : calloc(floats, sizeof(float));
    if (!h->memory)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the %llu bytes of a wall's levels", (unsigned long long)(floats * sizeof(float)));
    float *at = h->memory;
    for (unsigned l = from; l <= h->octaves; l++)
        plane_place(&h->e[l], h->channels, &at);
    for (unsigned i = 0; i < 3; i++)
        plane_place(more[i], h->channels, &at);
    h->made = true;
    return 0;
}

static int scratch_make(struct host *h, struct fault *f)
{
    const uint64_t floats = scratch_floats(h);
    for (unsigned i = 0; i < crew_members(h->crew); i++) {
        free(h->scratch[i]);
        h->scratch[i] = calloc(floats, sizeof(float));
        if (!h->scratch[i])
            return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the %llu bytes of a wall's rows", (unsigned long long)(floats * sizeof(float)));
    }
    return 0;
}

static int host_make(struct bloom *b, struct fault *f)
{
    struct host *h = calloc(1, sizeof(*h));
    if (h && crew_create(&h->crew, b->threads) == 0)
        h->scratch = calloc(crew_members(h->crew), sizeof(*h->scratch));
    if (!h || !h->scratch) {
        if (h)
            crew_destroy(h->crew);
        free(h);
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory, or no thread, for a wall's frames");
    }
    b->host = h;
    return 0;
}

// What may glow, tile by tile.
static int find_lit(struct host *h, const struct frame *fr)
{
    const struct frame_scan *s = fr->scan;
    const uint32_t tiles = s->tiles_x * s->tiles_y;
    if (tiles > h->tiles_room) {
        unsigned char *lit = realloc(h->lit, tiles);
        if (!lit)
            return fault_set(fr->f, FAULT_NO_MEMORY, "", "no memory for a frame's tiles");
        h->lit = lit;
        h->tiles_room = tiles;
    }
    h->wild = !(frame_scan_max_channel(s) * (1 + fr->b->plan->weight_sum) < 1e37);
    h->tiles_x = s->tiles_x;
    h->tiles_y = s->tiles_y;
    for (uint32_t i = 0; i < tiles; i++)
        h->lit[i] = fr->b->whole || bright_tile(fr, i);
    return 0;
}

int host_prepare(struct frame *fr, bool dark)
{
    struct bloom *b = fr->b;
    const struct slot_target *t = fr->target;
    if (!b->host && host_make(b, fr->f) < 0)
        return -1;
    struct host *h = b->host;
    const unsigned octaves = b->plan->levels, finest = fr->wall_level, channels = t->geometry.channels;
    const bool full = b->plan->full_size;
    if (h->width != t->width || h->height != t->height || h->channels != channels || h->octaves != octaves || h->finest != finest ||
        h->full_size != full) {
        h->made = false;
        h->width = 0; // not whole until its scratch is there
        h->height = t->height;
        h->channels = channels;
        h->octaves = octaves;
        h->finest = finest;
        h->full_size = full;
        uint32_t width = t->width, height = t->height;
        for (unsigned l = 0; l <= octaves; l++) {
            h->level[l] = level_of(width, height);
            width = (width + 1) / 2;
            height = (height + 1) / 2;
        }
        if (scratch_make(h, fr->f) < 0)
            return -1;
        h->width = t->width;
    }
    if (dark)
        return 0;
    return (!h->made && memory_make(h, fr->f) < 0) ? -1 : find_lit(h, fr);
}

/* ---- where there is light ------------------------------------------------------------------------------------ */

static bool column_lit(const struct host *h, uint32_t x, uint32_t top, uint32_t bottom)
{
    for (uint32_t y = top; y < bottom; y++)
        if (h->lit[(size_t)y * h->tiles_x + x])
            return true;
    return false;
}

static uint32_t tile_at(double px, uint32_t most) { return px <= 0 ? 0 : px >= (double)most * SCAN_TILE ? most : (uint32_t)(px / SCAN_TILE); }

unsigned host_runs(const struct host *h, unsigned level, long y0, long y1, double reach_px, struct host_run run[HOST_RUNS_MAX])
{
    const double cell = ldexp(1, (int)level);
    const uint32_t top = tile_at((double)y0 * cell - reach_px, h->tiles_y);
    const uint32_t last = tile_at((double)y1 * cell + reach_px, h->tiles_y), bottom = last < h->tiles_y ? last + 1 : last;
    const long apron = level ? HOST_APRON : 0, low = -apron, high = (long)h->level[level].width + apron;
    unsigned n = 0;
    for (uint32_t x = 0; x < h->tiles_x; x++) {
        if (!column_lit(h, x, top, bottom))
            continue;
        const double from = (double)x * SCAN_TILE - reach_px, to = (x + 1.0) * SCAN_TILE + reach_px;
        const long x0 = (long)fmax(floor(from / cell), (double)low), x1 = (long)fmin(ceil(to / cell) + 1, (double)high);
        if (x0 >= x1)
            continue;
        if (n && (x0 <= run[n - 1].x1 || n == HOST_RUNS_MAX))
            run[n - 1].x1 = x1;
        else
            run[n++] = (struct host_run){ x0, x1 };
    }
    return n;
}

// Pixels that light has travelled to E of a level: less than 4 cells of it.
static double reach_of(unsigned level) { return level ? ldexp(4, (int)level) : 0; }

// 0 between the runs.
static void clear_gaps(float *row, long low, long high, const struct host_run *run, unsigned n)
{
    for (unsigned i = 0; i <= n; i++) {
        const long from = i ? run[i - 1].x1 : low, to = i < n ? run[i].x0 : high;
        if (to > from)
            memset(row + from, 0, (size_t)(to - from) * sizeof(*row));
    }
}

/* ---- halving ------------------------------------------------------------------------------------------------- */

static long half_of(long i) { return i >= 0 ? i / 2 : -((1 - i) / 2); }

static void binomial_of(unsigned order, float b[8])
{
    for (unsigned k = 0; k < order; k++)
        b[k] = (float)psf_binomial(order)[k < order / 2 ? k : order - 1 - k];
}

// Cells x0 .. x1 - 1 of a halved row: cell x takes 2x - h .... Rows are given by their cell 0.
static void halve_across(float *out, const float *in, long x0, long x1, unsigned order, float *split)
{
    const long n = x1 - x0 + 4, h = order / 2 - 1;
    float *even = split, *odd = split + n, b[8];
    const float *row[8];
    host_unzip(even, odd, in + 2 * (x0 - 2), (size_t)n);
    for (long k = 0; k < (long)order; k++)
        row[k] = (((k - h) & 1) ? odd : even) + 2 + half_of(k - h);
    binomial_of(order, b);
    host_weigh(out + x0, row, b, order, (size_t)(x1 - x0), false);
}

/* A band of a halved level: its rows, and where their sources' halved rows are. */
struct band {
    long y0, y1;         /* rows that are made */
    long s0, s1;         /* rows that they come from */
    unsigned order, runs;
    struct host_run run[HOST_RUNS_MAX];
    float *halved;       /* cell 0 of the row of s0 */
    size_t pitch;
    bool wild;
    float *split;
};

static bool band_begin(struct band *k, unsigned band, const struct host *of, unsigned level, unsigned order)
{
    const struct level *v = &of->level[level];
    const long h = order / 2 - 1, end = (long)v->height + HOST_APRON;
    k->order = order;
    k->wild = of->wild;
    k->y0 = (long)band * BAND - HOST_APRON;
    k->y1 = k->y0 + BAND < end ? k->y0 + BAND : end;
    k->s0 = 2 * k->y0 - h;
    k->s1 = 2 * (k->y1 - 1) + (long)order - h;
    k->pitch = 4 * (size_t)v->texels;
    return k->y0 < k->y1;
}

static float *halved_row(const struct band *k, long s) { return k->halved + (size_t)(s - k->s0) * k->pitch; }

// The halved rows are there: the band itself.
static void halve_down(const struct band *k, const struct host_plane *to, unsigned c, long width)
{
    float b[8];
    binomial_of(k->order, b);
    for (long y = k->y0; y < k->y1; y++) {
        float *out = host_row(to, c, y);
        for (unsigned i = 0; i < k->runs; i++) {
            const float *row[8];
            for (long t = 0; t < (long)k->order; t++)
                row[t] = halved_row(k, 2 * y + t - ((long)k->order / 2 - 1)) + k->run[i].x0;
            host_weigh(out + k->run[i].x0, row, b, k->order, (size_t)(k->run[i].x1 - k->run[i].x0), false);
            if (k->wild)
                host_hold(out + k->run[i].x0, (size_t)(k->run[i].x1 - k->run[i].x0));
        }
        clear_gaps(out, -HOST_APRON, width + HOST_APRON, k->run, k->runs);
    }
}

static void no_light(const struct band *k, long s)
{
    for (unsigned i = 0; i < k->runs; i++)
        memset(halved_row(k, s) + k->run[i].x0, 0, (size_t)(k->run[i].x1 - k->run[i].x0) * sizeof(float));
}

// E of a level from that of the finer one.
static void down(const struct frame *fr, unsigned octave, unsigned c, unsigned member)
{
    const struct host *h = fr->b->host;
    const struct level *v = &h->level[octave + 1];
    struct band k;
    float *at = h->scratch[member];
    k.split = at + PAD;
    k.halved = at + 2 * PAD + 4 * h->level[0].texels + PSF_TAPS_MAX + LEVEL_MARGIN;
    for (unsigned i = 0; band_begin(&k, i, h, octave + 1, fr->b->plan->order[octave]); i++) {
        k.runs = host_runs(h, octave + 1, k.y0, k.y1, reach_of(octave + 1), k.run);
        const long apron = octave ? HOST_APRON : 0;
        for (long s = k.s0; s < k.s1; s++) {
            if (s < -apron || s >= (long)h->level[octave].height + apron) {
                no_light(&k, s);
                continue;
            }
            for (unsigned r = 0; r < k.runs; r++)
                halve_across(halved_row(&k, s), host_row(&h->e[octave], c, s), k.run[r].x0, k.run[r].x1, k.order, k.split);
        }
        halve_down(&k, &h->e[octave + 1], c, (long)v->width);
    }
}

/* ---- the bright pass ------------------------------------------------------------------------------------------ */

// Pixels x0 ... of a row of the planes.
static const float *pixels(const struct slot_target *t, unsigned c, long y, long x0, long n, float *decoded)
{
    const uint8_t *row = t->in[c].host + (size_t)y * t->in[c].row_pitch_bytes;
    if (t->geometry.type == PIXEL_TYPE_FLOAT)
        return (const float *)(const void *)row + x0;
    half_to_float(decoded, (const uint16_t *)(const void *)row + x0, (size_t)n);
    return decoded;
}

static void bright_row(const struct frame *fr, long y, const struct host_run *run, float *const e[3], float *decoded)
{
    const struct slot_target *t = fr->source;
    const long room = 4 * (long)fr->b->host->level[0].texels, n = run->x1 - run->x0;
    const float *in[3] = { NULL };
    float *out[3] = { NULL }, curve[4];
    for (unsigned c = 0; c < t->geometry.channels; c++) {
        in[c] = pixels(t, c, y, run->x0, n, decoded + c * room);
        out[c] = e[c] + run->x0;
    }
    bright_curve(fr, curve);
    host_excess(out, in, (size_t)n, t->geometry.channels, (enum bright_curve)fr->params->bright, curve, fr->request->luma);
}

static unsigned bands_of(const struct level *v, long apron) { return (unsigned)(((long)v->height + 2 * apron + BAND - 1) / BAND); }

unsigned host_bands(const struct host *h)
{
    return h->full_size ? bands_of(&h->level[0], 0) : h->octaves ? bands_of(&h->level[1], HOST_APRON) : 0;
}

static void bright_full(const struct frame *fr, unsigned band, unsigned member)
{
    const struct host *h = fr->b->host;
    const long y0 = (long)band * BAND, end = (long)h->level[0].height, y1 = y0 + BAND < end ? y0 + BAND : end;
    struct host_run run[HOST_RUNS_MAX];
    const unsigned runs = host_runs(h, 0, y0, y1, 0, run);
    for (long y = y0; y < y1; y++) {
        float *e[3] = { NULL };
        for (unsigned c = 0; c < h->channels; c++) {
            e[c] = host_row(&h->e[0], c, y);
            clear_gaps(e[c], 0, (long)h->level[0].width, run, runs);
        }
        for (unsigned i = 0; i < runs; i++)
            bright_row(fr, y, &run[i], e, h->scratch[member]);
    }
}

// Of tiles that may glow, the cells of level 1 that their pixels reach.
static unsigned halved_runs(const struct host *h, const struct host_run *pixel, unsigned n, struct host_run *run)
{
    const long high = (long)h->level[1].width + HOST_APRON;
    for (unsigned i = 0; i < n; i++) {
        const long x0 = half_of(pixel[i].x0 - 4), x1 = half_of(pixel[i].x1 + 4) + 1;
        run[i] = (struct host_run){ x0 < -HOST_APRON ? -HOST_APRON : x0, x1 > high ? high : x1 };
    }
    return n;
}

static void bright_halved(const struct frame *fr, unsigned band, unsigned member)
{
    const struct host *h = fr->b->host;
    const long room = 4 * (long)h->level[0].texels;
    struct host_run pixel[HOST_RUNS_MAX];
    struct band of[3];
    float *e[3], *at = h->scratch[member] + PAD, *decoded;
    const bool any = band_begin(&of[0], band, h, 1, fr->b->plan->order[0]);
    assert(any);
    (void)any;
    const unsigned pixel_runs = host_runs(h, 0, of[0].s0, of[0].s1, 0, pixel);
    of[0].runs = halved_runs(h, pixel, pixel_runs, of[0].run);
    of[0].split = at;
    decoded = at += room + 2 * PAD;
    at += 3 * room;
    for (unsigned c = 0; c < 3; c++, at += room + 2 * PAD)
        e[c] = at + PAD;
    for (unsigned c = 0; c < h->channels; c++, at += SOURCES_MAX * of[0].pitch + PAD) {
        of[c] = of[0];
        of[c].halved = at + LEVEL_MARGIN;
        memset(e[c] - PAD, 0, ((size_t)h->width + 2 * PAD) * sizeof(float));
    }
    for (long s = of[0].s0; s < of[0].s1; s++) {
        const bool inside = s >= 0 && s < (long)h->height;
        for (unsigned i = 0; inside && i < pixel_runs; i++)
            bright_row(fr, s, &pixel[i], e, decoded);
        for (unsigned c = 0; c < h->channels; c++) {
            if (!inside)
                no_light(&of[c], s);
            for (unsigned i = 0; inside && i < of[c].runs; i++)
                halve_across(halved_row(&of[c], s), e[c], of[c].run[i].x0, of[c].run[i].x1, of[c].order, of[c].split);
        }
    }
    for (unsigned c = 0; c < h->channels; c++)
        halve_down(&of[c], &h->e[1], c, (long)h->level[1].width);
}

void host_bright(const struct frame *fr, unsigned band, unsigned member)
{
    if (fr->b->host->full_size)
        bright_full(fr, band, member);
    else
        bright_halved(fr, band, member);
}

/* ---- Gaussians and doublings ------------------------------------------------------------------------------------ */

/* A level's cells in a plane that is sized for the finest one. */
static struct host_plane as_level(const struct host_plane *p, const struct level *v)
{
    struct host_plane q = *p;
    q.pitch = 4 * v->texels;
    q.rows = 4 * v->groups;
    return q;
}

static void blur(const struct host *h, const struct plan_gaussian *g, unsigned c, unsigned to, bool any, unsigned member)
{
    const struct level *v = &h->level[g->level];
    const struct host_plane rows = as_level(&h->rows, v), sum = as_level(&h->sum[to], v);
    const long apron = g->level ? HOST_APRON : 0, width = (long)v->width + 2 * apron, pitch = (long)rows.pitch;
    const long hx = (long)g->x.half, hy = (long)g->y.half, y_end = (long)v->height + apron;
    float tap[HOST_WEIGH_MAX], *wide = h->scratch[member];
    const float *row[HOST_WEIGH_MAX];
    for (long k = -hx; k <= hx; k++) {
        tap[k + hx] = (float)g->x.tap[labs(k)];
        row[k + hx] = wide + hx + k;
    }
    memset(wide, 0, (size_t)(pitch + 2 * hx) * sizeof(float));
    for (long y = -apron; y < y_end; y++) {
        memcpy(wide + hx + LEVEL_MARGIN - apron, host_row(&h->e[g->level], c, y) - apron, (size_t)width * sizeof(float));
        host_weigh(host_row(&rows, c, y) - LEVEL_MARGIN, row, tap, (unsigned)(2 * hx + 1), (size_t)pitch, false);
    }
    for (long y = -LEVEL_MARGIN; y < (long)sum.rows - LEVEL_MARGIN; y++) {
        unsigned n = 0;
        for (long k = -hy; k <= hy; k++)
            if (y + k >= -apron && y + k < y_end) {
                tap[n] = (float)g->y.tap[labs(k)];
                row[n++] = host_row(&rows, c, y + k) - LEVEL_MARGIN;
            }
        float *out = host_row(&sum, c, y) - LEVEL_MARGIN;
        if (!any)
            memset(out, 0, (size_t)pitch * sizeof(float));
        host_weigh_add(out, row, tap, n, (size_t)pitch, (float)g->weight[c]);
    }
}

// First coarse cell, from m, that fine cell 2 m + parity takes, and the weights from there.
static long up_weights(unsigned order, long parity, float w[4])
{
    float b[8];
    binomial_of(order, b);
    const long i = parity + order / 2 - 1, first = -half_of((long)order - 1 - i);
    for (long d = 0; d < (long)order / 2; d++)
        w[d] = 2 * b[i - 2 * (first + d)];
    return first;
}

static void up(const struct frame *fr, unsigned octave, unsigned c, unsigned from, unsigned member)
{
    const struct host *h = fr->b->host;
    const struct level *coarse = &h->level[octave + 1], *fine = &h->level[octave];
    const struct host_plane in = as_level(&h->sum[from], coarse), out = as_level(&h->sum[!from], fine);
    // Doubled rows, as many as the coarse level has.
    struct host_plane doubled = as_level(&h->rows, fine);
    const unsigned order = fr->b->plan->order[octave], taps = order / 2;
    const long n = (long)out.pitch / 2, edge = LEVEL_MARGIN / 2, reach = 2;
    float w[2][4], *half[2] = { h->scratch[member], h->scratch[member] + n };
    const float *row[4];
    const long first[2] = { up_weights(order, 0, w[0]), up_weights(order, 1, w[1]) };
    for (long y = -edge - reach; y < (long)out.rows / 2 - edge + reach; y++) {
        for (unsigned p = 0; p < 2; p++) {
            for (unsigned d = 0; d < taps; d++)
                row[d] = host_row(&in, c, y) - edge + first[p] + d;
            host_weigh(half[p], row, w[p], taps, (size_t)n, false);
        }
        host_zip(host_row(&doubled, c, y) - LEVEL_MARGIN, half[0], half[1], (size_t)n);
    }
    for (long y = -LEVEL_MARGIN; y < (long)out.rows - LEVEL_MARGIN; y++) {
        const unsigned p = y & 1;
        for (unsigned d = 0; d < taps; d++)
            row[d] = host_row(&doubled, c, half_of(y - p) + first[p] + d) - LEVEL_MARGIN;
        host_weigh(host_row(&out, c, y) - LEVEL_MARGIN, row, w[p], taps, out.pitch, false);
    }
}

static void sum_gaussians(const struct frame *fr, unsigned c, unsigned member)
{
    struct host *h = fr->b->host;
    const struct plan *p = fr->b->plan;
    unsigned held = 0, g = p->count;
    bool any = false;
    for (unsigned level = p->levels;; level--) {
        for (; g > 0 && p->gaussian[g - 1].level == level; g--) {
            blur(h, &p->gaussian[g - 1], c, held, any, member);
            any = true;
        }
        if (level == h->finest)
            break;
        if (any) {
            up(fr, level - 1, c, held, member);
            held = !held;
        }
    }
    const struct host_plane sum = as_level(&h->sum[held], &h->level[h->finest]);
    for (long y = -LEVEL_MARGIN; any && h->wild && y < (long)sum.rows - LEVEL_MARGIN; y++)
        host_hold(host_row(&sum, c, y) - LEVEL_MARGIN, sum.pitch);
    if (c == 0)
        h->held = held;
}

void host_spread(const struct frame *fr, unsigned channel, unsigned member)
{
    const struct host *h = fr->b->host;
    for (unsigned octave = h->full_size ? 0 : 1; octave < h->octaves; octave++)
        down(fr, octave, channel, member);
    if (fr->b->plan->count && fr->b->plan->gaussian[fr->b->plan->count - 1].level >= h->finest)
        sum_gaussians(fr, channel, member);
}
