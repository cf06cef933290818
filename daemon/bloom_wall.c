// SPDX-License-Identifier: Apache-2.0
// bloom_wall.c - a wall's picture: what is asked, which part of a frame it needs, its passes.
//
// A plain picture (bloom_wall_is_direct) is never composited: the mean over a wall pixel of I + intensity * B is resampled from I, from E
// at levels finer than the wall's pixels (their Gaussians are in the weights), and from the sum of the others at the level
// nearest to the wall's pixels. Any other picture is made whole, and resampled from its output planes.
// Invariant: levels, weights, shader variants and the order of sums depend on the frame, the wall and the plan, never on the target.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "bloom_internal.h"

// Loads are what a resampling costs, so few taps are unrolled to their very number; more of them in steps, for each is a pipeline.
static int32_t unrolled(uint32_t taps) { return taps <= 12 ? (int32_t)taps : taps <= 24 ? (int32_t)(taps + 3) / 4 * 4 : 0; }

bool bloom_wall_is_direct(const struct params *p)
{
    const bool dirt = p->dirt[0] && p->dirt_gain > 0;
    return p->look == LOOK_NONE && (p->bloom == SWITCH_OFF || p->psf_spec.kind == PSF_GAUSSIANS) && p->composite == COMPOSITE_ADD &&
           !p->matte[0] && !dirt && p->edge == EDGE_ZERO && p->view_spec.view == VIEW_FINAL;
}

// Columns of what is resampled, all sources beside each other.
static double texels_of(const struct plan *p, const struct bloom_wall *w, unsigned level)
{
    double texels = ceil(w->frame_width / 4.0) + ldexp(w->frame_width, -2 - (int)level) + 8;
    for (unsigned g = 0; g < p->count && p->gaussian[g].level < level; g++)
        texels += ldexp(w->frame_width, -2 - (int)p->gaussian[g].level) + 8;
    return texels;
}

unsigned wall_level(const struct bloom *b, const struct plan *p, const struct bloom_wall *w)
{
    // The nearest power of 2, by ratio.
    const double pitch = fmin(w->pitch_x, w->pitch_y) * M_SQRT2;
    unsigned level = 0;
    while (level < p->levels && ldexp(2, (int)level) <= pitch)
        level++;
    while (level > 0 && texels_of(p, w, level) > b->vk.properties.limits.maxImageDimension2D)
        level--;
    return level;
}

/* ---- what may be asked ----------------------------------------------------------------------------------- */

static int bad_wall(struct fault *f, const char *what, double value, const char *expected)
{
    return fault_set(f, FAULT_WALL, "wall", "%s = %.17g: %s expected", what, value, expected);
}

static int check_numbers(const struct bloom_wall *w, struct fault *f)
{
    if (w->first_x >= w->end_x || w->end_x > w->width)
        return bad_wall(f, "end_x", w->end_x, "more than first_x, at most the width");
    if (w->first_y >= w->end_y || w->end_y > w->height)
        return bad_wall(f, "end_y", w->end_y, "more than first_y, at most the height");
    if (!(isfinite(w->pitch_x) && w->pitch_x > 0))
        return bad_wall(f, "pitch_x", w->pitch_x, "a number above 0");
    if (!(isfinite(w->pitch_y) && w->pitch_y > 0))
        return bad_wall(f, "pitch_y", w->pitch_y, "a number above 0");
    if (!isfinite(w->x) || !isfinite(w->y))
        return bad_wall(f, isfinite(w->x) ? "y" : "x", isfinite(w->x) ? w->y : w->x, "a finite number");
    if (!w->frame_width || !w->frame_height)
        return bad_wall(f, "frame", w->frame_width ? w->frame_height : w->frame_width, "a size above 0");
    if (w->tone_map < DISPLAY_NONE || w->tone_map > DISPLAY_ACES)
        return bad_wall(f, "tone_map", w->tone_map, "none, reinhard or aces");
    return 0;
}

int bloom_wall_check_params(const struct params *p, struct fault *f)
{
    const struct { bool asked; const char *name; } not_here[] = {
        { p->display != DISPLAY_NONE, "display" }, { p->saturation != 1, "saturation" },
        { p->encoding != ENCODING_LINEAR, "encoding" }, { p->grow_size.value != 0, "grow" },
        { p->layer_count > 0, "layers" }, { p->storage == STORAGE_HALF, "storage" },
    };
    for (unsigned i = 0; i < sizeof(not_here) / sizeof(not_here[0]); i++)
        if (not_here[i].asked) {
            char field[32];
            snprintf(field, sizeof(field), "params.%s", not_here[i].name);
            return fault_set(f, FAULT_PARAM_CONFLICT, field, "%s with a wall: not given expected, for the wall's definition says "
                             "what becomes of the light", not_here[i].name);
        }
    return 0;
}

