/* SPDX-License-Identifier: Apache-2.0 */
/*
 * kernel_parts.h - what kernel.c shares with its models, and what the tests hold against published facts.
 */
#ifndef AIRYD_KERNEL_PARTS_H
#define AIRYD_KERNEL_PARTS_H

#include "kernel.h"

/* n points in -1/2 .. 1/2 with weights of sum 1, Gauss-Legendre. */
enum { KERNEL_POINTS_MAX = 64 };
struct kernel_points {
    unsigned n;
    double at[KERNEL_POINTS_MAX], weight[KERNEL_POINTS_MAX];
};
void kernel_points_make(struct kernel_points *p, unsigned n);
/* Enough for ripples of `cycles` within the length, to 1e-5 of the ripple; even, 2 .. KERNEL_POINTS_MAX. */
unsigned kernel_points_for(double cycles);

/* Energy beyond v of the Airy pattern, J0^2 + J1^2. */
double kernel_airy_beyond(double v);
/* Energy beyond an angle of the photopic eye, up to 90 degrees, as if the angles were a plane, in its paper's unit (per steradian)
 * times square degrees: 1 is (180 / pi)^2. Below 0 beyond 90 degrees. */
double kernel_eye_beyond(double degrees);
double kernel_eye_at(double degrees); /* the density */

struct kernel_polygon {
    unsigned corners;
    double x[32], y[32], edge_x[32], edge_y[32]; /* cycles a pixel; edge i leads from corner i to the next */
    double area, moment;                         /* moment: mean of x^2 over the polygon, = that of y^2 */
    double extent;                               /* largest distance of two corners: the finest ripple */
};
/* cycles: B of the round aperture of the same area. */
void kernel_polygon_make(struct kernel_polygon *p, unsigned corners, double rotation_deg, double cycles);
/* Density at (x, y) pixel heights from the middle; integrates to 1 over the plane. */
double kernel_polygon_at(const struct kernel_polygon *p, double x, double y);

/* Fill value[] and outside; not normalised. total: the sum over the whole plane. 0, or -ENOMEM. */
int kernel_draw_radial(struct kernel *k, const struct kernel_facts *facts, double cycles, double *total, struct crew *crew);
void kernel_draw_aperture(struct kernel *k, const struct kernel_facts *facts, double cycles, struct crew *crew);

#endif
