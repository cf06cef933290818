// SPDX-License-Identifier: Apache-2.0
// test_server_looks.c - what one asks of a real daemon is what comes back in the file: sources, mattes, views, layers, windows,
// displays, looks and kernels, each sample against the float64 references, within the bound that the reply states. The engine has its
// own tests; here is the way through request, reader, device, writer and reply.
#include "daemon_fixture.h"

#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "daemon_exr.h"
#include "exr_tool.h"
#include "reference_look.h"
#include "scene_kit.h"

static struct daemon the_daemon;
static struct airy *the_client;

static int start(void **state)
{
    (void)state;
    daemon_start(&the_daemon, (const char *const[]){ "--threads", "2", NULL });
    the_client = daemon_join(&the_daemon);
    return 0;
}

static int stop(void **state)
{
    (void)state;
    airy_close(the_client);
    assert_int_equal(daemon_stop(&the_daemon, SIGTERM), 0);
    return 0;
}

// ---- a scene as a file ---------------------------------------------------------------------------------

static const int32_t corner_x = -7, corner_y = 5;

static size_t pixels(const struct scene *s) { return (size_t)s->width * s->height; }

// To the file's precision, so that the reference sees what the daemon sees.
static void round_plane(const struct scene *s, double *v)
{
    for (size_t i = 0; v && i < pixels(s); i++) {
        float f = (float)v[i];
        uint16_t h;
        if (s->type == PIXEL_TYPE_HALF) {
            float_to_half(&h, &f, 1);
            half_to_float(&f, &h, 1);
        }
        v[i] = f;
    }
}

static void scene_make(struct scene *s, unsigned width, unsigned height, enum pixel_type type, uint64_t seed)
{
    scene_seed(seed);
    scene_init(s, width, height, 3, type);
    memcpy(s->luma, frame_rec709, sizeof s->luma);
    s->display_width = width + 20;
    scene_fill(s);
}

static void scene_round(struct scene *s)
{
    for (unsigned c = 0; c < s->channels; c++) {
        round_plane(s, s->plane[c]);
        round_plane(s, s->source[c]);
    }
    round_plane(s, s->matte);
}

// Z too, when there is a depth.
static uint8_t *scene_file(const struct scene *s, const double *depth, size_t *bytes)
{
    struct exr_plane plane[8] = { { "B", s->plane[2] }, { "G", s->plane[1] }, { "R", s->plane[0] } };
    unsigned n = 3;
    if (depth)
        plane[n++] = (struct exr_plane){ "Z", depth };
    for (unsigned c = 3; s->source[0] && c--;)
        plane[n++] = (struct exr_plane){ (const char *[]){ "glow.R", "glow.G", "glow.B" }[c], s->source[c] };
    if (s->matte)
        plane[n++] = (struct exr_plane){ "id.m", s->matte };
    const struct exr_file f = { .min_x = corner_x, .min_y = corner_y, .width = s->width, .height = s->height,
                                .display_width = s->display_width, .display_height = s->height,
                                .aspect = (float)s->aspect, .half = s->type == PIXEL_TYPE_HALF, .planes = n, .plane = plane };
    return exr_file_make(&f, bytes);
}

// "name=value name=value" to the request and to what the reference is asked.
static struct params ask(struct airy_request *r, const char *list)
{
    struct params p;
    struct fault f;
    struct airy_error e;
    char copy[1024], *rest, *name;
    params_init(&p);
    assert_true(strlen(list) < sizeof copy);
    strcpy(copy, list);
    for (name = strtok_r(copy, " ", &rest); name; name = strtok_r(NULL, " ", &rest)) {
        char *value = strchr(name, '=');
        assert_non_null(value);
        *value++ = 0;
        if (airy_request_param(r, name, value, &e) < 0 || params_set_text(&p, name, value, &f) < 0)
            fail_msg("%s=%s is no parameter", name, value);
    }
    params_look_defaults(&p);
    assert_int_equal(params_check(&p, &f), 0);
    return p;
}

static struct airy_result *send(const struct airy_request *r)
{
    struct airy_result *result = NULL;
    struct airy_error e;
    uint64_t id;
    if (airy_submit(the_client, r, &id, &e) < 0 || airy_wait(the_client, id, 60000, &result, &e) != 1)
        fail_msg("%s: %s (%s)", e.symbol, e.text, e.field);
    return result;
}

