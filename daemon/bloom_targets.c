// SPDX-License-Identifier: Apache-2.0
// bloom_targets.c - the images: a slot's input and output planes, and the pyramid that all slots share.
// Memory only grows; images are made anew in it when the shape changes, which costs microseconds.
#include <string.h>

#include "bloom_internal.h"

enum { PLACES_MAX = BLOOM_TARGETS_MAX * (VK_PLANES + LEVEL_PHASES) };

static VkDeviceSize align_up(VkDeviceSize n, VkDeviceSize a) { return (n + a - 1) / a * a; }

static int too_large(struct fault *f, const struct vk *v, uint32_t width, uint32_t height)
{
    return fault_set(f, FAULT_LIMIT, "input", "%u x %u pixels: the device takes images up to %u x %u", width,
                     height, v->properties.limits.maxImageDimension2D,
                     v->properties.limits.maxImageDimension2D);
}

/* ---- pyramid ------------------------------------------------------------------------------------- */

void targets_destroy(struct vk *v, struct targets *t)
{
    vk_image_destroy(v, &t->layered);
    for (unsigned i = 0; i <= PSF_LEVELS_MAX; i++)
        vk_image_destroy(v, &t->e[i]);
    for (unsigned i = 0; i < 3; i++)
        vk_image_destroy(v, &t->pool[i]);
    t->made = false;
}

// Images to be placed one after the other, block after block.
struct placing {
    struct vk_image *image[PLACES_MAX];
    unsigned char block[PLACES_MAX];
    VkDeviceSize offset[PLACES_MAX];
    unsigned count, last;
    VkDeviceSize size[VK_BLOCKS_MAX];
    uint32_t types;
};

static int place(struct vk *v, struct placing *p, struct vk_image *m, VkFormat format, uint32_t width,
                 uint32_t height, uint32_t layers, bool linear, struct fault *f)
{
    const uint32_t most = v->properties.limits.maxImageDimension2D;
    if (width > most || height > most)
        return too_large(f, v, width, height);
    if (vk_image_create(v, m, format, width, height, layers, linear, f) < 0)
        return -1;
    VkDeviceSize at = align_up(p->size[p->last], m->needs.alignment);
    if (at + m->needs.size > v->block_max && p->last + 1 < VK_BLOCKS_MAX) {
        p->last++;
        at = 0;
    }
    assert(p->count < PLACES_MAX);
    p->offset[p->count] = at;
    p->block[p->count] = (unsigned char)p->last;
    p->image[p->count++] = m;
    p->size[p->last] = at + m->needs.size;
    p->types &= m->needs.memoryTypeBits;
    return 0;
}

static int bind_all(struct vk *v, struct placing *p, struct vk_arena *memory, enum vk_place where, struct fault *f)
{
    for (unsigned i = 0; i <= p->last; i++)
        if (p->size[i] && vk_memory_reserve(v, &memory->block[i], p->size[i], p->types, where, f) < 0)
            return -1;
    for (unsigned i = 0; i < p->count; i++)
        if (vk_image_bind(v, p->image[i], &memory->block[p->block[i]], p->offset[i], f) < 0)
            return -1;
    return 0;
}

static void set_levels(struct targets *t)
{
    uint32_t w = t->shape.width, h = t->shape.height;
    for (unsigned i = 0; i <= t->shape.octaves; i++) {
        t->level[i] = level_of(w, h);
        w = (w + 1) / 2;
        h = (h + 1) / 2;
    }
    t->layered_groups = (t->shape.height + 1) / 2 + LEVEL_MARGIN;
}

int targets_prepare(struct vk *v, struct targets *t, const struct targets_shape *shape, struct fault *f)
{
    if (t->made && !memcmp(&t->shape, shape, sizeof(*shape)))
        return 0;
    targets_destroy(v, t);
    t->shape = *shape;
    set_levels(t);
    const VkFormat format = VK_FORMAT_R32G32B32A32_SFLOAT;
    struct placing p = { .types = ~0u };
    const struct level *wide = &t->level[shape->full_size ? 0 : 1];
    if (place(v, &p, &t->layered, format, wide->texels, t->layered_groups, 2 * shape->channels, false, f) < 0)
        goto fail;
    for (unsigned i = 1; i <= shape->octaves; i++)
        if (place(v, &p, &t->e[i], format, t->level[i].texels, t->level[i].groups * shape->channels,
                  LEVEL_PHASES, false, f) < 0)
            goto fail;
    const struct level *finest = &t->level[shape->finest];
    for (unsigned i = 0; i < 3; i++)
        if (place(v, &p, &t->pool[i], format, finest->texels, finest->groups * shape->channels,
                  LEVEL_PHASES, false, f) < 0)
            goto fail;
    if (bind_all(v, &p, &t->memory, VK_PLACE_DEVICE, f) < 0)
        goto fail;
    t->made = true;
    return 0;
fail:
    targets_destroy(v, t);
    return -1;
}

/* ---- slots --------------------------------------------------------------------------------------- */

