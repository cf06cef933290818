// SPDX-License-Identifier: Apache-2.0
// test_server_walls.c - walls through a real daemon, as a client sees them, with no controller plugged in: opened, shown, held, blackened,
// refused; a frame as raw pixels, as a part of a frame and as a file is the same picture; a wall split over nodes shows what the
// whole one shows, bit for bit. (What the pixels must be is test_wall_engine.c's question, what goes over USB test_wall_usb.c's.)
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "daemon_fixture.h"

static struct daemon the_daemon;

static int start(void **state)
{
    (void)state;
    daemon_start(&the_daemon, (const char *const[]){ "--threads", "2", NULL });
    return 0;
}

static int stop(void **state)
{
    (void)state;
    assert_int_equal(daemon_stop(&the_daemon, SIGTERM), 0);
    return 0;
}

// ---- definitions ---------------------------------------------------------------------------------------

// A wall of `size`, of which this node has the panel at x, y.
static const char *definition(const char *name, const char *size, unsigned x, unsigned y, unsigned w, unsigned h, const char *more)
{
    static char text[2048];
    snprintf(text, sizeof text,
             "wall: %s\n"
             "size: %s\n"
             "rate: 100\n"
             "panels:\n"
             "  - {name: p, at: [%u, %u], size: [%u, %u]}\n"
             "%s",
             name, size, x, y, w, h, more);
    return text;
}

static struct airy_wall_reply *ask(struct airy *a, struct airy_wall_request q)
{
    struct airy_wall_reply *r = NULL;
    struct airy_error e;
    if (airy_wall(a, &q, 60000, &r, &e) < 0)
        fail_msg("%s: %s (%s)", e.symbol, e.text, e.field);
    return r;
}

static void refused(struct airy *a, struct airy_wall_request q, const char *symbol, const char *says)
{
    struct airy_wall_reply *r = NULL;
    struct airy_error e;
    if (airy_wall(a, &q, 60000, &r, &e) == 0)
        fail_msg("action %d was done; expected %s", (int)q.action, symbol);
    if (strcmp(e.symbol, symbol) || !strstr(e.text, says))
        fail_msg("%s: %s; expected %s and \"%s\"", e.symbol, e.text, symbol, says);
}

static void open_wall(struct airy *a, const char *text)
{
    struct airy_wall_reply *r = ask(a, (struct airy_wall_request){ .action = AIRY_WALL_OPEN, .definition = text });
    assert_int_equal(r->n_walls, 1);
    airy_wall_reply_free(r);
}

static void close_wall(struct airy *a, const char *name)
{
    airy_wall_reply_free(ask(a, (struct airy_wall_request){ .action = AIRY_WALL_CLOSE, .name = name }));
}

static void sleep_ms(long ms) { nanosleep(&(struct timespec){ ms / 1000, ms % 1000 * 1000000 }, NULL); }

static uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000 + (uint64_t)t.tv_nsec;
}

// ---- frames --------------------------------------------------------------------------------------------

static const char psf[] = "gaussians:sigma=2/5/14,weight=.3/.2/.1";

static struct airy_result *bloom(struct airy *a, struct airy_request *r)
{
    struct airy_error e;
    struct airy_result *result = NULL;
    uint64_t id;
    if (!r->n_params)
        assert_int_equal(airy_request_param(r, "psf", psf, &e), 0);
    if (airy_submit(a, r, &id, &e) < 0 || airy_wait(a, id, 60000, &result, &e) != 1)
        fail_msg("%s: %s (%s)", e.symbol, e.text, e.field);
    return result;
}

static void bloom_refused(struct airy *a, struct airy_request *r, const char *symbol, const char *field)
{
    struct airy_error e = { 0 };
    struct airy_result *result = NULL;
    uint64_t id;
    if (airy_submit(a, r, &id, &e) == 0 && airy_wait(a, id, 60000, &result, &e) == 1)
        fail_msg("it was done; expected %s", symbol);
    if (strcmp(e.symbol, symbol) || strcmp(e.field, field))
        fail_msg("%s: %s (%s); expected %s (%s)", e.symbol, e.text, e.field, symbol, field);
}

static struct airy_request frame_request(const struct picture *p, const char *wall)
{
    struct airy_request r = AIRY_REQUEST_INIT;
    picture_request(p, &r);
    r.data = p->pixels;
    r.size = picture_bytes(p);
    r.wall = wall;
    return r;
}

