// SPDX-License-Identifier: Apache-2.0
// cmd_cleanup.c - the handler calls only what is async-signal-safe, and sees whole registrations,
// because they change only while the signals are held.
#include "cmd_cleanup.h"

#include <stddef.h>
#include <unistd.h>

static const int ending[] = { SIGINT, SIGTERM, SIGHUP };
enum { N_ENDING = sizeof(ending) / sizeof(ending[0]) };

static struct {
    int folder_fd;
    const char *file;
    const char *folder, *socket, *lock;
} registered;

static void handle(int signal)
{
    if (registered.file)
        unlinkat(registered.folder_fd, registered.file, 0);
    if (registered.folder) {
        unlink(registered.socket);
        unlink(registered.lock);
        rmdir(registered.folder);
    }
    /* SA_RESETHAND has put the default back: the raised signal ends the process when the handler
     * returns. */
    raise(signal);
}

void cleanup_install(void)
{
    struct sigaction a = { .sa_handler = handle, .sa_flags = (int)SA_RESETHAND }, old;
    for (unsigned i = 0; i < N_ENDING; i++)
        sigaddset(&a.sa_mask, ending[i]);
    for (unsigned i = 0; i < N_ENDING; i++)
        if (sigaction(ending[i], NULL, &old) == 0 && old.sa_handler != SIG_IGN)
            sigaction(ending[i], &a, NULL);
    struct sigaction ignore = { .sa_handler = SIG_IGN };
    sigaction(SIGPIPE, &ignore, NULL);
    sigaction(SIGXFSZ, &ignore, NULL);
}

void cleanup_hold(sigset_t *saved)
{
    sigset_t set;
    sigemptyset(&set);
    for (unsigned i = 0; i < N_ENDING; i++)
        sigaddset(&set, ending[i]);
    sigprocmask(SIG_BLOCK, &set, saved);
}

void cleanup_release(const sigset_t *saved) { sigprocmask(SIG_SETMASK, saved, NULL); }

void cleanup_set_file(int folder_fd, const char *name)
{
    sigset_t saved;
    cleanup_hold(&saved);
    registered.folder_fd = folder_fd;
    registered.file = name;
    cleanup_release(&saved);
}

void cleanup_set_folder(const char *folder, const char *socket, const char *lock)
{
    sigset_t saved;
    cleanup_hold(&saved);
    registered.folder = folder;
    registered.socket = socket;
    registered.lock = lock;
    cleanup_release(&saved);
}
