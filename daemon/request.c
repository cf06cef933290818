// SPDX-License-Identifier: Apache-2.0
// request.c - see request.h.
#include "request.h"

#include <fcntl.h>
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

// ---- params ----------------------------------------------------------------------------------------

static int read_param(struct params *p, const Airy__Param *a, struct fault *f)
{
    switch (a->value_case) {
    case AIRY__PARAM__VALUE_NUMBER: return params_set_number(p, a->name, a->number, f);
    case AIRY__PARAM__VALUE_TEXT: return params_set_text(p, a->name, a->text, f);
    default: break;
    }
    char field[64];
    snprintf(field, sizeof field, "params.%.50s", a->name);
    return fault_set(f, FAULT_PARAM_SYNTAX, field, "no value is given; expected a number or a text");
}

// At the door, so that an image that is kept now stays for as long as the request lives.
static int find_asset(struct job *j, const char *digest, const char *field, struct asset **out, struct fault *f)
{
    *out = asset_find(j->env->assets, digest);
    return *out ? 0
                : fault_set(f, FAULT_NO_ASSET, field, "no image with digest %.60s is kept: send it first", digest);
}

static int find_assets(struct job *j, struct fault *f)
{
    const struct params *p = &j->params;
    if (*p->dirt && find_asset(j, p->dirt, "params.dirt", &j->dirt, f) < 0)
        return -1;
    if (p->psf_spec.kind == PSF_IMAGE && find_asset(j, p->psf_spec.digest, "params.psf", &j->kernel, f) < 0)
        return -1;
    return 0;
}

static int read_params(struct job *j, const Airy__Bloom *b, struct fault *f)
{
    if (b->n_params > REQUEST_PARAMS_MAX)
        return fault_set(f, FAULT_LIMIT, "params", "%zu parameters; at most %d are taken", b->n_params,
                         REQUEST_PARAMS_MAX);
    for (size_t i = 0; i < b->n_params; i++) // of two the last holds
        if (read_param(&j->params, b->params[i], f) < 0)
            return -1;
    params_look_defaults(&j->params);
    return params_check(&j->params, f) < 0 ? -1 : find_assets(j, f);
}

// ---- format ----------------------------------------------------------------------------------------

static int copy_text(char *out, size_t size, const char *in, const char *field, struct fault *f)
{
    size_t n = strlen(in);
    if (n >= size)
        return fault_set(f, FAULT_LIMIT, field, "%zu bytes; at most %zu are taken", n, size - 1);
    memcpy(out, in, n + 1);
    return 0;
}

static int read_pixels(struct job *j, const char *word, struct fault *f)
{
    static const char *const words[] = { "keep", "half", "float" }; // enum exr_pixels
    if (!*word)
        return 0;
    for (int i = 0; i < 3; i++)
        if (!strcmp(word, words[i])) {
            j->exr_options.pixels = (enum exr_pixels)i;
            return 0;
        }
    return fault_set(f, FAULT_PARAM_SYNTAX, "exr.pixels", "\"%.60s\"; expected keep, half or float", word);
}

static int read_compression(struct job *j, const char *word, struct fault *f)
{
    j->exr_options.compression = *word ? exr_compression_parse(word) : EXR_KEEP;
    if (j->exr_options.compression != INT_MIN)
        return 0;
    return fault_set(f, FAULT_PARAM_SYNTAX, "exr.compression",
                     "\"%.60s\"; expected keep, none, rle, zips, zip, piz, pxr24, b44, b44a, dwaa or dwab", word);
}

static int read_exr(struct job *j, const Airy__ExrOptions *e, struct fault *f)
{
    if (copy_text(j->part, sizeof j->part, e->part, "exr.part", f) < 0 ||
        copy_text(j->layer, sizeof j->layer, e->layer, "exr.layer", f) < 0 ||
        copy_text(j->view, sizeof j->view, e->view, "exr.view", f) < 0)
        return -1;
    return read_pixels(j, e->pixels, f) < 0 ? -1 : read_compression(j, e->compression, f);
}

static int check_size(const struct exr_limits *limits, uint32_t width, uint32_t height, struct fault *f)
{
    if (width > limits->max_width)
        return fault_set(f, FAULT_LAYOUT, "raw.width", "%u pixels; at most %u are taken", width,
                         limits->max_width);
    if (height > limits->max_height)
        return fault_set(f, FAULT_LAYOUT, "raw.height", "%u pixels; at most %u are taken", height,
                         limits->max_height);
    if ((uint64_t)width * height > limits->max_pixels)
        return fault_set(f, FAULT_LAYOUT, "raw.width", "%u x %u pixels; at most %llu are taken", width, height,
                         (unsigned long long)limits->max_pixels);
    return 0;
}

