// SPDX-License-Identifier: Apache-2.0
// wall_colour.c - see wall_colour.h: a tick in two passes. The first gathers each board's light and adds up what it would
// draw, which settles the supplies' scales; the second turns light into bytes and adds up what those draw.
//
// Invariant: after wall_colour_frame no supply's estimate, made from the very bytes, is above its amps, unless its LEDs' idle
// current alone is; then all of them are black.
// The limit is linear in light, so the scale that holds it is a quotient. Dither can still round more LEDs up than down; then the bytes
// are made again with less. `allow` remembers how much less for as long as the picture stays the same: its scale
// settles, it does not go up and down with the dither's phase. The fade comes after the limit: so that the limit does not let go
// while the picture fades, which would bend the fade.
#include <math.h>
#include <stdlib.h>

#include "wall_colour_internal.h"

static const double release_s = 0.5;

struct led {
    uint32_t at;       /* on the board */
    int32_t pixel;
    uint16_t panel;
    uint8_t place;     /* struct dither's */
};

struct board {
    uint32_t leds;     /* that show a pixel; the others are not there */
    struct led *led;   /* owned, as the next */
    float *light;      /* [leds][3], R G B, before scale and fade */
    double wanted[3];  /* sums of light, in LEDs at full */
    double sent[3];    /* of what the bytes say */
};

struct supply {
    double scale, allow, anchor;
    double idle, wanted; /* amps; wanted: of the light, before the limit and the fade */
    double sent;
};

struct wall_colour {
    const struct wall_def *def;
    const struct wall_layout *layout;
    struct curve curve;
    struct dither dither, cut;
    float *gain;          /* [n_panels][3] */
    struct board *board;  /* [n_boards] */
    struct supply *supply;
    double fade;
    bool started;
    uint64_t tick;
};

static uint32_t lit(const struct wall_board_map *m)
{
    uint32_t n = 0;
    for (uint32_t k = 0; k < m->leds; k++)
        n += m->pixel[k] >= 0;
    return n;
}

static int board_make(struct board *b, const struct wall_board_map *m, uint32_t width, struct fault *f)
{
    b->leds = lit(m);
    // One more, so that a board without LEDs is no special case.
    b->led = calloc((size_t)b->leds + 1, sizeof(*b->led));
    b->light = calloc((size_t)b->leds + 1, 3 * sizeof(*b->light));
    if (!b->led || !b->light)
        return fault_set(f, FAULT_NO_MEMORY, "wall", "no memory for the colours of %u LEDs", b->leds);
    struct led *led = b->led;
    for (uint32_t k = 0; k < m->leds; k++) {
        if (m->pixel[k] < 0)
            continue;
        const uint32_t x = (uint32_t)m->pixel[k] % width, y = (uint32_t)m->pixel[k] / width;
        *led++ = (struct led){ .at = k, .pixel = m->pixel[k], .panel = m->panel[k],
                               .place = (uint8_t)((y & 3) << 2 | (x & 3)) };
    }
    return 0;
}

int wall_colour_create(struct wall_colour **out, const struct wall_def *def, const struct wall_layout *layout,
                       struct fault *f)
{
    struct wall_colour *c = calloc(1, sizeof(*c));
    if (!c)
        return fault_set(f, FAULT_NO_MEMORY, "wall", "no memory for a wall's colours");
    c->def = def;
    c->layout = layout;
    c->gain = calloc((size_t)def->n_panels + 1, 3 * sizeof(*c->gain));
    c->board = calloc((size_t)def->n_boards + 1, sizeof(*c->board));
    c->supply = calloc((size_t)def->n_supplies + 1, sizeof(*c->supply));
    if (!c->gain || !c->board || !c->supply) {
        fault_set(f, FAULT_NO_MEMORY, "wall", "no memory for a wall of %u boards", def->n_boards);
        goto fail;
    }
    if (curve_make(&c->curve, def, f))
        goto fail;
    for (unsigned p = 0; p < def->n_panels; p++)
        memcpy(&c->gain[3 * p], def->panel[p].gain, sizeof(def->panel[p].gain));
    for (unsigned s = 0; s < def->n_supplies; s++)
        c->supply[s] = (struct supply){ .scale = 1, .allow = 1 };
    for (unsigned b = 0; b < def->n_boards; b++) {
        if (board_make(&c->board[b], &layout->board[b], def->width, f))
            goto fail;
        if (def->board[b].supply >= 0)
            c->supply[def->board[b].supply].idle += (double)def->board[b].idle_amps * c->board[b].leds;
    }
    dither_none(&c->cut);
    *out = c;
    return 0;
fail:
    wall_colour_destroy(c);
    return -1;
}

