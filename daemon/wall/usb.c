// SPDX-License-Identifier: Apache-2.0
//
// usb.c - see usb.h: the context, its event thread, the list of wanted boards, and what may be asked of one.
//
// Invariant: a board is in the list from before its thread starts until after it ended, so that no two boards of one kind
// and serial ever touch the same device, and so that whoever walks the list under its lock finds boards that live.
#include "usb_internal.h"

#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { EVENTS_MS = 200 };

uint64_t usb_now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

void usb_cond_init(pthread_cond_t *c)
{
    pthread_condattr_t a;
    pthread_condattr_init(&a);
    pthread_condattr_setclock(&a, CLOCK_MONOTONIC);
    pthread_cond_init(c, &a);
    pthread_condattr_destroy(&a);
}

void usb_cond_wait_until(pthread_cond_t *c, pthread_mutex_t *m, uint64_t ns)
{
    const struct timespec t = { .tv_sec = (time_t)(ns / 1000000000u), .tv_nsec = (long)(ns % 1000000000u) };
    pthread_cond_timedwait(c, m, &t);
}

void usb_log(struct usb *u, const char *format, ...)
{
    char line[512];
    va_list args;
    if (!u->log)
        return;
    va_start(args, format);
    vsnprintf(line, sizeof(line), format, args);
    va_end(args);
    u->log(line);
}

static void query_boards(struct usb *u)
{
    const uint64_t now = usb_now_ns();
    pthread_mutex_lock(&u->lock);
    for (struct usb_board *b = u->board; b; b = b->next) {
        pthread_mutex_lock(&b->lock);
        usb_flight_query(b, now);
        pthread_mutex_unlock(&b->lock);
    }
    pthread_mutex_unlock(&u->lock);
}

static void *events_main(void *arg)
{
    struct usb *u = arg;
    uint64_t query_ns = 0;
    while (!atomic_load(&u->end)) {
        struct timeval t = { .tv_usec = EVENTS_MS * 1000 };
        libusb_handle_events_timeout_completed(u->context, &t, NULL);
        if (usb_now_ns() >= query_ns) {
            query_boards(u);
            query_ns = usb_now_ns() + EVENTS_MS * 1000000ull;
        }
    }
    return NULL;
}

int usb_create(struct usb **out, void (*log)(const char *line), struct fault *f)
{
    struct usb *u = calloc(1, sizeof(*u));
    if (!u)
        return fault_set(f, FAULT_NO_MEMORY, "usb", "no memory for USB");
    u->log = log;
    pthread_mutex_init(&u->lock, NULL);
    usb_cond_init(&u->found);
    const int r = libusb_init(&u->context);
    if (r) {
        u->context = NULL;
        fault_set(f, FAULT_INTERNAL, "usb", "no USB here: %s", libusb_strerror(r));
        goto fail;
    }
    if (pthread_create(&u->events, NULL, events_main, u)) {
        fault_set(f, FAULT_NO_MEMORY, "usb", "no thread for USB");
        goto fail;
    }
    u->events_run = true;
    if (usb_find_start(u, f))
        goto fail;
    *out = u;
    return 0;
fail:
    usb_destroy(u);
    return -1;
}

void usb_destroy(struct usb *u)
{
    if (!u)
        return;
    while (u->board)
        usb_board_remove(u->board, 0);
    usb_find_stop(u);
    if (u->events_run) {
        atomic_store(&u->end, true);
        libusb_interrupt_event_handler(u->context);
        pthread_join(u->events, NULL);
    }
    usb_find_free(u);
    if (u->context)
        libusb_exit(u->context);
    pthread_cond_destroy(&u->found);
    pthread_mutex_destroy(&u->lock);
    free(u);
}

// ---- boards -----------------------------------------------------------------------------------------------------

static int check_config(const struct panel_config *c, struct fault *f)
{
    if ((unsigned)c->kind >= WALL_BOARD_KINDS)
        return fault_set(f, FAULT_WALL, "kind", "kind of board %d, expected 0 to %d", (int)c->kind, WALL_BOARD_KINDS - 1);
    if (!c->serial[0] || !memchr(c->serial, 0, sizeof(c->serial)))
        return fault_set(f, FAULT_WALL, "serial", "a board needs a serial of 1 to %d letters", WALL_NAME_MAX - 1);
    if (c->width < 1 || c->height < 1 || (uint64_t)c->width * c->height > WALL_PIXELS_MAX)
        return fault_set(f, FAULT_WALL, "size", "%u x %u LEDs, expected 1 to %d in all", c->width, c->height, WALL_PIXELS_MAX);
    if (!(c->rate >= 1 && c->rate <= 1000))
        return fault_set(f, FAULT_WALL, "rate", "%g frames per second, expected 1 to 1000", c->rate);
    return 0;
}

