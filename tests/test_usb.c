// SPDX-License-Identifier: Apache-2.0
//
// test_usb.c - boards over libusb, against emulated ones: opening, bytes, pacing, hot-plug, lists. Faults are in
// test_usb_faults.c. Runs under umockdev-wrapper.
#include <limits.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "usb_rig.h"

enum { LEDS = 512 };

// ---- opening and frames ---------------------------------------------------------------------------------------

static void test_opens_and_sends(void **state)
{
    (void)state;
    struct kit_board *k = kit_fadecandy(rig_kit, "OPENSANDSENDS");
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_FADECANDY, k->serial, 64, 8);
    rig_wait_state(b, USB_READY);
    rig_send(b, LEDS, 0x030201);
    rig_wait_frames(k, 1);
    rig_wait_idle(b);

    pthread_mutex_lock(&k->lock);
    assert_int_equal(k->configs, 1);
    assert_int_equal(k->luts, 1);
    assert_int_equal(k->bad, 0);
    assert_int_equal(k->config[0], 0x80);
    assert_int_equal(k->config[1], 0x02);
    assert_int_equal(k->frame[0], 0x00);
    assert_memory_equal(k->frame + 1, "\x01\x02\x03", 3);
    assert_int_equal(k->frame[1536], 0x38);
    uint8_t rgb[3 * LEDS];
    rig_frame(rgb, LEDS, 0x030201);
    for (unsigned p = 0; p < LEDS; p++)
        assert_memory_equal(k->frame + p / 21 * 64 + 1 + p % 21 * 3, rgb + 3 * p, 3);
    pthread_mutex_unlock(&k->lock);

    const struct usb_stats s = rig_stats(b);
    assert_int_equal(s.sent, 1);
    assert_int_equal(s.opens, 1);
    assert_int_equal(s.latency_count, 1);
    assert_true(s.last_done_ns > 0);
    assert_true(strncmp(s.path, "1-", 2) == 0);
    usb_board_remove(b, 1000);
    usb_destroy(u);
    kit_unplug(k);
    assert_int_equal(kit_open_fds(k), 0);
    assert_int_equal(k->claims, k->releases);
}

static bool has_counters(void *arg)
{
    const struct usb_stats s = rig_stats(arg);
    return s.received == 120 && s.rendered == 7 * 120;
}

// The rate is kept: every frame arrives, in order, the table once, the board's own counters are read.
static void test_sixty_frames_per_second(void **state)
{
    (void)state;
    struct kit_board *k = kit_fadecandy(rig_kit, "SIXTY");
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_FADECANDY, k->serial, 64, 8);
    rig_wait_state(b, USB_READY);
    rig_send_steady(b, k, LEDS, 1, 120, 60);
    rig_wait_idle(b);
    for (unsigned i = 0; i < 120; i++)
        assert_int_equal(k->id[i], i + 1);
    assert_int_equal(k->luts, 1);
    assert_int_equal(rig_stats(b).sent, 120);
    assert_int_equal(rig_stats(b).dropped, 0);
    assert_true(rig_until(has_counters, b));
    static uint32_t latency[USB_LATENCIES];
    struct usb_stats s;
    usb_board_stats(b, &s, latency);
    assert_int_equal(s.latency_count, 120);
    uint32_t worst = 0;
    for (unsigned i = 0; i < s.latency_count; i++)
        worst = latency[i] > worst ? latency[i] : worst;
    assert_true(latency[0] >= 1500); // the model's own time for a frame
    print_message("# ready to last transfer, worst of 120: %u us\n", worst);
    usb_destroy(u);
    kit_unplug(k);
}

// The content is 3 * 64 * 2 bytes of 3 * 512: the rest is dark.
static void test_small_board(void **state)
{
    (void)state;
    struct kit_board *k = kit_fadecandy(rig_kit, "SMALL");
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_FADECANDY, k->serial, 64, 2);
    rig_wait_state(b, USB_READY);
    rig_send(b, 128, 0xffffff);
    rig_wait_frames(k, 1);
    uint8_t rgb[3 * 128];
    rig_frame(rgb, 128, 0xffffff);
    for (unsigned p = 0; p < LEDS; p++)
        assert_memory_equal(k->frame + p / 21 * 64 + 1 + p % 21 * 3, p < 128 ? rgb + 3 * p : (const uint8_t *)"\0\0\0", 3);
    usb_destroy(u);
    kit_unplug(k);
}

