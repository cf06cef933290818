// SPDX-License-Identifier: Apache-2.0
/*
 * exr_write.c - the output container: the input's own header bytes and chunks, with what had to change.
 *
 * Attributes are copied as raw records in their order, so that unknown types survive. Chunks go out in the
 * input file's order. Nothing here depends on when tasks ran.
 */
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "exr_internal.h"

static const char stamp_name[] = "airy";

// ---- headers ----------------------------------------------------------------------------------------------

struct buffer {
    uint8_t *data; // NULL: only counts
    uint64_t used;
};

static void put(struct buffer *b, const void *data, size_t n)
{
    if (b->data)
        memcpy(b->data + b->used, data, n);
    b->used += n;
}

static void put_number(struct buffer *b, uint32_t v)
{
    uint8_t bytes[4];
    exr_put_u32(bytes, v);
    put(b, bytes, 4);
}

static void put_stamp(struct buffer *b, const char *stamp)
{
    const size_t n = strlen(stamp);
    put(b, stamp_name, sizeof(stamp_name));
    put(b, "string", 7);
    put_number(b, (uint32_t)n);
    put(b, stamp, n);
}

// Values that were worked out of the old pixels.
static bool is_stale(const struct exr_attr *a)
{
    static const char *const words[] = { "sha-1", "sha1", "sha256", "sha-256", "md5", "checksum", "crc32",
                                         "xxhash", "oiio:AverageColor", "oiio:ConstantColor" };
    if (exr_attr_is(a, "preview", "preview"))
        return true;
    for (unsigned i = 0; i < sizeof(words) / sizeof(words[0]); i++)
        if (strcasestr(a->name, words[i]))
            return true;
    return false;
}

static uint32_t channels_bytes(const struct exr_part *p)
{
    uint64_t n = 1;
    for (unsigned i = 0; i < p->out_channels; i++)
        n += strlen(p->out_channel[i].name) + 1 + 16;
    return (uint32_t)n; // at most 4096 names of 256 bytes
}

// Entries of the input stay as they are but for the type.
static void put_channels(struct buffer *b, const struct exr_part *p, const struct exr_attr *a)
{
    put(b, a->record, (size_t)(a->data - a->record) - 4);
    put_number(b, channels_bytes(p));
    for (unsigned i = 0; i < p->out_channels; i++) {
        const struct exr_channel *c = &p->out_channel[i];
        const size_t name_bytes = strlen(c->name) + 1;
        put(b, c->name, name_bytes);
        put_number(b, c->out_type);
        if (c->from >= 0) {
            put(b, c->name + name_bytes + 4, 12);
        } else {
            put_number(b, 0);
            put_number(b, 1);
            put_number(b, 1);
        }
    }
    put(b, "", 1);
}

static void put_window(struct buffer *b, const struct exr_part *p)
{
    const uint32_t x = (uint32_t)p->min_x - p->grow, y = (uint32_t)p->min_y - p->grow;
    put_number(b, x);
    put_number(b, y);
    put_number(b, x + p->out_width - 1);
    put_number(b, y + p->out_height - 1);
}

static void put_attr(struct buffer *b, const struct exr_part *p, const struct exr_attr *a)
{
    const size_t leader = (size_t)(a->data - a->record);
    if ((p->retyped || p->extended) && exr_attr_is(a, "channels", "chlist")) {
        put_channels(b, p, a);
    } else if (p->changes && exr_attr_is(a, "compression", "compression")) {
        const uint8_t value = (uint8_t)p->out_compression;
        put(b, a->record, leader);
        put(b, &value, 1);
    } else if (p->changes && p->grow && exr_attr_is(a, "dataWindow", "box2i")) {
        put(b, a->record, leader);
        put_window(b, p);
    } else if (p->relayout && exr_attr_is(a, "chunkCount", "int")) {
        put(b, a->record, leader);
        put_number(b, p->outs);
    } else if (!p->changes || !is_stale(a)) {
        put(b, a->record, leader + a->bytes);
    }
}

