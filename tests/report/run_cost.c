// SPDX-License-Identifier: Apache-2.0
// run_cost.c - what a frame costs the engine against its size, against the share of its tiles that glow, and on real files.
#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "exr.h"
#include "report.h"

enum { TURNS_MAX = 5 };

static int by_value(const void *a, const void *b)
{
    return *(const double *)a < *(const double *)b ? -1 : *(const double *)a > *(const double *)b;
}

struct shot {
    struct report *r;
    struct params params;
    struct planes in, out;
    struct frame_scan scan;
    struct bloom_reply reply;
};

static bool shot_open(struct shot *s, struct report *r, uint32_t width, uint32_t height, struct fault *f)
{
    const struct bloom_geometry g = { width, height, 3, PIXEL_TYPE_HALF, 0, 1 };
    *s = (struct shot){ .r = r, .params = job_params(1920, 1e-3) };
    return bloom_slot_prepare(r->engine, bloom_slot(r->engine, 1), 1, &g, &s->in, &s->out, f) == 0;
}

static void shot_scan(struct shot *s)
{
    const float luma[3] = { .2126f, .7152f, .0722f };
    frame_scan_finish(&s->scan);
    s->scan = (struct frame_scan){ 0 };
    if (frame_scan_init(&s->scan, s->in.width, s->in.height))
        die("no memory for a scan");
    for (uint32_t y = 0; y < s->in.height; y++)
        frame_scan_row(&s->scan, &s->in, y, luma);
}

// The median of some turns after one to warm up; < 0 and *f: the engine refuses.
static double shot_median(struct shot *s, unsigned turns, struct fault *f)
{
    const struct bloom_request q = { .params = &s->params, .scan = &s->scan, .source = -1, .matte = -1, .depth = -1,
                                     .luma = { .2126f, .7152f, .0722f }, .pixel_aspect = 1 };
    double ms[TURNS_MAX];
    for (unsigned i = 0; i <= turns; i++) {
        double t0 = now_ms();
        if (bloom_run(s->r->engine, bloom_slot(s->r->engine, 1), 0, &q, &s->reply, f) < 0)
            return -1;
        if (i)
            ms[i - 1] = now_ms() - t0;
    }
    qsort(ms, turns, sizeof(*ms), by_value);
    return ms[turns / 2];
}

/* ---- size ------------------------------------------------------------------------------------------------------ */

static double available_bytes(void)
{
    char line[128];
    unsigned long long kib = 0;
    FILE *file = fopen("/proc/meminfo", "re");
    while (file && fgets(line, sizeof line, file))
        if (sscanf(line, "MemAvailable: %llu", &kib) == 1)
            break;
    if (file)
        fclose(file);
    return (double)kib * 1024;
}

// The same picture again and again, so that the share of what glows is the same at each size.
static void fill_repeated(const struct planes *to, const struct planes *from)
{
    for (unsigned c = 0; c < to->count; c++)
        for (uint32_t y = 0; y < to->height; y++)
            for (uint32_t x = 0; x < to->width; x += from->width)
                memcpy(planes_row(to, c, y) + x * (size_t)pixel_bytes(to->type), planes_row(from, c, y % from->height),
                       from->width * (size_t)pixel_bytes(to->type));
}

void report_size(struct report *r)
{
    static const uint32_t most[] = { 256, 2048, 8192 };
    enum { BYTES_A_PIXEL = 64 }; /* planes of half on both sides, and targets of float */
    struct bench_frame base;
    uint32_t last = r->large ? 16384 : most[r->extent];
    printf("cost against size\n");
    frame_make(&base, 256, 256, r->team);
    for (uint32_t side = 256; side <= last; side *= 2) {
        struct shot s;
        struct fault f;
        double need = (double)side * side * BYTES_A_PIXEL;
        if (need > available_bytes()) {
            report_note(r, "size", "%u x %u and more: %.1f GB needed, %.1f GB available", side, side, need * 1e-9,
                        available_bytes() * 1e-9);
            break;
        }
        if (!shot_open(&s, r, side, side, &f)) {
            report_note(r, "size", "%u x %u and more: %s", side, side, f.text);
            break;
        }
        fill_repeated(&s.in, &base.in_half);
        shot_scan(&s);
        double ms = shot_median(&s, side > 4096 ? 1 : 3, &f);
        frame_scan_finish(&s.scan);
        if (ms < 0) {
            report_note(r, "size", "%u x %u and more: %s", side, side, f.text);
            break;
        }
        sheet_row(r->size, "suddd", r->device, side, ms, s.reply.device_ms, ms * 1e6 / side / side);
        fflush(r->size);
    }
    if (!r->large)
        report_note(r, "size", "beyond %u x %u: a longer report has more, and AIRY_REPORT_LARGE=1 has 16384 x 16384", last,
                    last);
    frame_finish(&base);
}

