// SPDX-License-Identifier: Apache-2.0
// test_libairy_asset.c - airy_asset and plans with a scripted peer: what is sent, what comes back, and daemons that
// answer what was not asked.
#include "airy_peer.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <string.h>
#include <unistd.h>

static const char digest[] = "0123456789abcdef0123456789abcdef";

static void send_kept(struct peer *p, uint64_t id, const char *text)
{
    Airy__AssetKept k = AIRY__ASSET_KEPT__INIT;
    k.digest = (char *)text;
    k.width = 640;
    k.height = 360;
    peer_send(p, WIRE_ASSET_KEPT, id, &k.base);
}

static uint64_t take_asset(struct peer *p, unsigned n_fds, Airy__Payload *input)
{
    struct conn_message m = peer_next(p, WIRE_ASSET);
    must(m.header.n_fds == n_fds && m.header.id);
    for (unsigned i = 0; i < m.header.n_fds; i++)
        close(m.fds[i]);
    uint64_t id = m.header.id;
    *input = *((Airy__Asset *)peer_body(p, &m, &airy__asset__descriptor))->input;
    return id;
}

static void script_keeps(struct peer *p)
{
    Airy__Payload input;
    peer_welcome(p);
    uint64_t frame = peer_bloom(p);
    peer_next(p, WIRE_DATA); // the frame's
    uint64_t id = take_asset(p, 0, &input);
    must(input.kind == AIRY__PAYLOAD__KIND__INLINE && input.size == 5);
    struct conn_message m = peer_next(p, WIRE_DATA);
    must(m.header.id == id && m.header.body_bytes == 5 && !memcmp(m.body, "image", 5));
    peer_result_text(p, frame, "meanwhile");
    send_kept(p, id, digest);
    peer_credit(p, 5);

    id = take_asset(p, 1, &input);
    must(input.kind == AIRY__PAYLOAD__KIND__FILE && input.size == 9 && input.offset == 0 && input.fd == 0);
    send_kept(p, id, digest);
    id = take_asset(p, 1, &input);
    must(input.kind == AIRY__PAYLOAD__KIND__MEMFD);
    peer_fault(p, id, FAULT_EXR_UNSUPPORTED, "input", "no");
    peer_until_closed(p);
}

static void images_are_sent_beside_frames(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_keeps);
    struct airy_asset kept = { .width = 1 };
    struct airy_error e = { .text = "" };
    uint64_t frame = submit_text(a, "frame");
    if (airy_asset(a, -1, "image", 5, &kept, &e) < 0)
        fail_msg("%s", e.text);
    assert_string_equal(kept.digest, digest);
    assert_int_equal(kept.width, 640);
    assert_int_equal(kept.height, 360);
    expect_text(a, frame, "meanwhile"); // was not lost
    char path[] = "/tmp/test_libairy_XXXXXX";
    int file = mkstemp(path), memfd = memfd_of("12345", 5, F_SEAL_SHRINK);
    unlink(path);
    assert_int_equal(ftruncate(file, 9), 0);
    assert_int_equal(airy_asset(a, file, NULL, 0, &kept, &e), 0);
    close(file);
    kept.width = 7;
    assert_int_equal(airy_asset(a, memfd, NULL, 0, &kept, &e), -1);
    assert_string_equal(e.symbol, "EXR_UNSUPPORTED");
    assert_int_equal(kept.width, 7); // untouched
    close(memfd);
    // Refused here.
    assert_int_equal(airy_asset(a, -1, NULL, 0, &kept, &e), -1);
    assert_string_equal(e.field, "input");
    assert_int_equal(airy_asset(a, 0, "x", 1, &kept, &e), -1);
    assert_int_equal(airy_asset(a, 250, NULL, 0, &kept, NULL), -1);
    struct airy_result *none;
    assert_int_equal(airy_wait_any(a, 0, NULL, &none, &e), -1); // an image is never waited for by others
    assert_int_equal(e.code, -ENOENT);
    close_peer(&p, a);
}

// ---- plans -------------------------------------------------------------------------------------------

