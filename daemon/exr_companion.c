// SPDX-License-Identifier: Apache-2.0
/*
 * exr_companion.c - what the glow of a scene needs beside it: the layer whose light glows, a matte, depth.
 *
 * A companion is a target that is only read. It is looked for in the scene's own part, then in parts of the
 * same view, then in parts of no view, never in those of another view: so the two eyes of a stereo file share
 * one only where the file does not tell them apart. Within a part the name of the scene's own view goes before
 * the one without. Its data window must be the scene's. Source and matte that are asked for and absent are
 * faults; depth is used where there is one.
 */
#include <stdio.h>
#include <string.h>

#include "exr_internal.h"

struct seek {
    struct exr *x;
    struct exr_state *scene;
    enum exr_role role;
    const char *asked;     // what the request says, for faults
    char layer[EXR_PREFIX_BYTES]; // without its last dot; "": unprefixed
    const char *channel;   // of one channel: its last word
    struct fault why;      // why what was found is not used
};

static const char *const role_words[] = { "scene", "source", "matte", "depth" };

static unsigned planes_of(const struct seek *s) { return s->role == EXR_SOURCE ? s->scene->pub.channels : 1; }

static const char *field_of(const struct seek *s)
{
    return s->role == EXR_SOURCE ? "params.source" : s->role == EXR_MATTE ? "params.matte" : "input";
}

// ---- where to look --------------------------------------------------------------------------------------------

static bool has_view(const struct exr_part *p, const char *view, uint32_t bytes)
{
    const uint8_t *at = p->multi_view, *end = at ? at + p->multi_view_bytes : NULL;
    const char *one;
    uint32_t n;
    if (!at)
        return p->view && p->view_bytes == bytes && !memcmp(p->view, view, bytes);
    while (exr_next_view(&at, end, &one, &n))
        if (n == bytes && !memcmp(one, view, n))
            return true;
    return false;
}

// 0: the scene's own part, 1: of its view, 2: of no view, 3: not to be asked.
static unsigned rank_of(const struct seek *s, const struct exr_part *p)
{
    const struct exr_state *t = s->scene;
    const bool viewless = !p->multi_view && !p->view;
    if (p->index == t->pub.part)
        return 0;
    if (!t->view)
        return viewless ? 1 : 2;
    if (has_view(p, t->view, t->view_bytes))
        return 1;
    return viewless ? 2 : 3;
}

// Whether the part itself is the layer, by its name: "emission", or "emission.left".
static bool is_named(const struct seek *s, const struct exr_part *p)
{
    const size_t n = strlen(s->layer);
    if (!n || !p->name || p->name_bytes < n || memcmp(p->name, s->layer, n))
        return false;
    if (p->name_bytes == n)
        return true;
    return p->view && p->name[n] == '.' && p->name_bytes - n - 1 == p->view_bytes &&
           !memcmp(p->name + n + 1, p->view, p->view_bytes);
}

enum { PREFIXES = 4 };

// The i-th prefix to try in a part, most particular first; false: none there.
static bool prefix_of(const struct seek *s, const struct exr_part *p, unsigned i, char out[EXR_PREFIX_BYTES])
{
    const char *layer = i < 2 ? s->layer : "";
    const bool view = i % 2 == 0;
    // Depth is of the part where no layer has its own.
    if (i >= 2 && s->role != EXR_DEPTH && !is_named(s, p))
        return false;
    if (view && !(p->multi_view && s->scene->view))
        return false;
    int n = snprintf(out, EXR_PREFIX_BYTES, "%.255s%s", layer, *layer ? "." : "");
    if (view)
        snprintf(out + n, EXR_PREFIX_BYTES - (size_t)n, "%.*s.",
                 (int)(s->scene->view_bytes < 255 ? s->scene->view_bytes : 255), s->scene->view);
    return true;
}

// ---- what is there --------------------------------------------------------------------------------------------

