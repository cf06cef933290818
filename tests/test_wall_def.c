// SPDX-License-Identifier: Apache-2.0
// test_wall_def.c - wall definitions: what good ones mean, what bad ones are told (each mistake with its line and column, and
// what was expected), colour matrices against their formula's properties, and random damage.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "wall_def.h"
#include "wall_layout.h"

static struct wall_mistakes mistakes;

static void print_mistakes(void)
{
    for (unsigned i = 0; i < mistakes.count; i++)
        print_error("  %u:%u: %s\n", mistakes.at[i].line, mistakes.at[i].column, mistakes.at[i].text);
}

static struct wall_def *good(const char *text)
{
    struct fault f = { .code = FAULT_NONE };
    struct wall_def *d = NULL;
    if (wall_def_parse(&d, text, strlen(text), &mistakes, &f) < 0) {
        print_mistakes();
        fail_msg("%s", f.text);
    }
    assert_int_equal(mistakes.count, 0);
    return d;
}

/* The text has exactly these mistakes: "line:column: text", one after the other, until NULL; a text may end early with "*". */
static void bad(const char *text, const char *const expected[])
{
    struct fault f = { .code = FAULT_NONE };
    struct wall_def *const untouched = (struct wall_def *)&mistakes, *d = untouched;
    assert_int_equal(wall_def_parse(&d, text, strlen(text), &mistakes, &f), -1);
    assert_ptr_equal(d, untouched);
    assert_int_equal(f.code, FAULT_WALL);
    assert_string_equal(f.field, "wall");
    unsigned i = 0;
    for (; expected[i]; i++) {
        char found[320] = "(none)";
        if (i < mistakes.count)
            snprintf(found, sizeof(found), "%u:%u: %s", mistakes.at[i].line, mistakes.at[i].column, mistakes.at[i].text);
        const size_t length = strlen(expected[i]);
        const bool open = length && expected[i][length - 1] == '*';
        if (open ? strncmp(found, expected[i], length - 1) != 0 : strcmp(found, expected[i]) != 0) {
            print_mistakes();
            fail_msg("mistake %u is \"%s\", expected \"%s\"", i, found, expected[i]);
        }
    }
    if (i != mistakes.count) {
        print_mistakes();
        fail_msg("%u mistakes, expected %u", mistakes.count, i);
    }
    char first[400];
    snprintf(first, sizeof(first), "line %u: %s", mistakes.at[0].line, mistakes.at[0].text);
    assert_memory_equal(f.text, first, strlen(first) < 200 ? strlen(first) : 200);
}
#define BAD(text, ...) bad(text, (const char *const[]){ __VA_ARGS__, NULL })

/* What every wall needs, for tests of one thing: 3 lines. */
#define SHORT "wall: w\npanels: [{name: p, size: [8, 8]}]\nboards: [{serial: S, panels: p}]\n"

static void test_short_wall(void **state)
{
    (void)state;
    struct wall_def *d = good(SHORT);
    assert_string_equal(d->name, "w");
    assert_int_equal(d->width, 8);
    assert_int_equal(d->height, 8);
    assert_true(d->rate == 60 && d->hold_s == 2 && d->fade_s == 1);
    assert_true(d->window[0] == 0 && d->window[1] == 0 && d->window[2] == 1 && d->window[3] == 1);
    assert_int_equal(d->fit, WALL_FILL);
    assert_false(d->exposure_auto);
    assert_true(d->exposure == 0 && d->saturation == 1 && d->brightness == 1);
    assert_int_equal(d->transfer, WALL_TRANSFER_SRGB);
    assert_int_equal(d->dither, WALL_DITHER_TEMPORAL);
    for (unsigned i = 0; i < 9; i++)
        assert_true(d->matrix[i / 3][i % 3] == (i % 4 == 0));
    assert_int_equal(d->n_panels, 1);
    assert_int_equal(d->n_boards, 1);
    assert_int_equal(d->n_runs, 1);
    assert_string_equal(d->board[0].name, "S");
    assert_int_equal(d->board[0].kind, WALL_FADECANDY);
    assert_int_equal(d->board[0].supply, -1);
    assert_int_equal(d->run[0].count, 64);
    assert_int_equal(mistakes.notes, 0);
    wall_def_free(d);
}

static const char whole[] =
    "wall: stage-left\n"
    "size: [64, 32]\n"
    "rate: 120\n"
    "hold: forever\n"
    "fade: 500 ms\n"
    "picture:\n"
    "  fit: contain\n"
    "  window: [0.25, 0, 0.5, 1]\n"
    "  exposure: auto -1.5\n"
    "  adapt: {up: 2s, down: 250ms}\n"
    "  tone map: aces\n"
    "  saturation: 1.2\n"
    "colour:\n"
    "  transfer: 2.5\n"
    "  matrix: [[0.5, 0, 0], [0, 1, 0], [0, 0.25, 1]]\n"
    "  brightness: 80%\n"
    "  dither: off\n"
    "  calibration: gains.exr\n"
    "panels:\n"
    "- {name: left, at: [0, 0], size: [16, 32], flip: both, wiring: {run: columns, serpentine: true, origin: bottom-right}, gain: [1, 0.5, 0.25]}\n"
    "- {name: right, at: [16, 4], size: [8, 16], rotate: 270, gain: 0.5}\n"
    "supplies:\n"
    "- {name: psu1, amps: 20}\n"
    "boards:\n"
    "- serial: AAAAAAAAAAAAAAAA\n"
    "  name: one\n"
    "  order: GRB\n"
    "  brightness: 0.5\n"
    "  supply: psu1\n"
    "  amps per led: {red: 0.01, green: 0.011, blue: 0.012, idle: 0.0005}\n"
    "  delay: 5ms\n"
    "  panels: left\n"
    "- serial: \"0001\"\n"
    "  kind: gud\n"
    "  size: [8, 16]\n"
    "  amps per led: 0.06\n"
    "  panels: [right]\n";

