#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# farm_slurm.sh - client/farm/airy-slurm.sh under a real Slurm of one node (munged, slurmctld and slurmd of our own, in a temporary
# folder): 100 frames in 10 tasks, while tasks are queued again and cancelled, and programs and the daemon are killed: a counted number of
# times, between frames, with the daemon halted meanwhile, so that there is something to hit however fast or busy the machine is. Every frame
# must be the right one, and none done twice by the JSON lines. Prints TAP. Needs root and Debian's slurm-wlm and munge
# (`make farm-test` installs them); skipped without.
set -u
cd "$(dirname "$0")/.."
. tests/programs.sh
SCRIPT=$(realpath client/farm/airy-slurm.sh)
PATH=$PATH:/usr/sbin:/sbin
work=$(mktemp -d "${TMPDIR:-/tmp}/airy-slurm-XXXXXX")
. tests/tap.sh

for program in munged slurmctld slurmd sbatch; do
    command -v $program >/dev/null || { skip "100 frames under Slurm" "no $program: make farm-test installs it"; finish_tap; exit; }
done
[ "$(id -u)" = 0 ] || { skip "100 frames under Slurm" "slurmd needs root"; finish_tap; exit; }

started=()
finish() {
    touch "$work/stop"
    scancel --state=RUNNING --state=PENDING 2>/dev/null --user=root
    for pid in "${started[@]}"; do kill -TERM "$pid" 2>/dev/null; done
    sleep 1
    for pid in "${started[@]}"; do kill -KILL "$pid" 2>/dev/null; done
    kill -KILL "$(cat "$work/daemon.pid" 2>/dev/null)" 2>/dev/null
    wait 2>/dev/null
    rm -rf "$work"
}
trap finish EXIT

# ---- a cluster -------------------------------------------------------------------------------------------
RANDOM=${AIRY_SEED:-$(($$ % 32768))}
echo "# seed ${AIRY_SEED:-$(($$ % 32768))}"
port=$((20000 + RANDOM % 10000))
host=$(hostname -s)
mkdir -m 755 "$work"/{munge,state,spool,log}
chmod 755 "$work"
head -c 128 /dev/urandom >"$work/munge/key" && chmod 400 "$work/munge/key"
cat >"$work/slurm.conf" <<END
ClusterName=airy
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$port
SlurmdPort=$((port + 1))
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket=$work/munge/socket
CredType=cred/munge
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
SlurmctldLogFile=$work/log/slurmctld
SlurmdLogFile=$work/log/slurmd
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SlurmdParameters=config_overrides
SchedulerParameters=sched_interval=1,sched_min_interval=0,bf_interval=1
KillWait=2
MessageTimeout=60
BatchStartTimeout=300
SlurmdTimeout=0
UnkillableStepTimeout=300
ReturnToService=2
JobRequeue=1
NodeName=$host NodeAddr=127.0.0.1 CPUs=2
PartitionName=farm Nodes=$host Default=YES MaxTime=INFINITE State=UP OverSubscribe=NO
END
echo "CgroupPlugin=cgroup/v1" >"$work/cgroup.conf"
export SLURM_CONF=$work/slurm.conf

munged --force --foreground --key-file="$work/munge/key" --socket="$work/munge/socket" --pid-file="$work/munge/pid" \
    --log-file="$work/munge/log" --seed-file="$work/munge/seed" >/dev/null 2>&1 &
started+=($!)
wait_for 60 test -S "$work/munge/socket"
slurmctld -D -c >/dev/null 2>&1 &
started+=($!)
slurmd -D -c >/dev/null 2>&1 &
started+=($!)
idle() { sinfo -h -o %t 2>/dev/null | grep -qE 'idle|mix|alloc'; }
t() {
    why="no node: $(tail -3 "$work/log/slurmctld" "$work/log/slurmd" "$work/munge/log" 2>/dev/null | tr '\n' ' ')"
    wait_for 120 idle
}
check "slurmctld and slurmd are up" t
[ $failures -eq 0 ] || { finish_tap; exit; }

