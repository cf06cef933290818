// SPDX-License-Identifier: Apache-2.0
// kernel_aperture.c - see kernel.h: the light that a polygon diffracts. With k = 2 pi (x, y) and the
// corners u_j,
//     F(k) = -1/|k|^2 sum_j (k x e_j)/(k . e_j) (exp(i k u_j+1) - exp(i k u_j)),   e_j = u_j+1 - u_j,
// which is Green's theorem on the integral of exp(i k u) over the polygon. From a pixel to the next each
// exponential is turned by a constant, so a row needs sines only at its RESYNC points; all sub-samples
// of a pixel go side by side.
#include <math.h>
#include <string.h>

#include "kernel_parts.h"

enum { RESYNC = 64, LANES_MAX = KERNEL_POINTS_MAX };

#define INLINE static inline __attribute__((always_inline))

struct span {
    const struct kernel_polygon *p;
    const struct kernel_points *x, *y;
    double aspect, scale;
    int32_t from, to, row; /* dx, both included; dy */
    double *out;           /* of dx = 0 */
};

void kernel_polygon_make(struct kernel_polygon *p, unsigned corners, double rotation_deg, double cycles)
{
    const double n = corners, turn = 2 * M_PI / n, area = M_PI * cycles * cycles / 4;
    const double radius = sqrt(area / (n / 2 * sin(turn)));
    *p = (struct kernel_polygon){ .corners = corners, .area = area };
    for (unsigned i = 0; i < corners; i++) {
        p->x[i] = radius * cos(rotation_deg * M_PI / 180 + turn * i);
        p->y[i] = radius * sin(rotation_deg * M_PI / 180 + turn * i);
    }
    for (unsigned i = 0; i < corners; i++) {
        p->edge_x[i] = p->x[(i + 1) % corners] - p->x[i];
        p->edge_y[i] = p->y[(i + 1) % corners] - p->y[i];
    }
    p->moment = radius * radius * (2 + cos(turn)) / 12;
    p->extent = corners % 2 ? 2 * radius * cos(M_PI / (2 * n)) : 2 * radius;
}

struct corner_terms {
    double r[LANES_MAX], i[LANES_MAX];
};

// Adds edge a -> b to F: near k . e = 0 the quotient is i times the exponential at the edge's middle.
INLINE void edge_add(double *restrict fr, double *restrict fi, const struct corner_terms *a,
                     const struct corner_terms *b, const double *kx, const double *ky, double ex,
                     double ey, unsigned lanes)
{
    for (unsigned l = 0; l < lanes; l++) {
        const double dot = kx[l] * ex + ky[l] * ey, cross = kx[l] * ey - ky[l] * ex;
        const bool along = fabs(dot) < 1e-5;
        const double over = 1 / (along ? 1 : dot);
        const double mid_r = 0.5 * (a->r[l] + b->r[l]), mid_i = 0.5 * (a->i[l] + b->i[l]);
        const double dr = (b->r[l] - a->r[l]) * over, di = (b->i[l] - a->i[l]) * over;
        fr[l] += cross * (along ? -mid_i : dr);
        fi[l] += cross * (along ? mid_r : di);
    }
}

// |k|^2 <u^2> below 1e-4: the sum above would be a difference of nearly equal numbers; the parabola is
// right to 1e-8.
INLINE double density(const struct kernel_polygon *p, double fr, double fi, double kx, double ky)
{
    const double k2 = kx * kx + ky * ky;
    return k2 * p->moment < 1e-4 ? p->area * (1 - k2 * p->moment)
                                 : (fr * fr + fi * fi) / (k2 * k2 * p->area);
}

