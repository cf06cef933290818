// SPDX-License-Identifier: Apache-2.0
// wall_def_panels.c - the panels of a wall definition: single ones, and grids of equal ones; and panels by name.
//
// Invariant: panels are in the order of the text, a grid's in the order of its wiring, so that "a-1 to a-8" is a range.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "wall_def_internal.h"

enum { GRID_NAME_MAX = WALL_NAME_MAX - 1 - 6 }; /* room for "-" and a uint16_t */
enum { NAME, AT, SIZE, ROTATE, FLIP, WIRING, GAIN, GRID, GAP, ORDER, KEYS };
static const char *const keys[KEYS] = { "name", "at", "size", "rotate", "flip", "wiring", "gain", "grid", "gap", "grid order" };

static int by_name(const void *a, const void *b)
{
    const struct wall_group *p = a, *q = b;
    const int order = strcmp(p->name, q->name);
    return order ? order : p->at->line < q->at->line ? -1 : p->at->line > q->at->line;
}

void wall_read_wiring(struct wall_reader *r, const struct wall_node *n, struct wall_wiring *out)
{
    static const char *const wiring_keys[3] = { "run", "serpentine", "origin" };
    const struct wall_node *v[3];
    unsigned word;
    if (!n || !wall_keys(r, n, wiring_keys, 3, v))
        return;
    if (wall_word(r, v[0], "rows columns", &word))
        out->columns = word == 1;
    wall_yes(r, v[1], &out->serpentine);
    if (wall_word(r, v[2], "top-left top-right bottom-left bottom-right", &word))
        out->origin = (enum wall_corner)word;
}

/* Three gains, or one for all. */
static void read_gain(struct wall_reader *r, const struct wall_node *n, float out[3])
{
    double v[3];
    if (n && n->kind == NODE_LIST) {
        if (!wall_numbers(r, n, 3, 0, 1, "gains of R, G, B", v))
            return;
    } else if (wall_number(r, n, 0, 1, "a gain", v)) {
        v[1] = v[2] = v[0];
    } else {
        return;
    }
    for (unsigned i = 0; i < 3; i++)
        out[i] = (float)v[i];
}

static void read_turn(struct wall_reader *r, const struct wall_node *rotate, const struct wall_node *flip, struct wall_panel *p)
{
    unsigned word;
    if (wall_word(r, rotate, "0 90 180 270", &word))
        p->rotate = 90 * word;
    if (wall_word(r, flip, "none horizontal vertical both", &word)) {
        p->flip_x = word & 1;
        p->flip_y = word >> 1;
    }
}

struct grid {
    bool asked;
    uint32_t count[2], gap[2];
    struct wall_wiring order;
};

static bool read_grid(struct wall_reader *r, const struct wall_node *entry, const struct wall_node *count,
                      const struct wall_node *gap, const struct wall_node *order, struct grid *g)
{
    *g = (struct grid){ .asked = count != NULL, .count = { 1, 1 } };
    if (!count && (gap || order)) {
        wall_mistake(r, gap ? gap : order, "there is no grid; expected \"grid: [across, down]\" beside it");
        return false;
    }
    bool good = !count || wall_pair(r, count, 1, WALL_PANELS_MAX, "panels across and down", g->count);
    good = (!gap || wall_pair(r, gap, 0, WALL_SIDE_MAX, "wall pixels between the panels, across and down", g->gap)) && good;
    wall_read_wiring(r, order, &g->order);
    const uint64_t all = (uint64_t)g->count[0] * g->count[1];
    if (all > WALL_PANELS_MAX - r->d->n_panels) {
        wall_mistake(r, count ? count : entry, "%llu more panels; expected at most %u in all", (unsigned long long)all, WALL_PANELS_MAX);
        return false;
    }
    return good;
}

/* The k-th panel of a grid hangs in this column and row: a panel's wiring with panels for LEDs. */
static void grid_cell(const struct grid *g, uint32_t k, uint32_t *column, uint32_t *row)
{
    const struct wall_panel as = { .width = g->count[0], .height = g->count[1], .columns = g->order.columns,
                                   .serpentine = g->order.serpentine, .origin = g->order.origin };
    wall_panel_led(&as, k, column, row);
}

static bool inside_wall(struct wall_reader *r, const struct wall_node *n, const struct wall_panel *p, uint64_t x, uint64_t y)
{
    uint32_t w, h;
    const uint32_t width = r->size_given && r->d->width ? r->d->width : WALL_SIDE_MAX;
    const uint32_t height = r->size_given && r->d->width ? r->d->height : WALL_SIDE_MAX;
    wall_panel_size(p, &w, &h);
    if (x + w <= width && y + h <= height)
        return true;
    wall_mistake(r, n, "panel %s reaches from %llu, %llu to %llu, %llu; expected inside the wall's %u x %u", p->name,
                 (unsigned long long)x, (unsigned long long)y, (unsigned long long)x + w, (unsigned long long)y + h, width, height);
    return false;
}

static void add_group(struct wall_reader *r, const char *name, unsigned first, unsigned count, const struct wall_node *at)
{
    // Entries and panels are at most as many as text and panels allow; a name more is only not found.
    if (r->n_groups == WALL_GROUPS_MAX)
        return;
    struct wall_group *g = &r->group[r->n_groups++];
    *g = (struct wall_group){ .first = first, .count = count, .at = at };
    snprintf(g->name, sizeof(g->name), "%s", name);
}

