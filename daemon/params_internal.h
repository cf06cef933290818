/* SPDX-License-Identifier: Apache-2.0 */
/*
 * params_internal.h - what the params_*.c files share: numbers and pieces of text, the one grammar of
 * "key=list,key=list", and a reader for each TEXT row of the table. Nothing outside params includes it.
 *
 * Invariant: a reader leaves *p alone when it fails, and else keeps the text in canonical form, so that equal
 * requests have equal texts.
 */
#ifndef AIRYD_PARAMS_INTERNAL_H
#define AIRYD_PARAMS_INTERNAL_H

#include "params.h"

/* The rows of the table by number: bit ROW_x of params.given. */
enum {
#define NUMBER(name, field, def, min, max, unit, help) ROW_##name,
#define CHOICE(name, field, def, words, help) ROW_##name,
#define TEXT(name, field, def, help) ROW_##name,
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
    N_ROWS
};
_Static_assert(N_ROWS <= 64, "params.given has a bit for each row");

static inline bool params_given(const struct params *p, unsigned row) { return p->given >> row & 1; }
const char *params_row_name(unsigned row);
/* The word that a CHOICE row has now: "mip-chain". */
struct printed_word {
    char s[32];
};
struct printed_word params_word(const struct params *p, unsigned row);
/* params_check.c: has the row a say in the result, the others being what they are? */
bool params_has_meaning(const struct params *p, unsigned row);

/* ---- params_text.c --------------------------------------------------------------------------------- */

struct quoted {
    char s[48];
};
struct printed {
    char s[32];
};
/* The first bytes of s for an error text: hostile bytes become '?'. */
struct quoted quote(const char *s, size_t len);
/* A decimal number that is all of s[0..len): no blanks, no hexadecimal. "nan" and "inf" are read, so
 * that the answer to them is about their value. */
bool number_read(const char *s, size_t len, double *out);
struct printed number_print(double v);

int param_fault(struct fault *f, enum fault_code code, const char *name, const char *format, ...)
    __attribute__((format(printf, 4, 5)));

/* Appends like snprintf: used counts what would have been written. */
struct printer {
    char *out;
    size_t size, used;
};
void print_text(struct printer *to, const char *text);
void print_size(struct printer *to, const struct size *s);
/* R:G:B */
void print_tint(struct printer *to, const double tint[3]);

/* A part of a parameter's text, for errors that say where. */
struct piece {
    const char *param, *text; /* the row; its whole text */
    const char *s;            /* inside text; NULL: piece_next has given all */
    size_t len;
    const char *usage; /* what could stand there; NULL: the fault says it all */
};
struct piece piece_all(const char *param, const char *text, const char *usage);
/* Takes what is before the next separator off *rest; "a//b" has three pieces. False after the last one. */
bool piece_next(struct piece *rest, char separator, struct piece *out);
bool piece_is(const struct piece *p, const char *word);
int piece_fault(struct fault *f, enum fault_code code, const struct piece *p, const char *format, ...)
    __attribute__((format(printf, 4, 5)));

/* what: "a weight". */
struct number_range {
    const char *what;
    double min, max;
};
struct size_range {
    const char *what;
    double min[3], max[3]; /* by enum size_unit */
};
extern const struct size_range sigma_range;
int piece_number(const struct piece *p, const struct number_range *range, double *out, struct fault *f);
int piece_size(const struct piece *p, const struct size_range *range, struct size *out, struct fault *f);
/* Three numbers of that range, R:G:B. */
int piece_tint(const struct piece *p, const struct number_range *range, double out[3], struct fault *f);
extern const struct number_range tint_range;

/* Keeps a canonical text in a field of the struct, or says that it is too long. */
int text_keep(char field[PARAMS_TEXT_MAX], const char *param, const struct printer *canonical, struct fault *f);

/* ---- params_keys.c --------------------------------------------------------------------------------- */

enum shape { SHAPE_NUMBER, SHAPE_WHOLE, SHAPE_PERCENT, SHAPE_SIZE, SHAPE_TINT };

/* One key of "key=element/element/..,key=...". */
struct key_rule {
    const char *name;
    enum shape shape;
    unsigned max;              /* elements */
    struct number_range range; /* not for SHAPE_SIZE, which has sigma_range */
    const char *value;         /* by default; NULL: the key must be given, "": no element then */
    bool channels;             /* one element, or one for each of R, G, B; one is made three */
    bool alike;                /* one element is said where all are alike */
};

struct key_value {
    unsigned count;
    double v[PARAMS_GAUSSIANS_MAX][3]; /* SHAPE_TINT: all three; else the first */
    enum size_unit unit[PARAMS_GAUSSIANS_MAX];
};

enum { KEYS_MAX = 8 };
/* items: what is after "kind:". value[i] belongs to rule[i]. 0, or -1 and *f. */
int keys_read(struct key_value *value, const struct key_rule *rule, unsigned count, struct piece items,
              struct fault *f);
/* The keys that have elements, in the rules' order; tints of 1:1:1 all over are left out. */
void keys_print(const struct key_value *value, const struct key_rule *rule, unsigned count,
                struct printer *to);

/* ---- a reader for each TEXT row ------------------------------------------------------------------------ */

int read_source(struct params *p, const char *text, struct fault *f);
int read_matte(struct params *p, const char *text, struct fault *f);
int read_psf(struct params *p, const char *text, struct fault *f); /* params_psf.c */
int read_dirt(struct params *p, const char *text, struct fault *f);
int read_grow(struct params *p, const char *text, struct fault *f);
int read_view(struct params *p, const char *text, struct fault *f);
int read_layers(struct params *p, const char *text, struct fault *f);
int read_tint(struct params *p, const char *text, struct fault *f);
int read_sun(struct params *p, const char *text, struct fault *f);
/* 32 hexadecimal digits, as lower case. */
int piece_digest(const struct piece *p, char out[33], struct fault *f);

#endif
