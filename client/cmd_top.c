// SPDX-License-Identifier: Apache-2.0
/*
 * cmd_top.c - airy top: once a second, who has what in a daemon, how much room is left, and how long the stages take. On a terminal it is drawn
 * over, on the other screen, which is left at the end however that comes.
 */
#include <pwd.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

#include "cmd.h"
#include "cmd_json.h"
#include "cmd_options.h"
#include "cmd_report.h"
#include "cmd_wall_stop.h"
#include "cmd_wall_text.h"

enum { TIMEOUT_MS = 5000, BAR = 30 };
enum { TOP_SOCKET, TOP_JSON, TOP_ONCE, TOP_HELP, TOP_OPTIONS };

static const struct option_row rows[TOP_OPTIONS] = {
    [TOP_SOCKET] = { "socket", 0, "PATH", "" },
    [TOP_JSON] = { "json", 0, NULL, "" },
    [TOP_ONCE] = { "once", 0, NULL, "" },
    [TOP_HELP] = { "help", 'h', NULL, "" },
};

#define SCREEN_ENTER "\033[?1049h\033[?25l"
#define SCREEN_LEAVE "\033[?25h\033[?1049l"

struct top {
    const char *socket;
    bool json, once, screen;
    struct airy *airy;
    struct airy_status now, before; /* before.uptime_s 0: none */
};

static double per_second(const struct top *t, uint64_t now, uint64_t before)
{
    double seconds = t->now.uptime_s - t->before.uptime_s;
    return t->before.uptime_s > 0 && seconds > 0 && now >= before ? (double)(now - before) / seconds : 0;
}

