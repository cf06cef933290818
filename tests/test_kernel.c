// SPDX-License-Identifier: Apache-2.0
// test_kernel.c - drawn kernels against published facts of each model, and against integrals over single
// pixels that share no code with them: products of Simpson's rule on the formula of the paper.
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "kernel_parts.h"

static struct crew *crew;

static struct psf_spec spec_of(enum psf_kind kind)
{
    return (struct psf_spec){ .kind = kind,
                              .weight = 1,
                              .f_number = 8,
                              .pitch_um = 5,
                              .wavelength_nm = { 610, 550, 465 },
                              .blades = 6,
                              .degrees = 40 };
}

static struct kernel drawn(const struct psf_spec *s, uint32_t reach, double aspect, uint32_t height)
{
    const struct kernel_facts facts = {
        .psf = s, .reach_x = reach, .reach_y = reach, .pixel_aspect = aspect, .picture_height = height
    };
    struct fault f;
    struct kernel k = { 0 };
    if (kernel_check(&facts, &f) < 0 || kernel_draw(&k, &facts, 1, crew, &f) < 0)
        fail_msg("%s", f.text);
    return k;
}

static double sum_within(const struct kernel *k, double radius)
{
    double sum = 0;
    const int32_t r = k->max_x;
    for (int32_t y = -r; y <= r; y++)
        for (int32_t x = -r; x <= r; x++)
            sum += hypot(x, y) <= radius ? kernel_at(k, x, y) : 0;
    return sum;
}

static void near_to(double got, double wanted, double relative, const char *what)
{
    if (!(fabs(got - wanted) <= relative * fabs(wanted)))
        fail_msg("%s: %.12g, wanted %.12g", what, got, wanted);
}

// Simpson with 2 * steps parts each way, over the pixel at (x, y).
static double pixel_integral(double (*density)(const void *ctx, double x, double y), const void *ctx,
                             int x, int y, double aspect, int steps)
{
    double sum = 0;
    for (int i = 0; i <= 2 * steps; i++)
        for (int j = 0; j <= 2 * steps; j++) {
            const double wi = i == 0 || i == 2 * steps ? 1
                              : i % 2                  ? 4
                                                       : 2,
                         wj = j == 0 || j == 2 * steps ? 1
                              : j % 2                  ? 4
                                                       : 2;
            sum += wi * wj *
                   density(ctx, aspect * (x - 0.5 + i / (2.0 * steps)), y - 0.5 + j / (2.0 * steps));
        }
    return sum * aspect / (36.0 * steps * steps);
}

static void test_points_integrate_polynomials(void **state)
{
    (void)state;
    for (unsigned n = 2; n <= KERNEL_POINTS_MAX; n += n < 8 ? 1 : 7) {
        struct kernel_points p;
        kernel_points_make(&p, n);
        for (unsigned power = 0; power < 2 * n && power < 40; power++) {
            double sum = 0;
            for (unsigned i = 0; i < n; i++)
                sum += p.weight[i] * pow(2 * p.at[i], power);
            if (fabs(sum - (power % 2 ? 0 : 1.0 / (power + 1))) > 1e-14)
                fail_msg("%u points, x^%u: %.17g", n, power, sum);
        }
    }
}

/* ---- airy
 * --------------------------------------------------------------------------------------------- */

static double airy_density(const void *ctx, double x, double y)
{
    const double cycles = *(const double *)ctx, v = M_PI * cycles * hypot(x, y),
                 a = v > 1e-9 ? 2 * j1(v) / v : 1;
    return M_PI / 4 * cycles * cycles * a * a;
}

static void test_airy_energy_is_bessel(void **state)
{
    (void)state;
    for (double v = 200; v < 1e5; v *= 1.0137)
        near_to(kernel_airy_beyond(v), j0(v) * j0(v) + j1(v) * j1(v), 1e-9, "J0^2 + J1^2");
    near_to(1 - kernel_airy_beyond(3.8317059702), 0.8378, 1e-4, "energy within the first dark ring");
    near_to(1 - kernel_airy_beyond(7.0155866698), 0.9099, 1e-3, "energy within the second");
}

