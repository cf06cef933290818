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

struct raw_layout {
    uint32_t width, height;
    enum pixel_type type;
    unsigned count;
    struct raw_channel channel[RAW_CHANNELS_MAX];
    /* Set by raw_check: */
    unsigned planes;   /* 3: R G B, 1: Y */
    unsigned plane[3]; /* which channel is R, G, B (or Y) */
    bool dense;        /* the channels fill the payload: no byte between them */
    uint32_t band;     /* rows of a task */
};

/* payload_bytes: of the whole picture. The caller has checked width, height and their product against
 * its limits. 0, or -1 and *f (FAULT_LAYOUT, field "raw..."). */
int raw_check(struct raw_layout *l, uint64_t payload_bytes, struct fault *f);
unsigned raw_tasks(const struct raw_layout *l);
/* One band of rows: payload -> planes, scanned. */
void raw_decode(const struct raw_layout *l, const uint8_t *payload, const struct planes *in,
                struct frame_scan *scan, const float luma[3], unsigned task);
/* One band of rows: planes (of the layout's type, or FLOAT for a HALF layout) and the channels that
 * are no planes of `input` -> output. Returns the samples held at +-65504. Bytes between the channels
 * are not written. output == input is fine. */
uint64_t raw_encode(const struct raw_layout *l, const uint8_t *input, const struct planes *from,
                    uint8_t *output, unsigned task);

#endif
