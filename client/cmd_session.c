// SPDX-License-Identifier: Apache-2.0
// cmd_session.c - finds a daemon, or starts one. What a private daemon prints goes into an anonymous
// file, and is shown only when it does not come up.
#include "cmd_session.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "cmd.h"
#include "cmd_cleanup.h"

enum { START_SECONDS = 120, STOP_SECONDS = 10 };

static int local_error(struct airy_error *e, int error, const char *what)
{
    *e = (struct airy_error){ .code = -error };
    snprintf(e->symbol, sizeof(e->symbol), "LOCAL");
    snprintf(e->text, sizeof(e->text), "%s: %s", what, strerror(error));
    return -1;
}

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void pause_ms(long ms)
{
    struct timespec t = { ms / 1000, ms % 1000 * 1000000 };
    nanosleep(&t, NULL);
}

/* ---- the private daemon ---------------------------------------------------------------------- */

/* $AIRYD, else airyd beside this program, else a bare name for $PATH. */
static void program_path(char *out, size_t size)
{
    const char *given = getenv("AIRYD");
    if (given && *given) {
        snprintf(out, size, "%s", given);
        return;
    }
    ssize_t n = readlink("/proc/self/exe", out, size - 1);
    if (n > 0) {
        out[n] = '\0';
        char *slash = strrchr(out, '/');
        if (slash && (size_t)(slash + 1 - out) + sizeof("airyd") <= size) {
            memcpy(slash + 1, "airyd", sizeof("airyd"));
            if (access(out, X_OK) == 0)
                return;
        }
    }
    snprintf(out, size, "airyd");
}

static int folder_make(struct session *s, struct airy_error *e)
{
    const char *bases[] = { getenv("XDG_RUNTIME_DIR"), getenv("TMPDIR"), "/tmp" };
    const struct sockaddr_un *limit = NULL;
    int error = ENOENT;
    sigset_t saved;
    for (unsigned i = 0; i < 3; i++) {
        /* A socket's path has little room. */
        if (!bases[i] || strlen(bases[i]) + sizeof("/airy-XXXXXX/airyd.sock") > sizeof(limit->sun_path))
            continue;
        snprintf(s->folder, sizeof(s->folder), "%s/airy-XXXXXX", bases[i]);
        cleanup_hold(&saved);
        bool made = mkdtemp(s->folder) != NULL;
        error = errno;
        if (made) {
            snprintf(s->socket, sizeof(s->socket), "%s/airyd.sock", s->folder);
            snprintf(s->lock, sizeof(s->lock), "%s/airyd.sock.lock", s->folder);
            cleanup_set_folder(s->folder, s->socket, s->lock);
        }
        cleanup_release(&saved);
        if (made)
            return 0;
    }
    s->folder[0] = '\0';
    return local_error(e, error, "a folder for the private daemon's socket");
}

/* In the child: only what may be called between fork and exec. */
static _Noreturn void become_daemon(const char *program, char *const argv[], int lifetime_fd, int log_fd)
{
    static const char text[] = "airyd cannot be run; is it beside airy, in $PATH, or named by $AIRYD?\n";
    struct sigaction normal = { .sa_handler = SIG_DFL };
    sigset_t none;
    sigemptyset(&none);
    sigaction(SIGPIPE, &normal, NULL);
    sigaction(SIGXFSZ, &normal, NULL);
    sigprocmask(SIG_SETMASK, &none, NULL);
    setpgid(0, 0); /* a Ctrl-C on the terminal is for the command */
    int null_fd = open("/dev/null", O_RDONLY);
    if (null_fd >= 0 && dup2(null_fd, 0) >= 0 && dup2(log_fd, 1) >= 0 && dup2(log_fd, 2) >= 0 &&
        fcntl(lifetime_fd, F_SETFD, 0) == 0)
        execvp(program, argv);
    if (write(log_fd, text, sizeof(text) - 1) < 0)
        _exit(126);
    _exit(127);
}