static void test_whole_wall(void **state)
{
    (void)state;
    struct wall_def *d = good(whole);
    assert_int_equal(d->width, 64);
    assert_int_equal(d->height, 32);
    assert_true(d->rate == 120 && isinf(d->hold_s) && d->fade_s == 0.5);
    assert_int_equal(d->fit, WALL_CONTAIN);
    assert_true(d->window[0] == 0.25 && d->window[2] == 0.5);
    assert_true(d->exposure_auto && d->exposure == -1.5 && d->adapt_up_s == 2 && d->adapt_down_s == 0.25);
    assert_int_equal(d->tone_map, WALL_TONE_ACES);
    assert_true(d->saturation == 1.2 && d->brightness == 0.8 && d->gamma == 2.5);
    assert_int_equal(d->transfer, WALL_TRANSFER_GAMMA);
    assert_int_equal(d->dither, WALL_DITHER_OFF);
    assert_true(d->matrix[0][0] == 0.5 && d->matrix[2][1] == 0.25 && d->matrix[1][1] == 1);
    assert_string_equal(d->calibration, "gains.exr");
    const struct wall_panel *p = d->panel;
    assert_true(p->flip_x && p->flip_y && p->columns && p->serpentine && p->origin == WALL_BOTTOM_RIGHT && p->line == 20);
    assert_true(p->gain[0] == 1 && p->gain[1] == 0.5f && p->gain[2] == 0.25f);
    assert_true(p[1].rotate == 270 && p[1].gain[2] == 0.5f && p[1].x == 16 && p[1].y == 4);
    const struct wall_board *b = d->board;
    assert_string_equal(b->name, "one");
    assert_true(b->order[0] == 1 && b->order[1] == 0 && b->order[2] == 2);
    assert_true(b->brightness == 0.5f && b->supply == 0 && b->delay_ms == 5);
    assert_true(b->led_amps[0] == 0.01f && b->led_amps[2] == 0.012f && b->idle_amps == 0.0005f);
    assert_string_equal(b[1].serial, "0001");
    assert_true(b[1].kind == WALL_GUD && b[1].width == 8 && b[1].height == 16 && b[1].led_amps[1] == (float)(0.06 / 3));
    assert_true(d->supply[0].amps == 20);
    assert_int_equal(d->n_runs, 1 + 16);
    assert_int_equal(mistakes.notes, 0);
    wall_def_free(d);
}

/* ---- mistakes ------------------------------------------------------------------------------------------------------ */

static void test_keys(void **state)
{
    (void)state;
    BAD(SHORT "rates: 60\n", "4:1: rates: unknown key; did you mean \"rate\"?");
    BAD(SHORT "color: {}\n", "4:1: color: unknown key; did you mean \"colour\"?");
    BAD(SHORT "picture: {tone_map: aces}\n", "4:11: picture.tone_map: unknown key; did you mean \"tone map\"?");
    BAD(SHORT "xylophone: 60\n", "4:1: xylophone: unknown key; expected one of: wall, size, rate, hold, fade, picture, colour, panels, *");
    BAD(SHORT "rate: 60\nrate: 61\n", "5:7: rate: said twice (first in line 4); expected once");
    BAD("wall: w\n", "1:1: the wall has no panels; expected \"panels:\" and a list");
    BAD("", "1:1: the definition is empty; expected \"wall: NAME\" and what it is made of");
    BAD("[]", "1:1: a list of 0; expected keys with values, such as \"wall: ...\"");
    BAD("wall: w\npanels: []\nboards: x\n", "2:9: panels: a list of 0; expected a list of panels, each on a line that begins with \"- \"",
        "3:9: boards: \"x\"; expected a list of boards, each on a line that begins with \"- \"");
    BAD("panels: [{size: [1, 1]}]\nboards: [{serial: S, panels: panel-1}]\n", "1:1: the wall has no name; expected \"wall: NAME\"");
}

