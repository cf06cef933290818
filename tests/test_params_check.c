// SPDX-License-Identifier: Apache-2.0
// test_params_check.c - parameters together: every contradiction by its name, the looks' own numbers, and that what
// params_print says, of random requests of every kind, makes the same request again.
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "params.h"

/* Sets "name=value" pairs, with blanks between; a value in "..." may have blanks, with \ before " and \. */
static int set_line(struct params *p, const char *line, struct fault *f)
{
    char name[64], value[2048];
    while (*line) {
        size_t n = strcspn(line, "="), v = 0;
        assert_true(line[n] == '=' && n < sizeof(name));
        memcpy(name, line, n);
        name[n] = '\0';
        line += n + 1;
        bool quoted = *line == '"';
        for (line += quoted; *line && (quoted ? *line != '"' : *line != ' '); line++) {
            line += quoted && *line == '\\';
            assert_true(v < sizeof(value) - 1);
            value[v++] = *line;
        }
        value[v] = '\0';
        line += quoted;
        line += *line == ' ';
        if (params_set_text(p, name, value, f) < 0)
            return -1;
    }
    return 0;
}

static void must_set(struct params *p, const char *line)
{
    struct fault f = { 0 };
    params_init(p);
    if (set_line(p, line, &f) < 0)
        fail_msg("%s: %s", line, f.text);
    params_look_defaults(p);
}

static void agrees(const char *line)
{
    struct params p;
    struct fault f = { 0 };
    must_set(&p, line);
    if (params_check(&p, &f) < 0)
        fail_msg("%s: %s", line, f.text);
}

static void contradicts(const char *line, const char *name, const char *says)
{
    struct params p;
    struct fault f = { 0 };
    char field[96];
    must_set(&p, line);
    snprintf(field, sizeof(field), "params.%s", name);
    int r = params_check(&p, &f);
    if (r != -1 || f.code != FAULT_PARAM_CONFLICT || strcmp(f.field, field) != 0 || !strstr(f.text, says))
        fail_msg("%s: %d %s %s \"%s\", wanted %s \"%s\"", line, r, fault_symbol(f.code), f.field, f.text, field, says);
}

static void test_thresholds(void **state)
{
    (void)state;
    agrees("threshold=-2 threshold_unit=stops");
    agrees("threshold=0");
    contradicts("threshold=-0.001", "threshold", "threshold = -0.001: at least 0 expected");
    contradicts("threshold=-2 threshold_unit=linear", "threshold", "threshold_unit = stops");
    contradicts("threshold_unit=stops", "threshold_unit", "a threshold in stops is to be given");
    agrees("threshold_unit=stops bright=none");
    agrees("knee=1.5");
    agrees("knee=1 bright=smoothstep");
    agrees("knee=7 bright=channel");
    contradicts("knee=1.5 bright=smoothstep", "knee", "knee = 1.5: with a smoothstep");
    agrees("threshold=1e30 exposure=-23");
    contradicts("threshold=1e30 exposure=-32", "exposure", "threshold / 2^exposure = 4.2");
    agrees("threshold=1e30 exposure=-32 bright=none");
    contradicts("knee=1e30 exposure=-32", "exposure", "knee / 2^exposure");
    agrees("knee=1e30 exposure=-32 bright=luminance");
    agrees("threshold=120 threshold_unit=stops");
    contradicts("threshold=123 threshold_unit=stops", "threshold", "at most 1e+37");
    contradicts("threshold=1e30 threshold_unit=stops", "threshold", "threshold / 2^exposure = inf");
    agrees("threshold=1e27 exposure=auto");
    contradicts("threshold=1e30 exposure=auto", "threshold", "exposure = auto may come to -32");
    contradicts("knee=1e30 exposure=auto", "knee", "auto");
}

