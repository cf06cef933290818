// SPDX-License-Identifier: Apache-2.0
// test_libairy.c - libairy with good peers: replies in every order and form.
#include "airy_peer.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

// ---- good peers ------------------------------------------------------------------------------------

static void a_handshake_tells_who_and_what(void **state)
{
    (void)state;
    struct peer p = { .credit_bytes = 12345678 };
    struct airy *a = open_peer(&p, script_handshake);
    assert_string_equal(airy_server(a), "peer/1");
    assert_string_equal(airy_device(a), "test device");
    assert_int_equal(airy_limits(a)->credit_bytes, 12345678);
    assert_int_equal(airy_limits(a)->max_frame_bytes, BIG_BYTES);
    assert_int_equal(airy_limits(a)->max_requests, 64);
    assert_true(airy_fd(a) >= 0);
    assert_int_equal(airy_events(a), POLLIN);
    struct airy_error e;
    uint64_t id = 99;
    assert_int_equal(airy_pump(a, &e), 0);
    assert_int_equal(airy_wait_any(a, -1, &id, NULL, &e), -1); // not for ever: there is nothing
    assert_int_equal(e.code, -ENOENT);
    assert_int_equal(id, 0);
    assert_int_equal(airy_wait(a, 77, -1, NULL, &e), -1);
    assert_int_equal(e.code, -ENOENT);
    assert_int_equal(airy_cancel(a, 77, &e), 0);
    close_peer(&p, a);
    airy_close(NULL);
    airy_result_free(NULL);
}

// Sends 8 MB of result before it reads a byte of the 20 MB upload: both must keep reading.
static void script_both_ways(struct peer *p)
{
    peer_welcome(p);
    uint64_t id = peer_bloom(p);
    uint8_t *out = malloc(8000000), *in = malloc(BIG_BYTES), *expected = malloc(BIG_BYTES);
    must(out && in && expected);
    fill(out, 8000000, 7);
    fill(expected, BIG_BYTES, 3);
    must(conn_send_data(p->conn, id, out, 8000000, NULL, NULL) == 0);
    peer_flush(p);
    size_t got = 0;
    while (got < BIG_BYTES) {
        struct conn_message m = peer_next(p, WIRE_DATA);
        must(m.header.id == id && m.header.body_bytes <= BIG_BYTES - got);
        memcpy(in + got, m.body, m.header.body_bytes);
        got += m.header.body_bytes;
    }
    must(!memcmp(in, expected, BIG_BYTES));
    peer_result(p, id, AIRY__PAYLOAD__KIND__INLINE, 0, 8000000, -1);
    free(out);
    free(in);
    free(expected);
    peer_until_closed(p);
}

static void large_inline_both_ways_at_once(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_both_ways);
    uint8_t *data = malloc(BIG_BYTES + 5), *expected = malloc(8000000);
    fill(data + 5, BIG_BYTES, 3);
    fill(expected, 8000000, 7);
    struct airy_request r = inline_request(data, BIG_BYTES);
    r.offset = 5;
    uint64_t id = submit(a, &r);
    struct airy_result *res;
    struct airy_error e = { .text = "" };
    assert_int_equal(airy_wait(a, id, 0, &res, &e), 0);
    if (airy_wait(a, id, 20000, &res, &e) != 1)
        fail_msg("%s", e.text);
    assert_int_equal(res->size, 8000000);
    assert_memory_equal(res->data, expected, 8000000);
    airy_result_free(res);
    free(data);
    free(expected);
    close_peer(&p, a);
}

static void script_reverse(struct peer *p)
{
    peer_welcome(p);
    uint64_t ids[16];
    for (unsigned i = 0; i < 16; i++) {
        ids[i] = peer_bloom(p);
        peer_next(p, WIRE_DATA);
    }
    for (unsigned i = 16; i--;) {
        char text[32];
        snprintf(text, sizeof(text), "result %u", i);
        peer_result_text(p, ids[i], text);
    }
    peer_until_closed(p);
}

