// SPDX-License-Identifier: Apache-2.0
// test_look.c - the five named looks on the device that is there, each pixel against the float64 reference: 1e-5 of the frame's
// largest value, and the bound that the reply states. Validation layers are on, and any message fails.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "look_kit.h"

static struct bloom *engine, *staged;
static bool validate = true;
static void log_line(const char *line) { print_message("%s\n", line); }

/* ---- what is asked --------------------------------------------------------------------------------------- */

static const char *const names[] = { "none", "half-gaussian", "mip-chain", "three-scale", "jimenez", "airy-eight" };
static const unsigned sizes[][2] = { { 1, 1 }, { 1, 7 }, { 7, 1 }, { 2, 2 }, { 13, 11 }, { 64, 64 }, { 97, 131 }, { 333, 190 } };
static const struct { unsigned channels; enum pixel_type type; } kinds[] = { { 3, PIXEL_TYPE_FLOAT }, { 3, PIXEL_TYPE_HALF },
                                                                             { 1, PIXEL_TYPE_FLOAT }, { 1, PIXEL_TYPE_HALF } };
#define COUNT(a) (sizeof(a) / sizeof((a)[0]))

// METHODS' own numbers of each look.
static struct params asked(int look)
{
    struct params p;
    params_init(&p);
    p.look = look;
    if (look == LOOK_HALF_GAUSSIAN || look == LOOK_JIMENEZ)
        p.threshold = .8;
    if (look == LOOK_HALF_GAUSSIAN)
        p.intensity = 1.5;
    return p;
}

static double try_it(unsigned w, unsigned h, unsigned kind, const struct params *p, const bool with[ROLES], const char *what)
{
    struct scene s;
    scene_init(&s, w, h, kinds[kind].channels, kinds[kind].type);
    if (with)
        memcpy(s.with, with, sizeof(s.with));
    s.aspect = 1.25;
    scene_run(&s, p, engine);
    assert_false(s.reply.untouched);
    const double worst = scene_check(&s, p, what);
    scene_finish(&s);
    return worst;
}

static void every_look_at_every_size(void **state)
{
    (void)state;
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++) {
        const struct params p = asked(look);
        double worst = 0;
        for (unsigned i = 0; i < COUNT(sizes); i++)
            for (unsigned kind = 0; kind < COUNT(kinds); kind++)
                worst = fmax(worst, try_it(sizes[i][0], sizes[i][1], kind, &p, NULL, names[look]));
        print_message("%s: worst %.2g of the largest value\n", names[look], worst);
    }
}

/* One more number set than the look's own. */
struct option {
    const char *what;
    int look;
    void (*set)(struct params *p);
};

static void kawase_1(struct params *p) { p->kawase = 1; }
static void kawase_5(struct params *p) { p->kawase = 5; }
static void six(struct params *p)
{
    p->stages = STAGES_6;
    p->tint_count = 2;
    memcpy(p->tints, (double[2][3]){ { 1, .5, .25 }, { .3, 1.5, .7 } }, 2 * sizeof(p->tints[0]));
}
static void six_kawase_16(struct params *p)
{
    six(p);
    p->kawase = 16;
}
static void legacy(struct params *p) { p->legacy_gain = SWITCH_ON; }
static void wide_steps(struct params *p) { p->radius = 2.3; }
static void no_steps(struct params *p) { p->radius = 0; }
static void stops(struct params *p)
{
    p->threshold_unit = UNIT_STOPS;
    p->threshold = -1.5;
    p->exposure = 1.25;
    p->intensity = .7;
}
static void no_threshold(struct params *p) { p->threshold = 0; }
static void no_knee(struct params *p) { p->knee = 0; }
static void the_sun(struct params *p)
{
    p->sun_spec = (struct sun_spec){ .given = true, .x_percent = 37.3, .y_percent = 21.7, .radius = { 9, SIZE_PERCENT },
                                     .gain = 300, .tint = { 1, .9, .7 } };
}
static void the_sun_outside(struct params *p)
{
    the_sun(p);
    p->sun_spec.x_percent = -3;
    p->sun_spec.radius = (struct size){ 11.5, SIZE_PIXELS };
}
static void the_sun_in_mm(struct params *p)
{
    the_sun(p);
    p->sun_spec.radius = (struct size){ 2, SIZE_MM };
}

