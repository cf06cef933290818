// SPDX-License-Identifier: Apache-2.0
// test_wall_boards.c - what a wall hands to its boards, and when by its own clock: the other side of usb.h, recorded. (Real
// transfers on emulated devices are tested with the daemon.) The linker puts the recorder before usb.h's functions (tests.mk).
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include <pthread.h>
#include <time.h>

#include "wall.h"

enum { BOARDS = 3, LEDS = 64 * 8, SENT_MAX = 4096 };

struct usb_board {
    struct panel_config config;
    unsigned sent, removed;
    bool busy;
    struct { uint64_t ready_ns; uint8_t first[3], last; } frame[SENT_MAX];
};

static struct usb_board boards[BOARDS];
static unsigned added, refuse_at;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000 + (uint64_t)t.tv_nsec;
}

int __wrap_usb_board_add(struct usb_board **out, struct usb *u, const struct panel_config *c, struct fault *f);
void __wrap_usb_board_remove(struct usb_board *b, unsigned timeout_ms);
void __wrap_usb_board_send(struct usb_board *b, const uint8_t *rgb, uint64_t ready_ns);
bool __wrap_usb_board_idle(struct usb_board *b);
void __wrap_usb_board_stats(struct usb_board *b, struct usb_stats *out, uint32_t *latency_us);

int __wrap_usb_board_add(struct usb_board **out, struct usb *u, const struct panel_config *c, struct fault *f)
{
    assert_non_null(u);
    if (added == refuse_at)
        return fault_set(f, FAULT_WALL, "serial", "%s is in use by another wall", c->serial);
    boards[added] = (struct usb_board){ .config = *c };
    *out = &boards[added++];
    return 0;
}

void __wrap_usb_board_remove(struct usb_board *b, unsigned timeout_ms)
{
    assert_in_range(timeout_ms, 0, 1000);
    if (b)
        b->removed++;
}

void __wrap_usb_board_send(struct usb_board *b, const uint8_t *rgb, uint64_t ready_ns)
{
    pthread_mutex_lock(&lock);
    if (b->sent < SENT_MAX) {
        b->frame[b->sent].ready_ns = ready_ns;
        memcpy(b->frame[b->sent].first, rgb, 3);
        b->frame[b->sent++].last = rgb[3 * LEDS - 1];
    }
    pthread_mutex_unlock(&lock);
}

bool __wrap_usb_board_idle(struct usb_board *b) { return !b->busy; }

/* Done 50 ms after it was sent, 100, 150: far more than this machine is ever late. */
void __wrap_usb_board_stats(struct usb_board *b, struct usb_stats *out, uint32_t *latency_us)
{
    const unsigned i = (unsigned)(b - boards);
    *out = (struct usb_stats){ .state = USB_READY };
    pthread_mutex_lock(&lock);
    out->sent = b->sent;
    if (b->sent)
        out->last_done_ns = b->frame[b->sent - 1].ready_ns + (i + 1) * 50000000;
    pthread_mutex_unlock(&lock);
    if (latency_us)
        for (; out->latency_count < 10; out->latency_count++)
            latency_us[out->latency_count] = (i + 1) * 50000;
}

static struct wall_def *three_boards(void)
{
    struct wall_def *d = calloc(1, sizeof(*d));
    *d = (struct wall_def){ .name = "three", .width = 64, .height = 24, .rate = 100, .hold_s = 2, .fade_s = 1, .brightness = 1,
                            .gamma = 2.2, .dither = WALL_DITHER_OFF, .n_panels = BOARDS, .n_boards = BOARDS, .n_runs = BOARDS };
    d->panel = calloc(BOARDS, sizeof(*d->panel));
    d->board = calloc(BOARDS, sizeof(*d->board));
    d->run = calloc(BOARDS, sizeof(*d->run));
    for (unsigned b = 0; b < BOARDS; b++) {
        d->panel[b] = (struct wall_panel){ .y = 8 * b, .width = 64, .height = 8, .gain = { 1, 1, 1 } };
        d->board[b] = (struct wall_board){ .name = { (char)('a' + b) }, .serial = { (char)('A' + b) }, .width = 64, .height = 8,
                                           .brightness = 1, .supply = -1, .order = { 0, 1, 2 } };
        d->run[b] = (struct wall_run){ .panel = b, .board = b, .count = LEDS };
    }
    d->board[1].delay_ms = 3.5;
    d->board[2].delay_ms = 34;
    return d;
}

static void start(struct wall **w)
{
    struct fault f = { 0 };
    memset(boards, 0, sizeof(boards));
    added = 0;
    refuse_at = BOARDS;
    // Only the recorder sees it.
    assert_int_equal(wall_create(w, three_boards(), (struct usb *)&added, NULL, &f), 0);
}

