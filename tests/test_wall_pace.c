// SPDX-License-Identifier: Apache-2.0
// test_wall_pace.c - what a wall shows at which tick: the pacer's decisions against a slow model of the words in wall.h, hours of
// them in a moment; patterns through a real layout; and a wall with its thread, several writers and readers, without boards.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include <math.h>
#include <pthread.h>
#include <time.h>

#include "wall_meter.h"
#include "wall_pacer.h"

static const uint64_t second = 1000000000, begin = 5000000000000;
static uint32_t seed = 7;

static uint32_t chance(uint32_t below)
{
    seed = seed * 1664525 + 1013904223;
    return (uint32_t)((uint64_t)seed * below >> 32);
}

/* ---- pacer --------------------------------------------------------------------------------------------- */

static void push(struct pacer *p, uint64_t now, uint64_t present, double exposure)
{
    const int slot = pacer_take(p);
    assert_in_range(slot, 0, PACER_SLOTS - 1);
    pacer_push(p, slot, now, present, exposure);
}

static struct pacer_tick run_on_time(struct pacer *p)
{
    struct pacer_tick t;
    const uint64_t time = pacer_time_ns(p, p->next);
    assert_false(pacer_run(p, time - 1, &t));
    assert_true(pacer_run(p, time, &t));
    assert_int_equal(t.time_ns, time);
    assert_int_equal(p->pictures, p->shown + p->dropped + p->waiting);
    return t;
}

static void test_ticks_stand_on_the_clock(void **state)
{
    (void)state;
    static const double rates[] = { 1, 24, 23.976, 50, 59.94, 60, 120, 240 };
    for (unsigned i = 0; i < sizeof(rates) / sizeof(rates[0]); i++) {
        struct pacer p;
        pacer_init(&p, begin, rates[i], 2, 1);
        for (uint64_t k = 1; k < 100000; k++)
            assert_true(llabs((long long)(pacer_time_ns(&p, k) - begin) - llrintl((long double)k / (long double)rates[i] * 1e9L)) <= 1);
        // Ten years on it has not drifted.
        const uint64_t k = (uint64_t)(rates[i] * 86400 * 3650);
        const long double there = (long double)(pacer_time_ns(&p, k) - begin), wanted = (long double)k / (long double)rates[i] * 1e9L;
        assert_true(fabsl(there - wanted) <= 64);
    }
}

static void test_hold_fade_black_and_back(void **state)
{
    (void)state;
    struct pacer p;
    pacer_init(&p, begin, 60, 2, 1);
    for (unsigned k = 0; k < 100; k++) {
        const struct pacer_tick t = run_on_time(&p);
        assert_true(t.source == WALL_NONE && t.slot == -1 && t.fade == 0);
    }
    for (unsigned round = 0; round < 3; round++) {
        push(&p, pacer_time_ns(&p, p.next) - 5, 0, 1.5);
        double before = 1;
        const unsigned until = round == 1 ? 150 : 1000; // once a picture comes while it fades
        for (unsigned k = 0; k < until; k++) {
            const struct pacer_tick t = run_on_time(&p);
            // 6 ticks are 100 ms, 120 are 2 s, 180 are 3 s.
            const enum wall_source wanted = k <= 6 ? WALL_LIVE : k <= 120 ? WALL_HELD : k < 180 ? WALL_FADING : WALL_BLACK;
            assert_int_equal(t.source, wanted);
            assert_true(t.exposure == 1.5);
            assert_true(fabs(t.fade - (k <= 120 ? 1 : k < 180 ? (180 - k) / 60.0 : 0)) < 1e-6);
            assert_true(t.fade <= before);
            assert_true((t.slot == -1) == (wanted == WALL_BLACK));
            before = t.fade;
        }
    }
    assert_int_equal(p.shown, 3);
    assert_int_equal(p.dropped, 0);
    // Days of black.
    p.next += 60 * 86400 * 3;
    assert_int_equal(run_on_time(&p).source, WALL_BLACK);
}

