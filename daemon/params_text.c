// SPDX-License-Identifier: Apache-2.0
// params_text.c - numbers, sizes and pieces of a parameter's text, and the faults that say where one is wrong.
//
// Invariant: all numbers are read and written in the C locale, whatever the process has set, because they travel
// between machines. What is quoted in a fault is printable ASCII and short, whatever was sent.
#include <locale.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "params_internal.h"

/* A pixel size is held where a Gaussian is one; the others are wide, and judged once they are in pixels. */
const struct size_range sigma_range = { "a size", { 0.1, 0.001, 1e-6 }, { 4096, 100, 1e5 } };
const struct number_range tint_range = { "a tint", 0, 1000 };
static const char *const unit_names[] = { [SIZE_PIXELS] = "px", [SIZE_PERCENT] = "%", [SIZE_MM] = "mm" };

/* glibc's "C" locale object is static: no allocation, nothing to free. */
static locale_t locale_enter(void) { return uselocale(newlocale(LC_ALL_MASK, "C", (locale_t)0)); }

struct quoted quote(const char *s, size_t len)
{
    struct quoted q;
    size_t n = 0;
    for (; n < len && n < 40; n++)
        q.s[n] = s[n] >= ' ' && s[n] <= '~' ? s[n] : '?';
    for (unsigned i = 0; n < len && i < 3; i++)
        q.s[n + i] = '.';
    q.s[n < len ? n + 3 : n] = '\0';
    return q;
}

bool number_read(const char *s, size_t len, double *out)
{
    char copy[512], *end;
    if (len == 0 || len >= sizeof(copy) || memchr(s, 'x', len) || memchr(s, 'X', len) ||
        !memchr("+-.0123456789nNiI", s[0], 17))
        return false;
    memcpy(copy, s, len);
    copy[len] = '\0';
    locale_t old = locale_enter();
    double v = strtod(copy, &end);
    uselocale(old);
    if (end != copy + len)
        return false;
    *out = v + 0.0; /* -0 becomes 0: one request, one line */
    return true;
}

struct printed number_print(double v)
{
    struct printed p;
    locale_t old = locale_enter();
    /* 15 digits give back every number that a person types; 17 give back every double. */
    for (int digits = 15; digits <= 17; digits++) {
        snprintf(p.s, sizeof(p.s), "%.*g", digits, v);
        if (strtod(p.s, NULL) == v)
            break;
    }
    uselocale(old);
    return p;
}

int param_fault(struct fault *f, enum fault_code code, const char *name, const char *format, ...)
{
    char field[sizeof(f->field)], text[sizeof(f->text)];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof(text), format, args);
    va_end(args);
    snprintf(field, sizeof(field), "params.%s", quote(name, strlen(name)).s);
    return fault_set(f, code, field, "%s", text);
}

/* ---- printing ---------------------------------------------------------------------------------------- */

void print_text(struct printer *to, const char *text)
{
    if (to->used < to->size)
        snprintf(to->out + to->used, to->size - to->used, "%s", text);
    to->used += strlen(text);
}

void print_size(struct printer *to, const struct size *s)
{
    print_text(to, number_print(s->value).s);
    print_text(to, s->unit == SIZE_PIXELS ? "" : unit_names[s->unit]);
}

void print_tint(struct printer *to, const double tint[3])
{
    for (unsigned c = 0; c < 3; c++) {
        print_text(to, c ? ":" : "");
        print_text(to, number_print(tint[c]).s);
    }
}

int text_keep(char field[PARAMS_TEXT_MAX], const char *param, const struct printer *canonical, struct fault *f)
{
    if (canonical->used >= PARAMS_TEXT_MAX)
        return param_fault(f, FAULT_PARAM_RANGE, param, "%s: %zu characters: at most %d expected", param,
                           canonical->used, PARAMS_TEXT_MAX - 1);
    memset(field, 0, PARAMS_TEXT_MAX);
    memcpy(field, canonical->out, canonical->used);
    return 0;
}

/* ---- pieces ------------------------------------------------------------------------------------------ */

struct piece piece_all(const char *param, const char *text, const char *usage)
{
    return (struct piece){ .param = param, .text = text, .s = text, .len = strlen(text), .usage = usage };
}

bool piece_next(struct piece *rest, char separator, struct piece *out)
{
    if (!rest->s)
        return false;
    const char *at = memchr(rest->s, separator, rest->len);
    *out = *rest;
    if (!at) {
        rest->s = NULL;
        return true;
    }
    out->len = (size_t)(at - rest->s);
    rest->s = at + 1;
    rest->len -= out->len + 1;
    return true;
}

bool piece_is(const struct piece *p, const char *word)
{
    return p->len == strlen(word) && memcmp(p->s, word, p->len) == 0;
}

int piece_fault(struct fault *f, enum fault_code code, const struct piece *p, const char *format, ...)
{
    char why[sizeof(f->text)];
    va_list args;
    va_start(args, format);
    vsnprintf(why, sizeof(why), format, args);
    va_end(args);
    return param_fault(f, code, p->param, "%s, at character %zu, \"%s\": %s%s%s%s", p->param,
                       (size_t)(p->s - p->text) + 1, quote(p->s, p->len).s, why, p->usage ? " (" : "",
                       p->usage ? p->usage : "", p->usage ? ")" : "");
}

int piece_number(const struct piece *p, const struct number_range *range, double *out, struct fault *f)
{
    double v;
    bool number = number_read(p->s, p->len, &v);
    if (!number || !(v >= range->min && v <= range->max))
        return piece_fault(f, number ? FAULT_PARAM_RANGE : FAULT_PARAM_SYNTAX, p,
                           "%s from %s to %s expected", range->what, number_print(range->min).s,
                           number_print(range->max).s);
    *out = v;
    return 0;
}

int piece_size(const struct piece *p, const struct size_range *range, struct size *out, struct fault *f)
{
    enum size_unit unit = SIZE_PIXELS;
    size_t suffix = 0;
    double v;
    for (unsigned i = 0; i < 3; i++) {
        size_t n = strlen(unit_names[i]);
        if (p->len >= n && memcmp(p->s + p->len - n, unit_names[i], n) == 0) {
            unit = (enum size_unit)i;
            suffix = n;
        }
    }
    if (!number_read(p->s, p->len - suffix, &v))
        return piece_fault(f, FAULT_PARAM_SYNTAX, p, "%s such as 8, 0.5%% or 0.3mm expected", range->what);
    if (!(v >= range->min[unit] && v <= range->max[unit]))
        return piece_fault(f, FAULT_PARAM_RANGE, p, "%s from %s to %s %s expected", range->what,
                           number_print(range->min[unit]).s, number_print(range->max[unit]).s,
                           unit_names[unit]);
    *out = (struct size){ v, unit };
    return 0;
}

int piece_tint(const struct piece *p, const struct number_range *range, double out[3], struct fault *f)
{
    struct piece rest = *p, part;
    double tint[3];
    unsigned n = 0;
    while (piece_next(&rest, ':', &part)) {
        if (n == 3)
            return piece_fault(f, FAULT_PARAM_SYNTAX, p, "three numbers R:G:B expected");
        if (piece_number(&part, range, &tint[n++], f) < 0)
            return -1;
    }
    if (n != 3)
        return piece_fault(f, FAULT_PARAM_SYNTAX, p, "three numbers R:G:B expected");
    memcpy(out, tint, sizeof(tint));
    return 0;
}
