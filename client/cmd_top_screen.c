// SPDX-License-Identifier: Apache-2.0
// cmd_top_screen.c - see cmd_top_screen.h. Signals that only concern the screen come by a descriptor, so that none is missed between a look
// and a wait, and none interrupts a write.
#include "cmd_top_screen.h"

#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/ioctl.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include "cmd_wall_stop.h"

#define ENTER "\033[?1049h\033[?25l\033[2J"
#define LEAVE "\033[?25h\033[?1049l"

enum { SIDE_MAX = 1000, REDRAW_KEY = 'L' - '@' };

bool screen_there(void)
{
    const char *term = getenv("TERM");
    return isatty(STDOUT_FILENO) && term && *term && strcmp(term, "dumb") != 0;
}

// ---- there and back --------------------------------------------------------------------------------

static void enter(const struct screen *s)
{
    if (s->keys)
        tcsetattr(STDIN_FILENO, TCSANOW, &s->raw);
    stop_restore(LEAVE);
    stop_restore_terminal(s->keys ? &s->before : NULL);
    fputs(ENTER, stdout);
    fflush(stdout);
}

static void leave(const struct screen *s)
{
    fputs(LEAVE, stdout);
    fflush(stdout);
    if (s->keys)
        tcsetattr(STDIN_FILENO, TCSANOW, &s->before);
    stop_restore(NULL);
    stop_restore_terminal(NULL);
}

static void signals_of(sigset_t *set)
{
    sigemptyset(set);
    sigaddset(set, SIGWINCH);
    sigaddset(set, SIGTSTP);
    sigaddset(set, SIGCONT);
}

static int watch(const struct screen *s, int fd)
{
    struct epoll_event e = { .events = EPOLLIN };
    return epoll_ctl(s->events_fd, EPOLL_CTL_ADD, fd, &e) < 0 ? -errno : 0;
}

int screen_open(struct screen *s)
{
    sigset_t set;
    int rc;
    *s = (struct screen){ .signals_fd = -1, .events_fd = -1 };
    s->keys = isatty(STDIN_FILENO) && tcgetattr(STDIN_FILENO, &s->before) == 0;
    s->raw = s->before;
    s->raw.c_lflag &= ~(tcflag_t)(ICANON | ECHO);
    s->raw.c_cc[VMIN] = 1;
    s->raw.c_cc[VTIME] = 0;
    s->raw.c_cc[VQUIT] = _POSIX_VDISABLE; // its end would leave the terminal as it is
    signals_of(&set);
    s->events_fd = epoll_create1(EPOLL_CLOEXEC);
    s->signals_fd = signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK);
    rc = s->events_fd < 0 || s->signals_fd < 0 ? -errno : watch(s, s->signals_fd);
    if (!rc && s->keys)
        rc = watch(s, STDIN_FILENO);
    if (rc < 0)
        goto fail;
    sigprocmask(SIG_BLOCK, &set, NULL);
    enter(s);
    return 0;
fail:
    if (s->events_fd >= 0)
        close(s->events_fd);
    if (s->signals_fd >= 0)
        close(s->signals_fd);
    return rc;
}

void screen_close(struct screen *s)
{
    sigset_t set;
    leave(s);
    signals_of(&set);
    close(s->events_fd);
    close(s->signals_fd);
    sigprocmask(SIG_UNBLOCK, &set, NULL);
}

// ---- drawing -----------------------------------------------------------------------------------------

void screen_size(unsigned *columns, unsigned *rows)
{
    struct winsize w = { 0 };
    ioctl(STDOUT_FILENO, TIOCGWINSZ, &w);
    *columns = w.ws_col ? w.ws_col : 80;
    *rows = w.ws_row ? w.ws_row : 24;
    *columns = *columns > SIDE_MAX ? SIDE_MAX : *columns;
    *rows = *rows > SIDE_MAX ? SIDE_MAX : *rows;
}

// Bytes of the letter in UTF-8 that begins here, 0: none that may be shown (a control character, C1 ones included, or no UTF-8).
static unsigned letter(const unsigned char *s)
{
    const unsigned n = s[0] < 0x80 ? 1 : s[0] >= 0xc2 && s[0] < 0xe0 ? 2 : (s[0] & 0xf0) == 0xe0 ? 3 : s[0] >= 0xf0 && s[0] < 0xf5 ? 4 : 0;
    if (n < 2)
        return n && s[0] >= 0x20 && s[0] != 0x7f;
    for (unsigned i = 1; i < n; i++)
        if ((s[i] & 0xc0) != 0x80)
            return 0;
    return s[0] == 0xc2 && s[1] < 0xa0 ? 0 : n;
}

