/* SPDX-License-Identifier: Apache-2.0 */
/*
 * panel.h - what a kind of LED controller must know how to do, and what it is given for that. One file a controller
 * (panel_fadecandy.c, panel_gud.c); usb.c does everything that is the same for all: finding, opening, hot-plug, the
 * transfers in flight, time-outs, statistics.
 *
 * Every function runs either on the board's own thread (open, mend, close: they may block) or on whichever thread sends
 * the next frame, often the one that handles libusb's events (encode, reply, query, answer: they may not). What takes a
 * round trip there is a list of steps (struct panel_step) that usb.c submits one after the other. Calls of one state come
 * from different threads, one at a time, but that query and answer may run beside mend.
 */
#ifndef AIRYD_PANEL_H
#define AIRYD_PANEL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "fault.h"
#include "wall_def.h"

struct libusb_device_handle;
struct libusb_config_descriptor;

struct panel_config { /* what the wall says of this board; constant while it is added */
    enum wall_board_kind kind;
    char serial[WALL_NAME_MAX];
    uint32_t width, height;
    double rate;
    uint16_t lut[3 * 257];
};

enum { PANEL_CONTROL_MAX = 64 }; /* bytes of a control step, without its 8 setup bytes */

/* A transfer: control (endpoint 0) or bulk OUT. What goes out lies in the frame's buffer; what a control IN brings back
 * goes to panel_ops.reply. */
struct panel_step {
    bool control;
    uint8_t request_type, request; /* of control */
    uint16_t value, index;
    size_t offset, length;         /* in panel_frame.data; of a control transfer at most PANEL_CONTROL_MAX */
};

struct panel_need { size_t bytes; unsigned steps; }; /* of one frame, at most */

struct panel_frame { /* one frame as this controller wants it; usb.c makes the buffers once, at open, by panel_need */
    uint8_t *data;
    size_t size, room;
    struct panel_step *step;
    unsigned steps, steps_room;
};

struct panel_ops {
    const char *name;          /* "fadecandy" */
    enum wall_board_kind kind;
    struct { uint16_t vendor, product; } id[4]; /* until {0, 0} */
    unsigned in_flight;        /* frames that may be under way at once: 1 where a frame takes steps that must not mix; at most 2 */
    /* Which interface and bulk OUT endpoint: 0, or -1 and *f when this is no such device. Descriptors are hostile. */
    int (*probe)(const struct libusb_config_descriptor *c, uint8_t *interface, uint8_t *endpoint, struct fault *f);
    /* After the interface is claimed; may block, each transfer at most 1 s. *state is the driver's. 0, or -1 and *f:
     * FAULT_WALL: the device is not fit for this wall, and is not asked again before it is plugged in anew; any other code:
     * it may be tried again. */
    int (*open)(void **state, struct libusb_device_handle *h, uint8_t interface, uint8_t endpoint,
                const struct panel_config *c, struct panel_need *need, struct fault *f);
    void (*close)(void *state);
    /* rgb: 3 * width * height bytes, in the order of the wire. Fills the frame; full: the board's content is unknown (first
     * frame, after a fault). It never needs more than it said at open. */
    void (*encode)(void *state, const uint8_t *rgb, bool full, struct panel_frame *f);
    /* What a control IN step of a frame brought back: 0, or -1 and *f (the frame has failed). NULL: it has no such steps. */
    int (*reply)(void *state, const struct panel_step *step, const uint8_t *data, size_t length, struct fault *f);
    /* After a stall, when the endpoint's halt is cleared; may block. 0, or -1 and *f, the board's own word for what was wrong.
     * NULL: nothing to do. */
    int (*mend)(void *state, struct fault *f);
    /* Statistics of the board itself: fills up to `max` control IN steps (length at most PANEL_CONTROL_MAX each), and reads
     * the answer of one, of any length. 0, or NULL: it has none. */
    unsigned (*query)(void *state, struct panel_step *step, unsigned max);
    void (*answer)(void *state, unsigned i, const uint8_t *data, size_t length, uint64_t *rendered, uint64_t *received);
};

extern const struct panel_ops panel_fadecandy, panel_gud;
/* By kind, in the order of enum wall_board_kind. */
extern const struct panel_ops *const panel_kinds[WALL_BOARD_KINDS];

#endif
