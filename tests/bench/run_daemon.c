// SPDX-License-Identifier: Apache-2.0
// run_daemon.c - frames through a real airyd by libairy: raw in shared memory and EXR files, one at a
// time and four in flight, in turns with the floors; then the daemon's peak memory. Every first answer
// is compared with the engine in this process, bit for bit: a fast wrong frame is no figure.
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "airy.h"
#include "bench.h"
#include "exr.h"

enum { FLIGHT = 4, RAMP = 2, START_MS = 60000 };

/* ---- the daemon ----------------------------------------------------------------------------------- */

struct server {
    pid_t pid;
    char dir[64], path[96];
    int lifetime_fd; /* closed when this process ends, however it does: the daemon then ends too */
    struct airy *a;
};

static void server_exec(const struct bench *b, const struct server *s, int fd)
{
    char fd_text[16], threads[16];
    snprintf(fd_text, sizeof fd_text, "%d", fd);
    snprintf(threads, sizeof threads, "%d", TEAM);
    execl(b->airyd, b->airyd, "--socket", s->path, "--lifetime-fd", fd_text, "--threads", threads,
          "--device", b->device ? b->device : "", (char *)NULL);
    perror(b->airyd);
    _exit(127);
}

static void server_start(struct server *s, const struct bench *b)
{
    int ends[2];
    struct airy_error e;
    strcpy(s->dir, "/tmp/airy-bench-XXXXXX");
    if (!mkdtemp(s->dir) || pipe(ends))
        die("a folder and a pipe for airyd: %s", strerror(errno));
    snprintf(s->path, sizeof s->path, "%s/s", s->dir);
    fcntl(ends[1], F_SETFD, FD_CLOEXEC);
    fflush(stdout);
    if ((s->pid = fork()) < 0)
        die("fork: %s", strerror(errno));
    if (s->pid == 0)
        server_exec(b, s, ends[0]);
    close(ends[0]);
    s->lifetime_fd = ends[1];
    for (double end = now_ms() + START_MS; airy_connect(&s->a, s->path, &e) < 0;) {
        if (waitpid(s->pid, NULL, WNOHANG) == s->pid || now_ms() > end)
            die("%s did not start: %s", b->airyd, e.text);
        nanosleep(&(struct timespec){ .tv_nsec = 10000000 }, NULL);
    }
}

static void server_stop(struct server *s)
{
    int status;
    airy_close(s->a);
    kill(s->pid, SIGTERM);
    if (waitpid(s->pid, &status, 0) != s->pid || status)
        die("airyd ended with status 0x%x", (unsigned)status);
    close(s->lifetime_fd);
    unlink(s->path);
    rmdir(s->dir);
}

// VmHWM: the most that was resident at once, memfds that it had mapped too.
static double server_peak_bytes(const struct server *s)
{
    char path[64], line[256];
    unsigned long long kib = 0;
    snprintf(path, sizeof path, "/proc/%d/status", (int)s->pid);
    FILE *file = fopen(path, "re");
    while (file && fgets(line, sizeof line, file))
        if (sscanf(line, "VmHWM: %llu", &kib) == 1)
            break;
    if (file)
        fclose(file);
    if (!kib)
        die("%s has no VmHWM", path);
    return (double)kib * 1024;
}

/* ---- streams: the same request again and again
 * --------------------------------------------------------- */

struct stream {
    struct server *server;
    struct airy_request request;
    unsigned flight, frames; /* in flight at once; measured */
    struct {
        int fd;
        uint8_t *map;
    } output[FLIGHT]; /* raw */
    uint64_t output_bytes;
    uint64_t id[FLIGHT];
    void (*check)(struct stream *s, const struct airy_result *r);
    const void *check_ctx;
    bool checked;
};

static void stream_submit(struct stream *s, unsigned slot)
{
    struct airy_error e;
    if (s->output_bytes)
        s->request.output_fd = s->output[slot].fd;
    if (airy_submit(s->server->a, &s->request, &s->id[slot], &e) < 0)
        die("%s: %s: %s", e.symbol, e.field, e.text);
}

static unsigned slot_of(const struct stream *s, uint64_t id)
{
    unsigned slot = 0;
    while (slot < s->flight && s->id[slot] != id)
        slot++;
    if (slot == s->flight)
        die("a result for request %llu, which is not in flight", (unsigned long long)id);
    return slot;
}

