// SPDX-License-Identifier: Apache-2.0
/*
 * test_exr_grow.c - outputs with a grown data window, read back by the OpenEXR C++ library: inside the old
 * pixels (and what was edited), outside the new ones, 0 in channels that are not bloomed; and what is refused.
 */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "tools/exr_run.h"
#include "tools/exr_tool.h"

#define COUNT(a) (sizeof(a) / sizeof(*(a)))

struct made {
    uint8_t *bytes;
    size_t size;
};

static struct exr_tool_spec base_spec(void)
{
    return (struct exr_tool_spec){ .layout = EXR_TOOL_RGBA, .compression = EXR_ZIP, .type = 1,
                                   .tile_width = 32, .tile_height = 24, .min_x = -5, .min_y = -37,
                                   .width = 76, .height = 58, .parts = 1 };
}

static struct made make(const struct exr_tool_spec *s)
{
    struct made m;
    if (exr_tool_make(s, &m.bytes, &m.size))
        fail_msg("the generator failed");
    return m;
}

static float new_value(unsigned c, uint32_t x, uint32_t y) // exact in half
{
    return (float)((x * 3 + y * 5 + c * 7) % 61) / 16.0f + 0.0625f;
}

static bool edited_at(uint32_t x, uint32_t y) { return (x / 8 + y / 8) % 3 == 0; }

// A pattern all over the grown window, the old pixels left alone in two thirds of it.
static void edit(unsigned target, const struct exr_target *t, struct planes *out, void *ctx)
{
    (void)target, (void)t, (void)ctx;
    assert_int_equal(out->width, t->width + 2 * t->grow);
    for (unsigned c = 0; c < out->count; c++)
        for (uint32_t y = 0; y < out->height; y++)
            for (uint32_t x = 0; x < out->width; x++)
                if (edited_at(x, y))
                    planes_set(out, c, x, y, new_value(c, x, y));
}

static void extra(unsigned target, unsigned k, struct planes *out, void *ctx)
{
    (void)target, (void)ctx;
    for (unsigned c = 0; c < out->count; c++)
        for (uint32_t y = 0; y < out->height; y++)
            for (uint32_t x = 0; x < out->width; x++)
                planes_set(out, c, x, y, new_value(c + 3 + k, x, y));
}

static uint32_t bits_of(float v, int type)
{
    uint32_t u = 0;
    uint16_t h;
    if (type == PIXEL_TYPE_HALF) {
        float_to_half(&h, &v, 1);
        return h;
    }
    memcpy(&u, &v, 4);
    return u;
}

static uint32_t converted(uint32_t bits, int from, int to)
{
    float v;
    uint16_t h = (uint16_t)bits;
    if (from == to)
        return bits;
    if (from == PIXEL_TYPE_HALF)
        half_to_float(&v, &h, 1);
    else
        memcpy(&v, &bits, 4);
    return bits_of(v, to);
}

static bool is_nan_of(uint32_t bits, int type)
{
    return type == PIXEL_TYPE_HALF ? (bits & 0x7fff) > 0x7c00 : type == PIXEL_TYPE_FLOAT && (bits & 0x7fffffff) > 0x7f800000;
}

// plane: of the bloomed channels; -1: carried over.
static void check_channel(const struct made *m, const struct exr_run *r, unsigned part, const char *name, int plane,
                          int from, int to)
{
    uint32_t *old, *new;
    unsigned w, h, nw, nh, g = r->grow;
    assert_int_equal(exr_tool_channel(m->bytes, m->size, part, name, 0, 0, &old, &w, &h), 0);
    assert_int_equal(exr_tool_channel(r->bytes, r->size, part, name, 0, 0, &new, &nw, &nh), 0);
    assert_int_equal(nw, w + 2 * g);
    assert_int_equal(nh, h + 2 * g);
    for (uint32_t y = 0; y < nh; y++)
        for (uint32_t x = 0; x < nw; x++) {
            const bool in = x >= g && x < g + w && y >= g && y < g + h;
            const uint32_t was = in ? old[(y - g) * w + x - g] : 0, is = new[y * nw + x];
            uint32_t want = converted(was, from, to);
            if (plane >= 0 && !r->untouched && edited_at(x, y))
                want = bits_of(new_value((unsigned)plane, x, y), to);
            if (is != want && !(is_nan_of(is, to) && is_nan_of(want, to) && from != to))
                fail_msg("%s at %u,%u (%s): 0x%x, not 0x%x", name, x, y, in ? "inside" : "outside", is, want);
        }
    free(old);
    free(new);
}

