// SPDX-License-Identifier: Apache-2.0
// test_machine.c - what the daemon takes the machine for: limits of control groups, in real files below a folder of this test, and how
// descriptors are shared out.
#include <errno.h>
#include <ftw.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <cmocka.h>

#include "machine.h"

static const uint64_t GIB = UINT64_C(1) << 30;
static char root[64];

static int remove_one(const char *path, const struct stat *st, int kind, struct FTW *at)
{
    (void)st;
    (void)kind;
    (void)at;
    return remove(path);
}

static int fresh(void **state)
{
    (void)state;
    strcpy(root, "/tmp/airyd-test-machine-XXXXXX");
    return mkdtemp(root) ? 0 : -1;
}

static int gone(void **state)
{
    (void)state;
    return nftw(root, remove_one, 16, FTW_DEPTH | FTW_PHYS);
}

// A file below the root, with its folders.
static void put(const char *path, const char *text)
{
    char whole[512];
    snprintf(whole, sizeof whole, "%s%s", root, path);
    for (char *at = whole + strlen(root) + 1; (at = strchr(at, '/')); at++) {
        *at = 0;
        if (mkdir(whole, 0755) < 0)
            assert_int_equal(errno, EEXIST);
        *at = '/';
    }
    FILE *file = fopen(whole, "w");
    assert_non_null(file);
    fputs(text, file);
    assert_int_equal(fclose(file), 0);
}

static uint64_t memory(void) { return machine_memory_under(root, 64 * GIB); }

static void test_no_groups(void **state)
{
    (void)state;
    assert_int_equal(memory(), 64 * GIB); // not even /proc
    put("/proc/self/cgroup", "");
    assert_int_equal(memory(), 64 * GIB);
    put("/proc/self/cgroup", "0::/\n");
    assert_int_equal(memory(), 64 * GIB);
    put("/sys/fs/cgroup/memory.max", "max\n");
    assert_int_equal(memory(), 64 * GIB);
}

// The service's own limit, and each of those above it.
static void test_unified(void **state)
{
    (void)state;
    put("/proc/self/cgroup", "0::/system.slice/airyd.service\n");
    put("/sys/fs/cgroup/system.slice/airyd.service/memory.max", "max\n");
    put("/sys/fs/cgroup/system.slice/airyd.service/memory.high", "max\n");
    put("/sys/fs/cgroup/system.slice/memory.max", "max\n");
    assert_int_equal(memory(), 64 * GIB);
    put("/sys/fs/cgroup/memory.max", "34359738368\n");
    assert_int_equal(memory(), 32 * GIB);
    put("/sys/fs/cgroup/system.slice/memory.max", "17179869184\n");
    assert_int_equal(memory(), 16 * GIB);
    put("/sys/fs/cgroup/system.slice/airyd.service/memory.max", "8589934592\n");
    assert_int_equal(memory(), 8 * GIB);
    put("/sys/fs/cgroup/system.slice/airyd.service/memory.high", "4294967296\n"); // it would be slowed down there
    assert_int_equal(memory(), 4 * GIB);
    put("/sys/fs/cgroup/other.slice/memory.max", "1\n"); // not ours
    assert_int_equal(memory(), 4 * GIB);
    put("/sys/fs/cgroup/system.slice/airyd.service/memory.max", "99999999999999\n"); // more than there is above it
    put("/sys/fs/cgroup/system.slice/airyd.service/memory.high", "max\n");
    assert_int_equal(memory(), 16 * GIB);
}

// A container sees its own root, and perhaps the host's path, which is not there.
static void test_container(void **state)
{
    (void)state;
    put("/proc/self/cgroup", "0::/docker/0123456789abcdef\n");
    put("/sys/fs/cgroup/memory.max", "2147483648\n");
    assert_int_equal(memory(), 2 * GIB);
    put("/proc/self/cgroup", "0::/../../init.scope\n");
    assert_int_equal(memory(), 2 * GIB);
}

