#!/usr/bin/env bash
# Uses a real Slurm (https://slurm.schedmd.com) as the engine: a controller and four nodes on this machine,
# without root, munge or cgroups. While a job runs, one process is requeued, another cancelled by a user, the
# controller restarted and the service killed. Every frame must be rendered once, with the bits of `forelight
# render`, and nothing may be left in Slurm. Then a node's daemon dies, and Slurm starts its frame a second
# time while the first process goes on. Finally a job that is cancelled here must be cancelled in Slurm.
#
#   FORELIGHT_BIN      the program (default: target/debug/forelight, which is built)
#   FORELIGHT_KEEP     if set, keeps the folder with all logs and prints its path
#
# Needs Slurm (Debian: slurm-wlm), Python with venv, and network access. Without them it is reported
# as not run, and in CI it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

deploy/packages.sh slurm-wlm || skip 'slurm-wlm cannot be installed (no network?)'
PATH=$PATH:/usr/sbin
for program in slurmctld slurmd sbatch; do
  command -v $program >/dev/null || skip "there is no $program (Debian: slurm-wlm)"
done
python_with openjd openjd-cli==0.8.0 'numpy>=2,<3' 'OpenEXR>=3.3,<4'
need_forelight

work=$(mktemp -d)
farm=
controller=
declare -A daemons=()
cleanup() {
  # Processes started by Slurm are not children of this script. They have the path of our configuration in
  # their environment, like the daemons and the farm.
  local process
  for process in $(grep -lsza "^SLURM_CONF=$work/slurm.conf$" /proc/[0-9]*/environ | cut -d/ -f3); do
    [ "$process" = $$ ] || kill -9 "$process" 2>/dev/null || true
  done
  wait 2>/dev/null || true
  if [ -n "${FORELIGHT_KEEP:-}" ]; then echo "kept: $work"; else rm -rf "$work"; fi
}
trap cleanup EXIT
fail() {
  echo "failed: $1"
  squeue --states=all 2>/dev/null || true
  tail -n 40 "$work/farm.log" 2>/dev/null || true
  # What the processes that Slurm started said, and where those that still run wait.
  find "$work" -name '*_*.log' -exec tail -n 20 {} + || true
  local process
  for process in $(pgrep -f "$FORELIGHT_BIN worker" || true); do
    echo "process $process: $(tr '\0' ' ' <"/proc/$process/cmdline")"
    grep -H '' "/proc/$process"/task/*/{comm,wchan} || true
  done
  exit 1
}

host=$(hostname -s)
export SLURM_CONF=$work/slurm.conf
mkdir -p "$work"/{run,spool,state,log}
ports=()
for _ in 1 2 3 4 5; do ports+=("$(free_port)"); done
{
  sed -e "s|@HOST@|$host|g" -e "s|@USER@|$(id -un)|g" -e "s|@FOLDER@|$work|g" deploy/slurm.conf
  echo "SlurmctldPort=${ports[0]}"
  for node in 1 2 3 4; do
    echo "NodeName=node$node NodeHostname=$host NodeAddr=127.0.0.1 Port=${ports[$node]} CPUs=1 RealMemory=1000"
  done
  echo 'PartitionName=render Nodes=node[1-4] Default=YES MaxTime=INFINITE State=UP'
} >"$SLURM_CONF"
start_controller() {
  slurmctld -D -f "$SLURM_CONF" >>"$work/log/slurmctld.out" 2>&1 &
  controller=$!
}
start_node() {
  mkdir -p "$work/spool/node$1"
  slurmd -D -f "$SLURM_CONF" -N "node$1" >>"$work/log/node$1.out" 2>&1 &
  daemons[$1]=$!
}
start_controller
for node in 1 2 3 4; do start_node $node; done
idle_nodes() { [ "$(sinfo --noheader --Node --format=%T | grep -c '^idle$')" = 4 ]; }
wait_for 30 idle_nodes

export NO_PROXY=127.0.0.1 no_proxy=127.0.0.1
port=$(free_port)
start_farm() {
  "$FORELIGHT_BIN" serve --data "$work/data" --listen "127.0.0.1:$port" --lease-ttl 4s --executor slurm --slurm-poll 0.5s \
    --slurm-bundles "$work/bundles" --slurm-preview cpu --slurm-price 0.5 >"$work/printed" 2>>"$work/farm.log" &
  farm=$!
  wait_for 30 grep -q '^listening on ' "$work/printed"
}
submit() { "$FORELIGHT_BIN" submit "$1" --server "http://127.0.0.1:$port" --data "$work/data" "${@:2}"; }
# A running element on one of the given nodes, as NUMBER_PLACE.
running() { squeue --noheader --states=RUNNING --name="$(names render)" --format='%F_%K %N' | grep -E " node[$1]\$" | head -1 | cut -d' ' -f1; }
names() { squeue --noheader --states=all --format=%j | grep "^forelight-$1" | sort -u | paste -sd,; }

echo 'a job through Slurm with failures around it'
start_farm
size=(--width 160 --height 90 --spp 8 --ambient-bounces 1)
submit deploy/scenes/corridor --frames 0-19 "${size[@]}" --samples 64 --deadline 2h --name 'a "shot"; of ours' \
  --follow --json --out "$work/images" >"$work/job.json" 2>"$work/submit.log" &
submitted=$!
wait_for 120 at_least "SELECT count(*) FROM results r JOIN tasks t ON t.id = r.task_id WHERE t.kind = 'render'" 2
is "SELECT count(*) FROM nodes WHERE name LIKE 'node_'" 4 || fail 'the nodes of Slurm and of the farm differ'
at_least "SELECT count(*) FROM slurm_arrays WHERE deadline_at IS NOT NULL" 1 || fail 'no array has a deadline'
at_least "SELECT count(*) FROM slurm_arrays WHERE reservation IS NOT NULL" 1 || fail 'no array has a reservation'

echo '  a process is requeued while it works'
# A process that has just delivered its frame is cancelled once it is requeued. Then requeue another one.
# Slurm delays requeued jobs by two minutes.
waits() { squeue --array --noheader --states=PENDING --format='%F_%K %r' | grep -q "^$1 BeginTime"; }
requeued() {
  local element
  element=$(running 12)
  [ -n "$element" ] && scontrol requeue "$element" || return 1
  for _ in {1..50}; do
    waits "$element" && scontrol update "JobId=$element" StartTime=now && return
    sleep 0.2
  done
  return 1
}
wait_for 60 requeued
echo '  a process is cancelled by a user'
# A process that has just delivered its frame leaves no lost submission. Then cancel another one.
lost() { at_least "SELECT count(*) FROM events WHERE kind = 'submission_lost'" 1; }
ended() { is "SELECT count(*) FROM slurm_elements e JOIN slurm_arrays a ON a.id = e.array_id WHERE e.outcome IS NULL AND a.slurm_id || '_' || e.position = '$1'" 0; }
cancelled() {
  local element
  element=$(running 34)
  [ -n "$element" ] || return 1
  scancel "$element"
  wait_for 60 ended "$element"
  lost
}
wait_for 120 cancelled
echo '  the controller is away for a while'
kill "$controller"
wait "$controller" 2>/dev/null || true
told() { at_least "SELECT count(*) FROM events WHERE kind = 'engine_state' AND body LIKE '%does not answer%'" "$1"; }
wait_for 60 told 1
start_controller
back() { at_least "SELECT count(*) FROM events WHERE kind = 'engine_state' AND body LIKE '%answers again%'" 1; }
wait_for 30 back
echo '  the service is killed'
kill -9 "$farm"
wait "$farm" 2>/dev/null || true
sleep 2
start_farm

wait_for 400 bash -c "! kill -0 $submitted"
wait "$submitted" || { cat "$work/submit.log"; fail 'the job was not delivered'; }

echo 'every frame is rendered once'
"$environment/bin/python" - "$work/data/forelight.sqlite" <<'PYTHON'
import sqlite3, sys

database = sqlite3.connect(f"file:{sys.argv[1]}?mode=ro", uri=True)
def rows(query): return database.execute(query).fetchall()

done = rows("SELECT frame, count(*) FROM results r JOIN tasks t ON t.id = r.task_id WHERE t.kind = 'render' GROUP BY frame")
assert done == [(frame, 1) for frame in range(20)], done
# A process that Slurm started again found its task leased or done, so no frame was rendered by two at a time.
both = rows("""SELECT t.frame, a.fence, b.fence FROM leases a JOIN leases b ON a.task_id = b.task_id AND a.fence < b.fence JOIN tasks t ON t.id = a.task_id
    WHERE b.granted_at < a.ended_at OR a.state = 'committed'""")
assert not both, f"rendered by two: {both}"
lost = rows("SELECT count(*) FROM events WHERE kind = 'submission_lost'")[0][0]
leased = rows("SELECT count(*) FROM leases l JOIN tasks t ON t.id = l.task_id WHERE t.kind = 'render'")[0][0]
print(f"  20 frames, {leased} leases, {lost} processes lost and started again")
PYTHON
for frame in 0 7 19; do
  "$FORELIGHT_BIN" render deploy/scenes/corridor --frame $frame "${size[@]}" --preview cpu --out "$work/$frame.exr" >"$work/render.log" 2>&1 ||
    { cat "$work/render.log"; fail "frame $frame cannot be rendered here"; }
  same_bits "$work/$frame.exr" "$(find "$work/images" -name "*$(printf %04d $frame)*.exr" | head -1)"
done
ours() { squeue --noheader --format='%j %T' | grep -c '^forelight' || true; }
nothing_left() { [ "$(ours)" = 0 ] && is 'SELECT count(*) FROM slurm_elements WHERE outcome IS NULL' 0; }
wait_for 60 nothing_left
no_reservation() { ! scontrol --oneliner show reservation | grep -q forelight_; }
wait_for 30 no_reservation

echo 'the parts of a divided frame are an array over three nodes'
wait_for 60 idle_nodes
divided=$(submit deploy/scenes/corridor --frames 3 "${size[@]}" --samples 16 --profile-frames 1 --parts 3 --name divided)
wait_for 200 is "SELECT state FROM jobs WHERE name = 'divided'" done
of_parts="FROM tasks t JOIN jobs j ON j.id = t.job_id AND j.name = 'divided' AND t.kind = 'render_part'"
is "SELECT count(DISTINCT e.array_id) || ' ' || count(*) FROM slurm_elements e JOIN (SELECT t.id $of_parts) p ON p.id = e.task_id" '1 3' ||
  fail 'the parts are not one array of three'
is "SELECT count(DISTINCT l.node_id) FROM leases l JOIN (SELECT t.id $of_parts) p ON p.id = l.task_id" 3 || fail 'the parts were not on three nodes'
"$FORELIGHT_BIN" submit --job "$divided" --out "$work/divided" --server "http://127.0.0.1:$port" --data "$work/data" >/dev/null
"$FORELIGHT_BIN" render deploy/scenes/corridor --frame 3 "${size[@]}" --preview cpu --out "$work/whole.exr" >"$work/render.log" 2>&1 ||
  { cat "$work/render.log"; fail 'the frame cannot be rendered here'; }
same_bits "$work/whole.exr" "$(find "$work/divided" -name '*0003*.exr' | head -1)"

echo 'the parts of each pass over a frame are an array of their own'
submit deploy/scenes/corridor --frames 3 "${size[@]}" --samples 16 --profile-frames 1 --parts 3 --within 8s --name passes >/dev/null
wait_for 300 is "SELECT state FROM jobs WHERE name = 'passes'" done
of_parts="FROM tasks t JOIN jobs j ON j.id = t.job_id AND j.name = 'passes' AND t.kind = 'render_part'"
arrays="SELECT e.array_id, count(*) AS elements FROM slurm_elements e JOIN (SELECT t.id $of_parts) p ON p.id = e.task_id GROUP BY e.array_id"
is "SELECT (count(*) > 4) || ' ' || min(elements) || ' ' || max(elements) FROM ($arrays)" '1 3 3' ||
  fail 'the parts of each pass are not one array of three'

echo 'a daemon dies, and Slurm runs its frame a second time while the first process goes on'
job=$(submit deploy/scenes/corridor --frames 0-2 --width 640 --spp 256 --samples 16 --profile-frames 1 --parts 1 --name long)
three() { [ "$(squeue --noheader --states=RUNNING --format=%j | grep -c '^forelight-render-long')" = 3 ]; }
wait_for 120 three
read -r element node < <(squeue --noheader --states=RUNNING --name=forelight-render-long --format='%F_%K %N' | head -1)
task=$(ask "SELECT lower(hex(e.task_id)) FROM slurm_elements e JOIN slurm_arrays a ON a.id = e.array_id WHERE a.slurm_id || '_' || e.position = '$element'")
dashed=${task:0:8}-${task:8:4}-${task:12:4}-${task:16:4}-${task:20}
works() { # the numbers of the processes that were started for the task
  "$environment/bin/python" - "$dashed" <<'PYTHON'
import pathlib, sys

for path in pathlib.Path("/proc").glob("[0-9]*/cmdline"):
    try:
        words = path.read_bytes().decode().split("\0")
    except OSError:
        continue
    if words[1:2] == ["worker"] and sys.argv[1] in words:
        print(path.parent.name)
PYTHON
}
leases() { is "SELECT count(*) FROM leases WHERE lower(hex(task_id)) = '$task'" "$1"; }
wait_for 30 leases 1
first=$(works)
[ "$(wc -w <<<"$first")" = 1 ] || fail "these processes render the frame: $first"
kill -9 "${daemons[${node#node}]}"
wait "${daemons[${node#node}]}" 2>/dev/null || true
requeued() { squeue --array --noheader --states=PENDING --format='%F_%K' | grep -q "^$element\$"; }
wait_for 90 requeued
scontrol update "JobId=$element" StartTime=now
again() { squeue --noheader --states=RUNNING --format='%F_%K %N' | grep "^$element " | grep -qv " $node\$"; }
wait_for 60 again
two() { [ "$(works | wc -w)" = 2 ]; }
wait_for 30 two
sleep 6
two || fail 'one of the two processes has ended'
leases 1 || fail 'the second process has a lease of the frame that the first one renders'
# The first process dies as well. Its lease expires, and the second takes over.
kill -9 "$first"
wait_for 30 leases 2
is "SELECT count(*) FROM leases WHERE lower(hex(task_id)) = '$task' AND state = 'active'" 1 || fail 'no process took over'

echo 'a job that is cancelled here is cancelled in Slurm'
"$FORELIGHT_BIN" cancel "$job" --server "http://127.0.0.1:$port" --data "$work/data"
wait_for 60 nothing_left
is "SELECT state FROM jobs WHERE name = 'long'" cancelled || fail 'the job is not cancelled'
start_node "${node#node}"

echo 'a job whose program is missing fails with the reason'
kill -INT "$farm"
wait "$farm" || true
"$FORELIGHT_BIN" serve --data "$work/data" --listen "127.0.0.1:$port" --executor slurm --slurm-poll 0.5s \
  --slurm-program /nowhere/forelight >"$work/printed" 2>>"$work/farm.log" &
farm=$!
wait_for 30 grep -q '^listening on ' "$work/printed"
submit deploy/scenes/corridor --frames 0 --width 16 --spp 1 --samples 16 --name hopeless >/dev/null
failing() { at_least "SELECT count(*) FROM events WHERE kind = 'submission_lost' AND body LIKE '%FAILED with exit code 127%'" 2; }
wait_for 60 failing
