// SPDX-License-Identifier: Apache-2.0
// test_property.c - random scenes, sizes and parameters: no reply may exceed the bound that it states. Every scene comes
// from a seed of its own, which a failure prints: AIRY_SEED=<seed> AIRY_SCENES=1 does that scene again. Parameters are set by
// name, as a client sets them, so that the line of a failure says all of them. AIRY_MINUTES=N goes on with new seeds for so long.
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
#include <time.h>

#include "scene_kit.h"

enum { SCENES = 300, SIDE_MAX = 200, KERNEL_PIXELS_MAX = 4000, SHOWN_MAX = 10 };

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

// Every second scene is plain, for each new set of switches is a pipeline that the driver compiles.
static void random_scene(struct scene *s, bool rich)
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
    if (!rich)
        return;
    if (chance(.3)) {
        scene_add_source(s);
        for (unsigned c = 0; c < s->channels; c++)
            random_plane(s->source[c], s->width, s->height, level, below(16));
    }
    if (chance(.3)) {
        scene_add_matte(s);
        sprinkle(s->matte, s->width, s->height, 1, matte_value);
    }
    if (chance(.2)) {
        scene_add_dirt(s, 1 + below(40), 1 + below(40));
        for (unsigned i = 0; i < s->dirt_width * s->dirt_height * 3; i++)
            s->dirt[i] = (float)between(0, 2);
    }
    if (chance(.25))
        s->grow = below(40);
    if (chance(.2))
        s->display_width = 1 + below(400);
}

/* ---- requests -------------------------------------------------------------------------------------- */

static void set(struct params *p, const char *name, const char *text)
{
    struct fault f;
    if (params_set_text(p, name, text, &f) < 0)
        fail_msg("%s=%s: %s", name, text, f.text);
}

static void set_number(struct params *p, const char *name, double v)
{
    char text[40];
    snprintf(text, sizeof(text), "%.6g", v);
    set(p, name, text);
}

/* One of the words, which are separated by single blanks. */
static void set_word(struct params *p, const char *name, const char *words)
{
    char copy[80], *at = copy, *end;
    unsigned n = 1;
    snprintf(copy, sizeof(copy), "%s", words);
    for (const char *c = copy; *c; c++)
        n += *c == ' ';
    for (n = below(n); n > 0; n--)
        at = strchr(at, ' ') + 1;
    if ((end = strchr(at, ' ')))
        *end = 0;
    set(p, name, at);
}

struct text {
    char s[PARAMS_TEXT_MAX];
    size_t len;
};

__attribute__((format(printf, 2, 3))) static void append(struct text *t, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    t->len += (size_t)vsnprintf(t->s + t->len, sizeof(t->s) - t->len, format, args);
    va_end(args);
    assert_true(t->len < sizeof(t->s));
}

static void random_gaussians(struct params *p, const struct scene *s)
{
    struct text t = { .len = 0 };
    const unsigned count = 1 + below(5);
    append(&t, "gaussians:sigma=");
    for (unsigned i = 0; i < count; i++) {
        const bool percent = chance(.2), mm = !percent && chance(.2);
        // In mm of a 36 mm sensor; a display window that is narrower than the frame only makes it wider.
        const double sigma = percent ? log_between(.2, 30) : mm ? log_between(.1, 5) : log_between(.3, 150);
        append(&t, "%s%.4g%s", i ? "/" : "", sigma, percent ? "%" : mm ? "mm" : "");
    }
    append(&t, ",weight=");
    for (unsigned i = 0; i < count; i++)
        append(&t, "%s%.4g", i ? "/" : "", chance(.1) && i ? 0 : log_between(.01, 2));
    if (s->channels == 3 && chance(.5)) {
        append(&t, ",tint=");
        for (unsigned i = 0; i < count; i++)
            append(&t, "%s%.3g:%.3g:%.3g", i ? "/" : "", between(0, 2), between(0, 2), between(0, 2));
    }
    set(p, "psf", t.s);
}

