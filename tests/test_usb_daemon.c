// SPDX-License-Identifier: Apache-2.0
// test_usb_daemon.c - the unmodified daemon and emulated controllers: from a client's frame to the bytes on the wire, and what an
// operator does to both. Under umockdev-wrapper. The bytes are worked out here from the frame's linear drive, the definition and
// the controllers' tables, by other means than the daemon's.
#include "daemon_fixture.h"

#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "usb_kit.h"

enum { WAIT_MS = 100000, SIDE = 32, ROWS = 16, LEDS = SIDE * ROWS };

static struct usb_kit *the_kit;
static struct daemon the_daemon;

static int start(void **state)
{
    (void)state;
    the_kit = kit_create();
    if (!the_kit)
        fail_msg("no emulation of USB: run this under umockdev-wrapper");
    daemon_start(&the_daemon, (const char *const[]){ "--threads", "2", NULL });
    return 0;
}

static int stop(void **state)
{
    (void)state;
    int status = daemon_stop(&the_daemon, SIGTERM);
    kit_destroy(the_kit);
    assert_int_equal(status, 0);
    return 0;
}

// What a test that failed has left open shall not fail the next, nor a controller of which the daemon has not yet seen that it is gone.
static int unplug(void **state)
{
    (void)state;
    struct airy *a;
    struct airy_error e;
    struct airy_wall_reply *r = NULL;
    const struct airy_wall_request close = { .action = AIRY_WALL_CLOSE, .name = "w" }, list = { .action = AIRY_WALL_LIST };
    kit_unplug_all(the_kit);
    if (airy_connect(&a, the_daemon.path, &e) < 0)
        return -1;
    if (airy_wall(a, &close, WAIT_MS, &r, &e) == 0)
        airy_wall_reply_free(r);
    size_t there = 1;
    for (int64_t end = daemon_now_ms() + WAIT_MS; there && daemon_now_ms() < end && airy_wall(a, &list, WAIT_MS, &r, &e) == 0; daemon_nap()) {
        there = r->n_controllers;
        airy_wall_reply_free(r);
    }
    airy_close(a);
    return there ? -1 : 0;
}

// ---- client ------------------------------------------------------------------------------------------------------------

static struct airy_wall_reply *ask(struct airy *a, struct airy_wall_request q)
{
    struct airy_wall_reply *r = NULL;
    struct airy_error e;
    if (airy_wall(a, &q, 60000, &r, &e) < 0)
        fail_msg("%s: %s (%s)", e.symbol, e.text, e.field);
    return r;
}

static void open_wall(struct airy *a, const char *text)
{
    airy_wall_reply_free(ask(a, (struct airy_wall_request){ .action = AIRY_WALL_OPEN, .definition = text }));
}

static void close_wall(struct airy *a, const char *name)
{
    airy_wall_reply_free(ask(a, (struct airy_wall_request){ .action = AIRY_WALL_CLOSE, .name = name }));
}

static void pattern(struct airy *a, const char *word, const char *board, uint32_t led)
{
    airy_wall_reply_free(ask(a, (struct airy_wall_request){ .action = AIRY_WALL_PATTERN, .name = "w", .pattern = word, .board = board,
                                                            .led = led, .level = 1 }));
}

static struct airy_result *bloom(struct airy *a, struct airy_request *r)
{
    struct airy_error e;
    struct airy_result *result = NULL;
    uint64_t id;
    if (airy_submit(a, r, &id, &e) < 0 || airy_wait(a, id, 60000, &result, &e) != 1)
        fail_msg("%s: %s (%s)", e.symbol, e.text, e.field);
    return result;
}

static struct airy_request request(const struct picture *p, bool show)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    picture_request(p, &r);
    r.data = p->pixels;
    r.size = picture_bytes(p);
    r.wall = "w";
    r.show = show;
    return r;
}

static void show(struct airy *a, const struct picture *p)
{
    struct airy_request r = request(p, true);
    airy_result_free(bloom(a, &r));
}

