// SPDX-License-Identifier: Apache-2.0
// look_list.c - METHODS section 2 as lists of stages; look.h says each look in words. Pure arithmetic.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "look_internal.h"

static const char *const names[] = { "none", "half-gaussian", "mip-chain", "three-scale", "jimenez", "airy-eight" };
const char *look_name(int look) { return names[look]; }

/* ---- taps ------------------------------------------------------------------------------------------ */

static const double three_scale_taps[] = { .227027, .194595, .121622, .054054, .016216 };
static const double mip_weights[] = { .20, .40, .24, .11, .05, .02 };
enum { MIPS = sizeof(mip_weights) / sizeof(mip_weights[0]), AIRY_HALVINGS = 8, JIMENEZ_MIPS = 5 };
static const double airy_darken = .8;

/* One side of a Gaussian, so that all of it sums to 1. */
static void gaussian(double *half, int radius, double sigma)
{
    double sum = 0;
    for (int i = -radius; i <= radius; i++)
        sum += exp(-(double)i * i / (2 * sigma * sigma));
    for (int i = 0; i <= radius; i++)
        half[i] = exp(-(double)i * i / (2 * sigma * sigma)) / sum;
}

static void add_tap(struct look_stage *s, double dx, double dy, double weight)
{
    assert(s->taps < LOOK_TAPS_MAX);
    s->tap[s->taps++] = (struct look_tap){ dx, dy, weight };
}

// The tap at a whole texel gets more weight, or is made.
static void add_whole(struct look_stage *s, double dx, double dy, double weight)
{
    if (weight == 0)
        return;
    for (unsigned i = 0; i < s->taps; i++)
        if (s->tap[i].dx == dx && s->tap[i].dy == dy) {
            s->tap[i].weight += weight;
            return;
        }
    add_tap(s, dx, dy, weight);
}

// A bilinear sample at the same size is four texels of fixed shares, also at a clamped edge: taps between texels become fewer whole
// ones, which round less.
static void add_between(struct look_stage *s, double dx, double dy, double weight)
{
    const double x = floor(dx), y = floor(dy), u = dx - x, v = dy - y;
    add_whole(s, x, y, weight * (1 - u) * (1 - v));
    add_whole(s, x + 1, y, weight * u * (1 - v));
    add_whole(s, x, y + 1, weight * (1 - u) * v);
    add_whole(s, x + 1, y + 1, weight * u * v);
}

static void line_taps(struct look_stage *s, const double *half, int radius, double step, bool down)
{
    for (int i = -radius; i <= radius; i++)
        add_between(s, down ? 0 : i * step, down ? i * step : 0, half[i < 0 ? -i : i]);
}

// Four corners at a distance.
static void corner_taps(struct look_stage *s, double distance, double weight)
{
    for (int i = 0; i < 4; i++)
        add_between(s, i & 1 ? distance : -distance, i & 2 ? distance : -distance, weight);
}

static void edge_taps(struct look_stage *s, double distance, double weight)
{
    for (int i = -1; i <= 1; i += 2) {
        add_tap(s, i * distance, 0, weight);
        add_tap(s, 0, i * distance, weight);
    }
}

/* ---- a list ------------------------------------------------------------------------------------------ */

static int new_image(struct look_list *l, uint32_t width, uint32_t height)
{
    assert(l->images < LOOK_IMAGES_MAX);
    l->image[l->images].width = width;
    l->image[l->images].height = height;
    l->image[l->images].layers = 1;
    return (int)l->images++;
}

// Texels of a row of rows: two for each texel of halfs.
static int new_rows(struct look_list *l, uint32_t width, uint32_t height)
{
    const int i = new_image(l, (width + 7) / 8 * 2, height);
    l->image[i].layers = 3;
    return i;
}

static uint32_t half_of(uint32_t n) { return n / 2 ? n / 2 : 1; }

static int half_image(struct look_list *l, int of)
{
    return new_image(l, half_of(l->image[of].width), half_of(l->image[of].height));
}

static int same_image(struct look_list *l, int as) { return new_image(l, l->image[as].width, l->image[as].height); }