static void test_values(void **state)
{
    (void)state;
    static const struct { const char *text, *mistake; } cases[] = {
        { "rate: 0\n", "4:7: rate: \"0\"; expected frames per second, 1 to 240" },
        { "rate: 241\n", "4:7: rate: \"241\"; expected frames per second, 1 to 240" },
        { "rate: 500\n", "4:7: rate: \"500\"; *" },
        { "rate: nan\n", "4:7: rate: \"nan\"; *" },
        { "rate: .inf\n", "4:7: rate: \".inf\"; *" },
        { "rate: 1e999\n", "4:7: rate: \"1e999\"; *" },
        { "rate: 0x20\n", "4:7: rate: \"0x20\"; *" },
        { "rate: 6 0\n", "4:7: rate: \"6 0\"; *" },
        { "rate: 60fps\n", "4:7: rate: \"60fps\"; *" },
        { "rate:\n", "4:1: rate: nothing; *" },
        { "rate: [60]\n", "4:7: rate: a list of 1; *" },
        { "hold: 2\n", "4:7: hold: \"2\"; expected a time such as 2s or 500ms, 0 to 3600 s, or forever" },
        { "hold: -1s\n", "4:7: hold: \"-1s\"; *" },
        { "hold: 2 hours\n", "4:7: hold: \"2 hours\"; *" },
        { "fade: forever\n", "4:7: fade: \"forever\"; expected a time such as 2s or 500ms, 0 to 3600 s" },
        { "fade: 61min\n", "4:7: fade: \"61min\"; *" },
        { "size: [8]\n", "4:7: size: a list of 1; expected 2 numbers in brackets: *" },
        { "size: [8, 8.5]\n", "4:11: size[1]: \"8.5\"; expected the wall's width and height in pixels, a whole number 1 to 4096" },
        { "size: [8, 4097]\n", "4:11: size[1]: \"4097\"; *" },
        { "size: [4096, 4096]\n", "4:7: size: 4096 x 4096 are 16777216 pixels; expected at most 1048576" },
        { "size: [8, 7]\n", "2:10: panels[0]: panel p reaches from 0, 0 to 8, 8; expected inside the wall's 8 x 7" },
        { "picture: {fit: full}\n", "4:16: picture.fit: \"full\"; expected one of: fill contain stretch" },
        { "picture: {window: [0.5, 0, 0.6, 1]}\n", "4:19: picture.window: 0.5, 0, 0.6, 1; expected a part of the picture: *" },
        { "picture: {window: [0, 0, 0, 1]}\n", "4:19: picture.window: 0, 0, 0, 1; *" },
        { "picture: {exposure: automatic}\n", "4:21: picture.exposure: \"automatic\"; expected stops, *" },
        { "picture: {exposure: auto 1}\n", "4:21: picture.exposure: \"auto 1\"; *" },
        { "picture: {exposure: 33}\n", "4:21: picture.exposure: \"33\"; *" },
        { "picture: {adapt: {up: 1s}}\n", "4:18: picture.adapt: the exposure is fixed; *" },
        { "picture: {saturation: -1}\n", "4:23: picture.saturation: \"-1\"; expected a factor, 0 to 4" },
        { "colour: {transfer: 0.5}\n", "4:20: colour.transfer: \"0.5\"; expected srgb, or a gamma of 1 to 4 (1: linear)" },
        { "colour: {brightness: 101%}\n", "4:22: colour.brightness: \"101%\"; expected a share of the light, 0 to 1 or 0% to 100%" },
        { "colour: {brightness: '%'}\n", "4:22: colour.brightness: \"%\"; *" },
        { "colour: {dither: on}\n", "4:18: colour.dither: \"on\"; expected one of: temporal off" },
        { "colour: {matrix: [[1, 0, 0], [0, 1, 0]]}\n", "4:18: colour.matrix: a list of 2; expected three rows *" },
        { "colour: {matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 9]]}\n", "4:48: colour.matrix[2][2]: \"9\"; expected a row of the matrix, -8 to 8" },
        { "colour: {white: D66}\n", "4:17: colour.white: \"D66\"; expected a white: *" },
        { "colour: {white: [0.3, 0]}\n", "4:17: colour.white: x 0.3, y 0; expected a chromaticity: *" },
        { "colour: {white: [0.7, 0.29]}\n", "4:9: colour: white 0.7, 0.29 is not inside the triangle of the primaries; *" },
        { "colour: {primaries: {red: [0.6, 0.3], green: [0.3, 0.6]}}\n", "4:21: colour.primaries: blue is not said; *" },
        { "colour: {calibration: ''}\n", "4:23: colour.calibration: nothing; expected the name of an EXR file, 1 to 255 bytes of text on one line" },
        { "supplies: [{name: a}]\n", "4:12: supplies[0]: the supply has no limit; expected \"amps: ...\"" },
        { "supplies: [{amps: 1}]\n", "4:12: supplies[0]: the supply has no name; *" },
        { "supplies: [{name: a, amps: 0}]\n", "4:28: supplies[0].amps: \"0\"; expected amps, 0.1 to 10000" },
        { "supplies: [{name: a, amps: 1}, {name: a, amps: 2}]\n", "4:32: supplies[1]: two supplies are named \"a\" (the other in line 4); *" },
    };
    for (unsigned i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        char text[512];
        snprintf(text, sizeof(text), SHORT "%s", cases[i].text);
        BAD(text, cases[i].mistake);
    }
}

#define TOP "wall: w\nsize: [16, 16]\n"
#define BOARD "boards: [{serial: S, panels: p}]\n"
#define PANEL "panels: [{name: p, size: [8, 8]}, {name: q, at: [8, 0], size: [8, 8]}]\n"

