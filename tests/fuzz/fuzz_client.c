// SPDX-License-Identifier: Apache-2.0
//
// fuzz_client.c - client.c, client_ask.c and what they lead to: a whole connection's bytes, with descriptors anywhere, to a daemon
// that is all there, device and threads too, but for its loop and its listening socket.
//
// What is checked: the daemon says only what its protocol lets it, in whole messages; every BLOOM, ASSET and WALL of a connection
// that goes on has exactly one end; the limits hold; after the connection nothing is left of it: no request, no byte held, no
// descriptor. Frames are small, the bus of this machine is no input. Input: one byte of ways, then steps of one byte, each with its
// bytes (those of fuzz_conn). Time is the machine's, but for STEP_READ's leap.
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <sys/epoll.h>
#include <sys/mman.h>

#include "client_private.h"
#include "fuzz.h"

int LLVMFuzzerInitialize(int *argc, char ***argv);
int __wrap_usb_create(struct usb **out, void (*log)(const char *line), struct fault *f);

enum {
    WAY_VERBOSE = 1, WAY_LAZY = 2, /* LAZY: replies are read only at READ */
    STEP_SEND = 0, STEP_LONG = 1, STEP_FDS = 2, /* as fuzz_conn's; FDS: step >> 4 says which */
    STEP_READ = 3,                              /* step >> 2 & 3: */
    READ_NOW = 0, READ_ENDS = 1, READ_LATER = 2, READ_DRAIN = 3,
    LEAP_MS = 61000, PATIENCE_MS = 15000, STEPS_MAX = 200,
};

static struct client_host host;

int __wrap_usb_create(struct usb **out, void (*log)(const char *line), struct fault *f)
{
    (void)out, (void)log;
    return fault_set(f, FAULT_INTERNAL, "usb", "no USB");
}

static void say(const char *line) { must(*line && strlen(line) < 512); }

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    const uint64_t mib = 1 << 20;
    const struct sched_config config = { .threads = 1, .slots = 1, .device = { .threads = 1 },
                                         .limits = { 64 * mib, 8 * mib, 64 * mib, 8 * mib, 16, 256, 64 } };
    struct fault f = { .code = FAULT_NONE };
    (void)argc, (void)argv;
    block_pool_init(&host.blocks, 0);
    asset_cache_init(&host.assets, mib);
    if (walls_create(&host.walls, &host.assets, NULL, &f) < 0 || sched_create(&host.sched, &config, &f) < 0)
        fprintf(stderr, "%s\n", f.text);
    must(f.code == FAULT_NONE);
    metrics_init(&host.metrics);
    host.timeout = (struct client_timeouts){ 60000, 60000, 60000, 1000 };
    host.held_bytes_max = 8 * mib;
    host.jobs_max = 16;
    host.user_connections_max = 4;
    host.job = (struct job_env){ .limits = { .max_frame_bytes = mib, .exr = { 96, 96, 4096, mib } }, .blocks = &host.blocks,
                                 .assets = &host.assets, .walls = host.walls };
    host.facts = (struct reply_facts){ .job = host.job.limits, .credit_bytes = 2 * mib, .max_requests = 8, .device = *sched_device(host.sched) };
    return 0;
}

struct rig {
    const uint8_t *data; /* the input: what descriptors lead to */
    size_t size;
    struct client *client;
    struct conn *peer;
    uint8_t header[WIRE_HEADER_BYTES]; /* of what was sent: the message that is on its way */
    size_t in_header;
    uint64_t body_left;
    unsigned asked, ended;
    bool said_end, walls;
};

// ---- what the daemon says ------------------------------------------------------------------------------

