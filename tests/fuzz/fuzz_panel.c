// SPDX-License-Identifier: Apache-2.0
//
// fuzz_panel.c - panel_gud.c and panel_fadecandy.c: descriptors and replies that say anything.
//
// The parser is the target, so what lies under it is replaced: libusb's two blocking transfers answer from the input. The
// descriptors are what libusb makes of hostile ones: its arrays are as long as they say. What is checked: what is refused
// has a reason; what opened encodes a frame within what it asked for, and its steps send each row of it once. Input: one
// byte of ways, the wall's size, the descriptors, then a reply a transfer.
#include <libusb.h>
#include <stdbool.h>

#include "fuzz.h"
#include "panel.h"

int __wrap_libusb_control_transfer(libusb_device_handle *h, uint8_t type, uint8_t request, uint16_t value, uint16_t index,
                                   unsigned char *data, uint16_t length, unsigned timeout_ms);
int __wrap_libusb_bulk_transfer(libusb_device_handle *h, unsigned char endpoint, unsigned char *data, int length, int *done,
                                unsigned timeout_ms);

enum { SIDE_MAX = 128, INTERFACES_MAX = 4, ENDPOINTS_MAX = 4, ERROR_FIRST = 0xf0, TIMEOUT_MAX_MS = 1000 };

static struct fuzz_in replies;

// The first byte of a reply: ERROR_FIRST and above are errors of libusb; all else comes with a length of 16 bits.
static int next_error(uint8_t first) { return first >= ERROR_FIRST ? -1 - (first - ERROR_FIRST) % 12 : 0; }

int __wrap_libusb_control_transfer(libusb_device_handle *h, uint8_t type, uint8_t request, uint16_t value, uint16_t index,
                                   unsigned char *data, uint16_t length, unsigned timeout_ms)
{
    (void)h, (void)request, (void)value, (void)index;
    must(timeout_ms >= 1 && timeout_ms <= TIMEOUT_MAX_MS);
    const int error = next_error(fuzz_u8(&replies));
    if (error)
        return error;
    if (!(type & LIBUSB_ENDPOINT_IN))
        return length;
    size_t want = fuzz_u16(&replies), got;
    const uint8_t *bytes = fuzz_piece(&replies, want < length ? want : length, &got);
    if (got)
        memcpy(data, bytes, got);
    return (int)got;
}

int __wrap_libusb_bulk_transfer(libusb_device_handle *h, unsigned char endpoint, unsigned char *data, int length, int *done,
                                unsigned timeout_ms)
{
    (void)h, (void)data;
    must(!(endpoint & LIBUSB_ENDPOINT_IN) && length > 0 && timeout_ms >= 1 && timeout_ms <= TIMEOUT_MAX_MS);
    const uint8_t first = fuzz_u8(&replies);
    *done = first & 1 ? length - 1 : length;
    return next_error(first);
}

// ---- descriptors ---------------------------------------------------------------------------------------

struct made {
    struct libusb_config_descriptor config;
    struct libusb_interface interface[INTERFACES_MAX];
    struct libusb_interface_descriptor setting[INTERFACES_MAX];
    struct libusb_endpoint_descriptor *endpoint[INTERFACES_MAX];
};

// Exact arrays: whoever looks past their ends is seen.
static void make_descriptors(struct made *m, struct fuzz_in *in)
{
    m->config.bNumInterfaces = fuzz_u8(in) % (INTERFACES_MAX + 1);
    m->config.interface = m->interface;
    for (unsigned i = 0; i < m->config.bNumInterfaces; i++) {
        struct libusb_interface_descriptor *d = &m->setting[i];
        const uint8_t shape = fuzz_u8(in);
        d->bInterfaceNumber = fuzz_u8(in);
        d->bInterfaceClass = shape & 1 ? LIBUSB_CLASS_VENDOR_SPEC : fuzz_u8(in);
        d->bNumEndpoints = (shape >> 2) % (ENDPOINTS_MAX + 1);
        m->interface[i] = (struct libusb_interface){ shape & 2 ? NULL : d, shape & 2 ? 0 : 1 };
        d->endpoint = m->endpoint[i] = malloc(d->bNumEndpoints * sizeof(*d->endpoint) + !d->bNumEndpoints);
        must(d->endpoint);
        for (unsigned k = 0; k < d->bNumEndpoints; k++)
            m->endpoint[i][k] = (struct libusb_endpoint_descriptor){
                .bEndpointAddress = fuzz_u8(in), .bmAttributes = fuzz_u8(in), .wMaxPacketSize = fuzz_u16(in)
            };
    }
}

static void free_descriptors(struct made *m)
{
    for (unsigned i = 0; i < INTERFACES_MAX; i++)
        free(m->endpoint[i]);
}

