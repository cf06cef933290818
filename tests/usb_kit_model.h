/* SPDX-License-Identifier: Apache-2.0 */
/*
 * usb_kit_model.h - the firmware half of usb_kit: what a board does with a request and with bytes. Called with the
 * board's lock.
 */
#ifndef AIRYD_USB_KIT_MODEL_H
#define AIRYD_USB_KIT_MODEL_H

#include "usb_kit.h"

/* A control request: fills out (at most max bytes) and returns the length, or -EPIPE. data: of an OUT, length bytes. */
int kit_control(struct kit_board *b, const uint8_t setup[8], const uint8_t *data, size_t length, uint8_t *out, size_t max);
void kit_bulk(struct kit_board *b, const uint8_t *data, size_t length);
/* Device and configuration descriptor in hex. */
void kit_descriptors(const struct kit_board *b, char *hex, size_t size);

#endif