/* ---- tiles ------------------------------------------------------------------------------------------------------ */

static uint32_t scramble(uint32_t v)
{
    v = (v ^ v >> 16) * 0x7feb352du;
    v = (v ^ v >> 15) * 0x846ca68bu;
    return v ^ v >> 16;
}

static int by_hash(const void *a, const void *b)
{
    uint32_t x = scramble(*(const uint32_t *)a), y = scramble(*(const uint32_t *)b);
    return (x > y) - (x < y);
}

static void light_tiles(const struct planes *p, const uint32_t *order, uint32_t lit, uint32_t tiles_x)
{
    static const uint16_t dim = 0x3400, bright = 0x4000; /* .25, 2 */
    for (unsigned c = 0; c < p->count; c++)
        for (uint32_t y = 0; y < p->height; y++)
            for (uint32_t x = 0; x < p->width; x++)
                memcpy(planes_row(p, c, y) + 2 * (size_t)x, &dim, 2);
    for (uint32_t i = 0; i < lit; i++) {
        uint32_t x0 = order[i] % tiles_x * SCAN_TILE, y0 = order[i] / tiles_x * SCAN_TILE;
        for (unsigned c = 0; c < p->count; c++)
            for (uint32_t y = y0; y < y0 + SCAN_TILE && y < p->height; y++)
                for (uint32_t x = x0; x < x0 + SCAN_TILE && x < p->width; x++)
                    memcpy(planes_row(p, c, y) + 2 * (size_t)x, &bright, 2);
    }
}

void report_tiles(struct report *r)
{
    static const unsigned share[] = { 0, 1, 5, 20, 50, 100 };
    uint32_t width = r->extent == EXTENT_TINY ? 320 : 1920, height = width / 16 * 9;
    uint32_t tiles_x = (width + SCAN_TILE - 1) / SCAN_TILE, tiles = tiles_x * ((height + SCAN_TILE - 1) / SCAN_TILE);
    uint32_t *order = take(tiles, sizeof(*order));
    printf("cost against the share of bright tiles\n");
    for (unsigned pattern = 0; pattern < 2; pattern++) {
        for (uint32_t i = 0; i < tiles; i++)
            order[i] = i;
        if (pattern)
            qsort(order, tiles, sizeof(*order), by_hash);
        for (unsigned i = 0; i < sizeof share / sizeof share[0]; i++) {
            struct shot s;
            struct fault f;
            uint32_t lit = (tiles * share[i] + 99) / 100;
            if (!shot_open(&s, r, width, height, &f))
                die("%s", f.text);
            light_tiles(&s.in, order, lit, tiles_x);
            shot_scan(&s);
            double ms = shot_median(&s, r->extent == EXTENT_FULL ? 5 : 3, &f);
            if (ms < 0)
                die("%s: %s", f.field, f.text);
            sheet_row(r->tiles, "ssuuuds", r->device, pattern ? "scattered" : "from the top", share[i], tiles, lit, ms,
                      s.reply.skipped);
            frame_scan_finish(&s.scan);
        }
    }
    free(order);
}

/* ---- files ------------------------------------------------------------------------------------------------------- */

enum { FILES_MAX = 64 };
static struct {
    unsigned n;
    char *path[FILES_MAX];
} found;

static int collect(const char *path, const struct stat *st, int kind, struct FTW *at)
{
    size_t n = strlen(path);
    (void)at;
    if (kind == FTW_F && n > 4 && !strcmp(path + n - 4, ".exr") && st->st_size < 1 << 28 && found.n < FILES_MAX &&
        !(found.path[found.n++] = strdup(path)))
        die("no memory for names");
    return 0;
}

static int by_name(const void *a, const void *b) { return strcmp(*(char *const *)a, *(char *const *)b); }

static uint8_t *read_whole(const char *path, uint64_t *bytes)
{
    FILE *file = fopen(path, "re");
    struct stat st;
    if (!file || fstat(fileno(file), &st))
        die("%s: %s", path, strerror(errno));
    uint8_t *data = take((size_t)st.st_size + 1, 1);
    *bytes = (uint64_t)st.st_size;
    if (fread(data, 1, *bytes, file) != *bytes)
        die("%s: cannot be read", path);
    fclose(file);
    return data;
}

struct film {
    struct report *r;
    struct exr *exr;
    struct exr_worker *worker;
    struct params params;
    unsigned targets;
    struct planes in[BLOOM_TARGETS_MAX], out[BLOOM_TARGETS_MAX * BLOOM_OUTPUTS_MAX];
    struct bloom_reply reply[BLOOM_TARGETS_MAX];
    bool untouched[BLOOM_TARGETS_MAX];
};

