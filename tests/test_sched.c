// SPDX-License-Identifier: Apache-2.0
// test_sched.c - the scheduler with its real threads and the real device: turns, cancelling, and a device that
// is lost or hangs. That cannot be had on command, so bloom_run and bloom_create are wrapped by the
// linker (-Wl,--wrap): they do the real thing but where the test says "lost".
#include <poll.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "pulse.h"
#include "scheduler.h"
#include "scheduler_private.h"

enum { SIDE = 96, BYTES = SIDE * SIDE * 12 };
static const double AREA_MS = 1;

static _Atomic int runs, lose_at, lose_until; // runs number lose_at .. lose_until - 1 lose the device
static _Atomic int creates, creates_allowed;
static _Thread_local int creating; // the self-test's runs are not counted
static _Atomic int hang, hung, beats;   // hang: runs stand still; in them, one of `beats` is a step that came back

int __real_bloom_run(struct bloom *b, struct bloom_slot *s, unsigned target, const struct bloom_request *request,
                     struct bloom_reply *reply, struct fault *f);
int __wrap_bloom_run(struct bloom *b, struct bloom_slot *s, unsigned target, const struct bloom_request *request,
                     struct bloom_reply *reply, struct fault *f);
int __wrap_bloom_run(struct bloom *b, struct bloom_slot *s, unsigned target, const struct bloom_request *request,
                     struct bloom_reply *reply, struct fault *f)
{
    int n = creating ? -1 : runs++;
    while (hang && !creating) {
        hung = 1;
        if (beats > 0) {
            pulse_beat();
            beats--;
        }
        poll(NULL, 0, 1);
    }
    if (n >= lose_at && n < lose_until)
        return fault_set(f, FAULT_DEVICE_LOST, "", "lost by the test");
    int rc = __real_bloom_run(b, s, target, request, reply, f);
    // A device whose time is the frame's area, far above what the codec takes here: turns do not depend on this machine's load.
    if (!creating && request->display_width)
        reply->device_ms = AREA_MS * request->display_width * request->display_width;
    return rc;
}

int __real_bloom_create(struct bloom **out, const struct bloom_options *options, struct fault *f);
int __wrap_bloom_create(struct bloom **out, const struct bloom_options *options, struct fault *f);
int __wrap_bloom_create(struct bloom **out, const struct bloom_options *options, struct fault *f)
{
    if (creates++ >= creates_allowed)
        return fault_set(f, FAULT_INTERNAL, "", "refused by the test");
    creating = 1;
    int rc = __real_bloom_create(out, options, f);
    creating = 0;
    return rc;
}

struct world {
    struct sched *sched;
    struct block_pool blocks;
    struct job_env env;
    struct sched_flow flow[3];
};

static bool warm_idle;
static uint64_t work_bytes, user_work_bytes; // 0: plenty
static _Atomic int all_drawn; // how often it was logged

static void count_line(const char *line) { all_drawn += strstr(line, "all pipelines have drawn") != NULL; }

static void open_world(struct world *w, unsigned slots, int lost_from, int lost_to, int create_max)
{
    runs = creates = 0;
    lose_at = lost_from;
    lose_until = lost_to;
    creates_allowed = create_max;
    *w = (struct world){ 0 };
    block_pool_init(&w->blocks, 64 << 20);
    w->env = (struct job_env){ .limits = { .max_frame_bytes = 1 << 30 }, .blocks = &w->blocks };
    const uint64_t plenty = UINT64_C(1) << 40;
    struct sched_config config = { .threads = 2, .slots = slots, .warm_idle = warm_idle, .log = count_line };
    config.limits = (struct sched_limits){ work_bytes ? work_bytes : plenty, plenty, plenty, plenty, 10000, 10000, 10000 };
    if (user_work_bytes)
        config.limits.user_work_bytes = user_work_bytes;
    struct fault f;
    if (sched_create(&w->sched, &config, &f) < 0)
        fail_msg("%s", f.text);
    for (unsigned i = 0; i < 3; i++) // flows 0 and 1 are of one user
    {
        unsigned connections;
        assert_int_equal(sched_flow_open(w->sched, &w->flow[i], i < 2 ? 1000 : 1001, &connections), 0);
        assert_int_equal(connections, i == 1 ? 2 : 1);
    }
}

