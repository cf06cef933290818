/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_wall_clock.h - which frame of a sequence is to be sent when. Pure.
 *
 * Frame k is due at start + k / fps, reckoned from the start each time, so that nothing adds up. It is sent at most `ahead` before that,
 * and not at all when its time has passed: it is counted as skipped, and the sequence stays in time.
 */
#ifndef AIRY_CMD_WALL_CLOCK_H
#define AIRY_CMD_WALL_CLOCK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { PLAY_IN_FLIGHT = 4 };

struct play_clock {
    uint64_t start_ns, ahead_ns; /* CLOCK_MONOTONIC */
    double fps;
    uint64_t next;               /* the next frame, counted through all rounds */
    size_t count;                /* frames of one round, at least 1 */
    bool loop;
    uint64_t skipped;
};

enum play_step { PLAY_SEND, PLAY_WAIT, PLAY_OVER };

/* As far ahead as PLAY_IN_FLIGHT frames, but at most half a second. */
uint64_t play_ahead_ns(double fps);
/* Frame `next` is due in ahead_ns from now. */
void play_start(struct play_clock *c, uint64_t now_ns);
uint64_t play_due_ns(const struct play_clock *c, uint64_t k);
/* PLAY_SEND: *k is to be sent now. PLAY_WAIT: look again at *until_ns, or (UINT64_MAX) when something
 * has ended. PLAY_OVER: there are no more. */
enum play_step play_next(struct play_clock *c, uint64_t now_ns, unsigned in_flight, uint64_t *k, uint64_t *until_ns);

#endif