static void slot_clear(struct vk *v, struct bloom_slot *s)
{
    for (unsigned i = 0; i < s->count; i++) {
        for (unsigned c = 0; c < VK_PLANES; c++)
            vk_image_destroy(v, &s->target[i].in[c]);
        for (unsigned p = 0; p < LEVEL_PHASES; p++)
            vk_image_destroy(v, &s->target[i].out[p]);
    }
    s->count = 0;
}

void slot_destroy(struct vk *v, struct bloom_slot *s)
{
    slot_clear(v, s);
    vk_arena_free(v, &s->memory);
    vk_buffer_free(v, &s->staging);
}

static bool same_geometry(const struct bloom_slot *s, unsigned count, const struct bloom_geometry *g)
{
    if (s->count != count)
        return false;
    for (unsigned i = 0; i < count; i++)
        if (!bloom_geometry_same(&s->target[i].geometry, &g[i]))
            return false;
    return true;
}

static void describe(const struct bloom *b, const struct bloom_slot *s, const struct slot_target *t,
                     struct planes *in, struct planes *out)
{
    const struct bloom_geometry *g = &t->geometry;
    const size_t tight = (size_t)t->texels * 16;
    *in = (struct planes){ .width = g->width, .height = g->height, .count = g->channels, .type = g->type,
                           .phases = 1 };
    *out = *in;
    out->phases = LEVEL_PHASES;
    if (b->staged) {
        in->pitch_bytes = out->pitch_bytes = tight;
        for (unsigned i = 0; i < LEVEL_PHASES; i++)
            out->phase_offset[i] = (ptrdiff_t)(i * tight * t->groups * g->channels);
        for (unsigned c = 0; c < g->channels; c++) {
            in->base[c] = s->staging.memory.map + t->staging_in + c * tight * g->height;
            out->base[c] = s->staging.memory.map + t->staging_out + c * tight * t->groups;
        }
        return;
    }
    in->pitch_bytes = t->in[0].row_pitch_bytes;
    out->pitch_bytes = t->out[0].row_pitch_bytes;
    for (unsigned i = 0; i < LEVEL_PHASES; i++)
        out->phase_offset[i] = (ptrdiff_t)((uintptr_t)t->out[i].host - (uintptr_t)t->out[0].host);
    for (unsigned c = 0; c < g->channels; c++) {
        in->base[c] = t->in[c].host;
        out->base[c] = t->out[0].host + c * out->pitch_bytes * t->groups;
    }
}

void slot_input(const struct bloom *b, const struct bloom_slot *s, unsigned target, struct planes *in)
{
    struct planes out;
    describe(b, s, &s->target[target], in, &out);
}

static int make_target(struct bloom *b, struct placing *p, struct slot_target *t,
                       const struct bloom_geometry *g, VkDeviceSize *staging, struct fault *f)
{
    const VkFormat format = VK_FORMAT_R32G32B32A32_UINT;
    const uint32_t wide = g->type == PIXEL_TYPE_HALF ? 8 : 4;
    *t = (struct slot_target){ .geometry = *g, .texels = (g->width + wide - 1) / wide,
                               .groups = (g->height + 3) / 4 };
    for (unsigned c = 0; c < g->channels; c++)
        if (place(&b->vk, p, &t->in[c], format, t->texels, g->height, 1, !b->staged, f) < 0)
            return -1;
    for (unsigned i = 0; i < LEVEL_PHASES; i++)
        if (place(&b->vk, p, &t->out[i], format, t->texels, t->groups * g->channels, 1, !b->staged, f) < 0)
            return -1;
    t->staging_in = *staging;
    *staging += (VkDeviceSize)t->texels * 16 * g->height * g->channels;
    t->staging_out = *staging;
    *staging += (VkDeviceSize)t->texels * 16 * t->groups * g->channels * LEVEL_PHASES;
    return 0;
}

int bloom_slot_prepare(struct bloom *b, struct bloom_slot *s, unsigned count,
                       const struct bloom_geometry *geometry, struct planes *in, struct planes *out,
                       struct fault *f)
{
    if (count > BLOOM_TARGETS_MAX)
        return fault_set(f, FAULT_LIMIT, "input", "%u layers to bloom in one request: at most %d expected",
                         count, BLOOM_TARGETS_MAX);
    if (!same_geometry(s, count, geometry)) {
        slot_clear(&b->vk, s);
        VkDeviceSize staging = 0;
        struct placing p = { .types = ~0u };
        int r = 0;
        for (unsigned i = 0; r == 0 && i < count; i++) {
            s->count = i + 1;
            r = make_target(b, &p, &s->target[i], &geometry[i], &staging, f);
        }
        if (r == 0)
            r = bind_all(&b->vk, &p, &s->memory, b->staged ? VK_PLACE_DEVICE : VK_PLACE_HOST, f);
        if (r == 0 && b->staged)
            r = vk_buffer_reserve(&b->vk, &s->staging, staging,
                                  VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT, f);
        if (r < 0) {
            slot_clear(&b->vk, s);
            return -1;
        }
    }
    for (unsigned i = 0; i < count; i++)
        describe(b, s, &s->target[i], &in[i], &out[(size_t)i * BLOOM_OUTPUTS_MAX]);
    return 0;
}
