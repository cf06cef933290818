// SPDX-License-Identifier: Apache-2.0
// test_asset.c - the kept images: what becomes of a file, who is thrown out, and who never is.
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "daemon_fixture.h"

#include "asset.h"

enum { SIDE = 16, IMAGE_BYTES = SIDE * SIDE * 12 };

static struct exr_limits limits = { 4096, 4096, 1 << 24, 1 << 28 };
static const _Atomic bool never = false;

struct world {
    struct asset_cache cache;
    struct exr_worker *worker;
};

static void open_world(struct world *w, uint64_t bytes_max)
{
    asset_cache_init(&w->cache, bytes_max);
    assert_int_equal(exr_worker_create(&w->worker), 0);
}

static void close_world(struct world *w)
{
    exr_worker_destroy(w->worker);
    asset_cache_finish(&w->cache);
}

static int keep_picture(struct world *w, const struct picture *p, struct asset **out, struct fault *f)
{
    size_t bytes;
    uint8_t *file = picture_exr(p, &bytes);
    int rc = asset_keep(&w->cache, file, bytes, &limits, w->worker, &never, out, f);
    free(file);
    return rc;
}

// Picture number n, kept; NULL when there was no room.
static struct asset *keep(struct world *w, uint32_t n)
{
    struct picture p = picture_make(SIDE, SIDE, 40, n);
    struct asset *a = NULL;
    struct fault f = { .code = FAULT_NONE };
    if (keep_picture(w, &p, &a, &f) < 0)
        assert_int_equal(f.code, FAULT_BUSY);
    picture_free(&p);
    return a;
}

static void test_pixels(void **state)
{
    (void)state;
    struct world w;
    struct asset *a, *again;
    struct fault f = { .text = "" };
    open_world(&w, 1 << 20);
    struct picture p = picture_make(37, 21, 300, 5);
    if (keep_picture(&w, &p, &a, &f) < 0)
        fail_msg("%s", f.text);
    assert_int_equal(a->image.width, 37);
    assert_int_equal(a->image.height, 21);
    for (size_t i = 0; i < 37 * 21; i++)
        for (size_t c = 0; c < 3; c++)
            assert_true(a->image.rgb[i * 3 + c] == float_of(p.pixels[i * 4 + c]));
    assert_int_equal(strlen(a->image.digest), 32);
    // The same upload is the same image.
    assert_int_equal(keep_picture(&w, &p, &again, &f), 0);
    assert_ptr_equal(again, a);
    assert_int_equal(w.cache.bytes, 37 * 21 * 12);
    assert_ptr_equal(asset_find(&w.cache, a->image.digest), a);
    assert_null(asset_find(&w.cache, "00000000000000000000000000000000"));
    for (int i = 0; i < 3; i++)
        asset_release(&w.cache, a);
    picture_free(&p);
    close_world(&w);
}

// Known answers of xxh3-128, seed 0: of nothing, and of the five bytes "hello".
static void test_digest(void **state)
{
    (void)state;
    char digest[ASSET_DIGEST_MAX];
    asset_digest(digest, "", 0);
    assert_string_equal(digest, "99aa06d3014798d86001c324468d497f");
    asset_digest(digest, "hello", 5);
    assert_string_equal(digest, "b5e9c1ad071b3e7fc779cfaa5e523818");
}

static void test_bad_samples(void **state)
{
    (void)state;
    static const struct { uint16_t half; const char *says; } bad[] = {
        { 0x7e00, "is nan" }, { 0x7c00, "is inf" }, { 0xfc00, "is -inf" }, { 0xb800, "is -0.5" },
    };
    struct world w;
    open_world(&w, 1 << 20);
    for (unsigned i = 0; i < 4; i++) {
        struct picture p = picture_make(SIDE, SIDE, 40, 9);
        struct asset *a = NULL;
        struct fault f = { .code = FAULT_NONE };
        p.pixels[(3 * SIDE + 5) * 4 + 1] = bad[i].half;
        p.pixels[(7 * SIDE + 1) * 4] = bad[i].half; // a later one is not the first
        assert_int_equal(keep_picture(&w, &p, &a, &f), -1);
        assert_int_equal(f.code, FAULT_EXR_UNSUPPORTED);
        if (!strstr(f.text, "channel G at x 5, y 3") || !strstr(f.text, bad[i].says))
            fail_msg("%s", f.text);
        picture_free(&p);
    }
    assert_int_equal(w.cache.bytes, 0); // what was reserved came back
    close_world(&w);
}

static void test_too_large(void **state)
{
    (void)state;
    struct world w;
    struct asset *a = NULL;
    struct fault f = { .code = FAULT_NONE };
    struct picture p = picture_make(SIDE, SIDE + 1, 40, 1);
    open_world(&w, IMAGE_BYTES);
    assert_int_equal(keep_picture(&w, &p, &a, &f), -1);
    assert_int_equal(f.code, FAULT_EXR_TOO_LARGE);
    assert_string_equal(f.field, "input");
    picture_free(&p);
    assert_non_null(a = keep(&w, 1)); // exactly the ceiling
    asset_release(&w.cache, a);
    close_world(&w);
}

