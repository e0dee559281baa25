#!/usr/bin/env bash
# Builds the Python wheel with the daemon in it, into target/wheels.
#
#   deploy/wheel.sh
#   TIDEMAP_ZIG=no       for this machine's C library only, without zig
#
# Zig links both for glibc 2.28, so that the wheel (manylinux_2_28) installs on Debian 10, RHEL 8, Ubuntu 20.04 and
# later.
# Where zig cannot be had, the wheel needs the C library of this machine, or a newer one, and a line reports it.
set -euo pipefail
cd "$(dirname "$0")/.."

# Tools with fixed versions.
MATURIN=1.16.0
ZIG=(cargo-zigbuild==0.24.1 ziglang==0.17.1)
GLIBC=2.28

say() { echo "wheel: $*" >&2; }

target=${CARGO_TARGET_DIR:-$PWD/target}
tools=$PWD/target/python/tools
[ -x "$tools/bin/python" ] || python3 -m venv "$tools"
"$tools/bin/pip" install --quiet --disable-pip-version-check "maturin==$MATURIN"

zig=${TIDEMAP_ZIG:-yes}
triple=$(rustc -vV | sed -n 's/^host: //p')
if [ "$zig" = yes ] && [[ $triple != *-linux-gnu ]]; then
    zig=no
fi
if [ "$zig" = yes ] && ! "$tools/bin/pip" install --quiet --disable-pip-version-check "${ZIG[@]}"; then
    say "zig could not be had; the wheel is for this machine's glibc ($(ldd --version | sed -n '1s/.* //p')) and newer"
    zig=no
fi

if [ "$zig" = yes ] &&
    ! PATH="$tools/bin:$PATH" cargo zigbuild --release --locked -p tidemapd --features full --target "$triple.$GLIBC"; then
    say "zig could not link the daemon; the wheel is for this machine's glibc and newer"
    zig=no
fi
if [ "$zig" = yes ]; then
    built=$target/$triple/release
    arguments=(--zig --compatibility "manylinux_${GLIBC/./_}")
else
    cargo build --release --locked -p tidemapd --features full
    built=$target/release
    arguments=()
fi

rm -rf target/wheels
mkdir -p client/python/python/tidemap/bin
trap 'rm -rf client/python/python/tidemap/bin' EXIT
strip -o client/python/python/tidemap/bin/tidemapd "$built/tidemapd"
chmod 755 client/python/python/tidemap/bin/tidemapd
# Maturin checks the library, not the program beside it.
if [ "$zig" = yes ]; then
    program=client/python/python/tidemap/bin/tidemapd
    newest=$(grep -aoE 'GLIBC_2\.[0-9]+' "$program" | sed 's/GLIBC_//' | sort -uV | tail -n 1)
    if [ "$(printf '%s\n' "$newest" "$GLIBC" | sort -V | tail -n 1)" != "$GLIBC" ]; then
        say "the daemon needs glibc $newest, newer than $GLIBC"
        exit 1
    fi
fi
PATH="$tools/bin:$PATH" CARGO_TARGET_DIR=$target "$tools/bin/maturin" build --quiet --release --locked \
    --manifest-path client/python/Cargo.toml --out target/wheels "${arguments[@]}" ${TIDEMAP_MATURIN_ARGUMENTS:-}
ls -l target/wheels
