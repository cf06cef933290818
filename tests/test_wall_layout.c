// SPDX-License-Identifier: Apache-2.0
// test_wall_layout.c - which LED of a panel is which pixel of the wall: every wiring against a construction that knows nothing
// of formulas (a grid of numbers that is written along the wire, mirrored and turned cell by cell), and layouts of boards.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <string.h>

#include "wall_layout.h"

enum { SIDE = 12 };

/* LED numbers as they lie on a plane. */
struct sheet {
    unsigned width, height;
    unsigned led[SIDE][SIDE]; /* [y][x] */
};

/* Writes the numbers as the wire goes: from the corner, line by line. */
static void sheet_wire(struct sheet *s, const struct wall_panel *p)
{
    const bool right = p->origin == WALL_TOP_RIGHT || p->origin == WALL_BOTTOM_RIGHT;
    const bool bottom = p->origin == WALL_BOTTOM_LEFT || p->origin == WALL_BOTTOM_RIGHT;
    int x = right ? (int)p->width - 1 : 0, y = bottom ? (int)p->height - 1 : 0;
    int dx = p->columns ? 0 : right ? -1 : 1, dy = p->columns ? (bottom ? -1 : 1) : 0;
    const int next_x = p->columns ? (right ? -1 : 1) : 0, next_y = p->columns ? 0 : bottom ? -1 : 1;
    const unsigned lines = p->columns ? p->width : p->height, length = p->columns ? p->height : p->width;
    *s = (struct sheet){ .width = p->width, .height = p->height };
    unsigned led = 0;
    for (unsigned line = 0; line < lines; line++) {
        for (unsigned i = 0; i < length; i++) {
            s->led[y][x] = led++;
            if (i + 1 < length) {
                x += dx;
                y += dy;
            }
        }
        if (p->serpentine) {
            dx = -dx;
            dy = -dy;
        } else {
            x -= dx * (int)(length - 1);
            y -= dy * (int)(length - 1);
        }
        x += next_x;
        y += next_y;
    }
}

static void sheet_mirror(struct sheet *s)
{
    const struct sheet old = *s;
    for (unsigned y = 0; y < s->height; y++)
        for (unsigned x = 0; x < s->width; x++)
            s->led[y][x] = old.led[y][s->width - 1 - x];
}

static void sheet_quarter(struct sheet *s) /* clockwise: the left column becomes the top row, read upwards */
{
    const struct sheet old = *s;
    s->width = old.height;
    s->height = old.width;
    for (unsigned y = 0; y < s->height; y++)
        for (unsigned x = 0; x < s->width; x++)
            s->led[y][x] = old.led[old.height - 1 - x][y];
}

static void check_panel(const struct wall_panel *p)
{
    struct sheet s;
    uint32_t w, h;
    sheet_wire(&s, p);
    if (p->flip_x)
        sheet_mirror(&s);
    if (p->flip_y) { /* upside down is mirrored and turned by half */
        sheet_mirror(&s);
        sheet_quarter(&s);
        sheet_quarter(&s);
    }
    for (unsigned turn = 0; turn < p->rotate; turn += 90)
        sheet_quarter(&s);
    wall_panel_size(p, &w, &h);
    assert_int_equal(w, s.width);
    assert_int_equal(h, s.height);
    for (uint32_t k = 0; k < p->width * p->height; k++) {
        uint32_t x = 0, y = 0;
        wall_panel_led(p, k, &x, &y);
        if (x < p->x || y < p->y || x - p->x >= w || y - p->y >= h || s.led[y - p->y][x - p->x] != k) {
            print_error("%u x %u rotate %u flip %d %d columns %d serpentine %d origin %d: LED %u at %u, %u\n", p->width, p->height,
                        p->rotate, p->flip_x, p->flip_y, p->columns, p->serpentine, p->origin, k, x, y);
            fail();
        }
    }
}

