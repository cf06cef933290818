// SPDX-License-Identifier: Apache-2.0
// kernel.c - see kernel.h: what is common to all models, and the image. Sums are taken row by row in one
// order, by one thread, so that the norm does not depend on who drew what.
#include "kernel.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "kernel_parts.h"

void kernel_points_make(struct kernel_points *p, unsigned n)
{
    p->n = n;
    for (unsigned i = 0; i < n; i++) {
        // Newton on the Legendre polynomial, from Tricomi's estimate of the root.
        double x = cos(M_PI * (i + 0.75) / (n + 0.5)), slope = 1;
        for (unsigned turn = 0; turn < 8; turn++) {
            double before = 1, now = x;
            for (unsigned k = 2; k <= n; k++) {
                const double next = ((2 * k - 1) * x * now - (k - 1) * before) / k;
                before = now;
                now = next;
            }
            slope = n * (x * now - before) / (x * x - 1);
            x -= now / slope;
        }
        p->at[i] = x / 2;
        p->weight[i] = 1 / ((1 - x * x) * slope * slope);
    }
}

unsigned kernel_points_for(double cycles)
{
    // The rule's error on cos(2 pi c t) falls steeply once n is above pi c / 2; 4 more are 1e-5 and
    // better.
    const double n = 2 * ceil((0.5 * M_PI * cycles + 4) / 2);
    return n > KERNEL_POINTS_MAX ? KERNEL_POINTS_MAX : (unsigned)n;
}

/* ---- facts ------------------------------------------------------------------------------------------
 */

static const char *const kind_name[] = { "gaussians", "eye", "airy", "aperture", "image" };

static int number_check(const char *kind, const char *name, double v, double min, double max,
                        struct fault *f)
{
    if (v >= min && v <= max)
        return 0;
    return fault_set(f, FAULT_PARAM_RANGE, "params.psf", "psf %s, %s: %g found, %g to %g expected", kind,
                     name, v, min, max);
}

static int image_check(const struct kernel_facts *facts, struct fault *f)
{
    const uint32_t w = facts->image_width, h = facts->image_height;
    if (!facts->image || w < 1 || h < 1 || w > KERNEL_SIDE_MAX || h > KERNEL_SIDE_MAX)
        return fault_set(f, FAULT_PARAM_RANGE, "params.psf",
                         "psf image: %s %u x %u pixels found, 1 to %d each way expected",
                         facts->image ? "a kernel of" : "no kernel, of", w, h, KERNEL_SIDE_MAX);
    double sum[3] = { 0, 0, 0 };
    const uint64_t count = (uint64_t)w * h;
    for (uint64_t i = 0; i < count * 3; i++) {
        const float v = facts->image[i];
        if (!(v >= 0 && v <= 3.4028234e38f))
            return fault_set(
                f, FAULT_PARAM_RANGE, "params.psf",
                "psf image, pixel (%llu, %llu), channel %c: %g found, a finite number >= 0 expected",
                (unsigned long long)(i / 3 % w), (unsigned long long)(i / 3 / w), "RGB"[i % 3],
                (double)v);
        sum[i % 3] += (double)v;
    }
    for (unsigned c = 0; c < 3; c++)
        if (!(sum[c] > 0))
            return fault_set(f, FAULT_PARAM_RANGE, "params.psf",
                             "psf image, channel %c: a sum of 0 found, > 0 expected", "RGB"[c]);
    return 0;
}

static int lens_check(const struct psf_spec *s, struct fault *f)
{
    const char *kind = kind_name[s->kind];
    if (number_check(kind, "f-number", s->f_number, 0.1, 1e5, f) < 0 ||
        number_check(kind, "pitch", s->pitch_um, 1e-3, 1e5, f) < 0)
        return -1;
    for (unsigned c = 0; c < 3; c++)
        if (number_check(kind, "wavelength", s->wavelength_nm[c], 1, 1e6, f) < 0)
            return -1;
    return s->kind == PSF_APERTURE
               ? number_check(kind, "blades", s->blades, 3, 32, f) ||
                         number_check(kind, "rotation", s->rotation_deg, -1e6, 1e6, f)
                     ? -1
                     : 0
               : 0;
}

int kernel_check(const struct kernel_facts *facts, struct fault *f)
{
    const struct psf_spec *s = facts->psf;
    if (s->kind < PSF_EYE || s->kind > PSF_IMAGE)
        return fault_set(f, FAULT_INTERNAL, "params.psf",
                         "psf kind %d found, one that is drawn out expected", (int)s->kind);
    const char *kind = kind_name[s->kind];
    if (number_check(kind, "columns to reach", facts->reach_x, 0, KERNEL_SIDE_MAX / 2 - 1, f) < 0 ||
        number_check(kind, "rows to reach", facts->reach_y, 0, KERNEL_SIDE_MAX / 2 - 1, f) < 0)
        return -1;
    if (s->kind == PSF_IMAGE)
        return image_check(facts, f);
    // Beyond 8 the points along a pixel's long side would be too few for its short one.
    if (number_check(kind, "pixel aspect", facts->pixel_aspect, 0.125, 8, f) < 0)
        return -1;
    if (s->kind != PSF_EYE)
        return lens_check(s, f);
    if (number_check(kind, "degrees", s->degrees, 1e-3, 360, f) < 0)
        return -1;
    return number_check(kind, "the picture's height", facts->picture_height, 1, UINT32_MAX, f);
}

