// SPDX-License-Identifier: Apache-2.0
// test_reference.c - the bright pass and the spread of the reference against closed forms (test_reference_pipeline.c
// has the rest). It is the judge of everything else, so nothing here uses its own parts to check it: expected values are
// worked out anew, in place.
#include <time.h>

#include "by_hand.h"

/* ---- bright pass -----------------------------------------------------------------------------------
 */

static const double rec709[3] = { .2126, .7152, .0722 };
static const char psf_one[] = "gaussians:sigma=2,weight=1";

static void test_curve_values(void **state)
{
    (void)state;
    struct params p = asked("none", 1, .5, psf_one);
    assert_true(bright_y(&p, .25) == .25 && bright_y(&p, 0) == 0);
    p = asked("channel", 1, .5, psf_one);
    assert_true(bright_y(&p, 1) == 0 && bright_y(&p, 3.5) == 2.5 && bright_y(&p, .5) == 0);
    p = asked("luminance", 1, .5, psf_one);
    near_to(bright_y(&p, 4), 3, 1e-15, "luminance");
    assert_true(bright_y(&p, 1) == 0);
    p = asked("knee", 1, .5, psf_one); /* s = L - .5 in .5..1.5, E = s^2/2 */
    assert_true(bright_y(&p, .5) == 0 && bright_y(&p, .4) == 0);
    near_to(bright_y(&p, 1), .125, 1e-15, "knee at T");
    near_to(bright_y(&p, 1.25), .28125, 1e-15, "knee inside");
    near_to(bright_y(&p, 1.5), .5, 1e-15, "knee's end");
    near_to(bright_y(&p, 11), 10, 1e-15, "beyond the knee");
    p = asked("smoothstep", 2, .5, psf_one); /* from 1 to 3 */
    assert_true(bright_y(&p, 1) == 0 && bright_y(&p, 3) == 3 && bright_y(&p, 7) == 7);
    near_to(bright_y(&p, 2), 1, 1e-15, "smoothstep's middle");
    near_to(bright_y(&p, 1.5), 1.5 * .15625, 1e-15, "smoothstep at a quarter");
}

static void test_curve_colour(void **state)
{
    (void)state;
    struct params p = asked("luminance", 1, 0, psf_one);
    double pixel[3] = { 2, 3, .5 }, e[3];
    reference_bright(e, pixel, 3, rec709, &p);
    double L = .2126 * 2 + .7152 * 3 + .0722 * .5;
    for (unsigned c = 0; c < 3; c++)
        near_to(e[c], pixel[c] * (L - 1) / L, 1e-15, "hue is kept");
    /* AP1 (4,0,0) has Y = 1.089 with AP1's weights, .851 with Rec.709's (METHODS). */
    double red[3] = { 4, 0, 0 }, ap1[3] = { .2722287, .6740818, .0536895 };
    reference_bright(e, red, 3, ap1, &p);
    near_to(e[0], 4 * (4 * .2722287 - 1) / (4 * .2722287), 1e-12, "AP1");
    reference_bright(e, red, 3, rec709, &p);
    assert_true(e[0] == 0);
    double odd[3] = { 5, NAN, -2 }; /* NaN and negatives count as 0; the rest of the pixel glows */
    reference_bright(e, odd, 3, rec709, &p);
    near_to(e[0], 5 * (5 * .2126 - 1) / (5 * .2126), 1e-12, "beside a NaN");
    assert_true(e[1] == 0 && e[2] == 0);
    double endless[3] = { INFINITY, -INFINITY, 1e30 };
    p = asked("none", 0, 0, psf_one);
    reference_bright(e, endless, 3, rec709, &p);
    assert_true(e[0] == 0 && e[1] == 0 && e[2] == 1e30);
}

static void test_exposure(void **state)
{
    (void)state;
    static const char *const curves[] = { "channel", "luminance", "knee", "smoothstep" };
    for (unsigned i = 0; i < 4;
         i++) { /* one stop up: half the threshold; E(I, ev 1) = E(2 I, ev 0) / 2 */
        struct params a = asked(curves[i], 3, .75, psf_one), b = a;
        params_set_number(&a, "exposure", 1, NULL);
        for (double v = .01; v < 20; v *= 1.07)
            near_to(bright_y(&a, v), bright_y(&b, 2 * v) / 2, 1e-14, curves[i]);
    }
}

