// SPDX-License-Identifier: Apache-2.0
//
// librequest.c - a struct airy_request as a BLOOM (or ASSET) message, and its sending under the credits.
#include "lib_internal.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

int airy_request_param(struct airy_request *r, const char *name, const char *value, struct airy_error *e)
{
    struct airy_param *p = &r->params[r->n_params];
    if (r->n_params >= AIRY_PARAMS_MAX)
        return lib_fail(e, ENOSPC, "params", "a request has at most %d parameters", AIRY_PARAMS_MAX);
    if (strlen(name) >= sizeof(p->name))
        return lib_fail(e, ENAMETOOLONG, "params",
                        "a parameter's name has %zu bytes, at most %zu are allowed", strlen(name),
                        sizeof(p->name) - 1);
    if (strlen(value) >= sizeof(p->value))
        return lib_fail(e, EMSGSIZE, name, "the value of %s has %zu bytes, at most %zu are allowed",
                        name, strlen(value), sizeof(p->value) - 1);
    strcpy(p->name, name);
    strcpy(p->value, value);
    r->n_params++;
    return 0;
}

int airy_memfd(uint64_t size, void **map, struct airy_error *e)
{
    if (!size || size > INT64_MAX || size > SIZE_MAX)
        return lib_fail(e, EINVAL, "size", "a memfd of %" PRIu64 " bytes is not possible", size);
    void *p = MAP_FAILED;
    int fd = memfd_create("airy", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    if (fd < 0 || ftruncate(fd, (off_t)size) < 0)
        goto fail;
    p = mmap(NULL, (size_t)size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (p == MAP_FAILED || fcntl(fd, F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) < 0)
        goto fail;
    *map = p;
    return fd;
fail:
    lib_fail(e, errno, "size", "a memfd of %" PRIu64 " bytes: %s", size, strerror(errno));
    if (p != MAP_FAILED)
        munmap(p, (size_t)size);
    if (fd >= 0)
        close(fd);
    return -1;
}

// What a submit puts together before it is queued.
struct draft {
    Airy__Bloom bloom;
    Airy__Payload input;
    Airy__Output output;
    Airy__ExrOptions exr;
    Airy__RawLayout raw;
    Airy__WallTarget wall;
    Airy__Param params[AIRY_PARAMS_MAX], *param_list[AIRY_PARAMS_MAX];
    Airy__RawChannel channels[AIRY_CHANNELS_MAX], *channel_list[AIRY_CHANNELS_MAX];
    int fds[WIRE_FDS_MAX]; // the caller's
    unsigned n_fds;
};

static char *text_or_empty(const char *s) { return (char *)(s ? s : ""); }

static int draft_input(struct draft *d, const struct airy_request *r, struct airy_error *e)
{
    Airy__Payload *p = &d->input;
    airy__payload__init(p);
    p->offset = r->offset;
    p->size = r->size;
    if (!r->data == (r->input_fd < 0))
        return lib_fail(e, EINVAL, "input",
                        "a request has exactly one of data and input_fd (start from AIRY_REQUEST_INIT)");
    if (r->data) {
        p->kind = AIRY__PAYLOAD__KIND__INLINE;
        p->offset = 0;
        return 0;
    }
    struct stat st;
    if (fstat(r->input_fd, &st) < 0)
        return lib_fail(e, errno, "input_fd", "descriptor %d: %s", r->input_fd, strerror(errno));
    if (!S_ISREG(st.st_mode))
        return lib_fail(e, EINVAL, "input_fd", "descriptor %d is neither a memfd nor a regular file",
                        r->input_fd);
    // What can be sealed is a memfd; the daemon judges its seals. Files of a tmpfs have F_SEAL_SEAL
    // alone.
    int seals = fcntl(r->input_fd, F_GET_SEALS);
    bool memfd = seals >= 0 && seals != F_SEAL_SEAL;
    p->kind = memfd ? AIRY__PAYLOAD__KIND__MEMFD : AIRY__PAYLOAD__KIND__FILE;
    p->fd = d->n_fds;
    d->fds[d->n_fds++] = r->input_fd;
    if (p->size)
        return 0;
    if (r->offset >= (uint64_t)st.st_size)
        return lib_fail(e, EINVAL, "offset",
                        "offset %" PRIu64 " leaves nothing of the %" PRIu64 " bytes of descriptor %d",
                        r->offset, (uint64_t)st.st_size, r->input_fd);
    p->size = (uint64_t)st.st_size - r->offset;
    return 0;
}

static int draft_raw(struct draft *d, const struct airy_request *r, struct airy_error *e)
{
    if (r->n_channels > AIRY_CHANNELS_MAX)
        return lib_fail(e, EINVAL, "n_channels", "%u channels, at most %d are possible", r->n_channels,
                        AIRY_CHANNELS_MAX);
    airy__raw_layout__init(&d->raw);
    d->raw.width = r->width;
    d->raw.height = r->height;
    d->raw.type = (Airy__PixelType)r->type;
    d->raw.n_channels = r->n_channels;
    d->raw.channels = d->channel_list;
    for (unsigned i = 0; i < r->n_channels; i++) {
        Airy__RawChannel *c = d->channel_list[i] = &d->channels[i];
        airy__raw_channel__init(c);
        c->name = text_or_empty(r->channels[i].name);
        c->offset = r->channels[i].offset;
        c->row_stride = r->channels[i].row_stride;
        c->pixel_stride = r->channels[i].pixel_stride;
    }
    d->bloom.format_case = AIRY__BLOOM__FORMAT_RAW;
    d->bloom.raw = &d->raw;
    return 0;
}

static void draft_exr(struct draft *d, const struct airy_request *r)
{
    airy__exr_options__init(&d->exr);
    d->exr.part = text_or_empty(r->part);
    d->exr.layer = text_or_empty(r->layer);
    d->exr.view = text_or_empty(r->view);
    d->exr.pixels = text_or_empty(r->pixels);
    d->exr.compression = text_or_empty(r->compression);
    d->bloom.format_case = AIRY__BLOOM__FORMAT_EXR;
    d->bloom.exr = &d->exr;
}

static int draft_output(struct draft *d, const struct airy_request *r, struct airy_error *e)
{
    Airy__Output *o = &d->output;
    d->bloom.output = o;
    o->kind = r->show ? AIRY__OUTPUT__KIND__WALL : r->inline_output ? AIRY__OUTPUT__KIND__INLINE : AIRY__OUTPUT__KIND__MEMFD;
    if (r->show && (r->inline_output || r->output_fd >= 0))
        return lib_fail(e, EINVAL, "show", "a frame that is shown on a wall has no other output");
    if (r->output_fd < 0)
        return 0;
    if (r->inline_output)
        return lib_fail(e, EINVAL, "output_fd", "the output is either inline or in output_fd");
    o->kind = AIRY__OUTPUT__KIND__BUFFER;
    o->fd = d->n_fds;
    o->offset = r->output_offset;
    o->size = r->output_size;
    d->fds[d->n_fds++] = r->output_fd;
    return 0;
}

static int draft_wall(struct draft *d, const struct airy_request *r, struct airy_error *e)
{
    if (!r->wall)
        return r->show ? lib_fail(e, EINVAL, "wall", "a frame is to be shown, and no wall is named") : 0;
    Airy__WallTarget *w = d->bloom.wall = &d->wall;
    airy__wall_target__init(w);
    w->name = (char *)r->wall;
    w->present_ns = r->present_ns;
    w->frame_width = r->frame_width;
    w->frame_height = r->frame_height;
    w->x = r->frame_x;
    w->y = r->frame_y;
    return 0;
}

static int draft_make(struct draft *d, const struct airy_request *r, struct airy_error *e)
{
    airy__bloom__init(&d->bloom);
    airy__output__init(&d->output);
    d->n_fds = 0;
    if (r->n_params > AIRY_PARAMS_MAX)
        return lib_fail(e, EINVAL, "n_params", "%u parameters, at most %d are possible", r->n_params,
                        AIRY_PARAMS_MAX);
    for (unsigned i = 0; i < r->n_params; i++) {
        Airy__Param *p = d->param_list[i] = &d->params[i];
        airy__param__init(p);
        p->name = (char *)r->params[i].name;
        p->value_case = AIRY__PARAM__VALUE_TEXT;
        p->text = (char *)r->params[i].value;
    }
    d->bloom.params = d->param_list;
    d->bloom.n_params = r->n_params;
    d->bloom.progress = r->progress != NULL;
    d->bloom.plan_only = r->plan_only;
    d->bloom.priority = r->priority;
    d->bloom.deadline_ms = r->deadline_ms;
    d->bloom.input = &d->input;
    if (draft_input(d, r, e) < 0 || draft_wall(d, r, e) < 0 || (!r->plan_only && draft_output(d, r, e) < 0))
        return -1;
    if (r->width)
        return draft_raw(d, r, e);
    draft_exr(d, r);
    return 0;
}

// ---- sending ---------------------------------------------------------------------------------------

// In place: what was read is no more once a daemon has written a part of it.
static bool is_in_place(const struct airy_request *r, uint64_t size)
{
    struct stat in, out;
    if (r->data || r->output_fd < 0 || fstat(r->input_fd, &in) < 0 || fstat(r->output_fd, &out) < 0)
        return false;
    if (in.st_dev != out.st_dev || in.st_ino != out.st_ino)
        return false;
    return r->offset < r->output_offset ? r->output_offset - r->offset < size
                                        : r->offset - r->output_offset < r->output_size;
}

// What WELCOME allows; of the next daemon's, too.
static int check_limits(const struct airy *a, uint64_t bytes, bool wall, struct airy_error *e)
{
    if (wall && !a->has_walls)
        return lib_fail(e, ENOTSUP, "wall", "%s drives no walls", a->server);
    if (bytes > a->limits.credit_bytes)
        return lib_fail(e, EFBIG, "input.size",
                        "the payload is %" PRIu64 " bytes, a connection may have %" PRIu64 " in flight",
                        bytes, a->limits.credit_bytes);
    return 0;
}

// What the open requests say of the next one.
struct queue {
    struct request *next; // to be sent; NULL: none waits
    unsigned in_flight;
    bool suspects;
};

// A daemon died of one of those that were in flight, and nobody knows which: they go first, and one at a time, so that the next
// death has one cause. Those that have been there for fewer deaths go before.
static bool goes_before(const struct request *a, const struct request *b)
{
    if (!a->losses != !b->losses)
        return a->losses != 0;
    return a->losses != b->losses ? a->losses < b->losses : a->id < b->id;
}

static struct queue queue_look(const struct airy *a)
{
    struct queue q = { 0 };
    for (struct request *r = a->open; r; r = r->next) {
        q.in_flight += r->sent;
        q.suspects |= r->losses && !r->ended;
        if (!r->sent && !r->ended && (!q.next || goes_before(r, q.next)))
            q.next = r;
    }
    return q;
}

static bool has_room(const struct airy *a, uint64_t bytes)
{
    struct queue q = queue_look(a);
    unsigned most = a->limits.max_requests ? a->limits.max_requests : 1;
    if (a->open_count >= most)
        return false;
    return !lib_up(a) || a->again.draining || q.suspects || (!q.next && a->credit_bytes >= bytes);
}

// Blocks until a request of this size may be sent, or may wait for the next connection.
static int wait_for_room(struct airy *a, uint64_t bytes, bool wall, struct airy_error *e)
{
    if (!a->final && check_limits(a, bytes, wall, e) < 0)
        return -1;
    lib_step(a);
    while (!a->final && !has_room(a, bytes)) {
        lib_step_until(a, -1);
        if (lib_up(a) && check_limits(a, bytes, wall, e) < 0)
            return -1;
    }
    return a->final ? lib_copy_error(e, &a->lost) : 0;
}

static int pack(struct request *request, const ProtobufCMessage *body, struct airy_error *e)
{
    request->body_bytes = protobuf_c_message_get_packed_size(body);
    if (request->body_bytes > WIRE_CONTROL_BYTES_MAX)
        return lib_fail(e, EMSGSIZE, "", "the request's texts are longer than a message may be");
    request->body = malloc(request->body_bytes + 1);
    if (!request->body)
        return lib_fail(e, ENOMEM, "", "no memory for a request");
    protobuf_c_message_pack(body, request->body);
    return 0;
}

// A new request of this kind, on no list yet. NULL and *e.
static struct request *request_make(struct airy *a, enum request_kind kind, const struct airy_request *r,
                                    const struct draft *d, struct airy_error *e)
{
    Airy__Asset asset = AIRY__ASSET__INIT;
    asset.input = (Airy__Payload *)&d->input;
    struct request *request = calloc(1, sizeof(*request));
    if (!request) {
        lib_fail(e, ENOMEM, "", "no memory for a request");
        return NULL;
    }
    *request = (struct request){
        .airy = a,
        .kind = kind,
        .input_bytes = d->input.size,
        .output_kind = d->output.kind,
        .progress = r->progress,
        .progress_ctx = r->progress_ctx,
        .data = r->data ? (const uint8_t *)r->data + r->offset : NULL,
        .deadline_ms = r->deadline_ms,
        .wall = r->wall != NULL,
        .again = a->again.limit_ms && !r->show && !is_in_place(r, d->input.size),
    };
    if (pack(request, kind == REQUEST_ASSET ? &asset.base : &d->bloom.base, e) < 0)
        goto fail;
    for (; request->n_fds < d->n_fds; request->n_fds++)
        if ((request->fds[request->n_fds] = fcntl(d->fds[request->n_fds], F_DUPFD_CLOEXEC, 0)) < 0) {
            lib_fail(e, errno, "", "the request cannot be queued");
            goto fail;
        }
    return request;
fail:
    lib_request_free(request);
    return NULL;
}

static void request_queue(struct airy *a, struct request *request)
{
    request->id = a->next_id++;
    request->submitted_ms = lib_now_ms();
    request->next = a->open;
    a->open = request;
    a->open_count++;
}

// The deadline is counted from the submit on, wherever the time went.
static int queue_body(struct request *r, const int *fds)
{
    struct conn *conn = r->airy->conn;
    int64_t waited_ms = lib_now_ms() - r->submitted_ms;
    if (r->kind == REQUEST_ASSET || !r->deadline_ms || waited_ms <= 0)
        return conn_send(conn, r->kind == REQUEST_ASSET ? WIRE_ASSET : WIRE_BLOOM, r->id, r->body, r->body_bytes, fds, r->n_fds);
    Airy__Bloom *b = airy__bloom__unpack(NULL, r->body_bytes, r->body);
    if (!b)
        return -ENOMEM;
    b->deadline_ms = waited_ms < r->deadline_ms ? r->deadline_ms - (uint32_t)waited_ms : 1;
    int err = body_send(conn, WIRE_BLOOM, r->id, &b->base, fds, r->n_fds);
    airy__bloom__free_unpacked(b, NULL);
    return err;
}

// BLOOM or ASSET, with descriptors of the conn's own.
static int queue_first(struct request *r, struct airy_error *e)
{
    int fds[WIRE_FDS_MAX] = { -1, -1 };
    unsigned n = 0;
    int err = 0;
    for (; r->again && n < r->n_fds; n++)
        if ((fds[n] = fcntl(r->fds[n], F_DUPFD_CLOEXEC, 0)) < 0) {
            err = -errno;
            break;
        }
    if (!err)
        err = queue_body(r, r->again ? fds : r->fds);
    if (err) {
        while (n)
            close(fds[--n]);
        return lib_fail(e, -err, "", "the request cannot be queued");
    }
    if (!r->again)
        r->n_fds = 0; // the conn's
    return 0;
}

// Queues the data, if it is inline. When that fails the message is on its way without its bytes: nothing on this
// connection can be relied on.
static void queue_data(struct request *r)
{
    struct airy_error lost;
    if (!r->data)
        return;
    r->sending = true;
    if (conn_send_data(r->airy->conn, r->id, r->data, r->input_bytes, lib_request_sent, r) == 0)
        return;
    r->sending = false;
    lib_fail(&lost, ENOMEM, "", "no memory to send a payload");
    lib_lose(r->airy, &lost);
}

void lib_send_waiting(struct airy *a)
{
    while (lib_up(a) && !a->again.draining) {
        struct airy_error e;
        struct queue q = queue_look(a);
        struct request *r = q.next;
        if (!r || (q.suspects && q.in_flight))
            return;
        if (check_limits(a, r->input_bytes, r->wall, &e) < 0) {
            lib_request_end(r, &e);
            continue;
        }
        if (a->credit_bytes < r->input_bytes || (q.in_flight && q.in_flight >= a->limits.max_requests))
            return;
        if (queue_first(r, &e) < 0) {
            lib_request_end(r, &e);
            continue;
        }
        r->sent = true;
        a->credit_bytes -= r->input_bytes;
        queue_data(r);
    }
}

int airy_submit(struct airy *a, const struct airy_request *r, uint64_t *id, struct airy_error *e)
{
    struct draft d;
    if (lib_up(a) && check_limits(a, 0, r->wall != NULL, e) < 0)
        return -1;
    if (draft_make(&d, r, e) < 0 || wait_for_room(a, d.input.size, r->wall != NULL, e) < 0)
        return -1;
    struct request *request = request_make(a, r->plan_only ? REQUEST_PLAN : REQUEST_BLOOM, r, &d, e);
    if (!request)
        return -1;
    request_queue(a, request);
    *id = request->id;
    lib_send_waiting(a);
    lib_step(a);
    return 0;
}

int airy_asset(struct airy *a, int input_fd, const void *data, uint64_t size, struct airy_asset *out,
               struct airy_error *e)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    struct draft d;
    r.input_fd = input_fd;
    r.data = data;
    r.size = data ? size : 0;
    d.n_fds = 0;
    airy__output__init(&d.output);
    if (draft_input(&d, &r, e) < 0 || wait_for_room(a, d.input.size, false, e) < 0)
        return -1;
    struct airy_asset kept = { .digest = "" };
    struct request *request = request_make(a, REQUEST_ASSET, &r, &d, e);
    if (!request)
        return -1;
    request->kept = &kept;
    request_queue(a, request);
    uint64_t id = request->id;
    lib_send_waiting(a);
    // The only place where this id is known: whatever happens, it is waited for here.
    if (airy_wait(a, id, -1, NULL, e) < 0)
        return -1;
    *out = kept;
    return 0;
}

int airy_cancel(struct airy *a, uint64_t id, struct airy_error *e)
{
    if (a->final)
        return lib_copy_error(e, &a->lost);
    struct request *r = a->open;
    while (r && r->id != id)
        r = r->next;
    if (r)
        r->cancelled = true;
    if (r && !r->sent && !r->ended)
        lib_request_end(r, &lib_cancelled);
    else if (lib_up(a)) {
        int err = body_send(a->conn, WIRE_CANCEL, id, NULL, NULL, 0);
        if (err)
            return lib_fail(e, -err, "", "CANCEL: %s", strerror(-err));
    }
    return airy_pump(a, e);
}
