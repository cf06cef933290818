// SPDX-License-Identifier: Apache-2.0
// cmd_exr.c - walks the headers of an EXR file: magic, version, then per part attributes (name, type, size, value) until an
// empty name; with several parts, an empty header ends them. The invariant: `at` never passes `end`, and an attribute's
// strings are terminated before it.
#include "cmd_exr.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "airy.h"

enum {
    HEADER_FIRST = 64 << 10, /* bytes read at first; then more, up to */
    HEADER_MAX = 64 << 20,
    NAME_BYTES = 256,
    PARTS_MAX = 1024,
    FLAG_LONG_NAMES = 0x400,
    FLAG_DEEP = 0x800,
    FLAG_PARTS = 0x1000,
    CHANNELS_MAX = 4096,
    RUN_MAX = 128,
    RLE = 1,
};
#define BLACK_MAX (UINT64_C(512) << 20)

/* ---- headers ------------------------------------------------------------------------------------- */

struct head {
    uint8_t *bytes; /* owned */
    const uint8_t *at, *end;
    bool whole; /* the file ends where `end` is */
    uint32_t version;
};

struct attr {
    const char *name, *type;
    const uint8_t *record, *data;
    uint32_t size;
};

static uint32_t u32(const uint8_t *p)
{
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static int32_t s32(const uint8_t *p) { return (int32_t)u32(p); }

/* The first `want` bytes of the file, or all that it has. */
static int head_read(struct head *h, int fd, size_t want)
{
    size_t got = 0;
    free(h->bytes);
    *h = (struct head){ .bytes = malloc(want) };
    while (h->bytes && got < want) {
        ssize_t n = pread(fd, h->bytes + got, want - got, (off_t)got);
        if (n < 0 && errno == EINTR)
            continue;
        if (n < 0)
            return -1;
        if (n == 0)
            break;
        got += (size_t)n;
    }
    if (got < 8 || memcmp(h->bytes, "\x76\x2f\x31\x01", 4) != 0)
        return -1;
    h->whole = got < want;
    h->end = h->bytes + got;
    h->at = h->bytes + 8;
    h->version = u32(h->bytes + 4);
    return (h->version & 0xff) == 2 ? 0 : -1;
}

static const char *name_take(struct head *h)
{
    size_t left = (size_t)(h->end - h->at);
    const char *name = (const char *)h->at;
    const uint8_t *zero = memchr(h->at, 0, left < NAME_BYTES ? left : NAME_BYTES);
    if (!zero)
        return NULL;
    h->at = zero + 1;
    return name;
}

/* 1: an attribute; 0: the end of a header; -1: cut off, or no header. */
static int attr_next(struct head *h, struct attr *a)
{
    a->record = h->at;
    a->name = name_take(h);
    if (!a->name || !*a->name)
        return a->name ? 0 : -1;
    a->type = name_take(h);
    if (!a->type || h->end - h->at < 4)
        return -1;
    a->size = u32(h->at);
    if (a->size > (size_t)(h->end - h->at) - 4)
        return -1;
    a->data = h->at + 4;
    h->at = a->data + a->size;
    return 1;
}

/* Calls for every attribute, with its part's number; the parts' number, or -1. */
static int walk(struct head *h, void (*each)(void *ctx, int part, const struct attr *a), void *ctx)
{
    struct attr a;
    int part = 0;
    h->at = h->bytes + 8;
    for (;; part++) {
        int got = attr_next(h, &a);
        if (got == 0 && part > 0)
            return part;
        for (; got == 1; got = attr_next(h, &a))
            each(ctx, part, &a);
        if (got < 0 || part == PARTS_MAX)
            return -1;
        if (!(h->version & FLAG_PARTS))
            return 1;
    }
}

static void nothing(void *ctx, int part, const struct attr *a) { (void)ctx, (void)part, (void)a; }

/* The parts' number, or -1: not a file whose headers are whole. h is the caller's to free in every case. */
static int head_open(struct head *h, int fd)
{
    *h = (struct head){ 0 };
    for (size_t want = HEADER_FIRST; want <= HEADER_MAX; want *= 8) {
        if (head_read(h, fd, want) < 0)
            return -1;
        int parts = walk(h, nothing, NULL);
        if (parts > 0 || h->whole)
            return parts;
    }
    return -1;
}

/* ---- stamps --------------------------------------------------------------------------------------- */

struct stamps {
    const char *wanted; /* NULL: any */
    size_t len;
    unsigned equal, other;
};

static void stamp_look(void *ctx, int part, const struct attr *a)
{
    struct stamps *s = ctx;
    (void)part;
    if (strcmp(a->name, "airy") != 0 || strcmp(a->type, "string") != 0)
        return;
    bool equal = !s->wanted || (a->size == s->len && memcmp(a->data, s->wanted, s->len) == 0);
    s->equal += equal;
    s->other += !equal;
}

static int file_open(const char *path)
{
    struct stat s;
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK); /* a FIFO must not hold us up */
    if (fd < 0 || (fstat(fd, &s) == 0 && S_ISREG(s.st_mode)))
        return fd;
    close(fd);
    errno = EINVAL;
    return -1;
}

