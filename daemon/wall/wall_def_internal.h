/* SPDX-License-Identifier: Apache-2.0 */
/*
 * wall_def_internal.h - what the wall_def_*.c files share: the tree that a definition's YAML becomes, the readers of
 * its values, and the list of mistakes. Nothing else includes it.
 *
 * Invariant: reading goes on after a mistake, with the default in the place of what is wrong, so that one run tells them
 * all. What the contradictions' check (wall_def_check.c) looks at is in range even then: every reader leaves its output
 * alone unless the value is good.
 */
#ifndef AIRYD_WALL_DEF_INTERNAL_H
#define AIRYD_WALL_DEF_INTERNAL_H

#include "wall_def.h"

enum { WALL_DEPTH_MAX = 8 };

enum wall_node_kind { NODE_TEXT, NODE_LIST, NODE_MAP };

struct wall_node {
    enum wall_node_kind kind;
    unsigned line, column;         /* from 1 */
    struct wall_node *parent, *first, *last, *next;
    struct wall_node *made_before; /* all nodes, for freeing */
    const char *key;               /* of a map's value; NULL: an element of a list, or the root */
    unsigned key_line, key_column;
    unsigned index;                /* in the parent */
    unsigned count;                /* children */
    bool quoted;
    char text[];                   /* of NODE_TEXT; no NUL within */
};

enum { WALL_GROUPS_MAX = 4 * WALL_PANELS_MAX };
struct wall_group { /* a name: of a panel, or of all panels of a grid */
    char name[WALL_NAME_MAX];
    unsigned first, count; /* count 0: there is a mistake in it, told already */
    const struct wall_node *at;
};

struct wall_run_at {
    struct wall_run run;
    const struct wall_node *at;
};

struct wall_reader {
    struct wall_def *d;
    struct wall_mistakes *m;
    struct wall_node *nodes; /* owned */
    bool no_memory;
    bool size_given;
    unsigned n_groups;
    struct wall_group *group; /* [WALL_GROUPS_MAX], sorted by name before boards are read */
    const struct wall_node **panel_at, **board_at, **supply_at; /* where each is said, for messages */
    struct wall_run_at *run;                               /* [WALL_RUNS_MAX], in the order of the text */
    const struct wall_node *rate_at;                       /* NULL: not said */
};

/* ---- wall_def_tree.c: YAML -> tree; mistakes ---------------------------------------------------------------- */

/* NULL when there is a mistake that leaves no tree. The nodes are the reader's. */
struct wall_node *wall_tree_read(struct wall_reader *r, const char *text, size_t bytes);
void wall_tree_free(struct wall_reader *r);

/* "boards[0].order: " and the text, at that node; NULL: line 1. */
void wall_mistake(struct wall_reader *r, const struct wall_node *at, const char *format, ...)
    __attribute__((format(printf, 3, 4)));
void wall_note(struct wall_reader *r, const struct wall_node *at, const char *format, ...)
    __attribute__((format(printf, 3, 4)));
/* What is at that node, for "found ...": "\"RGX\"", "a list of 3", "nothing". */
struct wall_found {
    char s[56];
};
struct wall_found wall_found(const struct wall_node *n);

/* ---- wall_def_value.c: values --------------------------------------------------------------------------------- */

/* The values of a map by their keys' places in `keys` (NULL: not said). Unknown and repeated keys are mistakes. False: no
 * map. */
bool wall_keys(struct wall_reader *r, const struct wall_node *map, const char *const *keys, unsigned count,
               const struct wall_node *value[]);
/* Each reads *n if n is not NULL, and complains if the value is not as said; true: *out was set. */
bool wall_number(struct wall_reader *r, const struct wall_node *n, double min, double max, const char *what, double *out);
bool wall_share(struct wall_reader *r, const struct wall_node *n, double *out); /* 0..1, or "80%" */
bool wall_whole(struct wall_reader *r, const struct wall_node *n, uint32_t min, uint32_t max, const char *what,
                uint32_t *out);
bool wall_pair(struct wall_reader *r, const struct wall_node *n, uint32_t min, uint32_t max, const char *what,
               uint32_t out[2]);
bool wall_numbers(struct wall_reader *r, const struct wall_node *n, unsigned count, double min, double max,
                  const char *what, double out[]);
/* Seconds. forever: may it be? (INFINITY then) */
bool wall_time(struct wall_reader *r, const struct wall_node *n, double max_s, bool forever, double *out);
bool wall_yes(struct wall_reader *r, const struct wall_node *n, bool *out);
/* words: "fill contain stretch"; *out: the word's place. */
bool wall_word(struct wall_reader *r, const struct wall_node *n, const char *words, unsigned *out);
/* 1 to size - 1 bytes of text. */
bool wall_text(struct wall_reader *r, const struct wall_node *n, const char *what, char *out, size_t size);
/* A decimal number that is all of s[0..length): no blanks, no hexadecimal, no nan, no inf. */
bool wall_number_scan(const char *s, size_t length, double *out);
/* The first element of a list of at least one; NULL: there is none. */
const struct wall_node *wall_elements(struct wall_reader *r, const struct wall_node *n, const char *what);

/* ---- the parts of a definition -------------------------------------------------------------------------------- */

void wall_read_picture(struct wall_reader *r, const struct wall_node *n);
void wall_read_colour(struct wall_reader *r, const struct wall_node *n); /* wall_def_colour.c */
void wall_read_panels(struct wall_reader *r, const struct wall_node *n); /* wall_def_panels.c */
void wall_read_supplies(struct wall_reader *r, const struct wall_node *n);
void wall_read_boards(struct wall_reader *r, const struct wall_node *n); /* wall_def_boards.c */
/* The panels of a name, or of "a to b": first and count. */
bool wall_panels_named(struct wall_reader *r, const struct wall_node *n, unsigned *first, unsigned *count);
struct wall_wiring {
    bool columns, serpentine;
    enum wall_corner origin;
};
void wall_read_wiring(struct wall_reader *r, const struct wall_node *n, struct wall_wiring *out);
/* Contradictions between the parts; wall_def_check.c. Sorts the runs. */
void wall_def_check(struct wall_reader *r);

#endif
