/* SPDX-License-Identifier: Apache-2.0 */
/*
 * exr_tool.h - test EXR files made, and results read back, by the OpenEXR C++ library: a writer and a
 * reader that are not ours. Plain C for the tests.
 */
#ifndef EXR_TOOL_H
#define EXR_TOOL_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum exr_tool_layout {
    EXR_TOOL_RGBA,   /* A B G R Z(float) id(uint) diffuse.B/G/R */
    EXR_TOOL_Y,      /* Y, A */
    EXR_TOOL_YC,     /* Y, RY, BY (2x2), scanline only */
    EXR_TOOL_STEREO, /* multiView left right: A B G R, right.A/B/G/R, diffuse.right.B/G/R */
    EXR_TOOL_G,      /* G alone */
    EXR_TOOL_UINT,   /* R G B, all UINT */
    EXR_TOOL_EYES,   /* multiView left right: R G B Z matte, right. the same; glow. R G B, glow.right. R G B;
                        shared. R G B, hold.A; id.m(uint), id. R G B (uint) */
    EXR_TOOL_CROWD,  /* multiView v0 .. v5, each R G B Z */
    EXR_TOOL_SMALL,  /* R G B, small (2x2), scanline only */
    EXR_TOOL_YCGLOW, /* as EXR_TOOL_YC, and glow. Y RY BY likewise */
};

struct exr_tool_spec {
    enum exr_tool_layout layout;
    int compression;        /* the format's number */
    int type;               /* of the colour channels: 1 half, 2 float, 3: R and B half, G float */
    int tiled;              /* 0 scanline, 1 one level, 2 mip, 3 rip */
    int tile_width, tile_height, round_up;
    int line_order;
    int min_x, min_y, width, height;
    int parts;              /* 1: single-part file; 2: stereo parts + depth part; 3: and a deep part */
    int specials;           /* NaN, Inf, -0, negatives, subnormals among the samples */
    int aov;                /* 1, of files of several parts: one more part "emission" of the same window and no view,
                               scanlines, ZIPS: R G B and mask.A */
    float dwa_level;        /* 0: no attribute */
};

/* *bytes: malloc'd. 0, or -1 (the reason on stderr). */
int exr_tool_make(const struct exr_tool_spec *spec, uint8_t **bytes, size_t *size);

struct exr_tool_diff {
    unsigned part, level_x, level_y;
    char channel[64];
    uint64_t samples, differing;
    int type_a, type_b;
};

/* Compares all pixels of all flat parts bit for bit, samples of other types as floats: one entry per
 * channel and level that differs. Number of entries, or -1. Headers: text gets one line per difference. */
int exr_tool_compare(const uint8_t *a, size_t a_size, const uint8_t *b, size_t b_size,
                     struct exr_tool_diff *diff, int room, char *text, size_t text_size);

/* One channel as the bits of its own type. *bits: malloc'd, w * h of them (subsampled size). */
int exr_tool_channel(const uint8_t *bytes, size_t size, unsigned part, const char *channel,
                     unsigned level_x, unsigned level_y, uint32_t **bits, unsigned *w, unsigned *h);

/* The differences of all headers alone, as exr_tool_compare tells them. 0 or -1. */
int exr_tool_headers(const uint8_t *a, size_t a_size, const uint8_t *b, size_t b_size, char *text,
                     size_t text_size);
/* A part's data window. 0 or -1. */
int exr_tool_window(const uint8_t *bytes, size_t size, unsigned part, int *min_x, int *min_y, int *w, int *h);

/* The library's own RGB of a layer ("": unprefixed), also of luminance-chroma. *rgb: malloc'd, 3 * w * h. */
int exr_tool_rgb(const uint8_t *bytes, size_t size, const char *layer, float **rgb, unsigned *w, unsigned *h);

#ifdef __cplusplus
}
#endif

#endif