static void submit(struct world *w, unsigned flow, struct job *j)
{
    struct sched_refusal r;
    assert_true(sched_hold(w->sched, &w->flow[flow], j, j->input.size, 0, &r));
    sched_submit(w->sched, &w->flow[flow], j);
}

static void drop(struct world *w, struct job *j)
{
    sched_drop(w->sched, j);
    job_destroy(j);
}

static void close_world(struct world *w)
{
    for (unsigned i = 0; i < 3; i++)
        sched_flow_close(w->sched, &w->flow[i]);
    sched_destroy(w->sched);
    block_pool_finish(&w->blocks);
}

// A raw float picture with one lamp, its place by the id.
static struct job *make_sized(struct world *w, uint64_t id, uint32_t side)
{
    const uint64_t bytes = (uint64_t)side * side * 12;
    static const char *const names[] = { "R", "G", "B" };
    struct job *j = job_create(&w->env);
    struct fault f;
    j->id = id;
    j->raw = true;
    j->layout = (struct raw_layout){ .width = side, .height = side, .type = PIXEL_TYPE_FLOAT, .count = 3 };
    for (unsigned c = 0; c < 3; c++) {
        struct raw_channel *r = &j->layout.channel[c];
        strcpy(r->name, names[c]);
        r->offset = 4 * c;
        r->pixel_stride = 12;
        r->row_stride = side * 12;
    }
    assert_int_equal(raw_check(&j->layout, bytes, &f), 0);
    j->input = (struct payload){ .kind = PAYLOAD_INLINE, .fd = -1, .size = bytes };
    j->input.block = block_take(&w->blocks, bytes);
    memset(j->input.block->data, 0, bytes);
    float lamp[3] = { 100, 50, 25 };
    memcpy(j->input.block->data + (id * 131 % (side * side)) * 12, lamp, sizeof lamp);
    return j;
}

static struct job *make_job(struct world *w, uint64_t id) { return make_sized(w, id, SIDE); }

static struct job *next_done(struct world *w)
{
    for (int i = 0; i < 600; i++) {
        struct job *j = sched_done(w->sched);
        if (j)
            return j;
        struct pollfd p = { .fd = sched_event_fd(w->sched), .events = POLLIN };
        poll(&p, 1, 100);
        sched_event_clear(w->sched);
    }
    fail_msg("no job ended in 60 s");
    return NULL;
}

static uint64_t checksum(const struct job *j)
{
    uint64_t sum = 0;
    for (size_t i = 0; i < BYTES; i++)
        sum = sum * 31 + j->output.block->data[i];
    return sum;
}

// What a pixel costs, so that turns are reckoned right.
static void learn(struct world *w)
{
    for (uint64_t id = 1; id <= 16; id++) {
        submit(w, id % 3, make_job(w, id));
        drop(w, next_done(w));
    }
}

enum { JOBS = 6 };

static void run_jobs(struct world *w, uint64_t sums[JOBS], struct fault faults[JOBS])
{
    for (uint64_t i = 0; i < JOBS; i++)
        submit(w, 0, make_job(w, i + 1));
    for (int i = 0; i < JOBS; i++) {
        struct job *j = next_done(w);
        sums[j->id - 1] = j->finished ? checksum(j) : 0;
        faults[j->id - 1] = j->fault;
        assert_true(j->finished == (j->fault.code == FAULT_NONE));
        drop(w, j);
    }
}

static void wait_until(const _Atomic int *what, int value, const char *name)
{
    for (int i = 0; i < 60000 && *what != value; i++)
        poll(NULL, 0, 1);
    if (*what != value)
        fail_msg("%s is %d, not %d, after a minute", name, *what, value);
}

