/* SPDX-License-Identifier: Apache-2.0 */
/*
 * convolve.h - E convolved with a kernel by FFT in float64, on the CPU: for the PSFs that are no sum of Gaussians. (On a CPU
 * device this is 3-8 times as fast as an FFT in shaders, and float64 keeps dark pixels clean: METHODS section 3.3.)
 * Knows no Vulkan. A convolver belongs to one geometry and one kernel; its plans and spectra are made once.
 */
#ifndef AIRYD_CONVOLVE_H
#define AIRYD_CONVOLVE_H

#include "fault.h"
#include "params.h"

struct convolver;

struct convolver_facts {
    uint32_t width, height;      /* of E; outside it there is no light */
    uint32_t grow;               /* the result is this much larger on each side */
    unsigned channels;           /* 1 or 3 */
    double pixel_aspect;
    const struct psf_spec *psf;  /* kind EYE, AIRY, APERTURE or IMAGE; weight included in the result */
    const float *image;          /* PSF_IMAGE: interleaved RGB, image_width x image_height; centre at (w / 2, h / 2), normalised here
                                    per channel to sum 1 */
    uint32_t image_width, image_height;
    unsigned threads;
};

/* 0, or -1 and *f (NO_MEMORY; PARAM_RANGE naming params.psf). */
int convolver_create(struct convolver **out, const struct convolver_facts *facts, struct fault *f);
void convolver_destroy(struct convolver *c);
/* Sup over the frame of |result - exact| / (max E), float32 rounding of the result included: computed for this kernel and
 * size. */
double convolver_bound(const struct convolver *c);
/* Per channel: the kernel's sum that lies outside what fits the frame (for the ledger), 0 where the kernel has the whole frame. */
double convolver_weight(const struct convolver *c, unsigned channel);
/* e[c]: height rows of width floats, e_stride apart; out[c]: height + 2 grow rows of width + 2 grow. Results below 0 (rounding) are 0;
 * exactly 0 all over when E is 0. Same input, same bytes at any number of threads. */
int convolver_run(struct convolver *c, const float *const e[3], size_t e_stride, float *const out[3], size_t out_stride,
                  struct fault *f);

#endif
