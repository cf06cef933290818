// SPDX-License-Identifier: Apache-2.0
// machine.c - see machine.h.
//
// A control group's limit holds for all below it, so the least on the way from the process's own group to the root counts. Both
// hierarchies are asked: the unified one, and the older one's memory controller. In a container the path in /proc may be the host's, which is
// not there: such groups are passed over, and the root, which is then the container's own, is asked in any case.
#include "machine.h"

#include <errno.h>
#include <limits.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

static uint64_t least(uint64_t a, uint64_t b) { return a < b ? a : b; }
static uint64_t most(uint64_t a, uint64_t b) { return a > b ? a : b; }

// ---- memory --------------------------------------------------------------------------------------------

// "max", which is no number, and a file that is not there limit nothing.
static uint64_t limit_of(const char *folder, const char *name)
{
    char path[2 * PATH_MAX], text[32] = "", *end;
    snprintf(path, sizeof path, "%s/%s", folder, name);
    FILE *file = fopen(path, "re");
    if (!file)
        return UINT64_MAX;
    bool some = fgets(text, sizeof text, file) != NULL;
    fclose(file);
    errno = 0;
    unsigned long long bytes = some && text[0] >= '0' && text[0] <= '9' ? strtoull(text, &end, 10) : ULLONG_MAX;
    return errno || bytes == ULLONG_MAX || (*end && *end != '\n') ? UINT64_MAX : bytes;
}

// The group's path is cut from its end on, down to the mount itself.
static uint64_t least_above(const char *mount, char *group, const char *const names[2])
{
    uint64_t bytes = UINT64_MAX;
    for (;;) {
        char folder[PATH_MAX];
        const int n = snprintf(folder, sizeof folder, "%s%s", mount, group);
        for (unsigned i = 0; i < 2 && names[i] && n < PATH_MAX; i++)
            bytes = least(bytes, limit_of(folder, names[i]));
        char *slash = strrchr(group, '/');
        if (!slash)
            return bytes;
        *slash = 0;
    }
}

static bool has_word(const char *list, const char *word)
{
    const size_t n = strlen(word);
    for (const char *at = list; (at = strstr(at, word)); at += n)
        if ((at == list || at[-1] == ',') && (at[n] == ',' || !at[n]))
            return true;
    return false;
}

// One line of /proc/self/cgroup: number:controllers:path; no controllers: the unified hierarchy.
static uint64_t limit_by_line(const char *root, char *line)
{
    static const char *const unified[2] = { "memory.max", "memory.high" }, *const old[2] = { "memory.limit_in_bytes", NULL };
    line[strcspn(line, "\n")] = 0;
    char *controllers = strchr(line, ':'), *group = controllers ? strchr(controllers + 1, ':') : NULL, mount[PATH_MAX];
    if (!group || group[1] != '/')
        return UINT64_MAX;
    *group++ = 0;
    const bool is_unified = !*++controllers;
    if (!is_unified && !has_word(controllers, "memory"))
        return UINT64_MAX;
    snprintf(mount, sizeof mount, "%s/sys/fs/cgroup%s", root, is_unified ? "" : "/memory");
    return least_above(mount, group, is_unified ? unified : old);
}

uint64_t machine_memory_under(const char *root, uint64_t all)
{
    char path[PATH_MAX], line[PATH_MAX];
    uint64_t bytes = all;
    snprintf(path, sizeof path, "%s/proc/self/cgroup", root);
    FILE *file = fopen(path, "re");
    while (file && fgets(line, sizeof line, file))
        bytes = least(bytes, limit_by_line(root, line));
    if (file)
        fclose(file);
    return bytes;
}

uint64_t machine_memory_bytes(void)
{
    return machine_memory_under("", (uint64_t)sysconf(_SC_PHYS_PAGES) * (uint64_t)sysconf(_SC_PAGESIZE));
}

// ---- descriptors ---------------------------------------------------------------------------------------

// OWN: the program's own, a wall's boards, and what one message may bring before it is refused.
enum { OWN_FDS = 256, REQUEST_FDS = 3, MESSAGE_FDS = 2, JOBS_MIN = 16, JOBS_MAX = 65536 };

uint64_t machine_raise_fds(void)
{
    struct rlimit limit = { .rlim_cur = 1024 };
    if (getrlimit(RLIMIT_NOFILE, &limit) == 0) {
        limit.rlim_cur = limit.rlim_max;
        setrlimit(RLIMIT_NOFILE, &limit);
        getrlimit(RLIMIT_NOFILE, &limit);
    }
    return limit.rlim_cur;
}

struct fd_share machine_share_fds(uint64_t limit, uint64_t clients, uint64_t user_fds)
{
    const uint64_t room = limit > OWN_FDS ? least(limit - OWN_FDS, UINT32_MAX) : 0;
    struct fd_share s = { .clients = (unsigned)most(1, least(clients, room / 4 * 3)) };
    // Of messages that are half here nobody counts the descriptors; who waits with one in every connection finds them set aside.
    const uint64_t all = room - least((uint64_t)MESSAGE_FDS * s.clients, room / 4);
    const uint64_t spare = all > s.clients ? all - s.clients : 0;
    s.jobs = (unsigned)most(JOBS_MIN, least(spare / REQUEST_FDS, JOBS_MAX));
    s.all = (uint32_t)all;
    s.user = (uint32_t)(user_fds ? least(user_fds, all) : all / 4 * 3);
    return s;
}
