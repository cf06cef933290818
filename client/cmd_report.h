/* SPDX-License-Identifier: Apache-2.0 */
/*
 * cmd_report.h - what became of a frame, for people (lines on stderr) and for programs (one JSON object
 * a line on stdout; airy(1) lists its members).
 */
#ifndef AIRY_CMD_REPORT_H
#define AIRY_CMD_REPORT_H

#include <stdbool.h>
#include <stdint.h>

#include "airy.h"
#include "cmd.h"
#include "progress.h"

struct report_frame {
    bool numbered; /* of a range */
    int64_t number; /* frames.h's unit */
    bool black;     /* in the place of an input that is missing */
    const char *input, *output;
};

/* A frame that ended without work. */
enum report_pass { REPORT_SKIPPED, REPORT_MISSING };

void report_json_done(const struct report_frame *f, const struct airy_result *r, double write_ms);
void report_json_error(const struct report_frame *f, const struct airy_error *e, enum cmd_exit exit);
void report_json_pass(const struct report_frame *f, enum report_pass pass, const char *stamp);
void report_json_status(const struct airy_status *s);
struct json;
/* ... its members, into an object that is open. */
void report_json_status_fields(struct json *j, const struct airy_status *s);

/* A line per frame of a range; a paragraph for a single frame. */
void report_line(struct progress *p, const struct report_frame *f, const struct airy_result *r);
void report_paragraph(struct progress *p, const struct report_frame *f, const struct airy_result *r,
                      double write_ms);
void report_pass(struct progress *p, const struct report_frame *f, enum report_pass pass);
/* What would run, on standard output. */
void report_plan(const char *input, const struct airy_result *r);
void report_json_plan(const char *input, const struct airy_result *r);
void report_error(struct progress *p, const struct report_frame *f, const struct airy_error *e);
/* The error's field as people know it. */
const char *report_field(const struct airy_error *e);

#endif
