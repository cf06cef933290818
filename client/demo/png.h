/* SPDX-License-Identifier: Apache-2.0 */
/*
 * png.h - 8-bit RGB pictures to PNG files.
 */
#ifndef AIRY_DEMO_PNG_H
#define AIRY_DEMO_PNG_H

#include <stdint.h>

/* rgb: 3 bytes a pixel, row after row. 0, or -1 with a line on stderr. */
int png_write(const char *path, const uint8_t *rgb, int width, int height);

#endif
