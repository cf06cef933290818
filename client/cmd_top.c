// SPDX-License-Identifier: Apache-2.0
/*
 * cmd_top.c - airy top: once a second, who has what in a daemon, how much room is left, and how long the stages take. On a terminal it is drawn
 * over (cmd_top_screen.h), else written as lines. A daemon that has answered once may go: it is waited for.
 */
#include <errno.h>
#include <pwd.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "cmd.h"
#include "cmd_json.h"
#include "cmd_options.h"
#include "cmd_report.h"
#include "cmd_top_screen.h"
#include "cmd_wall_stop.h"
#include "cmd_wall_text.h"

enum { TIMEOUT_MS = 5000, BAR = 30, BAR_TEXT = 36, NARROW = 110 };
enum { TOP_SOCKET, TOP_JSON, TOP_ONCE, TOP_HELP, TOP_OPTIONS };

static const struct option_row rows[TOP_OPTIONS] = {
    [TOP_SOCKET] = { "socket", 0, "PATH", "" },
    [TOP_JSON] = { "json", 0, NULL, "" },
    [TOP_ONCE] = { "once", 0, NULL, "" },
    [TOP_HELP] = { "help", 'h', NULL, "" },
};

struct top {
    const char *socket;
    bool json, once;
    bool screen, answered;
    unsigned shown;   /* how often, as lines */
    unsigned columns; /* 0: as many as it takes */
    FILE *out;        /* where the text goes before it is shown */
    struct airy *airy; /* NULL: gone */
    struct airy_status now, before; /* before.uptime_s 0: none */
    struct airy_wall_reply *walls;  /* NULL: none */
    struct airy_error lost;         /* while it is gone */
};

static double per_second(const struct top *t, uint64_t now, uint64_t before)
{
    double seconds = t->now.uptime_s - t->before.uptime_s;
    return t->before.uptime_s > 0 && seconds > 0 && now >= before ? (double)(now - before) / seconds : 0;
}

static void bar(const struct top *t, const char *name, uint64_t used, uint64_t most)
{
    const unsigned room = !t->columns || t->columns > BAR + BAR_TEXT ? BAR : t->columns > BAR_TEXT ? t->columns - BAR_TEXT : 1;
    const unsigned n = most ? (unsigned)((double)used / (double)most * room + 0.5) : 0;
    fprintf(t->out, "  %-9s[", name);
    for (unsigned i = 0; i < room; i++)
        putc(i < n ? '#' : ' ', t->out);
    fprintf(t->out, "] %.1f of %.1f MB\n", 1e-6 * (double)used, 1e-6 * (double)most);
}

static const struct airy_status_user *user_before(const struct top *t, uint32_t uid)
{
    for (unsigned i = 0; i < t->before.n_users; i++)
        if (t->before.user[i].uid == uid)
            return &t->before.user[i];
    return NULL;
}

static void say_users(const struct top *t)
{
    fputs("\n  user          conns   reqs queued  running   fds         MB   device s  device %\n", t->out);
    for (unsigned i = 0; i < t->now.n_users; i++) {
        const struct airy_status_user *u = &t->now.user[i], *b = user_before(t, u->uid);
        const struct passwd *p = getpwuid(u->uid);
        double seconds = t->now.uptime_s - t->before.uptime_s;
        char name[24];
        snprintf(name, sizeof(name), "%u", u->uid);
        fprintf(t->out, "  %-12.12s %6u %6u %6u %8u %5u %10.1f %10.1f  ", p ? p->pw_name : name, u->connections, u->requests, u->queued,
               u->running, u->fds, 1e-6 * (double)u->bytes, u->device_ms / 1e3);
        if (b && t->before.uptime_s > 0 && seconds > 0)
            fprintf(t->out, "%8.0f\n", (u->device_ms - b->device_ms) / seconds / 10);
        else
            fputs("       -\n", t->out);
    }
}

static double share(const struct airy_status_stage *s, unsigned buckets, const double *ends, double part)
{
    uint64_t all = 0, sum = 0;
    for (unsigned i = 0; i <= buckets; i++)
        all += s->counts[i];
    for (unsigned i = 0; i < buckets && all; i++) {
        sum += s->counts[i];
        if ((double)sum >= part * (double)all)
            return ends[i];
    }
    return all ? -1 : 0;
}

