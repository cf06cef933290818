# SPDX-License-Identifier: Apache-2.0
# tap.sh - what test scripts share: TAP lines, programs by their exit status, and what they said. Sourced after $work
# is set; output of the last program is in $work/out and $work/err.
n=0 failures=0 why=
check() { # description, command...: one line of TAP
    local what=$1
    shift
    n=$((n + 1))
    why=
    if "$@"; then
        echo "ok $n - $what"
    else
        echo "not ok $n - $what"
        echo "# $why"
        tail -5 "$work/err" 2>/dev/null | sed 's/^/# /'
        failures=$((failures + 1))
    fi
}
skip() {
    n=$((n + 1))
    echo "ok $n - $1 # SKIP $2"
}
finish_tap() {
    echo "1..$n"
    [ $failures -eq 0 ]
}
exits() { # status command...
    local wanted=$1 got
    shift
    "$@" >"$work/out" 2>"$work/err"
    got=$?
    why="exit status $got, wanted $wanted: $*"
    [ $got -eq "$wanted" ]
}
says() { # text in the last messages
    why="stderr does not say \"$1\""
    grep -qF -- "$1" "$work/err"
}
ended() { # count status: that many frames ended so, by the JSON lines of the last run
    local got
    got=$(grep -c "\"status\":\"$2\"" "$work/out")
    why="$got frames are \"$2\", wanted $1"
    [ "$got" -eq "$1" ]
}
same() {
    why="$1 and $2 differ"
    cmp -s "$1" "$2"
}
wait_for() { # seconds command...
    local end=$((SECONDS + $1))
    shift
    until "$@"; do
        [ $SECONDS -ge $end ] && return 1
        sleep 0.05
    done
}
