// SPDX-License-Identifier: Apache-2.0
// wall.c - see wall.h: opening and closing a wall, pictures and patterns in, figures and previews out. Invariant: pixels are
// copied outside `lock`, so whoever pushes never makes a tick wait for more than a few instructions.
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "wall_internal.h"

/* ---- open ------------------------------------------------------------------------------------------------------ */

static int set_make(struct wall_set *s, const struct wall *w)
{
    s->bytes = calloc((size_t)w->def->n_boards + 1, sizeof(*s->bytes));
    for (unsigned b = 0; s->bytes && b < w->def->n_boards; b++)
        if (!(s->bytes[b] = calloc(1, w->out[b].size)))
            return -1;
    return s->bytes ? 0 : -1;
}

static void set_free(struct wall_set *s, unsigned boards)
{
    for (unsigned b = 0; s->bytes && b < boards; b++)
        free(s->bytes[b]);
    free(s->bytes);
}

/* The ticks that the longest delay spans, the one in the making, and one to spare. */
static unsigned sets_needed(const struct wall_def *d)
{
    double most_ms = 0;
    for (unsigned b = 0; b < d->n_boards; b++)
        most_ms = fmax(most_ms, d->board[b].delay_ms);
    return (unsigned)ceil(most_ms * 1e-3 * d->rate) + 2;
}

static int make_buffers(struct wall *w)
{
    const struct wall_def *d = w->def;
    w->out = calloc((size_t)d->n_boards + 1, sizeof(*w->out));
    w->sets = sets_needed(d);
    w->set = calloc(w->sets, sizeof(*w->set));
    w->board_power = calloc((size_t)d->n_boards + 1, sizeof(*w->board_power));
    w->supply_power = calloc((size_t)d->n_supplies + 1, sizeof(*w->supply_power));
    w->pattern_drive = calloc(w->values, sizeof(*w->pattern_drive));
    if (!w->out || !w->set || !w->board_power || !w->supply_power || !w->pattern_drive)
        return -1;
    for (unsigned b = 0; b < d->n_boards; b++)
        w->out[b] = (struct wall_out){ .size = 3 * (size_t)w->layout->board[b].leds,
                                       .delay_ns = (uint64_t)llrint(d->board[b].delay_ms * 1e6) };
    for (unsigned i = 0; i < w->sets; i++)
        if (set_make(&w->set[i], w))
            return -1;
    return set_make(&w->preview, w);
}

static int add_boards(struct wall *w, struct fault *f)
{
    for (unsigned b = 0; w->usb && b < w->def->n_boards; b++) {
        const struct wall_board *d = &w->def->board[b];
        struct panel_config c = { .kind = d->kind, .width = d->width, .height = d->height, .rate = w->def->rate };
        _Static_assert(sizeof(c.serial) == sizeof(d->serial), "a serial is copied whole");
        memcpy(c.serial, d->serial, sizeof(c.serial));
        wall_colour_lut(w->def, c.lut);
        if (usb_board_add(&w->out[b].usb, w->usb, &c, f))
            return -1;
    }
    return 0;
}

static void make_locks(struct wall *w)
{
    pthread_mutexattr_t a;
    pthread_mutexattr_init(&a);
    // Whoever holds what a real-time thread waits for must not be kept from the processor by a third.
    pthread_mutexattr_setprotocol(&a, PTHREAD_PRIO_INHERIT);
    pthread_mutex_init(&w->lock, &a);
    pthread_mutexattr_destroy(&a);
    pthread_mutex_init(&w->show_lock, NULL);
    pthread_mutex_init(&w->preview_lock, NULL);
}

/* Everything but the boards; the definition stays its owner's. */
static void wall_free(struct wall *w)
{
    set_free(&w->preview, w->out ? w->def->n_boards : 0);
    for (unsigned i = 0; w->set && i < w->sets; i++)
        set_free(&w->set[i], w->out ? w->def->n_boards : 0);
    for (unsigned i = 0; i < PACER_SLOTS; i++)
        free(w->slot[i]);
    free(w->set);
    free(w->out);
    free(w->board_power);
    free(w->supply_power);
    free(w->pattern_drive);
    wall_colour_destroy(w->colour);
    wall_layout_free(w->layout);
    pthread_mutex_destroy(&w->lock);
    pthread_mutex_destroy(&w->show_lock);
    pthread_mutex_destroy(&w->preview_lock);
    free(w);
}

static void remove_boards(struct wall *w, unsigned timeout_ms)
{
    for (unsigned b = 0; w->out && b < w->def->n_boards; b++)
        usb_board_remove(w->out[b].usb, timeout_ms);
}

int wall_create(struct wall **out, struct wall_def *def, struct usb *usb, void (*log)(const char *line), struct fault *f)
{
    struct wall *w = calloc(1, sizeof(*w));
    if (!w)
        return fault_set(f, FAULT_NO_MEMORY, "wall", "no memory for wall %s", def->name);
    w->def = def;
    w->usb = usb;
    w->log = log;
    w->values = 3 * (size_t)def->width * def->height;
    w->skew_ms = -1;
    make_locks(w);
    if (wall_layout_make(&w->layout, def, f) || wall_colour_create(&w->colour, def, w->layout, f))
        goto fail;
    if (make_buffers(w)) {
        fault_set(f, FAULT_NO_MEMORY, "wall", "no memory for wall %s of %u x %u pixels", def->name, def->width, def->height);
        goto fail;
    }
    if (add_boards(w, f))
        goto fail;
    pacer_init(&w->pacer, wall_now_ns(), def->rate, def->hold_s, def->fade_s);
    if (wall_thread_start(w, f))
        goto fail;
    *out = w;
    return 0;
fail:
    remove_boards(w, 0);
    wall_free(w);
    return -1;
}