static bool stamps_hold(const char *path, const char *wanted)
{
    struct stamps s = { .wanted = wanted, .len = wanted ? strlen(wanted) : 0 };
    struct head h = { 0 };
    int fd = file_open(path);
    if (fd < 0)
        return false;
    bool is_exr = head_open(&h, fd) > 0;
    if (is_exr)
        walk(&h, stamp_look, &s);
    free(h.bytes);
    close(fd);
    return is_exr && s.equal && !s.other;
}

bool exr_has_stamp(const char *path) { return stamps_hold(path, NULL); }
bool exr_is_stamped(const char *path, const char *stamp) { return *stamp && stamps_hold(path, stamp); }

/* ---- black ---------------------------------------------------------------------------------------- */

struct out {
    uint8_t *data; /* NULL: only counts */
    uint64_t used;
};

struct black_part {
    struct attr channels, window; /* window: the display window; data NULL: there is none */
    int32_t y0, y1;
    uint64_t width;
};

struct black {
    struct head h;
    struct black_part *part;
    int parts;
    struct out out;
    int open; /* the part whose attributes are coming; -1: none */
};

static void put(struct out *o, const void *data, size_t n)
{
    if (o->data)
        memcpy(o->data + o->used, data, n);
    o->used += n;
}

static void put_u32(struct out *o, uint32_t v)
{
    const uint8_t bytes[4] = { (uint8_t)v, (uint8_t)(v >> 8), (uint8_t)(v >> 16), (uint8_t)(v >> 24) };
    put(o, bytes, 4);
}

static void put_attr(struct out *o, const char *name, const char *type, const void *data, uint32_t size)
{
    put(o, name, strlen(name) + 1);
    put(o, type, strlen(type) + 1);
    put_u32(o, size);
    put(o, data, size);
}

static void part_collect(void *ctx, int part, const struct attr *a)
{
    struct black *b = ctx;
    if (strcmp(a->name, "channels") == 0 && strcmp(a->type, "chlist") == 0)
        b->part[part].channels = *a;
    if (strcmp(a->name, "displayWindow") == 0 && strcmp(a->type, "box2i") == 0 && a->size == 16)
        b->part[part].window = *a;
}

static uint64_t lines_of(const struct black_part *p) { return (uint64_t)((int64_t)p->y1 - p->y0 + 1); }

/* 0, or -1: what is needed of the part is not there. */
static int part_read(struct black_part *p)
{
    if (!p->channels.data || !p->window.data)
        return -1;
    int64_t x0 = s32(p->window.data), x1 = s32(p->window.data + 8);
    p->y0 = s32(p->window.data + 4);
    p->y1 = s32(p->window.data + 12);
    if (x1 < x0 || p->y1 < p->y0)
        return -1;
    p->width = (uint64_t)(x1 - x0 + 1);
    return p->width <= 1 << 20 && lines_of(p) <= 1 << 20 ? 0 : -1;
}

static int64_t floor_div(int64_t a, int64_t b) { return a / b - (a % b < 0); }

/* Bytes of line y; -1: the channel list is none. */
static int64_t line_bytes(const struct black_part *p, int32_t y)
{
    const uint8_t *at = p->channels.data, *end = at + p->channels.size;
    int64_t x0 = s32(p->window.data), x1 = x0 + (int64_t)p->width - 1, bytes = 0;
    for (unsigned n = 0; at < end && *at; n++) {
        const uint8_t *zero = memchr(at, 0, (size_t)(end - at));
        if (!zero || end - zero < 17 || n == CHANNELS_MAX)
            return -1;
        uint32_t type = u32(zero + 1);
        int32_t step_x = s32(zero + 9), step_y = s32(zero + 13);
        if (type > 2 || step_x < 1 || step_y < 1)
            return -1;
        if (y % step_y == 0)
            bytes += (floor_div(x1, step_x) - floor_div(x0 - 1, step_x)) * (type == 1 ? 2 : 4);
        at = zero + 17;
    }
    return at < end && p->channels.size > 1 ? bytes : -1;
}

/* OpenEXR's run lengths of a line of zeros, whose differences are one 0 and then 128s. */
static uint64_t rle_bytes(uint64_t raw) { return raw ? 2 + 2 * ((raw - 1 + RUN_MAX - 1) / RUN_MAX) : 0; }

static void put_line(struct out *o, uint64_t raw)
{
    uint64_t packed = rle_bytes(raw);
    const uint8_t literal[2] = { 0xff, 0 };
    if (packed >= raw) { /* kept as it is, as the format says; at most a few bytes */
        put_u32(o, (uint32_t)raw);
        for (uint64_t i = 0; i < raw; i++)
            put(o, "", 1);
        return;
    }
    put_u32(o, (uint32_t)packed);
    put(o, literal, 2);
    for (uint64_t left = raw - 1; left; left -= left < RUN_MAX ? left : RUN_MAX) {
        const uint8_t run[2] = { (uint8_t)((left < RUN_MAX ? left : RUN_MAX) - 1), 128 };
        put(o, run, 2);
    }
}

