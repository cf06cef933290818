// SPDX-License-Identifier: Apache-2.0
// test_wall_colour.c - from drive to bytes against the float64 reference: the curve's table at every knot, each factor of the
// chain, the dither's means and periods from the bytes themselves, the current limit over moving pictures.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include <math.h>
#include <time.h>

#include "reference/reference_led.h"
#include "wall_colour_internal.h"

enum { BOARDS = 3, SIDE = 16, TICKS = 256 };

/* A wall of SIDE x SIDE pixels: two boards of half of it each, one board with dark LEDs that repeats the first row. */
struct rig {
    struct wall_def def;
    struct wall_panel panel[2];
    struct wall_board board[BOARDS];
    struct wall_supply supply[1];
    struct wall_layout layout;
    struct wall_board_map map[BOARDS];
    int32_t pixel[BOARDS][SIDE * SIDE];
    uint16_t of_panel[BOARDS][SIDE * SIDE];
    float drive[SIDE * SIDE * 3];
    uint8_t bytes[BOARDS][SIDE * SIDE * 3];
    uint8_t *out[BOARDS];
    struct wall_colour *colour;
};

static uint32_t seed = 1;

static double chance(void)
{
    seed = seed * 1664525 + 1013904223;
    return (seed >> 8) / 16777216.0;
}

static struct rig *rig_new(void)
{
    struct rig *r = calloc(1, sizeof(*r));
    assert_non_null(r);
    r->def = (struct wall_def){ .name = "t", .width = SIDE, .height = SIDE, .rate = 60, .brightness = 1, .gamma = 2.2,
                                .n_panels = 2, .n_boards = BOARDS, .n_supplies = 1, .panel = r->panel, .board = r->board,
                                .supply = r->supply };
    for (unsigned p = 0; p < 2; p++)
        r->panel[p] = (struct wall_panel){ .y = p * SIDE / 2, .width = SIDE, .height = SIDE / 2, .gain = { 1, 1, 1 } };
    for (unsigned b = 0; b < BOARDS; b++) {
        r->board[b] = (struct wall_board){ .width = SIDE, .height = SIDE / 2, .order = { 0, 1, 2 }, .brightness = 1,
                                           .supply = -1 };
        for (uint32_t k = 0; k < SIDE * SIDE / 2; k++) {
            r->pixel[b][k] = b < 2 ? (int32_t)(b * SIDE * SIDE / 2 + k) : k % 3 ? (int32_t)(k / 8) : -1;
            r->of_panel[b][k] = b & 1;
        }
        r->map[b] = (struct wall_board_map){ SIDE * SIDE / 2, r->pixel[b], r->of_panel[b] };
        r->out[b] = r->bytes[b];
    }
    r->layout = (struct wall_layout){ .boards = BOARDS, .board = r->map };
    return r;
}

static void rig_start(struct rig *r)
{
    struct fault f = { 0 };
    wall_colour_destroy(r->colour);
    assert_int_equal(wall_colour_create(&r->colour, &r->def, &r->layout, &f), 0);
}

static void rig_free(struct rig *r)
{
    wall_colour_destroy(r->colour);
    free(r);
}

static void rig_fill(struct rig *r, float v)
{
    for (unsigned i = 0; i < SIDE * SIDE * 3; i++)
        r->drive[i] = v;
}

static void rig_tick(struct rig *r, double fade, uint64_t tick)
{
    memset(r->bytes, 0xa5, sizeof(r->bytes));
    wall_colour_frame(r->colour, r->drive, fade, tick, r->out);
}

/* ---- curve ------------------------------------------------------------------------------------------ */

static const double gammas[] = { 1, 1.8, 2.2, 2.8, 4, 5, 0 /* sRGB */ };
enum { GAMMAS = sizeof(gammas) / sizeof(gammas[0]) };

static struct wall_def curve_of(unsigned i, enum wall_dither dither)
{
    return (struct wall_def){ .transfer = gammas[i] > 0 ? WALL_TRANSFER_GAMMA : WALL_TRANSFER_SRGB, .gamma = gammas[i],
                              .dither = dither };
}

