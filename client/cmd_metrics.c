// SPDX-License-Identifier: Apache-2.0
// cmd_metrics.c - see cmd_metrics.h. Each family has its HELP and TYPE once, before its samples; counters end in _total; a histogram's buckets
// are cumulative and end in +Inf, which is its count.
#include "cmd_metrics.h"

#include <inttypes.h>
#include <stdarg.h>

static void family(FILE *out, const char *name, const char *type, const char *help)
{
    fprintf(out, "# HELP airyd_%s %s\n# TYPE airyd_%s %s\n", name, help, name, type);
}

static void one(FILE *out, const char *name, const char *type, const char *help, double value)
{
    family(out, name, type, help);
    fprintf(out, "airyd_%s %.17g\n", name, value);
}

// Of a label's value: what the format cannot hold as it is.
static void label(FILE *out, const char *text)
{
    for (; *text; text++) {
        if (*text == '\\' || *text == '"')
            putc('\\', out);
        if (*text == '\n')
            fputs("\\n", out);
        else
            putc(*text, out);
    }
}

static void requests(FILE *out, const struct airy_status *s)
{
    const struct {
        const char *word;
        uint64_t n;
    } ends[] = { { "done", s->done }, { "failed", s->failed }, { "cancelled", s->cancelled } };
    family(out, "requests_total", "counter", "Requests that ended, by how.");
    for (unsigned i = 0; i < sizeof(ends) / sizeof(ends[0]); i++)
        fprintf(out, "airyd_requests_total{end=\"%s\"} %" PRIu64 "\n", ends[i].word, ends[i].n);
    one(out, "refused_total", "counter", "Requests and connections refused as BUSY.", (double)s->refused_busy);
    one(out, "pixels_total", "counter", "Pixels bloomed.", (double)s->pixels);
    one(out, "received_bytes_total", "counter", "Payload bytes taken in.", (double)s->bytes_in);
    one(out, "sent_bytes_total", "counter", "Payload bytes of results.", (double)s->bytes_out);
    family(out, "requests", "gauge", "Requests in the daemon, by state.");
    fprintf(out, "airyd_requests{state=\"queued\"} %u\nairyd_requests{state=\"running\"} %u\n", s->queued, s->running);
}

static void daemon_itself(FILE *out, const struct airy_status *s)
{
    family(out, "info", "gauge", "The daemon and its device.");
    fputs("airyd_info{version=\"", out);
    label(out, s->server);
    fputs("\",device=\"", out);
    label(out, s->device);
    fputs("\",kind=\"", out);
    label(out, s->device_kind);
    fputs("\"} 1\n", out);
    one(out, "uptime_seconds", "gauge", "Time since the start.", s->uptime_s);
    one(out, "draining", "gauge", "1 while it stops.", s->draining);
    one(out, "connections", "gauge", "Clients connected.", s->clients);
    one(out, "resident_memory_bytes", "gauge", "Memory as the system counts it.", (double)s->rss_bytes);
    one(out, "loop_turns_total", "counter", "Turns of the thread that serves the sockets.", (double)s->loop_turns);
    one(out, "loop_longest_seconds", "gauge", "The longest of them.", s->loop_worst_ms / 1e3);
}

static void memory(FILE *out, const struct airy_status_memory *m)
{
    const struct {
        const char *word;
        uint64_t used, most;
    } pools[] = { { "payloads", m->payloads, m->payloads_max }, { "loads", m->loads, m->loads_max }, { "work", m->work, m->work_max } };
    enum { POOLS = sizeof(pools) / sizeof(pools[0]) };
    one(out, "memory_ceiling_bytes", "gauge", "Memory that may be used, by declared size.", (double)m->ceiling);
    family(out, "memory_bytes", "gauge", "Memory in use, by declared size.");
    for (unsigned i = 0; i < POOLS; i++)
        fprintf(out, "airyd_memory_bytes{pool=\"%s\"} %" PRIu64 "\n", pools[i].word, pools[i].used);
    family(out, "memory_max_bytes", "gauge", "What a pool may hold.");
    for (unsigned i = 0; i < POOLS; i++)
        fprintf(out, "airyd_memory_max_bytes{pool=\"%s\"} %" PRIu64 "\n", pools[i].word, pools[i].most);
    one(out, "memory_work_peak_bytes", "gauge", "The most that was at work at once.", (double)m->work_peak);
}