static int read_raw(struct job *j, const Airy__RawLayout *r, struct fault *f)
{
    struct raw_layout *l = &j->layout;
    j->raw = true;
    l->width = r->width;
    l->height = r->height;
    l->type = (enum pixel_type)r->type;
    if (check_size(&j->env->limits.exr, r->width, r->height, f) < 0)
        return -1;
    if (r->n_channels > RAW_CHANNELS_MAX)
        return fault_set(f, FAULT_LIMIT, "raw.channels", "%zu channels; at most %d are taken", r->n_channels,
                         RAW_CHANNELS_MAX);
    l->count = (unsigned)r->n_channels;
    for (unsigned i = 0; i < l->count; i++) {
        struct raw_channel *c = &l->channel[i];
        const Airy__RawChannel *a = r->channels[i];
        if (copy_text(c->name, sizeof c->name, a->name, "raw.channels.name", f) < 0)
            return -1;
        c->offset = a->offset;
        c->row_stride = a->row_stride;
        c->pixel_stride = a->pixel_stride;
    }
    if (j->params.layer_count || j->params.grow_size.value > 0)
        return fault_set(f, FAULT_PARAM_CONFLICT, j->params.layer_count ? "params.layers" : "params.grow",
                         "a raw picture's result has the layout of the input: no layers, no other size");
    l->source = j->params.source;
    l->matte = j->params.matte;
    l->depth = j->params.sun_spec.given;
    // A descriptor's whole rest is measured when it is opened.
    return j->input.size ? raw_check(l, j->input.size, f) : 0;
}

static int read_format(struct job *j, const Airy__Bloom *b, struct fault *f)
{
    j->exr_options.compression = EXR_KEEP;
    if (b->format_case == AIRY__BLOOM__FORMAT_RAW)
        return read_raw(j, b->raw, f);
    // Neither given: a file with all defaults.
    return b->format_case == AIRY__BLOOM__FORMAT_EXR ? read_exr(j, b->exr, f) : 0;
}

// ---- payloads --------------------------------------------------------------------------------------

struct fd_list {
    const int *fds;
    unsigned n;
    bool used[8];
};

// A descriptor of our own for each use: input and output may be the same memfd.
static int fd_pick(struct fd_list *l, uint32_t index, const char *field, struct fault *f)
{
    if (index >= l->n)
        return fault_set(f, FAULT_PAYLOAD, field, "descriptor %u of the message; %u came with it", index, l->n);
    int fd = l->used[index] ? fcntl(l->fds[index], F_DUPFD_CLOEXEC, 0) : l->fds[index];
    if (fd < 0)
        return fault_set(f, FAULT_BUSY, field, "too many descriptors are open");
    l->used[index] = true;
    return fd;
}

static int read_input(struct job *j, const Airy__Payload *p, struct fd_list *fds, struct fault *f)
{
    static const char *const words = "expected 1 (INLINE), 2 (MEMFD) or 3 (FILE)";
    struct payload *in = &j->input;
    uint64_t max = j->env->limits.max_frame_bytes;
    if (!p || p->kind == AIRY__PAYLOAD__KIND__NONE)
        return fault_set(f, FAULT_PAYLOAD, "input.kind", "no input is given; %s", words);
    if (p->size > max)
        return fault_set(f, FAULT_LIMIT, "input.size", "%llu bytes; at most %llu are taken",
                         (unsigned long long)p->size, (unsigned long long)max);
    in->size = p->size;
    if (p->kind == AIRY__PAYLOAD__KIND__INLINE) {
        in->kind = PAYLOAD_INLINE;
        return p->size ? 0 : fault_set(f, FAULT_PAYLOAD, "input.size", "0 bytes; expected at least 1");
    }
    if (p->kind != AIRY__PAYLOAD__KIND__MEMFD && p->kind != AIRY__PAYLOAD__KIND__FILE)
        return fault_set(f, FAULT_PAYLOAD, "input.kind", "kind %d; %s", (int)p->kind, words);
    in->kind = p->kind == AIRY__PAYLOAD__KIND__MEMFD ? PAYLOAD_MEMFD : PAYLOAD_FILE;
    in->offset = p->offset;
    if ((in->fd = fd_pick(fds, p->fd, "input.fd", f)) < 0)
        return -1;
    if (in->kind == PAYLOAD_FILE) // looked at where it may block: in the pool
        return in->offset > INT64_MAX ? fault_set(f, FAULT_PAYLOAD, "input.offset", "%llu is no offset in a file",
                                                  (unsigned long long)in->offset)
                                      : 0;
    if (payload_check_memfd(in, false, "input", f) < 0)
        return -1;
    if (in->size > max)
        return fault_set(f, FAULT_LIMIT, "input.size", "%llu bytes; at most %llu are taken",
                         (unsigned long long)in->size, (unsigned long long)max);
    return 0;
}

static int read_buffer(struct job *j, const Airy__Output *o, struct fd_list *fds, struct fault *f)
{
    struct payload *out = &j->output;
    if (!j->raw)
        return fault_set(f, FAULT_PAYLOAD, "output.kind",
                         "BUFFER for an EXR file, whose size nobody knows; expected 0 (INLINE) or 1 (MEMFD)");
    j->output_kind = JOB_OUTPUT_BUFFER;
    out->kind = PAYLOAD_MEMFD;
    out->offset = o->offset;
    out->size = o->size;
    if ((out->fd = fd_pick(fds, o->fd, "output.fd", f)) < 0 || payload_check_memfd(out, true, "output", f) < 0)
        return -1;
    // The layout was checked against the input's size, so the room must be no less.
    if (!j->input.size || out->size < j->input.size)
        return fault_set(f, FAULT_PAYLOAD, "output.size", "room for %llu bytes; expected the input's %llu%s",
                         (unsigned long long)out->size, (unsigned long long)j->input.size,
                         j->input.size ? "" : " (which must be stated)");
    out->size = j->input.size;
    return 0;
}

