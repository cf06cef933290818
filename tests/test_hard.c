// SPDX-License-Identifier: Apache-2.0
// test_hard.c - METHODS section 4: what every engine is tried on, with the figures. (The slides of cases 4 and 16 are
// test_hard_slide.c's; what a picture is made of the glow, test_hard_picture.c's; kernels, test_hard_kernel.c's; the windows and
// origins of case 17 test_server_frames', for the engine knows none.)
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hard_kit.h"

static const char *const curves[] = { "none", "channel", "luminance", "knee", "smoothstep" };

static void case_1_dark(void)
{
    for (unsigned r = 0; r < RULES; r++)
        for (int type = PIXEL_TYPE_HALF; type <= PIXEL_TYPE_FLOAT; type++) {
            struct params p = scene_params("gaussians:sigma=4/20,weight=1/1", BRIGHT_KNEE, hard_rules[r].tolerance);
            p.threshold = 2;
            struct scene s;
            scene_init(&s, 65, 41, 3, (enum pixel_type)type);
            unsigned touched = 0;
            hard_run(&s, &p);
            touched += !s.reply.untouched;
            hard_fill(&s, 1.4990234375); // just below the foot of the knee, as a half, too
            hard_run(&s, &p);
            touched += !s.reply.untouched;
            figure(1, type == PIXEL_TYPE_HALF ? "all zero or below T: touched (half)" : "all zero or below T: touched (float)",
                   hard_rules[r].name, touched, 0, "frames");
            scene_finish(&s);
        }
}

static void case_2_flat(void)
{
    for (unsigned r = 0; r < RULES; r++) {
        struct params p = scene_params("gaussians:sigma=2.7/6/10,weight=.5/1/2", BRIGHT_NONE, hard_rules[r].tolerance);
        struct scene s;
        scene_init(&s, 241, 233, 1, PIXEL_TYPE_FLOAT);
        hard_fill(&s, 3);
        hard_run(&s, &p);
        double worst = 0;
        for (unsigned y = 112; y < 121; y++)
            for (unsigned x = 112; x < 129; x++)
                worst = fmax(worst, fabs(hard_glow(&s, &p, 0, y * 241 + x) / (3 * 3.5) - 1));
        figure(2, "flat field: gain - sum of weights", hard_rules[r].name, worst, 1e-6, "relative");
        scene_finish(&s);
    }
}

// A lone point: the PSF within the tolerance of its peak, nothing outside its support, nothing negative.
static void lone_point(const struct hard_rule *rule, double sigma, unsigned width, unsigned height)
{
    char psf[64], what[96];
    snprintf(psf, sizeof(psf), "gaussians:sigma=%g,weight=1", sigma);
    struct params p = scene_params(psf, BRIGHT_NONE, rule->tolerance);
    p.intensity = 1e4; // so that the point itself does not round its glow off
    struct scene s;
    scene_init(&s, width, height, 1, PIXEL_TYPE_FLOAT);
    const unsigned px = width / 2 + 1, py = height / 2;
    s.plane[0][py * width + px] = 1e6;
    hard_run(&s, &p);
    const struct reference_frame f = scene_reference(&s, NULL);
    struct reference_result truth;
    assert_int_equal(reference_bloom(&truth, &f, &p), 0);
    const double peak = truth.glow[0][py * width + px];
    double worst = 0, furthest = 0;
    unsigned negative = 0;
    for (unsigned y = 0; y < height; y++)
        for (unsigned x = 0; x < width; x++) {
            const size_t i = (size_t)y * width + x;
            worst = fmax(worst, fabs(hard_glow(&s, &p, 0, i) - truth.glow[0][i]));
            negative += s.out[0][0][i] < 0;
            if (s.out[0][0][i] != 0)
                furthest = fmax(furthest, fmax(abs((int)x - (int)px), abs((int)y - (int)py)));
        }
    snprintf(what, sizeof(what), "1e6 on 0: error of the peak (sigma %g)", sigma);
    figure(3, what, rule->name, worst / peak, rule->tolerance + 1e-6, "of the peak");
    snprintf(what, sizeof(what), "1e6 on 0: furthest light (sigma %g)", sigma);
    figure(3, what, rule->name, furthest, 10 * sigma + 16, "px");
    snprintf(what, sizeof(what), "1e6 on 0: negative (sigma %g)", sigma);
    figure(3, what, rule->name, negative, 0, "px");
    reference_free(&truth);
    scene_finish(&s);
}

