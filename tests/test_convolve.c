// SPDX-License-Identifier: Apache-2.0
// test_convolve.c - the convolution by FFT against a dense one in long double with the same kernel: no
// error may exceed the bound that the convolver states, on the sizes and the frames of METHODS
// section 4.
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "convolve.h"
#include "fft.h"
#include "kernel.h"

enum { IMAGE_W = 6, IMAGE_H = 5 };
static float image[IMAGE_W * IMAGE_H * 3];
static const char *const kind_name[] = { "gaussians", "eye", "airy", "aperture", "image" };

struct picture {
    uint32_t width, height;
    float *plane[3];
};

static void *taken(size_t count, size_t size)
{
    void *p = calloc(count, size);
    assert_non_null(p);
    return p;
}

static struct picture picture_of(uint32_t width, uint32_t height)
{
    struct picture p = { width, height, { NULL, NULL, NULL } };
    for (unsigned c = 0; c < 3; c++)
        p.plane[c] = taken((size_t)width * height, sizeof(float));
    return p;
}

static void picture_free(struct picture *p)
{
    for (unsigned c = 0; c < 3; c++)
        free(p->plane[c]);
}

static float random_number(uint32_t *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return (float)(*seed >> 8) * 0x1p-24f;
}

enum scene { SCENE_NOISE, SCENE_POINT, SCENE_POINT_ON_NOISE, SCENE_BESIDE, SCENES };
static const char *const scene_name[] = { "noise", "1e6 on 0", "1e6 on 1e-3 noise", "6e4 beside 1e-6" };

static void scene_paint(struct picture *p, enum scene scene, uint32_t seed)
{
    const size_t count = (size_t)p->width * p->height;
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < count; i++) {
            const float r = random_number(&seed);
            const bool here = i == count / 2 + p->width / 3;
            p->plane[c][i] = scene == SCENE_NOISE            ? r
                             : scene == SCENE_POINT          ? (here ? 1e6f : 0)
                             : scene == SCENE_POINT_ON_NOISE ? (here ? 1e6f : 1e-3f * r)
                             : i % p->width < p->width / 2   ? 6e4f
                                                             : 1e-6f;
        }
}

static struct psf_spec spec_of(enum psf_kind kind)
{
    return (struct psf_spec){ .kind = kind,
                              .weight = 0.1,
                              .f_number = 8,
                              .pitch_um = 5,
                              .wavelength_nm = { 610, 550, 465 },
                              .blades = 5,
                              .rotation_deg = 8,
                              .degrees = 40 };
}

static struct convolver_facts facts_of(const struct psf_spec *s, uint32_t width, uint32_t height,
                                       uint32_t grow)
{
    return (struct convolver_facts){ .width = width,
                                     .height = height,
                                     .grow = grow,
                                     .channels = 3,
                                     .pixel_aspect = 1,
                                     .psf = s,
                                     .image = image,
                                     .image_width = IMAGE_W,
                                     .image_height = IMAGE_H,
                                     .threads = 2 };
}

static struct convolver *made(const struct convolver_facts *facts)
{
    struct convolver *c;
    struct fault f;
    if (convolver_create(&c, facts, &f) < 0)
        fail_msg("%s: %s", f.field, f.text);
    return c;
}

static void ran(struct convolver *c, const struct picture *in, struct picture *out)
{
    assert_int_equal(
        convolver_run(c, (const float *const *)in->plane, in->width, out->plane, out->width, NULL), 0);
}

static struct kernel kernel_of(const struct convolver_facts *facts, unsigned channel)
{
    const struct kernel_facts k = { .psf = facts->psf,
                                    .reach_x = facts->width + facts->grow - 1,
                                    .reach_y = facts->height + facts->grow - 1,
                                    .pixel_aspect = facts->pixel_aspect,
                                    .picture_height = facts->height,
                                    .image = facts->image,
                                    .image_width = facts->image_width,
                                    .image_height = facts->image_height };
    struct kernel out;
    struct crew *crew;
    assert_int_equal(crew_create(&crew, 1), 0);
    assert_int_equal(kernel_draw(&out, &k, channel, crew, NULL), 0);
    crew_destroy(crew);
    return out;
}

