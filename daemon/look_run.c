// SPDX-License-Identifier: Apache-2.0
// look_run.c - runs a look's list: prepare, record each stage, store each output, account.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "look_internal.h"

struct run {
    struct bloom *b;
    struct bloom_slot *slot;
    struct slot_target *target;
    const struct bloom_request *request;
    double exposure;
    double scale; /* of the sums of light: none of them overflows */
    bool black;   /* E is 0 everywhere: no stage is drawn */
    unsigned draws;
    struct fault *f;
};

/* ---- recording ------------------------------------------------------------------------------------- */

static struct stage_uniforms *begin_draw(struct run *r, struct vk_draw *d, const char *name)
{
    struct look_targets *t = r->b->look;
    const struct bloom_geometry *g = &r->target->geometry;
    assert(r->draws < LOOK_DRAWS_MAX);
    r->b->pass_name[r->draws] = name;
    d->uniforms = t->uniforms.buffer;
    d->uniforms_offset = (VkDeviceSize)r->draws++ * UNIFORM_STRIDE;
    d->uniforms_bytes = sizeof(struct stage_uniforms);
    struct stage_uniforms *u = (struct stage_uniforms *)(void *)(t->uniforms.memory.map + d->uniforms_offset);
    memset(u, 0, sizeof(*u));
    memcpy(u->bright, t->list.numbers, sizeof(u->bright));
    for (unsigned c = 0; c < 3; c++)
        u->luma[c] = g->channels == 1 ? c == 0 : r->request->luma[c];
    u->luma[3] = (float)r->request->params->saturation;
    return u;
}

static void image_size(int32_t out[4], const struct vk_image *m)
{
    out[0] = (int32_t)m->width;
    out[1] = (int32_t)m->height;
}

static void read_planes(struct vk_draw *d, struct slot_target *t)
{
    for (unsigned c = 0; c < VK_PLANES; c++)
        d->in[c] = &t->in[c < t->geometry.channels ? c : 0];
}

static bool same_size(const struct vk_image *a, const struct vk_image *b)
{
    return a->width == b->width && a->height == b->height;
}

static struct slot_target *planes_of(const struct run *r, const struct look_stage *s)
{
    return s->kind == LOOK_LOAD_MATTE          ? &r->slot->target[r->request->matte]
           : r->request->source >= 0           ? &r->slot->target[r->request->source]
                                               : r->target;
}

static const char *stage_name(const struct run *r, const struct look_stage *s)
{
    const bool half = planes_of(r, s)->geometry.type == PIXEL_TYPE_HALF;
    switch (s->kind) {
    case LOOK_LOAD_MATTE: return half ? "load_half" : "load";
    case LOOK_LOAD: return s->src >= 0 ? half ? "load_half_matte" : "load_matte" : half ? "load_half" : "load";
    case LOOK_LOAD_HALF: return half ? "halve_half" : "halve";
    case LOOK_LOAD_ROWS: return half ? "load_rows_half" : "load_rows";
    case LOOK_SAMPLE: return s->add >= 0 ? "sample_add" : "sample";
    case LOOK_ROWS: return "rows";
    case LOOK_MIX: return "mix";
    case LOOK_SUM: return s->src >= 0 ? "sum_pixels" : "sum";
    }
    return NULL;
}

static void set_taps(const struct run *r, const struct look_stage *s, struct stage_uniforms *u)
{
    const struct look_list *l = &r->b->look->list;
    for (unsigned i = 0; i < s->taps; i++) {
        u->tap[i][0] = (float)s->tap[i].dx;
        u->tap[i][1] = (float)s->tap[i].dy;
        u->tap[i][2] = (float)s->tap[i].weight;
    }
    for (unsigned i = 1; s->kind == LOOK_MIX && i < s->taps; i++) {
        u->tap[i][0] = (float)l->mips.section[i - 1].first;
        u->tap[i][1] = (float)l->mips.section[i - 1].height;
    }
}

