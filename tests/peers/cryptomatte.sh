#!/usr/bin/env bash
# Reads the Cryptomatte of our EXR files with OpenEXR, MurmurHash3 of mmh3, and the independent reader
# cryptomatte-api (https://pypi.org/project/cryptomatte-api). Names, hashes, ranks and coverage must be right.
#
#   FORELIGHT_BIN   the program (default: target/debug/forelight, which is built)
#
# Needs Python with venv, and network access. Without them it is reported as not run, and in CI it
# fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

python_with cryptomatte cryptomatte-api==1.0.0 'mmh3>=5,<6' 'numpy>=2,<3' 'OpenEXR>=3.3,<4'
need_forelight

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
quick=(--ambient-bounces 0 --preview cpu)
render() { "$FORELIGHT_BIN" render "$@" >"$work/log" 2>&1 || { cat "$work/log"; echo "failed: $*"; exit 1; }; }

for scene in corridor kitchen; do
  for integrator in ambient path; do
    echo "$scene, $integrator"
    common=(deploy/scenes/$scene "${quick[@]}" --integrator "$integrator")
    render "${common[@]}" --width 96 --height 54 --spp 16 --out "$work/many.exr"
    render "${common[@]}" --width 96 --height 54 --spp 1 --out "$work/one.exr"
    render "${common[@]}" --width 768 --height 432 --spp 1 --out "$work/large.exr"
    "$environment/bin/python" "$here/cryptomatte_peer.py" "$work/many.exr" "$work/one.exr" "$work/large.exr"
  done
done