static float *drive_of(struct airy *a, const struct picture *p, size_t pixels)
{
    struct airy_request r = request(p, false);
    struct airy_result *got = bloom(a, &r);
    assert_int_equal(got->size, pixels * 12);
    float *out = malloc(pixels * 12);
    memcpy(out, got->data, pixels * 12);
    airy_result_free(got);
    return out;
}

static void wait_board(struct airy *a, unsigned board, const char *state)
{
    for (int i = 0; i < WAIT_MS / 10; i++) {
        struct airy_wall_reply *r = ask(a, (struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = "w" });
        const bool is = !strcmp(r->walls[0].boards[board].state, state);
        airy_wall_reply_free(r);
        if (is)
            return;
        nanosleep(&(struct timespec){ 0, 10000000 }, NULL);
    }
    fail_msg("board %u did not become %s", board, state);
}

// ---- the wire ----------------------------------------------------------------------------------------------------------

// LED k of a Fadecandy frame, byte c as it lies on the wire.
static uint8_t wire(const uint8_t *frame, unsigned k, unsigned c) { return frame[k / 21 * 64 + 1 + 3 * (k % 21) + c]; }

struct snapshot {
    uint8_t frame[KIT_FRAME_BYTES];
};

static struct snapshot take(struct kit_board *b)
{
    struct snapshot s;
    pthread_mutex_lock(&b->lock);
    memcpy(s.frame, b->frame, sizeof s.frame);
    pthread_mutex_unlock(&b->lock);
    return s;
}

// Frames that were begun before now have come through: whatever was said before is on the boards.
static void settle(struct kit_board *b)
{
    if (!kit_wait_frames(b, kit_frames(b) + 8, WAIT_MS))
        fail_msg("no frames came to %s", b->serial);
}

static bool is_dark(struct kit_board *b)
{
    const struct snapshot s = take(b);
    unsigned lit = 0;
    for (unsigned k = 0; k < 512 * 3; k++)
        lit += wire(s.frame, k / 3, k % 3) != 0;
    return lit == 0;
}

static void wait_dark(struct kit_board *b, bool dark)
{
    for (int i = 0; i < WAIT_MS / 5; i++) {
        if (is_dark(b) == dark)
            return;
        nanosleep(&(struct timespec){ 0, 5000000 }, NULL);
    }
    fail_msg("%s did not become %s", b->serial, dark ? "dark" : "lit");
}

static const char one_board[] =
    "wall: w\n"
    "size: [32, 16]\n"
    "rate: 100\n"
    "%s"
    "colour: {transfer: 2.2, dither: off}\n"
    "panels:\n"
    "  - {name: p, at: [0, 0], size: [32, 16], wiring: {serpentine: true}}\n"
    "boards:\n"
    "  - {serial: ABCDEFGHIJKLMNOP, order: GRB, panels: [p]}\n";

static char *text_of(const char *format, const char *more)
{
    static char text[2048];
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wformat-nonliteral"
    snprintf(text, sizeof text, format, more);
#pragma GCC diagnostic pop
    return text;
}

// ---- tests ---------------------------------------------------------------------------------------------------------------

