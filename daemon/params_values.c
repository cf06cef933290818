// SPDX-License-Identifier: Apache-2.0
// params_values.c - the shorter texts: names in the file, digests, the window's growth, views and layers, the
// scales' tints, the sun; and what a size or a view means to the others.
#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "params_internal.h"

/* ---- names and digests ------------------------------------------------------------------------------- */

enum { NAME_BYTES_MAX = 255 }; /* OpenEXR's own limit of a name */

static int name_read(char field[PARAMS_TEXT_MAX], const char *param, const char *text, struct fault *f)
{
    size_t len = strlen(text);
    if (len > NAME_BYTES_MAX)
        return param_fault(f, FAULT_PARAM_RANGE, param, "%s = %s: %zu bytes: at most %d expected", param,
                           quote(text, len).s, len, NAME_BYTES_MAX);
    for (size_t i = 0; i < len; i++)
        if ((unsigned char)text[i] < ' ' || text[i] == 0x7f)
            return param_fault(f, FAULT_PARAM_SYNTAX, param, "%s, at character %zu, \"%s\": a name without control "
                               "characters expected", param, i + 1, quote(text + i, len - i).s);
    return text_keep(field, param, &(struct printer){ (char *)text, len + 1, len }, f);
}

int read_source(struct params *p, const char *text, struct fault *f)
{
    return name_read(p->source, "source", text, f);
}

int read_matte(struct params *p, const char *text, struct fault *f)
{
    return name_read(p->matte, "matte", text, f);
}

int piece_digest(const struct piece *p, char out[33], struct fault *f)
{
    char digest[33] = "";
    for (size_t i = 0; i < p->len && p->len == 32; i++) {
        char c = p->s[i];
        digest[i] = c >= 'A' && c <= 'F' ? (char)(c - 'A' + 'a') : c;
        if (!((c >= '0' && c <= '9') || (digest[i] >= 'a' && digest[i] <= 'f')))
            return piece_fault(f, FAULT_PARAM_SYNTAX, p, "32 hexadecimal digits expected");
    }
    if (p->len != 32)
        return piece_fault(f, FAULT_PARAM_SYNTAX, p, "32 hexadecimal digits, the digest of an upload, expected");
    memcpy(out, digest, sizeof(digest));
    return 0;
}

int read_dirt(struct params *p, const char *text, struct fault *f)
{
    struct piece all = piece_all("dirt", text, NULL);
    char digest[33] = "";
    if (*text && piece_digest(&all, digest, f) < 0)
        return -1;
    return text_keep(p->dirt, "dirt", &(struct printer){ digest, sizeof(digest), strlen(digest) }, f);
}

/* ---- sizes ------------------------------------------------------------------------------------------- */

int read_grow(struct params *p, const char *text, struct fault *f)
{
    static const struct size_range range = { "a length", { 0, 0, 0 }, { 16384, 100, 1e5 } };
    struct piece all = piece_all("grow", text, NULL);
    struct size size;
    char canonical[PARAMS_TEXT_MAX];
    struct printer to = { canonical, sizeof(canonical), 0 };
    if (piece_size(&all, &range, &size, f) < 0)
        return -1;
    if (size.value == 0) /* of whatever */
        size.unit = SIZE_PIXELS;
    print_size(&to, &size);
    if (text_keep(p->grow, "grow", &to, f) < 0)
        return -1;
    p->grow_size = size;
    return 0;
}

double params_pixels(const struct params *p, const struct size *s, uint32_t width, uint32_t height,
                     uint32_t display_width, double pixel_aspect)
{
    switch (s->unit) {
    case SIZE_PERCENT:
        return s->value / 100 * hypot(width * pixel_aspect, height);
    case SIZE_MM:
        return s->value / p->sensor_mm * display_width * pixel_aspect;
    default:
        return s->value;
    }
}

/* ---- views ------------------------------------------------------------------------------------------- */

static const char *const view_names[] = { "final", "source", "bright", "bloom", "level", "residual" };

static int piece_view(const struct piece *p, struct view_spec *out, struct fault *f)
{
    static const struct number_range range = { "a level", 0, PARAMS_GAUSSIANS_MAX - 1 };
    struct piece number = *p, word;
    double level = 0;
    piece_next(&number, ':', &word);
    for (unsigned i = 0; i < sizeof(view_names) / sizeof(view_names[0]); i++) {
        if (!piece_is(&word, view_names[i]) || (i == VIEW_LEVEL) != (number.s != NULL))
            continue;
        if (i == VIEW_LEVEL && piece_number(&number, &range, &level, f) < 0)
            return -1;
        if (level != floor(level))
            break;
        *out = (struct view_spec){ (enum view)i, (unsigned)level };
        return 0;
    }
    return piece_fault(f, FAULT_PARAM_SYNTAX, p, "one of \"final source bright bloom level:N residual\" expected");
}

static void print_view(struct printer *to, const struct view_spec *v)
{
    print_text(to, view_names[v->view]);
    if (v->view == VIEW_LEVEL) {
        print_text(to, ":");
        print_text(to, number_print(v->level).s);
    }
}

