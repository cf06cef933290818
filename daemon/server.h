/* SPDX-License-Identifier: Apache-2.0 */
/*
 * server.h - the socket thread: one epoll over listening sockets, clients, signals and the scheduler's
 * events. It never waits for anything else: no file, no device, no codec, no lock held for long. So
 * STATUS is answered at any load.
 */
#ifndef AIRYD_SERVER_H
#define AIRYD_SERVER_H

#include "client.h"
#include "listener.h"
#include "scheduler.h"

struct server;

struct server_config {
    struct sched_config sched;
    struct job_limits limits; /* widths and heights are lowered to what the device can do */
    uint64_t memory_bytes, reserved_bytes; /* the ceiling, and what of it is not for payloads and frames; the rest is shared out: */
    uint64_t held_bytes_max;               /* inline payloads; sched.limits has the loads and the work */
    uint64_t credit_bytes, idle_bytes_max, asset_bytes_max;
    uint32_t max_requests;
    unsigned max_clients, max_jobs, user_connections;
    struct client_timeouts timeouts;
    const char *wall[WALLS_MAX]; /* files of definitions that are opened at the start */
    unsigned n_walls;
    int lifetime_fd; /* -1: none; end of file there is as SIGTERM. The server's to close. */
    void (*log)(const char *line);
    bool verbose;
};

/* Opens the device, starts the threads, blocks SIGTERM, SIGINT and SIGHUP in all of them. Takes over
 * *l. 0, or -1 and *f. */
int server_create(struct server **out, const struct server_config *config, struct listener *l,
                  struct fault *f);
/* Until stopped and everything in hand is replied to. Returns the process's exit status. */
int server_run(struct server *s);
void server_destroy(struct server *s); /* NULL is fine */
const struct bloom_device_info *server_device(const struct server *s);
/* After server_run: what Vulkan's validation had to say, over all devices. */
unsigned server_validation_messages(struct server *s);

#endif
