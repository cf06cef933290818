#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# run.sh - runs what `make check` has built, counts TAP lines, and ends in one line: N passed, N failed,
# N skipped. A test counts as skipped only when it says so itself, with the reason; a program that dies, announces more tests than it
# reports, or has none has failed. What failed is said when it does and again at the end. TEST='*sched' runs only what is called so.
set -u
cd "$(dirname "$0")/.."

pure="wall_def wall_layout psf plan frame params params_check reference reference_pipeline wire conn libairy libairy_request libairy_bad \
    libairy_retry libairy_kill bloom_command machine server_faults server_loss \
    frames output exr exr_layers exr_grow exr_bad raw asset libairy_asset libairy_wall wall_text server server_assets server_life server_frames \
    server_limits server_looks server_walls wall_colour wall_pace wall_boards wall_command wall_draw"
device="look engine hard hard_slide hard_picture hard_kernel property kernel convolve sched room server_memory wall_engine"
usb="panel panel_gud usb usb_faults usb_daemon"
# Under TSan, too; `run.sh --threaded` names them.
threaded="conn libairy libairy_request libairy_retry libairy_asset libairy_wall asset wall_pace wall_boards"
threaded_server="server_limits server_faults server_frames server_life server_assets server_walls server_looks server"
if [ "${1:-}" = --threaded ]; then
    printf '%s\n' $threaded $threaded_server $usb sched exr
    exit
fi

BUILD=${BUILD:-build}
LOGS=$BUILD/check
mkdir -p "$LOGS"
export CMOCKA_MESSAGE_OUTPUT=TAP
export MESA_SHADER_CACHE_DIR=${MESA_SHADER_CACHE_DIR:-$PWD/$BUILD/shader-cache}
export ASAN_OPTIONS=detect_leaks=1:abort_on_error=0
export UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1
export LSAN_OPTIONS=suppressions=$PWD/tests/lsan.supp:print_suppressions=0
export TSAN_OPTIONS=suppressions=$PWD/tests/tsan.supp:halt_on_error=1:history_size=4

rm -f "$LOGS"/*.count "$LOGS"/*.failed
export TIMEFORMAT='%U %S'

run() { # label command...
    label=$1
    shift
    [[ $label == $TEST ]] || return 0
    log=$LOGS/$label.log
    start=$SECONDS
    cpu=$({ time timeout 900 "$@" >"$log" 2>&1; } 2>&1)
    status=$?
    # cmocka says "not ok 3 # SKIP name", scripts say "ok 3 - name # SKIP reason".
    s=$(grep -cE '^(not )?ok .*# *SKIP' "$log")
    p=$(grep -E '^ok ' "$log" | grep -cvE '# *SKIP')
    f=$(grep -E '^not ok ' "$log" | grep -cvE '# *SKIP')
    plan=$(grep -oE '^1\.\.[0-9]+' "$log" | head -1 | cut -c4-)
    if [ "${plan:-0}" -eq 0 ] || [ $((p + s + f)) -ne "$plan" ] || { [ $status -ne 0 ] && [ "$f" -eq 0 ]; }; then
        f=$((f + 1))
        echo "# $label: exit status $status after $((p + s + f - 1)) of ${plan:-?} tests" >>"$log"
    fi
    echo "$p $f $s" >"$LOGS/$label.count"
    # In one piece: several write here.
    out=$(
        printf '%-24s %4d passed %3d failed %3d skipped  %3d s, %3.0f + %3.0f of CPU\n' "$label" "$p" "$f" "$s" $((SECONDS - start)) $cpu
        grep -E '^(not )?ok .*# *SKIP|SKIPPED \\]' "$log" | sed -E 's/^(not )?ok [0-9]*/    skipped:/; s/^/    /'
        if [ "$f" -gt 0 ]; then
            grep -nE -A12 '^not ok|ERROR: |runtime error|WARNING: ThreadSanitizer|validation:|^# ' "$log" | head -60
            tail -15 "$log"
        fi
    )
    printf '%s\n' "$out"
    [ "$f" -eq 0 ] || printf '%s\n' "$out" >"$LOGS/$label.failed"
}

A=$BUILD/asan S=$BUILD/tsan
# The loader unloads the driver before leaks are looked for, and then nothing can tell whose they are: keep it.
# (The validation layer cannot be kept so, and the plain run has it.)
keep="env AIRY_TEST_VALIDATE=0 LD_PRELOAD=libvulkan_lvp.so ASAN_OPTIONS=$ASAN_OPTIONS:verify_asan_link_order=0"
# The driver's compiler holds more locks at once than TSan's deadlock detector can count (its own CHECK fails).
many_locks="env TSAN_OPTIONS=$TSAN_OPTIONS:detect_deadlocks=0"
# The driver's optimiser is half of what these take, which draw with hundreds of pipelines: they do without. (All others, and
# `make soak-scenes` and `make report`, have it.)
unoptimised="env GALLIVM_PERF=nopt"

