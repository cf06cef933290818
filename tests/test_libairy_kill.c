// SPDX-License-Identifier: Apache-2.0
// test_libairy_kill.c - libairy with real daemons that are killed (-9) at random moments and started again at the same path: every
// request ends exactly once, with the bytes that an undisturbed daemon gives. AIRY_SEED repeats a run, ROUNDS takes more.
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "daemon_fixture.h"

enum { FRAMES = 8, WAYS = 4 };

struct scene {
    struct picture picture;
    uint8_t *exr;
    size_t exr_bytes, raw_bytes;
    uint8_t *want[WAYS];
    size_t want_bytes[WAYS];
};

static unsigned own_fds(void)
{
    unsigned n = 0;
    for (int fd = 0; fd < 256; fd++)
        n += fcntl(fd, F_GETFD) >= 0;
    return n;
}

struct frame {
    uint64_t id;
    void *map; // of its own output
};

// Way 0: inline in and out; 1: a descriptor in, a memfd out; 2: raw pixels into an output of ours; 3: inline in, a memfd out.
static void frame_submit(struct airy *a, const struct scene *s, unsigned way, struct frame *f)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    struct airy_error e = { .text = "" };
    *f = (struct frame){ 0 };
    assert_int_equal(airy_request_param(&r, "psf", "gaussians:sigma=1.5/6,weight=.1/.1", &e), 0);
    if (way == 1) {
        r.input_fd = make_memfd(s->exr, s->exr_bytes, F_SEAL_SHRINK);
    } else if (way == 2) {
        r.input_fd = make_memfd(s->picture.pixels, s->raw_bytes, F_SEAL_SHRINK);
        picture_request(&s->picture, &r);
        r.output_fd = airy_memfd(s->raw_bytes, &f->map, &e);
        r.output_size = s->raw_bytes;
    } else {
        r.data = s->exr;
        r.size = s->exr_bytes;
        r.inline_output = way == 0;
    }
    if (airy_submit(a, &r, &f->id, &e) < 0)
        fail_msg("submit: %s", e.text);
    if (r.input_fd >= 0)
        close(r.input_fd);
    if (r.output_fd >= 0)
        close(r.output_fd);
}

static void frame_expect(struct airy *a, struct scene *s, unsigned way, struct frame *f)
{
    struct airy_result *res = NULL;
    struct airy_error e = { .text = "" };
    int n = airy_wait(a, f->id, 120000, &res, &e);
    if (n != 1)
        fail_msg("request %" PRIu64 ", way %u: %d %s %s", f->id, way, n, e.symbol, e.text);
    const void *data = way == 2 ? f->map : res->data;
    size_t bytes = way == 2 ? s->raw_bytes : res->size;
    if (!s->want[way]) {
        s->want[way] = malloc(bytes);
        s->want_bytes[way] = bytes;
        memcpy(s->want[way], data, bytes);
    }
    assert_int_equal(bytes, s->want_bytes[way]);
    if (memcmp(data, s->want[way], bytes) != 0)
        fail_msg("request %" PRIu64 ", way %u: not the bytes of an undisturbed daemon", f->id, way);
    airy_result_free(res);
    if (f->map)
        munmap(f->map, s->raw_bytes);
    assert_int_equal(airy_wait(a, f->id, 0, NULL, &e), -1); // once
    assert_int_equal(e.code, -ENOENT);
}

static pid_t start_again(const struct daemon *d)
{
    pid_t pid = fork();
    assert_true(pid >= 0);
    if (pid == 0 && prctl(PR_SET_PDEATHSIG, SIGKILL) == 0)
        daemon_exec((const char *const[]){ "--socket", d->path, "--warm", "common", NULL }, NULL);
    if (pid == 0)
        _exit(127);
    return pid;
}

static uint64_t number_of(const char *name, uint64_t normal)
{
    const char *given = getenv(name);
    return given ? strtoull(given, NULL, 10) : normal;
}

static void every_request_survives_the_daemons(void **state)
{
    (void)state;
    const unsigned rounds = (unsigned)number_of("ROUNDS", daemon_sanitized() ? 4 : 20);
    uint64_t seed = number_of("AIRY_SEED", (uint64_t)time(NULL));
    struct scene s = { .picture = picture_make(160, 96, 500, 7) };
    s.exr = picture_exr(&s.picture, &s.exr_bytes);
    s.raw_bytes = picture_bytes(&s.picture);
    print_message("# AIRY_SEED=%" PRIu64 "\n", seed);
    unsigned before = own_fds();
    struct daemon d;
    daemon_start(&d, (const char *const[]){ "--warm", "common", NULL });
    struct airy *a = NULL;
    struct airy_error e = { .text = "" };
    if (airy_connect(&a, d.path, &e) < 0)
        fail_msg("connect: %s", e.text);
    airy_set_reconnect(a, 120000); // a loaded machine may start one slowly
    struct frame f[FRAMES];
    for (unsigned way = 0; way < WAYS; way++) {
        frame_submit(a, &s, way, &f[0]);
        frame_expect(a, &s, way, &f[0]);
    }
    const unsigned quiet = own_fds();
    unsigned renewed = 0;
    for (unsigned round = 0; round < rounds; round++) {
        const uint64_t serial = airy_serial(a);
        for (unsigned i = 0; i < FRAMES; i++)
            frame_submit(a, &s, i % WAYS, &f[i]);
        seed = seed * 6364136223846793005u + 1442695040888963407u;
        for (unsigned us = (unsigned)(seed >> 33) % 20000; us > 1000; us -= 1000) { // its client works meanwhile
            assert_int_equal(airy_pump(a, &e), 0);
            usleep(1000);
        }
        kill(d.pid, SIGKILL);
        int status;
        assert_int_equal(waitpid(d.pid, &status, 0), d.pid);
        d.pid = start_again(&d);
        for (unsigned i = 0; i < FRAMES; i++)
            frame_expect(a, &s, i % WAYS, &f[i]);
        renewed += airy_serial(a) > serial;
        assert_int_equal(airy_wait_any(a, 0, NULL, NULL, &e), -1);
        assert_true(own_fds() <= quiet); // one less when the daemon's end has been noticed already
    }
    print_message("# %u daemons killed, %u of them with frames in flight\n", rounds, renewed);
    assert_true(renewed > 0);
    airy_close(a);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);
    assert_int_equal(own_fds(), before);
    for (unsigned way = 0; way < WAYS; way++)
        free(s.want[way]);
    free(s.exr);
    picture_free(&s.picture);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(every_request_survives_the_daemons) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
