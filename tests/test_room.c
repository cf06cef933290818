// SPDX-License-Identifier: Apache-2.0
// test_room.c - is what a frame reserves enough for what it allocates? The real engine on the real device; its calls to the allocators are counted
// on their way (-Wl,--wrap): device memory, and the host's. Of every kind of request the most that there was at once is held against what the
// scheduler would have set aside, and what is kept must be gone when it is released.
#include <malloc.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <vulkan/vulkan.h>

#include "bloom.h"
#include "frame.h"
#include "plan.h"
#include "scheduler_private.h"

enum { HELD_MAX = 4096, THREADS = 2, OWN_BYTES = 512 * 1024 }; // OWN: what does not grow with frames: crews, tables of pipelines

static _Atomic int64_t now_bytes, peak_bytes;

static void count(int64_t bytes)
{
    const int64_t now = atomic_fetch_add(&now_bytes, bytes) + bytes;
    int64_t peak = peak_bytes;
    while (now > peak && !atomic_compare_exchange_weak(&peak_bytes, &peak, now))
        ;
}

void *__real_malloc(size_t n);
void *__wrap_malloc(size_t n);
void *__wrap_malloc(size_t n)
{
    void *p = __real_malloc(n);
    count((int64_t)malloc_usable_size(p));
    return p;
}
void *__real_calloc(size_t n, size_t size);
void *__wrap_calloc(size_t n, size_t size);
void *__wrap_calloc(size_t n, size_t size)
{
    void *p = __real_calloc(n, size);
    count((int64_t)malloc_usable_size(p));
    return p;
}
void *__real_realloc(void *p, size_t n);
void *__wrap_realloc(void *p, size_t n);
void *__wrap_realloc(void *p, size_t n)
{
    const int64_t before = (int64_t)malloc_usable_size(p);
    p = __real_realloc(p, n);
    count((int64_t)malloc_usable_size(p) - before);
    return p;
}
void *__real_aligned_alloc(size_t a, size_t n);
void *__wrap_aligned_alloc(size_t a, size_t n);
void *__wrap_aligned_alloc(size_t a, size_t n)
{
    void *p = __real_aligned_alloc(a, n);
    count((int64_t)malloc_usable_size(p));
    return p;
}
void __real_free(void *p);
void __wrap_free(void *p);
void __wrap_free(void *p)
{
    count(-(int64_t)malloc_usable_size(p));
    __real_free(p);
}

static struct {
    VkDeviceMemory memory;
    int64_t bytes;
} held[HELD_MAX];

VkResult __real_vkAllocateMemory(VkDevice d, const VkMemoryAllocateInfo *i, const VkAllocationCallbacks *c, VkDeviceMemory *m);
VkResult __wrap_vkAllocateMemory(VkDevice d, const VkMemoryAllocateInfo *i, const VkAllocationCallbacks *c, VkDeviceMemory *m);
VkResult __wrap_vkAllocateMemory(VkDevice d, const VkMemoryAllocateInfo *i, const VkAllocationCallbacks *c, VkDeviceMemory *m)
{
    VkResult r = __real_vkAllocateMemory(d, i, c, m);
    unsigned at = 0;
    while (r == VK_SUCCESS && held[at].bytes)
        assert_true(++at < HELD_MAX);
    if (r == VK_SUCCESS) {
        held[at].memory = *m;
        held[at].bytes = (int64_t)i->allocationSize;
        count(held[at].bytes);
    }
    return r;
}
void __real_vkFreeMemory(VkDevice d, VkDeviceMemory m, const VkAllocationCallbacks *c);
void __wrap_vkFreeMemory(VkDevice d, VkDeviceMemory m, const VkAllocationCallbacks *c);
void __wrap_vkFreeMemory(VkDevice d, VkDeviceMemory m, const VkAllocationCallbacks *c)
{
    for (unsigned i = 0; i < HELD_MAX; i++)
        if (held[i].bytes && held[i].memory == m) {
            count(-held[i].bytes);
            held[i].bytes = 0;
        }
    __real_vkFreeMemory(d, m, c);
}

static struct bloom *engine;
static float picture[256 * 256 * 3];
static double worst;

static int start(void **state)
{
    (void)state;
    struct fault f;
    const struct bloom_options o = { .slots = 1, .threads = THREADS };
    if (bloom_create(&engine, &o, &f) < 0)
        fail_msg("%s", f.text);
    for (size_t i = 0; i < sizeof picture / sizeof picture[0]; i++)
        picture[i] = 1.0f / (1 + (float)(i % 97));
    return 0;
}

