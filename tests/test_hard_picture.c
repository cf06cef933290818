// SPDX-License-Identifier: Apache-2.0
// test_hard_picture.c - METHODS section 4 for what a picture is made of the glow: composites, borders, grown windows, views,
// displays, what is held or taken away, and what a half can hold.
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

static const char *const curves[] = { "none", "channel", "luminance", "knee", "smoothstep" };
static const char psf_two[] = "gaussians:sigma=4/16,weight=.5/.5";

static void case_12_saturated(void)
{
    for (unsigned r = 0; r < RULES; r++) {
        struct params p = scene_params("gaussians:sigma=3/12,weight=1/1", BRIGHT_NONE, hard_rules[r].tolerance);
        struct scene s;
        scene_init(&s, 60, 44, 3, PIXEL_TYPE_HALF);
        hard_fill(&s, 65504);
        hard_run(&s, &p);
        double other = 0;
        for (unsigned c = 0; c < 3; c++)
            for (size_t i = 0; i < hard_count(&s); i++)
                other += s.out[0][c][i] != 65504;
        figure(12, "65504 flat into half: not 65504", hard_rules[r].name, other, 0, "px");
        scene_finish(&s);
    }
}

// What a float picture becomes as half, in the words of frame.h: 65504 for what is above it, each such sample counted, no Inf. Half
// of the frame is dark, so that a count of all, or of none, is wrong.
static void case_12_counted(void)
{
    struct params p = scene_params("gaussians:sigma=3/12,weight=1/1", BRIGHT_NONE, 1e-4);
    struct scene s;
    scene_init(&s, 120, 44, 3, PIXEL_TYPE_FLOAT);
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < hard_count(&s); i++)
            s.plane[c][i] = i % 120 < 60 ? 65504 : 1e-3;
    const double ratio = hard_ratio(&s, &p);
    const struct reference_frame f = scene_reference(&s, NULL);
    struct reference_result truth;
    scene_truth(&truth, &s, &f, &p);
    const double bound = s.reply.error_bound * truth.max_bright * p.intensity;
    uint64_t counted = 0, least = 0, most = 0, other = 0;
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < hard_count(&s); i++) {
            const float v = (float)s.out[0][c][i];
            uint16_t half;
            float back;
            counted += float_to_half(&half, &v, 1);
            half_to_float(&back, &half, 1);
            least += truth.out[c][i] - bound > 65504;
            most += truth.out[c][i] + bound > 65504;
            other += !(back <= 65504) || (v > 65504 && back != 65504);
        }
    assert_true(least > hard_count(&s) && most < 3 * hard_count(&s));
    figure(12, "65504 beside 1e-3: error / bound", "R4", ratio, 1, "of the bound");
    figure(12, "65504 beside 1e-3 as half: above 65504", "R4", (double)other, 0, "samples");
    figure(12, "65504 beside 1e-3 as half: counted too few", "R4", counted < least ? (double)(least - counted) : 0, 0, "samples");
    figure(12, "65504 beside 1e-3 as half: counted too many", "R4", counted > most ? (double)(counted - most) : 0, 0, "samples");
    reference_free(&truth);
    scene_finish(&s);
}

// Case 1: bloom=off hands the frame on, whatever shines in it.
static void off_is_off(void)
{
    struct params p = scene_params(psf_two, BRIGHT_NONE, 1e-3);
    p.bloom = SWITCH_OFF;
    struct scene s;
    scene_init(&s, 65, 41, 3, PIXEL_TYPE_HALF);
    scene_fill(&s);
    hard_run(&s, &p);
    figure(1, "bloom=off: touched", "-", !s.reply.untouched, 0, "frames");
    scene_finish(&s);
}

// Cases 2 and 13: with the border replicated a flat field is flat to its corners, and mix leaves it as it is.
static void flat_to_the_corners(void)
{
    for (unsigned r = 0; r < RULES; r++)
        for (unsigned mix = 0; mix < 2; mix++) {
            struct params p = scene_params("gaussians:sigma=2.7/11/60,weight=.25/.25/.5", BRIGHT_NONE, hard_rules[r].tolerance);
            p.edge = EDGE_FILL;
            p.composite = mix ? COMPOSITE_MIX : COMPOSITE_ADD;
            p.intensity = .5;
            struct scene s;
            scene_init(&s, 133, 71, 3, PIXEL_TYPE_FLOAT);
            hard_fill(&s, 4);
            const double ratio = hard_ratio(&s, &p);
            double worst = 0;
            for (unsigned c = 0; c < 3; c++)
                for (size_t i = 0; i < hard_count(&s); i++)
                    worst = fmax(worst, fabs(s.out[0][c][i] / (mix ? 4 : 6) - 1));
            figure(13, mix ? "fill: flat field mixed" : "fill: flat field to its corners", hard_rules[r].name, worst, 1e-6,
                   "relative");
            figure(13, mix ? "fill and mix: error / bound" : "fill: error / bound", hard_rules[r].name, ratio, 1, "of the bound");
            hard_border(&s);
            figure(13, "fill: lit borders", hard_rules[r].name, hard_ratio(&s, &p), 1, "of the bound");
            scene_finish(&s);
        }
}