static void copy_reply(struct bloom_reply *r, const struct airy_target *t)
{
    *r = (struct bloom_reply){ .untouched = t->untouched, .error_bound = t->error_bound, .max_bright = t->max_bright,
                               .exposure = t->exposure, .energy_bright = t->energy_bright,
                               .energy_bloomed = t->energy_bloomed, .energy_lost = t->energy_lost,
                               .energy_clamped = t->energy_clamped, .energy_suppressed = t->energy_suppressed };
    snprintf(r->plan, sizeof r->plan, "%s", t->plan);
    snprintf(r->rule, sizeof r->rule, "%s", t->rule);
}

static void layer_name(char out[64], const struct params *p, unsigned output, unsigned channel)
{
    char view[32];
    const char letter = "RGB"[channel];
    if (output)
        params_view_name(&p->layer[output - 1], view);
    if (output)
        snprintf(out, 64, "airy.%s.%c", view, letter);
    else
        snprintf(out, 64, "%c", letter);
}

// The result's planes and what the reply says of it.
static void scene_take(struct scene *s, const struct params *p, const struct airy_result *r)
{
    int x, y, w, h;
    assert_int_equal(r->n_targets, 1);
    copy_reply(&s->reply, &r->targets[0]);
    assert_int_equal(exr_tool_window(r->data, r->size, 0, &x, &y, &w, &h), 0);
    assert_int_equal(x, corner_x - (int)s->grow);
    assert_int_equal(y, corner_y - (int)s->grow);
    assert_int_equal(w, s->width + 2 * s->grow);
    assert_int_equal(h, s->height + 2 * s->grow);
    s->outputs = 1 + p->layer_count;
    for (unsigned k = 0; k < s->outputs; k++)
        for (unsigned c = 0; c < 3; c++) {
            char name[64];
            uint32_t width, height;
            layer_name(name, p, k, c);
            s->out[k][c] = exr_file_plane(r->data, r->size, name, s->type == PIXEL_TYPE_HALF, &width, &height);
            if (!s->out[k][c])
                fail_msg("the result has no channel %s", name);
            assert_int_equal(width, w);
            assert_int_equal(height, h);
        }
}

static struct params scene_send(struct scene *s, const double *depth, const char *list)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    const struct params p = ask(&r, list);
    size_t bytes;
    scene_round(s);
    uint8_t *file = scene_file(s, depth, &bytes);
    r.data = file;
    r.size = bytes;
    struct airy_result *result = send(&r);
    scene_take(s, &p, result);
    airy_result_free(result);
    free(file);
    return p;
}

// Through the daemon, and each sample of each output against the reference.
static void try_scene(struct scene *s, const char *list)
{
    const struct params p = scene_send(s, NULL, list);
    scene_check(s, &p, list);
    scene_finish(s);
}

#define PSF "psf=gaussians:sigma=2/5/14,weight=.3/.2/.1"

// ---- where the glow comes from ---------------------------------------------------------------------------

static void test_source_and_matte(void **state)
{
    (void)state;
    struct scene s;
    for (unsigned with = 1; with < 4; with++) {
        scene_make(&s, 83, 61, with == 1 ? PIXEL_TYPE_HALF : PIXEL_TYPE_FLOAT, with);
        if (with & 1) {
            scene_add_source(&s);
            for (unsigned c = 0; c < 3; c++)
                for (size_t i = 0; i < pixels(&s); i++)
                    s.source[c][i] = i % 97 == c ? 30 : .2;
        }
        if (with & 2) {
            scene_add_matte(&s);
            for (size_t i = 0; i < pixels(&s); i++)
                s.matte[i] = i % 83 < 40 ? 0 : (double)(i % 5) / 4;
        }
        try_scene(&s, with == 1   ? PSF " source=glow"
                      : with == 2 ? PSF " matte=id.m emission=3"
                                  : PSF " source=glow matte=id.m emission=2.5 layers=source/bright");
    }
}

