// SPDX-License-Identifier: Apache-2.0
// test_libairy_wall.c - airy_wall and frames for walls with a scripted peer: what is sent, what comes back, what is passed over,
// and daemons that answer what was not asked.
#include "airy_peer.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <string.h>
#include <unistd.h>

static uint64_t take_wall(struct peer *p, Airy__Wall *out)
{
    struct conn_message m = peer_next(p, WIRE_WALL);
    must(m.header.n_fds == 0 && m.header.id);
    *out = *(Airy__Wall *)peer_body(p, &m, &airy__wall__descriptor); // its texts: until the next
    return m.header.id;
}

static struct airy_wall_reply *ask(struct airy *a, const struct airy_wall_request *q)
{
    struct airy_wall_reply *r = NULL;
    struct airy_error e = { .text = "" };
    if (airy_wall(a, q, 10000, &r, &e) < 0)
        fail_msg("wall: %s %s", e.field, e.text);
    assert_non_null(r);
    return r;
}

static struct airy_error expect_refusal(struct airy *a, const struct airy_wall_request *q, int timeout_ms)
{
    struct airy_wall_reply *r = NULL;
    struct airy_error e = { .text = "" };
    assert_int_equal(airy_wall(a, q, timeout_ms, &r, &e), -1);
    assert_null(r);
    assert_true(e.text[0]);
    return e;
}

// ---- every field -------------------------------------------------------------------------------------

static void send_lobby(struct peer *p, uint64_t id)
{
    Airy__Percentiles late = AIRY__PERCENTILES__INIT, latency = late;
    late.p50 = .25, late.p99 = .5, late.max = 4;
    latency.max = 9;
    Airy__WallBoard left = AIRY__WALL_BOARD__INIT, right = left, *boards[] = { &left, &right };
    left.name = (char *)"left", left.kind = (char *)"fadecandy", left.serial = (char *)"SERIAL";
    left.state = (char *)"ready", left.path = (char *)"1-4.2";
    left.sent = 1, left.dropped = 2, left.missed = 3, left.stalls = 4, left.timeouts = 5, left.errors = 6;
    left.losses = 7, left.rendered = 8, left.received = 9;
    left.latency_ms = &latency;
    left.amps = 1.5, left.amps_wanted = 2.5;
    right.state = (char *)"absent", right.problem = (char *)"unplugged";
    Airy__WallSupply supply = AIRY__WALL_SUPPLY__INIT, *supplies[] = { &supply };
    supply.name = (char *)"psu", supply.amps = 3, supply.amps_wanted = 4, supply.amps_limit = 5;
    Airy__WallState wall = AIRY__WALL_STATE__INIT, bare = wall, *walls[] = { &wall, &bare };
    wall.name = (char *)"lobby", wall.width = 64, wall.height = 16, wall.rate = 59.94, wall.leds = 1024;
    wall.source = (char *)"live", wall.fps = 60, wall.frames_per_second = 30;
    wall.ticks = 11, wall.ticks_missed = 12, wall.frames = 13, wall.shown = 14, wall.dropped = 15;
    wall.late_ms = &late;
    wall.exposure = -2, wall.realtime = 1;
    wall.boards = boards, wall.n_boards = 2;
    wall.supplies = supplies, wall.n_supplies = 1;
    Airy__Controller c = AIRY__CONTROLLER__INIT, *controllers[] = { &c };
    c.kind = (char *)"gud", c.serial = (char *)"G1", c.path = (char *)"2-1", c.wall = (char *)"lobby";
    c.problem = (char *)"twice";
    Airy__WallReply r = AIRY__WALL_REPLY__INIT;
    r.walls = walls, r.n_walls = 2;
    r.controllers = controllers, r.n_controllers = 1;
    r.usb = (char *)"no USB here";
    peer_send(p, WIRE_WALL_REPLY, id, &r.base);
}

