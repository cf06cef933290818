/* SPDX-License-Identifier: Apache-2.0 */
/*
 * progress.h - what the command says on stderr while it works: on a terminal one line that is drawn
 * over, with a bar, the frame rate and the time left; elsewhere plain lines. One thread.
 */
#ifndef AIRY_PROGRESS_H
#define AIRY_PROGRESS_H

#include <stdbool.h>
#include <stddef.h>

struct progress {
    bool bar;   /* draw */
    bool quiet; /* only errors */
    bool drawn; /* a bar stands on the line */
    size_t total, done, failed;
    double start_s, drawn_s;
};

/* A bar is drawn when stderr is a terminal and there are several frames. */
void progress_begin(struct progress *p, size_t total, bool quiet);
void progress_step(struct progress *p, bool failed); /* one frame more is through */
void progress_end(struct progress *p);
/* One line above the bar, without its newline in the format. progress_error also when quiet. */
void progress_line(struct progress *p, const char *format, ...) __attribute__((format(printf, 2, 3)));
void progress_error(struct progress *p, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* The bar's line, at most `columns` bytes. Pure. */
void progress_render(char *out, size_t size, unsigned columns, size_t done, size_t failed, size_t total,
                     double elapsed_s);

#endif
