# SPDX-License-Identifier: Apache-2.0
"""top_terminal.py - airy top on a terminal: a pty, and a screen that understands what a terminal does and refuses the rest. Run by
test_top.sh, with a daemon at SOCKET under load; the daemon's number is in the file PID, and it is started again when that dies.

    top_terminal.py AIRY SOCKET PID

Prints TAP. What is waited for may take a minute, no time is asserted."""
import codecs
import fcntl
import os
import pty
import re
import select
import signal
import struct
import sys
import termios
import time

AIRY, SOCKET, PID = sys.argv[1:4]
PATIENCE_S = 60
count = failures = 0


class Screen:
    """Two screens of cells, a cursor, and modes. A byte that would scroll, wrap or is no known sequence is an error."""

    def __init__(self, columns, rows):
        self.other, self.cursor, self.colours, self.wrong, self.draws = False, True, 0, [], 0
        self.rest, self.decode = "", codecs.getincrementaldecoder("utf-8")("strict").decode
        self.resize(columns, rows)

    def resize(self, columns, rows):
        self.columns, self.rows = columns, rows
        self.clear()

    def clear(self):
        self.cells = [[" "] * self.columns for _ in range(self.rows)]
        self.x = self.y = 0

    def text(self):
        return "\n".join("".join(row).rstrip() for row in self.cells)

    def sequence(self, body, letter):
        numbers = [int(n or 0) for n in body.lstrip("?").split(";")] if body.lstrip("?") else []
        if body == "?1049" and letter in "hl":
            self.other = letter == "h"
            self.clear()
        elif body == "?25" and letter in "hl":
            self.cursor = letter == "h"
        elif letter == "H":
            self.y, self.x = (numbers + [1, 1])[0] - 1 if numbers else 0, (numbers + [1, 1])[1] - 1 if len(numbers) > 1 else 0
            self.draws += self.y == 0
            if not (0 <= self.x < self.columns and 0 <= self.y < self.rows):
                self.wrong.append(f"the cursor goes to {self.x}, {self.y}")
                self.x, self.y = min(self.x, self.columns - 1), min(self.y, self.rows - 1)
        elif letter == "J" and body in ("", "0", "2"):
            for y in range(0 if body == "2" else self.y, self.rows):
                self.cells[y] = [" "] * self.columns
        elif letter == "K" and body == "":
            self.cells[self.y][self.x:] = [" "] * (self.columns - self.x)
        elif letter == "m":
            self.colours += 1
        else:
            self.wrong.append(f"ESC[{body}{letter}")

    def put(self, c):
        if c == "\r":
            self.x = 0
        elif c == "\n":
            self.y += 1
            if self.y >= self.rows and self.other:
                self.wrong.append("it scrolls")
            self.y = min(self.y, self.rows - 1)
        elif ord(c) < 32 or 127 <= ord(c) < 160:
            self.wrong.append(f"control character {ord(c)}")
        elif self.x >= self.columns or self.y >= self.rows:
            if self.other:
                self.wrong.append("it wraps")
        else:
            self.cells[self.y][self.x] = c
            self.x += 1

    def feed(self, data):
        text = self.rest + self.decode(data)
        self.rest = ""
        while text:
            m = re.match(r"\x1b\[([?0-9;]*)([A-Za-z])", text)
            if m:
                self.sequence(*m.groups())
                text = text[m.end():]
            elif text[0] == "\x1b":
                if len(text) > 16:
                    self.wrong.append(f"{text[:8]!r}")
                    text = text[1:]
                    continue
                self.rest = text
                return
            else:
                self.put(text[0])
                text = text[1:]


