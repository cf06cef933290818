// SPDX-License-Identifier: Apache-2.0
//
// conn.c - one end of the stream.
//
// Descriptors and messages are matched by position in the stream. The kernel hands descriptors over with
// the first byte they were sent with, and ends that recvmsg at the end of the sendmsg's bytes or
// earlier (unix_stream_read_generic in net/unix/af_unix.c: never two sets of descriptors in one
// recvmsg). So a set that came with stream bytes [first, end) belongs to the header whose first byte
// lies there; a set that no header can claim any more breaks the stream. That holds however the
// bytes are cut into reads.
#include "conn.h"

#include <assert.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <unistd.h>

enum {
    IN_FIRST_BYTES = 32 * 1024,
    IN_AFTER_SINK_BYTES = 4096, // read past a sunk body: what follows is seldom more than a header
    FD_SETS_MAX = 16,           // sets received and not yet claimed
    OUT_IOV = 32,
    OUT_ONCE_BYTES = 1024 * 1024,
    OUT_SHARE_BYTES = 8 * 1024 * 1024, // one conn_flush writes no more, for the other connections' sake
    SPARE_SEGMENTS_MAX = 32,
    SPARE_BYTES_MAX = 4096,
    DATA_STRIDE = WIRE_HEADER_BYTES + WIRE_DATA_BYTES_MAX,
};

struct fd_set_in {
    uint64_t first, end; // stream positions of the bytes it came with
    unsigned n;          // as sent; above WIRE_FDS_MAX none were kept
    bool truncated;
    int fds[WIRE_FDS_MAX];
};

// A message of our own copy, or memory to send as a run of DATA messages.
struct segment {
    struct segment *next;
    uint8_t *bytes; // header and body
    size_t cap_bytes;
    uint64_t total_bytes, written_bytes; // as on the wire, headers included
    int fds[WIRE_FDS_MAX];
    unsigned n_fds;
    bool is_data;
    const uint8_t *data;
    uint64_t data_bytes, id;
    void (*done)(void *ctx);
    void *ctx;
};

struct conn {
    int fd;
    enum wire_end peer;

    uint8_t *in; // unread: in[in_start .. in_end)
    size_t in_cap, in_start, in_end;
    size_t delivered_bytes; // at in_start, the body handed out last: given up by the next call
    uint64_t received;      // stream position of in[in_end]
    struct fd_set_in sets[FD_SETS_MAX];
    unsigned set_first, set_count;

    bool have_header; // header, fds: of the message whose body is awaited
    struct wire_header header;
    uint64_t header_at;
    int fds[WIRE_FDS_MAX];
    void *(*place)(void *ctx, uint64_t id, uint32_t bytes);
    void *place_ctx;
    uint8_t *sink; // NULL: the body is delivered from in
    uint32_t sunk_bytes;

    bool broken;
    struct fault fault;

    struct segment *out, **out_tail, *spare;
    unsigned spare_count;
    uint64_t unsent_bytes;
};

// ---- making and unmaking ---------------------------------------------------------------------

static void close_all(const int *fds, unsigned n)
{
    for (unsigned i = 0; i < n; i++)
        close(fds[i]);
}

int conn_create(struct conn **out, int fd, enum wire_end self)
{
    int flags = fcntl(fd, F_GETFL);
    if (flags < 0 || fcntl(fd, F_SETFL, flags | O_NONBLOCK) < 0)
        return -errno;
    struct conn *c = calloc(1, sizeof(*c));
    uint8_t *in = malloc(IN_FIRST_BYTES);
    if (!c || !in)
        goto fail;
    c->fd = fd;
    c->peer = self == WIRE_CLIENT ? WIRE_DAEMON : WIRE_CLIENT;
    c->in = in;
    c->in_cap = IN_FIRST_BYTES;
    c->out_tail = &c->out;
    *out = c;
    return 0;
fail:
    free(c);
    free(in);
    return -ENOMEM;
}

static struct fd_set_in *first_set(struct conn *c)
{
    return c->set_count ? &c->sets[c->set_first] : NULL;
}

static void drop_set(struct conn *c)
{
    c->set_first = (c->set_first + 1) % FD_SETS_MAX;
    c->set_count--;
}

static unsigned kept_fds(const struct fd_set_in *s)
{
    return s->truncated || s->n > WIRE_FDS_MAX ? 0 : s->n;
}

static void close_received_fds(struct conn *c)
{
    for (; c->set_count; drop_set(c))
        close_all(first_set(c)->fds, kept_fds(first_set(c)));
    if (c->have_header)
        close_all(c->fds, c->header.n_fds);
    c->have_header = false;
}

