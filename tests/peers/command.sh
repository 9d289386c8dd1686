#!/usr/bin/env bash
# Programs that can only be started, quoted from a few cheap renders: POV-Ray (http://www.povray.org) and the
# program of Mitsuba 3 (https://mitsuba-renderer.org). Prints quotes beside the cost of all frames.
#
# Needs the Debian package povray, Python with venv, and the network. Where they are missing it is reported as
# not run; in CI it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash
need_forelight

command -v povray >/dev/null || deploy/packages.sh povray || true
command -v povray >/dev/null || skip 'no povray (Debian: povray)'
python_with mitsuba mitsuba==3.9.1 'numpy>=2,<3' 'OpenEXR>=3.3,<4'

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$environment/bin/python" "$here/command_scenes.py" "$work" "$PWD/deploy/scenes/kitchen"

# Quotes by smaller images, regions and fewer samples. Times are printed and not judged: beside other work, a
# CPU second does less.
for quoted in pov-size pov-crop kitchen-samples; do
  "$FORELIGHT_BIN" bench renderers "$work/$quoted.command.toml" --frames 1,5,9,13,17,21 --seeds 1 --threads 1
done

# A file that a scene misses is named, and nothing is left behind.
sed 's/hall.pov/missing.pov/' "$work/pov-size.command.toml" >"$work/missing.command.toml"
if "$FORELIGHT_BIN" render "$work/missing.command.toml" --frame 1 --out "$work/missing.png" 2>"$work/said"; then
  echo 'error: a scene without one of its files was rendered' >&2
  exit 1
fi
grep 'nowhere.inc' "$work/said"
[ ! -e "$work/missing.png" ]
