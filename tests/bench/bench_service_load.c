// SPDX-License-Identifier: Apache-2.0
// bench_service_load.c - STATUS and a small job beside a farm's range: idle, one user's range, a crowd's. The three are measured in turns, so that
// a ratio is of one and the same minute. Each user of the crowd is a process with a uid of its own, for the daemon is fair by uid;
// that takes root, and without it all are one user, which is said.
#include <errno.h>
#include <fcntl.h>
#include <grp.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bench_service.h"

enum { USERS_MAX = 64, LOAD_ROUNDS_MAX = 16, RANGE_FLIGHT = 4, FIRST_UID = 60001, START_FRAMES_MS = 120000 };
enum phase { PHASE_IDLE, PHASE_ONE, PHASE_CROWD, PHASES };
enum kind { KIND_STATUS, KIND_EXR, KIND_RAW, KINDS };

struct crowd {
    const struct service *service;
    const char *file;      /* the frame, that all ranges read */
    atomic_ulong *frames;  /* shared with the children: done, by all of them */
    pid_t pid[USERS_MAX];
    unsigned users;
    bool own_uids;
    struct airy_request request;
};

/* ---- a user's range, in a child ---------------------------------------------------------------------- */

static void become_user(const struct crowd *c, unsigned user)
{
    const uid_t uid = FIRST_UID + user;
    if (c->own_uids && (setgroups(0, NULL) < 0 || setresgid(uid, uid, uid) < 0 || setresuid(uid, uid, uid) < 0))
        die("uid %u: %s", (unsigned)uid, strerror(errno));
    // After the change of uid, which would undo it.
    prctl(PR_SET_PDEATHSIG, SIGKILL);
}

// As `airy bloom` does it, four frames in flight, but that the results go nowhere.
static _Noreturn void range_run(const struct crowd *c, unsigned user)
{
    struct airy *a;
    struct airy_error e;
    become_user(c, user);
    struct airy_request request = c->request;
    request.input_fd = open(c->file, O_RDONLY | O_CLOEXEC);
    if (request.input_fd < 0 || airy_connect(&a, c->service->socket, &e) < 0)
        die("a user of a range: %s", request.input_fd < 0 ? strerror(errno) : e.text);
    for (unsigned in_flight = 0;;) {
        uint64_t id;
        struct airy_result *r = NULL;
        for (; in_flight < RANGE_FLIGHT; in_flight++)
            if (airy_submit(a, &request, &id, &e) < 0)
                die("%s: %s: %s", e.symbol, e.field, e.text);
        if (airy_wait_any(a, -1, &id, &r, &e) < 0)
            wait_for_room(&e);
        else
            atomic_fetch_add(c->frames, 1);
        in_flight--;
        airy_result_free(r);
    }
}

static void crowd_start(struct crowd *c, unsigned users)
{
    atomic_store(c->frames, 0);
    fflush(stdout);
    for (c->users = 0; c->users < users; c->users++) {
        pid_t pid = fork();
        if (pid < 0)
            die("fork: %s", strerror(errno));
        if (pid == 0)
            range_run(c, c->users);
        c->pid[c->users] = pid;
    }
    // The crowd is at work when each could have had a frame.
    for (double end = now_ms() + START_FRAMES_MS; atomic_load(c->frames) < users; pause_ms(20)) {
        if (now_ms() > end)
            die("%u users had %lu frames in %d s", users, (unsigned long)atomic_load(c->frames), START_FRAMES_MS / 1000);
        for (unsigned i = 0; i < users; i++)
            if (waitpid(c->pid[i], NULL, WNOHANG) != 0)
                die("user %u's range ended", i);
    }
}

static void crowd_stop(struct crowd *c)
{
    for (unsigned i = 0; i < c->users; i++)
        kill(c->pid[i], SIGKILL);
    for (unsigned i = 0; i < c->users; i++)
        waitpid(c->pid[i], NULL, 0);
    c->users = 0;
}

// What the ranges left behind is cancelled, but what was at the device ends first. Returns the longest turn of the daemon's loop so far, ms:
// a STATUS that took longer waited for a core, here or there, and not for the daemon.
static double wait_idle(const struct service *s)
{
    struct airy *a = service_connect(s);
    struct airy_status *status = take(1, sizeof *status);
    struct airy_error e;
    do {
        pause_ms(20);
        if (airy_status(a, status, 30000, &e) < 0)
            die("STATUS: %s", e.text);
    } while (status->queued || status->running);
    const double worst_ms = status->loop_worst_ms;
    free(status);
    airy_close(a);
    return worst_ms;
}

/* ---- the table ----------------------------------------------------------------------------------------- */

struct cell { /* of one phase and kind */
    struct series all;
    double p50[LOAD_ROUNDS_MAX], p99[LOAD_ROUNDS_MAX];
};

struct table {
    struct cell cell[PHASES][KINDS];
    double frames_per_s[PHASES][LOAD_ROUNDS_MAX];
    double loop_worst_ms; /* the daemon's own */
    unsigned rounds;
};

static void table_take(struct table *t, enum phase phase, struct probe *p)
{
    struct series *of[KINDS] = { &p->status, &p->exr, &p->raw };
    for (unsigned k = 0; k < KINDS; k++) {
        struct cell *c = &t->cell[phase][k];
        for (size_t i = 0; i < of[k]->n; i++)
            series_add(&c->all, of[k]->ms[i]);
        c->p50[t->rounds] = series_percentile(of[k], .5);
        c->p99[t->rounds] = series_percentile(of[k], .99);
    }
}

static double median_of(const double *v, unsigned n)
{
    struct series s = { 0 };
    for (unsigned i = 0; i < n; i++)
        series_add(&s, v[i]);
    double m = series_percentile(&s, .5);
    series_free(&s);
    return m;
}

