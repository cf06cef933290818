// SPDX-License-Identifier: Apache-2.0
// test_wall_engine.c - a wall's picture on the device that is there, against the float64 reference: light within the stated bound,
// drive within half a code value of 8 bits, shares of a wall equal to the whole bit for bit. Validation layers are on.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bloom_internal.h"
#include "reference_wall.h"
#include "scene_kit.h"

static struct bloom *engine;
static bool validate = true;

static void log_line(const char *line) { print_message("%s\n", line); }

/* ---- making and running ------------------------------------------------------------------------------------ */

static struct bloom_wall wall_make(unsigned width, unsigned height, double x, double y, double pitch_x, double pitch_y)
{
    struct bloom_wall w = { .width = width, .height = height, .end_x = width, .end_y = height, .x = x, .y = y, .pitch_x = pitch_x,
                            .pitch_y = pitch_y, .saturation = 1, .matrix = { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } } };
    w.drive = calloc((size_t)width * height * 3, sizeof(float));
    assert_non_null(w.drive);
    return w;
}

static struct bloom_request request_of(const struct scene *s, const struct params *p, const struct bloom_wall *w)
{
    struct bloom_request r = { .params = p, .scan = &s->scan, .source = -1, .matte = -1, .depth = -1, .wall = w,
                               .pixel_aspect = (float)s->aspect };
    memcpy(r.luma, s->luma, sizeof(r.luma));
    return r;
}

static void run(struct scene *s, const struct params *p, struct bloom_wall *w)
{
    struct fault f = { 0 };
    w->frame_width = s->width;
    w->frame_height = s->height;
    scene_load(s, engine, 0);
    const struct bloom_request r = request_of(s, p, w);
    if (bloom_run(engine, bloom_slot(engine, 0), 0, &r, &s->reply, &f) < 0)
        fail_msg("%s: %s", f.field, f.text);
}

static struct reference_wall wall_of(const struct bloom_wall *w, double exposure)
{
    struct reference_wall r = { w->width, w->height, w->x, w->y, w->pitch_x, w->pitch_y, exposure, w->saturation,
                                .tone_map = w->tone_map, .gain = w->gain };
    memcpy(r.matrix, w->matrix, sizeof(r.matrix));
    return r;
}

static double code_of(double drive, bool srgb)
{
    const double v = fmin(fmax(drive, 0), 1);
    return 255 * (!srgb ? pow(v, 1 / 2.5) : v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1 / 2.4) - 0.055);
}

/* Light (tone map none and so on): the worst of (error / allowed); and, of the wall as asked, the worst error in code values. */
struct verdict { double light, srgb, gamma; };

static struct verdict judge(struct scene *s, const struct params *p, struct bloom_wall *w, const char *what)
{
    struct verdict v = { 0 };
    struct reference_light l;
    struct bloom_wall plain = *w;
    plain.tone_map = DISPLAY_NONE;
    plain.saturation = 1;
    memcpy(plain.matrix, (double[3][3]){ { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } }, sizeof(plain.matrix));
    plain.gain = NULL;
    run(s, p, &plain);
    const struct reference_frame f = scene_reference(s, NULL);
    const struct reference_wall rw = wall_of(w, s->reply.exposure);
    struct params used = *p;
    used.exposure = s->reply.exposure;
    used.exposure_auto = false;
    assert_int_equal(reference_wall(&l, &f, &used, &rw), 0);
    const double exposed = exp2(s->reply.exposure), bound = s->reply.error_bound * p->intensity * l.max_bright;
    // A sum of the wall pixel's rows and columns; decoding is exact.
    const double terms = fmin(w->pitch_x, s->width) + fmin(w->pitch_y, s->height) + 20;
    const bool half = s->type == PIXEL_TYPE_HALF && !bloom_wall_is_direct(p);
    for (size_t i = 0; i < (size_t)w->width * w->height * 3; i++) {
        const double want = fmax(0, l.mean[i]) * exposed, error = fabs(plain.drive[i] - want);
        const double room = (bound + (terms * 0x1p-24 + (half ? 0x1p-11 : 0)) * l.size[i]) * exposed + 0x1p-125;
        const double ratio = isnan(plain.drive[i]) ? INFINITY : error / room;
        if (ratio > 1)
            fail_msg("%s: light at %zu,%zu,%zu is %.9g, %.9g expected, room %.3g (%s)", what, i / 3 % w->width, i / 3 / w->width, i % 3,
                     (double)plain.drive[i], want, room, s->reply.plan);
        v.light = fmax(v.light, ratio);
    }
    run(s, p, w);
    for (size_t i = 0; i < (size_t)w->width * w->height * 3; i++) {
        v.srgb = fmax(v.srgb, fabs(code_of(w->drive[i], true) - code_of(l.drive[i], true)));
        v.gamma = fmax(v.gamma, fabs(code_of(w->drive[i], false) - code_of(l.drive[i], false)));
    }
    print_message("%-30s %4ux%-4u wall %3ux%-3u bound %.2e error/bound %.3f codes srgb %.4f gamma 2.5 %.4f (%s)\n", what, s->width, s->height,
                  w->width, w->height, s->reply.error_bound, v.light, v.srgb, v.gamma, s->reply.rule);
    reference_light_free(&l);
    return v;
}

