#!/usr/bin/env bash
# Tries the Debian package as an operator would, in a clean root that debootstrap makes: install, serve, make a backup,
# reinstall with changed settings, restore, rotate certificate and token, remove, purge. Needs root and a network.
#
#   deploy/debian/try.sh PACKAGE.deb [SUITE]     SUITE is stable by default; the last line is `the package works`
set -euo pipefail
package=$(realpath "$1")
suite=${2:-stable}
root=$(mktemp -d)
chmod 755 "$root"
finish() { umount -q "$root/proc" || true; rm -rf "$root"; }
trap finish EXIT

debootstrap --variant=minbase --include=openssl "$suite" "$root" >"$root.log" 2>&1 || { tail "$root.log"; exit 1; }
rm -f "$root.log"
cp "$package" "$root/root/tidemap.deb"
mount --bind /proc "$root/proc"

cat >"$root/root/try" <<'TRY'
set -euo pipefail
fail() { echo "failed: $*" >&2; cat /tmp/log >&2 2>/dev/null || true; exit 1; }
start() {
    rm -f /tmp/ports
    setpriv --reuid tidemap --regid tidemap --clear-groups --no-new-privs \
        tidemapd --config /etc/tidemap/tidemapd.toml --data-dir /var/lib/tidemap >/tmp/ports 2>>/tmp/log &
    daemon=$!
    for _ in $(seq 100); do [ ! -s /tmp/ports ] || break; sleep 0.1; done
    [ -s /tmp/ports ] || fail "the daemon does not start"
}
stop() { kill "$daemon"; wait "$daemon" || fail "the daemon ended with $?"; }

cd /root
dpkg -i tidemap.deb
[ "$(stat -c '%U %a' /var/lib/tidemap)" = "tidemap 700" ] || fail "the data folder is not private"
[ -e /etc/systemd/system/multi-user.target.wants/tidemapd.service ] || fail "the unit is not enabled"
[ -e /usr/share/man/man1/tidemap-observe.1.gz ] && [ -e /usr/share/bash-completion/completions/tidemap ] || fail "texts"
tidemapd --config /etc/tidemap/tidemapd.toml config >/dev/null || fail "the settings are wrong"

start
tidemap map create home >/dev/null
printf 'time,state,value\n2025-01-06T08:57:10Z,door,0\n2025-01-06T09:41:33Z,door,1\n' >door.csv
tidemap observe home door.csv --producer robot-1
tidemap update home >/dev/null
[ "$(stat -c '%U %a' /var/backups/tidemap)" = "tidemap 700" ] || fail "there is no private place for backups"
tidemap backup create /var/backups/tidemap/by-hand >/dev/null
tidemapd check /var/backups/tidemap/by-hand
stop

# Serve with TLS and tokens; then the package again, as an upgrade does: the settings stay.
certificate() { # certificate DAYS
    openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN=tidemapd -keyout new.key -out new.csr
    openssl x509 -req -in new.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days "$1" -extfile names -out new.pem
    install -o tidemap -m 600 new.key /var/lib/tidemap/daemon.key
    install -o tidemap -m 600 new.pem /var/lib/tidemap/daemon.pem
} 2>/dev/null
printf 'subjectAltName=IP:127.0.0.1\nextendedKeyUsage=serverAuth' >names
openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 3650 -subj "/CN=our maps" \
    -keyout ca.key -out ca.pem 2>/dev/null
certificate 30
cat >>/etc/tidemap/tidemapd.toml <<'TOML'
tls_certificate = "/var/lib/tidemap/daemon.pem"
tls_key = "/var/lib/tidemap/daemon.key"
tokens_file = "/var/lib/tidemap/tokens.toml"
TOML
dpkg -i tidemap.deb >/dev/null
grep -q '^tokens_file' /etc/tidemap/tidemapd.toml || fail "the settings are lost"
token() { tidemapd --config /etc/tidemap/tidemapd.toml token "$@"; }
token create --role admin --note old >old.token
start
export TIDEMAP_SERVER=https://127.0.0.1:7435 TIDEMAP_TLS_CA=ca.pem
tidemap --token-file old.token reconstruct home door --from 2025-01-06T00:00:00Z --to 2025-01-07T00:00:00Z >kept.csv
[ "$(wc -l <kept.csv)" = 3 ] || fail "the data is not what it was"
certificate 365
token create --role admin --note new >new.token
sleep 3
tidemap --token-file new.token map list >/dev/null || fail "the new certificate or token is not taken"
openssl s_client -connect 127.0.0.1:7435 </dev/null 2>/dev/null | openssl x509 -noout -checkend $((300 * 86400)) ||
    fail "the old certificate is still in use"
token revoke "$(token list | grep ',old,' | cut -d , -f 1)"
sleep 3
! tidemap --token-file old.token map list 2>/dev/null || fail "the old token is still valid"
stop

# A disk that was lost: back to the backup.
find /var/lib/tidemap -mindepth 1 -maxdepth 1 ! -name 'daemon.*' ! -name tokens.toml -exec rm -rf {} +
tidemapd backup restore /var/backups/tidemap/by-hand /srv/restored
chown -R tidemap: /srv/restored
mv /srv/restored/* /var/lib/tidemap/
start
tidemap --token-file new.token reconstruct home door --from 2025-01-06T00:00:00Z --to 2025-01-07T00:00:00Z >again.csv
cmp kept.csv again.csv || fail "the backup is not what it was"
stop

dpkg -r tidemap >/dev/null
[ ! -e /usr/bin/tidemapd ] && [ -e /etc/tidemap/tidemapd.toml ] || fail "removed too much, or too little"
dpkg -P tidemap
[ ! -e /etc/tidemap/tidemapd.toml ] && [ -e /var/lib/tidemap/MANIFEST ] && [ -e /var/backups/tidemap/by-hand ] || fail "purged too much, or too little"
TRY
env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin LC_ALL=C chroot "$root" bash /root/try
echo "the package works"