static int film_decode(struct film *m, struct fault *f)
{
    struct bloom_geometry g[BLOOM_TARGETS_MAX];
    m->targets = exr_target_count(m->exr);
    if (!m->targets || m->targets > BLOOM_TARGETS_MAX)
        return fault_set(f, FAULT_LIMIT, "targets", "%u targets; 1 to %d are looked at", m->targets, BLOOM_TARGETS_MAX);
    for (unsigned i = 0; i < m->targets; i++) {
        const struct exr_target *t = exr_target(m->exr, i);
        g[i] = (struct bloom_geometry){ t->width, t->height, t->channels, t->type, 0, 1 };
    }
    if (bloom_slot_prepare(m->r->engine, bloom_slot(m->r->engine, 0), m->targets, g, m->in, m->out, f) < 0)
        return -1;
    for (unsigned i = 0; i < m->targets; i++)
        exr_bind(m->exr, i, &m->in[i], &m->out[i * BLOOM_OUTPUTS_MAX]);
    for (unsigned i = 0; i < exr_decode_tasks(m->exr); i++)
        if (exr_decode(m->exr, i, m->worker, f) < 0)
            return -1;
    return 0;
}

static int film_bloom(struct film *m, struct fault *f)
{
    for (unsigned i = 0; i < m->targets; i++) {
        const struct exr_target *t = exr_target(m->exr, i);
        struct bloom_request q = { .params = &m->params, .scan = &t->scan, .source = -1, .matte = -1, .depth = -1,
                                   .pixel_aspect = t->pixel_aspect, .display_width = t->display_width };
        memcpy(q.luma, t->luma, sizeof q.luma);
        if (bloom_run(m->r->engine, bloom_slot(m->r->engine, 0), i, &q, &m->reply[i], f) < 0)
            return -1;
        m->untouched[i] = m->reply[i].untouched;
    }
    if (exr_encode_begin(m->exr, m->untouched, f) < 0)
        return -1;
    for (unsigned i = 0; i < exr_encode_tasks(m->exr); i++)
        if (exr_encode(m->exr, i, m->worker, f) < 0)
            return -1;
    return 0;
}

static void film_write(struct film *m, const char *name)
{
    struct exr_counts n = exr_counts(m->exr);
    for (unsigned i = 0; i < m->targets; i++) {
        const struct exr_target *t = exr_target(m->exr, i);
        const struct bloom_reply *y = &m->reply[i];
        // A target that is untouched has done no work, whatever its tiles are.
        double done = y->untouched || !y->tiles ? 0 : 100. * y->tiles_bright / y->tiles;
        sheet_row(m->r->frames, "ssuuuudduuss", name, t->name, t->width, t->height, y->tiles, y->tiles_bright, 100 - done,
                  y->max_bright, n.chunks, n.chunks_copied, y->untouched ? "yes" : "no", y->skipped);
    }
}

static void look_at(struct report *r, const char *path, const char *name)
{
    const struct exr_limits limits = { 16384, 16384, UINT64_C(1) << 28, UINT64_C(1) << 32 };
    const struct exr_select select = { 0 };
    const struct exr_options options = { .compression = EXR_KEEP };
    static struct film m;
    struct fault f;
    uint64_t bytes;
    uint8_t *data = read_whole(path, &bytes);
    m = (struct film){ .r = r };
    params_init(&m.params);
    if (exr_worker_create(&m.worker))
        die("no memory for a codec");
    if (exr_open(&m.exr, data, bytes, &limits, &select, &options, &f) < 0 || film_decode(&m, &f) < 0 ||
        film_bloom(&m, &f) < 0)
        report_note(r, "frames", "%s: %s: %s", name, f.field, f.text);
    else
        film_write(&m, name);
    exr_close(m.exr);
    exr_worker_destroy(m.worker);
    free(data);
}

void report_frames(struct report *r)
{
    if (!r->frames_dir || access(r->frames_dir, R_OK)) {
        report_note(r, "frames", "no folder of real frames here: set AIRY_REPORT_FRAMES to one with EXR files");
        return;
    }
    printf("work skipped on real frames\n");
    if (nftw(r->frames_dir, collect, 8, FTW_PHYS))
        die("%s: %s", r->frames_dir, strerror(errno));
    qsort(found.path, found.n, sizeof(*found.path), by_name);
    for (unsigned i = 0; i < found.n; i++) {
        look_at(r, found.path[i], found.path[i] + strlen(r->frames_dir) + 1);
        free(found.path[i]);
    }
}
