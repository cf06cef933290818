// SPDX-License-Identifier: Apache-2.0
// test_libairy_retry.c - libairy when daemons go away: peers behind a real socket, each connection by its script. Every request ends
// exactly once; what may be sent again is, under the same id.
#include "airy_peer.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <poll.h>
#include <stdatomic.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

// Accepts one connection after the other, the n-th (from 0) for script(p, n), until it is stopped.
struct stand {
    char folder[32], path[64];
    int listener;
    unsigned fds_before;
    atomic_uint served;
    atomic_bool stop;
    void (*script)(struct stand *s, struct peer *p, unsigned n);
    uint64_t first_credit, next_credit; // 0: plenty
    bool next_no_walls;
    uint32_t deadline_ms[2];
    pthread_t thread;
};

static void *stand_main(void *arg)
{
    struct stand *s = arg;
    while (!s->stop) {
        struct pollfd w = { .fd = s->listener, .events = POLLIN };
        if (poll(&w, 1, 20) < 1)
            continue;
        unsigned n = s->served;
        uint64_t credit = n ? s->next_credit : s->first_credit;
        struct peer p = { .credit_bytes = credit ? credit : 2 * BIG_BYTES, .max_requests = 64, .no_walls = n && s->next_no_walls };
        int fd = accept4(s->listener, NULL, NULL, SOCK_CLOEXEC);
        must(fd >= 0 && conn_create(&p.conn, fd, WIRE_DAEMON) == 0);
        s->served = n + 1;
        s->script(s, &p, n);
        conn_destroy(p.conn);
        body_arena_finish(&p.arena);
    }
    return NULL;
}

static void stand_listen(struct stand *s)
{
    struct sockaddr_un address = { .sun_family = AF_UNIX };
    snprintf(address.sun_path, sizeof(address.sun_path), "%s", s->path);
    s->listener = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_true(s->listener >= 0);
    assert_int_equal(bind(s->listener, (struct sockaddr *)&address, sizeof(address)), 0);
    assert_int_equal(listen(s->listener, 4), 0);
    s->stop = false;
    assert_int_equal(pthread_create(&s->thread, NULL, stand_main, s), 0);
}

// Nobody listens from then on.
static void stand_leave(struct stand *s)
{
    s->stop = true;
    pthread_join(s->thread, NULL);
    close(s->listener);
    unlink(s->path);
}

static struct airy *stand_begin(struct stand *s, void (*script)(struct stand *, struct peer *, unsigned))
{
    s->fds_before = count_fds();
    strcpy(s->folder, "/tmp/test_libairy_XXXXXX");
    assert_non_null(mkdtemp(s->folder));
    snprintf(s->path, sizeof(s->path), "%s/s", s->folder);
    s->script = script;
    stand_listen(s);
    struct airy *a = NULL;
    struct airy_error e = { .text = "" };
    if (airy_connect(&a, s->path, &e) < 0)
        fail_msg("connect: %s", e.text);
    assert_int_equal(airy_serial(a), 1);
    return a;
}

static void stand_end(struct stand *s, struct airy *a)
{
    airy_close(a);
    stand_leave(s);
    rmdir(s->folder);
    assert_int_equal(count_fds(), s->fds_before);
}

// The next message whatever it is: 1; 0: none in timeout_ms; -1: the client has closed.
static int next_of_any(struct peer *p, struct conn_message *m, int timeout_ms)
{
    for (;;) {
        if (conn_next(p->conn, m, NULL) == 1)
            return 1;
        if (wait_readable(p, timeout_ms) < 1)
            return 0;
        if (conn_read(p->conn, 1 << 20) < 0)
            return -1;
    }
}

struct asked {
    uint64_t id;
    char text[64];
};