static void case_3_point(void)
{
    for (unsigned r = 0; r < RULES; r++) {
        lone_point(&hard_rules[r], 2.7, 141, 133);
        lone_point(&hard_rules[r], 8, 231, 221);
        lone_point(&hard_rules[r], 20, 501, 1);
        lone_point(&hard_rules[r], 20, 1, 501);
        lone_point(&hard_rules[r], 64, 1601, 1);
    }
}

// Non-negative taps lose nothing beside a large neighbour (METHODS section 3.3), so the glow of both is the sum of the
// glows, pixel by pixel. That needs no second design to compare with.
static void case_5_point_on_noise(void)
{
    for (unsigned r = 0; r < RULES; r++) {
        struct params p = scene_params("gaussians:sigma=4/16,weight=.5/.5", BRIGHT_NONE, hard_rules[r].tolerance);
        p.intensity = 1e4;
        struct scene s;
        scene_init(&s, 260, 180, 1, PIXEL_TYPE_FLOAT);
        s.plane[0][90 * 260 + 101] = 1e6;
        double *point = hard_output(&s, &p);
        for (size_t i = 0; i < hard_count(&s); i++)
            s.plane[0][i] = i == 90 * 260 + 101 ? 0 : 1e-3 * scene_uniform();
        double *noise = hard_output(&s, &p);
        s.plane[0][90 * 260 + 101] = 1e6;
        double *both = hard_output(&s, &p);
        for (size_t i = 0; i < hard_count(&s); i++)
            point[i] += noise[i];
        figure(5, "1e6 on 1e-3 noise: pointwise", hard_rules[r].name, hard_relative(both, point, hard_count(&s)), 1e-5, "relative");
        figure(5, "1e6 on 1e-3 noise: error / bound", hard_rules[r].name, hard_ratio(&s, &p), 1, "of the bound");
        free(point), free(noise), free(both);
        scene_finish(&s);
    }
}

static void case_6_dark_beside_bright(void)
{
    for (unsigned r = 0; r < RULES; r++)
        for (int type = PIXEL_TYPE_HALF; type <= PIXEL_TYPE_FLOAT; type++) {
            const bool half = type == PIXEL_TYPE_HALF;
            struct params p = scene_params("gaussians:sigma=3/6,weight=.5/.5", BRIGHT_NONE, hard_rules[r].tolerance);
            struct scene s;
            scene_init(&s, 201, 151, 1, (enum pixel_type)type);
            hard_fill(&s, 1e-6);
            s.plane[0][75 * 201 + 100] = 6e4;
            const double ratio = hard_ratio(&s, &p);
            double lost = 0, far = INFINITY;
            for (size_t i = 0; i < hard_count(&s); i++) {
                lost += s.out[0][0][i] < s.plane[0][i];
                far = fmin(far, s.out[0][0][i]);
            }
            figure(6, half ? "6e4 beside 1e-6: lost or negative (half)" : "6e4 beside 1e-6: lost or negative (float)",
                   hard_rules[r].name, lost, 0, "px");
            figure(6, half ? "6e4 beside 1e-6: error / bound (half)" : "6e4 beside 1e-6: error / bound (float)",
                   hard_rules[r].name, ratio, 1, "of the bound");
            // The corner sees half and half of the field, and a quarter of its glow.
            figure(6, half ? "6e4 beside 1e-6: 1 - darkest / its due (half)" : "6e4 beside 1e-6: 1 - darkest / its due (float)",
                   hard_rules[r].name, 1 - far / s.plane[0][0] / 1.25, .05, "share");
            scene_finish(&s);
        }
}