static void say_stages(const struct top *t)
{
    const struct airy_status *s = &t->now;
    const double mean[] = { s->mean_ms.queue, s->mean_ms.load, s->mean_ms.decode, s->mean_ms.bloom, s->mean_ms.encode, s->mean_ms.total };
    fputs("\n  stage     mean ms of the last   half are within   99 % are within\n", t->out);
    for (unsigned i = 0; i < s->n_stages; i++) {
        fprintf(t->out, "  %-9s %19.1f", s->stage[i].name, i < sizeof(mean) / sizeof(mean[0]) ? mean[i] : 0);
        for (unsigned k = 0; k < 2; k++) {
            double ms = share(&s->stage[i], s->n_buckets, s->bucket_ms, k ? 0.99 : 0.5);
            if (ms < 0)
                fprintf(t->out, "        > %7.0f", s->n_buckets ? s->bucket_ms[s->n_buckets - 1] : 0);
            else
                fprintf(t->out, "   %12.1f   ", ms);
        }
        putc('\n', t->out);
    }
}

// In one line where there is room for it.
static void say_counts(const struct top *t)
{
    const struct airy_status *s = &t->now;
    const char *end = t->columns && t->columns < NARROW ? "\n  " : "; ";
    fprintf(t->out, "  %u clients, %u waiting, %u running%s%llu done (%.1f/s), %.1f megapixels/s%s%llu failed, %llu cancelled, %llu refused\n",
            s->clients, s->queued, s->running, end, (unsigned long long)s->done, per_second(t, s->done, t->before.done),
            1e-6 * per_second(t, s->pixels, t->before.pixels), end, (unsigned long long)s->failed, (unsigned long long)s->cancelled,
            (unsigned long long)s->refused_busy);
}

static void say_text(const struct top *t)
{
    const struct airy_status *s = &t->now;
    if (!t->airy) {
        fprintf(t->out, "%s\n  it is asked again every second\n", t->lost.text);
        return;
    }
    fprintf(t->out, "%s%s on %s, up %.0f s\n", s->server, s->draining ? " (stopping)" : "", s->device, s->uptime_s);
    say_counts(t);
    bar(t, "payloads", s->memory.payloads, s->memory.payloads_max);
    bar(t, "loads", s->memory.loads, s->memory.loads_max);
    bar(t, "work", s->memory.work, s->memory.work_max);
    fprintf(t->out, "  resident %.1f MB, ceiling %.1f MB\n", 1e-6 * (double)s->rss_bytes, 1e-6 * (double)s->memory.ceiling);
    say_users(t);
    say_stages(t);
    for (unsigned i = 0; t->walls && i < t->walls->n_walls; i++) {
        if (!i)
            putc('\n', t->out);
        wall_text_stats(t->out, &t->walls->walls[i]);
    }
}

static void put_lines(const char *text)
{
    while (*text) {
        screen_put_line(stdout, text, 0);
        putchar('\n');
        text += strcspn(text, "\n");
        text += *text == '\n';
    }
    fflush(stdout);
}

static void show(struct top *t)
{
    char *text = NULL;
    size_t bytes;
    unsigned height;
    t->columns = 0;
    if (t->screen)
        screen_size(&t->columns, &height);
    t->out = open_memstream(&text, &bytes);
    if (!t->out)
        return;
    if (!t->screen && t->shown++)
        putc('\n', t->out); // from the one before
    say_text(t);
    if (fclose(t->out) == 0 && t->screen)
        screen_draw(text);
    else
        put_lines(text);
    free(text);
}

// One daemon's facts in one line: the status, and with it the walls.
static void say_json(const struct top *t)
{
    struct timespec at;
    struct json j = { .out = stdout };
    clock_gettime(CLOCK_REALTIME, &at);
    json_open(&j, NULL, '{');
    json_number(&j, "unix_s", (double)at.tv_sec + 1e-9 * (double)at.tv_nsec);
    report_json_status_fields(&j, &t->now);
    json_open(&j, "walls", '[');
    for (unsigned i = 0; t->walls && i < t->walls->n_walls; i++)
        wall_json_state(&j, NULL, &t->walls->walls[i]);
    json_close(&j, ']');
    json_close(&j, '}');
    json_line(&j);
}

