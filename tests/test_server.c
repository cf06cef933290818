// SPDX-License-Identifier: Apache-2.0
// test_server.c - what a real airyd answers to right and wrong messages over a real socket. One daemon for
// all tests: after each of them it must still serve the next.
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

#include "daemon_fixture.h"

static struct daemon the_daemon;
static unsigned fds_at_start;

static int start(void **state)
{
    (void)state;
    // Frames of 2 MiB at most, so that the limits can be reached.
    daemon_start(&the_daemon, (const char *const[]){ "--max-frame-bytes", "2M", "--max-requests", "4", NULL });
    usleep(300000); // until it has seen that daemon_start's probe is gone
    fds_at_start = daemon_fds(&the_daemon);
    return 0;
}

static int stop(void **state)
{
    (void)state;
    // Whatever was sent, no descriptor of a client is still open.
    for (int i = 0; i < 500 && daemon_fds(&the_daemon) > fds_at_start; i++)
        usleep(10000);
    assert_true(daemon_fds(&the_daemon) <= fds_at_start);
    assert_int_equal(daemon_stop(&the_daemon, 15), 0);
    return 0;
}

struct ask {
    Airy__Bloom bloom;
    Airy__Payload input;
    Airy__Output output;
    Airy__ExrOptions exr;
    Airy__RawLayout raw;
    Airy__RawChannel channel[4], *channels[4];
    Airy__Param param, *params[1];
};

static void ask_exr(struct ask *a, Airy__Payload__Kind kind, uint64_t size)
{
    memset(a, 0, sizeof *a);
    airy__bloom__init(&a->bloom);
    airy__payload__init(&a->input);
    airy__output__init(&a->output);
    airy__exr_options__init(&a->exr);
    a->input.kind = kind;
    a->input.size = size;
    a->bloom.input = &a->input;
    a->bloom.output = &a->output;
    a->bloom.format_case = AIRY__BLOOM__FORMAT_EXR;
    a->bloom.exr = &a->exr;
}

// A planar float picture of RGB.
static void ask_raw(struct ask *a, Airy__Payload__Kind kind, uint32_t width, uint32_t height)
{
    static char *const names[] = { "R", "G", "B" };
    ask_exr(a, kind, (uint64_t)width * height * 12);
    airy__raw_layout__init(&a->raw);
    a->raw.width = width;
    a->raw.height = height;
    a->raw.type = AIRY__PIXEL_TYPE__PIXEL_FLOAT;
    for (unsigned i = 0; i < 3; i++) {
        a->channels[i] = &a->channel[i];
        airy__raw_channel__init(&a->channel[i]);
        a->channel[i].name = names[i];
        a->channel[i].offset = (uint64_t)width * height * 4 * i;
        a->channel[i].row_stride = (uint64_t)width * 4;
        a->channel[i].pixel_stride = 4;
    }
    a->raw.channels = a->channels;
    a->raw.n_channels = 3;
    a->bloom.format_case = AIRY__BLOOM__FORMAT_RAW;
    a->bloom.raw = &a->raw;
}

static void ask_param(struct ask *a, const char *name, const char *text)
{
    airy__param__init(&a->param);
    a->param.name = (char *)name;
    a->param.value_case = AIRY__PARAM__VALUE_TEXT;
    a->param.text = (char *)text;
    a->params[0] = &a->param;
    a->bloom.params = a->params;
    a->bloom.n_params = 1;
}

// The peer still works, and so does the daemon.
static void close_healthy(struct peer *p)
{
    assert_true(peer_status(p)->clients >= 1);
    peer_close(p);
}

static void send_bytes(struct peer *p, const void *bytes, size_t n)
{
    assert_int_equal(send(conn_fd(p->conn), bytes, n, MSG_NOSIGNAL), n);
}

static void send_header(struct peer *p, enum wire_type type, unsigned n_fds, uint32_t body, uint64_t id)
{
    uint8_t h[WIRE_HEADER_BYTES];
    wire_encode(h, &(struct wire_header){ .type = type, .n_fds = (uint8_t)n_fds, .body_bytes = body, .id = id });
    send_bytes(p, h, sizeof h);
}

// ---- HELLO, STATUS ---------------------------------------------------------------------------------

