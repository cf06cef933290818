// SPDX-License-Identifier: Apache-2.0
// test_reference_pipeline.c - the reference's steps around the spread, and its borders, against numbers worked out by
// hand (reference.h, sections 2, 3, 5 to 8).
#include "by_hand.h"

/* A Gaussian of .1 pixel has one tap: glow = weight * E there and then, so the arithmetic around the spread can
 * be worked out by hand. */
static const char psf_point[] = "gaussians:sigma=0.1,weight=0.5";

static void test_exposure_auto(void **state)
{
    (void)state;
    /* In the middles of their bins: 2^(n + 1/16). What is not a number above 0 is not counted. */
    double half = exp2(1 / 16.), v[14];
    for (unsigned i = 0; i < 10; i++)
        v[i] = half * (i < 1 ? 0x1p-10 : i < 5 ? 1 : i < 8 ? 2 : 512);
    v[10] = 0, v[11] = -3, v[12] = NAN, v[13] = INFINITY;
    struct reference_frame f = frame_of(v, 7, 2);
    struct params p = asked("knee", 1, .5, psf_point);
    p.exposure_auto = true;
    p.meter_dark = 10, p.meter_bright = 20;
    near_to(reference_exposure(&f, &p, NULL), log2(.18 * 7 / (10 * half)), 1e-13, "whole bins");
    p.meter_dark = 25; /* 2.5 of 10: the dark one, and 1.5 of the four */
    near_to(reference_exposure(&f, &p, NULL), log2(.18 * 5.5 / (8.5 * half)), 1e-13, "parts of a bin");
    size_t edges;
    p.key = 1.7;
    near_to(reference_exposure(&f, &p, &edges), log2(1.7 * 5.5 / (8.5 * half)), 1e-13, "key");
    assert_int_equal(edges, 0);
    v[2] = 1, v[3] = 1 - 1e-8, v[4] = 2 * (1 + 1e-5);
    reference_exposure(&f, &p, &edges);
    assert_int_equal(edges, 2);
    p.meter_dark = 60, p.meter_bright = 40;
    assert_true(reference_exposure(&f, &p, NULL) == 0);
    p.meter_dark = p.meter_bright = 0, p.key = .18;
    for (unsigned i = 0; i < 14; i++)
        v[i] = 1e-30;
    near_to(reference_exposure(&f, &p, NULL), log2(.18) + 16 - 1 / 16., 1e-13, "below the lowest bin");
    p.key = 1e6;
    assert_true(reference_exposure(&f, &p, NULL) == 32);
    for (unsigned i = 0; i < 14; i++)
        v[i] = 1e30;
    p.key = 1;
    near_to(reference_exposure(&f, &p, NULL), -16 + 1 / 16., 1e-13, "above the highest bin");
    for (unsigned i = 0; i < 14; i++)
        v[i] = i % 2 ? 0 : NAN;
    assert_true(reference_exposure(&f, &p, NULL) == 0);
    p.exposure_auto = false, p.exposure = -3;
    assert_true(reference_exposure(&f, &p, NULL) == -3);

    /* What is metered is used: L of (1, 2, 4) with weights of 1/4, 1/2, 1/4 is 2.25, in the bin 2^1.125 .. 2^1.25. */
    double r = 1, g = 2, b = 4;
    f = (struct reference_frame){ .width = 1, .height = 1, .channels = 3, .plane = { &r, &g, &b },
                                  .luma = { .25, .5, .25 }, .pixel_aspect = 1 };
    struct reference_result q;
    p.exposure_auto = true, p.key = 1;
    assert_int_equal(reference_bloom(&q, &f, &p), 0);
    near_to(q.exposure, -(1 + 3 / 16.), 1e-13, "metered");
    near_to(q.threshold, exp2(1 + 3 / 16.), 1e-13, "threshold in use");
    near_to(q.knee, .5 * exp2(1 + 3 / 16.), 1e-13, "knee in use");
    reference_free(&q);
}

