/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_work.h - which frames a command line means: pairs of an input and an output, from patterns, ranges and the disk.
 * Invariant: no two frames have one output, and no output is another frame's input.
 */
#ifndef AIRY_CMD_WORK_H
#define AIRY_CMD_WORK_H

#include "cmd_bloom.h"

struct work {
    struct run_frame *frames; /* owned, with their strings */
    size_t n;
};

/* CMD_DONE, or what is wrong, which was said. */
enum cmd_exit work_init(struct work *w, const struct bloom_asked *a);
void work_finish(struct work *w); /* after work_init, however it ended */

#endif
