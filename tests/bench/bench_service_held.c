// SPDX-License-Identifier: Apache-2.0
// bench_service_held.c - what the daemon keeps: memory of a connection, with very many of them held while others work; memory, descriptors and
// threads over very many small frames.
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

#include "bench_service.h"

enum { SPARE_FDS = 1024, SPARE_CONNECTIONS = 64, FLIGHT_MAX = 64, MARKS = 4 };

/* ---- connections ----------------------------------------------------------------------------------------- */

// Here and, as it is inherited, in the daemon. Returns how many connections that allows.
static unsigned raise_descriptors(unsigned connections)
{
    struct rlimit limit, more;
    const rlim_t need = (rlim_t)connections + SPARE_FDS;
    if (getrlimit(RLIMIT_NOFILE, &limit) < 0)
        die("RLIMIT_NOFILE: %s", strerror(errno));
    more = (struct rlimit){ need, limit.rlim_max > need ? limit.rlim_max : need };
    if (limit.rlim_cur >= need || setrlimit(RLIMIT_NOFILE, &more) == 0)
        return connections;
    limit.rlim_cur = limit.rlim_max;
    setrlimit(RLIMIT_NOFILE, &limit);
    return limit.rlim_cur > SPARE_FDS ? (unsigned)limit.rlim_cur - SPARE_FDS : 0;
}

static void probe_print(const char *name, struct probe *p)
{
    printf("  %-22s STATUS p50 %.2f p99 %.2f max %.2f ms; 256x256 EXR p50 %.2f p99 %.2f ms; raw p50 %.2f p99 %.2f ms\n", name,
           series_percentile(&p->status, .5), series_percentile(&p->status, .99), series_percentile(&p->status, 1),
           series_percentile(&p->exr, .5), series_percentile(&p->exr, .99), series_percentile(&p->raw, .5), series_percentile(&p->raw, .99));
    fflush(stdout);
}

static void connect_all(const struct service *s, struct airy **held, unsigned n)
{
    struct series each = { 0 };
    struct airy_error e;
    const double start = now_ms();
    for (unsigned i = 0; i < n; i++) {
        double from = now_ms();
        if (airy_connect(&held[i], s->socket, &e) < 0)
            die("connection %u: %s: %s", i + 1, e.symbol, e.text);
        series_add(&each, now_ms() - from);
    }
    printf("  %u connected, HELLO and WELCOME, one after the other: %.2f s; each p50 %.3f p99 %.3f max %.2f ms\n", n, (now_ms() - start) / 1e3,
           series_percentile(&each, .5), series_percentile(&each, .99), series_percentile(&each, 1));
    series_free(&each);
}

// All still there: who was dropped would read the end of the stream.
static unsigned count_alive(struct airy **held, unsigned n)
{
    struct airy_status *status = take(1, sizeof *status);
    struct airy_error e;
    unsigned alive = 0;
    for (unsigned i = 0; i < n; i++)
        alive += airy_status(held[i], status, 30000, &e) == 0;
    free(status);
    return alive;
}

static void held_run(const struct service *s, struct airy **held, unsigned n, const struct service_options *o, struct picture_job *exr,
                     struct picture_job *raw)
{
    struct probe p = { 0 };
    probe_run(s, exr, raw, 2, &p); // warms up
    probe_free(&p);
    probe_run(s, exr, raw, o->seconds, &p);
    probe_print("none held", &p);
    probe_free(&p);
    struct service_size before = service_size(s->pid);
    connect_all(s, held, n);
    struct service_size after = service_size(s->pid);
    printf("  airyd: RSS %.1f MB without, %.1f MB with them: %.1f KiB a connection; %u descriptors, %u threads\n", before.rss_bytes / 1e6,
           after.rss_bytes / 1e6, (after.rss_bytes - before.rss_bytes) / 1024 / n, after.fds, after.threads);
    probe_run(s, exr, raw, o->seconds, &p);
    probe_print("held", &p);
    probe_free(&p);
    printf("  of %u held, %u answer a STATUS afterwards\n", n, count_alive(held, n));
    for (unsigned i = 0; i < n; i++)
        airy_close(held[i]);
    double from = now_ms();
    while (service_size(s->pid).fds > before.fds && now_ms() - from < 30000)
        pause_ms(1);
    after = service_size(s->pid);
    printf("  all closed: the daemon's descriptors are %u (%u before) after %.0f ms, RSS %.1f MB\n", after.fds, before.fds, now_ms() - from,
           after.rss_bytes / 1e6);
    probe_run(s, exr, raw, o->seconds, &p);
    probe_print("none held again", &p);
    probe_free(&p);
}

