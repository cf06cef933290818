// SPDX-License-Identifier: Apache-2.0
// cmd_report.c - a frame may have several targets (parts, views): at the top of its JSON object stand
// sums, and the worst of what cannot be summed; the targets follow one by one.
#include "cmd_report.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "cmd_json.h"
#include "frames.h"

/* All targets as one. */
static struct airy_target total_of(const struct airy_result *r)
{
    struct airy_target sum = { .untouched = true, .plan = "", .rule = "", .skipped = "", .storage = "" };
    for (unsigned i = 0; i < r->n_targets; i++) {
        const struct airy_target *t = &r->targets[i];
        if (i == 0 || t->error_bound > sum.error_bound) {
            sum.plan = t->plan;
            sum.rule = t->rule;
            sum.skipped = t->skipped;
            sum.storage = t->storage;
        }
        sum.error_bound = fmax(sum.error_bound, t->error_bound);
        sum.max_bright = fmax(sum.max_bright, t->max_bright);
        sum.levels = t->levels > sum.levels ? t->levels : sum.levels;
        sum.tiles += t->tiles;
        sum.tiles_bright += t->tiles_bright;
        sum.untouched = sum.untouched && t->untouched;
        sum.energy_input += t->energy_input;
        sum.energy_bright += t->energy_bright;
        sum.energy_bloomed += t->energy_bloomed;
        sum.energy_lost += t->energy_lost;
        sum.energy_clamped += t->energy_clamped;
        sum.energy_suppressed += t->energy_suppressed;
        sum.predicted_ms += t->predicted_ms;
        sum.nan += t->nan;
        sum.positive_inf += t->positive_inf;
        sum.negative_inf += t->negative_inf;
        sum.negative += t->negative;
        sum.saturated += t->saturated;
        if (t->any_nonfinite && !sum.any_nonfinite) {
            sum.any_nonfinite = true;
            sum.first_x = t->first_x;
            sum.first_y = t->first_y;
            sum.first_channel = t->first_channel;
        }
    }
    return sum;
}

/* ---- JSON --------------------------------------------------------------------------------------- */

static void json_measures(struct json *j, const struct airy_target *t)
{
    json_number(j, "error_bound", t->error_bound);
    json_string(j, "plan", t->plan);
    json_string(j, "rule", t->rule);
    json_count(j, "levels", t->levels);
    json_count(j, "tiles", t->tiles);
    json_count(j, "tiles_bright", t->tiles_bright);
    json_bool(j, "untouched", t->untouched);
    json_number(j, "max_bright", t->max_bright);
    json_open(j, "energy", '{');
    json_number(j, "input", t->energy_input);
    json_number(j, "bright", t->energy_bright);
    json_number(j, "bloomed", t->energy_bloomed);
    json_number(j, "lost", t->energy_lost);
    json_number(j, "clamped", t->energy_clamped);
    json_number(j, "suppressed", t->energy_suppressed);
    json_close(j, '}');
    json_open(j, "nonfinite", '{');
    json_count(j, "nan", t->nan);
    json_count(j, "positive_inf", t->positive_inf);
    json_count(j, "negative_inf", t->negative_inf);
    json_count(j, "negative", t->negative);
    if (t->any_nonfinite) {
        json_open(j, "first", '{');
        json_integer(j, "x", t->first_x);
        json_integer(j, "y", t->first_y);
        json_string(j, "channel", t->first_channel);
        json_close(j, '}');
    } else {
        json_null(j, "first");
    }
    json_close(j, '}');
    json_count(j, "saturated", t->saturated);
    json_string(j, "skipped", t->skipped);
    json_string(j, "storage", t->storage);
    json_number(j, "predicted_ms", t->predicted_ms);
}

static void json_place(struct json *j, const struct airy_target *t)
{
    json_string(j, "name", t->name);
    json_integer(j, "x", t->min_x);
    json_integer(j, "y", t->min_y);
    json_count(j, "width", t->width);
    json_count(j, "height", t->height);
    json_number(j, "exposure", t->exposure);
}

static void json_notes(struct json *j, const struct airy_result *r)
{
    json_string(j, "device", r->device);
    json_open(j, "notes", '[');
    for (unsigned i = 0; i < r->n_notes; i++)
        json_string(j, NULL, r->notes[i]);
    json_close(j, ']');
}

