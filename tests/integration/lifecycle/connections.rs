//! Clients that only hold connections open do not keep others out, and what the daemon writes is its owner's alone.

use std::{
    fs,
    io::{Read as _, Write as _},
    net::{Shutdown, TcpStream},
    os::unix::fs::PermissionsExt as _,
    path::Path,
    process::Command,
    time::Duration,
};

use tidemap_client::{connection::Client, maps::NewMap};
use tidemap_tests::daemon::{Daemon, Launch};

use super::ports::{get, metric};

/// Silent sockets of the test; the full number needs more descriptors than most shells allow.
const SILENT: usize = 400;

fn silent(daemon: &Daemon) -> TcpStream {
    let address = daemon.grpc.trim_start_matches("http://");
    TcpStream::connect(address).expect("a connection")
}

/// Whether the other end has closed the connection, or closes it within the time.
fn is_closed(socket: &mut TcpStream, within: Duration) -> bool {
    socket.set_read_timeout(Some(within)).expect("a timeout");
    let mut bytes = [0; 1024];
    loop {
        match socket.read(&mut bytes) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(error) => return !matches!(error.kind(), std::io::ErrorKind::WouldBlock),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn silent_connections_make_room_and_end() {
    let data = tempfile::tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).setting("max_connections", 64).start();
    let mut held: Vec<TcpStream> = (0..SILENT).map(|_| silent(&daemon)).collect();
    daemon.client().maps().await.expect("a good client is served");
    let (_, metrics) = get(&daemon, "/metrics").await;
    assert!(metric(&metrics, "tidemap_connections_displaced{port=\"grpc\"}") >= Some(1.0), "{metrics}");
    assert!(is_closed(&mut held[0], Duration::from_secs(1)), "the oldest made room");
    // A connection that sends hello and then nothing has to make a request in time too.
    let mut greeting = silent(&daemon);
    greeting.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0").expect("sent");
    assert!(is_closed(&mut greeting, Duration::from_secs(20)));
    daemon.client().maps().await.expect("a good client is served");
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_busy_connection_is_not_displaced() {
    let data = tempfile::tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).setting("max_connections", 8).start();
    let client = daemon.client();
    client.maps().await.expect("served");
    for _ in 0..40 {
        let socket = silent(&daemon);
        socket.shutdown(Shutdown::Write).expect("half closed");
        client.maps().await.expect("still served on its connection");
    }
    daemon.stop_in_order();
}

#[tokio::test(flavor = "multi_thread")]
async fn accepts_that_fail_for_want_of_descriptors_do_not_spin() {
    let data = tempfile::tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    // Descriptors become fewer than the daemon counted on when it started.
    let pid = daemon.process().pid().to_string();
    let open = fs::read_dir(format!("/proc/{pid}/fd")).expect("a process").count();
    let nofile = format!("--nofile={}", open + 20);
    assert!(Command::new("prlimit").args(["--pid", &pid, &nofile]).status().expect("prlimit runs").success());
    let sockets = 200;
    let mut held: Vec<TcpStream> = (0..sockets).map(|_| silent(&daemon)).collect();
    assert!(
        is_closed(&mut held[0], Duration::from_secs(20)),
        "the oldest made room for one that could not be accepted"
    );
    drop(held);
    daemon.client().maps().await.expect("served again");
    // After a failure the daemon pauses, and one connection makes room: it never fails more often than there are
    // connections.
    let (_, metrics) = get(&daemon, "/metrics").await;
    let failures = metric(&metrics, "tidemap_accept_errors").expect("descriptors were missing");
    assert!((1.0..=f64::from(sockets)).contains(&failures), "{failures} accepts failed");
    daemon.stop_in_order();
}

fn mode(path: &Path) -> u32 {
    fs::metadata(path).expect("it exists").permissions().mode() & 0o777
}

/// The permissions of everything in a folder.
fn modes(folder: &Path) -> Vec<(bool, u32)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path()) {
        found.push((entry.is_dir(), mode(&entry)));
        if entry.is_dir() {
            found.extend(modes(&entry));
        }
    }
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn the_data_folder_and_the_socket_are_private_whatever_the_umask() {
    let work = tempfile::tempdir().expect("a folder");
    let (data, socket) = (work.path().join("data"), work.path().join("socket"));
    fs::create_dir(&data).expect("a folder");
    fs::set_permissions(&data, fs::Permissions::from_mode(0o755)).expect("permissions");
    let launch =
        Launch::on(&data).setting("socket", socket.display()).under(["sh", "-c", "umask 0; exec \"$@\"", "sh"]);
    let daemon = launch.start();
    let local = Client::new(&format!("unix:{}", socket.display())).expect("an address");
    local.create_map(NewMap { name: "office".to_owned(), ..NewMap::default() }).await.expect("a new map");
    assert_eq!(daemon.client().maps().await.expect("the maps").len(), 1, "both ports serve the same maps");
    assert_eq!((mode(&data), mode(&socket)), (0o700, 0o600));
    let all = modes(&data);
    assert!(all.len() > 5, "{all:?}");
    assert!(all.iter().all(|&(is_folder, mode)| mode == if is_folder { 0o700 } else { 0o600 }), "{all:?}");
    // A daemon that died leaves its socket behind; the next one takes the path over.
    daemon.kill();
    assert!(socket.exists());
    let next = launch.start();
    assert_eq!(local.maps().await.expect("served again").len(), 1);
    let other = Launch::on(&work.path().join("other")).setting("socket", socket.display());
    let exit = other.try_start().expect_err("the socket is taken");
    assert!(exit.stderr.contains("another daemon listens there"), "{}", exit.stderr);
    next.stop_in_order();
}