static void pipelined_replies_in_any_order(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_reverse);
    uint64_t ids[16];
    for (unsigned i = 0; i < 16; i++)
        ids[i] = submit_text(a, "some frame");
    for (unsigned i = 0; i < 8; i++) {
        char text[32];
        snprintf(text, sizeof(text), "result %u", i);
        expect_text(a, ids[i], text);
    }
    for (unsigned i = 16; i-- > 8;) { // in the order in which they ended
        uint64_t id;
        struct airy_result *res;
        assert_int_equal(airy_wait_any(a, 10000, &id, &res, NULL), 1);
        assert_true(id == ids[i] && res->id == id);
        airy_result_free(res);
    }
    struct airy_error e;
    assert_int_equal(airy_wait(a, ids[0], 0, NULL, &e), -1); // reported once
    assert_int_equal(e.code, -ENOENT);
    close_peer(&p, a);
}

static void script_event_loop(struct peer *p)
{
    peer_welcome(p);
    uint64_t id = peer_bloom(p);
    usleep(50000); // the client fills the socket meanwhile
    for (size_t got = 0; got < BIG_BYTES;)
        got += peer_next(p, WIRE_DATA).header.body_bytes;
    peer_result_text(p, id, "loop");
    peer_until_closed(p);
}

static void an_event_loop_needs_only_poll_and_pump(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_event_loop);
    uint8_t *data = calloc(1, BIG_BYTES);
    struct airy_request r = inline_request(data, BIG_BYTES);
    uint64_t id = submit(a, &r), any = 0;
    struct airy_result *res = NULL;
    struct airy_error e;
    bool wrote = false;
    int n;
    while ((n = airy_wait_any(a, 0, &any, &res, &e)) == 0) {
        wrote |= airy_events(a) & POLLOUT;
        struct pollfd w = { .fd = airy_fd(a), .events = airy_events(a) };
        assert_int_equal(poll(&w, 1, 10000), 1);
        assert_int_equal(airy_pump(a, &e), 0);
    }
    assert_int_equal(n, 1);
    assert_true(wrote && any == id);
    assert_memory_equal(res->data, "loop", 4);
    airy_result_free(res);
    free(data);
    close_peer(&p, a);
}

static void send_full_result(struct peer *p, uint64_t id, int fd)
{
    Airy__Payload output = AIRY__PAYLOAD__INIT;
    output.kind = AIRY__PAYLOAD__KIND__MEMFD;
    output.offset = 5000;
    output.size = 3000;
    Airy__Energy energy = AIRY__ENERGY__INIT;
    energy.input = 1;
    energy.bright = 2;
    energy.bloomed = 3;
    energy.lost = 4;
    Airy__NonFinite bad = AIRY__NON_FINITE__INIT;
    bad.nan = 5;
    bad.any = 1;
    bad.first_x = -6;
    bad.first_channel = (char *)"G";
    Airy__Target first = AIRY__TARGET__INIT, second = AIRY__TARGET__INIT,
                 *targets[] = { &first, &second };
    first.name = (char *)"left";
    first.plan = (char *)"a plan";
    first.rule = (char *)"R3";
    first.min_x = -7;
    first.width = 1920;
    first.error_bound = 0.25;
    first.energy = &energy;
    first.nonfinite = &bad;
    first.saturated = 8;
    second.untouched = 1;
    Airy__StageTimes ms = AIRY__STAGE_TIMES__INIT;
    ms.queue = 1;
    ms.load = 2;
    ms.decode = 3;
    ms.bloom = 4;
    ms.encode = 5;
    ms.total = 15;
    char *notes[] = { (char *)"note one", (char *)"note two" };
    Airy__Result r = AIRY__RESULT__INIT;
    r.output = &output;
    r.targets = targets;
    r.n_targets = 2;
    r.ms = &ms;
    r.device = (char *)"dev";
    r.chunks = 9;
    r.chunks_copied = 8;
    r.notes = notes;
    r.n_notes = 2;
    r.exposure = -1.5;
    must(body_send(p->conn, WIRE_RESULT, id, &r.base, &fd, 1) == 0);
    peer_flush(p);
}

