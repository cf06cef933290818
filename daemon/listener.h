/* SPDX-License-Identifier: Apache-2.0 */
/*
 * listener.h - the sockets that are listened on: from systemd, or a path of our own.
 *
 * A path is ours from listener_bind to listener_finish: a lock file beside it (PATH.lock) is held for
 * that long, so two daemons never fight for one path, and a socket file that nobody answers on can
 * be replaced without a race. At the end only a socket file that is still ours is removed.
 */
#ifndef AIRYD_LISTENER_H
#define AIRYD_LISTENER_H

#include <stdbool.h>
#include <sys/types.h>

#include "fault.h"

enum { LISTENER_FDS_MAX = 8 };

struct listener {
    int fd[LISTENER_FDS_MAX];
    unsigned count;
    char path[108]; /* empty: from systemd */
    int lock_fd;
    dev_t dev;
    ino_t ino;
};

/* Takes what systemd passed; count 0 when it passed nothing. 0, or -1 and *f. */
int listener_from_systemd(struct listener *l, struct fault *f);
/* The default path: $XDG_RUNTIME_DIR/airyd.sock, for root /run/airyd/airyd.sock. */
int listener_default_path(char *out, size_t size, struct fault *f);
/* Binds PATH, mode 0660 less the umask; connects are refused until listener_listen. */
int listener_bind(struct listener *l, const char *path, struct fault *f);
int listener_listen(struct listener *l, struct fault *f);
/* Closes, and removes what is ours. Safe on a zeroed struct with lock_fd -1, and twice. */
void listener_finish(struct listener *l);

#endif
