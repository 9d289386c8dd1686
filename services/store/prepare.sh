#!/usr/bin/env bash
# Writes .sqlx: what SQLite says of each statement that is checked at compile time. Builds read these files
# and so need no database. Run this after a change to a statement or a migration, and commit the files.
#
#   services/store/prepare.sh [OPTION…]          writes .sqlx; options, such as features, go to cargo
#   services/store/prepare.sh --check COMMAND…   runs the command, a build of the workspace, and fails if
#                                                .sqlx is out of date
set -euo pipefail
cd "$(dirname "$0")/../.."
store=services/store answers=${CARGO_TARGET_DIR:-target}/sqlx
# The whole workspace, because cargo would check the dependencies of a single package again, with fewer
# features.
check=false build=(cargo check --quiet --workspace "$@")
[[ ${1:-} != --check ]] || check=true build=("${@:2}")
[ ${#build[@]} -gt 0 ] || { echo 'error: say what to build, such as --check cargo build --workspace' >&2; exit 2; }
made=$(mktemp -d)
trap 'rm -rf "$made"' EXIT

# A database with the schema that all migrations together make.
python3 - migrations "$made/schema.sqlite" <<'PYTHON'
import pathlib, sqlite3, sys
migrations, database = sys.argv[1:]
if sqlite3.sqlite_version_info < (3, 38):
    sys.exit(f"python3 has SQLite {sqlite3.sqlite_version}; 3.38 or newer is needed")
connection = sqlite3.connect(database)
for migration in sorted(pathlib.Path(migrations).glob("*.sql")):
    connection.executescript(f"BEGIN;\n{migration.read_text()}\nCOMMIT;")
connection.close()
PYTHON

# The macros ask this database about each statement, and write its answers to a folder. Those of an earlier
# build hold until something is changed.
if ! $check || [ ! -e "$answers/complete" ] ||
    [ -n "$(find Cargo.lock $store migrations -name .sqlx -prune -o -newer "$answers/complete" -print -quit)" ]; then
    rm -rf "$answers"
    mkdir -p "$answers/.sqlx"
    touch $store/src/lib.rs "$made/begun"
fi
FORELIGHT_SCHEMA="sqlite:$made/schema.sqlite" SQLX_OFFLINE=false SQLX_OFFLINE_DIR=$(realpath "$answers/.sqlx") \
    "${build[@]}"
[ ! -e "$made/begun" ] || mv "$made/begun" "$answers/complete"

if $check; then
    if ! diff -rq $store/.sqlx "$answers/.sqlx"; then
        rm "$answers/complete" # the next run asks again
        echo 'services/store/.sqlx is out of date: run services/store/prepare.sh and commit .sqlx' >&2
        exit 1
    fi
else
    rm -rf $store/.sqlx
    cp -r "$answers/.sqlx" $store
    touch $store/src/lib.rs
fi
