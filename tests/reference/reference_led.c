// SPDX-License-Identifier: Apache-2.0
// reference_led.c - reference_led.h's text as code.
#include "reference_led.h"

#include <math.h>

double reference_led_light(const struct wall_def *d, double code)
{
    const double v = code / 255;
    if (d->transfer == WALL_TRANSFER_GAMMA)
        return pow(v, d->gamma);
    return v > 0.04045 ? pow((v + 0.055) / 1.055, 2.4) : v / 12.92;
}

double reference_led_code(const struct wall_def *d, double light)
{
    if (d->transfer == WALL_TRANSFER_GAMMA)
        return 255 * pow(light, 1 / d->gamma);
    return 255 * (light > 0.04045 / 12.92 ? 1.055 * pow(light, 1 / 2.4) - 0.055 : 12.92 * light);
}

double reference_led_dithered(const struct wall_def *d, double light)
{
    int n = 0;
    while (n < 254 && reference_led_light(d, n + 1) <= light)
        n++;
    const double low = reference_led_light(d, n), high = reference_led_light(d, n + 1);
    return n + (light - low) / (high - low);
}

void reference_led_board(double *light, const struct wall_def *d, const struct wall_layout *l, unsigned board,
                         const float *drive, double fade, double scale)
{
    const struct wall_board_map *m = &l->board[board];
    for (uint32_t k = 0; k < m->leds; k++)
        for (unsigned c = 0; c < 3; c++) {
            double v = 0;
            if (m->pixel[k] >= 0) {
                const double given = (double)drive[3 * (size_t)m->pixel[k] + c];
                v = isnan(given) || given < 0 ? 0 : given > 1 ? 1 : given;
                v *= d->brightness * (double)d->board[board].brightness * (double)d->panel[m->panel[k]].gain[c] * scale * fade;
            }
            light[3 * (size_t)k + c] = v;
        }
}

double reference_led_amps(const struct wall_def *d, const struct wall_layout *l, unsigned board, const uint8_t *bytes)
{
    const struct wall_board *b = &d->board[board];
    const struct wall_board_map *m = &l->board[board];
    double amps = 0;
    for (uint32_t k = 0; k < m->leds; k++) {
        if (m->pixel[k] < 0)
            continue;
        amps += (double)b->idle_amps;
        for (unsigned i = 0; i < 3; i++)
            amps += (double)b->led_amps[b->order[i]] * reference_led_light(d, bytes[3 * (size_t)k + i]);
    }
    return amps;
}
