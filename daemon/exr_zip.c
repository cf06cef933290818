// SPDX-License-Identifier: Apache-2.0
/*
 * exr_zip.c - ZIP and ZIPS by libdeflate: the file format's predictor and byte split around zlib streams.
 *
 * Packing: bytes are split into even and odd ones, each is replaced by its difference to the one before
 * (+128), then deflated. The SSE2 loops and their scalar tails compute the same bytes.
 */
#include <libdeflate.h>
#include <string.h>

#include "exr_internal.h"

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

// In place: b[i] = b[0] + ... + b[i] - 128 i.
static void predictor_undo(uint8_t *b, uint64_t n)
{
    uint64_t i = 1;
    uint8_t last = b[0];
#if defined(__SSE2__)
    const __m128i bias = _mm_set1_epi8(-128);
    b[0] = (uint8_t)(b[0] + 128); // the loop takes 128 off every byte
    __m128i carry = _mm_setzero_si128();
    uint64_t k = 0;
    for (; k + 16 <= n; k += 16) {
        __m128i v = _mm_add_epi8(_mm_loadu_si128((const __m128i *)(b + k)), bias);
        v = _mm_add_epi8(v, _mm_slli_si128(v, 1));
        v = _mm_add_epi8(v, _mm_slli_si128(v, 2));
        v = _mm_add_epi8(v, _mm_slli_si128(v, 4));
        v = _mm_add_epi8(v, _mm_slli_si128(v, 8));
        v = _mm_add_epi8(v, carry);
        _mm_storeu_si128((__m128i *)(b + k), v);
        // all 16 bytes become the last one
        v = _mm_unpackhi_epi8(v, v);
        v = _mm_shufflehi_epi16(v, 0xff);
        carry = _mm_unpackhi_epi64(v, v);
    }
    if (k) {
        i = k;
        last = b[k - 1];
    } else {
        b[0] = last;
    }
#endif
    for (; i < n; i++)
        b[i] = last = (uint8_t)(last + b[i] - 128);
}

static void bytes_join(uint8_t *restrict out, const uint8_t *restrict in, uint64_t n)
{
    const uint8_t *even = in, *odd = in + (n + 1) / 2;
    uint64_t k = 0, half = n / 2;
#if defined(__SSE2__)
    for (; k + 16 <= half; k += 16) {
        __m128i a = _mm_loadu_si128((const __m128i *)(even + k));
        __m128i b = _mm_loadu_si128((const __m128i *)(odd + k));
        _mm_storeu_si128((__m128i *)(out + 2 * k), _mm_unpacklo_epi8(a, b));
        _mm_storeu_si128((__m128i *)(out + 2 * k + 16), _mm_unpackhi_epi8(a, b));
    }
#endif
    for (; k < half; k++) {
        out[2 * k] = even[k];
        out[2 * k + 1] = odd[k];
    }
    if (n & 1)
        out[n - 1] = even[half];
}

static void bytes_split(uint8_t *restrict out, const uint8_t *restrict in, uint64_t n)
{
    uint8_t *even = out, *odd = out + (n + 1) / 2;
    uint64_t k = 0, half = n / 2;
#if defined(__SSE2__)
    const __m128i low = _mm_set1_epi16(255);
    for (; k + 16 <= half; k += 16) {
        __m128i a = _mm_loadu_si128((const __m128i *)(in + 2 * k));
        __m128i b = _mm_loadu_si128((const __m128i *)(in + 2 * k + 16));
        _mm_storeu_si128((__m128i *)(even + k),
                         _mm_packus_epi16(_mm_and_si128(a, low), _mm_and_si128(b, low)));
        _mm_storeu_si128((__m128i *)(odd + k),
                         _mm_packus_epi16(_mm_srli_epi16(a, 8), _mm_srli_epi16(b, 8)));
    }
#endif
    for (; k < half; k++) {
        even[k] = in[2 * k];
        odd[k] = in[2 * k + 1];
    }
    if (n & 1)
        even[half] = in[n - 1];
}

// In place, from the end, since each byte needs the old one before it.
static void predictor_apply(uint8_t *b, uint64_t n)
{
    uint64_t i = n;
#if defined(__SSE2__)
    const __m128i bias = _mm_set1_epi8(-128);
    while (i > 16) {
        i -= 16;
        __m128i a = _mm_loadu_si128((const __m128i *)(b + i));
        __m128i p = _mm_loadu_si128((const __m128i *)(b + i - 1));
        _mm_storeu_si128((__m128i *)(b + i), _mm_add_epi8(_mm_sub_epi8(a, p), bias));
    }
#endif
    while (i > 1) {
        i--;
        b[i] = (uint8_t)(b[i] - b[i - 1] + 128);
    }
}

int exr_zip_unpack(struct libdeflate_decompressor *d, const uint8_t *packed, uint64_t packed_bytes,
                   uint8_t *unpacked, uint64_t n, uint8_t *scratch)
{
    // No count of bytes is asked for, so that anything but exactly n is a failure.
    if (libdeflate_zlib_decompress(d, packed, packed_bytes, scratch, n, NULL) != LIBDEFLATE_SUCCESS)
        return -1;
    predictor_undo(scratch, n);
    bytes_join(unpacked, scratch, n);
    return 0;
}

uint64_t exr_zip_pack(struct libdeflate_compressor *c, const uint8_t *unpacked, uint64_t n,
                      uint8_t *packed, uint8_t *scratch)
{
    if (n < 2)
        return 0;
    bytes_split(scratch, unpacked, n);
    predictor_apply(scratch, n);
    return libdeflate_zlib_compress(c, scratch, n, packed, n - 1);
}
