// SPDX-License-Identifier: Apache-2.0
// cmd_wall_test.c - airy wall test: a pattern in place of frames, and which boards do not show it.
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "cmd_options.h"
#include "cmd_wall_asked.h"
#include "cmd_wall_commands.h"
#include "cmd_wall_stop.h"
#include "cmd_wall_text.h"
#include "cmd_wall_use.h"

static const struct wall_syntax syntax = {
    .name = "wall test",
    .help = "airy wall test FILE|NAME PATTERN [--level N] [--seconds N]\n"
            "airy wall test FILE|NAME led --board NAME --led N\n"
            "\n"
            "Shows a pattern through the wall's whole mapping, until Ctrl-C; then frames are seen again.\n"
            "\n"
            "  order    each board's LEDs light up in its own order: is the wiring as defined?\n"
            "  panels   the edges of each panel, its first LED's corner red: position, rotation, mirroring\n"
            "  red green blue white     one colour: is the order of colours right? white: balance, and the power\n"
            "  ramp     dark to bright, white and each primary: transfer curve, dither\n"
            "  checker  every other pixel\n"
            "  led      one LED of one board\n"
            "  black    nothing\n"
            "\n"
            "On the first day: order, panels, red, green, blue; then white, with --level 0.1 first.\n"
            "\n"
            "    airy wall test lobby.yaml order\n"
            "    airy wall test lobby led --board left --led 63 --level 1\n",
    .expected = "FILE|NAME PATTERN",
    .operands_min = 2,
    .operands_max = 2,
    .options = 1 << WALL_OPTION_BOARD | 1 << WALL_OPTION_LED | 1 << WALL_OPTION_LEVEL | 1 << WALL_OPTION_SECONDS |
               1 << WALL_OPTION_DEVICE,
};

static const char *const patterns[] = { "order", "panels", "red", "green", "blue", "white", "ramp", "checker", "led", "black" };
enum { PATTERNS = sizeof(patterns) / sizeof(patterns[0]) };

/* 0, or -1: said what is wrong. */
static int asked_check(const struct wall_asked *a)
{
    const char *word = a->operand[1];
    bool known = false;
    for (unsigned i = 0; i < PATTERNS; i++)
        known = known || strcmp(word, patterns[i]) == 0;
    if (!known) {
        const char *best = nearest_name(word, patterns, PATTERNS);
        cmd_complain("%s: no pattern \"%s\"%s%s; order, panels, red, green, blue, white, ramp, checker, led or black expected", syntax.name,
                     word, best ? "; did you mean " : "", best ? best : "");
        return -1;
    }
    bool led = strcmp(word, "led") == 0;
    if (led && (!a->board || !a->has_led)) {
        cmd_complain("%s: pattern led needs --board NAME and --led N", syntax.name);
        return -1;
    }
    if (!led && (a->board || a->has_led)) {
        cmd_complain("%s: --board and --led are for the pattern led, not for %s", syntax.name, word);
        return -1;
    }
    return 0;
}

/* Says what changes of the boards, until it is over. */
static enum cmd_exit watch(struct wall_use *u, double seconds)
{
    char said[400] = "", now[400];
    uint64_t end_ns = seconds > 0 ? stop_now_ns() + (uint64_t)(seconds * 1e9) : UINT64_MAX;
    while (!stop_asked() && stop_now_ns() < end_ns) {
        struct airy_error e;
        struct airy_wall_reply *r =
            wall_ask(u->session.airy, &(struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = u->name }, &e);
        if (!r)
            return wall_complain(syntax.name, &e);
        wall_text_boards(now, sizeof(now), &r->walls[0]);
        airy_wall_reply_free(r);
        if (strcmp(said, now) != 0)
            fprintf(stderr, "%s: %s\n", u->name, now);
        memcpy(said, now, sizeof(said));
        uint64_t next_ns = stop_now_ns() + UINT64_C(500000000);
        stop_wait(-1, 0, next_ns < end_ns ? next_ns : end_ns);
    }
    return CMD_DONE;
}

static enum cmd_exit pattern(struct wall_use *u, const struct wall_asked *a, const char *word, enum cmd_exit exit)
{
    struct airy_error e;
    const struct airy_wall_request q = { .action = AIRY_WALL_PATTERN,
                                         .name = u->name,
                                         .pattern = word,
                                         .board = a->board,
                                         .led = a->led,
                                         .level = a->level };
    struct airy_wall_reply *r = NULL;
    if (airy_wall(u->session.airy, &q, WALL_TIMEOUT_MS, &r, &e) < 0)
        return exit != CMD_DONE ? exit : wall_complain(syntax.name, &e);
    airy_wall_reply_free(r);
    return exit;
}

int cmd_wall_test(int argc, char **argv)
{
    static struct wall_asked a = WALL_ASKED_INIT;
    struct wall_use u;
    int rc = wall_asked_read(&a, &syntax, argc, argv);
    if (rc)
        return rc > 0 ? CMD_DONE : CMD_USAGE;
    if (asked_check(&a) < 0)
        return CMD_USAGE;
    stop_install();
    enum cmd_exit exit = wall_use_open(&u, a.operand[0], &a.session, syntax.name);
    if (exit != CMD_DONE)
        return exit;
    exit = pattern(&u, &a, a.operand[1], CMD_DONE);
    if (exit == CMD_DONE) {
        fprintf(stderr, "%s: %s%s\n", u.name, a.operand[1], a.seconds > 0 ? "" : "; Ctrl-C ends it");
        exit = watch(&u, a.seconds);
        a.board = NULL;
        a.led = 0;
        exit = pattern(&u, &a, "", exit);
    }
    wall_use_close(&u);
    return exit;
}
