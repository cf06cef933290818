// SPDX-License-Identifier: Apache-2.0
// cmd_run.c - one connection, one thread: submit while there is room, wait for any, write, again. Each
// frame ends in exactly one report.
#include "cmd_run.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "cmd_asset.h"
#include "cmd_exr.h"
#include "cmd_output.h"
#include "cmd_report.h"

enum {
    TRIES_MAX = 3,        /* of a frame whose daemon was lost, or that failed and may be tried again */
    BUSY_TRIES_MAX = 200, /* waits of up to 2 s */
    RECONNECT_MS = 15000, /* for a daemon that was there and has gone */
    CODE_NO_ASSET = 223,
    CODE_BUSY = 400,
    CODE_DEADLINE = 404,
    CODE_SHUTTING_DOWN = 502,
};

struct run {
    const struct run_options *o;
    struct run_frame *frames;
    size_t n, first_open; /* all before first_open have ended */
    size_t ended;
    unsigned in_flight;
    unsigned suspects; /* not ended yet */
    bool hold;  /* the daemon is busy: submit nothing until something ends */
    bool abort; /* the request itself is wrong */
    bool failed;
    bool was_connected;
    bool assets_named, assets_sent; /* sent: to the daemon of this session */
    struct airy_request request;    /* with the digests, once they are sent */
    enum cmd_exit status; /* CMD_DONE until a frame failed for good */
    struct session session;
    struct progress progress;
};

static double now_ms(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

static struct airy_error local_error(int code, const char *field, const char *text)
{
    struct airy_error e = { .code = -code, .retryable = false };
    snprintf(e.symbol, sizeof(e.symbol), "LOCAL");
    snprintf(e.field, sizeof(e.field), "%s", field);
    snprintf(e.text, sizeof(e.text), "%.*s", (int)sizeof(e.text) - 1, text);
    return e;
}

static struct report_frame report_of(const struct run_frame *f)
{
    return (struct report_frame){ f->numbered, f->number, f->black, f->input, f->output };
}

/* ---- a frame's end ----------------------------------------------------------------------------- */

static void frame_end(struct run *r, struct run_frame *f, bool failed)
{
    if (f->state == RUN_IN_FLIGHT)
        r->in_flight--;
    f->state = RUN_ENDED;
    r->suspects -= f->suspect;
    f->suspect = false;
    r->ended++;
    r->hold = false;
    r->failed = r->failed || failed;
    progress_step(&r->progress, failed);
}

static void frame_fail_silently(struct run *r, struct run_frame *f, const struct airy_error *e,
                                enum cmd_exit exit)
{
    struct report_frame report = report_of(f);
    if (r->o->json)
        report_json_error(&report, e, exit);
    if (r->status == CMD_DONE && exit != CMD_RETRY)
        r->status = exit;
    r->abort = r->abort || exit == CMD_USAGE || r->o->fail_fast;
    frame_end(r, f, true);
}

static void frame_fail(struct run *r, struct run_frame *f, const struct airy_error *e,
                       enum cmd_exit exit)
{
    struct report_frame report = report_of(f);
    report_error(&r->progress, &report, e);
    frame_fail_silently(r, f, e, exit);
}

static void frame_again(struct run *r, struct run_frame *f)
{
    if (f->state == RUN_IN_FLIGHT)
        r->in_flight--;
    f->state = RUN_WAITING;
    f->asking = false;
}

static void frame_done(struct run *r, struct run_frame *f, const struct airy_result *result)
{
    char why[OUTPUT_WHY_MAX];
    struct report_frame report = report_of(f);
    double start_ms = now_ms();
    if (output_write(f->output, result, r->o->overwrite, why) < 0) {
        struct airy_error e = local_error(EIO, "output", why);
        frame_fail(r, f, &e, CMD_OUTPUT);
        return;
    }
    double write_ms = now_ms() - start_ms;
    if (r->o->json)
        report_json_done(&report, result, write_ms);
    else if (r->n == 1)
        report_paragraph(&r->progress, &report, result, write_ms);
    else if (!r->progress.bar)
        report_line(&r->progress, &report, result);
    frame_end(r, f, false);
}

static void frame_pass(struct run *r, struct run_frame *f, enum report_pass pass, const char *stamp)
{
    struct report_frame report = report_of(f);
    if (r->o->json)
        report_json_pass(&report, pass, stamp);
    else if (r->n == 1 || !r->progress.bar)
        report_pass(&r->progress, &report, pass);
    frame_end(r, f, false);
}

/* What the output would be stamped with is known. */
static void frame_judge(struct run *r, struct run_frame *f, const struct airy_result *result)
{
    f->asked = true;
    if (exr_is_stamped(f->output, result->stamp))
        frame_pass(r, f, REPORT_SKIPPED, result->stamp);
    else
        frame_again(r, f);
}

/* ---- the connection ------------------------------------------------------------------------------ */

/* All that was in flight has to be sent again: to the same place, or to a new private daemon. (libairy would do the former by
 * itself; here both are one thing, and the images that frames name are sent again, too.) One of them may be what the daemon died of: they
 * are sent one at a time then, so that it costs one frame. */
static void connection_lost(struct run *r, const struct airy_error *e)
{
    for (size_t i = r->first_open; i < r->n; i++) {
        struct run_frame *f = &r->frames[i];
        if (f->state != RUN_IN_FLIGHT)
            continue;
        if (e->code != CODE_SHUTTING_DOWN) {
            r->suspects += !f->suspect;
            f->suspect = true;
        }
        if (++f->tries < TRIES_MAX)
            frame_again(r, f);
        else
            frame_fail(r, f, e, CMD_RETRY);
    }
    session_close(&r->session);
    r->assets_sent = false;
}

/* No daemon to be had: said once, and of each frame in JSON. */
static void fail_all(struct run *r, const struct airy_error *e)
{
    progress_error(&r->progress, "airy: %s%s%s", report_field(e), *e->field ? ": " : "", e->text);
    for (size_t i = r->first_open; i < r->n; i++)
        if (r->frames[i].state != RUN_ENDED)
            frame_fail_silently(r, &r->frames[i], e, cmd_exit_of(e));
}

static void pause_for(uint32_t ms)
{
    ms = ms < 20 ? 20 : ms > 2000 ? 2000 : ms;
    struct timespec t = { ms / 1000, (long)(ms % 1000) * 1000000 };
    nanosleep(&t, NULL);
}

/* The daemon's, or the library's, no to one frame. */
static void frame_refused(struct run *r, struct run_frame *f, const struct airy_error *e)
{
    enum cmd_exit exit = cmd_exit_of(e);
    if (e->code == CODE_SHUTTING_DOWN) {
        connection_lost(r, e);
    } else if (e->code == CODE_NO_ASSET && r->assets_named && ++f->tries < TRIES_MAX) {
        frame_again(r, f); /* the daemon gave it up for others */
        r->assets_sent = false;
    } else if (e->code == CODE_BUSY && ++f->tries < BUSY_TRIES_MAX) {
        frame_again(r, f);
        r->hold = true;
        if (r->in_flight == 0)
            pause_for(e->retry_after_ms);
    } else if (exit == CMD_RETRY && e->code != CODE_BUSY && e->code != CODE_DEADLINE && ++f->tries < TRIES_MAX) {
        frame_again(r, f);
        pause_for(e->retry_after_ms);
    } else {
        frame_fail(r, f, e, exit);
    }
}

/* ---- in ----------------------------------------------------------------------------------------------
 */

int run_input_open(const char *path, char *why, size_t size)
{
    struct stat s;
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK); /* a FIFO must not hold us up */
    if (fd >= 0 && fstat(fd, &s) == 0 && S_ISREG(s.st_mode))
        return fd;
    int error = fd < 0 ? errno : EINVAL;
    snprintf(why, size, "%.300s: %s", path, fd < 0 ? strerror(error) : "not a regular file");
    if (fd >= 0)
        close(fd);
    errno = error;
    return -1;
}