static void test_stops(void **state)
{
    (void)state;
    struct params p = asked("channel", 3, 0, psf_point); /* 8 at exposure 0, 4 one stop up */
    p.threshold_unit = UNIT_STOPS;
    assert_true(bright_y(&p, 8) == 0 && bright_y(&p, 11) == 3);
    p.exposure = 1;
    assert_true(bright_y(&p, 4) == 0 && bright_y(&p, 11) == 7);
    p.threshold = -2; /* 1/4, 1/8 */
    assert_true(bright_y(&p, 1) == .875);
}

static void test_source_and_matte(void **state)
{
    (void)state;
    double in[4] = { 1, 2, -3, NAN }, source[4] = { 10, -1, 4, 6 }, matte[4] = { .5, 2, 1, .5 };
    struct reference_frame f = frame_of(in, 4, 1);
    struct params p = asked("none", 0, 0, psf_point);
    struct reference_result r;
    f.source[0] = source;
    assert_int_equal(reference_bloom(&r, &f, &p), 0); /* another layer glows */
    assert_true(r.bright[0][0] == 10 && r.bright[0][1] == 0 && r.bright[0][3] == 6);
    near_to(r.out[0][0], 1 + 5, 1e-15, "I + its glow");
    near_to(r.out[0][2], -3 + 2, 1e-15, "a negative of I");
    assert_true(isnan(r.out[0][3]) && r.glow[0][3] == 3);
    near_to(r.energy_input, 0, 1e-15, "of I");
    near_to(r.energy_bright, 20, 1e-15, "of S");
    reference_free(&r);
    f.matte = matte;
    p.emission = 3;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    static const double e[4] = { 15, 0, 12, 9 }, scene[3] = { 1 * 2, 2 * 5, -3 * 3 };
    for (unsigned i = 0; i < 4; i++)
        near_to(r.bright[0][i], e[i], 1e-15, "S * m * emission");
    for (unsigned i = 0; i < 3; i++)
        near_to(r.out[0][i], scene[i] + e[i] / 2, 1e-15, "I'");
    reference_free(&r);
    matte[0] = NAN, matte[1] = -1, matte[2] = INFINITY; /* all count as 0 */
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    for (unsigned i = 0; i < 3; i++)
        assert_true(r.bright[0][i] == 0 && r.out[0][i] == in[i]);
    reference_free(&r);
    f.matte = NULL; /* emission counts for nothing then */
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    assert_true(r.bright[0][0] == 10 && r.scene[0][0] == 1);
    reference_free(&r);
}

