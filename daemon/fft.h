/* SPDX-License-Identifier: Apache-2.0 */
/*
 * fft.h - complex transforms of length 2^a 3^b 5^c in float64, FFT_LANES of them side by side. Debian has no permissive
 * FFT library in double precision, and none that takes several signals at once, which is what makes this one fast: every
 * butterfly is the same arithmetic on FFT_LANES neighbouring numbers, and the columns of an image are such neighbours.
 *
 * A batch is two runs of n * FFT_LANES doubles, real and imaginary; element i of lane l is at i * FFT_LANES + l. Pure;
 * the results do not depend on the CPU: no fused multiply-add, whatever the vectors' width.
 */
#ifndef AIRYD_FFT_H
#define AIRYD_FFT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { FFT_LANES = 4, FFT_STAGES_MAX = 32, FFT_LENGTH_MAX = 1 << 20 };

struct fft {
    uint32_t n;
    unsigned stages;
    unsigned char radix[FFT_STAGES_MAX];
    double *twiddle; /* per stage m * (radix - 1) pairs */
};

/* The smallest 2^a 3^b 5^c >= n; n <= FFT_LENGTH_MAX. */
uint32_t fft_length(uint32_t n);
/* n as from fft_length. 0, or -ENOMEM. */
int fft_init(struct fft *f, uint32_t n);
void fft_finish(struct fft *f);

struct fft_batch {
    double *re, *im;
};

/* X[k] = sum x[i] exp(-+2 pi i k i / n) (- forward), not scaled. Both batches are written; the result is in the one that
 * is returned: z after an even number of stages, else work. */
struct fft_batch fft_run(const struct fft *f, struct fft_batch z, struct fft_batch work, bool inverse);

/* Bounds, as multiples of what is said, of one transform's rounding in float64 (first order in 2^-53, with a margin for
 * the rest). norm: |error|_2 <= norm * |X|_2. each: |error_k| <= each * sum |x_i|. */
struct fft_rounding {
    double norm, each;
};
struct fft_rounding fft_rounding(const struct fft *f);

#endif
