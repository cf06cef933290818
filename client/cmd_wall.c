// SPDX-License-Identifier: Apache-2.0
// cmd_wall.c - airy wall: which subcommand; and the two that need no daemon, check and draw.
#include "cmd_wall.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "cmd_options.h"
#include "cmd_wall_commands.h"
#include "wall_draw.h"

static const struct wall_command commands[] = {
    { "check", cmd_wall_check, "every mistake of a wall definition with its line, or what it amounts to" },
    { "draw", cmd_wall_draw, "the layout as a picture: LED order, panels, boards" },
    CMD_WALL_COMMANDS,
};
enum { COMMANDS = sizeof(commands) / sizeof(commands[0]) };

/* ---- files ---------------------------------------------------------------------------------------------------------- */

static enum cmd_exit input_fault(const char *path, const char *why)
{
    cmd_complain("wall: %s: %s", path, why);
    return CMD_INPUT;
}

/* One byte more than allowed is read, so that a file that is too large is known as such, also a pipe. */
enum cmd_exit wall_file_read(const char *path, char **text, size_t *bytes)
{
    struct stat s;
    enum { ROOM = WALL_TEXT_MAX + 1 };
    char *buffer = NULL;
    size_t used = 0;
    ssize_t n = 1;
    const int fd = open(path, O_RDONLY | O_CLOEXEC);
    enum cmd_exit result = CMD_DONE;
    if (fd < 0)
        return input_fault(path, strerror(errno));
    if (fstat(fd, &s) < 0 || S_ISDIR(s.st_mode))
        result = input_fault(path, "is a folder; expected a wall definition");
    else if (!(buffer = malloc(ROOM + 1)))
        result = input_fault(path, strerror(ENOMEM));
    while (result == CMD_DONE && used < ROOM && n != 0) {
        n = read(fd, buffer + used, ROOM - used);
        if (n < 0 && errno != EINTR)
            result = input_fault(path, strerror(errno));
        used += n > 0 ? (size_t)n : 0;
    }
    close(fd);
    if (result != CMD_DONE) {
        free(buffer);
        return result;
    }
    buffer[used] = '\0';
    *text = buffer;
    *bytes = used;
    return CMD_DONE;
}

/* As compilers print it, so that editors jump to it. */
static void print_mistakes(const char *path, const struct wall_mistakes *m, bool notes)
{
    for (unsigned i = 0; i < m->count; i++)
        fprintf(stderr, "%s:%u:%u: %s\n", path, m->at[i].line, m->at[i].column, m->at[i].text);
    for (unsigned i = 0; i < m->notes && notes; i++)
        fprintf(stderr, "%s:%u:%u: note: %s\n", path, m->note[i].line, m->note[i].column, m->note[i].text);
}

enum cmd_exit wall_file_parse(const char *path, bool notes, struct wall_def **out)
{
    static struct wall_mistakes m;
    struct fault f = { .code = FAULT_NONE };
    char *text;
    size_t bytes;
    enum cmd_exit result = wall_file_read(path, &text, &bytes);
    if (result != CMD_DONE)
        return result;
    if (wall_def_parse(out, text, bytes, &m, &f) < 0) {
        result = CMD_INPUT;
        print_mistakes(path, &m, false);
        if (!m.count)
            input_fault(path, f.text);
        else
            cmd_complain("wall: %s: %s%u mistake%s; see airy-wall(5)", path, m.more ? "more than " : "", m.count, m.count == 1 ? "" : "s");
    } else {
        print_mistakes(path, &m, notes);
    }
    free(text);
    return result;
}

/* ---- check ---------------------------------------------------------------------------------------------------------- */

static void print_times(const struct wall_def *d)
{
    printf("%s: %u x %u pixels, %.6g frames/s; without a source hold ", d->name, d->width, d->height, d->rate);
    if (isinf(d->hold_s))
        puts("forever");
    else
        printf("%.6g s, then fade %.6g s\n", d->hold_s, d->fade_s);
}

struct board_sum {
    uint32_t lit, strips;
    double amps; /* all LEDs that are wired, in full white, at the board's and the wall's brightness */
};

static struct board_sum board_sum(const struct wall_def *d, const struct wall_layout *l, unsigned i)
{
    const struct wall_board *b = &d->board[i];
    struct board_sum s = { 0, 0, 0 };
    unsigned used = 0;
    for (uint32_t k = 0; k < l->board[i].leds; k++)
        if (l->board[i].pixel[k] >= 0) {
            s.lit++;
            used |= b->kind == WALL_FADECANDY ? 1u << (k / b->width) : 0;
        }
    for (; used; used &= used - 1)
        s.strips++;
    s.amps = s.lit * (b->idle_amps + ((double)b->led_amps[0] + b->led_amps[1] + b->led_amps[2]) * b->brightness * d->brightness);
    return s;
}

