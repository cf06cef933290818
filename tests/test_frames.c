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

static void names_exact(const char *pattern, int64_t frame, const char *wanted)
{
    struct frames_pattern p;
    char why[FRAMES_WHY_MAX];
    assert_int_equal(frames_pattern_init(&p, pattern, why), 0);
    char *name = frames_name(&p, frame);
    assert_string_equal(name, wanted);
    free(name);
    frames_pattern_finish(&p);
}

static void names(const char *pattern, int64_t frame, const char *wanted)
{
    names_exact(pattern, frame * FRAMES_ONE, wanted);
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

static void test_subframe_names(void **state)
{
    (void)state;
    names_exact("img.####.exr", 1500000, "img.0001.5.exr");
    names_exact("img.####.exr", 1000000, "img.0001.exr");
    names_exact("img.@.exr", 10250000, "img.10.25.exr");
    names_exact("img.%04d.exr", 1, "img.0000.000001.exr");
    names_exact("img.$F4.exr", -1500000, "img.-001.5.exr");
    names_exact("img.####.exr", -500000, "img.-000.5.exr");
    names_exact("img.@.exr", -500000, "img.-0.5.exr");
    names_exact("img.##.exr", FRAMES_NUMBER_MAX, "img.999999999.exr");
    names_exact("img.##.exr", -FRAMES_NUMBER_MAX + 1, "img.-999999998.999999.exr");
}

static void range_exact(const char *text, size_t count, const int64_t *wanted, int64_t unit)
{
    struct frames_list l;
    char why[FRAMES_WHY_MAX] = "";
    if (frames_parse(&l, text, why) < 0)
        fail_msg("%s: %s", text, why);
    assert_int_equal(l.count, count);
    for (size_t i = 0; i < count; i++)
        assert_int_equal(l.frame[i], wanted[i] * unit);
    frames_list_finish(&l);
}
#define RANGE_IN(unit, text, ...)                                                                       \
    range_exact(text, sizeof((int64_t[]){ __VA_ARGS__ }) / sizeof(int64_t), (int64_t[]){ __VA_ARGS__ }, unit)
#define RANGE(text, ...) RANGE_IN(FRAMES_ONE, text, __VA_ARGS__)

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
    RANGE_IN(FRAMES_ONE / 100, "1.5", 150);
    RANGE_IN(FRAMES_ONE / 100, "1-2x0.5", 100, 150, 200);
    RANGE_IN(FRAMES_ONE / 100, "1-2x0.25", 100, 125, 150, 175, 200);
    RANGE_IN(FRAMES_ONE / 100, "-1.5-0x0.75", -150, -75, 0);
    RANGE_IN(FRAMES_ONE / 100, "2-1x0.4,1.2,1.20", 200, 160, 120);
    RANGE_IN(1, "0.000001", 1);

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
                                       "1.",
                                       ".5",
                                       "1.5.5",
                                       "1.0000001",
                                       "1-2x0",
                                       "1-2x0.0",
                                       "1-2x.5",
                                       "999999999.5",
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

static void test_offsets(void **state)
{
    (void)state;
    char why[FRAMES_WHY_MAX] = "";
    int64_t n;
    assert_int_equal(frames_parse_offset(&n, "1000", why), 0);
    assert_int_equal(n, 1000 * FRAMES_ONE);
    assert_int_equal(frames_parse_offset(&n, "+7", why), 0);
    assert_int_equal(n, 7 * FRAMES_ONE);
    assert_int_equal(frames_parse_offset(&n, "-0.5", why), 0);
    assert_int_equal(n, -FRAMES_ONE / 2);
    static const char *const bad[] = { "", "+", "-", "+-1", "x", "1-2", "1 ", "1000000000" };
    for (unsigned i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
        if (frames_parse_offset(&n, bad[i], why) == 0)
            fail_msg("\"%s\" was taken", bad[i]);
        assert_non_null(strstr(why, "expected"));
    }
    struct frames_list l;
    assert_int_equal(frames_parse(&l, "1-3", why), 0);
    assert_int_equal(frames_shift(&l, -3 * FRAMES_ONE, why), 0);
    assert_int_equal(l.frame[0], -2 * FRAMES_ONE);
    assert_int_equal(l.frame[2], 0);
    assert_int_equal(frames_shift(&l, FRAMES_NUMBER_MAX, why), 0);
    assert_int_equal(frames_shift(&l, FRAMES_ONE, why), -1); /* all or none */
    assert_non_null(strstr(why, "at most 9 digits"));
    assert_int_equal(l.frame[0], FRAMES_NUMBER_MAX - 2 * FRAMES_ONE);
    frames_list_finish(&l);
}

/* The folder holds the files; the pattern finds the frames. */
static void finds(const char *const *files, size_t n, const char *pattern, size_t count, const int64_t *wanted)
{
    char folder[] = "/tmp/airy-frames-XXXXXX", path[128], why[FRAMES_WHY_MAX];
    struct frames_pattern p;
    struct frames_list l;
    assert_non_null(mkdtemp(folder));
    for (size_t i = 0; i < n; i++) {
        snprintf(path, sizeof(path), "%s/%s", folder, files[i]);
        close(open(path, O_CREAT | O_WRONLY, 0600));
    }
    snprintf(path, sizeof(path), "%s/%s", folder, pattern);
    assert_int_equal(frames_pattern_init(&p, path, why), 0);
    assert_int_equal(frames_scan(&l, &p, why), 0);
    assert_int_equal(l.count, count);
    for (size_t i = 0; i < count; i++)
        assert_int_equal(l.frame[i], wanted[i]);
    frames_list_finish(&l);
    frames_pattern_finish(&p);
    for (size_t i = 0; i < n; i++) {
        snprintf(path, sizeof(path), "%s/%s", folder, files[i]);
        unlink(path);
    }
    rmdir(folder);
}

static void test_scan_subframes(void **state)
{
    (void)state;
    static const char *const files[] = { "a.0001.exr",   "a.0001.5.exr",   "a.0001.50.exr", "a.0001.25.exr", "a.1.75.exr",
                                         "a.-001.5.exr", "a.0002..exr",    "a.0003.5exr",   "a.0004.1234567.exr",
                                         "a.0005.2.exr", "a.0006.5.2.exr", "a.00071.exr" };
    enum { N = sizeof(files) / sizeof(files[0]) };
    finds(files, N, "a.####.exr", 5, (int64_t[]){ -1500000, 1000000, 1250000, 1500000, 5200000 });
    /* The pattern's own digits after the token are not the number's. */
    finds(files, N, "a.####.2.exr", 2, (int64_t[]){ 5000000, 6500000 });
    finds(files, N, "a.####1.exr", 1, (int64_t[]){ 7000000 });
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
        assert_int_equal(l.frame[i], wanted[i] * FRAMES_ONE);
    frames_list_finish(&l);
    frames_pattern_finish(&p);

    char here[256];
    assert_non_null(getcwd(here, sizeof(here)));
    assert_int_equal(chdir(folder), 0);
    frames_pattern_init(&p, "in.%03d.exr", why); /* without a folder, other padding */
    assert_int_equal(frames_scan(&l, &p, why), 0);
    assert_int_equal(l.count, 2);
    assert_int_equal(l.frame[0], 3 * FRAMES_ONE);
    assert_int_equal(l.frame[1], 12345 * FRAMES_ONE);
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
        cmocka_unit_test(test_subframe_names),
        cmocka_unit_test(test_ranges),
        cmocka_unit_test(test_offsets),
        cmocka_unit_test(test_scan_subframes),
        cmocka_unit_test(test_scan),
        cmocka_unit_test(test_progress),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
