// SPDX-License-Identifier: Apache-2.0
// test_psf.c - taps and their error: sums, signs, the figures of METHODS section 3.1.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>

#include "psf.h"

static double sum_of(const struct psf_taps *t)
{
    double s = t->tap[0];
    for (unsigned n = 1; n <= t->half; n++)
        s += 2 * t->tap[n];
    return s;
}

static void test_binomials_sum_to_one(void **state)
{
    (void)state;
    for (unsigned n = 4; n <= 8; n += 2) {
        double s = 0, odd = 0;
        for (unsigned k = 0; k < n; k++) {
            const double h = psf_binomial(n)[k < n / 2 ? k : n - 1 - k];
            s += h;
            odd += k & 1 ? h : 0;
        }
        // Equal sums of the even and the odd taps: each phase of a source gets the same share.
        assert_true(s == 1 && odd == 0.5);
    }
}

static void test_taps_are_a_kernel(void **state)
{
    (void)state;
    const unsigned char order[PSF_LEVELS_MAX] = { 4, 4, 6, 6, 8, 8 };
    for (unsigned level = 0; level <= 6; level++)
        for (double s = 1.3; s < 4; s *= 1.17) {
            struct psf_taps t;
            psf_gaussian_taps(&t, ldexp(s, (int)level), level, order, (unsigned)ceil(3.3 * s));
            assert_true(fabs(sum_of(&t) - 1) < 1e-12);
            for (unsigned n = 0; n <= t.half; n++)
                assert_true(t.tap[n] >= 0 && t.tap[n] <= t.tap[0]);
        }
}

/* The rules' worst errors as published in METHODS, found again by running the filters. */
static void check_rule(const char *name, unsigned char fine, const unsigned char top[3], double s_min, double c,
                       double published)
{
    double worst = 0, at = 0;
    for (double sigma = 2 * s_min * 1.0001; sigma < 40; sigma *= 1.13) {
        const unsigned level = (unsigned)floor(log2(sigma / s_min));
        unsigned char order[PSF_LEVELS_MAX] = { 0 };
        for (unsigned i = 0; i < level; i++)
            order[i] = level - 1 - i < 3 ? top[level - 1 - i] : fine;
        struct psf_taps t;
        struct psf_error e;
        psf_gaussian_taps(&t, sigma, level, order, (unsigned)ceil(c * ldexp(sigma, -(int)level)));
        assert_int_equal(psf_gaussian_error(&e, sigma, level, order, &t), 0);
        const double both = 2 * e.peak + e.peak * e.peak;
        if (both > worst) {
            worst = both;
            at = sigma;
        }
    }
    print_message("%s: worst peak error %.2e at sigma %.2f, published %.1e\n", name, worst, at, published);
    // The bound of two axes is about twice the error of their product at most.
    assert_true(worst < 2.5 * published && worst > published / 4);
}

static void test_rules_reach_their_figures(void **state)
{
    (void)state;
    check_rule("R2", 4, (const unsigned char[]){ 6, 4, 4 }, 1.3, 2.8, 7.0e-3);
    check_rule("R3", 4, (const unsigned char[]){ 6, 6, 4 }, 1.8, 3.25, 7.6e-4);
    check_rule("R4", 4, (const unsigned char[]){ 8, 8, 6 }, 2.0, 3.9, 3.9e-5);
    check_rule("R5", 4, (const unsigned char[]){ 8, 8, 6 }, 4.0, 4.6, 5.7e-6);
}

static void test_order_of_the_zeros_decides(void **state)
{
    (void)state;
    // Error falls as s^-n: halving the level by one at b6 gains far more than at b4.
    double e[2][2];
    for (unsigned i = 0; i < 2; i++)
        for (unsigned more = 0; more < 2; more++) {
            const unsigned char order[PSF_LEVELS_MAX] = { i ? 6 : 4, i ? 6 : 4, i ? 6 : 4 };
            struct psf_taps t;
            struct psf_error err;
            const unsigned level = 3 - more;
            psf_gaussian_taps(&t, 16, level, order, (unsigned)ceil(5 * ldexp(16, -(int)level)));
            assert_int_equal(psf_gaussian_error(&err, 16, level, order, &t), 0);
            e[i][more] = err.peak;
        }
    assert_true(e[1][0] < e[0][0] / 3);
    assert_true(e[0][0] / e[0][1] > 6 && e[1][0] / e[1][1] > 16);
}

static void test_direct_is_exact(void **state)
{
    (void)state;
    const unsigned char order[PSF_LEVELS_MAX] = { 0 };
    struct psf_taps t;
    struct psf_error e;
    psf_gaussian_taps(&t, 1.8, 0, order, 16);
    assert_int_equal(psf_gaussian_error(&e, 1.8, 0, order, &t), 0);
    assert_true(e.l1 < 1e-14 && e.peak < 1e-14);
    psf_gaussian_taps(&t, 1.8, 0, order, 5);
    assert_int_equal(psf_gaussian_error(&e, 1.8, 0, order, &t), 0);
    assert_true(e.l1 > 1e-3 && e.l1 < 1e-2);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_binomials_sum_to_one),
        cmocka_unit_test(test_taps_are_a_kernel),
        cmocka_unit_test(test_rules_reach_their_figures),
        cmocka_unit_test(test_order_of_the_zeros_decides),
        cmocka_unit_test(test_direct_is_exact),
    };
    return cmocka_run_group_tests_name("psf", tests, NULL, NULL);
}
