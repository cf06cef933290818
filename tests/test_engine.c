// SPDX-License-Identifier: Apache-2.0
// test_engine.c - the engine on the device that is there, against the float64 reference: every pixel within the
// bound that the reply states. Validation layers are on, and any message fails.
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

#include "scene_kit.h"

static struct bloom *engine;
static bool validate = true;

static void log_line(const char *line) { print_message("%s\n", line); }

static void test_sigmas_and_rules(void **state)
{
    (void)state;
    static const double sigmas[] = { 1.8, 2.7, 4, 6, 8, 12, 16, 32, 64, 128, 256 };
    static const double tolerances[] = { 1e-2, 1e-3, 1e-4, 1e-5 };
    for (unsigned t = 0; t < 4; t++)
        for (unsigned i = 0; i < sizeof(sigmas) / sizeof(sigmas[0]); i++) {
            // The two new-issue rules run on fewer sigmas: their wide kernels take long to compile.
            if (t >= 2 && i % 3)
                continue;
            char psf[64], what[64];
            snprintf(psf, sizeof(psf), "gaussians:sigma=%g,weight=1", sigmas[i]);
            snprintf(what, sizeof(what), "sigma %g tolerance %g", sigmas[i], tolerances[t]);
            struct params p = scene_params(psf, BRIGHT_CHANNEL, tolerances[t]);
            struct scene s;
            scene_init(&s, 181, 133, 3, PIXEL_TYPE_FLOAT);
            scene_fill(&s);
            scene_run(&s, &p, engine, 0);
            assert_true(s.reply.error_bound <= tolerances[t] * 1.01 + 1e-5);
            scene_check(&s, &p, what);
            scene_finish(&s);
        }
}

static void test_curves_and_types(void **state)
{
    (void)state;
    static const char *names[] = { "none", "channel", "luminance", "knee", "smoothstep" };
    for (int curve = BRIGHT_NONE; curve <= BRIGHT_SMOOTHSTEP; curve++)
        for (int type = PIXEL_TYPE_HALF; type <= PIXEL_TYPE_FLOAT; type++)
            for (unsigned channels = 1; channels <= 3; channels += 2) {
                struct params p = scene_params("gaussians:sigma=4/9,weight=.3/.2", (enum bright_curve)curve, 1e-3);
                p.exposure = curve == BRIGHT_KNEE ? 1 : 0;
                struct scene s;
                scene_init(&s, 75, 50, channels, (enum pixel_type)type);
                scene_fill(&s);
                scene_run(&s, &p, engine, 0);
                scene_check(&s, &p, names[curve]);
                scene_finish(&s);
            }
}

static void test_sizes(void **state)
{
    (void)state;
    static const unsigned sizes[][2] = { { 1, 1 },   { 1, 7 },    { 2, 1 },   { 3, 5 },   { 1, 131 },
                                         { 131, 1 }, { 7, 7 },    { 8, 8 },   { 9, 4 },   { 17, 33 },
                                         { 64, 64 }, { 127, 31 }, { 128, 3 }, { 257, 66 } };
    for (unsigned i = 0; i < sizeof(sizes) / sizeof(sizes[0]); i++)
        for (int type = PIXEL_TYPE_HALF; type <= PIXEL_TYPE_FLOAT; type++) {
            struct params p = scene_params("gaussians:sigma=1.8/4/11/40,weight=.2/.2/.2/.4", BRIGHT_KNEE, 1e-3);
            struct scene s;
            scene_init(&s, sizes[i][0], sizes[i][1], 3, (enum pixel_type)type);
            scene_fill(&s);
            scene_run(&s, &p, engine, 0);
            scene_check(&s, &p, "four sigmas");
            p = scene_params("gaussians:sigma=5/5.5/6/20,weight=.2/.2/.2/.4", BRIGHT_LUMINANCE, 1e-2);
            scene_run(&s, &p, engine, 0);
            scene_check(&s, &p, "same level");
            scene_finish(&s);
        }
}

