// SPDX-License-Identifier: Apache-2.0
// bloom_record.c - a frame's passes, in METHODS' order: bright pass, the pyramid, the Gaussians coarsest first, the pictures.
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "bloom_internal.h"

struct pass_uniforms *pass_begin(struct frame *fr, struct vk_draw *d)
{
    struct bloom *b = fr->b;
    assert(b->passes < PASSES_MAX);
    b->pass_name[b->passes] = ((const struct named_pipeline *)(const void *)
                                   ((const char *)d->pipeline - offsetof(struct named_pipeline, pipeline)))->name;
    const VkDeviceSize offset = (VkDeviceSize)b->passes++ * UNIFORM_STRIDE;
    d->uniforms = b->uniforms.buffer;
    d->uniforms_offset = offset;
    d->uniforms_bytes = sizeof(struct pass_uniforms);
    struct pass_uniforms *u = (struct pass_uniforms *)(void *)(b->uniforms.memory.map + offset);
    memset(u, 0, sizeof(*u));
    const uint32_t grow = fr->target->geometry.grow;
    u->frame[0] = (int32_t)fr->target->width;
    u->frame[1] = (int32_t)fr->target->height;
    u->mode[0] = (int32_t)fr->pad;
    u->mode[1] = fr->params->nonfinite;
    u->window[0] = u->window[1] = (int32_t)grow;
    u->window[2] = (int32_t)(fr->target->width - grow);
    u->window[3] = (int32_t)(fr->target->height - grow);
    for (unsigned c = 0; c < 3; c++)
        u->luma[c] = fr->request->luma[c];
    u->luma[3] = (float)exp2(fr->exposure);
    u->limit[0] = (float)fr->params->clamp;
    u->limit[1] = (float)fr->params->firefly;
    u->limit[2] = (float)fr->params->emission;
    u->limit[3] = (float)fr->params->saturation;
    return u;
}

static VkRect2D area_of(uint32_t width, uint32_t height) { return (VkRect2D){ { 0, 0 }, { width, height } }; }

static void level_area(struct frame *fr, const struct level *v, struct vk_draw *d, struct pass_uniforms *u)
{
    u->frame[2] = (int32_t)v->groups;
    d->area = area_of(v->texels, v->groups * fr->target->geometry.channels);
}

static void source(struct pass_uniforms *u, const struct level *v)
{
    u->src[0] = (int32_t)v->texels;
    u->src[1] = (int32_t)v->groups;
}

static void added(struct pass_uniforms *u, const struct level *v)
{
    u->add[0] = (int32_t)v->texels;
    u->add[1] = (int32_t)v->groups;
}

/* ---- only where there is light ----------------------------------------------------------------------- */

// Coarser levels cost too little to be cut up.
enum { LIT_OCTAVES = 2 };
enum { RECTS_MAX = 3 * LIT_MAX };
struct rects {
    unsigned count;
    VkRect2D rect[RECTS_MAX];
};

static uint32_t clamped(double v, uint32_t most) { return v <= 0 ? 0 : v >= most ? most : (uint32_t)v; }

// A span of pixels, widened by `reach`, as units of `per` stored cells of a level (the margin before its cell 0 included).
static void span(uint32_t from, uint32_t to, double reach, unsigned level, unsigned per, uint32_t most, int32_t *first,
                 uint32_t *count)
{
    const uint32_t a = clamped(floor((floor(ldexp(from - reach, -(int)level)) + LEVEL_MARGIN) / per), most);
    const uint32_t b = clamped(ceil((ceil(ldexp(to + reach, -(int)level)) + 1 + LEVEL_MARGIN) / per), most);
    *first = (int32_t)a;
    *count = b - a;
}

