/* SPDX-License-Identifier: Apache-2.0 */
/*
 * machine.h - what this process may use of the machine: memory, by its control groups, and descriptors, by its limit. Asked once, at
 * the start; what is shared out from it (main.c) holds from then on.
 */
#ifndef AIRYD_MACHINE_H
#define AIRYD_MACHINE_H

#include <stdint.h>

/* Of the machine's memory what every control group leaves that this process is in: systemd's MemoryMax= and MemoryHigh=, a container's limit. */
uint64_t machine_memory_bytes(void);
/* The same, of a machine with `all` bytes, its /proc and /sys below `root` ("": the real ones). */
uint64_t machine_memory_under(const char *root, uint64_t all);

/* Raises RLIMIT_NOFILE to what this process may have. Returns it. */
uint64_t machine_raise_fds(void);

struct fd_share {
    unsigned clients; /* connections: what was asked for, or what the limit leaves */
    unsigned jobs;    /* requests at a time */
    uint32_t all;     /* connections, what requests bring, and results that are not yet sent */
    uint32_t user;    /* of these a user's */
};
/* clients, user_fds (0: what keeps some for others): as asked for. */
struct fd_share machine_share_fds(uint64_t limit, uint64_t clients, uint64_t user_fds);

#endif
