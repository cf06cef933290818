// SPDX-License-Identifier: Apache-2.0
//
// panel_gud.c - GUD, the Generic USB Display protocol: a display of any size that takes rectangles (LED section 1 has
// the table; the kernel's own driver is the reference for what it leaves open).
//
// Invariant: nothing that the device says is used before it is checked against its own other answers and against the
// wall; what does not fit is refused at open, in words, so that encode has nothing left to fail on. Frames are whole
// every time, in bands of rows that the device's buffer holds uncompressed; LZ4 then only shortens what goes over the wire, and
// is left away for a band that it does not shorten (the format allows that always), so that no frame needs more room for it.
#include "panel.h"

#include <libusb.h>
#include <lz4.h>
#include <stdlib.h>
#include <string.h>

enum {
    GET_STATUS = 0x00,
    GET_DESCRIPTOR = 0x01,
    GET_FORMATS = 0x40,
    GET_PROPERTIES = 0x41,
    GET_CONNECTORS = 0x50,
    GET_CONNECTOR_PROPERTIES = 0x51,
    GET_CONNECTOR_STATUS = 0x54,
    GET_MODES = 0x55,
    SET_BUFFER = 0x60,
    STATE_CHECK = 0x61,
    STATE_COMMIT = 0x62,
    CONTROLLER_ENABLE = 0x63,
    DISPLAY_ENABLE = 0x64,

    FLAG_STATUS_ON_SET = 1,
    FLAG_FULL_UPDATE = 2,
    COMPRESSION_LZ4 = 1, /* a bit of the descriptor's, and the value in SET_BUFFER */
    MODE_PREFERRED = 1 << 10,
    CONNECTOR_CONNECTED = 1,
    CONNECTOR_UNKNOWN = 2,
    PROPERTY_CONNECTOR_LAST = 12,
    PROPERTY_ROTATION = 50,
    ROTATION_0 = 1,

    DESCRIPTOR_BYTES = 30,
    FORMATS_MAX = 32,
    CONNECTORS_MAX = 32,
    CONNECTOR_BYTES = 5,
    PROPERTIES_MAX = 32,
    PROPERTY_BYTES = 10,
    MODES_MAX = 128,
    MODE_BYTES = 24,
    SET_BUFFER_BYTES = 25,
    STATE_BYTES = MODE_BYTES + 2,
    OPEN_MS = 1000,
};

static const uint32_t MAGIC = 0x1d50614d;

struct format {
    uint8_t code, bytes; /* a pixel */
    const char *name;
};

// The first that the device has is taken. Fewer bits than eight a channel are no picture on a wall.
static const struct format formats[] = { { 0x50, 3, "RGB888" }, { 0x80, 4, "XRGB8888" }, { 0x40, 2, "RGB565" } };

struct gud {
    struct libusb_device_handle *handle;
    uint8_t interface;
    uint32_t width, height, flags, max_buffer;
    const struct format *format;
    uint8_t connector;
    uint8_t mode[MODE_BYTES];
    uint8_t properties[2 * PROPERTIES_MAX * PROPERTY_BYTES];
    size_t properties_bytes;
    uint32_t rows, bands; /* of a band; how many */
    uint8_t *plain;       /* a frame before compression, width * height * format->bytes; NULL: the display takes no LZ4 */
    bool lz4;
    bool begun;           /* FULL_UPDATE: the rectangle is named only after a failed frame, so not with the first */
};

static uint32_t u32(const uint8_t *p) { return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24; }
static uint16_t u16(const uint8_t *p) { return (uint16_t)(p[0] | p[1] << 8); }

static void put32(uint8_t *p, uint32_t v)
{
    for (unsigned i = 0; i < 4; i++)
        p[i] = (uint8_t)(v >> (8 * i));
}

static const char *status_name(uint8_t status)
{
    static const char *const names[] = { "ok", "busy", "request not supported", "protocol error", "invalid parameter",
                                         "error" };
    return status < sizeof(names) / sizeof(*names) ? names[status] : "a status that the protocol does not have";
}

// ---- probe ---------------------------------------------------------------------------------------------