// A frame and the same frame 2^-100 times as bright: the glow follows exactly, until float32's denormals. Those may be
// flushed to 0 (lavapipe does so): then what is missing is below 2^-126 an operation.
static void case_7_tiny(void)
{
    for (unsigned r = 0; r < RULES; r++) {
        struct params p = scene_params("gaussians:sigma=3/7,weight=.5/.5", BRIGHT_NONE, hard_rules[r].tolerance);
        struct scene s;
        scene_init(&s, 70, 54, 1, PIXEL_TYPE_FLOAT);
        for (size_t i = 0; i < hard_count(&s); i++)
            s.plane[0][i] = (float)(pow(10, -44 + 8 * scene_uniform()) * 0x1p100);
        double *bright = hard_output(&s, &p), worst = 0, missing = 0, odd = 0;
        for (size_t i = 0; i < hard_count(&s); i++)
            s.plane[0][i] *= 0x1p-100;
        double *dark = hard_output(&s, &p);
        for (size_t i = 0; i < hard_count(&s); i++) {
            const double want = bright[i] * 0x1p-100;
            odd += !isfinite(dark[i]) || dark[i] < 0;
            missing = fmax(missing, fabs(dark[i] - want) / 0x1p-126);
            if (want > 1e-37)
                worst = fmax(worst, fabs(dark[i] / want - 1));
        }
        figure(7, "1e-44..1e-36: NaN or negative", hard_rules[r].name, odd, 0, "px");
        figure(7, "1e-44..1e-36: where out > 1e-37", hard_rules[r].name, worst, INFINITY, "relative");
        figure(7, "1e-44..1e-36: flushed", hard_rules[r].name, missing, 40, "x 2^-126");
        // Ten times brighter nothing needs denormals any more.
        for (size_t i = 0; i < hard_count(&s); i++)
            s.plane[0][i] = (float)fmax(bright[i] * 0x1p-80, 1e-30);
        free(bright), free(dark);
        bright = hard_output(&s, &p);
        for (size_t i = 0; i < hard_count(&s); i++)
            s.plane[0][i] *= 0x1p60;
        dark = hard_output(&s, &p);
        for (size_t i = 0; i < hard_count(&s); i++)
            bright[i] *= 0x1p60;
        figure(7, "1e-30: against the same times 2^60", hard_rules[r].name, hard_relative(dark, bright, hard_count(&s)), 1e-6, "relative");
        free(bright), free(dark);
        scene_finish(&s);
    }
}

static void case_8_huge(void)
{
    for (unsigned r = 0; r < RULES; r++)
        for (int curve = BRIGHT_NONE; curve <= BRIGHT_SMOOTHSTEP; curve++) {
            char what[64];
            struct params p = scene_params("gaussians:sigma=3/12,weight=.5/.5", (enum bright_curve)curve, hard_rules[r].tolerance);
            struct scene s;
            scene_init(&s, 60, 44, 3, PIXEL_TYPE_FLOAT);
            double odd = 0;
            for (int huge_knee = 0; huge_knee < 2; huge_knee++) {
                p.threshold = huge_knee ? 1e37 : 1;
                p.knee = huge_knee ? curve == BRIGHT_SMOOTHSTEP ? 1 : 1e37 : .5;
                for (unsigned c = 0; c < 3; c++)
                    for (size_t i = 0; i < hard_count(&s); i++)
                        s.plane[c][i] = i % 7 ? 1.7e38 : 3e38;
                hard_run(&s, &p);
                for (unsigned c = 0; c < 3; c++)
                    for (size_t i = 0; i < hard_count(&s); i++)
                        odd += !isfinite(s.out[0][c][i]) || s.out[0][c][i] < s.plane[c][i] * (1 - 1e-6);
            }
            snprintf(what, sizeof(what), "1.7e38 and 3e38: Inf NaN or less (%s)", curves[curve]);
            figure(8, what, hard_rules[r].name, odd, 0, "px");
            scene_finish(&s);
        }
}

