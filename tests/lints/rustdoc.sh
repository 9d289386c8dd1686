#!/usr/bin/env bash
# Stands in for rustdoc in `cargo test --doc`: runs the examples, and then makes the documents, whose warnings, such as
# broken links, are errors. So they are made from what the tests are built with; `cargo doc` would read all
# dependencies once more.
set -euo pipefail
rustdoc "$@"
document=()
for argument in "$@"; do
  if [ "$argument" = --test ]; then
    document=(--output "$(mktemp --directory --tmpdir="${work:?the folder for temporary files}")")
  fi
done
[ ${#document[@]} -gt 0 ] || exit 0 # cargo asks for the version
while (($#)); do
  case $1 in
    --test) ;;
    --test-args | --test-run-directory) shift ;;
    *) document+=("$1") ;;
  esac
  shift
done
exec rustdoc "${document[@]}" -D warnings