// Every byte of a frame: serpentine wiring, order of colours, transfer curve; the table and the configuration; FINAL and numbers.
static void test_bytes(void **state)
{
    (void)state;
    struct picture p = picture_make(320, 160, 40, 77);
    struct kit_board *b = kit_fadecandy(the_kit, "ABCDEFGHIJKLMNOP");
    kit_plug(b);
    struct airy *a = daemon_join(&the_daemon);
    open_wall(a, text_of(one_board, "hold: forever\n"));
    float *drive = drive_of(a, &p, LEDS);
    wait_board(a, 0, "ready");
    show(a, &p);
    wait_dark(b, false);
    settle(b);
    const struct snapshot s = take(b);
    static const unsigned order[3] = { 1, 0, 2 };
    unsigned lit = 0, levels = 0;
    bool seen[256] = { false };
    for (unsigned k = 0; k < LEDS; k++) {
        const unsigned y = k / SIDE, x = y % 2 ? SIDE - 1 - k % SIDE : k % SIDE;
        for (unsigned c = 0; c < 3; c++) {
            const double light = fmin(1, fmax(0, (double)drive[(y * SIDE + x) * 3 + order[c]]));
            const double code = 255 * pow(light, 1 / 2.2);
            const uint8_t got = wire(s.frame, k, c);
            if (fabs(got - code) > 0.5 + 0.01)
                fail_msg("LED %u (pixel %u, %u), byte %u: %u sent; %.4f expected", k, x, y, c, got, code);
            lit += got > 0;
            levels += !seen[got];
            seen[got] = true;
        }
    }
    assert_true(lit > 200 && levels > 20);
    for (unsigned i = 0; i < 25; i++)
        assert_int_equal(s.frame[i * 64], i == 24 ? 0x38 : i);
    pthread_mutex_lock(&b->lock);
    assert_int_equal(b->bad, 0);
    assert_int_equal(b->luts, 1);
    assert_int_equal(b->configs, 1);
    assert_int_equal(b->config[1] & 3, 2);
    for (unsigned i = 0; i < 25; i++)
        assert_int_equal(b->lut[i * 64], 0x40 | i | (i == 24 ? 0x20 : 0));
    for (unsigned e = 0; e < 257; e++)
        for (unsigned c = 0; c < 3; c++) {
            const unsigned at = c * 257 + e;
            const uint8_t *v = b->lut + at / 31 * 64 + 2 + 2 * (at % 31);
            const double want = 65535 * pow(fmin(1, e / 255.0), 2.2);
            if (fabs((v[0] | v[1] << 8) - want) > 0.51)
                fail_msg("table entry %u of channel %u: %u; %.2f expected", e, c, v[0] | v[1] << 8, want);
        }
    pthread_mutex_unlock(&b->lock);
    free(drive);
    picture_free(&p);
    // Closed: black at last, and nobody holds the board.
    close_wall(a, "w");
    wait_dark(b, true);
    for (int i = 0; i < WAIT_MS / 5 && kit_count(b, &b->releases) == 0; i++)
        nanosleep(&(struct timespec){ 0, 5000000 }, NULL);
    assert_true(kit_count(b, &b->releases) > 0);
    airy_close(a);
}

static void test_led_by_led(void **state)
{
    (void)state;
    struct kit_board *b = kit_fadecandy(the_kit, "ABCDEFGHIJKLMNOP");
    kit_plug(b);
    struct airy *a = daemon_join(&the_daemon);
    open_wall(a, text_of(one_board, ""));
    wait_board(a, 0, "ready");
    static const unsigned leds[] = { 0, 20, 21, 63, 64, 503, 504, 511 };
    for (unsigned i = 0; i < sizeof leds / sizeof leds[0]; i++) {
        pattern(a, "led", "ABCDEFGHIJKLMNOP", leds[i]);
        settle(b);
        const struct snapshot s = take(b);
        for (unsigned k = 0; k < LEDS; k++)
            for (unsigned c = 0; c < 3; c++)
                if (wire(s.frame, k, c) != (k == leds[i] ? 255 : 0))
                    fail_msg("LED %u asked for: LED %u has %u", leds[i], k, wire(s.frame, k, c));
    }
    pattern(a, "green", "", 0);
    settle(b);
    const struct snapshot s = take(b);
    for (unsigned k = 0; k < LEDS; k++)
        assert_true(wire(s.frame, k, 0) == 255 && wire(s.frame, k, 1) == 0 && wire(s.frame, k, 2) == 0);
    airy_close(a);
    wait_dark(b, true);
}

