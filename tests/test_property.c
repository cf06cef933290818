// SPDX-License-Identifier: Apache-2.0
// test_property.c - random scenes, sizes and parameters: no reply may exceed the bound that it states. Every scene comes
// from a seed of its own, which a failure prints: AIRY_SEED=<seed> AIRY_SCENES=1 does that scene again.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "scene_kit.h"

enum { SCENES = 300, SIDE_MAX = 200 };

static struct bloom *engine;
static bool validate;

static void log_line(const char *line) { print_message("%s\n", line); }

static unsigned below(unsigned n) { return (unsigned)(scene_uniform() * n); }
static bool chance(double share) { return scene_uniform() < share; }
static double between(double low, double high) { return low + (high - low) * scene_uniform(); }
static double log_between(double low, double high) { return low * pow(high / low, scene_uniform()); }

/* ---- scenes ---------------------------------------------------------------------------------------- */

// Odd ones, primes, thin ones: all sides are as likely as their logarithm.
static unsigned random_side(void)
{
    static const unsigned primes[] = { 2, 3, 5, 7, 13, 31, 61, 127, 131, 191, 197, 199 };
    static const unsigned round[] = { 1, 4, 8, 16, 32, 64, 128, 192 };
    switch (below(4)) {
    case 0: return primes[below(12)];
    case 1: return round[below(8)];
    default: return (unsigned)log_between(1, SIDE_MAX + .99);
    }
}

// Each adds its light to plane v of w x h, of the scale of `level`.
static void add_points(double *v, unsigned w, unsigned h, double level)
{
    for (unsigned n = 1 + below(1 + w * h / 50); n > 0; n--)
        v[below(w * h)] = level * log_between(1e-6, 1e6);
}

static void add_blobs(double *v, unsigned w, unsigned h, double level)
{
    for (unsigned n = 1 + below(4); n > 0; n--) {
        const double x = between(0, w), y = between(0, h), r = log_between(.5, 1 + w / 2.), bright = level * log_between(.1, 100);
        for (unsigned i = 0; i < w * h; i++)
            v[i] += hypot(i % w - x, i / w - y) < r ? bright : 0;
    }
}

static void add_noise(double *v, unsigned w, unsigned h, double level)
{
    const double low = log_between(1e-3, 1);
    for (unsigned i = 0; i < w * h; i++)
        v[i] += level * log_between(low, 1 / low);
}

static void add_gradient(double *v, unsigned w, unsigned h, double level)
{
    const double a = between(-2, 2) / w, b = between(-2, 2) / h, at = between(0, 2);
    for (unsigned i = 0; i < w * h; i++)
        v[i] += level * (at + a * (i % w) + b * (i / w)); // below 0, too
}

static void sprinkle(double *v, unsigned w, unsigned h, double share, double (*value)(void))
{
    for (unsigned i = 0; i < w * h; i++)
        if (chance(share))
            v[i] = value();
}

static double odd_value(void)
{
    static const double odd[] = { NAN, INFINITY, -INFINITY, -1e6, -1e-6, -0.0, 1e-40, 0 };
    return odd[below(8)];
}

static void random_plane(double *v, unsigned w, unsigned h, double level, unsigned kind)
{
    static void (*const kinds[])(double *, unsigned, unsigned, double) = { add_points, add_blobs, add_noise, add_gradient };
    kinds[kind & 3](v, w, h, level);
    if (kind & 4)
        kinds[below(4)](v, w, h, level);
    if (kind & 8)
        sprinkle(v, w, h, .02, odd_value);
}

static double matte_value(void) { return chance(.1) ? odd_value() : scene_uniform(); }