static void test_panels(void **state)
{
    (void)state;
    static const struct { const char *panel, *mistake; } cases[] = {
        { "{name: p}", "3:10: panels[0]: panel p has no size; expected \"size: [LEDs across, LEDs down]\"" },
        { "{name: p, size: [8, 8], rotate: 45}", "3:42: panels[0].rotate: \"45\"; expected one of: 0 90 180 270" },
        { "{name: p, size: [8, 8], flip: x}", "3:40: panels[0].flip: \"x\"; expected one of: none horizontal vertical both" },
        { "{name: p, size: [8, 8], wiring: {origin: left}}", "3:51: panels[0].wiring.origin: \"left\"; expected one of: top-left *" },
        { "{name: p, size: [8, 8], wiring: {serpentine: maybe}}", "3:55: panels[0].wiring.serpentine: \"maybe\"; expected one of: false true no yes" },
        { "{name: p, size: [8, 8], gain: [1, 1, 1.5]}", "3:47: panels[0].gain[2]: \"1.5\"; expected gains of R, G, B, 0 to 1" },
        { "{name: p, size: [8, 8], at: [-1, 0]}", "3:39: panels[0].at[0]: \"-1\"; *" },
        { "{name: p, size: [8, 8], at: [9, 0]}", "3:10: panels[0]: panel p reaches from 9, 0 to 17, 8; expected inside the wall's 16 x 16" },
        { "{name: p, size: [8, 8], gap: [1, 1]}", "3:39: panels[0].gap: there is no grid; expected \"grid: [across, down]\" beside it" },
        { "{name: p, size: [8, 8]}, {name: q, at: [7, 7], size: [2, 2]}",
          "3:35: panels[1]: panel q lies on panel p (line 3) at wall pixel 7, 7; expected each pixel in one panel" },
        { "{name: p, size: [8, 8]}, {name: p, at: [8, 0], size: [2, 2]}", "3:35: panels[1]: two panels are named \"p\" (the other in line 3); *" },
        { "{name: p, size: [8, 8], grid: [2, 3]}", "3:10: panels[0]: panel p-5 reaches from 0, 16 to 8, 24; *" },
        { "{name: p, size: [1, 1], grid: [33, 32]}", "3:40: panels[0].grid: 1056 more panels; expected at most 1024 in all" },
        { "{name: p, size: [8, 8], grid: [0, 1]}", "3:41: panels[0].grid[0]: \"0\"; expected panels across and down, a whole number 1 to 1024" },
        { "{name: \"a\\tb\", size: [8, 8]}, {name: p, at: [8, 0], size: [8, 8]}", "3:17: panels[0].name: \"a?b\"; expected a name, *" },
    };
    for (unsigned i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        char text[512];
        snprintf(text, sizeof(text), TOP "panels: [%s]\n" BOARD, cases[i].panel);
        BAD(text, cases[i].mistake);
    }
    BAD("wall: w\npanels: [{name: p, size: [8, 8]}, {name: q, at: [4000, 4000], size: [8, 8]}]\n" BOARD,
        "1:1: the panels reach to 4008 x 4008, 16064064 pixels; expected at most 1048576");
}

static void test_boards(void **state)
{
    (void)state;
    static const struct { const char *board, *mistake; } cases[] = {
        { "{panels: p}", "4:10: boards[0]: the board has no serial; *" },
        { "{serial: S}", "4:10: boards[0]: the board shows nothing; expected one of *" },
        { "{serial: S, panels: p, leds: []}", "4:10: boards[0]: panels and leds; *" },
        { "{serial: S, order: RGX, panels: p}", "4:29: boards[0].order: \"RGX\"; expected each of R, G, B once, such as GRB" },
        { "{serial: S, order: RGG, panels: p}", "4:29: boards[0].order: \"RGG\"; *" },
        { "{serial: S, order: RG, panels: p}", "4:29: boards[0].order: \"RG\"; *" },
        { "{serial: S, order: RGBB, panels: p}", "4:29: boards[0].order: \"RGBB\"; *" },
        { "{serial: S, kind: fadecandies, panels: p}", "4:28: boards[0].kind: \"fadecandies\"; expected one of: fadecandy gud" },
        { "{serial: S, size: [8, 8], panels: p}", "4:28: boards[0].size: a fadecandy has 8 strips of 64 LEDs; expected no size" },
        { "{serial: S, kind: gud, panels: p}", "4:10: boards[0]: the display has no size; *" },
        { "{serial: S, kind: gud, size: [8, 7], panels: p}", "4:55: boards[0].panels: panel p of 8 x 8 at 0, 0; expected inside the display's 8 x 7" },
        { "{serial: S, supply: x, panels: p}", "4:30: boards[0].supply: \"x\"; expected the name of one of the 0 supplies *" },
        { "{serial: S, delay: 200ms, panels: p}", "4:29: boards[0].delay: \"200ms\"; expected a time such as 2s or 500ms, 0 to 0.1 s" },
        { "{serial: S, panels: r}", "4:30: boards[0].panels: \"r\"; expected the name of a panel or grid, or \"NAME to NAME\"" },
        { "{serial: S, panels: [q to p]}", "4:31: boards[0].panels[0]: \"q to p\" goes backwards; *" },
        { "{serial: S, panels: [p, q, p]}", "4:37: boards[0].panels[2]: LED 0 of panel p is driven already by board S (line 4); *" },
        { "{serial: S, leds: [{panel: p, strip: 8}]}", "4:47: boards[0].leds[0].strip: \"8\"; expected a strip of the board, a whole number 0 to 7" },
        { "{serial: S, leds: [{panel: p, strip: 0, at: 64}]}", "4:54: boards[0].leds[0].at: \"64\"; expected an LED of the strip, *" },
        { "{serial: S, leds: [{panel: p, at: 449}]}", "4:29: boards[0].leds[0]: panel p goes on LEDs 449 to 512 of board S, which has LEDs 0 to 511; *" },
        { "{serial: S, leds: [{panel: p, first: 60, count: 5}]}", "4:58: boards[0].leds[0].count: \"5\"; expected how many LEDs of the panel, *" },
        { "{serial: S, leds: [{panel: p, first: 64}]}", "4:47: boards[0].leds[0].first: \"64\"; *" },
        { "{serial: S, leds: [{panel: p, corner: [0, 0]}]}", "4:48: boards[0].leds[0].corner: the board is no display; *" },
        { "{serial: S, leds: [{panels: [p, q], count: 5}]}", "4:53: boards[0].leds[0].count: goes with one \"panel:\"*" },
        { "{serial: S, leds: [{at: 3}]}", "4:29: boards[0].leds[0]: no panel; *" },
        { "{serial: S, leds: [{panel: p}, {panel: q, at: 63}]}",
          "4:41: boards[0].leds[1]: LED 63 of board S shows panel p already (line 4); expected one panel LED each" },
        { "{serial: S, leds: [{panel: p, at: 100}, {panel: q, first: 5, count: 2, at: 110}]}",
          "4:50: boards[0].leds[1]: LED 110 of board S shows panel p already (line 4); *" },
        { "{serial: S, panels: p}, {serial: S, name: T, panels: q}", "4:34: boards[1]: serial \"S\" is also that of the board in line 4; *" },
        { "{serial: S, panels: p}, {serial: T, name: S, panels: q}", "4:34: boards[1]: two boards are named \"S\" (the other in line 4); *" },
        { "{serial: S, kind: gud, size: [4096, 4096], panels: p}", "4:10: boards[0]: the boards have 16777216 LEDs in all; expected at most 1048576" },
    };
    for (unsigned i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        char text[512];
        snprintf(text, sizeof(text), TOP PANEL "boards: [%s]\n", cases[i].board);
        BAD(text, cases[i].mistake);
    }
    // A display's two rectangles collide in many rows, and that is one mistake. A wiring makes no sense on a display.
    BAD(TOP PANEL "boards: [{serial: S, kind: gud, size: [16, 16], leds: [{panel: p}, {panel: q, corner: [7, 0]}]}]\n",
        "4:68: boards[0].leds[1]: LED 7 of board S shows panel p already (line 4); *");
    BAD(TOP "panels: [{name: p, size: [8, 8], wiring: {serpentine: yes}}]\nboards: [{serial: S, kind: gud, size: [8, 8], panels: p}]\n",
        "4:55: boards[0].panels: panel p has a wiring, and board S is a display; *");
}