static void test_aspect_and_percent(void **state)
{
    (void)state;
    static const double aspects[] = { 2.0, 0.5, 1.0926 };
    for (unsigned i = 0; i < 3; i++) {
        struct params p = scene_params("gaussians:sigma=2%/6%,weight=.5/.5", BRIGHT_KNEE, 1e-3);
        struct scene s;
        scene_init(&s, 120, 90, 3, PIXEL_TYPE_FLOAT);
        s.aspect = aspects[i];
        scene_fill(&s);
        scene_run(&s, &p, engine, 0);
        scene_check(&s, &p, "pixel aspect");
        scene_finish(&s);
    }
}

// METHODS section 4, case 1.
static void test_dark_frame_is_untouched(void **state)
{
    (void)state;
    struct params p = scene_params("gaussians:sigma=4,weight=1", BRIGHT_KNEE, 1e-3);
    p.threshold = 2;
    struct scene s;
    scene_init(&s, 64, 40, 3, PIXEL_TYPE_HALF);
    scene_run(&s, &p, engine, 0);
    assert_true(s.reply.untouched);
    for (size_t i = 0; i < 64 * 40; i++)
        s.plane[1][i] = 1.5;
    scene_run(&s, &p, engine, 0);
    assert_true(s.reply.untouched);
    // The knee's very end: L = T - K glows nothing, one ulp more does.
    for (unsigned c = 0; c < 3; c++)
        s.plane[c][7] = 1.6;
    scene_run(&s, &p, engine, 0);
    assert_false(s.reply.untouched);
    scene_finish(&s);
}

// Cases 3, 5, 6: exact 0 beyond the support, nothing negative, dark pixels keep their bits there.
static void test_impulse(void **state)
{
    (void)state;
    for (int type = PIXEL_TYPE_HALF; type <= PIXEL_TYPE_FLOAT; type++) {
        struct params p = scene_params("gaussians:sigma=4/8,weight=.5/.5", BRIGHT_CHANNEL, 1e-3);
        struct scene s;
        scene_init(&s, 301, 201, 3, (enum pixel_type)type);
        for (unsigned c = 0; c < 3; c++)
            for (size_t i = 0; i < 301 * 201; i++)
                s.plane[c][i] = -1e-6 + 2e-7 * (double)(i % 11);
        s.plane[1][100 * 301 + 150] = type == PIXEL_TYPE_HALF ? 6e4 : 1e6;
        scene_run(&s, &p, engine, 0);
        scene_check(&s, &p, "impulse");
        unsigned kept = 0;
        for (unsigned y = 0; y < 201; y++)
            for (unsigned x = 0; x < 301; x++) {
                const size_t i = (size_t)y * 301 + x;
                assert_true(s.out[0][1][i] >= s.plane[1][i]);
                assert_true(s.out[0][0][i] == s.plane[0][i] && s.out[0][2][i] == s.plane[2][i]);
                kept += s.out[0][1][i] == s.plane[1][i];
            }
        assert_true(kept > 301 * 201 / 2);
        scene_finish(&s);
    }
}

// Cases 9, 10: NaN and Inf stay on their pixel or become 0; negatives stay.
static void test_nonfinite(void **state)
{
    (void)state;
    for (int policy = NONFINITE_KEEP; policy <= NONFINITE_ZERO; policy++)
        for (int type = PIXEL_TYPE_HALF; type <= PIXEL_TYPE_FLOAT; type++) {
            struct params p = scene_params("gaussians:sigma=2/6,weight=.5/.5", BRIGHT_KNEE, 1e-3);
            p.nonfinite = policy;
            struct scene s;
            scene_init(&s, 90, 60, 3, (enum pixel_type)type);
            scene_fill(&s);
            s.plane[0][45 * 90 + 10] = NAN;
            s.plane[1][20 * 90 + 80] = INFINITY;
            s.plane[2][20 * 90 + 81] = -INFINITY;
            s.plane[2][30 * 90 + 31] = -3;
            scene_run(&s, &p, engine, 0);
            scene_check(&s, &p, policy == NONFINITE_KEEP ? "nonfinite keep" : "nonfinite zero");
            if (policy == NONFINITE_KEEP)
                assert_true(isnan(s.out[0][0][45 * 90 + 10]) && s.out[0][1][20 * 90 + 80] == INFINITY);
            // Zeroing pixels of a frame that glows nowhere.
            p.threshold = 1e9;
            scene_run(&s, &p, engine, 0);
            assert_int_equal(s.reply.untouched, policy == NONFINITE_KEEP);
            assert_true(isfinite(s.reply.error_bound) && s.reply.energy_bright == 0);
            assert_true(policy == NONFINITE_KEEP ? isnan(s.out[0][0][45 * 90 + 10]) : s.out[0][0][45 * 90 + 10] == 0);
            scene_finish(&s);
        }
}

