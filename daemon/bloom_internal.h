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
    float limit[4];
    float dirt[4];
    int32_t window[4];
    float tap[44];
};
static_assert(sizeof(struct pass_uniforms) == 10 * 16 + 11 * 16, "std140 twin of Pass");
static_assert(PSF_TAPS_MAX + 1 <= 44, "taps of a pass");

enum { EXCHANGE_USAGE = VK_BUFFER_USAGE_TRANSFER_SRC_BIT | VK_BUFFER_USAGE_TRANSFER_DST_BIT };
enum { UNIFORM_STRIDE = 512, PASSES_MAX = 512, PIPELINES_MAX = 512 };

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
    uint32_t width, height; /* of the canvas: the planes, and with edge=fill what lies around them */
    unsigned channels;
    unsigned octaves;   /* levels 1 .. octaves exist */
    bool full_size;     /* E is kept at full size */
    unsigned finest;    /* finest level with a Gaussian */
    bool half;          /* levels are stored as half, else float32 */
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

bool targets_same(const struct targets *t, const struct targets_shape *s);
int targets_prepare(struct vk *v, struct targets *t, const struct targets_shape *shape, struct fault *f);
void targets_destroy(struct vk *v, struct targets *t);

struct slot_target {
    struct bloom_geometry geometry;
    uint32_t width, height;        /* of the planes: the geometry's, grown on each side */
    struct vk_image in[VK_PLANES]; /* geometry.channels of them */
    struct vk_image out[BLOOM_OUTPUTS_MAX][LEVEL_PHASES];
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

/* A target's input planes, as bloom_slot_prepare returned them. */
void slot_input(const struct bloom *b, const struct bloom_slot *s, unsigned target, struct planes *in);
/* When staged, else nothing: records the copy of a target's input planes to the device (up), or of its output planes from it. */
void slot_copy(struct bloom *b, struct bloom_slot *s, struct slot_target *t, bool up);
/* Pictures that a scene target's output planes hold, and the image of one's rows y % LEVEL_PHASES == phase. */
static inline unsigned slot_outputs(const struct slot_target *t) { return t->geometry.outputs; }
static inline struct vk_image *slot_output(struct slot_target *t, unsigned output, unsigned phase)
{
    assert(output < slot_outputs(t));
    return &t->out[output][phase];
}

/* ---- the ledger: sums over E, read back from small pieces of the pyramid ------------------------- */

struct ledger_region { /* cells of one level, all its channels */
    unsigned level;
    uint32_t column0, columns; /* texels */
    uint32_t group0, groups;   /* within a channel's block */
    VkDeviceSize offset;       /* in the read-back buffer: [channel][phase][group][texel] */
};

/* Sums of E inside the window made for their own sake: before firefly and clamp, before clamp, and as it is. */
enum { TOTAL_RAW, TOTAL_UNCLAMPED, TOTAL_BRIGHT, LEDGER_TOTALS, LEDGER_REGIONS_MAX = 4 * (PSF_LEVELS_MAX + 1) + 1 + LEDGER_TOTALS };

struct ledger {
    unsigned count;
    struct ledger_region region[LEDGER_REGIONS_MAX];
    unsigned total_region; /* covers all of the coarsest level; after it LEDGER_TOTALS of the same shape */
    VkDeviceSize bytes;
    bool whole;            /* the levels are read back whole */
    /* Per Gaussian and axis: the share of a cell's light that stays inside, [cell + LEVEL_MARGIN]. */
    double *inside_x[PARAMS_GAUSSIANS_MAX], *inside_y[PARAMS_GAUSSIANS_MAX];
    struct vk_buffer buffer;
};

/* Works out the regions for a plan on these levels; pad: pixels of the canvas around the data window. 0, or -1 and *f. */
int ledger_prepare(struct ledger *l, const struct plan *p, const struct targets *t, uint32_t pad, struct fault *f);
void ledger_clear(struct ledger *l); /* keeps the buffer */
int ledger_record(struct vk_commands *c, struct ledger *l, struct targets *t, struct fault *f);
/* Only the coarsest level, as E is now, into the i-th of the other totals. */
int ledger_record_total(struct vk_commands *c, struct ledger *l, struct targets *t, unsigned i, struct fault *f);
struct ledger_sums {
    double bright;  /* E on the canvas */
    double spread;  /* weights * E: what B would be on a canvas without end */
    double inside, outside; /* of it, and outside the data window */
    double total[LEDGER_TOTALS];
};
/* scale: what the stored numbers were multiplied by. */
void ledger_sum(const struct ledger *l, const struct plan *p, const struct targets *t, double scale, struct ledger_sums *out);

/* ---- the engine ------------------------------------------------------------------------------------ */

struct named_pipeline {
    char name[40];
    int32_t spec;
    uint64_t used; /* in which recording, last */
    struct vk_pipeline pipeline;
};

enum { PLANS_MAX = 8 };
struct planned {
    uint64_t asked; /* when last; 0: empty */
    struct psf_spec spec;
    double near_gain, far_gain, sensor_mm, tolerance, budget_ms;
    struct plan_facts facts;
    struct plan plan;
};

/* What a frame costs on this device, measured at its start: fixed + pixels * channels * (base + per_mac * cost of the plan). */
struct cost_model {
    double fixed_ms, base_ns, mac_ns;
};

struct convolver;
struct look_targets;

/* ---- a wall's picture: what is kept from frame to frame of the same wall, target and plan -------------------- */

enum { WALL_KEPT = 4, WALL_SOURCES_MAX = PARAMS_GAUSSIANS_MAX + 2 };

/* What is resampled to the wall: the picture itself, a Gaussian of E at a level, or the sum of several at one. */
struct wall_source {
    int gaussian;              /* of the plan; -1: the picture, the sum */
    unsigned level;
    struct vk_image down;      /* weights, shaders/wall_rows.frag */
    uint32_t taps_down, taps_across; /* most that a sum has */
    unsigned chunks_across;
    uint32_t column, texels;   /* where its rows are in wall_work.rows */
};

/* One axis of a source, for the host: wall column (row) i is the sum of count[i] cells from first[i] on, counted from the first
 * one kept. */
struct wall_taps {
    uint32_t n, room;          /* columns; weights that each has room for */
    uint32_t *first, *count;
    float *weight;             /* [n][room] */
};

struct wall_work {
    uint64_t used;             /* bloom.walls_asked when last; 0: empty */
    struct bloom_wall wall;    /* its pointers are not looked at */
    uint32_t width, height;    /* of the target */
    unsigned channels;
    bool direct;
    struct plan plan;
    unsigned sources;
    bool summed;               /* the last one is the sum */
    struct wall_source source[WALL_SOURCES_MAX];
    struct vk_image across;    /* weights of all sources, shaders/wall_columns.frag */
    struct vk_image rows;      /* sources beside, channels below each other */
    struct vk_image drive, gain;
    bool has_gain;
    uint64_t gain_id;
    struct vk_memory memory;
    struct vk_buffer back;     /* the drive, R G B 0 */
    /* On the host, in place of all images: */
    bool host;
    struct wall_taps taps[WALL_SOURCES_MAX][2]; /* down, across */
    float *light;              /* [bands of HOST_ROWS rows][3][columns][HOST_ROWS]: the picture's mean, then the glow's too */
};

struct bloom {
    struct vk vk;
    struct bloom_device_info info;
    bool staged, whole;
    struct named_pipeline pipeline[PIPELINES_MAX];
    unsigned pipelines;
    struct vk_commands commands;
    struct vk_buffer uniforms;
    unsigned passes; /* recorded so far in this frame */
    uint64_t recordings;
    const char *pass_name[PASSES_MAX];
    struct targets targets;
    struct ledger ledger;
    struct vk_buffer counts;          /* exposure=auto's histogram */
    struct vk_image blank;            /* 1 x 1, for a binding that nothing reads */
    struct vk_image dirt;
    struct vk_memory blank_memory, dirt_memory;
    char dirt_digest[33];             /* of what the dirt image holds; "": none */
    struct vk_buffer exchange;        /* pixels to and from the host: dirt, FFT */
    struct convolver *convolver;      /* of the kernel that was asked for last */
    char convolver_key[PARAMS_TEXT_MAX + 128];
    struct cost_model cost;
    unsigned threads;                 /* for what the host does */
    struct look_targets *look;
    struct host *host;                /* bloom_host.h; made when first needed */
    struct wall_work *wall[WALL_KEPT]; /* made when first needed */
    uint64_t walls_asked;
    /* Plans and what they were made for: a request that came lately costs nothing to plan. */
    struct planned planned[PLANS_MAX];
    uint64_t plans_asked;
    const struct plan *plan;          /* the one in use */
    const struct plan *prepared;      /* the one that targets and ledger are made for; NULL: none */
    uint32_t prepared_pad;            /* of the ledger */
    unsigned slots;
    struct bloom_slot slot[BLOOM_SLOTS_MAX];
    struct bloom_slot warm_slot; /* for first draws: the others' planes are in use */
    unsigned warmed;             /* steps of bloom_warm_next that are done */
};

/* ---- one frame being bloomed ----------------------------------------------------------------------- */

struct frame {
    struct bloom *b;
    struct bloom_slot *slot;
    struct slot_target *target;  /* the scene */
    struct slot_target *source;  /* what glows: the scene, or another target */
    struct slot_target *matte;   /* NULL: none */
    const struct frame_scan *scan; /* of the source */
    const struct bloom_request *request;
    const struct params *params;
    double exposure;             /* stops in use */
    double threshold, knee;      /* in use: exposure applied */
    uint32_t pad;                /* pixels of the canvas around the planes: edge=fill */
    bool fft;                    /* the psf is a kernel: no plan */
    bool keeps_e;                /* E is wanted at full size by more than the spread */
    bool rich;                   /* the bright pass is extract.frag */
    struct ledger_sums sums;
    double most_glow;            /* an upper bound of intensity * B */
    uint32_t skip;               /* bit g: the plan's Gaussian g is left out, for it cannot reach half a step of the output; */
    double skip_bound;           /* what that is at most, of intensity * max E */
    bool half;                   /* levels are stored as half, */
    double scale;                /* all their numbers times this power of 2; else 1 */
    const struct bloom_wall *wall; /* NULL: output planes */
    bool wall_direct;            /* no composite: */
    bool wall_host;              /* by bloom_host.h */
    unsigned wall_level;         /* level at which the sum of Gaussians ends */
    const struct lit *lit;       /* where E may be above 0; NULL: anywhere */
    struct fault *f;
};

/* The parts of the planes in which some tile has a highlight: runs of tiles, so a few rectangles; pixels. */
enum { LIT_MAX = 48 };
struct lit {
    unsigned count;
    uint32_t x0[LIT_MAX], y0[LIT_MAX], x1[LIT_MAX], y1[LIT_MAX];
    double share; /* of all tiles, those inside */
};

/* ---- bloom_plan.c ---- */
/* b->plan: from the cache, or made in the place of the one that nobody has asked for longest. */
int plan_find(struct bloom *b, const struct bloom_request *r, const struct bloom_geometry *g, struct fault *f);
void plan_describe(struct bloom *b, const struct params *p, struct bloom_reply *r);

/* ---- bloom_bright.c: what glows, without looking at pixels ---- */
void bright_set(struct frame *fr);
/* Tiles, tiles_bright and max_bright of the reply. */
void bright_count(const struct frame *fr, struct bloom_reply *reply);
/* May this tile of the scan glow? */
bool bright_tile(const struct frame *fr, uint32_t tile);
/* The curve's numbers as pass_uniforms.bright has them. */
void bright_curve(const struct frame *fr, float curve[4]);
/* False: nearly everywhere, or too scattered to be worth it. */
bool bright_lit(const struct frame *fr, struct lit *out);
/* Sets skip and skip_bound: for a scene-linear picture of half, Gaussians whose sum stays below half of its smallest step. */
void bright_skip(struct frame *fr, const struct bloom_reply *reply);
/* What E's own arithmetic rounds off, of max E. */
double bright_rounding(const struct frame *fr, const struct bloom_reply *reply);

/* ---- bloom_record.c: passes ---- */
struct pass_uniforms *pass_begin(struct frame *fr, struct vk_draw *d);
/* Three images go round: one holds the sum so far, the others the next rows and the next sum. */
struct round {
    struct vk_image *sum, *rows, *next;
    bool any; /* sum holds something */
};
int record_begin(struct frame *fr);
/* Bright pass, and E's levels. */
int record_bright(struct frame *fr);
/* E's sums of the ledger that the frame itself does not have, when firefly, clamp or edge=fill were asked for. */
int record_totals(struct frame *fr);
/* Only the Gaussian of this index, -1: all. *r: any is false when there is none. */
int record_spread(struct frame *fr, int only, struct round *r);
/* Does the plain composite make this picture, when there is glow? */
bool is_plain_picture(const struct frame *fr, const struct view_spec *view);
/* One output: what it shows of the sum (NULL: no glow). */
int record_output(struct frame *fr, unsigned output, const struct view_spec *view, struct vk_image *sum);
int record_end(struct frame *fr);

/* ---- bloom_meter.c: exposure=auto ---- */
int meter_exposure(struct frame *fr, double *stops);

/* ---- bloom_fft.c: kernels that are no sum of Gaussians ---- */
/* After record_bright with E at full size: submits, convolves, begins anew with the glow in *sum. */
int fft_spread(struct frame *fr, struct vk_image **sum);
double fft_bound(const struct frame *fr);
int fft_prepare(struct frame *fr);
void fft_destroy(struct bloom *b);

/* ---- bloom_wall.c, bloom_wall_table.c ---- */
/* Where the sum of a plan's Gaussians ends on this device. */
unsigned wall_level(const struct bloom *b, const struct plan *p, const struct bloom_wall *w);
/* Wall, params and target against each other. */
int wall_check(const struct frame *fr);
/* A direct wall's frame, from begin to drive; dark: nothing glows. */
int wall_run(struct frame *fr, bool dark);
/* Any other's, after the frame: from the output planes or, untouched, from the input's. */
int wall_run_output(struct frame *fr, bool untouched);
/* What resampling rounds off, of what is resampled; after wall_run. */
double wall_rounding(const struct frame *fr);
/* The new exposure of a->stops that meets what is metered; *a stays. */
double bloom_adapt_stops(const struct bloom_adapt *a, double metered);
/* Finds or makes what this wall, target and plan keep. Needs the targets. It may submit. */
int wall_work_find(struct frame *fr, struct wall_work **out);
void wall_work_destroy(struct vk *v, struct wall_work *k); /* NULL is fine */

/* ---- bloom_cost.c ---- */
int cost_measure(struct bloom *b, struct fault *f);
double cost_predict(const struct bloom *b, const struct plan *p, const struct bloom_geometry *g);

/* Dirt or another host image into the device's, before what is recorded next. */
int dirt_upload(struct frame *fr, const struct bloom_image *image);

/* SPIR-V of the full-screen triangle. */
const uint32_t *pipeline_vertex(size_t *bytes);
double bloom_now_ms(void); /* CLOCK_MONOTONIC */
/* Finds or builds the pipeline of a shader variant. NULL and *f on failure. */
const struct vk_pipeline *pipeline_get(struct bloom *b, struct fault *f, int32_t spec, const char *format,
                                       ...) __attribute__((format(printf, 4, 5)));
/* Also draws once with the pipelines of common requests, or with all. */
int bloom_self_test(struct bloom *b, bool all, struct fault *f);

#endif
