// SPDX-License-Identifier: Apache-2.0
// cmd_wall_use.c - see cmd_wall_use.h. The definition is read here, too: for its name and its image, and so that all mistakes
// are told before a daemon is asked.
#include "cmd_wall_use.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "cmd.h"
#include "cmd_run.h"
#include "cmd_wall.h"

enum { CODE_NO_WALL = 224, CODE_WALL = 305, CODE_WALL_BUSY = 403, CLOSE_TIMEOUT_MS = 3000, PATH_ROOM = 4096 };

static int local_error(struct airy_error *e, int error, const char *text)
{
    *e = (struct airy_error){ .code = -error, .symbol = "LOCAL" };
    snprintf(e->text, sizeof(e->text), "%.380s", text);
    return -1;
}

enum cmd_exit wall_complain(const char *command, const struct airy_error *e)
{
    const char *hint = "";
    if (e->code == CODE_NO_WALL)
        hint = "; airy wall list says which are open, airy wall open FILE --keep opens one";
    else if (e->code == CODE_WALL_BUSY)
        hint = "; stop the other one (airy wall stats shows what it does), or wait";
    else if (e->code == CODE_WALL)
        hint = "; airy wall check FILE says all that is wrong";
    else if (e->code == -ENOTSUP)
        hint = "; restart it with a newer airyd";
    else if (e->code == -ECONNREFUSED || e->code == -ENOENT)
        hint = "; start airyd (systemctl start airyd), or see --socket";
    cmd_complain("%s: %s%s%s%s", command, e->field, *e->field ? ": " : "", e->text, hint);
    return cmd_exit_of(e);
}

/* ---- definitions ---------------------------------------------------------------------------------- */

static bool ends_in(const char *s, const char *end)
{
    size_t n = strlen(s), m = strlen(end);
    return n > m && strcmp(s + n - m, end) == 0;
}

bool wall_is_file(const char *what)
{
    struct stat s;
    return ends_in(what, ".yaml") || ends_in(what, ".yml") || strchr(what, '/') || (stat(what, &s) == 0 && S_ISREG(s.st_mode));
}

enum cmd_exit wall_use_read(struct wall_file *f, const char *path)
{
    struct fault fault;
    size_t bytes;
    *f = (struct wall_file){ 0 };
    enum cmd_exit exit = wall_file_read(path, &f->text, &bytes);
    if (exit != CMD_DONE || wall_def_parse(&f->def, f->text, bytes, NULL, &fault) == 0)
        return exit;
    wall_file_finish(f);
    exit = wall_file_parse(path, false, &f->def); /* says all that is wrong */
    if (exit == CMD_DONE) {
        cmd_complain("wall: %s has changed meanwhile; try again", path);
        wall_file_finish(f);
        exit = CMD_RETRY;
    }
    return exit;
}

void wall_file_finish(struct wall_file *f)
{
    wall_def_free(f->def);
    free(f->text);
    *f = (struct wall_file){ 0 };
}

/* The image of the gains; its path is relative to the definition. */
static int calibration_send(struct airy *a, const struct wall_def *d, const char *definition, struct airy_asset *kept,
                            struct airy_error *e)
{
    char path[PATH_ROOM], why[RUN_WHY_MAX];
    const char *slash = strrchr(definition, '/');
    int folder = slash && d->calibration[0] != '/' ? (int)(slash + 1 - definition) : 0;
    if (snprintf(path, sizeof(path), "%.*s%s", folder, definition, d->calibration) >= (int)sizeof(path))
        return local_error(e, ENAMETOOLONG, "calibration: the path is too long");
    int fd = run_input_open(path, why, sizeof(why));
    if (fd < 0) {
        local_error(e, ENOENT, why);
        snprintf(e->field, sizeof(e->field), "calibration");
        e->code = CODE_WALL; /* a mistake of the definition: not what may pass */
        return -1;
    }
    int rc = airy_asset(a, fd, NULL, 0, kept, e);
    close(fd);
    if (rc < 0 && e->code > 0)
        snprintf(e->field, sizeof(e->field), "calibration");
    return rc;
}

/* ---- asking ------------------------------------------------------------------------------------------ */

struct airy_wall_reply *wall_ask(struct airy *a, const struct airy_wall_request *q, struct airy_error *e)
{
    struct airy_wall_reply *r = NULL;
    if (airy_wall(a, q, WALL_TIMEOUT_MS, &r, e) < 0)
        return NULL;
    if (r->n_walls)
        return r;
    airy_wall_reply_free(r);
    local_error(e, EPROTO, "the daemon's answer has no wall in it");
    return NULL;
}

