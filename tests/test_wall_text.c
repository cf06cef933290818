// SPDX-License-Identifier: Apache-2.0
// test_wall_text.c - airy wall's pure parts: which frame is sent when, and what is said of a wall.
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "cmd_wall_clock.h"
#include "cmd_wall_text.h"

#define MS UINT64_C(1000000)

// ---- the clock -----------------------------------------------------------------------------------------

static void frames_are_sent_ahead_and_in_time(void **state)
{
    (void)state;
    struct play_clock c = { .fps = 60, .ahead_ns = play_ahead_ns(60), .count = 10, .next = 1 };
    uint64_t k = 99, until, now = 5000 * MS;
    play_start(&c, now);
    assert_true(llabs((long long)(play_due_ns(&c, 1) - now - c.ahead_ns)) <= 1);
    for (unsigned i = 1; i <= 3; i++) { // exactly 1 is due within the lead at the start, the others one by one
        while (play_next(&c, now, 0, &k, &until) == PLAY_WAIT) {
            assert_true(until > now && until != UINT64_MAX);
            now = until;
        }
        assert_int_equal(k, i);
        assert_true(play_due_ns(&c, k) - now <= c.ahead_ns + 1 && play_due_ns(&c, k) + 1 >= now + c.ahead_ns);
    }
    assert_int_equal(play_next(&c, now + 1000 * MS, PLAY_IN_FLIGHT, &k, &until), PLAY_WAIT); // full: nothing is even skipped
    assert_true(until == UINT64_MAX && c.skipped == 0);
    now = play_due_ns(&c, 7);
    assert_int_equal(play_next(&c, now, 0, &k, &until), PLAY_SEND); // due this very moment
    assert_int_equal(k, 7);
    assert_int_equal(c.skipped, 3);
    assert_int_equal(play_next(&c, play_due_ns(&c, 8) + 1, 0, &k, &until), PLAY_SEND);
    assert_int_equal(k, 9);
    assert_int_equal(c.skipped, 4);
    assert_int_equal(play_next(&c, now, 0, &k, &until), PLAY_OVER);
}

static void a_sequence_that_ran_out_of_time_is_over(void **state)
{
    (void)state;
    struct play_clock c = { .fps = 25, .ahead_ns = play_ahead_ns(25), .count = 100 };
    uint64_t k, until;
    play_start(&c, 1000 * MS);
    assert_int_equal(play_next(&c, 1000000 * MS, 0, &k, &until), PLAY_OVER);
    assert_int_equal(c.skipped, 100);
}

// A week at a rate that no number of nanoseconds divides; and a machine that slept.
static void a_loop_neither_drifts_nor_stalls(void **state)
{
    (void)state;
    struct play_clock c = { .fps = 60000. / 1001, .ahead_ns = play_ahead_ns(60000. / 1001), .count = 7, .loop = true };
    uint64_t k, until, now = 123 * MS;
    play_start(&c, now);
    uint64_t week = UINT64_C(7) * 24 * 3600 * 1000 * MS, start = play_due_ns(&c, 0);
    assert_int_equal(play_next(&c, start + week, 0, &k, &until), PLAY_SEND);
    long double exact = (long double)k * 1001e9L / 60000, due = (long double)(play_due_ns(&c, k) - start);
    assert_true(fabsl(due - exact) < 2 && play_due_ns(&c, k) >= start + week);
    assert_true(k > 0 && play_due_ns(&c, k - 1) < start + week);
    assert_int_equal(c.skipped, k);
    uint64_t before = play_due_ns(&c, k);
    assert_true(llabs((long long)(play_due_ns(&c, k + 1) - before) - 16683333) <= 2);
}

static void slow_sequences_are_not_sent_long_before(void **state)
{
    (void)state;
    assert_true(play_ahead_ns(60) == 66666666 && play_ahead_ns(1) == 500 * MS && play_ahead_ns(240) == 16666666);
}

// ---- words ---------------------------------------------------------------------------------------------

static struct airy_wall_board board(const char *name, const char *state, const char *problem)
{
    return (struct airy_wall_board){ .name = name, .kind = "fadecandy", .serial = "S", .state = state, .problem = problem, .path = "" };
}

