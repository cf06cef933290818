// SPDX-License-Identifier: Apache-2.0
// bloom_wall_host.c - a wall's frame on the host: three turns of the crew. Bright pass; then the glow's levels, a channel a task, beside
// the picture's mean, which is memory's work; then the glow's mean and the drive. Weights are those of bloom_wall_table.c.
//
// Invariant: a task writes only its own rows, of levels or of the wall. A wall row's sums go up the frame's rows, then along its
// columns, from the first that has a weight: as shaders/wall_rows.frag and wall_columns.frag do.
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "bloom_host.h"

/* One frame, for all tasks. */
struct host_frame {
    const struct frame *fr;
    struct wall_work *work;
    bool glows;
    unsigned spreads; /* tasks before the picture's */
    struct host_drive drive;
};

static unsigned wall_bands(const struct wall_work *k) { return (k->taps[0][0].n + HOST_ROWS - 1) / HOST_ROWS; }

static float *light_of(const struct wall_work *k, unsigned band, unsigned c)
{
    return k->light + ((size_t)band * 3 + c) * k->taps[0][1].n * HOST_ROWS;
}

/* ---- the picture's mean ------------------------------------------------------------------------------------ */

// Rows of the planes that are summed at a time: more than the processor can fetch ahead of is slower.
enum { AT_ONCE = 8 };

static void picture_row(const struct frame *fr, const struct wall_taps *t, uint32_t i, unsigned c, float *out, float *decoded)
{
    const struct slot_target *p = fr->target;
    const size_t width = p->width;
    if (!t->count[i])
        memset(out, 0, width * sizeof(*out));
    for (uint32_t k = 0; k < t->count[i]; k += AT_ONCE) {
        const uint32_t n = t->count[i] - k < AT_ONCE ? t->count[i] - k : AT_ONCE;
        const float *row[AT_ONCE];
        for (uint32_t m = 0; m < n; m++) {
            const uint8_t *from = p->in[c].host + (size_t)(t->first[i] + k + m) * p->in[c].row_pitch_bytes;
            row[m] = (const float *)(const void *)from;
            if (p->geometry.type == PIXEL_TYPE_HALF) {
                half_to_float(decoded + m * width, (const uint16_t *)(const void *)from, width);
                row[m] = decoded + m * width;
            }
        }
        host_weigh_finite(out, row, t->weight + (size_t)i * t->room + k, n, width, k > 0);
    }
}

static void picture_band(const struct host_frame *f, unsigned band, unsigned member)
{
    const struct frame *fr = f->fr;
    const struct wall_taps *down = &f->work->taps[0][0];
    const size_t width = fr->target->width;
    float *rows = fr->b->host->scratch[member], *turned = rows + HOST_ROWS * width, *decoded = turned + HOST_ROWS * width;
    const struct host_run all = { LONG_MIN, LONG_MAX };
    for (unsigned c = 0; c < f->work->channels; c++) {
        for (uint32_t r = 0; r < HOST_ROWS; r++) {
            if (band * HOST_ROWS + r < down->n)
                picture_row(fr, down, band * HOST_ROWS + r, c, rows + r * width, decoded);
            else
                memset(rows + r * width, 0, width * sizeof(*rows));
        }
        host_turn(turned, rows, width, width, 1);
        host_across(light_of(f->work, band, c), turned, &f->work->taps[0][1], &all, 1, true);
    }
}

/* ---- the glow's ------------------------------------------------------------------------------------------------ */

static const struct host_plane *plane_of(const struct host *h, const struct wall_source *s)
{
    return s->gaussian >= 0 ? &h->e[s->level] : &h->sum[h->held];
}

// The rows of cells that a band's wall rows take; false: none.
static bool band_span(const struct wall_taps *t, unsigned band, long *first, long *end)
{
    *first = LONG_MAX;
    *end = LONG_MIN;
    for (uint32_t i = band * HOST_ROWS; i < t->n && i < (band + 1) * HOST_ROWS; i++)
        if (t->count[i]) {
            *first = (long)t->first[i] < *first ? (long)t->first[i] : *first;
            *end = (long)t->first[i] + (long)t->count[i] > *end ? (long)t->first[i] + (long)t->count[i] : *end;
        }
    return *first < *end;
}

// Kept columns of a source that may have light for these rows.
static unsigned source_runs(const struct host *h, const struct wall_source *s, long first, long end, struct host_run *run)
{
    if (s->gaussian < 0) {
        run[0] = (struct host_run){ 0, 4 * (long)h->level[s->level].texels };
        return 1;
    }
    const unsigned n = host_runs(h, s->level, first - LEVEL_MARGIN, end - LEVEL_MARGIN, s->level ? ldexp(4, (int)s->level) : 0, run);
    for (unsigned i = 0; i < n; i++) {
        run[i].x0 += LEVEL_MARGIN;
        run[i].x1 += LEVEL_MARGIN;
    }
    return n;
}

static void glow_row(const struct wall_taps *t, uint32_t i, const float *plane, size_t pitch, const struct host_run *run, unsigned runs,
                     float *out)
{
    for (unsigned n = 0; n < runs; n++) {
        const size_t width = (size_t)(run[n].x1 - run[n].x0);
        float *to = out + run[n].x0;
        if (!t->count[i])
            memset(to, 0, width * sizeof(*to));
        for (uint32_t k = 0; k < t->count[i]; k += AT_ONCE) {
            const uint32_t m = t->count[i] - k < AT_ONCE ? t->count[i] - k : AT_ONCE;
            const float *row[AT_ONCE];
            for (uint32_t j = 0; j < m; j++)
                row[j] = plane + (size_t)(t->first[i] + k + j) * pitch + run[n].x0;
            host_weigh(to, row, t->weight + (size_t)i * t->room + k, m, width, k > 0);
        }
    }
}

