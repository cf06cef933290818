/* SPDX-License-Identifier: Apache-2.0 */
/*
 * page.h - the parts of report_page: CSV files in, one page out that opens from disk and needs nothing beside it. Whatever
 * text is in a file is escaped on its way out.
 */
#ifndef AIRY_REPORT_PAGE_H
#define AIRY_REPORT_PAGE_H

#include <stdbool.h>
#include <stdio.h>

void page_die(const char *format, ...) __attribute__((format(printf, 1, 2), noreturn));
void *page_take(size_t count, size_t bytes);

/* ---- CSV -------------------------------------------------------------------------------------------------------- */

struct csv {
    unsigned columns, rows; /* rows beside the header */
    char **cell;            /* [(1 + rows) * columns], into text; the header first */
    char *text;
};
/* False: there is no such file. A file that is no CSV (a row of other length) ends the program. */
bool csv_read(struct csv *c, const char *dir, const char *name);
void csv_finish(struct csv *c);
const char *csv_cell(const struct csv *c, unsigned row, const char *column); /* "" when there is no such column */
double csv_number(const struct csv *c, unsigned row, const char *column);    /* NaN when it is none */

void html_text(FILE *to, const char *s);
/* All of it, as an HTML table; folded: behind a line to click. */
void csv_table(FILE *to, const struct csv *c, const char *name, bool folded);

/* ---- plots ------------------------------------------------------------------------------------------------------ */

enum { SERIES_MAX = 24, POINTS_MAX = 512 };

struct series {
    char name[96];
    bool line;
    unsigned n;
    double x[POINTS_MAX], y[POINTS_MAX];
    char tip[POINTS_MAX][160];
};

struct plot {
    const char *id;    /* class of its points, for the page's check */
    char title[128];
    const char *x_name, *y_name;
    bool log_x, log_y;
    unsigned n;
    struct series *series; /* [SERIES_MAX], owned */
};

void plot_init(struct plot *p, const char *id, bool log_x, bool log_y, const char *x_name, const char *y_name);
void plot_finish(struct plot *p);
struct series *plot_series(struct plot *p, const char *name, bool line); /* finds or adds */
/* A value that is no number, or <= 0 on a logarithmic axis, ends the program: the page shows every row or none. */
void plot_point(struct plot *p, struct series *s, double x, double y, const char *tip);
void plot_write(FILE *to, const struct plot *p);

/* ---- sections ---------------------------------------------------------------------------------------------------- */

void section_speed(FILE *to, const char *dir);
void section_figure(const char *dir, const char *path); /* the README's: speed at 1080p */
void section_peers(FILE *to, const char *dir);
void section_hard(FILE *to, const char *dir);
void section_shimmer(FILE *to, const char *dir);
void section_pictures(FILE *to, const char *dir);
void section_cost(FILE *to, const char *dir);
void section_frames(FILE *to, const char *dir);
void section_machine(FILE *to, const char *dir);

#endif
