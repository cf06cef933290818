// SPDX-License-Identifier: Apache-2.0
// cmd_options.c - options from a table, so that parsing and help texts cannot differ.
#include "cmd_options.h"

#include <string.h>

#include "cmd.h"

enum { NAME_MAX_LEN = 31, NAMES_MAX = 128 };

void options_init(struct options *o, int argc, char **argv, const struct option_row *rows, size_t n_rows)
{
    *o = (struct options){ .argc = argc, .at = 1, .argv = argv, .rows = rows, .n_rows = n_rows };
}

/* Insertions, deletions, changes and swaps of neighbours that make a into b. */
static unsigned edit_distance(const char *a, size_t na, const char *b, size_t nb)
{
    unsigned d[NAME_MAX_LEN + 1][NAME_MAX_LEN + 1];
    for (size_t i = 0; i <= na; i++)
        for (size_t k = 0; k <= nb; k++) {
            if (i == 0 || k == 0) {
                d[i][k] = (unsigned)(i + k);
                continue;
            }
            unsigned best = d[i - 1][k - 1] + (a[i - 1] != b[k - 1]);
            best = d[i - 1][k] + 1 < best ? d[i - 1][k] + 1 : best;
            best = d[i][k - 1] + 1 < best ? d[i][k - 1] + 1 : best;
            if (i > 1 && k > 1 && a[i - 1] == b[k - 2] && a[i - 2] == b[k - 1] &&
                d[i - 2][k - 2] + 1 < best)
                best = d[i - 2][k - 2] + 1;
            d[i][k] = best;
        }
    return d[na][nb];
}

const char *nearest_name(const char *word, const char *const *candidates, size_t n)
{
    const char *best = NULL;
    size_t len = strlen(word);
    unsigned best_distance = 4;
    if (len > NAME_MAX_LEN)
        return NULL;
    for (size_t i = 0; i < n; i++) {
        size_t candidate_len = strlen(candidates[i]);
        if (candidate_len > NAME_MAX_LEN)
            continue;
        unsigned d = edit_distance(word, len, candidates[i], candidate_len);
        if (len >= 3 && strncmp(word, candidates[i], len) == 0)
            d = 1; /* a beginning */
        if (d < best_distance && d < candidate_len) {
            best = candidates[i];
            best_distance = d;
        }
    }
    return best;
}

static int unknown_option(const struct options *o, const char *arg, size_t len)
{
    const char *names[NAMES_MAX];
    char word[NAME_MAX_LEN + 1] = "";
    size_t n = o->n_rows < NAMES_MAX ? o->n_rows : NAMES_MAX;
    for (size_t i = 0; i < n; i++)
        names[i] = o->rows[i].name;
    if (len > 2 && len - 2 <= NAME_MAX_LEN)
        memcpy(word, arg + 2, len - 2);
    const char *best = arg[1] == '-' && *word ? nearest_name(word, names, n) : NULL;
    if (best)
        cmd_complain("%s: unknown option \"%.*s\"; did you mean --%s?", o->argv[0], (int)len, arg, best);
    else
        cmd_complain("%s: unknown option \"%.*s\"; see airy %s --help", o->argv[0], (int)len, arg,
                     o->argv[0]);
    return OPTIONS_WRONG;
}

/* Parameters have underscores on the wire, and dashes are what people type. */
static bool same_name(const char *name, const char *word, size_t len)
{
    if (strlen(name) != len)
        return false;
    for (size_t i = 0; i < len; i++)
        if (name[i] != word[i] && !(name[i] == '_' && word[i] == '-'))
            return false;
    return true;
}

static const struct option_row *row_find(const struct options *o, const char *arg, size_t len)
{
    for (size_t i = 0; i < o->n_rows; i++) {
        const struct option_row *r = &o->rows[i];
        if (arg[1] == '-' ? same_name(r->name, arg + 2, len - 2)
                          : len == 2 && r->letter && r->letter == arg[1])
            return r;
    }
    return NULL;
}

int options_next(struct options *o, const char **value)
{
    *value = NULL;
    if (o->at >= o->argc)
        return OPTIONS_END;
    const char *arg = o->argv[o->at++];
    if (!o->operands_only && strcmp(arg, "--") == 0) {
        o->operands_only = true;
        return options_next(o, value);
    }
    if (o->operands_only || arg[0] != '-' || !arg[1]) {
        *value = arg;
        return OPTIONS_OPERAND;
    }
    const char *equals = arg[1] == '-' ? strchr(arg, '=') : NULL;
    size_t len = equals ? (size_t)(equals - arg) : strlen(arg);
    const struct option_row *r = row_find(o, arg, len);
    if (!r)
        return unknown_option(o, arg, len);
    if (!r->value && equals) {
        cmd_complain("%s: --%s takes no value", o->argv[0], r->name);
        return OPTIONS_WRONG;
    }
    if (r->value && !equals && o->at >= o->argc) {
        cmd_complain("%s: --%s needs a value: %s", o->argv[0], r->name, r->value);
        return OPTIONS_WRONG;
    }
    if (r->value)
        *value = equals ? equals + 1 : o->argv[o->at++];
    return (int)(r - o->rows);
}