static void wait_ticks(struct wall *w, uint64_t more)
{
    struct wall_stats s;
    wall_stats(w, &s);
    for (const uint64_t until = s.ticks + more; s.ticks < until; wall_stats(w, &s))
        nanosleep(&(struct timespec){ .tv_nsec = 2000000 }, NULL);
}

static void wait_shown(struct wall *w, uint64_t pictures)
{
    struct wall_stats s;
    for (wall_stats(w, &s); s.shown < pictures; wall_stats(w, &s))
        nanosleep(&(struct timespec){ .tv_nsec = 1000000 }, NULL);
}

/* Numbered pictures, each with another green: every board gets them in order, and a board with a delay not before it is over. */
static void test_boards_get_all_ticks_in_order(void **state)
{
    (void)state;
    static float drive[64 * 24 * 3];
    struct wall *w;
    start(&w);
    assert_int_equal(added, BOARDS);
    for (unsigned b = 0; b < BOARDS; b++) {
        assert_int_equal(boards[b].config.serial[0], 'A' + b);
        assert_true(boards[b].config.width == 64 && boards[b].config.height == 8 && boards[b].config.rate == 100);
        assert_int_equal(boards[b].config.lut[257 + 255], 65535);
    }
    uint64_t pushed_ns[256] = { 0 };
    const struct wall_def *d = wall_definition(w);
    for (unsigned n = 1; n <= 100; n++) {
        for (unsigned i = 0; i < 64 * 24; i++)
            drive[3 * i + 1] = (float)wall_transfer_light(d, n / 255.0);
        pushed_ns[n] = now_ns();
        wall_show(w, drive, 0, 0);
        wait_shown(w, n);
    }
    wait_ticks(w, 8);
    struct wall_stats s;
    wall_stats(w, &s);
    // The recorder's boards come back 100 ms apart, each after its own delay and as late as it was sent.
    assert_true(s.skew.max > 90 && s.skew.max < 100000); // ms; a machine that stands still adds to it
    struct usb_stats u;
    struct wall_times latency;
    struct wall_power power;
    wall_board_stats(w, 2, &u, &latency, &power);
    assert_true(u.state == USB_READY && latency.p50 == 150 && latency.max == 150);
    wall_destroy(w);

    for (unsigned b = 0; b < BOARDS; b++) {
        const struct usb_board *o = &boards[b];
        unsigned before = 0;
        assert_in_range(o->sent, 100, SENT_MAX - 1);
        for (unsigned i = 0; i + 1 < o->sent; i++) {
            const unsigned n = o->frame[i].first[1];
            assert_in_range(n, before, before + 1);
            if (n > before)
                assert_true(o->frame[i].ready_ns >= pushed_ns[n]);
            before = n;
        }
        assert_int_equal(before, 100);
        // The last is black.
        const uint8_t *last = o->frame[o->sent - 1].first;
        assert_int_equal(last[0] | last[1] | last[2] | o->frame[o->sent - 1].last, 0);
        assert_int_equal(o->removed, 1);
    }
    // The same tick leaves that much later for each; one that comes too late for all of them leaves for all at once.
    unsigned delayed = 0;
    for (unsigned i = 0; i < 100; i++) {
        unsigned at[BOARDS];
        for (unsigned b = 0; b < BOARDS; b++)
            for (at[b] = 0; boards[b].frame[at[b]].first[1] != i + 1; at[b]++)
                ;
        assert_true(boards[2].frame[at[2]].ready_ns >= boards[1].frame[at[1]].ready_ns);
        assert_true(boards[1].frame[at[1]].ready_ns >= boards[0].frame[at[0]].ready_ns);
        delayed += boards[2].frame[at[2]].ready_ns - boards[0].frame[at[0]].ready_ns >= 24000000;
    }
    assert_true(delayed >= 10);
}

static void test_a_board_that_never_rests(void **state)
{
    (void)state;
    struct wall *w;
    start(&w);
    wait_ticks(w, 2);
    boards[1].busy = true;
    wall_destroy(w); // gives up waiting
    for (unsigned b = 0; b < BOARDS; b++)
        assert_int_equal(boards[b].removed, 1);
}

static void test_a_board_of_another_wall(void **state)
{
    (void)state;
    struct wall *w = NULL;
    struct fault f = { 0 };
    struct wall_def *d = three_boards();
    memset(boards, 0, sizeof(boards));
    added = 0;
    refuse_at = 2;
    assert_int_equal(wall_create(&w, d, (struct usb *)&added, NULL, &f), -1);
    assert_null(w);
    assert_int_equal(f.code, FAULT_WALL);
    assert_true(boards[0].removed == 1 && boards[1].removed == 1);
    wall_def_free(d); // still the caller's
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_boards_get_all_ticks_in_order),
        cmocka_unit_test(test_a_board_that_never_rests),
        cmocka_unit_test(test_a_board_of_another_wall),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
