/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_options.h - command lines: "--name value", "--name=value", "-n value", operands, "--". What is
 * wrong is said on stderr, with the nearest name that exists.
 */
#ifndef AIRY_CMD_OPTIONS_H
#define AIRY_CMD_OPTIONS_H

#include <stdbool.h>
#include <stddef.h>

struct option_row {
    const char *name;  /* without the dashes */
    char letter;       /* 0: none */
    const char *value; /* what it takes, for the help text; NULL: nothing */
    const char *help;
};

struct options {
    int argc, at;
    char **argv;
    const struct option_row *rows;
    size_t n_rows;
    bool operands_only;
};

enum { OPTIONS_END = -1, OPTIONS_OPERAND = -2, OPTIONS_WRONG = -3 };

/* argv[0] is skipped. */
void options_init(struct options *o, int argc, char **argv, const struct option_row *rows,
                  size_t n_rows);
/* The index of the next option's row, with *value, or one of the above (an operand is in *value). */
int options_next(struct options *o, const char **value);

/* The candidate that `word` was probably meant to be, or NULL. */
const char *nearest_name(const char *word, const char *const *candidates, size_t n);

#endif
