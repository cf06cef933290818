#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_command.sh - the airy command end to end, with real daemons: what it writes, what it leaves alone when
# something fails, and its exit statuses. Prints TAP. AIRY and AIRYD name the programs, SCENE the picture maker.
set -u
cd "$(dirname "$0")/.."
. tests/programs.sh

work=$(mktemp -d "${TMPDIR:-/tmp}/airy-test-XXXXXX")
export TMPDIR=$work/tmp XDG_RUNTIME_DIR=$work/run # where private daemons' folders go: seen to be empty again
mkdir "$TMPDIR" "$XDG_RUNTIME_DIR"
started=()
finish() {
    for pid in "${started[@]}"; do kill -KILL "$pid" 2>/dev/null; done
    chmod -R u+w "$work" 2>/dev/null
    rm -rf "$work"
}
trap finish EXIT

. tests/tap.sh
prints() { # extended regular expression on stdout
    why="stdout does not match $1"
    grep -qE -- "$1" "$work/out"
}
lines() {
    why="$(wc -l <"$work/out") lines on stdout, wanted $1"
    [ "$(wc -l <"$work/out")" -eq "$1" ]
}
is_exr() {
    for f; do
        why="$f is not an EXR file"
        [ "$(head -c4 "$f" | od -An -tx1 | tr -d ' ')" = 762f3101 ] || return 1
    done
}
nothing_left() { # no temporary file in the folder, no private daemon's folder
    why="left behind: $(find "$1" "$TMPDIR" "$XDG_RUNTIME_DIR" -name '.*.airy-*' -o -name 'airy-*' -mindepth 1)"
    [ -z "$(find "$1" "$TMPDIR" "$XDG_RUNTIME_DIR" -name '.*.airy-*')" ] &&
        [ -z "$(ls -A "$TMPDIR" "$XDG_RUNTIME_DIR" | grep -v : | grep .)" ]
}
children_of() { grep -lsE "^PPid:[[:space:]]+$1\$" /proc/[0-9]*/status | cut -d/ -f3; }
gone() { ! kill -0 "$1" 2>/dev/null || grep -q '^State:.Z' "/proc/$1/status" 2>/dev/null; }

"$SCENE" "$work/in.exr" 192 108 || exit 1
mkdir "$work/seq"
for i in 0001 0002 0003 0005 10001; do cp "$work/in.exr" "$work/seq/in.$i.exr"; done
head -c 3000 "$work/in.exr" >"$work/seq/in.0004.exr"

# ---- words -------------------------------------------------------------------------------------
t() { exits 0 "$AIRY" --version && prints '^airy [0-9]+\.[0-9]+\.[0-9]+$'; }
check "--version" t
t() {
    exits 0 "$AIRY" bloom --help && cp "$work/out" "$work/help" && exits 0 "$AIRY" help bloom && same "$work/help" "$work/out" &&
        prints '--threshold N' && prints 'threshold_unit; -32.0 to 1e30; default 1.0' && prints 'default[[:space:]]*$|knee\]'
}
check "help from the table" t
t() { exits 2 "$AIRY" bloom --thresold 2 a b && says 'did you mean --threshold?'; }
check "the nearest option" t
t() { exits 2 "$AIRY" blom && says 'did you mean airy bloom?'; }
check "the nearest command" t
t() {
    exits 2 "$AIRY" && exits 2 "$AIRY" bloom && exits 2 "$AIRY" bloom a && exits 2 "$AIRY" bloom a b c &&
        exits 2 "$AIRY" bloom a b -o c && exits 2 "$AIRY" bloom a b --jobs 0 && exits 2 "$AIRY" bloom a b --threshold &&
        exits 2 "$AIRY" bloom a b --json=1 && exits 2 "$AIRY" bloom a b --socket x --device cpu && exits 2 "$AIRY" status x
}
check "command lines that are none" t
t() {
    exits 2 "$AIRY" bloom "$work/seq/in.####.exr" "$work/out.exr" -f 1-3 && says 'no frame token' &&
        exits 2 "$AIRY" bloom "$work/seq/in.####.exr" "$work/out.exr" && says 'no frame token' &&
        exits 2 "$AIRY" bloom "$work/in.exr" "$work/out.####.exr" -f 1-3 && says 'no frame token' &&
        exits 2 "$AIRY" bloom "$work/seq/in.####.exr" "$work/o.####.exr" -f 1-x && says '1-100x2' && nothing_left "$work"
}
check "patterns and ranges that are none" t

