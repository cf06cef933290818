/* SPDX-License-Identifier: Apache-2.0 */
/*
 * usb_vhci.h - a Fadecandy for a real kernel: the firmware of usb_kit_model behind USB/IP, plugged into the kernel's own
 * virtual host controller. Unlike usb_kit, nothing between the code under test and the firmware is emulated: hub, usbcore, usbfs,
 * uevents and udevd are the system's.
 *
 * Invariant: as in usb_kit, a transfer counts when it completes; bytes of a stalled, held or unlinked one do not. A stalled
 * endpoint stays halted until its halt is cleared.
 *
 * For a machine of its own: it wants root and the module vhci-hcd. One thread a board serves its socket; all functions here are
 * for the test's thread.
 */
#ifndef AIRYD_USB_VHCI_H
#define AIRYD_USB_VHCI_H

#include "usb_kit.h"

struct vhci_board;

/* Not yet plugged in. The port of the virtual hub is the test's choice, from 0 on. NULL: no memory. */
struct vhci_board *vhci_create(const char *serial, unsigned port);
void vhci_destroy(struct vhci_board *v); /* unplugs first; NULL is fine */

/* 0, or -errno: no vhci_hcd here, or the port is in use. */
int vhci_plug(struct vhci_board *v);
void vhci_unplug(struct vhci_board *v); /* no-op when not plugged */

/* The firmware: faults and records. Owned by v; take its lock. */
struct kit_board *vhci_kit(struct vhci_board *v);
/* When the kernel had configured it last, CLOCK_MONOTONIC; 0: not since it was plugged in. */
uint64_t vhci_configured_ns(struct vhci_board *v);
uint64_t vhci_frames(struct vhci_board *v);
bool vhci_wait_frames(struct vhci_board *v, uint64_t frames, unsigned ms); /* false after ms */

#endif
