// SPDX-License-Identifier: Apache-2.0
// look_kit.c - see look_kit.h.
#include "look_kit.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static uint64_t seed = 0x9e3779b97f4a7c15u;


static double uniform(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (double)(seed >> 11) * 0x1p-53;
}

/* ---- a frame and what stands beside it ---------------------------------------------------------------- */

static unsigned channels_of(const struct scene *s, unsigned role) { return role >= MATTE ? 1 : s->channels; }
static enum pixel_type type_of(const struct scene *s, unsigned role) { return role == DEPTH ? PIXEL_TYPE_FLOAT : s->type; }

// Dark noise, lamps over four decades, a bright block in a corner; the same of another seed as the source; blocks of matte; a
// wall at depth 5 with holes to infinity.
static void fill(struct scene *s)
{
    const size_t n = (size_t)s->width * s->height;
    for (unsigned role = SCENE; role <= SOURCE; role++) {
        for (unsigned c = 0; c < s->channels; c++)
            for (size_t i = 0; i < n; i++)
                s->plane[role][c][i] = .9 * uniform();
        for (unsigned i = 0; i < 2 + n / 300; i++) {
            const size_t at = (size_t)(uniform() * (double)n);
            const double v = pow(10, 4 * uniform());
            for (unsigned c = 0; c < s->channels; c++)
                s->plane[role][c][at] = v * (.2 + uniform());
        }
        for (unsigned y = 0; y < s->height && y < 5; y++)
            for (unsigned x = 0; x < s->width && x < 9; x++)
                s->plane[role][0][(size_t)y * s->width + x] = 40;
    }
    for (size_t i = 0; i < n; i++) {
        const bool block = (i % s->width) / 7 % 2 == 0;
        s->plane[MATTE][0][i] = block ? uniform() : 0;
        s->plane[DEPTH][0][i] = uniform() < .4 ? INFINITY : 5 * uniform();
    }
}

void scene_init(struct scene *s, unsigned w, unsigned h, unsigned channels, enum pixel_type type)
{
    *s = (struct scene){ .width = w, .height = h, .channels = channels, .type = type, .aspect = 1, .with = { true },
                         .luma = { 0.2126f, 0.7152f, 0.0722f } };
    for (unsigned role = 0; role < ROLES; role++)
        for (unsigned c = 0; c < 3; c++)
            assert_non_null(s->plane[role][c] = calloc((size_t)w * h, sizeof(double)));
    for (unsigned c = 0; c < 3; c++) {
        assert_non_null(s->want[c] = calloc((size_t)w * h, sizeof(double)));
        assert_non_null(s->out[c] = calloc((size_t)w * h, sizeof(double)));
    }
    fill(s);
}

void scene_finish(struct scene *s)
{
    for (unsigned role = 0; role < ROLES; role++) {
        for (unsigned c = 0; c < 3; c++)
            free(s->plane[role][c]);
        frame_scan_finish(&s->scan[role]);
    }
    for (unsigned c = 0; c < 3; c++) {
        free(s->want[c]);
        free(s->out[c]);
    }
}

static double get(const struct planes *p, unsigned c, unsigned x, unsigned y)
{
    const uint8_t *row = planes_row(p, c, y);
    float v;
    if (p->type == PIXEL_TYPE_HALF) {
        uint16_t h;
        memcpy(&h, row + 2 * x, 2);
        half_to_float(&v, &h, 1);
    } else {
        memcpy(&v, row + 4 * x, 4);
    }
    return v;
}

// Rounds the scene's own doubles to what the plane holds.
static void put(struct scene *s, const struct planes *p, unsigned role, unsigned c, unsigned y)
{
    uint8_t *row = planes_row(p, c, y);
    memset(row, 0, p->pitch_bytes);
    double *v = s->plane[role][c] + (size_t)y * s->width;
    for (unsigned x = 0; x < s->width; x++) {
        const float f = (float)v[x];
        if (p->type == PIXEL_TYPE_HALF) {
            uint16_t h;
            float_to_half(&h, &f, 1);
            memcpy(row + 2 * x, &h, 2);
        } else {
            memcpy(row + 4 * x, &f, 4);
        }
        v[x] = get(p, c, x, y);
    }
}

void scene_take(struct scene *s, const struct planes *out)
{
    for (unsigned c = 0; c < s->channels; c++)
        for (unsigned y = 0; y < s->height; y++)
            for (unsigned x = 0; x < s->width; x++)
                s->out[c][(size_t)y * s->width + x] = get(out, c, x, y);
}

