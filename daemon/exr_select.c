// SPDX-License-Identifier: Apache-2.0
/*
 * exr_select.c - which channels are bloomed: part, layer and view to targets.
 *
 * A layer is a prefix of channel names ("diffuse" -> diffuse.R, diffuse.G, diffuse.B). In a part with a
 * multiView attribute the view is the last component but one ("right.R", "diffuse.right.R"), and names
 * without any prefix are of the first view. In other parts the attribute `view` names the whole part's.
 * Whether channels can be read as colour is asked here for the glow's source, too (exr_companion.c).
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "exr_internal.h"

static bool given(const char *word) { return word && *word; }

// ---- text for faults ------------------------------------------------------------------------------------

static bool list_has(const struct exr_list *l, const char *word, size_t n)
{
    for (const char *p = l->text; p && *p; p = strstr(p, ", "), p = p ? p + 2 : NULL)
        if (!strncmp(p, word, n) && (!p[n] || p[n] == ','))
            return true;
    return false;
}

void exr_list_add(struct exr_list *l, const char *word, size_t n)
{
    if (l->full || !n || list_has(l, word, n))
        return;
    if (l->used + n + 8 > sizeof(l->text)) {
        l->full = true;
        memcpy(l->text + l->used, ", ...", 6);
        return;
    }
    l->used += (size_t)snprintf(l->text + l->used, sizeof(l->text) - l->used, "%s%.*s",
                                l->used ? ", " : "", (int)n, word);
}

// ---- luminance weights ------------------------------------------------------------------------------------

// The Y row of the RGB -> XYZ matrix, normalised: solve S.P = W for the primaries' scales S.
static bool luma_of(const float c[8], float luma[3])
{
    const double rx = (double)c[0], ry = (double)c[1], gx = (double)c[2], gy = (double)c[3];
    const double bx = (double)c[4], by = (double)c[5], wx = (double)c[6], wy = (double)c[7];
    const double rz = 1 - rx - ry, gz = 1 - gx - gy, bz = 1 - bx - by;
    if (!(fabs(wy) > 1e-9))
        return false;
    const double X = wx / wy, Z = (1 - wx - wy) / wy;
    const double det = rx * (gy * bz - by * gz) - gx * (ry * bz - by * rz) + bx * (ry * gz - gy * rz);
    if (!(fabs(det) > 1e-12))
        return false;
    const double sr = (X * (gy * bz - by * gz) - gx * (bz - by * Z) + bx * (gz - gy * Z)) / det;
    const double sg = (rx * (bz - by * Z) - X * (ry * bz - by * rz) + bx * (ry * Z - rz)) / det;
    const double sb = (rx * (gy * Z - gz) - gx * (ry * Z - rz) + X * (ry * gz - gy * rz)) / det;
    const double y[3] = { sr * ry, sg * gy, sb * by }, sum = y[0] + y[1] + y[2];
    if (!(sum > 1e-9))
        return false;
    float found[3];
    for (int i = 0; i < 3; i++) {
        found[i] = (float)(y[i] / sum);
        if (!isfinite(found[i]) || fabsf(found[i]) > 16)
            return false;
    }
    memcpy(luma, found, sizeof(found));
    return true;
}

// False: the chromaticities make no colour space, and Rec.709's are taken.
static bool part_luma(const struct exr_part *p, float luma[3])
{
    memcpy(luma, frame_rec709, sizeof(frame_rec709));
    return !p->has_chromaticities || luma_of(p->chromaticities, luma);
}

// ---- one layer of one part --------------------------------------------------------------------------------

struct exr_channel *exr_channel_find(const struct exr_part *p, const char *prefix, const char *name)
{
    const size_t n = strlen(prefix);
    for (unsigned i = 0; i < p->channels; i++)
        if (!strncmp(p->channel[i].name, prefix, n) && !strcmp(p->channel[i].name + n, name))
            return &p->channel[i];
    return NULL;
}

static const char *const colour_words[][3] = { { "R", "G", "B" }, { "r", "g", "b" },
                                               { "red", "green", "blue" } };
enum { COLOUR_WORDS = sizeof(colour_words) / sizeof(colour_words[0]) };

unsigned exr_layer_find(const struct exr_part *p, const char *prefix, struct exr_channel *c[3], bool *chroma)
{
    *chroma = false;
    for (unsigned s = 0; s < COLOUR_WORDS; s++) {
        unsigned found = 0;
        for (unsigned i = 0; i < 3; i++)
            found += (c[i] = exr_channel_find(p, prefix, colour_words[s][i])) != NULL;
        if (found == 3)
            return 3;
    }
    c[0] = exr_channel_find(p, prefix, "Y");
    c[1] = exr_channel_find(p, prefix, "RY");
    c[2] = exr_channel_find(p, prefix, "BY");
    *chroma = c[0] && c[1] && c[2];
    return *chroma ? 3 : c[0] != NULL;
}

const char *exr_layer_unfit(const struct exr_part *p, struct exr_channel *const c[3], unsigned n, bool chroma,
                            const struct exr_channel **bad)
{
    float luma[3];
    for (unsigned i = 0; i < n; i++) {
        const int32_t s = chroma && i ? c[1]->x_sampling : 1;
        *bad = c[i];
        if (c[i]->type == PIXEL_TYPE_UINT)
            return "is UINT: only HALF and FLOAT can be bloomed";
        if (c[i]->x_sampling != s || c[i]->y_sampling != s || s > 2)
            return "is subsampled in a way that no colour layer is";
    }
    *bad = c[0];
    if (p->storage >= EXR_DEEP_SCANLINE)
        return "is deep data, which cannot be bloomed yet";
    part_luma(p, luma);
    if (chroma && fabsf(luma[1]) < 1e-4f)
        return "cannot be made R, G, B: its chromaticities give green no luminance";
    return NULL;
}

struct exr_state *exr_target_new(struct exr *x, struct exr_part *p, struct exr_channel *const c[3], unsigned n,
                                 bool chroma, struct fault *f)
{
    if (x->targets == EXR_TARGETS_MAX) {
        fault_set(f, FAULT_EXR_TOO_LARGE, "input",
                  "more than %d layers would be bloomed or read for it: choose some by part, layer or view",
                  EXR_TARGETS_MAX);
        return NULL;
    }
    struct exr_state *t = &x->target[x->targets];
    *t = (struct exr_state){ .pub = { .source = -1, .matte = -1, .depth = -1, .part = p->index,
                                      .min_x = p->min_x, .min_y = p->min_y, .width = p->width,
                                      .height = p->height, .channels = n, .type = PIXEL_TYPE_HALF,
                                      .luma = { 1 }, .pixel_aspect = p->pixel_aspect,
                                      .display_x = p->display_x, .display_y = p->display_y,
                                      .display_width = p->display_width, .display_height = p->display_height },
                             .luma_chroma = chroma,
                             .chroma_sampling = chroma ? (uint8_t)c[1]->x_sampling : 1 };
    const bool space = part_luma(p, t->yw);
    if (!space && !p->targets)
        exr_add_note(x, "part %u: chromaticities make no colour space; Rec.709 luminance is used", p->index);
    if (n == 3)
        memcpy(t->pub.luma, t->yw, sizeof(t->yw));
    for (unsigned i = 0; i < n; i++) {
        c[i]->taps |= exr_tap(x->targets, i);
        if (chroma || c[i]->type != PIXEL_TYPE_HALF)
            t->pub.type = PIXEL_TYPE_FLOAT;
    }
    x->targets++;
    p->targets++;
    return t;
}

unsigned exr_channel_of(const struct exr *x, const struct exr_state *t, unsigned plane)
{
    const struct exr_part *p = &x->part[t->pub.part];
    const uint64_t tap = exr_tap((unsigned)(t - x->target), plane);
    for (unsigned i = 0; i < p->channels; i++)
        if (p->channel[i].taps & tap)
            return i;
    return 0; // cannot be: each plane of a target has its channel
}

struct pick {
    struct exr *x;
    const struct exr_select *want;
    bool explicit;    // a part or a layer was asked for by name
    struct fault why; // why something that looked right was passed over
    bool partial;     // why is about missing channels
    const char *view; // at hand; NULL: none
    uint32_t view_bytes;
};

static int refuse(struct pick *k, const struct exr_part *p, const char *channel, const char *what)
{
    char title[96];
    if (!k->why.code || k->partial)
        fault_set(&k->why, FAULT_EXR_UNSUPPORTED, "input", "channel '%.64s' of %s %s", channel,
                  exr_part_title(p, title), what);
    k->partial = false;
    return k->explicit ? -1 : 0;
}

// The scene takes these channels; 1: done, 0: passed over, -1: fault.
static int take(struct pick *k, struct exr_part *p, struct exr_channel *c[3], unsigned n, bool chroma,
                const char *prefix, const char *name)
{
    const struct exr_channel *bad;
    for (unsigned i = 0; i < n; i++)
        if (c[i]->target >= 0)
            return 1;
    const char *unfit = exr_layer_unfit(p, c, n, chroma, &bad);
    if (unfit)
        return refuse(k, p, bad->name, unfit);
    for (unsigned i = 0; i < n; i++) {
        c[i]->target = (int)k->x->targets;
        c[i]->plane = i;
    }
    struct exr_state *t = exr_target_new(k->x, p, c, n, chroma, &k->why);
    if (!t)
        return -1;
    snprintf(t->pub.name, sizeof(t->pub.name), "%s", name);
    snprintf(t->prefix, sizeof(t->prefix), "%s", prefix);
    t->view = k->view;
    t->view_bytes = k->view_bytes;
    p->scenes++;
    return 1;
}

static void note_partial(struct pick *k, const struct exr_part *p, const char *prefix)
{
    char title[96];
    for (unsigned s = 0; s < COLOUR_WORDS && !k->why.code; s++) {
        const char *const *words = colour_words[s];
        unsigned found = 0, missing = 0;
        for (unsigned i = 0; i < 3; i++) {
            const bool there = exr_channel_find(p, prefix, words[i]) != NULL;
            found += there;
            missing = there ? missing : i;
        }
        if (!found)
            continue;
        fault_set(&k->why, FAULT_NO_LAYER, "layer", "layer '%.64s' of %s has no channel %s: %s, %s "
                  "and %s are needed", *prefix ? prefix : "(unprefixed)", exr_part_title(p, title),
                  words[missing], words[0], words[1], words[2]);
        k->partial = true;
    }
}

// R, G, B under the prefix, else Y with or without its chroma.
static int take_prefix(struct pick *k, struct exr_part *p, const char *prefix, const char *name)
{
    struct exr_channel *c[3];
    bool chroma;
    const unsigned n = exr_layer_find(p, prefix, c, &chroma);
    if (n)
        return take(k, p, c, n, chroma, prefix, name);
    note_partial(k, p, prefix);
    return 0;
}

// ---- one part -----------------------------------------------------------------------------------------------

static void title_of(const struct pick *k, const struct exr_part *p, const char *view, size_t view_bytes,
                     char *out, size_t size)
{
    const bool layer = given(k->want->layer);
    int n = 0;
    out[0] = 0;
    if (k->x->parts > 1)
        n = snprintf(out, size, "part %u (%.*s)", p->index,
                     (int)(view_bytes ? view_bytes : p->name_bytes), view_bytes ? view : p->name);
    else if (view_bytes)
        n = snprintf(out, size, "%.*s", (int)view_bytes, view);
    if (n < 0 || (size_t)n >= size)
        return;
    if (layer)
        snprintf(out + n, size - (size_t)n, "%s%s", n ? " " : "", k->want->layer);
    else if (!n)
        snprintf(out, size, "beauty");
}

bool exr_next_view(const uint8_t **at, const uint8_t *end, const char **view, uint32_t *n)
{
    if (end - *at < 4)
        return false;
    *n = exr_u32(*at);
    if (*n > (size_t)(end - *at) - 4)
        return false;
    *view = (const char *)*at + 4;
    *at += 4 + *n;
    return true;
}

bool exr_same(const char *word, const char *bytes, uint32_t n)
{
    return strlen(word) == n && !memcmp(word, bytes, n);
}

static int pick_views(struct pick *k, struct exr_part *p)
{
    const uint8_t *at = p->multi_view, *end = at + p->multi_view_bytes;
    const char *view, *layer = given(k->want->layer) ? k->want->layer : "";
    uint32_t n;
    char prefix[EXR_PREFIX_BYTES], name[256];
    int taken = 0;
    for (unsigned i = 0; exr_next_view(&at, end, &view, &n); i++) {
        if ((given(k->want->view) && !exr_same(k->want->view, view, n)) || !n || n > 255)
            continue;
        if (*layer)
            snprintf(prefix, sizeof(prefix), "%.255s.%.*s.", layer, (int)n, view);
        else if (i)
            snprintf(prefix, sizeof(prefix), "%.*s.", (int)n, view);
        else
            prefix[0] = 0;
        title_of(k, p, view, n, name, sizeof(name));
        k->view = view;
        k->view_bytes = n;
        int one = take_prefix(k, p, prefix, name);
        if (one < 0)
            return -1;
        taken |= one;
    }
    if (*layer && !taken && !given(k->want->view)) { // a layer that is of no view
        snprintf(prefix, sizeof(prefix), "%.255s.", layer);
        title_of(k, p, "", 0, name, sizeof(name));
        k->view = NULL;
        k->view_bytes = 0;
        return take_prefix(k, p, prefix, name);
    }
    return taken;
}

static int pick_part(struct pick *k, struct exr_part *p)
{
    if (p->multi_view)
        return pick_views(k, p);
    if (given(k->want->view) && !(p->view && exr_same(k->want->view, p->view, p->view_bytes)))
        return 0;
    char prefix[EXR_PREFIX_BYTES] = "", name[256];
    if (given(k->want->layer))
        snprintf(prefix, sizeof(prefix), "%.255s.", k->want->layer);
    title_of(k, p, p->view, p->view_bytes, name, sizeof(name));
    k->view = p->view;
    k->view_bytes = p->view_bytes;
    return take_prefix(k, p, prefix, name);
}

// ---- the whole file ---------------------------------------------------------------------------------------

static bool part_matches(const struct exr *x, const struct exr_part *p, const char *word)
{
    if (p->name && exr_same(word, p->name, p->name_bytes))
        return true;
    for (unsigned i = 0; i < x->parts; i++) // names go before numbers
        if (x->part[i].name && exr_same(word, x->part[i].name, x->part[i].name_bytes))
            return false;
    char number[16];
    snprintf(number, sizeof(number), "%u", p->index);
    return !strcmp(word, number);
}

static int no_part(const struct exr *x, const char *word, struct fault *f)
{
    struct exr_list l = { .text = "" };
    for (unsigned i = 0; i < x->parts; i++)
        exr_list_add(&l, x->part[i].name ? x->part[i].name : "(no name)",
                 x->part[i].name ? x->part[i].name_bytes : 9);
    return fault_set(f, FAULT_NO_PART, "part", "part '%.40s' asked for; the file has %u part%s: %s", word,
                     x->parts, x->parts == 1 ? "" : "s", l.text);
}

// Whether the view that was asked for is anywhere; lists those that are.
static bool view_known(const struct exr *x, const char *word, struct exr_list *l)
{
    bool known = false;
    for (unsigned i = 0; i < x->parts; i++) {
        const struct exr_part *p = &x->part[i];
        const uint8_t *at = p->multi_view, *end = at ? at + p->multi_view_bytes : NULL;
        const char *view;
        uint32_t n;
        while (at && exr_next_view(&at, end, &view, &n)) {
            exr_list_add(l, view, n);
            known |= exr_same(word, view, n);
        }
        if (p->view && !p->multi_view) {
            exr_list_add(l, p->view, p->view_bytes);
            known |= exr_same(word, p->view, p->view_bytes);
        }
    }
    return known;
}

void exr_list_layers(const struct exr_part *p, struct exr_list *l)
{
    for (unsigned c = 0; c < p->channels; c++) {
        const char *name = p->channel[c].name, *dot = strrchr(name, '.');
        exr_list_add(l, name, dot ? (size_t)(dot - name) : strlen(name));
    }
}

static int nothing(const struct pick *k, struct fault *f)
{
    const struct exr_select *s = k->want;
    if (k->why.code && (!k->partial || k->explicit)) {
        if (f)
            *f = k->why;
        return -1;
    }
    struct exr_list l = { .text = "" };
    if (given(s->view) && !view_known(k->x, s->view, &l))
        return fault_set(f, FAULT_NO_VIEW, "view", "view '%.40s' asked for; the file has %s%s", s->view,
                         l.used ? "views: " : "no views", l.text);
    for (unsigned i = 0; i < k->x->parts; i++)
        if (!given(s->part) || part_matches(k->x, &k->x->part[i], s->part))
            exr_list_layers(&k->x->part[i], &l);
    if (given(s->layer))
        return fault_set(f, FAULT_NO_LAYER, "layer", "layer '%.40s' asked for; the file has: %s", s->layer,
                         l.text);
    return fault_set(f, FAULT_NO_LAYER, "layer",
                     "no unprefixed R, G, B or Y to bloom; layers and channels of the file: %s", l.text);
}

int exr_select_targets(struct exr *x, const struct exr_select *s, struct fault *f)
{
    struct pick k = { .x = x, .want = s, .explicit = given(s->part) || given(s->layer) };
    bool matched = false;
    x->target = calloc(EXR_TARGETS_MAX, sizeof(*x->target));
    if (!x->target)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the targets");
    for (unsigned i = 0; i < x->parts; i++) {
        if (given(s->part) && !part_matches(x, &x->part[i], s->part))
            continue;
        matched = true;
        if (pick_part(&k, &x->part[i]) < 0) {
            if (f)
                *f = k.why;
            return -1;
        }
    }
    if (!matched)
        return no_part(x, s->part, f);
    return x->targets ? 0 : nothing(&k, f);
}
