#!/usr/bin/env bash
# The Debian package, from programs that are built already: target/deb/tidemap_VERSION_ARCHITECTURE.deb.
# Its contents are listed in client/cli/Cargo.toml. cargo-deb makes it, and deploy/setup.sh brings cargo-deb.
#
#   deploy/deb.sh PROGRAMS   the folder of tidemap and tidemapd, release builds
set -euo pipefail
cd "$(dirname "$0")/.."
programs=$1
parts=target/deb/parts
rm -rf "$parts"
mkdir -p "$parts"

deploy/texts.sh "$programs" target/texts
install -m 755 deploy/debian/{postinst,prerm,postrm} "$parts"
sed 's|/usr/local/bin/|/usr/bin/|' deploy/tidemapd.service >"$parts/tidemapd.service"

gzip -9nc CHANGELOG.md >"$parts/changelog.gz"
version=$("$programs/tidemapd" --version | awk '{ print $2 }')
# One commit always gives the same package.
SOURCE_DATE_EPOCH=$(git log -1 --format=%ct 2>/dev/null || echo 0)
export SOURCE_DATE_EPOCH
maintainer=$(sed -n 's/^maintainer = "\(.*\)"/\1/p' client/cli/Cargo.toml)
cat >"$parts/changelog" <<TEXT
tidemap ($version-1) stable; urgency=medium

  * The changes are in /usr/share/doc/tidemap/changelog.gz.

 -- $maintainer  $(date -R -u -d "@$SOURCE_DATE_EPOCH")
TEXT

PATH="$PWD/target/tools/bin:$PATH" cargo deb --quiet --no-build --no-dbgsym --strip -p tidemap -o target/deb/
