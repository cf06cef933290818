// SPDX-License-Identifier: Apache-2.0
// wall_pattern.c - test patterns as drive of the wall's own pixels, so that they go through the same mapping, colour orders and
// limits as pictures. Invariant: what the check at the start passes can be drawn at any time.
#include <math.h>
#include <string.h>

#include "wall.h"

static const char *const words[] = { "", "order", "panels", "red", "green", "blue", "white", "ramp", "checker", "led", "black" };
enum { KINDS = sizeof(words) / sizeof(words[0]) };
_Static_assert(KINDS == PATTERN_BLACK + 1, "a word for each pattern");

static const double usual_level = 0.25;
/* Order: LEDs a second, or as many as it takes for a board to be through in 16 s. */
static const double order_pace = 16, order_round_s = 16;

bool wall_pattern_read(enum wall_pattern_kind *out, const char *word)
{
    for (unsigned i = 0; i < KINDS; i++)
        if (strcmp(word, words[i]) == 0) {
            *out = (enum wall_pattern_kind)i;
            return true;
        }
    return false;
}

static int check(const struct wall_def *d, const struct wall_layout *l, const struct wall_pattern *p, struct fault *f)
{
    if ((unsigned)p->kind >= KINDS)
        return fault_set(f, FAULT_PARAM_RANGE, "pattern", "pattern %u: there are %d", (unsigned)p->kind, KINDS);
    if (!(p->level >= 0 && p->level <= 1))
        return fault_set(f, FAULT_PARAM_RANGE, "level", "a level of %g: it is 0 to 1", p->level);
    if (p->kind != PATTERN_LED)
        return 0;
    if (p->board >= d->n_boards)
        return fault_set(f, FAULT_PARAM_RANGE, "board", "board %u: the wall has %u", p->board, d->n_boards);
    const struct wall_board_map *m = &l->board[p->board];
    if (p->led >= m->leds)
        return fault_set(f, FAULT_PARAM_RANGE, "led", "LED %u: board %s has %u, from 0 on", p->led, d->board[p->board].name,
                         m->leds);
    if (m->pixel[p->led] < 0)
        return fault_set(f, FAULT_PARAM_RANGE, "led", "LED %u of board %s belongs to no panel", p->led,
                         d->board[p->board].name);
    return 0;
}

static void put(float *drive, uint32_t pixel, double r, double g, double b)
{
    drive[3 * (size_t)pixel] = (float)r;
    drive[3 * (size_t)pixel + 1] = (float)g;
    drive[3 * (size_t)pixel + 2] = (float)b;
}

static void fill(float *drive, const struct wall_def *d, double r, double g, double b)
{
    for (uint32_t i = 0; i < d->width * d->height; i++)
        put(drive, i, r, g, b);
}

static void draw_order(float *drive, const struct wall_board_map *m, double level, double seconds)
{
    uint32_t leds = 0;
    for (uint32_t k = 0; k < m->leds; k++)
        leds += m->pixel[k] >= 0;
    const double pace = fmax(order_pace, leds / order_round_s);
    const double at = seconds > 0 && leds ? fmod(floor(seconds * pace), leds) : 0;
    uint32_t n = 0;
    for (uint32_t k = 0; k < m->leds && n <= at; k++) {
        if (m->pixel[k] < 0)
            continue;
        const double v = n++ < at ? level / 16 : level;
        put(drive, (uint32_t)m->pixel[k], v, v, v);
    }
}

/* Of a panel, in wall pixels. */
static uint32_t pixel_of(const struct wall_def *d, const struct wall_panel *p, uint32_t i, uint32_t j)
{
    return (p->y + j) * d->width + p->x + i;
}

static void draw_panel_edges(float *drive, const struct wall_def *d, unsigned panel, double level)
{
    const struct wall_panel *p = &d->panel[panel];
    uint32_t width, height, x, y;
    wall_panel_size(p, &width, &height);
    wall_panel_led(p, 0, &x, &y);
    x -= p->x;
    y -= p->y;
    const uint32_t shorter = width < height ? width : height, mark = shorter < 16 ? 1 : shorter / 8;
    const double rest = level * (1 + panel % 4) / 32;
    for (uint32_t j = 0; j < height; j++)
        for (uint32_t i = 0; i < width; i++) {
            const bool edge = i == 0 || j == 0 || i + 1 == width || j + 1 == height;
            const bool corner = (x > i ? x - i : i - x) < mark && (y > j ? y - j : j - y) < mark;
            const double v = edge ? level : rest;
            put(drive, pixel_of(d, p, i, j), corner ? level : v, corner ? 0 : v, corner ? 0 : v);
        }
}

static void draw_panel_ramp(float *drive, const struct wall_def *d, unsigned panel)
{
    const struct wall_panel *p = &d->panel[panel];
    uint32_t width, height;
    wall_panel_size(p, &width, &height);
    for (uint32_t j = 0; j < height; j++)
        for (uint32_t i = 0; i < width; i++) {
            const double v = width > 1 ? (double)i / (width - 1) : 1;
            const unsigned band = (unsigned)((uint64_t)j * 4 / height); // white, red, green, blue
            put(drive, pixel_of(d, p, i, j), band < 2 ? v : 0, band == 0 || band == 2 ? v : 0,
                band == 0 || band == 3 ? v : 0);
        }
}

static void draw_checker(float *drive, const struct wall_def *d, double level)
{
    for (uint32_t y = 0; y < d->height; y++)
        for (uint32_t x = 0; x < d->width; x++) {
            const double v = (x + y) & 1 ? level : 0;
            put(drive, y * d->width + x, v, v, v);
        }
}

static void draw_field(float *drive, const struct wall_def *d, enum wall_pattern_kind kind, double level)
{
    const bool white = kind == PATTERN_WHITE;
    fill(drive, d, white || kind == PATTERN_RED ? level : 0, white || kind == PATTERN_GREEN ? level : 0,
         white || kind == PATTERN_BLUE ? level : 0);
}

int wall_pattern_draw(float *drive, const struct wall_def *d, const struct wall_layout *l, const struct wall_pattern *p,
                      double seconds, struct fault *f)
{
    if (check(d, l, p, f))
        return -1;
    if (!drive)
        return 0;
    const double level = p->level > 0 ? p->level : usual_level;
    memset(drive, 0, 3 * (size_t)d->width * d->height * sizeof(*drive));
    if (p->kind == PATTERN_ORDER)
        for (unsigned b = 0; b < d->n_boards; b++)
            draw_order(drive, &l->board[b], level, seconds);
    else if (p->kind == PATTERN_PANELS)
        for (unsigned i = 0; i < d->n_panels; i++)
            draw_panel_edges(drive, d, i, level);
    else if (p->kind == PATTERN_RAMP)
        for (unsigned i = 0; i < d->n_panels; i++)
            draw_panel_ramp(drive, d, i);
    else if (p->kind == PATTERN_CHECKER)
        draw_checker(drive, d, level);
    else if (p->kind == PATTERN_LED)
        put(drive, (uint32_t)l->board[p->board].pixel[p->led], level, level, level);
    else if (p->kind != PATTERN_NONE && p->kind != PATTERN_BLACK)
        draw_field(drive, d, p->kind, level);
    return 0;
}