static void test_short_holds(void **state)
{
    (void)state;
    // A source of 24 a second on a wall of 60 that holds nothing and fades at once: never black while it runs.
    struct pacer p;
    pacer_init(&p, begin, 60, 0, 0);
    unsigned sent = 0;
    for (unsigned k = 0; k < 600; k++) {
        while (sent * second / 24 <= k * second / 60)
            push(&p, begin + sent++ * second / 24, 0, 0);
        assert_int_equal(run_on_time(&p).source, WALL_LIVE);
    }
    for (unsigned k = 0; k < 4; k++)
        run_on_time(&p);
    assert_int_equal(run_on_time(&p).source, WALL_LIVE);
    for (unsigned k = 0; k < 3; k++)
        run_on_time(&p);
    assert_int_equal(run_on_time(&p).source, WALL_BLACK);
    // A slow wall: live for two ticks.
    pacer_init(&p, begin, 2, 0, 0);
    push(&p, begin, 0, 0);
    for (unsigned k = 0; k < 3; k++)
        assert_int_equal(run_on_time(&p).source, WALL_LIVE);
    assert_int_equal(run_on_time(&p).source, WALL_BLACK);
}

static void test_present_times(void **state)
{
    (void)state;
    struct pacer p;
    pacer_init(&p, begin, 100, 2, 1);
    const uint64_t period = second / 100;
    run_on_time(&p);
    // Out of order, for ticks 3, 2, 1 and between 4 and 5.
    push(&p, begin, begin + 3 * period, 3);
    push(&p, begin, begin + 2 * period, 2);
    push(&p, begin, begin + 4 * period + 1, 5);
    push(&p, begin, begin + period, 1);
    for (unsigned k = 1; k <= 5; k++) {
        const struct pacer_tick t = run_on_time(&p);
        assert_true(t.exposure == (k == 4 ? 3 : k));
    }
    assert_int_equal(p.shown, 4);
    // Late: the newest only. A straggler from before what is shown: never.
    const uint64_t now = pacer_time_ns(&p, 5) + 1;
    push(&p, now, now - 3 * period / 10, 7);
    push(&p, now, now - 4 * period / 10, 6);
    assert_int_equal(p.dropped, 1);
    assert_true(run_on_time(&p).exposure == 7);
    push(&p, now + period, now - period, 8);
    assert_true(run_on_time(&p).exposure == 7);
    assert_int_equal(p.dropped, 2);
    // Another source, whose clock is hours behind, is no straggler.
    push(&p, now + 2 * period, 1, 9);
    assert_true(run_on_time(&p).exposure == 9);
    push(&p, now + 3 * period, 2, 10);
    assert_true(run_on_time(&p).exposure == 10);
    // "The next tick" is it also when that is late, with its own time before the picture.
    struct pacer_tick t;
    const uint64_t late = pacer_time_ns(&p, p.next) + period / 2;
    push(&p, late, 0, 11);
    assert_true(pacer_run(&p, late + 1, &t) && t.exposure == 11);
}

static void test_queue_overflows(void **state)
{
    (void)state;
    struct pacer p;
    pacer_init(&p, begin, 60, 2, 1);
    run_on_time(&p);
    for (unsigned i = 0; i < WALL_WAITING_MAX; i++)
        push(&p, begin, begin + (10 + i) * second, i);
    assert_int_equal(p.dropped, 0);
    push(&p, begin, 0, 100); // due ones have their own place
    assert_int_equal(p.dropped, 0);
    push(&p, begin, begin + 9 * second, 101); // the oldest itself
    assert_int_equal(p.dropped, 1);
    assert_int_equal(p.waiting, 17);
    push(&p, begin, begin + 60 * second, 102); // the one of 10 s goes
    assert_int_equal(p.dropped, 2);
    assert_true(run_on_time(&p).exposure == 100);
    p.next = 60 * 10;
    assert_true(run_on_time(&p).exposure == 100);
    p.next = 60 * 11;
    assert_true(run_on_time(&p).exposure == 1);
    p.next = 60 * 60;
    assert_true(run_on_time(&p).exposure == 102);
    assert_int_equal(p.waiting, 0);
    assert_int_equal(p.dropped, 2 + 14);
    assert_int_equal(__builtin_popcount(p.free), PACER_SLOTS - 1);
    // All slots taken: none is left, and one comes back.
    int slot[PACER_SLOTS], n = 0;
    while ((slot[n] = pacer_take(&p)) >= 0)
        n++;
    assert_int_equal(n, PACER_SLOTS - 1);
    pacer_give(&p, slot[0]);
    assert_int_equal(pacer_take(&p), slot[0]);
}