static void script_memfds(struct peer *p)
{
    peer_welcome(p);
    uint8_t data[8000];
    fill(data, sizeof(data), 1);
    send_full_result(p, peer_bloom(p),
                     memfd_of(data, sizeof(data), F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_WRITE));
    send_full_result(p, peer_bloom(p), memfd_of(data, sizeof(data), F_SEAL_SHRINK));
    send_full_result(p, peer_bloom(p), memfd_of(data, sizeof(data), F_SEAL_GROW)); // may shrink
    send_full_result(p, peer_bloom(p), memfd_of(data, 7999, F_SEAL_SHRINK));       // too short
    send_full_result(p, peer_bloom(p), open("/dev/null", O_RDONLY | O_CLOEXEC));   // no memfd
    uint64_t id = peer_bloom(p);
    peer_result(p, id, AIRY__PAYLOAD__KIND__MEMFD, 4096, UINT64_MAX - 100,
                memfd_of(data, 8000, F_SEAL_SHRINK));
    id = peer_bloom(p);
    peer_result(p, id, AIRY__PAYLOAD__KIND__MEMFD, 0, 100, -1); // none came
    id = peer_bloom(p);
    peer_result(p, id, AIRY__PAYLOAD__KIND__INLINE, 0, 0, -1); // not what was asked for
    id = peer_bloom(p);
    peer_result(p, id, AIRY__PAYLOAD__KIND__MEMFD, 8000, 0,
                memfd_of(data, 8000, F_SEAL_SHRINK)); // empty
    peer_until_closed(p);
}

static void expect_full_result(struct airy *a, uint64_t id)
{
    uint8_t data[8000];
    fill(data, sizeof(data), 1);
    struct airy_result *res;
    struct airy_error e = { .text = "" };
    if (airy_wait(a, id, 10000, &res, &e) != 1)
        fail_msg("%s", e.text);
    assert_true(res->fd >= 0);
    assert_int_equal(res->size, 3000);
    assert_memory_equal(res->data, data + 5000, 3000);
    assert_int_equal(res->n_targets, 2);
    const struct airy_target *t = &res->targets[0];
    assert_string_equal(t->name, "left");
    assert_string_equal(t->plan, "a plan");
    assert_string_equal(t->rule, "R3");
    assert_true(t->min_x == -7 && t->width == 1920 && t->error_bound == 0.25 && t->saturated == 8);
    assert_true(t->energy_input == 1 && t->energy_bright == 2 && t->energy_bloomed == 3 &&
                t->energy_lost == 4);
    assert_true(t->nan == 5 && t->any_nonfinite && t->first_x == -6 && !t->untouched);
    assert_string_equal(t->first_channel, "G");
    assert_true(res->targets[1].untouched && res->targets[1].energy_input == 0);
    assert_string_equal(res->targets[1].first_channel, "");
    assert_true(res->ms.queue == 1 && res->ms.load == 2 && res->ms.decode == 3 && res->ms.bloom == 4);
    assert_true(res->ms.encode == 5 && res->ms.total == 15);
    assert_string_equal(res->device, "dev");
    assert_true(res->chunks == 9 && res->chunks_copied == 8 && res->exposure == -1.5);
    assert_int_equal(res->n_notes, 2);
    assert_string_equal(res->notes[1], "note two");
    airy_result_free(res);
}