static void test_welcome(void **state)
{
    (void)state;
    struct airy *a;
    struct airy_error e;
    assert_int_equal(airy_connect(&a, the_daemon.path, &e), 0);
    assert_string_equal(airy_server(a), "airyd/" AIRY_VERSION);
    assert_true(airy_device(a)[0]);
    const struct airy_limits *l = airy_limits(a);
    assert_int_equal(l->max_frame_bytes, 2 << 20);
    assert_true(l->credit_bytes >= l->max_frame_bytes);
    assert_int_equal(l->max_requests, 4);
    assert_true(l->max_width >= 4096 && l->max_height >= 4096 && l->max_pixels >= 4096 * 2160);
    struct airy_status s;
    assert_int_equal(airy_status(a, &s, 10000, &e), 0);
    assert_int_equal(s.clients, 1);
    assert_string_equal(s.device, airy_device(a));
    assert_true(s.rss_bytes > 1 << 20);
    assert_false(s.draining);
    airy_close(a);
}

static void test_wrong_version(void **state)
{
    (void)state;
    struct peer p;
    Airy__Hello h = AIRY__HELLO__INIT;
    h.version_min = 2;
    h.version_max = 9;
    peer_open(&p, &the_daemon);
    assert_int_equal(body_send(p.conn, WIRE_HELLO, 0, &h.base, NULL, 0), 0);
    peer_flush(&p);
    peer_expect_error(&p, 0, FAULT_BAD_VERSION, "version_max");
    peer_expect_closed(&p);
    peer_close(&p);
}

static void test_before_hello(void **state)
{
    (void)state;
    static const enum wire_type types[] = { WIRE_STATUS, WIRE_CANCEL, WIRE_BLOOM, WIRE_DATA };
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++) {
        struct peer p;
        peer_open(&p, &the_daemon);
        send_header(&p, types[i], 0, 0, 1);
        peer_expect_error(&p, 0, FAULT_UNEXPECTED, "type");
        peer_expect_closed(&p);
        peer_close(&p);
    }
}

static void test_second_hello(void **state)
{
    (void)state;
    struct peer p;
    peer_hello(&p, &the_daemon);
    send_header(&p, WIRE_HELLO, 0, 0, 0);
    peer_expect_error(&p, 0, FAULT_UNEXPECTED, "type");
    peer_expect_closed(&p);
    peer_close(&p);
}

static void test_garbage(void **state)
{
    (void)state;
    struct peer p;
    peer_open(&p, &the_daemon);
    send_bytes(&p, "GET / HTTP/1.1\r\nHost: airyd\r\n\r\n", 31);
    peer_expect_error(&p, 0, FAULT_BAD_MAGIC, NULL);
    peer_expect_closed(&p);
    peer_close(&p);
    // A megabyte of it: the error can still be read.
    peer_hello(&p, &the_daemon);
    uint32_t seed = 7;
    uint8_t junk[65536];
    for (size_t i = 0; i < sizeof junk; i++)
        junk[i] = (uint8_t)((seed = seed * 1664525u + 1013904223u) >> 24);
    for (int i = 0; i < 16; i++)
        if (send(conn_fd(p.conn), junk, sizeof junk, MSG_NOSIGNAL) < 0)
            break;
    peer_expect_error(&p, 0, FAULT_BAD_MAGIC, NULL);
    peer_expect_closed(&p);
    peer_close(&p);
}

static void test_bad_bodies(void **state)
{
    (void)state;
    struct peer p;
    peer_hello(&p, &the_daemon);
    send_header(&p, WIRE_BLOOM, 0, WIRE_CONTROL_BYTES_MAX + 1, 1);
    peer_expect_error(&p, 0, FAULT_TOO_LONG, NULL);
    peer_expect_closed(&p);
    peer_close(&p);
    peer_hello(&p, &the_daemon);
    send_header(&p, WIRE_BLOOM, 0, 4, 1);
    send_bytes(&p, "\xff\xff\xff\xff", 4);
    peer_expect_error(&p, 1, FAULT_BAD_BODY, NULL);
    peer_expect_closed(&p);
    peer_close(&p);
    // The daemon's own messages.
    peer_hello(&p, &the_daemon);
    send_header(&p, WIRE_RESULT, 0, 0, 1);
    peer_expect_error(&p, 0, FAULT_UNEXPECTED, NULL);
    peer_expect_closed(&p);
    peer_close(&p);
    // A request without an id.
    struct ask a;
    ask_exr(&a, AIRY__PAYLOAD__KIND__INLINE, 10);
    peer_hello(&p, &the_daemon);
    peer_bloom(&p, 0, &a.bloom, NULL, 0);
    peer_expect_error(&p, 0, FAULT_UNEXPECTED, "id");
    peer_expect_closed(&p);
    peer_close(&p);
}