void measure_connections(const struct service_options *o, struct team *team)
{
    struct service s;
    struct bench_frame small;
    struct picture_job exr, raw;
    char clients[16];
    const unsigned n = raise_descriptors(o->connections);
    printf("\n%u idle connections\n", n);
    if (n < o->connections)
        printf("  %u were asked for; RLIMIT_NOFILE cannot be raised here\n", o->connections);
    if (!n)
        return;
    frame_make(&small, 256, 256, team);
    picture_job_exr(&exr, "256x256 EXR", &small);
    picture_job_raw(&raw, "256x256 raw", &small);
    struct airy **held = take(n, sizeof *held);
    snprintf(clients, sizeof clients, "%u", n + SPARE_CONNECTIONS);
    service_prepare(&s, o->airyd);
    service_start(&s, (const char *const[]){ "--max-clients", clients, "--user-connections", clients, NULL });
    held_run(&s, held, n, o, &exr, &raw);
    service_stop(&s);
    service_remove(&s);
    free(held);
    picture_job_finish(&exr);
    picture_job_finish(&raw);
    frame_finish(&small);
}

/* ---- small frames ------------------------------------------------------------------------------------------ */

struct stream { /* small frames, every other inline both ways, the others by descriptors */
    struct airy *a;
    struct picture_job *job;
    void *pixels;
    struct airy_request inline_request;
    uint64_t sent, done;
};

static void stream_submit(struct stream *s)
{
    uint64_t id;
    struct airy_error e;
    if (airy_submit(s->a, s->sent % 2 ? &s->inline_request : &s->job->request, &id, &e) < 0)
        die("frame %llu: %s: %s: %s", (unsigned long long)s->sent, e.symbol, e.field, e.text);
    s->sent++;
}

static void stream_until(struct stream *s, uint64_t frames, uint64_t all, unsigned flight)
{
    struct airy_error e;
    while (s->done < frames) {
        struct airy_result *r;
        uint64_t id;
        while (s->sent < all && s->sent - s->done < flight)
            stream_submit(s);
        if (airy_wait_any(s->a, -1, &id, &r, &e) < 0)
            die("frame: %s: %s: %s", e.symbol, e.field, e.text);
        picture_job_check(s->job, r);
        airy_result_free(r);
        s->done++;
    }
}

static void stream_init(struct stream *s, struct picture_job *job, const struct service *service, uint64_t bytes)
{
    *s = (struct stream){ .a = service_connect(service), .job = job, .pixels = take(1, bytes), .inline_request = job->request };
    if (pread(job->input_fd, s->pixels, bytes, 0) != (ssize_t)bytes)
        die("the frame's own pixels: %s", strerror(errno));
    s->inline_request.input_fd = -1;
    s->inline_request.data = s->pixels;
    s->inline_request.size = bytes;
    s->inline_request.inline_output = true;
}

static void stream_finish(struct stream *s)
{
    airy_close(s->a);
    free(s->pixels);
}

void measure_memory(const struct service_options *o, struct team *team)
{
    struct service s;
    struct bench_frame tiny;
    struct picture_job raw;
    struct stream stream;
    const unsigned flight = o->flight < 1 ? 1 : o->flight > FLIGHT_MAX ? FLIGHT_MAX : o->flight;
    const uint64_t marks[MARKS] = { o->frames / 100, o->frames / 10, o->frames / 2, o->frames };
    frame_make(&tiny, 64, 64, team);
    picture_job_raw(&raw, "64x64 raw", &tiny);
    service_prepare(&s, o->airyd);
    // Else its pipelines, which draw one by one when the device is idle, would be in the figures.
    service_start(&s, (const char *const[]){ "--warm", "all", NULL });
    stream_init(&stream, &raw, &s, (uint64_t)64 * 64 * 8);
    printf("\n%llu frames of 64x64 raw half RGBA, %u in flight, every other inline, the others by descriptors\n", (unsigned long long)o->frames,
           flight);
    printf("  %10s %10s %14s %12s %8s %12s\n", "frames", "RSS MB", "anonymous MB", "descriptors", "threads", "frames/s");
    double from = now_ms();
    for (unsigned m = 0; m < MARKS; m++) {
        const uint64_t before = stream.done;
        stream_until(&stream, marks[m], o->frames, flight);
        const double s_passed = (now_ms() - from) / 1e3;
        struct service_size size = service_size(s.pid);
        printf("  %10llu %10.1f %14.1f %12u %8u %12.0f\n", (unsigned long long)stream.done, size.rss_bytes / 1e6, size.anonymous_bytes / 1e6,
               size.fds, size.threads, (double)(stream.done - before) / s_passed);
        fflush(stdout);
        from = now_ms();
    }
    stream_finish(&stream);
    service_stop(&s);
    service_remove(&s);
    picture_job_finish(&raw);
    frame_finish(&tiny);
}
