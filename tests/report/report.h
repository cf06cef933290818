/* SPDX-License-Identifier: Apache-2.0 */
/*
 * report.h - what the parts of airy_report share. It measures and writes CSV files into a folder; report_page makes the
 * page of them. How things are compared: bench.h. What cannot be measured here is a line of notes.csv, with the reason.
 */
#ifndef AIRY_REPORT_H
#define AIRY_REPORT_H

#include <stdio.h>

#include "bench.h"
#include "method.h"

enum report_extent { EXTENT_TINY, EXTENT_QUICK, EXTENT_FULL }; /* tiny: for the test of the report itself */

struct report {
    const char *dir;
    enum report_extent extent;
    bool large;             /* the 16K frame too */
    bool engine_only;       /* report_speed leaves the methods out: they have been measured */
    const char *frames_dir; /* NULL: none */
    struct team *team;
    struct bloom *engine;
    char device[128]; /* of the engine */
    FILE *speed, *shimmer, *size, *tiles, *frames, *machine, *notes;
};

/* One line: each column by a letter of `kinds`: s text (quoted), d a double, u an unsigned. */
void sheet_row(FILE *to, const char *kinds, ...);
void report_note(struct report *r, const char *section, const char *format, ...) __attribute__((format(printf, 3, 4)));

/* ---- what is compared -------------------------------------------------------------------------------------- */

/* Both classes of subject are given FLOAT planes and hand out FLOAT rows; conversion is outside of the clock. A subject's
 * planes are its own, but the engine's subjects of one type have theirs in common: load, run, look, then the next. */
struct subject {
    char name[48], setting[64];
    const struct method *method; /* NULL: the engine */
    double tolerance;
    enum pixel_type type;
    /* between subject_open and subject_close: */
    struct blur_job job;
    void *self;
    struct bloom *engine;
    struct bloom_slot *slot;
    struct params params;
    struct planes in, out;
    struct frame_scan scan;
    struct bloom_reply reply;
    float *row; /* of the output, as float */
};

enum { SUBJECTS_MAX = 24 };
/* The engine at each tolerance for half and float (half: with planes of half on both sides), and the methods. */
unsigned subjects_all(struct subject s[SUBJECTS_MAX]);
/* False, with nothing to close: the method cannot do that job. */
bool subject_open(struct subject *s, struct report *r, const struct blur_job *job);
void subject_close(struct subject *s);
void subject_load(struct subject *s, const struct planes *from);
/* The same, of an all-black frame but for two neighbours. */
void subject_point(struct subject *s, uint32_t x, uint32_t y, float at_x, float at_next);
double subject_run(struct subject *s); /* ms */
const float *subject_row(struct subject *s, unsigned c, uint32_t y);

/* ---- jobs -------------------------------------------------------------------------------------------------------- */

struct psf_job {
    const char *name;
    unsigned n;
    double sigma[METHOD_GAUSSIANS_MAX], weight[METHOD_GAUSSIANS_MAX];
};
struct psf_job psf_sigma20(void);
struct psf_job psf_j5(uint32_t width); /* of this frame width */
struct blur_job psf_blur(const struct psf_job *p, uint32_t width, uint32_t height, unsigned channels, float threshold,
                         double gain, struct team *team);

/* Worst |difference| from the sampled Gaussians over their peak for a lone point, over `phases` places. < 0: cannot. */
double point_error(struct subject *s, struct report *r, const struct psf_job *p, unsigned phases);

/* ---- the measurements ------------------------------------------------------------------------------------------- */

void report_speed(struct report *r);
void report_shimmer(struct report *r);
void report_tiles(struct report *r);
void report_size(struct report *r); /* last: the engine's memory only grows */
void report_frames(struct report *r);

#endif
