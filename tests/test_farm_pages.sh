#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# test_farm_pages.sh - the pages about OpenCue and Deadline cannot rot: every command line, option, exit status and field in them is taken
# out of the page and run, with what the managers put in the place of their tokens put there by this script, by their own rules (the
# cuebot's DispatchSupportService and FrameSet; Deadline's CommandLine plugin). The managers themselves do not run here. Prints TAP.
set -u
cd "$(dirname "$0")/.."
. tests/programs.sh
CUE=client/farm/opencue.md DEADLINE=client/farm/deadline.md
work=$(mktemp -d "${TMPDIR:-/tmp}/airy-pages-XXXXXX")
. tests/tap.sh
daemon=
finish() {
    [ -z "$daemon" ] || kill -KILL "$daemon" 2>/dev/null
    wait 2>/dev/null
    rm -rf "$work"
}
trap finish EXIT
mkdir -p "$work/bin" "$work/shots/a"
ln -s "$AIRY" "$work/bin/airy"
PATH=$work/bin:$PATH
"$SCENE" "$work/in.exr" 96 54 || exit 1
for i in $(seq 1001 1023); do ln "$work/in.exr" "$work/shots/a/in.$i.exr"; done
export AIRY_SOCKET=$work/s
"$AIRYD" --warm common --socket "$AIRY_SOCKET" 2>"$work/airyd.log" &
daemon=$!
answers() { "$AIRY" status >/dev/null 2>&1; }
wait_for 200 answers

block() { awk -v lang="^\`\`\`$2\$" '$0 ~ lang { in_it = 1; next } /^```$/ { in_it = 0 } in_it' "$1"; } # page language
entry() { block "$DEADLINE" ini | sed -n "s/^$1=//p"; }
here() { sed "s|/shots/|$work/shots/|g; s|/usr/local/bin/airy|$AIRY|g"; } # this machine's folders
outputs() { ls "$work/shots/a" | sed -n 's/^bloom\.\(-\{0,1\}[0-9]*\)\.exr$/\1/p' | tr '\n' ' '; }
fresh() { rm -f "$work"/shots/a/bloom.*; }
wrote() { # numbers
    why="outputs: $(outputs), wanted $1"
    [ "$(outputs)" = "$1" ]
}