# One line a piece of work: its command, or several that must not run beside each other, first those that take longest (a long one
# that begins last would run alone) and those whose shaders the others then find in the cache.
work() {
    for t in look property; do
        echo "run $t \$unoptimised \$BUILD/tests/test_$t"
    done
    echo "run wall_engine \$BUILD/tests/test_wall_engine"
    echo boards
    for t in $threaded_server; do
        echo "AIRYD=\$S/airyd AIRY=\$S/airy run tsan-$t \$many_locks \$S/tests/test_$t"
    done
    echo "run tsan-sched \$many_locks LD_PRELOAD=libvulkan_lvp.so \$S/tests/test_sched"
    for s in tests/test_*.sh; do
        echo "AIRYD=\$BUILD/airyd AIRY=\$BUILD/airy run $(basename "${s%.sh}" | sed 's/^test_//') bash $s"
    done
    for t in $device; do
        case $t in look | property) continue ;; wall_engine) ;; *) echo "run $t \$BUILD/tests/test_$t" ;; esac
        [ $t = room ] || echo "run asan-$t \$keep \$A/tests/test_$t" # room counts bytes: of the allocator that there is
    done
    echo "run asan-look \$unoptimised \$keep \$A/tests/test_look"
    echo "run asan-property \$unoptimised \$keep AIRY_SCENES=60 \$A/tests/test_property"
    for t in $pure; do
        echo "AIRYD=\$A/airyd AIRY=\$A/airy run asan-$t \$A/tests/test_$t"
        echo "AIRYD=\$BUILD/airyd AIRY=\$BUILD/airy run $t \$BUILD/tests/test_$t"
    done
    for t in $threaded; do
        echo "run tsan-$t \$S/tests/test_$t"
    done
    echo "AIRY_TEST_ONLY='test_t*' run tsan-exr \$S/tests/test_exr"
}

# Programs under umockdev-wrapper, which have an eye on real time; whose leaks are whose cannot be told there (test_server_walls tells
# of the daemon's).
boards() {
    for t in $usb; do
        AIRYD=$BUILD/airyd run "$t" umockdev-wrapper "$BUILD/tests/test_$t"
        AIRYD=$A/airyd run "asan-$t" env ASAN_OPTIONS=$ASAN_OPTIONS:verify_asan_link_order=0:detect_leaks=$([ $t = usb_daemon ] && echo 0 || echo 1) \
            umockdev-wrapper "$A/tests/test_$t"
        # TSan before the emulation, whose close() would hide descriptors' ends from it: every number that comes again would race.
        [ $t = usb_daemon ] || run "tsan-$t" umockdev-wrapper env LD_PRELOAD=libtsan.so.2:libumockdev-preload.so.0 "$S/tests/test_$t"
    done
}

export -f run boards
export TEST=${TEST:-*}
export BUILD LOGS A S keep many_locks unoptimised usb
# What every daemon draws with at its start comes out of the cache then, or many would make it at the same time, each taking that much longer.
"$BUILD/demo/scene" "$LOGS/warm.exr" && AIRYD=$BUILD/airyd "$BUILD/airy" bloom --overwrite "$LOGS/warm.exr" "$LOGS/warm.out.exr" >"$LOGS/warm.log" 2>&1 ||
    { cat "$LOGS/warm.log" && echo "0 1 0" >"$LOGS/warm.count"; }
# One more than there are CPUs: boards, daemons and clients wait much of their time.
work | xargs -d '\n' -P $(($(nproc) + 1)) -n 1 bash -c
# Every program under tests/ is in a list above; one that is not would never run.
for t in tests/test_*.c; do
    t=$(basename "${t%.c}" | sed 's/^test_//')
    [ -e "$LOGS/$t.count" ] || [ "$TEST" != '*' ] || { echo "test_$t did not run: name it in tests/run.sh"; echo "0 1 0" >"$LOGS/$t.count"; }
done
set -- $(cat "$LOGS"/*.count | awk '{ p += $1; f += $2; s += $3 } END { print p + 0, f + 0, s + 0 }')
cat "$LOGS"/*.failed 2>/dev/null
echo "$1 passed, $2 failed, $3 skipped"
[ "$2" -eq 0 ]
