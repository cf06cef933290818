/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_output.h - a result becomes a file, all or nothing: written under a hidden name in the same
 * folder, synced, renamed. Whatever fails, the file that was there stays as it was, and nothing
 * half-written is left.
 */
#ifndef AIRY_CMD_OUTPUT_H
#define AIRY_CMD_OUTPUT_H

#include <stdbool.h>

#include "airy.h"

enum { OUTPUT_WHY_MAX = 1024 };

/* Could a file be written there? For a failure before the work instead of after it. 0, or -1 and why
 * (OUTPUT_WHY_MAX bytes, naming the path). */
int output_check(const char *path, bool overwrite, char *why);
int output_write(const char *path, const struct airy_result *r, bool overwrite, char *why);

#endif
