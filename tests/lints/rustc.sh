#!/bin/sh
# Stands in for rustc in builds of the tests: Clippy compiles each crate, and its warnings are errors. So a
# crate is read once, where `cargo clippy` beside `cargo build` would read it and all dependencies twice.
#
# Clippy compiles as rustc does, but without the checks of null and misaligned pointers of debug builds.
# New lints belong in Cargo.toml: cargo does not see a change of this file.
exec clippy-driver "$@" -D warnings
