// SPDX-License-Identifier: Apache-2.0
// scene.c - the frame that everything is measured on, as planes and as an EXR file. Compression and the
// bright pass both depend on what is in a picture: so smooth light, grain and lamps, not noise and not
// one colour.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"
#include "exr.h"

/* ---- light -----------------------------------------------------------------------------------------
 */

static double hash(uint32_t x, uint32_t y, uint32_t seed)
{
    uint32_t h = x * 0x9e3779b1u ^ y * 0x85ebca77u ^ seed * 0xc2b2ae3du;
    h = (h ^ h >> 15) * 0x2c1b3c6du;
    h = (h ^ h >> 12) * 0x297a2d39u;
    return (double)(h ^ h >> 15) * 0x1p-32;
}

static double mix(double a, double b, double t) { return a + (b - a) * t; }

// Values on a lattice, smoothly joined.
static double lattice(double u, double v, uint32_t seed)
{
    double fu = floor(u), fv = floor(v), a = u - fu, b = v - fv;
    uint32_t x = (uint32_t)(int32_t)fu, y = (uint32_t)(int32_t)fv;
    a *= a * (3 - 2 * a);
    b *= b * (3 - 2 * b);
    return mix(mix(hash(x, y, seed), hash(x + 1, y, seed), a),
               mix(hash(x, y + 1, seed), hash(x + 1, y + 1, seed), a), b);
}

// u across (0 .. aspect), v down (0 .. 1): ground, a glowing horizon, clouds, lit windows below.
static void light(double rgb[3], double u, double v)
{
    double clouds = .55 * lattice(3 * u, 5 * v, 1) + .3 * lattice(9 * u, 14 * v, 2) +
                    .15 * lattice(31 * u, 43 * v, 3);
    double horizon = exp(-(v - .5) * (v - .5) / .02),
           base = .02 + .15 * clouds + 1.4 * horizon * (.3 + clouds);
    double warm = .5 + .5 * lattice(1.7 * u, 2 * v, 4);
    if (v > .62) {
        double wu = u * 24, wv = v * 26;
        bool window = wu - floor(wu) > .3 && wv - floor(wv) > .35;
        double lit = hash((uint32_t)wu, (uint32_t)wv, 5);
        base = .05 + .2 * clouds + (window && lit > .6 ? 3 * lit : 0);
    }
    rgb[0] = base * (.7 + .5 * warm);
    rgb[1] = base;
    rgb[2] = base * (1.25 - .6 * warm);
}

struct painter {
    struct bench_frame *f;
    double gain;
};

static void base_row(const struct painter *p, uint32_t y)
{
    const struct planes *out = &p->f->in_float;
    double scale = 1.0 / p->f->height;
    for (uint32_t x = 0; x < out->width; x++) {
        double rgb[3], shot = hash(x, y, 6) + hash(x, y, 7) + hash(x, y, 8) - 1.5; // sigma .5
        light(rgb, (x + .5) * scale, (y + .5) * scale);
        for (unsigned c = 0; c < 3; c++) {
            double v = rgb[c] * p->gain, grain = .012 * sqrt(v) * (shot + hash(x, y, 9 + c) - .5);
            ((float *)planes_row(out, c, y))[x] = (float)fmax(v + grain, 0);
        }
    }
}

static void base_rows(void *ctx, unsigned member)
{
    const struct painter *p = ctx;
    for (uint32_t y = member; y < p->f->height; y += TEAM)
        base_row(p, y);
}