static void test_missed_ticks(void **state)
{
    (void)state;
    struct pacer p;
    struct pacer_tick t;
    pacer_init(&p, begin, 100, 2, 1);
    const uint64_t period = second / 100;
    run_on_time(&p);
    assert_true(pacer_run(&p, begin + 2 * period, &t)); // one period late is not too late
    assert_int_equal(t.tick, 1);
    assert_int_equal(p.ticks_missed, 0);
    assert_true(pacer_run(&p, begin + 2 * period + 1, &t));
    assert_int_equal(t.tick, 2);
    assert_true(pacer_run(&p, begin + 4 * period + 1, &t)); // 3 is more than a period late
    assert_int_equal(t.tick, 4);
    assert_int_equal(p.ticks_missed, 1);
    assert_true(pacer_run(&p, begin + 3600 * second + period / 2, &t));
    assert_int_equal(t.tick, 360000);
    assert_int_equal(p.ticks_missed, 1 + 360000 - 5);
    assert_false(pacer_run(&p, begin + 3600 * second + period / 2, &t));
    for (unsigned i = 0; i < 100000; i++) {
        const uint64_t now = pacer_time_ns(&p, p.next) + chance(100000000), was = p.next, missed = p.ticks_missed;
        assert_true(pacer_run(&p, now, &t));
        assert_true(t.time_ns <= now && now - t.time_ns <= period + 1 && t.tick >= was);
        assert_int_equal(p.ticks_missed - missed, t.tick - was);
    }
    assert_int_equal(p.ticks + p.ticks_missed, p.next);
}

static void test_patterns_stand_before_pictures(void **state)
{
    (void)state;
    struct pacer p;
    pacer_init(&p, begin, 60, 2, 1);
    push(&p, begin, 0, 1);
    run_on_time(&p);
    p.pattern = true;
    for (unsigned k = 0; k < 1000; k++) {
        push(&p, pacer_time_ns(&p, p.next) - 1, 0, 2);
        const struct pacer_tick t = run_on_time(&p);
        assert_true(t.source == WALL_PATTERN && t.slot == -1 && t.fade == 1);
    }
    p.pattern = false;
    const struct pacer_tick t = run_on_time(&p);
    assert_true(t.source == WALL_LIVE && t.exposure == 2);
    assert_int_equal(p.shown, 1);
    assert_int_equal(p.dropped, 1000);
}

/* The words of wall.h, slowly: all pictures that wait, in a heap of no order. */
struct model {
    struct { uint64_t time, number; bool soon; } at[64];
    unsigned count;
    uint64_t shown, dropped, number, current, current_time;
    bool started;
};

static void model_remove(struct model *m, unsigned i)
{
    m->at[i] = m->at[--m->count];
}

static void model_push(struct model *m, uint64_t now, uint64_t present)
{
    m->at[m->count].soon = present == 0;
    m->at[m->count].time = present ? present : now;
    m->at[m->count++].number = m->number++;
    unsigned later = 0, oldest = 0;
    for (unsigned i = 0; i < m->count; i++) {
        if (m->at[i].soon || m->at[i].time <= now)
            continue;
        if (!later++ || m->at[i].time < m->at[oldest].time ||
            (m->at[i].time == m->at[oldest].time && m->at[i].number < m->at[oldest].number))
            oldest = i;
    }
    if (later > WALL_WAITING_MAX) {
        model_remove(m, oldest);
        m->dropped++;
    }
}