static void test_every_wiring(void **state)
{
    (void)state;
    static const unsigned sizes[][2] = { { 5, 3 }, { 3, 4 }, { 1, 7 }, { 7, 1 }, { 1, 1 }, { 8, 8 }, { 12, 11 } };
    unsigned tried = 0;
    for (unsigned size = 0; size < sizeof(sizes) / sizeof(sizes[0]); size++)
        for (unsigned bits = 0; bits < 256; bits++) {
            const struct wall_panel p = { .x = 100 + bits, .y = 7, .width = sizes[size][0], .height = sizes[size][1],
                                          .rotate = 90 * (bits & 3), .flip_x = bits >> 2 & 1, .flip_y = bits >> 3 & 1,
                                          .origin = (enum wall_corner)(bits >> 4 & 3), .columns = bits >> 6 & 1,
                                          .serpentine = bits >> 7 & 1 };
            check_panel(&p);
            tried++;
        }
    assert_int_equal(tried, 7 * 256);
}

/* One by hand, so that the words and not only two programs agree: 3 x 2, from the bottom right, columns there and back,
 * mirrored left to right, turned by 90 degrees clockwise. On the panel, from the corner upwards, then the next column down:
 *     (2,1) 0, (2,0) 1, (1,0) 2, (1,1) 3, (0,1) 4, (0,0) 5.
 * Mirrored: (0,1) 0, (0,0) 1, (1,0) 2, (1,1) 3, (2,1) 4, (2,0) 5. Turned: (x, y) -> (1 - y, x). */
static void test_one_by_hand(void **state)
{
    (void)state;
    const struct wall_panel p = { .width = 3, .height = 2, .rotate = 90, .flip_x = true, .origin = WALL_BOTTOM_RIGHT, .columns = true,
                                  .serpentine = true };
    static const uint32_t at[6][2] = { { 0, 0 }, { 1, 0 }, { 1, 1 }, { 0, 1 }, { 0, 2 }, { 1, 2 } };
    for (uint32_t k = 0; k < 6; k++) {
        uint32_t x, y;
        wall_panel_led(&p, k, &x, &y);
        assert_int_equal(x, at[k][0]);
        assert_int_equal(y, at[k][1]);
    }
}

static struct wall_layout *layout_of(const char *text, struct wall_def **d)
{
    struct fault f = { .code = FAULT_NONE };
    struct wall_layout *l;
    if (wall_def_parse(d, text, strlen(text), NULL, &f) < 0)
        fail_msg("%s", f.text);
    assert_int_equal(wall_layout_make(&l, *d, &f), 0);
    return l;
}

static void test_runs(void **state)
{
    (void)state;
    struct wall_def *d;
    struct wall_layout *l = layout_of("wall: w\n"
                                      "size: [20, 10]\n"
                                      "panels:\n"
                                      "- {name: a, at: [2, 3], size: [4, 2]}\n"
                                      "- {name: b, at: [10, 5], size: [3, 3], rotate: 180}\n"
                                      "boards:\n"
                                      "- serial: S\n"
                                      "  leds:\n"
                                      "  - {panel: a, first: 1, count: 3, strip: 2, at: 5, reversed: true}\n"
                                      "  - {panel: b}\n"
                                      "  - {panel: a, first: 4, at: 0}\n", &d);
    assert_int_equal(l->boards, 1);
    assert_int_equal(l->board[0].leds, 512);
    assert_int_equal(l->lit, 3 + 9 + 4);
    const struct wall_board_map *b = &l->board[0];
    // Reversed: the third, second, first of panel a's LEDs 1 to 3, which lie at x 3 to 5 of row 3.
    for (unsigned i = 0; i < 3; i++) {
        assert_int_equal(b->pixel[2 * 64 + 5 + i], 3 * 20 + 5 - i);
        assert_int_equal(b->panel[2 * 64 + 5 + i], 0);
    }
    // Without a place: behind the run before. Turned by half: from the bottom right corner backwards.
    for (unsigned i = 0; i < 9; i++) {
        assert_int_equal(b->pixel[2 * 64 + 8 + i], (7 - i / 3) * 20 + 12 - i % 3);
        assert_int_equal(b->panel[2 * 64 + 8 + i], 1);
    }
    for (unsigned i = 0; i < 4; i++)
        assert_int_equal(b->pixel[i], 4 * 20 + 2 + i);
    unsigned dark = 0;
    for (unsigned i = 0; i < 512; i++)
        dark += b->pixel[i] == -1;
    assert_int_equal(dark, 512 - 16);
    assert_int_equal(l->x0, 2);
    assert_int_equal(l->y0, 3);
    assert_int_equal(l->x1, 13);
    assert_int_equal(l->y1, 8);
    wall_layout_free(l);
    wall_def_free(d);
    wall_layout_free(NULL);
}

