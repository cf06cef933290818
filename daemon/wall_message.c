// SPDX-License-Identifier: Apache-2.0
// wall_message.c - see wall_message.h.
#include "wall_message.h"

#include <stdio.h>
#include <string.h>

#include "reply.h"

enum { FOUND_MAX = 128 };

// Everything of a reply lives in the arena, which has a ceiling: NULL beyond it.
static void *take(struct body_arena *a, size_t n, size_t size, bool *full)
{
    void *p = body_arena_alloc(a, n ? n * size : 1);
    *full |= !p;
    return p;
}

static char *text(struct body_arena *a, const char *s, bool *full)
{
    const size_t n = strlen(s) + 1;
    char *out = take(a, n, 1, full);
    if (!out)
        return (char *)"";
    memcpy(out, s, n);
    reply_clean(out);
    return out;
}

static Airy__Percentiles *percentiles(struct body_arena *a, const struct wall_times *t, bool *full)
{
    Airy__Percentiles *p = take(a, 1, sizeof *p, full);
    if (!p)
        return NULL;
    airy__percentiles__init(p);
    p->p50 = t->p50;
    p->p99 = t->p99;
    p->max = t->max;
    return p;
}

static const char *state_name(enum usb_state s)
{
    static const char *const names[] = { "absent", "opening", "ready", "failed" }; // enum usb_state
    return names[s];
}

static const char *kind_name(enum wall_board_kind k) { return panel_kinds[k]->name; }

// ---- a wall ----------------------------------------------------------------------------------------

static void board(Airy__WallBoard *o, const struct wall_ref *r, unsigned i, struct body_arena *a, bool *full)
{
    const struct wall_board *d = &r->def->board[i];
    struct usb_stats s = { 0 };
    struct wall_times latency = { 0 };
    struct wall_power power = { 0 };
    airy__wall_board__init(o);
    wall_board_stats(r->wall, i, &s, &latency, &power);
    o->name = text(a, d->name, full);
    o->kind = text(a, kind_name(d->kind), full);
    o->serial = text(a, d->serial, full);
    o->state = text(a, state_name(s.state), full);
    o->problem = text(a, s.why, full);
    o->path = text(a, s.path, full);
    o->sent = s.sent;
    o->dropped = s.dropped;
    o->missed = s.missed;
    o->stalls = s.stalls;
    o->timeouts = s.timeouts;
    o->errors = s.errors;
    o->losses = s.losses;
    o->rendered = s.rendered;
    o->received = s.received;
    o->latency_ms = percentiles(a, &latency, full);
    o->amps = power.amps;
    o->amps_wanted = power.wanted;
}

static void boards(Airy__WallState *o, const struct wall_ref *r, struct body_arena *a, bool *full)
{
    const unsigned n = r->def->n_boards;
    Airy__WallBoard *all = take(a, n, sizeof *all, full);
    o->boards = take(a, n, sizeof *o->boards, full);
    for (unsigned i = 0; i < n && all && o->boards; i++) {
        board(&all[i], r, i, a, full);
        o->boards[o->n_boards++] = &all[i];
    }
}

static void supplies(Airy__WallState *o, const struct wall_ref *r, struct body_arena *a, bool *full)
{
    const unsigned n = r->def->n_supplies;
    Airy__WallSupply *all = take(a, n, sizeof *all, full);
    o->supplies = take(a, n, sizeof *o->supplies, full);
    for (unsigned i = 0; i < n && all && o->supplies; i++) {
        const struct wall_power p = wall_supply_power(r->wall, i);
        airy__wall_supply__init(&all[i]);
        all[i].name = text(a, r->def->supply[i].name, full);
        all[i].amps = p.amps;
        all[i].amps_wanted = p.wanted;
        all[i].amps_limit = (double)r->def->supply[i].amps;
        o->supplies[o->n_supplies++] = &all[i];
    }
}