// Cases 7, 8, 12: the ends of the number lines.
static void test_extremes(void **state)
{
    (void)state;
    struct params p = scene_params("gaussians:sigma=3/7,weight=.5/.5", BRIGHT_NONE, 1e-3);
    struct scene s;
    scene_init(&s, 60, 44, 3, PIXEL_TYPE_FLOAT);
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < 60 * 44; i++)
            s.plane[c][i] = pow(10, -44 + 8 * scene_uniform());
    scene_run(&s, &p, engine, 0);
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < 60 * 44; i++)
            assert_true(isfinite(s.out[0][c][i]) && s.out[0][c][i] >= s.plane[c][i] && s.out[0][c][i] < 1e-34);
    for (int curve = BRIGHT_NONE; curve <= BRIGHT_SMOOTHSTEP; curve++) {
        p.bright = curve;
        for (unsigned c = 0; c < 3; c++)
            for (size_t i = 0; i < 60 * 44; i++)
                s.plane[c][i] = i % 7 ? 1.7e38 : 3e38;
        scene_run(&s, &p, engine, 0);
        for (unsigned c = 0; c < 3; c++)
            for (size_t i = 0; i < 60 * 44; i++)
                assert_true(isfinite(s.out[0][c][i]));
    }
    scene_finish(&s);

    p = scene_params("gaussians:sigma=3/7,weight=1/1", BRIGHT_NONE, 1e-3);
    scene_init(&s, 60, 44, 3, PIXEL_TYPE_HALF);
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < 60 * 44; i++)
            s.plane[c][i] = 65504;
    scene_run(&s, &p, engine, 0);
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < 60 * 44; i++)
            assert_true(s.out[0][c][i] == 65504);
    scene_finish(&s);
}

// A frame of every half there is: where nothing glows, each keeps its bits (NaN payloads, -0, denormals).
static void test_all_halfs_keep_their_bits(void **state)
{
    (void)state;
    struct params p = scene_params("gaussians:sigma=1.8,weight=1", BRIGHT_CHANNEL, 1e-3);
    p.threshold = 66000;
    struct scene s;
    scene_init(&s, 256, 300, 1, PIXEL_TYPE_HALF);
    scene_load(&s, engine, 0);
    for (unsigned y = 0; y < 256; y++)
        for (unsigned x = 0; x < 256; x++) {
            const uint16_t h = (uint16_t)(y * 256 + x);
            memcpy(planes_row(&s.in_planes[0], 0, y) + 2 * x, &h, 2);
        }
    frame_scan_finish(&s.scan);
    assert_int_equal(frame_scan_init(&s.scan, 256, 300), 0);
    for (unsigned y = 0; y < 300; y++)
        frame_scan_row(&s.scan, &s.in_planes[0], y, s.luma);
    struct bloom_request r = { .params = &p, .scan = &s.scan, .luma = { 1, 0, 0 }, .pixel_aspect = 1 };
    struct fault f = { 0 };
    assert_int_equal(bloom_run(engine, bloom_slot(engine, 0), 0, &r, &s.reply, &f), 0);
    assert_true(s.reply.untouched);
    // One lamp far down makes the passes run.
    p.threshold = 65000;
    assert_int_equal(bloom_run(engine, bloom_slot(engine, 0), 0, &r, &s.reply, &f), 0);
    assert_false(s.reply.untouched);
    unsigned same = 0;
    for (unsigned y = 0; y < 256; y++)
        for (unsigned x = 0; x < 256; x++)
            same += !memcmp(planes_row(&s.in_planes[0], 0, y) + 2 * x, planes_row(&s.out_planes[0], 0, y) + 2 * x, 2);
    print_message("halfs with their bits: %u of 65536\n", same);
    assert_true(same > 65536 - 64 * 64);
    scene_finish(&s);
}

