// SPDX-License-Identifier: Apache-2.0
// vk_pass.c - recording: barriers from what images remember, full-screen passes, submit and wait.
#include "vk.h"

#include "pulse.h"

#include <assert.h>

int vk_commands_create(struct vk *v, struct vk_commands *c, bool profile, struct fault *f)
{
    *c = (struct vk_commands){ .vk = v };
    const VkCommandBufferAllocateInfo info = {
        .sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO,
        .commandPool = v->pool,
        .level = VK_COMMAND_BUFFER_LEVEL_PRIMARY,
        .commandBufferCount = 1,
    };
    VkResult r = vkAllocateCommandBuffers(v->device, &info, &c->buffer);
    if (r == VK_SUCCESS && profile) {
        const VkQueryPoolCreateInfo queries = {
            .sType = VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO,
            .queryType = VK_QUERY_TYPE_TIMESTAMP,
            .queryCount = VK_STAMPS_MAX,
        };
        r = vkCreateQueryPool(v->device, &queries, NULL, &c->queries);
    }
    return r == VK_SUCCESS ? 0 : vk_fault(f, r, "creating a command buffer");
}

void vk_commands_destroy(struct vk_commands *c)
{
    if (c->queries)
        vkDestroyQueryPool(c->vk->device, c->queries, NULL);
    if (c->buffer)
        vkFreeCommandBuffers(c->vk->device, c->vk->pool, 1, &c->buffer);
    *c = (struct vk_commands){ 0 };
}

static void stamp(struct vk_commands *c)
{
    if (c->queries && c->stamps < VK_STAMPS_MAX)
        vkCmdWriteTimestamp2(c->buffer, VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT, c->queries, c->stamps++);
}

int vk_begin(struct vk_commands *c, struct fault *f)
{
    c->barriers = 0;
    const VkCommandBufferBeginInfo info = {
        .sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO,
        .flags = VK_COMMAND_BUFFER_USAGE_ONE_TIME_SUBMIT_BIT,
    };
    VkResult r = vkBeginCommandBuffer(c->buffer, &info);
    if (r != VK_SUCCESS)
        return vk_fault(f, r, "vkBeginCommandBuffer");
    if (c->queries) {
        vkCmdResetQueryPool(c->buffer, c->queries, 0, VK_STAMPS_MAX);
        c->stamps = 0;
        stamp(c);
    }
    return 0;
}

unsigned vk_stamps_ms(struct vk_commands *c, double *out, unsigned n)
{
    uint64_t ticks[VK_STAMPS_MAX];
    if (!c->queries || c->stamps < 2 ||
        vkGetQueryPoolResults(c->vk->device, c->queries, 0, c->stamps, sizeof(ticks), ticks, sizeof(ticks[0]),
                              VK_QUERY_RESULT_64_BIT | VK_QUERY_RESULT_WAIT_BIT) != VK_SUCCESS)
        return 0;
    unsigned i = 0;
    for (; i + 1 < c->stamps && i < n; i++)
        out[i] = (double)(ticks[i + 1] - ticks[0]) * c->vk->properties.limits.timestampPeriod * 1e-6;
    return i;
}

static bool writes(VkAccessFlags2 access)
{
    return access & (VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT | VK_ACCESS_2_TRANSFER_WRITE_BIT |
                     VK_ACCESS_2_SHADER_STORAGE_WRITE_BIT | VK_ACCESS_2_HOST_WRITE_BIT);
}

void vk_use(struct vk_commands *c, struct vk_image *m, VkPipelineStageFlags2 stage, VkAccessFlags2 access,
            bool discard)
{
    bool same_reads = m->layout == VK_IMAGE_LAYOUT_GENERAL && !writes(m->access) && !writes(access);
    if (same_reads && (m->stage & stage) == stage && (m->access & access) == access)
        return;
    assert(c->barriers < sizeof(c->barrier) / sizeof(c->barrier[0]));
    VkImageLayout old = m->layout;
    if (discard && old != VK_IMAGE_LAYOUT_PREINITIALIZED)
        old = VK_IMAGE_LAYOUT_UNDEFINED;
    c->barrier[c->barriers++] = (VkImageMemoryBarrier2){
        .sType = VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER_2,
        .srcStageMask = m->stage ? m->stage : VK_PIPELINE_STAGE_2_NONE,
        .srcAccessMask = writes(m->access) ? m->access : 0,
        .dstStageMask = stage,
        .dstAccessMask = access,
        .oldLayout = old,
        .newLayout = VK_IMAGE_LAYOUT_GENERAL,
        .srcQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
        .dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED,
        .image = m->image,
        .subresourceRange = { VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, m->layers },
    };
    // Readers add up, so that a later write waits for all of them.
    m->stage = same_reads ? m->stage | stage : stage;
    m->access = same_reads ? m->access | access : access;
    m->layout = VK_IMAGE_LAYOUT_GENERAL;
}