static int probe(const struct libusb_config_descriptor *c, uint8_t *interface, uint8_t *endpoint, struct fault *f)
{
    for (unsigned i = 0; i < c->bNumInterfaces; i++) {
        if (c->interface[i].num_altsetting < 1)
            continue;
        const struct libusb_interface_descriptor *d = &c->interface[i].altsetting[0];
        if (d->bInterfaceClass != LIBUSB_CLASS_VENDOR_SPEC)
            continue;
        for (unsigned k = 0; k < d->bNumEndpoints; k++) {
            const struct libusb_endpoint_descriptor *e = &d->endpoint[k];
            if ((e->bmAttributes & 3) != LIBUSB_TRANSFER_TYPE_BULK || (e->bEndpointAddress & LIBUSB_ENDPOINT_IN))
                continue;
            *interface = d->bInterfaceNumber;
            *endpoint = e->bEndpointAddress;
            return 0;
        }
    }
    return fault_set(f, FAULT_WALL, "interface", "no interface of class 255 (vendor) with a bulk OUT endpoint");
}

// ---- requests while it opens -----------------------------------------------------------------------------

static int read_status(struct gud *g, uint8_t *status)
{
    const int r = libusb_control_transfer(g->handle, 0xC1, GET_STATUS, 0, g->interface, status, 1, OPEN_MS);
    return r == 1 ? 0 : r < 0 ? r : LIBUSB_ERROR_IO;
}

// A stall is the device's refusal, and it is asked for the reason; all else is the bus's trouble, which may pass.
static int request_fault(struct gud *g, int r, const char *what, struct fault *f)
{
    uint8_t status;
    if (r != LIBUSB_ERROR_PIPE)
        return fault_set(f, FAULT_INTERNAL, what, "%s: %s", what, libusb_strerror(r));
    if (read_status(g, &status))
        return fault_set(f, FAULT_WALL, what, "%s: the display refuses (stall), and does not say why", what);
    return fault_set(f, FAULT_WALL, what, "%s: the display refuses: %s (%u)", what, status_name(status), status);
}

// *length: what came, at most max.
static int get(struct gud *g, uint8_t request, uint16_t value, uint8_t *data, size_t max, size_t *length,
               const char *what, struct fault *f)
{
    const int r = libusb_control_transfer(g->handle, 0xC1, request, value, g->interface, data, (uint16_t)max, OPEN_MS);
    if (r < 0)
        return request_fault(g, r, what, f);
    *length = (size_t)r;
    return 0;
}

// A list: a whole number of items, at least `least`.
static int get_list(struct gud *g, uint8_t request, uint16_t value, uint8_t *data, size_t max, size_t item,
                    size_t least, size_t *items, const char *what, struct fault *f)
{
    size_t length = 0;
    if (get(g, request, value, data, max * item, &length, what, f))
        return -1;
    if (length % item != 0)
        return fault_set(f, FAULT_WALL, what, "%s: %zu bytes, expected a multiple of %zu", what, length, item);
    if (length / item < least)
        return fault_set(f, FAULT_WALL, what, "%s: the list is empty, expected at least %zu", what, least);
    *items = length / item;
    return 0;
}

static int set(struct gud *g, uint8_t request, uint8_t *data, size_t length, const char *what, struct fault *f)
{
    const int r = libusb_control_transfer(g->handle, 0x41, request, 0, g->interface, data, (uint16_t)length, OPEN_MS);
    if (r < 0)
        return request_fault(g, r, what, f);
    if ((size_t)r != length)
        return fault_set(f, FAULT_INTERNAL, what, "%s: the display took %d of %zu bytes", what, r, length);
    if (!(g->flags & FLAG_STATUS_ON_SET))
        return 0;
    uint8_t status;
    if (read_status(g, &status))
        return fault_set(f, FAULT_WALL, what, "%s: no status, which the display says it gives", what);
    return status ? fault_set(f, FAULT_WALL, what, "%s: the display answers: %s (%u)", what, status_name(status), status)
                  : 0;
}

// ---- what the display says of itself ---------------------------------------------------------------------

static int check_size(uint32_t want, uint32_t least, uint32_t most, const char *what, struct fault *f)
{
    if (least > most || most == 0)
        return fault_set(f, FAULT_WALL, what, "%s: the display says it takes %u to %u, which is nothing", what, least, most);
    if (want < least || want > most)
        return fault_set(f, FAULT_WALL, what, "%s: the wall wants %u, the display takes %u to %u", what, want, least, most);
    return 0;
}