static void copy_out(const struct scene *s, uint8_t *to)
{
    const size_t row = (size_t)s->width * pixel_bytes(s->type);
    for (unsigned c = 0; c < s->channels; c++)
        for (unsigned y = 0; y < s->height; y++, to += row)
            memcpy(to, planes_row(&s->out_planes[0], c, y), row);
}

// Same request, same device: same bytes, whatever ran before, in whichever slot, staged or not.
static void test_same_bytes(void **state)
{
    (void)state;
    struct params p = scene_params("gaussians:sigma=2/4/8,weight=.2/.3/.4", BRIGHT_KNEE, 1e-3);
    struct params other = scene_params("gaussians:sigma=30,weight=.2", BRIGHT_NONE, 1e-2);
    struct scene s, o;
    scene_init(&s, 150, 99, 3, PIXEL_TYPE_FLOAT);
    scene_fill(&s);
    scene_init(&o, 77, 301, 3, PIXEL_TYPE_HALF);
    scene_fill(&o);
    const size_t bytes = (size_t)150 * 99 * 12;
    uint8_t *first = malloc(bytes), *again = malloc(bytes);
    assert_non_null(first);
    assert_non_null(again);
    scene_run(&s, &p, engine, 0);
    copy_out(&s, first);
    scene_run(&o, &other, engine, 1);
    scene_run(&s, &p, engine, 1);
    copy_out(&s, again);
    assert_memory_equal(first, again, bytes);

    struct bloom *staged;
    struct fault f = { 0 };
    const struct bloom_options options = { .slots = 1, .staged = true, .validate = validate, .log = log_line };
    if (bloom_create(&staged, &options, &f) < 0)
        fail_msg("%s", f.text);
    scene_run(&s, &p, staged, 0);
    copy_out(&s, again);
    assert_memory_equal(first, again, bytes);
    assert_int_equal(bloom_validation_messages(staged), 0);
    bloom_destroy(staged);
    free(first);
    free(again);
    scene_finish(&s);
    scene_finish(&o);
}

// What cannot reach half a step of a half is left out, and the bound says so.
static void test_too_faint_to_show(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s, 150, 90, 3, PIXEL_TYPE_HALF);
    scene_fill(&s);
    struct params p = scene_params("gaussians:sigma=4/30,weight=.2/1e-13", BRIGHT_KNEE, 1e-3);
    scene_run(&s, &p, engine, 0);
    assert_false(s.reply.untouched);
    assert_non_null(strstr(s.reply.skipped, "1 of 2 Gaussians"));
    scene_check(&s, &p, "one Gaussian too faint");
    p.intensity = 1e-13;
    scene_run(&s, &p, engine, 0);
    assert_true(s.reply.untouched);
    assert_true(s.reply.error_bound > 0);
    assert_non_null(strstr(s.reply.plan, "smallest step"));
    scene_check(&s, &p, "all too faint");
    // float32 has steps that small.
    scene_finish(&s);
    scene_init(&s, 150, 90, 3, PIXEL_TYPE_FLOAT);
    scene_fill(&s);
    scene_run(&s, &p, engine, 0);
    assert_false(s.reply.untouched);
    scene_finish(&s);
}

