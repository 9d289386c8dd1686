#!/usr/bin/env bash
# Denoised images against Open Image Denoise called from Python (https://pypi.org/project/pyoidn), and their
# measured error against an image with many samples.
#
#   FORELIGHT_BIN   the program (default: target/debug/forelight, which is built)
#
# Needs Python with venv, and network access. Without them it is reported as not run, and in CI it
# fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

python_with oidn pyoidn==2.5.1 'numpy>=2,<3' 'OpenEXR>=3.3,<4'
need_forelight
FORELIGHT_OIDN=$("$environment/bin/python" -c 'import pathlib, pyoidn; print(pathlib.Path(pyoidn.__file__).parent / "oidn/bin/oidnDenoise")')
export FORELIGHT_OIDN

work=$(mktemp -d)
farm=
trap stop_farm EXIT
fail() { echo "failed: $*" >&2; exit 1; }
scene=(deploy/scenes/kitchen --width 112 --height 63 --preview cpu)
render() { "$FORELIGHT_BIN" render "${scene[@]}" "$@" >"$work/log" 2>&1; }
# run FLAGS…: the same, which must succeed.
run() { render "$@" || { cat "$work/log"; fail "$*"; }; }

light=(--ambient-bounces 0)
echo 'a converged image'
run "${light[@]}" --spp 1024 --seed 99 --out "$work/converged.exr"
for samples in 4 16; do
  echo "$samples samples"
  run "${light[@]}" --spp $samples --out "$work/noisy.exr"
  run "${light[@]}" --spp $samples --denoise --out "$work/denoised-$samples.exr" --stats "$work/stats.json"
  "$environment/bin/python" "$here/denoise_peer.py" \
    "$work"/{noisy,"denoised-$samples",converged}.exr "$work/stats.json"
done

# forecast FLAGS…: the ladders.
forecast() {
  "$FORELIGHT_BIN" accuracy "$@" --denoise --json >"$work/ladders.json" 2>"$work/log" ||
    { cat "$work/log"; fail "accuracy $*"; }
}
echo 'the same errors, forecast'
forecast "${scene[@]}" "${light[@]}" --spp 4
"$environment/bin/python" "$here/denoise_forecast.py" "$work/ladders.json" \
  4:"$work/denoised-4.exr:$work/converged.exr" 16:"$work/denoised-16.exr:$work/converged.exr"
echo 'and those of a larger image, by some of its tiles'
larger=(deploy/scenes/kitchen --width 256 --height 144 --preview cpu "${light[@]}" --spp 4)
forecast "${larger[@]}"
"$FORELIGHT_BIN" render "${larger[@]}" --denoise --out "$work/larger.exr" --stats "$work/stats.json" >"$work/log" 2>&1 ||
  { cat "$work/log"; fail 'a larger image'; }
"$environment/bin/python" "$here/denoise_forecast.py" "$work/ladders.json" 4:"$work/stats.json"

echo 'an image with a cache, in a sequence, as a picture'
run --cache on --frames 0-1 --spp 1 --denoise --out "$work/draft-####.png"
[ -s "$work/draft-0001.png" ] || fail 'no second picture'

echo 'frames of a farm, whole and in parts'
"$FORELIGHT_BIN" farm --data "$work/data" --workers 1 --preview cpu --listen 127.0.0.1:0 >"$work/farm" 2>&1 &
farm=$!
server=$(farm_address "$work/farm" "$farm")
scene=(deploy/scenes/kitchen --width 64 --height 36 --preview cpu)
cached=(--cache on --spp 2 --frame 1 --denoise)
run "${cached[@]}" --out "$work/here.exr"
for parts in 1 2; do
  run "${cached[@]}" --server "$server" --data "$work/data" --parts $parts --out "$work/farm.exr" --stats "$work/stats.json"
  "$environment/bin/python" "$here/denoise_farm.py" "$work"/{here,farm}.exr "$work/stats.json"
done

echo 'ladders in a quote of the farm'
at=(--server "$server" --data "$work/data")
"$FORELIGHT_BIN" submit deploy/scenes/kitchen "${at[@]}" --frames 0-3 --width 64 --height 36 --spp 4 \
  --ambient-bounces 1 --name ladders --ladders --denoise --hold --follow >"$work/log" 2>&1 ||
  { cat "$work/log"; fail 'submit --ladders --denoise'; }
"$FORELIGHT_BIN" accuracy "${at[@]}" --job ladders --json >"$work/ladders.json"
"$environment/bin/python" "$here/denoise_forecast.py" "$work/ladders.json"

echo 'errors'
# refuse TEXT VARIABLE FLAGS…: a render must fail with this text and leave nothing.
refuse() {
  ! FORELIGHT_OIDN=$2 render "${@:3}" --out "$work/none.exr" || fail "no error: ${*:3}"
  grep -q "$1" "$work/log" || { cat "$work/log"; fail "another error: ${*:3}"; }
  [ ! -e "$work/none.exr" ] || fail 'it left an image'
}
refuse 'www.openimagedenoise.org' "$work/nowhere" --denoise
refuse 'cannot be used with' "$FORELIGHT_OIDN" --denoise --error 5
printf '#!/bin/sh\n[ "$1" = --list_devices ] && echo "Type: CPU" && exit\necho "Error: no memory" >&2\nexit 1\n' >"$work/broken"
chmod +x "$work/broken"
refuse 'no memory' "$work/broken" "${light[@]}" --spp 1 --denoise
