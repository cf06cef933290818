// SPDX-License-Identifier: Apache-2.0
// test_frames.c - the frame grammar, ranges read from a real folder, and the progress line.
#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "frames.h"
#include "progress.h"

static void names(const char *pattern, int64_t frame, const char *wanted)
{
    struct frames_pattern p;
    char why[FRAMES_WHY_MAX];
    assert_int_equal(frames_pattern_init(&p, pattern, why), 0);
    char *name = frames_name(&p, frame);
    assert_string_equal(name, wanted);
    free(name);
    frames_pattern_finish(&p);
}

static void test_tokens(void **state)
{
    (void)state;
    names("in.####.exr", 7, "in.0007.exr");
    names("in.#.exr", 7, "in.0007.exr");
    names("in.##.exr", 7, "in.07.exr");
    names("in.@.exr", 7, "in.7.exr");
    names("in.@@@.exr", 7, "in.007.exr");
    names("in.#@.exr", 7, "in.00007.exr");
    names("in.%04d.exr", 7, "in.0007.exr");
    names("in.%d.exr", 7, "in.7.exr");
    names("in.%010d.exr", 7, "in.0000000007.exr");
    names("in.$F4.exr", 7, "in.0007.exr");
    names("in.$F.exr", 7, "in.7.exr");
    names("####/a####b", 12, "0012/a0012b");
    names("in.####.exr", 123456, "in.123456.exr"); /* wider than its padding */
    names("in.####.exr", -1, "in.-001.exr");
    names("in.####.exr", -12345, "in.-12345.exr");
    names("in.exr", 7, "in.exr");
    names("100%.exr", 7, "100%.exr");
    names("%4d.%s.%n", 7, "%4d.%s.%n"); /* not tokens, and never a format */
    names("$FF.$Foo.$F_x", 7, "$FF.$Foo.$F_x");
    names("", 7, "");

    struct frames_pattern p;
    char why[FRAMES_WHY_MAX];
    assert_int_equal(frames_pattern_init(&p, "#.#.#.#.#.#.#.#.#", why), -1);
    assert_non_null(strstr(why, "at most 8"));
    assert_int_equal(frames_pattern_init(&p, "%099d", why), -1);
    assert_int_equal(frames_pattern_init(&p, "@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@@", why), -1);
}

static void range(const char *text, size_t count, const int64_t *wanted)
{
    struct frames_list l;
    char why[FRAMES_WHY_MAX] = "";
    if (frames_parse(&l, text, why) < 0)
        fail_msg("%s: %s", text, why);
    assert_int_equal(l.count, count);
    for (size_t i = 0; i < count; i++)
        assert_int_equal(l.frame[i], wanted[i]);
    frames_list_finish(&l);
}
#define RANGE(text, ...)                                                                                \
    range(text, sizeof((int64_t[]){ __VA_ARGS__ }) / sizeof(int64_t), (int64_t[]){ __VA_ARGS__ })

static void test_ranges(void **state)
{
    (void)state;
    RANGE("7", 7);
    RANGE("0007", 7);
    RANGE("1-4", 1, 2, 3, 4);
    RANGE("1-10x4", 1, 5, 9);
    RANGE("1-9x4", 1, 5, 9);
    RANGE("4-1", 4, 3, 2, 1);
    RANGE("10-1x4", 10, 6, 2);
    RANGE("-3--1", -3, -2, -1);
    RANGE("-1-1", -1, 0, 1);
    RANGE("1--1", 1, 0, -1);
    RANGE("1,5,9-12", 1, 5, 9, 10, 11, 12);
    RANGE("5,1-6x2,5", 5, 1, 3); /* none twice; the first stays */
    RANGE("3-3x100", 3);
    RANGE("999999999", 999999999);

    static const char *const bad[] = { "",
                                       "-",
                                       "a",
                                       "1-",
                                       "1-x2",
                                       "1-5x",
                                       "1-5x0",
                                       "1-5x-1",
                                       "1,",
                                       ",1",
                                       "1,,2",
                                       "1 -2",
                                       "1.5",
                                       "1-5x2y",
                                       "1x2",
                                       "--1",
                                       "1-5-9",
                                       "1000000000",
                                       "99999999999999999999999" };
    for (unsigned i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
        struct frames_list l;
        char why[FRAMES_WHY_MAX] = "";
        if (frames_parse(&l, bad[i], why) == 0)
            fail_msg("\"%s\" was taken", bad[i]);
        assert_non_null(strstr(why, "expected"));
        assert_null(l.frame);
    }
    struct frames_list l;
    char why[FRAMES_WHY_MAX];
    assert_int_equal(frames_parse(&l, "1-1000000", why), 0);
    assert_int_equal(l.count, FRAMES_MAX);
    frames_list_finish(&l);
    assert_int_equal(frames_parse(&l, "1-999999999", why), -1);
    assert_non_null(strstr(why, "at most 1000000"));
}