static void script_plan(struct peer *p)
{
    peer_welcome(p);
    struct conn_message m = peer_next(p, WIRE_BLOOM);
    must(m.header.n_fds == 0);
    uint64_t id = m.header.id;
    Airy__Bloom *b = peer_body(p, &m, &airy__bloom__descriptor);
    must(b->plan_only && !b->output);
    peer_next(p, WIRE_DATA);
    Airy__Payload none = AIRY__PAYLOAD__INIT;
    Airy__Target target = AIRY__TARGET__INIT, *targets[] = { &target };
    Airy__Result r = AIRY__RESULT__INIT;
    target.name = (char *)"beauty";
    target.plan = (char *)"R9";
    target.storage = (char *)"half";
    target.skipped = (char *)"nothing";
    target.exposure = -1.5;
    target.predicted_ms = 12.25;
    r.output = &none;
    r.targets = targets;
    r.n_targets = 1;
    peer_send(p, WIRE_RESULT, id, &r.base);
    id = peer_bloom(p); // and one with output, that it must not have
    peer_result(p, id, AIRY__PAYLOAD__KIND__MEMFD, 0, 2, memfd_of("ok", 2, F_SEAL_SHRINK));
    peer_until_closed(p);
}

static void a_plan_has_facts_and_no_data(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_plan);
    struct airy_request r = inline_request("frame", 5);
    struct airy_result *res = NULL;
    struct airy_error e = { .text = "" };
    r.plan_only = true;
    r.output_fd = 250; // not looked at
    if (airy_wait(a, submit(a, &r), 10000, &res, &e) != 1)
        fail_msg("%s", e.text);
    assert_null(res->data);
    assert_int_equal(res->fd, -1);
    assert_int_equal(res->n_targets, 1);
    assert_string_equal(res->targets[0].storage, "half");
    assert_string_equal(res->targets[0].skipped, "nothing");
    assert_true(res->targets[0].exposure == -1.5 && res->targets[0].predicted_ms == 12.25);
    assert_string_equal(res->targets[0].first_channel, "");
    airy_result_free(res);
    assert_int_equal(airy_wait(a, submit(a, &r), 10000, &res, &e), -1);
    assert_string_equal(e.field, "output.kind");
    close_peer(&p, a);
}

// ---- bad peers ---------------------------------------------------------------------------------------

static int breach; // set before the peer's thread starts

enum { KEPT_FOR_A_FRAME, RESULT_FOR_AN_IMAGE, DATA_FOR_AN_IMAGE, KEPT_FOR_NOTHING, LONG_DIGEST, NO_BODY, DIES, BREACHES };

static void script_breach(struct peer *p)
{
    static char longest[100];
    Airy__Payload input;
    uint64_t id;
    peer_welcome(p);
    if (breach == KEPT_FOR_A_FRAME)
        id = peer_bloom(p);
    else
        id = take_asset(p, 0, &input);
    memset(longest, 'f', sizeof longest - 1);
    switch (breach) {
    case RESULT_FOR_AN_IMAGE: peer_result(p, id, AIRY__PAYLOAD__KIND__NONE, 0, 0, -1); break;
    case DATA_FOR_AN_IMAGE:
        must(conn_send(p->conn, WIRE_DATA, id, "x", 1, NULL, 0) == 0);
        peer_flush(p);
        break;
    case KEPT_FOR_NOTHING: send_kept(p, id + 1, digest); break;
    case LONG_DIGEST: send_kept(p, id, longest); break;
    case NO_BODY:
        must(conn_send(p->conn, WIRE_ASSET_KEPT, id, "\x0a\xff", 2, NULL, 0) == 0);
        peer_flush(p);
        break;
    case DIES: return;
    default: send_kept(p, id, digest); break;
    }
    peer_until_closed(p);
}

static void breaches_lose_the_connection(void **state)
{
    (void)state;
    for (breach = 0; breach < BREACHES; breach++) {
        struct peer p = { 0 };
        struct airy *a = open_peer(&p, script_breach);
        struct airy_error e = { .text = "" };
        struct airy_asset kept;
        if (breach == KEPT_FOR_A_FRAME)
            assert_int_equal(airy_wait(a, submit_text(a, "frame"), 10000, NULL, &e), -1);
        else
            assert_int_equal(airy_asset(a, -1, "image", 5, &kept, &e), -1);
        assert_string_equal(e.symbol, "LOCAL");
        if (!e.text[0] || airy_fd(a) != -1)
            fail_msg("breach %d: \"%s\", descriptor %d", breach, e.text, airy_fd(a));
        close_peer(&p, a);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(images_are_sent_beside_frames),
        cmocka_unit_test(a_plan_has_facts_and_no_data),
        cmocka_unit_test(breaches_lose_the_connection),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