static void state(Airy__WallState *o, const struct wall_ref *r, struct body_arena *a, bool *full)
{
    struct wall_stats s;
    airy__wall_state__init(o);
    wall_stats(r->wall, &s);
    o->name = text(a, r->def->name, full);
    o->width = r->def->width;
    o->height = r->def->height;
    o->rate = r->def->rate;
    o->leds = r->layout->lit;
    o->source = text(a, wall_source_name(s.source), full);
    o->fps = s.fps;
    o->frames_per_second = s.pictures_per_s;
    o->ticks = s.ticks;
    o->ticks_missed = s.ticks_missed;
    o->late_ms = percentiles(a, &s.late, full);
    o->skew_ms = percentiles(a, &s.skew, full);
    o->frames = s.pictures;
    o->shown = s.shown;
    o->dropped = s.dropped;
    o->exposure = s.exposure;
    o->realtime = s.realtime;
    boards(o, r, a, full);
    supplies(o, r, a, full);
}

// ---- controllers -----------------------------------------------------------------------------------

static const char *user_of(struct wall_ref *const refs[], unsigned n, const struct usb_found *found)
{
    for (unsigned i = 0; i < n; i++)
        for (unsigned b = 0; b < refs[i]->def->n_boards; b++)
            if (refs[i]->def->board[b].kind == found->kind && !strcmp(refs[i]->def->board[b].serial, found->serial))
                return refs[i]->def->name;
    return "";
}

static void controllers(Airy__WallReply *o, struct usb *usb, struct wall_ref *const refs[], unsigned n, struct body_arena *a,
                        bool *full)
{
    struct usb_found found[FOUND_MAX];
    const unsigned count = usb_list(usb, found, FOUND_MAX, 0);
    Airy__Controller *all = take(a, count, sizeof *all, full);
    o->controllers = take(a, count, sizeof *o->controllers, full);
    for (unsigned i = 0; i < count && all && o->controllers; i++) {
        const struct usb_found *c = &found[i];
        airy__controller__init(&all[i]);
        all[i].kind = text(a, kind_name(c->kind), full);
        all[i].serial = text(a, c->serial, full);
        all[i].path = text(a, c->path, full);
        all[i].wall = text(a, user_of(refs, n, c), full);
        all[i].reading = c->reading;
        all[i].problem = text(a, *c->why ? c->why : c->twice ? "another controller has the same serial" : "", full);
        o->controllers[o->n_controllers++] = &all[i];
    }
}

static int list(const struct wall_desk *d, const char *only, Airy__WallReply *o, struct body_arena *a, struct fault *f)
{
    struct wall_ref *refs[WALLS_MAX];
    const unsigned n = walls_list(d->walls, refs);
    bool full = false;
    const char *why;
    struct usb *usb = walls_usb(d->walls, &why);
    Airy__WallState *all = take(a, n, sizeof *all, &full);
    o->walls = take(a, n, sizeof *o->walls, &full);
    for (unsigned i = 0; i < n && !full; i++) {
        if (*only && strcmp(only, refs[i]->def->name))
            continue;
        state(&all[i], refs[i], a, &full);
        o->walls[o->n_walls++] = &all[i];
    }
    if (*only && !o->n_walls) {
        walls_release(walls_find(d->walls, only, f));
        return -1;
    }
    o->usb = text(a, why, &full);
    if (usb && !full)
        controllers(o, usb, refs, n, a, &full);
    return full ? fault_set(f, FAULT_LIMIT, "wall", "the answer is too long for a message: ask for one wall by name") : 0;
}

// ---- open, pattern, preview ------------------------------------------------------------------------

static int open_wall(const struct wall_desk *d, const Airy__Wall *m, const void *client, struct wall_ref **r, struct fault *f)
{
    struct asset *gains = NULL;
    if (*m->calibration && !(gains = asset_find(d->assets, m->calibration)))
        return fault_set(f, FAULT_NO_ASSET, "calibration", "no image with digest %.60s is kept: send it first", m->calibration);
    int rc = walls_open(d->walls, m->definition, strlen(m->definition), gains, m->keep ? NULL : client, r, f);
    asset_release(d->assets, gains);
    if (rc == 0 && sched_open_walls(d->sched, f) < 0) {
        walls_close(d->walls, (*r)->def->name, NULL);
        return -1;
    }
    return rc;
}

static int find_board(const struct wall_ref *r, const char *name, unsigned *out, struct fault *f)
{
    for (unsigned i = 0; i < r->def->n_boards; i++)
        if (!strcmp(r->def->board[i].name, name)) {
            *out = i;
            return 0;
        }
    return fault_set(f, FAULT_WALL, "board", "wall \"%s\" has no board \"%.64s\"; its first is \"%s\"", r->def->name, name,
                     r->def->n_boards ? r->def->board[0].name : "");
}