static struct look_stage *new_stage(struct look_list *l, enum look_kind kind, int src, int add, int dst)
{
    assert(l->stages < LOOK_STAGES_MAX && dst != src && dst != add);
    struct look_stage *s = &l->stage[l->stages++];
    *s = (struct look_stage){ .kind = kind, .src = src, .add = add, .dst = dst, .weight = { 1, 1, 1 } };
    return s;
}

static void set_weight(struct look_stage *s, double weight)
{
    for (unsigned c = 0; c < 3; c++)
        s->weight[c] = (float)weight;
}

// dst = add + src at dst's size.
static struct look_stage *resample(struct look_list *l, int src, int add, int dst)
{
    struct look_stage *s = new_stage(l, LOOK_SAMPLE, src, add, dst);
    add_tap(s, 0, 0, 1);
    return s;
}

// Across into rows, down into dst; the last stage is returned.
static struct look_stage *blur(struct look_list *l, int src, int rows, int dst, const double *half, int radius, double step)
{
    line_taps(new_stage(l, LOOK_SAMPLE, src, -1, rows), half, radius, step, false);
    struct look_stage *s = new_stage(l, LOOK_SAMPLE, rows, -1, dst);
    line_taps(s, half, radius, step, true);
    return s;
}

// The images as sections of one image of rows.
static struct look_rows rows_of(struct look_list *l, const struct look_facts *f, const int *image, unsigned count)
{
    struct look_rows r = { .sections = count };
    uint32_t height = 0;
    assert(count <= LOOK_SECTIONS_MAX);
    for (unsigned i = 0; i < count; i++) {
        r.section[i].first = height;
        r.section[i].height = l->image[image[i]].height;
        height += r.section[i].height;
    }
    r.image = new_rows(l, f->width, height);
    for (unsigned i = 0; i < count; i++)
        new_stage(l, LOOK_ROWS, image[i], -1, r.image)->first = r.section[i].first;
    return r;
}

/* Light: of pixels (rows NULL), or of rows. */
static void sum_light(struct look_list *l, const struct look_facts *f, struct look_light *light, double factor, int pixels,
                      const struct look_rows *rows, bool curve)
{
    const int of = rows ? rows->image : pixels;
    const uint32_t width = rows ? (f->width + 3) / 4 : l->image[of].width;
    light->factor = factor;
    light->sums = new_image(l, width < LOOK_SUM_COLUMNS ? width : LOOK_SUM_COLUMNS, l->image[of].height);
    light->of = rows ? *rows : (struct look_rows){ .image = -1 };
    new_stage(l, LOOK_SUM, rows ? -1 : of, rows ? of : -1, light->sums)->curve = curve;
}

// E when it is kept at a size of its own: what a view shows of it, and its light.
static void keep_bright(struct look_list *l, const struct look_facts *f, int image)
{
    const bool twice = 2 * l->image[image].width == f->width && 2 * l->image[image].height == f->height;
    const bool same = l->image[image].width == f->width && l->image[image].height == f->height;
    if (f->want_bright || !(twice || same))
        l->bright = rows_of(l, f, &image, 1);
    // Drawn to twice its size every pixel counts 4 times, those at the edges too.
    if (twice || same)
        sum_light(l, f, &l->bright_light, twice ? 4 : 1, image, NULL, false);
    else
        sum_light(l, f, &l->bright_light, 1, -1, &l->bright, false);
}

// Every sample of the planes is in one pixel of the half size, with the same share.
static bool even(const struct look_facts *f) { return !f->matte && f->width % 2 == 0 && f->height % 2 == 0; }

// The matte, and the source: times the matte, and E already when the look's curve works at full size.
static int load(struct look_list *l, const struct look_facts *f, bool curve)
{
    if (f->matte) {
        l->matte = new_image(l, f->width, f->height);
        new_stage(l, LOOK_LOAD_MATTE, -1, -1, l->matte);
    }
    const int full = new_image(l, f->width, f->height);
    new_stage(l, LOOK_LOAD, l->matte, -1, full)->curve = curve;
    return full;
}

static int load_half(struct look_list *l, const struct look_facts *f, bool curve, bool after)
{
    const int half = new_image(l, f->width / 2, f->height / 2);
    struct look_stage *s = new_stage(l, LOOK_LOAD_HALF, -1, -1, half);
    s->curve = curve;
    s->after = after;
    return half;
}