static void test_bright_pass(void **state)
{
    (void)state;
    static const char *const lists[] = {
        PSF " firefly=4", PSF " clamp=2 firefly=8", PSF " threshold_unit=stops threshold=-1 exposure=1.5",
        PSF " exposure=auto bright=luminance", PSF " bright=smoothstep knee=.4", PSF " bright=channel clamp=5 near=2 far=.5",
    };
    for (unsigned i = 0; i < sizeof lists / sizeof lists[0]; i++) {
        struct scene s;
        scene_make(&s, 67, 43, PIXEL_TYPE_FLOAT, 10 + i);
        try_scene(&s, lists[i]);
    }
}

// ---- where it goes ---------------------------------------------------------------------------------------

static void test_views_and_layers(void **state)
{
    (void)state;
    static const char *const lists[] = {
        PSF " layers=bright/bloom/level:1/residual/source", PSF " view=bright layers=final",
        PSF " view=bloom", PSF " view=level:2 layers=level:0", PSF " view=residual composite=mix intensity=.5",
        PSF " layers=bloom display=reinhard",
    };
    for (unsigned i = 0; i < sizeof lists / sizeof lists[0]; i++) {
        struct scene s;
        scene_make(&s, 71, 52, i ? PIXEL_TYPE_FLOAT : PIXEL_TYPE_HALF, 20 + i);
        try_scene(&s, lists[i]);
    }
}

// The window, the values beyond it, sizes of every unit, and light that is lost though the window has grown.
static void test_grow(void **state)
{
    (void)state;
    struct scene s;
    scene_make(&s, 60, 45, PIXEL_TYPE_FLOAT, 30);
    s.grow = 9;
    try_scene(&s, PSF " grow=9");
    scene_make(&s, 60, 45, PIXEL_TYPE_HALF, 31);
    s.grow = 2; // ceil(2 % of 75)
    try_scene(&s, PSF " grow=2% layers=bloom");
    scene_make(&s, 60, 45, PIXEL_TYPE_FLOAT, 32);
    s.aspect = 2;
    s.grow = 20; // 4 mm of a sensor of 32 mm, on which 80 pixels of aspect 2 lie
    try_scene(&s, "psf=gaussians:sigma=1mm/3%,weight=.2/.1,tint=1:.5:.2/.4:1:2 grow=4mm sensor=32");
}

static void test_composites_and_displays(void **state)
{
    (void)state;
    static const char *const lists[] = {
        PSF " composite=mix intensity=.6", PSF " edge=fill", PSF " exposure=.5 display=aces encoding=srgb",
        PSF " display=reinhard saturation=.6 encoding=gamma2.2", PSF " composite=screen-add display=aces",
        "bloom=off display=aces encoding=srgb",
    };
    for (unsigned i = 0; i < sizeof lists / sizeof lists[0]; i++) {
        struct scene s;
        scene_make(&s, 64, 49, PIXEL_TYPE_FLOAT, 40 + i);
        try_scene(&s, lists[i]);
    }
}

// ---- images ----------------------------------------------------------------------------------------------

// An image of random colours, kept by the daemon: interleaved R G B.
static float *keep_image(unsigned width, unsigned height, struct airy_asset *kept)
{
    const size_t n = (size_t)width * height;
    float *rgb = malloc(n * 3 * sizeof *rgb);
    double *plane = malloc(n * 3 * sizeof *plane);
    assert_true(rgb && plane);
    for (size_t i = 0; i < n * 3; i++) {
        rgb[i] = (float)scene_uniform();
        plane[i % 3 * n + i / 3] = rgb[i];
    }
    const struct exr_plane planes[] = { { "B", plane + 2 * n }, { "G", plane + n }, { "R", plane } };
    const struct exr_file f = { .width = width, .height = height, .display_width = width, .display_height = height,
                                .aspect = 1, .planes = 3, .plane = planes };
    struct airy_error e;
    size_t bytes;
    uint8_t *file = exr_file_make(&f, &bytes);
    if (airy_asset(the_client, -1, file, bytes, kept, &e) < 0)
        fail_msg("%s: %s", e.symbol, e.text);
    free(file);
    free(plane);
    return rgb;
}

static void test_dirt(void **state)
{
    (void)state;
    struct scene s;
    struct airy_asset kept;
    char list[256];
    scene_make(&s, 59, 40, PIXEL_TYPE_FLOAT, 50);
    s.dirt_width = 23;
    s.dirt_height = 17;
    s.dirt = keep_image(23, 17, &kept);
    snprintf(list, sizeof list, PSF " dirt=%s dirt_gain=.7", kept.digest);
    try_scene(&s, list);
}

