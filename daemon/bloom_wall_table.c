// SPDX-License-Identifier: Apache-2.0
// bloom_wall_table.c - the weights with which a wall's pixels look at planes and levels.
//
// The mean over a wall pixel is linear and separable, and so are the pyramid's doublings U and a Gaussian K at its level: the mean of U^l K E
// is (A U^l K) E, where A is how much of each pixel a wall pixel covers, by its size. So each axis has one row of weights a wall column
// (row), worked out in double. A is worked out in the frame's coordinates and then moved by whole pixels: the weights of
// a wall pixel have the same bits wherever the target lies in the frame, as long as that is a multiple of 2^l.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bloom_host.h"

enum { TABLE_BYTES_MAX = 64 << 20 };

/* One axis of a wall and of its target. */
struct side {
    double at, pitch;         /* pixels of the frame */
    uint32_t first, end;      /* wall columns that are wanted */
    double shift;             /* of the target in the frame */
    uint32_t extent;          /* of the target */
};

/* One axis of a source: what the taps pass on their way, and where its cells are kept. */
struct way {
    unsigned level;
    const unsigned char *order;
    const struct psf_taps *taps; /* NULL: none */
    long margin, stored;         /* cells before cell 0, and all */
    bool aligned;                /* tables begin at a multiple of 4 */
};

struct window {
    long first, count;
    double *v, *spare; /* room for `room` each */
    long room;
};

static double window_at(const struct window *w, long i)
{
    return i >= w->first && i < w->first + w->count ? w->v[i - w->first] : 0;
}

static void window_take(struct window *w, long first, long count)
{
    assert(count <= w->room);
    double *t = w->v;
    w->v = w->spare;
    w->spare = t;
    w->first = first;
    w->count = count;
}

// The share of each of the target's pixels in the mean over wall column i. (What lies outside the target has no light.)
static void window_area(struct window *w, const struct side *s, uint32_t i)
{
    const double from = s->at + i * s->pitch, to = s->at + (i + 1.0) * s->pitch;
    const double low = fmax(floor(from), s->shift), high = fmin(ceil(to), s->shift + s->extent);
    w->first = w->count = 0;
    if (!(high > low))
        return;
    w->first = (long)(low - s->shift);
    w->count = (long)(high - low);
    for (long k = 0; k < w->count; k++)
        w->v[k] = fmax(0, fmin(to, low + k + 1.0) - fmax(from, low + k)) / s->pitch;
}

static long floor_half(long i) { return i >= 0 ? i / 2 : -((1 - i) / 2); }

// The transpose of one doubling: coarse cell j gives 2 b[k] of itself to fine cell 2j + k - h.
static void window_octave(struct window *w, unsigned order)
{
    const long h = order / 2 - 1, from = floor_half(w->first + h - (long)order + 1);
    const long to = floor_half(w->first + w->count - 1 + h) + 1;
    const double *b = psf_binomial(order);
    for (long j = from; j < to; j++) {
        double sum = 0;
        for (long k = 0; k < (long)order; k++)
            sum += 2 * b[k < (long)order / 2 ? k : (long)order - 1 - k] * window_at(w, 2 * j + k - h);
        w->spare[j - from] = sum;
    }
    window_take(w, from, to - from);
}

static void window_blur(struct window *w, const struct psf_taps *t)
{
    const long h = t->half, from = w->first - h, count = w->count + 2 * h;
    for (long j = 0; j < count; j++) {
        double sum = 0;
        for (long k = -h; k <= h; k++)
            sum += t->tap[labs(k)] * window_at(w, from + j + k);
        w->spare[j] = sum;
    }
    window_take(w, from, count);
}