# ---- OpenCue ------------------------------------------------------------------------------------------------
# What the cuebot makes of a layer's command, and rqd hands to a shell.
cue() { # first-frame chunk end-of-range frames-of-the-chunk extra
    local command="$line ${5:-}"
    command=${command//#FRAME_START#/$1}
    command=${command//#FRAME_END#/$(($1 + $2 - 1 < $3 ? $1 + $2 - 1 : $3))}
    command=${command//#FRAMESPEC#/$4}
    env CUE3=1 CUE_IFRAME="$1" CUE_CHUNK="$2" CUE_RANGE="1001-$3" CUE_FRAME="$1-bloom" CUE_LAYER=bloom CUE_JOB=show-a-me_bloom_a \
        CUE_THREADS=4 sh -c "$command"
}
line=$(block $CUE sh | here)
t() {
    why="not one command: $line" && [ "$(wc -l <<<"$line")" -eq 1 ] && fresh &&
        exits 0 cue 1001 10 1023 1001-1010 && ended 10 done && wrote "$(seq -s ' ' 1001 1010) " &&
        exits 0 cue 1021 10 1023 1021-1023 && ended 3 done && exits 0 cue 1001 10 1023 1001-1010 && ended 10 skipped
}
check "OpenCue: the command, two chunks and a retry" t
t() { # framesToFrameRanges writes these
    fresh && exits 0 cue 1001 2 1023 1001,1003 && wrote "1001 1003 " && exits 0 cue 1002 4 1023 1002-1011x3 && wrote "1001 1002 1003 1005 1008 1011 " &&
        exits 0 cue 1012 1 1023 1012 && wrote "1001 1002 1003 1005 1008 1011 1012 "
}
check "OpenCue: every form of #FRAMESPEC#" t
t() {
    local spec=$line
    why="the page does not name #FRAME_START#-#FRAME_END#" && grep -qF '`#FRAME_START#-#FRAME_END#`' $CUE || return 1
    line=${line//#FRAMESPEC#/#FRAME_START#-#FRAME_END#}
    fresh && exits 0 cue 1021 10 1023 "" && wrote "1021 1022 1023 "
    local status=$?
    line=$spec
    return $status
}
check "OpenCue: #FRAME_START#-#FRAME_END#" t
t() { # the program of PyOutline's example says the same as the line of CueSubmit's
    command -v python3 >/dev/null || return 0
    block $CUE python >"$work/outline.py"
    why="it is no Python" && python3 - "$work/outline.py" >"$work/command" <<'END' && why="two commands: $(cat "$work/command")" && [ "$(here <"$work/command")" = "$line" ]
import ast, sys
tree = ast.parse(open(sys.argv[1]).read())
[command] = [n.value for n in tree.body if isinstance(n, ast.Assign) and n.targets[0].id == "command"]
print(" ".join(ast.literal_eval(command)))  # as pyoutline's backend joins it
launch = tree.body[-1].value
assert ast.unparse(launch.func) == "outline.cuerun.launch" and [k.arg for k in launch.keywords] == ["use_pycuerun"]
END
}
check "OpenCue: PyOutline's example is the same command" t

# ---- Deadline -----------------------------------------------------------------------------------------------
# The plugin runs Executable with Arguments, no shell; the tokens in any case of letters, and the environment of the job.
deadline() { # first last extra
    local arguments="$(entry Arguments | here) ${3:-}" argv
    arguments=${arguments//<STARTFRAME>/$1}
    arguments=${arguments//<ENDFRAME>/$2}
    read -ra argv <<<"$arguments"
    env DEADLINE_JOB_ID=1 "$(entry EnvironmentKeyValue0 | sed "s|=.*|=$AIRY_SOCKET|")" "$(entry Executable | here)" "${argv[@]}"
}
t() {
    why="Plugin=$(entry Plugin)" && [ "$(entry Plugin)" = CommandLine ] && why="a space or a shell's letter in: $(entry Arguments)" &&
        ! entry Arguments | grep -q '["'\''$&|;]' && why="EnvironmentKeyValue0 names no variable of airy's: $(entry EnvironmentKeyValue0)" &&
        [ "$(entry EnvironmentKeyValue0 | cut -d= -f1)" = AIRY_SOCKET ] && fresh && exits 0 deadline 1001 1010 && ended 10 done &&
        wrote "$(seq -s ' ' 1001 1010) " && exits 0 deadline 1021 1023 && ended 3 done && exits 0 deadline 1021 1023 && ended 3 skipped
}
check "Deadline: the arguments, two tasks and a requeued one" t
t() {
    why="frames: $(entry Frames) by $(entry ChunkSize)" && [ "$(entry Frames)" = 1001-1100 ] && [ "$(entry ChunkSize)" = 10 ] && fresh &&
        exits 0 deadline 1001 1002 && fresh && local arguments &&
        arguments=$(entry Arguments | here | sed 's/####/%04d/g; s/<STARTFRAME>/1001/; s/<ENDFRAME>/1002/') && exits 0 airy $arguments && wrote "1001 1002 "
}
check "Deadline: %04d in the place of ####" t

# ---- what both pages say ---------------------------------------------------------------------------------------
options() { sed -n 's/^| \(outputs numbered\|a missing input\|one bad frame\|do them all\).*| \(.*\) |$/\2/p' "$1"; }
for page in $CUE $DEADLINE; do
    run() { if [ $page = $CUE ]; then cue "$1" 10 1023 "$1-$2" "${3:-}"; else deadline "$1" "$2" "${3:-}"; fi; }
    name=$(basename $page .md)
    t() {
        local said
        said=$(options $page | grep -oE '`[^`]+`' | tr -d '`' | tr '\n' ' ')
        why="the page's options are others than this test has: $said" && [ "$said" = "--offset -1000 --on-missing skip black --fail-fast --force " ] || return 1
        fresh && exits 0 run 1001 1003 "--offset -1000" && wrote "0001 0002 0003 " && exits 0 run 1001 1003 "--offset -1000 --force" && ended 3 done &&
            fresh && exits 3 run 1022 1024 && ended 1 failed && ended 2 done && exits 0 run 1022 1024 "--on-missing skip" && ended 1 missing &&
            exits 0 run 1022 1024 "--on-missing black" && ended 1 black && fresh && exits 3 run 1023 1030 "--fail-fast -j 1" && wrote "1023 "
    }
    check "$name: the options of its table" t
    t() { # the table of exit statuses, one after the other
        local said
        said=$(sed -n 's/^| \([0-9]\) | .*$/\1/p' $page | tr '\n' ' ')
        why="statuses in the page: $said" && [ "$said" = "0 2 3 4 5 1 " ] || return 1
        fresh && exits 0 run 1001 1001 && exits 2 run 1001 1001 "--threshold -1" && exits 2 run 1001 1001 --nothing &&
            exits 3 run 1030 1030 && exits 5 run 1002 1002 "--socket $work/none" && grep -q '"frame":1030,.*"status":"failed"' <(run 1030 1030 2>/dev/null) || return 1
        mkdir "$work/shots/a/bloom.1003.exr" # where a file is to go
        exits 4 run 1003 1003
        local status=$?
        rmdir "$work/shots/a/bloom.1003.exr"
        return $status
    }
    check "$name: the exit statuses of its table" t
done
left() { pgrep -f "$work/.*lifetime-fd" >/dev/null; }
t() { # without a shared daemon each run has its own, which ends with it
    fresh && exits 0 env -u AIRY_SOCKET XDG_RUNTIME_DIR="$work" sh -c "${line//#FRAMESPEC#/1001-1002}" && ended 2 done && wrote "1001 1002 " &&
        why="the run's own daemon stays" && wait_for 200 eval '! left'
}
check "without AIRY_SOCKET each starts its own daemon" t
finish_tap