// How many wait in a stage, and the first of them.
static unsigned in_stage(struct world *w, enum job_stage stage, uint64_t *first)
{
    unsigned n = 0;
    const struct job *j;
    pthread_mutex_lock(&w->sched->lock);
    TAILQ_FOREACH(j, &w->sched->lane[LANE_FRAMES].stage[stage], link)
    {
        if (!n++)
            *first = j->id;
    }
    pthread_mutex_unlock(&w->sched->lock);
    return n;
}

static void await_stage(struct world *w, enum job_stage stage, unsigned n, uint64_t *first)
{
    for (int i = 0; i < 6000 && in_stage(w, stage, first) < n; i++)
        poll(NULL, 0, 10);
    assert_int_equal(in_stage(w, stage, first), n);
}

// Two slots, which have planes for two large frames, and the spare one, for a small: a device that hangs cannot make any.
static void open_prepared(struct world *w, uint32_t large)
{
    uint64_t first;
    open_world(w, 2, 0, 0, 1);
    learn(w);
    hung = 0;
    hang = 1;
    submit(w, 0, make_sized(w, 1, large));
    wait_until(&hung, 1, "hung");
    submit(w, 0, make_sized(w, 2, large));
    await_stage(w, JOB_PREPARE, 1, &first);
    hang = 0;
    for (uint64_t id = 1; id <= 2; id++)
        drop(w, next_done(w));
    hung = 0;
    hang = 1;
}

/*
 * Both slots hold large frames of one connection, and a third waits. A small one of another connection, or of another user, takes the spare
 * slot and goes before the large one that waits for the device; a large one, and a second small one of the same connection, do not.
 */
static void test_small_passes_large(void **state)
{
    (void)state;
    enum { LARGE = 320 };
    for (unsigned flow = 1; flow <= 2; flow++) {
        struct world w;
        uint64_t first = 0;
        open_prepared(&w, LARGE);
        submit(&w, 0, make_sized(&w, 1, LARGE));
        wait_until(&hung, 1, "hung");
        for (uint64_t id = 2; id <= 3; id++)
            submit(&w, 0, make_sized(&w, id, LARGE));
        await_stage(&w, JOB_BLOOM, 1, &first);
        assert_int_equal(first, 2); // 1 is in the device's hands
        submit(&w, 0, make_job(&w, 4)); // of the same connection: after those before it
        submit(&w, 2, make_sized(&w, 5, LARGE));
        submit(&w, flow, make_job(&w, 6));
        if (flow == 1) {
            await_stage(&w, JOB_BLOOM, 2, &first);
            assert_int_equal(first, 6);
        } else { // behind 5, which is of its own connection and large
            poll(NULL, 0, 100);
            assert_int_equal(in_stage(&w, JOB_BLOOM, &first), 1);
        }
        hang = 0;
        uint64_t order[6];
        for (unsigned i = 0; i < 6; i++) {
            struct job *j = next_done(&w);
            assert_int_equal(j->fault.code, FAULT_NONE);
            order[i] = j->id;
            drop(&w, j);
        }
        if (flow == 1)
            assert_true(order[0] == 6 || order[1] == 6); // 1 has still to be encoded
        close_world(&w);
    }
}

/* Many small ones, one after the other, pass a large one until their connection has had as much, and no longer. */
static void test_passing_ends(void **state)
{
    (void)state;
    enum { LARGE = 320, SMALL = 40 };
    struct world w;
    unsigned before = 0;
    open_world(&w, 1, 0, 0, 1);
    learn(&w);
    submit(&w, 0, make_sized(&w, 100, LARGE));
    submit(&w, 0, make_sized(&w, 101, LARGE));
    for (uint64_t id = 1; id <= SMALL; id++)
        submit(&w, 1, make_job(&w, id));
    bool large_done = false;
    for (unsigned i = 0; i < SMALL + 2; i++) {
        struct job *j = next_done(&w);
        large_done |= j->id == 101;
        before += j->id < 100 && !large_done;
        drop(&w, j);
    }
    // A large one costs as much as 11 small ones: two of them, and what is at work anyway.
    print_message("%u small frames went before two large ones that cost as much as 22\n", before);
    assert_true(before < SMALL - 8);
    close_world(&w);
}

