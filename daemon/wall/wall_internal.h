/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wall_internal.h - what wall.c (everyone's side) and wall_thread.c (the pacer's) share. Two locks that guard data: `lock`, held for
 * microseconds only, for no copy of pixels is made under it; `preview_lock`, which the pacer takes only when it is free.
 *
 * A board's delay: the bytes of a tick wait in a ring of ticks and are sent that much after the tick's own time, by the same
 * thread and clock. So every board shows the same computation, and a delay need not be a number of periods.
 */
#ifndef AIRYD_WALL_INTERNAL_H
#define AIRYD_WALL_INTERNAL_H

#include <pthread.h>
#include <stdatomic.h>

#include "wall_meter.h"
#include "wall_pacer.h"

struct wall_set {           /* of one tick */
    uint64_t time_ns;
    uint8_t **bytes;        /* [n_boards]; owned, as what they point to */
};

struct wall_out {           /* a board; the pacer's alone but for usb */
    struct usb_board *usb;  /* owned; NULL: none is driven */
    size_t size;            /* bytes */
    uint64_t delay_ns;
    uint64_t next;          /* set to send: a count of ticks that were run */
    uint64_t planned_ns, sent_ns; /* of the last one sent: when it was to be, and was */
};

struct wall {
    struct wall_def *def;   /* owned, as all below */
    struct wall_layout *layout;
    struct wall_colour *colour;
    struct usb *usb;        /* not owned; NULL: none */
    void (*log)(const char *line);
    size_t values;          /* of a drive */

    pthread_t thread;
    bool running;
    atomic_bool stop;

    pthread_mutex_t show_lock;   /* one writer at a time; taken before `lock` */
    float *slot[PACER_SLOTS];    /* made when first used; whose: wall_pacer.h */

    pthread_mutex_t lock;        /* the rest up to the next lock */
    struct pacer pacer;          /* .next: written by the pacer's thread only, which so reads it without */
    struct wall_pattern pattern;
    uint64_t pattern_ns, pattern_number; /* when it began; a count of patterns */
    struct meter late, skew;
    struct meter_second second;
    struct wall_stats published;  /* as of the last tick; times and rates left out */
    struct wall_power *board_power, *supply_power;

    pthread_mutex_t preview_lock;
    struct wall_set preview;

    /* The pacer's alone. */
    struct wall_out *out;
    struct wall_set *set;
    unsigned sets;
    uint64_t run;                /* ticks */
    float *pattern_drive;
    uint64_t pattern_drawn;
    double skew_ms;              /* of the tick before; < 0: not known */
};

uint64_t wall_now_ns(void); /* CLOCK_MONOTONIC */
int wall_thread_start(struct wall *w, struct fault *f);
void wall_thread_stop(struct wall *w);

#endif