static void segment_free(struct segment *s)
{
    free(s->bytes);
    free(s);
}

void conn_destroy(struct conn *c)
{
    if (!c)
        return;
    close_received_fds(c);
    while (c->out) {
        struct segment *s = c->out;
        c->out = s->next;
        close_all(s->fds, s->n_fds);
        if (s->done)
            s->done(s->ctx);
        segment_free(s);
    }
    while (c->spare) {
        struct segment *s = c->spare;
        c->spare = s->next;
        segment_free(s);
    }
    close(c->fd);
    free(c->in);
    free(c);
}

int conn_fd(const struct conn *c) { return c->fd; }

void conn_set_sink(struct conn *c, void *(*place)(void *ctx, uint64_t id, uint32_t bytes), void *ctx)
{
    c->place = place;
    c->place_ctx = ctx;
}

// ---- reading -----------------------------------------------------------------------------------

static void give_up_delivered(struct conn *c)
{
    c->in_start += c->delivered_bytes;
    c->delivered_bytes = 0;
    if (c->in_start == c->in_end)
        c->in_start = c->in_end = 0;
}

// Room for the rest of the message that is coming; its size was checked with its header.
static int make_room(struct conn *c)
{
    if (c->in_start) {
        memmove(c->in, c->in + c->in_start, c->in_end - c->in_start);
        c->in_end -= c->in_start;
        c->in_start = 0;
    }
    size_t need = c->have_header && !c->sink ? c->header.body_bytes : WIRE_HEADER_BYTES;
    if (need <= c->in_cap)
        return 0;
    uint8_t *bigger = realloc(c->in, need + IN_AFTER_SINK_BYTES);
    if (!bigger)
        return -ENOMEM;
    c->in = bigger;
    c->in_cap = need + IN_AFTER_SINK_BYTES;
    return 0;
}

// Queues the descriptors that came with stream bytes [first, end).
static bool take_fds(struct conn *c, struct msghdr *h, uint64_t first, uint64_t end)
{
    struct fd_set_in set = { .first = first, .end = end };
    set.truncated = h->msg_flags & MSG_CTRUNC;
    for (struct cmsghdr *m = CMSG_FIRSTHDR(h); m; m = CMSG_NXTHDR(h, m)) {
        if (m->cmsg_level != SOL_SOCKET || m->cmsg_type != SCM_RIGHTS)
            continue;
        unsigned n = (unsigned)((m->cmsg_len - CMSG_LEN(0)) / sizeof(int));
        for (unsigned i = 0; i < n; i++) {
            int fd;
            memcpy(&fd, CMSG_DATA(m) + i * sizeof(int), sizeof(fd));
            if (set.n < WIRE_FDS_MAX)
                set.fds[set.n] = fd;
            else
                close(fd);
            set.n++;
        }
    }
    if (!set.n && !set.truncated)
        return false;
    if (!kept_fds(&set))
        close_all(set.fds, set.n < WIRE_FDS_MAX ? set.n : WIRE_FDS_MAX);
    c->sets[(c->set_first + c->set_count++) % FD_SETS_MAX] = set;
    return true;
}

// One recvmsg. > 0: bytes, 0: nothing or the end, as *end says; *short_read: no more can be there.
static ssize_t read_some(struct conn *c, size_t budget, bool *end, bool *short_read)
{
    int err = make_room(c);
    if (err)
        return err;
    size_t sink = c->sink ? c->header.body_bytes - c->sunk_bytes : 0;
    size_t room = c->in_cap - c->in_end;
    if (sink && room > IN_AFTER_SINK_BYTES)
        room = IN_AFTER_SINK_BYTES;
    if (sink > budget)
        sink = budget;
    if (room > budget - sink)
        room = budget - sink;
    if (!sink && !room)
        return 0;
    struct iovec iov[2] = { { c->sink ? c->sink + c->sunk_bytes : NULL, sink },
                            { c->in + c->in_end, room } };
    // Room for more than may come: what is too much is then counted and closed here.
    union {
        struct cmsghdr align;
        uint8_t bytes[512];
    } control;
    struct msghdr h = { .msg_iov = sink ? iov : iov + 1,
                        .msg_iovlen = sink ? 2 : 1,
                        .msg_control = &control,
                        .msg_controllen = sizeof(control) };
    ssize_t n;
    do
        n = recvmsg(c->fd, &h, MSG_CMSG_CLOEXEC | MSG_DONTWAIT);
    while (n < 0 && errno == EINTR);
    if (n < 0)
        return errno == EAGAIN || errno == EWOULDBLOCK ? 0 : -errno;
    *end = n == 0;
    size_t came = (size_t)n, to_sink = came < sink ? came : sink;
    bool fds = take_fds(c, &h, c->received, c->received + came);
    *short_read = came < sink + room && !fds;
    c->sunk_bytes += (uint32_t)to_sink;
    c->in_end += came - to_sink;
    c->received += came;
    return n;
}