// BLOOMs with inline texts, until none comes for `quiet_ms` (at least one). Their number; 0: the client has closed.
static unsigned take_texts(struct peer *p, struct asked *asked, unsigned most, int quiet_ms)
{
    unsigned n = 0;
    struct conn_message m;
    for (;;) {
        int got = next_of_any(p, &m, n ? quiet_ms : 20000);
        if (got < 0)
            return 0;
        if (got == 0)
            return n;
        if (m.header.type == WIRE_CANCEL)
            continue;
        must(m.header.type == WIRE_BLOOM && n < most);
        asked[n].id = m.header.id;
        m = peer_next(p, WIRE_DATA);
        must(m.header.id == asked[n].id && m.header.body_bytes < sizeof(asked[n].text));
        memcpy(asked[n].text, m.body, m.header.body_bytes);
        asked[n++].text[m.header.body_bytes] = 0;
    }
}

static void answer(struct peer *p, const struct asked *a)
{
    char text[80];
    snprintf(text, sizeof(text), "good %s", a->text);
    peer_result_text(p, a->id, text);
}

static void serve_texts(struct peer *p)
{
    struct asked asked[64];
    unsigned n;
    while ((n = take_texts(p, asked, 64, 0)) > 0)
        for (unsigned i = 0; i < n; i++)
            answer(p, &asked[i]);
}

// ---- sent again -----------------------------------------------------------------------------------

static void script_dies_once(struct stand *s, struct peer *p, unsigned n)
{
    (void)s;
    struct asked asked[8];
    peer_welcome(p);
    if (n == 0) {
        while (take_texts(p, asked, 8, 200) < 3)
            ;
        must(conn_send(p->conn, WIRE_DATA, asked[1].id, "half of an", 10, NULL, 0) == 0); // to be forgotten
        peer_flush(p);
        return;
    }
    serve_texts(p);
}

static void requests_come_through_a_death(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_dies_once);
    uint64_t ids[3] = { submit_text(a, "one"), submit_text(a, "two"), submit_text(a, "three") };
    expect_text(a, ids[1], "good two");
    expect_text(a, ids[2], "good three");
    expect_text(a, ids[0], "good one");
    assert_int_equal(airy_serial(a), 2);
    struct airy_error e;
    assert_int_equal(airy_wait_any(a, 0, NULL, NULL, &e), -1); // each once
    assert_int_equal(e.code, -ENOENT);
    expect_text(a, submit_text(a, "four"), "good four");
    stand_end(&s, a);
}

// Asleep: nothing is open when it goes, and nothing is done about it until something is.
static void script_dies_at_leisure(struct stand *s, struct peer *p, unsigned n)
{
    (void)s;
    peer_welcome(p);
    if (n)
        serve_texts(p);
}

static void an_idle_connection_comes_back_when_it_is_needed(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_dies_at_leisure);
    struct airy_error e;
    struct pollfd w = { .fd = airy_fd(a), .events = airy_events(a) };
    assert_int_equal(poll(&w, 1, 20000), 1); // the end is there
    assert_int_equal(airy_pump(a, &e), 0);
    assert_int_equal(poll(&w, 1, 50), 0);    // and nothing more to do
    assert_int_equal(airy_serial(a), 1);
    expect_text(a, submit_text(a, "again"), "good again");
    assert_int_equal(airy_serial(a), 2);
    stand_end(&s, a);
}

static void script_descriptors(struct stand *s, struct peer *p, unsigned n)
{
    peer_welcome(p);
    char text[8] = "";
    struct conn_message m = peer_next(p, WIRE_BLOOM);
    Airy__Bloom *b = peer_body(p, &m, &airy__bloom__descriptor);
    must(m.header.n_fds == 2 && b->input->size == 5 && b->output->size == 8 && b->n_params == 1);
    must(pread(m.fds[0], text, 5, 0) == 5 && !strcmp(text, "frame"));
    must(pwrite(m.fds[1], n ? "wholewho" : "hal", n ? 8 : 3, 0) > 0);
    s->deadline_ms[n] = b->deadline_ms;
    for (unsigned i = 0; i < m.header.n_fds; i++)
        close(m.fds[i]);
    if (n == 0) {
        usleep(50000);
        return;
    }
    peer_result(p, m.header.id, AIRY__PAYLOAD__KIND__NONE, 0, 8, -1);
    peer_until_closed(p);
}

