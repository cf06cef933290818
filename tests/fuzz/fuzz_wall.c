// SPDX-License-Identifier: Apache-2.0
//
// fuzz_wall.c - wall_def*.c, wall_layout.c and wall_draw*.c: any text as a wall definition.
//
// What is checked: what parses holds all that wall_def.h says of it, and its layout shows each LED where the panel's wiring
// puts it; what does not parse has mistakes, in the order of the lines.
#include <math.h>
#include <stdbool.h>

#include "fuzz.h"
#include "wall_draw.h"

enum { DRAWN_PIXELS_MAX = 64 * 64, DRAWN_CELL = 6 };

static bool within(double v, double least, double most) { return v >= least && v <= most; }
static bool is_name(const char *s) { return *s && memchr(s, '\0', WALL_NAME_MAX); }

static void check_picture(const struct wall_def *d)
{
    must(is_name(d->name));
    must(d->width >= 1 && d->width <= WALL_SIDE_MAX && d->height >= 1 && d->height <= WALL_SIDE_MAX);
    must((uint64_t)d->width * d->height <= WALL_PIXELS_MAX);
    must(within(d->rate, 1, 240));
    must((within(d->hold_s, 0, 3600) || d->hold_s == (double)INFINITY) && within(d->fade_s, 0, 3600));
    must(d->fit <= WALL_STRETCH && d->tone_map <= WALL_TONE_ACES && d->transfer <= WALL_TRANSFER_SRGB &&
         d->dither <= WALL_DITHER_OFF);
    for (unsigned i = 0; i < 4; i++)
        must(within(d->window[i], 0, 1));
    must(d->window[2] > 0 && d->window[3] > 0);
    must(within(d->saturation, 0, 4) && within(d->brightness, 0, 1) && isfinite(d->gamma) && d->gamma > 0);
    must(isfinite(d->exposure) && isfinite(d->adapt_up_s) && isfinite(d->adapt_down_s));
    for (unsigned i = 0; i < 9; i++)
        must(isfinite(d->matrix[i / 3][i % 3]));
    must(memchr(d->calibration, '\0', sizeof(d->calibration)));
}

static void check_panel(const struct wall_def *d, const struct wall_panel *p)
{
    uint32_t w, h;
    wall_panel_size(p, &w, &h);
    must(is_name(p->name) && p->width >= 1 && p->height >= 1);
    must((uint64_t)p->x + w <= d->width && (uint64_t)p->y + h <= d->height);
    must(p->rotate % 90 == 0 && p->rotate <= 270 && p->origin <= WALL_BOTTOM_RIGHT && p->line >= 1);
    for (unsigned c = 0; c < 3; c++)
        must(within((double)p->gain[c], 0, 1));
}

static void check_board(const struct wall_def *d, const struct wall_board *b)
{
    must(is_name(b->name) && is_name(b->serial) && (unsigned)b->kind < WALL_BOARD_KINDS && b->line >= 1);
    must(b->width >= 1 && b->height >= 1 && (uint64_t)b->width * b->height <= WALL_LEDS_MAX);
    must((1u << b->order[0] | 1u << b->order[1] | 1u << b->order[2]) == 7);
    must(b->supply >= -1 && b->supply < (int)d->n_supplies);
    must(within((double)b->brightness, 0, 1) && within(b->delay_ms, 0, 100));
    must(isfinite(b->idle_amps) && b->idle_amps >= 0);
    for (unsigned c = 0; c < 3; c++)
        must(isfinite(b->led_amps[c]) && b->led_amps[c] >= 0);
}

