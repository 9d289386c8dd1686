#!/usr/bin/env bash
# Blender Cycles (https://www.blender.org) behind the renderer's door: descriptions, previews, costs of shares of
# the samples, and merged images against one render, of bundles that become Blender files here.
#
#   FORELIGHT_SHARED   folder with test scenes (default: ../shared)
#
# Needs Python 3.11 with venv, and the network for pip. Where they are missing it is reported as not run; in CI
# it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

command -v python3 >/dev/null || skip 'no python3'
# The module bpy is compiled for one version of Python.
python3 -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || skip 'bpy 5.0 needs Python 3.11'
PIP_NO_CACHE_DIR=1 python_with blender bpy==5.0.1 'numpy>=1.26,<3'

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
test_scenes kitchen country-kitchen
"$environment/bin/python" "$here/blender_scenes.py" "$work" "${scenes[@]}" >"$work/log" 2>&1 || { cat "$work/log"; exit 1; }

# One at a time, because CPU time is measured.
FORELIGHT_BLENDS=$work FORELIGHT_BPY_PYTHON=$environment/bin/python nice cargo test --quiet \
  -p forelight-renderer-blender --test cycles -- --ignored --nocapture --test-threads 1
