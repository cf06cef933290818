/* SPDX-License-Identifier: Apache-2.0 */
/*
 * usb.h - boards over libusb: found by serial, opened when they come, lost and found again; at most 2 frames in flight a
 * board, the newest frame wins.
 *
 * Threads: one handles libusb's events and never blocks on a board; one reads the serials of what was plugged in (hot-plug
 * callbacks only leave a note for it); and each wanted board has one that opens it, clears its halts and closes it, so that a
 * board that answers slowly or lies never keeps another one waiting. usb_board_send and usb_board_stats may be called
 * from any thread, never block on a board, and take microseconds. A board is closed only after its last transfer has come back.
 *
 * Faults: stall -> clear halt, next frame whole; time-out -> cancel, next frame whole; device gone (by transfer, by ioctl or by
 * hot-plug, whichever comes first) -> closed, and opened again when a board of its kind and serial arrives. The newest frame that
 * a fault took is sent again at once; after a second fault in a row only with the next frame, so that a broken board costs no more
 * than the wall's rate.
 * Where no udevd runs (containers), libusb hears of no arrivals: there the bus is looked at once a second.
 *
 * Every frame that usb_board_send is given ends in exactly one of sent, dropped and missed.
 */
#ifndef AIRYD_USB_H
#define AIRYD_USB_H

#include "panel.h"

struct usb;
struct usb_board;

/* 0, or -1 and *f (FAULT_INTERNAL: no USB here, and why). log may be NULL; called from usb's threads, and must not call back. */
int usb_create(struct usb **out, void (*log)(const char *line), struct fault *f);
void usb_destroy(struct usb *u); /* closes and frees all boards that were not removed; NULL is fine */

enum usb_state { USB_ABSENT, USB_OPENING, USB_READY, USB_FAILED /* found, but cannot be used: `why` */ };

/* From now on the board is looked for, opened and kept open. The config is copied. 0, or -1 and *f: FAULT_WALL when this
 * kind and serial is in use by another wall; NO_MEMORY. */
int usb_board_add(struct usb_board **out, struct usb *u, const struct panel_config *c, struct fault *f);
/* Waits for what is in flight (at most timeout_ms), cancels the rest, closes, frees. NULL is fine. */
void usb_board_remove(struct usb_board *b, unsigned timeout_ms);

/* 3 * width * height bytes, copied. Sent at once when fewer than 2 frames are in flight, else when one comes back; a frame
 * that waits is replaced by a newer one (counted as dropped). ready_ns: CLOCK_MONOTONIC, when the tick had its bytes.
 * A board that is not ready counts it as missed. */
void usb_board_send(struct usb_board *b, const uint8_t *rgb, uint64_t ready_ns);
/* True when nothing is in flight or waiting. */
bool usb_board_idle(struct usb_board *b);

enum { USB_LATENCIES = 4096 };
struct usb_stats {
    enum usb_state state;
    char why[160];            /* of FAILED and ABSENT after a loss */
    char path[32];            /* "1-4.2", empty when absent */
    uint64_t sent;            /* frames wholly transferred */
    uint64_t dropped;         /* replaced by a newer one, before it was sent or when a fault took it */
    uint64_t missed;          /* came while the board was not ready, or was under way when it was lost */
    uint64_t stalls, timeouts, errors, losses, opens;
    uint64_t rendered, received; /* by the board's own counters, 0: it has none */
    uint64_t last_done_ns;    /* when the last frame's last transfer came back; 0: none yet */
    uint32_t latency_count;   /* of the last frames, at most USB_LATENCIES */
};
/* latency_us, of USB_LATENCIES entries, or NULL: from ready to the last transfer's return. */
void usb_board_stats(struct usb_board *b, struct usb_stats *out, uint32_t *latency_us);

/* All controllers of known kinds that are plugged in, wanted or not, by path. Waits so long for serials that are being read; 0: not at all. */
struct usb_found {
    enum wall_board_kind kind;
    char serial[WALL_NAME_MAX]; /* empty: could not be read, `why` */
    char path[32], why[96];
    uint16_t release;           /* bcdDevice */
    bool reading;               /* the serial is still being read */
    bool in_use, twice;         /* twice: another has the same serial */
};
unsigned usb_list(struct usb *u, struct usb_found *out, unsigned max, unsigned wait_ms);

#endif