static void check_window(const struct made *m, const struct exr_run *r, unsigned part)
{
    int a[4], b[4], g = (int)r->grow;
    assert_int_equal(exr_tool_window(m->bytes, m->size, part, &a[0], &a[1], &a[2], &a[3]), 0);
    assert_int_equal(exr_tool_window(r->bytes, r->size, part, &b[0], &b[1], &b[2], &b[3]), 0);
    assert_int_equal(b[0], a[0] - g);
    assert_int_equal(b[1], a[1] - g);
    assert_int_equal(b[2], a[2] + 2 * g);
    assert_int_equal(b[3], a[3] + 2 * g);
}

static void run_ok(struct exr_run *r, const struct made *m)
{
    if (exr_run(r, m->bytes, m->size))
        fail_msg("%s: %s: %s", fault_symbol(r->fault.code), r->fault.field, r->fault.text);
}

static void grown(const struct exr_tool_spec *s, struct exr_run r)
{
    struct made m = make(s);
    char text[2048];
    r.edit = edit;
    run_ok(&r, &m);
    check_window(&m, &r, 0);
    assert_int_equal(exr_tool_headers(m.bytes, m.size, r.bytes, r.size, text, sizeof(text)), 0);
    assert_non_null(strstr(text, "part 0 changed dataWindow\n"));
    const bool retyped = r.options.pixels != EXR_PIXELS_KEEP && (s->type == 3 || (int)r.options.pixels != s->type);
    const bool packed = r.options.compression != EXR_KEEP && r.options.compression != s->compression;
    assert_int_equal(strstr(text, "changed channels") != NULL, retyped);
    assert_int_equal(strstr(text, "changed compression") != NULL, packed);
    assert_null(strstr(text, "added"));
    assert_int_equal(r.counts.chunks_copied, 0);
    assert_non_null(strstr(r.notes, "so is depth, Z"));
    const char *const carried[] = { "A", "Z", "id", "diffuse.R", "diffuse.G", "diffuse.B" };
    const int rb = s->type == 2 ? 2 : 1, green = s->type == 1 ? 1 : 2;
    const int types[] = { PIXEL_TYPE_HALF, PIXEL_TYPE_FLOAT, PIXEL_TYPE_UINT, rb, green, rb };
    for (unsigned i = 0; i < COUNT(carried); i++)
        check_channel(&m, &r, 0, carried[i], -1, types[i], types[i]);
    for (unsigned c = 0; c < 3; c++) {
        const int from = c == 1 ? green : rb;
        check_channel(&m, &r, 0, (const char *const[]){ "R", "G", "B" }[c], (int)c, from,
                      r.options.pixels == EXR_PIXELS_KEEP ? from : (int)r.options.pixels);
    }
    exr_run_finish(&r);
    free(m.bytes);
}

static void test_windows(void **state)
{
    (void)state;
    const int windows[][4] = { { 0, 0, 76, 58 }, { -700, 900, 75, 47 }, { -5, -37, 131, 93 }, { 7, 3, 1, 1 },
                               { -1, -1, 2, 70 } };
    const uint32_t grows[] = { 1, 17, 64 };
    for (unsigned i = 0; i < COUNT(windows); i++)
        for (unsigned g = 0; g < COUNT(grows); g++)
            for (int tiled = 0; tiled < 2; tiled++)
                for (int untouched = 0; untouched < 2; untouched++) {
                    struct exr_tool_spec s = base_spec();
                    s.min_x = windows[i][0];
                    s.min_y = windows[i][1];
                    s.width = windows[i][2];
                    s.height = windows[i][3];
                    s.tiled = tiled;
                    s.specials = 1;
                    s.line_order = (int)(i + g) % (tiled ? 3 : 2);
                    grown(&s, (struct exr_run){ .grow = grows[g], .untouched = untouched, .threads = 2,
                                                .options = { .compression = EXR_KEEP } });
                }
}

