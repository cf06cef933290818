/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_wall_use.h - a wall to work with, by what the operator says: a definition's file, or the name of a wall that a daemon has
 * open. A file's wall is opened for the command's life, unless one of its name is open already: then that one is used, as it
 * is. What is wrong is said on stderr, with what to do.
 */
#ifndef AIRY_CMD_WALL_USE_H
#define AIRY_CMD_WALL_USE_H

#include "cmd.h"
#include "cmd_session.h"
#include "wall_def.h"

enum { WALL_TIMEOUT_MS = 5000 };

struct wall_use {
    struct session session;
    const char *command;      /* "wall play", for messages */
    char name[WALL_NAME_MAX];
    bool ours;                /* opened here: it closes with us */
    bool is_private;          /* the daemon is */
    double rate;
    uint32_t width, height;
    double hold_s, fade_s;    /* of a file; else 0 */
};

struct wall_file {
    char *text;               /* owned */
    struct wall_def *def;     /* owned */
};

/* Is it a file, there or only meant? */
bool wall_is_file(const char *what);
/* Every mistake is said, with its line. CMD_DONE, or not and nothing to finish. */
enum cmd_exit wall_use_read(struct wall_file *f, const char *path);
void wall_file_finish(struct wall_file *f);

/* CMD_DONE, or not: then the session is closed. */
enum cmd_exit wall_use_open(struct wall_use *u, const char *what, const struct session_options *o, const char *command);
/* The same again, after the daemon was lost; quietly. 0, or -1 and *e. */
int wall_use_again(struct wall_use *u, const char *what, const struct session_options *o, struct airy_error *e);
/* Closes what was opened here; black first. */
void wall_use_close(struct wall_use *u);

/* A daemon that is there: a wall that others are to find cannot be a private one's. */
int wall_daemon(struct session *s, const struct session_options *o, struct airy_error *e);
/* OPEN, the calibration's image first. keep: as in the protocol. */
int wall_open_file(struct airy *a, const struct wall_file *f, const char *path, bool keep, struct airy_error *e);
/* A reply with at least one wall, the caller's; NULL and *e. */
struct airy_wall_reply *wall_ask(struct airy *a, const struct airy_wall_request *q, struct airy_error *e);

/* An error in words, with what to do next where that is known; its exit status. */
enum cmd_exit wall_complain(const char *command, const struct airy_error *e);

#endif