static void board_free(struct usb_board *b)
{
    pthread_cond_destroy(&b->change);
    pthread_mutex_destroy(&b->lock);
    free(b->newest);
    free(b);
}

static struct usb_board *board_new(struct usb *u, const struct panel_config *c)
{
    struct usb_board *b = calloc(1, sizeof(*b));
    const size_t bytes = 3 * (size_t)c->width * c->height;
    if (b)
        b->newest = malloc(bytes);
    if (!b || !b->newest) {
        free(b);
        return NULL;
    }
    b->usb = u;
    b->ops = panel_kinds[c->kind];
    b->config = *c;
    b->newest_bytes = bytes;
    b->fd = -1;
    pthread_mutex_init(&b->lock, NULL);
    usb_cond_init(&b->change);
    return b;
}

// With the lock. A board that was refused for another wall's sake may fit this one.
static int enlist(struct usb *u, struct usb_board *b, struct fault *f)
{
    for (const struct usb_board *o = u->board; o; o = o->next)
        if (o->ops == b->ops && strcmp(o->config.serial, b->config.serial) == 0)
            return fault_set(f, FAULT_WALL, "serial", "%s %s is in use by another wall", b->ops->name, b->config.serial);
    for (struct usb_entry *e = u->entry; e; e = e->next)
        if (e->ops == b->ops && strcmp(e->serial, b->config.serial) == 0) {
            e->refused = false;
            e->retry_ns = 0;
        }
    b->next = u->board;
    u->board = b;
    return 0;
}

static void delist(struct usb *u, struct usb_board *b)
{
    pthread_mutex_lock(&u->lock);
    struct usb_board **p = &u->board;
    while (*p != b)
        p = &(*p)->next;
    *p = b->next;
    pthread_mutex_unlock(&u->lock);
}

int usb_board_add(struct usb_board **out, struct usb *u, const struct panel_config *c, struct fault *f)
{
    if (check_config(c, f))
        return -1;
    struct usb_board *b = board_new(u, c);
    if (!b)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for a board");
    pthread_mutex_lock(&u->lock);
    const int taken = enlist(u, b, f);
    pthread_mutex_unlock(&u->lock);
    if (taken)
        goto fail;
    if (usb_board_start(b, f)) {
        delist(u, b);
        goto fail;
    }
    *out = b;
    return 0;
fail:
    board_free(b);
    return -1;
}

void usb_board_remove(struct usb_board *b, unsigned timeout_ms)
{
    if (!b)
        return;
    const uint64_t end = usb_now_ns() + timeout_ms * 1000000ull;
    pthread_mutex_lock(&b->lock);
    while ((b->flying > 0 || b->waiting) && usb_now_ns() < end)
        usb_cond_wait_until(&b->change, &b->lock, end);
    pthread_mutex_unlock(&b->lock);
    usb_board_stop(b);
    delist(b->usb, b);
    board_free(b);
}

void usb_board_send(struct usb_board *b, const uint8_t *rgb, uint64_t ready_ns)
{
    pthread_mutex_lock(&b->lock);
    if (b->stats.state != USB_READY || b->lost || b->stop) {
        b->stats.missed++;
    } else {
        b->stats.dropped += b->waiting;
        memcpy(b->newest, rgb, b->newest_bytes);
        b->number++;
        b->newest_ready_ns = ready_ns;
        b->waiting = true;
        usb_flight_pump(b);
    }
    pthread_mutex_unlock(&b->lock);
}

bool usb_board_idle(struct usb_board *b)
{
    pthread_mutex_lock(&b->lock);
    const bool idle = b->flying == 0 && !b->waiting;
    pthread_mutex_unlock(&b->lock);
    return idle;
}

void usb_board_stats(struct usb_board *b, struct usb_stats *out, uint32_t *latency_us)
{
    pthread_mutex_lock(&b->lock);
    *out = b->stats;
    out->latency_count = b->latencies < USB_LATENCIES ? (uint32_t)b->latencies : USB_LATENCIES;
    if (latency_us)
        memcpy(latency_us, b->latency_us, out->latency_count * sizeof(*latency_us));
    pthread_mutex_unlock(&b->lock);
}
