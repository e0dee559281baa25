//! `tidemapd check-engine`: its output for sound servers, for servers that must not be used, and for no server.

use std::{
    io::{Read as _, Write as _},
    net::{TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Command, Output},
};

use super::*;

fn config(folder: &Path, servers: &[String], more: &str) -> PathBuf {
    let path = folder.join("engine.toml");
    fs::write(&path, format!("[cluster]\nmember = \"north\"\nservers = {servers:?}\n{more}")).expect("a config file");
    path
}

fn check_engine(config: &Path) -> Output {
    let mut command = Command::new(tidemap_tests::binaries::tidemapd());
    command.args(["check-engine", "--seconds", "2", "--config"]).arg(config).output().expect("runs")
}

fn refused(output: &Output, words: &[&str]) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(78) && words.iter().all(|word| text.contains(word)), "{output:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn check_engine_prints_the_servers_and_lets_writers_race() {
    let servers = match NatsServers::start(3).await {
        Ok(servers) => servers,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let work = tempdir().expect("a folder");
    let urls: Vec<String> = (0..3).map(|index| servers.url(index)).collect();
    let output = check_engine(&config(work.path(), &urls, ""));
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let lines: Vec<&str> = text.lines().collect();
    for (index, line) in lines[..3].iter().enumerate() {
        assert!(line.starts_with(&format!("nats-{index}: version 2.")), "{line}");
        assert!(line.ends_with("writes to its disk before it acknowledges"), "{line}");
    }
    assert!(lines[3].starts_with("4 writers in 2 s: ") && lines[3].ends_with("no position was taken twice"), "{text}");
    assert_eq!(String::from_utf8_lossy(&output.stderr), "", "nothing is wrong");
    assert!(!lines[3].contains(" 0 appends") && !lines[3].contains(" 0 refused"), "there was no race: {text}");
}

#[tokio::test(flavor = "multi_thread")]
async fn check_engine_refuses_servers_that_acknowledge_before_they_write() {
    let servers = match NatsServers::start_unsynced(1).await {
        Ok(servers) => servers,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let work = tempdir().expect("a folder");
    let output = check_engine(&config(work.path(), &[servers.url(0)], "engine_replicas = 1\n"));
    refused(&output, &["sync_interval: always"]);
    assert!(String::from_utf8_lossy(&output.stdout).contains("acknowledges before it writes"), "{output:?}");
}

/// Reports the version 2.9.10, and replies to pings only.
fn pretend(mut connection: TcpStream) -> std::io::Result<()> {
    connection.write_all(
        b"INFO {\"server_id\":\"A\",\"server_name\":\"old\",\"version\":\"2.9.10\",\"proto\":1,\"headers\":true,\
          \"max_payload\":2097152,\"jetstream\":true}\r\n",
    )?;
    let mut buffer = [0; 4096];
    loop {
        let read = connection.read(&mut buffer)?;
        if read == 0 {
            return Ok(());
        }
        for _ in buffer[..read].windows(4).filter(|window| window == b"PING") {
            connection.write_all(b"PONG\r\n")?;
        }
    }
}

#[test]
fn check_engine_refuses_a_server_that_is_too_old() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    std::thread::spawn(move || {
        for connection in listener.incoming().flatten() {
            std::thread::spawn(move || pretend(connection));
        }
    });
    let work = tempdir().expect("a folder");
    let output = check_engine(&config(work.path(), &[format!("nats://{address}")], ""));
    refused(&output, &["nats-server old has version 2.9.10", "two writers append at one position"]);
    assert!(String::from_utf8_lossy(&output.stdout).contains("old: version 2.9.10"), "{output:?}");
}

#[test]
fn check_engine_needs_a_section_and_a_server() {
    let work = tempdir().expect("a folder");
    let file = work.path().join("alone.toml");
    fs::write(&file, "").expect("a config file");
    refused(&check_engine(&file), &["no section [cluster]"]);
    let free = TcpListener::bind("127.0.0.1:0").expect("a port").local_addr().expect("an address");
    refused(&check_engine(&config(work.path(), &[format!("nats://{free}")], "")), &["the engine could not be checked"]);
}
