// SPDX-License-Identifier: Apache-2.0
/*
 * bench_wall_usb.c - `make bench-usb`: a wall of emulated Fadecandy boards, the unmodified daemon, for SECONDS: frames that each
 * board got, drops, lateness of the ticks, time from a tick's bytes to its last transfer, with a picture pushed at every tick, alone and
 * with a farm's 4K frames beside it; then how long it takes to light up after plugging in, and after a stall. Under
 * umockdev-wrapper. Prints; asserts nothing. The emulation's own share of the CPU is in every figure.
 */
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "airy.h"
#include "usb_kit.h"

enum { BOARDS_MAX = 16, WIDTH = 320, HEIGHT = 160 };

static struct usb_kit *kit;
static struct kit_board *board[BOARDS_MAX];
static char path[] = "/tmp/airyd-bench-XXXXXX/s";
static pid_t daemon_pid;

static uint64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000 + (uint64_t)t.tv_nsec;
}

static void sleep_ms(long ms) { nanosleep(&(struct timespec){ ms / 1000, ms % 1000 * 1000000 }, NULL); }

static void die(const char *what, const struct airy_error *e)
{
    fprintf(stderr, "bench: %s: %s\n", what, e ? e->text : "");
    if (daemon_pid > 0)
        kill(daemon_pid, SIGTERM);
    exit(1);
}

static struct airy *join(void)
{
    struct airy_error e;
    struct airy *a = NULL;
    for (int i = 0; i < 600; i++, sleep_ms(100))
        if (airy_connect(&a, path, &e) == 0)
            return a;
    die("no daemon", &e);
    return NULL;
}

// What stands for hardware does not wait for a processor; the programs that are measured do.
static void be_hardware(void)
{
    if (sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){ .sched_priority = 20 }) < 0)
        puts("no right to real-time priority: the emulated boards wait for the processor like everybody else");
}

static void be_software(void) { sched_setscheduler(0, SCHED_OTHER, &(struct sched_param){ 0 }); }

static void start_daemon(const char *airyd)
{
    char *slash = strrchr(path, '/');
    *slash = '\0';
    if (!mkdtemp(path))
        die("mkdtemp", NULL);
    *slash = '/';
    daemon_pid = fork();
    if (daemon_pid == 0) {
        be_software();
        execl(airyd, airyd, "--socket", path, "--threads", "2", "--warm", "common", (char *)NULL);
        _exit(127);
    }
}

static char *definition(unsigned boards, double rate)
{
    static char text[16384];
    int n = snprintf(text, sizeof text, "wall: bench\nrate: %g\nhold: forever\npanels:\n", rate);
    for (unsigned i = 0; i < boards; i++)
        n += snprintf(text + n, sizeof text - (size_t)n, "  - {name: p%u, at: [%u, %u], size: [32, 16]}\n", i, i % 5 * 32, i / 5 * 16);
    n += snprintf(text + n, sizeof text - (size_t)n, "boards:\n");
    for (unsigned i = 0; i < boards; i++)
        n += snprintf(text + n, sizeof text - (size_t)n, "  - {serial: BENCH%u, panels: [p%u]}\n", i, i);
    return text;
}

static struct airy_wall_reply *ask(struct airy *a, const struct airy_wall_request *q)
{
    struct airy_wall_reply *r = NULL;
    struct airy_error e;
    if (airy_wall(a, q, 60000, &r, &e) < 0)
        die("wall", &e);
    return r;
}

static bool all_ready(struct airy *a)
{
    struct airy_wall_reply *r = ask(a, &(struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = "bench" });
    bool ready = true;
    for (unsigned i = 0; i < r->walls[0].n_boards; i++)
        ready &= !strcmp(r->walls[0].boards[i].state, "ready");
    airy_wall_reply_free(r);
    return ready;
}

static double cpu_of(pid_t pid)
{
    char name[64];
    unsigned long user = 0, system = 0;
    snprintf(name, sizeof name, "/proc/%d/stat", (int)pid);
    FILE *f = fopen(name, "re");
    if (!f || fscanf(f, "%*d (%*[^)]) %*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %lu %lu", &user, &system) != 2)
        user = system = 0;
    if (f)
        fclose(f);
    return (double)(user + system) / (double)sysconf(_SC_CLK_TCK);
}

