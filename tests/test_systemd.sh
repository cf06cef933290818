#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_systemd.sh - the installation and what systemd makes of it: every file in its place, the units as systemd reads them, the gate on
# their exposure (alone and with each drop-in), and the real daemon started by its socket, watched, and reloaded. No systemd
# has to run here: its own tools take the manager's part, and at the end a script does. Prints TAP.
set -u
cd "$(dirname "$0")/.."
. tests/programs.sh
GATE=1.2 # of `systemd-analyze security`; 0 is no exposure, 10 is all
unset NOTIFY_SOCKET WATCHDOG_USEC WATCHDOG_PID LISTEN_FDS LISTEN_PID

work=$(mktemp -d "${TMPDIR:-/tmp}/airy-test-XXXXXX")
started=()
finish() {
    for pid in "${started[@]}"; do kill -KILL "$pid" 2>/dev/null; done
    rm -rf "$work"
}
trap finish EXIT

. tests/tap.sh
check() { # as tap.sh's, with the daemon's words
    local what=$1
    shift
    n=$((n + 1))
    why=
    if "$@" 2>>"$work/err"; then
        echo "ok $n - $what"
    else
        echo "not ok $n - $what"
        echo "# $why"
        tail -5 "$work/err" "$work/log" 2>/dev/null | sed 's/^/# /'
        failures=$((failures + 1))
    fi
}
needs() { # program, the tests that are skipped without it
    local program=$1
    shift
    command -v "$program" >/dev/null && return
    for t; do skip "$t" "no $program on this machine"; done
    return 1
}

# ---- what is installed ---------------------------------------------------------------------------------
R=$work/root
t() {
    why="make install failed" && make -s install BUILD="$BUILD" DESTDIR="$R" PREFIX=/usr LIBDIR=/usr/lib/some-arch >"$work/log" 2>&1 || return 1
    local page
    {
        printf '%s\n' bin/airy bin/airyd include/airy.h lib/some-arch/libairy.{a,so,so.0} lib/some-arch/pkgconfig/libairy.pc \
            lib/systemd/{system,user}/airyd.{service,socket} lib/sysusers.d/airyd.conf lib/udev/rules.d/70-airy-wall.rules \
            share/airy/airy-slurm.sh \
            share/doc/airyd/{README.md,LICENSE,PROTOCOL.md,airy.proto,opencue.md,deadline.md,examples/gpu.conf,examples/wall.conf}
        for page in client/*.[1-8] proto/*.[1-8] daemon/*.[1-8] daemon/wall/*.[1-8]; do
            [ -e "$page" ] && echo "share/man/man${page##*.}/${page##*/}"
        done
    } | sort >"$work/wanted"
    (cd "$R/usr" && find . -not -type d | sed 's|^\./||' | sort) >"$work/found"
    why="other files than wanted: $(diff "$work/wanted" "$work/found" | tr '\n' ' ')" && cmp -s "$work/wanted" "$work/found" &&
        why="something outside of usr/" && [ "$(ls "$R")" = usr ] &&
        why="an unreadable file, or one that others may write" && [ -z "$(find "$R" -type f \( -not -perm -444 -o -perm /022 \))" ] &&
        why="a path of another prefix" && ! grep -rIq /usr/local "$R/usr/lib/systemd" "$R/usr/share/doc/airyd/examples" "$R/usr/lib/some-arch/pkgconfig" &&
        grep -qx 'ExecStart=/usr/bin/airyd' "$R/usr/lib/systemd/system/airyd.service"
}
check "make install: every file, for this prefix" t