static void test_gud_full_rate(void **state)
{
    (void)state;
    enum { W = 256, H = 128, N = 60 };
    struct kit_board *k = kit_gud(rig_kit, "GUDFULL", W, H);
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_GUD, k->serial, W, H);
    rig_wait_state(b, USB_READY);
    assert_true(k->committed && k->lit);
    rig_send_steady(b, k, W * H, 1, N, 60);
    rig_wait_idle(b);
    const struct usb_stats s = rig_stats(b);
    assert_int_equal(s.sent + s.dropped, N);
    assert_int_equal(s.dropped, 0);
    assert_int_equal(k->frames, N);
    assert_int_equal(k->buffers, N);
    assert_int_equal(k->bad, 0);
    uint8_t *rgb = malloc(3 * W * H);
    rig_frame(rgb, W * H, N);
    for (size_t i = 0; i < W * H; i++) {
        assert_int_equal(k->picture[3 * i], rgb[3 * i + 2]);
        assert_int_equal(k->picture[3 * i + 1], rgb[3 * i + 1]);
        assert_int_equal(k->picture[3 * i + 2], rgb[3 * i]);
    }
    free(rgb);
    usb_destroy(u);
    kit_unplug(k);
}

// ---- coming and going -----------------------------------------------------------------------------------------

static void test_late_plug(void **state)
{
    (void)state;
    struct kit_board *k = kit_fadecandy(rig_kit, "LATE");
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_FADECANDY, k->serial, 64, 8);
    rig_send(b, LEDS, 1);
    assert_int_equal(rig_stats(b).missed, 1);
    assert_int_equal(rig_stats(b).state, USB_ABSENT);
    kit_plug(k);
    rig_wait_state(b, USB_READY);
    rig_send(b, LEDS, 2);
    rig_wait_frames(k, 1);
    assert_int_equal(rig_last_id(k), 2);
    usb_destroy(u);
    kit_unplug(k);
}

static void test_twenty_replugs(void **state)
{
    (void)state;
    struct kit_board *k = kit_fadecandy(rig_kit, "REPLUG");
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_FADECANDY, k->serial, 64, 8);
    for (uint32_t i = 0; i < 20; i++) {
        kit_plug(k);
        rig_wait_state(b, USB_READY);
        rig_send(b, LEDS, i + 1);
        rig_wait_frames(k, i + 1);
        assert_int_equal(rig_last_id(k), i + 1);
        assert_int_equal(k->luts, i + 1);
        assert_int_equal(k->configs, i + 1);
        kit_unplug(k);
        rig_wait_state(b, USB_ABSENT);
    }
    const struct usb_stats s = rig_stats(b);
    assert_int_equal(s.opens, 20);
    assert_int_equal(s.losses, 20);
    assert_int_equal(s.sent, 20);
    usb_board_remove(b, 0);
    usb_destroy(u);
    assert_int_equal(kit_open_fds(k), 0);
}

// Where no udevd runs nothing is heard of arrivals and departures.
static void test_unheard_arrival(void **state)
{
    (void)state;
    struct kit_board *k = kit_fadecandy(rig_kit, "UNHEARD");
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_FADECANDY, k->serial, 64, 8);
    for (uint32_t i = 1; i <= 2; i++) {
        kit_plug_unheard(k);
        rig_wait_state(b, USB_READY);
        rig_send(b, LEDS, i);
        rig_wait_frames(k, i);
        assert_int_equal(rig_last_id(k), i);
        kit_unplug(k);
        rig_wait_state(b, USB_ABSENT);
    }
    assert_int_equal(rig_stats(b).losses, 2);
    usb_destroy(u);
    assert_int_equal(kit_open_fds(k), 0);
}

static void test_remove_and_add_again(void **state)
{
    (void)state;
    struct kit_board *k = kit_fadecandy(rig_kit, "AGAIN");
    kit_plug(k);
    struct usb *u = rig_usb();
    for (uint32_t i = 1; i <= 3; i++) {
        struct usb_board *b = rig_add(u, WALL_FADECANDY, k->serial, 64, 8);
        rig_wait_state(b, USB_READY);
        rig_send(b, LEDS, i);
        usb_board_remove(b, 5000); // waits for what is in flight
        assert_int_equal(kit_frames(k), i);
    }
    usb_destroy(u);
    assert_int_equal(k->claims, 3);
    assert_int_equal(k->releases, 3);
    kit_unplug(k);
}

