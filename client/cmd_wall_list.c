// SPDX-License-Identifier: Apache-2.0
// cmd_wall_list.c - airy wall list, open, close: what there is, and what a daemon has open.
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "cmd_wall_asked.h"
#include "cmd_wall_commands.h"
#include "cmd_wall_stop.h"
#include "cmd_wall_text.h"
#include "cmd_wall_use.h"

/* ---- list ------------------------------------------------------------------------------------------- */

static const struct wall_syntax list_syntax = {
    .name = "wall list",
    .help = "airy wall list [--json]\n"
            "\n"
            "The LED controllers that are plugged in, with the serials that a definition needs, and the walls that the\n"
            "daemon has open. With no daemon running it looks with a private one.\n",
    .expected = "no operand",
    .options = 1 << WALL_OPTION_JSON | 1 << WALL_OPTION_DEVICE,
};

static bool being_read(const struct airy_wall_reply *r)
{
    for (unsigned i = 0; i < r->n_controllers; i++)
        if (r->controllers[i].reading)
            return true;
    return false;
}

/* A daemon that has just begun to look at USB knows the serials a little later. */
static int list(struct airy *a, struct airy_wall_reply **r, struct airy_error *e)
{
    enum { TRIES = 60 };
    for (int i = 0;; i++) {
        if (airy_wall(a, &(struct airy_wall_request){ .action = AIRY_WALL_LIST }, WALL_TIMEOUT_MS, r, e) < 0)
            return -1;
        if (!being_read(*r) || i == TRIES)
            return 0;
        airy_wall_reply_free(*r);
        *r = NULL;
        nanosleep(&(struct timespec){ .tv_nsec = 50000000 }, NULL);
    }
}

int cmd_wall_list(int argc, char **argv)
{
    static struct wall_asked a = WALL_ASKED_INIT;
    struct session s = SESSION_NONE;
    struct airy_wall_reply *r = NULL;
    struct airy_error e;
    int rc = wall_asked_read(&a, &list_syntax, argc, argv);
    if (rc)
        return rc > 0 ? CMD_DONE : CMD_USAGE;
    enum cmd_exit exit = CMD_DONE;
    if (session_open(&s, &a.session, &e) < 0 ||
        list(s.airy, &r, &e) < 0) {
        exit = wall_complain(list_syntax.name, &e);
    } else if (a.json) {
        struct json j = { .out = stdout };
        wall_json_list(&j, r);
        json_line(&j);
    } else {
        wall_text_list(stdout, r);
    }
    airy_wall_reply_free(r);
    session_close(&s);
    return exit;
}

/* ---- open ------------------------------------------------------------------------------------------- */

static const struct wall_syntax open_syntax = {
    .name = "wall open",
    .help = "airy wall open FILE [--keep]\n"
            "\n"
            "Opens the wall of a definition in a daemon that is running, for other commands and programs to use by its\n"
            "name. Without --keep it is open until Ctrl-C. Boards that are not there yet are waited for.\n"
            "\n"
            "    airy wall open lobby.yaml --keep && airy wall play 'loop.####.exr' --wall lobby --loop\n",
    .expected = "one definition, FILE,",
    .operands_min = 1,
    .operands_max = 1,
    .options = 1 << WALL_OPTION_KEEP,
};

/* CMD_DONE: it is open, and said so. */
static enum cmd_exit open_file(struct airy *airy, const struct wall_file *f, const struct wall_asked *a)
{
    char boards[400];
    struct airy_error e;
    const struct airy_wall_request look = { .action = AIRY_WALL_LIST, .name = f->def->name };
    struct airy_wall_reply *r = wall_ask(airy, &look, &e);
    if (r) {
        airy_wall_reply_free(r);
        cmd_complain("%s: wall \"%s\" is open already; airy wall close %s first, then open it again", open_syntax.name, f->def->name,
                     f->def->name);
        return CMD_INPUT;
    }
    if (wall_open_file(airy, f, a->operand[0], a->keep, &e) < 0 || !(r = wall_ask(airy, &look, &e)))
        return wall_complain(open_syntax.name, &e);
    wall_text_boards(boards, sizeof(boards), &r->walls[0]);
    printf("wall %s is open%s; %s\n", f->def->name, a->keep ? "" : " until Ctrl-C", boards);
    fflush(stdout);
    airy_wall_reply_free(r);
    return CMD_DONE;
}

static enum cmd_exit hold(struct wall_use *u)
{
    struct airy_error e;
    while (!stop_asked()) {
        stop_wait(airy_fd(u->session.airy), airy_events(u->session.airy), stop_now_ns() + UINT64_C(1000000000));
        if (airy_pump(u->session.airy, &e) < 0)
            return wall_complain(open_syntax.name, &e);
    }
    return CMD_DONE;
}

int cmd_wall_open(int argc, char **argv)
{
    static struct wall_asked a = WALL_ASKED_INIT;
    struct wall_use u = { .session = SESSION_NONE };
    struct wall_file f;
    struct airy_error e;
    int rc = wall_asked_read(&a, &open_syntax, argc, argv);
    if (rc)
        return rc > 0 ? CMD_DONE : CMD_USAGE;
    enum cmd_exit exit = wall_use_read(&f, a.operand[0]);
    if (exit != CMD_DONE)
        return exit;
    stop_install();
    if (wall_daemon(&u.session, &a.session, &e) < 0)
        exit = wall_complain(open_syntax.name, &e);
    else
        exit = open_file(u.session.airy, &f, &a);
    if (exit == CMD_DONE && !a.keep) {
        snprintf(u.name, sizeof(u.name), "%s", f.def->name);
        u.ours = true;
        exit = hold(&u);
    }
    wall_use_close(&u);
    wall_file_finish(&f);
    return exit;
}

/* ---- close ------------------------------------------------------------------------------------------ */

static const struct wall_syntax close_syntax = {
    .name = "wall close",
    .help = "airy wall close NAME\n"
            "\n"
            "Black on all its boards, and the wall is away, whoever opened it.\n",
    .expected = "the NAME of one wall",
    .operands_min = 1,
    .operands_max = 1,
};

int cmd_wall_close(int argc, char **argv)
{
    static struct wall_asked a = WALL_ASKED_INIT;
    struct session s;
    struct airy_wall_reply *r = NULL;
    struct airy_error e;
    int rc = wall_asked_read(&a, &close_syntax, argc, argv);
    if (rc)
        return rc > 0 ? CMD_DONE : CMD_USAGE;
    enum cmd_exit exit = CMD_DONE;
    if (wall_daemon(&s, &a.session, &e) < 0 ||
        airy_wall(s.airy, &(struct airy_wall_request){ .action = AIRY_WALL_CLOSE, .name = a.operand[0] }, WALL_TIMEOUT_MS, &r,
                  &e) < 0)
        exit = wall_complain(close_syntax.name, &e);
    airy_wall_reply_free(r);
    session_close(&s);
    return exit;
}