static const struct option options[] = {
    { "three-scale, kawase=1", LOOK_THREE_SCALE, kawase_1 },
    { "three-scale, kawase=5", LOOK_THREE_SCALE, kawase_5 },
    { "three-scale, six tints", LOOK_THREE_SCALE, six },
    { "three-scale, six tints, kawase=16", LOOK_THREE_SCALE, six_kawase_16 },
    { "jimenez, legacy", LOOK_JIMENEZ, legacy },
    { "jimenez, radius 2.3", LOOK_JIMENEZ, wide_steps },
    { "jimenez, radius 0", LOOK_JIMENEZ, no_steps },
    { "mip-chain, knee 0", LOOK_MIP_CHAIN, no_knee },
    { "mip-chain, sun", LOOK_MIP_CHAIN, the_sun },
    { "mip-chain, sun outside", LOOK_MIP_CHAIN, the_sun_outside },
    { "mip-chain, sun in mm", LOOK_MIP_CHAIN, the_sun_in_mm },
    { "half-gaussian, stops", LOOK_HALF_GAUSSIAN, stops },
    { "mip-chain, stops", LOOK_MIP_CHAIN, stops },
    { "three-scale, stops", LOOK_THREE_SCALE, stops },
    { "jimenez, stops", LOOK_JIMENEZ, stops },
    { "airy-eight, stops", LOOK_AIRY_EIGHT, stops },
    { "half-gaussian, T 0", LOOK_HALF_GAUSSIAN, no_threshold },
    { "mip-chain, T 0", LOOK_MIP_CHAIN, no_threshold },
    { "three-scale, T 0", LOOK_THREE_SCALE, no_threshold },
};

static void every_option(void **state)
{
    (void)state;
    static const unsigned some[][2] = { { 1, 3 }, { 13, 11 }, { 97, 131 } };
    for (unsigned i = 0; i < COUNT(options); i++) {
        struct params p = asked(options[i].look);
        options[i].set(&p);
        double worst = 0;
        for (unsigned k = 0; k < COUNT(some); k++)
            for (unsigned kind = 0; kind < 3; kind++)
                worst = fmax(worst, try_it(some[k][0], some[k][1], kind, &p, NULL, options[i].what));
        print_message("%s: worst %.2g\n", options[i].what, worst);
    }
}

static void source_matte_and_depth(void **state)
{
    (void)state;
    static const bool with[][ROLES] = { { true, true }, { true, false, true }, { true, true, true }, { true, true, true, true },
                                        { true, false, false, true } };
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++)
        for (unsigned i = 0; i < COUNT(with); i++) {
            struct params p = asked(look);
            p.emission = i & 1 ? 2 : .4;
            if (look == LOOK_MIP_CHAIN)
                the_sun(&p);
            char what[64];
            snprintf(what, sizeof(what), "%s with%s%s%s", names[look], with[i][SOURCE] ? " source" : "",
                     with[i][MATTE] ? " matte" : "", with[i][DEPTH] ? " depth" : "");
            double worst = 0;
            for (unsigned kind = 0; kind < COUNT(kinds); kind++)
                worst = fmax(worst, try_it(43, 29, kind, &p, with[i], what));
            print_message("%s: worst %.2g\n", what, worst);
        }
}

