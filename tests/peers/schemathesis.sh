#!/usr/bin/env bash
# Runs Schemathesis (https://schemathesis.readthedocs.io) against a farm and its OpenAPI document: valid and
# invalid requests are generated from the document, and every response is checked against it: valid ones are
# accepted, invalid ones refused. The farm has a finished job, a cancelled one with a lease, one that waits to be
# accepted, a webhook and a budget, so that deep routes are reached.
#
#   FORELIGHT_BIN                     the program (default: target/debug/forelight, which is built)
#   FORELIGHT_SCHEMATHESIS_EXAMPLES   requests per operation in the random part (default: 15; 200 takes a while)
#   FORELIGHT_SCHEMATHESIS_SEED       seed of the random part (default: 1)
#
# Further arguments go to schemathesis. Needs Python with venv, and network access. Without them it is
# reported as not run, and in CI it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

# Pinned, because new versions bring new checks.
python_with schemathesis schemathesis==4.32.5

need_forelight
scene=$PWD/deploy/scenes/corridor

work=$(mktemp -d)
farm=
cleanup() {
  if [ -n "$farm" ]; then
    kill -9 "$farm" 2>/dev/null || true
    wait "$farm" 2>/dev/null || true
  fi
  rm -rf "$work"
}
trap cleanup EXIT

: >"$work/printed" # read below, perhaps before the farm has opened it
"$FORELIGHT_BIN" farm --data "$work/data" --listen 127.0.0.1:0 --workers 1 --threads 1 --preview cpu \
  >"$work/printed" 2>&1 &
farm=$!
url=$(farm_address "$work/printed" "$farm")

# A finished job to query. No request may leave this machine.
export NO_PROXY=127.0.0.1 no_proxy=127.0.0.1
"$FORELIGHT_BIN" submit "$scene" --server "$url" --data "$work/data" \
  --frames 0-1 --width 16 --spp 1 --samples 16 --deadline 1h --follow --json >"$work/job.json"
token=$(cat "$work/data/tokens/operator.token")
"$environment/bin/python" "$here/schemathesis_things.py" "$url" "$token" "$work/job.json" >"$work/things.json"
"$environment/bin/python" "$here/schemathesis_config.py" "$work/things.json" >"$work/schemathesis.toml"
bundle=$("$environment/bin/python" -c 'import json, sys; print(json.load(sys.stdin)["job"]["bundle"]["id"])' <"$work/job.json")

export SCHEMATHESIS_HOOKS=schemathesis_hooks PYTHONPATH=$here FORELIGHT_EXAMPLE_SCENE=$scene FORELIGHT_EXAMPLE_BUNDLE=$bundle
FORELIGHT_THINGS=$(cat "$work/things.json")
export FORELIGHT_THINGS
cd "$work"
"$environment/bin/schemathesis" --config-file "$work/schemathesis.toml" run "$url/openapi.yaml" \
  --header "Authorization: Bearer $token" \
  --max-examples "${FORELIGHT_SCHEMATHESIS_EXAMPLES:-15}" --seed "${FORELIGHT_SCHEMATHESIS_SEED:-1}" \
  --continue-on-failure --warnings off --no-color "$@"
