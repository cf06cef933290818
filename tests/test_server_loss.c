// SPDX-License-Identifier: Apache-2.0
// test_server_loss.c - the unmodified daemon loses its Vulkan device, once, again and for good, by layer_loss.c under it. Whatever
// the device does, each request ends exactly once: with the bytes that an undisturbed daemon gives, or with an error that may be
// tried again; and a daemon that has no device left says so by its exit status, and makes room for the next.
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include "daemon_fixture.h"
#include "layer_loss.h"

enum { CLIENTS = 3, EACH = 4, FRAMES = CLIENTS * EACH, WAYS = 3, WALL = WAYS, EXIT_LOST = 3, WAIT_MS = 120000, FOREVER = INT_MAX };

static struct layer_loss *loss;
static uint32_t start_submissions; // what each device is tested with
static struct picture picture;
static uint8_t *exr;
static size_t exr_bytes, raw_bytes;
static struct {
    uint8_t *bytes;
    size_t size;
} want[WAYS + 1];

// ---- a daemon whose words are read -------------------------------------------------------------------

static struct log {
    int fd, saved;
    size_t n;
    char text[1 << 16];
} said = { .fd = -1, .saved = -1 };

// From here on what is started writes to said.fd.
static void log_begin(void)
{
    int ends[2];
    assert_int_equal(pipe2(ends, O_CLOEXEC), 0);
    said.saved = fcntl(STDERR_FILENO, F_DUPFD_CLOEXEC, 3);
    assert_int_equal(dup2(ends[1], STDERR_FILENO), STDERR_FILENO);
    close(ends[1]);
    if (said.fd >= 0)
        close(said.fd);
    said.fd = ends[0];
    said.n = 0;
    said.text[0] = '\0';
}

static void log_started(void)
{
    dup2(said.saved, STDERR_FILENO);
    close(said.saved);
    said.saved = -1;
}

// A little more of it, also for whoever runs the test. False: none came in the time, or it has ended.
static bool log_read(int timeout_ms)
{
    struct pollfd p = { .fd = said.fd, .events = POLLIN };
    char *at = said.text + said.n;
    if (poll(&p, 1, timeout_ms) < 1)
        return false;
    ssize_t n = read(said.fd, at, sizeof said.text - 1 - said.n);
    if (n <= 0)
        return false;
    at[n] = '\0';
    said.n += (size_t)n;
    (void)!write(STDERR_FILENO, at, (size_t)n);
    return true;
}

static void log_expect(const char *text)
{
    while (!strstr(said.text, text))
        if (!log_read(WAIT_MS))
            fail_msg("the daemon did not say \"%s\"", text);
}

static void start(struct daemon *d, const char *const *options)
{
    memset(loss, 0, sizeof *loss);
    log_begin();
    daemon_start(d, options);
    log_started();
    log_expect("ready on");
}

static const char *const common[] = { "--warm", "common", NULL };

// At the path of one that has ended.
static void start_again(struct daemon *d)
{
    memset(loss, 0, sizeof *loss);
    log_begin();
    d->pid = fork();
    assert_true(d->pid >= 0);
    if (d->pid == 0 && prctl(PR_SET_PDEATHSIG, SIGKILL) == 0)
        daemon_exec((const char *const[]){ "--socket", d->path, NULL }, common);
    if (d->pid == 0)
        _exit(127);
    log_started();
    log_expect("ready on");
}

static int stop(struct daemon *d, int signal)
{
    int status = daemon_stop(d, signal);
    while (log_read(0))
        ;
    return status;
}

// Of a daemon that has been waited for.
static void folder_leave(struct daemon *d)
{
    close(d->lifetime_fd);
    assert_int_equal(rmdir(d->dir), 0);
}

static void fd_close(int fd)
{
    if (fd >= 0)
        close(fd);
}

static void held_expect(unsigned n)
{
    for (int64_t end = daemon_now_ms() + WAIT_MS; atomic_load(&loss->held) != n; daemon_nap())
        if (daemon_now_ms() > end)
            fail_msg("%u calls stand still; expected %u", atomic_load(&loss->held), n);
}