// Where an image of this level can be above 0 when nothing has travelled further than these pixels; false: draw all of it.
static bool lit_rects(const struct frame *fr, unsigned level, double reach_x, double reach_y, const struct level *v,
                      struct vk_draw *d, struct rects *out)
{
    const struct lit *l = fr->lit;
    if (!l)
        return false;
    double area = 0;
    out->count = 0;
    for (unsigned c = 0; c < fr->target->geometry.channels; c++)
        for (unsigned i = 0; i < l->count; i++) {
            VkRect2D *r = &out->rect[out->count++];
            span(l->x0[i], l->x1[i], reach_x, level, 4, v->texels, &r->offset.x, &r->extent.width);
            span(l->y0[i], l->y1[i], reach_y, level, 4, v->groups, &r->offset.y, &r->extent.height);
            r->offset.y += (int32_t)(c * v->groups);
            area += (double)r->extent.width * r->extent.height;
        }
    if (area > 0.8 * v->texels * v->groups * fr->target->geometry.channels)
        return false;
    d->rects = out->rect;
    d->n_rects = out->count;
    return true;
}

// The same of the bright pass's image: rows at full size, columns at full size or halved.
static bool lit_layered(const struct frame *fr, unsigned level, struct vk_draw *d, struct rects *out)
{
    const struct targets *t = &fr->b->targets;
    const struct lit *l = fr->lit;
    if (!l)
        return false;
    out->count = 0;
    for (unsigned i = 0; i < l->count; i++) {
        VkRect2D *r = &out->rect[out->count++];
        span(l->x0[i], l->x1[i], level ? 4 : 0, level, 4, t->layered.width, &r->offset.x, &r->extent.width);
        span(l->y0[i], l->y1[i], 0, 0, 2, t->layered.height, &r->offset.y, &r->extent.height);
    }
    d->rects = out->rect;
    d->n_rects = out->count;
    return true;
}

// Pixels that light has travelled to E of a level: less than 4 cells of each level on the way.
static double reach_of_level(unsigned level) { return level ? ldexp(4, (int)level) : 0; }

/* ---- the bright pass --------------------------------------------------------------------------------- */

static void planes_of(const struct slot_target *t, struct vk_draw *d)
{
    for (unsigned c = 0; c < VK_PLANES; c++)
        d->in[c] = (struct vk_image *)&t->in[c < t->geometry.channels ? c : 0];
}

static const char *stored(const struct frame *fr) { return fr->half ? "_s16" : ""; }
static const char *type_of(const struct slot_target *t) { return t->geometry.type == PIXEL_TYPE_HALF ? "_half" : ""; }

// Step 4, and with an order the first halving across.
static int record_plain(struct frame *fr, unsigned order)
{
    struct targets *t = &fr->b->targets;
    const struct params *p = fr->params;
    struct vk_draw d = { .dst = &t->layered };
    const struct frame_scan *s = fr->scan;
    // A wall's shares are scanned by themselves: one variant for all of them.
    const bool clean = !fr->wall && !s->nan && !s->positive_inf && !s->negative_inf;
    const int32_t features = p->bright | (clean ? 8 : 0) | (fr->wall || s->negative ? 0 : 16);
    d.pipeline = pipeline_get(fr->b, fr->f, features, "bright_o%u_c%u%s%s", order, t->shape.channels,
                              type_of(fr->source), stored(fr));
    if (!d.pipeline)
        return -1;
    struct pass_uniforms *u = pass_begin(fr, &d);
    bright_curve(fr, u->bright);
    u->weight[3] = (float)fr->scale;
    planes_of(fr->source, &d);
    d.area = area_of(t->layered.width, t->layered.height);
    struct rects rects;
    lit_layered(fr, order ? 1 : 0, &d, &rects);
    vk_draw(&fr->b->commands, &d);
    return 0;
}

// Steps 1 to 4 with all that may be asked for.
struct extract {
    bool firefly, clamp, fill;
};

static int record_extract(struct frame *fr, struct extract x)
{
    struct targets *t = &fr->b->targets;
    const struct params *p = fr->params;
    struct vk_draw d = { .dst = &t->layered };
    int32_t features = p->bright;
    features |= x.firefly && p->firefly > 0 ? 8 : 0;
    features |= x.clamp && p->clamp > 0 ? 16 : 0;
    features |= fr->matte ? 32 | (fr->matte->geometry.type == PIXEL_TYPE_HALF ? 64 : 0) : 0;
    features |= x.fill && fr->pad ? 128 : 0;
    d.pipeline = pipeline_get(fr->b, fr->f, features, "extract_c%u%s", t->shape.channels, type_of(fr->source));
    if (!d.pipeline)
        return -1;
    struct pass_uniforms *u = pass_begin(fr, &d);
    bright_curve(fr, u->bright);
    planes_of(fr->source, &d);
    d.matte = fr->matte ? &fr->matte->in[0] : &fr->source->in[0];
    d.area = area_of(t->layered.width, t->layered.height);
    vk_draw(&fr->b->commands, &d);
    return 0;
}

