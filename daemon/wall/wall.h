/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wall.h - one open wall: its definition, the pictures that wait for their tick, the thread that paces it, its boards.
 *
 * The pacer runs on an absolute clock (CLOCK_MONOTONIC), tick k at start + k / rate, and sends at every tick, new picture or
 * not. At a tick it takes the newest picture whose time has come; older ones are dropped and counted. With no new picture
 * it holds the last one for hold_s (at least two periods and 100 ms, or a slow source would flicker), fades it to black over
 * fade_s (linear light), and stays black, still sending. A tick that is late by more than a period is left out and counted,
 * never made up for. A picture up to 1 s older than the one shown is late and dropped; older still it is another source's.
 * A board with a delay is sent the bytes of each tick that much after the tick's time.
 *
 * Threads: wall_show, wall_pattern, wall_stats and wall_preview may be called from any thread and never wait for a board or for a
 * tick. wall_create and wall_destroy belong to one thread.
 */
#ifndef AIRYD_WALL_H
#define AIRYD_WALL_H

#include "usb.h"
#include "wall_colour.h"

struct wall;

/* Takes def over on success. usb NULL: no boards are driven (previews and statistics work). Boards that are not there are
 * waited for. 0, or -1 and *f (FAULT_WALL: a board is another wall's; NO_MEMORY). */
int wall_create(struct wall **out, struct wall_def *def, struct usb *usb, void (*log)(const char *line), struct fault *f);
/* Sends black to every board, waits for it (at most 1 s), closes. NULL is fine. */
void wall_destroy(struct wall *w);
const struct wall_def *wall_definition(const struct wall *w);
const struct wall_layout *wall_layout(const struct wall *w);

enum { WALL_WAITING_MAX = 16 }; /* pictures with a later time; beyond it the oldest goes */
/* A picture: drive [height][width][3], copied. present_ns 0: at the next tick. Without memory for it it is dropped and counted. */
void wall_show(struct wall *w, const float *drive, uint64_t present_ns, double exposure);

enum wall_pattern_kind { PATTERN_NONE, PATTERN_ORDER, PATTERN_PANELS, PATTERN_RED, PATTERN_GREEN, PATTERN_BLUE, PATTERN_WHITE,
                         PATTERN_RAMP, PATTERN_CHECKER, PATTERN_LED, PATTERN_BLACK };
struct wall_pattern { enum wall_pattern_kind kind; unsigned board; uint32_t led; double level; };
/* "order" ...; false: no such word. */
bool wall_pattern_read(enum wall_pattern_kind *out, const char *word);
/* Linear drive of a pattern, past matrix and calibration, through everything else. order: each board's LEDs light up one
 * after the other in the order of the board, all boards at once, the ones before stay dim (seconds since the start move it); panels: an
 * edge of each panel with its corner marked red (origin), rest dim by panel; ramp: each panel 0..1 left to right as it hangs, in white
 * then R, G, B by quarter rows; checker: 1 x 1 wall pixels. level 0: 0.25; ramp has its own. drive: [height][width][3], NULL: only
 * look whether it can be drawn. 0, or -1 and *f (PARAM_RANGE: no such LED). */
int wall_pattern_draw(float *drive, const struct wall_def *d, const struct wall_layout *l, const struct wall_pattern *p,
                      double seconds, struct fault *f);
/* Shows a pattern in place of pictures; PATTERN_NONE: pictures again. 0, or -1 and *f. */
int wall_pattern(struct wall *w, const struct wall_pattern *p, struct fault *f);

enum wall_source { WALL_NONE, WALL_LIVE, WALL_HELD, WALL_FADING, WALL_BLACK, WALL_PATTERN };
struct wall_times { double p50, p99, max; }; /* ms */
struct wall_stats {
    enum wall_source source;       /* none: nothing ever came; held: no new picture for more than two ticks and 100 ms */
    double fps, pictures_per_s;    /* of the last second */
    uint64_t ticks, ticks_missed, pictures, shown, dropped; /* as of the last tick; while a pattern is on pictures are dropped */
    struct wall_times late, skew;  /* of the last 4096 ticks; skew: between the boards' last transfers of a tick, less their delays */
    double exposure;
    bool realtime;
};
void wall_stats(struct wall *w, struct wall_stats *out);
void wall_board_stats(struct wall *w, unsigned board, struct usb_stats *out, struct wall_times *latency, struct wall_power *power);
struct wall_power wall_supply_power(struct wall *w, unsigned supply);
/* What was sent last, undone: board bytes -> light -> sRGB, on the wall's pixels; pixels without LEDs 0. width * height * 3. */
void wall_preview(struct wall *w, uint8_t *rgb);
const char *wall_source_name(enum wall_source s);

#endif
