#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# pictures.sh DIR [WIDTH HEIGHT] - renders the demo's street, blooms it with the default and with each look through a daemon,
# and leaves before/after PNG files and DIR/pictures.csv. A look that the daemon refuses is a line of DIR/notes.csv.
set -u
BUILD=${BUILD:-build}
dir=$1 width=${2:-960} height=${3:-540}
AIRY=${AIRY:-$BUILD/airy}
work=$(mktemp -d "${TMPDIR:-/tmp}/airy-pictures-XXXXXX")
daemon=
finish() {
    [ -n "$daemon" ] && kill -TERM "$daemon" 2>/dev/null && wait "$daemon"
    rm -rf "$work"
}
trap finish EXIT

"${AIRYD:-$BUILD/airyd}" --warm common --socket "$work/s" 2>"$work/airyd.log" &
daemon=$!
"$BUILD/demo/scene" "$work/in.exr" "$width" "$height" || exit 1
for _ in $(seq 300); do "$AIRY" status --socket "$work/s" >/dev/null 2>&1 && break; sleep .1; done

echo "look,file" >"$dir/pictures.csv"
mkdir -p "$dir/pictures"
shown=0
show() { # name, file, options...
    local name=$1 file=$2
    shift 2
    rm -f "$work/out.exr"
    if ! "$AIRY" bloom "$work/in.exr" "$work/out.exr" --quiet --socket "$work/s" "$@" 2>"$work/err"; then
        printf '"pictures","%s: %s"\n' "$name" "$(tail -1 "$work/err" | tr '"' "'")" >>"$dir/notes.csv"
        return
    fi
    "$BUILD/demo/tonemap" -side "$work/in.exr" "$work/out.exr" "$dir/pictures/$file.png" $((width * 3 / 4)) || exit 1
    printf '"%s","pictures/%s.png"\n' "$name" "$file" >>"$dir/pictures.csv"
    shown=$((shown + 1))
}
show "no look: the default psf" default
for look in half-gaussian mip-chain three-scale jimenez airy-eight; do
    show "look $look" "$look" --look "$look"
done
[ $shown -gt 0 ] # a daemon that refuses all is no daemon