static void test_scan(void **state)
{
    (void)state;
    static const char *const files[] = { "in.0003.exr",       "in.0001.exr",     "in.12345.exr",
                                         "in.-002.exr",       "in.003.exr",      "in.00003.exr",
                                         "in.0004.exr~",      "in.0005.exr.tmp", "in.abcd.exr",
                                         ".in.0006.exr",      "in.0007.EXR",     "in.-0008.exr",
                                         "in.+009.exr",       "in..exr",         "xin.0001.exr",
                                         "in.99999999999.exr" };
    char folder[] = "/tmp/airy-frames-XXXXXX", path[128], why[FRAMES_WHY_MAX];
    enum { N = sizeof(files) / sizeof(files[0]) };
    assert_non_null(mkdtemp(folder));
    for (unsigned i = 0; i < N; i++) {
        snprintf(path, sizeof(path), "%s/%s", folder, files[i]);
        close(open(path, O_CREAT | O_WRONLY, 0600));
    }
    struct frames_pattern p;
    struct frames_list l;
    snprintf(path, sizeof(path), "%s/in.####.exr", folder);
    assert_int_equal(frames_pattern_init(&p, path, why), 0);
    assert_int_equal(frames_scan(&l, &p, why), 0);
    static const int64_t wanted[] = { -2, 1, 3, 12345 };
    assert_int_equal(l.count, 4);
    for (unsigned i = 0; i < 4; i++)
        assert_int_equal(l.frame[i], wanted[i]);
    frames_list_finish(&l);
    frames_pattern_finish(&p);

    char here[256];
    assert_non_null(getcwd(here, sizeof(here)));
    assert_int_equal(chdir(folder), 0);
    frames_pattern_init(&p, "in.%03d.exr", why); /* without a folder, other padding */
    assert_int_equal(frames_scan(&l, &p, why), 0);
    assert_int_equal(l.count, 2);
    assert_int_equal(l.frame[0], 3);
    assert_int_equal(l.frame[1], 12345);
    frames_list_finish(&l);
    frames_pattern_finish(&p);
    assert_int_equal(chdir(here), 0);

    for (unsigned i = 0; i < N; i++) {
        snprintf(path, sizeof(path), "%s/%s", folder, files[i]);
        unlink(path);
    }
    rmdir(folder);
    frames_pattern_init(&p, path, why);
    assert_int_equal(frames_scan(&l, &p, why), -1); /* no token */
    frames_pattern_finish(&p);
    frames_pattern_init(&p, "v##/in.####.exr", why);
    assert_int_equal(frames_scan(&l, &p, why), -1);
    assert_non_null(strstr(why, "-f"));
    frames_pattern_finish(&p);
    frames_pattern_init(&p, "/nowhere/in.####.exr", why);
    assert_int_equal(frames_scan(&l, &p, why), -1);
    assert_non_null(strstr(why, "/nowhere/"));
    frames_pattern_finish(&p);
}

static void test_progress(void **state)
{
    (void)state;
    char line[256];
    progress_render(line, sizeof(line), 79, 25, 0, 100, 5);
    assert_non_null(strstr(line, "[##########"));
    assert_non_null(strstr(line, "25/100  5 frames/s  ETA 0:15"));
    assert_null(strstr(line, "failed"));
    progress_render(line, sizeof(line), 79, 0, 0, 100, 0);
    assert_non_null(strstr(line, "ETA -"));
    progress_render(line, sizeof(line), 79, 10, 3, 100000, 1);
    assert_non_null(strstr(line, "ETA 2:46:39, 3 failed"));
    for (unsigned columns = 1; columns < 200; columns++) {
        progress_render(line, sizeof(line), columns, 999999, 1000, 1000000, 12345);
        assert_true(strlen(line) <= columns);
    }
    char small[8];
    progress_render(small, sizeof(small), 79, 1, 1, 2, 1);
    assert_int_equal(strlen(small), 7);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_tokens),
        cmocka_unit_test(test_ranges),
        cmocka_unit_test(test_scan),
        cmocka_unit_test(test_progress),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
