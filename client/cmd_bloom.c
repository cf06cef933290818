// SPDX-License-Identifier: Apache-2.0
// cmd_bloom.c - airy bloom: from a command line (airy plan's, too) to a list of frames and one request. The daemon judges
// parameters; the command only carries them.
#include "cmd_bloom.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cmd.h"
#include "cmd_work.h"

enum { JOBS_MAX = 64, PRIORITY_MIN = -10, PRIORITY_MAX = 10 };

const struct option_row bloom_options[BLOOM_OPTIONS] = {
    [BLOOM_OUTPUT] = { "output", 'o', "FILE",
                       "where to; with several frames a pattern such as out.####.exr" },
    [BLOOM_FRAMES] = { "frames", 'f', "RANGE", "1-100, 1-100x2, 1,5,9-12, 1-2x0.5; default: the frames on disk" },
    [BLOOM_OFFSET] = { "offset", 0, "N", "frame F is written as frame F + N" },
    [BLOOM_OUTPUT_FRAMES] = { "output-frames", 0, "RANGE",
                              "the outputs' numbers, one for each of the inputs', in their order" },
    [BLOOM_ON_MISSING] = { "on-missing", 0, "WORD",
                           "a frame whose input is not there: fail, skip or black (default fail)" },
    [BLOOM_PRIORITY] = { "priority", 0, "N", "among your own frames that wait for their turn, -10 to 10: higher first (default 0)" },
    [BLOOM_DEADLINE] = { "deadline", 0, "TIME",
                         "longest wait of a frame for its turn, such as 90s, 1.5m or 500ms; then it fails with status 5" },
    [BLOOM_JOBS] = { "jobs", 'j', "N", "frames in flight at once, 1 to 64 (default 4)" },
    [BLOOM_PART] = { "part", 0, "N|NAME", "part of the file (default: the beauty of each colour part)" },
    [BLOOM_LAYER] = { "layer", 0, "NAME",
                      "layer whose R, G, B are bloomed (default: the unprefixed ones)" },
    [BLOOM_VIEW] = { "view", 0, "NAME", "one stereo view (default: all)" },
    [BLOOM_PIXELS] = { "pixels", 0, "TYPE",
                       "of the bloomed channels: keep, half or float (default keep)" },
    [BLOOM_COMPRESSION] = { "compression", 0, "NAME",
                            "keep, none, rle, zips, zip, piz, pxr24, b44, b44a, dwaa or dwab (default "
                            "keep)" },
    [BLOOM_SOCKET] = { "socket", 0, "PATH", "the daemon's socket; no private daemon is started then" },
    [BLOOM_DEVICE] = { "device", 0, "NAME",
                       "start a private daemon on this device: cpu, gpu, a number or a name" },
    [BLOOM_OVERWRITE] = { "overwrite", 0, NULL, "replace outputs that are there (the default)" },
    [BLOOM_NO_OVERWRITE] = { "no-overwrite", 0, NULL, "refuse them instead" },
    [BLOOM_FORCE] = { "force", 0, NULL, "do frames, too, whose output is of the same request on the same input" },
    [BLOOM_KEEP_GOING] = { "keep-going", 0, NULL, "a bad frame does not stop the others (the default)" },
    [BLOOM_FAIL_FAST] = { "fail-fast", 0, NULL, "the first bad frame ends the run" },
    [BLOOM_JSON] = { "json", 0, NULL, "one JSON object a line and frame on standard output" },
    [BLOOM_QUIET] = { "quiet", 'q', NULL, "say nothing but errors" },
    [BLOOM_HELP] = { "help", 'h', NULL, "this text" },
/* --view was the stereo view's before the picture had views: those are --show. */
#define OPTION(name) (BLOOM_PARAM_##name == BLOOM_PARAM_view ? "show" : #name)
#define NUMBER(name, field, def, min, max, unit, help) [BLOOM_PARAM_##name] = { OPTION(name), 0, "N", help },
#define NUMBER_OR(name, field, flag, def, min, max, unit, word, help)                                   \
    [BLOOM_PARAM_##name] = { OPTION(name), 0, "N|" word, help },
#define CHOICE(name, field, def, words, help) [BLOOM_PARAM_##name] = { OPTION(name), 0, "WORD", help },
#define TEXT(name, field, def, help) [BLOOM_PARAM_##name] = { OPTION(name), 0, "TEXT", help },
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
};

static const char *const param_names[BLOOM_OPTIONS] = {
#define NUMBER(name, field, def, min, max, unit, help) [BLOOM_PARAM_##name] = #name,
#define CHOICE(name, field, def, words, help) [BLOOM_PARAM_##name] = #name,
#define TEXT(name, field, def, help) [BLOOM_PARAM_##name] = #name,
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
};

const char *bloom_param_name(int id) { return param_names[id]; }

static int operand(struct bloom_asked *a, const char *value)
{
    if (a->operands == 0)
        a->input = value;
    else if (a->operands == 1 && !a->output && a->command == BLOOM_FOR_FRAMES)
        a->output = value;
    else if (a->command == BLOOM_FOR_PLAN) {
        cmd_complain("plan: \"%s\": one input expected", value);
        return -1;
    } else {
        cmd_complain("bloom: \"%s\": one input and one output expected%s", value,
                     a->frames ? "" : " (quote a pattern: 'in.####.exr')");
        return -1;
    }
    a->operands++;
    return 0;
}

static int jobs_read(unsigned *jobs, const char *value)
{
    char *end;
    unsigned long n = strtoul(value, &end, 10);
    if (*value < '0' || *value > '9' || *end || n < 1 || n > JOBS_MAX) {
        cmd_complain("bloom: --jobs %s: a number from 1 to %d expected", value, JOBS_MAX);
        return -1;
    }
    *jobs = (unsigned)n;
    return 0;
}

static int priority_read(int *priority, const char *value)
{
    char *end;
    long n = strtol(value, &end, 10);
    if (!*value || *value == ' ' || *end || n < PRIORITY_MIN || n > PRIORITY_MAX) {
        cmd_complain("bloom: --priority %s: a number from %d to %d expected", value, PRIORITY_MIN, PRIORITY_MAX);
        return -1;
    }
    *priority = (int)n;
    return 0;
}

/* Seconds without a unit, so that it reads as every other time that people type. */
static int deadline_read(uint32_t *deadline_ms, const char *value)
{
    static const struct {
        const char *name;
        double ms;
    } units[] = { { "", 1e3 }, { "s", 1e3 }, { "ms", 1 }, { "m", 6e4 }, { "h", 3.6e6 } };
    char *end = (char *)value;
    double n = *value >= '0' && *value <= '9' ? strtod(value, &end) : -1;
    for (unsigned i = 0; i < sizeof(units) / sizeof(units[0]); i++)
        if (n > 0 && strcmp(end, units[i].name) == 0 && n * units[i].ms >= 1 && n * units[i].ms <= UINT32_MAX) {
            *deadline_ms = (uint32_t)(n * units[i].ms);
            return 0;
        }
    cmd_complain("bloom: --deadline %s: a time from 1ms to 1193h expected, such as 90s, 1.5m or 500ms", value);
    return -1;
}

static const char *command_name(const struct bloom_asked *a)
{
    return a->command == BLOOM_FOR_PLAN ? "plan" : "bloom";
}

static int param_add(struct bloom_asked *a, const char *name, const char *value)
{
    struct airy_error e;
    if (airy_request_param(&a->run.request, name, value, &e) == 0)
        return 0;
    cmd_complain("%s: --%s: %s", command_name(a), name, e.text);
    return -1;
}

static bool for_frames(int id)
{
    return (id >= BLOOM_OUTPUT && id <= BLOOM_JOBS) || (id >= BLOOM_OVERWRITE && id <= BLOOM_FAIL_FAST);
}

static int on_missing_read(enum run_missing *m, const char *value)
{
    static const char *const words[] = { [RUN_MISSING_FAIL] = "fail", [RUN_MISSING_SKIP] = "skip", [RUN_MISSING_BLACK] = "black" };
    for (unsigned i = 0; i < sizeof(words) / sizeof(words[0]); i++)
        if (strcmp(value, words[i]) == 0) {
            *m = (enum run_missing)i;
            return 0;
        }
    cmd_complain("bloom: --on-missing %s: fail, skip or black expected", value);
    return -1;
}

static int option(struct bloom_asked *a, int id, const char *value)
{
    struct airy_request *q = &a->run.request;
    const char **texts[] = { [BLOOM_FRAMES] = &a->frames,
                             [BLOOM_OFFSET] = &a->offset,
                             [BLOOM_OUTPUT_FRAMES] = &a->output_frames,
                             [BLOOM_PART] = &q->part,
                             [BLOOM_LAYER] = &q->layer,
                             [BLOOM_VIEW] = &q->view,
                             [BLOOM_PIXELS] = &q->pixels,
                             [BLOOM_COMPRESSION] = &q->compression,
                             [BLOOM_SOCKET] = &a->run.session.socket,
                             [BLOOM_DEVICE] = &a->run.session.device };
    if (a->command == BLOOM_FOR_PLAN && for_frames(id)) {
        cmd_complain("plan: --%s is for airy bloom: nothing is written", bloom_options[id].name);
        return -1;
    }
    switch (id) {
    case BLOOM_OUTPUT:
        if (a->output) {
            cmd_complain("bloom: two outputs, \"%s\" and \"%s\"", a->output, value);
            return -1;
        }
        a->output = value;
        return 0;
    case BLOOM_PRIORITY:
        return priority_read(&q->priority, value);
    case BLOOM_DEADLINE:
        return deadline_read(&q->deadline_ms, value);
    case BLOOM_JOBS:
        return jobs_read(&a->run.jobs, value);
    case BLOOM_OVERWRITE:
    case BLOOM_NO_OVERWRITE:
        a->run.overwrite = id == BLOOM_OVERWRITE;
        return 0;
    case BLOOM_FORCE:
        a->run.force = true;
        return 0;
    case BLOOM_KEEP_GOING:
    case BLOOM_FAIL_FAST:
        a->run.fail_fast = id == BLOOM_FAIL_FAST;
        return 0;
    case BLOOM_ON_MISSING:
        return on_missing_read(&a->run.on_missing, value);
    case BLOOM_JSON:
        a->run.json = true;
        return 0;
    case BLOOM_QUIET:
        a->run.quiet = true;
        return 0;
    case BLOOM_HELP:
        a->help = true;
        return 0;
    default:
        if (id >= BLOOM_PARAMS)
            return param_add(a, param_names[id], value);
        *texts[id] = value;
        return 0;
    }
}

int bloom_asked_read(struct bloom_asked *a, enum bloom_command command, int argc, char **argv)
{
    struct options o;
    const char *value;
    int id;
    a->command = command;
    options_init(&o, argc, argv, bloom_options, BLOOM_OPTIONS);
    while ((id = options_next(&o, &value)) != OPTIONS_END)
        if (id == OPTIONS_WRONG ||
            (id == OPTIONS_OPERAND ? operand(a, value) : option(a, id, value)) < 0)
            return -1;
    if (a->help)
        return 0;
    if (command == BLOOM_FOR_FRAMES && (!a->input || !a->output)) {
        cmd_complain("bloom: an input and an output expected: airy bloom IN OUT");
        return -1;
    }
    if (!a->input) {
        cmd_complain("plan: an input expected: airy plan IN");
        return -1;
    }
    if (a->offset && a->output_frames) {
        cmd_complain("bloom: --offset and --output-frames: one of them expected");
        return -1;
    }
    if (a->run.session.socket && a->run.session.device) {
        cmd_complain("%s: --device is for a private daemon; the one at --socket has its device", command_name(a));
        return -1;
    }
    return 0;
}

enum cmd_exit cmd_bloom(int argc, char **argv)
{
    static struct bloom_asked a = BLOOM_ASKED_INIT;
    struct work work;
    if (bloom_asked_read(&a, BLOOM_FOR_FRAMES, argc, argv) < 0)
        return CMD_USAGE;
    if (a.help)
        return cmd_help(2, (char *[]){ (char *)"help", (char *)"bloom", NULL });
    enum cmd_exit exit = work_init(&work, &a);
    if (exit == CMD_DONE)
        exit = run_frames(&a.run, work.frames, work.n);
    work_finish(&work);
    return exit;
}
