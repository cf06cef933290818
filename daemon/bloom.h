/* SPDX-License-Identifier: Apache-2.0 */
/*
 * bloom.h - the engine: one Vulkan device, its pipelines and reused targets, and the recording of a
 * plan. METHODS' pipeline (bright pass, spread, composite) on planes.
 *
 * Threads: bloom_run and bloom_slot_prepare may be called from one thread at a time (the device
 * thread). The planes that bloom_slot_prepare returns are plain memory, mapped for as long as the slot
 * is not prepared again: any thread may write the input planes before bloom_run and read the output
 * planes after it.
 */
#ifndef AIRYD_BLOOM_H
#define AIRYD_BLOOM_H

#include "fault.h"
#include "frame.h"
#include "params.h"

struct bloom;
struct bloom_slot;

enum { BLOOM_SLOTS_MAX = 9 };

struct bloom_options {
    const char *device;  /* NULL or "": best; "cpu", "gpu", an index, or part of a name */
    unsigned slots;      /* frames that can be in the pipeline at once, 1..BLOOM_SLOTS_MAX */
    unsigned threads;    /* for what the host does of a frame's bloom (FFT); 0: 2 */
    bool validate;       /* Vulkan validation with synchronisation validation; any message is counted */
    bool warm_all;       /* draw with every pipeline at start, not only with those of common requests: some
                            20 s when the driver has none of them in its cache, 2 s when it has */
    bool profile;        /* log the time of each pass (METHODS' stages) of every frame */
    bool whole;          /* draw also where nothing can glow (for tests) */
    bool staged;         /* copy through staging buffers even where the device needs none (for tests) */
    void (*log)(const char *line); /* may be NULL */
};

struct bloom_device_info {
    char name[256], driver[256];
    bool cpu;
    uint32_t max_dimension;
};

/* Opens the device, builds and warms every pipeline with a real draw, runs the self-test (a small frame
 * against numbers worked out in double on the CPU). 0, or -1 and *f. */
int bloom_create(struct bloom **out, const struct bloom_options *options, struct fault *f);
void bloom_destroy(struct bloom *b);
const struct bloom_device_info *bloom_device(const struct bloom *b);
unsigned bloom_validation_messages(const struct bloom *b);
/* Draws with pipelines that have not drawn yet, a few at a time (up to some 0.3 s each call when the driver has none in
 * its cache), beside the slots. True while there is more; false when all have drawn, or with *f (code not FAULT_NONE) when one
 * failed. On the device thread. */
bool bloom_warm_next(struct bloom *b, struct fault *f);
/* Pipelines that have been made (and so have drawn), and how many there are for plain requests; those that few
 * ask for are made when they are first needed. */
unsigned bloom_pipelines(const struct bloom *b, unsigned *possible);
/* Prints the devices that --device could name, one a line. */
void bloom_list_devices(void (*print)(const char *line));

struct bloom_slot *bloom_slot(struct bloom *b, unsigned i);

enum { BLOOM_TARGETS_MAX = 16, BLOOM_OUTPUTS_MAX = 1 + PARAMS_LAYERS_MAX };

struct bloom_geometry {
    uint32_t width, height;
    unsigned channels;      /* 1 or 3 */
    enum pixel_type type;   /* HALF or FLOAT */
    uint32_t grow;          /* pixels: the output planes are this much larger on each side */
    unsigned outputs;       /* 1 + extra layers; 0: only read (a glow source, matte or depth) */
};

static inline bool bloom_geometry_same(const struct bloom_geometry *a, const struct bloom_geometry *b)
{
    return a->width == b->width && a->height == b->height && a->channels == b->channels && a->type == b->type &&
           a->grow == b->grow && a->outputs == b->outputs;
}

/* Makes room for a job's targets; memory only grows, and nothing is allocated when the same
 * geometry comes again. in[i] receives the input planes, out[i * BLOOM_OUTPUTS_MAX + k] the k-th output's:
 * 0 the picture, then the extra layers. */
int bloom_slot_prepare(struct bloom *b, struct bloom_slot *s, unsigned count,
                       const struct bloom_geometry *geometry, struct planes *in, struct planes *out,
                       struct fault *f);

