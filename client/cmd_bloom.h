/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_bloom.h - the options of airy bloom, as a table: for the parser and for the help text. The
 * parameters' rows are made from proto/params.def.
 */
#ifndef AIRY_CMD_BLOOM_H
#define AIRY_CMD_BLOOM_H

#include "cmd_options.h"

enum bloom_option {
    BLOOM_OUTPUT,
    BLOOM_FRAMES,
    BLOOM_JOBS,
    BLOOM_PART,
    BLOOM_LAYER,
    BLOOM_VIEW,
    BLOOM_PIXELS,
    BLOOM_COMPRESSION,
    BLOOM_SOCKET,
    BLOOM_DEVICE,
    BLOOM_OVERWRITE,
    BLOOM_NO_OVERWRITE,
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

#endif
