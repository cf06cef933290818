// SPDX-License-Identifier: Apache-2.0
/*
 * bench_exr.c - the codec floor: bench_exr FILE [threads] [repeats]
 * Prints median ms of decode (open, all chunks, planes, scan) and of encode (every chunk changed,
 * packed and assembled in memory), and the file's size.
 */
#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>

#include "exr.h"

enum { THREADS_MAX = 64, REPEATS_MAX = 1000 };

static double now_ms(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec * 1e3 + (double)t.tv_nsec * 1e-6;
}

static double cpu_ms(void) // of all threads: less at the mercy of neighbours than the clock
{
    struct rusage r;
    getrusage(RUSAGE_SELF, &r);
    return (double)(r.ru_utime.tv_sec + r.ru_stime.tv_sec) * 1e3 +
           (double)(r.ru_utime.tv_usec + r.ru_stime.tv_usec) * 1e-3;
}

struct pool {
    struct exr *x;
    struct exr_worker *worker[THREADS_MAX];
    unsigned threads, tasks;
    bool encode;
    _Atomic unsigned next;
};

struct member {
    struct pool *pool;
    unsigned index;
};

static void *member_run(void *arg)
{
    const struct member *m = arg;
    struct pool *p = m->pool;
    struct fault f;
    for (unsigned i; (i = atomic_fetch_add(&p->next, 1)) < p->tasks;)
        if (p->encode ? exr_encode(p->x, i, p->worker[m->index], &f)
                      : exr_decode(p->x, i, p->worker[m->index], &f)) {
            fprintf(stderr, "bench_exr: %s\n", f.text);
            exit(1);
        }
    return NULL;
}

static void pool_run(struct pool *p, bool encode)
{
    pthread_t thread[THREADS_MAX];
    struct member m[THREADS_MAX];
    p->encode = encode;
    p->tasks = encode ? exr_encode_tasks(p->x) : exr_decode_tasks(p->x);
    atomic_store(&p->next, 0);
    for (unsigned i = 0; i < p->threads; i++) {
        m[i] = (struct member){ p, i };
        if (i && pthread_create(&thread[i], NULL, member_run, &m[i]))
            exit(1);
    }
    member_run(&m[0]);
    for (unsigned i = 1; i < p->threads; i++)
        pthread_join(thread[i], NULL);
}

static int drop(void *ctx, const void *data, size_t n)
{
    memcpy(*(uint8_t **)ctx, data, n); // as it would go into a memfd
    *(uint8_t **)ctx += n;
    return 0;
}

static uint8_t *read_file(const char *path, uint64_t *size)
{
    FILE *file = fopen(path, "rb");
    if (!file || fseek(file, 0, SEEK_END))
        return NULL;
    long n = ftell(file);
    rewind(file);
    uint8_t *data = n > 0 ? malloc((size_t)n) : NULL;
    if (data && fread(data, 1, (size_t)n, file) != (size_t)n) {
        free(data);
        data = NULL;
    }
    fclose(file);
    *size = data ? (uint64_t)n : 0;
    return data;
}

static int by_value(const void *a, const void *b)
{
    return *(const double *)a < *(const double *)b ? -1 : *(const double *)a > *(const double *)b;
}

// Flips the last bit of one sample in 16 of the first plane: every chunk changes, none gets simpler.
static void change(const struct planes *in, struct planes *out)
{
    const size_t bytes = pixel_bytes(in->type);
    for (unsigned c = 0; c < in->count; c++)
        for (uint32_t y = 0; y < in->height; y++) {
            uint8_t *row = planes_row(out, c, y);
            memcpy(row, planes_row(in, c, y), in->width * bytes);
            for (uint32_t x = y % 16; x < in->width && !c; x += 16)
                row[x * bytes] ^= 1;
        }
}

