// SPDX-License-Identifier: Apache-2.0
//
// test_panel.c - what the Fadecandy and the GUD drivers put on the wire, against bytes that were written out by hand from the
// byte tables (LED section 1), and which descriptors they take for theirs. The device at the other end is emulated,
// so this runs under umockdev-wrapper, too; lies of a display are in test_panel_gud.c.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <libusb.h>

#include "usb_rig.h"

struct golden {
    size_t at;
    const char *bytes;
    size_t length;
};

#define GOLDEN(at, bytes) { at, bytes, sizeof(bytes) - 1 }

static void assert_golden(const uint8_t *data, const struct golden *g, size_t n)
{
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < g[i].length; k++)
            if (data[g[i].at + k] != (uint8_t)g[i].bytes[k])
                fail_msg("byte %zu is %02x, expected %02x", g[i].at + k, data[g[i].at + k], (uint8_t)g[i].bytes[k]);
}

static void assert_zero(const uint8_t *data, size_t from, size_t to)
{
    for (size_t i = from; i < to; i++)
        if (data[i])
            fail_msg("byte %zu is %02x, expected 0", i, data[i]);
}

// LED p is sent as p & 255, p >> 8, a5.
static void test_fadecandy_bytes(void **state)
{
    (void)state;
    struct kit_board *k = kit_fadecandy(rig_kit, "BYTES");
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_FADECANDY, "BYTES", 64, 8);
    rig_wait_state(b, USB_READY);
    uint8_t rgb[3 * 512];
    for (unsigned p = 0; p < 512; p++) {
        rgb[3 * p] = (uint8_t)p;
        rgb[3 * p + 1] = (uint8_t)(p >> 8);
        rgb[3 * p + 2] = 0xa5;
    }
    usb_board_send(b, rgb, 0);
    rig_wait_frames(k, 1);
    static const struct golden frame[] = {
        GOLDEN(0, "\x00\x00\x00\xa5\x01\x00\xa5\x02\x00\xa5"), // packet 0: LEDs 0, 1, 2
        GOLDEN(61, "\x14\x00\xa5"),                            // LED 20
        GOLDEN(64, "\x01\x15\x00\xa5\x16\x00\xa5"),            // packet 1: LED 21, 22
        GOLDEN(768, "\x0c\xfc\x00\xa5"),                       // packet 12: LED 252
        GOLDEN(778, "\xff\x00\xa5\x00\x01\xa5"),               // LEDs 255, 256
        GOLDEN(1472, "\x17\xe3\x01\xa5"),                      // packet 23: LED 483
        GOLDEN(1533, "\xf7\x01\xa5"),                          // LED 503
        GOLDEN(1536, "\x38\xf8\x01\xa5\xf9\x01\xa5\xfa\x01\xa5\xfb\x01\xa5\xfc\x01\xa5\xfd\x01\xa5\xfe\x01\xa5\xff\x01\xa5"),
    };
    assert_golden(k->frame, frame, sizeof(frame) / sizeof(*frame));
    assert_zero(k->frame, 1561, 1600);
    // rig_config: entry e of channel ch is ch * 0x4000 + e * 16.
    static const struct golden lut[] = {
        GOLDEN(0, "\x40\x00\x00\x00\x10\x00\x20\x00"),     // packet 0: entries 0, 1, 2
        GOLDEN(62, "\xe0\x01"),                            // entry 30
        GOLDEN(64, "\x41\x00\xf0\x01"),                    // packet 1: entry 31
        GOLDEN(512, "\x48\x00\x80\x0f"),                   // packet 8: entry 248
        GOLDEN(530, "\x00\x10\x00\x40\x10\x40"),           // entry 256; green's 0 and 1
        GOLDEN(1536, "\x78\x00\x60\x8e"),                  // packet 24: blue's 230
        GOLDEN(1588, "\xf0\x8f\x00\x90"),                  // blue's 255, 256
    };
    assert_golden(k->lut, lut, sizeof(lut) / sizeof(*lut));
    assert_zero(k->lut, 1592, 1600);
    assert_int_equal(k->config[0], 0x80);
    assert_int_equal(k->config[1], 0x02);
    assert_zero(k->config, 2, 64);
    usb_destroy(u);
}

// 4 x 2 pixels: red, green, blue, white; then black and three greys.
static const uint8_t eight[24] = { 255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255, 0, 0, 0, 1, 1, 1, 128, 128, 128, 254, 254, 254 };

