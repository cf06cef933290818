// SPDX-License-Identifier: Apache-2.0
// page_csv.c - CSV files as tables: quoted fields, "" for a quote, no line breaks within a field.
#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "page.h"

enum { FILE_MAX = 64 << 20 };

static bool slurp(struct csv *c, const char *path)
{
    FILE *file = fopen(path, "re");
    if (!file)
        return false;
    c->text = page_take(FILE_MAX + 1, 1);
    size_t n = fread(c->text, 1, FILE_MAX + 1, file);
    if (ferror(file) || n > FILE_MAX)
        page_die("%s: %s", path, n > FILE_MAX ? "longer than 64 MiB" : strerror(errno));
    c->text[n] = 0;
    fclose(file);
    return true;
}

// Cuts one field off, in place; *end: what followed it.
static char *field(char **at, char *end)
{
    char *from = *at, *to = from, *p = from;
    bool quoted = *p == '"';
    p += quoted;
    while (*p && *p != '\n' && (quoted || *p != ',')) {
        if (quoted && *p == '"' && *++p != '"')
            break;
        *to++ = *p++;
    }
    p += *p == '\r';
    *end = *p;
    *at = *p ? p + 1 : p;
    *to = 0;
    return from;
}

bool csv_read(struct csv *c, const char *dir, const char *name)
{
    char path[1024], end, *at;
    unsigned cells = 0, room = 0;
    *c = (struct csv){ 0 };
    snprintf(path, sizeof path, "%s/%s.csv", dir, name);
    if (!slurp(c, path))
        return false;
    for (at = c->text; *at;) {
        unsigned first = cells;
        do {
            if (cells == room) {
                room = room ? 2 * room : 256;
                if (!(c->cell = realloc(c->cell, room * sizeof(*c->cell))))
                    page_die("no memory for %s", path);
            }
            c->cell[cells++] = field(&at, &end);
        } while (end == ',');
        if (end && end != '\n')
            page_die("%s: '%c' after a quoted field", path, end);
        if (first && cells - first != c->columns)
            page_die("%s: row %u has %u fields; the header has %u", path, c->rows + 1, cells - first, c->columns);
        *(first ? &c->rows : &c->columns) += first ? 1 : cells;
    }
    if (!c->columns)
        page_die("%s: empty", path);
    return true;
}

void csv_finish(struct csv *c)
{
    free(c->cell);
    free(c->text);
}

const char *csv_cell(const struct csv *c, unsigned row, const char *column)
{
    for (unsigned i = 0; i < c->columns; i++)
        if (!strcmp(c->cell[i], column))
            return c->cell[(row + 1) * c->columns + i];
    return "";
}

double csv_number(const struct csv *c, unsigned row, const char *column)
{
    const char *text = csv_cell(c, row, column);
    char *end;
    double v = strtod(text, &end);
    return end == text || *end ? NAN : v;
}

void html_text(FILE *to, const char *s)
{
    for (; *s; s++)
        switch (*s) {
        case '<': fputs("&lt;", to); break;
        case '>': fputs("&gt;", to); break;
        case '&': fputs("&amp;", to); break;
        case '"': fputs("&quot;", to); break;
        default: fputc(*s, to);
        }
}

void csv_table(FILE *to, const struct csv *c, const char *name, bool folded)
{
    if (folded)
        fprintf(to, "<details><summary>%s.csv, %u rows</summary>\n", name, c->rows);
    fprintf(to, "<div class=\"scroll\"><table data-csv=\"%s\">\n", name);
    for (unsigned row = 0; row <= c->rows; row++) {
        fputs("<tr>", to);
        for (unsigned i = 0; i < c->columns; i++) {
            const char *text = c->cell[row * c->columns + i];
            char *end;
            strtod(text, &end);
            fputs(!row ? "<th>" : *text && !*end ? "<td class=\"n\">" : "<td>", to);
            html_text(to, text);
            fputs(row ? "</td>" : "</th>", to);
        }
        fputs("</tr>\n", to);
    }
    fputs("</table></div>\n", to);
    if (folded)
        fputs("</details>\n", to);
}
