/* SPDX-License-Identifier: Apache-2.0 */
/*
 * walls.h - the walls that a daemon has open, by name: who opened them, whose frames they show, and what a frame for them needs to
 * know of them.
 *
 * Threads: the socket thread opens, finds and closes; jobs hold references, which any thread may give back. The last
 * reference's release only leaves the wall to the closing thread here: black and good-bye to the boards may take a second.
 */
#ifndef AIRYD_WALLS_H
#define AIRYD_WALLS_H

#include <pthread.h>
#include <sys/queue.h>

#include "asset.h"
#include "params.h"
#include "wall.h"

enum { WALLS_MAX = 4 };

struct walls;

struct wall_need { /* of a kind of frame: which part of it the wall's light comes from */
    bool known;
    uint32_t width, height, display_width;
    unsigned channels;
    float pixel_aspect;
    struct params params;
    double x, y;     /* of bloom_wall */
    int32_t part[4]; /* x0, y0, x1, y1 */
};

struct wall_ref {
    struct walls *walls;
    struct wall *wall;
    const struct wall_def *def;
    const struct wall_layout *layout;
    struct asset *gains;         /* NULL: none */
    uint64_t gain_id;            /* of them; never used twice */
    /* The socket thread's. */
    const void *owner;           /* it goes with this client; NULL: it stays */
    const void *source;          /* whose frames are shown */
    uint64_t source_ns;          /* the last of them */
    const void *tester;          /* whose test pattern is shown */
    /* Of its lane's device thread: one frame after the other. */
    struct bloom_adapt adapt;
    uint64_t adapt_ns;           /* time of the frame before */
    /* Under the table's lock. */
    struct wall_need need;       /* of the last kind of frame */
    unsigned references;
    bool closing;                /* no longer found */
    TAILQ_ENTRY(wall_ref) link;
};

/* 0, or -1 and *f. */
int walls_create(struct walls **out, struct asset_cache *assets, void (*log)(const char *line), struct fault *f);
/* Closes all; every reference must have been given back. NULL is fine. */
void walls_destroy(struct walls *w);

/* A definition (text) becomes an open wall: *out is its table's, without a reference for the caller. gains: the image that the definition
 * names, or NULL; a reference of it is taken. A wall that is open by the same name is an error, as is one more than WALLS_MAX; BUSY
 * while another is being closed. */
int walls_open(struct walls *w, const char *text, size_t bytes, struct asset *gains, const void *owner,
               struct wall_ref **out, struct fault *f);
/* With a reference; NULL and *f (NO_WALL, naming those that are open). */
struct wall_ref *walls_find(struct walls *w, const char *name, struct fault *f);
void walls_release(struct wall_ref *r); /* NULL is fine */
int walls_close(struct walls *w, const char *name, struct fault *f);
/* Closes what this client has opened, ends its test patterns, and frees what shows its frames. */
void walls_client_gone(struct walls *w, const void *client);
/* May this client's frames be shown now? Frames of one client at a time: another's are let in when it has sent none for the wall's
 * hold time (at most 2 s), or has gone. 0, or -1 and *f (WALL_BUSY). */
int walls_claim(struct wall_ref *r, const void *client, struct fault *f);

/* All open ones, in the order of their opening; no references. The socket thread's, until its next call of any of these. */
unsigned walls_list(struct walls *w, struct wall_ref *out[WALLS_MAX]);
/* NULL: no USB; why says so. Made at the first call. */
struct usb *walls_usb(struct walls *w, const char **why);

/* What was noted of a frame that is the same in all but `known` and `part`: fills part. */
bool walls_need_known(struct wall_ref *r, struct wall_need *like);
void walls_need_note(struct wall_ref *r, const struct wall_need *need);

/* Where a frame lies on the wall: fills width ... pitch_y, tone map, saturation, matrix and gain of *b for a frame of this size (its display
 * window) and pixel aspect, as if it were the target. Without drive and adapt. */
void walls_geometry(const struct wall_ref *r, uint32_t width, uint32_t height, float pixel_aspect, struct bloom_wall *b);

#endif
