// SPDX-License-Identifier: Apache-2.0
// cmd_bloom.c - airy bloom: from a command line (airy plan's, too) to a list of frames and one request. The daemon judges
// parameters; the command only carries them.
#include "cmd_bloom.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "cmd.h"
#include "frames.h"

enum { JOBS_MAX = 64 };

const struct option_row bloom_options[BLOOM_OPTIONS] = {
    [BLOOM_OUTPUT] = { "output", 'o', "FILE",
                       "where to; with several frames a pattern such as out.####.exr" },
    [BLOOM_FRAMES] = { "frames", 'f', "RANGE", "1-100, 1-100x2, 1,5,9-12; default: the frames on disk" },
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
    return id == BLOOM_OUTPUT || id == BLOOM_FRAMES || id == BLOOM_JOBS || id == BLOOM_OVERWRITE ||
           id == BLOOM_NO_OVERWRITE;
}

static int option(struct bloom_asked *a, int id, const char *value)
{
    struct airy_request *q = &a->run.request;
    const char **texts[] = { [BLOOM_FRAMES] = &a->frames,
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
    case BLOOM_JOBS:
        return jobs_read(&a->run.jobs, value);
    case BLOOM_OVERWRITE:
    case BLOOM_NO_OVERWRITE:
        a->run.overwrite = id == BLOOM_OVERWRITE;
        return 0;
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
    if (a->run.session.socket && a->run.session.device) {
        cmd_complain("%s: --device is for a private daemon; the one at --socket has its device", command_name(a));
        return -1;
    }
    return 0;
}

/* ---- which frames ------------------------------------------------------------------------------- */

struct work {
    struct run_frame *frames;
    size_t n;
};

static void work_finish(struct work *w)
{
    for (size_t i = 0; i < w->n; i++) {
        free(w->frames[i].input);
        free(w->frames[i].output);
    }
    free(w->frames);
}

static enum cmd_exit no_memory(void)
{
    cmd_complain("bloom: out of memory");
    return CMD_OTHER;
}

static enum cmd_exit work_single(struct work *w, const struct bloom_asked *a)
{
    w->frames = calloc(1, sizeof(*w->frames));
    if (!w->frames)
        return no_memory();
    w->n = 1;
    w->frames[0].input = strdup(a->input);
    w->frames[0].output = strdup(a->output);
    return w->frames[0].input && w->frames[0].output ? CMD_DONE : no_memory();
}

static enum cmd_exit work_fill(struct work *w, const struct frames_list *l,
                               const struct frames_pattern *in, const struct frames_pattern *out)
{
    w->frames = calloc(l->count, sizeof(*w->frames));
    if (!w->frames)
        return no_memory();
    for (; w->n < l->count; w->n++) {
        struct run_frame *f = &w->frames[w->n];
        f->numbered = true;
        f->number = l->frame[w->n];
        f->input = frames_name(in, f->number);
        f->output = frames_name(out, f->number);
        if (!f->input || !f->output) {
            w->n++;
            return no_memory();
        }
    }
    return CMD_DONE;
}

static enum cmd_exit work_range(struct work *w, const struct bloom_asked *a, const struct frames_pattern *in,
                                const struct frames_pattern *out)
{
    struct frames_list l = { 0 };
    char why[FRAMES_WHY_MAX];
    enum cmd_exit exit = CMD_DONE;
    if (a->frames && in->n_tokens == 0) {
        cmd_complain("bloom: -f %s: the input \"%s\" has no frame token such as ####", a->frames,
                     a->input);
        return CMD_USAGE;
    }
    if ((a->frames ? frames_parse(&l, a->frames, why) : frames_scan(&l, in, why)) < 0) {
        cmd_complain("bloom: %s", why);
        return a->frames ? CMD_USAGE : CMD_INPUT;
    }
    if (l.count == 0) {
        cmd_complain("bloom: no file is named as \"%s\"", a->input);
        exit = CMD_INPUT;
    } else if (l.count > 1 && out->n_tokens == 0) {
        cmd_complain("bloom: %zu frames, and the output \"%s\" has no frame token such as ####", l.count,
                     a->output);
        exit = CMD_USAGE;
    } else {
        exit = work_fill(w, &l, in, out);
    }
    frames_list_finish(&l);
    return exit;
}

/* A name that is there is itself, whatever is in it. */
static enum cmd_exit work_init(struct work *w, const struct bloom_asked *a)
{
    struct frames_pattern in, out;
    char why[FRAMES_WHY_MAX];
    *w = (struct work){ 0 };
    if (!a->frames && access(a->input, F_OK) == 0)
        return work_single(w, a);
    if (frames_pattern_init(&in, a->input, why) < 0) {
        cmd_complain("bloom: %s", why);
        return CMD_USAGE;
    }
    enum cmd_exit exit = CMD_USAGE;
    if (frames_pattern_init(&out, a->output, why) < 0) {
        cmd_complain("bloom: %s", why);
    } else {
        exit = !a->frames && in.n_tokens == 0 ? work_single(w, a) : work_range(w, a, &in, &out);
        frames_pattern_finish(&out);
    }
    frames_pattern_finish(&in);
    return exit;
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
