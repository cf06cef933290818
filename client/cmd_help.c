// SPDX-License-Identifier: Apache-2.0
// cmd_help.c - the help texts. Options and parameters come from their tables, and so cannot be out of
// date.
#include <ctype.h>
#include <stdio.h>
#include <string.h>

#include "cmd.h"
#include "cmd_bloom.h"
#include "cmd_help.h"

enum { WIDTH = 79, INDENT = 26 };

/* Text from column INDENT on, in lines of WIDTH; the first is begun already, at `column`. */
static void wrap(const char *text, int column)
{
    if (column >= INDENT) {
        putchar('\n');
        column = 0;
    }
    printf("%*s", INDENT - column, "");
    column = INDENT;
    while (*text) {
        int len = (int)strcspn(text, " ");
        if (len > WIDTH - INDENT) { /* of a long psf each key may have a line */
            const char *comma = memchr(text, ',', (size_t)len);
            len = comma ? (int)(comma - text) + 1 : len;
        }
        if (column > INDENT && column + 1 + len > WIDTH) {
            printf("\n%*s", INDENT, "");
            column = INDENT;
        } else if (column > INDENT && text[-1] == ' ') {
            putchar(' ');
            column++;
        }
        printf("%.*s", len, text);
        column += len;
        text += len + (text[len] == ' ');
    }
    putchar('\n');
}

void help_option(const struct option_row *r)
{
    char letter[8] = "    ";
    if (r->letter)
        snprintf(letter, sizeof(letter), "-%c, ", r->letter);
    char name[40];
    snprintf(name, sizeof(name), "%s", r->name);
    for (char *s = name; *s; s++)
        *s = *s == '_' ? '-' : *s;
    int column = printf("  %s--%s%s%s", letter, name, r->value ? " " : "", r->value ? r->value : "");
    wrap(r->help, column);
}

/* The word of a CHOICE's default: BRIGHT_KNEE is "knee". */
static const char *choice_word(const char *symbol, char *out, size_t size)
{
    const char *underscore = strrchr(symbol, '_');
    snprintf(out, size, "%s", underscore ? underscore + 1 : symbol);
    for (char *s = out; *s; s++)
        *s = (char)tolower((unsigned char)*s);
    return out;
}

