#!/usr/bin/env bash
# Builds the dashboard page into services/dashboard/dist, which `cargo build --features dashboard` embeds.
# Needs Node.js 18 or newer with npm, and the network for its packages. On Debian it installs Node.js.
set -euo pipefail
cd "$(dirname "$0")"
command -v npm >/dev/null || ../../deploy/packages.sh nodejs npm
# Packages are installed again when the lock file has changed.
installed=node_modules/.package-lock.json
if [ ! "$installed" -nt package-lock.json ]; then
  npm ci --no-audit --no-fund --silent
  touch "$installed"
fi
npm run build --silent