static void test_dependants(void **state)
{
    (void)state;
    agrees("intensity=1 composite=mix");
    agrees("intensity=2 composite=screen-add");
    contradicts("intensity=1.01 composite=mix", "intensity", "at most 1");
    contradicts("dirt_gain=.5", "dirt_gain", "there is no dirt");
    agrees("dirt_gain=.5 dirt=0123456789abcdef0123456789abcdef");
    contradicts("emission=2", "emission", "there is no matte");
    contradicts("emission=1", "emission", "emission is given, and there is no matte");
    agrees("emission=2 matte=id.A");
    contradicts("key=.2", "key", "exposure is not auto");
    contradicts("meter_dark=1 exposure=0", "meter_dark", "exposure is not auto");
    contradicts("meter_bright=1", "meter_bright", "exposure is not auto");
    agrees("key=.2 meter_dark=50 meter_bright=49 exposure=auto");
    contradicts("meter_dark=50 meter_bright=50 exposure=auto", "meter_bright", "less than 100 %");
    contradicts("meter_dark=100 exposure=auto", "meter_bright", "less than 100 %");
    agrees("tolerance=1e-3 budget_ms=20");
    agrees("sensor=24");
    agrees("near=2 far=.5");
    agrees("near=2 far=.5 psf=halation:sigma=4/5/6,gain=1");
    static const char *const kernels[] = { "eye:", "airy:", "aperture:", "image:0123456789abcdef0123456789abcdef" };
    for (unsigned i = 0; i < 4; i++) {
        char line[128];
        snprintf(line, sizeof(line), "psf=%s near=1", kernels[i]);
        contradicts(line, "near", "has no Gaussians");
        snprintf(line, sizeof(line), "psf=%s far=2", kernels[i]);
        contradicts(line, "far", "has no Gaussians");
        snprintf(line, sizeof(line), "psf=%s view=level:0", kernels[i]);
        contradicts(line, "view", "has no levels");
        snprintf(line, sizeof(line), "psf=%s layers=bright/level:0", kernels[i]);
        contradicts(line, "layers", "has no levels");
        snprintf(line, sizeof(line), "psf=%s edge=fill", kernels[i]);
        contradicts(line, "edge", "zero expected");
        snprintf(line, sizeof(line), "psf=%s edge=zero tolerance=1e-4 grow=2%% layers=bright/residual", kernels[i]);
        agrees(line);
    }
    agrees("view=level:3");
    contradicts("view=level:4", "view", "view = level.4: the psf has 4 Gaussians, level:0 to level:3");
    agrees("psf=octaves:sigma=2,count=8 view=level:7 layers=level:0/level:6");
    contradicts("psf=octaves:sigma=2,count=8 layers=level:0/level:8", "layers", "level:0 to level:7");
    agrees("bloom=off view=level:9");
}

/* Which looks understand what, said once more here, by METHODS section 2: a name, values that go anywhere, and the looks
 * ('-': the stated psf). */
static const struct {
    const char *with, *name, *looks;
} understood[] = {
    { "bright=luminance", "bright", "-" },
    { "clamp=3", "clamp", "-" },
    { "firefly=4", "firefly", "-" },
    { "psf=eye:", "psf", "-" },
    { "near=1", "near", "-" },
    { "far=1", "far", "-" },
    { "dirt=0123456789abcdef0123456789abcdef", "dirt", "-" },
    { "dirt=0123456789abcdef0123456789abcdef dirt_gain=.5", "dirt_gain", "-" },
    { "composite=add", "composite", "-" },
    { "edge=zero", "edge", "-" },
    { "grow=0", "grow", "-" },
    { "tolerance=1e-3", "tolerance", "-" },
    { "budget_ms=5", "budget_ms", "-" },
    { "storage=float", "storage", "-" },
    { "knee=.25", "knee", "-BD" },
    { "radius=.5", "radius", "D" },
    { "legacy_gain=on", "legacy_gain", "D" },
    { "kawase=3", "kawase", "C" },
    { "stages=6", "stages", "C" },
    { "tint=1:1:1", "tint", "C" },
    { "sun=x=50%,y=20%,radius=5%", "sun", "B" },
    { "threshold=2", "threshold", "-ABCDE" },
    { "threshold=2 threshold_unit=stops", "threshold_unit", "-ABCDE" },
    { "intensity=.5", "intensity", "-ABCDE" },
    { "source=emission", "source", "-ABCDE" },
    { "matte=id", "matte", "-ABCDE" },
    { "matte=id emission=3", "emission", "-ABCDE" },
    { "exposure=2", "exposure", "-ABCDE" },
    { "exposure=auto key=.2 meter_dark=1", "key", "-ABCDE" },
    { "sensor=24", "sensor", "-ABCDE" },
    { "nonfinite=zero", "nonfinite", "-ABCDE" },
    { "display=aces saturation=.5 encoding=srgb", "display", "-ABCDE" },
    { "view=bright layers=bloom/source", "view", "-ABCDE" },
    { "view=residual", "view", "-" },
    { "view=level:1", "view", "-" },
    { "layers=final/residual", "layers", "-" },
    { "layers=level:0", "layers", "-" },
    { "bloom=off", "bloom", "-ABCDE" },
};
static const char *const looks[] = { "none", "half-gaussian", "mip-chain", "three-scale", "jimenez", "airy-eight" };

