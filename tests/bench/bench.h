/* SPDX-License-Identifier: Apache-2.0 */
/*
 * bench.h - what the parts of airy_bench share: two threads, rounds of samples, the table and the CSV.
 *
 * What is compared is run in turns (A B C A B C ...), and a ratio is the median of the ratios within
 * each turn, so that a machine that slows down for a while slows down both sides. No time is
 * asserted; what is wrong (a pixel, a broken bound) ends the program with exit status 1.
 */
#ifndef AIRY_BENCH_H
#define AIRY_BENCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "bloom.h"
#include "frame.h"

void die(const char *format, ...) __attribute__((format(printf, 1, 2), noreturn));
double now_ms(void);
/* calloc that does not fail. */
void *take(size_t count, size_t bytes);
/* Keeps this process and its children to two cores, and the CPU device to two threads; returns how many there are. */
unsigned bench_pin(void);
void bench_cpu(char *out, size_t size); /* the model's name */

/* ---- two threads ------------------------------------------------------------------------------- */

enum { TEAM = 2 };
struct team; /* the caller and one more */
struct team *team_create(void);
void team_destroy(struct team *t);
/* Runs fn(ctx, 0) here and fn(ctx, 1) there, to the end of both. */
void team_run(struct team *t, void (*fn)(void *ctx, unsigned member), void *ctx);
/* Within fn: waits for the other. */
void team_meet(struct team *t);

/* ---- rounds ------------------------------------------------------------------------------------ */

enum { ROUNDS_MAX = 64, PARTS_MAX = 6, CASES_MAX = 16 };

struct sample {
    double ms;
    double part[PARTS_MAX]; /* of it, ms */
};
struct bench_case {
    char name[64];
    char note[64];
    void (*run)(void *ctx, struct sample *s);
    void *ctx;
    struct sample sample[ROUNDS_MAX];
};

/* One turn to warm up, then `rounds` turns of all cases. */
void bench_rounds(struct bench_case *cases, unsigned n, unsigned rounds);
double bench_median(const struct bench_case *c, unsigned rounds);
double bench_part(const struct bench_case *c, unsigned part, unsigned rounds);
double bench_ratio(const struct bench_case *c, const struct bench_case *base, unsigned rounds);

/* A table of the cases with their ratios to the bases (cases of the same rounds; names end with
 * NULL), and their lines in the CSV. */
struct bench_base {
    const char *name;
    unsigned of; /* index of the case */
};
void bench_table(const char *section, const char *size, const struct bench_case *cases, unsigned n,
                 unsigned rounds, const struct bench_base *bases);

void csv_open(const char *path); /* NULL: none */
void csv_line(const char *section, const char *size, const char *name, const char *quantity,
              double value, const char *unit);
void csv_text(const char *section, const char *name, const char *text);
void csv_close(void);

/* ---- the frame --------------------------------------------------------------------------------- */

struct bench_frame {
    char size[16]; /* "1920x1080" */
    uint32_t width, height;
    struct planes in_float, in_half;   /* R G B */
    struct planes out_float, out_half; /* J5 at 1e-3 by the engine; filled by measure_engine */
    uint8_t *exr;                      /* half RGBA ZIP of it */
    uint64_t exr_bytes;
    double bright_share; /* of pixels with a channel above 1 */
};
/* A scene of night and horizon: smooth light, lamps up to 5000, grain. The same for the same size. */
void frame_make(struct bench_frame *f, uint32_t width, uint32_t height, struct team *team);
void frame_finish(struct bench_frame *f);
void planes_fill(const struct planes *to, const struct planes *from);
/* The first difference of two planes ends the program. */
void planes_same(const struct planes *a, const struct planes *b, const char *what);

/* ---- the codec alone --------------------------------------------------------------------------- */

struct codec_result {
    double read_ms, write_ms;
    uint64_t bytes; /* written to `file` */
};
/* Reads all chunks of an EXR file into `in`, encodes all of `out` into a new file of the given enum
 * exr_compression, on two threads. file: room for the result. No chunk is copied, or the program ends.
 */
struct codec;
struct codec *codec_create(struct team *team);
void codec_destroy(struct codec *c);
struct codec_result codec_run(struct codec *c, const uint8_t *exr, uint64_t bytes, int compression,
                              const struct planes *in, const struct planes *out, uint8_t *file,
                              uint64_t room);
/* Only reads. */
void codec_read(struct codec *c, const uint8_t *exr, uint64_t bytes, const struct planes *in);

/* ---- the measurements -------------------------------------------------------------------------- */

struct bench {
    bool quick;
    unsigned rounds;
    const char *airyd, *device; /* device NULL: the best */
    struct team *team;
    struct bloom *engine;
};

/* The J5 job of this frame width: sigma 4/8/16/32/64 px at 1920, doubled at 3840. Returns a static text.
 */
const char *job_psf(uint32_t width);
struct params job_params(uint32_t width, double tolerance);
/* Sigmas of it, for the C chain. */
enum { JOB_GAUSSIANS = 5 };
void job_sigmas(uint32_t width, double sigma[JOB_GAUSSIANS]);

/* A case that copies the float RGBA frame on two threads. */
struct copy;
struct copy *copy_create(const struct bench_frame *f, struct team *team);
void copy_destroy(struct copy *c);
void copy_run(void *ctx, struct sample *s);
/* A case that runs the C chain. */
struct chain_job;
struct chain_job *chain_job_create(const struct bench_frame *f, struct team *team);
void chain_job_destroy(struct chain_job *j);
void chain_job_run(void *ctx, struct sample *s);
/* The chain against tests/reference on a small frame and a lone point. */
void chain_check(struct team *team);

void measure_engine(struct bench *b, struct bench_frame *f);
void measure_daemon(struct bench *b, struct bench_frame *f);
void measure_error(struct bench *b);

#endif