static void random_scene(struct scene *s)
{
    scene_init(s, random_side(), random_side(), chance(.5) ? 3 : 1,
               chance(.5) ? PIXEL_TYPE_HALF : PIXEL_TYPE_FLOAT);
    // Halfs end at 65504; floats may be far away from 1 on either side.
    const double level = s->type == PIXEL_TYPE_HALF ? log_between(1e-2, 1e2) : log_between(1e-3, 1e3);
    const unsigned kind = below(16);
    for (unsigned c = 0; c < s->channels; c++)
        random_plane(s->plane[c], s->width, s->height, level, kind);
    static const double aspects[] = { .5, .9, 1.0926, 2, 4 };
    if (chance(.3))
        s->aspect = aspects[below(5)];
    if (chance(.2) && s->channels == 3)
        memcpy(s->luma, (float[3]){ .2722287f, .6740818f, .0536895f }, sizeof(s->luma));
    if (ENGINE_HAS_SOURCE && chance(.2)) {
        scene_add_source(s);
        for (unsigned c = 0; c < s->channels; c++)
            random_plane(s->source[c], s->width, s->height, level, below(16));
    }
    if (ENGINE_HAS_SOURCE && chance(.2)) {
        scene_add_matte(s);
        sprinkle(s->matte, s->width, s->height, 1, matte_value);
    }
    if (ENGINE_HAS_DIRT && chance(.2)) {
        scene_add_dirt(s, 1 + below(40), 1 + below(40));
        for (unsigned i = 0; i < s->dirt_width * s->dirt_height * 3; i++)
            s->dirt[i] = (float)between(0, 2);
    }
    if (ENGINE_HAS_GROW && chance(.25))
        s->grow = below(40);
    if (ENGINE_HAS_MM && chance(.2))
        s->display_width = 1 + below(400);
}

/* ---- requests -------------------------------------------------------------------------------------- */

static void random_psf(struct params *p, const struct scene *s)
{
    char sigmas[200] = "", weights[200] = "", text[PARAMS_TEXT_MAX];
    const unsigned count = 1 + below(5);
    struct fault f;
    for (unsigned i = 0; i < count; i++) {
        const bool percent = chance(.2), mm = !percent && ENGINE_HAS_MM && chance(.2);
        // In mm of a 36 mm sensor; a display window that is narrower than the frame only makes it wider.
        const double sigma = percent ? log_between(.2, 30) : mm ? log_between(.1, 5) : log_between(.3, 150);
        snprintf(sigmas + strlen(sigmas), sizeof(sigmas) - strlen(sigmas), "%s%.4g%s", i ? "/" : "", sigma,
                 percent ? "%" : mm ? "mm" : "");
        snprintf(weights + strlen(weights), sizeof(weights) - strlen(weights), "%s%.4g", i ? "/" : "",
                 chance(.1) && i ? 0 : log_between(.01, 2));
    }
    snprintf(text, sizeof(text), "gaussians:sigma=%s,weight=%s", sigmas, weights);
    if (params_set_text(p, "psf", text, &f) < 0)
        fail_msg("%s: %s", text, f.text);
    for (unsigned i = 0; ENGINE_HAS_TINTS && i < count; i++)
        for (unsigned c = 0; c < 3; c++)
            p->psf_spec.gaussian[i].tint[c] = s->channels == 3 && chance(.5) ? between(0, 2) : 1;
}

static void random_bright(struct params *p)
{
    p->bright = (int)below(5);
    p->threshold = chance(.15) ? 0 : log_between(1e-3, 1e3);
    p->knee = p->bright == BRIGHT_SMOOTHSTEP ? between(.05, 1) : chance(.2) ? 0 : log_between(1e-3, 1e3);
    p->exposure = chance(.3) ? between(-4, 4) : 0;
    if (ENGINE_HAS_STOPS && chance(.2)) {
        p->threshold_unit = UNIT_STOPS;
        p->threshold = between(-8, 8);
    }
    if (ENGINE_HAS_AUTO && chance(.2)) {
        p->exposure_auto = true;
        p->key = log_between(.01, 10);
        p->meter_dark = chance(.3) ? 0 : between(0, 60);
        p->meter_bright = chance(.3) ? 0 : between(0, 39);
    }
    if (ENGINE_HAS_CLAMP && chance(.25))
        p->clamp = log_between(1e-3, 1e3);
    if (ENGINE_HAS_FIREFLY && chance(.25))
        p->firefly = log_between(.1, 100);
}

