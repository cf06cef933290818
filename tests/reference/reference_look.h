/* SPDX-License-Identifier: Apache-2.0 */
/*
 * reference_look.h - the five named looks in scalar float64, straight from METHODS section 2 and the choices that
 * daemon/look.h writes down: the truth that tests/test_look.c compares with. Shares no code with the daemon but struct params.
 */
#ifndef AIRY_REFERENCE_LOOK_H
#define AIRY_REFERENCE_LOOK_H

#include "params.h"

struct reference_look_frame {
    unsigned width, height, channels;
    const double *plane[3];  /* I */
    const double *source[3]; /* S; NULL: I */
    const double *matte;     /* NULL: none */
    const double *depth;     /* NULL: none */
    double luma[3];          /* of one plane: not looked at */
    double pixel_aspect, exposure; /* stops in use */
    unsigned display_width;
};

/* out[c]: width * height, the caller's. view: final, source, bright or bloom. 0, or -1 (no memory). */
int reference_look(double *const out[3], const struct reference_look_frame *f, const struct params *p, enum view view);

#endif