// E at half size from I at half size: half-gaussian, jimenez.
static int bright_of_half(struct look_list *l, const struct look_facts *f)
{
    int half;
    if (even(f)) {
        half = load_half(l, f, true, true);
    } else {
        const int full = load(l, f, false);
        half = half_image(l, full);
        resample(l, full, -1, half)->curve = true;
    }
    keep_bright(l, f, half);
    return half;
}

// E of full size, halved: three-scale, airy-eight. weight: of the halving.
static int half_of_bright(struct look_list *l, const struct look_facts *f, double weight)
{
    int half;
    if (even(f) && !f->want_bright) {
        half = load_half(l, f, true, false);
        set_weight(&l->stage[l->stages - 1], weight);
        sum_light(l, f, &l->bright_light, 4 / weight, half, NULL, false);
    } else {
        const int full = load(l, f, true);
        keep_bright(l, f, full);
        half = half_image(l, full);
        set_weight(resample(l, full, -1, half), weight);
    }
    return half;
}

static void glow_of(struct look_list *l, const struct look_facts *f, const int *image, unsigned count)
{
    l->glow = rows_of(l, f, image, count);
    sum_light(l, f, &l->glow_light, 1, -1, &l->glow, false);
}

/* ---- the looks --------------------------------------------------------------------------------------- */

static void half_gaussian(struct look_list *l, const struct look_facts *f)
{
    double half[5];
    gaussian(half, 4, 1.8);
    const int bright = bright_of_half(l, f), rows = same_image(l, bright), glow = same_image(l, bright);
    blur(l, bright, rows, glow, half, 4, 1);
    glow_of(l, f, &glow, 1);
}

static void add_sun(struct look_list *l, const struct look_facts *f, struct look_stage *s)
{
    const struct sun_spec *sun = &f->params->sun_spec;
    double x, y, radius;
    look_sun_place(f->params, f->width, f->height, f->display_width, f->pixel_aspect, &x, &y, &radius);
    if (!sun->given || !(radius > 1e-6) || f->params->bloom == SWITCH_OFF)
        return;
    double mean = 0;
    for (unsigned c = 0; c < 3; c++) {
        s->weight[c] = (float)(sun->gain * sun->tint[c] * f->sun_share);
        mean += sun->tint[c] / 3;
    }
    if (f->channels == 1) {
        set_weight(s, 0);
        s->weight[0] = (float)(sun->gain * mean * f->sun_share);
    }
    // A pixel's middle less the sun, in two parts: whole pixels are exact.
    const float at[8] = { (float)floor(x), (float)floor(y), (float)(x - floor(x) - .5), (float)(y - floor(y) - .5),
                          (float)(1 / (2 * radius * radius)), (float)f->pixel_aspect };
    memcpy(l->sun, at, sizeof(at));
    s->after = true;
}

// weights[0] of the knee of `first`, rows, and the others of the sections.
static struct look_stage *mix(struct look_list *l, const struct look_facts *f, struct look_rows *out, int first,
                              const struct look_rows *others, const double *weights, unsigned count)
{
    *out = (struct look_rows){ .image = new_rows(l, f->width, f->height), .sections = 1, .section = { { 0, f->height } } };
    struct look_stage *s = new_stage(l, LOOK_MIX, others->image, first, out->image);
    set_weight(s, 0);
    s->curve = true;
    for (unsigned i = 0; i < count; i++)
        add_tap(s, 0, 0, weights[i]);
    return s;
}

static void mip_chain(struct look_list *l, const struct look_facts *f)
{
    struct look_rows full = { .sections = 1, .section = { { 0, f->height } } };
    int mip[MIPS];
    if (even(f)) {
        full.image = new_rows(l, f->width, f->height);
        new_stage(l, LOOK_LOAD_ROWS, -1, -1, full.image);
        mip[1] = load_half(l, f, false, false);
    } else {
        mip[0] = load(l, f, false);
        full = rows_of(l, f, mip, 1);
        mip[1] = half_image(l, mip[0]);
        resample(l, mip[0], -1, mip[1]);
    }
    for (unsigned m = 2; m < MIPS; m++) {
        mip[m] = half_image(l, mip[m - 1]);
        resample(l, mip[m - 1], -1, mip[m]);
    }
    l->mips = rows_of(l, f, mip + 1, MIPS - 1);
    add_sun(l, f, mix(l, f, &l->glow, full.image, &l->mips, mip_weights, MIPS));
    sum_light(l, f, &l->glow_light, 1, -1, &l->glow, false);
    sum_light(l, f, &l->bright_light, 1, -1, &full, true);
    if (f->want_bright)
        mix(l, f, &l->bright, full.image, &l->mips, (const double[]){ 1 }, 1);
}

