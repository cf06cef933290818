// SPDX-License-Identifier: Apache-2.0
/*
 * bloom_bytes.c - what the engine keeps beside planes, told before any of it is there: an upper bound by the same arithmetic that makes
 * the images (bloom_targets.c, look_targets.c), the read-back (bloom_ledger.c) and the transforms (convolve.c). Pure; whatever
 * is added to those is added here, and tests/test_room.c compares both.
 */
#include <math.h>
#include <stdlib.h>

#include "bloom_internal.h"
#include "convolve.h"
#include "look_internal.h"

// What a driver may add to an image: its rows and row counts rounded up to whole blocks of 4, and its place.
enum { BLOCK = 4, PLACE_BYTES = 4096, TEXEL_BYTES = 16, PAD_SIGMAS = 10, PAD_MORE = 128 };

static uint64_t up(uint64_t n) { return (n + BLOCK - 1) / BLOCK * BLOCK; }

static uint64_t image_bytes(uint64_t width, uint64_t height, uint64_t layers)
{
    return up(width) * up(height) * layers * TEXEL_BYTES + PLACE_BYTES;
}

// With edge=fill the canvas goes as far as any Gaussian reaches: no further than so many of its sigmas.
uint64_t bloom_pad_most(const struct bloom_keep_facts *k, const struct bloom_geometry *g)
{
    const struct params *p = k->params;
    double most = 0;
    if (p->edge != EDGE_FILL || p->psf_spec.kind != PSF_GAUSSIANS)
        return 0;
    for (unsigned i = 0; i < p->psf_spec.count; i++)
        most = fmax(most, params_pixels(p, &p->psf_spec.gaussian[i].sigma, g->width, g->height,
                                        k->display_width ? k->display_width : g->width, k->pixel_aspect));
    // Pixels may be narrower than they are high.
    most *= fmax(1, 1 / k->pixel_aspect);
    return (uint64_t)fmin(most * PAD_SIGMAS + PAD_MORE, UINT32_MAX / 4);
}

// The pyramid as if all were kept at full size, in float32; and the ledger's read-back as if it were of all of it.
static uint64_t levels_bytes(const struct bloom_keep_facts *k, const struct bloom_geometry *g)
{
    const uint64_t around = 2 * (g->grow + bloom_pad_most(k, g)), ch = g->channels;
    uint64_t width = g->width + around, height = g->height + around, bytes = 0;
    // Tables of the ledger, two at a time for an axis of a Gaussian.
    const uint64_t axis = width + height + 2 * (2 * LEVEL_MARGIN + 4);
    bytes += (k->params->psf_spec.count + 2) * axis * sizeof(double);
    for (unsigned i = 0; i <= PSF_LEVELS_MAX; i++) {
        const uint64_t texels = (width + 3) / 4 + 4, groups = (height + 3) / 4 + 4, block = texels * groups * LEVEL_PHASES * TEXEL_BYTES * ch;
        if (i == 0)
            bytes += image_bytes(texels, (height + 1) / 2 + LEVEL_MARGIN, 2 * ch) + 3 * image_bytes(texels, groups * ch, LEVEL_PHASES);
        else
            bytes += image_bytes(texels, groups * ch, LEVEL_PHASES);
        bytes += i == 1 ? (1 + LEDGER_TOTALS) * block : block; // the totals are of some level from the first on
        width = (width + 1) / 2;
        height = (height + 1) / 2;
    }
    return bytes;
}

static uint64_t kernel_bytes(const struct bloom_keep_facts *k, const struct bloom_geometry *g)
{
    const struct convolver_facts facts = {
        .width = g->width,
        .height = g->height,
        .grow = g->grow,
        .channels = g->channels,
        .pixel_aspect = k->pixel_aspect,
        .psf = &k->params->psf_spec,
        .image_width = k->kernel ? k->kernel->width : 0,
        .image_height = k->kernel ? k->kernel->height : 0,
        .threads = k->threads,
    };
    const uint64_t width = g->width + 2ull * g->grow, height = g->height + 2ull * g->grow;
    const uint64_t texels = (width + 3) / 4 + 4, rows = 2 * ((height + 1) / 2 + LEVEL_MARGIN) + 4 * ((height + 3) / 4 + 4);
    // E and its glow on their way to the host and back.
    return convolver_bytes_most(&facts) + texels * rows * TEXEL_BYTES * g->channels + PLACE_BYTES;
}

static uint64_t look_bytes(const struct bloom_keep_facts *k, const struct bloom_geometry *g)
{
    struct look_list *l = malloc(sizeof(*l));
    const struct look_facts facts = { .params = k->params, .width = g->width, .height = g->height, .channels = g->channels,
                                      .pixel_aspect = k->pixel_aspect, .display_width = k->display_width, .matte = k->matte,
                                      .want_bright = true, .sun_share = 1 };
    uint64_t bytes = sizeof(struct look_targets) + (uint64_t)LOOK_DRAWS_MAX * UNIFORM_STRIDE;
    if (!l) // nor will there be any for the look itself
        return bytes;
    look_list_make(l, &facts);
    for (unsigned i = 0; i < l->images; i++)
        bytes += image_bytes(l->image[i].width, l->image[i].height, l->image[i].layers);
    // Both lights' sums come back.
    const int sums[2] = { l->bright_light.sums, l->glow_light.sums };
    for (unsigned i = 0; i < 2; i++)
        bytes += sums[i] < 0 ? 0 : image_bytes(l->image[sums[i]].width, l->image[sums[i]].height, 1);
    free(l);
    return bytes;
}

void bloom_keep_bytes(const struct bloom_keep_facts *k, unsigned count, const struct bloom_geometry *g, uint64_t bytes[BLOOM_KEEPS])
{
    for (unsigned i = 0; i < BLOOM_KEEPS; i++)
        bytes[i] = 0;
    for (unsigned i = 0; i < count; i++) {
        if (!g[i].channels)
            continue;
        const bool looks = k->params->look != LOOK_NONE, draws = !looks && k->params->psf_spec.kind != PSF_GAUSSIANS;
        const uint64_t now[BLOOM_KEEPS] = {
            [BLOOM_KEEP_LEVELS] = looks ? 0 : levels_bytes(k, &g[i]),
            [BLOOM_KEEP_KERNEL] = draws ? kernel_bytes(k, &g[i]) : 0,
            [BLOOM_KEEP_LOOK] = looks ? look_bytes(k, &g[i]) : 0,
            // The image, and its pixels on their way.
            [BLOOM_KEEP_DIRT] = k->dirt ? image_bytes(k->dirt->width, k->dirt->height, 1) + TEXEL_BYTES * (uint64_t)k->dirt->width * k->dirt->height : 0,
        };
        for (unsigned j = 0; j < BLOOM_KEEPS; j++)
            bytes[j] = now[j] > bytes[j] ? now[j] : bytes[j];
    }
}
