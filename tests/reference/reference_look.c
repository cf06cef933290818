// SPDX-License-Identifier: Apache-2.0
// reference_look.c - each look written out on whole images of doubles, one function a look, in the words of METHODS.
#include "reference_look.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

struct picture {
    unsigned w, h, channels;
    double *v; /* [channel][y][x] */
};

struct look_work {
    const struct reference_look_frame *f;
    const struct params *p;
    double threshold, knee;
    struct picture made[160]; /* freed at the end */
    unsigned count;
    bool failed;
};

static double *at(const struct picture *m, unsigned c, unsigned x, unsigned y)
{
    return m->v + ((size_t)c * m->h + y) * m->w + x;
}

static struct picture new_picture(struct look_work *k, unsigned w, unsigned h)
{
    struct picture m = { w, h, k->f->channels, calloc((size_t)w * h * k->f->channels, sizeof(double)) };
    k->made[k->count++] = m;
    k->failed = k->failed || !m.v;
    return m;
}

static unsigned halved(unsigned n) { return n < 2 ? 1 : n / 2; }

/* ---- samples --------------------------------------------------------------------------------------- */

static unsigned held(double i, unsigned n) { return i < 0 ? 0 : i > n - 1 ? n - 1 : (unsigned)i; }

// m at texel coordinates (middles at whole numbers).
static double bilinear(const struct picture *m, unsigned c, double x, double y)
{
    const double fx = floor(x), fy = floor(y), u = x - fx, v = y - fy;
    const unsigned x0 = held(fx, m->w), x1 = held(fx + 1, m->w), y0 = held(fy, m->h), y1 = held(fy + 1, m->h);
    return (1 - v) * ((1 - u) * *at(m, c, x0, y0) + u * *at(m, c, x1, y0)) +
           v * ((1 - u) * *at(m, c, x0, y1) + u * *at(m, c, x1, y1));
}

// Pixel i of `to` in texels of `from`.
static double place(unsigned i, unsigned to, unsigned from) { return (i + .5) * from / to - .5; }

/* ---- bright pass ------------------------------------------------------------------------------------- */

enum { CHANNEL, LUMINANCE, KNEE, SMOOTH };

static void glowing(const struct look_work *k, int curve, double e[3])
{
    const double T = k->threshold;
    double L = 0, gain = 0;
    for (unsigned c = 0; c < k->f->channels; c++)
        L += e[c] * (k->f->channels == 1 ? 1 : k->f->luma[c]);
    if (curve == LUMINANCE)
        gain = L > T ? (L - T) / L : 0;
    if (curve == KNEE) {
        const double K = fmin(k->knee, T), s = fmin(fmax(L - (T - K), 0), 2 * K);
        gain = L > 0 ? fmax(K > 0 ? s * s / (4 * K) : 0, L - T) / L : 0;
    }
    if (curve == SMOOTH) {
        const double low = T - T * k->knee, high = T + T * k->knee;
        const double t = high > low ? fmin(fmax((L - low) / (high - low), 0), 1) : L > T;
        gain = t * t * (3 - 2 * t);
    }
    for (unsigned c = 0; c < k->f->channels; c++)
        e[c] = curve == CHANNEL ? fmax(e[c] - T, 0) : e[c] * fmax(gain, 0);
}

// m at w x h, the curve of each sample when there is one (-1: none).
static struct picture resampled(struct look_work *k, const struct picture *m, unsigned w, unsigned h, int curve)
{
    struct picture r = new_picture(k, w, h);
    for (unsigned y = 0; !k->failed && y < h; y++)
        for (unsigned x = 0; x < w; x++) {
            double e[3] = { 0 };
            for (unsigned c = 0; c < m->channels; c++)
                e[c] = bilinear(m, c, place(x, w, m->w), place(y, h, m->h));
            if (curve >= 0)
                glowing(k, curve, e);
            for (unsigned c = 0; c < m->channels; c++)
                *at(&r, c, x, y) = e[c];
        }
    return r;
}

static struct picture half_size(struct look_work *k, const struct picture *m, int curve)
{
    return resampled(k, m, halved(m->w), halved(m->h), curve);
}

static void accumulate(struct look_work *k, struct picture *sum, const struct picture *m, const double weight[3])
{
    for (unsigned c = 0; !k->failed && c < sum->channels; c++)
        for (unsigned y = 0; y < sum->h; y++)
            for (unsigned x = 0; x < sum->w; x++)
                *at(sum, c, x, y) += weight[c] * bilinear(m, c, place(x, sum->w, m->w), place(y, sum->h, m->h));
}

