// SPDX-License-Identifier: Apache-2.0
// test_hard_kernel.c - METHODS section 4 for the psfs that are kernels, convolved by FFT. The truth is a dense convolution in
// float64 with the same kernel (scene_kernel.h). There are no rules here, whatever tolerance is asked for.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hard_kit.h"

enum { KINDS = 4, IMAGE = 2, IMAGE_W = 9, IMAGE_H = 7 };
static const struct {
    const char *name, *psf; /* NULL: psf=image: of the scene's own kernel */
} kinds[KINDS] = {
    { "eye", "eye:degrees=40,weight=0.3" },
    { "airy", "airy:f=22,pitch=2,weight=0.3" }, // rings of several pixels
    { "image", NULL },
    { "aperture", "aperture:blades=5,rotation=8,f=16,pitch=3,weight=0.3" },
};

static struct params kernel_params(struct scene *s, unsigned kind, enum bright_curve curve)
{
    char text[80];
    if (kind == IMAGE && !s->kernel)
        scene_add_kernel(s, IMAGE_W, IMAGE_H);
    snprintf(text, sizeof(text), "image:%s,weight=0.3", s->kernel_digest);
    return scene_params(kind == IMAGE ? text : kinds[kind].psf, curve, 1e-3);
}

/* A figure whose words end in the kind's name. */
static void kind_figure(unsigned number, const char *what, unsigned kind, double value, double limit, const char *unit)
{
    char text[96];
    snprintf(text, sizeof(text), "%s (%s)", what, kinds[kind].name);
    figure(number, text, "fft", value, limit, unit);
}

static void case_1_dark(void)
{
    for (unsigned k = 0; k < KINDS; k++) {
        struct scene s;
        scene_init(&s, 65, 41, 3, PIXEL_TYPE_HALF);
        struct params p = kernel_params(&s, k, BRIGHT_KNEE);
        p.threshold = 2;
        unsigned touched = 0;
        hard_run(&s, &p);
        touched += !s.reply.untouched;
        hard_fill(&s, 1.4990234375); // just below the foot of the knee
        hard_run(&s, &p);
        touched += !s.reply.untouched;
        kind_figure(1, "all zero or below T: touched", k, touched, 0, "frames");
        scene_finish(&s);
    }
}

// Only the image ends within the frame; of the others a flat field is compared with the dense sum.
static void case_2_flat(void)
{
    for (unsigned k = 0; k < KINDS; k++) {
        struct scene s;
        scene_init(&s, 71, 53, 3, PIXEL_TYPE_FLOAT);
        struct params p = kernel_params(&s, k, BRIGHT_NONE);
        hard_fill(&s, 3);
        kind_figure(2, "flat field: error / bound", k, hard_ratio(&s, &p), 1, "of the bound");
        double worst = 0;
        for (unsigned y = IMAGE_H; y < 53 - IMAGE_H; y++)
            for (unsigned x = IMAGE_W; x < 71 - IMAGE_W; x++)
                worst = fmax(worst, fabs(hard_glow(&s, &p, 1, y * 71 + x) / (3 * .3) - 1));
        if (k == IMAGE)
            kind_figure(2, "flat field: gain - weight", k, worst, 1e-6, "relative");
        scene_finish(&s);
    }
}

static void case_3_point(void)
{
    for (unsigned k = 0; k < KINDS; k++) {
        struct scene s;
        scene_init(&s, 141, 93, 1, PIXEL_TYPE_FLOAT);
        struct params p = kernel_params(&s, k, BRIGHT_NONE);
        p.intensity = 1e4; // so that the point itself does not round its glow off
        s.plane[0][40 * 141 + 70] = 1e6;
        hard_run(&s, &p);
        const struct reference_frame f = scene_reference(&s, NULL);
        struct reference_result truth;
        scene_truth(&truth, &s, &f, &p);
        double worst = 0, peak = 0, outside = 0;
        unsigned negative = 0;
        for (size_t i = 0; i < hard_count(&s); i++) {
            const double g = hard_glow(&s, &p, 0, i);
            peak = fmax(peak, truth.glow[0][i]);
            worst = fmax(worst, fabs(g - truth.glow[0][i]));
            outside = fmax(outside, truth.glow[0][i] == 0 ? g : 0);
            negative += s.out[0][0][i] < 0;
        }
        kind_figure(3, "1e6 on 0: error of the peak", k, worst / peak, 1e-6, "of the peak");
        kind_figure(3, "1e6 on 0: negative", k, negative, 0, "px");
        // Float64's rounding, which a convolution by FFT spreads over the frame.
        if (k == IMAGE)
            kind_figure(3, "1e6 on 0: light outside the kernel", k, outside / peak, 1e-14, "of the peak");
        reference_free(&truth);
        scene_finish(&s);
    }
}