static void descriptors_are_kept_and_deadlines_go_on(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_descriptors);
    struct airy_request r = AIRY_REQUEST_INIT;
    struct airy_error e = { .text = "" };
    void *out;
    r.input_fd = memfd_of("frame", 5, F_SEAL_SHRINK);
    r.output_fd = airy_memfd(8, &out, &e);
    r.output_size = 8;
    r.deadline_ms = 60000;
    assert_int_equal(airy_request_param(&r, "knee", "1", &e), 0);
    uint64_t id = submit(a, &r);
    close(r.input_fd);
    close(r.output_fd);
    struct airy_result *res = NULL;
    if (airy_wait(a, id, 20000, &res, &e) != 1)
        fail_msg("%s", e.text);
    assert_memory_equal(out, "wholewho", 8);
    airy_result_free(res);
    munmap(out, 8);
    assert_true(s.deadline_ms[0] <= 60000 && s.deadline_ms[0] > 0);
    assert_true(s.deadline_ms[1] < s.deadline_ms[0] && s.deadline_ms[1] > 0);
    stand_end(&s, a);
}

static void script_asset(struct stand *s, struct peer *p, unsigned n)
{
    (void)s;
    peer_welcome(p);
    uint64_t id = peer_next(p, WIRE_ASSET).header.id;
    struct conn_message m = peer_next(p, WIRE_DATA);
    must(m.header.body_bytes == 5 && !memcmp(m.body, "image", 5));
    if (n == 0)
        return;
    Airy__AssetKept kept = AIRY__ASSET_KEPT__INIT;
    kept.digest = (char *)"00112233445566778899aabbccddeeff";
    kept.width = 7;
    peer_send(p, WIRE_ASSET_KEPT, id, &kept.base);
    peer_until_closed(p);
}

static void an_asset_comes_through(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_asset);
    struct airy_asset kept;
    struct airy_error e = { .text = "" };
    if (airy_asset(a, -1, "image", 5, &kept, &e) < 0)
        fail_msg("%s", e.text);
    assert_string_equal(kept.digest, "00112233445566778899aabbccddeeff");
    assert_int_equal(kept.width, 7);
    stand_end(&s, a);
}

// ---- bounds ---------------------------------------------------------------------------------------

static void script_dies_always(struct stand *s, struct peer *p, unsigned n)
{
    (void)s, (void)n;
    struct asked asked;
    peer_welcome(p);
    take_texts(p, &asked, 1, 0);
}

static void a_request_is_tried_three_times(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_dies_always);
    struct airy_error e = expect_failure(a, submit_text(a, "x"), "LOCAL");
    assert_true(e.retryable);
    assert_true(e.code == -EPIPE || e.code == -ECONNRESET);
    assert_non_null(strstr(e.text, "3 daemons went away while they had this request"));
    assert_int_equal(s.served, 3);
    stand_end(&s, a);
}

// Dies of "poison", whatever is in flight beside it.
static void script_poison(struct stand *s, struct peer *p, unsigned n)
{
    (void)s, (void)n;
    struct asked asked[16];
    unsigned count;
    peer_welcome(p);
    while ((count = take_texts(p, asked, 16, 100)) > 0) {
        for (unsigned i = 0; i < count; i++)
            if (!strcmp(asked[i].text, "poison"))
                return;
        for (unsigned i = 0; i < count; i++)
            answer(p, &asked[i]);
    }
}