static void test_firefly_and_clamp(void **state)
{
    (void)state;
    double in[9] = { 1, 2, 3, 2, 90, 1, 2, 3, 2 };
    struct reference_frame f = frame_of(in, 3, 3);
    struct params p = asked("channel", 1, 0, psf_point);
    struct reference_result r;
    p.firefly = 4; /* the middle's neighbours have a mean of 2: 90 becomes 8; the others see the 90 */
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    near_to(r.bright[0][4], 7, 1e-15, "the firefly");
    near_to(r.bright[0][2], 2, 1e-15, "its neighbour");
    near_to(r.energy_suppressed, 82, 1e-14, "suppressed");
    near_to(r.energy_bright, 7 + 1 + 2 + 1 + 1 + 2 + 1, 1e-14, "bright");
    near_to(r.out[0][4], 90 + 3.5, 1e-15, "the picture keeps its firefly");
    reference_free(&r);
    in[4] = 1;
    p.firefly = .5; /* a corner has 3 neighbours: the mean of 2, 2, 1 is 5/3; an edge 5: of 2 it is (1+1+2+2+3)/5 */
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    p.threshold = 0, p.bright = BRIGHT_NONE;
    struct reference_result q;
    assert_int_equal(reference_bloom(&q, &f, &p), 0);
    near_to(q.bright[0][0], .5 * 5 / 3, 1e-15, "a corner");
    near_to(q.bright[0][3], .5 * 9 / 5, 1e-15, "an edge");
    assert_true(r.bright[0][3] == 0 && r.energy_suppressed > 0);
    reference_free(&r);
    reference_free(&q);
    f.width = f.height = 1; /* no neighbour */
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    assert_true(r.bright[0][0] == 1);
    reference_free(&r);

    double red = 11, green = 22, blue = 44; /* luminance 24.75, E's 23.75 = 24.75 * 95/99 */
    f = (struct reference_frame){ .width = 1, .height = 1, .channels = 3, .plane = { &red, &green, &blue },
                                  .luma = { .25, .5, .25 }, .pixel_aspect = 1 };
    p = asked("luminance", 1, 0, psf_point);
    p.clamp = 4.75;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    near_to(r.bright[1][0], 22 * 95 / 99. / 5, 1e-14, "clamped to a fifth");
    near_to(r.energy_clamped, 77 * 95 / 99. * .8, 1e-14, "taken away");
    near_to(r.energy_bright, 77 * 95 / 99. * .2, 1e-14, "left");
    near_to(r.max_bright, 44 * 95 / 99. / 5, 1e-14, "largest");
    reference_free(&r);
}

static void test_weights(void **state)
{
    (void)state;
    struct reference_frame f = { .width = 10, .height = 10, .channels = 3, .pixel_aspect = 1 };
    struct params p = asked("none", 0, 0, "gaussians:sigma=2/1/4,weight=.1/.2/.3");
    p.near_gain = 2, p.far_gain = 6; /* u = 1/2, 0, 1 */
    p.psf_spec.gaussian[2].tint[0] = 3, p.psf_spec.gaussian[2].tint[1] = .5;
    near_to(reference_weight(&f, &p, 0, 0), .1 * 4, 1e-15, "in the middle");
    near_to(reference_weight(&f, &p, 1, 1), .2 * 2, 1e-15, "near");
    near_to(reference_weight(&f, &p, 2, 0), .3 * 6 * 3, 1e-15, "far, red");
    near_to(reference_weight(&f, &p, 2, 1), .3 * 6 * .5, 1e-15, "far, green");
    f.channels = 1;
    near_to(reference_weight(&f, &p, 2, 0), .3 * 6 * 1.5, 1e-15, "one plane: the mean tint");
    p.psf_spec.count = 1;
    near_to(reference_weight(&f, &p, 0, 0), .1 * 2, 1e-15, "one sigma: near");
    double in = 2;
    f = frame_of(&in, 1, 1);
    p = asked("none", 0, 0, psf_point);
    p.psf_spec.gaussian[0].tint[2] = 4;
    p.near_gain = 10;
    struct reference_result r;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    near_to(r.glow[0][0], 2 * .5 * 2 * 10, 1e-15, "and so it glows");
    near_to(r.energy_bloomed, 20, 1e-15, "and so it counts");
    reference_free(&r);
}

static long inside(long i, long n) { return i < 0 ? 0 : i >= n ? n - 1 : i; }

