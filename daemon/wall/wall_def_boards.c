// SPDX-License-Identifier: Apache-2.0
// wall_def_boards.c - the supplies and boards of a wall definition, and which LEDs of a panel hang on which LEDs of a board.
//
// Invariant: runs that are kept are inside their panel and their board; whether they collide, wall_def_check.c says. A
// Fadecandy's LEDs are chains, so panels follow each other in wiring order; a display's are rows of pixels, so panels lie
// on it as rectangles, a run a row.
#include <stdio.h>
#include <string.h>

#include "wall_def_internal.h"

enum { STRIPS = 8, STRIP_LEDS = 64 }; /* of a Fadecandy */

/* ---- supplies --------------------------------------------------------------------------------------------------- */

static void read_supply(struct wall_reader *r, const struct wall_node *n)
{
    static const char *const keys[2] = { "name", "amps" };
    const struct wall_node *v[2];
    struct wall_supply *s = &r->d->supply[r->d->n_supplies];
    double amps = 0;
    if (!wall_keys(r, n, keys, 2, v))
        return;
    if (r->d->n_supplies == WALL_SUPPLIES_MAX) {
        wall_mistake(r, n, "one more supply; expected at most %u", WALL_SUPPLIES_MAX);
        return;
    }
    *s = (struct wall_supply){ .line = n->line };
    if (!v[0])
        wall_mistake(r, n, "the supply has no name; expected \"name: ...\", which boards refer to");
    else if (wall_text(r, v[0], "a name", s->name, sizeof(s->name)))
        r->supply_at[r->d->n_supplies++] = n;
    if (!v[1])
        wall_mistake(r, n, "the supply has no limit; expected \"amps: ...\"");
    if (wall_number(r, v[1], 0.1, 10000, "amps", &amps))
        s->amps = (float)amps;
}

void wall_read_supplies(struct wall_reader *r, const struct wall_node *n)
{
    for (const struct wall_node *e = wall_elements(r, n, "supplies"); e; e = e->next)
        read_supply(r, e);
}

static void find_supply(struct wall_reader *r, const struct wall_node *n, int *out)
{
    if (!n)
        return;
    for (unsigned i = 0; i < r->d->n_supplies && n->kind == NODE_TEXT; i++)
        if (strcmp(r->d->supply[i].name, n->text) == 0) {
            *out = (int)i;
            return;
        }
    wall_mistake(r, n, "%s; expected the name of one of the %u supplies under \"supplies:\"", wall_found(n).s, r->d->n_supplies);
}

/* ---- runs --------------------------------------------------------------------------------------------------------- */

struct placing { /* where the next LEDs go on a board */
    unsigned board;
    uint64_t at;                    /* of a chain */
    uint32_t x, y, row_height;      /* of a display: the next panel's corner */
};

static bool add_run(struct wall_reader *r, const struct wall_node *n, const struct wall_run *run)
{
    if (r->d->n_runs == WALL_RUNS_MAX) {
        wall_mistake(r, n, "one more run of LEDs; expected at most %u on all boards", WALL_RUNS_MAX);
        return false;
    }
    r->run[r->d->n_runs++] = (struct wall_run_at){ *run, n };
    return true;
}

/* `first` and `count` are inside the panel. */
static bool chain(struct wall_reader *r, const struct wall_node *n, struct placing *to, struct wall_run *run)
{
    const struct wall_board *b = &r->d->board[to->board];
    const uint64_t leds = (uint64_t)b->width * b->height;
    if (to->at + run->count > leds) {
        wall_mistake(r, n, "panel %s goes on LEDs %llu to %llu of board %s, which has LEDs 0 to %llu; expected all on the board",
                     r->d->panel[run->panel].name, (unsigned long long)to->at, (unsigned long long)to->at + run->count - 1, b->name,
                     (unsigned long long)leds - 1);
        to->at = leds;
        return false;
    }
    run->at = (uint32_t)to->at;
    to->at += run->count;
    return add_run(r, n, run);
}

static bool plain_rows(const struct wall_panel *p)
{
    return !p->columns && !p->serpentine && p->origin == WALL_TOP_LEFT;
}

