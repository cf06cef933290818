// SPDX-License-Identifier: Apache-2.0
// bloom_host_rows.c - the inner loops of bloom_host.h: weighted sums of rows, eight columns to a vector.
//
// Invariant: a column's sum goes through its rows in their order, one rounding for each product and each addition, in vectors as in the
// columns left over; so the bits do not depend on where a row is cut, nor on what the processor has.
#include <float.h>
#include <string.h>

#include "bloom_host.h"

// Twice compiled, chosen at start. Sanitizers' own start-up does not bear that, and clang's version of it is younger than Debian's.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define FAST __attribute__((target_clones("avx2", "default")))
#else
#define FAST
#endif

typedef float eight __attribute__((vector_size(32), aligned(4), may_alias));
typedef int32_t eight_bits __attribute__((vector_size(32), aligned(4), may_alias));

// For vectors, C has no ?: in gcc.
#define SELECT(MASK, YES, NO) ((eight)(((MASK) & (eight_bits)(YES)) | (~(MASK) & (eight_bits)(NO))))
#define LIMIT(V, LOW, HIGH)                                                                                                    \
    do {                                                                                                                       \
        const eight low_ = (LOW) - (eight){ 0 }, high_ = (HIGH) - (eight){ 0 };                                                \
        V = SELECT(V > low_, V, low_);                                                                                         \
        V = SELECT(V < high_, V, high_);                                                                                       \
    } while (0)

enum weighing { WEIGH_SET, WEIGH_MORE, WEIGH_ADD };

static inline float finite_or_0(float v)
{
    int32_t bits;
    memcpy(&bits, &v, 4);
    bits = (bits & 0x7f800000) == 0x7f800000 ? 0 : bits;
    memcpy(&v, &bits, 4);
    return v;
}

#define LOAD(V, P)                                                                                                             \
    eight V = *(const eight *)(const void *)(P);                                                                               \
    if (finite) {                                                                                                              \
        const eight_bits bits = (eight_bits)V;                                                                                 \
        V = (eight)(bits & ((bits & 0x7f800000) != 0x7f800000));                                                               \
    }
#define STORE(AT, SUM)                                                                                                         \
    do {                                                                                                                       \
        eight *const to_ = (eight *)(void *)(AT);                                                                              \
        if (how == WEIGH_ADD)                                                                                                  \
            *to_ += gain * (SUM);                                                                                              \
        else                                                                                                                   \
            *to_ = (SUM);                                                                                                      \
    } while (0)

static inline __attribute__((always_inline)) void weigh(float *out, const float *const *row, const float *w, unsigned count, size_t n,
                                                        enum weighing how, float gain, bool finite)
{
    size_t x = 0;
    for (; x + 32 <= n; x += 32) {
        eight a = { 0 }, b = a, c = a, d = a;
        if (how == WEIGH_MORE) {
            a = *(const eight *)(const void *)(out + x);
            b = *(const eight *)(const void *)(out + x + 8);
            c = *(const eight *)(const void *)(out + x + 16);
            d = *(const eight *)(const void *)(out + x + 24);
        }
        for (unsigned k = 0; k < count; k++) {
            const float *r = row[k] + x;
            LOAD(va, r) LOAD(vb, r + 8) LOAD(vc, r + 16) LOAD(vd, r + 24)
            a += w[k] * va;
            b += w[k] * vb;
            c += w[k] * vc;
            d += w[k] * vd;
        }
        STORE(out + x, a);
        STORE(out + x + 8, b);
        STORE(out + x + 16, c);
        STORE(out + x + 24, d);
    }
    for (; x + 8 <= n; x += 8) {
        eight a = { 0 };
        if (how == WEIGH_MORE)
            a = *(const eight *)(const void *)(out + x);
        for (unsigned k = 0; k < count; k++) {
            LOAD(v, row[k] + x)
            a += w[k] * v;
        }
        STORE(out + x, a);
    }
    for (; x < n; x++) {
        float sum = how == WEIGH_MORE ? out[x] : 0;
        for (unsigned k = 0; k < count; k++)
            sum += w[k] * (finite ? finite_or_0(row[k][x]) : row[k][x]);
        out[x] = how == WEIGH_ADD ? out[x] + gain * sum : sum;
    }
}

