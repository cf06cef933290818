/* SPDX-License-Identifier: Apache-2.0 */
/*
 * look.h - the five named looks (METHODS section 2) as data: a list of stages and numbers, which one mechanism runs.
 */
#ifndef AIRYD_LOOK_H
#define AIRYD_LOOK_H

#include "bloom.h"

/* Blooms one target of the slot by params->look. exposure: stops in use (metered already). Fills the reply but for tiles, max_bright
 * and exposure. Called by bloom_run on the device thread. 0, or -1 and *f. */
int look_run(struct bloom *b, struct bloom_slot *s, unsigned target, const struct bloom_request *request,
             double exposure, struct bloom_reply *reply, struct fault *f);
/* Frees what look_run keeps between frames. */
struct look_targets;
void look_destroy(struct bloom *b, struct look_targets *t);
/* "half-gaussian": half size, 9 + 9 taps; ...: what would run, for people. */
int look_print(const struct params *p, uint32_t width, uint32_t height, char *out, size_t size);

#endif
