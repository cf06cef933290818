/* SPDX-License-Identifier: Apache-2.0 */
/*
 * pulse.h - since when a device thread has made no progress. systemd's watchdog is fed by it and not by the event loop alone, for
 * that goes on turning while a driver hangs.
 *
 * Progress is a submission that came back, or a share of a computation: one frame may take minutes on a slow device, and it may,
 * for each of its steps is short. The thread that does the work names its pulse once; what it calls beats it without
 * knowing whose it is. A thread without one beats nothing.
 */
#ifndef AIRYD_PULSE_H
#define AIRYD_PULSE_H

#include <stdatomic.h>
#include <stdint.h>

struct pulse { /* all zero: nothing to do; which is progress, too */
    _Atomic uint64_t since_ns;
};

/* By the thread that works. */
void pulse_begin(struct pulse *p);
void pulse_beat(void);
void pulse_end(void);
/* By any thread: clock_ns() of the last progress, 0 when there is nothing to do. */
uint64_t pulse_since_ns(struct pulse *p);

#endif