// What a level-0 read of the layered image must know: its groups are of 2 rows.
static void layered_source(const struct targets *t, struct pass_uniforms *u)
{
    u->src[0] = (int32_t)t->layered.width;
    u->src[1] = (int32_t)t->layered_groups;
}

static int record_down(struct frame *fr, unsigned octave, unsigned order)
{
    struct targets *t = &fr->b->targets;
    const char *kind = octave > 0 ? "" : t->shape.full_size ? "layered_" : "vertical_";
    struct vk_draw d = { .src = octave ? &t->e[octave] : &t->layered, .dst = &t->e[octave + 1] };
    d.pipeline = pipeline_get(fr->b, fr->f, 0, "down_%so%u%s", kind, order, stored(fr));
    if (!d.pipeline)
        return -1;
    struct pass_uniforms *u = pass_begin(fr, &d);
    if (octave)
        source(u, &t->level[octave]);
    else
        layered_source(t, u);
    level_area(fr, &t->level[octave + 1], &d, u);
    struct rects rects;
    const double reach = reach_of_level(octave + 1);
    if (octave < LIT_OCTAVES)
        lit_rects(fr, octave + 1, reach, reach, &t->level[octave + 1], &d, &rects);
    vk_draw(&fr->b->commands, &d);
    return 0;
}

static int record_levels(struct frame *fr)
{
    const struct plan *p = fr->b->plan;
    for (unsigned i = 0; i < fr->b->targets.shape.octaves; i++)
        if (record_down(fr, i, i < p->levels ? p->order[i] : 4) < 0)
            return -1;
    return 0;
}

int record_bright(struct frame *fr)
{
    const unsigned order = fr->b->targets.shape.full_size ? 0 : fr->b->plan->order[0];
    const struct extract all = { true, true, true };
    if ((fr->rich ? record_extract(fr, all) : record_plain(fr, order)) < 0)
        return -1;
    return record_levels(fr);
}

static int record_total(struct frame *fr, struct extract x, unsigned total)
{
    struct bloom *b = fr->b;
    if (record_extract(fr, x) < 0 || record_levels(fr) < 0)
        return -1;
    return ledger_record_total(&b->commands, &b->ledger, &b->targets, total, fr->f);
}

int record_totals(struct frame *fr)
{
    const struct params *p = fr->params;
    if (p->firefly > 0 && record_total(fr, (struct extract){ 0 }, TOTAL_RAW) < 0)
        return -1;
    if (p->clamp > 0 && record_total(fr, (struct extract){ .firefly = true }, TOTAL_UNCLAMPED) < 0)
        return -1;
    return fr->pad ? record_total(fr, (struct extract){ .firefly = true, .clamp = true }, TOTAL_BRIGHT) : 0;
}

static unsigned reach_of(const struct psf_taps *taps)
{
    static const unsigned reaches[] = { 1, 2, 3, 4, 6, 10 };
    unsigned i = 0;
    while (4 * reaches[i] < taps->half)
        i++;
    return reaches[i];
}

static void set_taps(struct pass_uniforms *u, const struct psf_taps *taps)
{
    for (unsigned k = 0; k <= taps->half; k++)
        u->tap[k] = (float)taps->tap[k];
}