static void test_all_at_once(void **state)
{
    (void)state;
    BAD("wall: w\n"
        "rate: fast\n"
        "panels:\n"
        "- {name: p, size: [8, 8]}\n"
        "- {name: q, size: [0, 8]}\n"
        "boards:\n"
        "- serial: S\n"
        "  oder: GRB\n"
        "  panels: [p, q, r]\n",
        "2:7: rate: \"fast\"; *", "5:20: panels[1].size[0]: \"0\"; *", "8:3: boards[0].oder: unknown key; did you mean \"order\"?");
    // More than can be told: the first ones are.
    static char many[8192];
    size_t used = (size_t)snprintf(many, sizeof(many), "wall: w\npanels:\n");
    for (unsigned i = 0; i < 100; i++)
        used += (size_t)snprintf(many + used, sizeof(many) - used, "- {size: [0, 1]}\n");
    snprintf(many + used, sizeof(many) - used, "boards: [{serial: S, panels: panel-1}]\nrate: x\n");
    struct wall_def *d;
    struct fault f;
    assert_int_equal(wall_def_parse(&d, many, strlen(many), &mistakes, &f), -1);
    assert_int_equal(mistakes.count, WALL_FAULTS_MAX);
    assert_true(mistakes.more);
    for (unsigned i = 0; i < WALL_FAULTS_MAX; i++)
        assert_int_equal(mistakes.at[i].line, 3 + i);
    assert_int_equal(wall_def_parse(&d, many, strlen(many), NULL, &f), -1);
    assert_int_equal(wall_def_parse(&d, many, strlen(many), NULL, NULL), -1);
}

static void test_yaml(void **state)
{
    (void)state;
    BAD("wall: &a w\nrate: 0\npanels: [{size: [1, 1]}]\nboards: [{serial: S, panels: panel-1}]\n", "1:7: an anchor, \"&a\"; *", "2:7: rate: \"0\"; *");
    BAD("wall: *a\n", "1:7: an alias, \"*a\"; *");
    BAD("wall: !x w\npanels: [{size: [1, 1]}]\nboards: [{serial: S, panels: panel-1}]\n", "1:7: a tag, \"!x\"; *");
    BAD(SHORT "---\nwall: x\n", "4:1: a second document *");
    BAD("wall: [[[[[[[[[[x]]]]]]]]]]\n", "1:14: maps and lists more than 8 deep; *");
    BAD("? [a]\n: b\n", "1:3: a key that is a map or a list; *");
    BAD("wall: w\n\trate: 60\n", "2:1: not YAML: *");
    BAD("wall: \"a\\0b\"\n", "1:7: a NUL character; *");
    BAD("wall: [1, 2\n", "2:1: not YAML: *");
    BAD("wall: w: v\n", "1:8: not YAML: mapping values are not allowed in this context (a colon too many, *");
    BAD("wall: \xff\n", "1:1: at byte 6: invalid leading UTF-8 octet; expected UTF-8 text");
    static char large[WALL_TEXT_MAX + 2];
    memset(large, '#', sizeof(large) - 1);
    BAD(large, "1:1: 61441 bytes; expected a definition of at most 61440");
    // The text's end is where it is said to be, NUL or not.
    struct wall_def *d;
    struct fault f;
    char *exact = malloc(sizeof(SHORT) - 1);
    memcpy(exact, SHORT, sizeof(SHORT) - 1);
    assert_int_equal(wall_def_parse(&d, exact, sizeof(SHORT) - 1, &mistakes, &f), 0);
    wall_def_free(d);
    free(exact);
}

