// SPDX-License-Identifier: Apache-2.0
// street.c - the street: what a ray meets, and how that is lit. x right, y up, z along the street, in
// metres. Lamps light surfaces as points (no shadows: rain and dust fill them), are seen as small
// spheres, and shine in the wet ground as a rough highlight in closed form; everything else in the
// ground is one jittered mirror ray.
#include "street.h"

#include <stdbool.h>
#include <stddef.h>

#include "signs.h"
#include "vec.h"

enum { N_BLOCKS = 30, N_LAMPS = 18, N_STRINGS = 4, STRING_BULBS = 17, N_LIGHTS_MAX = 48 };
static const float far_away = 1e4f;

struct box {
    struct vec low, high;
    uint32_t seed;
};
struct ball {
    struct vec at, light;
    float radius;
};
struct light {
    struct vec at, power;
};

static struct box blocks[N_BLOCKS];
static struct ball lamps[N_LAMPS], bulbs[N_STRINGS * STRING_BULBS], beacons[8];
static struct light lights[N_LIGHTS_MAX];
static unsigned n_lights, n_beacons;
static struct vec eye, right_, up_, front, moon;

static const struct vec sodium = { 1.f, .66f, .36f }, white_hot = { 1.f, .90f, .74f };

/* ---- the world's making -------------------------------------------------------------------------- */

static void light_add(struct vec at, struct vec power)
{
    if (n_lights < N_LIGHTS_MAX)
        lights[n_lights++] = (struct light){ at, power };
}

static void make_blocks(void)
{
    unsigned n = 0;
    for (int side = -1; side <= 1; side += 2) {
        float z = -8;
        for (unsigned i = 0; i < 11; i++, n++) {
            float depth = 8 + 8 * hash2((int)i, side, 1), height = 9 + 15 * hash2((int)i, side, 2);
            float wall = 6.3f + 1.1f * hash2((int)i, side, 3);
            height += i > 5 ? 6 : 0;
            blocks[n] = (struct box){ vec(side < 0 ? -40 : wall, 0, z),
                                      vec(side < 0 ? -wall : 40, height, z + depth), hash(n + 11) };
            z += depth + (hash2((int)i, side, 4) > .75f ? 1.6f : 0);
        }
    }
    for (unsigned i = 0; n < N_BLOCKS; i++, n++) { /* towers behind the street's end */
        float x = -62 + 17 * (float)i + 5 * hash2((int)i, 0, 5);
        blocks[n] = (struct box){ vec(x, 0, 230 + 9 * (float)(i % 3)),
                                  vec(x + 11, 26 + 34 * hash2((int)i, 0, 6) * (i == 4 ? .3f : 1), 260),
                                  hash(n + 70) };
    }
}

static void make_lamps(void)
{
    static const float strength[] = { 5000, 3200, 4200, 2600, 3600, 2400, 3000, 2000, 2800 };
    for (unsigned i = 0; i < N_LAMPS; i++) {
        float side = i % 2 ? 1 : -1, z = 8.5f + 15 * (float)(i / 2) + (side > 0 ? 6 : 0);
        lamps[i] = (struct ball){ vec(3.75f * side, 5.6f, z), scale(white_hot, strength[i / 2]),
                                  .028f + 5e-4f * z };
        light_add(vec(3.75f * side, 5.5f, z), scale(sodium, 17));
    }
    for (unsigned s = 0; s < N_STRINGS; s++)
        for (unsigned i = 0; i < STRING_BULBS; i++) {
            float t = ((float)i + .5f) / STRING_BULBS, x = -6.2f + 12.4f * t;
            float z = 13 + 11 * (float)s + 5 * (t - .5f) * (s % 2 ? 1 : -1);
            float glow = 5 + 30 * hash2((int)i, (int)s, 8);
            bulbs[s * STRING_BULBS + i] =
                (struct ball){ vec(x, 6.9f + .5f * (float)(s % 2) - 3.6f * t * (1 - t), z),
                               scale(vec(1, .66f, .34f), glow), .04f };
        }
    static const struct ball far_lights[] = {
        { { -1.75f, .68f, 46 }, { 2600, 2500, 2300 }, .06f },
        { { -.75f, .68f, 46 }, { 2600, 2500, 2300 }, .06f },
        { { -2.3f, .70f, 83 }, { 1500, 1400, 1250 }, .06f },
        { { -1.1f, .70f, 83 }, { 1500, 1400, 1250 }, .06f },
        { { 3.9f, 3.5f, 60.f }, { 6, 150, 70 }, .13f },
        { { -3.9f, 3.5f, 60.f }, { 6, 150, 70 }, .13f },
        { { 1.2f, .75f, 64 }, { 40, 1.5f, .8f }, .09f },
        { { 2.4f, .75f, 64 }, { 40, 1.5f, .8f }, .09f },
    };
    for (n_beacons = 0; n_beacons < 8; n_beacons++)
        beacons[n_beacons] = far_lights[n_beacons];
    light_add(vec(-1.25f, .6f, 44), vec(14, 13, 12));
    light_add(vec(-1.7f, .6f, 81), vec(9, 8, 7));
    light_add(vec(1.85f, .8f, 20.1f), vec(1.4f, .05f, .02f));
}

