/* SPDX-License-Identifier: Apache-2.0 */
/*
 * c_chain.h - the yardstick: what a good C programmer would write for the J5 job without this
 * project. Float planes, two threads, loops that the compiler vectorises; the error that such chains
 * usually have (a few 1e-3), nothing sanitised, nothing skipped, nothing counted.
 *
 * out = in + intensity * sum of weight_i * G(sigma_i) * max(in - threshold, 0), zero outside. One
 * pyramid by [1 3 3 1]/8 down and (transposed: bilinear) up; each Gaussian at the level where its sigma
 * is 2 cells, its kernel narrowed by the variance of the filters around it.
 */
#ifndef AIRY_BENCH_C_CHAIN_H
#define AIRY_BENCH_C_CHAIN_H

#include "bench.h"

struct c_chain;

/* sigmas: powers of two from 4 on, each once, at most 512. NULL: out of memory, or other sigmas. */
struct c_chain *c_chain_create(unsigned width, unsigned height, const double *sigma,
                               const double *weight, unsigned n, struct team *team);
void c_chain_destroy(struct c_chain *c);
/* Planes: FLOAT, 3, of the chain's size. */
void c_chain_run(struct c_chain *c, const struct planes *in, const struct planes *out, float threshold,
                 float intensity);

#endif
