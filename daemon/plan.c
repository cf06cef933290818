// SPDX-License-Identifier: Apache-2.0
// plan.c - see plan.h.
#include "plan.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double SIGMA_MIN = 0.05, SIGMA_MAX = 8192;

// METHODS section 3.1. top[] is the filter of the coarsest octave below a Gaussian's level, then of the next
// finer ones; octaves finer than these take `fine`.
struct rule {
    const char *name;
    unsigned char fine;
    unsigned char top[3];
    double s_min; // the level's sigma is at least this
    double taps;  // half width over the level's sigma, at least
};

static const struct rule rules[] = {
    { "R2", 4, { 6, 4, 4 }, 1.3, 2.8 },
    { "R3", 4, { 6, 6, 4 }, 1.8, 3.25 },
    { "R4", 4, { 8, 8, 6 }, 2.0, 3.9 },
    { "R5", 4, { 8, 8, 6 }, 4.0, 4.6 },
};
enum { RULES = sizeof(rules) / sizeof(rules[0]), WIDEN_MAX = 6 };

static unsigned level_for(double sigma, double s_min)
{
    if (sigma < 2 * s_min)
        return 0;
    unsigned level = (unsigned)floor(log2(sigma / s_min) + 1e-9);
    return level < PSF_LEVELS_MAX ? level : PSF_LEVELS_MAX;
}

static void set_orders(struct plan *p, const struct rule *r)
{
    p->levels = 0;
    memset(p->order, 0, sizeof(p->order));
    for (unsigned g = 0; g < p->count; g++) {
        const unsigned level = p->gaussian[g].level;
        if (level > p->levels)
            p->levels = level;
        for (unsigned i = 0; i < level; i++) {
            const unsigned below = level - 1 - i;
            const unsigned char need = below < 3 ? r->top[below] : r->fine;
            if (p->order[i] < need)
                p->order[i] = need;
        }
    }
    p->full_size = false;
    for (unsigned g = 0; g < p->count; g++)
        p->full_size |= p->gaussian[g].level == 0;
}

static unsigned half_of(double sigma, unsigned level, double c, unsigned widen)
{
    const double half = ceil(c * ldexp(sigma, -(int)level)) + widen;
    return half > PSF_TAPS_MAX ? PSF_TAPS_MAX : half < 1 ? 1 : (unsigned)half;
}

// Taps and errors of one Gaussian, the kernel widened tap by tap while that is what keeps it from `want`.
static int fit(struct plan *p, struct plan_gaussian *g, const struct rule *r, double want)
{
    double before = INFINITY;
    for (unsigned widen = 0; widen <= WIDEN_MAX; widen++) {
        struct psf_error ex, ey;
        psf_gaussian_taps(&g->x, g->sigma_x, g->level, p->order, half_of(g->sigma_x, g->level, r->taps, widen));
        if (psf_gaussian_error(&ex, g->sigma_x, g->level, p->order, &g->x) < 0)
            return -1;
        if (g->sigma_y == g->sigma_x) {
            g->y = g->x;
            ey = ex;
        } else {
            psf_gaussian_taps(&g->y, g->sigma_y, g->level, p->order,
                              half_of(g->sigma_y, g->level, r->taps, widen));
            if (psf_gaussian_error(&ey, g->sigma_y, g->level, p->order, &g->y) < 0)
                return -1;
        }
        g->l1 = ex.l1 + ey.l1;
        g->peak = ex.peak + ey.peak + ex.peak * ey.peak;
        const double now = fmax(g->l1, g->peak);
        if (now <= want || now > 0.9 * before)
            return 0;
        before = now;
    }
    return 0;
}

static int by_level(const void *a, const void *b)
{
    const struct plan_gaussian *x = a, *y = b;
    if (x->level != y->level)
        return x->level < y->level ? -1 : 1;
    return x->sigma_x < y->sigma_x ? -1 : x->sigma_x > y->sigma_x;
}

// The largest over the channels of the weighted sum of v(g): light of one channel never meets another's.
static double weighted(const struct plan *p, bool of_error)
{
    double most = 0;
    for (unsigned c = 0; c < 3; c++) {
        double sum = 0;
        for (unsigned g = 0; g < p->count; g++)
            sum += p->gaussian[g].weight[c] * (of_error ? p->gaussian[g].l1 : 1);
        most = fmax(most, sum);
    }
    return most;
}

static int apply_rule(struct plan *p, const struct rule *r, double want)
{
    set_orders(p, r);
    for (unsigned g = 0; g < p->count; g++)
        if (fit(p, &p->gaussian[g], r, want) < 0)
            return -1;
    p->filter_bound = weighted(p, true);
    return 0;
}