/* Gives the slot's memory back; its planes are gone until it is prepared again. On the device thread. */
void bloom_slot_release(struct bloom *b, struct bloom_slot *s);
/* Gives back what is kept between frames and shared by all slots (enum bloom_keep): the next frame makes it again. On the device thread. */
void bloom_levels_release(struct bloom *b);

/* An image that a request names by digest: lens dirt, or a kernel. Plain rows of interleaved R G B floats,
 * all finite, >= 0; the owner keeps it unchanged until bloom_run returns. */
struct bloom_image {
    uint32_t width, height;
    const float *rgb;
    char digest[33];
};

/* Auto exposure over time, frame-rate independent: stops += (metered - stops) * (1 - exp(-step_s / tau)). The first frame has what is
 * metered. "Up" and "down" are the scene's light's: up_s when it has grown brighter (metered < stops: the exposure falls), down_s when
 * it has grown darker. The owner keeps it between frames; bloom_run changes started and stops, when it succeeds. Without
 * params' exposure=auto it is not looked at. */
struct bloom_adapt {
    bool started;
    double stops;
    double up_s, down_s; /* time constants; 0: at once */
    double step_s;       /* since the frame before */
};

/*
 * A wall's picture of a target, in place of output planes: each wall pixel is the mean of the composited frame
 * (METHODS section 1, step 7) over its rectangle, in linear light, by area; outside the target there is no light, and a sample that is
 * not finite has none but its glow. Then times 2^exposure, below 0 is 0, tone map, saturation (with Rec.709's luma), matrix, gain:
 * LED's "linear drive", not yet held to 0..1 (but light beyond 1e30 counts as 1e30).
 * Wall pixel (i, j) covers x + i * pitch_x ... x + (i + 1) * pitch_x pixels of the frame, y alike. The target is the frame, or a
 * part of it at frame_x, frame_y: x and y do not change with the part.
 * Where the picture is plain (bloom_wall_is_direct) nothing is composited at full size: only what the wall can show is computed.
 * The same wall pixel gets the same bits from any part of the frame that has all its light (bloom_wall_need), if its corner is a
 * multiple of 2^levels of the plan; with exposure and psf given by value (not exposure=auto, which meters the target, nor budget_ms, which
 * is of a machine). From a part with any other corner it is right to the bound all the same.
 * A reply's error_bound is then of the mean's glow; the mean of the frame itself is summed in float32, and so right to some
 * (rows + columns of a wall pixel) * 2^-24 of the mean of its sizes. Where the picture is not plain it passes through output planes
 * of the target's type. Energies are 0. The first frame of a wall makes weights and pipelines, unless bloom_wall_warm has.
 * Where the device is the CPU and the planes lie in the host's memory, a plain picture is worked out in C on options.threads threads.
 */
struct bloom_wall {
    uint32_t width, height;          /* of the wall, pixels */
    uint32_t first_x, first_y, end_x, end_y; /* the pixels that are wanted; the others stay as they are in drive */
    double x, y, pitch_x, pitch_y;
    uint32_t frame_width, frame_height; /* the frame that the target is a part of: sizes in % and mm mean its */
    int32_t frame_x, frame_y;        /* of the target's first pixel in it; >= 0 */
    int tone_map;                    /* enum display of params.h */
    double saturation;
    double matrix[3][3];
    const float *gain;               /* [height][width][3]; NULL: all 1. Unchanged while gain_id is the same */
    uint64_t gain_id;
    struct bloom_adapt *adapt;       /* NULL: the request's exposure */
    float *drive;                    /* [height][width][3]: receives the result */
};

/* What the definition of a wall decides, or cannot be had on one, is not asked for: 0, or -1 and *f (PARAM_CONFLICT). */
int bloom_wall_check_params(const struct params *p, struct fault *f);
/* Needs the target output planes (geometry.outputs = 1) for this wall, or none (0)? */
bool bloom_wall_is_direct(const struct params *p);
/* The part of the frame, pixels from its corner, that the wanted wall pixels' light comes from: their rectangles, the
 * PSF's reach around them, rounded out to the cells of the coarsest level in use, cut at the frame; where the picture is not plain, all
 * of it. Never empty. display_width: as in struct bloom_request, of the frame. On the device thread. 0, or -1 and *f. */