// Case 13: mix moves light and makes none: away from the borders the frame's sum stays, whatever glows of it.
static void mixed(const struct hard_rule *rule, int curve, double intensity)
{
    enum { W = 201, H = 181 };
    char what[64];
    struct params p = scene_params("gaussians:sigma=3/6,weight=.5/.5", (enum bright_curve)curve, rule->tolerance);
    p.composite = COMPOSITE_MIX;
    p.intensity = intensity;
    struct scene s;
    scene_init(&s, W, H, 3, PIXEL_TYPE_FLOAT);
    for (unsigned i = 0; i < 60; i++)
        for (unsigned c = 0; c < 3; c++)
            s.plane[c][(80 + i % 20) * W + 90 + i / 3] = 100 * scene_uniform();
    const double ratio = hard_ratio(&s, &p);
    double in = 0, out = 0, moved = 0;
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < hard_count(&s); i++) {
            in += s.plane[c][i];
            out += s.out[0][c][i];
            moved += fabs(s.out[0][c][i] - s.plane[c][i]);
        }
    assert_true(moved > .2 * in);
    snprintf(what, sizeof(what), "mix of %g (%s): sum of the frame", intensity, curves[curve]);
    figure(13, what, rule->name, fabs(out / in - 1), 1e-6, "relative");
    snprintf(what, sizeof(what), "mix of %g (%s): error / bound", intensity, curves[curve]);
    figure(13, what, rule->name, ratio, 1, "of the bound");
    scene_finish(&s);
}

static void mix_conserves(void)
{
    for (unsigned r = 0; r < RULES; r++)
        mixed(&hard_rules[r], BRIGHT_LUMINANCE, .7);
    for (int curve = BRIGHT_NONE; curve <= BRIGHT_SMOOTHSTEP; curve++)
        mixed(&hard_rules[1], curve, 1);
}

// Case 16: what firefly and clamp take away is in the ledger, and a lone firefly is no brighter than they say.
static void fireflies_held(void)
{
    for (unsigned r = 0; r < RULES; r++)
        for (unsigned clamp = 0; clamp < 2; clamp++) {
            struct params p = scene_params(psf_two, BRIGHT_CHANNEL, hard_rules[r].tolerance);
            p.firefly = clamp ? 0 : 4;
            p.clamp = clamp ? 50 : 0;
            struct scene s;
            scene_init(&s, 190, 150, 3, PIXEL_TYPE_FLOAT);
            hard_fill(&s, 2);
            for (unsigned i = 0; i < 1000; i++)
                for (unsigned c = 0, at = (unsigned)(scene_uniform() * 190 * 150); c < 3; c++)
                    s.plane[c][at] = 1e4;
            figure(16, clamp ? "1000 fireflies clamped: error / bound" : "1000 fireflies suppressed: error / bound",
                   hard_rules[r].name, hard_ratio(&s, &p), 1, "of the bound");
            // All of E but what is left, which is at most 50 a channel, or 4 times neighbours that may be fireflies too.
            const double taken = s.reply.energy_clamped + s.reply.energy_suppressed;
            figure(16, clamp ? "1000 fireflies clamped: left" : "1000 fireflies suppressed: left", hard_rules[r].name,
                   s.reply.energy_bright / (taken + s.reply.energy_bright), clamp ? .02 : .6, "of E");
            scene_finish(&s);
        }
}

