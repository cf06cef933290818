// SPDX-License-Identifier: Apache-2.0
// wall_def_value.c - the values of a wall definition: numbers, times, words, pairs, names, and a map's keys.
//
// Invariant: an output is set only by a value that is all that was expected; else a mistake names the value and what was
// expected, and the output keeps its default. Numbers are read in the C locale, whatever the process has set.
#include <assert.h>
#include <locale.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "wall_def_internal.h"

/* ---- keys ------------------------------------------------------------------------------------------------------- */

enum { KEY_MAX = 24, KEYS_MAX = 16 };

static unsigned least(unsigned a, unsigned b, unsigned c)
{
    unsigned m = a < b ? a : b;
    return m < c ? m : c;
}

/* Insertions, deletions and changes that make a into b (Levenshtein); - and _ count as blanks. */
static unsigned edit_distance(const char *a, const char *b)
{
    unsigned row[KEY_MAX + 1];
    const size_t na = strlen(a), nb = strlen(b);
    for (unsigned k = 0; k <= nb; k++)
        row[k] = k;
    for (unsigned i = 1; i <= na; i++) {
        const char c = a[i - 1] == '_' || a[i - 1] == '-' ? ' ' : a[i - 1];
        unsigned diagonal = row[0];
        row[0] = i;
        for (unsigned k = 1; k <= nb; k++) {
            const unsigned change = diagonal + (c != b[k - 1]);
            diagonal = row[k];
            row[k] = least(change, row[k] + 1, row[k - 1] + 1);
        }
    }
    return row[nb];
}

static const char *nearest(const char *word, const char *const *keys, unsigned count)
{
    /* What people write for what is there. */
    static const char *const other[][2] = { { "color", "colour" }, { "name", "wall" }, { "fps", "rate" }, { "gamma", "transfer" },
                                            { "reverse", "reversed" }, { "orientation", "rotate" }, { "position", "at" },
                                            { "outputs", "boards" }, { "mirror", "flip" }, { "start", "first" } };
    for (unsigned i = 0; i < sizeof(other) / sizeof(other[0]); i++)
        for (unsigned k = 0; k < count; k++)
            if (strcmp(word, other[i][0]) == 0 && strcmp(keys[k], other[i][1]) == 0)
                return keys[k];
    const char *best = NULL;
    unsigned best_distance = 3;
    if (strlen(word) > KEY_MAX)
        return NULL;
    for (unsigned k = 0; k < count; k++) {
        const unsigned d = edit_distance(word, keys[k]);
        if (d < best_distance && d < strlen(keys[k])) {
            best = keys[k];
            best_distance = d;
        }
    }
    return best;
}

/* The key that was probably meant, or NULL. */
static const char *complain_unknown(struct wall_reader *r, const struct wall_node *v, const char *const *keys, unsigned count)
{
    struct wall_node at = *v; /* without its text */
    at.line = v->key_line;
    at.column = v->key_column;
    at.kind = NODE_MAP;
    const char *best = nearest(v->key, keys, count);
    if (best) {
        wall_mistake(r, &at, "unknown key; did you mean \"%s\"?", best);
        return best;
    }
    char list[160];
    size_t used = 0;
    for (unsigned i = 0; i < count && used < sizeof(list); i++)
        used += (size_t)snprintf(list + used, sizeof(list) - used, "%s%s", i ? ", " : "", keys[i]);
    wall_mistake(r, &at, "unknown key; expected one of: %s", list);
    return NULL;
}

bool wall_keys(struct wall_reader *r, const struct wall_node *map, const char *const *keys, unsigned count,
               const struct wall_node *value[])
{
    const struct wall_node *meant[KEYS_MAX] = { NULL };
    assert(count <= KEYS_MAX);
    for (unsigned i = 0; i < count; i++)
        value[i] = NULL;
    if (map->kind != NODE_MAP) {
        wall_mistake(r, map, "%s; expected keys with values, such as \"%s: ...\"", wall_found(map).s, keys[0]);
        return false;
    }
    for (const struct wall_node *v = map->first; v; v = v->next) {
        unsigned i = 0;
        while (i < count && strcmp(v->key, keys[i]) != 0)
            i++;
        const char *best = i == count ? complain_unknown(r, v, keys, count) : NULL;
        for (unsigned k = 0; best && k < count; k++)
            if (keys[k] == best)
                meant[k] = v;
        if (i == count)
            continue;
        if (value[i])
            wall_mistake(r, v, "said twice (first in line %u); expected once", value[i]->key_line);
        else
            value[i] = v;
    }
    // What was meant is read, too, so that its own mistakes are told now, and nobody misses it.
    for (unsigned i = 0; i < count; i++)
        value[i] = value[i] ? value[i] : meant[i];
    return true;
}

