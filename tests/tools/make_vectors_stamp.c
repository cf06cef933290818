// SPDX-License-Identifier: Apache-2.0
// make_vectors_stamp.c - the example messages about what is done already: how a client asks for an output's stamp, and the RESULTs
// that tell it; see make_vectors.c.
#include "make_vectors.h"

void stamp_vectors(each_vector each, void *ctx)
{
    Airy__Bloom b = AIRY__BLOOM__INIT;
    Airy__Payload in = AIRY__PAYLOAD__INIT, out = AIRY__PAYLOAD__INIT;
    Airy__Output as = AIRY__OUTPUT__INIT;
    Airy__ExrOptions exr = AIRY__EXR_OPTIONS__INIT;
    in.kind = AIRY__PAYLOAD__KIND__FILE;
    as.kind = AIRY__OUTPUT__KIND__MEMFD;
    b.input = &in;
    b.output = &as;
    b.format_case = AIRY__BLOOM__FORMAT_EXR;
    b.exr = &exr;
    b.plan_only = true;
    each(&(struct vector){ .name = "bloom_plan", .what = "a file of which only the plan is wanted, and with it the stamp of its output",
                           .type = WIRE_BLOOM, .id = 11, .n_fds = 1, .body = &b.base },
         ctx);
    Airy__Target target = AIRY__TARGET__INIT, *targets[] = { &target };
    Airy__Result r = AIRY__RESULT__INIT;
    target.name = "beauty";
    target.width = 64;
    target.height = 36;
    target.rule = "R3";
    r.output = &out;
    r.targets = targets;
    r.n_targets = 1;
    r.stamp = "airyd 0.1.0; params: threshold=1 intensity=0.05; choice xxh3:0123456789abcdef0123456789abcdef; input "
              "xxh3:fedcba9876543210fedcba9876543210";
    each(&(struct vector){ .name = "result_plan", .what = "the plan of request 11, with the stamp that its output would have",
                           .type = WIRE_RESULT, .id = 11, .body = &r.base },
         ctx);
    out.kind = AIRY__PAYLOAD__KIND__MEMFD;
    out.size = 9216;
    r.chunks = 3;
    each(&(struct vector){ .name = "result_stamp", .what = "the end of request 12, with the stamp that is in its output's header",
                           .type = WIRE_RESULT, .id = 12, .n_fds = 1, .body = &r.base },
         ctx);
}
