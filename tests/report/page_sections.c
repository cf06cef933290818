// SPDX-License-Identifier: Apache-2.0
// page_sections.c - the chapters of the page: each reads its CSV, says what it shows, and what is missing.
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "page.h"

static void heading(FILE *to, const char *id, const char *title, const char *text)
{
    fprintf(to, "<h2 id=\"%s\">%s</h2>\n<p>%s</p>\n", id, title, text);
}

// What airy_report and report.sh could not do, with their reasons.
static void notes(FILE *to, const char *dir, const char *section)
{
    struct csv c;
    if (!csv_read(&c, dir, "notes"))
        return;
    for (unsigned i = 0; i < c.rows; i++)
        if (!strcmp(csv_cell(&c, i, "section"), section)) {
            fputs("<p class=\"note\">not here: ", to);
            html_text(to, csv_cell(&c, i, "note"));
            fputs("</p>\n", to);
        }
    csv_finish(&c);
}

/* ---- speed ------------------------------------------------------------------------------------------------------ */

static bool same_plot(const struct csv *c, unsigned a, unsigned b)
{
    return !strcmp(csv_cell(c, a, "size"), csv_cell(c, b, "size")) && !strcmp(csv_cell(c, a, "psf"), csv_cell(c, b, "psf"));
}

// The engine's curves say their device only where there are several.
static bool several_devices(const struct csv *c)
{
    const char *seen = NULL;
    for (unsigned i = 0; i < c->rows; i++) {
        if (!*csv_cell(c, i, "rule"))
            continue;
        if (seen && strcmp(seen, csv_cell(c, i, "device")))
            return true;
        seen = csv_cell(c, i, "device");
    }
    return false;
}

static void speed_plot(FILE *to, const struct csv *c, unsigned first)
{
    bool several = several_devices(c);
    struct plot p;
    char name[160], tip[400];
    plot_init(&p, "speed", true, true, "worst error of a lone point, share of its peak (left is better)",
              "ms a frame, median (lower is better)");
    snprintf(p.title, sizeof p.title, "%s, %s", csv_cell(c, first, "size"), csv_cell(c, first, "psf"));
    for (unsigned i = first; i < c->rows; i++) {
        if (!same_plot(c, first, i))
            continue;
        const char *device = csv_cell(c, i, "device"), *method = csv_cell(c, i, "method");
        bool engine = *csv_cell(c, i, "rule");
        snprintf(name, sizeof name, engine && several ? "%s, %.24s" : "%s", method, device);
        snprintf(tip, sizeof tip, "%s, %s: %s ms, error %s", method, csv_cell(c, i, "setting"), csv_cell(c, i, "ms"),
                 csv_cell(c, i, "error"));
        plot_point(&p, plot_series(&p, name, engine), csv_number(c, i, "error"), csv_number(c, i, "ms"), tip);
    }
    plot_write(to, &p);
    plot_finish(&p);
}

void section_speed(FILE *to, const char *dir)
{
    struct csv c;
    heading(to, "speed", "Speed against error",
            "Bright pass, blur and sum of one RGB frame, in turns on two threads. Error: the worst difference of any pixel "
            "from the exact sampled Gaussians over their peak, for a lone bright pixel at several sub-pixel phases. J5: five "
            "Gaussians an octave apart. Half: with planes of half on both sides, whose own rounding (2.4e-4 at the peak) is "
            "counted as error. The field's methods are written in C here, with bilinear samples turned into taps on whole pixels; "
            "each has its free number set so that the variance is right. Decoding, and the scan of tiles that is part of it, are outside of every figure here.");
    notes(to, dir, "speed");
    if (!csv_read(&c, dir, "speed"))
        return;
    for (unsigned i = 0; i < c.rows; i++) {
        unsigned k = 0;
        while (k < i && !same_plot(&c, k, i))
            k++;
        if (k == i)
            speed_plot(to, &c, i);
    }
    csv_table(to, &c, "speed", true);
    csv_finish(&c);
}

