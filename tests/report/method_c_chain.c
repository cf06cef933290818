// SPDX-License-Identifier: Apache-2.0
// method_c_chain.c - the bench's yardstick (tests/bench/c_chain.h) among the methods: an optimised chain with filters of
// 4 taps and a kernel a level; only sigmas that are powers of two, only three channels.
#include <stdlib.h>

#include "c_chain.h"
#include "method.h"

struct chain {
    struct c_chain *chain;
    float threshold;
    struct planes in, out; /* of one channel's job: copied into all three */
};

static void destroy(void *self)
{
    struct chain *c = self;
    c_chain_destroy(c->chain);
    planes_free(&c->in);
    planes_free(&c->out);
    free(c);
}

static void *create(const struct blur_job *j)
{
    struct chain *c = take(1, sizeof(*c));
    c->threshold = j->threshold;
    c->chain = c_chain_create(j->width, j->height, j->sigma, j->weight, j->n, j->team);
    if (c->chain && (j->channels == 3 || (!planes_alloc(&c->in, j->width, j->height, 3, PIXEL_TYPE_FLOAT) &&
                                          !planes_alloc(&c->out, j->width, j->height, 3, PIXEL_TYPE_FLOAT))))
        return c;
    destroy(c);
    return NULL;
}

static void run(void *self, const struct planes *in, const struct planes *out)
{
    struct chain *c = self;
    if (in->count == 3) {
        c_chain_run(c->chain, in, out, c->threshold, 1);
        return;
    }
    struct planes one = c->in;
    one.count = 1;
    planes_fill(&one, in);
    c_chain_run(c->chain, &c->in, &c->out, c->threshold, 1);
    planes_fill(out, &(struct planes){ .width = out->width, .height = out->height, .count = 1, .type = out->type,
                                       .base = { c->out.base[0] }, .pitch_bytes = c->out.pitch_bytes, .phases = 1 });
}

const struct method method_c_chain = { "plain C chain", "4 taps down and up, one kernel a level", create, run, destroy };
