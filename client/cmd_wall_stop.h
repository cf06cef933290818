/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_wall_stop.h - commands that run until they are stopped: the first SIGINT, SIGTERM or SIGHUP asks for a clean end, the second
 * one ends the command at once (as without this: cmd_cleanup.h). Main thread only.
 */
#ifndef AIRY_CMD_WALL_STOP_H
#define AIRY_CMD_WALL_STOP_H

#include <stdbool.h>
#include <stdint.h>
#include <termios.h>

void stop_install(void);
bool stop_asked(void);
/* Written to standard output when the command is ended at once; it stays the caller's. NULL: nothing. */
void stop_restore(const char *text);
/* How standard input, a terminal, is to be left then; it stays the caller's. NULL: as it is. */
void stop_restore_terminal(const struct termios *t);
/* Waits until CLOCK_MONOTONIC is `until_ns`, fd (-1: none) has one of `events`, or the command is to stop. */
void stop_wait(int fd, short events, uint64_t until_ns);
uint64_t stop_now_ns(void);

#endif