static void test_airy_rings(void **state)
{
    (void)state;
    struct psf_spec s = spec_of(PSF_AIRY);
    s.f_number = 32;
    s.pitch_um = 0.5;
    const double ring = 1.21967 * 0.55 * 32 / 0.5;
    struct kernel k = drawn(&s, 300, 1, 600);
    int32_t dark = 1;
    while (kernel_at(&k, dark + 1, 0) < kernel_at(&k, dark, 0))
        dark++;
    print_message("first dark ring at %d pixels, 1.22 lambda N is %.2f\n", dark, ring);
    assert_true(fabs(dark - ring) <= 1);
    const double inside = sum_within(&k, ring) * (1 - k.outside);
    print_message("energy within it %.4f, published 0.838; beyond the frame %.4f\n", inside, k.outside);
    assert_true(fabs(inside - 0.8378) < 2e-3);
    double bright = 0;
    for (int32_t x = dark; x < 2 * dark; x++)
        bright = fmax(bright, kernel_at(&k, x, 0));
    near_to(bright / kernel_at(&k, 0, 0), 0.0175, 0.01, "first bright ring over the peak");
    near_to(sum_within(&k, 1e9), 1, 1e-12, "sum");
    kernel_finish(&k);
}

static void pixels_compare(const char *name, const struct kernel *k, double share,
                           double (*density)(const void *, double, double), const void *ctx,
                           double aspect, int steps, double allowed)
{
    static const int at[][2] = { { 0, 0 },  { 1, 0 },  { 0, 1 },   { 1, 1 },   { 3, 2 },  { 4, 0 },
                                 { 15, 7 }, { 16, 9 }, { 40, 63 }, { 0, 100 }, { 97, 31 } };
    double worst = 0;
    for (unsigned i = 0; i < sizeof(at) / sizeof(*at); i++) {
        const int near = at[i][0] + at[i][1] < 6, x = at[i][0], y = at[i][1];
        const double exact =
            share * pixel_integral(density, ctx, x, y, aspect, near ? 8 * steps : steps);
        const double got = kernel_at(k, x, y) * (1 - k->outside), off = fabs(got / exact - 1);
        if (!(off <= allowed))
            fail_msg("%s, aspect %g, pixel (%d, %d): %.10g, its integral is %.10g", name, aspect, x, y,
                     got, exact);
        worst = fmax(worst, off);
    }
    print_message("%s, aspect %g: worst pixel off by %.1e\n", name, aspect, worst);
}

static void test_airy_pixels(void **state)
{
    (void)state;
    for (double aspect = 1; aspect <= 2; aspect += 0.5)
        for (double f_number = 2.8; f_number < 30; f_number *= 3) {
            struct psf_spec s = spec_of(PSF_AIRY);
            s.f_number = f_number;
            const double cycles = 5 / (0.55 * f_number);
            struct kernel k = drawn(&s, 110, aspect, 1);
            pixels_compare("airy", &k, 1, airy_density, &cycles, aspect, 40, 2e-5);
            kernel_finish(&k);
        }
}

// Far finer than a pixel: all but a tail in the middle; the tail's mean is B^2 / v^3 = 1 / (pi^3 B r^3).
static void test_airy_finer_than_drawn(void **state)
{
    (void)state;
    struct psf_spec s = spec_of(PSF_AIRY);
    s.f_number = 0.5;
    s.pitch_um = 1000;
    const double cycles = 1000 / (0.55 * 0.5);
    struct kernel k = drawn(&s, 40, 1, 1);
    double sum = 0, mean = 0;
    for (int32_t y = -40; y <= 40; y++)
        for (int32_t x = -40; x <= 40; x++)
            if (hypot(x, y) > 10) {
                sum += kernel_at(&k, x, y);
                mean += 1 / (M_PI * M_PI * M_PI * cycles * pow(hypot(x, y), 3));
            }
    near_to(sum, mean, 0.02, "tail");
    assert_true(kernel_at(&k, 0, 0) < 1 && kernel_at(&k, 0, 0) > 1 - 1e-3);
    kernel_finish(&k);
}

/* ---- eye
 * ---------------------------------------------------------------------------------------------- */

// The paper's formula, as printed.
static double spencer(double degrees)
{
    return 0.384 * 2.61e6 * exp(-pow(degrees / 0.02, 2)) + 0.478 * 20.91 / pow(degrees + 0.02, 3) +
           0.138 * 72.37 / pow(degrees + 0.02, 2);
}

static double eye_density(const void *ctx, double x, double y)
{
    const double pixel = *(const double *)ctx;
    return spencer(pixel * hypot(x, y)) * pixel * pixel;
}