// Readers refuse longer names of channels where the version does not announce them.
static bool has_long_names(const struct exr *x)
{
    for (unsigned i = 0; i < x->parts; i++)
        for (unsigned c = 0; c < x->part[i].out_channels; c++)
            if (x->part[i].out_channel[c].from < 0 && strlen(x->part[i].out_channel[c].name) > 31)
                return true;
    return false;
}

static void put_headers(struct buffer *b, const struct exr *x)
{
    put(b, x->bytes, 4);
    put_number(b, x->version_word | (has_long_names(x) ? EXR_FLAG_LONG_NAMES : 0));
    for (unsigned i = 0; i < x->parts; i++) {
        const struct exr_part *p = &x->part[i];
        const uint8_t *at = p->header, *end = p->header_end + 1;
        const bool stamped = x->stamp && p->scenes;
        bool done = false;
        struct exr_attr a;
        while (exr_attr_next(&at, end, &a, NULL) > 0) {
            if (!stamped || !exr_attr_is(&a, stamp_name, NULL)) {
                put_attr(b, p, &a);
            } else if (!done) {
                put_stamp(b, x->stamp);
                done = true;
            }
        }
        if (stamped && !done)
            put_stamp(b, x->stamp);
        put(b, "", 1);
    }
    if (x->multipart)
        put(b, "", 1);
}

void exr_note_dropped(struct exr *x, const struct exr_part *p)
{
    const uint8_t *at = p->header, *end = p->header_end + 1;
    char title[96];
    struct exr_attr a;
    while (p->changes && exr_attr_next(&at, end, &a, NULL) > 0)
        if (is_stale(&a))
            exr_add_note(x, "%s: attribute '%.64s' dropped: it was of the old pixels",
                         exr_part_title(p, title), a.name);
}

// ---- chunks -----------------------------------------------------------------------------------------------

struct place {
    uint64_t key; // where it, or what it was made of, lies in the input
    int64_t tie;
    unsigned part;
    uint32_t index;
};

static int place_order(const void *a, const void *b)
{
    const struct place *l = a, *r = b;
    if (l->key != r->key)
        return l->key < r->key ? -1 : 1;
    return l->tie < r->tie ? -1 : l->tie > r->tie;
}

static uint32_t part_chunks(const struct exr_part *p) { return p->changes ? p->outs : p->chunks; }

static bool is_copied(const struct exr_part *p, uint32_t i) { return !p->changes || !p->out[i].data; }

static uint64_t chunk_bytes(const struct exr *x, const struct exr_part *p, uint32_t i)
{
    return is_copied(p, i) ? p->chunk[i].bytes : exr_leader_bytes(x, p) + p->out[i].bytes;
}

static uint64_t count_chunks(const struct exr *x)
{
    uint64_t n = 0;
    for (unsigned i = 0; i < x->parts; i++)
        n += part_chunks(&x->part[i]);
    return n;
}

uint64_t exr_assembled_bytes(const struct exr *x)
{
    struct buffer b = { 0 };
    put_headers(&b, x);
    uint64_t bytes = b.used + 8 * count_chunks(x);
    for (unsigned i = 0; i < x->parts; i++)
        for (uint32_t k = 0; k < part_chunks(&x->part[i]); k++)
            bytes += chunk_bytes(x, &x->part[i], k);
    return bytes;
}

// Of what chunk k is made, and where it goes among those of the same origin.
static struct place place_of(struct exr_part *p, uint32_t k)
{
    struct place at = { .tie = p->line_order == 1 ? -(int64_t)k : (int64_t)k, .part = p->index, .index = k };
    if (p->changes && p->grow) { // of no one chunk: all together where the part's first is
        const struct exr_out_chunk *o = &p->out[k];
        at.key = p->chunk[0].at;
        if (p->line_order == 1) // rows from below, but tiles from the left
            at.tie = (int64_t)o->tile_x - (int64_t)o->tile_y * (int64_t)p->out_width;
        return at;
    }
    at.key = (p->changes && p->relayout ? exr_scanline_chunk(p, p->out[k].row) : &p->chunk[k])->at;
    return at;
}