static struct airy_times spent; // over all results of a push
static unsigned results;

static void note(const struct airy_result *r)
{
    if (!r)
        return;
    results++;
    spent.queue += r->ms.queue;
    spent.load += r->ms.load;
    spent.decode += r->ms.decode;
    spent.bloom += r->ms.bloom;
    spent.total += r->ms.total;
}

// Pushes a picture at every tick, as a live source does: float planes in a memfd, dark with a share of bright rows.
static void push(struct airy *a, uint32_t width, uint32_t height, double rate, double seconds)
{
    struct airy_error e;
    struct airy_request r = AIRY_REQUEST_INIT;
    const size_t plane = (size_t)width * height * sizeof(float);
    void *map;
    r.width = width;
    r.height = height;
    r.type = AIRY_FLOAT;
    r.n_channels = 3;
    for (unsigned c = 0; c < 3; c++)
        r.channels[c] = (struct airy_channel){ c == 0 ? "R" : c == 1 ? "G" : "B", plane * c, 4 * (uint64_t)width, 4 };
    r.size = plane * 3;
    r.input_fd = airy_memfd(r.size, &map, &e);
    if (r.input_fd < 0)
        die("memfd", &e);
    float *pixels = map;
    memset(&spent, 0, sizeof spent);
    results = 0;
    r.wall = "bench";
    r.show = true;
    const uint64_t start = now_ns();
    unsigned open = 0;
    for (uint64_t k = 0; (double)k < rate * seconds; k++) {
        const uint64_t due = start + (uint64_t)((double)k / rate * 1e9);
        while (now_ns() < due || open >= 4) {
            struct airy_result *got = NULL;
            uint64_t id;
            const int rc = open ? airy_wait_any(a, 1, &id, &got, &e) : 0;
            if (rc < 0)
                die("frame", &e);
            open -= rc > 0;
            note(got);
            airy_result_free(got);
            if (!open && now_ns() < due)
                sleep_ms(1);
        }
        for (unsigned x = 0; x < width; x++)
            pixels[k % 3 * (plane / 4) + k % height * width + x] = (float)((x * 31 + k * 7) % 97) / 40;
        r.present_ns = due + 50000000;
        uint64_t id;
        if (airy_submit(a, &r, &id, &e) < 0)
            die("submit", &e);
        open++;
    }
    while (open) {
        struct airy_result *got = NULL;
        uint64_t id;
        open -= airy_wait_any(a, 10000, &id, &got, &e) != 0;
        note(got);
        airy_result_free(got);
    }
    munmap(map, r.size);
    close(r.input_fd);
}

// A picture of 1080p for a wall of 512 x 256 at every tick: how many come through, and where their time goes.
static void large(struct airy *a, double seconds)
{
    airy_wall_reply_free(ask(a, &(struct airy_wall_request){ .action = AIRY_WALL_OPEN,
                                                             .definition = "wall: bench\nrate: 60\nhold: forever\npanels:\n"
                                                                           "  - {name: p, at: [0, 0], size: [512, 256]}\n" }));
    push(a, 1920, 1080, 60, 2);
    struct airy_wall_reply *r = ask(a, &(struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = "bench" });
    const uint64_t shown = r->walls[0].shown, dropped = r->walls[0].dropped;
    airy_wall_reply_free(r);
    const double cpu = cpu_of(daemon_pid);
    const uint64_t start = now_ns();
    push(a, 1920, 1080, 60, seconds);
    const double took = (double)(now_ns() - start) / 1e9, n = results ? results : 1;
    r = ask(a, &(struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = "bench" });
    printf("1080p float, the default look -> 512 x 256 at 60 a second, %.0f s: %.1f pushed, %.1f shown a second, %llu dropped; daemon %.2f cores\n", took,
           results / took, (double)(r->walls[0].shown - shown) / took, (unsigned long long)(r->walls[0].dropped - dropped),
           (cpu_of(daemon_pid) - cpu) / took);
    printf("  mean ms: queue %.1f, load %.1f, decode %.1f, bloom and resample %.1f, in all %.1f\n", spent.queue / n, spent.load / n,
           spent.decode / n, spent.bloom / n, spent.total / n);
    fflush(stdout);
    airy_wall_reply_free(r);
    airy_wall_reply_free(ask(a, &(struct airy_wall_request){ .action = AIRY_WALL_CLOSE, .name = "bench" }));
}