/* ---- close ----------------------------------------------------------------------------------------------------- */

static bool all_idle(struct wall *w)
{
    for (unsigned b = 0; b < w->def->n_boards; b++)
        if (w->out[b].usb && !usb_board_idle(w->out[b].usb))
            return false;
    return true;
}

static void go_black(struct wall *w)
{
    const uint64_t now_ns = wall_now_ns(), until_ns = now_ns + 1000000000;
    for (unsigned b = 0; b < w->def->n_boards; b++) {
        uint8_t *bytes = w->set[0].bytes[b];
        memset(bytes, 0, w->out[b].size);
        if (w->out[b].usb)
            usb_board_send(w->out[b].usb, bytes, now_ns);
    }
    while (!all_idle(w) && wall_now_ns() < until_ns)
        nanosleep(&(struct timespec){ .tv_nsec = 1000000 }, NULL);
}

void wall_destroy(struct wall *w)
{
    if (!w)
        return;
    wall_thread_stop(w);
    go_black(w);
    remove_boards(w, 0);
    struct wall_def *def = w->def;
    wall_free(w);
    wall_def_free(def);
}

const struct wall_def *wall_definition(const struct wall *w) { return w->def; }
const struct wall_layout *wall_layout(const struct wall *w) { return w->layout; }

/* ---- pictures and patterns --------------------------------------------------------------------------------------- */

void wall_show(struct wall *w, const float *drive, uint64_t present_ns, double exposure)
{
    pthread_mutex_lock(&w->show_lock);
    pthread_mutex_lock(&w->lock);
    const int slot = pacer_take(&w->pacer); // always one: writers take turns
    pthread_mutex_unlock(&w->lock);
    if (!w->slot[slot])
        w->slot[slot] = malloc(w->values * sizeof(*drive));
    if (w->slot[slot])
        memcpy(w->slot[slot], drive, w->values * sizeof(*drive));
    pthread_mutex_lock(&w->lock);
    if (w->slot[slot])
        pacer_push(&w->pacer, slot, wall_now_ns(), present_ns, exposure);
    else
        pacer_give(&w->pacer, slot);
    pthread_mutex_unlock(&w->lock);
    pthread_mutex_unlock(&w->show_lock);
}

int wall_pattern(struct wall *w, const struct wall_pattern *p, struct fault *f)
{
    if (wall_pattern_draw(NULL, w->def, w->layout, p, 0, f))
        return -1;
    pthread_mutex_lock(&w->lock);
    w->pattern = *p;
    w->pattern_ns = wall_now_ns();
    w->pattern_number++;
    w->pacer.pattern = p->kind != PATTERN_NONE;
    pthread_mutex_unlock(&w->lock);
    return 0;
}

/* ---- figures ------------------------------------------------------------------------------------------------------- */

void wall_stats(struct wall *w, struct wall_stats *out)
{
    struct meter late, skew;
    struct meter_second second;
    pthread_mutex_lock(&w->lock);
    *out = w->published;
    late = w->late;
    skew = w->skew;
    second = w->second;
    pthread_mutex_unlock(&w->lock);
    out->late = meter_times(&late);
    out->skew = meter_times(&skew);
    meter_second_read(&second, wall_now_ns(), &out->fps, &out->pictures_per_s);
}

void wall_board_stats(struct wall *w, unsigned board, struct usb_stats *out, struct wall_times *latency, struct wall_power *power)
{
    uint32_t us[USB_LATENCIES];
    float ms[USB_LATENCIES];
    *out = (struct usb_stats){ .state = USB_ABSENT };
    if (w->out[board].usb)
        usb_board_stats(w->out[board].usb, out, us);
    for (uint32_t i = 0; i < out->latency_count; i++)
        ms[i] = (float)us[i] / 1000;
    *latency = meter_percentiles(ms, out->latency_count);
    pthread_mutex_lock(&w->lock);
    *power = w->board_power[board];
    pthread_mutex_unlock(&w->lock);
}

struct wall_power wall_supply_power(struct wall *w, unsigned supply)
{
    pthread_mutex_lock(&w->lock);
    const struct wall_power p = w->supply_power[supply];
    pthread_mutex_unlock(&w->lock);
    return p;
}

/* ---- preview -------------------------------------------------------------------------------------------------------- */

static uint8_t srgb_byte(double light)
{
    const double v = light <= 0.0031308 ? 12.92 * light : 1.055 * pow(light, 1 / 2.4) - 0.055;
    return (uint8_t)lrint(255 * v);
}

void wall_preview(struct wall *w, uint8_t *rgb)
{
    const struct wall_def *d = w->def;
    uint8_t shown[256];
    for (unsigned n = 0; n < 256; n++)
        shown[n] = srgb_byte(wall_transfer_light(d, n / 255.0));
    memset(rgb, 0, w->values);
    pthread_mutex_lock(&w->preview_lock);
    for (unsigned b = 0; b < d->n_boards; b++) {
        const struct wall_board_map *m = &w->layout->board[b];
        for (uint32_t k = 0; k < m->leds; k++)
            for (unsigned i = 0; m->pixel[k] >= 0 && i < 3; i++)
                rgb[3 * (size_t)m->pixel[k] + d->board[b].order[i]] = shown[w->preview.bytes[b][3 * (size_t)k + i]];
    }
    pthread_mutex_unlock(&w->preview_lock);
}