void wall_colour_destroy(struct wall_colour *c)
{
    if (!c)
        return;
    for (unsigned b = 0; c->board && b < c->def->n_boards; b++) {
        free(c->board[b].led);
        free(c->board[b].light);
    }
    curve_free(&c->curve);
    free(c->gain);
    free(c->board);
    free(c->supply);
    free(c);
}

/* ---- first pass: light ----------------------------------------------------------------------------- */

/* NaN is not > 0. */
static inline float held(float v) { return v > 0 ? v < 1 ? v : 1 : 0; }

static void board_gather(const struct wall_colour *c, struct board *b, float brightness, const float *drive)
{
    double sum[3] = { 0 };
    for (uint32_t i = 0; i < b->leds; i++) {
        const struct led *led = &b->led[i];
        const float *from = &drive[3 * (size_t)led->pixel], *gain = &c->gain[3 * (size_t)led->panel];
        for (unsigned k = 0; k < 3; k++) {
            const float light = held(from[k]) * gain[k] * brightness;
            b->light[3 * (size_t)i + k] = light;
            sum[k] += (double)light;
        }
    }
    memcpy(b->wanted, sum, sizeof(sum));
}

static void gather(struct wall_colour *c, const float *drive)
{
    for (unsigned i = 0; i < c->def->n_boards; i++) {
        struct board *b = &c->board[i];
        if (drive) {
            board_gather(c, b, c->def->board[i].brightness * (float)c->def->brightness, drive);
            continue;
        }
        memset(b->light, 0, (size_t)b->leds * 3 * sizeof(*b->light));
        memset(b->wanted, 0, sizeof(b->wanted));
    }
}

/* ---- second pass: bytes ------------------------------------------------------------------------------ */

static double supply_scale(const struct wall_colour *c, unsigned board)
{
    const int s = c->def->board[board].supply;
    return s < 0 ? 1 : c->supply[s].scale;
}

static void board_encode(struct wall_colour *c, unsigned board, const struct dither *t, uint8_t *bytes)
{
    struct board *b = &c->board[board];
    const unsigned char *order = c->def->board[board].order;
    const float factor = (float)(supply_scale(c, board) * c->fade);
    uint64_t sum[3] = { 0 };
    for (uint32_t i = 0; i < b->leds; i++) {
        const struct led *led = &b->led[i];
        uint8_t *to = &bytes[3 * (size_t)led->at];
        for (unsigned k = 0; k < 3; k++) {
            const unsigned colour = order[k];
            const int32_t code = curve_code(&c->curve, b->light[3 * (size_t)i + colour] * factor);
            to[k] = dither_byte(code, t->at[led->place][colour]);
            sum[k] += c->curve.light[to[k]];
        }
    }
    for (unsigned k = 0; k < 3; k++)
        b->sent[order[k]] = 0x1p-31 * (double)sum[k];
}

static double board_amps(const struct wall_colour *c, unsigned board, const double light[3])
{
    const struct wall_board *d = &c->def->board[board];
    double amps = 0;
    for (unsigned k = 0; k < 3; k++)
        amps += (double)d->led_amps[k] * light[k];
    return amps;
}

/* ---- the limit ----------------------------------------------------------------------------------------- */

