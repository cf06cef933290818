// SPDX-License-Identifier: Apache-2.0
// measure.c - rounds, medians, tables, CSV: see bench.h.
#include <errno.h>
#include <sched.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "bench.h"

void die(const char *format, ...)
{
    va_list ap;
    va_start(ap, format);
    fflush(stdout);
    fputs("airy_bench: ", stderr);
    vfprintf(stderr, format, ap);
    fputc('\n', stderr);
    va_end(ap);
    exit(EXIT_FAILURE);
}

double now_ms(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec * 1e3 + (double)t.tv_nsec * 1e-6;
}

void *take(size_t count, size_t bytes)
{
    void *p = calloc(count, bytes);
    if (!p)
        die("no memory for %zu times %zu bytes", count, bytes);
    return p;
}

/* ---- the machine -------------------------------------------------------------------------------- */

unsigned bench_pin(void)
{
    cpu_set_t have, use;
    CPU_ZERO(&use);
    if (sched_getaffinity(0, sizeof have, &have))
        die("no CPU affinity");
    for (int i = 0; i < CPU_SETSIZE && CPU_COUNT(&use) < TEAM; i++)
        if (CPU_ISSET(i, &have))
            CPU_SET(i, &use);
    if (sched_setaffinity(0, sizeof use, &use))
        die("the CPU affinity cannot be set");
    setenv("LP_NUM_THREADS", "2", 0);
    return (unsigned)CPU_COUNT(&use);
}

void bench_cpu(char *out, size_t size)
{
    char line[256];
    FILE *file = fopen("/proc/cpuinfo", "re");
    snprintf(out, size, "unknown CPU");
    while (file && fgets(line, sizeof line, file)) {
        char *colon = strchr(line, ':');
        if (strncmp(line, "model name", 10) || !colon)
            continue;
        colon[strcspn(colon, "\n")] = 0;
        snprintf(out, size, "%s", colon + 2);
        break;
    }
    if (file)
        fclose(file);
}

/* ---- rounds -------------------------------------------------------------------------------------- */

void bench_rounds(struct bench_case *cases, unsigned n, unsigned rounds)
{
    for (unsigned r = 0; r <= rounds; r++)
        for (unsigned i = 0; i < n; i++) {
            struct sample s = { 0 };
            cases[i].run(cases[i].ctx, &s);
            if (r)
                cases[i].sample[r - 1] = s;
        }
}

static int by_value(const void *a, const void *b)
{
    return *(const double *)a < *(const double *)b ? -1 : *(const double *)a > *(const double *)b;
}

static double median(double *v, unsigned n)
{
    qsort(v, n, sizeof(*v), by_value);
    return n % 2 ? v[n / 2] : (v[n / 2 - 1] + v[n / 2]) / 2;
}

double bench_median(const struct bench_case *c, unsigned rounds)
{
    double v[ROUNDS_MAX];
    for (unsigned r = 0; r < rounds; r++)
        v[r] = c->sample[r].ms;
    return median(v, rounds);
}

double bench_part(const struct bench_case *c, unsigned part, unsigned rounds)
{
    double v[ROUNDS_MAX];
    for (unsigned r = 0; r < rounds; r++)
        v[r] = c->sample[r].part[part];
    return median(v, rounds);
}

double bench_ratio(const struct bench_case *c, const struct bench_case *base, unsigned rounds)
{
    double v[ROUNDS_MAX];
    for (unsigned r = 0; r < rounds; r++)
        v[r] = c->sample[r].ms / base->sample[r].ms;
    return median(v, rounds);
}

/* ---- table and CSV ------------------------------------------------------------------------------- */

static FILE *csv;
static const char *csv_path;

void csv_open(const char *path)
{
    csv_path = path;
    if (path && !(csv = fopen(path, "w")))
        die("%s: %s", path, strerror(errno));
    if (csv)
        fputs("section,size,name,quantity,value,unit\n", csv);
}

static void csv_field(const char *s)
{
    for (fputc('"', csv); *s; s++)
        fputc(*s == '"' ? '\'' : *s, csv);
    fputs("\",", csv);
}

void csv_line(const char *section, const char *size, const char *name, const char *quantity,
              double value, const char *unit)
{
    if (!csv)
        return;
    fprintf(csv, "%s,%s,", section, size);
    csv_field(name);
    fprintf(csv, "%s,%.6g,%s\n", quantity, value, unit);
}

void csv_text(const char *section, const char *name, const char *text)
{
    if (!csv)
        return;
    fprintf(csv, "%s,,%s,text,", section, name);
    csv_field(text);
    fputc('\n', csv);
}

void csv_close(void)
{
    if (csv && (ferror(csv) | fclose(csv)))
        die("%s: cannot be written", csv_path);
    csv = NULL;
}

static void case_csv(const char *section, const char *size, const struct bench_case *c, unsigned rounds)
{
    double low = c->sample[0].ms, high = low;
    for (unsigned r = 1; r < rounds; r++) {
        low = c->sample[r].ms < low ? c->sample[r].ms : low;
        high = c->sample[r].ms > high ? c->sample[r].ms : high;
    }
    csv_line(section, size, c->name, "median", bench_median(c, rounds), "ms");
    csv_line(section, size, c->name, "min", low, "ms");
    csv_line(section, size, c->name, "max", high, "ms");
    printf("  %-38s %8.2f %8.2f %8.2f", c->name, bench_median(c, rounds), low, high);
}

void bench_table(const char *section, const char *size, const struct bench_case *cases, unsigned n,
                 unsigned rounds, const struct bench_base *bases)
{
    printf("  %-38s %8s %8s %8s", "ms", "median", "min", "max");
    for (const struct bench_base *b = bases; b->name; b++)
        printf(" %*s/%s", 8 - (int)strlen(b->name), "", b->name);
    printf("\n");
    for (unsigned i = 0; i < n; i++) {
        case_csv(section, size, &cases[i], rounds);
        for (const struct bench_base *b = bases; b->name; b++) {
            double ratio = bench_ratio(&cases[i], &cases[b->of], rounds);
            char quantity[32];
            snprintf(quantity, sizeof quantity, "ratio_to_%s", b->name);
            csv_line(section, size, cases[i].name, quantity, ratio, "x");
            printf(" %9.2f", ratio);
        }
        printf("  %s\n", cases[i].note);
    }
    printf("\n");
}
