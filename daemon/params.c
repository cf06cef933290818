// SPDX-License-Identifier: Apache-2.0
// params.c - the table of proto/params.def as code: sets one parameter, and prints all that have a meaning.
//
// Invariant: a struct params holds only finite numbers inside their ranges, and texts in canonical form beside
// what was read from them. So two requests are equal when params_print says the same line for both, and what was
// printed can be read again.
#include "params.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "params_internal.h"

enum kind { KIND_NUMBER, KIND_CHOICE, KIND_TEXT };

struct row {
    const char *name;
    enum kind kind;
    size_t offset;
    double min, max;
    const char *words;   /* NUMBER: the unit; CHOICE: the words */
    const char *instead; /* NUMBER_OR: the word; else NULL */
    size_t flag_offset;  /* of what is true for that word */
    int (*read)(struct params *p, const char *text, struct fault *f); /* TEXT */
};

static const struct row rows[N_ROWS] = {
#define NUMBER(name, field, def, min, max, unit, help)                                                  \
    { #name, KIND_NUMBER, offsetof(struct params, field), min, max, unit, NULL, 0, NULL },
#define NUMBER_OR(name, field, flag, def, min, max, unit, word, help)                                   \
    { #name, KIND_NUMBER, offsetof(struct params, field), min, max, unit, word,                         \
      offsetof(struct params, flag), NULL },
#define CHOICE(name, field, def, words, help)                                                           \
    { #name, KIND_CHOICE, offsetof(struct params, field), 0, 0, words, NULL, 0, NULL },
#define TEXT(name, field, def, help)                                                                    \
    { #name, KIND_TEXT, offsetof(struct params, field), 0, 0, NULL, NULL, 0, read_##name },
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
};

const char *params_row_name(unsigned row) { return rows[row].name; }

/* The names that fit a fault's text, for who guesses; the table's place, for who reads. */
static const struct row *row_find(const char *name, struct fault *f)
{
    char known[160];
    struct printer to = { known, sizeof(known), 0 };
    for (unsigned i = 0; i < N_ROWS; i++) {
        if (strcmp(rows[i].name, name) == 0)
            return &rows[i];
        if (to.used + strlen(rows[i].name) + 2 < sizeof(known)) {
            print_text(&to, i ? ", " : "");
            print_text(&to, rows[i].name);
        }
    }
    param_fault(f, FAULT_PARAM_UNKNOWN, name, "no parameter \"%s\"; known: %s and others: see the table in section 9 "
                "of PROTOCOL.md", quote(name, strlen(name)).s, known);
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
    return param_fault(f, code, r->name, "%s = %s: a finite number from %s to %s (%s)%s%s expected", r->name,
                       found, number_print(r->min).s, number_print(r->max).s, r->words,
                       r->instead ? ", or " : "", r->instead ? r->instead : "");
}

static int number_set(struct params *p, const struct row *r, double v, const char *found,
                      struct fault *f)
{
    if (!isfinite(v) || v < r->min || v > r->max)
        return number_fault(f, FAULT_PARAM_RANGE, r, found);
    *(double *)field_of(p, r) = v + 0.0;
    if (r->instead)
        *(bool *)((char *)p + r->flag_offset) = false;
    return 0;
}

static int number_set_text(struct params *p, const struct row *r, const char *text, struct fault *f)
{
    double v;
    if (r->instead && strcmp(text, r->instead) == 0) {
        *(double *)field_of(p, r) = 0;
        *(bool *)((char *)p + r->flag_offset) = true;
        return 0;
    }
    if (!number_read(text, strlen(text), &v))
        return number_fault(f, FAULT_PARAM_SYNTAX, r, quote(text, strlen(text)).s);
    return number_set(p, r, v, quote(text, strlen(text)).s, f);
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

struct printed_word params_word(const struct params *p, unsigned row)
{
    const char *at;
    struct printed_word word;
    size_t len = word_at(rows[row].words, (unsigned)*(const int *)field_in(p, &rows[row]), &at);
    snprintf(word.s, sizeof(word.s), "%.*s", (int)len, at);
    return word;
}

/* ---- setting ------------------------------------------------------------------------------------------ */

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
    p->given = 0;
}

static int row_set_text(struct params *p, const struct row *r, const char *text, struct fault *f)
{
    switch (r->kind) {
    case KIND_NUMBER:
        return number_set_text(p, r, text, f);
    case KIND_CHOICE:
        return choice_set(p, r, text, f);
    case KIND_TEXT:
        return r->read(p, text, f);
    }
    return -1;
}

bool params_has(const struct params *p, const char *name)
{
    const struct row *r = row_find(name, NULL);
    return r && params_given(p, (unsigned)(r - rows));
}

int params_set_text(struct params *p, const char *name, const char *text, struct fault *f)
{
    const struct row *r = row_find(name, f);
    if (!r || row_set_text(p, r, text, f) < 0)
        return -1;
    p->given |= UINT64_C(1) << (r - rows);
    return 0;
}

int params_set_number(struct params *p, const char *name, double value, struct fault *f)
{
    const struct row *r = row_find(name, f);
    if (!r)
        return -1;
    if (r->kind != KIND_NUMBER)
        return param_fault(f, FAULT_PARAM_SYNTAX, name, "%s = %s: text expected, not a number", name,
                           number_print(value).s);
    if (number_set(p, r, value, number_print(value).s, f) < 0)
        return -1;
    p->given |= UINT64_C(1) << (r - rows);
    return 0;
}

/* ---- printing ----------------------------------------------------------------------------------------- */

/* A name with a blank or a quote would else end early, or pass for two parameters. */
static void print_quoted(struct printer *to, const char *text)
{
    if (!strpbrk(text, " \"\\")) {
        print_text(to, text);
        return;
    }
    print_text(to, "\"");
    for (; *text; text++) {
        char one[3] = { '\\', *text, '\0' };
        print_text(to, *text == '"' || *text == '\\' ? one : one + 1);
    }
    print_text(to, "\"");
}

int params_print(const struct params *p, char *out, size_t size)
{
    struct printer to = { out, size, 0 };
    if (size)
        out[0] = '\0';
    for (unsigned i = 0; i < N_ROWS; i++) {
        const struct row *r = &rows[i];
        if (!params_has_meaning(p, i))
            continue;
        print_text(&to, to.used ? " " : "");
        print_text(&to, r->name);
        print_text(&to, "=");
        if (r->kind == KIND_CHOICE)
            print_text(&to, params_word(p, i).s);
        else if (r->kind == KIND_TEXT)
            print_quoted(&to, field_in(p, r));
        else if (r->instead && *(const bool *)((const char *)p + r->flag_offset))
            print_text(&to, r->instead);
        else
            print_text(&to, number_print(*(const double *)field_in(p, r)).s);
    }
    return (int)to.used;
}
