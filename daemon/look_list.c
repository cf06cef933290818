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
    s->tap[s->taps++] = (struct look_tap){ (float)dx, (float)dy, (float)weight };
}

static void line_taps(struct look_stage *s, const double *half, int radius, double step, bool down)
{
    for (int i = -radius; i <= radius; i++)
        add_tap(s, down ? 0 : i * step, down ? i * step : 0, half[i < 0 ? -i : i]);
}

// Four corners at a distance.
static void corner_taps(struct look_stage *s, double distance, double weight)
{
    for (int i = 0; i < 4; i++)
        add_tap(s, i & 1 ? distance : -distance, i & 2 ? distance : -distance, weight);
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
    return (int)l->images++;
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

// The images' sum at full size. The first addition takes two at once.
static int sum_of(struct look_list *l, const int *image, unsigned count, int full)
{
    int sum = image[0], spare = -1;
    for (unsigned i = 1; i < count; i++) {
        const int dst = i < 3 ? same_image(l, full) : spare;
        resample(l, image[i], sum, dst);
        spare = sum;
        sum = dst;
    }
    return sum;
}

// The matte, and the source: times the matte, and E already when the look's curve works at full size.
static int load(struct look_list *l, const struct look_facts *f, bool curve)
{
    l->matte = -1;
    if (f->matte) {
        l->matte = new_image(l, f->width, f->height);
        new_stage(l, LOOK_LOAD_MATTE, -1, -1, l->matte);
    }
    const int full = new_image(l, f->width, f->height);
    new_stage(l, LOOK_LOAD, l->matte, -1, full)->curve = curve;
    return full;
}

/* ---- the looks --------------------------------------------------------------------------------------- */

static void half_gaussian(struct look_list *l, const struct look_facts *f)
{
    double half[5];
    gaussian(half, 4, 1.8);
    const int full = load(l, f, false);
    l->bright = half_image(l, full);
    resample(l, full, -1, l->bright)->curve = true;
    const int rows = same_image(l, l->bright);
    l->glow = same_image(l, l->bright);
    blur(l, l->bright, rows, l->glow, half, 4, 1);
}

static int add_sun(struct look_list *l, const struct look_facts *f, int sum, int spare)
{
    const struct sun_spec *sun = &f->params->sun_spec;
    double x, y, radius;
    look_sun_place(f->params, f->width, f->height, f->display_width, f->pixel_aspect, &x, &y, &radius);
    if (!sun->given || !(radius > 1e-6) || f->params->bloom == SWITCH_OFF)
        return sum;
    struct look_stage *s = new_stage(l, LOOK_SUN, -1, sum, spare);
    double mean = 0;
    for (unsigned c = 0; c < 3; c++) {
        s->weight[c] = (float)(sun->gain * sun->tint[c] * f->sun_share);
        mean += sun->tint[c] / 3;
    }
    if (f->channels == 1)
        s->weight[0] = (float)(sun->gain * mean * f->sun_share);
    // A pixel's middle less the sun, in two parts: whole pixels are exact.
    const float at[8] = { (float)floor(x), (float)floor(y), (float)(x - floor(x) - .5), (float)(y - floor(y) - .5),
                          (float)(1 / (2 * radius * radius)), (float)f->pixel_aspect };
    memcpy(l->sun, at, sizeof(at));
    return spare;
}

static void mip_chain(struct look_list *l, const struct look_facts *f)
{
    int mip[MIPS], sum[2];
    mip[0] = load(l, f, false);
    for (unsigned m = 1; m < MIPS; m++) {
        mip[m] = half_image(l, mip[m - 1]);
        resample(l, mip[m - 1], -1, mip[m]);
    }
    for (unsigned i = 0; i < 2; i++)
        sum[i] = same_image(l, mip[0]);
    for (unsigned m = 0; m < MIPS; m++) {
        struct look_stage *s = resample(l, mip[m], m ? sum[m & 1] : -1, sum[~m & 1]);
        s->curve = true;
        set_weight(s, mip_weights[m]);
    }
    l->glow = add_sun(l, f, sum[~(MIPS - 1) & 1], sum[(MIPS - 1) & 1]);
    if (f->want_bright) {
        l->bright = same_image(l, mip[0]);
        resample(l, mip[0], -1, l->bright)->curve = true;
    }
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
    l->bright = load(l, f, true);
    for (unsigned i = 0; i < scales; i++) {
        scale[i] = half_image(l, i ? scale[i - 1] : l->bright);
        rows[i] = same_image(l, scale[i]);
        resample(l, i ? scale[i - 1] : l->bright, -1, scale[i]);
    }
    for (unsigned i = 0; i < scales; i++) {
        if (passes)
            scale[i] = kawase(l, scale[i], rows[i], passes);
        else
            blur(l, scale[i], rows[i], scale[i], three_scale_taps, 4, 1);
        scale_tint(l->stage[l->stages - 1].weight, f, i);
    }
    l->glow = sum_of(l, scale, scales, l->bright);
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
    const int full = load(l, f, false);
    mip[0] = l->bright = half_image(l, full);
    spare[0] = same_image(l, mip[0]);
    resample(l, full, -1, mip[0])->curve = true;
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
    l->glow = sum;
}

static void airy_eight(struct look_list *l, const struct look_facts *f)
{
    double half[6], sum = 0;
    int image[AIRY_HALVINGS];
    gaussian(half, 5, 2);
    for (unsigned i = 1; i <= AIRY_HALVINGS; i++)
        sum += pow(airy_darken, i);
    l->bright = load(l, f, true);
    for (unsigned i = 0; i < AIRY_HALVINGS; i++) {
        const int from = i ? image[i - 1] : l->bright;
        image[i] = half_image(l, from);
        set_weight(resample(l, from, -1, image[i]), airy_darken);
    }
    for (unsigned i = 0; i < AIRY_HALVINGS; i++)
        set_weight(blur(l, image[i], same_image(l, image[i]), image[i], half, 5, 1), 1 / sum);
    l->glow = sum_of(l, image, AIRY_HALVINGS, l->bright);
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

static bool power_of_2(float v) { return v == 0 || frexpf(v, &(int){ 0 }) == .5f; }

// Roundings that one stage puts on a value: all numbers are >= 0, so each is a share 2^-24 of the value itself.
static double roundings(const struct look_list *l, const struct look_stage *s)
{
    if (s->kind == LOOK_LOAD_MATTE || s->kind == LOOK_LOAD)
        return s->src >= 0 ? 3 : 0; // the matte's two products, and emission's own
    if (s->kind == LOOK_SUN)
        return 8; // of exp(-u) in u: 3 roundings times u exp(-u) < .4; the series, the weight, the sum
    bool whole = true, exact = true;
    for (unsigned i = 0; i < s->taps; i++) {
        whole = whole && s->tap[i].dx == floorf(s->tap[i].dx) && s->tap[i].dy == floorf(s->tap[i].dy);
        exact = exact && power_of_2(s->tap[i].weight);
    }
    const bool same = l->image[s->src].width == l->image[s->dst].width && l->image[s->src].height == l->image[s->dst].height;
    double n = same && whole ? 0 : 6; // a position's rest, its product and the sum, for each axis
    n += exact ? 0 : 2;
    n += s->taps > 1 ? (s->taps + 3) / 4 - 1 + 2 : 0;
    for (unsigned c = 0; c < 3; c++)
        if (!power_of_2(s->weight[c]))
            return n + 2 + (s->add >= 0);
    return n + (s->add >= 0);
}

// Before the curve a rounding is a share of the sample, and the curve's slope makes it more; after it, a share of the glow.
static void count_roundings(struct look_list *l, const struct look_facts *f)
{
    double before[LOOK_IMAGES_MAX] = { 0 }, after[LOOK_IMAGES_MAX] = { 0 }, gain[LOOK_IMAGES_MAX] = { 0 };
    bool lit[LOOK_IMAGES_MAX] = { false }; // past the curve
    for (unsigned i = 0; i < l->stages; i++) {
        const struct look_stage *s = &l->stage[i];
        const int from = s->kind == LOOK_SAMPLE ? s->src : s->kind == LOOK_SUN ? s->add : -1;
        double sum = 0, b = from >= 0 ? before[from] : 0, a = from >= 0 ? after[from] : 0, n = roundings(l, s);
        for (unsigned t = 0; t < s->taps; t++)
            sum += s->tap[t].weight;
        sum = from < 0 || s->kind == LOOK_SUN ? 1 : sum * fmax(s->weight[0], fmax(s->weight[1], s->weight[2]));
        double g = from >= 0 ? gain[from] * sum : 1;
        const bool past = from >= 0 && lit[from];
        *(past ? &a : &b) += n;
        if (s->curve) {
            // E = I * s(L): 3 products and sums of L, 5 of s and its product; smoothstep is 1.5 / 2TK steep at L = T(1 + K).
            const double k = f->params->knee;
            const double slope = l->curve != BRIGHT_SMOOTHSTEP ? 1 : k > 0 ? 1 + .75 * (1 + k) / k : 0x1p24;
            b = (b + 8) * slope;
        }
        if (s->kind == LOOK_SAMPLE && s->add >= 0) {
            b = fmax(b, before[s->add]);
            a = fmax(a, after[s->add] + 1);
            g += gain[s->add];
        }
        before[s->dst] = b;
        after[s->dst] = a;
        gain[s->dst] = g;
        lit[s->dst] = past || s->curve;
    }
    const double most = fmax(1, gain[l->glow] * f->params->intensity);
    // A bilinear sample by the store, its product and the sum; a display's curves round some 30 times.
    const bool shown = f->params->display || f->params->encoding || f->params->saturation != 1;
    l->error_bound = (before[l->glow] * most + after[l->glow] + 9 + (shown ? 32 : 0)) * 0x1p-24;
}

void look_list_make(struct look_list *l, const struct look_facts *f)
{
    static void (*const makers[])(struct look_list *, const struct look_facts *) = {
        NULL, half_gaussian, mip_chain, three_scale, jimenez, airy_eight
    };
    assert(f->params->look > LOOK_NONE && f->params->look <= LOOK_AIRY_EIGHT);
    l->images = l->stages = 0;
    l->matte = l->glow = l->bright = -1;
    set_curve(l, f);
    makers[f->params->look](l, f);
    count_roundings(l, f);
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