void vk_flush_barriers(struct vk_commands *c)
{
    if (!c->barriers)
        return;
    const VkDependencyInfo info = {
        .sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO,
        .imageMemoryBarrierCount = c->barriers,
        .pImageMemoryBarriers = c->barrier,
    };
    vkCmdPipelineBarrier2(c->buffer, &info);
    c->barriers = 0;
}

void vk_to_host(struct vk_commands *c)
{
    const VkMemoryBarrier2 barrier = {
        .sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER_2,
        .srcStageMask = VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT | VK_PIPELINE_STAGE_2_COPY_BIT,
        .srcAccessMask = VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT | VK_ACCESS_2_TRANSFER_WRITE_BIT,
        .dstStageMask = VK_PIPELINE_STAGE_2_HOST_BIT,
        .dstAccessMask = VK_ACCESS_2_HOST_READ_BIT,
    };
    const VkDependencyInfo info = {
        .sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO,
        .memoryBarrierCount = 1,
        .pMemoryBarriers = &barrier,
    };
    vkCmdPipelineBarrier2(c->buffer, &info);
}

int vk_submit_and_wait(struct vk_commands *c, struct fault *f)
{
    struct vk *v = c->vk;
    vk_flush_barriers(c);
    VkResult r = vkEndCommandBuffer(c->buffer);
    if (r != VK_SUCCESS)
        return vk_fault(f, r, "vkEndCommandBuffer");
    const uint64_t value = v->timeline_value + 1;
    const VkCommandBufferSubmitInfo command = {
        .sType = VK_STRUCTURE_TYPE_COMMAND_BUFFER_SUBMIT_INFO,
        .commandBuffer = c->buffer,
    };
    const VkSemaphoreSubmitInfo signal = {
        .sType = VK_STRUCTURE_TYPE_SEMAPHORE_SUBMIT_INFO,
        .semaphore = v->timeline,
        .value = value,
        .stageMask = VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT,
    };
    const VkSubmitInfo2 submit = {
        .sType = VK_STRUCTURE_TYPE_SUBMIT_INFO_2,
        .commandBufferInfoCount = 1,
        .pCommandBufferInfos = &command,
        .signalSemaphoreInfoCount = 1,
        .pSignalSemaphoreInfos = &signal,
    };
    r = vkQueueSubmit2(v->queue, 1, &submit, VK_NULL_HANDLE);
    if (r != VK_SUCCESS)
        return vk_fault(f, r, "vkQueueSubmit2");
    v->timeline_value = value;
    const VkSemaphoreWaitInfo wait = {
        .sType = VK_STRUCTURE_TYPE_SEMAPHORE_WAIT_INFO,
        .semaphoreCount = 1,
        .pSemaphores = &v->timeline,
        .pValues = &value,
    };
    r = vkWaitSemaphores(v->device, &wait, VK_WAIT_S * UINT64_C(1000000000));
    // A wait that ran out is progress as well: it has an end, and what follows is a new device.
    pulse_beat();
    if (r == VK_TIMEOUT)
        return fault_set(f, FAULT_DEVICE_LOST, "", "the device did not finish a frame within %d s",
                         VK_WAIT_S);
    return r == VK_SUCCESS ? 0 : vk_fault(f, r, "vkWaitSemaphores");
}

static VkResult module_create(struct vk *v, const uint32_t *spirv, size_t bytes, VkShaderModule *out)
{
    const VkShaderModuleCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO,
        .codeSize = bytes,
        .pCode = spirv,
    };
    return vkCreateShaderModule(v->device, &info, NULL, out);
}

int vk_pipeline_create(struct vk *v, struct vk_pipeline *p, const uint32_t *spirv, size_t bytes,
                       VkFormat format, unsigned attachments, const int32_t *spec, unsigned n_spec,
                       struct fault *f)
{
    *p = (struct vk_pipeline){ .attachments = attachments, .format = format };
    VkShaderModule module;
    VkResult r = module_create(v, spirv, bytes, &module);
    if (r != VK_SUCCESS)
        return vk_fault(f, r, "vkCreateShaderModule");

