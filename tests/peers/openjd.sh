#!/usr/bin/env bash
# The reference implementation of Open Job Description (https://github.com/OpenJobDescription) runs jobs
# written by `forelight export`. Every channel of the images, except measured time, must have the bits of
# `forelight render`.
#
#   FORELIGHT_BIN   the program (default: target/debug/forelight, which is built)
#
# Needs Python with venv, and network access. Without them it is reported as not run, and in CI it
# fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

python_with openjd openjd-cli==0.8.0 'numpy>=2,<3' 'OpenEXR>=3.3,<4'
need_forelight

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
log=$work/log
quietly() { "$@" >"$log" 2>&1 || { cat "$log"; echo "failed: $*"; exit 1; }; }
# Each of these characters is special in a shell, in JSON or in a format string.
scene="$work/it's {{Param.Frames}} \"shot\" \$(false); *"
cp -r deploy/scenes/corridor "$scene"
small=(--width 64 --height 36 --spp 2)
# Farms without an extension could not run the job.
check() { quietly "$environment/bin/openjd" check "$1" --extensions ''; }

echo 'a job without a cache'
quietly "$FORELIGHT_BIN" export "$scene" --frames 0,2 "${small[@]}" --name "it's {{mine}}" --out "$work/plain.json"
check "$work/plain.json"
quietly "$environment/bin/openjd" run "$work/plain.json" -p "Forelight=$FORELIGHT_BIN" -p Preview=cpu -p "Images=$work/plain"
for frame in 0 2; do
  quietly "$FORELIGHT_BIN" render "$scene" --frame "$frame" "${small[@]}" --preview cpu --out "$work/$frame.exr"
  same_bits "$work/$frame.exr" "$work/plain/$frame.exr"
  [ -s "$work/plain/$frame.json" ]
done
[ "$(find "$work/plain" -type f | wc -l)" = 4 ]

echo 'a job with a forecast, and the cost of a frame'
quietly "$FORELIGHT_BIN" forecast "$scene" --frames 0-2 "${small[@]}" --samples 16 --preview cpu --json
cp "$log" "$work/quote.json"
quietly "$FORELIGHT_BIN" export "$scene" --frames 0-2 "${small[@]}" --threads 2 \
  --forecast "$work/quote.json" --stats "$work/plain/0.json" --out "$work/known.json"
check "$work/known.json"
grep -q 'amount.worker.memory' "$work/known.json"
quietly "$environment/bin/openjd" summary "$work/known.json"
grep -q 'Total tasks: 3' "$log"

echo 'a job with tasks of several frames'
quietly "$FORELIGHT_BIN" export "$scene" --frames 0-2 "${small[@]}" --threads 2 --forecast "$work/quote.json" --chunk 1m \
  --out "$work/chunks.json"
quietly "$environment/bin/openjd" check "$work/chunks.json"
grep -q '"targetRuntimeSeconds": "{{Param.ChunkSeconds}}"' "$work/chunks.json"
grep -q '"default": 60' "$work/chunks.json"
for frames in 150 2; do
  quietly "$environment/bin/openjd" run "$work/chunks.json" -p "Forelight=$FORELIGHT_BIN" -p Preview=cpu \
    -p "ChunkFrames=$frames" -p ChunkSeconds=0 -p "Images=$work/chunks-$frames"
  cp "$log" "$work/run-$frames"
  for frame in 0 2; do same_bits "$work/$frame.exr" "$work/chunks-$frames/$frame.exr"; done
done
# One process renders three frames, or two render them.
grep -q 'Chunks run: 1' "$work/run-150"
grep -q 'Chunks run: 2' "$work/run-2"

# With two bounces, the second level of the cache is filled and merged before the first.
cached=("${small[@]}" --cache on --cache-rays 48 --ambient-bounces 2)
echo 'a shot with a cache'
quietly "$FORELIGHT_BIN" cache plan "$scene" --frames 0-1 "${cached[@]}" --preview cpu --out "$work/plan.cache"
quietly "$FORELIGHT_BIN" cache fill "$scene" "${cached[@]}" --preview cpu --cache-file "$work/plan.cache" --out "$work/shot.cache"
for frame in 0 1; do
  quietly "$FORELIGHT_BIN" render "$scene" --frame "$frame" "${cached[@]}" --preview cpu --cache-file "$work/shot.cache" --out "$work/$frame.exr"
done
for parts in 1 3; do
  echo "  tasks that fill a level: $parts"
  quietly "$FORELIGHT_BIN" export "$scene" --frames 0-1 "${cached[@]}" --cache-parts "$parts" --out "$work/cached.json"
  check "$work/cached.json"
  quietly "$environment/bin/openjd" run "$work/cached.json" -p "Forelight=$FORELIGHT_BIN" -p Preview=cpu \
    -p "Images=$work/cached-$parts" -p "CacheFolder=$work/cache-$parts"
  for frame in 0 1; do same_bits "$work/$frame.exr" "$work/cached-$parts/$frame.exr"; done
