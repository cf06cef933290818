// SPDX-License-Identifier: Apache-2.0
/*
 * exr_encode.c - encode tasks: output planes -> chunks.
 *
 * Two ways. Patch: the chunk keeps its layout, so only samples that differ are put into its unpacked
 * bytes; when none does, nothing is stored and the container copies the input's chunk. Rebuild: types or
 * rows per chunk change, layers are added or the window grows, so rows are composed anew. In both, a sample keeps the file's bits unless
 * its new value, in the output's type, has others; a NaN that stays a NaN keeps its payload.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "exr_internal.h"

enum { TASK_PIXELS = 32 * 1024 };

// ---- the plan -------------------------------------------------------------------------------------------------

static bool touches(const struct exr *x, const struct exr_part *p)
{
    for (unsigned i = 0; i < x->targets; i++)
        if (x->target[i].pub.part == p->index && x->target[i].pub.role == EXR_SCENE && !x->target[i].untouched)
            return true;
    return false;
}

// Whether DWA codes a channel of this name with loss, as the library's rules say.
static bool dwa_is_lossy(const struct exr_channel *c)
{
    static const char *const names[] = { "R", "G", "B", "Y", "RY", "BY", "r", "g", "b", "ry", "by", "y",
                                         "red", "green", "blue" };
    const char *dot = strrchr(c->name, '.'), *last = dot ? dot + 1 : c->name;
    for (unsigned i = 0; i < sizeof(names) / sizeof(names[0]); i++)
        if (!strcmp(last, names[i]) && c->type != PIXEL_TYPE_UINT)
            return true;
    return false;
}

static void note_losses(struct exr *x, const struct exr_part *p)
{
    char others[96] = "", title[96];
    const bool kept = p->out_compression == p->compression;
    size_t used = 0;
    for (unsigned i = 0; i < p->channels; i++) {
        const struct exr_channel *c = &p->channel[i];
        bool loses = false;
        if (p->out_compression == EXR_DWAA || p->out_compression == EXR_DWAB)
            loses = dwa_is_lossy(c);
        else if (p->out_compression == EXR_B44 || p->out_compression == EXR_B44A)
            loses = c->type == PIXEL_TYPE_HALF && (!kept || c->linear);
        else if (p->out_compression == EXR_PXR24)
            loses = c->type == PIXEL_TYPE_FLOAT && !kept;
        if (c->target < 0 && loses && used + strlen(c->name) + 4 < sizeof(others))
            used += (size_t)snprintf(others + used, sizeof(others) - used, "%s%s", used ? " " : "", c->name);
    }
    if (used)
        exr_add_note(x, "%s: the compression is lossy, so chunks that changed may change these channels "
                     "slightly: %s", exr_part_title(p, title), others);
    else if (p->out_compression >= EXR_PXR24)
        exr_add_note(x, "%s: the compression is lossy for bloomed channels", exr_part_title(p, title));
}

static void note_grown(struct exr *x, const struct exr_part *p)
{
    char title[96];
    bool others = false, depth = false;
    for (unsigned i = 0; i < p->channels; i++) {
        const char *dot = strrchr(p->channel[i].name, '.');
        others |= p->channel[i].target < 0;
        depth |= p->channel[i].target < 0 && !strcmp(dot ? dot + 1 : p->channel[i].name, "Z");
    }
    if (others)
        exr_add_note(x, "%s: channels that are not bloomed are 0 in the %u pixels that it grew by on each side%s",
                     exr_part_title(p, title), p->grow, depth ? "; so is depth, Z" : "");
}

static int plan_part(struct exr *x, struct exr_part *p, struct fault *f)
{
    const bool touched = touches(x, p);
    if (x->options.compression != EXR_KEEP)
        p->out_compression = x->options.compression;
    p->grow = exr_part_grow(x, p);
    p->changes = touched || p->out_compression != p->compression || p->retyped || p->extended || p->grow;
    if (!p->changes)
        return 0;
    if (p->out_compression >= EXR_PXR24)
        note_losses(x, p);
    exr_note_dropped(x, p);
    if (p->grow)
        note_grown(x, p);
    if (exr_plan_outs(p, f))
        return -1;
    for (unsigned i = 0; i < x->targets; i++) {
        struct exr_state *t = &x->target[i];
        if (t->pub.part == p->index && t->pub.role == EXR_SCENE && t->luma_chroma && !t->untouched &&
            exr_yc_encode(x, t, f))
            return -1;
    }
    return touched && p->level0 < p->chunks ? exr_delta_make(x, p, f) : 0;
}

static int plan_tasks(struct exr *x, const struct exr_part *p, unsigned *room)
{
    uint64_t pixels = 0;
    uint32_t first = 0;
    for (uint32_t i = 0; i < p->outs; i++) {
        pixels += (uint64_t)p->out[i].width * p->out[i].rows;
        if (pixels < TASK_PIXELS && i + 1 < p->outs)
            continue;
        if (x->encode_tasks == *room) {
            *room = *room ? *room * 2 : 256;
            struct exr_task *more = realloc(x->encode_task, *room * sizeof(*more));
            if (!more)
                return -1;
            x->encode_task = more;
        }
        x->encode_task[x->encode_tasks++] = (struct exr_task){ p->index, 0, first, i + 1 - first };
        first = i + 1;
        pixels = 0;
    }
    return 0;
}

int exr_encode_begin(struct exr *x, const bool *untouched, struct fault *f)
{
    unsigned room = 0;
    if (exr_grow_check(x, f))
        return -1;
    for (unsigned i = 0; i < x->targets; i++)
        x->target[i].untouched = untouched[i];
    for (unsigned i = 0; i < x->parts; i++) {
        struct exr_part *p = &x->part[i];
        if (!p->scenes)
            continue;
        if (plan_part(x, p, f))
            return -1;
        if (p->changes && plan_tasks(x, p, &room))
            return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the encode plan");
    }
    return 0;
}

void exr_encode_free(const struct exr *x, struct exr_part *p)
{
    for (uint32_t i = 0; p->out && i < p->outs; i++)
        if (!exr_arena_has(&x->arena, p->out[i].data))
            free(p->out[i].data);
    free(p->out);
    p->out = NULL;
    exr_delta_free(p);
}

// ---- new rows -------------------------------------------------------------------------------------------------

struct job {
    struct exr *x;
    struct exr_part *p;
    struct exr_worker *w;
    struct exr_chunk *k;  // the input chunk at hand; of a grown part, the place of the output's
    uint8_t *row;         // scratch: a row of 4-byte samples, twice, and of halves
    uint64_t saturated, counted;
};

static float *job_floats(const struct job *j) { return (float *)(void *)j->row; }
static uint8_t *job_result(const struct job *j) { return j->row + 4 * (size_t)j->p->out_width; }
static uint16_t *job_half(const struct job *j)
{
    return (uint16_t *)(void *)(j->row + 8 * (size_t)j->p->out_width);
}

static const uint8_t *convert(struct job *j, const uint8_t *from, unsigned type, unsigned to, uint32_t n)
{
    if (type == to)
        return from;
    if (to == PIXEL_TYPE_HALF)
        j->saturated += float_to_half((uint16_t *)(void *)job_result(j),
                                      (const float *)(const void *)from, n);
    else
        half_to_float((float *)(void *)job_result(j), (const uint16_t *)(const void *)from, n);
    return job_result(j);
}

// The row of a target's channel in the output's type; NULL: as it was. raw: the file's bytes.
static const uint8_t *new_row(struct job *j, const struct exr_channel *c, uint32_t y, const uint8_t *raw)
{
    const struct exr_state *t = &j->x->target[c->target];
    const uint32_t n = j->k->width / (uint32_t)c->x_sampling;
    bool touched = c->output || !t->untouched;
    if (touched && !j->k->level_x && !j->k->level_y) {
        const bool chroma = t->luma_chroma && !c->output;
        const struct planes *from = chroma ? &t->yc[c->plane] : &t->out[c->output];
        const uint8_t *row = planes_row(from, chroma ? 0 : c->plane, y / (uint32_t)c->y_sampling);
        return convert(j, row + (size_t)j->k->x * pixel_bytes(from->type), from->type, c->out_type, n);
    }
    if (!touched && c->type == c->out_type)
        return NULL;
    exr_row_to_float(job_floats(j), raw, c->type, n, job_half(j));
    if (touched)
        touched = exr_delta_row(j->x, j->p, c, j->k, y, job_floats(j));
    if (!touched && c->type == c->out_type)
        return NULL;
    return convert(j, (const uint8_t *)job_floats(j), PIXEL_TYPE_FLOAT, c->out_type, n);
}

// Puts new samples where their bits differ, but for NaN over NaN. True when any did. *held counts samples
// that were put to the largest half: what the device's HALF planes hold back there.
static bool merge_half(uint8_t *raw, const uint8_t *new, uint32_t n, uint64_t *held)
{
    unsigned changed = 0;
    uint32_t largest = 0;
    for (uint32_t i = 0; i < n; i++) {
        uint16_t r, v;
        memcpy(&r, raw + 2 * (size_t)i, 2);
        memcpy(&v, new + 2 * (size_t)i, 2);
        const bool nans = (r & 0x7fff) > 0x7c00 && (v & 0x7fff) > 0x7c00;
        v = nans ? r : v;
        changed |= (unsigned)(v ^ r);
        largest += v != r && (v & 0x7fff) == 0x7bff;
        memcpy(raw + 2 * (size_t)i, &v, 2);
    }
    *held += largest;
    return changed != 0;
}

static bool merge_float(uint8_t *raw, const uint8_t *new, uint32_t n)
{
    uint32_t changed = 0;
    for (uint32_t i = 0; i < n; i++) {
        uint32_t r, v;
        memcpy(&r, raw + 4 * (size_t)i, 4);
        memcpy(&v, new + 4 * (size_t)i, 4);
        const bool nans = (r & 0x7fffffff) > 0x7f800000 && (v & 0x7fffffff) > 0x7f800000;
        v = nans ? r : v;
        changed |= v ^ r;
        memcpy(raw + 4 * (size_t)i, &v, 4);
    }
    return changed != 0;
}

static bool merge(uint8_t *raw, const uint8_t *new, unsigned type, uint32_t n, uint64_t *held)
{
    return type == PIXEL_TYPE_HALF ? merge_half(raw, new, n, held) : merge_float(raw, new, n);
}

// Rows that were converted here have been counted by the conversion.
static uint64_t *held_by(struct job *j, const uint8_t *row)
{
    return row == job_result(j) ? &j->counted : &j->saturated;
}

// The chunk's pixels as memory of its own; NULL: no memory.
static uint8_t *own_pixels(const struct exr *x, struct exr_chunk *k)
{
    if (!exr_in_input(x, k->pixels))
        return k->pixels;
    uint8_t *copy = malloc(k->unpacked_bytes);
    if (copy)
        k->pixels = memcpy(copy, k->pixels, k->unpacked_bytes);
    return copy;
}

// ---- chunks -------------------------------------------------------------------------------------------------

static int no_memory(struct fault *f) { return fault_set(f, FAULT_NO_MEMORY, "", "no memory to encode"); }

static int store(struct job *j, struct exr_out_chunk *o, uint32_t width, const uint8_t *pixels,
                 uint64_t bytes, struct fault *f)
{
    struct exr_codec_chunk c;
    const uint8_t *packed;
    uint64_t packed_bytes;
    char why[96] = "", title[96];
    if (exr_codec_view(j->w, j->p, o->row, width, o->rows, true, &c))
        return no_memory(f);
    if (exr_pack(j->w, &c, pixels, bytes, &packed, &packed_bytes, why))
        return fault_set(f, FAULT_INTERNAL, "", "chunk %u of %s %s", (unsigned)(o - j->p->out),
                         exr_part_title(j->p, title), why);
    // The chunk's own room is free now, and large enough, unless other chunks are made of it too.
    const bool reuse = !j->p->relayout && j->k->room && packed_bytes <= j->k->unpacked_bytes;
    o->data = reuse ? j->k->room : malloc(packed_bytes + 1);
    if (!o->data)
        return no_memory(f);
    if (packed != o->data)
        memcpy(o->data, packed, packed_bytes);
    o->bytes = packed_bytes;
    atomic_fetch_add_explicit(&j->x->chunks_encoded, 1, memory_order_relaxed);
    return 0;
}

static int patch(struct job *j, bool *changed, struct fault *f)
{
    struct exr_chunk *k = j->k;
    const struct exr_part *p = j->p;
    uint64_t at = 0;
    for (uint32_t y = k->y; y < k->y + k->height; y++)
        for (unsigned i = 0; i < p->channels; i++) {
            const struct exr_channel *c = &p->channel[i];
            if (y % (uint32_t)c->y_sampling)
                continue;
            const uint32_t n = k->width / (uint32_t)c->x_sampling;
            const uint64_t bytes = (uint64_t)n * pixel_bytes((enum pixel_type)c->type);
            const uint8_t *row = c->target < 0 ? NULL : new_row(j, c, y, k->pixels + at);
            if (row && memcmp(row, k->pixels + at, bytes)) {
                uint8_t *own = own_pixels(j->x, k);
                if (!own)
                    return no_memory(f);
                *changed |= merge(own + at, row, c->type, n, held_by(j, row));
            }
            at += bytes;
        }
    return 0;
}

// One row of the chunk at hand, in the output's channels and types; raw: in the input's.
static uint64_t rebuild_row(struct job *j, uint32_t y, const uint8_t *raw, uint8_t *out)
{
    uint64_t used = 0;
    for (unsigned i = 0; i < j->p->out_channels; i++) {
        const struct exr_channel *c = &j->p->out_channel[i];
        if (y % (uint32_t)c->y_sampling)
            continue;
        const uint32_t n = j->k->width / (uint32_t)c->x_sampling;
        const uint64_t in_bytes = (uint64_t)n * pixel_bytes((enum pixel_type)c->type);
        const uint64_t out_bytes = (uint64_t)n * pixel_bytes((enum pixel_type)c->out_type);
        const uint8_t *row = c->target < 0 ? NULL : new_row(j, c, y, raw);
        if (c->from < 0) { // nothing is under it
            memset(out + used, 0, out_bytes);
            merge(out + used, row, c->out_type, n, held_by(j, row));
            used += out_bytes;
            continue;
        }
        memcpy(out + used, row && c->type != c->out_type ? row : raw, out_bytes);
        if (row && c->type == c->out_type)
            merge(out + used, row, c->type, n, held_by(j, row));
        raw += in_bytes;
        used += out_bytes;
    }
    return used;
}

static int rebuild(struct job *j, struct exr_out_chunk *o, struct fault *f)
{
    struct exr_part *p = j->p;
    const uint64_t bytes = exr_rows_bytes(p, o->width, o->row, o->rows, true);
    uint8_t *out = exr_scratch(j->w, EXR_SCRATCH_CHUNK, bytes + 1);
    uint64_t used = 0;
    if (!out)
        return no_memory(f);
    const bool tiled = p->storage == EXR_TILED;
    for (uint32_t y = o->row; y < o->row + o->rows; y++) {
        if (!tiled)
            j->k = exr_scanline_chunk(p, y);
        const uint8_t *raw = j->k->pixels + exr_rows_bytes(p, o->width, j->k->y, y - j->k->y, false);
        used += rebuild_row(j, y, raw, out + used);
    }
    return store(j, o, o->width, out, bytes, f);
}

// A chunk of a grown window is like none of the input: its rows are gathered from those that it covers.
static int regrow(struct job *j, struct exr_out_chunk *o, struct fault *f)
{
    const struct exr_part *p = j->p;
    struct exr_chunk place = { .x = o->column, .width = o->width };
    const uint64_t bytes = exr_rows_bytes(p, o->width, o->row, o->rows, true);
    uint8_t *out = exr_scratch(j->w, EXR_SCRATCH_CHUNK, bytes + 1);
    uint8_t *raw = exr_scratch(j->w, EXR_SCRATCH_GROWN, exr_rows_bytes(p, o->width, 0, 1, false));
    uint64_t used = 0;
    if (!out || !raw)
        return no_memory(f);
    j->k = &place;
    for (uint32_t y = o->row; y < o->row + o->rows; y++) {
        exr_gather_row(p, (int64_t)o->column - p->grow, (int64_t)y - p->grow, o->width, raw);
        used += rebuild_row(j, y, raw, out + used);
    }
    return store(j, o, o->width, out, bytes, f);
}

static int encode_chunk(struct job *j, uint32_t i, struct fault *f)
{
    struct exr_part *p = j->p;
    struct exr_out_chunk *o = &p->out[i];
    if (p->grow)
        return regrow(j, o, f);
    if (p->relayout)
        return rebuild(j, o, f);
    j->k = &p->chunk[i];
    if (i >= p->level0 && !p->retyped && p->out_compression == p->compression && !p->delta)
        return 0;
    if (exr_decode_chunk(j->x, p, j->k, j->w, f))
        return -1;
    bool changed = p->out_compression != p->compression;
    int result = 0;
    if (p->retyped || p->extended) {
        result = rebuild(j, o, f);
    } else {
        result = patch(j, &changed, f);
        if (!result && changed)
            result = store(j, o, j->k->width, j->k->pixels, j->k->unpacked_bytes, f);
    }
    exr_drop_pixels(j->x, j->k); // no other task looks at it
    return result;
}

unsigned exr_encode_tasks(const struct exr *x) { return x->encode_tasks; }

int exr_encode(struct exr *x, unsigned task, struct exr_worker *w, struct fault *f)
{
    const struct exr_task *t = &x->encode_task[task];
    struct job j = { .x = x, .p = &x->part[t->part], .w = w };
    j.row = exr_scratch(w, EXR_SCRATCH_ROW, 12 * (uint64_t)j.p->out_width);
    if (!j.row)
        return no_memory(f);
    int result = 0;
    for (uint32_t i = t->first; i < t->first + t->count && !result; i++) {
        j.k = NULL;
        result = encode_chunk(&j, i, f);
    }
    if (j.saturated)
        atomic_fetch_add_explicit(&x->saturated, j.saturated, memory_order_relaxed);
    return result;
}
