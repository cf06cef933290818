/* SPDX-License-Identifier: Apache-2.0 */
/*
 * exr_internal.h - what the files of the exr room share.
 *
 *     exr_header.c   bytes -> struct exr_part: headers, strictly
 *     exr_chunk.c    geometry of chunks and levels, offset tables checked against the file
 *     exr_select.c   parts, layers, views -> targets that are bloomed
 *     exr_companion.c  what the glow needs beside them: source, matte, depth
 *     exr_layout.c   what the output has otherwise than the input: channels, windows, chunks
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

#include <assert.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "exr.h"
#include "exr_codec.h"

enum {
    EXR_CHANNELS_MAX = 4096,      /* of one part */
    EXR_PARTS_MAX = 1024,
    EXR_VIEWS_MAX = 256,          /* of one part */
    EXR_ATTRIBUTES_MAX = 16384,   /* of one file */
    EXR_LEVELS_MAX = 32,
    EXR_TARGETS_MAX = 16,         /* as BLOOM_TARGETS_MAX */
    EXR_EXTRAS_MAX = 7,           /* as in struct exr_options */
    EXR_OUT_CHUNKS_MAX = 1 << 22, /* of a part that grows: its tiles cost the peer nothing */
    EXR_PREFIX_BYTES = 600,
    EXR_NOTES_MAX = 32,
    EXR_NOTE_BYTES = 200,
};

enum { EXR_FLAG_LONG_NAMES = 0x400 }; /* of the version field: names of more than 31 bytes */

enum exr_storage { EXR_SCANLINE, EXR_TILED, EXR_DEEP_SCANLINE, EXR_DEEP_TILED };

struct exr_channel {
    const char *name;      /* in the input's bytes, NUL-terminated there */
    uint8_t type;          /* enum pixel_type, in the input */
    uint8_t out_type;      /* in the output */
    uint8_t linear;        /* pLinear: B44's hint */
    int32_t x_sampling, y_sampling;
    int from;              /* itself; in the output's list the input's channel, -1: of an extra layer */
    int target;            /* the scene that writes it, -1: carried over */
    unsigned plane;        /* of that scene; for luminance-chroma 0 Y, 1 RY, 2 BY */
    unsigned output;       /* of that scene: 0 the picture, then the extra layers */
    uint64_t taps;         /* bit 4 * t + p: plane p of target t is read from it */
};
static_assert(EXR_TARGETS_MAX * 4 <= 64, "taps have a bit for every plane");

static inline uint64_t exr_tap(unsigned target, unsigned plane) { return UINT64_C(1) << (4 * target + plane); }

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
    uint32_t row, rows;        /* of the output's window, or of the level */
    uint32_t column, width;
    uint32_t tile_x, tile_y;   /* tiled */
    uint8_t level_x, level_y;
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
    int32_t display_x, display_y;       /* display window; the data window when the file says none */
    uint32_t display_width, display_height;

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
    unsigned scenes;                    /* how many of them are written */
    struct exr_channel *out_channel;    /* of parts with scenes: the output's list; `channel` when no layers are added */
    unsigned out_channels;
    char *extra_names;                  /* of the added ones */
    bool retyped;                       /* some channel changes its type */
    bool extended;                      /* layers are added */
    uint32_t grow;                      /* encode: pixels that the window grows by on each side */
    uint32_t out_width, out_height;
    bool changes;                       /* encode: some chunk may differ */
    bool relayout;                      /* encode: other rows per chunk than the input */
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
    uint32_t crop_x, crop_y;   /* of the planes' first pixel in the part; the planes are pub's width x height */
    bool luma_chroma;
    uint8_t chroma_sampling;   /* 1 or 2 */
    float yw[3];               /* luminance-chroma: weights of the file's Y */
    char prefix[EXR_PREFIX_BYTES]; /* of a scene's channels: "", "diffuse.", "diffuse.right." */
    const char *view;          /* into the input; NULL: of no view */
    uint32_t view_bytes;
    struct planes in, out[1 + EXR_EXTRAS_MAX];
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
/* Bytes of rows [y, y + rows), `width` pixels wide; out: of the output's channels in their types. */
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

/* Names for a fault's text, each once. */
struct exr_list {
    char text[200];
    size_t used;
    bool full;
};
void exr_list_add(struct exr_list *l, const char *word, size_t n);
void exr_list_layers(const struct exr_part *p, struct exr_list *l);

bool exr_same(const char *word, const char *bytes, uint32_t n);
/* Walks a multiView attribute. */
bool exr_next_view(const uint8_t **at, const uint8_t *end, const char **view, uint32_t *n);
struct exr_channel *exr_channel_find(const struct exr_part *p, const char *prefix, const char *name);
/* The colour channels under a prefix: R G B, or Y RY BY (*chroma), or Y. How many; 0: no layer. */
unsigned exr_layer_find(const struct exr_part *p, const char *prefix, struct exr_channel *c[3], bool *chroma);
/* Why they cannot be read as colour, *bad is the one; NULL: they can. */
const char *exr_layer_unfit(const struct exr_part *p, struct exr_channel *const c[3], unsigned n, bool chroma,
                            const struct exr_channel **bad);
/* A target that reads these channels, of p's window; NULL and *f when there are too many. Counts it. */
struct exr_state *exr_target_new(struct exr *x, struct exr_part *p, struct exr_channel *const c[3], unsigned n,
                                 bool chroma, struct fault *f);
/* The channel that plane p of the target is read from. */
unsigned exr_channel_of(const struct exr *x, const struct exr_state *t, unsigned plane);

/* ---- exr_companion.c ---- */
int exr_select_companions(struct exr *x, const struct exr_select *s, struct fault *f);

/* ---- exr_layout.c ---- */
/* The output's channels of all parts with scenes: types, extra layers. */
int exr_plan_channels(struct exr *x, struct fault *f);
/* What the caller set, of the part's scenes. */
uint32_t exr_part_grow(const struct exr *x, const struct exr_part *p);
/* The output's window and chunks of one part, whose grow and out_compression are set. */
int exr_plan_outs(struct exr_part *p, struct fault *f);

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
       EXR_SCRATCH_MERGE, EXR_SCRATCH_GROWN, EXR_SCRATCHES };
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

/* Columns [x, x + width) of row y, all channels as in an unpacked chunk, from the chunks of level 0; x and y count
 * from the input's corner, and what is outside its window is 0. Parts without subsampled channels. */
void exr_gather_row(const struct exr_part *p, int64_t x, int64_t y, uint32_t width, uint8_t *out);

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
