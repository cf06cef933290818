// SPDX-License-Identifier: Apache-2.0
// look_bound.c - what a list's float32 arithmetic errs at most: a count of roundings, each at most 2^-24 of the value it is made on.
// Pure.
//
// All shares and weights are >= 0 and right to their own last bit, so past the curve a rounding is a share of the glow itself, however
// many values were added: such counts add up along the longest way. What is rounded before the curve is not so kept: the curve
// makes a share of L into more of E. For the curves with a corner that more is a share of I (their slope is at most 1); glows of all
// pixels add up, so it counts as often as the look's gain W. Smoothstep is steeper, and by how much is a property of its definition,
// not of the filters: conditioning() bounds it.
#include <math.h>

#include "look_internal.h"

/* Of an image, along the longest way to it. */
struct count {
    double before; /* roundings of I */
    double steep;  /* of L, that the curve makes steeper */
    double after;  /* of the glow */
    double gain;   /* sum of weights from E on */
    bool lit;      /* past the curve */
};

static bool power_of_2(double v) { return v == 0 || frexp(v, &(int){ 0 }) == .5; }

// A linear interpolation. Halving, both shares are .5: one sum. Doubling, .25 and .75: a product and the sum.
static double along(uint32_t from, uint32_t to)
{
    return from == to ? 0 : from == 2 * to ? 1 : to == 2 * from ? 2 : 3;
}

static double sample(const struct look_list *l, const struct look_stage *s)
{
    bool exact = true;
    for (unsigned i = 0; i < s->taps; i++)
        exact = exact && power_of_2(s->tap[i].weight);
    double n = along(l->image[s->src].width, l->image[s->dst].width) + along(l->image[s->src].height, l->image[s->dst].height);
    n += exact ? 0 : 2;
    n += s->taps > 1 ? (s->taps + 3) / 4 - 1 + 2 : 0;
    return n;
}

static double weighted(const struct look_stage *s)
{
    for (unsigned c = 0; c < 3; c++)
        if (!power_of_2((double)s->weight[c]))
            return 2;
    return 0;
}

static double most_weight(const struct look_stage *s) { return (double)fmaxf(s->weight[0], fmaxf(s->weight[1], s->weight[2])); }

// L: its sums and products 3, T or the foot as a float 1. From there on 8: the curve's own numbers, its products, and that with I.
static void light_up(const struct look_list *l, struct count *k)
{
    if (l->curve == BRIGHT_SMOOTHSTEP) {
        k->steep = k->before + 4;
        k->after = k->before + 10; // of t 3, which count twice in t^2 (3 - 2 t), and 4
        k->before = 0;
    } else {
        k->before += 8;
    }
    k->gain = 1;
    k->lit = true;
}

static double *count_of(struct count *k) { return k->lit ? &k->after : &k->before; }

static struct count most(struct count a, struct count b, bool sum)
{
    return (struct count){ fmax(a.before, b.before), fmax(a.steep, b.steep), fmax(a.after, b.after),
                           sum ? a.gain + b.gain : fmax(a.gain, b.gain), a.lit || b.lit };
}

static struct count sampled(const struct look_list *l, const struct look_stage *s, const struct count *of)
{
    struct count k = of[s->src];
    double sum = 0;
    *count_of(&k) += sample(l, s);
    for (unsigned i = 0; i < s->taps; i++)
        sum += s->tap[i].weight;
    if (s->curve)
        light_up(l, &k);
    *count_of(&k) += weighted(s);
    k.gain *= sum * most_weight(s);
    if (s->add >= 0) {
        k = most(k, of[s->add], true);
        k.after++;
    }
    return k;
}

// Each part's curve, its weight and the sums; the sun's exp(-u) rounds 3 u exp(-u) < 1.2 in u, and 7 more.
static struct count mixed(const struct look_list *l, const struct look_stage *s, const struct count *of)
{
    struct count k = most(of[s->src], of[s->add], false);
    double sum = 0;
    k.before += 3; // drawn to the frame's height
    light_up(l, &k);
    for (unsigned i = 0; i < s->taps; i++)
        sum += s->tap[i].weight;
    k.after += 2 + s->taps + (s->after ? 8 : 0);
    k.gain = sum;
    return k;
}

