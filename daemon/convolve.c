// SPDX-License-Identifier: Apache-2.0
// convolve.c - see convolve.h. A real frame of h rows goes through three sweeps, each shared out in
// independent tasks:
//   rows     two rows at a time are the real and the imaginary part of one complex row; its transform is
//   taken apart into
//            the half spectra of both. Rows without light are skipped.
//   columns  forward, times the kernel's spectrum, back, all in the cache: the work array is passed
//   once. rows     two half spectra are put together, back, and rounded to float32.
// Invariant: the work array is [block of FFT_LANES columns][re, im][row][lane], so that a block is one
// fft_batch and a row's part of it one cache line or less. Rows >= rows_in of it are zeroed by the
// column's own task.
#include "convolve.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "crew.h"
#include "fft.h"
#include "kernel.h"

enum { L = FFT_LANES, GROUP = 2 * L };

struct spectrum {
    double *value; /* [block][re, im unless real][row][lane], times weight / (n m) */
    uint32_t rows; /* m, or m / 2 + 1: mirrored */
    bool real;
};

struct scratch {
    struct fft_batch a, b;
    double *memory;
};

struct convolver {
    uint32_t width, height, grow, n, m, blocks;
    unsigned channels, spectra;
    struct fft row, column;
    struct crew *crew;
    struct scratch *scratch; /* one a member */
    double *work;
    struct spectrum spectrum[3];
    unsigned spectrum_of[3];
    double weight, outside[3], bound;
    bool cut; /* what is outside is lost, not put back */
    uint64_t bytes;

    /* The sweep under way: */
    const struct kernel *kernel; /* its spectrum is made; NULL: a frame */
    const float *e;
    float *out;
    size_t e_stride, out_stride;
    struct spectrum *by;
    uint32_t rows_in;
    atomic_bool lit;
};

static struct fft_batch block_of(const struct convolver *c, uint32_t block)
{
    double *re = c->work + (size_t)block * 2 * L * c->m;
    return (struct fft_batch){ re, re + (size_t)L * c->m };
}

/* ---- rows, forward
 * ------------------------------------------------------------------------------------ */

static bool frame_row(const struct convolver *c, uint32_t y, double *out)
{
    if (y >= c->height)
        return false;
    const float *e = c->e + (size_t)y * c->e_stride;
    bool lit = false;
    for (uint32_t x = 0; x < c->width; x++)
        lit |= e[x] != 0;
    for (uint32_t x = 0; lit && x < c->width; x++)
        out[(size_t)x * L] = (double)e[x];
    return lit;
}

static bool kernel_row(const struct convolver *c, uint32_t y, double *out)
{
    const struct kernel *k = c->kernel;
    const int32_t up = k->symmetry == KERNEL_ANY ? k->min_y : -k->max_y;
    const int32_t left = k->symmetry == KERNEL_MIRRORED ? -k->max_x : k->min_x;
    const int32_t dy = (int64_t)y <= k->max_y ? (int32_t)y : (int32_t)((int64_t)y - c->m);
    if (y >= c->m || dy < up || dy > k->max_y)
        return false;
    for (int32_t dx = left; dx <= k->max_x; dx++)
        out[(size_t)(dx < 0 ? dx + (int64_t)c->n : dx) * L] = kernel_at(k, dx, dy);
    return true;
}

// Z = A + iB, A and B of real rows: A[k] = (Z[k] + conj Z[n-k]) / 2, B[k] = (Z[k] - conj Z[n-k]) / 2i.
static void pair_part(const struct convolver *c, struct fft_batch z, uint32_t y0)
{
    const uint32_t half = c->n / 2;
    for (uint32_t k = 0; k <= half; k++) {
        const struct fft_batch to = block_of(c, k / L);
        const double *pr = z.re + (size_t)k * L, *pi = z.im + (size_t)k * L;
        const size_t mirror = (size_t)(k ? c->n - k : 0) * L;
        const double *qr = z.re + mirror, *qi = z.im + mirror;
        for (unsigned l = 0; l < L; l++) {
            const size_t a = (size_t)(y0 + l) * L + k % L, b = a + (size_t)L * L;
            if (y0 + l < c->m) {
                to.re[a] = 0.5 * (pr[l] + qr[l]);
                to.im[a] = 0.5 * (pi[l] - qi[l]);
            }
            if (y0 + L + l < c->m) {
                to.re[b] = 0.5 * (pi[l] + qi[l]);
                to.im[b] = 0.5 * (qr[l] - pr[l]);
            }
        }
    }
}