static void memfd_results_are_mapped_when_they_are_safe(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_memfds);
    struct airy_request r = inline_request("x", 1);
    r.inline_output = false;
    int file = memfd_of("frame", 5, F_SEAL_SHRINK);
    r.data = NULL;
    r.input_fd = file;
    r.size = 0;
    uint64_t ids[9];
    for (unsigned i = 0; i < 9; i++)
        ids[i] = submit(a, &r);
    close(file);
    expect_full_result(a, ids[0]);
    expect_full_result(a, ids[1]);
    for (unsigned i = 2; i < 8; i++) {
        struct airy_error e = expect_failure(a, ids[i], "LOCAL");
        assert_int_equal(e.code, -EPROTO);
        assert_memory_equal(e.field, "output", 6);
    }
    struct airy_result *res;
    assert_int_equal(airy_wait(a, ids[8], 10000, &res, NULL), 1);
    assert_int_equal(res->size, 0);
    airy_result_free(res);
    close_peer(&p, a);
}

static void script_errors(struct peer *p)
{
    peer_welcome(p);
    uint64_t a = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    uint64_t b = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    peer_fault(p, b, FAULT_BUSY, "", "too much");
    peer_fault(p, a, FAULT_PARAM_RANGE, "params.sigma", "sigma is -1");
    peer_result_text(p, peer_bloom(p), "still fine");
    peer_next(p, WIRE_DATA);
    uint64_t c = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    peer_bloom(p);
    peer_fault(p, c, FAULT_BAD_BODY, "body", "cannot be decoded"); // a code that closes
    peer_until_closed(p);
}

static void error_replies_are_mapped(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_errors);
    uint64_t first = submit_text(a, "1"), second = submit_text(a, "2"), failed;
    struct airy_error e;
    assert_int_equal(airy_wait_any(a, 10000, &failed, NULL, &e), -1);
    assert_true(failed == second && e.code == FAULT_BUSY && e.retryable && e.retry_after_ms == 250);
    e = expect_failure(a, first, "PARAM_RANGE");
    assert_int_equal(e.code, 201);
    assert_string_equal(e.field, "params.sigma");
    assert_string_equal(e.text, "sigma is -1");
    assert_false(e.retryable);
    expect_text(a, submit_text(a, "3"), "still fine");
    uint64_t third = submit_text(a, "4");
    uint64_t fourth = submit_text(a, "5");
    e = expect_failure(a, third, "BAD_BODY");
    e = expect_failure(a, fourth, "BAD_BODY"); // the connection went with it
    assert_int_equal(airy_fd(a), -1);
    assert_int_equal(airy_events(a), 0);
    assert_int_equal(airy_pump(a, &e), -1);
    assert_int_equal(e.code, FAULT_BAD_BODY);
    close_peer(&p, a);
}

static void script_cancel(struct peer *p)
{
    peer_welcome(p);
    uint64_t a = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    uint64_t b = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    must(peer_next(p, WIRE_CANCEL).header.id == a);
    must(peer_next(p, WIRE_CANCEL).header.id == a);
    must(peer_next(p, WIRE_CANCEL).header.id == b);
    peer_send(p, WIRE_CANCELLED, a, NULL);
    peer_result_text(p, b, "too late");
    peer_until_closed(p);
}

static void cancel_ends_a_request_or_not(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_cancel);
    uint64_t first = submit_text(a, "1"), second = submit_text(a, "2");
    assert_int_equal(airy_cancel(a, first, NULL), 0);
    assert_int_equal(airy_cancel(a, first, NULL), 0);
    assert_int_equal(airy_cancel(a, second, NULL), 0);
    struct airy_error e = expect_failure(a, first, "CANCELLED");
    assert_int_equal(e.code, -ECANCELED);
    expect_text(a, second, "too late");
    close_peer(&p, a);
}

static void script_credit(struct peer *p)
{
    peer_welcome(p);
    uint64_t a = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    must(wait_readable(p, 100) == 0); // the second waits for credit
    peer_credit(p, 30);
    must(wait_readable(p, 100) == 0); // not enough yet
    peer_result_text(p, a, "one");
    must(wait_readable(p, 100) == 0);
    peer_credit(p, 50);
    uint64_t b = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    peer_result_text(p, b, "two");
    peer_until_closed(p);
}