static double wanted_code(const struct wall_def *d, double light)
{
    return d->dither == WALL_DITHER_OFF ? reference_led_code(d, light) : reference_led_dithered(d, light);
}

static double curve_error(const struct wall_def *d, const struct curve *v, float light)
{
    const double e = curve_code(v, light) / 65536.0 - wanted_code(d, (double)light);
    if (!(fabs(e) <= 0.01))
        fail_msg("gamma %g dither %d light %.9g: off by %g code", d->gamma, d->dither, (double)light, e);
    return fabs(e);
}

/* Between a piece's ends and the bytes' own lights table and code are both straight: their difference is largest there. */
static void test_curve_at_every_knot(void **state)
{
    (void)state;
    for (unsigned i = 0; i < 2 * GAMMAS; i++) {
        const struct wall_def d = curve_of(i / 2, i & 1 ? WALL_DITHER_OFF : WALL_DITHER_TEMPORAL);
        struct curve v;
        struct fault f;
        double worst = 0;
        assert_int_equal(curve_make(&v, &d, &f), 0);
        for (uint32_t p = 0; p < v.pieces; p++)
            for (unsigned part = 0; part < 8; part++) {
                const uint32_t bits = (v.first + p) << CURVE_SHIFT | part << (CURVE_SHIFT - 3);
                float light;
                memcpy(&light, &bits, sizeof(light));
                if (light <= 1)
                    worst = fmax(worst, curve_error(&d, &v, light));
            }
        for (unsigned n = 0; n < 256; n++) {
            const float light = (float)reference_led_light(&d, n);
            worst = fmax(worst, curve_error(&d, &v, light));
            worst = fmax(worst, curve_error(&d, &v, nextafterf(light, 0)));
            if (n < 255)
                worst = fmax(worst, curve_error(&d, &v, nextafterf(light, 2)));
        }
        for (unsigned k = 0; k < 20000; k++)
            worst = fmax(worst, curve_error(&d, &v, (float)pow(chance(), 4)));
        assert_int_equal(curve_code(&v, 0), 0);
        assert_int_equal(curve_code(&v, 1), CODE_MOST);
        assert_in_range(curve_code(&v, 1e-40f), 0, 200);
        print_message("gamma %-3g dither %d: %u pieces, at most %.5f code off\n", d.gamma, d.dither, v.pieces, worst);
        curve_free(&v);
    }
}

static void test_transfer_and_lut(void **state)
{
    (void)state;
    for (unsigned i = 0; i < GAMMAS; i++) {
        const struct wall_def d = curve_of(i, WALL_DITHER_OFF);
        uint16_t lut[3 * 257];
        wall_colour_lut(&d, lut);
        for (unsigned n = 0; n < 257; n++) {
            const double light = reference_led_light(&d, n < 256 ? n : 255);
            for (unsigned ch = 0; ch < 3; ch++)
                assert_true(fabs(lut[ch * 257 + n] - 65535 * light) <= 0.5 + 1e-9);
            assert_true(fabs(wall_transfer_light(&d, fmin(n, 255) / 255.0) - light) < 1e-15);
            assert_true(fabs(255 * wall_transfer_code(&d, light) - fmin(n, 255)) < 1e-4);
        }
        assert_int_equal(lut[0], 0);
        assert_int_equal(lut[2 * 257 + 255], 65535);
        assert_true(wall_transfer_light(&d, NAN) == 0 && wall_transfer_light(&d, 7) == 1);
        assert_true(wall_transfer_code(&d, -1) == 0 && wall_transfer_code(&d, INFINITY) == 1);
    }
}

/* ---- chain -------------------------------------------------------------------------------------------- */

/* Every byte of every board is the reference's nearest code (where the table's 0.01 cannot tip it). */
static void expect_nearest(struct rig *r, double fade)
{
    double light[SIDE * SIDE * 3 / 2];
    for (unsigned b = 0; b < BOARDS; b++) {
        const struct wall_board *d = &r->board[b];
        reference_led_board(light, &r->def, &r->layout, b, r->drive, fade, wall_colour_board(r->colour, b).scale);
        for (uint32_t k = 0; k < r->map[b].leds; k++)
            for (unsigned i = 0; i < 3; i++) {
                const double code = reference_led_code(&r->def, light[3 * k + d->order[i]]);
                const double e = fabs(r->bytes[b][3 * k + i] - code);
                if (e > 0.51)
                    fail_msg("board %u led %u byte %u: %u, wanted %.4f", b, k, i, r->bytes[b][3 * k + i], code);
            }
    }
}