static void order_chunks(struct exr *x, struct place *places)
{
    uint64_t n = 0;
    bool sorted = true;
    for (unsigned i = 0; i < x->parts; i++)
        for (uint32_t k = 0; k < part_chunks(&x->part[i]); k++, n++) {
            places[n] = place_of(&x->part[i], k);
            sorted &= !n || place_order(&places[n - 1], &places[n]) < 0;
        }
    if (!sorted)
        qsort(places, n, sizeof(*places), place_order);
}

static void fill_tables(const struct exr *x, const struct place *places, uint64_t n, uint8_t *table,
                        uint64_t at)
{
    uint64_t first[EXR_PARTS_MAX], sum = 0;
    for (unsigned i = 0; i < x->parts; i++) {
        first[i] = sum;
        sum += part_chunks(&x->part[i]);
    }
    for (uint64_t i = 0; i < n; i++) {
        exr_put_u64(table + 8 * (first[places[i].part] + places[i].index), at);
        at += chunk_bytes(x, &x->part[places[i].part], places[i].index);
    }
}

static unsigned make_leader(const struct exr *x, const struct exr_part *p, uint32_t i, uint8_t out[24])
{
    unsigned n = 0;
    if (x->multipart) {
        exr_put_u32(out, p->index);
        n = 4;
    }
    if (p->storage == EXR_TILED) {
        const struct exr_out_chunk *o = &p->out[i];
        const uint32_t v[4] = { o->tile_x, o->tile_y, o->level_x, o->level_y };
        for (unsigned c = 0; c < 4; c++, n += 4)
            exr_put_u32(out + n, v[c]);
    } else {
        exr_put_u32(out + n, (uint32_t)p->min_y - p->grow + p->out[i].row);
        n += 4;
    }
    exr_put_u32(out + n, (uint32_t)p->out[i].bytes);
    return n + 4;
}

struct sink {
    int (*write)(void *ctx, const void *data, size_t len);
    void *ctx;
};

// Copied chunks that are neighbours in the input go out as one piece.
static int write_chunks(const struct exr *x, const struct place *places, uint64_t n, const struct sink *s)
{
    for (uint64_t i = 0; i < n; i++) {
        const struct exr_part *p = &x->part[places[i].part];
        uint8_t leader[24];
        int result;
        if (!is_copied(p, places[i].index)) {
            const struct exr_out_chunk *o = &p->out[places[i].index];
            result = s->write(s->ctx, leader, make_leader(x, p, places[i].index, leader));
            if (!result)
                result = s->write(s->ctx, o->data, o->bytes);
        } else {
            const uint64_t at = p->chunk[places[i].index].at;
            uint64_t bytes = p->chunk[places[i].index].bytes;
            while (i + 1 < n) {
                const struct exr_part *q = &x->part[places[i + 1].part];
                if (!is_copied(q, places[i + 1].index) || q->chunk[places[i + 1].index].at != at + bytes)
                    break;
                bytes += q->chunk[places[++i].index].bytes;
            }
            result = s->write(s->ctx, x->bytes + at, bytes);
        }
        if (result)
            return result;
    }
    return 0;
}

int exr_assemble(struct exr *x, int (*write)(void *ctx, const void *data, size_t len), void *ctx,
                 struct fault *f)
{
    const struct sink sink = { write, ctx };
    const uint64_t n = count_chunks(x);
    struct buffer b = { 0 };
    put_headers(&b, x);
    const uint64_t head = b.used + 8 * n;
    struct place *places = malloc(n * sizeof(*places));
    b = (struct buffer){ .data = malloc(head) };
    int result = -1;
    if (!places || !b.data) {
        fault_set(f, FAULT_NO_MEMORY, "", "no memory for the output's header");
        goto fail;
    }
    put_headers(&b, x);
    order_chunks(x, places);
    fill_tables(x, places, n, b.data + b.used, head);
    result = write(ctx, b.data, head);
    if (!result)
        result = write_chunks(x, places, n, &sink);
    if (result)
        fault_set(f, result == -ENOSPC || result == -EFBIG || result == -ENOMEM ? FAULT_NO_MEMORY : FAULT_INTERNAL, "output",
                  "the output could not be written: %s", strerror(-result));
fail:
    free(places);
    free(b.data);
    return result ? -1 : 0;
}