static void submit_waits_for_credit(void **state)
{
    (void)state;
    struct peer p = { .credit_bytes = 100 };
    struct airy *a = open_peer(&p, script_credit);
    char data[101] = "";
    struct airy_request r = inline_request(data, 80);
    uint64_t first = submit(a, &r), second = submit(a, &r);
    expect_text(a, second, "two");
    expect_text(a, first, "one");
    r.size = 101;
    struct airy_error e;
    uint64_t id;
    assert_int_equal(airy_submit(a, &r, &id, &e), -1);
    assert_int_equal(e.code, -EFBIG);
    assert_string_equal(e.field, "input.size");
    close_peer(&p, a);
}

static void script_max_requests(struct peer *p)
{
    peer_welcome(p);
    uint64_t ids[3];
    for (unsigned i = 0; i < 2; i++) {
        ids[i] = peer_bloom(p);
        peer_next(p, WIRE_DATA);
    }
    must(wait_readable(p, 100) == 0);
    peer_result_text(p, ids[1], "b");
    ids[2] = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    peer_result_text(p, ids[2], "c");
    peer_result_text(p, ids[0], "a");
    peer_until_closed(p);
}

static void submit_waits_for_a_free_request(void **state)
{
    (void)state;
    struct peer p = { .max_requests = 2 };
    struct airy *a = open_peer(&p, script_max_requests);
    uint64_t ids[3];
    for (unsigned i = 0; i < 3; i++)
        ids[i] = submit_text(a, "frame");
    expect_text(a, ids[0], "a");
    expect_text(a, ids[1], "b");
    expect_text(a, ids[2], "c");
    close_peer(&p, a);
}

static void script_progress(struct peer *p)
{
    peer_welcome(p);
    struct conn_message m = peer_next(p, WIRE_BLOOM);
    uint64_t id = m.header.id;
    Airy__Bloom *b = peer_body(p, &m, &airy__bloom__descriptor);
    must(b->progress);
    peer_next(p, WIRE_DATA);
    static const char *const stages[] = { "queued", "decode", "bloom", "encode" };
    for (unsigned i = 0; i < 4; i++) {
        Airy__Progress s = AIRY__PROGRESS__INIT;
        s.stage = (char *)stages[i];
        s.fraction = 0.25 * i;
        peer_send(p, WIRE_PROGRESS, id, &s.base);
        peer_send(p, WIRE_PROGRESS, id + 100, &s.base); // of a request that has ended: ignored
    }
    peer_result_text(p, id, "done");
    peer_until_closed(p);
}

struct progress_seen {
    unsigned n;
    uint64_t id;
    char stages[64];
    double last;
};

static void see_progress(void *ctx, uint64_t id, const char *stage, double fraction)
{
    struct progress_seen *s = ctx;
    s->n++;
    s->id = id;
    strcat(s->stages, stage);
    s->last = fraction;
}

static void progress_is_called_back(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct progress_seen seen = { .n = 0 };
    struct airy *a = open_peer(&p, script_progress);
    struct airy_request r = inline_request("f", 1);
    r.progress = see_progress;
    r.progress_ctx = &seen;
    uint64_t id = submit(a, &r);
    expect_text(a, id, "done");
    assert_int_equal(seen.n, 4);
    assert_true(seen.id == id && seen.last == 0.75);
    assert_string_equal(seen.stages, "queueddecodebloomencode");
    close_peer(&p, a);
}

// Busy for a second.
static void script_chatter(struct peer *p)
{
    peer_welcome(p);
    uint64_t id = peer_bloom(p);
    Airy__Progress s = AIRY__PROGRESS__INIT;
    char stage[60001]; // long, so that the socket is never empty for long
    memset(stage, 'b', 60000);
    stage[60000] = 0;
    s.stage = stage;
    struct timespec start, now;
    clock_gettime(CLOCK_MONOTONIC, &start);
    do {
        for (unsigned i = 0; i < 50; i++)
            peer_send(p, WIRE_PROGRESS, id, &s.base);
        clock_gettime(CLOCK_MONOTONIC, &now);
    } while ((now.tv_sec - start.tv_sec) * 1000 + (now.tv_nsec - start.tv_nsec) / 1000000 < 1000);
    peer_result_text(p, id, "at last");
    peer_until_closed(p);
}

