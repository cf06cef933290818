#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# airy-slurm.sh - a Slurm job array that blooms a range of frames, a chunk of them in each task. Safe to requeue and to run
# twice: each frame is written whole or not at all, and one that is done is left alone.
#
#   AIRY_IN='shot.####.exr' AIRY_OUT='bloom.####.exr' AIRY_FIRST=1001 AIRY_LAST=1100 AIRY_CHUNK=10 \
#       sbatch --array=0-9 airy-slurm.sh --threshold 2 --intensity 0.5
#
# The array has ceil((AIRY_LAST - AIRY_FIRST + 1) / AIRY_CHUNK) tasks; tasks beyond the range do nothing. What follows the
# script's name goes to airy bloom as it stands. AIRY names the program (default: airy); AIRY_LOG a folder, on a disk that all
# machines share, for the JSON lines: TASK.jsonl, one line a frame and attempt. AIRY_REQUEUES is how often a task may be queued
# again by itself (default 10).
#
# Exit statuses (airy(1)) as Slurm sees them: 0 done; 2, 3, 4 and 1 fail the task, for trying again would not help; 5 (no
# daemon, busy, lost, out of memory) queues the task again. A node that fails, scontrol requeue and pre-emption do so, too,
# because of --requeue.
#SBATCH --job-name=airy
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:TERM@30
set -u

: "${AIRY_IN:?is the input, such as shot.####.exr}" "${AIRY_OUT:?is the output, such as bloom.####.exr}"
: "${AIRY_FIRST:?is the first frame}" "${AIRY_LAST:?is the last frame}"
: "${SLURM_ARRAY_TASK_ID:?is missing: submit with sbatch --array=0-N}"
chunk=${AIRY_CHUNK:-10}
for number in "$AIRY_FIRST" "$AIRY_LAST" "$chunk" "${AIRY_REQUEUES:-10}"; do
    [[ $number =~ ^-?[0-9]{1,9}$ ]] || { echo "airy-slurm: \"$number\": a whole number expected" >&2; exit 2; }
done
[ "$((10#$chunk))" -ge 1 ] || { echo "airy-slurm: AIRY_CHUNK is $chunk; at least 1 expected" >&2; exit 2; }

decimal() { # 0010 is ten, not eight
    local digits=${1#-}
    echo "${1%"$digits"}$((10#$digits))"
}
first=$(($(decimal "$AIRY_FIRST") + SLURM_ARRAY_TASK_ID * 10#$chunk))
last=$((first + 10#$chunk - 1)) end=$(decimal "$AIRY_LAST")
[ $last -le "$end" ] || last=$end
[ $first -le $last ] || exit 0

log=/dev/stdout
if [ -n "${AIRY_LOG:-}" ]; then
    mkdir -p "$AIRY_LOG" && log=$AIRY_LOG/$SLURM_ARRAY_TASK_ID.jsonl || exit 4
fi

# In the background, so that a signal for the task reaches it at once; airy then removes what it has half-written.
"${AIRY:-airy}" bloom "$AIRY_IN" -o "$AIRY_OUT" -f "$first-$last" --json --quiet "$@" >>"$log" &
airy=$!
trap 'kill -TERM $airy 2>/dev/null' TERM INT
wait $airy
status=$?
while kill -0 $airy 2>/dev/null; do # a trap ends a wait early
    wait $airy
    status=$?
done

# 128 + 9: killed, by the kernel for want of memory or by hand; it has left nothing half-written.
if { [ $status -eq 5 ] || [ $status -eq 137 ]; } && [ "${SLURM_RESTART_COUNT:-0}" -lt "$((10#${AIRY_REQUEUES:-10}))" ]; then
    task=${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID
    echo "airy-slurm: status $status: task $task is queued again" >&2
    for attempt in 1 2 3 4 5; do # a task that has only just begun, or a busy controller, may refuse at first
        scontrol requeue "$task" && sleep 60 # until Slurm ends this attempt: its status would end the task
        sleep $attempt
    done
fi
exit $status
