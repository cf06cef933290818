// SPDX-License-Identifier: Apache-2.0
// wall_def.c - a wall definition from its text: the order in which its parts are read, what is said for the whole wall, and
// what becomes of a definition with mistakes.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "wall_def_internal.h"

static struct wall_def *def_new(void)
{
    struct wall_def *d = calloc(1, sizeof(*d));
    if (!d)
        return NULL;
    *d = (struct wall_def){ .rate = 60, .hold_s = 2, .fade_s = 1, .window = { 0, 0, 1, 1 }, .adapt_up_s = 1, .adapt_down_s = 0.3,
                            .saturation = 1, .matrix = { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } }, .brightness = 1,
                            .transfer = WALL_TRANSFER_SRGB, .gamma = 2.2 };
    // At their most: small beside what a wall's pictures take, and no list has to grow.
    d->panel = calloc(WALL_PANELS_MAX, sizeof(*d->panel));
    d->board = calloc(WALL_BOARDS_MAX, sizeof(*d->board));
    d->run = calloc(WALL_RUNS_MAX, sizeof(*d->run));
    d->supply = calloc(WALL_SUPPLIES_MAX, sizeof(*d->supply));
    if (d->panel && d->board && d->run && d->supply)
        return d;
    wall_def_free(d);
    return NULL;
}

void wall_def_free(struct wall_def *d)
{
    if (!d)
        return;
    free(d->panel);
    free(d->board);
    free(d->run);
    free(d->supply);
    free(d);
}

static int reader_init(struct wall_reader *r, struct wall_mistakes *m)
{
    *r = (struct wall_reader){ .m = m, .d = def_new() };
    r->group = calloc(WALL_GROUPS_MAX, sizeof(*r->group));
    r->panel_at = calloc(WALL_PANELS_MAX, sizeof(*r->panel_at));
    r->board_at = calloc(WALL_BOARDS_MAX, sizeof(*r->board_at));
    r->run = calloc(WALL_RUNS_MAX, sizeof(*r->run));
    r->supply_at = calloc(WALL_SUPPLIES_MAX, sizeof(*r->supply_at));
    return r->d && r->group && r->panel_at && r->board_at && r->run && r->supply_at ? 0 : -1;
}

static void reader_finish(struct wall_reader *r)
{
    wall_def_free(r->d);
    free(r->group);
    free(r->panel_at);
    free(r->board_at);
    free(r->run);
    free(r->supply_at);
    wall_tree_free(r);
}

/* ---- picture ---------------------------------------------------------------------------------------------------- */

/* "auto", "auto +1", "-0.5"; false: a mistake. */
static bool read_exposure(struct wall_reader *r, const struct wall_node *n)
{
    struct wall_def *d = r->d;
    double stops = 0;
    if (!n)
        return true;
    const bool is_auto = n->kind == NODE_TEXT && strncmp(n->text, "auto", 4) == 0;
    const char *s = n->text + (is_auto ? 4 : 0);
    while (is_auto && *s == ' ')
        s++;
    const bool more = !is_auto || *s;
    const bool sign = !is_auto || *s == '+' || *s == '-';
    if (n->kind != NODE_TEXT || (more && (!sign || !wall_number_scan(s, strlen(s), &stops))) || fabs(stops) > 32) {
        wall_mistake(r, n, "%s; expected stops, -32 to 32, or auto, or \"auto +1\"", wall_found(n).s);
        return false;
    }
    d->exposure_auto = is_auto;
    d->exposure = stops;
    return true;
}

static void read_window(struct wall_reader *r, const struct wall_node *n)
{
    double w[4];
    if (!wall_numbers(r, n, 4, 0, 1, "x, y, width, height as shares of the picture", w))
        return;
    if (w[2] <= 0 || w[3] <= 0 || w[0] + w[2] > 1 + 1e-9 || w[1] + w[3] > 1 + 1e-9)
        wall_mistake(r, n, "%.6g, %.6g, %.6g, %.6g; expected a part of the picture: x + width and y + height at most 1, "
                     "width and height above 0", w[0], w[1], w[2], w[3]);
    else
        memcpy(r->d->window, w, sizeof(w));
}

void wall_read_picture(struct wall_reader *r, const struct wall_node *n)
{
    enum { FIT, WINDOW, EXPOSURE, ADAPT, TONE_MAP, SATURATION, KEYS };
    static const char *const keys[KEYS] = { "fit", "window", "exposure", "adapt", "tone map", "saturation" };
    static const char *const adapt_keys[2] = { "up", "down" };
    const struct wall_node *v[KEYS], *a[2];
    struct wall_def *d = r->d;
    unsigned word;
    if (!n || !wall_keys(r, n, keys, KEYS, v))
        return;
    if (wall_word(r, v[FIT], "fill contain stretch", &word))
        d->fit = (enum wall_fit)word;
    read_window(r, v[WINDOW]);
    const bool known = read_exposure(r, v[EXPOSURE]);
    if (v[ADAPT] && wall_keys(r, v[ADAPT], adapt_keys, 2, a)) {
        wall_time(r, a[0], 3600, false, &d->adapt_up_s);
        wall_time(r, a[1], 3600, false, &d->adapt_down_s);
    }
    if (v[ADAPT] && known && !d->exposure_auto)
        wall_mistake(r, v[ADAPT], "the exposure is fixed; expected \"exposure: auto\", or no adapt");
    if (wall_word(r, v[TONE_MAP], "none reinhard aces", &word))
        d->tone_map = (enum wall_tone_map)word;
    wall_number(r, v[SATURATION], 0, 4, "a factor", &d->saturation);
}