// E and out = I + weight * (kernel convolved with E), by the definition.
struct drawn {
    unsigned width, height;
    const float *rgb;
    double weight;
};

static double kernel_sum(const struct drawn *k, unsigned c)
{
    double sum = 0;
    for (size_t i = 0; i < (size_t)k->width * k->height; i++)
        sum += (double)k->rgb[i * 3 + c];
    return sum;
}

static double drawn_at(const struct drawn *k, const struct scene *s, const double *e, unsigned c, int x, int y)
{
    double sum = 0;
    for (int ky = 0; ky < (int)k->height; ky++)
        for (int kx = 0; kx < (int)k->width; kx++) {
            const int sx = x - (kx - (int)k->width / 2), sy = y - (ky - (int)k->height / 2);
            if (sx >= 0 && sy >= 0 && sx < (int)s->width && sy < (int)s->height)
                sum += (double)k->rgb[((size_t)ky * k->width + (size_t)kx) * 3 + c] * e[(size_t)sy * s->width + (size_t)sx];
        }
    return k->weight * sum / kernel_sum(k, c);
}

static void bright_planes(const struct scene *s, const struct params *p, double *e[3], double *max)
{
    const double luma[3] = { (double)s->luma[0], (double)s->luma[1], (double)s->luma[2] };
    *max = 0;
    for (unsigned c = 0; c < 3; c++)
        assert_non_null(e[c] = malloc(pixels(s) * sizeof(double)));
    for (size_t i = 0; i < pixels(s); i++) {
        double lit[3];
        reference_bright(lit, (double[]){ s->plane[0][i], s->plane[1][i], s->plane[2][i] }, 3, luma, p);
        for (unsigned c = 0; c < 3; c++) {
            e[c][i] = lit[c];
            *max = fmax(*max, lit[c]);
        }
    }
}

static void check_drawn(const struct scene *s, const struct params *p, const struct drawn *k)
{
    const int grow = (int)s->grow, width = (int)s->width, height = (int)s->height;
    double *e[3], max, bright = 0, bloomed = 0, worst = 0;
    bright_planes(s, p, e, &max);
    for (unsigned c = 0; c < 3; c++)
        for (int y = -grow; y < height + grow; y++)
            for (int x = -grow; x < width + grow; x++) {
                const bool in = x >= 0 && y >= 0 && x < width && y < height;
                const size_t at = in ? (size_t)y * s->width + (size_t)x : 0;
                const double glow = drawn_at(k, s, e[c], c, x, y), want = glow + (in ? s->plane[c][at] : 0);
                const double got = s->out[0][c][(size_t)(y + grow) * (s->width + 2 * s->grow) + (size_t)(x + grow)];
                const double over = fabs(got - want) - scene_quantum(s->type, want);
                if (!(over <= s->reply.error_bound * max))
                    fail_msg("%d, %d channel %u: %.9g, %.9g expected within %.2g", x, y, c, got, want,
                             s->reply.error_bound * max);
                worst = fmax(worst, over);
                bright += in ? e[c][at] : 0;
                bloomed += in ? glow : 0;
            }
    print_message("%s: bound %.2e, worst %.2e of max E %.4g\n", s->reply.plan, s->reply.error_bound, worst / max, max);
    const double room = 1e-5 * bright;
    assert_true(fabs(s->reply.energy_bright - bright) <= room);
    assert_true(fabs(s->reply.energy_bloomed - bloomed) <= room);
    assert_true(fabs(s->reply.energy_lost - (k->weight * bright - bloomed)) <= room);
    for (unsigned c = 0; c < 3; c++)
        free(e[c]);
}

static void test_kernel(void **state)
{
    (void)state;
    struct scene s;
    struct airy_asset kept;
    char list[256];
    scene_make(&s, 53, 38, PIXEL_TYPE_FLOAT, 60);
    s.grow = 4;
    float *rgb = keep_image(7, 4, &kept);
    snprintf(list, sizeof list, "psf=image:%s,weight=.4 grow=4", kept.digest);
    const struct params p = scene_send(&s, NULL, list);
    assert_string_equal(s.reply.rule, "fft");
    check_drawn(&s, &p, &(struct drawn){ 7, 4, rgb, .4 });
    free(rgb);
    scene_finish(&s);
}

