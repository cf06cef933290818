#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# run.sh - runs what `make check` has built, counts TAP lines, and ends in one line: N passed, N failed,
# N skipped. A test counts as skipped only when it says so itself, with the reason; a program that dies or
# announces more tests than it reports has failed.
set -u
cd "$(dirname "$0")/.."
BUILD=${BUILD:-build}
LOGS=$BUILD/check
mkdir -p "$LOGS"
export CMOCKA_MESSAGE_OUTPUT=TAP
export MESA_SHADER_CACHE_DIR=${MESA_SHADER_CACHE_DIR:-$PWD/$BUILD/shader-cache}
export ASAN_OPTIONS=detect_leaks=1:abort_on_error=0
export UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1
export LSAN_OPTIONS=suppressions=$PWD/tests/lsan.supp:print_suppressions=0
export TSAN_OPTIONS=suppressions=$PWD/tests/tsan.supp:halt_on_error=1:history_size=4
passed=0 failed=0 skipped=0

run() { # label command...
    label=$1
    shift
    log=$LOGS/$label.log
    start=$SECONDS
    timeout 900 "$@" >"$log" 2>&1
    status=$?
    # cmocka says "not ok 3 # SKIP name", scripts say "ok 3 - name # SKIP reason".
    s=$(grep -cE '^(not )?ok .*# *SKIP' "$log")
    p=$(grep -E '^ok ' "$log" | grep -cvE '# *SKIP')
    f=$(grep -E '^not ok ' "$log" | grep -cvE '# *SKIP')
    plan=$(grep -oE '^1\.\.[0-9]+' "$log" | head -1 | cut -c4-)
    if [ -z "$plan" ] || [ $((p + s + f)) -ne "${plan:-0}" ] || { [ $status -ne 0 ] && [ "$f" -eq 0 ]; }; then
        f=$((f + 1))
        echo "# $label: exit status $status after $((p + s + f - 1)) of ${plan:-?} tests" >>"$log"
    fi
    passed=$((passed + p)) failed=$((failed + f)) skipped=$((skipped + s))
    printf '%-24s %4d passed %3d failed %3d skipped  %3d s\n' "$label" "$p" "$f" "$s" $((SECONDS - start))
    grep -E '^(not )?ok .*# *SKIP|SKIPPED \\]' "$log" | sed -E 's/^(not )?ok [0-9]*/    skipped:/; s/^/    /'
    if [ "$f" -gt 0 ]; then
        grep -nE -A12 '^not ok|ERROR: |runtime error|WARNING: ThreadSanitizer|validation:|^# ' "$log" | head -60
        tail -15 "$log"
    fi
}

for t in psf plan frame params params_check reference reference_pipeline wire conn libairy libairy_request libairy_bad frames exr exr_layers exr_grow exr_bad raw engine look kernel convolve hard hard_slide hard_picture hard_kernel property sched \
    asset libairy_asset server server_assets server_life server_frames server_looks; do
    [ -e tests/test_$t.c ] && AIRYD=$BUILD/airyd AIRY=$BUILD/airy run "$t" "$BUILD/tests/test_$t"
done
for s in tests/test_*.sh; do
    [ -e "$s" ] && AIRYD=$BUILD/airyd AIRY=$BUILD/airy run "$(basename "${s%.sh}" | sed 's/^test_//')" bash "$s"
done
A=$BUILD/asan
# The loader unloads the driver before leaks are looked for, and then nothing can tell whose they are: keep it.
# (The validation layer cannot be kept so, and the plain run has it.)
keep="env AIRY_TEST_VALIDATE=0 LD_PRELOAD=libvulkan_lvp.so ASAN_OPTIONS=$ASAN_OPTIONS:verify_asan_link_order=0"
for t in psf plan frame params params_check reference reference_pipeline wire conn libairy libairy_request libairy_bad frames exr exr_layers exr_grow exr_bad raw \
    asset libairy_asset server server_assets server_life server_frames server_looks; do
    [ -e tests/test_$t.c ] && AIRYD=$A/airyd AIRY=$A/airy run "asan-$t" "$A/tests/test_$t"
done
for t in engine look kernel convolve hard hard_slide hard_picture hard_kernel sched; do
    run "asan-$t" $keep "$A/tests/test_$t"
done
run asan-property $keep AIRY_SCENES=60 "$A/tests/test_property"
S=$BUILD/tsan
# The driver's compiler holds more locks at once than the deadlock detector can count, once many pipelines have drawn.
AIRYD=$S/airyd run tsan-server_looks env TSAN_OPTIONS=$TSAN_OPTIONS:detect_deadlocks=0 "$S/tests/test_server_looks"
for t in conn libairy libairy_request libairy_asset asset exr server server_assets server_life server_frames; do
    [ -e tests/test_$t.c ] && AIRYD=$S/airyd AIRY=$S/airy run "tsan-$t" "$S/tests/test_$t"
done
# The driver's compiler holds more locks at once than the deadlock detector can count (its own CHECK fails).
run tsan-sched env LD_PRELOAD=libvulkan_lvp.so TSAN_OPTIONS=$TSAN_OPTIONS:detect_deadlocks=0 "$S/tests/test_sched"

echo "$passed passed, $failed failed, $skipped skipped"
[ "$failed" -eq 0 ]