// Both promises of METHODS section 3: the L1 norm over all, and each lone point's peak.
static bool holds(const struct plan *p, double tolerance)
{
    for (unsigned g = 0; g < p->count; g++)
        if (p->gaussian[g].l1 > tolerance || p->gaussian[g].peak > tolerance)
            return false;
    return p->filter_bound <= tolerance;
}

// R5 was not enough: put the Gaussians that err most one level finer, again and again.
static int refine(struct plan *p, double tolerance)
{
    const struct rule *r = &rules[RULES - 1];
    snprintf(p->rule, sizeof(p->rule), "R5+");
    for (unsigned round = 0; round < PSF_LEVELS_MAX && !holds(p, tolerance); round++) {
        bool moved = false;
        for (unsigned g = 0; g < p->count; g++) {
            struct plan_gaussian *k = &p->gaussian[g];
            const double share = tolerance / fmax(1, p->weight_sum);
            const double sigma = fmax(k->sigma_x, k->sigma_y);
            if (fmax(k->l1, k->peak) <= share || k->level == 0 ||
                r->taps * ldexp(sigma, 1 - (int)k->level) > PSF_TAPS_MAX)
                continue;
            k->level--;
            moved = true;
        }
        if (!moved)
            break;
        if (apply_rule(p, r, tolerance / fmax(1, p->weight_sum)) < 0)
            return -1;
    }
    return 0;
}

static void count_cost(struct plan *p)
{
    double roundings = 8, cost = 0;
    for (unsigned i = 0; i < p->levels; i++) {
        cost += (0.75 + 0.75) * p->order[i] * ldexp(1, -2 * (int)i);
        roundings += 4.0 * p->order[i];
    }
    unsigned widest = 0;
    for (unsigned g = 0; g < p->count; g++) {
        const unsigned taps = 2 * p->gaussian[g].x.half + 1 + 2 * p->gaussian[g].y.half + 1;
        cost += taps * ldexp(1, -2 * (int)p->gaussian[g].level);
        widest = taps > widest ? taps : widest;
    }
    p->cost = cost;
    // Sums of non-negative terms: each operation adds at most 2^-24 of the result (METHODS section 3.3).
    p->rounding_bound = (roundings + widest + p->count) * 0x1p-24;
}

// Half storage: each number that a pass stores is off by at most 2^-11 of itself, and its readers inherit that. What
// passes by on its way from E to the picture: the bright pass, each halving, the kernel's two axes, and then at
// each finer level the doubling and every Gaussian that is added there. (Numbers below the normal halfs add less than 2^-37 of max E.)
static void count_half(struct plan *p)
{
    double worst[3] = { 0 };
    p->half_peak = 0;
    for (unsigned g = 0; g < p->count; g++) {
        const struct plan_gaussian *k = &p->gaussian[g];
        unsigned stores = 1 + k->level + 2 + k->level;
        for (unsigned h = 0; h < p->count; h++)
            stores += h != g && p->gaussian[h].level <= k->level;
        const double off = pow(1 + 0x1p-11, stores) - 1 + stores * 0x1p-37;
        p->half_peak = fmax(p->half_peak, off);
        for (unsigned c = 0; c < 3; c++)
            worst[c] += k->weight[c] * off;
    }
    p->half_bound = fmax(worst[0], fmax(worst[1], worst[2]));
}

// near for the narrowest, far for the widest, between them by the logarithm of sigma.
static double band_gain(const struct params *params, double sigma, double least, double most)
{
    const double u = most > least ? log(sigma / least) / log(most / least) : 0;
    return params->near_gain + (params->far_gain - params->near_gain) * u;
}

