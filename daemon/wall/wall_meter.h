/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wall_meter.h - what a pacer has measured: the last 4096 values of something, and how much there was in the last second.
 * Pure; fixed size, so that a tick allocates nothing and a copy can be taken under a lock and worked on outside it.
 */
#ifndef AIRYD_WALL_METER_H
#define AIRYD_WALL_METER_H

#include "wall.h"

enum { METER_VALUES = 4096, METER_TICKS = 256 /* more than a second of the fastest wall */ };

struct meter { unsigned count, next; float ms[METER_VALUES]; };

void meter_add(struct meter *m, double ms);
struct wall_times meter_times(struct meter *m); /* puts the values in order: of a copy */
/* The same of n values. */
struct wall_times meter_percentiles(float *ms, unsigned n);

struct meter_second {
    unsigned count, next;
    struct { uint64_t ns, pictures; } tick[METER_TICKS];
};

void meter_second_add(struct meter_second *m, uint64_t now_ns, uint64_t pictures /* so far */);
void meter_second_read(const struct meter_second *m, uint64_t now_ns, double *ticks_per_s, double *pictures_per_s);

#endif