static double exact_at(const struct kernel *k, const float *e, const struct convolver_facts *facts,
                       int32_t x, int32_t y)
{
    long double sum = 0;
    for (int32_t v = 0; v < (int32_t)facts->height; v++)
        for (int32_t u = 0; u < (int32_t)facts->width; u++, e++)
            if (*e != 0)
                sum += (long double)kernel_at(k, x - u, y - v) * (long double)*e;
    return (double)(sum * facts->psf->weight);
}

static double largest(const struct picture *p)
{
    float most = 0;
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < (size_t)p->width * p->height; i++)
            most = fmaxf(most, p->plane[c][i]);
    return (double)most;
}

struct worst {
    double of_bound, beyond_rounding,
        relative; /* error / bound; (error - float's) / max E; error / exact */
};

static void frame_compare(const struct convolver_facts *facts, struct convolver *c, enum scene scene,
                          struct worst *worst)
{
    struct picture in = picture_of(facts->width, facts->height);
    struct picture out = picture_of(facts->width + 2 * facts->grow, facts->height + 2 * facts->grow);
    scene_paint(&in, scene, 7 * facts->width + facts->height);
    ran(c, &in, &out);
    const double bound = convolver_bound(c) * largest(&in),
                 rounding = facts->psf->weight * 0x1p-24 * largest(&in);
    for (unsigned channel = 0; channel < 3; channel++) {
        struct kernel k = kernel_of(facts, channel);
        for (uint32_t i = 0; i < out.width * out.height; i++) {
            const int32_t x = (int32_t)(i % out.width - facts->grow),
                          y = (int32_t)(i / out.width - facts->grow);
            const double exact = exact_at(&k, in.plane[channel], facts, x, y),
                         got = (double)out.plane[channel][i];
            const double error = fabs(got - exact);
            // The FFT's part of the bound by itself, too: float32's would hide it.
            if (!(got >= 0 && error <= bound && error - exact * 0x1p-24 <= bound - rounding))
                fail_msg("%s, %s, %u x %u, grow %u, aspect %g, channel %u, pixel (%d, %d): %.9g, exact "
                         "%.9g, bound %.3g",
                         kind_name[facts->psf->kind], scene_name[scene], facts->width, facts->height,
                         facts->grow, facts->pixel_aspect, channel, x, y, got, exact, bound);
            worst->of_bound = fmax(worst->of_bound, error / bound);
            worst->beyond_rounding =
                fmax(worst->beyond_rounding, (error - exact * 0x1p-24) / largest(&in));
            worst->relative = fmax(worst->relative, exact > 0 ? error / exact : 0);
        }
        kernel_finish(&k);
    }
    picture_free(&in);
    picture_free(&out);
}

static void test_against_dense(void **state)
{
    (void)state;
    static const uint32_t size[][3] = { { 1, 1, 0 },   { 1, 1, 2 },   { 1, 17, 0 },
                                        { 13, 1, 3 },  { 2, 2, 0 },   { 7, 5, 1 },
                                        { 23, 19, 0 }, { 16, 16, 5 }, { 27, 17, 6 } };
    for (int kind = PSF_EYE; kind <= PSF_IMAGE; kind++) {
        const struct psf_spec s = spec_of((enum psf_kind)kind);
        for (unsigned scene = 0; scene < SCENES; scene++) {
            struct worst worst = { 0, 0, 0 };
            for (unsigned i = 0; i < sizeof(size) / sizeof(*size); i++) {
                struct convolver_facts facts = facts_of(&s, size[i][0], size[i][1], size[i][2]);
                facts.pixel_aspect = i % 2 ? 2 : 1;
                struct convolver *c = made(&facts);
                // The bound is no blank cheque: float32's rounding and little more.
                assert_true(convolver_bound(c) > s.weight * 0x1p-24 &&
                            convolver_bound(c) < 1.001 * s.weight * 0x1p-24);
                frame_compare(&facts, c, (enum scene)scene, &worst);
                convolver_destroy(c);
            }
            print_message("%-8s %-17s error / bound %.3f, FFT's part / max E %.1e, relative %.1e\n",
                          kind_name[kind], scene_name[scene], worst.of_bound, worst.beyond_rounding,
                          worst.relative);
            // METHODS section 4, case 5: for kernels that leave no pixel dark.
            assert_true(kind == PSF_IMAGE || worst.relative < 1e-5);
        }
    }
}

