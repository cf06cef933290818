/* SPDX-License-Identifier: Apache-2.0 */
/*
 * street.h - the demo's world: a street at night after rain, as a function from a ray to light.
 * Scene-linear, Rec.709; grey card near .2, lit windows near 2, neon 10 to 40, lamps up to 5000. Reads
 * only constants after street_init: any number of threads may trace.
 */
#ifndef AIRY_DEMO_STREET_H
#define AIRY_DEMO_STREET_H

#include <stdint.h>

struct vec {
    float x, y, z;
};

void street_init(void);
/* Light that comes in at (u, v), in picture heights from the middle, v up; *depth: metres along the axis
 * to the first surface, 1e4 for sky. random: the state of a generator of the caller's. */
struct vec street_look(float u, float v, uint32_t *random, float *depth);

#endif
