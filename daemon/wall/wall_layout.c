// SPDX-License-Identifier: Apache-2.0
// wall_layout.c - where each LED of a panel is on the wall (wall_def.h says how wiring, flip and rotation follow each other),
// and from that which wall pixel each LED of each board shows.
#include "wall_layout.h"

#include <stdlib.h>

void wall_panel_size(const struct wall_panel *p, uint32_t *width, uint32_t *height)
{
    const bool upright = p->rotate % 180 == 0;
    *width = upright ? p->width : p->height;
    *height = upright ? p->height : p->width;
}

void wall_panel_led(const struct wall_panel *p, uint32_t k, uint32_t *x, uint32_t *y)
{
    const uint32_t w = p->width, h = p->height, length = p->columns ? h : w;
    const uint32_t line = k / length, place = k % length;
    const uint32_t along = p->serpentine && line % 2 ? length - 1 - place : place;
    uint32_t u = p->columns ? line : along, v = p->columns ? along : line;
    // An origin on the right counts columns from there, whichever way the lines run; then the panel may be mirrored.
    const bool from_right = p->origin == WALL_TOP_RIGHT || p->origin == WALL_BOTTOM_RIGHT;
    const bool from_bottom = p->origin == WALL_BOTTOM_LEFT || p->origin == WALL_BOTTOM_RIGHT;
    if (from_right != p->flip_x)
        u = w - 1 - u;
    if (from_bottom != p->flip_y)
        v = h - 1 - v;
    const bool half = p->rotate == 180, quarter = p->rotate == 90, back = p->rotate == 270;
    *x = p->x + (quarter ? h - 1 - v : half ? w - 1 - u : back ? v : u);
    *y = p->y + (quarter ? u : half ? h - 1 - v : back ? w - 1 - u : v);
}

static void put_run(struct wall_layout *l, const struct wall_def *d, const struct wall_run *run)
{
    const struct wall_panel *p = &d->panel[run->panel];
    struct wall_board_map *b = &l->board[run->board];
    for (uint32_t i = 0; i < run->count; i++) {
        uint32_t x, y;
        wall_panel_led(p, run->first + (run->reversed ? run->count - 1 - i : i), &x, &y);
        b->pixel[run->at + i] = (int32_t)(y * d->width + x);
        b->panel[run->at + i] = (uint16_t)run->panel;
    }
    l->lit += run->count;
}

static void find_rectangle(struct wall_layout *l, const struct wall_def *d)
{
    l->x0 = d->width;
    l->y0 = d->height;
    for (unsigned i = 0; i < d->n_panels; i++) {
        const struct wall_panel *p = &d->panel[i];
        uint32_t w, h;
        wall_panel_size(p, &w, &h);
        l->x0 = p->x < l->x0 ? p->x : l->x0;
        l->y0 = p->y < l->y0 ? p->y : l->y0;
        l->x1 = p->x + w > l->x1 ? p->x + w : l->x1;
        l->y1 = p->y + h > l->y1 ? p->y + h : l->y1;
    }
}

int wall_layout_make(struct wall_layout **out, const struct wall_def *d, struct fault *f)
{
    struct wall_layout *l = calloc(1, sizeof(*l));
    if (!l || !(l->board = calloc(d->n_boards, sizeof(*l->board))))
        goto fail;
    l->boards = d->n_boards;
    for (unsigned i = 0; i < d->n_boards; i++) {
        struct wall_board_map *b = &l->board[i];
        b->leds = d->board[i].width * d->board[i].height;
        b->pixel = malloc(b->leds * sizeof(*b->pixel));
        b->panel = calloc(b->leds, sizeof(*b->panel));
        if (!b->pixel || !b->panel)
            goto fail;
        for (uint32_t k = 0; k < b->leds; k++)
            b->pixel[k] = -1;
    }
    for (unsigned i = 0; i < d->n_runs; i++)
        put_run(l, d, &d->run[i]);
    find_rectangle(l, d);
    *out = l;
    return 0;
fail:
    wall_layout_free(l);
    return fault_set(f, FAULT_NO_MEMORY, "wall", "no memory for the layout of %u boards", d->n_boards);
}

void wall_layout_free(struct wall_layout *l)
{
    if (!l)
        return;
    for (unsigned i = 0; l->board && i < l->boards; i++) {
        free(l->board[i].pixel);
        free(l->board[i].panel);
    }
    free(l->board);
    free(l);
}