static void model_tick(struct model *m, uint64_t time)
{
    int best = -1;
    for (unsigned i = 0; i < m->count; i++)
        if ((m->at[i].soon || m->at[i].time <= time) &&
            (best < 0 || m->at[i].time > m->at[best].time ||
             (m->at[i].time == m->at[best].time && m->at[i].number > m->at[best].number)))
            best = (int)i;
    if (best < 0)
        return;
    const uint64_t t = m->at[best].time, number = m->at[best].number;
    unsigned gone = 0;
    for (unsigned i = m->count; i-- > 0;)
        if (m->at[i].soon || m->at[i].time <= time) {
            model_remove(m, i);
            gone++;
        }
    const bool straggles = m->started && t < m->current_time && m->current_time - t <= second;
    m->dropped += straggles ? gone : gone - 1;
    if (straggles)
        return;
    m->shown++;
    m->started = true;
    m->current = number;
    m->current_time = t;
}

static void test_random_sources(void **state)
{
    (void)state;
    for (unsigned round = 0; round < 60; round++) {
        struct pacer p;
        struct model m = { 0 };
        pacer_init(&p, begin, 60, 3600, 0);
        const uint32_t busy = 1 + chance(8), far = 1 + chance(30);
        for (unsigned k = 0; k < 2000; k++) {
            const uint64_t time = pacer_time_ns(&p, p.next), from = time - second / 60;
            uint64_t now = from;
            for (unsigned n = chance(busy); n > 0; n--) {
                now += chance((uint32_t)(time - now));
                uint64_t present = 0;
                if (chance(3))
                    present = now - second / 10 + chance(far) * second / 60 + chance(2) * chance(1000000);
                if (chance(500) == 0)
                    present = 1 + chance(5);
                push(&p, now, present, (double)m.number);
                model_push(&m, now, present);
            }
            const struct pacer_tick t = run_on_time(&p);
            model_tick(&m, time);
            if (p.shown != m.shown || p.dropped != m.dropped || (m.started && t.exposure != (double)m.current))
                fail_msg("round %u tick %u: picture %g shown %llu dropped %llu, wanted %llu, %llu, %llu", round, k, t.exposure,
                         (unsigned long long)p.shown, (unsigned long long)p.dropped, (unsigned long long)m.current,
                         (unsigned long long)m.shown, (unsigned long long)m.dropped);
            assert_int_equal((unsigned)__builtin_popcount(p.free) + p.waiting + p.started, PACER_SLOTS);
        }
    }
}

/* ---- meters -------------------------------------------------------------------------------------------- */

static void test_meters(void **state)
{
    (void)state;
    struct meter *m = calloc(1, sizeof(*m));
    assert_true(meter_times(m).max == 0);
    for (unsigned i = 0; i < 10000; i++)
        meter_add(m, (double)(i * 7919 % 10000));
    for (unsigned i = 1; i <= METER_VALUES; i++) // the old ones are forgotten
        meter_add(m, (double)(i * 4093 % (METER_VALUES + 1) + 1));
    const struct wall_times t = meter_times(m);
    assert_true(t.max <= METER_VALUES + 1 && t.max >= METER_VALUES && fabs(t.p50 - 2048) <= 2 && fabs(t.p99 - 4056) <= 2);
    free(m);
    struct meter_second s = { 0 };
    double ticks, pictures;
    meter_second_read(&s, begin, &ticks, &pictures);
    assert_true(ticks == 0 && pictures == 0);
    for (unsigned k = 0; k < 2000; k++)
        meter_second_add(&s, begin + k * second / 240, 3 * k);
    meter_second_read(&s, begin + 1999 * second / 240, &ticks, &pictures);
    assert_true(ticks == 240 && pictures == 720);
    meter_second_read(&s, begin + 1999 * second / 240 + 2 * second, &ticks, &pictures);
    assert_true(ticks == 0 && pictures == 0);
}

/* ---- a wall ---------------------------------------------------------------------------------------------- */