static void test_chain_is_the_reference(void **state)
{
    (void)state;
    struct rig *r = rig_new();
    static const unsigned char orders[6][3] = { { 0, 1, 2 }, { 1, 0, 2 }, { 2, 1, 0 }, { 0, 2, 1 }, { 1, 2, 0 }, { 2, 0, 1 } };
    r->def.dither = WALL_DITHER_OFF;
    for (unsigned round = 0; round < 60; round++) {
        r->def.transfer = round & 1 ? WALL_TRANSFER_SRGB : WALL_TRANSFER_GAMMA;
        r->def.gamma = 1 + 3 * chance();
        r->def.brightness = round % 5 ? chance() : 1;
        for (unsigned p = 0; p < 2; p++)
            for (unsigned c = 0; c < 3; c++)
                r->panel[p].gain[c] = (float)chance();
        for (unsigned b = 0; b < BOARDS; b++) {
            r->board[b].brightness = (float)chance();
            memcpy(r->board[b].order, orders[(round + b) % 6], 3);
            r->board[b].supply = round % 3 ? 0 : -1;
            r->board[b].led_amps[b] = 0.02f;
        }
        r->supply[0].amps = 0.5f;
        for (unsigned i = 0; i < SIDE * SIDE * 3; i++)
            r->drive[i] = (float)(pow(chance(), 3) * 1.5 - 0.05);
        r->drive[5] = NAN;
        r->drive[6] = INFINITY;
        r->drive[7] = -INFINITY;
        const double fade = round % 4 ? chance() : 1;
        rig_start(r);
        rig_tick(r, fade, round);
        expect_nearest(r, fade);
    }
    wall_colour_frame(r->colour, NULL, 1, 99, r->out);
    for (unsigned b = 0; b < BOARDS; b++)
        for (unsigned i = 0; i < 3 * r->map[b].leds; i++)
            assert_int_equal(r->bytes[b][i], 0);
    rig_free(r);
}

/* ---- dither ------------------------------------------------------------------------------------------- */

/* The bytes of board 0 for 256 ticks: [tick][leds * 3]. */
static void film(struct rig *r, float light, uint8_t (*byte)[SIDE * SIDE * 3 / 2])
{
    rig_fill(r, light);
    for (unsigned t = 0; t < TICKS; t++) {
        rig_tick(r, 1, 1000 + t);
        memcpy(byte[t], r->bytes[0], sizeof(byte[t]));
    }
}

static void test_bright_leds_have_the_right_mean(void **state)
{
    (void)state;
    struct rig *r = rig_new();
    uint8_t(*byte)[SIDE * SIDE * 3 / 2] = malloc(TICKS * sizeof(*byte));
    double worst = 0, worst_light = 0;
    for (unsigned round = 0; round < 200; round++) {
        r->def.transfer = round & 1 ? WALL_TRANSFER_SRGB : WALL_TRANSFER_GAMMA;
        rig_start(r);
        const double code = 32.02 + 222.98 * chance();
        const float drive = (float)reference_led_light(&r->def, code);
        film(r, drive, byte);
        for (unsigned i = 0; i < SIDE * SIDE * 3 / 2; i++) {
            double sum = 0, light = 0;
            for (unsigned t = 0; t < TICKS; t++) {
                sum += byte[t][i];
                light += reference_led_light(&r->def, byte[t][i]);
            }
            worst = fmax(worst, fabs(sum / TICKS - code));
            worst_light = fmax(worst_light, fabs(light / TICKS / (double)drive - 1));
        }
    }
    print_message("bright: mean code off by at most %.5f, mean light by %.6f of itself\n", worst, worst_light);
    assert_true(worst <= 1 / 64.0);
    assert_true(worst_light <= 0.01 * 2.4 / 32);
    free(byte);
    rig_free(r);
}