// Of wall column i, in kept cells; those that are not kept have no light.
static void window_make(struct window *w, const struct side *s, const struct way *y, uint32_t i)
{
    window_area(w, s, i);
    for (unsigned o = 0; w->count && o < y->level; o++)
        window_octave(w, y->order[o]);
    if (w->count && y->taps)
        window_blur(w, y->taps);
    w->first += y->margin;
    const long skip = w->first < 0 ? -w->first : 0, past = w->first + w->count - y->stored;
    w->count -= skip + (past > 0 ? past : 0);
    if (w->count <= 0) {
        w->first = w->count = 0;
        return;
    }
    memmove(w->v, w->v + skip, (size_t)w->count * sizeof(double));
    w->first += skip;
}

static long begin_of(const struct window *w, const struct way *y) { return y->aligned ? w->first / 4 * 4 : w->first; }

/* A table on the host: [1 + chunks][n] texels of 4, of which the first of a column says where it begins (and, across, where
 * the source's last texel is, and how many chunks there are). */
struct table {
    unsigned chunks;
    uint32_t column, last; /* across: of the source in wall_work.rows */
    uint32_t n, taps;
    float *texel;
};

static int table_make(struct table *t, const struct side *s, const struct way *y, bool across, const struct vk *v, struct fault *f)
{
    const long room = (long)s->extent + 4 * PSF_TAPS_MAX + 64;
    double *memory = malloc(2 * (size_t)room * sizeof(double));
    if (!memory)
        return fault_set(f, FAULT_NO_MEMORY, "", "out of memory for a wall's weights");
    struct window w = { .v = memory, .spare = memory + room, .room = room };
    t->n = s->end - s->first;
    for (uint32_t i = s->first; i < s->end; i++) {
        window_make(&w, s, y, i);
        const unsigned chunks = (unsigned)((w.first + w.count - begin_of(&w, y) + 3) / 4);
        t->chunks = chunks > t->chunks ? chunks : t->chunks;
        t->taps = (uint32_t)w.count > t->taps ? (uint32_t)w.count : t->taps;
    }
    const uint64_t bytes = (uint64_t)t->n * (1 + t->chunks) * 4 * sizeof(float);
    if (bytes > TABLE_BYTES_MAX || 1 + t->chunks > v->properties.limits.maxImageDimension2D) {
        free(memory);
        return fault_set(f, FAULT_LIMIT, "wall", "%u wall pixels %s of %g frame pixels each: weights of %llu bytes, at most %d expected",
                         t->n, across ? "across" : "down", s->pitch, (unsigned long long)bytes, TABLE_BYTES_MAX);
    }
    t->texel = calloc(1, bytes);
    for (uint32_t i = s->first; t->texel && i < s->end; i++) {
        window_make(&w, s, y, i);
        const long begin = begin_of(&w, y);
        float *column = t->texel + (size_t)(i - s->first) * 4;
        column[0] = (float)(across ? (long)t->column + begin / 4 : begin);
        column[1] = (float)t->last;
        column[2] = (float)t->chunks;
        for (long k = 0; k < w.count; k++) {
            const long at = w.first - begin + k;
            column[(size_t)(1 + at / 4) * t->n * 4 + (size_t)(at % 4)] = (float)w.v[k];
        }
    }
    free(memory);
    return t->texel ? 0 : fault_set(f, FAULT_NO_MEMORY, "", "out of memory for a wall's weights");
}