static void set_numbers(const struct run *r, const struct look_stage *s, struct stage_uniforms *u)
{
    const struct params *p = r->request->params;
    const struct bloom_geometry *g = &r->target->geometry;
    const float *sun = r->b->look->list.sun;
    memcpy(u->weight, s->weight, sizeof(s->weight));
    // With the bloom off there is no light to glow.
    if (s->kind == LOOK_LOAD || s->kind == LOOK_LOAD_HALF || s->kind == LOOK_LOAD_ROWS)
        u->weight[0] *= p->bloom == SWITCH_OFF ? 0 : 1;
    u->weight[3] = (float)p->emission;
    if (s->kind == LOOK_SUM) {
        const uint32_t texels = s->src >= 0 ? (uint32_t)u->src[0] : (g->width + 3) / 4, columns = (uint32_t)u->dst[0];
        u->weight[0] = (float)r->scale;
        u->src[2] = (int32_t)((texels + columns - 1) / columns);
    }
    // These work at the frame's size, whatever the texels of their image.
    if (s->kind == LOOK_ROWS || s->kind == LOOK_MIX || s->kind == LOOK_SUM) {
        u->dst[0] = (int32_t)g->width;
        u->dst[1] = (int32_t)g->height;
    }
    u->dst[2] = (int32_t)s->first;
    memcpy(u->numbers, sun, sizeof(u->numbers));
    memcpy(u->more, sun + 4, sizeof(u->more));
    set_taps(r, s, u);
}

static void stage_spec(const struct run *r, const struct look_stage *s, const struct vk_draw *d, int32_t spec[4])
{
    const bool loads = s->kind == LOOK_LOAD_MATTE || s->kind == LOOK_LOAD || s->kind == LOOK_LOAD_HALF || s->kind == LOOK_LOAD_ROWS;
    spec[0] = s->curve ? (int32_t)r->b->look->list.curve : 0;
    spec[1] = s->kind == LOOK_ROWS ? d->src->width == r->target->geometry.width : s->kind == LOOK_SAMPLE && same_size(d->src, d->dst);
    spec[2] = s->kind == LOOK_SAMPLE ? d->add && same_size(d->add, d->dst) : s->after;
    spec[3] = loads ? (s->kind == LOOK_LOAD_MATTE ? 1 : (int32_t)r->target->geometry.channels) : s->taps ? (int32_t)s->taps : 1;
}

static VkRect2D stage_area(const struct run *r, const struct look_stage *s)
{
    const struct vk_image *dst = &r->b->look->image[s->dst];
    const uint32_t height = s->kind == LOOK_ROWS ? r->b->look->image[s->src].height : dst->height;
    return (VkRect2D){ { 0, (int32_t)s->first }, { dst->width, height } };
}

static int record_stage(struct run *r, const struct look_stage *s)
{
    struct look_targets *t = r->b->look;
    struct vk_image *dst = &t->image[s->dst];
    struct vk_draw d = { .src = s->src >= 0 ? &t->image[s->src] : NULL, .add = s->add >= 0 ? &t->image[s->add] : NULL,
                         .dst = dst };
    const char *name = stage_name(r, s);
    int32_t spec[4];
    if (s->kind <= LOOK_LOAD_ROWS)
        read_planes(&d, planes_of(r, s));
    stage_spec(r, s, &d, spec);
    d.pipeline = look_pipeline(r->b, name, VK_FORMAT_R32G32B32A32_SFLOAT, dst->layers, spec, r->f);
    if (!d.pipeline)
        return -1;
    struct stage_uniforms *u = begin_draw(r, &d, name);
    if (d.src)
        image_size(u->src, d.src);
    if (d.add)
        image_size(u->add, d.add);
    image_size(u->dst, dst);
    set_numbers(r, s, u);
    d.area = stage_area(r, s);
    vk_draw(&r->b->commands, &d);
    return 0;
}

