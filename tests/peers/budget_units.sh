#!/usr/bin/env bash
# Tests the systemd units and the crontab line of deploy/. systemd verifies the units. Their command lines run
# twice each against a live service. Without a threatened budget, the exit code is 0 and standard error is
# empty. Otherwise the exit code is 3 and standard error has one line, which cron mails.
#
#   FORELIGHT_BIN   the program (default: target/debug/forelight, which is built)
#
# Without systemd-analyze (Debian: systemd) the units are not verified. That part is then reported as not run,
# and in CI it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash
need_forelight

work=$(mktemp -d)
farm=
trap stop_farm EXIT
fail() { echo "failed: $*"; exit 1; }

command -v systemd-analyze >/dev/null || deploy/packages.sh systemd || true
if command -v systemd-analyze >/dev/null; then
  echo 'systemd verifies the units'
  mkdir "$work/units"
  for unit in service timer; do
    sed "s|/usr/local/bin/forelight|$FORELIGHT_BIN|" "deploy/forelight-budget.$unit" >"$work/units/forelight-budget.$unit"
  done
  systemd-analyze verify "$work"/units/* >"$work/verify" 2>&1 || { cat "$work/verify"; fail 'systemd-analyze verify'; }
  # systemd-analyze succeeds even if it ignores unknown lines.
  [ ! -s "$work/verify" ] || { cat "$work/verify"; fail 'systemd-analyze printed warnings'; }
else
  missing 'the units are not verified: systemd-analyze is missing (Debian: systemd)'
fi

: >"$work/farm" # read below, perhaps before the farm has opened it
"$FORELIGHT_BIN" farm --data "$work/data" --workers 1 --price 3600 --preview cpu --listen 127.0.0.1:0 >"$work/farm" 2>&1 &
farm=$!
address=$(farm_address "$work/farm" "$farm")
mkdir "$work/etc" "$work/units-state" "$work/cron-state"
"$FORELIGHT_BIN" token --role viewer --name budget --data "$work/data" --out "$work/etc/viewer.token" >/dev/null

# Expands ExecStart like systemd: the program, the credential's folder, the folder of the state.
exec_start=$(sed -n 's/^ExecStart=//p' deploy/forelight-budget.service)
exec_start=${exec_start//\/usr\/local\/bin\/forelight/$FORELIGHT_BIN}
exec_start=${exec_start//%d\/token/$work/etc/viewer.token}
exec_start=${exec_start//%S\/forelight-budget/$work/units-state}
# The command that cron passes to the shell: all after the five fields of the time. cron turns % into a
# newline.
line=$(grep -E '^[0-9*]' deploy/forelight-budget.crontab)
[[ $line =~ ^([0-9*,/-]+\ +){5}[^\ ] ]] || fail "the crontab does not begin with five fields: $line"
[[ $line != *%* ]] || fail "cron reads % as the end of a line: $line"
cron=$(sed -E 's/^([0-9*,\/-]+ +){5}//' <<<"$line")
cron=${cron//\/usr\/local\/bin\/forelight/$FORELIGHT_BIN}
cron=${cron//\/etc\/forelight/$work/etc}
cron=${cron//\/var\/lib\/forelight-budget/$work/cron-state}
for left in "$exec_start" "$cron"; do
  [[ $left != */usr/local/* && $left != */var/lib/* && $left != */etc/forelight/* && $left != *%* ]] || fail "unexpected path: $left"
done
for file in deploy/forelight-budget.service deploy/forelight-budget.crontab; do
  grep -q 'FORELIGHT_SERVER=http://127.0.0.1:7878$' "$file" || fail "$file does not set the address of the service"
done

# run CODE LINES: runs each command line twice. Each must exit with the code, write its two files completely,
# and print so many lines on standard error.
run() {
  local name command code
  for name in units cron; do
    [ "$name" = units ] && command=$exec_start || command=$cron
    for _ in first second; do
      code=0
      env -i PATH="$PATH" FORELIGHT_SERVER="$address" sh -c "$command" >"$work/out" 2>"$work/err" || code=$?
      [ "$code" = "$1" ] || { cat "$work/err"; fail "$name: exit code $code, not $1"; }
      [ "$(grep -c . "$work/err" || true)" = "$2" ] || { cat "$work/err"; fail "$name: not $2 lines on standard error"; }
      [ "$name" = units ] || [ ! -s "$work/out" ] || fail 'cron would mail standard output'
      [ "$(ls "$work/$name-state")" = $'tonight.csv\ntonight.html' ] || fail "$name: $(ls "$work/$name-state")"
      grep -q '</html>' "$work/$name-state/tonight.html" || fail "$name: the page is incomplete"
      [ -s "$work/$name-state/tonight.csv" ] || fail "$name: the table is empty"
    done
  done
}

echo 'a night within the budget'
run 0 0

echo 'a night that exceeds the budget'
"$FORELIGHT_BIN" submit deploy/scenes/corridor --server "$address" --data "$work/data" --project film --frames 0 \
  --width 16 --height 9 --spp 1 --samples 16 --profile-frames 1 --follow >"$work/job" 2>&1 || { cat "$work/job"; fail 'the job'; }
"$FORELIGHT_BIN" budget set film 0.0001 --per night --server "$address" --data "$work/data" >/dev/null
run 3 1
grep -q film "$work/err" || fail "the line does not name the project: $(cat "$work/err")"
echo 'passed'
