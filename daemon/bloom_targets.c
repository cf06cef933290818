// SPDX-License-Identifier: Apache-2.0
// bloom_targets.c - the images: a slot's input and output planes, and the pyramid that all slots share.
// Memory only grows; images are made anew in it when the shape changes, which costs microseconds.
#include <string.h>

#include "bloom_internal.h"
#include "look.h"

enum { PLACES_MAX = BLOOM_TARGETS_MAX * (VK_PLANES + BLOOM_OUTPUTS_MAX * LEVEL_PHASES) };

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

bool targets_same(const struct targets *t, const struct targets_shape *s)
{
    const struct targets_shape *h = &t->shape;
    return t->made && h->width == s->width && h->height == s->height && h->channels == s->channels &&
           h->octaves == s->octaves && h->full_size == s->full_size && h->finest == s->finest && h->half == s->half;
}

int targets_prepare(struct vk *v, struct targets *t, const struct targets_shape *shape, struct fault *f)
{
    if (targets_same(t, shape))
        return 0;
    targets_destroy(v, t);
    t->shape = *shape;
    set_levels(t);
    const VkFormat format = shape->half ? VK_FORMAT_R16G16B16A16_SFLOAT : VK_FORMAT_R32G32B32A32_SFLOAT;
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
        for (unsigned o = 0; o < BLOOM_OUTPUTS_MAX; o++)
            for (unsigned p = 0; p < LEVEL_PHASES; p++)
                vk_image_destroy(v, &s->target[i].out[o][p]);
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

static VkDeviceSize plane_bytes(const struct slot_target *t) { return (VkDeviceSize)t->texels * 16 * t->height; }
static VkDeviceSize output_bytes(const struct slot_target *t)
{
    return (VkDeviceSize)t->texels * 16 * t->groups * t->geometry.channels * LEVEL_PHASES;
}

static void describe_output(const struct bloom *b, const struct bloom_slot *s, const struct slot_target *t, unsigned o,
                            struct planes *out)
{
    const struct bloom_geometry *g = &t->geometry;
    *out = (struct planes){ .width = t->width, .height = t->height, .count = g->channels, .type = g->type,
                            .phases = LEVEL_PHASES };
    uint8_t *base;
    if (b->staged) {
        out->pitch_bytes = (size_t)t->texels * 16;
        for (unsigned i = 0; i < LEVEL_PHASES; i++)
            out->phase_offset[i] = (ptrdiff_t)(i * out->pitch_bytes * t->groups * g->channels);
        base = s->staging.memory.map + t->staging_out + o * output_bytes(t);
    } else {
        out->pitch_bytes = t->out[o][0].row_pitch_bytes;
        for (unsigned i = 0; i < LEVEL_PHASES; i++)
            out->phase_offset[i] = (ptrdiff_t)((uintptr_t)t->out[o][i].host - (uintptr_t)t->out[o][0].host);
        base = t->out[o][0].host;
    }
    for (unsigned c = 0; c < g->channels; c++)
        out->base[c] = base + c * out->pitch_bytes * t->groups;
}

// The window's rows within the grown planes.
static void describe_input(const struct bloom *b, const struct bloom_slot *s, const struct slot_target *t, struct planes *in)
{
    const struct bloom_geometry *g = &t->geometry;
    *in = (struct planes){ .width = g->width, .height = g->height, .count = g->channels, .type = g->type, .phases = 1 };
    in->pitch_bytes = b->staged ? (size_t)t->texels * 16 : t->in[0].row_pitch_bytes;
    const size_t corner = g->grow * in->pitch_bytes + (size_t)g->grow * pixel_bytes(g->type);
    for (unsigned c = 0; c < g->channels; c++)
        in->base[c] = (b->staged ? s->staging.memory.map + t->staging_in + c * plane_bytes(t) : t->in[c].host) + corner;
}

// What lies around the window, and rows' ends, are 0 for as long as the slot keeps its geometry: nobody writes there.
static void clear_input(const struct bloom *b, const struct bloom_slot *s, const struct slot_target *t)
{
    struct planes in;
    describe_input(b, s, t, &in);
    const size_t corner = t->geometry.grow * in.pitch_bytes + (size_t)t->geometry.grow * pixel_bytes(in.type);
    for (unsigned c = 0; c < in.count; c++)
        memset(in.base[c] - corner, 0, in.pitch_bytes * t->height);
}

void slot_input(const struct bloom *b, const struct bloom_slot *s, unsigned target, struct planes *in)
{
    describe_input(b, s, &s->target[target], in);
}

static int make_target(struct bloom *b, struct placing *p, struct slot_target *t,
                       const struct bloom_geometry *g, VkDeviceSize *staging, struct fault *f)
{
    const VkFormat format = VK_FORMAT_R32G32B32A32_UINT;
    const uint32_t wide = g->type == PIXEL_TYPE_HALF ? 8 : 4, most = b->vk.properties.limits.maxImageDimension2D;
    if (g->width > most || g->height > most || g->grow > most)
        return too_large(f, &b->vk, g->width, g->height);
    *t = (struct slot_target){ .geometry = *g, .width = g->width + 2 * g->grow, .height = g->height + 2 * g->grow };
    t->texels = (t->width + wide - 1) / wide;
    t->groups = (t->height + 3) / 4;
    for (unsigned c = 0; c < g->channels; c++)
        if (place(&b->vk, p, &t->in[c], format, t->texels, t->height, 1, !b->staged, f) < 0)
            return -1;
    for (unsigned o = 0; o < g->outputs; o++)
        for (unsigned i = 0; i < LEVEL_PHASES; i++)
            if (place(&b->vk, p, &t->out[o][i], format, t->texels, t->groups * g->channels, 1, !b->staged, f) < 0)
                return -1;
    t->staging_in = *staging;
    *staging += plane_bytes(t) * g->channels;
    t->staging_out = *staging;
    *staging += output_bytes(t) * g->outputs;
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
        for (unsigned i = 0; i < count; i++)
            clear_input(b, s, &s->target[i]);
    }
    for (unsigned i = 0; i < count; i++) {
        describe_input(b, s, &s->target[i], &in[i]);
        for (unsigned o = 0; o < geometry[i].outputs; o++)
            describe_output(b, s, &s->target[i], o, &out[(size_t)i * BLOOM_OUTPUTS_MAX + o]);
    }
    return 0;
}

void bloom_slot_release(struct bloom *b, struct bloom_slot *s) { slot_destroy(&b->vk, s); }

void bloom_levels_release(struct bloom *b)
{
    fft_destroy(b);
    ledger_clear(&b->ledger);
    b->prepared = NULL;
    vk_buffer_free(&b->vk, &b->ledger.buffer);
    targets_destroy(&b->vk, &b->targets);
    vk_arena_free(&b->vk, &b->targets.memory);
    look_release(b, b->look);
    vk_buffer_free(&b->vk, &b->exchange);
    vk_image_destroy(&b->vk, &b->dirt);
    vk_memory_free(&b->vk, &b->dirt_memory);
    b->dirt_digest[0] = 0;
}