done

echo 'a shot whose cache is chosen for an error'
quietly "$FORELIGHT_BIN" export "$scene" --frames 0-1 "${small[@]}" --ambient-bounces 1 --cache-error 5 --cache-parts 2 \
  --out "$work/chosen.json"
rays=$(sed -n 's/.*--cache-rays \([0-9]*\).*/\1/p' "$log")
check "$work/chosen.json"
python3 - "$work/chosen.json" "$rays" <<'PYTHON'
import json, sys
defaults = {one["name"]: one.get("default") for one in json.load(open(sys.argv[1]))["parameterDefinitions"]}
assert defaults["CacheRays"] == int(sys.argv[2]) > 0, defaults
PYTHON

echo 'a job that others wrote, as a renderer'
other=$work/other
mkdir "$other"
# A renderer whose pixels depend on all that it is told.
cat >"$other/draw.py" <<'PYTHON'
import struct, sys, zlib
scene, out, frame, width, height, tint = sys.argv[1:]
frame, width, height = int(frame), int(width), int(height)
shade = sum(open(scene, "rb").read()) + len(tint)
rows = b"".join(
    b"\0" + bytes((x * 7 + y * 3 + frame * 11 + shade * c) % 256 for x in range(width) for c in (1, 2, 3))
    for y in range(height))
def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
content = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
open(out, "wb").write(b"\x89PNG\r\n\x1a\n" + content)
PYTHON
echo 'a scene' >"$other/scene.txt"
cat >"$other/shot.job.yaml" <<'YAML'
specificationVersion: jobtemplate-2023-09
name: A shot
parameterDefinitions:
  - {name: Scene, type: PATH, objectType: FILE, dataFlow: IN, default: scene.txt}
  - {name: Folder, type: PATH, objectType: DIRECTORY, dataFlow: OUT, default: images}
  - {name: Draw, type: PATH, default: draw.py}
  - {name: Frames, type: STRING, default: "3-7:2"}
  - {name: Width, type: INT, default: 24}
  - {name: Height, type: INT, default: 16}
steps:
  - name: Render
    parameterSpace:
      taskParameterDefinitions:
        - {name: Frame, type: INT, range: "{{Param.Frames}}"}
    stepEnvironments:
      - {name: Tint, variables: {TINT: "warm {{Param.Width}}"}}
    script:
      actions:
        onRun: {command: bash, args: ["{{Task.File.Run}}"]}
      embeddedFiles:
        - name: Run
          type: TEXT
          data: |
            exec python3 "{{Param.Draw}}" "{{Param.Scene}}" "{{Param.Folder}}/{{Task.Param.Frame}}.png" \
              {{Task.Param.Frame}} {{Param.Width}} {{Param.Height}} "$TINT"
YAML
cat >"$other/shot.command.toml" <<'TOML'
name = "draw"
version = "1"
scene = "scene.txt"
output = "{frame}.png"
can = ["size"]

[openjd]
template = "shot.job.yaml"

[openjd.parameters]
Scene = "{scene}"
Folder = "{out_folder}"
Width = "{width}"
Height = "{height}"

[defaults]
width = 24
height = 16
TOML
mkdir "$other/images" "$other/here"
check "$other/shot.job.yaml"
quietly "$environment/bin/openjd" run "$other/shot.job.yaml"
quietly "$FORELIGHT_BIN" render "$other/shot.command.toml" --frames 3,5,7 --out "$other/here/#.png"
for frame in 3 5 7; do cmp "$other/images/$frame.png" "$other/here/$frame.png"; done

echo 'a shot of another renderer, in tasks of several frames'
quietly "$FORELIGHT_BIN" forecast "$other/shot.command.toml" --frames 3,5,7 --width 48 --json
sed -n '/^{/,$p' "$log" >"$work/other-quote.json"
quietly "$FORELIGHT_BIN" export "$other/shot.command.toml" --frames 3,5,7 --width 48 --threads 1 \
  --forecast "$work/other-quote.json" --chunk 1m --out "$other/exported.json"
quietly "$environment/bin/openjd" check "$other/exported.json"
quietly "$environment/bin/openjd" run "$other/exported.json" -p "Forelight=$FORELIGHT_BIN" -p "Images=$work/exported"
quietly "$FORELIGHT_BIN" render "$other/shot.command.toml" --frames 3,5,7 --width 48 --out "$other/here/#.png"
for frame in 3 5 7; do cmp "$work/exported/$frame.png" "$other/here/$frame.png"; done
if "$FORELIGHT_BIN" export "$other/shot.command.toml" --frames 3,5,7 --forecast "$work/other-quote.json" \
  --out "$other/wrong.json" 2>"$log"; then
  echo 'error: a quote of another size was taken' >&2
  exit 1
fi
grep -q 'it is of another quality (height: 32 and 16; width: 48 and 24)' "$log"
