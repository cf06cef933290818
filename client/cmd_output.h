/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_output.h - a result becomes a file, all or nothing: written under a hidden name in the same
 * folder, synced, renamed. Whatever fails, the file that was there stays as it was, and nothing
 * half-written is left.
 */
#ifndef AIRY_CMD_OUTPUT_H
#define AIRY_CMD_OUTPUT_H

#include <stdbool.h>
#include <stddef.h>

#include "airy.h"

enum { OUTPUT_WHY_MAX = 1024 };

/* Could a file be written there? For a failure before the work instead of after it. 0, or -1 and why
 * (OUTPUT_WHY_MAX bytes, naming the path). */
int output_check(const char *path, bool overwrite, char *why);
int output_write(const char *path, const struct airy_result *r, bool overwrite, char *why);

/* Removes the temporary files in a folder that nobody is writing any more, of the outputs for which is_ours says so (base: the
 * beginning of the output's name, output_is_base compares). Returns how many. */
unsigned output_clean(const char *folder, bool (*is_ours)(void *ctx, const char *base, size_t len), void *ctx);
bool output_is_base(const char *path, const char *base, size_t len);

#endif
