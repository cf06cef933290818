/* SPDX-License-Identifier: Apache-2.0 */
/*
 * asset.h - the images that requests name by digest (lens dirt, kernels): decoded once, kept under a ceiling, shared
 * by jobs.
 *
 * Invariants: what is kept is finite and >= 0 everywhere; no two have one digest; the bytes of all pixels, those of
 * uploads that are being decoded too, never exceed the ceiling. Who is in use (has a reference) is never thrown out; of the
 * others the one that was asked for longest ago goes first. The digest is of the uploaded bytes: whoever knows
 * it has, or had, the file.
 *
 * One lock guards the list and the counts; any thread may call. An image's pixels never change after asset_keep.
 */
#ifndef AIRYD_ASSET_H
#define AIRYD_ASSET_H

#include <pthread.h>
#include <stdatomic.h>
#include <sys/queue.h>

#include "bloom.h"
#include "exr.h"

enum { ASSET_DIGEST_MAX = 33 };

struct asset {
    struct bloom_image image;
    uint64_t bytes;      /* of its pixels */
    unsigned references; /* the cache's business */
    TAILQ_ENTRY(asset) link;
};

struct asset_cache {
    pthread_mutex_t lock;
    TAILQ_HEAD(asset_list, asset) list; /* asked for longest ago first */
    uint64_t bytes, bytes_max;
};

void asset_cache_init(struct asset_cache *c, uint64_t bytes_max);
void asset_cache_finish(struct asset_cache *c); /* all references have been given back */

/* xxh3-128 in 32 hex digits. */
void asset_digest(char out[ASSET_DIGEST_MAX], const void *bytes, uint64_t size);

/* The image with this digest, with a reference for the caller; NULL: none is kept. */
struct asset *asset_find(struct asset_cache *c, const char *digest);
void asset_release(struct asset_cache *c, struct asset *a); /* NULL is fine */

/* Decodes an EXR file and keeps its image, or finds that it is kept already; *out has a reference for the caller.
 * bytes stay as they are meanwhile. Runs on a pool thread; ends early (with *out NULL and 0) when *cancel is set. 0, or
 * -1 and *f: what exr_open and exr_decode say; EXR_UNSUPPORTED for more than one picture, or a sample that is no number >= 0;
 * EXR_TOO_LARGE for one that the ceiling does not hold; BUSY when those in use leave no room. */
int asset_keep(struct asset_cache *c, const void *bytes, uint64_t size, const struct exr_limits *limits,
               struct exr_worker *w, const _Atomic bool *cancel, struct asset **out, struct fault *f);

#endif