// ---- descriptors -------------------------------------------------------------------------------------

static void send_with_fd(struct peer *p, const void *bytes, size_t n, int fd)
{
    union {
        struct cmsghdr align;
        char bytes[CMSG_SPACE(sizeof(int))];
    } control = { .bytes = { 0 } };
    struct iovec iov = { (void *)bytes, n };
    struct msghdr h = { .msg_iov = &iov, .msg_iovlen = 1, .msg_control = &control, .msg_controllen = sizeof control };
    struct cmsghdr *c = CMSG_FIRSTHDR(&h);
    c->cmsg_level = SOL_SOCKET;
    c->cmsg_type = SCM_RIGHTS;
    c->cmsg_len = CMSG_LEN(sizeof(int));
    memcpy(CMSG_DATA(c), &fd, sizeof fd);
    assert_int_equal(sendmsg(conn_fd(p->conn), &h, MSG_NOSIGNAL), n);
}

static void test_wrong_n_fds(void **state)
{
    (void)state;
    struct peer p;
    peer_hello(&p, &the_daemon);
    send_header(&p, WIRE_BLOOM, 1, 0, 1); // says one, brings none
    peer_expect_error(&p, 0, FAULT_BAD_FDS, "header.n_fds");
    peer_expect_closed(&p);
    peer_close(&p);
    peer_hello(&p, &the_daemon);
    uint8_t h[WIRE_HEADER_BYTES];
    wire_encode(h, &(struct wire_header){ .type = WIRE_STATUS, .id = 1 });
    send_with_fd(&p, h, sizeof h, 0); // says none, brings one
    peer_expect_error(&p, 0, FAULT_BAD_FDS, NULL);
    peer_expect_closed(&p);
    peer_close(&p);
}

static void refused(struct peer *p, struct ask *a, const int *fds, unsigned n_fds, unsigned code,
                    const char *field)
{
    static uint64_t id = 100;
    peer_bloom(p, ++id, &a->bloom, fds, n_fds);
    peer_expect_error(p, id, code, field);
}

static void test_memfds(void **state)
{
    (void)state;
    static const uint8_t bytes[4096];
    int sealed = make_memfd(bytes, sizeof bytes, F_SEAL_SHRINK), open_memfd = make_memfd(bytes, sizeof bytes, 0);
    int grow = make_memfd(bytes, sizeof bytes, F_SEAL_GROW);
    struct peer p;
    struct ask a;
    peer_hello(&p, &the_daemon);
    ask_exr(&a, AIRY__PAYLOAD__KIND__MEMFD, sizeof bytes);
    refused(&p, &a, &open_memfd, 1, FAULT_PAYLOAD_SEALS, "input.fd");
    refused(&p, &a, &grow, 1, FAULT_PAYLOAD_SEALS, "input.fd");
    refused(&p, &a, &sealed, 1, FAULT_NOT_EXR, NULL);
    a.input.size = sizeof bytes + 1; // more than there is
    refused(&p, &a, &sealed, 1, FAULT_PAYLOAD, "input.size");
    a.input.size = 1;
    a.input.offset = sizeof bytes + 1;
    refused(&p, &a, &sealed, 1, FAULT_PAYLOAD, "input.offset");
    a.input.offset = UINT64_MAX;
    refused(&p, &a, &sealed, 1, FAULT_PAYLOAD, "input.offset");
    a.input.offset = 0;
    a.input.fd = 1; // index of no descriptor
    refused(&p, &a, &sealed, 1, FAULT_PAYLOAD, "input.fd");
    a.input.fd = 0;
    refused(&p, &a, NULL, 0, FAULT_PAYLOAD, "input.fd");
    refused(&p, &a, (int[]){ sealed, sealed }, 2, FAULT_PAYLOAD, "input.fd"); // the second is for nothing
    close(sealed);
    close(open_memfd);
    close(grow);
    close_healthy(&p);
}