static void random_view(struct view_spec *v, const struct params *p)
{
    *v = (struct view_spec){ (enum view)below(VIEW_RESIDUAL + 1), 0 };
    if (v->view == VIEW_LEVEL)
        v->level = below(p->psf_spec.count);
}

static void random_output(struct params *p)
{
    static const double tolerances[] = { 1e-1, 1e-2, 1e-3, 1e-3, 1e-4, 1e-5 };
    p->tolerance = tolerances[below(6)];
    p->intensity = chance(.1) ? 0 : log_between(1e-3, 10);
    p->nonfinite = chance(.5) ? NONFINITE_KEEP : NONFINITE_ZERO;
    if (ENGINE_HAS_MIX && chance(.4)) {
        p->composite = 1 + (int)below(2);
        p->intensity = p->composite == COMPOSITE_MIX ? fmin(p->intensity, 1) : p->intensity;
    }
    if (ENGINE_HAS_FILL)
        p->edge = chance(.1) ? EDGE_FILL : EDGE_ZERO;
    if (ENGINE_HAS_DISPLAY && chance(.3)) {
        p->display = (int)below(3);
        p->encoding = (int)below(3);
        p->saturation = chance(.5) ? 1 : between(0, 3);
    }
    // Half is refused where its bound is above the tolerance.
    if (ENGINE_HAS_STORAGE && p->tolerance == 1e-1 && p->psf_spec.count <= 3 && chance(.7)) {
        p->storage = STORAGE_HALF;
        for (unsigned i = 0; i < p->psf_spec.count; i++)
            p->psf_spec.gaussian[i].weight = fmin(p->psf_spec.gaussian[i].weight, .5);
    } else {
        p->storage = (int)below(2);
    }
    if (ENGINE_HAS_BLOOM_OFF)
        p->bloom = chance(.05) ? SWITCH_OFF : SWITCH_ON;
    if (ENGINE_HAS_VIEWS && chance(.2))
        random_view(&p->view_spec, p);
    p->layer_count = ENGINE_HAS_VIEWS && chance(.2) ? 1 + below(3) : 0;
    for (unsigned i = 0; i < p->layer_count; i++)
        random_view(&p->layer[i], p);
}

static void random_params(struct params *p, const struct scene *s)
{
    struct fault f;
    params_init(p);
    random_psf(p, s);
    random_bright(p);
    if (ENGINE_HAS_TINTS && chance(.3)) {
        p->near_gain = between(0, 2);
        p->far_gain = between(0, 2);
    }
    if (ENGINE_HAS_SOURCE)
        p->emission = chance(.5) ? 1 : log_between(.01, 100);
    if (ENGINE_HAS_DIRT)
        p->dirt_gain = chance(.3) ? 1 : scene_uniform();
    random_output(p);
    // nonfinite=zero of a frame without weight is a conflict of the engine's own.
    p->psf_spec.gaussian[0].weight = fmax(p->psf_spec.gaussian[0].weight, .01);
    if (params_check(p, &f) < 0)
        fail_msg("%s", f.text);
}

/* ---- the property ---------------------------------------------------------------------------------- */

