//! TLS: who is let in, and a certificate that changes while the daemon serves.

use std::{
    fs,
    io::{ErrorKind, Read as _},
    net::TcpStream,
    os::unix::fs::PermissionsExt as _,
    path::Path,
    time::Duration,
};

use rustix::process::Signal;
use tempfile::tempdir;
use tidemap_client::Error;
use tidemap_tests::{
    certificates::{Authority, Pair, Purpose, Validity, private_file},
    cli,
    daemon::Launch,
    tokens::Tokens,
};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio_rustls::rustls::{SupportedProtocolVersion, pki_types::ServerName, version};

use super::{eventually, metrics};

/// A daemon with this certificate; data and certificates are in the folder.
fn launch(folder: &Path, pair: &Pair) -> Launch {
    let [certificate, key] = pair.write(folder);
    let launch = Launch::on(&folder.join("data"));
    launch.setting("tls_certificate", certificate.display()).setting("tls_key", key.display())
}

/// A TLS connection of this version, or why there is none.
async fn connect(
    address: &str,
    authority: &Authority,
    version: &'static SupportedProtocolVersion,
) -> std::io::Result<tokio_rustls::client::TlsStream<tokio::net::TcpStream>> {
    let socket = tokio::net::TcpStream::connect(address).await?;
    authority.connector(version).connect(ServerName::try_from("localhost").expect("a name"), socket).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_port_with_tls_serves_those_who_trust_it_and_nobody_in_clear() {
    let work = tempdir().expect("a folder");
    let (authority, other) = (Authority::new("ours"), Authority::new("theirs"));
    let daemon = launch(work.path(), &authority.sign(Validity::Years)).start();
    authority.client(&daemon, None, None).maps().await.expect("served");
    for (what, refused) in [("in clear", daemon.client()), ("other authority", other.client(&daemon, None, None))] {
        let error = refused.maps().await.expect_err(what);
        assert!(matches!(error, Error::Unreachable { .. }), "{what}: {error}");
    }
    connect(&daemon.grpc, &authority, &version::TLS13).await.expect("TLS 1.3");
    connect(&daemon.grpc, &authority, &version::TLS12).await.expect_err("TLS 1.2 is not spoken");

    let ca = private_file(&work.path().join("ca.pem"), authority.pem());
    let server = format!("https://{}", daemon.grpc.replace("127.0.0.1", "localhost"));
    let run = |args: &[&str]| cli::command(&server, args).output().expect("tidemap runs");
    let listed = run(&["--tls-ca", &ca.display().to_string(), "map", "list"]);
    assert!(listed.status.success(), "{}", String::from_utf8_lossy(&listed.stderr));
    let without = run(&["map", "list"]);
    assert_eq!(without.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&without.stderr).contains("authority"));
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_names_an_authority_of_clients_serves_only_clients_of_it() {
    let work = tempdir().expect("a folder");
    let (authority, robots) = (Authority::new("ours"), Authority::new("robots"));
    let ca = private_file(&work.path().join("robots.pem"), robots.pem());
    let launch = launch(work.path(), &authority.sign(Validity::Years)).setting("tls_client_ca", ca.display());
    let daemon = launch.start();
    let robot = robots.sign(Validity::Years);
    authority.client(&daemon, Some(&robot), None).maps().await.expect("served");
    let (foreign, ended) = (authority.sign(Validity::Years), robots.sign(Validity::Ended));
    for (what, pair) in [("none", None), ("foreign", Some(&foreign)), ("ended", Some(&ended))] {
        authority.client(&daemon, pair, None).maps().await.expect_err(what);
    }
    let (trusted, server) =
        (private_file(&work.path().join("ca.pem"), authority.pem()), format!("https://{}", daemon.grpc));
    let trusted = trusted.display().to_string();
    for number in 0..40 {
        let listed = cli::command(&server, ["--tls-ca", &trusted, "map", "list"]).output().expect("tidemap runs");
        let text = String::from_utf8_lossy(&listed.stderr).into_owned();
        let is_reported = text.contains("--tls-cert") && text.contains("requires a certificate of the client");
        assert!(is_reported, "try {number}: {text}");
    }
    assert!(metrics(&daemon).contains("tidemap_tls_handshakes_failed_total"));
    let log = daemon.stop_in_order();
    let line = log.lines().find(|line| line.contains("a TLS handshake failed")).expect("failures are logged");
    assert!(line.contains("127.0.0.1:") && line.contains("error="), "{line}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_new_certificate_is_used_without_a_restart_and_a_bad_one_is_not() {
    let work = tempdir().expect("a folder");
    let (before, after, last) = (Authority::new("before"), Authority::new("after"), Authority::new("last"));
    let daemon = launch(work.path(), &before.sign(Validity::Years)).start();
    let open = before.client(&daemon, None, None);
    open.maps().await.expect("served");

    // A certificate that does not fit the key, as between the two steps of a replacement.
    let next = after.sign(Validity::Years);
    private_file(&work.path().join("daemon.pem"), &next.certificate);
    eventually("the bad pair is logged", async || daemon.process().stderr().contains("cannot be used")).await;
    before.client(&daemon, None, None).maps().await.expect("the old certificate stays");
    assert!(metrics(&daemon).contains("tidemap_reload_failures_total{what=\"certificates\"} 1"));

    let _ = next.write(work.path());
    eventually("the new certificate", async || after.client(&daemon, None, None).maps().await.is_ok()).await;
    before.client(&daemon, None, None).maps().await.expect_err("the old certificate is gone");
    open.maps().await.expect("an open connection stays");

    fs::write(work.path().join("daemon.key"), "no key").expect("written");
    eventually("no key", async || daemon.process().stderr().contains("contains no private key")).await;
    after.client(&daemon, None, None).maps().await.expect("the certificate before stays");

    let _ = last.sign(Validity::Years).write(work.path());
    daemon.process().signal(Signal::HUP);
    eventually("the last certificate", async || last.client(&daemon, None, None).maps().await.is_ok()).await;
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_certificate_that_clients_would_not_take_never_replaces_one_that_they_take() {
    let work = tempdir().expect("a folder");
    let authority = Authority::new("ours");
    let daemon = launch(work.path(), &authority.sign(Validity::Years)).start();
    let (mut failures, key) = (0, work.path().join("daemon.key"));
    let mut refused = async |words: &str| {
        failures += 1;
        let counted = format!("tidemap_reload_failures_total{{what=\"certificates\"}} {failures}");
        eventually(words, async || daemon.process().stderr().contains(words) && metrics(&daemon).contains(&counted))
            .await;
        authority.client(&daemon, None, None).maps().await.expect("the certificate before stays");
    };
    let (names, other) = (["localhost", "127.0.0.1"], Authority::new("theirs"));
    let signed = |names: &[&str], purpose| authority.sign_for(Validity::Years, names, purpose);
    // The file of the certificate is written last: the pair fits together when the daemon reads it.
    for (next, words) in [
        (authority.sign(Validity::Ended), "has expired"),
        (authority.sign(Validity::NotYet), "is not valid before 2120"),
        (signed(&names, Purpose::Clients), "does not have serverAuth"),
        (signed(&[], Purpose::Both), "names no host"),
        (signed(&["maps.example.org"], Purpose::Both), "is for maps.example.org, and the one in use for localhost"),
        (authority.sign(Validity::Years).with(&other), "is signed by none of those behind it"),
    ] {
        daemon.process().signal(Signal::STOP);
        let _ = next.write(work.path());
        daemon.process().signal(Signal::CONT);
        refused(words).await;
    }
    let next = authority.sign(Validity::Years);
    daemon.process().signal(Signal::STOP);
    let _ = next.write(work.path());
    fs::set_permissions(&key, fs::Permissions::from_mode(0o644)).expect("permissions");
    daemon.process().signal(Signal::CONT);
    refused(&format!("chmod 600 {}", key.display())).await;

    // The permissions are all that is wrong.
    fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).expect("permissions");
    eventually("the next certificate", async || {
        metrics(&daemon).contains("tidemap_reloads_total{what=\"certificates\"} 1")
    })
    .await;
    authority.client(&daemon, None, None).maps().await.expect("served");
    daemon.stop_in_order();
}

/// A certificate of an authority below the one that clients know: without that authority's own they cannot check it.
#[tokio::test(flavor = "multi_thread")]
async fn a_certificate_without_its_issuer_does_not_replace_one_that_has_it() {
    let work = tempdir().expect("a folder");
    let root = Authority::new("root");
    let issuer = root.below("issuer");
    let daemon = launch(work.path(), &issuer.sign(Validity::Years).with(&issuer)).start();
    root.client(&daemon, None, None).maps().await.expect("served");
    let put = |pair: &Pair| {
        daemon.process().signal(Signal::STOP);
        let _ = pair.write(work.path());
        daemon.process().signal(Signal::CONT);
    };
    put(&issuer.sign(Validity::Years));
    eventually("a refusal", async || daemon.process().stderr().contains("lacks the certificate of its issuer")).await;
    root.client(&daemon, None, None).maps().await.expect("the certificate before stays");
    // One name less, and by a wildcard; the issuer is there again.
    put(&issuer.sign_for(Validity::Years, &["localhost", "*.example.org"], Purpose::Both).with(&issuer));
    eventually("the next", async || metrics(&daemon).contains("tidemap_reloads_total{what=\"certificates\"} 1")).await;
    let lost = "the new certificate is not for 127.0.0.1, as the one before was";
    assert!(daemon.process().stderr().contains(lost), "{}", daemon.process().stderr());
    put(&issuer.sign_for(Validity::Years, &["maps.example.org"], Purpose::Both).with(&issuer));
    eventually("the last", async || metrics(&daemon).contains("tidemap_reloads_total{what=\"certificates\"} 2")).await;
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_is_silent_in_the_handshake_is_left() {
    let work = tempdir().expect("a folder");
    let daemon = launch(work.path(), &Authority::new("ours").sign(Validity::Years)).start();
    let mut silent = TcpStream::connect(&daemon.grpc).expect("a connection");
    silent.set_read_timeout(Some(Duration::from_secs(30))).expect("a timeout");
    match silent.read(&mut [0; 16]) {
        Ok(count) => assert_eq!(count, 0, "the connection ends"),
        Err(error) => assert_ne!(error.kind(), ErrorKind::WouldBlock, "the daemon keeps a silent client"),
    }
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn beyond_loopback_http_uses_tls_and_shows_metrics_to_holders_of_tokens() {
    let work = tempdir().expect("a folder");
    let (authority, tokens) = (Authority::new("ours"), Tokens::of(work.path()));
    let (planner, of_one_map) = (tokens.create(&["planner"], &[]), tokens.create(&["admin"], &["office"]));
    let launch = launch(work.path(), &authority.sign(Validity::Years)).setting("http_listen", "0.0.0.0:0");
    let refused = launch.try_start().expect_err("there are no tokens");
    assert!(refused.code() == Some(78) && refused.stderr.contains("without tokens"), "{refused}");
    let daemon = launch.setting("tokens_file", tokens.path.display()).start();
    let address = daemon.http.replace("0.0.0.0", "127.0.0.1");
    let get = async |path: &str, token: Option<&str>| {
        let mut socket = connect(&address, &authority, &version::TLS13).await.expect("TLS");
        let bearer = token.map_or_else(String::new, |token| format!("Authorization: Bearer {token}\r\n"));
        let request = format!("GET {path} HTTP/1.1\r\nHost: here\r\n{bearer}Connection: close\r\n\r\n");
        socket.write_all(request.as_bytes()).await.expect("a request");
        let mut text = Vec::new();
        // The end of a connection may come without the end of TLS.
        let _ = socket.read_to_end(&mut text).await;
        String::from_utf8_lossy(&text).split(' ').nth(1).map(str::to_owned).expect("a status")
    };
    assert_eq!(get("/readyz", None).await, "200");
    for (token, status) in [(None, "401"), (Some("tm_0_0"), "401"), (Some(of_one_map.as_str()), "403")] {
        assert_eq!(get("/metrics", token).await, status, "{token:?}");
    }
    assert_eq!(get("/metrics", Some(&planner)).await, "200");
    daemon.stop_in_order();
}

#[test]
fn wrong_files_are_named_before_anything_is_created() {
    let work = tempdir().expect("a folder");
    let pair = Authority::new("ours").sign(Validity::Years);
    let other = Authority::new("theirs").sign(Validity::Years);
    let empty = private_file(&work.path().join("empty.pem"), "");
    let foreign = private_file(&work.path().join("foreign.key"), &other.key);
    let data = work.path().join("data");
    for (key, value, words) in [
        ("tls_key", "", "tls_key is not set"),
        ("tls_key", "/nonexistent/key", "tls_key: /nonexistent/key cannot be read"),
        ("tls_key", empty.to_str().expect("text"), "contains no private key"),
        ("tls_key", foreign.to_str().expect("text"), "cannot be used together"),
        ("tls_certificate", empty.to_str().expect("text"), "contains no certificate"),
        ("tls_client_ca", empty.to_str().expect("text"), "contains no certificate"),
    ] {
        let exit = launch(work.path(), &pair).setting(key, value).try_start().expect_err(words);
        assert!(exit.code() == Some(78) && exit.stderr.contains(words), "{words}: {exit}");
        let secret = pair.key.lines().nth(1).expect("a line of the key");
        assert!(!exit.stderr.contains(secret) && !data.exists(), "{exit}");
    }
    let ours = Authority::new("ours");
    let signed = |names: &[&str], purpose| ours.sign_for(Validity::Years, names, purpose);
    for (pair, words) in [
        (ours.sign(Validity::Ended), "expired, it was valid until 2020"),
        (signed(&["localhost"], Purpose::Clients), "is not for servers"),
        (signed(&[], Purpose::Both), "names no host"),
        (ours.sign(Validity::Years).with(&Authority::new("theirs")), "is signed by none of those behind it"),
    ] {
        let exit = launch(work.path(), &pair).try_start().expect_err(words);
        assert!(exit.code() == Some(78) && exit.stderr.contains(words), "{words}: {exit}");
    }
    for (mode, is_fine) in [(0o604, false), (0o606, false), (0o640, true)] {
        let launch = launch(work.path(), &pair);
        fs::set_permissions(work.path().join("daemon.key"), fs::Permissions::from_mode(mode)).expect("permissions");
        match launch.try_start() {
            Ok(daemon) => {
                assert!(is_fine && daemon.stop_in_order().contains("has permissions") != is_root(), "{mode:o}");
            }
            Err(exit) => {
                assert!(!is_fine && exit.code() == Some(78) && exit.stderr.contains("chmod 600"), "{mode:o}: {exit}");
            }
        }
    }
    // A clock that is wrong at the start is often set right soon.
    let early = Authority::new("ours").sign(Validity::NotYet);
    let daemon = launch(work.path(), &early).start();
    assert!(daemon.stop_in_order().contains("clients refuse to connect"));
}

/// Whether files made here belong to root, whose groups may read keys.
fn is_root() -> bool {
    rustix::process::getuid().is_root()
}
