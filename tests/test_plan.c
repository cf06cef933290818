// SPDX-License-Identifier: Apache-2.0
// test_plan.c - the planner: tolerances are held by the computed bound, cheaper rules win, sizes resolve.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "plan.h"

static struct plan make(const char *psf, double tolerance, uint32_t w, uint32_t h, double aspect)
{
    struct params p;
    struct plan plan;
    struct fault f = { 0 };
    params_init(&p);
    if (params_set_text(&p, "psf", psf, &f) < 0)
        fail_msg("%s", f.text);
    p.tolerance = tolerance;
    const struct plan_facts facts = { w, h, w, 3, aspect, -1 };
    if (plan_make(&plan, &p, tolerance, &facts, &f) < 0)
        fail_msg("%s", f.text);
    return plan;
}

static void test_bound_holds_the_tolerance(void **state)
{
    (void)state;
    static const double tolerances[] = { 1e-2, 3e-3, 1e-3, 1e-4, 1e-5 };
    for (unsigned t = 0; t < 5; t++)
        for (double sigma = 0.3; sigma < 700; sigma *= 1.31) {
            char psf[64];
            snprintf(psf, sizeof(psf), "gaussians:sigma=%.9g,weight=1", sigma);
            const struct plan p = make(psf, tolerances[t], 1920, 1080, 1);
            if (!(p.filter_bound <= tolerances[t]))
                fail_msg("sigma %g tolerance %g: bound %g (%s)", sigma, tolerances[t], p.filter_bound, p.rule);
            assert_true(p.gaussian[0].peak <= tolerances[t]);
        }
}

static void test_weights_scale_the_bound(void **state)
{
    (void)state;
    // Ten times the weight: the same promise on intensity * max E needs a tenth of the error.
    const struct plan a = make("gaussians:sigma=20,weight=1", 1e-3, 1920, 1080, 1);
    const struct plan b = make("gaussians:sigma=20,weight=10", 1e-3, 1920, 1080, 1);
    assert_true(a.filter_bound <= 1e-3 && b.filter_bound <= 1e-3);
    assert_true(b.gaussian[0].l1 <= 1e-4);
}

static void test_looser_is_not_dearer(void **state)
{
    (void)state;
    double before = 0;
    for (double tolerance = 1e-2; tolerance >= 1e-5; tolerance /= 10) {
        const struct plan p = make("gaussians:sigma=4/8/16/32/64,weight=.2", tolerance, 1920, 1080, 1);
        assert_true(p.cost >= before);
        before = p.cost;
    }
}

static void test_shared_octaves_take_the_highest_order(void **state)
{
    (void)state;
    const struct plan p = make("gaussians:sigma=4/64,weight=.5/.5", 1e-3, 1920, 1080, 1);
    assert_int_equal(p.levels, 5);
    assert_int_equal(p.gaussian[0].level, 1);
    assert_int_equal(p.order[0], 6);
    assert_int_equal(p.order[1], 4);
    assert_int_equal(p.order[4], 6);
}

static void test_sizes(void **state)
{
    (void)state;
    // 1 % of the diagonal of 3-4-5, with pixels twice as wide as high.
    const struct plan p = make("gaussians:sigma=1%,weight=1", 1e-3, 150, 400, 2);
    assert_true(fabs(p.gaussian[0].sigma_y - 5) < 1e-12);
    assert_true(fabs(p.gaussian[0].sigma_x - 2.5) < 1e-12);
    assert_false(p.full_size && p.levels);
    struct params q;
    struct plan plan;
    struct fault f = { 0 };
    params_init(&q);
    assert_int_equal(params_set_text(&q, "psf", "gaussians:sigma=99%,weight=1", &f), 0);
    const struct plan_facts facts = { 16384, 16384, 16384, 3, 1, -1 };
    assert_int_equal(plan_make(&plan, &q, 1e-3, &facts, &f), -1);
    assert_int_equal(f.code, FAULT_PARAM_RANGE);
    assert_string_equal(f.field, "params.psf");
}

static void test_no_weight_is_no_plan(void **state)
{
    (void)state;
    const struct plan p = make("gaussians:sigma=4/8,weight=0/0", 1e-3, 64, 64, 1);
    assert_int_equal(p.count, 0);
}

static void test_print(void **state)
{
    (void)state;
    char text[256], cut[10];
    const struct plan p = make("gaussians:sigma=4/8,weight=.1/.1", 1e-3, 640, 480, 1);
    const int n = plan_print(&p, text, sizeof(text));
    assert_int_equal(n, (int)strlen(text));
    assert_int_equal(plan_print(&p, cut, sizeof(cut)), n);
    assert_int_equal(strlen(cut), 9);
    assert_non_null(strstr(text, "sigma 4 at 1"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_bound_holds_the_tolerance),
        cmocka_unit_test(test_weights_scale_the_bound),
        cmocka_unit_test(test_looser_is_not_dearer),
        cmocka_unit_test(test_shared_octaves_take_the_highest_order),
        cmocka_unit_test(test_sizes),
        cmocka_unit_test(test_no_weight_is_no_plan),
        cmocka_unit_test(test_print),
    };
    return cmocka_run_group_tests_name("plan", tests, NULL, NULL);
}