int wall_check(const struct frame *fr)
{
    const struct bloom_wall *w = fr->wall;
    const struct bloom_geometry *g = &fr->target->geometry;
    if (check_numbers(w, fr->f) < 0 || bloom_wall_check_params(fr->params, fr->f) < 0)
        return -1;
    if (g->grow || g->outputs > 1 || (!fr->wall_direct && g->outputs != 1))
        return fault_set(fr->f, FAULT_INTERNAL, "wall", "a target with %u outputs, grown by %u pixels: %s expected", g->outputs, g->grow,
                         fr->wall_direct ? "at most 1, and 0" : "1, and 0");
    if (w->frame_x < 0 || w->frame_y < 0 || (uint64_t)w->frame_x + g->width > w->frame_width ||
        (uint64_t)w->frame_y + g->height > w->frame_height)
        return fault_set(fr->f, FAULT_WALL, "wall", "%u x %u pixels at %d,%d: a part of the frame of %u x %u expected", g->width, g->height,
                         w->frame_x, w->frame_y, w->frame_width, w->frame_height);
    return 0;
}

/* ---- which part of the frame ------------------------------------------------------------------------------- */

// One axis, pixels of the frame.
static void need_span(double from, double to, uint32_t size, double reach, uint32_t cell, int32_t *first, int32_t *end)
{
    const double low = fmin(fmax(floor(from), 0), size - 1.0), high = fmin(fmax(ceil(to), low + 1), size);
    *first = (int32_t)(floor(fmax(low - reach, 0) / cell) * cell);
    *end = (int32_t)fmin(ceil((high + reach) / cell) * cell, size);
}

int bloom_wall_need(struct bloom *b, const struct params *p, float pixel_aspect, unsigned channels, uint32_t display_width,
                    const struct bloom_wall *w, int32_t need[4], struct fault *f)
{
    if (check_numbers(w, f) < 0)
        return -1;
    if (!bloom_wall_is_direct(p)) {
        memcpy(need, (int32_t[4]){ 0, 0, (int32_t)w->frame_width, (int32_t)w->frame_height }, 4 * sizeof(need[0]));
        return 0;
    }
    const struct bloom_geometry g = { .width = w->frame_width, .height = w->frame_height, .channels = channels, .type = PIXEL_TYPE_FLOAT };
    const struct bloom_request r = { .params = p, .wall = w, .pixel_aspect = pixel_aspect, .display_width = display_width };
    double reach = 0;
    uint32_t cell = 1;
    if (p->bloom == SWITCH_ON) {
        if (plan_find(b, &r, &g, f) < 0)
            return -1;
        // A firefly is one by its neighbours.
        reach = plan_reach(b->plan) + (p->firefly > 0 ? 1 : 0);
        cell = 1u << b->plan->levels;
    }
    need_span(w->x + w->first_x * w->pitch_x, w->x + w->end_x * w->pitch_x, w->frame_width, reach, cell, &need[0], &need[2]);
    need_span(w->y + w->first_y * w->pitch_y, w->y + w->end_y * w->pitch_y, w->frame_height, reach, cell, &need[1], &need[3]);
    return 0;
}

/* ---- auto exposure over time ---------------------------------------------------------------------------------- */

double bloom_adapt_stops(const struct bloom_adapt *a, double metered)
{
    if (!a->started)
        return metered;
    const double tau_s = metered < a->stops ? a->up_s : a->down_s;
    if (!(tau_s > 0))
        return metered;
    return a->stops + (metered - a->stops) * -expm1(-fmax(a->step_s, 0) / tau_s);
}

/* ---- passes ------------------------------------------------------------------------------------------------- */

/* What one source is read from. */
struct picture {
    const char *kind;
    struct vk_image *level;      /* or, NULL, planes: */
    const struct slot_target *planes;
    bool output;                 /* of the planes */
    uint32_t texels, groups;     /* of the level */
};

static void bind_picture(const struct picture *from, struct vk_draw *d, struct pass_uniforms *u)
{
    const struct slot_target *t = from->planes;
    if (from->level) {
        d->src = from->level;
        u->src[0] = (int32_t)from->texels;
        u->src[1] = (int32_t)from->groups;
        return;
    }
    for (unsigned c = 0; c < VK_PLANES; c++)
        d->in[c] = (struct vk_image *)(from->output ? &t->out[0][c] : &t->in[c < t->geometry.channels ? c : 0]);
    d->matte = (struct vk_image *)(from->output ? &t->out[0][3] : &t->in[0]);
    u->frame[2] = (int32_t)t->groups;
}

/* Where a level's Gaussian can be above 0 on the wall's rows. */
enum { RECTS_MAX = 3 * LIT_MAX };
struct lit_part {
    unsigned count;
    VkRect2D rect[RECTS_MAX];
};