static void json_frame(struct json *j, const struct report_frame *f, const char *status)
{
    json_open(j, NULL, '{');
    if (f->numbered)
        json_number(j, "frame", (double)f->number / (double)FRAMES_ONE);
    else
        json_null(j, "frame");
    json_string(j, "input", f->input);
    json_string(j, "output", f->output);
    json_string(j, "status", status);
}

static void json_times(struct json *j, const char *key, const struct airy_times *ms, double write_ms)
{
    json_open(j, key, '{');
    json_number(j, "queue", ms->queue);
    json_number(j, "load", ms->load);
    json_number(j, "decode", ms->decode);
    json_number(j, "bloom", ms->bloom);
    json_number(j, "encode", ms->encode);
    json_number(j, "total", ms->total);
    if (write_ms >= 0)
        json_number(j, "write", write_ms);
    json_close(j, '}');
}

void report_json_done(const struct report_frame *f, const struct airy_result *r, double write_ms)
{
    struct json j = { .out = stdout };
    struct airy_target sum = total_of(r);
    json_frame(&j, f, f->black ? "black" : "done");
    json_string(&j, "stamp", r->stamp);
    json_measures(&j, &sum);
    json_open(&j, "targets", '[');
    for (unsigned i = 0; i < r->n_targets; i++) {
        const struct airy_target *t = &r->targets[i];
        json_open(&j, NULL, '{');
        json_place(&j, t);
        json_measures(&j, t);
        json_close(&j, '}');
    }
    json_close(&j, ']');
    json_count(&j, "chunks", r->chunks);
    json_count(&j, "chunks_copied", r->chunks_copied);
    json_number(&j, "exposure", r->exposure);
    json_count(&j, "bytes", r->size);
    json_times(&j, "ms", &r->ms, write_ms);
    json_notes(&j, r);
    json_close(&j, '}');
    json_line(&j);
}

void report_json_plan(const char *input, const struct airy_result *r)
{
    struct json j = { .out = stdout };
    json_open(&j, NULL, '{');
    json_string(&j, "input", input);
    json_open(&j, "targets", '[');
    for (unsigned i = 0; i < r->n_targets; i++) {
        const struct airy_target *t = &r->targets[i];
        json_open(&j, NULL, '{');
        json_place(&j, t);
        json_string(&j, "plan", t->plan);
        json_string(&j, "rule", t->rule);
        json_count(&j, "levels", t->levels);
        json_string(&j, "storage", t->storage);
        json_number(&j, "error_bound", t->error_bound);
        json_number(&j, "predicted_ms", t->predicted_ms);
        json_close(&j, '}');
    }
    json_close(&j, ']');
    json_notes(&j, r);
    json_close(&j, '}');
    json_line(&j);
}

void report_json_error(const struct report_frame *f, const struct airy_error *e, enum cmd_exit exit)
{
    struct json j = { .out = stdout };
    json_frame(&j, f, "failed");
    json_open(&j, "error", '{');
    json_integer(&j, "code", e->code);
    json_string(&j, "symbol", e->symbol);
    json_string(&j, "field", e->field);
    json_string(&j, "text", e->text);
    json_bool(&j, "retryable", e->retryable);
    json_count(&j, "retry_after_ms", e->retry_after_ms);
    json_integer(&j, "exit_status", exit);
    json_close(&j, '}');
    json_close(&j, '}');
    json_line(&j);
}

static void json_users(struct json *j, const struct airy_status *s)
{
    json_open(j, "users", '[');
    for (unsigned i = 0; i < s->n_users; i++) {
        const struct airy_status_user *u = &s->user[i];
        json_open(j, NULL, '{');
        json_count(j, "uid", u->uid);
        json_count(j, "connections", u->connections);
        json_count(j, "requests", u->requests);
        json_count(j, "queued", u->queued);
        json_count(j, "running", u->running);
        json_count(j, "fds", u->fds);
        json_count(j, "bytes", u->bytes);
        json_number(j, "device_ms", u->device_ms);
        json_close(j, '}');
    }
    json_close(j, ']');
}

static void json_memory(struct json *j, const struct airy_status_memory *m)
{
    json_open(j, "memory", '{');
    json_count(j, "ceiling", m->ceiling);
    json_count(j, "reserved", m->reserved);
    json_count(j, "payloads", m->payloads);
    json_count(j, "payloads_max", m->payloads_max);
    json_count(j, "loads", m->loads);
    json_count(j, "loads_max", m->loads_max);
    json_count(j, "work", m->work);
    json_count(j, "work_max", m->work_max);
    json_count(j, "work_peak", m->work_peak);
    json_close(j, '}');
}