static void test_device_lost_once(void **state)
{
    (void)state;
    struct world w;
    uint64_t well[JOBS], lost[JOBS];
    struct fault faults[JOBS];
    open_world(&w, 3, 0, 0, 1);
    run_jobs(&w, well, faults);
    close_world(&w);
    for (int at = 0; at < JOBS; at += JOBS / 2) {
        open_world(&w, 3, at, at + 1, 2);
        run_jobs(&w, lost, faults);
        assert_int_equal(creates, 2);
        assert_false(sched_counts(w.sched).device_dead);
        close_world(&w);
        assert_memory_equal(well, lost, sizeof well); // every job done, with the same pixels
    }
}

static void test_device_lost_again(void **state)
{
    (void)state;
    struct world w;
    uint64_t sums[JOBS];
    struct fault faults[JOBS];
    int failed = 0;
    open_world(&w, 1, 0, 2, 10); // job 1 loses it twice
    run_jobs(&w, sums, faults);
    for (int i = 0; i < JOBS; i++)
        failed += faults[i].code == FAULT_DEVICE_LOST;
    assert_int_equal(failed, 1);
    assert_int_equal(faults[0].code, FAULT_DEVICE_LOST);
    assert_true(fault_retryable(faults[0].code));
    close_world(&w);
}

static void test_device_dead(void **state)
{
    (void)state;
    struct world w;
    uint64_t sums[JOBS];
    struct fault faults[JOBS];
    open_world(&w, 2, 0, 1000, 1); // lost, and cannot be opened again
    run_jobs(&w, sums, faults);
    for (int i = 0; i < JOBS; i++)
        assert_int_equal(faults[i].code, FAULT_DEVICE_LOST);
    assert_true(sched_counts(w.sched).device_dead);
    assert_int_equal(sched_counts(w.sched).running + sched_counts(w.sched).waiting, 0);
    close_world(&w);
}

// What the watchdog is fed by: the time of the last progress stands still while the device hangs, moves with every step that comes
// back, and is nothing while there is nothing to do.
static void test_device_hangs(void **state)
{
    (void)state;
    struct world w;
    open_world(&w, 2, 0, 0, 1);
    assert_true(sched_device_since_ns(w.sched) == 0);
    uint64_t before = clock_ns();
    hung = 0;
    hang = 1;
    submit(&w, 0, make_job(&w, 1));
    submit(&w, 2, make_job(&w, 2));
    wait_until(&hung, 1, "hung");
    uint64_t since = sched_device_since_ns(w.sched);
    assert_true(since >= before && since <= clock_ns());
    poll(NULL, 0, 50);
    assert_true(sched_device_since_ns(w.sched) == since); // a job that waits behind it is no progress
    for (int i = 0; i < 3; i++) {
        beats = 1;
        wait_until(&beats, 0, "beats");
        uint64_t next = sched_device_since_ns(w.sched);
        assert_true(next > since);
        since = next;
    }
    hang = 0;
    for (int i = 0; i < 2; i++) {
        struct job *j = next_done(&w);
        assert_int_equal(j->fault.code, FAULT_NONE);
        job_destroy(j);
    }
    // The device thread ends its step after the job has gone on.
    for (int i = 0; i < 60000 && sched_device_since_ns(w.sched); i++)
        poll(NULL, 0, 1);
    assert_true(sched_device_since_ns(w.sched) == 0);
    close_world(&w);
}

