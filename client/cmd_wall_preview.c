// SPDX-License-Identifier: Apache-2.0
// cmd_wall_preview.c - airy wall preview: what was sent to the LEDs last, as a PNG, or again and again in the terminal.
#include <stdio.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "cmd_wall_asked.h"
#include "cmd_wall_commands.h"
#include "cmd_wall_stop.h"
#include "cmd_wall_text.h"
#include "cmd_wall_use.h"
#include "wall_draw.h"

enum { LIVE_PERIOD_NS = 50000000 };

/* The other screen, without a cursor; and back. */
static const char enter[] = "\033[?1049h\033[?25l\033[2J", leave[] = "\033[0m\033[?25h\033[?1049l";

static const struct wall_syntax syntax = {
    .name = "wall preview",
    .help = "airy wall preview FILE|NAME -o OUT.png [--cell N]\n"
            "airy wall preview FILE|NAME --live\n"
            "\n"
            "Exactly what was sent to the LEDs last, undone: bytes, mapping, dither and limits back to the wall's pixels. It\n"
            "shows something only while frames or a pattern are on the wall. --live needs a terminal with 24-bit colours.\n"
            "\n"
            "    airy wall preview lobby --live\n"
            "    airy wall preview lobby -o lobby.png --cell 8\n",
    .expected = "FILE|NAME",
    .operands_min = 1,
    .operands_max = 1,
    .options = 1 << WALL_OPTION_OUTPUT | 1 << WALL_OPTION_CELL | 1 << WALL_OPTION_LIVE | 1 << WALL_OPTION_DEVICE,
};

static struct airy_wall_reply *preview(struct wall_use *u, struct airy_error *e)
{
    return wall_ask(u->session.airy, &(struct airy_wall_request){ .action = AIRY_WALL_PREVIEW, .name = u->name }, e);
}

static enum cmd_exit to_file(struct wall_use *u, const struct wall_asked *a)
{
    struct airy_error e;
    struct fault f = { .text = "" };
    struct wall_picture picture = { 0 };
    struct airy_wall_reply *r = preview(u, &e);
    if (!r)
        return wall_complain(syntax.name, &e);
    const struct airy_wall_state *w = &r->walls[0];
    enum cmd_exit exit = CMD_DONE;
    if (wall_draw_pixels(&picture, w->width, w->height, r->preview, a->cell, &f) < 0 ||
        wall_picture_write_png(&picture, a->output, &f) < 0) {
        cmd_complain("%s: %s: %s", syntax.name, a->output, f.text);
        exit = CMD_OUTPUT;
    }
    wall_picture_free(&picture);
    airy_wall_reply_free(r);
    return exit;
}

static void draw(const struct airy_wall_reply *r)
{
    struct winsize size;
    char line[512];
    unsigned columns = 80, rows = 24;
    if (ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col && size.ws_row) {
        columns = size.ws_col;
        rows = size.ws_row;
    }
    const struct airy_wall_state *w = &r->walls[0];
    wall_text_line(line, sizeof(line), columns - 1, w, NULL);
    fputs("\033[H", stdout);
    wall_text_blocks(stdout, r->preview, w->width, w->height, columns, rows - 1);
    printf("\033[J%s", line);
    fflush(stdout);
}

static enum cmd_exit live(struct wall_use *u)
{
    static char buffer[1 << 16];
    struct airy_error e;
    bool lost = false;
    setvbuf(stdout, buffer, _IOFBF, sizeof(buffer)); /* a picture in one piece */
    fputs(enter, stdout);
    stop_restore(leave);
    while (!lost && !stop_asked() && !ferror(stdout)) {
        uint64_t next_ns = stop_now_ns() + LIVE_PERIOD_NS;
        struct airy_wall_reply *r = preview(u, &e);
        lost = !r;
        if (r)
            draw(r);
        airy_wall_reply_free(r);
        if (!lost)
            stop_wait(-1, 0, next_ns);
    }
    fputs(leave, stdout);
    fflush(stdout);
    stop_restore(NULL);
    return lost ? wall_complain(syntax.name, &e) : CMD_DONE;
}

int cmd_wall_preview(int argc, char **argv)
{
    static struct wall_asked a = WALL_ASKED_INIT;
    struct wall_use u;
    int rc = wall_asked_read(&a, &syntax, argc, argv);
    if (rc)
        return rc > 0 ? CMD_DONE : CMD_USAGE;
    if (!a.output == !a.live) {
        cmd_complain("%s: either -o OUT.png or --live expected", syntax.name);
        return CMD_USAGE;
    }
    if (a.live && !isatty(STDOUT_FILENO)) {
        cmd_complain("%s: --live needs a terminal; -o OUT.png writes a picture", syntax.name);
        return CMD_USAGE;
    }
    stop_install();
    enum cmd_exit exit = wall_use_open(&u, a.operand[0], &a.session, syntax.name);
    if (exit != CMD_DONE)
        return exit;
    if (u.ours)
        cmd_complain("%s: wall \"%s\" was not open, so nothing is on it yet: expect black", syntax.name, u.name);
    exit = a.live ? live(&u) : to_file(&u, &a);
    wall_use_close(&u);
    return exit;
}