/* ---- geometries, psfs, rules -------------------------------------------------------------------------------------- */

static const struct shape { unsigned width, height; double x, y, pitch_x, pitch_y; } shapes[] = {
    { 48, 36, 0, 0, 3.75, 3.75 },        { 24, 18, 2.3, -4.1, 7.3, 7.3 },  { 181, 133, 0, 0, 1, 1 },    { 60, 40, -7.7, 3.2, 1.9, 2.4 },
    { 1, 1, 0, 0, 181, 133 },            { 97, 71, 10.1, 20.2, 0.37, 0.61 }, { 31, 17, -40, -30, 9, 11 }, { 3, 2, 5, 5, 50.5, 60.25 },
    { 5, 7, 180.5, 0, 0.1, 19 },         { 8, 4, 500, 0, 3, 3 },            { 13, 11, 0, 0, 13.92, 12.09 }, { 2, 1, -1000, -1000, 2000, 3000 },
};

static void test_geometries(void **state)
{
    (void)state;
    static const char *psfs[] = { "gaussians:sigma=4/8/16/32,weight=.2/.2/.2/.2", "gaussians:sigma=1/1.8/3,weight=.3/.2/.1",
                                  "gaussians:sigma=40,weight=.7" };
    for (unsigned i = 0; i < sizeof(shapes) / sizeof(shapes[0]); i++)
        for (unsigned k = i % 3; k < 3; k += 2) {
            const struct shape *h = &shapes[i];
            struct params p = scene_params(psfs[k], BRIGHT_CHANNEL, i % 2 ? 1e-3 : 1e-2);
            struct bloom_wall w = wall_make(h->width, h->height, h->x, h->y, h->pitch_x, h->pitch_y);
            struct scene s;
            scene_init(&s, 181, 133, (i + k) % 4 == 3 ? 1 : 3, (i + k) % 3 ? PIXEL_TYPE_FLOAT : PIXEL_TYPE_HALF);
            scene_fill(&s);
            judge(&s, &p, &w, psfs[k]);
            assert_true(s.reply.energy_bright == 0);
            free(w.drive);
            scene_finish(&s);
        }
}

static void test_rules_and_curves(void **state)
{
    (void)state;
    static const double tolerances[] = { 1e-2, 1e-3, 1e-4, 1e-5 };
    for (unsigned t = 0; t < 4; t++)
        for (int curve = BRIGHT_NONE; curve <= BRIGHT_SMOOTHSTEP; curve++) {
            struct params p = scene_params("gaussians:sigma=2/5/13,weight=.3/.2/.1", (enum bright_curve)curve, tolerances[t]);
            p.exposure = -0.5 + t;
            p.firefly = t == 1 ? 2 : 0;
            p.clamp = t == 2 ? 9 : 0;
            struct bloom_wall w = wall_make(30, 22, 1.5, 0.25, 4.2, 3.9);
            struct scene s;
            scene_init(&s, 130, 90, 3, PIXEL_TYPE_FLOAT);
            s.aspect = t == 3 ? 1.5 : 1;
            scene_fill(&s);
            judge(&s, &p, &w, "rules and curves");
            free(w.drive);
            scene_finish(&s);
        }
}