static void print_boards(const struct wall_def *d, const struct wall_layout *l)
{
    for (unsigned i = 0; i < d->n_boards; i++) {
        const struct wall_board *b = &d->board[i];
        const struct board_sum s = board_sum(d, l, i);
        const bool named = strcmp(b->name, b->serial) != 0;
        printf("  board %-16s %s%s%s, %u of %u LEDs", b->name, b->kind == WALL_FADECANDY ? "fadecandy" : "gud", named ? " " : "",
               named ? b->serial : "", s.lit, l->board[i].leds);
        if (b->kind == WALL_FADECANDY)
            printf(" on %u strip%s, 1.32 ms of bus a frame", s.strips, s.strips == 1 ? "" : "s"); /* LED section 1: 1600 bytes */
        else
            printf(", %u bytes a frame", 3 * b->width * b->height);
        if (s.amps > 0)
            printf(", at most %.3g A%s%s", s.amps, b->supply < 0 ? "" : " from ", b->supply < 0 ? "" : d->supply[b->supply].name);
        putchar('\n');
    }
}

static void print_supplies(const struct wall_def *d, const struct wall_layout *l)
{
    for (unsigned k = 0; k < d->n_supplies; k++) {
        double amps = 0;
        for (unsigned i = 0; i < d->n_boards; i++)
            amps += d->board[i].supply == (int)k ? board_sum(d, l, i).amps : 0;
        const double limit = d->supply[k].amps;
        printf("  supply %-15s %.3g A in full white of %.6g A: %s\n", d->supply[k].name, amps, limit,
               amps > limit ? "bright pictures will be dimmed" : "enough");
    }
}

static void print_bus(const struct wall_def *d)
{
    unsigned fadecandies = 0;
    for (unsigned i = 0; i < d->n_boards; i++)
        fadecandies += d->board[i].kind == WALL_FADECANDY;
    if (fadecandies)
        printf("  bus: %u fadecand%s take %.3g ms of each %.3g ms, if all are on one full-speed bus\n", fadecandies,
               fadecandies == 1 ? "y" : "ies", 1.32 * fadecandies, 1000 / d->rate);
}

/* The file operand and options of check and draw. */
enum { WALL_OUTPUT, WALL_CELL, WALL_HELP, WALL_OPTIONS };
static const struct option_row rows[WALL_OPTIONS] = {
    [WALL_OUTPUT] = { "output", 'o', "FILE.png", "" },
    [WALL_CELL] = { "cell", 0, "N", "" },
    [WALL_HELP] = { "help", 'h', NULL, "" },
};

struct asked {
    const char *file, *output;
    unsigned cell;
    bool help;
};

static bool read_cell(const char *text, unsigned *out)
{
    char *end;
    const unsigned long v = strtoul(text, &end, 10);
    if (*text < '0' || *text > '9' || *end || v < 1 || v > 256)
        return false;
    *out = (unsigned)v;
    return true;
}

static enum cmd_exit asked_read(struct asked *a, bool draw, int argc, char **argv)
{
    struct options o;
    const char *value;
    int id;
    *a = (struct asked){ .cell = 0 };
    argv[0] = draw ? (char *)"wall draw" : (char *)"wall check"; /* for what is said of wrong options */
    options_init(&o, argc, argv, rows, WALL_OPTIONS);
    while ((id = options_next(&o, &value)) != OPTIONS_END) {
        if (id == OPTIONS_WRONG)
            return CMD_USAGE;
        if (id == WALL_HELP) {
            a->help = true;
            return CMD_DONE;
        }
        if (id == OPTIONS_OPERAND && !a->file) {
            a->file = value;
        } else if (id == WALL_OUTPUT && draw) {
            a->output = value;
        } else if (id == WALL_CELL && draw) {
            if (!read_cell(value, &a->cell)) {
                cmd_complain("wall draw: --cell %s; expected pixels an LED, 1 to 256", value);
                return CMD_USAGE;
            }
        } else {
            cmd_complain("%s: \"%s\" is not expected", argv[0], id == OPTIONS_OPERAND ? value : rows[id].name);
            return CMD_USAGE;
        }
    }
    if (a->file && (a->output || !draw))
        return CMD_DONE;
    cmd_complain(draw ? "wall draw: expected a wall definition and a picture: airy wall draw FILE -o OUT.png"
                      : "wall check: expected a wall definition: airy wall check FILE");
    return CMD_USAGE;
}

