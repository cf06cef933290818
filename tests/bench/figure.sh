#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# figure.sh CSV >SVG - draws speed against error from a bench.csv: the engine's J5 at 1080p for each tolerance
# (half planes in, half planes out), beside the plain C chain and a copy of the frame, from the same run.
set -eu
awk -F, '
# Names are quoted and may hold commas: take fields from the right.
function field(n) { return $(NF - n) }
/^engine,1920x1080/ && /engine J5 half/ {
	match($0, /tolerance [0-9.e-]+/); t = substr($0, RSTART + 10, RLENGTH - 10)
	if (field(2) == "median") ms[t] = field(1)
	if (field(2) == "error_bound") bound[t] = field(1)
}
/^engine,1920x1080/ && /C chain/ && field(2) == "median" { chain = field(1) }
/^engine,1920x1080/ && /memcpy float/ && field(2) == "median" { copy = field(1) }
/c_chain point/ { chain_error = field(1) }
/^machine/ { machine = $0; sub(/^[^"]*"/, "", machine); sub(/,[^,]*$/, "", machine); sub(/".*/, "", machine); sub(/; airyd.*/, "", machine) }
function x(e) { return 90 + (log(e) / log(10) + 5.3) / 3.8 * 600 }
function y(m) { return 330 - log(m / 2) / log(200) * 290 }
function tick(v, text) { printf "<line x1=\"90\" x2=\"690\" y1=\"%.1f\" y2=\"%.1f\" class=\"grid\"/><text x=\"82\" y=\"%.1f\" text-anchor=\"end\">%s</text>\n", y(v), y(v), y(v) + 4, text }
function column(e, text) { printf "<line x1=\"%.1f\" x2=\"%.1f\" y1=\"40\" y2=\"330\" class=\"grid\"/><text x=\"%.1f\" y=\"348\" text-anchor=\"middle\">%s</text>\n", x(e), x(e), x(e), text }
END {
	print "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 720 400\" font-family=\"sans-serif\" font-size=\"12\">"
	print "<!-- SPDX-License-Identifier: Apache-2.0; made by tests/bench/figure.sh from bench.csv -->"
	print "<style>.grid{stroke:#ddd}.a{fill:#0a6;stroke:#0a6}.c{fill:#c50}text{fill:#333}</style>"
	print "<rect width=\"720\" height=\"400\" fill=\"white\"/>"
	print "<text x=\"90\" y=\"24\" font-size=\"14\">1920 x 1080, five Gaussians (sigma 4 to 64 px): ms a frame against error</text>"
	for (m = 2; m <= 200; m *= 10) { tick(m, m " ms"); if (m * 2.5 <= 400) tick(m * 2.5, m * 2.5 " ms"); if (m * 5 <= 400) tick(m * 5, m * 5 " ms") }
	column(1e-5, "1e-5"); column(1e-4, "1e-4"); column(1e-3, "1e-3"); column(1e-2, "1e-2")
	print "<text x=\"390\" y=\"366\" text-anchor=\"middle\">stated error bound, of the brightest glowing value (C chain: measured, of the peak)</text>"
	printf "<text x=\"390\" y=\"386\" text-anchor=\"middle\" fill=\"#888\" font-size=\"10\">%s</text>\n", machine
	printf "<line x1=\"90\" x2=\"690\" y1=\"%.1f\" y2=\"%.1f\" stroke=\"#888\" stroke-dasharray=\"4 3\"/><text x=\"100\" y=\"%.1f\">a copy of the frame, %.1f ms</text>\n", y(copy), y(copy), y(copy) - 5, copy
	printf "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"5\" class=\"c\"/><text x=\"%.1f\" y=\"%.1f\" text-anchor=\"end\">plain C chain, no bound, %.1f ms</text>\n", x(chain_error), y(chain), x(chain_error) - 10, y(chain) + 4, chain
	n = split("0.01 0.001 0.0001 1e-05", order, " ")
	for (i = 1; i <= n; i++) {
		t = order[i]
		if (i > 1) printf "<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" class=\"a\"/>\n", px, py, x(bound[t]), y(ms[t])
		px = x(bound[t]); py = y(ms[t])
		printf "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"5\" class=\"a\"/><text x=\"%.1f\" y=\"%.1f\">%s: %.0f ms</text>\n", px, py, px + 8, py + (t == "0.01" ? 20 : -8), "tolerance " t, ms[t]
	}
	print "</svg>"
}' "$1"
