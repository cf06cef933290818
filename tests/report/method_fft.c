// SPDX-License-Identifier: Apache-2.0
// method_fft.c - convolution by FFT, float32: the sum of Gaussians as one real spectrum, sizes 2^a 3^b 5^c with room for 5.5
// sigma, so that nothing wraps around. Stockham's form, 16 signals beside each other in SIMD lanes; two channels are one
// complex signal, as the kernel is even.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "method.h"

enum { LANES = 16, STAGES_MAX = 24 };

struct fft {
    long n;
    unsigned stages, radix[STAGES_MAX];
    float *cosine, *sine; /* [n] */
};

/* LANES complex numbers. */
struct cell {
    float re[LANES], im[LANES];
};

struct convolution {
    struct blur_job job;
    struct fft x, y;
    float *kernel_x[METHOD_GAUSSIANS_MAX], *kernel_y[METHOD_GAUSSIANS_MAX]; /* spectra, real */
    struct cell *line[TEAM], *other[TEAM];
    long blocks;
    struct cell *field[2]; /* [blocks][height]: LANES columns a block; of channel pairs */
    const struct planes *in, *out;
};

/* ---- one dimension ------------------------------------------------------------------------------------------ */

static bool fft_plan(struct fft *f, long n)
{
    static const unsigned radix[] = { 4, 2, 3, 5 };
    long rest = n;
    f->n = n;
    for (unsigned i = 0; i < 4; i++)
        for (; rest % radix[i] == 0 && f->stages < STAGES_MAX; rest /= radix[i])
            f->radix[f->stages++] = radix[i];
    if (rest != 1)
        return false;
    f->cosine = take((size_t)n, sizeof(float));
    f->sine = take((size_t)n, sizeof(float));
    for (long i = 0; i < n; i++) {
        f->cosine[i] = (float)cos(2 * M_PI * (double)i / (double)n);
        f->sine[i] = (float)-sin(2 * M_PI * (double)i / (double)n);
    }
    return true;
}

static void turn(struct cell *restrict to, const float *restrict re, const float *restrict im, float c, float s)
{
    for (int k = 0; k < LANES; k++) {
        to->re[k] = re[k] * c - im[k] * s;
        to->im[k] = re[k] * s + im[k] * c;
    }
}

static void butterfly_4(struct cell *restrict to, long step, const struct cell *restrict a, long gap, const float c[4],
                        const float s[4])
{
    float re[4][LANES], im[4][LANES];
    for (int k = 0; k < LANES; k++) {
        float ar = a[0].re[k] + a[2 * gap].re[k], ai = a[0].im[k] + a[2 * gap].im[k];
        float br = a[0].re[k] - a[2 * gap].re[k], bi = a[0].im[k] - a[2 * gap].im[k];
        float cr = a[gap].re[k] + a[3 * gap].re[k], ci = a[gap].im[k] + a[3 * gap].im[k];
        float dr = a[gap].re[k] - a[3 * gap].re[k], di = a[gap].im[k] - a[3 * gap].im[k];
        re[0][k] = ar + cr, im[0][k] = ai + ci;
        re[1][k] = br + di, im[1][k] = bi - dr;
        re[2][k] = ar - cr, im[2][k] = ai - ci;
        re[3][k] = br - di, im[3][k] = bi + dr;
    }
    for (int i = 0; i < 4; i++)
        turn(&to[i * step], re[i], im[i], c[i], s[i]);
}

/* cos and -sin of 2 pi k / r for r = 2, 3, 5. */
static const float ROOT_RE[6][5] = { [2] = { 1, -1 }, [3] = { 1, -.5f, -.5f },
                                     [5] = { 1, .309016994f, -.809016994f, -.809016994f, .309016994f } };
static const float ROOT_IM[6][5] = { [3] = { 0, -.866025404f, .866025404f },
                                     [5] = { 0, -.951056516f, -.587785252f, .587785252f, .951056516f } };

static void butterfly(unsigned r, struct cell *restrict to, long step, const struct cell *restrict a, long gap,
                      const float c[5], const float s[5])
{
    for (unsigned i = 0; i < r; i++) {
        float re[LANES] = { 0 }, im[LANES] = { 0 };
        for (unsigned j = 0; j < r; j++) {
            float wc = ROOT_RE[r][i * j % r], ws = ROOT_IM[r][i * j % r];
            const struct cell *v = &a[j * gap];
            for (int k = 0; k < LANES; k++) {
                re[k] += v->re[k] * wc - v->im[k] * ws;
                im[k] += v->re[k] * ws + v->im[k] * wc;
            }
        }
        turn(&to[i * step], re, im, c[i], s[i]);
    }
}

