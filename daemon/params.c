// SPDX-License-Identifier: Apache-2.0
// params.c - the table of proto/params.def as code: reads, checks and prints what was asked.
//
// Invariant: a struct params holds only finite numbers inside their ranges, a psf_spec that was read
// from its psf text, and that text in canonical form. So two requests are equal when params_print says
// the same line for both, and what was printed can be read again. All numbers are read and written in
// the C locale, whatever the process has set, because they travel between machines.
#include "params.h"

#include <assert.h>
#include <locale.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum kind { KIND_NUMBER, KIND_CHOICE, KIND_TEXT };

struct row {
    const char *name;
    enum kind kind;
    size_t offset;
    double min, max;
    const char *words; /* NUMBER: the unit; CHOICE: the words */
};

static const struct row rows[] = {
#define NUMBER(name, field, def, min, max, unit, help)                                                  \
    { #name, KIND_NUMBER, offsetof(struct params, field), min, max, unit },
#define CHOICE(name, field, def, words, help)                                                           \
    { #name, KIND_CHOICE, offsetof(struct params, field), 0, 0, words },
#define TEXT(name, field, def, help) { #name, KIND_TEXT, offsetof(struct params, field), 0, 0, NULL },
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
};
enum { N_ROWS = sizeof(rows) / sizeof(rows[0]) };

static const double sigma_pixels_min = 0.1, sigma_pixels_max = 4096;
static const double sigma_percent_min = 0.001, sigma_percent_max = 100;
static const double weight_max = 1e6;
/* Threshold and knee after exposure stay far inside float32, in which the engine works. */
static const double exposed_max = 1e37;

/* ---- small things ---------------------------------------------------------------------------- */

/* glibc's "C" locale object is static: no allocation, nothing to free. */
static locale_t locale_enter(void) { return uselocale(newlocale(LC_ALL_MASK, "C", (locale_t)0)); }

struct quoted {
    char s[48];
};

/* The first bytes of s for an error text: hostile bytes become '?'. */
static struct quoted quote(const char *s, size_t len)
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

/* A decimal number that is all of s[0..len): no blanks, no hexadecimal. "nan" and "inf" are read, so
 * that the answer to them is about their value. */
static bool number_read(const char *s, size_t len, double *out)
{
    char copy[512], *end;
    if (len == 0 || len >= sizeof(copy) || memchr(s, 'x', len) || memchr(s, 'X', len) ||
        !strchr("+-.0123456789nNiI", s[0]))
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

struct printed {
    char s[32];
};

static struct printed number_print(double v)
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

static int param_fault(struct fault *f, enum fault_code code, const char *name, const char *format, ...)
    __attribute__((format(printf, 4, 5)));
static int param_fault(struct fault *f, enum fault_code code, const char *name, const char *format, ...)
{
    char field[sizeof(f->field)], text[sizeof(f->text)];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof(text), format, args);
    va_end(args);
    snprintf(field, sizeof(field), "params.%s", quote(name, strlen(name)).s);
    return fault_set(f, code, field, "%s", text);
}

static const struct row *row_find(const char *name, struct fault *f)
{
    char known[256] = "";
    for (unsigned i = 0; i < N_ROWS; i++) {
        if (strcmp(rows[i].name, name) == 0)
            return &rows[i];
        size_t used = strlen(known);
        snprintf(known + used, sizeof(known) - used, "%s%s", i ? ", " : "", rows[i].name);
    }
    param_fault(f, FAULT_PARAM_UNKNOWN, name, "no parameter \"%s\"; known: %s",
                quote(name, strlen(name)).s, known);
    return NULL;
}

static void *field_of(struct params *p, const struct row *r) { return (char *)p + r->offset; }
static const void *field_in(const struct params *p, const struct row *r)
{
    return (const char *)p + r->offset;
}

/* ---- numbers and choices ----------------------------------------------------------------------- */

static int number_fault(struct fault *f, enum fault_code code, const struct row *r, const char *found)
{
    return param_fault(f, code, r->name, "%s = %s: a finite number from %s to %s (%s) expected", r->name,
                       found, number_print(r->min).s, number_print(r->max).s, r->words);
}

static int number_set(struct params *p, const struct row *r, double v, const char *found,
                      struct fault *f)
{
    if (!isfinite(v) || v < r->min || v > r->max)
        return number_fault(f, FAULT_PARAM_RANGE, r, found);
    *(double *)field_of(p, r) = v + 0.0;
    return 0;
}

/* The index'th word of a list; its length, or 0 after the last. */
static size_t word_at(const char *words, unsigned index, const char **word)
{
    for (;; index--) {
        size_t len = strcspn(words, " ");
        *word = words;
        if (index == 0 || len == 0)
            return len;
        words += len + (words[len] == ' ');
    }
}

static int choice_set(struct params *p, const struct row *r, const char *text, struct fault *f)
{
    const char *word;
    size_t len;
    for (unsigned i = 0; (len = word_at(r->words, i, &word)); i++)
        if (strlen(text) == len && memcmp(text, word, len) == 0) {
            *(int *)field_of(p, r) = (int)i;
            return 0;
        }
    return param_fault(f, FAULT_PARAM_SYNTAX, r->name, "%s = %s: one of \"%s\" expected", r->name,
                       quote(text, strlen(text)).s, r->words);
}

/* ---- psf ------------------------------------------------------------------------------------------ */

static const char psf_known[] = "known: gaussians:sigma=S/S/...,weight=W/W/...";

struct psf_lists {
    struct psf_gaussian g[PARAMS_GAUSSIANS_MAX];
    unsigned sigmas, weights;
};

/* piece: what is wrong, inside text. */
static int psf_fault(struct fault *f, enum fault_code code, const char *text, const char *piece,
                     size_t len, const char *expected)
{
    return param_fault(f, code, "psf", "psf, at character %zu, \"%s\": %s (%s)",
                       (size_t)(piece - text) + 1, quote(piece, len).s, expected, psf_known);
}

static int sigma_read(struct psf_gaussian *g, const char *text, const char *s, size_t len,
                      struct fault *f)
{
    bool percent = len > 0 && s[len - 1] == '%';
    double v;
    if (!number_read(s, len - percent, &v))
        return psf_fault(f, FAULT_PARAM_SYNTAX, text, s, len, "a sigma such as 8 or 0.5% expected");
    if (percent && !(v >= sigma_percent_min && v <= sigma_percent_max))
        return psf_fault(f, FAULT_PARAM_RANGE, text, s, len,
                         "a sigma from 0.001% to 100% of the diagonal expected");
    if (!percent && !(v >= sigma_pixels_min && v <= sigma_pixels_max))
        return psf_fault(f, FAULT_PARAM_RANGE, text, s, len, "a sigma from 0.1 to 4096 pixels expected");
    g->sigma = (struct size){ v, percent ? SIZE_PERCENT : SIZE_PIXELS };
    return 0;
}

static int weight_read(struct psf_gaussian *g, const char *text, const char *s, size_t len,
                       struct fault *f)
{
    double v;
    if (!number_read(s, len, &v))
        return psf_fault(f, FAULT_PARAM_SYNTAX, text, s, len, "a weight such as 0.2 expected");
    if (!(v >= 0 && v <= weight_max))
        return psf_fault(f, FAULT_PARAM_RANGE, text, s, len, "a weight from 0 to 1e+06 expected");
    g->weight = v;
    return 0;
}

/* "key=element/element/..." at s[0..len). */
static int psf_item_read(struct psf_lists *l, const char *text, const char *s, size_t len,
                         struct fault *f)
{
    bool sigma = len >= 6 && memcmp(s, "sigma=", 6) == 0;
    bool weight = len >= 7 && memcmp(s, "weight=", 7) == 0;
    if (!sigma && !weight)
        return psf_fault(f, FAULT_PARAM_SYNTAX, text, s, len, "sigma=... or weight=... expected");
    unsigned *count = sigma ? &l->sigmas : &l->weights;
    if (*count)
        return psf_fault(f, FAULT_PARAM_SYNTAX, text, s, len, "this key was given before");
    const char *end = s + len, *e = s + (sigma ? 6 : 7);
    for (;;) {
        const char *slash = memchr(e, '/', (size_t)(end - e));
        size_t n = (size_t)((slash ? slash : end) - e);
        if (*count == PARAMS_GAUSSIANS_MAX)
            return psf_fault(f, FAULT_PARAM_RANGE, text, e, n, "at most 32 Gaussians expected");
        if ((sigma ? sigma_read : weight_read)(&l->g[*count], text, e, n, f) < 0)
            return -1;
        ++*count;
        if (!slash)
            return 0;
        e = slash + 1;
    }
}
static_assert(PARAMS_GAUSSIANS_MAX == 32, "the text above says 32");

static int psf_read(struct psf_spec *out, const char *text, struct fault *f)
{
    static const char prefix[] = "gaussians:";
    const char *s = text;
    struct psf_lists l = { 0 };
    if (strncmp(text, prefix, sizeof(prefix) - 1) != 0)
        return psf_fault(f, FAULT_PARAM_SYNTAX, text, text, strlen(text),
                         "no such point spread function");
    s += sizeof(prefix) - 1;
    for (;;) {
        size_t len = strcspn(s, ",");
        if (psf_item_read(&l, text, s, len, f) < 0)
            return -1;
        s += len;
        if (!*s++)
            break;
    }
    if (!l.sigmas || !l.weights)
        return psf_fault(f, FAULT_PARAM_SYNTAX, text, text, strlen(text),
                         l.sigmas ? "weight=... is missing" : "sigma=... is missing");
    if (l.weights != l.sigmas && l.weights != 1)
        return param_fault(f, FAULT_PARAM_SYNTAX, "psf",
                           "psf: %u sigmas and %u weights: as many weights as sigmas, or one, expected",
                           l.sigmas, l.weights);
    *out = (struct psf_spec){ .count = l.sigmas };
    for (unsigned i = 0; i < l.sigmas; i++) {
        out->gaussian[i] = l.g[i];
        out->gaussian[i].weight = l.g[l.weights == 1 ? 0 : i].weight;
        for (unsigned c = 0; c < 3; c++)
            out->gaussian[i].tint[c] = 1;
    }
    return 0;
}

/* Appends like snprintf: *used counts what would have been written. */
static void append(char *out, size_t size, size_t *used, const char *text)
{
    if (*used < size)
        snprintf(out + *used, size - *used, "%s", text);
    *used += strlen(text);
}

static size_t psf_print(const struct psf_spec *s, char *out, size_t size)
{
    size_t used = 0;
    bool same = true;
    append(out, size, &used, "gaussians:sigma=");
    for (unsigned i = 0; i < s->count; i++) {
        append(out, size, &used, i ? "/" : "");
        append(out, size, &used, number_print(s->gaussian[i].sigma.value).s);
        append(out, size, &used, s->gaussian[i].sigma.unit == SIZE_PERCENT ? "%" : "");
        same = same && s->gaussian[i].weight == s->gaussian[0].weight;
    }
    append(out, size, &used, ",weight=");
    for (unsigned i = 0; i < (same ? 1 : s->count); i++) {
        append(out, size, &used, i ? "/" : "");
        append(out, size, &used, number_print(s->gaussian[i].weight).s);
    }
    return used;
}

static int psf_set(struct params *p, const char *text, struct fault *f)
{
    struct psf_spec spec;
    char canonical[PARAMS_TEXT_MAX];
    if (psf_read(&spec, text, f) < 0)
        return -1;
    size_t len = psf_print(&spec, canonical, sizeof(canonical));
    if (len >= sizeof(canonical))
        return param_fault(f, FAULT_PARAM_RANGE, "psf", "psf: %zu characters: at most %d expected", len,
                           PARAMS_TEXT_MAX - 1);
    p->psf_spec = spec;
    memcpy(p->psf, canonical, len + 1);
    return 0;
}

/* ---- the interface -----------------------------------------------------------------------------------
 */

void params_init(struct params *p)
{
    memset(p, 0, sizeof(*p));
    int bad = 0;
#define NUMBER(name, field, def, min, max, unit, help) p->field = def;
#define CHOICE(name, field, def, words, help) p->field = def;
#define TEXT(name, field, def, help) bad |= params_set_text(p, #name, def, NULL);
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
    assert(!bad);
    (void)bad;
}

int params_set_text(struct params *p, const char *name, const char *text, struct fault *f)
{
    const struct row *r = row_find(name, f);
    double v;
    if (!r)
        return -1;
    switch (r->kind) {
    case KIND_NUMBER:
        if (!number_read(text, strlen(text), &v))
            return number_fault(f, FAULT_PARAM_SYNTAX, r, quote(text, strlen(text)).s);
        return number_set(p, r, v, quote(text, strlen(text)).s, f);
    case KIND_CHOICE:
        return choice_set(p, r, text, f);
    case KIND_TEXT:
        if (r->offset == offsetof(struct params, psf))
            return psf_set(p, text, f);
        snprintf(field_of(p, r), PARAMS_TEXT_MAX, "%s", text);
        return 0;
    }
    return -1;
}

int params_set_number(struct params *p, const char *name, double value, struct fault *f)
{
    const struct row *r = row_find(name, f);
    if (!r)
        return -1;
    if (r->kind != KIND_NUMBER)
        return param_fault(f, FAULT_PARAM_SYNTAX, name, "%s = %s: text expected, not a number", name,
                           number_print(value).s);
    return number_set(p, r, value, number_print(value).s, f);
}

int params_check(const struct params *p, struct fault *f)
{
    double scale = exp2(-p->exposure);
    if (p->bright == BRIGHT_SMOOTHSTEP && p->knee > 1)
        return param_fault(
            f, FAULT_PARAM_CONFLICT, "knee",
            "knee = %s: with bright = smoothstep it is a share of the threshold, at most 1",
            number_print(p->knee).s);
    if (p->bright != BRIGHT_NONE && p->threshold * scale > exposed_max)
        return param_fault(f, FAULT_PARAM_CONFLICT, "exposure",
                           "threshold / 2^exposure = %s: at most 1e+37 expected",
                           number_print(p->threshold * scale).s);
    if (p->bright == BRIGHT_KNEE && p->knee * scale > exposed_max)
        return param_fault(f, FAULT_PARAM_CONFLICT, "exposure",
                           "knee / 2^exposure = %s: at most 1e+37 expected",
                           number_print(p->knee * scale).s);
    return 0;
}

/* Has the parameter a say in the result, the others being what they are? */
static bool has_meaning(const struct params *p, const struct row *r)
{
    if (r->offset == offsetof(struct params, knee))
        return p->bright == BRIGHT_KNEE || p->bright == BRIGHT_SMOOTHSTEP;
    if (r->offset == offsetof(struct params, threshold) ||
        r->offset == offsetof(struct params, exposure))
        return p->bright != BRIGHT_NONE;
    return true;
}

int params_print(const struct params *p, char *out, size_t size)
{
    size_t used = 0;
    if (size)
        out[0] = '\0';
    for (unsigned i = 0; i < N_ROWS; i++) {
        const struct row *r = &rows[i];
        char word[64];
        const char *value = field_in(p, r), *at;
        struct printed number;
        if (!has_meaning(p, r))
            continue;
        if (r->kind == KIND_NUMBER) {
            number = number_print(*(const double *)field_in(p, r));
            value = number.s;
        } else if (r->kind == KIND_CHOICE) {
            size_t len = word_at(r->words, (unsigned)*(const int *)field_in(p, r), &at);
            snprintf(word, sizeof(word), "%.*s", (int)len, at);
            value = word;
        }
        append(out, size, &used, used ? " " : "");
        append(out, size, &used, r->name);
        append(out, size, &used, "=");
        append(out, size, &used, value);
    }
    return (int)used;
}

double params_pixels(const struct params *p, const struct size *s, uint32_t width, uint32_t height,
                     uint32_t display_width, double pixel_aspect)
{
    switch (s->unit) {
    case SIZE_PERCENT: return s->value / 100 * hypot(width * pixel_aspect, height);
    case SIZE_MM: return s->value / p->sensor_mm * display_width * pixel_aspect;
    default: return s->value;
    }
}

void params_view_name(const struct view_spec *v, char out[32])
{
    static const char *const names[] = { "final", "source", "bright", "bloom", "level", "residual" };
    if (v->view == VIEW_LEVEL)
        snprintf(out, 32, "level.%u", v->level);
    else
        snprintf(out, 32, "%s", names[v->view]);
}