// A farm: 4K frames, two in flight, until killed.
static pid_t farm(void)
{
    pid_t pid = fork();
    if (pid)
        return pid;
    be_software();
    struct airy *a = join();
    struct airy_error e;
    struct airy_request r = AIRY_REQUEST_INIT;
    const size_t pixels = (size_t)3840 * 2160;
    uint16_t *frame = malloc(pixels * 8);
    for (size_t i = 0; i < pixels * 4; i++)
        frame[i] = (uint16_t)(0x3800 + i * 2654435761u % 0x0900);
    r.width = 3840;
    r.height = 2160;
    r.type = AIRY_HALF;
    r.n_channels = 4;
    for (unsigned c = 0; c < 4; c++)
        r.channels[c] = (struct airy_channel){ c == 0 ? "R" : c == 1 ? "G" : c == 2 ? "B" : "A", 2 * c, 3840 * 8, 8 };
    r.data = frame;
    r.size = pixels * 8;
    unsigned open = 0;
    for (;;) {
        uint64_t id;
        struct airy_result *got = NULL;
        if (open < 2 && airy_submit(a, &r, &id, &e) == 0)
            open++;
        else if (airy_wait_any(a, -1, &id, &got, &e) != 0)
            open--;
        airy_result_free(got);
    }
}

static void measure(struct airy *a, const char *name, unsigned boards, double rate, double seconds)
{
    uint64_t before[BOARDS_MAX];
    airy_wall_reply_free(ask(a, &(struct airy_wall_request){ .action = AIRY_WALL_OPEN, .definition = definition(boards, rate) }));
    while (!all_ready(a))
        sleep_ms(50);
    push(a, WIDTH, HEIGHT, rate, 2); // the first frame makes pipelines
    struct airy_wall_reply *r = ask(a, &(struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = "bench" });
    const uint64_t shown = r->walls[0].shown, lost = r->walls[0].dropped, missed = r->walls[0].ticks_missed;
    uint64_t board_dropped = 0;
    for (unsigned i = 0; i < boards; i++)
        board_dropped += r->walls[0].boards[i].dropped;
    airy_wall_reply_free(r);
    for (unsigned i = 0; i < boards; i++)
        before[i] = kit_frames(board[i]);
    const double cpu = cpu_of(daemon_pid);
    const uint64_t start = now_ns();
    push(a, WIDTH, HEIGHT, rate, seconds);
    const double took = (double)(now_ns() - start) / 1e9;
    uint64_t least = UINT64_MAX;
    for (unsigned i = 0; i < boards; i++) {
        const uint64_t n = kit_frames(board[i]) - before[i];
        least = n < least ? n : least;
    }
    const double used = (cpu_of(daemon_pid) - cpu) / took;
    r = ask(a, &(struct airy_wall_request){ .action = AIRY_WALL_LIST, .name = "bench" });
    const struct airy_wall_state *w = &r->walls[0];
    uint64_t dropped = 0;
    double p99 = 0, max = 0;
    for (unsigned i = 0; i < boards; i++) {
        dropped += w->boards[i].dropped;
        p99 = w->boards[i].latency_ms.p99 > p99 ? w->boards[i].latency_ms.p99 : p99;
        max = w->boards[i].latency_ms.max > max ? w->boards[i].latency_ms.max : max;
    }
    printf("%s, %u boards at %g a second, %.0f s: least %.2f frames/s a board, %llu board frames dropped, %llu ticks left out\n", name,
           boards, rate, took, (double)least / took, (unsigned long long)(dropped - board_dropped),
           (unsigned long long)(w->ticks_missed - missed));
    printf("  late p50 %.3f p99 %.3f max %.3f ms; skew p99 %.2f ms; ready to last transfer p99 %.2f max %.2f ms (of it 1.3 emulated)\n",
           w->late_ms.p50, w->late_ms.p99, w->late_ms.max, w->skew_ms.p99, p99, max);
    printf("  pictures shown %llu, dropped %llu; daemon %.2f cores%s\n", (unsigned long long)(w->shown - shown),
           (unsigned long long)(w->dropped - lost), used, w->realtime ? "" : "; no real-time priority");
    fflush(stdout);
    airy_wall_reply_free(r);
    airy_wall_reply_free(ask(a, &(struct airy_wall_request){ .action = AIRY_WALL_CLOSE, .name = "bench" }));
    sleep_ms(1500); // black, and away
}

