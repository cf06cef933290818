// SPDX-License-Identifier: Apache-2.0
// test_server_assets.c - a real daemon's kept images, plans, and the sources of raw pictures, over a real socket.
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "daemon_fixture.h"

enum { SIDE = 32, IMAGE_BYTES = SIDE * SIDE * 12, CREDIT_WAIT_MS = 60000 };

static struct daemon the_daemon;

static int start(void **state)
{
    (void)state;
    // Room for two of the pictures here, and a bit.
    daemon_start(&the_daemon, (const char *const[]){ "--max-frame-bytes", "2M", "--asset-bytes", "25K", NULL });
    return 0;
}

static int stop(void **state)
{
    (void)state;
    assert_int_equal(daemon_stop(&the_daemon, SIGTERM), 0);
    return 0;
}

static uint8_t *picture_file(uint32_t width, uint32_t height, uint32_t seed, size_t *bytes)
{
    struct picture p = picture_make(width, height, 40, seed);
    uint8_t *file = picture_exr(&p, bytes);
    picture_free(&p);
    return file;
}

static struct airy_asset send_picture(struct airy *a, uint32_t seed)
{
    struct airy_asset kept;
    struct airy_error e;
    size_t bytes;
    uint8_t *file = picture_file(SIDE, SIDE, seed, &bytes);
    if (airy_asset(a, -1, file, bytes, &kept, &e) < 0)
        fail_msg("%s: %s", e.symbol, e.text);
    free(file);
    assert_int_equal(strlen(kept.digest), 32);
    assert_int_equal(kept.width, SIDE);
    assert_int_equal(kept.height, SIDE);
    return kept;
}

// A small frame with one parameter. NULL: it failed as *e says.
static struct airy_result *bloom_with(struct airy *a, const char *name, const char *value, bool plan,
                                      struct airy_error *e)
{
    struct picture p = picture_make(96, 64, 60, 4);
    struct airy_request r = AIRY_REQUEST_INIT;
    struct airy_result *result = NULL;
    size_t bytes;
    uint64_t id;
    uint8_t *file = picture_exr(&p, &bytes);
    r.data = file;
    r.size = bytes;
    r.plan_only = plan;
    if (name)
        assert_int_equal(airy_request_param(&r, name, value, e), 0);
    if (airy_submit(a, &r, &id, e) < 0)
        fail_msg("submit: %s", e->text);
    airy_wait(a, id, 60000, &result, e);
    free(file);
    picture_free(&p);
    return result;
}

static void expect_no_asset(struct airy *a, const char *name, const char *value, const char *field)
{
    struct airy_error e;
    struct airy_result *r = bloom_with(a, name, value, false, &e);
    if (r)
        fail_msg("%s=%s was taken", name, value);
    if (strcmp(e.symbol, "NO_ASSET") || e.code != 223 || strcmp(e.field, field))
        fail_msg("%s %d, field %s: %s", e.symbol, e.code, e.field, e.text);
    assert_non_null(strstr(e.text, "send it first"));
}

static void expect_result(struct airy *a, const char *name, const char *value)
{
    struct airy_error e;
    struct airy_result *r = bloom_with(a, name, value, false, &e);
    if (!r)
        fail_msg("%s: %s (%s)", e.symbol, e.text, e.field);
    assert_true(r->size > 0);
    airy_result_free(r);
}

// ---- images ------------------------------------------------------------------------------------------

// However the bytes come, they are one image.
static void test_every_way_in(void **state)
{
    (void)state;
    struct airy *a = daemon_join(&the_daemon);
    struct airy_asset sent = send_picture(a, 1), again;
    struct airy_error e;
    size_t bytes;
    uint8_t *file = picture_file(SIDE, SIDE, 1, &bytes);
    int memfd = make_memfd(file, bytes, F_SEAL_SHRINK);
    assert_int_equal(airy_asset(a, memfd, NULL, 0, &again, &e), 0);
    assert_string_equal(again.digest, sent.digest);
    char path[] = "/tmp/airyd-test-asset-XXXXXX";
    int plain = mkstemp(path);
    assert_int_equal(write(plain, file, bytes), bytes);
    assert_int_equal(airy_asset(a, plain, NULL, 0, &again, &e), 0);
    assert_string_equal(again.digest, sent.digest);
    close(memfd);
    close(plain);
    unlink(path);
    free(file);
    airy_close(a);
}

