/* SPDX-License-Identifier: Apache-2.0 */
/* wall_file.h - a wall's definition, and the calibration image that it names, from files: airyd --wall. */
#ifndef AIRYD_WALL_FILE_H
#define AIRYD_WALL_FILE_H

#include "job.h"

/* Opens the wall of this file; it stays open. Blocks on the disk: at the start only. 0, or -1 and *f, whose text names the file. */
int wall_file_open(struct walls *w, const struct job_env *env, const char *path, struct fault *f);

#endif