// NaN, Inf and negatives of I; a frame that glows nowhere; bloom=off; numbers at the end of float32.
static void test_hard_pixels(void **state)
{
    (void)state;
    struct bloom_wall w = wall_make(20, 15, 0, 0, 4.5, 4);
    struct params p = scene_params("gaussians:sigma=2/6/20,weight=.5/.3/.3", BRIGHT_KNEE, 1e-3);
    struct scene s;
    scene_init(&s, 90, 60, 3, PIXEL_TYPE_FLOAT);
    scene_fill(&s);
    s.plane[0][45 * 90 + 10] = NAN;
    s.plane[1][20 * 90 + 80] = INFINITY;
    s.plane[2][20 * 90 + 81] = -INFINITY;
    s.plane[2][30 * 90 + 31] = -3;
    judge(&s, &p, &w, "nonfinite");
    p.threshold = 1e9;
    judge(&s, &p, &w, "dark");
    p.threshold = 1;
    p.bloom = SWITCH_OFF;
    judge(&s, &p, &w, "off");
    p.bloom = SWITCH_ON;
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < 90 * 60; i++)
            s.plane[c][i] = c ? 3.4e38 : -3.4e38;
    run(&s, &p, &w);
    for (size_t i = 0; i < 20 * 15 * 3; i++)
        assert_true(isfinite(w.drive[i]) && (i % 3 ? w.drive[i] > 1e29f : w.drive[i] == 0));
    free(w.drive);
    scene_finish(&s);
}

/* ---- the whole chain ---------------------------------------------------------------------------------------------- */

static void test_codes(void **state)
{
    (void)state;
    static const double tolerances[] = { 1e-3, 1e-4, 1e-5 };
    float *gain = calloc((size_t)40 * 30 * 3, sizeof(float));
    for (unsigned i = 0; i < 40 * 30 * 3; i++)
        gain[i] = (float)(0.5 + 0.5 * scene_uniform());
    for (unsigned t = 0; t < 3; t++)
        for (int tone = DISPLAY_NONE; tone <= DISPLAY_ACES; tone++)
            for (unsigned extra = 0; extra < 2; extra++) {
                struct params p = scene_params("gaussians:sigma=4/8/16,weight=.05/.05/.05", BRIGHT_KNEE, tolerances[t]);
                p.exposure = -1 + (double)t;
                struct bloom_wall w = wall_make(40, 30, 0, 0, 3.75, 3.7);
                w.tone_map = tone;
                w.saturation = extra ? 1.3 : 1;
                if (extra) {
                    memcpy(w.matrix, (double[3][3]){ { .9, .2, -.1 }, { -.05, 1.1, 0 }, { .01, -.2, 1.2 } }, sizeof(w.matrix));
                    w.gain = gain;
                    w.gain_id = 7;
                }
                struct scene s;
                scene_init(&s, 150, 111, 3, PIXEL_TYPE_FLOAT);
                scene_fill(&s);
                // A typical picture: lamps to 60.
                for (unsigned c = 0; c < 3; c++)
                    for (size_t i = 0; i < 150 * 111; i++)
                        s.plane[c][i] = fmin(s.plane[c][i], 60);
                const struct verdict v = judge(&s, &p, &w, "whole chain");
                assert_true(v.srgb <= 0.5 && v.gamma <= 0.5);
                free(w.drive);
                scene_finish(&s);
            }
    free(gain);
}

/* ---- shares ------------------------------------------------------------------------------------------------------- */

static void cut_out(struct scene *part, const struct scene *s, const int32_t at[4])
{
    scene_init(part, (unsigned)(at[2] - at[0]), (unsigned)(at[3] - at[1]), s->channels, s->type);
    part->aspect = s->aspect;
    for (unsigned c = 0; c < s->channels; c++)
        for (unsigned y = 0; y < part->height; y++)
            memcpy(part->plane[c] + (size_t)y * part->width, s->plane[c] + (size_t)(y + (unsigned)at[1]) * s->width + at[0],
                   part->width * sizeof(double));
}