static int stop(void **state)
{
    (void)state;
    bloom_destroy(engine);
    print_message("at most %.1f %% of what was reserved was there\n", 100 * worst);
    return 0;
}

struct kind {
    const char *params; /* "name=value name=value" */
    bool dirt, kernel, matte;
};

static void read_params(struct params *p, const struct kind *k)
{
    char text[256], *save = NULL;
    struct fault f;
    params_init(p);
    snprintf(text, sizeof text, "%s", k->params);
    for (char *word = strtok_r(text, " ", &save); word; word = strtok_r(NULL, " ", &save)) {
        char *value = strchr(word, '=');
        *value = 0;
        if (params_set_text(p, word, value + 1, &f) < 0)
            fail_msg("%s: %s", word, f.text);
    }
    params_look_defaults(p);
    if (params_check(p, &f) < 0)
        fail_msg("%s: %s", k->params, f.text);
}

// One frame from nothing, all of it bright; returns the most bytes that it had at once.
static int64_t run_once(const struct kind *k, const struct params *p, const struct bloom_geometry *g, unsigned targets)
{
    struct planes in[2], out[2 * BLOOM_OUTPUTS_MAX];
    struct frame_scan scan;
    struct fault f;
    struct bloom_reply reply;
    const struct bloom_image image = { .width = 256, .height = 256, .rgb = picture, .digest = "0123456789abcdef0123456789abcdef" };
    struct bloom_request r = { .params = p, .scan = &scan, .source = -1, .matte = k->matte ? 1 : -1, .depth = -1, .source_scan = NULL,
                               .dirt = k->dirt ? &image : NULL, .kernel = k->kernel ? &image : NULL, .luma = { 0.2126f, 0.7152f, 0.0722f },
                               .pixel_aspect = 1, .display_width = g->width };
    uint32_t bits;
    const float bright = 1e4f;
    memcpy(&bits, &bright, sizeof bits);
    assert_int_equal(frame_scan_init(&scan, g->width, g->height), 0);
    for (uint32_t i = 0; i < scan.tiles_x * scan.tiles_y; i++) {
        atomic_store(&scan.tile_luma[i], bits);
        atomic_store(&scan.tile_channel[i], bits);
    }
    r.matte_scan = k->matte ? &scan : NULL;
    const int64_t before = now_bytes;
    peak_bytes = before;
    struct bloom_slot *slot = bloom_slot(engine, 0);
    if (bloom_slot_prepare(engine, slot, targets, g, in, out, &f) < 0)
        fail_msg("%s, %u x %u: %s", k->params, g->width, g->height, f.text);
    for (unsigned c = 0; g->type == PIXEL_TYPE_FLOAT && c < g->channels; c++)
        memcpy(in[0].base[c], &bright, sizeof bright);
    if (bloom_run(engine, slot, 0, &r, &reply, &f) < 0)
        fail_msg("%s, %u x %u: %s: %s", k->params, g->width, g->height, f.field, f.text);
    const int64_t most = peak_bytes - before;
    bloom_slot_release(engine, slot);
    bloom_levels_release(engine);
    frame_scan_finish(&scan);
    return most;
}

static void compare(const struct kind *k, uint32_t width, uint32_t height, unsigned channels, enum pixel_type type, uint32_t grow)
{
    struct params p;
    read_params(&p, k);
    const struct bloom_geometry g[2] = { { width, height, channels, type, grow, 1 + p.layer_count }, { width, height, 1, type, grow, 0 } };
    const unsigned targets = k->matte ? 2 : 1;
    const struct bloom_image image = { .width = 256, .height = 256 };
    const struct bloom_keep_facts facts = { .params = &p, .pixel_aspect = 1, .display_width = width, .matte = k->matte,
                                            .dirt = k->dirt ? &image : NULL, .kernel = k->kernel ? &image : NULL, .threads = THREADS };
    uint64_t keep[BLOOM_KEEPS];
    bloom_keep_bytes(&facts, 1, g, keep);
    uint64_t reserved = room_planes_bytes(targets, g);
    for (unsigned i = 0; i < BLOOM_KEEPS; i++)
        reserved += keep[i];
    run_once(k, &p, g, targets); // its pipelines and plan are there from now on
    const int64_t before = now_bytes, most = run_once(k, &p, g, targets), after = now_bytes;
    if (most > (int64_t)reserved + OWN_BYTES)
        fail_msg("%s, %u x %u + %u, %u channels: %lld bytes at once; %llu were reserved", k->params, width, height, grow, channels, (long long)most,
                 (unsigned long long)reserved);
    if (after > before + 65536)
        fail_msg("%s, %u x %u: %lld bytes are left after the release", k->params, width, height, (long long)(after - before));
    if (most > 8 * OWN_BYTES)
        worst = fmax(worst, (double)most / (double)reserved);
    if (width == 600)
        print_message("%-44s %7.2f of %7.2f MB\n", k->params, 1e-6 * (double)most, 1e-6 * (double)reserved);
}