static void a_poisonous_frame_costs_one_frame(void **state)
{
    (void)state;
    enum { FRAMES = 9, BAD = 4 };
    static const char *const texts[FRAMES] = { "0", "1", "2", "3", "poison", "5", "6", "7", "8" };
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_poison);
    uint64_t ids[FRAMES];
    for (unsigned i = 0; i < FRAMES; i++)
        ids[i] = submit_text(a, texts[i]);
    for (unsigned i = 0; i < FRAMES; i++) {
        char text[32];
        snprintf(text, sizeof(text), "good %s", texts[i]);
        if (i != BAD)
            expect_text(a, ids[i], text);
    }
    struct airy_error e = expect_failure(a, ids[BAD], "LOCAL");
    assert_true(e.retryable);
    assert_non_null(strstr(e.text, "went away while they had this request"));
    assert_true(s.served >= 3 && s.served <= 4); // its three, and one for the others
    expect_text(a, submit_text(a, "after"), "good after");
    stand_end(&s, a);
}

static void script_silent_later(struct stand *s, struct peer *p, unsigned n)
{
    (void)s;
    if (n == 0) {
        peer_welcome(p);
        struct asked asked;
        take_texts(p, &asked, 1, 0);
    } else if (n == 1) {
        struct conn_message m;
        while (next_of_any(p, &m, 20000) == 1)
            ; // a HELLO that is not answered, until the client has had enough
    } else {
        peer_welcome(p);
        serve_texts(p);
    }
}

static void the_time_without_a_daemon_is_bounded(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_silent_later);
    airy_set_reconnect(a, 300);
    struct airy_error e = expect_failure(a, submit_text(a, "x"), "LOCAL");
    assert_true(e.retryable);
    assert_non_null(strstr(e.text, "none has answered for 300 ms"));
    assert_non_null(strstr(e.text, "no answer to HELLO"));
    assert_true(airy_fd(a) >= 0);
    stand_leave(&s);
    e = expect_failure(a, submit_text(a, "y"), "LOCAL"); // nobody listens
    assert_true(e.retryable);
    assert_non_null(strstr(e.text, s.path));
    struct airy_status status;
    assert_int_equal(airy_status(a, &status, 20000, &e), -1);
    assert_true(e.retryable);
    assert_int_equal(airy_status(a, &status, 20, &e), -1); // its own time is shorter
    assert_int_equal(e.code, -ETIMEDOUT);
    airy_set_reconnect(a, 30000);
    uint64_t id = submit_text(a, "z"); // while nobody listens
    assert_int_equal(airy_wait(a, id, 50, NULL, &e), 0);
    stand_listen(&s);
    expect_text(a, id, "good z");
    assert_int_equal(airy_serial(a), 2);
    stand_end(&s, a);
}

// Every daemon stops, politely, before it does a thing.
static void script_stops_always(struct stand *s, struct peer *p, unsigned n)
{
    (void)s, (void)n;
    struct asked asked;
    peer_welcome(p);
    if (take_texts(p, &asked, 1, 0)) {
        peer_fault(p, asked.id, FAULT_SHUTTING_DOWN, "", "the daemon is stopping");
        peer_until_closed(p);
    }
}

static void daemons_that_always_stop_are_given_up(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_stops_always);
    airy_set_reconnect(a, 400);
    struct airy_error e = expect_failure(a, submit_text(a, "x"), "LOCAL");
    assert_true(e.retryable);
    assert_non_null(strstr(e.text, "the daemon is stopping"));
    assert_true(s.served >= 2);
    stand_end(&s, a);
}

static void switched_off_it_is_lost_for_good(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_dies_always);
    airy_set_reconnect(a, 0);
    struct airy_error e = expect_failure(a, submit_text(a, "x"), "LOCAL");
    assert_true(e.retryable && (e.code == -EPIPE || e.code == -ECONNRESET));
    assert_int_equal(airy_fd(a), -1);
    assert_int_equal(airy_pump(a, &e), -1);
    struct airy_request r = inline_request("y", 1);
    uint64_t id;
    assert_int_equal(airy_submit(a, &r, &id, &e), -1);
    assert_int_equal(s.served, 1);
    stand_end(&s, a);

    struct stand t = { 0 };
    a = stand_begin(&t, script_silent_later);
    id = submit_text(a, "x");
    while (t.served < 2)
        assert_int_equal(airy_wait(a, id, 10, NULL, &e), 0);
    airy_set_reconnect(a, 0); // in the midst of it
    e = expect_failure(a, id, "LOCAL");
    assert_int_equal(airy_fd(a), -1);
    stand_end(&t, a);
}