// From an event to the next whole frame on the board.
static double until_frame(struct kit_board *b, uint64_t since)
{
    const uint64_t n = kit_frames(b);
    if (!kit_wait_frames(b, n + 1, 10000))
        return -1;
    return (double)(now_ns() - since) / 1e6;
}

static void recovery(struct airy *a)
{
    double plug = 0, stall = 0, lost = 0;
    enum { ROUNDS = 9 };
    airy_wall_reply_free(ask(a, &(struct airy_wall_request){ .action = AIRY_WALL_OPEN, .definition = definition(2, 60) }));
    while (!all_ready(a))
        sleep_ms(50);
    for (unsigned i = 0; i < ROUNDS; i++) {
        uint64_t t = now_ns();
        kit_unplug(board[1]);
        while (all_ready(a))
            sleep_ms(1);
        const double gone = (double)(now_ns() - t) / 1e6;
        sleep_ms(200);
        t = now_ns();
        kit_plug(board[1]);
        const double back = until_frame(board[1], t);
        sleep_ms(200);
        t = now_ns();
        KIT_SET(board[1], stall_next, 1);
        while (__atomic_load_n(&board[1]->stall_next, __ATOMIC_RELAXED))
            sleep_ms(1);
        t = now_ns();
        const double mended = until_frame(board[1], t);
        lost = gone > lost ? gone : lost;
        plug = back > plug ? back : plug;
        stall = mended > stall ? mended : stall;
    }
    printf("worst of %d: lost board noticed after %.0f ms, first frame %.0f ms after arrival, next frame %.1f ms after a stall\n", ROUNDS,
           lost, plug, stall);
    airy_wall_reply_free(ask(a, &(struct airy_wall_request){ .action = AIRY_WALL_CLOSE, .name = "bench" }));
}

int main(int argc, char **argv)
{
    const double seconds = argc > 2 ? atof(argv[2]) : 60;
    be_hardware();
    kit = kit_create();
    if (argc < 2 || !kit) {
        fputs("usage: umockdev-wrapper bench_wall_usb AIRYD [SECONDS]\n", stderr);
        return 1;
    }
    start_daemon(argv[1]);
    struct airy *a = join();
    for (unsigned i = 0; i < 10; i++) {
        char serial[16];
        snprintf(serial, sizeof serial, "BENCH%u", i);
        board[i] = kit_fadecandy(kit, serial);
        KIT_SET(board[i], delay_us, 1320); // LED section 1: 1600 bytes at full speed
        kit_plug(board[i]);
    }
    be_software();
    large(a, seconds);
    measure(a, "alone", 10, 60, seconds);
    measure(a, "alone", 5, 120, seconds);
    pid_t other = farm();
    measure(a, "beside 4K frames", 10, 60, seconds);
    kill(other, SIGKILL);
    waitpid(other, NULL, 0);
    recovery(a);
    airy_close(a);
    kill(daemon_pid, SIGTERM);
    waitpid(daemon_pid, NULL, 0);
    kit_unplug_all(kit);
    kit_destroy(kit);
    *strrchr(path, '/') = '\0';
    rmdir(path);
    return 0;
}
