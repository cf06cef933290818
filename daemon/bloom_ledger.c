// SPDX-License-Identifier: Apache-2.0
// bloom_ledger.c - where the light went, without looking at the full frame again.
//
// Every filter's taps sum to 1 and nothing is cut at the borders (the apron keeps it), so 4^L times the sum of
// level L is the sum of E: the coarsest level tells it. A Gaussian's light that falls outside the data
// window is, by the transpose of its filters, a weighted sum over its level's cells where the weight 1 - v_x v_y
// is 0 but near the edges: v = K^T U^T 1, one dimension at a time. So only the edges are read back.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bloom_internal.h"

void ledger_clear(struct ledger *l)
{
    for (unsigned g = 0; g < PARAMS_GAUSSIANS_MAX; g++) {
        free(l->inside_x[g]);
        free(l->inside_y[g]);
        l->inside_x[g] = l->inside_y[g] = NULL;
    }
    l->count = 0;
    l->bytes = 0;
}

static double cell(const double *v, long n, long i) { return i < 0 || i >= n ? 0 : v[i]; }

// v over the stored cells of `level`, from -LEVEL_MARGIN on. size: of the canvas, of which the outer `pad` are outside.
static double *inside(uint32_t size, uint32_t pad, unsigned level, const unsigned char *order, const struct psf_taps *taps)
{
    uint32_t extent = size;
    long n = (long)((extent + 3) / 4 * 4 + 2 * LEVEL_MARGIN);
    double *v = calloc((size_t)n, sizeof(*v)), *w = calloc((size_t)n, sizeof(*w));
    if (!v || !w)
        goto fail;
    for (uint32_t i = pad; i + pad < size; i++)
        v[LEVEL_MARGIN + i] = 1;
    // U^T is the halving times 2; a cell of level i+1 stands for 2 of level i, which takes the 2 back.
    for (unsigned o = 0; o < level; o++) {
        const long h = order[o] / 2 - 1;
        const double *b = psf_binomial(order[o]);
        extent = (extent + 1) / 2;
        const long m = (long)((extent + 3) / 4 * 4 + 2 * LEVEL_MARGIN);
        for (long j = 0; j < m; j++) {
            double s = 0;
            for (long k = 0; k < order[o]; k++)
                s += b[k < order[o] / 2 ? k : order[o] - 1 - k] *
                     cell(v, n, 2 * (j - LEVEL_MARGIN) + k - h + LEVEL_MARGIN);
            w[j] = s;
        }
        double *t = v;
        v = w;
        w = t;
        n = m;
    }
    for (long j = 0; j < n; j++) {
        double s = 0;
        for (long k = -(long)taps->half; k <= (long)taps->half; k++)
            s += taps->tap[labs(k)] * cell(v, n, j + k);
        // Interior sums are 1 up to rounding; make them exactly so, there is nothing lost there.
        w[j] = s > 1 - 1e-12 ? 1 : s;
    }
    free(v);
    return w;
fail:
    free(v);
    free(w);
    return NULL;
}

static size_t texel_bytes(const struct targets *t) { return t->shape.half ? 8 : 16; }

static void add_region(struct ledger *l, const struct targets *t, unsigned level, uint32_t column0,
                       uint32_t columns, uint32_t group0, uint32_t groups)
{
    if (!columns || !groups)
        return;
    struct ledger_region *r = &l->region[l->count++];
    *r = (struct ledger_region){ level, column0, columns, group0, groups, l->bytes };
    l->bytes += (VkDeviceSize)columns * groups * texel_bytes(t) * LEVEL_PHASES * t->shape.channels;
}

// Texels from the edge on within which some weight of an axis is below 1; the same on both sides.
static uint32_t edge_of(const double *v, uint32_t texels)
{
    uint32_t edge = 0;
    for (uint32_t i = 0; i < texels; i++)
        for (unsigned k = 0; k < 4; k++)
            if (v[4 * i + k] < 1) {
                const uint32_t from = i + 1 < texels - i ? i + 1 : texels - i;
                edge = from > edge ? from : edge;
            }
    return edge;
}

