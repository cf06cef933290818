// SPDX-License-Identifier: Apache-2.0
// cmd_wall.c - airy wall SUBCOMMAND: which one.
#include <stdio.h>
#include <string.h>

#include "cmd.h"
#include "cmd_options.h"
#include "cmd_wall_commands.h"

struct subcommand {
    const char *name;
    int (*run)(int argc, char **argv);
    const char *help;
};

static const struct subcommand subcommands[] = {
    CMD_WALL_COMMANDS,
};
enum { SUBCOMMANDS = sizeof(subcommands) / sizeof(subcommands[0]) };

static enum cmd_exit help(void)
{
    puts("airy wall SUBCOMMAND - LED walls\n");
    for (unsigned i = 0; i < SUBCOMMANDS; i++)
        printf("  airy wall %-9s %s\n", subcommands[i].name, subcommands[i].help);
    puts("\nairy wall SUBCOMMAND --help says more; see airy-wall(1).");
    return CMD_DONE;
}

enum cmd_exit cmd_wall(int argc, char **argv)
{
    const char *names[SUBCOMMANDS], *word = argc > 1 ? argv[1] : "";
    if (strcmp(word, "--help") == 0 || strcmp(word, "-h") == 0 || strcmp(word, "help") == 0)
        return help();
    for (unsigned i = 0; i < SUBCOMMANDS; i++) {
        names[i] = subcommands[i].name;
        if (strcmp(word, names[i]) == 0)
            return (enum cmd_exit)subcommands[i].run(argc - 1, argv + 1);
    }
    const char *best = *word ? nearest_name(word, names, SUBCOMMANDS) : NULL;
    if (best)
        cmd_complain("wall: unknown subcommand \"%s\"; did you mean airy wall %s?", word, best);
    else
        cmd_complain("wall: %s%s%s; see airy wall --help", *word ? "unknown subcommand \"" : "a subcommand expected", word,
                     *word ? "\"" : "");
    return CMD_USAGE;
}