    VkSpecializationMapEntry entries[8];
    assert(n_spec <= 8);
    for (unsigned i = 0; i < n_spec; i++)
        entries[i] = (VkSpecializationMapEntry){ i, i * (uint32_t)sizeof(int32_t), sizeof(int32_t) };
    const VkSpecializationInfo specialisation = { n_spec, entries, n_spec * sizeof(int32_t), spec };
    const VkPipelineShaderStageCreateInfo stages[] = {
        { .sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO,
          .stage = VK_SHADER_STAGE_VERTEX_BIT,
          .module = v->vertex,
          .pName = "main" },
        { .sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO,
          .stage = VK_SHADER_STAGE_FRAGMENT_BIT,
          .module = module,
          .pName = "main",
          .pSpecializationInfo = n_spec ? &specialisation : NULL },
    };
    const VkPipelineVertexInputStateCreateInfo vertices = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_VERTEX_INPUT_STATE_CREATE_INFO
    };
    const VkPipelineInputAssemblyStateCreateInfo assembly = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_INPUT_ASSEMBLY_STATE_CREATE_INFO,
        .topology = VK_PRIMITIVE_TOPOLOGY_TRIANGLE_LIST,
    };
    const VkPipelineViewportStateCreateInfo viewport = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_VIEWPORT_STATE_CREATE_INFO,
        .viewportCount = 1,
        .scissorCount = 1,
    };
    const VkPipelineRasterizationStateCreateInfo raster = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_RASTERIZATION_STATE_CREATE_INFO,
        .lineWidth = 1.0f,
    };
    const VkPipelineMultisampleStateCreateInfo multisample = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_MULTISAMPLE_STATE_CREATE_INFO,
        .rasterizationSamples = VK_SAMPLE_COUNT_1_BIT,
    };
    VkPipelineColorBlendAttachmentState blend[VK_ATTACHMENTS_MAX];
    VkFormat formats[VK_ATTACHMENTS_MAX];
    assert(attachments <= VK_ATTACHMENTS_MAX);
    for (unsigned i = 0; i < attachments; i++) {
        blend[i] = (VkPipelineColorBlendAttachmentState){ .colorWriteMask = 0xf };
        formats[i] = format;
    }
    const VkPipelineColorBlendStateCreateInfo blending = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_COLOR_BLEND_STATE_CREATE_INFO,
        .attachmentCount = attachments,
        .pAttachments = blend,
    };
    const VkDynamicState states[] = { VK_DYNAMIC_STATE_VIEWPORT, VK_DYNAMIC_STATE_SCISSOR };
    const VkPipelineDynamicStateCreateInfo dynamic = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_DYNAMIC_STATE_CREATE_INFO,
        .dynamicStateCount = 2,
        .pDynamicStates = states,
    };
    const VkPipelineRenderingCreateInfo rendering = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_RENDERING_CREATE_INFO,
        .colorAttachmentCount = attachments,
        .pColorAttachmentFormats = formats,
    };
    const VkGraphicsPipelineCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_GRAPHICS_PIPELINE_CREATE_INFO,
        .pNext = &rendering,
        .stageCount = 2,
        .pStages = stages,
        .pVertexInputState = &vertices,
        .pInputAssemblyState = &assembly,
        .pViewportState = &viewport,
        .pRasterizationState = &raster,
        .pMultisampleState = &multisample,
        .pColorBlendState = &blending,
        .pDynamicState = &dynamic,
        .layout = v->pipeline_layout,
    };
    r = vkCreateGraphicsPipelines(v->device, VK_NULL_HANDLE, 1, &info, NULL, &p->pipeline);
    vkDestroyShaderModule(v->device, module, NULL);
    return r == VK_SUCCESS ? 0 : vk_fault(f, r, "vkCreateGraphicsPipelines");
}

int vk_compute_create(struct vk *v, struct vk_pipeline *p, const uint32_t *spirv, size_t bytes, struct fault *f)
{
    *p = (struct vk_pipeline){ 0 };
    VkShaderModule module;
    VkResult r = module_create(v, spirv, bytes, &module);
    if (r != VK_SUCCESS)
        return vk_fault(f, r, "vkCreateShaderModule");
    const VkComputePipelineCreateInfo info = {
        .sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO,
        .stage = { .sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO,
                   .stage = VK_SHADER_STAGE_COMPUTE_BIT,
                   .module = module,
                   .pName = "main" },
        .layout = v->pipeline_layout,
    };
    r = vkCreateComputePipelines(v->device, VK_NULL_HANDLE, 1, &info, NULL, &p->pipeline);
    vkDestroyShaderModule(v->device, module, NULL);
    return r == VK_SUCCESS ? 0 : vk_fault(f, r, "vkCreateComputePipelines");
}