/* 12 x 8 pixels: panel 0 8 x 8 serpentine, panel 1 4 x 8 turned by 90 degrees; a Fadecandy each, of 64 x 8 LEDs. */
static struct wall_def *small_wall(void)
{
    struct wall_def *d = calloc(1, sizeof(*d));
    *d = (struct wall_def){ .name = "small", .width = 12, .height = 8, .rate = 200, .hold_s = 2, .fade_s = 1, .brightness = 1,
                            .gamma = 2.2, .dither = WALL_DITHER_OFF, .n_panels = 2, .n_boards = 2, .n_runs = 2 };
    d->panel = calloc(2, sizeof(*d->panel));
    d->board = calloc(2, sizeof(*d->board));
    d->run = calloc(2, sizeof(*d->run));
    d->panel[0] = (struct wall_panel){ .name = "left", .width = 8, .height = 8, .serpentine = true, .gain = { 1, 1, 1 } };
    d->panel[1] = (struct wall_panel){ .name = "right", .x = 8, .width = 8, .height = 4, .rotate = 90, .gain = { 1, 1, 1 } };
    for (unsigned b = 0; b < 2; b++)
        d->board[b] = (struct wall_board){ .name = { (char)('a' + b) }, .serial = { (char)('a' + b) }, .width = 64, .height = 8,
                                           .brightness = 1, .supply = -1, .order = { 1, 2, 0 }, .led_amps = { 1, 1, 1 } };
    d->board[1].delay_ms = 12.5;
    d->run[0] = (struct wall_run){ .panel = 0, .board = 0, .count = 64, .at = 3 };
    d->run[1] = (struct wall_run){ .panel = 1, .board = 1, .count = 32, .at = 64, .reversed = true };
    return d;
}

enum { VALUES = 12 * 8 * 3 };

static void test_pattern_words(void **state)
{
    (void)state;
    enum wall_pattern_kind k;
    static const char *const words[] = { "order", "panels", "red", "green", "blue", "white", "ramp", "checker", "led", "black" };
    for (unsigned i = 0; i < 10; i++) {
        assert_true(wall_pattern_read(&k, words[i]));
        assert_int_equal(k, PATTERN_ORDER + i);
    }
    assert_true(wall_pattern_read(&k, "") && k == PATTERN_NONE);
    assert_false(wall_pattern_read(&k, "Order"));
    assert_false(wall_pattern_read(&k, "reds"));
}

struct drawn { struct wall_def *d; struct wall_layout *l; float v[VALUES]; };

static void draw(struct drawn *s, enum wall_pattern_kind kind, double seconds)
{
    struct fault f = { 0 };
    const struct wall_pattern p = { .kind = kind, .level = 0.5 };
    assert_int_equal(wall_pattern_draw(s->v, s->d, s->l, &p, seconds, &f), 0);
}

static void expect_pixel(const struct drawn *s, unsigned x, unsigned y, double r, double g, double b)
{
    const float *v = &s->v[3 * (y * 12 + x)];
    if (fabs((double)v[0] - r) > 1e-6 || fabs((double)v[1] - g) > 1e-6 || fabs((double)v[2] - b) > 1e-6)
        fail_msg("pixel %u %u: %g %g %g, wanted %g %g %g", x, y, (double)v[0], (double)v[1], (double)v[2], r, g, b);
}