static int read_output(struct job *j, const Airy__Output *o, struct fd_list *fds, struct fault *f)
{
    int kind = o ? (int)o->kind : AIRY__OUTPUT__KIND__INLINE;
    if (j->kind == JOB_PLANS) { // and a descriptor for it is one too many
        j->output_kind = JOB_OUTPUT_NONE;
        return 0;
    }
    switch (kind) {
    case AIRY__OUTPUT__KIND__INLINE: j->output_kind = JOB_OUTPUT_INLINE; return 0;
    case AIRY__OUTPUT__KIND__MEMFD: j->output_kind = JOB_OUTPUT_MEMFD; return 0;
    case AIRY__OUTPUT__KIND__BUFFER:
        if (j->wall)
            return fault_set(f, FAULT_PAYLOAD, "output.kind",
                             "BUFFER for a wall's picture; expected 0 (INLINE), 1 (MEMFD) or 3 (WALL)");
        return read_buffer(j, o, fds, f);
    case AIRY__OUTPUT__KIND__WALL:
        if (!j->wall)
            return fault_set(f, FAULT_PAYLOAD, "output.kind", "WALL, and no wall is named; expected wall.name");
        j->output_kind = JOB_OUTPUT_WALL;
        return 0;
    default:
        return fault_set(f, FAULT_PAYLOAD, "output.kind",
                         "kind %d; expected 0 (INLINE), 1 (MEMFD), 2 (BUFFER) or 3 (WALL)", kind);
    }
}

static int fds_used(const struct fd_list *l, struct fault *f)
{
    for (unsigned i = 0; i < l->n; i++)
        if (!l->used[i])
            return fault_set(f, FAULT_PAYLOAD, "input.fd", "descriptor %u of the message is used by nothing", i);
    return 0;
}

static void close_unused(const struct fd_list *l)
{
    for (unsigned i = 0; i < l->n; i++)
        if (!l->used[i])
            close(l->fds[i]);
}

// The wall's own exposure holds where the request says none.
static void take_exposure(struct params *p, const struct wall_def *d)
{
    if (params_has(p, "exposure"))
        return;
    p->exposure_auto = d->exposure_auto;
    if (d->exposure_auto)
        p->key *= exp2(d->exposure);
    else
        p->exposure = d->exposure;
}

static int read_wall(struct job *j, const Airy__WallTarget *w, struct fault *f)
{
    if (!w)
        return 0;
    j->wall = walls_find(j->env->walls, w->name, f);
    if (!j->wall)
        return -1;
    j->walled = true;
    j->of_wall.present_ns = w->present_ns;
    j->of_wall.frame_width = w->frame_width;
    j->of_wall.frame_height = w->frame_height;
    j->of_wall.x = w->x;
    j->of_wall.y = w->y;
    take_exposure(&j->params, j->wall->def);
    return job_wall_check(j, f);
}

enum { PRIORITY_MAX = 10 };

static int read_turn(struct job *j, const Airy__Bloom *b, struct fault *f)
{
    if (b->priority < -PRIORITY_MAX || b->priority > PRIORITY_MAX)
        return fault_set(f, FAULT_PARAM_RANGE, "priority", "%d; expected -%d to %d", (int)b->priority, PRIORITY_MAX, PRIORITY_MAX);
    j->priority = b->priority;
    j->deadline_ms = b->deadline_ms;
    return 0;
}

int request_read(struct job *j, const Airy__Bloom *b, const int *fds, unsigned n_fds, struct fault *f)
{
    struct fd_list list = { .fds = fds, .n = n_fds };
    int rc = -1;
    j->kind = b->plan_only ? JOB_PLANS : JOB_BLOOMS;
    if (read_turn(j, b, f) < 0 || read_params(j, b, f) < 0 || read_input(j, b->input, &list, f) < 0 || read_format(j, b, f) < 0 ||
        read_wall(j, b->wall, f) < 0 || read_output(j, b->output, &list, f) < 0 || fds_used(&list, f) < 0)
        goto done;
    j->wants_progress = b->progress;
    rc = 0;
done:
    close_unused(&list);
    return rc;
}

int request_read_asset(struct job *j, const Airy__Asset *a, const int *fds, unsigned n_fds, struct fault *f)
{
    struct fd_list list = { .fds = fds, .n = n_fds };
    j->kind = JOB_KEEPS;
    j->output_kind = JOB_OUTPUT_NONE;
    int rc = read_input(j, a->input, &list, f) < 0 ? -1 : fds_used(&list, f);
    close_unused(&list);
    return rc;
}