/* Mean light of the 4 x 4 pixels from (x, y), over the ticks. */
static double neighbourhood(const struct rig *r, uint8_t (*byte)[SIDE * SIDE * 3 / 2], unsigned x, unsigned y, unsigned c)
{
    double sum = 0;
    for (unsigned t = 0; t < 4; t++)
        for (unsigned j = y; j < y + 4; j++)
            for (unsigned i = x; i < x + 4; i++)
                sum += reference_led_light(&r->def, byte[t][3 * (j * SIDE + i) + c]);
    return sum / 64;
}

static void test_dark_leds_do_not_flicker(void **state)
{
    (void)state;
    struct rig *r = rig_new();
    uint8_t(*byte)[SIDE * SIDE * 3 / 2] = malloc(TICKS * sizeof(*byte));
    double worst = 0;
    unsigned uneven = 0;
    rig_start(r);
    for (unsigned round = 0; round < 300; round++) {
        const double code = 31.9 * pow(chance(), 2);
        const float drive = (float)reference_led_light(&r->def, code);
        film(r, drive, byte);
        // What repeats every 4 ticks has no part slower than rate / 4.
        for (unsigned t = 4; t < TICKS; t++)
            assert_memory_equal(byte[t], byte[t & 3], sizeof(byte[t]));
        const unsigned n = (unsigned)code;
        const double step = reference_led_light(&r->def, n + 1) - reference_led_light(&r->def, n);
        for (unsigned y = 0; y + 4 <= SIDE / 2; y++)
            for (unsigned x = 0; x + 4 <= SIDE; x++)
                for (unsigned c = 0; c < 3; c++)
                    worst = fmax(worst, fabs(neighbourhood(r, byte, x, y, c) - (double)drive) / step);
        // And the 4 x 4 together do not pulse: at each tick as many are up as at any other, give or take one.
        for (unsigned c = 0; c < 3; c++) {
            unsigned low = 16, high = 0;
            for (unsigned t = 0; t < 4; t++) {
                unsigned up = 0;
                for (unsigned k = 0; k < 16; k++)
                    up += byte[t][3 * (k / 4 * SIDE + k % 4) + c] > n;
                low = up < low ? up : low;
                high = up > high ? up : high;
            }
            uneven = high - low > uneven ? high - low : uneven;
        }
    }
    print_message("dark: mean of 4 x 4 off by at most %.5f code; from tick to tick %u LED of 16 more\n", worst, uneven);
    assert_true(worst <= 1 / 128.0 + 0.01);
    assert_in_range(uneven, 0, 1);
    free(byte);
    rig_free(r);
}

/* Mean over all fractions: what 1/64 steps leave is not a bias. */
static void test_dark_is_unbiased(void **state)
{
    (void)state;
    struct rig *r = rig_new();
    rig_start(r);
    double sum = 0;
    enum { STEPS = 640 };
    for (unsigned i = 0; i < STEPS; i++) {
        const double share = (i + 0.5) / STEPS;
        const double low = reference_led_light(&r->def, 7), high = reference_led_light(&r->def, 8);
        rig_fill(r, (float)(low + share * (high - low)));
        for (unsigned t = 0; t < 4; t++) {
            rig_tick(r, 1, t);
            for (unsigned k = 0; k < 16; k++)
                sum += r->bytes[0][3 * (k / 4 * SIDE + k % 4) + 1] - 7 - share;
        }
    }
    assert_true(fabs(sum / (STEPS * 64)) <= 0.002);
    rig_free(r);
}

static void test_black_full_and_same_again(void **state)
{
    (void)state;
    struct rig *r = rig_new(), *s = rig_new();
    rig_start(r);
    rig_start(s);
    for (unsigned t = 0; t < 2 * TICKS; t++) {
        rig_fill(r, 0);
        rig_tick(r, 1, t);
        for (unsigned i = 0; i < SIDE * SIDE * 3 / 2; i++)
            assert_int_equal(r->bytes[0][i], 0);
        rig_fill(r, 1);
        rig_tick(r, 1, t);
        for (unsigned i = 0; i < SIDE * SIDE * 3 / 2; i++)
            assert_int_equal(r->bytes[1][i], 255);
        for (unsigned i = 0; i < SIDE * SIDE * 3; i++)
            r->drive[i] = s->drive[i] = (float)(chance() * chance());
        rig_tick(r, 0.7, t);
        rig_tick(s, 0.7, t);
        assert_memory_equal(r->bytes, s->bytes, sizeof(r->bytes));
    }
    rig_free(r);
    rig_free(s);
}