# ---- frames, and what they shall become ---------------------------------------------------------------------
FRAMES=100 CHUNK=10
mkdir "$work/in" "$work/o" "$work/want"
for i in 0 1 2 3 4; do
    "$SCENE" "$work/scene.$i.exr" $((480 + 16 * i)) 270 || exit 1
    "$AIRY" bloom "$work/scene.$i.exr" "$work/want/$i.exr" -q || exit 1
done
for i in $(seq 1 $FRAMES); do ln "$work/scene.$((i % 5)).exr" "$work/in/f.$(printf %04d "$i").exr"; done
export AIRY_SOCKET=$work/d.sock AIRY_IN="$work/in/f.####.exr" AIRY_OUT="$work/o/f.####.exr"
export AIRY_FIRST=0001 AIRY_LAST=$FRAMES AIRY_CHUNK=$CHUNK AIRY_LOG=$work/json
keep_daemon() {
    while [ ! -e "$work/stop" ]; do
        "$AIRYD" --warm common --socket "$AIRY_SOCKET" 2>>"$work/airyd.log" &
        echo $! >"$work/daemon.pid"
        wait $!
        sleep 0.05
    done
}
keep_daemon 2>/dev/null &
started+=($!)
answers() { "$AIRY" status --socket "$AIRY_SOCKET" >/dev/null 2>&1; }
wait_for 120 answers || { check "a daemon" false; finish_tap; exit; }