static void faults_come(_Atomic uint32_t *fault, uint32_t times)
{
    atomic_store(fault, times);
    atomic_store(&loss->hold, 0);
}

// ---- frames --------------------------------------------------------------------------------------------

struct frame {
    struct airy *airy;
    uint64_t id;
    unsigned way;
    void *map;
};

static struct airy_status status_of(struct airy *a)
{
    struct airy_status s;
    struct airy_error e;
    if (airy_status(a, &s, WAIT_MS, &e) < 0)
        fail_msg("status: %s", e.text);
    return s;
}

// Way 0: a file inline, and back; 1: a file by descriptor, a memfd back; 2: raw pixels into an output of ours.
static struct frame frame_submit(struct airy *a, unsigned way, const char *wall)
{
    struct frame f = { .airy = a, .way = way };
    struct airy_request r = AIRY_REQUEST_INIT;
    struct airy_error e;
    assert_int_equal(airy_request_param(&r, "psf", "gaussians:sigma=1.5/6,weight=.1/.1", &e), 0);
    r.wall = wall;
    if (wall) { // with a bright pass that the host does not do
        assert_int_equal(airy_request_param(&r, "clamp", "400", &e), 0);
        picture_request(&picture, &r);
        r.data = picture.pixels;
        r.size = raw_bytes;
    } else if (way == 0) {
        r.data = exr;
        r.size = exr_bytes;
        r.inline_output = true;
    } else if (way == 1) {
        r.input_fd = make_memfd(exr, exr_bytes, F_SEAL_SHRINK);
    } else {
        r.input_fd = make_memfd(picture.pixels, raw_bytes, F_SEAL_SHRINK);
        picture_request(&picture, &r);
        r.output_fd = airy_memfd(raw_bytes, &f.map, &e);
        r.output_size = raw_bytes;
    }
    if (airy_submit(a, &r, &f.id, &e) < 0)
        fail_msg("submit: %s %s", e.symbol, e.text);
    fd_close(r.input_fd);
    fd_close(r.output_fd);
    return f;
}

// Its one end: true when it is done, *bytes then compared with, or kept as, what is wanted. Else it is a lost device, and retryable.
static bool frame_ends(struct frame *f)
{
    struct airy_result *r = NULL;
    struct airy_error e = { .text = "" };
    const int n = airy_wait(f->airy, f->id, WAIT_MS, &r, &e);
    if (n == 1) {
        const void *data = f->map ? f->map : r->data;
        const size_t size = f->map ? raw_bytes : r->size;
        if (!want[f->way].bytes) {
            want[f->way].bytes = malloc(size);
            memcpy(want[f->way].bytes, data, size);
            want[f->way].size = size;
        }
        assert_int_equal(size, want[f->way].size);
        if (memcmp(data, want[f->way].bytes, size) != 0)
            fail_msg("request %llu, way %u: not the bytes of an undisturbed daemon", (unsigned long long)f->id, f->way);
        airy_result_free(r);
    } else if (n == 0 || strcmp(e.symbol, "DEVICE_LOST") != 0 || !e.retryable) {
        fail_msg("request %llu, way %u: %d %s %s; expected DEVICE_LOST", (unsigned long long)f->id, f->way, n, e.symbol, e.text);
    }
    if (f->map)
        munmap(f->map, raw_bytes);
    struct airy_error once; // the daemon may have gone since
    assert_int_equal(airy_wait(f->airy, f->id, 0, NULL, &once), -1);
    assert_true(once.code == -ENOENT || once.code == -EPIPE || once.code == -ECONNRESET);
    return n == 1;
}

static void frame_expect(struct airy *a, unsigned way)
{
    struct frame f = frame_submit(a, way, NULL);
    assert_true(frame_ends(&f));
}