/* E rises with L, makes no jump, is never above I, and ends in 0 at black: for T down to 0. */
static void test_curve_shape(void **state)
{
    (void)state;
    static const char *const curves[] = { "none", "channel", "luminance", "knee", "smoothstep" };
    static const double thresholds[] = { 0, 1e-30, 1e-6, .3, 1, 100, 1e30 };
    for (unsigned i = 0; i < 5; i++)
        for (unsigned t = 0; t < 7; t++) {
            double T = thresholds[t];
            struct params p = asked(curves[i], T, .9, psf_one);
            double before = bright_y(&p, 1e-40 / 1.01);
            assert_true(bright_y(&p, 0) == 0);
            for (double v = 1e-40; v < 3e38; v *= 1.01) {
                double e = bright_y(&p, v);
                if (!(e >= before && e <= v * (1 + 1e-15) && e - before <= 3 * .01 * v))
                    fail_msg("%s T=%g: E(%g) = %g after %g", curves[i], T, v, e, before);
                before = e;
            }
            static const double ends[] = { .1, .9, 1, 1.1, 1.9, 2 };
            for (unsigned k = 0; T > 0 && k < 6;
                 k++) { /* a hair to either side of each end of the knee */
                double at = T * ends[k], low = bright_y(&p, at * (1 - 1e-12)),
                       high = bright_y(&p, at * (1 + 1e-12));
                assert_true(high >= low && high - low <= 1e-10 * at);
            }
        }
    struct params p = asked("knee", 0, .9, psf_one);
    assert_true(bright_y(&p, 1e-30) == 1e-30); /* T = 0 leaves no knee: all glows */
}

/* ---- spread ------------------------------------------------------------------------------------------
 */

static void test_delta(void **state)
{
    (void)state;
    enum { W = 61, H = 47, X = 11, Y = 30 };
    static const double sigmas[] = { .1, .5, 1.8, 4, 20, 300 };
    double *in = calloc(W * H, sizeof(double)), sx, sy;
    in[Y * W + X] = 1e6;
    for (unsigned s = 0; s < 6; s++)
        for (double aspect = .5; aspect <= 2; aspect *= 2) {
            char psf[96];
            snprintf(psf, sizeof(psf), "gaussians:sigma=%g,weight=0.25", sigmas[s]);
            struct params p = asked("none", 0, 0, psf);
            struct reference_frame f = frame_of(in, W, H);
            struct reference_result r;
            f.pixel_aspect = aspect;
            assert_int_equal(reference_bloom(&r, &f, &p), 0);
            sx = sigmas[s] / aspect, sy = sigmas[s];
            double scale = 1e6 * .25 / gaussian_sum(sx) / gaussian_sum(sy);
            for (long y = 0; y < H; y++)
                for (long x = 0; x < W; x++) {
                    double gx = gaussian(x - X, sx), gy = gaussian(y - Y, sy);
                    double wanted = gx < .9e-17 || gy < .9e-17 ? 0 : scale * gx * gy;
                    if (gx > 1.1e-17 && gy > 1.1e-17)
                        near_to(r.glow[0][y * W + x], wanted, 1e-12, psf);
                    else
                        assert_true(r.glow[0][y * W + x] <= 1.2e-17 * scale);
                    near_to(r.out[0][y * W + x], in[y * W + x] + r.glow[0][y * W + x], 1e-15,
                            "composite");
                }
            reference_free(&r);
        }
    free(in);
}

/* Inside a field of I wider than the kernel the glow is the sum of weights times I. */
static void test_flat(void **state)
{
    (void)state;
    enum { N = 257 };
    double *in = malloc(sizeof(double) * N * N);
    for (unsigned i = 0; i < N * N; i++)
        in[i] = 3;
    struct params p = asked("none", 0, 0, "gaussians:sigma=2/8/12,weight=.1/.25/2");
    struct reference_frame f = frame_of(in, N, N);
    struct reference_result r;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    near_to(r.glow[0][128 * N + 128], 3 * 2.35, 1e-14, "the middle");
    near_to(r.glow[0][130 * N + 120], 3 * 2.35, 1e-14, "near the middle");
    /* A corner sees (1 + g0)/2 of the light along each axis. */
    double corner = 0;
    static const double sigma[] = { 2, 8, 12 }, weight[] = { .1, .25, 2 };
    for (unsigned i = 0; i < 3; i++)
        corner += 3 * weight[i] * pow(.5 + .5 / gaussian_sum(sigma[i]), 2);
    near_to(r.glow[0][0], corner, 1e-13, "the corner");
    near_to(r.glow[0][N * N - 1], corner, 1e-13, "the far corner");
    near_to(r.energy_bloomed + r.energy_lost, 2.35 * 3 * N * N, 1e-13, "energy");
    reference_free(&r);
    free(in);
}

