// SPDX-License-Identifier: Apache-2.0
//
// libwall.c - WALL and its answer as a struct airy_wall_reply.
//
// An airy_wall is no request of the lists: it ends where it began, within one call. What timed out is remembered by its id,
// so that a late answer does no harm; its bytes are never read into memory of the caller's.
#include "lib_internal.h"

#include <errno.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { PREVIEW_BYTES_MAX = 3 << 20 }; // a wall has at most 1 << 20 pixels
enum { BUSY_TRIES = 40, BUSY_MS_MAX = 500 }; // a wall that is being closed is gone in a second

struct airy_wall_reply_private {
    struct body_arena arena; // texts and lists
    uint8_t *preview;
};

void airy_wall_reply_free(struct airy_wall_reply *r)
{
    if (!r)
        return;
    body_arena_finish(&r->priv->arena);
    free(r->priv->preview);
    free(r->priv);
    free(r);
}

// ---- the answer ------------------------------------------------------------------------------------

static struct airy_percentiles percentiles(const Airy__Percentiles *p)
{
    return p ? (struct airy_percentiles){ p->p50, p->p99, p->max } : (struct airy_percentiles){ 0 };
}

static struct airy_wall_board board_of(const Airy__WallBoard *b)
{
    return (struct airy_wall_board){
        .name = b->name,
        .kind = b->kind,
        .serial = b->serial,
        .state = b->state,
        .problem = b->problem,
        .path = b->path,
        .sent = b->sent,
        .dropped = b->dropped,
        .missed = b->missed,
        .stalls = b->stalls,
        .timeouts = b->timeouts,
        .errors = b->errors,
        .losses = b->losses,
        .rendered = b->rendered,
        .received = b->received,
        .latency_ms = percentiles(b->latency_ms),
        .amps = b->amps,
        .amps_wanted = b->amps_wanted,
    };
}

static int take_wall(struct airy_wall_state *out, const Airy__WallState *w, struct body_arena *arena)
{
    struct airy_wall_board *boards = body_arena_alloc(arena, w->n_boards * sizeof(*boards));
    struct airy_wall_supply *supplies = body_arena_alloc(arena, w->n_supplies * sizeof(*supplies));
    if (!boards || !supplies)
        return -1;
    for (size_t i = 0; i < w->n_boards; i++)
        boards[i] = board_of(w->boards[i]);
    for (size_t i = 0; i < w->n_supplies; i++) {
        const Airy__WallSupply *s = w->supplies[i];
        supplies[i] = (struct airy_wall_supply){ s->name, s->amps, s->amps_wanted, s->amps_limit };
    }
    *out = (struct airy_wall_state){
        .name = w->name,
        .width = w->width,
        .height = w->height,
        .leds = w->leds,
        .rate = w->rate,
        .source = w->source,
        .fps = w->fps,
        .frames_per_second = w->frames_per_second,
        .ticks = w->ticks,
        .ticks_missed = w->ticks_missed,
        .late_ms = percentiles(w->late_ms),
        .skew_ms = percentiles(w->skew_ms),
        .frames = w->frames,
        .shown = w->shown,
        .dropped = w->dropped,
        .exposure = w->exposure,
        .realtime = w->realtime,
        .boards = boards,
        .n_boards = (unsigned)w->n_boards,
        .supplies = supplies,
        .n_supplies = (unsigned)w->n_supplies,
    };
    return 0;
}

static int take_facts(struct airy_wall_reply *r, const Airy__WallReply *b, struct airy_error *e)
{
    struct body_arena *arena = &r->priv->arena;
    struct airy_wall_state *walls = body_arena_alloc(arena, b->n_walls * sizeof(*walls));
    struct airy_controller *controllers = body_arena_alloc(arena, b->n_controllers * sizeof(*controllers));
    bool room = walls && controllers;
    for (size_t i = 0; room && i < b->n_walls; i++)
        room = take_wall(&walls[i], b->walls[i], arena) == 0;
    if (!room)
        return lib_fail(e, ENOMEM, "walls", "no room for %zu walls and %zu controllers", b->n_walls, b->n_controllers);
    for (size_t i = 0; i < b->n_controllers; i++) {
        const Airy__Controller *c = b->controllers[i];
        controllers[i] = (struct airy_controller){ c->kind, c->serial, c->path, c->wall, c->problem, c->reading };
    }
    r->walls = walls;
    r->n_walls = (unsigned)b->n_walls;
    r->controllers = controllers;
    r->n_controllers = (unsigned)b->n_controllers;
    r->usb = b->usb;
    return 0;
}