// No LED is driven twice, no board LED is fed twice; and the layout says the same as the runs.
static void check_runs(const struct wall_def *d, const struct wall_layout *l)
{
    uint32_t lit = 0;
    uint8_t **panel = calloc(d->n_panels + 1, sizeof(*panel)), **board = calloc(d->n_boards + 1, sizeof(*board));
    must(panel && board);
    for (unsigned i = 0; i < d->n_panels; i++)
        must((panel[i] = calloc((size_t)d->panel[i].width * d->panel[i].height, 1)));
    for (unsigned i = 0; i < d->n_boards; i++)
        must((board[i] = calloc(l->board[i].leds, 1)));
    for (unsigned i = 0; i < d->n_runs; i++) {
        const struct wall_run *r = &d->run[i];
        must(r->panel < d->n_panels && r->board < d->n_boards && r->count >= 1);
        must((uint64_t)r->first + r->count <= (uint64_t)d->panel[r->panel].width * d->panel[r->panel].height);
        must((uint64_t)r->at + r->count <= l->board[r->board].leds);
        for (uint32_t k = 0; k < r->count; k++) {
            uint32_t x, y;
            const uint32_t led = r->first + (r->reversed ? r->count - 1 - k : k);
            wall_panel_led(&d->panel[r->panel], led, &x, &y);
            must(x < d->width && y < d->height);
            must(!panel[r->panel][led]++ && !board[r->board][r->at + k]++);
            must(l->board[r->board].pixel[r->at + k] == (int32_t)(y * d->width + x));
            must(l->board[r->board].panel[r->at + k] == r->panel);
        }
        lit += r->count;
        if (i)
            must(r->board > r[-1].board || (r->board == r[-1].board && r->at > r[-1].at));
    }
    must(lit == l->lit);
    for (unsigned i = 0; i < d->n_boards; i++)
        for (uint32_t k = 0; k < l->board[i].leds; k++)
            must(board[i][k] || l->board[i].pixel[k] == -1);
    for (unsigned i = 0; i < d->n_panels; i++)
        free(panel[i]);
    for (unsigned i = 0; i < d->n_boards; i++)
        free(board[i]);
    free(panel);
    free(board);
}

static void check_drawing(const struct wall_def *d, const struct wall_layout *l)
{
    struct wall_picture p;
    struct fault f;
    const uint32_t width = l->x1 - l->x0, height = l->y1 - l->y0;
    if ((uint64_t)width * height > DRAWN_PIXELS_MAX || d->n_panels > 16)
        return;
    if (wall_draw_layout(&p, d, l, DRAWN_CELL, &f) < 0)
        return;
    must(p.width >= width && p.height >= height && p.rgb);
    wall_picture_free(&p);
}

static void check_def(const struct wall_def *d)
{
    struct wall_layout *l;
    struct fault f;
    uint64_t leds = 0;
    must(d->n_panels <= WALL_PANELS_MAX && d->n_boards <= WALL_BOARDS_MAX && d->n_runs <= WALL_RUNS_MAX &&
         d->n_supplies <= WALL_SUPPLIES_MAX);
    check_picture(d);
    for (unsigned i = 0; i < d->n_panels; i++)
        check_panel(d, &d->panel[i]);
    for (unsigned i = 0; i < d->n_boards; i++) {
        check_board(d, &d->board[i]);
        leds += (uint64_t)d->board[i].width * d->board[i].height;
    }
    must(leds <= WALL_LEDS_MAX);
    for (unsigned i = 0; i < d->n_supplies; i++)
        must(is_name(d->supply[i].name) && isfinite(d->supply[i].amps) && d->supply[i].amps >= 0);
    must(!wall_layout_make(&l, d, &f));
    check_runs(d, l);
    check_drawing(d, l);
    wall_layout_free(l);
}

static void check_mistakes(const struct wall_mistakes *m, const struct fault *f)
{
    must(f->code == FAULT_WALL && !strcmp(f->field, "wall") && *f->text);
    must(m->count >= 1 && m->count <= WALL_FAULTS_MAX);
    for (unsigned i = 0; i < m->count; i++) {
        must(*m->at[i].text && memchr(m->at[i].text, '\0', sizeof(m->at[i].text)));
        must(!i || m->at[i].line >= m->at[i - 1].line);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static struct wall_mistakes m;
    struct wall_def *d;
    struct fault f = { .code = FAULT_NONE }, g = { .code = FAULT_NONE };
    const char *text = size ? (const char *)data : "";
    memset(&m, 0, sizeof(m));
    if (wall_def_parse(&d, text, size, &m, &f) < 0) {
        check_mistakes(&m, &f);
        must(wall_def_parse(&d, text, size, NULL, &g) == -1 && !strcmp(f.text, g.text));
        return 0;
    }
    must(!m.count && m.notes <= WALL_NOTES_MAX);
    check_def(d);
    wall_def_free(d);
    return 0;
}
