/* SPDX-License-Identifier: Apache-2.0 */
/*
 * bloom_host.h - the glow of a wall's frame and its resampling in plain C, on a crew of threads, where the Vulkan device is
 * this very CPU: rows that stay in the cache and sums in registers take a third of what its shaders take, and no
 * pipeline is compiled. Planes that are not in the host's memory, and a bright pass with firefly or clamp, go through the shaders.
 *
 * Invariant: every cell is a sum in one fixed order, whichever thread, vector width or part of the frame it is computed with.
 * So the parts of a split wall agree to the bit, as those of the shaders do among themselves; host and shaders agree to the bound.
 */
#ifndef AIRYD_BLOOM_HOST_H
#define AIRYD_BLOOM_HOST_H

#include "bloom_internal.h"
#include "crew.h"

/* A level of E or of the sum, each channel by itself: cell (0, 0) is LEVEL_MARGIN columns and rows from the first one kept.
 * Light leaves the frame by less than HOST_APRON cells on its way down; outside of that E is 0 and is never written. */
enum { HOST_APRON = 3 };
struct host_plane {
    uint32_t pitch, rows; /* floats of a row; rows */
    float *at[3];
};

static inline float *host_row(const struct host_plane *p, unsigned c, long y)
{
    return p->at[c] + (size_t)(y + LEVEL_MARGIN) * p->pitch + LEVEL_MARGIN;
}

/* Columns x0 .. x1 - 1 of some cells. */
struct host_run { long x0, x1; };
enum { HOST_RUNS_MAX = 64 };

/* Owned by struct bloom, used by the device thread and, during crew_run, by the crew. */
struct host {
    struct crew *crew;
    uint32_t width, height;
    unsigned channels, octaves, finest;
    bool full_size, made;
    bool wild;                      /* E or its sums may leave float's range */
    struct level level[PSF_LEVELS_MAX + 1];
    struct host_plane e[PSF_LEVELS_MAX + 1];
    struct host_plane sum[2], rows; /* sized for the finest level that has a sum; at[] is read with a level's own pitch */
    unsigned held;                  /* which sum is the result */
    float *memory;
    float **scratch;                /* of each member */
    uint32_t tiles_x, tiles_y, tiles_room;
    unsigned char *lit;             /* tiles that may glow */
};

/* ---- bloom_host.c: bright pass, levels, Gaussians ---- */
/* Geometry of the levels; and, unless dark, memory for them and what glows. Nothing is allocated when the same shape comes again. */
int host_prepare(struct frame *fr, bool dark);
void host_destroy(struct host *h); /* NULL is fine */
/* Bright pass and first halving (or E itself): `host_bands` tasks. */
unsigned host_bands(const struct host *h);
void host_bright(const struct frame *fr, unsigned band, unsigned member);
/* After that, of one channel: the other levels, and the sum of the Gaussians from the finest level on. */
void host_spread(const struct frame *fr, unsigned channel, unsigned member);
/* Where E of a level may be above 0 in these rows of cells; sorted, apart. */
unsigned host_runs(const struct host *h, unsigned level, long y0, long y1, double reach_px, struct host_run run[HOST_RUNS_MAX]);

/* ---- bloom_host_rows.c: sums of rows ---- */
enum { HOST_WEIGH_MAX = 2 * PSF_TAPS_MAX + 1 };
/* out[x] = row[0][x] w[0] + row[1][x] w[1] ..., x < n. more: begins with out[x] in place of 0. */
void host_weigh(float *out, const float *const *row, const float *w, unsigned count, size_t n, bool more);
/* The same; samples that are not finite count as 0. */
void host_weigh_finite(float *out, const float *const *row, const float *w, unsigned count, size_t n, bool more);
/* out[x] += gain times such a sum. */
void host_weigh_add(float *out, const float *const *row, const float *w, unsigned count, size_t n, float gain);
/* Inf becomes FLT_MAX. */
void host_hold(float *v, size_t n);
/* even[i] = in[2 i], odd[i] = in[2 i + 1], and back. */
void host_unzip(float *even, float *odd, const float *in, size_t n);
void host_zip(float *out, const float *even, const float *odd, size_t n);
/* E of n pixels; in and out of `channels` rows. Twin of shaders/curve.glsl. curve: as pass_uniforms.bright. */
void host_excess(float *const out[3], const float *const in[3], size_t n, unsigned channels, enum bright_curve kind, const float curve[4],
                 const float luma[3]);
/* Eight rows side by side: out[x * 8 + r] = in[r * pitch + x] times gain, held to -FLT_MAX .. FLT_MAX before and after; and for each of n columns the sum of w[k] times the eight at
 * first + k, held to float's range, added to what out has or (set) in its place. */
enum { HOST_ROWS = 8 };
void host_turn(float *out, const float *in, size_t pitch, size_t n, float gain);
void host_across(float *out, const float *turned, const struct wall_taps *t, const struct host_run *run, unsigned runs, bool set);
/* n LEDs', a multiple of 8, linear drive of their light, in place; twin of shaders/wall_columns.frag, without the gain. */
struct host_drive { float exposure, saturation, luma[3], matrix[3][3]; int tone_map; };
void host_drive(float *const light[3], size_t n, const struct host_drive *d);

/* ---- bloom_wall_host.c ---- */
/* As wall_run. */
int wall_run_host(struct frame *fr, bool dark);

#endif