unsigned screen_put_line(FILE *out, const char *line, unsigned columns)
{
    unsigned taken = 0;
    for (const unsigned char *s = (const unsigned char *)line; *s && *s != '\n' && (!columns || taken < columns); taken++) {
        const unsigned n = letter(s);
        if (n)
            fwrite(s, 1, n, out);
        else
            putc('?', out);
        s += n + !n;
    }
    return taken;
}

static unsigned lines_of(const char *text)
{
    unsigned n = 0;
    for (; *text; n++) {
        text += strcspn(text, "\n");
        text += *text == '\n';
    }
    return n;
}

// A full line ends where the terminal would wrap: erasing from there would take its last letter.
static void draw_line(FILE *out, unsigned row, const char *line, unsigned columns)
{
    fprintf(out, "\033[%u;1H", row);
    if (screen_put_line(out, line, columns) < columns)
        fputs("\033[K", out);
}

static void draw(FILE *out, const char *text)
{
    unsigned columns, rows;
    screen_size(&columns, &rows);
    const unsigned lines = lines_of(text), shown = lines > rows ? rows - 1 : lines;
    for (unsigned row = 1; row <= shown; row++) {
        draw_line(out, row, text, columns);
        text += strcspn(text, "\n");
        text += *text == '\n';
    }
    if (shown < lines) {
        char more[32];
        snprintf(more, sizeof(more), "... %u more lines", lines - shown);
        draw_line(out, rows, more, columns);
    } else if (shown < rows) {
        fprintf(out, "\033[%u;1H\033[J", shown + 1);
    }
}

void screen_draw(const char *text)
{
    char *all = NULL;
    size_t bytes = 0;
    FILE *out = open_memstream(&all, &bytes); // in one write, or it flickers
    if (!out)
        return;
    draw(out, text);
    if (fclose(out) == 0)
        fwrite(all, 1, bytes, stdout);
    free(all);
    fflush(stdout);
}

// ---- what happens ------------------------------------------------------------------------------------

// What a key means; those of arrows and the like are whole sequences, whose letters are none.
static enum screen_event key_event(const char *keys, size_t n)
{
    enum screen_event event = SCREEN_TIME;
    for (size_t i = 0; i < n; i++) {
        if (keys[i] == 'q' || keys[i] == 'Q')
            return SCREEN_QUIT;
        if (keys[i] == REDRAW_KEY)
            event = SCREEN_DRAW;
        if (keys[i] != '\033' || i + 1 >= n)
            continue;
        i++;
        if (keys[i] == 'O')
            i++;
        else if (keys[i] == '[')
            while (++i < n && (keys[i] < '@' || keys[i] > '~'))
                ;
    }
    return event;
}

static enum screen_event take_keys(struct screen *s)
{
    char keys[64];
    struct pollfd p = { .fd = STDIN_FILENO, .events = POLLIN };
    if (!s->keys || poll(&p, 1, 0) <= 0)
        return SCREEN_TIME;
    const ssize_t n = read(STDIN_FILENO, keys, sizeof(keys));
    if (n < 0 && (errno == EINTR || errno == EAGAIN))
        return SCREEN_TIME;
    return n <= 0 ? SCREEN_QUIT : key_event(keys, (size_t)n);
}

static enum screen_event take_signals(struct screen *s)
{
    struct signalfd_siginfo i;
    bool stop = false, again = false, any = false;
    while (read(s->signals_fd, &i, sizeof(i)) == sizeof(i)) {
        any = true;
        stop |= i.ssi_signo == SIGTSTP;
        again |= i.ssi_signo == SIGCONT;
    }
    if (stop) {
        leave(s);
        raise(SIGSTOP);
    }
    if (stop || again) // who stopped us may have changed the terminal
        enter(s);
    return any ? SCREEN_DRAW : SCREEN_TIME;
}

enum screen_event screen_wait(struct screen *s, uint64_t until_ns)
{
    while (!stop_asked() && stop_now_ns() < until_ns) {
        stop_wait(s->events_fd, POLLIN, until_ns);
        const enum screen_event key = take_keys(s), signal = take_signals(s);
        if (key == SCREEN_QUIT)
            return key;
        if (key == SCREEN_DRAW || signal == SCREEN_DRAW)
            return SCREEN_DRAW;
    }
    return SCREEN_TIME;
}
