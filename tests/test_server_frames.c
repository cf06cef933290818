// SPDX-License-Identifier: Apache-2.0
// test_server_frames.c - frames through a real daemon: every way in and out gives the same pixels, whatever
// runs beside it and on how many threads. (What the pixels must be is test_engine.c's question.)
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "daemon_fixture.h"

static const char psf[] = "gaussians:sigma=2/5/14,weight=.3/.2/.1";

static struct daemon the_daemon;

static int start(void **state)
{
    (void)state;
    daemon_start(&the_daemon, (const char *const[]){ "--threads", "2", NULL });
    return 0;
}

static int stop(void **state)
{
    (void)state;
    assert_int_equal(daemon_stop(&the_daemon, SIGTERM), 0);
    return 0;
}

static struct airy_result *bloom(struct airy *a, struct airy_request *r)
{
    struct airy_error e;
    struct airy_result *result = NULL;
    uint64_t id;
    if (!r->n_params)
        assert_int_equal(airy_request_param(r, "psf", psf, &e), 0);
    if (airy_submit(a, r, &id, &e) < 0 || airy_wait(a, id, 60000, &result, &e) != 1)
        fail_msg("%s: %s (%s)", e.symbol, e.text, e.field);
    return result;
}

// Light goes up and nowhere down, alpha stays, something glows around the lamps.
static void check_bloomed(const struct picture *in, const uint16_t *out)
{
    size_t n = (size_t)in->width * in->height, changed = 0;
    for (size_t i = 0; i < n; i++) {
        for (int c = 0; c < 3; c++) {
            float before = float_of(in->pixels[i * 4 + (size_t)c]), after = float_of(out[i * 4 + (size_t)c]);
            if (!(after >= before))
                fail_msg("pixel %zu, %zu channel %d: %g became %g", i % in->width, i / in->width, c,
                         (double)before, (double)after);
            changed += after > before;
        }
        if (in->pixels[i * 4 + 3] != out[i * 4 + 3])
            fail_msg("alpha of pixel %zu, %zu changed", i % in->width, i / in->width);
    }
    assert_true(changed > 1000);
}

static struct airy_request raw_request(const struct picture *p)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    picture_request(p, &r);
    return r;
}

static void check_facts(const struct airy_result *r, const struct picture *p)
{
    assert_int_equal(r->n_targets, 1);
    const struct airy_target *t = &r->targets[0];
    assert_int_equal(t->width, p->width);
    assert_int_equal(t->height, p->height);
    assert_false(t->untouched);
    assert_true(t->plan[0] && t->rule[0] && t->name[0]);
    assert_true(t->error_bound > 0 && t->error_bound < 2e-3);
    assert_true(t->max_bright > 0);
    assert_true(t->energy_input > 0 && t->energy_bright > 0 && t->energy_bloomed > 0);
    assert_int_equal(t->tiles, ((p->width + 63) / 64) * ((p->height + 63) / 64));
    assert_true(t->tiles_bright >= 1 && t->tiles_bright <= t->tiles);
    assert_false(t->any_nonfinite);
    assert_true(r->ms.total > 0 && r->ms.bloom > 0);
    assert_true(r->device[0]);
}