static void rows_clear(const struct convolver *c, uint32_t block, uint32_t from, uint32_t to)
{
    const struct fft_batch z = block_of(c, block);
    if (from < to) {
        memset(z.re + (size_t)from * L, 0, (size_t)(to - from) * L * sizeof(double));
        memset(z.im + (size_t)from * L, 0, (size_t)(to - from) * L * sizeof(double));
    }
}

static void rows_in_task(void *ctx, unsigned task, unsigned member)
{
    struct convolver *c = ctx;
    struct scratch *s = &c->scratch[member];
    const uint32_t y0 = task * GROUP, end = y0 + GROUP < c->m ? y0 + GROUP : c->m;
    memset(s->a.re, 0, (size_t)c->n * L * sizeof(double));
    memset(s->a.im, 0, (size_t)c->n * L * sizeof(double));
    bool lit = false;
    for (unsigned l = 0; l < GROUP; l++) {
        double *out = (l < L ? s->a.re : s->a.im) + l % L;
        lit |= c->kernel ? kernel_row(c, y0 + l, out) : frame_row(c, y0 + l, out);
    }
    if (lit) {
        atomic_store_explicit(&c->lit, true, memory_order_relaxed);
        pair_part(c, fft_run(&c->row, s->a, s->b, false), y0);
    } else {
        for (uint32_t b = 0; b < c->blocks; b++)
            rows_clear(c, b, y0, end);
    }
}

/* ---- columns ----------------------------------------------------------------------------------------
 */

static struct fft_batch column_forward(const struct convolver *c, uint32_t block, struct scratch *s,
                                       struct fft_batch *other)
{
    const struct fft_batch z = block_of(c, block);
    rows_clear(c, block, c->rows_in, c->m);
    const struct fft_batch r = fft_run(&c->column, z, s->a, false);
    *other = r.re == z.re ? s->a : z;
    return r;
}

static size_t spectrum_block(const struct spectrum *k)
{
    return (size_t)k->rows * L * (k->real ? 1 : 2);
}

static void spectrum_task(void *ctx, unsigned task, unsigned member)
{
    struct convolver *c = ctx;
    struct fft_batch other;
    const struct fft_batch r = column_forward(c, task, &c->scratch[member], &other);
    const struct spectrum *k = c->by;
    const double scale = c->weight / ((double)c->n * c->m);
    const size_t count = (size_t)k->rows * L;
    double *out = k->value + task * spectrum_block(k);
    for (size_t i = 0; i < count; i++)
        out[i] = r.re[i] * scale;
    for (size_t i = 0; !k->real && i < count; i++)
        out[i + count] = r.im[i] * scale;
}

static void multiply(const struct convolver *c, struct fft_batch z, uint32_t block)
{
    const struct spectrum *k = c->by;
    const double *by = k->value + block * spectrum_block(k), *im = by + (size_t)L * k->rows;
    for (uint32_t y = 0; y < c->m; y++) {
        const size_t row = (size_t)(y < k->rows ? y : c->m - y) * L;
        double *zr = z.re + (size_t)y * L, *zi = z.im + (size_t)y * L;
        for (unsigned l = 0; k->real && l < L; l++) {
            zr[l] *= by[row + l];
            zi[l] *= by[row + l];
        }
        for (unsigned l = 0; !k->real && l < L; l++) {
            const double r = zr[l], i = zi[l];
            zr[l] = r * by[row + l] - i * im[row + l];
            zi[l] = r * im[row + l] + i * by[row + l];
        }
    }
}

