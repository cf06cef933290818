// SPDX-License-Identifier: Apache-2.0
/*
 * exr_codec.c - one chunk, packed <-> unpacked, by whichever library does that compression; and the
 * worker, which keeps what the codecs need from chunk to chunk.
 *
 * RLE, PIZ, PXR24, B44 and B44A are OpenEXRCore's (de)compress routines of its pipelines, called with our
 * own buffers and channel lists: a worker opens, once per compression, a context on a header that it has
 * just written itself, so the library never parses what came from outside and holds no state per file.
 *
 * Traps of OpenEXRCore 3.1 that this file steers round: a B44 chunk stored raw is decoded as B44; a
 * PXR24 result as long as its input reads back as raw; heights of subsampled channels are wrong in
 * chunks whose height is no multiple of the sampling. So raw chunks never reach it, a result that is not
 * smaller is stored raw, and the channel sizes are ours.
 */
#include <errno.h>
#include <libdeflate.h>
#include <openexr.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "exr_internal.h"

enum { DEFLATE_LEVEL = 4, HEADER_BYTES = 2048, CODECS = EXR_B44A + 1 };

struct core_codec {
    uint8_t header[HEADER_BYTES];
    uint64_t header_bytes;
    exr_context_t read, write;
    exr_decode_pipeline_t decode;
    exr_encode_pipeline_t encode;
    bool open;
};

struct scratch {
    void *memory;
    uint64_t bytes;
};

struct exr_worker {
    struct libdeflate_compressor *deflate;
    struct libdeflate_decompressor *inflate;
    struct core_codec *core[CODECS];
    exr_coding_channel_info_t *channels;
    unsigned channels_room;
    uint8_t *dwa; // the last packed DWA chunk
    struct scratch scratch[EXR_SCRATCHES];
};

void *exr_scratch(struct exr_worker *w, unsigned slot, uint64_t n)
{
    struct scratch *s = &w->scratch[slot];
    if (s->bytes < n || !s->memory) {
        free(s->memory);
        s->bytes = n + n / 4 + 64;
        s->memory = malloc(s->bytes);
        if (!s->memory)
            s->bytes = 0;
    }
    return s->memory;
}

// ---- contexts of OpenEXRCore on a header of our own -----------------------------------------------------

static void core_silent(exr_const_context_t c, exr_result_t code, const char *text)
{
    (void)c, (void)code, (void)text; // the caller reports, with the chunk's place
}

static int64_t core_write(exr_const_context_t c, void *user, const void *data, uint64_t n, uint64_t at,
                          exr_stream_error_func_ptr_t error)
{
    (void)c, (void)error;
    struct core_codec *k = user;
    if (at > HEADER_BYTES || n > HEADER_BYTES - at)
        return -1;
    memcpy(k->header + at, data, n);
    if (at + n > k->header_bytes)
        k->header_bytes = at + n;
    return (int64_t)n;
}

static int64_t core_read(exr_const_context_t c, void *user, void *data, uint64_t n, uint64_t at,
                         exr_stream_error_func_ptr_t error)
{
    (void)c, (void)error;
    const struct core_codec *k = user;
    if (at >= k->header_bytes)
        return 0;
    if (n > k->header_bytes - at)
        n = k->header_bytes - at;
    memcpy(data, k->header + at, n);
    return (int64_t)n;
}

static int64_t core_size(exr_const_context_t c, void *user)
{
    (void)c;
    return (int64_t)((const struct core_codec *)user)->header_bytes;
}

static bool core_open_write(struct core_codec *k, int compression)
{
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.user_data = k;
    init.write_fn = core_write;
    init.error_handler_fn = core_silent;
    const exr_attr_box2i_t window = { .max.x = 15 };
    const exr_attr_v2f_t centre = { .x = 0 };
    exr_chunk_info_t info;
    int part;
    return !exr_start_write(&k->write, "codec", EXR_WRITE_FILE_DIRECTLY, &init) &&
           !exr_add_part(k->write, "codec", EXR_STORAGE_SCANLINE, &part) &&
           !exr_initialize_required_attr(k->write, part, &window, &window, 1, &centre, 1,
                                         EXR_LINEORDER_INCREASING_Y, (exr_compression_t)compression) &&
           !exr_add_channel(k->write, part, "Y", EXR_PIXEL_HALF, EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1) &&
           !exr_write_header(k->write) && !exr_write_scanline_chunk_info(k->write, 0, 0, &info) &&
           !exr_encoding_initialize(k->write, 0, &info, &k->encode) &&
           !exr_encoding_choose_default_routines(k->write, 0, &k->encode) && k->encode.compress_fn;
}