// Case 17: a window that grows shows what a larger window with darkness around would: the same light at the same place.
static void grown(const struct hard_rule *rule, double aspect)
{
    enum { W = 97, H = 71, GROW = 37, WIDE = W + 2 * GROW, HIGH = H + 2 * GROW };
    char what[64];
    struct params p = scene_params("gaussians:sigma=4/11,weight=.3/.3", BRIGHT_CHANNEL, rule->tolerance);
    struct scene s, large;
    scene_init(&s, W, H, 1, PIXEL_TYPE_FLOAT);
    scene_init(&large, WIDE, HIGH, 1, PIXEL_TYPE_FLOAT);
    s.grow = GROW;
    s.aspect = large.aspect = aspect;
    hard_border(&s);
    for (unsigned i = 0; i < W * H; i++)
        large.plane[0][(i / W + GROW) * WIDE + GROW + i % W] = s.plane[0][i];
    const double ratio = hard_ratio(&s, &p);
    hard_run(&large, &p);
    double worst = 0, beyond = 0;
    for (unsigned i = 0; i < WIDE * HIGH; i++) {
        const unsigned x = i % WIDE, y = i / WIDE;
        worst = fmax(worst, fabs(large.out[0][0][i] - s.out[0][0][i]));
        beyond += x < GROW || y < GROW || x >= GROW + W || y >= GROW + H ? s.out[0][0][i] : 0;
    }
    snprintf(what, sizeof(what), "grown by 37 px (aspect %g): error / bound", aspect);
    figure(17, what, rule->name, ratio, 1, "of the bound");
    snprintf(what, sizeof(what), "grown by 37 px (aspect %g): against a larger window", aspect);
    figure(17, what, rule->name, worst / s.reply.max_bright / (s.reply.error_bound + large.reply.error_bound), 1,
           "of both bounds");
    // The glow that the ledger calls lost is what lies beyond the window, but for what the grown one ends too early for.
    snprintf(what, sizeof(what), "grown by 37 px (aspect %g): not lost but shown", aspect);
    figure(17, what, rule->name, fabs(1 - beyond / s.reply.energy_lost), aspect > 1 ? .01 : .05, "of what is lost");
    scene_finish(&s);
    scene_finish(&large);
}

// With edge=fill the border's light goes on for ever, in the grown window too.
static void grown_and_filled(const struct hard_rule *rule)
{
    struct params p = scene_params("gaussians:sigma=4/11,weight=.3/.3", BRIGHT_CHANNEL, rule->tolerance);
    p.edge = EDGE_FILL;
    struct scene s;
    scene_init(&s, 61, 43, 3, PIXEL_TYPE_HALF);
    s.grow = 19;
    hard_border(&s);
    figure(17, "grown by 19 px and filled: error / bound", rule->name, hard_ratio(&s, &p), 1, "of the bound");
    hard_fill(&s, 3);
    hard_run(&s, &p);
    // A flat field glows alike wherever one looks: 2 * .6 in the window and beyond.
    double worst = 0;
    for (size_t i = 0; i < (61 + 38) * (43 + 38); i++) {
        const double v = s.out[0][1][i], want = v > 2.5 ? 4.2 : 1.2;
        worst = fmax(worst, fabs(v / want - 1));
    }
    figure(17, "grown by 19 px and filled: flat field", rule->name, worst, 0x1p-10, "relative");
    scene_finish(&s);
}

static void grown_window(void)
{
    for (unsigned r = 0; r < RULES; r++) {
        grown(&hard_rules[r], 1);
        grown(&hard_rules[r], 2);
        grown_and_filled(&hard_rules[r]);
    }
}

// Every view at once: they add up, because the reference's do.
static void views_agree(void)
{
    for (int type = PIXEL_TYPE_HALF; type <= PIXEL_TYPE_FLOAT; type++) {
        struct params p = scene_params("gaussians:sigma=2/9/30,weight=.3/.2/.1", BRIGHT_KNEE, 1e-3);
        static const struct view_spec views[] = { { VIEW_SOURCE, 0 }, { VIEW_BRIGHT, 0 },   { VIEW_BLOOM, 0 },
                                                  { VIEW_LEVEL, 0 },  { VIEW_RESIDUAL, 0 }, { VIEW_LEVEL, 2 } };
        p.layer_count = 6;
        memcpy(p.layer, views, sizeof(views));
        struct scene s;
        scene_init(&s, 90, 63, 3, (enum pixel_type)type);
        scene_fill(&s);
        s.plane[1][7] = NAN;
        s.outputs = 7;
        figure(10, "six views beside the picture: error / bound", "R3", hard_ratio(&s, &p), 1, "of the bound");
        scene_finish(&s);
    }
}

