#!/usr/bin/env bash
# Signs people in through a real OpenID Connect provider (the npm package oidc-provider): groups and roles, stolen
# and repeated answers, and what ends with a person's token.
#
#   FORELIGHT_BIN   the program (default: it is built)
#
# Needs Node.js 18 or newer, and npm with network access. Without them it is reported as not run, and in CI it
# fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

command -v npm >/dev/null || deploy/packages.sh nodejs npm || skip 'npm cannot be installed (no network?)'
command -v npm >/dev/null || skip 'no npm'
if [ ! tests/peers/oidc/node_modules/.package-lock.json -nt tests/peers/oidc/package-lock.json ]; then
  npm ci --prefix tests/peers/oidc --no-audit --no-fund --silent ||
    skip 'packages of tests/peers/oidc cannot be installed (no network?)'
  touch tests/peers/oidc/node_modules/.package-lock.json
fi
need_forelight
export FORELIGHT_BIN
# No request may leave this machine.
export NO_PROXY=127.0.0.1 no_proxy=127.0.0.1
node --test --test-reporter=spec tests/peers/oidc/sign_in.test.mjs
