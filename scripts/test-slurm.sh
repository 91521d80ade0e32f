#!/usr/bin/env bash
# Runs the main job as a Slurm array, for real, on this one machine: Debian's slurmctld, slurmd and munge with a
# configuration of their own, on ports of their own. Kills one task with KILL in the middle of its work, submits what the
# report names as missing, and compares results.csv byte by byte with a run without Slurm. Needs root; Debian's packages
# are installed when they are missing. Ends all that it has started.
#
#   scripts/test-slurm.sh
#
# RESPIRE_BENCH chooses the program (target/release/respire-bench).
set -euo pipefail
cd "$(dirname "$0")/.."
program=test-slurm
. scripts/packages.sh
install_packages slurmctld slurmd slurm-client munge

bench=$(readlink -f "${RESPIRE_BENCH:-target/release/respire-bench}")
[ -x "$bench" ] || stop "there is no program $bench; build it first: cargo build --release"
work=$(mktemp -d)
pids=()
finish() {
  for pid in "${pids[@]}"; do kill "$pid" 2>/dev/null || true; done
  wait 2>/dev/null || true
  rm -rf "$work"
}
trap finish EXIT

# --- one node -----------------------------------------------------------------------------------------------------
mkdir -p "$work/state" "$work/spool" /run/munge
chown munge /run/munge
export SLURM_CONF=$work/slurm.conf
cat >"$SLURM_CONF" <<CONF
ClusterName=one
SlurmctldHost=$(hostname -s)(127.0.0.1)
SlurmctldPort=16817
SlurmdPort=16818
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
ReturnToService=2
SchedulerParameters=batch_sched_delay=0,sched_interval=2
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
StateSaveLocation=$work/state
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/slurmd.log
NodeName=$(hostname -s) NodeAddr=127.0.0.1 CPUs=$(nproc) RealMemory=4000 State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF
if ! munge -n >/dev/null 2>&1; then
  runuser -u munge -- munged --foreground 2>/dev/null & pids+=($!)
fi
for _ in $(seq 50); do munge -n >/dev/null 2>&1 && break; sleep 0.1; done
slurmctld -D >"$work/ctld.out" 2>&1 & pids+=($!)
slurmd -D -N "$(hostname -s)" >"$work/d.out" 2>&1 & pids+=($!)
for _ in $(seq 100); do [ "$(sinfo -h -o %t 2>/dev/null)" = idle ] && break; sleep 0.2; done
[ "$(sinfo -h -o %t)" = idle ] || { tail -n 8 "$work/slurmd.log" >&2; stop "Slurm's node does not become idle"; }

# --- the work: a tube, two methods, two seeds ------------------------------------------------------------------------------
scripts/tube-case.sh "$work/cases"
select=(--cases "$work/cases/tube.toml" --profile "$work/cases/tiny.toml" --seeds 1,2)
"$bench" all-cases "${select[@]}" --out "$work/local/reports" --cache "$work/local/cache" --threads 1 >"$work/local.log" 2>&1

# A blank and a percent sign, both of which mean something to Slurm; one task at a time, so that none takes over what the
# killed one leaves.
written="$work/the scripts, 100%"
slurm=("$bench" slurm "${select[@]}" --processors 1 --at-once 1 --scripts "$written" --out "$work/reports" --cache "$work/cache")
submitted() { bash "$written"/submit.sh | sed 's/.*report: job //'; }
await() { # JOB
  for _ in $(seq 600); do [ -z "$(squeue -h 2>/dev/null)" ] && return; sleep 0.2; done
  stop "the jobs do not end"
}

"${slurm[@]}"
report=$(submitted)
# The first task that works is killed, as a node that fails would. Known by its program and by this script's own cache,
# which no other process has among its arguments.
working_task() {
  local process
  for process in /proc/[0-9]*; do
    if [ "$process/exe" -ef "$bench" ] && grep -qzxF -e --cells-only "$process/cmdline" && grep -qzxF "$work/cache" "$process/cmdline"; then
      echo "${process##*/}"
      return
    fi
  done 2>/dev/null
}
for _ in $(seq 300); do
  child=$(working_task)
  [ -n "$child" ] && break
  sleep 0.05
done
[ -n "${child:-}" ] || { squeue >&2; tail -n 5 "$written"/*.log "$work/slurmctld.log" >&2; stop "no task was seen at work"; }
kill -KILL "$child"
await "$report"
missing=$(grep -o 'of [0-9]* cells failed: .*' "$written/report.log" || true)
[ -n "$missing" ] || { tail -n 5 "$written"/*.log >&2; stop "the report names no missing cell"; }
printf 'killed a task: %s\n' "$missing"
"${slurm[@]}"
submitted >/dev/null
await again
"${slurm[@]}" | grep -q "every cell is finished" || stop "cells are still missing"
cmp "$work/local/reports/latest/results.csv" "$work/reports/latest/results.csv"
printf 'same bytes: results.csv of the array and of the local run\n'
