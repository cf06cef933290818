// SPDX-License-Identifier: Apache-2.0
// bloom_fft.c - the spread by FFT on the host (convolve.h): E is read back at full size, its glow is put where the pyramid
// would have put its full-size sum, and the pictures are made from it as ever.
#include <stdio.h>
#include <string.h>

#include "bloom_internal.h"
#include "convolve.h"

/* Rows of the exchange buffer: a channel's block of `rows` rows of `texels` texels, cell (0, 0) at row and column LEVEL_MARGIN. */
struct block {
    uint32_t texels, rows;
    VkDeviceSize offset; /* of the first channel's */
};

static VkDeviceSize block_bytes(const struct block *k) { return (VkDeviceSize)k->texels * k->rows * 16; }

static float *corner_of(const struct bloom *b, const struct block *k, unsigned channel)
{
    float *base = (float *)(void *)(b->exchange.memory.map + k->offset + channel * block_bytes(k));
    return base + ((size_t)LEVEL_MARGIN * k->texels * 4 + LEVEL_MARGIN);
}

static struct block block_of_e(const struct targets *t)
{
    return (struct block){ t->layered.width, 2 * t->layered_groups, 0 };
}

static struct block block_of_glow(const struct targets *t)
{
    const struct block e = block_of_e(t);
    return (struct block){ t->level[0].texels, 4 * t->level[0].groups, block_bytes(&e) * t->shape.channels };
}

int fft_prepare(struct frame *fr)
{
    struct bloom *b = fr->b;
    const struct bloom_geometry *g = &fr->target->geometry;
    const struct params *p = fr->params;
    char key[sizeof(b->convolver_key)];
    snprintf(key, sizeof(key), "%s %u x %u + %u, %u channels, aspect %.9g", p->psf, g->width, g->height, g->grow, g->channels,
             (double)fr->request->pixel_aspect);
    if (b->convolver && !strcmp(key, b->convolver_key))
        return 0;
    fft_destroy(b);
    const struct bloom_image *image = fr->request->kernel;
    if (p->psf_spec.kind == PSF_IMAGE && !image)
        return fault_set(fr->f, FAULT_PARAM_CONFLICT, "params.psf", "psf=image: names an image that is not there");
    const struct convolver_facts facts = {
        .width = g->width,
        .height = g->height,
        .grow = g->grow,
        .channels = g->channels,
        .pixel_aspect = (double)fr->request->pixel_aspect,
        .psf = &p->psf_spec,
        .image = image ? image->rgb : NULL,
        .image_width = image ? image->width : 0,
        .image_height = image ? image->height : 0,
        .threads = b->threads,
    };
    if (convolver_create(&b->convolver, &facts, fr->f) < 0)
        return -1;
    snprintf(b->convolver_key, sizeof(b->convolver_key), "%s", key);
    return 0;
}

void fft_destroy(struct bloom *b)
{
    convolver_destroy(b->convolver);
    b->convolver = NULL;
}

double fft_bound(const struct frame *fr) { return convolver_bound(fr->b->convolver); }

// The phases' rows are interleaved by the copy itself; in one command, for the validation layer takes a strided copy for all
// that lies between its rows.
static void copy_rows(struct frame *fr, struct vk_image *m, const struct block *k, unsigned channel, unsigned phases,
                      unsigned layer, uint32_t first_row, uint32_t rows, bool up)
{
    struct vk_commands *c = &fr->b->commands;
    VkBufferImageCopy copy[LEVEL_PHASES];
    for (unsigned p = 0; p < phases; p++)
        copy[p] = (VkBufferImageCopy){
            .bufferOffset = k->offset + channel * block_bytes(k) + (VkDeviceSize)p * k->texels * 16,
            .bufferRowLength = phases * k->texels,
            .bufferImageHeight = rows,
            .imageSubresource = { VK_IMAGE_ASPECT_COLOR_BIT, 0, layer + p, 1 },
            .imageOffset = { 0, (int32_t)first_row, 0 },
            .imageExtent = { k->texels, rows, 1 },
        };
    if (up)
        vkCmdCopyBufferToImage(c->buffer, fr->b->exchange.buffer, m->image, VK_IMAGE_LAYOUT_GENERAL, phases, copy);
    else
        vkCmdCopyImageToBuffer(c->buffer, m->image, VK_IMAGE_LAYOUT_GENERAL, fr->b->exchange.buffer, phases, copy);
}

static double sum_rows(const float *from, size_t stride, uint32_t width, uint32_t height)
{
    double total = 0;
    for (uint32_t y = 0; y < height; y++) {
        double row = 0;
        for (uint32_t x = 0; x < width; x++)
            row += from[y * stride + x];
        total += row;
    }
    return total;
}

static int convolve(struct frame *fr, const struct block *from, const struct block *to)
{
    struct bloom *b = fr->b;
    const struct slot_target *t = fr->target;
    const uint32_t grow = t->geometry.grow;
    const float *e[3] = { NULL };
    float *out[3] = { NULL };
    const size_t e_stride = (size_t)from->texels * 4, stride = (size_t)to->texels * 4;
    for (unsigned c = 0; c < t->geometry.channels; c++) {
        e[c] = corner_of(b, from, c) + grow * e_stride + grow;
        out[c] = corner_of(b, to, c);
    }
    if (convolver_run(b->convolver, e, e_stride, out, stride, fr->f) < 0)
        return -1;
    fr->sums = (struct ledger_sums){ 0 };
    for (unsigned c = 0; c < t->geometry.channels; c++) {
        const double bright = sum_rows(e[c], e_stride, t->geometry.width, t->geometry.height);
        const double spread = bright * fr->params->psf_spec.weight; // what an image has beyond the frame is lost, too
        fr->sums.bright += bright;
        fr->sums.spread += spread;
        fr->sums.inside += sum_rows(out[c] + grow * stride + grow, stride, t->geometry.width,
                                     t->geometry.height);
    }
    fr->sums.outside = fr->sums.spread - fr->sums.inside;
    return 0;
}

int fft_spread(struct frame *fr, struct vk_image **sum)
{
    struct bloom *b = fr->b;
    struct targets *t = &b->targets;
    const struct block from = block_of_e(t), to = block_of_glow(t);
    const unsigned channels = t->shape.channels;
    if (vk_buffer_reserve(&b->vk, &b->exchange, to.offset + block_bytes(&to) * channels, EXCHANGE_USAGE, fr->f) < 0)
        return -1;
    vk_use(&b->commands, &t->layered, VK_PIPELINE_STAGE_2_COPY_BIT, VK_ACCESS_2_TRANSFER_READ_BIT, false);
    vk_flush_barriers(&b->commands);
    for (unsigned c = 0; c < channels; c++)
        copy_rows(fr, &t->layered, &from, c, 2, 2 * c, 0, t->layered_groups, false);
    vk_to_host(&b->commands);
    if (vk_submit_and_wait(&b->commands, fr->f) < 0 || convolve(fr, &from, &to) < 0 || vk_begin(&b->commands, fr->f) < 0)
        return -1;
    *sum = &t->pool[0];
    vk_use(&b->commands, *sum, VK_PIPELINE_STAGE_2_COPY_BIT, VK_ACCESS_2_TRANSFER_WRITE_BIT, true);
    vk_flush_barriers(&b->commands);
    for (unsigned c = 0; c < channels; c++)
        copy_rows(fr, *sum, &to, c, LEVEL_PHASES, 0, c * t->level[0].groups, t->level[0].groups, true);
    return 0;
}
