// SPDX-License-Identifier: Apache-2.0
// scene.c - renders the demo's frame: scene OUT.exr [WIDTH HEIGHT]. Rows are handed to the
// cores; each pixel has its own random numbers, so the picture does not depend on how many there are.
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "picture.h"
#include "vec.h"

static struct picture picture;
static atomic_int next_row;

/* Film grain: of the light's square root, as light comes in quanta. */
static float grained(float v, uint32_t *random)
{
    float bell = random01(random) + random01(random) + random01(random) - 1.5f;
    return fmaxf(0, v + bell * (.010f * sqrtf(v) + .0012f));
}

enum { FEW = 4, MANY = 10 }; /* samples: where a pixel is even, and where it is not */

static struct vec sample(int x, int y, int i, uint32_t *random, float *nearest)
{
    float height = (float)picture.height, depth;
    float sx = ((float)(i % 2) + random01(random)) * .5f,
          sy = ((float)(i / 2 % 2) + random01(random)) * .5f;
    struct vec c = street_look(((float)x + sx - .5f * (float)picture.width) / height,
                               (.5f * height - (float)y - sy) / height, random, &depth);
    *nearest = fminf(*nearest, depth);
    return c;
}

static void render_pixel(int x, int y)
{
    uint32_t random = hash((uint32_t)x + hash((uint32_t)y));
    size_t at = (size_t)y * (size_t)picture.width + (size_t)x;
    float height = (float)picture.height, nearest = 1e4f, low = 1, high = 0;
    struct vec sum = { 0 };
    int n = 0;
    while (n < FEW || (n < MANY && high - low > .04f)) {
        struct vec c = sample(x, y, n++, &random, &nearest);
        float shown = dot(c, vec(.3f, .6f, .1f));
        shown = sqrtf(shown / (1 + shown));
        low = fminf(low, shown);
        high = fmaxf(high, shown);
        sum = add(sum, c);
    }
    /* A real lens loses light towards the corners. */
    float cx = ((float)x / (float)picture.width - .5f) * 1.6f, cy = ((float)y / height - .5f) * .9f;
    float fall = 1 / ((1 + .35f * (cx * cx + cy * cy)) * (1 + .35f * (cx * cx + cy * cy)));
    sum = scale(sum, fall / (float)n);
    picture.rgb[3 * at] = grained(sum.x, &random);
    picture.rgb[3 * at + 1] = grained(sum.y, &random);
    picture.rgb[3 * at + 2] = grained(sum.z, &random);
    picture.z[at] = nearest;
}

static void *render_rows(void *unused)
{
    (void)unused;
    for (int y; (y = atomic_fetch_add(&next_row, 1)) < picture.height;)
        for (int x = 0; x < picture.width; x++)
            render_pixel(x, y);
    return NULL;
}

int main(int argc, char **argv)
{
    enum { THREADS_MAX = 64 };
    pthread_t threads[THREADS_MAX];
    long cores = sysconf(_SC_NPROCESSORS_ONLN);
    int width = argc > 3 ? atoi(argv[2]) : 1920, height = argc > 3 ? atoi(argv[3]) : 1080, n = 0;
    if (argc < 2 || width < 1 || height < 1 || width > 16384 || height > 16384) {
        fputs("scene OUT.exr [WIDTH HEIGHT]\n", stderr);
        return 2;
    }
    if (picture_alloc(&picture, width, height) < 0)
        return 1;
    street_init();
    while (n < cores - 1 && n < THREADS_MAX && pthread_create(&threads[n], NULL, render_rows, NULL) == 0)
        n++;
    render_rows(NULL);
    while (n > 0)
        pthread_join(threads[--n], NULL);
    int r = picture_write(argv[1], &picture);
    picture_free(&picture);
    return r < 0 ? 1 : 0;
}