int read_view(struct params *p, const char *text, struct fault *f)
{
    struct piece all = piece_all("view", text, NULL);
    struct view_spec view;
    if (piece_view(&all, &view, f) < 0)
        return -1;
    char canonical[32];
    struct printer to = { canonical, sizeof(canonical), 0 };
    print_view(&to, &view);
    p->view_spec = view;
    return text_keep(p->view, "view", &to, f);
}

int read_layers(struct params *p, const char *text, struct fault *f)
{
    struct piece rest = piece_all("layers", text, NULL), part;
    struct view_spec layer[PARAMS_LAYERS_MAX];
    unsigned n = 0;
    if (!*text)
        rest.s = NULL;
    while (piece_next(&rest, '/', &part)) {
        if (n == PARAMS_LAYERS_MAX)
            return piece_fault(f, FAULT_PARAM_RANGE, &part, "at most %d views expected", PARAMS_LAYERS_MAX);
        if (piece_view(&part, &layer[n], f) < 0)
            return -1;
        for (unsigned i = 0; i < n; i++)
            if (layer[i].view == layer[n].view && layer[i].level == layer[n].level)
                return piece_fault(f, FAULT_PARAM_SYNTAX, &part, "this view was given before");
        n++;
    }
    char canonical[PARAMS_TEXT_MAX];
    struct printer to = { canonical, sizeof(canonical), 0 };
    p->layer_count = n;
    for (unsigned i = 0; i < n; i++) {
        p->layer[i] = layer[i];
        print_text(&to, i ? "/" : "");
        print_view(&to, &layer[i]);
    }
    return text_keep(p->layers, "layers", &to, f);
}

void params_view_name(const struct view_spec *v, char out[32])
{
    if (v->view == VIEW_LEVEL)
        snprintf(out, 32, "level.%u", v->level);
    else
        snprintf(out, 32, "%s", view_names[v->view]);
}

/* ---- looks ------------------------------------------------------------------------------------------- */

int read_tint(struct params *p, const char *text, struct fault *f)
{
    struct piece rest = piece_all("tint", text, NULL), part;
    double tint[PARAMS_TINTS_MAX][3];
    unsigned n = 0;
    while (piece_next(&rest, '/', &part)) {
        if (n == PARAMS_TINTS_MAX)
            return piece_fault(f, FAULT_PARAM_RANGE, &part, "at most %d tints expected", PARAMS_TINTS_MAX);
        if (piece_tint(&part, &tint_range, tint[n], f) < 0)
            return -1;
        n++;
    }
    while (n > 1 && tint[n - 1][0] == tint[n - 2][0] && tint[n - 1][1] == tint[n - 2][1] &&
           tint[n - 1][2] == tint[n - 2][2])
        n--; /* the last one goes on */
    char canonical[PARAMS_TEXT_MAX];
    struct printer to = { canonical, sizeof(canonical), 0 };
    p->tint_count = n;
    for (unsigned i = 0; i < n; i++) {
        memcpy(p->tints[i], tint[i], sizeof(tint[i]));
        print_text(&to, i ? "/" : "");
        print_tint(&to, tint[i]);
    }
    assert(to.used < PARAMS_TEXT_MAX); /* six of three numbers fit */
    return text_keep(p->tint, "tint", &to, f);
}

enum { S_X, S_Y, S_RADIUS, S_GAIN, S_TINT, S_KEYS };
static const struct key_rule sun_rules[S_KEYS] = {
    { "x", SHAPE_PERCENT, 1, { "a place in %", -100, 200 }, NULL, false, false },
    { "y", SHAPE_PERCENT, 1, { "a place in %", -100, 200 }, NULL, false, false },
    { "radius", SHAPE_SIZE, 1, { .what = "a size" }, NULL, false, false },
    { "gain", SHAPE_NUMBER, 1, { "a gain", 0, 1e6 }, "1", false, false },
    { "tint", SHAPE_TINT, 1, { "a tint", 0, 1000 }, "1:1:1", false, false },
};
_Static_assert((int)S_KEYS <= (int)KEYS_MAX, "keys_read's promise");

int read_sun(struct params *p, const char *text, struct fault *f)
{
    struct piece all = piece_all("sun", text, "x=50%,y=20%,radius=5%[,gain=][,tint=R:G:B]");
    struct key_value v[S_KEYS];
    struct sun_spec sun;
    char canonical[PARAMS_TEXT_MAX] = "";
    struct printer to = { canonical, sizeof(canonical), 0 };
    memset(&sun, 0, sizeof(sun));
    if (*text) {
        if (keys_read(v, sun_rules, S_KEYS, all, f) < 0)
            return -1;
        sun.given = true;
        sun.x_percent = v[S_X].v[0][0];
        sun.y_percent = v[S_Y].v[0][0];
        sun.radius = (struct size){ v[S_RADIUS].v[0][0], v[S_RADIUS].unit[0] };
        sun.gain = v[S_GAIN].v[0][0];
        memcpy(sun.tint, v[S_TINT].v[0], sizeof(sun.tint));
        keys_print(v, sun_rules, S_KEYS, &to);
    }
    if (text_keep(p->sun, "sun", &to, f) < 0)
        return -1;
    p->sun_spec = sun;
    return 0;
}