int scene_try(struct scene *s, const struct params *p, struct bloom *b, struct fault *f)
{
    struct bloom_geometry g[ROLES];
    int index[ROLES] = { 0 };
    unsigned count = 0;
    for (unsigned role = 0; role < ROLES; role++) {
        index[role] = s->with[role] ? (int)count : -1;
        if (s->with[role])
            g[count++] = (struct bloom_geometry){ s->width, s->height, channels_of(s, role), type_of(s, role), 0,
                                                  role == SCENE ? 1 + p->layer_count : 0 };
    }
    if (bloom_slot_prepare(b, bloom_slot(b, 0), count, g, s->in, s->out_planes, f) < 0)
        return -1;
    for (unsigned role = 0; role < ROLES; role++) {
        if (!s->with[role])
            continue;
        frame_scan_finish(&s->scan[role]);
        assert_int_equal(frame_scan_init(&s->scan[role], s->width, s->height), 0);
        const float luma[3] = { s->channels == 1 ? 1 : s->luma[0], s->channels == 1 ? 0 : s->luma[1],
                                s->channels == 1 ? 0 : s->luma[2] };
        for (unsigned y = 0; y < s->height; y++) {
            for (unsigned c = 0; c < channels_of(s, role); c++)
                put(s, &s->in[index[role]], role, c, y);
            frame_scan_row(&s->scan[role], &s->in[index[role]], y, role >= MATTE ? (float[3]){ 1, 0, 0 } : luma);
        }
    }
    struct bloom_request r = { .params = p, .scan = &s->scan[SCENE], .source = index[SOURCE], .matte = index[MATTE],
                               .depth = index[DEPTH], .pixel_aspect = (float)s->aspect,
                               .matte_scan = s->with[MATTE] ? &s->scan[MATTE] : NULL,
                               .source_scan = s->with[SOURCE] ? &s->scan[SOURCE] : NULL };
    memcpy(r.luma, s->luma, sizeof(r.luma));
    s->reply = (struct bloom_reply){ 0 };
    if (bloom_run(b, bloom_slot(b, 0), 0, &r, &s->reply, f) < 0)
        return -1;
    scene_take(s, s->reply.untouched ? &s->in[0] : &s->out_planes[0]);
    return 0;
}

void scene_run(struct scene *s, const struct params *p, struct bloom *b)
{
    struct fault f = { 0 };
    if (scene_try(s, p, b, &f) < 0)
        fail_msg("%s: %s", f.field, f.text);
}

void scene_reference(struct scene *s, const struct params *p)
{
    struct reference_look_frame f = { .width = s->width, .height = s->height, .channels = s->channels,
                                      .luma = { s->luma[0], s->luma[1], s->luma[2] }, .pixel_aspect = s->aspect,
                                      .exposure = p->exposure, .display_width = s->width,
                                      .matte = s->with[MATTE] ? s->plane[MATTE][0] : NULL,
                                      .depth = s->with[DEPTH] ? s->plane[DEPTH][0] : NULL };
    for (unsigned c = 0; c < 3; c++) {
        f.plane[c] = s->plane[SCENE][c];
        f.source[c] = s->with[SOURCE] ? s->plane[SOURCE][c] : NULL;
    }
    assert_int_equal(reference_look(s->want, &f, p, p->view_spec.view), 0);
}

static double quantum(enum pixel_type type, double v)
{
    return type == PIXEL_TYPE_HALF ? fmax(ldexp(fabs(v), -11), 0x1p-25) : fmax(ldexp(fabs(v), -24), 0x1p-149);
}

static double limit = 1e-5;

/* Every pixel; the worst error over the largest value. */
double scene_check(struct scene *s, const struct params *p, const char *what)
{
    scene_reference(s, p);
    double largest = 0, worst = -1, worst_over = -1;
    size_t at = 0;
    unsigned channel = 0;
    const size_t n = (size_t)s->width * s->height;
    for (unsigned c = 0; c < s->channels; c++)
        for (size_t i = 0; i < n; i++) {
            largest = isfinite(s->want[c][i]) ? fmax(largest, fabs(s->want[c][i])) : largest;
            const double v = s->plane[SCENE][c][i];
            if (p->view_spec.view == VIEW_FINAL && !p->display && !p->encoding && isfinite(v))
                largest = fmax(largest, fabs(v));
        }
    for (unsigned c = 0; c < s->channels; c++)
        for (size_t i = 0; i < n; i++) {
            double want = s->want[c][i];
            const double got = s->out[c][i];
            if (!isfinite(want)) {
                assert_true(got == want || (isnan(got) && isnan(want)));
                continue;
            }
            if (s->type == PIXEL_TYPE_HALF)
                want = fmax(fmin(want, 65504), -65504);
            const double e = fabs(got - want), over = e - quantum(s->type, want);
            if (!(over <= worst_over)) {
                worst = e;
                worst_over = over;
                at = i;
                channel = c;
            }
        }
    const double share = largest > 0 ? fmax(worst_over, 0) / largest : fmax(worst_over, 0);
    const bool bad = !(share <= limit) || (!s->reply.untouched && !(share <= s->reply.error_bound));
    if (bad || getenv("AIRY_VERBOSE"))
        print_message("%s, %u x %u x %u %s: worst %.3g of the largest value %.6g beyond rounding (bound %.3g) at %zu,%zu channel "
                      "%u: %.9g, %.9g expected (error %.3g)\n", what, s->width, s->height, s->channels,
                      s->type == PIXEL_TYPE_HALF ? "half" : "float", share, largest, s->reply.error_bound, at % s->width,
                      at / s->width, channel, s->out[channel][at], s->want[channel][at], worst);
    assert_false(bad);
    return share;
}