// Exactly the pixels of the one wall, or nothing.
static int take_preview(struct airy_wall_reply *r, struct wall_wait *w, const Airy__Payload *p, struct airy_error *e)
{
    static const Airy__Payload nothing = AIRY__PAYLOAD__INIT;
    Airy__Payload__Kind want = w->preview ? AIRY__PAYLOAD__KIND__INLINE : AIRY__PAYLOAD__KIND__NONE;
    if (!p)
        p = &nothing;
    if (p->kind != want)
        return lib_fail(e, EPROTO, "preview.kind", "the answer's preview has kind %d, expected %d", (int)p->kind, (int)want);
    if (!w->preview)
        return 0;
    uint64_t pixels = r->n_walls == 1 ? (uint64_t)r->walls[0].width * r->walls[0].height : 0;
    if (!pixels || p->size != w->got_bytes || w->got_bytes % 3 || w->got_bytes / 3 != pixels)
        return lib_fail(e, EPROTO, "preview.size",
                        "a preview of %" PRIu64 " pixels is said to be %" PRIu64 " bytes, %zu came", pixels, p->size,
                        w->got_bytes);
    r->preview = r->priv->preview = w->got;
    w->got = NULL;
    return 0;
}

static int reply_make(struct wall_wait *w, const struct conn_message *m, struct airy_error *e)
{
    struct fault f;
    struct airy_wall_reply *r = calloc(1, sizeof(*r));
    if (r)
        r->priv = calloc(1, sizeof(*r->priv));
    if (!r || !r->priv) {
        free(r);
        return lib_fail(e, ENOMEM, "", "no memory for a wall's answer");
    }
    const Airy__WallReply *b =
        body_unpack(&airy__wall_reply__descriptor, m->body, m->header.body_bytes, &r->priv->arena, &f);
    if (!b)
        lib_fail(e, EPROTO, "", "from the daemon: %s", f.text);
    else if (take_facts(r, b, e) == 0 && take_preview(r, w, b->preview, e) == 0) {
        w->reply = r;
        return 0;
    }
    airy_wall_reply_free(r);
    return -1;
}

static int take_data(struct wall_wait *w, const struct conn_message *m, struct airy_error *e)
{
    size_t n = m->header.body_bytes;
    if (!w->preview || n > PREVIEW_BYTES_MAX - w->got_bytes)
        return lib_fail(e, EPROTO, "", "%zu bytes of DATA for a WALL that asked for %s", n,
                        w->preview ? "a preview, beyond the largest wall's" : "none");
    if (w->got_bytes + n > w->got_room) {
        size_t room = w->got_bytes + n > 2 * w->got_room ? w->got_bytes + n : 2 * w->got_room;
        uint8_t *bigger = realloc(w->got, room);
        if (!bigger)
            return lib_fail(e, ENOMEM, "", "no memory for a preview of %zu bytes", room);
        w->got = bigger;
        w->got_room = room;
    }
    if (n)
        memcpy(w->got + w->got_bytes, m->body, n);
    w->got_bytes += n;
    return 0;
}

static bool given_up(struct airy *a, uint64_t id, unsigned *at)
{
    for (*at = 0; *at < a->n_given_up; ++*at)
        if (a->given_up[*at] == id)
            return true;
    return false;
}

static void forget(struct airy *a, unsigned at) { a->given_up[at] = a->given_up[--a->n_given_up]; }

int lib_wall_message(struct airy *a, const struct conn_message *m, struct airy_error *e)
{
    struct wall_wait *w = a->wall;
    enum wire_type type = m->header.type;
    unsigned at;
    if (type != WIRE_WALL_REPLY && type != WIRE_DATA)
        return 0;
    if (given_up(a, m->header.id, &at)) {
        if (type == WIRE_WALL_REPLY)
            forget(a, at);
        return 1;
    }
    if (!w || w->ended || w->id != m->header.id)
        return 0;
    if (type == WIRE_DATA)
        return take_data(w, m, e) < 0 ? -1 : 1;
    w->ended = true;
    reply_make(w, m, &w->error);
    return 1;
}

bool lib_wall_error(struct airy *a, uint64_t id, const struct airy_error *error)
{
    struct wall_wait *w = a->wall;
    unsigned at;
    if (given_up(a, id, &at)) {
        forget(a, at);
        return true;
    }
    if (!w || w->ended || w->id != id)
        return false;
    w->ended = true;
    w->error = *error;
    return true;
}

