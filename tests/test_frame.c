// SPDX-License-Identifier: Apache-2.0
/*
 * test_frame.c - half <-> float against the definition of binary16, the scan against a plain double loop,
 * and the fast paths against the portable ones, bit for bit.
 */
#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <errno.h>
#include <pthread.h>

#include "frame.h"

void frame_use_portable(bool portable); // of frame.c, for this file

static const bool ways[] = { true, false };

static uint32_t bits(float f)
{
    uint32_t u;
    memcpy(&u, &f, 4);
    return u;
}

static float from_bits(uint32_t u)
{
    float f;
    memcpy(&f, &u, 4);
    return f;
}

static double half_meaning(uint16_t h)
{
    const int e = h >> 10 & 31, m = h & 1023;
    const double v = e ? ldexp(1024 + m, e - 25) : ldexp(m, -24);
    return h & 0x8000 ? -v : v;
}

static void test_half_to_float(void **state)
{
    (void)state;
    static uint16_t in[65536];
    static float out[65536];
    for (unsigned i = 0; i < 65536; i++)
        in[i] = (uint16_t)i;
    for (unsigned w = 0; w < 2; w++) {
        frame_use_portable(ways[w]);
        half_to_float(out, in, 65536);
        for (unsigned i = 0; i < 65536; i++) {
            if ((i & 0x7c00) != 0x7c00)
                assert_true((double)out[i] == half_meaning((uint16_t)i));
            else if (i & 0x3ff)
                assert_int_equal(bits(out[i]), (i & 0x8000) << 16 | 0x7fc00000 | (i & 0x3ff) << 13);
            else
                assert_true(isinf(out[i]));
            assert_int_equal(bits(out[i]) >> 31, i >> 15);
        }
        static uint16_t back[65536];
        assert_int_equal(float_to_half(back, out, 65536), 0);
        for (unsigned i = 0; i < 65536; i++) { // a signalling NaN comes back quiet
            const bool nan = (i & 0x7c00) == 0x7c00 && (i & 0x3ff);
            assert_int_equal(back[i], nan ? i | 0x200 : i);
        }
    }
}

// The nearest half by search, ties to even.
static uint16_t nearest_half(float f)
{
    const double a = fabs((double)f);
    unsigned low = 0, high = 0x7bff;
    if (a > 65504)
        return (uint16_t)(0x7bff | (f < 0 ? 0x8000 : 0));
    while (low < high) { // the largest half <= a
        const unsigned mid = (low + high + 1) / 2;
        if (half_meaning((uint16_t)mid) <= a)
            low = mid;
        else
            high = mid - 1;
    }
    if (low < 0x7bff) {
        const double below = a - half_meaning((uint16_t)low), above = half_meaning((uint16_t)(low + 1)) - a;
        if (above < below || (above == below && low & 1))
            low++;
    }
    return (uint16_t)(low | (signbit(f) ? 0x8000 : 0));
}

static void test_float_to_half(void **state)
{
    (void)state;
    enum { N = 65536 * 5 };
    float *in = malloc(N * sizeof(float));
    uint16_t *out = malloc(N * sizeof(*out));
    unsigned n = 0;
    uint32_t r = 12345;
    for (unsigned i = 0; i < 0x7c00; i++) { // each half, the midpoint after it, and both neighbours of that
        const float v = (float)half_meaning((uint16_t)i);
        const float next = i < 0x7bff ? (float)half_meaning((uint16_t)(i + 1)) : 65536.0f;
        const float mid = (float)(((double)v + (double)next) / 2);
        const float cases[] = { v, mid, nextafterf(mid, 0), nextafterf(mid, INFINITY) };
        for (unsigned c = 0; c < 4; c++) {
            in[n++] = cases[c];
            in[n++] = -cases[c];
        }
    }
    for (; n < N - 8; n++) {
        r = r * 1664525u + 1013904223u;
        in[n] = from_bits(r);
    }
    const float ends[] = { FLT_MAX, -FLT_MAX, 65504.0f, 65505.0f, FLT_MIN, 1e-45f, 65519.996f, 65520.0f };
    for (unsigned i = 0; i < 8; i++)
        in[n++] = ends[i];
    for (unsigned w = 0; w < 2; w++) {
        uint64_t over = 0;
        frame_use_portable(ways[w]);
        const uint64_t counted = float_to_half(out, in, N);
        for (unsigned i = 0; i < N; i++) {
            if (isnan(in[i])) {
                assert_int_equal(out[i], (bits(in[i]) >> 16 & 0x8000) | 0x7e00 | (bits(in[i]) >> 13 & 0x1ff));
            } else if (isinf(in[i])) {
                assert_int_equal(out[i], in[i] > 0 ? 0x7c00 : 0xfc00);
            } else {
                if (out[i] != nearest_half(in[i]))
                    fail_msg("%a became 0x%04x, nearest is 0x%04x (portable %d)", (double)in[i], out[i],
                             nearest_half(in[i]), ways[w]);
                over += fabsf(in[i]) > 65504.0f;
            }
        }
        assert_int_equal(counted, over);
    }
    free(in);
    free(out);
}

