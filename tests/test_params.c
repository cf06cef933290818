// SPDX-License-Identifier: Apache-2.0
// test_params.c - params.c against its table: ranges at their very ends, the psf grammar, and that what
// is printed reads back to the same request.
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
    char line[2048];
    params_init(&p);
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
           "threshold = nan: a finite number from 0 to 1e+30 (scene-linear) expected");
}

static void test_choices(void **state)
{
    (void)state;
    struct params p;
    struct fault f;
    params_init(&p);
    assert_int_equal(params_set_text(&p, "bright", "none", NULL), 0);
    assert_int_equal(p.bright, BRIGHT_NONE);
    assert_int_equal(params_set_text(&p, "bright", "smoothstep", NULL), 0);
    assert_int_equal(p.bright, BRIGHT_SMOOTHSTEP);
    assert_int_equal(params_set_text(&p, "nonfinite", "reject", NULL), 0);
    assert_int_equal(p.nonfinite, NONFINITE_REJECT);
    refuse("bright", "", FAULT_PARAM_SYNTAX, "smoothstep");
    refuse("bright", "kne", FAULT_PARAM_SYNTAX, "bright = kne");
    refuse("bright", "knee ", FAULT_PARAM_SYNTAX, "none channel");
    refuse("bright", "none channel", FAULT_PARAM_SYNTAX, "one of");
    assert_int_equal(params_set_number(&p, "bright", 1, &f), -1);
    assert_int_equal(f.code, FAULT_PARAM_SYNTAX);
    refuse("sgima", "1", FAULT_PARAM_UNKNOWN, "known: bright, threshold");
    refuse("", "1", FAULT_PARAM_UNKNOWN, "known");
}

