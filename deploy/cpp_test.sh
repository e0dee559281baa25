#!/usr/bin/env bash
# Builds the example of client/cpp in target/cpp, and runs it twice against a daemon: the second time the daemon has all
# observations already, and counts none of them again.
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
"$daemon" --data-dir "$data/data" --listen 127.0.0.1:0 --http-listen 127.0.0.1:0 --log-level error >"$data/ports" &
process=$!
trap 'kill "$process" 2>/dev/null || true; wait "$process" 2>/dev/null || true; rm -rf "$data"' EXIT
for _ in $(seq 300); do
    [ -s "$data/ports" ] && break
    kill -0 "$process" || { echo "cpp-test: the daemon did not start" >&2; exit 1; }
    sleep 0.1
done
server=$(grep -o 'grpc=[^ ]*' "$data/ports" | cut -d = -f 2)

expect() {
    local said
    said=$(target/cpp/example "$server")
    if ! diff <(printf '%s\n' "$@") <(printf '%s\n' "$said"); then
        echo "cpp-test: the example said something else than was expected (<)" >&2
        exit 1
    fi
}

answers=("door at noon open, at night closed" "map: 345 known cells of 0.5 m" "route: hall -> lab -> office")
expect "observations: 2016 durable, 0 of them before, 0 refused" "${answers[@]}"
expect "observations: 2016 durable, 2016 of them before, 0 refused" "${answers[@]}"
echo "cpp-test: passed"