static void request_submit(struct run *r, struct run_frame *f, int input_fd)
{
    struct airy_request request = r->request;
    struct airy_error e;
    request.input_fd = input_fd;
    request.plan_only = f->asking;
    if (airy_submit(r->session.airy, &request, &f->id, &e) == 0) {
        f->state = RUN_IN_FLIGHT;
        r->in_flight++;
    } else if (airy_fd(r->session.airy) >= 0) {
        frame_refused(r, f, &e);
    } else {
        if (++f->tries >= TRIES_MAX)
            frame_fail(r, f, &e, CMD_RETRY);
        connection_lost(r, &e);
    }
}

/* What the request names by file is there before the first frame. True when it is. */
static bool assets_ready(struct run *r, struct run_frame *f)
{
    struct airy_error e;
    if (r->assets_sent)
        return true;
    r->request = r->o->request;
    if (!r->assets_named || assets_send(r->session.airy, &r->o->request, &r->request, &e) == 0)
        return r->assets_sent = true;
    bool lost = airy_fd(r->session.airy) < 0;
    if (!lost && !e.retryable) {
        r->abort = true;
        fail_all(r, &e);
        return false;
    }
    if (++f->tries < TRIES_MAX)
        pause_for(e.retry_after_ms);
    else
        frame_fail(r, f, &e, CMD_RETRY);
    if (lost)
        connection_lost(r, &e);
    return false;
}

/* The frame's input, or a black one in its place; -1: the frame has ended. */
static int frame_input(struct run *r, struct run_frame *f)
{
    char why[EXR_WHY_MAX];
    _Static_assert((int)EXR_WHY_MAX >= (int)RUN_WHY_MAX, "both are said with it");
    int fd = run_input_open(f->input, why, RUN_WHY_MAX);
    f->black = false;
    if (fd >= 0)
        return fd;
    bool missing = errno == ENOENT;
    if (missing && r->o->on_missing == RUN_MISSING_SKIP) {
        frame_pass(r, f, REPORT_MISSING, NULL);
        return -1;
    }
    if (missing && f->model && (fd = exr_black(f->model, why)) >= 0) {
        f->black = true;
        return fd;
    }
    struct airy_error e = local_error(missing ? ENOENT : EIO, "input", why);
    frame_fail(r, f, &e, CMD_INPUT);
    return -1;
}

