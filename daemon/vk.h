/* SPDX-License-Identifier: Apache-2.0 */
/*
 * vk.h - Vulkan 1.3 in the small: one device and queue, memory that only grows, images that know their
 * last access, pipelines from a static table, one timeline semaphore. Knows no bloom and no sockets.
 *
 * Every image stays in VK_IMAGE_LAYOUT_GENERAL after its first use: on the devices of interest that
 * costs nothing, and it leaves barriers with one job, ordering. All functions return 0, or -1 with *f
 * filled (FAULT_DEVICE_LOST, FAULT_NO_MEMORY, FAULT_INTERNAL).
 */
#ifndef AIRYD_VK_H
#define AIRYD_VK_H

#include <vulkan/vulkan.h>

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "fault.h"

enum { VK_PLANES = 3, VK_ATTACHMENTS_MAX = 8, VK_LAYERS_MAX = 8 };

struct vk {
    VkInstance instance;
    VkPhysicalDevice physical;
    VkDevice device;
    VkQueue queue;
    uint32_t family;
    VkPhysicalDeviceProperties properties;
    char driver[256];
    VkPhysicalDeviceMemoryProperties memory;
    VkDeviceSize block_max;        /* largest single allocation */
    bool cpu;                      /* pixels are in the host's memory anyway: no staging */
    VkDescriptorSetLayout set_layout;
    VkPipelineLayout pipeline_layout;
    VkShaderModule vertex;
    VkCommandPool pool;
    VkSemaphore timeline;
    uint64_t timeline_value;
    PFN_vkCmdPushDescriptorSetKHR push_descriptor_set;
    VkDebugUtilsMessengerEXT messenger;
    unsigned messages;             /* validation messages so far */
    void (*log)(const char *line);
};

/* vertex: SPIR-V of the full-screen triangle. */
int vk_open(struct vk *v, const char *device, bool validate, void (*log)(const char *),
            const uint32_t *vertex, size_t vertex_bytes, struct fault *f);
void vk_close(struct vk *v); /* takes a half-opened one */
void vk_list(void (*print)(const char *line));
int vk_fault(struct fault *f, VkResult r, const char *what); /* fills *f, returns -1 */

/* Wait for this long at most for anything on the device; beyond it the device counts as lost. */
enum { VK_WAIT_S = 60 };

/* ---- memory ------------------------------------------------------------------------------------ */

/* One allocation that grows (by being made anew) and never shrinks. */
struct vk_memory {
    VkDeviceMemory memory;
    VkDeviceSize size;
    uint32_t type;
    uint8_t *map; /* of host-visible memory, for as long as it lives */
};
enum vk_place { VK_PLACE_DEVICE, VK_PLACE_HOST };

/* As many of these as it takes: no device gives more than its limit in one piece. */
enum { VK_BLOCKS_MAX = 16 };
struct vk_arena {
    struct vk_memory block[VK_BLOCKS_MAX];
};

/* Makes sure of `size` bytes of a type in `type_bits`. It may be made anew: what was bound to it must have been
 * destroyed before. */
int vk_memory_reserve(struct vk *v, struct vk_memory *m, VkDeviceSize size, uint32_t type_bits,
                      enum vk_place place, struct fault *f);
void vk_memory_free(struct vk *v, struct vk_memory *m);
void vk_arena_free(struct vk *v, struct vk_arena *a);

/* ---- images and buffers ------------------------------------------------------------------------ */

struct vk_image {
    VkImage image;
    VkImageView view;                      /* all layers, as a 2D array when layers > 1 */
    VkImageView layer_view[VK_LAYERS_MAX]; /* attachments */
    VkFormat format;
    uint32_t width, height, layers;
    VkMemoryRequirements needs;
    bool linear;
    size_t row_pitch_bytes;                /* of linear images */
    uint8_t *host;                         /* its first byte, in host-visible memory; else NULL */
    VkPipelineStageFlags2 stage;           /* last access */
    VkAccessFlags2 access;
    VkImageLayout layout;
};

/* Creates the image (no memory yet: `needs` tells). linear: laid out in rows for the host; one layer. */
int vk_image_create(struct vk *v, struct vk_image *m, VkFormat format, uint32_t width, uint32_t height,
                    uint32_t layers, bool linear, struct fault *f);