// All clients' frames are in the daemon, and the device stands still with the first of them.
static void frames_in_flight(struct airy **a, struct frame *f, struct airy *watcher)
{
    atomic_store(&loss->hold, 1);
    for (unsigned i = 0; i < FRAMES; i++)
        f[i] = frame_submit(a[i % CLIENTS], i % WAYS, NULL);
    struct airy_status s;
    for (int64_t end = daemon_now_ms() + WAIT_MS; s = status_of(watcher), s.queued + s.running != FRAMES; daemon_nap()) {
        struct airy_error e;
        for (unsigned i = 0; i < CLIENTS; i++)
            assert_int_equal(airy_pump(a[i], &e), 0);
        if (daemon_now_ms() > end)
            fail_msg("%u + %u requests are in the daemon; expected %d", s.queued, s.running, FRAMES);
    }
    held_expect(1);
}

static unsigned frames_end(struct frame *f)
{
    unsigned done = 0;
    for (unsigned i = 0; i < FRAMES; i++)
        done += frame_ends(&f[i]);
    return done;
}

static void clients_join(struct airy **a, const struct daemon *d)
{
    for (unsigned i = 0; i <= CLIENTS; i++)
        a[i] = daemon_join(d);
}

static void clients_close(struct airy **a)
{
    for (unsigned i = 0; i <= CLIENTS; i++)
        airy_close(a[i]);
}

// ---- the daemon lives on -------------------------------------------------------------------------------

// Lost at the submission, at the wait for it, and by a wait that ran out. With validation, that has an eye on how a device is left.
static void a_loss_costs_no_request(void **state)
{
    (void)state;
    const struct {
        _Atomic uint32_t *fault;
        const char *says;
    } ways[] = { { &loss->submit_lost, "the device is lost (vkQueueSubmit2: the Vulkan device was lost); opening it again" },
                 { &loss->wait_lost, "the device is lost (vkWaitSemaphores: the Vulkan device was lost); opening it again" },
                 { &loss->wait_hung, "the device is lost (the device did not finish a frame within" } };
    struct daemon d;
    struct airy *a[CLIENTS + 1];
    struct frame f[FRAMES];
    start(&d, (const char *const[]){ "--warm", "common", daemon_sanitized() ? NULL : "--validate", NULL });
    clients_join(a, &d);
    for (unsigned i = 0; i < sizeof ways / sizeof ways[0]; i++) {
        frames_in_flight(a, f, a[CLIENTS]);
        faults_come(ways[i].fault, 1);
        assert_int_equal(frames_end(f), FRAMES);
        log_expect(ways[i].says);
        assert_int_equal(*ways[i].fault, 0);
        assert_int_equal(loss->devices, i + 2);
        assert_int_equal(loss->destroyed, i + 1);
        const struct airy_status s = status_of(a[CLIENTS]);
        assert_int_equal(s.done, (i + 1) * FRAMES);
        assert_int_equal(s.failed + s.cancelled + s.queued + s.running, 0);
    }
    clients_close(a);
    assert_int_equal(stop(&d, SIGTERM), 0); // 4: validation had something to say
    assert_int_equal(loss->destroyed, loss->devices);
}

// What was on the device when it was lost twice ends; nothing else does.
static void twice_costs_those_at_work(void **state)
{
    (void)state;
    struct daemon d;
    struct airy *a[CLIENTS + 1];
    struct frame f[FRAMES];
    start(&d, (const char *const[]){ "--warm", "common", "--slots", "2", NULL });
    clients_join(a, &d);
    atomic_store(&loss->spare, start_submissions);
    frames_in_flight(a, f, a[CLIENTS]);
    faults_come(&loss->wait_lost, 2);
    const unsigned failed = FRAMES - frames_end(f);
    assert_in_range(failed, 1, 3); // two slots, and the spare one
    assert_int_equal(loss->wait_lost, 0);
    assert_int_equal(loss->devices, 3);
    const struct airy_status s = status_of(a[CLIENTS]);
    assert_int_equal(s.done, FRAMES - failed);
    assert_int_equal(s.failed, failed);
    frame_expect(a[0], 0);
    clients_close(a);
    assert_int_equal(stop(&d, SIGTERM), 0);
}

