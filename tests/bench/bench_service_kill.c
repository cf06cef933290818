// SPDX-License-Identifier: Apache-2.0
// bench_service_kill.c - from kill -9 of the daemon to the next frame served, under a supervisor that starts it again at once, as systemd does: as a
// client sees it that connects again and again, with the driver's cache of shaders empty and filled; and as `airy bloom` does it over a range.
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bench_service.h"

enum { SETTLE_MS = 3000, BETWEEN_MS = 100, BACK_MS = 60000, RANGE_FRAMES = 400, RANGE_KILL_AT = 40, RANGE_ROUNDS = 5, LINE_MAX_BYTES = 4096 };

/* ---- the supervisor, a process of its own -------------------------------------------------------------------- */

struct shared { /* with the supervisor */
    atomic_int daemon;
    atomic_uint starts;
    char cache[96]; /* of the next start; written while the daemon runs, read when it has ended */
};

struct supervised {
    struct service service;
    struct shared *shared;
    pid_t supervisor;
};

static _Noreturn void supervise(const struct supervised *s)
{
    // With the supervisor the daemon's lifetime pipe closes.
    int ends[2];
    if (prctl(PR_SET_PDEATHSIG, SIGKILL) < 0 || pipe(ends) < 0 || fcntl(ends[1], F_SETFD, FD_CLOEXEC) < 0)
        _exit(1);
    for (;;) {
        pid_t pid = fork();
        if (pid < 0)
            _exit(1);
        if (pid == 0) {
            setenv("MESA_SHADER_CACHE_DIR", s->shared->cache, 1);
            service_exec(&s->service, ends[0], NULL);
        }
        atomic_store(&s->shared->daemon, pid);
        atomic_fetch_add(&s->shared->starts, 1);
        waitpid(pid, NULL, 0);
    }
}

static void cache_name(struct supervised *s, const char *word, unsigned number)
{
    snprintf(s->shared->cache, sizeof s->shared->cache, "%s/%s%u", s->service.dir, word, number);
    if (mkdir(s->shared->cache, 0700) < 0 && errno != EEXIST)
        die("%s: %s", s->shared->cache, strerror(errno));
}

