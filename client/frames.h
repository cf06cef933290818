/* SPDX-License-Identifier: Apache-2.0 */
/*
 * frames.h - the frame grammar of the command: file names with a frame token, and ranges of frames.
 * Pure, but for frames_scan, which reads a folder.
 *
 * Tokens: one "#" is 4 digits, a run of them as many digits as it has ("##" is 2); "@" is 1 digit each;
 * "%d", "%04d"; "$F", "$F4". A number wider than its padding is written in full, a negative one with
 * its sign inside the padding, as printf does: -1 in "####" is "-001".
 * Ranges: "7", "1-10", "1-10x2", "10-1", "-5--1", and lists of these: "1,5,9-12".
 *
 * Subframes: "1.5", "1-2x0.25", at most 6 decimals. In a name the padding is the whole part's, and the decimals follow it
 * as they are, without zeros at the end: 1.5 in "img.####.exr" is "img.0001.5.exr", 1 is "img.0001.exr" (what
 * padzero(4,$FF) makes). Numbers are counted in millionths, so that steps add up exactly.
 */
#ifndef AIRY_FRAMES_H
#define AIRY_FRAMES_H

#include <stddef.h>
#include <stdint.h>

enum { FRAMES_TOKENS_MAX = 8, FRAMES_MAX = 1000000, FRAMES_WHY_MAX = 384 };
#define FRAMES_ONE INT64_C(1000000) /* frame 1; every frame number below is in this unit */
#define FRAMES_NUMBER_MAX (INT64_C(999999999) * FRAMES_ONE)

struct frames_token {
    size_t begin, end; /* in the text */
    unsigned width;    /* digits, at least 1 */
};

struct frames_pattern {
    char *text; /* owned */
    unsigned n_tokens;
    struct frames_token token[FRAMES_TOKENS_MAX];
};

/* 0, or -1 and why (FRAMES_WHY_MAX bytes). A text without tokens is a pattern, too. */
int frames_pattern_init(struct frames_pattern *p, const char *text, char *why);
void frames_pattern_finish(struct frames_pattern *p);
/* The file name of a frame, the caller's to free; NULL: no memory. */
char *frames_name(const struct frames_pattern *p, int64_t frame);

struct frames_list {
    int64_t *frame; /* owned; no number twice */
    size_t count;
};

/* Reads a range, in the order it says. 0, or -1 and why. */
int frames_parse(struct frames_list *l, const char *text, char *why);
/* One number, with a sign before it or none. 0, or -1 and why. */
int frames_parse_offset(int64_t *offset, const char *text, char *why);
/* Adds to every number. 0, or -1 and why: one would be beyond what a number may be. */
int frames_shift(struct frames_list *l, int64_t offset, char *why);
/* The frames whose files are there, in rising order (none is not an error). 0, or -1 and why. */
int frames_scan(struct frames_list *l, const struct frames_pattern *p, char *why);
void frames_list_finish(struct frames_list *l);

#endif
