// SPDX-License-Identifier: Apache-2.0
//
// fuzz_body.c - body.c, request.c and wall_message.c: any bytes as any message's body, and then as far as the daemon
// judges it before it needs a device.
//
// What is checked: what unpacks packs into bytes that unpack and pack the same; a request that is taken keeps to the
// limits; a refusal has a reason; descriptors are taken or closed. One wall without boards is open; the bus of this
// machine is no input, so there is none. Input: the message's number, one byte of ways, the body.
#include <fcntl.h>
#include <fcntl.h>
#include <stdbool.h>
#include <sys/mman.h>

#include "fuzz.h"
#include "request.h"
#include "wall_message.h"

int LLVMFuzzerInitialize(int *argc, char ***argv);
int __wrap_usb_create(struct usb **out, void (*log)(const char *line), struct fault *f);

enum { FILE_BYTES = 4096 };

static struct block_pool blocks;
static struct asset_cache assets;
static struct job_env env = {
    .limits = { .max_frame_bytes = 1 << 20, .exr = { 512, 512, 1 << 16, 1 << 20 } }, .blocks = &blocks, .assets = &assets
};
static int files[4]; /* sealed, unsealed, sealed and short, no memfd */

int __wrap_usb_create(struct usb **out, void (*log)(const char *line), struct fault *f)
{
    (void)out, (void)log;
    return fault_set(f, FAULT_INTERNAL, "usb", "no USB");
}

static int make_memfd(off_t bytes, bool seal)
{
    const int fd = memfd_create("fuzz", MFD_CLOEXEC | MFD_ALLOW_SEALING);
    must(fd >= 0 && !ftruncate(fd, bytes));
    must(!seal || !fcntl(fd, F_ADD_SEALS, F_SEAL_SHRINK));
    return fd;
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    static const char wall[] = "wall: w\nsize: [8, 4]\nrate: 1\npanels:\n- {name: p, size: [8, 4]}\n";
    struct fault f = { .code = FAULT_NONE };
    struct wall_ref *r;
    (void)argc, (void)argv;
    block_pool_init(&blocks, 0);
    asset_cache_init(&assets, 1 << 20);
    files[0] = make_memfd(FILE_BYTES, true);
    files[1] = make_memfd(FILE_BYTES, false);
    files[2] = make_memfd(1, true);
    files[3] = open("/dev/null", O_RDWR | O_CLOEXEC);
    must(files[3] >= 0);
    must(!walls_create(&env.walls, &assets, NULL, &f));
    if (walls_open(env.walls, wall, sizeof(wall) - 1, NULL, NULL, &r, &f) < 0)
        fprintf(stderr, "%s\n", f.text);
    must(f.code == FAULT_NONE);
    return 0;
}

// ---- any message ---------------------------------------------------------------------------------------

static size_t pack(const ProtobufCMessage *m, uint8_t **out)
{
    const size_t bytes = protobuf_c_message_get_packed_size(m);
    *out = malloc(bytes + !bytes);
    must(*out && protobuf_c_message_pack(m, *out) == bytes);
    return bytes;
}

/* The library keeps unknown fields, also of the number 0, which it then does not read. Nobody here sends them on. */
static void forget_unknown(ProtobufCMessage *m)
{
    m->n_unknown_fields = 0;
    for (unsigned i = 0; i < m->descriptor->n_fields; i++) {
        const ProtobufCFieldDescriptor *d = &m->descriptor->fields[i];
        const uint8_t *base = (const uint8_t *)m;
        void *at = (uint8_t *)m + d->offset;
        if (d->type != PROTOBUF_C_TYPE_MESSAGE)
            continue;
        if (d->label == PROTOBUF_C_LABEL_REPEATED) {
            ProtobufCMessage **list = *(ProtobufCMessage ***)at;
            for (size_t k = 0; k < *(const size_t *)(const void *)(base + d->quantifier_offset); k++)
                forget_unknown(list[k]);
            continue;
        }
        const bool other = d->flags & PROTOBUF_C_FIELD_FLAG_ONEOF &&
                           *(const uint32_t *)(const void *)(base + d->quantifier_offset) != d->id;
        if (!other && *(ProtobufCMessage **)at)
            forget_unknown(*(ProtobufCMessage **)at);
    }
}

