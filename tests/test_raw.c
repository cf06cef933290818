// SPDX-License-Identifier: Apache-2.0
// test_raw.c - raw layouts: what raw_check lets through is checked against a map of every byte, and what it
// lets through goes in and out unchanged. Random layouts, seeded.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "raw.h"

static uint32_t seed;
static uint32_t random_below(uint32_t n) { return (seed = seed * 1664525u + 1013904223u) / 65536 % n; }

static const char *const names[] = { "R", "G", "B", "A", "Z" };

// Planar, interleaved, row by row, or wild.
static void make_layout(struct raw_layout *l)
{
    memset(l, 0, sizeof *l);
    l->width = 1 + random_below(9);
    l->height = 1 + random_below(7);
    l->type = random_below(2) ? PIXEL_TYPE_HALF : PIXEL_TYPE_FLOAT;
    l->count = 3 + random_below(3);
    uint64_t bytes = pixel_bytes(l->type), w = l->width, h = l->height, n = l->count;
    uint32_t kind = random_below(4), pad = random_below(3);
    for (unsigned i = 0; i < n; i++) {
        struct raw_channel *c = &l->channel[i];
        strcpy(c->name, names[i]);
        if (kind == 0)
            *c = (struct raw_channel){ .offset = i * w * h * bytes, .row_stride = w * bytes, .pixel_stride = bytes };
        else if (kind == 1)
            *c = (struct raw_channel){ .offset = i * bytes, .row_stride = (w * n + pad) * bytes,
                                       .pixel_stride = n * bytes };
        else if (kind == 2)
            *c = (struct raw_channel){ .offset = i * (w + pad) * bytes, .row_stride = (w + pad) * n * bytes,
                                       .pixel_stride = bytes };
        else
            *c = (struct raw_channel){ .offset = random_below(200) * bytes,
                                       .row_stride = random_below(60) * bytes,
                                       .pixel_stride = random_below(6) * bytes };
        strcpy(c->name, names[i]);
        if (random_below(40) == 0) // one thing is off
            c->offset += random_below(20);
    }
}

enum { ROOM = 4096 };

// By brute force: every byte of every sample inside, and none twice.
static bool truly_fine(const struct raw_layout *l, uint64_t bytes)
{
    static uint8_t used[1 << 16];
    memset(used, 0, sizeof used);
    for (unsigned i = 0; i < l->count; i++)
        for (uint64_t y = 0; y < l->height; y++)
            for (uint64_t x = 0; x < l->width; x++)
                for (unsigned b = 0; b < pixel_bytes(l->type); b++) {
                    uint64_t at = l->channel[i].offset + y * l->channel[i].row_stride +
                                  x * l->channel[i].pixel_stride + b;
                    if (at >= bytes || used[at]++)
                        return false;
                }
    return true;
}

static void round_trip(struct raw_layout *l, uint64_t bytes)
{
    static const float luma[3] = { 0.2126f, 0.7152f, 0.0722f };
    uint8_t in[ROOM], out[ROOM];
    struct planes planes;
    struct frame_scan scan;
    for (uint64_t i = 0; i < bytes; i++)
        in[i] = (uint8_t)random_below(256);
    memset(out, 0x5a, sizeof out);
    assert_int_equal(planes_alloc(&planes, l->width, l->height, l->target[0].planes, l->type), 0);
    assert_int_equal(frame_scan_init(&scan, l->width, l->height), 0);
    l->band = 1 + random_below(l->height); // bands of any size
    for (unsigned t = raw_tasks(l); t-- > 0;)
        raw_decode(l, &l->target[0], in, &planes, &scan, luma, t);
    for (unsigned t = raw_tasks(l); t-- > 0;)
        assert_int_equal(raw_encode(l, in, &planes, out, t), 0);
    uint64_t samples = 0;
    for (uint64_t i = 0; i < bytes; i++)
        samples += out[i] == in[i];
    for (unsigned i = 0; i < l->count; i++)
        for (uint64_t y = 0; y < l->height; y++)
            for (uint64_t x = 0; x < l->width; x++) {
                uint64_t at =
                    l->channel[i].offset + y * l->channel[i].row_stride + x * l->channel[i].pixel_stride;
                if (memcmp(in + at, out + at, pixel_bytes(l->type)))
                    fail_msg("channel %s of %u x %u: pixel %llu, %llu changed", l->channel[i].name, l->width,
                             l->height, (unsigned long long)x, (unsigned long long)y);
            }
    for (uint64_t i = bytes; i < ROOM; i++)
        assert_int_equal(out[i], 0x5a);
    assert_true(!l->dense || samples == bytes);
    frame_scan_finish(&scan);
    planes_free(&planes);
}

