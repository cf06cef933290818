/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wall_draw_internal.h - a canvas and what is drawn on it: the wall_draw*.c files' own. Places are in pixels, a pixel's centre at
 * + 0.5; everything may lie partly or wholly outside.
 */
#ifndef AIRYD_WALL_DRAW_INTERNAL_H
#define AIRYD_WALL_DRAW_INTERNAL_H

#include "wall_draw.h"

struct ink {
    uint8_t r, g, b;
    double alpha; /* 0..1, blended in sRGB codes: for people's eyes, not for light */
};

/* Filled with `back`. 0, or -1 and *f: larger than WALL_DRAW_PIXELS_MAX, NO_MEMORY. */
enum { WALL_DRAW_PIXELS_MAX = 64 << 20 };
int canvas_init(struct wall_picture *c, uint64_t width, uint64_t height, struct ink back, struct fault *f);
void canvas_rectangle(struct wall_picture *c, double x, double y, double w, double h, double radius, struct ink ink);
/* Its line lies inside the rectangle. */
void canvas_frame(struct wall_picture *c, double x, double y, double w, double h, double line, struct ink ink);
void canvas_line(struct wall_picture *c, double x0, double y0, double x1, double y1, double width, struct ink ink);
void canvas_ring(struct wall_picture *c, double x, double y, double radius, double line, struct ink ink);
/* An arrow head with its tip at x, y, that points along dx, dy (of length 1). */
void canvas_head(struct wall_picture *c, double x, double y, double dx, double dy, double size, struct ink ink);

/* Letters are 5 x 7 dots of `scale` pixels, 6 dots apart; what is not ASCII is drawn as a box. */
void canvas_text(struct wall_picture *c, double x, double y, unsigned scale, struct ink ink, const char *text);
double canvas_text_width(unsigned scale, const char *text);
static inline double canvas_text_height(unsigned scale) { return 7.0 * scale; }

#endif
