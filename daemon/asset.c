// SPDX-License-Identifier: Apache-2.0
// asset.c - see asset.h. Room is reserved before anything is decoded, so that many uploads at once cannot take more
// than the ceiling between them.
#include "asset.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define XXH_INLINE_ALL
#include <xxhash.h>

void asset_cache_init(struct asset_cache *c, uint64_t bytes_max)
{
    *c = (struct asset_cache){ .bytes_max = bytes_max };
    pthread_mutex_init(&c->lock, NULL);
    TAILQ_INIT(&c->list);
}

static void asset_free(struct asset *a)
{
    if (!a)
        return;
    free((float *)a->image.rgb);
    free(a);
}

void asset_cache_finish(struct asset_cache *c)
{
    struct asset *a;
    while ((a = TAILQ_FIRST(&c->list))) {
        assert(!a->references);
        TAILQ_REMOVE(&c->list, a, link);
        asset_free(a);
    }
    pthread_mutex_destroy(&c->lock);
}

void asset_digest(char out[ASSET_DIGEST_MAX], const void *bytes, uint64_t size)
{
    XXH128_canonical_t digest;
    XXH128_canonicalFromHash(&digest, XXH3_128bits(bytes, size));
    static_assert(2 * sizeof digest.digest + 1 == ASSET_DIGEST_MAX, "hex digits and a NUL");
    for (size_t i = 0; i < sizeof digest.digest; i++)
        snprintf(out + 2 * i, 3, "%02x", digest.digest[i]);
}

// Under the lock.
static struct asset *find(struct asset_cache *c, const char *digest)
{
    struct asset *a;
    TAILQ_FOREACH(a, &c->list, link)
    if (!strcmp(a->image.digest, digest))
        break;
    if (!a)
        return NULL;
    a->references++;
    TAILQ_REMOVE(&c->list, a, link);
    TAILQ_INSERT_TAIL(&c->list, a, link);
    return a;
}

struct asset *asset_find(struct asset_cache *c, const char *digest)
{
    pthread_mutex_lock(&c->lock);
    struct asset *a = find(c, digest);
    pthread_mutex_unlock(&c->lock);
    return a;
}

void asset_release(struct asset_cache *c, struct asset *a)
{
    if (!a)
        return;
    pthread_mutex_lock(&c->lock);
    assert(a->references);
    a->references--;
    pthread_mutex_unlock(&c->lock);
}

// ---- room ------------------------------------------------------------------------------------------

static struct asset *oldest_unused(struct asset_cache *c)
{
    struct asset *a;
    TAILQ_FOREACH(a, &c->list, link)
    if (!a->references)
        return a;
    return NULL;
}

static int reserve(struct asset_cache *c, uint64_t bytes, struct fault *f)
{
    struct asset_list gone = TAILQ_HEAD_INITIALIZER(gone);
    struct asset *a;
    int rc = 0;
    pthread_mutex_lock(&c->lock);
    uint64_t unused = 0;
    TAILQ_FOREACH(a, &c->list, link)
    unused += a->references ? 0 : a->bytes;
    // Nothing is thrown out for an image that does not fit in the end.
    if (c->bytes - unused + bytes > c->bytes_max) {
        rc = fault_set(f, FAULT_BUSY, "input.size",
                       "%llu bytes of pixels; images in use leave %llu of %llu; try again", (unsigned long long)bytes,
                       (unsigned long long)(c->bytes_max - (c->bytes - unused)), (unsigned long long)c->bytes_max);
        f->retry_after_ms = 1000;
    }
    while (!rc && c->bytes + bytes > c->bytes_max && (a = oldest_unused(c))) {
        c->bytes -= a->bytes;
        TAILQ_REMOVE(&c->list, a, link);
        TAILQ_INSERT_TAIL(&gone, a, link);
    }
    if (!rc)
        c->bytes += bytes;
    pthread_mutex_unlock(&c->lock);
    while ((a = TAILQ_FIRST(&gone))) {
        TAILQ_REMOVE(&gone, a, link);
        asset_free(a);
    }
    return rc;
}

static void unreserve(struct asset_cache *c, uint64_t bytes)
{
    pthread_mutex_lock(&c->lock);
    c->bytes -= bytes;
    pthread_mutex_unlock(&c->lock);
}

// Its room is reserved. Somebody may have sent the same meanwhile: then that one is it.
static struct asset *insert(struct asset_cache *c, struct asset *mine)
{
    pthread_mutex_lock(&c->lock);
    struct asset *a = find(c, mine->image.digest);
    if (a) {
        c->bytes -= mine->bytes;
    } else {
        a = mine;
        a->references = 1;
        TAILQ_INSERT_TAIL(&c->list, a, link);
    }
    pthread_mutex_unlock(&c->lock);
    if (a != mine)
        asset_free(mine);
    return a;
}

// ---- an EXR file as an image -------------------------------------------------------------------------

static void row_floats(float *out, const struct planes *p, unsigned c, uint32_t y)
{
    const void *row = planes_row(p, c, y);
    if (p->type == PIXEL_TYPE_HALF)
        half_to_float(out, row, p->width);
    else
        memcpy(out, row, (size_t)p->width * sizeof *out);
}