// The same for the host: each column's own weights, one after the other.
static int taps_make(struct wall_taps *t, const struct side *s, const struct way *y, struct fault *f)
{
    const long room = (long)s->extent + 4 * PSF_TAPS_MAX + 64;
    double *memory = malloc(2 * (size_t)room * sizeof(double));
    struct window w = { .v = memory, .spare = memory + room, .room = room };
    t->n = s->end - s->first;
    t->room = 1;
    for (uint32_t i = s->first; memory && i < s->end; i++) {
        window_make(&w, s, y, i);
        t->room = (uint32_t)w.count > t->room ? (uint32_t)w.count : t->room;
    }
    const uint64_t bytes = (uint64_t)t->n * t->room * sizeof(float);
    if (bytes > TABLE_BYTES_MAX) {
        free(memory);
        return fault_set(f, FAULT_LIMIT, "wall", "%u wall pixels of %g frame pixels each: weights of %llu bytes, at most %d expected",
                         t->n, s->pitch, (unsigned long long)bytes, TABLE_BYTES_MAX);
    }
    t->first = calloc(t->n, sizeof(*t->first));
    t->count = calloc(t->n, sizeof(*t->count));
    t->weight = calloc(1, bytes);
    const bool all = memory && t->first && t->count && t->weight;
    for (uint32_t i = s->first; all && i < s->end; i++) {
        window_make(&w, s, y, i);
        t->first[i - s->first] = (uint32_t)w.first;
        t->count[i - s->first] = (uint32_t)w.count;
        for (long k = 0; k < w.count; k++)
            t->weight[(size_t)(i - s->first) * t->room + (size_t)k] = (float)w.v[k];
    }
    free(memory);
    return all ? 0 : fault_set(f, FAULT_NO_MEMORY, "", "out of memory for a wall's weights");
}

/* ---- on the device ----------------------------------------------------------------------------------- */

static size_t table_bytes(const struct table *t) { return (size_t)t->n * (1 + t->chunks) * 16; }

struct tables {
    struct table t[WALL_SOURCES_MAX][2]; /* down, across */
    uint32_t lines;                      /* of all across */
};

static void sides_of(const struct frame *fr, struct side side[2])
{
    const struct bloom_wall *w = fr->wall;
    side[0] = (struct side){ w->y, w->pitch_y, w->first_y, w->end_y, w->frame_y, fr->target->height };
    side[1] = (struct side){ w->x, w->pitch_x, w->first_x, w->end_x, w->frame_x, fr->target->width };
}

// Down and across.
static void ways_of(const struct frame *fr, const struct wall_source *s, bool picture, struct way way[2])
{
    const struct targets *t = &fr->b->targets;
    const struct plan *p = fr->b->plan;
    if (picture) {
        way[0] = (struct way){ .level = s->level, .stored = fr->target->height, .aligned = !fr->wall_direct };
        way[1] = (struct way){ .level = s->level, .stored = fr->target->width, .aligned = !fr->wall_host };
        return;
    }
    const struct plan_gaussian *g = s->gaussian >= 0 ? &p->gaussian[s->gaussian] : NULL;
    const struct level *v = fr->wall_host ? &fr->b->host->level[s->level] : &t->level[s->level];
    const bool layered = !fr->wall_host && s->level == 0 && g;
    way[0] = (struct way){ s->level, p->order, g ? &g->y : NULL, LEVEL_MARGIN, layered ? 2 * (long)t->layered_groups : 4 * (long)v->groups,
                           false };
    way[1] = (struct way){ s->level, p->order, g ? &g->x : NULL, LEVEL_MARGIN, 4 * (long)v->texels, !fr->wall_host };
}

static int host_tables_make(struct wall_work *k, const struct frame *fr)
{
    struct side side[2];
    sides_of(fr, side);
    for (unsigned i = 0; i < k->sources; i++) {
        struct way way[2];
        ways_of(fr, &k->source[i], i == 0, way);
        for (unsigned a = 0; a < 2; a++)
            if (taps_make(&k->taps[i][a], &side[a], &way[a], fr->f) < 0)
                return -1;
        k->source[i].taps_down = k->taps[i][0].room;
        k->source[i].taps_across = k->taps[i][1].room;
    }
    const uint64_t columns = k->taps[0][1].n, bands = (k->taps[0][0].n + HOST_ROWS - 1) / HOST_ROWS;
    const uint64_t floats = columns * bands * HOST_ROWS * 3;
    k->light = floats > SIZE_MAX / sizeof(float) ? NULL : malloc(floats * sizeof(float));
    return k->light ? 0 : fault_set(fr->f, FAULT_NO_MEMORY, "wall", "out of memory for %llu wall pixels", (unsigned long long)(floats / 3));
}