/* ---- numbers ------------------------------------------------------------------------------------------------------ */

static size_t digits(const char *s, size_t length)
{
    size_t n = 0;
    while (n < length && s[n] >= '0' && s[n] <= '9')
        n++;
    return n;
}

bool wall_number_scan(const char *s, size_t length, double *out)
{
    char copy[40];
    if (length == 0 || length >= sizeof(copy))
        return false;
    size_t at = s[0] == '-' || s[0] == '+';
    const size_t whole = digits(s + at, length - at);
    at += whole;
    size_t fraction = 0;
    if (at < length && s[at] == '.') {
        fraction = digits(s + at + 1, length - at - 1);
        at += 1 + fraction;
    }
    if (whole + fraction == 0)
        return false;
    if (at < length && (s[at] == 'e' || s[at] == 'E')) {
        const size_t sign = at + 1 < length && (s[at + 1] == '-' || s[at + 1] == '+');
        const size_t exponent = digits(s + at + 1 + sign, length - at - 1 - sign);
        if (!exponent)
            return false;
        at += 1 + sign + exponent;
    }
    if (at != length)
        return false;
    memcpy(copy, s, length);
    copy[length] = '\0';
    /* The C locale's object is static in the C library: nothing to free. */
    locale_t old = uselocale(newlocale(LC_ALL_MASK, "C", (locale_t)0));
    const double v = strtod(copy, NULL);
    uselocale(old);
    if (!isfinite(v))
        return false;
    *out = v + 0.0; /* -0 becomes 0 */
    return true;
}

static bool number_at(const struct wall_node *n, double *out)
{
    return n->kind == NODE_TEXT && wall_number_scan(n->text, strlen(n->text), out);
}

bool wall_number(struct wall_reader *r, const struct wall_node *n, double min, double max, const char *what, double *out)
{
    double v;
    if (!n)
        return false;
    if (number_at(n, &v) && v >= min && v <= max) {
        *out = v;
        return true;
    }
    wall_mistake(r, n, "%s; expected %s, %.10g to %.10g", wall_found(n).s, what, min, max);
    return false;
}

bool wall_share(struct wall_reader *r, const struct wall_node *n, double *out)
{
    double v;
    if (!n)
        return false;
    const size_t length = n->kind == NODE_TEXT ? strlen(n->text) : 0;
    const bool percent = length && n->text[length - 1] == '%';
    if (length && wall_number_scan(n->text, length - percent, &v)) {
        v *= percent ? 0.01 : 1;
        if (v >= 0 && v <= 1) {
            *out = v;
            return true;
        }
    }
    wall_mistake(r, n, "%s; expected a share of the light, 0 to 1 or 0%% to 100%%", wall_found(n).s);
    return false;
}

bool wall_whole(struct wall_reader *r, const struct wall_node *n, uint32_t min, uint32_t max, const char *what,
                uint32_t *out)
{
    double v;
    if (!n)
        return false;
    if (number_at(n, &v) && v >= min && v <= max && v == floor(v)) {
        *out = (uint32_t)v;
        return true;
    }
    wall_mistake(r, n, "%s; expected %s, a whole number %u to %u", wall_found(n).s, what, min, max);
    return false;
}

static bool is_list_of(struct wall_reader *r, const struct wall_node *n, unsigned count, const char *what)
{
    if (n->kind == NODE_LIST && n->count == count)
        return true;
    wall_mistake(r, n, "%s; expected %u numbers in brackets: %s", wall_found(n).s, count, what);
    return false;
}