static void a_busy_peer_does_not_stretch_a_timeout(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_chatter);
    uint64_t id = submit_text(a, "frame");
    unsigned timeouts = 0;
    struct airy_result *res = NULL;
    int n;
    while ((n = airy_wait(a, id, 20, &res, NULL)) == 0)
        timeouts++;
    assert_int_equal(n, 1);
    assert_true(timeouts >= 5); // some 50, if the machine is not busy
    airy_result_free(res);
    close_peer(&p, a);
}

static void script_status(struct peer *p)
{
    peer_welcome(p);
    uint64_t id = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    uint64_t late = peer_next(p, WIRE_STATUS).header.id;
    uint64_t asked = peer_next(p, WIRE_STATUS).header.id;
    must(late != asked);
    Airy__Device device = AIRY__DEVICE__INIT;
    device.name = (char *)"dev";
    device.kind = (char *)"cpu, and a text that is far too long for its place";
    Airy__StageTimes ms = AIRY__STAGE_TIMES__INIT;
    ms.total = 9;
    Airy__StatusReply s = AIRY__STATUS_REPLY__INIT;
    s.server = (char *)"late";
    peer_send(p, WIRE_STATUS_REPLY, late, &s.base);
    peer_result_text(p, id, "meanwhile");
    s.server = (char *)"peer/1";
    s.device = &device;
    s.uptime_s = 1.5;
    s.clients = 2;
    s.queued = 3;
    s.running = 4;
    s.done = 5;
    s.failed = 6;
    s.cancelled = 7;
    s.pixels = 8;
    s.bytes_in = 9;
    s.bytes_out = 10;
    s.rss_bytes = 11;
    s.mean_ms = &ms;
    s.draining = 1;
    peer_send(p, WIRE_STATUS_REPLY, asked, &s.base);
    peer_until_closed(p);
}

static void status_comes_beside_requests(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_status);
    uint64_t id = submit_text(a, "frame");
    struct airy_status s;
    struct airy_error e = { .text = "" };
    assert_int_equal(airy_status(a, &s, 50, &e), -1);
    assert_int_equal(e.code, -ETIMEDOUT);
    if (airy_status(a, &s, 10000, &e) < 0)
        fail_msg("%s", e.text);
    assert_string_equal(s.server, "peer/1");
    assert_string_equal(s.device, "dev");
    assert_string_equal(s.device_kind, "cpu, an");
    assert_true(s.uptime_s == 1.5 && s.clients == 2 && s.queued == 3 && s.running == 4 && s.done == 5);
    assert_true(s.failed == 6 && s.cancelled == 7 && s.pixels == 8 && s.bytes_in == 9 &&
                s.bytes_out == 10);
    assert_true(s.rss_bytes == 11 && s.mean_ms.total == 9 && s.draining);
    expect_text(a, id, "meanwhile");
    close_peer(&p, a);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_handshake_tells_who_and_what),
        cmocka_unit_test(large_inline_both_ways_at_once),
        cmocka_unit_test(pipelined_replies_in_any_order),
        cmocka_unit_test(an_event_loop_needs_only_poll_and_pump),
        cmocka_unit_test(memfd_results_are_mapped_when_they_are_safe),
        cmocka_unit_test(error_replies_are_mapped),
        cmocka_unit_test(cancel_ends_a_request_or_not),
        cmocka_unit_test(submit_waits_for_credit),
        cmocka_unit_test(submit_waits_for_a_free_request),
        cmocka_unit_test(progress_is_called_back),
        cmocka_unit_test(a_busy_peer_does_not_stretch_a_timeout),
        cmocka_unit_test(status_comes_beside_requests),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