static void lamp(const struct planes *out, uint32_t i)
{
    double size = out->height / 1080.0, r = size * (1 + 9 * pow(hash(i, 0, 20), 3));
    double x0 = hash(i, 1, 20) * out->width;
    double y0 = out->height * (i % 3 ? .35 + .6 * hash(i, 2, 20)
                                     : hash(i, 2, 20)); // some in the sky: no row stays dark
    double peak = 5 * pow(1000, hash(i, 3, 20)), warm = hash(i, 4, 20);
    double tint[3] = { 1, .55 + .4 * warm, .2 + .8 * warm };
    for (long y = lrint(y0 - 2 * r); y <= lrint(y0 + 2 * r); y++)
        for (long x = lrint(x0 - 2 * r); x <= lrint(x0 + 2 * r); x++) {
            double d = hypot((double)x - x0, (double)y - y0) / r;
            if (x < 0 || y < 0 || x >= (long)out->width || y >= (long)out->height || d >= 2)
                continue;
            for (unsigned c = 0; c < 3; c++)
                ((float *)planes_row(out, c, (uint32_t)y))[x] +=
                    (float)(peak * tint[c] * pow(1 - d / 2, 4));
        }
}

static float brightest(const struct planes *p, uint32_t x, uint32_t y)
{
    float m = 0;
    for (unsigned c = 0; c < 3; c++)
        m = fmaxf(m, ((const float *)planes_row(p, c, y))[x]);
    return m;
}

static int by_value(const void *a, const void *b)
{
    return *(const float *)a < *(const float *)b ? -1 : *(const float *)a > *(const float *)b;
}

// The gain with which one pixel in five is above 1, from the light at one pixel in 64.
static double gain_for(const struct bench_frame *f)
{
    size_t n = 0;
    float *v = take((size_t)(f->width / 8 + 1) * (f->height / 8 + 1), sizeof(*v));
    for (uint32_t y = 4; y < f->height; y += 8)
        for (uint32_t x = 4; x < f->width; x += 8) {
            double rgb[3];
            light(rgb, (x + .5) / f->height, (y + .5) / f->height);
            v[n++] = (float)fmax(rgb[0], fmax(rgb[1], rgb[2]));
        }
    qsort(v, n, sizeof(*v), by_value);
    double gain = 1 / v[n * 4 / 5];
    free(v);
    return gain;
}

static void to_half(struct bench_frame *f)
{
    uint64_t bright = 0;
    for (uint32_t y = 0; y < f->height; y++) {
        for (unsigned c = 0; c < 3; c++)
            float_to_half((uint16_t *)planes_row(&f->in_half, c, y),
                          (const float *)planes_row(&f->in_float, c, y), f->width);
        for (uint32_t x = 0; x < f->width; x++)
            bright += brightest(&f->in_float, x, y) > 1;
    }
    f->bright_share = (double)bright / ((double)f->width * f->height);
}

/* ---- EXR ---------------------------------------------------------------------------------------------
 */

static void put(uint8_t **at, const void *bytes, size_t n)
{
    memcpy(*at, bytes, n);
    *at += n;
}

static void put_u32(uint8_t **at, uint32_t v)
{
    put(at, &v, 4);
} // little-endian machines, as the shaders

static void put_attribute(uint8_t **at, const char *name, const char *type, const void *value,
                          uint32_t n)
{
    put(at, name, strlen(name) + 1);
    put(at, type, strlen(type) + 1);
    put_u32(at, n);
    put(at, value, n);
}

static uint8_t *put_header(uint8_t *at, const struct bench_frame *f)
{
    uint8_t list[80], *p = list;
    for (const char *name = "ABGR"; *name; name++) {
        put(&p, (char[2]){ *name, 0 }, 2);
        put(&p, (uint32_t[4]){ PIXEL_TYPE_HALF, 0, 1, 1 }, 16);
    }
    *p++ = 0;
    int32_t window[4] = { 0, 0, (int32_t)f->width - 1, (int32_t)f->height - 1 };
    put(&at, (uint8_t[8]){ 0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0 }, 8);
    put_attribute(&at, "channels", "chlist", list, (uint32_t)(p - list));
    put_attribute(&at, "compression", "compression", "\0", 1);
    put_attribute(&at, "dataWindow", "box2i", window, 16);
    put_attribute(&at, "displayWindow", "box2i", window, 16);
    put_attribute(&at, "lineOrder", "lineOrder", "\0", 1);
    put_attribute(&at, "pixelAspectRatio", "float", &(float){ 1 }, 4);
    put_attribute(&at, "screenWindowCenter", "v2f", (float[2]){ 0 }, 8);
    put_attribute(&at, "screenWindowWidth", "float", &(float){ 1 }, 4);
    *at++ = 0;
    return at;
}