static void test_codecs(void **state)
{
    (void)state;
    for (int from = EXR_NONE; from <= EXR_PIZ; from++)
        for (int to = EXR_KEEP; to <= EXR_PIZ; to++)
            for (int tiled = 0; tiled < 2; tiled++) {
                struct exr_tool_spec s = base_spec();
                s.compression = from;
                s.tiled = tiled;
                grown(&s, (struct exr_run){ .grow = 9, .options = { .compression = to } });
            }
}

static void test_types(void **state)
{
    (void)state;
    for (int type = 1; type <= 3; type++)
        for (int pixels = EXR_PIXELS_KEEP; pixels <= EXR_PIXELS_FLOAT; pixels++)
            for (int way = 0; way < 3; way++) {
                struct exr_tool_spec s = base_spec();
                s.type = type;
                s.specials = 1;
                grown(&s, (struct exr_run){ .grow = 5, .untouched = way == 0, .float_out = way == 2,
                                            .options = { .compression = EXR_KEEP, .pixels = (enum exr_pixels)pixels } });
            }
}

// Lossy codecs: the library reads them, and a flat part of the new area is what was put there.
static void test_lossy(void **state)
{
    (void)state;
    for (int compression = EXR_PXR24; compression <= EXR_DWAB; compression++)
        for (int tiled = 0; tiled < 2; tiled++) {
            struct exr_tool_spec s = base_spec();
            s.compression = compression;
            s.tiled = tiled;
            struct made m = make(&s);
            struct exr_run r = { .grow = 40, .untouched = true, .options = { .compression = EXR_KEEP } };
            run_ok(&r, &m);
            check_window(&m, &r, 0);
            uint32_t *v;
            unsigned w, h;
            assert_int_equal(exr_tool_channel(r.bytes, r.size, 0, "G", 0, 0, &v, &w, &h), 0);
            for (uint32_t x = 0; x < w; x++)
                assert_int_equal(v[3 * w + x], 0);
            float middle = 0;
            const uint16_t bits = (uint16_t)v[(h / 2) * w + w / 2];
            half_to_float(&middle, &bits, 1);
            assert_true(middle > 0.05f);
            free(v);
            exr_run_finish(&r);
            free(m.bytes);
        }
}

static void test_parts(void **state)
{
    (void)state;
    for (int tiled = 0; tiled < 2; tiled++) {
        struct exr_tool_spec s = base_spec();
        s.parts = 3;
        s.tiled = tiled;
        struct made m = make(&s);
        struct exr_run r = { .grow = 11, .edit = edit, .threads = 2, .extra = extra,
                             .options = { .compression = EXR_KEEP, .stamp = "s", .extras = 2,
                                          .extra_name = { "bright", "bloom" } } };
        run_ok(&r, &m);
        char text[2048];
        assert_int_equal(exr_tool_headers(m.bytes, m.size, r.bytes, r.size, text, sizeof(text)), 0);
        for (unsigned part = 0; part < 2; part++) {
            check_window(&m, &r, part);
            check_channel(&m, &r, part, "G", 1, 1, 1);
            check_channel(&m, &r, part, "Z", -1, 2, 2);
            uint32_t *v;
            unsigned w, h;
            assert_int_equal(exr_tool_channel(r.bytes, r.size, part, "airy.bloom.B", 0, 0, &v, &w, &h), 0);
            for (uint32_t y = 0; y < h; y++)
                for (uint32_t x = 0; x < w; x++)
                    assert_int_equal(v[y * w + x], bits_of(new_value(6, x, y), PIXEL_TYPE_HALF));
            free(v);
        }
        assert_null(strstr(text, "part 2")); // depth and deep, as they were
        assert_null(strstr(text, "part 3"));
        assert_int_equal(r.counts.chunks_copied, 2 * 36);
        exr_run_finish(&r);
        // one eye alone
        struct exr_run one = { .grow = 3, .untouched = true, .select = { .view = "right" },
                               .options = { .compression = EXR_KEEP } };
        run_ok(&one, &m);
        check_window(&m, &one, 1);
        assert_int_equal(exr_tool_headers(m.bytes, m.size, one.bytes, one.size, text, sizeof(text)), 0);
        assert_null(strstr(text, "part 0"));
        exr_run_finish(&one);
        free(m.bytes);
    }
}