static void test_notes(void **state)
{
    (void)state;
    struct wall_def *d = good(TOP PANEL "boards: [{serial: S, leds: [{panel: p, count: 60}]}]\n");
    assert_int_equal(mistakes.notes, 2);
    assert_string_equal(mistakes.note[0].text, "panels[0]: panel p: 4 of its 64 LEDs are on no board and stay dark");
    assert_string_equal(mistakes.note[1].text, "panels[1]: panel q: 64 of its 64 LEDs are on no board and stay dark");
    wall_def_free(d);
    char text[2048] = "wall: w\nrate: 60\npanels: [{name: t, size: [8, 8], grid: [11, 1]}]\nboards:\n";
    for (unsigned i = 1; i <= 11; i++)
        snprintf(text + strlen(text), sizeof(text) - strlen(text), "- {serial: S%u, panels: t-%u}\n", i, i);
    wall_def_free(good(text));
    assert_int_equal(mistakes.notes, 1);
    assert_int_equal(mistakes.note[0].line, 2);
    assert_non_null(strstr(mistakes.note[0].text, "11 fadecandies at 60 frames per second need 14.5 ms of bus in each 16.7 ms"));
    *strstr(text, "- {serial: S11") = '\0';
    wall_def_free(good(text)); /* ten at 60 are as planned */
    assert_int_equal(mistakes.notes, 1);
    assert_non_null(strstr(mistakes.note[0].text, "t-11: 64 of its 64"));
}

/* ---- colour --------------------------------------------------------------------------------------------------------- */

static struct wall_def *coloured(const char *colour)
{
    char text[512];
    snprintf(text, sizeof(text), SHORT "colour: {%s}\n", colour);
    return good(text);
}

/* What drive looks like: chromaticity of M * picture on LEDs of these primaries and white; written with sums of light, not with the
 * inverse that the definition's code uses. lum: of the LEDs' primaries. */
static void seen(const double m[3][3], const double primary[3][2], const double lum[3], const double picture[3], double out[3])
{
    double x = 0, y = 0, z = 0;
    for (unsigned c = 0; c < 3; c++) {
        const double drive = m[c][0] * picture[0] + m[c][1] * picture[1] + m[c][2] * picture[2];
        x += drive * lum[c] * primary[c][0] / primary[c][1];
        y += drive * lum[c];
        z += drive * lum[c] * (1 - primary[c][0] - primary[c][1]) / primary[c][1];
    }
    out[0] = x / (x + y + z);
    out[1] = y / (x + y + z);
    out[2] = y;
}

static double white_most(const struct wall_def *d)
{
    double most = -1;
    for (unsigned i = 0; i < 3; i++)
        most = fmax(most, d->matrix[i][0] + d->matrix[i][1] + d->matrix[i][2]);
    return most;
}

