// SPDX-License-Identifier: Apache-2.0
//
// fuzz_libairy.c - client/lib*.c: a daemon that says anything at any time.
//
// What is checked: no call hangs, crashes or leaks; each request is reported once; what a result points to can be read; a
// failure has a reason. Input: one byte of ways, then steps: bytes that the daemon sends, and calls of the library.
#include <errno.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/socket.h>

#include "fuzz.h"
#include "lib_internal.h"

enum {
    WAY_WELCOME = 1, /* a proper one comes first; else the input's bytes are all that the daemon says */
    WAY_ASSET = 2,   /* ends with an upload */
    STEPS_MAX = 64,
    MEMFD_BYTES = 256,
};
enum step { STEP_SEND, STEP_LONG, STEP_FD, STEP_PUMP, STEP_SUBMIT, STEP_STATUS, STEP_WALL, STEP_CANCEL, STEP_WAIT, STEPS };

static volatile unsigned seen; /* a place for what is only read */

static void touch_text(const char *s) { seen += (unsigned)strlen(s); }
static void touch(const void *data, uint64_t bytes)
{
    for (uint64_t i = 0; i < bytes; i++)
        seen += ((const uint8_t *)data)[i];
}

static void progress(void *ctx, uint64_t id, const char *stage, double fraction)
{
    (void)ctx, (void)id, (void)fraction;
    touch_text(stage);
}

static void check_error(const struct airy_error *e)
{
    must(e->code != 0 && *e->text && memchr(e->text, '\0', sizeof(e->text)));
    must(memchr(e->symbol, '\0', sizeof(e->symbol)) && memchr(e->field, '\0', sizeof(e->field)));
}

// ---- the daemon ----------------------------------------------------------------------------------------