static unsigned find(const struct seek *s, const struct exr_part *p, struct exr_channel *c[3], bool *chroma)
{
    char prefix[EXR_PREFIX_BYTES];
    *chroma = false;
    for (unsigned i = 0; i < PREFIXES; i++) {
        if (!prefix_of(s, p, i, prefix))
            continue;
        if (s->role == EXR_SOURCE) {
            const unsigned n = exr_layer_find(p, prefix, c, chroma);
            if (n)
                return n;
        } else if ((c[0] = exr_channel_find(p, prefix, s->channel))) {
            return 1;
        }
    }
    return 0;
}

// Keeps the first reason only.
#define REASON(s, ...)                                                                                       \
    ((s)->why.code ? false : (fault_set(&(s)->why, FAULT_EXR_UNSUPPORTED, field_of(s), __VA_ARGS__), false))

static bool same_window(struct seek *s, const struct exr_part *p, const struct exr_channel *c)
{
    const struct exr_target *t = &s->scene->pub;
    char mine[96], other[96];
    if (p->min_x == t->min_x && p->min_y == t->min_y && p->width == t->width && p->height == t->height)
        return true;
    return REASON(s, "channel '%.40s' of %.60s is %u x %u pixels at (%d, %d), %.60s is %u x %u at (%d, %d): the "
                  "data windows must be the same", c->name, exr_part_title(p, other), p->width, p->height,
                  p->min_x, p->min_y, exr_part_title(&s->x->part[t->part], mine), t->width, t->height, t->min_x,
                  t->min_y);
}

static bool fits(struct seek *s, const struct exr_part *p, struct exr_channel *const c[3], unsigned n, bool chroma)
{
    const struct exr_channel *bad = c[0];
    const char *unfit = NULL;
    char title[96];
    exr_part_title(p, title);
    if (p->storage >= EXR_DEEP_SCANLINE)
        return REASON(s, "channel '%.64s' of %.60s is deep data, which cannot be read as pixels yet", c[0]->name,
                      title);
    if (!same_window(s, p, c[0]))
        return false;
    if (n != planes_of(s))
        return REASON(s, "layer '%.64s' of %.60s has %u colour channel%s, %.64s has %u: the same number is needed",
                      s->asked, title, n, n == 1 ? "" : "s", s->scene->pub.name, s->scene->pub.channels);
    if (s->role == EXR_SOURCE)
        unfit = exr_layer_unfit(p, c, n, chroma, &bad);
    if (unfit)
        return REASON(s, "channel '%.64s' of %.60s %s", bad->name, title, unfit);
    if (s->role != EXR_SOURCE && (c[0]->x_sampling != 1 || c[0]->y_sampling != 1))
        return REASON(s, "channel '%.64s' of %.60s is subsampled to %u x %u, the frame is %u x %u: the same size is "
                      "needed", c[0]->name, title, p->width / (uint32_t)c[0]->x_sampling,
                      p->height / (uint32_t)c[0]->y_sampling, p->width, p->height);
    return true;
}

// ---- targets --------------------------------------------------------------------------------------------------

// A companion of another scene that is the same; -1: none.
static int find_target(const struct seek *s, const struct exr_part *p, struct exr_channel *const c[3], unsigned n)
{
    for (unsigned i = 0; i < s->x->targets; i++) {
        const struct exr_target *t = &s->x->target[i].pub;
        // Its scan weighs the channels as the scene does.
        bool same = t->role == s->role && t->part == p->index && t->channels == n &&
                    (s->role != EXR_SOURCE || !memcmp(t->luma, s->scene->pub.luma, sizeof(t->luma)));
        for (unsigned k = 0; k < n && same; k++)
            same = c[k]->taps & exr_tap(i, k);
        if (same)
            return (int)i;
    }
    return -1;
}

