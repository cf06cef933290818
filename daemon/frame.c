// SPDX-License-Identifier: Apache-2.0
/*
 * frame.c - planes, half <-> float rows, and the scan.
 *
 * Invariant: every routine with a fast path gives the same bits as its portable twin, so that a result
 * does not depend on the machine. The scan's sums are kept in 8 lanes (x % 8) per channel and added in one
 * fixed order for that reason; its maxima and counts are order-free anyhow.
 */
#include "frame.h"

#include <errno.h>
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if defined(__x86_64__)
#include <cpuid.h>
#include <immintrin.h>
#define FRAME_X86 1
#endif

enum { LANES = 8 };

// ---- planes -----------------------------------------------------------------------------------------

const float frame_rec709[3] = { 0.212639019f, 0.715168655f, 0.0721923187f };

int planes_alloc(struct planes *p, uint32_t width, uint32_t height, unsigned count,
                 enum pixel_type type)
{
    if ((count != 1 && count != 3) || type == PIXEL_TYPE_UINT || !width || !height)
        return -EINVAL;
    uint64_t pitch = ((uint64_t)width * pixel_bytes(type) + 63) & ~UINT64_C(63);
    uint64_t plane, total;
    if (__builtin_mul_overflow(pitch, (uint64_t)height, &plane) ||
        __builtin_mul_overflow(plane, (uint64_t)count, &total) || total > PTRDIFF_MAX - 64)
        return -EOVERFLOW;
    uint8_t *memory = aligned_alloc(64, total);
    if (!memory)
        return -ENOMEM;
    memset(memory, 0, total);
    *p = (struct planes){ .width = width, .height = height, .count = count, .type = type,
                          .pitch_bytes = pitch, .phases = 1 };
    for (unsigned c = 0; c < count; c++)
        p->base[c] = memory + c * plane;
    return 0;
}

void planes_free(struct planes *p)
{
    free(p->base[0]);
    *p = (struct planes){ 0 };
}

// ---- half <-> float ---------------------------------------------------------------------------------

static inline uint32_t float_bits(float f)
{
    uint32_t u;
    memcpy(&u, &f, 4);
    return u;
}

static inline float bits_float(uint32_t u)
{
    float f;
    memcpy(&f, &u, 4);
    return f;
}

static inline float half_value(uint16_t h)
{
    uint32_t sign = (uint32_t)(h & 0x8000) << 16, exponent = h >> 10 & 31, m = h & 1023;
    if (exponent == 31) // the processor's conversion makes a NaN quiet, so this does
        return bits_float(sign | 0x7f800000 | m << 13 | (m ? 0x400000 : 0));
    if (exponent)
        return bits_float(sign | (exponent + 112) << 23 | m << 13);
    return bits_float(sign | float_bits((float)m * 0x1p-24f));
}

// Round to nearest even; |f| is at most 65504, Inf or NaN.
static inline uint16_t half_of(float f)
{
    uint32_t u = float_bits(f), sign = u >> 16 & 0x8000, a = u & 0x7fffffff;
    if (a >= 0x7f800000)
        return (uint16_t)(sign | 0x7c00 | (a > 0x7f800000 ? 0x200 | (a >> 13 & 0x3ff) : 0));
    if (a < 0x38800000) { // subnormal: adding 0.5 lets the FPU round at 2^-24
        uint32_t r = float_bits(bits_float(a) + 0.5f) - 0x3f000000;
        return (uint16_t)(sign | r);
    }
    return (uint16_t)(sign | (a - 0x38000000 + 0xfff + (a >> 13 & 1)) >> 13);
}

static inline float half_range(float f, uint64_t *saturated)
{
    float a = fabsf(f);
    if (!(a > 65504.0f && a <= FLT_MAX))
        return f;
    ++*saturated;
    return copysignf(65504.0f, f);
}

static void half_to_float_c(float *out, const uint16_t *in, size_t n)
{
    for (size_t i = 0; i < n; i++)
        out[i] = half_value(in[i]);
}

static uint64_t float_to_half_c(uint16_t *out, const float *in, size_t n)
{
    uint64_t saturated = 0;
    for (size_t i = 0; i < n; i++)
        out[i] = half_of(half_range(in[i], &saturated));
    return saturated;
}

// ---- the scan of up to one tile's width of one row ----------------------------------------------------

struct segment {
    const uint8_t *row[3]; // at the segment's first pixel
    unsigned count;        // channels
    uint32_t x, n;         // first pixel (a multiple of SCAN_TILE) and how many
    float luma[3];
    double (*sum)[LANES];
    float max_luma, max_channel;
    uint32_t nan, positive_inf, negative_inf, negative;
    uint64_t first_nonfinite; // x << 2 | channel
};

