/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_wall_commands.h - the subcommands of airy wall that talk to a daemon, for cmd_wall.c's table. Each takes argv[0] as its own
 * name, which it replaces, and returns an enum cmd_exit.
 */
#ifndef AIRY_CMD_WALL_COMMANDS_H
#define AIRY_CMD_WALL_COMMANDS_H

int cmd_wall_list(int argc, char **argv);
int cmd_wall_open(int argc, char **argv);
int cmd_wall_close(int argc, char **argv);
int cmd_wall_play(int argc, char **argv);
int cmd_wall_test(int argc, char **argv);
int cmd_wall_preview(int argc, char **argv);
int cmd_wall_stats(int argc, char **argv);
int cmd_wall_share(int argc, char **argv);

#define CMD_WALL_COMMANDS                                                                                \
    { "list", cmd_wall_list, "controllers that are plugged in, walls that are open" },                   \
    { "open", cmd_wall_open, "opens a wall in the daemon, and keeps it" },                               \
    { "close", cmd_wall_close, "black, then away" },                                                     \
    { "play", cmd_wall_play, "a sequence of frames, bloomed, in time" },                                 \
    { "test", cmd_wall_test, "a test pattern through the whole mapping" },                               \
    { "preview", cmd_wall_preview, "what is sent to the LEDs, as a PNG or in the terminal" },            \
    { "stats", cmd_wall_stats, "rate, lateness, drops, errors, amperes, once a second" },                \
    { "share", cmd_wall_share, "what part of a frame this machine's share of a split wall needs" }

#endif