/* A panel as a rectangle of a display's pixels, at x, y. */
static bool place_rectangle(struct wall_reader *r, const struct wall_node *n, struct placing *to, unsigned panel)
{
    const struct wall_board *b = &r->d->board[to->board];
    const struct wall_panel *p = &r->d->panel[panel];
    if (!plain_rows(p)) {
        wall_mistake(r, n, "panel %s has a wiring, and board %s is a display; expected none (its pixels have rows and columns)", p->name,
                     b->name);
        return false;
    }
    if ((uint64_t)to->x + p->width > b->width || (uint64_t)to->y + p->height > b->height) {
        wall_mistake(r, n, "panel %s of %u x %u at %u, %u; expected inside the display's %u x %u", p->name, p->width, p->height, to->x,
                     to->y, b->width, b->height);
        return false;
    }
    for (uint32_t row = 0; row < p->height; row++) {
        const struct wall_run run = { .panel = panel, .board = to->board, .first = row * p->width, .count = p->width,
                                      .at = (to->y + row) * b->width + to->x, .line = n->line };
        if (!add_run(r, n, &run))
            return false;
    }
    return true;
}

/* The next panel of a list: on a display to the right of the one before, or below where the row is full. */
static bool place_next(struct wall_reader *r, const struct wall_node *n, struct placing *to, unsigned panel)
{
    const struct wall_board *b = &r->d->board[to->board];
    const struct wall_panel *p = &r->d->panel[panel];
    if (b->kind == WALL_FADECANDY) {
        struct wall_run run = { .panel = panel, .board = to->board, .count = p->width * p->height, .line = n->line };
        return chain(r, n, to, &run);
    }
    if (to->x && (uint64_t)to->x + p->width > b->width) {
        to->x = 0;
        to->y += to->row_height;
        to->row_height = 0;
    }
    if (!place_rectangle(r, n, to, panel))
        return false;
    to->x += p->width;
    to->row_height = p->height > to->row_height ? p->height : to->row_height;
    return true;
}

static bool place_named(struct wall_reader *r, const struct wall_node *n, struct placing *to)
{
    unsigned first, count;
    if (!wall_panels_named(r, n, &first, &count))
        return false;
    for (unsigned i = 0; i < count; i++)
        if (!place_next(r, n, to, first + i))
            return false;
    return true;
}

/* A name, or a list of names; it stops at the first that has no place, for the others would only follow from that. */
static void place_list(struct wall_reader *r, const struct wall_node *n, struct placing *to)
{
    if (n->kind == NODE_TEXT) {
        place_named(r, n, to);
        return;
    }
    for (const struct wall_node *e = wall_elements(r, n, "panel names"); e; e = e->next)
        if (!place_named(r, e, to))
            break;
}

/* first, count: inside the panel. */
static bool read_range(struct wall_reader *r, const struct wall_node *first, const struct wall_node *count, const struct wall_panel *p,
                       struct wall_run *run)
{
    const uint32_t leds = p->width * p->height;
    if (first && !wall_whole(r, first, 0, leds - 1, "an LED of the panel", &run->first))
        return false;
    run->count = leds - run->first;
    return !count || wall_whole(r, count, 1, run->count, "how many LEDs of the panel, from \"first\" on", &run->count);
}

/* strip, at: where on the board; false: a mistake. */
static bool read_at(struct wall_reader *r, const struct wall_node *strip, const struct wall_node *at, struct placing *to)
{
    const struct wall_board *b = &r->d->board[to->board];
    uint32_t s = 0, offset = 0;
    if (!strip && !at)
        return true;
    if (strip && b->kind != WALL_FADECANDY) {
        wall_mistake(r, strip, "board %s has no strips; expected \"corner: [x, y]\" or \"at: N\"", b->name);
        return false;
    }
    if (strip && !wall_whole(r, strip, 0, STRIPS - 1, "a strip of the board", &s))
        return false;
    const uint32_t leds = strip ? STRIP_LEDS : b->width * b->height;
    if (at && !wall_whole(r, at, 0, leds - 1, strip ? "an LED of the strip" : "an LED of the board", &offset))
        return false;
    to->at = s * STRIP_LEDS + offset;
    return true;
}

enum { PANEL, PANELS, FIRST, COUNT, STRIP, AT, CORNER, REVERSED, RUN_KEYS };

