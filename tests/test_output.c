// SPDX-License-Identifier: Apache-2.0
// test_output.c - outputs on a disk that fails: every system call of a write is made to fail in turn (full, EIO, cut short), in a
// real folder. Whatever fails, the old file stays, nothing is left beside it, and the error names the path. Then black frames and
// stamps, out of whole and of cut headers.
#include <errno.h>
#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "cmd_exr.h"
#include "cmd_output.h"

/* ---- faults ---------------------------------------------------------------------------------------- */

static struct {
    unsigned call, fail_at; /* the fail_at'th call from now on fails; 0: none */
    int error;              /* 0: sendfile and write move at most 7 bytes, in every call */
    const char *failed;
    char take_away[300]; /* before the rename: a file that goes, as another machine's clean-up might take it; once */
} fault;

static bool fails(const char *name)
{
    if (!fault.error || ++fault.call != fault.fail_at)
        return false;
    fault.failed = name;
    errno = fault.error;
    return true;
}

static size_t cut(size_t n) { return fault.fail_at && !fault.error && n > 7 ? 7 : n; }

int __real_fallocate(int fd, int mode, off_t from, off_t size);
int __wrap_fallocate(int fd, int mode, off_t from, off_t size);
ssize_t __real_sendfile(int out, int in, off_t *from, size_t n);
ssize_t __wrap_sendfile(int out, int in, off_t *from, size_t n);
ssize_t __real_write(int fd, const void *data, size_t n);
ssize_t __wrap_write(int fd, const void *data, size_t n);
int __real_fsync(int fd);
int __wrap_fsync(int fd);
int __real_renameat2(int from, const char *a, int to, const char *b, unsigned flags);
int __wrap_renameat2(int from, const char *a, int to, const char *b, unsigned flags);

int __wrap_fallocate(int fd, int mode, off_t from, off_t size)
{
    return fails("fallocate") ? -1 : __real_fallocate(fd, mode, from, size);
}
ssize_t __wrap_sendfile(int out, int in, off_t *from, size_t n)
{
    return fails("sendfile") ? -1 : __real_sendfile(out, in, from, cut(n));
}
ssize_t __wrap_write(int fd, const void *data, size_t n)
{
    return fails("write") ? -1 : __real_write(fd, data, cut(n));
}
int __wrap_fsync(int fd) { return fails("fsync") ? -1 : __real_fsync(fd); }
int __wrap_renameat2(int from, const char *a, int to, const char *b, unsigned flags)
{
    if (*fault.take_away) {
        fault.take_away[0] = '\0';
        assert_int_equal(unlinkat(from, a, 0), 0);
    }
    return fails("renameat2") ? -1 : __real_renameat2(from, a, to, b, flags);
}

/* ---- a folder ---------------------------------------------------------------------------------------- */

enum { BYTES = 1000 };
static char folder[] = "/tmp/airy-output-XXXXXX", path[64];
static uint8_t content[BYTES];

static int set_up(void **state)
{
    (void)state;
    for (unsigned i = 0; i < BYTES; i++)
        content[i] = (uint8_t)(i * 7 + i / 256);
    if (!mkdtemp(folder))
        return -1;
    snprintf(path, sizeof(path), "%s/out.exr", folder);
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    unlink(path);
    return rmdir(folder);
}