static void run_share(const struct scene *s, const struct params *p, struct bloom_wall w, bool larger)
{
    struct fault f = { 0 };
    struct scene part;
    int32_t need[4];
    w.frame_width = s->width;
    w.frame_height = s->height;
    if (bloom_wall_need(engine, p, (float)s->aspect, s->channels, 0, &w, need, &f) < 0)
        fail_msg("%s", f.text);
    if (larger)
        need[2] = (int32_t)s->width;
    cut_out(&part, s, need);
    scene_load(&part, engine, 0);
    w.frame_x = need[0];
    w.frame_y = need[1];
    const struct bloom_request r = request_of(&part, p, &w);
    if (bloom_run(engine, bloom_slot(engine, 0), 0, &r, &part.reply, &f) < 0)
        fail_msg("%s: %s", f.field, f.text);
    print_message("  share %u,%u..%u,%u of the wall: %d,%d..%d,%d of %ux%u\n", w.first_x, w.first_y, w.end_x, w.end_y, need[0], need[1],
                  need[2], need[3], s->width, s->height);
    scene_finish(&part);
}

static void split(const struct scene *s, const struct params *p, const struct bloom_wall *whole, const char *what)
{
    struct bloom_wall w = *whole;
    const size_t n = (size_t)w.width * w.height * 3;
    w.drive = calloc(n, sizeof(float));
    const unsigned shares = 2 + (unsigned)(scene_uniform() * 3);
    const bool down = scene_uniform() < 0.5;
    const uint32_t length = down ? w.height : w.width;
    uint32_t at = 0;
    for (unsigned i = 0; i < shares; i++) {
        const uint32_t end = i + 1 == shares ? length : at + 1 + (uint32_t)(scene_uniform() * (length - at - (shares - 1 - i)));
        struct bloom_wall share = w;
        *(down ? &share.first_y : &share.first_x) = at;
        *(down ? &share.end_y : &share.end_x) = end;
        run_share(s, p, share, i % 2);
        at = end;
        if (at == length)
            break;
    }
    for (size_t i = 0; i < n; i++)
        if (memcmp(&w.drive[i], &whole->drive[i], sizeof(float)))
            fail_msg("%s: pixel %zu,%zu,%zu is %.9g of a share, %.9g of the whole", what, i / 3 % w.width, i / 3 / w.width, i % 3,
                     (double)w.drive[i], (double)whole->drive[i]);
    free(w.drive);
}

static void test_split_is_whole(void **state)
{
    (void)state;
    static const char *psfs[] = { "gaussians:sigma=1.5/4/9,weight=.2/.3/.3", "gaussians:sigma=5/6/17,weight=.2/.2/.2",
                                  "gaussians:sigma=2%,weight=.5" };
    for (unsigned i = 0; i < 8; i++) {
        const uint64_t seed = 100 + i;
        scene_seed(seed);
        struct params p = scene_params(psfs[i % 3], BRIGHT_KNEE, i % 2 ? 1e-3 : 1e-2);
        p.firefly = i == 5 ? 3 : 0;
        struct scene s;
        scene_init(&s, 500 + (unsigned)(scene_uniform() * 200), 200 + (unsigned)(scene_uniform() * 90), i == 3 ? 1 : 3,
                   i % 4 == 1 ? PIXEL_TYPE_HALF : PIXEL_TYPE_FLOAT);
        s.aspect = i == 6 ? 1.25 : 1;
        scene_fill(&s);
        if (i == 2) // one share has a NaN and a negative sample, the others none
            s.plane[0][5] = NAN, s.plane[1][s.width - 2] = -1;
        if (i == 4) // light in one corner only: the other shares are dark
            for (unsigned c = 0; c < 3; c++)
                for (size_t k = 0; k < (size_t)s.width * s.height; k++)
                    s.plane[c][k] = k % s.width < 40 ? s.plane[c][k] : 0.3;
        const unsigned width = 20 + (unsigned)(scene_uniform() * 100), height = 10 + (unsigned)(scene_uniform() * 60);
        struct bloom_wall w = wall_make(width, height, -3 + 7 * scene_uniform(), -3 + 7 * scene_uniform(), s.width / (width * 1.02),
                                        s.height / (height * 1.02));
        w.tone_map = DISPLAY_ACES;
        w.saturation = 1.2;
        run(&s, &p, &w);
        print_message("seed %d: %ux%u, wall %ux%u at %.17g,%.17g pitch %.17g %.17g (%s)\n", (int)seed, s.width, s.height, width, height, w.x,
                      w.y, w.pitch_x, w.pitch_y, s.reply.plan);
        split(&s, &p, &w, psfs[i % 3]);
        free(w.drive);
        scene_finish(&s);
    }
}

