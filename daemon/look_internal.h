/* SPDX-License-Identifier: Apache-2.0 */
/*
 * look_internal.h - a look as data, made by look_list.c (pure), its error bounded by look_bound.c (pure), run by look_run.c, its
 * images and pipelines kept by look_targets.c, its light summed by look_energy.c.
 *
 * Images hold a pixel a texel, all channels in it; or they are rows: 4 pixels of a channel in a texel, the channels in 3 layers. What
 * the stores, one channel each, draw up is rows of the frame's width first: that is half of the bilinear sample, made once for three
 * stores at the smaller image's height. One image of rows holds several sections below each other, which a store adds up.
 */
#ifndef AIRYD_LOOK_INTERNAL_H
#define AIRYD_LOOK_INTERNAL_H

#include <assert.h>

#include "bloom_internal.h"
#include "look.h"

enum { LOOK_TAPS_MAX = 20, LOOK_IMAGES_MAX = 32, LOOK_STAGES_MAX = 136, LOOK_PIPELINES_MAX = 128, LOOK_SECTIONS_MAX = 8,
       LOOK_SUM_COLUMNS = 16, LOOK_SIZE_MAX = 16384 };

struct look_tap {
    double dx, dy; /* whole texels of the source */
    double weight;
};

enum look_kind {
    LOOK_LOAD_MATTE, /* plane of the matte -> dst */
    LOOK_LOAD,       /* planes of the source, times the matte -> dst */
    LOOK_LOAD_HALF,  /* planes of the source, of even sizes, halved -> dst */
    LOOK_LOAD_ROWS,  /* planes of the source -> dst, rows */
    LOOK_SAMPLE,     /* weight * sum of taps of src, plus add -> dst */
    LOOK_ROWS,       /* src -> dst, rows from row `first` on */
    LOOK_MIX,        /* curve of add, rows, and of the sections of src, plus the sun -> dst, rows */
    LOOK_SUM         /* light of src, or of rows, a column of texels each -> dst */
};

struct look_stage {
    enum look_kind kind;
    int src, add, dst; /* images; -1: none */
    bool curve;        /* the look's bright curve, of each sample */
    bool after;        /* LOAD_HALF: of the mean */
    uint32_t first;    /* ROWS: of dst */
    unsigned taps;     /* MIX: of add, then of the sections; only weights */
    struct look_tap tap[LOOK_TAPS_MAX];
    float weight[3];
};

/* What a store shows: sections of rows. */
struct look_rows {
    int image;         /* -1: none */
    unsigned sections;
    struct { uint32_t first, height; } section[LOOK_SECTIONS_MAX];
};

/* Light: factor * sum over the rows of image `sums`, each as often as the frame's rows sample it. */
struct look_light {
    int sums;          /* -1: not asked for */
    double factor;
    struct look_rows of; /* image -1: each row once */
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
    struct { uint32_t width, height, layers; } image[LOOK_IMAGES_MAX]; /* texels */
    struct look_stage stage[LOOK_STAGES_MAX];
    int matte;               /* image; -1: none */
    struct look_rows glow, bright; /* bright: made when a view shows it, or its light is summed so */
    struct look_rows mips;   /* mip-chain's, from the second on */
    struct look_light glow_light, bright_light;
    enum bright_curve curve;
    double threshold, foot;  /* in use; nothing glows at or below the foot */
    float numbers[4];        /* of the curve, as the shaders take them */
    float sun[8];            /* pixel, rest, 1/(2 r^2), aspect; weight in the stage */
    double error_bound;
};

/* params->look names one. */
void look_list_make(struct look_list *l, const struct look_facts *f);
/* l->error_bound, of a list that is made. */
void look_bound(struct look_list *l, const struct look_facts *f);
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
    struct vk_buffer sums;   /* the lists' sums, for the host */
    unsigned pipelines;
    /* When it is full the one that was used least lately makes room; `used` is the run, and one run uses far fewer than all. */
    struct { const char *name; int32_t spec[4]; uint64_t used; struct vk_pipeline pipeline; } pipeline[LOOK_PIPELINES_MAX];
    uint64_t runs;
    struct look_list list;
};

/* Makes b->look and the images of its list. 0, or -1 and *f. */
int look_targets_create(struct bloom *b, struct fault *f);
int look_targets_prepare(struct bloom *b, struct fault *f);
/* name: of the table of shaders/embed.sh. NULL and *f. */
const struct vk_pipeline *look_pipeline(struct bloom *b, const char *name, VkFormat format, unsigned attachments,
                                        const int32_t spec[4], struct fault *f);

/* Records the copy of both lights' sums to the host. */
int look_energy_record(struct bloom *b, struct fault *f);
/* After the submission: what they come to. scale: of the sums. */
void look_energy(const struct bloom *b, uint32_t height, double scale, double *bright, double *glow);

/* Unoccluded share around the sun from the planes of the slot's depth target. */
double look_sun_share(const struct bloom *b, const struct bloom_slot *s, const struct bloom_request *request);
/* The sun's place in pixels from the data window's corner, and its radius in pixel heights. */
void look_sun_place(const struct params *p, uint32_t width, uint32_t height, uint32_t display_width, double aspect,
                    double *x, double *y, double *radius);

#endif
