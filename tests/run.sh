#!/usr/bin/env bash
# All tests: installs what they need, then checks format and lints, and runs unit and integration tests, tests
# against other programs, and the demo.
#
#   tests/run.sh          everything
#   tests/run.sh --quick  without the tests of the whole (reference images, hard cases, kills of processes), of
#                         other programs, and of the demo
#
#   FORELIGHT_SHARED            folder with test scenes and reference images (default: ../shared)
#   CI                          if set, a test that lacks its data, a GPU or a program fails; otherwise such
#                               tests are listed at the end as not run, with the reason
#   FORELIGHT_REQUIRE_SHARED=1  the same as CI
set -euo pipefail
shopt -s nullglob
cd "$(dirname "$0")/.."
command -v cargo >/dev/null || PATH="$HOME/.cargo/bin:$PATH"
export CARGO_TERM_COLOR=never
# CI builds once. Incremental data would waste ten gigabytes, and line numbers in backtraces a minute. Fewer
# units of code take less time in all.
[ -z "${CI:-}" ] || export CARGO_INCREMENTAL=0 CARGO_PROFILE_DEV_DEBUG=0 CARGO_PROFILE_DEV_CODEGEN_UNITS=8
# Property tests run twice: with this seed, so that results are reproducible, and with a fresh one to find
# more.
export PROPTEST_RNG_SEED=2006

work=$(mktemp -d)
export FORELIGHT_NOT_RUN=$work/not-run
touch "$FORELIGHT_NOT_RUN"

step() { printf '\n== %s (%d s)\n' "$1" "$SECONDS"; }

# run_logged SCRIPT: runs a script of tests. Says when it begins, and prints its output and its times at the end. In
# CI, a script that hangs is ended, so that its output is seen.
run_logged() {
  local name status=0 start=$SECONDS log limit=()
  [ -z "${CI:-}" ] || limit=(timeout --kill-after 10 2700)
  name=$(basename "$1" .sh) log=$work/$name.log
  printf '.. %s\n' "$name"
  TIMEFORMAT='%0U + %0S'
  { time "${limit[@]}" "$1" >"$log" 2>&1; } 2>"$log.cpu" || status=$?
  flock "$work" bash -c 'printf "\n-- %s (%d s, %s s of CPU time%s)\n" "$1" "$2" "$3" "$4"; cat "$5"' - "$name" \
    $((SECONDS - start)) "$(cat "$log.cpu")" "$([ $status = 0 ] || echo ', FAILED')" "$log"
  [ $status = 0 ] || mv "$log" "$work/$name.failed"
  return $status
}
export -f run_logged
export work
# Programs under test keep nothing for later runs.
export XDG_CACHE_HOME=$work/cache

# Shows what failed once more, where a reader looks first, and lists the tests that were not run.
finish() {
  local status=$? log
  for log in "$work"/*.failed; do
    printf '\n-- What failed in %s\n' "$(basename "$log" .failed)"
    # Of the tests in Rust, only what those say that failed, without their stacks.
    if grep -q '^test result: FAILED' "$log"; then
      sed -n '/^failures:$/,/^test result: FAILED/{/^ *[0-9]*: \|^ *at /!p}' "$log"
    else
      cat "$log"
    fi | tail -n 120
  done
  if [ -s "$FORELIGHT_NOT_RUN" ]; then
    printf '\nNot run, or only in part: %d tests\n' "$(cut -f1 "$FORELIGHT_NOT_RUN" | sort -u | wc -l)"
    sort -u "$FORELIGHT_NOT_RUN" | sed 's/^/  /; s/\t/: /'
  fi
  rm -rf "$work"
  [ "$status" != 0 ] || step 'All passed'
}
trap finish EXIT

step 'Packages'
deploy/packages.sh mesa-vulkan-drivers libvulkan1 gcc libc6-dev python3-venv bubblewrap ffmpeg

step 'The dashboard page'
# Tests start a program with the page. Without Node.js only the page's own test is not run.
features=()
if services/dashboard/build.sh; then
  features=(--features forelight-cli/dashboard)
elif [ -n "${CI:-}" ]; then
  exit 1
fi

step 'Format'
cargo fmt --all --check

step 'Build and lints'
export RUSTC_WORKSPACE_WRAPPER=$PWD/tests/lints/rustc.sh
# The processes that tests start.
services/store/prepare.sh --check cargo build --workspace "${features[@]}" --quiet
cargo test --workspace "${features[@]}" --quiet --no-run

FORELIGHT_BIN=$(realpath "${CARGO_TARGET_DIR:-target}")/debug/forelight
export FORELIGHT_BIN FORELIGHT_FEATURES="${features[*]}"
[ ${#features[@]} -eq 0 ] || export FORELIGHT_DASHBOARD_BIN=$FORELIGHT_BIN
peers=()
# The longest first.
if [ "${1:-}" = --quick ]; then
  export FORELIGHT_QUICK=1
else
  peers=(tests/peers/{slurm,dashboard,blender_farm,mitsuba,schemathesis,command,gltf}.sh tests/peers/*.sh)
fi
step 'Tests, two programs at a time'
# Where one fails, the others still run.
printf '%s\n' tests/rust.sh "${peers[@]}" tests/docs.sh | awk '!seen[$0]++' | xargs -P 2 -I{} bash -c 'run_logged {}'

if [ "${1:-}" != --quick ]; then
  step 'The main job'
  FORELIGHT_DATA=$work/data DEMO_FRAMES=0-11 DEMO_SIZE=96x54 deploy/demo.sh --once
fi