static int read_descriptor(struct gud *g, struct fault *f)
{
    uint8_t d[DESCRIPTOR_BYTES];
    size_t length = 0;
    if (get(g, GET_DESCRIPTOR, 0, d, sizeof(d), &length, "descriptor", f))
        return -1;
    if (length != sizeof(d))
        return fault_set(f, FAULT_WALL, "descriptor", "descriptor: %zu bytes, expected %d", length, DESCRIPTOR_BYTES);
    if (u32(d) != MAGIC)
        return fault_set(f, FAULT_WALL, "descriptor", "magic 0x%08x, expected 0x%08x", u32(d), MAGIC);
    if (d[4] != 1)
        return fault_set(f, FAULT_WALL, "descriptor", "protocol version %u, expected 1", d[4]);
    g->flags = u32(d + 5);
    g->lz4 = (d[9] & COMPRESSION_LZ4) && !(g->flags & FLAG_FULL_UPDATE);
    g->max_buffer = u32(d + 10);
    return check_size(g->width, u32(d + 14), u32(d + 18), "width", f) ||
                   check_size(g->height, u32(d + 22), u32(d + 26), "height", f)
               ? -1
               : 0;
}

static int choose_format(struct gud *g, struct fault *f)
{
    uint8_t codes[FORMATS_MAX];
    size_t count;
    if (get_list(g, GET_FORMATS, 0, codes, FORMATS_MAX, 1, 1, &count, "formats", f))
        return -1;
    for (size_t i = 0; i < sizeof(formats) / sizeof(*formats); i++)
        if (memchr(codes, formats[i].code, count)) {
            g->format = &formats[i];
            return 0;
        }
    return fault_set(f, FAULT_WALL, "formats", "the display has %zu pixel formats (the first is 0x%02x), none of them RGB888 "
                     "(0x50), XRGB8888 (0x80) or RGB565 (0x40)", count, codes[0]);
}

// max_buffer 0 means no limit. A whole frame is at most 4 MB: the wall's own limit of pixels.
static int plan_bands(struct gud *g, struct fault *f)
{
    const uint64_t pitch = (uint64_t)g->width * g->format->bytes, frame = pitch * g->height;
    const uint64_t buffer = g->max_buffer && g->max_buffer < frame ? g->max_buffer : frame;
    if (buffer < pitch)
        return fault_set(f, FAULT_WALL, "buffer", "the display's buffer is %u bytes, one row of %s is %llu", g->max_buffer,
                         g->format->name, (unsigned long long)pitch);
    if ((g->flags & FLAG_FULL_UPDATE) && buffer < frame)
        return fault_set(f, FAULT_WALL, "buffer", "the display takes only whole frames (%llu bytes), and its buffer is %u",
                         (unsigned long long)frame, g->max_buffer);
    g->rows = (uint32_t)(buffer / pitch);
    g->bands = (g->height + g->rows - 1) / g->rows;
    return 0;
}

// They go back with the state as they came: the display's defaults. Unknown ones are left out, as the kernel does.
static void keep_property(struct gud *g, const uint8_t *p, bool connector)
{
    const uint16_t id = u16(p);
    if (connector ? id < 1 || id > PROPERTY_CONNECTOR_LAST : id != PROPERTY_ROTATION)
        return;
    uint8_t *to = g->properties + g->properties_bytes;
    memcpy(to, p, PROPERTY_BYTES);
    if (!connector) { // what came is the set of rotations that it can do
        memset(to + 2, 0, 8);
        to[2] = ROTATION_0;
    }
    g->properties_bytes += PROPERTY_BYTES;
}

static int read_properties(struct gud *g, bool connector, struct fault *f)
{
    uint8_t p[PROPERTIES_MAX * PROPERTY_BYTES];
    size_t count;
    if (get_list(g, connector ? GET_CONNECTOR_PROPERTIES : GET_PROPERTIES, connector ? g->connector : 0, p,
                 PROPERTIES_MAX, PROPERTY_BYTES, 0, &count, connector ? "connector properties" : "properties", f))
        return -1;
    for (size_t i = 0; i < count; i++)
        keep_property(g, p + i * PROPERTY_BYTES, connector);
    return 0;
}

static int take_connector(struct gud *g, size_t i, size_t properties_before, struct fault *f)
{
    g->connector = (uint8_t)i;
    g->properties_bytes = properties_before;
    return read_properties(g, true, f);
}

// The first that is connected, else the first that cannot tell.
static int choose_connector(struct gud *g, struct fault *f)
{
    uint8_t list[CONNECTORS_MAX * CONNECTOR_BYTES];
    const size_t before = g->properties_bytes;
    size_t count, length = 0;
    int unknown = -1;
    if (get_list(g, GET_CONNECTORS, 0, list, CONNECTORS_MAX, CONNECTOR_BYTES, 1, &count, "connectors", f))
        return -1;
    for (size_t i = 0; i < count; i++) {
        uint8_t status;
        if (take_connector(g, i, before, f) ||
            get(g, GET_CONNECTOR_STATUS, (uint16_t)i, &status, 1, &length, "connector status", f))
            return -1;
        if (length != 1)
            return fault_set(f, FAULT_WALL, "connector status", "connector status: 0 bytes, expected 1");
        if ((status & 3) == CONNECTOR_CONNECTED)
            return 0;
        if ((status & 3) == CONNECTOR_UNKNOWN && unknown < 0)
            unknown = (int)i;
    }
    if (unknown < 0)
        return fault_set(f, FAULT_WALL, "connector status", "nothing is connected to any of the display's %zu connectors",
                         count);
    return take_connector(g, (size_t)unknown, before, f);
}