// Beside companions, which do not grow.
static void test_companions(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    struct made m = make(&s);
    struct exr_run r = { .grow = 6, .edit = edit, .options = { .compression = EXR_KEEP },
                         .select = { .source = "diffuse", .matte = "id", .depth = true } };
    run_ok(&r, &m);
    assert_int_equal(r.targets, 4);
    check_window(&m, &r, 0);
    check_channel(&m, &r, 0, "G", 1, 1, 1);
    check_channel(&m, &r, 0, "id", -1, 0, 0);
    exr_run_finish(&r);
    free(m.bytes);
}

static void test_threads(void **state)
{
    (void)state;
    for (int tiled = 0; tiled < 2; tiled++) {
        struct exr_tool_spec s = base_spec();
        s.tiled = tiled;
        s.width = 200;
        s.height = 150;
        struct made m = make(&s);
        struct exr_run one = { .grow = 33, .edit = edit, .threads = 1, .options = { .compression = EXR_KEEP } };
        run_ok(&one, &m);
        for (unsigned threads = 0; threads <= 4; threads += 2) { // 0: backwards
            struct exr_run r = { .grow = 33, .edit = edit, .threads = threads, .options = { .compression = EXR_KEEP } };
            run_ok(&r, &m);
            assert_int_equal(r.size, one.size);
            assert_memory_equal(r.bytes, one.bytes, one.size);
            exr_run_finish(&r);
        }
        exr_run_finish(&one);
        free(m.bytes);
    }
}

// The chunks stand in the file in its line order, the tiles of a row from the left.
static void test_line_order(void **state)
{
    (void)state;
    for (int order = 0; order < 2; order++) {
        struct exr_tool_spec s = base_spec();
        s.tiled = 1;
        s.line_order = order;
        s.compression = EXR_NONE;
        struct made m = make(&s);
        struct exr_run r = { .grow = 20, .untouched = true, .options = { .compression = EXR_KEEP } };
        run_ok(&r, &m);
        const unsigned across = 4, down = 5; // 116 x 98 by tiles of 32 x 24
        assert_int_equal(r.counts.chunks, across * down);
        // Leaders of uncompressed tiles: found one after the other from the end of the table.
        const unsigned size = 32 * 22 * (order ? 98 - 24 * 4 : 24);
        const uint8_t first[20] = { [4] = order ? down - 1 : 0, [16] = size & 255, [17] = size >> 8 };
        const uint8_t *at = memmem(r.bytes, r.size, first, sizeof(first));
        for (unsigned i = 0; i < across * down; i++) {
            assert_non_null(at);
            assert_in_range(at - r.bytes, 8, r.size - 20);
            assert_int_equal(at[0], i % across);
            assert_int_equal(at[4], order ? down - 1 - i / across : i / across);
            at += 20 + (at[16] | at[17] << 8 | at[18] << 16);
        }
        assert_ptr_equal(at, r.bytes + r.size);
        exr_run_finish(&r);
        free(m.bytes);
    }
}