static void read_single(struct wall_reader *r, const struct wall_node *n, const struct wall_node *const v[], struct placing *to)
{
    unsigned first, count;
    struct wall_run run = { .board = to->board, .line = n->line };
    uint32_t corner[2];
    if (!wall_panels_named(r, v[PANEL], &first, &count))
        return;
    if (count != 1) {
        wall_mistake(r, v[PANEL], "%s are %u panels; expected one, or \"panels:\"", wall_found(v[PANEL]).s, count);
        return;
    }
    const bool display = r->d->board[to->board].kind == WALL_GUD;
    const bool linear = v[FIRST] || v[COUNT] || v[STRIP] || v[AT] || v[REVERSED];
    if (v[CORNER] && (!display || linear)) {
        wall_mistake(r, v[CORNER], display ? "beside at, first, count or reversed; expected one way to say where"
                                           : "the board is no display; expected \"strip: S\" or \"at: N\"");
        return;
    }
    if (display && !linear) {
        if (v[CORNER] && !wall_pair(r, v[CORNER], 0, WALL_SIDE_MAX - 1, "x, y of the display's pixels", corner))
            return;
        struct placing place = { .board = to->board, .x = v[CORNER] ? corner[0] : 0, .y = v[CORNER] ? corner[1] : 0 };
        place_rectangle(r, n, &place, first);
        return;
    }
    run.panel = first;
    wall_yes(r, v[REVERSED], &run.reversed);
    if (read_range(r, v[FIRST], v[COUNT], &r->d->panel[first], &run) && read_at(r, v[STRIP], v[AT], to))
        chain(r, n, to, &run);
}

static void read_run(struct wall_reader *r, const struct wall_node *n, struct placing *to)
{
    static const char *const keys[RUN_KEYS] = { "panel", "panels", "first", "count", "strip", "at", "corner", "reversed" };
    const struct wall_node *v[RUN_KEYS];
    if (!wall_keys(r, n, keys, RUN_KEYS, v))
        return;
    if (!v[PANEL] == !v[PANELS]) {
        wall_mistake(r, n, "%s; expected \"panel: NAME\" or \"panels: [NAME, ...]\"", v[PANEL] ? "panel and panels" : "no panel");
        return;
    }
    if (v[PANEL]) {
        read_single(r, n, v, to);
        return;
    }
    const struct wall_node *extra = v[FIRST] ? v[FIRST] : v[COUNT] ? v[COUNT] : v[REVERSED] ? v[REVERSED] : v[CORNER];
    if (extra)
        wall_mistake(r, extra, "goes with one \"panel:\", not with \"panels:\"; expected whole panels here");
    else if (read_at(r, v[STRIP], v[AT], to))
        place_list(r, v[PANELS], to);
}

/* ---- boards --------------------------------------------------------------------------------------------------------- */

static void read_order(struct wall_reader *r, const struct wall_node *n, unsigned char out[3])
{
    unsigned seen = 0;
    unsigned char order[3] = { 0, 1, 2 };
    if (!n)
        return;
    for (unsigned i = 0; i < 3 && n->kind == NODE_TEXT && n->text[i]; i++) {
        const char *found = strchr("RGB", n->text[i]);
        if (!found)
            break;
        order[i] = (unsigned char)(found - "RGB");
        seen |= 1u << order[i];
    }
    if (seen == 7 && !n->text[3])
        memcpy(out, order, sizeof(order));
    else
        wall_mistake(r, n, "%s; expected each of R, G, B once, such as GRB", wall_found(n).s);
}

/* A map by colour, or the amps of one LED in white, which the three share. */
static void read_amps(struct wall_reader *r, const struct wall_node *n, struct wall_board *b)
{
    static const char *const keys[4] = { "red", "green", "blue", "idle" };
    const struct wall_node *v[4];
    double amps;
    if (n && n->kind == NODE_TEXT) {
        if (wall_number(r, n, 0, 10, "amps of one LED in white", &amps))
            b->led_amps[0] = b->led_amps[1] = b->led_amps[2] = (float)(amps / 3);
        return;
    }
    if (!n || !wall_keys(r, n, keys, 4, v))
        return;
    for (unsigned i = 0; i < 4; i++)
        if (wall_number(r, v[i], 0, 10, "amps of one LED", &amps))
            *(i < 3 ? &b->led_amps[i] : &b->idle_amps) = (float)amps;
}

