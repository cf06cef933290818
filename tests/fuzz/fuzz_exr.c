// SPDX-License-Identifier: Apache-2.0
//
// fuzz_exr.c - exr*.c: any bytes as an OpenEXR file, with any selection: open, decode, encode, assemble.
//
// What is checked: a file that was written can be read again by the same selection, with as many targets; one whose pixels
// were not touched has the same pixels. Input: FUZZ_EXR_BYTES of ways, then the file.
#include <stdbool.h>

#include "fuzz.h"
#include "tools/exr_run.h"

enum { FUZZ_EXR_BYTES = 8, SIDE_MAX = 256, GROW_MAX = 16 };

static uint64_t hash_planes(uint64_t hash, const struct planes *p)
{
    for (unsigned c = 0; c < p->count; c++)
        for (uint32_t y = 0; y < p->height; y++) {
            const uint8_t *row = planes_row(p, c, y);
            for (size_t i = 0; i < (size_t)p->width * pixel_bytes(p->type); i++)
                hash = (hash ^ row[i]) * UINT64_C(0x100000001b3);
        }
    return hash;
}

static void look(unsigned target, const struct exr_target *t, const struct planes *in, void *ctx)
{
    uint64_t *hash = ctx;
    must(target < 16 && memchr(t->name, '\0', sizeof(t->name)));
    must(t->width == in->width && t->height == in->height && t->channels == in->count);
    *hash = hash_planes(*hash, in);
}

static void edit(unsigned target, const struct exr_target *t, struct planes *out, void *ctx)
{
    (void)target, (void)t, (void)ctx;
    for (unsigned c = 0; c < out->count; c++)
        for (uint32_t y = 0; y < out->height; y += 5)
            planes_set(out, c, (y * 7) % out->width, y, 70000.0f);
}

static void extra(unsigned target, unsigned k, struct planes *out, void *ctx)
{
    (void)target, (void)k, (void)ctx;
    planes_set(out, 0, 0, 0, 1.0f);
}

#define PICK(list, byte) ((list)[(byte) % (sizeof(list) / sizeof(*(list)))])

static void read_ways(struct exr_run *r, const uint8_t way[FUZZ_EXR_BYTES])
{
    static const char *const parts[] = { NULL, "", "0", "1", "depth", "deep", "emission", "left" };
    static const char *const layers[] = { NULL, "", "diffuse", "glow", "right", "shared" };
    static const char *const views[] = { NULL, "", "left", "right", "v0", "v5" };
    static const char *const sources[] = { NULL, "diffuse", "glow", "emission", "shared", "id" };
    static const char *const mattes[] = { NULL, "A", "hold.A", "id.m", "mask.A", "matte", "Z" };
    r->select = (struct exr_select){ .part = PICK(parts, way[0]), .layer = PICK(layers, way[1]), .view = PICK(views, way[2]),
                                     .source = PICK(sources, way[3]), .matte = PICK(mattes, way[4]), .depth = way[5] & 1 };
    r->options = (struct exr_options){ .compression = way[6] % 16 > EXR_DWAB ? EXR_KEEP : way[6] % 16,
                                       .pixels = (enum exr_pixels)((way[6] >> 4) % 3),
                                       .stamp = way[5] & 2 ? "a=1" : NULL,
                                       .extras = (way[5] >> 2 & 7) % 3,
                                       .extra_name = { "bright", "level.0" } };
    r->untouched = way[5] & 32;
    r->float_out = way[5] & 64;
    r->edit = way[5] & 128 ? edit : NULL;
    r->extra = extra;
    r->look = look;
    r->grow = way[7] < 128 ? 0 : way[7] % (GROW_MAX + 1);
}

// What was written, read by the same selection and written again untouched. Chunks that got extra layers are coded anew: a
// codec that loses then says so in a note.
static void check_output(const struct exr_run *first, uint64_t hash)
{
    static const struct exr_limits wider = { SIDE_MAX + 2 * GROW_MAX, SIDE_MAX + 2 * GROW_MAX, 1 << 20, UINT64_C(1) << 32 };
    uint64_t again = 0;
    struct exr_run r = { .select = first->select, .options = { .compression = EXR_KEEP }, .limits = &wider,
                         .untouched = true, .look = look, .ctx = &again };
    if (exr_run(&r, first->bytes, first->size) < 0) {
        if (r.fault.code != FAULT_EXR_TOO_LARGE)
            fprintf(stderr, "the output: %s: %s\n", r.fault.field, r.fault.text);
        must(r.fault.code == FAULT_EXR_TOO_LARGE);
        exr_run_finish(&r);
        return;
    }
    must(r.targets == first->targets && r.counts.chunks_copied == r.counts.chunks);
    const bool same = !first->edit && !first->grow && !first->float_out && first->options.compression == EXR_KEEP &&
                      first->options.pixels == EXR_PIXELS_KEEP && !strstr(first->notes, "lossy");
    must(!same || again == hash);
    exr_run_finish(&r);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const struct exr_limits limits = { SIDE_MAX, SIDE_MAX, 1 << 14, 1 << 20 };
    uint64_t hash = 0;
    struct exr_run r = { .limits = &limits, .ctx = &hash };
    if (size < FUZZ_EXR_BYTES)
        return 0;
    read_ways(&r, data);
    if (exr_run(&r, data + FUZZ_EXR_BYTES, size - FUZZ_EXR_BYTES) < 0)
        must(r.fault.code != FAULT_NONE && r.fault.code != FAULT_INTERNAL && *r.fault.text);
    else
        check_output(&r, hash);
    exr_run_finish(&r);
    return 0;
}