static void case_9_nonfinite(void)
{
    for (unsigned r = 0; r < RULES; r++)
        for (int policy = NONFINITE_KEEP; policy <= NONFINITE_ZERO; policy++) {
            const bool keep = policy == NONFINITE_KEEP;
            struct params p = scene_params("gaussians:sigma=4/24,weight=.5/.5", BRIGHT_KNEE, hard_rules[r].tolerance);
            p.nonfinite = policy;
            struct scene s;
            scene_init(&s, 150, 110, 3, PIXEL_TYPE_HALF);
            scene_fill(&s);
            s.plane[0][45 * 150 + 10] = NAN;
            s.plane[1][20 * 150 + 80] = INFINITY;
            s.plane[2][20 * 150 + 81] = -INFINITY;
            const double ratio = hard_ratio(&s, &p);
            double spread = 0;
            for (unsigned c = 0; c < 3; c++)
                for (size_t i = 0; i < hard_count(&s); i++)
                    spread += !isfinite(s.out[0][c][i]) && !(keep && !isfinite(s.plane[c][i]));
            figure(9, keep ? "NaN and Inf: spread (keep)" : "NaN and Inf: left (zero)", hard_rules[r].name, spread, 0, "px");
            figure(9, keep ? "NaN and Inf: error / bound (keep)" : "NaN and Inf: error / bound (zero)", hard_rules[r].name,
                   ratio, 1, "of the bound");
            scene_finish(&s);
        }
}

static void case_10_wide_gamut(void)
{
    for (unsigned r = 0; r < RULES; r++) {
        struct params p = scene_params("gaussians:sigma=2.7/12,weight=.5/.5", BRIGHT_LUMINANCE, hard_rules[r].tolerance);
        struct scene s;
        scene_init(&s, 120, 90, 3, PIXEL_TYPE_FLOAT);
        memcpy(s.luma, (float[3]){ .2722287f, .6740818f, .0536895f }, sizeof(s.luma));
        for (unsigned c = 0; c < 3; c++)
            for (size_t i = 0; i < hard_count(&s); i++)
                s.plane[c][i] = 6 * scene_uniform() - 2;
        s.plane[0][10 * 120 + 10] = 4; // Y = 1.089 by these weights, .851 by Rec.709's
        s.plane[1][10 * 120 + 10] = s.plane[2][10 * 120 + 10] = -.01;
        const double ratio = hard_ratio(&s, &p);
        double darker = 0;
        for (unsigned c = 0; c < 3; c++)
            for (size_t i = 0; i < hard_count(&s); i++)
                darker += s.out[0][c][i] < s.plane[c][i];
        figure(10, "negatives and AP1: made darker", hard_rules[r].name, darker, 0, "px");
        figure(10, "negatives and AP1: error / bound", hard_rules[r].name, ratio, 1, "of the bound");
        scene_finish(&s);
    }
}

// Every pixel of a ramp blooms alone (a Gaussian of .1 pixel has one tap), so the glow is the curve itself.
static void ramp(int curve, double threshold, double knee)
{
    enum { N = 4096 };
    char what[96];
    struct params p = scene_params("gaussians:sigma=0.1,weight=1", (enum bright_curve)curve, 1e-3);
    p.threshold = threshold;
    p.knee = knee;
    p.intensity = 1e6; // the glow drowns the ramp, so that its float32 is E's
    struct scene s;
    scene_init(&s, N, 1, 1, PIXEL_TYPE_FLOAT);
    // Around T and both ends of the knee in steps of one float, 3 decades in steps of a thousandth between.
    const double ends[] = { threshold - knee, threshold, threshold + knee };
    const double ends_of_share[] = { threshold * (1 - knee), threshold, threshold * (1 + knee) };
    const double base = threshold > 0 ? threshold : 1e-6;
    for (unsigned i = 0; i < N; i++)
        s.plane[0][i] = base * pow(10, -1.5 + 3. * i / N);
    for (unsigned e = 0; e < 3; e++) {
        const double at = curve == BRIGHT_SMOOTHSTEP ? ends_of_share[e] : ends[e];
        float v = (float)at;
        for (unsigned i = 0; at > 0 && i < 32; i++)
            v = nextafterf(v, 0);
        for (unsigned i = 0; at > 0 && i < 64; i++, v = nextafterf(v, INFINITY))
            s.plane[0][e * 64 + i] = v;
    }
    hard_run(&s, &p);
    double back = 0, off = 0, jump = 0;
    for (unsigned i = 0; i < N; i++) {
        double want[3], pixel[3] = { s.plane[0][i] };
        const double e = hard_glow(&s, &p, 0, i), L = s.plane[0][i];
        reference_bright(want, pixel, 1, NULL, &p);
        off = fmax(off, fabs(e - want[0]) / L);
        if (i % 64 == 0) // where runs meet
            continue;
        const double before = hard_glow(&s, &p, 0, i - 1), step = L - s.plane[0][i - 1];
        if (step < 0)
            continue;
        back = fmax(back, (before - e) / L);
        jump = fmax(jump, (e - before - 8 * step) / L);
    }
    snprintf(what, sizeof(what), "%s T=%g K=%g: off the curve", curves[curve], threshold, knee);
    figure(11, what, "-", off, curve == BRIGHT_SMOOTHSTEP ? 4e-6 : 1e-6, "of L");
    snprintf(what, sizeof(what), "%s T=%g K=%g: falls where L rises", curves[curve], threshold, knee);
    figure(11, what, "-", back, 5e-7, "of L");
    snprintf(what, sizeof(what), "%s T=%g K=%g: jump", curves[curve], threshold, knee);
    figure(11, what, "-", jump, 1e-6, "of L");
    scene_finish(&s);
}

