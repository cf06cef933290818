/* SPDX-License-Identifier: Apache-2.0 */
/*
 * reference_led.h - what a wall's LEDs should show, in float64, from the definition's own words and with none of the code under
 * test: the judge of wall_colour. No table, no dither, no speed.
 */
#ifndef AIRY_REFERENCE_LED_H
#define AIRY_REFERENCE_LED_H

#include "wall_layout.h"

/* The light (0..1) of a code 0..255 that need not be whole, and the code of a light. */
double reference_led_light(const struct wall_def *d, double code);
double reference_led_code(const struct wall_def *d, double light);

/* The code whose fraction is the share of the time that the next byte is shown, so that the mean light is right. */
double reference_led_dithered(const struct wall_def *d, double light);

/* light[3 * leds]: R, G, B of each LED of a board; dark LEDs 0. scale: of its supply. */
void reference_led_board(double *light, const struct wall_def *d, const struct wall_layout *l, unsigned board,
                         const float *drive, double fade, double scale);

/* Amps of a board that shows bytes (as on the wire). */
double reference_led_amps(const struct wall_def *d, const struct wall_layout *l, unsigned board, const uint8_t *bytes);

#endif