# ---- the run --------------------------------------------------------------------------------------------------
submit() { sbatch --parsable --output="$work/log/task.%a" --array="$1" "$SCRIPT" -j 1; }
outputs() { find "$work/o" -name 'f.*.exr' | wc -l; }
tasks() { squeue -h -r -t "$1" -o %F_%K 2>/dev/null; }
is_done() { grep -ho '"frame":[0-9]*,"input":"[^"]*","output":"[^"]*","status":"'"$1"'"' "$work"/json/*.jsonl 2>/dev/null; }
runs() { # our airy programs under Slurm
    for p in /proc/[0-9]*; do
        tr '\0' ' ' 2>/dev/null <"$p/cmdline" | grep -qF "$AIRY bloom $AIRY_IN" && basename "$p"
    done
}
pick() { shuf -n 1 --random-source=<(yes $RANDOM); }
# A task that was queued again would wait for two minutes; one whose start failed, and a node that took too long to clean up, for a person.
helped=0
hurry() {
    local job reason
    while read -r job reason; do
        case $reason in
        BeginTime) scontrol update jobid="$job" starttime=now 2>/dev/null ;;
        *held*) scontrol release "$job" 2>/dev/null && helped=$((helped + 1)) ;;
        esac
    done < <(squeue -h -r -t PENDING -o '%A %r' 2>/dev/null)
    sinfo -h -o %t 2>/dev/null | grep -qE 'drain|drng|down|fail' && scontrol update nodename="$host" state=resume 2>/dev/null && helped=$((helped + 1))
}
empty() {
    local left
    hurry
    left=$(squeue -h -r -t PENDING,RUNNING,COMPLETING,CONFIGURING,SUSPENDED -o %A 2>/dev/null) && [ -z "$left" ]
}

requeued=0 killed=0 cancelled=() daemons=0
halted() { [ "$(awk '$1 == "State:" { print $2 }' "/proc/$daemon/status" 2>/dev/null)" = T ]; }
strike() { # kind: hits one of those that are there now
    local task pid
    case $1 in
    requeue) task=$(tasks RUNNING | pick) && [ -n "$task" ] && scontrol requeue "$task" 2>/dev/null && requeued=$((requeued + 1)) ;;
    kill) pid=$(runs | pick) && [ -n "$pid" ] && kill -KILL "$pid" 2>/dev/null && killed=$((killed + 1)) ;;
    daemon) kill -KILL "$daemon" && daemons=$((daemons + 1)) ;;
    cancel)
        task=$(tasks RUNNING | pick) && [ -n "$task" ] && [[ " ${cancelled[*]} " != *" ${task#*_} "* ]] && scancel "$task" 2>/dev/null &&
            cancelled+=("${task#*_}")
        ;;
    esac
}
strike_any() {
    hurry
    strike "$1"
}
trouble() { # nothing ends while the daemon stands still, so that what is to be hit comes
    wait_for 120 answers || { why="no daemon"; return 1; }
    daemon=$(cat "$work/daemon.pid")
    kill -STOP "$daemon" && wait_for 60 halted
    wait_for 120 strike_any "$1" || why="nothing to $1: $(squeue -h -r | tr '\n' ';')"
    local status=$?
    kill -CONT "$daemon" 2>/dev/null
    return $status
}
further() {
    [ "$(outputs)" -gt "$seen" ] && return 0
    hurry
    return 1
}
left_over() { squeue -h -r -o '%K %T %r %S' 2>/dev/null | tr '\n' ';'; }
# As long as frames still come or tasks still end, none has failed: slow is no fault.
drain() {
    local state before='' end=0
    until empty; do
        state="$(outputs) $(left_over)"
        [ "$state" = "$before" ] || { before=$state end=$((SECONDS + 180)); }
        [ $SECONDS -lt $end ] || { why="tasks stay: $state; $(sinfo -h -o '%t %E')"; return 1; }
        sleep 0.2
    done
}
t() {
    exits 0 submit 0-$((FRAMES / CHUNK - 1)) || return 1
    local kind seen
    for kind in $(printf '%s\n' requeue{,,,} kill{,,,} daemon{,} cancel{,} | shuf --random-source=<(yes $RANDOM)); do
        seen=$(outputs)
        wait_for 180 further || { why="no output: $(left_over)"; return 1; }
        trouble "$kind" || return 1
    done
    drain || return 1
    # What was cancelled is for a person to submit again.
    exits 0 submit "$(printf '%s\n' "${cancelled[@]}" | sort -un | paste -sd,)" && drain || return 1
    echo "# $FRAMES frames: $requeued times queued again, $killed programs and $daemons daemons killed, ${#cancelled[@]} tasks cancelled; Slurm was helped $helped times"
    why="trouble is missing" && [ $requeued -eq 4 ] && [ $killed -eq 4 ] && [ $daemons -eq 2 ] && [ ${#cancelled[@]} -eq 2 ]
}
check "10 tasks, with kills" t
t() {
    local files wrong=0
    for i in $(seq 1 $FRAMES); do
        same "$work/o/f.$(printf %04d "$i").exr" "$work/want/$((i % 5)).exr" || { wrong=$((wrong + 1)) && echo "# $why"; }
    done
    files=$(ls -A "$work/o")
    echo "# wrong: $wrong of $FRAMES"
    why="$wrong frames are wrong" && [ $wrong -eq 0 ] || return 1
    why="$(wc -l <<<"$files") files; not frames: $(grep -v '^f' <<<"$files"); running: $(runs); $(left_over)"
    [ "$(wc -l <<<"$files")" -eq $FRAMES ]
}
check "$FRAMES frames, every one the same as by a direct run" t
t() {
    local twice lines
    twice=$(is_done done | sed 's/,.*//' | sort | uniq -d | tr '\n' ' ')
    lines=$(is_done '\(done\|skipped\)' | sed 's/,.*//' | sort -u | wc -l)
    echo "# $(is_done done | wc -l) done, $(is_done skipped | wc -l) left alone as done before; done twice: $(wc -w <<<"$twice")"
    why="done twice: $twice" && [ -z "$twice" ] && why="$lines frames have a line" && [ "$lines" -eq $FRAMES ]
}
check "none done twice" t
t() { # it fails for good, and is not queued again
    exits 0 env AIRY_IN="$work/none.####.exr" AIRY_LOG="$work/json2" SLURM_CONF="$SLURM_CONF" sbatch --parsable --wait --output="$work/log/bad" --array=0 "$SCRIPT" ||
        { why="its status is $? in sbatch --wait" && [ "$(grep -c '"status":"failed"' "$work/json2/0.jsonl")" -eq $CHUNK ] && ! grep -q 'queued again' "$work/log/bad"; }
}
check "an input that is not there fails the task, once" t
[ $failures -eq 0 ] || cp -r "$work/log" "$work/json" "$BUILD/" 2>/dev/null
[ $failures -eq 0 ] || tail -20 "$work"/log/* "$work"/json/* 2>/dev/null | cut -c1-300 | sed 's/^/# /'
finish_tap