// ---- the daemon ends -----------------------------------------------------------------------------------

static void upload_begin(struct peer *p, const struct daemon *d)
{
    Airy__Bloom b = AIRY__BLOOM__INIT;
    Airy__Payload in = AIRY__PAYLOAD__INIT;
    in.kind = AIRY__PAYLOAD__KIND__INLINE;
    in.size = 5000;
    b.input = &in;
    peer_hello(p, d);
    peer_bloom(p, 1, &b, NULL, 0);
    peer_status(p); // it has been taken
}

// All clients are told before their connection ends, and the path is free.
static void lost_for_good(struct daemon *d, _Atomic uint32_t *first, _Atomic uint32_t *then, const char *says)
{
    struct airy *a[CLIENTS + 1];
    struct frame f[FRAMES];
    struct peer half;
    clients_join(a, d);
    upload_begin(&half, d);
    atomic_store(&loss->hold, 1);
    for (unsigned i = 0; i < FRAMES; i++)
        f[i] = frame_submit(a[i % CLIENTS], i % WAYS, NULL);
    for (unsigned i = 0; i < CLIENTS; i++)
        status_of(a[i]); // what came before it has been taken
    held_expect(1);
    atomic_store(then, FOREVER);
    faults_come(first, first == then ? FOREVER : 1);
    assert_int_equal(frames_end(f), 0);
    peer_expect_error(&half, 1, FAULT_SHUTTING_DOWN, NULL);
    peer_expect_closed(&half);
    peer_close(&half);
    clients_close(a);
    assert_int_equal(daemon_wait(d), EXIT_LOST);
    log_expect("the device cannot be opened again");
    log_expect(says);
    log_expect("a Vulkan device is lost for good");
    assert_int_equal(access(d->path, F_OK), -1);
}

// The next daemon serves at the same path, also who was there before.
static void lost_again_and_again(void **state)
{
    (void)state;
    struct daemon d;
    struct airy *stays;
    struct airy_error e;
    start(&d, common);
    if (airy_connect(&stays, d.path, &e) < 0)
        fail_msg("connect: %s", e.text);
    airy_set_reconnect(stays, WAIT_MS);
    atomic_store(&loss->hold, 1);
    struct frame there = frame_submit(stays, 1, NULL);
    held_expect(1);
    lost_for_good(&d, &loss->submit_lost, &loss->submit_lost, "vkQueueSubmit2: the Vulkan device was lost");
    assert_false(frame_ends(&there));
    there = frame_submit(stays, 1, NULL); // waits for a daemon
    start_again(&d);
    assert_true(frame_ends(&there));
    frame_expect(stays, 0);
    airy_close(stays);
    assert_int_equal(stop(&d, SIGTERM), 0);
}

static void hangs_again_and_again(void **state)
{
    (void)state;
    struct daemon d;
    start(&d, common);
    lost_for_good(&d, &loss->wait_hung, &loss->wait_hung, "the device did not finish a frame within");
    folder_leave(&d);
}

static void no_device_after_the_loss(void **state)
{
    (void)state;
    struct daemon d;
    start(&d, common);
    lost_for_good(&d, &loss->wait_lost, &loss->create_fails, "vkCreateDevice: VkResult -3");
    folder_leave(&d);
}

static void no_device_at_the_start(void **state)
{
    (void)state;
    char folder[] = "/tmp/airyd-test-XXXXXX", path[64], text[4096];
    assert_non_null(mkdtemp(folder));
    snprintf(path, sizeof path, "%s/s", folder);
    memset(loss, 0, sizeof *loss);
    atomic_store(&loss->create_fails, 1);
    assert_int_equal(daemon_run((const char *const[]){ "--socket", path, NULL }, text, sizeof text), 1);
    assert_non_null(strstr(text, "vkCreateDevice: VkResult -3"));
    assert_int_equal(loss->create_fails, 0);
    memset(loss, 0, sizeof *loss);
    atomic_store(&loss->submit_lost, FOREVER); // it is there, and does not pass its test
    assert_int_equal(daemon_run((const char *const[]){ "--socket", path, NULL }, text, sizeof text), 1);
    assert_non_null(strstr(text, "the Vulkan device was lost"));
    assert_int_equal(rmdir(folder), 0);
}