static int record_gaussian(struct frame *fr, const struct plan_gaussian *k, struct round *r)
{
    struct targets *t = &fr->b->targets;
    const struct level *v = &t->level[k->level];
    struct vk_draw h = { .src = k->level ? &t->e[k->level] : &t->layered, .dst = r->rows };
    h.pipeline = pipeline_get(fr->b, fr->f, 0, "blur_h_%sr%u%s", k->level ? "" : "layered_", reach_of(&k->x), stored(fr));
    struct vk_draw w = { .src = r->rows, .add = r->any ? r->sum : NULL, .dst = r->next };
    w.pipeline = h.pipeline ? pipeline_get(fr->b, fr->f, 0, "blur_v_%sr%u%s", r->any ? "add_" : "", reach_of(&k->y),
                                          stored(fr))
                            : NULL;
    if (!w.pipeline)
        return -1;
    struct pass_uniforms *u = pass_begin(fr, &h);
    if (k->level)
        source(u, v);
    else
        layered_source(t, u);
    level_area(fr, v, &h, u);
    set_taps(u, &k->x);
    struct rects rects;
    const double reach = reach_of_level(k->level);
    if (k->level <= LIT_OCTAVES)
        lit_rects(fr, k->level, reach + ldexp(k->x.half, (int)k->level), reach, v, &h, &rects);
    vk_draw(&fr->b->commands, &h);

    u = pass_begin(fr, &w);
    source(u, v);
    added(u, v);
    level_area(fr, v, &w, u);
    set_taps(u, &k->y);
    for (unsigned c = 0; c < 3; c++)
        u->weight[c] = (float)k->weight[c];
    vk_draw(&fr->b->commands, &w);
    struct vk_image *free_now = r->sum;
    r->sum = r->next;
    r->next = free_now;
    r->any = true;
    return 0;
}

static int record_up(struct frame *fr, unsigned octave, struct round *r)
{
    struct targets *t = &fr->b->targets;
    struct vk_draw d = { .add = r->sum, .dst = r->next };
    d.pipeline = pipeline_get(fr->b, fr->f, 0, "up_o%u%s", fr->b->plan->order[octave], stored(fr));
    if (!d.pipeline)
        return -1;
    struct pass_uniforms *u = pass_begin(fr, &d);
    added(u, &t->level[octave + 1]);
    level_area(fr, &t->level[octave], &d, u);
    vk_draw(&fr->b->commands, &d);
    struct vk_image *free_now = r->sum;
    r->sum = r->next;
    r->next = free_now;
    return 0;
}

// Steps 5 and 6: the Gaussians of each level, coarsest first, each sum doubled into the next finer level.
int record_spread(struct frame *fr, int only, struct round *r)
{
    const struct plan *p = fr->b->plan;
    struct targets *t = &fr->b->targets;
    const unsigned finest = t->shape.finest;
    *r = (struct round){ .sum = &t->pool[0], .rows = &t->pool[1], .next = &t->pool[2] };
    unsigned g = p->count;
    for (unsigned level = p->levels;; level--) {
        for (; g > 0 && p->gaussian[g - 1].level == level; g--)
            if (!(fr->skip >> (g - 1) & 1) && (only < 0 || p->gaussian[g - 1].index == (unsigned)only) &&
                record_gaussian(fr, &p->gaussian[g - 1], r) < 0)
                return -1;
        if (level == finest)
            return 0;
        if (r->any && record_up(fr, level - 1, r) < 0)
            return -1;
    }
}

/* ---- pictures ------------------------------------------------------------------------------------ */

static bool has_dirt(const struct frame *fr) { return fr->request->dirt && fr->params->dirt_gain > 0; }

static int32_t develop_features(const struct frame *fr, const struct view_spec *view, bool glow)
{
    const struct params *p = fr->params;
    const bool final = view->view == VIEW_FINAL;
    int32_t features = (int32_t)view->view;
    if (final)
        features |= p->composite << 3 | p->display << 5 | p->encoding << 7 | (p->saturation != 1) << 9 | params_display(p) << 15;
    features |= fr->matte ? 1024 | (fr->matte->geometry.type == PIXEL_TYPE_HALF ? 2048 : 0) : 0;
    features |= glow && has_dirt(fr) ? 4096 : 0;
    features |= glow ? 8192 : 0;
    const bool e = view->view == VIEW_BRIGHT || view->view == VIEW_RESIDUAL || (final && p->composite == COMPOSITE_MIX);
    return features | (e && fr->keeps_e && p->bloom == SWITCH_ON ? 16384 : 0);
}

