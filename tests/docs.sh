#!/usr/bin/env bash
# The documents of all crates in Rust, private items included: their links and their examples.
#
#   FORELIGHT_FEATURES   features to build with, as cargo takes them (default: none)
set -euo pipefail
cd "$(dirname "$0")/.."
read -ra features <<<"${FORELIGHT_FEATURES:-}"
FORELIGHT_DOCS=$(mktemp -d)
trap 'rm -rf "$FORELIGHT_DOCS"' EXIT
export FORELIGHT_DOCS
RUSTDOC=$PWD/tests/lints/rustdoc.sh cargo test --workspace --doc "${features[@]}" --quiet --no-fail-fast
