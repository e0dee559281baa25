#!/usr/bin/env bash
# Runs every fuzz target of tests/fuzz for SECS seconds (default 60), with limits of memory (512 MiB) and of time for
# one input (10 s), and prints how many inputs each has tried. Findings are in target/fuzz/TARGET; a next run goes on
# from the corpus of earlier ones.
#
#   deploy/fuzz.sh [SECS [TARGET...]]
set -euo pipefail
cd "$(dirname "$0")/.."

secs=${1:-60}
shift $(($# > 0 ? 1 : 0))
targets=("$@")
[ "${#targets[@]}" -gt 0 ] || targets=(wire csv files checkpoint history log row list recording)
work=$PWD/target/fuzz
export CARGO_TARGET_DIR=$work/build
mkdir -p "$work"

# Sound files of the store, so that targets begin behind the checks of a file's form.
TIDEMAP_FUZZ_SEEDS=$work/seeds cargo test --quiet --locked -p tidemap-store --features fuzz --lib fuzz:: >/dev/null
# The code is safe Rust: without a sanitizer it runs many times faster. The coverage needs no nightly compiler.
(cd tests/fuzz && PATH="$PWD/../../target/tools/bin:$PATH" RUSTC_BOOTSTRAP=1 cargo fuzz build -s none --fuzz-dir .)

failed=0
for target in "${targets[@]}"; do
    mkdir -p "$work/$target/corpus" "$work/seeds/$target"
    seeds=("$work/seeds/$target")
    [ ! -d "tests/fuzz/seeds/$target" ] || seeds+=("tests/fuzz/seeds/$target")
    program=$(echo "$CARGO_TARGET_DIR"/*/release/"$target")
    status=0
    "$program" -rss_limit_mb=512 -timeout=10 -max_total_time="$secs" -max_len=65536 -print_final_stats=1 \
        -artifact_prefix="$work/$target/" "$work/$target/corpus" "${seeds[@]}" >"$work/$target.log" 2>&1 || status=$?
    tried=$(sed -n 's/^stat::number_of_executed_units: *//p' "$work/$target.log")
    memory=$(sed -n 's/^stat::peak_rss_mb: *//p' "$work/$target.log")
    echo "fuzz $target: ${tried:-0} inputs, ${memory:-?} MiB"
    if [ "$status" != 0 ]; then
        failed=1
        echo "fuzz $target: found something, see $work/$target.log and $work/$target" >&2
    fi
done
exit "$failed"