/* False: it is not known how many LEDs there are. */
static bool read_board_size(struct wall_reader *r, const struct wall_node *n, const struct wall_node *size, struct wall_board *b)
{
    uint32_t wh[2];
    if (b->kind == WALL_FADECANDY) {
        b->width = STRIP_LEDS;
        b->height = STRIPS;
        if (size)
            wall_mistake(r, size, "a fadecandy has 8 strips of 64 LEDs; expected no size");
        return true;
    }
    if (!size)
        wall_mistake(r, n, "the display has no size; expected \"size: [width, height]\" of the mode to use");
    if (!wall_pair(r, size, 1, WALL_SIDE_MAX, "the display's width and height", wh))
        return false;
    b->width = wh[0];
    b->height = wh[1];
    return true;
}

enum { SERIAL, KIND, NAME, SIZE, ORDER, BRIGHTNESS, SUPPLY, AMPS, DELAY, LEDS, BOARD_PANELS, BOARD_KEYS };

static void read_electric(struct wall_reader *r, const struct wall_node *const v[], struct wall_board *b)
{
    double share = 1, delay_s = 0;
    if (b->kind == WALL_FADECANDY) { /* WS2812B: 20 mA a colour (its maker's figure, most measure 12 to 16), 1 mA dark */
        b->led_amps[0] = b->led_amps[1] = b->led_amps[2] = 0.02f;
        b->idle_amps = 0.001f;
    }
    if (wall_share(r, v[BRIGHTNESS], &share))
        b->brightness = (float)share;
    find_supply(r, v[SUPPLY], &b->supply);
    read_amps(r, v[AMPS], b);
    if (wall_time(r, v[DELAY], 0.1, false, &delay_s))
        b->delay_ms = 1000 * delay_s;
    if (b->kind == WALL_GUD && v[SUPPLY] && !v[AMPS])
        wall_note(r, v[SUPPLY], "without \"amps per led\" a display counts as 0 A, and its supply's limit does nothing");
}

static void read_leds(struct wall_reader *r, const struct wall_node *n, const struct wall_node *const v[])
{
    struct placing to = { .board = r->d->n_boards - 1 };
    if (!v[LEDS] == !v[BOARD_PANELS]) {
        wall_mistake(r, n, "%s; expected one of \"panels: [NAME, ...]\" and \"leds:\" with a list of runs",
                     v[LEDS] ? "panels and leds" : "the board shows nothing");
        return;
    }
    if (v[BOARD_PANELS]) {
        place_list(r, v[BOARD_PANELS], &to);
        return;
    }
    for (const struct wall_node *e = wall_elements(r, v[LEDS], "runs"); e; e = e->next)
        read_run(r, e, &to);
}

static void read_board(struct wall_reader *r, const struct wall_node *n)
{
    static const char *const keys[BOARD_KEYS] = { "serial", "kind", "name", "size", "order", "brightness", "supply", "amps per led",
                                                  "delay", "leds", "panels" };
    const struct wall_node *v[BOARD_KEYS];
    struct wall_board b = { .order = { 0, 1, 2 }, .brightness = 1, .supply = -1, .line = n->line };
    unsigned kind = WALL_FADECANDY;
    if (!wall_keys(r, n, keys, BOARD_KEYS, v))
        return;
    if (r->d->n_boards == WALL_BOARDS_MAX) {
        wall_mistake(r, n, "one more board; expected at most %u", WALL_BOARDS_MAX);
        return;
    }
    wall_word(r, v[KIND], "fadecandy gud", &kind);
    b.kind = (enum wall_board_kind)kind;
    if (!v[SERIAL])
        wall_mistake(r, n, "the board has no serial; expected \"serial: ...\" as \"airy wall list\" shows it");
    wall_text(r, v[SERIAL], "a serial", b.serial, sizeof(b.serial));
    memcpy(b.name, b.serial, sizeof(b.name));
    wall_text(r, v[NAME], "a name", b.name, sizeof(b.name));
    read_order(r, v[ORDER], b.order);
    read_electric(r, v, &b);
    const bool sized = read_board_size(r, n, v[SIZE], &b);
    r->d->board[r->d->n_boards] = b;
    r->board_at[r->d->n_boards++] = n;
    if (sized)
        read_leds(r, n, v);
}

void wall_read_boards(struct wall_reader *r, const struct wall_node *n)
{
    for (const struct wall_node *e = wall_elements(r, n, "boards"); e; e = e->next)
        read_board(r, e);
}