static void test_patterns(void **state)
{
    (void)state;
    struct drawn s = { .d = small_wall() };
    struct fault f = { 0 };
    assert_int_equal(wall_layout_make(&s.l, s.d, &f), 0);
    // In the wiring's order, at 16 LEDs a second: second line of a serpentine backwards, the reversed run from its end.
    for (unsigned k = 0; k < 200; k++) {
        draw(&s, PATTERN_ORDER, (k + 0.5) / 16);
        const unsigned at = k % 64, x = at / 8 & 1 ? 7 - at % 8 : at % 8;
        expect_pixel(&s, x, at / 8, 0.5, 0.5, 0.5);
        if (at > 0) {
            const unsigned b = at - 1;
            expect_pixel(&s, b / 8 & 1 ? 7 - b % 8 : b % 8, b / 8, 0.5 / 16, 0.5 / 16, 0.5 / 16);
        }
        unsigned lit = 0;
        for (unsigned y = 0; y < 8; y++)
            for (unsigned i = 0; i < 8; i++)
                lit += s.v[3 * (y * 12 + i)] > 0;
        assert_int_equal(lit, at + 1);
        uint32_t px, py;
        wall_panel_led(&s.d->panel[1], 31 - k % 32, &px, &py);
        expect_pixel(&s, px, py, 0.5, 0.5, 0.5);
    }
    draw(&s, PATTERN_PANELS, 0);
    expect_pixel(&s, 0, 0, 0.5, 0, 0);
    expect_pixel(&s, 1, 0, 0.5, 0.5, 0.5);
    expect_pixel(&s, 3, 3, 0.5 / 32, 0.5 / 32, 0.5 / 32);
    expect_pixel(&s, 11, 0, 0.5, 0, 0); // turned by 90 degrees its LED 0 is top right
    expect_pixel(&s, 9, 3, 1.0 / 32, 1.0 / 32, 1.0 / 32);
    draw(&s, PATTERN_RAMP, 0);
    for (unsigned x = 0; x < 4; x++) {
        const double v = x / 3.0;
        expect_pixel(&s, 8 + x, 0, v, v, v);
        expect_pixel(&s, 8 + x, 3, v, 0, 0);
        expect_pixel(&s, 8 + x, 4, 0, v, 0);
        expect_pixel(&s, 8 + x, 7, 0, 0, v);
    }
    expect_pixel(&s, 7, 1, 1, 1, 1);
    draw(&s, PATTERN_CHECKER, 0);
    for (unsigned i = 0; i < 96; i++)
        expect_pixel(&s, i % 12, i / 12, (i + i / 12) % 2 * 0.5, (i + i / 12) % 2 * 0.5, (i + i / 12) % 2 * 0.5);
    for (unsigned c = 0; c < 5; c++) {
        draw(&s, c < 4 ? PATTERN_RED + c : PATTERN_BLACK, 0);
        expect_pixel(&s, 5, 5, c == 0 || c == 3 ? 0.5 : 0, c == 1 || c == 3 ? 0.5 : 0, c == 2 || c == 3 ? 0.5 : 0);
    }
    wall_layout_free(s.l);
    wall_def_free(s.d);
}

static void expect_bad(const struct drawn *s, struct wall_pattern p, const char *field, const char *text)
{
    struct fault f = { 0 };
    assert_int_equal(wall_pattern_draw(NULL, s->d, s->l, &p, 0, &f), -1);
    assert_int_equal(f.code, FAULT_PARAM_RANGE);
    assert_string_equal(f.field, field);
    if (!strstr(f.text, text))
        fail_msg("\"%s\" does not say \"%s\"", f.text, text);
}

static void test_bad_patterns(void **state)
{
    (void)state;
    struct drawn s = { .d = small_wall() };
    struct fault f = { 0 };
    assert_int_equal(wall_layout_make(&s.l, s.d, &f), 0);
    expect_bad(&s, (struct wall_pattern){ .kind = PATTERN_LED, .board = 2 }, "board", "the wall has 2");
    expect_bad(&s, (struct wall_pattern){ .kind = PATTERN_LED, .led = 512 }, "led", "board a has 512");
    expect_bad(&s, (struct wall_pattern){ .kind = PATTERN_LED, .led = 2 }, "led", "no panel");
    expect_bad(&s, (struct wall_pattern){ .kind = PATTERN_RED, .level = 1.01 }, "level", "1.01");
    expect_bad(&s, (struct wall_pattern){ .kind = PATTERN_RED, .level = NAN }, "level", "nan");
    expect_bad(&s, (struct wall_pattern){ .kind = (enum wall_pattern_kind)99 }, "pattern", "99");
    const struct wall_pattern led = { .kind = PATTERN_LED, .board = 1, .led = 64 + 31 };
    assert_int_equal(wall_pattern_draw(s.v, s.d, s.l, &led, 0, &f), 0);
    expect_pixel(&s, 11, 0, 0.25, 0.25, 0.25);
    wall_layout_free(s.l);
    wall_def_free(s.d);
}

