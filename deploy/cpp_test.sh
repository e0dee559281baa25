#!/usr/bin/env bash
# Builds the example of client/cpp in target/cpp, and runs it twice: first against a daemon that is killed and started
# again while it observes; then the daemon has all observations already, and counts none of them again.
#
#   deploy/cpp_test.sh TIDEMAPD
set -euo pipefail
cd "$(dirname "$0")/.."
daemon=$(realpath "${1:?the path of tidemapd}")

for tool in cmake protoc grpc_cpp_plugin pkg-config; do
    command -v "$tool" >/dev/null || { echo "cpp-test: SKIPPED: $tool is not installed" >&2; exit 0; }
done
pkg-config --exists grpc++ || { echo "cpp-test: SKIPPED: libgrpc++-dev is not installed" >&2; exit 0; }

cmake -S client/cpp -B target/cpp >target/cpp.log || { cat target/cpp.log; exit 1; }
cmake --build target/cpp --parallel "$(nproc)" >>target/cpp.log || { tail -n 40 target/cpp.log; exit 1; }

data=$(mktemp -d)
process=""
trap 'stop -TERM; rm -rf "$data"' EXIT

stop() {
    [ -z "$process" ] || { kill "$1" "$process" && wait "$process"; } 2>/dev/null || true
    process=""
}

# start ADDRESS
start() {
    : >"$data/ports"
    "$daemon" --data-dir "$data/data" --listen "$1" --http-listen 127.0.0.1:0 --log-level error >"$data/ports" &
    process=$!
    for _ in $(seq 600); do
        [ -s "$data/ports" ] && break
        kill -0 "$process" || { echo "cpp-test: the daemon did not start" >&2; exit 1; }
        sleep 0.1
    done
    server=$(grep -o 'grpc=[^ ]*' "$data/ports" | cut -d = -f 2)
}

# expect FILE LINE...
expect() {
    if ! diff <(printf '%s\n' "${@:2}") "$1"; then
        echo "cpp-test: the example said something else (>) than was expected (<)" >&2
        exit 1
    fi
}

answers=("door at noon open, at night closed" "map: 345 known cells of 0.5 m" "route: hall -> lab -> office")

# The daemon is killed and started again while the example observes.
start 127.0.0.1:0
target/cpp/example "$server" 1000 >"$data/first" &
example=$!
sleep 2
stop -KILL
start "$server"
wait "$example"
expect "$data/first" "observations: 2016 durable, 0 of them before, 0 refused" "${answers[@]}"

target/cpp/example "$server" >"$data/second"
expect "$data/second" "observations: 2016 durable, 2016 of them before, 0 refused" "${answers[@]}"
echo "cpp-test: passed"