int conn_read(struct conn *c, size_t budget)
{
    if (c->broken)
        return -EPROTO;
    give_up_delivered(c);
    bool any = false, end = false, short_read = false;
    while (budget && !short_read && c->set_count < FD_SETS_MAX) {
        ssize_t n = read_some(c, budget, &end, &short_read);
        if (n < 0)
            return any ? 1 : (int)n;
        if (n == 0)
            break;
        any = true;
        budget -= (size_t)n;
    }
    if (any)
        return 1;
    return end ? -EPIPE : 0;
}

// Takes the first set for the header if it is the header's; *f when they do not agree.
static int match_fds(struct conn *c, const struct wire_header *h, uint64_t at, struct fault *f)
{
    struct fd_set_in *s = first_set(c);
    uint64_t end = at + WIRE_HEADER_BYTES + h->body_bytes;
    bool came_with_header = s && s->first <= at && at < s->end;
    if (h->n_fds) {
        if (!came_with_header)
            return fault_set(f, FAULT_BAD_FDS, "header.n_fds",
                             "%s says that it brings %u descriptors, none came with its first byte",
                             wire_type_name(h->type), h->n_fds);
        // The control buffer has room for far more: what is missing found no place in this process's table.
        if (s->truncated && s->n < h->n_fds)
            return fault_set(f, FAULT_NO_MEMORY, "header.n_fds",
                             "%s brings %u descriptors, no more than %u are free here", wire_type_name(h->type),
                             h->n_fds, s->n);
        if (s->truncated || s->n != h->n_fds)
            return fault_set(f, FAULT_BAD_FDS, "header.n_fds",
                             "%s says that it brings %u descriptors, %u came%s", wire_type_name(h->type),
                             h->n_fds, s->n, s->truncated ? " and others could not be taken" : "");
        memcpy(c->fds, s->fds, sizeof(c->fds));
        drop_set(c);
        s = first_set(c);
    }
    // What ended before this message's end can belong to no later header.
    if (s && s->end <= end) {
        unsigned n = s->n;
        if (h->n_fds)
            close_all(c->fds, h->n_fds);
        return fault_set(f, FAULT_BAD_FDS, "header.n_fds",
                         "%u descriptors came with bytes of %s that its header does not state", n,
                         wire_type_name(h->type));
    }
    return 0;
}

static int take_header(struct conn *c, struct fault *f)
{
    struct wire_header h;
    uint64_t at = c->received - (c->in_end - c->in_start);
    if (wire_decode(&h, c->in + c->in_start, c->peer, f) < 0 || match_fds(c, &h, at, f) < 0)
        return -1;
    c->in_start += WIRE_HEADER_BYTES;
    c->header = h;
    c->header_at = at;
    c->have_header = true;
    c->sink = NULL;
    c->sunk_bytes = 0;
    if (h.type == WIRE_DATA && h.body_bytes && c->place)
        c->sink = c->place(c->place_ctx, h.id, h.body_bytes);
    if (c->sink) {
        size_t have = c->in_end - c->in_start;
        size_t n = have < h.body_bytes ? have : h.body_bytes;
        memcpy(c->sink, c->in + c->in_start, n);
        c->sunk_bytes = (uint32_t)n;
        c->in_start += n;
    }
    return 0;
}

static int break_stream(struct conn *c, const struct fault *why, struct fault *f)
{
    c->broken = true;
    c->fault = *why;
    close_received_fds(c);
    if (f)
        *f = c->fault;
    return -1;
}

// Descriptors that came within a header, after its first byte: nothing can claim them, and waiting for
// the rest of the header would wait for ever once FD_SETS_MAX are held.
static int check_partial_header(struct conn *c, struct fault *f)
{
    uint64_t at = c->received - (c->in_end - c->in_start);
    const struct fd_set_in *s = first_set(c);
    if (!s || (c->set_count == 1 && s->first <= at && at < s->end))
        return 0;
    return fault_set(f, FAULT_BAD_FDS, "header.n_fds",
                     "descriptors came after the first byte of a header, expected with it");
}