FAST void host_weigh(float *out, const float *const *row, const float *w, unsigned count, size_t n, bool more)
{
    if (more)
        weigh(out, row, w, count, n, WEIGH_MORE, 1, false);
    else
        weigh(out, row, w, count, n, WEIGH_SET, 1, false);
}

FAST void host_weigh_finite(float *out, const float *const *row, const float *w, unsigned count, size_t n, bool more)
{
    if (more)
        weigh(out, row, w, count, n, WEIGH_MORE, 1, true);
    else
        weigh(out, row, w, count, n, WEIGH_SET, 1, true);
}

FAST void host_weigh_add(float *out, const float *const *row, const float *w, unsigned count, size_t n, float gain)
{
    weigh(out, row, w, count, n, WEIGH_ADD, gain, false);
}

FAST void host_hold(float *v, size_t n)
{
    for (size_t x = 0; x < n; x++)
        v[x] = v[x] > FLT_MAX ? FLT_MAX : v[x];
}

FAST void host_unzip(float *restrict even, float *restrict odd, const float *restrict in, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        even[i] = in[2 * i];
        odd[i] = in[2 * i + 1];
    }
}

FAST void host_zip(float *restrict out, const float *restrict even, const float *restrict odd, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        out[2 * i] = even[i];
        out[2 * i + 1] = odd[i];
    }
}

/* ---- the bright pass --------------------------------------------------------------------------------------- */

static inline float sane(float v)
{
    const float f = finite_or_0(v);
    return f > 0 ? f : 0;
}

/* What luminance is multiplied by: a pass's numbers. */
struct curve { float edge, wide, by, foot; bool smooth; };

#define SANE(V, P)                                                                                                             \
    LOAD(V, P)                                                                                                                 \
    V = SELECT(V > none, V, none)

static inline __attribute__((always_inline)) void excess_eight(float *const out[3], const float *const in[3], size_t x, unsigned channels,
                                                               const struct curve *k, const float luma[3])
{
    const bool finite = true;
    const eight none = { 0 }, one = 1.0f - none, tiny = FLT_MIN - none;
    SANE(r, in[0] + x);
    eight g = none, b = none, l = r * luma[0], gain;
    if (channels == 3) {
        SANE(vg, in[1] + x);
        SANE(vb, in[2] + x);
        g = vg;
        b = vb;
        l = l + g * luma[1] + b * luma[2];
    }
    if (k->smooth) {
        eight t = (l - k->foot) * k->by;
        LIMIT(t, 0, 1);
        if (k->by == 0)
            t = SELECT(l > k->edge - none, one, none);
        gain = t * t * (3.0f - 2.0f * t);
    } else {
        eight s = l - k->foot;
        LIMIT(s, 0, k->wide);
        const eight knee = s * (s * k->by), line = l - k->edge, over = SELECT(line > none, line, none);
        gain = SELECT(knee > over, knee, over) / SELECT(l > tiny, l, tiny);
    }
    *(eight *)(void *)(out[0] + x) = r * gain;
    if (channels == 3) {
        *(eight *)(void *)(out[1] + x) = g * gain;
        *(eight *)(void *)(out[2] + x) = b * gain;
    }
}

// The pixels that are left over go through a vector of their own: one formula for all.
static inline __attribute__((always_inline)) void excess_luma(float *const out[3], const float *const in[3], size_t n, unsigned channels,
                                                              const struct curve *k, const float luma[3])
{
    size_t x = 0;
    for (; x + 8 <= n; x += 8)
        excess_eight(out, in, x, channels, k, luma);
    if (x == n)
        return;
    float some[2][3][8] = { { { 0 } } };
    float *const to[3] = { some[1][0], some[1][1], some[1][2] };
    const float *const from[3] = { some[0][0], some[0][1], some[0][2] };
    for (unsigned c = 0; c < channels; c++)
        memcpy(some[0][c], in[c] + x, (n - x) * sizeof(float));
    excess_eight(to, from, 0, channels, k, luma);
    for (unsigned c = 0; c < channels; c++)
        memcpy(out[c] + x, some[1][c], (n - x) * sizeof(float));
}