# ---- one frame, a private daemon -------------------------------------------------------------------
t() {
    exits 0 "$AIRY" bloom "$work/in.exr" "$work/out.exr" && is_exr "$work/out.exr" && says 'plan' && says 'energy' &&
        lines 0 && ! cmp -s "$work/in.exr" "$work/out.exr" && nothing_left "$work"
}
check "one frame, no flag, a private daemon" t
t() {
    exits 0 "$AIRY" bloom "$work/in.exr" "$work/out2.exr" --json -q && lines 1 &&
        prints '^\{"frame":null,"input":".*in\.exr","output":".*out2\.exr","status":"done","stamp":"airyd [0-9.]+; params: .*xxh3:[0-9a-f]{32}","error_bound":[0-9.e-]+,"plan":".+","rule":"R[0-9]' &&
        prints '"energy":\{"input":[0-9.e+]+,' && prints '"targets":\[\{"name":' && prints '"ms":\{"queue":' &&
        prints '"device":".+","notes":\[' && [ ! -s "$work/err" ] && same "$work/out2.exr" "$work/out.exr"
}
check "--json says the same, and the same bytes come" t
t() {
    exits 2 "$AIRY" bloom "$work/in.exr" "$work/no.exr" --threshold nan --json && says 'threshold = nan' &&
        prints '"error":\{"code":201,"symbol":"PARAM_RANGE","field":"params.threshold"' && prints '"exit_status":2' &&
        [ ! -e "$work/no.exr" ] && exits 2 "$AIRY" bloom "$work/in.exr" "$work/no.exr" --psf gaussians:sigma=-1,weight=1 &&
        says 'params.psf' && nothing_left "$work"
}
check "a parameter out of range" t
t() {
    exits 3 "$AIRY" bloom "$work/none.exr" "$work/no.exr" && says 'none.exr: No such file' &&
        exits 3 "$AIRY" bloom "$work" "$work/no.exr" && says 'not a regular file' &&
        exits 3 "$AIRY" bloom "$work/seq/in.0004.exr" "$work/no.exr" && says '[EXR_DAMAGED 301]' &&
        exits 3 "$AIRY" bloom "$0" "$work/no.exr" && says '[NOT_EXR 300]' &&
        exits 3 "$AIRY" bloom "$work/in.exr" "$work/no.exr" --part nope && says 'NO_PART' &&
        exits 3 "$AIRY" bloom "$work/what.####.exr" "$work/no.####.exr" && says 'no file is named' &&
        [ ! -e "$work/no.exr" ] && nothing_left "$work"
}
check "inputs that are none" t
t() { exits 1 env AIRYD=/nonexistent/airyd "$AIRY" bloom "$work/in.exr" "$work/no.exr" && says 'airyd cannot be run' && nothing_left "$work"; }
check "no airyd to start" t
t() { exits 1 env AIRYD=/bin/false "$AIRY" bloom "$work/in.exr" "$work/no.exr" && says 'ended with status 1' && nothing_left "$work"; }
check "an airyd that does not stay" t
t() {
    exits 5 "$AIRY" bloom "$work/in.exr" "$work/no.exr" --socket "$work/none.sock" && says 'none.sock' &&
        exits 5 "$AIRY" status --socket "$work/none.sock" && says 'none.sock' && [ ! -e "$work/no.exr" ]
}
check "no daemon at --socket" t

# ---- a daemon of our own for the rest ----------------------------------------------------------------
"$AIRYD" --warm common --socket "$work/d.sock" 2>"$work/airyd.log" &
daemon=$!
started+=("$daemon")
wait_for 200 "$AIRY" status --socket "$work/d.sock" >/dev/null 2>&1
bloom() { "$AIRY" bloom --socket "$work/d.sock" "$@"; }

