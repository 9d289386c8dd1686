#!/usr/bin/env bash
# The tests in Rust: of all crates, and of the whole program. They start the debug build of the program.
# tests/docs.sh runs the examples of documents.
#
#   FORELIGHT_FEATURES   features to build with, as cargo takes them (default: none)
#   FORELIGHT_QUICK      if set, the tests of the crates alone, with the fixed seed alone
set -euo pipefail
cd "$(dirname "$0")/.."
read -ra features <<<"${FORELIGHT_FEATURES:-}"

only=()
[ -z "${FORELIGHT_QUICK:-}" ] || only=(--exclude forelight-tests --exclude forelight-program-tests)
cargo test --workspace --tests "${only[@]}" "${features[@]}" --quiet --no-fail-fast
cargo test -p forelight-dashboard --quiet # what a program without the page shows
[ -z "${FORELIGHT_QUICK:-}" ] || exit 0
echo 'Property tests with a fresh seed'
tests/properties.sh '' "${features[@]}"