static void test_reserved(void **state)
{
    (void)state;
    static const struct kind kinds[] = {
        { .params = "threshold=0" },
        { .params = "threshold=0 psf=gaussians:sigma=0.6,weight=0.1" },
        { .params = "threshold=0 psf=gaussians:sigma=1.5/3/6/12/24/48/96,weight=.1/.1/.1/.1/.1/.1/.1 tolerance=1e-5" },
        { .params = "threshold=0 firefly=2 clamp=50 layers=bloom/bright/residual" },
        { .params = "threshold=0 edge=fill" },
        { .params = "threshold=0 edge=fill psf=gaussians:sigma=40,weight=0.1 tolerance=1e-5" },
        { .params = "threshold=0 psf=eye:weight=0.1" },
        { .params = "threshold=0 psf=airy:f=8,pitch=5,weight=0.1" },
        { .params = "threshold=0 psf=aperture:f=8,pitch=5,blades=6,weight=0.1" },
        { .params = "threshold=0 psf=image:0123456789abcdef0123456789abcdef,weight=0.1", .kernel = true },
        { .params = "threshold=0 dirt=0123456789abcdef0123456789abcdef", .dirt = true },
        { .params = "threshold=0 matte=m emission=2", .matte = true },
        { .params = "look=half-gaussian" },
        { .params = "look=mip-chain" },
        { .params = "look=three-scale stages=6" },
        { .params = "look=jimenez" },
        { .params = "look=airy-eight" },
        { .params = "look=airy-eight matte=m", .matte = true },
    };
    for (size_t i = 0; i < sizeof kinds / sizeof kinds[0]; i++) {
        const bool looks = !strncmp(kinds[i].params, "look", 4), fills = strstr(kinds[i].params, "edge=fill");
        // Pipelines are what takes time here: of one type and number of channels.
        compare(&kinds[i], 600, 400, 3, PIXEL_TYPE_FLOAT, 0);
        compare(&kinds[i], 7, 300, 3, PIXEL_TYPE_FLOAT, 0);
        if (i % 4 == 0)
            compare(&kinds[i], 500, 7, 1, PIXEL_TYPE_HALF, 0);
        if (!looks && !fills)
            compare(&kinds[i], 200, 150, 3, PIXEL_TYPE_FLOAT, 50);
    }
}

// A plan's reach depends on its rule and tolerance; what is set aside for edge=fill must cover each.
static void test_fill(void **state)
{
    (void)state;
    static const char *const tolerances[] = { "0.1", "1e-2", "1e-3", "1e-4", "1e-5" };
    double most = 0;
    for (unsigned i = 0; i < sizeof tolerances / sizeof tolerances[0]; i++)
        for (double sigma = 0.3; sigma < 400; sigma *= 1.11)
            for (double aspect = 0.5; aspect < 2.1; aspect *= 2) {
                char text[128];
                struct params p;
                struct plan plan;
                struct fault f;
                const struct bloom_geometry g = { 1000, 800, 3, PIXEL_TYPE_FLOAT, 0, 1 };
                const struct plan_facts facts = { 1000, 800, 1000, 3, aspect, -1 };
                const struct bloom_keep_facts keep = { .params = &p, .pixel_aspect = aspect, .display_width = 1000 };
                snprintf(text, sizeof text, "edge=fill psf=gaussians:sigma=%.4g,weight=0.1 tolerance=%s", sigma, tolerances[i]);
                read_params(&p, &(struct kind){ .params = text });
                if (plan_make(&plan, &p, p.tolerance, &facts, &f) < 0)
                    continue; // out of range in pixels
                const uint64_t pad = (plan_reach(&plan) + 15) / 16 * 16, set_aside = bloom_pad_most(&keep, &g);
                if (pad > set_aside)
                    fail_msg("%s, aspect %g: %llu pixels around; %llu were thought of", text, aspect, (unsigned long long)pad,
                             (unsigned long long)set_aside);
                if (sigma > 8)
                    most = fmax(most, (double)pad / sigma / fmax(1, 1 / aspect));
            }
    print_message("edge=fill reaches %.1f sigmas at most\n", most);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_fill), cmocka_unit_test(test_reserved) };
    return cmocka_run_group_tests(tests, start, stop);
}
