// SPDX-License-Identifier: Apache-2.0
// cmd_wall_play.c - airy wall play: frames to a wall, in time. One connection, one thread.
//
// The first frame is shown as soon as it is done, and warms up all that is to be warmed up; then the clock starts. After that no frame moves
// another: what is late is left out. A daemon that was lost is looked for again, for a wall has to run for days.
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "cmd_asset.h"
#include "cmd_run.h"
#include "cmd_wall_asked.h"
#include "cmd_wall_clock.h"
#include "cmd_wall_commands.h"
#include "cmd_wall_stop.h"
#include "cmd_wall_text.h"
#include "cmd_wall_use.h"
#include "frames.h"

enum { CODE_NO_ASSET = 223, CODE_NO_WALL = 224, CODE_BUSY = 400, CODE_WALL_BUSY = 403, CODE_SHUTTING_DOWN = 502 };
#define SECOND_NS UINT64_C(1000000000)
#define STILL_FPS 1. /* how often a still picture is sent again */

static const struct wall_syntax syntax = {
    .name = "wall play",
    .help = "airy wall play 'in.####.exr' --wall FILE|NAME [--fps N] [--loop] [-f RANGE] [bloom parameters]\n"
            "\n"
            "Blooms frames and shows them on a wall, each at its time. A frame that would be late is left out and counted,\n"
            "one that is damaged is told once. Ctrl-C ends it: a wall that was opened for it goes black and closes, a wall of\n"
            "the daemon holds the last frame and fades by its own definition. Ctrl-C twice ends it at once. A still picture\n"
            "stays with --loop. A daemon that is restarted is found again.\n"
            "\n"
            "    airy wall play 'loop.####.exr' --wall lobby.yaml --fps 24 --loop --intensity 0.5\n"
            "    airy wall play still.exr --wall lobby --loop\n",
    .expected = "one input, 'in.####.exr', in quotes,",
    .operands_min = 1,
    .operands_max = 1,
    .options = 1 << WALL_OPTION_WALL | 1 << WALL_OPTION_FPS | 1 << WALL_OPTION_LOOP | 1 << WALL_OPTION_FRAMES |
               1 << WALL_OPTION_PART | 1 << WALL_OPTION_LAYER | 1 << WALL_OPTION_VIEW | 1 << WALL_OPTION_DEVICE |
               1 << WALL_OPTION_JSON,
    .params = true,
};

struct flight { uint64_t id, k; };

struct play {
    struct wall_asked *asked;
    struct wall_use use;
    struct frames_pattern pattern;
    struct frames_list list; /* empty: one picture, the pattern's text */
    bool *told;              /* of each frame: it failed, and that was said */
    struct play_clock clock;
    bool running;            /* the clock is */
    struct flight flight[PLAY_IN_FLIGHT];
    unsigned in_flight;
    struct airy_request request; /* with the digests of the files that it names */
    struct wall_played played;
    uint64_t done, failed_in_row, report_ns;
    bool tty, drawn;
    bool lost;               /* the daemon is */
    bool assets_lost;        /* the daemon gave up what the request names */
    bool over, at_end;       /* at_end: because the frames are */
    enum cmd_exit status;    /* of the first failure */
};

/* ---- words ------------------------------------------------------------------------------------------- */

static void erase(struct play *p)
{
    if (p->drawn)
        fputs("\r\033[K", stderr);
    p->drawn = false;
}

static enum cmd_exit complain(struct play *p, const struct airy_error *e)
{
    erase(p);
    return wall_complain(syntax.name, e);
}

static void stop_with(struct play *p, enum cmd_exit exit)
{
    if (p->status == CMD_DONE)
        p->status = exit;
    p->over = true;
}

static void report_json(const struct play *p, const struct airy_wall_state *w)
{
    struct json j = { .out = stdout };
    json_open(&j, NULL, '{');
    json_count(&j, "sent", p->played.sent);
    json_count(&j, "skipped", p->played.skipped);
    json_count(&j, "failed", p->played.failed);
    wall_json_state(&j, "wall", w);
    json_close(&j, '}');
    json_line(&j);
}