static void columns_task(void *ctx, unsigned task, unsigned member)
{
    struct convolver *c = ctx;
    struct fft_batch other;
    const struct fft_batch r = column_forward(c, task, &c->scratch[member], &other);
    multiply(c, r, task);
    // As many stages back as forth: the result is in the work array again.
    fft_run(&c->column, r, other, true);
}

/* ---- rows, back
 * --------------------------------------------------------------------------------------- */

static uint32_t wrapped(const struct convolver *c, uint32_t out, uint32_t length)
{
    return (uint32_t)(((uint64_t)out + length - c->grow % length) % length);
}

// Z[k] = A[k] + iB[k], Z[n-k] = conj A[k] + i conj B[k].
static void pair_join(const struct convolver *c, struct fft_batch z, uint32_t first, unsigned count)
{
    const uint32_t half = c->n / 2;
    size_t at[GROUP];
    for (unsigned l = 0; l < GROUP; l++)
        at[l] = (size_t)wrapped(c, first + (l < count ? l : 0), c->m) * L;
    for (uint32_t k = 0; k <= half; k++) {
        const struct fft_batch from = block_of(c, k / L);
        double *pr = z.re + (size_t)k * L, *pi = z.im + (size_t)k * L;
        const size_t mirror = (size_t)(k ? c->n - k : 0) * L;
        double *qr = z.re + mirror, *qi = z.im + mirror;
        // At 0 and n / 2 both are the same number, whose imaginary parts are rounding: of a real row
        // they are 0.
        const bool own = k == 0 || 2 * k == c->n;
        for (unsigned l = 0; l < L; l++) {
            const size_t a = at[l] + k % L, b = at[l + L] + k % L;
            const double ai = own ? 0 : from.im[a], bi = own ? 0 : from.im[b];
            pr[l] = from.re[a] - bi;
            pi[l] = ai + from.re[b];
            qr[l] = from.re[a] + bi;
            qi[l] = from.re[b] - ai;
        }
    }
}

static void row_store(const struct convolver *c, const double *z, uint32_t row)
{
    float *out = c->out + (size_t)row * c->out_stride;
    uint32_t at = wrapped(c, 0, c->n);
    for (uint32_t x = 0; x < c->width + 2 * c->grow; x++) {
        const double v = z[(size_t)at * L];
        out[x] = v > 0 ? (float)fmin(v, 0x1.fffffep127) : 0.0f;
        at = at + 1 == c->n ? 0 : at + 1;
    }
}

static void rows_out_task(void *ctx, unsigned task, unsigned member)
{
    struct convolver *c = ctx;
    struct scratch *s = &c->scratch[member];
    const uint32_t rows = c->height + 2 * c->grow, first = task * GROUP;
    const unsigned count = rows - first < GROUP ? rows - first : GROUP;
    pair_join(c, s->a, first, count);
    const struct fft_batch z = fft_run(&c->row, s->a, s->b, true);
    for (unsigned l = 0; l < count; l++)
        row_store(c, (l < L ? z.re : z.im) + l % L, first + l);
}

/* ---- a frame
 * -------------------------------------------------------------------------------------------- */

static uint32_t groups(uint32_t rows) { return (rows + GROUP - 1) / GROUP; }

static void rows_forward(struct convolver *c, uint32_t rows)
{
    c->rows_in = groups(rows) * GROUP < c->m ? groups(rows) * GROUP : c->m;
    atomic_store_explicit(&c->lit, false, memory_order_relaxed);
    crew_run(c->crew, groups(rows), rows_in_task, c);
}

int convolver_run(struct convolver *c, const float *const e[3], size_t e_stride, float *const out[3],
                  size_t out_stride, struct fault *f)
{
    const uint32_t width = c->width + 2 * c->grow, height = c->height + 2 * c->grow;
    if (e_stride < c->width || out_stride < width)
        return fault_set(f, FAULT_INTERNAL, "",
                         "convolver: strides of %zu and %zu floats found, at least %u and %u expected",
                         e_stride, out_stride, c->width, width);
    c->kernel = NULL;
    c->e_stride = e_stride;
    c->out_stride = out_stride;
    for (unsigned i = 0; i < c->channels; i++) {
        c->e = e[i];
        c->out = out[i];
        c->by = &c->spectrum[c->spectrum_of[i]];
        rows_forward(c, c->height);
        if (!atomic_load_explicit(&c->lit, memory_order_relaxed)) {
            for (uint32_t y = 0; y < height; y++)
                memset(out[i] + (size_t)y * out_stride, 0, width * sizeof(float));
            continue;
        }
        crew_run(c->crew, c->blocks, columns_task, c);
        crew_run(c->crew, groups(height), rows_out_task, c);
    }
    return 0;
}