// true: all samples are finite and none is negative, maxima and sums are in; false: nothing was done.
typedef bool scan_fast_fn(struct segment *s);

static void segment_classify(struct segment *s, uint32_t x, unsigned c, float v)
{
    if (v <= FLT_MAX && v >= -FLT_MAX) {
        s->negative += v < 0;
        return;
    }
    if (v != v)
        s->nan++;
    else if (v > 0)
        s->positive_inf++;
    else
        s->negative_inf++;
    uint64_t key = (uint64_t)x << 2 | c;
    if (key < s->first_nonfinite)
        s->first_nonfinite = key;
}

static void segment_scan_c(struct segment *s, enum pixel_type type)
{
    for (uint32_t i = 0; i < s->n; i++) {
        float clean[3] = { 0, 0, 0 };
        for (unsigned c = 0; c < s->count; c++) {
            float v;
            if (type == PIXEL_TYPE_HALF) {
                uint16_t h;
                memcpy(&h, s->row[c] + 2 * (size_t)i, 2);
                v = half_value(h);
            } else {
                memcpy(&v, s->row[c] + 4 * (size_t)i, 4);
            }
            segment_classify(s, s->x + i, c, v);
            if (!(v <= FLT_MAX && v >= -FLT_MAX))
                continue;
            s->sum[c][i % LANES] += (double)v;
            clean[c] = v > 0 ? v : 0;
        }
        float luma = clean[0] * s->luma[0];
        if (s->count == 3)
            luma = luma + clean[1] * s->luma[1] + clean[2] * s->luma[2];
        float most = fmaxf(clean[0], fmaxf(clean[1], clean[2]));
        s->max_luma = luma > s->max_luma ? luma : s->max_luma;
        s->max_channel = most > s->max_channel ? most : s->max_channel;
    }
}

static bool scan_fast_none(struct segment *s)
{
    (void)s;
    return false;
}

#ifdef FRAME_X86
#define AVX2 __attribute__((target("avx2,f16c,popcnt")))

AVX2 static void half_to_float_f16c(float *out, const uint16_t *in, size_t n)
{
    size_t i = 0;
    for (; i + 8 <= n; i += 8)
        _mm256_storeu_ps(out + i, _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)(in + i))));
    half_to_float_c(out + i, in + i, n - i);
}

AVX2 static uint64_t float_to_half_f16c(uint16_t *out, const float *in, size_t n)
{
    const __m256 sign = _mm256_set1_ps(-0.0f), top = _mm256_set1_ps(65504.0f);
    const __m256 most = _mm256_set1_ps(FLT_MAX);
    uint64_t saturated = 0;
    size_t i = 0;
    for (; i + 8 <= n; i += 8) {
        __m256 v = _mm256_loadu_ps(in + i), a = _mm256_andnot_ps(sign, v);
        __m256 over = _mm256_and_ps(_mm256_cmp_ps(a, top, _CMP_GT_OQ), _mm256_cmp_ps(a, most, _CMP_LE_OQ));
        unsigned mask = (unsigned)_mm256_movemask_ps(over);
        if (mask) {
            saturated += (unsigned)__builtin_popcount(mask);
            v = _mm256_blendv_ps(v, _mm256_or_ps(top, _mm256_and_ps(v, sign)), over);
        }
        _mm_storeu_si128((__m128i *)(out + i), _mm256_cvtps_ph(v, _MM_FROUND_TO_NEAREST_INT));
    }
    return saturated + float_to_half_c(out + i, in + i, n - i);
}

AVX2 static inline __m256 scan_load(const uint8_t *row, uint32_t i, bool half)
{
    if (half)
        return _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)(row + 2 * (size_t)i)));
    return _mm256_loadu_ps((const float *)(const void *)(row + 4 * (size_t)i));
}

// Bit patterns of finite, non-negative numbers are all below that of Inf.
AVX2 static inline bool scan_plain(const struct segment *s, unsigned count, bool half)
{
    __m256i all = _mm256_setzero_si256();
    const uint32_t step = half ? 16 : 8;
    for (unsigned c = 0; c < count; c++)
        for (uint32_t i = 0; i < SCAN_TILE; i += step) {
            __m256i v = _mm256_loadu_si256((const __m256i *)(s->row[c] + (half ? 2 : 4) * (size_t)i));
            all = half ? _mm256_max_epu16(all, v) : _mm256_max_epu32(all, v);
        }
    const __m256i limit = half ? _mm256_set1_epi16(0x7bff) : _mm256_set1_epi32(0x7f7fffff);
    __m256i within = half ? _mm256_cmpeq_epi16(_mm256_max_epu16(all, limit), limit)
                          : _mm256_cmpeq_epi32(_mm256_max_epu32(all, limit), limit);
    return _mm256_movemask_epi8(within) == -1;
}