static int ask(struct top *t, struct airy_error *e)
{
    const struct airy_wall_request list = { .action = AIRY_WALL_LIST };
    struct airy_error no_walls;
    if (!t->airy && cmd_connect(&t->airy, t->socket, e) < 0)
        return -1;
    airy_wall_reply_free(t->walls);
    t->walls = NULL;
    if (airy_status(t->airy, &t->now, TIMEOUT_MS, e) < 0)
        return -1;
    // A daemon that has none, or is stopping, says so in an error: the rest is worth showing.
    if (airy_wall(t->airy, &list, TIMEOUT_MS, &t->walls, &no_walls) < 0)
        t->walls = NULL;
    return 0;
}

// The daemon that was there has gone; another one counts from 0.
static void lose(struct top *t, const struct airy_error *e)
{
    const bool first = !t->lost.code;
    airy_close(t->airy);
    t->airy = NULL;
    t->before = (struct airy_status){ .uptime_s = 0 };
    t->lost = *e;
    if (t->screen)
        show(t);
    else if (first)
        cmd_complain("top: %s; it is asked again every second", e->text);
}

// 0, or -1 and *e: it is no use to ask again.
static int look(struct top *t, struct airy_error *e)
{
    *e = (struct airy_error){ 0 };
    if (ask(t, e) < 0) {
        if (t->once || !t->answered || cmd_exit_of(e) != CMD_RETRY)
            return -1;
        lose(t, e);
        return 0;
    }
    t->answered = true;
    t->lost.code = 0;
    if (t->json)
        say_json(t);
    else
        show(t);
    return 0;
}

// False: q was pressed.
static bool wait_for_next(struct top *t, struct screen *s, uint64_t next_ns)
{
    while (!stop_asked() && stop_now_ns() < next_ns) {
        if (!t->screen) {
            stop_wait(-1, 0, next_ns);
            continue;
        }
        const enum screen_event event = screen_wait(s, next_ns);
        if (event == SCREEN_QUIT)
            return false;
        if (event == SCREEN_DRAW)
            show(t);
    }
    return true;
}

static int watch(struct top *t, struct screen *s, struct airy_error *e)
{
    for (uint64_t next_ns = stop_now_ns(); !stop_asked() && !ferror(stdout);) {
        const int rc = look(t, e);
        if (rc < 0 || t->once)
            return rc;
        // One that answered late is not asked twice at once.
        next_ns = next_ns + UINT64_C(1000000000) > stop_now_ns() ? next_ns + UINT64_C(1000000000) : stop_now_ns();
        if (!wait_for_next(t, s, next_ns))
            return 0;
        t->before = t->airy ? t->now : t->before;
    }
    return 0;
}

// 1: go on; 0: help was given; -1: usage.
static int read_options(struct top *t, int argc, char **argv)
{
    struct options o;
    const char *value;
    int id;
    options_init(&o, argc, argv, rows, TOP_OPTIONS);
    while ((id = options_next(&o, &value)) != OPTIONS_END) {
        if (id == OPTIONS_OPERAND)
            cmd_complain("top: \"%s\" is not expected", value);
        if (id == OPTIONS_OPERAND || id == OPTIONS_WRONG)
            return -1;
        if (id == TOP_HELP) {
            cmd_help(2, (char *[]){ (char *)"help", (char *)"top", NULL });
            return 0;
        }
        if (id == TOP_SOCKET)
            t->socket = value;
        t->json |= id == TOP_JSON;
        t->once |= id == TOP_ONCE;
    }
    return 1;
}

enum cmd_exit cmd_top(int argc, char **argv)
{
    static struct top t;
    struct airy_error e;
    int go = read_options(&t, argc, argv);
    if (go <= 0)
        return go < 0 ? CMD_USAGE : CMD_DONE;
    stop_install();
    // The first answer comes before the screen: without one nothing has been drawn over.
    if (cmd_connect(&t.airy, t.socket, &e) < 0) {
        cmd_complain("top: %s", e.text);
        return cmd_exit_of(&e);
    }
    struct screen s;
    t.screen = !t.once && !t.json && screen_there() && screen_open(&s) == 0;
    const int rc = watch(&t, &s, &e);
    if (t.screen)
        screen_close(&s);
    airy_wall_reply_free(t.walls);
    airy_close(t.airy);
    if (rc < 0)
        cmd_complain("top: %s", e.text);
    return rc < 0 ? cmd_exit_of(&e) : CMD_DONE;
}