t() {
    printf '#include <airy.h>\n#include <stdio.h>\nint main(void) { airy_close(NULL); return puts(AIRY_VERSION) < 0; }\n' >"$work/use.c"
    why="pkg-config and the library do not fit" &&
        export PKG_CONFIG_PATH=$R/usr/lib/some-arch/pkgconfig PKG_CONFIG_SYSROOT_DIR=$R &&
        ${CC:-cc} "$work/use.c" $(pkg-config --cflags --libs libairy) -o "$work/use" &&
        why="version $(pkg-config --modversion libairy), and its header says $(LD_LIBRARY_PATH=$R/usr/lib/some-arch "$work/use")" &&
        [ "$(LD_LIBRARY_PATH=$R/usr/lib/some-arch "$work/use")" = "$(pkg-config --modversion libairy)" ]
}
# An instrumented library wants its runtime linked in.
if nm -D "$BUILD/libairy.so" 2>/dev/null | grep -qE '__(asan|tsan)_'; then
    skip "libairy.pc: a program of somebody else's" "built with a sanitizer"
else
    check "libairy.pc: a program of somebody else's" t
fi

t() {
    why="make deb failed" && make -s deb BUILD="$BUILD" >"$work/log" 2>&1 || return 1
    local deb depends
    deb=$(ls "$BUILD"/airyd_*.deb)
    depends=$(dpkg-deb -f "$deb" Depends)
    for p in libvulkan1 libopenexr libprotobuf-c1 libsystemd0 mesa-vulkan-drivers; do
        why="Depends does not name $p: $depends" && grep -q "$p" <<<"$depends" || return 1
    done
    mkdir "$work/deb" && dpkg-deb -x "$deb" "$work/deb" && dpkg-deb -e "$deb" "$work/deb/DEBIAN" &&
        why="the package lacks a unit" && [ -s "$work/deb/usr/lib/systemd/system/airyd.socket" ] &&
        why="an md5sum is wrong" && (cd "$work/deb" && md5sum --quiet -c DEBIAN/md5sums) &&
        why="a maintainer script is no shell script" && sh -n "$work/deb/DEBIAN/postinst" && sh -n "$work/deb/DEBIAN/prerm" && sh -n "$work/deb/DEBIAN/postrm"
}
needs dpkg-shlibdeps "make deb" && check "make deb: a package that says what it needs" t

# ---- what systemd reads ---------------------------------------------------------------------------------
# In a root of its own, with the programs that the units name and nothing of this machine.
with() { # drop-in, or nothing
    rm -rf "$R/etc" && mkdir -p "$R/etc/systemd/system/airyd.service.d" "$R/bin"
    ln -sf /bin/true "$R/bin/kill"
    [ -z "$1" ] || cp "$R/usr/share/doc/airyd/examples/$1.conf" "$R/etc/systemd/system/airyd.service.d/"
}
t() { # drop-in, or nothing
    local score
    with "$1"
    cp "$R"/usr/lib/systemd/system/airyd.* "$work/units/" && rm -rf "$work/units/airyd.service.d" &&
        cp -r "$R/etc/systemd/system/airyd.service.d" "$work/units/" || return 1
    sed -i "s|/usr/bin/airyd|$AIRYD|" "$work"/units/airyd.service "$work"/units/airyd.service.d/* 2>/dev/null
    why="verify: $(systemd-analyze verify --man=no "$work/units/airyd.service" "$work/units/airyd.socket" 2>&1)"
    [ "$why" = "verify: " ] || return 1
    why="security: $(systemd-analyze security --offline=yes --threshold="${GATE/./}" --no-pager "$work/units/airyd.service" 2>&1 | grep -E 'Overall|✗')"
    score=$(sed -nE 's/.*exposure level for [^:]*: ([0-9.]+) .*/\1/p' <<<"$why")
    echo "# exposure${1:+ with $1.conf}: $score"
    [ -n "$score" ] && awk -v s="$score" -v g=$GATE 'BEGIN { exit !(s <= g) }'
}
mkdir "$work/units"
if needs systemd-analyze "the unit" "with gpu.conf" "with wall.conf" "the user's units"; then
    check "the unit: clean, and exposed to at most $GATE" t ""
    check "with gpu.conf: clean, and exposed to at most $GATE" t gpu
    check "with wall.conf: clean, and exposed to at most $GATE" t wall
    t() {
        mkdir "$work/user" && cp "$R"/usr/lib/systemd/user/airyd.* "$work/user/" && sed -i "s|/usr/bin/airyd|$AIRYD|" "$work/user/airyd.service" || return 1
        why="verify: $(XDG_RUNTIME_DIR=$work systemd-analyze --user verify --man=no "$work"/user/airyd.* 2>&1)"
        [ "$why" = "verify: " ] && why="not where clients look" && grep -qx 'ListenStream=%t/airyd.sock' "$work/user/airyd.socket"
    }
    check "the user's units: clean, at the clients' first path" t
