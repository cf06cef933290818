/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_run.h - carries frames through a daemon: several in flight, results written as they come, a bad
 * frame reported and passed over, a lost daemon found or started again. A frame whose output says by its stamp that it is of the
 * same request on the same input is left as it is: so that a run that ended early is ended by running it again.
 */
#ifndef AIRY_CMD_RUN_H
#define AIRY_CMD_RUN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "cmd.h"
#include "cmd_session.h"

struct run_frame {
    bool numbered;
    int64_t number;
    char *input, *output; /* owned by the list's owner, */
    char *model;          /* too: the file that a black frame in its place is like; NULL: none */

    enum { RUN_WAITING, RUN_IN_FLIGHT, RUN_ENDED } state;
    uint64_t id;
    unsigned tries;
    bool suspect; /* a daemon was lost while it was in flight */
    bool black; /* the input is one that the command made */
    bool asking, asked; /* whether the output is done already: in flight; it is not */
};

enum run_missing { RUN_MISSING_FAIL, RUN_MISSING_SKIP, RUN_MISSING_BLACK };

struct run_options {
    struct session_options session;
    struct airy_request request; /* everything but the input; files that it names are sent first */
    unsigned jobs;
    bool json, quiet, overwrite, force, fail_fast;
    enum run_missing on_missing;
};

enum { RUN_WHY_MAX = 512 };
/* A regular file for reading, or -1, errno and why. */
int run_input_open(const char *path, char *why, size_t size);

/* The exit status of the whole: that of the first frame that failed for good, else CMD_RETRY when any
 * failed at all, else CMD_DONE. A request that no frame can satisfy (a parameter) ends the run. */
enum cmd_exit run_frames(const struct run_options *o, struct run_frame *frames, size_t n);

#endif