static int record_store(struct run *r, unsigned output, enum view view)
{
    struct look_targets *t = r->b->look;
    const struct params *p = r->request->params;
    struct slot_target *slot = r->target;
    const struct bloom_geometry *g = &slot->geometry;
    const bool show = view == VIEW_FINAL && params_display(p), matte = t->list.matte >= 0;
    const bool all = show && p->saturation != 1 && g->channels == 3;
    char name[40];
    snprintf(name, sizeof(name), "store%s%s%s", g->type == PIXEL_TYPE_HALF ? "_half" : "", all ? "_all" : "",
             matte ? "_matte" : "");
    const struct look_rows *rows = view == VIEW_BRIGHT ? &t->list.bright : &t->list.glow;
    struct vk_draw d = { .src = matte ? &t->image[t->list.matte] : NULL, .add = &t->image[rows->image] };
    const bool glows = !r->black && view != VIEW_SOURCE;
    const int32_t spec[4] = { rows->section[0].height == g->height, show, glows ? (int32_t)rows->sections : 0,
                              view > VIEW_SOURCE ? VIEW_BRIGHT : (int32_t)view }; // bright and bloom are both what `add` holds
    d.pipeline = look_pipeline(r->b, name, VK_FORMAT_R32G32B32A32_UINT, LEVEL_PHASES, spec, r->f);
    if (!d.pipeline)
        return -1;
    struct stage_uniforms *u = begin_draw(r, &d, "store");
    image_size(u->add, d.add);
    const int32_t dst[4] = { (int32_t)g->width, (int32_t)g->height, (int32_t)slot->groups, (int32_t)g->channels };
    memcpy(u->dst, dst, sizeof(dst));
    const int32_t mode[4] = { p->nonfinite, 0, p->display, p->encoding };
    memcpy(u->mode, mode, sizeof(mode));
    u->weight[0] = view == VIEW_BRIGHT ? 1 : (float)p->intensity;
    u->weight[3] = (float)p->emission;
    u->numbers[0] = (float)exp2(r->exposure);
    u->numbers[1] = p->look == LOOK_AIRY_EIGHT;
    for (unsigned i = 0; i < rows->sections; i++) {
        u->tap[i][0] = (float)rows->section[i].first;
        u->tap[i][1] = (float)rows->section[i].height;
    }
    read_planes(&d, slot);
    for (unsigned i = 0; i < LEVEL_PHASES; i++)
        d.dst_each[i] = slot_output(slot, output, i);
    d.area = (VkRect2D){ { 0, 0 }, { slot->texels, slot->groups * g->channels } };
    d.bands = all ? 1 : g->channels;
    vk_draw(&r->b->commands, &d);
    return 0;
}

static enum view output_view(const struct params *p, unsigned output)
{
    return output ? p->layer[output - 1].view : p->view_spec.view;
}

static int record(struct run *r)
{
    const struct params *p = r->request->params;
    const struct look_list *l = &r->b->look->list;
    if (vk_begin(&r->b->commands, r->f) < 0)
        return -1;
    slot_copy(r->b, r->slot, r->target, true);
    if (r->request->source >= 0)
        slot_copy(r->b, r->slot, &r->slot->target[r->request->source], true);
    if (r->request->matte >= 0)
        slot_copy(r->b, r->slot, &r->slot->target[r->request->matte], true);
    for (unsigned i = 0; i < l->stages; i++)
        if ((!r->black || l->stage[i].kind == LOOK_LOAD_MATTE) && record_stage(r, &l->stage[i]) < 0)
            return -1;
    if (!r->black && look_energy_record(r->b, r->f) < 0)
        return -1;
    for (unsigned i = 0; i < slot_outputs(r->target); i++)
        if (record_store(r, i, output_view(p, i)) < 0)
            return -1;
    slot_copy(r->b, r->slot, r->target, false);
    vk_to_host(&r->b->commands);
    return 0;
}

/* ---- what is asked ----------------------------------------------------------------------------------- */

static bool wants(const struct run *r, enum view view)
{
    for (unsigned i = 0; i < slot_outputs(r->target); i++)
        if (output_view(r->request->params, i) == view)
            return true;
    return false;
}

static int check(const struct run *r)
{
    const struct params *p = r->request->params;
    const struct bloom_geometry *g = &r->target->geometry;
    for (unsigned i = 0; i < slot_outputs(r->target); i++) {
        char name[32];
        if (output_view(p, i) <= VIEW_BLOOM)
            continue;
        params_view_name(i ? &p->layer[i - 1] : &p->view_spec, name);
        return fault_set(r->f, FAULT_PARAM_CONFLICT, i ? "params.layers" : "params.view",
                         "view %s with look %s: final, source, bright or bloom expected", name, look_name(p->look));
    }
    if (g->grow)
        return fault_set(r->f, FAULT_PARAM_CONFLICT, "params.grow", "%u pixels with look %s: 0 expected, for a look's edges "
                         "are clamped", g->grow, look_name(p->look));
    return 0;
}

