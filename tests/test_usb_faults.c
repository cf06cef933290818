// SPDX-License-Identifier: Apache-2.0
//
// test_usb_faults.c - what goes wrong on the bus: stalls, held transfers, no memory, boards that leave in every way, slow
// ones, and the other boards that must not notice. Every frame that was sent is accounted for. Under umockdev-wrapper.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "usb_rig.h"

enum { LEDS = 512 };

struct pair {
    struct kit_board *kit;
    struct usb *usb;
    struct usb_board *board;
};

static struct pair pair_open(const char *serial)
{
    struct pair p = { .kit = kit_fadecandy(rig_kit, serial) };
    kit_plug(p.kit);
    p.usb = rig_usb();
    p.board = rig_add(p.usb, WALL_FADECANDY, serial, 64, 8);
    rig_wait_state(p.board, USB_READY);
    return p;
}

static void pair_close(struct pair *p)
{
    usb_destroy(p->usb);
    assert_int_equal(kit_open_fds(p->kit), 0);
    assert_int_equal(p->kit->bad, 0);
    assert_null(p->kit->flying);
}

static void assert_all_counted(struct usb_board *b, uint64_t sends)
{
    const struct usb_stats s = rig_stats(b);
    if (s.sent + s.dropped + s.missed != sends)
        fail_msg("sent %llu + dropped %llu + missed %llu != %llu", (unsigned long long)s.sent,
                 (unsigned long long)s.dropped, (unsigned long long)s.missed, (unsigned long long)sends);
}

static void assert_ids_rise(const struct kit_board *k)
{
    for (uint64_t i = 1; i < k->frames && i < KIT_LOG; i++)
        assert_true(k->id[i] > k->id[i - 1]);
}

static void test_slow_board(void **state)
{
    (void)state;
    struct pair p = pair_open("SLOW");
    KIT_SET(p.kit, delay_us, 40000);
    rig_send_paced(p.board, LEDS, 1, 60, 60);
    rig_wait_idle(p.board);
    const struct usb_stats s = rig_stats(p.board);
    assert_all_counted(p.board, 60);
    assert_true(s.dropped > 20);
    assert_int_equal(s.sent, kit_frames(p.kit));
    assert_int_equal(rig_last_id(p.kit), 60); // the newest wins
    assert_ids_rise(p.kit);
    assert_int_equal(s.timeouts, 0);
    pair_close(&p);
}

static bool was_cleared(void *arg) { return rig_stats(((struct pair *)arg)->board).stalls > 0; }

// The endpoint stays halted until the halt is cleared; the frame that fell is sent again, whole.
static void test_stall(void **state)
{
    (void)state;
    struct pair p = pair_open("STALL");
    rig_send_steady(p.board, p.kit, LEDS, 1, 5, 60);
    KIT_SET(p.kit, stall_next, 1);
    rig_send(p.board, LEDS, 6);
    assert_true(rig_until(was_cleared, &p));
    rig_wait_frames(p.kit, 6); // with no frame after it
    rig_wait_idle(p.board);
    assert_int_equal(rig_last_id(p.kit), 6);
    KIT_SET(p.kit, stall_next, 1);
    rig_send_steady(p.board, p.kit, LEDS, 7, 30, 60);
    const struct usb_stats s = rig_stats(p.board);
    assert_int_equal(s.stalls, 2);
    assert_int_equal(p.kit->clears, 2);
    assert_all_counted(p.board, 36);
    assert_int_equal(rig_last_id(p.kit), 36);
    assert_int_equal(s.dropped, 0); // each came the second time, before the next was due
    assert_ids_rise(p.kit);
    assert_int_equal(p.kit->luts, 1);
    pair_close(&p);
}

// A board that stalls every frame costs a clear a frame, not more, and never takes anything else down.
static void test_stall_always(void **state)
{
    (void)state;
    struct pair p = pair_open("STALLALWAYS");
    KIT_SET(p.kit, stall_next, 1000);
    rig_send_paced(p.board, LEDS, 1, 30, 60);
    assert_int_equal(rig_stats(p.board).sent, 0);
    assert_true(rig_stats(p.board).stalls <= 31);
    KIT_SET(p.kit, stall_next, 0);
    rig_send_paced(p.board, LEDS, 31, 10, 60);
    rig_wait_idle(p.board);
    assert_int_equal(rig_last_id(p.kit), 40);
    assert_all_counted(p.board, 40);
    pair_close(&p);
}

