// SPDX-License-Identifier: Apache-2.0
// kernel_radial.c - see kernel.h: the eye and the Airy pattern, from the energy T(r) beyond r. Of a
// pixel's border only the parts along x and y are ever integrated, each for one edge: V(i, j), the right
// one, and H(i, j), the lower one; a pixel is a sum of four. Four numbers of about 1/r^2 leave one of
// 1/r^3, so of float64's 16 digits about 12 are left at r = 4000.
#include <errno.h>
#include <math.h>
#include <stdlib.h>

#include "kernel_parts.h"

enum { BAND = 8, CLOSE = 4, MIDDLE = 16, TABLE_MAX = 1 << 20 };
static const double table_step = 0.05; /* in v: a cubic is then right to 2e-7 / v^2 */

struct radial {
    struct kernel *k;
    double aspect;
    double degrees; /* a pixel; 0: airy */
    double v;       /* airy: v a pixel */
    double *table;  /* T and T' step, in turn */
    size_t table_count;
    struct kernel_points close, middle, far;
};

double kernel_airy_beyond(double v)
{
    if (v < 256) {
        const double a = j0(v), b = j1(v);
        return a * a + b * b;
    }
    // Hankel's expansions (Abramowitz and Stegun 9.2.5, 9.2.9, 9.2.10) to v^-3; what is left out is
    // below 1e-10 of it.
    const double q = 1 / (v * v), p0 = 1 - 9.0 / 128 * q, q0 = (-1.0 / 8 + 75.0 / 1024 * q) / v;
    const double p1 = 1 + 15.0 / 128 * q, q1 = (3.0 / 8 - 105.0 / 1024 * q) / v;
    const double s = sin(v - M_PI_4), c = cos(v - M_PI_4);
    const double a = p0 * c - q0 * s, b = p1 * s + q1 * c;
    return 2 / (M_PI * v) * (a * a + b * b);
}

static const double eye_core = 0.02, eye_share[3] = { .384, .478, .138 };

double kernel_eye_at(double degrees)
{
    const double u = degrees + eye_core, g = degrees / eye_core;
    return eye_share[0] * 2.61e6 * exp(-g * g) + eye_share[1] * 20.91 / (u * u * u) +
           eye_share[2] * 72.37 / (u * u);
}

double kernel_eye_beyond(double degrees)
{
    const double a = eye_core, u = degrees + a, g = degrees / a, end = 90 + a;
    const double f0 = 2.61e6 * M_PI * a * a * exp(-g * g);
    const double f1 = 2 * M_PI * 20.91 * (1 / u - a / (2 * u * u));
    const double f2 = 2 * M_PI * 72.37 * (log(end / u) + a / end - a / u);
    return eye_share[0] * f0 + eye_share[1] * f1 + eye_share[2] * f2;
}

static double beyond(const struct radial *g, double r)
{
    if (g->degrees > 0)
        return kernel_eye_beyond(r * g->degrees);
    const double v = r * g->v, at = v / table_step;
    if (at >= (double)g->table_count - 1)
        return kernel_airy_beyond(v);
    const size_t i = (size_t)at;
    const double t = at - (double)i, s = 1 - t, *n = g->table + 2 * i;
    return s * s * ((1 + 2 * t) * n[0] + t * n[1]) + t * t * ((1 + 2 * s) * n[2] - s * n[3]);
}

// d(J0^2 + J1^2)/dv = -2 J1^2 / v.
static int table_make(struct radial *g, double v_max)
{
    g->table_count = (size_t)fmin(v_max / table_step + 3, TABLE_MAX);
    g->table = malloc(g->table_count * 2 * sizeof(*g->table));
    if (!g->table)
        return -ENOMEM;
    for (size_t i = 0; i < g->table_count; i++) {
        const double v = (double)i * table_step, b = i ? j1(v) : 0;
        g->table[2 * i] = kernel_airy_beyond(v);
        g->table[2 * i + 1] = i ? -2 * b * b / v * table_step : 0;
    }
    return 0;
}

// The integral of T dphi along an edge at `distance` from the middle, between along -+ length / 2.
static double edge_of(const struct radial *g, const struct kernel_points *p, double distance,
                      double along, double length)
{
    double sum = 0;
    for (unsigned n = 0; n < p->n; n++) {
        const double t = along + p->at[n] * length, q = distance * distance + t * t;
        sum += p->weight[n] * beyond(g, sqrt(q)) / q;
    }
    return sum * distance * length;
}

static const struct kernel_points *points_of(const struct radial *g, int32_t i, int32_t j)
{
    const int32_t far = i > j ? i : j;
    return far < CLOSE ? &g->close : far < MIDDLE ? &g->middle : &g->far;
}

static double right_of(const struct radial *g, int32_t i, int32_t j)
{
    return edge_of(g, points_of(g, i, j), (i + 0.5) * g->aspect, j, 1);
}

static double below(const struct radial *g, int32_t i, int32_t j)
{
    return edge_of(g, points_of(g, i, j), j + 0.5, i * g->aspect, g->aspect);
}

// One band: the lower edges of a row are the upper ones of the next, so they are handed on in the row
// that they will become: value[j + 1][i] holds H(i, j) until its turn.
static void band_draw(void *ctx, unsigned task, unsigned member)
{
    (void)member;
    struct radial *g = ctx;
    struct kernel *k = g->k;
    const int32_t columns = k->max_x + 1, first = (int32_t)task * BAND;
    const int32_t last = first + BAND - 1 < k->max_y ? first + BAND - 1 : k->max_y;
    for (int32_t j = first; j <= last; j++) {
        double *row = k->value + (size_t)j * (size_t)columns;
        double left = -right_of(g, 0, j);
        for (int32_t i = 0; i < columns; i++) {
            const double above = j == 0 ? -below(g, i, 0) : j == first ? below(g, i, j - 1) : row[i];
            const double right = right_of(g, i, j), low = below(g, i, j);
            row[i] = (left - right + above - low) / (2 * M_PI);
            if (j < last)
                row[i + columns] = low;
            left = right;
        }
    }
}

int kernel_draw_radial(struct kernel *k, const struct kernel_facts *facts, double cycles, double *total,
                       struct crew *crew)
{
    struct radial g = { .k = k, .aspect = facts->pixel_aspect };
    const double r_max = hypot((k->max_x + 1) * g.aspect, k->max_y + 1);
    unsigned points = 4;
    if (cycles > 0) {
        g.v = M_PI * cycles;
        points = kernel_points_for(cycles * fmax(1, g.aspect));
        if (table_make(&g, g.v * r_max) < 0)
            return -ENOMEM;
    } else {
        g.degrees = facts->psf->degrees / facts->picture_height;
    }
    kernel_points_make(&g.close, KERNEL_POINTS_MAX);
    kernel_points_make(&g.middle, points > 16 ? points : 16);
    kernel_points_make(&g.far, points > 4 ? points : 4);
    crew_run(crew, (unsigned)(k->max_y / BAND + 1), band_draw, &g);
    *total = beyond(&g, 0);
    k->value[0] += *total;
    free(g.table);
    return 0;
}
