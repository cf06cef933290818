// SPDX-License-Identifier: Apache-2.0
/*
 * report_page.c - report_page DIR: makes DIR/index.html and DIR/speed.svg of the CSV files that are in DIR. The plots are in the
 * page as SVG, made here: the script only hides and shows a curve.
 */
#include "page.h"

#include <errno.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

void page_die(const char *format, ...)
{
    va_list ap;
    va_start(ap, format);
    fputs("report_page: ", stderr);
    vfprintf(stderr, format, ap);
    fputc('\n', stderr);
    va_end(ap);
    exit(EXIT_FAILURE);
}

void *page_take(size_t count, size_t bytes)
{
    void *p = calloc(count, bytes);
    if (!p)
        page_die("no memory for %zu times %zu bytes", count, bytes);
    return p;
}

static const char head[] =
    "<!DOCTYPE html>\n<!-- SPDX-License-Identifier: Apache-2.0; made by make report -->\n"
    "<html lang=\"en\"><head><meta charset=\"utf-8\"><title>airyd: report</title>\n"
    "<meta name=\"viewport\" content=\"width=device-width\"><link rel=\"icon\" href=\"data:,\">\n<style>\n"
    "body{font:15px/1.45 sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#222;background:#fff}\n"
    "nav a{margin-right:1em}table{border-collapse:collapse;font-size:13px}td,th{padding:2px 9px;text-align:left;"
    "border-bottom:1px solid #ddd;vertical-align:top}.n{text-align:right;font-variant-numeric:tabular-nums}\n"
    ".scroll{overflow-x:auto}.note{color:#8a4b00}figure{margin:1em 0}img,svg{width:100%;height:auto}\n"
    ".key{cursor:pointer}.key.off{opacity:.3}.series.off{display:none}summary{cursor:pointer;margin:.5em 0}\n"
    "</style></head><body>\n<h1>airyd: what it does, and what it costs</h1>\n<nav>"
    "<a href=\"#speed\">speed against error</a><a href=\"#peers\">peers</a><a href=\"#hard\">hard cases</a>"
    "<a href=\"#shimmer\">shimmer</a><a href=\"#pictures\">pictures</a><a href=\"#cost\">cost</a>"
    "<a href=\"#frames\">real frames</a><a href=\"#machine\">machine</a></nav>\n";

static const char tail[] =
    "<script>\n'use strict';\n"
    "for (const svg of document.querySelectorAll('svg.plot'))\n"
    "  for (const key of svg.querySelectorAll('.key'))\n"
    "    key.addEventListener('click', () => {\n"
    "      const off = key.classList.toggle('off');\n"
    "      svg.querySelector(`.series[data-series=\"${key.dataset.series}\"]`).classList.toggle('off', off);\n"
    "    });\n"
    "document.documentElement.dataset.script = 'ran';\n</script>\n</body></html>\n";

int main(int argc, char **argv)
{
    char path[1024];
    if (argc != 2) {
        fputs("Usage: report_page DIR\n", stderr);
        return 2;
    }
    snprintf(path, sizeof path, "%s/index.html", argv[1]);
    FILE *to = fopen(path, "we");
    if (!to)
        page_die("%s: %s", path, strerror(errno));
    fputs(head, to);
    section_speed(to, argv[1]);
    section_peers(to, argv[1]);
    section_hard(to, argv[1]);
    section_shimmer(to, argv[1]);
    section_pictures(to, argv[1]);
    section_cost(to, argv[1]);
    section_frames(to, argv[1]);
    section_machine(to, argv[1]);
    fputs(tail, to);
    if (ferror(to) | fclose(to))
        page_die("%s: cannot be written", path);
    snprintf(path, sizeof path, "%s/speed.svg", argv[1]);
    section_figure(argv[1], path);
    return EXIT_SUCCESS;
}