static bool has_timeout(void *arg) { return rig_stats(arg).timeouts > 0; }

static void test_held_transfer(void **state)
{
    (void)state;
    struct pair p = pair_open("HELD");
    KIT_SET(p.kit, hold, true);
    rig_send_paced(p.board, LEDS, 1, 4, 60);
    assert_true(rig_until(has_timeout, p.board));
    assert_true(kit_count(p.kit, &p.kit->cancels) > 0);
    assert_int_equal(kit_frames(p.kit), 0);
    KIT_SET(p.kit, hold, false);
    rig_send(p.board, LEDS, 5);
    rig_wait_idle(p.board);
    assert_int_equal(rig_last_id(p.kit), 5);
    assert_int_equal(rig_stats(p.board).state, USB_READY);
    assert_int_equal(rig_stats(p.board).losses, 0);
    assert_all_counted(p.board, 5);
    pair_close(&p);
}

static void test_no_memory(void **state)
{
    (void)state;
    struct pair p = pair_open("ENOMEM");
    KIT_SET(p.kit, enomem_next, 1);
    rig_send(p.board, LEDS, 1);
    assert_int_equal(rig_stats(p.board).errors, 1);
    assert_int_equal(kit_frames(p.kit), 0);
    rig_send(p.board, LEDS, 2);
    rig_wait_idle(p.board);
    assert_int_equal(kit_frames(p.kit), 1);
    assert_int_equal(rig_last_id(p.kit), 2);
    assert_int_equal(rig_stats(p.board).dropped, 1);
    assert_all_counted(p.board, 2);
    pair_close(&p);
}

static void test_unplug_in_flight(void **state)
{
    (void)state;
    struct pair p = pair_open("UNPLUG");
    KIT_SET(p.kit, hold, true);
    rig_send(p.board, LEDS, 1);
    rig_send(p.board, LEDS, 2);
    rig_send(p.board, LEDS, 3);
    kit_unplug(p.kit);
    rig_wait_state(p.board, USB_ABSENT);
    struct usb_stats s = rig_stats(p.board);
    assert_int_equal(s.losses, 1);
    assert_int_equal(s.missed, 3);
    assert_non_null(strstr(s.why, "lost"));
    KIT_SET(p.kit, hold, false);
    kit_plug(p.kit);
    rig_wait_state(p.board, USB_READY);
    rig_send(p.board, LEDS, 4);
    rig_wait_frames(p.kit, 1);
    rig_wait_idle(p.board);
    s = rig_stats(p.board);
    assert_int_equal(s.opens, 2);
    assert_string_equal(s.why, "");
    assert_all_counted(p.board, 4);
    pair_close(&p);
}

// ENODEV, and nobody said that it left.
static void test_silent_loss(void **state)
{
    (void)state;
    struct pair p = pair_open("SILENT");
    rig_send(p.board, LEDS, 1);
    rig_wait_frames(p.kit, 1);
    kit_vanish(p.kit);
    rig_send(p.board, LEDS, 2);
    rig_wait_state(p.board, USB_ABSENT);
    assert_int_equal(rig_stats(p.board).losses, 1);
    assert_int_equal(rig_stats(p.board).missed, 1);
    kit_unplug(p.kit);
    kit_plug(p.kit);
    rig_wait_state(p.board, USB_READY);
    rig_send(p.board, LEDS, 3);
    rig_wait_frames(p.kit, 2);
    assert_int_equal(rig_last_id(p.kit), 3);
    pair_close(&p);
}

