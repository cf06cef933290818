// SPDX-License-Identifier: Apache-2.0
// cmd_wall_stats.c - airy wall stats: once a second what a daemon knows of its walls. On a terminal it is drawn over.
#include <stdio.h>
#include <time.h>
#include <unistd.h>

#include "cmd_wall_asked.h"
#include "cmd_wall_commands.h"
#include "cmd_wall_stop.h"
#include "cmd_wall_text.h"
#include "cmd_wall_use.h"

static const struct wall_syntax syntax = {
    .name = "wall stats",
    .help = "airy wall stats [NAME] [--once] [--json]\n"
            "\n"
            "Once a second, of one wall or of all: ticks and new pictures a second, how late the ticks are (p50, p99 and the\n"
            "most of the last 4096), what was shown, dropped and missed; of each board what was sent, dropped, its faults, its\n"
            "latency, and the amperes by the definition's numbers. Ctrl-C ends it.\n"
            "\n"
            "    airy wall stats lobby --json >>lobby.log\n",
    .expected = "at most one NAME of a wall",
    .operands_max = 1,
    .options = 1 << WALL_OPTION_ONCE | 1 << WALL_OPTION_JSON,
};

static void say_json(const struct airy_wall_reply *r)
{
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    for (unsigned i = 0; i < r->n_walls; i++) {
        struct json j = { .out = stdout };
        json_open(&j, NULL, '{');
        json_number(&j, "unix_s", (double)t.tv_sec + 1e-9 * (double)t.tv_nsec);
        wall_json_state(&j, "wall", &r->walls[i]);
        json_close(&j, '}');
        json_line(&j);
    }
}

static void say_text(const struct airy_wall_reply *r, bool draw_over)
{
    if (draw_over)
        fputs("\033[H\033[J", stdout);
    if (!r->n_walls)
        puts("no wall is open; airy wall open FILE --keep opens one");
    for (unsigned i = 0; i < r->n_walls; i++)
        wall_text_stats(stdout, &r->walls[i]);
    fflush(stdout);
}

int cmd_wall_stats(int argc, char **argv)
{
    static struct wall_asked a = WALL_ASKED_INIT;
    struct session s;
    struct airy_error e;
    int rc = wall_asked_read(&a, &syntax, argc, argv);
    if (rc)
        return rc > 0 ? CMD_DONE : CMD_USAGE;
    if (wall_daemon(&s, &a.session, &e) < 0)
        return wall_complain(syntax.name, &e);
    stop_install();
    enum cmd_exit exit = CMD_DONE;
    for (uint64_t next_ns = stop_now_ns(); exit == CMD_DONE && !stop_asked() && !ferror(stdout);) {
        struct airy_wall_reply *r = NULL;
        const struct airy_wall_request q = { .action = AIRY_WALL_LIST, .name = a.operand[0] };
        if (airy_wall(s.airy, &q, WALL_TIMEOUT_MS, &r, &e) < 0)
            exit = wall_complain(syntax.name, &e);
        else if (a.json)
            say_json(r);
        else
            say_text(r, !a.once && isatty(STDOUT_FILENO));
        airy_wall_reply_free(r);
        if (a.once)
            break;
        next_ns += UINT64_C(1000000000);
        while (exit == CMD_DONE && !stop_asked() && stop_now_ns() < next_ns)
            stop_wait(-1, 0, next_ns);
    }
    session_close(&s);
    return exit;
}