static void bar(const char *name, uint64_t used, uint64_t most)
{
    unsigned n = most ? (unsigned)((double)used / (double)most * BAR + 0.5) : 0;
    printf("  %-9s[", name);
    for (unsigned i = 0; i < BAR; i++)
        putchar(i < n ? '#' : ' ');
    printf("] %.1f of %.1f MB\n", 1e-6 * (double)used, 1e-6 * (double)most);
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
    puts("\n  user          conns   reqs queued  running   fds         MB   device s  device %");
    for (unsigned i = 0; i < t->now.n_users; i++) {
        const struct airy_status_user *u = &t->now.user[i], *b = user_before(t, u->uid);
        const struct passwd *p = getpwuid(u->uid);
        double seconds = t->now.uptime_s - t->before.uptime_s;
        char name[24];
        snprintf(name, sizeof(name), "%u", u->uid);
        printf("  %-12.12s %6u %6u %6u %8u %5u %10.1f %10.1f  ", p ? p->pw_name : name, u->connections, u->requests, u->queued,
               u->running, u->fds, 1e-6 * (double)u->bytes, u->device_ms / 1e3);
        if (b && t->before.uptime_s > 0 && seconds > 0)
            printf("%8.0f\n", (u->device_ms - b->device_ms) / seconds / 10);
        else
            puts("       -");
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

static void say_stages(const struct airy_status *s)
{
    const double mean[] = { s->mean_ms.queue, s->mean_ms.load, s->mean_ms.decode, s->mean_ms.bloom, s->mean_ms.encode, s->mean_ms.total };
    puts("\n  stage     mean ms of the last   half are within   99 % are within");
    for (unsigned i = 0; i < s->n_stages; i++) {
        printf("  %-9s %19.1f", s->stage[i].name, i < sizeof(mean) / sizeof(mean[0]) ? mean[i] : 0);
        for (unsigned k = 0; k < 2; k++) {
            double ms = share(&s->stage[i], s->n_buckets, s->bucket_ms, k ? 0.99 : 0.5);
            if (ms < 0)
                printf("        > %7.0f", s->n_buckets ? s->bucket_ms[s->n_buckets - 1] : 0);
            else
                printf("   %12.1f   ", ms);
        }
        putchar('\n');
    }
}

static void say_text(const struct top *t, const struct airy_wall_reply *walls)
{
    const struct airy_status *s = &t->now;
    if (t->screen)
        fputs("\033[H\033[J", stdout);
    printf("%s%s on %s, up %.0f s\n", s->server, s->draining ? " (stopping)" : "", s->device, s->uptime_s);
    printf("  %u clients, %u waiting, %u running; %llu done (%.1f/s), %llu failed, %llu cancelled, %llu refused; %.1f megapixels/s\n",
           s->clients, s->queued, s->running, (unsigned long long)s->done, per_second(t, s->done, t->before.done),
           (unsigned long long)s->failed, (unsigned long long)s->cancelled, (unsigned long long)s->refused_busy,
           1e-6 * per_second(t, s->pixels, t->before.pixels));
    bar("payloads", s->memory.payloads, s->memory.payloads_max);
    bar("loads", s->memory.loads, s->memory.loads_max);
    bar("work", s->memory.work, s->memory.work_max);
    printf("  resident %.1f MB, ceiling %.1f MB\n", 1e-6 * (double)s->rss_bytes, 1e-6 * (double)s->memory.ceiling);
    say_users(t);
    say_stages(s);
    for (unsigned i = 0; walls && i < walls->n_walls; i++) {
        if (!i)
            putchar('\n');
        wall_text_stats(stdout, &walls->walls[i]);
    }
    fflush(stdout);
}

// One daemon's facts in one line: the status, and with it the walls.
static void say_json(const struct top *t, const struct airy_wall_reply *walls)
{
    struct timespec at;
    struct json j = { .out = stdout };
    clock_gettime(CLOCK_REALTIME, &at);
    json_open(&j, NULL, '{');
    json_number(&j, "unix_s", (double)at.tv_sec + 1e-9 * (double)at.tv_nsec);
    report_json_status_fields(&j, &t->now);
    json_open(&j, "walls", '[');
    for (unsigned i = 0; walls && i < walls->n_walls; i++)
        wall_json_state(&j, NULL, &walls->walls[i]);
    json_close(&j, ']');
    json_close(&j, '}');
    json_line(&j);
}

static int look(struct top *t, struct airy_error *e)
{
    const struct airy_wall_request list = { .action = AIRY_WALL_LIST };
    struct airy_wall_reply *walls = NULL;
    struct airy_error no_walls;
    if (airy_status(t->airy, &t->now, TIMEOUT_MS, e) < 0)
        return -1;
    // A daemon that has none, or is stopping, says so in an error: the rest is worth showing.
    if (airy_wall(t->airy, &list, TIMEOUT_MS, &walls, &no_walls) < 0)
        walls = NULL;
    if (t->json)
        say_json(t, walls);
    else
        say_text(t, walls);
    airy_wall_reply_free(walls);
    t->before = t->now;
    return 0;
}

static enum cmd_exit watch(struct top *t)
{
    struct airy_error e;
    int rc = 0;
    for (uint64_t next_ns = stop_now_ns(); !stop_asked() && !ferror(stdout);) {
        rc = look(t, &e);
        if (rc < 0 || t->once)
            break;
        next_ns += UINT64_C(1000000000);
        while (!stop_asked() && stop_now_ns() < next_ns)
            stop_wait(-1, 0, next_ns);
    }
    if (t->screen) {
        fputs(SCREEN_LEAVE, stdout);
        fflush(stdout);
        stop_restore(NULL);
    }
    if (rc == 0)
        return CMD_DONE;
    cmd_complain("top: %s", e.text);
    return cmd_exit_of(&e);
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
    if (airy_connect(&t.airy, t.socket, &e) < 0) {
        cmd_complain("top: %s", e.text);
        return cmd_exit_of(&e);
    }
    stop_install();
    t.screen = !t.once && !t.json && isatty(STDOUT_FILENO);
    if (t.screen) {
        stop_restore(SCREEN_LEAVE);
        fputs(SCREEN_ENTER, stdout);
    }
    enum cmd_exit exit = watch(&t);
    airy_close(t.airy);
    return exit;
}