static void add_edges(struct ledger *l, const struct targets *t, unsigned level, uint32_t ex, uint32_t ey)
{
    const struct level *v = &t->level[level];
    if (2 * ex >= v->texels || 2 * ey >= v->groups) {
        add_region(l, t, level, 0, v->texels, 0, v->groups);
        return;
    }
    add_region(l, t, level, 0, ex, 0, v->groups);
    add_region(l, t, level, v->texels - ex, ex, 0, v->groups);
    add_region(l, t, level, ex, v->texels - 2 * ex, 0, ey);
    add_region(l, t, level, ex, v->texels - 2 * ex, v->groups - ey, ey);
}

int ledger_prepare(struct ledger *l, const struct plan *p, const struct targets *t, uint32_t pad, struct fault *f)
{
    ledger_clear(l);
    l->whole = pad > 0;
    uint32_t ex[PSF_LEVELS_MAX + 1] = { 0 }, ey[PSF_LEVELS_MAX + 1] = { 0 };
    for (unsigned g = 0; g < p->count; g++) {
        const struct plan_gaussian *k = &p->gaussian[g];
        const struct level *v = &t->level[k->level];
        l->inside_x[g] = inside(t->shape.width, pad, k->level, p->order, &k->x);
        l->inside_y[g] = inside(t->shape.height, pad, k->level, p->order, &k->y);
        if (!l->inside_x[g] || !l->inside_y[g])
            return fault_set(f, FAULT_NO_MEMORY, "", "out of memory for the energy ledger");
        const uint32_t x = l->whole ? v->texels : edge_of(l->inside_x[g], v->texels);
        const uint32_t y = l->whole ? v->groups : edge_of(l->inside_y[g], v->groups);
        ex[k->level] = x > ex[k->level] ? x : ex[k->level];
        ey[k->level] = y > ey[k->level] ? y : ey[k->level];
    }
    for (unsigned i = 0; i < t->shape.octaves; i++)
        add_edges(l, t, i, ex[i], ey[i]);
    l->total_region = l->count;
    const struct level *top = &t->level[t->shape.octaves];
    for (unsigned i = 0; i <= LEDGER_TOTALS; i++)
        add_region(l, t, t->shape.octaves, 0, top->texels, 0, top->groups);
    return 0;
}

static void record_region(struct vk_commands *c, struct ledger *l, struct targets *t, const struct ledger_region *r)
{
    struct vk_image *m = r->level ? &t->e[r->level] : &t->layered;
    vk_use(c, m, VK_PIPELINE_STAGE_2_COPY_BIT, VK_ACCESS_2_TRANSFER_READ_BIT, false);
    vk_flush_barriers(c);
    for (unsigned ch = 0; ch < t->shape.channels; ch++) {
        // At level 0 a group of 4 rows is two of the layered image's, in its two phases.
        const bool layered = r->level == 0;
        const uint32_t rows = layered ? 2 : 1, layers = layered ? 2 : LEVEL_PHASES;
        uint32_t first = r->group0 * rows, count = r->groups * rows;
        if (layered) {
            first = first < t->layered_groups ? first : t->layered_groups;
            count = count < t->layered_groups - first ? count : t->layered_groups - first;
        }
        if (!count)
            continue;
        const VkBufferImageCopy copy = {
            .bufferOffset = r->offset + (VkDeviceSize)ch * r->columns * r->groups * texel_bytes(t) * LEVEL_PHASES,
            .bufferRowLength = r->columns,
            .bufferImageHeight = r->groups * rows,
            .imageSubresource = { VK_IMAGE_ASPECT_COLOR_BIT, 0, layered ? ch * 2 : 0, layers },
            .imageOffset = { (int32_t)r->column0,
                             (int32_t)(first + (layered ? 0 : ch * t->level[r->level].groups)), 0 },
            .imageExtent = { r->columns, count, 1 },
        };
        vkCmdCopyImageToBuffer(c->buffer, m->image, VK_IMAGE_LAYOUT_GENERAL, l->buffer.buffer, 1, &copy);
    }
}

