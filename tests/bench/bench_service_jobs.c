// SPDX-License-Identifier: Apache-2.0
// bench_service_jobs.c - samples, the requests that are measured, and the probe that sends them: see bench_service.h.
#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "bench_service.h"

enum { STATUS_EVERY_MS = 3, STATUS_TIMEOUT_MS = 30000, SMALL_EVERY_MS = 10, CODE_BUSY = 400, BUSY_TRIES = 1000 };

void pause_ms(double ms)
{
    struct timespec t = { .tv_sec = (time_t)(ms / 1e3) };
    t.tv_nsec = (long)((ms - (double)t.tv_sec * 1e3) * 1e6);
    nanosleep(&t, NULL);
}

/* ---- samples --------------------------------------------------------------------------------------- */

void series_add(struct series *s, double ms)
{
    if (s->n == s->cap) {
        s->cap = s->cap ? 2 * s->cap : 1024;
        s->ms = realloc(s->ms, s->cap * sizeof s->ms[0]);
        if (!s->ms)
            die("no memory for %zu samples", s->cap);
    }
    s->ms[s->n++] = ms;
}

void series_free(struct series *s)
{
    free(s->ms);
    *s = (struct series){ 0 };
}

static int by_ms(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

double series_percentile(struct series *s, double p)
{
    if (!s->n)
        return 0;
    qsort(s->ms, s->n, sizeof s->ms[0], by_ms);
    size_t rank = (size_t)(p * (double)s->n);
    return s->ms[rank < s->n ? rank : s->n - 1];
}

/* ---- requests -------------------------------------------------------------------------------------- */

static void job_params_set(struct airy_request *r, uint32_t width)
{
    const char *const set[][2] = {
        { "bright", "channel" }, { "threshold", "1" }, { "intensity", "1" }, { "tolerance", "1e-3" }, { "psf", job_psf(width) },
    };
    struct airy_error e;
    for (unsigned i = 0; i < sizeof set / sizeof set[0]; i++)
        if (airy_request_param(r, set[i][0], set[i][1], &e) < 0)
            die("%s: %s", e.field, e.text);
}

static uint8_t *job_init(struct picture_job *j, const char *name, uint32_t width, uint64_t bytes)
{
    struct airy_error e;
    void *map;
    *j = (struct picture_job){ .name = name, .request = AIRY_REQUEST_INIT };
    if ((j->input_fd = airy_memfd(bytes, &map, &e)) < 0)
        die("%s", e.text);
    j->request.input_fd = j->input_fd;
    job_params_set(&j->request, width);
    return map;
}

void picture_job_exr(struct picture_job *j, const char *name, const struct bench_frame *f)
{
    uint8_t *map = job_init(j, name, f->width, f->exr_bytes);
    memcpy(map, f->exr, f->exr_bytes);
    munmap(map, f->exr_bytes);
}

void picture_job_raw(struct picture_job *j, const char *name, const struct bench_frame *f)
{
    static const char *const names[] = { "R", "G", "B", "A" };
    const uint64_t bytes = (uint64_t)f->width * f->height * 8;
    uint8_t *map = job_init(j, name, f->width, bytes);
    for (uint32_t y = 0; y < f->height; y++)
        for (unsigned c = 0; c < 4; c++)
            for (uint32_t x = 0; x < f->width; x++)
                memcpy(map + ((uint64_t)y * f->width + x) * 8 + c * 2,
                       c == 3 ? (const uint8_t *)&(uint16_t){ 0x3c00 } : planes_row(&f->in_half, c, y) + (size_t)x * 2, 2);
    munmap(map, bytes);
    j->request.width = f->width;
    j->request.height = f->height;
    j->request.type = AIRY_HALF;
    j->request.n_channels = 4;
    for (unsigned c = 0; c < 4; c++)
        j->request.channels[c] = (struct airy_channel){ names[c], c * 2, (uint64_t)f->width * 8, 8 };
}

void picture_job_finish(struct picture_job *j)
{
    close(j->input_fd);
    free(j->expect);
}

void picture_job_check(struct picture_job *j, const struct airy_result *r)
{
    if (!j->expect) {
        if (r->n_targets != 1 || r->targets[0].untouched || !r->size)
            die("%s: nothing was bloomed", j->name);
        j->expect_bytes = r->size;
        j->expect = take(1, r->size);
        memcpy(j->expect, r->data, r->size);
    }
    if (r->size != j->expect_bytes || memcmp(r->data, j->expect, r->size))
        die("%s: the result differs from that of the same request before", j->name);
}

void wait_for_room(const struct airy_error *e)
{
    if (e->code != CODE_BUSY)
        die("%s: %s: %s", e->symbol, e->field, e->text);
    pause_ms(e->retry_after_ms < 1 ? 1 : e->retry_after_ms > 1000 ? 1000 : e->retry_after_ms);
}

double picture_job_try(struct picture_job *j, struct airy *a, struct airy_error *e)
{
    const double from = now_ms();
    struct airy_result *r;
    uint64_t id;
    if (airy_submit(a, &j->request, &id, e) < 0 || airy_wait(a, id, -1, &r, e) < 0)
        return -1;
    const double ms = now_ms() - from;
    picture_job_check(j, r);
    airy_result_free(r);
    return ms;
}

double picture_job_run(struct picture_job *j, struct airy *a)
{
    const double from = now_ms();
    struct airy_error e = { .code = 0 };
    for (int i = 0; i < BUSY_TRIES; i++) {
        double ms = picture_job_try(j, a, &e);
        if (ms >= 0)
            return i ? now_ms() - from : ms;
        wait_for_room(&e);
    }
    die("%s: %s: %s", j->name, e.symbol, e.text);
}

/* ---- the probe ------------------------------------------------------------------------------------- */

struct status_probe {
    struct airy *a;
    struct series *series;
    atomic_bool stop;
};

static void *status_loop(void *ctx)
{
    struct status_probe *p = ctx;
    struct airy_status *status = take(1, sizeof *status);
    struct airy_error e;
    while (!atomic_load(&p->stop)) {
        double from = now_ms();
        if (airy_status(p->a, status, STATUS_TIMEOUT_MS, &e) < 0)
            die("STATUS: %s: %s", e.symbol, e.text);
        series_add(p->series, now_ms() - from);
        pause_ms(STATUS_EVERY_MS);
    }
    free(status);
    return NULL;
}

void probe_run(const struct service *s, struct picture_job *exr, struct picture_job *raw, double seconds, struct probe *p)
{
    struct status_probe status = { .a = service_connect(s), .series = &p->status };
    struct airy *a = service_connect(s);
    pthread_t thread;
    atomic_init(&status.stop, false);
    if (pthread_create(&thread, NULL, status_loop, &status))
        die("no thread");
    for (double end = now_ms() + seconds * 1e3; now_ms() < end;) {
        series_add(&p->exr, picture_job_run(exr, a));
        pause_ms(SMALL_EVERY_MS);
        series_add(&p->raw, picture_job_run(raw, a));
        pause_ms(SMALL_EVERY_MS);
    }
    atomic_store(&status.stop, true);
    pthread_join(thread, NULL);
    airy_close(status.a);
    airy_close(a);
}

void probe_free(struct probe *p)
{
    series_free(&p->status);
    series_free(&p->exr);
    series_free(&p->raw);
}