// A larger frame at some pixels only: 1e6 in a corner, and what float64 makes of the other one.
static void test_dark_pixels(void **state)
{
    (void)state;
    for (int kind = PSF_EYE; kind <= PSF_IMAGE; kind++) {
        const struct psf_spec s = spec_of((enum psf_kind)kind);
        const struct convolver_facts facts = facts_of(&s, 211, 149, 0);
        struct convolver *c = made(&facts);
        struct picture in = picture_of(211, 149), out = picture_of(211, 149);
        double relative = 0, noise = 0;
        for (unsigned i = 0; i < 3; i++)
            in.plane[i][211 * 3 + 4] = 1e6f;
        ran(c, &in, &out);
        struct kernel k = kernel_of(&facts, 0);
        for (uint32_t i = 0; i < 211 * 149; i++) {
            const double exact = 1e5 * kernel_at(&k, (int32_t)(i % 211) - 4, (int32_t)(i / 211) - 3),
                         got = (double)out.plane[0][i];
            assert_true(got >= 0 && fabs(got - exact) <= 1e6 * convolver_bound(c));
            relative = fmax(relative, exact > 0 ? fabs(got - exact) / exact : 0);
            noise = fmax(noise, fabs(got - exact) - exact * 0x1p-24);
        }
        print_message("%-8s 1e6 in a corner of 211 x 149: relative %.1e, noise of the FFT %.1e\n",
                      kind_name[kind], relative, noise);
        assert_true(relative < 1e-5 && noise < 1e-8);
        kernel_finish(&k);
        convolver_destroy(c);
        picture_free(&in);
        picture_free(&out);
    }
}

static void test_no_light_is_exact(void **state)
{
    (void)state;
    for (int kind = PSF_EYE; kind <= PSF_IMAGE; kind++) {
        const struct psf_spec s = spec_of((enum psf_kind)kind);
        const struct convolver_facts facts = facts_of(&s, 45, 38, 4);
        struct convolver *c = made(&facts);
        struct picture in = picture_of(45, 38), out = picture_of(53, 46), zero = picture_of(53, 46);
        scene_paint(&in, SCENE_NOISE, 5);
        memset(in.plane[1], 0, 45 * 38 * sizeof(float));
        ran(c, &in, &out);
        assert_memory_equal(out.plane[1], zero.plane[1], 53 * 46 * sizeof(float));
        assert_true(out.plane[0][0] > 0 || kind == PSF_IMAGE);
        for (unsigned i = 0; i < 3; i++)
            memset(in.plane[i], 0, 45 * 38 * sizeof(float));
        ran(c, &in, &out);
        for (unsigned i = 0; i < 3; i++)
            assert_memory_equal(out.plane[i], zero.plane[i], 53 * 46 * sizeof(float));
        convolver_destroy(c);
        picture_free(&in);
        picture_free(&out);
        picture_free(&zero);
    }
}