// Levels stored as half: within their own, computed, bound; refused where that is above the tolerance.
static void test_half_storage(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s, 181, 133, 3, PIXEL_TYPE_FLOAT);
    scene_fill(&s);
    struct params p = scene_params("gaussians:sigma=4/8/16/32,weight=.2", BRIGHT_KNEE, 1e-2);
    assert_int_equal(params_set_text(&p, "storage", "half", NULL), 0);
    scene_run(&s, &p, engine, 0);
    assert_string_equal(s.reply.storage, "half");
    assert_true(s.reply.error_bound > 1e-3 && s.reply.error_bound <= 1e-2);
    scene_check(&s, &p, "levels of half");
    p.tolerance = 1e-3;
    struct bloom_request r = { .params = &p, .scan = &s.scan, .source = -1, .matte = -1, .depth = -1, .pixel_aspect = 1 };
    memcpy(r.luma, s.luma, sizeof(r.luma));
    struct fault f = { 0 };
    assert_int_equal(bloom_run(engine, bloom_slot(engine, 0), 0, &r, &s.reply, &f), -1);
    assert_int_equal(f.code, FAULT_PARAM_CONFLICT);
    assert_string_equal(f.field, "params.storage");
    scene_finish(&s);
}

// What is not drawn, for no tile there has a highlight, changes no bit.
static void test_dark_tiles(void **state)
{
    (void)state;
    static const char *const psf[] = { "gaussians:sigma=4/8/40,weight=.2/.3/.4", "gaussians:sigma=1.5/6,weight=.3",
                                       "gaussians:sigma=20,weight=1" };
    struct bloom *whole;
    struct fault f = { 0 };
    const struct bloom_options options = { .slots = 1, .whole = true, .validate = validate, .log = log_line };
    if (bloom_create(&whole, &options, &f) < 0)
        fail_msg("%s", f.text);
    struct scene s;
    for (unsigned i = 0; i < 12; i++) {
        const enum pixel_type type = i & 1 ? PIXEL_TYPE_HALF : PIXEL_TYPE_FLOAT;
        struct params p = scene_params(psf[i % 3], BRIGHT_KNEE, i % 4 < 2 ? 1e-3 : 1e-5);
        scene_init(&s, 400 + 37 * i, 300 + 29 * i, i % 4 == 3 ? 1 : 3, type);
        s.grow = i % 5 == 4 ? 24 : 0;
        // Lamps at the corners of tiles, where a pixel's light leaves its tile at once, and some anywhere.
        for (unsigned k = 0; k < 6; k++) {
            const unsigned x = k < 3 ? 64 * (1 + k * 2) - (k & 1) : (unsigned)(scene_uniform() * s.width);
            const unsigned y = k < 3 ? 64 * (1 + k) - (k >> 1) : (unsigned)(scene_uniform() * s.height);
            for (unsigned c = 0; c < s.channels; c++)
                s.plane[c][y * s.width + x] = 50 + 1000 * scene_uniform();
        }
        scene_run(&s, &p, engine, 0);
        assert_true(s.reply.skipped[0] != 0);
        print_message("%s (%u of %u tiles bright)\n", s.reply.skipped, s.reply.tiles_bright, s.reply.tiles);
        const size_t samples = (size_t)(s.width + 2 * s.grow) * (s.height + 2 * s.grow);
        double *first[3] = { 0 };
        for (unsigned c = 0; c < s.channels; c++) {
            first[c] = malloc(samples * sizeof(double));
            assert_non_null(first[c]);
            memcpy(first[c], s.out[0][c], samples * sizeof(double));
        }
        const double bright = s.reply.energy_bright, lost = s.reply.energy_lost;
        scene_run(&s, &p, whole, 0);
        assert_true(s.reply.skipped[0] == 0);
        assert_true(s.reply.energy_bright == bright && s.reply.energy_lost == lost);
        for (unsigned c = 0; c < s.channels; c++) {
            assert_memory_equal(first[c], s.out[0][c], samples * sizeof(double));
            free(first[c]);
        }
        scene_finish(&s);
    }
    assert_int_equal(bloom_validation_messages(whole), 0);
    bloom_destroy(whole);
}

