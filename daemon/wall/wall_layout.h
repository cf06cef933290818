/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wall_layout.h - which LED of which board shows which pixel of the wall. Pure.
 */
#ifndef AIRYD_WALL_LAYOUT_H
#define AIRYD_WALL_LAYOUT_H

#include "wall_def.h"

struct wall_board_map {
    uint32_t leds;      /* width * height of the board */
    int32_t *pixel;     /* [leds]: y * wall width + x, or -1: dark */
    uint16_t *panel;    /* [leds]: the panel it belongs to; undefined where pixel is -1 */
};

struct wall_layout {
    unsigned boards;
    struct wall_board_map *board; /* [def->n_boards] */
    uint32_t lit;                 /* LEDs that show something */
    uint32_t x0, y0, x1, y1;      /* the smallest rectangle of wall pixels with all panels; x1, y1 past the end */
};

int wall_layout_make(struct wall_layout **out, const struct wall_def *d, struct fault *f); /* NO_MEMORY */
void wall_layout_free(struct wall_layout *l); /* NULL is fine */

#endif
