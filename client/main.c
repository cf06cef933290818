// SPDX-License-Identifier: Apache-2.0
// main.c - the airy command: which subcommand, and what its end means to a shell.
#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "cmd.h"
#include "cmd_cleanup.h"
#include "cmd_options.h"

void cmd_complain(const char *format, ...)
{
    va_list args;
    va_start(args, format);
    fputs("airy: ", stderr);
    vfprintf(stderr, format, args);
    fputc('\n', stderr);
    va_end(args);
}

int cmd_connect(struct airy **out, const char *socket, struct airy_error *e)
{
    *out = NULL;
    if (airy_connect(out, socket, e) < 0)
        return -1;
    airy_set_reconnect(*out, 0);
    return 0;
}

/* PROTOCOL.md's codes by hundreds: 2xx the request (20x its parameters), 3xx the file, 4xx and 5xx the
 * daemon's state. Negative: errno of this side. */
enum cmd_exit cmd_exit_of(const struct airy_error *e)
{
    static const int may_pass[] = { ECONNREFUSED, ENOENT, ECONNRESET, EPIPE, ETIMEDOUT, EAGAIN, EPROTO };
    if (e->retryable)
        return CMD_RETRY;
    if (e->code >= 200 && e->code < 210)
        return CMD_USAGE;
    if ((e->code >= 210 && e->code < 400) || e->code == 401)
        return CMD_INPUT;
    for (unsigned i = 0; i < sizeof(may_pass) / sizeof(may_pass[0]); i++)
        if (e->code == -may_pass[i])
            return CMD_RETRY;
    return CMD_OTHER;
}

static enum cmd_exit dispatch(int argc, char **argv)
{
    static const char *const names[] = { "bloom", "plan", "status", "top", "wall", "help" };
    static enum cmd_exit (*const commands[])(int, char **) = { cmd_bloom, cmd_plan, cmd_status, cmd_top, cmd_wall,
                                                         cmd_help };
    enum { COMMANDS = sizeof(commands) / sizeof(commands[0]) };
    const char *word = argc > 1 ? argv[1] : "";
    if (strcmp(word, "--help") == 0 || strcmp(word, "-h") == 0)
        word = "help";
    if (strcmp(word, "--version") == 0 || strcmp(word, "-V") == 0) {
        puts("airy " AIRY_VERSION);
        return CMD_DONE;
    }
    for (unsigned i = 0; i < COMMANDS; i++)
        if (strcmp(word, names[i]) == 0)
            return commands[i](argc - 1, argv + 1);
    const char *best = *word ? nearest_name(word, names, COMMANDS) : NULL;
    if (!*word)
        cmd_complain("what to do? airy bloom IN OUT, or see airy --help");
    else if (best)
        cmd_complain("unknown command \"%s\"; did you mean airy %s?", word, best);
    else
        cmd_complain("unknown command \"%s\"; see airy --help", word);
    return CMD_USAGE;
}

int main(int argc, char **argv)
{
    cleanup_install();
    enum cmd_exit exit = dispatch(argc, argv);
    if ((fflush(stdout) != 0 || ferror(stdout)) && exit == CMD_DONE) {
        cmd_complain("standard output: %s", strerror(errno));
        exit = CMD_OUTPUT;
    }
    return (int)exit;
}
