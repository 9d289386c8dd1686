#!/usr/bin/env bash
# Quotes and renders scenes of Blender, Radiance, POV-Ray and Mitsuba with many seeds. Prints how far the quotes are
# off, and how often jobs cost at most P80 and P95, before and after calibration. Asserts nothing.
#
#   tests/other_renderers.sh          prints the figures
#   tests/other_renderers.sh --write  also writes them into docs/benchmarks.md
#
#   FORELIGHT_BIN   the program (default: it is built, for release)
#   SEEDS           jobs of each scene (default: 25, a quarter of an hour)
#
# Needs what the tests of these renderers need (tests/peers). Measure on a quiet machine: costs are CPU time.
set -euo pipefail
cd "$(dirname "$0")/.."
source tests/peers/support.bash

scenes=target/other_renderers
mkdir -p "$scenes"
blender_module
FORELIGHT_BPY_PYTHON=$environment/bin/python
"$FORELIGHT_BPY_PYTHON" tests/peers/blender_scenes.py "$scenes" deploy/scenes/{kitchen,corridor} >/dev/null 2>&1
radiance_programs
rifs=()
for name in kitchen corridor; do
  "$environment/bin/python" tests/peers/radiance_scenes.py "deploy/scenes/$name" "$scenes/$name" --size 96 >/dev/null
  rifs+=("$scenes/$name/$name.rif")
done
python_with mitsuba mitsuba==3.9.1 'numpy>=2,<3' 'OpenEXR>=3.3,<4'
deploy/packages.sh povray
"$environment/bin/python" tests/peers/command_scenes.py "$scenes" "$PWD/deploy/scenes/kitchen"
export FORELIGHT_BPY_PYTHON

if [ -z "${FORELIGHT_BIN:-}" ]; then
  cargo build --quiet --release --package forelight-cli
  FORELIGHT_BIN=$PWD/target/release/forelight
fi
write=()
[ "${1:-}" != --write ] || write=(--write docs/benchmarks.md)
"$FORELIGHT_BIN" bench renderers "$scenes"/{kitchen,corridor}.blend "${rifs[@]}" \
  "$scenes"/{pov-size,kitchen-samples,kitchen-size}.command.toml --frames 1 --width 96 --height 96 --threads 1 \
  --seeds "${SEEDS:-25}" "${write[@]}"
