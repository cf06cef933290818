// SPDX-License-Identifier: Apache-2.0
//
// panel_fadecandy.c - the Fadecandy: 512 LEDs, 64-byte packets on a bulk endpoint (LED section 1 has the table).
//
// Invariant: a frame is always all 25 packets in one transfer, for the board shows only what ends in FINAL. The colour
// table and the configuration go out once, at open: sent again and again they are reported to garble colours. The
// pixels are perceptual bytes; the table linearises them, and the board dithers the 16 bits that come out.
// Interpolation is off: it costs a frame of latency, and the wall sends at a steady rate anyway.
#include "panel.h"

#include <libusb.h>
#include <stdlib.h>
#include <string.h>

enum {
    PACKET = 64,
    PACKETS = 25,
    LEDS = 512,
    PIXELS_A_PACKET = 21,
    LUT_ENTRIES = 3 * 257,
    LUT_A_PACKET = 31,
    TYPE_LUT = 0x40,
    TYPE_CONFIG = 0x80,
    FINAL = 0x20,
    NO_INTERPOLATION = 0x02,
    REQUEST_COUNTER = 1,
    OPEN_MS = 1000,
};
_Static_assert((PACKETS - 1) * PIXELS_A_PACKET < LEDS && LEDS <= PACKETS * PIXELS_A_PACKET, "25 packets hold 512 pixels");
_Static_assert((PACKETS - 1) * LUT_A_PACKET < LUT_ENTRIES && LUT_ENTRIES <= PACKETS * LUT_A_PACKET, "and the table");

struct fadecandy {
    uint32_t leds;
};

static void number_packets(uint8_t *data, uint8_t type)
{
    for (unsigned i = 0; i < PACKETS; i++)
        data[i * PACKET] = (uint8_t)(type | (i == PACKETS - 1 ? FINAL : 0) | i);
}

static int probe(const struct libusb_config_descriptor *c, uint8_t *interface, uint8_t *endpoint, struct fault *f)
{
    if (c->bNumInterfaces < 1 || c->interface[0].num_altsetting < 1)
        return fault_set(f, FAULT_WALL, "interface", "no interface, expected a vendor's (class 255)");
    const struct libusb_interface_descriptor *d = &c->interface[0].altsetting[0];
    if (d->bInterfaceClass != LIBUSB_CLASS_VENDOR_SPEC)
        return fault_set(f, FAULT_WALL, "interface", "class of the first interface is %u, expected 255 (vendor)",
                         d->bInterfaceClass);
    for (unsigned i = 0; i < d->bNumEndpoints; i++) {
        const struct libusb_endpoint_descriptor *e = &d->endpoint[i];
        if ((e->bmAttributes & 3) != LIBUSB_TRANSFER_TYPE_BULK || (e->bEndpointAddress & LIBUSB_ENDPOINT_IN))
            continue;
        if (e->wMaxPacketSize != PACKET)
            return fault_set(f, FAULT_WALL, "endpoint", "packets of %u bytes, expected %d", e->wMaxPacketSize, PACKET);
        *interface = d->bInterfaceNumber;
        *endpoint = e->bEndpointAddress;
        return 0;
    }
    return fault_set(f, FAULT_WALL, "endpoint", "the first interface has no bulk OUT endpoint");
}

static int send_now(struct libusb_device_handle *h, uint8_t endpoint, uint8_t *data, int length, const char *what,
                    struct fault *f)
{
    int done = 0;
    const int r = libusb_bulk_transfer(h, endpoint, data, length, &done, OPEN_MS);
    if (r < 0)
        return fault_set(f, FAULT_INTERNAL, what, "sending the %s: %s", what, libusb_strerror(r));
    if (done != length)
        return fault_set(f, FAULT_INTERNAL, what, "sending the %s: the board took %d of %d bytes", what, done, length);
    return 0;
}

static int send_config(struct libusb_device_handle *h, uint8_t endpoint, struct fault *f)
{
    uint8_t packet[PACKET] = { TYPE_CONFIG, NO_INTERPOLATION };
    return send_now(h, endpoint, packet, sizeof(packet), "configuration", f);
}

static int send_lut(struct libusb_device_handle *h, uint8_t endpoint, const uint16_t *lut, struct fault *f)
{
    uint8_t data[PACKETS * PACKET] = { 0 };
    number_packets(data, TYPE_LUT);
    for (unsigned i = 0; i < LUT_ENTRIES; i++) {
        uint8_t *p = data + i / LUT_A_PACKET * PACKET + 2 + i % LUT_A_PACKET * 2;
        p[0] = (uint8_t)lut[i];
        p[1] = (uint8_t)(lut[i] >> 8);
    }
    return send_now(h, endpoint, data, sizeof(data), "colour table", f);
}

static int open_board(void **state, struct libusb_device_handle *h, uint8_t interface, uint8_t endpoint,
                      const struct panel_config *c, struct panel_need *need, struct fault *f)
{
    (void)interface;
    const uint64_t leds = (uint64_t)c->width * c->height;
    if (leds < 1 || leds > LEDS)
        return fault_set(f, FAULT_WALL, "size", "%u x %u LEDs, a Fadecandy has %d", c->width, c->height, LEDS);
    if (send_config(h, endpoint, f) || send_lut(h, endpoint, c->lut, f))
        return -1;
    struct fadecandy *s = calloc(1, sizeof(*s));
    if (!s)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for a board");
    s->leds = (uint32_t)leds;
    *state = s;
    *need = (struct panel_need){ .bytes = PACKETS * PACKET, .steps = 1 };
    return 0;
}

static void close_board(void *state) { free(state); }

static void encode(void *state, const uint8_t *rgb, bool full, struct panel_frame *f)
{
    const struct fadecandy *s = state;
    (void)full;
    memset(f->data, 0, PACKETS * PACKET);
    number_packets(f->data, 0);
    for (uint32_t first = 0, packet = 0; first < s->leds; first += PIXELS_A_PACKET, packet++) {
        const uint32_t left = s->leds - first, n = left < PIXELS_A_PACKET ? left : PIXELS_A_PACKET;
        memcpy(f->data + packet * PACKET + 1, rgb + 3 * (size_t)first, 3 * (size_t)n);
    }
    f->size = PACKETS * PACKET;
    f->step[0] = (struct panel_step){ .offset = 0, .length = f->size };
    f->steps = 1;
}

enum { COUNTERS = 2 }; /* rendered, received */

static unsigned query(void *state, struct panel_step *step, unsigned max)
{
    (void)state;
    unsigned n = 0;
    for (; n < COUNTERS && n < max; n++)
        step[n] = (struct panel_step){ .control = true, .request_type = 0xC0, .request = REQUEST_COUNTER,
                                       .index = (uint16_t)n, .length = 4 };
    return n;
}

static void answer(void *state, unsigned i, const uint8_t *d, size_t length, uint64_t *rendered, uint64_t *received)
{
    (void)state;
    if (length != 4 || i >= COUNTERS)
        return;
    const uint32_t v = d[0] | (uint32_t)d[1] << 8 | (uint32_t)d[2] << 16 | (uint32_t)d[3] << 24;
    *(i == 0 ? rendered : received) = v;
}

const struct panel_ops panel_fadecandy = {
    .name = "fadecandy",
    .kind = WALL_FADECANDY,
    .id = { { 0x1d50, 0x607a } },
    .in_flight = 2,
    .probe = probe,
    .open = open_board,
    .close = close_board,
    .encode = encode,
    .query = query,
    .answer = answer,
};