// Jobs that come while other pipelines are drawn with get the same pixels; a device that is lost over it is
// opened again, and all are drawn with in the end.
static void test_warm_when_idle(void **state)
{
    (void)state;
    struct world w;
    uint64_t cold[JOBS], warm[JOBS];
    struct fault faults[JOBS];
    open_world(&w, 2, 0, 0, 1);
    run_jobs(&w, cold, faults);
    close_world(&w);
    warm_idle = true;
    all_drawn = 0;
    open_world(&w, 2, 3, 4, 2);
    warm_idle = false;
    run_jobs(&w, warm, faults);
    assert_memory_equal(cold, warm, sizeof cold);
    for (int i = 0; i < 1200 && !all_drawn; i++)
        poll(NULL, 0, 100);
    assert_int_equal(all_drawn, 1);
    assert_int_equal(creates, 2);
    assert_true(runs > 60); // the steps went through the engine, beside the six jobs
    run_jobs(&w, warm, faults);
    assert_memory_equal(cold, warm, sizeof cold);
    close_world(&w);
}

// With one slot jobs end in the order of their turns: users take turns, then their connections do.
static void test_turns(void **state)
{
    (void)state;
    struct world w;
    open_world(&w, 1, 0, 0, 1);
    // The first is on its way while the others are lined up.
    submit(&w, 0, make_job(&w, 100));
    drop(&w, next_done(&w));
    struct job *block = make_job(&w, 99);
    submit(&w, 0, block);
    for (uint64_t i = 0; i < 4; i++)
        submit(&w, 0, make_job(&w, 10 + i));
    for (uint64_t i = 0; i < 2; i++)
        submit(&w, 1, make_job(&w, 20 + i));
    for (uint64_t i = 0; i < 2; i++)
        submit(&w, 2, make_job(&w, 30 + i));
    uint64_t order[9];
    int place[3] = { 0 };
    for (int i = 0; i < 9; i++) {
        struct job *j = next_done(&w);
        order[i] = j->id;
        if (j->id == 11 || j->id == 20 || j->id == 31)
            place[j->id == 11 ? 0 : j->id == 20 ? 1 : 2] = i;
        drop(&w, j);
    }
    // Within a connection the order is kept.
    uint64_t last[4] = { 0 };
    for (int i = 0; i < 9; i++)
        if (order[i] < 99) {
            assert_true(order[i] > last[order[i] / 10]);
            last[order[i] / 10] = order[i];
        }
    // User 1001's second comes before user 1000's fourth or later: it had a turn every other time.
    if (place[2] > 5)
        fail_msg("user 1001's second job was number %d of 9", place[2]);
    if (place[1] > 6)
        fail_msg("the second connection's first job was number %d of 9", place[1]);
    close_world(&w);
}

static void test_cancel_anywhere(void **state)
{
    (void)state;
    struct world w;
    int finished = 0, cancelled = 0;
    open_world(&w, 3, 0, 0, 1);
    for (int round = 0; round < 60; round++) {
        struct job *jobs[4];
        for (uint64_t i = 0; i < 4; i++) {
            jobs[i] = make_job(&w, i + 1);
            submit(&w, i % 3, jobs[i]);
        }
        // At another moment of their lives each round.
        for (volatile int spin = 0; spin < round * 20000; spin++)
            ;
        for (int i = 0; i < 4; i++)
            sched_cancel(w.sched, jobs[i]);
        for (int i = 0; i < 4; i++) {
            struct job *j = next_done(&w);
            assert_int_equal(j->fault.code, FAULT_NONE);
            finished += j->finished;
            cancelled += !j->finished;
            drop(&w, j);
        }
        assert_int_equal(sched_counts(w.sched).running + sched_counts(w.sched).waiting, 0);
    }
    assert_int_equal(finished + cancelled, 240);
    assert_true(cancelled > 0);
    // Every slot is free again.
    uint64_t sums[JOBS];
    struct fault faults[JOBS];
    run_jobs(&w, sums, faults);
    for (int i = 0; i < JOBS; i++)
        assert_int_equal(faults[i].code, FAULT_NONE);
    close_world(&w);
}

// One slot, and something of that side in it until the others are lined up and hang is 0.
static void open_blocked(struct world *w, uint32_t side)
{
    open_world(w, 1, 0, 0, 1);
    learn(w);
    hang = 1;
    submit(w, 0, make_sized(w, 99, side));
    while (!sched_counts(w->sched).running)
        poll(NULL, 0, 1);
}