static bool core_open_read(struct core_codec *k)
{
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.user_data = k;
    init.read_fn = core_read;
    init.size_fn = core_size;
    init.error_handler_fn = core_silent;
    init.max_image_width = init.max_image_height = 16;
    init.max_tile_width = init.max_tile_height = 16;
    exr_chunk_info_t info = { .height = 1, .width = 16, .type = EXR_STORAGE_SCANLINE,
                              .unpacked_size = 32 };
    if (exr_start_read(&k->read, "codec", &init) || exr_decoding_initialize(k->read, 0, &info, &k->decode))
        return false;
    static uint8_t nowhere[64]; // never written: only the choice of routines looks at it
    k->decode.channels[0].decode_to_ptr = nowhere;
    k->decode.channels[0].user_pixel_stride = 2;
    k->decode.channels[0].user_line_stride = 32;
    return !exr_decoding_choose_default_routines(k->read, 0, &k->decode) && k->decode.decompress_fn;
}

static void core_close(struct core_codec *k)
{
    if (!k)
        return;
    // The pipelines must free only what they made: our buffers and lists go first.
    if (k->read) {
        k->decode.channels = k->decode._quick_chan_store;
        k->decode.packed_buffer = k->decode.unpacked_buffer = NULL;
        k->decode.packed_alloc_size = k->decode.unpacked_alloc_size = 0;
        exr_decoding_destroy(k->read, &k->decode);
        exr_finish(&k->read);
    }
    if (k->write) {
        k->encode.channels = k->encode._quick_chan_store;
        k->encode.packed_buffer = NULL;
        k->encode.packed_alloc_size = 0;
        exr_encoding_destroy(k->write, &k->encode);
        exr_finish(&k->write);
    }
    free(k);
}

static struct core_codec *core_of(struct exr_worker *w, int compression)
{
    if (w->core[compression])
        return w->core[compression];
    struct core_codec *k = calloc(1, sizeof(*k));
    if (!k)
        return NULL;
    if (!core_open_write(k, compression) || !core_open_read(k)) {
        core_close(k);
        return NULL;
    }
    return w->core[compression] = k;
}

// ---- worker -----------------------------------------------------------------------------------------------

int exr_worker_create(struct exr_worker **out)
{
    struct exr_worker *w = calloc(1, sizeof(*w));
    if (!w)
        return -ENOMEM;
    w->deflate = libdeflate_alloc_compressor(DEFLATE_LEVEL);
    w->inflate = libdeflate_alloc_decompressor();
    if (!w->deflate || !w->inflate) {
        exr_worker_destroy(w);
        return -ENOMEM;
    }
    *out = w;
    return 0;
}

void exr_worker_destroy(struct exr_worker *w)
{
    if (!w)
        return;
    for (int i = 0; i < CODECS; i++)
        core_close(w->core[i]);
    for (int i = 0; i < EXR_SCRATCHES; i++)
        free(w->scratch[i].memory);
    libdeflate_free_compressor(w->deflate);
    libdeflate_free_decompressor(w->inflate);
    free(w->channels);
    free(w->dwa);
    free(w);
}

// ---- chunks ---------------------------------------------------------------------------------------------

// OpenEXRCore's channel list for this chunk; NULL: no memory.
static exr_coding_channel_info_t *core_channels(struct exr_worker *w, const struct exr_codec_chunk *c)
{
    if (w->channels_room < c->channels) {
        free(w->channels);
        w->channels_room = 0;
        w->channels = calloc(c->channels, sizeof(*w->channels));
        if (!w->channels)
            return NULL;
        w->channels_room = c->channels;
    }
    for (unsigned i = 0; i < c->channels; i++) {
        const struct exr_codec_channel *from = &c->channel[i];
        const int8_t bytes = (int8_t)pixel_bytes((enum pixel_type)from->type);
        w->channels[i] = (exr_coding_channel_info_t){
            .channel_name = from->name, .height = (int32_t)from->height, .width = (int32_t)from->width,
            .x_samples = from->x_sampling, .y_samples = from->y_sampling, .p_linear = from->linear,
            .bytes_per_element = bytes, .data_type = from->type, .user_bytes_per_element = bytes,
            .user_data_type = from->type };
    }
    return w->channels;
}