static uint32_t held(double v, uint32_t most) { return v <= 0 ? 0 : v >= most ? most : (uint32_t)v; }

static bool lit_part(const struct frame *fr, const struct wall_work *k, const struct wall_source *s, struct lit_part *out)
{
    const struct lit *l = fr->lit;
    const struct bloom_wall *w = fr->wall;
    const uint32_t rows = w->end_y - w->first_y;
    // Light gets less than 4 cells of a level away on its way there, as far again on its way back, and half the taps between.
    const double cell = ldexp(1, (int)s->level), reach_x = 4 * cell;
    const double reach_y = (8 + fr->b->plan->gaussian[s->gaussian].y.half) * cell;
    double area = 0;
    out->count = 0;
    for (unsigned c = 0; l && c < k->channels; c++)
        for (unsigned i = 0; i < l->count; i++) {
            const uint32_t x0 = held(floor(((l->x0[i] - reach_x) / cell + LEVEL_MARGIN) / 4) - 1, s->texels);
            const uint32_t x1 = held(ceil(((l->x1[i] + reach_x) / cell + LEVEL_MARGIN) / 4) + 1, s->texels);
            const double top = (l->y0[i] - reach_y + w->frame_y - w->y) / w->pitch_y - w->first_y;
            const double bottom = (l->y1[i] + reach_y + w->frame_y - w->y) / w->pitch_y - w->first_y;
            const uint32_t y0 = held(floor(top) - 1, rows), y1 = held(ceil(bottom) + 1, rows);
            out->rect[out->count++] = (VkRect2D){ { (int32_t)(s->column + x0), (int32_t)(c * rows + y0) }, { x1 - x0, y1 - y0 } };
            area += (double)(x1 - x0) * (y1 - y0);
        }
    return l && area < 0.8 * s->texels * rows * k->channels;
}

static int record_rows(struct frame *fr, struct wall_work *k, const struct wall_source *s, const struct picture *from,
                       const double gain[3])
{
    struct vk_draw d = { .dst = &k->rows, .dirt = (struct vk_image *)&s->down };
    const struct slot_target *t = from->planes;
    d.pipeline = pipeline_get(fr->b, fr->f, unrolled(s->taps_down), "wall_rows_%s%s", from->kind,
                              t && t->geometry.type == PIXEL_TYPE_HALF ? "_half" : "");
    if (!d.pipeline)
        return -1;
    const uint32_t rows = fr->wall->end_y - fr->wall->first_y;
    struct pass_uniforms *u = pass_begin(fr, &d);
    u->mode[2] = (int32_t)(s->down.height - 1);
    u->mode[3] = (int32_t)rows;
    u->frame[3] = (int32_t)s->column;
    for (unsigned c = 0; c < 3; c++)
        u->weight[c] = (float)gain[k->channels == 1 ? 0 : c];
    bind_picture(from, &d, u);
    d.bands = t && !from->output ? k->channels : 1;
    d.area = (VkRect2D){ { (int32_t)s->column, 0 }, { s->texels, rows * k->channels } };
    struct lit_part part;
    if (s->gaussian >= 0 && lit_part(fr, k, s, &part)) {
        d.rects = part.rect;
        d.n_rects = part.count;
    }
    vk_draw(&fr->b->commands, &d);
    return 0;
}

static int record_picture(struct frame *fr, struct wall_work *k, bool output)
{
    static const double one[3] = { 1, 1, 1 };
    const struct picture from = { .kind = output ? "output" : "input", .planes = fr->target, .output = output };
    return record_rows(fr, k, &k->source[0], &from, one);
}

static int record_finer(struct frame *fr, struct wall_work *k, const struct wall_source *s)
{
    struct targets *t = &fr->b->targets;
    const struct plan_gaussian *g = &fr->b->plan->gaussian[s->gaussian];
    struct picture from = { "level", &t->e[s->level], .texels = t->level[s->level].texels, .groups = t->level[s->level].groups };
    if (!s->level)
        from = (struct picture){ "layered", &t->layered, .texels = t->layered.width, .groups = t->layered_groups };
    double gain[3];
    for (unsigned c = 0; c < 3; c++)
        gain[c] = fr->params->intensity * g->weight[c];
    return record_rows(fr, k, s, &from, gain);
}

static int record_glow(struct frame *fr, struct wall_work *k)
{
    const struct targets *t = &fr->b->targets;
    for (unsigned i = 1; i + k->summed < k->sources; i++)
        if (record_finer(fr, k, &k->source[i]) < 0)
            return -1;
    struct round r;
    if (!k->summed)
        return 0;
    if (record_spread(fr, -1, &r) < 0)
        return -1;
    const struct level *v = &t->level[t->shape.finest];
    const struct picture from = { "level", r.sum, .texels = v->texels, .groups = v->groups };
    const double by = fr->params->intensity, gain[3] = { by, by, by };
    return record_rows(fr, k, &k->source[k->sources - 1], &from, gain);
}

