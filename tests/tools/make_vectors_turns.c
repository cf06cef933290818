// SPDX-License-Identifier: Apache-2.0
// make_vectors_turns.c - the example messages about turns, users and memory; see make_vectors.c.
#include "make_vectors.h"

static void turn(each_vector each, void *ctx)
{
    Airy__Bloom b = AIRY__BLOOM__INIT;
    Airy__Payload in = AIRY__PAYLOAD__INIT;
    Airy__ExrOptions exr = AIRY__EXR_OPTIONS__INIT;
    in.kind = AIRY__PAYLOAD__KIND__INLINE;
    in.size = 1024;
    b.input = &in;
    b.format_case = AIRY__BLOOM__FORMAT_EXR;
    b.exr = &exr;
    b.priority = -3;
    b.deadline_ms = 2000;
    each(&(struct vector){ .name = "bloom_turn", .what = "a request that may wait, but not for long", .type = WIRE_BLOOM, .id = 9,
                           .body = &b.base },
         ctx);
    Airy__Error e = AIRY__ERROR__INIT;
    e.code = 404;
    e.symbol = "DEADLINE";
    e.text = "it waited for its turn for 2000.4 ms; at most 2000 were given";
    e.field = "deadline_ms";
    e.retryable = true;
    each(&(struct vector){ .name = "error_deadline", .what = "a request that waited too long for its turn", .type = WIRE_ERROR,
                           .id = 9, .body = &e.base },
         ctx);
}

static void users(each_vector each, void *ctx)
{
    Airy__StatusReply s = AIRY__STATUS_REPLY__INIT;
    Airy__UserState first = AIRY__USER_STATE__INIT, second = AIRY__USER_STATE__INIT;
    Airy__UserState *all[] = { &first, &second };
    first.uid = 1000;
    first.connections = 2;
    first.requests = 5;
    first.queued = 3;
    first.running = 2;
    first.fds = 6;
    first.bytes = 50000000;
    first.device_ms = 1234.5;
    second.uid = 1001;
    second.connections = 1;
    second.fds = 1;
    Airy__MemoryState m = AIRY__MEMORY_STATE__INIT;
    m.ceiling = 8000000000;
    m.reserved = 1500000000;
    m.payloads = 1000000;
    m.work = 49000000;
    m.work_peak = 99000000;
    m.payloads_max = m.loads_max = 2000000000;
    m.work_max = 2500000000;
    double edges[] = { 1, 10 };
    uint64_t counts[] = { 4, 90, 6 };
    Airy__StageHistogram stage = AIRY__STAGE_HISTOGRAM__INIT;
    Airy__StageHistogram *stages[] = { &stage };
    stage.stage = "bloom";
    stage.counts = counts;
    stage.n_counts = 3;
    stage.sum_ms = 512.25;
    s.server = "airyd/0.1.0";
    s.clients = 3;
    s.users = all;
    s.n_users = 2;
    s.memory = &m;
    s.bucket_ms = edges;
    s.n_bucket_ms = 2;
    s.stages = stages;
    s.n_stages = 1;
    s.loop_turns = 70000;
    s.loop_worst_ms = 1.5;
    s.refused_busy = 7;
    each(&(struct vector){ .name = "status_reply_users", .what = "the answer to status, with users, memory and one histogram",
                           .type = WIRE_STATUS_REPLY, .id = 6, .body = &s.base },
         ctx);
}

void turn_vectors(each_vector each, void *ctx)
{
    turn(each, ctx);
    users(each, ctx);
}