/* ---- limit -------------------------------------------------------------------------------------------- */

static void rig_power(struct rig *r, float amps)
{
    for (unsigned b = 0; b < 2; b++) {
        const float led[3] = { 0.012f, 0.02f, 0.009f };
        memcpy(r->board[b].led_amps, led, sizeof(led));
        r->board[b].idle_amps = 0.001f;
        r->board[b].supply = 0;
    }
    r->supply[0].amps = amps;
    rig_start(r);
}

static double rig_amps(const struct rig *r)
{
    return reference_led_amps(&r->def, &r->layout, 0, r->bytes[0]) + reference_led_amps(&r->def, &r->layout, 1, r->bytes[1]);
}

static double expect_limit(struct rig *r)
{
    const double amps = rig_amps(r);
    const struct wall_power p = wall_colour_supply(r->colour, 0);
    if (amps > (double)r->supply[0].amps * (1 + 1e-9))
        fail_msg("%.9g A drawn of %.9g", amps, (double)r->supply[0].amps);
    assert_true(fabs(p.amps - amps) <= 1e-6 * amps);
    assert_true(fabs(p.amps - wall_colour_board(r->colour, 0).amps - wall_colour_board(r->colour, 1).amps) <= 1e-9 * amps);
    assert_true(p.scale >= 0 && p.scale <= 1);
    return amps;
}

static void test_limit_always_holds(void **state)
{
    (void)state;
    for (unsigned round = 0; round < 12; round++) {
        struct rig *r = rig_new();
        r->def.dither = round & 1 ? WALL_DITHER_OFF : WALL_DITHER_TEMPORAL;
        r->def.transfer = round & 2 ? WALL_TRANSFER_SRGB : WALL_TRANSFER_GAMMA;
        const double idle = 256 * 0.001;
        rig_power(r, (float)(idle + (round < 10 ? 0.001 + pow(chance(), 2) * 8 : 1e-5)));
        for (unsigned t = 0; t < 300; t++) {
            if (t % 40 == 0 || round == 5)
                for (unsigned i = 0; i < SIDE * SIDE * 3; i++)
                    r->drive[i] = (float)(t / 40 % 3 == 0 ? 1 : t / 40 % 3 == 1 ? chance() : 0.01 * chance());
            rig_tick(r, t % 80 < 60 ? 1 : (79 - t % 80) / 20.0, t);
            expect_limit(r);
        }
        rig_free(r);
    }
}

static void test_limit_attacks_releases_and_rests(void **state)
{
    (void)state;
    struct rig *r = rig_new();
    rig_power(r, 2.0f);
    rig_fill(r, 1);
    rig_tick(r, 1, 0);
    const double full = 256 * (0.001 + 0.041), room = 2.0 - 0.256, first = room / (256 * 0.041);
    struct wall_power p = wall_colour_supply(r->colour, 0);
    assert_true(fabs(p.wanted - full) < 1e-3 && fabs(p.scale - first) < 0.01 * first);
    expect_limit(r);
    // A still picture rests: no byte depends on the limit's own history any more, and what is used is what there is.
    double scale[3] = { 0 };
    for (unsigned t = 1; t < 1200; t++) {
        rig_tick(r, 1, t);
        const double amps = expect_limit(r);
        assert_true(t < 300 || amps > 0.98 * 2.0);
        scale[t / 400] = wall_colour_supply(r->colour, 0).scale;
    }
    assert_true(scale[1] == scale[2]);
    // Fading does not let the limit go: the fade stays straight.
    rig_tick(r, 0.5, 1200);
    assert_true(wall_colour_supply(r->colour, 0).scale == scale[2]);
    assert_true(fabs((rig_amps(r) - 0.256) / (0.5 * room) - 1) < 0.02);
    // Release: towards 1 with 0.5 s.
    const double from = scale[2];
    rig_fill(r, 0.01f);
    for (unsigned n = 1; n <= 60; n++) {
        rig_tick(r, 1, 1200 + n);
        const double wanted = 1 - (1 - from) * exp(-(double)n / 30);
        assert_true(fabs(wall_colour_supply(r->colour, 0).scale - wanted) < 1e-9);
    }
    // Ticks that were left out count as time.
    const double before = wall_colour_supply(r->colour, 0).scale;
    rig_tick(r, 1, 1290);
    assert_true(fabs(wall_colour_supply(r->colour, 0).scale - (1 - (1 - before) * exp(-1))) < 1e-9);
    rig_fill(r, 1);
    rig_tick(r, 1, 1291);
    assert_true(wall_colour_supply(r->colour, 0).scale <= first * (1 + 1e-6));
    rig_free(r);
}

