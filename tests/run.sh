#!/usr/bin/env bash
# All tests: installs what they need, then checks format and lints, and runs unit and integration tests, tests
# against other programs, and the demo.
#
#   tests/run.sh          everything
#   tests/run.sh --quick  without the tests against other programs, and without the demo
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
# CI builds once. Incremental data would waste ten gigabytes, and line numbers in backtraces a minute.
[ -z "${CI:-}" ] || export CARGO_INCREMENTAL=0 CARGO_PROFILE_DEV_DEBUG=0
# Property tests run twice: with this seed, so that results are reproducible, and with a fresh one to find
# more.
export PROPTEST_RNG_SEED=2006

work=$(mktemp -d)
export FORELIGHT_NOT_RUN=$work/not-run
touch "$FORELIGHT_NOT_RUN"

step() { printf '\n== %s (%d s)\n' "$1" "$SECONDS"; }

# Lists the tests that were not run, whether the others passed or failed.
finish() {
  local status=$?
  if [ -s "$FORELIGHT_NOT_RUN" ]; then
    printf '\nNot run, or only in part: %d tests\n' "$(cut -f1 "$FORELIGHT_NOT_RUN" | sort -u | wc -l)"
    sort -u "$FORELIGHT_NOT_RUN" | sed 's/^/  /; s/\t/: /'
  fi
  rm -rf "$work"
  [ "$status" != 0 ] || step 'All passed'
}
trap finish EXIT

step 'Packages'
deploy/packages.sh mesa-vulkan-drivers libvulkan1 gcc libc6-dev python3-venv

step 'Format and lints'
cargo fmt --all --check
cargo clippy --workspace --all-targets --quiet -- -D warnings
RUSTDOCFLAGS='-D warnings' cargo doc --workspace --no-deps --quiet
services/store/prepare.sh --check

step 'Tests'
cargo build --workspace --quiet # the processes that tests start
cargo test --workspace --quiet --no-fail-fast

step 'Property tests with a fresh seed'
tests/properties.sh

if [ "${1:-}" != --quick ]; then
  FORELIGHT_BIN=$(realpath "${CARGO_TARGET_DIR:-target}")/debug/forelight
  export FORELIGHT_BIN
  for peer in tests/peers/*.sh; do
    step "$(basename "$peer" .sh)"
    "$peer"
  done
  step 'The main job'
  FORELIGHT_DATA=$work/data DEMO_FRAMES=0-11 DEMO_SIZE=96x54 deploy/demo.sh --once
fi
