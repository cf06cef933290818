// SPDX-License-Identifier: Apache-2.0
// scene_kit.c - see scene_kit.h.
#include "scene_kit.h"
#include "scene_kernel.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static uint64_t state = 0x9e3779b97f4a7c15u;

// A multiplier spreads neighbouring seeds; xorshift must not start at 0.
void scene_seed(uint64_t seed) { state = (seed + 1) * 0x9e3779b97f4a7c15u | 1; }

double scene_uniform(void)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (double)(state >> 11) * 0x1p-53;
}

/* ---- making ---------------------------------------------------------------------------------------- */

static double *plane_make(size_t n)
{
    double *v = calloc(n, sizeof(double));
    assert_non_null(v);
    return v;
}

static size_t pixels_in(const struct scene *s) { return (size_t)s->width * s->height; }
static size_t pixels_out(const struct scene *s)
{
    return ((size_t)s->width + 2 * s->grow) * ((size_t)s->height + 2 * s->grow);
}

void scene_init(struct scene *s, unsigned width, unsigned height, unsigned channels, enum pixel_type type)
{
    *s = (struct scene){ .width = width, .height = height, .channels = channels, .type = type, .aspect = 1,
                         .luma = { 0.2126f, 0.7152f, 0.0722f }, .outputs = 1 };
    if (channels == 1)
        memcpy(s->luma, (float[3]){ 1, 0, 0 }, sizeof(s->luma));
    for (unsigned c = 0; c < channels; c++)
        s->plane[c] = plane_make(pixels_in(s));
}

static void clear_out(struct scene *s)
{
    for (unsigned k = 0; k < BLOOM_OUTPUTS_MAX; k++)
        for (unsigned c = 0; c < 3; c++) {
            free(s->out[k][c]);
            s->out[k][c] = NULL;
        }
}

void scene_finish(struct scene *s)
{
    for (unsigned c = 0; c < 3; c++) {
        free(s->plane[c]);
        free(s->source[c]);
    }
    free(s->matte);
    free(s->dirt);
    free(s->kernel);
    clear_out(s);
    frame_scan_finish(&s->scan);
    frame_scan_finish(&s->source_scan);
    frame_scan_finish(&s->matte_scan);
}

void scene_add_source(struct scene *s)
{
    for (unsigned c = 0; c < s->channels; c++)
        s->source[c] = plane_make(pixels_in(s));
}

void scene_add_matte(struct scene *s) { s->matte = plane_make(pixels_in(s)); }

void scene_add_dirt(struct scene *s, unsigned width, unsigned height)
{
    s->dirt_width = width;
    s->dirt_height = height;
    s->dirt = calloc((size_t)width * height * 3, sizeof(float));
    assert_non_null(s->dirt);
}

void scene_add_kernel(struct scene *s, unsigned width, unsigned height)
{
    const size_t n = (size_t)width * height * 3;
    free(s->kernel);
    s->kernel_width = width;
    s->kernel_height = height;
    s->kernel = calloc(n, sizeof(float));
    assert_non_null(s->kernel);
    for (size_t i = 0; i < n; i++)
        s->kernel[i] = (float)(0.01 + scene_uniform());
    for (unsigned i = 0; i < 4; i++)
        snprintf(s->kernel_digest + 8 * i, 9, "%08x", (uint32_t)(scene_uniform() * 0x1p32));
}

void scene_fill(struct scene *s)
{
    for (unsigned c = 0; c < s->channels; c++)
        for (size_t i = 0; i < pixels_in(s); i++)
            s->plane[c][i] = 0.9 * scene_uniform();
    const unsigned lamps = 3 + s->width * s->height / 400;
    for (unsigned i = 0; i < lamps; i++) {
        const size_t at = (size_t)(scene_uniform() * s->width * s->height);
        const double v = pow(10, 4.5 * scene_uniform());
        for (unsigned c = 0; c < s->channels; c++)
            s->plane[c][at] = v * (0.2 + scene_uniform());
    }
    for (unsigned y = 0; y < s->height && y < 5; y++)
        for (unsigned x = 0; x < s->width && x < 9; x++)
            s->plane[0][(size_t)y * s->width + x] = 40;
}

struct params scene_params(const char *psf, enum bright_curve curve, double tolerance)
{
    struct params p;
    struct fault f;
    params_init(&p);
    if (params_set_text(&p, "psf", psf, &f) < 0)
        fail_msg("%s", f.text);
    p.bright = curve;
    p.tolerance = tolerance;
    p.threshold = 1;
    p.knee = 0.5;
    p.intensity = 1;
    return p;
}