/* Sample by sample against the dense sum: what is small beside its neighbours counts as much as they. */
static double pointwise(struct scene *s, const struct params *p)
{
    const struct reference_frame f = scene_reference(s, NULL);
    struct reference_result truth;
    hard_run(s, p);
    scene_truth(&truth, s, &f, p);
    const double worst = hard_relative(s->out[0][0], truth.out[0], hard_count(s));
    reference_free(&truth);
    return worst;
}

static void case_5_point_on_noise(void)
{
    for (unsigned k = 0; k < KINDS; k++) {
        struct scene s;
        scene_init(&s, 90, 70, 1, PIXEL_TYPE_FLOAT);
        struct params p = kernel_params(&s, k, BRIGHT_NONE);
        for (size_t i = 0; i < hard_count(&s); i++)
            s.plane[0][i] = (float)(i == 30 * 90 + 41 ? 1e6 : 1e-3 * scene_uniform());
        kind_figure(5, "1e6 on 1e-3 noise: pointwise", k, pointwise(&s, &p), 1e-5, "relative");
        kind_figure(5, "1e6 on 1e-3 noise: error / bound", k, hard_ratio(&s, &p), 1, "of the bound");
        scene_finish(&s);
    }
}

static void case_6_dark_beside_bright(void)
{
    for (unsigned k = 0; k < KINDS; k++)
        for (int type = PIXEL_TYPE_HALF; type <= PIXEL_TYPE_FLOAT; type++) {
            const bool half = type == PIXEL_TYPE_HALF;
            struct scene s;
            scene_init(&s, 101, 61, 1, (enum pixel_type)type);
            struct params p = kernel_params(&s, k, BRIGHT_NONE);
            hard_fill(&s, 1e-6);
            s.plane[0][30 * 101 + 50] = 6e4;
            const double ratio = hard_ratio(&s, &p);
            double lost = 0;
            for (size_t i = 0; i < hard_count(&s); i++)
                lost += s.out[0][0][i] < s.plane[0][i];
            kind_figure(6, half ? "6e4 beside 1e-6: lost or negative, half" : "6e4 beside 1e-6: lost or negative", k, lost, 0,
                        "px");
            kind_figure(6, half ? "6e4 beside 1e-6: error / bound, half" : "6e4 beside 1e-6: error / bound", k, ratio, 1,
                        "of the bound");
            if (!half)
                kind_figure(6, "6e4 beside 1e-6: pointwise", k, pointwise(&s, &p), 1e-5, "relative");
            scene_finish(&s);
        }
}

static void case_9_nonfinite(void)
{
    for (unsigned k = 0; k < KINDS; k++)
        for (int policy = NONFINITE_KEEP; policy <= NONFINITE_ZERO; policy++) {
            const bool keep = policy == NONFINITE_KEEP;
            struct scene s;
            scene_init(&s, 75, 55, 3, PIXEL_TYPE_HALF);
            scene_fill(&s);
            struct params p = kernel_params(&s, k, BRIGHT_KNEE);
            p.nonfinite = policy;
            s.plane[0][45 * 75 + 10] = NAN;
            s.plane[1][20 * 75 + 60] = INFINITY;
            s.plane[2][20 * 75 + 61] = -INFINITY;
            const double ratio = hard_ratio(&s, &p);
            double spread = 0;
            for (unsigned c = 0; c < 3; c++)
                for (size_t i = 0; i < hard_count(&s); i++)
                    spread += !isfinite(s.out[0][c][i]) && !(keep && !isfinite(s.plane[c][i]));
            kind_figure(9, keep ? "NaN and Inf, keep: spread" : "NaN and Inf, zero: left", k, spread, 0, "px");
            kind_figure(9, keep ? "NaN and Inf, keep: error / bound" : "NaN and Inf, zero: error / bound", k, ratio, 1,
                        "of the bound");
            scene_finish(&s);
        }
}

