/* SPDX-License-Identifier: Apache-2.0 */
/*
 * exr_internal.h - what the files of the exr room share.
 *
 *     exr_header.c   bytes -> struct exr_part: headers, strictly
 *     exr_chunk.c    geometry of chunks and levels, offset tables checked against the file
 *     exr_select.c   parts, layers, views -> targets
 *     exr_codec.c    one chunk: packed <-> unpacked (exr_zip.c, exr_dwa.cc, OpenEXRCore)
 *     exr_decode.c   decode tasks: unpacked rows -> planes
 *     exr_encode.c   encode tasks: planes -> unpacked rows -> packed
 *     exr_mip.c      the lower levels of tiled parts        exr_yc.c   luminance-chroma
 *     exr_write.c    the output container                   exr_arena.c  memory of chunks
 *     exr.c          open, close, bind, notes
 *
 * The header is read by our own strict parser, once, because the output needs its raw bytes: nothing that
 * came from outside ever reaches the header parsers of the libraries, which see only the synthetic
 * headers that exr_codec.c and exr_dwa.cc make. So every size, count and coordinate that bounds memory
 * or an index is checked here, in one place.
 *
 * "Unpacked" is the file format's own layout of a chunk: row by row, and in each row channel by channel
 * in order of their names, little-endian. Channels with y sampling > 1 are absent from other rows.
 */
#ifndef AIRYD_EXR_INTERNAL_H
#define AIRYD_EXR_INTERNAL_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "exr.h"
#include "exr_codec.h"

enum {
    EXR_CHANNELS_MAX = 4096,      /* of one part */
    EXR_PARTS_MAX = 1024,
    EXR_ATTRIBUTES_MAX = 16384,   /* of one file */
    EXR_LEVELS_MAX = 32,
    EXR_TARGETS_MAX = 16,         /* as BLOOM_TARGETS_MAX */
    EXR_NOTES_MAX = 32,
    EXR_NOTE_BYTES = 200,
};

enum exr_storage { EXR_SCANLINE, EXR_TILED, EXR_DEEP_SCANLINE, EXR_DEEP_TILED };

struct exr_channel {
    const char *name;      /* in the input's bytes, NUL-terminated there */
    uint8_t type;          /* enum pixel_type, in the input */
    uint8_t out_type;      /* in the output */
    uint8_t linear;        /* pLinear: B44's hint */
    int32_t x_sampling, y_sampling;
    int target;            /* of struct exr, -1: carried over */
    unsigned plane;        /* of that target; for luminance-chroma 0 Y, 1 RY, 2 BY */
};

/* Memory for unpacked chunks, from a cache of the process. */
struct exr_arena {
    uint8_t *memory;
    uint64_t bytes;
};

/* One chunk of the input. */
struct exr_chunk {
    uint64_t at, bytes;        /* the whole chunk in the input: leader and payload */
    uint64_t packed_at, packed_bytes;
    uint64_t unpacked_bytes;
    uint32_t tile_x, tile_y;   /* tiled */
    uint8_t level_x, level_y;
    uint32_t x, y;             /* first pixel in its level, from the data window's corner */
    uint32_t width, height;
    uint8_t *pixels;           /* unpacked; NULL: not decoded. Owned unless in the input or the arena. */
    uint8_t *room;             /* its place in the arena; NULL: none */
};

/* One chunk of the output: the input's `copy`, or data of our own. */
struct exr_out_chunk {
    uint8_t *data;             /* the payload without leader; NULL: copied. Owned unless in the arena. */
    uint64_t bytes;
    uint32_t row, rows;        /* scanline parts */
};

struct exr_band;

struct exr_part {
    unsigned index;
    const uint8_t *header, *header_end; /* raw attributes, without the final NUL */
    const char *name, *type, *view;     /* into the input; name is NULL when absent */
    uint32_t name_bytes, view_bytes;    /* attribute strings have no NUL */
    const uint8_t *multi_view;          /* the stringvector's bytes */
    uint32_t multi_view_bytes;
    enum exr_storage storage;
    int compression, out_compression;
    float dwa_level;
    unsigned line_order;
    int32_t min_x, min_y;
    uint32_t width, height;
    uint32_t tile_width, tile_height;
    unsigned level_mode, round_up;      /* 0 one, 1 mip, 2 rip */
    unsigned levels_x, levels_y;
    float pixel_aspect;
    bool has_chromaticities;
    float chromaticities[8];
    int64_t chunk_count_attr;           /* -1: absent */

    struct exr_channel *channel;
    unsigned channels;
    bool y_sampled;                     /* some channel has y sampling > 1 */

