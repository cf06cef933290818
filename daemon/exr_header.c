// SPDX-License-Identifier: Apache-2.0
/*
 * exr_header.c - headers of all parts, strictly.
 *
 * Invariant: nothing is allocated by a number that the file states; every pointer kept lies in the
 * caller's bytes. Attributes that we do not need are only stepped over: the output takes them as they
 * are.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "exr_internal.h"

enum {
    FLAG_TILED = 0x200, FLAG_DEEP = 0x800, FLAG_MULTIPART = 0x1000,
    NAME_MAX_BYTES = 255,
};

static int damaged(struct fault *f, const char *what)
{
    return fault_set(f, FAULT_EXR_DAMAGED, "input", "%s", what);
}

// A NUL-terminated name in [*at, end).
static const char *name_next(const uint8_t **at, const uint8_t *end)
{
    size_t room = (size_t)(end - *at);
    const uint8_t *nul = memchr(*at, 0, room < NAME_MAX_BYTES + 1 ? room : NAME_MAX_BYTES + 1);
    if (!nul)
        return NULL;
    const char *name = (const char *)*at;
    *at = nul + 1;
    return name;
}

int exr_attr_next(const uint8_t **at, const uint8_t *end, struct exr_attr *a, struct fault *f)
{
    const uint8_t *p = *at;
    if (p >= end)
        return damaged(f, "the header has no end: the file is truncated");
    if (!*p) {
        *at = p + 1;
        return 0;
    }
    *a = (struct exr_attr){ .record = p };
    a->name = name_next(&p, end);
    a->type = a->name ? name_next(&p, end) : NULL;
    if (!a->type || !*a->type)
        return fault_set(f, FAULT_EXR_DAMAGED, "input",
                         "an attribute of the header has no proper name and type (at most %d bytes each)",
                         NAME_MAX_BYTES);
    if (end - p < 4)
        return damaged(f, "the file ends inside its header");
    a->bytes = exr_u32(p);
    p += 4;
    if (a->bytes > INT32_MAX || a->bytes > (size_t)(end - p))
        return fault_set(f, FAULT_EXR_DAMAGED, "input",
                         "header attribute '%.64s' says %u bytes, the file has %zu left", a->name,
                         a->bytes, (size_t)(end - p));
    a->data = p;
    *at = p + a->bytes;
    return 1;
}

bool exr_attr_is(const struct exr_attr *a, const char *name, const char *type)
{
    return !strcmp(a->name, name) && (!type || !strcmp(a->type, type));
}

// ---- single attributes --------------------------------------------------------------------------------

static int parse_channels(struct exr_part *p, const struct exr_attr *a, struct fault *f)
{
    const uint8_t *at = a->data, *end = a->data + a->bytes;
    unsigned n = 0, room = 0;
    while (at < end && *at) {
        if (n == EXR_CHANNELS_MAX)
            return fault_set(f, FAULT_EXR_TOO_LARGE, "input", "part %u has more than %d channels",
                             p->index, EXR_CHANNELS_MAX);
        if (n == room) {
            room = room ? room * 2 : 16;
            struct exr_channel *more = realloc(p->channel, room * sizeof(*more));
            if (!more)
                return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the channel list");
            p->channel = more;
        }
        const char *name = name_next(&at, end);
        if (!name || end - at < 16)
            return damaged(f, "attribute 'channels' is cut short");
        uint32_t type = exr_u32(at), xs = exr_u32(at + 8), ys = exr_u32(at + 12);
        if (type > PIXEL_TYPE_FLOAT)
            return fault_set(f, FAULT_EXR_DAMAGED, "input",
                             "channel '%.64s' has pixel type %u; 0, 1 and 2 exist", name, type);
        if (xs < 1 || ys < 1 || xs > 65536 || ys > 65536)
            return fault_set(f, FAULT_EXR_DAMAGED, "input", "channel '%.64s' has sampling %d x %d",
                             name, (int)xs, (int)ys);
        if (n && strcmp(p->channel[n - 1].name, name) >= 0)
            return fault_set(f, FAULT_EXR_DAMAGED, "input",
                             "channel '%.64s' comes twice or not in order of names", name);
        p->channel[n] = (struct exr_channel){
            .name = name, .type = (uint8_t)type, .out_type = (uint8_t)type, .linear = at[4],
            .x_sampling = (int32_t)xs, .y_sampling = (int32_t)ys, .from = (int)n, .target = -1 };
        p->channels = ++n;
        p->y_sampled |= ys > 1;
        at += 16;
    }
    if (at + 1 != end)
        return damaged(f, "attribute 'channels' has no proper end");
    if (!n)
        return fault_set(f, FAULT_EXR_DAMAGED, "input", "part %u has no channels", p->index);
    return 0;
}

static int parse_window(struct exr_part *p, const struct exr_attr *a, struct fault *f)
{
    const bool display = exr_attr_is(a, "displayWindow", NULL);
    int64_t v[4];
    for (int i = 0; i < 4; i++)
        v[i] = (int32_t)exr_u32(a->data + 4 * i);
    const int64_t far = INT32_MAX / 2;
    if (v[0] > v[2] || v[1] > v[3] || v[0] <= -far || v[1] <= -far || v[2] >= far || v[3] >= far)
        return fault_set(f, FAULT_EXR_DAMAGED, "input",
                         "%s of part %u is (%lld %lld) - (%lld %lld), which is no window", a->name, p->index,
                         (long long)v[0], (long long)v[1], (long long)v[2], (long long)v[3]);
    if (display) {
        p->display_x = (int32_t)v[0];
        p->display_y = (int32_t)v[1];
        p->display_width = (uint32_t)(v[2] - v[0] + 1);
        p->display_height = (uint32_t)(v[3] - v[1] + 1);
        return 0;
    }
    p->min_x = (int32_t)v[0];
    p->min_y = (int32_t)v[1];
    p->width = (uint32_t)(v[2] - v[0] + 1);
    p->height = (uint32_t)(v[3] - v[1] + 1);
    return 0;
}

// Each view is looked for among all channels: so their number is bounded, like that of channels.
static int parse_views(struct exr_part *p, const struct exr_attr *a, struct fault *f)
{
    const uint8_t *at = a->data, *end = a->data + a->bytes;
    const char *view;
    uint32_t bytes, n = 0;
    while (exr_next_view(&at, end, &view, &bytes))
        if (++n > EXR_VIEWS_MAX)
            return fault_set(f, FAULT_EXR_TOO_LARGE, "input", "attribute 'multiView' of part %u has more than %d views",
                             p->index, EXR_VIEWS_MAX);
    p->multi_view = a->data;
    p->multi_view_bytes = a->bytes;
    return 0;
}

static int parse_tiles(struct exr_part *p, const struct exr_attr *a, struct fault *f)
{
    uint32_t w = exr_u32(a->data), h = exr_u32(a->data + 4);
    unsigned mode = a->data[8] & 15, round = a->data[8] >> 4;
    if (!w || !h || w > INT32_MAX || h > INT32_MAX || mode > 2 || round > 1)
        return fault_set(f, FAULT_EXR_DAMAGED, "input",
                         "attribute 'tiles' of part %u says %u x %u, level mode %u, rounding %u", p->index,
                         w, h, mode, round);
    p->tile_width = w;
    p->tile_height = h;
    p->level_mode = mode;
    p->round_up = round;
    return 0;
}

static float f32(const uint8_t *p)
{
    uint32_t u = exr_u32(p);
    float v;
    memcpy(&v, &u, 4);
    return v;
}

enum seen { CHANNELS = 1, COMPRESSION = 2, WINDOW = 4, TILES = 8, CHUNKS = 16, TYPE = 32, NAME = 64,
            DISPLAY = 8192 };

struct known {
    const char *name, *type;
    uint32_t bytes; // 0: any
    unsigned bit;
};

static const struct known known[] = {
    { "channels", "chlist", 0, CHANNELS },       { "compression", "compression", 1, COMPRESSION },
    { "dataWindow", "box2i", 16, WINDOW },       { "tiles", "tiledesc", 9, TILES },
    { "chunkCount", "int", 4, CHUNKS },          { "type", "string", 0, TYPE },
    { "name", "string", 0, NAME },               { "lineOrder", "lineOrder", 1, 128 },
    { "pixelAspectRatio", "float", 4, 256 },     { "chromaticities", "chromaticities", 32, 512 },
    { "view", "string", 0, 1024 },               { "multiView", "stringvector", 0, 2048 },
    { "dwaCompressionLevel", "float", 4, 4096 }, { "displayWindow", "box2i", 16, DISPLAY },
};

static int store(struct exr_part *p, unsigned bit, const struct exr_attr *a, struct fault *f)
{
    switch (bit) {
    case CHANNELS:
        return parse_channels(p, a, f);
    case COMPRESSION:
        p->compression = p->out_compression = a->data[0];
        if (p->compression > EXR_DWAB)
            return fault_set(f, FAULT_EXR_UNSUPPORTED, "input",
                             "part %u has compression %d; 0 (none) to 9 (dwab) are known", p->index,
                             p->compression);
        return 0;
    case WINDOW:
    case DISPLAY:
        return parse_window(p, a, f);
    case TILES:
        return parse_tiles(p, a, f);
    case CHUNKS:
        p->chunk_count_attr = (int32_t)exr_u32(a->data);
        return 0;
    case TYPE:
        p->type = (const char *)a->data;
        return 0;
    case NAME:
        p->name = (const char *)a->data;
        p->name_bytes = a->bytes;
        return 0;
    case 128:
        p->line_order = a->data[0];
        return 0;
    case 256:
        p->pixel_aspect = f32(a->data);
        return 0;
    case 512:
        p->has_chromaticities = true;
        for (int i = 0; i < 8; i++)
            p->chromaticities[i] = f32(a->data + 4 * i);
        return 0;
    case 1024:
        p->view = (const char *)a->data;
        p->view_bytes = a->bytes;
        return 0;
    case 2048:
        return parse_views(p, a, f);
    default:
        p->dwa_level = f32(a->data);
        return 0;
    }
}

// ---- one header -----------------------------------------------------------------------------------------

static int storage_of(const struct exr *x, struct exr_part *p, uint32_t type_bytes, struct fault *f)
{
    static const char *const words[] = { "scanlineimage", "tiledimage", "deepscanline", "deeptile" };
    int found = -1;
    for (int i = 0; i < 4; i++)
        if (p->type && type_bytes == strlen(words[i]) && !memcmp(p->type, words[i], type_bytes))
            found = i;
    const bool deep = x->version_word & FLAG_DEEP;
    if (!x->multipart && !deep) // the version's flag rules, as in every other reader
        found = x->tiled_flag ? EXR_TILED : EXR_SCANLINE;
    if (found < 0)
        return fault_set(f, p->type ? FAULT_EXR_UNSUPPORTED : FAULT_EXR_DAMAGED, "input",
                         "part %u has type '%.*s'; scanlineimage, tiledimage, deepscanline and deeptile "
                         "are known", p->index, p->type ? (int)(type_bytes < 64 ? type_bytes : 64) : 0,
                         p->type ? p->type : "");
    p->storage = (enum exr_storage)found;
    if (found >= EXR_DEEP_SCANLINE && !deep)
        return fault_set(f, FAULT_EXR_DAMAGED, "input",
                         "part %u is deep, but the file's version field says that none is", p->index);
    return 0;
}

static int check_required(const struct exr *x, struct exr_part *p, unsigned seen, struct fault *f)
{
    const bool tiled = p->storage == EXR_TILED || p->storage == EXR_DEEP_TILED;
    unsigned need = CHANNELS | COMPRESSION | WINDOW | (tiled ? TILES : 0);
    if (x->multipart)
        need |= TYPE | NAME | CHUNKS;
    for (unsigned i = 0; i < sizeof(known) / sizeof(known[0]); i++)
        if (need & ~seen & known[i].bit)
            return fault_set(f, FAULT_EXR_DAMAGED, "input", "part %u has no attribute '%s'", p->index,
                             known[i].name);
    for (unsigned i = 0; i < p->channels; i++) {
        const struct exr_channel *c = &p->channel[i];
        if (tiled && (c->x_sampling != 1 || c->y_sampling != 1))
            return fault_set(f, FAULT_EXR_DAMAGED, "input",
                             "channel '%.64s' of a tiled part is subsampled", c->name);
        if (p->min_x % c->x_sampling || p->min_y % c->y_sampling ||
            p->width % (uint32_t)c->x_sampling || p->height % (uint32_t)c->y_sampling)
            return fault_set(f, FAULT_EXR_DAMAGED, "input",
                             "channel '%.64s': the data window's corner and size are no multiples of its "
                             "sampling %d x %d", c->name, c->x_sampling, c->y_sampling);
    }
    if (!(p->pixel_aspect >= 1e-6f && p->pixel_aspect <= 1e6f))
        return fault_set(f, FAULT_EXR_DAMAGED, "input",
                         "pixelAspectRatio of part %u is %g; 1e-6 to 1e6 was expected", p->index,
                         (double)p->pixel_aspect);
    if (!(p->dwa_level >= 0 && p->dwa_level <= 1e6f))
        return fault_set(f, FAULT_EXR_DAMAGED, "input", "dwaCompressionLevel of part %u is %g",
                         p->index, (double)p->dwa_level);
    return 0;
}

static int parse_header(struct exr *x, struct exr_part *p, const uint8_t **at, unsigned *attributes,
                        struct fault *f)
{
    const uint8_t *end = x->bytes + x->size;
    unsigned seen = 0;
    uint32_t type_bytes = 0;
    struct exr_attr a;
    int more;
    p->header = *at;
    while ((more = exr_attr_next(at, end, &a, f)) > 0) {
        if (++*attributes > EXR_ATTRIBUTES_MAX)
            return fault_set(f, FAULT_EXR_TOO_LARGE, "input", "the header has more than %d attributes",
                             EXR_ATTRIBUTES_MAX);
        for (unsigned i = 0; i < sizeof(known) / sizeof(known[0]); i++) {
            if (strcmp(a.name, known[i].name))
                continue;
            if (strcmp(a.type, known[i].type) || (known[i].bytes && a.bytes != known[i].bytes))
                return fault_set(f, FAULT_EXR_DAMAGED, "input",
                                 "attribute '%s' of part %u is %u bytes of type '%.32s'; '%s' was "
                                 "expected", a.name, p->index, a.bytes, a.type, known[i].type);
            if (seen & known[i].bit)
                return fault_set(f, FAULT_EXR_DAMAGED, "input", "attribute '%s' comes twice in part %u",
                                 a.name, p->index);
            seen |= known[i].bit;
            if (known[i].bit == TYPE)
                type_bytes = a.bytes;
            if (store(p, known[i].bit, &a, f))
                return -1;
        }
    }
    if (more < 0)
        return -1;
    p->header_end = *at - 1;
    if (!(seen & DISPLAY)) {
        p->display_x = p->min_x;
        p->display_y = p->min_y;
        p->display_width = p->width;
        p->display_height = p->height;
    }
    if (storage_of(x, p, type_bytes, f) || check_required(x, p, seen, f))
        return -1;
    return 0;
}

static int check_version(struct exr *x, struct fault *f)
{
    static const uint8_t magic[4] = { 0x76, 0x2f, 0x31, 0x01 };
    if (x->size < 8 || memcmp(x->bytes, magic, 4))
        return fault_set(f, FAULT_NOT_EXR, "input",
                         "the payload (%llu bytes) does not begin with OpenEXR's magic number 76 2f 31 01",
                         (unsigned long long)x->size);
    x->version_word = exr_u32(x->bytes + 4);
    const uint32_t flags = FLAG_TILED | EXR_FLAG_LONG_NAMES | FLAG_DEEP | FLAG_MULTIPART;
    if ((x->version_word & 0xff) != 2 || x->version_word & ~(0xffu | flags))
        return fault_set(f, FAULT_EXR_UNSUPPORTED, "input",
                         "the file's version field is 0x%x; version 2 with flags 0x%x was expected",
                         x->version_word, flags);
    x->multipart = x->version_word & FLAG_MULTIPART;
    x->tiled_flag = x->version_word & FLAG_TILED;
    if (x->tiled_flag && x->version_word & (FLAG_DEEP | FLAG_MULTIPART))
        return damaged(f, "the version field says single-part tiled and also deep or multipart");
    return 0;
}

static int add_part(struct exr *x, struct fault *f)
{
    if (x->parts == EXR_PARTS_MAX)
        return fault_set(f, FAULT_EXR_TOO_LARGE, "input", "the file has more than %d parts",
                         EXR_PARTS_MAX);
    struct exr_part *more = realloc(x->part, (x->parts + 1) * sizeof(*more));
    if (!more)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the list of parts");
    x->part = more;
    memset(&more[x->parts], 0, sizeof(*more));
    more[x->parts].index = x->parts;
    more[x->parts].pixel_aspect = 1;
    more[x->parts].dwa_level = 45;
    more[x->parts].chunk_count_attr = -1;
    x->parts++;
    return 0;
}

int exr_parse_headers(struct exr *x, uint64_t *tables, struct fault *f)
{
    if (check_version(x, f))
        return -1;
    const uint8_t *at = x->bytes + 8, *end = x->bytes + x->size;
    unsigned attributes = 0;
    do {
        if (add_part(x, f) || parse_header(x, &x->part[x->parts - 1], &at, &attributes, f))
            return -1;
        if (x->multipart && at >= end)
            return damaged(f, "the headers have no end: the file is truncated");
    } while (x->multipart && *at);
    if (x->multipart)
        at++;
    *tables = (uint64_t)(at - x->bytes);
    return 0;
}