void street_init(void)
{
    n_lights = 0;
    make_blocks();
    make_lamps();
    for (unsigned i = 0; i < N_SIGNS; i++)
        light_add(sign_middle(i), scale(signs[i].colour, signs[i].shine));
    eye = vec(.35f, 1.5f, 0);
    front = unit(sub(vec(-.15f, 3.05f, 24), eye));
    right_ = unit(vec(front.z, 0, -front.x));
    up_ = vec(front.y * right_.z - front.z * right_.y, front.z * right_.x - front.x * right_.z,
              front.x * right_.y - front.y * right_.x);
    moon = unit(vec(.052f, .232f, 1));
}

/* ---- what a ray meets -------------------------------------------------------------------------------
 */

enum thing { THING_SKY, THING_GROUND, THING_BLOCK, THING_DARK, THING_CAR, THING_EMITTER };

struct hit {
    enum thing thing;
    float t;
    struct vec normal, light; /* light: of an emitter */
    const struct box *block;
};

static float ball_at(struct vec o, struct vec d, struct vec c, float radius)
{
    struct vec q = sub(c, o);
    float b = dot(q, d), h = radius * radius - dot(q, q) + b * b;
    return h > 0 && b > 0 ? b - sqrtf(h) : far_away;
}

/* The slab test; d's components may be 0. */
static float box_at(struct vec o, struct vec d, struct vec low, struct vec high, struct vec *normal)
{
    struct vec inverse =
        vec(1 / (d.x != 0 ? d.x : 1e-9f), 1 / (d.y != 0 ? d.y : 1e-9f), 1 / (d.z != 0 ? d.z : 1e-9f));
    struct vec a = times(sub(low, o), inverse), b = times(sub(high, o), inverse);
    struct vec near = vec(fminf(a.x, b.x), fminf(a.y, b.y), fminf(a.z, b.z));
    struct vec back = vec(fmaxf(a.x, b.x), fmaxf(a.y, b.y), fmaxf(a.z, b.z));
    float in = fmaxf(near.x, fmaxf(near.y, near.z)), out = fminf(back.x, fminf(back.y, back.z));
    if (in > out || in < 1e-3f)
        return far_away;
    *normal = in == near.x   ? vec(d.x > 0 ? -1 : 1, 0, 0)
              : in == near.y ? vec(0, d.y > 0 ? -1 : 1, 0)
                             : vec(0, 0, d.z > 0 ? -1 : 1);
    return in;
}

/* Does the ray pass through a box, wherever it begins? */
static bool passes(struct vec o, struct vec d, struct vec low, struct vec high)
{
    struct vec inverse =
        vec(1 / (d.x != 0 ? d.x : 1e-9f), 1 / (d.y != 0 ? d.y : 1e-9f), 1 / (d.z != 0 ? d.z : 1e-9f));
    struct vec a = times(sub(low, o), inverse), b = times(sub(high, o), inverse);
    float in = fmaxf(fminf(a.x, b.x), fmaxf(fminf(a.y, b.y), fminf(a.z, b.z)));
    float out = fminf(fmaxf(a.x, b.x), fminf(fmaxf(a.y, b.y), fmaxf(a.z, b.z)));
    return in <= out && out > 0;
}

/* An upright pole. */
static float pole_at(struct vec o, struct vec d, float x, float z, float low, float high, float radius,
                     struct vec *normal)
{
    float ox = o.x - x, oz = o.z - z, a = d.x * d.x + d.z * d.z, b = ox * d.x + oz * d.z;
    float h = b * b - a * (ox * ox + oz * oz - radius * radius);
    if (h <= 0)
        return far_away;
    float t = (-b - sqrtf(h)) / a, y = o.y + t * d.y;
    if (t < 1e-3f || y < low || y > high)
        return far_away;
    *normal = scale(vec(ox + t * d.x, 0, oz + t * d.z), 1 / radius);
    return t;
}