static void supervised_start(struct supervised *s, const struct service_options *o)
{
    service_prepare(&s->service, o->airyd);
    s->shared = mmap(NULL, sizeof *s->shared, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (s->shared == MAP_FAILED)
        die("no memory to share");
    cache_name(s, "warm", 0);
    fflush(stdout);
    if ((s->supervisor = fork()) < 0)
        die("fork: %s", strerror(errno));
    if (s->supervisor == 0)
        supervise(s);
    airy_close(service_connect(&s->service));
}

static void supervised_stop(struct supervised *s)
{
    kill(s->supervisor, SIGKILL);
    waitpid(s->supervisor, NULL, 0);
    // The daemon sees its lifetime end and takes its socket with it.
    for (double end = now_ms() + BACK_MS; access(s->service.socket, F_OK) == 0; pause_ms(5))
        if (now_ms() > end)
            die("airyd outlives its supervisor");
    service_remove(&s->service);
    munmap(s->shared, sizeof *s->shared);
}

static void kill_daemon(const struct supervised *s)
{
    if (kill(atomic_load(&s->shared->daemon), SIGKILL) < 0)
        die("airyd could not be killed: %s", strerror(errno));
}

/* ---- a client that connects again --------------------------------------------------------------------------------- */

struct back { /* ms from the kill */
    struct series connected, frame;
};

// The first frame that is served. A connection that was accepted and died is one more try.
static void back_again(const struct supervised *s, struct picture_job *job, double from, struct back *b)
{
    struct airy *a = NULL;
    struct airy_error e;
    double connected = 0, ms = -1;
    while (ms < 0) {
        if (now_ms() - from > BACK_MS)
            die("no frame %d s after a kill: %s", BACK_MS / 1000, e.text);
        if (airy_connect(&a, s->service.socket, &e) < 0) {
            pause_ms(1);
            continue;
        }
        connected = now_ms() - from;
        ms = picture_job_try(job, a, &e);
        airy_close(a);
    }
    if (getenv("AIRY_BENCH_VERBOSE"))
        fprintf(stderr, "connected after %.0f ms, a frame after %.0f ms; %u starts\n", connected, now_ms() - from,
                atomic_load(&s->shared->starts));
    series_add(&b->connected, connected);
    series_add(&b->frame, now_ms() - from);
}

static void kills_run(struct supervised *s, struct picture_job *job, unsigned rounds, bool cold, struct back *b)
{
    for (unsigned i = 0; i < rounds; i++) {
        if (cold)
            cache_name(s, "cold", i);
        const double from = now_ms();
        kill_daemon(s);
        back_again(s, job, from, b);
        pause_ms(BETWEEN_MS);
    }
}

static void back_print(const char *name, struct back *b)
{
    printf("  %-36s %7zu %9.0f %9.0f %9.0f %14.0f\n", name, b->frame.n, series_percentile(&b->frame, .5), series_percentile(&b->frame, .99),
           series_percentile(&b->frame, 1), series_percentile(&b->connected, .5));
    fflush(stdout);
}

static void back_free(struct back *b)
{
    series_free(&b->connected);
    series_free(&b->frame);
}

/* ---- airy's own ---------------------------------------------------------------------------------------------------------- */

static void range_files(const char *dir, const struct bench_frame *f)
{
    char path[128], link_path[128];
    snprintf(path, sizeof path, "%s/in.0001.exr", dir);
    FILE *file = fopen(path, "we");
    if (!file || fwrite(f->exr, 1, f->exr_bytes, file) != f->exr_bytes || fclose(file))
        die("%s: %s", path, strerror(errno));
    for (int i = 2; i <= RANGE_FRAMES; i++) {
        snprintf(link_path, sizeof link_path, "%s/in.%04d.exr", dir, i);
        if (link(path, link_path) < 0)
            die("%s: %s", link_path, strerror(errno));
    }
}

static FILE *airy_start(const struct service_options *o, const struct service *s, pid_t *pid)
{
    char in[128], out[128], range[32];
    int ends[2];
    snprintf(in, sizeof in, "%s/in.####.exr", s->dir);
    snprintf(out, sizeof out, "%s/out.####.exr", s->dir);
    snprintf(range, sizeof range, "1-%d", RANGE_FRAMES);
    if (pipe2(ends, O_CLOEXEC) < 0)
        die("a pipe for airy: %s", strerror(errno));
    fflush(stdout);
    if ((*pid = fork()) < 0)
        die("fork: %s", strerror(errno));
    if (*pid == 0) {
        dup2(ends[1], STDOUT_FILENO);
        execl(o->airy, o->airy, "bloom", in, "-o", out, "-f", range, "--socket", s->socket, "--force", "--quiet", "--json", (char *)NULL);
        _exit(127);
    }
    close(ends[1]);
    return fdopen(ends[0], "re");
}

// One range, one kill in it. Returns for how long no frame ended from the kill on, at the longest; all of them have to end well.
static double range_pause(const struct service_options *o, struct supervised *s)
{
    char line[LINE_MAX_BYTES];
    pid_t pid;
    int status, lines = 0;
    FILE *from_airy = airy_start(o, &s->service, &pid);
    double last = now_ms(), longest = 0;
    while (from_airy && fgets(line, sizeof line, from_airy)) {
        const double now = now_ms();
        if (lines > RANGE_KILL_AT && now - last > longest)
            longest = now - last;
        last = now;
        if (++lines == RANGE_KILL_AT)
            kill_daemon(s);
    }
    if (from_airy)
        fclose(from_airy);
    if (waitpid(pid, &status, 0) != pid || status || lines != RANGE_FRAMES)
        die("%s: %d lines of %d frames, status 0x%x", o->airy, lines, RANGE_FRAMES, (unsigned)status);
    return longest;
}

/* ---- the measurement ------------------------------------------------------------------------------------------------------- */

void measure_kills(const struct service_options *o, struct team *team)
{
    struct supervised s;
    struct bench_frame small;
    struct picture_job raw;
    struct back cold = { 0 }, warm = { 0 }, none = { 0 };
    struct series pauses = { 0 };
    if (!o->kills)
        return;
    frame_make(&small, 256, 256, team);
    picture_job_raw(&raw, "256x256 raw", &small);
    supervised_start(&s, o);
    printf("\nFrom kill -9 to the next frame served (256x256 raw), the daemon started again at once\n");
    printf("  %-36s %7s %9s %9s %9s %14s\n", "ms", "rounds", "p50", "p99", "max", "connected p50");
    back_again(&s, &raw, now_ms(), &none);
    back_free(&none);
    pause_ms(SETTLE_MS); // the cache gets the pipelines that are made when idle, too
    kills_run(&s, &raw, o->kills, false, &warm);
    back_print("shader cache warm", &warm);
    kills_run(&s, &raw, o->kills, true, &cold);
    back_print("shader cache empty", &cold);
    cache_name(&s, "warm", 0);
    range_files(s.service.dir, &small);
    for (unsigned i = 0; i < RANGE_ROUNDS; i++)
        series_add(&pauses, range_pause(o, &s));
    printf("  %-36s %7zu %9.0f %9s %9.0f   (all of %d frames written, exit status 0)\n", "airy bloom RANGE: no frame ended for", pauses.n,
           series_percentile(&pauses, .5), "", series_percentile(&pauses, 1), RANGE_FRAMES);
    printf("  %u starts of airyd\n", atomic_load(&s.shared->starts));
    supervised_stop(&s);
    back_free(&cold);
    back_free(&warm);
    series_free(&pauses);
    picture_job_finish(&raw);
    frame_finish(&small);
}