static void case_10_wide_gamut(void)
{
    for (unsigned k = 0; k < KINDS; k++) {
        struct scene s;
        scene_init(&s, 60, 45, 3, PIXEL_TYPE_FLOAT);
        struct params p = kernel_params(&s, k, BRIGHT_LUMINANCE);
        memcpy(s.luma, (float[3]){ .2722287f, .6740818f, .0536895f }, sizeof(s.luma));
        for (unsigned c = 0; c < 3; c++)
            for (size_t i = 0; i < hard_count(&s); i++)
                s.plane[c][i] = 6 * scene_uniform() - 2;
        const double ratio = hard_ratio(&s, &p);
        double darker = 0;
        for (unsigned c = 0; c < 3; c++)
            for (size_t i = 0; i < hard_count(&s); i++)
                darker += s.out[0][c][i] < s.plane[c][i];
        kind_figure(10, "negatives and AP1: made darker", k, darker, 0, "px");
        kind_figure(10, "negatives and AP1: error / bound", k, ratio, 1, "of the bound");
        scene_finish(&s);
    }
}

// Every view beside the picture, and mix, which wants E and its spread at once.
static void case_10_views(void)
{
    static const struct view_spec views[] = { { VIEW_SOURCE, 0 }, { VIEW_BRIGHT, 0 }, { VIEW_BLOOM, 0 }, { VIEW_RESIDUAL, 0 } };
    for (unsigned k = 0; k < KINDS; k++)
        for (int composite = COMPOSITE_ADD; composite <= COMPOSITE_SCREEN_ADD; composite++) {
            struct scene s;
            scene_init(&s, 60, 45, 3, PIXEL_TYPE_FLOAT);
            scene_fill(&s);
            struct params p = kernel_params(&s, k, BRIGHT_CHANNEL);
            p.composite = composite;
            p.display = composite == COMPOSITE_SCREEN_ADD ? DISPLAY_REINHARD : DISPLAY_NONE;
            p.layer_count = 4;
            memcpy(p.layer, views, sizeof(views));
            s.outputs = 5;
            kind_figure(10, "four views beside the picture: error / bound", k, hard_ratio(&s, &p), 1, "of the bound");
            scene_finish(&s);
        }
}

// Nothing wraps around: the light of one border is not at the other, in the frame nor in a grown one.
static void case_13_borders(void)
{
    for (unsigned k = 0; k < KINDS; k++)
        for (unsigned grow = 0; grow < 20; grow += 17) {
            struct scene s;
            scene_init(&s, 64, 45, 1, PIXEL_TYPE_FLOAT); // 64 + 8 is no length of the FFT's
            s.grow = grow;
            struct params p = kernel_params(&s, k, BRIGHT_CHANNEL);
            hard_border(&s);
            kind_figure(13, grow ? "lit borders, grown: error / bound" : "lit borders: error / bound", k, hard_ratio(&s, &p), 1,
                        "of the bound");
            memset(s.plane[0], 0, hard_count(&s) * sizeof(double));
            s.plane[0][0] = 1e6; // one corner: the opposite one has its tail alone
            kind_figure(13, grow ? "a lit corner, grown: error / bound" : "a lit corner: error / bound", k, hard_ratio(&s, &p), 1,
                        "of the bound");
            scene_finish(&s);
        }
}

