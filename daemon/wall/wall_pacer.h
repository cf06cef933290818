/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wall_pacer.h - which tick it is, and what it shows: the pacer's decisions without its thread, clock and pictures. Every
 * function takes the time as an argument, so that hours can be tested in a second. One thread at a time (wall.c's lock).
 *
 * Pictures are slots, numbers 0..PACER_SLOTS - 1 whose memory is wall.c's. Invariant: a slot is free, or with a writer
 * (pacer_take to pacer_push or pacer_give), or waiting, or the current one; pictures == shown + dropped + waiting.
 */
#ifndef AIRYD_WALL_PACER_H
#define AIRYD_WALL_PACER_H

#include "wall.h"

/* One that is due, those with a later time, the current one, one with a writer. */
enum { PACER_QUEUE = 1 + WALL_WAITING_MAX, PACER_SLOTS = PACER_QUEUE + 2 };

struct pacer_picture {
    int slot;
    bool soon;         /* for the next tick, whenever that is */
    uint64_t time_ns;  /* present_ns, or when it came */
    uint64_t number;   /* of pictures, in the order they came */
    double exposure;
};

struct pacer {
    uint64_t start_ns;
    double rate;
    uint64_t live_ns, hold_ns, fade_ns;
    uint64_t next;             /* tick to run */
    bool pattern;
    bool started;              /* there is a current picture */
    struct pacer_picture current;
    uint64_t current_ns;       /* when it was first shown */
    unsigned waiting;
    struct pacer_picture queue[PACER_QUEUE]; /* in the order of time_ns, then of number */
    uint32_t free;             /* a bit a slot */
    uint64_t ticks, ticks_missed, pictures, shown, dropped;
};

struct pacer_tick {
    uint64_t tick, time_ns;    /* its number, and when it was to be */
    enum wall_source source;
    int slot;                  /* to show; -1: black, or the pattern */
    double fade;               /* linear light */
    double exposure;
};

/* A picture is live for two periods and at least 100 ms; a shorter hold_s means that, for a source slower than the wall is not
 * lost between its pictures. */
void pacer_init(struct pacer *p, uint64_t start_ns, double rate, double hold_s, double fade_s);
uint64_t pacer_time_ns(const struct pacer *p, uint64_t tick); /* start + tick / rate, to the nanosecond */

int pacer_take(struct pacer *p);            /* a slot to write into; -1: none */
void pacer_give(struct pacer *p, int slot); /* back, unwritten: its picture counts as dropped */
/* Pictures that this one makes pointless are dropped at once: those due that are older, and beyond WALL_WAITING_MAX with a
 * later time the oldest of them. */
void pacer_push(struct pacer *p, int slot, uint64_t now_ns, uint64_t present_ns, double exposure);

/* The tick that is to run at now_ns, not before the next tick's time: false, it is too early. Ticks late by more than a
 * period are left out and counted. Of the pictures whose time is not after the tick's, the newest becomes the current one, unless
 * it is a straggler: up to 1 s older than the current one. (Older still is another source's clock, not a late picture.) While a
 * pattern is shown pictures are taken as always, but count as dropped. */
bool pacer_run(struct pacer *p, uint64_t now_ns, struct pacer_tick *out);

#endif
