#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_top.sh - airy top beside a daemon that blooms: on terminals (top_terminal.py), and where there is none. Prints TAP.
set -u
cd "$(dirname "$0")/.."
. tests/programs.sh
work=$(mktemp -d "${TMPDIR:-/tmp}/airy-top-XXXXXX")
socket=$work/s
. tests/tap.sh
command -v python3 >/dev/null || { skip "airy top on terminals" "no python3"; finish_tap; exit; }

started=()
finish() {
    touch "$work/stop"
    for pid in "${started[@]}"; do kill -KILL "$pid" 2>/dev/null; done
    kill -KILL "$(cat "$work/pid" 2>/dev/null)" 2>/dev/null
    wait 2>/dev/null
    rm -rf "$work"
}
trap finish EXIT
"$SCENE" "$work/in.exr" 96 54 || exit 1
keep_daemon() { # a supervisor: it comes back
    while [ ! -e "$work/stop" ]; do
        "$AIRYD" --warm common --socket "$socket" 2>>"$work/airyd.log" &
        echo $! >"$work/pid.new" && mv "$work/pid.new" "$work/pid"
        wait $!
        sleep 2 # time to be missed
    done
}
load() { # one frame after the other, a few a second
    while [ ! -e "$work/stop" ]; do
        "$AIRY" bloom --socket "$socket" "$work/in.exr" "$work/out.exr" --force -q 2>/dev/null
        sleep 0.2
    done
}
keep_daemon 2>/dev/null &
started+=($!)
answers() { "$AIRY" status --socket "$socket" >/dev/null 2>&1; }
wait_for 200 answers
load &
started+=($!)

python3 -B tests/top_terminal.py "$AIRY" "$socket" "$work/pid" >"$work/terminal"
status=$?
grep -v '^1\.\.' "$work/terminal"
n=$(grep -cE '^(not )?ok ' "$work/terminal")
failures=$(grep -c '^not ok ' "$work/terminal")
[ $status -eq 0 ] || [ "$failures" -gt 0 ] || check "top_terminal.py ends by itself" false

# ---- where there is no terminal --------------------------------------------------------------------------
t() {
    why="it did not end by itself" && ! timeout -s TERM 4 "$AIRY" top --socket "$socket" </dev/null >"$work/lines" 2>"$work/err"
    why="a sequence in: $(head -c 300 "$work/lines")" && ! grep -q $'\033' "$work/lines" &&
        why="$(grep -c ' done (' "$work/lines") times, wanted 2 and more" && [ "$(grep -c ' done (' "$work/lines")" -ge 2 ]
}
check "a pipe or a file: lines, once a second" t
t() {
    exits 0 "$AIRY" top --socket "$socket" --once && why="no users" && grep -q '^  user ' "$work/out" && exits 0 "$AIRY" top --socket "$socket" --once --json &&
        python3 -c 'import json,sys; assert json.load(sys.stdin)["walls"] == []' <"$work/out"
}
check "--once, --json" t
t() { # who reads has gone
    "$AIRY" top --socket "$socket" 2>"$work/err" | head -1 >"$work/out"
    local status=${PIPESTATUS[0]}
    why="exit status $status" && [ "$status" -eq 4 ]
}
check "whoever reads it may go" t
t() { exits 5 "$AIRY" top --socket "$work/none" && says "$work/none" && exits 2 "$AIRY" top --nothing; }
check "no daemon at the start: said, status 5" t
t() { # lines: said once, and it goes on
    "$AIRY" top --socket "$socket" --json >"$work/json" 2>"$work/gone" &
    local top=$!
    lines() { [ "$(wc -l <"$work/json")" -ge "$1" ]; }
    why="no lines" && wait_for 200 lines 1 && kill -KILL "$(cat "$work/pid")" && why="not said" && wait_for 60 grep -q 'asked again' "$work/gone" && why="not back" &&
        wait_for 200 answers && wait_for 60 lines $(($(wc -l <"$work/json") + 2))
    local status=$?
    kill -TERM $top && wait $top && [ $status -eq 0 ] && why="said $(wc -l <"$work/gone") times" && [ "$(wc -l <"$work/gone")" -eq 1 ]
}
check "a daemon that goes away, in lines: said once" t
finish_tap
