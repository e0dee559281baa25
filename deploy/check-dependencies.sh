#!/usr/bin/env bash
# Checks the dependencies against deny.toml: licences, bans and sources, which needs no network, and advisories, whose
# database is fetched. Where it cannot be fetched, a copy fetched before is used; without one, the script prints so, and
# checks the rest. Fails only for its findings.
set -euo pipefail
cd "$(dirname "$0")/.."

PATH="$PATH:$PWD/target/tools/bin"
if ! command -v cargo-deny >/dev/null; then
    echo "lint: cargo-deny is not installed; deny.toml was not checked"
    exit 0
fi
cargo deny --locked --log-level error check --hide-inclusion-graph licenses bans sources
if timeout 60 cargo deny --log-level off fetch db >/dev/null 2>&1; then
    cargo deny --locked --log-level error check --hide-inclusion-graph --disable-fetch advisories
elif ls "${CARGO_HOME:-$HOME/.cargo}"/advisory-dbs/*/.git/HEAD >/dev/null 2>&1; then
    echo "lint: the advisories could not be fetched; those that were fetched before are used"
    cargo deny --locked --log-level error check --hide-inclusion-graph --disable-fetch advisories
else
    echo "lint: the advisories could not be fetched; licences, bans and sources were checked, advisories were not"
fi