// Interleaved halves by memfd, inline, from a file, into a buffer, and as an EXR file: the same pixels.
static void test_all_ways(void **state)
{
    (void)state;
    struct picture p = picture_make(301, 203, 300, 11);
    size_t bytes = picture_bytes(&p), file_bytes;
    struct airy *a = daemon_join(&the_daemon);

    struct airy_request r = raw_request(&p);
    r.input_fd = make_memfd(p.pixels, bytes, F_SEAL_SHRINK | F_SEAL_WRITE);
    struct airy_result *truth = bloom(a, &r);
    assert_int_equal(truth->size, bytes);
    assert_true(truth->fd >= 0);
    int seals = F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_WRITE | F_SEAL_SEAL;
    assert_int_equal(fcntl(truth->fd, F_GET_SEALS), seals);
    check_bloomed(&p, truth->data);
    check_facts(truth, &p);

    r.inline_output = true;
    struct airy_result *got = bloom(a, &r);
    assert_int_equal(got->size, bytes);
    assert_memory_equal(got->data, truth->data, bytes);
    airy_result_free(got);
    close(r.input_fd);

    r = raw_request(&p);
    r.data = p.pixels;
    r.size = bytes;
    got = bloom(a, &r);
    assert_memory_equal(got->data, truth->data, bytes);
    airy_result_free(got);

    // At an odd place of a file, and into an odd place of a buffer, whose other bytes stay.
    char path[] = "/tmp/airyd-test-raw-XXXXXX";
    int file = mkstemp(path);
    assert_int_equal(pwrite(file, p.pixels, bytes, 7), bytes);
    void *map;
    r = raw_request(&p);
    r.input_fd = file;
    r.offset = 7;
    r.size = bytes;
    r.output_fd = airy_memfd(bytes + 10000, &map, NULL);
    r.output_offset = 5001;
    r.output_size = bytes + 4000;
    memset(map, 0xa5, bytes + 10000);
    got = bloom(a, &r);
    assert_null(got->data);
    assert_memory_equal((uint8_t *)map + 5001, truth->data, bytes);
    for (size_t i = 0; i < bytes + 10000; i++)
        if ((i < 5001 || i >= 5001 + bytes) && ((uint8_t *)map)[i] != 0xa5)
            fail_msg("byte %zu of the buffer was written, the result is 5001 to %zu", i, 5001 + bytes);
    airy_result_free(got);
    munmap(map, bytes + 10000);
    close(r.output_fd);
    close(file);
    unlink(path);

    uint8_t *exr = picture_exr(&p, &file_bytes);
    r = (struct airy_request)AIRY_REQUEST_INIT;
    r.data = exr;
    r.size = file_bytes;
    got = bloom(a, &r);
    check_facts(got, &p);
    struct picture back = picture_from_exr(got->data, got->size);
    assert_int_equal(back.width, p.width);
    assert_int_equal(back.height, p.height);
    assert_memory_equal(back.pixels, truth->data, bytes);
    static const char odd[] = "oddOne\0oddType\0\4\0\0\0kept"; // its NUL is not the file's
    assert_non_null(memmem(got->data, 4096, odd, sizeof odd - 1));
    assert_non_null(memmem(got->data, 4096, "airyd " AIRY_VERSION "; params: ", strlen(AIRY_VERSION) + 16));
    assert_non_null(memmem(got->data, 4096, "; input xxh3:", 13));
    picture_free(&back);
    airy_result_free(got);
    free(exr);
    airy_result_free(truth);
    airy_close(a);
    picture_free(&p);
}

// The picture as planar floats: their exact glow rounds to the halves' within one place.
static void test_planar_float(void **state)
{
    (void)state;
    struct picture p = picture_make(190, 77, 300, 12);
    size_t n = (size_t)p.width * p.height;
    float *in;
    struct airy *a = daemon_join(&the_daemon);
    struct airy_request r = AIRY_REQUEST_INIT;
    r.input_fd = airy_memfd(n * 12, (void **)&in, NULL);
    r.width = p.width;
    r.height = p.height;
    r.type = AIRY_FLOAT;
    r.n_channels = 3;
    for (unsigned c = 0; c < 3; c++) {
        static const char *const names[] = { "B", "G", "R" };
        r.channels[c] = (struct airy_channel){ names[c], n * 4 * c, p.width * 4, 4 };
        for (size_t i = 0; i < n; i++)
            in[n * c + i] = float_of(p.pixels[i * 4 + 2 - c]);
    }
    struct airy_result *floats = bloom(a, &r);
    struct airy_request h = raw_request(&p);
    h.data = p.pixels;
    h.size = picture_bytes(&p);
    struct airy_result *halves = bloom(a, &h);
    const float *f = floats->data;
    const uint16_t *q = halves->data;
    for (size_t i = 0; i < n; i++)
        for (unsigned c = 0; c < 3; c++) {
            float exact = f[n * (2 - c) + i], half = float_of(q[i * 4 + c]);
            float step = (exact < 0 ? -exact : exact) / 1024 + 1e-6f;
            if (!(exact - half <= step && half - exact <= step))
                fail_msg("pixel %zu, %zu channel %u: float %g, half %g", i % p.width, i / p.width, c,
                         (double)exact, (double)half);
        }
    airy_result_free(floats);
    airy_result_free(halves);
    munmap(in, n * 12);
    close(r.input_fd);
    airy_close(a);
    picture_free(&p);
}