// ---- who is there ---------------------------------------------------------------------------------------------

static const struct usb_found *found_at(const struct usb_found *f, unsigned n, const char *serial, unsigned nth)
{
    for (unsigned i = 0; i < n; i++)
        if (strcmp(f[i].serial, serial) == 0 && nth-- == 0)
            return &f[i];
    return NULL;
}

static bool twins_reported(void *arg)
{
    (void)arg;
    return rig_logged("fadecandy TWIN is there twice");
}

static bool opened_twice(void *arg)
{
    const struct usb_stats s = rig_stats(arg);
    return s.opens == 2 && s.state == USB_READY;
}

static void test_one_serial_twice(void **state)
{
    (void)state;
    struct kit_board *k1 = kit_fadecandy(rig_kit, "TWIN"), *k2 = kit_fadecandy(rig_kit, "TWIN");
    struct usb_found f[8];
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_FADECANDY, "TWIN", 64, 8);
    kit_plug(k1);
    rig_wait_state(b, USB_READY);
    kit_plug(k2);
    assert_true(rig_until(twins_reported, NULL));
    const unsigned n = usb_list(u, f, 8, 3000);
    assert_int_equal(n, 2);
    assert_true(found_at(f, n, "TWIN", 0)->twice && found_at(f, n, "TWIN", 1)->twice);
    assert_true(found_at(f, n, "TWIN", 0)->in_use);
    assert_false(found_at(f, n, "TWIN", 1)->in_use);
    rig_send(b, LEDS, 1);
    rig_wait_frames(k1, 1);
    assert_int_equal(kit_frames(k2), 0);
    kit_unplug(k1); // the other one takes over
    assert_true(rig_until(opened_twice, b));
    rig_send(b, LEDS, 2);
    rig_wait_frames(k2, 1);
    assert_int_equal(rig_last_id(k2), 2);
    usb_destroy(u);
    kit_unplug(k2);
}

static void test_unknown_serial_is_absent(void **state)
{
    (void)state;
    struct kit_board *k = kit_fadecandy(rig_kit, "KNOWN");
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *nobody = rig_add(u, WALL_FADECANDY, "NOBODY", 64, 8);
    struct usb_board *wrong_kind = rig_add(u, WALL_GUD, "KNOWN", 64, 8);
    struct usb_board *b = rig_add(u, WALL_FADECANDY, "KNOWN", 64, 8);
    rig_wait_state(b, USB_READY);
    rig_send(nobody, LEDS, 1);
    rig_send(b, LEDS, 1);
    rig_wait_frames(k, 1);
    assert_int_equal(rig_stats(nobody).state, USB_ABSENT);
    assert_int_equal(rig_stats(wrong_kind).state, USB_ABSENT);
    assert_int_equal(rig_stats(nobody).missed, 1);
    usb_destroy(u);
    kit_unplug(k);
}

static void test_list(void **state)
{
    (void)state;
    struct kit_board *k[5] = { kit_fadecandy(rig_kit, "LISTED"), kit_gud(rig_kit, "DISPLAY", 8, 4),
                               kit_fadecandy(rig_kit, ""), kit_fadecandy(rig_kit, ""), kit_gud(rig_kit, "OTHERID", 8, 4) };
    memset(k[3]->serial, 'L', 100);
    k[4]->vendor = 0x16d0;
    k[4]->product = 0x10a9;
    for (unsigned i = 0; i < 5; i++)
        kit_plug(k[i]);
    struct usb *u = rig_usb();
    struct usb_found f[8];
    assert_int_equal(usb_list(u, f, 8, 3000), 5);
    assert_int_equal(usb_list(u, f, 2, 3000), 2);
    assert_int_equal(usb_list(u, f, 8, 3000), 5);
    assert_int_equal(found_at(f, 5, "LISTED", 0)->kind, WALL_FADECANDY);
    assert_int_equal(found_at(f, 5, "LISTED", 0)->release, 0x0108);
    assert_int_equal(found_at(f, 5, "DISPLAY", 0)->kind, WALL_GUD);
    assert_int_equal(found_at(f, 5, "OTHERID", 0)->kind, WALL_GUD);
    unsigned empty = 0, too_long = 0;
    for (unsigned i = 0; i < 5; i++) {
        assert_true(strchr(f[i].path, '-') != NULL);
        assert_false(f[i].twice);
        empty += strstr(f[i].why, "cannot be read: empty") != NULL;
        too_long += strstr(f[i].why, "a serial number of 100 letters, expected at most 63") != NULL;
    }
    assert_int_equal(empty, 1);
    assert_int_equal(too_long, 1);
    usb_destroy(u);
    for (unsigned i = 0; i < 5; i++)
        kit_unplug(k[i]);
}

