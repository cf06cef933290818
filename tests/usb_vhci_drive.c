// SPDX-License-Identifier: Apache-2.0
// usb_vhci_drive.c - see usb_vhci_drive.h.
#include "usb_vhci_drive.h"

#include "daemon_fixture.h"

#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "wall.h"

enum { ASK_MS = 60000 };

static char path[] = "/tmp/airyd-vhci-XXXXXX";
static struct daemon the_daemon;
static struct airy *client; // NULL: not the daemon
static struct usb *usb;
static struct wall *wall;

#define COPY(to, from) snprintf(to, sizeof to, "%s", from)

// ---- the daemon -----------------------------------------------------------------------------------------------------

static struct airy_wall_reply *ask(struct airy_wall_request q)
{
    struct airy_wall_reply *r = NULL;
    struct airy_error e;
    q.name = "w";
    if (airy_wall(client, &q, ASK_MS, &r, &e) < 0)
        fail_msg("%s: %s (%s)", e.symbol, e.text, e.field);
    return r;
}

static void start_daemon(const char *definition)
{
    const int fd = mkstemp(path);
    assert_int_equal(write(fd, definition, strlen(definition)), strlen(definition));
    close(fd);
    daemon_start(&the_daemon, (const char *const[]){ "--threads", "1", "--warm", "common", "--wall", path, NULL });
    client = daemon_join(&the_daemon);
    printf("# driven by %s on %s\n", airy_server(client), airy_device(client));
}

static struct drive_times times_of(struct airy_percentiles p) { return (struct drive_times){ p.p50, p.p99, p.max }; }

static struct drive_state look_at_daemon(void)
{
    struct airy_wall_reply *r = ask((struct airy_wall_request){ .action = AIRY_WALL_LIST });
    assert_int_equal(r->n_walls, 1);
    assert_int_equal(r->walls[0].n_boards, 1);
    const struct airy_wall_board *b = &r->walls[0].boards[0];
    struct drive_state s = { .dropped = b->dropped, .missed = b->missed, .stalls = b->stalls, .timeouts = b->timeouts,
                             .errors = b->errors, .losses = b->losses, .latency = times_of(b->latency_ms),
                             .late = times_of(r->walls[0].late_ms), .controllers = r->n_controllers };
    COPY(s.state, b->state);
    COPY(s.problem, b->problem);
    if (r->n_controllers) {
        COPY(s.kind, r->controllers[0].kind);
        COPY(s.serial, r->controllers[0].serial);
        COPY(s.path, r->controllers[0].path);
        COPY(s.trouble, r->controllers[0].problem);
    }
    airy_wall_reply_free(r);
    return s;
}

static int stop_daemon(void)
{
    airy_close(client);
    client = NULL;
    const int status = daemon_stop(&the_daemon, SIGTERM);
    unlink(path);
    return status;
}

// ---- the wall alone -------------------------------------------------------------------------------------------------

static void say(const char *line) { fprintf(stderr, "%s\n", line); }

static void start_wall(const char *definition)
{
    struct wall_def *d = NULL;
    struct fault f;
    if (wall_def_parse(&d, definition, strlen(definition), NULL, &f) || usb_create(&usb, say, &f) ||
        wall_create(&wall, d, usb, say, &f))
        fail_msg("%s", f.text);
    printf("# driven by the daemon's wall alone, without the daemon and its device\n");
}

static struct drive_times times_here(struct wall_times t) { return (struct drive_times){ t.p50, t.p99, t.max }; }

static struct drive_state look_at_wall(void)
{
    static const char *const names[] = { "absent", "opening", "ready", "failed" };
    struct usb_stats b;
    struct wall_stats w;
    struct wall_times latency;
    struct wall_power power;
    struct usb_found found;
    wall_board_stats(wall, 0, &b, &latency, &power);
    wall_stats(wall, &w);
    struct drive_state s = { .dropped = b.dropped, .missed = b.missed, .stalls = b.stalls, .timeouts = b.timeouts,
                             .errors = b.errors, .losses = b.losses, .latency = times_here(latency), .late = times_here(w.late),
                             .controllers = usb_list(usb, &found, 1, ASK_MS) };
    COPY(s.state, names[b.state]);
    COPY(s.problem, b.why);
    if (s.controllers) {
        COPY(s.kind, panel_kinds[found.kind]->name);
        COPY(s.serial, found.serial);
        COPY(s.path, found.path);
        COPY(s.trouble, found.why);
    }
    return s;
}

// ---- either ---------------------------------------------------------------------------------------------------------

void drive_start(const char *definition, bool daemon)
{
    if (daemon)
        start_daemon(definition);
    else
        start_wall(definition);
}

void drive_pattern(const char *word, uint32_t led)
{
    if (client) {
        const struct drive_state s = look_at_daemon();
        airy_wall_reply_free(ask((struct airy_wall_request){ .action = AIRY_WALL_PATTERN, .pattern = word, .board = s.serial,
                                                             .led = led, .level = 1 }));
        return;
    }
    struct wall_pattern p = { .led = led, .level = 1 };
    struct fault f;
    assert_true(wall_pattern_read(&p.kind, word));
    if (wall_pattern(wall, &p, &f))
        fail_msg("%s", f.text);
}

struct drive_state drive_look(void) { return client ? look_at_daemon() : look_at_wall(); }

int drive_stop(void)
{
    if (client)
        return stop_daemon();
    wall_destroy(wall);
    usb_destroy(usb);
    wall = NULL;
    usb = NULL;
    return 0;
}
