/* SPDX-License-Identifier: Apache-2.0 */
/*
 * scene_kernel.h - the spread of a psf that is no sum of Gaussians, as it is defined: every lit pixel draws the whole kernel.
 * What is independent of the engine here is the convolution; the kernel itself is daemon/kernel.h's, which test_kernel holds
 * against the models.
 */
#ifndef AIRY_SCENE_KERNEL_H
#define AIRY_SCENE_KERNEL_H

#include "scene_kit.h"

/* Adds the spread of r->bright to r->glow, weight included. Costs lit pixels times all pixels. */
void scene_kernel_spread(struct reference_result *r, const struct scene *s, const struct reference_frame *f,
                         const struct psf_spec *psf);

#endif