static exr_chunk_info_t core_chunk(const struct exr_codec_chunk *c, uint64_t packed, uint64_t unpacked)
{
    return (exr_chunk_info_t){ .start_y = c->y, .height = (int32_t)c->height, .width = (int32_t)c->width,
                               .type = EXR_STORAGE_SCANLINE, .compression = (uint8_t)c->compression,
                               .packed_size = packed, .unpacked_size = unpacked };
}

static int core_unpack(struct exr_worker *w, const struct exr_codec_chunk *c, const uint8_t *packed,
                       uint64_t packed_bytes, uint8_t *unpacked, uint64_t unpacked_bytes, char why[96])
{
    struct core_codec *k = core_of(w, c->compression);
    exr_coding_channel_info_t *channels = core_channels(w, c);
    if (!k || !channels) {
        snprintf(why, 96, "no memory for the codec");
        return -1;
    }
    exr_decode_pipeline_t *d = &k->decode;
    d->channels = channels;
    d->channel_count = (int16_t)c->channels;
    d->chunk = core_chunk(c, packed_bytes, unpacked_bytes);
    d->packed_buffer = (void *)(uintptr_t)packed; // only read
    d->unpacked_buffer = unpacked;
    d->packed_alloc_size = d->unpacked_alloc_size = 0;
    exr_result_t rv = d->decompress_fn(d);
    d->packed_buffer = d->unpacked_buffer = NULL;
    if (rv)
        snprintf(why, 96, "cannot be decompressed: %s", exr_get_error_code_as_string(rv));
    return rv ? -1 : 0;
}

static int core_pack(struct exr_worker *w, const struct exr_codec_chunk *c, const uint8_t *unpacked,
                     uint64_t n, const uint8_t **packed, uint64_t *packed_bytes, char why[96])
{
    struct core_codec *k = core_of(w, c->compression);
    exr_coding_channel_info_t *channels = core_channels(w, c);
    if (!k || !channels) {
        snprintf(why, 96, "no memory for the codec");
        return -1;
    }
    exr_encode_pipeline_t *e = &k->encode;
    e->channels = channels;
    e->channel_count = (int16_t)c->channels;
    e->chunk = core_chunk(c, 0, n);
    e->packed_buffer = (void *)(uintptr_t)unpacked; // only read
    e->packed_bytes = n;
    e->packed_alloc_size = 0;
    e->compressed_bytes = 0;
    exr_result_t rv = e->compress_fn(e);
    e->packed_buffer = NULL;
    // B44 says so when its 14 bytes per block do not fit: narrow images grow, and are stored raw.
    const bool grew = rv == EXR_ERR_OUT_OF_MEMORY && e->compressed_buffer;
    if (rv && !grew) {
        snprintf(why, 96, "cannot be compressed: %s", exr_get_error_code_as_string(rv));
        return -1;
    }
    *packed = grew ? unpacked : e->compressed_buffer;
    *packed_bytes = grew ? n : e->compressed_bytes;
    return 0;
}

static int zip_unpack(struct exr_worker *w, const uint8_t *packed, uint64_t packed_bytes,
                      uint8_t *unpacked, uint64_t n, char why[96])
{
    uint8_t *scratch = exr_scratch(w, EXR_SCRATCH_ZIP, n);
    if (scratch && !exr_zip_unpack(w->inflate, packed, packed_bytes, unpacked, n, scratch))
        return 0;
    snprintf(why, 96, scratch ? "is no proper zlib stream of its pixels" : "no memory");
    return -1;
}

int exr_unpack(struct exr_worker *w, const struct exr_codec_chunk *c, const uint8_t *packed,
               uint64_t packed_bytes, uint8_t *unpacked, uint64_t unpacked_bytes, char why[96])
{
    if (packed_bytes == unpacked_bytes) {
        memcpy(unpacked, packed, unpacked_bytes);
        return 0;
    }
    switch (c->compression) {
    case EXR_NONE:
        snprintf(why, 96, "has %llu bytes; %llu were expected", (unsigned long long)packed_bytes,
                 (unsigned long long)unpacked_bytes);
        return -1;
    case EXR_ZIP:
    case EXR_ZIPS:
        return zip_unpack(w, packed, packed_bytes, unpacked, unpacked_bytes, why);
    case EXR_DWAA:
    case EXR_DWAB:
        return exr_dwa_unpack(c, packed, packed_bytes, unpacked, unpacked_bytes, why);
    default:
        return core_unpack(w, c, packed, packed_bytes, unpacked, unpacked_bytes, why);
    }
}

