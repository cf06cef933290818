#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_python.sh - the Python package: its types, the golden vectors, the conformance suite and more against live daemons, a
# daemon that lies, the examples, and a wheel. Prints TAP. AIRY and AIRYD name the programs, SCENE the picture maker.
set -u
cd "$(dirname "$0")/.."
. tests/programs.sh
export PYTHONDONTWRITEBYTECODE=1
unset XDG_RUNTIME_DIR

python=$(find_python)
if [ -z "$python" ]; then
    echo "ok 1 - the Python client # SKIP no Python 3.11 with protobuf: install python3-protobuf"
    echo "1..1"
    exit 0
fi
make --no-print-directory -s python BUILD="$BUILD" || exit 1
export PYTHONPATH=$PWD/$BUILD/python

work=$(mktemp -d "${TMPDIR:-/tmp}/airy-python-XXXXXX")
daemon=
finish() {
    [ -z "$daemon" ] || kill -KILL "$daemon" 2>/dev/null
    rm -rf "$work"
}
trap finish EXIT

n=0 failures=0
passed() { # description
    n=$((n + 1))
    echo "ok $n - $1"
}
failed() { # description, file with the reason
    n=$((n + 1))
    failures=$((failures + 1))
    echo "not ok $n - $1"
    tail -40 "$2" | sed 's/^/# /'
}
skip() {
    n=$((n + 1))
    echo "ok $n - $1 # SKIP $2"
}
check() { # description, command...
    local what=$1
    shift
    if "$@" >"$work/log" 2>&1; then passed "$what"; else failed "$what" "$work/log"; fi
}

# Each prints TAP of its own: its lines are numbered anew, and its plan must agree.
for t in vectors peer conformance live; do
    timeout 400 "$python" -W always::ResourceWarning "client/python/tests/test_$t.py" >"$work/out" 2>"$work/err"
    status=$?
    plan=$(sed -n 's/^1\.\.//p' "$work/out")
    lines=$(grep -cE '^(not )?ok ' "$work/out")
    while IFS= read -r line; do
        case $line in
        "ok "* | "not ok "*)
            n=$((n + 1))
            echo "$line" | sed -E "s/^(not )?ok [0-9]+ - /\1ok $n - $t: /"
            case $line in not*) failures=$((failures + 1)) ;; esac
            ;;
        "# "*) echo "$line" ;;
        esac
    done <"$work/out"
    if grep -E 'ResourceWarning|RuntimeWarning|never awaited|never retrieved' "$work/err"; then
        failed "$t leaves nothing behind" "$work/err"
    fi
    if [ "${plan:-x}" != "$lines" ] || { [ $status -ne 0 ] && ! grep -q '^not ok' "$work/out"; }; then
        echo "exit status $status after $lines of ${plan:-?} tests" >>"$work/err"
        failed "$t ran to its end" "$work/err"
    fi
done

if command -v mypy >/dev/null; then
    MYPYPATH=$PYTHONPATH check "types, by mypy --strict" mypy --config-file client/python/pyproject.toml \
        --cache-dir "$work/mypy" -p airy
else
    skip "types" "no mypy: install mypy"
fi

# ---- what a reader pastes --------------------------------------------------------------------------
"$AIRYD" --warm common --socket "$work/airyd.sock" 2>"$work/airyd.log" &
daemon=$!
export AIRY_SOCKET=$work/airyd.sock
tries=0
until "$AIRY" status >/dev/null 2>&1 || [ $tries -gt 600 ]; do
    tries=$((tries + 1))
    sleep 0.1
done
"$SCENE" "$work/in.exr" 192 108
"$AIRY" bloom "$work/in.exr" "$work/command.exr" --threshold 0.8 -q

frame() {
    "$python" client/python/examples/bloom_frame.py "$work/in.exr" "$work/out.exr" && cmp "$work/out.exr" "$work/command.exr" &&
        [ "$(wc -l <client/python/examples/bloom_frame.py)" -le 10 ]
}
check "examples/bloom_frame.py writes what airy bloom writes" frame

