// SPDX-License-Identifier: Apache-2.0
//
// seeds_talk.c - real traffic as seeds: libairy and a daemon of this build, with a relay between them that writes down
// what each end says. The calls are few and small, one of each kind.
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <time.h>

#include "airy.h"
#include "body.h"
#include "fuzz.h"
#include "seeds.h"
#include "tools/exr_tool.h"

enum { START_MS = 60000, FDS_MAX = 4, FROM_CLIENT = 0, FROM_DAEMON = 1 };

static struct seed steps[2], stream[2]; /* by who speaks */
static int relay_ends[2];               /* towards the client, towards the daemon */

// ---- the relay -----------------------------------------------------------------------------------------

static void write_down(unsigned who, const uint8_t *bytes, size_t n, unsigned n_fds)
{
    seed_add(&stream[who], bytes, n);
    if (n_fds) {
        const size_t first = n < 255 ? n : 255;
        seed_number(&steps[who], 2 | (n_fds - 1) << 2, 1);
        seed_number(&steps[who], first, 1);
        seed_add(&steps[who], bytes, first);
        bytes += first;
        n -= first;
    }
    if (n) {
        seed_number(&steps[who], 1, 1);
        seed_number(&steps[who], n, 2);
        seed_add(&steps[who], bytes, n);
    }
}

// What came goes on, descriptors and all. False: the end.
static bool pass_on(unsigned who)
{
    uint8_t bytes[8192];
    union {
        struct cmsghdr align;
        uint8_t bytes[CMSG_SPACE(FDS_MAX * sizeof(int))];
    } control;
    struct iovec iov = { bytes, sizeof(bytes) };
    struct msghdr h = { .msg_iov = &iov, .msg_iovlen = 1, .msg_control = &control, .msg_controllen = sizeof(control) };
    const ssize_t n = recvmsg(relay_ends[who], &h, MSG_CMSG_CLOEXEC);
    if (n <= 0)
        return false;
    const struct cmsghdr *c = CMSG_FIRSTHDR(&h);
    const unsigned n_fds = c ? (unsigned)((c->cmsg_len - CMSG_LEN(0)) / sizeof(int)) : 0;
    write_down(who, bytes, (size_t)n, n_fds);
    iov.iov_len = (size_t)n;
    h.msg_control = n_fds ? &control : NULL;
    h.msg_controllen = n_fds ? CMSG_SPACE(n_fds * sizeof(int)) : 0;
    must(sendmsg(relay_ends[!who], &h, MSG_NOSIGNAL) == n);
    for (unsigned i = 0; i < n_fds; i++) {
        int fd;
        memcpy(&fd, CMSG_DATA(c) + i * sizeof(fd), sizeof(fd));
        close(fd);
    }
    return true;
}

static void *relay_main(void *arg)
{
    struct pollfd p[2] = { { relay_ends[0], POLLIN, 0 }, { relay_ends[1], POLLIN, 0 } };
    (void)arg;
    for (;;) {
        must(poll(p, 2, -1) > 0);
        for (unsigned who = 0; who < 2; who++)
            if (p[who].revents && !pass_on(who))
                return NULL;
    }
}

// ---- the daemon ----------------------------------------------------------------------------------------

static int connect_to(const char *path, pid_t pid)
{
    struct sockaddr_un a = { .sun_family = AF_UNIX };
    snprintf(a.sun_path, sizeof(a.sun_path), "%s", path);
    for (unsigned i = 0; i < START_MS / 20; i++) {
        const int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
        must(fd >= 0);
        if (!connect(fd, (struct sockaddr *)&a, sizeof(a)))
            return fd;
        close(fd);
        if (waitpid(pid, NULL, WNOHANG) == pid)
            return -1;
        nanosleep(&(struct timespec){ .tv_nsec = 20000000 }, NULL);
    }
    return -1;
}

// ---- the client ----------------------------------------------------------------------------------------

// Good or bad, the answer is what is wanted; that the daemon is there until the end is checked.
static void ask(struct airy *a, const struct airy_request *r)
{
    struct airy_error e = { 0 };
    struct airy_result *result = NULL;
    uint64_t id;
    must(airy_submit(a, r, &id, &e) == 0);
    if (airy_wait(a, id, -1, &result, &e) == 1)
        airy_result_free(result);
    must(airy_fd(a) >= 0);
}