// Decimation in frequency, in order; the result is in what is returned, v or w.
static struct cell *fft_run(const struct fft *f, struct cell *v, struct cell *w)
{
    long done = 1;
    for (unsigned i = 0; i < f->stages; i++) {
        unsigned r = f->radix[i];
        long left = f->n / (done * r);
        for (long p = 0; p < left; p++) {
            float c[5], s[5];
            for (unsigned k = 0; k < r; k++) {
                c[k] = f->cosine[p * k * done % f->n];
                s[k] = f->sine[p * k * done % f->n];
            }
            for (long q = 0; q < done; q++)
                if (r == 4)
                    butterfly_4(&w[q + done * 4 * p], done, &v[q + done * p], done * left, c, s);
                else
                    butterfly(r, &w[q + done * r * p], done, &v[q + done * p], done * left, c, s);
        }
        struct cell *swap = v;
        v = w;
        w = swap;
        done *= r;
    }
    return v;
}

// Back: the conjugate of the conjugate's transform, by swapping the parts.
static void swap_parts(struct cell *v, long n)
{
    for (long i = 0; i < n; i++)
        for (int k = 0; k < LANES; k++) {
            float t = v[i].re[k];
            v[i].re[k] = v[i].im[k];
            v[i].im[k] = t;
        }
}

/* ---- life ------------------------------------------------------------------------------------------------------ */

static long good_size(long least)
{
    for (long n = least;; n++) {
        long rest = n;
        for (long p = 2; p <= 5; p++)
            while (rest % p == 0)
                rest /= p;
        if (rest == 1)
            return n;
    }
}

// The transform of the sampled Gaussian, and 1 / n of the way back.
static float *spectrum(double sigma, double gain, long n)
{
    float *s = take((size_t)n, sizeof(float));
    double *wave = take((size_t)n, sizeof(double)), sum = 1;
    long reach = (long)ceil(5.5 * sigma);
    for (long i = 0; i < n; i++)
        wave[i] = cos(2 * M_PI * (double)i / (double)n);
    for (long x = 1; x <= reach; x++)
        sum += 2 * exp(-(double)(x * x) / (2 * sigma * sigma));
    for (long i = 0; i < n; i++) {
        double v = 1;
        for (long x = 1; x <= reach; x++)
            v += 2 * exp(-(double)(x * x) / (2 * sigma * sigma)) * wave[i * x % n];
        s[i] = (float)(gain * v / sum / (double)n);
    }
    free(wave);
    return s;
}

static void destroy(void *self)
{
    struct convolution *v = self;
    for (unsigned i = 0; i < METHOD_GAUSSIANS_MAX; i++) {
        free(v->kernel_x[i]);
        free(v->kernel_y[i]);
    }
    for (unsigned t = 0; t < TEAM; t++) {
        free(v->line[t]);
        free(v->other[t]);
    }
    free(v->field[0]);
    free(v->field[1]);
    free(v->x.cosine);
    free(v->x.sine);
    free(v->y.cosine);
    free(v->y.sine);
    free(v);
}

static struct cell *cells(size_t n)
{
    struct cell *c = NULL;
    return posix_memalign((void **)&c, 64, n * sizeof(*c)) ? NULL : c;
}

static void *create(const struct blur_job *j)
{
    struct convolution *v = take(1, sizeof(*v));
    long reach = (long)ceil(5.5 * j->sigma[j->n - 1]), n;
    v->job = *j;
    if (!fft_plan(&v->x, good_size(j->width + reach)) || !fft_plan(&v->y, good_size(j->height + reach)))
        goto fail;
    for (unsigned i = 0; i < j->n; i++) {
        v->kernel_x[i] = spectrum(j->sigma[i], j->weight[i], v->x.n);
        v->kernel_y[i] = spectrum(j->sigma[i], 1, v->y.n);
    }
    n = v->x.n > v->y.n ? v->x.n : v->y.n;
    v->blocks = (v->x.n + LANES - 1) / LANES;
    for (unsigned t = 0; t < TEAM; t++)
        if (!(v->line[t] = cells((size_t)n)) || !(v->other[t] = cells((size_t)n)))
            goto fail;
    for (unsigned p = 0; p < (j->channels + 1) / 2; p++)
        if (!(v->field[p] = cells((size_t)v->blocks * j->height)))
            goto fail;
    return v;
fail:
    destroy(v);
    return NULL;
}

/* ---- run ------------------------------------------------------------------------------------------------------- */

static struct cell *field_at(const struct convolution *v, unsigned pair, long block, long y)
{
    return v->field[pair] + block * (long)v->job.height + y;
}