static void test_looks(void **state)
{
    (void)state;
    for (unsigned i = 0; i < sizeof(understood) / sizeof(understood[0]); i++)
        for (unsigned look = 0; look < 6; look++) {
            char line[256];
            snprintf(line, sizeof(line), "%s look=%s", understood[i].with, looks[look]);
            if (strchr(understood[i].looks, "-ABCDE"[look]))
                agrees(line);
            else if (strstr(understood[i].with, "dirt=")) /* the table's first one is named */
                contradicts(line, "dirt", "does not have it");
            else
                contradicts(line, understood[i].name, "look");
        }
    contradicts("look=jimenez knee=1.5", "knee", "smoothstep");
    agrees("look=mip-chain knee=1.5");
    agrees("look=three-scale stages=3 tint=1:1:1/1:1:2/1:1:3");
    contradicts("look=three-scale stages=3 tint=1:1:1/1:1:2/1:1:3/1:1:4", "tint", "tint: 4 of them, and stages = 3");
    agrees("look=three-scale stages=6 tint=1:1:1/1:1:2/1:1:3/1:1:4/1:1:5/1:1:6");
    struct params p;
    struct fault f;
    must_set(&p, "look=three-scale kawase=2.5");
    assert_int_equal(params_check(&p, &f), -1);
    assert_int_equal(f.code, FAULT_PARAM_RANGE);
    assert_string_equal(f.text, "kawase = 2.5: a whole number of passes expected");
}

static void test_look_defaults(void **state)
{
    (void)state;
    struct params p, again;
    must_set(&p, "look=half-gaussian");
    assert_true(p.threshold == .8 && p.intensity == 1.5 && p.emission == 1 && p.bright == BRIGHT_CHANNEL);
    must_set(&p, "matte=m look=half-gaussian");
    assert_true(p.emission == 2 && p.given == (1u << 1 | 1u << 3));
    must_set(&p, "matte=m emission=5 threshold=3 look=half-gaussian intensity=1");
    assert_true(p.emission == 5 && p.threshold == 3 && p.intensity == 1);
    must_set(&p, "look=jimenez");
    assert_true(p.threshold == .8 && p.knee == .5 && p.intensity == 1 && p.radius == .5);
    assert_int_equal(p.bright, BRIGHT_SMOOTHSTEP);
    must_set(&p, "look=mip-chain");
    assert_true(p.threshold == 1 && p.knee == .5 && p.intensity == 1 && p.bright == BRIGHT_KNEE);
    must_set(&p, "look=three-scale");
    assert_true(p.threshold == 1 && p.intensity == 1 && p.bright == BRIGHT_LUMINANCE);
    assert_int_equal(p.composite, COMPOSITE_ADD);
    must_set(&p, "look=airy-eight");
    assert_true(p.threshold == 1 && p.intensity == 1 && p.composite == COMPOSITE_SCREEN_ADD);
    /* Twice is once; none is nothing. */
    memcpy(&again, &p, sizeof(p));
    params_look_defaults(&again);
    assert_memory_equal(&again, &p, sizeof(p));
    params_init(&p);
    memcpy(&again, &p, sizeof(p));
    params_look_defaults(&again);
    assert_memory_equal(&again, &p, sizeof(p));
}