int main(int argc, char **argv)
{
    if (argc < 2)
        return fprintf(stderr, "usage: bench_exr FILE [threads] [repeats]\n"), 2;
    struct pool pool = { .threads = argc > 2 ? (unsigned)atoi(argv[2]) : 2 };
    int repeats = argc > 3 ? atoi(argv[3]) : 11;
    if (!pool.threads || pool.threads > THREADS_MAX || repeats < 1 || repeats > REPEATS_MAX)
        return 2;
    uint64_t size, out_bytes = 0;
    uint8_t *bytes = read_file(argv[1], &size), *result = NULL;
    if (!bytes)
        return fprintf(stderr, "bench_exr: %s: %s\n", argv[1], strerror(errno)), 1;
    for (unsigned i = 0; i < pool.threads; i++)
        if (exr_worker_create(&pool.worker[i]))
            return 1;
    const struct exr_limits limits = { 65536, 65536, UINT64_C(1) << 32, UINT64_C(1) << 36 };
    const struct exr_select select = { 0 };
    const struct exr_options options = { .compression = EXR_KEEP };
    static double decode_ms[REPEATS_MAX], encode_ms[REPEATS_MAX], decode_cpu[REPEATS_MAX],
        encode_cpu[REPEATS_MAX];
    struct planes in[16] = { { 0 } }, out[16] = { { 0 } };
    const bool untouched[16] = { false };
    struct exr_counts counts = { 0 };
    for (int r = -1; r < repeats; r++) {
        struct fault f;
        double t0 = now_ms(), c0 = cpu_ms();
        if (exr_open(&pool.x, bytes, size, &limits, &select, &options, &f))
            return fprintf(stderr, "bench_exr: %s\n", f.text), 1;
        for (unsigned i = 0; i < exr_target_count(pool.x); i++) {
            const struct exr_target *t = exr_target(pool.x, i);
            if (r < 0 && (planes_alloc(&in[i], t->width, t->height, t->channels, t->type) ||
                          planes_alloc(&out[i], t->width, t->height, t->channels, t->type)))
                return 1;
            exr_bind(pool.x, i, &in[i], &out[i]);
        }
        pool_run(&pool, false);
        double t1 = now_ms(), c1 = cpu_ms();
        for (unsigned i = 0; i < exr_target_count(pool.x) && r < 0; i++)
            change(&in[i], &out[i]);
        double t2 = now_ms(), c2 = cpu_ms();
        if (exr_encode_begin(pool.x, untouched, &f))
            return fprintf(stderr, "bench_exr: %s\n", f.text), 1;
        pool_run(&pool, true);
        out_bytes = exr_assembled_bytes(pool.x);
        if (r < 0)
            result = malloc(out_bytes);
        uint8_t *at = result;
        if (!result || exr_assemble(pool.x, drop, &at, &f))
            return 1;
        double t3 = now_ms(), c3 = cpu_ms();
        counts = exr_counts(pool.x);
        exr_close(pool.x);
        if (r >= 0) {
            decode_ms[r] = t1 - t0;
            encode_ms[r] = t3 - t2;
            decode_cpu[r] = c1 - c0;
            encode_cpu[r] = c3 - c2;
        }
    }
    qsort(decode_ms, (size_t)repeats, sizeof(double), by_value);
    qsort(encode_ms, (size_t)repeats, sizeof(double), by_value);
    qsort(decode_cpu, (size_t)repeats, sizeof(double), by_value);
    qsort(encode_cpu, (size_t)repeats, sizeof(double), by_value);
    printf("{\"file\":\"%s\",\"threads\":%u,\"decode_ms\":%.2f,\"encode_ms\":%.2f,\"decode_cpu_ms\":%.2f,"
           "\"encode_cpu_ms\":%.2f,\"chunks\":%u,"
           "\"chunks_copied\":%u,\"in_bytes\":%llu,\"out_bytes\":%llu}\n",
           argv[1], pool.threads, decode_ms[repeats / 2], encode_ms[repeats / 2], decode_cpu[repeats / 2],
           encode_cpu[repeats / 2], counts.chunks,
           counts.chunks_copied, (unsigned long long)size, (unsigned long long)out_bytes);
    for (int i = 0; i < 16; i++) {
        planes_free(&in[i]);
        planes_free(&out[i]);
    }
    for (unsigned i = 0; i < pool.threads; i++)
        exr_worker_destroy(pool.worker[i]);
    free(result);
    free(bytes);
    return 0;
}