/* ---- the whole --------------------------------------------------------------------------------------------------- */

static void read_name(struct wall_reader *r, const struct wall_node *root, const struct wall_node *n)
{
    if (!n)
        wall_mistake(r, root, "the wall has no name; expected \"wall: NAME\"");
    else if (wall_text(r, n, "a name", r->d->name, sizeof(r->d->name)) && strchr(r->d->name, '/'))
        wall_mistake(r, n, "%s; expected a name without \"/\", which would look like a file's", wall_found(n).s);
}

static void read_size(struct wall_reader *r, const struct wall_node *n)
{
    uint32_t size[2];
    r->size_given = n != NULL;
    if (!wall_pair(r, n, 1, WALL_SIDE_MAX, "the wall's width and height in pixels", size))
        return;
    if ((uint64_t)size[0] * size[1] > WALL_PIXELS_MAX) {
        wall_mistake(r, n, "%u x %u are %llu pixels; expected at most %u", size[0], size[1],
                     (unsigned long long)size[0] * size[1], WALL_PIXELS_MAX);
        return;
    }
    r->d->width = size[0];
    r->d->height = size[1];
}

static void read_wall(struct wall_reader *r, const struct wall_node *root)
{
    enum { WALL, SIZE, RATE, HOLD, FADE, PICTURE, COLOUR, PANELS, SUPPLIES, BOARDS, KEYS };
    static const char *const keys[KEYS] = { "wall", "size", "rate", "hold", "fade", "picture", "colour", "panels", "supplies",
                                            "boards" };
    const struct wall_node *v[KEYS];
    struct wall_def *d = r->d;
    if (!wall_keys(r, root, keys, KEYS, v))
        return;
    read_name(r, root, v[WALL]);
    read_size(r, v[SIZE]);
    r->rate_at = v[RATE];
    wall_number(r, v[RATE], 1, 240, "frames per second", &d->rate);
    wall_time(r, v[HOLD], 3600, true, &d->hold_s);
    wall_time(r, v[FADE], 3600, false, &d->fade_s);
    wall_read_picture(r, v[PICTURE]);
    wall_read_colour(r, v[COLOUR]);
    if (v[PANELS])
        wall_read_panels(r, v[PANELS]);
    else
        wall_mistake(r, root, "the wall has no panels; expected \"panels:\" and a list");
    wall_read_supplies(r, v[SUPPLIES]);
    if (v[BOARDS])
        wall_read_boards(r, v[BOARDS]);
    else
        wall_note(r, root, "the wall has no boards: no LED is lit; its pictures can be had by programs only");
    wall_def_check(r);
}

static int whole_or_fault(struct wall_reader *r, struct fault *f)
{
    const struct wall_mistakes *m = r->m;
    if (r->no_memory)
        return fault_set(f, FAULT_NO_MEMORY, "wall", "no memory to read the definition");
    if (!m->count)
        return 0;
    if (m->count == 1)
        return fault_set(f, FAULT_WALL, "wall", "line %u: %s", m->at[0].line, m->at[0].text);
    return fault_set(f, FAULT_WALL, "wall", "line %u: %s (and %u more mistakes)", m->at[0].line, m->at[0].text, m->count - 1);
}

int wall_def_parse(struct wall_def **out, const char *text, size_t bytes, struct wall_mistakes *m, struct fault *f)
{
    struct wall_reader r;
    struct wall_mistakes *own = NULL;
    int result = -1;
    if (!m)
        m = own = malloc(sizeof(*own));
    if (!m)
        return fault_set(f, FAULT_NO_MEMORY, "wall", "no memory to read the definition");
    m->count = m->notes = 0;
    m->more = false;
    if (reader_init(&r, m) < 0)
        r.no_memory = true;
    if (!r.no_memory && bytes > WALL_TEXT_MAX)
        wall_mistake(&r, NULL, "%zu bytes; expected a definition of at most %u", bytes, WALL_TEXT_MAX);
    if (!r.no_memory && !m->count) {
        const struct wall_node *root = wall_tree_read(&r, text, bytes);
        if (root)
            read_wall(&r, root);
    }
    result = whole_or_fault(&r, f);
    if (result == 0) {
        *out = r.d;
        r.d = NULL;
    }
    reader_finish(&r);
    free(own);
    return result;
}