static void test_files(void **state)
{
    (void)state;
    char path[] = "/tmp/airyd-test-file-XXXXXX";
    int file = mkstemp(path), ends[2];
    assert_true(file >= 0);
    assert_int_equal(write(file, "not an exr file, but long enough", 32), 32);
    int write_only = open(path, O_WRONLY | O_CLOEXEC), dir = open("/tmp", O_RDONLY | O_CLOEXEC);
    assert_int_equal(pipe(ends), 0);
    struct peer p;
    struct ask a;
    peer_hello(&p, &the_daemon);
    ask_exr(&a, AIRY__PAYLOAD__KIND__FILE, 32);
    refused(&p, &a, &file, 1, FAULT_NOT_EXR, NULL);
    a.input.size = 1000; // the file is shorter
    refused(&p, &a, &file, 1, FAULT_PAYLOAD, "input.size");
    a.input.size = 32;
    refused(&p, &a, &write_only, 1, FAULT_PAYLOAD, "input.fd");
    refused(&p, &a, &dir, 1, FAULT_PAYLOAD, "input.fd");
    refused(&p, &a, &ends[0], 1, FAULT_PAYLOAD, "input.fd");
    a.input.kind = AIRY__PAYLOAD__KIND__MEMFD; // a file that says it is one
    refused(&p, &a, &file, 1, FAULT_PAYLOAD_SEALS, "input.fd");
    close(file);
    close(write_only);
    close(dir);
    close(ends[0]);
    close(ends[1]);
    unlink(path);
    close_healthy(&p);
}

static void test_buffers(void **state)
{
    (void)state;
    static const float pixels[3 * 64];
    int in = make_memfd(pixels, sizeof pixels, F_SEAL_SHRINK);
    int small = make_memfd(NULL, 100, F_SEAL_SHRINK), open_memfd = make_memfd(NULL, sizeof pixels, 0);
    int sealed = make_memfd(NULL, sizeof pixels, F_SEAL_SHRINK | F_SEAL_WRITE);
    struct peer p;
    struct ask a;
    peer_hello(&p, &the_daemon);
    ask_raw(&a, AIRY__PAYLOAD__KIND__MEMFD, 8, 8);
    a.output.kind = AIRY__OUTPUT__KIND__BUFFER;
    a.output.fd = 1;
    a.output.size = sizeof pixels;
    refused(&p, &a, (int[]){ in, small }, 2, FAULT_PAYLOAD, "output.size");
    refused(&p, &a, (int[]){ in, open_memfd }, 2, FAULT_PAYLOAD_SEALS, "output.fd");
    refused(&p, &a, (int[]){ in, sealed }, 2, FAULT_PAYLOAD_SEALS, "output.fd");
    a.output.size = 100; // less room than the input
    refused(&p, &a, (int[]){ in, small }, 2, FAULT_PAYLOAD, "output.size");
    a.bloom.format_case = AIRY__BLOOM__FORMAT_EXR;
    a.bloom.exr = &a.exr;
    refused(&p, &a, (int[]){ in, small }, 2, FAULT_PAYLOAD, "output.kind");
    close(in);
    close(small);
    close(open_memfd);
    close(sealed);
    close_healthy(&p);
}

// ---- requests ----------------------------------------------------------------------------------------

static void test_params(void **state)
{
    (void)state;
    struct peer p;
    struct ask a;
    static char many[20001 + 64], long_text[60000];
    char *at = many + sprintf(many, "gaussians:sigma=1");
    for (int i = 1; i < 9000; i++)
        at += sprintf(at, "/1");
    memset(long_text, 'x', sizeof long_text - 1);
    const struct {
        const char *name, *text, *field;
        unsigned code;
    } cases[] = {
        { "psf", "gaussians:sigma=-1,weight=1", "params.psf", 0 },
        { "psf", many, "params.psf", 0 },
        { "psf", long_text, "params.psf", 0 },
        { "threshold", "nan", "params.threshold", 0 },
        { "threshold", "-33", "params.threshold", FAULT_PARAM_RANGE },
        { "threshold", "", "params.threshold", 0 },
        { "tolerance", "1e9", "params.tolerance", FAULT_PARAM_RANGE },
        { "bright", "brightest", "params.bright", 0 },
        { "sigma", "-1", "params.sigma", FAULT_PARAM_UNKNOWN },
    };
    peer_hello(&p, &the_daemon);
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        ask_exr(&a, AIRY__PAYLOAD__KIND__INLINE, 100);
        ask_param(&a, cases[i].name, cases[i].text);
        peer_bloom(&p, i + 1, &a.bloom, NULL, 0);
        struct conn_message m;
        struct fault f;
        peer_expect(&p, &m, WIRE_ERROR, i + 1);
        Airy__Error *e = body_unpack(&airy__error__descriptor, m.body, m.header.body_bytes, &p.arena, &f);
        assert_string_equal(e->field, cases[i].field);
        assert_in_range(e->code, FAULT_PARAM_UNKNOWN, FAULT_PARAM_CONFLICT);
        if (cases[i].code)
            assert_int_equal(e->code, cases[i].code);
        assert_false(e->retryable);
        peer_data(&p, i + 1, long_text, 100); // on its way already: thrown away
    }
    close_healthy(&p);
}