static void test_energy(void **state)
{
    (void)state;
    enum { W = 83, H = 40 };
    struct reference_frame f = frame_of(NULL, W, H);
    f.channels = 3;
    f.pixel_aspect = 1.5;
    memcpy(f.luma, rec709, sizeof(rec709));
    double *planes[3], sum = 0;
    for (unsigned c = 0; c < 3; c++) {
        f.plane[c] = planes[c] = random_plane(W * H, 12);
        for (unsigned i = 0; i < W * H; i++)
            sum += planes[c][i];
    }
    struct params p = asked("knee", 1, .5, "gaussians:sigma=1.5/2%/70,weight=.3/.2/.1");
    params_set_number(&p, "intensity", 2.5, NULL);
    struct reference_result r;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    near_to(r.energy_input, sum, 1e-12, "input");
    assert_true(r.energy_bright > 0 && r.energy_bright < sum && r.energy_lost > 0 &&
                r.energy_bloomed > 0);
    near_to(r.energy_bloomed + r.energy_lost, 2.5 * .6 * r.energy_bright, 1e-13,
            "nothing is made, nothing vanishes");
    double added = 0;
    for (unsigned c = 0; c < 3; c++)
        for (unsigned i = 0; i < W * H; i++)
            added += r.out[c][i] - planes[c][i];
    near_to(added, r.energy_bloomed, 1e-10, "what was added");
    reference_free(&r);
    for (unsigned c = 0; c < 3; c++)
        free(planes[c]);
}

/* B(aX + bY) = a B(X) + b B(Y); flips and the transpose of the input flip the output. */
static void test_linear(void **state)
{
    (void)state;
    enum { W = 37, H = 29, N = W * H };
    struct params p = asked("none", 0, 0, "gaussians:sigma=1.2/9,weight=.5/.7");
    double *x = random_plane(N, 20), *y = random_plane(N, 20), *mix = malloc(N * sizeof(double));
    double *flip = malloc(N * sizeof(double)), *turn = malloc(N * sizeof(double));
    for (unsigned i = 0; i < N; i++) {
        mix[i] = 2 * x[i] + .25 * y[i];
        flip[N - 1 - i] = x[i];
        turn[i % W * H + i / W] = x[i];
    }
    struct reference_result rx, ry, rm, rf, rt;
    struct reference_frame fx = frame_of(x, W, H), fy = frame_of(y, W, H), fm = frame_of(mix, W, H);
    struct reference_frame ff = frame_of(flip, W, H), ft = frame_of(turn, H, W);
    assert_int_equal(reference_bloom(&rx, &fx, &p) | reference_bloom(&ry, &fy, &p) |
                         reference_bloom(&rm, &fm, &p) | reference_bloom(&rf, &ff, &p) |
                         reference_bloom(&rt, &ft, &p),
                     0);
    for (unsigned i = 0; i < N; i++) {
        near_to(rm.glow[0][i], 2 * rx.glow[0][i] + .25 * ry.glow[0][i], 1e-13, "linear");
        near_to(rf.glow[0][N - 1 - i], rx.glow[0][i], 1e-13, "flip");
        near_to(rt.glow[0][i % W * H + i / W], rx.glow[0][i], 1e-13, "transpose");
    }
    reference_free(&rx), reference_free(&ry), reference_free(&rm), reference_free(&rf),
        reference_free(&rt);
    free(x), free(y), free(mix), free(flip), free(turn);
}

/* sigma_x = sigma / aspect; per cent of the diagonal in pixel heights: 400 x 300 at aspect 1 is 500. */
static void test_aspect(void **state)
{
    (void)state;
    struct reference_frame f = { .width = 400, .height = 300, .pixel_aspect = 1 };
    struct psf_gaussian pixels = { { 8, SIZE_PIXELS }, 1, { 1, 1, 1 } }, percent = { { 2, SIZE_PERCENT }, 1, { 1, 1, 1 } };
    struct params p = asked("none", 0, 0, psf_one);
    double x, y;
    reference_sigma(&x, &y, &percent, &f, &p);
    near_to(x, 10, 1e-14, "x");
    near_to(y, 10, 1e-14, "y");
    f = (struct reference_frame){ .width = 200, .height = 300, .pixel_aspect = 2 };
    reference_sigma(&x, &y, &percent, &f, &p); /* the same picture */
    near_to(x, 5, 1e-14, "x");
    near_to(y, 10, 1e-14, "y");
    reference_sigma(&x, &y, &pixels, &f, &p);
    assert_true(x == 4 && y == 8);
    /* 1 mm of 36 on 1800 pixels, each twice as wide as high: 50 pixels across, 100 pixel heights. */
    struct psf_gaussian mm = { { 1, SIZE_MM }, 1, { 1, 1, 1 } };
    f.display_width = 1800;
    reference_sigma(&x, &y, &mm, &f, &p);
    near_to(x, 50, 1e-14, "mm, x");
    near_to(y, 100, 1e-14, "mm, y");
    f.display_width = 0;
    p.sensor_mm = 18;
    reference_sigma(&x, &y, &mm, &f, &p);
    near_to(y, 2 * 200 / 18., 1e-14, "mm of the frame itself");
}

