/* SPDX-License-Identifier: Apache-2.0 */
/*
 * metrics.h - counters. Any thread adds; STATUS reads them without a lock, so that it is answered at any
 * load. The stage times are the socket thread's alone.
 */
#ifndef AIRYD_METRICS_H
#define AIRYD_METRICS_H

#include <stdatomic.h>
#include <stdint.h>

struct stage_times { /* milliseconds */
    double queue, load, decode, bloom, encode, total;
};

enum { METRICS_RECENT = 64 };

struct metrics {
    _Atomic uint64_t done, failed, cancelled, pixels, bytes_in, bytes_out;
    uint64_t start_ns;
    struct stage_times recent[METRICS_RECENT];
    uint64_t recent_count; /* ever noted */
};

uint64_t clock_ns(void); /* CLOCK_MONOTONIC */

void metrics_init(struct metrics *m);
void metrics_note(struct metrics *m, const struct stage_times *t);
struct stage_times metrics_mean(const struct metrics *m); /* over the last METRICS_RECENT; else zeros */
uint64_t metrics_rss_bytes(void); /* 0 when the system does not say */

#endif