// ---- stopping -------------------------------------------------------------------------------------

static void script_stops(struct stand *s, struct peer *p, unsigned n)
{
    (void)s;
    struct asked asked[4];
    struct conn_message m;
    peer_welcome(p);
    if (n == 0) {
        must(take_texts(p, asked, 4, 200) == 2);
        peer_fault(p, asked[1].id, FAULT_SHUTTING_DOWN, "", "the daemon is stopping");
        must(next_of_any(p, &m, 200) == 0); // the other one is waited for, and nothing is sent
        answer(p, &asked[0]);
        must(next_of_any(p, &m, 20000) == -1);
    } else if (n == 1) {
        must(take_texts(p, asked, 4, 200) == 1 && !strcmp(asked[0].text, "b"));
        peer_fault(p, 0, FAULT_SHUTTING_DOWN, "", "the daemon is stopping"); // of the connection
    } else {
        serve_texts(p);
    }
}

static void a_daemon_that_stops_hands_over(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_stops);
    uint64_t first = submit_text(a, "a"), second = submit_text(a, "b");
    expect_text(a, second, "good b");
    expect_text(a, first, "good a");
    assert_int_equal(s.served, 3);
    stand_end(&s, a);
}

// ---- what is not sent again -----------------------------------------------------------------------

static void script_counts(struct stand *s, struct peer *p, unsigned n)
{
    (void)s;
    peer_welcome(p);
    for (unsigned i = 0; i < (n ? 1u : 4u); i++) {
        struct conn_message m = peer_next(p, n || i != 2 ? WIRE_BLOOM : WIRE_WALL);
        for (unsigned k = 0; k < m.header.n_fds; k++)
            close(m.fds[k]);
        if (i == 2) {
            Airy__WallReply reply = AIRY__WALL_REPLY__INIT;
            peer_send(p, WIRE_WALL_REPLY, m.header.id, &reply.base);
        }
        if (n)
            peer_result(p, m.header.id, AIRY__PAYLOAD__KIND__NONE, 0, 0, -1);
    }
    if (n)
        peer_until_closed(p);
}

static void what_is_not_idempotent_ends(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_counts);
    struct airy_error e = { .text = "" };
    struct airy_wall_reply *reply = NULL;
    void *map;
    int fd = airy_memfd(4096, &map, &e);
    struct airy_request shown = AIRY_REQUEST_INIT, place = AIRY_REQUEST_INIT, drive = AIRY_REQUEST_INIT;
    shown.input_fd = place.input_fd = drive.input_fd = place.output_fd = fd;
    shown.wall = drive.wall = "w";
    shown.show = true;
    place.size = 2049;
    place.output_offset = place.output_size = 2048;
    uint64_t ids[3];
    ids[0] = submit(a, &shown);
    ids[1] = submit(a, &place);
    if (airy_wall(a, &(struct airy_wall_request){ .action = AIRY_WALL_OPEN, .definition = "w" }, 20000, &reply, &e) < 0)
        fail_msg("%s", e.text);
    airy_wall_reply_free(reply);
    ids[2] = submit(a, &drive);
    for (unsigned i = 0; i < 3; i++) {
        e = expect_failure(a, ids[i], "LOCAL");
        assert_true(e.retryable);
        assert_non_null(strstr(e.text, i == 1 ? "where its input was" : "wall may have gone"));
    }
    place.size = 2048; // side by side is fine
    struct airy_result *res = NULL;
    if (airy_wait(a, submit(a, &place), 20000, &res, &e) != 1)
        fail_msg("%s", e.text);
    airy_result_free(res);
    munmap(map, 4096);
    close(fd);
    stand_end(&s, a);
}

