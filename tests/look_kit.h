/* SPDX-License-Identifier: Apache-2.0 */
/*
 * look_kit.h - a frame for the tests of looks, with the layers that may stand beside it, its run on the device, and the float64
 * reference of it. Everything in a struct scene is scene_finish's to free but the planes, which are the slot's.
 */
#ifndef AIRY_LOOK_KIT_H
#define AIRY_LOOK_KIT_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>

#include "bloom.h"
#include "look.h"
#include "reference_look.h"

enum { SCENE, SOURCE, MATTE, DEPTH, ROLES };

struct scene {
    unsigned width, height, channels;
    enum pixel_type type;
    double *plane[ROLES][3], *want[3], *out[3];
    bool with[ROLES];
    struct frame_scan scan[ROLES];
    struct planes in[ROLES], out_planes[ROLES * BLOOM_OUTPUTS_MAX];
    struct bloom_reply reply;
    double aspect, exposure;
    float luma[3];
};

/* Noise, lamps and a block; the caller may change planes until it runs. */
void scene_init(struct scene *s, unsigned w, unsigned h, unsigned channels, enum pixel_type type);
void scene_finish(struct scene *s);
/* Rounds the planes to the type, blooms them, takes the result into out: 0, or -1 and *f. */
int scene_try(struct scene *s, const struct params *p, struct bloom *b, struct fault *f);
void scene_run(struct scene *s, const struct params *p, struct bloom *b);
/* Every pixel against the reference; the worst error over the largest value, 1e-5 and the reply's bound at most. */
double scene_check(struct scene *s, const struct params *p, const char *what);
/* Another output into out; the reference into want. */
void scene_take(struct scene *s, const struct planes *out);
void scene_reference(struct scene *s, const struct params *p);

#endif
