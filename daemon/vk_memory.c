// SPDX-License-Identifier: Apache-2.0
// vk_memory.c - memory that only grows, images and buffers in it.
#include "vk.h"

#include <assert.h>
#include <sys/mman.h>
#include <unistd.h>

static int find_type(const struct vk *v, uint32_t bits, VkMemoryPropertyFlags want,
                     VkMemoryPropertyFlags nice)
{
    int found = -1;
    for (uint32_t i = 0; i < v->memory.memoryTypeCount; i++) {
        VkMemoryPropertyFlags flags = v->memory.memoryTypes[i].propertyFlags;
        if (!(bits & (1u << i)) || (flags & want) != want)
            continue;
        if ((flags & nice) == nice)
            return (int)i;
        if (found < 0)
            found = (int)i;
    }
    return found;
}

// A CPU device's memory is this process's own: large pages spare its threads page walks (6 % of a frame's time
// measured). Advice only, before the pages are touched.
static void advise_large_pages(struct vk *v, struct vk_memory *m)
{
    void *map = m->map;
    if (!v->cpu || (!map && vkMapMemory(v->device, m->memory, 0, VK_WHOLE_SIZE, 0, &map) != VK_SUCCESS))
        return;
    const uintptr_t page = (uintptr_t)sysconf(_SC_PAGESIZE);
    const uintptr_t from = ((uintptr_t)map + page - 1) & ~(page - 1), to = ((uintptr_t)map + m->size) & ~(page - 1);
    if (to > from)
        madvise((void *)from, to - from, MADV_HUGEPAGE);
    if (!m->map)
        vkUnmapMemory(v->device, m->memory);
}

int vk_memory_reserve(struct vk *v, struct vk_memory *m, VkDeviceSize size, uint32_t type_bits,
                      enum vk_place place, struct fault *f)
{
    if (m->memory && m->size >= size && (type_bits & (1u << m->type)))
        return 0;
    const VkMemoryPropertyFlags host =
        VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT;
    int type = place == VK_PLACE_HOST
                   ? find_type(v, type_bits, host, host | VK_MEMORY_PROPERTY_HOST_CACHED_BIT)
                   : find_type(v, type_bits, 0, VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT);
    if (type < 0)
        return fault_set(f, FAULT_INTERNAL, "", "no memory type among bits %x", type_bits);
    vk_memory_free(v, m);
    const VkMemoryAllocateInfo info = {
        .sType = VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO,
        .allocationSize = size,
        .memoryTypeIndex = (uint32_t)type,
    };
    VkResult r = vkAllocateMemory(v->device, &info, NULL, &m->memory);
    if (r != VK_SUCCESS)
        return vk_fault(f, r, "vkAllocateMemory");
    m->size = size;
    m->type = (uint32_t)type;
    if (place == VK_PLACE_HOST) {
        r = vkMapMemory(v->device, m->memory, 0, VK_WHOLE_SIZE, 0, (void **)&m->map);
        if (r != VK_SUCCESS) {
            vk_memory_free(v, m);
            return vk_fault(f, r, "vkMapMemory");
        }
    }
    advise_large_pages(v, m);
    return 0;
}

void vk_memory_free(struct vk *v, struct vk_memory *m)
{
    if (m->memory)
        vkFreeMemory(v->device, m->memory, NULL);
    *m = (struct vk_memory){ 0 };
}

void vk_arena_free(struct vk *v, struct vk_arena *a)
{
    for (unsigned i = 0; i < VK_BLOCKS_MAX; i++)
        vk_memory_free(v, &a->block[i]);
}