static void test_linear(void **state)
{
    (void)state;
    const struct psf_spec s = spec_of(PSF_APERTURE);
    const struct convolver_facts facts = facts_of(&s, 61, 53, 0);
    const size_t count = 61 * 53;
    struct convolver *c = made(&facts);
    struct picture a = picture_of(61, 53), b = picture_of(61, 53), both = picture_of(61, 53);
    struct picture fa = picture_of(61, 53), fb = picture_of(61, 53), fboth = picture_of(61, 53);
    scene_paint(&a, SCENE_NOISE, 1);
    scene_paint(&b, SCENE_BESIDE, 2);
    // Twice the light is, but for the smallest numbers, the same digits; sums agree within the three
    // bounds.
    for (unsigned i = 0; i < 3; i++)
        for (size_t n = 0; n < count; n++)
            both.plane[i][n] = 2 * a.plane[i][n];
    ran(c, &a, &fa);
    ran(c, &both, &fboth);
    for (unsigned i = 0; i < 3; i++)
        for (size_t n = 0; n < count; n++)
            assert_true(fboth.plane[i][n] == 2 * fa.plane[i][n]);
    for (unsigned i = 0; i < 3; i++)
        for (size_t n = 0; n < count; n++)
            both.plane[i][n] = a.plane[i][n] + b.plane[i][n];
    ran(c, &b, &fb);
    ran(c, &both, &fboth);
    // The sum itself was rounded to float32 in each sample.
    const double allowed = convolver_bound(c) * (largest(&a) + largest(&b) + largest(&both)) +
                           s.weight * largest(&both) * 0x1p-24;
    for (unsigned i = 0; i < 3; i++)
        for (size_t n = 0; n < count; n++)
            assert_true(fabs((double)fboth.plane[i][n] - (double)fa.plane[i][n] -
                             (double)fb.plane[i][n]) <= allowed);
    convolver_destroy(c);
    struct picture *all[] = { &a, &b, &both, &fa, &fb, &fboth };
    for (unsigned i = 0; i < 6; i++)
        picture_free(all[i]);
}

static void test_threads_give_the_same_bytes(void **state)
{
    (void)state;
    for (int kind = PSF_EYE; kind <= PSF_IMAGE; kind++) {
        const struct psf_spec s = spec_of((enum psf_kind)kind);
        struct convolver_facts facts = facts_of(&s, 150, 97, 3);
        struct picture in = picture_of(150, 97), first = picture_of(156, 103);
        scene_paint(&in, SCENE_POINT_ON_NOISE, 3);
        for (facts.threads = 0; facts.threads <= 5; facts.threads++) {
            struct picture out = picture_of(156, 103);
            struct convolver *c = made(&facts);
            for (unsigned turn = 0; turn < 2; turn++) {
                ran(c, &in, facts.threads ? &out : &first);
                for (unsigned i = 0; facts.threads && i < 3; i++)
                    assert_memory_equal(out.plane[i], first.plane[i], 156 * 103 * sizeof(float));
            }
            convolver_destroy(c);
            picture_free(&out);
        }
        picture_free(&in);
        picture_free(&first);
    }
}

static void test_one_plane_has_the_mean(void **state)
{
    (void)state;
    for (int kind = PSF_EYE; kind <= PSF_IMAGE; kind++) {
        const struct psf_spec s = spec_of((enum psf_kind)kind);
        struct convolver_facts facts = facts_of(&s, 40, 30, 0);
        struct picture in = picture_of(40, 30), one = picture_of(40, 30), three = picture_of(40, 30);
        scene_paint(&in, SCENE_NOISE, 9);
        memcpy(in.plane[1], in.plane[0], 1200 * sizeof(float));
        memcpy(in.plane[2], in.plane[0], 1200 * sizeof(float));
        struct convolver *c = made(&facts);
        ran(c, &in, &three);
        convolver_destroy(c);
        facts.channels = 1;
        c = made(&facts);
        ran(c, &in, &one);
        for (unsigned i = 0; i < 1200; i++) {
            const double mean =
                ((double)three.plane[0][i] + (double)three.plane[1][i] + (double)three.plane[2][i]) / 3;
            assert_true(fabs((double)one.plane[0][i] - mean) <= 2 * convolver_bound(c));
            assert_true(one.plane[1][i] == 0);
        }
        convolver_destroy(c);
        picture_free(&in);
        picture_free(&one);
        picture_free(&three);
    }
}