void vk_pipeline_destroy(struct vk *v, struct vk_pipeline *p)
{
    if (p->pipeline)
        vkDestroyPipeline(v->device, p->pipeline, NULL);
    *p = (struct vk_pipeline){ 0 };
}

struct bindings {
    VkDescriptorImageInfo image[4 + VK_PLANES];
    VkDescriptorBufferInfo buffer[2];
    VkWriteDescriptorSet set[7];
    unsigned images, buffers, sets;
};

static void bind_image(struct bindings *w, uint32_t binding, const struct vk_image *m)
{
    if (!m)
        return;
    w->image[w->images] = (VkDescriptorImageInfo){ VK_NULL_HANDLE, m->view, VK_IMAGE_LAYOUT_GENERAL };
    w->set[w->sets++] = (VkWriteDescriptorSet){ .sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET,
                                                .dstBinding = binding,
                                                .descriptorCount = 1,
                                                .descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_IMAGE,
                                                .pImageInfo = &w->image[w->images] };
    w->images++;
}

static void bind_buffer(struct bindings *w, uint32_t binding, VkDescriptorType type, VkBuffer buffer, VkDeviceSize offset,
                        VkDeviceSize bytes)
{
    w->buffer[w->buffers] = (VkDescriptorBufferInfo){ buffer, offset, bytes };
    w->set[w->sets++] = (VkWriteDescriptorSet){ .sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET,
                                                .dstBinding = binding,
                                                .descriptorCount = 1,
                                                .descriptorType = type,
                                                .pBufferInfo = &w->buffer[w->buffers] };
    w->buffers++;
}

static void push_bindings(struct vk_commands *c, const struct vk_draw *d, unsigned band, VkPipelineBindPoint point,
                          const struct vk_buffer *counts)
{
    struct bindings w;
    w.images = w.buffers = w.sets = 0;
    bind_image(&w, 0, d->src);
    bind_image(&w, 1, d->add);
    bind_image(&w, 4, d->matte);
    bind_image(&w, 5, d->dirt);
    if (d->in[0]) {
        const VkDescriptorImageInfo *first = &w.image[w.images];
        for (unsigned i = 0; i < VK_PLANES; i++)
            w.image[w.images++] = (VkDescriptorImageInfo){ VK_NULL_HANDLE, d->in[d->bands > 1 && !d->all_planes ? band : i]->view,
                                                           VK_IMAGE_LAYOUT_GENERAL };
        w.set[w.sets++] = (VkWriteDescriptorSet){ .sType = VK_STRUCTURE_TYPE_WRITE_DESCRIPTOR_SET,
                                                  .dstBinding = 2,
                                                  .descriptorCount = VK_PLANES,
                                                  .descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_IMAGE,
                                                  .pImageInfo = first };
    }
    bind_buffer(&w, 3, VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER, d->uniforms, d->uniforms_offset, d->uniforms_bytes);
    if (counts)
        bind_buffer(&w, 6, VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, counts->buffer, 0, counts->size);
    c->vk->push_descriptor_set(c->buffer, point, c->vk->pipeline_layout, 0, w.sets, w.set);
}

static void use_inputs(struct vk_commands *c, const struct vk_draw *d, VkPipelineStageFlags2 stage)
{
    struct vk_image *all[] = { d->src, d->add, d->matte, d->dirt };
    for (unsigned i = 0; i < sizeof(all) / sizeof(all[0]); i++)
        if (all[i])
            vk_use(c, all[i], stage, VK_ACCESS_2_SHADER_STORAGE_READ_BIT, false);
    for (unsigned i = 0; d->in[0] && i < VK_PLANES; i++)
        vk_use(c, d->in[i], stage, VK_ACCESS_2_SHADER_STORAGE_READ_BIT, false);
}

