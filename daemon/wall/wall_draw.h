/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wall_draw.h - pictures of a wall: its layout for people, and files of pixels. Pure but for the file that is written.
 */
#ifndef AIRYD_WALL_DRAW_H
#define AIRYD_WALL_DRAW_H

#include "wall_layout.h"

struct wall_picture { /* sRGB, 8 bits, R G B interleaved; owned */
    uint32_t width, height;
    uint8_t *rgb;
};

/* The layout: each LED a cell of `cell` pixels (0: chosen so that the picture's longer side is about 1600), coloured by its board,
 * with the wiring's order as a line from LED to LED (first LED ringed, arrow heads where it turns), panel edges and names, LED numbers
 * where there is room; wall pixels without an LED dark. Of a canvas with few panels only the part that has them. Legend of boards (name, kind, serial, LEDs) below. */
int wall_draw_layout(struct wall_picture *out, const struct wall_def *d, const struct wall_layout *l, unsigned cell,
                     struct fault *f);
/* Wall pixels (sRGB, width * height * 3) as round-cornered cells, for a preview. */
int wall_draw_pixels(struct wall_picture *out, uint32_t width, uint32_t height, const uint8_t *rgb, unsigned cell,
                     struct fault *f);
int wall_picture_write_png(const struct wall_picture *p, const char *path, struct fault *f); /* temp file, rename */
void wall_picture_free(struct wall_picture *p);

#endif