static void glow_source(const struct host_frame *f, const struct wall_source *s, const struct wall_taps taps[2], unsigned band, unsigned member)
{
    const struct frame *fr = f->fr;
    const struct host *h = fr->b->host;
    const struct host_plane *p = plane_of(h, s);
    const size_t pitch = 4 * (size_t)h->level[s->level].texels;
    struct host_run run[HOST_RUNS_MAX];
    long first, end;
    if (!band_span(&taps[0], band, &first, &end))
        return;
    const unsigned runs = source_runs(h, s, first, end, run);
    if (!runs)
        return;
    float *rows = h->scratch[member], *turned = rows + HOST_ROWS * pitch;
    memset(rows, 0, HOST_ROWS * pitch * sizeof(*rows));
    for (unsigned c = 0; c < f->work->channels; c++) {
        const double weight = s->gaussian >= 0 ? fr->b->plan->gaussian[s->gaussian].weight[c] : 1;
        for (uint32_t r = 0; r < HOST_ROWS && band * HOST_ROWS + r < taps[0].n; r++)
            glow_row(&taps[0], band * HOST_ROWS + r, p->at[c], pitch, run, runs, rows + r * pitch);
        host_turn(turned, rows, pitch, pitch, (float)(fr->params->intensity * weight));
        host_across(light_of(f->work, band, c), turned, &taps[1], run, runs, false);
    }
}

/* ---- the drive -------------------------------------------------------------------------------------------------- */

static void hand_over(const struct host_frame *f, float *const v[3], unsigned band)
{
    const struct bloom_wall *w = f->fr->wall;
    const uint32_t columns = w->end_x - w->first_x;
    for (uint32_t r = 0; r < HOST_ROWS && w->first_y + band * HOST_ROWS + r < w->end_y; r++) {
        const size_t at = 3 * ((size_t)(w->first_y + band * HOST_ROWS + r) * w->width + w->first_x);
        float *to = w->drive + at;
        const float *gain = w->gain ? w->gain + at : NULL;
        for (uint32_t x = 0; x < columns; x++)
            for (unsigned c = 0; c < 3; c++)
                to[3 * x + c] = gain ? v[c][x * HOST_ROWS + r] * gain[3 * x + c] : v[c][x * HOST_ROWS + r];
    }
}

static void finish_band(void *arg, unsigned band, unsigned member)
{
    const struct host_frame *f = arg;
    struct wall_work *k = f->work;
    const size_t n = (size_t)k->taps[0][1].n * HOST_ROWS;
    for (unsigned i = 1; f->glows && i < k->sources; i++)
        glow_source(f, &k->source[i], k->taps[i], band, member);
    float *v[3] = { light_of(k, band, 0), light_of(k, band, 1), light_of(k, band, 2) };
    for (unsigned c = k->channels; c < 3; c++)
        memcpy(v[c], v[0], n * sizeof(float));
    host_drive(v, n, &f->drive);
    hand_over(f, v, band);
}

/* ---- a frame ------------------------------------------------------------------------------------------------------ */

static void bright_task(void *arg, unsigned task, unsigned member)
{
    const struct host_frame *f = arg;
    host_bright(f->fr, task, member);
}

static void middle_task(void *arg, unsigned task, unsigned member)
{
    const struct host_frame *f = arg;
    if (task < f->spreads)
        host_spread(f->fr, task, member);
    else
        picture_band(f, task - f->spreads, member);
}

static void set_drive(const struct frame *fr, struct host_drive *d)
{
    const struct bloom_wall *w = fr->wall;
    d->exposure = (float)exp2(fr->exposure);
    d->saturation = (float)w->saturation;
    d->tone_map = w->tone_map;
    for (unsigned c = 0; c < 3; c++) {
        d->luma[c] = frame_rec709[c];
        for (unsigned i = 0; i < 3; i++)
            d->matrix[c][i] = (float)w->matrix[c][i];
    }
}

static void turn(struct host_frame *f, const char *name, unsigned tasks, void (*fn)(void *, unsigned, unsigned))
{
    struct bloom *b = f->fr->b;
    const double start = bloom_now_ms();
    if (tasks)
        crew_run(b->host->crew, tasks, fn, f);
    if (!b->commands.queries || !b->vk.log)
        return;
    char text[96];
    snprintf(text, sizeof(text), "pass %-24s %8.3f ms", name, bloom_now_ms() - start);
    b->vk.log(text);
}

int wall_run_host(struct frame *fr, bool dark)
{
    struct host_frame f = { .fr = fr, .glows = !dark };
    if (wall_work_find(fr, &f.work) < 0)
        return -1;
    set_drive(fr, &f.drive);
    if (f.glows)
        turn(&f, "host_bright", host_bands(fr->b->host), bright_task);
    // The long tasks first.
    f.spreads = f.glows ? f.work->channels : 0;
    turn(&f, "host_levels_and_picture", f.spreads + wall_bands(f.work), middle_task);
    turn(&f, "host_glow_and_drive", wall_bands(f.work), finish_band);
    return 0;
}
