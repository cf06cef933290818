/* SPDX-License-Identifier: Apache-2.0 */
/*
 * panel.h - what a kind of LED controller must know how to do, and what it is given for that. One file a controller
 * (panel_fadecandy.c, panel_gud.c); usb.c does everything that is the same for all: finding, opening, hot-plug, the
 * transfers in flight, time-outs, statistics.
 *
 * Every function runs on the thread of usb.c that handles libusb's events, or on its thread that opens boards; none may
 * block on the event thread: what takes a round trip is a list of steps (struct panel_step) that usb.c submits one after
 * the other.
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

/* A transfer: control (endpoint 0) or bulk OUT. The data lie in the frame's buffer. */
struct panel_step {
    bool control;
    uint8_t request_type, request; /* of control */
    uint16_t value, index;
    size_t offset, length;         /* in panel_frame.data; of a control transfer without its 8 setup bytes */
};

struct panel_frame { /* one frame as this controller wants it; buffers are made once, at open */
    uint8_t *data;
    size_t size, room;
    struct panel_step *step;
    unsigned steps, steps_room;
};

struct panel_ops {
    const char *name;          /* "fadecandy" */
    enum wall_board_kind kind;
    struct { uint16_t vendor, product; } id[4]; /* until {0, 0} */
    /* Which interface and bulk OUT endpoint: 0, or -1 and *f when this is no such device. Descriptors are hostile. */
    int (*probe)(const struct libusb_config_descriptor *c, uint8_t *interface, uint8_t *endpoint, struct fault *f);
    /* After the interface is claimed; may block (opener's thread), each transfer at most 1 s. *state is the driver's. */
    int (*open)(void **state, struct libusb_device_handle *h, uint8_t interface, uint8_t endpoint,
                const struct panel_config *c, struct fault *f);
    void (*close)(void *state);
    /* rgb: 3 * width * height bytes, in the order of the wire. Fills the frame; full: the board's content is unknown (first
     * frame, after a fault). */
    int (*encode)(void *state, const uint8_t *rgb, bool full, struct panel_frame *f);
    /* Statistics of the board itself: fills up to `max` control IN steps (length at most 64 each), and reads the answer of
     * one. 0: it has none. */
    unsigned (*query)(void *state, struct panel_step *step, unsigned max);
    void (*answer)(void *state, unsigned i, const uint8_t *data, size_t length, uint64_t *rendered, uint64_t *received);
};

extern const struct panel_ops panel_fadecandy, panel_gud;
/* By kind, in the order of enum wall_board_kind. */
extern const struct panel_ops *const panel_kinds[WALL_BOARD_KINDS];

#endif