/* The frame's border goes on for ever: summed over 30 pixels beyond it, where a sigma of 3 has nothing left. */
static void test_fill(void **state)
{
    (void)state;
    enum { REACH = 30, GROW = 4 };
    static const long sizes[][2] = { { 7, 5 }, { 1, 6 }, { 5, 1 }, { 1, 1 }, { 2, 9 } };
    for (unsigned s = 0; s < 5; s++) {
        long w = sizes[s][0], h = sizes[s][1], wide = w + 2 * GROW;
        double *in = random_plane((size_t)(w * h), 8), bloomed = 0;
        struct reference_frame f = frame_of(in, (unsigned)w, (unsigned)h);
        struct params p = asked("none", 0, 0, "gaussians:sigma=3,weight=.7");
        struct reference_result r;
        f.grow = GROW;
        f.pixel_aspect = 2;
        p.edge = EDGE_FILL;
        p.intensity = 2;
        assert_int_equal(reference_bloom(&r, &f, &p), 0);
        assert_true(r.width == wide && r.height == h + 2 * GROW);
        for (long y = -GROW; y < h + GROW; y++)
            for (long x = -GROW; x < w + GROW; x++) {
                double want = 0;
                for (long v = y - REACH; v <= y + REACH; v++)
                    for (long u = x - REACH; u <= x + REACH; u++)
                        want += in[inside(v, h) * w + inside(u, w)] * gaussian(u - x, 1.5) * gaussian(v - y, 3);
                want *= .7 / gaussian_sum(1.5) / gaussian_sum(3);
                bool within = x >= 0 && x < w && y >= 0 && y < h;
                size_t at = (size_t)((y + GROW) * wide + x + GROW);
                near_to(r.glow[0][at], want, 1e-12, "fill");
                near_to(r.out[0][at], 2 * want + (within ? in[y * w + x] : 0), 1e-12, "fill, composited");
                bloomed += within ? 2 * want : 0;
            }
        near_to(r.energy_bloomed, bloomed, 1e-12, "bloomed");
        assert_true(r.energy_lost == 0);
        reference_free(&r);
        free(in);
    }
    /* A wide kernel on a flat field: the field, at its corners and beyond them too. */
    double flat[12];
    for (unsigned i = 0; i < 12; i++)
        flat[i] = 5;
    struct reference_frame f = frame_of(flat, 4, 3);
    struct params p = asked("none", 0, 0, "gaussians:sigma=50,weight=.7");
    struct reference_result r;
    f.grow = GROW;
    p.edge = EDGE_FILL;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    for (unsigned i = 0; i < 12 * 11; i++)
        near_to(r.glow[0][i], 3.5, 1e-13, "flat");
    reference_free(&r);
}

static void test_grow(void **state)
{
    (void)state;
    enum { W = 5, H = 3, GROW = 9, WIDE = W + 2 * GROW };
    double in[W * H] = { 0 };
    in[1 * W + 4] = 8;
    in[2 * W + 0] = -2;
    struct reference_frame f = frame_of(in, W, H);
    struct params p = asked("none", 0, 0, "gaussians:sigma=2,weight=.25");
    struct reference_result r;
    f.grow = GROW;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    for (long y = 0; y < H + 2 * GROW; y++)
        for (long x = 0; x < WIDE; x++) {
            double glow = 2 * gaussian(x - GROW - 4, 2) * gaussian(y - GROW - 1, 2) / pow(gaussian_sum(2), 2);
            double own = x == GROW + 4 && y == GROW + 1 ? 8 : x == GROW && y == GROW + 2 ? -2 : 0;
            near_to(r.out[0][y * WIDE + x], own + glow, 1e-13, "beyond the frame");
        }
    double across = 0, up = 0; /* inside counts the frame as it came */
    for (long x = 0; x < W; x++)
        across += gaussian(x - 4, 2);
    for (long y = 0; y < H; y++)
        up += gaussian(y - 1, 2);
    near_to(r.energy_bloomed, 2 * across * up / pow(gaussian_sum(2), 2), 1e-13, "bloomed");
    near_to(r.energy_bloomed + r.energy_lost, 2, 1e-13, "the rest is lost");
    p.composite = COMPOSITE_MIX; /* beyond the frame E is 0, so mix adds */
    reference_free(&r);
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    near_to(r.out[0][0], r.glow[0][0], 1e-15, "mix, beyond the frame");
    near_to(r.out[0][(GROW + 1) * WIDE + GROW + 4], r.glow[0][(GROW + 1) * WIDE + GROW + 4], 1e-13, "mix");
    reference_free(&r);
}