static void test_requests_name_it(void **state)
{
    (void)state;
    struct airy *a = daemon_join(&the_daemon), *b = daemon_join(&the_daemon);
    expect_no_asset(a, "dirt", "0123456789abcdef0123456789abcdef", "params.dirt");
    expect_no_asset(a, "psf", "image:0123456789abcdef0123456789abcdef", "params.psf");
    struct airy_asset kept = send_picture(a, 2);
    expect_result(a, "dirt", kept.digest);
    expect_result(b, "dirt", kept.digest); // another connection's, too
    airy_close(a);
    airy_close(b);
}

static void test_the_oldest_goes(void **state)
{
    (void)state;
    struct airy *a = daemon_join(&the_daemon);
    struct airy_asset first = send_picture(a, 11), second = send_picture(a, 12);
    expect_result(a, "dirt", first.digest);
    send_picture(a, 13); // in the place of the second
    expect_result(a, "dirt", first.digest);
    expect_no_asset(a, "dirt", second.digest, "params.dirt");
    send_picture(a, 12);
    expect_result(a, "dirt", second.digest);
    airy_close(a);
}

static void expect_refused(struct airy *a, const void *data, size_t bytes, const char *symbol, const char *says)
{
    struct airy_asset kept;
    struct airy_error e;
    if (airy_asset(a, -1, data, bytes, &kept, &e) == 0)
        fail_msg("taken, %s was expected", symbol);
    if (strcmp(e.symbol, symbol) || !strstr(e.text, says))
        fail_msg("%s: %s (%s)", e.symbol, e.text, e.field);
}

static void test_what_is_no_image(void **state)
{
    (void)state;
    struct airy *a = daemon_join(&the_daemon);
    size_t bytes;
    uint8_t *file = picture_file(64, 64, 3, &bytes);
    expect_refused(a, file, bytes, "EXR_TOO_LARGE", "64 x 64");
    free(file);
    expect_refused(a, "hello", 5, "NOT_EXR", "");
    struct picture p = picture_make(SIDE, SIDE, 40, 3);
    p.pixels[(2 * SIDE + 30) * 4 + 2] = half_of(-0.25f);
    file = picture_exr(&p, &bytes);
    expect_refused(a, file, bytes, "EXR_UNSUPPORTED", "channel B at x 30, y 2 is -0.25");
    expect_refused(a, file, bytes - 100, "EXR_DAMAGED", "");
    free(file);
    picture_free(&p);
    send_picture(a, 3); // and the daemon is none the worse
    airy_close(a);
}

// ---- messages ----------------------------------------------------------------------------------------

static uint64_t credit_until(struct peer *p, uint64_t bytes)
{
    struct conn_message m;
    struct fault f;
    uint64_t got = 0;
    while (got < bytes && peer_next(p, &m, CREDIT_WAIT_MS) > 0) {
        assert_int_equal(m.header.type, WIRE_CREDIT);
        got += ((Airy__Credit *)body_unpack(&airy__credit__descriptor, m.body, m.header.body_bytes, &p->arena, &f))->bytes;
    }
    return got;
}

