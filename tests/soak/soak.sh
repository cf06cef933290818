#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# soak.sh - makes the clients' packages and runs soak.py, with MINUTES or LOAD_SECONDS, ROUNDS, SEED and LARGE as soak.py says. Prints TAP.
# AIRY and AIRYD name the programs, SCENE the picture maker, AIRY_NODE the node.
set -u
cd "$(dirname "$0")/../.."
. tests/programs.sh
export WORK NODE NODE_PACKAGE PYTHONPATH PYTHONDONTWRITEBYTECODE=1
export MESA_SHADER_CACHE_DIR=${MESA_SHADER_CACHE_DIR:-$(realpath "$BUILD")/shader-cache}
unset XDG_RUNTIME_DIR

python=$(find_python)
if [ -z "$python" ]; then
    echo "ok 1 - soak # SKIP no Python 3.11 with protobuf: install python3-protobuf"
    echo "1..1"
    exit 0
fi
make --no-print-directory -s python BUILD="$BUILD" >&2 || exit 1
PYTHONPATH=$(realpath "$BUILD")/python

WORK=$(mktemp -d "${TMPDIR:-/tmp}/airy-soak-XXXXXX")
child=
finish() { # whatever it started is its to end; what it could not, by its folder's name in the command line
    [ -z "$child" ] || kill -KILL "$child" 2>/dev/null
    for p in /proc/[0-9]*; do
        tr '\0' ' ' 2>/dev/null <"$p/cmdline" | grep -qF "$WORK/" && kill -KILL "$(basename "$p")" 2>/dev/null
    done
    wait 2>/dev/null
    rm -rf "$WORK"
}
trap finish EXIT
trap 'exit 130' INT TERM

NODE=$(command -v "${AIRY_NODE:-node}")
if [ -n "$NODE" ] && [ "$(printf '%s\n' 18.11 "$("$NODE" -p process.versions.node)" | sort -V | head -1)" = 18.11 ]; then
    NODE_PACKAGE=$WORK/node
    cp -r client/node "$NODE_PACKAGE" && "$NODE" client/node/generate.mjs "$NODE_PACKAGE" >/dev/null || exit 1
else
    NODE=
fi

"$python" tests/soak/soak.py &
child=$!
wait $child
