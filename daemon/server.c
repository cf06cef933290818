// SPDX-License-Identifier: Apache-2.0
// server.c - see server.h.
#include "server.h"

#include "wall_file.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/signalfd.h>
#include <sys/socket.h>
#include <systemd/sd-daemon.h>
#include <unistd.h>

enum { TICK_MS = 250, ACCEPT_ONCE = 64, EVENTS_ONCE = 64, FEEDS = 4, EXIT_DEVICE_LOST = 3 };

enum watch_kind { WATCH_LISTEN, WATCH_CLIENT, WATCH_SIGNAL, WATCH_SCHED, WATCH_LIFETIME };

struct watch {
    enum watch_kind kind;
    int fd;
    uint32_t events; // as epoll has them
    struct client *client;
    TAILQ_ENTRY(watch) link; // clients
    TAILQ_ENTRY(watch) of_busy;
    bool busy;
};
TAILQ_HEAD(watch_list, watch);

struct server {
    struct client_host host;
    struct listener *listener;
    struct watch listen[LISTENER_FDS_MAX], signals, sched, lifetime;
    bool accepting, starved; // starved: no descriptor was left for who comes, and the log says so
    int epoll_fd;
    unsigned max_clients;
    struct watch_list clients, dead;
    struct watch_list busy; // of clients, by of_busy: all that have something in hand; of 10,000 that only listen none is looked at
    uint64_t tick_ns;
    uint64_t watchdog_ns, fed_ns; // watchdog_ns: what systemd grants; 0: nobody watches
    bool stuck;
    int exit_status;
    void (*log)(const char *line);
};

// ---- epoll -----------------------------------------------------------------------------------------

static int watch(struct server *s, struct watch *w, uint32_t events)
{
    struct epoll_event e = { .events = events, .data.ptr = w };
    w->events = events;
    return epoll_ctl(s->epoll_fd, EPOLL_CTL_ADD, w->fd, &e) < 0 ? -errno : 0;
}

static void unwatch(struct server *s, struct watch *w) { epoll_ctl(s->epoll_fd, EPOLL_CTL_DEL, w->fd, NULL); }

static void note_busy(struct server *s, struct watch *w, bool busy)
{
    if (busy == w->busy)
        return;
    w->busy = busy;
    if (busy)
        TAILQ_INSERT_TAIL(&s->busy, w, of_busy);
    else
        TAILQ_REMOVE(&s->busy, w, of_busy);
}

static void client_bury(struct server *s, struct watch *w)
{
    note_busy(s, w, false);
    client_destroy(w->client);
    w->client = NULL;
    TAILQ_REMOVE(&s->clients, w, link);
    TAILQ_INSERT_TAIL(&s->dead, w, link);
}

// After anything that a client did or was done to it. Its watch stays until the loop's events, which
// may name it, are all handled.
static void client_update(struct server *s, struct watch *w)
{
    if (!w->client)
        return;
    if (client_dead(w->client)) {
        unwatch(s, w);
        client_bury(s, w);
        return;
    }
    note_busy(s, w, !client_idle(w->client));
    uint32_t events = client_events(w->client);
    if (events == w->events)
        return;
    struct epoll_event e = { .events = events, .data.ptr = w };
    w->events = events;
    epoll_ctl(s->epoll_fd, EPOLL_CTL_MOD, w->fd, &e);
}

static void each_client(struct server *s, void (*act)(struct client *c))
{
    struct watch *w, *next;
    for (w = TAILQ_FIRST(&s->clients); w; w = next) {
        next = TAILQ_NEXT(w, link);
        act(w->client);
        client_update(s, w);
    }
}

static void reap(struct server *s)
{
    struct watch *w;
    while ((w = TAILQ_FIRST(&s->dead))) {
        TAILQ_REMOVE(&s->dead, w, link);
        free(w);
    }
}

// ---- accept ----------------------------------------------------------------------------------------