/* Adds the grid's panels (of no grid: one), up to the first that has no place. */
static void add_panels(struct wall_reader *r, const struct wall_node *n, const struct wall_panel *model, const struct grid *g)
{
    uint32_t w, h, column, row;
    struct wall_def *d = r->d;
    wall_panel_size(model, &w, &h);
    for (uint32_t k = 0; k < g->count[0] * g->count[1]; k++) {
        struct wall_panel *p = &d->panel[d->n_panels];
        *p = *model;
        if (g->asked)
            snprintf(p->name, sizeof(p->name), "%.*s-%u", (int)GRID_NAME_MAX, model->name, (unsigned)(uint16_t)(k + 1));
        grid_cell(g, k, &column, &row);
        const uint64_t x = model->x + (uint64_t)column * (w + g->gap[0]), y = model->y + (uint64_t)row * (h + g->gap[1]);
        const bool good = inside_wall(r, n, p, x, y);
        if (g->asked || !good)
            add_group(r, p->name, d->n_panels, good, n);
        if (!good)
            break;
        p->x = (uint32_t)x;
        p->y = (uint32_t)y;
        r->panel_at[d->n_panels++] = n;
    }
}

/* True: the panel can be placed. */
static bool read_model(struct wall_reader *r, const struct wall_node *n, const struct wall_node *const v[], struct wall_panel *p)
{
    struct wall_wiring wiring = { false, false, WALL_TOP_LEFT };
    uint32_t at[2] = { 0, 0 }, size[2] = { 1, 1 };
    bool good = !v[AT] || wall_pair(r, v[AT], 0, WALL_SIDE_MAX - 1, "x, y of the panel's top left corner on the wall", at);
    if (!v[SIZE])
        wall_mistake(r, n, "panel %s has no size; expected \"size: [LEDs across, LEDs down]\"", p->name);
    good = wall_pair(r, v[SIZE], 1, WALL_SIDE_MAX, "LEDs across and down", size) && good;
    read_turn(r, v[ROTATE], v[FLIP], p);
    wall_read_wiring(r, v[WIRING], &wiring);
    read_gain(r, v[GAIN], p->gain);
    p->x = at[0];
    p->y = at[1];
    p->width = size[0];
    p->height = size[1];
    p->columns = wiring.columns;
    p->serpentine = wiring.serpentine;
    p->origin = wiring.origin;
    return good;
}

static void read_panel(struct wall_reader *r, const struct wall_node *n)
{
    const struct wall_node *v[KEYS];
    struct wall_panel p = { .gain = { 1, 1, 1 }, .line = n->line };
    struct grid grid;
    if (!wall_keys(r, n, keys, KEYS, v))
        return;
    snprintf(p.name, sizeof(p.name), "%s-%u", v[GRID] ? "grid" : "panel", n->index + 1);
    wall_text(r, v[NAME], "a name", p.name, v[GRID] ? GRID_NAME_MAX + 1 : sizeof(p.name));
    bool good = read_model(r, n, v, &p);
    good = read_grid(r, n, v[GRID], v[GAP], v[ORDER], &grid) && good;
    const unsigned before = r->d->n_panels;
    if (good)
        add_panels(r, n, &p, &grid);
    // What has a mistake keeps its name, so that the boards that name it are not called mistaken, too.
    const bool whole = r->d->n_panels - before == grid.count[0] * grid.count[1];
    if (grid.asked || r->d->n_panels > before || !good)
        add_group(r, p.name, before, whole ? r->d->n_panels - before : 0, n);
}

void wall_read_panels(struct wall_reader *r, const struct wall_node *n)
{
    for (const struct wall_node *e = wall_elements(r, n, "panels"); e; e = e->next)
        read_panel(r, e);
    qsort(r->group, r->n_groups, sizeof(*r->group), by_name);
    for (unsigned i = 1; i < r->n_groups; i++)
        if (strcmp(r->group[i].name, r->group[i - 1].name) == 0)
            wall_mistake(r, r->group[i].at, "two panels are named \"%s\" (the other in line %u); expected each name once",
                         r->group[i].name, r->group[i - 1].at->line);
}

/* ---- names ---------------------------------------------------------------------------------------------------- */

static const struct wall_group *group_find(const struct wall_reader *r, const char *name)
{
    unsigned low = 0, high = r->n_groups;
    while (low < high) {
        const unsigned middle = (low + high) / 2;
        const int order = strcmp(r->group[middle].name, name);
        if (order == 0)
            return &r->group[middle];
        if (order < 0)
            low = middle + 1;
        else
            high = middle;
    }
    return NULL;
}

/* "a-1 to a-8" */
static bool range_find(const struct wall_reader *r, const char *text, const struct wall_group **a, const struct wall_group **b)
{
    char first[WALL_NAME_MAX];
    const char *to = strstr(text, " to ");
    if (!to || (size_t)(to - text) >= sizeof(first))
        return false;
    memcpy(first, text, (size_t)(to - text));
    first[to - text] = '\0';
    *a = group_find(r, first);
    *b = group_find(r, to + 4);
    return *a && *b;
}

bool wall_panels_named(struct wall_reader *r, const struct wall_node *n, unsigned *first, unsigned *count)
{
    const struct wall_group *a = n->kind == NODE_TEXT ? group_find(r, n->text) : NULL, *b = a;
    if (!a && (n->kind != NODE_TEXT || !range_find(r, n->text, &a, &b))) {
        wall_mistake(r, n, "%s; expected the name of a panel or grid, or \"NAME to NAME\"", wall_found(n).s);
        return false;
    }
    if (!a->count || !b->count)
        return false; /* said already */
    if (b->first < a->first) {
        wall_mistake(r, n, "%s goes backwards; expected panels in the order in which they are defined", wall_found(n).s);
        return false;
    }
    *first = a->first;
    *count = b->first + b->count - a->first;
    return true;
}
