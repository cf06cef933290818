/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_wall.h - airy wall SUBCOMMAND: the subcommands by name. A subcommand more is one row in cmd_wall.c's table and one
 * file.
 */
#ifndef AIRY_CMD_WALL_H
#define AIRY_CMD_WALL_H

#include "cmd.h"

/* argv[0] is the subcommand's name. */
struct wall_command {
    const char *name;
    int (*run)(int argc, char **argv); /* an enum cmd_exit */
    const char *help;                  /* one line of what it does */
};

int cmd_wall_check(int argc, char **argv);
int cmd_wall_draw(int argc, char **argv);

#endif
