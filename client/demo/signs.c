// SPDX-License-Identifier: Apache-2.0
// signs.c - letters are strokes on a grid of 4 x 6; a tube is everything within its radius of a stroke.
#include "signs.h"

#include <stddef.h>
#include <string.h>

#include "vec.h"

/* Four digits a stroke: from x, y to x, y. */
static const struct {
    char letter;
    const char *strokes;
} glyphs[] = {
    { 'A', "002626401232" },
    { 'B', "0006063636454544443303333342424141300030" },
    { 'C', "4536361616050501011010303041" },
    { 'E', "0006064603330040" },
    { 'F', "000606460333" },
    { 'H', "000640460343" },
    { 'I', "2026" },
    { 'L', "00060040" },
    { 'O', "10303041414545363616160505010110" },
    { 'R', "0006063636454544443333032340" },
    { 'T', "06462620" },
    { 'Y', "062346232023" },
    { '+', "21250343" },
};

const struct sign signs[N_SIGNS] = {
    { "HOTEL", true, { -5.75f, 3.9f, 15.5f }, { 1, 0, 0 }, .82f, { 1.f, .035f, .06f }, 13, 3.2f },
    { "BAR", false, { 4.25f, 3.35f, 12.5f }, { 1, 0, 0 }, .62f, { .03f, .50f, 1.f }, 11, 2.6f },
    { "AIRY", true, { 4.95f, 4.6f, 24.f }, { 1, 0, 0 }, 1.05f, { 1.f, .05f, .50f }, 14, 4.2f },
    { "CAFE", false, { -6.0f, 3.7f, 27.f }, { 1, 0, 0 }, .60f, { 1.f, .36f, .04f }, 10, 2.2f },
    { "+", false, { 4.7f, 4.4f, 38.f }, { 1, 0, 0 }, 1.5f, { .05f, 1.f, .28f }, 9, 2.6f },
    { "HOTEL", true, { -5.9f, 5.f, 44.f }, { 1, 0, 0 }, 1.1f, { .10f, .22f, 1.f }, 13, 4.2f },
    { "-", false, { -6.2f, 3.45f, 5.f }, { 0, 0, 1 }, 7.f, { .16f, .14f, 1.f }, 7, 2.2f },
    { "-", false, { 6.15f, 3.55f, 30.f }, { 0, 0, -1 }, 9.f, { 1.f, .08f, .14f }, 7, 2.2f },
    { "BAR", true, { 5.0f, 4.2f, 58.f }, { 1, 0, 0 }, 1.1f, { 1.f, .40f, .05f }, 11, 3.6f },
};

static const char *strokes_of(char letter)
{
    for (unsigned i = 0; i < sizeof(glyphs) / sizeof(glyphs[0]); i++)
        if (glyphs[i].letter == letter)
            return glyphs[i].strokes;
    return "";
}

static float unit_of(const struct sign *s) { return s->letter / 6; } /* metres a grid step */

static void panel_size(const struct sign *s, float *w, float *h)
{
    float n = (float)strlen(s->word), step = unit_of(s);
    if (s->word[0] == '-') {
        *w = s->letter;
        *h = .16f;
        return;
    }
    *w = (s->upright ? 4 : n * 5.4f - 1.4f) * step + 2.4f * step;
    *h = (s->upright ? n * 7.6f - 1.6f : 6) * step + 2.4f * step;
}

struct vec sign_middle(unsigned i)
{
    const struct sign *s = &signs[i];
    float w, h;
    panel_size(s, &w, &h);
    struct vec toward = vec(-s->across.z, 0, s->across.x); /* to the reader's back: turned below */
    struct vec at = add(s->corner, add(scale(s->across, w / 2), vec(0, h / 2, 0)));
    return sub(at, scale(toward, .5f));
}

static float stroke_distance(float x, float y, const char *k)
{
    float ax = (float)(k[0] - '0'), ay = (float)(k[1] - '0'), bx = (float)(k[2] - '0') - ax,
          by = (float)(k[3] - '0') - ay;
    float t = clamp01(((x - ax) * bx + (y - ay) * by) / (bx * bx + by * by));
    float dx = x - ax - t * bx, dy = y - ay - t * by;
    return sqrtf(dx * dx + dy * dy);
}

/* Metres from (x, y) on the panel to the nearest tube's middle. */
static float tube_distance(const struct sign *s, float x, float y, float w, float h)
{
    float step = unit_of(s), best = 1e3f;
    unsigned n = (unsigned)strlen(s->word);
    if (s->word[0] == '-') {
        float over = x < .1f ? .1f - x : x > w - .1f ? x - w + .1f : 0;
        return hypotf(over, y - h / 2);
    }
    for (unsigned i = 0; i < n; i++) {
        float lx = x / step - 1.2f - (s->upright ? 0 : 5.4f * (float)i);
        float ly = y / step - 1.2f - (s->upright ? 7.6f * (float)(n - 1 - i) : 0);
        if (lx < -2 || lx > 6 || ly < -2 || ly > 8)
            continue;
        for (const char *k = strokes_of(s->word[i]); *k; k += 4) {
            float distance = stroke_distance(lx, ly, k) * step;
            best = distance < best ? distance : best;
        }
    }
    return best;
}

bool signs_meet(struct vec o, struct vec d, float *t, struct vec *light)
{
    bool met = false;
    for (unsigned i = 0; i < N_SIGNS; i++) {
        const struct sign *s = &signs[i];
        struct vec normal = vec(-s->across.z, 0, s->across.x);
        float against = dot(d, normal), at = dot(sub(s->corner, o), normal) / against, w, h;
        if (fabsf(against) < 1e-6f || at < 1e-3f || at >= *t)
            continue;
        struct vec p = sub(along(o, d, at), s->corner);
        float x = dot(p, s->across), y = p.y;
        panel_size(s, &w, &h);
        if (x < 0 || y < 0 || x > w || y > h)
            continue;
        float tube = .021f + .012f * s->letter, distance = tube_distance(s, x, y, w, h);
        tube = s->word[0] == '-' ? .03f : tube;
        float hot = 1 - distance / tube, spill = tube / (distance + tube);
        struct vec core = blend(s->colour, vec(1, .93f, .93f), .16f * clamp01(hot));
        *light = hot > 0 ? scale(core, s->radiance * (.35f + .65f * sqrtf(hot)))
                         : add(scale(s->colour, .010f * s->radiance * spill * spill),
                               vec(.004f, .004f, .005f));
        *t = at;
        met = true;
    }
    return met;
}