double kernel_polygon_at(const struct kernel_polygon *p, double x, double y)
{
    const double kx = 2 * M_PI * x, ky = 2 * M_PI * y;
    double fr = 0, fi = 0;
    for (unsigned j = 0; j < p->corners; j++) {
        const unsigned next = (j + 1) % p->corners;
        const double ta = kx * p->x[j] + ky * p->y[j], tb = kx * p->x[next] + ky * p->y[next];
        const struct corner_terms a = { { cos(ta) }, { sin(ta) } }, b = { { cos(tb) }, { sin(tb) } };
        edge_add(&fr, &fi, &a, &b, &kx, &ky, p->edge_x[j], p->edge_y[j], 1);
    }
    return density(p, fr, fi, kx, ky);
}

struct lanes {
    unsigned n;
    double x[LANES_MAX], y[LANES_MAX],
        weight[LANES_MAX]; /* of sub-samples, in pixel heights from the pixel's middle */
    struct corner_terms at[32];
    double turn_r[32], turn_i[32]; /* from a pixel to the next */
};

INLINE void turn_all(struct lanes *g, const struct span *s, int32_t dx)
{
    const struct kernel_polygon *p = s->p;
    const bool anew = (dx - s->from) % RESYNC == 0;
    for (unsigned j = 0; j < p->corners; j++) {
        double *restrict er = g->at[j].r, *restrict ei = g->at[j].i;
        for (unsigned l = 0; anew && l < g->n; l++) {
            const double t =
                2 * M_PI * ((s->aspect * dx + g->x[l]) * p->x[j] + (s->row + g->y[l]) * p->y[j]);
            er[l] = cos(t);
            ei[l] = sin(t);
        }
        const double turn_r = g->turn_r[j], turn_i = g->turn_i[j];
        for (unsigned l = 0; !anew && l < g->n; l++) {
            const double r = er[l], i = ei[l];
            er[l] = r * turn_r - i * turn_i;
            ei[l] = r * turn_i + i * turn_r;
        }
    }
}

// The sub-samples of g->n, in each of the pixels from .. to.
INLINE void lanes_add(struct lanes *g, const struct span *s)
{
    const struct kernel_polygon *p = s->p;
    double kx[LANES_MAX], ky[LANES_MAX];
    for (unsigned j = 0; j < p->corners; j++) {
        g->turn_r[j] = cos(2 * M_PI * s->aspect * p->x[j]);
        g->turn_i[j] = sin(2 * M_PI * s->aspect * p->x[j]);
    }
    for (unsigned l = 0; l < g->n; l++)
        ky[l] = 2 * M_PI * (s->row + g->y[l]);
    for (int32_t dx = s->from; dx <= s->to; dx++) {
        double fr[LANES_MAX] = { 0 }, fi[LANES_MAX] = { 0 };
        for (unsigned l = 0; l < g->n; l++)
            kx[l] = 2 * M_PI * (s->aspect * dx + g->x[l]);
        turn_all(g, s, dx);
        for (unsigned j = 0; j < p->corners; j++)
            edge_add(fr, fi, &g->at[j], &g->at[(j + 1) % p->corners], kx, ky, p->edge_x[j], p->edge_y[j],
                     g->n);
        for (unsigned l = 0; l < g->n; l++)
            fr[l] = g->weight[l] * density(p, fr[l], fi[l], kx[l], ky[l]);
        double sum = 0;
        for (unsigned l = 0; l < g->n; l++)
            sum += fr[l];
        s->out[dx] += s->scale * s->aspect * sum;
    }
}

INLINE void span_lines(const struct span *s)
{
    struct lanes g = { .n = 0 };
    for (int32_t dx = s->from; dx <= s->to; dx++)
        s->out[dx] = 0;
    for (unsigned y = 0; y < s->y->n; y++) {
        for (unsigned x = 0; x < s->x->n; x++, g.n++) {
            g.x[g.n] = s->aspect * s->x->at[x];
            g.y[g.n] = s->y->at[y];
            g.weight[g.n] = s->x->weight[x] * s->y->weight[y];
        }
        if (g.n + s->x->n > LANES_MAX || y + 1 == s->y->n) {
            lanes_add(&g, s);
            g.n = 0;
        }
    }
}

