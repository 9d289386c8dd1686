#!/usr/bin/env bash
# Measures the service and the dashboard page together on a farm of 5,000 nodes, 2,000 open jobs, one of them
# of 10,000 frames: heartbeats of all workers, alone and beside 200 open pages, and, while the workers go on,
# new plans and the page in Chromium. Prints times and sizes, and asserts nothing: the sizes of documents are
# asserted by `cargo test -p forelight-api --test farm_size`, which also fills this farm's database.
#
#   tests/farm_size.sh          prints the figures
#   tests/farm_size.sh --write  also writes them into docs/benchmarks.md
#
#   FORELIGHT_DASHBOARD_BIN   the program, built with `--features dashboard` (default: it is built, for release)
#   FORELIGHT_FARM_SIZE       a folder to keep the farm in; one that is there is used again
#   SECONDS_EACH              length of each measurement of heartbeats (default: 30)
#
# Needs what tests/peers/dashboard.sh needs. Measure on a quiet machine.
set -euo pipefail
cd "$(dirname "$0")/.."

services/dashboard/build.sh
npm ci --prefix tests/peers/dashboard --no-audit --no-fund --silent
CHROMIUM=$(command -v chromium || command -v chromium-browser || command -v google-chrome)
export CHROMIUM NO_PROXY=127.0.0.1 no_proxy=127.0.0.1
if [ -z "${FORELIGHT_DASHBOARD_BIN:-}" ]; then
  cargo build --quiet --release -p forelight-cli --features dashboard
  FORELIGHT_DASHBOARD_BIN=$PWD/target/release/forelight
fi
export FORELIGHT_DASHBOARD_BIN
each=${SECONDS_EACH:-30}

work=$(mktemp -d)
bench=
finish() {
  [ -z "$bench" ] || kill "$bench" 2>/dev/null || true
  rm -rf "$work"
}
trap finish EXIT

kept=${FORELIGHT_FARM_SIZE:-$work/kept}
[ -e "$kept" ] || FORELIGHT_FARM_SIZE=$kept cargo test --quiet -p forelight-api --test farm_size >/dev/null
# Each measurement has a fresh copy.
farm() { rm -rf "$work/farm" "$work/farm.out" && cp -r "$kept" "$work/farm"; }

measure() {
  printf 'load of the machine: %s\n' "$(cut -d' ' -f1-3 /proc/loadavg)"
  printf '\n== Heartbeats alone\n'
  farm
  "$FORELIGHT_DASHBOARD_BIN" bench workers --data "$work/farm" --time "${each}s"
  printf '\n== Heartbeats beside 200 open pages\n'
  for _ in 1 2 3; do
    farm
    "$FORELIGHT_DASHBOARD_BIN" bench workers --data "$work/farm" --time "${each}s" --pages 200 | sed 1d
  done
  printf '\n== New plans and the page in Chromium, beside the workers\n'
  farm
  "$FORELIGHT_DASHBOARD_BIN" bench workers --data "$work/farm" --time 600s >"$work/bench" 2>&1 &
  bench=$!
  for _ in $(seq 600); do
    grep -q 'listening on' "$work/farm.out" 2>/dev/null && break
    sleep 0.1
  done
  address=$(sed -n 's/^listening on //p' "$work/farm.out" | head -1)
  node tests/peers/dashboard/plans.mjs "$address" "$work/farm"
  node tests/peers/dashboard/size.mjs "$address" "$work/farm"
  kill "$bench"
  printf '\nload of the machine: %s\n' "$(cut -d' ' -f1-3 /proc/loadavg)"
}

# The block of docs/benchmarks.md.
block() {
  processor=$(sed -n 's/^model name.*: //p' /proc/cpuinfo | head -1)
  printf '```sh\ntests/farm_size.sh --write\n```\n\n| date | commit | processor | cores |\n| --- | --- | --- | ---: |\n'
  printf '| %s | %s | %s | %s |\n\n' "$(date -u '+%Y-%m-%d %H:%M UTC')" "$(git rev-parse --short HEAD)" "$processor" "$(nproc)"
  printf '```text\n%s\n```\n' "$(cat "$work/report")"
}

measure | tee "$work/report"
if [ "${1:-}" = --write ]; then
  block >"$work/block"
  begin='<!-- bench farm_size -->'
  sed -i -e "/^$begin\$/,/^<!-- end -->\$/{/^$begin\$/{p;r $work/block" -e "};/^<!-- end -->\$/!d}" docs/benchmarks.md
fi