static void range_of(const double *v, unsigned n, double *low, double *high)
{
    *low = *high = v[0];
    for (unsigned i = 1; i < n; i++) {
        *low = v[i] < *low ? v[i] : *low;
        *high = v[i] > *high ? v[i] : *high;
    }
}

static void cell_print(struct table *t, unsigned phase, unsigned kind, const char *name)
{
    struct cell *c = &t->cell[phase][kind];
    double low50, high50, low99, high99, ratio[LOAD_ROUNDS_MAX];
    range_of(c->p50, t->rounds, &low50, &high50);
    range_of(c->p99, t->rounds, &low99, &high99);
    for (unsigned r = 0; r < t->rounds; r++)
        ratio[r] = c->p50[r] / t->cell[PHASE_IDLE][kind].p50[r];
    printf("  %-14s %7zu %9.2f %9.2f %9.2f   %8.2f..%-8.2f %8.2f..%-8.2f %7.1fx\n", name, c->all.n, series_percentile(&c->all, .5),
           series_percentile(&c->all, .99), series_percentile(&c->all, 1), low50, high50, low99, high99, median_of(ratio, t->rounds));
}

static void table_print(struct table *t, const struct crowd *c, unsigned users)
{
    static const char *const kinds[KINDS] = { "STATUS", "256x256 EXR there and back", "256x256 raw there and back" };
    char crowd[32];
    snprintf(crowd, sizeof crowd, "%u users", users);
    const char *const phases[PHASES] = { "idle", "one user", crowd };
    printf("  %-14s %7s %9s %9s %9s   %-18s %-18s %8s\n", "ms", "samples", "p50", "p99", "max", "p50 of rounds", "p99 of rounds", "to idle");
    for (unsigned k = 0; k < KINDS; k++) {
        printf(" %s\n", kinds[k]);
        for (unsigned p = 0; p < PHASES; p++)
            cell_print(t, p, k, phases[p]);
    }
    printf(" longest turn of the daemon's loop, by its own clock: %.2f ms\n", t->loop_worst_ms);
    printf(" frames of the range a second, all users: one user %.2f, %s %.2f%s\n", median_of(t->frames_per_s[PHASE_ONE], t->rounds), crowd,
           median_of(t->frames_per_s[PHASE_CROWD], t->rounds), c->own_uids ? "" : " (not root: all with this uid, so one user to the daemon)");
}

/* ---- the measurement ------------------------------------------------------------------------------------- */

static void file_write(const char *path, const struct bench_frame *f)
{
    FILE *file = fopen(path, "we");
    if (!file || fwrite(f->exr, 1, f->exr_bytes, file) != f->exr_bytes || fclose(file))
        die("%s: %s", path, strerror(errno));
}

static void phase_run(struct table *t, struct crowd *c, enum phase phase, unsigned users, const struct service_options *o,
                      struct picture_job *exr, struct picture_job *raw)
{
    struct probe p = { 0 };
    if (users)
        crowd_start(c, users);
    unsigned long before = atomic_load(c->frames);
    const double from = now_ms();
    probe_run(c->service, exr, raw, o->seconds, &p);
    t->frames_per_s[phase][t->rounds] = (double)(atomic_load(c->frames) - before) / (now_ms() - from) * 1e3;
    crowd_stop(c);
    t->loop_worst_ms = wait_idle(c->service);
    table_take(t, phase, &p);
    probe_free(&p);
}

void measure_load(const struct service_options *o, struct team *team)
{
    struct service s;
    struct bench_frame big, small;
    struct picture_job range, exr, raw;
    char file[96];
    struct table *t = take(1, sizeof *t);
    struct crowd c = { .service = &s, .file = file, .own_uids = geteuid() == 0 };
    const unsigned users = o->users < USERS_MAX ? o->users : USERS_MAX, rounds = o->rounds < LOAD_ROUNDS_MAX ? o->rounds : LOAD_ROUNDS_MAX;
    frame_make(&big, 3840, 2160, team);
    frame_make(&small, 256, 256, team);
    picture_job_exr(&range, "range", &big);
    picture_job_exr(&exr, "256x256 EXR", &small);
    picture_job_raw(&raw, "256x256 raw", &small);
    service_prepare(&s, o->airyd);
    snprintf(file, sizeof file, "%s/frame.exr", s.dir);
    file_write(file, &big);
    c.request = range.request;
    c.frames = mmap(NULL, sizeof *c.frames, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (c.frames == MAP_FAILED)
        die("no memory to share");
    printf("\nBeside a range of %s half RGBA ZIP (%.1f MB a frame, %d in flight a user), %u rounds of %g s each\n", big.size,
           (double)big.exr_bytes / 1e6, RANGE_FLIGHT, rounds, o->seconds);
    service_start(&s, NULL);
    struct probe warm = { 0 };
    probe_run(&s, &exr, &raw, 2, &warm);
    probe_free(&warm);
    for (; t->rounds < rounds; t->rounds++) {
        phase_run(t, &c, PHASE_IDLE, 0, o, &exr, &raw);
        phase_run(t, &c, PHASE_ONE, 1, o, &exr, &raw);
        phase_run(t, &c, PHASE_CROWD, users, o, &exr, &raw);
    }
    table_print(t, &c, users);
    service_stop(&s);
    service_remove(&s);
    munmap(c.frames, sizeof *c.frames);
    for (unsigned p = 0; p < PHASES; p++)
        for (unsigned k = 0; k < KINDS; k++)
            series_free(&t->cell[p][k].all);
    free(t);
    picture_job_finish(&range);
    picture_job_finish(&exr);
    picture_job_finish(&raw);
    frame_finish(&big);
    frame_finish(&small);
}