/* A daemon is looked for, or started, only when there is something to send; one that was there is waited for. */
static bool session_ready(struct run *r)
{
    struct airy_error e;
    double end_ms = now_ms() + RECONNECT_MS;
    while (!r->session.airy && session_open(&r->session, &r->o->session, &e) < 0) {
        if (!r->was_connected || now_ms() > end_ms || cmd_exit_of(&e) != CMD_RETRY) {
            fail_all(r, &e);
            return false;
        }
        pause_for(100);
    }
    return r->was_connected = true;
}

static void frame_submit(struct run *r, struct run_frame *f)
{
    char why[OUTPUT_WHY_MAX];
    int fd = frame_input(r, f);
    if (fd < 0)
        return;
    /* Only a file with a stamp is worth a question. */
    f->asking = !r->o->force && !f->asked && exr_has_stamp(f->output);
    if (!f->asking && output_check(f->output, r->o->overwrite, why) < 0) {
        struct airy_error e = local_error(EIO, "output", why);
        frame_fail(r, f, &e, CMD_OUTPUT);
    } else if (session_ready(r) && assets_ready(r, f)) {
        request_submit(r, f, fd);
    }
    close(fd);
}

/* Of those under suspicion the one that fewest daemons were lost with, alone. */
static void submit_suspect(struct run *r)
{
    struct run_frame *next = NULL;
    for (size_t i = r->first_open; i < r->n && r->in_flight == 0; i++) {
        struct run_frame *f = &r->frames[i];
        if (f->state == RUN_WAITING && f->suspect && (!next || f->tries < next->tries))
            next = f;
    }
    if (next)
        frame_submit(r, next);
}

static void submit_some(struct run *r)
{
    if (r->suspects) {
        submit_suspect(r);
        return;
    }
    for (size_t i = r->first_open; i < r->n && !r->abort; i++) {
        if (r->in_flight >= r->o->jobs || (r->hold && r->in_flight))
            return;
        if (r->frames[i].state == RUN_WAITING)
            frame_submit(r, &r->frames[i]);
    }
}

/* ---- out ---------------------------------------------------------------------------------------------
 */

static struct run_frame *frame_of(struct run *r, uint64_t id)
{
    for (size_t i = r->first_open; i < r->n; i++)
        if (r->frames[i].state == RUN_IN_FLIGHT && r->frames[i].id == id)
            return &r->frames[i];
    return NULL;
}

static void receive_one(struct run *r)
{
    uint64_t id = 0;
    struct airy_result *result = NULL;
    struct airy_error e;
    int got = airy_wait_any(r->session.airy, -1, &id, &result, &e);
    struct run_frame *f = id ? frame_of(r, id) : NULL;
    if (got == 1 && f && f->asking)
        frame_judge(r, f, result);
    else if (got == 1 && f)
        frame_done(r, f, result);
    else if (got == -1 && f && !(e.code < 0 && airy_fd(r->session.airy) < 0))
        frame_refused(r, f, &e);
    else if (got == -1)
        connection_lost(r, &e);
    airy_result_free(result);
}

static bool is_output(void *ctx, const char *base, size_t len)
{
    const struct run *r = ctx;
    for (size_t i = 0; i < r->n; i++)
        if (output_is_base(r->frames[i].output, base, len))
            return true;
    return false;
}

/* What earlier runs on these frames left half-written when they were killed, once for each folder. */
static void clean_folders(struct run *r)
{
    const char *last = "";
    size_t last_len = 0;
    for (size_t i = 0; i < r->n; i++) {
        const char *output = r->frames[i].output, *slash = strrchr(output, '/');
        size_t len = slash ? (size_t)(slash + 1 - output) : 0;
        if (i > 0 && len == last_len && memcmp(output, last, len) == 0)
            continue;
        char *folder = len ? strndup(output, len) : strdup(".");
        if (folder)
            output_clean(folder, is_output, r);
        free(folder);
        last = output;
        last_len = len;
    }
}

enum cmd_exit run_frames(const struct run_options *o, struct run_frame *frames, size_t n)
{
    struct run r = { .o = o, .frames = frames, .n = n, .session = SESSION_NONE };
    r.assets_named = assets_named(&o->request);
    clean_folders(&r);
    progress_begin(&r.progress, n, o->quiet || (o->json && n == 1));
    while (r.ended < n && !r.abort) {
        while (r.first_open < n && frames[r.first_open].state == RUN_ENDED)
            r.first_open++;
        submit_some(&r);
        if (r.session.airy && r.in_flight)
            receive_one(&r);
    }
    session_close(&r.session);
    progress_end(&r.progress);
    return r.status != CMD_DONE ? r.status : r.failed ? CMD_RETRY : CMD_DONE;
}