void help_params(void)
{
    char text[512], word[32];
#define NUMBER_OR(name, field, flag, def, min, max, unit, instead, help)                                \
    help_option(&bloom_options[BLOOM_PARAM_##name]);                                                   \
    snprintf(text, sizeof(text), "[%s; %s to %s, or %s; default %s]", unit, #min, #max, instead, #def); \
    wrap(text, 0);
#define NUMBER(name, field, def, min, max, unit, help)                                                  \
    help_option(&bloom_options[BLOOM_PARAM_##name]);                                                   \
    snprintf(text, sizeof(text), "[%s; %s to %s; default %s]", unit, #min, #max, #def);                 \
    wrap(text, 0);
#define CHOICE(name, field, def, words, help)                                                           \
    help_option(&bloom_options[BLOOM_PARAM_##name]);                                                   \
    snprintf(text, sizeof(text), "[%s; default %s]", words, choice_word(#def, word, sizeof(word)));     \
    wrap(text, 0);
#define TEXT(name, field, def, help)                                                                    \
    help_option(&bloom_options[BLOOM_PARAM_##name]);                                                   \
    snprintf(text, sizeof(text), "[default %s]", *def ? def : "none");                                                \
    wrap(text, 0);
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
}

static void help_all(void)
{
    puts("airy " AIRY_VERSION " - blooms HDR EXR frames, with airyd\n"
         "\n"
         "  airy bloom IN OUT                                        one frame\n"
         "  airy bloom 'in.####.exr' -o 'out.####.exr' -f 1-100x2    a range, several in flight\n"
         "  airy plan IN                                             what would run, and its error bound\n"
         "  airy top                                                 who has what in a daemon, live\n"
         "  airy status [--json]                                     how a daemon is doing\n"
         "  airy wall ...                                            LED walls: airy wall --help\n"
         "  airy help bloom                                          every option and parameter\n"
         "  airy --version\n"
         "\n"
         "With no daemon running, airy bloom starts a private one for its own life.");
}

/* The texts' grammar is the daemon's (PROTOCOL.md section 9); this is what one needs at hand. */
static void help_texts(void)
{
    puts("\n"
         "Sizes: 8 or 8px (pixel heights), 0.5% (of the data window's diagonal), 0.3mm (on the sensor).\n"
         "\n"
         "Point spread functions (S a size, W a weight; R:G:B the tint of each Gaussian):\n"
         "  gaussians:sigma=S/S/..,weight=W/W/..[,tint=R:G:B/..]\n"
         "  octaves:sigma=S,count=N[,ratio=2][,weight=1][,slope=1][,bend=0][,tint=R:G:B/..]\n"
         "  octaves:sigma=S,count=N[,ratio=2],weights=W/W/..[,tint=R:G:B/..]\n"
         "  halation:sigma=S/S/S,gain=W/W/W                        for R/G/B\n"
         "  eye:[degrees=40][,weight=0.1]                          glare of the eye\n"
         "  airy:[f=8][,pitch=5][,wavelength=610/550/465][,weight=0.1]\n"
         "  aperture:[blades=6][,rotation=0][,f=..., as airy]      starburst\n"
         "  image:FILE[,weight=0.1]                                a kernel (or the DIGEST of a sent one)\n"
         "\n"
         "Views, for --show and --layers: final, source, bright (what glows), bloom (the glow), level:N\n"
         "(that of Gaussian N, from 0), residual (the scene without what glows). Layers become channels\n"
         "airy.bright.R and so on. --view is the stereo view.\n"
         "\n"
         "A look brings its own threshold, knee, intensity and emission, and refuses what it does not\n"
         "have. Contradictions are errors that name the parameter.");
}

static void help_bloom(void)
{
    puts("airy bloom IN OUT [options]\n"
         "airy bloom 'in.####.exr' -o 'out.####.exr' [-f RANGE] [options]\n"
         "\n"
         "Adds a bloom to EXR frames. All else in the file stays as it is: other channels, parts,\n"
         "attributes, windows. Each output appears whole or not at all. #### is the frame's number\n"
         "(also #, @@@, %04d, $F4). Where a parameter takes the digest of an image, a file that is there\n"
         "(--dirt FILE, --psf image:FILE) is sent to the daemon first. A frame whose output is there\n"
         "already, of the same request on the same input, is left as it is.\n"
         "\n"
         "Options:");
    for (unsigned i = 0; i < BLOOM_PARAMS; i++)
        help_option(&bloom_options[i]);
    puts("\nParameters of the bloom:");
    help_params();
    help_texts();
    puts("\nExit status: 0 all done; 2 usage; 3 input; 4 output; 5 may be tried again as it is; 1 "
         "other.\n"
         "See airy(1).");
}

static void help_plan(void)
{
    puts("airy plan IN [options]\n"
         "\n"
         "Says what airy bloom would run for this file with these options, without running it: of each\n"
         "target the plan, its rule, how numbers are stored between the passes, the error bound, and the\n"
         "time on the device as predicted. What would be skipped depends on the pixels, and is not known.\n"
         "\n"
         "Options: those of airy bloom (airy help bloom) that are not about outputs and ranges.\n"
         "\n"
         "Exit status: as airy bloom's.");
}

static void help_status(void)
{
    puts("airy status [--socket PATH] [--json | --prometheus]\n"
         "\n"
         "Asks the daemon at PATH (default: $AIRY_SOCKET, $XDG_RUNTIME_DIR/airyd.sock,\n"
         "/run/airyd/airyd.sock) for its device, its queue, its counts and its times.\n"
         "--prometheus prints them, the users, the memory and the walls as Prometheus scrapes them.\n"
         "\n"
         "Exit status: 0 it answered; 5 none answers; 2 usage.");
}

static void help_top(void)
{
    puts("airy top [--socket PATH] [--once] [--json]\n"
         "\n"
         "Once a second: users with what they have in the daemon and their share of the device, the queue,\n"
         "memory against its ceiling, the times of the stages, the walls. On a terminal it is drawn over; q or\n"
         "ctrl-C ends it. A daemon that goes away is waited for.\n"
         "\n"
         "Exit status: 0 stopped, or --once answered; 5 none answers; 2 usage.");
}

enum cmd_exit cmd_help(int argc, char **argv)
{
    if (argc > 2) {
        cmd_complain("help: one topic expected: bloom, plan, status or top");
        return CMD_USAGE;
    }
    if (argc < 2)
        help_all();
    else if (strcmp(argv[1], "bloom") == 0)
        help_bloom();
    else if (strcmp(argv[1], "plan") == 0)
        help_plan();
    else if (strcmp(argv[1], "status") == 0)
        help_status();
    else if (strcmp(argv[1], "top") == 0)
        help_top();
    else {
        cmd_complain("help: no topic \"%s\"; there are bloom, plan, status and top", argv[1]);
        return CMD_USAGE;
    }
    return CMD_DONE;
}