static void refused_bytes(const struct made *m, uint32_t grow, const struct exr_limits *limits, enum fault_code code,
                          const char *words)
{
    struct exr_run r = { .grow = grow, .limits = limits, .options = { .compression = EXR_KEEP } };
    const int result = exr_run(&r, m->bytes, m->size);
    exr_run_finish(&r);
    if (!result)
        fail_msg("no fault; '%s' was expected", words);
    if (r.fault.code != code || strcmp(r.fault.field, "params.grow") || !strstr(r.fault.text, words))
        fail_msg("%s '%s': '%s'; expected '%s'", fault_symbol(r.fault.code), r.fault.field, r.fault.text, words);
}

static void refused(const struct exr_tool_spec *s, uint32_t grow, const struct exr_limits *limits,
                    enum fault_code code, const char *words)
{
    struct made m = make(s);
    refused_bytes(&m, grow, limits, code, words);
    free(m.bytes);
}

static void test_refused(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    s.tiled = 2;
    refused(&s, 1, NULL, FAULT_EXR_UNSUPPORTED, "part 0 has mip levels");
    s.tiled = 3;
    refused(&s, 1, NULL, FAULT_EXR_UNSUPPORTED, "part 0 has rip levels");
    s = base_spec();
    s.min_x = s.min_y = 0;
    s.layout = EXR_TOOL_YC;
    refused(&s, 2, NULL, FAULT_EXR_UNSUPPORTED, "luminance and chroma");
    s.layout = EXR_TOOL_SMALL;
    refused(&s, 2, NULL, FAULT_EXR_UNSUPPORTED, "channel 'small' of part 0 is subsampled 2 x 2");
    s = base_spec();
    const struct exr_limits limits[] = { { 95, 512, 1 << 20, 1 << 20 }, { 512, 77, 1 << 20, 1 << 20 },
                                         { 512, 512, 96 * 78 - 1, 1 << 20 }, { 512, 512, 1 << 20, 96 * 78 * 22 - 1 } };
    const char *const words[] = { "would grow to 96 x 78 pixels; at most 95 x 512", "at most 512 x 77",
                                  "and 7487 in all", "would hold 164736 bytes of pixels" };
    for (unsigned i = 0; i < COUNT(limits); i++)
        refused(&s, 10, &limits[i], FAULT_EXR_TOO_LARGE, words[i]);
    const struct exr_limits exact = { 96, 78, 96 * 78, 96 * 78 * 22 };
    struct made m = make(&s);
    struct exr_run r = { .grow = 10, .limits = &exact, .options = { .compression = EXR_KEEP } };
    run_ok(&r, &m);
    exr_run_finish(&r);
    refused_bytes(&m, UINT32_MAX, NULL, FAULT_EXR_TOO_LARGE, "4294967295 more pixels");
    // a window at the end of what coordinates can be
    uint8_t *window = memmem(m.bytes, m.size, "dataWindow\0box2i\0", 17);
    assert_non_null(window);
    const int32_t min_x = -(INT32_MAX / 2) + 5, max_x = min_x + s.width - 1;
    memcpy(window + 21, &min_x, 4);
    memcpy(window + 29, &max_x, 4);
    refused_bytes(&m, 5, NULL, FAULT_EXR_TOO_LARGE, "part 0 at (-1073741818, -37) would leave the coordinates");
    struct exr_run last = { .grow = 4, .options = { .compression = EXR_KEEP } };
    run_ok(&last, &m);
    exr_run_finish(&last);
    free(m.bytes);
    // a file of one pixel that would be millions of tiles
    s.tiled = 1;
    s.tile_width = s.tile_height = s.width = s.height = 1;
    refused(&s, 1100, NULL, FAULT_EXR_TOO_LARGE, "4844401 chunks, of 1 x 1 pixels");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_windows),    cmocka_unit_test(test_codecs),  cmocka_unit_test(test_types),
        cmocka_unit_test(test_lossy),      cmocka_unit_test(test_parts),   cmocka_unit_test(test_companions),
        cmocka_unit_test(test_threads),    cmocka_unit_test(test_line_order), cmocka_unit_test(test_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