fi
t() {
    why="the gate is none: it lets pass a unit without any setting"
    printf '[Service]\nExecStart=/bin/true\n' >"$work/open.service"
    ! systemd-analyze security --offline=yes --threshold="${GATE/./}" --no-pager "$work/open.service" >/dev/null 2>&1
}
needs systemd-analyze "the gate closes" && check "the gate closes" t
t() {
    why="sysusers: $(systemd-sysusers --root="$work/empty" "$R/usr/lib/sysusers.d/airyd.conf" 2>&1)"
    grep -q '^airy-wall:' "$work/empty/etc/group"
}
mkdir -p "$work/empty/etc"
needs systemd-sysusers "the group airy-wall" && check "the group airy-wall is made" t
t() { # the rule's three boards, each for the group and for who sits there
    local rule
    for id in 1d50:607a 1d50:614d 16d0:10a9; do
        rule=$(grep -F "ATTR{idVendor}==\"${id%:*}\", ATTR{idProduct}==\"${id#*:}\"" "$R/usr/lib/udev/rules.d/70-airy-wall.rules")
        why="no rule for $id" && [ -n "$rule" ] && why="$id: $rule" && grep -qF 'GROUP="airy-wall", MODE="0660", TAG+="uaccess"' <<<"$rule" || return 1
    done
}
check "a rule for each controller" t

# ---- the daemon, started by its socket ---------------------------------------------------------------------------
t() {
    systemd-socket-activate -l "$work/a.sock" "$AIRYD" --warm common 2>"$work/log" &
    started+=($!)
    why="no socket" && wait_for 200 test -S "$work/a.sock" && why="no answer through systemd's socket" &&
        timeout 200 "$AIRY" status --socket "$work/a.sock" >"$work/out" &&
        why="it does not say whose socket it is" && grep -q "ready on systemd's socket" "$work/log" &&
        why="no clean end" && kill -TERM "${started[-1]}" && wait "${started[-1]}" && why="the socket is not its to remove" && [ -S "$work/a.sock" ]
}
needs systemd-socket-activate "socket activation" && check "socket activation" t

# A manager of one page: takes the notes, by order. What they are is what is asserted, never when they came.
cat >"$work/manager.py" <<'PY'
import os, socket, subprocess, sys
path, log, limit_us, command = sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4:]
s = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
s.bind(path)
env = dict(os.environ, NOTIFY_SOCKET=path, WATCHDOG_USEC=limit_us)
child = subprocess.Popen(command, env=env, stderr=open(log, "w"))
print("pid", child.pid, flush=True)
s.settimeout(0.1)
while child.poll() is None:
    try:
        print(s.recv(4096).decode().replace("\n", " "), flush=True)
    except socket.timeout:
        pass
