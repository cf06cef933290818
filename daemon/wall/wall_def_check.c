// SPDX-License-Identifier: Apache-2.0
// wall_def_check.c - what contradicts what in a wall definition: names said twice, panels on top of each other, LEDs that
// are driven or fed twice; and what is possible, but perhaps not meant.
//
// Invariant: nothing here takes more than n log n steps: panels are painted into one map of the wall, each stopping at its
// first collision, and runs are sorted.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "wall_def_internal.h"

/* ---- names: boards and supplies are few enough for pairs ------------------------------------------------------------ */

static void check_boards(struct wall_reader *r)
{
    const struct wall_def *d = r->d;
    uint64_t leds = 0;
    for (unsigned i = 0; i < d->n_boards; i++) {
        leds += (uint64_t)d->board[i].width * d->board[i].height;
        for (unsigned k = 0; k < i; k++) {
            const struct wall_board *a = &d->board[k], *b = &d->board[i];
            if (*b->serial && a->kind == b->kind && strcmp(a->serial, b->serial) == 0)
                wall_mistake(r, r->board_at[i], "serial \"%s\" is also that of the board in line %u; expected each board once", b->serial,
                             a->line);
            else if (*b->name && strcmp(a->name, b->name) == 0)
                wall_mistake(r, r->board_at[i], "two boards are named \"%s\" (the other in line %u); expected each name once", b->name,
                             a->line);
        }
    }
    if (leds > WALL_LEDS_MAX)
        wall_mistake(r, r->board_at[0], "the boards have %llu LEDs in all; expected at most %u", (unsigned long long)leds, WALL_LEDS_MAX);
    for (unsigned i = 0; i < d->n_supplies; i++)
        for (unsigned k = 0; k < i; k++)
            if (strcmp(d->supply[k].name, d->supply[i].name) == 0)
                wall_mistake(r, r->supply_at[i], "two supplies are named \"%s\" (the other in line %u); expected each name once",
                             d->supply[i].name, d->supply[k].line);
}

/* ---- panels --------------------------------------------------------------------------------------------------------- */

/* The canvas where no size is said: as far as the panels reach. False: it is too large. */
static bool settle_size(struct wall_reader *r)
{
    struct wall_def *d = r->d;
    if (r->size_given)
        return d->width > 0;
    for (unsigned i = 0; i < d->n_panels; i++) {
        uint32_t w, h;
        wall_panel_size(&d->panel[i], &w, &h);
        d->width = d->panel[i].x + w > d->width ? d->panel[i].x + w : d->width;
        d->height = d->panel[i].y + h > d->height ? d->panel[i].y + h : d->height;
    }
    if ((uint64_t)d->width * d->height <= WALL_PIXELS_MAX)
        return d->width > 0;
    wall_mistake(r, NULL, "the panels reach to %u x %u, %llu pixels; expected at most %u", d->width, d->height,
                 (unsigned long long)d->width * d->height, WALL_PIXELS_MAX);
    return false;
}

/* Paints a panel's place with its number + 1; stops at a pixel that is painted already: its panel, or -1. */
static int paint(uint16_t *owner, uint32_t width, const struct wall_panel *p, unsigned index, uint32_t at[2])
{
    uint32_t w, h;
    wall_panel_size(p, &w, &h);
    for (at[1] = p->y; at[1] < p->y + h; at[1]++)
        for (at[0] = p->x; at[0] < p->x + w; at[0]++) {
            uint16_t *o = &owner[(size_t)at[1] * width + at[0]];
            if (*o)
                return *o - 1;
            *o = (uint16_t)(index + 1);
        }
    return -1;
}

static void check_panels(struct wall_reader *r)
{
    const struct wall_def *d = r->d;
    if (!settle_size(r))
        return;
    uint16_t *owner = calloc((size_t)d->width * d->height, sizeof(*owner));
    if (!owner) {
        r->no_memory = true;
        return;
    }
    for (unsigned i = 0; i < d->n_panels; i++) {
        uint32_t at[2];
        const int other = paint(owner, d->width, &d->panel[i], i, at);
        if (other >= 0)
            wall_mistake(r, r->panel_at[i], "panel %s lies on panel %s (line %u) at wall pixel %u, %u; expected each pixel in one panel",
                         d->panel[i].name, d->panel[other].name, d->panel[other].line, at[0], at[1]);
    }
    free(owner);
}

/* ---- runs --------------------------------------------------------------------------------------------------------- */

static int by_board(const void *pa, const void *pb)
{
    const struct wall_run *a = &((const struct wall_run_at *)pa)->run, *b = &((const struct wall_run_at *)pb)->run;
    if (a->board != b->board)
        return a->board < b->board ? -1 : 1;
    return a->at < b->at ? -1 : a->at > b->at;
}

static int by_panel(const void *pa, const void *pb)
{
    const struct wall_run *a = &((const struct wall_run_at *)pa)->run, *b = &((const struct wall_run_at *)pb)->run;
    if (a->panel != b->panel)
        return a->panel < b->panel ? -1 : 1;
    return a->first < b->first ? -1 : a->first > b->first;
}