static void test_formats(void **state)
{
    (void)state;
    struct peer p;
    struct ask a;
    peer_hello(&p, &the_daemon);
    ask_exr(&a, AIRY__PAYLOAD__KIND__INLINE, 100);
    a.exr.compression = "gzip";
    refused(&p, &a, NULL, 0, FAULT_PARAM_SYNTAX, "exr.compression");
    a.exr.compression = "";
    a.exr.pixels = "int";
    refused(&p, &a, NULL, 0, FAULT_PARAM_SYNTAX, "exr.pixels");
    ask_exr(&a, AIRY__PAYLOAD__KIND__NONE, 0);
    refused(&p, &a, NULL, 0, FAULT_PAYLOAD, "input.kind");
    ask_exr(&a, (Airy__Payload__Kind)99, 5);
    refused(&p, &a, NULL, 0, FAULT_PAYLOAD, "input.kind");
    ask_exr(&a, AIRY__PAYLOAD__KIND__INLINE, 0);
    refused(&p, &a, NULL, 0, FAULT_PAYLOAD, "input.size");
    ask_exr(&a, AIRY__PAYLOAD__KIND__INLINE, 100);
    a.output.kind = (Airy__Output__Kind)99;
    refused(&p, &a, NULL, 0, FAULT_PAYLOAD, "output.kind");
    ask_exr(&a, AIRY__PAYLOAD__KIND__INLINE, UINT64_MAX);
    refused(&p, &a, NULL, 0, FAULT_LIMIT, "input.size");
    close_healthy(&p);
}

static void test_layouts(void **state)
{
    (void)state;
    struct peer p;
    struct ask a;
    peer_hello(&p, &the_daemon);
    ask_raw(&a, AIRY__PAYLOAD__KIND__INLINE, 8, 8);
    a.raw.width = 0;
    refused(&p, &a, NULL, 0, FAULT_LAYOUT, "raw.width");
    a.raw.width = UINT32_MAX;
    refused(&p, &a, NULL, 0, FAULT_LAYOUT, "raw.width");
    ask_raw(&a, AIRY__PAYLOAD__KIND__INLINE, 8, 8);
    a.raw.type = AIRY__PIXEL_TYPE__PIXEL_NONE;
    refused(&p, &a, NULL, 0, FAULT_LAYOUT, "raw.type");
    ask_raw(&a, AIRY__PAYLOAD__KIND__INLINE, 8, 8);
    a.channel[2].offset += 4; // the last pixel is outside
    refused(&p, &a, NULL, 0, FAULT_LAYOUT, "raw.channels.offset");
    a.channel[2].offset = UINT64_MAX - 3;
    refused(&p, &a, NULL, 0, FAULT_LAYOUT, "raw.channels.offset");
    ask_raw(&a, AIRY__PAYLOAD__KIND__INLINE, 8, 8);
    a.channel[0].row_stride = UINT64_MAX - 3;
    refused(&p, &a, NULL, 0, FAULT_LAYOUT, "raw.channels.offset");
    a.channel[0].row_stride = 28; // shorter than a row
    refused(&p, &a, NULL, 0, FAULT_LAYOUT, "raw.channels.row_stride");
    ask_raw(&a, AIRY__PAYLOAD__KIND__INLINE, 8, 8);
    a.channel[1].offset += 2; // not a float's place
    refused(&p, &a, NULL, 0, FAULT_LAYOUT, "raw.channels");
    ask_raw(&a, AIRY__PAYLOAD__KIND__INLINE, 8, 8);
    a.channel[1].offset = 0; // on top of R
    refused(&p, &a, NULL, 0, FAULT_LAYOUT, "raw.channels");
    ask_raw(&a, AIRY__PAYLOAD__KIND__INLINE, 8, 8);
    a.channel[1].name = "R";
    refused(&p, &a, NULL, 0, FAULT_LAYOUT, "raw.channels.name");
    a.channel[1].name = "Q"; // no G
    refused(&p, &a, NULL, 0, FAULT_LAYOUT, "raw.channels");
    a.raw.n_channels = 0;
    refused(&p, &a, NULL, 0, FAULT_LAYOUT, "raw.channels");
    close_healthy(&p);
}