/* The sun behind a wall, in the open, and half of both: the share is what the depths say. */
static void sun_is_hidden_by_depth(void **state)
{
    (void)state;
    struct params p = asked(LOOK_MIP_CHAIN);
    the_sun(&p);
    p.sun_spec.x_percent = p.sun_spec.y_percent = 50;
    p.sun_spec.radius = (struct size){ 8, SIZE_PIXELS };
    p.intensity = 1;
    const float open[3] = { 1, 0, .5f };
    for (unsigned i = 0; i < 3; i++) {
        struct scene s;
        scene_init(&s, 64, 64, 3, PIXEL_TYPE_FLOAT);
        s.with[DEPTH] = true;
        for (unsigned at = 0; at < 64 * 64; at++) {
            for (unsigned c = 0; c < 3; c++)
                s.plane[SCENE][c][at] = 0;
            const bool wall = i == 1 || (i == 2 && at % 64 < 32);
            s.plane[DEPTH][0][at] = at == 0 ? 9 : wall ? 2 : INFINITY;
        }
        scene_run(&s, &p, engine);
        scene_check(&s, &p, "sun and wall");
        // 32 of the 64 points stand left of the middle, give or take the spiral's first turns.
        const double glow = s.out[0][32 * 64 + 32] / (300 * exp(-.5 / 128));
        print_message("sun, open %.1f: share %.4f\n", open[i], glow);
        assert_true(fabs(glow - open[i]) <= (i == 2 ? 3. / 64 : 1e-5));
        scene_finish(&s);
    }
}

static void every_display(void **state)
{
    (void)state;
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++)
        for (int display = DISPLAY_NONE; display <= DISPLAY_ACES; display++)
            for (int encoding = ENCODING_LINEAR; encoding <= ENCODING_SRGB; encoding++) {
                struct params p = asked(look);
                p.display = display;
                p.encoding = encoding;
                p.saturation = encoding == ENCODING_SRGB ? 1.4 : encoding == ENCODING_GAMMA22 ? 1 : .6;
                p.exposure = -.5;
                char what[64];
                snprintf(what, sizeof(what), "%s display %d encoding %d", names[look], display, encoding);
                double worst = 0;
                for (unsigned kind = 0; kind < COUNT(kinds); kind++)
                    worst = fmax(worst, try_it(31, 22, kind, &p, NULL, what));
                print_message("%s: worst %.2g\n", what, worst);
            }
}

static void every_view(void **state)
{
    (void)state;
    static const bool with[ROLES] = { true, false, true };
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++)
        for (int view = VIEW_FINAL; view <= VIEW_BLOOM; view++) {
            struct params p = asked(look);
            p.view_spec.view = (enum view)view;
            p.emission = 2;
            p.display = DISPLAY_ACES; // of final alone
            for (unsigned kind = 0; kind < COUNT(kinds); kind++)
                try_it(37, 26, kind, &p, with, "view");
        }
    struct params p = asked(LOOK_JIMENEZ);
    struct scene s;
    struct fault f = { 0 };
    scene_init(&s, 8, 8, 3, PIXEL_TYPE_FLOAT);
    p.view_spec = (struct view_spec){ VIEW_LEVEL, 2 };
    assert_int_equal(scene_try(&s, &p, engine, &f), -1);
    assert_int_equal(f.code, FAULT_PARAM_CONFLICT);
    assert_string_equal(f.field, "params.view");
    scene_finish(&s);
}

// A picture and three layers in one run: each is what it would be alone.
static void layers_are_views(void **state)
{
    (void)state;
    static const enum view views[] = { VIEW_SOURCE, VIEW_BRIGHT, VIEW_BLOOM };
    static const unsigned some[][2] = { { 38, 26 }, { 37, 25 }, { 1, 1 } };
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++)
        for (unsigned i = 0; i < COUNT(some); i++)
            for (unsigned kind = 0; kind < 4; kind++) {
                struct params p = asked(look);
                p.display = DISPLAY_REINHARD; // of the picture alone
                p.emission = 2;
                p.layer_count = COUNT(views);
                for (unsigned k = 0; k < COUNT(views); k++)
                    p.layer[k].view = views[k];
                struct scene s;
                scene_init(&s, some[i][0], some[i][1], kinds[kind / 2].channels, kinds[kind / 2].type);
                s.with[MATTE] = kind & 1;
                scene_run(&s, &p, engine);
                assert_false(s.reply.untouched);
                scene_check(&s, &p, "picture beside layers");
                for (unsigned k = 0; k < COUNT(views); k++) {
                    p.view_spec.view = views[k];
                    scene_take(&s, &s.out_planes[1 + k]);
                    scene_check(&s, &p, "layer");
                }
                // Dark, with layers: nothing glows, and all four are written.
                p.view_spec.view = VIEW_FINAL;
                p.threshold = 1e6;
                p.knee = 0;
                scene_run(&s, &p, engine);
                assert_false(s.reply.untouched);
                assert_true(kind & 1 || s.reply.energy_bloomed == 0);
                for (unsigned k = 0; k < COUNT(views); k++) {
                    p.view_spec.view = views[k];
                    scene_take(&s, &s.out_planes[1 + k]);
                    scene_check(&s, &p, "layer of a dark frame");
                }
                scene_finish(&s);
            }
}

