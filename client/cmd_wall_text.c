// SPDX-License-Identifier: Apache-2.0
// cmd_wall_text.c - see cmd_wall_text.h. A line says first what is wrong, for lines get cut.
#include "cmd_wall_text.h"

#include <inttypes.h>
#include <stdarg.h>
#include <string.h>

enum { NAMED_MAX = 4 }; /* boards with a problem that a line names */

static bool is_ready(const struct airy_wall_board *b) { return strcmp(b->state, "ready") == 0; }

/* Appends; what does not fit is left out. */
__attribute__((format(printf, 3, 4))) static void add(char *out, size_t size, const char *format, ...)
{
    size_t n = strlen(out);
    va_list args;
    va_start(args, format);
    vsnprintf(out + n, size - n, format, args);
    va_end(args);
}

/* Nothing of a name reaches the terminal as a command. */
static void make_plain(char *s)
{
    for (; *s; s++)
        if ((unsigned char)*s < ' ' || *s == 0x7f)
            *s = '?';
}

struct plain { char text[200]; };

static struct plain plain(const char *s)
{
    struct plain p;
    snprintf(p.text, sizeof(p.text), "%s", s);
    make_plain(p.text);
    return p;
}

bool wall_text_boards(char *out, size_t size, const struct airy_wall_state *w)
{
    unsigned ready = 0, named = 0;
    for (unsigned i = 0; i < w->n_boards; i++)
        ready += is_ready(&w->boards[i]);
    snprintf(out, size, "%u/%u boards ready", ready, w->n_boards);
    for (unsigned i = 0; i < w->n_boards; i++) {
        const struct airy_wall_board *b = &w->boards[i];
        if (is_ready(b))
            continue;
        if (named == NAMED_MAX) {
            add(out, size, ", and %u more", w->n_boards - ready - named);
            break;
        }
        add(out, size, "%s %s %s", named++ ? "," : ";", b->name, b->state);
        if (*b->problem)
            add(out, size, " (%s)", b->problem);
    }
    make_plain(out);
    return ready < w->n_boards;
}

void wall_amps(const struct airy_wall_state *w, double *amps, double *wanted)
{
    *amps = *wanted = 0;
    for (unsigned i = 0; i < w->n_boards; i++) {
        *amps += w->boards[i].amps;
        *wanted += w->boards[i].amps_wanted;
    }
}

/* "12.3 A", "12.3 A of 15.0 (limited)"; nothing when the definition states no currents. */
static void add_amps(char *out, size_t size, double amps, double wanted)
{
    if (wanted > amps * 1.001 + 1e-9)
        add(out, size, "%.1f A of %.1f (limited)", amps, wanted);
    else
        add(out, size, "%.1f A", amps);
}

void wall_text_line(char *out, size_t size, unsigned columns, const struct airy_wall_state *w, const struct wall_played *played)
{
    char boards[400];
    double amps, wanted;
    bool trouble = wall_text_boards(boards, sizeof(boards), w);
    snprintf(out, size, "%s %s  %.1f fps, %.1f new", w->name, w->source, w->fps, w->frames_per_second);
    if (trouble)
        add(out, size, "  %s", boards);
    if (played) {
        add(out, size, "  skipped %" PRIu64, played->skipped);
        if (played->failed)
            add(out, size, "  failed %" PRIu64, played->failed);
    }
    add(out, size, "  dropped %" PRIu64 "  late p99 %.2f max %.2f ms", w->dropped, w->late_ms.p99, w->late_ms.max);
    if (!trouble)
        add(out, size, "  %s", boards);
    wall_amps(w, &amps, &wanted);
    if (wanted > 0) {
        add(out, size, "  ");
        add_amps(out, size, amps, wanted);
    }
    if (columns < size)
        out[columns] = '\0';
    make_plain(out);
}