static void random_kernel(struct params *p, struct scene *s)
{
    struct text t = { .len = 0 };
    switch (below(4)) {
    case 0: append(&t, "eye:degrees=%.4g", between(1, 170)); break;
    case 1: append(&t, "airy:f=%.4g,pitch=%.4g", log_between(2, 64), log_between(1, 10)); break;
    case 2: append(&t, "aperture:blades=%u,rotation=%.4g,f=%.4g", 3 + below(8), between(-90, 90), log_between(4, 32)); break;
    default:
        scene_add_kernel(s, 1 + below(40), 1 + below(40));
        append(&t, "image:%s", s->kernel_digest);
    }
    append(&t, ",weight=%.4g", log_between(.01, 2));
    set(p, "psf", t.s);
}

static void random_bright(struct params *p, bool rich)
{
    const bool stops = chance(.2), automatic = chance(.2);
    set_word(p, "bright", "none channel luminance knee smoothstep");
    if (stops)
        set(p, "threshold_unit", "stops");
    set_number(p, "threshold", stops ? between(-8, 8) : chance(.15) ? 0 : log_between(1e-3, 1e3));
    set_number(p, "knee", p->bright == BRIGHT_SMOOTHSTEP ? between(.05, 1) : chance(.2) ? 0 : log_between(1e-3, 1e3));
    if (automatic) {
        set(p, "exposure", "auto");
        set_number(p, "key", log_between(.01, 10));
        set_number(p, "meter_dark", chance(.3) ? 0 : between(0, 60));
        set_number(p, "meter_bright", chance(.3) ? 0 : between(0, 39));
    } else {
        set_number(p, "exposure", chance(.3) ? between(-4, 4) : 0);
    }
    if (rich && chance(.3))
        set_number(p, "clamp", log_between(1e-3, 1e3));
    if (rich && chance(.3))
        set_number(p, "firefly", log_between(.1, 100));
}

/* A view's name, of those that the psf has. */
static const char *random_view(const struct params *p, char out[32])
{
    static const char *const views[] = { "final", "source", "bright", "bloom", "residual" };
    const unsigned n = below(p->psf_spec.count ? 6 : 5);
    if (n < 5)
        snprintf(out, 32, "%s", views[n]);
    else
        snprintf(out, 32, "level:%u", below(p->psf_spec.count));
    return out;
}

/* Each view once: the layers are named after them. */
static void random_layers(struct params *p)
{
    struct text t = { .len = 0 };
    char name[3][32];
    unsigned n = 0;
    for (unsigned tries = 1 + below(3); tries > 0; tries--) {
        random_view(p, name[n]);
        bool again = false;
        for (unsigned i = 0; i < n; i++)
            again |= !strcmp(name[i], name[n]);
        if (again || !strcmp(name[n], "final"))
            continue;
        append(&t, "%s%s", n ? "/" : "", name[n]);
        n++;
    }
    if (n)
        set(p, "layers", t.s);
}

static void random_output(struct params *p, bool rich)
{
    static const double tolerances[] = { 1e-1, 1e-2, 1e-3, 1e-3, 1e-4, 1e-5 };
    char name[32];
    set_number(p, "tolerance", tolerances[below(6)]);
    if (rich)
        set_word(p, "composite", "add mix screen-add");
    set_number(p, "intensity", chance(.1) ? 0 : log_between(1e-3, p->composite == COMPOSITE_MIX ? 1 : 10));
    set_word(p, "nonfinite", "keep zero");
    // Half is refused where its bound is above the tolerance.
    double weights = 0;
    for (unsigned i = 0; i < p->psf_spec.count; i++)
        weights += p->psf_spec.gaussian[i].weight;
    if (!rich && p->psf_spec.kind == PSF_GAUSSIANS && p->tolerance == 1e-1 && p->psf_spec.count <= 3 && weights < 2)
        set(p, "storage", "half");
    if (!rich)
        return;
    if (p->psf_spec.kind == PSF_GAUSSIANS && chance(.2))
        set(p, "edge", "fill");
    if (chance(.4)) {
        set_word(p, "display", "none reinhard aces");
        set_word(p, "encoding", "linear gamma2.2 srgb");
        set_number(p, "saturation", chance(.5) ? 1 : between(0, 3));
    }
    if (chance(.1))
        set(p, "bloom", "off");
    if (chance(.3))
        set(p, "view", random_view(p, name));
    if (chance(.3))
        random_layers(p);
}