// Which of the two holds the last pass.
static int kawase(struct look_list *l, int image, int other, unsigned passes)
{
    for (unsigned i = 0; i < passes; i++) {
        corner_taps(new_stage(l, LOOK_SAMPLE, image, -1, other), i + .5, .25);
        const int next = image;
        image = other;
        other = next;
    }
    return image;
}

static void scale_tint(float weight[3], const struct look_facts *f, unsigned scale)
{
    const struct params *p = f->params;
    const double one[3] = { 1, 1, 1 };
    const double *tint = !p->tint_count ? one : p->tints[scale < p->tint_count ? scale : p->tint_count - 1];
    for (unsigned c = 0; c < 3; c++)
        weight[c] = (float)(f->channels == 1 ? (tint[0] + tint[1] + tint[2]) / 3 : tint[c]);
}

static void three_scale(struct look_list *l, const struct look_facts *f)
{
    const unsigned scales = f->params->stages == STAGES_6 ? 6 : 3, passes = (unsigned)f->params->kawase;
    int scale[6], rows[6];
    for (unsigned i = 0; i < scales; i++) {
        if (i) {
            scale[i] = half_image(l, scale[i - 1]);
            resample(l, scale[i - 1], -1, scale[i]);
        } else {
            scale[0] = half_of_bright(l, f, 1);
        }
        rows[i] = same_image(l, scale[i]);
    }
    for (unsigned i = 0; i < scales; i++) {
        if (passes)
            scale[i] = kawase(l, scale[i], rows[i], passes);
        else
            blur(l, scale[i], rows[i], scale[i], three_scale_taps, 4, 1);
        scale_tint(l->stage[l->stages - 1].weight, f, i);
    }
    glow_of(l, f, scale, scales);
}

static void down_13(struct look_list *l, int src, int dst, bool legacy)
{
    struct look_stage *s = new_stage(l, LOOK_SAMPLE, src, -1, dst);
    const double outer = legacy ? 2 : 1;
    add_tap(s, 0, 0, .125);
    corner_taps(s, 1, .125);
    edge_taps(s, 2, outer / 16);
    corner_taps(s, 2, outer / 32);
}

static void tent_up(struct look_list *l, int src, int add, int dst)
{
    struct look_stage *s = new_stage(l, LOOK_SAMPLE, src, add, dst);
    add_tap(s, 0, 0, .25);
    edge_taps(s, 1, .125);
    corner_taps(s, 1, .0625);
}

static void jimenez(struct look_list *l, const struct look_facts *f)
{
    double half[5];
    int mip[JIMENEZ_MIPS + 1], spare[JIMENEZ_MIPS + 1];
    gaussian(half, 4, 1.8);
    mip[0] = bright_of_half(l, f);
    spare[0] = same_image(l, mip[0]);
    for (unsigned i = 1; i <= JIMENEZ_MIPS; i++) {
        mip[i] = half_image(l, mip[i - 1]);
        spare[i] = same_image(l, mip[i]);
        down_13(l, mip[i - 1], mip[i], f->params->legacy_gain == SWITCH_ON);
    }
    for (unsigned i = 1; i <= JIMENEZ_MIPS; i++)
        blur(l, mip[i], spare[i], mip[i], half, 4, f->params->radius);
    int sum = mip[JIMENEZ_MIPS];
    for (unsigned i = JIMENEZ_MIPS; i-- > 0; sum = spare[i])
        tent_up(l, sum, i ? mip[i] : -1, spare[i]);
    glow_of(l, f, &sum, 1);
}

