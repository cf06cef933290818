// SPDX-License-Identifier: Apache-2.0
// params_keys.c - "key=element/element/..,key=..." by a table of rules: the point spread functions and the sun are
// said in it.
//
// Invariant: after keys_read each key has as many elements as its rule allows, each in its range; a key that was
// not given has its default. So one printer makes the canonical text of all of them.
#include <math.h>
#include <string.h>

#include "params_internal.h"

static int element_read(struct key_value *v, const struct key_rule *rule, const struct piece *p,
                        struct fault *f)
{
    double *number = v->v[v->count];
    struct piece cut = *p;
    struct size size;
    switch (rule->shape) {
    case SHAPE_SIZE:
        if (piece_size(p, &sigma_range, &size, f) < 0)
            return -1;
        *number = size.value;
        v->unit[v->count] = size.unit;
        break;
    case SHAPE_TINT:
        if (piece_tint(p, &rule->range, number, f) < 0)
            return -1;
        break;
    case SHAPE_PERCENT:
        if (cut.len == 0 || cut.s[cut.len - 1] != '%')
            return piece_fault(f, FAULT_PARAM_SYNTAX, p, "%s such as 50%% expected", rule->range.what);
        cut.len--;
        if (piece_number(&cut, &rule->range, number, f) < 0)
            return -1;
        break;
    default:
        if (piece_number(p, &rule->range, number, f) < 0)
            return -1;
        if (rule->shape == SHAPE_WHOLE && *number != floor(*number))
            return piece_fault(f, FAULT_PARAM_SYNTAX, p, "%s, a whole number, expected", rule->range.what);
    }
    v->count++;
    return 0;
}

static int list_read(struct key_value *v, const struct key_rule *rule, struct piece list, struct fault *f)
{
    struct piece all = list, element;
    while (piece_next(&list, '/', &element)) {
        if (v->count == rule->max)
            return piece_fault(f, FAULT_PARAM_RANGE, &element, "at most %u of %s expected", rule->max,
                               rule->name);
        if (element_read(v, rule, &element, f) < 0)
            return -1;
    }
    if (rule->channels && v->count == 1)
        for (; v->count < 3; v->count++) {
            memcpy(v->v[v->count], v->v[0], sizeof(v->v[0]));
            v->unit[v->count] = v->unit[0];
        }
    if (rule->channels && v->count != 3)
        return piece_fault(f, FAULT_PARAM_SYNTAX, &all, "one, or three for R/G/B, expected");
    return 0;
}

/* "key=list" */
static int item_read(struct key_value *value, const struct key_rule *rule, unsigned count,
                     const struct piece *item, struct fault *f)
{
    struct piece list = *item, key;
    piece_next(&list, '=', &key);
    for (unsigned i = 0; i < count && list.s; i++) {
        if (!piece_is(&key, rule[i].name))
            continue;
        if (value[i].count)
            return piece_fault(f, FAULT_PARAM_SYNTAX, item, "this key was given before");
        return list_read(&value[i], &rule[i], list, f);
    }
    return piece_fault(f, FAULT_PARAM_SYNTAX, item, "no such key");
}

int keys_read(struct key_value *value, const struct key_rule *rule, unsigned count, struct piece items,
              struct fault *f)
{
    struct piece all = items, item;
    for (unsigned i = 0; i < count; i++)
        value[i].count = 0;
    if (items.len == 0)
        items.s = NULL;
    while (piece_next(&items, ',', &item))
        if (item_read(value, rule, count, &item, f) < 0)
            return -1;
    for (unsigned i = 0; i < count; i++) {
        if (value[i].count)
            continue;
        if (!rule[i].value)
            return piece_fault(f, FAULT_PARAM_SYNTAX, &all, "%s=... is missing", rule[i].name);
        if (*rule[i].value && list_read(&value[i], &rule[i], piece_all(all.param, rule[i].value, NULL), f) < 0)
            return -1;
    }
    return 0;
}

static bool all_alike(const struct key_value *v, enum shape shape)
{
    for (unsigned i = 1; i < v->count; i++) {
        for (unsigned c = 0; c < (shape == SHAPE_TINT ? 3 : 1); c++)
            if (v->v[i][c] != v->v[0][c])
                return false;
        if (shape == SHAPE_SIZE && v->unit[i] != v->unit[0])
            return false;
    }
    return true;
}

static void element_print(const struct key_value *v, unsigned i, enum shape shape, struct printer *to)
{
    if (shape == SHAPE_SIZE) {
        print_size(to, &(struct size){ v->v[i][0], v->unit[i] });
    } else if (shape == SHAPE_TINT) {
        print_tint(to, v->v[i]);
    } else {
        print_text(to, number_print(v->v[i][0]).s);
        print_text(to, shape == SHAPE_PERCENT ? "%" : "");
    }
}

void keys_print(const struct key_value *value, const struct key_rule *rule, unsigned count,
                struct printer *to)
{
    bool first = true;
    for (unsigned i = 0; i < count; i++) {
        const struct key_value *v = &value[i];
        const enum shape shape = rule[i].shape;
        bool alike = all_alike(v, shape);
        if (!v->count || (shape == SHAPE_TINT && alike && v->v[0][0] == 1 && v->v[0][1] == 1 && v->v[0][2] == 1))
            continue;
        print_text(to, first ? "" : ",");
        print_text(to, rule[i].name);
        print_text(to, "=");
        first = false;
        for (unsigned k = 0; k < (alike && rule[i].alike ? 1 : v->count); k++) {
            print_text(to, k ? "/" : "");
            element_print(v, k, shape, to);
        }
    }
}