static void supply_settle(struct wall_colour *c, unsigned i, double steps)
{
    struct supply *s = &c->supply[i];
    s->wanted = 0;
    for (unsigned b = 0; b < c->def->n_boards; b++)
        if (c->def->board[b].supply == (int)i)
            s->wanted += board_amps(c, b, c->board[b].wanted);
    const double amps = (double)c->def->supply[i].amps, room = fmax(amps - s->idle, 0);
    if (fabs(s->wanted - s->anchor) > 1e-3 * s->anchor) {
        s->anchor = s->wanted;
        s->allow = 1;
    }
    double target = 1;
    if (amps > 0 && s->wanted > s->allow * room)
        target = s->allow * room / s->wanted;
    const double released = s->scale + (target - s->scale) * -expm1(-steps / (c->def->rate * release_s));
    s->scale = fmin(target, released);
}

static double supply_sent(const struct wall_colour *c, unsigned i)
{
    double amps = 0;
    for (unsigned b = 0; b < c->def->n_boards; b++)
        if (c->def->board[b].supply == (int)i)
            amps += board_amps(c, b, c->board[b].sent);
    return amps;
}

static void supply_encode(struct wall_colour *c, unsigned i, const struct dither *t, uint8_t *const bytes[])
{
    for (unsigned b = 0; b < c->def->n_boards; b++)
        if (c->def->board[b].supply == (int)i)
            board_encode(c, b, t, bytes[b]);
    c->supply[i].sent = supply_sent(c, i);
}

/* Less, until the bytes hold the limit: each time somewhat more than what is too much, for in an even picture no byte changes
 * before the scale has gone down by a step of the dither. Codes that are cut never draw more than the light they stand for but for
 * the table's error, below 0.005 of it: so the last way always holds. */
static void supply_hold(struct wall_colour *c, unsigned i, uint8_t *const bytes[])
{
    struct supply *s = &c->supply[i];
    const double amps = (double)c->def->supply[i].amps, room = fmax(amps - s->idle, 0);
    static const double more[3] = { 2e-4, 1e-3, 4e-3 };
    for (unsigned attempt = 0; attempt < 4 && s->sent > room; attempt++) {
        const bool last = attempt == 3;
        s->scale *= last ? 0.99 : room / s->sent * (1 - more[attempt]);
        if (s->wanted > 0 && room > 0)
            s->allow = fmin(s->allow, s->scale * s->wanted / room);
        supply_encode(c, i, last ? &c->cut : &c->dither, bytes);
    }
}

void wall_colour_frame(struct wall_colour *c, const float *drive, double fade, uint64_t tick, uint8_t *const bytes[])
{
    const struct wall_def *d = c->def;
    const double steps = c->started && tick > c->tick ? (double)(tick - c->tick) : 1;
    c->started = true;
    c->tick = tick;
    c->fade = fade > 0 ? fmin(fade, 1) : 0;
    dither_make(&c->dither, d->dither, tick);
    gather(c, drive);
    for (unsigned i = 0; i < d->n_supplies; i++)
        supply_settle(c, i, steps);
    for (unsigned b = 0; b < d->n_boards; b++) {
        if (c->board[b].leds < c->layout->board[b].leds)
            memset(bytes[b], 0, 3 * (size_t)c->layout->board[b].leds);
        if (d->board[b].supply < 0)
            board_encode(c, b, &c->dither, bytes[b]);
    }
    for (unsigned i = 0; i < d->n_supplies; i++) {
        supply_encode(c, i, &c->dither, bytes);
        if (d->supply[i].amps > 0)
            supply_hold(c, i, bytes);
    }
}

/* ---- estimates -------------------------------------------------------------------------------------------- */

struct wall_power wall_colour_board(const struct wall_colour *c, unsigned board)
{
    const struct board *b = &c->board[board];
    const double idle = (double)c->def->board[board].idle_amps * b->leds;
    return (struct wall_power){ .amps = idle + board_amps(c, board, b->sent),
                                .wanted = idle + c->fade * board_amps(c, board, b->wanted),
                                .scale = supply_scale(c, board) };
}

struct wall_power wall_colour_supply(const struct wall_colour *c, unsigned supply)
{
    const struct supply *s = &c->supply[supply];
    return (struct wall_power){ .amps = s->idle + s->sent, .wanted = s->idle + c->fade * s->wanted, .scale = s->scale };
}
