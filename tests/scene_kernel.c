// SPDX-License-Identifier: Apache-2.0
// scene_kernel.c - see scene_kernel.h.
#include "scene_kernel.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

#include "crew.h"
#include "kernel.h"

/* k for all |dx| <= reach_x, |dy| <= reach_y, in rows. */
struct table {
    size_t reach_x, reach_y, stride;
    double *value;
};

/* Adds share * the kernel of one channel. */
static void draw(struct table *t, const struct kernel_facts *facts, unsigned channel, double share)
{
    struct kernel k;
    struct crew *crew;
    struct fault f;
    if (kernel_check(facts, &f) < 0)
        fail_msg("%s", f.text);
    assert_int_equal(crew_create(&crew, 1), 0);
    assert_int_equal(kernel_draw(&k, facts, channel, crew, &f), 0);
    crew_destroy(crew);
    for (size_t y = 0; y <= 2 * t->reach_y; y++)
        for (size_t x = 0; x <= 2 * t->reach_x; x++)
            t->value[y * t->stride + x] +=
                share * kernel_at(&k, (int32_t)x - (int32_t)t->reach_x, (int32_t)y - (int32_t)t->reach_y);
    kernel_finish(&k);
}

static void add_scaled(double *restrict out, const double *restrict in, double v, size_t n)
{
    for (size_t i = 0; i < n; i++)
        out[i] += v * in[i];
}

static void spread(double *out, const double *e, const struct reference_frame *f, const struct table *t)
{
    const size_t wide = f->width + 2 * (size_t)f->grow, high = f->height + 2 * (size_t)f->grow;
    for (size_t y = f->grow; y < f->grow + f->height; y++)
        for (size_t x = f->grow; x < f->grow + f->width; x++)
            for (size_t o = 0; e[y * wide + x] != 0 && o < high; o++)
                add_scaled(out + o * wide, t->value + (o + t->reach_y - y) * t->stride + t->reach_x - x,
                           e[y * wide + x], wide);
}

void scene_kernel_spread(struct reference_result *r, const struct scene *s, const struct reference_frame *f,
                         const struct psf_spec *psf)
{
    const struct kernel_facts facts = { .psf = psf,
                                        .reach_x = f->width + f->grow - 1,
                                        .reach_y = f->height + f->grow - 1,
                                        .pixel_aspect = f->pixel_aspect,
                                        .picture_height = f->height,
                                        .image = s->kernel,
                                        .image_width = s->kernel_width,
                                        .image_height = s->kernel_height };
    struct table t = { .reach_x = facts.reach_x, .reach_y = facts.reach_y, .stride = 2 * (size_t)facts.reach_x + 1 };
    for (unsigned c = 0; c < f->channels; c++) {
        t.value = calloc(t.stride * (2 * t.reach_y + 1), sizeof(double));
        assert_non_null(t.value);
        // One plane has the mean of the three.
        for (unsigned k = 0; k < 3; k++)
            if (f->channels == 1 || k == c)
                draw(&t, &facts, k, psf->weight / (f->channels == 1 ? 3 : 1));
        spread(r->glow[c], r->bright[c], f, &t);
        free(t.value);
    }
}