static void script_lists(struct peer *p)
{
    Airy__Wall w;
    peer_welcome(p);
    uint64_t frame = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    uint64_t id = take_wall(p, &w);
    must(w.action == AIRY__WALL__ACTION__LIST && !*w.name && !*w.definition && !w.keep && !*w.pattern);
    peer_result_text(p, frame, "meanwhile");
    send_lobby(p, id);
    id = take_wall(p, &w);
    must(w.action == AIRY__WALL__ACTION__OPEN && !strcmp(w.definition, "name: x") && !strcmp(w.calibration, "d1") && w.keep);
    peer_fault(p, id, FAULT_WALL, "wall", "line 1: no");
    id = take_wall(p, &w);
    must(w.action == AIRY__WALL__ACTION__PATTERN && !strcmp(w.name, "lobby") && !strcmp(w.pattern, "led"));
    must(!strcmp(w.board, "left") && w.led == 300 && w.level == .5);
    peer_send(p, WIRE_WALL_REPLY, id, &(Airy__WallReply)AIRY__WALL_REPLY__INIT.base);
    id = take_wall(p, &w);
    must(w.action == AIRY__WALL__ACTION__CLOSE && !strcmp(w.name, "lobby"));
    peer_fault(p, id, FAULT_NO_WALL, "name", "gone");
    peer_until_closed(p);
}

static void check_lobby(const struct airy_wall_reply *r)
{
    assert_int_equal(r->n_walls, 2);
    const struct airy_wall_state *w = &r->walls[0];
    assert_string_equal(w->name, "lobby");
    assert_true(w->width == 64 && w->height == 16 && w->leds == 1024 && w->rate == 59.94);
    assert_string_equal(w->source, "live");
    assert_true(w->fps == 60 && w->frames_per_second == 30 && w->ticks == 11 && w->ticks_missed == 12);
    assert_true(w->frames == 13 && w->shown == 14 && w->dropped == 15 && w->exposure == -2 && w->realtime);
    assert_true(w->late_ms.p50 == .25 && w->late_ms.p99 == .5 && w->late_ms.max == 4);
    assert_true(w->skew_ms.p50 == 0 && w->skew_ms.max == 0); // did not come
    assert_int_equal(w->n_boards, 2);
    const struct airy_wall_board *b = &w->boards[0];
    assert_string_equal(b->name, "left");
    assert_string_equal(b->kind, "fadecandy");
    assert_string_equal(b->serial, "SERIAL");
    assert_string_equal(b->state, "ready");
    assert_string_equal(b->path, "1-4.2");
    assert_true(b->sent == 1 && b->dropped == 2 && b->missed == 3 && b->stalls == 4 && b->timeouts == 5);
    assert_true(b->errors == 6 && b->losses == 7 && b->rendered == 8 && b->received == 9);
    assert_true(b->latency_ms.max == 9 && b->amps == 1.5 && b->amps_wanted == 2.5);
    assert_string_equal(w->boards[1].problem, "unplugged");
    assert_string_equal(w->boards[1].name, "");
    assert_int_equal(w->n_supplies, 1);
    assert_string_equal(w->supplies[0].name, "psu");
    assert_true(w->supplies[0].amps == 3 && w->supplies[0].amps_wanted == 4 && w->supplies[0].amps_limit == 5);
    assert_int_equal(r->walls[1].n_boards, 0);
    assert_int_equal(r->n_controllers, 1);
    assert_string_equal(r->controllers[0].kind, "gud");
    assert_string_equal(r->controllers[0].serial, "G1");
    assert_string_equal(r->controllers[0].path, "2-1");
    assert_string_equal(r->controllers[0].wall, "lobby");
    assert_string_equal(r->controllers[0].problem, "twice");
    assert_string_equal(r->usb, "no USB here");
    assert_null(r->preview);
}