/* ---- light ------------------------------------------------------------------------------------------------------ */

static double view_sum(struct scene *s, struct params p, enum view view)
{
    double sum = 0;
    p.view_spec.view = view;
    scene_reference(s, &p);
    for (unsigned c = 0; c < s->channels; c++)
        for (size_t i = 0; i < (size_t)s->width * s->height; i++)
            sum += s->want[c][i];
    return sum;
}

// E and the glow, summed as a reference would show them.
static double check_light(struct scene *s, const struct params *p, const char *what)
{
    const double bright = view_sum(s, *p, VIEW_BRIGHT), glow = view_sum(s, *p, VIEW_BLOOM);
    const double b = fabs(s->reply.energy_bright - bright) / fmax(bright, 1e-30);
    const double g = fabs(s->reply.energy_bloomed - glow) / fmax(glow, 1e-30);
    if (!(b <= 1e-4 && g <= 1e-4))
        fail_msg("%s, %u x %u x %u: bright %.9g, %.9g expected; bloomed %.9g, %.9g expected", what, s->width, s->height,
                 s->channels, s->reply.energy_bright, bright, s->reply.energy_bloomed, glow);
    assert_true(s->reply.energy_lost == 0);
    return fmax(b, g);
}

static void light_is_summed(void **state)
{
    (void)state;
    static const unsigned some[][2] = { { 1, 1 }, { 1, 7 }, { 2, 2 }, { 13, 11 }, { 64, 64 }, { 67, 50 }, { 142, 70 } };
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++) {
        double worst = 0;
        for (unsigned i = 0; i < COUNT(some); i++)
            for (unsigned kind = 0; kind < 2 * COUNT(kinds); kind++) {
                struct params p = asked(look);
                p.emission = 2;
                // The sums are of linear light, whatever is shown.
                p.display = kind & 1 ? DISPLAY_ACES : DISPLAY_NONE;
                if (look == LOOK_MIP_CHAIN)
                    the_sun(&p);
                struct scene s;
                scene_init(&s, some[i][0], some[i][1], kinds[kind / 2].channels, kinds[kind / 2].type);
                s.with[MATTE] = s.with[SOURCE] = kind & 1;
                scene_run(&s, &p, engine);
                worst = fmax(worst, check_light(&s, &p, names[look]));
                scene_finish(&s);
            }
        print_message("%s: light within %.2g\n", names[look], worst);
    }
}

/* ---- hard cases --------------------------------------------------------------------------------------------------- */

static void flat(struct scene *s, double v);

// Values from the ends of float32's range: the bound holds, or the sum is held at the largest float.
static void ends_of_the_range(void **state)
{
    (void)state;
    static const double scales[] = { 1e-44, 1e-39, 1e-36, 1e-30, 1e30, 1e36, 2e37 };
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++)
        for (unsigned i = 0; i < COUNT(scales); i++)
            for (unsigned w = 40; w <= 41; w++) {
                struct params p = asked(look);
                p.threshold *= scales[i];
                p.knee = look == LOOK_JIMENEZ ? p.knee : p.knee * scales[i];
                struct scene s;
                scene_init(&s, w, 30, 3, PIXEL_TYPE_FLOAT);
                for (unsigned c = 0; c < 3; c++)
                    for (unsigned k = 0; k < w * 30; k++)
                        s.plane[SCENE][c][k] = fmin(s.plane[SCENE][c][k] / 4, 3) * scales[i];
                scene_run(&s, &p, engine);
                scene_reference(&s, &p);
                double largest = 0, worst = 0;
                for (unsigned c = 0; c < 3; c++)
                    for (unsigned k = 0; k < w * 30; k++) {
                        assert_true(isfinite(s.out[c][k]) && s.out[c][k] >= 0);
                        largest = fmax(largest, s.want[c][k]);
                        worst = fmax(worst, fabs(s.out[c][k] - s.want[c][k]));
                    }
                if (w == 40)
                    print_message("%s at %.0e: worst %.3g of the largest value\n", names[look], scales[i], worst / largest);
                // Below the normal floats a device may flush to 0, so each sum may lose some of the smallest normal float.
                assert_true(worst <= 1e-5 * largest + 32 * 0x1p-126);
                if (scales[i] >= 1e-30)
                    check_light(&s, &p, names[look]);
                scene_finish(&s);
            }
}