int vk_image_create(struct vk *v, struct vk_image *m, VkFormat format, uint32_t width, uint32_t height,
                    uint32_t layers, bool linear, struct fault *f)
{
    assert(layers <= VK_LAYERS_MAX && (!linear || layers == 1));
    *m = (struct vk_image){ .format = format, .width = width, .height = height, .layers = layers,
                            .linear = linear };
    const VkImageCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO,
        .imageType = VK_IMAGE_TYPE_2D,
        .format = format,
        .extent = { width, height, 1 },
        .mipLevels = 1,
        .arrayLayers = layers,
        .samples = VK_SAMPLE_COUNT_1_BIT,
        .tiling = linear ? VK_IMAGE_TILING_LINEAR : VK_IMAGE_TILING_OPTIMAL,
        .usage = VK_IMAGE_USAGE_STORAGE_BIT | VK_IMAGE_USAGE_COLOR_ATTACHMENT_BIT |
                 VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT,
        .initialLayout = linear ? VK_IMAGE_LAYOUT_PREINITIALIZED : VK_IMAGE_LAYOUT_UNDEFINED,
    };
    VkResult r = vkCreateImage(v->device, &info, NULL, &m->image);
    if (r != VK_SUCCESS)
        return vk_fault(f, r, "vkCreateImage");
    m->layout = info.initialLayout;
    vkGetImageMemoryRequirements(v->device, m->image, &m->needs);
    if (linear) {
        const VkImageSubresource sub = { VK_IMAGE_ASPECT_COLOR_BIT, 0, 0 };
        VkSubresourceLayout layout;
        vkGetImageSubresourceLayout(v->device, m->image, &sub, &layout);
        assert(layout.offset == 0);
        m->row_pitch_bytes = layout.rowPitch;
    }
    return 0;
}

static VkResult make_view(struct vk *v, struct vk_image *m, VkImageViewType type, uint32_t first,
                          uint32_t count, VkImageView *out)
{
    const VkImageViewCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_IMAGE_VIEW_CREATE_INFO,
        .image = m->image,
        .viewType = type,
        .format = m->format,
        .subresourceRange = { VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, first, count },
    };
    return vkCreateImageView(v->device, &info, NULL, out);
}

int vk_image_bind(struct vk *v, struct vk_image *m, struct vk_memory *memory, VkDeviceSize offset,
                  struct fault *f)
{
    m->host = memory->map ? memory->map + offset : NULL;
    VkResult r = vkBindImageMemory(v->device, m->image, memory->memory, offset);
    if (r == VK_SUCCESS)
        r = make_view(v, m, m->layers == 1 ? VK_IMAGE_VIEW_TYPE_2D : VK_IMAGE_VIEW_TYPE_2D_ARRAY, 0, m->layers,
                      &m->view);
    for (uint32_t i = 0; r == VK_SUCCESS && i < m->layers; i++)
        r = make_view(v, m, VK_IMAGE_VIEW_TYPE_2D, i, 1, &m->layer_view[i]);
    return r == VK_SUCCESS ? 0 : vk_fault(f, r, "binding an image");
}

void vk_image_destroy(struct vk *v, struct vk_image *m)
{
    for (uint32_t i = 0; i < VK_LAYERS_MAX; i++)
        if (m->layer_view[i])
            vkDestroyImageView(v->device, m->layer_view[i], NULL);
    if (m->view)
        vkDestroyImageView(v->device, m->view, NULL);
    if (m->image)
        vkDestroyImage(v->device, m->image, NULL);
    *m = (struct vk_image){ 0 };
}

int vk_buffer_reserve(struct vk *v, struct vk_buffer *b, VkDeviceSize size, VkBufferUsageFlags usage,
                      struct fault *f)
{
    if (b->buffer && b->size >= size)
        return 0;
    vk_buffer_free(v, b);
    const VkBufferCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO,
        .size = size,
        .usage = usage,
    };
    VkResult r = vkCreateBuffer(v->device, &info, NULL, &b->buffer);
    if (r != VK_SUCCESS)
        return vk_fault(f, r, "vkCreateBuffer");
    VkMemoryRequirements needs;
    vkGetBufferMemoryRequirements(v->device, b->buffer, &needs);
    if (vk_memory_reserve(v, &b->memory, needs.size, needs.memoryTypeBits, VK_PLACE_HOST, f) < 0)
        goto fail;
    r = vkBindBufferMemory(v->device, b->buffer, b->memory.memory, 0);
    if (r != VK_SUCCESS) {
        vk_fault(f, r, "vkBindBufferMemory");
        goto fail;
    }
    b->size = size;
    return 0;
fail:
    vk_buffer_free(v, b);
    return -1;
}

void vk_buffer_free(struct vk *v, struct vk_buffer *b)
{
    if (b->buffer)
        vkDestroyBuffer(v->device, b->buffer, NULL);
    vk_memory_free(v, &b->memory);
    *b = (struct vk_buffer){ 0 };
}
