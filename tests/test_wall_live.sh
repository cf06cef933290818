#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_wall_live.sh - airy wall as an operator uses it on the first day, with a real daemon and no controller plugged in: open,
# list, play, preview, test, share, stats, close. Prints TAP. AIRY and AIRYD name the programs, SCENE the picture maker.
set -u
cd "$(dirname "$0")/.."
. tests/programs.sh
work=$(mktemp -d "${TMPDIR:-/tmp}/airy-wall-XXXXXX")
daemon=
finish() {
    [ -n "$daemon" ] && kill -KILL "$daemon" 2>/dev/null
    rm -rf "$work"
}
trap finish EXIT

. tests/tap.sh
prints() {
    why="stdout does not match $1: $(head -5 "$work/out")"
    grep -qE -- "$1" "$work/out"
}
wall() {
    local what=$1
    shift
    "$AIRY" wall "$what" --socket "$work/s" "$@"
}
# A black picture packs into very little.
packed() { stat -c %s "$1"; }

cd "$work"
"$AIRYD" --socket "$work/s" --threads 2 --warm common 2>daemon.log &
daemon=$!
for _ in $(seq 300); do "$AIRY" status --socket "$work/s" >/dev/null 2>&1 && break; sleep 0.1; done

cat >lobby.yaml <<'YAML'
wall: lobby
rate: 50
hold: forever
picture: {tone map: aces}
panels:
  - {grid: [2, 1], name: tile, size: [16, 16], wiring: {serpentine: true}}
boards:
  - {serial: NOTTHERE, panels: [tile]}
YAML
sed 's/wall: lobby/wall: broken/; s/serial: NOTTHERE/serial: OTHER, order: RGX/' lobby.yaml >broken.yaml
sed 's/wall: lobby/wall: gains/; s/serial: NOTTHERE/serial: GAINED/; s/^panels/colour: {calibration: gains.exr}\npanels/' lobby.yaml >gains.yaml

check "nothing is open, and it says what to do" exits 0 wall list
check "... in words" prints 'none is open'
check "a definition with a mistake is not opened" exits 3 wall open broken.yaml --keep
check "... and the mistake is told with its line" says "broken.yaml:8"
check "a wall is opened and kept" exits 0 wall open lobby.yaml --keep
check "it is listed with its board" exits 0 wall list
check "... that is not there" prints 'NOTTHERE.*absent|absent.*NOTTHERE'
check "opened again it is used as it is, or said to be open" exits 3 wall open lobby.yaml --keep

"$SCENE" one.exr 2>/dev/null
for i in 1 2 3 4 5 6; do ln -s one.exr "in.000$i.exr"; done
echo "not a picture" >in.0004.exr.bad
rm in.0004.exr && mv in.0004.exr.bad in.0004.exr

check "a still picture is shown" exits 0 timeout -s INT 20 "$AIRY" wall play --socket "$work/s" one.exr --wall lobby
check "what is sent can be looked at" exits 0 wall preview lobby -o lit.png
check "... and is not black" eval 'why="lit.png has $(packed lit.png) bytes"; [ "$(packed lit.png)" -gt 2000 ]'
check "a sequence with a damaged frame goes on" exits 3 timeout -s INT 60 "$AIRY" wall play --socket "$work/s" 'in.####.exr' --wall lobby --fps 2
check "... and names it" says 'in.0004.exr'
check "the figures say that pictures were shown" exits 0 wall stats lobby --once --json
check "... more than one" prints '"shown": *([2-9]|[1-9][0-9])'
check "black is a pattern" exits 0 timeout -s INT 20 "$AIRY" wall test --socket "$work/s" lobby black --seconds 1
check "a board's LED by its number" exits 0 wall test lobby led --board NOTTHERE --led 511 --seconds 0.2
check "one that is not there is refused" exits 2 wall test lobby led --board NOTTHERE --led 512 --seconds 0.2
check "a wall that nobody opened" exits 3 wall test attic white --seconds 0.2
check "... is told apart from those that are open" says '"lobby"'
check "what a share needs of a frame" exits 0 wall share lobby.yaml --frame 1920x1080 --psf gaussians:sigma=8,weight=.1 --json
check "... is a region of it" prints '"width": *[0-9]+'
check "a calibration image that is not there" exits 3 wall open gains.yaml --keep
check "... is named" says 'gains.exr'
"$SCENE" gains.exr 2>/dev/null
check "one of another size is refused" exits 3 wall open gains.yaml --keep
check "... with both sizes" says "the wall's 32 x 16"
check "closed" exits 0 wall close lobby
check "... and gone" exits 0 wall list
check "... from the list" prints 'none is open'

kill -TERM "$daemon"
wait "$daemon"
status=$?
daemon=
check "the daemon ends well" eval 'why="exit status $status"; [ $status -eq 0 ]'
finish_tap
