# Shared by the scripts of this folder, which source it after `set -euo pipefail` in the repository's root.

# The installer leaves it to Python to compile packages, and Python keeps what it has compiled.
unset PYTHONDONTWRITEBYTECODE
here=$PWD/tests/peers
shared=${FORELIGHT_SHARED:-$PWD/../shared}

# missing REASON: reports that this test, or a part of it, was not run. With CI or FORELIGHT_REQUIRE_SHARED=1
# set, this is a failure. Otherwise the line goes to the file FORELIGHT_NOT_RUN, which tests/run.sh lists at
# its end. tests/needs does the same for Rust tests.
missing() {
  if [ -n "${CI:-}" ] || [ "${FORELIGHT_REQUIRE_SHARED:-0}" != 0 ]; then
    echo "error: $1; with CI or FORELIGHT_REQUIRE_SHARED set, every test must run" >&2
    exit 1
  fi
  echo "not run: $1"
  [ -z "${FORELIGHT_NOT_RUN:-}" ] || printf '%s\t%s\n' "$(basename "$0")" "$1" >>"$FORELIGHT_NOT_RUN"
}

# skip REASON: the same, and ends the script.
skip() { missing "$1"; exit 0; }

# installer ARGUMENT…: runs uv, which installs Python packages for a tenth of pip's CPU time, and stores what
# several environments need once. The first call installs it.
installer() {
  local home=$PWD/target/venv-uv version=0.13.9
  exec 9<"$here/support.bash"
  flock 9 # another test may be at it
  if [ ! -e "$home/ready-$version" ]; then
    python3 -m venv "$home" || skip 'python3 has no venv (Debian: python3-venv)'
    "$home/bin/pip" install --quiet --disable-pip-version-check "uv==$version" ||
      skip 'uv cannot be installed (no network?)'
    touch "$home/ready-$version"
  fi
  exec 9<&-
  export UV_CACHE_DIR=$PWD/target/uv-cache UV_SYSTEM_CERTS=1
  # Where pip is told to look, if it is.
  [ -z "${PIP_INDEX_URL:-}" ] || export UV_DEFAULT_INDEX=$PIP_INDEX_URL
  [ -z "${PIP_FIND_LINKS:-}" ] || export UV_FIND_LINKS=$PIP_FIND_LINKS
  # A package that is compiled in Rust here has lints of its own.
  env -u RUSTC_WORKSPACE_WRAPPER "$home/bin/uv" --quiet "$@"
}