int wall_open_file(struct airy *a, const struct wall_file *f, const char *path, bool keep, struct airy_error *e)
{
    struct airy_asset kept = { .digest = "" };
    if (f->def->calibration[0] && calibration_send(a, f->def, path, &kept, e) < 0)
        return -1;
    struct airy_wall_reply *r = wall_ask(
        a, &(struct airy_wall_request){ .action = AIRY_WALL_OPEN, .definition = f->text, .calibration = kept.digest, .keep = keep },
        e);
    airy_wall_reply_free(r);
    return r ? 0 : -1;
}

int wall_daemon(struct session *s, const struct session_options *o, struct airy_error *e)
{
    *s = (struct session)SESSION_NONE;
    return cmd_connect(&s->airy, o->socket, e); /* the wall goes with it: wall_use_again */
}

/* What the daemon says of the wall by this name. 0, or -1 and *e. */
static int wall_find(struct wall_use *u, const char *name, struct airy_error *e)
{
    struct airy_wall_reply *r =
        wall_ask(u->session.airy, &(struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = name }, e);
    if (!r)
        return -1;
    snprintf(u->name, sizeof(u->name), "%s", name);
    u->rate = r->walls[0].rate;
    u->width = r->walls[0].width;
    u->height = r->walls[0].height;
    airy_wall_reply_free(r);
    return 0;
}

static int use_file(struct wall_use *u, const struct wall_file *f, const char *path, struct airy_error *e)
{
    u->hold_s = f->def->hold_s;
    u->fade_s = f->def->fade_s;
    u->ours = false;
    if (wall_find(u, f->def->name, e) == 0)
        return 0;
    if (e->code != CODE_NO_WALL || wall_open_file(u->session.airy, f, path, false, e) < 0)
        return -1;
    u->ours = true;
    return wall_find(u, f->def->name, e);
}

enum cmd_exit wall_use_open(struct wall_use *u, const char *what, const struct session_options *o, const char *command)
{
    struct airy_error e;
    struct wall_file f = { 0 };
    *u = (struct wall_use){ .session = SESSION_NONE, .command = command };
    if (wall_is_file(what)) {
        enum cmd_exit exit = wall_use_read(&f, what);
        if (exit != CMD_DONE)
            return exit;
    } else if (o->device) {
        cmd_complain("%s: --device is for a private daemon, and wall \"%s\" can only be another's; name the definition's file", command,
                     what);
        return CMD_USAGE;
    }
    bool ok = f.def ? session_open(&u->session, o, &e) == 0 && use_file(u, &f, what, &e) == 0
                    : wall_daemon(&u->session, o, &e) == 0 && wall_find(u, what, &e) == 0;
    u->is_private = u->session.daemon > 0;
    if (ok && f.def && !u->ours)
        cmd_complain("%s: wall \"%s\" is open already, and used as it is (airy wall close %s first, if %s has changed)", command,
                     u->name, u->name, what);
    enum cmd_exit exit = CMD_DONE;
    if (!ok && !f.def && !u->session.airy && e.code < 0) {
        cmd_complain("%s: \"%s\" is no file, so it has to be a wall that a daemon has open; %s", command, what, e.text);
        exit = CMD_RETRY;
    } else if (!ok) {
        exit = wall_complain(command, &e);
    }
    wall_file_finish(&f);
    if (!ok)
        wall_use_close(u);
    return exit;
}

int wall_use_again(struct wall_use *u, const char *what, const struct session_options *o, struct airy_error *e)
{
    struct wall_file f = { 0 };
    session_close(&u->session);
    /* While the daemon of others restarts, a private one would take its boards. */
    int rc = u->is_private ? session_open(&u->session, o, e) : wall_daemon(&u->session, o, e);
    if (rc == 0 && !wall_is_file(what))
        rc = wall_find(u, what, e);
    else if (rc == 0 && wall_use_read(&f, what) == CMD_DONE)
        rc = use_file(u, &f, what, e);
    else if (rc == 0)
        rc = local_error(e, EINVAL, "the definition is not what it was");
    wall_file_finish(&f);
    if (rc < 0)
        session_close(&u->session);
    return rc;
}

void wall_use_close(struct wall_use *u)
{
    struct airy_wall_reply *r = NULL;
    if (u->session.airy && u->ours &&
        airy_wall(u->session.airy, &(struct airy_wall_request){ .action = AIRY_WALL_CLOSE, .name = u->name }, CLOSE_TIMEOUT_MS, &r,
                  NULL) == 0)
        airy_wall_reply_free(r);
    u->ours = false;
    session_close(&u->session);
}
