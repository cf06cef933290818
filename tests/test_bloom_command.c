// SPDX-License-Identifier: Apache-2.0
// test_bloom_command.c - airy bloom ($AIRY, or build/airy) against scripted daemons on a real socket: what its requests say, and what
// becomes of the others when one frame kills every daemon that has it.
#include "airy_peer.h"

#include <fcntl.h>
#include <poll.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

enum { FRAMES = 5, POISON = 3, WAIT_MS = 100000 };

static char folder[64], said[32768];
static int listener;

struct command {
    pid_t pid;
    int out_fd;
};

static void path_of(char *out, size_t size, const char *name) { snprintf(out, size, "%s/%s", folder, name); }

static void file_write(const char *name, const char *text)
{
    char path[96];
    path_of(path, sizeof(path), name);
    int fd = open(path, O_CREAT | O_WRONLY | O_TRUNC | O_CLOEXEC, 0600);
    assert_true(fd >= 0);
    assert_int_equal(write(fd, text, strlen(text)), strlen(text));
    close(fd);
}

static void command_begin(struct command *c, const char *const *args)
{
    const char *airy = getenv("AIRY"), *argv[24] = { airy ? airy : "build/airy", "bloom", "--json", "--socket" };
    char path[96];
    path_of(path, sizeof(path), "s");
    unsigned n = 4;
    for (argv[n++] = path; *args; args++)
        argv[n++] = *args;
    int ends[2];
    assert_int_equal(pipe2(ends, O_CLOEXEC), 0);
    c->pid = fork();
    assert_true(c->pid >= 0);
    if (c->pid == 0) {
        char program[4096];
        if (realpath(argv[0], program) && chdir(folder) == 0 && dup2(ends[1], 1) >= 0 && dup2(ends[1], 2) >= 0)
            execv(program, (char **)argv);
        _exit(126);
    }
    close(ends[1]);
    c->out_fd = ends[0];
}