FAST void host_excess(float *const out[3], const float *const in[3], size_t n, unsigned channels, enum bright_curve kind, const float curve[4],
                      const float luma[3])
{
    if (kind != BRIGHT_NONE && kind != BRIGHT_CHANNEL) {
        const struct curve k = { curve[0], curve[1], curve[2], curve[3], kind == BRIGHT_SMOOTHSTEP };
        excess_luma(out, in, n, channels, &k, luma);
        return;
    }
    const float edge = kind == BRIGHT_CHANNEL ? curve[0] : 0;
    for (unsigned c = 0; c < channels; c++) {
        const float *restrict from = in[c];
        float *restrict to = out[c];
        for (size_t x = 0; x < n; x++) {
            const float v = sane(from[x]) - edge;
            to[x] = v > 0 ? v : 0;
        }
    }
}

/* ---- to the wall's pixels ------------------------------------------------------------------------------------ */

#define LOWS(A, B) __builtin_shufflevector(A, B, 0, 8, 1, 9, 4, 12, 5, 13)
#define HIGHS(A, B) __builtin_shufflevector(A, B, 2, 10, 3, 11, 6, 14, 7, 15)
#define LOW_PAIRS(A, B) __builtin_shufflevector(A, B, 0, 1, 8, 9, 4, 5, 12, 13)
#define HIGH_PAIRS(A, B) __builtin_shufflevector(A, B, 2, 3, 10, 11, 6, 7, 14, 15)
#define LOW_HALVES(A, B) __builtin_shufflevector(A, B, 0, 1, 2, 3, 8, 9, 10, 11)
#define HIGH_HALVES(A, B) __builtin_shufflevector(A, B, 4, 5, 6, 7, 12, 13, 14, 15)

// Columns of eight rows, as rows.
static inline __attribute__((always_inline)) void turn_block(eight v[8])
{
    eight a[8], b[8];
    for (unsigned i = 0; i < 8; i += 2) {
        a[i] = LOWS(v[i], v[i + 1]);
        a[i + 1] = HIGHS(v[i], v[i + 1]);
    }
    for (unsigned i = 0; i < 8; i += 4)
        for (unsigned k = 0; k < 2; k++) {
            b[i + 2 * k] = LOW_PAIRS(a[i + k], a[i + k + 2]);
            b[i + 2 * k + 1] = HIGH_PAIRS(a[i + k], a[i + k + 2]);
        }
    for (unsigned i = 0; i < 4; i++) {
        v[i] = LOW_HALVES(b[i], b[i + 4]);
        v[i + 4] = HIGH_HALVES(b[i], b[i + 4]);
    }
}

FAST void host_turn(float *restrict out, const float *restrict in, size_t pitch, size_t n, float gain)
{
    size_t x = 0;
    for (; x + 8 <= n; x += 8) {
        eight v[8];
        for (size_t r = 0; r < 8; r++)
            v[r] = *(const eight *)(const void *)(in + r * pitch + x);
        turn_block(v);
        for (size_t i = 0; i < 8; i++) {
            LIMIT(v[i], -FLT_MAX, FLT_MAX);
            v[i] *= gain;
            LIMIT(v[i], -FLT_MAX, FLT_MAX);
            *(eight *)(void *)(out + (x + i) * HOST_ROWS) = v[i];
        }
    }
    for (; x < n; x++) {
        eight v;
        for (size_t r = 0; r < 8; r++)
            v[r] = in[r * pitch + x];
        LIMIT(v, -FLT_MAX, FLT_MAX);
        v *= gain;
        LIMIT(v, -FLT_MAX, FLT_MAX);
        *(eight *)(void *)(out + x * HOST_ROWS) = v;
    }
}