static void test_bad_requests(void **state)
{
    (void)state;
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_FADECANDY, "MINE", 64, 8), *none = NULL;
    struct fault f = { 0 };
    struct panel_config c = rig_config(WALL_FADECANDY, "MINE", 64, 8);
    assert_int_equal(usb_board_add(&none, u, &c, &f), -1);
    assert_int_equal(f.code, FAULT_WALL);
    assert_string_equal(f.text, "fadecandy MINE is in use by another wall");
    c.kind = (enum wall_board_kind)7;
    assert_int_equal(usb_board_add(&none, u, &c, &f), -1);
    c = rig_config(WALL_FADECANDY, "", 64, 8);
    assert_int_equal(usb_board_add(&none, u, &c, &f), -1);
    c = rig_config(WALL_GUD, "BIG", 65536, 65536);
    assert_int_equal(usb_board_add(&none, u, &c, &f), -1);
    assert_string_equal(f.field, "size");
    c = rig_config(WALL_GUD, "RATE", 8, 8);
    c.rate = 0;
    assert_int_equal(usb_board_add(&none, u, &c, &f), -1);
    assert_string_equal(f.field, "rate");
    assert_null(none);
    usb_board_remove(b, 0);
    usb_board_remove(NULL, 0);
    usb_destroy(u);
    usb_destroy(NULL);
}

// Another process, which knows nothing of the kit, sees the emulated boards.
static void test_other_process(void **state)
{
    (void)state;
    struct kit_board *k1 = kit_fadecandy(rig_kit, "PROBED"), *k2 = kit_gud(rig_kit, "PROBEDTOO", 16, 8);
    kit_plug(k1);
    kit_plug(k2);
    char path[PATH_MAX], text[1024];
    const ssize_t n = readlink("/proc/self/exe", path, sizeof(path) - 32);
    assert_true(n > 0);
    path[n] = '\0';
    strcpy(strrchr(path, '/'), "/usb_probe");
    // The shell between is no program of TSan's, which may be preloaded, too.
    setenv("LD_PRELOAD", "libumockdev-preload.so.0", 1);
    FILE *p = popen(path, "r");
    assert_non_null(p);
    text[fread(text, 1, sizeof(text) - 1, p)] = '\0';
    assert_int_equal(pclose(p), 0);
    char want[1024];
    snprintf(want, sizeof(want), "fadecandy PROBED 1-%u \ngud PROBEDTOO 1-%u \n", k1->port, k2->port);
    assert_string_equal(text, want);
    kit_unplug(k1);
    kit_unplug(k2);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(test_opens_and_sends, rig_teardown),
        cmocka_unit_test_teardown(test_sixty_frames_per_second, rig_teardown),
        cmocka_unit_test_teardown(test_small_board, rig_teardown),
        cmocka_unit_test_teardown(test_gud_full_rate, rig_teardown),
        cmocka_unit_test_teardown(test_late_plug, rig_teardown),
        cmocka_unit_test_teardown(test_twenty_replugs, rig_teardown),
        cmocka_unit_test_teardown(test_unheard_arrival, rig_teardown),
        cmocka_unit_test_teardown(test_remove_and_add_again, rig_teardown),
        cmocka_unit_test_teardown(test_one_serial_twice, rig_teardown),
        cmocka_unit_test_teardown(test_unknown_serial_is_absent, rig_teardown),
        cmocka_unit_test_teardown(test_list, rig_teardown),
        cmocka_unit_test_teardown(test_bad_requests, rig_teardown),
        cmocka_unit_test_teardown(test_other_process, rig_teardown),
    };
    return cmocka_run_group_tests(tests, rig_group_setup, rig_group_teardown);
}