static void test_eye_is_normalised_as_published(void **state)
{
    (void)state;
    const double unit = pow(M_PI / 180, 2);
    print_message("all of the eye's light: %.4f\n", kernel_eye_beyond(0) * unit);
    assert_true(fabs(kernel_eye_beyond(0) * unit - 1) < 0.03);
    // Its energies by Simpson in log(a): the derivative of `beyond` is -2 pi a f.
    for (double a = 1e-3; a < 80; a *= 1.7) {
        double sum = 0, ratio = pow(1.7, 1.0 / 64);
        for (unsigned i = 0; i <= 64; i++) {
            const double at = a * pow(ratio, i);
            sum += (i == 0 || i == 64 ? 1 : i % 2 ? 4 : 2) * 2 * M_PI * at * at * spencer(at);
        }
        near_to(kernel_eye_beyond(a) - kernel_eye_beyond(1.7 * a), sum * log(ratio) / 3, 1e-6,
                "eye's energy of a ring");
    }
}

static void test_eye_pixels(void **state)
{
    (void)state;
    for (double aspect = 0.5; aspect <= 2; aspect *= 2) {
        struct psf_spec s = spec_of(PSF_EYE);
        const double pixel = 40 / 1080.0, total = kernel_eye_beyond(0);
        struct kernel k = drawn(&s, 110, aspect, 1080);
        pixels_compare("eye", &k, 1 / total, eye_density, &pixel, aspect, 40, 2e-5);
        near_to(sum_within(&k, 1e9), 1, 1e-12, "sum");
        kernel_finish(&k);
    }
}

static double slope_at(const struct kernel *k, int32_t r)
{
    return log(kernel_at(k, r + r / 10, 0) / kernel_at(k, r - r / 10, 0)) /
           log((r + r / 10.0) / (r - r / 10.0));
}

static void test_eye_tail(void **state)
{
    (void)state;
    struct psf_spec s = spec_of(PSF_EYE);
    struct kernel k = drawn(&s, 900, 1, 1800); /* 45 pixels a degree */
    static const int32_t at[] = { 10, 50, 200, 800 };
    double slope[4];
    for (unsigned i = 0; i < 4; i++) {
        const double a = at[i] / 45.0, b = a + at[i] / 10 / 45.0, c = a - at[i] / 10 / 45.0;
        slope[i] = slope_at(&k, at[i]);
        print_message("eye at %.2f degrees falls as r^%.2f\n", a, slope[i]);
        near_to(slope[i], log(spencer(b) / spencer(c)) / log(b / c), 5e-3, "slope");
    }
    // f1 rules near, f2 far; they meet at 1 degree.
    assert_true(slope[0] < -2.5 && slope[0] < slope[1] && slope[1] < slope[2] && slope[2] < slope[3]);
    assert_true(fabs(slope[3] + 2) < 0.06);
    // Round: 25^2 = 7^2 + 24^2 = 15^2 + 20^2.
    for (int32_t m = 4; m <= 32; m *= 2) {
        near_to(kernel_at(&k, 7 * m, -24 * m), kernel_at(&k, 25 * m, 0), 1e-3 / m, "round");
        near_to(kernel_at(&k, -15 * m, 20 * m), kernel_at(&k, 0, 25 * m), 1e-3 / m, "round");
    }
    kernel_finish(&k);
}

/* ---- aperture
 * ------------------------------------------------------------------------------------------- */

static double polygon_density(const void *ctx, double x, double y)
{
    return kernel_polygon_at(ctx, x, y);
}

// F by dividing the polygon into triangles from its middle, and each by midpoints.
static double density_by_midpoints(const struct kernel_polygon *p, double x, double y)
{
    enum { N = 160 };
    double re = 0, im = 0, area = 0;
    for (unsigned j = 0; j < p->corners; j++) {
        const unsigned next = (j + 1) % p->corners;
        const double ax = p->x[j], ay = p->y[j], bx = p->x[next], by = p->y[next],
                     a = (ax * by - ay * bx) / 2;
        for (unsigned s = 0; s < N; s++)
            for (unsigned t = 0; t < N; t++) {
                const double u = (s + 0.5) / N, v = (t + 0.5) / N, w = 2 * a * u / (N * N);
                const double px = u * (ax + v * (bx - ax)), py = u * (ay + v * (by - ay));
                re += w * cos(2 * M_PI * (x * px + y * py));
                im += w * sin(2 * M_PI * (x * px + y * py));
                area += w;
            }
    }
    return (re * re + im * im) / area;
}

