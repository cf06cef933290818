#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# demo.sh - what `make demo` runs after the build: starts a daemon on a private socket, renders a street at
# night, blooms it through the socket, and leaves EXR and PNG files in $BUILD/demo.
set -eu
cd "$(dirname "$0")/.."
build=${BUILD:-build}
out=$build/demo
mkdir -p "$out"

# A socket's path has little room: not in the build folder, whose name may be long.
run=$(mktemp -d "${TMPDIR:-/tmp}/airy-demo-XXXXXX")
daemon=
finish() {
	status=$?
	trap - EXIT INT TERM
	if [ -n "$daemon" ]; then
		kill -TERM "$daemon" 2>/dev/null || true
		wait "$daemon" 2>/dev/null || true
	fi
	rm -rf "$run"
	exit $status
}
trap finish EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

"$build/airyd" --warm common --socket "$run/airyd.sock" 2>"$out/airyd.log" &
daemon=$!

echo "rendering the scene (1920 x 1080, half RGBA and a float Z, ZIP) -> $out/in.exr"
"$out/scene" "$out/in.exr"

tries=0
until "$build/airy" status --socket "$run/airyd.sock" >/dev/null 2>&1; do
	tries=$((tries + 1))
	if ! kill -0 "$daemon" 2>/dev/null || [ $tries -gt 300 ]; then
		echo "airyd did not start:" >&2
		cat "$out/airyd.log" >&2
		exit 1
	fi
	sleep 0.1
done

# The first frame pays for pages and caches; the second is what a farm sees.
echo "airy bloom $out/in.exr $out/out.exr"
"$build/airy" bloom "$out/in.exr" "$out/out.exr" --socket "$run/airyd.sock" --force --quiet
"$build/airy" bloom "$out/in.exr" "$out/out.exr" --socket "$run/airyd.sock" --force
echo
"$build/airy" status --socket "$run/airyd.sock"
echo

"$out/tonemap" "$out/in.exr" "$out/before.png"
"$out/tonemap" "$out/out.exr" "$out/after.png"
"$out/tonemap" -glow "$out/in.exr" "$out/out.exr" "$out/glow.png"
ls -l "$out"/in.exr "$out"/out.exr "$out"/before.png "$out"/after.png "$out"/glow.png
