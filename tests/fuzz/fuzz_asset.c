// SPDX-License-Identifier: Apache-2.0
//
// fuzz_asset.c - asset.c: any bytes as an image to be kept.
//
// What is checked: what is kept is finite and >= 0, counts exactly its bytes, and is found again by its digest and by its
// bytes; what is refused leaves no room taken.
#include <math.h>

#include "asset.h"
#include "fuzz.h"

enum { CEILING_BYTES = 1 << 18 };

static void check_kept(struct asset_cache *c, struct asset *a)
{
    const struct bloom_image *i = &a->image;
    must(strlen(i->digest) == ASSET_DIGEST_MAX - 1 && a->references == 1);
    must(a->bytes == (uint64_t)i->width * i->height * 12 && a->bytes && c->bytes == a->bytes && a->bytes <= CEILING_BYTES);
    for (uint64_t k = 0; k < (uint64_t)i->width * i->height * 3; k++)
        must(isfinite(i->rgb[k]) && i->rgb[k] >= 0);
    struct asset *found = asset_find(c, i->digest);
    must(found == a && a->references == 2);
    asset_release(c, found);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const struct exr_limits limits = { 512, 512, 1 << 16, 1 << 20 };
    static const _Atomic bool cancel;
    static struct exr_worker *worker; // reused for ever, as in the daemon
    struct fault f = { .code = FAULT_NONE };
    struct asset_cache c;
    struct asset *a = NULL, *again = NULL;
    if (!worker)
        must(!exr_worker_create(&worker));
    asset_cache_init(&c, CEILING_BYTES);
    if (asset_keep(&c, data, size, &limits, worker, &cancel, &a, &f) < 0) {
        must(!a && f.code != FAULT_NONE && *f.text);
        must(!c.bytes && TAILQ_EMPTY(&c.list));
    } else {
        must(a);
        check_kept(&c, a);
        must(!asset_keep(&c, data, size, &limits, worker, &cancel, &again, &f) && again == a);
        asset_release(&c, again);
        asset_release(&c, a);
    }
    asset_cache_finish(&c);
    return 0;
}