static const char two_boards[] =
    "wall: w\n"
    "rate: 100\n"
    "hold: forever\n"
    "panels:\n"
    "  - {name: p, at: [0, 0], size: [16, 16]}\n"
    "  - {name: q, at: [16, 0], size: [16, 16]}\n"
    "boards:\n"
    "  - {serial: FIRST, panels: [p]}\n"
    "  - {serial: SECOND, panels: [q]}\n";

// One of two is pulled out and put in again, many times, once by surprise: the other misses nothing, the one comes back.
static void test_pulled(void **state)
{
    (void)state;
    struct kit_board *p = kit_fadecandy(the_kit, "FIRST"), *q = kit_fadecandy(the_kit, "SECOND");
    kit_plug(p);
    struct airy *a = daemon_join(&the_daemon);
    open_wall(a, two_boards);
    wait_board(a, 0, "ready");
    wait_board(a, 1, "absent");
    kit_plug(q);
    wait_board(a, 1, "ready");
    pattern(a, "white", "", 0);
    for (unsigned i = 0; i < 6; i++) {
        settle(q);
        if (i % 3 == 2) // no event says so, for a while
            kit_vanish(q);
        else
            kit_unplug(q);
        wait_board(a, 1, "absent");
        settle(p);
        kit_unplug(q);
        kit_plug(q);
        wait_board(a, 1, "ready");
    }
    settle(q);
    assert_false(is_dark(q));
    struct airy_wall_reply *r = ask(a, (struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = "w" });
    const struct airy_wall_board *first = &r->walls[0].boards[0], *second = &r->walls[0].boards[1];
    assert_int_equal(first->losses, 0);
    assert_int_equal(first->errors + first->stalls, 0);
    if (first->timeouts) // of an emulation that had no CPU for that long
        print_message("the other board: %llu transfers timed out\n", (unsigned long long)first->timeouts);
    assert_int_equal(second->losses, 6);
    assert_true(second->missed > 0 && second->sent > 0);
    assert_int_equal(r->n_controllers, 2);
    assert_string_equal(r->controllers[0].wall, "w");
    airy_wall_reply_free(r);
    airy_close(a);
    wait_dark(q, true);
}

// The wire stalls, and hangs: counted, mended, and light again.
static void test_faults(void **state)
{
    (void)state;
    struct kit_board *b = kit_fadecandy(the_kit, "ABCDEFGHIJKLMNOP");
    kit_plug(b);
    struct airy *a = daemon_join(&the_daemon);
    open_wall(a, text_of(one_board, ""));
    wait_board(a, 0, "ready");
    pattern(a, "white", "", 0);
    settle(b);
    KIT_SET(b, stall_next, 1);
    settle(b);
    KIT_SET(b, hold, true);
    nanosleep(&(struct timespec){ 0, 300000000 }, NULL);
    KIT_SET(b, hold, false);
    settle(b);
    KIT_SET(b, enomem_next, 2);
    settle(b);
    struct airy_wall_reply *r = ask(a, (struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = "w" });
    assert_int_equal(r->walls[0].boards[0].stalls, 1);
    assert_true(r->walls[0].boards[0].timeouts >= 1);
    assert_int_equal(r->walls[0].boards[0].errors, 2);
    assert_int_equal(r->walls[0].boards[0].losses, 0);
    assert_string_equal(r->walls[0].boards[0].state, "ready");
    airy_wall_reply_free(r);
    assert_false(is_dark(b));
    airy_close(a);
}

// A client that shows frames is killed: held, faded, black; the wall is the service's and stays; then the service is stopped.
static void test_source_lost_and_stop(void **state)
{
    (void)state;
    char path[] = "/tmp/airyd-test-wall-XXXXXX";
    int fd = mkstemp(path);
    const char *text = text_of(one_board, "hold: 300ms\nfade: 300ms\n");
    assert_int_equal(write(fd, text, strlen(text)), strlen(text));
    struct kit_board *b = kit_fadecandy(the_kit, "ABCDEFGHIJKLMNOP");
    kit_plug(b);
    struct daemon d;
    daemon_start(&d, (const char *const[]){ "--threads", "1", "--wall", path, NULL });
    struct airy *a = daemon_join(&d);
    struct picture p = picture_make(64, 32, 400, 3);
    wait_board(a, 0, "ready");
    show(a, &p);
    wait_dark(b, false);
    airy_close(a);
    wait_dark(b, true);
    a = daemon_join(&d);
    pattern(a, "white", "", 0);
    wait_dark(b, false);
    airy_close(a);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
    assert_true(is_dark(b));
    picture_free(&p);
    close(fd);
    unlink(path);
}