static void test_psf(void **state)
{
    (void)state;
    struct params p;
    params_init(&p);
    assert_int_equal(params_set_text(&p, "psf", "gaussians:sigma=4/8/16,weight=.2/.3/.4", NULL), 0);
    assert_string_equal(p.psf, "gaussians:sigma=4/8/16,weight=0.2/0.3/0.4");
    assert_int_equal(p.psf_spec.count, 3);
    assert_true(p.psf_spec.gaussian[1].sigma.value == 8 && p.psf_spec.gaussian[1].weight == .3);
    assert_int_equal(params_set_text(&p, "psf", "gaussians:weight=2e-1,sigma=4/0.5%", NULL), 0);
    assert_string_equal(p.psf, "gaussians:sigma=4/0.5%,weight=0.2");
    assert_true(p.psf_spec.gaussian[0].sigma.unit == SIZE_PIXELS && p.psf_spec.gaussian[1].sigma.unit == SIZE_PERCENT);
    assert_true(p.psf_spec.gaussian[1].weight == .2);

    static const struct {
        const char *psf;
        enum fault_code code;
        const char *says;
    } bad[] = {
        { "", FAULT_PARAM_SYNTAX, "known: gaussians:" },
        { "airy:f=8", FAULT_PARAM_SYNTAX, "\"airy:f=8\"" },
        { "gaussians:", FAULT_PARAM_SYNTAX, "sigma=... or weight=... expected" },
        { "gaussians:sigma=4", FAULT_PARAM_SYNTAX, "weight=... is missing" },
        { "gaussians:weight=4", FAULT_PARAM_SYNTAX, "sigma=... is missing" },
        { "gaussians:sigma=-1,weight=1", FAULT_PARAM_RANGE, "character 17, \"-1\"" },
        { "gaussians:sigma=0,weight=1", FAULT_PARAM_RANGE, "0.1 to 4096" },
        { "gaussians:sigma=0.0999,weight=1", FAULT_PARAM_RANGE, "0.0999" },
        { "gaussians:sigma=4096.5,weight=1", FAULT_PARAM_RANGE, "4096.5" },
        { "gaussians:sigma=101%,weight=1", FAULT_PARAM_RANGE, "101%" },
        { "gaussians:sigma=0.0001%,weight=1", FAULT_PARAM_RANGE, "0.0001%" },
        { "gaussians:sigma=nan,weight=1", FAULT_PARAM_RANGE, "nan" },
        { "gaussians:sigma=inf%,weight=1", FAULT_PARAM_RANGE, "inf%" },
        { "gaussians:sigma=4,weight=nan", FAULT_PARAM_RANGE, "nan" },
        { "gaussians:sigma=4,weight=-0.1", FAULT_PARAM_RANGE, "-0.1" },
        { "gaussians:sigma=4,weight=1e7", FAULT_PARAM_RANGE, "1e7" },
        { "gaussians:sigma=4,weight=10%", FAULT_PARAM_SYNTAX, "10%" },
        { "gaussians:sigma=4%%,weight=1", FAULT_PARAM_SYNTAX, "4%%" },
        { "gaussians:sigma=%,weight=1", FAULT_PARAM_SYNTAX, "\"%\"" },
        { "gaussians:sigma=,weight=1", FAULT_PARAM_SYNTAX, "sigma such as" },
        { "gaussians:sigma=4/,weight=1", FAULT_PARAM_SYNTAX, "character 19" },
        { "gaussians:sigma=4//8,weight=1", FAULT_PARAM_SYNTAX, "character 19" },
        { "gaussians:sigma=4,sigma=8,weight=1", FAULT_PARAM_SYNTAX, "given before" },
        { "gaussians:sigma=4,weight=1,weight=1", FAULT_PARAM_SYNTAX, "given before" },
        { "gaussians:sigma=4,weight=1,", FAULT_PARAM_SYNTAX, "character 28" },
        { "gaussians:sigma=4,weight=1 ", FAULT_PARAM_SYNTAX, "\"1 \"" },
        { "gaussians:sigma=4,weight=1,tint=2", FAULT_PARAM_SYNTAX, "\"tint=2\"" },
        { "gaussians:Sigma=4,weight=1", FAULT_PARAM_SYNTAX, "Sigma=4" },
        { "gaussians:sigma=4/8/16,weight=1/2", FAULT_PARAM_SYNTAX, "3 sigmas and 2 weights" },
        { "gaussians:sigma=4,weight=1/2", FAULT_PARAM_SYNTAX, "1 sigmas and 2 weights" },
        { "gaussians:sigma=4\x01\xff,weight=1", FAULT_PARAM_SYNTAX, "\"4??\"" },
    };
    for (unsigned i = 0; i < sizeof(bad) / sizeof(bad[0]); i++)
        refuse("psf", bad[i].psf, bad[i].code, bad[i].says);
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
    refuse("psf", text, FAULT_PARAM_RANGE, "at most 32");
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

static void test_conflicts(void **state)
{
    (void)state;
    struct params p;
    struct fault f;
    params_init(&p);
    p.knee = 1.5;
    assert_int_equal(params_check(&p, &f), 0);
    p.bright = BRIGHT_SMOOTHSTEP;
    assert_int_equal(params_check(&p, &f), -1);
    assert_int_equal(f.code, FAULT_PARAM_CONFLICT);
    assert_string_equal(f.field, "params.knee");
    p.knee = 1;
    assert_int_equal(params_check(&p, &f), 0);
    p.threshold = 1e30;
    p.exposure = -32;
    assert_int_equal(params_check(&p, &f), -1);
    assert_string_equal(f.field, "params.exposure");
    p.bright = BRIGHT_NONE;
    assert_int_equal(params_check(&p, &f), 0);
    p.bright = BRIGHT_KNEE;
    p.threshold = 1;
    p.knee = 1e30;
    assert_int_equal(params_check(&p, &f), -1);
}

/* ---- print -> parse -> print ------------------------------------------------------------------------
 */

static uint64_t seed = 0x9e3779b97f4a7c15u;

static uint64_t random_u64(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    return seed ^= seed << 17;
}

static double random_in(double min, double max)
{
    double u = (double)(random_u64() >> 11) * 0x1p-53;
    double v = random_u64() % 4 == 0 ? round(min + (max - min) * u) : min + (max - min) * u;
    if (random_u64() % 2 && max > 1e3)
        v = fmin(max, fmax(min, exp2(u * 40 - 20)));
    return random_u64() % 16 == 0 ? (random_u64() % 2 ? min : max) : fmin(max, fmax(min, v));
}

static void parse_line(struct params *p, const char *line)
{
    char copy[4096], *save = NULL;
    struct fault f;
    snprintf(copy, sizeof(copy), "%s", line);
    for (char *word = strtok_r(copy, " ", &save); word; word = strtok_r(NULL, " ", &save)) {
        char *equals = strchr(word, '=');
        assert_non_null(equals);
        *equals = '\0';
        if (params_set_text(p, word, equals + 1, &f) < 0)
            fail_msg("%s=%s: %s", word, equals + 1, f.text);
    }
}

static void random_psf(struct params *p)
{
    char text[1024];
    unsigned n = 1 + (unsigned)(random_u64() % 12);
    char *s = text + sprintf(text, "gaussians:sigma=");
    for (unsigned i = 0; i < n; i++)
        s += random_u64() % 2 ? sprintf(s, "%s%.9g%%", i ? "/" : "", random_in(.001, 100))
                              : sprintf(s, "%s%.12g", i ? "/" : "", random_in(.1, 4096));
    s += sprintf(s, ",weight=");
    for (unsigned i = 0; i < n; i++)
        s += sprintf(s, "%s%.12g", i ? "/" : "", random_in(0, 1e6));
    struct fault f;
    if (params_set_text(p, "psf", text, &f) < 0)
        fail_msg("%s: %s", text, f.text);
}

static void test_round_trip(void **state)
{
    (void)state;
    static const char *const curves[] = { "none", "channel", "luminance", "knee", "smoothstep" };
    static const char *const policies[] = { "keep", "zero", "reject" };
    for (unsigned round = 0; round < 5000; round++) {
        struct params a, b;
        char first[4096], second[4096];
        params_init(&a);
        params_init(&b);
        for (unsigned i = 0; i < N_NUMBERS; i++)
            assert_int_equal(
                params_set_number(&a, numbers[i].name, random_in(numbers[i].min, numbers[i].max), NULL),
                0);
        params_set_text(&a, "bright", curves[random_u64() % 5], NULL);
        params_set_text(&a, "nonfinite", policies[random_u64() % 3], NULL);
        random_psf(&a);
        int len = params_print(&a, first, sizeof(first));
        assert_int_equal(len, strlen(first));
        parse_line(&b, first);
        params_print(&b, second, sizeof(second));
        assert_string_equal(first, second);
        if (a.bright == BRIGHT_KNEE) /* nothing is without meaning then: all of it must come back */
            assert_memory_equal(&a, &b, sizeof(a));
    }
}

static void test_print_equal(void **state)
{
    (void)state;
    struct params a, b;
    char first[2048], second[2048], cut[10];
    params_init(&a);
    params_init(&b);
    params_set_text(&a, "threshold", "1.50", NULL);
    params_set_text(&b, "threshold", "15e-1", NULL);
    params_set_text(&a, "exposure", "-0", NULL);
    params_set_number(&b, "exposure", 0, NULL);
    params_set_text(&a, "psf", "gaussians:sigma=400/8,weight=.2/.2", NULL);
    params_set_text(&b, "psf", "gaussians:weight=2e-1,sigma=4e2/8.0", NULL);
    int len = params_print(&a, first, sizeof(first));
    params_print(&b, second, sizeof(second));
    assert_string_equal(first, second);
    assert_non_null(strstr(first, "threshold=1.5 "));
    assert_non_null(strstr(first, "exposure=0 "));
    assert_non_null(strstr(first, "psf=gaussians:sigma=400/8,weight=0.2 "));
    assert_int_equal(params_print(&a, cut, sizeof(cut)), len);
    assert_memory_equal(cut, first, sizeof(cut) - 1);
    assert_int_equal(cut[9], 0);
    assert_int_equal(params_print(&a, NULL, 0), len);
    /* With bright=none threshold, knee and exposure change nothing, and are not said. */
    params_set_text(&a, "bright", "none", NULL);
    params_set_text(&b, "bright", "none", NULL);
    params_set_text(&b, "threshold", "7", NULL);
    params_print(&a, first, sizeof(first));
    params_print(&b, second, sizeof(second));
    assert_string_equal(first, second);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_defaults),   cmocka_unit_test(test_ranges),
        cmocka_unit_test(test_choices),    cmocka_unit_test(test_psf),
        cmocka_unit_test(test_psf_many),   cmocka_unit_test(test_conflicts),
        cmocka_unit_test(test_round_trip), cmocka_unit_test(test_print_equal),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