static void test_dirt(void **state)
{
    (void)state;
    double planes[3][4] = { { 2, 2, 2, 2 }, { 4, 4, 4, 4 }, { 6, 6, 6, 6 } };
    double dirt[2 * 3] = { 0, 0, 1, 1, 4, 1 }; /* two texels: red 0 to 1, green 0 to 4, blue 1 */
    static const double at[4] = { 0, .25, .75, 1 };
    struct reference_frame f = { .width = 4, .height = 1, .channels = 3, .plane = { planes[0], planes[1], planes[2] },
                                 .luma = { .2, .7, .1 }, .pixel_aspect = 1, .dirt = dirt, .dirt_width = 2,
                                 .dirt_height = 1 };
    struct params p = asked("none", 0, 0, psf_point);
    struct reference_result r;
    for (unsigned half = 0; half < 2; half++) {
        p.dirt_gain = half ? .5 : 1;
        assert_int_equal(reference_bloom(&r, &f, &p), 0);
        for (unsigned i = 0; i < 4; i++) {
            near_to(r.glow[0][i], 1 * (1 - p.dirt_gain + p.dirt_gain * at[i]), 1e-15, "red");
            near_to(r.glow[1][i], 2 * (1 - p.dirt_gain + p.dirt_gain * 4 * at[i]), 1e-15, "green");
            near_to(r.glow[2][i], 3, 1e-15, "blue");
        }
        near_to(r.energy_bloomed, 24, 1e-14, "the ledger is before the dirt");
        reference_free(&r);
    }
    f.channels = 1; /* the mean of 0 0 1 is 1/3, of 1 4 1 it is 2; grown to 6, -1/3 .. 4/3 in six steps */
    f.grow = 1;
    p.dirt_gain = 1;
    p.psf_spec.gaussian[0].sigma.value = 100;
    p.edge = EDGE_FILL; /* flat: 1 everywhere */
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    static const double u[6] = { 0, 0, 1 / 3., 2 / 3., 1, 1 };
    for (unsigned i = 0; i < 18; i++)
        near_to(r.glow[0][i], (1 - u[i % 6]) / 3 + u[i % 6] * 2, 1e-13, "one plane, grown");
    reference_free(&r);
    /* Rows of dirt, too: 1 over 3, looked at by 4 rows. */
    double rows[2 * 3] = { 1, 1, 1, 3, 3, 3 };
    f = frame_of(planes[0], 1, 4);
    f.dirt = rows, f.dirt_width = 1, f.dirt_height = 2;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    for (unsigned i = 0; i < 4; i++)
        near_to(r.glow[0][i], 1 + 2 * at[i], 1e-13, "down");
    reference_free(&r);
}

static void test_composites(void **state)
{
    (void)state;
    double in[2] = { 3, -1 }; /* knee of 0: E = 2, 0; B = 1, 0 */
    struct reference_frame f = frame_of(in, 2, 1);
    struct params p = asked("luminance", 1, 0, psf_point);
    struct reference_result r;
    p.intensity = .25;
    static const double want[3] = { 3 + .25, 3 + .25 * (1 - 2), 3 + .25 };
    for (int composite = COMPOSITE_ADD; composite <= COMPOSITE_SCREEN_ADD; composite++) {
        p.composite = composite; /* with no display screen-add is add */
        assert_int_equal(reference_bloom(&r, &f, &p), 0);
        near_to(r.out[0][0], want[composite], 1e-15, "composite");
        assert_true(r.out[0][1] == -1);
        reference_free(&r);
    }
    p.bloom = SWITCH_OFF;
    double matte[2] = { .5, 1 };
    f.matte = matte, p.emission = 5;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    assert_true(r.out[0][0] == 9 && r.out[0][1] == -5 && r.bright[0][0] == 0 && r.glow[0][0] == 0 &&
                r.max_bright == 0 && r.energy_bright == 0 && r.energy_bloomed == 0 && r.energy_input == 2);
    reference_free(&r);
}