// The image's light all lands in the frame, so that mix leaves the sum as it is.
static void case_13_mix(void)
{
    struct scene s;
    scene_init(&s, 101, 81, 3, PIXEL_TYPE_FLOAT);
    struct params p = kernel_params(&s, IMAGE, BRIGHT_LUMINANCE);
    p.psf_spec.weight = 1;
    snprintf(p.psf, sizeof(p.psf), "image:%s,weight=1", s.kernel_digest);
    p.composite = COMPOSITE_MIX;
    p.intensity = .7;
    for (unsigned i = 0; i < 60; i++)
        for (unsigned c = 0; c < 3; c++)
            s.plane[c][(30 + i % 20) * 101 + 40 + i / 3] = 100 * scene_uniform();
    const double ratio = hard_ratio(&s, &p);
    double in = 0, out = 0;
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < hard_count(&s); i++) {
            in += s.plane[c][i];
            out += s.out[0][c][i];
        }
    kind_figure(13, "mix: sum of the frame", IMAGE, fabs(out / in - 1), 1e-6, "relative");
    kind_figure(13, "mix: error / bound", IMAGE, ratio, 1, "of the bound");
    scene_finish(&s);
}

static void case_14_sizes(void)
{
    static const unsigned sizes[][2] = { { 1, 1 },  { 1, 7 },   { 2, 1 },  { 3, 5 },  { 1, 131 }, { 131, 1 },
                                         { 61, 31 }, { 9, 4 }, { 17, 33 }, { 64, 3 }, { 53, 59 } };
    for (unsigned k = 0; k < KINDS; k++) {
        double worst = 0;
        for (unsigned i = 0; i < sizeof(sizes) / sizeof(sizes[0]); i++)
            for (int type = PIXEL_TYPE_HALF; type <= PIXEL_TYPE_FLOAT; type++) {
                struct scene s;
                scene_init(&s, sizes[i][0], sizes[i][1], i % 2 ? 1 : 3, (enum pixel_type)type);
                scene_fill(&s);
                struct params p = kernel_params(&s, k, BRIGHT_KNEE);
                worst = fmax(worst, hard_ratio(&s, &p));
                scene_finish(&s);
            }
        kind_figure(14, "1x1 1xN Nx1 odd and prime: error / bound", k, worst, 1, "of the bound");
    }
}

// An image larger than the frame is cut off, and what is cut off is lost, not put back.
static void case_14_large_kernel(void)
{
    struct scene s;
    scene_init(&s, 21, 13, 3, PIXEL_TYPE_FLOAT);
    scene_add_kernel(&s, 90, 64);
    struct params p = kernel_params(&s, IMAGE, BRIGHT_NONE);
    scene_fill(&s);
    kind_figure(14, "a kernel larger than the frame: error / bound", IMAGE, hard_ratio(&s, &p), 1, "of the bound");
    scene_finish(&s);
}

/* ---- case 15 ------------------------------------------------------------------------------------------- */

enum { SIDE = 61, N = SIDE * SIDE };

static void linearity(unsigned kind)
{
    struct scene s;
    scene_init(&s, SIDE, SIDE, 1, PIXEL_TYPE_FLOAT);
    struct params p = kernel_params(&s, kind, BRIGHT_NONE);
    scene_fill(&s);
    double *x = hard_copy(s.plane[0], N), *bx = hard_output(&s, &p);
    scene_fill(&s);
    double *y = hard_copy(s.plane[0], N), *by = hard_output(&s, &p);
    for (size_t i = 0; i < N; i++) {
        s.plane[0][i] = (float)x[i] * 2. + (float)y[i] * .25;
        bx[i] = 2 * bx[i] + .25 * by[i];
    }
    double *sum = hard_output(&s, &p);
    kind_figure(15, "linearity", kind, hard_relative(sum, bx, N), 1e-6, "relative");
    free(x), free(y), free(bx), free(by), free(sum);
    scene_finish(&s);
}

static void transpose(double *to, const double *from)
{
    for (unsigned i = 0; i < N; i++)
        to[i % SIDE * SIDE + i / SIDE] = from[i];
}

static void reverse(double *to, const double *from)
{
    for (unsigned i = 0; i < N; i++)
        to[N - 1 - i] = from[i];
}