// Large frames against thumbnails of 1/16 of the area: as long as both users have some, their device times stay within what one
// large frame takes, and so do those of one user's two connections.
static void test_equal_device_time(void **state)
{
    (void)state;
    enum { LARGE = 8, SMALL = 100, SIDE_L = 192, SIDE_S = 48 };
    const double large = AREA_MS * SIDE_L * SIDE_L;
    struct world w;
    double took[3] = { 0 }; // by flow: 0 large and 1 small of one user, 2 small of another
    open_blocked(&w, 512);
    for (uint64_t i = 0; i < LARGE; i++)
        submit(&w, 0, make_sized(&w, 1000 + i, SIDE_L));
    for (uint64_t i = 0; i < SMALL; i++)
        submit(&w, 1, make_sized(&w, 2000 + i, SIDE_S));
    for (uint64_t i = 0; i < 2 * SMALL; i++)
        submit(&w, 2, make_sized(&w, 3000 + i, SIDE_S));
    unsigned left[3] = { LARGE, SMALL, 2 * SMALL };
    double worst = 0;
    hang = 0;
    while (left[0] + left[1] + left[2]) {
        struct job *j = next_done(&w);
        assert_int_equal(j->fault.code, FAULT_NONE);
        if (j->id >= 1000) {
            const unsigned k = (unsigned)(j->id / 1000 - 1);
            took[k] += j->ms.bloom;
            left[k]--;
        }
        drop(&w, j);
        if (!left[0] || !left[1] || !left[2])
            continue;
        // The first one's 512 x 512 count for user 1000, too; its connection is behind by as much.
        const double first = AREA_MS * 512 * 512, between = took[0] + took[1] + first - took[2];
        if (took[2] > first) {
            worst = between > worst ? between : -between > worst ? -between : worst;
            if (between > 2 * large || between < -2 * large)
                fail_msg("user 1000 had %.0f ms, user 1001 %.0f", took[0] + took[1] + first, took[2]);
        }
    }
    print_message("the two users' times were never more than %.2f large frames apart\n", worst / large);
    struct sched_user_facts u[SCHED_USERS_SHOWN];
    assert_int_equal(sched_users(w.sched, u), 2);
    for (int i = 0; i < 2; i++) {
        assert_int_equal(u[i].queued + u[i].running + u[i].requests, 0);
        assert_true(u[i].device_ms >= (u[i].uid == 1001 ? 2 * SMALL * AREA_MS * SIDE_S * SIDE_S : LARGE * large));
        assert_int_equal(u[i].bytes, 0);
    }
    close_world(&w);
}

// Higher first, among one user's; the other user's turns are not touched by them.
static void test_priorities(void **state)
{
    (void)state;
    struct world w;
    open_blocked(&w, 2 * SIDE);
    for (uint64_t i = 0; i < 12; i++) {
        struct job *j = make_job(&w, 10 + i);
        j->priority = (int)(i % 4) * 5 - 5; // -5 0 5 10
        submit(&w, (unsigned)(i % 2), j);
    }
    for (uint64_t i = 0; i < 3; i++) {
        struct job *j = make_job(&w, 50 + i);
        j->priority = -10;
        submit(&w, 2, j);
    }
    int last = 11, others = 0, seen = 0;
    uint64_t last_id = 0;
    hang = 0;
    for (int i = 0; i < 16; i++) {
        struct job *j = next_done(&w);
        if (j->id >= 50 && j->id < 99) {
            assert_true(j->id > last_id);
            last_id = j->id;
            others++;
        } else if (j->id < 50) {
            if (j->priority > last)
                fail_msg("priority %d after %d", j->priority, last);
            last = j->priority;
            seen++;
            if (seen == 8) // user 1001 owes nothing for the first, large one: its three were among these
                assert_int_equal(others, 3);
        }
        drop(&w, j);
    }
    assert_int_equal(seen, 12);
    close_world(&w);
}