static float *drive_of(struct airy *a, const struct picture *p, const char *wall, uint32_t width, uint32_t height)
{
    struct airy_request r = frame_request(p, wall);
    struct airy_result *got = bloom(a, &r);
    const size_t bytes = (size_t)width * height * 12;
    assert_int_equal(got->size, bytes);
    float *out = malloc(bytes);
    memcpy(out, got->data, bytes);
    airy_result_free(got);
    return out;
}

// ---- tests ---------------------------------------------------------------------------------------------

static void test_open_list_close(void **state)
{
    (void)state;
    struct airy *a = daemon_join(&the_daemon);
    struct airy_wall_reply *r = ask(a, (struct airy_wall_request){ .action = AIRY_WALL_LIST });
    assert_int_equal(r->n_walls, 0);
    airy_wall_reply_free(r);

    r = ask(a, (struct airy_wall_request){ .action = AIRY_WALL_OPEN,
                                           .definition = definition("one", "[24, 16]", 0, 0, 24, 16,
                                                                    "boards:\n  - {serial: NOTTHERE, kind: fadecandy, panels: [p]}\n") });
    assert_string_equal(r->walls[0].name, "one");
    assert_int_equal(r->walls[0].width, 24);
    assert_int_equal(r->walls[0].height, 16);
    assert_int_equal(r->walls[0].leds, 384);
    assert_string_equal(r->walls[0].source, "none");
    assert_int_equal(r->walls[0].n_boards, 1);
    assert_string_equal(r->walls[0].boards[0].state, "absent");
    airy_wall_reply_free(r);

    refused(a, (struct airy_wall_request){ .action = AIRY_WALL_OPEN, .definition = definition("one", "[2, 2]", 0, 0, 2, 2, "") },
            "WALL", "is open");
    refused(a, (struct airy_wall_request){ .action = AIRY_WALL_OPEN, .definition = definition("two", "[2, 2]", 1, 0, 2, 2, "") },
            "WALL", "line 5");
    refused(a, (struct airy_wall_request){ .action = AIRY_WALL_OPEN, .definition = "" }, "WALL", "");
    refused(a, (struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = "three" }, "NO_WALL", "\"one\"");
    refused(a, (struct airy_wall_request){ .action = AIRY_WALL_CLOSE, .name = "three" }, "NO_WALL", "three");
    refused(a, (struct airy_wall_request){ .action = AIRY_WALL_PATTERN, .name = "one", .pattern = "plaid" }, "PARAM_SYNTAX", "checker");
    refused(a, (struct airy_wall_request){ .action = AIRY_WALL_PATTERN, .name = "one", .pattern = "red", .level = 2 }, "PARAM_RANGE", "0 to 1");
    refused(a, (struct airy_wall_request){ .action = AIRY_WALL_PATTERN, .name = "one", .pattern = "led", .board = "x" }, "WALL", "NOTTHERE");
    refused(a, (struct airy_wall_request){ .action = AIRY_WALL_PATTERN, .name = "one", .pattern = "led", .board = "NOTTHERE", .led = 512 },
            "PARAM_RANGE", "512");
    refused(a, (struct airy_wall_request){ .action = AIRY_WALL_OPEN,
                                           .definition = definition("four", "[2, 2]", 0, 0, 2, 2, "colour: {calibration: gains.exr}\n") },
            "WALL", "gains.exr");

    // One client's wall is another's to see, and goes with the first.
    struct airy *b = daemon_join(&the_daemon);
    r = ask(b, (struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = "one" });
    assert_int_equal(r->n_walls, 1);
    airy_wall_reply_free(r);
    for (unsigned i = 0; i < 3; i++) {
        char name[8];
        snprintf(name, sizeof name, "more%u", i);
        open_wall(a, definition(name, "[2, 2]", 0, 0, 2, 2, ""));
    }
    refused(a, (struct airy_wall_request){ .action = AIRY_WALL_OPEN, .definition = definition("fifth", "[2, 2]", 0, 0, 2, 2, "") },
            "LIMIT", "at most 4");
    airy_close(a);
    for (int i = 0; i < 200; i++) {
        r = ask(b, (struct airy_wall_request){ .action = AIRY_WALL_LIST });
        unsigned left = r->n_walls;
        airy_wall_reply_free(r);
        if (!left)
            break;
        if (i == 199)
            fail_msg("%u walls stayed when their client had gone", left);
        sleep_ms(20);
    }
    airy_close(b);
}