static void script_smaller(struct stand *s, struct peer *p, unsigned n)
{
    (void)s;
    struct conn_message m;
    peer_welcome(p);
    if (n == 0) {
        for (unsigned i = 0; i < 3; i++) {
            peer_next(p, WIRE_BLOOM);
            peer_next(p, WIRE_DATA);
        }
        return;
    }
    struct asked asked;
    must(take_texts(p, &asked, 1, 0) == 1 && !strcmp(asked.text, "small"));
    answer(p, &asked);
    must(next_of_any(p, &m, 20000) == -1);
}

static void the_next_daemons_limits_hold(void **state)
{
    (void)state;
    struct stand s = { .first_credit = 1000, .next_credit = 50, .next_no_walls = true };
    struct airy *a = stand_begin(&s, script_smaller);
    char data[80] = "";
    struct airy_request large = inline_request(data, 80), wall = inline_request("wall", 4);
    struct airy_error e;
    wall.wall = "w";
    uint64_t ids[3] = { submit(a, &large), submit(a, &wall), submit_text(a, "small") };
    expect_text(a, ids[2], "good small");
    e = expect_failure(a, ids[0], "LOCAL");
    assert_int_equal(e.code, -EFBIG);
    assert_string_equal(e.field, "input.size");
    assert_non_null(strstr(e.text, "80 bytes, a connection may have 50"));
    e = expect_failure(a, ids[1], "LOCAL");
    assert_int_equal(e.code, -ENOTSUP);
    assert_string_equal(e.field, "wall");
    assert_int_equal(airy_limits(a)->credit_bytes, 50);
    stand_end(&s, a);
}

static void script_cancels(struct stand *s, struct peer *p, unsigned n)
{
    (void)s;
    struct conn_message m;
    peer_welcome(p);
    if (n == 0) {
        do
            must(next_of_any(p, &m, 20000) == 1);
        while (m.header.type != WIRE_CANCEL); // asked for, and never done
        return;
    }
    struct asked asked;
    must(take_texts(p, &asked, 1, 0) == 1);
    answer(p, &asked); // and goes again
}

static void a_cancel_holds(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_cancels);
    struct airy_error e;
    uint64_t first = submit_text(a, "a"), second = submit_text(a, "b");
    assert_int_equal(airy_cancel(a, second, &e), 0);
    e = expect_failure(a, second, "CANCELLED"); // by us: the daemon is no more
    expect_text(a, first, "good a");
    stand_leave(&s);
    uint64_t third = submit_text(a, "c"), fourth = submit_text(a, "d");
    assert_int_equal(airy_wait(a, third, 20, NULL, &e), 0);
    assert_int_equal(airy_cancel(a, third, &e), 0); // while there is no daemon
    e = expect_failure(a, third, "CANCELLED");
    assert_int_equal(e.code, -ECANCELED);
    stand_listen(&s);
    expect_text(a, fourth, "good d");
    stand_end(&s, a);
}

// ---- event loops, status ------------------------------------------------------------------------------

static void script_loop(struct stand *s, struct peer *p, unsigned n)
{
    (void)s;
    struct asked asked;
    peer_welcome(p);
    if (n < 2)
        take_texts(p, &asked, 1, 0);
    else
        serve_texts(p);
}