static void questions_and_answers_are_whole(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_lists);
    uint64_t frame = submit_text(a, "frame");
    struct airy_wall_reply *r = ask(a, &(struct airy_wall_request){ .action = AIRY_WALL_LIST });
    check_lobby(r);
    airy_wall_reply_free(r);
    airy_wall_reply_free(NULL);
    expect_text(a, frame, "meanwhile"); // was not lost
    struct airy_error e = expect_refusal(
        a, &(struct airy_wall_request){ .action = AIRY_WALL_OPEN, .definition = "name: x", .calibration = "d1", .keep = true },
        10000);
    assert_string_equal(e.symbol, "WALL");
    assert_int_equal(e.code, 305);
    r = ask(a, &(struct airy_wall_request){
                   .action = AIRY_WALL_PATTERN, .name = "lobby", .pattern = "led", .board = "left", .led = 300, .level = .5 });
    assert_int_equal(r->n_walls, 0);
    assert_string_equal(r->usb, "");
    airy_wall_reply_free(r);
    e = expect_refusal(a, &(struct airy_wall_request){ .action = AIRY_WALL_CLOSE, .name = "lobby" }, -1);
    assert_string_equal(e.symbol, "NO_WALL");
    // Refused here, and nothing is sent.
    e = expect_refusal(a, &(struct airy_wall_request){ .action = (enum airy_wall_action)9 }, -1);
    assert_string_equal(e.field, "action");
    char *longest = calloc(1, 70001);
    assert_non_null(longest);
    memset(longest, '#', 70000);
    e = expect_refusal(a, &(struct airy_wall_request){ .action = AIRY_WALL_OPEN, .definition = longest }, -1);
    assert_string_equal(e.field, "definition");
    free(longest);
    assert_int_equal(airy_wait_any(a, 0, NULL, NULL, &e), -1); // a wall's answer is never waited for by others
    assert_int_equal(e.code, -ENOENT);
    close_peer(&p, a);
}

// ---- previews ------------------------------------------------------------------------------------------

static void send_preview(struct peer *p, uint64_t id, uint32_t width, uint32_t height, uint64_t said)
{
    Airy__WallState wall = AIRY__WALL_STATE__INIT, *walls[] = { &wall };
    Airy__Payload preview = AIRY__PAYLOAD__INIT;
    Airy__WallReply r = AIRY__WALL_REPLY__INIT;
    wall.width = width;
    wall.height = height;
    preview.kind = AIRY__PAYLOAD__KIND__INLINE;
    preview.size = said;
    r.walls = walls;
    r.n_walls = 1;
    r.preview = &preview;
    peer_send(p, WIRE_WALL_REPLY, id, &r.base);
}

static void send_bytes(struct peer *p, uint64_t id, const void *bytes, size_t n)
{
    must(conn_send(p->conn, WIRE_DATA, id, bytes, n, NULL, 0) == 0);
    peer_flush(p);
}

enum { SIDE = 512, PREVIEW_BYTES = SIDE * SIDE * 3 };
static uint8_t pixels[PREVIEW_BYTES];

static void script_previews(struct peer *p)
{
    Airy__Wall w;
    peer_welcome(p);
    uint64_t id = take_wall(p, &w);
    must(w.action == AIRY__WALL__ACTION__PREVIEW && !strcmp(w.name, "lobby"));
    send_bytes(p, id, pixels, 5);
    send_bytes(p, id, "", 0);
    send_bytes(p, id, pixels + 5, 700000);
    send_bytes(p, id, pixels + 700005, PREVIEW_BYTES - 700005);
    send_preview(p, id, SIDE, SIDE, PREVIEW_BYTES);
    // Sizes that contradict each other end the question, not the connection.
    static const struct { uint32_t width, height; uint64_t said; size_t came; } bad[] = {
        { 2, 1, 6, 5 }, { 2, 1, 5, 6 }, { 2, 2, 6, 6 }, { 0, 0, 0, 0 }, { 65536, 65536, 0, 0 }, { 1, 2, 7, 7 },
    };
    for (unsigned i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        id = take_wall(p, &w);
        send_bytes(p, id, pixels, bad[i].came);
        send_preview(p, id, bad[i].width, bad[i].height, bad[i].said);
    }
    id = take_wall(p, &w); // asked for the list, gets a preview
    send_preview(p, id, 2, 1, 6);
    id = take_wall(p, &w); // and the other way round
    peer_send(p, WIRE_WALL_REPLY, id, &(Airy__WallReply)AIRY__WALL_REPLY__INIT.base);
    id = take_wall(p, &w); // an error after some of the bytes
    send_bytes(p, id, pixels, 100);
    peer_fault(p, id, FAULT_NO_WALL, "name", "closed meanwhile");
    peer_until_closed(p);
}

