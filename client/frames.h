/* SPDX-License-Identifier: Apache-2.0 */
/*
 * frames.h - the frame grammar of the command: file names with a frame token, and ranges of frames.
 * Pure, but for frames_scan, which reads a folder.
 *
 * Tokens: one "#" is 4 digits, a run of them as many digits as it has ("##" is 2); "@" is 1 digit each;
 * "%d",
 * "%04d"; "$F", "$F4". A number wider than its padding is written in full, a negative one with
 * its sign inside the padding, as printf does: -1 in "####" is "-001".
 * Ranges: "7", "1-10", "1-10x2", "10-1", "-5--1", and lists of these: "1,5,9-12".
 */
#ifndef AIRY_FRAMES_H
#define AIRY_FRAMES_H

#include <stddef.h>
#include <stdint.h>

enum { FRAMES_TOKENS_MAX = 8, FRAMES_MAX = 1000000, FRAMES_WHY_MAX = 384 };
#define FRAMES_NUMBER_MAX INT64_C(999999999)

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
/* The frames whose files are there, in rising order (none is not an error). 0, or -1 and why. */
int frames_scan(struct frames_list *l, const struct frames_pattern *p, char *why);
void frames_list_finish(struct frames_list *l);

#endif