// Strides, and a kernel larger than the frame: what it lacks is in the ledger.
static void test_ledger_of_a_large_image(void **state)
{
    (void)state;
    const struct psf_spec s = spec_of(PSF_IMAGE);
    struct convolver_facts facts = facts_of(&s, 2, 1, 0);
    struct convolver *c = made(&facts);
    const float e[8] = { 1, 0, 77, 77, 77, 77, 77, 77 };
    float out[3][8] = { { 0 } };
    const float *const in[3] = { e, e, e };
    float *const to[3] = { out[0], out[1], out[2] };
    assert_int_equal(convolver_run(c, in, 8, to, 8, NULL), 0);
    for (unsigned i = 0; i < 3; i++) {
        double total = 0, kept = 0;
        for (unsigned n = 0; n < IMAGE_W * IMAGE_H; n++)
            total += (double)image[3 * n + i];
        for (unsigned x = IMAGE_W / 2 - 1; x <= IMAGE_W / 2 + 1; x++)
            kept += (double)image[3 * (IMAGE_H / 2 * IMAGE_W + x) + i];
        assert_true(fabs(convolver_weight(c, i) - 0.1 * (1 - kept / total)) < 1e-12);
        const double here = 0.1 * (double)image[3 * (IMAGE_H / 2 * IMAGE_W + IMAGE_W / 2) + i] / total;
        assert_true(fabs((double)out[i][0] - here) < 1e-8 && out[i][2] == 0);
    }
    struct fault f;
    assert_int_equal(convolver_run(c, in, 1, to, 8, &f), -1);
    assert_int_equal(convolver_run(c, in, 8, to, 1, &f), -1);
    convolver_destroy(c);
    const struct psf_spec eye = spec_of(PSF_EYE);
    facts.psf = &eye;
    c = made(&facts);
    assert_true(convolver_weight(c, 0) == 0 && convolver_outside(c, 0) > 0 &&
                convolver_outside(c, 0) < 1);
    convolver_destroy(c);
}

static void test_large_numbers(void **state)
{
    (void)state;
    struct psf_spec s = spec_of(PSF_EYE);
    s.weight = 100;
    const struct convolver_facts facts = facts_of(&s, 9, 9, 0);
    struct convolver *c = made(&facts);
    struct picture in = picture_of(9, 9), out = picture_of(9, 9);
    for (unsigned i = 0; i < 81; i++) {
        in.plane[0][i] = 3e38f;
        in.plane[1][i] = 1e-44f;
        in.plane[2][i] = 1e-38f;
    }
    ran(c, &in, &out);
    assert_true(out.plane[0][40] == 0x1.fffffep127f);
    assert_true(isfinite(out.plane[1][40]) && out.plane[1][40] > 1e-43f && out.plane[2][40] > 1e-37f &&
                out.plane[2][40] < 1e-36f);
    convolver_destroy(c);
    picture_free(&in);
    picture_free(&out);
}

static void refused(const struct convolver_facts *facts, enum fault_code code, const char *part)
{
    struct convolver *c = NULL;
    struct fault f = { 0 };
    assert_int_equal(convolver_create(&c, facts, &f), -1);
    assert_null(c);
    if (f.code != code || strcmp(f.field, "params.psf") != 0 || !strstr(f.text, part))
        fail_msg("%d %s: %s", (int)f.code, f.field, f.text);
}

static void test_bad_facts_are_refused(void **state)
{
    (void)state;
    struct psf_spec s = spec_of(PSF_IMAGE);
    const struct convolver_facts good = facts_of(&s, 8, 8, 0);
    struct convolver_facts facts = good;
    facts.width = 0;
    refused(&facts, FAULT_PARAM_RANGE, "0 x 8");
    facts = good;
    facts.height = 0;
    refused(&facts, FAULT_PARAM_RANGE, "8 x 0");
    facts = good;
    facts.channels = 2;
    refused(&facts, FAULT_PARAM_RANGE, "2 channels");
    facts = good;
    facts.width = facts.height = facts.grow = UINT32_MAX;
    refused(&facts, FAULT_LIMIT, "4294967295");
    facts = good;
    facts.grow = UINT32_MAX - 4;
    refused(&facts, FAULT_LIMIT, "grow 4294967291");
    facts = good;
    facts.image_width = facts.image_height = 0x80000000u;
    refused(&facts, FAULT_PARAM_RANGE, "2147483648");
    facts.image_width = 0;
    refused(&facts, FAULT_PARAM_RANGE, "0 x 2147483648");
    facts = good;
    const double weight[] = { NAN, INFINITY, -1 };
    for (unsigned i = 0; i < 3; i++) {
        s.weight = weight[i];
        refused(&facts, FAULT_PARAM_RANGE, "a weight of");
    }
    s.weight = 1;
    image[40] = NAN;
    refused(&facts, FAULT_PARAM_RANGE, "nan found, a finite number");
    image[40] = 1;
    s = spec_of(PSF_EYE);
    facts.width = facts.height = 60000;
    refused(&facts, FAULT_LIMIT, "MiB, at most");
    s.kind = PSF_GAUSSIANS;
    refused(&facts, FAULT_INTERNAL, "kind 0");
    convolver_destroy(NULL);
}