static void previews_are_the_walls_pixels(void **state)
{
    (void)state;
    struct peer p = { 0 };
    fill(pixels, sizeof pixels, 4);
    struct airy *a = open_peer(&p, script_previews);
    const struct airy_wall_request q = { .action = AIRY_WALL_PREVIEW, .name = "lobby" };
    struct airy_wall_reply *r = ask(a, &q);
    assert_int_equal(r->walls[0].width, SIDE);
    assert_memory_equal(r->preview, pixels, PREVIEW_BYTES);
    airy_wall_reply_free(r);
    for (unsigned i = 0; i < 6; i++) {
        struct airy_error e = expect_refusal(a, &q, 10000);
        if (strcmp(e.field, "preview.size") != 0)
            fail_msg("case %u: %s: %s", i, e.field, e.text);
    }
    struct airy_error e = expect_refusal(a, &(struct airy_wall_request){ .action = AIRY_WALL_LIST }, 10000);
    assert_string_equal(e.field, "preview.kind");
    e = expect_refusal(a, &q, 10000);
    assert_string_equal(e.field, "preview.kind");
    e = expect_refusal(a, &q, 10000);
    assert_string_equal(e.symbol, "NO_WALL");
    assert_true(airy_fd(a) >= 0);
    close_peer(&p, a);
}

// ---- time-outs -------------------------------------------------------------------------------------------

static void script_slow(struct peer *p)
{
    Airy__Wall w;
    uint64_t late[3];
    peer_welcome(p);
    for (unsigned i = 0; i < 3; i++)
        late[i] = take_wall(p, &w);
    uint64_t frame = peer_bloom(p);
    peer_next(p, WIRE_DATA);
    send_lobby(p, late[1]);
    send_bytes(p, late[0], "abc", 3);
    send_preview(p, late[0], 1, 1, 3);
    peer_fault(p, late[2], FAULT_NO_WALL, "name", "gone");
    peer_result_text(p, frame, "after them");
    send_lobby(p, take_wall(p, &w));
    for (unsigned i = 0; i < 16; i++)
        take_wall(p, &w);
    peer_until_closed(p);
}

static void late_answers_are_passed_over(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_slow);
    const struct airy_wall_request q = { .action = AIRY_WALL_LIST };
    for (unsigned i = 0; i < 3; i++)
        assert_int_equal(expect_refusal(a, &q, 1).code, -ETIMEDOUT);
    uint64_t frame = submit_text(a, "frame");
    expect_text(a, frame, "after them");
    struct airy_wall_reply *r = ask(a, &q);
    check_lobby(r);
    airy_wall_reply_free(r);
    for (unsigned i = 0; i < 16; i++)
        assert_int_equal(expect_refusal(a, &q, 0).code, -ETIMEDOUT);
    assert_int_equal(expect_refusal(a, &q, 0).code, -EAGAIN); // a daemon that never answers is not asked for ever
    close_peer(&p, a);
}

// ---- frames for walls ------------------------------------------------------------------------------------

static Airy__Bloom *take_frame(struct peer *p, uint64_t *id)
{
    struct conn_message m = peer_next(p, WIRE_BLOOM);
    must(m.header.n_fds == 0);
    *id = m.header.id;
    return peer_body(p, &m, &airy__bloom__descriptor);
}

static void send_need(struct peer *p, uint64_t id)
{
    Airy__Region need = AIRY__REGION__INIT;
    Airy__Result r = AIRY__RESULT__INIT;
    need.x = -8;
    need.y = 2;
    need.width = 640;
    need.height = 360;
    r.need = &need;
    peer_send(p, WIRE_RESULT, id, &r.base);
}

