/* SPDX-License-Identifier: Apache-2.0 */
/*
 * raw.h - raw pictures <-> planes. A picture is a payload and a list of strided channels, which says
 * planar and interleaved alike; the result has the same layout.
 *
 * raw_check proves, in 64 bits, that every byte of every channel lies in the payload and that no two
 * channels share a byte (the result is written by several threads at once, so an overlap would make it
 * depend on their order). After it no other function here can fail or leave the payload.
 *
 * The input may be memory that its owner changes while it is read: each pixel is read once, into the
 * planes, and nothing is decided from a second look at it.
 */
#ifndef AIRYD_RAW_H
#define AIRYD_RAW_H

#include "fault.h"
#include "frame.h"

enum { RAW_CHANNELS_MAX = 32, RAW_NAME_MAX = 64 };

struct raw_channel {
    char name[RAW_NAME_MAX];
    uint64_t offset, row_stride; /* bytes */
    uint64_t pixel_stride;
};

/* The scene is bloomed and written; the others are only read, for the glow. */
enum raw_role { RAW_SCENE, RAW_SOURCE, RAW_MATTE, RAW_DEPTH, RAW_ROLES };

struct raw_target {
    enum raw_role role;
    unsigned planes;      /* 3: R G B, 1: Y, a matte, a depth */
    unsigned plane[3];    /* which channel is R, G, B (or the one) */
    enum pixel_type type; /* of its planes: the layout's; of a depth always FLOAT */
};

struct raw_layout {
    uint32_t width, height;
    enum pixel_type type;
    unsigned count;
    struct raw_channel channel[RAW_CHANNELS_MAX];
    /* What the glow needs beside R, G, B (or Y), by the channels' names; "" or NULL: nothing. The caller's, as long
     * as raw_check runs. */
    const char *source; /* channels <source>.R, .G, .B, or <source>.Y beside Y */
    const char *matte;  /* a channel */
    bool depth;         /* channel Z, when there is one */
    /* Set by raw_check: */
    unsigned targets;                    /* the scene first */
    struct raw_target target[RAW_ROLES];
    bool dense;        /* the channels fill the payload: no byte between them */
    uint32_t band;     /* rows of a task */
};

/* The target with this role, or -1. */
static inline int raw_find(const struct raw_layout *l, enum raw_role role)
{
    for (unsigned i = 0; i < l->targets; i++)
        if (l->target[i].role == role)
            return (int)i;
    return -1;
}

/* payload_bytes: of the whole picture. The caller has checked width, height and their product against
 * its limits. 0, or -1 and *f (FAULT_LAYOUT, field "raw...", or the parameter whose channels are not there). */
int raw_check(struct raw_layout *l, uint64_t payload_bytes, struct fault *f);
unsigned raw_tasks(const struct raw_layout *l);
/* One band of rows: payload -> a target's planes, scanned (scan NULL: not). */
void raw_decode(const struct raw_layout *l, const struct raw_target *t, const uint8_t *payload,
                const struct planes *in, struct frame_scan *scan, const float luma[3], unsigned task);
/* One band of rows: the scene's planes (of the layout's type, or FLOAT for a HALF layout) and the channels that
 * are no planes of `input` -> output. Returns the samples held at +-65504. Bytes between the channels
 * are not written. output == input is fine. */
uint64_t raw_encode(const struct raw_layout *l, const uint8_t *input, const struct planes *from,
                    uint8_t *output, unsigned task);

#endif
