/* SPDX-License-Identifier: Apache-2.0 */
/*
 * bench_service.h - what the parts of bench_service share: airyd as a child, requests, samples, figures out of /proc.
 *
 * Everything goes through a real airyd by libairy, as a client has it. No time is asserted; a request that fails, or pixels that are
 * not what the same request had before, end the program with exit status 1: a fast wrong frame is no figure.
 */
#ifndef AIRY_BENCH_SERVICE_H
#define AIRY_BENCH_SERVICE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "airy.h"
#include "bench.h"

struct service_options {
    const char *airyd, *airy; /* the programs */
    const char *readme;       /* of the Python client */
    double seconds;           /* of each measurement under load */
    unsigned rounds;          /* of the measurements under load */
    unsigned kills;           /* rounds of kill -9 */
    unsigned users;           /* in the crowd */
    unsigned connections;     /* to be held */
    uint64_t frames;          /* small ones, for the memory */
    unsigned flight;          /* of those, in hand at once */
};

/* ---- the daemon (bench_service_daemon.c) --------------------------------------------------------------- */

struct service {
    const char *airyd;
    char dir[64], socket[96]; /* of dir, all may enter; of the socket, all may connect */
    pid_t pid;
    int lifetime_fd; /* closed when this process ends, however it does: the daemon then ends too */
};

/* The folder and the name of the socket; starts nothing. */
void service_prepare(struct service *s, const char *airyd);
/* extra: options, ended by NULL; NULL: none. Returns when the daemon answers. */
void service_start(struct service *s, const char *const *extra);
void service_stop(struct service *s);   /* SIGTERM; any exit status but 0 ends the program */
void service_remove(struct service *s); /* the folder and what is in it, folders too */
/* Waits (30 s at most) until somebody answers at the socket, then lets every user of this machine connect. */
struct airy *service_connect(const struct service *s);
/* In a child: replaces it by airyd, with the options of all measurements. Does not return. */
void service_exec(const struct service *s, int lifetime_fd, const char *const *extra) __attribute__((noreturn));

struct service_size {
    double rss_bytes, anonymous_bytes;
    unsigned threads, fds;
};
struct service_size service_size(pid_t pid);

/* ---- samples (bench_service_jobs.c) ---------------------------------------------------------------------- */

struct series { /* ms, in the order in which they came */
    double *ms;
    size_t n, cap;
};
void series_add(struct series *s, double ms);
void series_free(struct series *s);
/* p of 0..1, by nearest rank; 0 of an empty series. Sorts it. */
double series_percentile(struct series *s, double p);

/* ---- requests (bench_service_jobs.c) --------------------------------------------------------------------- */

struct picture_job { /* the same request again and again; the first result is what the others have to be */
    const char *name;
    struct airy_request request;
    int input_fd;
    uint8_t *expect; /* NULL: none came yet */
    uint64_t expect_bytes;
};
/* The J5 job on an EXR file or on interleaved half RGBA of the frame; input by memfd, output by the daemon's. The strings stay
 * the caller's. */
void picture_job_exr(struct picture_job *j, const char *name, const struct bench_frame *f);
void picture_job_raw(struct picture_job *j, const char *name, const struct bench_frame *f);
void picture_job_finish(struct picture_job *j);
/* Ends the program if it is not what came before. */
void picture_job_check(struct picture_job *j, const struct airy_result *r);
/* One there and back; BUSY is tried again when the daemon says. Returns ms. */
double picture_job_run(struct picture_job *j, struct airy *a);
/* The same, where the daemon may go: < 0. */
double picture_job_try(struct picture_job *j, struct airy *a, struct airy_error *e);
/* Waits as long as the daemon that is busy asks for; any other error ends the program. */
void wait_for_room(const struct airy_error *e);
void pause_ms(double ms);

/* ---- the measurements ------------------------------------------------------------------------------- */

struct probe { /* STATUS on one connection, small jobs on another, for some seconds */
    struct series status, exr, raw;
};
void probe_run(const struct service *s, struct picture_job *exr, struct picture_job *raw, double seconds, struct probe *p);
void probe_free(struct probe *p);

void measure_load(const struct service_options *o, struct team *team);        /* bench_service_load.c */
void measure_connections(const struct service_options *o, struct team *team); /* bench_service_held.c */
void measure_memory(const struct service_options *o, struct team *team);      /* bench_service_held.c */
void measure_kills(const struct service_options *o, struct team *team);       /* bench_service_kill.c */

#endif