static void test_messages(void **state)
{
    (void)state;
    struct peer p;
    struct conn_message m;
    struct fault f;
    Airy__Payload input = AIRY__PAYLOAD__INIT;
    size_t bytes;
    uint8_t *file = picture_file(SIDE, SIDE, 21, &bytes);
    peer_hello(&p, &the_daemon);
    input.kind = AIRY__PAYLOAD__KIND__INLINE;
    input.size = bytes;
    peer_asset(&p, 9, &input, -1);
    peer_data(&p, 9, file, bytes);
    peer_expect(&p, &m, WIRE_ASSET_KEPT, 9);
    Airy__AssetKept *k = body_unpack(&airy__asset_kept__descriptor, m.body, m.header.body_bytes, &p.arena, &f);
    assert_int_equal(k->width, SIDE);
    assert_int_equal(credit_until(&p, bytes), bytes);

    // Half an upload, cancelled; what still comes means nothing; the id is free again.
    peer_asset(&p, 9, &input, -1);
    peer_data(&p, 9, file, bytes / 2);
    peer_cancel(&p, 9);
    peer_expect(&p, &m, WIRE_CANCELLED, 9);
    assert_int_equal(credit_until(&p, bytes), bytes);
    peer_data(&p, 9, file, 100);
    peer_asset(&p, 9, &input, -1);
    peer_asset(&p, 9, &input, -1);
    peer_expect_error(&p, 9, FAULT_DUPLICATE_ID, "id");
    assert_int_equal(credit_until(&p, bytes), bytes); // the second one's
    peer_data(&p, 9, file, bytes);
    peer_expect(&p, &m, WIRE_ASSET_KEPT, 9);
    assert_int_equal(credit_until(&p, bytes), bytes);

    peer_asset(&p, 10, NULL, -1);
    peer_expect_error(&p, 10, FAULT_PAYLOAD, "input.kind");
    input.kind = AIRY__PAYLOAD__KIND__MEMFD;
    peer_asset(&p, 11, &input, -1); // no descriptor came with it
    peer_expect_error(&p, 11, FAULT_PAYLOAD, "input.fd");
    int fd = make_memfd(file, bytes, 0);
    peer_asset(&p, 12, &input, fd);
    peer_expect_error(&p, 12, FAULT_PAYLOAD_SEALS, "input.fd");
    input.kind = AIRY__PAYLOAD__KIND__INLINE;
    peer_asset(&p, 13, &input, fd); // ... and here one too many
    peer_expect_error(&p, 13, FAULT_PAYLOAD, "input.fd");
    input.size = UINT64_C(1) << 40;
    peer_asset(&p, 14, &input, -1);
    peer_expect_error(&p, 14, FAULT_LIMIT, "input.size");
    input.size = bytes;
    peer_asset(&p, 15, &input, -1);
    peer_data(&p, 15, file, bytes - 1);
    peer_data(&p, 15, file, 2);
    peer_expect_error(&p, 15, FAULT_PAYLOAD, "input.size");
    assert_true(peer_status(&p)->clients >= 1);
    close(fd);
    peer_asset(&p, 0, &input, -1);
    peer_expect_error(&p, 0, FAULT_UNEXPECTED, "id");
    peer_expect_closed(&p);
    peer_close(&p);
    free(file);
}

// ---- plans -------------------------------------------------------------------------------------------

static void test_plan_is_what_runs(void **state)
{
    (void)state;
    struct airy *a = daemon_join(&the_daemon);
    struct airy_error e;
    static const char psf[] = "gaussians:sigma=2/9,weight=.3/.1";
    struct airy_result *plan = bloom_with(a, "psf", psf, true, &e);
    if (!plan)
        fail_msg("%s: %s", e.symbol, e.text);
    struct airy_result *done = bloom_with(a, "psf", psf, false, &e);
    assert_non_null(done);
    assert_null(plan->data);
    assert_int_equal(plan->size, 0);
    assert_int_equal(plan->fd, -1);
    assert_int_equal(plan->n_targets, 1);
    const struct airy_target *p = &plan->targets[0], *d = &done->targets[0];
    assert_int_equal(p->width, 96);
    assert_int_equal(p->height, 64);
    assert_string_equal(p->name, d->name);
    assert_string_equal(p->plan, d->plan);
    assert_string_equal(p->rule, d->rule);
    assert_int_equal(p->levels, d->levels);
    assert_true(p->error_bound > 0 && p->error_bound < 1e-3);
    assert_true(p->storage[0]);
    assert_true(p->energy_input == 0 && d->energy_input > 0); // nothing was looked at
    assert_string_equal(plan->device, done->device);
    airy_result_free(plan);
    airy_result_free(done);
    assert_null(bloom_with(a, "tolerance", "7", true, &e));
    assert_string_equal(e.field, "params.tolerance");
    airy_close(a);
}