    struct exr_chunk *chunk;            /* in the offset table's order */
    uint32_t chunks;
    uint32_t level0;                    /* chunks of level 0: the first ones */
    struct exr_band *band;              /* of level 0: rows complete together */
    uint32_t bands;
    _Atomic uint32_t chunks_left;       /* level 0 still to decode: for luminance-chroma */

    unsigned targets;                   /* how many look into this part */
    bool changes;                       /* encode: some chunk may differ */
    bool relayout;                      /* encode: other rows per chunk than the input */
    bool retyped;                       /* encode: some channel changes its type */
    struct exr_out_chunk *out;
    uint32_t outs;
    struct exr_delta *delta;            /* mip levels: what is to be added */
};

/* Rows whose chunks are in when `left` is 0; whoever makes it so scans them. */
struct exr_band {
    uint32_t row, rows;
    _Atomic uint32_t left;
};

/* A run of chunks that one task does. */
struct exr_task {
    unsigned part;
    uint32_t band;             /* decode */
    uint32_t first, count;
};

struct exr_state {
    struct exr_target pub;
    bool luma_chroma;
    uint8_t chroma_sampling;   /* 1 or 2 */
    struct planes in, out;
    struct planes yc[3];       /* encode of luminance-chroma: Y, RY, BY to be stored */
    bool untouched;
};

struct exr {
    const uint8_t *bytes;
    uint64_t size;
    bool multipart, tiled_flag;
    uint32_t version_word;
    struct exr_limits limits;
    struct exr_options options;
    char *stamp;
    struct exr_part *part;
    unsigned parts;
    struct exr_state *target;
    unsigned targets;
    struct exr_arena arena;
    struct exr_task *decode_task, *encode_task;
    unsigned decode_tasks, encode_tasks;
    _Atomic uint64_t saturated;
    _Atomic uint32_t chunks_encoded;
    unsigned notes;
    char note[EXR_NOTES_MAX][EXR_NOTE_BYTES];
};

static inline bool exr_in_input(const struct exr *x, const void *p)
{
    return (uintptr_t)p - (uintptr_t)x->bytes < x->size;
}

/* ---- bytes ---- */
static inline uint32_t exr_u32(const uint8_t *p)
{
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}
static inline uint64_t exr_u64(const uint8_t *p)
{
    return exr_u32(p) | (uint64_t)exr_u32(p + 4) << 32;
}
static inline void exr_put_u32(uint8_t *p, uint32_t v)
{
    for (int i = 0; i < 4; i++)
        p[i] = (uint8_t)(v >> 8 * i);
}
static inline void exr_put_u64(uint8_t *p, uint64_t v)
{
    exr_put_u32(p, (uint32_t)v);
    exr_put_u32(p + 4, (uint32_t)(v >> 32));
}

/* ---- exr.c ---- */
void exr_add_note(struct exr *x, const char *format, ...) __attribute__((format(printf, 2, 3)));
/* "part 1 (rgba_right)", for faults. */
const char *exr_part_title(const struct exr_part *p, char out[96]);

/* ---- exr_arena.c ---- */
int exr_arena_init(struct exr_arena *a, uint64_t bytes); /* 0, or -1: no memory */
void exr_arena_finish(struct exr_arena *a);
static inline bool exr_arena_has(const struct exr_arena *a, const void *p)
{
    return (uintptr_t)p - (uintptr_t)a->memory < a->bytes;
}

/* ---- exr_header.c ---- */
struct exr_attr {
    const char *name, *type;
    const uint8_t *record; /* where it begins */
    const uint8_t *data;
    uint32_t bytes;
};
/* The next attribute of [*at, end): 1, 0 at the list's NUL (*at is then past it), -1 and *f. */
int exr_attr_next(const uint8_t **at, const uint8_t *end, struct exr_attr *a, struct fault *f);
bool exr_attr_is(const struct exr_attr *a, const char *name, const char *type);
/* Parses all headers; *tables is where the offset tables begin. */
int exr_parse_headers(struct exr *x, uint64_t *tables, struct fault *f);

/* ---- exr_chunk.c ---- */
unsigned exr_lines_per_chunk(int compression);
uint32_t exr_level_size(uint32_t size, unsigned level, bool round_up);
/* Rows [y, y + rows) of a channel that a sampling of `s` keeps; y counts from the window's corner,
 * which is a multiple of s. */
