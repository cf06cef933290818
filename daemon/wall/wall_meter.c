// SPDX-License-Identifier: Apache-2.0
// wall_meter.c - see wall_meter.h. Percentiles are values that were measured (nearest rank), never between two of them.
#include <math.h>
#include <stdlib.h>

#include "wall_meter.h"

void meter_add(struct meter *m, double ms)
{
    m->ms[m->next] = (float)ms;
    m->next = (m->next + 1) % METER_VALUES;
    m->count += m->count < METER_VALUES;
}

static int by_size(const void *a, const void *b)
{
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static double rank(const float *sorted, unsigned n, double share)
{
    const unsigned i = (unsigned)ceil(share * n);
    return (double)sorted[i > 0 ? i - 1 : 0];
}

struct wall_times meter_percentiles(float *ms, unsigned n)
{
    if (!n)
        return (struct wall_times){ 0 };
    qsort(ms, n, sizeof(*ms), by_size);
    return (struct wall_times){ .p50 = rank(ms, n, 0.5), .p99 = rank(ms, n, 0.99), .max = (double)ms[n - 1] };
}

struct wall_times meter_times(struct meter *m) { return meter_percentiles(m->ms, m->count); }

void meter_second_add(struct meter_second *m, uint64_t now_ns, uint64_t pictures)
{
    m->tick[m->next].ns = now_ns;
    m->tick[m->next].pictures = pictures;
    m->next = (m->next + 1) % METER_TICKS;
    m->count += m->count < METER_TICKS;
}

void meter_second_read(const struct meter_second *m, uint64_t now_ns, double *ticks_per_s, double *pictures_per_s)
{
    const uint64_t second_ns = 1000000000;
    unsigned n = 0;
    uint64_t newest = 0, oldest = 0;
    for (; n < m->count; n++) {
        const unsigned i = (m->next + METER_TICKS - 1 - n) % METER_TICKS;
        if (n == 0)
            newest = m->tick[i].pictures;
        oldest = m->tick[i].pictures;
        if (m->tick[i].ns + second_ns <= now_ns)
            break;
    }
    // Before there is a second to look back on, pictures count from 0.
    if (n == m->count && m->count < METER_TICKS)
        oldest = 0;
    *ticks_per_s = n;
    *pictures_per_s = (double)(newest - oldest);
}