static void listen_pause(struct server *s, bool pause)
{
    if (s->accepting != pause)
        return;
    s->accepting = !pause;
    for (unsigned i = 0; i < s->listener->count; i++)
        if (pause)
            unwatch(s, &s->listen[i]);
        else
            watch(s, &s->listen[i], EPOLLIN);
}

static void client_add(struct server *s, int fd)
{
    struct watch *w = calloc(1, sizeof *w);
    if (!w) {
        close(fd);
        return;
    }
    w->kind = WATCH_CLIENT;
    w->fd = fd;
    w->client = client_create(&s->host, fd);
    if (!w->client) {
        free(w);
        return;
    }
    TAILQ_INSERT_TAIL(&s->clients, w, link);
    if (watch(s, w, EPOLLIN) < 0) {
        client_bury(s, w);
        return;
    }
    client_update(s, w); // it may have been turned away
}

// With no room for more, those who come wait in the kernel's backlog until the next tick.
static void on_listen(struct server *s, int listen_fd)
{
    for (int i = 0; i < ACCEPT_ONCE; i++) {
        if (s->host.clients >= s->max_clients) {
            listen_pause(s, true);
            return;
        }
        int fd = accept4(listen_fd, NULL, NULL, SOCK_CLOEXEC | SOCK_NONBLOCK);
        if (fd >= 0) {
            s->starved = false;
            client_add(s, fd);
            continue;
        }
        if (errno == EINTR || errno == ECONNABORTED)
            continue;
        if (errno != EAGAIN && errno != EWOULDBLOCK) {
            char line[128];
            snprintf(line, sizeof line, "accept: %s; trying again", strerror(errno));
            if (!s->starved)
                s->log(line);
            s->starved = true;
            listen_pause(s, true);
        }
        return;
    }
}

// ---- stop ------------------------------------------------------------------------------------------

static void drain(struct server *s, const char *why)
{
    if (s->host.draining)
        return;
    s->host.draining = true;
    char line[160];
    snprintf(line, sizeof line, "%s: finishing %u requests, taking no more", why, s->host.jobs);
    s->log(line);
    sd_notify(0, "STOPPING=1");
    listen_pause(s, true);
    listener_finish(s->listener);
    each_client(s, client_drain);
}

// Nothing is read again, for nothing is kept in a file of ours; whoever waits for the end of it is told.
static void reload(struct server *s)
{
    if (s->host.draining)
        return;
    sd_notifyf(0, "RELOADING=1\nMONOTONIC_USEC=%llu", (unsigned long long)(clock_ns() / 1000));
    s->log("SIGHUP: there is nothing to read again");
    sd_notify(0, "READY=1");
}

static void on_signal(struct server *s)
{
    struct signalfd_siginfo info;
    while (read(s->signals.fd, &info, sizeof info) == sizeof info) {
        if (info.ssi_signo == SIGHUP) {
            reload(s);
            continue;
        }
        if (s->host.draining) {
            s->log("second signal: exiting at once");
            _exit(EXIT_FAILURE);
        }
        drain(s, info.ssi_signo == SIGINT ? "SIGINT" : "SIGTERM");
    }
}

static void on_lifetime(struct server *s)
{
    char waste[64];
    ssize_t n = read(s->lifetime.fd, waste, sizeof waste);
    if (n > 0 || (n < 0 && (errno == EAGAIN || errno == EINTR)))
        return;
    unwatch(s, &s->lifetime);
    drain(s, "the starter has gone");
}

// True when nothing is left to do. Who has got all its replies is let go, with time to read them.
static bool drained(struct server *s)
{
    if (!s->host.draining || s->host.jobs)
        return false;
    struct watch *w, *next;
    for (w = TAILQ_FIRST(&s->clients); w; w = next) {
        next = TAILQ_NEXT(w, link);
        if (client_idle(w->client))
            client_hangup(w->client);
        client_update(s, w);
    }
    return TAILQ_EMPTY(&s->clients);
}

