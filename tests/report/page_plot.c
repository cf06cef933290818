// SPDX-License-Identifier: Apache-2.0
// page_plot.c - plots as SVG that stands alone: colours and sizes are attributes, so that the same text is a figure of the
// page and a file for the README.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "page.h"

enum { WIDTH = 860, HEIGHT = 420, LEFT = 70, RIGHT = 610, TOP = 34, BOTTOM = 370, TICKS_MAX = 40 };

static const char *const COLOUR[] = { "#0a7d4f", "#1f5fbf", "#c2410c", "#b8860b", "#7c3aed", "#be185d",
                                      "#0e7490", "#6b7280", "#111827", "#65a30d", "#dc2626", "#854d0e" };
enum { COLOURS = sizeof COLOUR / sizeof COLOUR[0] };

struct axis {
    double low, high; /* of the values, or of their log10 */
    bool log;
    unsigned n;
    double tick[TICKS_MAX]; /* values */
};

void plot_init(struct plot *p, const char *id, bool log_x, bool log_y, const char *x_name, const char *y_name)
{
    *p = (struct plot){ .id = id, .x_name = x_name, .y_name = y_name, .log_x = log_x, .log_y = log_y };
    p->series = page_take(SERIES_MAX, sizeof(*p->series));
}

void plot_finish(struct plot *p) { free(p->series); }

struct series *plot_series(struct plot *p, const char *name, bool line)
{
    unsigned i = 0;
    while (i < p->n && strcmp(p->series[i].name, name))
        i++;
    if (i == SERIES_MAX)
        page_die("plot %s: more than %d series", p->id, SERIES_MAX);
    if (i == p->n) {
        p->n++;
        p->series[i].line = line;
        snprintf(p->series[i].name, sizeof p->series[i].name, "%s", name);
    }
    return &p->series[i];
}

void plot_point(struct plot *p, struct series *s, double x, double y, const char *tip)
{
    if (s->n == POINTS_MAX)
        page_die("plot %s, %s: more than %d points", p->id, s->name, POINTS_MAX);
    if (!isfinite(x) || !isfinite(y) || (p->log_x && x <= 0) || (p->log_y && y <= 0))
        page_die("plot %s, %s: %g, %g cannot be shown", p->id, s->name, x, y);
    s->x[s->n] = x;
    s->y[s->n] = y;
    snprintf(s->tip[s->n++], sizeof s->tip[0], "%s", tip);
}

/* ---- axes ------------------------------------------------------------------------------------------------------- */

static double scaled(const struct axis *a, double v) { return ((a->log ? log10(v) : v) - a->low) / (a->high - a->low); }

static void ticks_log(struct axis *a)
{
    static const double steps[] = { 1, 2, 5 };
    bool fine = a->high - a->low < 2.5;
    for (int e = (int)floor(a->low); e <= (int)ceil(a->high); e++)
        for (unsigned i = 0; i < (fine ? 3 : 1); i++) {
            double v = steps[i] * pow(10, e);
            if (log10(v) >= a->low - 1e-9 && log10(v) <= a->high + 1e-9 && a->n < TICKS_MAX)
                a->tick[a->n++] = v;
        }
}

static void ticks_even(struct axis *a)
{
    double step = pow(10, floor(log10((a->high - a->low) / 4)));
    if ((a->high - a->low) / step > 10)
        step *= (a->high - a->low) / step > 20 ? 5 : 2;
    for (double v = ceil(a->low / step) * step; v <= a->high + 1e-9 * step && a->n < TICKS_MAX; v += step)
        a->tick[a->n++] = fabs(v) < step * 1e-6 ? 0 : v;
}

static struct axis axis_of(const struct plot *p, bool x)
{
    struct axis a = { .low = INFINITY, .high = -INFINITY, .log = x ? p->log_x : p->log_y };
    for (unsigned i = 0; i < p->n; i++)
        for (unsigned k = 0; k < p->series[i].n; k++) {
            double v = x ? p->series[i].x[k] : p->series[i].y[k];
            v = a.log ? log10(v) : v;
            a.low = fmin(a.low, v);
            a.high = fmax(a.high, v);
        }
    double margin = a.high > a.low ? .04 * (a.high - a.low) : fmax(.1 * fabs(a.high), a.log ? .3 : 1e-3);
    a.low -= margin;
    a.high += margin;
    (a.log ? ticks_log : ticks_even)(&a);
    return a;
}