static void keep(struct hit *h, enum thing thing, float t, struct vec normal)
{
    if (t < h->t)
        *h = (struct hit){ .thing = thing, .t = t, .normal = normal };
}

static void keep_ball(struct hit *h, struct vec o, struct vec d, const struct ball *b, float grow)
{
    float t = ball_at(o, d, b->at, b->radius * grow);
    if (t < h->t)
        *h = (struct hit){ .thing = THING_EMITTER, .t = t, .light = b->light };
}

static void meet_lamps(struct hit *h, struct vec o, struct vec d, bool shining)
{
    struct vec n = { 0 };
    for (unsigned i = 0; i < N_LAMPS; i++) {
        const struct ball *b = &lamps[i];
        float side = b->at.x > 0 ? 1 : -1;
        if (!passes(o, d, vec(side > 0 ? 3.5f : -4.8f, 0, b->at.z - .13f),
                    vec(side > 0 ? 4.8f : -3.5f, 5.9f, b->at.z + .13f)))
            continue;
        keep(h, THING_DARK, pole_at(o, d, 4.7f * side, b->at.z, 0, 5.85f, .055f, &n), n);
        struct vec low = vec(side > 0 ? 3.55f : -4.75f, 5.74f, b->at.z - .05f);
        struct vec high = vec(side > 0 ? 4.75f : -3.55f, 5.80f, b->at.z + .05f);
        keep(h, THING_DARK, box_at(o, d, low, high, &n), n);
        low = vec(b->at.x - .2f, 5.64f, b->at.z - .12f);
        keep(h, THING_DARK, box_at(o, d, low, vec(b->at.x + .2f, 5.76f, b->at.z + .12f), &n), n);
        if (shining)
            keep_ball(h, o, d, b, 1);
    }
    for (unsigned i = 0; i < n_beacons && shining; i++)
        keep_ball(h, o, d, &beacons[i], 1);
}

static void meet_strings(struct hit *h, struct vec o, struct vec d)
{
    for (unsigned s = 0; s < N_STRINGS; s++) {
        float z = 13 + 11 * (float)s;
        if (!passes(o, d, vec(-6.5f, 5.8f, z - 2.7f), vec(6.5f, 7.6f, z + 2.7f)))
            continue;
        for (unsigned i = 0; i < STRING_BULBS; i++)
            keep_ball(h, o, d, &bulbs[s * STRING_BULBS + i], 1);
    }
}

/* Somebody on the way home, and a parked-out car ahead with its rear lights on. */
static void meet_people(struct hit *h, struct vec o, struct vec d)
{
    static const float x = -1.55f, z = 12.6f;
    struct vec n = { 0 };
    if (passes(o, d, vec(x - 1, 0, z - 1), vec(x + 1, 2.3f, z + 1))) {
        keep(h, THING_DARK, pole_at(o, d, x - .10f, z, 0, .85f, .075f, &n), n);
        keep(h, THING_DARK, pole_at(o, d, x + .11f, z + .12f, .04f, .85f, .075f, &n), n);
        keep(h, THING_DARK, pole_at(o, d, x, z + .03f, .62f, 1.42f, .215f, &n), n);
        keep(h, THING_DARK, ball_at(o, d, vec(x, 1.42f, z + .03f), .2f), vec(0, 0, -1));
        keep(h, THING_DARK, ball_at(o, d, vec(x, 1.64f, z), .105f), vec(0, 0, -1));
        keep(h, THING_DARK, pole_at(o, d, x + .22f, z, 1.1f, 2.0f, .012f, &n), n);
        float t = ball_at(o, d, vec(x + .12f, 1.32f, z), .80f); /* the umbrella is a cap of it */
        if (o.y + t * d.y > 1.80f)
            keep(h, THING_DARK, t, unit(sub(along(o, d, t), vec(x + .12f, 1.32f, z))));
    }
    float t = box_at(o, d, vec(.95f, .28f, 20.4f), vec(2.75f, .95f, 24.6f), &n);
    keep(h, THING_CAR, t, n);
    t = box_at(o, d, vec(1.12f, .9f, 21.3f), vec(2.58f, 1.42f, 23.6f), &n);
    keep(h, THING_CAR, t, n);
}