/* Of two runs the one that is said later. */
static bool is_later(const struct wall_run_at *a, const struct wall_run_at *b)
{
    return a->at->line != b->at->line ? a->at->line > b->at->line : a->at->column > b->at->column;
}

/* Told once for two entries of the text, which may be many rows of a display: `pair` is the last that was told. */
static bool is_new(const struct wall_node *pair[2], const struct wall_node *a, const struct wall_node *b)
{
    if (pair[0] == a && pair[1] == b)
        return false;
    pair[0] = a;
    pair[1] = b;
    return true;
}

static void check_driven_twice(struct wall_reader *r)
{
    const struct wall_node *pair[2] = { NULL, NULL };
    qsort(r->run, r->d->n_runs, sizeof(*r->run), by_panel);
    const struct wall_run_at *reach = r->run; /* of those before, on this panel, the one that reaches farthest */
    for (unsigned i = 1; i < r->d->n_runs; i++) {
        const struct wall_run_at *b = &r->run[i];
        if (b->run.panel == reach->run.panel && b->run.first < reach->run.first + reach->run.count) {
            const bool later = is_later(b, reach);
            const struct wall_run_at *now = later ? b : reach, *then = later ? reach : b;
            if (is_new(pair, now->at, then->at))
                wall_mistake(r, now->at, "LED %u of panel %s is driven already by board %s (line %u); expected one board LED each",
                             b->run.first, r->d->panel[b->run.panel].name, r->d->board[then->run.board].name, then->at->line);
        }
        if (b->run.panel != reach->run.panel || b->run.first + b->run.count > reach->run.first + reach->run.count)
            reach = b;
    }
}

static void check_fed_twice(struct wall_reader *r)
{
    const struct wall_node *pair[2] = { NULL, NULL };
    qsort(r->run, r->d->n_runs, sizeof(*r->run), by_board);
    const struct wall_run_at *reach = r->run;
    for (unsigned i = 1; i < r->d->n_runs; i++) {
        const struct wall_run_at *b = &r->run[i];
        if (b->run.board == reach->run.board && b->run.at < reach->run.at + reach->run.count) {
            const bool later = is_later(b, reach);
            const struct wall_run_at *now = later ? b : reach, *then = later ? reach : b;
            if (is_new(pair, now->at, then->at))
                wall_mistake(r, now->at, "LED %u of board %s shows panel %s already (line %u); expected one panel LED each", b->run.at,
                             r->d->board[b->run.board].name, r->d->panel[then->run.panel].name, then->at->line);
        }
        if (b->run.board != reach->run.board || b->run.at + b->run.count > reach->run.at + reach->run.count)
            reach = b;
    }
}

/* ---- notes ---------------------------------------------------------------------------------------------------------- */

static void note_undriven(struct wall_reader *r)
{
    const struct wall_def *d = r->d;
    uint32_t driven[WALL_PANELS_MAX] = { 0 };
    for (unsigned i = 0; i < d->n_runs; i++)
        driven[r->run[i].run.panel] += r->run[i].run.count;
    for (unsigned i = 0; i < d->n_panels && d->n_boards; i++) {
        const uint32_t leds = d->panel[i].width * d->panel[i].height;
        if (driven[i] < leds)
            wall_note(r, r->panel_at[i], "panel %s: %u of its %u LEDs are on no board and stay dark", d->panel[i].name, leds - driven[i],
                      leds);
    }
}

/* LED section 1: 1600 bytes are at least 1.32 ms of a full-speed bus; at most 10 boards a transaction translator at 60 fps. A
 * high-speed bus carries about 40 MB/s in bulk. */
static void note_bus(struct wall_reader *r)
{
    const struct wall_def *d = r->d;
    unsigned fadecandies = 0;
    double display_bytes = 0;
    for (unsigned i = 0; i < d->n_boards; i++)
        if (d->board[i].kind == WALL_FADECANDY)
            fadecandies++;
        else
            display_bytes += 3.0 * d->board[i].width * d->board[i].height;
    if (fadecandies * d->rate > 600)
        wall_note(r, r->rate_at ? r->rate_at : r->board_at[0], "%u fadecandies at %.6g frames per second need %.3g ms of bus in each "
                  "%.3g ms; spread them over %.0f buses or hubs with a translator of their own", fadecandies, d->rate, fadecandies * 1.32,
                  1000 / d->rate, ceil(fadecandies * d->rate / 600));
    if (display_bytes * d->rate > 40e6)
        wall_note(r, r->rate_at ? r->rate_at : r->board_at[0], "the displays take %.3g MB/s uncompressed; a high-speed bus carries about "
                  "40 MB/s", display_bytes * d->rate * 1e-6);
}

void wall_def_check(struct wall_reader *r)
{
    struct wall_def *d = r->d;
    check_boards(r);
    check_panels(r);
    if (d->n_runs) {
        check_driven_twice(r);
        check_fed_twice(r);
    }
    for (unsigned i = 0; i < d->n_runs; i++)
        d->run[i] = r->run[i].run;
    if (r->m->count)
        return; /* notes about what is not whole would only mislead */
    note_undriven(r);
    note_bus(r);
}
