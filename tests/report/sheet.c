// SPDX-License-Identifier: Apache-2.0
// sheet.c - lines of CSV.
#include <stdarg.h>
#include <stdlib.h>

#include "report.h"

static void quoted(FILE *to, const char *s)
{
    for (fputc('"', to); *s; s++) {
        if (*s == '"')
            fputc('"', to);
        fputc((unsigned char)*s < ' ' ? ' ' : *s, to);
    }
    fputc('"', to);
}

void sheet_row(FILE *to, const char *kinds, ...)
{
    va_list ap;
    va_start(ap, kinds);
    for (const char *k = kinds; *k; k++) {
        if (k > kinds)
            fputc(',', to);
        if (*k == 's')
            quoted(to, va_arg(ap, const char *));
        else if (*k == 'd')
            fprintf(to, "%.6g", va_arg(ap, double));
        else
            fprintf(to, "%u", va_arg(ap, unsigned));
    }
    fputc('\n', to);
    va_end(ap);
}

void report_note(struct report *r, const char *section, const char *format, ...)
{
    char text[512];
    va_list ap;
    va_start(ap, format);
    vsnprintf(text, sizeof text, format, ap);
    va_end(ap);
    sheet_row(r->notes, "ss", section, text);
    printf("  %s: %s\n", section, text);
}