# python_with NAME PACKAGE==VERSION [PACKAGE…]: creates a virtual environment with the packages unless it
# exists, and sets `environment` to its folder.
python_with() {
  local name=$1 packages=("${@:2}")
  environment=$PWD/target/venv-$name
  local ready=$environment/ready-${packages[0]##*=}
  command -v python3 >/dev/null || skip 'no python3'
  mkdir -p target
  exec 8>"$environment.lock"
  flock 8 # another test may be making it
  if [ ! -e "$ready" ]; then
    installer venv --clear --python "$(command -v python3)" "$environment"
    python_packages "${packages[@]}"
    touch "$ready"
  fi
  exec 8>&-
}

# python_packages PACKAGE…: adds packages to `environment`.
python_packages() {
  installer pip install --python "$environment/bin/python" "$@" || skip "$1 cannot be installed (no network?)"
}

# Sets `environment` to one with Blender as a Python module, of version FORELIGHT_BPY_VERSION.
blender_module() {
  local version=${FORELIGHT_BPY_VERSION:-5.0.1}
  command -v python3 >/dev/null || skip 'no python3'
  # The module bpy is compiled for one version of Python.
  python3 -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || skip 'bpy needs Python 3.11'
  # Libraries that the module bpy is linked to.
  deploy/packages.sh libgl1 libice6 libsm6 libx11-6 libxext6 libxfixes3 libxi6 libxkbcommon0 libxrender1 ||
    skip 'the libraries of Blender cannot be installed (no network?)'
  python_with "blender${FORELIGHT_BPY_VERSION:+-$version}" "bpy==$version" 'numpy>=1.26,<3' 'OpenEXR>=3.3,<4'
}

# Sets `environment` to one with Radiance, and FORELIGHT_RADIANCE to the folder of its programs.
radiance_programs() {
  python_with radiance pyradiance==1.3.1 'numpy>=2,<3' 'pillow>=11' 'OpenEXR>=3.3,<4'
  FORELIGHT_RADIANCE=$("$environment/bin/python" -c 'import pathlib, pyradiance; print(pathlib.Path(pyradiance.__file__).parent / "bin")')
  export FORELIGHT_RADIANCE
}

# workspace VERB…: cargo, for the whole workspace and with the features of tests/run.sh. For single packages,
# cargo would build their dependencies again, with fewer features.
workspace() {
  local features
  read -ra features <<<"${FORELIGHT_FEATURES:-}"
  cargo "$1" --quiet --workspace "${features[@]}" "${@:2}"
}

# Sets FORELIGHT_BIN to a fresh build, unless it is set.
need_forelight() {
  if [ -z "${FORELIGHT_BIN:-}" ]; then
    workspace build --bin forelight
    FORELIGHT_BIN=$PWD/target/debug/forelight
  fi
}

# At the end of a test: stops `$farm`, which logs to $work/farm, and removes $work. If the test failed, shows the
# end of the log.
stop_farm() {
  local status=$?
  [ -z "$farm" ] || { kill -INT "$farm" && wait "$farm"; } 2>/dev/null || true
  [ "$status" = 0 ] || tail -n 30 "$work/farm" 2>/dev/null || true
  rm -rf "$work"
}

# test_scenes OWN SHARED…: sets `scenes` to one of the project's own scenes and the shared ones. Reports
# missing shared scenes.
test_scenes() {
  scenes=("$PWD/deploy/scenes/$1")
  shared_scenes "${@:2}"
}

# shared_scenes NAME…: adds shared scenes to `scenes`.
shared_scenes() {
  local name
  for name in "$@"; do
    if [ -d "$shared/scenes/$name" ]; then
      scenes+=("$shared/scenes/$name")
    else
      missing "no scenes/$name in $shared (set FORELIGHT_SHARED)"
    fi
  done
}

# same_bits OURS THEIRS: fails unless all channels of two EXR files, except measured time, have the same bits.
# Needs numpy and OpenEXR in the environment.
same_bits() {
  "$environment/bin/python" - "$@" <<'PYTHON'
import sys
import OpenEXR

def bits(path):
    with OpenEXR.File(path, separate_channels=True) as file:
        return {name: channel.pixels.tobytes() for name, channel in file.channels().items() if name != "cost.cpu_nanos"}

ours, theirs = map(bits, sys.argv[1:])
wrong = sorted(name for name in ours.keys() | theirs.keys() if ours.get(name) != theirs.get(name))
if wrong or not {"R", "G", "B", "cost.work"} <= ours.keys():
    sys.exit(f"{sys.argv[2]} differs from what forelight renders: {wrong or sorted(ours)}")
PYTHON
}

# allowed_sandbox: sets `sandbox` to the flag that runs renderers in a sandbox. Empty where the system lets
# nobody make one, as in many containers.
allowed_sandbox() {
  deploy/packages.sh bubblewrap || true
  sandbox=()
  if unshare --user --pid --fork true 2>/dev/null; then sandbox=(--sandbox); fi
}

# free_port: prints an unused port.
free_port() { "$environment/bin/python" -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])'; }

# wait_for SECONDS COMMAND…: repeats the command until it succeeds. After that time it calls `fail`, which the
# script defines.
wait_for() {
  local tries=$(($1 * 10))
  shift
  while ! "$@" 2>/dev/null; do
    tries=$((tries - 1))
    [ $tries -gt 0 ] || fail "timed out: $*"
    sleep 0.1
  done
}

# farm_address FILE PROCESS: prints the address that a farm prints into the file. Fails with the content of the
# file if the process ends before, or prints none within a minute.
farm_address() {
  local address
  for _ in $(seq 600); do
    address=$(sed -n 's/^listening on //p' "$1")
    [ -n "$address" ] && { echo "$address"; return; }
    kill -0 "$2" 2>/dev/null || break
    sleep 0.1
  done
  cat "$1" >&2
  echo 'failed: the farm did not start' >&2
  return 1
}

# ask QUERY: prints one value from the database of the farm in $work/data. `is` and `at_least` compare it.
ask() {
  "$environment/bin/python" - "$work/data/forelight.sqlite" "$1" <<'PYTHON'
import sqlite3, sys
row = sqlite3.connect(f"file:{sys.argv[1]}?mode=ro", uri=True, timeout=10).execute(sys.argv[2]).fetchone()
print("" if row is None or row[0] is None else row[0])
PYTHON
}
is() { [ "$(ask "$1")" = "$2" ]; }
at_least() { [ "$(ask "$1")" -ge "$2" ]; }

# picture_of_several_colours FILE.png: whether a picture shows something. Needs NumPy in the environment.
picture_of_several_colours() {
  deploy/packages.sh ffmpeg || skip 'no ffmpeg (Debian: ffmpeg)'
  ffmpeg -v error -i "$1" -f rawvideo -pix_fmt rgb24 - | "$environment/bin/python" -c '
import sys
import numpy
pixels = numpy.frombuffer(sys.stdin.buffer.read(), numpy.uint8).reshape(-1, 3)
sys.exit(len(numpy.unique(pixels, axis=0)) < 20)'
}