static void test_keep(void **state)
{
    (void)state;
    struct airy *a = daemon_join(&the_daemon);
    airy_wall_reply_free(ask(a, (struct airy_wall_request){ .action = AIRY_WALL_OPEN, .keep = true,
                                                            .definition = definition("kept", "[2, 2]", 0, 0, 2, 2, "") }));
    airy_close(a);
    a = daemon_join(&the_daemon);
    sleep_ms(50);
    struct airy_wall_reply *r = ask(a, (struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = "kept" });
    assert_int_equal(r->n_walls, 1);
    airy_wall_reply_free(r);
    close_wall(a, "kept");
    airy_close(a);
}

static void test_bad_frames(void **state)
{
    (void)state;
    struct picture p = picture_make(64, 48, 50, 3);
    struct airy *a = daemon_join(&the_daemon);
    struct airy_error e;
    open_wall(a, definition("w", "[16, 12]", 0, 0, 16, 12, ""));

    struct airy_request r = frame_request(&p, "nobody");
    bloom_refused(a, &r, "NO_WALL", "wall.name");
    r = frame_request(&p, "w");
    airy_request_param(&r, "display", "aces", &e);
    bloom_refused(a, &r, "PARAM_CONFLICT", "params.display");
    r = frame_request(&p, "w");
    airy_request_param(&r, "storage", "half", &e);
    bloom_refused(a, &r, "PARAM_CONFLICT", "params.storage");
    r = frame_request(&p, "w");
    r.frame_width = 100;
    r.frame_height = 48;
    r.frame_x = 37;
    bloom_refused(a, &r, "LAYOUT", "wall.frame_width");
    r = frame_request(&p, "w");
    r.frame_x = -1;
    bloom_refused(a, &r, "LAYOUT", "wall.frame_width");
    // And it goes on.
    free(drive_of(a, &p, "w", 16, 12));
    picture_free(&p);
    airy_close(a);
}

// Raw, as a part of itself with all that is needed, as a file, whole or in shares: the same light.
static void test_ways_and_shares(void **state)
{
    (void)state;
    enum { W = 48, H = 24 };
    struct picture p = picture_make(601, 333, 400, 21);
    struct airy *a = daemon_join(&the_daemon);
    open_wall(a, definition("whole", "[48, 24]", 0, 0, W, H, "picture: {tone map: aces}\n"));
    float *truth = drive_of(a, &p, "whole", W, H);
    float most = 0;
    for (size_t i = 0; i < (size_t)W * H * 3; i++)
        most = fmaxf(most, truth[i]);
    assert_true(most > 0.1f && most <= 1.1f);

    // As a file.
    size_t bytes;
    uint8_t *file = picture_exr(&p, &bytes);
    struct airy_request r = AIRY_REQUEST_INIT;
    r.data = file;
    r.size = bytes;
    r.wall = "whole";
    struct airy_result *got = bloom(a, &r);
    assert_int_equal(got->size, W * H * 12);
    assert_memory_equal(got->data, truth, W * H * 12);
    airy_result_free(got);
    free(file);

    // In shares: a node's panel, the whole frame, or only what the node says that it needs.
    static const unsigned share[][4] = { { 0, 0, 17, H }, { 17, 0, 31, 11 }, { 17, 11, 31, 13 } };
    bool smaller = false;
    for (unsigned i = 0; i < 3; i++) {
        const unsigned *s = share[i];
        open_wall(a, definition("share", "[48, 24]", s[0], s[1], s[2], s[3], "picture: {tone map: aces}\n"));
        float *part = drive_of(a, &p, "share", W, H);

        r = frame_request(&p, "share");
        r.plan_only = true;
        got = bloom(a, &r);
        assert_true(got->has_need);
        struct airy_region n = got->need;
        airy_result_free(got);
        assert_true(n.x >= 0 && n.y >= 0 && n.x + n.width <= p.width && n.y + n.height <= p.height && n.width && n.height);
        smaller |= n.width < p.width || n.height < p.height;
        r = frame_request(&p, "share");
        r.frame_width = p.width;
        r.frame_height = p.height;
        r.frame_x = n.x;
        r.frame_y = n.y;
        r.width = n.width;
        r.height = n.height;
        r.data = (const uint8_t *)r.data + ((size_t)n.y * p.width + (size_t)n.x) * 8;
        r.size = ((size_t)(n.height - 1) * p.width + n.width) * 8;
        got = bloom(a, &r);

        for (unsigned y = s[1]; y < s[1] + s[3]; y++) {
            const size_t at = ((size_t)y * W + s[0]) * 3;
            if (memcmp(part + at, truth + at, s[2] * 12))
                fail_msg("share %u, row %u: not what the whole wall shows", i, y);
            if (memcmp((const float *)got->data + at, truth + at, s[2] * 12))
                fail_msg("share %u, row %u, from its region alone: not what the whole wall shows", i, y);
        }
        airy_result_free(got);
        free(part);
        close_wall(a, "share");
        // Its name is free once the last of it has gone.
        sleep_ms(20);
    }
    assert_true(smaller);
    free(truth);
    picture_free(&p);
    airy_close(a);
}

