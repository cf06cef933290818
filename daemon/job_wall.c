// SPDX-License-Identifier: Apache-2.0
// job_wall.c - what of a job's work is different when its frame is for a wall; see job.h.
#include <stdio.h>
#include <string.h>

#include "job.h"

int job_wall_check(const struct job *j, struct fault *f)
{
    if (bloom_wall_check_params(&j->params, f) < 0)
        return -1;
    const struct job_wall *w = &j->of_wall;
    if (!j->raw && (w->frame_width || w->frame_height || w->x || w->y))
        return fault_set(f, FAULT_PAYLOAD, "wall.frame_width", "a file's windows say where it lies: 0 expected");
    if (!w->frame_width && !w->frame_height && !w->x && !w->y)
        return 0;
    const struct exr_limits *l = &j->env->limits.exr;
    const int64_t right = (int64_t)w->x + j->layout.width, bottom = (int64_t)w->y + j->layout.height;
    if (w->frame_width > l->max_width || w->frame_height > l->max_height || w->x < 0 || w->y < 0 || right > w->frame_width ||
        bottom > w->frame_height)
        return fault_set(f, FAULT_LAYOUT, "wall.frame_width",
                         "%u x %u pixels at %d, %d of a frame of %u x %u: a part of a frame of at most %u x %u expected",
                         j->layout.width, j->layout.height, w->x, w->y, w->frame_width, w->frame_height, l->max_width,
                         l->max_height);
    return 0;
}

// ---- where it lies ---------------------------------------------------------------------------------

static void place_exr(struct job *j)
{
    struct job_wall *w = &j->of_wall;
    const struct exr_target *t = exr_target(j->exr, 0);
    // The data window is the frame: what lies beyond the display window shines into it.
    walls_geometry(j->wall, t->display_width, t->display_height, t->pixel_aspect, &w->geometry);
    w->corner[0] = (int32_t)((int64_t)t->min_x - t->display_x);
    w->corner[1] = (int32_t)((int64_t)t->min_y - t->display_y);
    w->geometry.x -= w->corner[0];
    w->geometry.y -= w->corner[1];
    w->frame_width = t->width;
    w->frame_height = t->height;
    w->x = w->y = 0;
}

static void place_raw(struct job *j)
{
    struct job_wall *w = &j->of_wall;
    if (!w->frame_width) {
        w->frame_width = j->layout.width;
        w->frame_height = j->layout.height;
    }
    walls_geometry(j->wall, w->frame_width, w->frame_height, 1, &w->geometry);
}

static void kind_of(const struct job *j, struct wall_need *n)
{
    const struct job_wall *w = &j->of_wall;
    const struct exr_target *t = j->raw ? NULL : exr_target(j->exr, 0);
    memset(n, 0, sizeof *n);
    n->width = w->frame_width;
    n->height = w->frame_height;
    n->channels = t ? t->channels : j->layout.target[0].planes;
    n->pixel_aspect = t ? t->pixel_aspect : 1;
    n->display_width = t ? t->display_width : w->frame_width;
    n->x = w->geometry.x;
    n->y = w->geometry.y;
    memcpy(&n->params, &j->params, sizeof n->params);
}

// ---- the part that is needed -----------------------------------------------------------------------

static uint32_t within(int64_t v, int64_t low, int64_t high) { return (uint32_t)(v < low ? low : v > high ? high : v); }

// Of the target, what lies in need; a pixel when there is nothing.
static void overlap(const struct job_wall *w, uint32_t width, uint32_t height, uint32_t out[4])
{
    out[0] = within((int64_t)w->need[0] - w->x, 0, width - 1);
    out[1] = within((int64_t)w->need[1] - w->y, 0, height - 1);
    out[2] = within((int64_t)w->need[2] - w->x, out[0] + 1, width);
    out[3] = within((int64_t)w->need[3] - w->y, out[1] + 1, height);
}

// Light that is left out would be a seam.
static int check_part(const struct job *j, struct fault *f)
{
    const struct job_wall *w = &j->of_wall;
    const struct raw_layout *l = &j->layout;
    if (w->need[0] >= w->x && w->need[1] >= w->y && w->need[2] <= (int64_t)w->x + l->width && w->need[3] <= (int64_t)w->y + l->height)
        return 0;
    return fault_set(f, FAULT_LAYOUT, "wall.x", "%u x %u pixels at %d, %d; the wall's light comes from %d x %d at %d, %d, all of which is expected",
                     l->width, l->height, w->x, w->y, w->need[2] - w->need[0], w->need[3] - w->need[1], w->need[0], w->need[1]);
}

static int cut_raw(struct job *j, struct fault *f)
{
    struct job_wall *w = &j->of_wall;
    struct raw_layout *l = &j->layout;
    uint32_t part[4];
    if (check_part(j, f) < 0)
        return -1;
    overlap(w, l->width, l->height, part);
    w->whole_width = l->width;
    w->whole_height = l->height;
    w->crop_x = part[0];
    w->crop_y = part[1];
    for (unsigned i = 0; i < l->count; i++)
        l->channel[i].offset += part[1] * l->channel[i].row_stride + part[0] * l->channel[i].pixel_stride;
    l->width = part[2] - part[0];
    l->height = part[3] - part[1];
    if (l->band > l->height)
        l->band = l->height;
    w->x += (int32_t)part[0];
    w->y += (int32_t)part[1];
    for (unsigned i = 0; i < l->targets; i++)
        if (l->target[i].role != RAW_DEPTH && frame_scan_init(&j->raw_scan[i], l->width, l->height)) {
            j->raw_scan[i].tile_luma = NULL;
            return fault_set(f, FAULT_NO_MEMORY, "raw", "no memory for the frame's tiles");
        }
    return 0;
}