static void scale(struct look_work *k, struct picture *m, double by)
{
    for (size_t i = 0; !k->failed && i < (size_t)m->w * m->h * m->channels; i++)
        m->v[i] *= by;
}

// taps[-n .. n] across, then down, `step` texels apart.
static struct picture separable(struct look_work *k, const struct picture *m, const double *taps, int n, double step)
{
    struct picture across = new_picture(k, m->w, m->h), down = new_picture(k, m->w, m->h);
    for (int pass = 0; !k->failed && pass < 2; pass++)
        for (unsigned c = 0; c < m->channels; c++)
            for (unsigned y = 0; y < m->h; y++)
                for (unsigned x = 0; x < m->w; x++) {
                    double sum = 0;
                    for (int i = -n; i <= n; i++)
                        sum += taps[abs(i)] * (pass ? bilinear(&across, c, x, y + i * step) : bilinear(m, c, x + i * step, y));
                    *at(pass ? &down : &across, c, x, y) = sum;
                }
    return down;
}

static void bell(double *taps, int n, double sigma)
{
    double sum = 0;
    for (int i = 0; i <= n; i++)
        sum += (i ? 2 : 1) * (taps[i] = exp(-.5 * (i / sigma) * (i / sigma)));
    for (int i = 0; i <= n; i++)
        taps[i] /= sum;
}

/* ---- the looks: B, and E ------------------------------------------------------------------------------ */

static const double one[3] = { 1, 1, 1 };

static void half_gaussian(struct look_work *k, const struct picture *I, struct picture *B, struct picture *E)
{
    double taps[5];
    bell(taps, 4, 1.8);
    struct picture e = half_size(k, I, CHANNEL), b = separable(k, &e, taps, 4, 1);
    accumulate(k, B, &b, one);
    accumulate(k, E, &e, one);
}

static double unoccluded(const struct look_work *k, double sx, double sy, double radius)
{
    const struct reference_look_frame *f = k->f;
    double far = -HUGE_VAL;
    int seen = 0, open = 0;
    if (!f->depth)
        return 1;
    for (size_t i = 0; i < (size_t)f->width * f->height; i++)
        if (isfinite(f->depth[i]))
            far = fmax(far, f->depth[i]);
    for (int i = 0; i < 64; i++) {
        const double r = radius * sqrt((i + .5) / 64), angle = i * M_PI * (3 - sqrt(5));
        const double x = floor(sx + r * cos(angle) / f->pixel_aspect), y = floor(sy + r * sin(angle));
        if (x < 0 || y < 0 || x >= f->width || y >= f->height)
            continue;
        const double z = f->depth[(size_t)y * f->width + (size_t)x];
        seen++;
        open += (isinf(z) && z > 0) || (isfinite(z) && z >= far);
    }
    return seen ? (double)open / seen : 1;
}

static void sun(struct look_work *k, struct picture *B)
{
    const struct sun_spec *s = &k->p->sun_spec;
    const struct reference_look_frame *f = k->f;
    const double diagonal = hypot(f->width * f->pixel_aspect, f->height);
    const double sx = s->x_percent * f->width / 100, sy = s->y_percent * f->height / 100;
    const double radius = s->radius.unit == SIZE_PERCENT ? s->radius.value / 100 * diagonal
                          : s->radius.unit == SIZE_MM ? s->radius.value / k->p->sensor_mm * f->display_width * f->pixel_aspect
                                                      : s->radius.value;
    const double share = unoccluded(k, sx, sy, radius);
    for (unsigned c = 0; c < B->channels; c++)
        for (unsigned y = 0; y < B->h; y++)
            for (unsigned x = 0; x < B->w; x++) {
                const double dx = (x + .5 - sx) * f->pixel_aspect, dy = y + .5 - sy;
                const double tint = f->channels == 1 ? (s->tint[0] + s->tint[1] + s->tint[2]) / 3 : s->tint[c];
                *at(B, c, x, y) += s->gain * tint * share * exp(-(dx * dx + dy * dy) / (2 * radius * radius));
            }
}

static void mip_chain(struct look_work *k, const struct picture *I, struct picture *B, struct picture *E)
{
    static const double w[] = { .20, .40, .24, .11, .05, .02 };
    struct picture mip = *I;
    for (int m = 0; m < 6; m++) {
        const double weight[3] = { w[m], w[m], w[m] };
        if (m)
            mip = half_size(k, &mip, -1);
        struct picture b = resampled(k, &mip, I->w, I->h, KNEE);
        accumulate(k, B, &b, weight);
        if (m == 0)
            accumulate(k, E, &b, one);
    }
    if (k->p->sun_spec.given && !k->failed)
        sun(k, B);
}