// 1: header and body are there, 0: not yet.
static int complete_message(struct conn *c, struct fault *f)
{
    if (!c->have_header) {
        if (c->in_end - c->in_start < WIRE_HEADER_BYTES)
            return check_partial_header(c, f);
        if (take_header(c, f) < 0)
            return -1;
    }
    // Sets that came since the header was taken.
    struct wire_header none = c->header;
    none.n_fds = 0;
    if (match_fds(c, &none, c->header_at, f) < 0)
        return -1;
    size_t have = c->sink ? c->sunk_bytes : c->in_end - c->in_start;
    return have >= c->header.body_bytes;
}

int conn_next(struct conn *c, struct conn_message *m, struct fault *f)
{
    struct fault why;
    if (c->broken)
        return break_stream(c, &c->fault, f);
    give_up_delivered(c);
    int complete = complete_message(c, &why);
    if (complete < 0)
        return break_stream(c, &why, f);
    if (!complete)
        return 0;
    m->header = c->header;
    m->body = c->sink ? NULL : c->in + c->in_start;
    memcpy(m->fds, c->fds, sizeof(m->fds));
    c->delivered_bytes = c->sink ? 0 : c->header.body_bytes;
    c->have_header = false;
    c->sink = NULL;
    return 1;
}

// ---- writing -----------------------------------------------------------------------------------

static struct segment *segment_new(struct conn *c, size_t bytes)
{
    struct segment *s = c->spare;
    if (s) {
        c->spare = s->next;
        c->spare_count--;
    } else if (!(s = calloc(1, sizeof(*s)))) {
        return NULL;
    }
    if (s->cap_bytes < bytes) {
        free(s->bytes);
        s->cap_bytes = 0;
        if (!(s->bytes = malloc(bytes))) {
            free(s);
            return NULL;
        }
        s->cap_bytes = bytes;
    }
    return s;
}

static void segment_retire(struct conn *c, struct segment *s)
{
    if (c->spare_count == SPARE_SEGMENTS_MAX || s->cap_bytes > SPARE_BYTES_MAX) {
        segment_free(s);
        return;
    }
    *s = (struct segment){ .next = c->spare, .bytes = s->bytes, .cap_bytes = s->cap_bytes };
    c->spare = s;
    c->spare_count++;
}

static void enqueue(struct conn *c, struct segment *s)
{
    s->next = NULL;
    *c->out_tail = s;
    c->out_tail = &s->next;
    c->unsent_bytes += s->total_bytes;
}

int conn_send(struct conn *c, enum wire_type type, uint64_t id, const void *body, size_t bytes,
              const int *fds, unsigned n_fds)
{
    assert(bytes <= (type == WIRE_DATA ? WIRE_DATA_BYTES_MAX : WIRE_CONTROL_BYTES_MAX));
    assert(n_fds <= WIRE_FDS_MAX);
    struct segment *s = segment_new(c, WIRE_HEADER_BYTES + bytes);
    if (!s)
        return -ENOMEM;
    struct wire_header h = {
        .type = type, .n_fds = (uint8_t)n_fds, .body_bytes = (uint32_t)bytes, .id = id
    };
    wire_encode(s->bytes, &h);
    if (bytes)
        memcpy(s->bytes + WIRE_HEADER_BYTES, body, bytes);
    s->total_bytes = WIRE_HEADER_BYTES + bytes;
    if (n_fds)
        memcpy(s->fds, fds, n_fds * sizeof(int));
    s->n_fds = n_fds;
    enqueue(c, s);
    return 0;
}

int conn_send_data(struct conn *c, uint64_t id, const void *data, uint64_t bytes,
                   void (*done)(void *ctx), void *ctx)
{
    struct segment *s = segment_new(c, 0);
    if (!s)
        return -ENOMEM;
    uint64_t messages = bytes / WIRE_DATA_BYTES_MAX + (bytes % WIRE_DATA_BYTES_MAX != 0);
    s->is_data = true;
    s->data = data;
    s->data_bytes = bytes;
    s->id = id;
    s->done = done;
    s->ctx = ctx;
    s->total_bytes = bytes + messages * WIRE_HEADER_BYTES;
    enqueue(c, s);
    return 0;
}

struct gather {
    struct iovec iov[OUT_IOV];
    uint8_t headers[OUT_IOV][WIRE_HEADER_BYTES];
    unsigned n;
    size_t bytes;
};