static struct airy_result *stream_wait(struct stream *s, unsigned *slot)
{
    struct airy_error e;
    struct airy_result *r = NULL;
    uint64_t id;
    if (airy_wait_any(s->server->a, -1, &id, &r, &e) <= 0)
        die("%s: %s: %s", e.symbol, e.field, e.text);
    *slot = slot_of(s, id);
    return r;
}

static void single_run(struct stream *s, struct sample *out)
{
    unsigned slot;
    double t0 = now_ms();
    stream_submit(s, 0);
    struct airy_result *r = stream_wait(s, &slot);
    out->ms = now_ms() - t0;
    const struct airy_times *t = &r->ms;
    memcpy(out->part, (double[PARTS_MAX]){ t->queue, t->load, t->decode, t->bloom, t->encode, t->total },
           sizeof out->part);
    if (!s->checked)
        s->check(s, r);
    s->checked = true;
    airy_result_free(r);
}

// What is still in flight when the clock has stopped is not worth its time.
static void flight_cancel(struct stream *s)
{
    struct airy_error e;
    for (unsigned i = 0; i < s->flight; i++)
        if (airy_cancel(s->server->a, s->id[i], &e) < 0)
            die("%s: %s", e.symbol, e.text);
    for (unsigned i = 0; i < s->flight; i++) {
        struct airy_result *r = NULL;
        uint64_t id;
        if (airy_wait_any(s->server->a, -1, &id, &r, &e) < 0 && strcmp(e.symbol, "CANCELLED"))
            die("%s: %s: %s", e.symbol, e.field, e.text);
        airy_result_free(r);
    }
}

// Always `flight` requests in hand while the clock runs.
static void flight_run(struct stream *s, struct sample *out)
{
    double t0 = 0;
    unsigned slot;
    for (slot = 0; slot < s->flight; slot++)
        stream_submit(s, slot);
    for (unsigned done = 1; done <= RAMP + s->frames; done++) {
        airy_result_free(stream_wait(s, &slot));
        stream_submit(s, slot);
        if (done == RAMP)
            t0 = now_ms();
    }
    out->ms = (now_ms() - t0) / s->frames;
    flight_cancel(s);
}

static void stream_run(void *ctx, struct sample *out)
{
    struct stream *s = ctx;
    if (s->flight == 1)
        single_run(s, out);
    else
        flight_run(s, out);
}

static void stream_param(struct stream *s, const char *name, const char *value)
{
    struct airy_error e;
    if (airy_request_param(&s->request, name, value, &e) < 0)
        die("%s: %s", e.field, e.text);
}

static void stream_job(struct stream *s, uint32_t width)
{
    stream_param(s, "bright", "channel");
    stream_param(s, "threshold", "1");
    stream_param(s, "intensity", "1");
    stream_param(s, "tolerance", "1e-3");
    stream_param(s, "psf", job_psf(width));
}

static uint8_t *shared(uint64_t bytes, int *fd)
{
    void *map;
    struct airy_error e;
    if ((*fd = airy_memfd(bytes, &map, &e)) < 0)
        die("%s", e.text);
    return map;
}

/* ---- raw
 * ------------------------------------------------------------------------------------------------ */

struct layout {
    const char *name;
    enum pixel_type type;
    unsigned channels; /* 3: planes; 4: interleaved */
};
static const struct layout layouts[] = {
    { "planar float RGB", PIXEL_TYPE_FLOAT, 3 },
    { "planar half RGB", PIXEL_TYPE_HALF, 3 },
    { "interleaved half RGBA", PIXEL_TYPE_HALF, 4 },
};
enum { LAYOUTS = sizeof layouts / sizeof layouts[0] };

struct raw_side {
    const struct layout *layout;
    const struct bench_frame *f;
    int input_fd;
    uint8_t *input;
    uint64_t bytes;
    struct stream one, four;
};

static uint8_t *raw_sample(const struct raw_side *r, uint8_t *base, unsigned c, uint32_t y, uint32_t x)
{
    uint64_t size = pixel_bytes(r->layout->type), w = r->f->width, h = r->f->height;
    return base + size * (r->layout->channels == 4 ? (y * w + x) * 4 + c : (c * h + y) * w + x);
}

