/* SPDX-License-Identifier: Apache-2.0 */
/*
 * exr_codec.h - one chunk as the codecs see it. Plain C and C++: exr_dwa.cc sees no other header of ours.
 */
#ifndef AIRYD_EXR_CODEC_H
#define AIRYD_EXR_CODEC_H

#include <stdbool.h>
#include <stdint.h>

struct exr_codec_channel {
    const char *name;
    uint8_t type, linear;      /* enum pixel_type; pLinear */
    int32_t x_sampling, y_sampling;
    uint32_t width, height;    /* samples in this chunk */
};

struct exr_codec_chunk {
    int compression;           /* enum exr_compression */
    float dwa_level;
    bool tiled;
    int32_t y;                 /* absolute */
    uint32_t width, height;
    const struct exr_codec_channel *channel; /* in order of their names */
    unsigned channels;
};

#ifdef __cplusplus
extern "C" {
#endif

/* DWAA and DWAB, through the C++ library. 0, or -1 with a few words in why. */
int exr_dwa_unpack(const struct exr_codec_chunk *c, const uint8_t *packed, uint64_t packed_bytes,
                   uint8_t *unpacked, uint64_t unpacked_bytes, char why[96]);
/* *packed: malloc'd, the caller's. */
int exr_dwa_pack(const struct exr_codec_chunk *c, const uint8_t *unpacked, uint64_t unpacked_bytes,
                 uint8_t **packed, uint64_t *packed_bytes, char why[96]);

#ifdef __cplusplus
}
#endif

#endif