static void ask_file(struct airy *a, const uint8_t *file, size_t size, const char *param, const char *value, bool plan, bool in_memory)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    void *map = NULL;
    r.size = size;
    r.plan_only = plan;
    if (in_memory) {
        r.input_fd = airy_memfd(size, &map, NULL);
        must(r.input_fd >= 0);
        memcpy(map, file, size);
    } else {
        r.data = file;
        r.inline_output = true;
    }
    must(!param || !airy_request_param(&r, param, value, NULL));
    ask(a, &r);
    if (r.input_fd >= 0)
        close(r.input_fd);
}

static struct airy_request raw_request(const float *pixels)
{
    static const char *const names[] = { "R", "G", "B" };
    struct airy_request r = AIRY_REQUEST_INIT;
    r.data = pixels;
    r.width = r.height = 8;
    r.size = 8 * 8 * 12;
    r.type = AIRY_FLOAT;
    for (unsigned i = 0; i < 3; i++)
        r.channels[i] = (struct airy_channel){ names[i], 4 * i, 8 * 12, 12 };
    r.n_channels = 3;
    return r;
}

static void ask_wall(struct airy *a, enum airy_wall_action action, const char *pattern)
{
    struct airy_wall_request q = { .action = action, .name = "w", .pattern = pattern };
    struct airy_wall_reply *reply = NULL;
    if (action == AIRY_WALL_OPEN) {
        q.name = NULL;
        q.definition = "wall: w\nsize: [8, 8]\npanels:\n- {name: p, size: [8, 8]}\n";
    }
    if (airy_wall(a, &q, -1, &reply, NULL) == 0)
        airy_wall_reply_free(reply);
    must(airy_fd(a) >= 0);
}

static void talk(struct airy *a)
{
    static float pixels[8 * 8 * 3];
    const struct exr_tool_spec spec = { .layout = EXR_TOOL_RGBA, .compression = 3, .type = 1, .width = 16, .height = 16, .parts = 1 };
    struct airy_asset kept = { .digest = "" };
    struct airy_status status;
    uint8_t *file;
    size_t size;
    must(!exr_tool_make(&spec, &file, &size));
    must(!airy_status(a, &status, -1, NULL));
    ask_file(a, file, size, "threshold", "0.5", false, false);
    ask_file(a, file, size, "look", "jimenez", false, true);
    ask_file(a, file, size, NULL, NULL, true, true);
    ask_file(a, file, size, "threshold", "lots", false, false);
    ask_file(a, file, size / 2, NULL, NULL, false, false);
    airy_asset(a, -1, file, size, &kept, NULL);
    ask_file(a, file, size, "dirt", kept.digest, false, true);
    struct airy_request raw = raw_request(pixels);
    pixels[100] = 50;
    ask(a, &raw);
    ask_wall(a, AIRY_WALL_OPEN, NULL);
    raw.wall = "w";
    raw.show = true;
    ask(a, &raw);
    ask_wall(a, AIRY_WALL_LIST, NULL);
    ask_wall(a, AIRY_WALL_PATTERN, "checker");
    ask_wall(a, AIRY_WALL_PREVIEW, NULL);
    ask_wall(a, AIRY_WALL_CLOSE, NULL);
    free(file);
}

// ---- what was said, as seeds ---------------------------------------------------------------------------

/* The next whole message of a stream, or NULL. */
static const uint8_t *next_message(const struct seed *s, size_t *at, size_t *n)
{
    const uint8_t *m = s->bytes + *at;
    if (s->size - *at < WIRE_HEADER_BYTES)
        return NULL;
    *n = WIRE_HEADER_BYTES + (m[8] | (size_t)m[9] << 8 | (size_t)m[10] << 16);
    must(*n <= s->size - *at);
    *at += *n;
    return m;
}