t() {
    exits 0 "$AIRY" status --socket "$work/d.sock" && prints '^airyd/' &&
        exits 0 "$AIRY" status --json --socket "$work/d.sock" && lines 1 && prints '"device_kind":"[cg]pu".*"draining":false\}$' &&
        exits 0 env AIRY_SOCKET="$work/d.sock" "$AIRY" status
}
check "status" t
t() {
    rm -rf "$work/o" && mkdir "$work/o" &&
        exits 3 bloom "$work/seq/in.####.exr" -o "$work/o/out.####.exr" --json && lines 6 && says 'in.0004.exr' &&
        is_exr "$work"/o/out.{0001,0002,0003,0005,10001}.exr && [ ! -e "$work/o/out.0004.exr" ] &&
        [ "$(grep -c '"error":' "$work/out")" -eq 1 ] && grep '"error":' "$work/out" | grep -q '^{"frame":4,' &&
        same "$work/o/out.0005.exr" "$work/out.exr" && nothing_left "$work/o"
}
check "frames from disk; a bad one does not stop the rest" t
t() {
    rm -rf "$work/o" && mkdir "$work/o" && exits 0 bloom "$work/seq/in.%04d.exr" "$work/o/\$F2.exr" -f 5-1x2 -j 2 &&
        [ "$(ls "$work/o" | tr '\n' ' ')" = "01.exr 03.exr 05.exr " ] && says '3 of 3 frames done'
}
check "a range with a step, backwards" t
t() {
    rm -rf "$work/o" && mkdir "$work/o" && exits 3 bloom "$work/seq/in.@@@@.exr" "$work/o/@.exr" -f 1,7 -q &&
        says 'in.0007.exr: No such file' && is_exr "$work/o/1.exr" && [ "$(wc -l <"$work/err")" -eq 1 ]
}
check "a missing frame; quiet" t

# ---- plans, and images by their files --------------------------------------------------------------------
plan() { "$AIRY" plan --socket "$work/d.sock" "$@"; }
t() {
    exits 0 plan "$work/in.exr" && prints '^    plan     .+' && prints '^    error    <= ' && prints '^  skipped +depends on the pixels' &&
        exits 0 plan "$work/in.exr" --json && lines 1 &&
        prints '^\{"input":".*in\.exr","targets":\[\{"name":".+,"width":192,"height":108,.*"plan":".+","rule":".+","levels":[0-9]+,"storage":' &&
        exits 2 plan "$work/in.exr" --tolerance 7 && says 'params.tolerance' && exits 3 plan "$work/none.exr" && exits 2 plan &&
        exits 2 plan "$work/in.exr" x.exr && exits 2 plan "$work/in.exr" -o x.exr && says 'nothing is written' &&
        exits 3 plan "$work/seq/in.0004.exr" --part 9 && exits 0 "$AIRY" help plan && [ ! -e x.exr ]
}
check "airy plan" t
t() {
    rm -rf "$work/o" && mkdir "$work/o" &&
        exits 0 bloom "$work/seq/in.####.exr" -o "$work/o/####.exr" -f 1-3 --dirt "$work/in.exr" && is_exr "$work"/o/000{1,2,3}.exr &&
        exits 0 plan "$work/in.exr" --dirt "$work/in.exr" &&
        exits 3 bloom "$work/in.exr" "$work/o/no.exr" --dirt "$work/seq/in.0004.exr" && says 'in.0004.exr' && [ ! -e "$work/o/no.exr" ] &&
        exits 3 bloom "$work/in.exr" "$work/o/no.exr" --dirt 0123456789abcdef0123456789abcdef && says '[NO_ASSET 223]' &&
        exits 0 "$AIRY" bloom "$work/in.exr" "$work/o/private.exr" --dirt "$work/in.exr" && is_exr "$work/o/private.exr" && nothing_left "$work/o"
}
check "--dirt FILE is sent once, and missed when it is not kept" t
t() { exits 0 plan "$work/in.exr" --threshold-unit linear && exits 0 plan "$work/in.exr" --threshold_unit=linear && exits 0 plan "$work/in.exr" --budget-ms 0; }
check "dashes for underscores" t

