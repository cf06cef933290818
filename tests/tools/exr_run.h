/* SPDX-License-Identifier: Apache-2.0 */
/* exr_run.h - a whole life of a struct exr for tests: bytes in, edited bytes out. */
#ifndef EXR_RUN_H
#define EXR_RUN_H

#include "exr.h"

struct exr_run {
    struct exr_select select;
    struct exr_options options;
    const struct exr_limits *limits;  /* NULL: generous */
    unsigned threads;                 /* 0: one, tasks in reverse order */
    uint32_t grow;                    /* of every scene */
    bool untouched;
    bool float_out;                   /* output planes are FLOAT whatever the input is */
    /* out begins as a copy of in, in the middle of what is grown; NULL leaves it so. Scenes only. */
    void (*edit)(unsigned target, const struct exr_target *t, struct planes *out, void *ctx);
    /* fills extra layer k; needed when there are any */
    void (*extra)(unsigned target, unsigned k, struct planes *out, void *ctx);
    void (*look)(unsigned target, const struct exr_target *t, const struct planes *in, void *ctx);
    void *ctx;

    /* results; exr_run_finish frees them */
    uint8_t *bytes;
    size_t size;
    struct exr_counts counts;
    unsigned targets;
    char names[16][256];
    char notes[4096];
    struct fault fault;
};

int exr_run(struct exr_run *r, const void *bytes, size_t size); /* 0, or -1 with r->fault */
void exr_run_finish(struct exr_run *r);

float planes_get(const struct planes *p, unsigned c, uint32_t x, uint32_t y);
void planes_set(struct planes *p, unsigned c, uint32_t x, uint32_t y, float v);

#endif