static void test_random_layouts(void **state)
{
    (void)state;
    unsigned taken = 0, refused_good = 0;
    for (uint32_t i = 0; i < 20000; i++) {
        struct raw_layout l;
        struct fault f;
        seed = i;
        make_layout(&l);
        uint64_t bytes = 1 + random_below(i % 2 ? 900 : 2500);
        if (raw_check(&l, bytes, &f) == 0) {
            taken++;
            if (!truly_fine(&l, bytes))
                fail_msg("seed %u: taken, though samples overlap or lie outside", i);
            round_trip(&l, bytes);
            continue;
        }
        assert_int_equal(f.code, FAULT_LAYOUT);
        assert_true(!strncmp(f.field, "raw.", 4));
        // The usual arrangements must never be refused for nothing.
        bool aligned = true;
        for (unsigned c = 0; c < l.count; c++)
            aligned &= l.channel[c].offset % pixel_bytes(l.type) == 0;
        refused_good += aligned && truly_fine(&l, bytes);
    }
    print_message("%u layouts taken, %u odd ones refused that would have been possible\n", taken, refused_good);
    assert_true(taken > 3000);
    assert_true(refused_good < 400);
}

static void test_extremes(void **state)
{
    (void)state;
    static const uint64_t big[] = { UINT64_MAX, UINT64_MAX - 3, (uint64_t)1 << 63, (uint64_t)1 << 32, UINT32_MAX - 3 };
    for (size_t i = 0; i < 5; i++)
        for (int what = 0; what < 3; what++) {
            struct raw_layout l = { .width = 16384, .height = 16384, .type = PIXEL_TYPE_FLOAT, .count = 1 };
            l.channel[0] = (struct raw_channel){ .name = "Y", .row_stride = 65536, .pixel_stride = 4 };
            struct fault f;
            assert_int_equal(raw_check(&l, (uint64_t)1 << 30, &f), 0);
            *(what == 0   ? &l.channel[0].offset
              : what == 1 ? &l.channel[0].row_stride
                          : &l.channel[0].pixel_stride) = big[i] & ~(uint64_t)3;
            assert_int_equal(raw_check(&l, (uint64_t)1 << 30, &f), -1);
            assert_int_equal(f.code, FAULT_LAYOUT);
        }
}

// FLOAT planes into a HALF picture: held at 65504 and counted.
static void test_saturation(void **state)
{
    (void)state;
    struct raw_layout l = { .width = 3000, .height = 1, .type = PIXEL_TYPE_HALF, .count = 1 };
    struct fault f;
    struct planes p;
    uint16_t out[3000];
    l.channel[0] = (struct raw_channel){ .name = "Y", .row_stride = 6000, .pixel_stride = 2 };
    assert_int_equal(raw_check(&l, sizeof out, &f), 0);
    assert_int_equal(planes_alloc(&p, 3000, 1, 1, PIXEL_TYPE_FLOAT), 0);
    float *row = (float *)(void *)planes_row(&p, 0, 0);
    for (int x = 0; x < 3000; x++)
        row[x] = x % 3 ? 1.0f : 1e6f;
    assert_int_equal(raw_encode(&l, NULL, &p, (uint8_t *)out, 0), 1000);
    for (int x = 0; x < 3000; x++)
        assert_int_equal(out[x], x % 3 ? 0x3c00 : 0x7bff);
    planes_free(&p);
}

