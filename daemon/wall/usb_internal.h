/* SPDX-License-Identifier: Apache-2.0 */
/*
 * usb_internal.h - what the parts of usb.c share: usb.c (contexts, lists, statistics), usb_find.c (what is plugged in),
 * usb_board.c (a board's own thread: open, mend, close), usb_flight.c (frames and transfers).
 *
 * Locks: struct usb.lock guards the lists (what is plugged in, which boards are wanted); struct usb_board.lock guards one
 * board. Taken in this order; neither is held over a blocking call of libusb. Submitting and cancelling do not block and
 * are done under the board's lock, so that a handle cannot be closed between the check and the use.
 */
#ifndef AIRYD_USB_INTERNAL_H
#define AIRYD_USB_INTERNAL_H

#include <libusb.h>
#include <pthread.h>

#include "usb.h"

enum { USB_SLOTS = 2, USB_QUERIES = 4, USB_RESCAN_MS = 1000, USB_PATH_MAX = 32 };

/* A controller that is plugged in. Born by a note of hot-plug or by the look at the bus; owned by struct usb. */
struct usb_entry {
    struct usb_entry *next;
    uint64_t arrival;            /* names it for good: numbers are never used again */
    libusb_device *device;       /* a reference; NULL: only the bus itself knows it (no udevd) */
    uint8_t bus, address;
    const struct panel_ops *ops;
    uint16_t release;
    bool read;                   /* the serial was read, or cannot be */
    bool unopened;               /* ... for it could not be opened (permission, not there yet): worth another look */
    bool refused;                /* opened, and not fit for the wall that wants it */
    bool used;
    uint64_t retry_ns;           /* not before */
    char serial[WALL_NAME_MAX], path[USB_PATH_MAX], why[96];
};

struct usb {
    libusb_context *context;
    void (*log)(const char *line);
    bool has_hotplug, no_udev;
    libusb_hotplug_callback_handle hotplug;
    pthread_t events, finder;
    bool events_run, finder_run;
    pthread_mutex_t lock;
    pthread_cond_t found; /* the entries changed, or stop */
    bool stop;            /* the finder */
    _Atomic bool end;     /* the event thread */
    struct usb_entry *entry;
    uint64_t arrivals;
    struct usb_board *board;
};

struct usb_slot { /* a frame under way; busy from its first transfer to the return of its last */
    struct usb_board *board;
    struct libusb_transfer *transfer;
    struct panel_frame frame;
    unsigned step;
    bool busy;
    uint64_t number, ready_ns;
    uint8_t control[LIBUSB_CONTROL_SETUP_SIZE + PANEL_CONTROL_MAX];
};

struct usb_query { /* the board's own counters, one control transfer after the other */
    struct libusb_transfer *transfer;
    struct panel_step step[USB_QUERIES];
    unsigned steps, at;
    bool busy;
    uint64_t next_ns;
    uint8_t control[LIBUSB_CONTROL_SETUP_SIZE + PANEL_CONTROL_MAX];
};

struct usb_board {
    struct usb_board *next; /* of struct usb, under its lock */
    struct usb *usb;
    const struct panel_ops *ops;
    struct panel_config config;
    pthread_t keeper;

    pthread_mutex_t lock;
    pthread_cond_t change;
    bool stop;             /* close, and end the thread */
    bool nudge;            /* what is plugged in has changed */
    uint64_t entry;        /* arrival of the one that is open; 0: none */
    libusb_device_handle *handle;
    int fd;                /* under a handle that was wrapped, else -1 */
    uint8_t bus, address, interface, endpoint;
    void *panel;
    bool lost;             /* gone: cancel, close */
    bool faulted;          /* a transfer has failed: the others come back first, then the newest frame goes whole */
    bool halted;           /* ... and the endpoint's halt is to be cleared */
    bool full;             /* the board's content is unknown */
    unsigned faults_in_row;
    struct usb_slot slot[USB_SLOTS];
    unsigned flying;
    struct usb_query query;

    uint8_t *newest;       /* the newest frame's bytes, and a copy being sent can be made again from it */
    size_t newest_bytes;
    uint64_t number, newest_ready_ns;
    bool waiting;          /* newest is to be sent */

    struct usb_stats stats;
    uint64_t latencies;    /* ever noted */
    uint32_t latency_us[USB_LATENCIES];
};

uint64_t usb_now_ns(void);
void usb_cond_init(pthread_cond_t *c); /* of CLOCK_MONOTONIC */
void usb_cond_wait_until(pthread_cond_t *c, pthread_mutex_t *m, uint64_t ns);
void usb_log(struct usb *u, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* usb_find.c */
int usb_find_start(struct usb *u, struct fault *f);
void usb_find_stop(struct usb *u);
void usb_find_free(struct usb *u);
struct usb_entry *usb_entry_by_arrival(struct usb *u, uint64_t arrival);         /* under the lock */
struct usb_entry *usb_entry_for(struct usb *u, const struct usb_board *b, uint64_t now_ns); /* under the lock */
/* Copies what is needed to open one: device (a reference more, or NULL), bus, address. */
struct usb_target {
    libusb_device *device;
    uint8_t bus, address;
};
struct usb_target usb_entry_target(const struct usb_entry *e);
int usb_target_open(struct usb *u, const struct usb_target *t, libusb_device_handle **out, int *fd);
void usb_target_finish(struct usb_target *t);
void usb_nudge(struct usb *u); /* under u->lock: every board looks again */

/* usb_board.c */
int usb_board_start(struct usb_board *b, struct fault *f);
void usb_board_stop(struct usb_board *b); /* closes; returns when it is closed */

/* usb_flight.c: all under the board's lock */
int usb_flight_make(struct usb_board *b, const struct panel_need *need); /* -1: no memory */
void usb_flight_free(struct usb_board *b);
bool usb_flight_over(const struct usb_board *b); /* nothing is with libusb */
void usb_flight_pump(struct usb_board *b);       /* sends what waits, if it may */
void usb_flight_mended(struct usb_board *b);
void usb_flight_lost(struct usb_board *b);
void usb_flight_cancel(struct usb_board *b);
void usb_flight_query(struct usb_board *b, uint64_t now_ns);

#endif
