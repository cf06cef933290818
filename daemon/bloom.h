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

struct bloom_options {
    const char *device;  /* NULL or "": best; "cpu", "gpu", an index, or part of a name */
    unsigned slots;      /* frames that can be in the pipeline at once, 1..8 */
    bool validate;       /* Vulkan validation with synchronisation validation; any message is counted */
    bool warm_all;       /* draw with every pipeline at start, not only with those of common requests: some
                            20 s when the driver has none of them in its cache, 2 s when it has */
    bool profile;        /* log the time of each pass (METHODS' stages) of every frame */
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
/* Pipelines that have been made (and so have drawn), and how many there could be. */
unsigned bloom_pipelines(const struct bloom *b, unsigned *possible);
/* Prints the devices that --device could name, one a line. */
void bloom_list_devices(void (*print)(const char *line));

struct bloom_slot *bloom_slot(struct bloom *b, unsigned i);

struct bloom_geometry {
    uint32_t width, height;
    unsigned channels;      /* 1 or 3 */
    enum pixel_type type;   /* HALF or FLOAT */
};

enum { BLOOM_TARGETS_MAX = 16 };

/* Makes room for a job's targets; memory only grows, and nothing is allocated when the same
 * geometry comes again. in[i] and out[i] receive the planes. */
int bloom_slot_prepare(struct bloom *b, struct bloom_slot *s, unsigned count,
                       const struct bloom_geometry *geometry, struct planes *in, struct planes *out,
                       struct fault *f);

struct bloom_request {
    const struct params *params;
    const struct frame_scan *scan; /* of the input planes */
    float luma[3];
    float pixel_aspect;            /* width of a pixel over its height; > 0 */
};

struct bloom_reply {
    bool untouched;       /* no glow at all: the output planes were not written */
    char plan[512];       /* for people */
    char rule[8];
    unsigned levels;
    double error_bound;   /* of intensity * max E, every pixel; rule + rounding */
    double max_bright;    /* upper bound of E from the scan */
    double energy_bright, energy_bloomed, energy_lost;
    uint64_t saturated;   /* samples held at the output type's largest value; counted by the encoder
                             for HALF, here for nothing yet */
    uint32_t tiles, tiles_bright;
    double device_ms;
};

/* Blooms one target of the slot. 0, or -1 and *f (FAULT_DEVICE_LOST: the whole struct bloom is to be
 * thrown away). */
int bloom_run(struct bloom *b, struct bloom_slot *s, unsigned target,
              const struct bloom_request *request, struct bloom_reply *reply, struct fault *f);

#endif