static double displayed_y(const struct params *p, double v)
{
    double out[3], scene[3] = { v }, none[3] = { 0 };
    reference_final(out, scene, none, none, 1, NULL, p);
    return out[0];
}

static void test_display(void **state)
{
    (void)state;
    struct params p = asked("none", 0, 0, psf_point);
    assert_true(displayed_y(&p, -3) == -3 && displayed_y(&p, 1e30) == 1e30); /* off by default */
    p.exposure = 1;
    assert_true(displayed_y(&p, 3) == 3);
    p.display = DISPLAY_REINHARD;
    near_to(displayed_y(&p, 1.5), .75, 1e-15, "reinhard");
    assert_true(displayed_y(&p, -3) == 0);
    p.exposure = 0, p.display = DISPLAY_ACES;
    near_to(displayed_y(&p, 1), 2.54 / 3.16, 1e-15, "aces");
    near_to(displayed_y(&p, 2), 10.1 / 11.04, 1e-15, "aces");
    p.display = DISPLAY_NONE, p.encoding = ENCODING_GAMMA22;
    near_to(displayed_y(&p, exp2(2.2)), 2, 1e-14, "gamma");
    p.encoding = ENCODING_SRGB;
    near_to(displayed_y(&p, .5), .7353569830524495, 1e-14, "sRGB");
    near_to(displayed_y(&p, .002), .02584, 1e-14, "sRGB's foot");
    assert_true(displayed_y(&p, -1) == 0);

    static const double luma[3] = { .25, .5, .25 }, scene[3] = { 1, 2, 5 }, bright[3] = { .5, 1, 1.5 },
                        glow[3] = { 2, 4, 6 };
    double out[3];
    p = asked("none", 0, 0, psf_point);
    p.saturation = 0, p.intensity = .5;
    reference_final(out, scene, bright, glow, 3, luma, &p); /* 2, 4, 8: 4.5 */
    assert_true(out[0] == 4.5 && out[1] == 4.5 && out[2] == 4.5);
    p.saturation = 2; /* -0.5 becomes 0 */
    reference_final(out, scene, bright, glow, 3, luma, &p);
    assert_true(out[0] == 0 && out[1] == 3.5 && out[2] == 11.5);
    p.composite = COMPOSITE_MIX; /* 1.75, 3.5, 7.25: 4 */
    reference_final(out, scene, bright, glow, 3, luma, &p);
    assert_true(out[0] == 0 && out[1] == 3 && out[2] == 10.5);
    p.saturation = 1, p.composite = COMPOSITE_SCREEN_ADD, p.display = DISPLAY_REINHARD, p.exposure = 1;
    reference_final(out, scene, bright, glow, 3, luma, &p);
    near_to(out[0], 2 / 3. + 1, 1e-15, "screen-add");
    near_to(out[2], 10 / 11. + 3, 1e-15, "screen-add");
    p.saturation = 0, p.encoding = ENCODING_GAMMA22;
    reference_final(out, scene, bright, glow, 3, luma, &p);
    near_to(out[1], pow(.25 * (2 / 3. + 1) + .5 * (4 / 5. + 2) + .25 * (10 / 11. + 3), 1 / 2.2), 1e-14,
            "screen-add, then saturation, then encoding");

    /* A sample that is no number is handed on; beside it, it counts as 0 + glow. */
    double r0 = NAN, g0 = 2, b0 = 4;
    struct reference_frame f = { .width = 1, .height = 1, .channels = 3, .plane = { &r0, &g0, &b0 },
                                 .luma = { .25, .5, .25 }, .pixel_aspect = 1 };
    p = asked("none", 0, 0, psf_point);
    p.saturation = 0; /* 0, 3, 6 */
    struct reference_result r;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    assert_true(isnan(r.out[0][0]) && r.out[1][0] == 3 && r.out[2][0] == 3);
    reference_free(&r);
    p.nonfinite = NONFINITE_ZERO;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    assert_true(r.out[0][0] == 3);
    reference_free(&r);
}