// The frame turned is the picture turned. A pentagon has no such symmetry, and an image turns with the frame.
static void turned(unsigned kind, const char *what, void (*turn)(double *, const double *), bool transposed)
{
    struct scene s, t;
    scene_init(&s, SIDE, SIDE, 1, PIXEL_TYPE_FLOAT);
    scene_init(&t, SIDE, SIDE, 1, PIXEL_TYPE_FLOAT);
    struct params p = kernel_params(&s, kind, BRIGHT_CHANNEL);
    if (kind == IMAGE)
        scene_add_kernel(&t, transposed ? IMAGE_H : IMAGE_W, transposed ? IMAGE_W : IMAGE_H);
    for (unsigned i = 0; kind == IMAGE && i < IMAGE_W * IMAGE_H; i++)
        memcpy(t.kernel + 3 * (transposed ? i % IMAGE_W * IMAGE_H + i / IMAGE_W : IMAGE_W * IMAGE_H - 1 - i), s.kernel + 3 * i,
               3 * sizeof(float));
    struct params q = kernel_params(&t, kind, BRIGHT_CHANNEL);
    scene_fill(&s);
    turn(t.plane[0], s.plane[0]);
    double *straight = hard_output(&s, &p), *other = hard_output(&t, &q), *back = hard_copy(other, N);
    turn(back, other);
    kind_figure(15, what, kind, hard_relative(back, straight, N), 1e-6, "relative");
    free(straight), free(other), free(back);
    scene_finish(&s);
    scene_finish(&t);
}

static void threads(unsigned kind, struct bloom *other)
{
    struct scene s;
    scene_init(&s, 133, 87, 3, PIXEL_TYPE_FLOAT);
    scene_fill(&s);
    struct params p = kernel_params(&s, kind, BRIGHT_KNEE);
    double differ = 0, *many[3];
    hard_run(&s, &p);
    for (unsigned c = 0; c < 3; c++)
        many[c] = hard_copy(s.out[0][c], hard_count(&s));
    for (unsigned k = 0; k < 2; k++) {
        scene_run(&s, &p, k ? hard_engine : other, k);
        for (unsigned c = 0; c < 3; c++)
            for (size_t i = 0; i < hard_count(&s); i++)
                differ += many[c][i] != s.out[0][c][i];
    }
    kind_figure(15, "five threads and another slot: other bits", kind, differ, 0, "samples");
    for (unsigned c = 0; c < 3; c++)
        free(many[c]);
    scene_finish(&s);
}

static void case_15_symmetries(void)
{
    struct bloom *five;
    struct fault f = { 0 };
    const struct bloom_options options = { .slots = 1, .threads = 5, .device = bloom_device(hard_engine)->name };
    if (bloom_create(&five, &options, &f) < 0)
        fail_msg("%s", f.text);
    for (unsigned k = 0; k < KINDS; k++) {
        linearity(k);
        if (strcmp(kinds[k].name, "aperture")) {
            turned(k, "transpose", transpose, true);
            turned(k, "flip of both axes", reverse, false);
        }
        threads(k, five);
    }
    bloom_destroy(five);
}

int main(void)
{
    const struct hard_case cases[] = {
        { true, "case_1_dark", case_1_dark },
        { true, "case_2_flat", case_2_flat },
        { true, "case_3_point", case_3_point },
        { true, "case_5_point_on_noise", case_5_point_on_noise },
        { true, "case_6_dark_beside_bright", case_6_dark_beside_bright },
        { true, "case_9_nonfinite", case_9_nonfinite },
        { true, "case_10_wide_gamut", case_10_wide_gamut },
        { true, "case_10_views", case_10_views },
        { true, "case_13_borders", case_13_borders },
        { true, "case_13_mix", case_13_mix },
        { true, "case_14_sizes", case_14_sizes },
        { true, "case_14_large_kernel", case_14_large_kernel },
        { true, "case_15_symmetries", case_15_symmetries },
    };
    return hard_main("hard_kernel", cases, sizeof(cases) / sizeof(cases[0]));
}
