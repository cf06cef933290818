/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_wall_text.h - what is known of a wall, for people and for programs. Pure: texts from the library's structs. Names come from
 * definitions and from USB: control characters in them are shown as "?".
 */
#ifndef AIRY_CMD_WALL_TEXT_H
#define AIRY_CMD_WALL_TEXT_H

#include <stddef.h>
#include <stdio.h>

#include "airy.h"
#include "cmd_json.h"

struct wall_played { /* of airy wall play */
    uint64_t sent, skipped, failed;
};

/* "8/10 boards ready; left absent (unplugged), 3 opening" in at most `size` bytes; false when all are ready. */
bool wall_text_boards(char *out, size_t size, const struct airy_wall_state *w);
/* Sum of the boards, and of what they would take. */
void wall_amps(const struct airy_wall_state *w, double *amps, double *wanted);

/* One line, at most `columns` characters. played NULL: nothing of it. */
void wall_text_line(char *out, size_t size, unsigned columns, const struct airy_wall_state *w, const struct wall_played *played);
/* A paragraph: the wall, its boards, its supplies. */
void wall_text_stats(FILE *out, const struct airy_wall_state *w);
/* Walls and controllers, and what to do when there are none. */
void wall_text_list(FILE *out, const struct airy_wall_reply *r);

void wall_json_state(struct json *j, const char *key, const struct airy_wall_state *w);
void wall_json_list(struct json *j, const struct airy_wall_reply *r);

/* sRGB pixels as half blocks, at most columns x rows characters, with ANSI's 24-bit colours: a block shows the mean of the pixels that it
 * covers. Each line ends in "\033[0m\r\n". */
void wall_text_blocks(FILE *out, const uint8_t *rgb, uint32_t width, uint32_t height, unsigned columns, unsigned rows);

#endif