static inline uint32_t exr_sampled(uint32_t y, uint32_t rows, uint32_t s)
{
    return (y + rows + s - 1) / s - (y + s - 1) / s;
}
/* Bytes of row y (from the corner), `width` pixels wide. */
uint64_t exr_row_bytes(const struct exr_part *p, uint32_t width, uint32_t y, bool out);
uint64_t exr_rows_bytes(const struct exr_part *p, uint32_t width, uint32_t y, uint32_t rows, bool out);
/* Geometry and limits of one part: fills chunks (without offsets), levels. */
int exr_plan_chunks(struct exr *x, struct exr_part *p, struct fault *f);
/* Reads and checks the offset tables and leaders of all parts. */
int exr_read_tables(struct exr *x, uint64_t tables, struct fault *f);
unsigned exr_leader_bytes(const struct exr *x, const struct exr_part *p);
/* The chunk of level (0,0) that holds row y. */
struct exr_chunk *exr_scanline_chunk(struct exr_part *p, uint32_t y);

/* ---- exr_select.c ---- */
int exr_select_targets(struct exr *x, const struct exr_select *s, struct fault *f);

/* ---- exr_codec.c ---- */
/* packed -> exactly unpacked_bytes. 0, or -1 with a few words in why. */
int exr_unpack(struct exr_worker *w, const struct exr_codec_chunk *c, const uint8_t *packed,
               uint64_t packed_bytes, uint8_t *unpacked, uint64_t unpacked_bytes, char why[96]);
/* unpacked -> *packed, which stays the worker's until its next call; it may be `unpacked` itself (raw).
 * 0, or -1 with why. */
int exr_pack(struct exr_worker *w, const struct exr_codec_chunk *c, const uint8_t *unpacked,
             uint64_t unpacked_bytes, const uint8_t **packed, uint64_t *packed_bytes, char why[96]);
/* The codec's view of rows [y, y+rows) of a part, in input or output types. */
int exr_codec_view(struct exr_worker *w, const struct exr_part *p, uint32_t y, uint32_t width,
                   uint32_t rows, bool out, struct exr_codec_chunk *c);
/* Scratch that belongs to the worker, at least n bytes; slot 0..EXR_SCRATCHES-1. NULL: no memory. */
enum { EXR_SCRATCH_ROW, EXR_SCRATCH_CHUNK, EXR_SCRATCH_ZIP, EXR_SCRATCH_PACKED, EXR_SCRATCH_VIEW,
       EXR_SCRATCH_MERGE, EXR_SCRATCHES };
void *exr_scratch(struct exr_worker *w, unsigned slot, uint64_t n);
/* Decodes chunk k of the part into its pixels, unless they are there. */
int exr_decode_chunk(struct exr *x, struct exr_part *p, struct exr_chunk *k, struct exr_worker *w,
                     struct fault *f);
void exr_drop_pixels(const struct exr *x, struct exr_chunk *k);

/* ---- exr_zip.c ---- */
struct libdeflate_compressor;
struct libdeflate_decompressor;
int exr_zip_unpack(struct libdeflate_decompressor *d, const uint8_t *packed, uint64_t packed_bytes,
                   uint8_t *unpacked, uint64_t n, uint8_t *scratch);
/* Returns the packed size, 0 when it would not be smaller than n. scratch and packed: n bytes. */
uint64_t exr_zip_pack(struct libdeflate_compressor *c, const uint8_t *unpacked, uint64_t n,
                      uint8_t *packed, uint8_t *scratch);

/* ---- exr_write.c ---- */
void exr_note_dropped(struct exr *x, const struct exr_part *p);

/* ---- exr_decode.c ---- */
int exr_plan_decode(struct exr *x, struct fault *f);
/* A row of a file's channel as floats. */
void exr_row_to_float(float *out, const uint8_t *in, unsigned type, size_t n, uint16_t *scratch);

/* Row y of a channel of level 0 as floats, width / x_sampling of them; its chunks are decoded. */
void exr_fetch_row(const struct exr_part *p, unsigned channel, uint32_t y, float *out,
                   uint16_t *scratch);

/* ---- exr_encode.c ---- */
void exr_encode_free(const struct exr *x, struct exr_part *p);

/* ---- exr_yc.c ---- */
int exr_yc_decode(struct exr *x, struct exr_state *t, struct fault *f);
int exr_yc_encode(struct exr *x, struct exr_state *t, struct fault *f);

/* ---- exr_mip.c ---- */
/* What the glow adds to each lower level of a target's planes. */
int exr_delta_make(struct exr *x, struct exr_part *p, struct fault *f);
void exr_delta_free(struct exr_part *p);
/* Adds to n floats of a level's row at (px, py); false: nothing changes in it. */
bool exr_delta_row(const struct exr *x, const struct exr_part *p, const struct exr_channel *c,
                   const struct exr_chunk *k, uint32_t py, float *row);

#endif
