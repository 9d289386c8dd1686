#!/usr/bin/env bash
# Blender Cycles (https://www.blender.org) behind the renderer's door: descriptions, previews, costs of shares of
# the samples, and merged images against one render, of bundles that become Blender files here.
#
#   FORELIGHT_BPY_VERSION   version of Blender (default: 5.0.1). 4.2.23 and 4.5.15 pass too.
#
# Needs Python 3.11 with venv, and the network. Where they are missing it is reported as not run; in CI
# it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

blender_module

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$environment/bin/python" "$here/blender_scenes.py" "$work" deploy/scenes/kitchen >"$work/log" 2>&1 || { cat "$work/log"; exit 1; }

# What Cycles prepares, by what it says: names of objects and files say nothing.
PYTHONPATH=services/renderers/blender/src/driver "$environment/bin/python" - <<'PYTHON'
from forelight_render import SAMPLE, prepared
for text, name in [
    ("Loading render kernels (may take a few minutes the first time)", "kernels"),
    ("Synchronizing object | Image of a BVH kernel", "scene"),
    ("Synchronizing object | Sample 1/2 rock", "scene"),
    ("Updating Geometry BVH Cube 1/4 | Building BVH", "tree"),
    ("Updating Scene BVH | Building", "tree"),
    ("Updating Images | Loading kernel.png", "textures"),
    ("Scene, ViewLayer | Updating Shaders", "scene"),
    ("Sample 3/8", None),
    ("Finished", None),
]:
    assert prepared(text) == name, (text, prepared(text))
assert SAMPLE.search("Sample 3/8").groups() == ("3", "8")
PYTHON

# One at a time, because CPU time is measured.
export FORELIGHT_BLENDS=$work FORELIGHT_BPY_PYTHON=$environment/bin/python
workspace test --test cycles -- --ignored --nocapture --test-threads 1
