// SPDX-License-Identifier: Apache-2.0
// main.c - airyd's options, and the order of its start and end. airyd.8 is the manual.
#include <errno.h>
#include <fcntl.h>
#include <getopt.h>
#include <limits.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <systemd/sd-daemon.h>
#include <unistd.h>

#include "airy.h"
#include "machine.h"
#include "server.h"

enum { EXIT_USAGE = 2, EXIT_VALIDATION = 4 };

struct options {
    const char *socket, *device, *warm;
    uint64_t threads, slots, max_frame_bytes, max_clients, max_requests, timeout_s, asset_bytes;
    uint64_t memory_bytes, user_connections, user_requests, user_bytes, user_fds; // 0: by the machine
    const char *wall[WALLS_MAX];
    unsigned n_walls;
    int lifetime_fd;
    bool validate, verbose;
};

static void say(const char *line)
{
    // A client's words are in some lines: they stay one line.
    char text[1024];
    size_t n = 0;
    for (; line[n] && n < sizeof text - 1; n++)
        text[n] = (unsigned char)line[n] < ' ' || line[n] == 127 ? '?' : line[n];
    text[n] = 0;
    fprintf(stderr, "airyd: %s\n", text);
}

static void say_fault(const struct fault *f)
{
    char line[512];
    snprintf(line, sizeof line, "%s%s%s", f->field, f->field[0] ? ": " : "", f->text);
    say(line);
}

static void print_line(const char *line) { puts(line); }

static const char usage[] =
    "Usage: airyd [OPTION]...\n"
    "Blooms HDR frames that come over a Unix socket, on one Vulkan device.\n\n"
    "      --socket PATH          listen here (default: $XDG_RUNTIME_DIR/airyd.sock, for root\n"
    "                             /run/airyd/airyd.sock; not used with a socket from systemd)\n"
    "      --device WHICH         cpu, gpu, an index or part of a name (default: the best)\n"
    "      --list-devices         print the devices and exit\n"
    "      --threads N            codec threads, 1 to 256 (default: the number of CPUs)\n"
    "      --slots N              frames between decoding and encoding, 1 to 8 (default 3)\n"
    "      --max-frame-bytes N    largest payload, either way; K, M, G may follow (default 2G, at\n"
    "                             most an eighth of --memory-bytes)\n"
    "      --memory-bytes N       memory for payloads, frames and caches, by declared size; K, M, G may follow\n"
    "                             (default three quarters of the memory)\n"
    "      --max-clients N        connections, 1 to 65536 (default 1024)\n"
    "      --max-requests N       requests in flight on a connection, 1 to 4096 (default 64)\n"
    "      --user-connections N   connections of a user, 1 to 65536 (default three quarters of --max-clients,\n"
    "                             but 16)\n"
    "      --user-requests N      requests in flight of a user, 1 to 65536 (default 1024)\n"
    "      --user-bytes N         memory for a user's payloads, and as much for the user's frames at work; K, M, G\n"
    "                             may follow (default what keeps some for others)\n"
    "      --user-fds N           descriptors of a user: connections, what requests bring, memfds of results not\n"
    "                             yet sent; 8 to 1048576 (default three quarters of what RLIMIT_NOFILE leaves)\n"
    "      --asset-bytes N        memory for the images that requests name by digest, decoded; K, M, G may\n"
    "                             follow (default 256M, at most a sixteenth of --memory-bytes)\n"
    "      --timeout-s N          seconds for a HELLO, a stalled upload, a reply not read (default 60)\n"
    "      --lifetime-fd N        stop when this inherited pipe's other end is closed\n"
    "      --wall FILE            drive this LED wall, airy-wall(5), from the start; up to 4\n"
    "      --warm WORD            draw with all pipelines before the first request, with the common ones\n"
    "                             only, or then with the others when idle (default idle; common with\n"
    "                             --lifetime-fd, where somebody waits)\n"
    "      --validate             Vulkan validation; any message makes the exit status 4\n"
    "      --verbose              a line for each connection and error\n"
    "      --help, --version\n";

enum option_id {
    OPT_SOCKET = 1,
    OPT_DEVICE,
    OPT_LIST,
    OPT_THREADS,
    OPT_SLOTS,
    OPT_FRAME,
    OPT_CLIENTS,
    OPT_REQUESTS,
    OPT_TIMEOUT,
    OPT_ASSETS,
    OPT_MEMORY,
    OPT_USER_CONNECTIONS,
    OPT_USER_REQUESTS,
    OPT_USER_BYTES,
    OPT_USER_FDS,
    OPT_LIFETIME,
    OPT_WALL,
    OPT_WARM,
    OPT_VALIDATE,
    OPT_VERBOSE,
    OPT_HELP,
    OPT_VERSION
};

