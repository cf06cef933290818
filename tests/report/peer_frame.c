// SPDX-License-Identifier: Apache-2.0
// peer_frame.c - the frame that other programs are tried on, and the error of what they made of it.
//     peer_frame make W H OUT.pfm OUT.exr    one point of 1 in the middle of black
//     peer_frame error FILE GAIN ADDED       the worst |difference| from the sampled Gaussian of sigma 20, of its peak, in the
//                                            picture's red: FILE (PFM or EXR) is GAIN * blurred + ADDED * the frame
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "picture.h"

static const double SIGMA = 20;
enum { SIDE_MAX = 16384 };

static int pfm_write(const char *path, const struct picture *p)
{
    FILE *f = fopen(path, "we");
    if (!f)
        return -1;
    fprintf(f, "PF\n%d %d\n-1.0\n", p->width, p->height);
    // Rows from the bottom up; the frame is its own mirror image but for the point.
    for (int y = p->height; y-- > 0;)
        fwrite(p->rgb + 3 * (size_t)p->width * (size_t)y, 3 * sizeof(float), (size_t)p->width, f);
    return ferror(f) | fclose(f) ? -1 : 0;
}

static void swap_bytes(float *v, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        uint32_t b;
        memcpy(&b, &v[i], sizeof b);
        b = __builtin_bswap32(b);
        memcpy(&v[i], &b, sizeof b);
    }
}

static int pfm_rows(FILE *f, struct picture *p, int channels, double scale)
{
    size_t n = (size_t)channels * (size_t)p->width;
    float *row = calloc(n, sizeof(*row));
    int y = p->height;
    while (row && y > 0 && fread(row, sizeof(*row), n, f) == n) {
        if (scale > 0) // big-endian
            swap_bytes(row, n);
        for (int x = (y--, 0); x < p->width; x++)
            for (int c = 0; c < 3; c++)
                p->rgb[3 * ((size_t)y * (size_t)p->width + (size_t)x) + (size_t)c] =
                    row[channels * x + (c < channels ? c : 0)];
    }
    free(row);
    return y ? -1 : 0;
}

static int pfm_read(struct picture *p, const char *path)
{
    char kind[3];
    int w, h, r = -1;
    double scale;
    FILE *f = fopen(path, "re");
    if (!f)
        return -1;
    if (fscanf(f, "%2s %d %d %lf", kind, &w, &h, &scale) == 4 && fgetc(f) == '\n' && w > 0 && h > 0 && w <= SIDE_MAX &&
        h <= SIDE_MAX && (!strcmp(kind, "PF") || !strcmp(kind, "Pf")) && picture_alloc(p, w, h) == 0)
        r = pfm_rows(f, p, kind[1] == 'F' ? 3 : 1, scale);
    fclose(f);
    return r;
}

static double worst_error(const struct picture *p, double gain, double added)
{
    double norm = 1, worst = 0;
    for (int x = 1; x < 9 * SIGMA; x++)
        norm += 2 * exp(-x * x / (2 * SIGMA * SIGMA));
    for (int y = 0; y < p->height; y++)
        for (int x = 0; x < p->width; x++) {
            double dx = x - p->width / 2, dy = y - p->height / 2;
            double v = p->rgb[3 * ((size_t)y * (size_t)p->width + (size_t)x)] - (dx == 0 && dy == 0 ? added : 0);
            double e = fabs(v / gain * norm * norm - exp(-(dx * dx + dy * dy) / (2 * SIGMA * SIGMA)));
            worst = e > worst || isnan(e) ? e : worst;
        }
    return worst;
}

static int make(int width, int height, const char *pfm, const char *exr)
{
    struct picture p;
    if (width < 1 || height < 1 || width > SIDE_MAX || height > SIDE_MAX || picture_alloc(&p, width, height) < 0)
        return -1;
    for (size_t i = 0; i < 3 * (size_t)width * (size_t)height; i++)
        p.rgb[i] = 0;
    for (size_t c = 0; c < 3; c++)
        p.rgb[3 * ((size_t)(height / 2) * (size_t)width + (size_t)(width / 2)) + c] = 1;
    int r = pfm_write(pfm, &p) < 0 || picture_write(exr, &p) < 0 ? -1 : 0;
    picture_free(&p);
    return r;
}

int main(int argc, char **argv)
{
    struct picture p = { 0 };
    if (argc == 6 && !strcmp(argv[1], "make"))
        return make(atoi(argv[2]), atoi(argv[3]), argv[4], argv[5]) < 0;
    if (argc != 5 || strcmp(argv[1], "error") || !(atof(argv[3]) > 0)) {
        fputs("Usage: peer_frame make W H OUT.pfm OUT.exr | peer_frame error FILE GAIN ADDED\n", stderr);
        return 2;
    }
    size_t n = strlen(argv[2]);
    if ((n > 4 && !strcmp(argv[2] + n - 4, ".pfm") ? pfm_read(&p, argv[2]) : picture_read(&p, argv[2])) < 0) {
        fprintf(stderr, "%s: no picture\n", argv[2]);
        return 1;
    }
    printf("%.4g\n", worst_error(&p, atof(argv[3]), atof(argv[4])));
    picture_free(&p);
    return 0;
}
