// SPDX-License-Identifier: Apache-2.0
// cmd_wall_stop.c - the second signal goes to the handler that was there before. Between a look and a wait the signals are blocked, so that
// none is missed.
#include "cmd_wall_stop.h"

#include <poll.h>
#include <signal.h>
#include <stddef.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static const int stopping[] = { SIGINT, SIGTERM, SIGHUP };
enum { N_STOPPING = sizeof(stopping) / sizeof(stopping[0]) };

static volatile sig_atomic_t asked;
static struct sigaction before[N_STOPPING];
static const char *restore;
static size_t restore_bytes;
static const struct termios *volatile restore_terminal;

static void last(int signal)
{
    if (restore_terminal)
        tcsetattr(STDIN_FILENO, TCSANOW, restore_terminal);
    if (restore_bytes && write(STDOUT_FILENO, restore, restore_bytes) < 0)
        _exit(128 + signal);
    for (unsigned i = 0; i < N_STOPPING; i++)
        if (stopping[i] == signal && before[i].sa_handler != SIG_DFL && before[i].sa_handler != SIG_IGN)
            before[i].sa_handler(signal); /* raises it again, with the default's action */
    _exit(128 + signal);
}

static void handle(int signal)
{
    if (asked)
        last(signal);
    asked = 1;
}

void stop_install(void)
{
    struct sigaction a = { .sa_handler = handle };
    for (unsigned i = 0; i < N_STOPPING; i++)
        if (sigaction(stopping[i], NULL, &before[i]) == 0 && before[i].sa_handler != SIG_IGN)
            sigaction(stopping[i], &a, NULL);
}

bool stop_asked(void) { return asked; }

void stop_restore(const char *text)
{
    restore_bytes = 0;
    restore = text;
    restore_bytes = text ? strlen(text) : 0;
}

void stop_restore_terminal(const struct termios *t) { restore_terminal = t; }

uint64_t stop_now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * UINT64_C(1000000000) + (uint64_t)t.tv_nsec;
}

void stop_wait(int fd, short events, uint64_t until_ns)
{
    struct pollfd p = { .fd = fd, .events = events };
    sigset_t set, saved;
    sigemptyset(&set);
    for (unsigned i = 0; i < N_STOPPING; i++)
        sigaddset(&set, stopping[i]);
    sigprocmask(SIG_BLOCK, &set, &saved);
    uint64_t now_ns = stop_now_ns(), left_ns = until_ns > now_ns ? until_ns - now_ns : 0;
    struct timespec left = { (time_t)(left_ns / 1000000000), (long)(left_ns % 1000000000) };
    if (!asked && left_ns)
        ppoll(&p, fd >= 0, &left, &saved);
    sigprocmask(SIG_SETMASK, &saved, NULL);
}
