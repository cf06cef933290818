// SPDX-License-Identifier: Apache-2.0
// jobs.c - the J5 job in its three words (parameters, sigmas, C chain), the floors as cases, and the
// chain's own check: a yardstick that computes something else would make every ratio a lie.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"
#include "c_chain.h"
#include "reference.h"

static const double JOB_WEIGHT[JOB_GAUSSIANS] = { .2, .2, .2, .2, .2 };

void job_sigmas(uint32_t width, double sigma[JOB_GAUSSIANS])
{
    for (unsigned i = 0; i < JOB_GAUSSIANS; i++)
        sigma[i] = ldexp(width > 1920 ? 8 : 4, (int)i);
}

const char *job_psf(uint32_t width)
{
    static char text[160];
    double s[JOB_GAUSSIANS];
    job_sigmas(width, s);
    snprintf(text, sizeof text, "gaussians:sigma=%g/%g/%g/%g/%g,weight=0.2/0.2/0.2/0.2/0.2", s[0], s[1],
             s[2], s[3], s[4]);
    return text;
}

static void set(struct params *p, const char *name, const char *text)
{
    struct fault f;
    if (params_set_text(p, name, text, &f) < 0)
        die("%s: %s", f.field, f.text);
}

struct params job_params(uint32_t width, double tolerance)
{
    struct params p;
    char text[32];
    params_init(&p);
    snprintf(text, sizeof text, "%g", tolerance);
    set(&p, "tolerance", text);
    set(&p, "bright", "channel");
    set(&p, "threshold", "1");
    set(&p, "intensity", "1");
    set(&p, "psf", job_psf(width));
    return p;
}

/* ---- memcpy --------------------------------------------------------------------------------------- */

struct copy {
    struct team *team;
    size_t bytes; /* of each member */
    uint8_t *from, *to;
};

struct copy *copy_create(const struct bench_frame *f, struct team *team)
{
    struct copy *c = take(1, sizeof(*c));
    *c = (struct copy){ .team = team, .bytes = (size_t)f->width * f->height * 16 / TEAM };
    c->from = take(TEAM, c->bytes);
    c->to = take(TEAM, c->bytes);
    memset(c->from, 1, TEAM * c->bytes); // pages of its own, not one page of zeros
    return c;
}

void copy_destroy(struct copy *c)
{
    free(c->from);
    free(c->to);
    free(c);
}

static void copy_half(void *ctx, unsigned member)
{
    const struct copy *c = ctx;
    memcpy(c->to + member * c->bytes, c->from + member * c->bytes, c->bytes);
}

void copy_run(void *ctx, struct sample *s)
{
    struct copy *c = ctx;
    double t0 = now_ms();
    team_run(c->team, copy_half, c);
    s->ms = now_ms() - t0;
    c->from[0]++; // the copy is looked at: it cannot be left out
    if (c->to[0] != (uint8_t)(c->from[0] - 1))
        die("memcpy did not copy");
}

/* ---- the C chain ------------------------------------------------------------------------------------
 */

struct chain_job {
    struct c_chain *chain;
    const struct bench_frame *f;
    struct planes out;
};

static struct c_chain *chain_for(uint32_t width, uint32_t height, uint32_t job_width, struct team *team)
{
    double sigma[JOB_GAUSSIANS];
    job_sigmas(job_width, sigma);
    struct c_chain *c = c_chain_create(width, height, sigma, JOB_WEIGHT, JOB_GAUSSIANS, team);
    if (!c)
        die("the C chain cannot be made for %ux%u", width, height);
    return c;
}

struct chain_job *chain_job_create(const struct bench_frame *f, struct team *team)
{
    struct chain_job *j = take(1, sizeof(*j));
    j->f = f;
    j->chain = chain_for(f->width, f->height, f->width, team);
    if (planes_alloc(&j->out, f->width, f->height, 3, PIXEL_TYPE_FLOAT))
        die("no memory for %s planes", f->size);
    return j;
}

