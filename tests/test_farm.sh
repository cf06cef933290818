#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_farm.sh - what a farm relies on, with real daemons: frames that are done are left alone, numbers that differ between
# input and output, frames that are missing, disks that are full, and runs and daemons that are killed at random moments (the
# seed is printed; AIRY_SEED repeats it, ROUNDS= takes more). Prints TAP.
set -u
cd "$(dirname "$0")/.."
. tests/programs.sh

work=$(mktemp -d "${TMPDIR:-/tmp}/airy-farm-XXXXXX")
. tests/tap.sh
started=() mounted=
finish() {
    for pid in "${started[@]}"; do kill -KILL "$pid" 2>/dev/null; done
    [ -n "$mounted" ] && umount "$mounted"
    wait 2>/dev/null
    rm -rf "$work"
}
trap finish EXIT

"$SCENE" "$work/in.exr" 96 54 || exit 1
"$SCENE" "$work/other.exr" 80 60 || exit 1
mkdir "$work/seq" "$work/o"
for i in 0001 0002 0003 0004 0006; do cp "$work/in.exr" "$work/seq/in.$i.exr"; done
socket=$work/d.sock
daemon_start() {
    "$AIRYD" --warm common --socket "$socket" 2>>"$work/airyd.log" &
    daemon=$!
    started+=("$daemon")
}
daemon_start
wait_for 200 "$AIRY" status --socket "$socket" >/dev/null 2>&1
bloom() { "$AIRY" bloom --socket "$socket" "$@"; }
fresh() { rm -rf "$work/o" && mkdir "$work/o"; }
range() { bloom "$work/seq/in.####.exr" -o "$work/o/out.####.exr" --json -q "$@"; }
inode() { stat -c %i "$work/o/out.$1.exr"; }
exits 0 bloom "$work/in.exr" "$work/want.exr" || exit 1

# ---- done is done --------------------------------------------------------------------------------------
t() {
    fresh && exits 0 range -f 1-4 && ended 4 done || return 1
    local before
    before=$(inode 0001)
    exits 0 range -f 1-4 && ended 4 skipped && why="the file was written again" && [ "$(inode 0001)" = "$before" ] &&
        exits 0 range -f 1-4 --no-overwrite && ended 4 skipped && exits 0 range -f 1-4 --force && ended 4 done &&
        why="--force left it" && [ "$(inode 0001)" != "$before" ] && same "$work/o/out.0004.exr" "$work/want.exr"
}
check "the same again does nothing; --force does it" t
t() {
    exits 0 range -f 1-4 --threshold 0.5 && ended 4 done && exits 0 range -f 1-4 --threshold 0.50 && ended 4 skipped &&
        exits 0 range -f 1-4 --threshold 0.5 --compression rle && ended 4 done && exits 0 range -f 1-4 --threshold 0.5 --pixels float &&
        ended 4 done && exits 0 range -f 1-4 --threshold 0.5 --part 0 && ended 4 done && exits 0 range -f 1-4 && ended 4 done
}
check "other parameters, storage or parts are another request" t
t() {
    cp "$work/other.exr" "$work/seq/in.0002.exr" && head -c 2000 "$work/o/out.0003.exr" >"$work/cut" &&
        cp "$work/in.exr" "$work/o/out.0004.exr" && exits 0 range -f 1-4 && ended 2 done && ended 2 skipped &&
        same "$work/o/out.0004.exr" "$work/want.exr" && exits 4 range -f 2 --no-overwrite --threshold 3
    local status=$?
    cp "$work/in.exr" "$work/seq/in.0002.exr"
    return $status
}
check "another input, or a file that is not ours, is done again" t
t() {
    exits 0 bloom "$work/in.exr" "$work/o/one.exr" --bloom off && exits 0 bloom "$work/in.exr" "$work/o/one.exr" &&
        exits 0 bloom "$work/in.exr" "$work/o/one.exr" && says 'is there already, of the same request' && same "$work/o/one.exr" "$work/want.exr"
}
check "one frame says so, too" t
t() {
    exits 0 bloom "$work/in.exr" "$work/o/dirt.exr" --dirt "$work/other.exr" --json -q && exits 0 bloom "$work/in.exr" "$work/o/dirt.exr" \
        --dirt "$work/other.exr" --json -q && ended 1 skipped && exits 0 bloom "$work/in.exr" "$work/o/dirt.exr" --dirt "$work/in.exr" --json -q && ended 1 done
}
check "an image by its file is known by what is in it" t

