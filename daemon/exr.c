// SPDX-License-Identifier: Apache-2.0
// exr.c - the life of a struct exr: open, bind, close, and what it tells about itself.
#include "exr.h"

#include <assert.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "exr_internal.h"

static const char *const compression_words[] = { "none", "rle", "zips", "zip", "piz", "pxr24",
                                                 "b44", "b44a", "dwaa", "dwab" };

int exr_compression_parse(const char *word)
{
    if (!strcmp(word, "keep"))
        return EXR_KEEP;
    for (int i = 0; i <= EXR_DWAB; i++)
        if (!strcmp(word, compression_words[i]))
            return i;
    return INT_MIN;
}

const char *exr_part_title(const struct exr_part *p, char out[96])
{
    if (p->name)
        snprintf(out, 96, "part %u (%.*s)", p->index, (int)(p->name_bytes < 64 ? p->name_bytes : 64),
                 p->name);
    else
        snprintf(out, 96, "part %u", p->index);
    return out;
}

void exr_add_note(struct exr *x, const char *format, ...)
{
    if (x->notes == EXR_NOTES_MAX)
        return;
    va_list args;
    va_start(args, format);
    vsnprintf(x->note[x->notes], sizeof(x->note[0]), format, args);
    va_end(args);
    x->notes++;
}

unsigned exr_note_count(const struct exr *x) { return x->notes; }
const char *exr_note(const struct exr *x, unsigned i) { return x->note[i]; }

// ---- open ---------------------------------------------------------------------------------------------------

static int check_names(const struct exr *x, struct fault *f)
{
    for (unsigned i = 0; x->multipart && i < x->parts; i++)
        for (unsigned j = 0; j < i; j++)
            if (x->part[i].name_bytes == x->part[j].name_bytes &&
                !memcmp(x->part[i].name, x->part[j].name, x->part[i].name_bytes))
                return fault_set(f, FAULT_EXR_DAMAGED, "input", "parts %u and %u have the same name '%.*s'",
                                 j, i, (int)(x->part[i].name_bytes < 64 ? x->part[i].name_bytes : 64),
                                 x->part[i].name);
    return 0;
}

static int check_decoded(const struct exr *x, struct fault *f)
{
    uint64_t bytes = 0;
    for (unsigned i = 0; i < x->parts; i++)
        for (uint32_t k = 0; x->part[i].targets && k < x->part[i].chunks; k++)
            bytes += x->part[i].chunk[k].unpacked_bytes;
    if (bytes > x->limits.max_decoded_bytes)
        return fault_set(f, FAULT_EXR_TOO_LARGE, "input",
                         "the parts to be bloomed hold %llu bytes of pixels; at most %llu are taken",
                         (unsigned long long)bytes, (unsigned long long)x->limits.max_decoded_bytes);
    return 0;
}

// What is unpacked stays to the end; what is packed is never larger than unpacked, and lives twice while the file is put together;
// what is not touched is copied from the input.
uint64_t exr_work_bytes(const struct exr *x)
{
    uint64_t unpacked = 0, made = 0;
    for (unsigned i = 0; i < x->parts; i++)
        for (uint32_t k = 0; x->part[i].targets && k < x->part[i].chunks; k++)
            unpacked += x->part[i].chunk[k].unpacked_bytes;
    for (unsigned i = 0; i < x->targets; i++) {
        const struct exr_target *t = &x->target[i].pub;
        if (t->role == EXR_SCENE)
            made += (t->width + 2ull * t->grow) * (t->height + 2ull * t->grow) * t->channels * (1ull + x->options.extras) *
                    pixel_bytes(PIXEL_TYPE_FLOAT);
    }
    return x->size + 3 * unpacked + 2 * made;
}

// Under AddressSanitizer each chunk has memory of its own, so that it sees an overrun.
#if defined(__SANITIZE_ADDRESS__)
enum { SHARED_ROOM = 0 };
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
enum { SHARED_ROOM = 0 };
#else
enum { SHARED_ROOM = 1 };
#endif
#else
enum { SHARED_ROOM = 1 };
#endif

// A place for every chunk of level 0 that must be unpacked; each begins on a cache line.
static int make_room(struct exr *x, struct fault *f)
{
    if (!SHARED_ROOM)
        return 0;
    for (int pass = 0; pass < 2; pass++) {
        uint64_t at = 0;
        for (unsigned i = 0; i < x->parts; i++)
            for (uint32_t k = 0; x->part[i].targets && k < x->part[i].level0; k++) {
                struct exr_chunk *c = &x->part[i].chunk[k];
                if (c->packed_bytes == c->unpacked_bytes)
                    continue;
                if (pass)
                    c->room = x->arena.memory + at;
                at += (c->unpacked_bytes + 63) & ~UINT64_C(63);
            }
        if (!pass && exr_arena_init(&x->arena, at))
            return fault_set(f, FAULT_NO_MEMORY, "", "no memory for %llu bytes of pixels",
                             (unsigned long long)at);
    }
    return 0;
}