static void random_params(struct params *p, struct scene *s, bool rich)
{
    struct fault f;
    params_init(p);
    if (s->width * s->height <= KERNEL_PIXELS_MAX && chance(.15))
        random_kernel(p, s);
    else
        random_gaussians(p, s);
    random_bright(p, rich);
    if (p->psf_spec.kind == PSF_GAUSSIANS && chance(.3)) {
        set_number(p, "near", between(0, 2));
        set_number(p, "far", between(0, 2));
    }
    if (s->source[0])
        set(p, "source", "glow");
    if (s->matte) {
        set(p, "matte", "matte");
        set_number(p, "emission", chance(.3) ? 1 : log_between(.01, 100));
    }
    if (s->dirt) {
        set(p, "dirt", "00000000000000000000000000000001");
        set_number(p, "dirt_gain", chance(.3) ? 1 : scene_uniform());
    }
    set_number(p, "grow", s->grow);
    random_output(p, rich);
    if (params_check(p, &f) < 0)
        fail_msg("%s", f.text);
}

/* ---- the property ---------------------------------------------------------------------------------- */

static void explain(const struct scene *s, const struct params *p, uint64_t seed, const struct scene_verdict *v)
{
    char line[PARAMS_LINE_MAX];
    params_print(p, line, sizeof(line));
    print_error("AIRY_SEED=%" PRIu64 " AIRY_SCENES=1: %ux%u, %u channels, %s, aspect %g, grow %u, %u outputs%s%s%s\n", seed,
                s->width, s->height, s->channels, s->type == PIXEL_TYPE_HALF ? "half" : "float", s->aspect, s->grow,
                s->outputs, s->source[0] ? ", source" : "", s->matte ? ", matte" : "", s->dirt ? ", dirt" : "");
    print_error("  params: %s\n", line);
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

static uint64_t environment(const char *name, uint64_t otherwise, uint64_t most)
{
    const char *text = getenv(name);
    char *end = NULL;
    const uint64_t v = text ? strtoull(text, &end, 10) : otherwise;
    if (text && (end == text || *end || v > most))
        fail_msg("%s=%s: a whole number of at most %" PRIu64 " expected", name, text, most);
    return v;
}

// The ratio, -1 when the frame came back untouched; *wrong counts.
static double try_scene(uint64_t seed, unsigned *wrong)
{
    struct scene s;
    struct params p;
    struct scene_verdict v;
    scene_seed(seed);
    const bool rich = chance(.5);
    random_scene(&s, rich);
    random_params(&p, &s, rich);
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

/* Scenes by number, or by time. */
struct extent {
    uint64_t first, scenes;
    time_t until; /* 0: all scenes */
};

static struct extent extent(void)
{
    struct extent e = { .first = environment("AIRY_SEED", 20260101, UINT64_MAX / 2) };
    const uint64_t minutes = environment("AIRY_MINUTES", 0, 100000);
    e.scenes = environment("AIRY_SCENES", minutes ? 100000000 : SCENES, 100000000);
    assert_true(e.scenes >= 1);
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    e.until = minutes ? now.tv_sec + 60 * (time_t)minutes : 0;
    return e;
}

static bool goes_on(const struct extent *e, uint64_t done)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return done < e->scenes && (!e->until || now.tv_sec < e->until);
}

static void test_no_reply_exceeds_its_bound(void **state)
{
    (void)state;
    const struct extent e = extent();
    unsigned wrong = 0;
    size_t n = 0, room = 0;
    uint64_t done, worst = 0;
    double *ratio = NULL, most = -1;
    print_message("AIRY_SEED=%" PRIu64 " AIRY_SCENES=%" PRIu64 "\n", e.first, e.scenes);
    for (done = 0; goes_on(&e, done) && wrong < SHOWN_MAX; done++) {
        const double r = try_scene(e.first + done, &wrong);
        if (n == room)
            ratio = realloc(ratio, (room = 2 * room + 1024) * sizeof(double));
        assert_non_null(ratio);
        if (r >= 0)
            ratio[n++] = r;
        if (r > most)
            most = r, worst = e.first + done;
    }
    qsort(ratio, n, sizeof(double), rising);
    print_message("property: %zu scenes glow, %" PRIu64 " in all; error / stated bound: max %.4f (AIRY_SEED=%" PRIu64
                  "), 99%% %.4f, median %.4f\n",
                  n, done, n ? ratio[n - 1] : 0, worst, n ? ratio[n * 99 / 100] : 0, n ? ratio[n / 2] : 0);
    if (done >= SCENES)
        assert_true(n > done / 3 || wrong); // else nothing is tried
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
