// SPDX-License-Identifier: Apache-2.0
// picture.c - the plainest use of OpenEXRCore: one scanline part, chunk after chunk.
#include "picture.h"

#include <openexr.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int picture_alloc(struct picture *p, int width, int height)
{
    size_t n = (size_t)width * (size_t)height;
    *p = (struct picture){ .width = width, .height = height };
    p->rgb = calloc(n, 3 * sizeof(float));
    p->z = calloc(n, sizeof(float));
    if (p->rgb && p->z)
        return 0;
    fputs("out of memory\n", stderr);
    picture_free(p);
    return -1;
}

void picture_free(struct picture *p)
{
    free(p->rgb);
    free(p->z);
    *p = (struct picture){ 0 };
}

/* ---- out -------------------------------------------------------------------------------------- */

static exr_result_t header(exr_context_t x, const struct picture *p)
{
    static const struct {
        const char *name, *value;
    } texts[] = {
        { "owner", "airyd" },
        { "comments", "a street at night, made by the airyd demo; linear Rec.709" },
        { "capDate", "2026:01:01 00:00:00" },
    };
    static const struct {
        const char *name;
        exr_pixel_type_t type;
    } channels[] = { { "A", EXR_PIXEL_HALF },
                     { "B", EXR_PIXEL_HALF },
                     { "G", EXR_PIXEL_HALF },
                     { "R", EXR_PIXEL_HALF },
                     { "Z", EXR_PIXEL_FLOAT } };
    exr_attr_chromaticities_t rec709 = { .640f, .330f, .300f, .600f, .150f, .060f, .3127f, .3290f };
    exr_attr_timecode_t code = { .time_and_flags = 0x01000000, .user_data = 0 };
    int part;
    exr_result_t r = exr_add_part(x, "beauty", EXR_STORAGE_SCANLINE, &part);
    if (r == EXR_ERR_SUCCESS)
        r = exr_initialize_required_attr_simple(x, part, p->width, p->height, EXR_COMPRESSION_ZIP);
    if (r == EXR_ERR_SUCCESS)
        r = exr_set_zip_compression_level(x, part, 4);
    for (unsigned i = 0; i < 5 && r == EXR_ERR_SUCCESS; i++)
        r = exr_add_channel(x, part, channels[i].name, channels[i].type, EXR_PERCEPTUALLY_LOGARITHMIC, 1,
                            1);
    for (unsigned i = 0; i < 3 && r == EXR_ERR_SUCCESS; i++)
        r = exr_attr_set_string(x, part, texts[i].name, texts[i].value);
    if (r == EXR_ERR_SUCCESS)
        r = exr_attr_set_chromaticities(x, part, "chromaticities", &rec709);
    if (r == EXR_ERR_SUCCESS)
        r = exr_attr_set_float(x, part, "expTime", 1 / 48.f);
    if (r == EXR_ERR_SUCCESS)
        r = exr_attr_set_timecode(x, part, "timeCode", &code);
    return r == EXR_ERR_SUCCESS ? exr_write_header(x) : r;
}

/* The rows of one chunk as OpenEXRCore takes them: a float plane per channel. */
static exr_result_t chunk_write(exr_context_t x, const struct picture *p, int y, float *planes,
                                exr_encode_pipeline_t *e, int first)
{
    exr_chunk_info_t c;
    exr_result_t r = exr_write_scanline_chunk_info(x, 0, y, &c);
    if (r == EXR_ERR_SUCCESS)
        r = first ? exr_encoding_initialize(x, 0, &c, e) : exr_encoding_update(x, 0, &c, e);
    if (r != EXR_ERR_SUCCESS)
        return r;
    size_t n = (size_t)c.width * (size_t)c.height;
    for (int i = 0; i < e->channel_count; i++) {
        exr_coding_channel_info_t *channel = &e->channels[i];
        char name = channel->channel_name[0];
        float *plane = planes + (size_t)i * n;
        for (size_t k = 0; k < n; k++) {
            size_t pixel = (size_t)y * (size_t)p->width + k;
            const float *rgb = p->rgb + 3 * pixel;
            plane[k] = name == 'R'   ? rgb[0]
                       : name == 'G' ? rgb[1]
                       : name == 'B' ? rgb[2]
                       : name == 'Z' ? p->z[pixel]
                                     : 1;
        }
        channel->encode_from_ptr = (const uint8_t *)plane;
        channel->user_data_type = EXR_PIXEL_FLOAT;
        channel->user_bytes_per_element = sizeof(float);
        channel->user_pixel_stride = sizeof(float);
        channel->user_line_stride = c.width * (int)sizeof(float);
    }
    if (first)
        r = exr_encoding_choose_default_routines(x, 0, e);
    return r == EXR_ERR_SUCCESS ? exr_encoding_run(x, 0, e) : r;
}