// One lit pixel in each corner, and one of NaN or Inf beside each.
static void corners_and_their_neighbours(void **state)
{
    (void)state;
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++) {
        double worst = 0;
        for (unsigned kind = 0; kind < COUNT(kinds); kind++)
            for (unsigned corner = 0; corner < 4; corner++)
                for (unsigned bad = 0; bad < 3; bad++) {
                    const struct params p = asked(look);
                    struct scene s;
                    scene_init(&s, 34 + (corner & 1), 22, kinds[kind].channels, kinds[kind].type);
                    flat(&s, 0);
                    const unsigned x = corner & 1 ? s.width - 1 : 0, y = corner & 2 ? 21 : 0;
                    const unsigned nx = corner & 1 ? x - 1 : 1;
                    for (unsigned c = 0; c < s.channels; c++) {
                        s.plane[SCENE][c][y * s.width + x] = 6e4;
                        s.plane[SCENE][c][y * s.width + nx] = bad == 0 ? NAN : bad == 1 ? INFINITY : -INFINITY;
                    }
                    scene_run(&s, &p, engine);
                    worst = fmax(worst, scene_check(&s, &p, "corner"));
                    check_light(&s, &p, names[look]);
                    scene_finish(&s);
                }
        print_message("%s, corners beside NaN and Inf: worst %.2g\n", names[look], worst);
    }
}

// Halvings of sizes that 256 divides know no left nor right: a frame turned around gives its picture turned around.
static void flips(void **state)
{
    (void)state;
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++) {
        const struct params p = asked(look);
        struct scene s, t;
        const unsigned w = 256, h = 256;
        scene_init(&s, w, h, 3, PIXEL_TYPE_FLOAT);
        scene_init(&t, w, h, 3, PIXEL_TYPE_FLOAT);
        for (unsigned c = 0; c < 3; c++)
            for (unsigned i = 0; i < w * h; i++)
                t.plane[SCENE][c][w * h - 1 - i] = s.plane[SCENE][c][i];
        scene_run(&s, &p, engine);
        scene_run(&t, &p, engine);
        double worst = 0, largest = 0;
        for (unsigned c = 0; c < 3; c++)
            for (unsigned i = 0; i < w * h; i++) {
                worst = fmax(worst, fabs(t.out[c][w * h - 1 - i] - s.out[c][i]));
                largest = fmax(largest, fabs(s.out[c][i]));
            }
        print_message("%s turned around: worst %.2g of the largest value\n", names[look], worst / largest);
        assert_true(worst <= 1e-6 * largest);
        assert_true(fabs(s.reply.energy_bloomed - t.reply.energy_bloomed) <= 1e-5 * s.reply.energy_bloomed);
        scene_finish(&s);
        scene_finish(&t);
    }
}

// METHODS' numbers where all sizes are even are held to 1e-5 by proof; the others by what is measured.
static void bounds_are_tight(void **state)
{
    (void)state;
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++)
        for (unsigned i = 0; i < 2; i++) {
            const struct params p = asked(look);
            struct scene s;
            scene_init(&s, i ? 333 : 320, i ? 253 : 256, 3, PIXEL_TYPE_FLOAT);
            scene_run(&s, &p, engine);
            const double share = scene_check(&s, &p, names[look]);
            print_message("%s at %u x %u: bound %.3g, worst %.3g\n", names[look], s.width, s.height, s.reply.error_bound, share);
            assert_true(s.reply.error_bound <= (i && look == LOOK_JIMENEZ ? 1.3e-5 : 1e-5));
            scene_finish(&s);
        }
}