int ledger_record(struct vk_commands *c, struct ledger *l, struct targets *t, struct fault *f)
{
    if (vk_buffer_reserve(c->vk, &l->buffer, l->bytes, VK_BUFFER_USAGE_TRANSFER_DST_BIT, f) < 0)
        return -1;
    for (unsigned i = 0; i <= l->total_region; i++)
        record_region(c, l, t, &l->region[i]);
    return 0;
}

int ledger_record_total(struct vk_commands *c, struct ledger *l, struct targets *t, unsigned i, struct fault *f)
{
    if (vk_buffer_reserve(c->vk, &l->buffer, l->bytes, VK_BUFFER_USAGE_TRANSFER_DST_BIT, f) < 0)
        return -1;
    record_region(c, l, t, &l->region[l->total_region + 1 + i]);
    return 0;
}

// Sum over the region's cells of weight_c * E_c * (vx * vy), or, outside, of its complement; all of it with vx NULL.
static double region_sum(const struct ledger *l, const struct ledger_region *r, const struct targets *t,
                         const double weight[3], const double *vx, const double *vy, bool outside)
{
    double total = 0;
    const bool layered = r->level == 0;
    const uint32_t per_group = layered ? 2 : LEVEL_PHASES;
    for (unsigned ch = 0; ch < t->shape.channels; ch++) {
        const size_t row_bytes = r->columns * texel_bytes(t);
        const uint8_t *base = l->buffer.memory.map + r->offset + ch * row_bytes * r->groups * LEVEL_PHASES;
        double of_channel = 0;
        for (uint32_t row = 0; weight[ch] != 0 && row < r->groups * 4; row++) {
            const uint32_t y = r->group0 * 4 + row;
            if (layered && y / 2 >= t->layered_groups)
                continue;
            const uint32_t phase = row % per_group, group = row / per_group;
            const uint8_t *cells = base + ((size_t)phase * (r->groups * 4 / per_group) + group) * row_bytes;
            const double wy = vy ? vy[y] : 0;
            double sum = 0;
            for (uint32_t x = 0; x < r->columns; x++) {
                float e[4];
                if (t->shape.half)
                    half_to_float(e, (const uint16_t *)(const void *)(cells + 8 * x), 4);
                else
                    memcpy(e, cells + 16 * x, 16);
                for (unsigned i = 0; i < 4; i++) {
                    const double in = vx ? wy * vx[(r->column0 + x) * 4 + i] : 1;
                    sum += e[i] * (outside ? 1 - in : in);
                }
            }
            of_channel += sum;
        }
        total += weight[ch] * of_channel;
    }
    // A cell of a level stands for 4^level pixels.
    return ldexp(total, 2 * (int)r->level);
}

void ledger_sum(const struct ledger *l, const struct plan *p, const struct targets *t, double scale,
                struct ledger_sums *out)
{
    static const double all[3] = { 1, 1, 1 };
    const struct ledger_region *top = &l->region[l->total_region];
    *out = (struct ledger_sums){ .bright = region_sum(l, top, t, all, NULL, NULL, false) };
    for (unsigned i = 0; i < LEDGER_TOTALS; i++)
        out->total[i] = region_sum(l, &top[1 + i], t, all, NULL, NULL, false);
    for (unsigned g = 0; g < p->count; g++) {
        const struct plan_gaussian *k = &p->gaussian[g];
        out->spread += region_sum(l, top, t, k->weight, NULL, NULL, false);
        for (unsigned i = 0; i <= l->total_region; i++)
            if (l->region[i].level == k->level) {
                out->outside += region_sum(l, &l->region[i], t, k->weight, l->inside_x[g], l->inside_y[g], true);
                // A difference of sums over a canvas much larger than the window would keep few digits.
                if (l->whole)
                    out->inside += region_sum(l, &l->region[i], t, k->weight, l->inside_x[g], l->inside_y[g], false);
            }
    }
    if (!l->whole)
        out->inside = out->spread - out->outside;
    double *all_sums[] = { &out->bright, &out->spread, &out->inside, &out->outside };
    for (unsigned i = 0; i < sizeof(all_sums) / sizeof(all_sums[0]); i++)
        *all_sums[i] /= scale;
}