static bool is_kept(struct world *w, const char *digest)
{
    struct asset *a = asset_find(&w->cache, digest);
    asset_release(&w->cache, a);
    return a != NULL;
}

static void test_least_recently_used_goes(void **state)
{
    (void)state;
    struct world w;
    char digest[4][ASSET_DIGEST_MAX];
    open_world(&w, 3 * IMAGE_BYTES + 5);
    for (uint32_t i = 0; i < 3; i++) {
        struct asset *a = keep(&w, i);
        memcpy(digest[i], a->image.digest, ASSET_DIGEST_MAX);
        asset_release(&w.cache, a);
    }
    assert_true(is_kept(&w, digest[0])); // asked for: 1 is the oldest now
    struct asset *fourth = keep(&w, 3);
    memcpy(digest[3], fourth->image.digest, ASSET_DIGEST_MAX);
    asset_release(&w.cache, fourth);
    assert_false(is_kept(&w, digest[1]));
    assert_true(is_kept(&w, digest[0]) && is_kept(&w, digest[2]) && is_kept(&w, digest[3]));
    assert_int_equal(w.cache.bytes, 3 * IMAGE_BYTES);
    close_world(&w);
}

static void test_in_use_stays(void **state)
{
    (void)state;
    struct world w;
    open_world(&w, 2 * IMAGE_BYTES);
    struct asset *a = keep(&w, 0), *b = keep(&w, 1);
    float first = a->image.rgb[0];
    assert_null(keep(&w, 2)); // BUSY
    assert_int_equal(w.cache.bytes, 2 * IMAGE_BYTES);
    asset_release(&w.cache, b);
    struct asset *c = keep(&w, 2); // b's place
    assert_non_null(c);
    assert_true(a->image.rgb[0] == first && is_kept(&w, a->image.digest));
    asset_release(&w.cache, a);
    asset_release(&w.cache, c);
    close_world(&w);
}

static void test_cancelled(void **state)
{
    (void)state;
    struct world w;
    struct asset *a;
    struct fault f;
    const _Atomic bool cancelled = true;
    struct picture p = picture_make(SIDE, SIDE, 40, 1);
    size_t bytes;
    uint8_t *file = picture_exr(&p, &bytes);
    open_world(&w, 1 << 20);
    assert_int_equal(asset_keep(&w.cache, file, bytes, &limits, w.worker, &cancelled, &a, &f), 0);
    assert_null(a);
    assert_int_equal(w.cache.bytes, 0);
    free(file);
    picture_free(&p);
    close_world(&w);
}

// ---- many threads on a small cache -------------------------------------------------------------------

static struct asset_cache *shared;

static void *hammer(void *arg)
{
    uint32_t seed = (uint32_t)(uintptr_t)arg;
    struct exr_worker *worker;
    if (exr_worker_create(&worker))
        abort();
    for (int i = 0; i < 200; i++) {
        struct picture p = picture_make(SIDE, SIDE, 40, (seed = seed * 1664525u + 1013904223u) >> 30);
        size_t bytes;
        uint8_t *file = picture_exr(&p, &bytes);
        struct asset *a = NULL;
        struct fault f = { .code = FAULT_NONE };
        if (asset_keep(shared, file, bytes, &limits, worker, &never, &a, &f) < 0) {
            if (f.code != FAULT_BUSY)
                abort();
        } else {
            for (size_t n = 0; n < SIDE * SIDE; n++) // nobody takes it away meanwhile
                if (a->image.rgb[n * 3] != float_of(p.pixels[n * 4]))
                    abort();
            asset_release(shared, a);
        }
        free(file);
        picture_free(&p);
    }
    exr_worker_destroy(worker);
    return NULL;
}

static void test_threads(void **state)
{
    (void)state;
    struct asset_cache cache;
    pthread_t thread[3];
    asset_cache_init(&cache, 2 * IMAGE_BYTES);
    shared = &cache;
    for (uintptr_t i = 0; i < 3; i++)
        assert_int_equal(pthread_create(&thread[i], NULL, hammer, (void *)(i + 1)), 0);
    for (unsigned i = 0; i < 3; i++)
        pthread_join(thread[i], NULL);
    unsigned n = 0;
    struct asset *a;
    TAILQ_FOREACH(a, &cache.list, link)
    {
        assert_int_equal(a->references, 0);
        n++;
    }
    assert_int_equal(cache.bytes, n * IMAGE_BYTES);
    assert_true(n >= 1 && n <= 2);
    asset_cache_finish(&cache);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_pixels),       cmocka_unit_test(test_digest),
        cmocka_unit_test(test_bad_samples),  cmocka_unit_test(test_too_large),
        cmocka_unit_test(test_least_recently_used_goes),
        cmocka_unit_test(test_in_use_stays), cmocka_unit_test(test_cancelled),
        cmocka_unit_test(test_threads),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