static int set_sizes(struct plan *p, const struct params *params, const struct plan_facts *facts, struct fault *f)
{
    const struct psf_spec *spec = &params->psf_spec;
    double sigma[PARAMS_GAUSSIANS_MAX], least = INFINITY, most = 0;
    for (unsigned i = 0; i < spec->count; i++) {
        sigma[i] = params_pixels(params, &spec->gaussian[i].sigma, facts->width, facts->height, facts->display_width,
                                 facts->pixel_aspect);
        least = fmin(least, sigma[i]);
        most = fmax(most, sigma[i]);
    }
    for (unsigned i = 0; i < spec->count; i++) {
        const struct psf_gaussian *s = &spec->gaussian[i];
        const double weight = s->weight * band_gain(params, sigma[i], least, most);
        struct plan_gaussian g = { .index = i, .sigma_y = sigma[i], .sigma_x = sigma[i] / facts->pixel_aspect };
        for (unsigned c = 0; c < 3; c++)
            g.weight[c] = weight * s->tint[c];
        if (facts->channels == 1) {
            g.weight[0] = (g.weight[0] + g.weight[1] + g.weight[2]) / 3;
            g.weight[1] = g.weight[2] = 0;
        }
        if ((facts->only >= 0 && (unsigned)facts->only != i) || fmax(g.weight[0], fmax(g.weight[1], g.weight[2])) == 0)
            continue;
        // Below this a Gaussian is one pixel to 1e-80; keep the arithmetic away from 0/0.
        g.sigma_x = fmax(g.sigma_x, SIGMA_MIN);
        g.sigma_y = fmax(g.sigma_y, SIGMA_MIN);
        if (!(fmax(g.sigma_x, g.sigma_y) <= SIGMA_MAX))
            return fault_set(f, FAULT_PARAM_RANGE, "params.psf",
                             "sigma %g of this frame is %g px: at most %g px expected", s->sigma.value,
                             fmax(g.sigma_x, g.sigma_y), SIGMA_MAX);
        p->gaussian[p->count++] = g;
    }
    p->weight_sum = weighted(p, false);
    return 0;
}

int plan_make(struct plan *p, const struct params *params, double tolerance, const struct plan_facts *facts, struct fault *f)
{
    memset(p, 0, sizeof(*p));
    if (set_sizes(p, params, facts, f) < 0)
        return -1;
    // Each Gaussian to its share, so that the weighted sum holds too.
    const double share = tolerance / fmax(1, p->weight_sum);
    for (unsigned r = 0; r < RULES; r++) {
        snprintf(p->rule, sizeof(p->rule), "%s", rules[r].name);
        for (unsigned g = 0; g < p->count; g++) {
            struct plan_gaussian *k = &p->gaussian[g];
            k->level = level_for(fmin(k->sigma_x, k->sigma_y), rules[r].s_min);
            // A long thin pixel may ask for more taps across than there are.
            while (rules[r].taps * ldexp(fmax(k->sigma_x, k->sigma_y), -(int)k->level) + WIDEN_MAX > PSF_TAPS_MAX &&
                   k->level < PSF_LEVELS_MAX)
                k->level++;
        }
        if (apply_rule(p, &rules[r], share) < 0)
            goto fail;
        if (holds(p, tolerance))
            break;
        if (r + 1 == RULES && refine(p, tolerance) < 0)
            goto fail;
    }
    qsort(p->gaussian, p->count, sizeof(p->gaussian[0]), by_level);
    count_cost(p);
    count_half(p);
    return 0;
fail:
    return fault_set(f, FAULT_NO_MEMORY, "", "out of memory for the error of a plan");
}

bool plan_holds_half(const struct plan *p, double tolerance)
{
    for (unsigned g = 0; g < p->count; g++)
        if (p->gaussian[g].peak + p->half_peak > tolerance)
            return false;
    return p->filter_bound + p->weight_sum * p->rounding_bound + p->half_bound <= tolerance;
}

uint32_t plan_reach(const struct plan *p)
{
    uint32_t reach = 0;
    for (unsigned g = 0; g < p->count; g++) {
        const struct plan_gaussian *k = &p->gaussian[g];
        const uint32_t half = k->x.half > k->y.half ? k->x.half : k->y.half;
        // The filters of the octaves add less than 8 cells of the level, down and up.
        const uint32_t r = (half + (k->level ? 8 : 0)) << k->level;
        reach = r > reach ? r : reach;
    }
    return reach;
}

int plan_print(const struct plan *p, char *out, size_t size)
{
    int n = snprintf(out, size, "%s, %u level%s", p->rule, p->levels, p->levels == 1 ? "" : "s");
    for (unsigned i = 0; i < p->levels; i++)
        n += snprintf(n < (int)size ? out + n : NULL, n < (int)size ? size - (size_t)n : 0, "%sb%u",
                      i ? ">" : " ", p->order[i]);
    for (unsigned g = 0; g < p->count; g++) {
        const struct plan_gaussian *k = &p->gaussian[g];
        n += snprintf(n < (int)size ? out + n : NULL, n < (int)size ? size - (size_t)n : 0,
                      "%ssigma %.4g at %u, %u taps", g ? "; " : ": ", k->sigma_y, k->level,
                      2 * k->y.half + 1);
    }
    return n;
}
