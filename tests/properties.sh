#!/usr/bin/env bash
# Property tests (proptest) with one seed.
#
#   tests/properties.sh        a fresh seed; prints the command that repeats the run
#   tests/properties.sh SEED   this seed; an empty one is a fresh one
#
# Further arguments go to cargo.
#
# The seed of a failing case is added to a file `*proptest-regressions*` near the test's sources, and later
# runs try it first. Commit that file with the fix.
set -euo pipefail
cd "$(dirname "$0")/.."

# The names of all tests in `proptest!` blocks.
mapfile -t names < <(git grep -l 'proptest! {' -- '*.rs' | xargs awk '
  /^ *(proptest::)?proptest! \{$/ { match($0, /^ */); margin = RLENGTH; inside = 1 }
  inside && match($0, /^ *\}/) && RLENGTH == margin + 1 { inside = 0 }
  inside && $1 == "fn" { sub(/\(.*/, "", $2); print $2 }')
[ ${#names[@]} -gt 0 ] || { echo 'error: no property tests were found' >&2; exit 1; }

seed=${1:-$(od -An -N4 -tu4 /dev/urandom | tr -d ' ')}
echo "${#names[@]} property tests with seed $seed; to repeat: tests/properties.sh $seed"
kept() { git ls-files --modified --others --exclude-standard -- '*proptest-regressions*'; }
if ! PROPTEST_RNG_SEED=$seed cargo test --workspace --tests "${@:2}" --quiet --no-fail-fast -- "${names[@]}"; then
  printf 'error: property tests failed with seed %s\n' "$seed" >&2
  [ -z "$(kept)" ] || printf 'The cases are kept; commit these files with the fix:\n%s\n' "$(kept)" >&2
  exit 1
fi