// ---- loop ------------------------------------------------------------------------------------------

static void on_sched(struct server *s)
{
    sched_event_clear(s->host.sched);
    struct watch *w, *next;
    TAILQ_FOREACH(w, &s->busy, of_busy)
    client_progress(w->client);
    struct job *j;
    while ((j = sched_done(s->host.sched)))
        client_job_done(&s->host, j);
    // Replies change what their clients wait for.
    for (w = TAILQ_FIRST(&s->busy); w; w = next) {
        next = TAILQ_NEXT(w, of_busy);
        client_update(s, w);
    }
    if (sched_counts(s->host.sched).device_dead && !s->host.draining) {
        s->exit_status = EXIT_DEVICE_LOST;
        drain(s, "a Vulkan device is lost for good");
    }
}

static void tick(struct server *s)
{
    uint64_t now = clock_ns();
    if (now - s->tick_ns < (uint64_t)TICK_MS * 1000000)
        return;
    s->tick_ns = now;
    struct watch *w, *next;
    for (w = TAILQ_FIRST(&s->clients); w; w = next) {
        next = TAILQ_NEXT(w, link);
        client_tick(w->client, now);
        client_update(s, w);
    }
    if (!s->host.draining)
        listen_pause(s, false);
}

static void handle(struct server *s, struct watch *w, uint32_t events)
{
    switch (w->kind) {
    case WATCH_LISTEN:
        if (s->accepting)
            on_listen(s, w->fd);
        break;
    case WATCH_CLIENT:
        if (!w->client)
            break;
        client_event(w->client, events);
        client_update(s, w);
        break;
    case WATCH_SIGNAL: on_signal(s); break;
    case WATCH_SCHED: on_sched(s); break;
    case WATCH_LIFETIME: on_lifetime(s); break;
    }
}

// This loop would feed the watchdog for ever while a driver hangs: it does so only while the device makes progress, or has
// nothing to do. A device that has a step longer than WatchdogSec= is given up at once, not another WatchdogSec= later.
static void watchdog_feed(struct server *s)
{
    uint64_t now = clock_ns();
    if (!s->watchdog_ns || (s->fed_ns && now - s->fed_ns < s->watchdog_ns / FEEDS))
        return;
    s->fed_ns = now;
    uint64_t since = sched_device_since_ns(s->host.sched);
    bool stuck = since && now > since && now - since > s->watchdog_ns;
    if (stuck && !s->stuck) {
        char line[160];
        snprintf(line, sizeof line, "the device has made no progress for %.1f s, the watchdog grants %.1f s: giving up",
                 (double)(now - since) / 1e9, (double)s->watchdog_ns / 1e9);
        s->log(line);
    }
    s->stuck = stuck;
    sd_notify(0, stuck ? "WATCHDOG=trigger" : "WATCHDOG=1");
}

// Late jobs end now; how long there is nothing to do but for what comes.
static int until_next(struct server *s)
{
    uint64_t now = clock_ns(), next = sched_expire(s->host.sched, now), wait_ns = UINT64_MAX;
    if (!TAILQ_EMPTY(&s->clients) || (!s->accepting && !s->host.draining))
        wait_ns = (uint64_t)TICK_MS * 1000000;
    if (next && next - now < wait_ns)
        wait_ns = next - now;
    if (s->watchdog_ns && s->watchdog_ns / FEEDS < wait_ns)
        wait_ns = s->watchdog_ns / FEEDS;
    if (wait_ns == UINT64_MAX)
        return -1;
    uint64_t ms = wait_ns / 1000000 + 1;
    return ms > INT_MAX ? INT_MAX : (int)ms;
}

static void note_turn(struct server *s, uint64_t from_ns)
{
    struct metrics *m = &s->host.metrics;
    double ms = (double)(clock_ns() - from_ns) / 1e6;
    m->loop_turns++;
    m->loop_worst_ms = ms > m->loop_worst_ms ? ms : m->loop_worst_ms;
}