/* ---- made once --------------------------------------------------------------------------------------
 */

static double *numbers(uint64_t count)
{
    return aligned_alloc(64, (size_t)((count * sizeof(double) + 63) / 64 * 64));
}

static uint32_t length_for(uint32_t side, uint32_t grow, int32_t min, int32_t max)
{
    return fft_length(side + grow + (uint32_t)(-min > max ? -min : max));
}

// What all takes, counted before any of it is taken.
static uint64_t bytes_peak(struct convolver *c, const struct kernel *k, unsigned members)
{
    const uint64_t drawn = (uint64_t)(k->max_x - k->min_x + 1) * (uint64_t)(k->max_y - k->min_y + 1);
    const uint64_t longest = c->n > c->m ? c->n : c->m, work = (uint64_t)c->blocks * 2 * L * c->m;
    const struct spectrum *s = &c->spectrum[0];
    const uint64_t spectra = (uint64_t)c->blocks * spectrum_block(s) * c->spectra;
    c->bytes = sizeof(double) * (work + spectra + members * 4 * L * longest);
    return c->bytes + sizeof(double) * drawn * (c->channels == 1 ? 2 : 1);
}

static int bytes_count(struct convolver *c, const struct kernel *k, unsigned members, struct fault *f)
{
    const uint64_t peak = bytes_peak(c, k, members);
    if (peak > CONVOLVER_BYTES_MAX)
        return fault_set(
            f, FAULT_LIMIT, "params.psf",
            "psf: a convolution by FFT of %u x %u needs %llu MiB, at most %llu MiB expected", c->n, c->m,
            (unsigned long long)(peak >> 20), (unsigned long long)(CONVOLVER_BYTES_MAX >> 20));
    return 0;
}

static int memory_take(struct convolver *c, unsigned threads, struct fault *f)
{
    const uint64_t longest = c->n > c->m ? c->n : c->m;
    int err = crew_create(&c->crew, threads);
    if (err == 0)
        err = fft_init(&c->row, c->n) || fft_init(&c->column, c->m);
    if (err == 0)
        err = (c->scratch = calloc(crew_members(c->crew), sizeof(*c->scratch))) == NULL;
    for (unsigned i = 0; err == 0 && i < crew_members(c->crew); i++) {
        double *p = c->scratch[i].memory = numbers(4 * L * longest);
        if (!p)
            err = -1;
        else
            c->scratch[i] = (struct scratch){ { p, p + L * longest },
                                              { p + 2 * L * longest, p + 3 * L * longest },
                                              p };
    }
    if (err == 0)
        err = (c->work = numbers((uint64_t)c->blocks * 2 * L * c->m)) == NULL;
    if (err == 0) // the last block's lanes beyond column n / 2: never written again
        memset(block_of(c, c->blocks - 1).re, 0, 2 * L * sizeof(double) * c->m);
    for (unsigned i = 0; err == 0 && i < c->spectra; i++)
        err = (c->spectrum[i].value = numbers((uint64_t)c->blocks * spectrum_block(&c->spectrum[i]))) ==
              NULL;
    return err == 0
               ? 0
               : fault_set(f, FAULT_NO_MEMORY, "params.psf",
                           "psf: no memory or thread for a convolution by FFT of %u x %u", c->n, c->m);
}