static int tables_make(struct tables *all, struct wall_work *k, const struct frame *fr)
{
    struct side side[2];
    uint32_t column = 0;
    sides_of(fr, side);
    for (unsigned i = 0; i < k->sources; i++) {
        struct wall_source *s = &k->source[i];
        struct way way[2];
        ways_of(fr, s, i == 0, way);
        const struct way down = way[0], across = way[1];
        s->column = column;
        s->texels = (uint32_t)(across.stored + 3) / 4;
        column += s->texels;
        all->t[i][1] = (struct table){ .column = s->column, .last = column - 1 };
        if (table_make(&all->t[i][0], &side[0], &down, false, &fr->b->vk, fr->f) < 0 ||
            table_make(&all->t[i][1], &side[1], &across, true, &fr->b->vk, fr->f) < 0)
            return -1;
        // Aligned tables may begin before their first tap.
        s->taps_down = down.aligned ? 4 * all->t[i][0].chunks : all->t[i][0].taps;
        s->taps_across = all->t[i][1].taps;
        s->chunks_across = all->t[i][1].chunks;
        all->lines += 1 + all->t[i][1].chunks;
    }
    return 0;
}

static int add_image(struct bloom *b, struct vk_image *m, uint32_t width, uint32_t height, VkDeviceSize *bytes,
                     uint32_t *types, struct fault *f)
{
    const uint32_t most = b->vk.properties.limits.maxImageDimension2D;
    if (width > most || height > most)
        return fault_set(f, FAULT_LIMIT, "wall", "an image of %u x %u: the device takes up to %u x %u", width, height, most, most);
    if (vk_image_create(&b->vk, m, VK_FORMAT_R32G32B32A32_SFLOAT, width, height, 1, false, f) < 0)
        return -1;
    *bytes = (*bytes + m->needs.alignment - 1) / m->needs.alignment * m->needs.alignment + m->needs.size;
    *types &= m->needs.memoryTypeBits;
    return 0;
}

static int bind_next(struct bloom *b, struct wall_work *k, struct vk_image *m, VkDeviceSize *at, struct fault *f)
{
    *at = (*at + m->needs.alignment - 1) / m->needs.alignment * m->needs.alignment;
    const VkDeviceSize offset = *at;
    *at += m->needs.size;
    return vk_image_bind(&b->vk, m, &k->memory, offset, f);
}

// Every image of the wall in one piece of memory.
static int images_make(struct wall_work *k, const struct tables *all, const struct frame *fr)
{
    struct bloom *b = fr->b;
    const struct bloom_wall *w = fr->wall;
    const uint32_t columns = w->end_x - w->first_x, rows = w->end_y - w->first_y;
    struct vk_image *image[WALL_SOURCES_MAX + 4];
    unsigned n = 0;
    VkDeviceSize bytes = 0, at = 0;
    uint32_t types = ~0u;
    const struct wall_source *last = &k->source[k->sources - 1];
    const struct { struct vk_image *image; uint32_t width, height; } shared[] = {
        { &k->rows, last->column + last->texels, rows * fr->target->geometry.channels },
        { &k->drive, columns, rows },
        { &k->across, columns, all->lines },
        { &k->gain, w->width, w->height },
    };
    for (unsigned i = 0; i < (w->gain ? 4 : 3); i++) {
        image[n++] = shared[i].image;
        if (add_image(b, shared[i].image, shared[i].width, shared[i].height, &bytes, &types, fr->f) < 0)
            return -1;
    }
    for (unsigned i = 0; i < k->sources; i++) {
        image[n++] = &k->source[i].down;
        if (add_image(b, &k->source[i].down, rows, 1 + all->t[i][0].chunks, &bytes, &types, fr->f) < 0)
            return -1;
    }
    if (vk_memory_reserve(&b->vk, &k->memory, bytes, types, VK_PLACE_DEVICE, fr->f) < 0)
        return -1;
    for (unsigned i = 0; i < n; i++)
        if (bind_next(b, k, image[i], &at, fr->f) < 0)
            return -1;
    return vk_buffer_reserve(&b->vk, &k->back, (VkDeviceSize)columns * rows * 16, VK_BUFFER_USAGE_TRANSFER_DST_BIT, fr->f);
}