// What waits beyond its deadline ends as DEADLINE, retryable; what has its turn goes on. The clock is the test's.
static void test_deadlines(void **state)
{
    (void)state;
    struct world w;
    open_blocked(&w, 2 * SIDE);
    for (uint64_t i = 0; i < 6; i++) {
        struct job *j = make_job(&w, 10 + i);
        j->deadline_ms = i % 2 ? 3600 * 1000 : 0; // an hour: never in this test
        submit(&w, 0, j);
    }
    struct job *late = make_job(&w, 20);
    late->deadline_ms = 1800 * 1000;
    late->priority = -10;
    submit(&w, 1, late);
    const uint64_t now = clock_ns(), s = UINT64_C(1000000000), next = sched_expire(w.sched, now);
    assert_true(next > now + 1790 * s && next <= now + 1800 * s);
    const uint64_t after = sched_expire(w.sched, now + 1801 * s);
    assert_true(after > now + 3590 * s);
    int ended = 0;
    hang = 0;
    for (int i = 0; i < 8; i++) {
        struct job *j = next_done(&w);
        if (j->fault.code == FAULT_DEADLINE) {
            assert_int_equal(j->id, 20);
            assert_string_equal(j->fault.field, "deadline_ms");
            assert_true(fault_retryable(j->fault.code) && !j->finished);
            ended++;
        } else {
            assert_true(j->finished);
        }
        drop(&w, j);
    }
    assert_int_equal(ended, 1);
    assert_int_equal(sched_expire(w.sched, now + 7200 * s), 0);
    close_world(&w);
}

// A ceiling that has room for one large frame: sizes that take turns make each other's planes go, nothing is ever above the
// ceiling, everything is done, and what can never fit says so.
static void test_room(void **state)
{
    (void)state;
    struct world w;
    uint64_t one = 0;
    open_world(&w, 3, 0, 0, 1);
    struct job *j = make_sized(&w, 1, 256);
    j->n_targets = 1;
    assert_true(sched_fits(w.sched, j, &one));
    j->n_targets = 0;
    drop(&w, j);
    close_world(&w);
    work_bytes = one + one / 4;
    open_world(&w, 3, 0, 0, 1);
    static const uint32_t sides[] = { 256, 64, 255, 128, 250, 96, 256, 200 };
    for (uint64_t i = 0; i < 40; i++)
        submit(&w, (unsigned)(i % 3), make_sized(&w, i + 1, sides[i % 8]));
    submit(&w, 2, make_sized(&w, 777, 320));
    for (int i = 0; i < 41; i++) {
        j = next_done(&w);
        if (j->id == 777) {
            assert_int_equal(j->fault.code, FAULT_LIMIT);
        } else if (!j->finished) {
            fail_msg("job %llu: %s", (unsigned long long)j->id, j->fault.text);
        }
        drop(&w, j);
        struct sched_counts c = sched_counts(w.sched);
        assert_true(c.work_bytes <= work_bytes && c.work_peak_bytes <= work_bytes);
    }
    assert_true(sched_counts(w.sched).work_peak_bytes > one / 2);
    // An unread result is held; nobody can take its room, and it is there again when the result goes.
    submit(&w, 0, make_sized(&w, 1, 256));
    struct job *unread = next_done(&w);
    assert_int_equal(unread->work_held, 256 * 256 * 12);
    submit(&w, 2, make_sized(&w, 2, 128));
    drop(&w, next_done(&w));
    drop(&w, unread);
    for (unsigned round = 0; round < 30; round++) { // cancelled while parked, or anywhere
        struct job *jobs[5];
        for (uint64_t i = 0; i < 5; i++)
            submit(&w, (unsigned)(i % 3), jobs[i] = make_sized(&w, i + 1, sides[(i + round) % 8]));
        for (volatile unsigned spin = 0; spin < round * 30000; spin++)
            ;
        for (unsigned i = 0; i < 5; i += 1 + round % 2)
            sched_cancel(w.sched, jobs[i]);
        for (int i = 0; i < 5; i++)
            drop(&w, next_done(&w));
    }
    assert_int_equal(sched_counts(w.sched).running + sched_counts(w.sched).waiting, 0);
    close_world(&w);
    work_bytes = 0;
}