// The largest J5 plot that is not doubled: 1080p where it was measured.
void section_figure(const char *dir, const char *path)
{
    struct csv c;
    unsigned found = 0;
    if (!csv_read(&c, dir, "speed") || !c.rows)
        page_die("%s/speed.csv: nothing was measured", dir);
    for (unsigned i = 0; i < c.rows; i++)
        if (!strcmp(csv_cell(&c, i, "psf"), "J5") && !same_plot(&c, found, i))
            found = i;
    FILE *to = fopen(path, "we");
    if (!to)
        page_die("%s: %s", path, strerror(errno));
    fputs("<!-- SPDX-License-Identifier: Apache-2.0; made by make report -->\n", to);
    speed_plot(to, &c, found);
    if (ferror(to) | fclose(to))
        page_die("%s: cannot be written", path);
    csv_finish(&c);
}

/* ---- tables ------------------------------------------------------------------------------------------------------ */

void section_peers(FILE *to, const char *dir)
{
    struct csv c;
    heading(to, "peers", "What a user picks today",
            "Other programs, where they are installed: the whole command, its start and its files included, blurring a 1080p "
            "frame with a lone point by sigma 20; the error is of the picture that it wrote. airyd's line is the whole "
            "command, too, with its own daemon started for it, and, warm, with one that runs.");
    notes(to, dir, "peers");
    if (csv_read(&c, dir, "peers")) {
        csv_table(to, &c, "peers", false);
        csv_finish(&c);
    }
}

void section_hard(FILE *to, const char *dir)
{
    struct csv c;
    heading(to, "hard", "Hard cases", "Each with its figure and the limit that the test holds it to.");
    notes(to, dir, "hard");
    if (csv_read(&c, dir, "hard")) {
        csv_table(to, &c, "hard", false);
        csv_finish(&c);
    }
}

void section_frames(FILE *to, const char *dir)
{
    struct csv c;
    heading(to, "frames", "Work skipped on real frames",
            "Default parameters. A tile of 64 x 64 pixels with nothing bright costs no filter; a chunk whose pixels did not "
            "change is copied compressed.");
    notes(to, dir, "frames");
    if (csv_read(&c, dir, "frames")) {
        csv_table(to, &c, "frames", false);
        csv_finish(&c);
    }
}

void section_machine(FILE *to, const char *dir)
{
    struct csv c;
    heading(to, "machine", "Machine and versions",
            "Times hold for this machine on this day; compare ratios, and only within one report.");
    if (csv_read(&c, dir, "machine")) {
        csv_table(to, &c, "machine", false);
        csv_finish(&c);
    }
}

/* ---- shimmer, cost ------------------------------------------------------------------------------------------------- */

static void shimmer_plot(FILE *to, const struct csv *c, const char *column, const char *y_name)
{
    struct plot p;
    char name[200], tip[300];
    plot_init(&p, column, false, false, "place of the source, pixels", y_name);
    snprintf(p.title, sizeof p.title, "%s of a one-pixel source that slides by 1/8 px, sigma 20", column);
    for (unsigned i = 0; i < c->rows; i++) {
        snprintf(name, sizeof name, "%s %s", csv_cell(c, i, "method"), csv_cell(c, i, "setting"));
        snprintf(tip, sizeof tip, "%s: x %s, %s %s", name, csv_cell(c, i, "x_px"), column, csv_cell(c, i, column));
        plot_point(&p, plot_series(&p, name, true), csv_number(c, i, "x_px"), csv_number(c, i, column), tip);
    }
    plot_write(to, &p);
    plot_finish(&p);
}

// The range of each curve, which is what the eye sees as shimmer.
static void shimmer_ranges(FILE *to, const struct csv *c)
{
    fputs("<table><tr><th>method</th><th>setting</th><th>peak, least</th><th>most</th><th>energy, least</th>"
          "<th>most</th></tr>\n", to);
    for (unsigned i = 0; i < c->rows;) {
        double low[2] = { INFINITY, INFINITY }, high[2] = { -INFINITY, -INFINITY };
        unsigned first = i;
        for (; i < c->rows && !strcmp(csv_cell(c, i, "method"), csv_cell(c, first, "method")) &&
               !strcmp(csv_cell(c, i, "setting"), csv_cell(c, first, "setting")); i++)
            for (unsigned k = 0; k < 2; k++) {
                low[k] = fmin(low[k], csv_number(c, i, k ? "energy" : "peak"));
                high[k] = fmax(high[k], csv_number(c, i, k ? "energy" : "peak"));
            }
        fputs("<tr><td>", to);
        html_text(to, csv_cell(c, first, "method"));
        fputs("</td><td>", to);
        html_text(to, csv_cell(c, first, "setting"));
        fprintf(to, "</td><td class=\"n\">%.6f</td><td class=\"n\">%.6f</td><td class=\"n\">%.6f</td>"
                    "<td class=\"n\">%.6f</td></tr>\n", low[0], high[0], low[1], high[1]);
    }
    fputs("</table>\n", to);
}