static void upload(struct bloom *b, struct vk_image *m, VkDeviceSize offset)
{
    vk_use(&b->commands, m, VK_PIPELINE_STAGE_2_COPY_BIT, VK_ACCESS_2_TRANSFER_WRITE_BIT, true);
    vk_flush_barriers(&b->commands);
    const VkBufferImageCopy copy = {
        .bufferOffset = offset,
        .imageSubresource = { VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1 },
        .imageExtent = { m->width, m->height, 1 },
    };
    vkCmdCopyBufferToImage(b->commands.buffer, b->exchange.buffer, m->image, VK_IMAGE_LAYOUT_GENERAL, 1, &copy);
}

static int tables_upload(struct wall_work *k, const struct tables *all, const struct frame *fr)
{
    struct bloom *b = fr->b;
    VkDeviceSize bytes = 0, begin = 0;
    for (unsigned i = 0; i < k->sources; i++)
        for (unsigned a = 0; a < 2; a++)
            bytes += table_bytes(&all->t[i][a]);
    if (vk_buffer_reserve(&b->vk, &b->exchange, bytes, EXCHANGE_USAGE, fr->f) < 0 || vk_begin(&b->commands, fr->f) < 0)
        return -1;
    bytes = 0;
    for (unsigned a = 0; a < 2; a++) {
        begin = bytes;
        for (unsigned i = 0; i < k->sources; i++) {
            const struct table *t = &all->t[i][a];
            memcpy(b->exchange.memory.map + bytes, t->texel, table_bytes(t));
            if (a == 0)
                upload(b, &k->source[i].down, bytes);
            bytes += table_bytes(t);
        }
    }
    upload(b, &k->across, begin);
    return vk_submit_and_wait(&b->commands, fr->f);
}

static int gain_upload(struct wall_work *k, const struct frame *fr)
{
    struct bloom *b = fr->b;
    const struct bloom_wall *w = fr->wall;
    const size_t pixels = (size_t)w->width * w->height;
    if (k->host || !w->gain || (k->has_gain && k->gain_id == w->gain_id))
        return 0;
    if (vk_buffer_reserve(&b->vk, &b->exchange, pixels * 16, EXCHANGE_USAGE, fr->f) < 0 || vk_begin(&b->commands, fr->f) < 0)
        return -1;
    float *to = (float *)(void *)b->exchange.memory.map;
    for (size_t i = 0; i < pixels; i++) {
        memcpy(to + 4 * i, w->gain + 3 * i, 3 * sizeof(float));
        to[4 * i + 3] = 0;
    }
    k->has_gain = false;
    upload(b, &k->gain, 0);
    if (vk_submit_and_wait(&b->commands, fr->f) < 0)
        return -1;
    k->has_gain = true;
    k->gain_id = w->gain_id;
    return 0;
}

/* ---- kept from frame to frame -------------------------------------------------------------------------- */

static void images_destroy(struct vk *v, struct wall_work *k)
{
    vk_image_destroy(v, &k->rows);
    vk_image_destroy(v, &k->drive);
    vk_image_destroy(v, &k->across);
    vk_image_destroy(v, &k->gain);
    for (unsigned i = 0; i < WALL_SOURCES_MAX; i++)
        vk_image_destroy(v, &k->source[i].down);
}

static void host_tables_free(struct wall_work *k)
{
    for (unsigned i = 0; i < WALL_SOURCES_MAX; i++)
        for (unsigned a = 0; a < 2; a++) {
            struct wall_taps *t = &k->taps[i][a];
            free(t->first);
            free(t->count);
            free(t->weight);
            *t = (struct wall_taps){ 0 };
        }
    free(k->light);
    k->light = NULL;
}