static void test_one_lost_the_other_goes_on(void **state)
{
    (void)state;
    struct kit_board *k1 = kit_fadecandy(rig_kit, "STAYS"), *k2 = kit_fadecandy(rig_kit, "GOES");
    kit_plug(k1);
    kit_plug(k2);
    struct usb *u = rig_usb();
    struct usb_board *b1 = rig_add(u, WALL_FADECANDY, "STAYS", 64, 8), *b2 = rig_add(u, WALL_FADECANDY, "GOES", 64, 8);
    rig_wait_state(b1, USB_READY);
    rig_wait_state(b2, USB_READY);
    for (uint32_t i = 1; i <= 120; i++) {
        rig_send(b2, LEDS, i);
        rig_send_steady(b1, k1, LEDS, i, 1, 60);
        if (i == 60) {
            KIT_SET(k2, hold, true);
            rig_send(b2, LEDS, i);
            kit_vanish(k2); // with a transfer in flight; the event below
        } else if (i == 62) {
            kit_unplug(k2);
        }
        rig_sleep_ms(8);
    }
    rig_wait_state(b2, USB_ABSENT);
    assert_int_equal(rig_stats(b2).losses, 1);
    assert_int_equal(rig_stats(b1).sent, 120);
    assert_int_equal(rig_stats(b1).dropped + rig_stats(b1).missed + rig_stats(b1).errors, 0);
    assert_all_counted(b2, 121);
    for (unsigned i = 0; i < 120; i++)
        assert_int_equal(k1->id[i], i + 1);
    usb_destroy(u);
    assert_int_equal(kit_open_fds(k1) + kit_open_fds(k2), 0);
}

static bool is_listed(void *arg)
{
    struct usb_found found[2];
    return usb_list(arg, found, 2, 3000) == 1 && found[0].serial[0];
}

// A board that answers nothing while it is opened keeps no other one waiting.
static void test_mute_board(void **state)
{
    (void)state;
    struct kit_board *k1 = kit_gud(rig_kit, "MUTE", 8, 4), *k2 = kit_fadecandy(rig_kit, "TALKS");
    struct usb *u = rig_usb();
    kit_plug(k1);
    assert_true(rig_until(is_listed, u)); // its serial is read
    KIT_SET(k1, mute, true);
    struct usb_board *b1 = rig_add(u, WALL_GUD, "MUTE", 8, 4), *b2 = rig_add(u, WALL_FADECANDY, "TALKS", 64, 8);
    kit_plug(k2);
    rig_wait_state(b2, USB_READY);
    rig_send(b2, LEDS, 1);
    rig_wait_frames(k2, 1);
    rig_wait_state(b1, USB_FAILED);
    assert_non_null(strstr(rig_stats(b1).why, "descriptor"));
    KIT_SET(k1, mute, false); // an I/O error is no refusal: it is tried again
    rig_wait_state(b1, USB_READY);
    usb_destroy(u);
    assert_int_equal(kit_open_fds(k1) + kit_open_fds(k2), 0);
}

static void test_destroy_in_any_state(void **state)
{
    (void)state;
    struct kit_board *k = kit_fadecandy(rig_kit, "ANYSTATE");
    usb_destroy(rig_usb());
    kit_plug(k);
    usb_destroy(rig_usb()); // the serial is perhaps being read
    for (unsigned i = 0; i < 5; i++) {
        struct usb *u = rig_usb();
        rig_add(u, WALL_FADECANDY, "ANYSTATE", 64, 8);
        rig_sleep_ms(i); // perhaps half open
        usb_destroy(u);
        assert_int_equal(kit_open_fds(k), 0);
    }
    KIT_SET(k, hold, true);
    for (unsigned i = 0; i < 2; i++) { // with transfers in flight, then beyond a time-out that is still to come
        KIT_SET(k, hold, false);
        struct usb *u = rig_usb();
        struct usb_board *b = rig_add(u, WALL_FADECANDY, "ANYSTATE", 64, 8);
        rig_wait_state(b, USB_READY);
        KIT_SET(k, hold, true);
        for (uint32_t n = 1; n <= 3; n++)
            rig_send(b, LEDS, n);
        if (i == 0)
            usb_board_remove(b, 20);
        usb_destroy(u);
        assert_int_equal(kit_open_fds(k), 0);
        assert_null(k->flying);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(test_slow_board, rig_teardown),
        cmocka_unit_test_teardown(test_stall, rig_teardown),
        cmocka_unit_test_teardown(test_stall_always, rig_teardown),
        cmocka_unit_test_teardown(test_held_transfer, rig_teardown),
        cmocka_unit_test_teardown(test_no_memory, rig_teardown),
        cmocka_unit_test_teardown(test_unplug_in_flight, rig_teardown),
        cmocka_unit_test_teardown(test_silent_loss, rig_teardown),
        cmocka_unit_test_teardown(test_one_lost_the_other_goes_on, rig_teardown),
        cmocka_unit_test_teardown(test_mute_board, rig_teardown),
        cmocka_unit_test_teardown(test_destroy_in_any_state, rig_teardown),
    };
    return cmocka_run_group_tests(tests, rig_group_setup, rig_group_teardown);
}