AVX2 static inline float scan_horizontal_max(__m256 v)
{
    __m128 m = _mm_max_ps(_mm256_castps256_ps128(v), _mm256_extractf128_ps(v, 1));
    m = _mm_max_ps(m, _mm_movehl_ps(m, m));
    return _mm_cvtss_f32(_mm_max_ss(m, _mm_shuffle_ps(m, m, 1)));
}

AVX2 static inline bool scan_avx2(struct segment *s, unsigned count, bool half)
{
    if (s->n != SCAN_TILE || !scan_plain(s, count, half))
        return false;
    __m256d low[3], high[3];
    __m256 weight[3], luma_max = _mm256_setzero_ps(), channel_max = luma_max;
    for (unsigned c = 0; c < count; c++) {
        low[c] = _mm256_loadu_pd(s->sum[c]);
        high[c] = _mm256_loadu_pd(s->sum[c] + 4);
        weight[c] = _mm256_set1_ps(s->luma[c]);
    }
    for (uint32_t i = 0; i < SCAN_TILE; i += LANES) {
        __m256 luma = _mm256_setzero_ps();
        for (unsigned c = 0; c < count; c++) {
            __m256 v = scan_load(s->row[c], i, half), part = _mm256_mul_ps(v, weight[c]);
            luma = c ? _mm256_add_ps(luma, part) : part;
            channel_max = _mm256_max_ps(channel_max, v);
            low[c] = _mm256_add_pd(low[c], _mm256_cvtps_pd(_mm256_castps256_ps128(v)));
            high[c] = _mm256_add_pd(high[c], _mm256_cvtps_pd(_mm256_extractf128_ps(v, 1)));
        }
        luma_max = _mm256_max_ps(luma, luma_max); // this order: never -0 or NaN
    }
    for (unsigned c = 0; c < count; c++) {
        _mm256_storeu_pd(s->sum[c], low[c]);
        _mm256_storeu_pd(s->sum[c] + 4, high[c]);
    }
    s->max_luma = scan_horizontal_max(luma_max);
    s->max_channel = scan_horizontal_max(channel_max);
    return true;
}

AVX2 static bool scan_half3(struct segment *s) { return scan_avx2(s, 3, true); }
AVX2 static bool scan_half1(struct segment *s) { return scan_avx2(s, 1, true); }
AVX2 static bool scan_float3(struct segment *s) { return scan_avx2(s, 3, false); }
AVX2 static bool scan_float1(struct segment *s) { return scan_avx2(s, 1, false); }

static bool cpu_is_fast(void)
{
    unsigned a, b, c, d;
    return __builtin_cpu_supports("avx2") && __get_cpuid(1, &a, &b, &c, &d) && (c & bit_F16C);
}
#endif

// ---- the choice: by processor, or as a test has set it ------------------------------------------------

// 0: not looked yet, 1: portable, 2: fast. Every thread comes to the same answer.
static _Atomic int frame_speed;

void frame_use_portable(bool portable); // for tests alone, so in no header
void frame_use_portable(bool portable) { atomic_store(&frame_speed, portable ? 1 : 0); }

static bool frame_fast(void)
{
    int speed = atomic_load_explicit(&frame_speed, memory_order_relaxed);
    if (!speed) {
#ifdef FRAME_X86
        speed = cpu_is_fast() ? 2 : 1;
#else
        speed = 1;
#endif
        atomic_store_explicit(&frame_speed, speed, memory_order_relaxed);
    }
    return speed == 2;
}

void half_to_float(float *out, const uint16_t *in, size_t n)
{
#ifdef FRAME_X86
    if (frame_fast()) {
        half_to_float_f16c(out, in, n);
        return;
    }
#endif
    half_to_float_c(out, in, n);
}

uint64_t float_to_half(uint16_t *out, const float *in, size_t n)
{
#ifdef FRAME_X86
    if (frame_fast())
        return float_to_half_f16c(out, in, n);
#endif
    return float_to_half_c(out, in, n);
}

static scan_fast_fn *scan_routine(const struct planes *p)
{
#ifdef FRAME_X86
    if (frame_fast()) {
        if (p->type == PIXEL_TYPE_HALF)
            return p->count == 3 ? scan_half3 : scan_half1;
        return p->count == 3 ? scan_float3 : scan_float1;
    }
#endif
    (void)p;
    return scan_fast_none;
}

// ---- the scan -----------------------------------------------------------------------------------------

