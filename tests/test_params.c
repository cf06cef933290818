// SPDX-License-Identifier: Apache-2.0
// test_params.c - one parameter at a time against the table: ranges at their very ends, every word, each text's grammar
// with the place of the mistake, and what sizes and views mean. (What goes together: test_params_check.c.)
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "params.h"

struct number {
    const char *name;
    double min, max;
    const char *unit;
    size_t offset;
};
static const struct number numbers[] = {
#define NUMBER(name, field, def, min, max, unit, help)                                                  \
    { #name, min, max, unit, offsetof(struct params, field) },
#define CHOICE(name, field, def, words, help)
#define TEXT(name, field, def, help)
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
};
enum { N_NUMBERS = sizeof(numbers) / sizeof(numbers[0]) };

static double value_of(const struct params *p, const struct number *n)
{
    return *(const double *)((const char *)p + n->offset);
}

static void refuse(const char *name, const char *text, enum fault_code code, const char *says)
{
    struct params p, before;
    struct fault f = { 0 };
    char field[96];
    params_init(&p);
    before = p;
    snprintf(field, sizeof(field), "params.%s", name);
    int r = params_set_text(&p, name, text, &f);
    if (r != -1 || f.code != code || !strstr(f.text, says))
        print_error("%s=%s: %d %s \"%s\", wanted \"%s\"\n", name, text, r, fault_symbol(f.code), f.text,
                    says);
    assert_int_equal(r, -1);
    assert_int_equal(f.code, code);
    assert_string_equal(f.field, field);
    assert_non_null(strstr(f.text, says));
    assert_memory_equal(&p, &before, sizeof(p));
}

static void test_defaults(void **state)
{
    (void)state;
    struct params p;
    char line[PARAMS_LINE_MAX];
    params_init(&p);
    assert_true(p.given == 0);
    assert_int_equal(params_check(&p, NULL), 0);
    for (unsigned i = 0; i < N_NUMBERS; i++) {
        assert_true(value_of(&p, &numbers[i]) >= numbers[i].min);
        assert_true(value_of(&p, &numbers[i]) <= numbers[i].max);
    }
    assert_true(p.psf_spec.count >= 1);
    params_print(&p, line, sizeof(line));
    print_message("defaults: %s\n", line);
}

/* Both ends are in, the next double beyond them, and what is no number, are out: for every NUMBER. */
static void test_ranges(void **state)
{
    (void)state;
    static const char *const not_finite[] = { "nan", "NaN", "-nan", "inf", "-inf", "1e999", "-1e999" };
    static const char *const not_numbers[] = { "",    " 1",    "1 ", "1,5", "0x10", "1e",   "--1",
                                               "one", "1.0.0", "+",  "\t2", "1\n",  "nano", "infi" };
    for (unsigned i = 0; i < N_NUMBERS; i++) {
        const struct number *n = &numbers[i];
        struct params p;
        char text[64];
        params_init(&p);
        for (int end = 0; end < 2; end++) {
            double bound = end ? n->max : n->min;
            double beyond = nextafter(bound, end ? INFINITY : -INFINITY);
            assert_int_equal(params_set_number(&p, n->name, bound, NULL), 0);
            assert_true(value_of(&p, n) == bound);
            assert_int_equal(params_set_number(&p, n->name, beyond, NULL), -1);
            snprintf(text, sizeof(text), "%.17g", bound);
            assert_int_equal(params_set_text(&p, n->name, text, NULL), 0);
            assert_true(value_of(&p, n) == bound);
            snprintf(text, sizeof(text), "%.17g", beyond);
            refuse(n->name, text, FAULT_PARAM_RANGE, text);
        }
        for (unsigned k = 0; k < sizeof(not_finite) / sizeof(*not_finite); k++) {
            refuse(n->name, not_finite[k], FAULT_PARAM_RANGE, not_finite[k]);
            refuse(n->name, not_finite[k], FAULT_PARAM_RANGE, n->unit);
        }
        for (unsigned k = 0; k < sizeof(not_numbers) / sizeof(*not_numbers); k++)
            refuse(n->name, not_numbers[k], FAULT_PARAM_SYNTAX, "a finite number from");
        struct fault f;
        assert_int_equal(params_set_number(&p, n->name, NAN, &f), -1);
        assert_int_equal(f.code, FAULT_PARAM_RANGE);
    }
    refuse("threshold", "nan", FAULT_PARAM_RANGE,
           "threshold = nan: a finite number from -32 to 1e+30 (threshold_unit) expected");
}

/* The word sets the flag and 0, a number clears it, and what fails changes neither. */
static void test_word_or_number(void **state)
{
    (void)state;
    struct params p;
    struct fault f;
    params_init(&p);
    assert_false(p.exposure_auto);
    assert_int_equal(params_set_text(&p, "exposure", "2.5", NULL), 0);
    assert_int_equal(params_set_text(&p, "exposure", "auto", NULL), 0);
    assert_true(p.exposure_auto && p.exposure == 0);
    assert_int_equal(params_set_text(&p, "exposure", "33", &f), -1);
    assert_non_null(strstr(f.text, "exposure = 33: a finite number from -32 to 32 (stops), or auto expected"));
    assert_int_equal(params_set_text(&p, "exposure", "Auto", &f), -1);
    assert_int_equal(f.code, FAULT_PARAM_SYNTAX);
    assert_true(p.exposure_auto);
    assert_int_equal(params_set_number(&p, "exposure", 0, NULL), 0);
    assert_false(p.exposure_auto);
    assert_int_equal(params_set_text(&p, "exposure", "auto", NULL), 0);
    assert_int_equal(params_set_text(&p, "exposure", "-3", NULL), 0);
    assert_true(!p.exposure_auto && p.exposure == -3);
    assert_int_equal(params_set_text(&p, "key", "auto", NULL), -1);
}

/* Bit i of given is row i, set by what succeeds only. */
static void test_given(void **state)
{
    (void)state;
    static const struct {
        const char *name, *text;
    } all[] = {
#define NUMBER(name, field, def, min, max, unit, help) { #name, #max },
#define CHOICE(name, field, def, words, help) { #name, NULL },
#define TEXT(name, field, def, help) { #name, def },
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
    };
    struct params p;
    params_init(&p);
    for (unsigned i = 0; i < sizeof(all) / sizeof(all[0]); i++) {
        const uint64_t before = p.given;
        assert_int_equal(params_set_text(&p, all[i].name, "\x01", NULL), -1);
        assert_true(p.given == before);
        if (!all[i].text)
            continue;
        if (params_set_text(&p, all[i].name, all[i].text, NULL) < 0)
            fail_msg("%s=%s", all[i].name, all[i].text);
        assert_true(p.given == (before | UINT64_C(1) << i));
    }
}

struct choice {
    const char *name, *words;
    size_t offset;
};
static const struct choice choices[] = {
#define NUMBER(name, field, def, min, max, unit, help)
#define CHOICE(name, field, def, words, help) { #name, words, offsetof(struct params, field) },
#define TEXT(name, field, def, help)
#include "params.def"
#undef NUMBER
#undef CHOICE
#undef TEXT
};

/* Every word of every CHOICE, in the order of its enum; and not the half of one, nor two. */
static void test_choices(void **state)
{
    (void)state;
    struct params p;
    struct fault f;
    params_init(&p);
    for (unsigned i = 0; i < sizeof(choices) / sizeof(choices[0]); i++) {
        const struct choice *c = &choices[i];
        char words[256], cut[64], *save = NULL;
        int n = 0;
        snprintf(words, sizeof(words), "%s", c->words);
        for (char *word = strtok_r(words, " ", &save); word; word = strtok_r(NULL, " ", &save)) {
            assert_int_equal(params_set_text(&p, c->name, word, NULL), 0);
            assert_int_equal(*(const int *)((const char *)&p + c->offset), n++);
            snprintf(cut, sizeof(cut), "%s ", word);
            refuse(c->name, cut, FAULT_PARAM_SYNTAX, c->words);
            if (strlen(word) > 1) {
                snprintf(cut, sizeof(cut), "%.*s", (int)strlen(word) - 1, word);
                refuse(c->name, cut, FAULT_PARAM_SYNTAX, c->words);
            }
        }
        assert_true(n >= 2);
        refuse(c->name, "", FAULT_PARAM_SYNTAX, c->words);
        refuse(c->name, c->words, FAULT_PARAM_SYNTAX, "one of");
        assert_int_equal(params_set_number(&p, c->name, 1, &f), -1);
        assert_int_equal(f.code, FAULT_PARAM_SYNTAX);
    }
    params_set_text(&p, "look", "mip-chain", NULL);
    assert_int_equal(p.look, LOOK_MIP_CHAIN);
    params_set_text(&p, "composite", "screen-add", NULL);
    assert_int_equal(p.composite, COMPOSITE_SCREEN_ADD);
    params_set_text(&p, "encoding", "gamma2.2", NULL);
    assert_int_equal(p.encoding, ENCODING_GAMMA22);
    params_set_text(&p, "stages", "6", NULL);
    assert_int_equal(p.stages, STAGES_6);
    refuse("sgima", "1", FAULT_PARAM_UNKNOWN, "no parameter \"sgima\"; known: bloom, look, source");
    refuse("", "1", FAULT_PARAM_UNKNOWN, "PROTOCOL.md");
}

/* ---- texts ------------------------------------------------------------------------------------------- */

#define D32 "0123456789abcdef0123456789abcdef"

/* name=text is taken, and kept as `canonical`, which reads back as itself. */
static void accept(const char *name, size_t offset, const char *text, const char *canonical, struct params *p)
{
    struct params again;
    struct fault f = { 0 };
    params_init(p);
    params_init(&again);
    const char *field = (const char *)p + offset;
    if (params_set_text(p, name, text, &f) < 0)
        fail_msg("%s=%s: %s", name, text, f.text);
    assert_string_equal(field, canonical);
    if (params_set_text(&again, name, canonical, &f) < 0)
        fail_msg("%s=%s: %s", name, canonical, f.text);
    assert_string_equal((const char *)&again + offset, canonical);
}
#define ACCEPT(name, text, canonical, p) accept(#name, offsetof(struct params, name), text, canonical, p)

struct wrong {
    const char *text;
    enum fault_code code;
    const char *says;
};
static void refuse_each(const char *name, const struct wrong *bad, size_t n)
{
    for (size_t i = 0; i < n; i++)
        refuse(name, bad[i].text, bad[i].code, bad[i].says);
}
#define REFUSE_EACH(name, bad) refuse_each(name, bad, sizeof(bad) / sizeof((bad)[0]))

static void test_psf_gaussians(void **state)
{
    (void)state;
    struct params p;
    ACCEPT(psf, "gaussians:sigma=4/8/16,weight=.2/.3/.4", "gaussians:sigma=4/8/16,weight=0.2/0.3/0.4", &p);
    assert_int_equal(p.psf_spec.kind, PSF_GAUSSIANS);
    assert_int_equal(p.psf_spec.count, 3);
    assert_true(p.psf_spec.gaussian[1].sigma.value == 8 && p.psf_spec.gaussian[1].weight == .3);
    assert_true(p.psf_spec.gaussian[2].tint[0] == 1 && p.psf_spec.gaussian[2].tint[2] == 1);
    ACCEPT(psf, "gaussians:weight=2e-1,sigma=4px/0.5%/.3mm", "gaussians:sigma=4/0.5%/0.3mm,weight=0.2", &p);
    assert_true(p.psf_spec.gaussian[0].sigma.unit == SIZE_PIXELS);
    assert_true(p.psf_spec.gaussian[1].sigma.unit == SIZE_PERCENT && p.psf_spec.gaussian[1].sigma.value == .5);
    assert_true(p.psf_spec.gaussian[2].sigma.unit == SIZE_MM && p.psf_spec.gaussian[2].weight == .2);
    ACCEPT(psf, "gaussians:tint=1:.5:0/2:3:4,sigma=4/4,weight=1/1",
           "gaussians:sigma=4/4,weight=1,tint=1:0.5:0/2:3:4", &p);
    assert_true(p.psf_spec.gaussian[0].tint[1] == .5 && p.psf_spec.gaussian[1].tint[2] == 4);
    ACCEPT(psf, "gaussians:sigma=4/8,weight=1,tint=1:.9:.8", "gaussians:sigma=4/8,weight=1,tint=1:0.9:0.8", &p);
    assert_true(p.psf_spec.gaussian[1].tint[2] == .8);
    ACCEPT(psf, "gaussians:sigma=4/8,weight=1,tint=1:1:1/1:1:1", "gaussians:sigma=4/8,weight=1", &p);
    ACCEPT(psf, "gaussians:sigma=0.1/4096/0.001%/100%/1e-06mm/100000mm,weight=0",
           "gaussians:sigma=0.1/4096/0.001%/100%/1e-06mm/100000mm,weight=0", &p);

    static const struct wrong bad[] = {
        { "", FAULT_PARAM_SYNTAX, "known: gaussians octaves halation eye airy aperture image" },
        { "gauss:sigma=4", FAULT_PARAM_SYNTAX, "character 1, \"gauss\": no such point spread function" },
        { "Gaussians:sigma=4", FAULT_PARAM_SYNTAX, "known: gaussians" },
        { "gaussians", FAULT_PARAM_SYNTAX, "sigma=... is missing" },
        { "gaussians:", FAULT_PARAM_SYNTAX, "character 11, \"\": sigma=... is missing (gaussians:sigma=" },
        { "gaussians:sigma=4", FAULT_PARAM_SYNTAX, "weight=... is missing" },
        { "gaussians:weight=4", FAULT_PARAM_SYNTAX, "sigma=... is missing" },
        { "gaussians:sigma=-1,weight=1", FAULT_PARAM_RANGE, "character 17, \"-1\"" },
        { "gaussians:sigma=0,weight=1", FAULT_PARAM_RANGE, "from 0.1 to 4096 px" },
        { "gaussians:sigma=0.0999,weight=1", FAULT_PARAM_RANGE, "0.0999" },
        { "gaussians:sigma=4096.5px,weight=1", FAULT_PARAM_RANGE, "4096.5px" },
        { "gaussians:sigma=101%,weight=1", FAULT_PARAM_RANGE, "from 0.001 to 100 %" },
        { "gaussians:sigma=0.0001%,weight=1", FAULT_PARAM_RANGE, "0.0001%" },
        { "gaussians:sigma=1e-7mm,weight=1", FAULT_PARAM_RANGE, "from 1e-06 to 100000 mm" },
        { "gaussians:sigma=100001mm,weight=1", FAULT_PARAM_RANGE, "100001mm" },
        { "gaussians:sigma=nan,weight=1", FAULT_PARAM_RANGE, "nan" },
        { "gaussians:sigma=inf%,weight=1", FAULT_PARAM_RANGE, "inf%" },
        { "gaussians:sigma=4,weight=nan", FAULT_PARAM_RANGE, "nan" },
        { "gaussians:sigma=4,weight=-0.1", FAULT_PARAM_RANGE, "a weight from 0 to 1000000" },
        { "gaussians:sigma=4,weight=1e7", FAULT_PARAM_RANGE, "character 26, \"1e7\"" },
        { "gaussians:sigma=4,weight=10%", FAULT_PARAM_SYNTAX, "10%" },
        { "gaussians:sigma=4%%,weight=1", FAULT_PARAM_SYNTAX, "4%%" },
        { "gaussians:sigma=4cm,weight=1", FAULT_PARAM_SYNTAX, "such as 8, 0.5% or 0.3mm" },
        { "gaussians:sigma=4 px,weight=1", FAULT_PARAM_SYNTAX, "\"4 px\"" },
        { "gaussians:sigma=0x4px,weight=1", FAULT_PARAM_SYNTAX, "0x4px" },
        { "gaussians:sigma=%,weight=1", FAULT_PARAM_SYNTAX, "\"%\"" },
        { "gaussians:sigma=mm,weight=1", FAULT_PARAM_SYNTAX, "\"mm\"" },
        { "gaussians:sigma=,weight=1", FAULT_PARAM_SYNTAX, "character 17, \"\"" },
        { "gaussians:sigma=4/,weight=1", FAULT_PARAM_SYNTAX, "character 19" },
        { "gaussians:sigma=4//8,weight=1", FAULT_PARAM_SYNTAX, "character 19" },
        { "gaussians:sigma=4,sigma=8,weight=1", FAULT_PARAM_SYNTAX, "character 19, \"sigma=8\": this key was given" },
        { "gaussians:sigma=4,weight=1,weight=1", FAULT_PARAM_SYNTAX, "given before" },
        { "gaussians:sigma=4,weight=1,", FAULT_PARAM_SYNTAX, "character 28" },
        { "gaussians:,sigma=4,weight=1", FAULT_PARAM_SYNTAX, "character 11" },
        { "gaussians:sigma=4,weight=1 ", FAULT_PARAM_SYNTAX, "\"1 \"" },
        { "gaussians:sigma=4,weight=1,tint=2", FAULT_PARAM_SYNTAX, "character 33, \"2\": three numbers R:G:B" },
        { "gaussians:sigma=4,weight=1,tint=1:2:3:4", FAULT_PARAM_SYNTAX, "three numbers" },
        { "gaussians:sigma=4,weight=1,tint=1::1", FAULT_PARAM_SYNTAX, "character 35, \"\"" },
        { "gaussians:sigma=4,weight=1,tint=1:-1:1", FAULT_PARAM_RANGE, "a tint from 0 to 1000" },
        { "gaussians:sigma=4,weight=1,tint=1:1:1001", FAULT_PARAM_RANGE, "1001" },
        { "gaussians:sigma=4/5/6,weight=1,tint=1:1:1/2:2:2", FAULT_PARAM_SYNTAX, "3 Gaussians and 2 tints" },
        { "gaussians:sigma=4,weight=1,slope=2", FAULT_PARAM_SYNTAX, "\"slope=2\": no such key" },
        { "gaussians:Sigma=4,weight=1", FAULT_PARAM_SYNTAX, "Sigma=4" },
        { "gaussians:sigma,weight=1", FAULT_PARAM_SYNTAX, "\"sigma\": no such key" },
        { "gaussians:sigma=4/8/16,weight=1/2", FAULT_PARAM_SYNTAX, "3 Gaussians and 2 weights" },
        { "gaussians:sigma=4,weight=1/2", FAULT_PARAM_SYNTAX, "1 Gaussians and 2 weights" },
        { "gaussians:sigma=4\x01\xff,weight=1", FAULT_PARAM_SYNTAX, "\"4??\"" },
    };
    REFUSE_EACH("psf", bad);
}

static void test_psf_octaves(void **state)
{
    (void)state;
    struct params p;
    const struct psf_gaussian *g = p.psf_spec.gaussian;
    ACCEPT(psf, "octaves:sigma=2,count=4", "octaves:sigma=2,count=4,ratio=2,weight=1,slope=1,bend=0", &p);
    assert_int_equal(p.psf_spec.kind, PSF_GAUSSIANS);
    assert_int_equal(p.psf_spec.count, 4);
    for (unsigned i = 0; i < 4; i++) { /* 8, 4, 2, 1 of 15 */
        assert_true(g[i].sigma.value == 2 << i && g[i].sigma.unit == SIZE_PIXELS);
        assert_true(fabs(g[i].weight - (8 >> i) / 15.) < 1e-15);
    }
    ACCEPT(psf, "octaves:bend=.5,slope=-1,weight=3,ratio=1.5,count=3,sigma=.1%,tint=1:1:1/1:1:2/1:1:3",
           "octaves:sigma=0.1%,count=3,ratio=1.5,weight=3,slope=-1,bend=0.5,tint=1:1:1/1:1:2/1:1:3", &p);
    /* exponents 0, 0.5, 0 */
    const double sum = 2 + sqrt(2);
    assert_true(fabs(g[0].weight - 3 / sum) < 1e-15 && fabs(g[1].weight - 3 * sqrt(2) / sum) < 1e-15);
    assert_true(fabs(g[2].sigma.value - .225) < 1e-15 && g[2].sigma.unit == SIZE_PERCENT && g[2].tint[2] == 3);
    ACCEPT(psf, "octaves:sigma=1mm,count=2,weights=.4/.2", "octaves:sigma=1mm,count=2,ratio=2,weights=0.4/0.2", &p);
    assert_true(g[0].weight == .4 && g[1].weight == .2 && g[1].sigma.value == 2);
    ACCEPT(psf, "octaves:sigma=1,count=3,weights=.2/.2/.2", "octaves:sigma=1,count=3,ratio=2,weights=0.2", &p);
    assert_true(g[2].weight == .2);
    /* The steepest curves neither overflow nor vanish. */
    for (int sign = -1; sign <= 1; sign += 2) {
        char text[128];
        double total = 0;
        snprintf(text, sizeof(text), "octaves:sigma=.1,count=32,ratio=1.01,slope=%d,bend=%d", 16 * sign, 4 * sign);
        params_init(&p);
        assert_int_equal(params_set_text(&p, "psf", text, NULL), 0);
        for (unsigned i = 0; i < 32; i++) {
            assert_true(g[i].weight >= 0 && g[i].weight <= 1);
            total += g[i].weight;
        }
        assert_true(fabs(total - 1) < 1e-12);
    }
    static const struct wrong bad[] = {
        { "octaves:sigma=2", FAULT_PARAM_SYNTAX, "count=... is missing" },
        { "octaves:count=2", FAULT_PARAM_SYNTAX, "sigma=... is missing" },
        { "octaves:sigma=2/4,count=2", FAULT_PARAM_RANGE, "character 17, \"4\": at most 1 of sigma" },
        { "octaves:sigma=2,count=0", FAULT_PARAM_RANGE, "a count from 1 to 32" },
        { "octaves:sigma=2,count=33", FAULT_PARAM_RANGE, "33" },
        { "octaves:sigma=2,count=2.5", FAULT_PARAM_SYNTAX, "character 23, \"2.5\": a count, a whole number," },
        { "octaves:sigma=2,count=1e99", FAULT_PARAM_RANGE, "1e99" },
        { "octaves:sigma=2,count=2,ratio=1", FAULT_PARAM_RANGE, "a ratio from 1.01 to 16" },
        { "octaves:sigma=2,count=2,ratio=17", FAULT_PARAM_RANGE, "17" },
        { "octaves:sigma=2,count=2,slope=17", FAULT_PARAM_RANGE, "a slope from -16 to 16" },
        { "octaves:sigma=2,count=2,bend=-5", FAULT_PARAM_RANGE, "a bend from -4 to 4" },
        { "octaves:sigma=2,count=13", FAULT_PARAM_RANGE, "octave 12 has sigma 8192: at most 4096" },
        { "octaves:sigma=50%,count=3", FAULT_PARAM_RANGE, "octave 2 has sigma 200: at most 100" },
        { "octaves:sigma=2,count=3,weights=1/2", FAULT_PARAM_SYNTAX, "3 Gaussians and 2 weights" },
        { "octaves:sigma=2,count=2,weights=1/2,slope=0", FAULT_PARAM_SYNTAX, "without weight, slope and bend" },
        { "octaves:sigma=2,count=2,weights=1/2,weight=1", FAULT_PARAM_SYNTAX, "without weight" },
        { "octaves:sigma=2,count=2,tint=1:1:1/1:1:2/1:1:3", FAULT_PARAM_SYNTAX, "2 Gaussians and 3 tints" },
    };
    REFUSE_EACH("psf", bad);
}

static void test_psf_halation(void **state)
{
    (void)state;
    struct params p;
    const struct psf_gaussian *g = p.psf_spec.gaussian;
    ACCEPT(psf, "halation:gain=.3/.1/.02,sigma=.3mm/.2mm/4", "halation:sigma=0.3mm/0.2mm/4,gain=0.3/0.1/0.02", &p);
    assert_int_equal(p.psf_spec.kind, PSF_GAUSSIANS);
    assert_int_equal(p.psf_spec.count, 3);
    for (unsigned i = 0; i < 3; i++)
        for (unsigned c = 0; c < 3; c++)
            assert_true(g[i].tint[c] == (i == c));
    assert_true(g[0].weight == .3 && g[2].weight == .02 && g[1].sigma.value == .2);
    assert_true(g[1].sigma.unit == SIZE_MM && g[2].sigma.unit == SIZE_PIXELS);
    ACCEPT(psf, "halation:sigma=4/4/4,gain=.1", "halation:sigma=4,gain=0.1", &p);
    assert_true(g[2].weight == .1 && g[2].sigma.value == 4);
    static const struct wrong bad[] = {
        { "halation:sigma=4", FAULT_PARAM_SYNTAX, "gain=... is missing (halation:sigma=S/S/S,gain=G/G/G)" },
        { "halation:sigma=4/5,gain=1", FAULT_PARAM_SYNTAX, "character 16, \"4/5\": one, or three for R/G/B" },
        { "halation:sigma=4/5/6/7,gain=1", FAULT_PARAM_RANGE, "at most 3" },
        { "halation:sigma=4,gain=1,tint=1:1:1", FAULT_PARAM_SYNTAX, "no such key" },
        { "halation:sigma=4,gain=-1", FAULT_PARAM_RANGE, "a gain from 0" },
    };
    REFUSE_EACH("psf", bad);
}

static void test_psf_kernels(void **state)
{
    (void)state;
    struct params p;
    const struct psf_spec *s = &p.psf_spec;
    ACCEPT(psf, "eye", "eye:degrees=40,weight=0.1", &p);
    assert_true(s->kind == PSF_EYE && s->degrees == 40 && s->weight == .1 && s->count == 0 && s->f_number == 0);
    ACCEPT(psf, "eye:weight=1,degrees=170", "eye:degrees=170,weight=1", &p);
    ACCEPT(psf, "airy:", "airy:f=8,pitch=5,wavelength=610/550/465,weight=0.1", &p);
    assert_true(s->kind == PSF_AIRY && s->f_number == 8 && s->pitch_um == 5 && s->weight == .1);
    assert_true(s->wavelength_nm[0] == 610 && s->wavelength_nm[1] == 550 && s->wavelength_nm[2] == 465);
    assert_true(s->blades == 0);
    ACCEPT(psf, "airy:wavelength=550,f=16,weight=0", "airy:f=16,pitch=5,wavelength=550,weight=0", &p);
    assert_true(s->wavelength_nm[0] == 550 && s->wavelength_nm[2] == 550 && s->f_number == 16);
    ACCEPT(psf, "aperture:blades=7,rotation=-12.5,f=2.8,pitch=4",
           "aperture:f=2.8,pitch=4,wavelength=610/550/465,weight=0.1,blades=7,rotation=-12.5", &p);
    assert_true(s->kind == PSF_APERTURE && s->blades == 7 && s->rotation_deg == -12.5 && s->pitch_um == 4);
    ACCEPT(psf, "aperture", "aperture:f=8,pitch=5,wavelength=610/550/465,weight=0.1,blades=6,rotation=0", &p);
    ACCEPT(psf, "image:" D32, "image:" D32 ",weight=0.1", &p);
    assert_true(s->kind == PSF_IMAGE && s->weight == .1);
    assert_string_equal(s->digest, D32);
    ACCEPT(psf, "image:0123456789ABCDEF0123456789abcdef,weight=2", "image:" D32 ",weight=2", &p);
    static const struct wrong bad[] = {
        { "eye:degrees=0.5", FAULT_PARAM_RANGE, "an angle from 1 to 170" },
        { "eye:degrees=171", FAULT_PARAM_RANGE, "171" },
        { "eye:sigma=4", FAULT_PARAM_SYNTAX, "no such key (eye:" },
        { "eye:,", FAULT_PARAM_SYNTAX, "character 5" },
        { "airy:f=.4", FAULT_PARAM_RANGE, "an f-number from 0.5 to 1000" },
        { "airy:f=1001", FAULT_PARAM_RANGE, "1001" },
        { "airy:pitch=.09", FAULT_PARAM_RANGE, "a pixel pitch in um from 0.1 to 1000" },
        { "airy:pitch=1e4", FAULT_PARAM_RANGE, "1e4" },
        { "airy:wavelength=99", FAULT_PARAM_RANGE, "a wavelength in nm from 100 to 20000" },
        { "airy:wavelength=20001", FAULT_PARAM_RANGE, "20001" },
        { "airy:wavelength=600/500", FAULT_PARAM_SYNTAX, "one, or three" },
        { "airy:wavelength=600/500/400/300", FAULT_PARAM_RANGE, "at most 3" },
        { "airy:blades=5", FAULT_PARAM_SYNTAX, "no such key" },
        { "airy:weight=1000001", FAULT_PARAM_RANGE, "a weight from 0 to 1000000" },
        { "aperture:blades=2", FAULT_PARAM_RANGE, "a number of blades from 3 to 32" },
        { "aperture:blades=33", FAULT_PARAM_RANGE, "33" },
        { "aperture:blades=5.5", FAULT_PARAM_SYNTAX, "whole number" },
        { "aperture:rotation=361", FAULT_PARAM_RANGE, "an angle in degrees from -360 to 360" },
        { "image", FAULT_PARAM_SYNTAX, "32 hexadecimal digits" },
        { "image:", FAULT_PARAM_SYNTAX, "character 7, \"\": 32 hexadecimal digits" },
        { "image:weight=1", FAULT_PARAM_SYNTAX, "32 hexadecimal digits" },
        { "image:" D32 "0", FAULT_PARAM_SYNTAX, "32 hexadecimal digits" },
        { "image:0123456789abcdef0123456789abcdeg", FAULT_PARAM_SYNTAX, "character 7" },
        { "image:" D32 ",", FAULT_PARAM_SYNTAX, "character 40" },
        { "image:" D32 ",weight=x", FAULT_PARAM_SYNTAX, "character 47, \"x\"" },
    };
    REFUSE_EACH("psf", bad);
}

static void test_psf_many(void **state)
{
    (void)state;
    enum { TEN_THOUSAND = 10000 };
    char *text = malloc(2 * TEN_THOUSAND + 64);
    assert_non_null(text);
    for (unsigned count = 31; count <= 33; count++) {
        char *s = text + sprintf(text, "gaussians:weight=1,sigma=4");
        for (unsigned i = 1; i < count; i++)
            s += sprintf(s, "/4");
        struct params p;
        params_init(&p);
        assert_int_equal(params_set_text(&p, "psf", text, NULL), count <= 32 ? 0 : -1);
    }
    char *s = text + sprintf(text, "gaussians:weight=1,sigma=4");
    for (unsigned i = 1; i < TEN_THOUSAND; i++)
        s += sprintf(s, "/4");
    refuse("psf", text, FAULT_PARAM_RANGE, "at most 32 of sigma");
    /* 32 long numbers twice do not fit the text. */
    s = text + sprintf(text, "gaussians:sigma=");
    for (unsigned i = 0; i < 32; i++)
        s += sprintf(s, "%s%.17g", i ? "/" : "", 1.1234567890123 + i);
    s += sprintf(s, ",weight=");
    for (unsigned i = 0; i < 32; i++)
        s += sprintf(s, "%s%.17g", i ? "/" : "", .1234567890123 + i);
    refuse("psf", text, FAULT_PARAM_RANGE, "at most 511");
    free(text);
}

static void test_names(void **state)
{
    (void)state;
    struct params p;
    char long_name[300];
    memset(long_name, 'n', sizeof(long_name));
    for (unsigned i = 0; i < 2; i++) {
        const char *name = i ? "matte" : "source";
        size_t offset = i ? offsetof(struct params, matte) : offsetof(struct params, source);
        accept(name, offset, "", "", &p);
        accept(name, offset, "View Layer.Emit=\"1\" \\", "View Layer.Emit=\"1\" \\", &p);
        accept(name, offset, "\xc3\xa9mission", "\xc3\xa9mission", &p);
        long_name[255] = '\0';
        accept(name, offset, long_name, long_name, &p);
        long_name[255] = 'n';
        long_name[256] = '\0';
        refuse(name, long_name, FAULT_PARAM_RANGE, "256 bytes: at most 255 expected");
        refuse(name, "a\nb", FAULT_PARAM_SYNTAX, "at character 2, \"?b\"");
        refuse(name, "\x7f", FAULT_PARAM_SYNTAX, "without control characters");
    }
    ACCEPT(dirt, "", "", &p);
    ACCEPT(dirt, "0123456789ABCDEF0123456789abcdef", D32, &p);
    refuse("dirt", "dirt.exr", FAULT_PARAM_SYNTAX, "\"dirt.exr\": 32 hexadecimal digits");
    refuse("dirt", D32 "0", FAULT_PARAM_SYNTAX, "32 hexadecimal digits");
    refuse("dirt", "0123456789abcdef0123456789abcde/", FAULT_PARAM_SYNTAX, "32 hexadecimal digits");
}

static void test_grow(void **state)
{
    (void)state;
    struct params p;
    ACCEPT(grow, "64", "64", &p);
    assert_true(p.grow_size.value == 64 && p.grow_size.unit == SIZE_PIXELS);
    ACCEPT(grow, "64px", "64", &p);
    ACCEPT(grow, "02.50%", "2.5%", &p);
    assert_true(p.grow_size.value == 2.5 && p.grow_size.unit == SIZE_PERCENT);
    ACCEPT(grow, "1mm", "1mm", &p);
    assert_true(p.grow_size.unit == SIZE_MM);
    ACCEPT(grow, "0%", "0", &p);
    ACCEPT(grow, "-0mm", "0", &p);
    ACCEPT(grow, "16384", "16384", &p);
    ACCEPT(grow, "100%", "100%", &p);
    ACCEPT(grow, "1e5mm", "100000mm", &p);
    static const struct wrong bad[] = {
        { "", FAULT_PARAM_SYNTAX, "a length such as" },        { "-1", FAULT_PARAM_RANGE, "0 to 16384 px" },
        { "16384.5", FAULT_PARAM_RANGE, "0 to 16384 px" },     { "100.1%", FAULT_PARAM_RANGE, "0 to 100 %" },
        { "100001mm", FAULT_PARAM_RANGE, "0 to 100000 mm" },   { "64 ", FAULT_PARAM_SYNTAX, "\"64 \"" },
        { "64/64", FAULT_PARAM_SYNTAX, "64/64" },              { "64in", FAULT_PARAM_SYNTAX, "64in" },
    };
    REFUSE_EACH("grow", bad);
}

static void test_views(void **state)
{
    (void)state;
    static const char *const words[] = { "final", "source", "bright", "bloom", "level:0", "residual" };
    struct params p;
    char name[32];
    for (unsigned i = 0; i < 6; i++) {
        ACCEPT(view, words[i], words[i], &p);
        assert_int_equal(p.view_spec.view, i);
        params_view_name(&p.view_spec, name);
        assert_string_equal(name, i == VIEW_LEVEL ? "level.0" : words[i]);
    }
    ACCEPT(view, "level:031", "level:31", &p);
    assert_int_equal(p.view_spec.level, 31);
    params_view_name(&p.view_spec, name);
    assert_string_equal(name, "level.31");
    ACCEPT(layers, "", "", &p);
    assert_int_equal(p.layer_count, 0);
    ACCEPT(layers, "bright/level:2/level:1/final/source/bloom/residual",
           "bright/level:2/level:1/final/source/bloom/residual", &p);
    assert_int_equal(p.layer_count, 7);
    assert_true(p.layer[0].view == VIEW_BRIGHT && p.layer[1].view == VIEW_LEVEL && p.layer[1].level == 2);
    static const struct wrong bad[] = {
        { "", FAULT_PARAM_SYNTAX, "final source bright" },  { "level", FAULT_PARAM_SYNTAX, "level:N" },
        { "level:", FAULT_PARAM_SYNTAX, "character 7" },    { "level:32", FAULT_PARAM_RANGE, "a level from 0 to 31" },
        { "level:-1", FAULT_PARAM_RANGE, "-1" },            { "level:1.5", FAULT_PARAM_SYNTAX, "level:1.5" },
        { "bright:1", FAULT_PARAM_SYNTAX, "bright:1" },     { "brigh", FAULT_PARAM_SYNTAX, "one of" },
        { "final/bright", FAULT_PARAM_SYNTAX, "one of" },   { "level:1:2", FAULT_PARAM_SYNTAX, "1:2" },
    };
    REFUSE_EACH("view", bad);
    static const struct wrong bad_layers[] = {
        { "/", FAULT_PARAM_SYNTAX, "character 1, \"\"" },
        { "bright/", FAULT_PARAM_SYNTAX, "character 8, \"\"" },
        { "bright/bloom/bright", FAULT_PARAM_SYNTAX, "character 14, \"bright\": this view was given before" },
        { "level:1/level:01", FAULT_PARAM_SYNTAX, "given before" },
        { "level:0/level:1/level:2/level:3/level:4/level:5/level:6/level:7", FAULT_PARAM_RANGE, "at most 7 views" },
        { "bright,bloom", FAULT_PARAM_SYNTAX, "one of" },
    };
    REFUSE_EACH("layers", bad_layers);
}

static void test_tints_and_sun(void **state)
{
    (void)state;
    struct params p;
    ACCEPT(tint, "1:.9:.8", "1:0.9:0.8", &p);
    assert_int_equal(p.tint_count, 1);
    ACCEPT(tint, "1:1:1/0:1000:2/3:4:5/6:7:8/9:10:11/12:13:14", "1:1:1/0:1000:2/3:4:5/6:7:8/9:10:11/12:13:14", &p);
    assert_int_equal(p.tint_count, 6);
    assert_true(p.tints[1][1] == 1000 && p.tints[5][2] == 14);
    ACCEPT(tint, "1:2:3/4:5:6/4:5:6/4:5:6", "1:2:3/4:5:6", &p); /* the last one goes on */
    assert_int_equal(p.tint_count, 2);
    ACCEPT(tint, "1:1:1/1:1:1", "1:1:1", &p);
    static const struct wrong bad_tints[] = {
        { "", FAULT_PARAM_SYNTAX, "character 1" },
        { "1:1", FAULT_PARAM_SYNTAX, "three numbers R:G:B" },
        { "1:1:1/", FAULT_PARAM_SYNTAX, "character 7" },
        { "1:1:1/1:x:1", FAULT_PARAM_SYNTAX, "character 9, \"x\"" },
        { "1:1:1001", FAULT_PARAM_RANGE, "a tint from 0 to 1000" },
        { "1:1:1/1:1:1/1:1:1/1:1:1/1:1:1/1:1:1/1:1:1", FAULT_PARAM_RANGE, "character 37" },
    };
    REFUSE_EACH("tint", bad_tints);

    ACCEPT(sun, "", "", &p);
    assert_false(p.sun_spec.given);
    ACCEPT(sun, "x=50%,y=20%,radius=5%,gain=2,tint=1:.9:.7", "x=50%,y=20%,radius=5%,gain=2,tint=1:0.9:0.7", &p);
    assert_true(p.sun_spec.given && p.sun_spec.x_percent == 50 && p.sun_spec.y_percent == 20);
    assert_true(p.sun_spec.radius.unit == SIZE_PERCENT && p.sun_spec.radius.value == 5);
    assert_true(p.sun_spec.gain == 2 && p.sun_spec.tint[2] == .7);
    ACCEPT(sun, "radius=8px,y=-100%,x=200%", "x=200%,y=-100%,radius=8,gain=1", &p);
    assert_true(p.sun_spec.gain == 1 && p.sun_spec.tint[0] == 1 && p.sun_spec.tint[2] == 1);
    static const struct wrong bad_suns[] = {
        { "x=50%,y=20%", FAULT_PARAM_SYNTAX, "radius=... is missing (x=50%,y=20%,radius=5%" },
        { "x=50,y=20%,radius=5%", FAULT_PARAM_SYNTAX, "character 3, \"50\": a place in % such as 50% expected" },
        { "x=201%,y=20%,radius=5%", FAULT_PARAM_RANGE, "a place in % from -100 to 200" },
        { "x=50%,y=-101%,radius=5%", FAULT_PARAM_RANGE, "-101" },
        { "x=%,y=20%,radius=5%", FAULT_PARAM_SYNTAX, "character 3" },
        { "x=50%,y=20%,radius=0", FAULT_PARAM_RANGE, "0.1 to 4096 px" },
        { "x=50%,y=20%,radius=5%,gain=-1", FAULT_PARAM_RANGE, "a gain from 0" },
        { "x=50%,y=20%,radius=5%,tint=1:1:1/1:1:1", FAULT_PARAM_RANGE, "at most 1" },
        { "x=50%,y=20%,radius=5%,z=1", FAULT_PARAM_SYNTAX, "no such key" },
    };
    REFUSE_EACH("sun", bad_suns);
}

/* Sizes in pixel heights, worked by hand: 1920 x 1080 in a display window of 2048, pixels twice as wide as high. */
static void test_pixels(void **state)
{
    (void)state;
    struct params p;
    params_init(&p);
    const struct size px = { 8, SIZE_PIXELS }, percent = { 10, SIZE_PERCENT }, mm = { .5, SIZE_MM };
    assert_true(params_pixels(&p, &px, 1920, 1080, 2048, 2) == 8);
    assert_true(fabs(params_pixels(&p, &percent, 3, 4, 3, 1) - .5) < 1e-15);
    assert_true(fabs(params_pixels(&p, &percent, 1920, 1080, 2048, 2) - .1 * sqrt(3840. * 3840 + 1080 * 1080)) < 1e-9);
    assert_true(fabs(params_pixels(&p, &mm, 1920, 1080, 2048, 1) - .5 / 36 * 2048) < 1e-9);
    assert_true(fabs(params_pixels(&p, &mm, 1920, 1080, 2048, 2) - .5 / 36 * 4096) < 1e-9);
    params_set_text(&p, "sensor", "24", NULL);
    assert_true(fabs(params_pixels(&p, &mm, 1920, 1080, 2048, 1) - .5 / 24 * 2048) < 1e-9);
    /* The largest picture times the largest size stays a number. */
    assert_true(isfinite(params_pixels(&p, &(struct size){ 1e5, SIZE_MM }, UINT32_MAX, UINT32_MAX, UINT32_MAX, 1e6)));
}

/* ---- damage ------------------------------------------------------------------------------------------ */

static uint64_t seed = 0x2545f4914f6cdd1du;
static unsigned random_below(unsigned n)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (unsigned)((seed >> 11) % n);
}