// The chunks of up to 3 sources, 4 bits each; 0: too many, for a loop.
static int32_t unrolled_columns(const struct wall_work *k, unsigned sources)
{
    int32_t bits = 0;
    for (unsigned i = 0; i < sources; i++) {
        if (i >= 3 || k->source[i].chunks_across > 8 || k->source[i].chunks_across == 0)
            return 0;
        bits |= (int32_t)k->source[i].chunks_across << 4 * i;
    }
    return bits;
}

// The drive, and to where the host reads it.
static int record_drive(struct frame *fr, struct wall_work *k, unsigned sources)
{
    struct bloom *b = fr->b;
    const struct bloom_wall *w = fr->wall;
    struct vk_draw d = { .src = &k->rows, .add = w->gain ? &k->gain : &b->blank, .dirt = &k->across, .dst = &k->drive };
    const int32_t features = w->tone_map | (w->saturation != 1) << 2 | (w->gain != NULL) << 3;
    d.pipeline = pipeline_get(b, fr->f, features | unrolled_columns(k, sources) << 4, "wall_columns_c%u", k->channels);
    if (!d.pipeline)
        return -1;
    struct pass_uniforms *u = pass_begin(fr, &d);
    u->mode[2] = (int32_t)sources;
    u->mode[3] = (int32_t)k->drive.height;
    u->window[0] = (int32_t)w->first_x;
    u->window[1] = (int32_t)w->first_y;
    u->limit[3] = (float)w->saturation;
    for (unsigned c = 0; c < 3; c++) {
        u->luma[c] = frame_rec709[c];
        for (unsigned i = 0; i < 3; i++)
            u->tap[4 * c + i] = (float)w->matrix[c][i];
    }
    d.area = (VkRect2D){ { 0, 0 }, { k->drive.width, k->drive.height } };
    vk_draw(&b->commands, &d);
    vk_use(&b->commands, &k->drive, VK_PIPELINE_STAGE_2_COPY_BIT, VK_ACCESS_2_TRANSFER_READ_BIT, false);
    vk_flush_barriers(&b->commands);
    const VkBufferImageCopy copy = {
        .imageSubresource = { VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1 },
        .imageExtent = { k->drive.width, k->drive.height, 1 },
    };
    vkCmdCopyImageToBuffer(b->commands.buffer, k->drive.image, VK_IMAGE_LAYOUT_GENERAL, k->back.buffer, 1, &copy);
    vk_to_host(&b->commands);
    return vk_submit_and_wait(&b->commands, fr->f);
}

static void hand_over(const struct frame *fr, const struct wall_work *k)
{
    const struct bloom_wall *w = fr->wall;
    const float *from = (const float *)(const void *)k->back.memory.map;
    const uint32_t columns = w->end_x - w->first_x;
    for (uint32_t y = w->first_y; y < w->end_y; y++)
        for (uint32_t x = 0; x < columns; x++, from += 4)
            memcpy(w->drive + 3 * ((size_t)y * w->width + w->first_x + x), from, 3 * sizeof(float));
}

int wall_run(struct frame *fr, bool dark)
{
    struct wall_work *k;
    if (wall_work_find(fr, &k) < 0 || record_begin(fr) < 0)
        return -1;
    if (!dark && record_bright(fr) < 0)
        return -1;
    if (record_picture(fr, k, false) < 0 || (!dark && record_glow(fr, k) < 0) ||
        record_drive(fr, k, dark ? 1 : k->sources) < 0)
        return -1;
    hand_over(fr, k);
    return 0;
}

int wall_run_output(struct frame *fr, bool untouched)
{
    struct wall_work *k;
    if (wall_work_find(fr, &k) < 0 || (untouched ? record_begin(fr) : vk_begin(&fr->b->commands, fr->f)) < 0)
        return -1;
    if (!untouched) {
        fr->b->passes = 0;
        fr->b->recordings++;
    }
    if (record_picture(fr, k, !untouched) < 0 || record_drive(fr, k, 1) < 0)
        return -1;
    hand_over(fr, k);
    return 0;
}

double wall_rounding(const struct frame *fr)
{
    // Each sum of n terms is off by at most n 2^-24 of itself, their weights and products by 2 more, gain and what is added by 4.
    double most = 0;
    struct wall_work *k = NULL;
    for (unsigned i = 0; i < WALL_KEPT; i++)
        if (fr->b->wall[i] && fr->b->wall[i]->used == fr->b->walls_asked)
            k = fr->b->wall[i];
    for (unsigned i = 1; k && i < k->sources; i++)
        most = fmax(most, (double)k->source[i].taps_down + k->source[i].taps_across + 8 + k->sources);
    return most * 0x1p-24;
}