static void board_line(FILE *out, const struct airy_wall_board *b)
{
    char amps[64] = "";
    if (b->amps_wanted > 0) {
        add(amps, sizeof(amps), ", ");
        add_amps(amps, sizeof(amps), b->amps, b->amps_wanted);
    }
    fprintf(out, "  %-16s %-8s sent %" PRIu64 ", dropped %" PRIu64 ", missed %" PRIu64 ", latency p50 %.2f p99 %.2f max %.2f ms%s\n",
            plain(b->name).text, plain(b->state).text, b->sent, b->dropped, b->missed, b->latency_ms.p50, b->latency_ms.p99,
            b->latency_ms.max, amps);
    if (b->stalls || b->timeouts || b->errors || b->losses)
        fprintf(out, "  %-16s          %" PRIu64 " stalls, %" PRIu64 " time-outs, %" PRIu64 " errors, went away %" PRIu64 " times\n", "",
                b->stalls, b->timeouts, b->errors, b->losses);
    if (b->received)
        fprintf(out, "  %-16s          the board itself: %" PRIu64 " received, %" PRIu64 " rendered\n", "", b->received, b->rendered);
    if (*b->problem)
        fprintf(out, "  %-16s          %s\n", "", plain(b->problem).text);
}

void wall_text_stats(FILE *out, const struct airy_wall_state *w)
{
    char line[64];
    fprintf(out, "%s  %ux%u, %u LEDs, %s, exposure %.2f%s\n", plain(w->name).text, w->width, w->height, w->leds,
            plain(w->source).text, w->exposure, w->realtime ? "" : ", no real-time priority (it may stutter on a busy machine)");
    fprintf(out, "  %.1f of %.4g ticks a second, %.1f new pictures; late p50 %.2f p99 %.2f max %.2f ms; skew p99 %.2f max %.2f ms\n",
            w->fps, w->rate, w->frames_per_second, w->late_ms.p50, w->late_ms.p99, w->late_ms.max, w->skew_ms.p99, w->skew_ms.max);
    fprintf(out, "  %" PRIu64 " pictures, %" PRIu64 " shown, %" PRIu64 " dropped; %" PRIu64 " ticks, %" PRIu64 " missed\n", w->frames,
            w->shown, w->dropped, w->ticks, w->ticks_missed);
    for (unsigned i = 0; i < w->n_boards; i++)
        board_line(out, &w->boards[i]);
    for (unsigned i = 0; i < w->n_supplies; i++) {
        const struct airy_wall_supply *s = &w->supplies[i];
        line[0] = '\0';
        add_amps(line, sizeof(line), s->amps, s->amps_wanted);
        fprintf(out, "  supply %-9s %s", plain(s->name).text, line);
        if (s->amps_limit > 0)
            fprintf(out, ", limit %.1f A", s->amps_limit);
        fputc('\n', out);
    }
}

/* ---- lists ------------------------------------------------------------------------------------------- */

static const char access_hint[] =
    "  A board that cannot be opened: systemd/60-airy-wall.rules of airyd, in /etc/udev/rules.d, gives the group airy-wall the\n"
    "  controllers; the daemon's user must be in it. Then udevadm control --reload, and plug the board in again.\n";

static void list_controllers(FILE *out, const struct airy_wall_reply *r)
{
    bool trouble = false;
    for (unsigned i = 0; i < r->n_controllers; i++) {
        const struct airy_controller *c = &r->controllers[i];
        fprintf(out, "  %-10s %-20s at %-8s ", plain(c->kind).text, *c->serial ? plain(c->serial).text : "(no serial)",
                plain(c->path).text);
        if (*c->problem)
            fprintf(out, "%s\n", plain(c->problem).text);
        else if (*c->wall)
            fprintf(out, "wall %s\n", plain(c->wall).text);
        else
            fprintf(out, "free\n");
        trouble = trouble || *c->problem;
    }
    if (trouble)
        fputs(access_hint, out);
}