static int make_memfd(unsigned seals)
{
    const int fd = memfd_create("fuzz", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    must(fd >= 0 && !ftruncate(fd, MEMFD_BYTES));
    must(!seals || !fcntl(fd, F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | (seals > 1 ? F_SEAL_WRITE : 0)));
    return fd;
}

static void daemon_send(int peer, const uint8_t *bytes, size_t n, int fd)
{
    union {
        struct cmsghdr align;
        uint8_t bytes[CMSG_SPACE(sizeof(int))];
    } control = { .bytes = { 0 } };
    struct iovec iov = { (void *)(uintptr_t)bytes, n };
    struct msghdr h = { .msg_iov = &iov, .msg_iovlen = 1 };
    if (!n)
        return;
    if (fd >= 0) {
        h.msg_control = &control;
        h.msg_controllen = sizeof(control);
        struct cmsghdr *c = CMSG_FIRSTHDR(&h);
        *c = (struct cmsghdr){ .cmsg_len = CMSG_LEN(sizeof(int)), .cmsg_level = SOL_SOCKET, .cmsg_type = SCM_RIGHTS };
        memcpy(CMSG_DATA(c), &fd, sizeof(fd));
    }
    const ssize_t sent = sendmsg(peer, &h, MSG_DONTWAIT | MSG_NOSIGNAL);
    must(sent > 0 || errno == EAGAIN || errno == EPIPE || errno == ECONNRESET);
}

static void daemon_step(int peer, enum step step, uint8_t shape, struct fuzz_in *in)
{
    size_t n;
    const uint8_t *bytes = fuzz_piece(in, step == STEP_LONG ? fuzz_u16(in) : fuzz_u8(in), &n);
    const int fd = step == STEP_FD ? make_memfd(shape >> 4 & 3) : -1;
    daemon_send(peer, bytes, n, fd);
    if (fd >= 0)
        close(fd);
}

static void daemon_welcome(int peer)
{
    Airy__Welcome w = AIRY__WELCOME__INIT;
    Airy__Limits limits = AIRY__LIMITS__INIT;
    static char *features[] = { (char *)(uintptr_t)"wall" };
    limits.max_requests = 16;
    limits.max_width = limits.max_height = 4096;
    limits.max_pixels = 1 << 24;
    limits.max_frame_bytes = limits.credit_bytes = 1 << 20;
    w.version = WIRE_VERSION;
    w.server = (char *)(uintptr_t)"airyd/0";
    w.limits = &limits;
    w.features = features;
    w.n_features = 1;
    uint8_t message[WIRE_HEADER_BYTES + 256];
    const size_t n = airy__welcome__get_packed_size(&w);
    must(n <= 256);
    wire_encode(message, &(struct wire_header){ .type = WIRE_WELCOME, .body_bytes = (uint32_t)n });
    airy__welcome__pack(&w, message + WIRE_HEADER_BYTES);
    daemon_send(peer, message, WIRE_HEADER_BYTES + n, -1);
}

// ---- the caller ----------------------------------------------------------------------------------------

static void check_result(const struct airy_result *r)
{
    touch(r->data, r->data ? r->size : 0);
    for (unsigned i = 0; i < r->n_targets; i++) {
        const struct airy_target *t = &r->targets[i];
        touch_text(t->name), touch_text(t->plan), touch_text(t->rule), touch_text(t->skipped), touch_text(t->storage);
        touch_text(t->first_channel);
    }
    for (unsigned i = 0; i < r->n_notes; i++)
        touch_text(r->notes[i]);
    touch_text(r->device);
}

static void check_walls(const struct airy_wall_reply *r)
{
    for (unsigned i = 0; i < r->n_walls; i++) {
        const struct airy_wall_state *w = &r->walls[i];
        touch_text(w->name), touch_text(w->source);
        for (unsigned k = 0; k < w->n_boards; k++)
            touch_text(w->boards[k].name), touch_text(w->boards[k].state), touch_text(w->boards[k].problem);
        for (unsigned k = 0; k < w->n_supplies; k++)
            touch_text(w->supplies[k].name);
    }
    for (unsigned i = 0; i < r->n_controllers; i++)
        touch_text(r->controllers[i].serial), touch_text(r->controllers[i].wall);
    touch_text(r->usb);
    if (r->preview)
        touch(r->preview, (uint64_t)r->walls[0].width * r->walls[0].height * 3);
}

// Only where it cannot block: a connection without credit waits for some.
static void submit(struct airy *a, uint8_t shape)
{
    static const uint8_t inline_data[64];
    struct airy_error e = { 0 };
    struct airy_request r = AIRY_REQUEST_INIT;
    uint64_t id = 0;
    const int fd = shape & 64 ? make_memfd(1) : -1;
    if (fd >= 0)
        r.input_fd = fd;
    else
        r.data = inline_data;
    r.size = sizeof(inline_data);
    r.inline_output = shape & 16;
    r.plan_only = shape & 32;
    r.progress = progress;
    if (!a->conn || (a->credit_bytes >= sizeof(inline_data) && a->open_count < a->limits.max_requests)) {
        if (airy_submit(a, &r, &id, &e) < 0)
            check_error(&e);
        else
            must(id);
    }
    if (fd >= 0)
        close(fd);
}

static void ask_wall(struct airy *a, uint8_t shape)
{
    const struct airy_wall_request q = { .action = shape & 16 ? AIRY_WALL_PREVIEW : AIRY_WALL_LIST, .name = "w" };
    struct airy_wall_reply *reply = NULL;
    struct airy_error e = { 0 };
    if (airy_wall(a, &q, 0, &reply, &e) < 0) {
        check_error(&e);
        return;
    }
    check_walls(reply);
    airy_wall_reply_free(reply);
}

// 1: something ended.
static int wait_any(struct airy *a)
{
    struct airy_result *r = NULL;
    struct airy_error e = { 0 };
    uint64_t id = 0;
    const int n = airy_wait_any(a, 0, &id, &r, &e);
    if (n == 1) {
        must(r && id == r->id);
        check_result(r);
        airy_result_free(r);
    } else if (n < 0) {
        check_error(&e);
    }
    return n == 1 || (n < 0 && id);
}

static void caller_step(struct airy *a, enum step step, uint8_t shape)
{
    struct airy_error e = { 0 };
    struct airy_status s;
    switch (step) {
    case STEP_SUBMIT: submit(a, shape); break;
    case STEP_WALL: ask_wall(a, shape); break;
    case STEP_WAIT: wait_any(a); break;
    case STEP_STATUS:
        if (airy_status(a, &s, 0, &e) < 0)
            check_error(&e);
        break;
    case STEP_CANCEL:
        if (airy_cancel(a, shape >> 4, &e) < 0)
            check_error(&e);
        break;
    default:
        if (airy_pump(a, &e) < 0) {
            check_error(&e);
            must(airy_fd(a) == -1);
        }
        break;
    }
}

static void talk(struct airy *a, int peer, struct fuzz_in *in, uint8_t way)
{
    static const uint8_t data[64];
    struct airy_asset kept;
    struct airy_error e = { 0 };
    for (unsigned i = 0; in->left && i < STEPS_MAX; i++) {
        const uint8_t shape = fuzz_u8(in);
        const enum step step = (enum step)((shape & 15) % STEPS);
        if (step <= STEP_FD)
            daemon_step(peer, step, shape, in);
        else
            caller_step(a, step, shape);
    }
    must(!shutdown(peer, SHUT_WR));
    if (way & WAY_ASSET && airy_asset(a, -1, data, sizeof(data), &kept, &e) < 0)
        check_error(&e);
    for (unsigned ended = 0; wait_any(a); ended++)
        must(ended <= STEPS_MAX);
    must(!a->open && !a->done);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct fuzz_in in = { data, size };
    const uint8_t way = fuzz_u8(&in);
    const int next = fuzz_next_fd();
    struct airy_error e = { 0 };
    struct airy *a = NULL;
    int fd[2];
    must(!socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, fd));
    if (way & WAY_WELCOME) {
        daemon_welcome(fd[1]);
    } else {
        daemon_send(fd[1], in.at, in.left, -1);
        in.left = 0;
        must(!shutdown(fd[1], SHUT_WR));
    }
    if (airy_connect_fd(&a, fd[0], &e) < 0)
        check_error(&e);
    else
        talk(a, fd[1], &in, way);
    airy_close(a);
    close(fd[1]);
    must(fuzz_next_fd() == next);
    return 0;
}