int server_run(struct server *s)
{
    while (!drained(s)) {
        watchdog_feed(s);
        struct epoll_event events[EVENTS_ONCE];
        int n = epoll_wait(s->epoll_fd, events, EVENTS_ONCE, until_next(s));
        uint64_t from_ns = clock_ns();
        if (n < 0 && errno != EINTR) {
            s->log("epoll_wait failed");
            return EXIT_FAILURE;
        }
        for (int i = 0; i < n; i++)
            handle(s, events[i].data.ptr, events[i].events);
        tick(s);
        reap(s);
        note_turn(s, from_ns);
    }
    return s->exit_status;
}

// ---- life ------------------------------------------------------------------------------------------

// Blocked before the threads start, so that all of them have it so and the signals come by signals.fd alone.
static int open_signals(struct server *s, struct fault *f)
{
    sigset_t set;
    sigemptyset(&set);
    sigaddset(&set, SIGTERM);
    sigaddset(&set, SIGINT);
    sigaddset(&set, SIGHUP);
    // What they tell of is an error of the write, too: it costs the one result.
    signal(SIGPIPE, SIG_IGN);
    signal(SIGXFSZ, SIG_IGN);
    if (pthread_sigmask(SIG_BLOCK, &set, NULL))
        return fault_set(f, FAULT_INTERNAL, "", "pthread_sigmask failed");
    s->signals = (struct watch){ .kind = WATCH_SIGNAL };
    s->signals.fd = signalfd(-1, &set, SFD_NONBLOCK | SFD_CLOEXEC);
    return s->signals.fd < 0 ? fault_set(f, FAULT_INTERNAL, "", "signalfd: %s", strerror(errno)) : 0;
}

static int open_watches(struct server *s, struct fault *f)
{
    s->epoll_fd = epoll_create1(EPOLL_CLOEXEC);
    int rc = s->epoll_fd < 0 ? -errno : watch(s, &s->signals, EPOLLIN);
    s->sched = (struct watch){ .kind = WATCH_SCHED, .fd = sched_event_fd(s->host.sched) };
    if (!rc)
        rc = watch(s, &s->sched, EPOLLIN);
    for (unsigned i = 0; i < s->listener->count && !rc; i++) {
        s->listen[i] = (struct watch){ .kind = WATCH_LISTEN, .fd = s->listener->fd[i] };
        rc = watch(s, &s->listen[i], EPOLLIN);
    }
    s->accepting = true;
    if (!rc && s->lifetime.fd >= 0) {
        int flags = fcntl(s->lifetime.fd, F_GETFL);
        rc = flags < 0 || fcntl(s->lifetime.fd, F_SETFL, flags | O_NONBLOCK) < 0 ? -errno : 0;
        if (!rc && (rc = watch(s, &s->lifetime, EPOLLIN)))
            return fault_set(f, FAULT_INTERNAL, "--lifetime-fd", "descriptor %d: %s (expected a pipe or a socket)",
                             s->lifetime.fd, strerror(-rc));
    }
    return rc ? fault_set(f, FAULT_INTERNAL, "", "watching descriptors: %s", strerror(-rc)) : 0;
}