static bool gather_full(const struct gather *g)
{
    return g->n + 2 > OUT_IOV || g->bytes >= OUT_ONCE_BYTES;
}

static void gather_add(struct gather *g, const uint8_t *p, size_t bytes)
{
    g->iov[g->n++] = (struct iovec){ (void *)p, bytes };
    g->bytes += bytes;
}

// The DATA messages of a segment from its written position on.
static void gather_data(struct gather *g, const struct segment *s)
{
    uint64_t at = s->written_bytes;
    while (at < s->total_bytes && !gather_full(g)) {
        uint64_t message = at / DATA_STRIDE, within = at % DATA_STRIDE;
        uint64_t offset = message * WIRE_DATA_BYTES_MAX, rest = s->data_bytes - offset;
        uint32_t body = rest < WIRE_DATA_BYTES_MAX ? (uint32_t)rest : WIRE_DATA_BYTES_MAX;
        if (within < WIRE_HEADER_BYTES) {
            uint8_t *header = g->headers[g->n];
            wire_encode(header,
                        &(struct wire_header){ .type = WIRE_DATA, .body_bytes = body, .id = s->id });
            gather_add(g, header + within, WIRE_HEADER_BYTES - within);
            within = WIRE_HEADER_BYTES;
        }
        within -= WIRE_HEADER_BYTES;
        gather_add(g, s->data + offset + within, body - within);
        at = message * DATA_STRIDE + WIRE_HEADER_BYTES + body;
    }
}

static void gather_segments(struct gather *g, const struct segment *s)
{
    g->n = 0;
    g->bytes = 0;
    bool fds = s->n_fds;
    for (const struct segment *first = s; s && !gather_full(g); s = s->next) {
        // Descriptors go with their message alone, so that the reader can tell whose they are.
        if (s != first && (fds || s->n_fds))
            return;
        if (s->is_data)
            gather_data(g, s);
        else
            gather_add(g, s->bytes + s->written_bytes, s->total_bytes - s->written_bytes);
    }
}

static ssize_t write_some(struct conn *c)
{
    struct gather g;
    struct segment *s = c->out;
    gather_segments(&g, s);
    union {
        struct cmsghdr align;
        uint8_t bytes[CMSG_SPACE(WIRE_FDS_MAX * sizeof(int))];
    } control = { .bytes = { 0 } };
    struct msghdr h = { .msg_iov = g.iov, .msg_iovlen = g.n };
    if (s->n_fds) {
        h.msg_control = &control;
        h.msg_controllen = CMSG_SPACE(s->n_fds * sizeof(int));
        struct cmsghdr *m = CMSG_FIRSTHDR(&h);
        m->cmsg_level = SOL_SOCKET;
        m->cmsg_type = SCM_RIGHTS;
        m->cmsg_len = CMSG_LEN(s->n_fds * sizeof(int));
        memcpy(CMSG_DATA(m), s->fds, s->n_fds * sizeof(int));
    }
    ssize_t n;
    do
        n = sendmsg(c->fd, &h, MSG_NOSIGNAL | MSG_DONTWAIT);
    while (n < 0 && errno == EINTR);
    return n < 0 ? -errno : n;
}

// Retires what is written up to `bytes` more, and everything that has nothing left.
static void advance(struct conn *c, uint64_t bytes)
{
    c->unsent_bytes -= bytes;
    while (c->out) {
        struct segment *s = c->out;
        uint64_t rest = s->total_bytes - s->written_bytes;
        uint64_t n = bytes < rest ? bytes : rest;
        if (n) {
            close_all(s->fds, s->n_fds);
            s->n_fds = 0;
        }
        s->written_bytes += n;
        bytes -= n;
        if (n < rest)
            return;
        if (!(c->out = s->next))
            c->out_tail = &c->out;
        void (*done)(void *) = s->done;
        void *ctx = s->ctx;
        segment_retire(c, s);
        if (done)
            done(ctx);
    }
}

int conn_flush(struct conn *c)
{
    advance(c, 0);
    for (uint64_t share = 0; c->out && share < OUT_SHARE_BYTES;) {
        ssize_t n = write_some(c);
        if (n == -EAGAIN || n == -EWOULDBLOCK)
            return 0;
        if (n < 0)
            return (int)n;
        share += (uint64_t)n;
        advance(c, (uint64_t)n);
    }
    return !c->out;
}

uint64_t conn_unsent_bytes(const struct conn *c) { return c->unsent_bytes; }

bool conn_wants_write(const struct conn *c) { return c->out; }
