#!/usr/bin/env bash
# Radiance (https://www.radiance-online.org) behind the renderer's door: descriptions, previews, rays by kind,
# pixels that are taken over against one render, and images against rpict's; then one of the project's scenes,
# quoted and rendered by the command line and by a farm.
#
#   tests/peers/radiance_renderer.sh          as above
#   tests/peers/radiance_renderer.sh --full   errors of quotes from 256 of 65,536 pixels, 30 seeds (minutes)
#
#   FORELIGHT_BIN   the program (default: target/debug/forelight, which is built)
#
# Needs Python with venv, and network access. Without them it is reported as not run, and in CI it
# fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

radiance_programs

work=$(mktemp -d)
farm=
cleanup() {
  [ -z "$farm" ] || { kill "$farm" 2>/dev/null || true; wait "$farm" 2>/dev/null || true; }
  rm -rf "$work"
}
trap cleanup EXIT
fail() { echo "failed: $1"; tail -n 30 "$work"/*.log 2>/dev/null || true; exit 1; }

export_scene() { "$environment/bin/python" "$here/radiance_scenes.py" "deploy/scenes/$1" "$work/$1" --size "$2"; }

if [ "${1:-}" = --full ]; then
  need_forelight
  for scene in kitchen corridor; do
    rif=$(export_scene "$scene" 256)
    for level in 'ambient_bounces=0' 'ambient_bounces=1 --set ambient_accuracy=0 --set ambient_divisions=64 --set ambient_super_samples=0'; do
      echo "== $scene, $level"
      # shellcheck disable=SC2086 # the flags are words
      "$FORELIGHT_BIN" bench renderers "$rif" --frames 1 --seeds "${SEEDS:-30}" --threads 1 --set $level
    done
  done
  exit 0
fi

# The test that looks for processes that are left runs alone.
questions() { workspace test --test rtrace -- --ignored "$@"; }
questions --skip leaves_no_process
questions leaves_no_process
need_forelight
rif=$(export_scene kitchen 128) || fail 'the kitchen cannot be exported'

echo 'the command line finds Radiance, and quotes, renders and writes three kinds of image'
"$FORELIGHT_BIN" renderers --json >"$work/renderers.json" 2>"$work/renderers.log" || fail 'no renderers'
grep -q '"name": "radiance"' "$work/renderers.json" || fail 'Radiance is not listed'
"$FORELIGHT_BIN" forecast "$rif" --threads 1 --cost-map "$work/map.png" --json >"$work/quote.json" 2>"$work/forecast.log" || fail 'no quote'
picture_of_several_colours "$work/map.png" || fail 'the cost map shows nothing'
for kind in exr hdr png; do
  "$FORELIGHT_BIN" render "$rif" --threads 1 --out "$work/1.$kind" --stats "$work/stats.json" >/dev/null 2>"$work/render.log" ||
    fail "no $kind image"
done
"$environment/bin/python" - "$work" <<'PYTHON'
import json, sys
from pathlib import Path
folder = Path(sys.argv[1])
quote, stats = (json.loads((folder / name).read_text()) for name in ("quote.json", "stats.json"))
forecast, actual = quote["total"]["cpu_seconds"]["mean"], stats["cpu_seconds"]
rays = quote["total"]["rays"]
print(f"  {forecast:.3f} s of CPU time forecast, {actual:.3f} s taken; {rays['shadow']['mean']:.0f} shadow rays")
assert quote["profiled"]["pixels"] == 256 and rays["primary"]["mean"] == 128 * 128, rays
assert rays["transparent"]["mean"] > 0 and rays["ambient"]["mean"] == 0, rays
assert (folder / "1.hdr").read_bytes().startswith(b"#?RADIANCE\nVIEW= ")
PYTHON

echo 'a farm renders it from shared storage, and takes over the pixels of the profile'
export NO_PROXY=127.0.0.1 no_proxy=127.0.0.1
port=$(free_port)
allowed_sandbox
"$FORELIGHT_BIN" farm --data "$work/data" --listen "127.0.0.1:$port" --workers 1 --threads 1 --preview cpu \
  "${sandbox[@]}" --bundle-root "$work" >"$work/printed" 2>"$work/farm.log" &
farm=$!
wait_for 60 grep -q '^listening on ' "$work/printed"
"$FORELIGHT_BIN" submit "$rif" --shared --frames 1 --server "http://127.0.0.1:$port" --data "$work/data" --out "$work/images" \
  --name hall >"$work/submit.log" 2>&1 || fail 'the job was not delivered'
# Besides 256 pixels, neighbours of some of them are finished.
at_least "SELECT json_extract(actual, '\$.reused_pixels') FROM frames" 257 || fail 'the pixels of the profile were traced again'
"$environment/bin/python" - "$work/1.exr" "$work/images/frame-0001.exr" <<'PYTHON'
import sys
import numpy
import OpenEXR

def image(path):
    with OpenEXR.File(path, separate_channels=True) as file:
        return numpy.stack([file.channels()[name].pixels for name in "RGB"])

ours, theirs = map(image, sys.argv[1:])
differ = (ours != theirs).any(axis=0)
print(f"  {differ.mean():.2%} of the pixels differ from one render, the image's mean by {abs(theirs.mean() / ours.mean() - 1):.1e}")
# Shadow tests of many lights depend on those before, see docs/renderers.md.
assert abs(theirs.mean() / ours.mean() - 1) < 1e-3
PYTHON