static void a_line_names_what_is_wrong_first(void **state)
{
    (void)state;
    struct airy_wall_board boards[] = { board("left", "ready", ""), board("r\033[2Jt", "absent", "unplugged"),
                                        board("far", "failed", "no access") };
    boards[0].amps = 2;
    boards[0].amps_wanted = 3;
    struct airy_wall_state w = { .name = "lobby", .source = "live", .fps = 60, .frames_per_second = 24, .dropped = 5,
                                 .late_ms = { .1, .25, 1.5 }, .boards = boards, .n_boards = 3 };
    struct wall_played played = { .sent = 9, .skipped = 2, .failed = 1 };
    char line[512], text[512];
    wall_text_line(line, sizeof line, 500, &w, &played);
    assert_string_equal(line, "lobby live  60.0 fps, 24.0 new  1/3 boards ready; r?[2Jt absent (unplugged), far failed (no access)  "
                              "skipped 2  failed 1  dropped 5  late p99 0.25 max 1.50 ms  2.0 A of 3.0 (limited)");
    wall_text_line(line, sizeof line, 12, &w, &played);
    assert_string_equal(line, "lobby live  ");
    assert_true(wall_text_boards(text, sizeof text, &w));
    w.n_boards = 1;
    boards[0].amps_wanted = 2;
    assert_false(wall_text_boards(text, sizeof text, &w));
    assert_string_equal(text, "1/1 boards ready");
    wall_text_line(line, sizeof line, 500, &w, NULL);
    assert_string_equal(line, "lobby live  60.0 fps, 24.0 new  dropped 5  late p99 0.25 max 1.50 ms  1/1 boards ready  2.0 A");
}

static void long_and_many_names_stay_within(void **state)
{
    (void)state;
    enum { N = 64 };
    char name[300];
    memset(name, 'n', sizeof name - 1);
    name[sizeof name - 1] = '\0';
    struct airy_wall_board boards[N];
    for (unsigned i = 0; i < N; i++)
        boards[i] = board(name, name, name);
    struct airy_wall_state w = { .name = name, .source = name, .boards = boards, .n_boards = N };
    char *exact = malloc(100); // so that a byte too many is seen
    assert_non_null(exact);
    wall_text_boards(exact, 100, &w);
    assert_int_equal(strlen(exact), 99);
    wall_text_line(exact, 100, 5000, &w, NULL);
    assert_int_equal(strlen(exact), 99);
    wall_text_line(exact, 100, 99, &w, NULL);
    assert_int_equal(strlen(exact), 99);
    free(exact);
    for (unsigned i = 0; i < N; i++)
        boards[i] = board("b", "absent", "");
    char text[512];
    wall_text_boards(text, sizeof text, &w);
    assert_string_equal(text, "0/64 boards ready; b absent, b absent, b absent, b absent, and 60 more");
}

static char *stream_text;
static size_t stream_bytes;

static FILE *stream(void)
{
    FILE *f = open_memstream(&stream_text, &stream_bytes);
    assert_non_null(f);
    return f;
}

static void a_list_says_what_to_do(void **state)
{
    (void)state;
    struct airy_wall_reply r = { .usb = "" };
    FILE *f = stream();
    wall_text_list(f, &r);
    fclose(f);
    assert_non_null(strstr(stream_text, "is plugged in"));
    assert_non_null(strstr(stream_text, "airy wall open"));
    assert_null(strstr(stream_text, "There is no USB"));
    assert_null(strstr(stream_text, "udev"));
    free(stream_text);
    const struct airy_controller controllers[] = { { "fadecandy", "ABC", "1-4", "lobby", "" },
                                                   { "gud", "", "1-5", "", "permission denied" },
                                                   { "gud", "X", "1-6", "", "" } };
    r = (struct airy_wall_reply){ .usb = "", .controllers = controllers, .n_controllers = 3 };
    f = stream();
    wall_text_list(f, &r);
    fclose(f);
    assert_non_null(strstr(stream_text, "ABC                  at 1-4      wall lobby\n"));
    assert_non_null(strstr(stream_text, "(no serial)"));
    assert_non_null(strstr(stream_text, "permission denied\n"));
    assert_non_null(strstr(stream_text, "at 1-6      free\n"));
    assert_non_null(strstr(stream_text, "60-airy-wall.rules"));
    free(stream_text);
    r = (struct airy_wall_reply){ .usb = "no /dev/bus/usb" };
    f = stream();
    wall_text_list(f, &r);
    fclose(f);
    assert_non_null(strstr(stream_text, "There is no USB: no /dev/bus/usb"));
    assert_null(strstr(stream_text, "is plugged in"));
    free(stream_text);
}