/* ---- running --------------------------------------------------------------------------------------- */

static void put(const struct planes *to, unsigned c, unsigned y, double *v)
{
    uint8_t *row = planes_row(to, c, y);
    memset(row, 0, to->pitch_bytes);
    for (unsigned x = 0; x < to->width; x++) {
        float f = (float)v[x];
        if (to->type == PIXEL_TYPE_HALF) {
            uint16_t h;
            float_to_half(&h, &f, 1);
            memcpy(row + 2 * x, &h, 2);
            half_to_float(&f, &h, 1);
        } else {
            memcpy(row + 4 * x, &f, 4);
        }
        v[x] = f;
    }
}

static void get(const struct planes *from, unsigned c, unsigned y, double *v)
{
    const uint8_t *row = planes_row(from, c, y);
    for (unsigned x = 0; x < from->width; x++) {
        float f;
        if (from->type == PIXEL_TYPE_HALF) {
            uint16_t h;
            memcpy(&h, row + 2 * x, 2);
            half_to_float(&f, &h, 1);
        } else {
            memcpy(&f, row + 4 * x, 4);
        }
        v[x] = f;
    }
}

static void put_all(struct scene *s, const struct planes *to, double *const plane[3], struct frame_scan *scan)
{
    if (scan) {
        frame_scan_finish(scan);
        assert_int_equal(frame_scan_init(scan, s->width, s->height), 0);
    }
    for (unsigned y = 0; y < s->height; y++) {
        for (unsigned c = 0; c < to->count; c++)
            put(to, c, y, plane[c] + (size_t)y * s->width);
        if (scan)
            frame_scan_row(scan, to, y, s->luma);
    }
}

// The target, then its source and its matte where there are such.
void scene_load(struct scene *s, struct bloom *b, unsigned slot)
{
    struct bloom_geometry g[3] = { { s->width, s->height, s->channels, s->type, s->grow, s->outputs } };
    unsigned count = 1;
    if (s->source[0])
        g[count++] = (struct bloom_geometry){ s->width, s->height, s->channels, s->type, s->grow, 0 };
    if (s->matte)
        g[count++] = (struct bloom_geometry){ s->width, s->height, 1, s->type, s->grow, 0 };
    struct fault f = { 0 };
    if (bloom_slot_prepare(b, bloom_slot(b, slot), count, g, s->in_planes, s->out_planes, &f) < 0)
        fail_msg("%s", f.text);
    put_all(s, &s->in_planes[0], s->plane, &s->scan);
    if (s->source[0])
        put_all(s, &s->in_planes[1], s->source, &s->source_scan);
    if (s->matte)
        put_all(s, &s->in_planes[count - 1], (double *[3]){ s->matte }, &s->matte_scan);
}

static void read_back(struct scene *s)
{
    clear_out(s);
    for (unsigned k = 0; k < s->outputs; k++)
        for (unsigned c = 0; c < s->channels; c++) {
            s->out[k][c] = plane_make(pixels_out(s));
            // An untouched picture is its input, and beyond that 0; layers are written all the same.
            const bool in = s->reply.untouched && k == 0;
            const unsigned margin = in ? s->grow : 0, rows = s->height + (in ? 0 : 2 * s->grow);
            for (unsigned y = 0; y < rows; y++)
                get(in ? &s->in_planes[0] : &s->out_planes[k], c, y,
                    s->out[k][c] + ((size_t)y + margin) * (s->width + 2 * s->grow) + margin);
        }
}

void scene_run(struct scene *s, const struct params *p, struct bloom *b, unsigned slot)
{
    scene_load(s, b, slot);
    struct bloom_image dirt = { .width = s->dirt_width, .height = s->dirt_height, .rgb = s->dirt };
    // A name of its own for every run: the engine keeps what it has seen by name.
    static unsigned runs;
    snprintf(dirt.digest, sizeof(dirt.digest), "%032x", ++runs);
    struct bloom_image kernel = { .width = s->kernel_width, .height = s->kernel_height, .rgb = s->kernel };
    memcpy(kernel.digest, s->kernel_digest, sizeof(kernel.digest));
    struct bloom_request r = { .params = p,
                               .scan = &s->scan,
                               .source = s->source[0] ? 1 : -1,
                               .source_scan = s->source[0] ? &s->source_scan : NULL,
                               .matte = !s->matte ? -1 : s->source[0] ? 2 : 1,
                               .matte_scan = s->matte ? &s->matte_scan : NULL,
                               .depth = -1,
                               .dirt = s->dirt ? &dirt : NULL,
                               .kernel = s->kernel ? &kernel : NULL,
                               .pixel_aspect = (float)s->aspect,
                               .display_width = s->display_width };
    memcpy(r.luma, s->luma, sizeof(r.luma));
    struct fault f = { 0 };
    if (bloom_run(b, bloom_slot(b, slot), 0, &r, &s->reply, &f) < 0)
        fail_msg("%s: %s", f.field, f.text);
    read_back(s);
}

