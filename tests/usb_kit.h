/* SPDX-License-Identifier: Apache-2.0 */
/*
 * usb_kit.h - USB boards without hardware: models of a Fadecandy and of a GUD display behind emulated usbfs nodes, for
 * the code under test in this process, or for an unmodified program that this process starts.
 *
 * Invariant: a model records only what a real board would have got: a transfer counts when it completes, packets of a
 * stalled or cancelled one do not. A model is a board's firmware and the kernel's usbfs in one; the system under test is real
 * down to its ioctls.
 *
 * The program must run under umockdev-wrapper (its library is preloaded); a child inherits the preload and UMOCKDEV_DIR
 * from the environment, so fork and exec is all it takes. One kit a process, made before anything of libusb or udev runs. Under
 * a sanitizer: ASAN_OPTIONS=verify_asan_link_order=0.
 */
#ifndef AIRYD_USB_KIT_H
#define AIRYD_USB_KIT_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct usb_kit;
struct kit_urb;

enum {
    KIT_FRAME_BYTES = 1600,
    KIT_LOG = 4096,       /* frames and requests that are remembered */
    KIT_REPLY_MAX = 3072,
    KIT_REQUESTS = 0x58,
};

struct kit_reply { /* what the display answers to one request; a test may put any lie here before it is plugged in */
    uint8_t data[KIT_REPLY_MAX];
    size_t length;
    bool stall;
};

struct kit_board {
    struct usb_kit *kit; /* the kit's own fields first: not for tests */
    bool gud;
    unsigned port, bus, address;
    bool plugged, unheard;
    int fifo;
    void *handler;
    struct kit_urb *flying, *done;
    uint64_t busy_until_ns;
    char node[64], syspath[128];

    pthread_mutex_t lock; /* guards all below; kit_* functions take it */
    pthread_cond_t change;
    char serial[128];
    uint16_t vendor, product;
    /* Faults. */
    bool gone;              /* every ioctl says ENODEV */
    unsigned stall_next;    /* so many bulk transfers stall */
    unsigned enomem_next;   /* so many submissions fail */
    bool hold;              /* bulk transfers never complete */
    bool mute;              /* control transfers never complete */
    unsigned delay_us;      /* of a bulk transfer; one after the other */
    bool stall_stays;       /* a stalled endpoint stalls until its halt is cleared */
    bool halted;

    /* What came. */
    uint64_t frames, luts, configs, bad, clears, claims, releases, cancels;
    uint8_t frame[KIT_FRAME_BYTES], lut[KIT_FRAME_BYTES], config[64];
    uint32_t id[KIT_LOG];     /* of frame n at n % KIT_LOG: its first LED's three bytes as they came */
    uint64_t at_ns[KIT_LOG];  /* when it was complete, CLOCK_MONOTONIC */

    /* Of a display. */
    struct kit_reply *reply;  /* [KIT_REQUESTS], by bRequest */
    uint32_t width, height;
    unsigned pixel_bytes;
    uint8_t set_status;       /* what GET_STATUS says after an OUT */
    unsigned set_stall;       /* the bRequest of the OUT that stalls, 0: none */
    uint8_t request[KIT_LOG]; /* every control request but GET_STATUS and strings, in order, a bulk transfer as 0xff */
    uint64_t requests;
    uint8_t state[1024];      /* of the last STATE_CHECK */
    size_t state_bytes;
    uint8_t buffer[25];       /* of the last SET_BUFFER */
    uint64_t buffers, statuses;
    uint64_t compressed, bulk_bytes; /* rectangles that came as LZ4; bytes of all rectangles on the wire */
    bool committed, lit, named;
    uint8_t *picture;         /* width * height * pixel_bytes */
};

struct usb_kit *kit_create(void); /* NULL: the preload is missing */
void kit_destroy(struct usb_kit *k); /* and all boards */

/* Models, not yet plugged in; each at a port of its own. Owned by the kit. */
struct kit_board *kit_fadecandy(struct usb_kit *k, const char *serial);
/* RGB888, one mode, connected, no flags, a buffer of one frame. */
struct kit_board *kit_gud(struct usb_kit *k, const char *serial, uint32_t width, uint32_t height);
void kit_gud_defaults(struct kit_board *b); /* back to that; not while it is plugged in */
void kit_gud_mode(uint8_t out[24], uint16_t width, uint16_t height); /* a sound one */

void kit_plug(struct kit_board *b);     /* a new address each time */
void kit_plug_unheard(struct kit_board *b); /* on the bus, but no event says so, as where no udevd runs */
void kit_unplug(struct kit_board *b);   /* transfers die, ioctls say ENODEV, then the event; no-op when not plugged */
void kit_unplug_all(struct usb_kit *k);
void kit_vanish(struct kit_board *b);   /* as unplug, but no event */

/* Handles of this process that are open on the board's node (its last one). */
unsigned kit_open_fds(struct kit_board *b);
/* What came before may be read without the locks until more comes: of boards at rest. kit_open_fds and rig_until do it, too. */
void kit_see_all(struct usb_kit *k);
/* Waits until the condition on the board is true, looked at under its lock; false after ms. */
bool kit_wait(struct kit_board *b, bool (*is)(const struct kit_board *b, uint64_t n), uint64_t n, unsigned ms);
bool kit_wait_frames(struct kit_board *b, uint64_t frames, unsigned ms);
uint64_t kit_count(struct kit_board *b, const uint64_t *of); /* one of its counts, while it may grow */
uint64_t kit_frames(struct kit_board *b);
#define KIT_SET(b, field, value) \
    do { \
        pthread_mutex_lock(&(b)->lock); \
        (b)->field = (value); \
        pthread_cond_broadcast(&(b)->change); \
        pthread_mutex_unlock(&(b)->lock); \
    } while (0)

#endif