int vk_image_bind(struct vk *v, struct vk_image *m, struct vk_memory *memory, VkDeviceSize offset,
                  struct fault *f);
void vk_image_destroy(struct vk *v, struct vk_image *m);

struct vk_buffer {
    VkBuffer buffer;
    VkDeviceSize size;
    struct vk_memory memory; /* host-visible, mapped */
};
int vk_buffer_reserve(struct vk *v, struct vk_buffer *b, VkDeviceSize size, VkBufferUsageFlags usage,
                      struct fault *f);
void vk_buffer_free(struct vk *v, struct vk_buffer *b);

/* ---- recording --------------------------------------------------------------------------------- */

/* Barriers are gathered and issued together, just before the pass that needs them. */
struct vk_commands {
    struct vk *vk;
    VkCommandBuffer buffer;
    VkImageMemoryBarrier2 barrier[32];
    unsigned barriers;
    VkQueryPool queries; /* one time stamp after each draw, when profiling */
    uint32_t stamps;
};
enum { VK_STAMPS_MAX = 256 };

int vk_commands_create(struct vk *v, struct vk_commands *c, bool profile, struct fault *f);
void vk_commands_destroy(struct vk_commands *c);
int vk_begin(struct vk_commands *c, struct fault *f);
/* Says how m is used next; discard: its content is not needed. */
void vk_use(struct vk_commands *c, struct vk_image *m, VkPipelineStageFlags2 stage, VkAccessFlags2 access,
            bool discard);
void vk_flush_barriers(struct vk_commands *c);
/* Host writes before, host reads after: submission makes the first visible, this the second. */
void vk_to_host(struct vk_commands *c);
/* Submits and waits, at most VK_WAIT_S seconds. */
int vk_submit_and_wait(struct vk_commands *c, struct fault *f);

/* After vk_submit_and_wait: milliseconds from the start of the commands to the end of draw i; n read. */
unsigned vk_stamps_ms(struct vk_commands *c, double *out, unsigned n);

/* ---- passes ------------------------------------------------------------------------------------ */

/* A full-screen fragment pass: reads images by imageLoad, writes colour attachments. The one descriptor
 * set: 0 src and 1 add (2D arrays), 2 in[3] (2D, rgba32ui), 3 the pass's uniform block, 4 matte (2D, rgba32ui),
 * 5 dirt (2D, rgba32f), 6 a storage buffer (compute only). */
struct vk_pipeline {
    VkPipeline pipeline;
    unsigned attachments;
    VkFormat format;
};
int vk_pipeline_create(struct vk *v, struct vk_pipeline *p, const uint32_t *spirv, size_t bytes,
                       VkFormat format, unsigned attachments, const int32_t *spec, unsigned n_spec,
                       struct fault *f);
int vk_compute_create(struct vk *v, struct vk_pipeline *p, const uint32_t *spirv, size_t bytes, struct fault *f);
void vk_pipeline_destroy(struct vk *v, struct vk_pipeline *p);

struct vk_draw {
    const struct vk_pipeline *pipeline;
    struct vk_image *src, *add;            /* NULL: not read */
    struct vk_image *in[VK_PLANES];
    struct vk_image *matte, *dirt;         /* NULL: not read */
    struct vk_image *dst;                  /* its layers are the attachments */
    struct vk_image *dst_each[VK_ATTACHMENTS_MAX]; /* or images of one layer, when dst is NULL */
    VkRect2D area;                         /* of the attachments; nothing outside is written */
    unsigned bands;                        /* > 1: the area is drawn in so many bands of equal height, and
                                              band i finds in[i] where a single band finds in[0] */
    bool all_planes;                       /* but every band finds all of in[] */
    const VkRect2D *rects;                 /* NULL: all of the area. Else it is cleared to 0 and only these are drawn */
    unsigned n_rects;
    VkBuffer uniforms;
    VkDeviceSize uniforms_offset, uniforms_bytes;
};
void vk_draw(struct vk_commands *c, const struct vk_draw *d);
/* A compute pass: reads d's images, adds to the counters in `counts`, which the host may read after the submission. */
void vk_dispatch(struct vk_commands *c, const struct vk_draw *d, const struct vk_buffer *counts, uint32_t groups_x,
                 uint32_t groups_y);

#endif
