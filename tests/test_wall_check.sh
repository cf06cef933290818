#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_wall_check.sh - airy wall check and draw: what they print, where, and their exit statuses. No daemon, no device.
# Prints TAP. AIRY names the program.
set -u
cd "$(dirname "$0")/.."
BUILD=${BUILD:-build}
AIRY=$(realpath "${AIRY:-$BUILD/airy}")
work=$(mktemp -d "${TMPDIR:-/tmp}/airy-wall-XXXXXX")
trap 'rm -rf "$work"' EXIT

n=0 failures=0 why=
check() { # description, command...: one line of TAP
    local what=$1
    shift
    n=$((n + 1))
    why=
    if "$@"; then
        echo "ok $n - $what"
    else
        echo "not ok $n - $what"
        echo "# $why"
        tail -5 "$work/err" 2>/dev/null | sed 's/^/# /'
        failures=$((failures + 1))
    fi
}
exits() { # status command...: output in $work/out and $work/err
    local wanted=$1 got
    shift
    "$@" >"$work/out" 2>"$work/err"
    got=$?
    why="exit status $got, wanted $wanted: $*"
    [ $got -eq "$wanted" ]
}
says() { # a whole line on stderr
    why="stderr has no line \"$1\""
    grep -qxF -- "$1" "$work/err"
}
mentions() {
    why="stderr does not say \"$1\""
    grep -qF -- "$1" "$work/err"
}
prints() { # extended regular expression on stdout
    why="stdout does not match $1"
    grep -qE -- "$1" "$work/out"
}
lines() { # how many on stderr
    why="$(wc -l <"$work/err") lines on stderr, wanted $1"
    [ "$(wc -l <"$work/err")" -eq "$1" ]
}

cat >"$work/good.yaml" <<'END'
wall: stage
panels:
- {name: t, grid: [4, 4], size: [8, 8], wiring: {serpentine: true}}
- {name: edge, at: [32, 0], size: [2, 32]}
supplies:
- {name: psu1, amps: 20}
boards:
- {serial: A, name: left, supply: psu1, panels: t-1 to t-8}
- {serial: B, name: right, supply: psu1, brightness: 0.5, panels: t-9 to t-12}
- {serial: C, kind: gud, size: [8, 32], panels: [t-13]}
END
sed -i 's/, wiring: {serpentine: true}//' "$work/good.yaml" # a display's panels have no wiring
cat >"$work/bad.yaml" <<'END'
wall: stage
rate: fast
panels:
- {name: t, size: [8, 8], rotate: 45}
boards:
- serial: A
  order: RGX
  panals: t
END

t() {
    exits 0 "$AIRY" wall check "$work/good.yaml" && prints '^stage: 34 x 32 pixels, 60 frames/s; .* hold 2 s, then fade 1 s$' &&
        prints '17 panels with 1088 LEDs, 832 of them on 3 boards$' &&
        prints 'board left +fadecandy A, 512 of 512 LEDs on 8 strips, 1\.32 ms of bus a frame, at most 31\.2 A from psu1$' &&
        prints 'board right +fadecandy B, 256 of 512 LEDs on 4 strips, .*, at most 7\.94 A from psu1$' &&
        prints 'board C +gud, 64 of 256 LEDs, 768 bytes a frame$' &&
        prints 'supply psu1 +39\.2 A in full white of 20 A: bright pictures will be dimmed$' &&
        prints 'bus: 2 fadecandies take 2\.64 ms of each 16\.7 ms' &&
        says "$work/good.yaml:4:3: note: panels[1]: panel edge: 64 of its 64 LEDs are on no board and stay dark" && lines 4
}
check "a good wall: what it amounts to, and notes" t
t() {
    exits 3 "$AIRY" wall check "$work/bad.yaml" &&
        says "$work/bad.yaml:2:7: rate: \"fast\"; expected frames per second, 1 to 240" &&
        says "$work/bad.yaml:4:35: panels[0].rotate: \"45\"; expected one of: 0 90 180 270" &&
        says "$work/bad.yaml:7:10: boards[0].order: \"RGX\"; expected each of R, G, B once, such as GRB" &&
        says "$work/bad.yaml:8:3: boards[0].panals: unknown key; did you mean \"panels\"?" && mentions '4 mistakes' && lines 5 &&
        [ ! -s "$work/out" ]
}
check "every mistake with its line" t
t() {
    exits 3 "$AIRY" wall check "$work/none.yaml" && mentions 'No such file' && exits 3 "$AIRY" wall check "$work" && mentions 'folder' &&
        exits 3 "$AIRY" wall check /dev/zero && mentions 'expected a definition of at most' && exits 3 "$AIRY" wall check /dev/null &&
        says '/dev/null:1:1: the definition is empty; expected "wall: NAME" and what it is made of'
}
check "files that are none" t
t() {
    exits 2 "$AIRY" wall && exits 2 "$AIRY" wall chek && mentions 'did you mean airy wall check?' && exits 2 "$AIRY" wall check &&
        exits 2 "$AIRY" wall check a b && exits 2 "$AIRY" wall check "$work/good.yaml" -o x && exits 2 "$AIRY" wall draw "$work/good.yaml" &&
        exits 2 "$AIRY" wall draw "$work/good.yaml" -o "$work/x.png" --cell 0 && exits 2 "$AIRY" wall draw x --cel 3 &&
        mentions 'did you mean --cell?' && [ ! -e "$work/x.png" ]
}
check "command lines that are none" t
t() {
    exits 0 "$AIRY" wall --help && prints '^  airy wall check ' && prints '^  airy wall draw ' && exits 0 "$AIRY" wall check --help &&
        prints '^  airy wall check stage.yaml$' && exits 0 "$AIRY" wall draw --help && prints '^  airy wall draw stage.yaml -o stage.png$'
}
check "help" t
t() {
    exits 0 "$AIRY" wall draw "$work/good.yaml" -o "$work/a.png" --cell 9 && mentions 'a.png: ' &&
        why="no PNG" && [ "$(head -c8 "$work/a.png" | od -An -tx1 | tr -d ' ')" = 89504e470d0a1a0a ] &&
        exits 0 "$AIRY" wall draw "$work/good.yaml" -o "$work/b.png" --cell 9 && why="drawn twice, not the same" &&
        cmp -s "$work/a.png" "$work/b.png" && exits 4 "$AIRY" wall draw "$work/good.yaml" -o "$work/no/a.png" && mentions 'No such file' &&
        exits 3 "$AIRY" wall draw "$work/bad.yaml" -o "$work/c.png" && [ ! -e "$work/c.png" ] &&
        why="left behind" && [ -z "$(find "$work" -name '.*airy*')" ]
}
check "a picture of the layout" t
# The manual's examples are definitions, too.
t() {
    awk -v out="$work/example" '/^\.nf/ { n++; on = 1; next } /^\.fi/ { on = 0 } on && !/^\./ { gsub(/\\-/, "-"); gsub(/\\&/, "");
        print > (out n ".yaml") }' client/airy-wall.5
    why="no examples in the manual" && [ -e "$work/example1.yaml" ] || return 1
    for f in "$work"/example*.yaml; do
        grep -q '^wall:' "$f" || continue
        exits 0 "$AIRY" wall check "$f" || return 1
    done
}
check "the manual's examples" t

echo "1..$n"
[ $failures -eq 0 ]