static void check_packed(const ProtobufCMessageDescriptor *d, ProtobufCMessage *m)
{
    static struct body_arena other;
    struct fault f = { .code = FAULT_NONE };
    uint8_t *once, *twice;
    forget_unknown(m);
    const size_t bytes = pack(m, &once);
    const ProtobufCMessage *again = body_unpack(d, once, bytes, &other, &f);
    must(again);
    must(pack(again, &twice) == bytes && !memcmp(once, twice, bytes));
    free(once);
    free(twice);
    body_arena_finish(&other);
}

// ---- requests ------------------------------------------------------------------------------------------

static unsigned bring_fds(int fds[2], uint8_t way)
{
    const unsigned n = (way & 3) % 3;
    for (unsigned i = 0; i < n; i++) {
        fds[i] = fcntl(files[way >> (2 + 2 * i) & 3], F_DUPFD_CLOEXEC, 0);
        must(fds[i] >= 0);
    }
    return n;
}

static void check_job(const struct job *j)
{
    must(j->input.kind != PAYLOAD_NONE && j->input.size <= env.limits.max_frame_bytes);
    must((j->input.kind == PAYLOAD_INLINE) == (j->input.fd < 0));
    must(!j->params.dirt[0] || j->dirt);
    if (!j->raw)
        return;
    must(j->layout.width <= env.limits.exr.max_width && j->layout.height <= env.limits.exr.max_height);
    must((uint64_t)j->layout.width * j->layout.height <= env.limits.exr.max_pixels && j->layout.count <= RAW_CHANNELS_MAX);
    must(j->output_kind != JOB_OUTPUT_BUFFER || (j->output.fd >= 0 && j->output.size == j->input.size));
}

static void check_request(const void *m, bool asset, uint8_t way)
{
    struct fault f = { .code = FAULT_NONE };
    int fds[2];
    const unsigned n = bring_fds(fds, way);
    struct job *j = job_create(&env);
    must(j);
    const int r = asset ? request_read_asset(j, m, fds, n, &f) : request_read(j, m, fds, n, &f);
    if (r < 0)
        must(f.code != FAULT_NONE && *f.text);
    else
        check_job(j);
    job_destroy(j);
}

static void check_wall(const Airy__Wall *m, struct body_arena *arena)
{
    const struct wall_desk desk = { .walls = env.walls, .assets = &assets, .blocks = &blocks };
    struct fault f = { .code = FAULT_NONE };
    Airy__WallReply *reply;
    struct block *preview = NULL;
    uint64_t bytes = 0;
    uint8_t *packed;
    // Opening needs the scheduler, closing would end this target's wall.
    if (m->action == AIRY__WALL__ACTION__OPEN || m->action == AIRY__WALL__ACTION__CLOSE)
        return;
    if (wall_message(&desk, m, NULL, arena, &reply, &preview, &bytes, &f) < 0) {
        must(f.code != FAULT_NONE && *f.text && !preview);
        return;
    }
    must(pack(&reply->base, &packed) <= WIRE_CONTROL_BYTES_MAX && (!preview || preview->bytes >= bytes));
    free(packed);
    block_give(&blocks, preview);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const ProtobufCMessageDescriptor *const messages[] = {
        &airy__bloom__descriptor,  &airy__asset__descriptor,        &airy__wall__descriptor,     &airy__hello__descriptor,
        &airy__welcome__descriptor, &airy__result__descriptor,      &airy__error__descriptor,    &airy__asset_kept__descriptor,
        &airy__credit__descriptor, &airy__progress__descriptor,     &airy__status_reply__descriptor,
        &airy__wall_reply__descriptor,
    };
    struct fuzz_in in = { data, size };
    struct body_arena arena = { 0 };
    struct fault f = { .code = FAULT_NONE };
    const ProtobufCMessageDescriptor *d = messages[fuzz_u8(&in) % (sizeof(messages) / sizeof(*messages))];
    const uint8_t way = fuzz_u8(&in);
    const int next = fuzz_next_fd();
    if (in.left > WIRE_CONTROL_BYTES_MAX)
        return 0;
    void *m = body_unpack(d, in.at, in.left, &arena, &f);
    if (!m) {
        must(f.code == FAULT_BAD_BODY && *f.text);
    } else {
        check_packed(d, m);
        if (d == &airy__bloom__descriptor || d == &airy__asset__descriptor)
            check_request(m, d == &airy__asset__descriptor, way);
        if (d == &airy__wall__descriptor)
            check_wall(m, &arena);
    }
    body_arena_finish(&arena);
    must(fuzz_next_fd() == next);
    return 0;
}