void wall_text_list(FILE *out, const struct airy_wall_reply *r)
{
    char boards[400];
    fprintf(out, "controllers: %s\n", r->n_controllers ? "" : "none");
    if (*r->usb)
        fprintf(out,
                "  There is no USB: %s.\n"
                "  The daemon needs /dev/bus/usb (a container: --device /dev/bus/usb; a unit: DeviceAllow=char-usb_device rw).\n",
                plain(r->usb).text);
    else if (!r->n_controllers)
        fputs("  No Fadecandy (1d50:607a) or GUD display (1d50:614d, 16d0:10a9) is plugged in, or none is seen here.\n"
              "  Is it powered, and does lsusb show it?\n",
              out);
    list_controllers(out, r);
    fprintf(out, "walls: %s\n", r->n_walls ? "" : "none is open; airy wall open FILE --keep opens one");
    for (unsigned i = 0; i < r->n_walls; i++) {
        const struct airy_wall_state *w = &r->walls[i];
        wall_text_boards(boards, sizeof(boards), w);
        fprintf(out, "  %-10s %ux%u, %u LEDs at %.4g fps, %s; %s\n", plain(w->name).text, w->width, w->height, w->leds, w->rate,
                plain(w->source).text, boards);
    }
}

/* ---- JSON -------------------------------------------------------------------------------------------- */

static void json_percentiles(struct json *j, const char *key, const struct airy_percentiles *p)
{
    json_open(j, key, '{');
    json_number(j, "p50", p->p50);
    json_number(j, "p99", p->p99);
    json_number(j, "max", p->max);
    json_close(j, '}');
}

static void json_board(struct json *j, const struct airy_wall_board *b)
{
    json_open(j, NULL, '{');
    json_string(j, "name", b->name);
    json_string(j, "kind", b->kind);
    json_string(j, "serial", b->serial);
    json_string(j, "state", b->state);
    json_string(j, "problem", b->problem);
    json_string(j, "path", b->path);
    json_count(j, "sent", b->sent);
    json_count(j, "dropped", b->dropped);
    json_count(j, "missed", b->missed);
    json_count(j, "stalls", b->stalls);
    json_count(j, "timeouts", b->timeouts);
    json_count(j, "errors", b->errors);
    json_count(j, "losses", b->losses);
    json_count(j, "rendered", b->rendered);
    json_count(j, "received", b->received);
    json_percentiles(j, "latency_ms", &b->latency_ms);
    json_number(j, "amps", b->amps);
    json_number(j, "amps_wanted", b->amps_wanted);
    json_close(j, '}');
}

static void json_lists(struct json *j, const struct airy_wall_state *w)
{
    json_open(j, "boards", '[');
    for (unsigned i = 0; i < w->n_boards; i++)
        json_board(j, &w->boards[i]);
    json_close(j, ']');
    json_open(j, "supplies", '[');
    for (unsigned i = 0; i < w->n_supplies; i++) {
        const struct airy_wall_supply *s = &w->supplies[i];
        json_open(j, NULL, '{');
        json_string(j, "name", s->name);
        json_number(j, "amps", s->amps);
        json_number(j, "amps_wanted", s->amps_wanted);
        json_number(j, "amps_limit", s->amps_limit);
        json_close(j, '}');
    }
    json_close(j, ']');
}

void wall_json_state(struct json *j, const char *key, const struct airy_wall_state *w)
{
    double amps, wanted;
    wall_amps(w, &amps, &wanted);
    json_open(j, key, '{');
    json_string(j, "name", w->name);
    json_count(j, "width", w->width);
    json_count(j, "height", w->height);
    json_count(j, "leds", w->leds);
    json_number(j, "rate", w->rate);
    json_string(j, "source", w->source);
    json_number(j, "fps", w->fps);
    json_number(j, "frames_per_second", w->frames_per_second);
    json_count(j, "ticks", w->ticks);
    json_count(j, "ticks_missed", w->ticks_missed);
    json_percentiles(j, "late_ms", &w->late_ms);
    json_percentiles(j, "skew_ms", &w->skew_ms);
    json_count(j, "frames", w->frames);
    json_count(j, "shown", w->shown);
    json_count(j, "dropped", w->dropped);
    json_number(j, "exposure", w->exposure);
    json_bool(j, "realtime", w->realtime);
    json_number(j, "amps", amps);
    json_number(j, "amps_wanted", wanted);
    json_lists(j, w);
    json_close(j, '}');
}