void section_shimmer(FILE *to, const char *dir)
{
    struct csv c;
    heading(to, "shimmer", "Shimmer",
            "A source of one pixel moves by an eighth of a pixel at a time. Peak and energy of its glow over those of the exact "
            "one: a level line is what a still eye wants.");
    notes(to, dir, "shimmer");
    if (!csv_read(&c, dir, "shimmer"))
        return;
    shimmer_plot(to, &c, "peak", "peak, of the exact one");
    shimmer_plot(to, &c, "energy", "energy, of the exact one");
    shimmer_ranges(to, &c);
    csv_table(to, &c, "shimmer", true);
    csv_finish(&c);
}

void section_cost(FILE *to, const char *dir)
{
    struct csv c;
    struct plot p;
    heading(to, "cost", "Cost against size, and against what glows",
            "The engine alone, J5 at tolerance 1e-3, planes of half on both sides.");
    notes(to, dir, "size");
    if (csv_read(&c, dir, "size")) {
        plot_init(&p, "size", true, true, "side of a square frame, pixels", "ms a frame, median");
        snprintf(p.title, sizeof p.title, "cost against size");
        for (unsigned i = 0; i < c.rows; i++)
            plot_point(&p, plot_series(&p, csv_cell(&c, i, "device"), true), csv_number(&c, i, "side"),
                       csv_number(&c, i, "ms"), csv_cell(&c, i, "ns_per_pixel"));
        plot_write(to, &p);
        plot_finish(&p);
        csv_table(to, &c, "size", true);
        csv_finish(&c);
    }
    if (csv_read(&c, dir, "tiles")) {
        plot_init(&p, "tiles", false, false, "tiles that glow, %", "ms a frame, median");
        snprintf(p.title, sizeof p.title, "cost against the share of bright tiles, 1080p");
        for (unsigned i = 0; i < c.rows; i++)
            plot_point(&p, plot_series(&p, csv_cell(&c, i, "pattern"), true), csv_number(&c, i, "percent"),
                       csv_number(&c, i, "ms"), csv_cell(&c, i, "ms"));
        plot_write(to, &p);
        plot_finish(&p);
        csv_table(to, &c, "tiles", true);
        csv_finish(&c);
    }
}

/* ---- pictures ----------------------------------------------------------------------------------------------------- */

static void base64(FILE *to, FILE *from)
{
    static const char digit[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    unsigned char b[3];
    for (size_t n; (n = fread(b, 1, 3, from)) > 0;) {
        unsigned long v = (unsigned long)b[0] << 16 | (n > 1 ? (unsigned long)b[1] << 8 : 0) | (n > 2 ? b[2] : 0);
        char out[4] = { digit[v >> 18], digit[v >> 12 & 63], n > 1 ? digit[v >> 6 & 63] : '=', n > 2 ? digit[v & 63] : '=' };
        fwrite(out, 1, 4, to);
    }
}

void section_pictures(FILE *to, const char *dir)
{
    struct csv c;
    heading(to, "pictures", "Before and after",
            "One rendered street, left as rendered, right bloomed; exposure, tone curve and encoding are the same for all.");
    notes(to, dir, "pictures");
    if (!csv_read(&c, dir, "pictures"))
        return;
    for (unsigned i = 0; i < c.rows; i++) {
        char path[1024];
        snprintf(path, sizeof path, "%s/%s", dir, csv_cell(&c, i, "file"));
        FILE *from = fopen(path, "re");
        if (!from)
            page_die("%s: %s", path, strerror(errno));
        fputs("<figure><img alt=\"", to);
        html_text(to, csv_cell(&c, i, "look"));
        fputs("\" src=\"data:image/png;base64,", to);
        base64(to, from);
        fputs("\"><figcaption>", to);
        html_text(to, csv_cell(&c, i, "look"));
        fputs("</figcaption></figure>\n", to);
        fclose(from);
    }
    csv_finish(&c);
}
