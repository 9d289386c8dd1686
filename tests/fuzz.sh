#!/usr/bin/env bash
# Runs every fuzz target for some minutes, one after the other, and prints a table: executions, coverage, findings.
#
#   tests/fuzz.sh 10               all targets, ten minutes each
#   tests/fuzz.sh 1 routes kept    these targets, one minute each
#
# Findings stay in tests/fuzz/artifacts. Needs nightly Rust and cargo-fuzz; see tests/fuzz/Cargo.toml.
set -euo pipefail
cd "$(dirname "$0")"
minutes=${1:-1}
shift || true
targets=("$@")
[ ${#targets[@]} -gt 0 ] || mapfile -t targets < <(cargo +nightly fuzz list)

FORELIGHT_SEEDS=$PWD/fuzz/corpus FORELIGHT_MUTATIONS=0 cargo test --quiet -p forelight-tests --test fuzzed good_input >/dev/null
cargo +nightly fuzz build -s none >/dev/null

table=$(printf '%-14s %12s %10s %9s %s' target executions coverage findings seconds)
failed=0
for target in "${targets[@]}"; do
  log=$(mktemp) start=$SECONDS before=$(ls "fuzz/artifacts/$target" 2>/dev/null | wc -l)
  cargo +nightly fuzz run -s none "$target" -- -max_total_time=$((minutes * 60)) -rss_limit_mb=3000 -timeout=60 \
    -print_final_stats=1 >"$log" 2>&1 || true
  executions=$(sed -n 's/^stat::number_of_executed_units: *//p' "$log" | tail -1)
  coverage=$(grep -o 'cov: [0-9]*' "$log" | tail -1 | cut -d' ' -f2 || true)
  found=$(($(ls "fuzz/artifacts/$target" 2>/dev/null | wc -l) - before))
  table+=$'\n'$(printf '%-14s %12s %10s %9s %s' "$target" "${executions:--}" "${coverage:--}" "$found" $((SECONDS - start)))
  if [ "$found" != 0 ] || [ -z "$executions" ]; then
    failed=1
    tail -40 "$log"
  fi
  rm -f "$log"
done
printf '%s\n' "$table"
exit $failed