# ---- what one may ask for ----------------------------------------------------------------------------------
fresh() { rm -rf "$work/o" && mkdir "$work/o"; }
takes() { # options: done, said, and another picture than the one that came
    exits 0 bloom "$work/in.exr" "$work/o/out.exr" "$@" && is_exr "$work/o/out.exr" && says "plan" &&
        why="$* changed nothing" && ! cmp -s "$work/in.exr" "$work/o/out.exr"
}
refuses() { # status text options
    local status=$1 text=$2
    shift 2
    exits "$status" bloom "$work/in.exr" "$work/o/no.exr" "$@" && says "$text" && why="$* left a file" && [ ! -e "$work/o/no.exr" ]
}
holds() { # text in the last output's bytes: a channel's name in the header
    why="the output has no $1"
    grep -qaF -- "$1" "$work/o/out.exr"
}
t() {
    fresh && takes --firefly 4 && says 'by firefly' && takes --clamp 2 && says 'taken by clamp' &&
        takes --threshold-unit stops --threshold -1 && takes --exposure auto && says 'exposure' &&
        takes --matte A --emission 2 && takes --bright luminance --near 2 --far .5
}
check "where the glow comes from" t
t() {
    fresh && takes --display aces --encoding srgb && takes --composite mix --intensity .5 && takes --edge fill && says '0 lost' &&
        takes --show bright && takes --show bloom && takes --show level:1 && takes --show residual &&
        takes --layers bright/bloom && holds airy.bright.R && holds airy.bloom.B &&
        takes --grow 16 && says 'the 16 pixels that it grew by' && takes --grow 2% && takes --grow 1mm
}
check "where it goes" t
t() {
    fresh && takes --psf octaves:sigma=2,count=5 && takes --psf halation:sigma=9/5/3,gain=.1/.02/.01 &&
        takes --psf eye && says 'by FFT' && takes --psf airy:f=16 && takes --psf aperture:blades=5 &&
        takes --psf "image:$work/in.exr,weight=.2" && takes --dirt "$work/in.exr" --dirt-gain .5
}
check "every point spread function" t
t() {
    fresh
    for look in half-gaussian mip-chain three-scale jimenez airy-eight; do
        takes --look $look && says "plan     $look:" && exits 0 plan "$work/in.exr" --look $look && prints "plan     $look:" || return 1
    done
    why="a look with its light, and nothing lost" && exits 0 bloom "$work/in.exr" "$work/o/out.exr" --look jimenez --radius 1 --legacy-gain on &&
        grep -q 'bright, ' "$work/err" && ! grep -q 'lost at' "$work/err" && takes --look three-scale --kawase 2 --stages 6 --tint 1:.5:.2 &&
        takes --look mip-chain --sun x=50%,y=20%,radius=5%
}
check "every look" t
t() {
    fresh && exits 0 bloom "$work/in.exr" "$work/o/off.exr" --bloom off && says 'handed on as it was' && same "$work/in.exr" "$work/o/off.exr" &&
        exits 0 plan "$work/in.exr" --bloom off && prints 'no glow: bloom=off' && takes --bloom off --display aces
}
check "--bloom off hands on the very file" t
t() {
    fresh && takes --budget-ms 100000 && refuses 2 'params.budget_ms: budget_ms = 1e-06: the cheapest plan' --budget-ms 0.000001 &&
        exits 2 plan "$work/in.exr" --budget-ms 0.000001 && says '[PARAM_CONFLICT 203]'
}
check "a budget, and one that cannot be" t
t() {
    fresh && refuses 2 'look = jimenez does not have it' --look jimenez --psf eye && refuses 2 'look = none does not have it' --radius 2 &&
        refuses 2 'no such point spread function; known: gaussians' --psf gauss && refuses 2 'weight=... is missing' --psf gaussians:sigma=4 &&
        refuses 2 '--show (params.view): ' --show level:9 && refuses 2 'level:0 to level:3' --show level:9 && refuses 2 '--show' --show nope &&
        refuses 2 'was given before' --layers bright/bright && refuses 2 'there is no dirt' --dirt-gain .5 &&
        refuses 2 'there is no matte' --emission 2 && refuses 2 'at most 1' --composite mix --intensity 2 &&
        refuses 2 'a threshold in stops is to be given' --threshold-unit stops && refuses 2 'exposure is not auto' --key .2 &&
        refuses 2 'params.edge' --edge fill --psf eye && refuses 2 'a length from 0 to 16384 px' --grow 20000 &&
        refuses 3 "layer 'nope' asked for" --source nope && refuses 3 "channel 'nope' asked for" --matte nope &&
        refuses 3 'params.dirt: nope.exr: No such file' --dirt nope.exr &&
        refuses 3 'params.psf: nope.exr: No such file' --psf image:nope.exr,weight=1 &&
        exits 3 plan "$work/in.exr" --dirt nope.exr && says 'nope.exr: No such file' && nothing_left "$work/o"
}
check "what contradicts, and what is not there, is named" t

