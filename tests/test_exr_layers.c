// SPDX-License-Identifier: Apache-2.0
/*
 * test_exr_layers.c - what is read beside a scene (source, matte, depth) against the OpenEXR C++ library's own
 * reading, and the layers that are written beside it, read back by that library.
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
        fail_msg("the generator failed: layout %d parts %d", s->layout, s->parts);
    return m;
}

static float value(uint32_t bits, int type)
{
    float v;
    if (type == PIXEL_TYPE_UINT)
        return (float)bits;
    if (type == PIXEL_TYPE_HALF) {
        uint16_t h = (uint16_t)bits;
        half_to_float(&v, &h, 1);
    } else {
        memcpy(&v, &bits, 4);
    }
    return v;
}

static void edit_box(unsigned target, const struct exr_target *t, struct planes *out, void *ctx)
{
    (void)target, (void)ctx, (void)t;
    for (unsigned c = 0; c < out->count; c++)
        for (uint32_t y = 10; y < 20; y++)
            for (uint32_t x = 30; x < 40; x++)
                planes_set(out, c, x, y, 7.5f);
}

// ---- companions ----

struct want {
    enum exr_role role;
    unsigned part;
    const char *channel[3];
    int file_type;           // of the channels
    int source, matte, depth; // of scenes
};

enum { WANTS = 12 };

struct checked {
    const struct made *file;
    const struct want *want;
    unsigned looked;
};

static void check_plane(const struct made *m, const struct want *w, unsigned c, const struct planes *in)
{
    uint32_t *bits;
    unsigned width, height;
    assert_int_equal(exr_tool_channel(m->bytes, m->size, w->part, w->channel[c], 0, 0, &bits, &width, &height), 0);
    assert_int_equal(in->width, width);
    assert_int_equal(in->height, height);
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++) {
            const float is = planes_get(in, c, x, y), should = value(bits[y * width + x], w->file_type);
            if (memcmp(&is, &should, 4) && !(isnan(is) && isnan(should)))
                fail_msg("part %u channel %s at %u,%u: %g, not %g", w->part, w->channel[c], x, y, (double)is,
                         (double)should);
        }
    free(bits);
}

static void look(unsigned target, const struct exr_target *t, const struct planes *in, void *ctx)
{
    struct checked *k = ctx;
    const struct want *w = &k->want[target];
    assert_int_equal(t->role, w->role);
    assert_int_equal(t->part, w->part);
    assert_int_equal(t->display_width, 100);
    const bool scene = w->role == EXR_SCENE;
    assert_int_equal(t->source, scene ? w->source : -1);
    assert_int_equal(t->matte, scene ? w->matte : -1);
    assert_int_equal(t->depth, scene ? w->depth : -1);
    const enum pixel_type type = w->file_type == PIXEL_TYPE_HALF && w->role != EXR_DEPTH ? PIXEL_TYPE_HALF
                                                                                           : PIXEL_TYPE_FLOAT;
    assert_int_equal(t->type, type);
    for (unsigned c = 0; c < 3 && w->channel[c]; c++) {
        assert_in_range(c, 0, t->channels - 1);
        check_plane(k->file, w, c, in);
    }
    assert_true(frame_scan_max_channel(&t->scan) > 0); // they are scanned, too
    k->looked++;
}

static void companions(const struct exr_tool_spec *s, struct exr_select select, const struct want *want,
                       unsigned wants)
{
    struct made m = make(s);
    char text[2048];
    static struct exr_tool_diff d[256];
    for (unsigned threads = 0; threads < 3; threads += 2)
        for (int edited = 0; edited < 2; edited++) {
            struct checked k = { .file = &m, .want = want };
            struct exr_run r = { .select = select, .options = { .compression = EXR_KEEP }, .threads = threads,
                                 .untouched = !edited, .edit = edited ? edit_box : NULL, .look = look, .ctx = &k };
            if (exr_run(&r, m.bytes, m.size))
                fail_msg("%s: %s: %s", fault_symbol(r.fault.code), r.fault.field, r.fault.text);
            assert_int_equal(k.looked, wants);
            const int n = exr_tool_compare(m.bytes, m.size, r.bytes, r.size, d, COUNT(d), text, sizeof(text));
            assert_in_range(n, edited ? 3 : 0, edited ? (int)COUNT(d) : 0);
            for (int i = 0; i < n; i++) { // only what scenes are of
                bool of_scene = false;
                for (unsigned t = 0; t < wants; t++)
                    for (unsigned c = 0; c < 3 && want[t].role == EXR_SCENE; c++)
                        of_scene |= want[t].part == d[i].part && !strcmp(want[t].channel[c], d[i].channel);
                if (!of_scene)
                    fail_msg("channel %s of part %u changed", d[i].channel, d[i].part);
            }
            if (!edited) {
                assert_int_equal(r.size, m.size);
                assert_memory_equal(r.bytes, m.bytes, m.size);
            }
            exr_run_finish(&r);
        }
    free(m.bytes);
}

#define HALF3(part_, p) .part = (part_), .channel = { p "R", p "G", p "B" }, .file_type = PIXEL_TYPE_HALF
#define ONE(part_, name, t) .part = (part_), .channel = { name }, .file_type = (t)
#define COMPANIONS(s, sel, ...)                                                                              \
    do {                                                                                                     \
        const struct want list[] = { __VA_ARGS__ };                                                          \
        companions(s, (struct exr_select)sel, list, COUNT(list));                                            \
    } while (0)
#define SEL(...) { __VA_ARGS__ }

static void test_same_part(void **state)
{
    (void)state;
    for (int tiled = 0; tiled < 4; tiled++)
        for (int compression = EXR_NONE; compression <= EXR_ZIP; compression += 3) {
            struct exr_tool_spec s = base_spec();
            s.tiled = tiled;
            s.compression = compression;
            s.specials = tiled == 1;
            COMPANIONS(&s, SEL(.source = "diffuse", .matte = "id", .depth = true),
                       { EXR_SCENE, HALF3(0, ""), .source = 1, .matte = 2, .depth = 3 },
                       { EXR_SOURCE, HALF3(0, "diffuse.") }, { EXR_MATTE, ONE(0, "id", PIXEL_TYPE_UINT) },
                       { EXR_DEPTH, ONE(0, "Z", PIXEL_TYPE_FLOAT) });
            // channels that feed two targets
            COMPANIONS(&s, SEL(.layer = "diffuse", .source = "diffuse", .matte = "diffuse.G"),
                       { EXR_SCENE, HALF3(0, "diffuse."), .source = 1, .matte = 2, .depth = -1 },
                       { EXR_SOURCE, HALF3(0, "diffuse.") }, { EXR_MATTE, ONE(0, "diffuse.G", PIXEL_TYPE_HALF) });
            COMPANIONS(&s, SEL(.matte = "Z", .depth = true),
                       { EXR_SCENE, HALF3(0, ""), .source = -1, .matte = 1, .depth = 2 },
                       { EXR_MATTE, ONE(0, "Z", PIXEL_TYPE_FLOAT) }, { EXR_DEPTH, ONE(0, "Z", PIXEL_TYPE_FLOAT) });
        }
}

static void test_views(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    s.layout = EXR_TOOL_EYES;
    COMPANIONS(&s, SEL(.source = "glow", .matte = "matte", .depth = true),
               { EXR_SCENE, HALF3(0, ""), .source = 2, .matte = 3, .depth = 4 },
               { EXR_SCENE, HALF3(0, "right."), .source = 5, .matte = 6, .depth = 7 },
               { EXR_SOURCE, HALF3(0, "glow.") }, { EXR_MATTE, ONE(0, "matte", PIXEL_TYPE_HALF) },
               { EXR_DEPTH, ONE(0, "Z", PIXEL_TYPE_FLOAT) }, { EXR_SOURCE, HALF3(0, "glow.right.") },
               { EXR_MATTE, ONE(0, "right.matte", PIXEL_TYPE_HALF) },
               { EXR_DEPTH, ONE(0, "right.Z", PIXEL_TYPE_FLOAT) });
    // what the file does not tell apart is shared
    COMPANIONS(&s, SEL(.source = "shared", .matte = "hold.A"),
               { EXR_SCENE, HALF3(0, ""), .source = 2, .matte = 3, .depth = -1 },
               { EXR_SCENE, HALF3(0, "right."), .source = 2, .matte = 3, .depth = -1 },
               { EXR_SOURCE, HALF3(0, "shared.") }, { EXR_MATTE, ONE(0, "hold.A", PIXEL_TYPE_FLOAT) });
    // the depth of the view, where the layer has none; a view named in full
    COMPANIONS(&s, SEL(.layer = "glow", .view = "right", .source = "right", .matte = "id.m", .depth = true),
               { EXR_SCENE, HALF3(0, "glow.right."), .source = 1, .matte = 2, .depth = 3 },
               { EXR_SOURCE, HALF3(0, "right.") }, { EXR_MATTE, ONE(0, "id.m", PIXEL_TYPE_UINT) },
               { EXR_DEPTH, ONE(0, "right.Z", PIXEL_TYPE_FLOAT) });
}

static void test_other_part(void **state)
{
    (void)state;
    for (int tiled = 0; tiled < 3; tiled++) {
        struct exr_tool_spec s = base_spec();
        s.parts = 2;
        s.aov = 1;
        s.tiled = tiled;
        // a part that is the layer by its name, and a scene itself; each eye's own depth; the mask shared
        COMPANIONS(&s, SEL(.source = "emission", .matte = "mask.A", .depth = true),
                   { EXR_SCENE, HALF3(0, ""), .source = 3, .matte = 4, .depth = 5 },
                   { EXR_SCENE, HALF3(1, ""), .source = 3, .matte = 4, .depth = 6 },
                   { EXR_SCENE, HALF3(3, ""), .source = 3, .matte = 4, .depth = 5 },
                   { EXR_SOURCE, HALF3(3, "") }, { EXR_MATTE, ONE(3, "mask.A", PIXEL_TYPE_HALF) },
                   { EXR_DEPTH, ONE(0, "Z", PIXEL_TYPE_FLOAT) }, { EXR_DEPTH, ONE(1, "Z", PIXEL_TYPE_FLOAT) });
        s.parts = 3; // and a deep part, which has a Z, too
        COMPANIONS(&s, SEL(.view = "right", .source = "emission", .matte = "id"),
                   { EXR_SCENE, HALF3(1, ""), .source = 1, .matte = 2, .depth = -1 },
                   { EXR_SOURCE, HALF3(4, "") }, { EXR_MATTE, ONE(1, "id", PIXEL_TYPE_UINT) });
        COMPANIONS(&s, SEL(.part = "emission", .source = "emission", .depth = true), // Z elsewhere is of other size
                   { EXR_SCENE, HALF3(4, ""), .source = 1, .matte = -1, .depth = 2 },
                   { EXR_SOURCE, HALF3(4, "") }, { EXR_DEPTH, ONE(0, "Z", PIXEL_TYPE_FLOAT) });
    }
}

static void look_luma_chroma(unsigned target, const struct exr_target *t, const struct planes *in, void *ctx)
{
    const float *want = ctx;
    if (t->role != EXR_SOURCE)
        return;
    unsigned far_off = 0;
    assert_int_equal(target, 1);
    for (uint32_t y = 0; y < t->height; y++)
        for (uint32_t x = 0; x < t->width; x++, want += 3)
            for (unsigned c = 0; c < 3; c++)
                far_off += fabsf(planes_get(in, c, x, y) - want[c]) > 0.02f * fmaxf(want[0], fmaxf(want[1], want[2])) + 1e-3f;
    assert_in_range(far_off, 0, t->width * t->height / 20); // where the library takes saturation off
}

static void test_luma_chroma_source(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    s.layout = EXR_TOOL_YCGLOW;
    s.min_x = s.min_y = -4;
    struct made m = make(&s);
    float *want;
    unsigned w, h;
    assert_int_equal(exr_tool_rgb(m.bytes, m.size, "glow", &want, &w, &h), 0);
    struct exr_run r = { .select = { .source = "glow" }, .options = { .compression = EXR_KEEP }, .untouched = true,
                         .look = look_luma_chroma, .ctx = want };
    assert_int_equal(exr_run(&r, m.bytes, m.size), 0);
    assert_int_equal(r.targets, 2);
    assert_int_equal(r.size, m.size);
    exr_run_finish(&r);
    free(want);
    free(m.bytes);
}

static void refused(const struct exr_tool_spec *s, struct exr_run r, enum fault_code code, const char *field,
                    const char *words)
{
    struct made m = make(s);
    r.options.compression = EXR_KEEP;
    const int result = exr_run(&r, m.bytes, m.size);
    exr_run_finish(&r);
    free(m.bytes);
    if (!result)
        fail_msg("no fault; %s %s with '%s' was expected", fault_symbol(code), field, words);
    if (r.fault.code != code || strcmp(r.fault.field, field) || !strstr(r.fault.text, words))
        fail_msg("%s '%s': '%s'; expected %s %s with '%s'", fault_symbol(r.fault.code), r.fault.field, r.fault.text,
                 fault_symbol(code), field, words);
}

#define REFUSED(sel, code, field, words) refused(&s, (struct exr_run){ .select = sel }, code, field, words)

static void test_companions_refused(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    REFUSED(SEL(.source = "specular"), FAULT_NO_LAYER, "params.source",
            "layer 'specular' asked for; for beauty the file has: A, B, G, R, Z, diffuse, id");
    REFUSED(SEL(.matte = "diffuse"), FAULT_NO_LAYER, "params.matte", "diffuse.B, diffuse.G, diffuse.R, id");
    REFUSED(SEL(.matte = "diffuse."), FAULT_NO_LAYER, "params.matte", "channel 'diffuse.' asked for");
    s.layout = EXR_TOOL_EYES;
    REFUSED(SEL(.source = "id"), FAULT_EXR_UNSUPPORTED, "params.source", "channel 'id.R' of part 0 is UINT");
    s.layout = EXR_TOOL_SMALL;
    s.min_x = s.min_y = 0;
    REFUSED(SEL(.matte = "small"), FAULT_EXR_UNSUPPORTED, "params.matte",
            "channel 'small' of part 0 is subsampled to 38 x 29, the frame is 76 x 58");
    s = base_spec();
    s.parts = 3;
    s.aov = 1;
    REFUSED(SEL(.matte = "depth.Z"), FAULT_EXR_UNSUPPORTED, "params.matte",
            "channel 'Z' of part 2 (depth) is 64 x 36 pixels at (-3, 5), part 0 (first.left) is 76 x 58 at (-5, -37)");
    REFUSED(SEL(.matte = "deep.Z"), FAULT_EXR_UNSUPPORTED, "params.matte", "channel 'Z' of part 3 (deep) is deep data");
    REFUSED(SEL(.source = "deep"), FAULT_EXR_UNSUPPORTED, "params.source", "is deep data");
    REFUSED(SEL(.view = "right", .source = "first.left"), FAULT_NO_LAYER, "params.source", // the other eye's
            "for part 1 (right) the file has: A, B, G, R, Z, diffuse, id");
    s.layout = EXR_TOOL_Y;
    REFUSED(SEL(.source = "emission"), FAULT_EXR_UNSUPPORTED, "params.source",
            "layer 'emission' of part 4 (emission) has 3 colour channels, part 0 (left) has 1");
    s = base_spec();
    s.layout = EXR_TOOL_CROWD;
    struct made m = make(&s); // 6 views, 4 targets each
    struct exr_run r = { .select = { .depth = true }, .options = { .compression = EXR_KEEP }, .untouched = true };
    assert_int_equal(exr_run(&r, m.bytes, m.size), 0);
    assert_int_equal(r.targets, 12);
    exr_run_finish(&r);
    free(m.bytes);
    REFUSED(SEL(.source = "v1", .matte = "Z", .depth = true), FAULT_EXR_TOO_LARGE, "input", "more than 16 layers");
}

// Depth that cannot be used is none, and said.
static void test_depth_absent(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    s.layout = EXR_TOOL_Y;
    struct made m = make(&s);
    struct exr_run r = { .select = { .depth = true }, .options = { .compression = EXR_KEEP }, .untouched = true };
    assert_int_equal(exr_run(&r, m.bytes, m.size), 0);
    assert_int_equal(r.targets, 1);
    assert_string_equal(r.notes, "");
    exr_run_finish(&r);
    free(m.bytes);
    s.parts = 2; // the depth part has another window
    m = make(&s);
    struct exr_run two = { .select = { .depth = true }, .options = { .compression = EXR_KEEP }, .untouched = true };
    assert_int_equal(exr_run(&two, m.bytes, m.size), 0);
    assert_int_equal(two.targets, 2);
    assert_non_null(strstr(two.notes, "depth is not used: channel 'Z' of part 2 (depth) is 64 x 36"));
    exr_run_finish(&two);
    free(m.bytes);
}

// ---- extra layers ----

static float layer_value(unsigned target, unsigned k, unsigned c, uint32_t x, uint32_t y)
{
    return (float)((x * 3 + y * 5 + c * 7 + k * 11 + target * 13) % 64) / 16.0f - 0.5f; // exact in half
}

static void extra(unsigned target, unsigned k, struct planes *out, void *ctx)
{
    (void)ctx;
    for (unsigned c = 0; c < out->count; c++)
        for (uint32_t y = 0; y < out->height; y++)
            for (uint32_t x = 0; x < out->width; x++)
                planes_set(out, c, x, y, layer_value(target, k, c, x, y));
}

static void check_layer(const struct exr_run *r, unsigned part, unsigned target, unsigned k, unsigned c,
                        const char *name, int type)
{
    uint32_t *bits;
    unsigned w, h;
    if (exr_tool_channel(r->bytes, r->size, part, name, 0, 0, &bits, &w, &h))
        fail_msg("no channel %s", name);
    for (uint32_t y = 0; y < h; y++)
        for (uint32_t x = 0; x < w; x++)
            if (value(bits[y * w + x], type) != layer_value(target, k, c, x, y))
                fail_msg("%s at %u,%u is %g, not %g", name, x, y, (double)value(bits[y * w + x], type),
                         (double)layer_value(target, k, c, x, y));
    free(bits);
}

static const char *const odd_names[] = { "bright", "level.12", "a-name-of-more-than-thirty-one-bytes" };

static void extras_of(const struct exr_tool_spec *s, int to, enum exr_pixels pixels, bool edited)
{
    struct made m = make(s);
    char text[2048], name[128];
    static struct exr_tool_diff d[256];
    struct exr_run r = { .options = { .compression = to, .pixels = pixels, .extras = 3,
                                      .extra_name = { odd_names[0], odd_names[1], odd_names[2] } },
                         .extra = extra, .untouched = !edited, .edit = edited ? edit_box : NULL, .threads = 2 };
    if (exr_run(&r, m.bytes, m.size))
        fail_msg("%s: %s: %s", fault_symbol(r.fault.code), r.fault.field, r.fault.text);
    const int n = exr_tool_compare(m.bytes, m.size, r.bytes, r.size, d, COUNT(d), text, sizeof(text));
    assert_in_range(n, 0, COUNT(d));
    const bool lossy = to == EXR_DWAA || to == EXR_B44;
    for (int i = 0; i < n && !lossy; i++) {
        const bool colour = !strcmp(d[i].channel, "R") || !strcmp(d[i].channel, "G") || !strcmp(d[i].channel, "B");
        if (!colour || !(edited || d[i].type_a != d[i].type_b))
            fail_msg("channel %s changed in %llu samples", d[i].channel, (unsigned long long)d[i].differing);
    }
    assert_non_null(strstr(text, "changed channels\n"));
    assert_int_equal(strstr(text, "changed compression\n") != NULL, to != EXR_KEEP && to != s->compression);
    for (const char *at = text; (at = strstr(at, "changed ")); at++)
        assert_true(!strncmp(at + 8, "channels\n", 9) || !strncmp(at + 8, "compression\n", 12) ||
                    !strncmp(at + 8, "chunkCount\n", 11));
    assert_null(strstr(text, "added"));
    assert_int_equal(r.counts.chunks_copied, 0);
    for (unsigned k = 0; k < 3 && !lossy; k++)
        for (unsigned c = 0; c < 3; c++) {
            const int file_type = s->type == 2 || (s->type == 3 && c == 1) ? 2 : 1;
            snprintf(name, sizeof(name), "airy.%s.%c", odd_names[k], "RGB"[c]);
            check_layer(&r, 0, 0, k, c, name, pixels == EXR_PIXELS_KEEP ? file_type : (int)pixels);
        }
    exr_run_finish(&r);
    free(m.bytes);
}

static void test_extras(void **state)
{
    (void)state;
    for (int tiled = 0; tiled < 2; tiled++)
        for (int type = 1; type <= 3; type++) {
            struct exr_tool_spec s = base_spec();
            s.tiled = tiled;
            s.type = type;
            s.specials = 1;
            s.compression = type == 1 ? EXR_PIZ : EXR_ZIP;
            for (int edited = 0; edited < 2; edited++) {
                for (int pixels = EXR_PIXELS_KEEP; pixels <= EXR_PIXELS_FLOAT; pixels++)
                    extras_of(&s, EXR_KEEP, (enum exr_pixels)pixels, edited);
                for (int to = EXR_NONE; to <= EXR_PIZ; to++)
                    extras_of(&s, to, EXR_PIXELS_KEEP, edited);
                extras_of(&s, EXR_B44, EXR_PIXELS_KEEP, edited);
                extras_of(&s, EXR_DWAA, EXR_PIXELS_KEEP, edited);
            }
        }
}

// Each layer beside the channels that it is of.
static void test_extras_layouts(void **state)
{
    (void)state;
    const struct {
        enum exr_tool_layout layout;
        int parts;
        const char *layer;
        unsigned targets;
        struct {
            unsigned part, c;
            const char *name;
        } at[2];
    } cases[] = {
        { EXR_TOOL_STEREO, 1, NULL, 2, { { 0, 1, "airy.bloom.G" }, { 0, 2, "right.airy.bloom.B" } } },
        { EXR_TOOL_STEREO, 1, "diffuse", 1, { { 0, 0, "diffuse.right.airy.bloom.R" } } },
        { EXR_TOOL_RGBA, 1, "diffuse", 1, { { 0, 1, "diffuse.airy.bloom.G" } } },
        { EXR_TOOL_RGBA, 3, NULL, 2, { { 0, 1, "airy.bloom.G" }, { 1, 0, "airy.bloom.R" } } },
        { EXR_TOOL_Y, 1, NULL, 1, { { 0, 0, "airy.bloom.Y" } } },
        { EXR_TOOL_YC, 1, NULL, 1, { { 0, 1, "airy.bloom.G" } } },
        { EXR_TOOL_SMALL, 1, NULL, 1, { { 0, 2, "airy.bloom.B" } } },
    };
    for (unsigned i = 0; i < COUNT(cases); i++) {
        struct exr_tool_spec s = base_spec();
        s.layout = cases[i].layout;
        s.parts = cases[i].parts;
        s.min_x = s.min_y = -6;
        struct made m = make(&s);
        struct exr_run r = { .select = { .layer = cases[i].layer }, .extra = extra, .untouched = true, .threads = 2,
                             .options = { .compression = EXR_KEEP, .stamp = "s", .extras = 1, .extra_name = { "bloom" } } };
        if (exr_run(&r, m.bytes, m.size))
            fail_msg("%u: %s: %s", i, r.fault.field, r.fault.text);
        assert_int_equal(r.targets, cases[i].targets);
        struct exr_tool_diff d[8];
        char text[2048];
        assert_int_equal(exr_tool_compare(m.bytes, m.size, r.bytes, r.size, d, 8, text, sizeof(text)), 0);
        for (unsigned t = 0; t < cases[i].targets; t++)
            check_layer(&r, cases[i].at[t].part, t, 0, cases[i].at[t].c, cases[i].at[t].name, 1);
        if (s.parts == 3) { // the others as they were
            assert_null(strstr(text, "part 2"));
            assert_null(strstr(text, "part 3"));
            assert_int_equal(r.counts.chunks_copied, 2 * 36);
        }
        exr_run_finish(&r);
        free(m.bytes);
    }
}

static void extra_huge(unsigned target, unsigned k, struct planes *out, void *ctx)
{
    extra(target, k, out, ctx);
    planes_set(out, 0, 3, 4, 1e6f);
    planes_set(out, 2, 5, 6, INFINITY);
}

static void test_extras_saturate(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    struct made m = make(&s);
    for (int wide = 0; wide < 2; wide++) {
        struct exr_run r = { .extra = extra_huge, .untouched = true, .float_out = wide,
                             .options = { .compression = EXR_KEEP, .extras = 1, .extra_name = { "bright" } } };
        assert_int_equal(exr_run(&r, m.bytes, m.size), 0);
        assert_int_equal(r.counts.saturated, 1);
        uint32_t *bits;
        unsigned w, h;
        assert_int_equal(exr_tool_channel(r.bytes, r.size, 0, "airy.bright.R", 0, 0, &bits, &w, &h), 0);
        assert_int_equal(bits[4 * w + 3], 0x7bff);
        free(bits);
        assert_int_equal(exr_tool_channel(r.bytes, r.size, 0, "airy.bright.B", 0, 0, &bits, &w, &h), 0);
        assert_int_equal(bits[6 * w + 5], 0x7c00);
        free(bits);
        exr_run_finish(&r);
    }
    free(m.bytes);
}

#define LAYERS(...)                                                                                          \
    (struct exr_run)                                                                                         \
    {                                                                                                        \
        .extra = extra, .options = { .extras = 1, .extra_name = { __VA_ARGS__ } }                            \
    }

static void test_extras_refused(void **state)
{
    (void)state;
    struct exr_tool_spec s = base_spec();
    for (s.tiled = 2; s.tiled <= 3; s.tiled++)
        refused(&s, LAYERS("bright"), FAULT_EXR_UNSUPPORTED, "params.layers", "levels of resolution");
    s.tiled = 0;
    char long_name[300];
    memset(long_name, 'x', sizeof(long_name));
    long_name[sizeof(long_name) - 1] = 0;
    refused(&s, LAYERS(long_name), FAULT_EXR_UNSUPPORTED, "params.layers", "a name of 306 bytes; at most 255");
    const struct exr_limits limits = { 512, 512, 1 << 20, 76 * 58 * 28 - 1 };
    struct exr_run r = LAYERS("bright");
    r.limits = &limits;
    refused(&s, r, FAULT_EXR_TOO_LARGE, "params.layers", "would hold 123424 bytes of pixels; at most 123423");
    // the second time they are there
    struct made m = make(&s);
    struct exr_run first = LAYERS("bright"), again = LAYERS("bright"), other = LAYERS("other");
    first.options.compression = again.options.compression = other.options.compression = EXR_KEEP;
    assert_int_equal(exr_run(&first, m.bytes, m.size), 0);
    assert_int_equal(exr_run(&again, first.bytes, first.size), -1);
    assert_int_equal(again.fault.code, FAULT_EXR_UNSUPPORTED);
    assert_string_equal(again.fault.field, "params.layers");
    assert_non_null(strstr(again.fault.text, "has a channel 'airy.bright.B' already"));
    assert_int_equal(exr_run(&other, first.bytes, first.size), 0);
    assert_int_equal(other.targets, 1);
    check_layer(&other, 0, 0, 0, 1, "airy.bright.G", 1);
    check_layer(&other, 0, 0, 0, 1, "airy.other.G", 1);
    exr_run_finish(&first);
    exr_run_finish(&other);
    free(m.bytes);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_same_part),          cmocka_unit_test(test_views),
        cmocka_unit_test(test_other_part),         cmocka_unit_test(test_luma_chroma_source),
        cmocka_unit_test(test_companions_refused), cmocka_unit_test(test_depth_absent),
        cmocka_unit_test(test_extras),             cmocka_unit_test(test_extras_layouts),
        cmocka_unit_test(test_extras_saturate),    cmocka_unit_test(test_extras_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
