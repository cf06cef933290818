/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_wall_asked.h - the command lines of airy wall's subcommands that talk to a daemon: one table of options, of which each
 * subcommand takes some, for its parser and for its help.
 */
#ifndef AIRY_CMD_WALL_ASKED_H
#define AIRY_CMD_WALL_ASKED_H

#include "cmd_session.h"

enum wall_option {
    WALL_OPTION_WALL,
    WALL_OPTION_FRAMES,
    WALL_OPTION_FPS,
    WALL_OPTION_LOOP,
    WALL_OPTION_BOARD,
    WALL_OPTION_LED,
    WALL_OPTION_LEVEL,
    WALL_OPTION_SECONDS,
    WALL_OPTION_OUTPUT,
    WALL_OPTION_CELL,
    WALL_OPTION_LIVE,
    WALL_OPTION_ONCE,
    WALL_OPTION_KEEP,
    WALL_OPTION_FRAME,
    WALL_OPTION_PART,
    WALL_OPTION_LAYER,
    WALL_OPTION_VIEW,
    WALL_OPTION_SOCKET,
    WALL_OPTION_DEVICE,
    WALL_OPTION_JSON,
    WALL_OPTION_HELP,
    WALL_OPTIONS
};

struct wall_syntax {
    const char *name;     /* "wall play" */
    const char *help;     /* up to the options: what it does, with an example */
    const char *expected; /* the operands, for who got them wrong: "FILE|NAME PATTERN" */
    unsigned operands_min, operands_max;
    unsigned options;     /* bits 1 << WALL_OPTION_...; socket and help are always taken */
    bool params;          /* the bloom's parameters, too */
};

struct wall_asked { /* strings: argv's */
    const char *operand[2];
    unsigned operands;
    const char *wall, *frames, *board, *output;
    double fps, level, seconds; /* 0: not given */
    bool has_led;
    uint32_t led, cell, frame_width, frame_height;
    bool loop, live, once, keep, json;
    struct session_options session;
    struct airy_request request;
};
#define WALL_ASKED_INIT { .request = AIRY_REQUEST_INIT }

/* 0; 1: the help was asked for, and is said; -1: said what is wrong. */
int wall_asked_read(struct wall_asked *a, const struct wall_syntax *s, int argc, char **argv);

#endif
