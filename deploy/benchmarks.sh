#!/usr/bin/env bash
# Fills docs/benchmarks.md: builds forelight and runs the benches, each at a size that takes minutes.
#
#   deploy/benchmarks.sh              all benches
#   deploy/benchmarks.sh plan rays    only these; the sections of the others stay
#
# FORELIGHT_BIN   a forelight binary to use instead of building one; it must be a release build
set -euo pipefail
cd "$(dirname "$0")/.."

case "${1:-}" in
  -h | --help) sed -n '2,7s/^# \{0,1\}//p' "$0"; exit 0 ;;
esac

command -v cargo >/dev/null || PATH="$HOME/.cargo/bin:$PATH"
if [ -z "${FORELIGHT_BIN:-}" ]; then
  cargo build --release --package forelight-cli
  FORELIGHT_BIN=$(realpath "${CARGO_TARGET_DIR:-target}")/release/forelight
fi

scenes=(deploy/scenes/kitchen deploy/scenes/corridor)
# `bench paper` also writes its own report with pictures.
report=${CARGO_TARGET_DIR:-target}/benchmarks/paper
mkdir -p docs

# Runs one bench if asked for, and writes its section.
bench() {
  [ "${#wanted[@]}" -eq 0 ] || [[ " ${wanted[*]} " == *" $1 "* ]] || return 0
  printf '\n== %s (%d s)\n' "$1" "$SECONDS"
  "$FORELIGHT_BIN" bench "$@" --write docs/benchmarks.md
}
wanted=("$@")

bench forecast "${scenes[@]}"
bench shots "${scenes[@]}" --seeds 2
bench coverage "${scenes[@]}"
bench paper "${scenes[@]}" --size 128 --seeds 20 --repeats 1 --out "$report"
bench seconds "${scenes[@]}" --width 96 --rounds 3
bench divide "${scenes[@]}" --width 640 --height 360 --ambient-bounces 1
bench effects "${scenes[@]}" --width 64 --height 64 --repeats 3
bench cache "${scenes[@]}" --size 192 --height 108 --rung '--cache on' --error 0.5,1,2,4
bench images "${scenes[0]}" --size 128 --repeats 1 --reference '--integrator path --spp 1024'
bench preview "${scenes[@]}"
bench rays "${scenes[@]}"
bench plan
bench leases
bench workers --workers 1000 --time 30s
