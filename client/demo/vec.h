/* SPDX-License-Identifier: Apache-2.0 */
/*
 * vec.h - three floats, hashes and value noise, for the demo's scene.
 */
#ifndef AIRY_DEMO_VEC_H
#define AIRY_DEMO_VEC_H

#include <math.h>

#include "street.h"

static inline struct vec vec(float x, float y, float z) { return (struct vec){ x, y, z }; }
static inline struct vec add(struct vec a, struct vec b) { return vec(a.x + b.x, a.y + b.y, a.z + b.z); }
static inline struct vec sub(struct vec a, struct vec b) { return vec(a.x - b.x, a.y - b.y, a.z - b.z); }
static inline struct vec scale(struct vec a, float s) { return vec(a.x * s, a.y * s, a.z * s); }
static inline struct vec times(struct vec a, struct vec b)
{
    return vec(a.x * b.x, a.y * b.y, a.z * b.z);
}
static inline float dot(struct vec a, struct vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline struct vec along(struct vec o, struct vec d, float t) { return add(o, scale(d, t)); }
static inline struct vec unit(struct vec a) { return scale(a, 1 / sqrtf(dot(a, a))); }
static inline struct vec blend(struct vec a, struct vec b, float t)
{
    return add(a, scale(sub(b, a), t));
}
static inline float clamp01(float v) { return v < 0 ? 0 : v > 1 ? 1 : v; }
static inline float ramp(float low, float high, float v)
{
    float t = clamp01((v - low) / (high - low));
    return t * t * (3 - 2 * t);
}

static inline uint32_t hash(uint32_t v)
{
    v = v * 747796405u + 2891336453u;
    v = ((v >> ((v >> 28) + 4)) ^ v) * 277803737u;
    return (v >> 22) ^ v;
}
static inline float hash2(int x, int y, uint32_t seed)
{
    return (float)(hash((uint32_t)x + hash((uint32_t)y + hash(seed))) >> 8) * 0x1p-24f;
}
static inline float random01(uint32_t *state)
{
    *state = *state * 1664525u + 1013904223u;
    return (float)(hash(*state) >> 8) * 0x1p-24f;
}

static inline float noise(float x, float y, uint32_t seed)
{
    float fx = floorf(x), fy = floorf(y), tx = ramp(0, 1, x - fx), ty = ramp(0, 1, y - fy);
    int ix = (int)fx, iy = (int)fy;
    float a = hash2(ix, iy, seed), b = hash2(ix + 1, iy, seed);
    float c = hash2(ix, iy + 1, seed), d = hash2(ix + 1, iy + 1, seed);
    return a + (b - a) * tx + (c - a + (a - b - c + d) * tx) * ty;
}
static inline float fbm(float x, float y, uint32_t seed, int octaves)
{
    float sum = 0, weight = .5f;
    for (int i = 0; i < octaves; i++, x *= 2.03f, y *= 2.03f, weight *= .5f)
        sum += weight * noise(x, y, seed + (uint32_t)i);
    return sum;
}

#endif