static void raw_fill(struct raw_side *r)
{
    const struct planes *from = r->layout->type == PIXEL_TYPE_HALF ? &r->f->in_half : &r->f->in_float;
    size_t size = pixel_bytes(r->layout->type);
    for (unsigned c = 0; c < r->layout->channels; c++)
        for (uint32_t y = 0; y < r->f->height; y++)
            for (uint32_t x = 0; x < r->f->width; x++)
                memcpy(raw_sample(r, r->input, c, y, x),
                       c == 3 ? (const uint8_t *)&(uint16_t){ 0x3c00 }
                              : planes_row(from, c, y) + x * size,
                       size);
}

static void raw_check(struct stream *s, const struct airy_result *result)
{
    const struct raw_side *r = s->check_ctx;
    const struct planes *want = r->layout->type == PIXEL_TYPE_HALF ? &r->f->out_half : &r->f->out_float;
    size_t size = pixel_bytes(r->layout->type);
    if (result->n_targets != 1 || result->targets[0].untouched)
        die("%s: nothing was bloomed", r->layout->name);
    for (unsigned c = 0; c < r->layout->channels; c++)
        for (uint32_t y = 0; y < r->f->height; y++)
            for (uint32_t x = 0; x < r->f->width; x++)
                if (memcmp(raw_sample(r, s->output[0].map, c, y, x),
                           c == 3 ? (const uint8_t *)&(uint16_t){ 0x3c00 }
                                  : planes_row(want, c, y) + x * size,
                           size))
                    die("%s: pixel %u,%u of channel %u is not the engine's", r->layout->name, x, y, c);
}

static void raw_request(const struct raw_side *r, struct airy_request *q)
{
    static const char *const names[4] = { "R", "G", "B", "A" };
    q->input_fd = r->input_fd;
    q->width = r->f->width;
    q->height = r->f->height;
    q->type = r->layout->type == PIXEL_TYPE_HALF ? AIRY_HALF : AIRY_FLOAT;
    q->n_channels = r->layout->channels;
    for (unsigned c = 0; c < q->n_channels; c++)
        q->channels[c] = (struct airy_channel){
            .name = names[c],
            .offset = (uint64_t)(raw_sample(r, r->input, c, 0, 0) - r->input),
            .pixel_stride =
                (uint32_t)(raw_sample(r, r->input, c, 0, 1) - raw_sample(r, r->input, c, 0, 0)),
            .row_stride =
                (uint64_t)(raw_sample(r, r->input, c, 1, 0) - raw_sample(r, r->input, c, 0, 0)),
        };
}

static void raw_stream(struct raw_side *r, struct stream *s, struct server *server, unsigned flight,
                       unsigned frames)
{
    *s = (struct stream){ .server = server,
                          .request = AIRY_REQUEST_INIT,
                          .flight = flight,
                          .frames = frames,
                          .output_bytes = r->bytes,
                          .check = raw_check,
                          .check_ctx = r };
    raw_request(r, &s->request);
    stream_job(s, r->f->width);
    for (unsigned i = 0; i < flight; i++)
        s->output[i].map = shared(r->bytes, &s->output[i].fd);
}

static void stream_finish(struct stream *s)
{
    for (unsigned i = 0; s->output_bytes && i < s->flight; i++) {
        munmap(s->output[i].map, s->output_bytes);
        close(s->output[i].fd);
    }
}