static void test_matrix(void **state)
{
    (void)state;
    // LEDs as a meter sees them: a wide gamut, and a cold white. Luminances by solving x and y of the white by bisection over sums.
    static const double led[3][2] = { { 0.690, 0.305 }, { 0.180, 0.720 }, { 0.135, 0.060 } };
    static const double rec709[3][2] = { { 0.64, 0.33 }, { 0.30, 0.60 }, { 0.15, 0.06 } };
    static const double rec709_luma[3] = { 0.2126, 0.7152, 0.0722 };
    struct wall_def *d = coloured("primaries: {red: [0.690, 0.305], green: [0.180, 0.720], blue: [0.135, 0.060]}, white: [0.28, 0.29]");
    assert_true(fabs(white_most(d) - 1) < 1e-12);
    // Luminances of the primaries whose sum has that white: from x*(..)=.., as two linear equations by Cramer's rule.
    const double wx = 0.28 / 0.29, wz = (1 - 0.28 - 0.29) / 0.29;
    double a[3], c[3];
    for (unsigned i = 0; i < 3; i++) {
        a[i] = led[i][0] / led[i][1];
        c[i] = (1 - led[i][0] - led[i][1]) / led[i][1];
    }
    const double det = (a[0] - a[2]) * (c[1] - c[2]) - (a[1] - a[2]) * (c[0] - c[2]);
    double lum[3];
    lum[0] = ((wx - a[2]) * (c[1] - c[2]) - (a[1] - a[2]) * (wz - c[2])) / det;
    lum[1] = ((a[0] - a[2]) * (wz - c[2]) - (wx - a[2]) * (c[0] - c[2])) / det;
    lum[2] = 1 - lum[0] - lum[1];
    static const double pictures[][3] = { { 1, 1, 1 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 }, { 0.2, 0.7, 0.4 } };
    static const double identity[3][3] = { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } };
    double scale = 0;
    for (unsigned i = 0; i < sizeof(pictures) / sizeof(pictures[0]); i++) {
        double on_wall[3], meant[3];
        seen(d->matrix, led, lum, pictures[i], on_wall);
        seen(identity, rec709, rec709_luma, pictures[i], meant);
        scale = i ? scale : on_wall[2] / meant[2];
        // 4 digits of Rec.709's published luma and white limit the comparison.
        if (fabs(on_wall[0] - meant[0]) > 1e-4 || fabs(on_wall[1] - meant[1]) > 1e-4 || fabs(on_wall[2] / meant[2] / scale - 1) > 2e-3)
            fail_msg("picture %u: x %g y %g Y %g, meant %g %g %g", i, on_wall[0], on_wall[1], on_wall[2] / scale, meant[0], meant[1], meant[2]);
    }
    wall_def_free(d);
    // Rec.709's own primaries and white: nothing to do.
    d = coloured("primaries: {red: [0.64, 0.33], green: [0.3, 0.6], blue: [0.15, 0.06]}, white: D65");
    for (unsigned i = 0; i < 9; i++)
        assert_true(fabs(d->matrix[i / 3][i % 3] - (i % 4 == 0)) < 1e-12);
    wall_def_free(d);
    // The target white is the LEDs' own: white is all three full on.
    d = coloured("white: [0.28, 0.29], target white: native");
    for (unsigned i = 0; i < 3; i++)
        assert_true(fabs(d->matrix[i][0] + d->matrix[i][1] + d->matrix[i][2] - 1) < 1e-9);
    wall_def_free(d);
    // Bradford, D65 to D50, against Lindbloom's published matrix of linear sRGB to XYZ D50: the white's drive on LEDs of D65 is
    // that of the chromaticity D50, and neutral picture parts keep it.
    d = coloured("target white: D50");
    double xy[3], grey[3] = { 0.18, 0.18, 0.18 };
    seen(d->matrix, rec709, rec709_luma, grey, xy);
    assert_true(fabs(xy[0] - 0.3457) < 2e-4 && fabs(xy[1] - 0.3585) < 2e-4);
    const double red[3] = { 1, 0, 0 };
    seen(d->matrix, rec709, rec709_luma, red, xy);
    assert_true(fabs(xy[0] - 0.4360747 / (0.4360747 + 0.2225045 + 0.0139322)) < 3e-4);
    assert_true(fabs(xy[1] - 0.2225045 / (0.4360747 + 0.2225045 + 0.0139322)) < 3e-4);
    assert_true(fabs(white_most(d) - 1) < 1e-12);
    wall_def_free(d);
    // A target that the LEDs cannot reach.
    BAD(SHORT "colour: {white: [0.3, 0.31], target white: [0.69, 0.305]}\n", "4:9: colour: these LEDs cannot show the target white: *");
    // The explicit matrix multiplies from the left, on the drive.
    struct wall_def *plain = coloured("white: [0.28, 0.29]"), *both = coloured("white: [0.28, 0.29], matrix: [[0, 1, 0], [0.5, 0, 0], [0, 0, 2]]");
    for (unsigned k = 0; k < 3; k++) {
        assert_true(both->matrix[0][k] == plain->matrix[1][k]);
        assert_true(both->matrix[1][k] == 0.5 * plain->matrix[0][k]);
        assert_true(both->matrix[2][k] == 2 * plain->matrix[2][k]);
    }
    wall_def_free(plain);
    wall_def_free(both);
}

/* ---- the most, and damage --------------------------------------------------------------------------------------------- */

static void test_at_the_caps(void **state)
{
    (void)state;
    struct wall_def *d = good("wall: w\n"
                              "size: [4096, 256]\n"
                              "panels: [{name: t, size: [32, 32], grid: [128, 8]}]\n"
                              "boards: [{serial: S, kind: gud, size: [4096, 64], panels: t-1 to t-256}]\n");
    assert_int_equal(d->n_panels, WALL_PANELS_MAX);
    assert_int_equal(d->n_runs, WALL_RUNS_MAX);
    struct wall_layout *l;
    assert_int_equal(wall_layout_make(&l, d, NULL), 0);
    assert_int_equal(l->lit, 4096 * 64);
    wall_layout_free(l);
    wall_def_free(d);
    assert_int_equal(mistakes.notes, WALL_NOTES_MAX);
    BAD("wall: w\nsize: [4096, 256]\npanels: [{name: t, size: [32, 32], grid: [128, 8]}]\n"
        "boards: [{serial: S, kind: gud, size: [4096, 96], panels: t-1 to t-257}]\n",
        "4:59: boards[0].panels: one more run of LEDs; expected at most 8192 on all boards");
    // All panels on one place: each stops at its first pixel.
    BAD("wall: w\nsize: [1024, 1024]\npanels:\n- {name: a, size: [1024, 1024]}\n- {name: b, size: [1024, 1024]}\n"
        "boards: [{serial: S, kind: gud, size: [1024, 1024], panels: a}]\n",
        "5:3: panels[1]: panel b lies on panel a (line 4) at wall pixel 0, 0; *");
}

static uint32_t random_next(uint64_t *state) /* PCG-XSH-RR 64/32, O'Neill 2014 */
{
    const uint64_t old = *state;
    *state = old * 6364136223846793005u + 1442695040888963407u;
    const uint32_t x = (uint32_t)((old >> 18 ^ old) >> 27), turn = (uint32_t)(old >> 59);
    return x >> turn | x << (-turn & 31);
}