static void put_file(const char *name, const void *data, size_t n)
{
    int fd = open(name, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    assert_true(fd >= 0);
    assert_int_equal(__real_write(fd, data, n), n);
    close(fd);
}

static bool holds(const void *data, size_t n)
{
    uint8_t got[BYTES + 1];
    int fd = open(path, O_RDONLY);
    ssize_t len = fd < 0 ? -1 : read(fd, got, sizeof(got));
    if (fd >= 0)
        close(fd);
    return len == (ssize_t)n && memcmp(got, data, n) == 0;
}

static bool any(void *ctx, const char *base, size_t len)
{
    (void)base, (void)len;
    ++*(unsigned *)ctx;
    return false;
}

static unsigned temporary_files(void)
{
    unsigned n = 0;
    output_clean(folder, any, &n);
    return n;
}

static struct airy_result result_make(bool in_memory)
{
    struct airy_result r = { .data = content, .size = BYTES, .fd = -1 };
    if (!in_memory) {
        r.fd = memfd_create("result", MFD_CLOEXEC);
        assert_true(r.fd >= 0);
        assert_int_equal(__real_write(r.fd, content, BYTES), BYTES);
    }
    return r;
}

/* ---- what fails ------------------------------------------------------------------------------------- */

/* Every call in turn, until one write gets through without meeting the fault. Returns how many calls there are. */
static unsigned every_call(const struct airy_result *r, int error, bool exists)
{
    char why[OUTPUT_WHY_MAX];
    for (unsigned at = 1;; at++) {
        unlink(path);
        if (exists)
            put_file(path, "old", 3);
        memset(&fault, 0, sizeof(fault));
        fault.fail_at = at;
        fault.error = error;
        int rc = output_write(path, r, true, why);
        fault.error = 0;
        fault.fail_at = 0;
        if (temporary_files() != 0)
            fail_msg("error %d in call %u, %s: a temporary file stays", error, at, fault.failed ? fault.failed : "-");
        if (!fault.failed) {
            assert_int_equal(rc, 0);
            assert_true(holds(content, BYTES));
            return at - 1;
        }
        /* The last fsync is the folder's: the name is there by then, and whole. */
        bool whole = holds(content, BYTES), old = exists ? holds("old", 3) : access(path, F_OK) < 0;
        if (!whole && !old)
            fail_msg("error %d in call %u, %s: neither the old file nor the new one", error, at, fault.failed);
        if (rc == 0 && !whole)
            fail_msg("error %d in call %u, %s: done, it says", error, at, fault.failed);
        if (rc < 0 && (!strstr(why, path) || !strstr(why, strerror(error))))
            fail_msg("error %d in call %u, %s: \"%s\"", error, at, fault.failed, why);
        if (rc == 0 && error == ENOSPC)
            fail_msg("a full disk in call %u, %s, was not noticed", at, fault.failed);
    }
}

static void test_faults(void **state)
{
    (void)state;
    static const int errors[] = { ENOSPC, EIO, EDQUOT, EFBIG, EROFS };
    for (unsigned in_memory = 0; in_memory < 2; in_memory++)
        for (unsigned exists = 0; exists < 2; exists++)
            for (unsigned i = 0; i < sizeof(errors) / sizeof(errors[0]); i++) {
                struct airy_result r = result_make(in_memory);
                /* fallocate, the copy, fsync, the rename, the folder's fsync */
                assert_int_equal(every_call(&r, errors[i], exists), 5);
                if (r.fd >= 0)
                    close(r.fd);
            }
}

static void test_short(void **state)
{
    (void)state;
    char why[OUTPUT_WHY_MAX];
    for (unsigned in_memory = 0; in_memory < 2; in_memory++) {
        struct airy_result r = result_make(in_memory);
        unlink(path);
        memset(&fault, 0, sizeof(fault));
        fault.fail_at = 1;
        assert_int_equal(output_write(path, &r, true, why), 0);
        fault.fail_at = 0;
        assert_true(holds(content, BYTES));
        if (r.fd >= 0)
            close(r.fd);
    }
    /* Fewer bytes than were said: not a file of them. */
    struct airy_result r = result_make(false);
    r.data = NULL;
    r.size = BYTES + 1;
    assert_int_equal(output_write(path, &r, true, why), -1);
    assert_non_null(strstr(why, strerror(EIO)));
    assert_true(holds(content, BYTES));
    assert_int_equal(temporary_files(), 0);
    close(r.fd);
}

static void test_taken_away(void **state)
{
    (void)state;
    char why[OUTPUT_WHY_MAX];
    struct airy_result r = result_make(true);
    unlink(path);
    memset(&fault, 0, sizeof(fault));
    strcpy(fault.take_away, "the next one");
    assert_int_equal(output_write(path, &r, true, why), 0);
    assert_int_equal(fault.take_away[0], 0);
    assert_true(holds(content, BYTES));
    assert_int_equal(temporary_files(), 0);
}

/* ---- stamps and black frames -------------------------------------------------------------------------- */

/* A header as bytes: attributes by hand. */
static uint8_t *attr(uint8_t *to, const char *name, const char *type, const void *data, uint32_t n)
{
    to = (uint8_t *)stpcpy((char *)to, name) + 1;
    to = (uint8_t *)stpcpy((char *)to, type) + 1;
    for (unsigned i = 0; i < 4; i++)
        *to++ = (uint8_t)(n >> 8 * i);
    memcpy(to, data, n);
    return to + n;
}

static size_t header(uint8_t *out, int32_t width, int32_t height, const char *stamp)
{
    static const uint8_t channel[] = "R\0\1\0\0\0\0\0\0\0\1\0\0\0\1\0\0\0"; /* half, every pixel; its end is the literal's */
    const int32_t window[4] = { 0, 0, width - 1, height - 1 };
    uint8_t *to = out;
    memcpy(to, "\x76\x2f\x31\x01\2\0\0\0", 8);
    to = attr(to + 8, "channels", "chlist", channel, sizeof(channel));
    to = attr(to, "displayWindow", "box2i", window, 16);
    to = attr(to, "dataWindow", "box2i", window, 16);
    if (stamp)
        to = attr(to, "airy", "string", stamp, (uint32_t)strlen(stamp));
    *to++ = 0;
    return (size_t)(to - out);
}

static void test_stamps(void **state)
{
    (void)state;
    uint8_t bytes[512];
    size_t n = header(bytes, 4, 4, "the stamp");
    put_file(path, bytes, n);
    assert_true(exr_has_stamp(path));
    assert_true(exr_is_stamped(path, "the stamp"));
    assert_false(exr_is_stamped(path, "the stamq"));
    assert_false(exr_is_stamped(path, "the stam"));
    assert_false(exr_is_stamped(path, "the stamp "));
    assert_false(exr_is_stamped(path, ""));
    for (size_t cut_at = 0; cut_at < n; cut_at++) { /* cut anywhere: no stamp, and nothing worse */
        put_file(path, bytes, cut_at);
        assert_false(exr_has_stamp(path));
    }
    for (size_t i = 0; i < n; i++) { /* any byte wrong: an answer */
        for (unsigned bit = 0; bit < 8; bit++) {
            bytes[i] ^= (uint8_t)(1u << bit);
            put_file(path, bytes, n);
            exr_is_stamped(path, "the stamp");
            bytes[i] ^= (uint8_t)(1u << bit);
        }
    }
    put_file(path, bytes, header(bytes, 4, 4, NULL));
    assert_false(exr_has_stamp(path));
    unlink(path);
    assert_false(exr_has_stamp(path));
    assert_false(exr_has_stamp(folder));
}

static void test_black(void **state)
{
    (void)state;
    uint8_t bytes[512];
    char why[EXR_WHY_MAX];
    size_t n = header(bytes, 300, 5, "of another frame");
    put_file(path, bytes, n);
    int a = exr_black(path, why), b;
    assert_true(a >= 0);
    struct stat s;
    assert_int_equal(fstat(a, &s), 0);
    assert_int_equal(fcntl(a, F_GET_SEALS) & F_SEAL_SHRINK, F_SEAL_SHRINK);
    uint8_t *got = malloc((size_t)s.st_size);
    assert_int_equal(pread(a, got, (size_t)s.st_size, 0), s.st_size);
    assert_null(memmem(got, (size_t)s.st_size, "airy", 5));
    /* The last of 5 lines: where it is, its number, its size, and the run lengths of 600 bytes. */
    const uint8_t line[] = { 4, 0, 0, 0, 12, 0, 0, 0, 0xff, 0, 127, 128, 127, 128, 127, 128, 127, 128, 86, 128 };
    assert_memory_equal(got + s.st_size - sizeof(line), line, sizeof(line));
    uint64_t at;
    memcpy(&at, got + s.st_size - 5 * sizeof(line) - 8, 8);
    assert_int_equal(at, (uint64_t)s.st_size - sizeof(line));
    free(got);
    /* Another frame of the format: the same bytes. */
    put_file(path, bytes, header(bytes, 300, 5, NULL));
    b = exr_black(path, why);
    struct stat t;
    assert_int_equal(fstat(b, &t), 0);
    assert_int_equal(t.st_size, s.st_size);
    close(a);
    close(b);

    static const int32_t bad[][2] = { { 0, 5 }, { 5, 0 }, { -3, 5 }, { INT32_MAX, 2 }, { 2, INT32_MAX }, { 1 << 20, 1 << 20 } };
    for (unsigned i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
        put_file(path, bytes, header(bytes, bad[i][0], bad[i][1], NULL));
        if (exr_black(path, why) >= 0)
            fail_msg("%d x %d was made", bad[i][0], bad[i][1]);
        assert_non_null(strstr(why, path));
        assert_non_null(strstr(why, "expected"));
    }
    n = header(bytes, 8, 2, NULL);
    for (size_t cut_at = 0; cut_at < n; cut_at++) {
        put_file(path, bytes, cut_at);
        assert_int_equal(exr_black(path, why), -1);
    }
    for (size_t i = 0; i < n; i++)
        for (unsigned bit = 0; bit < 8; bit++) {
            bytes[i] ^= (uint8_t)(1u << bit);
            put_file(path, bytes, n);
            int fd = exr_black(path, why);
            if (fd >= 0)
                close(fd);
            bytes[i] ^= (uint8_t)(1u << bit);
        }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_faults),     cmocka_unit_test(test_short), cmocka_unit_test(test_taken_away),
        cmocka_unit_test(test_stamps),     cmocka_unit_test(test_black),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
