#!/usr/bin/env bash
# Builds the examples of client/cpp in target/cpp, and runs them against a real daemon.
#
#   deploy/cpp_test.sh TIDEMAPD           the program tidemap is in the same folder
#
# client/cpp/queue: a program takes observations before the daemon runs, while it runs, and after it was killed; the
# daemon counts each once. client/cpp, which needs gRPC for C++: the example runs twice, first against a daemon that is
# killed and started again while it observes; then the daemon has all observations already, and counts none of them
# again.
set -euo pipefail
cd "$(dirname "$0")/.."
daemon=$(realpath "${1:?the path of tidemapd}")

skip() { echo "cpp-test: SKIPPED: $*" >&2; exit 0; }
# build FOLDER TARGET
build() {
    cmake -S "$1" -B "$2" >target/cpp.log || { cat target/cpp.log; exit 1; }
    cmake --build "$2" --parallel "$(nproc)" >>target/cpp.log 2>&1 || { tail -n 40 target/cpp.log; exit 1; }
}

for tool in cmake c++ cargo; do
    command -v "$tool" >/dev/null || skip "$tool is not installed"
done

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

# observations ARGUMENTS OF tidemap map: the number of observations of the map that it shows
observations() {
    "$(dirname "$daemon")/tidemap" --server "$server" map "$@" --output json | grep -o '"observations": *[0-9]*' |
        grep -o '[0-9]*$'
}

# expect FILE LINE...
expect() {
    if ! diff <(printf '%s\n' "${@:2}") "$1"; then
        echo "cpp-test: the example printed something else (>) than was expected (<)" >&2
        exit 1
    fi
}

# The queue: first no daemon is there, and the map is created later.
build client/cpp/queue target/cpp-queue
start 127.0.0.1:0
stop -TERM
target/cpp-queue/queue_example "$server" "$data/queue" 500 >"$data/offline"
expect "$data/offline" "taken 500, waiting 500, refused 0"
start "$server"
observations create office >"$data/counted"
expect "$data/counted" 0
target/cpp-queue/queue_example "$server" "$data/queue" 1000 60 >"$data/online"
expect "$data/online" "taken 1000, waiting 0, refused 0"
# The daemon is killed while the program takes observations, and started again while it waits.
target/cpp-queue/queue_example "$server" "$data/queue" 50000 120 >"$data/killed" &
example=$!
sleep 0.3
stop -KILL
start "$server"
wait "$example"
expect "$data/killed" "taken 50000, waiting 0, refused 0"
observations show office >"$data/counted"
expect "$data/counted" 50000
stop -TERM
rm -rf "$data/data"

for tool in protoc grpc_cpp_plugin pkg-config; do
    command -v "$tool" >/dev/null || skip "the example with gRPC: $tool is not installed"
done
pkg-config --exists grpc++ || skip "the example with gRPC: libgrpc++-dev is not installed"
build client/cpp target/cpp
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