// While it draws with the pipelines that nobody has asked for: once, and nobody notices; for good, and nobody has to come first.
static void lost_with_nobody_there(void **state)
{
    (void)state;
    for (int good = 0; good < 2; good++) {
        struct daemon d;
        memset(loss, 0, sizeof *loss);
        atomic_store(&loss->spare, start_submissions);
        atomic_store(&loss->hold, 1);
        log_begin();
        daemon_start(&d, (const char *const[]){ "--warm", "idle", NULL });
        log_started();
        held_expect(1);
        if (good)
            atomic_store(&loss->spare, 0);
        faults_come(&loss->submit_lost, good ? FOREVER : 1);
        if (!good) {
            struct airy *a = daemon_join(&d);
            frame_expect(a, 0);
            assert_int_equal(loss->devices, 2);
            airy_close(a);
        }
        assert_int_equal(stop(&d, good ? 0 : SIGTERM), good ? EXIT_LOST : 0);
    }
}

// ---- a driver that does not come back ---------------------------------------------------------------------

// systemd's end: read all the time, for a full queue would hold up the daemon.
struct notes {
    int fd;
    atomic_bool triggered;
};

static void *notes_main(void *arg)
{
    struct notes *notes = arg;
    char text[512];
    for (ssize_t n; (n = recv(notes->fd, text, sizeof text - 1, 0)) > 0;) {
        text[n] = '\0';
        if (strstr(text, "WATCHDOG=trigger"))
            atomic_store(&notes->triggered, true);
    }
    return NULL;
}

// The watchdog is told to act, whoever asks is answered meanwhile, and a second signal ends the daemon all the same.
static void a_hung_driver_is_given_up(void **state)
{
    (void)state;
    char folder[] = "/tmp/airyd-test-XXXXXX";
    struct sockaddr_un address = { .sun_family = AF_UNIX };
    assert_non_null(mkdtemp(folder));
    snprintf(address.sun_path, sizeof address.sun_path, "%s/n", folder);
    struct notes notes = { .fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0) };
    pthread_t reader;
    assert_int_equal(bind(notes.fd, (struct sockaddr *)&address, sizeof address), 0);
    assert_int_equal(pthread_create(&reader, NULL, notes_main, &notes), 0);
    setenv("NOTIFY_SOCKET", address.sun_path, 1);
    setenv("WATCHDOG_USEC", "1000000", 1);
    struct daemon d;
    start(&d, common);
    unsetenv("NOTIFY_SOCKET");
    unsetenv("WATCHDOG_USEC");
    struct airy *a = daemon_join(&d);
    atomic_store(&loss->hold_idle, 1); // what was submitted never ends, and so the device cannot be left
    atomic_store(&loss->wait_hung, 1);
    struct frame f = frame_submit(a, 1, NULL);
    log_expect("the device did not finish a frame within");
    for (int64_t end = daemon_now_ms() + WAIT_MS; !atomic_load(&notes.triggered); daemon_nap())
        assert_true(daemon_now_ms() < end);
    log_expect("the watchdog grants 1.0 s: giving up");
    held_expect(1);
    assert_int_equal(status_of(a).running, 1);
    kill(d.pid, SIGTERM);
    log_expect("SIGTERM: finishing 1 requests");
    kill(d.pid, SIGTERM);
    assert_int_equal(stop(&d, 0), 1);
    struct airy_error e;
    assert_int_equal(airy_wait(a, f.id, WAIT_MS, NULL, &e), -1);
    airy_close(a);
    shutdown(notes.fd, SHUT_RD);
    pthread_join(reader, NULL);
    close(notes.fd);
    unlink(address.sun_path);
    assert_int_equal(rmdir(folder), 0);
}

