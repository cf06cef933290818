/* SPDX-License-Identifier: Apache-2.0 */
/*
 * by_hand.h - what the two tests of the reference share: a request, a frame, and closed forms that use none of the
 * reference's own parts, for it is the judge of everything else.
 */
#ifndef AIRY_BY_HAND_H
#define AIRY_BY_HAND_H

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "reference/reference.h"

static inline struct params asked(const char *bright, double threshold, double knee, const char *psf)
{
    struct params p;
    params_init(&p);
    assert_int_equal(params_set_text(&p, "bright", bright, NULL), 0);
    assert_int_equal(params_set_number(&p, "threshold", threshold, NULL), 0);
    assert_int_equal(params_set_number(&p, "knee", knee, NULL), 0);
    assert_int_equal(params_set_number(&p, "intensity", 1, NULL), 0);
    assert_int_equal(params_set_text(&p, "psf", psf, NULL), 0);
    return p;
}

static inline struct reference_frame frame_of(const double *plane, unsigned w, unsigned h)
{
    return (struct reference_frame){
        .width = w, .height = h, .channels = 1, .plane = { plane }, .pixel_aspect = 1
    };
}

static inline void near_to(double got, double wanted, double relative, const char *what)
{
    if (!(fabs(got - wanted) <= relative * fabs(wanted)))
        fail_msg("%s: %.17g, wanted %.17g", what, got, wanted);
}

static inline double bright_y(const struct params *p, double v)
{
    double e[3], pixel[3] = { v };
    reference_bright(e, pixel, 1, NULL, p);
    return e[0];
}

static inline double gaussian(long n, double sigma) { return exp(-(double)(n * n) / (2 * sigma * sigma)); }

static inline double gaussian_sum(double sigma)
{
    double sum = 1;
    for (long n = 1; n < 40 * sigma + 40; n++)
        sum += 2 * gaussian(n, sigma);
    return sum;
}

static inline double random_unit(void)
{
    static uint64_t seed = 88172645463325252u;
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (double)(seed >> 11) * 0x1p-53;
}

static inline double *random_plane(size_t n, double spread)
{
    double *v = malloc(n * sizeof(double));
    assert_non_null(v);
    for (size_t i = 0; i < n; i++)
        v[i] = exp2((random_unit() - .5) * spread);
    return v;
}

#endif
