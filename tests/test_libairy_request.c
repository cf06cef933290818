// SPDX-License-Identifier: Apache-2.0
// test_libairy_request.c - what a struct airy_request becomes on the wire, and what is refused before
// it.
#include "airy_peer.h"

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

static void script_requests(struct peer *p)
{
    peer_welcome(p);
    struct conn_message m = peer_next(p, WIRE_BLOOM);
    must(m.header.n_fds == 1 && fcntl(m.fds[0], F_GETFD) & FD_CLOEXEC);
    close(m.fds[0]);
    uint64_t id = m.header.id;
    Airy__Bloom *b = peer_body(p, &m, &airy__bloom__descriptor);
    must(b->input->kind == AIRY__PAYLOAD__KIND__FILE && b->input->fd == 0);
    must(b->input->offset == 10 && b->input->size == 90);
    must(b->format_case == AIRY__BLOOM__FORMAT_EXR && !strcmp(b->exr->part, "2") &&
         !strcmp(b->exr->layer, "fg"));
    must(!strcmp(b->exr->view, "") && !strcmp(b->exr->pixels, "half") &&
         !strcmp(b->exr->compression, "zip"));
    must(b->output->kind == AIRY__OUTPUT__KIND__MEMFD && !b->progress);
    must(b->n_params == 2 && !strcmp(b->params[1]->name, "knee"));
    must(b->params[1]->value_case == AIRY__PARAM__VALUE_TEXT && !strcmp(b->params[1]->text, "0.25"));
    peer_result(p, id, AIRY__PAYLOAD__KIND__MEMFD, 0, 2, memfd_of("ok", 2, F_SEAL_SHRINK));

    m = peer_next(p, WIRE_BLOOM);
    must(m.header.n_fds == 2);
    must(pwrite(m.fds[1], "bloomed", 7, 100) == 7);
    close(m.fds[0]);
    close(m.fds[1]);
    id = m.header.id;
    b = peer_body(p, &m, &airy__bloom__descriptor);
    must(b->input->kind == AIRY__PAYLOAD__KIND__MEMFD && b->input->size == 4096 && !b->input->offset);
    must(b->format_case == AIRY__BLOOM__FORMAT_RAW && b->raw->width == 8 && b->raw->height == 4);
    must(b->raw->type == AIRY__PIXEL_TYPE__PIXEL_FLOAT && b->raw->n_channels == 3);
    must(!strcmp(b->raw->channels[2]->name, "B") && b->raw->channels[2]->offset == 8);
    must(b->raw->channels[2]->row_stride == 128 && b->raw->channels[2]->pixel_stride == 16);
    must(b->output->kind == AIRY__OUTPUT__KIND__BUFFER && b->output->fd == 1);
    must(b->output->offset == 64 && b->output->size == 4032);
    peer_result(p, id, AIRY__PAYLOAD__KIND__NONE, 0, 512, -1);
    peer_until_closed(p);
}

static void requests_say_what_was_asked(void **state)
{
    (void)state;
    struct peer p = { 0 };
    char path[] = "/tmp/test_libairy_XXXXXX";
    struct airy *a = open_peer(&p, script_requests);
    int file = mkstemp(path);
    assert_true(file >= 0);
    unlink(path);
    assert_int_equal(ftruncate(file, 100), 0);
    struct airy_request r = AIRY_REQUEST_INIT;
    struct airy_error e = { .text = "" };
    r.input_fd = file;
    r.offset = 10;
    r.part = "2";
    r.layer = "fg";
    r.pixels = "half";
    r.compression = "zip";
    assert_int_equal(airy_request_param(&r, "threshold", "1.5", &e), 0);
    assert_int_equal(airy_request_param(&r, "knee", "0.25", &e), 0);
    uint64_t id = submit(a, &r);
    close(file);
    struct airy_result *res;
    if (airy_wait(a, id, 10000, &res, &e) != 1)
        fail_msg("%s", e.text);
    assert_memory_equal(res->data, "ok", 2);
    airy_result_free(res);

    void *in, *out;
    int in_fd = airy_memfd(4096, &in, &e), out_fd = airy_memfd(4096, &out, &e);
    assert_true(in_fd >= 0 && out_fd >= 0);
    struct airy_request raw = AIRY_REQUEST_INIT;
    raw.input_fd = in_fd;
    raw.width = 8;
    raw.height = 4;
    raw.type = AIRY_FLOAT;
    raw.n_channels = 3;
    for (unsigned i = 0; i < 3; i++)
        raw.channels[i] = (struct airy_channel){ i == 0 ? "R" : i == 1 ? "G" : "B", 4 * i, 128, 16 };
    raw.output_fd = out_fd;
    raw.output_offset = 64;
    raw.output_size = 4032;
    id = submit(a, &raw);
    if (airy_wait(a, id, 10000, &res, &e) != 1)
        fail_msg("%s", e.text);
    assert_null(res->data);
    assert_int_equal(res->fd, -1);
    assert_int_equal(res->size, 512);
    assert_memory_equal((char *)out + 100, "bloomed", 7);
    airy_result_free(res);
    munmap(in, 4096);
    munmap(out, 4096);
    close(in_fd);
    close(out_fd);
    close_peer(&p, a);
}