// The companion's index, or -1 and *f.
static int take(const struct seek *s, struct exr_part *p, struct exr_channel *const c[3], unsigned n, bool chroma,
                struct fault *f)
{
    const int there = find_target(s, p, c, n);
    if (there >= 0)
        return there;
    struct exr_state *t = exr_target_new(s->x, p, c, n, chroma, f);
    if (!t)
        return -1;
    t->pub.role = s->role;
    if (s->role == EXR_SOURCE)
        memcpy(t->pub.luma, s->scene->pub.luma, sizeof(t->pub.luma));
    if (s->role == EXR_DEPTH)
        t->pub.type = PIXEL_TYPE_FLOAT;
    snprintf(t->pub.name, sizeof(t->pub.name), "%s of %.200s", role_words[s->role], s->scene->pub.name);
    return (int)(t - s->x->target);
}

static int absent(struct seek *s, struct fault *f)
{
    struct exr_list l = { .text = "" };
    if (s->why.code) {
        if (f)
            *f = s->why;
        return -1;
    }
    for (unsigned i = 0; i < s->x->parts; i++) {
        const struct exr_part *p = &s->x->part[i];
        if (rank_of(s, p) == 3)
            continue;
        if (s->role == EXR_SOURCE)
            exr_list_layers(p, &l);
        for (unsigned c = 0; c < p->channels && s->role == EXR_MATTE; c++)
            exr_list_add(&l, p->channel[c].name, strlen(p->channel[c].name));
    }
    return fault_set(f, FAULT_NO_LAYER, field_of(s), "%s '%.40s' asked for; for %.40s the file has: %s",
                     s->role == EXR_SOURCE ? "layer" : "channel", s->asked, s->scene->pub.name, l.text);
}

// *index of the scene's companion. 0, or -1 and *f.
static int seek(struct seek *s, int *index, struct fault *f)
{
    struct exr_channel *c[3];
    bool chroma;
    for (unsigned rank = 0; rank < 3; rank++)
        for (unsigned i = 0; i < s->x->parts; i++) {
            struct exr_part *p = &s->x->part[i];
            if (rank_of(s, p) != rank)
                continue;
            const unsigned n = find(s, p, c, &chroma);
            if (n && fits(s, p, c, n, chroma)) {
                *index = take(s, p, c, n, chroma, f);
                return *index < 0 ? -1 : 0;
            }
        }
    if (s->role != EXR_DEPTH)
        return absent(s, f);
    if (s->why.code)
        exr_add_note(s->x, "depth is not used: %.170s", s->why.text);
    return 0;
}

static int seek_source(struct exr *x, struct exr_state *t, const char *layer, struct fault *f)
{
    struct seek s = { .x = x, .scene = t, .role = EXR_SOURCE, .asked = layer };
    snprintf(s.layer, sizeof(s.layer), "%s", layer);
    return seek(&s, &t->pub.source, f);
}

static int seek_matte(struct exr *x, struct exr_state *t, const char *name, struct fault *f)
{
    struct seek s = { .x = x, .scene = t, .role = EXR_MATTE, .asked = name, .channel = name };
    const char *dot = strrchr(name, '.');
    if (dot) {
        s.channel = dot + 1;
        snprintf(s.layer, sizeof(s.layer), "%.*s", (int)(dot - name < 512 ? dot - name : 512), name);
    }
    return seek(&s, &t->pub.matte, f);
}

static int seek_depth(struct exr *x, struct exr_state *t, const char *layer, struct fault *f)
{
    struct seek s = { .x = x, .scene = t, .role = EXR_DEPTH, .asked = "Z", .channel = "Z" };
    snprintf(s.layer, sizeof(s.layer), "%s", layer ? layer : "");
    return seek(&s, &t->pub.depth, f);
}

int exr_select_companions(struct exr *x, const struct exr_select *s, struct fault *f)
{
    const unsigned scenes = x->targets;
    for (unsigned i = 0; i < scenes; i++) {
        struct exr_state *t = &x->target[i];
        if ((s->source && *s->source && seek_source(x, t, s->source, f)) ||
            (s->matte && *s->matte && seek_matte(x, t, s->matte, f)) ||
            (s->depth && seek_depth(x, t, s->layer, f)))
            return -1;
    }
    return 0;
}
