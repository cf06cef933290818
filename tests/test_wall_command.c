// SPDX-License-Identifier: Apache-2.0
// test_wall_command.c - the airy command ($AIRY, or build/airy) against a scripted daemon on a real socket: which questions it asks, which
// frames it sends for which time, and what its end is.
#include "airy_peer.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <poll.h>
#include <signal.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

enum { FPS = 20, FRAMES = 5 };
#define PERIOD_NS (1000000000 / FPS)

static char folder[64], socket_path[80], said[16384];

struct command {
    pid_t pid;
    int out_fd;
    struct peer p;
};

static void path_of(char *out, size_t size, const char *name) { snprintf(out, size, "%s/%s", folder, name); }

// airy wall ARGS --socket ..., with the peer at the other end of its connection.
static void begin(struct command *c, int listen_fd, const char *const *args)
{
    const char *airy = getenv("AIRY"), *argv[24] = { airy ? airy : "build/airy", "wall" };
    unsigned n = 2;
    int ends[2];
    *c = (struct command){ .p = { .credit_bytes = 1 << 20, .max_requests = 64 } };
    while (*args)
        argv[n++] = *args++;
    argv[n++] = "--socket";
    argv[n] = socket_path;
    assert_int_equal(pipe2(ends, O_CLOEXEC), 0);
    c->pid = fork();
    if (c->pid == 0) {
        dup2(ends[1], 1);
        dup2(ends[1], 2);
        execv(argv[0], (char **)argv);
        _exit(126);
    }
    close(ends[1]);
    c->out_fd = ends[0];
    struct pollfd w = { .fd = listen_fd, .events = POLLIN };
    assert_int_equal(poll(&w, 1, 10000), 1);
    int fd = accept4(listen_fd, NULL, NULL, SOCK_CLOEXEC);
    assert_true(fd >= 0);
    assert_int_equal(conn_create(&c->p.conn, fd, WIRE_DAEMON), 0);
    peer_welcome(&c->p);
}

