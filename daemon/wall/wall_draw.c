// SPDX-License-Identifier: Apache-2.0
// wall_draw.c - pictures of a wall for the people who hang and wire it: which LED is on which board, and how the wire goes.
//
// Invariant: boards can be told apart without seeing colours: the colours are those of Okabe and Ito ("Color Universal
// Design", 2008), beyond eight boards the cells' shape changes, and every run of LEDs is marked with its board's number.
#include "wall_draw_internal.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { MARGIN = 32, LONG_SIDE = 1600, CELL_MAX = 256, CELL_AUTO_MAX = 64, COLOURS = 8 };
enum { CELL_WIRES = 5, CELL_NUMBERS = 26 }; /* cells from which on there is room for them */
enum { TITLE_SCALE = 3, TEXT_SCALE = 2, ROW = 24 };

static const struct ink paper = { 0x12, 0x14, 0x18, 1 }, ground = { 0x1c, 0x1f, 0x25, 1 }, unlit = { 0x30, 0x34, 0x3c, 1 },
                        bright = { 0xf4, 0xf4, 0xf0, 1 }, faint = { 0xa8, 0xac, 0xb4, 1 };
static const struct ink palette[COLOURS] = {
    { 0xe6, 0x9f, 0x00, 1 }, { 0x56, 0xb4, 0xe9, 1 }, { 0x00, 0x9e, 0x73, 1 }, { 0xf0, 0xe4, 0x42, 1 },
    { 0x3d, 0x8b, 0xd4, 1 }, { 0xe8, 0x6a, 0x10, 1 }, { 0xcc, 0x79, 0xa7, 1 }, { 0xc8, 0xc8, 0xc8, 1 },
};

struct sketch {
    struct wall_picture picture;
    const struct wall_def *d;
    const struct wall_layout *l;
    double cell, left, top; /* of the whole wall in the picture, whose corner may lie outside */
    double right;           /* where the part that is drawn ends */
};

static struct ink thin(struct ink ink, double alpha)
{
    ink.alpha = alpha;
    return ink;
}

static double centre_x(const struct sketch *s, int32_t pixel) { return s->left + s->cell * (pixel % (int32_t)s->d->width + 0.5); }
static double centre_y(const struct sketch *s, int32_t pixel) { return s->top + s->cell * (pixel / (int32_t)s->d->width + 0.5); }

/* ---- cells ---------------------------------------------------------------------------------------------------------- */

/* Eight colours in four shapes: full, round, small, hollow. */
static void draw_cell(struct wall_picture *c, double x, double y, double size, unsigned board, double alpha)
{
    const struct ink ink = thin(palette[board % COLOURS], alpha);
    const double gap = size >= 4 ? size * 0.06 : 0, full = size - 2 * gap;
    const unsigned shape = board / COLOURS % 4;
    if (shape == 0 || size < 4)
        canvas_rectangle(c, x + gap, y + gap, full, full, size >= 6 ? size * 0.15 : 0, ink);
    else if (shape == 1)
        canvas_rectangle(c, x + gap, y + gap, full, full, full / 2, ink);
    else if (shape == 2)
        canvas_rectangle(c, x + size / 4, y + size / 4, size / 2, size / 2, 0, ink);
    else
        canvas_frame(c, x + gap, y + gap, full, full, fmax(1, size / 6), ink);
}

static void draw_panels(struct sketch *s)
{
    for (unsigned i = 0; i < s->d->n_panels; i++) {
        const struct wall_panel *p = &s->d->panel[i];
        uint32_t w, h;
        wall_panel_size(p, &w, &h);
        canvas_rectangle(&s->picture, s->left + p->x * s->cell, s->top + p->y * s->cell, w * s->cell, h * s->cell, 0, unlit);
    }
}

