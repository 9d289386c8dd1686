# What the scripts of this folder share; they source it after `set -euo pipefail`, in the repository's root.

export PYTHONDONTWRITEBYTECODE=1
here=$PWD/tests/peers
shared=${FORELIGHT_SHARED:-$PWD/../shared}

# Ends the script as one that has nothing to test here, with the reason.
skip() { echo "skipped: $1"; exit 0; }

# python_with NAME PACKAGE==VERSION [PACKAGE…]: a virtual environment that holds the packages, made if it is not there; sets
# `environment` to its folder.
python_with() {
  local name=$1 packages=("${@:2}")
  environment=$PWD/target/venv-$name
  local ready=$environment/ready-${packages[0]##*=}
  [ -e "$ready" ] && return
  command -v python3 >/dev/null || skip 'no python3'
  python3 -m venv "$environment" || skip 'python3 has no venv (Debian: python3-venv)'
  "$environment/bin/pip" install --quiet --disable-pip-version-check "${packages[@]}" ||
    skip "${packages[0]} cannot be installed (no network?)"
  touch "$ready"
}

# Sets FORELIGHT_BIN to a build of now, unless it is set.
need_forelight() {
  if [ -z "${FORELIGHT_BIN:-}" ]; then
    cargo build --quiet -p forelight-cli
    FORELIGHT_BIN=$PWD/target/debug/forelight
  fi
}

# test_scenes OWN SHARED…: sets `scenes` to one of the project's own scenes and those of the shared ones that are there.
test_scenes() {
  scenes=("$PWD/deploy/scenes/$1")
  local name
  for name in "${@:2}"; do
    if [ -d "$shared/scenes/$name" ]; then
      scenes+=("$shared/scenes/$name")
    else
      echo "note: no $name: there is no folder $shared/scenes"
    fi
  done
}