static void test_polygon_closed_form(void **state)
{
    (void)state;
    for (unsigned n = 3; n <= 9; n += 2) {
        struct kernel_polygon p;
        kernel_polygon_make(&p, n, 11, 0.9);
        near_to(kernel_polygon_at(&p, 0, 0), p.area, 1e-12, "middle");
        near_to(p.area, M_PI / 4 * 0.81, 1e-12, "area");
        for (unsigned i = 0; i < 24; i++) {
            // Every third on the very line of an edge's normal, where the closed form is 0/0.
            const double turn = (11 + 180.0 / n + 360.0 / n * (i % n)) * M_PI / 180 +
                                (i % 3 ? 0.01 * i : 0),
                         r = 0.004 * pow(1.4, i);
            const double got = kernel_polygon_at(&p, r * cos(turn), r * sin(turn));
            const double wanted = r < 6 ? density_by_midpoints(&p, r * cos(turn), r * sin(turn)) : got;
            if (fabs(got - wanted) > 1e-3 * wanted + 1e-7 * p.area)
                fail_msg("%u corners, r %g, turn %g: %g, wanted %g", n, r, turn, got, wanted);
        }
    }
}

static unsigned spikes_of(const struct kernel *k, int32_t radius)
{
    enum { BINS = 180 };
    double bin[BINS] = { 0 };
    for (int32_t y = -radius; y <= radius; y++)
        for (int32_t x = -radius; x <= radius; x++)
            if (fabs(hypot(x, y) - radius * 0.8) < radius * 0.2)
                bin[(unsigned)(BINS + floor(BINS * (atan2(y, x) / (2 * M_PI)) + 0.5)) % BINS] +=
                    kernel_at(k, x, y);
    double mean = 0;
    for (unsigned i = 0; i < BINS; i++)
        mean += bin[i] / BINS;
    unsigned spikes = 0;
    for (unsigned i = 0; i < BINS; i++)
        spikes +=
            bin[i] > 2 * mean && bin[i] >= bin[(i + 1) % BINS] && bin[i] > bin[(i + BINS - 1) % BINS];
    return spikes;
}

static void test_aperture_spikes(void **state)
{
    (void)state;
    for (unsigned n = 3; n <= 9; n++) {
        struct psf_spec s = spec_of(PSF_APERTURE);
        s.blades = n;
        s.rotation_deg = 17;
        struct kernel k = drawn(&s, 100, 1, 1);
        const unsigned spikes = spikes_of(&k, 100);
        print_message("%u blades: %u spikes; %.2e of the light beyond\n", n, spikes, k.outside);
        assert_int_equal(spikes, n % 2 ? 2 * n : n);
        near_to(sum_within(&k, 1e9), 1, 1e-12, "sum");
        kernel_finish(&k);
    }
}

static void test_aperture_pixels(void **state)
{
    (void)state;
    struct psf_spec s = spec_of(PSF_APERTURE);
    s.rotation_deg = 4;
    struct kernel_polygon p;
    kernel_polygon_make(&p, 6, 4, 5 / (0.55 * 8));
    struct kernel k = drawn(&s, 110, 1, 1);
    double worst_near = 0, worst_far = 0;
    for (int x = -100; x <= 100; x += 8)
        for (int y = 0; y <= 100; y += 7) {
            const double exact = pixel_integral(polygon_density, &p, x, y, 1, 20);
            // A ripple is as large as the mean around it, so compare with that: 1e-5 and 1e-2 of a
            // ripple.
            const double off = fabs(kernel_at(&k, x, y) * (1 - k.outside) - exact) / exact;
            double *worst = abs(x) <= KERNEL_NEAR && y <= KERNEL_NEAR ? &worst_near : &worst_far;
            *worst = fmax(*worst, off);
        }
    print_message("aperture: worst pixel off by %.1e near, %.1e far\n", worst_near, worst_far);
    assert_true(worst_near < 1e-4 && worst_far < 5e-2);
    kernel_finish(&k);
}

