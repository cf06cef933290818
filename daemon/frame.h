/* SPDX-License-Identifier: Apache-2.0 */
/*
 * frame.h - the pixels of one bloomed layer ("target"), and what a look at them tells.
 *
 * A target has 3 colour planes (R, G, B) or 1 (Y), HALF or FLOAT, of the data window's size.
 * struct planes only says where rows are: the memory belongs to whoever made it (a device slot,
 * a test). Row y of plane c is one contiguous run of pitch_bytes (>= width * bytes, the rest
 * zero); consecutive rows need not be neighbours, so always go through planes_row().
 * The only products of width, height and size in the daemon are made here.
 */
#ifndef AIRYD_FRAME_H
#define AIRYD_FRAME_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* The numbers of EXR's pixelType. */
enum pixel_type { PIXEL_TYPE_UINT = 0, PIXEL_TYPE_HALF = 1, PIXEL_TYPE_FLOAT = 2 };

static inline unsigned pixel_bytes(enum pixel_type t) { return t == PIXEL_TYPE_HALF ? 2 : 4; }

/* Relative luminance of Rec.709's R, G, B (METHODS' .2126 .7152 .0722, unrounded). One home, so that a picture blooms alike
 * to the bit raw and as EXR without chromaticities. */
extern const float frame_rec709[3];

enum { PLANES_PHASES_MAX = 4 };

struct planes {
    uint32_t width, height;
    unsigned count;          /* 1 or 3 */
    enum pixel_type type;    /* HALF or FLOAT */
    uint8_t *base[3];
    size_t pitch_bytes;      /* from a row to the next of the same phase */
    unsigned phases;         /* rows y with the same y % phases lie together; 1 = plain */
    ptrdiff_t phase_offset[PLANES_PHASES_MAX]; /* of a phase's first row, from base */
};

static inline uint8_t *planes_row(const struct planes *p, unsigned c, uint32_t y)
{
    return p->base[c] + p->phase_offset[y % p->phases] + (y / p->phases) * p->pitch_bytes;
}

/* A plain heap copy of planes: zeroed, pitch a multiple of 64 bytes. 0 or -ENOMEM / -EOVERFLOW. */
int planes_alloc(struct planes *p, uint32_t width, uint32_t height, unsigned count,
                 enum pixel_type type);
void planes_free(struct planes *p); /* only what planes_alloc made */

/* IEEE binary16 <-> binary32 for rows; to half: round to nearest even, finite values beyond 65504
 * become +-65504 and are counted in the return value, Inf and NaN stay. */
void half_to_float(float *out, const uint16_t *in, size_t n);
uint64_t float_to_half(uint16_t *out, const float *in, size_t n);

/*
 * The scan: one look at each row of a target, made by whichever thread has just decoded it, in any
 * order; all results are independent of order and thread count.
 *
 * A sample is "negative" when finite and < 0. max_luma and max_channel are over what can enter the
 * bright pass: finite samples, negatives as 0; per tile of 64 x 64 pixels, never negative, kept as
 * the bits of a float (which order like integers).
 */
enum { SCAN_TILE = 64 };

struct frame_scan {
    uint32_t tiles_x, tiles_y;
    _Atomic uint32_t *tile_luma;    /* [tiles_y][tiles_x] */
    _Atomic uint32_t *tile_channel; /* [tiles_y][tiles_x] */
    double *row_sum;                /* [height]: sum of finite samples of all channels */
    uint32_t height;
    _Atomic uint64_t nan, positive_inf, negative_inf, negative; /* samples */
    _Atomic uint64_t first_nonfinite; /* y << 34 | x << 2 | channel; UINT64_MAX when none */
};

int frame_scan_init(struct frame_scan *s, uint32_t width, uint32_t height); /* 0 or -errno */
void frame_scan_finish(struct frame_scan *s);
/* luma: weights of R, G, B (1,0,0 for one plane). Call once per row, when all its planes are in. */
void frame_scan_row(struct frame_scan *s, const struct planes *p, uint32_t y, const float luma[3]);
double frame_scan_sum(const struct frame_scan *s); /* fixed order */
float frame_scan_max_luma(const struct frame_scan *s);
float frame_scan_max_channel(const struct frame_scan *s);

#endif