// The kernel of a plane: the channel's, or of a frame of one plane the mean.
static int plane_kernel(struct convolver *c, struct kernel *k, const struct kernel_facts *facts,
                        unsigned channel, struct fault *f)
{
    if (kernel_draw(k, facts, channel, c->crew, f) < 0)
        return -1;
    for (unsigned more = 1; c->channels == 1 && more < 3; more++) {
        struct kernel other;
        if (kernel_draw(&other, facts, more, c->crew, f) < 0) {
            kernel_finish(k);
            return -1;
        }
        const size_t count = (size_t)(k->max_x - k->min_x + 1) * (size_t)(k->max_y - k->min_y + 1);
        for (size_t i = 0; i < count; i++)
            k->value[i] += (other.value[i] - k->value[i]) / (more + 1);
        k->outside += (other.outside - k->outside) / (more + 1);
        kernel_finish(&other);
    }
    return 0;
}

static int spectra_make(struct convolver *c, const struct kernel_facts *facts, struct fault *f)
{
    bool made[3] = { false, false, false };
    for (unsigned i = 0; i < c->channels; i++) {
        const unsigned to = c->spectrum_of[i];
        if (made[to]) {
            for (unsigned j = 0; j < i; j++)
                c->outside[i] = c->spectrum_of[j] == to ? c->outside[j] : c->outside[i];
            continue;
        }
        struct kernel k;
        if (plane_kernel(c, &k, facts, i, f) < 0)
            return -1;
        made[to] = true;
        c->outside[i] = k.outside;
        c->kernel = &k;
        c->by = &c->spectrum[to];
        rows_forward(c, c->m);
        crew_run(c->crew, c->blocks, spectrum_task, c);
        c->kernel = NULL;
        kernel_finish(&k);
    }
    return 0;
}

/*
 * Let |.| be 2-norms, u = 2^-53, and a transform's error norm |X| and, componentwise, each * sum |x|
 * (fft.h). Then spectrum of E     |dX| <= norm |X| of the kernel     |dK_j| <= each * weight for every
 * j, as the kernel is >= 0 with sum <= weight; and |K_j| <= weight product, pairs, scaling   8
 * roundings: <= 16 u |X| weight way back          norm again and by Parseval |dy| <= (2 norm + each + 16
 * u) weight |E|, |E| <= sqrt(width height) max E, each pixel's error <= |dy|. Last, one rounding to
 * float32 of a number that is <= weight max E. (Below 1e-38 max E the smallest float's step, 1.4e-45, is
 * to be added.)
 */
static double bound_of(const struct convolver *c)
{
    const struct fft_rounding r = fft_rounding(&c->row), k = fft_rounding(&c->column);
    const double norm = r.norm + k.norm, each = r.each + k.each;
    const double fft = (2 * norm + each + 16 * 0x1p-53) * sqrt((double)c->width * c->height);
    return c->weight * (fft + (1 + fft) * 0x1p-24);
}

static int facts_check(const struct convolver_facts *facts, struct fault *f)
{
    const uint64_t x = (uint64_t)facts->width + facts->grow, y = (uint64_t)facts->height + facts->grow;
    if (facts->width < 1 || facts->height < 1 || (facts->channels != 1 && facts->channels != 3))
        return fault_set(
            f, FAULT_PARAM_RANGE, "params.psf",
            "psf: a frame of %u x %u pixels, %u channels found, at least 1 x 1 and 1 or 3 expected",
            facts->width, facts->height, facts->channels);
    if (x > CONVOLVER_SIDE_MAX || y > CONVOLVER_SIDE_MAX)
        return fault_set(f, FAULT_LIMIT, "params.psf",
                         "psf: a frame of %u x %u pixels and grow %u found, sides of up to %d expected",
                         facts->width, facts->height, facts->grow, CONVOLVER_SIDE_MAX);
    if (!(facts->psf->weight >= 0 && facts->psf->weight <= 1e12))
        return fault_set(f, FAULT_PARAM_RANGE, "params.psf",
                         "psf: a weight of %g found, 0 to 1e12 expected", facts->psf->weight);
    return 0;
}

