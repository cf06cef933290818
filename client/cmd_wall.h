/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_wall.h - airy wall SUBCOMMAND: the subcommands by name, and how a definition is read from its file with all its
 * mistakes told. A subcommand more is one row in cmd_wall.c's table and one file.
 */
#ifndef AIRY_CMD_WALL_H
#define AIRY_CMD_WALL_H

#include "cmd.h"
#include "wall_def.h"

/* argv[0] is the subcommand's name. */
struct wall_command {
    const char *name;
    int (*run)(int argc, char **argv); /* an enum cmd_exit */
    const char *help;                  /* one line of what it does */
};

int cmd_wall_check(int argc, char **argv);
int cmd_wall_draw(int argc, char **argv);

/* The text of a definition, NUL behind it; the caller frees it. CMD_DONE, or it complained. */
enum cmd_exit wall_file_read(const char *path, char **text, size_t *bytes);
/* The definition in a file (wall_def_free it); its mistakes go to stderr as "FILE:12:5: ...", notes too when `notes`. */
enum cmd_exit wall_file_parse(const char *path, bool notes, struct wall_def **out);

#endif