static void test_views(void **state)
{
    (void)state;
    enum { W = 6, GROW = 2, N = (W + 2 * GROW) * (1 + 2 * GROW) };
    double in[W] = { 5, 0, -2, NAN, 9, 1 }, matte[W] = { 1, 1, .5, 1, .5, 0 }, plane[N], levels[N] = { 0 };
    struct reference_frame f = frame_of(in, W, 1);
    struct params p = asked("luminance", 2, 0, "gaussians:sigma=1/4,weight=.5/.25");
    struct reference_result r;
    f.matte = matte, f.grow = GROW;
    p.emission = 3, p.intensity = 2, p.display = DISPLAY_ACES;
    assert_int_equal(reference_bloom(&r, &f, &p), 0);
    static const double scene[W] = { 15, 0, -4, NAN, 18, 1 }, bright[W] = { 13, 0, 0, 0, 11.5, 0 };
    double *out[3] = { plane };
    const size_t first = GROW * (W + 2 * GROW) + GROW;
    static const enum view views[] = { VIEW_SOURCE, VIEW_BRIGHT, VIEW_RESIDUAL };
    for (unsigned k = 0; k < 3; k++) {
        struct view_spec v = { views[k], 0 };
        assert_int_equal(reference_view(out, &r, &f, &p, &v), 0);
        for (unsigned i = 0; i < W; i++) {
            double want = k == 0 ? scene[i] : k == 1 ? bright[i] : scene[i] - bright[i];
            if (isnan(want))
                assert_true(isnan(plane[first + i]));
            else
                near_to(plane[first + i], want, 1e-15, "view");
        }
        assert_true(plane[0] == 0 && plane[N - 1] == 0);
    }
    for (unsigned level = 0; level < 2; level++) {
        struct view_spec v = { VIEW_LEVEL, level };
        assert_int_equal(reference_view(out, &r, &f, &p, &v), 0);
        double sigma = level ? 4 : 1, g0 = gaussian_sum(sigma);
        for (long x = 0; x < W; x++)
            near_to(plane[first + (size_t)x],
                    2 * (level ? .25 : .5) * (13 * gaussian(x, sigma) + 11.5 * gaussian(x - 4, sigma)) / g0 / g0,
                    1e-13, "level");
        for (unsigned i = 0; i < N; i++)
            levels[i] += plane[i];
    }
    assert_int_equal(reference_view(out, &r, &f, &p, &(struct view_spec){ VIEW_BLOOM, 0 }), 0);
    for (unsigned i = 0; i < N; i++)
        near_to(plane[i], levels[i], 1e-13, "bloom is the sum of the levels");
    assert_int_equal(reference_view(out, &r, &f, &p, &(struct view_spec){ VIEW_LEVEL, 2 }), -1);
    assert_int_equal(reference_view(out, &r, &f, &p, &(struct view_spec){ VIEW_FINAL, 0 }), 0);
    double shown = 15 + levels[first];
    near_to(plane[first], shown * (2.51 * shown + .03) / (shown * (2.43 * shown + .59) + .14), 1e-13, "final");
    reference_free(&r);
    p.psf_spec.kind = PSF_AIRY; /* not the reference's */
    assert_int_equal(reference_bloom(&r, &f, &p), -1);
    reference_free(&r);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_exposure_auto),
        cmocka_unit_test(test_stops),
        cmocka_unit_test(test_source_and_matte),
        cmocka_unit_test(test_firefly_and_clamp),
        cmocka_unit_test(test_weights),
        cmocka_unit_test(test_fill),
        cmocka_unit_test(test_grow),
        cmocka_unit_test(test_dirt),
        cmocka_unit_test(test_composites),
        cmocka_unit_test(test_display),
        cmocka_unit_test(test_views),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