void chain_job_destroy(struct chain_job *j)
{
    c_chain_destroy(j->chain);
    planes_free(&j->out);
    free(j);
}

void chain_job_run(void *ctx, struct sample *s)
{
    struct chain_job *j = ctx;
    double t0 = now_ms();
    c_chain_run(j->chain, &j->f->in_float, &j->out, 1, 1);
    s->ms = now_ms() - t0;
}

// The worst |difference| of the glow over all planes; *peak: the largest right glow.
static double chain_error(const struct planes *in, const struct planes *out, const struct params *p,
                          double *peak, double *max_bright)
{
    struct reference_frame rf = { .width = in->width,
                                  .height = in->height,
                                  .channels = 3,
                                  .luma = { .2126, .7152, .0722 },
                                  .pixel_aspect = 1 };
    double *plane[3];
    for (unsigned c = 0; c < 3; c++) {
        rf.plane[c] = plane[c] = take((size_t)in->width * in->height, sizeof(double));
        for (size_t i = 0; i < (size_t)in->width * in->height; i++)
            plane[c][i] = ((const float *)planes_row(in, c, (uint32_t)(i / in->width)))[i % in->width];
    }
    struct reference_result r;
    if (reference_bloom(&r, &rf, p) < 0)
        die("the reference has no memory");
    double worst = *peak = 0;
    for (unsigned c = 0; c < 3; c++)
        for (size_t i = 0; i < (size_t)in->width * in->height; i++) {
            float v = ((const float *)planes_row(out, c, (uint32_t)(i / in->width)))[i % in->width];
            worst = fmax(worst, fabs(v - r.out[c][i]));
            *peak = fmax(*peak, r.glow[c][i]);
        }
    *max_bright = r.max_bright;
    reference_free(&r);
    for (unsigned c = 0; c < 3; c++)
        free(plane[c]);
    return worst;
}

void chain_check(struct team *team)
{
    static const double TOLERANCE = 2e-2;
    enum { WIDTH = 211, HEIGHT = 123 };
    struct planes in, out;
    struct params p = job_params(1920, TOLERANCE);
    struct c_chain *chain = chain_for(WIDTH, HEIGHT, 1920, team);
    if (planes_alloc(&in, WIDTH, HEIGHT, 3, PIXEL_TYPE_FLOAT) ||
        planes_alloc(&out, WIDTH, HEIGHT, 3, PIXEL_TYPE_FLOAT))
        die("no memory for the chain's check");
    for (unsigned scene = 0; scene < 2; scene++) {
        uint32_t seed = 1;
        for (unsigned c = 0; c < 3; c++)
            for (uint32_t i = 0; i < WIDTH * HEIGHT; i++) {
                seed = seed * 1664525u + 1013904223u;
                // First one point, then ground and sparks up to every edge.
                ((float *)planes_row(&in, c, i / WIDTH))[i % WIDTH] =
                    scene ? (float)(seed >> 8) * 0x1.3p-24f + (seed % 193 == 0 ? 30 : 0)
                          : (i == 61 * WIDTH + 107 + c ? 2 : 0);
            }
        c_chain_run(chain, &in, &out, 1, 1);
        double peak, max_bright, error = chain_error(&in, &out, &p, &peak, &max_bright);
        double of = scene ? max_bright : peak;
        printf("C chain against the reference, %s: worst error %.1e of %s\n",
               scene ? "sparks" : "one point", error / of, scene ? "max E" : "the peak");
        csv_line("check", "211x123", scene ? "c_chain sparks" : "c_chain point", "error", error / of,
                 "relative");
        if (!(error <= TOLERANCE * of))
            die("the C chain errs by %g, %g allowed", error, TOLERANCE * of);
    }
    planes_free(&in);
    planes_free(&out);
    c_chain_destroy(chain);
}
