/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_session.h - the command's connection: to a daemon that is there, or to a private one that lives as
 * long as the command. The private daemon holds the read end of a pipe (--lifetime-fd) whose only write
 * end is ours: so it goes when the command goes, however that happens.
 */
#ifndef AIRY_CMD_SESSION_H
#define AIRY_CMD_SESSION_H

#include <stdbool.h>
#include <sys/types.h>

#include "airy.h"

struct session {
    struct airy *airy; /* NULL: not open */
    pid_t daemon;      /* of a private one; 0: none */
    int lifetime_fd, log_fd;
    char folder[128], socket[160], lock[160]; /* of a private one */
};

#define SESSION_NONE                                                                                    \
    {                                                                                                   \
        .lifetime_fd = -1, .log_fd = -1                                                                 \
    }

struct session_options {
    const char *socket; /* NULL: the usual places, else a private daemon */
    const char *device; /* for a private daemon, which it asks for; NULL: any */
};

/* 0, or -1 and *e. The connection does not come back by itself: what to do about a lost daemon is the caller's. */
int session_open(struct session *s, const struct session_options *o, struct airy_error *e);
/* Ends a private daemon, too. A session that is not open is fine. */
void session_close(struct session *s);

#endif
