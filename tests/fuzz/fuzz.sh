#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# fuzz.sh NAME... - runs fuzz targets for MINUTES, shared among them, two at a time; each goes on where it was, in
# build/fuzz/corpus. Ends in a line a target: inputs tried, edges covered, what was found. 1 when anything was.
set -u
cd "$(dirname "$0")/../.."
BUILD=${BUILD:-build} MINUTES=${MINUTES:-30} jobs=2
found=$BUILD/fuzz/found logs=$BUILD/fuzz/logs
mkdir -p "$found" "$logs"
export UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1
# The one with a device: what its driver keeps is known, and the loader shall not unload it before leaks are looked for.
device="env LSAN_OPTIONS=suppressions=tests/lsan.supp:print_suppressions=0 ASAN_OPTIONS=verify_asan_link_order=0 LD_PRELOAD=libvulkan_lvp.so"
seconds=$((MINUTES * 60 * jobs / $#))
[ "$seconds" -gt 0 ] || seconds=1

one() {
    corpus=$BUILD/fuzz/corpus/$1
    mkdir -p "$corpus" "tests/fuzz/regressions/$1"
    with=
    [ "$1" = client ] && with=$device
    nice -n 19 $with "$BUILD/asan/tests/fuzz/fuzz_$1" -max_total_time="$seconds" -timeout=20 -rss_limit_mb=1024 -max_len=65536 \
        -print_final_stats=1 -artifact_prefix="$found/$1-" "$corpus" "$BUILD/fuzz/seeds/$1" "tests/fuzz/regressions/$1" \
        >"$logs/$1.log" 2>&1
    status=$?
    tried=$(sed -n 's/^stat::number_of_executed_units: *//p' "$logs/$1.log")
    edges=$(grep -oE 'cov: [0-9]+' "$logs/$1.log" | tail -1)
    echo "$1: ${tried:-?} inputs, ${edges:-cov: ?}, $([ $status -eq 0 ] && echo nothing found || echo "FOUND something: $logs/$1.log")"
    rmdir "tests/fuzz/regressions/$1" 2>/dev/null
    return $status
}

running=0 failed=0
for name; do
    one "$name" &
    running=$((running + 1))
    if [ "$running" -ge "$jobs" ]; then
        wait -n || failed=1
        running=$((running - 1))
    fi
done
while [ "$running" -gt 0 ]; do
    wait -n || failed=1
    running=$((running - 1))
done
[ "$failed" -eq 0 ] || ls "$found"
exit $failed