static void send_eight(struct kit_board *k, unsigned times)
{
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_GUD, k->serial, 4, 2);
    rig_wait_state(b, USB_READY);
    for (unsigned i = 0; i < times; i++) {
        usb_board_send(b, eight, 0);
        rig_wait_idle(b);
    }
    assert_int_equal(rig_stats(b).sent, times);
    assert_int_equal(k->bad, 0);
    usb_destroy(u);
}

static void test_gud_bytes(void **state)
{
    (void)state;
    struct kit_board *k = kit_gud(rig_kit, "GUDBYTES", 4, 2);
    send_eight(k, 1);
    static const struct golden picture[] = {
        GOLDEN(0, "\x00\x00\xff\x00\xff\x00\xff\x00\x00\xff\xff\xff\x00\x00\x00\x01\x01\x01\x80\x80\x80\xfe\xfe\xfe") };
    assert_golden(k->picture, picture, 1);
    static const struct golden buffer[] = {
        GOLDEN(0, "\x00\x00\x00\x00\x00\x00\x00\x00\x04\x00\x00\x00\x02\x00\x00\x00\x18\x00\x00\x00\x00\x00\x00\x00\x00") };
    assert_golden(k->buffer, buffer, 1);
    static const uint8_t order[] = { 0x01, 0x40, 0x41, 0x50, 0x51, 0x54, 0x55, 0x63, 0x61, 0x62, 0x64, 0x60, 0xff };
    assert_int_equal(k->requests, sizeof(order));
    assert_memory_equal(k->request, order, sizeof(order));
    static const struct golden check[] = { // clock 10000; 4 12 20 28; 2 4 6 8; preferred; RGB888; connector 0
        GOLDEN(0, "\x10\x27\x00\x00\x04\x00\x0c\x00\x14\x00\x1c\x00\x02\x00\x04\x00\x06\x00\x08\x00\x00\x04\x00\x00\x50\x00") };
    assert_int_equal(k->state_bytes, 26);
    assert_golden(k->state, check, 1);
    assert_int_equal(k->statuses, 0);
}

static void test_gud_formats(void **state)
{
    (void)state;
    struct kit_board *x = kit_gud(rig_kit, "XRGB", 4, 2), *r = kit_gud(rig_kit, "RGB565", 4, 2), *all = kit_gud(rig_kit, "ALL", 4, 2);
    memcpy(x->reply[0x40].data, "\x40\x80\x01", 3);
    x->reply[0x40].length = 3;
    memset(x->reply[0x01].data + 10, 0, 4); // no limit
    r->reply[0x40].data[0] = 0x40;
    memcpy(all->reply[0x40].data, "\x01\x40\x80\x50", 4);
    all->reply[0x40].length = 4;
    send_eight(x, 1);
    send_eight(r, 1);
    send_eight(all, 1);
    static const struct golden xrgb[] = { GOLDEN(0, "\x00\x00\xff\x00\x00\xff\x00\x00\xff\x00\x00\x00\xff\xff\xff\x00"
                                                    "\x00\x00\x00\x00\x01\x01\x01\x00\x80\x80\x80\x00\xfe\xfe\xfe\x00") };
    assert_golden(x->picture, xrgb, 1);
    static const struct golden rgb565[] = {
        GOLDEN(0, "\x00\xf8\xe0\x07\x1f\x00\xff\xff\x00\x00\x00\x00\x10\x84\xff\xff") };
    assert_golden(r->picture, rgb565, 1);
    assert_int_equal(all->state[24], 0x50);
}

// A buffer of one row and a bit: a band a row, each with its own name; and a status after each name.
static void test_gud_bands_and_status(void **state)
{
    (void)state;
    struct kit_board *k = kit_gud(rig_kit, "BANDS", 4, 2);
    k->reply[0x01].data[10] = 15;
    k->reply[0x01].data[5] = 1;
    send_eight(k, 2);
    assert_int_equal(k->frames, 2);
    assert_int_equal(k->buffers, 4);
    assert_int_equal(k->statuses, 4 + 4);
    static const struct golden second[] = {
        GOLDEN(0, "\x00\x00\x00\x00\x01\x00\x00\x00\x04\x00\x00\x00\x01\x00\x00\x00\x0c\x00\x00\x00\x00\x00\x00\x00\x00") };
    assert_golden(k->buffer, second, 1);
    assert_memory_equal(k->picture, "\x00\x00\xff\x00\xff\x00\xff\x00\x00\xff\xff\xff\x00\x00\x00\x01\x01\x01", 18);
}

