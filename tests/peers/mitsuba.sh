#!/usr/bin/env bash
# Compares our images with those of Mitsuba 3 (https://mitsuba-renderer.org), an independent path tracer. An
# independent reader, tests/peers/bundle.py, loads the bundles.
#
#   tests/peers/mitsuba.sh                   compares means of small images, with diffuse materials also of blocks
#   tests/peers/mitsuba.sh --full BUNDLE…    CPU time of an equal error (minutes), by `forelight bench images`
#
#   FORELIGHT_BIN      the program (default: target/debug/forelight, which is built; with --full:
#                      target/release/forelight)
#   FORELIGHT_SHARED   folder with test scenes (default: ../shared)
#
# Needs Python with venv, and the network. Where they are missing it is reported as not run; in CI it
# fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

python_with mitsuba mitsuba==3.9.1 'numpy>=2,<3' 'OpenEXR>=3.3,<4'

# Mitsuba's vectorised renderer needs a recent LLVM. Without it, Mitsuba renders ray by ray.
llvm() {
  local names=(/usr/lib/*/libLLVM.so.* /usr/lib/*/libLLVM-1[6-9].so*) name
  for name in "${names[@]}"; do [ -e "$name" ] && echo "$name" && return; done
}
if [ -z "${DRJIT_LIBLLVM_PATH:-}" ] && [ -z "$(llvm)" ]; then deploy/packages.sh libllvm19 || true; fi
DRJIT_LIBLLVM_PATH=${DRJIT_LIBLLVM_PATH:-$(llvm)}
if [ -n "$DRJIT_LIBLLVM_PATH" ]; then
  export DRJIT_LIBLLVM_PATH
  variant=llvm_ad_rgb
else
  echo 'note: no LLVM 16 or later; Mitsuba renders ray by ray'
  variant=scalar_rgb
fi
mitsuba() { "$environment/bin/python" "$here/mitsuba_peer.py" --variant "$variant" "$@"; }

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

if [ "${1:-}" = --full ]; then
  shift
  bin=${FORELIGHT_BIN:-$PWD/target/release/forelight}
  for scene in "$@"; do
    images=$PWD/target/peers/mitsuba-$(basename "$scene")
    mkdir -p "$images/reference"
    echo "== $(basename "$scene"), $(basename "$variant")"
    mitsuba "$scene" --out "$images" --size 512 --spp 1,4,16,64,256 --repeats 3 | tee "$images/measured.jsonl"
    [ -e "$images/reference/mitsuba-4096.exr" ] || mitsuba "$scene" --out "$images/reference" --size 512 --spp 4096 --seed 2
    mapfile -t peers < <("$environment/bin/python" "$here/bundle.py" peers "$images/measured.jsonl" "$images/reference/mitsuba-4096.exr")
    "$bin" bench images "$scene" --size 512 --materials lambert --ambient-bounces 1 --references "$images/references" \
      --out "$images/bench.json" --pictures "$images" "${peers[@]}"
  done
  exit 0
fi

need_forelight
test_scenes kitchen cornell-box
# Mitsuba's mean of the kitchen varies by 0.6 % between runs, whatever the seed and the samples (slivers
# beside lamps), and at this size our cache brightens by 0.3 %. Tests to 0.1 % use references with standard
# errors.
mean_tolerance=0.01
failed=0
for scene in "${scenes[@]}"; do
  name=$(basename "$scene")
  mkdir "$work/$name"
  mitsuba "$scene" --out "$work/$name" --size 64 --spp 4096 >/dev/null
  for quality in '--spp 64 --ambient-divisions 8' '--spp 64 --cache on'; do
    echo "$name, one bounce, $quality"
    # shellcheck disable=SC2086 # the flags are words
    "$FORELIGHT_BIN" render "$scene" --width 64 --height 64 --materials lambert --ambient-bounces 1 $quality \
      --preview cpu --out "$work/$name/ours.exr" >/dev/null 2>"$work/log" || { cat "$work/log"; exit 1; }
    "$environment/bin/python" "$here/bundle.py" compare "$work/$name/ours.exr" "$work/$name/mitsuba-4096.exr" "$mean_tolerance" 0.02 || failed=1
  done
done

# All materials. Mitsuba's own roughplastic is not the bundle format's plastic, so Mitsuba is taught the latter: see
# mitsuba_materials.py. The two programs count bounces in different ways: ours leaves mirrors and smooth glass out. So both
# follow paths for up to 100 bounces, beyond which hardly any light is left, and Russian roulette ends most of them sooner.
echo "Mitsuba's roughplastic against the plastic of the bundle format"
"$environment/bin/python" "$here/mitsuba_materials.py"
scenes=()
if [ "$variant" = scalar_rgb ]; then
  missing 'no LLVM 16 or later: images with all materials would take hours'
else
  shared_scenes country-kitchen living-room
fi
for scene in "${scenes[@]}"; do
  name=$(basename "$scene")
  echo "$name, all materials"
  mkdir -p "$work/full/$name"
  mitsuba "$scene" --out "$work/full/$name" --size 64 --spp 128 --batches 8 --materials format --depth 100 >/dev/null
  for seed in {1..8}; do
    "$FORELIGHT_BIN" render "$scene" --width 64 --height 64 --integrator path --ambient-bounces 100 --max-depth 64 --spp 128 \
      --seed "$seed" --preview cpu --out "$work/full/$name/ours-$seed.exr" >/dev/null 2>"$work/log" || { cat "$work/log"; exit 1; }
  done
  "$environment/bin/python" "$here/bundle.py" compare-means 0.001 0.0008 \
    "$work/full/$name"/ours-*.exr "$work/full/$name"/mitsuba-128-*.exr || failed=1
done
exit "$failed"