/* ---- print -> parse -> print ------------------------------------------------------------------------ */

static uint64_t seed = 0x9e3779b97f4a7c15u;

static uint64_t random_u64(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    return seed ^= seed << 17;
}
static bool chance(unsigned one_in) { return random_u64() % one_in == 0; }
static unsigned random_below(unsigned n) { return (unsigned)(random_u64() % n); }

static double random_in(double min, double max)
{
    double u = (double)(random_u64() >> 11) * 0x1p-53;
    double v = chance(4) ? round(min + (max - min) * u) : min + (max - min) * u;
    if (chance(2) && max > 1e3)
        v = exp2(u * 40 - 20);
    return chance(16) ? (chance(2) ? min : max) : fmin(max, fmax(min, v));
}

static char *random_list(char *s, const char *key, unsigned n, double min, double max)
{
    s += sprintf(s, "%s=", key);
    for (unsigned i = 0; i < n; i++)
        s += sprintf(s, "%s%.*g", i ? "/" : "", chance(2) ? 3 : 9, random_in(min, max));
    return s;
}

static char *random_sizes(char *s, const char *key, unsigned n)
{
    static const char *const units[] = { "", "px", "%", "mm" };
    s += sprintf(s, "%s=", key);
    for (unsigned i = 0; i < n; i++)
        s += sprintf(s, "%s%.*g%s", i ? "/" : "", chance(2) ? 3 : 9, random_in(.2, 99), units[random_below(4)]);
    return s;
}

static char *random_tints(char *s, unsigned n)
{
    for (unsigned i = 0; i < n; i++)
        s += sprintf(s, "%s%.3g:%.3g:%.3g", i ? "/" : "", random_in(0, 2), random_in(0, 2), random_in(0, 1000));
    return s;
}

static void random_octaves(char *s)
{
    unsigned n = 1 + random_below(12);
    s += sprintf(s, "octaves:count=%u,sigma=%.5g%s,", n, random_in(.2, 9), chance(2) ? "%" : "");
    s = random_list(s, "ratio", 1, 1.01, 1.2);
    if (chance(2)) {
        s = random_list(s + sprintf(s, ","), "weights", chance(3) ? 1 : n, 0, 1e6);
    } else {
        s = random_list(s + sprintf(s, ","), "slope", 1, -16, 16);
        s = random_list(s + sprintf(s, ","), "bend", 1, -4, 4);
        s = random_list(s + sprintf(s, ","), "weight", 1, 0, 1e6);
    }
    if (chance(3))
        random_tints(s + sprintf(s, ",tint="), chance(2) ? 1 : n);
}

static void random_psf(char *s)
{
    unsigned n = 1 + random_below(10);
    switch (random_below(7)) {
    case 0:
        s = random_sizes(s + sprintf(s, "gaussians:"), "sigma", n);
        s = random_list(s + sprintf(s, ","), "weight", chance(3) ? 1 : n, 0, 1e6);
        if (chance(3))
            random_tints(s + sprintf(s, ",tint="), chance(2) ? 1 : n);
        break;
    case 1:
        random_octaves(s);
        break;
    case 2:
        s = random_sizes(s + sprintf(s, "halation:"), "sigma", chance(2) ? 1 : 3);
        random_list(s + sprintf(s, ","), "gain", chance(2) ? 1 : 3, 0, 1e6);
        break;
    case 3:
        random_list(s + sprintf(s, "eye:weight=.5,"), "degrees", 1, 1, 170);
        break;
    case 4:
        s = random_list(s + sprintf(s, "airy:"), "f", 1, .5, 1000);
        random_list(s + sprintf(s, ","), "wavelength", chance(2) ? 1 : 3, 100, 20000);
        break;
    case 5:
        s = random_list(s + sprintf(s, "aperture:blades=%u,", 3 + random_below(30)), "rotation", 1, -360, 360);
        random_list(s + sprintf(s, ","), "pitch", 1, .1, 1000);
        break;
    default:
        sprintf(s, "image:%016llx%016llx", (unsigned long long)random_u64(), (unsigned long long)random_u64());
    }
}

