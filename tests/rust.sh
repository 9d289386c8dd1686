#!/usr/bin/env bash
# The tests in Rust: of all crates, and of the whole program. They start the debug build of the program.
#
#   FORELIGHT_FEATURES   features to build with, as cargo takes them (default: none)
set -euo pipefail
cd "$(dirname "$0")/.."
read -ra features <<<"${FORELIGHT_FEATURES:-}"

cargo test --workspace "${features[@]}" --quiet --no-fail-fast
cargo test -p forelight-dashboard --quiet # what a program without the page shows
echo 'Property tests with a fresh seed'
tests/properties.sh '' "${features[@]}"
