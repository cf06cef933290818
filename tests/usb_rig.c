// SPDX-License-Identifier: Apache-2.0
// usb_rig.c - see usb_rig.h.
#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <cmocka.h>

#include "usb_rig.h"

struct usb_kit *rig_kit;

static pthread_mutex_t log_lock = PTHREAD_MUTEX_INITIALIZER;
static char log_text[1 << 16];

static uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

static void sleep_until(uint64_t ns)
{
    const struct timespec t = { .tv_sec = (time_t)(ns / 1000000000u), .tv_nsec = (long)(ns % 1000000000u) };
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL))
        continue;
}

void rig_sleep_ms(unsigned ms) { sleep_until(now_ns() + ms * 1000000ull); }

int rig_group_setup(void **state)
{
    (void)state;
    rig_kit = kit_create();
    if (!rig_kit)
        fprintf(stderr, "run this program under umockdev-wrapper\n");
    return rig_kit ? 0 : -1;
}

int rig_group_teardown(void **state)
{
    (void)state;
    kit_destroy(rig_kit);
    return 0;
}

int rig_teardown(void **state)
{
    (void)state;
    kit_unplug_all(rig_kit);
    return 0;
}

static void on_log(const char *line)
{
    pthread_mutex_lock(&log_lock);
    const size_t at = strlen(log_text);
    snprintf(log_text + at, sizeof(log_text) - at, "%s\n", line);
    if (getenv("AIRY_TEST_LOG"))
        fprintf(stderr, "# %s\n", line);
    pthread_mutex_unlock(&log_lock);
}

bool rig_logged(const char *words)
{
    pthread_mutex_lock(&log_lock);
    const bool is = strstr(log_text, words);
    pthread_mutex_unlock(&log_lock);
    return is;
}

struct usb *rig_usb(void)
{
    struct usb *u = NULL;
    struct fault f = { 0 };
    pthread_mutex_lock(&log_lock);
    log_text[0] = '\0';
    pthread_mutex_unlock(&log_lock);
    if (usb_create(&u, on_log, &f))
        fail_msg("usb_create: %s", f.text);
    return u;
}

struct panel_config rig_config(enum wall_board_kind kind, const char *serial, uint32_t width, uint32_t height)
{
    struct panel_config c = { .kind = kind, .width = width, .height = height, .rate = 2 };
    snprintf(c.serial, sizeof(c.serial), "%s", serial);
    for (unsigned ch = 0; ch < 3; ch++)
        for (unsigned e = 0; e < 257; e++)
            c.lut[ch * 257 + e] = (uint16_t)(ch * 0x4000 + e * 16);
    return c;
}

struct usb_board *rig_add(struct usb *u, enum wall_board_kind kind, const char *serial, uint32_t width, uint32_t height)
{
    const struct panel_config c = rig_config(kind, serial, width, height);
    struct usb_board *b = NULL;
    struct fault f = { 0 };
    if (usb_board_add(&b, u, &c, &f))
        fail_msg("usb_board_add: %s", f.text);
    return b;
}

void rig_frame(uint8_t *rgb, size_t leds, uint32_t n)
{
    for (size_t i = 0; i < 3 * leds; i++)
        rgb[i] = (uint8_t)(n * 7 + i * 31 + i / 256);
    for (unsigned i = 0; i < 3; i++)
        rgb[i] = (uint8_t)(n >> (8 * i));
}

void rig_send(struct usb_board *b, size_t leds, uint32_t n)
{
    uint8_t *rgb = malloc(3 * leds);
    assert_non_null(rgb);
    rig_frame(rgb, leds, n);
    usb_board_send(b, rgb, now_ns());
    free(rgb);
}

void rig_send_paced(struct usb_board *b, size_t leds, uint32_t first, unsigned count, double rate)
{
    const uint64_t start = now_ns();
    for (unsigned i = 0; i < count; i++) {
        sleep_until(start + (uint64_t)(1e9 / rate * i));
        rig_send(b, leds, first + i);
    }
}

void rig_send_steady(struct usb_board *b, struct kit_board *k, size_t leds, uint32_t first, unsigned count, double rate)
{
    uint64_t next = now_ns();
    for (unsigned i = 0; i < count; i++, next += (uint64_t)(1e9 / rate)) {
        const uint64_t frames = kit_frames(k);
        sleep_until(next);
        rig_send(b, leds, first + i);
        rig_wait_frames(k, frames + 1);
        rig_wait_idle(b);
    }
}

bool rig_until(bool (*is)(void *arg), void *arg)
{
    const uint64_t end = now_ns() + RIG_WAIT_MS * 1000000ull;
    while (!is(arg)) {
        if (now_ns() > end)
            return false;
        rig_sleep_ms(2);
    }
    kit_see_all(rig_kit);
    return true;
}

struct usb_stats rig_stats(struct usb_board *b)
{
    struct usb_stats s;
    usb_board_stats(b, &s, NULL);
    return s;
}

struct state_wait {
    struct usb_board *board;
    enum usb_state state;
};

static bool has_state(void *arg)
{
    const struct state_wait *w = arg;
    return rig_stats(w->board).state == w->state;
}

void rig_wait_state(struct usb_board *b, enum usb_state s)
{
    struct state_wait w = { b, s };
    if (rig_until(has_state, &w))
        return;
    const struct usb_stats now = rig_stats(b);
    fail_msg("state is %d (%s), expected %d", (int)now.state, now.why, (int)s);
}

static bool is_idle(void *arg) { return usb_board_idle(arg); }

void rig_wait_idle(struct usb_board *b)
{
    if (!rig_until(is_idle, b))
        fail_msg("the board is still busy");
}

void rig_wait_frames(struct kit_board *b, uint64_t n)
{
    if (!kit_wait_frames(b, n, RIG_WAIT_MS))
        fail_msg("%s has %llu frames, expected %llu", b->serial, (unsigned long long)kit_frames(b), (unsigned long long)n);
}

uint32_t rig_last_id(struct kit_board *b)
{
    pthread_mutex_lock(&b->lock);
    const uint32_t id = b->frames ? b->id[(b->frames - 1) % KIT_LOG] : 0;
    pthread_mutex_unlock(&b->lock);
    return id;
}