static void test_plan_messages(void **state)
{
    (void)state;
    struct peer p;
    struct conn_message m;
    struct fault f;
    size_t bytes;
    uint8_t *file = picture_file(96, 64, 4, &bytes);
    Airy__Payload input = AIRY__PAYLOAD__INIT;
    Airy__Output output = AIRY__OUTPUT__INIT;
    Airy__Bloom b = AIRY__BLOOM__INIT;
    peer_hello(&p, &the_daemon);
    input.kind = AIRY__PAYLOAD__KIND__INLINE;
    input.size = bytes;
    output.kind = AIRY__OUTPUT__KIND__MEMFD; // not looked at
    b.input = &input;
    b.output = &output;
    b.plan_only = true;
    peer_bloom(&p, 5, &b, NULL, 0);
    peer_data(&p, 5, file, bytes);
    peer_expect(&p, &m, WIRE_RESULT, 5);
    assert_int_equal(m.header.n_fds, 0);
    Airy__Result *r = body_unpack(&airy__result__descriptor, m.body, m.header.body_bytes, &p.arena, &f);
    assert_int_equal(r->output->kind, AIRY__PAYLOAD__KIND__NONE);
    assert_int_equal(r->output->size, 0);
    assert_int_equal(r->n_targets, 1);
    assert_true(r->targets[0]->plan[0] && !r->targets[0]->energy && !r->targets[0]->nonfinite);
    // A descriptor for the output is one too many.
    int fd = make_memfd(NULL, 4096, F_SEAL_SHRINK);
    output.kind = AIRY__OUTPUT__KIND__BUFFER;
    peer_bloom(&p, 6, &b, &fd, 1);
    peer_expect_error(&p, 6, FAULT_PAYLOAD, "input.fd");
    peer_bloom(&p, 7, &b, NULL, 0);
    peer_data(&p, 7, "not an EXR file, that is", bytes < 24 ? bytes : 24);
    peer_cancel(&p, 7);
    peer_expect(&p, &m, WIRE_CANCELLED, 7);
    close(fd);
    peer_close(&p);
    free(file);
}

// ---- raw pictures with a source ------------------------------------------------------------------------

static struct airy_error raw_fails(struct airy *a, const char *name, const char *value)
{
    static float pixels[8 * 4 * 4];
    struct airy_request r = AIRY_REQUEST_INIT;
    struct airy_error e = { .text = "" };
    struct airy_result *result = NULL;
    uint64_t id;
    static const char *const names[] = { "R", "G", "B", "lamps.R" };
    r.data = pixels;
    r.size = sizeof pixels;
    r.width = 8;
    r.height = 4;
    r.type = AIRY_FLOAT;
    r.n_channels = 4;
    for (unsigned c = 0; c < 4; c++)
        r.channels[c] = (struct airy_channel){ names[c], 4 * c, 8 * 16, 16 };
    assert_int_equal(airy_request_param(&r, name, value, &e), 0);
    assert_int_equal(airy_submit(a, &r, &id, &e), 0);
    assert_int_equal(airy_wait(a, id, 60000, &result, &e), -1);
    return e;
}

static void test_raw_sources(void **state)
{
    (void)state;
    struct airy *a = daemon_join(&the_daemon);
    struct airy_error e = raw_fails(a, "source", "lamps"); // R is there, G is not
    assert_string_equal(e.symbol, "LAYOUT");
    assert_string_equal(e.field, "params.source");
    assert_non_null(strstr(e.text, "lamps.G"));
    e = raw_fails(a, "matte", "cut");
    assert_string_equal(e.symbol, "LAYOUT");
    assert_string_equal(e.field, "params.matte");
    e = raw_fails(a, "layers", "bloom");
    assert_string_equal(e.symbol, "PARAM_CONFLICT");
    assert_string_equal(e.field, "params.layers");
    e = raw_fails(a, "grow", "4");
    assert_string_equal(e.symbol, "PARAM_CONFLICT");
    assert_string_equal(e.field, "params.grow");
    airy_close(a);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_every_way_in),     cmocka_unit_test(test_requests_name_it),
        cmocka_unit_test(test_the_oldest_goes),  cmocka_unit_test(test_what_is_no_image),
        cmocka_unit_test(test_messages),         cmocka_unit_test(test_plan_is_what_runs),
        cmocka_unit_test(test_plan_messages),    cmocka_unit_test(test_raw_sources),
    };
    return cmocka_run_group_tests(tests, start, stop);
}
