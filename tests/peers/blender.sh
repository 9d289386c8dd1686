#!/usr/bin/env bash
# Blender Cycles (https://www.blender.org) behind the renderer's door: descriptions, previews, costs of shares of
# the samples, and merged images against one render, of bundles that become Blender files here.
#
#   FORELIGHT_BPY_VERSION   version of Blender (default: 5.0.1). 4.2.23 and 4.5.15 pass too.
#
# Needs Python 3.11 with venv, and the network for pip. Where they are missing it is reported as not run; in CI
# it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

blender_module

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$environment/bin/python" "$here/blender_scenes.py" "$work" deploy/scenes/kitchen >"$work/log" 2>&1 || { cat "$work/log"; exit 1; }

# One at a time, because CPU time is measured.
export FORELIGHT_BLENDS=$work FORELIGHT_BPY_PYTHON=$environment/bin/python
workspace test --test cycles -- --ignored --nocapture --test-threads 1
