#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_report.sh - a tiny report, made as `make report` makes it: its CSV files are whole, its figures are possible, its page is well
# formed and has a point for every row. Prints TAP. The page in a browser: tests/report/check_report.sh.
set -u
cd "$(dirname "$0")/.."
export BUILD=${BUILD:-build}
work=$(mktemp -d "${TMPDIR:-/tmp}/airy-report-XXXXXX")
trap 'rm -rf "$work"' EXIT
dir=$work/report

n=0 failures=0
check() { # description, command...
    local what=$1
    shift
    n=$((n + 1))
    if "$@"; then echo "ok $n - $what"; else
        echo "not ok $n - $what"
        failures=$((failures + 1))
    fi
}

made() {
    AIRY_REPORT_DIR=$dir bash tests/report/report.sh --tiny >"$work/log" 2>&1 && return
    tail -5 "$work/log" | sed 's/^/# /'
    return 1
}
# Fields of line $2.. of a file: quotes hide commas.
fields='function fields(line,   n, i, c, q) { n = 1; q = 0
    for (i = 1; i <= length(line); i++) { c = substr(line, i, 1)
        if (c == "\"") q = !q; else if (c == "," && !q) n++ }
    return q ? -1 : n }'
whole() {
    local f
    for f in speed shimmer size tiles machine notes peers pictures; do
        awk "$fields"' NR == 1 { want = fields($0) } fields($0) != want { print "# " FILENAME ":" FNR ": " $0; bad = 1 }
            END { exit bad || NR < 2 }' "$dir/$f.csv" || { echo "# $f.csv"; return 1; }
    done
}
rows() { tail -n +2 "$dir/$1.csv" | wc -l; }
# A quoted device's name may hold commas: fields are taken after the closing quotes.
methods() {
    local m
    for m in 'airyd, half' 'airyd, float' Kawase 'dual filter' '13-tap + tent chain' 'box pyramid' recursive 'FFT on the CPU' \
        'direct Gaussian' 'plain C chain'; do
        grep -q "\"$m" "$dir/speed.csv" || { echo "# no $m"; return 1; }
    done
}
# METHODS 3.1: a lone point's error is below the tolerance for the engine; what is exact but for float32, or cut at 4 sigma, is
# so; the field's chains are not.
errors() {
    awk -F'","' '/^"/ && NR > 1 { split($6, v, ","); split(v[1], t, "\""); type = t[1]; e = v[2] + 0
        if (!(e > 0 && e < 1.5)) bad("impossible")
        if ($4 == "airyd, float") { sub("tolerance ", "", $5); if (e > $5 + 0) bad("above the tolerance") ; seen++ }
        if ($4 == "FFT on the CPU" && e > 1e-5) bad("not exact")
        if ($4 == "direct Gaussian" && e > 5e-4) bad("more than the cut at 4 sigma")
        if ($4 ~ /Kawase|box|dual|tent/ && e < 1e-3) bad("better than it can be") }
        function bad(why) { print "# " why ": " $0; failed = 1 }
        END { exit failed || seen != 8 }' "$dir/speed.csv"
}
# A glow has the energy of its source, wherever that is.
energies() {
    awk -F, 'NR > 1 && !($NF > .99 && $NF < 1.01) { print "# " $0; bad = 1 } END { exit bad || NR < 20 }' "$dir/shimmer.csv"
}
points() {
    local pair have want
    for pair in speed:speed peak:shimmer energy:shimmer size:size tiles:tiles; do
        have=$(grep -c "class=\"pt ${pair%:*}\"" "$dir/index.html") want=$(rows "${pair#*:}")
        [ "$have" -gt 0 ] && [ "$have" -eq "$want" ] || { echo "# $pair: $have points, $want rows"; return 1; }
    done
}
# Elements open and close in order; those that stay empty are known.
well_formed() {
    awk 'BEGIN { RS = "<" } NR > 1 {
        tag = $0; sub(/>.*/, "", tag); name = tag; sub(/[ \n\t].*/, "", name)
        if (script && name != "/script") next
        if (name ~ /^!/ || tag ~ /\/$/ || name ~ /^(meta|link|img|br)$/) next
        if (name ~ /^\//) { if (stack[depth--] != substr(name, 2)) { print "# <" name "> closes <" stack[depth + 1] ">"; exit bad = 1 }
            script = 0 }
        else { stack[++depth] = name; script = name == "script" } }
        END { exit bad || depth != 0 || NR < 100 }' "$1"
}
alone() { ! grep -E '(src|href)="[^"#]' "$dir/index.html" | grep -vE '(src|href)="(data:|#)' | grep -q .; }
pictures() { [ "$(rows pictures)" -gt 0 ] && [ "$(grep -o 'src="data:image/png;base64,iVBOR' "$dir/index.html" | wc -l)" -eq "$(rows pictures)" ]; }
escaped() { # what a file says is text, never markup
    printf 'section,note\n"hard","<script>alert(1)</script> & ""quoted"""\n' >"$dir/notes.csv"
    "$BUILD/bench/report_page" "$dir" && grep -qF '&lt;script&gt;alert(1)&lt;/script&gt; &amp; &quot;quoted&quot;' "$dir/index.html"
}
ragged() { # a CSV that is none is refused
    printf 'a,b\n1,2,3\n' >"$dir/hard.csv"
    ! "$BUILD/bench/report_page" "$dir" 2>"$work/err" && grep -q 'row 1 has 3 fields; the header has 2' "$work/err"
}

echo 1..11
check "a tiny report is made" made
check "every CSV file has rows, each as long as its header" whole
check "the engine and every method are in it" methods
check "each error is what the method's arithmetic allows" errors
check "no method gains or loses light" energies
check "the page has a point for every row" points
check "the page is well formed" well_formed "$dir/index.html"
check "the figure is well formed" well_formed "$dir/speed.svg"
check "the page has its pictures within, and loads nothing" eval 'alone && pictures'
check "text from files is escaped" escaped
check "a damaged CSV is refused" ragged
[ $failures -eq 0 ]