static const struct option options_known[] = {
    { "socket", required_argument, NULL, OPT_SOCKET },
    { "device", required_argument, NULL, OPT_DEVICE },
    { "list-devices", no_argument, NULL, OPT_LIST },
    { "threads", required_argument, NULL, OPT_THREADS },
    { "slots", required_argument, NULL, OPT_SLOTS },
    { "max-frame-bytes", required_argument, NULL, OPT_FRAME },
    { "max-clients", required_argument, NULL, OPT_CLIENTS },
    { "max-requests", required_argument, NULL, OPT_REQUESTS },
    { "timeout-s", required_argument, NULL, OPT_TIMEOUT },
    { "asset-bytes", required_argument, NULL, OPT_ASSETS },
    { "memory-bytes", required_argument, NULL, OPT_MEMORY },
    { "user-connections", required_argument, NULL, OPT_USER_CONNECTIONS },
    { "user-requests", required_argument, NULL, OPT_USER_REQUESTS },
    { "user-bytes", required_argument, NULL, OPT_USER_BYTES },
    { "user-fds", required_argument, NULL, OPT_USER_FDS },
    { "lifetime-fd", required_argument, NULL, OPT_LIFETIME },
    { "wall", required_argument, NULL, OPT_WALL },
    { "warm", required_argument, NULL, OPT_WARM },
    { "validate", no_argument, NULL, OPT_VALIDATE },
    { "verbose", no_argument, NULL, OPT_VERBOSE },
    { "help", no_argument, NULL, OPT_HELP },
    { "version", no_argument, NULL, OPT_VERSION },
    { NULL, 0, NULL, 0 },
};

// Exits when the option's value is no number in [min, max].
static uint64_t number(const char *name, const char *text, uint64_t min, uint64_t max)
{
    char *end = NULL;
    errno = 0;
    unsigned long long n = text[0] >= '0' && text[0] <= '9' ? strtoull(text, &end, 10) : 0;
    unsigned shift = 0;
    if (end && *end && !end[1])
        shift = *end == 'K' ? 10 : *end == 'M' ? 20 : *end == 'G' ? 30 : 0;
    if (end && shift)
        end++;
    if (end && !*end && !errno && n <= UINT64_MAX >> shift && n << shift >= min && n << shift <= max)
        return n << shift;
    fprintf(stderr, "airyd: --%s: \"%s\"; expected a whole number from %llu to %llu\n", name, text,
            (unsigned long long)min, (unsigned long long)max);
    exit(EXIT_USAGE);
}

static void take_option(struct options *o, int id, const char *arg)
{
    switch (id) {
    case OPT_SOCKET: o->socket = arg; break;
    case OPT_DEVICE: o->device = arg; break;
    case OPT_LIST: bloom_list_devices(print_line); exit(fflush(stdout) ? EXIT_FAILURE : EXIT_SUCCESS);
    case OPT_THREADS: o->threads = number("threads", arg, 1, SCHED_THREADS_MAX); break;
    case OPT_SLOTS: o->slots = number("slots", arg, 1, SCHED_SLOTS_MAX); break;
    case OPT_FRAME: o->max_frame_bytes = number("max-frame-bytes", arg, 4096, UINT64_C(1) << 40); break;
    case OPT_CLIENTS: o->max_clients = number("max-clients", arg, 1, 65536); break;
    case OPT_REQUESTS: o->max_requests = number("max-requests", arg, 1, 4096); break;
    case OPT_TIMEOUT: o->timeout_s = number("timeout-s", arg, 1, 86400); break;
    case OPT_ASSETS: o->asset_bytes = number("asset-bytes", arg, 4096, UINT64_C(1) << 40); break;
    case OPT_MEMORY: o->memory_bytes = number("memory-bytes", arg, 4096, UINT64_C(1) << 44); break;
    case OPT_USER_CONNECTIONS: o->user_connections = number("user-connections", arg, 1, 65536); break;
    case OPT_USER_REQUESTS: o->user_requests = number("user-requests", arg, 1, 65536); break;
    case OPT_USER_BYTES: o->user_bytes = number("user-bytes", arg, 4096, UINT64_C(1) << 44); break;
    case OPT_USER_FDS: o->user_fds = number("user-fds", arg, 8, 1 << 20); break;
    case OPT_LIFETIME:
        o->lifetime_fd = (int)number("lifetime-fd", arg, 0, INT_MAX);
        if (fcntl(o->lifetime_fd, F_SETFD, FD_CLOEXEC) < 0) {
            fprintf(stderr, "airyd: --lifetime-fd: descriptor %d is not open\n", o->lifetime_fd);
            exit(EXIT_USAGE);
        }
        break;
    case OPT_WALL:
        if (o->n_walls == WALLS_MAX) {
            fprintf(stderr, "airyd: --wall: \"%s\" is one too many; at most %d are driven\n", arg, WALLS_MAX);
            exit(EXIT_USAGE);
        }
        o->wall[o->n_walls++] = arg;
        break;
    case OPT_WARM:
        if (strcmp(arg, "all") && strcmp(arg, "common") && strcmp(arg, "idle")) {
            fprintf(stderr, "airyd: --warm: \"%s\"; expected all, common or idle\n", arg);
            exit(EXIT_USAGE);
        }
        o->warm = arg;
        break;
    case OPT_VALIDATE: o->validate = true; break;
    case OPT_VERBOSE: o->verbose = true; break;
    case OPT_HELP: fputs(usage, stdout); exit(EXIT_SUCCESS);
    case OPT_VERSION: puts("airyd " AIRY_VERSION); exit(EXIT_SUCCESS);
    default: fputs("airyd: see airyd --help\n", stderr); exit(EXIT_USAGE);
    }
}

