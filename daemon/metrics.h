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

enum { METRICS_RECENT = 64, METRICS_STAGES = 6, METRICS_BUCKETS = 14 };

/* "queue", "load", "decode", "bloom", "encode", "total"; upper ends of the buckets, rising. */
extern const char *const metrics_stage_name[METRICS_STAGES];
extern const double metrics_bucket_ms[METRICS_BUCKETS];

struct metrics_histogram {
    uint64_t count[METRICS_BUCKETS + 1]; /* the last: beyond the last bucket's end */
    double sum_ms;
};

struct metrics {
    _Atomic uint64_t done, failed, cancelled, pixels, bytes_in, bytes_out;
    uint64_t start_ns;
    struct stage_times recent[METRICS_RECENT];
    uint64_t recent_count; /* ever noted */
    struct metrics_histogram histogram[METRICS_STAGES];
    uint64_t refused_busy, loop_turns; /* of the socket thread's loop */
    double loop_worst_ms;
};

uint64_t clock_ns(void); /* CLOCK_MONOTONIC */

void metrics_init(struct metrics *m);
void metrics_note(struct metrics *m, const struct stage_times *t);
struct stage_times metrics_mean(const struct metrics *m); /* over the last METRICS_RECENT; else zeros */
uint64_t metrics_rss_bytes(void); /* 0 when the system does not say */

#endif