// display <= sync start <= sync end <= total, each way: anything else is no timing.
static bool mode_sane(const uint8_t *m)
{
    for (unsigned at = 4; at <= 12; at += 8)
        if (u16(m + at) < 1 || u16(m + at) > u16(m + at + 2) || u16(m + at + 2) > u16(m + at + 4) ||
            u16(m + at + 4) > u16(m + at + 6))
            return false;
    return true;
}

static int choose_mode(struct gud *g, struct fault *f)
{
    static const char field[] = "modes";
    uint8_t list[MODES_MAX * MODE_BYTES];
    size_t count;
    const uint8_t *best = NULL;
    if (get_list(g, GET_MODES, g->connector, list, MODES_MAX, MODE_BYTES, 1, &count, field, f))
        return -1;
    bool nonsense = false;
    for (size_t i = 0; i < count; i++) {
        const uint8_t *m = list + i * MODE_BYTES;
        if (u16(m + 4) != g->width || u16(m + 12) != g->height)
            continue;
        if (!mode_sane(m))
            nonsense = true;
        else if (!best || (u32(m + 20) & MODE_PREFERRED && !(u32(best + 20) & MODE_PREFERRED)))
            best = m;
    }
    if (!best && nonsense)
        return fault_set(f, FAULT_WALL, field, "the display's mode of %u x %u has sync times out of order", g->width, g->height);
    if (!best)
        return fault_set(f, FAULT_WALL, field, "the display has %zu modes (the first is %u x %u), none is %u x %u, the wall's",
                         count, u16(list + 4), u16(list + 12), g->width, g->height);
    memcpy(g->mode, best, MODE_BYTES);
    return 0;
}

static int start_display(struct gud *g, struct fault *f)
{
    uint8_t on = 1, state[STATE_BYTES + sizeof(g->properties)];
    memcpy(state, g->mode, MODE_BYTES);
    state[MODE_BYTES] = g->format->code;
    state[MODE_BYTES + 1] = g->connector;
    memcpy(state + STATE_BYTES, g->properties, g->properties_bytes);
    return set(g, CONTROLLER_ENABLE, &on, 1, "controller on", f) ||
                   set(g, STATE_CHECK, state, STATE_BYTES + g->properties_bytes, "state check", f) ||
                   set(g, STATE_COMMIT, NULL, 0, "state commit", f) || set(g, DISPLAY_ENABLE, &on, 1, "display on", f)
               ? -1
               : 0;
}

static int open_display(void **state, struct libusb_device_handle *h, uint8_t interface, uint8_t endpoint,
                        const struct panel_config *c, struct panel_need *need, struct fault *f)
{
    (void)endpoint;
    if (c->width < 1 || c->height < 1 || (uint64_t)c->width * c->height > WALL_PIXELS_MAX)
        return fault_set(f, FAULT_WALL, "size", "%u x %u pixels, expected 1 to %d", c->width, c->height, WALL_PIXELS_MAX);
    struct gud *g = calloc(1, sizeof(*g));
    if (!g)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for a display");
    g->handle = h;
    g->interface = interface;
    g->width = c->width;
    g->height = c->height;
    if (read_descriptor(g, f) || choose_format(g, f) || plan_bands(g, f) || read_properties(g, false, f) ||
        choose_connector(g, f) || choose_mode(g, f) || start_display(g, f))
        goto fail;
    const size_t frame = (size_t)g->width * g->height * g->format->bytes;
    if (g->lz4 && !(g->plain = malloc(frame))) {
        fault_set(f, FAULT_NO_MEMORY, "", "no memory for a display's frame");
        goto fail;
    }
    need->bytes = (size_t)g->bands * SET_BUFFER_BYTES + frame;
    need->steps = g->bands * (g->flags & FLAG_STATUS_ON_SET ? 3 : 2);
    *state = g;
    return 0;
fail:
    free(g);
    return -1;
}

static void close_display(void *state)
{
    struct gud *g = state;
    free(g->plain);
    free(g);
}

// ---- frames ----------------------------------------------------------------------------------------------