class Top:
    """airy top in a pty of its own; keeps the far end, so that it can be asked after the end."""

    def __init__(self, columns=100, rows=40, options=(), **environment):
        self.screen = Screen(columns, rows)
        self.master, self.slave = pty.openpty()
        self.size(columns, rows)
        self.modes = termios.tcgetattr(self.slave)
        self.status = None
        self.pid = os.fork()
        if self.pid == 0:
            os.setsid()
            fcntl.ioctl(self.slave, termios.TIOCSCTTY, 0)
            for fd in range(3):
                os.dup2(self.slave, fd)
            os.closerange(3, 64)
            for name in ("TERM", "NO_COLOR", "COLUMNS", "LINES"):
                os.environ.pop(name, None)
            os.environ.update({"TERM": "xterm-256color", **environment})
            os.execv(AIRY, [AIRY, "top", "--socket", SOCKET, *options])

    def size(self, columns, rows):
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def resize(self, columns, rows):
        # What was drawn before the signal came was for the old size: judged is what comes after a whole picture of the new one.
        self.size(columns, rows)
        self.screen.resize(columns, rows)
        self.draws_more(2)
        self.screen.wrong.clear()
        self.screen.clear()
        self.draws_more(1)

    def draws_more(self, times):
        before = self.screen.draws
        self.press(b"\x0c" * times)
        self.wait(f"draws {times} more times", lambda: self.screen.draws >= before + times)

    def pump(self, seconds):
        end = time.monotonic() + seconds
        while select.select([self.master], [], [], max(0, end - time.monotonic()))[0]:
            self.screen.feed(os.read(self.master, 65536))
            if time.monotonic() >= end:
                return

    def wait(self, what, reached):
        end = time.monotonic() + PATIENCE_S
        while not reached():
            if time.monotonic() > end:
                raise AssertionError(f"{what}: not in {PATIENCE_S} s; the screen:\n{self.screen.text()}")
            self.pump(0.05)

    def shows(self, text):
        self.wait(f"shows {text!r}", lambda: text in self.screen.text())

    def press(self, keys):
        os.write(self.master, keys)

    def ended(self):
        if self.status is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.status = os.waitstatus_to_exitcode(status) if pid else None
        return self.status is not None

    def check_end(self, status):
        self.wait("ends", self.ended)
        self.pump(0.2)
        expect(self.status == status, f"exit status {self.status}, wanted {status}")
        self.check_left()

    def check_left(self):
        s = self.screen
        expect(not s.other and s.cursor, f"left: other screen {s.other}, cursor {s.cursor}")
        expect(termios.tcgetattr(self.slave) == self.modes, "the terminal's modes are not as they were")
        expect(not s.wrong, f"wrong on the screen: {s.wrong[:3]}")

    def close(self):
        if not self.ended():
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
        os.close(self.master)
        os.close(self.slave)


def expect(condition, otherwise):
    if not condition:
        raise AssertionError(otherwise)


def draws_at_once_and_again(top):
    top.shows("resident")
    top.shows("half are within")
    expect(top.screen.other and not top.screen.cursor, "not on the other screen, or with a cursor")
    expect(not termios.tcgetattr(top.slave)[3] & (termios.ECHO | termios.ICANON), "keys are echoed, or wait for a line")
    before = top.screen.draws
    top.wait("draws again", lambda: top.screen.draws > before + 1)
    # Real load: the frames that are done become more.
    done = lambda: int((re.search(r"(\d+) done", top.screen.text()) or [0, "0"])[1])
    first = done()
    top.wait("frames are counted", lambda: done() > first)
    top.press(b"x\x1b[A\x1bOq")  # means nothing
    top.draws_more(1)
    expect(not top.ended(), "another key ends it")
    top.press(b"q")
    top.check_end(0)


def resized(top):
    top.shows("99 % are within")
    top.resize(40, 10)
    top.shows("more lines")
    text = top.screen.text()
    expect("clients" in text and "done" in text and "work" in text, f"40x10 leaves out what matters:\n{text}")
    top.resize(140, 50)
    top.wait("all of it", lambda: "99 % are within" in top.screen.text() and "more lines" not in top.screen.text())
    top.resize(1, 1)
    top.press(b"Q")
    top.check_end(0)