// Only the picture passes the display: the views beside it stay linear, and so does a view in its place.
static void views_undisplayed(void)
{
    static const struct view_spec views[] = { { VIEW_SOURCE, 0 }, { VIEW_BRIGHT, 0 }, { VIEW_BLOOM, 0 }, { VIEW_RESIDUAL, 0 } };
    for (int composite = COMPOSITE_ADD; composite <= COMPOSITE_SCREEN_ADD; composite++)
        for (unsigned alone = 0; alone < 2; alone++) {
            struct params p = scene_params("gaussians:sigma=2/9,weight=.3/.2", BRIGHT_KNEE, 1e-3);
            p.composite = composite;
            p.display = DISPLAY_ACES;
            p.encoding = ENCODING_SRGB;
            p.saturation = .8;
            if (alone)
                p.view_spec = (struct view_spec){ VIEW_BLOOM, 0 };
            p.layer_count = 4;
            memcpy(p.layer, views, sizeof(views));
            struct scene s;
            scene_init(&s, 90, 63, 3, PIXEL_TYPE_FLOAT);
            scene_fill(&s);
            s.outputs = 5;
            figure(10, alone ? "displayed: view=bloom and four views: error / bound" : "displayed: four views beside: error / bound",
                   "R3", hard_ratio(&s, &p), 1, "of the bound");
            scene_finish(&s);
        }
}

// Case 8: no display makes NaN or a negative of the ends of the number line.
static void displays_finite(void)
{
    for (int display = DISPLAY_NONE; display <= DISPLAY_ACES; display++)
        for (int encoding = ENCODING_LINEAR; encoding <= ENCODING_SRGB; encoding++) {
            struct params p = scene_params("gaussians:sigma=3,weight=.5", BRIGHT_NONE, 1e-3);
            p.display = display;
            p.encoding = encoding;
            p.saturation = 1.5;
            struct scene s;
            scene_init(&s, 60, 44, 3, PIXEL_TYPE_FLOAT);
            double odd = 0;
            for (unsigned c = 0; c < 3; c++)
                for (size_t i = 0; i < hard_count(&s); i++)
                    s.plane[c][i] = (scene_uniform() < .3 ? -1 : 1) * pow(10, -40 + 78 * scene_uniform());
            hard_run(&s, &p);
            for (unsigned c = 0; c < 3; c++)
                for (size_t i = 0; i < hard_count(&s); i++)
                    odd += !isfinite(s.out[0][c][i]) || s.out[0][c][i] < 0;
            figure(8, "1e-40..1e38 displayed: Inf NaN or negative", "-", odd, 0, "samples");
            for (unsigned c = 0; c < 3; c++)
                for (size_t i = 0; i < hard_count(&s); i++)
                    s.plane[c][i] = 8 * scene_uniform() - 1;
            figure(8, "-1..7 displayed: error / bound", "-", hard_ratio(&s, &p), 1, "of the bound");
            scene_finish(&s);
        }
}

// Cases 3, 6 and 8 with half storage: scaled, so that nothing overflows and the bound holds.
static void half_storage(void)
{
    static const double levels[] = { 1e-26, 1e-6, 1, 6e4, 1e6, 1e37 };
    for (unsigned k = 0; k < 6; k++) {
        char what[64];
        struct params p = scene_params("gaussians:sigma=2.7/8/20,weight=.3/.3/.3", BRIGHT_NONE, 3e-2);
        p.storage = STORAGE_HALF;
        struct scene s;
        scene_init(&s, 150, 97, 3, PIXEL_TYPE_FLOAT);
        for (unsigned c = 0; c < 3; c++)
            for (size_t i = 0; i < hard_count(&s); i++)
                s.plane[c][i] = i == 7000 ? levels[k] : levels[k] * 1e-4 * scene_uniform();
        const double ratio = hard_ratio(&s, &p);
        // Far from 1 float32 is taken: a power of 2 cannot bring such numbers to where half has its digits.
        const bool half = levels[k] > 1e-20 && levels[k] < 1e20;
        assert_string_equal(s.reply.storage, half ? "half" : "float");
        snprintf(what, sizeof(what), "half storage at %g: error / bound", levels[k]);
        figure(3, what, s.reply.rule, ratio, 1, "of the bound");
        scene_finish(&s);
    }
}

int main(void)
{
    const struct hard_case cases[] = {
        { true, "case_12_saturated", case_12_saturated },
        { true, "case_12_counted", case_12_counted },
        { true, "off_is_off", off_is_off },
        { true, "flat_to_the_corners", flat_to_the_corners },
        { true, "mix_conserves", mix_conserves },
        { true, "fireflies_held", fireflies_held },
        { true, "grown_window", grown_window },
        { true, "views_agree", views_agree },
        { true, "views_undisplayed", views_undisplayed },
        { true, "displays_finite", displays_finite },
        { true, "half_storage", half_storage },
    };
    return hard_main("hard_picture", cases, sizeof(cases) / sizeof(cases[0]));
}