/* ---- pictures that are not plain, faults, adaptation ---------------------------------------------------------------- */

static void test_not_plain(void **state)
{
    (void)state;
    struct bloom_wall w = wall_make(33, 21, 1.25, -2, 3.3, 4.1);
    struct scene s;
    scene_init(&s, 121, 77, 3, PIXEL_TYPE_FLOAT);
    scene_fill(&s);
    struct params p = scene_params("gaussians:sigma=2/6,weight=.5/.3", BRIGHT_KNEE, 1e-3);
    p.composite = COMPOSITE_MIX;
    p.intensity = 0.5;
    assert_false(bloom_wall_is_direct(&p));
    judge(&s, &p, &w, "mix");
    p.composite = COMPOSITE_ADD;
    p.edge = EDGE_FILL;
    judge(&s, &p, &w, "edge fill");
    s.plane[1][500] = NAN;
    judge(&s, &p, &w, "edge fill, NaN");
    scene_finish(&s);
    scene_init(&s, 121, 77, 1, PIXEL_TYPE_HALF);
    scene_fill(&s);
    judge(&s, &p, &w, "edge fill, half Y");
    p.threshold = 1e9;
    judge(&s, &p, &w, "untouched");
    free(w.drive);
    scene_finish(&s);
}

static void refused(struct scene *s, const struct params *p, const struct bloom_wall *w, enum fault_code code, const char *field)
{
    struct fault f = { 0 };
    struct bloom_reply reply;
    const struct bloom_request r = request_of(s, p, w);
    assert_int_equal(bloom_run(engine, bloom_slot(engine, 0), 0, &r, &reply, &f), -1);
    print_message("  %s: %s\n", f.field, f.text);
    assert_int_equal(f.code, code);
    assert_string_equal(f.field, field);
}

static void test_faults(void **state)
{
    (void)state;
    struct params p = scene_params("gaussians:sigma=4,weight=1", BRIGHT_KNEE, 1e-3);
    struct bloom_wall w = wall_make(8, 8, 0, 0, 4, 4);
    struct scene s;
    scene_init(&s, 32, 32, 3, PIXEL_TYPE_FLOAT);
    run(&s, &p, &w);
    struct params q = p;
    q.display = DISPLAY_ACES;
    refused(&s, &q, &w, FAULT_PARAM_CONFLICT, "params.display");
    q = p;
    q.encoding = ENCODING_SRGB;
    refused(&s, &q, &w, FAULT_PARAM_CONFLICT, "params.encoding");
    q = p;
    q.storage = STORAGE_HALF;
    refused(&s, &q, &w, FAULT_PARAM_CONFLICT, "params.storage");
    struct bloom_wall v = w;
    v.pitch_x = NAN;
    refused(&s, &p, &v, FAULT_WALL, "wall");
    v = w;
    v.end_y = 9;
    refused(&s, &p, &v, FAULT_WALL, "wall");
    v = w;
    v.x = INFINITY;
    refused(&s, &p, &v, FAULT_WALL, "wall");
    v = w;
    v.frame_x = 1;
    refused(&s, &p, &v, FAULT_WALL, "wall");
    // Far away, and larger than all: no light, and the mean of nearly nothing.
    v = w;
    v.x = 1e300;
    run(&s, &p, &v);
    v = w;
    v.pitch_x = v.pitch_y = 1e300;
    run(&s, &p, &v);
    for (unsigned i = 0; i < 8 * 8 * 3; i++)
        assert_true(w.drive[i] == 0);
    free(w.drive);
    scene_finish(&s);
}