static void report_text(struct play *p, const struct airy_wall_state *w)
{
    struct winsize size;
    char line[512];
    unsigned columns = sizeof(line) - 1;
    if (p->tty)
        columns = ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col ? size.ws_col - 1u : 79;
    wall_text_line(line, sizeof(line), columns, w, &p->played);
    erase(p);
    fprintf(stderr, p->tty ? "%s" : "%s\n", line);
    fflush(stderr);
    p->drawn = p->tty;
}

/* Once a second. Is the wall still there, and is anything to be seen of it? */
static bool report(struct play *p)
{
    struct airy_error e;
    struct airy_wall_reply *r =
        wall_ask(p->use.session.airy, &(struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = p->use.name }, &e);
    p->report_ns = stop_now_ns() + SECOND_NS;
    if (!r && e.code == CODE_NO_WALL)
        stop_with(p, complain(p, &e));
    if (!r)
        return false;
    p->played.skipped = p->clock.skipped;
    if (p->asked->json)
        report_json(p, &r->walls[0]);
    else
        report_text(p, &r->walls[0]);
    bool lit = strcmp(r->walls[0].source, "black") != 0 && strcmp(r->walls[0].source, "none") != 0;
    airy_wall_reply_free(r);
    return lit;
}

/* ---- what becomes of a frame ------------------------------------------------------------------------- */

static char *frame_path(const struct play *p, uint64_t k)
{
    return p->list.count ? frames_name(&p->pattern, p->list.frame[k % p->list.count]) : strdup(p->pattern.text);
}

static void frame_failed(struct play *p, uint64_t k, const char *path, const char *why, enum cmd_exit exit)
{
    bool *told = &p->told[k % p->clock.count];
    p->played.failed++;
    if (p->status == CMD_DONE)
        p->status = exit;
    if (!*told) {
        erase(p);
        cmd_complain("%s: %s%s%s", syntax.name, path ? path : "", path ? ": " : "", why);
    }
    *told = true;
    if (++p->failed_in_row < p->clock.count || p->over)
        return;
    erase(p);
    if (p->clock.count > 1)
        cmd_complain("%s: none of the %zu frames can be shown", syntax.name, p->clock.count);
    p->over = true;
}

/* Other work has filled the daemon: that frame's time goes by. The first one has time. */
static void frame_busy(struct play *p, uint64_t k)
{
    if (p->running) {
        p->clock.skipped++;
        return;
    }
    p->clock.next = k;
    stop_wait(-1, 0, stop_now_ns() + SECOND_NS / 10);
}

/* The daemon's no to one frame, or to all. */
static void frame_refused(struct play *p, uint64_t k, const struct airy_error *e)
{
    enum cmd_exit exit = cmd_exit_of(e);
    if (e->code == CODE_SHUTTING_DOWN || airy_fd(p->use.session.airy) < 0) {
        p->lost = true;
    } else if (e->code == CODE_NO_ASSET && assets_named(&p->asked->request)) {
        p->assets_lost = true;
    } else if (exit == CMD_USAGE || e->code == CODE_NO_WALL || e->code == CODE_WALL_BUSY || e->code == CODE_NO_ASSET) {
        stop_with(p, complain(p, e));
    } else if (e->code == CODE_BUSY) {
        frame_busy(p, k);
    } else {
        char why[sizeof(e->field) + sizeof(e->text) + 4], *path = frame_path(p, k);
        snprintf(why, sizeof(why), "%s%s%s", e->field, *e->field ? ": " : "", e->text);
        frame_failed(p, k, path, why, exit);
        free(path);
    }
}

static void frame_send(struct play *p, uint64_t k, uint64_t present_ns)
{
    char why[RUN_WHY_MAX] = "out of memory", *path = frame_path(p, k);
    int fd = path ? run_input_open(path, why, sizeof(why)) : -1;
    free(path);
    if (fd < 0) {
        frame_failed(p, k, NULL, why, CMD_INPUT);
        return;
    }
    struct airy_error e;
    struct flight *f = &p->flight[p->in_flight];
    p->request.input_fd = fd;
    p->request.present_ns = present_ns;
    f->k = k;
    if (airy_submit(p->use.session.airy, &p->request, &f->id, &e) == 0) {
        p->in_flight++;
        p->played.sent++;
    } else {
        frame_refused(p, k, &e);
    }
    close(fd);
}