watches() { # a frame that lies there, one that is moved in, one that is damaged, and one after that
    mkdir "$work/from" "$work/to"
    cp "$work/in.exr" "$work/from/a.exr"
    "$python" client/python/examples/watch_folder.py "$work/from" "$work/to" &
    local watcher=$! tries=0
    head -c 3000 "$work/in.exr" >"$work/from/bad.exr"
    cp "$work/in.exr" "$work/b" && mv "$work/b" "$work/from/b.exr"
    until [ -e "$work/to/a.exr" ] && [ -e "$work/to/b.exr" ] || [ $tries -gt 300 ]; do
        tries=$((tries + 1))
        sleep 0.1
    done
    kill -TERM $watcher
    wait $watcher
    "$AIRY" bloom "$work/in.exr" "$work/plain.exr" -q && cmp "$work/to/a.exr" "$work/plain.exr" && cmp "$work/to/b.exr" "$work/plain.exr" &&
        [ ! -e "$work/to/bad.exr" ]
}
check "examples/watch_folder.py blooms what comes, and survives a damaged frame" watches

batches() { # all good frames of a folder, with a damaged one among them; then only what is missing
    mkdir "$work/batch" "$work/done"
    for i in 1 2 3; do cp "$work/in.exr" "$work/batch/$i.exr"; done
    head -c 3000 "$work/in.exr" >"$work/batch/bad.exr"
    "$python" client/python/examples/batch_folder.py "$work/batch" "$work/done" threshold=0.8
    [ $? -eq 1 ] || return 1
    for i in 1 2 3; do cmp "$work/done/$i.exr" "$work/command.exr" || return 1; done
    [ ! -e "$work/done/bad.exr" ] && rm "$work/batch/bad.exr" "$work/done/2.exr" &&
        "$python" client/python/examples/batch_folder.py "$work/batch" "$work/done" threshold=0.8 2>"$work/said" &&
        grep -q '1/1 ' "$work/said" && cmp "$work/done/2.exr" "$work/command.exr"
}
check "examples/batch_folder.py blooms a folder, and goes on where it was" batches

printf 'wall: sign\npanels:\n- {name: p, size: [16, 9]}\nboards:\n- {serial: NOT-THERE, panels: p}\n' >"$work/sign.yaml"
feeds() {
    "$python" client/python/examples/wall_feed.py "$work/sign.yaml" 1 >"$work/said" && cat "$work/said" &&
        grep -q '^sign: 144 LEDs, 60 frames/s' "$work/said" && grep -qE '^[1-9][0-9]* frames, [1-9][0-9]* shown' "$work/said"
}
if "$python" -c 'import numpy' 2>/dev/null; then
    check "examples/wall_feed.py feeds a wall" feeds
else
    skip "examples/wall_feed.py" "no NumPy: install python3-numpy"
fi

# ---- a wheel -----------------------------------------------------------------------------------------
wheel() { # built and used outside the tree, by pip or by setuptools alone: no index is asked
    cp -r client/python "$work/package" && cp proto/airy.proto "$work/package/" && mkdir "$work/site" &&
        (cd "$work/package" && if "$python" -m pip --version >/dev/null 2>&1; then
            "$python" -m pip wheel --no-index --no-deps --no-build-isolation --no-cache-dir --disable-pip-version-check --wheel-dir ../wheel .
        else
            "$python" -c 'from setuptools import build_meta as b; print(b.build_wheel("../wheel"))'
        fi) &&
        (cd "$work/site" && "$python" -m zipfile -e "$work"/wheel/airy-*.whl .) &&
        PYTHONPATH=$work/site "$python" -c '
import airy, sys
assert airy.__file__.startswith(sys.argv[1]), airy.__file__
with airy.Client() as c:
    assert c.bloom(sys.argv[2], threshold=0.8).tobytes() == open(sys.argv[3], "rb").read()
' "$work/site" "$work/in.exr" "$work/command.exr"
}
if "$python" -c 'import setuptools, wheel' 2>/dev/null; then
    check "the wheel holds all that is needed" wheel
else
    skip "the wheel" "no setuptools: install python3-setuptools and python3-wheel"
fi
echo "1..$n"
[ $failures -eq 0 ]