static void load_rows(const struct convolution *v, unsigned pair, long y, long rows, struct cell *line)
{
    memset(line, 0, (size_t)v->x.n * sizeof(*line));
    for (unsigned part = 0; part < 2 && 2 * pair + part < v->job.channels; part++)
        for (long k = 0; k < rows; k++) {
            const float *in = (const float *)planes_row(v->in, 2 * pair + part, (uint32_t)(y + k));
            for (long x = 0; x < v->job.width; x++)
                (part ? line[x].im : line[x].re)[k] = in[x] > v->job.threshold ? in[x] - v->job.threshold : 0;
        }
}

static void rows_there(struct convolution *v, unsigned pair, long y, long rows, unsigned member)
{
    load_rows(v, pair, y, rows, v->line[member]);
    const struct cell *f = fft_run(&v->x, v->line[member], v->other[member]);
    for (long b = 0; b < v->blocks; b++)
        for (long k = 0; k < rows; k++) {
            struct cell *to = field_at(v, pair, b, y + k);
            for (long i = 0; i < LANES && b * LANES + i < v->x.n; i++) {
                to->re[i] = f[b * LANES + i].re[k];
                to->im[i] = f[b * LANES + i].im[k];
            }
        }
}

static void multiply(const struct convolution *v, struct cell *f, long block)
{
    for (long y = 0; y < v->y.n; y++) {
        float gain[LANES] = { 0 };
        for (unsigned i = 0; i < v->job.n; i++)
            for (long k = 0; k < LANES && block * LANES + k < v->x.n; k++)
                gain[k] += v->kernel_x[i][block * LANES + k] * v->kernel_y[i][y];
        for (int k = 0; k < LANES; k++) {
            f[y].re[k] *= gain[k];
            f[y].im[k] *= gain[k];
        }
    }
}

static void columns(struct convolution *v, unsigned pair, long block, unsigned member)
{
    struct cell *line = v->line[member], *other = v->other[member], *field = field_at(v, pair, block, 0);
    size_t inside = v->job.height;
    memcpy(line, field, inside * sizeof(*line));
    memset(line + inside, 0, ((size_t)v->y.n - inside) * sizeof(*line));
    struct cell *f = fft_run(&v->y, line, other);
    multiply(v, f, block);
    swap_parts(f, v->y.n);
    f = fft_run(&v->y, f, f == line ? other : line);
    swap_parts(f, v->y.n);
    memcpy(field, f, inside * sizeof(*f));
}

static void rows_back(struct convolution *v, unsigned pair, long y, long rows, unsigned member)
{
    struct cell *line = v->line[member];
    for (long b = 0; b < v->blocks; b++)
        for (long k = 0; k < rows; k++) {
            // The parts change places on the way in, for the way back.
            const struct cell *from = field_at(v, pair, b, y + k);
            for (long i = 0; i < LANES && b * LANES + i < v->x.n; i++) {
                line[b * LANES + i].re[k] = from->im[i];
                line[b * LANES + i].im[k] = from->re[i];
            }
        }
    const struct cell *f = fft_run(&v->x, line, v->other[member]);
    for (unsigned part = 0; part < 2 && 2 * pair + part < v->job.channels; part++)
        for (long k = 0; k < rows; k++) {
            const float *in = (const float *)planes_row(v->in, 2 * pair + part, (uint32_t)(y + k));
            float *out = (float *)planes_row(v->out, 2 * pair + part, (uint32_t)(y + k));
            for (long x = 0; x < v->job.width; x++)
                out[x] = in[x] + (part ? f[x].re : f[x].im)[k];
        }
}

static void all_rows(struct convolution *v, void (*fn)(struct convolution *, unsigned, long, long, unsigned), unsigned member)
{
    long first = part_first(v->job.height, member), last = part_first(v->job.height, member + 1);
    for (unsigned p = 0; p < (v->job.channels + 1) / 2; p++)
        for (long y = first; y < last; y += LANES)
            fn(v, p, y, last - y < LANES ? last - y : LANES, member);
}

static void member_run(void *ctx, unsigned member)
{
    struct convolution *v = ctx;
    all_rows(v, rows_there, member);
    team_meet(v->job.team);
    for (unsigned p = 0; p < (v->job.channels + 1) / 2; p++)
        for (long b = part_first(v->blocks, member); b < part_first(v->blocks, member + 1); b++)
            columns(v, p, b, member);
    team_meet(v->job.team);
    all_rows(v, rows_back, member);
}

static void run(void *self, const struct planes *in, const struct planes *out)
{
    struct convolution *v = self;
    v->in = in;
    v->out = out;
    team_run(v->job.team, member_run, v);
}

const struct method method_fft = { "FFT on the CPU", "mixed radix, float32, padded by 5.5 sigma", create, run, destroy };