#if defined(__x86_64__)
__attribute__((target("avx2"))) static void span_avx2(const struct span *s) { span_lines(s); }
#endif
static void span_plain(const struct span *s) { span_lines(s); }

static void span_draw(const struct span *s)
{
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2")) {
        span_avx2(s);
        return;
    }
#endif
    span_plain(s);
}

struct aperture {
    struct kernel *k;
    double aspect;
    struct kernel_polygon near, far;
    struct kernel_points near_x, near_y, far_x, far_y;
    double near_scale, far_scale;
};

static void row_draw(void *ctx, unsigned task, unsigned member)
{
    (void)member;
    const struct aperture *a = ctx;
    const struct kernel *k = a->k;
    const int32_t dy = (int32_t)task, width = k->max_x - k->min_x + 1;
    const int32_t rim = k->max_x < KERNEL_NEAR ? k->max_x : KERNEL_NEAR;
    double *out = k->value + (size_t)dy * (size_t)width - k->min_x;
    struct span far = { &a->far,  &a->far_x, &a->far_y, a->aspect, a->far_scale,
                        k->min_x, k->max_x,  dy,        out };
    if (dy > KERNEL_NEAR) {
        span_draw(&far);
        return;
    }
    far.to = -rim - 1;
    span_draw(&far);
    far.from = rim + 1;
    far.to = k->max_x;
    span_draw(&far);
    const struct span near = { &a->near, &a->near_x, &a->near_y, a->aspect, a->near_scale,
                               -rim,     rim,        dy,         out };
    span_draw(&near);
}

static void sums_take(const struct kernel *k, double *near, double *far)
{
    *near = *far = 0;
    const double *v = k->value;
    for (int32_t dy = 0; dy <= k->max_y; dy++) {
        double row_near = 0, row_far = 0;
        for (int32_t dx = k->min_x; dx <= k->max_x; dx++, v++) {
            const bool is_near = dy <= KERNEL_NEAR && dx >= -KERNEL_NEAR && dx <= KERNEL_NEAR;
            *(is_near ? &row_near : &row_far) += *v;
        }
        // Rows above the middle are those below.
        *near += dy ? 2 * row_near : row_near;
        *far += dy ? 2 * row_far : row_far;
    }
}

void kernel_draw_aperture(struct kernel *k, const struct kernel_facts *facts, double cycles,
                          struct crew *crew)
{
    struct aperture a = { .k = k, .aspect = facts->pixel_aspect };
    const struct psf_spec *s = facts->psf;
    const double near = fmin(cycles, KERNEL_FINEST), far = fmin(cycles, KERNEL_FINEST_FAR);
    kernel_polygon_make(&a.near, s->blades, s->rotation_deg, near);
    kernel_polygon_make(&a.far, s->blades, s->rotation_deg, far);
    a.near_scale = near / cycles;
    a.far_scale = far / cycles;
    kernel_points_make(&a.near_x, kernel_points_for(a.near.extent * a.aspect));
    kernel_points_make(&a.near_y, kernel_points_for(a.near.extent));
    const unsigned far_x = kernel_points_for(a.far.extent * a.aspect),
                   far_y = kernel_points_for(a.far.extent);
    kernel_points_make(&a.far_x, far_x > 2 ? far_x - 2 : 2);
    kernel_points_make(&a.far_y, far_y > 2 ? far_y - 2 : 2);
    crew_run(crew, (unsigned)k->max_y + 1, row_draw, &a);

    // near: of all light a share of near / near_scale falls on the near pixels of the pattern that was
    // drawn; what of it lies beyond them falls with 1 / B too.
    double near_sum, far_sum, *middle = k->value - k->min_x;
    sums_take(k, &near_sum, &far_sum);
    const double beyond = fmax(0, a.near_scale - near_sum);
    *middle += 1 - a.near_scale;
    k->outside = fmax(0, beyond - far_sum);
}