# ---- outputs that cannot be ----------------------------------------------------------------------------
old() { rm -rf "$work/o" && mkdir "$work/o" && echo old >"$work/o/out.exr" && cp "$work/o/out.exr" "$work/old"; }
t() {
    exits 4 bloom "$work/in.exr" "$work/missing/out.exr" && says 'missing/' && says 'No such file' &&
        exits 4 bloom "$work/in.exr" "$work/o" && says 'not a regular file' &&
        exits 4 bloom "$work/in.exr" /dev/null && says '/dev/null' && [ -c /dev/null ]
}
check "an output that is no place for a file" t
t() {
    old && exits 4 bash -c 'ulimit -f 4; exec "$@"' - "$AIRY" bloom --socket "$work/d.sock" "$work/in.exr" "$work/o/out.exr" &&
        says 'out.exr: cannot be written: File too large' && same "$work/o/out.exr" "$work/old" && nothing_left "$work/o"
}
check "no room: the old file stays" t
t() { old && exits 4 bloom --no-overwrite "$work/in.exr" "$work/o/out.exr" && same "$work/o/out.exr" "$work/old" && exits 0 bloom --no-overwrite "$work/in.exr" "$work/o/new.exr" && is_exr "$work/o/new.exr"; }
check "--no-overwrite" t
t() {
    old && chmod 640 "$work/o/out.exr" && ln -s out.exr "$work/o/link.exr" && exits 0 bloom "$work/in.exr" "$work/o/link.exr" &&
        is_exr "$work/o/out.exr" && [ -L "$work/o/link.exr" ] && [ "$(stat -c %a "$work/o/out.exr")" = 640 ] &&
        cp "$work/in.exr" "$work/o/self.exr" && exits 0 bloom "$work/o/self.exr" "$work/o/self.exr" && same "$work/o/self.exr" "$work/out.exr"
}
check "links and modes stay; onto itself" t
t() { exits 4 bash -c '"$@" >/dev/full' - "$AIRY" bloom --socket "$work/d.sock" "$work/in.exr" "$work/o/f.exr" --json; }
check "standard output that is full" t
if [ "$(id -u)" = 0 ] && ! command -v setpriv >/dev/null; then
    skip "no permission" "root, and no setpriv"
else
    t() {
        local as=()
        old && cp "$AIRY" "$work/airy" && chmod 755 "$work" "$work/airy" && chmod 666 "$work/d.sock" &&
            chmod 644 "$work/in.exr" && chmod 555 "$work/o" || return 1
        [ "$(id -u)" = 0 ] && as=(setpriv --reuid=65534 --regid=65534 --clear-groups)
        exits 4 "${as[@]}" "$work/airy" bloom --socket "$work/d.sock" "$work/in.exr" "$work/o/out.exr" &&
            says 'Permission denied' && same "$work/o/out.exr" "$work/old" && nothing_left "$work/o"
    }
    check "no permission: the old file stays" t
    chmod 755 "$work/o"
fi

# ---- sudden ends ------------------------------------------------------------------------------------------
mkdir "$work/many" "$work/many.out"
for i in $(seq 1 400); do ln "$work/in.exr" "$work/many/$i.exr"; done
begin_many() { # a private daemon with a lot to do; sets pid and child
    rm -f "$work"/many.out/*
    echo old >"$work/many.out/400.exr"
    "$AIRY" bloom "$work/many/@.exr" "$work/many.out/@.exr" -f 1-400 >"$work/out" 2>"$work/err" &
    pid=$!
    started+=("$pid")
    why="it did not begin"
    wait_for 200 test -e "$work/many.out/3.exr" || return 1
    child=$(children_of "$pid" | head -1)
    why="no private daemon"
    [ -n "$child" ] && started+=("$child")
}
all_whole() {
    for f in "$work"/many.out/*; do
        [ "$(stat -c %s "$f")" -eq "$(stat -c %s "$work/out.exr")" ] || [ "$(cat "$f")" = old ] || return 1
    done
}
t() {
    begin_many && kill -TERM "$pid" && wait "$pid"
    local status=$?
    why="exit status $status" && [ $status -eq 143 ] && why="the private daemon stays" && wait_for 200 gone "$child" &&
        why="a file is not whole" && all_whole && wait_for 200 nothing_left "$work/many.out"
}
check "SIGTERM: nothing half-written, no daemon, no folder" t
t() {
    begin_many && kill -KILL "$pid" && wait "$pid" 2>/dev/null
    why="the private daemon stays" && wait_for 200 gone "$child" || return 1
    rm -f "$work"/many.out/.*.airy-* # what even the kernel cannot clean up after kill -9
    why="a file is not whole" && all_whole && rm -rf "$XDG_RUNTIME_DIR"/airy-* "$TMPDIR"/airy-*
}
check "kill -9: the private daemon goes" t
t() {
    begin_many && kill -KILL "$child"
    wait "$pid"
    local status=$?
    why="exit status $status, $(ls "$work/many.out" | wc -l) files" && [ $status -eq 0 ] &&
        [ "$(ls "$work/many.out" | wc -l)" -eq 400 ] && is_exr "$work"/many.out/*.exr && nothing_left "$work/many.out"
}
check "a private daemon that dies is started again, and no frame is lost" t
t() {
    kill -TERM "$daemon" && wait "$daemon"
    local status=$?
    why="exit status $status" && [ $status -eq 0 ]
}
check "the daemon ends on SIGTERM" t

finish_tap
