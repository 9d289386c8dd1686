#!/usr/bin/env bash
# Compares our images with those of Radiance (https://www.radiance-online.org), which introduced the
# irradiance cache. An independent reader, tests/peers/bundle.py, loads the bundles. Radiance counts light of
# the sky as a bounce, so the bundles have no sky.
#
#   tests/peers/radiance.sh                   small images: means, and those of 8 × 8 blocks, must agree
#   tests/peers/radiance.sh --full BUNDLE…    CPU time of an equal error (an hour), by `forelight bench images`
#
#   FORELIGHT_BIN      the program (default: target/debug/forelight, which is built; with --full:
#                      target/release/forelight)
#   FORELIGHT_SHARED   folder with test scenes (default: ../shared)
#
# Needs Python with venv, and network access. Without them it is reported as not run, and in CI it
# fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

radiance_programs
radiance() { "$environment/bin/python" "$here/radiance_peer.py" "$@"; }

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

if [ "${1:-}" = --full ]; then
  shift
  bin=${FORELIGHT_BIN:-$PWD/target/release/forelight}
  # From quick to good. The best one at an error represents Radiance.
  ladder=(
    --rung '1: x1 -aa .3 -ad 256 -as 64 -ar 32 -dt .05 -dc .5'
    --rung '2: x1 -aa .2 -ad 512 -as 128 -ar 64 -dt .05 -dc .5'
    --rung '3: x1 -aa .2 -ad 512 -as 128 -ar 64'
    --rung '4: x2 -aa .2 -ad 512 -as 128 -ar 64 -dt .05 -dc .5'
    --rung '5: x2 -aa .15 -ad 1024 -as 256 -ar 128 -dt .02 -dc .75'
    --rung '6: x2 -aa .1 -ad 2048 -as 512 -ar 128'
    --rung '7: x3 -aa .15 -ad 1024 -as 256 -ar 128 -dt .02 -dc .75'
  )
  for scene in "$@"; do
    images=$PWD/target/peers/radiance-$(basename "$scene")
    [ ! -e "$images/bundle" ] || { chmod -R u+w "$images/bundle" && rm -rf "$images/bundle"; }
    mkdir -p "$images"
    echo "== $(basename "$scene"), without a sky"
    "$environment/bin/python" "$here/bundle.py" without-environment "$scene" "$images/bundle"
    radiance "$images/bundle" --out "$images" --size 512 "${ladder[@]}" | tee "$images/measured.jsonl"
    # Converged, without a cache.
    [ -e "$images/radiance-reference.exr" ] || radiance "$images/bundle" --out "$images" --size 512 --rung 'reference: x4 -aa 0 -ad 32 -as 0 -u+'
    mapfile -t peers < <("$environment/bin/python" "$here/bundle.py" peers "$images/measured.jsonl" "$images/radiance-reference.exr")
    "$bin" bench images "$images/bundle" --size 512 --materials lambert --ambient-bounces 1 --references "$images/references" \
      --out "$images/bench.json" --pictures "$images" "${peers[@]}"
  done
  exit 0
fi

need_forelight
test_scenes kitchen cornell-box
failed=0
for scene in "${scenes[@]}"; do
  name=$(basename "$scene")
  "$environment/bin/python" "$here/bundle.py" without-environment "$scene" "$work/$name"
  radiance "$work/$name" --out "$work" --size 64 \
    --rung 'cache: x4 -aa .15 -ad 256 -as 64 -ar 64' >/dev/null
  for quality in '--spp 64 --ambient-divisions 8' '--spp 64 --cache on'; do
    echo "$name without its sky, one bounce, $quality"
    # shellcheck disable=SC2086 # the flags are words
    "$FORELIGHT_BIN" render "$work/$name" --width 64 --height 64 --materials lambert --ambient-bounces 1 $quality \
      --preview cpu --out "$work/ours.exr" >/dev/null 2>"$work/log" || { cat "$work/log"; exit 1; }
    "$environment/bin/python" "$here/bundle.py" compare "$work/ours.exr" "$work/radiance-cache.exr" 0.015 0.025 || failed=1
  done
done
exit "$failed"
