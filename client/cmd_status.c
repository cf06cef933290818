// SPDX-License-Identifier: Apache-2.0
// cmd_status.c - airy status: asks a daemon that is there; never starts one.
#include <stdio.h>

#include "cmd.h"
#include "cmd_metrics.h"
#include "cmd_options.h"
#include "cmd_report.h"

enum { TIMEOUT_MS = 5000 };
enum { STATUS_SOCKET, STATUS_JSON, STATUS_PROMETHEUS, STATUS_HELP, STATUS_OPTIONS };

static const struct option_row rows[STATUS_OPTIONS] = {
    [STATUS_SOCKET] = { "socket", 0, "PATH", "" },
    [STATUS_JSON] = { "json", 0, NULL, "" },
    [STATUS_PROMETHEUS] = { "prometheus", 0, NULL, "" },
    [STATUS_HELP] = { "help", 'h', NULL, "" },
};

static void print_status(const struct airy_status *s)
{
    const struct airy_times *ms = &s->mean_ms;
    printf("%s%s, up %.0f s\n", s->server, s->draining ? " (stopping)" : "", s->uptime_s);
    printf("  device     %s (%s, %s)\n", s->device, s->device_kind, s->driver);
    printf("  now        %u clients, %u waiting, %u running\n", s->clients, s->queued, s->running);
    printf("  so far     %llu done, %llu failed, %llu cancelled, %.4g megapixels\n",
           (unsigned long long)s->done, (unsigned long long)s->failed, (unsigned long long)s->cancelled,
           1e-6 * (double)s->pixels);
    printf("  bytes      %.4g MB in, %.4g MB out, %.4g MB resident\n", 1e-6 * (double)s->bytes_in,
           1e-6 * (double)s->bytes_out, 1e-6 * (double)s->rss_bytes);
    printf("  memory     %.4g MB of payloads, %.4g MB of loads, %.4g MB at work (at most %.4g); ceiling %.4g MB\n",
           1e-6 * (double)s->memory.payloads, 1e-6 * (double)s->memory.loads, 1e-6 * (double)s->memory.work,
           1e-6 * (double)s->memory.work_max, 1e-6 * (double)s->memory.ceiling);
    printf("  mean ms    queue %.1f, load %.1f, decode %.1f, bloom %.1f, encode %.1f, total %.1f\n",
           ms->queue, ms->load, ms->decode, ms->bloom, ms->encode, ms->total);
}

enum form { FORM_TEXT, FORM_JSON, FORM_PROMETHEUS };

// A scrape has the walls' counters, too, where there are walls.
static void print_metrics(struct airy *a, const struct airy_status *s)
{
    const struct airy_wall_request list = { .action = AIRY_WALL_LIST };
    struct airy_wall_reply *walls = NULL;
    struct airy_error e;
    if (airy_wall(a, &list, TIMEOUT_MS, &walls, &e) < 0)
        walls = NULL;
    metrics_print(stdout, s, walls);
    airy_wall_reply_free(walls);
}

static enum cmd_exit ask(const char *socket, enum form form)
{
    static struct airy_status s;
    struct airy *a;
    struct airy_error e;
    if (airy_connect(&a, socket, &e) < 0) {
        cmd_complain("status: %s", e.text);
        return cmd_exit_of(&e);
    }
    int r = airy_status(a, &s, TIMEOUT_MS, &e);
    if (r < 0)
        cmd_complain("status: %s", e.text);
    else if (form == FORM_JSON)
        report_json_status(&s);
    else if (form == FORM_PROMETHEUS)
        print_metrics(a, &s);
    else
        print_status(&s);
    airy_close(a);
    return r < 0 ? cmd_exit_of(&e) : CMD_DONE;
}

enum cmd_exit cmd_status(int argc, char **argv)
{
    struct options o;
    const char *value, *socket = NULL;
    enum form form = FORM_TEXT;
    int id;
    options_init(&o, argc, argv, rows, STATUS_OPTIONS);
    while ((id = options_next(&o, &value)) != OPTIONS_END) {
        if (id == OPTIONS_OPERAND)
            cmd_complain("status: \"%s\" is not expected", value);
        if (id == OPTIONS_OPERAND || id == OPTIONS_WRONG)
            return CMD_USAGE;
        if (id == STATUS_HELP)
            return cmd_help(2, (char *[]){ (char *)"help", (char *)"status", NULL });
        if (id == STATUS_SOCKET)
            socket = value;
        form = id == STATUS_JSON ? FORM_JSON : id == STATUS_PROMETHEUS ? FORM_PROMETHEUS : form;
    }
    return ask(socket, form);
}