static void expect_refused(struct airy *a, const struct airy_request *r, int code, const char *field)
{
    struct airy_error e = { .text = "" };
    uint64_t id = 4711;
    assert_int_equal(airy_submit(a, r, &id, &e), -1);
    assert_int_equal(e.code, code);
    assert_string_equal(e.symbol, "LOCAL");
    assert_string_equal(e.field, field);
    assert_true(e.text[0]);
    assert_int_equal(id, 4711);
    assert_int_equal(airy_submit(a, r, &id, NULL), -1);
}

static void impossible_requests_are_refused_here(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_handshake);
    struct airy_request r = AIRY_REQUEST_INIT;
    expect_refused(a, &r, -EINVAL, "input");
    r.data = "x";
    r.input_fd = 0;
    expect_refused(a, &r, -EINVAL, "input");
    r.data = NULL;
    int fds[2];
    assert_int_equal(pipe(fds), 0);
    r.input_fd = fds[0];
    expect_refused(a, &r, -EINVAL, "input_fd");
    close(fds[0]);
    close(fds[1]);
    r.input_fd = 250;
    expect_refused(a, &r, -EBADF, "input_fd");
    int file = memfd_of("12345", 5, F_SEAL_SHRINK);
    r.input_fd = file;
    r.offset = 5;
    expect_refused(a, &r, -EINVAL, "offset");
    r.offset = 0;
    r.inline_output = true;
    r.output_fd = file;
    expect_refused(a, &r, -EINVAL, "output_fd");
    r.inline_output = false;
    r.output_fd = 250;
    expect_refused(a, &r, -EBADF, "");
    r.output_fd = -1;
    r.n_channels = 9;
    r.width = 1;
    expect_refused(a, &r, -EINVAL, "n_channels");
    r.width = 0;
    char *longest = malloc(70000);
    memset(longest, 'p', 69999);
    longest[69999] = 0;
    r.part = longest;
    expect_refused(a, &r, -EMSGSIZE, "");
    struct airy_error e;
    longest[512] = 0;
    assert_int_equal(airy_request_param(&r, "psf", longest, &e), -1);
    assert_string_equal(e.field, "psf");
    longest[511] = 0;
    assert_int_equal(airy_request_param(&r, "psf", longest, &e), 0);
    longest[32] = 0;
    assert_int_equal(airy_request_param(&r, longest, "1", &e), -1);
    for (unsigned i = 1; i < AIRY_PARAMS_MAX; i++)
        assert_int_equal(airy_request_param(&r, "knee", "1", &e), 0);
    assert_int_equal(airy_request_param(&r, "knee", "1", &e), -1);
    assert_int_equal(e.code, -ENOSPC);
    void *map;
    assert_int_equal(airy_memfd(0, &map, &e), -1);
    assert_int_equal(airy_memfd(UINT64_MAX, &map, &e), -1);
    assert_string_equal(e.field, "size");
    free(longest);
    close(file);
    close_peer(&p, a);
}

static void a_memfd_is_sealed(void **state)
{
    (void)state;
    struct airy_error e;
    void *map;
    int fd = airy_memfd(12345, &map, &e);
    assert_true(fd >= 0);
    assert_int_equal(fcntl(fd, F_GET_SEALS), F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL);
    assert_true(fcntl(fd, F_GETFD) & FD_CLOEXEC);
    memset(map, 1, 12345);
    assert_int_equal(ftruncate(fd, 1), -1);
    munmap(map, 12345);
    close(fd);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(requests_say_what_was_asked),
        cmocka_unit_test(impossible_requests_are_refused_here),
        cmocka_unit_test(a_memfd_is_sealed),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