static double user_value(const struct airy_status_user *u, unsigned what)
{
    switch (what) {
    case 0: return u->connections;
    case 1: return u->queued;
    case 2: return u->running;
    case 3: return u->fds;
    case 4: return (double)u->bytes;
    default: return u->device_ms / 1e3;
    }
}

static void users(FILE *out, const struct airy_status *s)
{
    static const struct {
        const char *name, *type, *help;
    } rows[] = {
        { "user_connections", "gauge", "Connections of a user." },
        { "user_queued", "gauge", "Requests of a user that wait." },
        { "user_running", "gauge", "Requests of a user at work." },
        { "user_descriptors", "gauge", "Descriptors that a user's connections and requests hold." },
        { "user_bytes", "gauge", "Memory that a user's payloads, frames and unread results take." },
        { "user_device_seconds_total", "counter", "Device time of a user." },
    };
    for (unsigned r = 0; r < sizeof(rows) / sizeof(rows[0]); r++) {
        family(out, rows[r].name, rows[r].type, rows[r].help);
        for (unsigned i = 0; i < s->n_users; i++)
            fprintf(out, "airyd_%s{uid=\"%u\"} %.17g\n", rows[r].name, s->user[i].uid, user_value(&s->user[i], r));
    }
}

static void stages(FILE *out, const struct airy_status *s)
{
    family(out, "stage_seconds", "histogram", "Time of requests that were done, by stage.");
    for (unsigned i = 0; i < s->n_stages; i++) {
        const struct airy_status_stage *h = &s->stage[i];
        uint64_t sum = 0;
        for (unsigned k = 0; k <= s->n_buckets; k++) {
            char end[32] = "+Inf";
            if (k < s->n_buckets)
                snprintf(end, sizeof(end), "%.9g", s->bucket_ms[k] / 1e3);
            sum += h->counts[k];
            fprintf(out, "airyd_stage_seconds_bucket{stage=\"%s\",le=\"%s\"} %" PRIu64 "\n", h->name, end, sum);
        }
        fprintf(out, "airyd_stage_seconds_sum{stage=\"%s\"} %.17g\n", h->name, h->sum_ms / 1e3);
        fprintf(out, "airyd_stage_seconds_count{stage=\"%s\"} %" PRIu64 "\n", h->name, sum);
    }
}

static void walls_of(FILE *out, const struct airy_wall_reply *r)
{
    static const struct {
        const char *name, *type, *help;
    } rows[] = {
        { "wall_frames_total", "counter", "Pictures that came for a wall." },
        { "wall_shown_total", "counter", "Pictures that were shown." },
        { "wall_dropped_total", "counter", "Pictures replaced before their tick." },
        { "wall_ticks_missed_total", "counter", "Ticks so late that one was left out." },
    };
    for (unsigned k = 0; k < sizeof(rows) / sizeof(rows[0]); k++) {
        family(out, rows[k].name, rows[k].type, rows[k].help);
        for (unsigned i = 0; i < r->n_walls; i++) {
            const struct airy_wall_state *w = &r->walls[i];
            const uint64_t values[] = { w->frames, w->shown, w->dropped, w->ticks_missed };
            fprintf(out, "airyd_%s{wall=\"", rows[k].name);
            label(out, w->name);
            fprintf(out, "\"} %" PRIu64 "\n", values[k]);
        }
    }
}

void metrics_print(FILE *out, const struct airy_status *s, const struct airy_wall_reply *walls)
{
    daemon_itself(out, s);
    requests(out, s);
    memory(out, &s->memory);
    users(out, s);
    stages(out, s);
    if (walls && walls->n_walls)
        walls_of(out, walls);
}
