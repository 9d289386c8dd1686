#!/usr/bin/env bash
# The Python package of deploy/python: builds it from openapi.yaml, checks its types with mypy, and runs its
# example and python_client_peer.py against a farm.
#
# Needs Python 3.11 with venv, and the network. Where they are missing it is reported as not run; in CI it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash
need_forelight

python_with python-client mypy==1.19.0 types-python-dateutil
rm -rf deploy/python/src/forelight/rest
python_packages ./deploy/python
# mypy finds the package where it is installed.
(cd "$environment" && bin/mypy --strict --python-executable bin/python -p forelight \
  && bin/mypy --strict --python-executable bin/python "$OLDPWD/deploy/python/example.py" "$here/python_client_peer.py")

work=$(mktemp -d)
farm=
trap stop_farm EXIT
: >"$work/farm"
"$FORELIGHT_BIN" farm --data "$work/data" --workers 1 --preview cpu --listen 127.0.0.1:0 >"$work/farm" 2>&1 &
farm=$!
FORELIGHT_SERVER=$(farm_address "$work/farm" "$farm")
"$FORELIGHT_BIN" token --role submitter --name python --data "$work/data" --out "$work/token" >/dev/null
FORELIGHT_TOKEN=$(cat "$work/token")
export FORELIGHT_SERVER FORELIGHT_TOKEN

"$environment/bin/python" deploy/python/example.py deploy/scenes/kitchen 0-1 "$work/images"
"$environment/bin/python" "$here/python_client_peer.py" deploy/scenes/kitchen "$work/images"