static void test_not_exr(void **state)
{
    (void)state;
    struct peer p;
    struct ask a;
    struct picture picture = picture_make(32, 32, 50, 1);
    size_t bytes;
    uint8_t *file = picture_exr(&picture, &bytes);
    peer_hello(&p, &the_daemon);
    ask_exr(&a, AIRY__PAYLOAD__KIND__INLINE, 64);
    peer_bloom(&p, 1, &a.bloom, NULL, 0);
    peer_data(&p, 1, "<html>................................................................", 64);
    peer_expect_error(&p, 1, FAULT_NOT_EXR, NULL);
    // Cut anywhere, it is an error and never more.
    for (size_t cut = 1; cut < bytes; cut += 211) {
        ask_exr(&a, AIRY__PAYLOAD__KIND__INLINE, cut);
        peer_bloom(&p, 2, &a.bloom, NULL, 0);
        peer_data(&p, 2, file, cut);
        struct conn_message m;
        peer_expect(&p, &m, WIRE_ERROR, 2);
    }
    ask_exr(&a, AIRY__PAYLOAD__KIND__INLINE, bytes);
    a.exr.layer = "nosuch";
    peer_bloom(&p, 3, &a.bloom, NULL, 0);
    peer_data(&p, 3, file, bytes);
    peer_expect_error(&p, 3, FAULT_NO_LAYER, NULL);
    a.exr.layer = "";
    a.exr.part = "7";
    peer_bloom(&p, 4, &a.bloom, NULL, 0);
    peer_data(&p, 4, file, bytes);
    peer_expect_error(&p, 4, FAULT_NO_PART, NULL);
    free(file);
    picture_free(&picture);
    close_healthy(&p);
}

static void test_nonfinite_reject(void **state)
{
    (void)state;
    struct peer p;
    struct ask a;
    float pixels[3 * 16 * 8] = { 0 };
    uint32_t nan = 0x7fc00000;
    memcpy(&pixels[128 + 5 * 16 + 3], &nan, 4); // G of (3, 5)
    peer_hello(&p, &the_daemon);
    ask_raw(&a, AIRY__PAYLOAD__KIND__INLINE, 16, 8);
    ask_param(&a, "nonfinite", "reject");
    peer_bloom(&p, 1, &a.bloom, NULL, 0);
    peer_data(&p, 1, pixels, sizeof pixels);
    const Airy__Error *e = peer_expect_error(&p, 1, FAULT_NONFINITE, "params.nonfinite");
    assert_non_null(strstr(e->text, "x 3, y 5 in channel G"));
    close_healthy(&p);
}

// ---- flow control --------------------------------------------------------------------------------------

static void test_duplicate_id(void **state)
{
    (void)state;
    struct peer p;
    struct ask a;
    struct conn_message m;
    float pixels[3 * 64] = { 5 };
    peer_hello(&p, &the_daemon);
    ask_raw(&a, AIRY__PAYLOAD__KIND__INLINE, 8, 8);
    peer_bloom(&p, 1, &a.bloom, NULL, 0);
    peer_bloom(&p, 1, &a.bloom, NULL, 0);
    peer_expect_error(&p, 1, FAULT_DUPLICATE_ID, "id");
    peer_data(&p, 1, pixels, sizeof pixels); // the first goes on
    peer_expect(&p, &m, WIRE_DATA, 1);
    peer_expect(&p, &m, WIRE_RESULT, 1);
    peer_bloom(&p, 1, &a.bloom, NULL, 0); // and its id is free again
    peer_data(&p, 1, pixels, sizeof pixels);
    peer_expect(&p, &m, WIRE_DATA, 1);
    peer_expect(&p, &m, WIRE_RESULT, 1);
    close_healthy(&p);
}

