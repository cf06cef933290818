/* SPDX-License-Identifier: Apache-2.0 */
/*
 * daemon_exr.h - EXR files of any channels for tests through a daemon: written by hand from the format's description, read back
 * by the OpenEXR C++ library, so that neither end shares a mistake with the daemon's codec.
 */
#ifndef TEST_DAEMON_EXR_H
#define TEST_DAEMON_EXR_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct exr_plane {
    const char *name;    /* "glow.R" */
    const double *value; /* width * height; the caller's */
};

struct exr_file {
    int32_t min_x, min_y; /* of the data window */
    uint32_t width, height;
    uint32_t display_width, display_height; /* from (0, 0) */
    float aspect;
    bool half; /* else float */
    unsigned planes;
    const struct exr_plane *plane; /* in the order of their names, as the format wants them */
};

/* One scanline part, uncompressed. malloc'ed. */
uint8_t *exr_file_make(const struct exr_file *f, size_t *bytes);
/* A channel of the first part, of halves or floats; *width and *height are its size. malloc'ed; NULL: there is none such. */
double *exr_file_plane(const uint8_t *file, size_t bytes, const char *name, bool half, uint32_t *width, uint32_t *height);

#endif
