// SPDX-License-Identifier: Apache-2.0
// cmd_wall_asked.c - see cmd_wall_asked.h. The daemon judges names and parameters; here are only numbers read.
#include "cmd_wall_asked.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cmd.h"
#include "cmd_bloom.h"
#include "cmd_help.h"

enum { PARAMS = BLOOM_OPTIONS - BLOOM_PARAMS, ROWS_MAX = (int)WALL_OPTIONS + PARAMS };
enum { ALWAYS = 1 << WALL_OPTION_SOCKET | 1 << WALL_OPTION_HELP };

static const struct option_row wall_rows[WALL_OPTIONS] = {
    [WALL_OPTION_WALL] = { "wall", 'w', "FILE|NAME", "a definition, or the name of a wall that a daemon has open" },
    [WALL_OPTION_FRAMES] = { "frames", 'f', "RANGE", "1-100, 1-100x2, 1,5,9-12; default: the frames on disk" },
    [WALL_OPTION_FPS] = { "fps", 0, "N", "frames per second of the sequence (default: the wall's own rate)" },
    [WALL_OPTION_LOOP] = { "loop", 0, NULL, "begin again at the end; a still picture is held" },
    [WALL_OPTION_BOARD] = { "board", 0, "NAME", "pattern led: the board," },
    [WALL_OPTION_LED] = { "led", 0, "N", "and the LED's number on it, from 0" },
    [WALL_OPTION_LEVEL] = { "level", 0, "N", "linear light, above 0 to 1 (default 0.25)" },
    [WALL_OPTION_SECONDS] = { "seconds", 0, "N", "end after so long (default: Ctrl-C ends it)" },
    [WALL_OPTION_OUTPUT] = { "output", 'o', "FILE", "a PNG" },
    [WALL_OPTION_CELL] = { "cell", 0, "N", "pixels of the PNG a LED, 1 to 64 (default: as fits)" },
    [WALL_OPTION_LIVE] = { "live", 0, NULL, "in this terminal, until Ctrl-C" },
    [WALL_OPTION_ONCE] = { "once", 0, NULL, "once, instead of every second" },
    [WALL_OPTION_KEEP] = { "keep", 0, NULL, "the wall stays open when this command has ended" },
    [WALL_OPTION_FRAME] = { "frame", 0, "WxH", "the size of the whole frame, such as 1920x1080" },
    [WALL_OPTION_PART] = { "part", 0, "N|NAME", "part of the file" },
    [WALL_OPTION_LAYER] = { "layer", 0, "NAME", "layer whose R, G, B are shown" },
    [WALL_OPTION_VIEW] = { "view", 0, "NAME", "one stereo view" },
    [WALL_OPTION_SOCKET] = { "socket", 0, "PATH", "the daemon's socket; no private daemon is started then" },
    [WALL_OPTION_DEVICE] = { "device", 0, "NAME", "start a private daemon on this device: cpu, gpu, a number or a name" },
    [WALL_OPTION_JSON] = { "json", 0, NULL, "one JSON object a line on standard output" },
    [WALL_OPTION_HELP] = { "help", 'h', NULL, "this text" },
};

/* The rows that a subcommand takes; id[i]: row i is wall_rows', or from WALL_OPTIONS on a parameter. */
struct rows {
    struct option_row row[ROWS_MAX];
    int id[ROWS_MAX];
    size_t n;
};

static void rows_make(struct rows *r, const struct wall_syntax *s)
{
    r->n = 0;
    for (int i = 0; i < WALL_OPTIONS; i++)
        if ((s->options | ALWAYS) & 1u << i) {
            r->row[r->n] = wall_rows[i];
            r->id[r->n++] = i;
        }
    for (int i = BLOOM_PARAMS; s->params && i < BLOOM_OPTIONS; i++) {
        r->row[r->n] = bloom_options[i];
        r->id[r->n++] = WALL_OPTIONS + i - BLOOM_PARAMS;
    }
}

static int help(const struct wall_syntax *s, const struct rows *r)
{
    printf("%s\nOptions:\n", s->help);
    for (size_t i = 0; i < r->n && r->id[i] < WALL_OPTIONS; i++)
        help_option(&r->row[i]);
    if (s->params) {
        puts("\nParameters of the bloom:");
        help_params();
    }
    puts("\nExit status: 0 all done; 2 usage; 3 input; 4 output; 5 may be tried again as it is; 1 other.\nSee airy-wall(1).");
    return 1;
}