int cmd_wall_check(int argc, char **argv)
{
    struct asked a;
    struct wall_def *d = NULL;
    struct wall_layout *l = NULL;
    struct fault f;
    enum cmd_exit result = asked_read(&a, false, argc, argv);
    if (a.help) {
        puts("airy wall check FILE\n"
             "\n"
             "Reads a wall definition (airy-wall(5)) and tells every mistake as FILE:LINE:COLUMN: what was found;\n"
             "what was expected. Of a good one it prints what it amounts to: LEDs, boards, strips, bus time, amps;\n"
             "and notes about what is possible, but perhaps not meant. Needs no daemon and no hardware.\n"
             "\n"
             "  airy wall check stage.yaml\n"
             "\n"
             "Exit status: 0 no mistakes; 2 usage; 3 mistakes, or no such file.");
        return CMD_DONE;
    }
    if (result != CMD_DONE || (result = wall_file_parse(a.file, true, &d)) != CMD_DONE)
        return result;
    if (wall_layout_make(&l, d, &f) < 0) {
        cmd_complain("wall check: %s", f.text);
        result = CMD_OTHER;
    } else {
        print_times(d);
        uint64_t leds = 0;
        for (unsigned i = 0; i < d->n_panels; i++)
            leds += (uint64_t)d->panel[i].width * d->panel[i].height;
        printf("  %u panel%s with %llu LEDs, %u of them on %u board%s\n", d->n_panels, d->n_panels == 1 ? "" : "s",
               (unsigned long long)leds, l->lit, d->n_boards, d->n_boards == 1 ? "" : "s");
        print_boards(d, l);
        print_supplies(d, l);
        print_bus(d);
    }
    wall_layout_free(l);
    wall_def_free(d);
    return result;
}

/* ---- draw ----------------------------------------------------------------------------------------------------------- */

static enum cmd_exit draw(const struct asked *a, const struct wall_def *d)
{
    struct wall_layout *l = NULL;
    struct wall_picture p = { .rgb = NULL };
    struct fault f;
    enum cmd_exit result = CMD_DONE;
    if (wall_layout_make(&l, d, &f) < 0 || wall_draw_layout(&p, d, l, a->cell, &f) < 0)
        result = f.code == FAULT_LIMIT ? CMD_USAGE : CMD_OTHER;
    else if (wall_picture_write_png(&p, a->output, &f) < 0)
        result = CMD_OUTPUT;
    if (result == CMD_DONE)
        fprintf(stderr, "%s: %u x %u\n", a->output, p.width, p.height);
    else
        cmd_complain("wall draw: %s", f.text);
    wall_picture_free(&p);
    wall_layout_free(l);
    return result;
}

int cmd_wall_draw(int argc, char **argv)
{
    struct asked a;
    struct wall_def *d;
    enum cmd_exit result = asked_read(&a, true, argc, argv);
    if (a.help) {
        puts("airy wall draw FILE -o OUT.png [--cell N]\n"
             "\n"
             "Draws a wall definition's layout as its front is seen: each LED in its board's colour, the wire as a line with\n"
             "arrow heads where it turns, the first LED of each run ringed and marked board:LED, panels with their\n"
             "names, a legend. --cell: pixels an LED, 1 to 256; by default the longer side is about 1600 pixels, and\n"
             "from 26 on LEDs have their numbers.\n"
             "\n"
             "  airy wall draw stage.yaml -o stage.png\n"
             "\n"
             "Exit status: 0 done; 2 usage; 3 mistakes in the definition, or no such file; 4 the picture cannot be written.");
        return CMD_DONE;
    }
    if (result != CMD_DONE || (result = wall_file_parse(a.file, false, &d)) != CMD_DONE)
        return result;
    result = draw(&a, d);
    wall_def_free(d);
    return result;
}

/* ---- which ---------------------------------------------------------------------------------------------------------- */

static void help(void)
{
    puts("airy wall - LED walls: what is where, and what is shown\n");
    for (unsigned i = 0; i < COMMANDS; i++)
        printf("  airy wall %-9s %s\n", commands[i].name, commands[i].help);
    puts("\nairy wall SUBCOMMAND --help tells more, so does airy-wall(1); airy-wall(5) is the language of wall definitions.");
}

enum cmd_exit cmd_wall(int argc, char **argv)
{
    const char *names[COMMANDS];
    const char *word = argc > 1 ? argv[1] : "";
    if (strcmp(word, "--help") == 0 || strcmp(word, "-h") == 0 || strcmp(word, "help") == 0) {
        help();
        return CMD_DONE;
    }
    for (unsigned i = 0; i < COMMANDS; i++) {
        names[i] = commands[i].name;
        if (strcmp(word, names[i]) == 0)
            return (enum cmd_exit)commands[i].run(argc - 1, argv + 1);
    }
    const char *best = *word ? nearest_name(word, names, COMMANDS) : NULL;
    if (!*word)
        cmd_complain("wall: what to do? airy wall check FILE, or see airy wall --help");
    else if (best)
        cmd_complain("wall: unknown subcommand \"%s\"; did you mean airy wall %s?", word, best);
    else
        cmd_complain("wall: unknown subcommand \"%s\"; see airy wall --help", word);
    return CMD_USAGE;
}