bool wall_pair(struct wall_reader *r, const struct wall_node *n, uint32_t min, uint32_t max, const char *what,
               uint32_t out[2])
{
    uint32_t v[2];
    if (!n || !is_list_of(r, n, 2, what))
        return false;
    const bool x = wall_whole(r, n->first, min, max, what, &v[0]);
    if (!wall_whole(r, n->first->next, min, max, what, &v[1]) || !x)
        return false;
    memcpy(out, v, sizeof(v));
    return true;
}

bool wall_numbers(struct wall_reader *r, const struct wall_node *n, unsigned count, double min, double max,
                  const char *what, double out[])
{
    double v[4];
    bool good = true;
    unsigned i = 0;
    if (!n || !is_list_of(r, n, count, what))
        return false;
    for (const struct wall_node *e = n->first; e; e = e->next)
        good = wall_number(r, e, min, max, what, &v[i++]) && good;
    if (good)
        memcpy(out, v, count * sizeof(*v));
    return good;
}

/* ---- times, words, names --------------------------------------------------------------------------------------------- */

static bool time_scan(const char *s, double *out)
{
    static const struct { const char *unit; double seconds; } units[] = { { "ms", 1e-3 }, { "s", 1 }, { "min", 60 } };
    const size_t length = strlen(s), number = strcspn(s, " abcdefghijklmnopqrstuvwxyz");
    const char *unit = s + number;
    if (!wall_number_scan(s, number, out))
        return false;
    while (*unit == ' ')
        unit++;
    if (number == length)
        return *out == 0;
    for (unsigned i = 0; i < sizeof(units) / sizeof(units[0]); i++)
        if (strcmp(unit, units[i].unit) == 0) {
            *out *= units[i].seconds;
            return true;
        }
    return false;
}

bool wall_time(struct wall_reader *r, const struct wall_node *n, double max_s, bool forever, double *out)
{
    double v;
    if (!n)
        return false;
    if (forever && n->kind == NODE_TEXT && strcmp(n->text, "forever") == 0) {
        *out = INFINITY;
        return true;
    }
    if (n->kind == NODE_TEXT && time_scan(n->text, &v) && v >= 0 && v <= max_s) {
        *out = v;
        return true;
    }
    wall_mistake(r, n, "%s; expected a time such as 2s or 500ms, 0 to %.10g s%s", wall_found(n).s, max_s,
                 forever ? ", or forever" : "");
    return false;
}

bool wall_word(struct wall_reader *r, const struct wall_node *n, const char *words, unsigned *out)
{
    if (!n)
        return false;
    unsigned i = 0;
    for (const char *w = words; n->kind == NODE_TEXT && *w; i++) {
        const size_t length = strcspn(w, " ");
        if (strlen(n->text) == length && memcmp(n->text, w, length) == 0) {
            *out = i;
            return true;
        }
        w += length + (w[length] == ' ');
    }
    wall_mistake(r, n, "%s; expected one of: %s", wall_found(n).s, words);
    return false;
}

bool wall_yes(struct wall_reader *r, const struct wall_node *n, bool *out)
{
    unsigned word;
    if (!wall_word(r, n, "false true no yes", &word))
        return false;
    *out = word & 1;
    return true;
}

bool wall_text(struct wall_reader *r, const struct wall_node *n, const char *what, char *out, size_t size)
{
    if (!n)
        return false;
    bool good = n->kind == NODE_TEXT && *n->text && strlen(n->text) < size;
    for (const char *s = n->text; good && *s; s++)
        good = (unsigned char)*s >= ' ' && *s != 0x7f;
    if (good) {
        memcpy(out, n->text, strlen(n->text) + 1);
        return true;
    }
    wall_mistake(r, n, "%s; expected %s, 1 to %zu bytes of text on one line", wall_found(n).s, what, size - 1);
    return false;
}

const struct wall_node *wall_elements(struct wall_reader *r, const struct wall_node *n, const char *what)
{
    if (!n)
        return NULL;
    if (n->kind == NODE_LIST && n->count)
        return n->first;
    wall_mistake(r, n, "%s; expected a list of %s, each on a line that begins with \"- \"", wall_found(n).s, what);
    return NULL;
}
