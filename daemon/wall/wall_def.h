/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wall_def.h - a wall definition (airy-wall(5)): YAML text -> checked numbers. Pure: no files but the one named, no
 * USB, no Vulkan; linked into the daemon and into `airy wall check`.
 *
 * Invariant: what wall_def_parse returns is whole and free of contradictions. Every index is in range, no LED is driven
 * twice, no board LED is fed twice; whoever uses it need not look again. Nothing that the text says is ignored: an unknown
 * key is an error. Anchors, aliases and tags of YAML are errors too.
 */
#ifndef AIRYD_WALL_DEF_H
#define AIRYD_WALL_DEF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "fault.h"

enum {
    WALL_TEXT_MAX = 60 * 1024,   /* bytes of a definition: it fits in one message */
    WALL_SIDE_MAX = 4096,        /* wall pixels, each way */
    WALL_PIXELS_MAX = 1 << 20,   /* of a wall */
    WALL_LEDS_MAX = 1 << 20,     /* of all boards, lit or not */
    WALL_PANELS_MAX = 1024,
    WALL_BOARDS_MAX = 64,
    WALL_RUNS_MAX = 8192,        /* of all boards */
    WALL_SUPPLIES_MAX = 64,
    WALL_NAME_MAX = 64,
    WALL_FAULTS_MAX = 64,        /* mistakes that are told at once */
    WALL_NOTES_MAX = 16
};

enum wall_fit { WALL_FILL, WALL_CONTAIN, WALL_STRETCH };
enum wall_tone_map { WALL_TONE_NONE, WALL_TONE_REINHARD, WALL_TONE_ACES };
enum wall_transfer { WALL_TRANSFER_GAMMA, WALL_TRANSFER_SRGB };
enum wall_dither { WALL_DITHER_TEMPORAL, WALL_DITHER_OFF };
enum wall_corner { WALL_TOP_LEFT, WALL_TOP_RIGHT, WALL_BOTTOM_LEFT, WALL_BOTTOM_RIGHT };
enum wall_board_kind { WALL_FADECANDY, WALL_GUD };
enum { WALL_BOARD_KINDS = 2 };

struct wall_panel {
    char name[WALL_NAME_MAX];
    uint32_t x, y;          /* wall pixels: top left corner of the panel as it hangs */
    uint32_t width, height; /* LEDs of the panel itself, before it is turned */
    unsigned rotate;        /* 0, 90, 180, 270 degrees clockwise, as it hangs */
    bool flip_x, flip_y;    /* mirrored left to right, top to bottom, before it is turned */
    bool serpentine;        /* every second line of its wiring (the 2nd, 4th ...) runs back */
    bool columns;           /* the wiring's lines are columns, else rows */
    enum wall_corner origin; /* where LED 0 is, on the panel itself, before flip and rotate */
    float gain[3];          /* calibration, linear, 0..1 */
    unsigned line;          /* of the definition, for messages */
};

/* LEDs first ... first + count - 1 of a panel, in its wiring's order (reversed: the last first), on LEDs at ... of a board. */
struct wall_run {
    unsigned panel, board;
    uint32_t first, count, at;
    bool reversed;
    unsigned line;
};

struct wall_supply {
    char name[WALL_NAME_MAX];
    float amps;             /* 0: unlimited */
    unsigned line;
};

struct wall_board {
    char name[WALL_NAME_MAX]; /* default: its serial */
    char serial[WALL_NAME_MAX];
    enum wall_board_kind kind;
    /* The board's LEDs, numbered row by row. Fadecandy: 64 x 8, a row a strip. GUD: the mode that the board is to be set
     * to; its LEDs are the display's pixels. */
    uint32_t width, height;
    unsigned char order[3];   /* which of R, G, B (0, 1, 2) goes first, second, third on the wire */
    float brightness;         /* 0..1, linear, times the wall's */
    int supply;               /* -1: none */
    float led_amps[3];        /* of one LED's R, G, B at full drive */
    float idle_amps;          /* of one LED at 0 */
    double delay_ms;          /* trim: its frames are sent so much later, 0..100 */
    unsigned line;
};

struct wall_def {
    char name[WALL_NAME_MAX];
    uint32_t width, height;    /* of the whole wall (canvas), pixels; a node of a split wall names only its panels.
                                  Not said: as far as the panels reach */
    double rate;               /* frames per second, 1..240 */
    double hold_s, fade_s;     /* 0..3600 each: a lost source is held, then faded; hold_s INFINITY: held forever */

    enum wall_fit fit;         /* the display window on the canvas; default fill */
    double window[4];          /* of the display window, as shares 0..1: x, y, width, height; default 0 0 1 1 */
    bool exposure_auto;
    double exposure;           /* stops; with auto: added to it */
    double adapt_up_s, adapt_down_s; /* time constants of auto */
    enum wall_tone_map tone_map;
    double saturation;         /* 0..4 */

    /* From linear Rec.709 to the LEDs' own linear R, G, B: primaries, white point and matrix of the definition in one. */
    double matrix[3][3];
    double brightness;         /* 0..1, linear */
    enum wall_transfer transfer; /* of the 8 bits that are sent */
    double gamma;
    enum wall_dither dither;

    char calibration[256];     /* an image of width x height R, G, B gains (EXR); a path relative to the definition;
                                  empty: none */
    unsigned n_panels, n_boards, n_runs, n_supplies;
    struct wall_panel *panel;  /* owned */
    struct wall_board *board;
    struct wall_run *run;      /* by board, then by at */
    struct wall_supply *supply;
};

struct wall_mistake { unsigned line, column; char text[256]; };
struct wall_mistakes {
    unsigned count;
    struct wall_mistake at[WALL_FAULTS_MAX];
    bool more;                 /* there are more mistakes than these */
    unsigned notes;            /* what is possible, but perhaps not meant; also where nothing is wrong */
    struct wall_mistake note[WALL_NOTES_MAX];
};

/* 0 and *out (wall_def_free it), or -1: with all mistakes that were found, in the order of the lines, in *m, and *f with
 * the first (FAULT_WALL, field "wall", "line 12: ...", or NO_MEMORY). m may be NULL. The text need not end in a NUL. */
int wall_def_parse(struct wall_def **out, const char *text, size_t bytes, struct wall_mistakes *m, struct fault *f);
void wall_def_free(struct wall_def *d); /* NULL is fine */

/*
 * LED k of a panel's wiring -> wall pixel; k < width * height of the panel. The wiring has lines of width LEDs (columns: of
 * height); the first line lies at the origin's edge and starts in the origin's corner; serpentine lines go there and back.
 * That gives column u and row v on the panel itself. Then flip_x: u = width - 1 - u, flip_y: v = height - 1 - v. Then,
 * clockwise, 90: (height - 1 - v, u), 180: (width - 1 - u, height - 1 - v), 270: (v, width - 1 - u). Then + (x, y).
 */
void wall_panel_led(const struct wall_panel *p, uint32_t k, uint32_t *x, uint32_t *y);
/* The size of the panel as it hangs. */
void wall_panel_size(const struct wall_panel *p, uint32_t *width, uint32_t *height);

#endif