int frame_scan_init(struct frame_scan *s, uint32_t width, uint32_t height)
{
    *s = (struct frame_scan){ 0 };
    if (!width || !height)
        return -EINVAL;
    s->tiles_x = (uint32_t)(((uint64_t)width + SCAN_TILE - 1) / SCAN_TILE);
    s->tiles_y = (uint32_t)(((uint64_t)height + SCAN_TILE - 1) / SCAN_TILE);
    s->height = height;
    size_t tiles;
    if (__builtin_mul_overflow((size_t)s->tiles_x, (size_t)s->tiles_y, &tiles))
        return -EOVERFLOW;
    s->tile_luma = calloc(tiles, sizeof(*s->tile_luma));
    s->tile_channel = calloc(tiles, sizeof(*s->tile_channel));
    s->row_sum = calloc(height, sizeof(*s->row_sum));
    atomic_init(&s->first_nonfinite, UINT64_MAX);
    if (s->tile_luma && s->tile_channel && s->row_sum)
        return 0;
    frame_scan_finish(s);
    return -ENOMEM;
}

void frame_scan_finish(struct frame_scan *s)
{
    free((void *)s->tile_luma);
    free((void *)s->tile_channel);
    free(s->row_sum);
    *s = (struct frame_scan){ 0 };
}

static void atomic_raise(_Atomic uint32_t *slot, float value)
{
    uint32_t bits = float_bits(value < FLT_MAX ? value : FLT_MAX);
    uint32_t old = atomic_load_explicit(slot, memory_order_relaxed);
    while (bits > old &&
           !atomic_compare_exchange_weak_explicit(slot, &old, bits, memory_order_relaxed,
                                                  memory_order_relaxed))
        ;
}

static void scan_add_counts(struct frame_scan *s, const struct segment *g, uint32_t y)
{
    if (g->negative)
        atomic_fetch_add_explicit(&s->negative, g->negative, memory_order_relaxed);
    if (g->first_nonfinite == UINT64_MAX)
        return;
    atomic_fetch_add_explicit(&s->nan, g->nan, memory_order_relaxed);
    atomic_fetch_add_explicit(&s->positive_inf, g->positive_inf, memory_order_relaxed);
    atomic_fetch_add_explicit(&s->negative_inf, g->negative_inf, memory_order_relaxed);
    uint64_t key = (uint64_t)y << 34 | g->first_nonfinite;
    uint64_t old = atomic_load_explicit(&s->first_nonfinite, memory_order_relaxed);
    while (key < old &&
           !atomic_compare_exchange_weak_explicit(&s->first_nonfinite, &old, key,
                                                  memory_order_relaxed, memory_order_relaxed))
        ;
}

void frame_scan_row(struct frame_scan *s, const struct planes *p, uint32_t y, const float luma[3])
{
    double sum[3][LANES] = { { 0 } };
    scan_fast_fn *fast = scan_routine(p);
    const size_t line = (size_t)(y / SCAN_TILE) * s->tiles_x;
    const uint8_t *row[3] = { 0 };
    for (unsigned c = 0; c < p->count; c++)
        row[c] = planes_row(p, c, y);
    for (uint32_t t = 0; t < s->tiles_x; t++) {
        struct segment g = { .count = p->count, .x = t * SCAN_TILE, .sum = sum,
                             .luma = { luma[0], luma[1], luma[2] }, .first_nonfinite = UINT64_MAX };
        g.n = p->width - g.x < SCAN_TILE ? p->width - g.x : SCAN_TILE;
        for (unsigned c = 0; c < p->count; c++)
            g.row[c] = row[c] + (size_t)g.x * pixel_bytes(p->type);
        if (!fast(&g)) {
            segment_scan_c(&g, p->type);
            scan_add_counts(s, &g, y);
        }
        if (g.max_channel > 0) {
            atomic_raise(&s->tile_luma[line + t], g.max_luma);
            atomic_raise(&s->tile_channel[line + t], g.max_channel);
        }
    }
    double total = 0;
    for (unsigned c = 0; c < p->count; c++) {
        const double *l = sum[c];
        total += ((l[0] + l[4]) + (l[2] + l[6])) + ((l[1] + l[5]) + (l[3] + l[7]));
    }
    s->row_sum[y] = total;
}

double frame_scan_sum(const struct frame_scan *s)
{
    double total = 0;
    for (uint32_t y = 0; y < s->height; y++)
        total += s->row_sum[y];
    return total;
}

static float tiles_max(const struct frame_scan *s, const _Atomic uint32_t *tile)
{
    uint32_t most = 0;
    const size_t n = (size_t)s->tiles_x * s->tiles_y;
    for (size_t i = 0; i < n; i++) {
        uint32_t v = atomic_load_explicit(&tile[i], memory_order_relaxed);
        most = v > most ? v : most;
    }
    return bits_float(most);
}

float frame_scan_max_luma(const struct frame_scan *s) { return tiles_max(s, s->tile_luma); }
float frame_scan_max_channel(const struct frame_scan *s) { return tiles_max(s, s->tile_channel); }