static struct picture kawase(struct look_work *k, const struct picture *m, int pass)
{
    struct picture r = new_picture(k, m->w, m->h);
    const double d = pass + .5;
    for (unsigned c = 0; !k->failed && c < m->channels; c++)
        for (unsigned y = 0; y < m->h; y++)
            for (unsigned x = 0; x < m->w; x++)
                *at(&r, c, x, y) = (bilinear(m, c, x - d, y - d) + bilinear(m, c, x + d, y - d) + bilinear(m, c, x - d, y + d) +
                                    bilinear(m, c, x + d, y + d)) / 4;
    return r;
}

static void three_scale(struct look_work *k, const struct picture *I, struct picture *B, struct picture *E)
{
    static const double taps[] = { .227027, .194595, .121622, .054054, .016216 };
    const struct params *p = k->p;
    const struct picture e = resampled(k, I, I->w, I->h, LUMINANCE);
    struct picture level = e;
    accumulate(k, E, &e, one);
    for (unsigned i = 0; i < (p->stages == STAGES_6 ? 6u : 3u); i++) {
        double weight[3] = { 1, 1, 1 };
        if (p->tint_count)
            memcpy(weight, p->tints[i < p->tint_count ? i : p->tint_count - 1], sizeof(weight));
        if (k->f->channels == 1)
            weight[0] = (weight[0] + weight[1] + weight[2]) / 3;
        level = half_size(k, &level, -1);
        struct picture b = level;
        for (int pass = 0; pass < (int)p->kawase; pass++)
            b = kawase(k, &b, pass);
        if (p->kawase < 1)
            b = separable(k, &level, taps, 4, 1);
        accumulate(k, B, &b, weight);
    }
}

static struct picture thirteen(struct look_work *k, const struct picture *m, bool legacy)
{
    struct picture r = new_picture(k, halved(m->w), halved(m->h));
    for (unsigned c = 0; !k->failed && c < r.channels; c++)
        for (unsigned y = 0; y < r.h; y++)
            for (unsigned x = 0; x < r.w; x++) {
                const double px = place(x, r.w, m->w), py = place(y, r.h, m->h);
                double inner = 0, edges = 0, corners = 0;
                for (int j = -1; j <= 1; j += 2) {
                    edges += bilinear(m, c, px + 2 * j, py) + bilinear(m, c, px, py + 2 * j);
                    for (int i = -1; i <= 1; i += 2) {
                        inner += bilinear(m, c, px + i, py + j);
                        corners += bilinear(m, c, px + 2 * i, py + 2 * j);
                    }
                }
                *at(&r, c, x, y) = (inner + bilinear(m, c, px, py)) / 8 + (legacy ? 2 : 1) * (edges / 16 + corners / 32);
            }
    return r;
}

static void add_tent(struct look_work *k, struct picture *to, const struct picture *m)
{
    for (unsigned c = 0; !k->failed && c < to->channels; c++)
        for (unsigned y = 0; y < to->h; y++)
            for (unsigned x = 0; x < to->w; x++)
                for (int j = -1; j <= 1; j++)
                    for (int i = -1; i <= 1; i++)
                        *at(to, c, x, y) += (2 - abs(i)) * (2 - abs(j)) / 16.0 *
                                            bilinear(m, c, place(x, to->w, m->w) + i, place(y, to->h, m->h) + j);
}

static void jimenez(struct look_work *k, const struct picture *I, struct picture *B, struct picture *E)
{
    double taps[5];
    bell(taps, 4, 1.8);
    struct picture mip[6], blurred[6];
    mip[0] = half_size(k, I, SMOOTH);
    for (int i = 1; i <= 5; i++) {
        mip[i] = thirteen(k, &mip[i - 1], k->p->legacy_gain == SWITCH_ON);
        blurred[i] = separable(k, &mip[i], taps, 4, k->p->radius);
    }
    for (int i = 4; i >= 1; i--)
        add_tent(k, &blurred[i], &blurred[i + 1]);
    blurred[0] = new_picture(k, mip[0].w, mip[0].h);
    add_tent(k, &blurred[0], &blurred[1]);
    accumulate(k, B, &blurred[0], one);
    accumulate(k, E, &mip[0], one);
}

static void airy_eight(struct look_work *k, const struct picture *I, struct picture *B, struct picture *E)
{
    double taps[6], total = 0;
    bell(taps, 5, 2);
    const struct picture e = resampled(k, I, I->w, I->h, CHANNEL);
    struct picture level = e;
    accumulate(k, E, &e, one);
    for (int i = 1; i <= 8; i++) {
        level = half_size(k, &level, -1);
        scale(k, &level, .8);
        struct picture b = separable(k, &level, taps, 5, 1);
        accumulate(k, B, &b, one);
        total += pow(.8, i);
    }
    scale(k, B, 1 / total);
}