static const char *random_view(void)
{
    static const char *const views[] = { "final", "source", "bright", "bloom", "level:0", "level:2", "residual" };
    return views[random_below(7)];
}

static void random_text(const char *name, char *s)
{
    static const char *const names[] = { "", "emission", "View Layer.Emit", "a=\"b\" \\ c", "\xc3\xa9 x" };
    if (!strcmp(name, "psf"))
        random_psf(s);
    else if (!strcmp(name, "source") || !strcmp(name, "matte"))
        strcpy(s, names[random_below(5)]);
    else if (!strcmp(name, "dirt"))
        sprintf(s, "%016llx%016llx", (unsigned long long)random_u64(), (unsigned long long)random_u64());
    else if (!strcmp(name, "grow"))
        sprintf(s, "%.4g%s", random_in(0, 100), chance(2) ? "%" : chance(2) ? "mm" : "");
    else if (!strcmp(name, "view"))
        strcpy(s, random_view());
    else if (!strcmp(name, "layers"))
        sprintf(s, "%s", chance(3) ? "" : chance(2) ? random_view() : "bloom/bright/final");
    else if (!strcmp(name, "tint"))
        random_tints(s, 1 + random_below(6));
    else if (!strcmp(name, "sun"))
        random_tints(s + sprintf(s, "x=%.4g%%,y=-3%%,radius=%.3gmm,gain=2,tint=", random_in(-100, 200), random_in(1, 9)), 1);
    else
        fail_msg("no random text of %s is made here", name);
}