// One interleaved picture with everything that a glow may need: who is which, and what is in their planes.
static void test_sources(void **state)
{
    (void)state;
    static const char *const all[] = { "R", "G", "B", "A", "lamps.B", "lamps.G", "lamps.R", "cut", "Z" };
    enum { WIDTH = 5, HEIGHT = 3, COUNT = 9 };
    struct raw_layout l = { .width = WIDTH, .height = HEIGHT, .type = PIXEL_TYPE_HALF, .count = COUNT };
    uint16_t in[HEIGHT][WIDTH][COUNT];
    struct fault f;
    for (unsigned c = 0; c < COUNT; c++) {
        strcpy(l.channel[c].name, all[c]);
        l.channel[c].offset = 2 * c;
        l.channel[c].pixel_stride = 2 * COUNT;
        l.channel[c].row_stride = 2 * COUNT * WIDTH;
    }
    for (unsigned i = 0; i < HEIGHT * WIDTH * COUNT; i++)
        ((uint16_t *)in)[i] = (uint16_t)(0x3c00 + i);
    assert_int_equal(raw_check(&l, sizeof in, &f), 0);
    assert_int_equal(l.targets, 1);
    assert_int_equal(raw_find(&l, RAW_SOURCE), -1);
    l.source = "lamps";
    l.matte = "cut";
    l.depth = true;
    assert_int_equal(raw_check(&l, sizeof in, &f), 0);
    assert_int_equal(l.targets, 4);
    static const unsigned channels[RAW_ROLES][3] = { { 0, 1, 2 }, { 6, 5, 4 }, { 7 }, { 8 } };
    for (unsigned role = RAW_SCENE; role < RAW_ROLES; role++) {
        const struct raw_target *t = &l.target[raw_find(&l, (enum raw_role)role)];
        struct planes p;
        assert_int_equal(t->planes, role < RAW_MATTE ? 3 : 1);
        assert_int_equal(t->type, role == RAW_DEPTH ? PIXEL_TYPE_FLOAT : PIXEL_TYPE_HALF);
        assert_int_equal(planes_alloc(&p, WIDTH, HEIGHT, t->planes, t->type), 0);
        raw_decode(&l, t, (const uint8_t *)in, &p, NULL, NULL, 0);
        for (unsigned c = 0; c < t->planes; c++)
            for (unsigned y = 0; y < HEIGHT; y++)
                for (unsigned x = 0; x < WIDTH; x++) {
                    uint16_t half = in[y][x][channels[role][c]];
                    float wide;
                    half_to_float(&wide, &half, 1);
                    const uint8_t *row = planes_row(&p, c, y);
                    if (role == RAW_DEPTH)
                        assert_memory_equal(row + 4 * x, &wide, 4);
                    else
                        assert_memory_equal(row + 2 * x, &half, 2);
                }
        planes_free(&p);
    }
    // What is only read comes back as it was.
    uint16_t out[HEIGHT][WIDTH][COUNT];
    struct planes black;
    assert_int_equal(planes_alloc(&black, WIDTH, HEIGHT, 3, PIXEL_TYPE_HALF), 0);
    raw_encode(&l, (const uint8_t *)in, &black, (uint8_t *)out, 0);
    for (unsigned i = 0; i < HEIGHT * WIDTH * COUNT; i++)
        assert_int_equal(((uint16_t *)out)[i], i % COUNT < 3 ? 0 : ((uint16_t *)in)[i]);
    planes_free(&black);
    // Absent ones are named; a Z that is not there is no fault.
    l.source = "lamp";
    assert_int_equal(raw_check(&l, sizeof in, &f), -1);
    assert_int_equal(f.code, FAULT_LAYOUT);
    assert_string_equal(f.field, "params.source");
    l.source = "";
    l.matte = "cut.R";
    assert_int_equal(raw_check(&l, sizeof in, &f), -1);
    assert_string_equal(f.field, "params.matte");
    l.matte = NULL;
    strcpy(l.channel[8].name, "depth");
    assert_int_equal(raw_check(&l, sizeof in, &f), 0);
    assert_int_equal(l.targets, 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_random_layouts),
        cmocka_unit_test(test_extremes),
        cmocka_unit_test(test_saturation),
        cmocka_unit_test(test_sources),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