/* Inserts, deletes, changes and doubles pieces. */
static void damage(char *s, size_t size)
{
    static const char bytes[] = ":,/=%.-+eE0123456789pxmnif \x01\x80_";
    for (unsigned n = 1 + random_below(3); n; n--) {
        size_t len = strlen(s), at = random_below((unsigned)len + 1), cut = random_below(6);
        switch (random_below(4)) {
        case 0:
            if (len + 2 < size)
                memmove(s + at + 1, s + at, len - at + 1), s[at] = bytes[random_below(sizeof(bytes) - 1)];
            break;
        case 1:
            memmove(s + at, s + (at + cut > len ? len : at + cut), len - (at + cut > len ? len : at + cut) + 1);
            break;
        case 2:
            if (at < len)
                s[at] = bytes[random_below(sizeof(bytes) - 1)];
            break;
        default:
            if (2 * len + 1 < size) {
                memmove(s + at + len, s + at, len - at + 1);
                memmove(s + at, s, len);
            }
        }
    }
}

/* Damaged texts are refused with nothing touched, or taken and kept as what reads back as itself. */
static void test_damaged_texts(void **state)
{
    (void)state;
    static const struct {
        const char *name, *text;
        size_t offset;
    } good[] = {
#define ROW(name, text) { #name, text, offsetof(struct params, name) }
        ROW(psf, "gaussians:sigma=4/0.5%/.3mm,weight=.2/.3/.4,tint=1:1:1/1:2:3/0:0:1"),
        ROW(psf, "octaves:sigma=2,count=4,ratio=1.5,slope=.5,bend=-.1,weight=2"),
        ROW(psf, "halation:sigma=4/5/6,gain=.1/.2/.3"),
        ROW(psf, "eye:degrees=40,weight=.1"),
        ROW(psf, "airy:f=8,pitch=5,wavelength=600/500/400"),
        ROW(psf, "aperture:blades=7,rotation=12"),
        ROW(psf, "image:" D32 ",weight=.5"),
        ROW(dirt, D32),
        ROW(grow, "2.5%"),
        ROW(view, "level:12"),
        ROW(layers, "bright/level:0/bloom"),
        ROW(tint, "1:1:1/.5:2:3"),
        ROW(sun, "x=50%,y=20%,radius=5%,gain=2,tint=1:.9:.7"),
        ROW(source, "View Layer.Emit"),
#undef ROW
    };
    static struct params p, before;
    unsigned taken = 0, refused = 0;
    print_message("seed %llx\n", (unsigned long long)seed);
    params_init(&p);
    for (unsigned round = 0; round < 100000; round++) {
        const unsigned k = random_below(sizeof(good) / sizeof(good[0]));
        char text[600], first[PARAMS_TEXT_MAX];
        struct fault f = { 0 };
        strcpy(text, good[k].text);
        damage(text, sizeof(text));
        before = p;
        if (params_set_text(&p, good[k].name, text, &f) < 0) {
            if (memcmp(&p, &before, sizeof(p)) || strncmp(f.field, "params.", 7) || !*f.text)
                fail_msg("%s=%s: touched, or no reason: %s \"%s\"", good[k].name, text, f.field, f.text);
            for (const char *c = f.text; *c; c++)
                assert_true(*c >= ' ' && *c <= '~');
            refused++;
            continue;
        }
        const char *field = (const char *)&p + good[k].offset;
        snprintf(first, sizeof(first), "%s", field);
        if (params_set_text(&p, good[k].name, first, &f) < 0 || strcmp(field, first))
            fail_msg("%s=%s: kept as %s, which is not itself: %s", good[k].name, text, first, f.text);
        taken++;
    }
    print_message("%u damaged texts were refused, %u still meant something\n", refused, taken);
    assert_true(refused > 10000 && taken > 1000);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_defaults),      cmocka_unit_test(test_ranges),
        cmocka_unit_test(test_word_or_number), cmocka_unit_test(test_given),
        cmocka_unit_test(test_choices),       cmocka_unit_test(test_psf_gaussians),
        cmocka_unit_test(test_psf_octaves),   cmocka_unit_test(test_psf_halation),
        cmocka_unit_test(test_psf_kernels),   cmocka_unit_test(test_psf_many),
        cmocka_unit_test(test_names),         cmocka_unit_test(test_grow),
        cmocka_unit_test(test_views),         cmocka_unit_test(test_tints_and_sun),
        cmocka_unit_test(test_pixels),        cmocka_unit_test(test_damaged_texts),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