static double at_x(const struct axis *a, double v) { return LEFT + scaled(a, v) * (RIGHT - LEFT); }
static double at_y(const struct axis *a, double v) { return BOTTOM - scaled(a, v) * (BOTTOM - TOP); }

static void write_axes(FILE *to, const struct plot *p, const struct axis *x, const struct axis *y)
{
    for (unsigned i = 0; i < x->n; i++)
        fprintf(to,
                "<line x1=\"%.1f\" x2=\"%.1f\" y1=\"%d\" y2=\"%d\" stroke=\"#e2e2e2\"/>"
                "<text x=\"%.1f\" y=\"%d\" text-anchor=\"middle\">%g</text>\n",
                at_x(x, x->tick[i]), at_x(x, x->tick[i]), TOP, BOTTOM, at_x(x, x->tick[i]), BOTTOM + 17, x->tick[i]);
    for (unsigned i = 0; i < y->n; i++)
        fprintf(to,
                "<line x1=\"%d\" x2=\"%d\" y1=\"%.1f\" y2=\"%.1f\" stroke=\"#e2e2e2\"/>"
                "<text x=\"%d\" y=\"%.1f\" text-anchor=\"end\">%.6g</text>\n",
                LEFT, RIGHT, at_y(y, y->tick[i]), at_y(y, y->tick[i]), LEFT - 7, at_y(y, y->tick[i]) + 4, y->tick[i]);
    fprintf(to, "<text x=\"%d\" y=\"%d\" text-anchor=\"middle\">", (LEFT + RIGHT) / 2, BOTTOM + 38);
    html_text(to, p->x_name);
    fprintf(to, "</text><text transform=\"translate(16 %d) rotate(-90)\" text-anchor=\"middle\">", (TOP + BOTTOM) / 2);
    html_text(to, p->y_name);
    fputs("</text>\n", to);
}

static void write_series(FILE *to, const struct plot *p, unsigned i, const struct axis *x, const struct axis *y)
{
    const struct series *s = &p->series[i];
    const char *colour = COLOUR[i % COLOURS];
    bool dense = s->n > 20;
    fprintf(to, "<g class=\"series\" data-series=\"%u\">\n", i);
    if (s->line && s->n > 1) {
        fprintf(to, "<polyline fill=\"none\" stroke=\"%s\" stroke-width=\"1.6\"%s points=\"", colour,
                i >= COLOURS ? " stroke-dasharray=\"4 3\"" : "");
        for (unsigned k = 0; k < s->n; k++)
            fprintf(to, "%.1f,%.1f ", at_x(x, s->x[k]), at_y(y, s->y[k]));
        fputs("\"/>\n", to);
    }
    for (unsigned k = 0; k < s->n; k++) {
        fprintf(to, "<circle class=\"pt %s\" cx=\"%.1f\" cy=\"%.1f\" r=\"%s\" fill=\"%s\"><title>", p->id,
                at_x(x, s->x[k]), at_y(y, s->y[k]), dense ? "1.3" : s->line ? "4" : "5.5", colour);
        html_text(to, s->tip[k]);
        fputs("</title></circle>\n", to);
    }
    fprintf(to, "</g>\n<g class=\"key\" data-series=\"%u\"><circle cx=\"%d\" cy=\"%u\" r=\"5\" fill=\"%s\"/>"
                "<text x=\"%d\" y=\"%u\">", i, RIGHT + 22, TOP + 8 + 19 * i, colour, RIGHT + 34, TOP + 12 + 19 * i);
    html_text(to, s->name);
    fputs("</text></g>\n", to);
}

void plot_write(FILE *to, const struct plot *p)
{
    unsigned points = 0;
    for (unsigned i = 0; i < p->n; i++)
        points += p->series[i].n;
    if (!points)
        return;
    struct axis x = axis_of(p, true), y = axis_of(p, false);
    fprintf(to, "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %d %d\" font-family=\"sans-serif\" "
                "font-size=\"12\" fill=\"#333\" class=\"plot\" role=\"img\">\n"
                "<rect width=\"%d\" height=\"%d\" fill=\"white\"/>\n<text x=\"%d\" y=\"20\" font-size=\"14\">",
            WIDTH, HEIGHT, WIDTH, HEIGHT, LEFT);
    html_text(to, p->title);
    fputs("</text>\n", to);
    write_axes(to, p, &x, &y);
    for (unsigned i = 0; i < p->n; i++)
        write_series(to, p, i, &x, &y);
    fputs("</svg>\n", to);
}