/* ---- policies ------------------------------------------------------------------------------------------------ */

static void staged_makes_the_same_bytes(void **state)
{
    (void)state;
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++)
        for (unsigned kind = 0; kind < COUNT(kinds); kind++) {
            struct params p = asked(look);
            p.emission = 3;
            struct scene s;
            scene_init(&s, 61, 45, kinds[kind].channels, kinds[kind].type);
            s.with[SOURCE] = s.with[MATTE] = s.with[DEPTH] = true;
            if (look == LOOK_MIP_CHAIN)
                the_sun(&p);
            scene_run(&s, &p, engine);
            double *once[3];
            for (unsigned c = 0; c < 3; c++) {
                once[c] = s.out[c];
                assert_non_null(s.out[c] = calloc(61 * 45, sizeof(double)));
            }
            scene_run(&s, &p, staged);
            for (unsigned c = 0; c < s.channels; c++)
                assert_memory_equal(once[c], s.out[c], 61 * 45 * sizeof(double));
            for (unsigned c = 0; c < 3; c++)
                free(once[c]);
            scene_finish(&s);
        }
}

static void flat(struct scene *s, double v)
{
    for (unsigned c = 0; c < s->channels; c++)
        for (size_t i = 0; i < (size_t)s->width * s->height; i++)
            s->plane[SCENE][c][i] = v;
}

static void dark_frames_are_untouched(void **state)
{
    (void)state;
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++) {
        struct params p = asked(look);
        p.threshold = 1;
        struct scene s;
        scene_init(&s, 33, 17, 3, PIXEL_TYPE_FLOAT);
        // At the foot of the curve, exactly, and a step above it.
        const double foot = look == LOOK_MIP_CHAIN || look == LOOK_JIMENEZ ? .5 : 1;
        flat(&s, foot);
        memcpy(s.luma, (float[3]){ .25f, .5f, .25f }, sizeof(s.luma));
        scene_run(&s, &p, engine);
        assert_true(s.reply.untouched);
        flat(&s, foot * 1.01);
        scene_run(&s, &p, engine);
        assert_false(s.reply.untouched);
        scene_check(&s, &p, "just above the foot");
        flat(&s, 7);
        p.intensity = 0;
        scene_run(&s, &p, engine);
        assert_true(s.reply.untouched);
        p.intensity = 1;
        p.bloom = SWITCH_OFF;
        scene_run(&s, &p, engine);
        assert_true(s.reply.untouched);
        // Off, but shown: a display works on the frame as it is.
        p.display = DISPLAY_REINHARD;
        scene_run(&s, &p, engine);
        assert_false(s.reply.untouched);
        assert_true(fabs(s.out[1][40] - 7. / 8) < 1e-6);
        scene_finish(&s);
    }
}

// NaN and Inf stay themselves, or become 0 and take glow; nothing of them gets into the others.
static void nonfinite_pixels(void **state)
{
    (void)state;
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++)
        for (unsigned kind = 0; kind < COUNT(kinds); kind++)
            for (int policy = NONFINITE_KEEP; policy <= NONFINITE_ZERO; policy++) {
                struct params p = asked(look);
                p.nonfinite = policy;
                struct scene s;
                scene_init(&s, 40, 30, kinds[kind].channels, kinds[kind].type);
                s.plane[SCENE][0][5 * 40 + 6] = NAN;
                s.plane[SCENE][0][29 * 40 + 39] = INFINITY;
                s.plane[SCENE][s.channels - 1][12 * 40 + 20] = -INFINITY;
                s.plane[SCENE][0][20 * 40 + 8] = -3;
                scene_run(&s, &p, engine);
                scene_check(&s, &p, "nonfinite");
                for (unsigned c = 0; c < s.channels; c++)
                    for (unsigned i = 0; i < 40 * 30; i++)
                        assert_true(isfinite(s.out[c][i]) || (policy == NONFINITE_KEEP && !isfinite(s.plane[SCENE][c][i])));
                // A dark frame is touched for the sake of a zero alone.
                flat(&s, .01);
                s.plane[SCENE][0][3] = NAN;
                scene_run(&s, &p, engine);
                assert_int_equal(s.reply.untouched, policy == NONFINITE_KEEP);
                if (policy == NONFINITE_ZERO)
                    assert_true(s.out[0][3] == 0 && s.out[0][4] == s.plane[SCENE][0][4]);
                scene_finish(&s);
            }
}

