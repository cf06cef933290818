/* SPDX-License-Identifier: Apache-2.0 */
/*
 * signs.h - neon: words and lines of glass tube on dark panels in the street.
 */
#ifndef AIRY_DEMO_SIGNS_H
#define AIRY_DEMO_SIGNS_H

#include <stdbool.h>

#include "street.h"

struct sign {
    const char *word;  /* letters; '-' is a line as long as the panel, '+' a cross */
    bool upright;      /* letters below each other */
    struct vec corner; /* lower left as it is read */
    struct vec across; /* direction of reading, unit */
    float letter;      /* height in metres */
    struct vec colour;
    float radiance;
    float shine; /* of the light that it throws */
};

enum { N_SIGNS = 9 };
extern const struct sign signs[N_SIGNS];

struct vec sign_middle(unsigned i); /* a little before the panel */
/* The nearest tube or panel before *t: moves *t, sets *light. */
bool signs_meet(struct vec o, struct vec d, float *t, struct vec *light);

#endif