static void host_init(struct server *s, const struct server_config *config)
{
    struct client_host *h = &s->host;
    const struct bloom_device_info *d = sched_device(h->sched);
    metrics_init(&h->metrics);
    h->timeout = config->timeouts;
    h->held_bytes_max = config->held_bytes_max;
    h->jobs_max = config->max_jobs;
    h->user_connections_max = config->user_connections;
    h->user_fds_max = config->sched.limits.user_fds;
    h->log = config->verbose ? config->log : NULL;
    h->job.limits = config->limits;
    h->job.blocks = &h->blocks;
    h->job.assets = &h->assets;
    h->job.walls = h->walls;
    struct exr_limits *e = &h->job.limits.exr;
    e->max_width = e->max_width < d->max_dimension ? e->max_width : d->max_dimension;
    e->max_height = e->max_height < d->max_dimension ? e->max_height : d->max_dimension;
    h->facts = (struct reply_facts){ .job = h->job.limits,
                                     .credit_bytes = config->credit_bytes,
                                     .max_requests = config->max_requests,
                                     .memory = { .ceiling = config->memory_bytes,
                                                 .reserved = config->reserved_bytes,
                                                 .inline_max = config->held_bytes_max,
                                                 .load_max = config->sched.limits.load_bytes,
                                                 .work_max = config->sched.limits.work_bytes },
                                     .device = *d };
    reply_clean(h->facts.device.name);
    reply_clean(h->facts.device.driver);
}

// The service's own walls. Their calibration is read as any image that a client sends.
static int open_walls(struct server *s, const struct server_config *config, struct fault *f)
{
    for (unsigned i = 0; i < config->n_walls; i++)
        if (wall_file_open(s->host.walls, &s->host.job, config->wall[i], f) < 0)
            return -1;
    return config->n_walls ? sched_open_walls(s->host.sched, f) : 0;
}

// systemd's WatchdogSec=; without it, or meant for another process, nothing is fed.
static int open_watchdog(struct server *s, struct fault *f)
{
    uint64_t us = 0;
    int rc = sd_watchdog_enabled(0, &us);
    if (rc < 0)
        return fault_set(f, FAULT_INTERNAL, "WATCHDOG_USEC", "\"%.40s\"; expected microseconds", getenv("WATCHDOG_USEC"));
    s->watchdog_ns = rc && us < UINT64_MAX / 1000 ? us * 1000 : 0;
    return 0;
}

int server_create(struct server **out, const struct server_config *config, struct listener *l, struct fault *f)
{
    struct server *s = calloc(1, sizeof *s);
    if (!s)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for the server");
    s->epoll_fd = s->signals.fd = -1;
    s->listener = l;
    s->max_clients = config->max_clients;
    s->log = config->log;
    s->lifetime = (struct watch){ .kind = WATCH_LIFETIME, .fd = config->lifetime_fd };
    TAILQ_INIT(&s->clients);
    TAILQ_INIT(&s->dead);
    TAILQ_INIT(&s->busy);
    block_pool_init(&s->host.blocks, config->idle_bytes_max);
    asset_cache_init(&s->host.assets, config->asset_bytes_max);
    if (open_watchdog(s, f) < 0 || open_signals(s, f) < 0 || walls_create(&s->host.walls, &s->host.assets, config->log, f) < 0 ||
        sched_create(&s->host.sched, &config->sched, f) < 0)
        goto fail;
    host_init(s, config);
    if (open_walls(s, config, f) < 0)
        goto fail;
    if (listener_listen(l, f) < 0 || open_watches(s, f) < 0)
        goto fail;
    *out = s;
    return 0;
fail:
    server_destroy(s);
    return -1;
}

void server_destroy(struct server *s)
{
    if (!s)
        return;
    struct watch *w;
    while ((w = TAILQ_FIRST(&s->clients))) {
        TAILQ_REMOVE(&s->clients, w, link);
        client_destroy(w->client);
        free(w);
    }
    reap(s);
    sched_destroy(s->host.sched);
    walls_destroy(s->host.walls);
    asset_cache_finish(&s->host.assets);
    block_pool_finish(&s->host.blocks);
    listener_finish(s->listener);
    if (s->lifetime.fd >= 0)
        close(s->lifetime.fd);
    if (s->signals.fd >= 0)
        close(s->signals.fd);
    if (s->epoll_fd >= 0)
        close(s->epoll_fd);
    free(s);
}

const struct bloom_device_info *server_device(const struct server *s) { return &s->host.facts.device; }

unsigned server_validation_messages(struct server *s) { return sched_validation_messages(s->host.sched); }
