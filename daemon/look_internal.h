/* SPDX-License-Identifier: Apache-2.0 */
/*
 * look_internal.h - a look as data, made by look_list.c (pure), run by look_run.c, its images and pipelines kept by
 * look_targets.c.
 */
#ifndef AIRYD_LOOK_INTERNAL_H
#define AIRYD_LOOK_INTERNAL_H

#include <assert.h>

#include "bloom_internal.h"
#include "look.h"

enum { LOOK_TAPS_MAX = 16, LOOK_IMAGES_MAX = 24, LOOK_STAGES_MAX = 128, LOOK_PIPELINES_MAX = 64,
       LOOK_SIZE_MAX = 16384 };

struct look_tap {
    float dx, dy; /* texels of the source */
    float weight;
};

enum look_kind {
    LOOK_LOAD_MATTE, /* plane of the matte -> dst */
    LOOK_LOAD,       /* planes of the source, times the matte -> dst */
    LOOK_SAMPLE,     /* weight * sum of taps of src, plus add -> dst */
    LOOK_SUN         /* add + glow -> dst */
};

struct look_stage {
    enum look_kind kind;
    int src, add, dst; /* images; -1: none */
    bool curve;        /* the look's bright curve, of each sample */
    unsigned taps;
    struct look_tap tap[LOOK_TAPS_MAX];
    float weight[3];
};

struct look_facts {
    const struct params *params;
    uint32_t width, height;
    unsigned channels;
    double exposure, pixel_aspect;
    uint32_t display_width;
    bool matte, want_bright;
    double sun_share; /* unoccluded */
};

struct look_list {
    unsigned images, stages;
    struct { uint32_t width, height; } image[LOOK_IMAGES_MAX];
    struct look_stage stage[LOOK_STAGES_MAX];
    int matte, glow, bright; /* images of the result; -1: none */
    enum bright_curve curve;
    double threshold, foot;  /* in use; nothing glows at or below the foot */
    float numbers[4];        /* of the curve, as the shaders take them */
    float sun[8];            /* pixel, rest, 1/(2 r^2), aspect; weight in the stage */
    double error_bound;
};

/* params->look names one. */
void look_list_make(struct look_list *l, const struct look_facts *f);
const char *look_name(int look);

/* Twin of `Stage` in shaders/look.glsl (std140). */
struct stage_uniforms {
    int32_t src[4], add[4], dst[4], mode[4];
    float bright[4], luma[4], weight[4], numbers[4], more[4];
    float tap[LOOK_TAPS_MAX][4];
};
static_assert(sizeof(struct stage_uniforms) == 9 * 16 + LOOK_TAPS_MAX * 16, "std140 twin of Stage");
static_assert(sizeof(struct stage_uniforms) <= UNIFORM_STRIDE, "a stage's uniforms fit their place");

enum { LOOK_DRAWS_MAX = LOOK_STAGES_MAX + BLOOM_OUTPUTS_MAX };

/* Kept between frames: memory grows only, images are made anew when their sizes change. */
struct look_targets {
    bool made;
    unsigned images;
    struct vk_image image[LOOK_IMAGES_MAX];
    struct vk_arena memory;
    struct vk_buffer uniforms;
    unsigned pipelines;
    struct { const char *name; int32_t spec[4]; struct vk_pipeline pipeline; } pipeline[LOOK_PIPELINES_MAX];
    struct look_list list;
};

/* Makes b->look and the images of its list. 0, or -1 and *f. */
int look_targets_create(struct bloom *b, struct fault *f);
int look_targets_prepare(struct bloom *b, struct fault *f);
/* name: of the table of shaders/embed.sh. NULL and *f. */
const struct vk_pipeline *look_pipeline(struct bloom *b, const char *name, VkFormat format, unsigned attachments,
                                        const int32_t spec[4], struct fault *f);

/* Unoccluded share around the sun from the planes of the slot's depth target. */
double look_sun_share(const struct bloom *b, const struct bloom_slot *s, const struct bloom_request *request);
/* The sun's place in pixels from the data window's corner, and its radius in pixel heights. */
void look_sun_place(const struct params *p, uint32_t width, uint32_t height, uint32_t display_width, double aspect,
                    double *x, double *y, double *radius);

#endif
