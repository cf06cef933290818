/* SPDX-License-Identifier: Apache-2.0 */
/*
 * convolve.h - E convolved with a kernel by FFT in float64, on the CPU: for the PSFs that are no sum of Gaussians. (On a CPU
 * device this is 3-8 times as fast as an FFT in shaders, and float64 keeps dark pixels clean: METHODS section 3.3.)
 * Knows no Vulkan. A convolver belongs to one geometry and one kernel; its plans and spectra are made once.
 *
 * The kernel is kernel.h's, times psf->weight; one plane has the mean of the three channels' kernels. Nothing wraps around: the transforms are
 * n x m, each the smallest 2^a 3^b 5^c that keeps frame and kernel apart (for a model, >= 2 (side + grow) - 1).
 * Memory: 8 n m bytes of work, and per different channel of the kernel 2 n m (eye, airy), 4 n m (aperture) or 8 n m (image); scratch of
 * 128 max(n, m) a thread; while it is made, the drawn kernel too. CONVOLVER_BYTES_MAX in all.
 */
#ifndef AIRYD_CONVOLVE_H
#define AIRYD_CONVOLVE_H

#include "fault.h"
#include "params.h"

struct convolver;

enum { CONVOLVER_SIDE_MAX = 1 << 16 }; /* width + grow, height + grow */
#define CONVOLVER_BYTES_MAX (UINT64_C(8) << 30)

struct convolver_facts {
    uint32_t width, height;      /* of E; outside it there is no light */
    uint32_t grow;               /* the result is this much larger on each side */
    unsigned channels;           /* 1 or 3 */
    double pixel_aspect;
    const struct psf_spec *psf;  /* kind EYE, AIRY, APERTURE or IMAGE; weight included in the result */
    const float *image;          /* PSF_IMAGE: interleaved RGB, image_width x image_height; centre at (w / 2, h / 2), normalised here
                                    per channel to sum 1 */
    uint32_t image_width, image_height;
    unsigned threads;            /* taken as 1 .. 64 */
};

/* The image is not looked at after this. 0, or -1 and *f (NO_MEMORY; LIMIT: more than the two above; PARAM_RANGE naming params.psf). */
int convolver_create(struct convolver **out, const struct convolver_facts *facts, struct fault *f);
void convolver_destroy(struct convolver *c);
/* Sup over the frame of |result - exact| / (max E), float32 rounding of the result included: computed for this kernel and
 * size. */
double convolver_bound(const struct convolver *c);
/* Per channel: the kernel's sum that lies outside what fits the frame (for the ledger), 0 where the kernel has the whole frame. */
double convolver_weight(const struct convolver *c, unsigned channel);
/* Per channel: the share of the true PSF that lies beyond the pixels that can matter for this frame, and was put back by normalising
 * (models) or left out (image). */
double convolver_outside(const struct convolver *c, unsigned channel);
uint64_t convolver_bytes(const struct convolver *c);
/* Never less than what convolver_create takes for it at any moment, its end included; of an image only the size is looked at. Pure. */
uint64_t convolver_bytes_most(const struct convolver_facts *facts);
/* e: finite, >= 0; not out.
 * e[c]: height rows of width floats, e_stride apart; out[c]: height + 2 grow rows of width + 2 grow. Results below 0 (rounding) are 0;
 * above the
 * largest float they are that; exactly 0 all over when E is 0. Same input, same bytes at any number of threads. */
int convolver_run(struct convolver *c, const float *const e[3], size_t e_stride, float *const out[3], size_t out_stride,
                  struct fault *f);

#endif
