// SPDX-License-Identifier: Apache-2.0
// look_sun.c - where mip-chain's sun stands, and how much of it the scene leaves open: 64 depths around it, read on the host,
// for a pass would cost more than they do.
#include <math.h>
#include <string.h>

#include "look_internal.h"

void look_sun_place(const struct params *p, uint32_t width, uint32_t height, uint32_t display_width, double aspect,
                    double *x, double *y, double *radius)
{
    const struct sun_spec *sun = &p->sun_spec;
    *x = sun->x_percent / 100 * width;
    *y = sun->y_percent / 100 * height;
    *radius = sun->given ? params_pixels(p, &sun->radius, width, height, display_width ? display_width : width, aspect) : 0;
}

static float depth_at(const struct planes *in, uint32_t x, uint32_t y)
{
    const uint8_t *row = planes_row(in, 0, y);
    float v;
    if (in->type == PIXEL_TYPE_HALF) {
        uint16_t h;
        memcpy(&h, row + (size_t)x * 2, sizeof(h));
        half_to_float(&v, &h, 1);
    } else {
        memcpy(&v, row + (size_t)x * 4, sizeof(v));
    }
    return v;
}

static float farthest(const struct planes *in)
{
    float most = -INFINITY;
    for (uint32_t y = 0; y < in->height; y++)
        for (uint32_t x = 0; x < in->width; x++) {
            const float z = depth_at(in, x, y);
            if (isfinite(z) && z > most)
                most = z;
        }
    return most;
}

double look_sun_share(const struct bloom *b, const struct bloom_slot *s, const struct bloom_request *request)
{
    enum { POINTS = 64 };
    const struct params *p = request->params;
    if (request->depth < 0 || !p->sun_spec.given)
        return 1;
    struct planes in;
    slot_input(b, s, (unsigned)request->depth, &in);
    double x, y, radius;
    look_sun_place(p, in.width, in.height, request->display_width, request->pixel_aspect, &x, &y, &radius);
    const double turn = acos(-1) * (3 - sqrt(5));
    const float most = farthest(&in);
    unsigned inside = 0, open = 0;
    for (unsigned i = 0; i < POINTS; i++) {
        const double r = radius * sqrt((i + .5) / POINTS);
        const double px = floor(x + r * cos(i * turn) / request->pixel_aspect), py = floor(y + r * sin(i * turn));
        if (px < 0 || py < 0 || px >= in.width || py >= in.height)
            continue;
        const float z = depth_at(&in, (uint32_t)px, (uint32_t)py);
        inside++;
        open += z == INFINITY || (isfinite(z) && z >= most);
    }
    return inside ? (double)open / inside : 1;
}