static void test_planes(void **state)
{
    (void)state;
    struct planes p;
    assert_int_equal(planes_alloc(&p, 33, 5, 3, PIXEL_TYPE_HALF), 0);
    assert_int_equal(p.pitch_bytes, 128);
    for (unsigned c = 0; c < 3; c++)
        for (uint32_t y = 0; y < 5; y++)
            for (unsigned i = 0; i < 128; i++)
                assert_int_equal(planes_row(&p, c, y)[i], 0);
    planes_free(&p);
    assert_null(p.base[0]);
    assert_int_equal(planes_alloc(&p, UINT32_MAX, UINT32_MAX, 3, PIXEL_TYPE_FLOAT), -EOVERFLOW);
    assert_int_equal(planes_alloc(&p, 0, 1, 3, PIXEL_TYPE_FLOAT), -EINVAL);
    assert_int_equal(planes_alloc(&p, 1, 1, 2, PIXEL_TYPE_FLOAT), -EINVAL);
}

// ---- scan ----

struct facts {
    uint64_t nan, positive_inf, negative_inf, negative, first;
    double sum;
    float luma[64], channel[64];
};

static float sample_of(const struct planes *p, unsigned c, uint32_t x, uint32_t y)
{
    float v;
    if (p->type == PIXEL_TYPE_HALF)
        half_to_float(&v, (const uint16_t *)(const void *)planes_row(p, c, y) + x, 1);
    else
        memcpy(&v, planes_row(p, c, y) + 4 * (size_t)x, 4);
    return v;
}

static void plain_scan(struct facts *f, const struct planes *p, const float luma[3])
{
    memset(f, 0, sizeof(*f));
    f->first = UINT64_MAX;
    const uint32_t tiles_x = (p->width + 63) / 64;
    for (uint32_t y = 0; y < p->height; y++)
        for (uint32_t x = 0; x < p->width; x++) {
            float clean[3] = { 0 };
            for (unsigned c = 0; c < p->count; c++) {
                const float v = sample_of(p, c, x, y);
                if (isfinite(v)) {
                    f->sum += (double)v;
                    f->negative += v < 0;
                    clean[c] = v > 0 ? v : 0;
                    continue;
                }
                f->nan += isnan(v) != 0;
                f->positive_inf += v > 0;
                f->negative_inf += v < 0;
                if (f->first == UINT64_MAX)
                    f->first = (uint64_t)y << 34 | (uint64_t)x << 2 | c;
            }
            float l = clean[0] * luma[0];
            if (p->count == 3)
                l = l + clean[1] * luma[1] + clean[2] * luma[2];
            const uint32_t t = y / 64 * tiles_x + x / 64;
            f->luma[t] = fmaxf(f->luma[t], fminf(l, FLT_MAX));
            f->channel[t] = fmaxf(f->channel[t], fmaxf(clean[0], fmaxf(clean[1], clean[2])));
        }
}

static void fill(struct planes *p, unsigned kind)
{
    uint32_t r = 99 + kind;
    for (unsigned c = 0; c < p->count; c++)
        for (uint32_t y = 0; y < p->height; y++)
            for (uint32_t x = 0; x < p->width; x++) {
                r = r * 1664525u + 1013904223u;
                float v = (float)(r >> 8) * 0x1p-20f;
                if (kind && (r >> 4) % 997 == 0) {
                    static const float odd[] = { NAN, INFINITY, -INFINITY, -1, -0.0f, 65504, 0, 1e-7f };
                    v = odd[(r >> 20) % 8];
                }
                if (kind == 2 && (r >> 3) % 501 == 7 && p->type == PIXEL_TYPE_FLOAT)
                    v = FLT_MAX;
                uint8_t *at = planes_row(p, c, y);
                if (p->type == PIXEL_TYPE_HALF)
                    float_to_half((uint16_t *)(void *)at + x, &v, 1);
                else
                    memcpy(at + 4 * (size_t)x, &v, 4);
            }
}

