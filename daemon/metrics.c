// SPDX-License-Identifier: Apache-2.0
// metrics.c - see metrics.h.
#include "metrics.h"

#include <fcntl.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

const char *const metrics_stage_name[METRICS_STAGES] = { "queue", "load", "decode", "bloom", "encode", "total" };
const double metrics_bucket_ms[METRICS_BUCKETS] = { 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 20000 };

uint64_t clock_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * UINT64_C(1000000000) + (uint64_t)t.tv_nsec;
}

void metrics_init(struct metrics *m)
{
    *m = (struct metrics){ .start_ns = clock_ns() };
}

static void histogram_note(struct metrics_histogram *h, double ms)
{
    unsigned i = 0;
    while (i < METRICS_BUCKETS && ms > metrics_bucket_ms[i])
        i++;
    h->count[i]++;
    h->sum_ms += ms;
}

void metrics_note(struct metrics *m, const struct stage_times *t)
{
    const double ms[METRICS_STAGES] = { t->queue, t->load, t->decode, t->bloom, t->encode, t->total };
    for (unsigned i = 0; i < METRICS_STAGES; i++)
        histogram_note(&m->histogram[i], ms[i]);
    m->recent[m->recent_count++ % METRICS_RECENT] = *t;
}

struct stage_times metrics_mean(const struct metrics *m)
{
    struct stage_times s = { 0 };
    unsigned n = m->recent_count < METRICS_RECENT ? (unsigned)m->recent_count : METRICS_RECENT;
    if (!n)
        return s;
    for (unsigned i = 0; i < n; i++) {
        const struct stage_times *t = &m->recent[i];
        s.queue += t->queue / n;
        s.load += t->load / n;
        s.decode += t->decode / n;
        s.bloom += t->bloom / n;
        s.encode += t->encode / n;
        s.total += t->total / n;
    }
    return s;
}

uint64_t metrics_rss_bytes(void)
{
    int fd = open("/proc/self/statm", O_RDONLY | O_CLOEXEC);
    if (fd < 0)
        return 0;
    char text[128];
    ssize_t n = read(fd, text, sizeof text - 1);
    close(fd);
    if (n <= 0)
        return 0;
    text[n] = 0;
    unsigned long long all, resident;
    if (sscanf(text, "%llu %llu", &all, &resident) != 2)
        return 0;
    return resident * (uint64_t)sysconf(_SC_PAGESIZE);
}