/* Where the glow is 0 the very bits come back, those of -0.0 and of denormals too; a half holds at 65504. */
static void bits_are_handed_on(void **state)
{
    (void)state;
    struct params p = asked(LOOK_HALF_GAUSSIAN);
    struct scene s;
    scene_init(&s, 100, 4, 3, PIXEL_TYPE_FLOAT);
    flat(&s, 0);
    s.plane[SCENE][0][0] = 50;
    s.plane[SCENE][1][90] = -0.0;
    s.plane[SCENE][2][91] = 1e-42;
    scene_run(&s, &p, engine);
    assert_false(s.reply.untouched);
    uint32_t zero, small;
    memcpy(&zero, planes_row(&s.out_planes[0], 1, 0) + 4 * 90, 4);
    memcpy(&small, planes_row(&s.out_planes[0], 2, 0) + 4 * 91, 4);
    assert_int_equal(zero, 0x80000000u);
    assert_true(small == 714);
    assert_true(s.out[0][0] > 50);
    scene_finish(&s);
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++) {
        p = asked(look);
        scene_init(&s, 16, 16, 3, PIXEL_TYPE_HALF);
        flat(&s, 65504);
        scene_run(&s, &p, engine);
        for (unsigned i = 0; i < 256; i++)
            assert_true(s.out[0][i] == 65504);
        scene_finish(&s);
        // The largest floats: no NaN, no Inf.
        scene_init(&s, 16, 16, 3, PIXEL_TYPE_FLOAT);
        flat(&s, 3.4e38);
        scene_run(&s, &p, engine);
        for (unsigned i = 0; i < 256; i++)
            assert_true(isfinite(s.out[2][i]) && s.out[2][i] >= 3.3e38);
        scene_finish(&s);
    }
}

/* ---- what the definitions say of flat fields and lone weights ------------------------------------------------------ */

static double flat_gain(struct params p, double v)
{
    struct scene s;
    scene_init(&s, 70, 50, 3, PIXEL_TYPE_FLOAT);
    flat(&s, v);
    p.view_spec.view = VIEW_BLOOM;
    scene_run(&s, &p, engine);
    const double glow = s.out[1][25 * 70 + 35];
    for (unsigned i = 0; i < 70 * 50; i++)
        assert_true(fabs(s.out[1][i] - glow) <= 4e-6 * glow); // clamped edges: flat to the corners
    scene_finish(&s);
    return glow;
}

static void flat_fields(void **state)
{
    (void)state;
    struct params p = asked(LOOK_HALF_GAUSSIAN);
    assert_true(fabs(flat_gain(p, 4.8) - 1.5 * 4) < 2e-5);
    p = asked(LOOK_MIP_CHAIN);
    assert_true(fabs(flat_gain(p, 6) - 1.02 * 5) < 2e-5);
    p = asked(LOOK_THREE_SCALE);
    const double taps = .227027 + 2 * (.194595 + .121622 + .054054 + .016216);
    assert_true(fabs(flat_gain(p, 6) - 3 * 5 * taps * taps) < 5e-5);
    p = asked(LOOK_JIMENEZ);
    assert_true(fabs(flat_gain(p, 6) - 5 * 6) < 1e-4);
    p.legacy_gain = SWITCH_ON;
    double sum = 0;
    for (int i = 1; i <= 5; i++)
        sum += pow(1.375, i);
    assert_true(fabs(flat_gain(p, 6) - sum * 6) < 1e-3);
    p = asked(LOOK_AIRY_EIGHT);
    assert_true(fabs(flat_gain(p, 6) - 5) < 2e-5);
}