static struct hit meet(struct vec o, struct vec d, bool shining)
{
    struct hit h = { .thing = THING_SKY, .t = far_away };
    struct vec n = { 0 };
    if (d.y < -1e-5f)
        keep(&h, THING_GROUND, -o.y / d.y, vec(0, 1, 0));
    for (unsigned i = 0; i < N_BLOCKS; i++) {
        float t = box_at(o, d, blocks[i].low, blocks[i].high, &n);
        if (t < h.t)
            h = (struct hit){ .thing = THING_BLOCK, .t = t, .normal = n, .block = &blocks[i] };
    }
    meet_people(&h, o, d);
    meet_lamps(&h, o, d, shining);
    meet_strings(&h, o, d);
    float t = h.t;
    struct vec light;
    if (signs_meet(o, d, &t, &light))
        h = (struct hit){ .thing = THING_EMITTER, .t = t, .light = light };
    return h;
}

/* ---- how it is lit
 * ------------------------------------------------------------------------------------ */

static struct vec sky(struct vec d)
{
    float height = d.y > 0 ? d.y : 0;
    struct vec c =
        blend(vec(.042f, .034f, .047f), vec(.0035f, .006f, .015f), clamp01(powf(height, .45f) * 1.25f));
    float cloud = d.z > .01f ? ramp(.42f, .72f,
                                    fbm(d.x / (height + .25f) * 2.2f + 3, d.z / (height + .25f), 40, 5))
                             : 0;
    float off = sqrtf(fmaxf(0, 2 - 2 * dot(d, moon)));
    float halo = .0022f / (off * off + .004f);
    c = add(c, scale(vec(.6f, .72f, 1), halo * (.12f + .45f * cloud)));
    c = add(c, scale(vec(.03f, .022f, .026f), cloud * (1 - height)));
    if (off < .031f) {
        float x = (d.x - moon.x) * 60, y = (d.y - moon.y) * 60;
        float maria = ramp(.35f, .75f, fbm(x + 7, y + 2, 50, 4));
        float rim = sqrtf(fmaxf(0, 1 - off * off / (.031f * .031f)));
        float share = ramp(.031f, .0302f, off) * (1 - .85f * cloud);
        c = blend(c, scale(vec(1, .93f, .80f), 2.6f * (.55f + .45f * rim) * (1 - .5f * maria)), share);
    }
    return c;
}

/* Light of all lamps and signs on a matt surface, over pi. */
static struct vec lit(struct vec p, struct vec n)
{
    struct vec sum = scale(vec(.010f, .012f, .019f), .6f + .4f * n.y);
    for (unsigned i = 0; i < n_lights; i++) {
        struct vec to = sub(lights[i].at, p);
        float r2 = dot(to, to) + .05f, facing = dot(to, n);
        if (facing <= 0 || r2 > 900)
            continue;
        float fade = 1 - r2 / 900;
        sum = add(sum, scale(lights[i].power, .318f * facing / (r2 * sqrtf(r2)) * fade * fade));
    }
    return sum;
}

/* What stands in a lit window: a blind, a curtain, somebody's shelf. */
static struct vec window_light(float u, float v, int column, int floor, uint32_t seed)
{
    float mood = hash2(column, floor, seed + 1), strength = hash2(column, floor, seed + 2);
    struct vec c = mood > .86f  ? vec(.55f, .75f, 1)
                   : mood > .8f ? vec(1, .5f, .42f)
                                : blend(vec(1, .50f, .17f), vec(1, .72f, .40f), mood);
    float shade = .45f + .55f * ramp(-.1f, 1.1f, v);
    if (hash2(column, floor, seed + 3) > .5f && v > hash2(column, floor, seed + 4))
        shade *= .45f + .12f * sinf(v * 60); /* a blind, part way down */
    else
        shade *= .55f + .45f * ramp(.0f, .35f, fabsf(u - .5f)) +
                 .25f * (noise(u * 5, v * 4, seed + (uint32_t)floor) - .5f);
    return scale(c, shade * (.18f + 1.9f * strength * strength));
}

static struct vec shop_light(float u, float v, int column, uint32_t seed)
{
    float kind = hash2(column, 0, seed + 21);
    struct vec c = kind > .7f    ? vec(.50f, .78f, 1)
                   : kind > .45f ? vec(1, .52f, .22f)
                                 : vec(1, .66f, .33f);
    float shelf = .55f + .45f * ramp(.25f, .6f, noise(u * 9, v * 5, seed + (uint32_t)column));
    float ceiling = ramp(.86f, .9f, v) * ramp(.97f, .93f, v) * 2.6f;
    return scale(c, (.22f + .75f * kind) * shelf * ramp(0, .25f, v) + ceiling);
}