/* ---- comparing ------------------------------------------------------------------------------------- */

struct reference_frame scene_reference(const struct scene *s, double **dirt)
{
    struct reference_frame f = { .width = s->width, .height = s->height, .channels = s->channels,
                                 .plane = { s->plane[0], s->plane[1], s->plane[2] },
                                 .luma = { s->luma[0], s->luma[1], s->luma[2] },
                                 .pixel_aspect = (float)s->aspect,
                                 .source = { s->source[0], s->source[1], s->source[2] }, .matte = s->matte,
                                 .grow = s->grow, .display_width = s->display_width };
    if (!s->dirt)
        return f;
    const size_t n = (size_t)s->dirt_width * s->dirt_height * 3;
    *dirt = plane_make(n);
    for (size_t i = 0; i < n; i++)
        (*dirt)[i] = s->dirt[i];
    f.dirt = *dirt;
    f.dirt_width = s->dirt_width;
    f.dirt_height = s->dirt_height;
    return f;
}

double scene_quantum(enum pixel_type type, double v)
{
    const double single = fmax(ldexp(fabs(v), -24), 0x1p-149);
    return type == PIXEL_TYPE_HALF ? fmax(ldexp(fabs(v), -11), 0x1p-25) + single : single;
}

static double held(enum pixel_type type, double v)
{
    const double most = type == PIXEL_TYPE_HALF ? 65504 : 0x1.fffffep127;
    return isfinite(v) ? fmin(fmax(v, -most), most) : v;
}

/* One comparison: the scene, what was asked, the truth, and the stated bound of B's error. */
struct judge {
    const struct scene *s;
    const struct params *p;
    const struct reference_frame *f;
    const struct reference_result *r;
    double bound;
};

static bool plain_add(const struct params *p)
{
    return p->composite != COMPOSITE_MIX && p->display == DISPLAY_NONE && p->saturation == 1 &&
           p->encoding == ENCODING_LINEAR;
}

// The interval in which sample c of the final picture's pixel i must be: the box of all glows that hold the bound, through
// the composite and the display, whose extremes are at its corners (reference.h). Float32 arithmetic there is allowed
// a millionth of what goes in, and of what comes out.
static void final_interval(const struct judge *j, size_t i, unsigned c, double *low, double *high)
{
    double scene[3] = { 0 }, bright[3] = { 0 }, glow[3] = { 0 }, slack[3], v[3], out[3];
    const double k = j->p->intensity;
    *low = INFINITY;
    *high = -INFINITY;
    for (unsigned u = 0; u < j->f->channels; u++) {
        scene[u] = isfinite(j->r->scene[u][i]) ? j->r->scene[u][i] : 0;
        bright[u] = j->r->bright[u][i];
        glow[u] = j->r->glow[u][i];
        slack[u] = j->bound + (k > 0 ? 1e-6 * (fabs(scene[u]) / k + glow[u] + bright[u]) : 0);
    }
    for (unsigned corner = 0; corner < 1u << j->f->channels; corner++) {
        double base[3] = { 0 };
        for (unsigned u = 0; u < j->f->channels; u++) {
            const double sign = corner >> u & 1 ? 1 : -1;
            v[u] = glow[u] + sign * slack[u];
            // Without intensity no glow stands for the rounding of the scene.
            base[u] = scene[u] + (k > 0 ? 0 : sign * 1e-6 * fabs(scene[u]));
            // A denormal may be flushed; an encoding makes that 1e-20.
            if (sign < 0 && fabs(scene[u]) < 0x1p-126)
                base[u] = 0;
        }
        reference_final(out, base, bright, v, j->f->channels, j->f->luma, j->p);
        // Below 0 after the tone map (a glow short by its bound) an encoding has no value: black.
        const double o = isnan(out[c]) ? 0 : out[c];
        *low = fmin(*low, o - 1e-6 * fabs(o));
        *high = fmax(*high, o + 1e-6 * fabs(o));
    }
}