static void header_end(struct black *b)
{
    static const uint8_t compression = RLE, order = 0;
    const struct black_part *p = &b->part[b->open];
    put_attr(&b->out, "compression", "compression", &compression, 1);
    put_attr(&b->out, "lineOrder", "lineOrder", &order, 1);
    put_attr(&b->out, "dataWindow", "box2i", p->window.data, 16);
    if (b->h.version & FLAG_PARTS) {
        const uint32_t n = (uint32_t)lines_of(p);
        const uint8_t count[4] = { (uint8_t)n, (uint8_t)(n >> 8), (uint8_t)(n >> 16), (uint8_t)(n >> 24) };
        put_attr(&b->out, "type", "string", "scanlineimage", 13);
        put_attr(&b->out, "chunkCount", "int", count, 4);
    }
    put(&b->out, "", 1);
}

static void header_attr(void *ctx, int part, const struct attr *a)
{
    static const char *const kept[] = { "channels", "displayWindow", "pixelAspectRatio", "screenWindowCenter",
                                        "screenWindowWidth", "chromaticities", "name", "view", "multiView" };
    struct black *b = ctx;
    if (part != b->open && b->open >= 0)
        header_end(b);
    b->open = part;
    for (unsigned i = 0; i < sizeof(kept) / sizeof(kept[0]); i++)
        if (strcmp(a->name, kept[i]) == 0)
            put_attr(&b->out, a->name, a->type, a->data, a->size);
}

static void put_headers(struct black *b)
{
    put(&b->out, b->h.bytes, 4);
    put_u32(&b->out, 2 | (b->h.version & (FLAG_LONG_NAMES | FLAG_PARTS)));
    b->open = -1;
    walk(&b->h, header_attr, b);
    header_end(b);
    if (b->h.version & FLAG_PARTS)
        put(&b->out, "", 1);
}

/* The offset tables, then the chunks: `offset` is where the next chunk will be. */
static int put_chunks(struct black *b)
{
    const unsigned leader = b->h.version & FLAG_PARTS ? 12 : 8;
    uint64_t offset = b->out.used;
    for (int i = 0; i < b->parts; i++)
        offset += 8 * lines_of(&b->part[i]);
    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i < b->parts; i++)
            for (int64_t y = b->part[i].y0; y <= b->part[i].y1; y++) {
                int64_t raw = line_bytes(&b->part[i], (int32_t)y);
                if (raw < 0 || raw > INT32_MAX || offset > BLACK_MAX || b->out.used > BLACK_MAX)
                    return -1;
                if (pass == 0) {
                    put_u32(&b->out, (uint32_t)offset);
                    put_u32(&b->out, 0); /* BLACK_MAX is below 2^32 */
                    uint64_t packed = rle_bytes((uint64_t)raw);
                    offset += leader + (packed < (uint64_t)raw ? packed : (uint64_t)raw);
                    continue;
                }
                if (leader == 12)
                    put_u32(&b->out, (uint32_t)i);
                put_u32(&b->out, (uint32_t)y);
                put_line(&b->out, (uint64_t)raw);
            }
    return 0;
}

/* Once to count, once to write. */
static int black_write(struct black *b, char *why)
{
    struct airy_error e;
    void *map = NULL;
    b->out = (struct out){ 0 };
    put_headers(b);
    if (put_chunks(b) < 0)
        return -1;
    uint64_t size = b->out.used;
    int fd = airy_memfd(size, &map, &e);
    if (fd < 0) {
        snprintf(why, EXR_WHY_MAX, "a black frame: %.380s", e.text);
        return -1;
    }
    b->out = (struct out){ .data = map };
    put_headers(b);
    put_chunks(b);
    munmap(map, size);
    return fd;
}

static int black_read(struct black *b, int fd)
{
    b->parts = head_open(&b->h, fd);
    if (b->parts < 1 || (b->h.version & FLAG_DEEP))
        return -1;
    b->part = calloc((size_t)b->parts, sizeof(*b->part));
    if (!b->part)
        return -1;
    walk(&b->h, part_collect, b);
    for (int i = 0; i < b->parts; i++)
        if (part_read(&b->part[i]) < 0)
            return -1;
    return 0;
}

int exr_black(const char *path, char why[EXR_WHY_MAX])
{
    struct black b = { 0 };
    int black = -1, fd = file_open(path);
    if (fd < 0) {
        snprintf(why, EXR_WHY_MAX, "%.300s: %s", path, strerror(errno));
        return -1;
    }
    snprintf(why, EXR_WHY_MAX, "%.300s: an EXR file of flat parts and at most %u MiB expected, to make a black frame like it",
             path, (unsigned)(BLACK_MAX >> 20));
    if (black_read(&b, fd) == 0)
        black = black_write(&b, why);
    free(b.part);
    free(b.h.bytes);
    close(fd);
    return black;
}