// ---- walls ---------------------------------------------------------------------------------------------

static void a_wall_loses_its_device(void **state)
{
    (void)state;
    struct daemon d;
    struct frame f[EACH];
    start(&d, common);
    struct airy *a = daemon_join(&d);
    struct airy_wall_reply *reply = NULL;
    struct airy_error e;
    const struct airy_wall_request open = { .action = AIRY_WALL_OPEN,
                                            .definition = "wall: w\nsize: [32, 16]\nrate: 100\npanels:\n"
                                                          "  - {name: p, at: [0, 0], size: [32, 16]}\n" };
    if (airy_wall(a, &open, WAIT_MS, &reply, &e) < 0)
        fail_msg("%s: %s (%s)", e.symbol, e.text, e.field);
    airy_wall_reply_free(reply);
    f[0] = frame_submit(a, WALL, "w");
    assert_true(frame_ends(&f[0])); // and that is what is wanted
    assert_int_equal(loss->devices, 2);
    for (int good = 0; good < 2; good++) {
        atomic_store(&loss->hold, 1);
        for (unsigned i = 0; i < EACH; i++)
            f[i] = frame_submit(a, WALL, "w");
        status_of(a); // what came before it has been taken
        held_expect(1);
        atomic_store(&loss->create_fails, good ? FOREVER : 0);
        faults_come(&loss->submit_lost, 1);
        for (unsigned i = 0; i < EACH; i++)
            assert_int_equal(frame_ends(&f[i]), !good);
        assert_int_equal(loss->devices, 3);
    }
    airy_close(a);
    assert_int_equal(stop(&d, 0), EXIT_LOST);
}

// ---- the command -----------------------------------------------------------------------------------------

enum { SHOT = 6 };

static pid_t bloom_begin(const struct daemon *d, const char *folder, const char *output)
{
    const char *airy = getenv("AIRY");
    char program[PATH_MAX];
    assert_non_null(realpath(airy ? airy : "build/airy", program));
    const pid_t pid = fork();
    assert_true(pid >= 0);
    if (pid == 0) {
        if (chdir(folder) == 0 && dup2(STDERR_FILENO, STDOUT_FILENO) >= 0)
            execl(program, program, "bloom", "--socket", d->path, "in.####.exr", "-o", output, "-f", "1-6", (char *)NULL);
        _exit(126);
    }
    return pid;
}

static int bloom_end(pid_t pid)
{
    int status;
    assert_int_equal(waitpid(pid, &status, 0), pid);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 1000 + WTERMSIG(status);
}

static uint8_t *file_read(const char *folder, const char *name, unsigned i, size_t *size)
{
    char path[128];
    struct stat st;
    snprintf(path, sizeof path, "%s/%s.%04u.exr", folder, name, i);
    const int fd = open(path, O_RDONLY | O_CLOEXEC);
    assert_true(fd >= 0 && fstat(fd, &st) == 0);
    uint8_t *bytes = malloc((size_t)st.st_size);
    assert_int_equal(read(fd, bytes, (size_t)st.st_size), st.st_size);
    close(fd);
    *size = (size_t)st.st_size;
    return bytes;
}

// Each once, and nothing beside them.
static void files_expect(const char *folder)
{
    unsigned n = 0;
    for (unsigned i = 1; i <= SHOT; i++) {
        size_t size, wanted;
        uint8_t *got = file_read(folder, "out", i, &size), *wants = file_read(folder, "want", i, &wanted);
        assert_int_equal(size, wanted);
        assert_memory_equal(got, wants, size);
        free(got);
        free(wants);
    }
    DIR *dir = opendir(folder);
    char path[512];
    for (struct dirent *entry; (entry = readdir(dir));) {
        if (entry->d_name[0] == '.' && !strncmp(entry->d_name, "..", strlen(entry->d_name)))
            continue;
        n++;
        snprintf(path, sizeof path, "%s/%s", folder, entry->d_name);
        unlink(path);
    }
    closedir(dir);
    assert_int_equal(n, 3 * SHOT);
}