static void script_frames(struct peer *p)
{
    uint64_t id;
    peer_welcome(p);
    Airy__Bloom *b = take_frame(p, &id);
    must(b->wall && !strcmp(b->wall->name, "lobby") && b->wall->present_ns == UINT64_C(1) << 62);
    must(b->wall->frame_width == 1920 && b->wall->frame_height == 1080 && b->wall->x == -4 && b->wall->y == 7);
    must(b->output && b->output->kind == AIRY__OUTPUT__KIND__WALL && !b->plan_only);
    peer_next(p, WIRE_DATA);
    send_need(p, id);
    b = take_frame(p, &id);
    must(b->wall && b->plan_only && !b->output);
    peer_next(p, WIRE_DATA);
    send_need(p, id);
    b = take_frame(p, &id); // the drive, not shown
    must(b->wall && b->output->kind == AIRY__OUTPUT__KIND__INLINE);
    peer_next(p, WIRE_DATA);
    peer_result_text(p, id, "drive");
    b = take_frame(p, &id);
    must(!b->wall);
    peer_next(p, WIRE_DATA);
    peer_result_text(p, id, "none");
    take_frame(p, &id); // shown, and yet with a memfd
    peer_next(p, WIRE_DATA);
    peer_result(p, id, AIRY__PAYLOAD__KIND__MEMFD, 0, 2, memfd_of("ok", 2, F_SEAL_SHRINK));
    peer_until_closed(p);
}

static struct airy_result *wait_result(struct airy *a, uint64_t id)
{
    struct airy_result *res = NULL;
    struct airy_error e = { .text = "" };
    if (airy_wait(a, id, 10000, &res, &e) != 1)
        fail_msg("%s: %s", e.field, e.text);
    return res;
}

static void frames_go_to_walls(void **state)
{
    (void)state;
    struct peer p = { 0 };
    struct airy *a = open_peer(&p, script_frames);
    struct airy_request r = inline_request("frame", 5);
    r.inline_output = false;
    r.show = true;
    r.wall = "lobby";
    r.present_ns = UINT64_C(1) << 62;
    r.frame_width = 1920, r.frame_height = 1080, r.frame_x = -4, r.frame_y = 7;
    struct airy_result *res = wait_result(a, submit(a, &r));
    assert_null(res->data);
    assert_int_equal(res->fd, -1);
    assert_true(res->has_need && res->need.x == -8 && res->need.y == 2);
    assert_true(res->need.width == 640 && res->need.height == 360);
    airy_result_free(res);
    r.plan_only = true;
    res = wait_result(a, submit(a, &r));
    assert_true(res->has_need && !res->data);
    airy_result_free(res);
    r = inline_request("frame", 5);
    r.wall = "lobby";
    expect_text(a, submit(a, &r), "drive");
    r.wall = NULL;
    res = wait_result(a, submit(a, &r));
    assert_false(res->has_need);
    airy_result_free(res);
    // Refused here.
    struct airy_error e = { .text = "" };
    uint64_t id;
    r.inline_output = false;
    r.show = true;
    assert_int_equal(airy_submit(a, &r, &id, &e), -1);
    assert_string_equal(e.field, "wall");
    r.wall = "lobby";
    r.inline_output = true;
    assert_int_equal(airy_submit(a, &r, &id, &e), -1);
    assert_string_equal(e.field, "show");
    r.inline_output = false;
    r.output_fd = 0;
    assert_int_equal(airy_submit(a, &r, &id, &e), -1);
    assert_string_equal(e.field, "show");
    r.output_fd = -1;
    assert_string_equal(expect_failure(a, submit(a, &r), "LOCAL").field, "output.kind");
    close_peer(&p, a);
}