static uint64_t held_by(struct world *w, uid_t uid)
{
    static struct sched_user_facts users[SCHED_USERS_SHOWN];
    unsigned n = sched_users(w->sched, users);
    for (unsigned i = 0; i < n; i++)
        if (users[i].uid == uid)
            return users[i].bytes;
    fail_msg("no user %u", (unsigned)uid);
    return 0;
}

// A user's frames never have more at work than the user may, however many of them could have a turn at once; one that has too much by results
// that nobody reads keeps nobody else from being served, and goes on when they are read.
static void test_user_room(void **state)
{
    (void)state;
    enum { LARGE = 256, FRAMES = 24 };
    const uint64_t one = (uint64_t)LARGE * LARGE * 12;
    struct world w;
    struct job *j;
    user_work_bytes = one + one / 2; // of two only one
    open_world(&w, 3, 0, 0, 1);
    uint64_t inputs = 0;
    for (uint64_t i = 0; i < FRAMES; i++) {
        j = make_sized(&w, i + 1, i % 3 == 2 ? 64 : LARGE);
        inputs += j->input.size;
        submit(&w, (unsigned)(i % 2), j);
    }
    for (uint64_t i = 0; i < FRAMES; i++)
        submit(&w, 2, make_sized(&w, 100 + i, 64));
    unsigned done[2] = { 0, 0 };
    while (done[0] + done[1] < 2 * FRAMES) {
        j = next_done(&w);
        if (!j->finished)
            fail_msg("job %llu: %s", (unsigned long long)j->id, j->fault.text);
        done[j->id >= 100]++;
        const uint64_t work = held_by(&w, 1000) - inputs;
        if (work > user_work_bytes)
            fail_msg("%llu bytes at work; at most %llu are this user's", (unsigned long long)work, (unsigned long long)user_work_bytes);
        inputs -= j->id < 100 ? j->input_held : 0;
        drop(&w, j);
    }
    assert_int_equal(done[0], FRAMES);
    // One result is not read; three more wait, and hold neither a slot nor the other user.
    submit(&w, 0, make_sized(&w, 1, LARGE));
    struct job *unread = next_done(&w);
    for (uint64_t i = 2; i <= 4; i++)
        submit(&w, 0, make_sized(&w, i, LARGE));
    for (uint64_t i = 0; i < 6; i++)
        submit(&w, 2, make_sized(&w, 100 + i, LARGE));
    for (int i = 0; i < 6; i++) {
        j = next_done(&w);
        assert_in_range(j->id, 100, 105);
        drop(&w, j);
    }
    assert_null(sched_done(w.sched));
    assert_int_equal(sched_counts(w.sched).waiting, 3);
    drop(&w, unread);
    for (uint64_t i = 2; i <= 4; i++) {
        j = next_done(&w);
        assert_int_equal(j->id, i); // in their order
        assert_true(j->finished);
        drop(&w, j);
    }
    assert_int_equal(held_by(&w, 1000), 0);
    close_world(&w);
    user_work_bytes = 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_turns),
        cmocka_unit_test(test_equal_device_time),
        cmocka_unit_test(test_priorities),
        cmocka_unit_test(test_deadlines),
        cmocka_unit_test(test_room),
        cmocka_unit_test(test_user_room),
        cmocka_unit_test(test_warm_when_idle),
        cmocka_unit_test(test_cancel_anywhere),
        cmocka_unit_test(test_small_passes_large),
        cmocka_unit_test(test_passing_ends),
        cmocka_unit_test(test_device_lost_once),
        cmocka_unit_test(test_device_lost_again),
        cmocka_unit_test(test_device_dead),
        cmocka_unit_test(test_device_hangs),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
