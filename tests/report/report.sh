#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# report.sh [--quick|--tiny] - what `make report` runs after the build: measures into $BUILD/report/*.csv and makes
# $BUILD/report/index.html of them. AIRY_REPORT_LARGE=1: the 16K frame too. AIRY_REPORT_FRAMES: a folder of real EXR frames
# (default ../shared/frames beside the checkout). AIRY_REPORT_DIR: where to, instead.
set -eu
cd "$(dirname "$0")/../.."
BUILD=${BUILD:-build}
dir=${AIRY_REPORT_DIR:-$BUILD/report}
frames=${AIRY_REPORT_FRAMES:-../shared/frames}
extent=${1:-}
case $extent in
'' | --quick | --tiny) ;;
*) echo "Usage: report.sh [--quick|--tiny]" >&2; exit 2 ;;
esac
export BUILD AIRYD=${AIRYD:-$BUILD/airyd} AIRY=${AIRY:-$BUILD/airy}
export MESA_SHADER_CACHE_DIR=${MESA_SHADER_CACHE_DIR:-$PWD/$BUILD/shader-cache}
mkdir -p "$dir"
rm -rf "$dir"/*.csv "$dir/pictures" "$dir/index.html"
start=$SECONDS

set -- "$dir"
[ -n "$extent" ] && set -- "$extent" "$@"
[ -n "${AIRY_REPORT_LARGE:-}" ] && set -- --large "$@"
if [ -d "$frames" ] && [ "$extent" != --tiny ]; then set -- --frames "$frames" "$@"; fi
"$BUILD/bench/airy_report" "$@"

hard=$BUILD/tests/test_hard
if [ "$extent" = --tiny ]; then
    printf '"hard","left out of a tiny report"\n' >>"$dir/notes.csv"
elif [ -x "$hard" ]; then
    echo "hard cases"
    AIRY_HARD_CSV=$dir/hard.csv "$hard" >"$dir/hard.log" 2>&1 ||
        printf '"hard","%s failed: see hard.log"\n' test_hard >>"$dir/notes.csv"
else
    printf '"hard","there is no test_hard"\n' >>"$dir/notes.csv"
fi

echo "peers"
case $extent in
--tiny) AIRY_REPORT_PEERS=none bash tests/report/peers.sh "$dir" 1 256 256 ;;
--quick) bash tests/report/peers.sh "$dir" 1 ;;
*) bash tests/report/peers.sh "$dir" 3 ;;
esac
echo "pictures"
case $extent in
--tiny) bash tests/report/pictures.sh "$dir" 160 90 ;;
*) bash tests/report/pictures.sh "$dir" ;;
esac
"$BUILD/bench/report_page" "$dir"
echo "$((SECONDS - start)) s: $dir/index.html"