// Of a final picture, whether the plain composite makes it.
bool is_plain_picture(const struct frame *fr, const struct view_spec *view)
{
    const struct params *p = fr->params;
    return view->view == VIEW_FINAL && !params_display(p) && p->composite != COMPOSITE_MIX && !fr->matte && !has_dirt(fr);
}

static void set_dirt(const struct frame *fr, struct pass_uniforms *u)
{
    const struct bloom_image *m = fr->request->dirt;
    if (!m)
        return;
    u->dirt[0] = (float)fr->params->dirt_gain;
    u->dirt[1] = (float)((double)m->width / fr->target->width);
    u->dirt[2] = (float)((double)m->height / fr->target->height);
    // The shader reads .yz.
    u->mode[2] = (int32_t)m->width;
    u->mode[3] = (int32_t)m->height;
}

// What the composite need not ask of each pixel, for the scan has asked it: bits of composite.frag's KNOWN.
static int32_t known(const struct frame *fr)
{
    const struct frame_scan *s = fr->request->scan;
    const double largest = fr->target->geometry.type == PIXEL_TYPE_HALF ? 65504 : (double)FLT_MAX;
    // Negative samples only bring a sum down; how far below 0 they go the scan does not tell.
    const bool in_range = s->negative == 0 && frame_scan_max_channel(s) + fr->most_glow <= largest * (1 - 0x1p-20);
    return (s->nan || s->positive_inf || s->negative_inf ? 0 : 1) | (in_range ? 2 : 0);
}

// Steps 7 to 9.
int record_output(struct frame *fr, unsigned output, const struct view_spec *view, struct vk_image *sum)
{
    struct bloom *b = fr->b;
    struct slot_target *t = fr->target;
    struct targets *pyramid = &b->targets;
    const bool plain = sum && is_plain_picture(fr, view);
    const unsigned order = sum && pyramid->shape.finest ? b->plan->order[0] : 0;
    struct vk_draw d = { .add = sum ? sum : &pyramid->pool[0] };
    if (plain)
        d.pipeline = pipeline_get(b, fr->f, known(fr), "composite_o%u%s%s", order, type_of(t), stored(fr));
    else
        d.pipeline = pipeline_get(b, fr->f, develop_features(fr, view, sum != NULL), "develop_o%u_c%u%s", order,
                                  t->geometry.channels, type_of(t));
    if (!d.pipeline)
        return -1;
    struct pass_uniforms *u = pass_begin(fr, &d);
    u->frame[2] = (int32_t)t->groups;
    u->weight[3] = (float)(fr->params->intensity / fr->scale);
    added(u, &pyramid->level[pyramid->shape.finest]);
    planes_of(t, &d);
    d.bands = t->geometry.channels;
    if (!plain) {
        d.matte = fr->matte ? &fr->matte->in[0] : &t->in[0];
        set_dirt(fr, u);
        d.dirt = has_dirt(fr) ? &b->dirt : &b->blank;
        d.src = &pyramid->layered;
        // Saturation looks at all channels of a pixel.
        d.all_planes = view->view == VIEW_FINAL && fr->params->saturation != 1;
    }
    for (unsigned i = 0; i < LEVEL_PHASES; i++)
        d.dst_each[i] = &t->out[output][i];
    d.area = area_of(t->texels, t->groups * t->geometry.channels);
    vk_draw(&b->commands, &d);
    return 0;
}

/* ---- begin and end --------------------------------------------------------------------------------- */

static void stage_image(struct vk_commands *c, const struct bloom_slot *s, struct vk_image *m, VkDeviceSize offset, bool up)
{
    vk_use(c, m, VK_PIPELINE_STAGE_2_COPY_BIT, up ? VK_ACCESS_2_TRANSFER_WRITE_BIT : VK_ACCESS_2_TRANSFER_READ_BIT, up);
    vk_flush_barriers(c);
    const VkBufferImageCopy copy = {
        .bufferOffset = offset,
        .imageSubresource = { VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1 },
        .imageExtent = { m->width, m->height, 1 },
    };
    if (up)
        vkCmdCopyBufferToImage(c->buffer, s->staging.buffer, m->image, VK_IMAGE_LAYOUT_GENERAL, 1, &copy);
    else
        vkCmdCopyImageToBuffer(c->buffer, m->image, VK_IMAGE_LAYOUT_GENERAL, s->staging.buffer, 1, &copy);
}