static void draw_leds(struct sketch *s, unsigned board)
{
    const struct wall_board_map *b = &s->l->board[board];
    for (uint32_t k = 0; k < b->leds; k++) {
        const int32_t p = b->pixel[k];
        if (p < 0)
            continue;
        draw_cell(&s->picture, centre_x(s, p) - s->cell / 2, centre_y(s, p) - s->cell / 2, s->cell, board,
                  s->cell >= CELL_WIRES ? 0.42 : 0.9);
        if (s->cell >= CELL_NUMBERS) {
            char number[12];
            snprintf(number, sizeof(number), "%u", k);
            const unsigned scale = s->cell >= 2 * CELL_NUMBERS ? 2 : 1;
            canvas_text(&s->picture, centre_x(s, p) - s->cell * 0.38, centre_y(s, p) + s->cell * 0.40 - canvas_text_height(scale), scale,
                        thin(bright, 0.85), number);
        }
    }
}

/* ---- wires ---------------------------------------------------------------------------------------------------------- */

static bool is_step(const struct sketch *s, int32_t a, int32_t b)
{
    const int32_t w = (int32_t)s->d->width, dx = a % w - b % w, dy = a / w - b / w;
    return dx * dx + dy * dy == 1;
}

/* Does the chain begin anew at LED k? The line is not drawn from the one before then. */
static bool begins(const struct wall_board_map *b, uint32_t k, uint32_t strip)
{
    return b->pixel[k] >= 0 && (k % strip == 0 || b->pixel[k - 1] < 0);
}

static void draw_wire(struct sketch *s, unsigned board)
{
    const struct wall_board_map *b = &s->l->board[board];
    const struct ink ink = bright;
    const double width = fmax(1, s->cell * 0.08);
    double before_x = 0, before_y = 0; /* the last step's direction */
    for (uint32_t k = 1; k < b->leds; k++) {
        if (b->pixel[k] < 0 || begins(b, k, s->d->board[board].width)) {
            before_x = before_y = 0;
            continue;
        }
        const double x0 = centre_x(s, b->pixel[k - 1]), y0 = centre_y(s, b->pixel[k - 1]);
        const double x1 = centre_x(s, b->pixel[k]), y1 = centre_y(s, b->pixel[k]), length = hypot(x1 - x0, y1 - y0);
        const double dx = (x1 - x0) / length, dy = (y1 - y0) / length;
        const bool step = is_step(s, b->pixel[k - 1], b->pixel[k]);
        canvas_line(&s->picture, x0, y0, x1, y1, step ? width : fmax(1, width / 2), thin(ink, step ? 0.8 : 0.35));
        if (step && (fabs(dx - before_x) > 0.01 || fabs(dy - before_y) > 0.01))
            canvas_head(&s->picture, (x0 + x1) / 2 + dx * s->cell * 0.2, (y0 + y1) / 2 + dy * s->cell * 0.2, dx, dy, s->cell * 0.4, ink);
        before_x = dx;
        before_y = dy;
    }
}

static void draw_label(struct sketch *s, double x, double y, unsigned scale, struct ink ink, const char *text)
{
    const double pad = 2.0 * scale;
    canvas_rectangle(&s->picture, x - pad, y - pad, canvas_text_width(scale, text) + 2 * pad, canvas_text_height(scale) + 2 * pad, pad,
                     thin(paper, 0.8));
    canvas_text(&s->picture, x, y, scale, ink, text);
}

static void draw_begin(struct sketch *s, unsigned board, uint32_t k)
{
    char text[24];
    const int32_t p = s->l->board[board].pixel[k];
    const double x = centre_x(s, p), y = centre_y(s, p), radius = fmax(3, s->cell * 0.4);
    canvas_ring(&s->picture, x, y, radius, fmax(1.5, radius * 0.28), bright);
    snprintf(text, sizeof(text), "%u:%u", board + 1, k);
    const unsigned scale = s->cell >= 22 ? 2 : 1;
    if (s->cell < 8)
        return;
    // Held inside the wall, where the next panel's rings do not hide it.
    const double w = canvas_text_width(scale, text);
    const double at = x + radius + 3.0 * scale + w <= s->right ? x + radius + 3.0 * scale : x - radius - 3.0 * scale - w;
    draw_label(s, at, y - canvas_text_height(scale) / 2, scale, bright, text);
}

