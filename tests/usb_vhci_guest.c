// SPDX-License-Identifier: Apache-2.0
//
// usb_vhci_guest.c - the wall (usb_vhci_drive), a real kernel's USB and a Fadecandy of usb_vhci: an operator's evening, from the
// board's arrival to the black last frame. Runs inside the machine that usb_vhci.sh boots; it plugs devices into the kernel it
// runs on. With the argument "wall" the wall runs without the daemon. The tests are one story and build on each other: one that fails takes the later ones with it.
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

#include "usb_vhci.h"
#include "usb_vhci_drive.h"

enum { WAIT_MS = 60000, LEDS = 512, RATE = 60, SECONDS = 5 };

#define SERIAL "ENICCULVLDQJQDWD"

static const char definition[] =
    "wall: w\n"
    "rate: 60\n"
    "colour: {transfer: 2.2, dither: off}\n"
    "panels:\n"
    "  - {name: p, at: [0, 0], size: [64, 8]}\n"
    "boards:\n"
    "  - {serial: " SERIAL ", order: GRB, panels: [p]}\n";

static bool with_daemon, stopped;
static struct vhci_board *the_board;

static uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

static double ms_since(uint64_t ns) { return (double)(int64_t)(now_ns() - ns) * 1e-6; }

static void nap(void) { nanosleep(&(struct timespec){ .tv_nsec = 2000000 }, NULL); }

static void wait_state(const char *state)
{
    for (const uint64_t start = now_ns(); ms_since(start) < WAIT_MS; nap()) {
        const struct drive_state s = drive_look();
        if (strcmp(s.state, state) == 0)
            return;
    }
    fail_msg("the board did not become %s", state);
}

// ---- the board's side -----------------------------------------------------------------------------------------------

struct seen {
    uint64_t frames, luts, configs, bad, clears, cancels;
    uint8_t frame[KIT_FRAME_BYTES], lut[KIT_FRAME_BYTES], config[64];
};

static struct seen look(void)
{
    struct kit_board *k = vhci_kit(the_board);
    pthread_mutex_lock(&k->lock);
    struct seen s = { .frames = k->frames, .luts = k->luts, .configs = k->configs, .bad = k->bad, .clears = k->clears,
                      .cancels = k->cancels };
    memcpy(s.frame, k->frame, sizeof s.frame);
    memcpy(s.lut, k->lut, sizeof s.lut);
    memcpy(s.config, k->config, sizeof s.config);
    pthread_mutex_unlock(&k->lock);
    return s;
}

static void wait_frames_more(uint64_t n)
{
    const uint64_t have = vhci_frames(the_board);
    if (!vhci_wait_frames(the_board, have + n, WAIT_MS))
        fail_msg("%llu frames came in %d ms, expected %llu", (unsigned long long)(vhci_frames(the_board) - have), WAIT_MS,
                 (unsigned long long)n);
}

// One LED, first <= k < first + count, of the three bytes; all others dark.
static void golden(uint8_t frame[KIT_FRAME_BYTES], unsigned first, unsigned count, const uint8_t bytes[3])
{
    memset(frame, 0, KIT_FRAME_BYTES);
    for (unsigned i = 0; i < 25; i++)
        frame[i * 64] = i == 24 ? 0x38 : (uint8_t)i;
    for (unsigned k = first; k < first + count; k++)
        memcpy(frame + k / 21 * 64 + 1 + 3 * (k % 21), bytes, 3);
}

static void expect_frame(const struct seen *s, const uint8_t want[KIT_FRAME_BYTES])
{
    for (unsigned i = 0; i < KIT_FRAME_BYTES; i++)
        if (s->frame[i] != want[i])
            fail_msg("byte %u of the frame is %02x, expected %02x", i, s->frame[i], want[i]);
}

// Within a few frames of being asked for, and then in every one.
static void expect_light(unsigned first, unsigned count, const uint8_t bytes[3])
{
    uint8_t want[KIT_FRAME_BYTES];
    golden(want, first, count, bytes);
    wait_frames_more(8);
    for (unsigned i = 0; i < 3; i++) {
        const struct seen s = look();
        expect_frame(&s, want);
        wait_frames_more(1);
    }
}

static const uint8_t white[3] = { 255, 255, 255 }, red[3] = { 0, 255, 0 }, blue[3] = { 0, 0, 255 }; // GRB