void slot_copy(struct bloom *b, struct bloom_slot *s, struct slot_target *t, bool up)
{
    if (!b->staged)
        return;
    const VkDeviceSize plane = (VkDeviceSize)t->texels * 16 * t->height;
    const VkDeviceSize phase = (VkDeviceSize)t->texels * 16 * t->groups * t->geometry.channels;
    for (unsigned i = 0; up && i < t->geometry.channels; i++)
        stage_image(&b->commands, s, &t->in[i], t->staging_in + i * plane, true);
    for (unsigned o = 0; !up && o < t->geometry.outputs; o++)
        for (unsigned i = 0; i < LEVEL_PHASES; i++)
            stage_image(&b->commands, s, &t->out[o][i], t->staging_out + (o * LEVEL_PHASES + i) * phase, false);
}

int record_begin(struct frame *fr)
{
    struct bloom *b = fr->b;
    if (vk_begin(&b->commands, fr->f) < 0)
        return -1;
    b->passes = 0;
    b->recordings++;
    slot_copy(b, fr->slot, fr->target, true);
    if (fr->source != fr->target)
        slot_copy(b, fr->slot, fr->source, true);
    if (fr->matte)
        slot_copy(b, fr->slot, fr->matte, true);
    return 0;
}

int record_end(struct frame *fr)
{
    struct bloom *b = fr->b;
    slot_copy(b, fr->slot, fr->target, false);
    vk_to_host(&b->commands);
    return vk_submit_and_wait(&b->commands, fr->f);
}

/* ---- dirt ------------------------------------------------------------------------------------------- */

int dirt_upload(struct frame *fr, const struct bloom_image *image)
{
    struct bloom *b = fr->b;
    if (!strcmp(b->dirt_digest, image->digest))
        return 0;
    const uint32_t most = b->vk.properties.limits.maxImageDimension2D;
    if (image->width > most || image->height > most)
        return fault_set(fr->f, FAULT_LIMIT, "params.dirt", "an image of %u x %u: the device takes up to %u x %u",
                         image->width, image->height, most, most);
    b->dirt_digest[0] = '\0';
    vk_image_destroy(&b->vk, &b->dirt);
    const size_t pixels = (size_t)image->width * image->height;
    if (vk_image_create(&b->vk, &b->dirt, VK_FORMAT_R32G32B32A32_SFLOAT, image->width, image->height, 1, false, fr->f) < 0 ||
        vk_memory_reserve(&b->vk, &b->dirt_memory, b->dirt.needs.size, b->dirt.needs.memoryTypeBits, VK_PLACE_DEVICE,
                          fr->f) < 0 ||
        vk_image_bind(&b->vk, &b->dirt, &b->dirt_memory, 0, fr->f) < 0 ||
        vk_buffer_reserve(&b->vk, &b->exchange, pixels * 16, EXCHANGE_USAGE, fr->f) < 0)
        return -1;
    float *to = (float *)(void *)b->exchange.memory.map;
    for (size_t i = 0; i < pixels; i++) {
        memcpy(to + 4 * i, image->rgb + 3 * i, 3 * sizeof(float));
        to[4 * i + 3] = 0;
    }
    vk_use(&b->commands, &b->dirt, VK_PIPELINE_STAGE_2_COPY_BIT, VK_ACCESS_2_TRANSFER_WRITE_BIT, true);
    vk_flush_barriers(&b->commands);
    const VkBufferImageCopy copy = {
        .imageSubresource = { VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1 },
        .imageExtent = { image->width, image->height, 1 },
    };
    vkCmdCopyBufferToImage(b->commands.buffer, b->exchange.buffer, b->dirt.image, VK_IMAGE_LAYOUT_GENERAL, 1, &copy);
    // Once an image: fft_spread may make the exchange buffer anew, or write it, in the same frame.
    return vk_submit_and_wait(&b->commands, fr->f) < 0 ? -1 : vk_begin(&b->commands, fr->f);
}