// Does light of these columns reach the sum of this one? at: the first run that may matter, for columns come in order.
static inline bool is_lit(const struct host_run *run, unsigned runs, unsigned *at, long first, long end)
{
    while (*at < runs && run[*at].x1 <= first)
        ++*at;
    return *at < runs && run[*at].x0 < end;
}

FAST void host_across(float *out, const float *turned, const struct wall_taps *t, const struct host_run *run, unsigned runs, bool set)
{
    unsigned at = 0;
    for (uint32_t i = 0; i < t->n; i++, out += HOST_ROWS) {
        const float *w = t->weight + (size_t)i * t->room, *from = turned + (size_t)t->first[i] * HOST_ROWS;
        const long first = (long)t->first[i], end = first + (long)t->count[i];
        if (set)
            memset(out, 0, HOST_ROWS * sizeof(*out));
        if (!is_lit(run, runs, &at, first, end))
            continue;
        eight sum = { 0 };
        for (uint32_t k = 0; k < t->count[i]; k++)
            sum += w[k] * *(const eight *)(const void *)(from + (size_t)k * HOST_ROWS);
        LIMIT(sum, -FLT_MAX, FLT_MAX);
        *(eight *)(void *)out += sum;
    }
}

#define TONE_MAP(V)                                                                                                            \
    do {                                                                                                                       \
        V *= exposure;                                                                                                         \
        LIMIT(V, 0, most);                                                                                                     \
        if (tone_map == DISPLAY_REINHARD)                                                                                      \
            V = V / (V + 1.0f);                                                                                                \
        if (tone_map == DISPLAY_ACES) {                                                                                        \
            const eight above_ = SELECT(V > one, V, one), i_ = 1.0f / above_, below_ = SELECT(V < one, V, one);                \
            const eight low_ = below_ * (2.51f * below_ + 0.03f) / (below_ * (2.43f * below_ + 0.59f) + 0.14f);                \
            const eight high_ = (2.51f + 0.03f * i_) / (2.43f + i_ * (0.59f + 0.14f * i_));                                    \
            V = SELECT(V < one, low_, high_);                                                                                  \
        }                                                                                                                      \
    } while (0)

// ACES: Narkowicz 2015; from 1 on over v^2, so that no square overflows.
static inline __attribute__((always_inline)) void drive(float *const light[3], size_t n, const struct host_drive *d, int tone_map, bool saturate)
{
    // Light that is this bright is held at full drive later anyway; sums of it stay finite.
    const float most = 1e30f, exposure = d->exposure, s = d->saturation;
    const eight one = 1.0f - (eight){ 0 }, none = { 0 };
    const struct host_drive k = *d;
    for (size_t x = 0; x < n; x += 8) {
        eight *const red = (eight *)(void *)(light[0] + x), *const green = (eight *)(void *)(light[1] + x);
        eight *const blue = (eight *)(void *)(light[2] + x);
        eight r = *red, g = *green, b = *blue;
        TONE_MAP(r);
        TONE_MAP(g);
        TONE_MAP(b);
        if (saturate) {
            const eight l = r * k.luma[0] + g * k.luma[1] + b * k.luma[2];
            const eight sr = l + s * (r - l), sg = l + s * (g - l), sb = l + s * (b - l);
            r = SELECT(sr > none, sr, none);
            g = SELECT(sg > none, sg, none);
            b = SELECT(sb > none, sb, none);
        }
        *red = k.matrix[0][0] * r + k.matrix[0][1] * g + k.matrix[0][2] * b;
        *green = k.matrix[1][0] * r + k.matrix[1][1] * g + k.matrix[1][2] * b;
        *blue = k.matrix[2][0] * r + k.matrix[2][1] * g + k.matrix[2][2] * b;
    }
}

FAST void host_drive(float *const light[3], size_t n, const struct host_drive *d)
{
    if (d->tone_map == DISPLAY_ACES)
        drive(light, n, d, DISPLAY_ACES, d->saturation != 1);
    else if (d->tone_map == DISPLAY_REINHARD)
        drive(light, n, d, DISPLAY_REINHARD, d->saturation != 1);
    else
        drive(light, n, d, DISPLAY_NONE, d->saturation != 1);
}