/* ---- before and after ---------------------------------------------------------------------------------- */

static double clean(double v) { return isfinite(v) && v > 0 ? v : 0; }

static struct picture light(struct look_work *k)
{
    const struct reference_look_frame *f = k->f;
    struct picture m = new_picture(k, f->width, f->height);
    const size_t n = (size_t)f->width * f->height;
    for (unsigned c = 0; !k->failed && c < f->channels; c++)
        for (size_t i = 0; i < n; i++)
            m.v[c * n + i] = clean(f->source[c] ? f->source[c][i] : f->plane[c][i]) *
                             (f->matte ? clean(f->matte[i]) * k->p->emission : 1);
    return m;
}

static double toned(double v, int kind)
{
    return kind == DISPLAY_REINHARD ? v / (v + 1)
           : kind == DISPLAY_ACES   ? v * (2.51 * v + .03) / (v * (2.43 * v + .59) + .14)
                                    : v;
}

static double transfer(double v, int kind)
{
    return kind == ENCODING_GAMMA22 ? pow(v, 1 / 2.2)
           : kind == ENCODING_SRGB  ? (v <= .0031308 ? 12.92 * v : 1.055 * pow(v, 1 / 2.4) - .055)
                                    : v;
}

// One pixel: scene and k B to what is shown.
static void shown(const struct look_work *k, double v[3], const double glow[3])
{
    const struct params *p = k->p;
    const bool after = p->look == LOOK_AIRY_EIGHT, display = p->display || p->saturation != 1 || p->encoding;
    double l = 0;
    for (unsigned c = 0; c < k->f->channels; c++) {
        if (!display) {
            v[c] += glow[c];
            continue;
        }
        v[c] = toned(fmax(0, (v[c] + (after ? 0 : glow[c])) * exp2(k->f->exposure)), p->display) + (after ? glow[c] : 0);
        l += k->f->luma[c] * v[c];
    }
    for (unsigned c = 0; display && c < k->f->channels; c++) {
        if (k->f->channels == 3)
            v[c] = fmax(0, l + p->saturation * (v[c] - l));
        v[c] = transfer(v[c], p->encoding);
    }
}

static void finish(const struct look_work *k, const struct picture *B, const struct picture *E, enum view view,
                   double *const out[3])
{
    const struct reference_look_frame *f = k->f;
    const size_t n = (size_t)f->width * f->height;
    for (size_t i = 0; i < n; i++) {
        double scene[3] = { 0 }, glow[3] = { 0 }, v[3];
        const double factor = f->matte ? 1 + clean(f->matte[i]) * (k->p->emission - 1) : 1;
        for (unsigned c = 0; c < f->channels; c++) {
            scene[c] = isfinite(f->plane[c][i]) ? f->plane[c][i] * factor : 0;
            glow[c] = k->p->intensity * B->v[c * n + i];
        }
        memcpy(v, scene, sizeof(v));
        if (view == VIEW_FINAL)
            shown(k, v, glow);
        for (unsigned c = 0; c < f->channels; c++) {
            const bool keep = !isfinite(f->plane[c][i]) && k->p->nonfinite == NONFINITE_KEEP;
            out[c][i] = view == VIEW_BRIGHT ? E->v[c * n + i] : view == VIEW_BLOOM ? glow[c] : keep ? f->plane[c][i] : v[c];
        }
    }
}

int reference_look(double *const out[3], const struct reference_look_frame *f, const struct params *p, enum view view)
{
    static void (*const looks[])(struct look_work *, const struct picture *, struct picture *, struct picture *) = {
        NULL, half_gaussian, mip_chain, three_scale, jimenez, airy_eight
    };
    struct look_work *k = calloc(1, sizeof(*k));
    if (!k)
        return -1;
    k->f = f;
    k->p = p;
    const double scaled = exp2(f->exposure);
    k->threshold = (p->threshold_unit == UNIT_STOPS ? exp2(p->threshold) : p->threshold) / scaled;
    k->knee = p->look == LOOK_JIMENEZ ? p->knee : p->knee / scaled;
    struct picture I = light(k), B = new_picture(k, f->width, f->height), E = new_picture(k, f->width, f->height);
    if (!k->failed && p->bloom)
        looks[p->look](k, &I, &B, &E);
    if (!k->failed)
        finish(k, &B, &E, view, out);
    const int r = k->failed ? -1 : 0;
    for (unsigned i = 0; i < k->count; i++)
        free(k->made[i].v);
    free(k);
    return r;
}