/* A display: panels are rectangles of its pixels, the next to the right, then below. */
static void test_display(void **state)
{
    (void)state;
    struct wall_def *d;
    struct wall_layout *l = layout_of("wall: w\n"
                                      "panels:\n"
                                      "- {name: t, grid: [3, 1], size: [4, 2]}\n"
                                      "- {name: low, at: [0, 2], size: [4, 2], rotate: 180}\n"
                                      "boards:\n"
                                      "- {serial: G, kind: gud, size: [8, 6], leds: [{panels: t}, {panel: low, corner: [4, 4]}]}\n", &d);
    assert_int_equal(d->width, 12);
    assert_int_equal(d->height, 4);
    for (unsigned y = 0; y < 6; y++)
        for (unsigned x = 0; x < 8; x++) {
            int expected = -1;
            if (y < 2)
                expected = (int)(y * 12 + x);               /* t-1, t-2 */
            else if (y < 4 && x < 4)
                expected = (int)((y - 2) * 12 + 8 + x);     /* t-3 */
            else if (y >= 4 && x >= 4)
                expected = (int)((3 - (y - 4)) * 12 + 3 - (x - 4));
            assert_int_equal(l->board[0].pixel[y * 8 + x], expected);
        }
    wall_layout_free(l);
    wall_def_free(d);
}

/* A grid whose panels follow each other there and back, by columns from the bottom right. */
static void test_grid(void **state)
{
    (void)state;
    struct wall_def *d;
    struct wall_layout *l = layout_of("wall: w\n"
                                      "panels:\n"
                                      "- name: t\n"
                                      "  grid: [2, 3]\n"
                                      "  size: [4, 2]\n"
                                      "  at: [1, 1]\n"
                                      "  gap: [1, 2]\n"
                                      "  rotate: 90\n"
                                      "  grid order: {run: columns, serpentine: yes, origin: bottom-right}\n"
                                      "boards:\n"
                                      "- {serial: S, panels: [t-2 to t-3, t-1]}\n", &d);
    static const uint32_t at[6][2] = { { 4, 13 }, { 4, 7 }, { 4, 1 }, { 1, 1 }, { 1, 7 }, { 1, 13 } };
    assert_int_equal(d->n_panels, 6);
    for (unsigned i = 0; i < 6; i++) {
        char name[8] = { 't', '-', (char)('1' + i), 0 };
        assert_string_equal(d->panel[i].name, name);
        assert_int_equal(d->panel[i].x, at[i][0]);
        assert_int_equal(d->panel[i].y, at[i][1]);
    }
    assert_int_equal(l->board[0].panel[0], 1);
    assert_int_equal(l->board[0].panel[8], 2);
    assert_int_equal(l->board[0].panel[16], 0);
    assert_int_equal(l->lit, 24);
    assert_int_equal(d->width, 6);
    assert_int_equal(d->height, 17);
    wall_layout_free(l);
    wall_def_free(d);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_every_wiring), cmocka_unit_test(test_one_by_hand), cmocka_unit_test(test_runs),
        cmocka_unit_test(test_display),      cmocka_unit_test(test_grid),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
