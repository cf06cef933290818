/* SPDX-License-Identifier: Apache-2.0 */
/*
 * usb_rig.h - what the tests of the boards share: one kit for the whole program, a struct usb for a test, frames that
 * can be told apart, and waits for a condition (no test waits for a time to pass).
 */
#ifndef AIRYD_USB_RIG_H
#define AIRYD_USB_RIG_H

#include "usb.h"
#include "usb_kit.h"

enum { RIG_WAIT_MS = 60000, RIG_LEDS_MAX = 256 * 128 };

extern struct usb_kit *rig_kit;

int rig_group_setup(void **state);    /* for cmocka_run_group_tests */
int rig_group_teardown(void **state);
int rig_teardown(void **state);       /* of each test: unplugs what it left */
struct usb *rig_usb(void);            /* with a log that rig_logged reads */
bool rig_logged(const char *words);   /* since rig_usb */
/* The rate is 2, for time-outs of 1.5 s: on a busy machine a sound transfer may be held up for longer than 100 ms. */
struct panel_config rig_config(enum wall_board_kind kind, const char *serial, uint32_t width, uint32_t height);
struct usb_board *rig_add(struct usb *u, enum wall_board_kind kind, const char *serial, uint32_t width, uint32_t height);

/* Frame n: LED 0 is n in three bytes, little end first; the rest differs from LED to LED and from frame to frame. */
void rig_frame(uint8_t *rgb, size_t leds, uint32_t n);
void rig_send(struct usb_board *b, size_t leds, uint32_t n);
/* Frames first .. first + count - 1, at the rate. */
void rig_send_paced(struct usb_board *b, size_t leds, uint32_t first, unsigned count, double rate);
/* The same, but each only after the one before has arrived: on a machine that is too busy for the rate it takes longer, and
 * still any frame that is dropped is a mistake. */
void rig_send_steady(struct usb_board *b, struct kit_board *k, size_t leds, uint32_t first, unsigned count, double rate);
void rig_sleep_ms(unsigned ms);

/* Waits; fails the test when it does not come. */
void rig_wait_state(struct usb_board *b, enum usb_state s);
void rig_wait_idle(struct usb_board *b);
void rig_wait_frames(struct kit_board *b, uint64_t n);
bool rig_until(bool (*is)(void *arg), void *arg); /* false after RIG_WAIT_MS */
struct usb_stats rig_stats(struct usb_board *b);
/* Id of the model's last frame. */
uint32_t rig_last_id(struct kit_board *b);

#endif
