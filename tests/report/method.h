/* SPDX-License-Identifier: Apache-2.0 */
/*
 * method.h - the blurs that the field uses, written as a good C programmer would: float32, two threads, loops
 * that the compiler vectorises, no bound, no NaN, nothing skipped. They are what the engine is compared with.
 *
 * Each does out = in + sum of weight_i * (its G(sigma_i)) * max(in - threshold, 0). Each gets the sigma right as
 * well as it can: its free number (an offset, a mix of two levels) is set so that the second moment of its kernel
 * is sigma^2. What is left is the method's own error: its shape, and how it changes with the phase. Light that
 * leaves the frame at a coarse level is not kept in an apron: near a border they err more than is measured here.
 */
#ifndef AIRY_REPORT_METHOD_H
#define AIRY_REPORT_METHOD_H

#include "bench.h"

enum { METHOD_GAUSSIANS_MAX = 8 };

struct blur_job {
    uint32_t width, height;
    unsigned channels; /* 1 or 3 */
    unsigned n;        /* Gaussians, widest last */
    double sigma[METHOD_GAUSSIANS_MAX], weight[METHOD_GAUSSIANS_MAX];
    float threshold;
    struct team *team; /* the caller's, as long as the method */
};

struct method {
    const char *name;
    const char *how; /* for people */
    void *(*create)(const struct blur_job *j); /* NULL: cannot do that job */
    /* FLOAT planes of the job's size and channels. */
    void (*run)(void *self, const struct planes *in, const struct planes *out);
    void (*destroy)(void *self);
};

extern const struct method method_kawase, method_dual, method_tent, method_box, method_recursive, method_fft,
    method_direct, method_c_chain;
enum { METHODS = 8 };
extern const struct method *const methods[METHODS];

/* ---- for their files ------------------------------------------------------------------------------------- */

/* Planes of floats with zeros around, for filters to read beyond the border. */
struct grid {
    long width, height, pad; /* pad rows above and below; pad_x floats left and right */
    long pad_x;
    size_t stride;
    float *memory; /* owned */
};
bool grid_init(struct grid *g, long width, long height, unsigned planes, long pad);
void grid_finish(struct grid *g);
static inline float *grid_row(const struct grid *g, unsigned c, long y)
{
    return g->memory + ((size_t)c * (size_t)(g->height + 2 * g->pad) + (size_t)(y + g->pad)) * g->stride + g->pad_x;
}

/* Rows first .. last of a member's part of n. */
static inline long part_first(long n, unsigned member) { return n * (long)member / TEAM; }

/* max(in - threshold, 0) of this member's rows. */
void grid_bright(const struct grid *g, const struct planes *in, float threshold, unsigned member);

#endif
