/* SPDX-License-Identifier: Apache-2.0 */
/*
 * usb_vhci_drive.h - what drives the wall in the machine of usb_vhci.sh: the unmodified daemon over its socket, or, where the CPU
 * is emulated and the daemon's first draw on lavapipe takes longer than its own limit of 60 s for a frame, the same wall (pacer,
 * colour, layout, boards) linked into the test, without a device. One a process; a failure fails the test.
 */
#ifndef AIRYD_USB_VHCI_DRIVE_H
#define AIRYD_USB_VHCI_DRIVE_H

#include <stdbool.h>
#include <stdint.h>

struct drive_times { double p50, p99, max; }; /* ms */
struct drive_state { /* of the wall's only board */
    char state[16], problem[160];
    uint64_t dropped, missed, stalls, timeouts, errors, losses;
    struct drive_times latency, late; /* bytes ready -> transferred; a tick against the clock */
    unsigned controllers;
    char kind[16], serial[64], path[32], trouble[96]; /* of the first controller */
};

/* Opens the wall `w` of this definition; tells what drives it. */
void drive_start(const char *definition, bool daemon);
void drive_pattern(const char *word, uint32_t led); /* at level 1; led: on the board `serial` of the definition */
struct drive_state drive_look(void);
int drive_stop(void); /* SIGTERM, or its like; the exit status. 0 when nothing runs */

#endif
