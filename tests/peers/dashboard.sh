#!/usr/bin/env bash
# Tests the dashboard page in Chromium against a farm: signing in, a quote before booking, a job to its end,
# retries, a rescue; orders to frames, jobs and nodes, and changes of settings; every screen with an empty
# farm, a working one, and after the service was killed or the network was away; rules of accessibility (axe)
# in light and dark, of every screen and question; and what the first view loads.
#
#   FORELIGHT_DASHBOARD_BIN   the program, built with `--features dashboard` (default: page and program are built)
#
# Screenshots are written to target/dashboard-screenshots. Needs Node.js 18 or newer, npm with network access,
# and Chromium. Without them it is reported as not run, and in CI it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

packages=(chromium ffmpeg fonts-dejavu-core)
command -v npm >/dev/null || packages+=(nodejs npm)
deploy/packages.sh "${packages[@]}" || skip 'Chromium cannot be installed (no network?)'
command -v npm >/dev/null || skip 'no npm'
CHROMIUM=$(command -v chromium || command -v chromium-browser || command -v google-chrome) || skip 'no Chromium'
export CHROMIUM

# install FOLDER: its packages, as the lock file names them, unless they are there already.
install() {
  local stamp=$1/node_modules/.package-lock.json
  [ "$stamp" -nt "$1/package-lock.json" ] && return
  npm ci --prefix "$1" --no-audit --no-fund --silent || skip "packages of $1 cannot be installed (no network?)"
  touch "$stamp"
}
install services/dashboard
install tests/peers/dashboard

# Another test may run the given program. With a new page, the next `cargo` would replace it.
if [ -z "${FORELIGHT_DASHBOARD_BIN:-}" ]; then
  services/dashboard/build.sh
  cargo build --quiet -p forelight-cli --features dashboard
  FORELIGHT_DASHBOARD_BIN=$PWD/target/debug/forelight
fi
export FORELIGHT_DASHBOARD_BIN
# No request may leave this machine.
export NO_PROXY=127.0.0.1 no_proxy=127.0.0.1
rm -rf target/dashboard-screenshots
mkdir -p target/dashboard-screenshots

# While the tests run: types of the API are those of openapi.yaml, and the page is checked and formatted.
{
  cd services/dashboard
  npx openapi-typescript ../../openapi.yaml --output ../../target/dashboard-schema.d.ts >/dev/null 2>&1
  cmp --silent ../../target/dashboard-schema.d.ts src/api/schema.d.ts || {
    echo 'failed: services/dashboard/src/api/schema.d.ts is not what openapi.yaml says; run `npm run types` there'
    exit 1
  }
  npm run check --silent
} &
checks=$!
# The files run at the same time: most of it is waiting for farms.
node --test --test-concurrency=3 --test-reporter=spec tests/peers/dashboard/*.test.mjs || status=$?
wait "$checks" || status=$?
exit "${status:-0}"
