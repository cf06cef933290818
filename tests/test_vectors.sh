#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_vectors.sh - proto/vectors are what `make vectors` writes, byte for byte and file for file, twice the same; and the fields that
# tell a client what is done already are in one of them. What they mean is judged by test_wire, and by the clients' own tests.
set -u
cd "$(dirname "$0")/.."
BUILD=${BUILD:-build}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
. tests/tap.sh

t() {
    mkdir "$work/v" && exits 0 "$BUILD/tests/make_vectors" "$work/v" && why="make vectors, then look: $(diff -rq "$work/v" proto/vectors | tr '\n' ';')" &&
        diff -r "$work/v" proto/vectors >/dev/null && why="only $(ls "$work/v" | wc -l) files" && [ "$(ls "$work/v" | wc -l)" -gt 100 ]
}
check "proto/vectors are what make vectors writes" t
t() { # airy.proto's fields that the whole of a farm's "done is done" rests on
    for field in '"planOnly": true' '"stamp": "airyd ' '"kind": "FILE"'; do
        why="no vector has $field" && grep -lqF "$field" proto/vectors/*.json || return 1
    done
}
check "a plan is asked for, and a stamp is told, in a vector" t
t() {
    exits 2 "$BUILD/tests/make_vectors" && exits 1 "$BUILD/tests/make_vectors" "$work/none" && says 'No such file'
}
check "a folder that is not there is said" t
finish_tap