static void read_options(struct options *o, int argc, char **argv)
{
    int id;
    // getopt's own messages name the option.
    while ((id = getopt_long(argc, argv, "", options_known, NULL)) != -1)
        take_option(o, id, optarg);
    if (optind < argc) {
        fprintf(stderr, "airyd: \"%s\": no such argument; see airyd --help\n", argv[optind]);
        exit(EXIT_USAGE);
    }
}

static uint64_t least(uint64_t a, uint64_t b) { return a < b ? a : b; }
static uint64_t most(uint64_t a, uint64_t b) { return a > b ? a : b; }

static unsigned cpus(void)
{
    cpu_set_t set;
    int n = sched_getaffinity(0, sizeof set, &set) == 0 ? CPU_COUNT(&set) : 1;
    return n > SCHED_THREADS_MAX ? SCHED_THREADS_MAX : (unsigned)n;
}

/*
 * The ceiling, shared out: caches and the program itself; payloads that come inline; payloads that are read; all that is at work. Each
 * pool of payloads takes the largest frame at least, so that nothing that may be sent can never be taken. Exits when too little is left.
 */
static void share_memory(struct server_config *c, const struct options *o, uint64_t all)
{
    // The device's driver and its code; chunks that the codec keeps for the next frame (exr_arena.c).
    const uint64_t ceiling = o->memory_bytes ? o->memory_bytes : all / 4 * 3, sixth = ceiling / 6;
    const uint64_t program = UINT64_C(256) << 20, chunks = least(UINT64_C(512) << 20, ceiling / 8);
    const uint64_t frame = o->max_frame_bytes ? o->max_frame_bytes : least(UINT64_C(2) << 30, ceiling / 8);
    const uint64_t inline_bytes = most(frame, sixth), load = most(frame, sixth);
    c->memory_bytes = ceiling;
    c->limits.max_frame_bytes = frame;
    c->idle_bytes_max = least(UINT64_C(1) << 30, ceiling / 16);
    c->asset_bytes_max = o->asset_bytes ? o->asset_bytes : least(UINT64_C(256) << 20, ceiling / 16);
    // An image that is to be kept is decoded beside those that are.
    c->reserved_bytes = program + chunks + c->idle_bytes_max + 2 * c->asset_bytes_max;
    const uint64_t rest = c->reserved_bytes + inline_bytes + load, little = UINT64_C(16) << 20;
    if (ceiling < rest + little) {
        fprintf(stderr, "airyd: --memory-bytes: %llu; expected at least %llu with this --max-frame-bytes and --asset-bytes\n",
                (unsigned long long)ceiling, (unsigned long long)(rest + little));
        exit(EXIT_USAGE);
    }
    const uint64_t work = ceiling - rest, user = o->user_bytes ? o->user_bytes : UINT64_MAX;
    exr_cache_limit(chunks);
    c->held_bytes_max = inline_bytes;
    c->sched.limits = (struct sched_limits){ .work_bytes = work,
                                             .load_bytes = load,
                                             .user_work_bytes = least(user, work / 4 * 3),
                                             .user_inline_bytes = least(user, most(frame, inline_bytes / 4 * 3)),
                                             .user_requests = (uint32_t)o->user_requests };
}

// Of a frame's bloom, what the host does: kernels, and walls on a CPU device. Beyond a few, memory is what it waits for.
static unsigned host_threads(const struct options *o)
{
    const unsigned threads = o->threads ? (unsigned)o->threads : cpus(), most = 8;
    return threads < 2 ? 2 : threads > most ? most : threads;
}