static void test_limit_below_idle_is_black(void **state)
{
    (void)state;
    struct rig *r = rig_new();
    rig_power(r, 0.1f);
    rig_fill(r, 1);
    for (unsigned t = 0; t < 8; t++) {
        rig_tick(r, 1, t);
        for (unsigned i = 0; i < SIDE * SIDE * 3 / 2; i++)
            assert_int_equal(r->bytes[0][i] | r->bytes[1][i], 0);
    }
    assert_true(fabs(wall_colour_supply(r->colour, 0).amps - 0.256) < 1e-6);
    rig_power(r, 0); // unlimited
    rig_tick(r, 1, 0);
    assert_true(wall_colour_supply(r->colour, 0).scale == 1);
    assert_int_equal(r->bytes[0][0], 255);
    rig_free(r);
}

/* ---- cost: printed, never judged --------------------------------------------------------------------- */

static void test_a_large_board(void **state)
{
    (void)state;
    enum { W = 512, H = 256, N = 20 };
    struct rig *r = rig_new();
    struct wall_board_map map = { W * H, malloc(W * H * sizeof(int32_t)), calloc(W * H, sizeof(uint16_t)) };
    float *drive = malloc(W * H * 3 * sizeof(float));
    uint8_t *bytes = malloc(W * H * 3);
    r->def.width = W;
    r->def.height = H;
    r->def.n_boards = 1;
    r->layout = (struct wall_layout){ .boards = 1, .board = &map };
    for (int32_t k = 0; k < W * H; k++)
        map.pixel[k] = k;
    for (size_t i = 0; i < W * H * 3; i++)
        drive[i] = (float)pow(chance(), 3);
    rig_start(r);
    double best = 1e9;
    for (unsigned n = 0; n < N; n++) {
        struct timespec a, b;
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &a);
        wall_colour_frame(r->colour, drive, 1, n, &bytes);
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &b);
        best = fmin(best, (double)(b.tv_sec - a.tv_sec) * 1e3 + (double)(b.tv_nsec - a.tv_nsec) * 1e-6);
        for (size_t i = 0; i < W * H * 3; i += 997) {
            const double code = reference_led_dithered(&r->def, (double)drive[i]);
            assert_true(fabs(bytes[i] - code) < 1.01);
        }
    }
    print_message("512 x 256 pixels: %.2f ms of one core\n", best);
    free(map.pixel);
    free(map.panel);
    free(drive);
    free(bytes);
    rig_free(r);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_curve_at_every_knot),
        cmocka_unit_test(test_transfer_and_lut),
        cmocka_unit_test(test_chain_is_the_reference),
        cmocka_unit_test(test_bright_leds_have_the_right_mean),
        cmocka_unit_test(test_dark_leds_do_not_flicker),
        cmocka_unit_test(test_dark_is_unbiased),
        cmocka_unit_test(test_black_full_and_same_again),
        cmocka_unit_test(test_limit_always_holds),
        cmocka_unit_test(test_limit_attacks_releases_and_rests),
        cmocka_unit_test(test_limit_below_idle_is_black),
        cmocka_unit_test(test_a_large_board),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