static void airy_eight(struct look_list *l, const struct look_facts *f)
{
    double half[6], sum = 0;
    int image[AIRY_HALVINGS];
    gaussian(half, 5, 2);
    for (unsigned i = 1; i <= AIRY_HALVINGS; i++)
        sum += pow(airy_darken, i);
    image[0] = half_of_bright(l, f, airy_darken);
    for (unsigned i = 1; i < AIRY_HALVINGS; i++) {
        image[i] = half_image(l, image[i - 1]);
        set_weight(resample(l, image[i - 1], -1, image[i]), airy_darken);
    }
    for (unsigned i = 0; i < AIRY_HALVINGS; i++)
        set_weight(blur(l, image[i], same_image(l, image[i]), image[i], half, 5, 1), 1 / sum);
    glow_of(l, f, image, AIRY_HALVINGS);
}

/* ---- numbers ------------------------------------------------------------------------------------------- */

// Differences are taken in double: T - K must be 0 when K = T. Twin of record_bright() in bloom.c.
static void set_curve(struct look_list *l, const struct look_facts *f)
{
    static const unsigned char curves[] = { BRIGHT_NONE, BRIGHT_CHANNEL, BRIGHT_KNEE, BRIGHT_LUMINANCE, BRIGHT_SMOOTHSTEP,
                                            BRIGHT_CHANNEL };
    const struct params *p = f->params;
    const double scale = exp2(-f->exposure);
    const double t = (p->threshold_unit == UNIT_STOPS ? exp2(p->threshold) : p->threshold) * scale;
    l->curve = (enum bright_curve)curves[p->look];
    const bool smooth = l->curve == BRIGHT_SMOOTHSTEP;
    const double k = smooth ? t * p->knee : l->curve == BRIGHT_KNEE ? fmin(p->knee * scale, t) : 0;
    l->threshold = t;
    l->foot = t - k;
    l->numbers[0] = (float)t;
    l->numbers[1] = (float)(2 * k);
    l->numbers[2] = k > 0 ? (float)(1 / ((smooth ? 2 : 4) * k)) : 0;
    l->numbers[3] = (float)(t - k);
}

void look_list_make(struct look_list *l, const struct look_facts *f)
{
    static void (*const makers[])(struct look_list *, const struct look_facts *) = {
        NULL, half_gaussian, mip_chain, three_scale, jimenez, airy_eight
    };
    assert(f->params->look > LOOK_NONE && f->params->look <= LOOK_AIRY_EIGHT);
    l->images = l->stages = 0;
    l->matte = -1;
    l->glow = l->bright = l->mips = (struct look_rows){ .image = -1 };
    l->glow_light = l->bright_light = (struct look_light){ .sums = -1 };
    set_curve(l, f);
    makers[f->params->look](l, f);
    look_bound(l, f);
}

int look_print(const struct params *p, uint32_t width, uint32_t height, char *out, size_t size)
{
    const uint32_t w = half_of(width), h = half_of(height);
    switch (p->look) {
    case LOOK_HALF_GAUSSIAN:
        return snprintf(out, size, "half-gaussian: channel bright pass at %u x %u, 9 + 9 taps of sigma 1.8", w, h);
    case LOOK_MIP_CHAIN:
        return snprintf(out, size, "mip-chain: knee bright pass of 6 mips from %u x %u on, each at full size%s", width, height,
                        p->sun_spec.given ? "; the sun" : "");
    case LOOK_THREE_SCALE:
        if (p->kawase >= 1)
            return snprintf(out, size, "three-scale: luminance bright pass, %d halvings from %u x %u on, %u Kawase passes at each",
                            p->stages == STAGES_6 ? 6 : 3, w, h, (unsigned)p->kawase);
        return snprintf(out, size, "three-scale: luminance bright pass, %d halvings from %u x %u on, 9 + 9 taps at each",
                        p->stages == STAGES_6 ? 6 : 3, w, h);
    case LOOK_JIMENEZ:
        return snprintf(out, size, "jimenez: smoothstep bright pass at %u x %u, 5 mips of 13 taps%s, 9 + 9 taps %g texels apart at "
                        "each, tents up", w, h, p->legacy_gain == SWITCH_ON ? " that sum to 1.375" : "", p->radius);
    case LOOK_AIRY_EIGHT:
        return snprintf(out, size, "airy-eight: channel bright pass, 8 halvings from %u x %u on, each times %g, 11 + 11 taps at each",
                        w, h, airy_darken);
    default:
        return snprintf(out, size, "no look");
    }
}