# ---- numbers ---------------------------------------------------------------------------------------------
t() {
    fresh && exits 0 range -f 1-3 --offset 1000 && [ "$(ls "$work/o" | tr '\n' ' ')" = "out.1001.exr out.1002.exr out.1003.exr " ] &&
        fresh && exits 0 range -f 1-3 --offset -2 && [ -e "$work/o/out.-001.exr" ] && [ -e "$work/o/out.0001.exr" ] &&
        fresh && exits 0 range -f 3-1 --output-frames 10-20x5 && [ "$(ls "$work/o" | tr '\n' ' ')" = "out.0010.exr out.0015.exr out.0020.exr " ] &&
        grep -q '"frame":3,.*out.0010' "$work/out" && exits 2 range -f 1-3 --output-frames 1-2 && says '2 frames; as many' &&
        exits 2 range -f 1-3 --output-frames 1-3 --offset 1 && exits 2 range -f 1-3 --offset x && says 'a number such as' &&
        exits 2 range -f 1-3 --offset 999999999 && exits 2 bloom "$work/in.exr" "$work/o/x.exr" --offset 1 && says 'no frame token'
}
check "outputs are numbered on their own" t
t() {
    local before
    before=$(cat "$work"/seq/* | cksum)
    exits 2 bloom "$work/seq/in.####.exr" -o "$work/seq/in.####.exr" -f 1-4 --offset 1 && says 'is an input itself' &&
        exits 2 bloom "$work/seq/in.####.exr" "$work/o/out.exr" -f 1 && says 'no frame token' && why="an input changed" &&
        [ "$(cat "$work"/seq/* | cksum)" = "$before" ]
}
check "an output that is an input, or the same for all, is refused" t
t() {
    mkdir "$work/sub" && for i in 0001 0001.5 0002; do cp "$work/in.exr" "$work/sub/s.$i.exr"; done
    fresh && exits 0 bloom "$work/sub/s.####.exr" -o "$work/o/@.exr" -f 1-2x0.5 --json -q &&
        [ "$(ls "$work/o" | tr '\n' ' ')" = "1.5.exr 1.exr 2.exr " ] && grep -q '^{"frame":1.5,' "$work/out" &&
        exits 0 bloom "$work/sub/s.####.exr" -o "$work/o/@.exr" --json -q && ended 3 skipped
}
check "subframes, said and found" t

# ---- missing and bad ------------------------------------------------------------------------------------
t() {
    fresh && exits 3 range -f 3-6 && ended 3 done && ended 1 failed && exits 0 range -f 3-6 --on-missing skip && ended 3 skipped &&
        ended 1 missing && [ ! -e "$work/o/out.0005.exr" ] && exits 2 range -f 1 --on-missing nothing
}
check "a missing frame fails, or is left out" t
t() {
    fresh && exits 0 range -f 4-6 --on-missing black && ended 2 done && ended 1 black &&
        grep '"black"' "$work/out" | grep '^{"frame":5,' | grep -q '"energy":{"input":0,' &&
        exits 0 "$AIRY" plan --socket "$socket" "$work/o/out.0005.exr" --json && grep -q '"width":96,"height":54' "$work/out" &&
        exits 0 range -f 4-6 --on-missing black && ended 3 skipped && cp "$work/in.exr" "$work/seq/in.0005.exr" &&
        exits 0 range -f 4-6 --on-missing black && ended 2 skipped && ended 1 done && same "$work/o/out.0005.exr" "$work/want.exr" &&
        exits 3 bloom "$work/none.####.exr" -o "$work/o/#.exr" -f 1 --on-missing black && rm "$work/seq/in.0005.exr" &&
        exits 3 range -f 90-91 && exits 0 range -f 90-91 --on-missing black && ended 2 black
}
check "a missing frame is black, until it comes" t
t() {
    fresh && head -c 2500 "$work/in.exr" >"$work/seq/in.0005.exr" && exits 3 range -f 1-6 && ended 5 done && ended 1 failed &&
        exits 3 range -f 1-6 --on-missing skip --keep-going && ended 5 skipped && ended 1 failed &&
        fresh && exits 3 range -f 5,1-4 --fail-fast -j 1 && ended 1 failed && ended 0 done
    local status=$?
    rm "$work/seq/in.0005.exr"
    return $status
}
check "one bad frame costs one frame; --fail-fast ends there" t

# ---- what dead runs leave -----------------------------------------------------------------------------------
t() {
    fresh && cd "$work/o" || return 1
    local dead=.out.0001.exr.airy-0123456789abcdef live=.out.0002.exr.airy-0123456789abcdef other=.else.exr.airy-0123456789abcdef
    local like=.out.0001.exr.airy-0123456789abcdeX
    touch "$dead" "$other" "$like"
    exec 9>"$live" && flock 9 && cd - >/dev/null && exits 0 range -f 1-3 && why="the dead one stays" && [ ! -e "$work/o/$dead" ] &&
        why="one that is being written, or is not of these frames, went" && [ -e "$work/o/$live" ] && [ -e "$work/o/$other" ] && [ -e "$work/o/$like" ]
    local status=$?
    exec 9>&-
    return $status
}
check "dead runs' files go, living ones' and others' stay" t
if mkdir "$work/small" && mount -t tmpfs -o size=256k tmpfs "$work/small" 2>/dev/null; then
    mounted=$work/small
    t() {
        echo old >"$work/small/out.0001.exr" && cp "$work/small/out.0001.exr" "$work/old" && head -c 250000 /dev/zero >"$work/small/fill" &&
            exits 4 bloom "$work/seq/in.####.exr" -o "$work/small/out.####.exr" -f 1-2 --compression none -q && says 'out.0001.exr: cannot be written: No space left' &&
            same "$work/small/out.0001.exr" "$work/old" && why="left: $(ls -A "$work/small")" && [ "$(ls -A "$work/small" | wc -l)" -eq 2 ] &&
            rm "$work/small/fill" && exits 0 bloom "$work/seq/in.####.exr" -o "$work/small/out.####.exr" -f 1-2 --compression rle -q
    }
    check "a full disk: the old file stays, nothing else, and then it goes on" t
    umount "$mounted" && mounted=
else
    skip "a full disk" "no permission to mount a tmpfs"
fi

# ---- at once, and killed -------------------------------------------------------------------------------------
FRAMES=40
mkdir "$work/many"
for i in $(seq 1 $FRAMES); do ln "$work/in.exr" "$work/many/$i.exr"; done
# A program and not a function: in the background its number is airy's own, which is to be killed.
many=("$AIRY" bloom --socket "$socket" "$work/many/@.exr" -o "$work/o/@.exr" -f 1-$FRAMES --json -q)
all_right() { # every frame that is there is the right one
    for f in "$work"/o/*.exr; do
        [ -e "$f" ] || continue
        same "$f" "$work/want.exr" || return 1
    done
}
complete() {
    all_right && why="$(ls -A "$work/o" | wc -l) files, wanted $FRAMES" && [ "$(ls -A "$work/o" | wc -l)" -eq $FRAMES ]
}
t() {
    fresh
    local a b
    "${many[@]}" >"$work/a" 2>"$work/err" &
    a=$!
    "${many[@]}" >"$work/b" 2>>"$work/err" &
    b=$!
    wait $a && why="the second run" && wait $b && complete &&
        why="a frame has no end, or two" && [ "$(cat "$work/a" "$work/b" | grep -cE '"status":"(done|skipped)"')" -eq $((2 * FRAMES)) ]
}
check "two runs on the same frames at once" t

RANDOM=${AIRY_SEED:-$(($$ % 32768))}
echo "# seed ${AIRY_SEED:-$(($$ % 32768))}"
pause() { sleep "0.$(printf %03d $((RANDOM % 250)))"; }
keep_daemon() { # a supervisor: it comes back
    while [ ! -e "$work/stop" ]; do
        "$AIRYD" --warm common --socket "$socket" 2>>"$work/airyd.log" &
        echo $! >"$work/daemon.pid"
        wait $!
        sleep 0.05
    done
}
t() { # the runs are killed
    local finished=0 pid status
    fresh
    for round in $(seq 1 "${ROUNDS:-10}"); do
        "${many[@]}" >>"$work/killed" 2>"$work/err" &
        pid=$!
        pause
        kill -KILL $pid 2>/dev/null
        wait $pid 2>/dev/null
        status=$?
        [ $status -eq 137 ] || finished=$((finished + 1))
        all_right || { why="round $round: $why"; return 1; }
        complete && fresh
    done
    echo "# ${ROUNDS:-10} runs, $finished ended before they were killed"
    exits 0 "${many[@]}" && complete && why="every run ended by itself" && [ $finished -lt "${ROUNDS:-10}" ]
}
check "kill -9 of the run: whole files, and the next run ends it" t
answers() { "$AIRY" status --socket "$socket" >/dev/null 2>&1; }
t() { # the daemons are
    local pid kills=0
    kill -KILL "$daemon" && wait "$daemon" 2>/dev/null
    keep_daemon 2>/dev/null &
    started+=($!)
    wait_for 200 "$AIRY" status --socket "$socket" >/dev/null 2>&1 || return 1
    for round in $(seq 1 "${ROUNDS:-10}"); do
        fresh
        wait_for 200 answers
        "${many[@]}" >"$work/out" 2>"$work/err" &
        pid=$!
        pause
        kill -KILL "$(cat "$work/daemon.pid")" 2>/dev/null && kills=$((kills + 1))
        wait $pid
        local status=$?
        # Killed before the run had connected: it says so, and may be tried again.
        if [ $status -eq 5 ] && says 'no daemon answers' && why="round $round: a daemon that was there was not waited for" && ended 0 done; then
            wait_for 200 answers && exits 0 "${many[@]}"
            status=$?
        fi
        why="round $round: exit status $status" && [ $status -eq 0 ] && complete && why="frames were done twice" && ended $FRAMES done || return 1
    done
    echo "# $kills daemons killed"
    why="none was killed" && [ $kills -gt 0 ]
}
check "kill -9 of the daemon: the run waits for the next one, and loses nothing" t
touch "$work/stop"
kill -TERM "$(cat "$work/daemon.pid")" 2>/dev/null

finish_tap