int picture_write(const char *path, const struct picture *p)
{
    exr_context_t x;
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    exr_encode_pipeline_t e = EXR_ENCODE_PIPELINE_INITIALIZER;
    int32_t lines = 16;
    float *planes = malloc((size_t)p->width * 16 * 5 * sizeof(float));
    exr_result_t r =
        planes ? exr_start_write(&x, path, EXR_WRITE_FILE_DIRECTLY, &init) : EXR_ERR_OUT_OF_MEMORY;
    if (r != EXR_ERR_SUCCESS) {
        fprintf(stderr, "%s: %s\n", path, exr_get_default_error_message(r));
        free(planes);
        return -1;
    }
    r = header(x, p);
    if (r == EXR_ERR_SUCCESS)
        r = exr_get_scanlines_per_chunk(x, 0, &lines);
    for (int y = 0; y < p->height && r == EXR_ERR_SUCCESS; y += lines)
        r = chunk_write(x, p, y, planes, &e, y == 0);
    exr_encoding_destroy(x, &e);
    exr_result_t finished = exr_finish(&x);
    free(planes);
    r = r == EXR_ERR_SUCCESS ? finished : r;
    if (r != EXR_ERR_SUCCESS)
        fprintf(stderr, "%s: %s\n", path, exr_get_default_error_message(r));
    return r == EXR_ERR_SUCCESS ? 0 : -1;
}

/* ---- in --------------------------------------------------------------------------------------- */

static exr_result_t chunk_read(exr_context_t x, struct picture *p, int y, int top,
                               exr_decode_pipeline_t *d, int first)
{
    exr_chunk_info_t c;
    exr_result_t r = exr_read_scanline_chunk_info(x, 0, y + top, &c);
    if (r == EXR_ERR_SUCCESS)
        r = first ? exr_decoding_initialize(x, 0, &c, d) : exr_decoding_update(x, 0, &c, d);
    if (r != EXR_ERR_SUCCESS)
        return r;
    for (int i = 0; i < d->channel_count; i++) {
        exr_coding_channel_info_t *channel = &d->channels[i];
        const char *name = channel->channel_name;
        int at = strcmp(name, "R") == 0   ? 0
                 : strcmp(name, "G") == 0 ? 1
                 : strcmp(name, "B") == 0 ? 2
                                          : -1;
        channel->decode_to_ptr =
            at < 0 ? NULL : (uint8_t *)(p->rgb + 3 * (size_t)y * (size_t)p->width + at);
        channel->user_data_type = EXR_PIXEL_FLOAT;
        channel->user_bytes_per_element = sizeof(float);
        channel->user_pixel_stride = 3 * sizeof(float);
        channel->user_line_stride = 3 * p->width * (int)sizeof(float);
    }
    if (first)
        r = exr_decoding_choose_default_routines(x, 0, d);
    return r == EXR_ERR_SUCCESS ? exr_decoding_run(x, 0, d) : r;
}

int picture_read(struct picture *p, const char *path)
{
    exr_context_t x;
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    exr_decode_pipeline_t d = EXR_DECODE_PIPELINE_INITIALIZER;
    exr_attr_box2i_t window;
    int32_t lines;
    *p = (struct picture){ 0 };
    exr_result_t r = exr_start_read(&x, path, &init);
    if (r != EXR_ERR_SUCCESS) {
        fprintf(stderr, "%s: %s\n", path, exr_get_default_error_message(r));
        return -1;
    }
    r = exr_get_data_window(x, 0, &window);
    if (r == EXR_ERR_SUCCESS)
        r = exr_get_scanlines_per_chunk(x, 0, &lines);
    if (r == EXR_ERR_SUCCESS &&
        picture_alloc(p, window.max.x - window.min.x + 1, window.max.y - window.min.y + 1) < 0)
        r = EXR_ERR_OUT_OF_MEMORY;
    for (int y = 0; r == EXR_ERR_SUCCESS && y < p->height; y += lines)
        r = chunk_read(x, p, y, window.min.y, &d, y == 0);
    exr_decoding_destroy(x, &d);
    exr_finish(&x);
    if (r == EXR_ERR_SUCCESS)
        return 0;
    fprintf(stderr, "%s: %s\n", path, exr_get_default_error_message(r));
    picture_free(p);
    return -1;
}
