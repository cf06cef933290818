/* SPDX-License-Identifier: Apache-2.0 */
/*
 * picture.h - RGB pictures of floats to and from EXR, by OpenEXRCore, for the demo's own files.
 */
#ifndef AIRY_DEMO_PICTURE_H
#define AIRY_DEMO_PICTURE_H

#include <stddef.h>

struct picture {
    int width, height;
    float *rgb; /* 3 floats a pixel, row after row; owned */
    float *z;   /* depth, or NULL; owned */
};

/* 0, or -1 with a line on stderr. */
int picture_alloc(struct picture *p, int width, int height);
void picture_free(struct picture *p);
/* R, G, B, A as half and Z (when there is one) as float, ZIP, with a shot's usual attributes. */
int picture_write(const char *path, const struct picture *p);
int picture_read(struct picture *p, const char *path); /* R, G, B of the first part */

#endif