static void case_11_curves(void)
{
    for (int curve = BRIGHT_NONE; curve <= BRIGHT_SMOOTHSTEP; curve++) {
        ramp(curve, 1, .5);
        ramp(curve, 100, curve == BRIGHT_SMOOTHSTEP ? .3 : 40);
        ramp(curve, 1e-6, curve == BRIGHT_SMOOTHSTEP ? 1 : .5); // the knee is wider than T: it shrinks
        if (curve != BRIGHT_SMOOTHSTEP)
            ramp(curve, 0, .5);
    }
}

// The frame alone, and the same light as part of a larger frame: zero extension says that they glow alike.
static void embedded(unsigned number, const char *name, double aspect)
{
    enum { W = 97, H = 71, PAD = 61, WIDE = W + 2 * PAD }; // odd: other cells of the pyramid
    for (unsigned r = 0; r < RULES; r++) {
        char what[96];
        struct params p = scene_params("gaussians:sigma=4/11/30,weight=.3/.3/.3", BRIGHT_CHANNEL, hard_rules[r].tolerance);
        struct scene s, large;
        scene_init(&s, W, H, 1, PIXEL_TYPE_FLOAT);
        scene_init(&large, WIDE, H + 2 * PAD, 1, PIXEL_TYPE_FLOAT);
        s.aspect = large.aspect = aspect;
        hard_border(&s);
        for (unsigned i = 0; i < W * H; i++)
            large.plane[0][(i / W + PAD) * WIDE + PAD + i % W] = s.plane[0][i];
        const double ratio = hard_ratio(&s, &p);
        hard_run(&large, &p);
        double worst = 0, in = 0, out = 0;
        for (unsigned i = 0; i < W * H; i++) {
            worst = fmax(worst, fabs(large.out[0][0][(i / W + PAD) * WIDE + PAD + i % W] - s.out[0][0][i]));
            in += fmax(0, s.plane[0][i] - 1);
            out += hard_glow(&s, &p, 0, i);
        }
        snprintf(what, sizeof(what), "%s: error / bound", name);
        figure(number, what, hard_rules[r].name, ratio, 1, "of the bound");
        snprintf(what, sizeof(what), "%s: against a larger window", name);
        figure(number, what, hard_rules[r].name,
               worst / s.reply.max_bright / (s.reply.error_bound + large.reply.error_bound), 1, "of both bounds");
        snprintf(what, sizeof(what), "%s: light gained", name);
        figure(number, what, hard_rules[r].name, out / (in * .9), 1, "of what glows");
        scene_finish(&s);
        scene_finish(&large);
    }
}

static void case_13_borders(void) { embedded(13, "lit borders", 1); }
static void case_17_aspect(void)
{
    embedded(17, "aspect 2", 2);
    embedded(17, "aspect 0.5", .5);
    embedded(17, "aspect 1.0926", 1.0926);
}