// Nothing glows: bit-identical, also what is between the pixels and not a number.
static void test_untouched(void **state)
{
    (void)state;
    struct picture p = picture_make(64, 48, 0.5f, 13);
    p.pixels[5 * 4 + 1] = 0x7e01; // a NaN with a payload
    p.pixels[9 * 4 + 2] = half_of(-3);
    size_t pitch = 64 * 8 + 24, bytes = pitch * 48 + 100;
    uint8_t *in = malloc(bytes);
    for (size_t i = 0; i < bytes; i++)
        in[i] = (uint8_t)(i * 37);
    for (size_t y = 0; y < 48; y++)
        memcpy(in + 16 + y * pitch, p.pixels + y * 64 * 4, 64 * 8);
    struct airy *a = daemon_join(&the_daemon);
    for (int inline_output = 0; inline_output < 2; inline_output++) {
        struct airy_request r = raw_request(&p);
        for (unsigned c = 0; c < 4; c++) {
            r.channels[c].offset += 16;
            r.channels[c].row_stride = pitch;
        }
        r.data = in;
        r.size = bytes;
        r.inline_output = inline_output;
        struct airy_result *got = bloom(a, &r);
        assert_true(got->targets[0].untouched);
        assert_true(got->targets[0].any_nonfinite);
        assert_int_equal(got->targets[0].nan, 1);
        assert_int_equal(got->targets[0].negative, 1);
        assert_int_equal(got->targets[0].first_x, 5);
        assert_int_equal(got->targets[0].first_y, 0);
        assert_string_equal(got->targets[0].first_channel, "G");
        assert_int_equal(got->size, bytes);
        assert_memory_equal(got->data, in, bytes);
        airy_result_free(got);
    }
    free(in);
    airy_close(a);
    picture_free(&p);
}

// ---- many --------------------------------------------------------------------------------------------

enum { PIPELINED = 16 };

// 16 frames of different sizes at once, waited for in another order: each reply is its request's.
static void test_pipelined(void **state)
{
    (void)state;
    struct airy *a = daemon_join(&the_daemon);
    struct picture p[PIPELINED];
    uint64_t id[PIPELINED];
    struct airy_error e;
    for (unsigned i = 0; i < PIPELINED; i++) {
        p[i] = picture_make(100 + 17 * i, 90 + 5 * i, 300, 20 + i);
        struct airy_request r = raw_request(&p[i]);
        r.data = p[i].pixels;
        r.size = picture_bytes(&p[i]);
        r.inline_output = i & 1;
        airy_request_param(&r, "psf", psf, &e);
        if (airy_submit(a, &r, &id[i], &e) < 0)
            fail_msg("%s", e.text);
    }
    for (unsigned k = 0; k < PIPELINED; k++) {
        unsigned i = k * 7 % PIPELINED;
        struct airy_result *r;
        if (airy_wait(a, id[i], 60000, &r, &e) != 1)
            fail_msg("%s: %s", e.symbol, e.text);
        assert_int_equal(r->id, id[i]);
        assert_int_equal(r->targets[0].width, p[i].width);
        assert_int_equal(r->size, picture_bytes(&p[i]));
        check_bloomed(&p[i], r->data);
        airy_result_free(r);
        picture_free(&p[i]);
    }
    airy_close(a);
}

struct worker {
    pthread_t thread;
    const struct daemon *daemon;
    const uint8_t *exr;
    size_t exr_bytes;
    const uint8_t *expected;
    size_t expected_bytes;
    unsigned frames, wrong;
    bool inline_output;
};

static void *worker_main(void *arg)
{
    struct worker *w = arg;
    struct airy *a;
    struct airy_error e;
    w->wrong = w->frames;
    if (airy_connect(&a, w->daemon->path, &e) < 0)
        return NULL;
    for (unsigned i = 0; i < w->frames; i++) {
        struct airy_request r = AIRY_REQUEST_INIT;
        struct airy_result *result;
        uint64_t id;
        r.data = w->exr;
        r.size = w->exr_bytes;
        r.compression = "zip";
        r.inline_output = w->inline_output;
        airy_request_param(&r, "psf", psf, &e);
        if (airy_submit(a, &r, &id, &e) < 0 || airy_wait(a, id, 60000, &result, &e) != 1)
            break;
        if (result->size == w->expected_bytes && !memcmp(result->data, w->expected, result->size))
            w->wrong--;
        airy_result_free(result);
    }
    airy_close(a);
    return NULL;
}

static struct airy_result *zipped(struct airy *a, const uint8_t *exr, size_t bytes)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    r.data = exr;
    r.size = bytes;
    r.compression = "zip";
    return bloom(a, &r);
}

