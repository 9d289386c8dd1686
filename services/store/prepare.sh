#!/usr/bin/env bash
# Writes .sqlx: what SQLite says of each statement that is checked at compile time. Builds read these files and
# so need no database. Run this after a change to a statement or a migration, and commit the files.
#
#   services/store/prepare.sh          writes .sqlx
#   services/store/prepare.sh --check  fails if .sqlx is out of date
#
# Further arguments go to cargo.
set -euo pipefail
cd "$(dirname "$0")"
check=false features=("$@")
[[ ${1:-} != --check ]] || check=true features=("${@:2}")
made=$(mktemp -d)
trap 'rm -rf "$made"' EXIT
mkdir "$made/.sqlx"

# A database with the schema that all migrations together make.
python3 - ../../migrations "$made/schema.sqlite" <<'PYTHON'
import pathlib, sqlite3, sys
migrations, database = sys.argv[1:]
if sqlite3.sqlite_version_info < (3, 38):
    sys.exit(f"python3 has SQLite {sqlite3.sqlite_version}; 3.38 or newer is needed")
connection = sqlite3.connect(database)
for migration in sorted(pathlib.Path(migrations).glob("*.sql")):
    connection.executescript(f"BEGIN;\n{migration.read_text()}\nCOMMIT;")
connection.close()
PYTHON

# The macros ask this database about each statement, and write its answers to the folder. The whole workspace is
# checked, because cargo would check the dependencies of a single package again, with fewer features.
touch src/lib.rs
FORELIGHT_SCHEMA="sqlite:$made/schema.sqlite" SQLX_OFFLINE=false SQLX_OFFLINE_DIR="$made/.sqlx" \
    cargo check --quiet --workspace "${features[@]}"

if $check; then
    if ! diff -rq .sqlx "$made/.sqlx"; then
        echo 'services/store/.sqlx is out of date: run services/store/prepare.sh and commit .sqlx' >&2
        exit 1
    fi
else
    rm -rf .sqlx
    cp -r "$made/.sqlx" .sqlx
    touch src/lib.rs
fi
