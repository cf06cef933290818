// SPDX-License-Identifier: Apache-2.0
//
// test_panel_gud.c - displays that lie: each answer of the opening wrong in its own way. The board is FAILED with words
// that name the answer, what was found and what was expected; the board beside it goes on; the same display, plugged in
// again with the truth, is used. And LZ4: what the model unpacks is what was sent, whatever the buffer. Under umockdev-wrapper.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "usb_rig.h"

enum { W = 16, H = 8, ANY = -1 };

struct lie {
    const char *name;
    uint8_t request;    // whose answer is changed
    int length;         // of the answer, or ANY: as it was
    size_t at;          // bytes changed
    const char *bytes;
    size_t n;
    const char *words;  // of `why`
};

#define LIE(name, request, length, at, bytes, words) { name, request, length, at, bytes, sizeof(bytes) - 1, words }

static const struct lie lies[] = {
    LIE("short", 0x01, 29, 0, "", "descriptor: 29 bytes, expected 30"),
    LIE("nothing", 0x01, 0, 0, "", "descriptor: 0 bytes, expected 30"),
    LIE("magic", 0x01, ANY, 0, "\x00\x00\x00\x00", "magic 0x00000000, expected 0x1d50614d"),
    LIE("version", 0x01, ANY, 4, "\x02", "protocol version 2, expected 1"),
    LIE("no width", 0x01, ANY, 14, "\0\0\0\0\0\0\0\0", "width: the display says it takes 0 to 0, which is nothing"),
    LIE("turned", 0x01, ANY, 22, "\xff\xff\xff\xff\x00\x00\x00\x01", "height: the display says it takes 4294967295 to 16777216"),
    LIE("small", 0x01, ANY, 18, "\x0f\0\0\0", "which is nothing"),
    LIE("big only", 0x01, ANY, 14, "\x11\0\0\0\xff\0\0\0", "width: the wall wants 16, the display takes 17 to 255"),
    LIE("buffer", 0x01, ANY, 10, "\x2f\0\0\0", "the display's buffer is 47 bytes, one row of RGB888 is 48"),
    LIE("part of all", 0x01, ANY, 5, "\x02\0\0\0\0\x30\0\0\0", "takes only whole frames (384 bytes), and its buffer is 48"),
    LIE("no formats", 0x40, 0, 0, "", "formats: the list is empty, expected at least 1"),
    LIE("wrong formats", 0x40, 3, 0, "\x01\x08\x20", "the display has 3 pixel formats (the first is 0x01), none of them RGB888"),
    LIE("torn properties", 0x41, 11, 0, "", "properties: 11 bytes, expected a multiple of 10"),
    LIE("no connector", 0x50, 0, 0, "", "connectors: the list is empty"),
    LIE("torn connector", 0x50, 7, 0, "", "connectors: 7 bytes, expected a multiple of 5"),
    LIE("torn connector properties", 0x51, 9, 0, "", "connector properties: 9 bytes, expected a multiple of 10"),
    LIE("unconnected", 0x54, ANY, 0, "\x80", "nothing is connected to any of the display's 1 connectors"),
    LIE("no status", 0x54, 0, 0, "", "connector status: 0 bytes, expected 1"),
    LIE("no modes", 0x55, 0, 0, "", "modes: the list is empty"),
    LIE("torn mode", 0x55, 25, 0, "", "modes: 25 bytes, expected a multiple of 24"),
    LIE("other mode", 0x55, ANY, 4, "\x11\x00", "the display has 1 modes (the first is 17 x 8), none is 16 x 8, the wall's"),
    LIE("mad mode", 0x55, ANY, 6, "\x01\x00", "the display's mode of 16 x 8 has sync times out of order"),
};

static void tell(struct kit_board *k, const struct lie *l)
{
    struct kit_reply *r = &k->reply[l->request];
    memcpy(r->data + l->at, l->bytes, l->n);
    if (l->length != ANY)
        r->length = (size_t)l->length;
}

static void expect_refusal(struct usb_board *b, struct kit_board *k, const char *name, const char *words)
{
    rig_wait_state(b, USB_FAILED);
    const struct usb_stats s = rig_stats(b);
    if (!strstr(s.why, words))
        fail_msg("%s: \"%s\", expected \"%s\"", name, s.why, words);
    assert_int_equal(kit_frames(k), 0);
}

