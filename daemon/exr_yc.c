// SPDX-License-Identifier: Apache-2.0
/*
 * exr_yc.c - luminance-chroma parts: Y, RY = (R - Y) / Y, BY = (B - Y) / Y, chroma at full or half size.
 *
 * Decoding is the library's reconstruction (27-tap filters of ImfRgbaYca) in float, without its final
 * desaturation. Encoding is a difference: a sample that no changed pixel reaches keeps its bits, others
 * get the decimated change of chroma added to what the file has; so nothing is lost by the filters
 * where there is no glow, and little where there is.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "exr_internal.h"

enum { REACH = 13, TAPS = 7 };

// At distances 1, 3, .. 13: what rebuilds an odd sample, and half of it for decimation (centre: 0.499846).
static const float rebuild[TAPS] = { 0.627123f, -0.186077f, 0.087929f, -0.043159f,
                                     0.019597f, -0.007540f, 0.002128f };
static const float decimate[TAPS] = { 0.313659f, -0.093067f, 0.043978f, -0.021586f,
                                      0.009801f, -0.003771f, 0.001064f };
static const float decimate_centre = 0.499846f;

static int64_t clamp(int64_t v, int64_t most) { return v < 0 ? 0 : v > most ? most : v; }

struct frame_rows {
    float *chroma[2];  // h/s rows of w: chroma widened to full width; or h rows of w/s: narrowed changes
    float *row[5];     // scratch rows of w
    uint16_t *half;
    uint8_t *changed;  // [h]
};

static void rows_free(struct frame_rows *r)
{
    for (int i = 0; i < 2; i++)
        free(r->chroma[i]);
    for (int i = 0; i < 5; i++)
        free(r->row[i]);
    free(r->half);
    free(r->changed);
}

static int rows_alloc(struct frame_rows *r, uint32_t width, uint32_t height, uint64_t chroma, struct fault *f)
{
    *r = (struct frame_rows){ .half = malloc(2 * (size_t)width), .changed = calloc(height, 1) };
    bool ok = r->half && r->changed;
    for (int i = 0; i < 2; i++)
        ok &= (r->chroma[i] = malloc(chroma * sizeof(float))) != NULL;
    for (int i = 0; i < 5; i++)
        ok &= (r->row[i] = malloc(width * sizeof(float))) != NULL;
    if (ok)
        return 0;
    rows_free(r);
    return fault_set(f, FAULT_NO_MEMORY, "", "no memory to rebuild luminance-chroma");
}

// ---- decode -----------------------------------------------------------------------------------------------

static void widen(float *out, const float *in, uint32_t width)
{
    const int64_t last = width / 2 - 1;
    for (int64_t i = 0; i <= last; i++) {
        float sum = 0;
        for (int k = 0; k < TAPS; k++)
            sum += rebuild[k] * (in[clamp(i - k, last)] + in[clamp(i + 1 + k, last)]);
        out[2 * i] = in[i];
        out[2 * i + 1] = sum;
    }
}

static void rebuild_row(float *out, const float *rows, uint32_t width, uint32_t height, uint32_t y)
{
    const int64_t i = y / 2, last = height / 2 - 1;
    if (y % 2 == 0) {
        memcpy(out, rows + (size_t)i * width, width * sizeof(float));
        return;
    }
    memset(out, 0, width * sizeof(float));
    for (int k = 0; k < TAPS; k++) {
        const float *a = rows + (size_t)clamp(i - k, last) * width;
        const float *b = rows + (size_t)clamp(i + 1 + k, last) * width;
        for (uint32_t j = 0; j < width; j++)
            out[j] += rebuild[k] * (a[j] + b[j]);
    }
}

static void to_rgb(float *r, float *g, float *b, const float *y, const float *ry, const float *by,
                   uint32_t width, const float luma[3])
{
    for (uint32_t i = 0; i < width; i++) {
        if (ry[i] == 0 && by[i] == 0) { // grey stays exactly grey
            r[i] = g[i] = b[i] = y[i];
            continue;
        }
        r[i] = (ry[i] + 1) * y[i];
        b[i] = (by[i] + 1) * y[i];
        g[i] = (y[i] - r[i] * luma[0] - b[i] * luma[2]) / luma[1];
    }
}

int exr_yc_decode(struct exr *x, struct exr_state *t, struct fault *f)
{
    const struct exr_part *p = &x->part[t->pub.part];
    const uint32_t w = t->pub.width, h = t->pub.height, s = t->chroma_sampling;
    struct frame_rows r;
    if (rows_alloc(&r, w, h, (uint64_t)w * (h / s), f))
        return -1;
    const unsigned luminance = exr_channel_of(x, t, 0);
    for (unsigned c = 0; c < 2; c++) {
        const unsigned channel = exr_channel_of(x, t, c + 1);
        for (uint32_t y = 0; y < h; y += s) {
            float *to = r.chroma[c] + (size_t)(y / s) * w;
            exr_fetch_row(p, channel, y, s == 2 ? r.row[0] : to, r.half);
            if (s == 2)
                widen(to, r.row[0], w);
        }
    }
    for (uint32_t y = 0; y < h; y++) {
        const float *chroma[2];
        exr_fetch_row(p, luminance, y, r.row[0], r.half);
        for (unsigned c = 0; c < 2; c++) {
            chroma[c] = s == 2 ? r.row[1 + c] : r.chroma[c] + (size_t)y * w;
            if (s == 2)
                rebuild_row(r.row[1 + c], r.chroma[c], w, h, y);
        }
        to_rgb((float *)(void *)planes_row(&t->in, 0, y), (float *)(void *)planes_row(&t->in, 1, y),
               (float *)(void *)planes_row(&t->in, 2, y), r.row[0], chroma[0], chroma[1], w, t->yw);
        frame_scan_row(&t->pub.scan, &t->in, y, t->pub.luma);
    }
    rows_free(&r);
    return 0;
}

// ---- encode -----------------------------------------------------------------------------------------------

// Chroma of one pixel as the library makes it: only finite, non-negative colours have one.
static void chroma_of(const float rgb[3], const float luma[3], float out[2])
{
    float v[3];
    for (int i = 0; i < 3; i++)
        v[i] = isfinite(rgb[i]) && rgb[i] > 0 ? rgb[i] : 0;
    out[0] = out[1] = 0;
    if (v[0] == v[1] && v[1] == v[2])
        return;
    const float y = v[0] * luma[0] + v[1] * luma[1] + v[2] * luma[2];
    for (int i = 0; i < 2; i++)
        if (fabsf(v[2 * i] - y) < 65504.0f * y)
            out[i] = (v[2 * i] - y) / y;
}

static bool same_bits(float a, float b)
{
    return !memcmp(&a, &b, 4) || (a != a && b != b);
}

// New luminance into y (which has the old one), changes of chroma into d; true when anything changed.
static bool changes_of_row(const struct exr_state *t, uint32_t at, float *y, float *const d[2])
{
    const float *in[3], *out[3];
    bool any = false;
    for (unsigned c = 0; c < 3; c++) {
        in[c] = (const float *)(const void *)planes_row(&t->in, c, at);
        out[c] = (const float *)(const void *)planes_row(&t->out[0], c, at);
    }
    const float *l = t->yw;
    for (uint32_t i = 0; i < t->pub.width; i++) {
        d[0][i] = d[1][i] = 0;
        const float a[3] = { in[0][i], in[1][i], in[2][i] }, b[3] = { out[0][i], out[1][i], out[2][i] };
        if (same_bits(a[0], b[0]) && same_bits(a[1], b[1]) && same_bits(a[2], b[2]))
            continue;
        float before[2], after[2];
        any = true;
        y[i] = b[0] == b[1] && b[1] == b[2] ? b[0] : b[0] * l[0] + b[1] * l[1] + b[2] * l[2];
        chroma_of(a, l, before);
        chroma_of(b, l, after);
        d[0][i] = after[0] - before[0];
        d[1][i] = after[1] - before[1];
    }
    return any;
}

static void narrow(float *out, const float *in, uint32_t width)
{
    const int64_t last = (int64_t)width - 1;
    for (int64_t i = 0; i <= last; i += 2) {
        float sum = decimate_centre * in[i];
        for (int k = 0; k < TAPS; k++)
            sum += decimate[k] * (in[clamp(i - 1 - 2 * k, last)] + in[clamp(i + 1 + 2 * k, last)]);
        out[i / 2] = sum;
    }
}

// Adds to a chroma row the change that reaches it.
static void add_change(float *row, const struct frame_rows *r, unsigned c, uint32_t n, uint32_t height,
                       uint32_t y, uint32_t s)
{
    const int64_t last = (int64_t)height - 1;
    if (s == 1) {
        for (uint32_t i = 0; i < n; i++)
            row[i] += r->chroma[c][(size_t)y * n + i];
        return;
    }
    bool reached = r->changed[y];
    for (int k = 1; k <= REACH; k += 2)
        reached |= r->changed[clamp((int64_t)y - k, last)] | r->changed[clamp((int64_t)y + k, last)];
    if (!reached)
        return;
    for (uint32_t i = 0; i < n; i++) {
        float sum = decimate_centre * r->chroma[c][(size_t)y * n + i];
        for (int k = 0; k < TAPS; k++)
            sum += decimate[k] * (r->chroma[c][(size_t)clamp((int64_t)y - 1 - 2 * k, last) * n + i] +
                                  r->chroma[c][(size_t)clamp((int64_t)y + 1 + 2 * k, last) * n + i]);
        if (sum != 0)
            row[i] += sum;
    }
}

int exr_yc_encode(struct exr *x, struct exr_state *t, struct fault *f)
{
    const struct exr_part *p = &x->part[t->pub.part];
    const uint32_t w = t->pub.width, h = t->pub.height, s = t->chroma_sampling, n = w / s;
    struct frame_rows r;
    for (unsigned i = 0; i < 3; i++)
        if (planes_alloc(&t->yc[i], i ? n : w, i ? h / s : h, 1, PIXEL_TYPE_FLOAT))
            return fault_set(f, FAULT_NO_MEMORY, "", "no memory for luminance-chroma");
    if (rows_alloc(&r, w, h, (uint64_t)n * h, f))
        return -1;
    const unsigned luminance = exr_channel_of(x, t, 0);
    for (uint32_t y = 0; y < h; y++) {
        float *to = (float *)(void *)planes_row(&t->yc[0], 0, y), *const d[2] = { r.row[0], r.row[1] };
        exr_fetch_row(p, luminance, y, to, r.half);
        r.changed[y] = changes_of_row(t, y, to, d);
        for (unsigned c = 0; c < 2; c++) {
            if (s == 2)
                narrow(r.chroma[c] + (size_t)y * n, d[c], w);
            else
                memcpy(r.chroma[c] + (size_t)y * n, d[c], w * sizeof(float));
        }
    }
    for (unsigned c = 0; c < 2; c++) {
        const unsigned channel = exr_channel_of(x, t, c + 1);
        for (uint32_t y = 0; y < h; y += s) {
            float *to = (float *)(void *)planes_row(&t->yc[1 + c], 0, y / s);
            exr_fetch_row(p, channel, y, to, r.half);
            add_change(to, &r, c, n, h, y, s);
        }
    }
    rows_free(&r);
    return 0;
}
