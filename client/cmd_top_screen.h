/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_top_screen.h - a terminal that is drawn over: its other screen without a cursor, keys as they are pressed, its size as it is now.
 *
 * Invariant: however the command ends (but by SIGKILL), and while it is stopped by ctrl-Z, the terminal is as it was found. What is drawn
 * never scrolls and never wraps, and of a text from outside nothing but its letters reaches the terminal.
 *
 * Uses cmd_wall_stop.h: stop_install comes first. Main thread only; one at a time.
 */
#ifndef AIRY_CMD_TOP_SCREEN_H
#define AIRY_CMD_TOP_SCREEN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <termios.h>

struct screen {
    bool keys; /* standard input is a terminal, too */
    struct termios before, raw;
    int signals_fd, events_fd;
};

enum screen_event { SCREEN_TIME, SCREEN_DRAW, SCREEN_QUIT };

/* Standard output is a terminal that understands more than lines ($TERM). */
bool screen_there(void);
/* 0 or -errno, and nothing changed. */
int screen_open(struct screen *s);
void screen_close(struct screen *s);
/* 1 to 1000 each, and 80 by 24 when the terminal does not tell. */
void screen_size(unsigned *columns, unsigned *rows);
/* As much of the text as there is room for; the last line says what is left out. */
void screen_draw(const char *text);
/* Waits until CLOCK_MONOTONIC is until_ns (TIME, also when the command is to stop), the size changed or the screen was away (DRAW), or
 * q was pressed or the terminal is gone (QUIT). */
enum screen_event screen_wait(struct screen *s, uint64_t until_ns);

/* One line of the text, which ends at '\n' or '\0', without control characters and cut to so many columns (0: all). Returns how many
 * it took. */
unsigned screen_put_line(FILE *out, const char *line, unsigned columns);

#endif
