#!/usr/bin/env bash
# The main job on one machine: builds forelight, starts a farm of two workers, submits the kitchen shot,
# follows it to the end, and leaves the farm running.
#
#   deploy/demo.sh           set up, run the shot, leave the farm running
#   deploy/demo.sh --once    the same, but stop the farm at the end; exit code 0 if every frame was delivered
#
# FORELIGHT_BIN   a forelight binary to use instead of building one
# FORELIGHT_DATA  folder of the farm's data (default: farm-data)
# DEMO_SCENE, DEMO_FRAMES, DEMO_SIZE, DEMO_SPP   another shot (default: deploy/scenes/kitchen, 0-47, 160x90, 8)
set -euo pipefail
cd "$(dirname "$0")/.."

once=false
case "${1:-}" in
  '') ;;
  --once) once=true ;;
  -h | --help) sed -n '2,11s/^# \{0,1\}//p' "$0"; exit 0 ;;
  *) echo "error: unknown option $1 (options: --once, --help)" >&2; exit 2 ;;
esac

# A software Vulkan driver, so that previews use the GPU path everywhere. Without it they run on the CPU.
deploy/packages.sh mesa-vulkan-drivers libvulkan1 gcc libc6-dev
command -v cargo >/dev/null || PATH="$HOME/.cargo/bin:$PATH"
if [ -z "${FORELIGHT_BIN:-}" ]; then
  command -v cargo >/dev/null || { echo 'error: Rust is missing; install it from https://rustup.rs and run this again' >&2; exit 1; }
  # With the dashboard page, if it can be built.
  features=()
  if services/dashboard/build.sh; then
    features=(--features dashboard)
  else
    echo 'note: built without the dashboard page, which needs Node.js 18 and the network' >&2
  fi
  cargo build --profile demo --package forelight-cli "${features[@]}"
  FORELIGHT_BIN=$(realpath "${CARGO_TARGET_DIR:-target}")/demo/forelight
fi

data=${FORELIGHT_DATA:-farm-data}
scene=${DEMO_SCENE:-deploy/scenes/kitchen}
size=${DEMO_SIZE:-160x90}
mkdir -p "$data"
log=$data/farm.log

: >"$log" # read below, perhaps before the farm has opened it
# Its own session, so that the farm outlives this script.
setsid "$FORELIGHT_BIN" farm --data "$data" --workers 2 --threads 1 --price 0.40 \
  --listen "${FORELIGHT_LISTEN:-127.0.0.1:0}" >"$log" 2>&1 </dev/null &
farm=$!
stop() { kill -INT "$farm" 2>/dev/null && wait "$farm" 2>/dev/null || true; }
$once && trap stop EXIT

address=
for _ in $(seq 300); do
  address=$(sed -n 's/^listening on //p' "$log")
  [ -n "$address" ] && break
  kill -0 "$farm" 2>/dev/null || { echo "error: the farm did not start; its log:" >&2; tail -20 "$log" >&2; exit 1; }
  sleep 0.1
done
[ -n "$address" ] || { echo "error: the farm did not print its address; see its log $log" >&2; exit 1; }
echo "farm:   $address   (log: $log)"

"$FORELIGHT_BIN" submit "$scene" --server "$address" --data "$data" --name demo --frames "${DEMO_FRAMES:-0-47}" \
  --width "${size%x*}" --height "${size#*x}" --spp "${DEMO_SPP:-8}" --ambient-bounces 1 --ambient-divisions 16 \
  --deadline 30m --budget 5 --out "$data/demo"

if ! $once; then
  trap - EXIT
  cat <<EOF

The farm is still running (process $farm, stop it with: kill $farm).
  address     $address
  token       $data/tokens/operator.token
  dashboard   $FORELIGHT_BIN dashboard --server $address --data $data
  next job    $FORELIGHT_BIN submit deploy/scenes/corridor --server $address --data $data --deadline 1h --out corridor-images
EOF
fi
