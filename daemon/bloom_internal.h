/* SPDX-License-Identifier: Apache-2.0 */
/*
 * bloom_internal.h - what the files of the engine share: the layout of levels (twin of
 * shaders/common.glsl), the pipelines by name, the reused targets, the ledger.
 */
#ifndef AIRYD_BLOOM_INTERNAL_H
#define AIRYD_BLOOM_INTERNAL_H

#include <assert.h>

#include "bloom.h"
#include "plan.h"
#include "vk.h"

/* Cells between a level's first stored cell and its cell 0: apron and ring, two texels of 4. */
enum { LEVEL_MARGIN = 8, LEVEL_PHASES = 4 };

/* Twin of `Pass` in shaders/common.glsl (std140). */
struct pass_uniforms {
    int32_t src[4];
    int32_t add[4];
    int32_t frame[4];
    int32_t mode[4];
    float bright[4];
    float luma[4];
    float weight[4];
    float tap[44];
};
static_assert(sizeof(struct pass_uniforms) == 7 * 16 + 11 * 16, "std140 twin of Pass");
static_assert(PSF_TAPS_MAX + 1 <= 44, "taps of a pass");

enum { UNIFORM_STRIDE = 512, PASSES_MAX = 128, PIPELINES_MAX = 128 };

/* A level's logical size; images may be larger. */
struct level {
    uint32_t width, height; /* cells of light: ceil(previous / 2) */
    uint32_t texels;        /* of a row */
    uint32_t groups;        /* of 4 rows, of one channel's block */
};

static inline struct level level_of(uint32_t width, uint32_t height)
{
    return (struct level){ width, height, (width + 3) / 4 + 4, (height + 3) / 4 + 4 };
}

/* What decides the images; equal shapes share them. */
struct targets_shape {
    uint32_t width, height;
    unsigned channels;
    unsigned octaves;   /* levels 1 .. octaves exist */
    bool full_size;     /* E is kept at full size */
    unsigned finest;    /* finest level with a Gaussian */
};

/* Everything between the input and the output planes: shared by all frames, one at a time. */
struct targets {
    bool made;
    struct targets_shape shape;
    struct level level[PSF_LEVELS_MAX + 1];
    struct vk_image layered;              /* the bright pass's result */
    struct vk_image e[PSF_LEVELS_MAX + 1]; /* E at level 1 .. octaves */
    struct vk_image pool[3];              /* kernel rows, sums; of the finest level's size */
    uint32_t layered_groups;              /* of 2 rows */
    struct vk_arena memory;
};

int targets_prepare(struct vk *v, struct targets *t, const struct targets_shape *shape, struct fault *f);
void targets_destroy(struct vk *v, struct targets *t);

struct slot_target {
    struct bloom_geometry geometry;
    struct vk_image in[VK_PLANES]; /* geometry.channels of them */
    struct vk_image out[LEVEL_PHASES];
    VkDeviceSize staging_in, staging_out; /* offsets, when staged */
    uint32_t texels;               /* of a row */
    uint32_t groups;               /* of 4 rows, of a channel's block of out */
};

struct bloom_slot {
    unsigned count;
    struct slot_target target[BLOOM_TARGETS_MAX];
    struct vk_arena memory;
    struct vk_buffer staging;
};

void slot_destroy(struct vk *v, struct bloom_slot *s);

/* ---- the ledger: sums over E, read back from small pieces of the pyramid ------------------------- */

struct ledger_region { /* cells of one level, all its channels */
    unsigned level;
    uint32_t column0, columns; /* texels */
    uint32_t group0, groups;   /* within a channel's block */
    VkDeviceSize offset;       /* in the read-back buffer: [channel][phase][group][texel] */
};

enum { LEDGER_REGIONS_MAX = 4 * (PSF_LEVELS_MAX + 1) + 1 };

struct ledger {
    unsigned count;
    struct ledger_region region[LEDGER_REGIONS_MAX];
    unsigned total_region; /* covers all of the coarsest level */
    VkDeviceSize bytes;
    /* Per Gaussian and axis: the share of a cell's light that stays inside, [cell + LEVEL_MARGIN]. */
    double *inside_x[PARAMS_GAUSSIANS_MAX], *inside_y[PARAMS_GAUSSIANS_MAX];
    struct vk_buffer buffer;
};

/* Works out the regions for a plan on these levels. 0, or -1 and *f. */
int ledger_prepare(struct ledger *l, const struct plan *p, const struct targets *t, struct fault *f);
void ledger_clear(struct ledger *l); /* keeps the buffer */
int ledger_record(struct vk_commands *c, struct ledger *l, struct targets *t, struct fault *f);
/* E's sum and the sum of intensity * B that falls outside the data window. */
void ledger_sum(const struct ledger *l, const struct plan *p, const struct targets *t, double intensity,
                double *bright, double *lost);

/* ---- the engine ------------------------------------------------------------------------------------ */

struct named_pipeline {
    char name[40];
    int32_t spec;
    struct vk_pipeline pipeline;
};

enum { PLANS_MAX = 8 };
struct planned {
    uint64_t asked; /* when last; 0: empty */
    struct psf_spec spec;
    double tolerance, aspect;
    uint32_t width, height;
    struct plan plan;
};

struct bloom {
    struct vk vk;
    struct bloom_device_info info;
    bool staged;
    struct named_pipeline pipeline[PIPELINES_MAX];
    unsigned pipelines;
    struct vk_commands commands;
    struct vk_buffer uniforms;
    unsigned passes; /* recorded so far in this frame */
    const char *pass_name[PASSES_MAX];
    struct targets targets;
    struct ledger ledger;
    /* Plans and what they were made for: a request that came lately costs nothing to plan. */
    struct planned planned[PLANS_MAX];
    uint64_t plans_asked;
    const struct plan *plan;          /* the one in use */
    const struct plan *prepared;      /* the one that targets and ledger are made for; NULL: none */
    unsigned octaves;
    unsigned slots;
    struct bloom_slot slot[8];
    struct bloom_slot warm_slot; /* for first draws: the others' planes are in use */
    unsigned warmed;             /* steps of bloom_warm_next that are done */
};

/* Finds or builds the pipeline of a shader variant. NULL and *f on failure. */
const struct vk_pipeline *pipeline_get(struct bloom *b, struct fault *f, int32_t spec, const char *format,
                                       ...) __attribute__((format(printf, 4, 5)));
/* Also draws once with the pipelines of common requests, or with all. */
int bloom_self_test(struct bloom *b, bool all, struct fault *f);

#endif