static int check_row(const float *row, const struct exr_target *t, unsigned c, uint32_t y, struct fault *f)
{
    static const char *const names[] = { "R", "G", "B" };
    for (uint32_t x = 0; x < t->width; x++)
        if (!(row[x] >= 0 && isfinite(row[x])))
            return fault_set(f, FAULT_EXR_UNSUPPORTED, "input",
                             "channel %s at x %lld, y %lld is %g; an image to be kept has finite samples of at least 0",
                             t->channels == 1 ? "Y" : names[c], (long long)t->min_x + x, (long long)t->min_y + y,
                             (double)row[x]);
    return 0;
}

static int interleave(float *rgb, const struct planes *p, const struct exr_target *t, struct fault *f)
{
    float *row = malloc((size_t)t->width * sizeof *row);
    int rc = row ? 0 : fault_set(f, FAULT_NO_MEMORY, "input", "no memory for a row of %u pixels", t->width);
    for (uint32_t y = 0; y < t->height && !rc; y++)
        for (unsigned c = 0; c < 3 && !rc; c++) {
            float *out = rgb + (size_t)y * t->width * 3 + c;
            row_floats(row, p, t->channels == 3 ? c : 0, y);
            rc = check_row(row, t, c, y, f);
            for (uint32_t x = 0; x < t->width; x++)
                out[(size_t)x * 3] = row[x];
        }
    free(row);
    return rc;
}

// 1: decoded, 0: cancelled, -1 and *f.
static int decode(struct exr *x, struct exr_worker *w, const _Atomic bool *cancel, struct fault *f)
{
    for (unsigned i = 0; i < exr_decode_tasks(x); i++) {
        if (*cancel)
            return 0;
        if (exr_decode(x, i, w, f) < 0)
            return -1;
    }
    return 1;
}

// What the file has is one picture, and it fits. The bytes of its pixels as an image are in *bytes.
static int measure(const struct asset_cache *c, struct exr *x, uint64_t *bytes, struct fault *f)
{
    if (exr_target_count(x) != 1)
        return fault_set(f, FAULT_EXR_UNSUPPORTED, "input", "%u pictures (parts or views) in the file; expected one",
                         exr_target_count(x));
    const struct exr_target *t = exr_target(x, 0);
    // Less than 2^64: the reader's limits are far below 2^32 in both directions.
    if (t->width > UINT32_MAX / 12 || __builtin_mul_overflow((uint64_t)t->width * 12, t->height, bytes) ||
        *bytes > c->bytes_max)
        return fault_set(f, FAULT_EXR_TOO_LARGE, "input",
                         "%u x %u pixels need 12 bytes each; the images that are kept may have %llu", t->width,
                         t->height, (unsigned long long)c->bytes_max);
    return 0;
}

// A fresh image of a file that is open, its room reserved. 1, 0: cancelled, -1 and *f.
static int read_image(struct asset *a, struct exr *x, struct exr_worker *w, const _Atomic bool *cancel,
                      struct fault *f)
{
    const struct exr_target *t = exr_target(x, 0);
    struct planes p;
    float *rgb = malloc(a->bytes);
    int rc = planes_alloc(&p, t->width, t->height, t->channels, t->type);
    if (!rgb || rc < 0) {
        if (rc == 0)
            planes_free(&p);
        free(rgb);
        return fault_set(f, FAULT_NO_MEMORY, "input", "no memory for %u x %u pixels", t->width, t->height);
    }
    exr_bind(x, 0, &p, &p); // never encoded: the output planes are not looked at
    rc = decode(x, w, cancel, f);
    if (rc > 0 && interleave(rgb, &p, t, f) < 0)
        rc = -1;
    planes_free(&p);
    a->image.width = t->width;
    a->image.height = t->height;
    a->image.rgb = rgb; // the image's in any case
    return rc;
}

static int keep_fresh(struct asset_cache *c, const char *digest, struct exr *x, struct exr_worker *w,
                      const _Atomic bool *cancel, struct asset **out, struct fault *f)
{
    uint64_t bytes = 0;
    if (measure(c, x, &bytes, f) < 0 || reserve(c, bytes, f) < 0)
        return -1;
    struct asset *a = calloc(1, sizeof *a);
    int rc = -1;
    if (!a) {
        fault_set(f, FAULT_NO_MEMORY, "input", "no memory for an image");
    } else {
        a->bytes = bytes;
        memcpy(a->image.digest, digest, ASSET_DIGEST_MAX);
        rc = read_image(a, x, w, cancel, f);
    }
    if (rc > 0) {
        *out = insert(c, a);
        return 0;
    }
    asset_free(a);
    unreserve(c, bytes);
    return rc;
}

int asset_keep(struct asset_cache *c, const void *bytes, uint64_t size, const struct exr_limits *limits,
               struct exr_worker *w, const _Atomic bool *cancel, struct asset **out, struct fault *f)
{
    char digest[ASSET_DIGEST_MAX];
    asset_digest(digest, bytes, size);
    *out = asset_find(c, digest);
    if (*out)
        return 0;
    const struct exr_select all = { 0 };
    const struct exr_options keep = { .compression = EXR_KEEP };
    struct exr *x;
    if (exr_open(&x, bytes, size, limits, &all, &keep, f) < 0)
        return -1;
    int rc = keep_fresh(c, digest, x, w, cancel, out, f);
    exr_close(x);
    return rc;
}
