// SPDX-License-Identifier: Apache-2.0
/*
 * test_exr.c - round trips: files made by the OpenEXR C++ library go through our codec with an edit of a
 * few pixels, and come back to that library: what was edited is there, all else has its old bits.
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

// The edit: brighter in a rectangle, as a glow would; from the window's corner.
struct box {
    uint32_t x0, y0, x1, y1;
};

static float brighter(float v) { return isfinite(v) ? v * 1.5f + 0.25f : v; }

static void edit_box(unsigned target, const struct exr_target *t, struct planes *out, void *ctx)
{
    const struct box *b = ctx;
    (void)target;
    for (unsigned c = 0; c < out->count; c++)
        for (uint32_t y = b->y0; y < b->y1 && y < t->height; y++)
            for (uint32_t x = b->x0; x < b->x1 && x < t->width; x++)
                planes_set(out, c, x, y, brighter(planes_get(out, c, x, y)));
}

static float value(uint32_t bits, int type)
{
    float v;
    if (type == PIXEL_TYPE_HALF) {
        uint16_t h = (uint16_t)bits;
        half_to_float(&v, &h, 1);
    } else {
        memcpy(&v, &bits, 4);
    }
    return v;
}

static uint32_t expected_bits(uint32_t bits, int type)
{
    if (!isfinite(value(bits, type)))
        return bits;
    float v = brighter(value(bits, type));
    if (type == PIXEL_TYPE_HALF) {
        uint16_t h;
        float_to_half(&h, &v, 1);
        return h;
    }
    memcpy(&bits, &v, 4);
    return bits;
}

static void print_spec(const struct exr_tool_spec *s)
{
    print_error("layout %d compression %d type %d tiled %d tile %dx%d up %d order %d window %d,%d %dx%d "
                "parts %d specials %d\n", s->layout, s->compression, s->type, s->tiled, s->tile_width,
                s->tile_height, s->round_up, s->line_order, s->min_x, s->min_y, s->width, s->height,
                s->parts, s->specials);
}

static struct exr_tool_spec base_spec(void)
{
    return (struct exr_tool_spec){ .layout = EXR_TOOL_RGBA, .compression = EXR_ZIP, .type = 1,
                                   .tile_width = 32, .tile_height = 24, .min_x = -5, .min_y = -37,
                                   .width = 131, .height = 93, .parts = 1 };
}

struct made {
    uint8_t *bytes;
    size_t size;
};

static struct made make(const struct exr_tool_spec *s)
{
    struct made m;
    if (exr_tool_make(s, &m.bytes, &m.size)) {
        print_spec(s);
        fail_msg("the generator failed");
    }
    return m;
}

static void run_ok(struct exr_run *r, const struct made *m, const struct exr_tool_spec *s)
{
    if (exr_run(r, m->bytes, m->size)) {
        if (s)
            print_spec(s);
        fail_msg("%s: %s: %s", fault_symbol(r->fault.code), r->fault.field, r->fault.text);
    }
}

enum { DIFFS = 512 };

static int compare(const struct made *m, const struct exr_run *r, struct exr_tool_diff *d, char *text,
                   size_t text_size)
{
    int n = exr_tool_compare(m->bytes, m->size, r->bytes, r->size, d, DIFFS, text, text_size);
    if (n < 0)
        fail_msg("the library cannot read what we wrote");
    return n;
}

// All samples of a channel: edited inside the box, old bits outside.
static void check_box(const struct made *m, const struct exr_run *r, unsigned part, const char *name,
                      int type, const struct box *b, const struct exr_tool_spec *s)
{
    uint32_t *old, *new;
    unsigned w, h, w2, h2;
    assert_int_equal(exr_tool_channel(m->bytes, m->size, part, name, 0, 0, &old, &w, &h), 0);
    assert_int_equal(exr_tool_channel(r->bytes, r->size, part, name, 0, 0, &new, &w2, &h2), 0);
    assert_int_equal(w, w2);
    for (unsigned y = 0; y < h; y++)
        for (unsigned x = 0; x < w; x++) {
            const uint32_t was = old[y * w + x], is = new[y * w + x];
            const bool in = x >= b->x0 && x < b->x1 && y >= b->y0 && y < b->y1;
            const uint32_t want = in ? expected_bits(was, type) : was;
            if (is != want) {
                print_spec(s);
                fail_msg("part %u channel %s at %u,%u: 0x%x became 0x%x, not 0x%x", part, name, x, y, was,
                         is, want);
            }
        }
    free(old);
    free(new);
}

static bool is_beauty(const char *name)
{
    return !strcmp(name, "R") || !strcmp(name, "G") || !strcmp(name, "B");
}

static bool lossy(int compression) { return compression >= EXR_PXR24; }

static void round_trip(const struct exr_tool_spec *s)
{
    struct made m = make(s);
    struct box b = { 40, 20, 70, 45 };
    struct exr_run r = { .options = { .compression = EXR_KEEP, .stamp = "stamp" }, .edit = edit_box,
                         .ctx = &b, .threads = 1 };
    run_ok(&r, &m, s);
    struct exr_tool_diff d[DIFFS];
    char text[2048];
    int n = compare(&m, &r, d, text, sizeof(text));
    assert_in_range(n, 1, DIFFS);
    for (int i = 0; i < n; i++) {
        const bool dwa = s->compression >= EXR_DWAA && !strncmp(d[i].channel, "diffuse.", 8);
        if (!is_beauty(d[i].channel) && !dwa) {
            print_spec(s);
            fail_msg("channel %s, not bloomed, changed in %llu samples", d[i].channel,
                     (unsigned long long)d[i].differing);
        }
    }
    assert_string_equal(text, "part 0 lost oiio:SHA-1\npart 0 lost preview\npart 0 added airy\n");
    assert_non_null(strstr(r.notes, "preview"));
    const int rb = s->type == 2 ? 2 : 1, g = s->type == 1 ? 1 : 2;
    if (!lossy(s->compression)) {
        check_box(&m, &r, 0, "R", rb, &b, s);
        check_box(&m, &r, 0, "G", g, &b, s);
        check_box(&m, &r, 0, "B", rb, &b, s);
    } else {
        assert_non_null(strstr(r.notes, "lossy"));
    }
    const unsigned copied = r.counts.chunks_copied;
    if (s->compression != EXR_DWAB || s->tiled) // whose 256 lines are one chunk here
        assert_in_range(copied, 1, r.counts.chunks - 1);
    exr_run_finish(&r);
    free(m.bytes);
}

static void test_compressions(void **state)
{
    (void)state;
    for (int compression = EXR_NONE; compression <= EXR_DWAB; compression++)
        for (int tiled = 0; tiled < 4; tiled++)
            for (int type = 1; type <= 3; type++) {
                struct exr_tool_spec s = base_spec();
                s.compression = compression;
                s.tiled = tiled;
                s.type = type;
                s.round_up = type == 2;
                s.line_order = tiled ? (type - 1) % 3 : type % 2;
                s.specials = compression <= EXR_PIZ;
                round_trip(&s);
            }
}

static void test_windows(void **state)
{
    (void)state;
    const int windows[][4] = { { 0, 0, 100, 80 }, { -700, 900, 75, 47 }, { 5, 5, 71, 46 }, { 0, 0, 257, 46 } };
    for (unsigned i = 0; i < sizeof(windows) / sizeof(windows[0]); i++)
        for (int tiled = 0; tiled < 4; tiled++) {
            struct exr_tool_spec s = base_spec();
            s.tiled = tiled;
            s.round_up = (int)i & 1;
            s.min_x = windows[i][0];
            s.min_y = windows[i][1];
            s.width = windows[i][2];
            s.height = windows[i][3];
            s.specials = 1;
            round_trip(&s);
        }
}

// ---- untouched ----

static void same_chunks(const struct made *m, const struct exr_run *r, unsigned stamped_parts)
{
    // The output is the input but for the stamp: 5 + 7 + 4 bytes and its 5 letters, per part with a target.
    const size_t stamp = 21 * (size_t)stamped_parts;
    assert_int_equal(r->size, m->size + stamp);
    assert_int_equal(r->counts.chunks, r->counts.chunks_copied);
}

static void test_untouched(void **state)
{
    (void)state;
    for (int compression = EXR_NONE; compression <= EXR_DWAB; compression++)
        for (int tiled = 0; tiled < 4; tiled++) {
            struct exr_tool_spec s = base_spec();
            s.compression = compression;
            s.tiled = tiled;
            s.specials = 1;
            struct made m = make(&s);
            struct exr_tool_diff d[DIFFS];
            char text[2048];
            for (int way = 0; way < 3; way++) { // said to be so; found to be so, in either plane type
                struct exr_run r = { .options = { .compression = EXR_KEEP, .stamp = "stamp" },
                                     .untouched = way == 0, .float_out = way == 2 };
                run_ok(&r, &m, &s);
                assert_int_equal(compare(&m, &r, d, text, sizeof(text)), 0);
                assert_int_equal(r.counts.chunks, r.counts.chunks_copied);
                if (!way) {
                    same_chunks(&m, &r, 1);
                    assert_string_equal(text, "part 0 added airy\n");
                }
                exr_run_finish(&r);
            }
            free(m.bytes);
        }
}

// The header's raw bytes: the same records in the same order, `airy` after them, then replaced in place.
static void test_header_bytes(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    struct made m = make(&s);
    struct exr_run r = { .options = { .compression = EXR_KEEP, .stamp = "first" }, .untouched = true };
    run_ok(&r, &m, &s);
    const uint8_t *airy = memmem(r.bytes, r.size, "airy\0string", 11);
    assert_non_null(airy);
    const size_t head = (size_t)(airy - r.bytes);
    assert_memory_equal(m.bytes, r.bytes, head);
    assert_int_equal(m.bytes[head], 0); // the end of the input's header
    assert_memory_equal(airy + 12, "\5\0\0\0first", 9);
    struct exr_run again = { .options = { .compression = EXR_KEEP, .stamp = "other" }, .untouched = true };
    struct made once = { r.bytes, r.size };
    run_ok(&again, &once, &s);
    assert_int_equal(again.size, r.size);
    assert_memory_equal(again.bytes, r.bytes, head + 16);
    assert_memory_equal(again.bytes + head + 16, "other", 5);
    assert_memory_equal(again.bytes + head + 21, r.bytes + head + 21, r.size - head - 21);
    exr_run_finish(&again);
    exr_run_finish(&r);
    free(m.bytes);
}

// ---- other layouts ----

static void test_luminance(void **state)
{
    (void)state;
    struct box b = { 40, 20, 70, 45 };
    for (int type = 1; type <= 2; type++) {
        struct exr_tool_spec s = base_spec();
        s.layout = EXR_TOOL_Y;
        s.type = type;
        struct made m = make(&s);
        struct exr_run r = { .options = { .compression = EXR_KEEP }, .edit = edit_box, .ctx = &b };
        run_ok(&r, &m, &s);
        assert_int_equal(r.targets, 1);
        check_box(&m, &r, 0, "Y", type, &b, &s);
        exr_run_finish(&r);
        free(m.bytes);
    }
}

struct rgb_image {
    float *rgb;
    unsigned w, h;
    unsigned far_off;
};

static void look_rgb(unsigned target, const struct exr_target *t, const struct planes *in, void *ctx)
{
    struct rgb_image *want = ctx;
    (void)target;
    assert_int_equal(t->width, want->w);
    assert_int_equal(in->type, PIXEL_TYPE_FLOAT);
    for (uint32_t y = 0; y < want->h; y++)
        for (uint32_t x = 0; x < want->w; x++) {
            const float *v = want->rgb + 3 * ((size_t)y * want->w + x);
            float worst = 0, most = fmaxf(v[0], fmaxf(v[1], v[2]));
            for (unsigned c = 0; c < 3; c++)
                worst = fmaxf(worst, fabsf(planes_get(in, c, x, y) - v[c]));
            want->far_off += worst > 0.02f * most + 1e-3f;
        }
}

// Rebuilt colours are the library's, but where its last step takes saturation off.
static void check_luma_chroma(const struct made *m, unsigned allowed_percent)
{
    struct rgb_image want = { 0 };
    assert_int_equal(exr_tool_rgb(m->bytes, m->size, "", &want.rgb, &want.w, &want.h), 0);
    struct exr_run r = { .options = { .compression = EXR_KEEP }, .look = look_rgb, .ctx = &want };
    run_ok(&r, m, NULL);
    if ((uint64_t)want.far_off * 100 > (uint64_t)allowed_percent * want.w * want.h)
        fail_msg("%u of %u pixels are off", want.far_off, want.w * want.h);
    assert_int_equal(r.counts.chunks, r.counts.chunks_copied);
    exr_run_finish(&r);
    free(want.rgb);
}

static void test_luma_chroma(void **state)
{
    (void)state;
    const int compressions[] = { EXR_NONE, EXR_RLE, EXR_ZIPS, EXR_ZIP, EXR_PIZ, EXR_PXR24, EXR_B44, EXR_DWAA,
                                 EXR_DWAB };
    for (unsigned i = 0; i < sizeof(compressions) / sizeof(compressions[0]); i++) {
        struct exr_tool_spec s = base_spec();
        s.layout = EXR_TOOL_YC;
        s.compression = compressions[i];
        s.type = 1 + (int)i % 2;
        s.min_x = -6;
        s.min_y = -38;
        s.width = 130;
        s.height = 94;
        struct made m = make(&s);
        check_luma_chroma(&m, 3);
        struct box b = { 60, 40, 70, 50 };
        struct exr_run r = { .options = { .compression = EXR_KEEP }, .edit = edit_box, .ctx = &b };
        run_ok(&r, &m, &s);
        uint32_t *old, *new;
        unsigned w, h;
        const char *const names[] = { "Y", "RY", "BY" };
        for (unsigned c = 0; c < 3 && !lossy(s.compression); c++) {
            const unsigned sampling = c ? 2 : 1, reach = c ? 13 : 0;
            unsigned changed = 0;
            assert_int_equal(exr_tool_channel(m.bytes, m.size, 0, names[c], 0, 0, &old, &w, &h), 0);
            assert_int_equal(exr_tool_channel(r.bytes, r.size, 0, names[c], 0, 0, &new, &w, &h), 0);
            for (unsigned y = 0; y < h; y++)
                for (unsigned x = 0; x < w; x++) {
                    const unsigned px = x * sampling, py = y * sampling;
                    const bool near = px + reach >= b.x0 && px < b.x1 + reach && py + reach >= b.y0 &&
                                      py < b.y1 + reach;
                    if (!near)
                        assert_int_equal(old[y * w + x], new[y * w + x]);
                    changed += old[y * w + x] != new[y * w + x];
                }
            assert_in_range(changed, 1, w * h);
            free(old);
            free(new);
        }
        exr_run_finish(&r);
        free(m.bytes);
    }
}

static void test_stereo(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    s.layout = EXR_TOOL_STEREO;
    struct made m = make(&s);
    struct box b = { 40, 20, 70, 45 };
    const struct {
        const char *layer, *view, *names[2], *channel;
        unsigned targets;
    } cases[] = {
        { NULL, NULL, { "left", "right" }, NULL, 2 },  { NULL, "right", { "right" }, "right.G", 1 },
        { NULL, "left", { "left" }, "G", 1 },          { "right", NULL, { "right" }, "right.G", 1 },
        { "diffuse", NULL, { "right diffuse" }, "diffuse.right.G", 1 },
        { "diffuse.right", NULL, { "diffuse.right" }, "diffuse.right.G", 1 },
    };
    for (unsigned i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        struct exr_run r = { .options = { .compression = EXR_KEEP }, .edit = edit_box, .ctx = &b,
                             .select = { .layer = cases[i].layer, .view = cases[i].view } };
        run_ok(&r, &m, &s);
        assert_int_equal(r.targets, cases[i].targets);
        for (unsigned t = 0; t < r.targets; t++)
            if (i != 3)
                assert_string_equal(r.names[t], cases[i].names[t]);
        struct exr_tool_diff d[DIFFS];
        char text[2048];
        assert_int_equal(compare(&m, &r, d, text, sizeof(text)), 3 * r.targets);
        if (cases[i].channel)
            check_box(&m, &r, 0, cases[i].channel, 1, &b, &s);
        exr_run_finish(&r);
    }
    free(m.bytes);
}

static void test_parts(void **state)
{
    (void)state;
    struct box b = { 40, 20, 70, 45 };
    for (int parts = 2; parts <= 3; parts++)
        for (int tiled = 0; tiled < 3; tiled++) {
            struct exr_tool_spec s = base_spec();
            s.parts = parts;
            s.tiled = tiled;
            struct made m = make(&s);
            const struct exr_select selects[] = { { 0 }, { .part = "1" }, { .view = "left" },
                                                  { .part = "second.right" },
                                                  { .part = "0", .layer = "diffuse" } };
            for (unsigned i = 0; i < 5; i++) {
                struct exr_run r = { .options = { .compression = EXR_KEEP, .stamp = "stamp" },
                                     .select = selects[i], .edit = edit_box, .ctx = &b, .threads = 2 };
                run_ok(&r, &m, &s);
                assert_int_equal(r.targets, i ? 1 : 2);
                struct exr_tool_diff d[DIFFS];
                char text[2048];
                int n = compare(&m, &r, d, text, sizeof(text));
                assert_in_range(n, 3 * r.targets, DIFFS);
                const char *const prefix = i == 4 ? "diffuse." : "";
                for (int k = 0; k < n; k++) {
                    assert_true(d[k].part == (i == 1 || i == 3 ? 1 : 0) || !i);
                    assert_true(!strncmp(d[k].channel, prefix, strlen(prefix)));
                    assert_true(is_beauty(d[k].channel + strlen(prefix)));
                }
                if (i != 1 && i != 3)
                    check_box(&m, &r, 0, i == 4 ? "diffuse.G" : "G", 1, &b, &s);
                exr_run_finish(&r);
            }
            free(m.bytes);
        }
}

// ---- levels ----

static double mean(const uint32_t *bits, unsigned n, int type)
{
    double sum = 0;
    for (unsigned i = 0; i < n; i++)
        sum += (double)value(bits[i], type);
    return sum / n;
}

static void test_levels(void **state)
{
    (void)state;
    struct box b = { 40, 20, 70, 45 };
    for (int tiled = 2; tiled <= 3; tiled++)
        for (int up = 0; up < 2; up++) {
            struct exr_tool_spec s = base_spec();
            s.tiled = tiled;
            s.round_up = up;
            s.type = 2;
            struct made m = make(&s);
            struct exr_run r = { .options = { .compression = EXR_KEEP }, .edit = edit_box, .ctx = &b };
            run_ok(&r, &m, &s);
            double gain0 = 0;
            for (unsigned ly = 0; ly < 7; ly++)
                for (unsigned lx = 0; lx < 7; lx++) {
                    if (tiled == 2 && lx != ly)
                        continue;
                    uint32_t *old, *new;
                    unsigned w, h;
                    assert_int_equal(exr_tool_channel(m.bytes, m.size, 0, "G", lx, ly, &old, &w, &h), 0);
                    assert_int_equal(exr_tool_channel(r.bytes, r.size, 0, "G", lx, ly, &new, &w, &h), 0);
                    const double gain = mean(new, w * h, 2) - mean(old, w * h, 2);
                    if (!lx && !ly)
                        gain0 = gain;
                    if (fabs(gain - gain0) > 1e-5 * fabs(gain0) + 1e-6)
                        fail_msg("level %u,%u (up %d) gained %g on average, level 0 %g", lx, ly, up, gain,
                                 gain0);
                    if (w > 4 && h > 4) // far corner: nothing reached it
                        assert_int_equal(old[w * h - 1], new[w * h - 1]);
                    free(old);
                    free(new);
                }
            exr_run_finish(&r);
            free(m.bytes);
        }
}

// ---- options ----

static void test_recompress(void **state)
{
    (void)state;
    struct box b = { 40, 20, 70, 45 };
    for (int from = EXR_NONE; from <= EXR_PIZ; from++)
        for (int to = EXR_NONE; to <= EXR_DWAB; to++)
            for (int tiled = 0; tiled < 3; tiled += 2) {
                struct exr_tool_spec s = base_spec();
                s.compression = from;
                s.tiled = tiled;
                s.line_order = from % 2;
                struct made m = make(&s);
                struct exr_run r = { .options = { .compression = to }, .edit = edit_box, .ctx = &b,
                                     .threads = 2 };
                run_ok(&r, &m, &s);
                struct exr_tool_diff d[DIFFS];
                char text[2048];
                int n = compare(&m, &r, d, text, sizeof(text));
                assert_true(from == to || strstr(text, "part 0 changed compression"));
                if (!lossy(to)) {
                    assert_int_equal(n, tiled ? 3 * 8 : 3);
                    check_box(&m, &r, 0, "R", 1, &b, &s);
                }
                exr_run_finish(&r);
                free(m.bytes);
            }
}

static void test_retype(void **state)
{
    (void)state;
    const struct box none = { 0, 0, 0, 0 };
    for (int type = 1; type <= 3; type++)
        for (int tiled = 0; tiled < 3; tiled += 2)
            for (int pixels = EXR_PIXELS_HALF; pixels <= EXR_PIXELS_FLOAT; pixels++)
                for (int untouched = 0; untouched < 2; untouched++) {
                    struct exr_tool_spec s = base_spec();
                    s.type = type;
                    s.tiled = tiled;
                    struct made m = make(&s);
                    struct exr_run r = { .options = { .compression = EXR_KEEP, .pixels = pixels },
                                         .untouched = untouched, .edit = edit_box, .ctx = (void *)&none };
                    run_ok(&r, &m, &s);
                    struct exr_tool_diff d[DIFFS];
                    char text[2048];
                    int n = compare(&m, &r, d, text, sizeof(text));
                    for (int i = 0; i < n; i++) {
                        assert_true(is_beauty(d[i].channel));
                        assert_int_equal(d[i].type_b, pixels == EXR_PIXELS_HALF ? 1 : 2);
                        if (d[i].type_b == 2) // to wider: no value may differ
                            assert_int_equal(d[i].differing, 0);
                    }
                    const int kept = type == 3 ? 1 : (type == pixels) * 3; // how many keep their type
                    const int retyped = type == 3 ? (pixels == 1 ? 1 : 2) : 3 - kept;
                    assert_int_equal(n, retyped * (tiled ? 8 : 1));
                    exr_run_finish(&r);
                    free(m.bytes);
                }
}

static void edit_huge(unsigned target, const struct exr_target *t, struct planes *out, void *ctx)
{
    (void)target, (void)t, (void)ctx;
    planes_set(out, 0, 1, 1, 1e6f);
    planes_set(out, 1, 2, 1, -1e6f);
    planes_set(out, 2, 3, 1, INFINITY);
}

static void test_saturation(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    struct made m = make(&s);
    struct exr_run r = { .options = { .compression = EXR_KEEP }, .float_out = true, .edit = edit_huge };
    run_ok(&r, &m, &s);
    assert_int_equal(r.counts.saturated, 2);
    uint32_t *v;
    unsigned w, h;
    assert_int_equal(exr_tool_channel(r.bytes, r.size, 0, "R", 0, 0, &v, &w, &h), 0);
    assert_int_equal(v[w + 1], 0x7bff);
    free(v);
    assert_int_equal(exr_tool_channel(r.bytes, r.size, 0, "B", 0, 0, &v, &w, &h), 0);
    assert_int_equal(v[w + 3], 0x7c00);
    free(v);
    exr_run_finish(&r);
    free(m.bytes);
}

static void test_threads(void **state)
{
    (void)state;
    struct box b = { 10, 5, 100, 70 };
    for (int tiled = 0; tiled < 4; tiled++) {
        struct exr_tool_spec s = base_spec();
        s.tiled = tiled;
        s.compression = tiled == 1 ? EXR_PIZ : EXR_ZIPS;
        struct made m = make(&s);
        struct exr_run one = { .options = { .compression = EXR_KEEP }, .edit = edit_box, .ctx = &b,
                               .threads = 1 };
        run_ok(&one, &m, &s);
        for (unsigned threads = 0; threads <= 4; threads += 2) { // 0: backwards
            struct exr_run r = { .options = { .compression = EXR_KEEP }, .edit = edit_box, .ctx = &b,
                                 .threads = threads };
            run_ok(&r, &m, &s);
            assert_int_equal(r.size, one.size);
            assert_memory_equal(r.bytes, one.bytes, one.size);
            exr_run_finish(&r);
        }
        exr_run_finish(&one);
        free(m.bytes);
    }
}

// ---- real frames ----

static bool load(const char *folder, const char *name, struct made *m)
{
    char path[1024];
    snprintf(path, sizeof(path), "%s/%s", folder, name);
    FILE *file = fopen(path, "rb");
    if (!file)
        return false;
    fseek(file, 0, SEEK_END);
    m->size = (size_t)ftell(file);
    rewind(file);
    m->bytes = malloc(m->size);
    const bool ok = fread(m->bytes, 1, m->size, file) == m->size;
    fclose(file);
    return ok;
}

static void test_frames(void **state)
{
    (void)state;
    const struct {
        const char *name;
        unsigned targets;
        enum fault_code fault;
    } frames[] = {
        { "Beachball/multipart.0001.exr", 2, 0 },      { "Beachball/singlepart.0001.exr", 2, 0 },
        { "Beachball/singlepart.0002.exr", 2, 0 },     { "Chromaticities/Rec709_YC.exr", 1, 0 },
        { "Chromaticities/XYZ.exr", 1, 0 },            { "DisplayWindow/t01.exr", 1, 0 },
        { "DisplayWindow/t05.exr", 1, 0 },             { "DisplayWindow/t09.exr", 1, 0 },
        { "DisplayWindow/t12.exr", 1, 0 },             { "MultiResolution/Bonita.exr", 1, 0 },
        { "ScanLines/CandleGlass.exr", 1, 0 },         { "ScanLines/Cannon.exr", 1, 0 },
        { "ScanLines/Desk.exr", 1, 0 },                { "TestImages/AllHalfValues.exr", 1, 0 },
        { "TestImages/BrightRingsNanInf.exr", 1, 0 },  { "Tiles/GoldenGate.exr", 1, 0 },
        { "TestImages/WideFloatRange.exr", 0, FAULT_NO_LAYER },
        { "v2/LowResLeftView/Trunks.exr", 0, FAULT_EXR_UNSUPPORTED },
    };
    const char *folder = getenv("AIRY_FRAMES") ? getenv("AIRY_FRAMES") : "../shared/frames";
    struct made m;
    if (!load(folder, frames[0].name, &m)) {
        print_message("[  SKIPPED ] no frames in %s (AIRY_FRAMES)\n", folder);
        skip();
    }
    free(m.bytes);
    struct box b = { 30, 40, 60, 70 };
    for (unsigned i = 0; i < sizeof(frames) / sizeof(frames[0]); i++) {
        print_message("  %s\n", frames[i].name);
        assert_true(load(folder, frames[i].name, &m));
        struct exr_run r = { .options = { .compression = EXR_KEEP, .stamp = "stamp" }, .untouched = true };
        if (frames[i].fault) {
            assert_int_equal(exr_run(&r, m.bytes, m.size), -1);
            assert_int_equal(r.fault.code, frames[i].fault);
            free(m.bytes);
            continue;
        }
        struct exr_tool_diff d[DIFFS];
        char text[2048];
        run_ok(&r, &m, NULL);
        assert_int_equal(r.targets, frames[i].targets);
        same_chunks(&m, &r, strstr(frames[i].name, "multipart") ? 2 : 1);
        assert_int_equal(compare(&m, &r, d, text, sizeof(text)), 0);
        exr_run_finish(&r);
        struct exr_run e = { .options = { .compression = EXR_KEEP }, .edit = edit_box, .ctx = &b, .threads = 2 };
        run_ok(&e, &m, NULL);
        int n = compare(&m, &e, d, text, sizeof(text));
        assert_in_range(n, 1, DIFFS);
        for (int k = 0; k < n; k++) {
            const char *dot = strrchr(d[k].channel, '.'), *last = dot ? dot + 1 : d[k].channel;
            if (!is_beauty(last) && strcmp(last, "Y") && strcmp(last, "RY") && strcmp(last, "BY"))
                fail_msg("%s: channel %s changed", frames[i].name, d[k].channel);
        }
        exr_run_finish(&e);
        if (strstr(frames[i].name, "_YC"))
            check_luma_chroma(&m, 5);
        free(m.bytes);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_compressions), cmocka_unit_test(test_windows),
        cmocka_unit_test(test_untouched),    cmocka_unit_test(test_header_bytes),
        cmocka_unit_test(test_luminance),    cmocka_unit_test(test_luma_chroma),
        cmocka_unit_test(test_stereo),       cmocka_unit_test(test_parts),
        cmocka_unit_test(test_levels),       cmocka_unit_test(test_recompress),
        cmocka_unit_test(test_retype),       cmocka_unit_test(test_saturation),
        cmocka_unit_test(test_threads),      cmocka_unit_test(test_frames),
    };
    if (getenv("AIRY_TEST_ONLY"))
        cmocka_set_test_filter(getenv("AIRY_TEST_ONLY"));
    return cmocka_run_group_tests(tests, NULL, NULL);
}
