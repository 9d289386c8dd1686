#!/bin/sh
# Stands in for rustc in builds of the tests: Clippy compiles each crate, and its warnings are errors. So a crate is
# read once, where `cargo clippy` beside `cargo build` would read it and all of its dependencies twice.
exec clippy-driver "$@" -D warnings