// Its exit status, or 128 + its signal; `said` has its words.
static int end(struct command *c)
{
    int status;
    size_t n = 0;
    ssize_t got;
    conn_destroy(c->p.conn);
    body_arena_finish(&c->p.arena);
    while (n < sizeof said - 1 && (got = read(c->out_fd, said + n, sizeof said - 1 - n)) > 0)
        n += (size_t)got;
    said[n] = '\0';
    close(c->out_fd);
    assert_int_equal(waitpid(c->pid, &status, 0), c->pid);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

static int listen_here(void)
{
    struct sockaddr_un address = { .sun_family = AF_UNIX };
    snprintf(address.sun_path, sizeof address.sun_path, "%s", socket_path);
    unlink(socket_path);
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_true(fd >= 0);
    assert_int_equal(bind(fd, (struct sockaddr *)&address, sizeof address), 0);
    assert_int_equal(listen(fd, 4), 0);
    return fd;
}

// ---- what the daemon says --------------------------------------------------------------------------------

static void say_wall(struct peer *p, uint64_t id, const char *source)
{
    Airy__WallBoard board = AIRY__WALL_BOARD__INIT, *boards[] = { &board };
    Airy__WallState wall = AIRY__WALL_STATE__INIT, *walls[] = { &wall };
    Airy__WallReply r = AIRY__WALL_REPLY__INIT;
    board.name = (char *)"left";
    board.state = (char *)"absent";
    wall.name = (char *)"lobby";
    wall.source = (char *)source;
    wall.width = 4;
    wall.height = 2;
    wall.rate = 60;
    wall.boards = boards;
    wall.n_boards = 1;
    r.walls = walls;
    r.n_walls = 1;
    peer_send(p, WIRE_WALL_REPLY, id, &r.base);
}

static void say_done(struct peer *p, uint64_t id)
{
    peer_send(p, WIRE_RESULT, id, &(Airy__Result)AIRY__RESULT__INIT.base);
}

// The next message; its descriptors are closed. False: the client has closed.
static bool next(struct peer *p, struct conn_message *m)
{
    struct fault f;
    int n;
    while ((n = conn_next(p->conn, m, &f)) == 0) {
        must(wait_readable(p, 10000) == 1);
        if (conn_read(p->conn, 1 << 20) < 0)
            return false;
    }
    must(n == 1);
    for (unsigned i = 0; i < m->header.n_fds; i++)
        close(m->fds[i]);
    return true;
}

static Airy__Wall *expect_wall(struct peer *p, Airy__Wall__Action action, uint64_t *id)
{
    struct conn_message m;
    must(next(p, &m) && m.header.type == WIRE_WALL);
    *id = m.header.id;
    Airy__Wall *w = peer_body(p, &m, &airy__wall__descriptor);
    must(w->action == action);
    return w;
}

// ---- play --------------------------------------------------------------------------------------------------

struct seen {
    unsigned frames, closes;
    uint64_t first_ns, last_ns; // of those with a time
};

// Answers until the client goes. Every frame's time is a whole number of periods after the first's. The frame number `damaged` fails; after
// `interrupt` frames the command is interrupted.
static void serve_play(struct command *c, unsigned damaged, unsigned interrupt, struct seen *s)
{
    struct conn_message m;
    *s = (struct seen){ 0 };
    while (next(&c->p, &m)) {
        uint64_t id = m.header.id;
        if (m.header.type == WIRE_WALL) {
            Airy__Wall *w = peer_body(&c->p, &m, &airy__wall__descriptor);
            must(!strcmp(w->name, "lobby"));
            must(w->action == AIRY__WALL__ACTION__LIST || w->action == AIRY__WALL__ACTION__CLOSE);
            s->closes += w->action == AIRY__WALL__ACTION__CLOSE;
            say_wall(&c->p, id, "black");
            continue;
        }
        must(m.header.type == WIRE_BLOOM);
        Airy__Bloom *b = peer_body(&c->p, &m, &airy__bloom__descriptor);
        must(b->wall && !strcmp(b->wall->name, "lobby") && b->output->kind == AIRY__OUTPUT__KIND__WALL);
        must(b->n_params == 1 && !strcmp(b->params[0]->name, "intensity") && !strcmp(b->params[0]->text, "0.5"));
        uint64_t at = b->wall->present_ns, bytes = b->input->size;
        must((at == 0) == (s->frames == 0)); // the first one is shown when it can be
        if (at) {
            s->first_ns = s->first_ns ? s->first_ns : at;
            must(at >= s->first_ns && at > s->last_ns && (at - s->first_ns + 1) % PERIOD_NS <= 2);
            s->last_ns = at;
        }
        if (++s->frames == damaged)
            peer_fault(&c->p, id, FAULT_EXR_DAMAGED, "input", "no EXR");
        else
            say_done(&c->p, id);
        peer_credit(&c->p, bytes);
        if (s->frames == interrupt)
            kill(c->pid, SIGINT);
    }
}

static void a_sequence_is_played_in_time(void **state)
{
    (void)state;
    char pattern[100];
    struct command c;
    struct seen seen;
    uint64_t id;
    int fd = listen_here();
    path_of(pattern, sizeof pattern, "f.####.exr");
    begin(&c, fd, (const char *[]){ "play", pattern, "--wall", "lobby", "--fps", "20", "--intensity", "0.5", NULL });
    must(!strcmp(expect_wall(&c.p, AIRY__WALL__ACTION__LIST, &id)->name, "lobby"));
    say_wall(&c.p, id, "none");
    serve_play(&c, 0, 0, &seen);
    assert_int_equal(end(&c), 0);
    assert_true(seen.frames >= 1 && seen.frames <= FRAMES && seen.closes == 0); // another's wall stays
    assert_non_null(strstr(said, "left absent"));
    // Whatever was not sent was counted.
    char counted[40];
    snprintf(counted, sizeof counted, "skipped %u", FRAMES - seen.frames);
    if (!strstr(said, counted))
        fail_msg("%u frames were sent, and it said: %s", seen.frames, said);

    begin(&c, fd, (const char *[]){ "play", pattern, "--wall", "lobby", "--fps", "20", "--intensity", "0.5", NULL });
    expect_wall(&c.p, AIRY__WALL__ACTION__LIST, &id);
    say_wall(&c.p, id, "none");
    struct conn_message m; // the very first is damaged: the second starts the clock
    must(next(&c.p, &m) && m.header.type == WIRE_BLOOM);
    peer_fault(&c.p, m.header.id, FAULT_EXR_DAMAGED, "input", "no EXR");
    serve_play(&c, 0, 0, &seen);
    assert_int_equal(end(&c), 3);
    assert_non_null(strstr(said, "f.0001.exr: input: no EXR"));
    assert_non_null(strstr(said, "failed 1"));
    close(fd);
}

static void ctrl_c_closes_what_was_opened(void **state)
{
    (void)state;
    static const char text[] = "wall: lobby\nsize: [4, 2]\nrate: 60\npanels:\n  - {name: p, at: [0, 0], size: [4, 2]}\n"
                               "boards:\n  - {serial: NOTTHERE, kind: fadecandy, panels: [p]}\n";
    char pattern[100], definition[100];
    struct command c;
    struct seen seen;
    uint64_t id;
    int fd = listen_here();
    path_of(pattern, sizeof pattern, "f.####.exr");
    path_of(definition, sizeof definition, "wall.yaml");
    FILE *f = fopen(definition, "w");
    assert_non_null(f);
    fputs(text, f);
    fclose(f);
    begin(&c, fd, (const char *[]){ "play", pattern, "--wall", definition, "--fps", "20", "--loop", "--intensity", "0.5", NULL });
    expect_wall(&c.p, AIRY__WALL__ACTION__LIST, &id);
    peer_fault(&c.p, id, FAULT_NO_WALL, "name", "none is open");
    Airy__Wall *w = expect_wall(&c.p, AIRY__WALL__ACTION__OPEN, &id);
    must(!strcmp(w->definition, text) && !w->keep && !*w->calibration);
    say_wall(&c.p, id, "none");
    expect_wall(&c.p, AIRY__WALL__ACTION__LIST, &id);
    say_wall(&c.p, id, "none");
    serve_play(&c, 3, 2 * FRAMES, &seen); // through the second round
    assert_int_equal(end(&c), 3);         // of the frame that failed
    assert_true(seen.frames >= 2 * FRAMES);
    assert_int_equal(seen.closes, 1);
    close(fd);
}

// ---- others --------------------------------------------------------------------------------------------------

static void patterns_end_with_the_command(void **state)
{
    (void)state;
    struct command c;
    struct conn_message m;
    uint64_t id;
    unsigned ended = 0;
    int fd = listen_here();
    begin(&c, fd, (const char *[]){ "test", "lobby", "led", "--board", "left", "--led", "63", "--level", "1", "--seconds", "0.1", NULL });
    expect_wall(&c.p, AIRY__WALL__ACTION__LIST, &id);
    say_wall(&c.p, id, "none");
    Airy__Wall *w = expect_wall(&c.p, AIRY__WALL__ACTION__PATTERN, &id);
    must(!strcmp(w->pattern, "led") && !strcmp(w->board, "left") && w->led == 63 && w->level == 1);
    say_wall(&c.p, id, "pattern");
    while (next(&c.p, &m)) {
        w = peer_body(&c.p, &m, &airy__wall__descriptor);
        ended += w->action == AIRY__WALL__ACTION__PATTERN && !*w->pattern;
        say_wall(&c.p, m.header.id, "pattern");
    }
    assert_int_equal(end(&c), 0);
    assert_int_equal(ended, 1);
    assert_non_null(strstr(said, "0/1 boards ready; left absent"));
    close(fd);
}

static void a_share_is_what_the_plan_says(void **state)
{
    (void)state;
    struct command c;
    struct conn_message m;
    uint64_t id;
    int fd = listen_here();
    begin(&c, fd, (const char *[]){ "share", "lobby", "--frame", "640x100", NULL });
    expect_wall(&c.p, AIRY__WALL__ACTION__LIST, &id);
    say_wall(&c.p, id, "none");
    must(next(&c.p, &m) && m.header.type == WIRE_BLOOM);
    Airy__Bloom *b = peer_body(&c.p, &m, &airy__bloom__descriptor);
    must(b->plan_only && b->wall->frame_width == 640 && b->wall->frame_height == 100);
    must(b->raw && b->raw->width == 640 && b->raw->height == 100 && b->input->size == 640 * 100 * 6);
    Airy__Region need = AIRY__REGION__INIT;
    Airy__Result r = AIRY__RESULT__INIT;
    need.x = 300;
    need.width = 340;
    need.height = 100;
    r.need = &need;
    peer_send(&c.p, WIRE_RESULT, m.header.id, &r.base);
    must(!next(&c.p, &m));
    assert_int_equal(end(&c), 0);
    assert_non_null(strstr(said, "lobby needs x 300 to 639, y 0 to 99 of 640x100: 340x100+300+0, 53.1 % of the frame"));
    close(fd);
}

static void no_wall_says_what_to_do(void **state)
{
    (void)state;
    struct command c;
    uint64_t id;
    int fd = listen_here();
    begin(&c, fd, (const char *[]){ "stats", "loby", "--once", NULL });
    expect_wall(&c.p, AIRY__WALL__ACTION__LIST, &id);
    peer_fault(&c.p, id, FAULT_NO_WALL, "wall.name", "no wall \"loby\" is open");
    assert_int_equal(end(&c), 3);
    assert_non_null(strstr(said, "airy wall list"));
    begin(&c, fd, (const char *[]){ "stats", "lobby", "--once", "--json", NULL });
    expect_wall(&c.p, AIRY__WALL__ACTION__LIST, &id);
    say_wall(&c.p, id, "held");
    assert_int_equal(end(&c), 0);
    assert_non_null(strstr(said, "\"source\":\"held\""));
    close(fd);
}

static int folder_make(void **state)
{
    (void)state;
    char path[100];
    strcpy(folder, "/tmp/test_wall_command_XXXXXX");
    if (!mkdtemp(folder))
        return -1;
    path_of(socket_path, sizeof socket_path, "s");
    for (unsigned i = 1; i <= FRAMES; i++) {
        char name[20];
        snprintf(name, sizeof name, "f.%04u.exr", i);
        path_of(path, sizeof path, name);
        FILE *f = fopen(path, "w");
        if (!f || fputs("frame", f) < 0 || fclose(f))
            return -1;
    }
    signal(SIGPIPE, SIG_IGN);
    return 0;
}

static int folder_remove(void **state)
{
    (void)state;
    static const char *const names[] = { "s", "wall.yaml", "f.0001.exr", "f.0002.exr", "f.0003.exr", "f.0004.exr", "f.0005.exr" };
    for (unsigned i = 0; i < sizeof names / sizeof names[0]; i++) {
        char path[100];
        path_of(path, sizeof path, names[i]);
        unlink(path);
    }
    return rmdir(folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_sequence_is_played_in_time),
        cmocka_unit_test(ctrl_c_closes_what_was_opened),
        cmocka_unit_test(patterns_end_with_the_command),
        cmocka_unit_test(a_share_is_what_the_plan_says),
        cmocka_unit_test(no_wall_says_what_to_do),
    };
    return cmocka_run_group_tests(tests, folder_make, folder_remove);
}