static void measure_raw(struct bench *b, const struct bench_frame *f, struct server *server,
                        unsigned frames)
{
    static struct bench_case cases[CASES_MAX];
    static struct raw_side side[LAYOUTS];
    struct copy *copy = copy_create(f, b->team);
    struct chain_job *chain = chain_job_create(f, b->team);
    unsigned n = 0;
    cases[n++] =
        (struct bench_case){ .name = "memcpy float RGBA, 2 threads", .run = copy_run, .ctx = copy };
    cases[n++] =
        (struct bench_case){ .name = "C chain J5 float, 2 threads", .run = chain_job_run, .ctx = chain };
    for (unsigned i = 0; i < LAYOUTS; i++) {
        struct raw_side *r = &side[i];
        *r = (struct raw_side){ .layout = &layouts[i], .f = f };
        r->bytes = (uint64_t)f->width * f->height * r->layout->channels * pixel_bytes(r->layout->type);
        r->input = shared(r->bytes, &r->input_fd);
        raw_fill(r);
        raw_stream(r, &r->one, server, 1, 1);
        raw_stream(r, &r->four, server, FLIGHT, frames);
        cases[n] = (struct bench_case){ .run = stream_run, .ctx = &r->one };
        snprintf(cases[n++].name, sizeof cases[n].name, "%s, one", r->layout->name);
        cases[n] = (struct bench_case){ .run = stream_run, .ctx = &r->four };
        snprintf(cases[n++].name, sizeof cases[n].name, "%s, 4 in flight", r->layout->name);
    }
    bench_rounds(cases, n, b->rounds);
    printf("Daemon, raw to raw in shared memory, J5, %s: ms a frame\n", f->size);
    for (unsigned i = 2; i < n; i += 2)
        snprintf(cases[i].note, sizeof cases[i].note, "load+decode %.1f bloom %.1f encode %.1f",
                 bench_part(&cases[i], 1, b->rounds) + bench_part(&cases[i], 2, b->rounds),
                 bench_part(&cases[i], 3, b->rounds), bench_part(&cases[i], 4, b->rounds));
    bench_table("raw", f->size, cases, n, b->rounds,
                (const struct bench_base[]){ { "memcpy", 0 }, { "chain", 1 }, { NULL, 0 } });
    for (unsigned i = 0; i < LAYOUTS; i++) {
        stream_finish(&side[i].one);
        stream_finish(&side[i].four);
        munmap(side[i].input, side[i].bytes);
        close(side[i].input_fd);
    }
    copy_destroy(copy);
    chain_job_destroy(chain);
}

/* ---- EXR
 * ------------------------------------------------------------------------------------------------- */

struct floor_job {
    struct codec *codec;
    const struct bench_frame *f;
    struct planes in;
    uint8_t *file;
    uint64_t room, bytes;
};

static void floor_run(void *ctx, struct sample *s)
{
    struct floor_job *j = ctx;
    struct codec_result r = codec_run(j->codec, j->f->exr, j->f->exr_bytes, EXR_KEEP, &j->in,
                                      &j->f->out_half, j->file, j->room);
    s->ms = r.read_ms + r.write_ms;
    s->part[0] = r.read_ms;
    s->part[1] = r.write_ms;
    j->bytes = r.bytes;
}

static void exr_check(struct stream *s, const struct airy_result *r)
{
    const struct floor_job *j = s->check_ctx;
    if (r->chunks_copied)
        die("%u of %u chunks were copied: not the floor's work", r->chunks_copied, r->chunks);
    codec_read(j->codec, r->data, r->size, &j->in);
    planes_same(&j->in, &j->f->out_half, "the daemon's EXR file");
}

static void look_check(struct stream *s, const struct airy_result *r)
{
    (void)s;
    if (r->n_targets != 1 || r->targets[0].untouched)
        die("the default look does nothing to the frame");
}