static void take_reply(struct rig *r, const struct conn_message *m)
{
    static const ProtobufCMessageDescriptor *const bodies[] = {
        [WIRE_WELCOME] = &airy__welcome__descriptor,           [WIRE_RESULT] = &airy__result__descriptor,
        [WIRE_ERROR] = &airy__error__descriptor,               [WIRE_ASSET_KEPT] = &airy__asset_kept__descriptor,
        [WIRE_CREDIT] = &airy__credit__descriptor,             [WIRE_PROGRESS] = &airy__progress__descriptor,
        [WIRE_STATUS_REPLY] = &airy__status_reply__descriptor, [WIRE_WALL_REPLY] = &airy__wall_reply__descriptor,
    };
    static struct body_arena arena;
    const struct wire_header *h = &m->header;
    struct fault f;
    client_close_fds(m);
    if (h->type < sizeof(bodies) / sizeof(*bodies) && bodies[h->type])
        must(body_unpack(bodies[h->type], m->body, h->body_bytes, &arena, &f));
    must(!r->said_end);
    if (h->type == WIRE_ERROR && !h->id)
        r->said_end = true;
    else
        r->ended += h->type == WIRE_RESULT || h->type == WIRE_ERROR || h->type == WIRE_ASSET_KEPT || h->type == WIRE_CANCELLED ||
                    h->type == WIRE_WALL_REPLY;
}

static void read_replies(struct rig *r)
{
    struct conn_message m;
    struct fault f;
    int n, came;
    do {
        came = conn_read(r->peer, 1 << 20);
        while ((n = conn_next(r->peer, &m, &f)) == 1)
            take_reply(r, &m);
        must(n == 0);
    } while (came > 0);
}

// ---- the daemon's loop ---------------------------------------------------------------------------------

static void check_limits(const struct rig *r)
{
    must(host.jobs <= host.jobs_max && host.held_bytes <= host.held_bytes_max);
    must(r->client->credit_left <= host.facts.credit_bytes && r->client->n_requests <= host.facts.max_requests);
}

static void turn(struct rig *r)
{
    struct job *j;
    sched_event_clear(host.sched);
    if (r->client)
        client_progress(r->client);
    while ((j = sched_done(host.sched)))
        client_job_done(&host, j);
    if (!r->client)
        return;
    client_event(r->client, client_events(r->client) & EPOLLIN);
    check_limits(r);
}

static unsigned uploads(const struct rig *r)
{
    const struct job *j;
    unsigned n = 0;
    TAILQ_FOREACH(j, &r->client->jobs, of_client) n += j->stage == JOB_UPLOAD;
    return n;
}

static bool working(const struct rig *r)
{
    const struct job *j;
    if (!r->client)
        return host.jobs;
    TAILQ_FOREACH(j, &r->client->jobs, of_client)
    if (j->stage != JOB_UPLOAD)
        return true;
    return conn_wants_write(r->client->conn) && !client_dead(r->client);
}

static void work_ends(struct rig *r)
{
    const uint64_t end_ns = clock_ns() + (uint64_t)PATIENCE_MS * 1000000;
    struct pollfd p = { .fd = sched_event_fd(host.sched), .events = POLLIN };
    turn(r);
    while (working(r)) {
        read_replies(r);
        poll(&p, 1, 10);
        turn(r);
        must(clock_ns() < end_ns);
    }
    read_replies(r);
}

// ---- what the client says ------------------------------------------------------------------------------

static void count(struct rig *r, const uint8_t *bytes, size_t n)
{
    while (n) {
        const uint64_t room = r->body_left ? r->body_left : WIRE_HEADER_BYTES - r->in_header, part = n < room ? n : room;
        if (r->body_left) {
            r->body_left -= part;
        } else {
            memcpy(r->header + r->in_header, bytes, part);
            r->in_header += part;
        }
        bytes += part;
        n -= part;
        if (r->in_header < WIRE_HEADER_BYTES)
            continue;
        struct wire_header h;
        struct fault f;
        if (!r->body_left && r->header[0] && wire_decode(&h, r->header, WIRE_CLIENT, &f) == 0) {
            r->body_left = h.body_bytes;
            r->header[0] = 0; // counted when its body is there
        }
        if (r->body_left)
            continue;
        r->asked += r->header[5] == WIRE_BLOOM || r->header[5] == WIRE_ASSET || r->header[5] == WIRE_WALL;
        r->walls |= r->header[5] == WIRE_WALL;
        r->in_header = 0;
    }
}

