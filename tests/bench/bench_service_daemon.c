// SPDX-License-Identifier: Apache-2.0
// bench_service_daemon.c - airyd as a child of the bench, and what /proc tells of it: see bench_service.h.
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bench_service.h"

enum { START_MS = 30000, ARGUMENTS_MAX = 32 };

void service_prepare(struct service *s, const char *airyd)
{
    *s = (struct service){ .airyd = airyd, .lifetime_fd = -1 };
    strcpy(s->dir, "/tmp/airy-bench-XXXXXX");
    if (!mkdtemp(s->dir) || chmod(s->dir, 0755) < 0)
        die("%s: %s", s->dir, strerror(errno));
    snprintf(s->socket, sizeof s->socket, "%s/s", s->dir);
}

void service_exec(const struct service *s, int lifetime_fd, const char *const *extra)
{
    char fd_text[16], threads[16];
    snprintf(fd_text, sizeof fd_text, "%d", lifetime_fd);
    snprintf(threads, sizeof threads, "%d", TEAM);
    // A service's own way to warm up; a lifetime would change it.
    const char *arguments[ARGUMENTS_MAX] = { s->airyd,    "--socket", s->socket, "--lifetime-fd", fd_text,
                                             "--threads", threads,    "--warm",  "idle" };
    unsigned n = 9;
    while (extra && *extra && n < ARGUMENTS_MAX - 1)
        arguments[n++] = *extra++;
    // What it says is of no interest while it works.
    int quiet = open("/dev/null", O_WRONLY | O_CLOEXEC);
    if (quiet >= 0 && !getenv("AIRY_BENCH_VERBOSE"))
        dup2(quiet, STDERR_FILENO);
    execv(s->airyd, (char *const *)arguments);
    _exit(127);
}

struct airy *service_connect(const struct service *s)
{
    struct airy *a;
    struct airy_error e;
    for (double end = now_ms() + START_MS; airy_connect(&a, s->socket, &e) < 0; pause_ms(5)) {
        int status = 0;
        if (s->pid && waitpid(s->pid, &status, WNOHANG) == s->pid)
            die("%s ended with status 0x%x", s->airyd, (unsigned)status);
        if (now_ms() > end)
            die("%s did not start: %s", s->airyd, e.text);
    }
    if (chmod(s->socket, 0666) < 0)
        die("%s: %s", s->socket, strerror(errno));
    return a;
}

void service_start(struct service *s, const char *const *extra)
{
    int ends[2];
    if (pipe(ends))
        die("a pipe for airyd: %s", strerror(errno));
    fcntl(ends[1], F_SETFD, FD_CLOEXEC);
    fflush(stdout);
    if ((s->pid = fork()) < 0)
        die("fork: %s", strerror(errno));
    if (s->pid == 0)
        service_exec(s, ends[0], extra);
    close(ends[0]);
    s->lifetime_fd = ends[1];
    airy_close(service_connect(s));
}

void service_stop(struct service *s)
{
    int status;
    kill(s->pid, SIGTERM);
    if (waitpid(s->pid, &status, 0) != s->pid || status)
        die("%s ended with status 0x%x", s->airyd, (unsigned)status);
    close(s->lifetime_fd);
    s->lifetime_fd = -1;
    s->pid = 0;
}

static int remove_one(const char *path, const struct stat *st, int type, struct FTW *at)
{
    (void)st;
    (void)type;
    (void)at;
    return remove(path);
}

void service_remove(struct service *s)
{
    if (nftw(s->dir, remove_one, 16, FTW_DEPTH | FTW_PHYS) < 0)
        die("removing %s: %s", s->dir, strerror(errno));
}

static unsigned count_entries(const char *path)
{
    unsigned n = 0;
    DIR *dir = opendir(path);
    for (struct dirent *d; dir && (d = readdir(dir));)
        n += d->d_name[0] != '.';
    if (dir)
        closedir(dir);
    return n;
}

struct service_size service_size(pid_t pid)
{
    char path[64], line[256];
    unsigned long long rss = 0, anonymous = 0;
    struct service_size size = { 0 };
    snprintf(path, sizeof path, "/proc/%d/status", (int)pid);
    FILE *file = fopen(path, "re");
    while (file && fgets(line, sizeof line, file)) {
        sscanf(line, "VmRSS: %llu", &rss);
        sscanf(line, "RssAnon: %llu", &anonymous);
        sscanf(line, "Threads: %u", &size.threads);
    }
    if (file)
        fclose(file);
    if (!rss)
        die("%s has no VmRSS", path);
    size.rss_bytes = (double)rss * 1024;
    size.anonymous_bytes = (double)anonymous * 1024;
    snprintf(path, sizeof path, "/proc/%d/fd", (int)pid);
    size.fds = count_entries(path);
    return size;
}
