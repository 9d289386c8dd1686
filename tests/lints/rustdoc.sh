#!/usr/bin/env bash
# Stands in for rustdoc in `cargo test --doc`: runs the examples and makes the documents, whose warnings, such
# as broken links, are errors. So they are made from what the tests are built with, where `cargo doc` would
# read all dependencies once more. tests/docs.sh names the folder of the documents.
set -euo pipefail
status=0
rustdoc "$@" || status=$?
document=() is_test=false crate=
while (($#)); do
  case $1 in
    --test) is_test=true ;;
    --test-args | --test-run-directory) shift ;;
    --crate-name) crate=$2 document+=("$1") ;;
    --extern) # Examples use the crate itself; its documents are made from its source.
      if [[ ${2:-} == "$crate="* ]]; then shift; else document+=("$1"); fi ;;
    *) document+=("$1") ;;
  esac
  shift
done
if $is_test; then
  rustdoc "${document[@]}" -D warnings --document-private-items --output "$FORELIGHT_DOCS" || status=$?
fi
exit "$status"