/* ---- the thread ------------------------------------------------------------------------------------------ */

static void pause_ms(unsigned ms)
{
    nanosleep(&(struct timespec){ .tv_sec = ms / 1000, .tv_nsec = ms % 1000 * 1000000L }, NULL);
}

/* Waits as long as it takes; what is asserted is what there is then. */
static struct wall_stats wait_for_ticks(struct wall *w, uint64_t more)
{
    struct wall_stats s;
    wall_stats(w, &s);
    const uint64_t until = s.ticks + more;
    while (s.ticks < until) {
        pause_ms(2);
        wall_stats(w, &s);
    }
    return s;
}

static unsigned lines;
static void count_line(const char *line)
{
    assert_non_null(strstr(line, "wall small: 2 boards, 96 LEDs, 200 frames a second, "));
    lines++;
}

static uint8_t srgb_of(const struct wall_def *d, double light)
{
    const double sent = lrint(255 * wall_transfer_code(d, light)), shown = wall_transfer_light(d, sent / 255);
    return (uint8_t)lrint(255 * (shown <= 0.0031308 ? 12.92 * shown : 1.055 * pow(shown, 1 / 2.4) - 0.055));
}

static void test_preview_is_what_was_sent(void **state)
{
    (void)state;
    struct wall *w = NULL;
    struct fault f = { 0 };
    float drive[VALUES];
    uint8_t rgb[VALUES];
    lines = 0;
    assert_int_equal(wall_create(&w, small_wall(), NULL, count_line, &f), 0);
    const struct wall_def *d = wall_definition(w);
    struct wall_stats s = wait_for_ticks(w, 3);
    assert_true(s.source == WALL_NONE && s.shown == 0);
    assert_string_equal(wall_source_name(s.source), "none");
    for (unsigned i = 0; i < VALUES; i++)
        drive[i] = (float)i / VALUES;
    wall_show(w, drive, 0, -2.5);
    s = wait_for_ticks(w, 3);
    assert_true(s.pictures == 1 && s.shown == 1 && s.dropped == 0 && s.exposure == -2.5);
    assert_true(s.ticks > 0 && s.late.max >= s.late.p99 && s.late.p99 >= s.late.p50 && s.late.p50 >= 0);
    wall_preview(w, rgb);
    for (unsigned i = 0; i < VALUES; i++)
        assert_in_range(rgb[i] + 1, srgb_of(d, (double)drive[i]), srgb_of(d, (double)drive[i]) + 2);
    struct usb_stats u;
    struct wall_times latency;
    struct wall_power power;
    wall_board_stats(w, 0, &u, &latency, &power);
    assert_true(u.state == USB_ABSENT && power.amps > 10 && power.scale == 1);
    // A pattern stands before it, and goes again.
    const struct wall_pattern red = { .kind = PATTERN_RED, .level = 1 }, bad = { .kind = PATTERN_LED, .board = 9 }, none = { 0 };
    assert_int_equal(wall_pattern(w, &bad, &f), -1);
    assert_int_equal(wall_pattern(w, &red, &f), 0);
    assert_int_equal(wait_for_ticks(w, 3).source, WALL_PATTERN);
    wall_preview(w, rgb);
    for (unsigned i = 0; i < VALUES; i++)
        assert_int_equal(rgb[i], i % 3 ? 0 : 255);
    assert_int_equal(wall_pattern(w, &none, &f), 0);
    wait_for_ticks(w, 3);
    wall_show(w, drive, 0, 0); // a slow machine may have let it fade meanwhile
    s = wait_for_ticks(w, 2);
    wall_preview(w, rgb);
    assert_int_equal(rgb[VALUES - 1], srgb_of(d, (double)drive[VALUES - 1]));
    // All figures add up.
    assert_int_equal(s.pictures, s.shown + s.dropped);
    wall_destroy(w);
    assert_int_equal(lines, 1);
    wall_destroy(NULL);
}

