#!/usr/bin/env bash
# The systemd units and the crontab line of deploy/. systemd finds nothing wrong with the units, and their command lines are run against a live service, twice each. On a fine night the exit code is 0 and standard error is empty. When a budget is threatened, the exit code is 3 and standard error has one line, which cron mails. The files are the same each time.
#
#   FORELIGHT_BIN   the program (default: target/debug/forelight, which is built)
#
# Without systemd-analyze (Debian: systemd) the units are not verified, and that part is reported as not run;
# in CI it fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash
need_forelight

work=$(mktemp -d)
farm=
stop() { [ -z "$farm" ] || { kill -INT "$farm" && wait "$farm"; } 2>/dev/null || true; rm -rf "$work"; }
trap stop EXIT
fail() { echo "failed: $*"; exit 1; }

command -v systemd-analyze >/dev/null || deploy/packages.sh systemd || true
if command -v systemd-analyze >/dev/null; then
  echo 'the units, as systemd reads them'
  mkdir "$work/units"
  for unit in service timer; do
    sed "s|/usr/local/bin/forelight|$FORELIGHT_BIN|" "deploy/forelight-budget.$unit" >"$work/units/forelight-budget.$unit"
  done
  systemd-analyze verify "$work"/units/* >"$work/verify" 2>&1 || { cat "$work/verify"; fail 'systemd-analyze verify'; }
  # It says of lines that it does not know that it ignores them, and calls that a success.
  [ ! -s "$work/verify" ] || { cat "$work/verify"; fail 'systemd-analyze has remarks'; }
else
  missing 'the units are not verified: there is no systemd-analyze (Debian: systemd)'
fi

"$FORELIGHT_BIN" farm --data "$work/data" --workers 1 --price 3600 --preview cpu --listen 127.0.0.1:0 >"$work/farm" 2>&1 &
farm=$!
address=
for _ in $(seq 300); do
  address=$(sed -n 's/^listening on //p' "$work/farm")
  [ -n "$address" ] && break
  kill -0 "$farm" 2>/dev/null || { cat "$work/farm"; fail 'the farm did not start'; }
  sleep 0.1
done
mkdir "$work/etc" "$work/units-state" "$work/cron-state"
"$FORELIGHT_BIN" token --role viewer --name budget --data "$work/data" --out "$work/etc/viewer.token" >/dev/null

# What systemd makes of ExecStart: the program, the credential's folder, the folder of the state.
exec_start=$(sed -n 's/^ExecStart=//p' deploy/forelight-budget.service)
exec_start=${exec_start//\/usr\/local\/bin\/forelight/$FORELIGHT_BIN}
exec_start=${exec_start//%d\/token/$work/etc/viewer.token}
exec_start=${exec_start//%S\/forelight-budget/$work/units-state}
# What cron hands to the shell: all after the five fields of the time. It would make a line's end of a per
# cent sign.
line=$(grep -E '^[0-9*]' deploy/forelight-budget.crontab)
[[ $line =~ ^([0-9*,/-]+\ +){5}[^\ ] ]] || fail "the crontab does not begin with five fields: $line"
[[ $line != *%* ]] || fail "cron reads % as the end of a line: $line"
cron=$(sed -E 's/^([0-9*,\/-]+ +){5}//' <<<"$line")
cron=${cron//\/usr\/local\/bin\/forelight/$FORELIGHT_BIN}
cron=${cron//\/etc\/forelight/$work/etc}
cron=${cron//\/var\/lib\/forelight-budget/$work/cron-state}
for left in "$exec_start" "$cron"; do
  [[ $left != */usr/local/* && $left != */var/lib/* && $left != */etc/forelight/* && $left != *%* ]] || fail "a path is not known here: $left"
done
for file in deploy/forelight-budget.service deploy/forelight-budget.crontab; do
  grep -q 'FORELIGHT_SERVER=http://127.0.0.1:7878$' "$file" || fail "$file does not say where the service is"
done

# run CODE LINES: each command line twice; it has to end with the code, and to leave its two files, whole, and
# so many lines on standard error.
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
      grep -q '</html>' "$work/$name-state/tonight.html" || fail "$name: the page is not whole"
      [ -s "$work/$name-state/tonight.csv" ] || fail "$name: the table is empty"
    done
  done
}

echo 'a fine night'
run 0 0

echo 'a night whose budget is used up'
"$FORELIGHT_BIN" submit deploy/scenes/corridor --server "$address" --data "$work/data" --project film --frames 0 \
  --width 16 --height 9 --spp 1 --samples 16 --profile-frames 1 --follow >"$work/job" 2>&1 || { cat "$work/job"; fail 'the job'; }
"$FORELIGHT_BIN" budget set film 0.0001 --per night --server "$address" --data "$work/data" >/dev/null
run 3 1
grep -q film "$work/err" || fail "the line does not name the project: $(cat "$work/err")"
echo 'passed'