// Fewer connections than were asked for are a fact that whoever runs this wants to know.
static struct fd_share share_fds(const struct options *o)
{
    const uint64_t limit = machine_raise_fds();
    const struct fd_share fds = machine_share_fds(limit, o->max_clients, o->user_fds);
    char line[160];
    if (fds.clients < o->max_clients) {
        snprintf(line, sizeof line, "RLIMIT_NOFILE of %llu leaves descriptors for %u connections, not the %llu of --max-clients",
                 (unsigned long long)limit, fds.clients, (unsigned long long)o->max_clients);
        say(line);
    }
    return fds;
}

static void configure(struct server_config *c, const struct options *o)
{
    const char *warm = o->warm ? o->warm : o->lifetime_fd < 0 ? "idle" : "common";
    uint64_t memory = machine_memory_bytes(), gib = UINT64_C(1) << 30;
    uint32_t timeout_ms = (uint32_t)o->timeout_s * 1000;
    const struct fd_share fds = share_fds(o);
    *c = (struct server_config){
        .sched = { .threads = o->threads ? (unsigned)o->threads : cpus(),
                   .slots = (unsigned)o->slots,
                   .device = { .device = o->device, .threads = host_threads(o), .validate = o->validate,
                               .warm_all = !strcmp(warm, "all"), .log = say },
                   .warm_idle = !strcmp(warm, "idle"),
                   .log = say },
        .limits = { .exr = { .max_width = 16384,
                             .max_height = 16384,
                             .max_pixels = least(UINT64_C(16384) * 16384, memory / 48),
                             .max_decoded_bytes = memory / 4 } },
        .max_requests = (uint32_t)o->max_requests,
        .max_clients = fds.clients,
        .max_jobs = fds.jobs,
        .user_connections = o->user_connections ? (unsigned)o->user_connections
                                                : (unsigned)least(fds.clients, most(16, fds.clients / 4 * 3)),
        .timeouts = { .hello = timeout_ms, .write = timeout_ms, .upload = timeout_ms, .linger = 1000 },
        .n_walls = o->n_walls,
        .lifetime_fd = o->lifetime_fd,
        .log = say,
        .verbose = o->verbose,
    };
    memcpy(c->wall, o->wall, sizeof c->wall);
    share_memory(c, o, memory);
    c->sched.limits.fds = fds.all;
    c->sched.limits.user_fds = fds.user;
    // The largest frame must fit, or nobody could ever send it.
    c->credit_bytes = most(c->limits.max_frame_bytes, least(gib, c->memory_bytes / 8));
}

static int open_listener(struct listener *l, const struct options *o, struct fault *f)
{
    char path[sizeof l->path];
    if (listener_from_systemd(l, f) < 0)
        return -1;
    if (l->count) {
        if (!o->socket)
            return 0;
        return fault_set(f, FAULT_INTERNAL, "--socket", "\"%.200s\", and systemd passed %u sockets; expected one "
                                                        "or the other",
                         o->socket, l->count);
    }
    if (o->socket)
        return listener_bind(l, o->socket, f);
    return listener_default_path(path, sizeof path, f) < 0 ? -1 : listener_bind(l, path, f);
}

static int run(const struct options *o)
{
    struct server_config config;
    struct server *server = NULL;
    struct listener listener = { .lock_fd = -1 };
    struct fault f = { .code = FAULT_NONE };
    configure(&config, o);
    if (open_listener(&listener, o, &f) < 0 || server_create(&server, &config, &listener, &f) < 0) {
        say_fault(&f);
        listener_finish(&listener);
        return EXIT_FAILURE;
    }
    char line[800];
    const struct bloom_device_info *d = server_device(server);
    snprintf(line, sizeof line, "ready on %s: %s (%s), %u codec threads, %u slots",
             listener.path[0] ? listener.path : "systemd's socket", d->name, d->driver, config.sched.threads,
             config.sched.slots);
    say(line);
    sd_notifyf(0, "READY=1\nSTATUS=%s", line);
    int status = server_run(server);
    unsigned messages = server_validation_messages(server);
    server_destroy(server);
    if (messages) {
        snprintf(line, sizeof line, "%u Vulkan validation messages", messages);
        say(line);
        status = status ? status : EXIT_VALIDATION;
    }
    say("stopped");
    return status;
}

int main(int argc, char **argv)
{
    struct options o = {
        .slots = 3, .max_clients = 1024, .max_requests = 64, .timeout_s = 60, .user_requests = 1024,
        .lifetime_fd = -1
    };
    read_options(&o, argc, argv);
    return run(&o);
}
