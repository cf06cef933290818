#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_fuzz.sh - every reader of bytes from outside, one test a target of tests/fuzz: all seeds and all inputs that were ever
# found (tests/fuzz/regressions), then a counted number of new inputs, the same everywhere: no crash, leak or time-out,
# memory under a limit. `make fuzz-built` has made the targets and the seeds.
set -u
cd "$(dirname "$0")/.."
BUILD=${BUILD:-build}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export ASAN_OPTIONS=detect_leaks=1 UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1
unset LSAN_OPTIONS

# Inputs beyond the seeds: what takes about 6 s on a slow core.
declare -A runs=([conn]=12000 [body]=30000 [params]=20000 [exr]=4000 [asset]=20000 [wall]=8000 [panel]=60000 [frames]=20000
    [raw]=8000 [libairy]=10000 [client]=1500)

# The one with a device: what its driver keeps is known, and the loader shall not unload it before leaks are looked for.
device="env LSAN_OPTIONS=suppressions=tests/lsan.supp:print_suppressions=0 ASAN_OPTIONS=detect_leaks=1:verify_asan_link_order=0 LD_PRELOAD=libvulkan_lvp.so"

n=0 failed=0
report() { # name status log
    n=$((n + 1))
    if [ "$2" -eq 0 ]; then
        echo "ok $n - $1"
    else
        failed=1
        echo "not ok $n - $1"
        tail -40 "$3" | sed 's/^/# /'
    fi
}

targets=$(cd tests/fuzz && ls fuzz_*.c | sed 's/^fuzz_//; s/\.c$//')
echo "1..$(($(echo "$targets" | wc -w) * 2))"
for t in $targets; do
    fuzz=$BUILD/asan/tests/fuzz/fuzz_$t log=$work/$t.log
    kept=$(find "$BUILD/fuzz/seeds/$t" "tests/fuzz/regressions/$t" -type f 2>/dev/null)
    with=
    [ "$t" = client ] && with=$device
    # Each by itself and to its end, whatever it covers.
    if [ -n "$kept" ]; then
        $with "$fuzz" -timeout=60 -rss_limit_mb=1024 $kept >"$log" 2>&1
        status=$?
    else
        echo "no seeds" >"$log"
        status=1
    fi
    report "$t: seeds and what was found, $(echo "$kept" | wc -w) inputs" "$status" "$log"
    mkdir "$work/$t"
    $with "$fuzz" -seed=1 -runs="${runs[$t]:?}" -timeout=60 -rss_limit_mb=1024 -max_len=16384 -print_final_stats=1 \
        -artifact_prefix="$work/$t-" "$work/$t" "$BUILD/fuzz/seeds/$t" >"$log" 2>&1
    status=$?
    [ $status -eq 0 ] || for input in "$work/$t"-*; do
        [ -f "$input" ] || continue
        mkdir -p "$BUILD/fuzz/found" && cp "$input" "$BUILD/fuzz/found/"
        echo "kept as $BUILD/fuzz/found/$(basename "$input")" >>"$log"
    done
    report "$t: $(sed -n 's/^stat::number_of_executed_units: *//p' "$log") inputs, $(grep -oE 'cov: [0-9]+' "$log" | tail -1 | cut -c6-) edges" "$status" "$log"
done
exit $failed