/* What a parse that succeeds promises (wall_def.h), looked at without its code. */
static void check_promises(const struct wall_def *d)
{
    struct wall_layout *l;
    assert_true(d->width >= 1 && d->height >= 1 && (uint64_t)d->width * d->height <= WALL_PIXELS_MAX);
    assert_true(d->n_panels >= 1 && d->n_panels <= WALL_PANELS_MAX && d->n_boards >= 1 && d->n_boards <= WALL_BOARDS_MAX);
    assert_true(d->rate >= 1 && d->rate <= 240 && d->fade_s >= 0 && d->fade_s <= 3600);
    for (unsigned i = 0; i < 9; i++)
        assert_true(isfinite(d->matrix[i / 3][i % 3]));
    for (unsigned i = 0; i < d->n_boards; i++)
        assert_true(d->board[i].supply < (int)d->n_supplies && *d->board[i].serial);
    for (unsigned i = 0; i < d->n_runs; i++) {
        const struct wall_run *r = &d->run[i];
        assert_true(r->panel < d->n_panels && r->board < d->n_boards && r->count >= 1);
        assert_true((uint64_t)r->first + r->count <= (uint64_t)d->panel[r->panel].width * d->panel[r->panel].height);
        assert_true((uint64_t)r->at + r->count <= (uint64_t)d->board[r->board].width * d->board[r->board].height);
    }
    assert_int_equal(wall_layout_make(&l, d, NULL), 0);
    uint8_t *seen_pixel = calloc((size_t)d->width * d->height, 1);
    uint32_t lit = 0;
    for (unsigned i = 0; i < l->boards; i++)
        for (uint32_t k = 0; k < l->board[i].leds; k++) {
            const int32_t p = l->board[i].pixel[k];
            if (p < 0)
                continue;
            assert_true((uint32_t)p < d->width * d->height && !seen_pixel[p]);
            seen_pixel[p] = 1;
            lit++;
        }
    assert_int_equal(lit, l->lit);
    free(seen_pixel);
    wall_layout_free(l);
}

static size_t damage(char *text, size_t size, size_t room, uint64_t *seed)
{
    static const char *const words[] = { "0", "-1", "4096", "9999999999", "1e308", "[", "]", "{", "}", ": ", "\n- ", "&a ", "*a", "!!x ", "---\n", "\t",
                                         "p", "name: ", "rotate: 90", "grid: [9, 9]", "strip: 7", "at: ", "count: ", ", ", "\"", "\\0", "\xff",
                                         "first: 1", "reversed: true", "size: [1, 1]", "panels: ", "~", "#", "\n  ", "left", "right to left" };
    for (unsigned n = 1 + random_next(seed) % 3; n; n--) {
        const size_t at = random_next(seed) % (size + 1), take = random_next(seed) % 3 ? 0 : random_next(seed) % 12;
        const size_t gone = take < size - at ? take : size - at;
        memmove(text + at, text + at + gone, size - at - gone);
        size -= gone;
        const char *w = words[random_next(seed) % (sizeof(words) / sizeof(words[0]))];
        size_t length = strlen(w);
        if (random_next(seed) % 3 == 0 || size + length > room)
            continue;
        memmove(text + at + length, text + at, size - at);
        memcpy(text + at, w, length);
        size += length;
    }
    return size;
}

/* AIRY_WALL_MUTATIONS and AIRY_SEED: more of them, others. */
static void test_damage(void **state)
{
    (void)state;
    const char *asked = getenv("AIRY_WALL_MUTATIONS"), *seed_text = getenv("AIRY_SEED");
    const unsigned tries = asked ? (unsigned)atoi(asked) : 20000, seed0 = seed_text ? (unsigned)atoi(seed_text) : 1;
    static const char tiles[] = "wall: tiles\npanels:\n- {name: p, size: [8, 8], grid: [4, 2], grid order: {serpentine: yes}}\n"
                                "supplies: [{name: s, amps: 5}]\nboards:\n- {serial: A, supply: s, leds: [{panels: p-1 to p-4}, {panel: p-5, "
                                "strip: 6, reversed: yes}]}\n- {serial: B, kind: gud, size: [16, 16], leds: [{panel: p-6, corner: [8, 8]}]}\n";
    const char *const models[] = { whole, tiles, SHORT };
    unsigned parsed = 0;
    for (unsigned i = 0; i < tries; i++) {
        uint64_t seed = (uint64_t)seed0 << 32 | i;
        random_next(&seed);
        struct wall_def *d = NULL;
        struct fault f = { .code = FAULT_NONE };
        const char *model = models[random_next(&seed) % 3];
        char buffer[4096];
        size_t size = strlen(model);
        memcpy(buffer, model, size);
        size = damage(buffer, size, sizeof(buffer), &seed);
        char *text = malloc(size + !size); /* of that size, for ASan */
        memcpy(text, buffer, size);
        if (wall_def_parse(&d, text, size, &mistakes, &f) == 0) {
            assert_int_equal(mistakes.count, 0);
            check_promises(d);
            wall_def_free(d);
            parsed++;
        } else {
            if (f.code != FAULT_WALL || !mistakes.count || !*mistakes.at[0].text)
                fail_msg("seed %u, mutation %u: no mistake is told", seed0, i);
            for (unsigned k = 1; k < mistakes.count; k++)
                assert_true(mistakes.at[k - 1].line <= mistakes.at[k].line);
        }
        free(text);
    }
    print_message("%u mutations, %u of them walls\n", tries, parsed);
    assert_true(parsed > tries / 100 && parsed < tries);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_short_wall), cmocka_unit_test(test_whole_wall), cmocka_unit_test(test_keys),
        cmocka_unit_test(test_values),     cmocka_unit_test(test_panels),     cmocka_unit_test(test_boards),
        cmocka_unit_test(test_all_at_once), cmocka_unit_test(test_yaml),      cmocka_unit_test(test_notes),
        cmocka_unit_test(test_matrix),     cmocka_unit_test(test_at_the_caps), cmocka_unit_test(test_damage),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