static int exr_file(const struct bench_frame *f, const struct server *s)
{
    char path[128];
    snprintf(path, sizeof path, "%s/in.exr", s->dir);
    int fd = open(path, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
    if (fd < 0 || unlink(path))
        die("%s: %s", path, strerror(errno));
    for (uint64_t done = 0; done < f->exr_bytes;) {
        ssize_t n = write(fd, f->exr + done, f->exr_bytes - done);
        if (n <= 0)
            die("%s: %s", path, strerror(errno));
        done += (uint64_t)n;
    }
    return fd;
}

static void stage_table(const struct bench_frame *f, const struct bench_case *cases, unsigned n,
                        unsigned rounds)
{
    static const char *const stage[PARTS_MAX] = {
        "queue", "load", "decode", "bloom", "encode", "total"
    };
    printf("  %-38s", "stages in the daemon, ms (median)");
    for (unsigned k = 0; k < PARTS_MAX; k++)
        printf(" %8s", stage[k]);
    printf("\n");
    for (unsigned i = 1; i < n; i += 2) {
        printf("  %-38s", cases[i].name);
        for (unsigned k = 0; k < PARTS_MAX; k++) {
            double ms = bench_part(&cases[i], k, rounds);
            printf(" %8.2f", ms);
            csv_line("exr", f->size, cases[i].name, stage[k], ms, "ms");
        }
        printf("\n");
    }
    printf("\n");
}

static void exr_stream(struct stream *s, struct server *server, int fd, unsigned flight, unsigned frames)
{
    *s = (struct stream){
        .server = server, .request = AIRY_REQUEST_INIT, .flight = flight, .frames = frames
    };
    s->request.input_fd = fd;
}

static void measure_exr(struct bench *b, const struct bench_frame *f, struct server *server,
                        unsigned frames)
{
    static struct bench_case cases[CASES_MAX];
    static struct stream stream[4];
    struct floor_job floor = { .codec = codec_create(b->team),
                               .f = f,
                               .room = 2 * f->exr_bytes + (1 << 20) };
    static const char *const names[4] = { "EXR J5, one", "EXR J5, 4 in flight", "EXR default look, one",
                                          "EXR default look, 4 in flight" };
    floor.file = take(1, floor.room);
    if (planes_alloc(&floor.in, f->width, f->height, 3, PIXEL_TYPE_HALF))
        die("no memory for %s planes", f->size);
    int fd = exr_file(f, server);
    cases[0] = (struct bench_case){ .name = "codec floor: read + write, 2 threads",
                                    .run = floor_run,
                                    .ctx = &floor };
    for (unsigned i = 0; i < 4; i++) {
        exr_stream(&stream[i], server, fd, i % 2 ? FLIGHT : 1, frames);
        if (i < 2)
            stream_job(&stream[i], f->width);
        stream[i].check = i < 2 ? exr_check : look_check;
        stream[i].check_ctx = &floor;
        cases[i + 1] = (struct bench_case){ .run = stream_run, .ctx = &stream[i] };
        snprintf(cases[i + 1].name, sizeof cases[i + 1].name, "%s", names[i]);
    }
    bench_rounds(cases, 5, b->rounds);
    double read_ms = bench_part(&cases[0], 0, b->rounds), write_ms = bench_part(&cases[0], 1, b->rounds);
    snprintf(cases[0].note, sizeof cases[0].note, "read %.1f write %.1f", read_ms, write_ms);
    csv_line("exr", f->size, cases[0].name, "read", read_ms, "ms");
    csv_line("exr", f->size, cases[0].name, "write", write_ms, "ms");
    printf("Daemon, EXR to EXR (half RGBA ZIP, %.1f MB in, %.1f MB out), %s: ms a frame\n",
           (double)f->exr_bytes * 1e-6, (double)floor.bytes * 1e-6, f->size);
    bench_table("exr", f->size, cases, 5, b->rounds,
                (const struct bench_base[]){ { "floor", 0 }, { NULL, 0 } });
    stage_table(f, cases, 5, b->rounds);
    close(fd);
    free(floor.file);
    planes_free(&floor.in);
    codec_destroy(floor.codec);
}

/* ---- memory
 * ---------------------------------------------------------------------------------------------- */

static void report_memory(const struct bench_frame *f, const char *after, double bytes)
{
    double decoded = (double)f->width * f->height * 16;
    printf("  %-38s %8.0f MB %6.2f x the decoded float RGBA frame\n", after, bytes * 1e-6,
           bytes / decoded);
    csv_line("memory", f->size, after, "peak", bytes, "bytes");
    csv_line("memory", f->size, after, "ratio_to_frame", bytes / decoded, "x");
}

void measure_daemon(struct bench *b, struct bench_frame *f)
{
    struct server server;
    unsigned frames = f->width > 1920 ? 3 : 5;
    server_start(&server, b);
    double start = server_peak_bytes(&server);
    struct stream one;
    int fd = exr_file(f, &server);
    exr_stream(&one, &server, fd, 1, 1);
    stream_job(&one, f->width);
    one.check = look_check;
    for (unsigned i = 0; i < 3; i++)
        stream_run(&one, &(struct sample){ 0 });
    close(fd);
    double single = server_peak_bytes(&server);
    measure_raw(b, f, &server, frames);
    measure_exr(b, f, &server, frames);
    printf("Daemon, most memory resident (VmHWM), %s\n", f->size);
    report_memory(f, "after the start", start);
    report_memory(f, "after EXR frames one at a time", single);
    report_memory(f, "after all of the above", server_peak_bytes(&server));
    printf("\n");
    server_stop(&server);
}