static bool has_endpoint(const struct made *m, uint8_t interface, uint8_t endpoint)
{
    for (unsigned i = 0; i < m->config.bNumInterfaces; i++)
        for (unsigned k = 0; k < m->setting[i].bNumEndpoints && m->interface[i].num_altsetting; k++)
            if (m->setting[i].bInterfaceNumber == interface && m->endpoint[i][k].bEndpointAddress == endpoint)
                return true;
    return false;
}

// ---- frames --------------------------------------------------------------------------------------------

static void check_fault(const struct fault *f) { must(f->code != FAULT_NONE && *f->text); }

static void check_frame(const struct panel_ops *ops, void *state, const struct panel_config *c, const struct panel_need *need,
                        bool full)
{
    const size_t rgb_bytes = (size_t)3 * c->width * c->height;
    uint8_t *rgb = malloc(rgb_bytes);
    struct panel_frame f = { .data = malloc(need->bytes), .room = need->bytes, .step = calloc(need->steps, sizeof(*f.step)),
                             .steps_room = need->steps };
    struct fault fault = { .code = FAULT_NONE };
    size_t sent = 0, end = 0, pixels = 0;
    must(rgb && f.data && f.step);
    memset(rgb, 0x5a, rgb_bytes);
    ops->encode(state, rgb, full, &f);
    must(f.steps >= 1 && f.steps <= need->steps && f.size <= need->bytes);
    for (unsigned i = 0; i < f.steps; i++) {
        const struct panel_step *s = &f.step[i];
        const bool in = s->control && s->request_type & LIBUSB_ENDPOINT_IN;
        must(s->control ? s->length <= PANEL_CONTROL_MAX : s->length > 0);
        must(in || (s->offset <= f.size && s->length <= f.size - s->offset));
        if (in) {
            size_t got;
            const uint8_t *bytes = fuzz_piece(&replies, fuzz_u8(&replies) % (s->length + 2), &got);
            if (ops->reply(state, s, bytes, got, &fault) < 0)
                check_fault(&fault);
        }
        if (s->control && !in && s->request == 0x60) // SET_BUFFER says how many bytes of pixels follow, packed or not
            pixels += f.data[s->offset + 16] | (size_t)f.data[s->offset + 17] << 8 | (size_t)f.data[s->offset + 18] << 16;
        if (s->control)
            continue;
        must(!sent || s->offset >= end); // the bands of a picture do not overlap
        sent += s->length;
        end = s->offset + s->length;
    }
    must((pixels ? pixels : sent) >= (size_t)2 * c->width * c->height);
    free(f.step);
    free(f.data);
    free(rgb);
}

static void check_rest(const struct panel_ops *ops, void *state)
{
    struct panel_step step[4];
    struct fault f = { .code = FAULT_NONE };
    uint64_t rendered = 0, received = 0;
    if (ops->mend && ops->mend(state, &f) < 0)
        check_fault(&f);
    const unsigned n = ops->query ? ops->query(state, step, 4) : 0;
    must(n <= 4);
    for (unsigned i = 0; i < n + (n > 0); i++) { // one answer more than was asked for
        size_t got;
        must(i == n || (step[i].control && step[i].length <= PANEL_CONTROL_MAX));
        const uint8_t *bytes = fuzz_piece(&replies, fuzz_u8(&replies) % 8, &got);
        uint8_t *exact = malloc(got + !got);
        must(exact);
        if (got)
            memcpy(exact, bytes, got);
        ops->answer(state, i, exact, got, &rendered, &received);
        free(exact);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static uint8_t handle; // only its address is used
    struct fuzz_in in = { data, size };
    struct made m = { 0 };
    struct fault f = { .code = FAULT_NONE };
    struct panel_need need = { 0 };
    struct panel_config c = { .serial = "FUZZ", .rate = 60 };
    uint8_t interface = 0, endpoint = 1;
    void *state = NULL;
    const uint8_t way = fuzz_u8(&in);
    const struct panel_ops *ops = panel_kinds[way & 1];
    c.kind = ops->kind;
    c.width = fuzz_u8(&in) % (SIDE_MAX + 1);
    c.height = fuzz_u8(&in) % (SIDE_MAX + 1);
    make_descriptors(&m, &in);
    if (ops->probe(&m.config, &interface, &endpoint, &f) < 0)
        check_fault(&f);
    else
        must(has_endpoint(&m, interface, endpoint) && !(endpoint & LIBUSB_ENDPOINT_IN));
    endpoint &= (uint8_t)~LIBUSB_ENDPOINT_IN;
    replies = in;
    if (ops->open(&state, (libusb_device_handle *)(void *)&handle, interface, endpoint, &c, &need, &f) < 0) {
        check_fault(&f);
        must(!state);
    } else {
        for (unsigned i = 0; i < 3; i++)
            check_frame(ops, state, &c, &need, i != 1);
        check_rest(ops, state);
        ops->close(state);
    }
    free_descriptors(&m);
    return 0;
}