static void test_lies(void **state)
{
    (void)state;
    struct kit_board *good = kit_fadecandy(rig_kit, "HONEST"), *k = kit_gud(rig_kit, "LIAR", W, H);
    kit_plug(good);
    struct usb *u = rig_usb();
    struct usb_board *g = rig_add(u, WALL_FADECANDY, "HONEST", 64, 8), *b = rig_add(u, WALL_GUD, "LIAR", W, H);
    rig_wait_state(g, USB_READY);
    const unsigned n = sizeof(lies) / sizeof(*lies);
    for (unsigned i = 0; i < n; i++) {
        kit_gud_defaults(k);
        tell(k, &lies[i]);
        kit_plug(k);
        expect_refusal(b, k, lies[i].name, lies[i].words);
        rig_send(g, 512, i + 1);
        rig_wait_frames(good, i + 1);
        assert_int_equal(kit_open_fds(k), 0);
        kit_unplug(k);
        rig_wait_state(b, USB_ABSENT);
    }
    kit_gud_defaults(k);
    kit_plug(k);
    rig_wait_state(b, USB_READY);
    rig_send(b, W * H, 1);
    rig_wait_frames(k, 1);
    assert_int_equal(rig_stats(g).sent, n);
    usb_destroy(u);
}

static void refuse(const char *name, unsigned stall_get, unsigned stall_set, uint8_t status, bool status_on_set, const char *words)
{
    struct kit_board *k = kit_gud(rig_kit, name, W, H);
    if (stall_get)
        k->reply[stall_get].stall = true;
    k->set_stall = stall_set;
    k->set_status = status;
    k->reply[0x01].data[5] = status_on_set;
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_GUD, name, W, H);
    expect_refusal(b, k, name, words);
    // A refusal is final until it is plugged in again.
    pthread_mutex_lock(&k->lock);
    const uint64_t requests = k->requests;
    pthread_mutex_unlock(&k->lock);
    rig_sleep_ms(1300);
    pthread_mutex_lock(&k->lock);
    assert_int_equal(k->requests, requests);
    pthread_mutex_unlock(&k->lock);
    usb_destroy(u);
    kit_unplug(k);
}

static void test_refusals(void **state)
{
    (void)state;
    refuse("STALLSFORMATS", 0x40, 0, 2, false, "formats: the display refuses: request not supported (2)");
    refuse("STALLSCHECK", 0, 0x61, 4, false, "state check: the display refuses: invalid parameter (4)");
    refuse("STATUS", 0, 0, 3, true, "controller on: the display answers: protocol error (3)");
    refuse("STRANGESTATUS", 0, 0, 200, true, "a status that the protocol does not have (200)");
}

// The most that the protocol allows of each list, and more than one that would do.
static void test_long_lists(void **state)
{
    (void)state;
    struct kit_board *k = kit_gud(rig_kit, "LONG", W, H);
    memset(k->reply[0x40].data, 0x01, 32);
    k->reply[0x40].data[31] = 0x50;
    k->reply[0x40].length = 32;
    k->reply[0x41].length = k->reply[0x51].length = 320;
    k->reply[0x41].data[0] = 50;                       // rotation: can do all
    k->reply[0x41].data[2] = 0x3f;
    for (unsigned i = 0; i < 32; i++)
        k->reply[0x51].data[10 * i] = (uint8_t)(12 + (i > 0)); // backlight, then 31 that nobody knows
    k->reply[0x51].data[2] = 77;
    k->reply[0x50].length = 160;
    for (unsigned i = 0; i < 128; i++)
        kit_gud_mode(k->reply[0x55].data + 24 * i, (uint16_t)(i == 126 ? W : 100 + i), H);
    k->reply[0x55].length = KIT_REPLY_MAX;
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_GUD, "LONG", W, H);
    rig_wait_state(b, USB_READY);
    rig_send(b, W * H, 5);
    rig_wait_frames(k, 1);
    static const uint8_t properties[20] = { 50, 0, 1, 0, 0, 0, 0, 0, 0, 0, 12, 0, 77, 0, 0, 0, 0, 0, 0, 0 };
    assert_int_equal(k->state_bytes, 46);
    assert_memory_equal(k->state + 26, properties, 20);
    assert_int_equal(k->bad, 0);
    usb_destroy(u);
}