static void case_14_sizes(void)
{
    static const unsigned sizes[][2] = { { 1, 1 },   { 1, 7 },  { 2, 1 },   { 3, 5 },    { 1, 131 }, { 131, 1 },
                                         { 127, 31 }, { 9, 4 }, { 17, 33 }, { 128, 3 }, { 101, 103 } };
    for (unsigned r = 0; r < RULES; r++) {
        double worst = 0;
        for (unsigned i = 0; i < sizeof(sizes) / sizeof(sizes[0]); i++)
            for (int type = PIXEL_TYPE_HALF; type <= PIXEL_TYPE_FLOAT; type++) {
                struct params p = scene_params("gaussians:sigma=1.8/4/11/40,weight=.2/.2/.2/.4", BRIGHT_KNEE,
                                               hard_rules[r].tolerance);
                struct scene s;
                scene_init(&s, sizes[i][0], sizes[i][1], i % 2 ? 1 : 3, (enum pixel_type)type);
                scene_fill(&s);
                worst = fmax(worst, hard_ratio(&s, &p));
                scene_finish(&s);
            }
        figure(14, "1x1 1xN Nx1 odd and prime: error / bound", hard_rules[r].name, worst, 1, "of the bound");
    }
}

/* ---- case 15 ----------------------------------------------------------------------------------------- */

static const char psf_15[] = "gaussians:sigma=4/16,weight=.5/.5";

static void linearity(const struct hard_rule *rule)
{
    struct params p = scene_params(psf_15, BRIGHT_NONE, rule->tolerance);
    struct scene s;
    scene_init(&s, 131, 90, 1, PIXEL_TYPE_FLOAT);
    scene_fill(&s);
    double *x = hard_copy(s.plane[0], hard_count(&s)), *bx = hard_output(&s, &p);
    scene_fill(&s);
    double *y = hard_copy(s.plane[0], hard_count(&s)), *by = hard_output(&s, &p);
    for (size_t i = 0; i < hard_count(&s); i++) {
        s.plane[0][i] = (float)x[i] * 2. + (float)y[i] * .25;
        bx[i] = 2 * bx[i] + .25 * by[i];
    }
    double *sum = hard_output(&s, &p);
    figure(15, "linearity", rule->name, hard_relative(sum, bx, hard_count(&s)), 1e-6, "relative");
    free(x), free(y), free(bx), free(by), free(sum);
    scene_finish(&s);
}

// Sides of a multiple of 2^levels, so that mirroring maps cells onto cells; a transpose may have any.
static void mirrored(const struct hard_rule *rule)
{
    enum { W = 192, H = 128, N = W * H };
    struct params p = scene_params(psf_15, BRIGHT_CHANNEL, rule->tolerance);
    struct scene s, t;
    scene_init(&s, W, H, 1, PIXEL_TYPE_FLOAT);
    scene_init(&t, H, W, 1, PIXEL_TYPE_FLOAT);
    scene_fill(&s);
    for (unsigned i = 0; i < N; i++)
        t.plane[0][i % W * H + i / W] = s.plane[0][i];
    double *straight = hard_output(&s, &p), *turned = hard_output(&t, &p), *v = hard_copy(turned, N);
    for (unsigned i = 0; i < N; i++)
        v[i] = turned[i % W * H + i / W];
    figure(15, "transpose", rule->name, hard_relative(v, straight, N), 1e-6, "relative");
    for (unsigned i = 0; i < N; i++)
        v[N - 1 - i] = s.plane[0][i];
    memcpy(s.plane[0], v, N * sizeof(*v));
    free(turned);
    turned = hard_output(&s, &p);
    for (unsigned i = 0; i < N; i++)
        v[i] = turned[N - 1 - i];
    figure(15, "flip of both axes", rule->name, hard_relative(v, straight, N), 1e-6, "relative");
    free(straight), free(turned), free(v);
    scene_finish(&s);
    scene_finish(&t);
}

