//! The resources that one sender's imports take from others: turns, the processor, and programs that outlive the client
//! that waits for them.
//!
//! Invariant: the programs are those that the daemon starts. The data of a process is read from the system.

use std::{io::Read as _, os::unix::net::UnixListener, process::Command};

use rustix::process::{Pid, Signal, kill_process};
use tidemap_tests::binaries;

use super::*;

/// The programs that work in the folder of recordings of this data folder; those that have ended do not.
fn programs(data: &Path) -> Vec<i32> {
    let folder = data.join("uploads");
    let processes = fs::read_dir("/proc").expect("processes").filter_map(Result::ok);
    let working = processes.filter(|process| {
        fs::read_link(process.path().join("cwd")).is_ok_and(|works_in| works_in.starts_with(&folder))
    });
    working.filter_map(|process| process.file_name().to_str()?.parse().ok()).collect()
}

fn niceness(pid: i32) -> Option<String> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    stat.rsplit(')').next()?.split_whitespace().nth(16).map(str::to_owned)
}

fn signal(pid: i32, signal: Signal) {
    kill_process(Pid::from_raw(pid).expect("a number"), signal).expect("it is there");
}

#[test]
fn a_sender_of_little_keeps_no_turn_and_takes_none_of_another_map() {
    let (data, daemon) = started();
    let path = "flat/recordings/door.bag";
    let mut slow = chunked(&daemon, path);
    slow.write_all(b"5\r\n#ROSB\r\n").expect("a part");
    eventually("the file arrives", || data.path().join("uploads/0/recording/door.bag").exists());
    refused(&check(&daemon, path, &[]), 429, "BUSY", &["into this map"]);
    assert_eq!(imported(&send(&daemon, "other/recordings/door.bag", &[], &door(4))).1, 0);
    // An address has two turns.
    let mut second = chunked(&daemon, "other/recordings/door.bag");
    second.write_all(b"5\r\n#ROSB\r\n").expect("a part");
    eventually("the file arrives", || data.path().join("uploads/1/recording/door.bag").exists());
    refused(&check(&daemon, "third/recordings/door.bag", &[]), 429, "BUSY", &["from this address"]);
    drop(second);
    // A byte now and then does not keep the turn.
    let began = Instant::now();
    slow.set_read_timeout(Some(Duration::from_secs(1))).expect("a timeout");
    let mut answer = [0; 4096];
    let length = loop {
        assert!(began.elapsed() < 4 * ENDED_WITHIN, "it has no end");
        let _ = slow.write_all(b"1\r\na\r\n");
        if let Ok(length @ 1..) = slow.read(&mut answer) {
            break length;
        }
    };
    let answer = String::from_utf8_lossy(&answer[..length]);
    assert!(answer.contains(" 408 ") && answer.contains("KiB a second"), "{answer}");
    eventually("the turn is free", || check(&daemon, path, &[]).code == 200);
    daemon.stop_in_order();
}

#[test]
fn a_program_has_limits_and_ends_with_a_daemon_that_is_killed() {
    let (data, daemon) = started();
    let large = door(60_000);
    let answer = running(&daemon, "large/recordings/door.bag", &large);
    let found = programs(data.path());
    let [program] = found[..] else { panic!("one program: {found:?}") };
    // Lowering its priority is its last step at the start. While it is stopped it does nothing by itself.
    eventually("it leaves the processor to others", || niceness(program).as_deref() == Some("19"));
    signal(program, Signal::STOP);
    let limits = fs::read_to_string(format!("/proc/{program}/limits")).expect("its limits");
    let limit = |name: &str| {
        let line = limits.lines().find_map(|line| line.strip_prefix(name)).expect("a limit");
        line.split_whitespace().next().expect("a number").parse::<u64>().expect("a number")
    };
    let secs = limit("Max cpu time");
    assert!((120..300).contains(&secs), "{secs} s for {} bytes", large.len());
    assert!(limit("Max address space") <= 2 << 30);
    daemon.kill();
    eventually("the program ends", || programs(data.path()).is_empty());
    drop(answer);
}

#[test]
fn a_program_that_survived_ends_when_the_next_daemon_starts() {
    let data = tempdir().expect("a folder");
    let folder = data.path().join("uploads/3/recording");
    fs::create_dir_all(&folder).expect("a folder");
    fs::write(folder.join("door.bag"), door(4)).expect("a file");
    // A daemon that takes connections and does not reply.
    let _silent = UnixListener::bind(data.path().join("uploads/3/socket")).expect("a socket");
    let mut survivor = Command::new(binaries::tidemap())
        .args(["import", "--patience", "10m", "flat", "door.bag"])
        .current_dir(&folder)
        .env("TIDEMAP_SERVER", "unix:../socket")
        .spawn()
        .expect("the program starts");
    eventually("it works there", || !programs(data.path()).is_empty());
    let daemon = Launch::on(data.path()).start();
    eventually("it has ended", || survivor.try_wait().expect("a child").is_some());
    assert!(is_empty(data.path()));
    assert!(daemon.stop_in_order().contains("for an earlier daemon is ended"));
}

#[test]
fn an_import_ends_with_its_token() {
    let work = tempdir().expect("a folder");
    let tokens = Tokens::of(work.path());
    let [first, second] = [(); 2].map(|()| tokens.create(&["admin"], &[]));
    let data = work.path().join("data");
    let daemon = Launch::on(&data).setting("tokens_file", tokens.path.display()).start();
    let large = door(60_000);
    let begin = |map: &str, token: &str| {
        let mut socket = TcpStream::connect(&daemon.http).expect("the port is open");
        let (name, media) = BYTES;
        let head = format!(
            "POST /api/v1/maps/{map}/recordings/door.bag HTTP/1.1\r\nHost: {}\r\n{name}: {media}\r\n\
             Authorization: Bearer {token}\r\nConnection: close\r\nContent-Length: {}\r\n\r\n",
            daemon.http,
            large.len()
        );
        socket.write_all(head.as_bytes()).expect("a request");
        socket
    };
    // One import runs, of which nothing more comes while it is stopped; the file of the other still arrives.
    let mut running = begin("large", &first);
    running.write_all(&large).expect("the file");
    eventually("it runs", || !programs(&data).is_empty());
    signal(programs(&data)[0], Signal::STOP);
    let mut arriving = begin("other", &second);
    arriving.write_all(&large[..1000]).expect("a part");
    eventually("it arrives", || data.join("uploads/1/recording/door.bag").exists());
    tokens.revoke(&first);
    tokens.revoke(&second);
    let mut text = String::new();
    let _ = running.read_to_string(&mut text);
    assert!(text.contains("REVOKED") && text.contains("token was revoked"), "{text}");
    let mut head = [0; 4096];
    let length = arriving.read(&mut head).expect("an answer");
    let head = String::from_utf8_lossy(&head[..length]);
    assert!(head.contains(" 401 ") && head.contains("REVOKED"), "{head}");
    eventually("the program has ended", || programs(&data).is_empty());
    eventually("the files are gone", || is_empty(&data));
    let log = daemon.stop_in_order();
    assert!(log.contains("the import of a recording was stopped") && log.contains("token was revoked"), "{log}");
}