// Frames: a stalled rectangle, a stalled picture, a status that complains.
static void test_faults_of_frames(void **state)
{
    (void)state;
    struct kit_board *k = kit_gud(rig_kit, "FAULTY", W, H);
    k->reply[0x01].data[5] = 1;
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_GUD, "FAULTY", W, H);
    rig_wait_state(b, USB_READY);
    KIT_SET(k, stall_next, 1);
    rig_send(b, W * H, 1);
    rig_wait_frames(k, 1);
    rig_wait_idle(b);
    assert_int_equal(rig_stats(b).stalls, 1);
    KIT_SET(k, set_stall, 0x60);
    KIT_SET(k, set_status, 4);
    rig_send(b, W * H, 2);
    rig_sleep_ms(100);
    assert_true(rig_stats(b).stalls > 1);
    assert_true(rig_logged("after a stall: the display says: invalid parameter (4)"));
    KIT_SET(k, set_stall, 0);
    rig_send(b, W * H, 3);
    rig_sleep_ms(100);
    assert_true(rig_stats(b).errors > 0);
    assert_int_equal(kit_frames(k), 1);
    KIT_SET(k, set_status, 0);
    rig_send(b, W * H, 4);
    rig_wait_frames(k, 2);
    rig_wait_idle(b);
    assert_int_equal(rig_last_id(k), 4 << 16); // memory order B, G, R
    const struct usb_stats s = rig_stats(b);
    assert_int_equal(s.sent + s.dropped, 4);
    assert_int_equal(s.state, USB_READY);
    usb_destroy(u);
}

// ---- LZ4 --------------------------------------------------------------------------------------------------------

// Frame n: rows that repeat (they shrink), then, from row `noise` on, rows of random bytes (they do not).
static void draw(uint8_t *rgb, uint32_t width, uint32_t height, uint32_t noise, uint32_t n)
{
    uint32_t seed = n * 2654435761u + 1;
    for (size_t i = 0; i < (size_t)width * height * 3; i++) {
        seed ^= seed << 13;
        seed ^= seed >> 17;
        seed ^= seed << 5;
        rgb[i] = i / 3 / width < noise ? (uint8_t)(n + i % 3) : (uint8_t)(seed >> 11);
    }
}

// The model unpacks what comes; here its picture is held against what was sent. Memory order is B, G, R.
static void expect_picture(struct kit_board *k, const uint8_t *rgb)
{
    pthread_mutex_lock(&k->lock);
    for (size_t i = 0; i < (size_t)k->width * k->height * 3; i++)
        if (k->picture[i / 3 * 3 + 2 - i % 3] != rgb[i])
            fail_msg("%s: pixel %zu, colour %zu is %u, expected %u", k->serial, i / 3, i % 3, k->picture[i / 3 * 3 + 2 - i % 3],
                     rgb[i]);
    pthread_mutex_unlock(&k->lock);
}

struct packed { uint64_t buffers, compressed, bytes; };

// One frame, and what it cost on the wire.
static struct packed send_drawn(struct usb_board *b, struct kit_board *k, uint32_t noise, uint32_t n)
{
    static uint8_t rgb[64 * 32 * 3];
    const struct packed before = { k->buffers, k->compressed, k->bulk_bytes };
    draw(rgb, k->width, k->height, noise, n);
    const uint64_t have = kit_frames(k);
    usb_board_send(b, rgb, 0);
    rig_wait_frames(k, have + 1);
    rig_wait_idle(b);
    expect_picture(k, rgb);
    assert_int_equal(k->bad, 0);
    return (struct packed){ k->buffers - before.buffers, k->compressed - before.compressed, k->bulk_bytes - before.bytes };
}

static struct kit_board *lz4_display(const char *name, uint32_t width, uint32_t height, uint8_t compression, uint32_t max_buffer)
{
    struct kit_board *k = kit_gud(rig_kit, name, width, height);
    k->reply[0x01].data[9] = compression;
    for (unsigned i = 0; i < 4; i++)
        k->reply[0x01].data[10 + i] = (uint8_t)(max_buffer >> (8 * i));
    return k;
}

enum { LW = 64, LH = 32, PITCH = LW * 3, FRAME = PITCH * LH };

