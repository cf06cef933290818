/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd.h - the airy command's parts in one view: what main.c calls, and the exit statuses (airy(1) tells
 * them to people). The command uses libairy and libc, and knows nothing of the protocol.
 */
#ifndef AIRY_CMD_H
#define AIRY_CMD_H

#include "airy.h"

enum cmd_exit {
    CMD_DONE = 0,
    CMD_OTHER = 1,
    CMD_USAGE = 2,
    CMD_INPUT = 3,
    CMD_OUTPUT = 4,
    CMD_RETRY = 5, /* the same command may succeed later */
};

/* argv[0] is the subcommand's name. */
enum cmd_exit cmd_bloom(int argc, char **argv);
enum cmd_exit cmd_plan(int argc, char **argv);
enum cmd_exit cmd_status(int argc, char **argv);
enum cmd_exit cmd_top(int argc, char **argv);
enum cmd_exit cmd_wall(int argc, char **argv);
enum cmd_exit cmd_help(int argc, char **argv);

/* "airy: ..." and a newline on stderr. */
void cmd_complain(const char *format, ...) __attribute__((format(printf, 1, 2)));
/* A connection whose loss the command itself sees to; *out is NULL on failure. 0, or -1 and *e. */
int cmd_connect(struct airy **out, const char *socket, struct airy_error *e);
/* What an error of the daemon or the library means to a shell. */
enum cmd_exit cmd_exit_of(const struct airy_error *e);

#endif