static struct vec facade(const struct hit *h, struct vec p)
{
    const struct box *b = h->block;
    bool face = fabsf(h->normal.x) > .5f;
    float u = face ? p.z - b->low.z : p.x, v = p.y, far = p.z > 200;
    float tint = hash2(0, 0, b->seed), pitch = far ? 1.6f : 1.9f + .7f * hash2(1, 0, b->seed);
    struct vec wall = blend(vec(.16f, .105f, .08f), vec(.13f, .135f, .145f), tint);
    wall = scale(wall, .7f + .6f * fbm(u * 1.7f, v * 1.7f, b->seed, 4));
    if (!far)
        wall = scale(
            wall, 1 - .35f * ramp(.035f, .0f, fabsf(v / .28f - roundf(v / .28f)) * .28f)); /* courses */
    float storey = 3.3f, shop = far ? 0 : 3.7f;
    if (!far && v < shop && face) {
        float cell = 3.6f, at = u / cell, x = at - floorf(at), y = (v - .5f) / 2.5f;
        bool open = hash2((int)floorf(at), 9, b->seed) > .42f;
        if (open && x > .06f && x < .94f && y > 0 && y < 1 && fabsf(x - .5f) > .012f)
            return shop_light(x, y, (int)floorf(at), b->seed);
        wall = scale(wall, y > 1 ? .45f : .6f);
    } else if (v > shop && (face || far)) {
        int column = (int)floorf(u / pitch), floor = (int)floorf((v - shop) / storey);
        float x = u / pitch - (float)column, y = (v - shop) / storey - (float)floor;
        x = (x - .24f) / .52f;
        y = (y - .26f) / .56f;
        bool inside = x > 0 && x < 1 && y > 0 && y < 1 && v < b->high.y - 1.2f;
        bool frame = fabsf(x - .5f) < .03f || fabsf(y - .62f) < .02f || x < .05f || x > .95f ||
                     y < .04f || y > .96f;
        if (inside && !frame && hash2(column, floor, b->seed + 7) > (far ? .68f : .63f))
            return scale(window_light(x, y, column, floor, b->seed), far ? .55f : 1);
        if (inside && !frame)
            return scale(vec(.010f, .014f, .022f), .5f + y);
        if (inside || (y < 0 && y > -.1f && x > -.1f && x < 1.1f))
            wall = scale(wall, 1.7f);
    }
    return times(wall, scale(lit(p, h->normal), 3.1416f * .5f));
}

/* Nearer than it is wide, far: light that the damp air adds, and takes away. */
static struct vec through_air(struct vec c, struct vec d, float t)
{
    float clear = expf(-.0075f * t);
    struct vec air = blend(vec(.060f, .043f, .040f), vec(.014f, .016f, .025f), clamp01(d.y * 3.5f));
    return t >= far_away ? c : blend(air, c, clear);
}

static struct vec dark_thing(const struct hit *h, struct vec p, struct vec d)
{
    float edge = 1 + dot(h->normal, d);
    return scale(lit(p, h->normal), .05f + .25f * powf(clamp01(edge), 3));
}

static struct vec car(const struct hit *h, struct vec p, struct vec d)
{
    bool lamp = h->normal.z < -.5f && p.y > .66f && p.y < .78f && fabsf(fabsf(p.x - 1.85f) - .66f) < .2f;
    bool plate = h->normal.z < -.5f && fabsf(p.x - 1.85f) < .26f && fabsf(p.y - .48f) < .06f;
    if (lamp)
        return vec(14, .42f, .16f);
    if (p.y > .97f && p.y < 1.36f && h->normal.z < -.5f && fabsf(p.x - 1.85f) < .64f)
        return scale(lit(p, vec(0, .8f, -.6f)), .05f);
    return add(scale(lit(p, h->normal), plate ? .5f : .03f),
               scale(sky(vec(d.x, fabsf(d.y) + .4f, d.z)), .1f));
}

static struct vec shade(const struct hit *h, struct vec o, struct vec d)
{
    struct vec p = along(o, d, h->t);
    switch (h->thing) {
    case THING_SKY:
        return sky(d);
    case THING_BLOCK:
        return facade(h, p);
    case THING_DARK:
        return dark_thing(h, p, d);
    case THING_CAR:
        return car(h, p, d);
    default:
        return h->light;
    }
}

/* ---- the wet ground
 * ------------------------------------------------------------------------------------- */