static struct airy_wall_reply *state_of(struct airy *a, const char *name)
{
    return ask(a, (struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = name });
}

static void wait_for_source(struct airy *a, const char *name, const char *source)
{
    for (int i = 0; i < 1000; i++) {
        struct airy_wall_reply *r = state_of(a, name);
        const bool is = !strcmp(r->walls[0].source, source);
        airy_wall_reply_free(r);
        if (is)
            return;
        sleep_ms(10);
    }
    fail_msg("the wall's source did not become %s", source);
}

static void check_preview(struct airy *a, const char *name, bool lit)
{
    struct airy_wall_reply *r = ask(a, (struct airy_wall_request){ .action = AIRY_WALL_PREVIEW, .name = name });
    const size_t n = (size_t)r->walls[0].width * r->walls[0].height * 3;
    unsigned most = 0;
    assert_non_null(r->preview);
    for (size_t i = 0; i < n; i++)
        most = r->preview[i] > most ? r->preview[i] : most;
    if (lit ? most < 100 : most > 0)
        fail_msg("the brightest sample of the preview is %u; expected %s", most, lit ? "light" : "black");
    airy_wall_reply_free(r);
}

// Shown, held, faded, black; a pattern in between; the boards' bytes are what the preview undoes.
static void test_show(void **state)
{
    (void)state;
    struct picture p = picture_make(64, 32, 400, 5);
    struct airy *a = daemon_join(&the_daemon);
    open_wall(a, definition("stage", "[32, 16]", 0, 0, 32, 16,
                            "hold: 400 ms\nfade: 200 ms\nboards:\n  - {serial: NOTTHERE, kind: fadecandy, panels: [p]}\n"));
    struct airy_request r = frame_request(&p, "stage");
    r.show = true;
    struct airy_result *got = bloom(a, &r);
    assert_int_equal(got->size, 0);
    assert_int_equal(got->n_targets, 1);
    assert_true(got->targets[0].error_bound > 0);
    airy_result_free(got);
    wait_for_source(a, "stage", "live");
    check_preview(a, "stage", true);
    wait_for_source(a, "stage", "held");
    check_preview(a, "stage", true);
    wait_for_source(a, "stage", "black");
    check_preview(a, "stage", false);

    airy_wall_reply_free(ask(a, (struct airy_wall_request){ .action = AIRY_WALL_PATTERN, .name = "stage", .pattern = "white", .level = 1 }));
    wait_for_source(a, "stage", "pattern");
    sleep_ms(30);
    check_preview(a, "stage", true);
    airy_wall_reply_free(ask(a, (struct airy_wall_request){ .action = AIRY_WALL_PATTERN, .name = "stage", .pattern = "" }));
    wait_for_source(a, "stage", "black");

    // In the future: not before its time.
    r.present_ns = now_ns() + 300000000;
    airy_result_free(bloom(a, &r));
    struct airy_wall_reply *s = state_of(a, "stage");
    const bool early = now_ns() < r.present_ns && strcmp(s->walls[0].source, "black");
    airy_wall_reply_free(s);
    assert_false(early);
    wait_for_source(a, "stage", "live");
    s = state_of(a, "stage");
    assert_int_equal(s->walls[0].frames, 2);
    assert_int_equal(s->walls[0].shown, 2);
    assert_int_equal(s->walls[0].dropped, 0);
    assert_true(s->walls[0].ticks > 10);
    assert_true(s->walls[0].boards[0].missed > 10);
    assert_int_equal(s->walls[0].boards[0].sent, 0);
    airy_wall_reply_free(s);
    picture_free(&p);
    airy_close(a);
}

