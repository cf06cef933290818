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
    return __real_bloom_run(b, s, target, request, reply, f);
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

enum { SIDE = 96, BYTES = SIDE * SIDE * 12 };

struct world {
    struct sched *sched;
    struct block_pool blocks;
    struct job_env env;
    struct sched_flow flow[3];
};

static bool warm_idle;
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
    struct sched_config config = { .threads = 2, .slots = slots, .warm_idle = warm_idle, .log = count_line };
    struct fault f;
    if (sched_create(&w->sched, &config, &f) < 0)
        fail_msg("%s", f.text);
    for (unsigned i = 0; i < 3; i++) // flows 0 and 1 are of one user
        assert_int_equal(sched_flow_open(w->sched, &w->flow[i], i < 2 ? 1000 : 1001), 0);
}

static void close_world(struct world *w)
{
    for (unsigned i = 0; i < 3; i++)
        sched_flow_close(w->sched, &w->flow[i]);
    sched_destroy(w->sched);
    block_pool_finish(&w->blocks);
}

// A raw float picture with one lamp, its place by the id.
static struct job *make_job(struct world *w, uint64_t id)
{
    static const char *const names[] = { "R", "G", "B" };
    struct job *j = job_create(&w->env);
    struct fault f;
    j->id = id;
    j->raw = true;
    j->layout = (struct raw_layout){ .width = SIDE, .height = SIDE, .type = PIXEL_TYPE_FLOAT, .count = 3 };
    for (unsigned c = 0; c < 3; c++) {
        struct raw_channel *r = &j->layout.channel[c];
        strcpy(r->name, names[c]);
        r->offset = 4 * c;
        r->pixel_stride = 12;
        r->row_stride = SIDE * 12;
    }
    assert_int_equal(raw_check(&j->layout, BYTES, &f), 0);
    j->input = (struct payload){ .kind = PAYLOAD_INLINE, .fd = -1, .size = BYTES };
    j->input.block = block_take(&w->blocks, BYTES);
    memset(j->input.block->data, 0, BYTES);
    float lamp[3] = { 100, 50, 25 };
    memcpy(j->input.block->data + (id * 131 % (SIDE * SIDE)) * 12, lamp, sizeof lamp);
    return j;
}

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

enum { JOBS = 6 };

static void run_jobs(struct world *w, uint64_t sums[JOBS], struct fault faults[JOBS])
{
    for (uint64_t i = 0; i < JOBS; i++)
        sched_submit(w->sched, &w->flow[0], make_job(w, i + 1));
    for (int i = 0; i < JOBS; i++) {
        struct job *j = next_done(w);
        sums[j->id - 1] = j->finished ? checksum(j) : 0;
        faults[j->id - 1] = j->fault;
        assert_true(j->finished == (j->fault.code == FAULT_NONE));
        job_destroy(j);
    }
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
    for (int at = 0; at < JOBS; at++) {
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

static void wait_until(const _Atomic int *what, int value, const char *name)
{
    for (int i = 0; i < 60000 && *what != value; i++)
        poll(NULL, 0, 1);
    if (*what != value)
        fail_msg("%s is %d, not %d, after a minute", name, *what, value);
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
    sched_submit(w.sched, &w.flow[0], make_job(&w, 1));
    sched_submit(w.sched, &w.flow[2], make_job(&w, 2));
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
    sched_submit(w.sched, &w.flow[0], make_job(&w, 100));
    job_destroy(next_done(&w));
    struct job *block = make_job(&w, 99);
    sched_submit(w.sched, &w.flow[0], block);
    for (uint64_t i = 0; i < 4; i++)
        sched_submit(w.sched, &w.flow[0], make_job(&w, 10 + i));
    for (uint64_t i = 0; i < 2; i++)
        sched_submit(w.sched, &w.flow[1], make_job(&w, 20 + i));
    for (uint64_t i = 0; i < 2; i++)
        sched_submit(w.sched, &w.flow[2], make_job(&w, 30 + i));
    uint64_t order[9];
    int place[3] = { 0 };
    for (int i = 0; i < 9; i++) {
        struct job *j = next_done(&w);
        order[i] = j->id;
        if (j->id == 11 || j->id == 20 || j->id == 31)
            place[j->id == 11 ? 0 : j->id == 20 ? 1 : 2] = i;
        job_destroy(j);
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
            sched_submit(w.sched, &w.flow[i % 3], jobs[i]);
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
            job_destroy(j);
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

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_turns),
        cmocka_unit_test(test_warm_when_idle),
        cmocka_unit_test(test_cancel_anywhere),
        cmocka_unit_test(test_device_lost_once),
        cmocka_unit_test(test_device_lost_again),
        cmocka_unit_test(test_device_dead),
        cmocka_unit_test(test_device_hangs),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