// The descriptor is given to epoll once, and only what epoll says is done.
static void an_event_loop_sees_it_through(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_loop);
    int fd = airy_fd(a), set = epoll_create1(EPOLL_CLOEXEC), n;
    struct epoll_event event = { .events = EPOLLIN };
    assert_int_equal(epoll_ctl(set, EPOLL_CTL_ADD, fd, &event), 0);
    uint64_t id = submit_text(a, "loop"), any = 0;
    struct airy_result *res = NULL;
    struct airy_error e = { .text = "" };
    while ((n = airy_wait_any(a, 0, &any, &res, &e)) == 0) {
        assert_int_equal(airy_fd(a), fd);
        assert_int_equal(airy_events(a), POLLIN);
        assert_int_equal(epoll_wait(set, &event, 1, 20000), 1);
        assert_int_equal(airy_pump(a, &e), 0);
    }
    if (n != 1)
        fail_msg("%s", e.text);
    assert_true(any == id && res->size == 9 && !memcmp(res->data, "good loop", 9));
    airy_result_free(res);
    close(set);
    assert_int_equal(airy_serial(a), 3);
    stand_end(&s, a);
}

static void script_status(struct stand *s, struct peer *p, unsigned n)
{
    (void)s;
    peer_welcome(p);
    struct conn_message m = peer_next(p, WIRE_STATUS);
    if (n == 0)
        return;
    Airy__StatusReply reply = AIRY__STATUS_REPLY__INIT;
    reply.done = 42;
    peer_send(p, WIRE_STATUS_REPLY, m.header.id, &reply.base);
    peer_until_closed(p);
}

static void status_fails_in_the_midst_and_comes_the_next_time(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_status);
    static struct airy_status status;
    struct airy_error e = { .text = "" };
    assert_int_equal(airy_status(a, &status, 20000, &e), -1);
    assert_true(e.retryable);
    if (airy_status(a, &status, 20000, &e) < 0)
        fail_msg("%s", e.text);
    assert_int_equal(status.done, 42);
    stand_end(&s, a);
}

// A daemon that ends a request that only the one before it had: nothing there is to be tried again.
static void script_breaks(struct stand *s, struct peer *p, unsigned n)
{
    (void)s;
    struct asked asked[2];
    peer_welcome(p);
    if (n == 0) {
        for (unsigned i = 0; i < 2; i++) {
            peer_bloom(p);
            peer_next(p, WIRE_DATA);
        }
        return;
    }
    must(take_texts(p, asked, 2, 100) == 1); // a suspect, alone
    peer_result_text(p, asked[0].id + 1, "early");
    peer_until_closed(p);
}

static void a_breach_is_final(void **state)
{
    (void)state;
    struct stand s = { 0 };
    struct airy *a = stand_begin(&s, script_breaks);
    uint64_t ids[2] = { submit_text(a, "a"), submit_text(a, "b") };
    assert_true(ids[1] == ids[0] + 1);
    for (unsigned i = 0; i < 2; i++) {
        struct airy_error e = expect_failure(a, ids[i], "LOCAL");
        assert_int_equal(e.code, -EPROTO);
    }
    assert_int_equal(airy_fd(a), -1);
    stand_end(&s, a);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(requests_come_through_a_death),
        cmocka_unit_test(an_idle_connection_comes_back_when_it_is_needed),
        cmocka_unit_test(descriptors_are_kept_and_deadlines_go_on),
        cmocka_unit_test(an_asset_comes_through),
        cmocka_unit_test(a_request_is_tried_three_times),
        cmocka_unit_test(a_poisonous_frame_costs_one_frame),
        cmocka_unit_test(the_time_without_a_daemon_is_bounded),
        cmocka_unit_test(daemons_that_always_stop_are_given_up),
        cmocka_unit_test(switched_off_it_is_lost_for_good),
        cmocka_unit_test(a_daemon_that_stops_hands_over),
        cmocka_unit_test(what_is_not_idempotent_ends),
        cmocka_unit_test(the_next_daemons_limits_hold),
        cmocka_unit_test(a_cancel_holds),
        cmocka_unit_test(an_event_loop_sees_it_through),
        cmocka_unit_test(status_fails_in_the_midst_and_comes_the_next_time),
        cmocka_unit_test(a_breach_is_final),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