static int cut_exr(struct job *j, struct fault *f)
{
    struct job_wall *w = &j->of_wall;
    uint32_t part[4];
    overlap(w, exr_target(j->exr, 0)->width, exr_target(j->exr, 0)->height, part);
    const int rc = exr_crop(j->exr, 0, part[0], part[1], part[2], part[3], f);
    if (rc > 0) {
        w->x = (int32_t)part[0];
        w->y = (int32_t)part[1];
    }
    return rc < 0 ? -1 : 0;
}

static int cut(struct job *j, struct fault *f)
{
    if ((j->raw ? cut_raw(j, f) : cut_exr(j, f)) < 0)
        return -1;
    j->of_wall.placed = true;
    return 0;
}

int job_wall_open(struct job *j, struct fault *f)
{
    struct wall_need like;
    if (j->raw)
        place_raw(j);
    else
        place_exr(j);
    if (j->kind == JOB_PLANS)
        return 0;
    kind_of(j, &like);
    if (!walls_need_known(j->wall, &like))
        return 0;
    memcpy(j->of_wall.need, like.part, sizeof like.part);
    j->of_wall.has_need = true;
    return cut(j, f);
}

bool job_wants_plan(const struct job *j) { return j->wall && !j->of_wall.placed; }

int job_wall_plan(struct job *j, struct bloom *b, struct fault *f)
{
    struct job_wall *w = &j->of_wall;
    struct wall_need kind;
    kind_of(j, &kind);
    if (bloom_wall_need(b, &j->params, kind.pixel_aspect, kind.channels, kind.display_width, &w->geometry, w->need, f) < 0)
        return -1;
    w->has_need = true;
    memcpy(kind.part, w->need, sizeof kind.part);
    walls_need_note(j->wall, &kind);
    return j->kind == JOB_PLANS ? 0 : cut(j, f);
}

// ---- the picture -----------------------------------------------------------------------------------

static size_t drive_bytes(const struct job *j) { return (size_t)j->wall->def->width * j->wall->def->height * 3 * sizeof(float); }

// The time between this frame and the one before, by when they are to be seen.
static double step_s(struct job *j)
{
    struct wall_ref *r = j->wall;
    const uint64_t now = j->of_wall.present_ns ? j->of_wall.present_ns : clock_ns();
    const double step = r->adapt_ns && now > r->adapt_ns ? (double)(now - r->adapt_ns) / 1e9 : 0;
    r->adapt_ns = now;
    return step;
}

int job_wall_begin(struct job *j, struct bloom_wall *b, struct bloom_adapt *adapt, struct fault *f)
{
    struct job_wall *w = &j->of_wall;
    if (!w->drive)
        w->drive = block_take(j->env->blocks, drive_bytes(j));
    if (!w->drive)
        return fault_set(f, FAULT_NO_MEMORY, "wall", "no memory for the wall's picture");
    // What no panel shows stays dark.
    memset(w->drive->data, 0, drive_bytes(j));
    *b = w->geometry;
    b->frame_width = w->frame_width;
    b->frame_height = w->frame_height;
    b->frame_x = w->x;
    b->frame_y = w->y;
    b->drive = (float *)(void *)w->drive->data;
    *adapt = j->wall->adapt;
    if (j->output_kind == JOB_OUTPUT_WALL)
        adapt->step_s = step_s(j);
    else
        adapt->started = false; // a frame that is not shown changes nothing, and depends on none before it
    b->adapt = adapt;
    return 0;
}

void job_wall_end(struct job *j, const struct bloom_adapt *adapt, const struct bloom_reply *reply)
{
    struct job_wall *w = &j->of_wall;
    if (j->output_kind != JOB_OUTPUT_WALL)
        return;
    j->wall->adapt = *adapt;
    wall_show(j->wall->wall, (const float *)(const void *)w->drive->data, w->present_ns, reply->exposure);
}

int job_wall_finish(struct job *j, struct fault *f)
{
    struct job_wall *w = &j->of_wall;
    struct payload *p = &j->output;
    if (j->output_kind == JOB_OUTPUT_MEMFD) {
        if (payload_new_memfd(p, f) < 0)
            return -1;
        const int rc = payload_write(p, w->drive->data, drive_bytes(j));
        return rc < 0 ? fault_set(f, FAULT_NO_MEMORY, "output", "the result cannot be written: %s", strerror(-rc)) : payload_seal(p, f);
    }
    if (j->output_kind != JOB_OUTPUT_INLINE)
        return 0;
    p->kind = PAYLOAD_INLINE;
    p->block = w->drive;
    p->data = w->drive->data;
    p->size = drive_bytes(j);
    w->drive = NULL;
    return 0;
}

void job_wall_release(struct job *j)
{
    block_give(j->env->blocks, j->of_wall.drive);
    j->of_wall.drive = NULL;
    walls_release(j->wall);
    j->wall = NULL;
}

void job_wall_rewind(struct job *j)
{
    struct job_wall *w = &j->of_wall;
    struct raw_layout *l = &j->layout;
    if (j->raw && w->placed) {
        for (unsigned i = 0; i < l->count; i++)
            l->channel[i].offset -= w->crop_y * l->channel[i].row_stride + w->crop_x * l->channel[i].pixel_stride;
        l->width = w->whole_width;
        l->height = w->whole_height;
        w->x -= (int32_t)w->crop_x;
        w->y -= (int32_t)w->crop_y;
        l->targets = 0; // looked at again
    }
    w->placed = false;
}