static void json_has_every_member(void **state)
{
    (void)state;
    struct airy_wall_board b = board("left", "ready", "");
    b.sent = UINT64_MAX;
    b.amps = .5;
    b.amps_wanted = 1;
    const struct airy_wall_supply s = { "psu", 1, 2, 3 };
    struct airy_wall_state w = { .name = "a\"b", .source = "held", .width = 2, .height = 3, .leds = 6, .rate = 30, .fps = NAN,
                                 .boards = &b, .n_boards = 1, .supplies = &s, .n_supplies = 1, .realtime = true };
    FILE *f = stream();
    struct json j = { .out = f };
    wall_json_state(&j, NULL, &w);
    json_line(&j);
    fclose(f);
    assert_string_equal(
        stream_text,
        "{\"name\":\"a\\\"b\",\"width\":2,\"height\":3,\"leds\":6,\"rate\":30,\"source\":\"held\",\"fps\":null,\"frames_per_second\":0,"
        "\"ticks\":0,\"ticks_missed\":0,\"late_ms\":{\"p50\":0,\"p99\":0,\"max\":0},\"skew_ms\":{\"p50\":0,\"p99\":0,\"max\":0},"
        "\"frames\":0,\"shown\":0,\"dropped\":0,\"exposure\":0,\"realtime\":true,\"amps\":0.5,\"amps_wanted\":1,"
        "\"boards\":[{\"name\":\"left\",\"kind\":\"fadecandy\",\"serial\":\"S\",\"state\":\"ready\",\"problem\":\"\",\"path\":\"\","
        "\"sent\":18446744073709551615,\"dropped\":0,\"missed\":0,\"stalls\":0,\"timeouts\":0,\"errors\":0,\"losses\":0,"
        "\"rendered\":0,\"received\":0,\"latency_ms\":{\"p50\":0,\"p99\":0,\"max\":0},\"amps\":0.5,\"amps_wanted\":1}],"
        "\"supplies\":[{\"name\":\"psu\",\"amps\":1,\"amps_wanted\":2,\"amps_limit\":3}]}\n");
    free(stream_text);
}

// ---- half blocks ---------------------------------------------------------------------------------------

#define UPPER "\xe2\x96\x80"

static void expect_blocks(const uint8_t *rgb, uint32_t width, uint32_t height, unsigned columns, unsigned rows, const char *text)
{
    FILE *f = stream();
    wall_text_blocks(f, rgb, width, height, columns, rows);
    fclose(f);
    assert_string_equal(stream_text, text);
    free(stream_text);
}

static void blocks_show_two_rows_a_line(void **state)
{
    (void)state;
    const uint8_t rgb[] = { 255, 0, 0, 255, 0, 0, 0, 255, 0, 0, 0, 255, 1, 2, 3, 1, 2, 3 };
    expect_blocks(rgb, 2, 3, 80, 24,
                  "\033[38;2;255;0;0m\033[48;2;0;255;0m" UPPER "\033[48;2;0;0;255m" UPPER "\033[0m\r\n"
                  "\033[38;2;1;2;3m\033[48;2;0;0;0m" UPPER UPPER "\033[0m\r\n");
    expect_blocks(rgb, 2, 3, 80, 1, // 1 x 2: the first row's mean, and that of both others
                  "\033[38;2;255;0;0m\033[48;2;1;65;65m" UPPER "\033[0m\r\n");
    expect_blocks(rgb, 2, 3, 0, 24, "");
    expect_blocks(rgb, 6, 1, 1, 1, "\033[38;2;85;43;44m\033[48;2;0;0;0m" UPPER "\033[0m\r\n");
}

// Every size into every size: no pixel outside is read (sanitizers), no line is too long.
static void blocks_fit(void **state)
{
    (void)state;
    for (uint32_t w = 1; w < 12; w++)
        for (uint32_t h = 1; h < 12; h++)
            for (unsigned columns = 1; columns < 9; columns++)
                for (unsigned rows = 1; rows < 9; rows++) {
                    uint8_t *exact = calloc(3, (size_t)w * h);
                    assert_non_null(exact);
                    FILE *f = stream();
                    wall_text_blocks(f, exact, w, h, columns, rows);
                    fclose(f);
                    unsigned lines = 0, blocks = 0;
                    for (const char *s = stream_text; (s = strstr(s, "\r\n")); s++)
                        lines++;
                    for (const char *s = stream_text; (s = strstr(s, UPPER)); s++)
                        blocks++;
                    if (!lines || lines > rows || !blocks || blocks > lines * columns || blocks % lines)
                        fail_msg("%ux%u in %ux%u: %u lines, %u blocks", w, h, columns, rows, lines, blocks);
                    free(stream_text);
                    free(exact);
                }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(frames_are_sent_ahead_and_in_time),
        cmocka_unit_test(a_sequence_that_ran_out_of_time_is_over),
        cmocka_unit_test(a_loop_neither_drifts_nor_stalls),
        cmocka_unit_test(slow_sequences_are_not_sent_long_before),
        cmocka_unit_test(a_line_names_what_is_wrong_first),
        cmocka_unit_test(long_and_many_names_stay_within),
        cmocka_unit_test(a_list_says_what_to_do),
        cmocka_unit_test(json_has_every_member),
        cmocka_unit_test(blocks_show_two_rows_a_line),
        cmocka_unit_test(blocks_fit),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
