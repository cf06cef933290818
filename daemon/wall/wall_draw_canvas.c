// SPDX-License-Identifier: Apache-2.0
// wall_draw_canvas.c - shapes with soft edges: each is a signed distance (negative inside), and a pixel is covered by
// 1/2 - distance, held to 0..1. Only the pixels of a shape's bounding box are looked at.
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <fcntl.h>
#include <unistd.h>

#include <png.h>

#include "wall_draw_internal.h"

int canvas_init(struct wall_picture *c, uint64_t width, uint64_t height, struct ink back, struct fault *f)
{
    if (width == 0 || height == 0 || width > 65535 || height > 65535 || width * height > WALL_DRAW_PIXELS_MAX)
        return fault_set(f, FAULT_LIMIT, "cell", "the picture would be %llu x %llu; expected at most %u pixels: make the cells smaller",
                         (unsigned long long)width, (unsigned long long)height, WALL_DRAW_PIXELS_MAX);
    uint8_t *rgb = malloc((size_t)(width * height * 3));
    if (!rgb)
        return fault_set(f, FAULT_NO_MEMORY, "", "no memory for a picture of %llu x %llu", (unsigned long long)width,
                         (unsigned long long)height);
    for (uint64_t i = 0; i < width * height; i++) {
        rgb[3 * i] = back.r;
        rgb[3 * i + 1] = back.g;
        rgb[3 * i + 2] = back.b;
    }
    *c = (struct wall_picture){ (uint32_t)width, (uint32_t)height, rgb };
    return 0;
}

static void blend(struct wall_picture *c, long x, long y, struct ink ink, double coverage)
{
    uint8_t *p = c->rgb + 3 * ((size_t)y * c->width + (size_t)x);
    const double a = ink.alpha * coverage;
    p[0] = (uint8_t)lrint(p[0] + (ink.r - p[0]) * a);
    p[1] = (uint8_t)lrint(p[1] + (ink.g - p[1]) * a);
    p[2] = (uint8_t)lrint(p[2] + (ink.b - p[2]) * a);
}

struct shape {
    double x0, y0, x1, y1; /* corners of a rectangle; ends of a line */
    double round;          /* of corners, or half of a line's width */
    double hollow;         /* > 0: only the border, so wide, inside */
    double dx, dy, size;
};

static void fill(struct wall_picture *c, double x0, double y0, double x1, double y1, const struct shape *s,
                 double (*distance)(const struct shape *, double, double), struct ink ink)
{
    const long left = lrint(fmax(0, floor(x0 - 1))), right = lrint(fmin(c->width, ceil(x1 + 1)));
    const long top = lrint(fmax(0, floor(y0 - 1))), bottom = lrint(fmin(c->height, ceil(y1 + 1)));
    for (long y = top; y < bottom; y++)
        for (long x = left; x < right; x++) {
            const double d = distance(s, (double)x + 0.5, (double)y + 0.5);
            if (d < 0.5)
                blend(c, x, y, ink, fmin(1, 0.5 - d));
        }
}

static double hollowed(const struct shape *s, double d) { return s->hollow > 0 ? fmax(d, -d - s->hollow) : d; }

static double to_rectangle(const struct shape *s, double x, double y)
{
    const double dx = fabs(x - (s->x0 + s->x1) / 2) - (s->x1 - s->x0) / 2 + s->round;
    const double dy = fabs(y - (s->y0 + s->y1) / 2) - (s->y1 - s->y0) / 2 + s->round;
    return hollowed(s, hypot(fmax(dx, 0), fmax(dy, 0)) + fmin(fmax(dx, dy), 0) - s->round);
}

static double to_line(const struct shape *s, double x, double y)
{
    const double lx = s->x1 - s->x0, ly = s->y1 - s->y0, square = lx * lx + ly * ly;
    const double t = square > 0 ? fmin(1, fmax(0, ((x - s->x0) * lx + (y - s->y0) * ly) / square)) : 0;
    return hypot(x - s->x0 - t * lx, y - s->y0 - t * ly) - s->round;
}

static double to_ring(const struct shape *s, double x, double y)
{
    return hollowed(s, hypot(x - s->x0, y - s->y0) - s->round);
}

/* A triangle with its tip at x0, y0, as long as wide. */
static double to_head(const struct shape *s, double x, double y)
{
    const double along = (s->x0 - x) * s->dx + (s->y0 - y) * s->dy; /* behind the tip */
    const double across = fabs((x - s->x0) * s->dy - (y - s->y0) * s->dx);
    return fmax(along - s->size, (across - along / 2) / 1.118); /* 1.118: sqrt(1 + 1/4), the edge's slope */
}

