/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_cleanup.h - what must not stay when a signal ends the command: one half-written file, and the
 * private daemon's socket and folder. (The private daemon itself goes by its lifetime descriptor.) Main
 * thread only.
 */
#ifndef AIRY_CMD_CLEANUP_H
#define AIRY_CMD_CLEANUP_H

#include <signal.h>

/* SIGINT, SIGTERM and SIGHUP remove what is registered, and then end the command as they would have. A
 * signal that is ignored stays so. SIGPIPE and SIGXFSZ become errors of write. */
void cleanup_install(void);

/* Between these no signal comes in: for making something and registering it as one step. */
void cleanup_hold(sigset_t *saved);
void cleanup_release(const sigset_t *saved);

/* The strings and the descriptor stay the caller's, and valid until cleared with NULL. */
void cleanup_set_file(int folder_fd, const char *name);
void cleanup_set_folder(const char *folder, const char *socket, const char *lock);

#endif