// What the models' kernels are is test_kernel's; here all that they spread is accounted for, and lands in the file.
static void test_model_kernels(void **state)
{
    (void)state;
    static const char *const psfs[] = { "eye", "airy:f=16,weight=.2", "aperture:blades=5,f=32,weight=.3" };
    static const double weights[] = { .1, .2, .3 };
    for (unsigned i = 0; i < 3; i++) {
        struct scene s;
        char list[128];
        double sum = 0;
        scene_make(&s, 48, 36, PIXEL_TYPE_FLOAT, 70 + i);
        snprintf(list, sizeof list, "psf=%s view=bloom", psfs[i]);
        scene_send(&s, NULL, list);
        for (unsigned c = 0; c < 3; c++)
            for (size_t k = 0; k < pixels(&s); k++) {
                assert_true(s.out[0][c][k] >= 0);
                sum += s.out[0][c][k];
            }
        const double bright = s.reply.energy_bright;
        assert_true(bright > 0 && s.reply.error_bound > 0 && s.reply.energy_lost > 0);
        assert_true(fabs(sum - s.reply.energy_bloomed) <= 1e-6 * bright);
        assert_true(fabs(s.reply.energy_bloomed + s.reply.energy_lost - weights[i] * bright) <= 1e-6 * bright);
        scene_finish(&s);
    }
}

// ---- looks ------------------------------------------------------------------------------------------------

static void check_look(struct scene *s, const struct params *p, const double *depth, unsigned output, enum view view)
{
    struct reference_look_frame f = { .width = s->width, .height = s->height, .channels = 3, .matte = s->matte,
                                      .depth = depth, .pixel_aspect = s->aspect, .exposure = s->reply.exposure,
                                      .display_width = s->display_width };
    double *want[3], largest = 0;
    for (unsigned c = 0; c < 3; c++) {
        f.plane[c] = s->plane[c];
        f.luma[c] = (double)s->luma[c];
        assert_non_null(want[c] = malloc(pixels(s) * sizeof(double)));
    }
    assert_int_equal(reference_look(want, &f, p, view), 0);
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < pixels(s); i++)
            largest = fmax(largest, fmax(fabs(s->plane[c][i]), fabs(want[c][i])));
    for (unsigned c = 0; c < 3; c++) {
        for (size_t i = 0; i < pixels(s); i++) {
            const double over = fabs(s->out[output][c][i] - want[c][i]) - scene_quantum(s->type, want[c][i]);
            if (!(over <= 1e-5 * largest && over <= s->reply.error_bound * largest))
                fail_msg("%s, output %u: %zu, %zu channel %u: %.9g, %.9g expected", s->reply.plan, output, i % s->width,
                         i / s->width, c, s->out[output][c][i], want[c][i]);
        }
        free(want[c]);
    }
}

static void test_looks(void **state)
{
    (void)state;
    static const char *const lists[] = {
        "look=half-gaussian layers=bright/bloom", "look=half-gaussian matte=id.m",
        "look=mip-chain sun=x=30%,y=40%,radius=12%,gain=3,tint=1:.8:.5 layers=bloom",
        "look=three-scale kawase=3 stages=6 tint=1:.5:.2/1:1:1 exposure=1", "look=jimenez knee=.3 radius=1 legacy_gain=on",
        "look=airy-eight display=aces encoding=srgb",
    };
    for (unsigned i = 0; i < sizeof lists / sizeof lists[0]; i++) {
        struct scene s;
        double *depth = malloc(77 * 45 * sizeof *depth);
        assert_non_null(depth);
        scene_make(&s, 77, 45, PIXEL_TYPE_FLOAT, 80 + i);
        if (i == 1) {
            scene_add_matte(&s);
            for (size_t k = 0; k < pixels(&s); k++)
                s.matte[k] = k % 77 > 50;
        }
        for (size_t k = 0; k < pixels(&s); k++)
            depth[k] = k % 3 ? INFINITY : 12;
        const struct params p = scene_send(&s, depth, lists[i]);
        check_look(&s, &p, depth, 0, VIEW_FINAL);
        for (unsigned k = 0; k < p.layer_count; k++)
            check_look(&s, &p, depth, 1 + k, p.layer[k].view);
        free(depth);
        scene_finish(&s);
    }
}

