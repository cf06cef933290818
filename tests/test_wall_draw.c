// SPDX-License-Identifier: Apache-2.0
// test_wall_draw.c - pictures of walls: where colours, rings, wires and dark pixels are, and the PNG files read back.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <png.h>

#include "wall_draw.h"

static const char text[] = "wall: w\n"
                           "size: [20, 10]\n"
                           "panels:\n"
                           "- {name: a, at: [2, 1], size: [4, 4], wiring: {serpentine: true, origin: bottom-right}}\n"
                           "- {name: b, at: [10, 5], size: [3, 3]}\n"
                           "- {name: c, at: [15, 5], size: [3, 3]}\n"
                           "boards:\n"
                           "- {serial: S, panels: a}\n"
                           "- {serial: T, kind: gud, size: [3, 3], panels: b}\n";

struct scene {
    struct wall_def *d;
    struct wall_layout *l;
};

static void scene_init(struct scene *s)
{
    struct fault f = { .code = FAULT_NONE };
    if (wall_def_parse(&s->d, text, strlen(text), NULL, &f) < 0)
        fail_msg("%s", f.text);
    assert_int_equal(wall_layout_make(&s->l, s->d, &f), 0);
}

static void scene_finish(struct scene *s)
{
    wall_layout_free(s->l);
    wall_def_free(s->d);
}

static const uint8_t *at(const struct wall_picture *p, uint32_t x, uint32_t y)
{
    assert_true(x < p->width && y < p->height);
    return p->rgb + 3 * ((size_t)y * p->width + x);
}

/* The wall's corner in the picture: where the ground begins, which is no other thing's colour. */
static void find_wall(const struct wall_picture *p, uint32_t *x, uint32_t *y)
{
    const uint8_t ground[3] = { 0x1c, 0x1f, 0x25 };
    for (*y = 0; *y < p->height; (*y)++)
        for (*x = 0; *x < p->width; (*x)++)
            if (memcmp(at(p, *x, *y), ground, 3) == 0)
                return;
    fail_msg("no wall in the picture");
}

static unsigned bright_in(const struct wall_picture *p, uint32_t x, uint32_t y, uint32_t w, uint32_t h)
{
    unsigned n = 0;
    for (uint32_t j = y; j < y + h; j++)
        for (uint32_t i = x; i < x + w; i++) {
            const uint8_t *c = at(p, i, j);
            n += c[0] > 200 && c[1] > 200 && c[2] > 200;
        }
    return n;
}

static void test_layout(void **state)
{
    (void)state;
    enum { CELL = 24 };
    struct scene s;
    struct wall_picture p;
    struct fault f;
    uint32_t x0 = 0, y0 = 0;
    scene_init(&s);
    assert_int_equal(wall_draw_layout(&p, s.d, s.l, CELL, &f), 0);
    find_wall(&p, &x0, &y0);
    assert_true(p.width >= x0 + 18 * CELL && p.height >= y0 + 9 * CELL);
    // What is drawn begins a pixel beside the first panel: at wall pixel 1, 0.
    assert_true(x0 >= CELL);
    x0 -= CELL;
    // Near a cell's corner lies nothing but the cell: of its board, of a panel without one, of the ground.
    const uint32_t corner = CELL * 5 / 6;
    const uint8_t *a = at(&p, x0 + 3 * CELL + corner, y0 + 3 * CELL + corner), *b = at(&p, x0 + 11 * CELL + corner, y0 + 7 * CELL + corner);
    const uint8_t *c = at(&p, x0 + 16 * CELL + corner, y0 + 7 * CELL + corner);
    assert_true(a[0] > a[1] && a[1] > a[2]);  /* orange */
    assert_true(b[2] > b[1] && b[1] > b[0]);  /* sky blue */
    assert_true(abs(c[0] - c[2]) < 16);       /* grey */
    // Ringed: LED 0 of board 1, bottom right of panel a; of the display the top left. Not ringed: the other corners.
    const unsigned ring = bright_in(&p, x0 + 5 * CELL, y0 + 4 * CELL, CELL, CELL);
    const unsigned other = bright_in(&p, x0 + 2 * CELL, y0 + 1 * CELL, CELL / 2, CELL);
    print_message("bright pixels: %u in the first LED, %u in the last's half\n", ring, other);
    assert_true(ring > 4 * CELL && other < 3 * CELL);
    // The wire turns up at the left end of the lowest row, and not at its right end: serpentine.
    assert_true(bright_in(&p, x0 + 2 * CELL + CELL / 2 - 2, y0 + 3 * CELL + CELL / 2, 4, CELL / 2) > 8);
    assert_int_equal(bright_in(&p, x0 + 5 * CELL + CELL / 2 - 2, y0 + 3 * CELL + CELL * 3 / 4, 4, CELL / 5), 0);
    wall_picture_free(&p);
    wall_picture_free(&p); /* an empty one is fine */
    scene_finish(&s);
}

