// SPDX-License-Identifier: Apache-2.0
/*
 * test_exr_bad.c - what exr.h refuses, and how: selections that are not there, truncated and damaged files,
 * absurd headers; and a fuzz of small files of every kind with a fixed seed (AIRY_SEED, AIRY_FUZZ=count).
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "tools/exr_run.h"
#include "tools/exr_tool.h"

static struct exr_tool_spec base_spec(void)
{
    return (struct exr_tool_spec){ .layout = EXR_TOOL_RGBA, .compression = EXR_ZIP, .type = 1,
                                   .tile_width = 16, .tile_height = 16, .width = 40, .height = 36,
                                   .parts = 1 };
}

struct made {
    uint8_t *bytes;
    size_t size;
};

static struct made make(const struct exr_tool_spec *s)
{
    struct made m;
    if (exr_tool_make(s, &m.bytes, &m.size))
        fail_msg("the generator failed");
    return m;
}

static void edit_all(unsigned target, const struct exr_target *t, struct planes *out, void *ctx)
{
    (void)target, (void)ctx;
    for (unsigned c = 0; c < out->count; c++)
        for (uint32_t y = 0; y < t->height; y++)
            planes_set(out, c, (y * 7) % t->width, y, 2.0f);
}

static const struct exr_limits tight = { 512, 512, 512 * 512, 64 << 20 };

static void expect(const void *bytes, size_t size, const struct exr_select *select, enum fault_code code,
                   const char *words)
{
    struct exr_run r = { .options = { .compression = EXR_KEEP }, .limits = &tight, .edit = edit_all };
    if (select)
        r.select = *select;
    const int result = exr_run(&r, bytes, size);
    exr_run_finish(&r);
    if (!result)
        fail_msg("no fault; %s with '%s' was expected", fault_symbol(code), words);
    if (r.fault.code != code || !strstr(r.fault.text, words))
        fail_msg("%s '%s': '%s'; expected %s with '%s'", fault_symbol(r.fault.code), r.fault.field,
                 r.fault.text, fault_symbol(code), words);
}

// ---- selections ----

static void test_select(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    s.parts = 3;
    struct made m = make(&s);
#define WANT(...) &(struct exr_select){ __VA_ARGS__ }
    expect(m.bytes, m.size, WANT(.part = "4"), FAULT_NO_PART, "part '4' asked for; the file has 4 parts: first");
    expect(m.bytes, m.size, WANT(.part = "-1"), FAULT_NO_PART, "4 parts");
    expect(m.bytes, m.size, WANT(.part = "deep"), FAULT_EXR_UNSUPPORTED, "deep data");
    expect(m.bytes, m.size, WANT(.part = "depth"), FAULT_NO_LAYER, "Z");
    expect(m.bytes, m.size, WANT(.view = "middle"), FAULT_NO_VIEW, "left, right");
    expect(m.bytes, m.size, WANT(.layer = "specular"), FAULT_NO_LAYER, "diffuse");
    free(m.bytes);
    s = base_spec();
    m = make(&s);
    expect(m.bytes, m.size, WANT(.view = "left"), FAULT_NO_VIEW, "no views");
    expect(m.bytes, m.size, WANT(.part = "1"), FAULT_NO_PART, "1 part");
    expect(m.bytes, m.size, WANT(.layer = "diffus"), FAULT_NO_LAYER, "diffuse");
    free(m.bytes);
    s.layout = EXR_TOOL_UINT;
    m = make(&s);
    expect(m.bytes, m.size, NULL, FAULT_EXR_UNSUPPORTED, "channel 'R' of part 0 is UINT");
    free(m.bytes);
    s.layout = EXR_TOOL_G;
    m = make(&s);
    expect(m.bytes, m.size, NULL, FAULT_NO_LAYER, "G");
    expect(m.bytes, m.size, WANT(.part = "0"), FAULT_NO_LAYER, "no channel");
    free(m.bytes);
}

// ---- headers ----

struct text {
    uint8_t bytes[1 << 16];
    size_t n;
};

static void add(struct text *t, const void *data, size_t n)
{
    memcpy(t->bytes + t->n, data, n);
    t->n += n;
}

static void add_u32(struct text *t, uint32_t v)
{
    const uint8_t b[4] = { (uint8_t)v, (uint8_t)(v >> 8), (uint8_t)(v >> 16), (uint8_t)(v >> 24) };
    add(t, b, 4);
}

static void add_attr(struct text *t, const char *name, const char *type, const void *data, uint32_t n)
{
    add(t, name, strlen(name) + 1);
    add(t, type, strlen(type) + 1);
    add_u32(t, n);
    add(t, data, n);
}

struct head {
    uint32_t version;
    int32_t window[4];
    uint8_t compression;
    uint32_t tile[2];
    uint8_t mode;
    const char *channels[4];
    uint32_t channel_type, sampling;
};

static struct head good_head(void)
{
    return (struct head){ .version = 2, .window = { 0, 0, 7, 7 }, .compression = EXR_ZIP,
                          .channels = { "B", "G", "R" }, .channel_type = 1, .sampling = 1 };
}

static void write_head(struct text *t, const struct head *h)
{
    t->n = 0;
    add(t, "\x76\x2f\x31\x01", 4);
    add_u32(t, h->version);
    struct text *list = calloc(1, sizeof(*list));
    for (unsigned i = 0; i < 4 && h->channels[i]; i++) {
        add(list, h->channels[i], strlen(h->channels[i]) + 1);
        add_u32(list, h->channel_type);
        add_u32(list, 0);
        add_u32(list, h->sampling);
        add_u32(list, h->sampling);
    }
    add(list, "", 1);
    add_attr(t, "channels", "chlist", list->bytes, (uint32_t)list->n);
    add_attr(t, "compression", "compression", &h->compression, 1);
    add_attr(t, "dataWindow", "box2i", h->window, 16);
    list->n = 0;
    add_u32(list, h->tile[0]);
    add_u32(list, h->tile[1]);
    add(list, &h->mode, 1);
    if (h->version & 0x200)
        add_attr(t, "tiles", "tiledesc", list->bytes, 9);
    free(list);
}

static void expect_head(const struct head *h, enum fault_code code, const char *words)
{
    struct text *t = calloc(1, sizeof(*t));
    write_head(t, h);
    add(t, "", 1);
    for (int i = 0; i < 64; i++)
        add_u32(t, 0);
    expect(t->bytes, t->n, NULL, code, words);
    free(t);
}

static void test_headers(void **state)
{
    (void)state;
    expect("", 0, NULL, FAULT_NOT_EXR, "magic");
    expect("\x89PNG\r\n\x1a\n........", 16, NULL, FAULT_NOT_EXR, "magic");
    struct head h = good_head();
    expect_head(&h, FAULT_EXR_DAMAGED, "no offset: the file was not written to its end");
    h.version = 3;
    expect_head(&h, FAULT_EXR_UNSUPPORTED, "version field is 0x3");
    h = good_head();
    h.version = 0x8002;
    expect_head(&h, FAULT_EXR_UNSUPPORTED, "version field");
    h = good_head();
    h.compression = 10;
    expect_head(&h, FAULT_EXR_UNSUPPORTED, "compression 10");
    const int32_t windows[][4] = { { 0, 0, INT32_MAX, 7 }, { INT32_MIN, 0, INT32_MAX, 7 }, { 5, 0, 4, 7 },
                                   { 0, 9, 7, 8 } };
    for (unsigned i = 0; i < 4; i++) {
        h = good_head();
        memcpy(h.window, windows[i], 16);
        expect_head(&h, FAULT_EXR_DAMAGED, "which is no window");
    }
    h = good_head();
    h.window[2] = INT32_MAX / 2 - 1;
    expect_head(&h, FAULT_EXR_TOO_LARGE, "at most 512 x 512");
    h = good_head();
    h.window[3] = 511;
    h.compression = EXR_ZIPS;
    expect_head(&h, FAULT_EXR_DAMAGED, "more than the file's");
    h = good_head();
    h.version = 0x202;
    expect_head(&h, FAULT_EXR_DAMAGED, "says 0 x 0");
    h.tile[0] = h.tile[1] = INT32_MAX;
    expect_head(&h, FAULT_EXR_DAMAGED, "no offset");
    h.tile[0] = UINT32_MAX;
    expect_head(&h, FAULT_EXR_DAMAGED, "tiles");
    h = good_head();
    h.channels[1] = "B";
    expect_head(&h, FAULT_EXR_DAMAGED, "'B' comes twice");
    h.channels[1] = "A";
    expect_head(&h, FAULT_EXR_DAMAGED, "not in order");
    h = good_head();
    h.channels[0] = NULL;
    expect_head(&h, FAULT_EXR_DAMAGED, "no channels");
    h = good_head();
    h.channel_type = 3;
    expect_head(&h, FAULT_EXR_DAMAGED, "pixel type 3");
    h = good_head();
    h.sampling = 0;
    expect_head(&h, FAULT_EXR_DAMAGED, "sampling 0");
    h.sampling = 3;
    expect_head(&h, FAULT_EXR_DAMAGED, "no multiples of its sampling");
}

static void test_attributes(void **state)
{
    (void)state;
    struct text *t = calloc(1, sizeof(*t));
    struct head h = good_head();
    write_head(t, &h);
    add_attr(t, "dataWindow", "box2i", h.window, 16);
    expect(t->bytes, t->n, NULL, FAULT_EXR_DAMAGED, "'dataWindow' comes twice");
    write_head(t, &h);
    add_attr(t, "lineOrder", "int", "\0\0\0\0", 4);
    expect(t->bytes, t->n, NULL, FAULT_EXR_DAMAGED, "attribute 'lineOrder' of part 0 is 4 bytes");
    write_head(t, &h);
    add(t, "x\0int\0\xff\xff\xff\xff", 10);
    expect(t->bytes, t->n, NULL, FAULT_EXR_DAMAGED, "says 4294967295 bytes");
    write_head(t, &h);
    memset(t->bytes + t->n, 'x', 300);
    t->n += 300;
    expect(t->bytes, t->n, NULL, FAULT_EXR_DAMAGED, "proper name");
    const int32_t displays[][4] = { { 0, 0, INT32_MAX, 7 }, { INT32_MIN, 0, 0, 0 }, { 1, 0, 0, 7 } };
    for (unsigned i = 0; i < 3; i++) {
        write_head(t, &h);
        add_attr(t, "displayWindow", "box2i", displays[i], 16);
        expect(t->bytes, t->n, NULL, FAULT_EXR_DAMAGED, "displayWindow of part 0 is (");
    }
    const float aspects[] = { 0, -1, 1e30f };
    for (unsigned i = 0; i < 3; i++) {
        write_head(t, &h);
        add_attr(t, "pixelAspectRatio", "float", &aspects[i], 4);
        add(t, "", 1);
        expect(t->bytes, t->n, NULL, FAULT_EXR_DAMAGED, "pixelAspectRatio");
    }
    struct text *views = calloc(1, sizeof(*views));
    for (unsigned i = 0; i < 257; i++)
        add(views, "\1\0\0\0v", 5);
    write_head(t, &h);
    add_attr(t, "multiView", "stringvector", views->bytes, (uint32_t)views->n);
    expect(t->bytes, t->n, NULL, FAULT_EXR_TOO_LARGE, "more than 256 views");
    free(views);
    // a million attributes
    write_head(t, &h);
    const size_t million = 1000000, each = 11;
    uint8_t *huge = malloc(t->n + million * each);
    memcpy(huge, t->bytes, t->n);
    for (size_t i = 0; i < million; i++)
        memcpy(huge + t->n + i * each, "b\0str\0\1\0\0\0", each);
    expect(huge, t->n + million * each, NULL, FAULT_EXR_TOO_LARGE, "more than 16384 attributes");
    free(huge);
    free(t);
}

// ---- chunks ----

static uint64_t get_u64(const uint8_t *p)
{
    uint64_t v = 0;
    for (int i = 7; i >= 0; i--)
        v = v << 8 | p[i];
    return v;
}

static void put_u64(uint8_t *p, uint64_t v)
{
    for (int i = 0; i < 8; i++)
        p[i] = (uint8_t)(v >> 8 * i);
}

// The offset table ends where the first chunk begins, so the first entry tells where it is.
static uint8_t *table_of(const struct made *m, unsigned chunks)
{
    for (uint8_t *p = m->bytes + 8; p + 8 * chunks <= m->bytes + m->size; p++)
        if (get_u64(p) == (uint64_t)(p - m->bytes) + 8 * chunks)
            return p;
    fail_msg("no offset table found");
    return NULL;
}

static void test_chunks(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    struct made m = make(&s);
    uint8_t *table = table_of(&m, 3), *chunk = m.bytes + get_u64(table);
    const uint64_t first = get_u64(table), second = get_u64(table + 8);
    const struct {
        uint64_t offset;
        const char *words;
    } offsets[] = {
        { 0, "has no offset" }, { 1, "outside the file's chunks" }, { UINT64_MAX, "outside the file" },
        { m.size - 3, "outside the file" }, { m.size, "outside the file" }, { second, "another scanline" },
    };
    for (unsigned i = 0; i < sizeof(offsets) / sizeof(offsets[0]); i++) {
        put_u64(table, offsets[i].offset);
        expect(m.bytes, m.size, NULL, FAULT_EXR_DAMAGED, offsets[i].words);
    }
    put_u64(table, first);
    uint8_t saved[8];
    memcpy(saved, chunk, 8);
    chunk[0] ^= 16;
    expect(m.bytes, m.size, NULL, FAULT_EXR_DAMAGED, "says another scanline");
    memcpy(chunk, saved, 8);
    memset(chunk + 4, 0, 4);
    expect(m.bytes, m.size, NULL, FAULT_EXR_DAMAGED, "is empty");
    memset(chunk + 4, 0xff, 4);
    expect(m.bytes, m.size, NULL, FAULT_EXR_DAMAGED, "longer than the file");
    memcpy(chunk + 4, saved + 4, 4);
    chunk[4]++;
    expect(m.bytes, m.size, NULL, FAULT_EXR_DAMAGED, "overlap");
    chunk[4]--;
    chunk[9] ^= 0xff;
    expect(m.bytes, m.size, NULL, FAULT_EXR_DAMAGED, "chunk 0 of part 0 is no proper zlib stream");
    free(m.bytes);
}

static void test_limits(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    struct made m = make(&s);
    const struct exr_limits limits[] = { { 39, 512, 1 << 20, 1 << 20 }, { 512, 35, 1 << 20, 1 << 20 },
                                         { 512, 512, 40 * 36 - 1, 1 << 20 },
                                         { 512, 512, 1 << 20, 40 * 36 * 22 - 1 } };
    for (unsigned i = 0; i < 4; i++) {
        struct exr_run r = { .options = { .compression = EXR_KEEP }, .limits = &limits[i] };
        assert_int_equal(exr_run(&r, m.bytes, m.size), -1);
        assert_int_equal(r.fault.code, FAULT_EXR_TOO_LARGE);
    }
    const struct exr_limits exact = { 40, 36, 40 * 36, 40 * 36 * 22 };
    struct exr_run r = { .options = { .compression = EXR_KEEP }, .limits = &exact };
    assert_int_equal(exr_run(&r, m.bytes, m.size), 0);
    exr_run_finish(&r);
    free(m.bytes);
}

// Every beginning of a file is a fault: nothing hangs, nothing is read behind its end.
static void test_truncated(void **state)
{
    (void)state;
    for (int kind = 0; kind < 3; kind++) {
        struct exr_tool_spec s = base_spec();
        s.tiled = kind == 1 ? 2 : 0;
        s.parts = kind == 2 ? 3 : 1;
        s.width = s.height = 20;
        struct made m = make(&s);
        for (size_t n = 0; n < m.size; n += n < 3000 ? 1 : 13) {
            uint8_t *exact = malloc(n + 1);
            memcpy(exact, m.bytes, n);
            struct exr_run r = { .options = { .compression = EXR_KEEP }, .limits = &tight };
            if (!exr_run(&r, exact, n))
                fail_msg("%zu of %zu bytes were taken for a file", n, m.size);
            assert_in_range(r.fault.code, FAULT_NOT_EXR, FAULT_EXR_DAMAGED);
            free(exact);
        }
        free(m.bytes);
    }
}

// ---- fuzz ----

static uint64_t random_state;

static uint32_t random_u32(void)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)(random_state >> 16);
}

static void mutate(uint8_t *bytes, size_t *size)
{
    const unsigned edits = 1 + random_u32() % 4;
    const bool chunks_only = random_u32() % 2; // so that the codecs see damage, too
    for (unsigned i = 0; i < edits; i++) {
        size_t at = random_u32() % *size;
        if (chunks_only)
            at = *size / 3 + at / 3 * 2;
        else if (random_u32() % 2 && *size > 1200) // the headers, where it does most
            at = random_u32() % 1200;
        if (at >= *size)
            at = *size - 1;
        switch (random_u32() % 5) {
        case 0:
            bytes[at] ^= (uint8_t)(1u << random_u32() % 8);
            break;
        case 1:
            bytes[at] = (uint8_t)random_u32();
            break;
        case 2:
            if (at + 4 <= *size)
                memset(bytes + at, random_u32() % 2 ? 0xff : 0, 4);
            break;
        case 3:
            if (at + 8 <= *size)
                memmove(bytes + at, bytes + random_u32() % (*size - 7), 8);
            break;
        default:
            if (random_u32() % 8 == 0)
                *size = at + 1;
        }
    }
}

static void extra_all(unsigned target, unsigned k, struct planes *out, void *ctx)
{
    (void)target, (void)k, (void)ctx;
    planes_set(out, 0, out->width - 1, out->height - 1, 3.0f);
}

// All that can be asked of a file, at random.
static void ask(struct exr_run *r, int kind)
{
    static const char *const sources[] = { "diffuse", "glow", "emission", "right", "" };
    static const char *const mattes[] = { "id", "A", "matte", "mask.A", "" };
    const uint32_t dice = random_u32();
    r->select.depth = dice & 1;
    if (dice & 2) // the fitting one, mostly
        r->select.source = sources[dice & 4 ? random_u32() % 5 : kind == 5 ? 1 : kind == 3 ? 2 : 0];
    if (dice & 8)
        r->select.matte = mattes[dice & 16 ? random_u32() % 5 : kind == 5 ? 2 : kind == 3 ? 3 : 0];
    if (kind != 1 && kind != 2 && kind != 4 && (dice & 0x60) == 0x60)
        r->grow = 1 + random_u32() % 40;
    if ((dice & 0x180) == 0x180) {
        r->options.extras = 1;
        r->options.extra_name[0] = "bright";
        r->extra = extra_all;
    }
}

static void test_fuzz(void **state)
{
    (void)state;
    const char *seed_word = getenv("AIRY_SEED"), *count_word = getenv("AIRY_FUZZ");
    const uint64_t seed = seed_word ? strtoull(seed_word, NULL, 0) : 20260101;
    const unsigned count = count_word ? (unsigned)atoi(count_word) : 150;
    print_message("  seed %llu, %u mutations of each of 60 files\n", (unsigned long long)seed, count);
    random_state = seed * 2 + 1;
    unsigned accepted = 0, total = 0;
    for (int compression = EXR_NONE; compression <= EXR_DWAB; compression++)
        for (int kind = 0; kind < 6; kind++) {
            struct exr_tool_spec s = base_spec();
            s.compression = compression;
            s.tiled = kind < 3 ? kind : 0;
            s.parts = kind == 3 ? 3 : 1;
            s.aov = kind == 3;
            s.layout = kind == 4 ? EXR_TOOL_YC : kind == 5 ? EXR_TOOL_EYES : EXR_TOOL_RGBA;
            s.type = 1 + compression % 3;
            s.specials = compression < EXR_B44;
            if (kind == 4)
                s.type = 1;
            struct made m = make(&s);
            uint8_t *copy = malloc(m.size);
            for (unsigned i = 0; i < count; i++, total++) {
                size_t size = m.size;
                memcpy(copy, m.bytes, m.size);
                mutate(copy, &size);
                uint8_t *exact = malloc(size); // so that a sanitizer sees one byte too far
                memcpy(exact, copy, size);
                struct exr_run r = { .options = { .compression = EXR_KEEP, .stamp = "s" },
                                     .limits = &tight, .edit = edit_all };
                if (i % 2)
                    ask(&r, kind);
                if (!exr_run(&r, exact, size)) {
                    accepted++;
                } else if (!r.fault.code || !r.fault.text[0]) {
                    fail_msg("a fault without words (seed %llu)", (unsigned long long)seed);
                }
                exr_run_finish(&r);
                free(exact);
            }
            free(copy);
            free(m.bytes);
        }
    print_message("  %u of %u were still files\n", accepted, total);
    assert_in_range(accepted, 1, total - 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_select),    cmocka_unit_test(test_headers), cmocka_unit_test(test_attributes),
        cmocka_unit_test(test_chunks),    cmocka_unit_test(test_limits),  cmocka_unit_test(test_truncated),
        cmocka_unit_test(test_fuzz),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