/* How far sample c of pixel i may be from `want` in this view, the output's own rounding apart. */
static double room_of(const struct judge *j, const struct view_spec *view, size_t i, unsigned c, double want,
                      double got)
{
    const double matte = j->f->matte && isfinite(j->r->scene[c][i]) ? 0x1p-22 * fabs(j->r->scene[c][i]) : 0;
    double low, high;
    // A smoothstep rises by as much as 1.5 / 2K of L over the width of its knee.
    const double steep = j->p->bright == BRIGHT_SMOOTHSTEP && j->p->knee > 0 ? fmax(1, .75 / j->p->knee) : 1;
    switch (view->view) {
    case VIEW_FINAL:
        if (plain_add(j->p))
            return j->bound * j->p->intensity + matte;
        final_interval(j, i, c, &low, &high);
        // Black that may be black: how far below it the glow would have put it cannot be seen.
        if (got == 0 && low <= 0)
            return INFINITY;
        return got < want ? want - low : high - want;
    case VIEW_SOURCE: return matte;
    case VIEW_BRIGHT:
    case VIEW_RESIDUAL: return matte + 0x1p-20 * steep * (j->r->bright[c][i] + j->r->max_bright);
    default: return j->bound * j->p->intensity;
    }
}

static void compare_output(const struct judge *j, unsigned output, const struct view_spec *view, double *const want[3],
                           struct scene_verdict *v)
{
    const struct scene *s = j->s;
    const double scale = j->p->intensity * j->r->max_bright;
    for (unsigned c = 0; c < s->channels; c++)
        for (size_t i = 0; i < pixels_out(s); i++) {
            const double got = s->out[output][c][i], truth = held(s->type, want[c][i]);
            if (!isfinite(truth) && (truth == got || (isnan(truth) && isnan(got))))
                continue;
            const double error = fabs(got - truth), room = room_of(j, view, i, c, truth, got);
            // Numbers below the normal floats may be flushed on the way.
            const double excess = error - scene_quantum(s->type, truth) - 0x1p-126;
            const double ratio = excess <= 0 ? 0 : room > 0 ? excess / room : INFINITY;
            if (ratio <= v->ratio)
                continue;
            v->ratio = isnan(ratio) ? INFINITY : ratio;
            v->error = scale > 0 ? error / scale : 0;
            v->x = (unsigned)(i % (s->width + 2 * s->grow));
            v->y = (unsigned)(i / (s->width + 2 * s->grow));
            v->c = c;
            v->output = output;
            v->got = got;
            v->want = truth;
            v->room = room;
        }
}

static void ledger_entry(struct scene_verdict *v, const char *what, double got, double want, double room)
{
    if (!v->why[0] && !(fabs(got - want) <= room))
        snprintf(v->why, sizeof(v->why), "%s %.9g, %.9g +- %.2g expected", what, got, want, room);
}

// Sums over float32 pyramids: a few 1e-6, and of each lit pixel the rounding of L - T; the spread's own share is the bound's.
static void compare_ledger(const struct judge *j, struct scene_verdict *v)
{
    const struct bloom_reply *reply = &j->s->reply;
    const struct reference_result *r = j->r;
    const double k = j->p->intensity, all = r->energy_bright + r->energy_clamped + r->energy_suppressed;
    double lit = 0, weight = 0;
    for (unsigned c = 0; c < j->f->channels; c++)
        for (size_t i = 0; i < pixels_in(j->s); i++) {
            const double s = j->f->source[0] ? j->f->source[c][i] : j->f->plane[c][i];
            lit += isfinite(s) && s > 0 ? s * (j->f->matte ? fmax(1, j->p->emission) : 1) : 0;
        }
    for (unsigned c = 0; c < j->f->channels; c++) {
        double w = j->p->psf_spec.kind == PSF_GAUSSIANS ? 0 : j->p->psf_spec.weight;
        for (unsigned i = 0; i < j->p->psf_spec.count; i++)
            w += reference_weight(j->f, j->p, i, c);
        weight = fmax(weight, w);
    }
    if (!(reply->max_bright >= r->max_bright * (1 - 1e-6)))
        snprintf(v->why, sizeof(v->why), "max E %.9g, at least %.9g expected", reply->max_bright, r->max_bright);
    // Levels of half keep 11 bits.
    const double near = (strcmp(reply->storage, "half") ? 1e-5 : 8e-3) * all + 0x1p-21 * lit;
    // With edge=fill the light comes from beyond the frame too: a bound a sample.
    const double spread = j->p->edge == EDGE_FILL ? r->max_bright * (double)(pixels_in(j->s) * j->f->channels) : all;
    const double room = near * (1 + k * weight) + reply->error_bound * k * spread;
    ledger_entry(v, "bright", reply->energy_bright, r->energy_bright, near);
    ledger_entry(v, "clamped", reply->energy_clamped, r->energy_clamped, near);
    ledger_entry(v, "suppressed", reply->energy_suppressed, r->energy_suppressed, near);
    // A level's view has that level's glow alone.
    if (j->p->view_spec.view == VIEW_LEVEL)
        return;
    ledger_entry(v, "lost", reply->energy_lost, r->energy_lost, j->p->edge == EDGE_FILL ? 0 : room);
    ledger_entry(v, "bloomed", reply->energy_bloomed, r->energy_bloomed, room);
}