void report_json_status_fields(struct json *j, const struct airy_status *s)
{
    json_string(j, "server", s->server);
    json_string(j, "device", s->device);
    json_string(j, "device_kind", s->device_kind);
    json_string(j, "driver", s->driver);
    json_number(j, "uptime_s", s->uptime_s);
    json_count(j, "clients", s->clients);
    json_count(j, "queued", s->queued);
    json_count(j, "running", s->running);
    json_count(j, "done", s->done);
    json_count(j, "failed", s->failed);
    json_count(j, "cancelled", s->cancelled);
    json_count(j, "refused", s->refused_busy);
    json_count(j, "pixels", s->pixels);
    json_count(j, "bytes_in", s->bytes_in);
    json_count(j, "bytes_out", s->bytes_out);
    json_count(j, "rss_bytes", s->rss_bytes);
    json_times(j, "mean_ms", &s->mean_ms, -1);
    json_memory(j, &s->memory);
    json_users(j, s);
    json_count(j, "loop_turns", s->loop_turns);
    json_number(j, "loop_worst_ms", s->loop_worst_ms);
    json_bool(j, "draining", s->draining);
}

void report_json_pass(const struct report_frame *f, enum report_pass pass, const char *stamp)
{
    struct json j = { .out = stdout };
    json_frame(&j, f, pass == REPORT_SKIPPED ? "skipped" : "missing");
    json_string(&j, "stamp", stamp);
    json_close(&j, '}');
    json_line(&j);
}

void report_json_status(const struct airy_status *s)
{
    struct json j = { .out = stdout };
    json_open(&j, NULL, '{');
    report_json_status_fields(&j, s);
    json_close(&j, '}');
    json_line(&j);
}

/* ---- for people --------------------------------------------------------------------------------------
 */

/* "-": no glow, and yet not untouched (a matte, a display transform). */
static bool has_glow(const struct airy_target *t) { return strcmp(t->rule, "-") != 0; }

/* A stated psf; else a look, whose bound is of another size, and which loses no light at borders. */
static bool is_psf(const struct airy_target *t)
{
    return (t->rule[0] == 'R' && t->rule[1] >= '0' && t->rule[1] <= '9') || strcmp(t->rule, "fft") == 0;
}

static void warn_nonfinite(struct progress *p, const struct report_frame *f, const struct airy_target *t)
{
    if (t->any_nonfinite)
        progress_line(p,
                      "%s: %" PRIu64 " NaN, %" PRIu64 " +Inf, %" PRIu64
                      " -Inf samples; the first at %d,%d in %s",
                      f->input, t->nan, t->positive_inf, t->negative_inf, t->first_x, t->first_y,
                      t->first_channel ? t->first_channel : "?");
    if (t->saturated)
        progress_line(p, "%s: %" PRIu64 " samples held at 65504, the largest half", f->output,
                      t->saturated);
}

void report_line(struct progress *p, const struct report_frame *f, const struct airy_result *r)
{
    struct airy_target t = total_of(r);
    if (t.untouched)
        progress_line(p, "%s: no glow, handed on as it was, %.0f ms", f->output, r->ms.total);
    else
        progress_line(p, "%s: %s, %u levels, error <= %.2g, %.0f ms", f->output, t.rule, t.levels,
                      t.error_bound, r->ms.total);
    warn_nonfinite(p, f, &t);
}

void report_pass(struct progress *p, const struct report_frame *f, enum report_pass pass)
{
    if (pass == REPORT_SKIPPED)
        progress_line(p, "%s: is there already, of the same request on the same input (--force does it again)", f->output);
    else
        progress_line(p, "%s: is not there, and left out", f->input);
}

