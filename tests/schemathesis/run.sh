#!/usr/bin/env bash
# Calls every JSON interface of a daemon of its own with generated requests, by its OpenAPI document, and fails if an
# answer has a code of 500 or more. `make schemathesis` runs it; SECONDS_MAX and SEED say how long and with which seed.
#
# Left out: WatchAnomalies, whose answer does not end, and CreateBackup, which would write to generated paths.
set -euo pipefail

programs=$(cd "$1" && pwd)
venv=$2
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'kill "${daemon:-}" 2>/dev/null || true; rm -rf -- "$work"' EXIT

cat > "$work/tidemapd.toml" <<END
data_dir = "$work/data"
listen = "127.0.0.1:0"
http_listen = "127.0.0.1:0"
http_write = true
END
"$programs/tidemapd" --config "$work/tidemapd.toml" --log-level error > "$work/ports" &
daemon=$!
until [ -s "$work/ports" ]; do kill -0 "$daemon"; sleep 0.1; done
http=$(sed 's/.*http=//' "$work/ports")
TIDEMAP_SERVER=$(sed 's/.*grpc=\([^ ]*\) .*/\1/' "$work/ports")
export TIDEMAP_SERVER PATH="$programs:$PATH"
tidemap sample office "$work/office" > "$work/sample.log"
sh "$work/office/try.sh" > "$work/try.log" 2>&1

cd "$work"
PYTHONPATH=$here SCHEMATHESIS_HOOKS=hooks "$venv/bin/schemathesis" run "http://$http/api/v1/openapi.json" \
    --checks not_a_server_error --phases examples,coverage,fuzzing --continue-on-failure --seed "${SEED:-1}" \
    --max-time "${SECONDS_MAX:-300}" --generation-database none --warnings off \
    --exclude-path-regex '(WatchAnomalies|CreateBackup)$'
kill -0 "$daemon"