static void test_old(void **state)
{
    (void)state;
    put("/proc/self/cgroup", "12:cpu,cpuacct:/a\n5:memory:/a/b\n1:name=systemd:/a\n0::/\n");
    put("/sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n"); // as good as none
    put("/sys/fs/cgroup/memory/a/memory.limit_in_bytes", "9223372036854771712\n");
    put("/sys/fs/cgroup/memory/a/b/memory.limit_in_bytes", "9223372036854771712\n");
    put("/sys/fs/cgroup/cpu/a/memory.limit_in_bytes", "1\n");
    assert_int_equal(memory(), 64 * GIB);
    put("/sys/fs/cgroup/memory/a/memory.limit_in_bytes", "3221225472\n");
    assert_int_equal(memory(), 3 * GIB);
    put("/proc/self/cgroup", "5:hugetlb,memory:/a/b\n");
    assert_int_equal(memory(), 3 * GIB);
    put("/proc/self/cgroup", "5:memoryless:/a/b\n");
    assert_int_equal(memory(), 64 * GIB);
}

// What cannot be read limits nothing, and breaks nothing.
static void test_nonsense(void **state)
{
    (void)state;
    static const char *const limits[] = { "", "\n", "-1\n", "4 GiB\n", "12345678901234567890123456789\n", "0x1000\n", "max", " 1\n" };
    static const char *const lines[] = { "", ":", "::", "0::", "0::x/y\n", "no colons\n", "0:memory\n", ":::/a\n" };
    put("/proc/self/cgroup", "0::/a\n");
    for (size_t i = 0; i < sizeof limits / sizeof limits[0]; i++) {
        put("/sys/fs/cgroup/a/memory.max", limits[i]);
        assert_int_equal(memory(), 64 * GIB);
    }
    put("/sys/fs/cgroup/a/memory.max", "4096"); // without an end of line
    assert_int_equal(memory(), 4096);
    for (size_t i = 0; i < sizeof lines / sizeof lines[0]; i++) {
        put("/proc/self/cgroup", lines[i]);
        assert_int_equal(memory(), 64 * GIB);
    }
    char *longest = malloc(10001);
    memset(longest, '/', 10000);
    longest[10000] = 0;
    memcpy(longest, "0::/a", 5);
    put("/proc/self/cgroup", longest);
    assert_true(memory() <= 64 * GIB);
    free(longest);
}

static void test_this_machine(void **state)
{
    (void)state;
    const uint64_t bytes = machine_memory_bytes();
    assert_true(bytes > 0 && bytes <= machine_memory_under(root, UINT64_MAX)); // nothing is below that root
    struct rlimit limit;
    const uint64_t fds = machine_raise_fds();
    assert_int_equal(getrlimit(RLIMIT_NOFILE, &limit), 0);
    assert_int_equal(limit.rlim_cur, limit.rlim_max);
    assert_int_equal(fds, limit.rlim_cur);
}

// Whatever the limit is: all that is counted, and two descriptors of half a message for each connection, as long as that
// is no more than a quarter, fit below it with the program's own; and there is something for everybody.
static void test_share_fds(void **state)
{
    (void)state;
    for (uint64_t limit = 300; limit < UINT64_C(1) << 40; limit = limit * 5 / 4)
        for (uint64_t clients = 1; clients <= 65536; clients = clients * 3 + 1) {
            const struct fd_share s = machine_share_fds(limit, clients, 0);
            assert_true(s.clients >= 1 && s.clients <= clients);
            assert_true(s.all < limit && s.clients <= s.all && s.user <= s.all && s.user >= s.all / 2);
            assert_true(s.jobs >= 16 && s.jobs <= 65536);
            if (limit >= 8 * clients + 4096)
                assert_true(s.clients == clients && s.all + 2 * clients < limit);
        }
    assert_int_equal(machine_share_fds(65536, 1024, 0).clients, 1024);
    assert_int_equal(machine_share_fds(65536, 1024, 100).user, 100);
    assert_true(machine_share_fds(1024, 1024, 0).clients < 1024);
    assert_int_equal(machine_share_fds(10, 1024, 0).clients, 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_no_groups, fresh, gone),    cmocka_unit_test_setup_teardown(test_unified, fresh, gone),
        cmocka_unit_test_setup_teardown(test_container, fresh, gone),    cmocka_unit_test_setup_teardown(test_old, fresh, gone),
        cmocka_unit_test_setup_teardown(test_nonsense, fresh, gone),     cmocka_unit_test_setup_teardown(test_this_machine, fresh, gone),
        cmocka_unit_test(test_share_fds),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