static void target_paragraph(struct progress *p, const struct airy_target *t)
{
    progress_line(p, "  %s  %u x %u at %d,%d", t->name, t->width, t->height, t->min_x, t->min_y);
    if (t->untouched) {
        progress_line(p, "    nothing glows: handed on as it was");
        return;
    }
    progress_line(p, "    plan     %s%s%s", t->plan, *t->storage ? "; stored as " : "", t->storage);
    if (*t->skipped)
        progress_line(p, "    skipped  %s", t->skipped);
    if (has_glow(t) && is_psf(t))
        progress_line(p, "    error    <= %.2g x intensity x %.4g (the brightest that glows), at every pixel of the glow",
                      t->error_bound, t->max_bright);
    else if (has_glow(t))
        progress_line(p, "    error    <= %.2g x the frame's largest value, at every pixel in linear light", t->error_bound);
    if (has_glow(t) && is_psf(t))
        progress_line(p, "    energy   %.4g in, %.4g bright, %.4g bloomed, %.4g lost at the borders",
                      t->energy_input, t->energy_bright, t->energy_bloomed, t->energy_lost);
    else if (has_glow(t))
        progress_line(p, "    energy   %.4g in, %.4g bright, %.4g bloomed", t->energy_input, t->energy_bright,
                      t->energy_bloomed);
    else
        progress_line(p, "    energy   %.4g in", t->energy_input);
    if (t->energy_clamped > 0 || t->energy_suppressed > 0)
        progress_line(p, "             %.4g taken by clamp, %.4g by firefly", t->energy_clamped,
                      t->energy_suppressed);
    if (t->exposure != 0)
        progress_line(p, "    exposure %.4g stops", t->exposure);
    if (t->predicted_ms > 0)
        progress_line(p, "    device   %.1f ms predicted", t->predicted_ms);
    progress_line(p, "    tiles    %u of %u have a highlight", t->tiles_bright, t->tiles);
}

void report_paragraph(struct progress *p, const struct report_frame *f, const struct airy_result *r,
                      double write_ms)
{
    struct airy_target sum = total_of(r);
    progress_line(p, "%s -> %s", f->input, f->output);
    for (unsigned i = 0; i < r->n_targets; i++)
        target_paragraph(p, &r->targets[i]);
    if (r->chunks)
        progress_line(p, "  chunks     %u, %u of them copied as they were", r->chunks, r->chunks_copied);
    progress_line(p,
                  "  time       load %.1f, decode %.1f, bloom %.1f, encode %.1f, write %.1f; %.1f ms in "
                  "the daemon",
                  r->ms.load, r->ms.decode, r->ms.bloom, r->ms.encode, write_ms, r->ms.total);
    progress_line(p, "  device     %s", r->device ? r->device : "?");
    for (unsigned i = 0; i < r->n_notes; i++)
        progress_line(p, "  note       %s", r->notes[i]);
    warn_nonfinite(p, f, &sum);
}

static void plan_target(const struct airy_target *t)
{
    printf("  %s  %u x %u at %d,%d\n", t->name, t->width, t->height, t->min_x, t->min_y);
    printf("    plan     %s\n", t->plan);
    if (*t->rule && has_glow(t))
        printf("    rule     %s, %u levels\n", t->rule, t->levels);
    if (*t->storage)
        printf("    storage  %s between the passes\n", t->storage);
    if (t->error_bound > 0)
        printf("    error    <= %.2g x intensity x the brightest value that glows, at every pixel of the glow\n",
               t->error_bound);
    if (t->exposure != 0)
        printf("    exposure %.4g stops\n", t->exposure);
    if (t->predicted_ms > 0)
        printf("    time     %.1f ms on the device, as predicted\n", t->predicted_ms);
}

void report_plan(const char *input, const struct airy_result *r)
{
    printf("%s\n", input);
    for (unsigned i = 0; i < r->n_targets; i++)
        plan_target(&r->targets[i]);
    printf("  device     %s\n", r->device ? r->device : "?");
    for (unsigned i = 0; i < r->n_notes; i++)
        printf("  note       %s\n", r->notes[i]);
    puts("  skipped    depends on the pixels: airy bloom says it");
}

const char *report_field(const struct airy_error *e)
{
    /* The one parameter whose option has another name. */
    return strcmp(e->field, "params.view") == 0 ? "--show (params.view)" : e->field;
}

void report_error(struct progress *p, const struct report_frame *f, const struct airy_error *e)
{
    /* A local error's text names its path already. */
    if (e->code > 0)
        progress_error(p, "airy: %s: %s%s%s [%s %d]", f->input, report_field(e), *e->field ? ": " : "", e->text,
                       e->symbol, e->code);
    else
        progress_error(p, "airy: %s", e->text);
}