static void a_daemon_without_walls_is_not_asked(void **state)
{
    (void)state;
    struct peer p = { .no_walls = true };
    struct airy *a = open_peer(&p, script_handshake);
    struct airy_request r = inline_request("frame", 5);
    struct airy_error e = expect_refusal(a, &(struct airy_wall_request){ .action = AIRY_WALL_LIST }, 10000);
    uint64_t id;
    assert_int_equal(e.code, -ENOTSUP);
    r.wall = "lobby";
    assert_int_equal(airy_submit(a, &r, &id, &e), -1);
    assert_int_equal(e.code, -ENOTSUP);
    assert_true(airy_fd(a) >= 0);
    close_peer(&p, a);
}

// ---- bad peers -------------------------------------------------------------------------------------------

static int breach; // set before the peer's thread starts

enum { REPLY_FOR_A_FRAME, REPLY_FOR_NOTHING, RESULT_FOR_A_WALL, DATA_UNASKED, TOO_MUCH_DATA, CANCELLED, TWICE, DIES, BREACHES };

static void script_breach(struct peer *p)
{
    Airy__Wall w;
    Airy__WallReply empty = AIRY__WALL_REPLY__INIT;
    peer_welcome(p);
    uint64_t id = breach == REPLY_FOR_A_FRAME ? peer_bloom(p) : take_wall(p, &w);
    switch (breach) {
    case REPLY_FOR_NOTHING: peer_send(p, WIRE_WALL_REPLY, id + 1, &empty.base); break;
    case RESULT_FOR_A_WALL: peer_result(p, id, AIRY__PAYLOAD__KIND__NONE, 0, 0, -1); break;
    case DATA_UNASKED: send_bytes(p, id, "x", 1); break;
    case TOO_MUCH_DATA:
        for (unsigned i = 0; i < 4; i++) {
            must(conn_send(p->conn, WIRE_DATA, id, pixels, sizeof pixels, NULL, 0) == 0);
            must(conn_send(p->conn, WIRE_DATA, id, pixels, sizeof pixels, NULL, 0) == 0);
        }
        conn_flush(p->conn);
        break;
    case CANCELLED: peer_send(p, WIRE_CANCELLED, id, NULL); break;
    case DIES: return;
    case TWICE: peer_send(p, WIRE_WALL_REPLY, id, &empty.base); // fallthrough
    default: peer_send(p, WIRE_WALL_REPLY, id, &empty.base); break;
    }
    struct conn_message m;
    while (conn_read(p->conn, 1 << 20) >= 0) { // until the client closes, whatever it leaves unread
        while (conn_next(p->conn, &m, NULL) == 1)
            ;
        conn_flush(p->conn);
        wait_readable(p, 10);
    }
}

static void breaches_lose_the_connection(void **state)
{
    (void)state;
    for (breach = 0; breach < BREACHES; breach++) {
        struct peer p = { 0 };
        struct airy *a = open_peer(&p, script_breach);
        struct airy_error e = { .text = "" };
        struct airy_wall_request q = { .action = breach == TOO_MUCH_DATA ? AIRY_WALL_PREVIEW : AIRY_WALL_LIST };
        struct airy_wall_reply *r = NULL;
        if (breach == REPLY_FOR_A_FRAME)
            assert_int_equal(airy_wait(a, submit_text(a, "frame"), 10000, NULL, &e), -1);
        else if (airy_wall(a, &q, 10000, &r, &e) == 0 && breach == TWICE)
            for (unsigned i = 0; i < 10000 && airy_pump(a, &e) == 0; i++) // the second may have come with the first
                usleep(1000);
        airy_wall_reply_free(r);
        assert_string_equal(e.symbol, "LOCAL");
        if (!e.text[0] || airy_fd(a) != -1)
            fail_msg("breach %d: \"%s\", descriptor %d", breach, e.text, airy_fd(a));
        e = expect_refusal(a, &q, 10000);
        assert_string_equal(e.symbol, "LOCAL");
        close_peer(&p, a);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(questions_and_answers_are_whole),
        cmocka_unit_test(previews_are_the_walls_pixels),
        cmocka_unit_test(late_answers_are_passed_over),
        cmocka_unit_test(frames_go_to_walls),
        cmocka_unit_test(a_daemon_without_walls_is_not_asked),
        cmocka_unit_test(breaches_lose_the_connection),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