/* A number within bounds, all of the text. */
static int number(const struct wall_syntax *s, int id, const char *text, double min, double max, double *out)
{
    char *end;
    double v = strtod(text, &end);
    if (end != text && !*end && isfinite(v) && v >= min && v <= max) {
        *out = v;
        return 0;
    }
    cmd_complain("%s: --%s %s: a number from %.10g to %.10g expected", s->name, wall_rows[id].name, text, min, max);
    return -1;
}

static int whole(const struct wall_syntax *s, int id, const char *text, double min, double max, uint32_t *out)
{
    double v;
    if (number(s, id, text, min, max, &v) < 0)
        return -1;
    if (v != floor(v)) {
        cmd_complain("%s: --%s %s: a whole number expected", s->name, wall_rows[id].name, text);
        return -1;
    }
    *out = (uint32_t)v;
    return 0;
}

static int size(struct wall_asked *a, const struct wall_syntax *s, const char *text)
{
    char rest;
    if (*text >= '0' && *text <= '9' && sscanf(text, "%6ux%6u%c", &a->frame_width, &a->frame_height, &rest) == 2 &&
        a->frame_width && a->frame_height)
        return 0;
    cmd_complain("%s: --frame %s: width and height in pixels expected, such as 1920x1080", s->name, text);
    return -1;
}

static int param(struct wall_asked *a, const struct wall_syntax *s, int id, const char *value)
{
    struct airy_error e;
    const char *name = bloom_param_name(id - WALL_OPTIONS + BLOOM_PARAMS);
    if (airy_request_param(&a->request, name, value, &e) == 0)
        return 0;
    cmd_complain("%s: --%s: %s", s->name, name, e.text);
    return -1;
}

static int option(struct wall_asked *a, const struct wall_syntax *s, int id, const char *value)
{
    const char **texts[] = { [WALL_OPTION_WALL] = &a->wall,          [WALL_OPTION_FRAMES] = &a->frames,
                             [WALL_OPTION_BOARD] = &a->board,        [WALL_OPTION_OUTPUT] = &a->output,
                             [WALL_OPTION_PART] = &a->request.part,  [WALL_OPTION_LAYER] = &a->request.layer,
                             [WALL_OPTION_VIEW] = &a->request.view,  [WALL_OPTION_SOCKET] = &a->session.socket,
                             [WALL_OPTION_DEVICE] = &a->session.device };
    bool *flags[] = { [WALL_OPTION_LOOP] = &a->loop, [WALL_OPTION_LIVE] = &a->live, [WALL_OPTION_ONCE] = &a->once,
                      [WALL_OPTION_KEEP] = &a->keep, [WALL_OPTION_JSON] = &a->json };
    if (id >= WALL_OPTIONS)
        return param(a, s, id, value);
    switch (id) {
    case WALL_OPTION_FPS:
        return number(s, id, value, .01, 1000, &a->fps);
    case WALL_OPTION_LEVEL:
        return number(s, id, value, 1e-6, 1, &a->level);
    case WALL_OPTION_SECONDS:
        return number(s, id, value, .01, 1e9, &a->seconds);
    case WALL_OPTION_LED:
        a->has_led = true;
        return whole(s, id, value, 0, UINT32_MAX, &a->led);
    case WALL_OPTION_CELL:
        return whole(s, id, value, 1, 64, &a->cell);
    case WALL_OPTION_FRAME:
        return size(a, s, value);
    default:
        if (value)
            *texts[id] = value;
        else
            *flags[id] = true;
        return 0;
    }
}

static int operands_check(const struct wall_asked *a, const struct wall_syntax *s)
{
    if (a->operands >= s->operands_min && a->operands <= s->operands_max) {
        if (!a->session.socket || !a->session.device)
            return 0;
        cmd_complain("%s: --device is for a private daemon; the one at --socket has its device", s->name);
        return -1;
    }
    cmd_complain("%s: %s expected; see airy %s --help", s->name, s->expected, s->name);
    return -1;
}

int wall_asked_read(struct wall_asked *a, const struct wall_syntax *s, int argc, char **argv)
{
    static struct rows rows;
    struct options o;
    const char *value;
    int at;
    rows_make(&rows, s);
    argv[0] = (char *)s->name;
    options_init(&o, argc, argv, rows.row, rows.n);
    while ((at = options_next(&o, &value)) != OPTIONS_END) {
        if (at == OPTIONS_WRONG)
            return -1;
        if (at == OPTIONS_OPERAND) {
            if (a->operands < 2)
                a->operand[a->operands] = value;
            a->operands++;
        } else if (rows.id[at] == WALL_OPTION_HELP) {
            return help(s, &rows);
        } else if (option(a, s, rows.id[at], value) < 0) {
            return -1;
        }
    }
    return operands_check(a, s);
}