// The same frame on a device of its own with one thread, and in another slot: the same bytes.
static void threads(const struct hard_rule *rule, struct bloom *one_thread)
{
    struct params p = scene_params(psf_15, BRIGHT_KNEE, rule->tolerance);
    struct scene s;
    scene_init(&s, 333, 217, 3, PIXEL_TYPE_FLOAT);
    scene_fill(&s);
    double differ = 0, *many[3];
    hard_run(&s, &p);
    for (unsigned c = 0; c < 3; c++)
        many[c] = hard_copy(s.out[0][c], hard_count(&s));
    for (unsigned k = 0; k < 2; k++) {
        scene_run(&s, &p, k ? hard_engine : one_thread, k);
        for (unsigned c = 0; c < 3; c++)
            for (size_t i = 0; i < hard_count(&s); i++)
                differ += many[c][i] != s.out[0][c][i];
    }
    figure(15, "one thread and another slot: other bits", rule->name, differ, 0, "samples");
    for (unsigned c = 0; c < 3; c++)
        free(many[c]);
    scene_finish(&s);
}

static void case_15_symmetries(void)
{
    struct bloom *one_thread;
    struct fault f = { 0 };
    const struct bloom_options options = { .slots = 1, .device = bloom_device(hard_engine)->name };
    setenv("LP_NUM_THREADS", "1", 1); // lavapipe reads it when a device is made
    if (bloom_create(&one_thread, &options, &f) < 0)
        fail_msg("%s", f.text);
    unsetenv("LP_NUM_THREADS");
    for (unsigned r = 0; r < RULES; r++) {
        linearity(&hard_rules[r]);
        mirrored(&hard_rules[r]);
        threads(&hard_rules[r], one_thread);
    }
    bloom_destroy(one_thread);
}

static void case_16_fireflies(void)
{
    for (unsigned r = 0; r < RULES; r++) {
        struct params p = scene_params("gaussians:sigma=2.7/20,weight=.3/.3", BRIGHT_CHANNEL, hard_rules[r].tolerance);
        double low = INFINITY, high = 0, ratio = 0;
        for (unsigned frame = 0; frame < 3; frame++) {
            struct scene s;
            scene_init(&s, 190, 150, 1, PIXEL_TYPE_FLOAT);
            for (unsigned i = 0; i < 1000; i++)
                s.plane[0][(size_t)(scene_uniform() * 190 * 150)] = 1e4;
            ratio = fmax(ratio, hard_ratio(&s, &p));
            // What is in the picture and what the ledger calls lost, of the light that there is.
            double glow = s.reply.energy_lost, light = 0;
            for (size_t i = 0; i < hard_count(&s); i++) {
                glow += hard_glow(&s, &p, 0, i);
                light += fmax(0, s.plane[0][i] - 1);
            }
            low = fmin(low, glow / (.6 * light));
            high = fmax(high, glow / (.6 * light));
            scene_finish(&s);
        }
        figure(16, "1000 fireflies: error / bound", hard_rules[r].name, ratio, 1, "of the bound");
        figure(16, "1000 fireflies: range of glow / light", hard_rules[r].name, high - low, 1e-4, "relative");
        figure(16, "1000 fireflies: glow / light - 1", hard_rules[r].name, fmax(high - 1, 1 - low), 1e-4, "relative");
    }
}

int main(void)
{
    const struct hard_case cases[] = {
        { true, "case_1_dark", case_1_dark },
        { true, "case_2_flat", case_2_flat },
        { true, "case_3_point", case_3_point },
        { true, "case_5_point_on_noise", case_5_point_on_noise },
        { true, "case_6_dark_beside_bright", case_6_dark_beside_bright },
        { true, "case_7_tiny", case_7_tiny },
        { true, "case_8_huge", case_8_huge },
        { true, "case_9_nonfinite", case_9_nonfinite },
        { true, "case_10_wide_gamut", case_10_wide_gamut },
        { true, "case_11_curves", case_11_curves },
        { true, "case_13_borders", case_13_borders },
        { true, "case_14_sizes", case_14_sizes },
        { true, "case_15_symmetries", case_15_symmetries },
        { true, "case_16_fireflies", case_16_fireflies },
        { true, "case_17_aspect", case_17_aspect },
    };
    return hard_main("hard", cases, sizeof(cases) / sizeof(cases[0]));
}