static void check_scan(const struct frame_scan *s, const struct facts *f)
{
    assert_int_equal(s->nan, f->nan);
    assert_int_equal(s->positive_inf, f->positive_inf);
    assert_int_equal(s->negative_inf, f->negative_inf);
    assert_int_equal(s->negative, f->negative);
    assert_true(s->first_nonfinite == f->first);
    const double sum = frame_scan_sum(s);
    if (fabs(sum - f->sum) > 1e-12 * fabs(f->sum))
        fail_msg("sum %.17g, plain %.17g", sum, f->sum);
    float luma = 0, channel = 0;
    for (uint32_t i = 0; i < s->tiles_x * s->tiles_y; i++) {
        assert_int_equal(s->tile_luma[i], bits(f->luma[i]));
        assert_int_equal(s->tile_channel[i], bits(f->channel[i]));
        luma = fmaxf(luma, f->luma[i]);
        channel = fmaxf(channel, f->channel[i]);
    }
    assert_true(frame_scan_max_luma(s) == luma);
    assert_true(frame_scan_max_channel(s) == channel);
}

static void test_scan(void **state)
{
    (void)state;
    const float lumas[][3] = { { 0.2126f, 0.7152f, 0.0722f }, { 0.34f, 0.73f, -0.07f } };
    const uint32_t widths[] = { 1, 63, 64, 65, 200 };
    for (unsigned type = PIXEL_TYPE_HALF; type <= PIXEL_TYPE_FLOAT; type++)
        for (unsigned count = 1; count <= 3; count += 2)
            for (unsigned i = 0; i < 5 * 3 * 2; i++) {
                const uint32_t width = widths[i % 5];
                const unsigned kind = i / 5 % 3;
                const float one[3] = { 1, 0, 0 }, *luma = count == 1 ? one : lumas[i / 15];
                struct planes p;
                struct facts f;
                double sums[2][130];
                assert_int_equal(planes_alloc(&p, width, 130, count, type), 0);
                fill(&p, kind);
                plain_scan(&f, &p, luma);
                for (unsigned w = 0; w < 2; w++) {
                    struct frame_scan s;
                    frame_use_portable(ways[w]);
                    assert_int_equal(frame_scan_init(&s, width, 130), 0);
                    for (uint32_t y = 0; y < 130; y++) // any order
                        frame_scan_row(&s, &p, y * 77 % 130, luma);
                    check_scan(&s, &f);
                    memcpy(sums[w], s.row_sum, sizeof(sums[w]));
                    frame_scan_finish(&s);
                }
                assert_memory_equal(sums[0], sums[1], sizeof(sums[0]));
                planes_free(&p);
            }
}

struct share {
    struct frame_scan *s;
    const struct planes *p;
    uint32_t first;
};

static void *scan_share(void *arg)
{
    const struct share *h = arg;
    const float luma[3] = { 0.2126f, 0.7152f, 0.0722f };
    for (uint32_t y = h->first; y < h->p->height; y += 2)
        frame_scan_row(h->s, h->p, y, luma);
    return NULL;
}

static void test_scan_threads(void **state)
{
    (void)state;
    const float luma[3] = { 0.2126f, 0.7152f, 0.0722f };
    struct planes p;
    struct frame_scan s;
    struct facts f;
    pthread_t thread;
    frame_use_portable(false);
    assert_int_equal(planes_alloc(&p, 200, 130, 3, PIXEL_TYPE_HALF), 0);
    fill(&p, 1);
    plain_scan(&f, &p, luma);
    assert_int_equal(frame_scan_init(&s, 200, 130), 0);
    struct share odd = { &s, &p, 1 }, even = { &s, &p, 0 };
    assert_int_equal(pthread_create(&thread, NULL, scan_share, &odd), 0);
    scan_share(&even);
    pthread_join(thread, NULL);
    check_scan(&s, &f);
    frame_scan_finish(&s);
    planes_free(&p);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_half_to_float), cmocka_unit_test(test_float_to_half),
        cmocka_unit_test(test_planes),        cmocka_unit_test(test_scan),
        cmocka_unit_test(test_scan_threads),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