void canvas_rectangle(struct wall_picture *c, double x, double y, double w, double h, double radius, struct ink ink)
{
    const struct shape s = { .x0 = x, .y0 = y, .x1 = x + w, .y1 = y + h, .round = fmin(radius, fmin(w, h) / 2) };
    fill(c, x, y, x + w, y + h, &s, to_rectangle, ink);
}

void canvas_frame(struct wall_picture *c, double x, double y, double w, double h, double line, struct ink ink)
{
    const struct shape s = { .x0 = x, .y0 = y, .x1 = x + w, .y1 = y + h, .hollow = line };
    // Four sides: the middle of a large frame need not be looked at.
    fill(c, x, y, x + w, y + line, &s, to_rectangle, ink);
    fill(c, x, y + h - line, x + w, y + h, &s, to_rectangle, ink);
    const struct shape sides[2] = { { .x0 = x, .y0 = y + line, .x1 = x + line, .y1 = y + h - line },
                                    { .x0 = x + w - line, .y0 = y + line, .x1 = x + w, .y1 = y + h - line } };
    for (unsigned i = 0; i < 2; i++)
        fill(c, sides[i].x0, sides[i].y0, sides[i].x1, sides[i].y1, &sides[i], to_rectangle, ink);
}

void canvas_line(struct wall_picture *c, double x0, double y0, double x1, double y1, double width, struct ink ink)
{
    const double r = width / 2;
    const struct shape s = { .x0 = x0, .y0 = y0, .x1 = x1, .y1 = y1, .round = r };
    fill(c, fmin(x0, x1) - r, fmin(y0, y1) - r, fmax(x0, x1) + r, fmax(y0, y1) + r, &s, to_line, ink);
}

void canvas_ring(struct wall_picture *c, double x, double y, double radius, double line, struct ink ink)
{
    const struct shape s = { .x0 = x, .y0 = y, .round = radius, .hollow = line };
    fill(c, x - radius, y - radius, x + radius, y + radius, &s, to_ring, ink);
}

void canvas_head(struct wall_picture *c, double x, double y, double dx, double dy, double size, struct ink ink)
{
    const struct shape s = { .x0 = x, .y0 = y, .dx = dx, .dy = dy, .size = size };
    fill(c, x - size * 1.2, y - size * 1.2, x + size * 1.2, y + size * 1.2, &s, to_head, ink);
}

/* ---- files ---------------------------------------------------------------------------------------------------------- */

static int failed(struct fault *f, const char *path, const char *why)
{
    return fault_set(f, FAULT_INTERNAL, "output", "%.200s: cannot be written: %s", path, why);
}

/* A hidden name in the same folder: only there is a rename one step. */
static char *temp_name(const char *path)
{
    uint64_t random;
    const char *slash = strrchr(path, '/');
    const int folder = slash ? (int)(slash + 1 - path) : 0;
    char *name;
    if (getrandom(&random, sizeof(random), 0) != (ssize_t)sizeof(random) ||
        asprintf(&name, "%.*s.%.200s.airy-%016llx", folder, path, path + folder, (unsigned long long)random) < 0)
        return NULL;
    return name;
}

int wall_picture_write_png(const struct wall_picture *p, const char *path, struct fault *f)
{
    png_image image = { .version = PNG_IMAGE_VERSION, .width = p->width, .height = p->height, .format = PNG_FORMAT_RGB };
    char *temp = temp_name(path);
    if (!temp)
        return fault_set(f, FAULT_NO_MEMORY, "output", "no memory to write %.200s", path);
    const int fd = open(temp, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0666);
    FILE *file = fd >= 0 ? fdopen(fd, "wb") : NULL;
    const char *why = NULL;
    if (!file) {
        why = strerror(errno);
        if (fd >= 0)
            close(fd);
    } else {
        if (!png_image_write_to_stdio(&image, file, 0, p->rgb, 0, NULL))
            why = image.message;
        else if (fflush(file) != 0 || fsync(fd) < 0)
            why = strerror(errno);
        if (fclose(file) != 0 && !why)
            why = strerror(errno);
        if (!why && rename(temp, path) < 0)
            why = strerror(errno);
    }
    const int result = why ? failed(f, path, why) : 0;
    if (why && fd >= 0)
        unlink(temp);
    free(temp);
    return result;
}

void wall_picture_free(struct wall_picture *p)
{
    free(p->rgb);
    *p = (struct wall_picture){ 0 };
}