static int open_all(struct exr *x, const struct exr_select *select, struct fault *f)
{
    uint64_t tables;
    if (exr_parse_headers(x, &tables, f) || check_names(x, f))
        return -1;
    for (unsigned i = 0; i < x->parts; i++)
        if (exr_plan_chunks(x, &x->part[i], f))
            return -1;
    if (exr_read_tables(x, tables, f) || exr_select_targets(x, select, f) ||
        exr_select_companions(x, select, f) || exr_plan_channels(x, f) || check_decoded(x, f) ||
        exr_plan_decode(x, f) || make_room(x, f))
        return -1;
    for (unsigned i = 0; i < x->targets; i++)
        if (frame_scan_init(&x->target[i].pub.scan, x->target[i].pub.width, x->target[i].pub.height))
            return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the scan of %s",
                             x->target[i].pub.name);
    return 0;
}

int exr_open(struct exr **out, const void *bytes, uint64_t size, const struct exr_limits *limits,
             const struct exr_select *select, const struct exr_options *options, struct fault *f)
{
    struct exr *x = calloc(1, sizeof(*x));
    if (!x)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for a request");
    x->bytes = bytes;
    x->size = size;
    x->limits = *limits;
    assert(options->extras <= EXR_EXTRAS_MAX);
    x->options = *options;
    x->options.stamp = NULL;
    x->stamp = options->stamp ? strdup(options->stamp) : NULL;
    if (options->stamp && !x->stamp) {
        fault_set(f, FAULT_NO_MEMORY, "", "no memory for the stamp");
        goto fail;
    }
    if (open_all(x, select, f))
        goto fail;
    *out = x;
    return 0;
fail:
    exr_close(x);
    return -1;
}

static void part_finish(const struct exr *x, struct exr_part *p)
{
    for (uint32_t i = 0; p->chunk && i < p->chunks; i++)
        exr_drop_pixels(x, &p->chunk[i]);
    exr_encode_free(x, p);
    if (p->out_channel != p->channel)
        free(p->out_channel);
    free(p->extra_names);
    free(p->chunk);
    free(p->band);
    free(p->channel);
}

void exr_close(struct exr *x)
{
    if (!x)
        return;
    for (unsigned i = 0; i < x->parts; i++)
        part_finish(x, &x->part[i]);
    exr_arena_finish(&x->arena);
    for (unsigned i = 0; i < x->targets; i++) {
        frame_scan_finish(&x->target[i].pub.scan);
        for (unsigned c = 0; c < 3; c++)
            planes_free(&x->target[i].yc[c]);
    }
    free(x->part);
    free(x->target);
    free(x->decode_task);
    free(x->encode_task);
    free(x->stamp);
    free(x);
}

// ---- use ----------------------------------------------------------------------------------------------------

unsigned exr_target_count(const struct exr *x) { return x->targets; }
struct exr_target *exr_target(struct exr *x, unsigned i) { return &x->target[i].pub; }

void exr_bind(struct exr *x, unsigned target, const struct planes *in, const struct planes *out)
{
    struct exr_state *t = &x->target[target];
    t->in = *in;
    for (unsigned i = 0; i <= x->options.extras && t->pub.role == EXR_SCENE; i++)
        t->out[i] = out[i];
}

static int crop_one(struct exr_state *t, const struct exr_state *like, uint32_t x0, uint32_t y0, uint32_t x1, uint32_t y1)
{
    if (t->pub.part != like->pub.part)
        return 0;
    frame_scan_finish(&t->pub.scan);
    t->crop_x = x0;
    t->crop_y = y0;
    t->pub.min_x += (int32_t)x0;
    t->pub.min_y += (int32_t)y0;
    t->pub.width = x1 - x0;
    t->pub.height = y1 - y0;
    return frame_scan_init(&t->pub.scan, t->pub.width, t->pub.height);
}

int exr_crop(struct exr *x, unsigned target, uint32_t x0, uint32_t y0, uint32_t x1, uint32_t y1, struct fault *f)
{
    const struct exr_state *like = &x->target[target];
    assert(x0 < x1 && y0 < y1 && x1 <= like->pub.width && y1 <= like->pub.height && !like->crop_x && !like->crop_y);
    for (unsigned i = 0; i < x->targets; i++) {
        const struct exr_state *t = &x->target[i];
        // What is read for it lies in the same part or in one of the same window; of that only the whole can be had.
        const bool other = (like->pub.source == (int)i || like->pub.matte == (int)i || like->pub.depth == (int)i) &&
                           t->pub.part != like->pub.part;
        if (other || (t->pub.part == like->pub.part && t->luma_chroma))
            return 0;
    }
    for (unsigned i = 0; i < x->targets; i++)
        if (crop_one(&x->target[i], like, x0, y0, x1, y1))
            return fault_set(f, FAULT_NO_MEMORY, "", "no memory for a scan");
    return 1;
}

struct exr_counts exr_counts(const struct exr *x)
{
    struct exr_counts c = { .saturated = atomic_load(&x->saturated) };
    for (unsigned i = 0; i < x->parts; i++)
        c.chunks += x->part[i].changes ? x->part[i].outs : x->part[i].chunks;
    c.chunks_copied = c.chunks - atomic_load(&x->chunks_encoded);
    return c;
}