// ---- the question ----------------------------------------------------------------------------------

static char *text_or_empty(const char *s) { return (char *)(s ? s : ""); }

static int wall_send(struct airy *a, const struct airy_wall_request *q, uint64_t id, struct airy_error *e)
{
    static const Airy__Wall__Action actions[] = {
        [AIRY_WALL_LIST] = AIRY__WALL__ACTION__LIST,       [AIRY_WALL_OPEN] = AIRY__WALL__ACTION__OPEN,
        [AIRY_WALL_CLOSE] = AIRY__WALL__ACTION__CLOSE,     [AIRY_WALL_PATTERN] = AIRY__WALL__ACTION__PATTERN,
        [AIRY_WALL_PREVIEW] = AIRY__WALL__ACTION__PREVIEW,
    };
    Airy__Wall w = AIRY__WALL__INIT;
    w.action = actions[q->action];
    w.name = text_or_empty(q->name);
    w.definition = text_or_empty(q->definition);
    w.calibration = text_or_empty(q->calibration);
    w.keep = q->keep;
    w.pattern = text_or_empty(q->pattern);
    w.board = text_or_empty(q->board);
    w.led = q->led;
    w.level = q->level;
    int err = body_send(a->conn, WIRE_WALL, id, &w.base, NULL, 0);
    if (err == -EMSGSIZE)
        return lib_fail(e, EMSGSIZE, "definition", "the wall's definition has %zu bytes, a message at most %d",
                        strlen(w.definition), WIRE_CONTROL_BYTES_MAX);
    return err ? lib_fail(e, -err, "", "WALL: %s", strerror(-err)) : 0;
}

static int wall_allowed(struct airy *a, const struct airy_wall_request *q, struct airy_error *e)
{
    if (!a->has_walls)
        return lib_fail(e, ENOTSUP, "", "%s drives no walls", a->server);
    if ((unsigned)q->action > AIRY_WALL_PREVIEW)
        return lib_fail(e, EINVAL, "action", "there is no action %d of walls", (int)q->action);
    if (a->n_given_up == WALL_GIVEN_UP_MAX)
        return lib_fail(e, EAGAIN, "", "%d earlier questions about walls are not answered yet", WALL_GIVEN_UP_MAX);
    return 0;
}

static int ask_once(struct airy *a, const struct airy_wall_request *q, int64_t deadline_ms, int timeout_ms,
                    struct airy_wall_reply **out, struct airy_error *e)
{
    if (lib_wait_up(a, deadline_ms, e) < 0)
        return -1;
    struct wall_wait w = { .id = a->next_id, .preview = q->action == AIRY_WALL_PREVIEW };
    const uint64_t serial = a->again.serial;
    if (wall_allowed(a, q, e) < 0 || wall_send(a, q, w.id, e) < 0)
        return -1;
    a->own_walls |= q->action == AIRY_WALL_OPEN && !q->keep;
    a->next_id++;
    a->wall = &w;
    lib_step(a);
    for (bool up = false; !w.ended && lib_up(a) && a->again.serial == serial && !up;)
        up = lib_step_until(a, deadline_ms) > 0;
    a->wall = NULL;
    free(w.got); // what a good answer did not take
    const bool lost = !lib_up(a) || a->again.serial != serial;
    if (w.reply) {
        *out = w.reply;
        return 0;
    }
    if (w.ended || lost) {
        if (e)
            *e = w.ended ? w.error : a->lost;
        return -1;
    }
    a->given_up[a->n_given_up++] = w.id;
    return lib_fail(e, ETIMEDOUT, "", "the daemon did not answer about walls in %d ms", timeout_ms);
}

int airy_wall(struct airy *a, const struct airy_wall_request *q, int timeout_ms, struct airy_wall_reply **out,
              struct airy_error *e)
{
    const int64_t deadline_ms = lib_deadline_ms(timeout_ms);
    struct airy_error own;
    e = e ? e : &own;
    for (int i = 0;; i++) {
        if (ask_once(a, q, deadline_ms, timeout_ms, out, e) == 0)
            return 0;
        if (e->code != FAULT_BUSY || i == BUSY_TRIES || e->retry_after_ms > BUSY_MS_MAX)
            return -1;
        nanosleep(&(struct timespec){ .tv_nsec = (long)e->retry_after_ms * 1000000 }, NULL);
    }
}