/* Whatever has ended. timeout_ms as airy_wait_any's. */
static void receive(struct play *p, int timeout_ms)
{
    while (p->in_flight && !p->lost && !p->over) {
        uint64_t id = 0;
        unsigned i = 0;
        struct airy_result *result = NULL;
        struct airy_error e;
        int got = airy_wait_any(p->use.session.airy, timeout_ms, &id, &result, &e);
        airy_result_free(result);
        if (got == 0)
            return;
        while (i < p->in_flight && p->flight[i].id != id)
            i++;
        if (i == p->in_flight) { /* the connection's end */
            p->lost = true;
            return;
        }
        uint64_t k = p->flight[i].k;
        p->flight[i] = p->flight[--p->in_flight];
        if (got == 1) {
            p->failed_in_row = 0;
            p->done++;
        } else {
            frame_refused(p, k, &e);
        }
        timeout_ms = 0;
    }
}

/* ---- in time ------------------------------------------------------------------------------------------ */

static void end_reached(struct play *p) { p->over = p->at_end = true; }

/* The first frame that can be shown: no clock runs yet. */
static void prime(struct play *p)
{
    uint64_t done = p->done;
    if (!p->clock.loop && p->clock.next >= p->clock.count) {
        end_reached(p);
        return;
    }
    frame_send(p, p->clock.next++, 0);
    while (p->in_flight && !p->over && !p->lost && !stop_asked())
        receive(p, 50);
    if (p->done == done)
        return;
    p->running = true;
    play_start(&p->clock, stop_now_ns());
}

static void run(struct play *p)
{
    uint64_t k, until_ns;
    struct airy *a = p->use.session.airy;
    receive(p, 0);
    if (p->lost || p->over)
        return;
    enum play_step step = play_next(&p->clock, stop_now_ns(), p->in_flight, &k, &until_ns);
    if (step == PLAY_SEND)
        frame_send(p, k, play_due_ns(&p->clock, k));
    else if (step == PLAY_OVER && p->in_flight == 0)
        end_reached(p);
    else if (p->in_flight == 0 && airy_pump(a, NULL) < 0) /* with frames in flight, receive sees it */
        p->lost = true;
    else
        stop_wait(airy_fd(a), airy_events(a), until_ns < p->report_ns ? until_ns : p->report_ns);
}

/* What the request names by file. */
static int assets(struct play *p, struct airy_error *e)
{
    if (assets_send(p->use.session.airy, &p->asked->request, &p->request, e) < 0)
        return -1;
    p->request.wall = p->use.name;
    p->request.show = true;
    p->assets_lost = false;
    return 0;
}

/* A daemon that was restarted. The clock goes on. */
static void find_again(struct play *p)
{
    struct airy_error e = { .text = "" };
    char said[sizeof(e.text)] = "";
    erase(p);
    cmd_complain("%s: the daemon is lost; looking for it again", syntax.name);
    while (!stop_asked()) {
        if (wall_use_again(&p->use, p->asked->wall, &p->asked->session, &e) == 0 && assets(p, &e) == 0) {
            p->in_flight = 0;
            p->lost = false;
            return;
        }
        if (strcmp(said, e.text) != 0)
            cmd_complain("%s: %s; tried again every second (Ctrl-C ends it)", syntax.name, e.text);
        memcpy(said, e.text, sizeof(said));
        stop_wait(-1, 0, stop_now_ns() + SECOND_NS);
    }
}

static void send_assets_again(struct play *p)
{
    struct airy_error e;
    if (assets(p, &e) == 0)
        return;
    if (airy_fd(p->use.session.airy) < 0)
        p->lost = true;
    else
        stop_with(p, complain(p, &e));
}

/* What was sent last gets its time; a wall that will close with us gets its hold and its fade. */
static void linger(struct play *p)
{
    uint64_t end_ns = p->running ? play_due_ns(&p->clock, p->clock.next) : stop_now_ns();
    double rest_s = p->use.ours ? p->use.hold_s + p->use.fade_s : 0; /* held for ever: until Ctrl-C */
    end_ns = rest_s < 1e9 ? end_ns + (uint64_t)(rest_s * 1e9) : UINT64_MAX;
    bool lit = true;
    while (!stop_asked() && stop_now_ns() < end_ns && lit && airy_fd(p->use.session.airy) >= 0) {
        if (stop_now_ns() >= p->report_ns)
            lit = report(p);
        stop_wait(-1, 0, end_ns < p->report_ns ? end_ns : p->report_ns);
    }
}

