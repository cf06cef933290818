// SPDX-License-Identifier: Apache-2.0
// progress.c - draws at most ten times a second: a terminal over a slow line must not hold up the
// frames.
#include "progress.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void clock_text(char *out, size_t size, double s)
{
    unsigned long t = s > 359999 ? 359999 : s > 0 ? (unsigned long)(s + .5) : 0;
    if (t >= 3600)
        snprintf(out, size, "%lu:%02lu:%02lu", t / 3600, t / 60 % 60, t % 60);
    else
        snprintf(out, size, "%lu:%02lu", t / 60, t % 60);
}

void progress_render(char *out, size_t size, unsigned columns, size_t done, size_t failed, size_t total,
                     double elapsed_s)
{
    char tail[128], eta[24], trouble[40] = "", bar[64];
    unsigned room;
    double rate = elapsed_s > 0 ? (double)done / elapsed_s : 0;
    if (done)
        clock_text(eta, sizeof(eta), (double)(total - done) / rate);
    else
        snprintf(eta, sizeof(eta), "-");
    if (failed)
        snprintf(trouble, sizeof(trouble), ", %zu failed", failed);
    int len = snprintf(tail, sizeof(tail), " %zu/%zu  %.3g frames/s  ETA %s%s", done, total, rate, eta,
                       trouble);
    room = columns > (unsigned)len + 12 ? columns - (unsigned)len - 2 : 0;
    room = room > 50 ? 50 : room;
    unsigned full = total ? (unsigned)((double)room * (double)done / (double)total) : 0;
    memset(bar, '#', full);
    memset(bar + full, '.', room - full);
    bar[room] = '\0';
    size_t limit = columns + 1 < size ? columns + 1 : size;
    if (room)
        snprintf(out, limit, "[%s]%s", bar, tail);
    else
        snprintf(out, limit, "%s", tail + 1);
}

static void draw(struct progress *p)
{
    struct winsize w;
    char line[256];
    unsigned columns = ioctl(STDERR_FILENO, TIOCGWINSZ, &w) == 0 && w.ws_col ? w.ws_col : 80;
    progress_render(line, sizeof(line), columns - 1, p->done, p->failed, p->total, now_s() - p->start_s);
    fprintf(stderr, "\r\033[K%s", line);
    fflush(stderr);
    p->drawn = true;
    p->drawn_s = now_s();
}

static void erase(struct progress *p)
{
    if (p->drawn)
        fputs("\r\033[K", stderr);
    p->drawn = false;
}

void progress_begin(struct progress *p, size_t total, bool quiet)
{
    *p = (struct progress){ .total = total, .quiet = quiet, .start_s = now_s() };
    p->bar = !quiet && total > 1 && isatty(STDERR_FILENO);
    if (p->bar)
        draw(p);
}

void progress_step(struct progress *p, bool failed)
{
    p->done++;
    p->failed += failed;
    if (p->bar && (now_s() - p->drawn_s > .1 || p->done == p->total))
        draw(p);
}

void progress_end(struct progress *p)
{
    double elapsed_s = now_s() - p->start_s;
    erase(p);
    if (!p->quiet && p->total > 1)
        fprintf(stderr, "%zu of %zu frames done in %.3g s (%.3g frames/s)\n", p->done - p->failed,
                p->total, elapsed_s, elapsed_s > 0 ? (double)p->done / elapsed_s : 0);
}

__attribute__((format(printf, 2, 0))) static void say(struct progress *p, const char *format,
                                                      va_list args)
{
    erase(p);
    vfprintf(stderr, format, args);
    fputc('\n', stderr);
    if (p->bar)
        draw(p);
}

void progress_line(struct progress *p, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    if (!p->quiet)
        say(p, format, args);
    va_end(args);
}

void progress_error(struct progress *p, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    say(p, format, args);
    va_end(args);
}