static struct count count_stage(const struct look_list *l, const struct look_facts *f, const struct look_stage *s,
                                const struct count *of)
{
    struct count k = { 0 };
    switch (s->kind) {
    case LOOK_LOAD_MATTE:
    case LOOK_LOAD_ROWS:
    case LOOK_SUM:
        return k;
    case LOOK_LOAD:
        k.before = s->src >= 0 ? 3 : 0; // the matte's two products, and emission's own
        if (s->curve)
            light_up(l, &k);
        return k;
    case LOOK_LOAD_HALF:
        if (s->curve && !s->after)
            light_up(l, &k);
        *count_of(&k) += 2;
        if (s->curve && s->after)
            light_up(l, &k);
        *count_of(&k) += weighted(s);
        k.gain *= most_weight(s);
        return k;
    case LOOK_ROWS:
        k = of[s->src];
        *count_of(&k) += along(l->image[s->src].width, f->width);
        return s->first ? most(of[s->dst], k, true) : k;
    case LOOK_MIX:
        return mixed(l, s, of);
    case LOOK_SAMPLE:
        return sampled(l, s, of);
    }
    return k;
}

/*
 * Smoothstep: E = I s(t), t = (L - T (1 - K)) / 2TK, s = t^2 (3 - 2t). A share d of L is d c(t) of t, c = L / 2TK = (1 - K) / 2K + t,
 * and d c s'(t) I of E. Of a pixel j that glows with weight w_j here that is d w_j phi_j I_j, phi = c s'; with M the largest of I
 * and of the glow, and W >= sum w_j, for every a >= 0
 *     sum w_j phi_j I_j = a sum w_j s_j I_j + sum w_j (phi_j - a s_j) I_j <= M (a + W max over t of (phi - a s)),
 * of which the smallest counts: far more than W pixels cannot all stand where the curve is steep without the glow being large
 * itself. A pixel's E errs by I at most, so all of it by W, which is the answer where K is 0: the definition jumps there, and so does
 * any evaluation, by the light of the pixels that are within a rounding of T.
 */
static double conditioning(double knee, double gain, double share)
{
    enum { STEPS = 1024 };
    if (knee <= 0)
        return gain;
    const double c0 = (1 - knee) / (2 * knee), h = 1. / STEPS;
    double least = INFINITY;
    for (double a = 0; a <= 4 * (c0 + 2); a += (c0 + 2) / 16) {
        double peak = 0;
        for (int i = 0; i <= STEPS; i++) {
            const double t = i * h;
            peak = fmax(peak, (c0 + t) * 6 * t * (1 - t) - a * t * t * (3 - 2 * t));
        }
        // Between the steps, by the second derivative.
        peak += (12 * (c0 + 3) + 6 * a) * h * h;
        least = fmin(least, a + gain * peak);
    }
    return fmin(share * least, gain);
}

void look_bound(struct look_list *l, const struct look_facts *f)
{
    const double unit = 0x1p-24;
    struct count of[LOOK_IMAGES_MAX] = { 0 };
    for (unsigned i = 0; i < l->stages; i++)
        of[l->stage[i].dst] = count_stage(l, f, &l->stage[i], of);
    struct count k = of[l->glow.image];
    for (unsigned i = 0; i < l->glow.sections; i++)
        k.after = fmax(k.after, of[l->glow.image].after + along(l->glow.section[i].height, f->height));
    // Sections, intensity as a float and its product, the scene's factor and product, the sum.
    k.after += l->glow.sections - 1 + 2 + (f->matte ? 3 : 0) + 1;
    const double gain = k.gain * f->params->intensity;
    l->error_bound = k.before * unit * fmax(1, gain) + k.after * unit;
    // T = 0: all that is lit glows wholly.
    if (l->curve == BRIGHT_SMOOTHSTEP && l->threshold > 0)
        l->error_bound += conditioning(f->params->knee, gain, k.steep * unit);
}