static enum cmd_exit play(struct play *p)
{
    struct airy_error e;
    if (assets(p, &e) < 0)
        return complain(p, &e);
    while (!p->over && !stop_asked()) {
        if (p->lost)
            find_again(p);
        else if (p->assets_lost)
            send_assets_again(p);
        else if (p->running)
            run(p);
        else
            prime(p);
        if (!p->lost && !p->over && stop_now_ns() >= p->report_ns)
            report(p);
    }
    if (p->at_end && p->done)
        linger(p);
    if (p->done && !p->lost && (p->at_end || !p->over))
        report(p);
    if (p->drawn)
        fputc('\n', stderr);
    return p->status;
}

/* ---- which frames ------------------------------------------------------------------------------------- */

static enum cmd_exit frames_find(struct play *p)
{
    const struct wall_asked *a = p->asked;
    char why[FRAMES_WHY_MAX];
    bool one = !a->frames && access(a->operand[0], F_OK) == 0; /* a name that is there is itself, whatever is in it */
    if (frames_pattern_init(&p->pattern, a->operand[0], why) < 0) {
        cmd_complain("%s: %s", syntax.name, why);
        return CMD_USAGE;
    }
    if (a->frames && p->pattern.n_tokens == 0) {
        cmd_complain("%s: -f %s: the input \"%s\" has no frame token such as ####", syntax.name, a->frames, a->operand[0]);
        return CMD_USAGE;
    }
    if (one || p->pattern.n_tokens == 0)
        return CMD_DONE;
    if ((a->frames ? frames_parse(&p->list, a->frames, why) : frames_scan(&p->list, &p->pattern, why)) < 0) {
        cmd_complain("%s: %s", syntax.name, why);
        return a->frames ? CMD_USAGE : CMD_INPUT;
    }
    if (p->list.count)
        return CMD_DONE;
    cmd_complain("%s: no file is named as \"%s\"", syntax.name, a->operand[0]);
    return CMD_INPUT;
}

static void clock_set(struct play *p)
{
    const struct wall_asked *a = p->asked;
    bool still = p->list.count == 0;
    double fps = a->fps > 0 ? a->fps : p->use.rate > 0 ? p->use.rate : 60;
    if (still) { /* sent again before the wall would fade it */
        fps = STILL_FPS;
        if (p->use.hold_s > 0 && p->use.hold_s < 2 / STILL_FPS)
            fps = p->use.hold_s > .2 ? 2 / p->use.hold_s : 10;
    } else if (fps > p->use.rate * 1.001)
        cmd_complain("%s: %.4g frames a second are more than the wall's rate, %.4g: some will not be seen", syntax.name, fps, p->use.rate);
    p->clock = (struct play_clock){ .fps = fps, .ahead_ns = play_ahead_ns(fps), .count = still ? 1 : p->list.count, .loop = a->loop };
}

int cmd_wall_play(int argc, char **argv)
{
    static struct wall_asked a = WALL_ASKED_INIT;
    static struct play p = { .asked = &a, .use = { .session = SESSION_NONE } };
    int rc = wall_asked_read(&a, &syntax, argc, argv);
    if (rc)
        return rc > 0 ? CMD_DONE : CMD_USAGE;
    if (!a.wall) {
        cmd_complain("%s: --wall FILE|NAME expected: where to?", syntax.name);
        return CMD_USAGE;
    }
    enum cmd_exit exit = frames_find(&p);
    if (exit == CMD_DONE) {
        stop_install();
        exit = wall_use_open(&p.use, a.wall, &a.session, syntax.name);
    }
    if (exit == CMD_DONE) {
        clock_set(&p);
        p.tty = !a.json && isatty(STDERR_FILENO);
        p.report_ns = stop_now_ns() + SECOND_NS;
        p.told = calloc(p.clock.count, sizeof(*p.told));
        if (p.told) {
            exit = play(&p);
        } else {
            cmd_complain("%s: out of memory", syntax.name);
            exit = CMD_OTHER;
        }
        wall_use_close(&p.use);
    }
    free(p.told);
    frames_list_finish(&p.list);
    frames_pattern_finish(&p.pattern);
    return exit;
}