struct pusher { struct wall *w; unsigned n; };

static void *push_many(void *arg)
{
    struct pusher *p = arg;
    float drive[VALUES];
    for (unsigned k = 0; k < 400; k++) {
        for (unsigned i = 0; i < VALUES; i++)
            drive[i] = (float)p->n / 4;
        struct timespec t;
        clock_gettime(CLOCK_MONOTONIC, &t);
        const uint64_t now = (uint64_t)t.tv_sec * second + (uint64_t)t.tv_nsec;
        wall_show(p->w, drive, k % 3 ? now + k % 7 * 3000000 : 0, p->n);
        if (k % 16 == 0)
            pause_ms(3);
        if (k % 100 == 0) {
            const struct wall_pattern x = { .kind = k % 200 ? PATTERN_ORDER : PATTERN_NONE };
            assert_int_equal(wall_pattern(p->w, &x, NULL), 0);
        }
    }
    return NULL;
}

static void *look_often(void *arg)
{
    struct wall *w = arg;
    uint8_t rgb[VALUES];
    for (unsigned k = 0; k < 100; k++) {
        struct wall_stats s;
        struct usb_stats u;
        struct wall_times latency;
        struct wall_power power;
        wall_stats(w, &s);
        wall_preview(w, rgb);
        wall_board_stats(w, 1, &u, &latency, &power);
        pause_ms(1);
    }
    return NULL;
}

static void test_many_writers(void **state)
{
    (void)state;
    struct wall *w = NULL;
    struct fault f = { 0 };
    assert_int_equal(wall_create(&w, small_wall(), NULL, NULL, &f), 0);
    pthread_t thread[6];
    struct pusher p[4];
    for (unsigned i = 0; i < 4; i++) {
        p[i] = (struct pusher){ w, i + 1 };
        assert_int_equal(pthread_create(&thread[i], NULL, push_many, &p[i]), 0);
    }
    for (unsigned i = 4; i < 6; i++)
        assert_int_equal(pthread_create(&thread[i], NULL, look_often, w), 0);
    for (unsigned i = 0; i < 6; i++)
        pthread_join(thread[i], NULL);
    const struct wall_pattern none = { 0 };
    assert_int_equal(wall_pattern(w, &none, &f), 0);
    float drive[VALUES];
    for (unsigned i = 0; i < VALUES; i++)
        drive[i] = 1;
    wait_for_ticks(w, 10); // past the last present time
    wall_show(w, drive, 0, 9);
    const struct wall_stats s = wait_for_ticks(w, 3);
    assert_int_equal(s.pictures, 4 * 400 + 1);
    assert_int_equal(s.pictures, s.shown + s.dropped);
    assert_true(s.exposure == 9);
    uint8_t rgb[VALUES];
    wall_preview(w, rgb);
    for (unsigned i = 0; i < VALUES; i++)
        assert_int_equal(rgb[i], 255);
    print_message("%g ticks a second, late p50 %.3f p99 %.3f max %.3f ms, %llu ticks left out, real time %d\n", s.fps, s.late.p50,
                  s.late.p99, s.late.max, (unsigned long long)s.ticks_missed, s.realtime);
    wall_destroy(w);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_ticks_stand_on_the_clock),
        cmocka_unit_test(test_hold_fade_black_and_back),
        cmocka_unit_test(test_short_holds),
        cmocka_unit_test(test_present_times),
        cmocka_unit_test(test_queue_overflows),
        cmocka_unit_test(test_missed_ticks),
        cmocka_unit_test(test_patterns_stand_before_pictures),
        cmocka_unit_test(test_random_sources),
        cmocka_unit_test(test_meters),
        cmocka_unit_test(test_pattern_words),
        cmocka_unit_test(test_patterns),
        cmocka_unit_test(test_bad_patterns),
        cmocka_unit_test(test_preview_is_what_was_sent),
        cmocka_unit_test(test_many_writers),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