static int pattern(struct wall_ref *r, const Airy__Wall *m, const void *client, struct fault *f)
{
    struct wall_pattern p = { .kind = PATTERN_NONE, .led = m->led, .level = m->level == 0 ? 0.25 : m->level };
    if (*m->pattern && !wall_pattern_read(&p.kind, m->pattern))
        return fault_set(f, FAULT_PARAM_SYNTAX, "pattern",
                         "\"%.60s\"; expected order, panels, red, green, blue, white, ramp, checker, led, black, or nothing",
                         m->pattern);
    if (!(p.level >= 0 && p.level <= 1))
        return fault_set(f, FAULT_PARAM_RANGE, "level", "%g; expected 0 to 1", m->level);
    if (p.kind == PATTERN_LED && find_board(r, m->board, &p.board, f) < 0)
        return -1;
    if (wall_pattern(r->wall, &p, f) < 0)
        return -1;
    r->tester = p.kind == PATTERN_NONE ? NULL : client;
    return 0;
}

static int preview(const struct wall_desk *d, const struct wall_ref *r, Airy__WallReply *o, struct body_arena *a,
                   struct block **out, uint64_t *bytes, struct fault *f)
{
    bool full = false;
    *bytes = (uint64_t)r->def->width * r->def->height * 3;
    o->preview = take(a, 1, sizeof *o->preview, &full);
    struct block *b = full ? NULL : block_take(d->blocks, *bytes);
    if (!b)
        return fault_set(f, FAULT_NO_MEMORY, "preview", "no memory for %llu bytes", (unsigned long long)*bytes);
    airy__payload__init(o->preview);
    o->preview->kind = AIRY__PAYLOAD__KIND__INLINE;
    o->preview->size = *bytes;
    wall_preview(r->wall, b->data);
    *out = b;
    return 0;
}

// The wall's state in the reply says its size to who has only its name.
static int about(const struct wall_desk *d, const Airy__Wall *m, const void *client, struct wall_ref *r, Airy__WallReply *o, struct body_arena *a,
                 struct block **picture, uint64_t *bytes, struct fault *f)
{
    if (m->action == AIRY__WALL__ACTION__PATTERN && pattern(r, m, client, f) < 0)
        return -1;
    if (m->action == AIRY__WALL__ACTION__PREVIEW && preview(d, r, o, a, picture, bytes, f) < 0)
        return -1;
    if (list(d, r->def->name, o, a, f) == 0)
        return 0;
    block_give(d->blocks, *picture);
    *picture = NULL;
    return -1;
}

int wall_message(const struct wall_desk *d, const Airy__Wall *m, const void *client, struct body_arena *arena,
                 Airy__WallReply **reply, struct block **picture, uint64_t *bytes, struct fault *f)
{
    Airy__WallReply *o = body_arena_alloc(arena, sizeof *o);
    struct wall_ref *r = NULL;
    int rc = -1;
    *picture = NULL;
    *bytes = 0;
    *reply = o;
    if (!o)
        return fault_set(f, FAULT_NO_MEMORY, "wall", "no memory for a reply");
    airy__wall_reply__init(o);
    switch ((int)m->action) {
    case AIRY__WALL__ACTION__LIST: return list(d, m->name, o, arena, f);
    case AIRY__WALL__ACTION__CLOSE: return walls_close(d->walls, m->name, f);
    case AIRY__WALL__ACTION__OPEN: return open_wall(d, m, client, &r, f) < 0 ? -1 : list(d, r->def->name, o, arena, f);
    case AIRY__WALL__ACTION__PATTERN:
    case AIRY__WALL__ACTION__PREVIEW:
        if ((r = walls_find(d->walls, m->name, f)))
            rc = about(d, m, client, r, o, arena, picture, bytes, f);
        walls_release(r);
        return rc;
    default:
        return fault_set(f, FAULT_PARAM_RANGE, "action", "%d; expected 0 (LIST), 1 (OPEN), 2 (CLOSE), 3 (PATTERN) or 4 (PREVIEW)",
                         (int)m->action);
    }
}
