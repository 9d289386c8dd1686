#!/usr/bin/env bash
# Runs a job on a farm with artefacts in an S3 bucket (moto, https://docs.getmoto.org), and makes the server
# unreachable for a while. Images must have the bits of `forelight render`. The bucket must hold exactly the
# artefacts in the farm's database. While the server is away, the farm must answer "later", never "no".
#
#   FORELIGHT_BIN   the program (default: target/debug/forelight, which is built)
#
# Needs Python with venv, and network access. Without them it is reported as not run, and in CI it
# fails.
set -euo pipefail
cd "$(dirname "$0")/../.."
source tests/peers/support.bash

python_with s3 'moto[server]==5.1.16' 'blake3>=1,<2' 'numpy>=2,<3' 'OpenEXR>=3.3,<4'
need_forelight

work=$(mktemp -d)
server=
proxy=
farm=
cleanup() {
  for process in $farm $proxy $server; do
    kill -9 "$process" 2>/dev/null || true
    wait "$process" 2>/dev/null || true
  done
  rm -rf "$work"
}
trap cleanup EXIT
fail() { echo "failed: $1"; tail -n 30 "$work/farm.log" 2>/dev/null || true; exit 1; }
# The server keeps its objects in memory, so it cannot be stopped. A proxy in front of it is stopped and
# started instead.
behind=$(free_port)
port=$(free_port)
open_door() {
  "$environment/bin/python" - "$port" "$behind" <<'PYTHON' &
import asyncio, sys

port, behind = map(int, sys.argv[1:])

async def pour(reader, writer):
    try:
        while data := await reader.read(1 << 16):
            writer.write(data)
            await writer.drain()
    except ConnectionError:
        pass
    finally:
        writer.close()

async def serve(reader, writer):
    there, back = await asyncio.open_connection("127.0.0.1", behind)
    await asyncio.gather(pour(reader, back), pour(there, writer))

async def main():
    server = await asyncio.start_server(serve, "127.0.0.1", port)
    await server.serve_forever()

asyncio.run(main())
PYTHON
  proxy=$!
  wait_for 10 bash -c "exec 3<>/dev/tcp/127.0.0.1/$port"
}
shut_door() { kill -9 "$proxy"; wait "$proxy" 2>/dev/null || true; proxy=; }

"$environment/bin/moto_server" -H 127.0.0.1 -p "$behind" >"$work/moto.log" 2>&1 &
server=$!
wait_for 30 bash -c "exec 3<>/dev/tcp/127.0.0.1/$behind"
open_door

export NO_PROXY=127.0.0.1 no_proxy=127.0.0.1
export AWS_ENDPOINT_URL=http://127.0.0.1:$port AWS_REGION=us-east-1 AWS_ACCESS_KEY_ID=farm AWS_SECRET_ACCESS_KEY=very-secret-key
small=(--width 64 --height 36 --spp 2)
start() {
  "$FORELIGHT_BIN" farm --data "$work/data" --listen "127.0.0.1:${1:-0}" --workers 2 --threads 1 --preview cpu --lease-ttl 3s \
    --artifacts s3://renders/farm/a "${@:2}" >"$work/printed" 2>>"$work/farm.log" &
  farm=$!
}
refused() { # WORDS: a farm that is started now says so and ends
  start
  ! wait "$farm" || fail 'a farm started without usable storage'
  farm=
  grep -q "$1" "$work/farm.log" || fail "not in the log of the farm: $1"
}

echo 'unusable storage is refused with the reason'
refused 'AWS_ALLOW_HTTP=true'
export AWS_ALLOW_HTTP=true
refused 'no such bucket'
"$environment/bin/python" -c '
import boto3
boto3.client("s3").create_bucket(Bucket="renders")'

echo 'a job with artefacts in the bucket, while the server is away for a time'
start
wait_for 30 grep -q '^listening on ' "$work/printed"
url=$(sed -n 's/^listening on //p' "$work/printed")
token=$(cat "$work/data/tokens/worker.token")
"$FORELIGHT_BIN" submit deploy/scenes/corridor --server "$url" --data "$work/data" --frames 0-9 "${small[@]}" \
  --samples 32 --deadline 1h --follow --json --out "$work/images" >"$work/job.json" 2>"$work/submit.log" &
submitted=$!
rendered() { grep -q 'committed' "$work/farm.log" && grep -q 'leased.*kind=render' "$work/farm.log"; }
wait_for 120 rendered
shut_door
answer=$(curl -s -o "$work/problem.json" -D - -X PUT --data-binary 'half an image' -H "Authorization: Bearer $token" \
  "$url/v1/artifacts/$(printf '0%.0s' {1..64})")