print("exit", child.returncode, flush=True)
PY
count() { grep -c "$1" "$work/notes"; }
more() { [ "$(count "$1")" -gt "$2" ]; }
manage() { # limit in microseconds, environment...: sets pid
    rm -f "$work/notify" "$work/notes"
    env "${@:2}" python3 "$work/manager.py" "$work/notify" "$work/log" "$1" "$AIRYD" --socket "$work/m.sock" --warm common >"$work/notes" &
    started+=($!)
    why="it did not become ready" && wait_for 200 grep -q '^READY=1 STATUS=ready on ' "$work/notes" || return 1
    pid=$(sed -n 's/^pid //p' "$work/notes")
    started+=("$pid")
}
t() {
    local seen
    manage 1000000 || return 1
    why="READY did not come first: $(sed -n 2p "$work/notes")" && sed -n 2p "$work/notes" | grep -q '^READY=1' &&
        why="idle, and not fed again and again" && wait_for 200 more '^WATCHDOG=1$' 3 &&
        kill -HUP "$pid" && why="SIGHUP: no RELOADING with its time" && wait_for 200 grep -qE '^RELOADING=1 MONOTONIC_USEC=[0-9]+$' "$work/notes" &&
        why="and no READY after it" && wait_for 200 eval 'sed "1,/^RELOADING/d" "$work/notes" | grep -q "^READY=1"' || return 1
    seen=$(count '^WATCHDOG=1$')
    why="no longer fed after SIGHUP" && wait_for 200 more '^WATCHDOG=1$' "$seen" &&
        kill -TERM "$pid" && why="no STOPPING, or no clean end" && wait_for 200 grep -q '^exit 0$' "$work/notes" && grep -q '^STOPPING=1$' "$work/notes" &&
        why="it gave up a device that was idle" && ! grep -q trigger "$work/notes"
}
needs python3 "READY, the watchdog when idle, reload, stop" && check "READY, the watchdog when idle, reload, stop" t

# A driver that hangs: the loader's function stands still while a file is there. The loop goes on, and must not feed.
cat >"$work/hang.c" <<'C'
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <unistd.h>
#include <vulkan/vulkan.h>
VkResult vkWaitSemaphores(VkDevice d, const VkSemaphoreWaitInfo *w, uint64_t ns)
{
    while (access(getenv("HANG_WHILE"), F_OK) == 0)
        usleep(10000);
    PFN_vkWaitSemaphores real = (PFN_vkWaitSemaphores)dlsym(RTLD_NEXT, "vkWaitSemaphores");
    return real(d, w, ns);
}
C
t() {
    why="hang.so" && ${CC:-cc} -shared -fPIC "$work/hang.c" -o "$work/hang.so" && manage 1000000 LD_PRELOAD="$work/hang.so" HANG_WHILE="$work/hang" || return 1
    touch "$work/hang"
    "$AIRY" bloom --socket "$work/m.sock" "$work/in.exr" "$work/out.exr" >"$work/out" 2>&1 &
    local client=$! fed
    started+=("$client")
    why="the device hangs, and it is not given up" && wait_for 200 grep -q '^WATCHDOG=trigger$' "$work/notes" &&
        why="its words do not say why" && grep -q 'the device has made no progress for ' "$work/log" &&
        why="the loop stopped with it" && timeout 200 "$AIRY" status --socket "$work/m.sock" >/dev/null || return 1
    fed=$(sed '1,/trigger/d' "$work/notes" | grep -c '^WATCHDOG=1$')
    why="fed $fed times after it was given up" && [ "$fed" -eq 0 ] && rm "$work/hang" &&
        why="the frame that hung is not done" && wait "$client" && [ -s "$work/out.exr" ] &&
        why="progress, and not fed" && wait_for 200 eval 'sed "1,/trigger/d" "$work/notes" | grep -q "^WATCHDOG=1$"' &&
        kill -TERM "$pid" && wait_for 200 grep -q '^exit 0$' "$work/notes"
}
if needs python3 "a device that hangs"; then
    if nm -D "$AIRYD" | grep -qE '__(asan|tsan)_'; then
        skip "a device that hangs is given up, and only then" "a sanitizer wants to be the first library"
    else
        "$SCENE" "$work/in.exr" >/dev/null
        check "a device that hangs is given up, and only then" t
    fi
fi
t() {
    why="WATCHDOG_USEC=soon was taken"
    WATCHDOG_USEC=soon WATCHDOG_PID='' timeout 200 "$AIRYD" --socket "$work/w.sock" 2>"$work/log"
    [ $? -eq 1 ] && why="the field is not named" && grep -q 'WATCHDOG_USEC: "soon"; expected microseconds' "$work/log"
}
check "WATCHDOG_USEC that is no number" t

finish_tap