static void test_sizes(void **state)
{
    (void)state;
    struct scene s;
    struct wall_picture p;
    struct fault f;
    scene_init(&s);
    for (unsigned cell = 1; cell < 40; cell += cell < 8 ? 1 : 7) {
        assert_int_equal(wall_draw_layout(&p, s.d, s.l, cell, &f), 0);
        assert_true(p.width >= 18 * cell && p.height >= 9 * cell);
        wall_picture_free(&p);
    }
    assert_int_equal(wall_draw_layout(&p, s.d, s.l, 0, &f), 0);
    assert_true(p.width >= 1000 && p.width <= 1800);
    wall_picture_free(&p);
    // A wall too large for its cells says so, and takes no memory first.
    static const char large[] = "wall: w\npanels: [{name: p, size: [1024, 1024]}]\n"
                                "boards: [{serial: G, kind: gud, size: [1024, 1024], panels: p}]\n";
    struct wall_def *d;
    struct wall_layout *l;
    assert_int_equal(wall_def_parse(&d, large, strlen(large), NULL, &f), 0);
    assert_int_equal(wall_layout_make(&l, d, &f), 0);
    assert_int_equal(wall_draw_layout(&p, d, l, 256, &f), -1);
    assert_int_equal(f.code, FAULT_LIMIT);
    assert_non_null(strstr(f.text, "make the cells smaller"));
    wall_layout_free(l);
    wall_def_free(d);
    scene_finish(&s);
}

static void test_files(void **state)
{
    (void)state;
    static const uint8_t rgb[2 * 3 * 3] = { 255, 0, 0, 0, 255, 0, 0, 0, 255, 9, 8, 7, 100, 101, 102, 255, 255, 255 };
    char folder[] = "/tmp/airy-draw-XXXXXX", path[64], missing[64];
    struct wall_picture p;
    struct fault f;
    assert_non_null(mkdtemp(folder));
    snprintf(path, sizeof(path), "%s/out.png", folder);
    snprintf(missing, sizeof(missing), "%s/no/out.png", folder);
    assert_int_equal(wall_draw_pixels(&p, 3, 2, rgb, 10, &f), 0);
    assert_int_equal(p.width, 30);
    assert_int_equal(p.height, 20);
    assert_int_equal(wall_picture_write_png(&p, path, &f), 0);
    png_image image = { .version = PNG_IMAGE_VERSION };
    assert_true(png_image_begin_read_from_file(&image, path));
    image.format = PNG_FORMAT_RGB;
    uint8_t *back = malloc(PNG_IMAGE_SIZE(image));
    assert_true(png_image_finish_read(&image, NULL, back, 0, NULL));
    assert_int_equal(image.width, 30);
    assert_int_equal(image.height, 20);
    for (unsigned y = 0; y < 2; y++)
        for (unsigned x = 0; x < 3; x++)
            assert_memory_equal(back + 3 * ((y * 10 + 5) * 30 + x * 10 + 5), rgb + 3 * (y * 3 + x), 3);
    assert_int_equal(back[0] + back[1] + back[2], 0); /* round corners */
    free(back);
    // What cannot be written leaves nothing behind; a file that was there stays whole.
    assert_int_equal(wall_picture_write_png(&p, missing, &f), -1);
    assert_non_null(strstr(f.text, "No such file"));
    assert_int_equal(wall_picture_write_png(&p, folder, &f), -1);
    DIR *dir = opendir(folder);
    unsigned files = 0;
    for (const struct dirent *e; (e = readdir(dir));)
        files += e->d_name[0] != '.' || strstr(e->d_name, "airy") != NULL;
    closedir(dir);
    assert_int_equal(files, 1);
    wall_picture_free(&p);
    unlink(path);
    assert_int_equal(rmdir(folder), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_layout),
        cmocka_unit_test(test_sizes),
        cmocka_unit_test(test_files),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