// ---- what is refused, and what is left alone ----------------------------------------------------------------

static void expect_refusal(const char *list, const char *field, const char *words)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    struct airy_result *result = NULL;
    struct airy_error e;
    struct scene s;
    size_t bytes;
    uint64_t id;
    scene_make(&s, 40, 30, PIXEL_TYPE_FLOAT, 90);
    ask(&r, list);
    uint8_t *file = scene_file(&s, NULL, &bytes);
    r.data = file;
    r.size = bytes;
    assert_int_equal(airy_submit(the_client, &r, &id, &e), 0);
    if (airy_wait(the_client, id, 60000, &result, &e) == 1)
        fail_msg("%s was taken", list);
    if (strcmp(e.field, field) || !strstr(e.text, words))
        fail_msg("%s: %s %s: %s", list, e.symbol, e.field, e.text);
    free(file);
    scene_finish(&s);
}

static void test_refusals(void **state)
{
    (void)state;
    expect_refusal("budget_ms=.000001", "params.budget_ms", "budget_ms = ");
    expect_refusal("source=nope", "params.source", "'nope'");
    expect_refusal("matte=nope.a", "params.matte", "'nope.a'");
    expect_refusal("grow=16384", "params.grow", "16384 pixels on each side");
}

// A budget that is enough is kept to, and a plan says what runs without a picture.
static void test_plan_and_budget(void **state)
{
    (void)state;
    struct scene s;
    struct airy_request r = AIRY_REQUEST_INIT;
    size_t bytes;
    scene_make(&s, 64, 40, PIXEL_TYPE_FLOAT, 95);
    ask(&r, PSF " budget_ms=100000");
    scene_round(&s);
    uint8_t *file = scene_file(&s, NULL, &bytes);
    r.data = file;
    r.size = bytes;
    struct airy_result *done = send(&r);
    r.plan_only = true;
    struct airy_result *planned = send(&r);
    const struct airy_target *d = &done->targets[0], *t = &planned->targets[0];
    assert_int_equal(planned->size, 0);
    assert_string_equal(t->plan, d->plan);
    assert_string_equal(t->rule, d->rule);
    assert_true(t->error_bound > 0 && t->error_bound <= d->error_bound && d->error_bound < 1e-4);
    assert_true(t->predicted_ms > 0 && t->predicted_ms <= 100000);
    airy_result_free(done);
    airy_result_free(planned);
    free(file);
    scene_finish(&s);
}

static void expect_same_file(const char *list, bool same)
{
    struct scene s;
    struct airy_request r = AIRY_REQUEST_INIT;
    size_t bytes;
    scene_make(&s, 64, 40, PIXEL_TYPE_HALF, 96);
    s.plane[1][77] = NAN;
    ask(&r, list);
    uint8_t *file = scene_file(&s, NULL, &bytes);
    r.data = file;
    r.size = bytes;
    for (int inline_output = 0; inline_output < 2; inline_output++) {
        r.inline_output = inline_output;
        struct airy_result *got = send(&r);
        assert_int_equal(got->size == bytes && !memcmp(got->data, file, bytes), same);
        assert_int_equal(got->targets[0].nan, 1); // counted all the same
        airy_result_free(got);
    }
    free(file);
    scene_finish(&s);
}

static void test_off_is_the_same_file(void **state)
{
    (void)state;
    expect_same_file("bloom=off", true);
    expect_same_file("bloom=off threshold=.1 exposure=2", true);
    expect_same_file("bloom=off nonfinite=zero", false);
    expect_same_file("bloom=off display=aces", false);
    expect_same_file("bloom=off grow=1", false);
    expect_same_file("bloom=off layers=bloom", false);
    expect_same_file(PSF, false);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_source_and_matte), cmocka_unit_test(test_bright_pass),
        cmocka_unit_test(test_views_and_layers), cmocka_unit_test(test_grow),
        cmocka_unit_test(test_composites_and_displays), cmocka_unit_test(test_dirt),
        cmocka_unit_test(test_kernel),           cmocka_unit_test(test_model_kernels),
        cmocka_unit_test(test_looks),            cmocka_unit_test(test_refusals),
        cmocka_unit_test(test_plan_and_budget),  cmocka_unit_test(test_off_is_the_same_file),
    };
    return cmocka_run_group_tests(tests, start, stop);
}