void wall_json_list(struct json *j, const struct airy_wall_reply *r)
{
    json_open(j, NULL, '{');
    if (*r->usb)
        json_string(j, "usb_problem", r->usb);
    else
        json_null(j, "usb_problem");
    json_open(j, "controllers", '[');
    for (unsigned i = 0; i < r->n_controllers; i++) {
        const struct airy_controller *c = &r->controllers[i];
        json_open(j, NULL, '{');
        json_string(j, "kind", c->kind);
        json_string(j, "serial", c->serial);
        json_string(j, "path", c->path);
        json_string(j, "wall", c->wall);
        json_string(j, "problem", c->problem);
        json_close(j, '}');
    }
    json_close(j, ']');
    json_open(j, "walls", '[');
    for (unsigned i = 0; i < r->n_walls; i++)
        wall_json_state(j, NULL, &r->walls[i]);
    json_close(j, ']');
    json_close(j, '}');
}

/* ---- half blocks ------------------------------------------------------------------------------------- */

/* The mean of the pixels that block (x, y) of w x h covers, at least one of them. */
static uint32_t block(const uint8_t *rgb, uint32_t width, uint32_t height, uint32_t x, uint32_t y, uint32_t w, uint32_t h)
{
    uint32_t x0 = (uint32_t)((uint64_t)x * width / w), x1 = (uint32_t)((uint64_t)(x + 1) * width / w);
    uint32_t y0 = (uint32_t)((uint64_t)y * height / h), y1 = (uint32_t)((uint64_t)(y + 1) * height / h);
    uint64_t sum[3] = { 0 }, n = (uint64_t)(x1 - x0) * (y1 - y0);
    for (uint32_t j = y0; j < y1; j++)
        for (uint32_t i = x0; i < x1; i++)
            for (unsigned c = 0; c < 3; c++)
                sum[c] += rgb[3 * ((size_t)j * width + i) + c];
    return (uint32_t)((sum[0] + n / 2) / n << 16 | (sum[1] + n / 2) / n << 8 | (sum[2] + n / 2) / n);
}

static void colour(FILE *out, int where, uint32_t c)
{
    fprintf(out, "\033[%d;2;%u;%u;%um", where, c >> 16, c >> 8 & 255, c & 255);
}

void wall_text_blocks(FILE *out, const uint8_t *rgb, uint32_t width, uint32_t height, unsigned columns, unsigned rows)
{
    uint32_t w = width, h = height;
    if (!columns || !rows)
        return;
    if (w > columns) { /* smaller, of the same shape */
        h = (uint32_t)((uint64_t)h * columns / w);
        w = columns;
    }
    if (h > 2 * rows) {
        w = (uint32_t)((uint64_t)w * 2 * rows / h);
        h = 2 * rows;
    }
    w = w ? w : 1;
    h = h ? h : 1;
    for (uint32_t y = 0; y < h; y += 2) {
        uint32_t top = UINT32_MAX, bottom = UINT32_MAX; /* in force */
        for (uint32_t x = 0; x < w; x++) {
            uint32_t t = block(rgb, width, height, x, y, w, h);
            uint32_t b = y + 1 < h ? block(rgb, width, height, x, y + 1, w, h) : 0;
            if (t != top)
                colour(out, 38, t);
            if (b != bottom)
                colour(out, 48, b);
            top = t;
            bottom = b;
            fputs("\xe2\x96\x80", out); /* U+2580, the upper half */
        }
        fputs("\033[0m\r\n", out);
    }
}