/* Of a chain the first LED of each strip and run, where a wire starts; of a display the first of each panel. */
static void draw_begins(struct sketch *s, unsigned board)
{
    const struct wall_board_map *b = &s->l->board[board];
    const bool chain = s->d->board[board].kind == WALL_FADECANDY;
    bool seen[WALL_PANELS_MAX] = { false };
    for (uint32_t k = 0; k < b->leds; k++) {
        if (b->pixel[k] < 0)
            continue;
        const bool first = !seen[b->panel[k]];
        seen[b->panel[k]] = true;
        if (first || (chain && begins(b, k, s->d->board[board].width)))
            draw_begin(s, board, k);
    }
}

/* ---- words ---------------------------------------------------------------------------------------------------------- */

static void draw_names(struct sketch *s)
{
    for (unsigned i = 0; i < s->d->n_panels; i++) {
        const struct wall_panel *p = &s->d->panel[i];
        uint32_t w, h;
        wall_panel_size(p, &w, &h);
        const double x = s->left + p->x * s->cell, y = s->top + p->y * s->cell;
        canvas_frame(&s->picture, x, y, w * s->cell, h * s->cell, s->cell >= CELL_WIRES ? 2 : 1, thin(bright, 0.7));
        for (unsigned scale = 4; scale >= 1; scale--) {
            const double tw = canvas_text_width(scale, p->name), th = canvas_text_height(scale);
            if (tw > w * s->cell * 0.6 || th > h * s->cell * 0.3)
                continue;
            draw_label(s, x + (w * s->cell - tw) / 2, y + (h * s->cell - th) / 2, scale, bright, p->name);
            break;
        }
    }
}

static uint32_t lit_leds(const struct wall_board_map *b, uint32_t *strips)
{
    uint32_t lit = 0, used[8] = { 0 };
    for (uint32_t k = 0; k < b->leds; k++)
        if (b->pixel[k] >= 0) {
            lit++;
            used[k / 64 % 8] = 1;
        }
    *strips = 0;
    for (unsigned i = 0; i < 8; i++)
        *strips += used[i];
    return lit;
}

static void legend_text(const struct sketch *s, unsigned board, char *out, size_t size)
{
    uint32_t strips;
    const struct wall_board *b = &s->d->board[board];
    const uint32_t lit = lit_leds(&s->l->board[board], &strips);
    const bool named = strcmp(b->name, b->serial) != 0;
    int used = snprintf(out, size, "%2u  %s%s%s %s, %u LEDs", board + 1, named ? b->name : "", named ? "  " : "",
                        b->kind == WALL_FADECANDY ? "fadecandy" : "gud", b->serial, lit);
    if (b->kind == WALL_FADECANDY)
        snprintf(out + used, size - (size_t)used, " on %u strip%s", strips, strips == 1 ? "" : "s");
    else
        snprintf(out + used, size - (size_t)used, " of %u x %u", b->width, b->height);
}

static void draw_legend(struct sketch *s, double y)
{
    static const char *const help[] = { "ring: first LED of a strip, run or panel, marked board:LED (strip N begins at LED 64 N)",
                                        "line: the wire, arrow heads where it turns; thin: it jumps", "grey: LEDs on no board" };
    char text[200];
    for (unsigned i = 0; i < s->d->n_boards; i++, y += ROW) {
        draw_cell(&s->picture, MARGIN, y - 2, 18, i, 1);
        legend_text(s, i, text, sizeof(text));
        canvas_text(&s->picture, MARGIN + 26, y, TEXT_SCALE, bright, text);
    }
    y += ROW / 3;
    for (unsigned i = 0; i < sizeof(help) / sizeof(help[0]); i++, y += ROW)
        canvas_text(&s->picture, MARGIN, y, TEXT_SCALE, faint, help[i]);
}

static double legend_width(const struct sketch *s)
{
    char text[200];
    double widest = 1040; /* the lines of help */
    for (unsigned i = 0; i < s->d->n_boards; i++) {
        legend_text(s, i, text, sizeof(text));
        widest = fmax(widest, 26 + canvas_text_width(TEXT_SCALE, text));
    }
    return widest;
}

/* ---- whole pictures ------------------------------------------------------------------------------------------------- */

static unsigned cell_for(uint32_t width, uint32_t height, unsigned cell)
{
    const uint32_t longer = width > height ? width : height;
    if (cell)
        return cell < CELL_MAX ? cell : CELL_MAX;
    const unsigned fit = LONG_SIDE / longer;
    return fit < 1 ? 1 : fit > CELL_AUTO_MAX ? CELL_AUTO_MAX : fit;
}