void wall_work_destroy(struct vk *v, struct wall_work *k)
{
    if (!k)
        return;
    images_destroy(v, k);
    host_tables_free(k);
    vk_memory_free(v, &k->memory);
    vk_buffer_free(v, &k->back);
    free(k);
}

static bool same_wall(const struct bloom_wall *a, const struct bloom_wall *b)
{
    return a->width == b->width && a->height == b->height && a->first_x == b->first_x && a->first_y == b->first_y &&
           a->end_x == b->end_x && a->end_y == b->end_y && a->x == b->x && a->y == b->y && a->pitch_x == b->pitch_x &&
           a->pitch_y == b->pitch_y && a->frame_x == b->frame_x && a->frame_y == b->frame_y && !a->gain == !b->gain;
}

static bool same_work(const struct wall_work *k, const struct frame *fr)
{
    return k->used && same_wall(&k->wall, fr->wall) && k->width == fr->target->width && k->height == fr->target->height &&
           k->channels == fr->target->geometry.channels && k->direct == fr->wall_direct && k->host == fr->wall_host &&
           (!fr->wall_direct || !memcmp(&k->plan, fr->b->plan, sizeof(k->plan)));
}

// The picture itself; then each Gaussian below the sum's level by itself, then the sum.
static void list_sources(struct wall_work *k, const struct frame *fr)
{
    const struct plan *p = fr->b->plan;
    k->sources = 0;
    k->source[k->sources++] = (struct wall_source){ .gaussian = -1 };
    if (!fr->wall_direct)
        return;
    unsigned g = 0;
    for (; g < p->count && p->gaussian[g].level < fr->wall_level; g++)
        k->source[k->sources++] = (struct wall_source){ .gaussian = (int)g, .level = p->gaussian[g].level };
    k->summed = g < p->count;
    if (k->summed)
        k->source[k->sources++] = (struct wall_source){ .gaussian = -1, .level = fr->wall_level };
}

static int work_make(struct wall_work *k, const struct frame *fr)
{
    struct bloom *b = fr->b;
    k->used = 0;
    k->has_gain = false;
    images_destroy(&b->vk, k);
    host_tables_free(k);
    k->wall = *fr->wall;
    k->width = fr->target->width;
    k->height = fr->target->height;
    k->channels = fr->target->geometry.channels;
    k->direct = fr->wall_direct;
    k->host = fr->wall_host;
    if (k->direct)
        memcpy(&k->plan, b->plan, sizeof(k->plan)); // padding too, for it is compared so
    list_sources(k, fr);
    if (k->host)
        return host_tables_make(k, fr);
    struct tables *all = calloc(1, sizeof(*all));
    int r = all ? 0 : fault_set(fr->f, FAULT_NO_MEMORY, "", "out of memory for a wall's weights");
    if (r == 0)
        r = tables_make(all, k, fr);
    if (r == 0)
        r = images_make(k, all, fr);
    if (r == 0)
        r = tables_upload(k, all, fr);
    for (unsigned i = 0; all && i < WALL_SOURCES_MAX; i++)
        for (unsigned a = 0; a < 2; a++)
            free(all->t[i][a].texel);
    free(all);
    return r;
}

int wall_work_find(struct frame *fr, struct wall_work **out)
{
    struct bloom *b = fr->b;
    unsigned at = 0;
    for (unsigned i = 0; i < WALL_KEPT; i++) {
        if (!b->wall[i] && !(b->wall[i] = calloc(1, sizeof(*b->wall[i]))))
            return fault_set(fr->f, FAULT_NO_MEMORY, "", "out of memory for a wall");
        if (same_work(b->wall[i], fr)) {
            at = i;
            break;
        }
        at = b->wall[i]->used < b->wall[at]->used ? i : at;
    }
    struct wall_work *k = b->wall[at];
    if ((!same_work(k, fr) && work_make(k, fr) < 0) || gain_upload(k, fr) < 0)
        return -1;
    k->used = ++b->walls_asked;
    *out = k;
    return 0;
}