static void explain(const struct scene *s, const struct params *p, uint64_t seed, const struct scene_verdict *v)
{
    char line[4096];
    params_print(p, line, sizeof(line));
    print_error("AIRY_SEED=%" PRIu64 " AIRY_SCENES=1: %ux%u, %u channels, %s, aspect %g, grow %u, %u outputs%s%s%s\n", seed,
                s->width, s->height, s->channels, s->type == PIXEL_TYPE_HALF ? "half" : "float", s->aspect, s->grow,
                s->outputs, s->source[0] ? ", source" : "", s->matte ? ", matte" : "", s->dirt ? ", dirt" : "");
    print_error("  params: %s\n", line);
    for (unsigned i = 0; i < p->psf_spec.count; i++)
        print_error("  tint %u: %g:%g:%g\n", i, p->psf_spec.gaussian[i].tint[0], p->psf_spec.gaussian[i].tint[1],
                    p->psf_spec.gaussian[i].tint[2]);
    print_error("  plan: %s%s; bound %.3g, max E %.6g\n", s->reply.plan, s->reply.untouched ? " (untouched)" : "",
                s->reply.error_bound, v->max_bright);
    if (!(v->ratio <= 1))
        print_error("  output %u, pixel %u,%u channel %u: %.9g, %.9g expected, room %.3g, error/bound %.3g\n", v->output, v->x,
                    v->y, v->c, v->got, v->want, v->room, v->ratio);
    if (v->why[0])
        print_error("  %s\n", v->why);
}

static int rising(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

static uint64_t environment(const char *name, uint64_t otherwise)
{
    const char *text = getenv(name);
    return text ? strtoull(text, NULL, 0) : otherwise;
}

// The ratio, -1 when the frame came back untouched; *wrong counts.
static double try_scene(uint64_t seed, unsigned *wrong)
{
    struct scene s;
    struct params p;
    struct scene_verdict v;
    scene_seed(seed);
    random_scene(&s);
    random_params(&p, &s);
    s.outputs = 1 + p.layer_count;
    scene_run(&s, &p, engine, 0);
    scene_compare(&s, &p, &v);
    if (!(v.ratio <= 1) || v.why[0]) {
        ++*wrong;
        explain(&s, &p, seed, &v);
    }
    const double ratio = s.reply.untouched && v.ratio <= 1 ? -1 : v.ratio;
    scene_finish(&s);
    return ratio;
}

static void test_no_reply_exceeds_its_bound(void **state)
{
    (void)state;
    const uint64_t first = environment("AIRY_SEED", 20260101), scenes = environment("AIRY_SCENES", SCENES);
    unsigned wrong = 0, shown = 0;
    size_t n = 0;
    assert_true(scenes >= 1 && scenes <= 100000000);
    double *ratio = malloc(scenes * sizeof(double));
    assert_non_null(ratio);
    print_message("AIRY_SEED=%" PRIu64 " AIRY_SCENES=%" PRIu64 "\n", first, scenes);
    for (uint64_t i = 0; i < scenes && shown < 10; i++) {
        const unsigned before = wrong;
        const double r = try_scene(first + i, &wrong);
        shown += wrong > before;
        if (r >= 0)
            ratio[n++] = r;
    }
    qsort(ratio, n, sizeof(double), rising);
    print_message("property: %zu scenes glow, %" PRIu64 " in all; error / stated bound: max %.4f, 99%% %.4f, median %.4f\n",
                  n, scenes, n ? ratio[n - 1] : 0, n ? ratio[n * 99 / 100] : 0, n ? ratio[n / 2] : 0);
    if (scenes >= SCENES)
        assert_true(n > scenes / 3 || shown); // else nothing is tried
    free(ratio);
    if (wrong)
        fail_msg("%u replies are wrong", wrong);
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
    const struct bloom_options options = { .slots = 1, .validate = validate, .log = log_line,
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
        cmocka_unit_test(test_no_reply_exceeds_its_bound),
        cmocka_unit_test(test_no_validation_message),
    };
    // The layers take two thirds of the time, and test_engine and test_hard have them on: AIRY_TEST_VALIDATE=1 asks for them.
    validate = getenv("AIRY_TEST_VALIDATE") && strcmp(getenv("AIRY_TEST_VALIDATE"), "1") == 0;
    return _cmocka_run_group_tests("property", tests, sizeof(tests) / sizeof(tests[0]) - !validate, setup, teardown);
}
