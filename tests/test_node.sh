#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_node.sh - the Node client: its package is made as `npm pack` makes it, its types are checked, and its tests (client/node/test) run
# against real daemons. Prints TAP. AIRY and AIRYD name the programs, SCENE the picture maker, AIRY_NODE the node, NODE_TYPES a folder
# that holds @types/node. No network is needed.
set -u
cd "$(dirname "$0")/.."
. tests/programs.sh
NODE=${AIRY_NODE:-node}
export AIRY_ROOT=$PWD

oldest=18.11
skip_all() {
    echo "1..1"
    echo "ok 1 - the Node client # SKIP $1"
    exit 0
}
command -v "$NODE" >/dev/null || skip_all "no node (Debian: nodejs)"
version=$("$NODE" -p process.versions.node)
[ "$(printf '%s\n' $oldest "$version" | sort -V | head -1)" = $oldest ] || skip_all "node is $version, $oldest is the oldest that will do"

# A copy of its own: making it writes into it, and the sources stay as they are.
package=$BUILD/node
rm -rf "$package"
cp -r client/node "$package"
rm -rf "$package/gen"

n=0 failures=0
check() { # description, command...
    local what=$1
    shift
    n=$((n + 1))
    if "$@" >"$BUILD/node.log" 2>&1; then echo "ok $n - $what"; else
        echo "not ok $n - $what"
        tail -15 "$BUILD/node.log" | sed 's/^/# /'
        failures=$((failures + 1))
    fi
}
skip() {
    n=$((n + 1))
    echo "ok $n - $1 # SKIP $2"
}

generated() { # twice the same, and nothing of it by hand
    "$NODE" client/node/generate.mjs "$package" && cp -r "$package/gen" "$BUILD/node-again" &&
        "$NODE" client/node/generate.mjs "$package" && diff -r "$package/gen" "$BUILD/node-again"
    local status=$?
    rm -rf "$BUILD/node-again"
    return $status
}
# What npm packs is unpacked where a user would have it, and used there.
packed() {
    local work user f status=1
    work=$(mktemp -d "${TMPDIR:-/tmp}/airy-npm-XXXXXX")
    user=$work/user/node_modules/@airyd/client
    mkdir -p "$user"
    npm_config_cache=$work/cache npm_config_offline=true npm pack "./$package" --ignore-scripts --silent --pack-destination "$work" &&
        tar -xzf "$work"/airyd-client-*.tgz -C "$user" --strip-components=1 && whole "$user" && status=0
    rm -rf "$work"
    return $status
}
whole() { # folder
    local f
    for f in lib/index.js lib/index.d.ts gen/contract.js gen/messages.d.ts gen/airy.proto examples/bloom-frame.mjs README.md; do
        [ -f "$1/$f" ] || { echo "$f is not packed"; return 1; }
    done
    [ ! -e "$1/test" ] || { echo "the tests are packed"; return 1; }
    (cd "$1/../../.." && "$NODE" --input-type=module -e "import { connect } from '@airyd/client';
        await connect({ path: '/nowhere' }).then(() => { throw new Error('connected'); }, (e) => { if (e.symbol !== 'CONNECT') throw e; });")
}
types_of() { # the folder with @types/node
    local d
    for d in ${NODE_TYPES:-} "$package/node_modules/@types" /usr/share/nodejs/@types; do
        [ -d "$d/node" ] && { echo "$d"; return; }
    done
    return 1
}

check "gen/ is made from airy.proto and PROTOCOL.md" generated
if command -v npm >/dev/null; then check "the package is whole without its sources" packed; else skip "the package is whole" "no npm"; fi
if ! command -v tsc >/dev/null; then
    skip "the types say what the library does" "no tsc (Debian: node-typescript)"
elif types=$(types_of); then
    check "the types say what the library does" tsc -p "$package/tsconfig.json" --typeRoots "$types"
else
    skip "the types say what the library does" "no @types/node: NODE_TYPES=FOLDER names one"
fi

# Its lines are numbered on; its plan, the last line, grows by these.
"$NODE" "$package/test/main.mjs" "$@" | awk -v n=$n '
    /^(not )?ok [0-9]+/ { at = $1 == "not" ? 3 : 2; $at = n + $at }
    /^1\.\.[0-9]+$/ { print "1.." n + substr($0, 4); next }
    { print; fflush() }'
[ "${PIPESTATUS[0]}" -eq 0 ] && [ $failures -eq 0 ]
