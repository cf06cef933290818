#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# check_report.sh [DIR] - opens DIR/index.html from disk in headless chromium: the script has run, each plot has as many points
# as its CSV has rows, each picture has been decoded, the console is silent, and nothing was asked of a network. Prints TAP; without
# chromium the checks are skipped, and say so.
set -u
dir=$(realpath "${1:-build/report}")
browser=$(command -v chromium || command -v chromium-browser || command -v google-chrome)
names=("the script has run" "every row of the CSV files is a point" "every picture is in the page and decoded"
    "the console is silent" "nothing is loaded from elsewhere")
echo "1..${#names[@]}"
if [ -z "$browser" ]; then
    for i in "${!names[@]}"; do echo "ok $((i + 1)) - ${names[$i]} # SKIP chromium is not installed"; done
    exit 0
fi
work=$(mktemp -d "${TMPDIR:-/tmp}/airy-page-XXXXXX")
trap 'rm -rf "$work"' EXIT

# A copy whose last script writes what only a browser knows into the DOM.
sed 's|</body>|<script>Promise.all([...document.images].map(i => i.decode())).then(() => {\n\
document.documentElement.dataset.decoded = [...document.images].filter(i => i.naturalWidth > 0).length;\n\
document.documentElement.dataset.wide = [...document.querySelectorAll("circle.pt")].filter(c => c.getBoundingClientRect().width > 0).length;\n\
document.documentElement.dataset.loaded = performance.getEntriesByType("resource").filter(e => !e.name.startsWith("data:")).length; });</script></body>|' \
    "$dir/index.html" >"$work/index.html"
HOME=$work timeout 120 "$browser" --headless --no-sandbox --disable-gpu --disable-dev-shm-usage --user-data-dir="$work/profile" \
    --enable-logging=stderr --v=0 --virtual-time-budget=10000 --dump-dom "file://$work/index.html" >"$work/dom" 2>"$work/log"

n=0 failed=0
check() { # name, command...
    n=$((n + 1))
    local name=$1
    shift
    if "$@"; then echo "ok $n - $name"; else
        echo "not ok $n - $name"
        failed=1
    fi
}
attribute() { grep -oE "data-$1=\"[^\"]*\"" "$work/dom" | head -1 | cut -d'"' -f2; }
script_ran() { [ "$(attribute script)" = ran ]; }
rows() { tail -n +2 "$dir/$1.csv" | wc -l; }
points() { grep -oE "class=\"pt $1\"" "$work/dom" | wc -l; }
all_points() {
    local total=0 pair have want
    for pair in speed:speed peak:shimmer energy:shimmer size:size tiles:tiles; do
        have=$(points "${pair%:*}") want=$(rows "${pair#*:}")
        echo "# ${pair%:*}: $have points, $want rows"
        [ "$have" -gt 0 ] && [ "$have" -eq "$want" ] || return 1
        total=$((total + have))
    done
    echo "# $(attribute wide) of $total points have a size on the screen"
    [ "$(attribute wide)" = "$total" ]
}
pictures() {
    echo "# $(attribute decoded) pictures decoded"
    [ "$(rows pictures)" -gt 0 ] && [ "$(attribute decoded)" = "$(rows pictures)" ]
}
silent() {
    grep -E 'CONSOLE' "$work/log" | sed 's/^/# /'
    ! grep -qE 'CONSOLE' "$work/log"
}
alone() { [ "$(attribute loaded)" = 0 ]; }
check "${names[0]}" script_ran
check "${names[1]}" all_points
check "${names[2]}" pictures
check "${names[3]}" silent
check "${names[4]}" alone
[ $failed -eq 0 ]