// The same bytes at 1 and 2 threads, with 1 and 3 slots, alone and among four others.
static void test_determinism(void **state)
{
    (void)state;
    enum { CLIENTS = 5 };
    struct picture p = picture_make(640, 360, 800, 31);
    size_t bytes;
    uint8_t *exr = picture_exr(&p, &bytes);
    struct daemon one;
    daemon_start(&one, (const char *const[]){ "--threads", "1", "--slots", "1", NULL });
    struct airy *a = daemon_join(&one);
    struct airy_result *alone = zipped(a, exr, bytes);
    assert_memory_equal(alone->data, exr, 4);
    assert_int_equal(alone->chunks, (360 + 15) / 16);

    struct worker w[CLIENTS];
    for (int i = 0; i < CLIENTS; i++) {
        w[i] = (struct worker){ .daemon = i == 4 ? &one : &the_daemon, .exr = exr, .exr_bytes = bytes,
                                .expected = alone->data, .expected_bytes = alone->size, .frames = 6,
                                .inline_output = i & 1 };
        assert_int_equal(pthread_create(&w[i].thread, NULL, worker_main, &w[i]), 0);
    }
    for (int i = 0; i < CLIENTS; i++)
        pthread_join(w[i].thread, NULL);
    for (int i = 0; i < CLIENTS; i++)
        assert_int_equal(w[i].wrong, 0);
    airy_result_free(alone);
    airy_close(a);
    assert_int_equal(daemon_stop(&one, SIGTERM), 0);
    free(exr);
    picture_free(&p);
}

// A client with one small frame is not kept waiting for another's long queue.
static void test_fair(void **state)
{
    (void)state;
    const uint32_t part = daemon_sanitized() ? 2 : 1;
    struct picture big = picture_make(1920 / part, 1080 / part, 300, 41), small = picture_make(64, 64, 300, 42);
    struct airy *a = daemon_join(&the_daemon), *b = daemon_join(&the_daemon);
    struct airy_error e;
    struct airy_status s;
    struct airy_request r = raw_request(&big);
    uint64_t id[16];
    r.input_fd = make_memfd(big.pixels, picture_bytes(&big), F_SEAL_SHRINK);
    airy_request_param(&r, "psf", psf, &e);
    for (int i = 0; i < 16; i++)
        if (airy_submit(a, &r, &id[i], &e) < 0)
            fail_msg("%s", e.text);
    close(r.input_fd);
    r = raw_request(&small);
    r.data = small.pixels;
    r.size = picture_bytes(&small);
    airy_result_free(bloom(b, &r));
    assert_int_equal(airy_status(b, &s, 10000, &e), 0);
    print_message("the small frame was done with %u of the 16 big ones waiting\n", s.queued);
    assert_true(s.queued >= 4);
    for (int i = 0; i < 16; i++) {
        struct airy_result *result;
        if (airy_wait(a, id[i], 60000, &result, &e) != 1)
            fail_msg("%s: %s", e.symbol, e.text);
        airy_result_free(result);
    }
    airy_close(a);
    airy_close(b);
    picture_free(&big);
    picture_free(&small);
}

// The same frame again and again: memory stays where it is.
static void test_steady(void **state)
{
    (void)state;
    struct picture p = picture_make(512, 512, 300, 51);
    size_t bytes;
    uint8_t *exr = picture_exr(&p, &bytes);
    struct airy *a = daemon_join(&the_daemon);
    struct airy_error e;
    struct airy_status before, after;
    const int frames = daemon_sanitized() ? 30 : 120;
    for (int i = 0; i < frames; i++) {
        airy_result_free(zipped(a, exr, bytes));
        if (i == frames / 3)
            assert_int_equal(airy_status(a, &before, 10000, &e), 0);
    }
    assert_int_equal(airy_status(a, &after, 10000, &e), 0);
    print_message("resident %.1f MiB after a third of %d frames, %.1f after all\n", (double)before.rss_bytes / 1048576.0, frames,
                  (double)after.rss_bytes / 1048576.0);
    if (!daemon_sanitized()) // which keeps freed memory for a while
        assert_true(after.rss_bytes < before.rss_bytes + (8 << 20));
    airy_close(a);
    free(exr);
    picture_free(&p);
}

static void note_progress(void *ctx, uint64_t id, const char *stage, double fraction)
{
    double *last = ctx;
    (void)id;
    assert_true(stage[0] && fraction >= *last && fraction <= 1);
    *last = fraction;
}

static void test_progress(void **state)
{
    (void)state;
    struct picture p = picture_make(800, 600, 300, 61);
    struct airy *a = daemon_join(&the_daemon);
    struct airy_request r = raw_request(&p);
    double last = -1;
    r.data = p.pixels;
    r.size = picture_bytes(&p);
    r.progress = note_progress;
    r.progress_ctx = &last;
    airy_result_free(bloom(a, &r));
    assert_true(last >= 0); // some came
    airy_close(a);
    picture_free(&p);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_all_ways),    cmocka_unit_test(test_planar_float),
        cmocka_unit_test(test_untouched),   cmocka_unit_test(test_pipelined),
        cmocka_unit_test(test_determinism), cmocka_unit_test(test_fair),
        cmocka_unit_test(test_steady),      cmocka_unit_test(test_progress),
    };
    return cmocka_run_group_tests(tests, start, stop);
}