static void test_adaptation(void **state)
{
    (void)state;
    struct params p = scene_params("gaussians:sigma=4,weight=.1", BRIGHT_KNEE, 1e-2);
    struct bloom_adapt a = { .up_s = 0.4, .down_s = 2.5 };
    struct bloom_wall w = wall_make(8, 6, 0, 0, 8, 8);
    struct scene s;
    struct fault f;
    assert_int_equal(params_set_text(&p, "exposure", "auto", &f), 0);
    w.adapt = &a;
    scene_init(&s, 64, 48, 3, PIXEL_TYPE_FLOAT);
    double stops = 0;
    for (unsigned i = 0; i < 12; i++) {
        const double level = i < 3 ? 0.1 : i < 8 ? 2.5 : 0.03;
        for (unsigned c = 0; c < 3; c++)
            for (size_t k = 0; k < 64 * 48; k++)
                s.plane[c][k] = level * (0.8 + 0.4 * scene_uniform());
        a.step_s = 0.01 + 0.1 * scene_uniform();
        w.adapt = NULL;
        run(&s, &p, &w);
        const double metered = s.reply.exposure;
        w.adapt = &a;
        run(&s, &p, &w);
        stops = i == 0 ? metered : stops + (metered - stops) * (1 - exp(-a.step_s / (metered < stops ? 0.4 : 2.5)));
        print_message("  level %g: metered %.4f, stops %.6f\n", level, metered, s.reply.exposure);
        assert_true(fabs(s.reply.exposure - stops) < 1e-9 && a.stops == s.reply.exposure && a.started);
    }
    // One step is as good as two of half its length.
    struct bloom_adapt one = { true, 3, 1, 1, 0.2 }, two = { true, 3, 1, 1, 0.1 };
    two.stops = bloom_adapt_stops(&two, -1);
    assert_true(fabs(bloom_adapt_stops(&one, -1) - bloom_adapt_stops(&two, -1)) < 1e-12);
    one.up_s = 0;
    assert_true(bloom_adapt_stops(&one, -1) == -1);
    free(w.drive);
    scene_finish(&s);
}

/* ---- host and shaders ----------------------------------------------------------------------------------------------- */

// The same frames by the other path: each holds the bound, so they are no further apart than twice that.
static void test_host_and_shaders_agree(void **state)
{
    (void)state;
    struct bloom *const first = engine;
    struct bloom *other = NULL;
    struct fault f = { 0 };
    const struct bloom_options options = { .slots = 2, .validate = validate, .log = log_line, .device = getenv("AIRY_TEST_DEVICE"),
                                           .staged = !getenv("AIRY_TEST_STAGED"), .threads = 3 };
    assert_int_equal(bloom_create(&other, &options, &f), 0);
    for (unsigned i = 0; i < 12; i++) {
        const uint64_t seed = 900 + i;
        scene_seed(seed);
        struct params p = scene_params(i % 2 ? "gaussians:sigma=1/3/9,weight=.3/.2/.3" : "gaussians:sigma=4/8/16/32/64,weight=.2/.2/.2/.2/.2",
                                       (enum bright_curve)(i % 5), i % 3 ? 1e-3 : 1e-4);
        struct scene s;
        scene_init(&s, 257 + 40 * i, 190 + 11 * i, i == 5 ? 1 : 3, i % 4 == 2 ? PIXEL_TYPE_HALF : PIXEL_TYPE_FLOAT);
        scene_fill(&s);
        for (unsigned c = 0; c < s.channels; c++) // dim but for some tiles, in a third of the scenes
            for (size_t k = 0; i % 3 == 1 && k < (size_t)s.width * s.height; k++)
                if ((k % s.width / 64 * 5 + k / s.width / 64 * 3) % 7)
                    s.plane[c][k] *= 1e-4;
        struct bloom_wall w = wall_make(40 + i, 20 + i, -2.5, 3.25, s.width / 41.0, s.height / 23.0);
        judge(&s, &p, &w, "one");
        float *one = w.drive;
        const double bound = s.reply.error_bound, most = s.reply.max_bright;
        w.drive = calloc((size_t)w.width * w.height * 3, sizeof(float));
        engine = other;
        judge(&s, &p, &w, "other");
        engine = first;
        assert_true(s.reply.error_bound == bound || fabs(s.reply.error_bound - bound) < 1e-4 * bound + 1e-6);
        for (size_t k = 0; k < (size_t)w.width * w.height * 3; k++) {
            const double room = 2 * bound * p.intensity * most + 1e-5 * fabs(one[k]) + 1e-30;
            if (!(fabs((double)w.drive[k] - (double)one[k]) <= room))
                fail_msg("seed %d: pixel %zu,%zu,%zu is %.9g by one path, %.9g by the other, room %.3g", (int)seed, k / 3 % w.width,
                         k / 3 / w.width, k % 3, (double)one[k], (double)w.drive[k], room);
        }
        free(one);
        free(w.drive);
        scene_finish(&s);
    }
    assert_int_equal(bloom_validation_messages(other), 0);
    bloom_destroy(other);
}