int exr_pack(struct exr_worker *w, const struct exr_codec_chunk *c, const uint8_t *unpacked,
             uint64_t n, const uint8_t **packed, uint64_t *packed_bytes, char why[96])
{
    uint8_t *scratch, *out;
    int result = 0;
    *packed = unpacked;
    *packed_bytes = n;
    switch (c->compression) {
    case EXR_NONE:
        break;
    case EXR_ZIP:
    case EXR_ZIPS:
        scratch = exr_scratch(w, EXR_SCRATCH_ZIP, n);
        out = exr_scratch(w, EXR_SCRATCH_PACKED, n);
        if (!scratch || !out) {
            snprintf(why, 96, "no memory");
            return -1;
        }
        *packed_bytes = exr_zip_pack(w->deflate, unpacked, n, out, scratch);
        *packed = out;
        break;
    case EXR_DWAA:
    case EXR_DWAB:
        free(w->dwa);
        w->dwa = NULL;
        result = exr_dwa_pack(c, unpacked, n, &w->dwa, packed_bytes, why);
        *packed = w->dwa;
        break;
    default:
        result = core_pack(w, c, unpacked, n, packed, packed_bytes, why);
    }
    if (!result && (!*packed_bytes || *packed_bytes >= n)) { // stored raw, as readers expect
        *packed = unpacked;
        *packed_bytes = n;
    }
    return result;
}

int exr_codec_view(struct exr_worker *w, const struct exr_part *p, uint32_t y, uint32_t width,
                   uint32_t rows, bool out, struct exr_codec_chunk *c)
{
    const unsigned n = out ? p->out_channels : p->channels;
    const int32_t corner = p->min_y - (out ? (int32_t)p->grow : 0);
    struct exr_codec_channel *list = exr_scratch(w, EXR_SCRATCH_VIEW, (uint64_t)n * sizeof(*list));
    if (!list)
        return -1;
    for (unsigned i = 0; i < n; i++) {
        const struct exr_channel *from = out ? &p->out_channel[i] : &p->channel[i];
        list[i] = (struct exr_codec_channel){
            .name = from->name, .type = out ? from->out_type : from->type, .linear = from->linear,
            .x_sampling = from->x_sampling, .y_sampling = from->y_sampling,
            .width = width / (uint32_t)from->x_sampling,
            .height = exr_sampled(y, rows, (uint32_t)from->y_sampling) };
    }
    *c = (struct exr_codec_chunk){ .compression = out ? p->out_compression : p->compression,
                                   .dwa_level = p->dwa_level, .tiled = p->storage == EXR_TILED,
                                   .y = (p->storage == EXR_TILED ? 0 : corner) + (int32_t)y,
                                   .width = width, .height = rows, .channel = list, .channels = n };
    return 0;
}

int exr_decode_chunk(struct exr *x, struct exr_part *p, struct exr_chunk *k, struct exr_worker *w,
                     struct fault *f)
{
    if (k->pixels || !k->unpacked_bytes)
        return 0;
    const uint8_t *packed = x->bytes + k->packed_at;
    if (k->packed_bytes == k->unpacked_bytes) { // raw: the input's own bytes will do
        k->pixels = (uint8_t *)(uintptr_t)packed;
        return 0;
    }
    char title[96], why[96] = "no memory";
    struct exr_codec_chunk c;
    uint8_t *pixels = k->room ? k->room : malloc(k->unpacked_bytes);
    if (!pixels || exr_codec_view(w, p, k->y, k->width, k->height, false, &c)) {
        if (pixels != k->room)
            free(pixels);
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for %llu bytes of pixels",
                         (unsigned long long)k->unpacked_bytes);
    }
    if (exr_unpack(w, &c, packed, k->packed_bytes, pixels, k->unpacked_bytes, why)) {
        if (pixels != k->room)
            free(pixels);
        return fault_set(f, FAULT_EXR_DAMAGED, "input", "chunk %u of %s %s",
                         (unsigned)(k - p->chunk), exr_part_title(p, title), why);
    }
    k->pixels = pixels;
    return 0;
}

void exr_drop_pixels(const struct exr *x, struct exr_chunk *k)
{
    if (k->pixels && !exr_in_input(x, k->pixels) && !exr_arena_has(&x->arena, k->pixels))
        free(k->pixels);
    k->pixels = NULL;
}