static void test_aperture_turns(void **state)
{
    (void)state;
    struct psf_spec s = spec_of(PSF_APERTURE), t = s;
    s.blades = t.blades = 5;
    s.rotation_deg = 10;
    t.rotation_deg = 10 + 72;
    struct kernel a = drawn(&s, 70, 1, 1), b = drawn(&t, 70, 1, 1);
    t.rotation_deg = 100;
    struct kernel c = drawn(&t, 70, 1, 1);
    for (int32_t y = -70; y <= 70; y++)
        for (int32_t x = -70; x <= 70; x++) {
            // From +x towards +y.
            const double v = kernel_at(&a, x, y), floor = 1e-12;
            if (fabs(kernel_at(&b, x, y) - v) > floor || fabs(kernel_at(&c, -y, x) - v) > floor)
                fail_msg("(%d, %d): %g, a fifth on %g, a quarter on %g", x, y, v, kernel_at(&b, x, y),
                         kernel_at(&c, -y, x));
        }
    kernel_finish(&a);
    kernel_finish(&b);
    kernel_finish(&c);
}

static void test_many_blades_are_round(void **state)
{
    (void)state;
    struct psf_spec s = spec_of(PSF_APERTURE), round = spec_of(PSF_AIRY);
    s.blades = 32;
    s.f_number = round.f_number = 16;
    struct kernel a = drawn(&s, 60, 1, 1), b = drawn(&round, 60, 1, 1);
    for (int32_t x = 0; x <= 6; x++)
        near_to(kernel_at(&a, x, x / 2), kernel_at(&b, x, x / 2), 2e-2, "32 blades against none");
    kernel_finish(&a);
    kernel_finish(&b);
}

// Finer than the far pixels are drawn: the energy of rings goes on as 1 / r^2 across the seam.
static void test_aperture_seam(void **state)
{
    (void)state;
    struct psf_spec s = spec_of(PSF_APERTURE);
    s.f_number = 1.8;
    s.rotation_deg = 7;
    struct kernel k = drawn(&s, 100, 1, 1);
    double in = 0, out = 0;
    for (int32_t y = -100; y <= 100; y++)
        for (int32_t x = -100; x <= 100; x++) {
            const int32_t side = abs(x) > abs(y) ? abs(x) : abs(y);
            in += side > 44 && side <= KERNEL_NEAR ? kernel_at(&k, x, y) : 0;
            out += side > KERNEL_NEAR && side <= 100 ? kernel_at(&k, x, y) : 0;
        }
    near_to(out / in, (1 / 64.5 - 1 / 100.5) / (1 / 44.5 - 1 / 64.5), 0.05, "energy beyond the seam");
    kernel_finish(&k);
}

/* ---- image, threads, bad facts
 * ------------------------------------------------------------------------- */

static void test_image(void **state)
{
    (void)state;
    float rgb[4 * 3 * 3];
    for (unsigned i = 0; i < 36; i++)
        rgb[i] = (float)(i * i % 17) + 1;
    struct psf_spec s = spec_of(PSF_IMAGE);
    struct kernel_facts facts = { .psf = &s,
                                  .reach_x = 9,
                                  .reach_y = 9,
                                  .pixel_aspect = 1,
                                  .image = rgb,
                                  .image_width = 4,
                                  .image_height = 3 };
    for (unsigned cut = 0; cut < 2; cut++)
        for (unsigned c = 0; c < 3; c++) {
            struct kernel k;
            struct fault f;
            double total = 0, kept = 0;
            facts.reach_x = cut ? 1 : 9;
            assert_int_equal(kernel_check(&facts, &f), 0);
            assert_int_equal(kernel_draw(&k, &facts, c, crew, &f), 0);
            for (unsigned i = c; i < 36; i += 3)
                total += (double)rgb[i];
            for (int32_t y = 0; y < 3; y++)
                for (int32_t x = 0; x < 4; x++) {
                    const bool in = !cut || x - 2 >= -1;
                    const double wanted = in ? (double)rgb[(y * 4 + x) * 3 + (int32_t)c] / total : 0;
                    assert_true(kernel_at(&k, x - 2, y - 1) == wanted);
                    kept += wanted;
                }
            assert_true(fabs(k.outside - (1 - kept)) < 1e-15 && (cut || k.outside == 0));
            kernel_finish(&k);
        }
}