static struct vec asphalt(struct vec p)
{
    float x = fabsf(p.x), grain = .8f + .4f * noise(p.x * 40, p.z * 40, 60);
    float dash = ramp(1.6f, 1.7f, fabsf(fmodf(p.z + 100, 7) - 3.5f)),
          worn = ramp(.3f, .6f, fbm(p.x * 3, p.z * 3, 61, 3));
    if (x > 4.25f) { /* pavement, in slabs */
        float sx = fabsf(p.x / .9f - roundf(p.x / .9f)), sz = fabsf(p.z / .9f - roundf(p.z / .9f));
        return scale(vec(.13f, .125f, .12f), grain * (sx < .02f || sz < .02f ? .5f : 1));
    }
    if (x > 4.05f)
        return scale(vec(.2f, .19f, .18f), grain);
    float line = ramp(.075f, .06f, fabsf(p.x)) * (1 - dash) * worn;
    return blend(scale(vec(.040f, .041f, .046f), grain), vec(.45f, .43f, .38f), line);
}

/* Highlights of the lamps' small balls: Gaussian slopes of variance a2, in both directions. */
static struct vec glints(struct vec p, struct vec d, struct vec n, float a2)
{
    struct vec sum = { 0 };
    for (unsigned i = 0; i < N_LAMPS + n_beacons; i++) {
        const struct ball *b = i < N_LAMPS ? &lamps[i] : &beacons[i - N_LAMPS];
        struct vec to = sub(b->at, p);
        float r2 = dot(to, to), area = 3.1416f * b->radius * b->radius;
        struct vec l = scale(to, 1 / sqrtf(r2)), half = unit(sub(l, d));
        float hn = dot(half, n), nl = dot(l, n);
        if (hn <= .05f || nl <= 0)
            continue;
        float slope2 = 1 / (hn * hn) - 1, away = powf(1 - clamp01(dot(half, l)), 5);
        float density = expf(-slope2 / a2) / (3.1416f * a2 * hn * hn * hn * hn);
        float share = (.02f + .98f * away) * density / (4 * fmaxf(.05f, -dot(d, n)));
        sum = add(sum, scale(b->light, share * area / r2));
    }
    return sum;
}

static struct vec ground(const struct hit *h, struct vec o, struct vec d, uint32_t *random)
{
    struct vec p = along(o, d, h->t);
    float wet =
        ramp(.36f, .60f, fbm(p.x * .55f + 9, p.z * .28f, 62, 4) + (fabsf(p.x) > 4.25f ? -.06f : .02f));
    float rough = .055f + (.009f - .055f) * wet;
    float wave = .25f * rough, far = clamp01(1 - h->t / 60);
    struct vec n = vec((noise(p.x * 9, p.z * 5, 63) - .5f) * wave * far, 1,
                       (noise(p.x * 7, p.z * 9, 64) - .5f) * wave * far);
    float radius = rough * sqrtf(-logf(1 - .98f * random01(random))), turn = 6.2832f * random01(random);
    n = unit(n);
    struct vec tilted = unit(add(n, vec(radius * cosf(turn), 0, radius * sinf(turn))));
    struct vec r = sub(d, scale(tilted, 2 * dot(d, tilted)));
    r.y = fabsf(r.y) + 1e-4f;
    r = unit(r);
    struct hit mirror = meet(along(p, vec(0, 1, 0), .002f), r, false);
    struct vec seen = through_air(shade(&mirror, p, r), r, mirror.t);
    float bright = fmaxf(seen.x, fmaxf(seen.y, seen.z));
    seen = bright > 9 ? scale(seen, 9 / bright) : seen; /* no fireflies */
    float share = .02f + .98f * powf(1 - clamp01(-dot(d, n)), 5);
    share *= .45f + .55f * wet;
    struct vec matt = times(asphalt(p), scale(lit(p, n), 3.1416f * (.5f - .25f * wet)));
    struct vec glint = scale(glints(p, d, n, rough * rough * 1.2f + 6e-5f), .45f + .55f * wet);
    return add(add(matt, scale(seen, share)), glint);
}

struct vec street_look(float u, float v, uint32_t *random, float *depth)
{
    struct vec d = unit(add(front, add(scale(right_, u * 1.02f), scale(up_, v * 1.02f))));
    struct hit h = meet(eye, d, true);
    struct vec c = h.thing == THING_GROUND ? ground(&h, eye, d, random) : shade(&h, eye, d);
    *depth = h.thing == THING_SKY ? far_away : h.t * dot(d, front);
    return h.thing == THING_EMITTER ? c : through_air(c, d, h.t);
}