static double most_light(const struct run *r)
{
    const struct frame_scan *scan = r->request->source >= 0 ? r->request->source_scan : r->request->scan;
    return r->b->look->list.curve == BRIGHT_CHANNEL ? frame_scan_max_channel(scan) : frame_scan_max_luma(scan);
}

// E is 0: every curve is at or below its foot, and no sample exceeds the largest of the frame.
static bool black(const struct run *r)
{
    const struct params *p = r->request->params;
    if (p->bloom == SWITCH_OFF)
        return true;
    if (p->look == LOOK_MIP_CHAIN && p->sun_spec.given && p->sun_spec.gain > 0)
        return false;
    const double most = most_light(r);
    return most == 0 || (r->request->matte < 0 && most <= r->b->look->list.foot);
}

static bool untouched(const struct run *r)
{
    const struct params *p = r->request->params;
    const struct frame_scan *s = r->request->scan;
    const bool bad = s->nan || s->positive_inf || s->negative_inf;
    if ((p->nonfinite == NONFINITE_ZERO && bad) || slot_outputs(r->target) > 1 || (r->request->matte >= 0 && p->emission != 1))
        return false;
    if (p->view_spec.view == VIEW_SOURCE)
        return true;
    return p->view_spec.view == VIEW_FINAL && !params_display(p) && (r->black || p->intensity == 0);
}

static void make_list(struct run *r)
{
    const struct bloom_request *q = r->request;
    const struct bloom_geometry *g = &r->target->geometry;
    const struct look_facts facts = {
        .params = q->params,
        .width = g->width,
        .height = g->height,
        .channels = g->channels,
        .exposure = r->exposure,
        .pixel_aspect = q->pixel_aspect,
        .display_width = q->display_width,
        .matte = q->matte >= 0,
        .want_bright = wants(r, VIEW_BRIGHT),
        .sun_share = q->params->look == LOOK_MIP_CHAIN ? look_sun_share(r->b, r->slot, q) : 1,
    };
    look_list_make(&r->b->look->list, &facts);
}

int look_run(struct bloom *b, struct bloom_slot *s, unsigned target, const struct bloom_request *request,
             double exposure, struct bloom_reply *reply, struct fault *f)
{
    struct run r = { .b = b, .slot = s, .target = &s->target[target], .request = request, .exposure = exposure, .f = f };
    const struct params *p = request->params;
    if (check(&r) < 0 || look_targets_create(b, f) < 0)
        return -1;
    b->look->runs++;
    make_list(&r);
    r.black = black(&r);
    // Up to 2^16 pixels of 1e38 and a look's gain are added in floats.
    r.scale = most_light(&r) > 1e20 ? 0x1p-40 : 1;
    if (untouched(&r)) {
        reply->untouched = true;
        snprintf(reply->plan, sizeof(reply->plan), "untouched: look %s adds nothing to this frame", look_name(p->look));
        snprintf(reply->rule, sizeof(reply->rule), "-");
        return 0;
    }
    const double start = bloom_now_ms();
    if (look_targets_prepare(b, f) < 0 || record(&r) < 0 || vk_submit_and_wait(&b->commands, f) < 0)
        return -1;
    reply->device_ms = bloom_now_ms() - start;
    look_print(p, r.target->geometry.width, r.target->geometry.height, reply->plan, sizeof(reply->plan));
    snprintf(reply->rule, sizeof(reply->rule), "%.7s", look_name(p->look));
    snprintf(reply->storage, sizeof(reply->storage), "float");
    reply->levels = b->look->list.images;
    reply->error_bound = b->look->list.error_bound;
    if (!r.black) {
        double glow = 0;
        look_energy(b, r.target->geometry.height, r.scale, &reply->energy_bright, &glow);
        reply->energy_bloomed = p->intensity * glow;
    }
    return 0;
}