void vk_draw(struct vk_commands *c, const struct vk_draw *d)
{
    const VkPipelineStageFlags2 output = VK_PIPELINE_STAGE_2_COLOR_ATTACHMENT_OUTPUT_BIT;
    VkRenderingAttachmentInfo attachments[VK_ATTACHMENTS_MAX];
    uint32_t width = 0, height = 0;
    for (unsigned i = 0; i < d->pipeline->attachments; i++) {
        struct vk_image *m = d->dst ? d->dst : d->dst_each[i];
        attachments[i] = (VkRenderingAttachmentInfo){
            .sType = VK_STRUCTURE_TYPE_RENDERING_ATTACHMENT_INFO,
            .imageView = m->layer_view[d->dst ? i : 0],
            .imageLayout = VK_IMAGE_LAYOUT_GENERAL,
            .loadOp = d->rects ? VK_ATTACHMENT_LOAD_OP_CLEAR : VK_ATTACHMENT_LOAD_OP_DONT_CARE,
            .storeOp = VK_ATTACHMENT_STORE_OP_STORE,
        };
        width = m->width;
        height = m->height;
        const bool all = d->area.extent.width == width && d->area.extent.height == height;
        if (!d->dst || i == 0)
            vk_use(c, m, output, VK_ACCESS_2_COLOR_ATTACHMENT_WRITE_BIT, all);
    }
    use_inputs(c, d, VK_PIPELINE_STAGE_2_FRAGMENT_SHADER_BIT);
    vk_flush_barriers(c);

    const VkRenderingInfo rendering = {
        .sType = VK_STRUCTURE_TYPE_RENDERING_INFO,
        .renderArea = d->area,
        .layerCount = 1,
        .colorAttachmentCount = d->pipeline->attachments,
        .pColorAttachments = attachments,
    };
    const VkViewport viewport = { 0, 0, (float)width, (float)height, 0, 1 };
    vkCmdBeginRendering(c->buffer, &rendering);
    vkCmdBindPipeline(c->buffer, VK_PIPELINE_BIND_POINT_GRAPHICS, d->pipeline->pipeline);
    vkCmdSetViewport(c->buffer, 0, 1, &viewport);
    const unsigned bands = d->bands > 1 ? d->bands : 1, draws = d->rects ? d->n_rects : bands;
    assert(!d->rects || bands == 1);
    for (unsigned i = 0; i < draws; i++) {
        VkRect2D part = d->rects ? d->rects[i] : d->area;
        if (!d->rects) {
            part.extent.height /= bands;
            part.offset.y += (int32_t)(i * part.extent.height);
        }
        vkCmdSetScissor(c->buffer, 0, 1, &part);
        if (i == 0 || bands > 1)
            push_bindings(c, d, i, VK_PIPELINE_BIND_POINT_GRAPHICS, NULL);
        vkCmdDraw(c->buffer, 3, 1, 0, 0);
    }
    vkCmdEndRendering(c->buffer);
    stamp(c);
}

void vk_dispatch(struct vk_commands *c, const struct vk_draw *d, const struct vk_buffer *counts, uint32_t groups_x,
                 uint32_t groups_y)
{
    use_inputs(c, d, VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT);
    vk_flush_barriers(c);
    vkCmdFillBuffer(c->buffer, counts->buffer, 0, VK_WHOLE_SIZE, 0);
    VkMemoryBarrier2 barrier = {
        .sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER_2,
        .srcStageMask = VK_PIPELINE_STAGE_2_ALL_TRANSFER_BIT, // where a fill is one
        .srcAccessMask = VK_ACCESS_2_TRANSFER_WRITE_BIT,
        .dstStageMask = VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT,
        .dstAccessMask = VK_ACCESS_2_SHADER_STORAGE_READ_BIT | VK_ACCESS_2_SHADER_STORAGE_WRITE_BIT,
    };
    const VkDependencyInfo info = {
        .sType = VK_STRUCTURE_TYPE_DEPENDENCY_INFO,
        .memoryBarrierCount = 1,
        .pMemoryBarriers = &barrier,
    };
    vkCmdPipelineBarrier2(c->buffer, &info);
    vkCmdBindPipeline(c->buffer, VK_PIPELINE_BIND_POINT_COMPUTE, d->pipeline->pipeline);
    push_bindings(c, d, 0, VK_PIPELINE_BIND_POINT_COMPUTE, counts);
    vkCmdDispatch(c->buffer, groups_x, groups_y, 1);
    barrier = (VkMemoryBarrier2){
        .sType = VK_STRUCTURE_TYPE_MEMORY_BARRIER_2,
        .srcStageMask = VK_PIPELINE_STAGE_2_COMPUTE_SHADER_BIT,
        .srcAccessMask = VK_ACCESS_2_SHADER_STORAGE_WRITE_BIT,
        .dstStageMask = VK_PIPELINE_STAGE_2_HOST_BIT,
        .dstAccessMask = VK_ACCESS_2_HOST_READ_BIT,
    };
    vkCmdPipelineBarrier2(c->buffer, &info);
    stamp(c);
}