static void test_lz4(void **state)
{
    (void)state;
    struct kit_board *k = lz4_display("PACKED", LW, LH, 1, 8 * PITCH); // four bands
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_GUD, k->serial, LW, LH);
    rig_wait_state(b, USB_READY);
    struct packed p = send_drawn(b, k, LH, 1); // all flat
    assert_int_equal(p.buffers, 4);
    assert_int_equal(p.compressed, 4);
    assert_true(p.bytes < FRAME / 20);
    p = send_drawn(b, k, 0, 2); // all noise: as it is, no byte more
    assert_int_equal(p.buffers, 4);
    assert_int_equal(p.compressed, 0);
    assert_int_equal(p.bytes, FRAME);
    p = send_drawn(b, k, 16, 3); // half and half, each band for itself
    assert_int_equal(p.compressed, 2);
    assert_true(p.bytes > FRAME / 2 && p.bytes < FRAME / 2 + FRAME / 20);
    KIT_SET(k, stall_next, 1); // the frame that stalled comes again, whole
    p = send_drawn(b, k, LH, 4);
    assert_int_equal(p.compressed, 4);
    assert_true(rig_stats(b).stalls == 1);
    usb_destroy(u);
}

// A display that says nothing of LZ4, or only of things that nobody knows, gets none.
static void test_lz4_only_when_offered(void **state)
{
    (void)state;
    static const uint8_t offers[] = { 0x00, 0xfe };
    for (unsigned i = 0; i < 2; i++) {
        struct kit_board *k = lz4_display(i ? "STRANGE" : "PLAIN", LW, LH, offers[i], 0);
        kit_plug(k);
        struct usb *u = rig_usb();
        struct usb_board *b = rig_add(u, WALL_GUD, k->serial, LW, LH);
        rig_wait_state(b, USB_READY);
        const struct packed p = send_drawn(b, k, LH, 1);
        assert_int_equal(p.compressed, 0);
        assert_int_equal(p.bytes, FRAME);
        usb_destroy(u);
    }
}

// Every size of buffer that is no size of a picture, with all bits of compression set.
static void test_lz4_hostile_buffers(void **state)
{
    (void)state;
    static const struct { uint32_t max_buffer, bands; } hostile[] = {
        { 0, 1 }, { PITCH, LH }, { PITCH + 1, LH }, { 2 * PITCH - 1, LH }, { 5 * PITCH + 7, 7 }, { FRAME - 1, 2 }, { FRAME, 1 },
        { FRAME + 1, 1 }, { 0x7fffffff, 1 }, { 0x80000000, 1 }, { 0xffffffff, 1 },
    };
    for (unsigned i = 0; i < sizeof(hostile) / sizeof(*hostile); i++) {
        char name[32];
        snprintf(name, sizeof(name), "BUFFER%u", hostile[i].max_buffer);
        struct kit_board *k = lz4_display(name, LW, LH, 0xff, hostile[i].max_buffer);
        kit_plug(k);
        struct usb *u = rig_usb();
        struct usb_board *b = rig_add(u, WALL_GUD, name, LW, LH);
        rig_wait_state(b, USB_READY);
        for (uint32_t noise = 0; noise <= LH; noise += LH / 4)
            assert_int_equal(send_drawn(b, k, noise, 10 + noise).buffers, hostile[i].bands);
        usb_destroy(u);
        kit_unplug(k);
    }
    struct kit_board *k = lz4_display("BUFFERSHORT", LW, LH, 0xff, PITCH - 1);
    kit_plug(k);
    struct usb *u = rig_usb();
    expect_refusal(rig_add(u, WALL_GUD, k->serial, LW, LH), k, k->serial, "the display's buffer is 191 bytes, one row of RGB888 is 192");
    usb_destroy(u);
}

// The smallest pictures: nothing can be shorter than they are, and nothing goes wrong.
static void test_lz4_smallest(void **state)
{
    (void)state;
    struct kit_board *k = lz4_display("ONEPIXEL", 1, 1, 1, 0);
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_GUD, k->serial, 1, 1);
    rig_wait_state(b, USB_READY);
    const struct packed p = send_drawn(b, k, 1, 1);
    assert_int_equal(p.compressed, 0);
    assert_int_equal(p.bytes, 3);
    usb_destroy(u);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(test_lies, rig_teardown),
        cmocka_unit_test_teardown(test_refusals, rig_teardown),
        cmocka_unit_test_teardown(test_long_lists, rig_teardown),
        cmocka_unit_test_teardown(test_faults_of_frames, rig_teardown),
        cmocka_unit_test_teardown(test_lz4, rig_teardown),
        cmocka_unit_test_teardown(test_lz4_only_when_offered, rig_teardown),
        cmocka_unit_test_teardown(test_lz4_hostile_buffers, rig_teardown),
        cmocka_unit_test_teardown(test_lz4_smallest, rig_teardown),
    };
    return cmocka_run_group_tests(tests, rig_group_setup, rig_group_teardown);
}