// FULL_UPDATE: no rectangle, but after a frame that failed.
static void test_gud_full_update(void **state)
{
    (void)state;
    struct kit_board *k = kit_gud(rig_kit, "FULLUPDATE", 4, 2);
    k->reply[0x01].data[5] = 2;
    k->reply[0x01].data[9] = 1; // LZ4, which must not be used with it
    kit_plug(k);
    struct usb *u = rig_usb();
    struct usb_board *b = rig_add(u, WALL_GUD, k->serial, 4, 2);
    rig_wait_state(b, USB_READY);
    for (unsigned i = 1; i <= 4; i++) {
        if (i == 3)
            KIT_SET(k, stall_next, 1);
        usb_board_send(b, eight, 0);
        rig_wait_frames(k, i);
        rig_wait_idle(b);
        assert_int_equal(k->buffers, i < 3 ? 0 : 1);
    }
    assert_int_equal(k->statuses, 1); // asked why it stalled
    assert_int_equal(k->bad, 0);
    usb_destroy(u);
}

// ---- probe ----------------------------------------------------------------------------------------------------

static int probe(const struct panel_ops *ops, uint8_t class, uint8_t attributes, uint8_t address, uint16_t packet,
                 unsigned interfaces, unsigned endpoints, uint8_t *endpoint, struct fault *f)
{
    const struct libusb_endpoint_descriptor e = { .bEndpointAddress = address, .bmAttributes = attributes,
                                                  .wMaxPacketSize = packet };
    const struct libusb_interface_descriptor d = { .bInterfaceClass = class, .bNumEndpoints = (uint8_t)endpoints,
                                                   .endpoint = &e };
    const struct libusb_interface i = { .altsetting = &d, .num_altsetting = 1 };
    const struct libusb_config_descriptor c = { .bNumInterfaces = (uint8_t)interfaces, .interface = &i };
    uint8_t interface = 77;
    *endpoint = 0;
    const int r = ops->probe(&c, &interface, endpoint, f);
    assert_int_equal(interface, r ? 77 : 0);
    return r;
}

static void test_probe(void **state)
{
    (void)state;
    uint8_t e;
    struct fault f = { 0 };
    assert_int_equal(probe(&panel_fadecandy, 255, 2, 1, 64, 1, 1, &e, &f), 0);
    assert_int_equal(e, 1);
    assert_int_equal(probe(&panel_fadecandy, 255, 2, 1, 63, 1, 1, &e, &f), -1);
    assert_string_equal(f.text, "packets of 63 bytes, expected 64");
    assert_int_equal(probe(&panel_fadecandy, 254, 2, 1, 64, 1, 1, &e, &f), -1);
    assert_string_equal(f.text, "class of the first interface is 254, expected 255 (vendor)");
    assert_int_equal(probe(&panel_fadecandy, 255, 2, 0x81, 64, 1, 1, &e, &f), -1);
    assert_int_equal(probe(&panel_fadecandy, 255, 3, 1, 64, 1, 1, &e, &f), -1);
    assert_int_equal(probe(&panel_fadecandy, 255, 2, 1, 64, 1, 0, &e, &f), -1);
    assert_int_equal(probe(&panel_fadecandy, 255, 2, 1, 64, 0, 1, &e, &f), -1);
    assert_int_equal(probe(&panel_gud, 255, 2, 3, 512, 1, 1, &e, &f), 0);
    assert_int_equal(e, 3);
    assert_int_equal(probe(&panel_gud, 255, 2, 0x83, 512, 1, 1, &e, &f), -1);
    assert_int_equal(probe(&panel_gud, 8, 2, 3, 512, 1, 1, &e, &f), -1);
    assert_int_equal(probe(&panel_gud, 255, 2, 3, 512, 0, 1, &e, &f), -1);
    assert_string_equal(f.text, "no interface of class 255 (vendor) with a bulk OUT endpoint");
}

static void test_kinds(void **state)
{
    (void)state;
    for (unsigned k = 0; k < WALL_BOARD_KINDS; k++) {
        assert_int_equal(panel_kinds[k]->kind, k);
        assert_in_range(panel_kinds[k]->in_flight, 1, 2);
        assert_int_equal(panel_kinds[k]->id[3].vendor, 0); // the list ends
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(test_fadecandy_bytes, rig_teardown),
        cmocka_unit_test_teardown(test_gud_bytes, rig_teardown),
        cmocka_unit_test_teardown(test_gud_formats, rig_teardown),
        cmocka_unit_test_teardown(test_gud_bands_and_status, rig_teardown),
        cmocka_unit_test_teardown(test_gud_full_update, rig_teardown),
        cmocka_unit_test(test_probe),
        cmocka_unit_test(test_kinds),
    };
    return cmocka_run_group_tests(tests, rig_group_setup, rig_group_teardown);
}
