#!/usr/bin/env bash
# Installs Debian packages that are missing: deploy/packages.sh NAME…
# Needs root or sudo. Without them it prints what to install and continues.
set -euo pipefail

missing=()
for package in "$@"; do
  dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
done
[ ${#missing[@]} -eq 0 ] && exit 0

if ! command -v apt-get >/dev/null; then
  echo "note: not a Debian system; please install the equivalent of: ${missing[*]}" >&2
  exit 0
fi
if [ "$(id -u)" -eq 0 ]; then
  root=()
elif command -v sudo >/dev/null; then
  root=(sudo)
else
  echo "note: not root and no sudo; please install: ${missing[*]}" >&2
  exit 0
fi
# Two scripts may want packages at the same time.
exec 9<"$0"
flock 9
echo "installing ${missing[*]}"
export DEBIAN_FRONTEND=noninteractive
"${root[@]}" apt-get update -qq
"${root[@]}" apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
