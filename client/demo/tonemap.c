// SPDX-License-Identifier: Apache-2.0
// tonemap.c - EXR to PNG for looking at: exposure, a filmic curve (METHODS section 1.8, aces), sRGB. The
// same for all pictures of a run, so that they can be compared.
//     tonemap IN.exr OUT.png
//     tonemap -glow BEFORE.exr AFTER.exr OUT.png      the difference, in linear light
//     tonemap -side BEFORE.exr AFTER.exr OUT.png W    the left half of one, the right half of the other
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "picture.h"
#include "png.h"

static const float exposure = 1.5f;

static uint8_t display(float v)
{
    v = fmaxf(0, v * exposure) * .8f;
    v = v > 1e4f ? 1 : v * (2.51f * v + .03f) / (v * (2.43f * v + .59f) + .14f);
    v = v > 1 ? 1 : v;
    v = v <= .0031308f ? 12.92f * v : 1.055f * powf(v, 1 / 2.4f) - .055f;
    return (uint8_t)(v * 255 + .5f);
}

static int write_png(const char *path, const float *rgb, int width, int height)
{
    size_t n = 3 * (size_t)width * (size_t)height;
    uint8_t *bytes = malloc(n);
    if (!bytes)
        return -1;
    for (size_t i = 0; i < n; i++)
        bytes[i] = display(rgb[i]);
    int r = png_write(path, bytes, width, height);
    free(bytes);
    return r;
}

static void subtract(struct picture *a, const struct picture *b)
{
    for (size_t i = 0; i < 3 * (size_t)a->width * (size_t)a->height; i++)
        a->rgb[i] -= b->rgb[i];
}

/* Shrinks in display values, which is what the eye averages in a small picture; a light line parts the
 * halves. */
static int side_by_side(const char *path, const struct picture *before, const struct picture *after,
                        int width)
{
    int height = (int)lround((double)width * before->height / before->width);
    uint8_t *bytes = malloc(3 * (size_t)width * (size_t)height);
    if (!bytes)
        return -1;
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++)
            for (int c = 0; c < 3; c++) {
                const struct picture *p = 2 * x < width ? before : after;
                int x0 = (int)((long)x * p->width / width), x1 = (int)((long)(x + 1) * p->width / width);
                int y0 = (int)((long)y * p->height / height),
                    y1 = (int)((long)(y + 1) * p->height / height);
                unsigned sum = 0, n = 0;
                for (int sy = y0; sy < (y1 > y0 ? y1 : y0 + 1); sy++)
                    for (int sx = x0; sx < (x1 > x0 ? x1 : x0 + 1); sx++, n++)
                        sum += display(
                            p->rgb[3 * ((size_t)sy * (size_t)p->width + (size_t)sx) + (size_t)c]);
                bytes[3 * ((size_t)y * (size_t)width + (size_t)x) + (size_t)c] =
                    x == width / 2 ? 190 : (uint8_t)(sum / n);
            }
    int r = png_write(path, bytes, width, height);
    free(bytes);
    return r;
}

int main(int argc, char **argv)
{
    struct picture a = { 0 }, b = { 0 };
    int r = -1, glow = argc == 5 && strcmp(argv[1], "-glow") == 0;
    int side = argc == 6 && strcmp(argv[1], "-side") == 0 && atoi(argv[5]) > 0;
    if (argc == 3) {
        r = picture_read(&a, argv[1]);
        r = r < 0 ? r : write_png(argv[2], a.rgb, a.width, a.height);
    } else if (glow || side) {
        r = picture_read(&a, argv[2]) < 0 || picture_read(&b, argv[3]) < 0 ? -1 : 0;
        if (r == 0 && (a.width != b.width || a.height != b.height)) {
            fputs("tonemap: pictures of different sizes\n", stderr);
            r = -1;
        }
        if (r == 0 && glow)
            subtract(&b, &a);
        if (r == 0)
            r = glow ? write_png(argv[4], b.rgb, b.width, b.height)
                     : side_by_side(argv[4], &a, &b, atoi(argv[5]));
    } else {
        fputs("tonemap [-glow|-side] IN.exr... OUT.png [WIDTH]\n", stderr);
    }
    picture_free(&a);
    picture_free(&b);
    return r < 0 ? 1 : 0;
}
