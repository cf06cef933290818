// SPDX-License-Identifier: Apache-2.0
// look_energy.c - a look's light, from sums of short stretches of rows that the device made: some 100 KB to read, whatever the frame.
// A row that the frame's rows sample w times in all (shares of bilinear samples, clamped edges included) counts w times.
#include <math.h>
#include <string.h>

#include "look_internal.h"

static VkDeviceSize sums_bytes(const struct look_list *l, const struct look_light *light)
{
    return light->sums < 0 ? 0 : (VkDeviceSize)l->image[light->sums].width * l->image[light->sums].height * 16;
}

static void copy(struct bloom *b, const struct look_light *light, VkDeviceSize offset)
{
    if (light->sums < 0)
        return;
    struct vk_image *m = &b->look->image[light->sums];
    vk_use(&b->commands, m, VK_PIPELINE_STAGE_2_COPY_BIT, VK_ACCESS_2_TRANSFER_READ_BIT, false);
    vk_flush_barriers(&b->commands);
    const VkBufferImageCopy region = { .bufferOffset = offset,
                                       .imageSubresource = { VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1 },
                                       .imageExtent = { m->width, m->height, 1 } };
    vkCmdCopyImageToBuffer(b->commands.buffer, m->image, VK_IMAGE_LAYOUT_GENERAL, b->look->sums.buffer, 1, &region);
}

int look_energy_record(struct bloom *b, struct fault *f)
{
    struct look_targets *t = b->look;
    const VkDeviceSize bright = sums_bytes(&t->list, &t->list.bright_light), glow = sums_bytes(&t->list, &t->list.glow_light);
    if (!(bright + glow))
        return 0;
    if (vk_buffer_reserve(&b->vk, &t->sums, bright + glow, VK_BUFFER_USAGE_TRANSFER_DST_BIT, f) < 0)
        return -1;
    copy(b, &t->list.bright_light, 0);
    copy(b, &t->list.glow_light, bright);
    return 0;
}

static double row_sum(const float *row, uint32_t width)
{
    double sum = 0;
    for (uint32_t i = 0; i < width * 4; i++)
        sum += (double)row[i]; // the fourth of each is 0
    return sum;
}

// The frame's rows in turn, each a share of two of the section's.
static double section_sum(const float *rows, uint32_t width, uint32_t height, uint32_t to)
{
    double sum = 0;
    for (uint32_t y = 0; y < to; y++) {
        const double at = (y + .5) * height / to - .5, low = floor(at), t = at - low;
        const uint32_t a = low < 0 ? 0 : (uint32_t)low, b = low + 1 > height - 1 ? height - 1 : (uint32_t)(low + 1);
        sum += (1 - t) * row_sum(rows + (size_t)a * width * 4, width) + t * row_sum(rows + (size_t)b * width * 4, width);
    }
    return sum;
}

static double light_sum(const struct look_list *l, const struct look_light *light, const uint8_t *map, uint32_t height)
{
    if (light->sums < 0)
        return 0;
    const float *rows = (const float *)(const void *)map;
    const uint32_t width = l->image[light->sums].width, all = l->image[light->sums].height;
    if (light->of.image < 0)
        return light->factor * section_sum(rows, width, all, all);
    double sum = 0;
    for (unsigned i = 0; i < light->of.sections; i++)
        sum += section_sum(rows + (size_t)light->of.section[i].first * width * 4, width, light->of.section[i].height, height);
    return light->factor * sum;
}

void look_energy(const struct bloom *b, uint32_t height, double scale, double *bright, double *glow)
{
    const struct look_list *l = &b->look->list;
    const uint8_t *map = b->look->sums.memory.map;
    if (!map)
        return;
    *bright = light_sum(l, &l->bright_light, map, height) / scale;
    *glow = light_sum(l, &l->glow_light, map + sums_bytes(l, &l->bright_light), height) / scale;
}
