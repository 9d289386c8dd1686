#!/usr/bin/env bash
# Compares our rays with Embree's (https://www.embree.org) one by one: they must hit the same triangles.
# Speeds are printed, but not tested. To measure them, use a release build:
#
#   FORELIGHT_BIN=target/release/forelight FORELIGHT_EMBREE_RAYS=300000 FORELIGHT_EMBREE_REPEATS=15 tests/peers/embree.sh
#
#   FORELIGHT_BIN             the program (default: target/debug/forelight, which is built)
#   FORELIGHT_SHARED          folder with test scenes (default: ../shared); without it, our own scenes
#   FORELIGHT_EMBREE_RAYS     approximate number of rays of each kind (default: 5000)
#   FORELIGHT_EMBREE_REPEATS  how often each program traces them, in turns (default: 3)
#
# Needs Embree (Debian: libembree-dev), a C++ compiler and Python. Without them it is reported as not run, and
# in CI it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

deploy/packages.sh g++ libembree-dev || skip 'Embree cannot be installed (no network?)'
command -v g++ >/dev/null || skip 'no C++ compiler'
embree=
for version in 4 3; do
  if echo "#include <embree$version/rtcore.h>" | g++ -E -x c++ - >/dev/null 2>&1; then
    embree=$version
    break
  fi
done
[ -n "$embree" ] || skip 'no Embree (Debian: libembree-dev)'
command -v python3 >/dev/null || skip 'no python3'

peer=$PWD/target/peers/embree
if [ ! -x "$peer" ] || [ tests/peers/embree.cpp -nt "$peer" ]; then
  mkdir -p target/peers
  g++ -std=c++17 -O2 -Wall -Wextra tests/peers/embree.cpp -o "$peer" "-lembree$embree"
fi
need_forelight

test_scenes kitchen country-kitchen modern-hall living-room
scenes+=("$PWD/deploy/scenes/corridor")
result=$(mktemp)
trap 'rm -f "$result"' EXIT
"$FORELIGHT_BIN" bench rays "${scenes[@]}" --peer "$peer" --json \
  --rays "${FORELIGHT_EMBREE_RAYS:-5000}" --repeats "${FORELIGHT_EMBREE_REPEATS:-3}" >"$result"

python3 - "$result" <<'PYTHON'
import json, sys

measured = json.load(open(sys.argv[1]))
# Results may differ for rays that start within rounding of a surface or pass an edge.
allowed = 0.001
wrong = []
print(f"{'':32}{'ours':>10}{measured['peer']:>16}{'ratio':>8}{'differ':>8}   (million rays a second)")
for scene in measured["scenes"]:
    print(f"{scene['bundle']}: {scene['triangles']} triangles, tree {scene['tree_bytes_per_triangle']:.0f} "
          f"and geometry {scene['geometry_bytes_per_triangle']:.0f} bytes a triangle")
    for kind in scene["kinds"]:
        print(f"  {kind['kind'] + ', ' + kind['query']:30}{kind['rays_per_second'] / 1e6:10.2f}"
              f"{kind['peer_rays_per_second'] / 1e6:16.2f}{kind['ratio']:8.2f}{kind['differing']:8}")
        if kind["rays"] == 0 or kind["differing"] > allowed * kind["rays"]:
            wrong.append(f"{scene['bundle']}, {kind['kind']}: {kind['differing']} of {kind['rays']} rays differ")
if wrong:
    sys.exit("Embree disagrees: " + "; ".join(wrong))
PYTHON