# The wrong hash is found before anything is sent to the server.
grep -q '^HTTP/1.1 422' <<<"$answer" || fail "a wrong hash was answered: $answer"
image=$("$environment/bin/python" - "$work/data/forelight.sqlite" <<'PYTHON'
import sqlite3, sys
print(sqlite3.connect(f"file:{sys.argv[1]}?mode=ro", uri=True).execute("SELECT lower(hex(hash)) FROM artifacts").fetchone()[0])
PYTHON
)
answer=$(curl -s -o "$work/problem.json" -D - -H "Authorization: Bearer $token" "$url/v1/artifacts/$image")
grep -q '^HTTP/1.1 503' <<<"$answer" && grep -qi '^retry-after: ' <<<"$answer" || fail "while the server is away: $answer"
grep -q 'the artefact store cannot be used just now' "$work/problem.json" || fail "$(cat "$work/problem.json")"
sleep 6
kill -0 "$submitted" || fail 'the job ended while the server was away'
open_door
wait "$submitted" || { cat "$work/submit.log"; fail 'the job was not delivered'; }

echo 'the images, the bucket and the database agree'
for frame in 0 3 9; do
  "$FORELIGHT_BIN" render deploy/scenes/corridor --frame $frame "${small[@]}" --preview cpu --out "$work/$frame.exr" >"$work/render.log" 2>&1 ||
    { cat "$work/render.log"; fail "frame $frame cannot be rendered here"; }
  same_bits "$work/$frame.exr" "$(find "$work/images" -name "*$(printf %04d $frame)*.exr" | head -1)"
done
"$environment/bin/python" - "$work/data" <<'PYTHON'
import boto3, pathlib, sqlite3, sys

data = pathlib.Path(sys.argv[1])
database = sqlite3.connect(f"file:{data}/forelight.sqlite?mode=ro", uri=True)
promised = {f"farm/a/blake3/{name[:2]}/{name}": size for name, size in database.execute("SELECT lower(hex(hash)), size FROM artifacts")}
client = boto3.client("s3")
pages = client.get_paginator("list_objects_v2").paginate(Bucket="renders")
there = {entry["Key"]: entry["Size"] for page in pages for entry in page["Contents"]}
there.pop("farm/a/farm")
missing = {name: size for name, size in promised.items() if there.get(name) != size}
assert promised and not missing, f"promised, and not there: {missing}"
# An object without a row is only waste: a result sent after its lease was lost.
assert len(there) - len(promised) <= 8, f"{len(there)} objects for {len(promised)} rows"
left = client.list_multipart_uploads(Bucket="renders").get("Uploads", [])
assert not left, f"unfinished uploads: {left}"
lost, failed = database.execute("SELECT (SELECT count(*) FROM events WHERE kind = 'task_failed'), (SELECT count(*) FROM tasks WHERE state <> 'done')").fetchone()
assert (lost, failed) == (0, 0), f"{lost} tasks failed, {failed} are not done"
local = [path for path in (data / "artifacts").rglob("*") if path.is_file()]
assert not local, f"left in the data folder: {local}"
PYTHON
grep -q "$AWS_SECRET_ACCESS_KEY" "$work/farm.log" && fail 'the log holds a secret'

echo 'a long artefact is stored in parts and read back; an aborted upload leaves nothing'
"$environment/bin/python" - "$work" <<'PYTHON' >"$work/hashes"
import blake3, pathlib, random, sys

for name, seed in ("long", 1), ("other", 2):
    content = random.Random(seed).randbytes(20_000_001)
    (pathlib.Path(sys.argv[1]) / name).write_bytes(content)
    print(blake3.blake3(content).hexdigest())
PYTHON
{ read -r long; read -r other; } <"$work/hashes"
put() { curl -s -o "$work/answer.json" -w '%{http_code}' -X PUT --data-binary "@$work/$1" -H "Authorization: Bearer $token" "${@:3}" "$url/v1/artifacts/$2" || true; }
[ "$(put long "$long")" = 201 ] || fail "a long artefact: $(cat "$work/answer.json")"
[ "$(put long "$long")" = 200 ] || fail "the same again: $(cat "$work/answer.json")"
curl -sf -H "Authorization: Bearer $token" "$url/v1/artifacts/$long" | cmp - "$work/long" || fail 'it differs when read back'
# 100 is "continue".
[[ "$(put other "$other" --limit-rate 4M --max-time 1)" = [01]00 ]] || fail 'an aborted upload was answered'
staged() { [ -n "$(find "$work/data/artifacts" -type f)" ]; }
wait_for 20 eval '! staged'
"$environment/bin/python" - "$long" "$other" <<'PYTHON'
import boto3, sys

client = boto3.client("s3")
pages = client.get_paginator("list_objects_v2").paginate(Bucket="renders")
there = {entry["Key"].rsplit("/", 1)[1]: entry for page in pages for entry in page["Contents"]}
assert there[sys.argv[1]]["Size"] == 20_000_001
assert there[sys.argv[1]]["ETag"].strip('"').endswith("-3"), "it was not sent in parts of 8 MiB"
assert sys.argv[2] not in there and not client.list_multipart_uploads(Bucket="renders").get("Uploads")
PYTHON

echo 'a farm with a different artefact store is refused'
kill -INT "$farm"
wait "$farm" || true
farm=
"$FORELIGHT_BIN" farm --data "$work/data" --listen 127.0.0.1:0 --workers 1 --preview cpu >"$work/printed" 2>"$work/farm.log" &&
  fail 'the farm started without its artefacts'
grep -q -- '--artifacts s3://renders/farm/a' "$work/farm.log" || fail 'the error does not name the artefact store'