static void test_one_source(void **state)
{
    (void)state;
    struct picture p = picture_make(32, 32, 400, 5);
    struct airy *a = daemon_join(&the_daemon), *b = daemon_join(&the_daemon), *c = daemon_join(&the_daemon);
    open_wall(a, definition("shared", "[8, 8]", 0, 0, 8, 8, "hold: 3600s\n"));
    struct airy_request r = frame_request(&p, "shared");
    r.show = true;
    airy_result_free(bloom(b, &r));
    bloom_refused(c, &r, "WALL_BUSY", "wall.name");
    // A picture that is not shown disturbs nobody.
    free(drive_of(c, &p, "shared", 8, 8));
    airy_close(b);
    struct airy_error e;
    for (int i = 0;; i++) {
        struct airy_result *got = NULL;
        uint64_t id;
        assert_int_equal(airy_submit(c, &r, &id, &e), 0);
        int rc = airy_wait(c, id, 60000, &got, &e);
        if (rc == 1) {
            airy_result_free(got);
            break;
        }
        assert_string_equal(e.symbol, "WALL_BUSY");
        assert_true(i < 100);
        sleep_ms(10);
    }
    picture_free(&p);
    airy_close(c);
    airy_close(a);
}

// Many frames in flight for a wall and for nobody, walls closed under them: every request ends, the daemon lives.
static void test_closed_under_frames(void **state)
{
    (void)state;
    enum { FRAMES = 24 };
    struct picture p = picture_make(320, 200, 100, 9);
    struct airy *a = daemon_join(&the_daemon), *b = daemon_join(&the_daemon);
    struct airy_error e;
    unsigned ended = 0;
    open_wall(b, definition("brief", "[16, 8]", 0, 0, 16, 8, ""));
    for (unsigned i = 0; i < FRAMES; i++) {
        struct airy_request r = frame_request(&p, i % 2 ? "brief" : NULL);
        uint64_t id;
        r.show = i % 4 == 1;
        assert_int_equal(airy_submit(a, &r, &id, &e), 0);
        if (i == FRAMES / 2)
            close_wall(b, "brief");
    }
    for (; ended < FRAMES; ended++) {
        struct airy_result *got = NULL;
        uint64_t id = 0;
        int rc = airy_wait_any(a, 60000, &id, &got, &e);
        if (rc < 0 && strcmp(e.symbol, "NO_WALL"))
            fail_msg("%s: %s", e.symbol, e.text);
        assert_true(rc != 0);
        airy_result_free(got);
    }
    airy_close(a);
    airy_close(b);
    picture_free(&p);
}

static void test_service_wall(void **state)
{
    (void)state;
    char path[] = "/tmp/airyd-test-wall-XXXXXX", text[4096];
    int fd = mkstemp(path);
    const char *good = definition("service", "[8, 8]", 0, 0, 8, 8, "");
    assert_int_equal(write(fd, good, strlen(good)), strlen(good));
    struct daemon d;
    daemon_start(&d, (const char *const[]){ "--threads", "1", "--wall", path, NULL });
    struct airy *a = daemon_join(&d);
    struct airy_wall_reply *r = state_of(a, "service");
    assert_int_equal(r->n_walls, 1);
    airy_wall_reply_free(r);
    airy_close(a);
    assert_int_equal(daemon_stop(&d, SIGTERM), 0);

    assert_int_equal(ftruncate(fd, 0), 0);
    assert_int_equal(pwrite(fd, "wall: x\nsize: [0, 4]\n", 21, 0), 21);
    char socket_path[sizeof path + 8]; // of its own: this program may run beside itself
    snprintf(socket_path, sizeof socket_path, "%s.sock", path);
    assert_int_not_equal(daemon_run((const char *const[]){ "--wall", path, "--socket", socket_path, NULL }, text, sizeof text), 0);
    if (!strstr(text, "line 1") || !strstr(text, path))
        fail_msg("said: %s", text);
    close(fd);
    unlink(path);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_open_list_close), cmocka_unit_test(test_keep),
        cmocka_unit_test(test_bad_frames),      cmocka_unit_test(test_ways_and_shares),
        cmocka_unit_test(test_show),            cmocka_unit_test(test_one_source),
        cmocka_unit_test(test_closed_under_frames), cmocka_unit_test(test_service_wall),
    };
    return cmocka_run_group_tests(tests, start, stop);
}
