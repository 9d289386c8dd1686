#!/usr/bin/env bash
# A farm of two nodes, one with Blender (https://www.blender.org) and one without. While it renders 24 frames of a
# `.blend` file, the worker is killed, and then Blender itself. Every frame must be rendered once, by the node that
# has Blender, and to the bits of `forelight render`. Missing textures and too little memory are errors that
# name the frame, the file and the reason. A script in a file that never ends is not run. No process is left behind.
#
#   FORELIGHT_BIN   the program (default: target/debug/forelight, which is built)
#
# Needs Python 3.11 with venv, and network access. Without them it is reported as not run, and in CI
# it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

blender_module
need_forelight

work=$(mktemp -d)
farm=
declare -A workers=()
cleanup() {
  for process in $farm "${workers[@]}"; do
    kill -9 "$process" 2>/dev/null || true
    wait "$process" 2>/dev/null || true
  done
  rm -rf "$work"
}
trap cleanup EXIT
fail() { echo "failed: $1"; tail -n 40 "$work"/*.log 2>/dev/null || true; exit 1; }

mkdir "$work/scenes"
"$environment/bin/python" "$here/blender_scenes.py" "$work/scenes" deploy/scenes/kitchen >"$work/scenes.log" 2>&1 || fail 'no scenes'
export NO_PROXY=127.0.0.1 no_proxy=127.0.0.1
port=$(free_port)
"$FORELIGHT_BIN" serve --data "$work/data" --listen "127.0.0.1:$port" --lease-ttl 4s --bundle-root "$work/scenes" \
  --bundle-root "$PWD/deploy/scenes" >"$work/printed" 2>"$work/farm.log" &
farm=$!
wait_for 30 grep -q '^listening on ' "$work/printed"
start_worker() { # NAME PYTHON [FLAG…]
  FORELIGHT_BPY_PYTHON=$2 "$FORELIGHT_BIN" worker --data "$work/data" --server "http://127.0.0.1:$port" --name "$1" \
    --threads 1 --preview cpu --bundles "$work/bundles" "${@:3}" >"$work/$1.log" 2>&1 &
  workers[$1]=$!
}
start_worker without /nowhere/python
wait_for 60 grep -q registered "$work/without.log"
submit() { "$FORELIGHT_BIN" submit "$1" --server "http://127.0.0.1:$port" --data "$work/data" "${@:2}"; }
ended() { is "SELECT state FROM jobs WHERE name = '$1'" "$2"; }
rendered() { at_least "SELECT count(*) FROM frames f JOIN jobs j ON j.id = f.job_id WHERE j.name = 'shot' AND f.actual IS NOT NULL" "$1"; }
# same_image A B: equal channels, but for the time that pixels took.
same_image() {
  "$environment/bin/python" - "$1" "$2" <<'PYTHON' || fail "$2 is another image than $1"
import sys
import numpy
import OpenEXR

def channels(path):
    with OpenEXR.File(path, separate_channels=True) as file:
        return {name: channel.pixels for part in file.parts for name, channel in part.channels.items() if "Render Time" not in name}

ours, theirs = map(channels, sys.argv[1:])
assert ours.keys() == theirs.keys() and len(ours) > 4, (ours.keys(), theirs.keys())
worst = max(float(numpy.abs(ours[n] - theirs[n]).max() / max(numpy.abs(ours[n]).mean(), 1e-12)) for n in ours)
print(f"  {sys.argv[2].rsplit('/', 1)[1]}: largest difference {worst:.1e} of the mean")
assert worst <= 1e-5
PYTHON
}
# Blender processes that the worker of this name has started.
blenders() { pgrep -P "${workers[$1]}" -f driver.py; }

echo 'a job that no node can render waits and says why'
size=(--width 96 --height 96 --spp 16)
submit "$work/scenes/kitchen.blend" --shared --frames 0-23 "${size[@]}" --name shot --follow --out "$work/images" \
  >"$work/submit.log" 2>&1 &
submitted=$!
waits() { "$FORELIGHT_BIN" jobs --server "http://127.0.0.1:$port" --data "$work/data" --json | grep -q 'no node has cycles'; }
wait_for 30 waits
submit deploy/scenes/kitchen --shared --frames 0-1 --width 32 --spp 1 --samples 16 --name own >/dev/null
wait_for 60 ended own done

echo 'a node with Blender renders it; its worker is killed, and then Blender itself'
start_worker with "$environment/bin/python"
wait_for 120 rendered 3
left=$(blenders with)
kill -9 "${workers[with]}"
wait "${workers[with]}" 2>/dev/null || true
gone() { ! kill -0 $left; }
wait_for 10 gone
# From here on Blender runs in a sandbox.
allowed_sandbox
start_worker with "$environment/bin/python" "${sandbox[@]}"
wait_for 120 rendered 8
kill -9 $(blenders with) || fail 'there is no Blender to kill'
wait_for 240 bash -c "! kill -0 $submitted"
wait "$submitted" || fail 'the job was not delivered'
is "SELECT count(*) FROM results r JOIN tasks t ON t.id = r.task_id JOIN jobs j ON j.id = t.job_id WHERE j.name = 'shot' AND t.kind = 'render'" 24 ||
  fail 'the frames are not 24'
is "SELECT group_concat(DISTINCT n.name) FROM leases l JOIN nodes n ON n.id = l.node_id JOIN tasks t ON t.id = l.task_id JOIN jobs j ON j.id = t.job_id WHERE j.name = 'shot'" with ||
  fail 'a node without Blender had a task of the job'
at_least "SELECT count(*) FROM tasks t JOIN jobs j ON j.id = t.job_id WHERE j.name = 'shot' AND t.kind = 'render' AND t.failures > 0" 1 ||
  fail 'Blender was killed, and no task failed'
echo "  $(ask "SELECT count(*) FROM leases l JOIN tasks t ON t.id = l.task_id JOIN jobs j ON j.id = t.job_id WHERE j.name = 'shot' AND t.kind = 'render'") leases of 24 frames"

echo 'frames have the bits of `forelight render`, with and without samples of the profile'
for frame in 5 "$(ask "SELECT max(t.frame) FROM tasks t JOIN jobs j ON j.id = t.job_id WHERE j.name = 'shot' AND t.kind = 'profile'")"; do
  FORELIGHT_BPY_PYTHON=$environment/bin/python "$FORELIGHT_BIN" render "$work/scenes/kitchen.blend" --frame "$frame" \
    "${size[@]}" --threads 1 --out "$work/$frame.exr" >"$work/render.log" 2>&1 || fail "frame $frame cannot be rendered here"
  same_image "$work/$frame.exr" "$work/images/frame-$(printf %04d "$frame").exr"
done

echo 'a frame that is divided by its samples is the same image'
submit "$work/scenes/kitchen.blend" --shared --frames 5 "${size[@]}" --parts 3 --name parts --out "$work/parts" >"$work/parts.log" 2>&1 ||
  fail 'the divided frame was not delivered'
is "SELECT count(*) FROM results r JOIN tasks t ON t.id = r.task_id JOIN jobs j ON j.id = t.job_id WHERE j.name = 'parts' AND t.kind = 'render_part'" 3 ||
  fail 'the frame was not rendered in three parts'
same_image "$work/5.exr" "$work/parts/frame-0005.exr"

echo 'a quote says which objects it is for, and where in the image its time will go'
FORELIGHT_BPY_PYTHON=$environment/bin/python "$FORELIGHT_BIN" forecast "$work/scenes/kitchen.blend" --frames 0,12 "${size[@]}" \
  --explain --cost-map "$work/map.png" >"$work/why.log" 2>&1 || fail 'no explanation'
for text in 'of CPU time)' 'floor, floor_tiles' 'to halve the work: ' 'cost map of frame'; do
  grep -q "$text" "$work/why.log" || fail "not told: $text"
done
picture_of_several_colours "$work/map.png" || fail 'the cost map shows nothing'
status=0
FORELIGHT_BPY_PYTHON=$environment/bin/python "$FORELIGHT_BIN" forecast "$work/scenes/kitchen.blend" --frames 0 --spp 1 \
  --cost-map "$work/none.png" >"$work/none.log" 2>&1 || status=$?
[ $status = 2 ] && grep -q 'of 2 samples or more' "$work/none.log" || fail 'a cost map of one sample was not refused'
submit "$work/scenes/kitchen.blend" --shared --frames 3 "${size[@]}" --hold --name held >/dev/null
wait_for 60 at_least "SELECT count(preview_png) FROM frames f JOIN jobs j ON j.id = f.job_id WHERE j.name = 'held'" 1
is "SELECT count(*) FROM tasks t JOIN jobs j ON j.id = t.job_id WHERE j.name = 'held' AND t.kind = 'render'" 0 ||
  fail 'a frame of the held job was rendered'

echo 'a missing texture is named before anything is rendered'
submit "$work/scenes/missing.blend" --shared --frames 1 --spp 1 --name missing >/dev/null
wait_for 60 ended missing failed
case $(ask "SELECT error FROM jobs WHERE name = 'missing'") in
*wood*"$work/scenes/textures/wood.png"*) ;;
*) fail "the error does not name the texture: $(ask "SELECT error FROM jobs WHERE name = 'missing'")" ;;
esac

echo 'a frame without enough memory fails with the limit'
submit "$work/scenes/kitchen.blend" --shared --frames 7 --spp 1 --width 32 --task-memory 150MiB --name large >/dev/null
wait_for 120 ended large failed
case $(ask "SELECT error FROM jobs WHERE name = 'large'") in
*memory*) echo "  $(ask "SELECT error FROM jobs WHERE name = 'large'")" ;;
*) fail "the error does not name the memory: $(ask "SELECT error FROM jobs WHERE name = 'large'")" ;;
esac

echo 'a script in an uploaded file that never ends is not run'
submit "$work/scenes/script.blend" --frames 1 --spp 1 --width 32 --name script >/dev/null
wait_for 60 ended script 'done'
[ ! -e "$work/scenes/script-was-run" ] || fail 'the script was run'

echo 'an uploaded file takes its textures along; a second submission finds them on the farm'
for name in packed again; do
  FORELIGHT_BPY_PYTHON=$environment/bin/python submit "$work/scenes/kitchen.blend" --frames 5 "${size[@]}" --name $name \
    --out "$work/$name" >"$work/$name.log" 2>&1 || fail "the job $name was not delivered"
  same_image "$work/5.exr" "$work/$name/frame-0005.exr"
done
is "SELECT count(DISTINCT b.hash) FROM bundles b JOIN jobs j ON j.bundle_id = b.id WHERE j.name IN ('packed', 'again')" 1 ||
  fail 'the second submission has another file'
for python in "$environment/bin/python" /nowhere/python; do
  status=0
  FORELIGHT_BPY_PYTHON=$python submit "$work/scenes/missing.blend" >"$work/refused" 2>&1 || status=$?
  [ $status = 2 ] || fail "exit code $status for a file that is missing"
  cat "$work/refused"
done | grep -c -e 'missing assets: image wood' -e 'it is not on this machine' | grep -qx 2 || fail 'missing files are not told'

echo 'a frame that is cancelled ends, and no process is left behind'
submit "$work/scenes/kitchen.blend" --shared --frames 0 --width 512 --spp 4096 --profile-frames 1 --name long >"$work/long"
renders() { is "SELECT count(*) FROM tasks t JOIN jobs j ON j.id = t.job_id WHERE j.name = 'long' AND t.state = 'leased'" 1; }
wait_for 60 renders
"$FORELIGHT_BIN" cancel "$(cat "$work/long")" --server "http://127.0.0.1:$port" --data "$work/data" >/dev/null
left=$(blenders with || true)
kill -INT "${workers[with]}"
wait "${workers[with]}" || true
for process in $left; do ! kill -0 "$process" 2>/dev/null || fail "process $process is left"; done