// The transform by itself, of each radix and their products: against the sum that defines it.
static void test_transform(void **state)
{
    (void)state;
    static const uint32_t length[] = { 1,  2,  3,  4,   5,   6,   8,   9,   25,
                                       30, 60, 96, 120, 125, 243, 256, 270, 600 };
    uint32_t seed = 11;
    for (unsigned i = 0; i < sizeof(length) / sizeof(*length); i++) {
        const uint32_t n = length[i];
        struct fft t;
        assert_int_equal(fft_length(n), n);
        assert_int_equal(fft_init(&t, n), 0);
        double *all = taken((size_t)n * FFT_LANES * 6, sizeof(*all));
        const size_t part = (size_t)n * FFT_LANES;
        for (size_t k = 0; k < 2 * part; k++)
            all[k] = all[4 * part + k] = (double)random_number(&seed) - 0.5;
        const struct fft_batch z = { all, all + part }, work = { all + 2 * part, all + 3 * part };
        const double *re = all + 4 * part, *im = all + 5 * part;
        const struct fft_batch r = fft_run(&t, z, work, false);
        for (unsigned l = 0; l < FFT_LANES; l++) {
            double off = 0, norm = 0, sum = 0, most = 0;
            for (uint32_t k = 0; k < n; k++) {
                long double wr = 0, wi = 0;
                for (uint32_t x = 0; x < n; x++) {
                    const long double turn = -2 * 3.14159265358979323846264L * (x * k % n) / n;
                    const double a = re[x * FFT_LANES + l], b = im[x * FFT_LANES + l];
                    wr += a * cosl(turn) - b * sinl(turn);
                    wi += a * sinl(turn) + b * cosl(turn);
                }
                const double error =
                    (double)hypotl(r.re[k * FFT_LANES + l] - wr, r.im[k * FFT_LANES + l] - wi);
                most = fmax(most, error);
                off += error * error;
                norm += (double)(wr * wr + wi * wi);
                sum += hypot(re[k * FFT_LANES + l], im[k * FFT_LANES + l]);
            }
            const struct fft_rounding bound = fft_rounding(&t);
            if (sqrt(off) > bound.norm * sqrt(norm) || most > bound.each * sum)
                fail_msg("length %u: norm %g of %g, each %g of %g", n, sqrt(off),
                         bound.norm * sqrt(norm), most, bound.each * sum);
        }
        const struct fft_batch other = { r.re == z.re ? work.re : z.re, r.im == z.im ? work.im : z.im };
        const struct fft_batch back = fft_run(&t, r, other, true);
        for (size_t k = 0; k < part; k++)
            assert_true(fabs(back.re[k] / n - re[k]) < 1e-14 && fabs(back.im[k] / n - im[k]) < 1e-14);
        free(all);
        fft_finish(&t);
    }
    assert_int_equal(fft_length(7), 8);
    assert_int_equal(fft_length(2159), 2160);
    assert_int_equal(fft_length(3839), 3840);
}

static int image_make(void **state)
{
    (void)state;
    uint32_t seed = 99;
    for (unsigned i = 0; i < IMAGE_W * IMAGE_H * 3; i++)
        image[i] = 0.1f + random_number(&seed);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_transform),
        cmocka_unit_test(test_against_dense),
        cmocka_unit_test(test_dark_pixels),
        cmocka_unit_test(test_no_light_is_exact),
        cmocka_unit_test(test_linear),
        cmocka_unit_test(test_threads_give_the_same_bytes),
        cmocka_unit_test(test_one_plane_has_the_mean),
        cmocka_unit_test(test_ledger_of_a_large_image),
        cmocka_unit_test(test_large_numbers),
        cmocka_unit_test(test_bad_facts_are_refused),
    };
    return cmocka_run_group_tests(tests, image_make, NULL);
}