static void test_threads_draw_the_same(void **state)
{
    (void)state;
    for (int kind = PSF_EYE; kind <= PSF_APERTURE; kind++) {
        const struct psf_spec s = spec_of((enum psf_kind)kind);
        struct kernel first = { 0 };
        const struct kernel_facts facts = {
            .psf = &s, .reach_x = 75, .reach_y = 90, .pixel_aspect = 1, .picture_height = 91
        };
        for (unsigned threads = 1; threads <= 3; threads++) {
            struct crew *c;
            struct kernel k;
            assert_int_equal(crew_create(&c, threads), 0);
            assert_int_equal(kernel_draw(&k, &facts, 0, c, NULL), 0);
            const size_t bytes =
                sizeof(double) * (size_t)(k.max_x - k.min_x + 1) * (size_t)(k.max_y - k.min_y + 1);
            if (threads == 1)
                first = k;
            else
                assert_memory_equal(first.value, k.value, bytes);
            if (threads > 1)
                kernel_finish(&k);
            crew_destroy(c);
        }
        kernel_finish(&first);
    }
}

static void refused(const struct kernel_facts *facts, const char *part)
{
    struct fault f = { 0 };
    assert_int_equal(kernel_check(facts, &f), -1);
    assert_int_equal(f.code, FAULT_PARAM_RANGE);
    assert_string_equal(f.field, "params.psf");
    if (!strstr(f.text, part))
        fail_msg("\"%s\" does not say \"%s\"", f.text, part);
}

static void test_bad_facts_are_refused(void **state)
{
    (void)state;
    float rgb[12] = { 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1 };
    struct psf_spec s = spec_of(PSF_IMAGE);
    struct kernel_facts facts = { .psf = &s,
                                  .reach_x = 4,
                                  .reach_y = 4,
                                  .pixel_aspect = 1,
                                  .picture_height = 5,
                                  .image = rgb,
                                  .image_width = 2,
                                  .image_height = 2 };
    assert_int_equal(kernel_check(&facts, NULL), 0);
    const float bad[] = { NAN, INFINITY, -INFINITY, -1e-30f };
    for (unsigned i = 0; i < 4; i++) {
        rgb[10] = bad[i];
        refused(&facts, "pixel (1, 1), channel G");
    }
    rgb[10] = 1;
    rgb[2] = rgb[5] = rgb[8] = rgb[11] = 0;
    refused(&facts, "channel B: a sum of 0");
    facts.image_width = 0;
    refused(&facts, "0 x 2");
    facts.image_width = UINT32_MAX;
    facts.image_height = UINT32_MAX;
    refused(&facts, "4294967295");
    facts.image = NULL;
    refused(&facts, "no kernel");
    s = spec_of(PSF_EYE);
    s.degrees = NAN;
    refused(&facts, "degrees: nan");
    facts.picture_height = 0;
    s.degrees = 40;
    refused(&facts, "height: 0");
    s = spec_of(PSF_APERTURE);
    s.blades = 2;
    refused(&facts, "blades: 2");
    s.blades = 33;
    refused(&facts, "blades: 33");
    s = spec_of(PSF_AIRY);
    s.wavelength_nm[2] = 0;
    refused(&facts, "wavelength: 0");
    facts.pixel_aspect = NAN;
    refused(&facts, "pixel aspect: nan");
    facts.pixel_aspect = 1;
    facts.reach_x = UINT32_MAX;
    refused(&facts, "columns to reach");
}

static int crew_make(void **state)
{
    (void)state;
    return crew_create(&crew, 2);
}

static int crew_end(void **state)
{
    (void)state;
    crew_destroy(crew);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_points_integrate_polynomials),
        cmocka_unit_test(test_airy_energy_is_bessel),
        cmocka_unit_test(test_airy_rings),
        cmocka_unit_test(test_airy_pixels),
        cmocka_unit_test(test_airy_finer_than_drawn),
        cmocka_unit_test(test_eye_is_normalised_as_published),
        cmocka_unit_test(test_eye_pixels),
        cmocka_unit_test(test_eye_tail),
        cmocka_unit_test(test_polygon_closed_form),
        cmocka_unit_test(test_aperture_spikes),
        cmocka_unit_test(test_aperture_pixels),
        cmocka_unit_test(test_aperture_turns),
        cmocka_unit_test(test_many_blades_are_round),
        cmocka_unit_test(test_aperture_seam),
        cmocka_unit_test(test_image),
        cmocka_unit_test(test_threads_draw_the_same),
        cmocka_unit_test(test_bad_facts_are_refused),
    };
    return cmocka_run_group_tests(tests, crew_make, crew_end);
}