static int make_memfd(const struct rig *r, bool seal, bool empty)
{
    const int fd = memfd_create("fuzz", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    must(fd >= 0 && (empty ? ftruncate(fd, 65536) == 0 : write(fd, r->data, r->size) == (ssize_t)r->size));
    must(!seal || !fcntl(fd, F_ADD_SEALS, F_SEAL_SHRINK));
    return fd;
}

static int make_fd(const struct rig *r, unsigned which)
{
    const int fd = which < 3 ? make_memfd(r, which != 1, which == 2) : open("/dev/null", O_RDWR | O_CLOEXEC);
    must(fd >= 0);
    return fd;
}

static void give(struct rig *r, const uint8_t *bytes, size_t n, const int *fds, unsigned n_fds)
{
    for (unsigned tries = 0; n && tries < 100;) {
        const ssize_t sent = fuzz_send(conn_fd(r->peer), bytes, n, fds, n_fds);
        if (sent < 0) {
            must(errno == EAGAIN || errno == EPIPE || errno == ECONNRESET);
            if (errno != EAGAIN)
                return;
            tries++;
            turn(r);
            read_replies(r);
            continue;
        }
        count(r, bytes, (size_t)sent);
        bytes += sent;
        n -= (size_t)sent;
        n_fds = 0;
    }
    turn(r);
}

static void look(struct rig *r, unsigned how)
{
    turn(r);
    read_replies(r);
    if (how == READ_ENDS)
        work_ends(r);
    if (how == READ_LATER)
        client_tick(r->client, clock_ns() + (uint64_t)LEAP_MS * 1000000);
    if (how == READ_DRAIN) {
        host.draining = true;
        client_drain(r->client);
    }
}

static void run(struct rig *r, struct fuzz_in *in, uint8_t way)
{
    for (unsigned steps = 0; in->left && steps < STEPS_MAX && !client_dead(r->client); steps++) {
        const uint8_t step = fuzz_u8(in);
        const unsigned kind = step & 3, n_fds = kind == STEP_FDS ? 1 + (step >> 2 & 3) : 0;
        int fds[4];
        size_t n;
        if (kind == STEP_READ) {
            look(r, step >> 2 & 3);
            continue;
        }
        const uint8_t *bytes = fuzz_piece(in, kind == STEP_LONG ? fuzz_u16(in) : fuzz_u8(in), &n);
        for (unsigned i = 0; i < n_fds; i++)
            fds[i] = make_fd(r, ((step >> 4) + i) & 3);
        give(r, bytes, n, fds, n_fds);
        for (unsigned i = 0; i < n_fds; i++)
            close(fds[i]);
        if (!(way & WAY_LAZY))
            read_replies(r);
    }
}

static void close_walls(void)
{
    struct wall_ref *open[WALLS_MAX];
    struct fault f;
    for (unsigned n = walls_list(host.walls, open); n; n--)
        walls_close(host.walls, open[n - 1]->def->name, &f);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct fuzz_in in = { data, size };
    const uint8_t way = fuzz_u8(&in);
    struct rig r = { .data = data, .size = size };
    const int next = fuzz_next_fd();
    int fd[2];
    must(!socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, fd));
    host.log = way & WAY_VERBOSE ? say : NULL;
    host.draining = false;
    must((r.client = client_create(&host, fd[0])) && !conn_create(&r.peer, fd[1], WIRE_CLIENT));
    run(&r, &in, way);
    work_ends(&r);
    must(r.ended <= r.asked);
    if (r.client->state == CLIENT_READY)
        must(r.ended + uploads(&r) == r.asked);
    client_destroy(r.client);
    r.client = NULL;
    conn_destroy(r.peer);
    const uint64_t end_ns = clock_ns() + (uint64_t)PATIENCE_MS * 1000000;
    for (struct pollfd p = { .fd = sched_event_fd(host.sched), .events = POLLIN }; host.jobs; turn(&r)) {
        poll(&p, 1, 10);
        must(clock_ns() < end_ns);
    }
    const struct sched_counts left = sched_counts(host.sched);
    must(!host.clients && !host.refused && !host.held_bytes && !left.waiting && !left.running && !left.load_bytes);
    close_walls();
    if (!r.walls) // theirs are closed by a thread of their own
        must(fuzz_next_fd() == next);
    return 0;
}
