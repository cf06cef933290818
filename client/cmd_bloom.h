/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_bloom.h - the options of airy bloom and airy plan, as a table: for the parser and for the help text. The
 * parameters' rows are made from proto/params.def.
 */
#ifndef AIRY_CMD_BLOOM_H
#define AIRY_CMD_BLOOM_H

#include "cmd_options.h"
#include "cmd_run.h"

enum bloom_option {
    BLOOM_OUTPUT,
    BLOOM_FRAMES,
    BLOOM_OFFSET,
    BLOOM_OUTPUT_FRAMES,
    BLOOM_ON_MISSING,
    BLOOM_PRIORITY,
    BLOOM_DEADLINE,
    BLOOM_JOBS, /* up to here for airy bloom alone */
    BLOOM_PART,
    BLOOM_LAYER,
    BLOOM_VIEW,
    BLOOM_PIXELS,
    BLOOM_COMPRESSION,
    BLOOM_SOCKET,
    BLOOM_DEVICE,
    BLOOM_OVERWRITE, /* these, too */
    BLOOM_NO_OVERWRITE,
    BLOOM_FORCE,
    BLOOM_KEEP_GOING,
    BLOOM_FAIL_FAST,
    BLOOM_JSON,
    BLOOM_QUIET,
    BLOOM_HELP,
    BLOOM_PARAMS, /* the first parameter's number, too */
    BLOOM_BEFORE_PARAMS = BLOOM_PARAMS - 1,
#define NUMBER(name, field, def, min, max, unit, help) BLOOM_PARAM_##name,
#define CHOICE(name, field, def, words, help) BLOOM_PARAM_##name,
#define TEXT(name, field, def, help) BLOOM_PARAM_##name,
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
    BLOOM_OPTIONS
};

extern const struct option_row bloom_options[BLOOM_OPTIONS];

/* The parameter of an option from BLOOM_PARAMS on: --show sets "view". */
const char *bloom_param_name(int id);

enum bloom_command { BLOOM_FOR_FRAMES, BLOOM_FOR_PLAN };

struct bloom_asked { /* strings: argv's */
    enum bloom_command command;
    struct run_options run;
    const char *input, *output, *frames, *offset, *output_frames;
    unsigned operands;
    bool help;
};
#define BLOOM_ASKED_INIT                                                                                \
    {                                                                                                   \
        .run = {.request = AIRY_REQUEST_INIT, .jobs = 4, .overwrite = true }                            \
    }

/* 0, or -1: said what is wrong. With help nothing else is checked. */
int bloom_asked_read(struct bloom_asked *a, enum bloom_command command, int argc, char **argv);

#endif
