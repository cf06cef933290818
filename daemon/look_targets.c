// SPDX-License-Identifier: Apache-2.0
// look_targets.c - what the looks keep between frames: images, uniforms, pipelines. Images are made anew in memory that only
// grows when a list asks for other sizes; a pipeline is made when a stage first needs it.
#include <stdlib.h>
#include <string.h>

#include "look_internal.h"
#include "spirv_look.h"

int look_targets_create(struct bloom *b, struct fault *f)
{
    if (b->look)
        return 0;
    struct look_targets *t = calloc(1, sizeof(*t));
    if (!t)
        return fault_set(f, FAULT_NO_MEMORY, "", "out of memory for a look");
    if (vk_buffer_reserve(&b->vk, &t->uniforms, (VkDeviceSize)LOOK_DRAWS_MAX * UNIFORM_STRIDE,
                          VK_BUFFER_USAGE_UNIFORM_BUFFER_BIT, f) < 0) {
        free(t);
        return -1;
    }
    b->look = t;
    return 0;
}

static void clear_images(struct vk *v, struct look_targets *t)
{
    for (unsigned i = 0; i < t->images; i++)
        vk_image_destroy(v, &t->image[i]);
    t->images = 0;
    t->made = false;
}

void look_release(struct bloom *b, struct look_targets *t)
{
    if (!t)
        return;
    clear_images(&b->vk, t);
    vk_arena_free(&b->vk, &t->memory);
    vk_buffer_free(&b->vk, &t->sums);
}

void look_destroy(struct bloom *b, struct look_targets *t)
{
    if (!t)
        return;
    look_release(b, t);
    vk_buffer_free(&b->vk, &t->uniforms);
    for (unsigned i = 0; i < t->pipelines; i++)
        vk_pipeline_destroy(&b->vk, &t->pipeline[i].pipeline);
    free(t);
}

static bool same_images(const struct look_targets *t)
{
    bool same = t->made && t->images == t->list.images;
    for (unsigned i = 0; same && i < t->images; i++)
        same = t->image[i].width == t->list.image[i].width && t->image[i].height == t->list.image[i].height &&
               t->image[i].layers == t->list.image[i].layers;
    return same;
}

// One after the other, from block to block; blocks are made when all places are known.
struct places {
    unsigned block[LOOK_IMAGES_MAX], last;
    VkDeviceSize offset[LOOK_IMAGES_MAX], size[VK_BLOCKS_MAX];
    uint32_t types;
};

static int place(const struct vk *v, struct places *p, unsigned i, const struct vk_image *m, struct fault *f)
{
    const VkDeviceSize a = m->needs.alignment;
    VkDeviceSize at = (p->size[p->last] + a - 1) / a * a;
    if (at && at + m->needs.size > v->block_max) {
        if (p->last + 1 == VK_BLOCKS_MAX)
            return fault_set(f, FAULT_LIMIT, "params.look", "the look's images need more than %d blocks of %llu bytes: a smaller "
                             "frame expected", VK_BLOCKS_MAX, (unsigned long long)v->block_max);
        p->last++;
        at = 0;
    }
    p->block[i] = p->last;
    p->offset[i] = at;
    p->size[p->last] = at + m->needs.size;
    p->types &= m->needs.memoryTypeBits;
    return 0;
}

int look_targets_prepare(struct bloom *b, struct fault *f)
{
    struct vk *v = &b->vk;
    struct look_targets *t = b->look;
    if (same_images(t))
        return 0;
    clear_images(v, t);
    struct places p = { .types = ~0u };
    // Positions are exact integers in the shaders, 2 * size^2 at most.
    const uint32_t most = b->info.max_dimension < LOOK_SIZE_MAX ? b->info.max_dimension : LOOK_SIZE_MAX;
    for (unsigned i = 0; i < t->list.images; i++) {
        const uint32_t w = t->list.image[i].width, h = t->list.image[i].height;
        t->images = i + 1;
        if (w > most || h > most) {
            fault_set(f, FAULT_LIMIT, "input", "%u x %u pixels: a look takes frames up to %u x %u here", w, h, most, most);
            goto fail;
        }
        if (vk_image_create(v, &t->image[i], VK_FORMAT_R32G32B32A32_SFLOAT, w, h, t->list.image[i].layers, false, f) < 0 ||
            place(v, &p, i, &t->image[i], f) < 0)
            goto fail;
    }
    for (unsigned i = 0; i <= p.last; i++)
        if (vk_memory_reserve(v, &t->memory.block[i], p.size[i], p.types, VK_PLACE_DEVICE, f) < 0)
            goto fail;
    for (unsigned i = 0; i < t->images; i++)
        if (vk_image_bind(v, &t->image[i], &t->memory.block[p.block[i]], p.offset[i], f) < 0)
            goto fail;
    t->made = true;
    return 0;
fail:
    clear_images(v, t);
    return -1;
}

static const struct spirv_entry *find(const char *name)
{
    for (unsigned i = 0; i < sizeof(spirv_look_table) / sizeof(spirv_look_table[0]); i++)
        if (!strcmp(spirv_look_table[i].name, name))
            return &spirv_look_table[i];
    return NULL;
}

// The device is idle between runs, so a pipeline of an earlier one may go.
static unsigned free_place(struct bloom *b, struct look_targets *t)
{
    unsigned at = 0;
    if (t->pipelines < LOOK_PIPELINES_MAX)
        return t->pipelines++;
    for (unsigned i = 1; i < LOOK_PIPELINES_MAX; i++)
        if (t->pipeline[i].used < t->pipeline[at].used)
            at = i;
    assert(t->pipeline[at].used < t->runs);
    vk_pipeline_destroy(&b->vk, &t->pipeline[at].pipeline);
    t->pipeline[at].name = NULL;
    return at;
}

const struct vk_pipeline *look_pipeline(struct bloom *b, const char *name, VkFormat format, unsigned attachments,
                                        const int32_t spec[4], struct fault *f)
{
    struct look_targets *t = b->look;
    const struct spirv_entry *s = find(name);
    assert(s);
    for (unsigned i = 0; i < t->pipelines; i++)
        if (t->pipeline[i].name == s->name && !memcmp(t->pipeline[i].spec, spec, sizeof(t->pipeline[i].spec))) {
            t->pipeline[i].used = t->runs;
            return &t->pipeline[i].pipeline;
        }
    const unsigned at = free_place(b, t);
    if (vk_pipeline_create(&b->vk, &t->pipeline[at].pipeline, s->words, s->bytes, format, attachments, spec, 4, f) < 0)
        return NULL;
    memcpy(t->pipeline[at].spec, spec, sizeof(t->pipeline[0].spec));
    t->pipeline[at].name = s->name;
    t->pipeline[at].used = t->runs;
    return &t->pipeline[at].pipeline;
}