def control_c(top):
    top.shows("resident")
    top.press(b"\x03")
    top.check_end(0)


def killed_by(number):
    def run(top):
        top.shows("resident")
        os.kill(top.pid, number)
        top.check_end(0)
    return run


def at_once(top):
    """Twice, while the daemon does not answer: ends though it is asked and waits."""
    top.shows("resident")
    daemon = int(open(PID).read())
    os.kill(daemon, signal.SIGSTOP)
    try:
        top.pump(2.5)  # it asks once a second: now it waits for an answer
        os.kill(top.pid, signal.SIGINT)
        top.pump(0.3)
        if not top.ended():
            os.kill(top.pid, signal.SIGINT)
        top.wait("ends", top.ended)
        top.pump(0.2)
        top.check_left()
    finally:
        os.kill(daemon, signal.SIGCONT)


def stopped_and_on(top):
    top.shows("resident")
    top.press(b"\x1a")
    top.wait("stops", lambda: open(f"/proc/{top.pid}/stat").read().split(") ")[1][0] == "T")
    top.pump(0.2)
    top.check_left()
    os.kill(top.pid, signal.SIGCONT)
    top.wait("is back", lambda: top.screen.other and "resident" in top.screen.text())
    expect(not top.screen.cursor and not termios.tcgetattr(top.slave)[3] & termios.ECHO, "back, but not as before")
    top.press(b"q")
    top.check_end(0)


def gone_and_back(top):
    top.shows("resident")
    before = int(open(PID).read())
    os.kill(before, signal.SIGKILL)
    top.shows("it is asked again every second")
    expect(top.screen.other, "the screen is left")
    top.shows("resident")
    expect("it is asked again" not in top.screen.text(), "what it said before stays")
    expect(int(open(PID).read()) != before, "the same daemon")
    top.press(b"q")
    top.check_end(0)


def no_colour(top):
    top.shows("resident")
    top.press(b"q")
    top.check_end(0)
    expect(top.screen.colours == 0, "colours in spite of NO_COLOR")


def dumb(top):
    top.wait("lines", lambda: top.screen.text().count("done (") >= 1)
    top.pump(1.5)
    expect(not top.screen.other and top.screen.draws == 0 and top.screen.cursor, "sequences for a dumb terminal")
    top.press(b"\x03")
    top.check_end(0)


def hung_up(top):
    top.shows("resident")
    os.kill(top.pid, signal.SIGHUP)
    top.check_end(0)


def check(what, test, **options):
    global count, failures
    count += 1
    top = Top(**options)
    try:
        test(top)
        print(f"ok {count} - {what}")
    except (AssertionError, OSError, ValueError, IndexError) as e:
        failures += 1
        print(f"not ok {count} - {what}")
        print("\n".join("# " + line for line in str(e).splitlines()))
    finally:
        top.close()
    sys.stdout.flush()


check("draws, and draws again; q ends, other keys do nothing", draws_at_once_and_again)
check("follows the terminal's size, to 40x10 and to one cell", resized)
check("a terminal of 40x10 from the start", lambda top: (top.shows("more lines"), top.press(b"q"), top.check_end(0)), columns=40, rows=10)
check("ctrl-C leaves the terminal as it was", control_c)
check("SIGTERM, too", killed_by(signal.SIGTERM))
check("SIGHUP, too", hung_up)
check("and when the daemon does not answer", at_once)
check("ctrl-Z gives the terminal back, and takes it again", stopped_and_on)
check("a daemon that goes away is waited for", gone_and_back)
check("NO_COLOR: none", no_colour, NO_COLOR="1")
check("TERM=dumb: lines", dumb, rows=200, TERM="dumb")
check("TERM is empty: lines", dumb, rows=200, TERM="")
print(f"1..{count}")
sys.exit(failures != 0)