static int command_end(struct command *c)
{
    int status;
    size_t n = 0;
    ssize_t got;
    while (n < sizeof(said) - 1 && (got = read(c->out_fd, said + n, sizeof(said) - 1 - n)) > 0)
        n += (size_t)got;
    said[n] = '\0';
    close(c->out_fd);
    assert_int_equal(waitpid(c->pid, &status, 0), c->pid);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

// The command's next connection, welcomed; false: it has ended, and makes none.
static bool peer_accept(struct peer *p, const struct command *c)
{
    *p = (struct peer){ .credit_bytes = 1 << 20, .max_requests = 64 };
    struct pollfd w[2] = { { .fd = listener, .events = POLLIN }, { .fd = c->out_fd } }; // POLLHUP
    assert_true(poll(w, 2, WAIT_MS) > 0);
    if (!(w[0].revents & POLLIN))
        return false;
    int fd = accept4(listener, NULL, NULL, SOCK_CLOEXEC);
    assert_true(fd >= 0);
    assert_int_equal(conn_create(&p->conn, fd, WIRE_DAEMON), 0);
    peer_welcome(p);
    return true;
}

static void peer_end(struct peer *p)
{
    conn_destroy(p->conn);
    body_arena_finish(&p->arena);
}

static unsigned count_of(const char *text)
{
    unsigned n = 0;
    for (const char *at = said; (at = strstr(at, text)); at++)
        n++;
    return n;
}

static void priority_and_deadline_are_sent(void **state)
{
    (void)state;
    struct command c;
    struct peer p;
    file_write("in.exr", "frame");
    command_begin(&c, (const char *const[]){ "in.exr", "out.exr", "--priority", "-3", "--deadline", "1.5m", NULL });
    assert_true(peer_accept(&p, &c));
    struct conn_message m = peer_next(&p, WIRE_BLOOM);
    Airy__Bloom *b = peer_body(&p, &m, &airy__bloom__descriptor);
    assert_int_equal(b->priority, -3);
    // Counted from the submit on, which was just now: a slow machine takes something off.
    assert_true(b->deadline_ms <= 90000 && b->deadline_ms > 30000);
    close(m.fds[0]);
    peer_fault(&p, m.header.id, FAULT_DEADLINE, "deadline_ms", "it waited too long");
    peer_until_closed(&p); // and is not asked again
    peer_end(&p);
    assert_int_equal(command_end(&c), 5);
    assert_int_equal(count_of("\"symbol\":\"DEADLINE\""), 1);
    assert_non_null(strstr(said, "\"exit_status\":5"));
}

static void wrong_times_and_numbers_are_refused(void **state)
{
    (void)state;
    static const char *const wrong[][2] = { { "--priority", "11" },   { "--priority", "-11" }, { "--priority", "high" },
                                            { "--priority", "" },     { "--deadline", "0" },   { "--deadline", "-1s" },
                                            { "--deadline", "5 days" }, { "--deadline", "nan" }, { "--deadline", "1200h" },
                                            { "--deadline", "0.5ms" } };
    for (unsigned i = 0; i < sizeof(wrong) / sizeof(wrong[0]); i++) {
        struct command c;
        command_begin(&c, (const char *const[]){ "in.exr", "out.exr", wrong[i][0], wrong[i][1], NULL });
        assert_int_equal(command_end(&c), 2);
        assert_non_null(strstr(said, "expected"));
        assert_non_null(strstr(said, wrong[i][0]));
    }
}

// BLOOMs until the client waits for an end. False: it has closed. *poison: one of them is the bad one; the others get their ends.
static bool serve_some(struct peer *p, bool *poison)
{
    uint64_t ids[FRAMES];
    unsigned n = 0;
    struct conn_message m;
    *poison = false;
    for (;;) {
        if (conn_next(p->conn, &m, NULL) == 1) {
            char text[16] = "";
            assert_int_equal(m.header.type, WIRE_BLOOM);
            assert_true(m.header.n_fds == 1 && n < FRAMES && pread(m.fds[0], text, sizeof(text) - 1, 0) > 0);
            *poison |= strcmp(text, "poison") == 0;
            ids[n++] = m.header.id;
            close(m.fds[0]);
            continue;
        }
        if (wait_readable(p, n ? 300 : WAIT_MS) < 1)
            break;
        if (conn_read(p->conn, 1 << 20) < 0)
            return false;
    }
    assert_true(n > 0);
    for (unsigned i = 0; i < n && !*poison; i++)
        peer_result(p, ids[i], AIRY__PAYLOAD__KIND__MEMFD, 0, 7, memfd_of("bloomed", 7, F_SEAL_SHRINK));
    return true;
}

static void a_frame_that_kills_daemons_costs_one(void **state)
{
    (void)state;
    struct command c;
    struct peer p;
    unsigned deaths = 0;
    char name[32], path[96];
    for (unsigned i = 1; i <= FRAMES; i++) {
        snprintf(name, sizeof(name), "f.%04u.exr", i);
        file_write(name, i == POISON ? "poison" : "frame");
    }
    command_begin(&c, (const char *const[]){ "f.####.exr", "-o", "o.####.exr", "-f", "1-5", "-j", "4", "-q", NULL });
    while (peer_accept(&p, &c)) {
        bool poison = false;
        while (!poison && serve_some(&p, &poison))
            ;
        deaths += poison;
        peer_end(&p);
    }
    assert_int_equal(command_end(&c), 5);
    assert_int_equal(deaths, 3);
    assert_int_equal(count_of("\"status\":\"done\""), FRAMES - 1);
    assert_int_equal(count_of("\"status\":\"failed\""), 1);
    for (unsigned i = 1; i <= FRAMES; i++) {
        snprintf(name, sizeof(name), "o.%04u.exr", i);
        path_of(path, sizeof(path), name);
        assert_int_equal(access(path, F_OK), i == POISON ? -1 : 0);
    }
}

static int begin_all(void **state)
{
    (void)state;
    struct sockaddr_un address = { .sun_family = AF_UNIX };
    strcpy(folder, "/tmp/test_bloom_XXXXXX");
    if (!mkdtemp(folder))
        return -1;
    snprintf(address.sun_path, sizeof(address.sun_path), "%.60s/s", folder);
    listener = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    return bind(listener, (struct sockaddr *)&address, sizeof(address)) || listen(listener, 4);
}

static int end_all(void **state)
{
    (void)state;
    char command[96];
    snprintf(command, sizeof(command), "rm -rf %s", folder);
    close(listener);
    return system(command);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(priority_and_deadline_are_sent),
        cmocka_unit_test(wrong_times_and_numbers_are_refused),
        cmocka_unit_test(a_frame_that_kills_daemons_costs_one),
    };
    return cmocka_run_group_tests(tests, begin_all, end_all);
}