/* The call of fuzz_libairy that makes the client say this; 0: none does. */
static uint8_t call_of(const uint8_t *m, size_t n)
{
    uint8_t call = m[5] == WIRE_STATUS || m[5] == WIRE_ASSET ? 5 : 0; // an upload waits: a question takes its number
    struct body_arena arena = { 0 };
    struct fault f;
    if (m[5] != WIRE_BLOOM && m[5] != WIRE_WALL)
        return call;
    const void *body = body_unpack(m[5] == WIRE_BLOOM ? &airy__bloom__descriptor : &airy__wall__descriptor,
                                   m + WIRE_HEADER_BYTES, n - WIRE_HEADER_BYTES, &arena, &f);
    must(body);
    if (m[5] == WIRE_WALL) {
        call = ((const Airy__Wall *)body)->action == AIRY__WALL__ACTION__PREVIEW ? 0x16 : 6;
    } else {
        const Airy__Bloom *b = body;
        call = b->plan_only ? 0x24 : b->output && b->output->kind == AIRY__OUTPUT__KIND__MEMFD ? 4 : 0x14;
    }
    body_arena_finish(&arena);
    return call;
}

static void write_libairy(void)
{
    static struct seed s;
    const uint8_t *asked, *said;
    size_t at = 0, n, from, length;
    seed_number(&s, 1, 1);
    while ((asked = next_message(&stream[FROM_CLIENT], &at, &n))) {
        const uint8_t call = call_of(asked, n);
        if (!call)
            continue;
        if (asked[5] == WIRE_BLOOM)
            seed_number(&s, call, 1);
        for (from = 0; (said = next_message(&stream[FROM_DAEMON], &from, &length));)
            if (!memcmp(said + 16, asked + 16, 8) && asked[5] != WIRE_ASSET)
                seed_message(&s, said, length, true);
        if (asked[5] != WIRE_BLOOM) // these look once: the answer is to be there
            seed_number(&s, call, 1);
        seed_add(&s, "\3\10", 2);
    }
    seed_write("libairy", "talk", &s);
}

static void write_seeds(void)
{
    static const char *const names[] = { "talk_client", "talk_daemon" };
    static struct seed s;
    for (unsigned who = 0; who < 2; who++) {
        const uint8_t *m;
        size_t at = 0, n;
        char name[64];
        s.size = 0;
        seed_number(&s, who == FROM_CLIENT ? 1 : 2, 1);
        seed_add(&s, steps[who].bytes, steps[who].size);
        seed_write("conn", names[who], &s);
        if (who == FROM_CLIENT)
            seed_write("client", names[who], &s);
        for (unsigned i = 0; (m = next_message(&stream[who], &at, &n)); i++) {
            snprintf(name, sizeof(name), "%s%u", names[who], i);
            seed_body(name, m, n);
        }
    }
    write_libairy();
}

int seeds_talk(const char *airyd)
{
    char path[] = "/tmp/airy-seeds-XXXXXX", socket_path[64];
    struct airy *a = NULL;
    struct airy_error e = { 0 };
    pthread_t relay;
    int pair[2], result = -1;
    must(airyd && mkdtemp(path));
    snprintf(socket_path, sizeof(socket_path), "%s/s", path);
    const pid_t pid = fork();
    must(pid >= 0);
    if (pid == 0) {
        execl(airyd, airyd, "--socket", socket_path, (char *)NULL);
        perror(airyd);
        _exit(127);
    }
    if ((relay_ends[1] = connect_to(socket_path, pid)) < 0) {
        fprintf(stderr, "%s does not start\n", airyd);
        goto done;
    }
    must(!socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair));
    relay_ends[0] = pair[0];
    must(!pthread_create(&relay, NULL, relay_main, NULL));
    if (airy_connect_fd(&a, pair[1], &e) < 0) {
        fprintf(stderr, "%s\n", e.text);
        exit(1);
    }
    talk(a);
    airy_close(a);
    pthread_join(relay, NULL);
    close(relay_ends[0]);
    close(relay_ends[1]);
    write_seeds();
    result = 0;
done:
    kill(pid, SIGTERM);
    waitpid(pid, NULL, 0);
    unlink(socket_path);
    rmdir(path);
    return result;
}
