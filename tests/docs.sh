#!/usr/bin/env bash
# The docs of all crates in Rust: their links and their examples.
#
#   FORELIGHT_FEATURES   features to build with, as cargo takes them (default: none)
set -euo pipefail
cd "$(dirname "$0")/.."
read -ra features <<<"${FORELIGHT_FEATURES:-}"
RUSTDOC=$PWD/tests/lints/rustdoc.sh cargo test --workspace --doc "${features[@]}" --quiet