// Metered in float32: pixels within a millionth of a bin's edge may be in either, and then EV is right to a bin.
static void compare_exposure(const struct scene *s, const struct params *p, const struct reference_frame *f,
                             struct scene_verdict *v)
{
    size_t near_edges;
    const bool displayed = p->display != DISPLAY_NONE || p->encoding != ENCODING_LINEAR || p->saturation != 1;
    if (p->bloom == SWITCH_OFF && !displayed)
        return; // nobody looks at it
    const double ev = reference_exposure(f, p, &near_edges);
    ledger_entry(v, "exposure", s->reply.exposure, ev, !p->exposure_auto ? 0 : near_edges ? .126 : 1e-5);
}

void scene_truth(struct reference_result *r, const struct scene *s, const struct reference_frame *f,
                 const struct params *p)
{
    struct params used = *p;
    const bool kernel = p->psf_spec.kind != PSF_GAUSSIANS;
    if (kernel)
        used.psf_spec = (struct psf_spec){ .kind = PSF_GAUSSIANS };
    assert_int_equal(reference_bloom(r, f, &used), 0);
    if (!kernel || p->bloom == SWITCH_OFF)
        return;
    scene_kernel_spread(r, s, f, &p->psf_spec);
    reference_take_glow(r, f, p, p->psf_spec.weight);
}

void scene_compare(const struct scene *s, const struct params *p, struct scene_verdict *v)
{
    *v = (struct scene_verdict){ 0 };
    double *dirt = NULL, *want[3] = { NULL };
    const struct reference_frame f = scene_reference(s, &dirt);
    struct params used = *p;
    compare_exposure(s, p, &f, v);
    if (p->exposure_auto) {
        used.exposure = s->reply.exposure; // a stop's rounding is not the glow's error
        used.exposure_auto = false;
    }
    struct reference_result r;
    scene_truth(&r, s, &f, &used);
    v->max_bright = r.max_bright;
    const struct judge j = { s, &used, &f, &r, s->reply.error_bound * r.max_bright };
    for (unsigned c = 0; c < s->channels; c++)
        want[c] = plane_make(pixels_out(s));
    for (unsigned k = 0; k < s->outputs; k++) {
        const struct view_spec *view = k ? &p->layer[k - 1] : &p->view_spec;
        assert_int_equal(reference_view(want, &r, &f, &used, view), 0);
        compare_output(&j, k, view, want, v);
    }
    if (strcmp(s->reply.rule, "-") && r.energy_bright > 0)
        compare_ledger(&j, v);
    for (unsigned c = 0; c < 3; c++)
        free(want[c]);
    free(dirt);
    reference_free(&r);
}

double scene_check(const struct scene *s, const struct params *p, const char *what)
{
    struct scene_verdict v;
    scene_compare(s, p, &v);
    print_message("%-34s %4ux%-4u %s bound %.2e error/bound %.3f error %.2e of max E %.3g at %u,%u,%u (%s)\n", what,
                  s->width, s->height, s->type == PIXEL_TYPE_HALF ? "half " : "float", s->reply.error_bound, v.ratio,
                  v.error, v.max_bright, v.x, v.y, v.c, s->reply.plan);
    if (!(v.ratio <= 1))
        fail_msg("%s: output %u, pixel %u,%u,%u is %.9g, %.9g expected, room %.3g", what, v.output, v.x, v.y, v.c, v.got,
                 v.want, v.room);
    if (v.why[0])
        fail_msg("%s: %s", what, v.why);
    return v.ratio;
}