/* One row in `one_in` is set; kawase, whose numbers are whole, to a whole number. */
static void random_params(struct params *p, unsigned one_in)
{
    char text[4096], words[256], *save = NULL;
    unsigned n;
    params_init(p);
#define NUMBER(name, field, def, min, max, unit, help)                                                  \
    if (chance(one_in)) {                                                                               \
        double v = random_in(min, max);                                                                 \
        assert_int_equal(params_set_number(p, #name, strcmp(#name, "kawase") ? v : floor(v), NULL), 0); \
    }
#define NUMBER_OR(name, field, flag, def, min, max, unit, word, help)                                   \
    NUMBER(name, field, def, min, max, unit, help)                                                      \
    if (chance(2 * one_in))                                                                             \
        assert_int_equal(params_set_text(p, #name, word, NULL), 0);
#define CHOICE(name, field, def, all, help)                                                             \
    if (chance(one_in)) {                                                                               \
        strcpy(words, all);                                                                             \
        n = 0;                                                                                          \
        for (const char *w = words; (w = strchr(w, ' ')); w++)                                          \
            n++;                                                                                        \
        char *word = strtok_r(words, " ", &save);                                                       \
        for (n = random_below(n + 1); n; n--)                                                           \
            word = strtok_r(NULL, " ", &save);                                                          \
        assert_int_equal(params_set_text(p, #name, word, NULL), 0);                                     \
    }
#define TEXT(name, field, def, help)                                                                    \
    if (chance(one_in)) {                                                                               \
        random_text(#name, text);                                                                       \
        struct fault f = { 0 };                                                                         \
        if (params_set_text(p, #name, text, &f) < 0)                                                    \
            fail_msg("%s=%s: %s", #name, text, f.text);                                                 \
    }
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
    params_look_defaults(p);
}

static bool same_size(const struct size *a, const struct size *b)
{
    return a->value == b->value && a->unit == b->unit;
}

static void assert_same_psf(const struct psf_spec *a, const struct psf_spec *b)
{
    assert_true(a->kind == b->kind && a->count == b->count && a->blades == b->blades);
    for (unsigned i = 0; i < a->count; i++) {
        assert_true(same_size(&a->gaussian[i].sigma, &b->gaussian[i].sigma));
        assert_true(a->gaussian[i].weight == b->gaussian[i].weight);
        assert_memory_equal(a->gaussian[i].tint, b->gaussian[i].tint, sizeof(a->gaussian[i].tint));
    }
    assert_true(a->weight == b->weight && a->f_number == b->f_number && a->pitch_um == b->pitch_um);
    assert_memory_equal(a->wavelength_nm, b->wavelength_nm, sizeof(a->wavelength_nm));
    assert_true(a->rotation_deg == b->rotation_deg && a->degrees == b->degrees);
    assert_string_equal(a->digest, b->digest);
}

/* What is printed reads back without a contradiction, prints the same, and means the same. */
static void round_trip(const struct params *a)
{
    static char first[PARAMS_LINE_MAX], second[PARAMS_LINE_MAX];
    static struct params b;
    struct fault f = { 0 };
    int len = params_print(a, first, sizeof(first));
    assert_true(len > 0 && (size_t)len == strlen(first));
    must_set(&b, first);
    if (params_check(&b, &f) < 0)
        fail_msg("%s: %s", first, f.text);
    params_print(&b, second, sizeof(second));
    assert_string_equal(first, second);
    if (a->bloom == SWITCH_OFF)
        return;
    assert_true(a->look == b.look);
    if (a->bright != BRIGHT_NONE)
        assert_true(a->exposure_auto == b.exposure_auto && a->exposure == b.exposure && a->threshold == b.threshold);
    assert_same_psf(&a->psf_spec, &b.psf_spec);
    assert_true(same_size(&a->grow_size, &b.grow_size) && a->view_spec.view == b.view_spec.view);
    assert_true(a->layer_count == b.layer_count && a->tint_count == b.tint_count);
    assert_memory_equal(a->layer, b.layer, a->layer_count * sizeof(a->layer[0]));
    assert_memory_equal(a->tints, b.tints, a->tint_count * sizeof(a->tints[0]));
    assert_true(a->sun_spec.given == b.sun_spec.given && a->sun_spec.x_percent == b.sun_spec.x_percent);
    assert_true(same_size(&a->sun_spec.radius, &b.sun_spec.radius));
    assert_string_equal(a->source, b.source);
    assert_string_equal(a->matte, b.matte);
    assert_true(a->intensity == b.intensity && a->emission == b.emission && a->bright == b.bright);
    assert_true(a->composite == b.composite && a->clamp == b.clamp && a->display == b.display);
}

static void test_round_trip(void **state)
{
    (void)state;
    static struct params a;
    unsigned good = 0, with_look = 0, kernels = 0, off = 0;
    for (unsigned round = 0; round < 40000; round++) {
        random_params(&a, 2 + round % 16);
        if (params_check(&a, NULL) < 0)
            continue;
        round_trip(&a);
        good++;
        with_look += a.look != LOOK_NONE;
        kernels += a.psf_spec.kind != PSF_GAUSSIANS;
        off += a.bloom == SWITCH_OFF;
    }
    print_message("%u of 40000 without contradiction: %u with a look, %u with a kernel, %u off\n", good, with_look,
                  kernels, off);
    assert_true(good > 1000 && with_look > 50 && kernels > 50 && off > 50);
}

/* One parameter at a time, so that each of them comes back surely, and each look with all that it has. */
static void test_round_trip_each(void **state)
{
    (void)state;
    static struct params a;
    for (unsigned i = 0; i < sizeof(understood) / sizeof(understood[0]); i++)
        for (unsigned look = 0; look < 6; look++) {
            char line[256];
            if (!strchr(understood[i].looks, "-ABCDE"[look]))
                continue;
            snprintf(line, sizeof(line), "%s look=%s", understood[i].with, looks[look]);
            must_set(&a, line);
            round_trip(&a);
        }
}

/* Nothing that can be set makes a longer line than is promised. */
static void test_longest_line(void **state)
{
    (void)state;
    static struct params p;
    char name[256], line[PARAMS_LINE_MAX];
    memset(name, '"', 255);
    name[255] = '\0';
    params_init(&p);
    assert_int_equal(params_set_text(&p, "source", name, NULL), 0);
    assert_int_equal(params_set_text(&p, "matte", name, NULL), 0);
    assert_int_equal(params_set_text(&p, "exposure", "auto", NULL), 0);
    assert_int_equal(params_set_text(&p, "dirt", "0123456789abcdef0123456789abcdef", NULL), 0);
    size_t texts = 2 * 512 + 33 + sizeof(p.layers) + sizeof(p.psf) + sizeof(p.tint) + sizeof(p.sun) + 64;
    /* Every row at once, which no request can be: names, texts as long as their fields, numbers of 24 digits. */
    size_t rows = 0;
#define NUMBER(name, field, def, min, max, unit, help) rows += sizeof(#name) + 1 + 24;
#define CHOICE(name, field, def, words, help) rows += sizeof(#name) + 1 + 16;
#define TEXT(name, field, def, help) rows += sizeof(#name) + 1;
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
    print_message("longest line: below %zu of %d bytes\n", texts + rows, PARAMS_LINE_MAX);
    assert_true(texts + rows < PARAMS_LINE_MAX);
    assert_true(params_print(&p, line, sizeof(line)) > 1020 && strlen(line) < texts + rows);
    round_trip(&p);
}

static void test_print_equal(void **state)
{
    (void)state;
    struct params a, b;
    char first[PARAMS_LINE_MAX], second[PARAMS_LINE_MAX], cut[10];
    must_set(&a, "threshold=1.50 exposure=-0 psf=gaussians:sigma=400/8,weight=.2/.2");
    must_set(&b, "psf=gaussians:weight=2e-1,sigma=4e2/8.0px threshold=15e-1 exposure=auto exposure=0");
    int len = params_print(&a, first, sizeof(first));
    params_print(&b, second, sizeof(second));
    assert_string_equal(first, second);
    assert_non_null(strstr(first, " threshold=1.5 "));
    assert_non_null(strstr(first, " exposure=0 "));
    assert_non_null(strstr(first, " psf=gaussians:sigma=400/8,weight=0.2 "));
    assert_int_equal(params_print(&a, cut, sizeof(cut)), len);
    assert_memory_equal(cut, first, sizeof(cut) - 1);
    assert_int_equal(cut[9], 0);
    assert_int_equal(params_print(&a, NULL, 0), len);
    /* With bright=none threshold, knee and exposure change nothing, and are not said. */
    must_set(&a, "bright=none");
    must_set(&b, "bright=none threshold=7 exposure=2 sensor=24");
    params_print(&a, first, sizeof(first));
    params_print(&b, second, sizeof(second));
    assert_string_equal(first, second);
    /* But a display has the exposure in it. */
    must_set(&b, "bright=none exposure=2 display=aces");
    params_print(&b, second, sizeof(second));
    assert_non_null(strstr(second, " exposure=2 "));
    must_set(&b, "exposure=auto");
    params_print(&b, second, sizeof(second));
    assert_non_null(strstr(second, " exposure=auto key=0.18 meter_dark=10 meter_bright=2 "));
    must_set(&b, "look=half-gaussian matte=id");
    params_print(&b, second, sizeof(second));
    assert_string_equal(second, "bloom=on look=half-gaussian matte=id emission=2 threshold=0.8 threshold_unit=linear "
                                "intensity=1.5 exposure=0 display=none saturation=1 encoding=linear view=final "
                                "nonfinite=keep");
    must_set(&b, "psf=gaussians:sigma=1mm,weight=1 source=\"a matte=b\" bloom=on");
    params_print(&b, second, sizeof(second));
    assert_non_null(strstr(second, " source=\"a matte=b\" "));
    assert_non_null(strstr(second, " sensor=36 "));
    must_set(&b, "budget_ms=20");
    params_print(&b, second, sizeof(second));
    assert_null(strstr(second, "tolerance"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_thresholds),    cmocka_unit_test(test_dependants),
        cmocka_unit_test(test_looks),         cmocka_unit_test(test_look_defaults),
        cmocka_unit_test(test_round_trip),    cmocka_unit_test(test_round_trip_each),
        cmocka_unit_test(test_longest_line),  cmocka_unit_test(test_print_equal),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
