/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_exr.h - what the command itself reads and writes of the EXR format: a finished file's stamp, and a black frame like
 * another one. Files are anybody's: every size is checked against what is there before it is used.
 * Nothing here looks at pixels; those are the daemon's.
 */
#ifndef AIRY_CMD_EXR_H
#define AIRY_CMD_EXR_H

#include <stdbool.h>
#include <stdint.h>

enum { EXR_WHY_MAX = 512 };

/* Has a regular file at path an attribute "airy" that is a string? */
bool exr_has_stamp(const char *path);
/* Has it, and are all that it has this one? A part that was not bloomed has none, or that of an earlier run on the
 * input, and then the answer is no: rather a frame too often than one too few. */
bool exr_is_stamped(const char *path, const char *stamp);

/* A sealed memfd (the caller's) with an EXR file of zeros: the parts, names, channels and display windows of the file at
 * path, and data windows that are the display windows. Equal for all files of one format. -1 and why. */
int exr_black(const char *path, char why[EXR_WHY_MAX]);

#endif