// After warming, a wall's frames find their weights and pipelines; and they are what they are without.
static void test_warm(void **state)
{
    (void)state;
    struct fault f = { 0 };
    struct params p = scene_params("gaussians:sigma=3/7/21,weight=.2/.2/.2", BRIGHT_KNEE, 1e-3);
    struct bloom_wall w = wall_make(37, 19, 0.5, 0, 5.25, 6.5);
    struct scene s;
    scene_init(&s, 203, 131, 3, PIXEL_TYPE_FLOAT);
    scene_fill(&s);
    for (unsigned i = 0; i < (unsigned)w.width * w.height * 3; i++)
        w.drive[i] = 7;
    w.frame_width = s.width;
    w.frame_height = s.height;
    const struct bloom_geometry g = { s.width, s.height, 3, PIXEL_TYPE_FLOAT, 0, bloom_wall_is_direct(&p) ? 0 : 1 };
    if (bloom_wall_warm(engine, &w, &p, &g, (float)s.aspect, 0, &f) < 0)
        fail_msg("%s: %s", f.field, f.text);
    for (unsigned i = 0; i < (unsigned)w.width * w.height * 3; i++)
        assert_true(w.drive[i] == 7);
    const unsigned pipelines = engine->pipelines;
    const float *weights[WALL_KEPT];
    const VkImage images[WALL_KEPT] = { engine->wall[0]->rows.image, engine->wall[1]->rows.image, engine->wall[2]->rows.image,
                                        engine->wall[3]->rows.image };
    for (unsigned i = 0; i < WALL_KEPT; i++)
        weights[i] = engine->wall[i]->taps[0][0].weight;
    judge(&s, &p, &w, "warm");
    assert_int_equal(engine->pipelines, pipelines);
    for (unsigned i = 0; i < WALL_KEPT; i++)
        assert_true(engine->wall[i]->taps[0][0].weight == weights[i] && engine->wall[i]->rows.image == images[i]);
    w.end_y = 99;
    assert_int_equal(bloom_wall_warm(engine, &w, &p, &g, (float)s.aspect, 0, &f), -1);
    assert_int_equal(f.code, FAULT_WALL);
    free(w.drive);
    scene_finish(&s);
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
    const struct bloom_options options = { .slots = 2, .validate = validate, .log = log_line, .device = getenv("AIRY_TEST_DEVICE"),
                                           .staged = getenv("AIRY_TEST_STAGED") != NULL };
    if (bloom_create(&engine, &options, &f) < 0) {
        print_error("%s: %s\n", f.field, f.text);
        return -1;
    }
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
        cmocka_unit_test(test_geometries),     cmocka_unit_test(test_rules_and_curves), cmocka_unit_test(test_hard_pixels),
        cmocka_unit_test(test_codes),          cmocka_unit_test(test_split_is_whole),   cmocka_unit_test(test_not_plain),
        cmocka_unit_test(test_faults),         cmocka_unit_test(test_adaptation),       cmocka_unit_test(test_host_and_shaders_agree),
        cmocka_unit_test(test_warm),           cmocka_unit_test(test_no_validation_message),
    };
    validate = !getenv("AIRY_TEST_VALIDATE") || strcmp(getenv("AIRY_TEST_VALIDATE"), "0") != 0;
    return _cmocka_run_group_tests("wall_engine", tests, sizeof(tests) / sizeof(tests[0]) - !validate, setup, teardown);
}
