/* SPDX-License-Identifier: Apache-2.0 */
/*
 * kernel.h - a PSF that is no sum of Gaussians, drawn out in float64: one number a pixel, one channel at a time. Pure
 * arithmetic; the numbers do not depend on the number of threads.
 *
 * What is drawn: k[dx, dy] = integral of the PSF over the pixel at (dx, dy) from its middle (a pixel is pixel_aspect wide and 1 high),
 * for all |dx| <= reach_x, |dy| <= reach_y, then normalised to sum 1. The weight is not in it. Of each model:
 *   eye       Spencer, Shirley, Zimmerman, Greenberg 1995, photopic: .384 f0 + .478 f1 + .138 f2 with f0 = 2.61e6 exp(-(a / .02)^2),
 *             f1 = 20.91 / (a + .02)^3, f2 = 72.37 / (a + .02)^2, a in degrees = distance * degrees / height of the picture. (Their
 *             .282 .478 .207 .033 are the scotopic eye.) The same for all channels.
 *   airy      (2 J1(v) / v)^2, v = pi r pitch / (lambda N).
 *   aperture  |F|^2 of a regular polygon of `blades` corners, one of them rotation_deg from +x towards +y, as wide as gives it the
 *             area of the round aperture of that f-number; F in closed form, so that no grid of the aperture enters.
 *   image     the picture's floats, pixel for pixel (pixel_aspect does not enter), its middle at (w / 2, h / 2). It is normalised over
 *             the whole picture; what lies beyond reach_x, reach_y is cut off and said in `outside`.
 *
 * How: eye and airy are radial, so the integral over a pixel is one along its border: with T(r) the energy beyond r,
 * integral = [origin inside] T(0) - 1/2pi of the closed integral of T dphi. T is known in closed form for both (airy: J0^2 + J1^2), so a
 * core that is far smaller than a pixel is as exact as a wide one. Aperture: Gauss-Legendre points, enough for 1e-5 of a
 * ripple within KERNEL_NEAR pixels of the middle and 1e-2 beyond.
 * Finer than can be drawn: let B = pitch / (lambda N), cycles a pixel. Above KERNEL_FINEST (for an aperture's far pixels above
 * KERNEL_FINEST_FAR) the ripples are drawn as of that B, and their energy scaled by the quotient, as the tail's falls with 1 / B; the middle
 * pixel has the rest.
 */
#ifndef AIRYD_KERNEL_H
#define AIRYD_KERNEL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "crew.h"
#include "fault.h"
#include "params.h"

enum { KERNEL_SIDE_MAX = 1 << 17, KERNEL_NEAR = 64, KERNEL_FINEST = 16 };
#define KERNEL_FINEST_FAR 2.5

/* What of k is kept: k[-dx, dy] = k[dx, -dy] = k[dx, dy]; k[-dx, -dy] = k[dx, dy]; nothing. */
enum kernel_symmetry { KERNEL_MIRRORED, KERNEL_CENTRAL, KERNEL_ANY };

struct kernel_facts {
    const struct psf_spec *psf; /* not PSF_GAUSSIANS */
    uint32_t reach_x, reach_y;  /* < KERNEL_SIDE_MAX / 2 */
    double pixel_aspect;
    uint32_t picture_height;    /* eye */
    const float *image;         /* PSF_IMAGE: interleaved RGB, finite, >= 0; the caller's */
    uint32_t image_width, image_height;
};

struct kernel {
    enum kernel_symmetry symmetry;
    int32_t min_x, max_x, min_y, max_y; /* kept; MIRRORED: from 0, CENTRAL: min_y is 0 */
    double *value;                      /* rows of max_x - min_x + 1; owned */
    double outside; /* share of the true PSF beyond the kept pixels. Eye: of all within 90 degrees, taken as flat */
};

/* Faults: PARAM_RANGE of params.psf (sizes, an image's numbers), NO_MEMORY. Only the kind's own facts are looked at. */
int kernel_check(const struct kernel_facts *facts, struct fault *f);
/* Whether two channels have the same kernel. */
bool kernel_same(const struct psf_spec *psf, unsigned a, unsigned b);
/* How far it reaches: the kept columns and rows, before it is drawn (value and outside are not set). Facts were checked. */
void kernel_measure(struct kernel *k, const struct kernel_facts *facts);
/* Channel 0..2. Facts were checked. 0, or -1 and *f (NO_MEMORY). */
int kernel_draw(struct kernel *k, const struct kernel_facts *facts, unsigned channel, struct crew *crew, struct fault *f);
void kernel_finish(struct kernel *k);

static inline double kernel_at(const struct kernel *k, int32_t dx, int32_t dy)
{
    if (k->symmetry != KERNEL_ANY && dy < 0) {
        dx = -dx;
        dy = -dy;
    }
    if (k->symmetry == KERNEL_MIRRORED && dx < 0)
        dx = -dx;
    if (dx < k->min_x || dx > k->max_x || dy < k->min_y || dy > k->max_y)
        return 0;
    return k->value[(size_t)(dy - k->min_y) * (size_t)(k->max_x - k->min_x + 1) + (size_t)(dx - k->min_x)];
}

#endif