static void convert(const struct gud *g, const uint8_t *rgb, uint8_t *out)
{
    const size_t pixels = (size_t)g->width * g->height;
    const unsigned bytes = g->format->bytes;
    for (size_t i = 0; i < pixels; i++, rgb += 3, out += bytes) {
        if (bytes == 2) {
            const unsigned r = (rgb[0] * 31u + 127) / 255, gr = (rgb[1] * 63u + 127) / 255, b = (rgb[2] * 31u + 127) / 255;
            out[0] = (uint8_t)(gr << 5 | b);
            out[1] = (uint8_t)(r << 3 | gr >> 3);
            continue;
        }
        out[0] = rgb[2];
        out[1] = rgb[1];
        out[2] = rgb[0];
        if (bytes == 4)
            out[3] = 0;
    }
}

static void name_band(const struct gud *g, uint32_t y, uint32_t rows, size_t compressed, uint8_t *out)
{
    memset(out, 0, SET_BUFFER_BYTES);
    put32(out + 4, y);
    put32(out + 8, g->width);
    put32(out + 12, rows);
    put32(out + 16, rows * g->width * g->format->bytes);
    if (!compressed)
        return;
    out[20] = COMPRESSION_LZ4;
    put32(out + 21, (uint32_t)compressed);
}

// The length, or 0: it does not shrink, and is copied as it is. At most 4 MB (the wall's limit of pixels), so it fits an int.
static size_t compress_band(const uint8_t *plain, size_t length, uint8_t *out)
{
    const int n = LZ4_compress_default((const char *)plain, (char *)out, (int)length, (int)length - 1);
    if (n > 0)
        return (size_t)n;
    memcpy(out, plain, length);
    return 0;
}

static void encode_band(const struct gud *g, uint32_t band, bool named, struct panel_frame *f)
{
    const size_t pitch = (size_t)g->width * g->format->bytes, name = (size_t)band * SET_BUFFER_BYTES;
    const uint32_t y = band * g->rows, left = g->height - y, rows = left < g->rows ? left : g->rows;
    const size_t at = (size_t)g->bands * SET_BUFFER_BYTES + y * pitch, length = rows * pitch;
    const size_t compressed = g->plain ? compress_band(g->plain + y * pitch, length, f->data + at) : 0;
    name_band(g, y, rows, compressed, f->data + name);
    if (named)
        f->step[f->steps++] = (struct panel_step){ .control = true, .request_type = 0x41, .request = SET_BUFFER,
                                                   .index = g->interface, .offset = name, .length = SET_BUFFER_BYTES };
    if (named && (g->flags & FLAG_STATUS_ON_SET))
        f->step[f->steps++] = (struct panel_step){ .control = true, .request_type = 0xC1, .request = GET_STATUS,
                                                   .index = g->interface, .length = 1 };
    f->step[f->steps++] = (struct panel_step){ .offset = at, .length = compressed ? compressed : length };
}

static void encode(void *state, const uint8_t *rgb, bool full, struct panel_frame *f)
{
    struct gud *g = state;
    const size_t pixels = (size_t)g->bands * SET_BUFFER_BYTES;
    const bool named = !(g->flags & FLAG_FULL_UPDATE) || (full && g->begun);
    g->begun = true;
    f->steps = 0;
    convert(g, rgb, g->plain ? g->plain : f->data + pixels);
    for (uint32_t band = 0; band < g->bands; band++)
        encode_band(g, band, named, f);
    f->size = pixels + (size_t)g->width * g->height * g->format->bytes;
}

static int reply(void *state, const struct panel_step *step, const uint8_t *data, size_t length, struct fault *f)
{
    (void)state;
    (void)step;
    if (length != 1)
        return fault_set(f, FAULT_WALL, "status", "status: %zu bytes, expected 1", length);
    return data[0] ? fault_set(f, FAULT_WALL, "status", "the display answers: %s (%u)", status_name(data[0]), data[0]) : 0;
}

static int mend(void *state, struct fault *f)
{
    uint8_t status = 0;
    const int r = read_status(state, &status);
    if (r)
        return fault_set(f, FAULT_INTERNAL, "status", "no status after a stall: %s", libusb_strerror(r));
    return status ? fault_set(f, FAULT_WALL, "status", "the display says: %s (%u)", status_name(status), status) : 0;
}

const struct panel_ops panel_gud = {
    .name = "gud",
    .kind = WALL_GUD,
    .id = { { 0x1d50, 0x614d }, { 0x16d0, 0x10a9 } },
    .in_flight = 1,
    .probe = probe,
    .open = open_display,
    .close = close_display,
    .encode = encode,
    .reply = reply,
    .mend = mend,
};