static void test_too_many_requests(void **state)
{
    (void)state;
    struct peer p;
    struct ask a;
    peer_hello(&p, &the_daemon);
    ask_raw(&a, AIRY__PAYLOAD__KIND__INLINE, 8, 8);
    for (uint64_t id = 1; id <= 5; id++)
        peer_bloom(&p, id, &a.bloom, NULL, 0);
    const Airy__Error *e = peer_expect_error(&p, 5, FAULT_BUSY, NULL);
    assert_true(e->retryable);
    assert_true(e->retry_after_ms > 0 && e->queue_position > 0);
    close_healthy(&p);
}

// Credit: at least one frame of the largest size; a second of it beyond is refused, and nothing is lost.
static void test_credit(void **state)
{
    (void)state;
    struct airy *probe;
    struct airy_error e;
    assert_int_equal(airy_connect(&probe, the_daemon.path, &e), 0);
    uint64_t credit = airy_limits(probe)->credit_bytes;
    airy_close(probe);
    // Frames may have 2 MiB here, credit is far more: a lone request cannot reach it, so with 4 requests
    // it takes a daemon whose credit is one frame.
    struct daemon d;
    struct peer p;
    struct ask a;
    struct conn_message m;
    struct fault f;
    char frame[32];
    snprintf(frame, sizeof frame, "%llu", (unsigned long long)credit + 4096);
    daemon_start(&d, (const char *const[]){ "--max-frame-bytes", frame, NULL });
    peer_hello(&p, &d);
    ask_exr(&a, AIRY__PAYLOAD__KIND__INLINE, credit + 4096);
    peer_bloom(&p, 1, &a.bloom, NULL, 0);
    a.input.size = 1;
    peer_bloom(&p, 2, &a.bloom, NULL, 0);
    peer_expect_error(&p, 2, FAULT_BUSY, NULL);
    assert_int_equal(peer_status(&p)->clients, 1);
    peer_cancel(&p, 1);
    uint64_t back = 1; // of request 2, taken by the STATUS above
    bool cancelled = false;
    while (back < credit + 4096 + 1 && peer_next(&p, &m, 5000) > 0) {
        cancelled |= m.header.type == WIRE_CANCELLED && m.header.id == 1;
        if (m.header.type == WIRE_CREDIT)
            back += ((Airy__Credit *)body_unpack(&airy__credit__descriptor, m.body, m.header.body_bytes,
                                                 &p.arena, &f))
                        ->bytes;
    }
    assert_true(cancelled);
    assert_int_equal(back, credit + 4096 + 1);
    peer_close(&p);
    assert_int_equal(daemon_stop(&d, 15), 0);
}

static void test_too_much_data(void **state)
{
    (void)state;
    struct peer p;
    struct ask a;
    static uint8_t bytes[1000];
    peer_hello(&p, &the_daemon);
    ask_exr(&a, AIRY__PAYLOAD__KIND__INLINE, 500);
    peer_bloom(&p, 1, &a.bloom, NULL, 0);
    peer_data(&p, 1, bytes, 300);
    peer_data(&p, 1, bytes, 300);
    peer_expect_error(&p, 1, FAULT_PAYLOAD, "input.size");
    peer_data(&p, 1, bytes, 1000); // of a request that has ended
    peer_data(&p, 99, bytes, 1000); // of one that never was
    close_healthy(&p);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_welcome),          cmocka_unit_test(test_wrong_version),
        cmocka_unit_test(test_before_hello),     cmocka_unit_test(test_second_hello),
        cmocka_unit_test(test_garbage),          cmocka_unit_test(test_bad_bodies),
        cmocka_unit_test(test_wrong_n_fds),      cmocka_unit_test(test_memfds),
        cmocka_unit_test(test_files),            cmocka_unit_test(test_buffers),
        cmocka_unit_test(test_params),           cmocka_unit_test(test_formats),
        cmocka_unit_test(test_layouts),          cmocka_unit_test(test_not_exr),
        cmocka_unit_test(test_nonfinite_reject), cmocka_unit_test(test_duplicate_id),
        cmocka_unit_test(test_too_many_requests), cmocka_unit_test(test_credit),
        cmocka_unit_test(test_too_much_data),
    };
    return cmocka_run_group_tests(tests, start, stop);
}