static void the_command_finishes_its_range(void **state)
{
    (void)state;
    char folder[] = "/tmp/airyd-test-XXXXXX", path[64];
    struct daemon d;
    assert_non_null(mkdtemp(folder));
    for (unsigned i = 1; i <= SHOT; i++) {
        snprintf(path, sizeof path, "%s/in.%04u.exr", folder, i);
        const int fd = open(path, O_CREAT | O_WRONLY | O_CLOEXEC, 0600);
        assert_int_equal(write(fd, exr, exr_bytes), exr_bytes);
        close(fd);
    }
    start(&d, common);
    assert_int_equal(bloom_end(bloom_begin(&d, folder, "want.####.exr")), 0);
    atomic_store(&loss->hold, 1);
    const pid_t pid = bloom_begin(&d, folder, "out.####.exr");
    held_expect(1);
    struct airy *a = daemon_join(&d);
    for (int64_t end = daemon_now_ms() + WAIT_MS; status_of(a).queued + status_of(a).running < 2; daemon_nap())
        assert_true(daemon_now_ms() < end);
    airy_close(a);
    faults_come(&loss->submit_lost, FOREVER);
    assert_int_equal(daemon_wait(&d), EXIT_LOST);
    start_again(&d);
    assert_int_equal(bloom_end(pid), 0);
    files_expect(folder);
    assert_int_equal(rmdir(folder), 0);
    assert_int_equal(stop(&d, SIGTERM), 0);
}

// ---- all of them -----------------------------------------------------------------------------------------

static char control[] = "/tmp/airyd-test-XXXXXX";

// The layer is beside this program. What an undisturbed daemon gives is what everyone wants.
static int before(void **state)
{
    (void)state;
    char folder[PATH_MAX];
    assert_non_null(realpath("/proc/self/exe", folder));
    *strrchr(folder, '/') = '\0';
    setenv("XDG_DATA_HOME", folder, 1);
    setenv(LAYER_LOSS_ON, "1", 1);
    const int fd = mkstemp(control);
    assert_true(fd >= 0 && ftruncate(fd, sizeof *loss) == 0);
    setenv(LAYER_LOSS_FILE, control, 1);
    loss = mmap(NULL, sizeof *loss, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    assert_ptr_not_equal(loss, MAP_FAILED);
    close(fd);
    picture = picture_make(160, 96, 500, 7);
    exr = picture_exr(&picture, &exr_bytes);
    raw_bytes = picture_bytes(&picture);

    struct daemon d;
    start(&d, common);
    start_submissions = loss->submitted;
    assert_int_equal(loss->devices, 1); // the layer is there
    assert_true(start_submissions > 0);
    struct airy *a = daemon_join(&d);
    for (unsigned way = 0; way < WAYS; way++)
        frame_expect(a, way);
    airy_close(a);
    return stop(&d, SIGTERM);
}

static int after(void **state)
{
    (void)state;
    munmap(loss, sizeof *loss);
    unlink(control);
    for (unsigned way = 0; way <= WALL; way++)
        free(want[way].bytes);
    free(exr);
    picture_free(&picture);
    fd_close(said.fd);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_loss_costs_no_request),  cmocka_unit_test(twice_costs_those_at_work),
        cmocka_unit_test(lost_again_and_again),     cmocka_unit_test(hangs_again_and_again),
        cmocka_unit_test(no_device_after_the_loss), cmocka_unit_test(no_device_at_the_start),
        cmocka_unit_test(lost_with_nobody_there),   cmocka_unit_test(a_hung_driver_is_given_up),
        cmocka_unit_test(a_wall_loses_its_device),  cmocka_unit_test(the_command_finishes_its_range),
    };
    if (getenv("AIRY_TEST_ONLY"))
        cmocka_set_test_filter(getenv("AIRY_TEST_ONLY"));
    return cmocka_run_group_tests(tests, before, after);
}
