// SPDX-License-Identifier: Apache-2.0
// reference_wall.c - see reference_wall.h.
#include "reference_wall.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static double overlap(double from, double to, double pixel) { return fmax(0, fmin(to, pixel + 1) - fmax(from, pixel)); }

// Of wall pixel i, j: the mean of v(pixel), by area.
static double area_mean(const double *v, const double *also, const struct reference_frame *f, const struct reference_wall *w, unsigned i,
                        unsigned j)
{
    const double x0 = w->x + i * w->pitch_x, x1 = w->x + (i + 1.0) * w->pitch_x;
    const double y0 = w->y + j * w->pitch_y, y1 = w->y + (j + 1.0) * w->pitch_y;
    double sum = 0;
    for (double y = fmax(0, floor(y0)); y < fmin(f->height, ceil(y1)); y++)
        for (double x = fmax(0, floor(x0)); x < fmin(f->width, ceil(x1)); x++) {
            const size_t at = (size_t)y * f->width + (size_t)x;
            const double value = also ? fabs(v[at]) + fabs(also[at] - v[at]) : v[at];
            sum += overlap(x0, x1, x) * overlap(y0, y1, y) * value;
        }
    return sum / (w->pitch_x * w->pitch_y);
}

static double toned(double v, int kind)
{
    if (kind == DISPLAY_REINHARD)
        return v / (v + 1);
    return kind == DISPLAY_ACES ? v * (2.51 * v + .03) / (v * (2.43 * v + .59) + .14) : v;
}

void reference_drive(double drive[3], const double mean[3], const struct reference_wall *w, const float *gain)
{
    static const double luma[3] = { .2126, .7152, .0722 };
    double v[3], l = 0;
    for (unsigned c = 0; c < 3; c++) {
        v[c] = toned(fmax(0, mean[c] * exp2(w->exposure)), w->tone_map);
        l += luma[c] * v[c];
    }
    for (unsigned c = 0; c < 3; c++)
        v[c] = fmax(0, l + w->saturation * (v[c] - l));
    for (unsigned c = 0; c < 3; c++)
        drive[c] = (w->matrix[c][0] * v[0] + w->matrix[c][1] * v[1] + w->matrix[c][2] * v[2]) * (gain ? (double)gain[c] : 1);
}

void reference_light_free(struct reference_light *l)
{
    free(l->mean);
    free(l->size);
    free(l->drive);
    *l = (struct reference_light){ 0 };
}

int reference_wall(struct reference_light *l, const struct reference_frame *f, const struct params *p, const struct reference_wall *w)
{
    const size_t n = (size_t)w->width * w->height * 3;
    struct params own = *p;
    struct reference_result r;
    own.nonfinite = NONFINITE_ZERO;
    *l = (struct reference_light){ calloc(n, sizeof(double)), calloc(n, sizeof(double)), calloc(n, sizeof(double)), 0 };
    int e = reference_bloom(&r, f, &own);
    if (e < 0 || !l->mean || !l->size || !l->drive) {
        e = -1;
        goto done;
    }
    l->max_bright = r.max_bright;
    for (unsigned j = 0; j < w->height; j++)
        for (unsigned i = 0; i < w->width; i++) {
            const size_t at = 3 * ((size_t)j * w->width + i);
            for (unsigned c = 0; c < 3; c++) {
                const unsigned from = f->channels == 1 ? 0 : c;
                l->mean[at + c] = area_mean(r.out[from], NULL, f, w, i, j);
                l->size[at + c] = area_mean(r.scene[from], r.out[from], f, w, i, j);
            }
            reference_drive(&l->drive[at], &l->mean[at], w, w->gain ? w->gain + at : NULL);
        }
done:
    reference_free(&r);
    return e;
}
