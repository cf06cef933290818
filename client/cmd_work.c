// SPDX-License-Identifier: Apache-2.0
// cmd_work.c - see cmd_work.h. Inputs and outputs are numbered independently: by an offset, or by a range of their own.
#include "cmd_work.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "frames.h"

void work_finish(struct work *w)
{
    for (size_t i = 0; i < w->n; i++) {
        free(w->frames[i].input);
        free(w->frames[i].output);
        free(w->frames[i].model);
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
    if (a->offset || a->output_frames) {
        cmd_complain("bloom: --%s: the input \"%s\" has no frame token such as ####", a->offset ? "offset" : "output-frames",
                     a->input);
        return CMD_USAGE;
    }
    w->frames = calloc(1, sizeof(*w->frames));
    if (!w->frames)
        return no_memory();
    w->n = 1;
    w->frames[0].input = strdup(a->input);
    w->frames[0].output = strdup(a->output);
    return w->frames[0].input && w->frames[0].output ? CMD_DONE : no_memory();
}

static enum cmd_exit work_fill(struct work *w, const struct frames_list *in, const struct frames_list *out,
                               const struct frames_pattern *in_name, const struct frames_pattern *out_name)
{
    w->frames = calloc(in->count, sizeof(*w->frames));
    if (!w->frames)
        return no_memory();
    for (; w->n < in->count; w->n++) {
        struct run_frame *f = &w->frames[w->n];
        f->numbered = true;
        f->number = in->frame[w->n];
        f->input = frames_name(in_name, f->number);
        f->output = frames_name(out_name, out->frame[w->n]);
        if (!f->input || !f->output) {
            w->n++;
            return no_memory();
        }
    }
    return CMD_DONE;
}

static int by_input(const void *a, const void *b)
{
    return strcmp((*(const struct run_frame *const *)a)->input, (*(const struct run_frame *const *)b)->input);
}

/* A run that writes what it has yet to read would depend on the order of its frames. */
static enum cmd_exit check_apart(const struct work *w)
{
    const struct run_frame **sorted = malloc(w->n * sizeof(*sorted));
    enum cmd_exit exit = CMD_DONE;
    if (!sorted)
        return no_memory();
    for (size_t i = 0; i < w->n; i++)
        sorted[i] = &w->frames[i];
    qsort(sorted, w->n, sizeof(*sorted), by_input);
    for (size_t i = 0; i < w->n && exit == CMD_DONE; i++) {
        const struct run_frame key = { .input = w->frames[i].output }, *at = &key;
        const struct run_frame **same = bsearch(&at, sorted, w->n, sizeof(*sorted), by_input);
        if (same && *same != &w->frames[i]) {
            cmd_complain("bloom: \"%s\" would be written for the input \"%s\", and is an input itself", w->frames[i].output,
                         w->frames[i].input);
            exit = CMD_USAGE;
        }
    }
    free(sorted);
    return exit;
}

/* ---- black frames: what they are like ------------------------------------------------------------ */

/* The nearest number that is there. */
static size_t nearest(const struct frames_list *there, int64_t frame)
{
    size_t from = 0, to = there->count;
    while (from < to) {
        size_t middle = from + (to - from) / 2;
        if (there->frame[middle] < frame)
            from = middle + 1;
        else
            to = middle;
    }
    if (from == there->count || (from > 0 && frame - there->frame[from - 1] <= there->frame[from] - frame))
        from--;
    return from;
}

/* Of the pattern on the disk, not of the range: so that a part of the range, on another machine, finds the same. */
static enum cmd_exit models_find(struct work *w, const struct frames_pattern *in)
{
    struct frames_list there = { 0 };
    char why[FRAMES_WHY_MAX];
    enum cmd_exit exit = CMD_DONE;
    if (frames_scan(&there, in, why) < 0) {
        cmd_complain("bloom: --on-missing black: %s", why);
        return CMD_INPUT;
    }
    for (size_t i = 0; there.count && i < w->n && exit == CMD_DONE; i++) {
        struct run_frame *f = &w->frames[i];
        if (access(f->input, F_OK) == 0 || errno != ENOENT)
            continue;
        f->model = frames_name(in, there.frame[nearest(&there, f->number)]);
        exit = f->model ? CMD_DONE : no_memory();
    }
    frames_list_finish(&there);
    return exit;
}

/* ---- ranges ----------------------------------------------------------------------------------------- */

static enum cmd_exit input_frames(struct frames_list *l, const struct bloom_asked *a, const struct frames_pattern *in)
{
    char why[FRAMES_WHY_MAX];
    if (in->n_tokens == 0) {
        cmd_complain("bloom: -f %s: the input \"%s\" has no frame token such as ####", a->frames, a->input);
        return CMD_USAGE;
    }
    if ((a->frames ? frames_parse(l, a->frames, why) : frames_scan(l, in, why)) < 0) {
        cmd_complain("bloom: %s", why);
        return a->frames ? CMD_USAGE : CMD_INPUT;
    }
    if (l->count > 0)
        return CMD_DONE;
    cmd_complain("bloom: no file is named as \"%s\"", a->input);
    return CMD_INPUT;
}

static int list_copy(struct frames_list *to, const struct frames_list *from)
{
    to->frame = malloc(from->count * sizeof(*to->frame));
    if (!to->frame)
        return -1;
    memcpy(to->frame, from->frame, from->count * sizeof(*to->frame));
    to->count = from->count;
    return 0;
}

static enum cmd_exit output_frames(struct frames_list *l, const struct bloom_asked *a, const struct frames_list *in)
{
    char why[FRAMES_WHY_MAX];
    int64_t offset = 0;
    if (a->output_frames ? frames_parse(l, a->output_frames, why) < 0
                         : a->offset && frames_parse_offset(&offset, a->offset, why) < 0) {
        cmd_complain("bloom: --%s: %s", a->output_frames ? "output-frames" : "offset", why);
        return CMD_USAGE;
    }
    if (a->output_frames && l->count != in->count) {
        cmd_complain("bloom: --output-frames %s: %zu frames; as many as the inputs' %zu expected", a->output_frames, l->count,
                     in->count);
        return CMD_USAGE;
    }
    if (a->output_frames)
        return CMD_DONE;
    if (list_copy(l, in) < 0)
        return no_memory();
    if (frames_shift(l, offset, why) == 0)
        return CMD_DONE;
    cmd_complain("bloom: --offset %s: %s", a->offset, why);
    return CMD_USAGE;
}

static enum cmd_exit work_range(struct work *w, const struct bloom_asked *a, const struct frames_pattern *in,
                                const struct frames_pattern *out)
{
    struct frames_list from = { 0 }, to = { 0 };
    enum cmd_exit exit = input_frames(&from, a, in);
    /* Also of one frame: the next part of a range would go over it. */
    if (exit == CMD_DONE && out->n_tokens == 0) {
        cmd_complain("bloom: %zu frame%s of a range, and the output \"%s\" has no frame token such as ####", from.count,
                     from.count == 1 ? "" : "s", a->output);
        exit = CMD_USAGE;
    }
    if (exit == CMD_DONE)
        exit = output_frames(&to, a, &from);
    if (exit == CMD_DONE)
        exit = work_fill(w, &from, &to, in, out);
    if (exit == CMD_DONE)
        exit = check_apart(w);
    if (exit == CMD_DONE && a->run.on_missing == RUN_MISSING_BLACK)
        exit = models_find(w, in);
    frames_list_finish(&from);
    frames_list_finish(&to);
    return exit;
}

/* A name that is there is itself, whatever is in it. */
enum cmd_exit work_init(struct work *w, const struct bloom_asked *a)
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