// ---- the story --------------------------------------------------------------------------------------------------------

static void plug(void)
{
    const int r = vhci_plug(the_board);
    if (r)
        fail_msg("no device for vhci_hcd: %s", strerror(-r));
}

static void say_arrival(uint64_t plugged_ns)
{
    const struct kit_board *k = vhci_kit(the_board);
    const uint64_t first = k->at_ns[(vhci_frames(the_board) - 1) % KIT_LOG], configured = vhci_configured_ns(the_board);
    printf("# first frame %.0f ms after the kernel had configured the board, which took it %.0f ms\n",
           (double)(int64_t)(first - configured) * 1e-6, (double)(int64_t)(configured - plugged_ns) * 1e-6);
}

static void wait_first_frame(uint64_t plugged_ns, uint64_t have)
{
    if (!vhci_wait_frames(the_board, have + 1, WAIT_MS))
        fail_msg("no frame came to a board that was plugged in");
    say_arrival(plugged_ns);
    wait_state("ready");
}

// The daemon runs first; the board's arrival comes to it by way of udevd.
static void test_arrival(void **state)
{
    (void)state;
    if (access("/run/udev/control", F_OK) < 0)
        fail_msg("no udevd runs here");
    wait_state("absent");
    const uint64_t plugged = now_ns();
    plug();
    wait_first_frame(plugged, 0);
    const struct drive_state s = drive_look();
    assert_int_equal(s.controllers, 1);
    assert_string_equal(s.kind, "fadecandy");
    assert_string_equal(s.serial, SERIAL);
    assert_string_equal(s.trouble, "");
    printf("# at %s\n", s.path);
}

static void test_bytes(void **state)
{
    (void)state;
    static const unsigned leds[] = { 0, 20, 21, 64, 503, 504, 511 };
    drive_pattern("red", 0);
    expect_light(0, LEDS, red);
    drive_pattern("blue", 0);
    expect_light(0, LEDS, blue);
    for (unsigned i = 0; i < sizeof leds / sizeof leds[0]; i++) {
        drive_pattern("led", leds[i]);
        expect_light(leds[i], 1, white);
    }
}

static void test_tables_once(void **state)
{
    (void)state;
    const struct seen s = look();
    assert_int_equal(s.luts, 1);
    assert_int_equal(s.configs, 1);
    assert_int_equal(s.config[1] & 3, 2); // dithers, does not interpolate
    for (unsigned i = 0; i < 25; i++)
        assert_int_equal(s.lut[i * 64], 0x40 | i | (i == 24 ? 0x20 : 0));
    for (unsigned at = 0; at < 3 * 257; at++) {
        const uint8_t *v = s.lut + at / 31 * 64 + 2 + 2 * (at % 31);
        const double want = 65535 * pow(fmin(1, at % 257 / 255.0), 2.2);
        if (fabs((v[0] | v[1] << 8) - want) > 0.51)
            fail_msg("table entry %u is %u, expected %.2f", at, v[0] | v[1] << 8, want);
    }
}

// So many frames come, all sound; how fast and how many were lost is told, for this machine may be an emulated one.
static void test_rate(void **state)
{
    (void)state;
    drive_pattern("white", 0);
    wait_frames_more(1);
    const struct drive_state before = drive_look();
    const uint64_t start = now_ns(), have = vhci_frames(the_board);
    if (!vhci_wait_frames(the_board, have + RATE * SECONDS, WAIT_MS))
        fail_msg("%llu frames came in %d ms", (unsigned long long)(vhci_frames(the_board) - have), WAIT_MS);
    const double took_s = ms_since(start) / 1000;
    const struct drive_state s = drive_look();
    printf("# %d frames in %.3f s: %.2f a second, %llu dropped, %llu missed; ready to done p50 %.2f p99 %.2f max %.2f ms\n",
           RATE * SECONDS, took_s, RATE * SECONDS / took_s, (unsigned long long)(s.dropped - before.dropped),
           (unsigned long long)(s.missed - before.missed), s.latency.p50, s.latency.p99, s.latency.max);
    printf("# ticks late p50 %.3f p99 %.3f max %.3f ms\n", s.late.p50, s.late.p99, s.late.max);
    assert_int_equal(s.stalls + s.losses, 0);
    assert_int_equal(look().bad, 0);
}