/* The part of the canvas that is drawn: what has panels, and a pixel around it. A machine's share of a large wall is seen
 * as large as a wall of that size. */
struct part {
    uint32_t x0, y0, x1, y1;
};

static struct part part_of(const struct wall_def *d, const struct wall_layout *l)
{
    return (struct part){ l->x0 ? l->x0 - 1 : 0, l->y0 ? l->y0 - 1 : 0, l->x1 < d->width ? l->x1 + 1 : d->width,
                          l->y1 < d->height ? l->y1 + 1 : d->height };
}

static void subtitle(const struct wall_def *d, const struct wall_layout *l, const struct part *part, char *out, size_t size)
{
    const int used = snprintf(out, size, "%u x %u pixels, %u LEDs on %u board%s", d->width, d->height, l->lit, d->n_boards,
                              d->n_boards == 1 ? "" : "s");
    if (part->x1 - part->x0 < d->width || part->y1 - part->y0 < d->height)
        snprintf(out + used, size - (size_t)used, "; shown from pixel %u, %u to %u, %u", part->x0, part->y0, part->x1 - 1, part->y1 - 1);
}

int wall_draw_layout(struct wall_picture *out, const struct wall_def *d, const struct wall_layout *l, unsigned cell, struct fault *f)
{
    const struct part part = part_of(d, l);
    const uint32_t width = part.x1 - part.x0, height = part.y1 - part.y0;
    struct sketch s = { .d = d, .l = l, .cell = cell_for(width, height, cell) };
    char size[160];
    subtitle(d, l, &part, size, sizeof(size));
    const double top = MARGIN + canvas_text_height(TITLE_SCALE) + ROW + ROW / 2, wall_w = width * s.cell, wall_h = height * s.cell;
    const double foot = top + wall_h + ROW, legend = ROW * (d->n_boards + 3.5);
    const double words = fmax(canvas_text_width(TITLE_SCALE, d->name), canvas_text_width(TEXT_SCALE, size));
    const double widest = fmax(fmax(wall_w, legend_width(&s)), words);
    s.left = MARGIN - part.x0 * s.cell;
    s.top = top - part.y0 * s.cell;
    s.right = MARGIN + wall_w;
    if (canvas_init(&s.picture, (uint64_t)widest + 2 * MARGIN, (uint64_t)(foot + legend) + MARGIN / 2, paper, f) < 0)
        return -1;
    canvas_text(&s.picture, MARGIN, MARGIN, TITLE_SCALE, bright, d->name);
    canvas_text(&s.picture, MARGIN, MARGIN + canvas_text_height(TITLE_SCALE) + 10, TEXT_SCALE, faint, size);
    canvas_rectangle(&s.picture, MARGIN, top, wall_w, wall_h, 0, ground);
    draw_panels(&s);
    for (unsigned i = 0; i < d->n_boards; i++)
        draw_leds(&s, i);
    for (unsigned i = 0; i < d->n_boards && s.cell >= CELL_WIRES; i++)
        if (d->board[i].kind == WALL_FADECANDY)
            draw_wire(&s, i);
    draw_names(&s);
    for (unsigned i = 0; i < d->n_boards; i++)
        draw_begins(&s, i);
    draw_legend(&s, foot);
    *out = s.picture;
    return 0;
}

int wall_draw_pixels(struct wall_picture *out, uint32_t width, uint32_t height, const uint8_t *rgb, unsigned cell, struct fault *f)
{
    struct wall_picture c;
    const unsigned size = cell_for(width, height, cell);
    const double gap = size >= 4 ? size * 0.06 : 0;
    if (canvas_init(&c, (uint64_t)width * size, (uint64_t)height * size, (struct ink){ 0, 0, 0, 1 }, f) < 0)
        return -1;
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++) {
            const uint8_t *p = rgb + 3 * ((size_t)y * width + x);
            canvas_rectangle(&c, x * (double)size + gap, y * (double)size + gap, size - 2 * gap, size - 2 * gap, size >= 4 ? size * 0.2 : 0,
                             (struct ink){ p[0], p[1], p[2], 1 });
        }
    *out = c;
    return 0;
}