static int daemon_start(struct session *s, const char *device, struct airy_error *e)
{
    char program[PATH_MAX], fd_text[16];
    int ends[2];
    s->log_fd = memfd_create("airyd log", MFD_CLOEXEC);
    if (s->log_fd < 0)
        return local_error(e, errno, "an anonymous file");
    /* Above the standard descriptors, which the child replaces. */
    if (pipe2(ends, O_CLOEXEC) < 0)
        return local_error(e, errno, "a pipe");
    int read_end = fcntl(ends[0], F_DUPFD_CLOEXEC, 3);
    s->lifetime_fd = fcntl(ends[1], F_DUPFD_CLOEXEC, 3);
    close(ends[0]);
    close(ends[1]);
    if (read_end < 0 || s->lifetime_fd < 0) {
        int error = errno;
        if (read_end >= 0)
            close(read_end);
        return local_error(e, error, "a pipe");
    }
    program_path(program, sizeof(program));
    snprintf(fd_text, sizeof(fd_text), "%d", read_end);
    char *argv[] = { program,         "--socket", s->socket,
                     "--lifetime-fd", fd_text,    device ? "--device" : NULL,
                     (char *)device,  NULL };
    s->daemon = fork();
    if (s->daemon == 0)
        become_daemon(program, argv, read_end, s->log_fd);
    int error = errno;
    close(read_end);
    if (s->daemon > 0)
        return 0;
    s->daemon = 0;
    return local_error(e, error, "fork");
}

/* The last lines that the daemon printed. */
static void log_tail(const struct session *s, char *out, size_t size)
{
    struct stat st = { 0 };
    ssize_t n = 0;
    if (fstat(s->log_fd, &st) == 0) {
        off_t from = st.st_size > (off_t)size - 1 ? st.st_size - (off_t)size + 1 : 0;
        n = pread(s->log_fd, out, size - 1, from);
    }
    n = n > 0 ? n : 0;
    while (n > 0 && out[n - 1] == '\n')
        n--;
    out[n] = '\0';
    for (ssize_t i = 0; i < n; i++)
        out[i] = out[i] == '\n' ? ';' : out[i];
}

/* Has the daemon ended? *e says how. */
static bool daemon_gone(struct session *s, struct airy_error *e)
{
    int status;
    char said[256];
    if (waitpid(s->daemon, &status, WNOHANG) != s->daemon)
        return false;
    s->daemon = 0;
    log_tail(s, said, sizeof(said));
    *e = (struct airy_error){ .code = -ECHILD };
    snprintf(e->symbol, sizeof(e->symbol), "LOCAL");
    snprintf(e->text, sizeof(e->text), "the private daemon ended with %s %d: %s",
             WIFSIGNALED(status) ? "signal" : "status",
             WIFSIGNALED(status) ? WTERMSIG(status) : WEXITSTATUS(status),
             *said ? said : "it said nothing");
    return true;
}

static int daemon_connect(struct session *s, struct airy_error *e)
{
    double end_s = now_s() + START_SECONDS;
    for (;;) {
        if (cmd_connect(&s->airy, s->socket, e) == 0)
            return 0;
        if (e->code > 0)
            return -1; /* it answered, and does not want us */
        if (daemon_gone(s, e))
            return -1;
        if (now_s() > end_s) {
            local_error(e, ETIMEDOUT, "the private daemon does not answer");
            return -1;
        }
        pause_ms(10);
    }
}

/* ---- the interface ----------------------------------------------------------------------------------
 */

int session_open(struct session *s, const struct session_options *o, struct airy_error *e)
{
    *s = (struct session)SESSION_NONE;
    if (o->socket || !o->device) {
        if (cmd_connect(&s->airy, o->socket, e) == 0)
            return 0;
        if (o->socket || e->code > 0)
            return -1;
    }
    if (folder_make(s, e) == 0 && daemon_start(s, o->device, e) == 0 && daemon_connect(s, e) == 0)
        return 0;
    session_close(s);
    return -1;
}

static void daemon_stop(struct session *s)
{
    double end_s = now_s() + STOP_SECONDS;
    while (waitpid(s->daemon, NULL, WNOHANG) == 0) {
        if (now_s() > end_s) {
            kill(s->daemon, SIGKILL);
            waitpid(s->daemon, NULL, 0);
            break;
        }
        pause_ms(5);
    }
    s->daemon = 0;
}

void session_close(struct session *s)
{
    airy_close(s->airy);
    s->airy = NULL;
    if (s->lifetime_fd >= 0)
        close(s->lifetime_fd);
    if (s->daemon > 0)
        daemon_stop(s);
    if (s->log_fd >= 0)
        close(s->log_fd);
    s->lifetime_fd = s->log_fd = -1;
    if (s->folder[0]) {
        unlink(s->socket); /* the daemon has, unless it was killed */
        unlink(s->lock);
        rmdir(s->folder);
        cleanup_set_folder(NULL, NULL, NULL);
        s->folder[0] = '\0';
    }
}