/* mip-chain's weights one by one: a checkerboard of 2^m pixels vanishes to its mean at mip m + 1, and with T = 0 the glow is linear. */
static void weights_of_the_mip_chain(void **state)
{
    (void)state;
    static const double w[] = { .20, .40, .24, .11, .05, .02 };
    struct params p = asked(LOOK_MIP_CHAIN);
    p.threshold = p.knee = 0;
    p.view_spec.view = VIEW_BLOOM;
    struct scene s;
    scene_init(&s, 64, 64, 1, PIXEL_TYPE_FLOAT);
    for (unsigned i = 0; i < 64 * 64; i++)
        s.plane[SCENE][0][i] = (i % 64 + i / 64) & 1;
    scene_run(&s, &p, engine);
    // Mip 0 keeps the board, all others are its mean.
    double mean = 0;
    for (unsigned m = 1; m < 6; m++)
        mean += w[m] / 2;
    for (unsigned i = 0; i < 64 * 64; i++)
        assert_true(fabs(s.out[0][i] - (w[0] * s.plane[SCENE][0][i] + mean)) < 1e-6);
    scene_finish(&s);
}

static void says_what_runs(void **state)
{
    (void)state;
    char text[256];
    for (int look = LOOK_HALF_GAUSSIAN; look <= LOOK_AIRY_EIGHT; look++) {
        const struct params p = asked(look);
        look_print(&p, 1921, 1, text, sizeof(text));
        assert_int_equal(strncmp(text, names[look], strlen(names[look])), 0);
        assert_non_null(strstr(text, look == LOOK_MIP_CHAIN ? "1921 x 1" : "960 x 1"));
    }
}

/* ---- the program ------------------------------------------------------------------------------------------------- */

static int open_engines(void **state)
{
    (void)state;
    struct fault f = { 0 };
    struct bloom_options o = { .slots = 1, .validate = validate, .log = log_line };
    if (bloom_create(&engine, &o, &f) < 0)
        fail_msg("%s", f.text);
    o.staged = true;
    if (bloom_create(&staged, &o, &f) < 0)
        fail_msg("%s", f.text);
    return 0;
}

static int close_engines(void **state)
{
    (void)state;
    const unsigned messages = bloom_validation_messages(engine) + bloom_validation_messages(staged);
    if (messages)
        print_message("%u validation messages\n", messages);
    bloom_destroy(engine);
    bloom_destroy(staged);
    return messages ? -1 : 0;
}

static void validation_is_silent(void **state)
{
    (void)state;
    assert_int_equal(bloom_validation_messages(engine) + bloom_validation_messages(staged), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_look_at_every_size),
        cmocka_unit_test(every_option),
        cmocka_unit_test(source_matte_and_depth),
        cmocka_unit_test(sun_is_hidden_by_depth),
        cmocka_unit_test(every_display),
        cmocka_unit_test(every_view),
        cmocka_unit_test(layers_are_views),
        cmocka_unit_test(light_is_summed),
        cmocka_unit_test(ends_of_the_range),
        cmocka_unit_test(corners_and_their_neighbours),
        cmocka_unit_test(flips),
        cmocka_unit_test(bounds_are_tight),
        cmocka_unit_test(staged_makes_the_same_bytes),
        cmocka_unit_test(dark_frames_are_untouched),
        cmocka_unit_test(nonfinite_pixels),
        cmocka_unit_test(bits_are_handed_on),
        cmocka_unit_test(flat_fields),
        cmocka_unit_test(weights_of_the_mip_chain),
        cmocka_unit_test(says_what_runs),
        cmocka_unit_test(validation_is_silent),
    };
    // AIRY_TEST_VALIDATE=0 runs without the layers (their leaks would drown ours), and without their test.
    validate = !getenv("AIRY_TEST_VALIDATE") || strcmp(getenv("AIRY_TEST_VALIDATE"), "0") != 0;
    cmocka_set_test_filter(getenv("AIRY_TEST_ONLY"));
    return _cmocka_run_group_tests("look", tests, COUNT(tests) - !validate, open_engines, close_engines);
}
