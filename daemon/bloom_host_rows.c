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

static inline float held(float v) { return v > FLT_MAX ? FLT_MAX : v < -FLT_MAX ? -FLT_MAX : v; }

FAST void host_hold(float *v, size_t n, float gain)
{
    for (size_t x = 0; x < n; x++)
        v[x] = held(held(v[x]) * gain);
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

static inline float within(float v, float low, float high)
{
    v = v > low ? v : low;
    return v < high ? v : high;
}

// What luminance l is multiplied by.
static inline __attribute__((always_inline)) float curve_gain(float l, bool smooth, float edge, float wide, float by, float foot)
{
    if (smooth) {
        const float step = l > edge ? 1.0f : 0.0f, slope = within((l - foot) * by, 0, 1), t = by == 0 ? step : slope;
        return t * t * (3.0f - 2.0f * t);
    }
    const float s = within(l - foot, 0, wide), knee = s * (s * by), line = l - edge, over = line > 0 ? line : 0;
    return (knee > over ? knee : over) / (l > FLT_MIN ? l : FLT_MIN);
}

static inline __attribute__((always_inline)) void excess_luma(float *const out[3], const float *const in[3], size_t n, unsigned channels,
                                                              bool smooth, const float curve[4], const float luma[3])
{
    const float edge = curve[0], wide = curve[1], by = curve[2], foot = curve[3];
    const float lr = luma[0], lg = channels == 3 ? luma[1] : 0, lb = channels == 3 ? luma[2] : 0;
    const float *restrict r = in[0], *restrict g = in[channels == 3 ? 1 : 0], *restrict b = in[channels == 3 ? 2 : 0];
    float *restrict red = out[0], *restrict green = out[1], *restrict blue = out[2];
    if (channels == 1) {
        for (size_t x = 0; x < n; x++) {
            const float v = sane(r[x]);
            red[x] = v * curve_gain(v * lr, smooth, edge, wide, by, foot);
        }
        return;
    }
    for (size_t x = 0; x < n; x++) {
        const float vr = sane(r[x]), vg = sane(g[x]), vb = sane(b[x]);
        const float gain = curve_gain(vr * lr + vg * lg + vb * lb, smooth, edge, wide, by, foot);
        red[x] = vr * gain;
        green[x] = vg * gain;
        blue[x] = vb * gain;
    }
}

FAST void host_excess(float *const out[3], const float *const in[3], size_t n, unsigned channels, enum bright_curve kind, const float curve[4],
                      const float luma[3])
{
    if (kind == BRIGHT_SMOOTHSTEP) {
        excess_luma(out, in, n, channels, true, curve, luma);
        return;
    }
    if (kind != BRIGHT_NONE && kind != BRIGHT_CHANNEL) {
        excess_luma(out, in, n, channels, false, curve, luma);
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

FAST void host_turn(float *restrict out, const float *restrict in, size_t pitch, size_t n)
{
    for (size_t x = 0; x < n; x++)
        for (size_t r = 0; r < HOST_ROWS; r++)
            out[x * HOST_ROWS + r] = in[r * pitch + x];
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
        for (unsigned r = 0; r < HOST_ROWS; r++)
            out[r] += held(sum[r]);
    }
}

static inline __attribute__((always_inline)) float mapped(float v, int kind)
{
    if (kind == DISPLAY_REINHARD)
        return v / (v + 1.0f);
    if (kind == DISPLAY_ACES) {
        // Narkowicz 2015; from 1 on over v^2, so that no square overflows.
        const float i = 1.0f / (v > 1.0f ? v : 1.0f);
        const float low = v * (2.51f * v + 0.03f) / (v * (2.43f * v + 0.59f) + 0.14f);
        const float high = (2.51f + 0.03f * i) / (2.43f + i * (0.59f + 0.14f * i));
        return v < 1.0f ? low : high;
    }
    return v;
}

static inline __attribute__((always_inline)) void drive(float *const light[3], size_t n, const struct host_drive *d, int tone_map)
{
    // Light that is this bright is held at full drive later anyway; sums of it stay finite.
    const float most = 1e30f;
    const struct host_drive k = *d;
    float *restrict red = light[0], *restrict green = light[1], *restrict blue = light[2];
    for (size_t x = 0; x < n; x++) {
        float r = mapped(within(red[x] * k.exposure, 0, most), tone_map);
        float g = mapped(within(green[x] * k.exposure, 0, most), tone_map);
        float b = mapped(within(blue[x] * k.exposure, 0, most), tone_map);
        const float l = r * k.luma[0] + g * k.luma[1] + b * k.luma[2];
        const float sr = l + k.saturation * (r - l), sg = l + k.saturation * (g - l), sb = l + k.saturation * (b - l);
        r = k.saturation == 1 ? r : sr > 0 ? sr : 0;
        g = k.saturation == 1 ? g : sg > 0 ? sg : 0;
        b = k.saturation == 1 ? b : sb > 0 ? sb : 0;
        red[x] = k.matrix[0][0] * r + k.matrix[0][1] * g + k.matrix[0][2] * b;
        green[x] = k.matrix[1][0] * r + k.matrix[1][1] * g + k.matrix[1][2] * b;
        blue[x] = k.matrix[2][0] * r + k.matrix[2][1] * g + k.matrix[2][2] * b;
    }
}

FAST void host_drive(float *const light[3], size_t n, const struct host_drive *d)
{
    if (d->tone_map == DISPLAY_ACES)
        drive(light, n, d, DISPLAY_ACES);
    else if (d->tone_map == DISPLAY_REINHARD)
        drive(light, n, d, DISPLAY_REINHARD);
    else
        drive(light, n, d, DISPLAY_NONE);
}