// A display: its picture is the panel, line by line.
static void test_display(void **state)
{
    (void)state;
    struct picture p = picture_make(160, 80, 40, 78);
    struct kit_board *b = kit_gud(the_kit, "DISPLAY1", 32, 16);
    kit_plug(b);
    struct airy *a = daemon_join(&the_daemon);
    open_wall(a, "wall: w\nrate: 50\nhold: forever\ncolour: {transfer: srgb, dither: off}\n"
                 "panels:\n  - {name: p, at: [0, 0], size: [32, 16]}\n"
                 "boards:\n  - {serial: DISPLAY1, kind: gud, size: [32, 16], panels: [p]}\n");
    float *drive = drive_of(a, &p, LEDS);
    wait_board(a, 0, "ready");
    show(a, &p);
    settle(b);
    settle(b);
    pthread_mutex_lock(&b->lock);
    for (unsigned i = 0; i < LEDS * 3; i++) {
        const double light = fmin(1, fmax(0, (double)drive[i]));
        const double code = 255 * (light <= 0.0031308 ? 12.92 * light : 1.055 * pow(light, 1 / 2.4) - 0.055);
        const uint8_t got = b->picture[i / 3 * 3 + 2 - i % 3]; // memory order B G R
        if (fabs(got - code) > 0.51)
            fail_msg("pixel %u, colour %u: %u sent; %.3f expected", i / 3, i % 3, got, code);
    }
    assert_true(b->lit && b->committed);
    pthread_mutex_unlock(&b->lock);
    free(drive);
    picture_free(&p);
    airy_close(a);
}

// What is plugged in and what is wrong with it, for an operator who looks.
static void test_list(void **state)
{
    (void)state;
    struct kit_board *b = kit_fadecandy(the_kit, "ALONE"), *c = kit_fadecandy(the_kit, "ALONE");
    struct kit_board *liar = kit_gud(the_kit, "LIAR", 32, 16);
    memset(liar->reply[1].data, 0xff, 30); // its descriptor
    kit_plug(b);
    kit_plug(c);
    kit_plug(liar);
    struct airy *a = daemon_join(&the_daemon);
    open_wall(a, "wall: w\npanels:\n  - {name: p, at: [0, 0], size: [32, 16]}\n"
                 "boards:\n  - {serial: LIAR, kind: gud, size: [32, 16], panels: [p]}\n");
    wait_board(a, 0, "failed");
    struct airy_wall_reply *r = ask(a, (struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = "w" });
    unsigned twice = 0;
    assert_int_equal(r->n_controllers, 3);
    for (unsigned i = 0; i < 3; i++)
        twice += strstr(r->controllers[i].problem, "same serial") != NULL;
    assert_int_equal(twice, 2);
    assert_true(r->walls[0].boards[0].problem[0]);
    airy_wall_reply_free(r);
    airy_close(a);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(test_bytes, unplug),   cmocka_unit_test_teardown(test_led_by_led, unplug),
        cmocka_unit_test_teardown(test_pulled, unplug),  cmocka_unit_test_teardown(test_faults, unplug),
        cmocka_unit_test_teardown(test_source_lost_and_stop, unplug),
        cmocka_unit_test_teardown(test_display, unplug), cmocka_unit_test_teardown(test_list, unplug),
    };
    return cmocka_run_group_tests(tests, start, stop);
}