static void plan_make(struct convolver *c, const struct convolver_facts *facts, const struct kernel *k)
{
    c->n = length_for(facts->width, facts->grow, k->min_x, k->max_x);
    c->m = length_for(facts->height, facts->grow, k->min_y, k->max_y);
    c->blocks = (c->n / 2 + 1 + L - 1) / L;
    for (unsigned i = 0; i < facts->channels; i++) {
        unsigned same = 0;
        while (same < i && !kernel_same(facts->psf, same, i))
            same++;
        c->spectrum_of[i] = same < i ? c->spectrum_of[same] : c->spectra++;
    }
    for (unsigned i = 0; i < 3; i++)
        c->spectrum[i] =
            (struct spectrum){ .real = k->symmetry != KERNEL_ANY,
                               .rows = k->symmetry == KERNEL_MIRRORED ? c->m / 2 + 1 : c->m };
}

static struct kernel_facts kernel_facts_of(const struct convolver_facts *facts)
{
    return (struct kernel_facts){ .psf = facts->psf,
                                  .reach_x = facts->width + facts->grow - 1,
                                  .reach_y = facts->height + facts->grow - 1,
                                  .pixel_aspect = facts->pixel_aspect,
                                  .picture_height = facts->height,
                                  .image = facts->image,
                                  .image_width = facts->image_width,
                                  .image_height = facts->image_height };
}

static unsigned members_for(unsigned threads) { return threads < 1 ? 1 : threads > CREW_MAX ? CREW_MAX : threads; }

uint64_t convolver_bytes_most(const struct convolver_facts *facts)
{
    enum { TABLES_BYTES = 1 << 20 }; // a model's radial table, the crew, the struct
    if ((uint64_t)facts->width + facts->grow > CONVOLVER_SIDE_MAX || (uint64_t)facts->height + facts->grow > CONVOLVER_SIDE_MAX ||
        !facts->width || !facts->height)
        return 0; // it will be refused
    const struct kernel_facts kernel = kernel_facts_of(facts);
    struct kernel k;
    struct convolver c = { .width = facts->width, .height = facts->height, .grow = facts->grow, .channels = facts->channels };
    kernel_measure(&k, &kernel);
    plan_make(&c, facts, &k);
    return bytes_peak(&c, &k, members_for(facts->threads)) + 8 * sizeof(double) * ((uint64_t)c.n + c.m) + TABLES_BYTES;
}

int convolver_create(struct convolver **out, const struct convolver_facts *facts, struct fault *f)
{
    struct kernel k;
    struct convolver *c = NULL;
    if (facts_check(facts, f) < 0)
        return -1;
    const struct kernel_facts kernel = kernel_facts_of(facts);
    if (kernel_check(&kernel, f) < 0)
        return -1;
    if (!(c = calloc(1, sizeof(*c))))
        return fault_set(f, FAULT_NO_MEMORY, "params.psf", "psf: no memory for a convolution");
    *c = (struct convolver){ .width = facts->width,
                             .height = facts->height,
                             .grow = facts->grow,
                             .channels = facts->channels,
                             .weight = facts->psf->weight,
                             .cut = facts->psf->kind == PSF_IMAGE };
    kernel_measure(&k, &kernel);
    plan_make(c, facts, &k);
    const unsigned threads = members_for(facts->threads);
    if (bytes_count(c, &k, threads, f) < 0 || memory_take(c, threads, f) < 0 ||
        spectra_make(c, &kernel, f) < 0)
        goto fail;
    c->bound = bound_of(c);
    *out = c;
    return 0;
fail:
    convolver_destroy(c);
    return -1;
}

void convolver_destroy(struct convolver *c)
{
    if (!c)
        return;
    for (unsigned i = 0; i < 3; i++)
        free(c->spectrum[i].value);
    free(c->work);
    for (unsigned i = 0; c->scratch && i < crew_members(c->crew); i++)
        free(c->scratch[i].memory);
    free(c->scratch);
    fft_finish(&c->row);
    fft_finish(&c->column);
    crew_destroy(c->crew);
    free(c);
}

double convolver_bound(const struct convolver *c) { return c->bound; }
double convolver_weight(const struct convolver *c, unsigned channel)
{
    return c->cut ? c->weight * c->outside[channel] : 0;
}
double convolver_outside(const struct convolver *c, unsigned channel) { return c->outside[channel]; }
uint64_t convolver_bytes(const struct convolver *c) { return c->bytes; }