int bloom_wall_need(struct bloom *b, const struct params *p, float pixel_aspect, unsigned channels, uint32_t display_width,
                    const struct bloom_wall *w, int32_t need[4] /* x0, y0, x1, y1 */, struct fault *f);

/* What stays from frame to frame beside planes, each kind as large as its largest frame. */
enum bloom_keep { BLOOM_KEEP_LEVELS, BLOOM_KEEP_KERNEL, BLOOM_KEEP_LOOK, BLOOM_KEEP_DIRT, BLOOM_KEEPS };
struct bloom_keep_facts {
    const struct params *params;
    double pixel_aspect;
    uint32_t display_width;          /* as in struct bloom_request */
    bool matte;
    const struct bloom_image *dirt, *kernel; /* NULL: none */
    unsigned threads;                /* options.threads */
};
/* Never less than what edge=fill puts around the picture on each side, pixels; part of the below. */
uint64_t bloom_pad_most(const struct bloom_keep_facts *k, const struct bloom_geometry *g);
/* Never less than what bloom_run will have allocated of each kind for such targets (not of walls), its host's memory included. Pure: may be
 * asked on any thread. */
void bloom_keep_bytes(const struct bloom_keep_facts *k, unsigned count, const struct bloom_geometry *g, uint64_t bytes[BLOOM_KEEPS]);

struct bloom_request {
    const struct params *params;
    const struct frame_scan *scan; /* of the target's input planes */
    /* Other targets of the slot, of the same width and height; -1 or the target itself: none. */
    int source;                    /* its light glows; with the scan of its planes */
    const struct frame_scan *source_scan;
    int matte;                     /* 1 channel */
    const struct frame_scan *matte_scan;
    int depth;                     /* 1 channel, FLOAT: for the sun of look mip-chain */
    const struct bloom_image *dirt, *kernel; /* NULL: none */
    const struct bloom_wall *wall; /* NULL: output planes */
    float luma[3];
    float pixel_aspect;            /* width of a pixel over its height; > 0 */
    uint32_t display_width;        /* of the display window, for sizes in mm; 0: the target's width */
};

/* Makes ready what the first frames of such a wall need (weights, memory, pipelines), by drawing a bright and a dark one of no light.
 * geometry: of the target; the wall's frame_... as they will be; its drive is not written. A few ms on the host, up to 2 s where a
 * driver must compile. On the device thread. 0, or -1 and *f. */
int bloom_wall_warm(struct bloom *b, const struct bloom_wall *w, const struct params *p, const struct bloom_geometry *geometry,
                    float pixel_aspect, uint32_t display_width, struct fault *f);

struct bloom_reply {
    bool untouched;       /* no glow at all: the output planes were not written */
    char plan[512];       /* for people */
    char skipped[256];    /* what was not done, and why */
    char rule[8];         /* "R3"; "fft"; a look's name, cut; "-" */
    char storage[8];      /* "float", "half" */
    unsigned levels;
    double error_bound;   /* of intensity * max E, every pixel; rule + rounding + storage + skipped */
    double max_bright;    /* upper bound of E from the scan */
    double exposure;      /* stops in use */
    double energy_bright, energy_bloomed, energy_lost;
    double energy_clamped, energy_suppressed; /* of E, taken by clamp and by firefly */
    uint64_t saturated;   /* samples held at the output type's largest value; counted by the encoder
                             for HALF, here for nothing yet */
    uint32_t tiles, tiles_bright;
    double device_ms;
    double predicted_ms;  /* by the cost model measured at the device's start; 0: not known (FFT, looks) */
};

/* What would run for such a frame, without running: fills plan, rule, storage, levels, error_bound (filters, rounding
 * and storage), predicted_ms. */
int bloom_plan(struct bloom *b, const struct bloom_geometry *geometry, const struct bloom_request *request,
               struct bloom_reply *reply, struct fault *f);

/* Blooms one target of the slot. 0, or -1 and *f (FAULT_DEVICE_LOST: the whole struct bloom is to be
 * thrown away). */
int bloom_run(struct bloom *b, struct bloom_slot *s, unsigned target,
              const struct bloom_request *request, struct bloom_reply *reply, struct fault *f);

#endif