bool kernel_same(const struct psf_spec *psf, unsigned a, unsigned b)
{
    return psf->kind == PSF_EYE ||
           (psf->kind != PSF_IMAGE && psf->wavelength_nm[a] == psf->wavelength_nm[b]);
}

/* ---- drawing ----------------------------------------------------------------------------------------
 */

static int32_t smaller(int64_t a, int64_t b) { return (int32_t)(a < b ? a : b); }

void kernel_measure(struct kernel *k, const struct kernel_facts *facts)
{
    const int32_t rx = (int32_t)facts->reach_x, ry = (int32_t)facts->reach_y;
    switch (facts->psf->kind) {
    case PSF_IMAGE: {
        const int64_t w = facts->image_width, h = facts->image_height;
        *k = (struct kernel){ .symmetry = KERNEL_ANY,
                              .min_x = -smaller(w / 2, rx),
                              .max_x = smaller(w - 1 - w / 2, rx),
                              .min_y = -smaller(h / 2, ry),
                              .max_y = smaller(h - 1 - h / 2, ry) };
        break;
    }
    case PSF_APERTURE:
        *k = (struct kernel){ .symmetry = KERNEL_CENTRAL, .min_x = -rx, .max_x = rx, .max_y = ry };
        break;
    default:
        *k = (struct kernel){ .symmetry = KERNEL_MIRRORED, .max_x = rx, .max_y = ry };
    }
}

// Sum of the whole kernel: what is kept once counts as often as it stands for.
static double sum_of(const struct kernel *k)
{
    const double *v = k->value;
    double sum = 0;
    for (int32_t dy = k->min_y; dy <= k->max_y; dy++) {
        double row = 0;
        for (int32_t dx = k->min_x; dx <= k->max_x; dx++, v++)
            row += k->symmetry == KERNEL_MIRRORED && dx ? 2 * *v : *v;
        sum += k->symmetry != KERNEL_ANY && dy ? 2 * row : row;
    }
    return sum;
}

static size_t count_of(const struct kernel *k)
{
    return (size_t)(k->max_x - k->min_x + 1) * (size_t)(k->max_y - k->min_y + 1);
}

// Differences of border integrals and far ripples can be a rounding below 0; light cannot.
static void scale_by(struct kernel *k, double factor)
{
    for (size_t i = 0, n = count_of(k); i < n; i++)
        k->value[i] = fmax(k->value[i] * factor, 0);
}

static void image_draw(struct kernel *k, const struct kernel_facts *facts, unsigned channel)
{
    const uint32_t w = facts->image_width, h = facts->image_height;
    double total = 0, *v = k->value;
    for (uint32_t y = 0; y < h; y++) {
        double row = 0;
        for (uint32_t x = 0; x < w; x++)
            row += (double)facts->image[3 * ((uint64_t)y * w + x) + channel];
        total += row;
    }
    for (int32_t dy = k->min_y; dy <= k->max_y; dy++)
        for (int32_t dx = k->min_x; dx <= k->max_x; dx++) {
            const uint64_t at =
                (uint64_t)(dy + (int64_t)(h / 2)) * w + (uint64_t)(dx + (int64_t)(w / 2));
            *v++ = (double)facts->image[3 * at + channel] / total;
        }
    const bool whole = (int64_t)w == k->max_x - k->min_x + 1 && (int64_t)h == k->max_y - k->min_y + 1;
    k->outside = whole ? 0 : fmax(0, 1 - sum_of(k));
}

static int airy_draw(struct kernel *k, const struct kernel_facts *facts, double cycles,
                     struct crew *crew)
{
    const double drawn = fmin(cycles, KERNEL_FINEST), scale = drawn / cycles;
    double total;
    const int err = kernel_draw_radial(k, facts, drawn, &total, crew);
    if (err < 0)
        return err;
    k->outside = scale * fmax(0, 1 - sum_of(k));
    scale_by(k, scale);
    k->value[0] += 1 - scale;
    return 0;
}

int kernel_draw(struct kernel *k, const struct kernel_facts *facts, unsigned channel, struct crew *crew,
                struct fault *f)
{
    const struct psf_spec *s = facts->psf;
    double total = 1;
    int err = 0;
    kernel_measure(k, facts);
    k->value = malloc(count_of(k) * sizeof(*k->value));
    if (!k->value)
        return fault_set(f, FAULT_NO_MEMORY, "params.psf", "psf: no memory for a kernel of %zu numbers",
                         count_of(k));
    const double cycles =
        s->kind == PSF_EYE ? 0 : 1e3 * s->pitch_um / (s->wavelength_nm[channel] * s->f_number);
    if (s->kind == PSF_IMAGE) {
        image_draw(k, facts, channel);
        return 0;
    }
    if (s->kind == PSF_APERTURE)
        kernel_draw_aperture(k, facts, cycles, crew);
    else if (s->kind == PSF_AIRY)
        err = airy_draw(k, facts, cycles, crew);
    else if ((err = kernel_draw_radial(k, facts, 0, &total, crew)) == 0)
        k->outside = fmax(0, 1 - sum_of(k) / total);
    if (err < 0) {
        kernel_finish(k);
        return fault_set(f, FAULT_NO_MEMORY, "params.psf", "psf: no memory for a table of the pattern");
    }
    scale_by(k, 1 / sum_of(k));
    return 0;
}

void kernel_finish(struct kernel *k)
{
    free(k->value);
    k->value = NULL;
}