static void test_nonfinite(void **state)
{
    (void)state;
    enum { N = 9 };
    double r0[N] = { 0, 0, NAN, 0, 100, 0, -3, INFINITY, -INFINITY }, r1[N] = { 0 }, r2[N] = { 0 };
    r1[2] = 50;
    struct reference_frame f = {
        .width = N, .height = 1, .channels = 3, .plane = { r0, r1, r2 }, .pixel_aspect = 1
    };
    memcpy(f.luma, rec709, sizeof(rec709));
    struct params p = asked("none", 0, 0, "gaussians:sigma=1,weight=1");
    struct reference_result r;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    double g0 = 1 / gaussian_sum(1), g2 = gaussian(2, 1) * g0, g3 = gaussian(3, 1) * g0;
    assert_true(isnan(r.out[0][2]) && r.out[0][7] == INFINITY && r.out[0][8] == -INFINITY);
    near_to(r.out[1][2], 50 + 50 * g0 * g0, 1e-14, "the other channel of that pixel");
    near_to(r.glow[0][2], 100 * g2 * g0, 1e-14, "glow where the NaN is");
    near_to(r.out[0][6], -3 + 100 * g2 * g0, 1e-14, "a negative stays, and spreads nothing");
    near_to(r.energy_input, 147, 1e-14, "input");
    near_to(r.energy_bright, 150, 1e-14, "bright");
    reference_free(&r);
    params_set_text(&p, "nonfinite", "zero", NULL);
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    near_to(r.out[0][2], 100 * g2 * g0, 1e-14, "zero");
    near_to(r.out[0][7], 100 * g3 * g0, 1e-14, "zero");
    reference_free(&r);
    params_set_text(&p, "nonfinite", "reject", NULL);
    assert_int_equal(reference_bloom(&r, &f, &p), -1);
    reference_free(&r);
    r0[2] = r0[7] = r0[8] = 0;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    reference_free(&r);
}

static void test_small(void **state)
{
    (void)state;
    double one = 10;
    static const unsigned sizes[][2] = { { 1, 1 }, { 1, 17 }, { 17, 1 }, { 2, 3 } };
    struct params p = asked("luminance", 1, 0, "gaussians:sigma=64,weight=1");
    for (unsigned i = 0; i < 4; i++) {
        double *in = calloc(sizes[i][0] * sizes[i][1], sizeof(double));
        in[0] = one;
        struct reference_frame f = frame_of(in, sizes[i][0], sizes[i][1]);
        struct reference_result r;
        assert_int_equal(reference_bloom(&r, &f, &p), 0);
        near_to(r.out[0][0], 10 + 9 / pow(gaussian_sum(64), 2), 1e-14, "one pixel");
        near_to(r.energy_bloomed + r.energy_lost, 9, 1e-14, "energy");
        near_to(r.max_bright, 9, 1e-14, "max E");
        reference_free(&r);
        free(in);
    }
}

static void test_speed(void **state)
{
    (void)state;
    enum { N = 512 };
    double *in = random_plane(N * N, 8);
    struct params p = asked("none", 0, 0, "gaussians:sigma=256,weight=1");
    struct reference_frame f = frame_of(in, N, N);
    struct reference_result r;
    clock_t t = clock();
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    print_message("512 x 512, sigma 256, one plane, every pixel lit: %.0f ms\n",
                  1e3 * (double)(clock() - t) / CLOCKS_PER_SEC);
    reference_free(&r);
    free(in);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_curve_values), cmocka_unit_test(test_curve_colour),
        cmocka_unit_test(test_exposure),     cmocka_unit_test(test_curve_shape),
        cmocka_unit_test(test_delta),        cmocka_unit_test(test_flat),
        cmocka_unit_test(test_energy),       cmocka_unit_test(test_linear),
        cmocka_unit_test(test_aspect),       cmocka_unit_test(test_nonfinite),
        cmocka_unit_test(test_small),        cmocka_unit_test(test_speed),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