// An uncompressed file of R, G, B and an alpha of 1, by the format's description.
static uint8_t *plain_exr(const struct bench_frame *f, uint64_t *bytes)
{
    size_t line = (size_t)f->width * 2, chunk = 8 + 4 * line;
    uint8_t *file = take(1, 4096 + f->height * (chunk + 8)), *at = put_header(file, f);
    uint64_t offset = (uint64_t)(at - file) + 8 * (uint64_t)f->height;
    for (uint32_t y = 0; y < f->height; y++, offset += chunk)
        put(&at, &offset, 8);
    for (uint32_t y = 0; y < f->height; y++) {
        put_u32(&at, y);
        put_u32(&at, (uint32_t)(4 * line));
        for (uint32_t x = 0; x < f->width; x++)
            put(&at, &(uint16_t){ 0x3c00 }, 2);
        for (unsigned c = 3; c-- > 0;)
            put(&at, planes_row(&f->in_half, c, y), line);
    }
    *bytes = (uint64_t)(at - file);
    return file;
}

static void to_exr(struct bench_frame *f, struct team *team)
{
    uint64_t bytes;
    uint8_t *plain = plain_exr(f, &bytes);
    struct codec *codec = codec_create(team);
    struct planes in;
    if (planes_alloc(&in, f->width, f->height, 3, PIXEL_TYPE_HALF))
        die("no memory for %s planes", f->size);
    f->exr = take(1, 2 * bytes);
    f->exr_bytes = codec_run(codec, plain, bytes, EXR_ZIP, &in, &f->in_half, f->exr, 2 * bytes).bytes;
    codec_read(codec, f->exr, f->exr_bytes, &in);
    planes_same(&in, &f->in_half, "the frame's own EXR file");
    planes_free(&in);
    codec_destroy(codec);
    free(plain);
}

/* ---- planes
 * -------------------------------------------------------------------------------------------- */

void planes_fill(const struct planes *to, const struct planes *from)
{
    for (unsigned c = 0; c < to->count; c++)
        for (uint32_t y = 0; y < to->height; y++)
            memcpy(planes_row(to, c, y), planes_row(from, c, y),
                   to->width * (size_t)pixel_bytes(to->type));
}

void planes_same(const struct planes *a, const struct planes *b, const char *what)
{
    size_t size = pixel_bytes(a->type);
    for (unsigned c = 0; c < a->count; c++)
        for (uint32_t y = 0; y < a->height; y++)
            for (uint32_t x = 0; memcmp(planes_row(a, c, y), planes_row(b, c, y), a->width * size); x++)
                if (memcmp(planes_row(a, c, y) + x * size, planes_row(b, c, y) + x * size, size))
                    die("%s: pixel %u,%u of plane %u differs", what, x, y, c);
}

void frame_make(struct bench_frame *f, uint32_t width, uint32_t height, struct team *team)
{
    *f = (struct bench_frame){ .width = width, .height = height };
    snprintf(f->size, sizeof f->size, "%ux%u", width, height);
    if (planes_alloc(&f->in_float, width, height, 3, PIXEL_TYPE_FLOAT) ||
        planes_alloc(&f->out_float, width, height, 3, PIXEL_TYPE_FLOAT) ||
        planes_alloc(&f->in_half, width, height, 3, PIXEL_TYPE_HALF) ||
        planes_alloc(&f->out_half, width, height, 3, PIXEL_TYPE_HALF))
        die("no memory for %s planes", f->size);
    struct painter p = { f, gain_for(f) };
    team_run(team, base_rows, &p);
    for (uint32_t i = 0; i < 180; i++)
        lamp(&f->in_float, i);
    to_half(f);
    to_exr(f, team);
}

void frame_finish(struct bench_frame *f)
{
    planes_free(&f->in_float);
    planes_free(&f->in_half);
    planes_free(&f->out_float);
    planes_free(&f->out_half);
    free(f->exr);
}
