// SPDX-License-Identifier: Apache-2.0
// hard_kit.c - see hard_kit.h.
#include "hard_kit.h"

#include <float.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { DEVICES_MAX = 8, CASES_MAX = 64 };

struct bloom *hard_engine;
const struct hard_rule hard_rules[RULES] = { { "R2", 1e-2 }, { "R3", 1e-3 }, { "R4", 1e-4 }, { "R5", 1e-5 } };

static struct bloom *engines[DEVICES_MAX];
static unsigned devices;
static bool validate;

/* ---- figures --------------------------------------------------------------------------------------- */

// A comma in a device's name or a text is no separator.
static void csv_field(FILE *f, const char *text)
{
    const bool quoted = strpbrk(text, ",\"\n") != NULL;
    if (quoted)
        fputc('"', f);
    for (; *text; text++)
        fputs((char[3]){ *text, *text == '"' ? '"' : 0 }, f);
    fputs(quoted ? "\"," : ",", f);
}

static void csv_line(unsigned number, const char *what, const char *rule, double value, double limit, const char *unit)
{
    const char *path = getenv("AIRY_HARD_CSV");
    FILE *f = path ? fopen(path, "a") : NULL;
    if (path && !f)
        fail_msg("%s cannot be written", path);
    if (!f)
        return;
    if (ftell(f) == 0)
        fprintf(f, "case,what,rule,figure,limit,unit\n");
    char on[320];
    // Which device, only where there is a choice.
    snprintf(on, sizeof(on), "%s%s%s", what, devices > 1 ? " on " : "", devices > 1 ? bloom_device(hard_engine)->name : "");
    fprintf(f, "%u,", number);
    csv_field(f, on);
    csv_field(f, rule);
    fprintf(f, "%.6g,", value);
    if (isfinite(limit))
        fprintf(f, "%.6g", limit);
    fprintf(f, ",%s\n", unit);
    fclose(f);
}

void figure(unsigned number, const char *what, const char *rule, double value, double limit, const char *unit)
{
    char text[64] = "reported";
    if (isfinite(limit))
        snprintf(text, sizeof(text), "limit %.3g", limit);
    print_message("case %u: %-52s %-4s %-10.4g %s (%s)\n", number, what, rule, value, unit, text);
    csv_line(number, what, rule, value, limit, unit);
    if (!(value <= limit))
        fail_msg("case %u: %s %s: %.6g %s, at most %.6g expected", number, what, rule, value, unit, limit);
}

/* ---- scenes ---------------------------------------------------------------------------------------- */

void hard_run(struct scene *s, const struct params *p) { scene_run(s, p, hard_engine, 0); }

double hard_ratio(struct scene *s, const struct params *p)
{
    struct scene_verdict v;
    hard_run(s, p);
    scene_compare(s, p, &v);
    if (v.why[0])
        fail_msg("%ux%u: %s", s->width, s->height, v.why);
    return v.ratio;
}

double hard_glow(const struct scene *s, const struct params *p, unsigned c, size_t i)
{
    return (s->out[0][c][i] - s->plane[c][i]) / p->intensity;
}

size_t hard_count(const struct scene *s) { return (size_t)s->width * s->height; }

void hard_fill(struct scene *s, double v)
{
    for (unsigned c = 0; c < s->channels; c++)
        for (size_t i = 0; i < hard_count(s); i++)
            s->plane[c][i] = v;
}

double *hard_copy(const double *v, size_t n)
{
    double *copy = malloc(n * sizeof(*copy));
    assert_non_null(copy);
    return memcpy(copy, v, n * sizeof(*copy));
}

double hard_relative(const double *a, const double *b, size_t n)
{
    double worst = 0;
    for (size_t i = 0; i < n; i++)
        if (a[i] != b[i])
            worst = fmax(worst, fabs(a[i] - b[i]) / fmax(fabs(b[i]), DBL_MIN));
    return worst;
}

void hard_border(struct scene *s)
{
    for (unsigned y = 0; y < s->height; y++)
        for (unsigned x = 0; x < s->width; x++)
            if (x == 0 || y == 0 || x == s->width - 1 || y == s->height - 1)
                s->plane[0][y * s->width + x] = 1 + 100 * scene_uniform();
}

double *hard_output(struct scene *s, const struct params *p)
{
    hard_run(s, p);
    return hard_copy(s->out[0][0], hard_count(s));
}

/* ---- devices --------------------------------------------------------------------------------------- */

static void log_line(const char *line) { print_message("%s\n", line); }
static void count_device(const char *line) { devices += *line != 0; }

static int open_device(const char *name, struct bloom **b)
{
    struct fault f = { 0 };
    const struct bloom_options options = { .slots = 2, .validate = validate, .log = log_line, .device = name };
    if (bloom_create(b, &options, &f) < 0) {
        print_error("%s: %s\n", f.field, f.text);
        return -1;
    }
    print_message("device: %s\n", bloom_device(*b)->name);
    return 0;
}

// All that --list-devices names, or the one of AIRY_TEST_DEVICE.
static int setup(void **state)
{
    (void)state;
    const char *one = getenv("AIRY_TEST_DEVICE");
    if (!one)
        bloom_list_devices(count_device);
    if (devices <= 1) {
        devices = 1;
        return open_device(one, &engines[0]);
    }
    devices = devices > DEVICES_MAX ? DEVICES_MAX : devices;
    for (unsigned i = 0; i < devices; i++) {
        char index[12];
        snprintf(index, sizeof(index), "%u", i);
        if (open_device(index, &engines[i]) < 0)
            return -1;
    }
    return 0;
}

static int teardown(void **state)
{
    (void)state;
    for (unsigned i = 0; i < devices; i++)
        bloom_destroy(engines[i]);
    return 0;
}

static void run_case(void **state)
{
    const struct hard_case *c = *state;
    for (unsigned i = 0; i < devices; i++) {
        hard_engine = engines[i];
        scene_seed(1);
        c->run();
    }
}

static void no_validation_message(void **state)
{
    (void)state;
    for (unsigned i = 0; i < devices; i++)
        assert_int_equal(bloom_validation_messages(engines[i]), 0);
}

int hard_main(const char *group, const struct hard_case *cases, unsigned count)
{
    struct CMUnitTest tests[CASES_MAX + 1];
    struct hard_case copies[CASES_MAX];
    unsigned n = 0;
    // AIRY_TEST_VALIDATE=0 runs without the layers (their leaks would drown ours), and without their test.
    validate = !getenv("AIRY_TEST_VALIDATE") || strcmp(getenv("AIRY_TEST_VALIDATE"), "0") != 0;
    for (unsigned i = 0; i < count && n < CASES_MAX; i++) {
        if (!cases[i].has)
            continue;
        copies[n] = cases[i];
        tests[n] = (struct CMUnitTest){ .name = cases[i].name, .test_func = run_case, .initial_state = &copies[n] };
        n++;
    }
    if (validate)
        tests[n++] = (struct CMUnitTest){ .name = "no_validation_message", .test_func = no_validation_message };
    return _cmocka_run_group_tests(group, tests, n, setup, teardown);
}