// A real halt: the endpoint stalls until usbcore has cleared it.
static void test_stall(void **state)
{
    (void)state;
    const struct seen before = look();
    KIT_SET(vhci_kit(the_board), stall_next, 1);
    const uint64_t start = now_ns();
    for (; ms_since(start) < WAIT_MS && look().clears == before.clears;)
        nap();
    const struct seen cleared = look();
    assert_int_equal(cleared.clears, before.clears + 1);
    const uint64_t have = cleared.frames;
    if (!vhci_wait_frames(the_board, have + 1, WAIT_MS))
        fail_msg("no frame came after the halt was cleared");
    printf("# light again %.0f ms after a stall was asked for\n", ms_since(start));
    expect_light(0, LEDS, white);
    const struct drive_state s = drive_look();
    assert_true(s.stalls >= 1);
    assert_int_equal(s.losses, 0);
    assert_string_equal(s.state, "ready");
    assert_int_equal(look().luts, before.luts); // mended, not opened anew
    assert_int_equal(look().clears, before.clears + 1);
}

// A board that takes nothing for a while: cancelled, down to usbcore's unlink.
static void test_held(void **state)
{
    (void)state;
    const struct seen before = look();
    KIT_SET(vhci_kit(the_board), hold, true);
    for (const uint64_t start = now_ns(); ms_since(start) < WAIT_MS && look().cancels == before.cancels;)
        nap();
    assert_true(look().cancels > before.cancels);
    KIT_SET(vhci_kit(the_board), hold, false);
    expect_light(0, LEDS, white);
    const struct drive_state s = drive_look();
    assert_true(s.timeouts >= 1);
    assert_int_equal(s.losses, 0);
}

static void test_unplugged(void **state)
{
    (void)state;
    const uint64_t start = now_ns();
    vhci_unplug(the_board);
    wait_state("absent");
    printf("# absent %.0f ms after the plug was pulled\n", ms_since(start));
    // The transfer says so first; the words come when the board is closed, the event when udevd has passed it on.
    struct drive_state s = drive_look();
    for (; (s.controllers || !s.problem[0]) && ms_since(start) < WAIT_MS; s = drive_look())
        nap();
    assert_int_equal(s.losses, 1);
    assert_int_equal(s.controllers, 0);
    assert_true(s.problem[0]);
    printf("# off the list after %.0f ms\n", ms_since(start));
}

static void test_back(void **state)
{
    (void)state;
    const struct seen before = look();
    const uint64_t plugged = now_ns();
    plug();
    wait_first_frame(plugged, before.frames);
    expect_light(0, LEDS, white);
    assert_int_equal(look().luts, before.luts + 1); // a new board knows nothing
    assert_int_equal(look().bad, 0);
}

static void test_black_at_the_end(void **state)
{
    (void)state;
    uint8_t dark[KIT_FRAME_BYTES];
    golden(dark, 0, 0, white);
    const struct seen lit = look();
    assert_int_equal(lit.frame[1], 255);
    stopped = true;
    assert_int_equal(drive_stop(), 0);
    const struct seen s = look();
    assert_true(s.frames > lit.frames);
    expect_frame(&s, dark);
    assert_int_equal(s.bad, 0);
}

// ---- set up -------------------------------------------------------------------------------------------------------------

static int start(void **state)
{
    (void)state;
    const uint64_t begin = now_ns();
    the_board = vhci_create(SERIAL, 0);
    assert_non_null(the_board);
    drive_start(definition, with_daemon);
    printf("# it was up after %.1f s\n", ms_since(begin) / 1000);
    return 0;
}

static int stop(void **state)
{
    (void)state;
    if (!stopped)
        drive_stop();
    vhci_destroy(the_board);
    return 0;
}

int main(int argc, char **argv)
{
    with_daemon = argc < 2 || strcmp(argv[1], "wall") != 0;
    setvbuf(stdout, NULL, _IOLBF, 0);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_arrival),   cmocka_unit_test(test_bytes), cmocka_unit_test(test_tables_once),
        cmocka_unit_test(test_rate),      cmocka_unit_test(test_stall), cmocka_unit_test(test_held),
        cmocka_unit_test(test_unplugged), cmocka_unit_test(test_back),  cmocka_unit_test(test_black_at_the_end),
    };
    return cmocka_run_group_tests(tests, start, stop);
}
