/* SPDX-License-Identifier: Apache-2.0 */
/*
 * scene_kit.h - scenes for tests of the engine: filled from a seed, run on a device, and held against the float64
 * reference. A scene's planes are doubles that have the pixel type's precision once it has run, so that the reference
 * and the device see the same numbers.
 */
#ifndef AIRY_SCENE_KIT_H
#define AIRY_SCENE_KIT_H

#include "bloom.h"
#include "reference.h"

struct scene {
    unsigned width, height, channels;
    enum pixel_type type;
    double *plane[3];
    float luma[3];
    double aspect;
    unsigned grow, display_width;
    double *source[3], *matte; /* scene_add_source, scene_add_matte; NULL: none */
    unsigned dirt_width, dirt_height;
    float *dirt; /* interleaved R G B; NULL: none */
    unsigned kernel_width, kernel_height;
    float *kernel; /* of psf=image: interleaved R G B; NULL: none */
    char kernel_digest[33];
    unsigned outputs;
    /* After a run. */
    double *out[BLOOM_OUTPUTS_MAX][3]; /* (width + 2 grow) x (height + 2 grow) */
    struct frame_scan scan, source_scan, matte_scan;
    struct planes in_planes[3], out_planes[3 * BLOOM_OUTPUTS_MAX]; /* the slot's; the target is the first */
    struct bloom_reply reply;
};

/* Random numbers of all tests here: one state, which a seed sets. */
void scene_seed(uint64_t seed);
double scene_uniform(void); /* 0 <= v < 1 */

/* Zeroed planes. What is not set: luma of Rec.709, aspect 1, one output. */
void scene_init(struct scene *s, unsigned width, unsigned height, unsigned channels, enum pixel_type type);
void scene_finish(struct scene *s); /* what scene_init and the adders made */
void scene_add_source(struct scene *s);
void scene_add_matte(struct scene *s);
void scene_add_dirt(struct scene *s, unsigned width, unsigned height);
/* Random numbers, none of them the same turned or mirrored; kernel_digest gets a random name. */
void scene_add_kernel(struct scene *s, unsigned width, unsigned height);
/* Dark ground with noise, some lamps over five decades, a bright block that touches a corner. */
void scene_fill(struct scene *s);

/* A psf in params' own words; threshold 1, knee .5, intensity 1. */
struct params scene_params(const char *psf, enum bright_curve curve, double tolerance);

/* Puts the planes into the slot and scans them. */
void scene_load(struct scene *s, struct bloom *b, unsigned slot);
/* Loads, blooms, reads back. */
void scene_run(struct scene *s, const struct params *p, struct bloom *b, unsigned slot);
/* The frame that scene s is, for the reference; *dirt (may be NULL when s has none) is the caller's to free. */
struct reference_frame scene_reference(const struct scene *s, double **dirt);

/* What *f should become: the reference, and for a psf that is no sum of Gaussians a dense convolution of its E with the kernel that
 * daemon/kernel.h draws. *r is reference_free's. */
void scene_truth(struct reference_result *r, const struct scene *s, const struct reference_frame *f,
                 const struct params *p);

/* What the output type itself rounds off: half an ulp of the pixel. */
double scene_quantum(enum pixel_type type, double v);

struct scene_verdict {
    double ratio; /* worst (|out - reference| - rounding of the output) / stated bound; above 1 the reply is wrong */
    double error; /* there, of intensity * max E */
    unsigned x, y, c, output;
    double got, want, room;
    double max_bright; /* the reference's */
    char why[192];     /* of a wrong ledger, exposure or max E; "" when they are right */
};

/* Every output of a scene that has run, against the reference. */
void scene_compare(const struct scene *s, const struct params *p, struct scene_verdict *v);
/* The same, printed, and the test fails unless it is right. Returns the ratio. */
double scene_check(const struct scene *s, const struct params *p, const char *what);

#endif