// Case 15: a mirrored frame gives the mirrored result, to float32 rounding.
static void test_mirror(void **state)
{
    (void)state;
    struct params p = scene_params("gaussians:sigma=4/16,weight=.5/.5", BRIGHT_CHANNEL, 1e-3);
    struct scene s, m;
    // A multiple of 2^levels: then mirroring maps cells onto cells.
    scene_init(&s, 128, 96, 1, PIXEL_TYPE_FLOAT);
    scene_init(&m, 128, 96, 1, PIXEL_TYPE_FLOAT);
    scene_fill(&s);
    for (unsigned y = 0; y < 96; y++)
        for (unsigned x = 0; x < 128; x++)
            m.plane[0][(95 - y) * 128 + 127 - x] = s.plane[0][y * 128 + x];
    scene_run(&s, &p, engine, 0);
    scene_run(&m, &p, engine, 0);
    double worst = 0;
    for (unsigned y = 0; y < 96; y++)
        for (unsigned x = 0; x < 128; x++) {
            const double a = s.out[0][0][y * 128 + x], b = m.out[0][0][(95 - y) * 128 + 127 - x];
            worst = fmax(worst, fabs(a - b) / a);
        }
    print_message("mirror: worst relative difference %.2e\n", worst);
    assert_true(worst <= 1e-6);
    scene_finish(&s);
    scene_finish(&m);
}

// Every pipeline there is draws at start, and none has the layers complain.
static void test_all_pipelines_draw(void **state)
{
    (void)state;
    struct bloom *all;
    struct fault f = { 0 };
    const struct bloom_options options = { .slots = 1, .warm_all = true, .validate = validate, .log = log_line };
    if (bloom_create(&all, &options, &f) < 0)
        fail_msg("%s", f.text);
    assert_int_equal(bloom_validation_messages(all), 0);
    unsigned possible;
    const unsigned made = bloom_pipelines(all, &possible);
    assert_int_equal(made, possible);
    bloom_destroy(all);
}

static void test_no_validation_message(void **state)
{
    (void)state;
    assert_int_equal(bloom_validation_messages(engine), 0);
}

static int setup(void **state)
{
    (void)state;
    struct fault f = { 0 };
    const struct bloom_options options = { .slots = 2, .validate = validate, .log = log_line,
                                           .device = getenv("AIRY_TEST_DEVICE") };
    if (bloom_create(&engine, &options, &f) < 0) {
        print_error("%s: %s\n", f.field, f.text);
        return -1;
    }
    print_message("device: %s\n", bloom_device(engine)->name);
    return 0;
}

static int teardown(void **state)
{
    (void)state;
    bloom_destroy(engine);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_sigmas_and_rules),
        cmocka_unit_test(test_curves_and_types),
        cmocka_unit_test(test_sizes),
        cmocka_unit_test(test_aspect_and_percent),
        cmocka_unit_test(test_dark_frame_is_untouched),
        cmocka_unit_test(test_impulse),
        cmocka_unit_test(test_nonfinite),
        cmocka_unit_test(test_extremes),
        cmocka_unit_test(test_all_halfs_keep_their_bits),
        cmocka_unit_test(test_same_bytes),
        cmocka_unit_test(test_half_storage),
        cmocka_unit_test(test_too_faint_to_show),
        cmocka_unit_test(test_dark_tiles),
        cmocka_unit_test(test_mirror),
        cmocka_unit_test(test_all_pipelines_draw),
        cmocka_unit_test(test_no_validation_message),
    };
    // AIRY_TEST_VALIDATE=0 runs without the layers (their leaks would drown ours), and without their test.
    validate = !getenv("AIRY_TEST_VALIDATE") || strcmp(getenv("AIRY_TEST_VALIDATE"), "0") != 0;
    return _cmocka_run_group_tests("engine", tests, sizeof(tests) / sizeof(tests[0]) - !validate, setup, teardown);
}
